"""Filters that a job frees: where they begin, who judges them, and what of them is refused."""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np
import pytest

from jaxmpc import Experiment, InputError, Params, evaluate, margins
from jaxmpc.closed_loops import close_loops
from jaxmpc.stability import Margins
from jaxmpc.stability.family import family_margins
from jaxmpc.stability.held_beat import telling_rates
from tuning import TuneSpec
from tuning.objective.measures import Data, judged_margins
from tuning.objective.problem import problem_of, training

Job = Callable[..., dict[str, Any]]
SAMPLED: dict[str, Any] = {
    "damping": "sampled",
    "stiffness": [375.0, 810.0],
    "sensor": {"lsb": [0.0, 0.0, 0.0]},
    "reference": {"z": -1.0},
}
TUNE = {"starts": 2, "duration": 1.5, "settle": 1.0}
FREE = {"velocity_cutoff": True, "force_cutoff": [50.0, 2000.0], "K2": True}


def spec_of(small: Job, experiment: dict[str, Any] = SAMPLED, free: dict[str, Any] = FREE, **tables: Any) -> TuneSpec:
    return TuneSpec.from_dict(small(experiment=experiment, tune={**TUNE, "free": free}, **tables))


def test_they_begin_as_the_experiments(small: Job) -> None:
    spec = spec_of(small)
    begun = spec.space.exact(spec.space.encode(spec.space.base))
    assert float(begun.velocity_cutoff) == pytest.approx(180.0)
    # Where none filters the force, as quick as the bounds let it.
    assert float(begun.force_cutoff) == pytest.approx(2000.0, rel=0.01)
    assert spec.params.force_cutoff is None
    assert spec.before.velocity_cutoff is None

    filtered = spec_of(small, {**SAMPLED, "velocity_lowpass": 300.0, "sensor": {"kalman": 1.0}})
    assert float(filtered.space.base.velocity_cutoff) == 300.0
    assert float(filtered.space.base.force_cutoff) == pytest.approx(filtered.experiment.force_cutoff)
    given = spec_of(small, params={"force_cutoff": 700.0})
    assert float(given.space.base.force_cutoff) == 700.0
    still = spec_of(small, free={"K2": True}, params={"force_cutoff": 700.0})
    assert float(still.space.exact(still.space.encode(still.space.base)).force_cutoff) == 700.0


def test_what_makes_no_sense_is_refused(small: Job) -> None:
    with pytest.raises(InputError, match="damping is ideal"):
        spec_of(small, {**SAMPLED, "damping": "ideal"})
    with pytest.raises(InputError, match="around the start point"):
        spec_of(small, free={"velocity_cutoff": [200.0, 900.0]})
    family = {"experiment": {"published": "family-wam"}, "params": {"published": "family"}, "goals": {"ideal": False}}
    for knots in ({"velocity_cutoff": True}, {"2": {"force_cutoff": [50.0, 500.0]}}):
        with pytest.raises(InputError, match="a parameter of a knot"):
            TuneSpec.from_dict(family | {"tune": {"free": {"knots": knots}}})
    # Fixed gains and knots have one, so that both are judged.
    both = TuneSpec.from_dict(family | {"tune": {"free": {"force_cutoff": True, "knots": {"Q_p": True}}}})
    assert not both.fixed_stay


def out_of_reach(small: Job) -> TuneSpec:
    """What the margins miss is part of the loss; both tests have one program."""
    goals = {"ideal": False, "M_s": 1.2, "soft": {"chatter": 1.0, "rms": 0.05}}
    return spec_of(small, goals=goals, params={"force_cutoff": 600.0})


@pytest.mark.oracle
def test_the_tuner_sees_the_loop_that_is_judged_and_run(small: Job) -> None:
    spec = out_of_reach(small)
    met = training(spec, [0])
    z = spec.space.encode(spec.space.base) + np.array([[0.3, 0.3, 0.2], [-0.5, -0.2, 0.1]])
    seen = problem_of(spec, met).differentiate(z, 1.0)
    for row in range(2):
        params = spec.space.exact(z[row])
        judged = margins(params, spec.judged_at, path=spec.experiment.loop_path(False))
        np.testing.assert_allclose(seen.M_s[row], judged.M_s, rtol=1e-9)
        run = evaluate(params, met[0])
        np.testing.assert_allclose(seen.cells.rms[row][:, 0], run.metrics.rms, rtol=1e-9)


@pytest.mark.oracle
def test_the_loss_has_slopes_of_them(small: Job) -> None:
    spec = out_of_reach(small)
    problem = problem_of(spec, training(spec, [0]))
    z = spec.space.encode(spec.space.base) + np.array([0.3, -0.2, 0.2])
    gradient = problem.differentiate(z[None].repeat(2, axis=0), 1.0).gradient[0]

    def slope(step: np.ndarray) -> float:
        near, far = (problem.differentiate(z + h * step * [[1.0], [-1.0]], 1.0).loss for h in (1.0, 2.0))
        return float(8.0 * (near[0] - near[1]) - (far[0] - far[1])) / 12e-4

    expected = [slope(step) for step in 1e-4 * np.eye(len(z))]
    assert (np.abs(expected) > 1e-3).all()
    np.testing.assert_allclose(gradient, expected, rtol=1e-4)


@pytest.mark.oracle
def test_a_family_with_filters_is_judged_with_them_held_and_fixed(small: Job) -> None:
    job = {
        "experiment": {"published": "family-wam"},
        "params": {"published": "family"},
        "goals": {"M_s": 2.0},
        "tune": {"train_seeds": [0], "duration": 14.0, "settle": 13.0, "free": {"velocity_cutoff": True, "lam": True}},
    }
    spec = TuneSpec.from_dict(job)
    problem = problem_of(spec, training(spec, [0]), spectral=True)
    family = Params.from_dict({**Params.published("family").to_dict(), "velocity_cutoff": 90.0, "force_cutoff": 900.0})

    def judged(batch: Params, data: Data) -> Margins:
        return judged_margins(close_loops(batch, data.scene.stiffness, data.scene.path), data)

    found = np.asarray(jax.jit(judged)(Params.stack([family]), problem.data).M_s)[0]
    K_s, believed = (np.asarray(values) for values in (problem.data.judged_at, problem.data.believed))
    fixed = np.isnan(believed)
    path = Experiment.published("family-wam").loop_path()
    np.testing.assert_allclose(found[fixed], margins(family, K_s[fixed], path=path).M_s, rtol=1e-9)
    known = np.unique(believed[~fixed])
    ratios = (K_s / believed)[~fixed][: np.sum(believed == known[0])]
    judged_again = family_margins(family, known, ratios, path, telling_rates)
    np.testing.assert_allclose(found[~fixed].reshape(len(known), -1), judged_again.M_s, rtol=1e-9)
