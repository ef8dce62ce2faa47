"""A family of controllers: at its knots the controllers that it was made of, between them what lies between."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import msgspec
import numpy as np
import pytest

from jaxmpc import Experiment, Params, design, evaluate, margins, synthesis
from jaxmpc.engine.base import scalars
from jaxmpc.files.errors import InputError
from jaxmpc.law import cascade, identification, schedule
from jaxmpc.law.gains import Gains
from jaxmpc.law.stiffness import SILENT
from jaxmpc.stability.family import KNOWN, family_margins, gains_on, judged_where
from jaxmpc.synthesis.listening import Listening
from jaxmpc.world.loop_path import loop_path
from jaxmpc.xla import ops
from jaxmpc.xla.precision import in_float64

FAMILY = Params.published("family")
PLACES = FAMILY.listening.stiffness
NUMBERS = ("phi", "gamma", "K", "L", "input_gain", "mpc_ref", "mpc_x", "mpc_u")


@pytest.fixture(scope="module")
def gains() -> Gains:
    return scalars(design(FAMILY), preview=False)


def numbers(gains: Gains) -> np.ndarray:
    return np.hstack([np.ravel(getattr(gains, name)) for name in NUMBERS])


@pytest.mark.parametrize("knot", range(5))
def test_at_a_knot_it_is_that_controller(gains: Gains, knot: int) -> None:
    found, K2 = schedule.at(gains.schedule, np.log(PLACES[knot]), ops)
    own = scalars(design(FAMILY.knots[knot]), preview=False)
    # To the tissue of 1 N/m and back costs a few roundings.
    np.testing.assert_allclose(numbers(found), numbers(own), rtol=1e-12, atol=1e-14)
    assert K2 == pytest.approx(float(FAMILY.knots[knot].K2), rel=1e-14)


def test_between_two_knots_each_gain_is_half_way_on_a_unit_tissue(gains: Gains) -> None:
    low, high = np.log(PLACES[:2])
    middle, K2 = schedule.at(gains.schedule, 0.5 * (low + high), ops)
    ends = [schedule.at(gains.schedule, at, ops)[0] for at in (low, high)]

    def on_unit_tissue(gains: Gains, log_stiffness: float) -> np.ndarray:
        factor = np.exp(log_stiffness)
        K_1, K_2, *K_v = gains.K
        return np.array([K_1, K_2, *(factor * each for each in K_v), factor * gains.L[0], gains.L[2], gains.mpc_u])

    halves = [on_unit_tissue(end, at) for end, at in zip(ends, (low, high), strict=True)]
    found = on_unit_tissue(middle, 0.5 * (low + high))
    np.testing.assert_allclose(found, np.mean(halves, axis=0), rtol=1e-12, atol=1e-14)
    assert K2 == pytest.approx(0.5 * float(FAMILY.knots[0].K2 + FAMILY.knots[1].K2))


@pytest.mark.parametrize("authority", [0.0, 0.25, 1.0])
def test_authority_blends_the_fixed_gains_with_the_known_ones(gains: Gains, authority: float) -> None:
    axis = cascade.init(gains, 0.0)
    tissue = axis.tissue._replace(log_stiffness=np.log(600.0), authority=authority)
    found, K2 = schedule.now(gains, 48.4, axis._replace(tissue=tissue), ops)
    known, known_K2 = schedule.at(gains.schedule, np.log(600.0), ops)
    blended = (1.0 - authority) * numbers(gains) + authority * numbers(known)
    np.testing.assert_allclose(numbers(found), blended, rtol=1e-12, atol=1e-14)
    assert K2 == pytest.approx((1.0 - authority) * 48.4 + authority * known_K2)


def test_where_gains_move_the_cascade_goes_on_from_the_command_that_was_applied(gains: Gains) -> None:
    """With the gains that come, the command that the state stands for is the last one."""
    moving = cascade.init(gains, -5.0)._replace(x_hat=(-4.2, 90.0, 12.0), p_hat=-3.0, u=-4.6, v=22.0)
    kept, jumps = cascade.carried_on(gains, moving), []
    assert float(cascade.carried_on(gains, kept).u) == pytest.approx(float(kept.u), rel=1e-12)
    for authority in (0.0, 1.0):
        tissue = moving.tissue._replace(log_stiffness=np.log(1900.0), authority=authority)
        known, _ = schedule.now(gains, 48.4, moving._replace(tissue=tissue), ops)
        gone_on = cascade.carried_on(known, moving)
        fed_back = np.dot(known.L, gone_on.x_hat) + gone_on.p_hat
        assert float(known.input_gain * gone_on.u - fed_back) == pytest.approx(22.0, rel=1e-12)
        jumps.append(abs(known.input_gain * moving.u - fed_back - 22.0))
    # Left as it was, the reference would have had one of the two laws ask for something else altogether.
    assert max(jumps) > 50.0


@pytest.mark.parametrize("stiffness", [50.0, 280.0, 300.0, 810.0, 2400.0, 2500.0, 9000.0])
def test_on_any_tissue_the_gains_that_are_judged_are_those_that_fly(gains: Gains, stiffness: float) -> None:
    """The law holds what it believes within the outer knots and a little."""
    tissue = cascade.init(gains, -5.0).tissue._replace(log_stiffness=np.log(stiffness), authority=1.0)
    believed = identification.step(gains.schedule.identification, tissue, -5.0, 0.0, -5.0, 0.0, SILENT, ops)
    flown, K2 = schedule.at(gains.schedule, believed.log_stiffness, ops)
    judged, damping = gains_on(FAMILY, [stiffness], Experiment.published("family-wam").loop_path())
    one = jax.tree.map(lambda leaf: leaf[0], judged)
    for name in ("phi", "gamma", "K", "L", "input_gain", "mpc_x", "mpc_u"):
        np.testing.assert_allclose(getattr(one, name), np.asarray(getattr(flown, name)), rtol=1e-9, atol=1e-14)
    assert damping[0] == pytest.approx(float(K2))


def test_without_a_schedule_nothing_is_touched() -> None:
    plain = scalars(design(Params()), preview=False)
    axis = cascade.init(plain, -5.0)
    assert schedule.now(plain, 10.0, axis, ops) == (plain, 10.0)
    assert schedule.listen(plain, axis, -5.0, 0.1, -5.0, 0.0, 0.0, ops) == (axis, 0.0, 0.0)


def learning_nothing(family: Params) -> Params:
    return replace(family, listening=replace(family.listening, harmonics=0))


def test_the_margins_with_a_knot_held_are_those_of_its_controller() -> None:
    path, ratios = loop_path(), np.array([0.92, 1.0, 1.08])
    found = family_margins(learning_nothing(FAMILY), PLACES[1:2], ratios, path)
    own = margins(FAMILY.knots[1], ratios * PLACES[1], path=path)
    for name, value in own._asdict().items():
        np.testing.assert_allclose(getattr(found, name)[0], value, rtol=1e-9, err_msg=name)


@pytest.mark.oracle
def test_the_published_family_keeps_its_margins_between_its_knots() -> None:
    """The margins of `cautious`, over all of the interval within which the schedule takes over."""
    band = FAMILY.listening.band
    found = family_margins(FAMILY, np.geomspace(375.0, 1900.0, 9), np.linspace(1.0 - band, 1.0 + band, 5), loop_path())
    assert np.max(found.M_s) <= 2.0
    assert np.min(found.gain_margin_db) >= 6.0
    assert np.min(found.gain_reduction_db) >= 4.0
    assert np.min(found.phase_margin_deg) >= 30.0
    assert np.min(found.delay_margin_s) >= 1.5e-3


def test_a_family_misses_its_riccati_equations_by_the_worst_of_its_knots(monkeypatch: pytest.MonkeyPatch) -> None:
    one = design(FAMILY.knots[0])
    monkeypatch.setattr(synthesis, "design_one", lambda knot, *_: (one, knot.Q_p))
    _, missed = synthesis.design_family(FAMILY, 1e-3)
    assert float(missed) == max(float(knot.Q_p) for knot in FAMILY.knots)


@pytest.mark.oracle
def test_a_gradient_goes_through_design_and_schedule() -> None:
    def value(lam: jax.Array) -> jax.Array:
        knots = (FAMILY.knots[0], replace(FAMILY.knots[1], lam=lam), *FAMILY.knots[2:])
        known, _ = schedule.at(scalars(design(replace(FAMILY, knots=knots)), False).schedule, np.log(600.0), ops)
        return known.mpc_u + known.mpc_x[0] * known.L[0]

    at, h = float(FAMILY.knots[1].lam), 1e-6
    found = jax.grad(value)(jnp.asarray(at))
    central = (value(jnp.asarray(at + h)) - value(jnp.asarray(at - h))) / (2.0 * h)
    assert found == pytest.approx(float(central), rel=1e-6)  # h² and rounding/h leave eight digits
    assert abs(found) > 1e-3


def test_params_survive_a_file_and_a_stack() -> None:
    again = Params.from_dict(FAMILY.to_dict())
    assert again.to_dict() == FAMILY.to_dict()
    pair = Params.stack([FAMILY, again])
    assert pair.batch_shape == (2,)
    assert pair[1].to_dict() == FAMILY.to_dict()


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({"listening": {"stiffness": [375.0, 810.0]}}, "knots"),
        ({"listening": {"stiffness": sorted(PLACES, reverse=True)}}, "listening.stiffness"),
        ({"listening": {"stiffness": list(PLACES), "frequency": 1.0}}, "listening.frequency"),
        ({"listening": {"stiffness": list(PLACES), "pitch": 1.0}}, "listening.pitch"),
        ({"knots": [{"Khat_s": 400.0, "guarded": True}] * 5}, "knots"),
        ({"knots": 3}, "knots"),
        ({"knots": [{"Q_p": -1.0}] * 5}, "Q_p"),
    ],
)
def test_a_wrong_family_is_refused_by_name(change: dict, key: str) -> None:
    with pytest.raises(InputError) as refused:
        Params.from_dict(FAMILY.to_dict() | change)
    assert refused.value.key == key


def test_the_settings_are_the_laws_constants_in_engineering_units() -> None:
    found = Listening((375.0, 810.0)).constants(1e-3)
    assert np.degrees(np.arctan2(found.turn[1], found.turn[0])) == pytest.approx(360.0 * 17e-3)
    # All poles of the watch's filter at one place: its characteristic polynomial is (z − p)³.
    value, rate, curve = np.asarray(found.prediction)
    T_s = 1e-3
    A = np.array([[1.0, T_s, 0.5 * T_s**2], [0.0, 1.0, T_s], [0.0, 0.0, 1.0]])
    transition = A @ (np.eye(3) - np.outer([value, rate, curve], [1.0, 0.0, 0.0]))
    np.testing.assert_allclose(np.poly(transition), np.poly([np.exp(-1e-3 / 0.0035)] * 3), rtol=1e-9)


@pytest.mark.oracle
@in_float64
def test_slopes_through_schedule_and_loop_are_central_differences() -> None:
    """Twenty families on tissues that they have to find, which a hasty lock-in does within a second."""
    # Of its five knots every other one, which take half as long to compile.
    places, chosen = PLACES[::2], FAMILY.knots[::2]
    hasty = replace(FAMILY.listening, stiffness=places, lock_in=0.1, averaging=0.2, confidence=1.0, band=0.5)
    experiment = Experiment.published("table-1")
    # A step of a rounded force is no slope.
    smooth = msgspec.structs.replace(experiment.sensor, lsb=(0.0, 0.0, 0.0))
    tissues = tuple(np.geomspace(400.0, 1800.0, 4).tolist())
    experiment = msgspec.structs.replace(experiment, duration=3.0, settle=2.0, stiffness=tissues, sensor=smooth)
    random = np.random.default_rng(3)
    around = 1.0 + 0.1 * random.uniform(-1.0, 1.0, (5, 3))

    @jax.jit
    def residual(factors: jax.Array) -> jax.Array:
        """RMS of each tissue's axes together, as the knots' Q_p, their T_cl and the fixed Q_p are multiplied [N]."""
        of_knots, of_fixed = factors[:2], factors[2]
        knots = tuple(replace(knot, Q_p=knot.Q_p * of_knots[0], T_cl=knot.T_cl * of_knots[1]) for knot in chosen)
        family = replace(FAMILY, Q_p=FAMILY.Q_p * of_fixed, knots=knots, listening=hasty)
        return jnp.linalg.norm(evaluate(family, experiment).metrics.rms, axis=-1)

    slopes, h = jax.jit(jax.jacrev(residual)), 1e-5
    compared = 0
    for factors in jnp.asarray(around):
        ends = [(residual(factors + h * e), residual(factors - h * e)) for e in np.eye(3)]
        expected = np.stack([(up - down) / (2.0 * h) for up, down in ends], axis=-1)
        assert (np.abs(expected[:, :2]).max(axis=1) > 1e-4).all(), "the schedule has flown"
        # The schedule is switched by clips, whose corners a step of 1e-5 meets now and then.
        scale = np.abs(expected).max(axis=1, keepdims=True)
        np.testing.assert_allclose(slopes(factors) / scale, expected / scale, atol=1e-4, rtol=0)
        compared += len(expected)
    assert compared == 20


def test_doubt_under_one_axis_takes_the_authority_from_all(gains: Gains) -> None:
    axis = cascade.init(gains, 0.0)
    assert axis.tissue is not None
    sure = axis._replace(tissue=axis.tissue._replace(authority=1.0))
    doubtful = axis._replace(tissue=axis.tissue._replace(doubt=2.0, strain=0.3))
    alarm = schedule.alarm((sure, doubtful, sure), ops)
    assert alarm == (2.0, 0.3, sure.tissue.wave)
    after, _, _ = schedule.listen(gains, sure, 0.0, 0.0, 0.0, 0.0, alarm, ops)
    assert after.tissue is not None
    assert after.tissue.authority < 0.9
    calm, _, _ = schedule.listen(gains, sure, 0.0, 0.0, 0.0, 0.0, SILENT, ops)
    assert calm.tissue is not None
    assert calm.tissue.authority == 1.0


@pytest.mark.parametrize(
    ("places", "count"),
    [((810.0,), 1), ((375.0, 1900.0), KNOWN), ((375.0, 810.0, 1900.0), KNOWN + 1), ((300.0, 600.0, 1200.0), KNOWN)],
)
def test_a_family_is_judged_once_at_each_known_stiffness(places: tuple[float, ...], count: int) -> None:
    """Logarithms round: a single knot was judged, and told, at 810 and at 810.0000000000003 N/m."""
    known, _ = judged_where(Listening(places))
    assert len(known) == count
    assert np.all(np.diff(known) > 1e-6 * known[:-1])
    assert set(places) <= set(known.tolist())
