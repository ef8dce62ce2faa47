"""Tissue against solve_ivp, printed figures, complex moduli and what any contact must do."""

import math
from types import SimpleNamespace

import hypothesis.strategies as st
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from scipy.integrate import solve_ivp

from jaxmpc.world.tissue import KINDS, WIDTH, Tissue, TissueState, force, init, relax
from jaxmpc.world.tissue.grip import Touched

FLOATS = SimpleNamespace(exp=math.exp, sqrt=math.sqrt, maximum=max)
ARRAYS = SimpleNamespace(exp=np.exp, sqrt=np.sqrt, maximum=np.maximum)
REST = (0.0, 0.0, 0.0)
HEART = Tissue(810.0)
NUMBERS = (810.0, 3.0, 0.25, 0.1, 1.0, 0.5)
"""Numbers of the heart: stiffness, viscosity, relaxing share, two time constants, dissipation."""
BOTH = pytest.mark.parametrize("attached", [True, False])
EVERY = pytest.mark.parametrize("kind", KINDS)


def normal(kind, attached, delta, rate=0.0, tissue=HEART, state=None):
    """Force pressing on the surface, indented by delta."""
    state = init(kind, attached) if state is None else state
    return -force(kind, attached, tissue, state, (0.0, 0.0, -delta), (0.0, 0.0, -rate), FLOATS)[2]


def slope(kind, attached, delta, tissue=HEART):
    h = 1e-7
    return (normal(kind, attached, delta + h, tissue=tissue) - normal(kind, attached, delta - h, tissue=tissue)) / 2 / h


def response(kind, attached, tissue, t, d, ddot):
    """Forces along a path, shape (3, steps), with the rate between samples given to the memory."""
    state, forces = init(kind, attached), []
    for k in range(len(t)):
        forces.append(force(kind, attached, tissue, state, d[:, k], ddot[:, k], FLOATS))
        if k + 1 < len(t):
            h = t[k + 1] - t[k]
            state = relax(kind, attached, tissue, state, d[:, k], (d[:, k + 1] - d[:, k]) / h, h, FLOATS)
    return np.array(forces).T


def loss_factor(kind, frequency, *constants):
    """Tangent of the phase lead of force over displacement in the last two periods of a sine."""
    t = np.arange(0.0, max(3.0, 8.0 / frequency), min(4e-3, 0.005 / frequency))
    angle = 2.0 * np.pi * frequency * t
    d, ddot = np.zeros((3, len(t))), np.zeros((3, len(t)))
    d[0], ddot[0] = 1e-3 * np.sin(angle), 1e-3 * 2.0 * np.pi * frequency * np.cos(angle)
    y = response(kind, True, HEART._replace(constants=constants), t, d, ddot)[0]
    late = t >= t[-1] - 2.0 / frequency
    in_phase, ahead = np.linalg.lstsq(np.stack([np.sin(angle), np.cos(angle)], 1)[late], y[late])[0]
    return ahead / in_phase


def test_the_papers_tissue_is_a_spring_and_nothing_else():
    d = (0.1e-3, -0.2e-3, 0.7e-3)
    assert force("elastic", True, Tissue(813.7), (), d, REST, None) == tuple(813.7 * x for x in d)
    # As few operations as the formula has.
    assert len(jax.make_jaxpr(lambda d: force("elastic", True, HEART, (), tuple(d), REST, jnp))(d).eqns) == 3


@EVERY
def test_only_the_standard_linear_solid_carries_state_and_what_is_touched_its_anchor(kind):
    numbers = 6 if kind == "standard-linear" else 0
    assert [len(jax.tree.leaves(init(kind, attached))) for attached in (True, False)] == [numbers, numbers + 2]


@BOTH
@EVERY
@pytest.mark.parametrize("stiffness", [300.0, 810.0, 2500.0, 1e4])
def test_the_secant_at_five_newton_is_the_stiffness(kind, attached, stiffness):
    near = 1e-3 if stiffness < 5e3 else 3e-3
    assert normal(kind, attached, 5.0 / stiffness, tissue=Tissue(stiffness)) == pytest.approx(5.0, rel=near)


@BOTH
def test_printed_constants_of_the_nonlinear_laws(attached):
    assert slope("fung", True, 0.0) == pytest.approx(338.0, rel=0.01)
    assert slope("fung", attached, 5.0 / 810.0) == pytest.approx(1590.0, rel=0.01)
    assert slope("hunt-crossley", attached, 5.0 / 810.0) == pytest.approx(1210.0, rel=0.01)
    # F = 0.324 N/mm^1.5 δ^1.5 and F = 1.35 N (exp(0.25 δ/mm) − 1).
    for mm in (1.0, 3.0, 6.0):
        assert normal("hunt-crossley", attached, 1e-3 * mm) == pytest.approx(0.324 * mm**1.5, rel=0.01)
        assert normal("fung", attached, 1e-3 * mm) == pytest.approx(1.35 * math.expm1(0.25 * mm), rel=0.01)


@pytest.mark.parametrize(
    ("frequency", "viscosity", "printed"),
    [(1.25, b, f) for b, f in ((0, 0.0), (1, 0.01), (3, 0.03), (8, 0.08))]
    + [(10.0, b, f) for b, f in ((0, 0.0), (1, 0.08), (3, 0.23), (8, 0.62))],
)
def test_printed_loss_factors_of_kelvin_voigt(frequency, viscosity, printed):
    assert loss_factor("kelvin-voigt", frequency, viscosity) == pytest.approx(printed, abs=0.005)


@pytest.mark.parametrize("frequency", [0.1, 0.35, 1.25, 2.5])
def test_loss_factor_of_the_standard_linear_solid(frequency):
    s = 2j * np.pi * frequency
    modulus = 0.75 + sum(0.125 * s * tau / (1.0 + s * tau) for tau in (0.1, 1.0))
    found = loss_factor("standard-linear", frequency)
    assert found == pytest.approx(modulus.imag / modulus.real, rel=2e-3)
    assert 0.05 < found < 0.15


@BOTH
def test_standard_linear_solid_against_solve_ivp(attached):
    """Branch forces qᵢ′ = kᵢ ṙ − qᵢ/τᵢ, another form of the law, with the surface r."""
    tissue = Tissue(600.0, (0.4, (0.05, 0.7)))

    def tip(t):
        return 4e-3 * np.sin(2 * np.pi * 1.3 * t), 1e-3 * np.cos(5.0 * t), -3e-3 + 5e-3 * np.sin(2 * np.pi * 0.8 * t)

    def surface(t):
        x, y, z = tip(t)
        if attached:
            return np.array([x, y, z])
        r = np.sqrt(z * z + WIDTH**2)
        share = (1.0 - z / r) ** 2 * (2.0 + z / r) / 4.0
        return np.array([share * x, share * y, -((r - z) ** 2) / (4.0 * r)])

    def rates(t, q):
        rdot = (surface(t + 1e-6) - surface(t - 1e-6)) / 2e-6
        stretch = np.concatenate([rdot, rdot])
        return 120.0 * stretch - q / np.repeat([0.05, 0.7], 3)

    t = np.arange(0.0, 2.0, 1e-3)
    start = 120.0 * np.tile(surface(0.0), 2)
    q = solve_ivp(rates, (0.0, 2.0), start, t_eval=t, rtol=1e-9, atol=1e-10, max_step=1e-3).y
    path = np.array([tip(x) for x in t]).T
    found = response("standard-linear", attached, tissue, t, path, np.zeros_like(path))
    if attached:
        wanted = 360.0 * path + q[:3] + q[3:]
        assert np.abs(found - wanted).max() < 1e-4
    else:
        wanted = np.minimum(360.0 * np.array([surface(x) for x in t]).T[2] + q[2] + q[5], 0.0)
        assert np.abs(found[2] - wanted).max() < 0.3 * 600.0 * WIDTH
        assert found[2].min() < -3.0
        assert (found[2] > -1e-3).mean() > 0.05


@given(q=st.floats(1e-6, 1e6), z=st.floats(-1e-2, 1e-2), begin=st.floats(-1e-2, 1e-2), end=st.floats(-1e-2, 1e-2))
def test_memory_is_stable_and_stays_within_what_it_followed(q, z, begin, end):
    tissue = Tissue(810.0, (0.25, (1.0 / q, 1.0 / q)))
    state = TissueState((z, z, z), (z, z, z))
    after = relax("standard-linear", True, tissue, state, (begin,) * 3, (end - begin,) * 3, 1.0, FLOATS)
    assert min(z, begin, end) - 1e-15 <= after.z_1[0] <= max(z, begin, end) + 1e-15


@pytest.mark.parametrize("h", [1e-4, 0.1, 10.0])
def test_memory_lags_a_steady_ramp_by_its_time_constant(h):
    begin, rate = np.array([1e-3, -2e-3, 3e-3]), np.array([0.02, 0.01, -0.03])
    state = TissueState(tuple(begin - 0.1 * rate), tuple(begin - 1.0 * rate))
    after = relax("standard-linear", True, HEART, state, begin, rate, h, FLOATS)
    np.testing.assert_allclose(after, [begin + (h - tau) * rate for tau in (0.1, 1.0)], rtol=1e-12)


def everything(flat, ops):
    """Forces [N] and memory [K_s m] of all laws, both ways, from Tissue, memory, d and ddot in a row."""
    viscosity, relaxing, *taus, dissipation = flat[1:6]
    memory, d, ddot, anchor = flat[6:12], tuple(flat[12:15]), tuple(flat[15:18]), tuple(flat[18:20])
    constants = {
        "kelvin-voigt": (viscosity,),
        "standard-linear": (relaxing, tuple(taus)),
        "hunt-crossley": (dissipation,),
    }
    for attached in (True, False):
        for kind in KINDS:
            tissue = Tissue(flat[0], constants.get(kind, ()))
            law = TissueState(tuple(memory[:3]), tuple(memory[3:])) if kind == "standard-linear" else ()
            state = law if attached else Touched(anchor, law)
            yield from force(kind, attached, tissue, state, d, ddot, ops)
            after = relax(kind, attached, tissue, state, d, ddot, 1e-3, ops)
            yield from (800.0 * x for x in jax.tree.leaves(after))


@pytest.mark.oracle
def test_gradients_against_central_differences():
    """With respect to constants, memory, place and rate; forward and reverse; at, across and far from contact."""
    deltas = np.array([-5e-3, -1e-3, -WIDTH, -1e-9, 0.0, 1e-9, WIDTH, 1e-3, 5e-3])
    scale = np.array([*NUMBERS, *(1e-3,) * 9, *(0.05,) * 3, *(1e-3,) * 2])
    inputs = np.tile([*NUMBERS, *(2e-4,) * 6, 1e-3, -2e-3, 0.0, 0.01, -0.02, 0.03, 5e-4, 1e-4], (len(deltas), 1))
    inputs[:, 14] = -deltas

    def of_rows(*flat):
        return list(everything(flat, jnp))

    # Rows do not mix: one pass over 20 copies of them, each moved along another input.
    copies = [jnp.asarray(column) for column in np.tile(inputs, (20, 1)).T]
    along = [jnp.asarray(column) for column in np.repeat(np.eye(20), len(deltas), axis=0).T]
    forward = np.stack(jax.jvp(of_rows, copies, along)[1])
    weights = np.random.default_rng(0).normal(size=(len(forward), 1)) * np.ones(20 * len(deltas))
    reverse = np.stack(jax.vjp(of_rows, *copies)[1]([jnp.asarray(w) for w in weights]))
    assert np.isfinite(forward).all()
    np.testing.assert_allclose((reverse * np.stack(along)).sum(0), (forward * weights).sum(0), rtol=1e-9, atol=1e-9)
    forward = forward.reshape(-1, 20, len(deltas))
    for i, unit in enumerate(scale):
        h = np.zeros(20)
        h[i] = 1e-5 * unit
        high, low = (np.stack(list(everything((inputs + way * h).T, ARRAYS))) for way in (1.0, -1.0))
        # Newton for a relative change of the input: the slopes' units differ. Fung's law, attached, has no second
        # derivative at 0, so the difference is of first order there.
        np.testing.assert_allclose(unit * forward[:, i], (high - low) / 2e-5, rtol=1e-6, atol=2e-6)


@EVERY
def test_an_attached_tissue_pulls_as_it_pushes(kind):
    for delta in (1e-5, 1e-3, 8e-3):
        assert normal(kind, True, -delta, -0.02) == pytest.approx(-normal(kind, True, delta, 0.02), rel=1e-12)
    assert 0.0 < slope(kind, True, 0.0) < 1e3


@EVERY
@settings(max_examples=50)
@given(delta=st.floats(-0.05, 0.02), rate=st.floats(-2.0, 2.0), memory=st.floats(-0.02, 0.02), c=st.floats(0.0, 5.0))
def test_a_touching_tip_is_never_pulled(kind, delta, rate, memory, c):
    state, constants = (
        jax.tree.map(lambda _: memory, init(kind, False)),
        {"hunt-crossley": (c,), "kelvin-voigt": (8.0,)},
    )
    assert normal(kind, False, delta, rate, HEART._replace(constants=constants.get(kind, ())), state) >= 0.0


@EVERY
@settings(max_examples=50)
@given(delta=st.floats(-0.02, 0.02), step=st.floats(1e-9, 1e-3), rate=st.floats(0.0, 0.5))
def test_a_touching_tip_feels_more_the_deeper_and_no_jump(kind, delta, step, rate):
    low, high = normal(kind, False, delta, rate), normal(kind, False, delta + step, rate)
    assert low <= high * (1.0 + 1e-9) + 1e-12
    # No tangent within 20 mm is stiffer than this; Kelvin-Voigt's damping comes in over w.
    stiffest = {"fung": 6e4, "kelvin-voigt": 2e3 + 3.0 * rate / WIDTH}.get(kind, 5e3)
    assert high - low <= stiffest * step


@EVERY
@pytest.mark.parametrize("stiffness", [300.0, 810.0, 2500.0])
def test_nothing_is_felt_a_millimetre_away(kind, stiffness):
    d, ddot = (5e-3, -5e-3, 1e-3), (0.1, 0.1, -0.1)
    assert max(map(abs, force(kind, False, Tissue(stiffness), init(kind, False), d, ddot, FLOATS))) < 1e-3


@EVERY
def test_in_firm_contact_touching_is_as_good_as_attached(kind):
    d, ddot = (2e-3, -1e-3, -6e-3), (0.02, -0.01, 0.03)
    found, wanted = (force(kind, attached, HEART, init(kind, attached), d, ddot, FLOATS) for attached in (False, True))
    np.testing.assert_allclose(found, wanted, rtol=1e-4)


@EVERY
def test_contact_lost_and_found_again(kind):
    t = np.arange(0.0, 12.6, 4e-3)
    d, ddot = np.zeros((3, len(t))), np.zeros((3, len(t)))
    d[0] = 1e-3
    pressed = ((t >= 0.1) & (t < 0.5)) | (t >= 12.1)
    d[2] = np.where(pressed, -5e-3, 8e-3)
    y = response(kind, False, HEART, t, d, ddot)
    assert np.abs(y[:, ~pressed]).max() < 1e-4
    first, again = int(np.argmax(t >= 0.1)), int(np.argmax(t >= 12.1))
    # Along the surface, where it sticks anew, what is left is what its memory has not forgotten: 1e-12 N.
    np.testing.assert_allclose(y[:, again : again + 100], y[:, first : first + 100], rtol=1e-4, atol=1e-9)


@EVERY
def test_contact_found_elsewhere_pushes_along_the_surface_only_by_what_it_moves_from_there(kind):
    t = np.arange(0.0, 3.0, 1e-3)
    d = np.zeros((3, len(t)))
    d[2] = np.interp(t, [0.0, 0.5, 1.0, 1.2, 1.7, 3.0], [0.0, -6e-3, -6e-3, 4e-3, -6e-3, -6e-3])
    d[0] = np.interp(t, [0.0, 1.1, 1.3, 2.0, 2.5, 3.0], [0.0, 0.0, 8e-3, 8e-3, 9e-3, 9e-3])
    y = response(kind, False, HEART, t, d, np.gradient(d, 1e-3, axis=1))
    pressed = d[2] < -5e-3
    assert np.abs(y[0, pressed & (t < 1.99)]).max() < 0.02
    # 1 mm on 810 N/m, and 3 N s/m times its rate until 2.5 s.
    assert 0.6 < y[0, t > 2.6].min()
    assert y[0, t > 2.6].max() < 0.82


def test_a_tip_that_presses_by_a_millimetre_does_not_slide():
    state = init("elastic", False)
    for _ in range(10_000):
        state = relax("elastic", False, HEART, state, (2e-3, -1e-3, -1e-3), REST, 1e-3, FLOATS)
    assert max(map(abs, state.anchor)) < 0.02 * 2e-3


@pytest.mark.parametrize("steps", [1, 5, 20])
def test_sliding_is_the_same_at_any_step(steps):
    state = init("elastic", False)
    for _ in range(5 * steps):
        state = relax("elastic", False, HEART, state, (1e-3, 0.0, -2.0 * WIDTH), REST, 1e-3 / steps, FLOATS)
    u = 2.0 / math.sqrt(5.0)
    contact = 0.25 * (1.0 + u) ** 2 * (2.0 - u)
    assert state.anchor[0] == pytest.approx(1e-3 * -math.expm1(-5.0 * (1.0 - contact) / contact), rel=0.01)


@BOTH
@EVERY
def test_a_closed_path_costs_work_or_none(kind, attached):
    """No law gives energy away: the tip's work over a steady cycle through contact and out of it."""
    t = np.arange(0.0, 6.0, 1e-3)
    angle = 2.0 * np.pi * t
    d = np.stack([2e-3 * np.cos(angle), np.zeros_like(t), -1e-3 + 3e-3 * np.sin(angle)])
    ddot = 2.0 * np.pi * np.stack([-2e-3 * np.sin(angle), np.zeros_like(t), 3e-3 * np.cos(angle)])
    y = response(kind, attached, HEART, t, d, ddot)
    last = t >= 5.0
    pure_normal = np.sum((y[2] * ddot[2])[last]) * 1e-3
    dissipates = kind in ("kelvin-voigt", "standard-linear", "hunt-crossley")
    assert (pure_normal > 1e-5) if dissipates else abs(pure_normal) < 1e-8


@BOTH
@EVERY
def test_every_kind_of_scalar_agrees(kind, attached):
    casadi = pytest.importorskip("casadi")
    recorded = SimpleNamespace(exp=casadi.exp, sqrt=casadi.sqrt, maximum=casadi.fmax)
    d, ddot = (1e-3, -2e-3, -4e-5), (0.01, -0.02, 0.03)

    def both(d, ddot, like, ops):
        state = relax(kind, attached, HEART, init(kind, attached, like), d, ddot, 0.1, ops)
        return force(kind, attached, HEART, state, d, ddot, ops)

    wanted = both(d, ddot, 0.0, FLOATS)
    batch = both(*(tuple(np.full(5, x) for x in axes) for axes in (d, ddot)), np.zeros(5), ARRAYS)
    np.testing.assert_allclose(batch, np.repeat(np.array(wanted)[:, None], 5, 1), rtol=1e-12)
    x, v = casadi.SX.sym("d", 3), casadi.SX.sym("v", 3)
    symbolic = both(tuple(x[i] for i in range(3)), tuple(v[i] for i in range(3)), x[0], recorded)
    found = casadi.Function("f", [x, v], [casadi.vertcat(*symbolic)])(d, ddot)
    np.testing.assert_allclose(np.asarray(found).ravel(), wanted, rtol=1e-12)
