"""The gradient through design, identification, schedule and loop, arm in the loop, against central differences."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from jaxmpc import Params
from jaxmpc.xla.precision import in_float64
from tests.tuning.test_gradient_on_the_arm import QUIET
from tuning import TuneSpec
from tuning.objective.problem import problem_of, training

Job = Callable[..., dict[str, Any]]
POINTS = 20
PLACES = (375.0, 810.0)
STEP = 1e-4
QUICK = {
    "stiffness": list(PLACES),
    "amplitude": 0.5,
    "frequency": 30.0,
    "lock_in": 0.05,
    "averaging": 0.1,
    "confidence": 1.0,
    "band": 0.12,
}
"""Settings with which the schedule has the control of both tissues from 1.5 s on, and some of it from 0.9 s on."""
FREE = {"lam": True, "Q_p": True, "T_cl": True, "knots": {"lam": True, "Q_p": True, "T_cl": True, "Khat_s": True}}


def quick_family() -> dict[str, Any]:
    """The published family's knots at two stiffnesses, which it tells apart quickly."""
    family = Params.published("family").to_dict()
    places = family["listening"]["stiffness"]
    knots = [knot for knot, place in zip(family["knots"], places, strict=True) if place in PLACES]
    return {"published": "family", "guarded": False, "knots": knots, "listening": QUICK}


@pytest.mark.slow
@in_float64
def test_every_parameter_at_twenty_random_feasible_points(small: Job) -> None:
    """1e-4 of the largest slope, by differences of fourth order; most of it is the reverse mode's compiling.

    Scored is what comes before, while and after the schedule takes over.
    """
    tune = {"starts": 2, "train_seeds": [0], "duration": 1.9, "settle": 0.7, "free": FREE, "margin_points": 0}
    goals = {"M_s": 3.0, "ideal": False, "soft": {"rms": 0.05}}
    experiment = {**QUIET, "stiffness": list(PLACES)}
    job = small(experiment=experiment, params=quick_family(), tune=tune, scenarios={"rhythms": ["own"]}, goals=goals)
    spec = TuneSpec.from_dict(job)
    problem = problem_of(spec, training(spec, (0,)))
    z = spec.space.encode(spec.params) + 0.05 * np.random.default_rng(0).standard_normal((POINTS, spec.space.size))
    values = problem.differentiate(z, 1.0)
    assert (values.hard.max(axis=1) < 1.0).all(), "feasible"
    steps = np.array([-2.0, -1.0, 1.0, 2.0])[:, None, None] * STEP * np.eye(spec.space.size)
    around = (z[:, None, None] + steps).reshape(-1, spec.space.size)
    # In parts: all runs at once take more than 20 GB.
    losses = np.concatenate([problem.evaluate(part).loss for part in np.split(around, spec.space.size)])
    weights = np.array([1.0, -8.0, 8.0, -1.0]) / (12.0 * STEP)
    expected = np.einsum("psk,s->pk", losses.reshape(POINTS, 4, -1), weights)
    assert (np.abs(expected).max(axis=0) > 0.0).all(), "every parameter acts"
    worst = np.abs(values.gradient - expected).max(axis=1) / np.abs(expected).max(axis=1)
    np.testing.assert_array_less(worst, 1e-4)
