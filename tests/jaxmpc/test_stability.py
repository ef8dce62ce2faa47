"""Margins against their own definition on an independent model, and python-control."""

from collections.abc import Callable
from functools import partial
from typing import Any

import control
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmpc import InputError, Params, Status, design, margins, stability
from jaxmpc.stability import CELLS
from jaxmpc.stability.loop import closed_loop_matrix, contact_of, spectral_radius
from jaxmpc.stability.response import loop_response
from jaxmpc.world.loop_path import loop_path
from tests.jaxmpc.judged_loops import CASES, LATE, PARABOLIC, SENSOR, T_S, TUNED, cut_margins, radius


@pytest.mark.oracle
@pytest.mark.parametrize(("params", "K_s", "delay", "ideal"), [*CASES, PARABOLIC, *LATE])
def test_spectral_radius_is_that_of_the_independent_loop(
    independent_loop: Callable[..., Any], params: Params, K_s: float, delay: int, ideal: bool
) -> None:
    gains = design(params)
    sensor = 0.0 if ideal else SENSOR
    A, *_ = independent_loop(gains, K_s, float(params.K2), delay, ideal, sensor)
    keep = np.arange(len(A)) != 2 + params.designed_delay if params.architecture == "mpc" else slice(None)
    expected = radius(A[:, keep][keep])
    contact = contact_of(K_s, params.K2, loop_path(delay=delay, ideal=ideal))
    assert float(spectral_radius(closed_loop_matrix(gains, contact))) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("cut", [0.0, 1.0])
@pytest.mark.parametrize(
    ("params", "K_s", "delay", "ideal"),
    [*CASES[:2], LATE[1], *(pytest.param(*case, marks=pytest.mark.oracle) for case in (*CASES[2:], *LATE[2:]))],
)
def test_gain_or_delay_at_the_margin_puts_a_pole_on_the_unit_circle(
    independent_loop: Callable[..., Any], params: Params, K_s: float, delay: int, ideal: bool, cut: float
) -> None:
    """The definition itself, with eigenvalues of a loop in which exactly that gain or delay was put."""
    gains, place = design(params), "a" if cut else "v"
    build = partial(independent_loop, gains, K_s, float(params.K2), delay, ideal, 0.0 if ideal else SENSOR)
    found = cut_margins(params, K_s, float(delay), ideal, cut)

    def at_the_limit(**change: float) -> float:
        A, *_ = build(**change)
        keep = np.arange(len(A)) != 2 + params.designed_delay if params.architecture == "mpc" else slice(None)
        return radius(A[keep][:, keep])

    for gain_db in (float(found.gain_margin_db), -float(found.gain_reduction_db)):
        if np.isfinite(gain_db):
            assert at_the_limit(**{f"gain_{place}": 10 ** (gain_db / 20)}) == pytest.approx(1.0, abs=1e-6)
    late = float(found.delay_margin_s) / T_S
    assert at_the_limit(**{f"late_{place}": late}) == pytest.approx(1.0, abs=1e-6)
    assert at_the_limit(**{f"late_{place}": 0.98 * late}) < 1.0


@pytest.mark.oracle
@pytest.mark.parametrize("cut", [0.0, 1.0])
@pytest.mark.parametrize(("params", "K_s", "delay", "ideal"), CASES[:7])
def test_margins_are_those_of_python_control(params: Params, K_s: float, delay: int, ideal: bool, cut: float) -> None:
    """On frequency data: its polynomial route finds false crossings here."""
    gains = design(params)
    contact = contact_of(K_s, params.K2, loop_path(delay=delay, ideal=ideal))
    omega = np.geomspace(0.5, 0.9999 * np.pi / T_S, 5_000)
    data = control.FRD(np.asarray(loop_response(gains, contact, jnp.asarray(omega * T_S), cut)), omega, smooth=True)
    gain, phase, distance, *_ = control.stability_margins(data, returnall=True)
    found = cut_margins(params, K_s, float(delay), ideal, cut)
    decibels = 20 * np.log10(gain)
    assert float(found.gain_margin_db) == pytest.approx(decibels[decibels > 0].min(initial=np.inf), rel=1e-3)
    assert float(found.gain_reduction_db) == pytest.approx((-decibels[decibels < 0]).min(initial=np.inf), rel=1e-3)
    assert float(found.phase_margin_deg) == pytest.approx(np.mod(phase, 360.0).min(), rel=1e-3)
    assert float(found.M_s) == pytest.approx(1.0 / distance.min(), rel=1e-3)


@pytest.mark.oracle
def test_batches_and_stiffness_sets_keep_their_shape() -> None:
    batch = Params.stack([Params(), Params(Q_p=2.0), Params.published("printed")])
    found = margins(batch, np.array([375.0, 810.0, 1900.0]), ideal=True)
    assert found.M_s.shape == (3, 3)
    assert found.status.tolist() == [[Status.OK] * 3, [Status.OK] * 3, [Status.OK, Status.OK, Status.UNSTABLE]]
    np.testing.assert_array_equal(np.asarray(found.spectral_radius) < 1.0, found.status == Status.OK)
    alone = margins(Params(Q_p=2.0), np.array([375.0, 810.0, 1900.0]), ideal=True)
    np.testing.assert_allclose(found.M_s[1], alone.M_s, rtol=1e-9)


@pytest.mark.parametrize(("stiffness", "delay"), [(0.0, 1), (-5.0, 1), (float("nan"), 1), (810.0, 3)])
def test_impossible_tissue_or_delay_is_refused(stiffness: float, delay: int) -> None:
    with pytest.raises(InputError, match="must be"):
        margins(Params(), stiffness, delay=delay)


@pytest.mark.oracle
@pytest.mark.parametrize("ideal", [False, True])
def test_loops_of_any_number_as_they_run_and_ideal_are_judged_by_one_program(ideal: bool) -> None:
    """One for just these loops says the same of each; they are one more than a block holds, of two controllers."""
    stiffness = np.geomspace(375.0, 1900.0, CELLS // 2 + 1)[:, None]
    both = Params.stack([Params(), TUNED])
    margins(Params(), 810.0)
    programs = stability._block.programs
    found = margins(both, stiffness, ideal=ideal)
    assert stability._block.programs == programs
    assert found.M_s.shape == (2, *stiffness.shape)
    alone = jax.jit(lambda params: margins(params, stiffness, ideal=ideal))(both)
    for name, values in alone._asdict().items():
        np.testing.assert_allclose(getattr(found, name), values, rtol=1e-9, err_msg=name)
