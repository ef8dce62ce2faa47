"""Experiments: the tables of their TOML files, what is built from them, and the published ones."""

from jaxmpc.experiment.experiment import AXES, Experiment, Physics, SensorSettings, Signals

__all__ = ["AXES", "Experiment", "Physics", "SensorSettings", "Signals"]
