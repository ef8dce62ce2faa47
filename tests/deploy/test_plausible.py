"""The module comes as an argument, so that the mutation test can hand in a wrong one."""

import math

import numpy as np
import pytest

from deploy.safety import plausible as right
from deploy.safety.reasons import Reason

JR3_NOISE, JR3_LSB = (0.010,) * 3, (0.0061, 0.0061, 0.0122)
CTS, T_S = (4096,) * 4, 1e-3


@pytest.fixture(scope="module")
def plausible():
    return right


def live(samples, seed=0, lsb=JR3_LSB):
    """A sensor on a beating heart: 5 N of push, residuals of 0.4 N, noise, counts; (samples, 3) [N]."""
    draw, t = np.random.default_rng(seed), 1e-3 * np.arange(samples)
    waves = [np.sin(2 * np.pi * (1.265 * (i + 1) * t + draw.uniform())) for i in range(3)]
    true = 0.2 * np.stack(waves, axis=1) @ draw.uniform(-1, 1, (3, 3)) + (0.0, 0.0, -5.0)
    return np.floor((true + draw.normal(0.0, 0.010, (samples, 3))) / lsb + 0.5) * lsb


def run(plausible, forces, innovations=None):
    """The reasons, sample by sample."""
    state, found = plausible.ForceState(), []
    for k, force in enumerate(forces):
        given = None if force is None else tuple(map(float, force))
        state, reason = plausible.force_step(state, given, None if innovations is None else innovations[k])
        found.append(reason)
    return found


def first(reasons):
    """Number of samples until something was found, and what."""
    return next(((k, reason) for k, reason in enumerate(reasons) if reason is not None), None)


def test_a_live_sensor_raises_no_alarm(plausible):
    for seed, lsb in ((0, JR3_LSB), (1, (1 / 256,) * 3)):
        samples = list(live(3000, seed, lsb))
        assert first(run(plausible, samples, [(0.3, -0.3, 0.3)] * 3000)) is None
        for k in range(0, 3000, 3):
            samples[k] = samples[k + 1] = None
        assert first(run(plausible, samples)) is None


def test_off(plausible):
    healthy = list(live(20))
    assert run(plausible, [*healthy, None, None, None, None, healthy[-1]])[20:] == [
        None,
        None,
        Reason.FORCE_LOST,
        Reason.FORCE_LOST,
        None,
    ]
    assert run(plausible, [None] * 3) == [None, None, Reason.FORCE_LOST]
    assert first(run(plausible, [*healthy, None, None, healthy[0], None, None, healthy[1]])) is None


def test_what_is_not_finite_or_beyond_the_sensor(plausible):
    healthy = list(live(20))
    for axis in range(3):
        for bad in (math.nan, math.inf, -math.inf):
            wrong = [bad if i == axis else 0.0 for i in range(3)]
            assert run(plausible, [wrong]) == [Reason.FORCE_NOT_FINITE]
            # nothing of it is remembered
            assert run(plausible, [*healthy, wrong, healthy[-1]])[20:] == [Reason.FORCE_NOT_FINITE, None]
        for sign in (-1.0, 1.0):
            edge = [sign * 120.0 * (i == axis) for i in range(3)]
            assert run(plausible, [edge]) == [None]
            wrong = [float(np.nextafter(value, sign * 999.0)) if value else 0.0 for value in edge]
            assert run(plausible, [wrong]) == [Reason.FORCE_RANGE]
    assert run(plausible, [*healthy, 1000.0 * healthy[-1]])[20:] == [Reason.FORCE_RANGE]


def test_jumps(plausible):
    for axis in range(3):
        for sign in (-1.0, 1.0):
            start = np.array([0.5, -0.5, 0.25])
            step = sign * np.eye(3)[axis]
            assert run(plausible, [start, start + 0.625 * step]) == [None, None]
            over = start + 0.6251 * step
            # it stays a jump until the force is back, or somebody starts again
            assert run(plausible, [start, over, over, start]) == [None, Reason.FORCE_JUMP, Reason.FORCE_JUMP, None]
    healthy = list(live(40))
    jumped = [force + (10.0, 0.0, 0.0) * (k >= 20) if k >= 20 else force for k, force in enumerate(healthy)]
    for wrong in (
        jumped,
        [*healthy[:20], *(-force for force in healthy[20:])],
        [*healthy[:20], *(0.5 * force for force in healthy[20:])],
    ):
        assert first(run(plausible, wrong)) == (20, Reason.FORCE_JUMP)
    # a lost sample doubles what the force may have changed by, and no number of them allows for more than 1.5 N
    zero, up = np.zeros(3), np.array([0.0, 0.0, 1.0])
    for lost, most in ((1, 1.25), (2, 1.5)):
        missing = [None] * lost
        assert run(plausible, [zero, *missing, most * up])[-1] is None
        assert run(plausible, [zero, *missing, (most + 0.0001) * up])[-1] is Reason.FORCE_JUMP


def test_stuck_within_12_samples(plausible):
    healthy = list(live(100))
    found = run(plausible, healthy + [healthy[-1]] * 20)
    assert first(found) == (100 + 10, Reason.FORCE_STUCK)
    assert set(found[110:]) == {Reason.FORCE_STUCK}
    # two axes alone, or 11 samples, are no proof
    free = [healthy[-1] + (0.0, 0.0061 * (k % 2), 0.0) for k in range(100)]
    assert first(run(plausible, healthy + free)) is None
    for _ in range(2):
        assert first(run(plausible, [*healthy[:1], *[healthy[1]] * 11, healthy[2], healthy[3]])) is None
    # samples that are lost in between do not hide it
    found = run(plausible, [healthy[0], healthy[0], None] * 6)
    assert first(found) == (3 * 5 + 1, Reason.FORCE_STUCK)


def test_half_the_rate(plausible):
    half = [force for force in live(200) for _ in range(2)]
    assert first(run(plausible, half)) == (45, Reason.FORCE_SLOW)
    third = [force for force in live(200) for _ in range(3)]
    k, reason = first(run(plausible, third))
    assert (k < 30, reason) == (True, Reason.FORCE_SLOW)
    # one repetition in four is compensated by three new samples: it never adds up
    quarter = [force for k, force in enumerate(live(900)) for _ in range(2 if k % 3 == 0 else 1)]
    assert first(run(plausible, quarter)) is None


def test_repetitions_do_not_count_below_zero(plausible):
    half = [force for force in live(200) for _ in range(2)]
    assert first(run(plausible, [*live(300, 3), *half]))[0] - 300 in (44, 45)


def test_innovations(plausible):
    healthy = list(live(40))
    quiet, edge = (0.1, 0.1, 0.1), (1.4, -1.4, 1.4)
    assert first(run(plausible, healthy, [edge] * 40)) is None
    for axis in range(3):
        for sign in (-1.0, 1.0):
            loud = tuple(sign * 1.4001 if i == axis else 0.0 for i in range(3))
            assert first(run(plausible, healthy, [quiet] * 10 + [loud, loud, quiet] * 10)) is None
            assert first(run(plausible, healthy, [quiet] * 10 + [loud, loud, None] * 10)) is None
            assert first(run(plausible, healthy, [quiet] * 10 + [loud] * 30)) == (12, Reason.FORCE_MODEL)
        nothing = tuple(math.nan if i == axis else 0.0 for i in range(3))
        assert first(run(plausible, healthy, [quiet] * 10 + [nothing] * 30)) == (12, Reason.FORCE_MODEL)
    assert first(run(plausible, healthy)) is None
    assert first(run(plausible, healthy, [(2.0, 0.0, 0.0)] * 40)) == (2, Reason.FORCE_MODEL)


def test_chance_of_a_false_alarm(plausible):
    # against counting: equal pairs and triples of a rounded normal number, its mean on and between two counts
    draw = np.random.default_rng(11)
    for lsb, samples in ((0.02, 2), (0.02, 3), (0.005, 2)):
        drawn = draw.normal(0.0, 0.010, (samples, 100_000))
        chances = []
        for place in (0.0, 0.125, 0.25, 0.375, 0.5):
            counts = np.floor(drawn / lsb + place + 0.5)
            chances.append(np.mean(np.all(counts == counts[0], axis=0)))
        # 1e5 trials know a chance of 0.1 … 0.6 to 0.0016
        assert plausible.repeats((0.010,), (lsb,), samples) == pytest.approx(chances[0], abs=0.006)
        assert max(chances) < chances[0] + 0.006
    # in a minute × five tissues there are 3e5 places to begin
    assert 3e5 * plausible.repeats(JR3_NOISE, JR3_LSB) < 1e-12
    assert 3e5 * plausible.repeats(JR3_NOISE, (1 / 256,) * 3) < 1e-20
    assert plausible.repeats(JR3_NOISE, JR3_LSB, 2) == pytest.approx(0.0093, abs=0.0002)
    # one axis alone would not do: Z of the JR3 has counts as coarse as its noise
    assert 3e5 * plausible.repeats(JR3_NOISE[:1], JR3_LSB[2:]) > 10.0
    # nor would a sensor quieter than its counts
    assert 3e5 * plausible.repeats((0.003,) * 3, JR3_LSB) > 10.0
    assert plausible.repeats((0.0, 0.0), (0.1, 0.0)) == 1.0
    assert plausible.repeats((0.1, 0.0), (0.0, 0.1)) == 0.0


def spin(plausible, rows, cts=CTS, T_s=T_S):
    state, found = plausible.EncoderState(), []
    for row in rows:
        state, reason, motor = plausible.encoder_step(state, row, cts, T_s)
        found.append((reason, motor))
    return found


NOTHING = (None, -1)


def turning(samples, motor=None, speed=0.0, start=-1000):
    """Counts of motors at rest, one of them turning [rad/s]."""
    lsb = 2 * math.pi / 4096
    return [
        tuple(start + (round(k * 1e-3 * speed / lsb) if i == motor else 0) for i in range(4)) for k in range(samples)
    ]


def test_encoders_at_rest_or_turning(plausible):
    for motor in range(4):
        for speed in (0.0, 3.0, -40.0, 105.0):
            assert set(spin(plausible, turning(100, motor, speed))) == {NOTHING}
    assert spin(plausible, [(None,) * 4] * 50) == [NOTHING] * 50


def test_encoder_jumps(plausible):
    # 150 rad/s are 97.8 counts a sample
    for motor in range(4):
        for sign in (-1, 1):
            start = (5, -7, 1000, -20000)
            near, far = (tuple(c + sign * n * (i == motor) for i, c in enumerate(start)) for n in (97, 98))
            assert spin(plausible, [start, near]) == [NOTHING] * 2
            jump = (Reason.ENCODER_JUMP, motor)
            assert spin(plausible, [start, far, far, near]) == [NOTHING, jump, jump, NOTHING]
            # two samples that are lost give it three times as long
            lost = tuple(None if i == motor else c for i, c in enumerate(start))
            near, far = (tuple(c + sign * n * (i == motor) for i, c in enumerate(start)) for n in (293, 294))
            assert spin(plausible, [start, lost, lost, near])[3] == NOTHING
            assert spin(plausible, [start, lost, lost, far])[3] == jump
            # and only those in a row
            near, far = (tuple(c + sign * n * (i == motor) for i, c in enumerate(start)) for n in (97, 98))
            assert spin(plausible, [start, lost, start, near])[3] == NOTHING
            assert spin(plausible, [start, lost, start, far])[3] == jump
    assert spin(plausible, [(0, 0, 0, 0), (0, 0, 0, 49)], (4096, 4096, 4096, 2048))[1] == (Reason.ENCODER_JUMP, 3)
    assert spin(plausible, [(0, 0, 0, 0), (0, 195, 0, 0)], T_s=2e-3)[1] == NOTHING
    assert spin(plausible, [(0, 0, 0, 0), (0, 196, 0, 0)], T_s=2e-3)[1] == (Reason.ENCODER_JUMP, 1)


def test_encoder_stuck_while_turning(plausible):
    for motor in range(4):
        for sign in (-1.0, 1.0):
            rows = turning(60, motor, sign * 9.2)  # 6 counts a sample
            found = spin(plausible, rows + [rows[-1]] * 30)
            assert found[:70] == [NOTHING] * 70
            assert found[70:] == [(Reason.ENCODER_STUCK, motor)] * 20
            # one that turns slowly, or slows down, may come to rest
            rows = turning(60, motor, sign * 4.6)
            assert spin(plausible, rows + [rows[-1]] * 30) == [NOTHING] * 90
            # 200 rad/s² at J4
            brake, angle, speed = [], 0.0, 20.0
            while speed > 0.0:
                angle, speed = angle + 1e-3 * speed, speed - 3.6
                brake.append(tuple(round(sign * angle * 4096 / 2 / math.pi) * (i == motor) for i in range(4)))
            rows = turning(60, motor, sign * 20.0, 0)
            end = rows[-1][motor]
            stop = [tuple((end + c) * (i == motor) for i, c in enumerate(row)) for row in brake]
            assert spin(plausible, rows + stop + [stop[-1]] * 30) == [NOTHING] * (90 + len(stop))
    # 6 rad/s are the bound: 3.91 counts a sample
    for counts, reason in ((3, None), (4, Reason.ENCODER_STUCK)):
        rows = [(0, 0, 0, counts * k) for k in range(60)]
        assert spin(plausible, rows + [rows[-1]] * 12)[-1][0] is reason
    # at rest for long, then turning on: what it once did is forgotten
    rows = turning(60, 2, 4.6)
    on = [tuple(c + (i == 2) for i, c in enumerate(rows[-1]))]
    assert set(spin(plausible, rows + [rows[-1]] * 30 + on * 30)) == {NOTHING}


def test_one_that_is_pushed_and_stands_still_is_not_believed_until_it_moves(plausible):
    state = plausible.EncoderState()
    pushed = [-1] * 20 + [2] + [-1] * 9
    for k, unmoved in enumerate(pushed):
        state, reason, motor = plausible.encoder_step(state, (0, 0, 7, 0), CTS, T_S, unmoved)
        assert (reason, motor) == ((Reason.ENCODER_STUCK, 2) if k >= 20 else NOTHING)
    assert plausible.encoder_step(state, (0, 0, 8, 0), CTS, T_S)[1:] == NOTHING
    # one that moved a moment ago is, whatever is said of it
    state = plausible.EncoderState()
    for _ in range(11):
        state, reason, motor = plausible.encoder_step(state, (0, 0, 7, 0), CTS, T_S, 2)
        assert (reason, motor) == NOTHING


def test_encoder_bounds_themselves(plausible):
    # a whole turn in 2π/v seconds is v rad/s exactly
    turn = 2.0 * math.pi
    assert turn / (turn / 150.0) == 150.0
    assert turn / (turn / 12.0) == 12.0
    assert spin(plausible, [(0,) * 4, (4096, 0, 0, 0)], T_s=turn / 150.0) == [NOTHING] * 2
    # half the weight of 12 rad/s is remembered
    assert spin(plausible, [(0,) * 4] + [(4096, 0, 0, 0)] * 20, T_s=turn / 12.0) == [NOTHING] * 21
    found = spin(plausible, [(0,) * 4] + [(4096, 0, 0, 0)] * 20, T_s=turn / 12.001)
    assert found == [NOTHING] * 12 + [(Reason.ENCODER_STUCK, 0)] * 9


def test_speed_is_remembered_over_two_samples(plausible):
    state = plausible.EncoderState()
    for row in ((0,) * 4, (10, 0, 0, 0), (20, 0, 0, 0), (26, 0, 0, 0)):
        state, _, _ = plausible.encoder_step(state, row, CTS, T_S)
    count = 2 * math.pi / 4096 / T_S
    assert state.speed == pytest.approx(((((10 / 2) + 10) / 2 + 6) / 2 * count, 0.0, 0.0, 0.0))
    assert (state.still, state.age, state.counts) == ((0, 3, 3, 3), (0, 0, 0, 0), (26, 0, 0, 0))
    state, _, _ = plausible.encoder_step(state, (None, None, 0, 1), CTS, T_S)
    assert (state.still, state.age, state.counts) == ((0, 3, 4, 0), (1, 1, 0, 0), (26, 0, 0, 1))
    state = plausible.EncoderState()
    for _ in range(13):
        state, _, _ = plausible.encoder_step(state, (1, 2, 3, 4), CTS, T_S)
    assert (state.still, state.speed) == ((12,) * 4, (0.0,) * 4)


def test_angles_beyond_the_stops(plausible):
    stops = ((-2.6, 2.6), (-2.0, 2.0), (-2.8, 2.8), (-0.9, 3.15))
    for joint, (low, high) in enumerate(stops):
        for edge, away in ((low - 0.1, -9.0), (high + 0.1, 9.0)):
            assert plausible.beyond_stop(tuple(edge * (i == joint) for i in range(4))) == -1
            for bad in (float(np.nextafter(edge, away)), math.nan, away):
                assert plausible.beyond_stop(tuple(bad if i == joint else 0.0 for i in range(4))) == joint
