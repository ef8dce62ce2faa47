"""The descent: it improves, holds its goals, survives a kill and a gradient that is not finite."""

from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from threading import Event
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import tuning.search.optimise
import tuning.search.run as run
from jaxmpc import Params, margins
from jaxmpc.files.errors import InputError
from tuning import TuneSpec, tune
from tuning.search.ahead import threads
from tuning.search.optimise import optimiser, rehearse, schedule
from tuning.search.run import run_search
from tuning.search.state import NAME, SearchState

Job = Callable[..., dict[str, Any]]


def descend(spec: TuneSpec, folder: Path | None = None) -> SearchState:
    """The only level of a linear job."""
    return run_search(spec, folder).steps[-1].state


def test_the_schedule_looks_first_then_softens_then_polishes() -> None:
    widths, rates, polish, _ = schedule(20, True, 0.1)
    assert (widths[0], rates[0]) == (1.0, 0.0)
    assert widths[1] == 8.0
    assert (np.diff(widths[1:polish]) < 0.0).all()
    assert (widths[1:polish] > 1.0).all()
    assert (widths[polish:] == 1.0).all()
    assert rates[1] == 0.1
    assert rates[polish] == pytest.approx(0.01)
    assert len(widths) == 21
    assert schedule(20, False, 0.1).polish == 1


def test_a_gradient_that_is_not_finite_moves_only_the_others() -> None:
    begin, update = optimiser()
    z = np.ones((2, 3))
    gradient = np.array([[1.0, 2.0, 3.0], [1.0, np.nan, 3.0]])
    memory = begin(jnp.asarray(z))
    moved, after, usable = update(z, memory, gradient, 0.1)
    assert usable.tolist() == [True, False]
    assert (np.asarray(moved[0]) != 1.0).all()
    np.testing.assert_array_equal(moved[1], 1.0)
    for old, new in zip(jax.tree.leaves(memory), jax.tree.leaves(after), strict=True):
        np.testing.assert_array_equal(new[1], old[1])


def test_a_descent_compiles_nothing_to_move_its_starts_that_was_rehearsed() -> None:
    optimiser.cache_clear()
    rehearse(2, 3)
    begin, update = optimiser()
    compiled = begin.__wrapped__, update.__wrapped__  # what they are beside the place where they run
    sizes = [each._cache_size() for each in compiled]
    z = np.ones((2, 3))
    moved, memory, _ = update(z, begin(z), z, schedule(20, False, 0.1).rates[1])
    update(np.asarray(moved), memory, z, schedule(20, False, 0.1).rates[2])
    assert [each._cache_size() for each in compiled] == sizes


def test_threads_that_it_is_given_may_go_on_when_a_search_is_over(monkeypatch: pytest.MonkeyPatch, small: Job) -> None:
    """What compiles there for the proof is not waited for."""
    found = run.Step("linear", SimpleNamespace(), SimpleNamespace(best=np.ones(1), closest=np.ones(1)))  # type: ignore[arg-type]
    monkeypatch.setattr(run, "problem_of", lambda *_, **__: None)
    monkeypatch.setattr(run, "screened", lambda *_: None)
    monkeypatch.setattr(run, "proposal", lambda *_: found)
    going, spec = Event(), TuneSpec.from_dict(small())
    with threads() as pool:
        late = pool.submit(going.wait, 10.0)
        assert run_search(spec, pool=pool).steps == [found]
        assert not late.done()
        going.set()
        assert pool.submit(int).result() == 0


@pytest.mark.slow
def test_a_feasible_start_is_improved(small: Job) -> None:
    state = descend(TuneSpec.from_dict(small(goals={"M_s": 6.0})))
    assert np.isfinite(state.incumbent[0])
    assert state.best.min() < 0.9 * state.score[0, 0]
    assert (np.diff(state.incumbent[: state.iteration]) <= 0.0).all()


def same(one: SearchState, other: SearchState) -> None:
    for field in fields(SearchState):
        for a, b in zip(*(jax.tree.leaves(getattr(state, field.name)) for state in (one, other)), strict=True):
            np.testing.assert_array_equal(a, b, err_msg=field.name)


@pytest.mark.slow
def test_a_killed_run_continues_to_the_same_bits(
    spec: TuneSpec, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, stop = descend(spec), 7
    monkeypatch.setattr(tuning.search.optimise, "SAVE_EVERY", 0.0)
    record = SearchState.record

    def killed(self: SearchState, *args: Any, **kwargs: Any) -> None:
        if self.iteration == stop:
            raise KeyboardInterrupt
        record(self, *args, **kwargs)

    with monkeypatch.context() as patch:
        patch.setattr(SearchState, "record", killed)
        with pytest.raises(KeyboardInterrupt):
            descend(spec, tmp_path)
    iterations = 0

    def counted(self: SearchState, *args: Any, **kwargs: Any) -> None:
        nonlocal iterations
        iterations += 1
        record(self, *args, **kwargs)

    monkeypatch.setattr(SearchState, "record", counted)
    same(descend(spec, tmp_path), whole)
    assert iterations == whole.iteration - stop


@pytest.mark.slow
def test_a_state_of_another_spec_or_a_damaged_one_is_refused(small: Job, tmp_path: Path) -> None:
    spec = TuneSpec.from_dict(small(tune={"steps": 1}))
    descend(spec, tmp_path)
    with pytest.raises(InputError, match="very spec"):
        descend(TuneSpec.from_dict(small(tune={"steps": 2})), tmp_path)
    state = tmp_path / NAME
    data = bytearray(state.read_bytes())
    data[100] ^= 1
    state.write_bytes(bytes(data))
    with pytest.raises(InputError, match="Remove it"):
        descend(spec, tmp_path)


def bar(result: Any) -> None:
    """The bar of the tuner: every goal held, a quarter of the text design's worst residual gone on unseen motion."""
    assert result.feasible, result.unmet()
    found = margins(result.params, [375.0, 810.0, 1900.0], ideal=True)
    assert (np.asarray(found.M_s) <= 2.0).all()
    assert float(result.params.K2) <= 100.0
    assert 1e-4 <= float(result.params.T_cl) <= 2e-2
    assert 1e-14 <= float(result.params.Q_x) <= 1e2
    np.testing.assert_array_equal(result.spec.params.Khat_s, Params.published("text").Khat_s)
    assert result.gain >= 0.25


@pytest.mark.slow
def test_a_short_run_meets_the_bar(small: Job) -> None:
    bar(tune(TuneSpec.from_dict(small(tune={"steps": 60, "seed": 2}))))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_default_job_meets_the_bar_on_twenty_unseen_seeds(seed: int) -> None:
    bar(tune(TuneSpec.from_dict({"tune": {"seed": seed}, "goals": {"ideal": True}})))
