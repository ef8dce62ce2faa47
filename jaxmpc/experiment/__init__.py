"""Experiments: the tables of their TOML files, what is built from them, and the published ones."""

from jaxmpc.experiment.experiment import Experiment, Physics, SensorSettings, Signals
from jaxmpc.quantities import AXES

__all__ = ["AXES", "Experiment", "Physics", "SensorSettings", "Signals"]
