"""A controller's own filters of velocity and force: in place of the experiment's, wherever a loop is judged or run."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import msgspec
import numpy as np
import pytest
import scipy.linalg

from deploy.controller.recomputed_margins import differences
from jaxmpc import Experiment, InputError, Params, design, evaluate, margins
from jaxmpc.evaluation import _run
from jaxmpc.export.freezing import freeze_controller
from jaxmpc.law.force_filter import ForceFilter
from jaxmpc.law.ops import FLOATS
from jaxmpc.law.scalar import declared
from jaxmpc.stability import _block
from jaxmpc.stability.family import family_margins
from jaxmpc.stability.loop import contacts_between
from jaxmpc.stability.presliding import presliding_peak
from jaxmpc.synthesis import _design
from jaxmpc.synthesis.force_filter import cutoff_of, force_filter
from jaxmpc.synthesis.params import by_structure

TISSUES = (375.0, 810.0, 1900.0)
QUIET: dict[str, Any] = {
    "damping": "sampled",
    "stiffness": list(TISSUES),
    "duration": 0.6,
    "settle": 0.2,
    "sensor": {"lsb": [0.0, 0.0, 0.0]},
    "reference": {"z": -1.0},
}
"""Without quantisers, which no small difference sees."""
OTHER = Experiment.from_dict({**QUIET, "velocity_lowpass": 320.0, "sensor": {**QUIET["sensor"], "kalman": 15.0}})
"""With the filters that `OWN` brings."""
PLAIN = Experiment.from_dict(QUIET)
CAUTIOUS = Params.published("cautious")
OWN = dataclasses.replace(CAUTIOUS, velocity_cutoff=320.0, force_cutoff=OTHER.force_cutoff)

SLOWER = dataclasses.replace(OWN, velocity_cutoff=90.0, force_cutoff=600.0)


def same(found: Any, expected: Any, rtol: float = 1e-12) -> None:
    for ours, theirs in zip(*map(jax.tree.leaves, (found, expected)), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=rtol)


@pytest.mark.parametrize("ratio", [1e-3, 0.3, 100.0, 2e5])
def test_the_closed_form_answers_the_riccati_equation(ratio: float) -> None:
    """Scipy's, for a rate that changes by so much per sample over the noise [1/s]; to what its own digits allow."""
    T_s = 1e-3
    A, C = np.array([[1.0, T_s], [0.0, 1.0]]), np.array([[1.0, 0.0]])
    P = scipy.linalg.solve_discrete_are(A.T, C.T, np.diag([0.0, ratio**2]), np.eye(1))
    found = force_filter(np.sqrt(ratio / T_s), T_s, FLOATS)
    assert found is not None
    np.testing.assert_allclose(found[1:], (P @ C.T / (C @ P @ C.T + 1.0)).ravel(), rtol=1e-8)
    # The poles of what it predicts lie at ω₀, 45° from the real axis, where samples are many.
    poles = np.log(np.linalg.eigvals(A - A @ np.array(found[1:])[:, None] @ C)) / T_s
    if ratio < 1.0:
        np.testing.assert_allclose(np.abs(poles), np.sqrt(ratio / T_s), rtol=1e-2)
        np.testing.assert_allclose(poles.real, -np.abs(poles.imag), rtol=2e-2)


@pytest.mark.parametrize("T_s", [1e-4, 1e-3, 0.1])
def test_a_filter_that_nothing_slows_is_one_that_can_be_frozen(T_s: float) -> None:
    """Of the quickest change and no noise: ŷ is y, and the rate its difference, to 1e-6; yet a share below 1."""
    found = force_filter(cutoff_of(1e6, 0.0, T_s), T_s, FLOATS)
    assert found is not None
    assert found.force_gain < declared(ForceFilter)["force_gain"].below
    assert found.force_gain == pytest.approx(1.0, abs=1e-11)
    assert found.rate_gain * T_s == pytest.approx(1.0, rel=1e-5)


@pytest.mark.oracle
def test_margins_are_those_of_an_experiment_with_the_same_filters() -> None:
    expected = margins(CAUTIOUS, TISSUES, path=OTHER.loop_path())
    same(margins(OWN, TISSUES, path=PLAIN.loop_path()), expected)
    assert np.all(np.abs(margins(SLOWER, TISSUES).M_s / expected.M_s - 1.0) > 0.01)


@pytest.mark.oracle
def test_each_of_a_batch_has_its_own() -> None:
    both = Params.stack([OWN, SLOWER])
    together = margins(both, TISSUES)
    for row in range(2):
        same(jax.tree.map(lambda field, row=row: field[row], together), margins(both[row], TISSUES))
    run = evaluate(both, PLAIN)
    same(jax.tree.map(lambda field: field[1], run.metrics), evaluate(both[1], PLAIN).metrics, 1e-9)


@pytest.mark.oracle
def test_an_evaluation_runs_the_loop_that_it_judges() -> None:
    found, expected = evaluate(OWN, PLAIN), evaluate(CAUTIOUS, OTHER)
    same((found.metrics, found.margins), (expected.metrics, expected.margins))
    assert np.all(np.abs(evaluate(SLOWER, PLAIN).metrics.chatter / found.metrics.chatter - 1.0) > 0.01)


def with_slopes(function: Callable[..., Any], *modes: Callable[..., Any]) -> Callable[..., Any]:
    """One program for the value and, in each mode, the slopes by the first argument."""

    def twice(*at: Any) -> tuple[Any, Any]:
        value = function(*at)
        return value, value

    def program(*at: Any) -> tuple[Any, ...]:
        found = [mode(twice, has_aux=True)(*at) for mode in modes]
        return found[0][1], *(slopes for slopes, _ in found)

    return jax.jit(program)


def differences_of(program: Callable[[Any], Any], at: np.ndarray) -> np.ndarray:
    """Slopes of the value that a program gives, by central differences of fourth order."""
    steps = 1e-4 * np.eye(len(at))
    weighted = [(1.0, -2.0), (-8.0, -1.0), (8.0, 1.0), (-1.0, 2.0)]
    found = [sum(w * np.asarray(program(at + k * step)[0]) for w, k in weighted) / 12e-4 for step in steps]
    return np.stack(found, axis=-1)


def filtered(x: Any) -> Params:
    """The controller at logarithms of its cut-offs."""
    return dataclasses.replace(CAUTIOUS, velocity_cutoff=jnp.exp(x[0]), force_cutoff=jnp.exp(x[1]))


LOGARITHMS = np.log([250.0, 700.0])


@pytest.mark.oracle
def test_all_margins_have_slopes_in_both_modes() -> None:
    """On a stiff tissue, where each moves; the peak at 810 N/m too."""

    def judged(x: Any, K_s: Any) -> Any:
        return jnp.log(jnp.stack(margins(filtered(x), K_s)[:5]))

    program = with_slopes(judged, jax.jacrev, jax.jacfwd)
    for K_s, rows, least in ((810.0, slice(1), 1e-3), (1600.0, slice(5), 1e-5)):
        _, back, ahead = (np.asarray(found)[rows] for found in program(LOGARITHMS, K_s))
        expected = differences_of(lambda x, K_s=K_s: program(x, K_s), LOGARITHMS)[rows]
        assert (np.abs(expected) > least).all()
        np.testing.assert_allclose(back, expected, rtol=1e-4)
        np.testing.assert_allclose(ahead, back, rtol=1e-8)


@pytest.mark.oracle
def test_residual_and_chatter_of_a_run_have_slopes() -> None:
    at_810 = msgspec.structs.replace(PLAIN, stiffness=(810.0,), duration=0.4)

    def run(x: Any) -> Any:
        found = evaluate(filtered(x), at_810).metrics
        return 1e3 * jnp.sum(found.rms) + jnp.sum(found.chatter)

    program = with_slopes(run, jax.jacrev)
    expected = differences_of(program, LOGARITHMS)
    assert (np.abs(expected) > 1e-3).all()
    np.testing.assert_allclose(program(LOGARITHMS)[1], expected, rtol=1e-4)


def test_other_numbers_compile_nothing() -> None:
    def programs() -> list[int]:
        return [each.programs for each in (_design, _block, contacts_between, _run)]

    evaluate(OWN, PLAIN)
    before = programs()
    evaluate(dataclasses.replace(OWN, velocity_cutoff=77.0, force_cutoff=456.0), PLAIN)
    assert programs() == before


@pytest.mark.oracle
def test_a_family_has_one_filter_for_all_its_gains() -> None:
    own = {"velocity_cutoff": 320.0, "force_cutoff": OWN.force_cutoff}
    family = dataclasses.replace(Params.published("family"), **own)
    arguments = np.array([375.0, 900.0]), np.array([0.94, 1.06])
    expected = family_margins(Params.published("family"), *arguments, OTHER.loop_path())
    same(family_margins(family, *arguments, PLAIN.loop_path()), expected, 1e-9)
    knots = [{**family.knots[0].to_dict(), "force_cutoff": 300.0}]
    with pytest.raises(InputError, match=r"knots\.force_cutoff"):
        Params.from_dict({"listening": {"stiffness": [375.0]}, "knots": knots})


@pytest.mark.oracle
def test_sticking_joints_meet_the_same_filters() -> None:
    expected = presliding_peak(CAUTIOUS, TISSUES, [40.0], OTHER.loop_path())
    same(presliding_peak(OWN, TISSUES, [40.0], PLAIN.loop_path()), expected, 1e-9)


def test_a_frozen_controller_carries_them(tmp_path: Path) -> None:
    frozen = freeze_controller(tmp_path / "c.npz", OWN, PLAIN, {"M_s": 3.0}, ideal=False)
    assert frozen.loop.velocity_cutoff == 320.0
    same(frozen.gains.force_filter, OTHER.loop_path().force_filter)
    rows = {row["stiffness"]: row["M_s"] for row in frozen.margins}
    same(np.array([rows[K_s] for K_s in TISSUES]), margins(CAUTIOUS, TISSUES, path=OTHER.loop_path()).M_s, 1e-9)
    # Computed again from what the file has, by another way.
    assert differences(frozen) == []
    assert Params.from_dict(frozen.params).to_dict() == OWN.to_dict()


def test_without_them_nothing_is_said_of_them() -> None:
    assert not {"velocity_cutoff", "force_cutoff"} & {
        *CAUTIOUS.to_dict(),
        *CAUTIOUS.with_columns({"K2": [1.0]}).numbers,
    }
    assert jax.tree.leaves(CAUTIOUS.velocity_cutoff) == []
    assert Params.from_dict(OWN.to_dict()).to_dict() == OWN.to_dict()
    assert by_structure([OWN, CAUTIOUS, OWN]) == [[0, 2], [1]]
    with pytest.raises(InputError, match="for all or none"):
        Params.stack([OWN, CAUTIOUS])
    with pytest.raises(InputError, match=r"velocity_cutoff.*rad/s.*typical"):
        dataclasses.replace(CAUTIOUS, velocity_cutoff=0.0)


@pytest.mark.oracle
def test_a_quick_filter_passes_everything() -> None:
    """At the highest cut-offs the loop is the one without filters."""
    quick = dataclasses.replace(CAUTIOUS, velocity_cutoff=1e5, force_cutoff=1e4)
    none = dataclasses.replace(PLAIN.loop_path(), velocity_cutoff=0.0)
    same(margins(quick, TISSUES).M_s, margins(CAUTIOUS, TISSUES, path=none).M_s, 1e-3)
    assert design(quick).force_filter.force_gain < 1.0
