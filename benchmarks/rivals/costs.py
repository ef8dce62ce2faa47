"""What an evaluation and a gradient cost on this machine, measured once per folder of results."""

import time
from collections.abc import Callable
from pathlib import Path

import jax
import msgspec
import numpy as np

from benchmarks.rivals import pi
from benchmarks.rivals.gradient import warmed_up
from benchmarks.rivals.objective import BATCH, evaluator, mpc_aob, pi_control
from benchmarks.rivals.room import vectors
from benchmarks.sweep_throughput import machine
from jaxmpc.files.errors import InputError
from jaxmpc.files.sealed import write_atomic
from tuning.job.spec import TuneSpec
from tuning.objective.problem import problem_of, training

REPEATS = 7
SAME = 1e-9
"""Relative difference between two programs of the same objective, of float64 rounding amplified by the quantisers."""


class Costs(msgspec.Struct, frozen=True):
    """Costs, and of which job they are."""

    key: str
    machine: str
    devices: int
    steps: int
    """Of one evaluation: scenarios × tissues × samples."""
    rate: float
    """Steps per second of a batch of evaluations."""
    cost_ratio: float
    """Of a look of the tuner to evaluations of as many controllers at once [-]."""
    look: float
    """Seconds of a look at `starts` controllers."""
    difference: float
    """Between the losses that both programs give, relative [-]."""
    compiled: dict[str, float]
    """Seconds of everybody's first call."""


def prepared(spec: TuneSpec, key: str, path: Path) -> Costs:
    """Compile all programs, and measure what they cost unless that is known from before.

    Raises:
        InputError: The folder is of another job.
    """
    problem = problem_of(spec, training(spec, spec.tune.train_seeds))
    starts = spec.tune.starts
    many = vectors(problem.structure.axes, np.random.default_rng(0).uniform(size=(BATCH, spec.space.size)))
    many[0] = spec.space.encode(spec.params)
    few = np.repeat(many[:1], starts, axis=0)
    evaluate, small = evaluator(problem, mpc_aob), evaluator(problem, mpc_aob, starts)
    control = evaluator(problem, pi_control)
    compiled = {
        "evaluations": _seconds(lambda: evaluate(many)),
        "of PI": _seconds(lambda: control(np.zeros((BATCH, len(pi.AXES))))),
        "tuner": warmed_up(spec),
    }
    if path.exists():
        known = msgspec.json.decode(path.read_bytes(), type=Costs)
        if known.key != key:
            raise InputError("-o", path.parent, "a new folder, or one of this very job", "Choose another or remove it.")
        return known
    steps = len(spec.tune.train_seeds) * len(spec.experiment.stiffness) * problem.data.scene.signals.score.shape[1]
    found, expected = small(few).loss, problem.differentiate(few, 1.0).loss
    difference = float(np.max(np.abs(found / expected - 1.0)))
    if not difference < SAME:
        raise SystemExit(f"evaluations give another loss than the tuner's looks: {found} instead of {expected}")
    # In turns, and the least of each: on a shared machine the rest only measures the neighbours.
    times = [
        [
            _seconds(lambda: small(few)),
            _seconds(lambda: problem.differentiate(few, 1.0)),
            _seconds(lambda: evaluate(many)),
        ]
        for _ in range(REPEATS)
    ]
    once, look, batch = np.min(times, axis=0).tolist()
    costs = Costs(
        key, machine(), jax.local_device_count(), steps, BATCH * steps / batch, look / once, look, difference, compiled
    )
    write_atomic(path, msgspec.json.format(msgspec.json.encode(costs), indent=2))
    return costs


def _seconds(function: Callable[[], object]) -> float:
    began = time.perf_counter()
    function()
    return time.perf_counter() - began
