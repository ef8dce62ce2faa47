"""The whole objective: gradients in both modes, diagonals, the way back from an unstable loop."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmpc import margins
from jaxmpc.files.errors import InputError
from jaxmpc.loop.linear import HIGHEST_FORCE
from jaxmpc.metrics import Metrics
from jaxmpc.quantities import METRICS
from jaxmpc.xla.precision import in_float64
from jaxmpc.xla.shared import kind_of
from tuning import TuneSpec
from tuning.job.goals import margin_goals
from tuning.objective.evaluated import HEADROOM, PENALTY, visible_goals, visible_soft
from tuning.objective.loss import Values, value_alone
from tuning.objective.measures import measure
from tuning.objective.problem import Problem, _held, problem_of, training
from tuning.search.optimise import optimiser

UNLIMITED = {"joint_torque_limit": [0.0] * 4, "torque_step_limit": [0.0] * 4}
Job = Callable[..., dict[str, Any]]
QUIET = {"sensor": {"lsb": [0.0, 0.0, 0.0]}, "reference": {"z": []}}
EFFORT = {"effort": 3.0}
"""Of more than one test, which one program then serves."""
STEP = 1e-3


def problem(spec: TuneSpec) -> Problem:
    return problem_of(spec, training(spec, spec.tune.train_seeds))


def central(values: np.ndarray) -> np.ndarray:
    """Five-point derivative from values at −2, −1, 1 and 2 steps, along the last dimension."""
    weights = np.array([1.0, -8.0, 8.0, -1.0]) / (12.0 * STEP)
    slope: np.ndarray = values @ weights
    return slope


def around(z: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Four points per direction, flattened to rows."""
    points = z + np.array([-2.0, -1.0, 1.0, 2.0])[None, :, None] * STEP * directions[:, None, :]
    rows: np.ndarray = points.reshape(-1, len(z))
    return rows


def in_eights(function: Callable[[np.ndarray], np.ndarray], rows: np.ndarray) -> np.ndarray:
    """As many rows at a time as a tuning run has starts: the same program."""
    return np.concatenate([function(part) for part in np.split(rows, len(rows) // 8)])


@pytest.mark.oracle
@pytest.mark.parametrize("K2", [10.0, 60.0])
def test_reverse_gradient_is_the_central_difference_for_every_parameter(small: Job, K2: float) -> None:
    spec = TuneSpec.from_dict(small(experiment=QUIET, params={"K2": K2, "Q_x": 1e-3}, goals=EFFORT))
    see, space = problem(spec).differentiate, spec.space
    # Off the kinks of the soft mask, which whole horizons can stand on.
    z = space.encode(spec.params) + 0.07
    losses = in_eights(lambda rows: see(rows, 3.0).loss, around(z, np.eye(space.size)))
    expected = central(losses.reshape(space.size, 4))
    found = see(np.tile(z, (8, 1)), 3.0).gradient[0]
    assert (np.abs(expected) > 1e-8).all()
    np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max(), rtol=0)


@pytest.mark.parametrize(
    "tables",
    [
        {"experiment": QUIET},
        {"experiment": {"published": "table-1-wam", "stiffness": [375.0, 1900.0], "duration": 3.0, "settle": 2.0}},
    ],
    ids=["linear", "spectra of the arm"],
)
@in_float64
def test_programs_can_be_compiled_before_spectra_are_read_and_ratios_have_a_base(
    small: Job, tables: dict[str, Any]
) -> None:
    goals = {"ideal": False, "soft": {"rms_ratio": 0.9}}
    tune = {"train_seeds": [0, 1], "duration": 3.0, "settle": 2.0}
    spec = TuneSpec.from_dict(small(**tables, goals=goals, tune=tune))
    z, begun = np.zeros((8, spec.space.size)), list[Problem]()
    met = training(spec, spec.tune.train_seeds)
    whole = problem_of(spec, met, spectral=spec.on_arm, begun=begun.append)
    (first,) = begun
    assert kind_of(first._arguments(z, 1.0)) == kind_of(whole._arguments(z, 1.0))
    assert first.structure == whole.structure
    if spec.on_arm:
        assert not np.any(first.data.spectra.heart)
        assert np.any(whole.data.spectra.heart)
    assert np.all(first.data.reference.rms == 1.0)
    assert np.all(whole.data.reference.rms < 1.0)


@pytest.mark.oracle
def test_an_engine_without_reverse_mode_gives_the_same_gradient(small: Job) -> None:
    spec = TuneSpec.from_dict(small(experiment=QUIET, tune={"duration": 0.4, "settle": 0.1}, goals=EFFORT))
    scanned = problem(spec)
    inside = scanned._replace(
        structure=scanned.structure._replace(world=scanned.structure.world._replace(engine="kernel"))
    )
    z = np.tile(spec.space.encode(spec.params) + 0.07, (8, 1)) * np.linspace(0.99, 1.01, 8)[:, None]
    wanted, found = (each.differentiate(z, 3.0) for each in (scanned, inside))
    np.testing.assert_allclose(found.loss, wanted.loss, rtol=1e-9)
    np.testing.assert_allclose(found.gradient, wanted.gradient, rtol=0, atol=1e-7 * np.abs(wanted.gradient).max())


@pytest.mark.oracle
def test_forward_mode_agrees_with_every_goal_violated(small: Job) -> None:
    goals = {
        "M_s": 1.1,
        "gain_margin_db": 60.0,
        "gain_reduction_db": 60.0,
        "phase_margin_deg": 80.0,
        "delay_margin_s": 0.1,
        "ideal": False,
    }
    spec = TuneSpec.from_dict(small(experiment=QUIET, goals=goals, tune={"duration": 0.4, "settle": 0.1}))
    data, kind = problem(spec)
    data = data._replace(margins={name: jnp.broadcast_to(limit, (4,)) for name, limit in data.margins.items()})
    direction = np.random.default_rng(0).standard_normal(spec.space.size)
    forward = jax.jit(
        lambda z: jax.jvp(lambda z: value_alone(z, data, 3.0, kind).loss, (z,), (jnp.tile(direction, (4, 1)),))
    )
    z = spec.space.encode(spec.params) + 0.07
    expected = central(np.asarray(forward(jnp.asarray(around(z, direction[None])))[0]))
    found = forward(jnp.tile(z, (4, 1)))[1]
    np.testing.assert_allclose(found, expected, rtol=1e-6)


@pytest.mark.oracle
def test_full_diagonals_have_a_gradient_per_entry(small: Job) -> None:
    free = {"lam": True, "delta": True, "Khat_s": True}
    tune = {"free": free, "diagonals": ["lam", "delta"], "duration": 0.4, "settle": 0.1}
    spec = TuneSpec.from_dict(small(experiment={**QUIET, "stiffness": [810.0]}, tune=tune))
    see, space = problem(spec).differentiate, spec.space
    z = space.encode(spec.params)
    chosen = [0, 1, 4, 16, 20, 30, 40, 80]
    losses = in_eights(lambda rows: see(rows, 1.0).loss, around(z, np.eye(space.size)[chosen]))
    found = see(np.tile(z, (8, 1)), 1.0).gradient[0]
    np.testing.assert_allclose(found[chosen], central(losses.reshape(-1, 4)), atol=1e-6 * np.abs(found).max(), rtol=0)
    # λ acts up to H_u = 5 and δ up to H_p = 30: what lies beyond must be without effect, what lies inside not.
    names = np.asarray(space.names)
    dead = {name for name, slope in zip(names, found, strict=True) if slope == 0.0}
    assert dead == {f"lam[{i}]" for i in range(6, 17)} | {f"delta[{i}]" for i in range(31, 65)}


CREST = METRICS["peak_to_peak"].crest
SOFT = {"chatter": 0.6, "effort_z": 2.0, "peak_to_peak": 0.35}
HARD = {"chatter": 0.5, "effort_x": 1.0, "peak_to_peak": 0.5}


def test_a_level_without_time_sees_all_but_peaks_and_has_stand_ins_for_them() -> None:
    def level(spectra: Any, **soft: float) -> Any:
        return SimpleNamespace(spectra=spectra, correction=None, soft=soft)

    assert visible_goals(HARD, level(None)) == tuple(HARD)
    assert visible_goals(HARD, level("some")) == ("chatter", "effort_x")
    assert visible_soft(level(None, **SOFT)) == SOFT
    assert visible_soft(level("some", **SOFT)) == {
        "chatter": 0.6,
        "effort_z": 2.0,
        "rms": 0.35 / CREST,
    }
    assert visible_soft(level("some", peak_to_peak_ratio=0.7)) == {"rms_ratio": 0.7}
    assert visible_soft(level("some", peak_to_peak_ratio=0.7, rms_x=0.1)) == {"rms_x": 0.1}, "a residual leads already"


@pytest.mark.slow
def test_effort_and_chatter_are_goals_from_spectra_as_in_time(small: Job) -> None:
    """With the text design, which misses both."""
    experiment = {"published": "table-1-wam", "duration": 6.0, "settle": 2.0}
    goals = {"M_s": 6.0, **HARD, "ideal": False, "soft": SOFT}
    spec = TuneSpec.from_dict(small(experiment=experiment, goals=goals))
    problem, space = problem_of(spec, training(spec, spec.tune.train_seeds), spectral=True), spec.space
    assert problem.hard_goals == ("chatter", "effort_x")
    assert problem.soft_goals == ("chatter", "effort_z", "rms")
    # Off the kinks of the soft mask, which whole horizons can stand on.
    z = space.encode(spec.params) + 0.07
    found = problem.differentiate(np.tile(z, (8, 1)), 3.0)
    chatter, effort, rms = (
        np.asarray(field[0]) for field in (found.cells.chatter, found.cells.effort, found.cells.rms)
    )
    np.testing.assert_allclose(found.hard[0, 1:], [chatter.max() / 0.5, effort[..., 0].max() / 1.0])
    expected = [chatter.max() / 0.6, effort[..., 2].max() / 2.0, rms.max() * CREST / 0.35]
    np.testing.assert_allclose(found.soft[0], expected)
    missed = sum(1.0 - 1.0 / value + HEADROOM for value in found.hard[0, 1:])
    assert float(found.loss[0]) == pytest.approx(float(np.log(found.score[0])) + PENALTY * missed)
    losses = in_eights(lambda rows: problem.differentiate(rows, 3.0).loss, around(z, np.eye(space.size)))
    slope = central(losses.reshape(space.size, 4))
    np.testing.assert_allclose(found.gradient[0], slope, atol=1e-6 * np.abs(slope).max(), rtol=0)


@pytest.mark.slow
@in_float64
def test_spectra_and_runs_agree_on_effort_and_chatter(small: Job) -> None:
    """To 5 %: noise makes nearly all of both, and that the linear loop knows to 3 %. It knows no limits of joints."""
    tune = {"starts": 2, "duration": 6.0, "settle": 2.5}
    params = {"K2": 40.0, "T_cl": 2e-4, "Khat_s": 800.0, "Q_p": 1.5}
    spec = TuneSpec.from_dict(
        small(
            experiment={"published": "table-1-wam", "arm": UNLIMITED}, params=params, tune=tune, goals={"ideal": False}
        )
    )
    both = (problem_of(spec, training(spec, (0,)), spectral) for spectral in (True, False))
    coarse, fine = (measure(spec.params, one.data, one.structure) for one in both)
    np.testing.assert_allclose(coarse.chatter, fine.chatter, rtol=0.05)
    np.testing.assert_allclose(coarse.effort, fine.effort, rtol=0.05)


@pytest.mark.oracle
def test_a_start_that_stands_still_has_a_slope(small: Job) -> None:
    """Unstable, it stands still, so that its effort is 0."""
    spec = TuneSpec.from_dict(small(params={"Khat_s": 200.0}, goals=EFFORT))
    values = problem(spec).differentiate(np.tile(spec.space.encode(spec.params), (8, 1)), 1.0)
    assert np.isposinf(values.M_s[0, -1])
    assert np.isfinite(values.gradient).all()


def test_a_ratio_to_what_was_lost_everywhere_is_refused(small: Job) -> None:
    """Every controller would be as good as any other; lost on one tissue, it leaves the others."""
    lost = {"baseline": {"published": "text", "Khat_s": 200.0}}

    def reference(stiffness: list[float], soft: str) -> np.ndarray:
        tables = small(experiment={**QUIET, "stiffness": stiffness}, goals={"soft": {soft: 0.5}}, **lost)
        return np.asarray(problem(TuneSpec.from_dict(tables)).data.reference.rms)

    with pytest.raises(InputError, match="lost in every run"):
        reference([1900.0], "rms_ratio")
    np.testing.assert_array_equal(reference([1900.0], "rms"), 1.0)
    known = np.isfinite(reference([375.0, 1900.0], "rms_ratio"))
    np.testing.assert_array_equal(known.all(axis=(1, 2)), [True, False])
    assert not known[1].any()


@pytest.mark.slow
def test_an_unstable_start_is_led_to_stability(small: Job) -> None:
    spec = TuneSpec.from_dict(small(params={"Khat_s": 200.0}))
    see = problem(spec).differentiate
    begin, update = optimiser()
    z = np.tile(spec.space.encode(spec.params), (8, 1))
    memory = begin(jnp.asarray(z))
    values: Values = see(z, 1.0)
    assert np.isposinf(values.M_s[0, -1])
    assert np.isnan(values.worst[0])
    assert np.isfinite(values.gradient).all()
    assert np.abs(values.gradient[0]).max() > 0.0
    for _ in range(40):
        z, memory, usable = update(z, memory, values.gradient, 0.15)
        assert np.asarray(usable).all()
        values = see(np.asarray(z), 1.0)
    assert np.isfinite(values.M_s).all()
    assert np.isfinite(values.worst).all()


@pytest.mark.slow
def test_goals_keep_their_names_through_the_compiled_program(small: Job) -> None:
    """In whatever order a job writes them: columns of the histories are labelled by `margin_goals`."""
    goals = {"phase_margin_deg": 20.0, "M_s": 3.0, "gain_margin_db": 5.0, "delay_margin_s": 1e-3, "ideal": False}
    spec = TuneSpec.from_dict(small(goals=goals, tune={"duration": 0.4, "settle": 0.1}, experiment=QUIET))
    seen = problem(spec).differentiate(np.tile(spec.space.encode(spec.params), (2, 1)), 1.0).hard[0]
    found = margins(spec.params, spec.judged_at)
    expected = np.asarray(margin_goals(found, spec.margin_goals).normalised).max(axis=1)
    np.testing.assert_allclose(seen, expected, rtol=0.02)


def test_a_baseline_that_is_lost_on_one_axis_is_lost_in_that_run(spec: TuneSpec) -> None:
    """Whatever lasts there is better, on its other axes too, which left no newton."""
    cells = Metrics(*(np.full((3, 2, 3), 0.1) for _ in Metrics._fields))
    cells.peak_error[1, 0, 2] = HIGHEST_FORCE
    cells.peak_error[2, 1, 0] = np.nan
    known = np.isfinite(np.asarray(_held(spec, cells).rms))
    lost = np.zeros((3, 2, 3), bool)
    lost[1, 0], lost[2, 1] = True, True
    np.testing.assert_array_equal(known, ~lost)
