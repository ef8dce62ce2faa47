"""The search: what runs first, orders, the front; on the arm at a size that compiles more than it runs."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from jaxmpc import Params
from jaxmpc.files.errors import InputError
from jaxmpc.loop.linear import HIGHEST_FORCE
from jaxmpc.metrics import Metrics
from jaxmpc.xla.precision import in_float64
from tuning import TuneSpec, pareto
from tuning.objective.loss import Values, run_cells, value_alone
from tuning.objective.problem import over_starts, problem_of, training
from tuning.proof.result import assess
from tuning.proof.sensitivities import sensitivities, vector_of
from tuning.search.constraints import programs_of
from tuning.search.front import handed_on, table
from tuning.search.run import SAME, Step, proposed, run_search
from tuning.search.state import NAME, SearchState, check_states, load, save

Job = Callable[..., dict[str, Any]]


@pytest.fixture
def on_the_arm(small: Job) -> Callable[..., TuneSpec]:
    def job(**tables: Any) -> TuneSpec:
        scenarios = {"rhythms": ["own", "premature"], "friction": 0.3, "mass": 0.1}
        tune = {"starts": 2, "steps": 5, "train_seeds": [0, 1], "heldout_seeds": [1000], "duration": 3.2, "settle": 0.5}
        base: dict[str, Any] = {"experiment": {"published": "table-1-wam", "duration": 4.0, "settle": 0.5}}
        base |= {"scenarios": scenarios, "goals": {"M_s": 6.0, "ideal": False, "soft": {"rms_ratio": 0.9}}}
        return TuneSpec.from_dict(small(**{**base, **tables, "tune": {**tune, **tables.get("tune", {})}}))

    return job


def state_of(best: list[float], z: np.ndarray, hard: np.ndarray) -> SearchState:
    """A state after one iteration at which each start stood where it is."""
    state = SearchState.new(z, (), 1, (hard.shape[1], 1))
    state.best, state.best_z, state.path[0], state.hard[0], state.iteration = np.array(best), z, z, hard, 1
    return state


def test_what_runs_first_is_the_best_that_differs(spec: TuneSpec) -> None:
    z = np.random.default_rng(0).standard_normal((5, spec.space.size))
    z[3] = z[1] + 0.1 * SAME
    state = state_of([3.0, 1.0, np.inf, 1.1, 2.0], z, np.ones((5, 1)))
    state.closest = np.array([0.7, 0.9, 1.5, 0.8, 0.95])
    chosen = proposed(spec, state, 5)
    np.testing.assert_allclose(chosen, [spec.space.encode(spec.params), z[1], z[4], z[0], z[2]])


@pytest.mark.parametrize(
    ("found", "closest", "wins"),
    [([np.inf, np.inf], [1.5, 1.1], 2), ([0.8, 0.9], [1.0, 0.7], 1), ([np.inf, 0.9], [1.1, 1.0], 2)],
)
def test_of_several_orders_the_one_goes_on_that_came_closest_where_none_holds_its_goals(
    found: list[float], closest: list[float], wins: int, spec: TuneSpec, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first one did, and a goal was told to be missed by the point that came closest."""

    def made(job: TuneSpec, *_: Any) -> Step:
        which = int(job.params.disturbance_order) - 1
        state = state_of([found[which]], np.zeros((1, job.space.size)), np.ones((1, 1)))
        state.closest = np.array([closest[which]])
        return Step("linear", None, state)  # type: ignore[arg-type]  # of which nothing is asked

    for name, replaced in (("problem_of", lambda *_, **__: None), ("screened", lambda *_: None), ("proposal", made)):
        monkeypatch.setattr(f"tuning.search.run.{name}", replaced)
    several = msgspec.structs.replace(spec, tune=msgspec.structs.replace(spec.tune, orders=(1, 2)))
    history = run_search(several)
    assert history.spec.params.disturbance_order == wins
    assert history.orders == dict(zip((1, 2), found, strict=True))


def test_points_of_a_front_take_over_what_fits_their_limits() -> None:
    """M_s ≤ 3, 2, 1.5: the middle point found the best, the first may take it, the last may not."""
    z = np.arange(3.0)[:, None]
    asked = np.array([[3.0, 6.0], [2.0, 6.0], [1.5, 6.0]])
    reached = np.array([[2.9, 7.0], [1.9, 6.5], [1.4, 6.1]])
    hard = np.stack([reached[:, 0] / asked[:, 0], asked[:, 1] / reached[:, 1]], axis=1)
    state = state_of([0.9, 0.7, 0.8], z, hard)
    np.testing.assert_array_equal(handed_on(state, asked, np.array([False, True])).ravel(), [1.0, 1.0, 2.0])


def test_a_start_that_left_1_kn_holds_nothing_whatever_its_goals_say() -> None:
    """Of three starts at the same goals one left 1 kN on one axis of one scenario."""
    state = SearchState.new(np.zeros((3, 1)), (), 1, (1, 1))
    cells = Metrics(*(np.full((3, 2, 2, 3), 0.1) for _ in Metrics._fields))
    cells.peak_error[1, 1, 0, 2] = HIGHEST_FORCE
    one = np.ones(3)
    seen = Values(one, one, 0.5 * one, one, 0 * one, np.ones((3, 2)), 0.9 * np.ones((3, 1)), np.ones((3, 1)), cells)
    state.record(seen, True, 1e-4)
    assert state.best.tolist() == [0.5, np.inf, 0.5]
    assert state.closest.tolist() == [0.9, np.inf, 0.9]


def test_patience_begins_with_polishing() -> None:
    """Whole horizons have that many iterations, however long ago soft ones gained."""
    state = state_of([1.0], np.zeros((1, 1)), np.ones((1, 1)))
    state.iteration, state.gained = 100, 10
    assert [state.stalled(30, since) for since in (0, 69, 70, 90)] == [True, True, False, False]
    state.best = np.array([np.inf])
    assert not state.stalled(30, 0)


@pytest.mark.parametrize("name", ["state.npz", "state-spectra.npz", "state-order-2.npz"])
def test_a_folder_with_the_state_of_another_job_is_refused_whatever_its_name(
    spec: TuneSpec, tmp_path: Path, name: str
) -> None:
    own = [spec.with_order(order).digest for order in (1, 2)]
    state = state_of([1.0], np.zeros((1, 1)), np.ones((1, 1)))
    save(tmp_path, own[1], state, name)
    check_states(tmp_path, own)
    with pytest.raises(InputError, match="very spec"):
        check_states(tmp_path, [spec.digest])
    (tmp_path / name).write_bytes(b"damaged")
    check_states(tmp_path, [spec.digest])


def test_a_state_that_other_sources_have_left_is_refused(
    spec: TuneSpec, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What a goal means may have changed between two of them: a search would go on from numbers of both."""
    state = state_of([1.0], np.zeros((1, 1)), np.ones((1, 1)))
    save(tmp_path, spec.digest, state)
    load(tmp_path, spec.digest, state)
    monkeypatch.setattr("tuning.search.state.source_of", lambda package: f"{package}, changed")
    with pytest.raises(InputError, match=f"{tmp_path}.*this very program"):
        check_states(tmp_path, [spec.digest])
    with pytest.raises(InputError, match="this very program"):
        load(tmp_path, spec.digest, state)


def test_a_state_of_the_largest_search_is_read_again(tmp_path: Path) -> None:
    state = SearchState.new(np.zeros((1024, 8)), (), 601, (4, 1))
    save(tmp_path, "key", state)
    assert (tmp_path / NAME).stat().st_size > 64 * 2**20
    np.testing.assert_array_equal(load(tmp_path, "key", state).path, state.path)


def test_a_front_of_no_limits_is_refused_before_anything_is_tuned(spec: TuneSpec, tmp_path: Path) -> None:
    """It ended in a ValueError of its figure, behind the whole search."""
    with pytest.raises(InputError, match=r"^pareto = empty: must be .* limits"):
        pareto(spec, tmp_path / "out", z=spec.space.encode(spec.params))
    assert not (tmp_path / "out").exists()


@in_float64
def test_orders_ask_for_a_q_p_of_their_own(spec: TuneSpec) -> None:
    second = spec.with_order(2)
    assert second.params.disturbance_order == 2
    assert second.before == spec.params
    (axis,) = (axis for axis in second.space.axes if axis.name == "Q_p")
    assert axis.low < float(second.params.Q_p) < axis.high


@pytest.mark.oracle
def test_a_search_whose_runs_are_all_lost_finds_nothing(small: Job) -> None:
    """The ideal loop is stable, and its margins are the goals; what runs is sampled and is not: it reaches 1e120 N."""
    tune = {"starts": 2, "steps": 2, "heldout_seeds": [1000], "free": {"Khat_s": [290.0, 310.0]}}
    tables = {"experiment": {"damping": "sampled"}, "params": {"K2": 250.0, "Khat_s": 300.0}}
    result = assess(run_search(TuneSpec.from_dict(small(tune=tune, goals={"M_s": 50.0}, **tables))))
    assert not result.met
    assert result.unmet().startswith("no point was found that has a score")


@pytest.mark.oracle
def test_a_front_from_elsewhere_does_not_go_on_from_these_states(small: Job, tmp_path: Path) -> None:
    spec = TuneSpec.from_dict(small(tune={"steps": 1}, pareto={"M_s": [6.0, 5.0]}))
    z = spec.space.encode(spec.params)
    pareto(spec, f"{tmp_path}/front", z=z)  # makes it, as `tune` does
    with pytest.raises(InputError, match="-o"):
        pareto(spec, tmp_path / "front", z=z + 0.01)


@pytest.mark.slow
def test_spectra_propose_and_the_arm_decides(on_the_arm: Callable[..., TuneSpec]) -> None:
    spec = on_the_arm(tune={"mapping": 3, "orders": [1, 2]})
    with_float64 = in_float64(lambda: assess(run_search(spec)))
    result = with_float64()
    assert [step.name for step in result.steps] == ["spectra", "mapping"]
    assert set(result.orders) == {1, 2}
    assert result.feasible, result.unmet()
    assert result.heldout.rms.shape == (2, 1, 3, 3)
    # Spectra that are corrected at a point say there what the arm did: the shares of each tissue's worst, and margins.
    found, z = sensitivities(result), vector_of(result)
    worst = result.steps[1].problem.evaluate(np.tile(z, (4, 1))).score[0]
    assert found.values[0].max() == pytest.approx(worst, rel=0.1)
    assert np.isfinite(found.slopes).all()


@pytest.mark.slow
@in_float64
def test_what_was_compiled_beside_the_spectra_is_what_runs(on_the_arm: Callable[..., TuneSpec]) -> None:
    over_starts.cache_clear()
    programs_of.cache_clear()
    spec = on_the_arm(tune={"mapping": 2})
    mapping = run_search(spec).steps[-1]
    assert mapping.spectra is not None
    assert over_starts(value_alone, mapping.problem.structure).programs == 1
    assert over_starts(run_cells, mapping.spectra.structure).programs == 1
    assert [each.programs for each in programs_of(mapping.spectra.structure)] == [1, 1]


@pytest.mark.slow
@in_float64
def test_spectra_agree_with_runs_on_the_residual(on_the_arm: Callable[..., TuneSpec]) -> None:
    """To 15 %: they know no friction that answers to the residual motion, which is up to a tenth here.

    Nor do they know the joints' limits, which this controller would meet.
    """
    unlimited = {"joint_torque_limit": [0.0] * 4, "torque_step_limit": [0.0] * 4}
    table = {"published": "table-1-wam", "duration": 4.0, "settle": 0.5, "arm": unlimited}
    spec = on_the_arm(
        experiment=table, params={"K2": 40.0, "T_cl": 2e-4, "Khat_s": 800.0, "Q_p": 1.5}, goals={"soft": {"rms": 0.05}}
    )
    met = training(spec, (0,))
    z = np.tile(spec.space.encode(spec.params), (2, 1))
    coarse, fine = (problem_of(spec, met, spectral).evaluate(z).cells.rms[0] for spectral in (True, False))
    np.testing.assert_allclose(coarse, fine, rtol=0.15)


@pytest.mark.slow
def test_a_front_falls_with_its_limits(small: Job) -> None:
    spec = TuneSpec.from_dict(small(tune={"steps": 60}, goals={"M_s": 3.0}, pareto={"M_s": [1.7, 2.0, 3.0]}))
    front = pareto(spec)
    assert front.limits["M_s"].tolist() == [3.0, 2.0, 1.7]
    assert (np.diff(front.score) >= 0.0).all(), "a tighter limit cannot give a lower residual"
    assert (front.hard[:, 0] <= front.limits["M_s"]).all()
    assert all(isinstance(params, Params) for params in front.params)
    assert table(front).count("\n") == 4
