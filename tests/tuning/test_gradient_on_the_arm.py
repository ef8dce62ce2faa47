"""The gradient that tunes, arm in the loop, against central differences at random feasible points."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from jaxmpc.xla.precision import in_float64
from tuning import TuneSpec
from tuning.objective.problem import problem_of, training

Job = Callable[..., dict[str, Any]]
POINTS, ROWS = 20, 32
STEP = 1e-3
UNLIMITED = {"joint_torque_limit": [0.0] * 4, "torque_step_limit": [0.0] * 4}
QUIET = {
    "published": "table-1-wam",
    "stiffness": [375.0, 1900.0],
    "sensor": {"lsb": [0.0, 0.0, 0.0]},
    "arm": {"encoder_counts": 0, "torque_lsb": 0.0, "torque_limit": [100.0] * 4, **UNLIMITED},
    "reference": {"z": []},
}
"""Without quantisers and saturation: their tangent is straight-through on purpose, which no difference sees."""
TUNED = {"lam": 5.0, "Q_p": 40.0, "Q_x": 5.0, "T_cl": 3e-4, "K2": 19.0, "Khat_s": 1900.0, "Hp": 12, "Hu": 5}


@pytest.mark.oracle
@in_float64
def test_every_parameter_at_twenty_random_feasible_points(small: Job) -> None:
    tune = {"starts": 2, "train_seeds": [0, 1], "duration": 0.6, "settle": 0.2}
    scenarios = {"rhythms": ["own", "steady"], "friction": 0.3, "mass": 0.1}
    goals = {"M_s": 3.5, "ideal": False, "soft": {"rms": 0.05}}
    spec = TuneSpec.from_dict(small(experiment=QUIET, params=TUNED, tune=tune, scenarios=scenarios, goals=goals))
    problem = problem_of(spec, training(spec, (0, 1)))
    drawn = spec.space.encode(spec.params) + 0.2 * np.random.default_rng(0).standard_normal((2 * ROWS, spec.space.size))
    # Soft horizons, whose slope whole ones do not have.
    seen = [problem.differentiate(part, 3.0) for part in np.split(drawn, 2)]
    feasible = np.concatenate([values.hard.max(axis=1) < 1.0 for values in seen])
    gradient = np.concatenate([values.gradient for values in seen])[feasible][:POINTS]
    z = drawn[feasible][:POINTS]
    assert len(z) == POINTS
    steps = np.array([-2.0, -1.0, 1.0, 2.0])[:, None, None] * STEP * np.eye(spec.space.size)
    around = (z[:, None, None] + steps).reshape(-1, spec.space.size)
    losses = np.concatenate([problem.differentiate(part, 3.0).loss for part in np.split(around, len(around) // ROWS)])
    weights = np.array([1.0, -8.0, 8.0, -1.0]) / (12.0 * STEP)
    expected = np.einsum("psk,s->pk", losses.reshape(POINTS, 4, -1), weights)
    worst = np.abs(gradient - expected).max(axis=1) / np.abs(expected).max(axis=1)
    assert (np.abs(expected).max(axis=0) > 0.0).all(), "every parameter acts"
    np.testing.assert_array_less(worst, 1e-4)
