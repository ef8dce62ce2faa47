"""Gradients of single goals out of whole losses, against closed forms; on real jobs against central differences."""

from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmpc import Params, design
from jaxmpc.report.loops import curves
from jaxmpc.stability.loop import contact_of
from jaxmpc.stability.response import loop_response
from jaxmpc.world.loop_path import loop_path
from jaxmpc.xla.precision import in_float64
from tuning import TuneSpec
from tuning.objective.evaluated import HEADROOM, PENALTY
from tuning.objective.loss import margin_slopes, run_slopes
from tuning.objective.problem import Problem, over_starts
from tuning.proof.gradients import SCORE, Slope, judged_on, on_tissue, slopes, values_at
from tuning.proof.limits import limits, multipliers_of
from tuning.proof.result import assess, assess_and
from tuning.proof.sensitivities import _per_parameter, log_slopes, sensitivities, vector_of
from tuning.proof.split import split
from tuning.reports.explained import _signed, study
from tuning.reports.files import write
from tuning.search.run import run_search

Job = Callable[..., dict[str, Any]]
QUIET = {"sensor": {"lsb": [0.0, 0.0, 0.0]}, "reference": {"z": []}}
STEP = 1e-4


class Seen(NamedTuple):
    loss: Any
    gradient: Any
    score: Any
    hard: Any


class Scene(NamedTuple):
    stiffness: Any


class Data(NamedTuple):
    scene: Scene
    margins: dict[str, Any]
    hard: dict[str, Any]
    soft: dict[str, Any]
    spectra: Any
    judged_at: Any
    reference: Any
    correction: None = None
    believed: None = None


class Analytic(Problem):
    """A loss composed as the real one, of goals whose gradients are known: log goal = exponents · z · (K_s/1000)."""

    def differentiate(self, z: np.ndarray, width: float) -> Any:
        data, K = self.data, np.asarray(self.data.judged_at) / 1e3
        limits = {**data.margins, **data.hard}
        M_s, gain, rms = (np.broadcast_to(limits[name], len(z))[:, None] for name in ("M_s", "gain_margin_db", "rms"))
        value = [1.5 * np.exp((z @ row)[:, None] * K) for row in EXPONENTS[:3]]
        # 1/g per goal and judged tissue, and the sign of its slope.
        inverse = [(M_s / value[0], -1.0), (value[1] / gain, 1.0), (rms / value[2][:, :1], -1.0)]
        tissues = np.asarray(data.scene.stiffness) / 1e3
        worst = tissues[np.argmax((z @ EXPONENTS[3])[:, None] * tissues, axis=1)]
        loss, gradient = worst * (z @ EXPONENTS[3]), worst[:, None] * EXPONENTS[3]
        for (inv, sign), row in zip(inverse, EXPONENTS[:3], strict=True):
            missed = np.maximum(1.0 - inv + HEADROOM, 0.0)
            loss = loss + PENALTY * missed.sum(axis=1)
            steep = np.where(missed > 0.0, -sign * inv * K[: inv.shape[1]], 0.0).sum(axis=1)
            gradient = gradient + PENALTY * steep[:, None] * row
        hard = np.stack([(1.0 / inv).max(axis=1) for inv, _ in inverse], axis=1)
        return Seen(loss, gradient, np.exp(worst * (z @ EXPONENTS[3])), hard)


EXPONENTS = np.random.default_rng(0).standard_normal((4, 5))
TISSUES = np.array([400.0, 900.0, 1800.0])


def analytic() -> Analytic:
    margins = {"M_s": jnp.asarray(2.0), "gain_margin_db": jnp.asarray(3.0)}
    reference = jnp.ones((3, 1, 3))
    data: Any = Data(
        Scene(jnp.asarray(TISSUES)), margins, {"rms": jnp.asarray(0.1)}, {}, None, jnp.asarray(TISSUES), reference
    )
    return Analytic(data, None)  # type: ignore[arg-type]  # it runs no program


@pytest.mark.parametrize("starts", [2, 8])
@in_float64
def test_one_look_holds_the_gradient_of_every_goal(starts: int) -> None:
    z = np.linspace(-0.2, 0.3, 5)
    others = np.stack([z + 0.1, z - 0.1])
    found = slopes(on_tissue(analytic(), 1), z, starts, others)
    K = TISSUES[1] / 1e3
    signs = {"M_s": (0, 1.0, 1.5 / 2.0), "gain_margin_db": (1, -1.0, 3.0 / 1.5), "rms": (2, 1.0, 1.5 / 0.1)}
    for name, (row, sign, factor) in {**signs, SCORE: (3, 1.0, 1.0)}.items():
        np.testing.assert_allclose(found[name].gradient, sign * EXPONENTS[row] * K, rtol=1e-9, err_msg=name)
        for value, vector in ((found[name].value, z), *zip(found[name].beside, others, strict=True)):
            assert value == pytest.approx(factor * np.exp(sign * EXPONENTS[row] @ vector * K), rel=1e-12)


@in_float64
def test_margins_alone_move_to_another_tissue() -> None:
    z = np.linspace(-0.2, 0.3, 5)
    found = slopes(judged_on(analytic(), 700.0), z, 4)
    np.testing.assert_allclose(found["M_s"].gradient, EXPONENTS[0] * 0.7, rtol=1e-9)
    assert found[SCORE].value == pytest.approx(np.exp(EXPONENTS[3] @ z * TISSUES / 1e3).max())


def test_multipliers_balance_the_slope_with_goals_that_push_against_it() -> None:
    first, second, away = np.array([1.0, 0.0, 0.0]), np.array([1.0, 1.0, 0.0]), np.array([0.0, -1.0, -1.0])
    downhill = 2.0 * first + 0.5 * second + np.array([0.0, 0.0, 0.3])
    multipliers, left = multipliers_of(downhill, [first, second, away])
    np.testing.assert_allclose(multipliers, [2.0, 0.5, 0.0], atol=1e-12)
    assert left == pytest.approx(0.3)
    assert multipliers_of(downhill, [])[1] == pytest.approx(np.linalg.norm(downhill))


@in_float64
def test_slopes_of_log_parameters_are_central_differences(small: Job) -> None:
    free = {"lam": True, "T_cl": True, "Khat_s": True, "Hp": True}
    space = TuneSpec.from_dict(small(tune={"free": free, "diagonals": ["lam"]})).space
    z = space.encode(Params()) + 0.3
    beside = np.log(space.values(np.stack([z - STEP, z + STEP])))
    # The quotient errs by the third derivative times the step squared: some 1e-9.
    np.testing.assert_allclose(log_slopes(space, z), (beside[1] - beside[0]) / (2.0 * STEP), rtol=1e-7)


def test_curves_show_the_worse_cut_and_end_where_the_reference_asks(spec: TuneSpec) -> None:
    params = Params(Khat_s=900.0, K2=30.0)
    found = curves(params, spec.experiment, ideal=False)
    np.testing.assert_allclose(found.force[:, -1], 1.0, atol=0.01)
    assert (found.overshoot >= 0.0).all()
    with jax.enable_x64(True):
        stiffness = np.asarray(spec.experiment.stiffness)[:, None]
        contact = contact_of(stiffness, 30.0, loop_path())
        gains, contact = jax.tree.map(np.asarray, (design(params), contact))
    theta = 2.0 * np.pi * found.frequency * 1e-3
    cuts = np.stack([np.abs(1.0 / (1.0 + loop_response(gains, contact, theta, cut))) for cut in (0.0, 1.0)])
    for i in range(len(stiffness)):
        np.testing.assert_allclose(found.sensitivity[i], max(cuts[:, i], key=np.max), rtol=1e-12)


def compiled(problem: Problem) -> tuple[int, ...]:
    """How many functions have been dealt out, and how many programs there are of those that descend."""
    programs = (over_starts(slopes, problem.structure).programs for slopes in (margin_slopes, run_slopes))
    return over_starts.cache_info().currsize, *programs


@pytest.mark.oracle
@in_float64
def test_a_real_job_against_central_differences_without_another_program(small: Job) -> None:
    free = {"lam": True, "Q_p": True, "K2": True, "Khat_s": True, "Hp": True}
    tune = {"starts": 4, "steps": 4, "free": free}
    goals = {"ideal": False, "M_s": 3.0, "overshoot": 8.0}
    result = assess(run_search(TuneSpec.from_dict(small(experiment=QUIET, tune=tune, goals=goals))))
    step, spec, z = result.steps[-1], result.spec, vector_of(result)
    np.testing.assert_array_equal(spec.space.exact(z).Khat_s, result.params.Khat_s)
    programs = compiled(step.problem)
    found = sensitivities(result)
    held = limits(result)
    assert compiled(step.problem) == programs
    for tissue in range(3):
        alone = on_tissue(step.problem, tissue)
        for i, name in enumerate(("lam", "Q_p", "K2", "Khat_s")):
            moved = [z + sign * STEP * np.eye(len(z))[i] for sign in (1.0, -1.0)]
            values = np.log(spec.space.values(np.stack(moved))[:, i])
            seen = values_at(alone, np.stack(moved), 4)
            for metric, reached in ((0, seen.score), (1, seen.hard[:, 0])):
                expected = np.log(reached[0] / reached[1]) / (values[0] - values[1])
                slope = found.slopes[metric, i, tissue]
                assert slope == pytest.approx(expected, rel=1e-4, abs=1e-7), (name, tissue, metric)
    assert all(goal.normalised > 0.97 for goal in held.active)
    # The step is that of the job; the peak lies between points of the curve, 2 % apart.
    pair = [curves(params, spec.experiment, spec.ideal) for params in (spec.before, result.params)]
    overshoot = values_at(step.problem, z[None], 4).hard[0, 1] * 8.0
    assert pair[1].overshoot.max() == pytest.approx(overshoot, rel=1e-9)
    np.testing.assert_allclose(
        pair[1].sensitivity.max(axis=1),
        np.asarray(result.margins["as run"].M_s[1])[np.searchsorted(spec.judged_at, spec.experiment.stiffness)],
        rtol=0.01,
    )
    parts = split(result)
    np.testing.assert_allclose(parts.whole**2, parts.motion**2 + parts.noise**2, rtol=1e-9)
    assert (parts.friction == 0.0).all()


def test_an_unstable_neighbour_is_no_slope(small: Job) -> None:
    """H_p one longer is unstable, H_u may not be changed."""
    space = TuneSpec.from_dict(small(tune={"free": {"lam": True, "Hp": True, "Hu": True}})).space
    for lost in (np.nan, np.inf):
        slope = Slope(0.9, np.array([0.1, 0.0, 0.0]), np.array([0.9, lost, 0.9, 0.9]))
        found = _per_parameter(space, slope, np.ones(3), {"Hp": 0.1, "Hu": 0.0})
        np.testing.assert_allclose(found, [0.1, np.nan, 0.0])
    assert [_signed(x) for x in found] == ["+0.100", "–", "0"]


@pytest.mark.slow
@in_float64
def test_another_structure_before_and_a_goal_that_nobody_meets(small: Job, tmp_path: Path) -> None:
    tune = {"starts": 2, "steps": 2, "free": {"lam": True, "Khat_s": True}}
    tables = {"baseline": {"disturbance_order": 2, "Q_p": 1e-3}, "goals": {"M_s": 1.01, "rms": 0.02}}
    job = small(tune={**tune, "diagonals": ["lam"]}, **tables)
    result, explaining = assess_and(study, run_search(TuneSpec.from_dict(job)))
    way: Future[None] = Future()
    way.set_result(None)
    write(result, explaining, tmp_path, way)
    assert not (tmp_path / "params.toml").exists()
    held = limits(result)
    assert {goal.goal for goal in held.active} == {"M_s", "rms"}
    assert np.isnan([goal.multiplier for goal in held.active]).all()
