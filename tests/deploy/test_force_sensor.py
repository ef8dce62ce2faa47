import math
import random

import numpy as np
import pytest

from deploy.errors import CalibrationError
from deploy.force.can_sensor import CanSensor
from deploy.force.sensor import BAD_DATA, TARE_AGAIN, Mounted, Wrench, mean_force
from deploy.puck import codec, messages
from deploy.puck.frame import Frame

FORCE, MOMENT = codec.encode_force((1.0, 2.0, -3.0)), codec.encode_moment((0.5, 0.0, -0.25))
DOUBT = 20
"""Cycles at 1 kHz."""
OTHER = codec.encode_force((1.5, 2.0, -3.0))


class Fixed:
    """A sensor that always reads the same."""

    ready = True

    def __init__(self, force=(1.0, 2.0, 3.0), moment=(0.1, 0.2, 0.3), flags=0):
        self.wrench, self.tared = Wrench(force, moment, flags), 0

    def request(self):
        return (Frame(8, b"\x36"),)

    def feed(self, frame):
        return frame.id == 0x50A

    def read(self):
        return self.wrench

    def tare(self):
        self.tared += 1
        return (Frame(8, b"\xb6\x00\x00\x00"),)


def asked():
    sensor = CanSensor()
    assert sensor.request() == (Frame(0x008, b"\x36"),)
    return sensor


def test_a_reading_is_two_frames():
    sensor = asked()
    assert sensor.read() is None
    assert sensor.feed(FORCE)
    assert not sensor.ready
    assert sensor.feed(MOMENT)
    assert sensor.ready
    assert sensor.read() == Wrench((1.0, 2.0, -3.0), (0.5, 0.0, -0.25), 0)
    sensor.request()
    assert sensor.read() is None


def test_flags_come_through():
    sensor = asked()
    sensor.feed(codec.encode_force((0.0, 0.0, 0.0), BAD_DATA | TARE_AGAIN | 3))
    assert sensor.read().flags == 0xC3


def test_frames_of_others_are_left_alone():
    sensor = asked()
    for frame in (codec.encode_position(1, 2), codec.encode_property(8, 54, 1), codec.encode_acceleration((0, 0, 0))):
        assert not sensor.feed(frame)


def test_wrong_lengths_are_counted():
    sensor = asked()
    for length in (0, 1, 2, 3, 4, 5, 8):
        assert sensor.feed(Frame(0x50A, bytes(length)))
        assert sensor.feed(Frame(0x50B, bytes(length)))
    assert sensor.malformed == 14
    assert sensor.read() is None


def test_without_its_moment_a_force_counts_all_the_same():
    sensor = asked()
    sensor.feed(FORCE)
    assert not sensor.ready  # the moment is waited for
    assert sensor.read().force == (1.0, 2.0, -3.0)


def test_after_a_missing_answer_two_different_ones_count_as_none():
    sensor = asked()
    sensor.request()  # nothing came
    sensor.feed(FORCE)
    sensor.feed(MOMENT)
    assert not sensor.ready  # this may be the late one
    sensor.feed(OTHER)
    assert sensor.ready
    assert sensor.read() is None
    assert sensor.doubtful == 1
    sensor.request()
    sensor.feed(FORCE)
    sensor.feed(MOMENT)
    assert sensor.ready  # the late one has come, nothing is in doubt any more


def test_doubt_ends():
    sensor = asked()
    for cycle in range(DOUBT + 1):
        sensor.request()
        sensor.feed(FORCE)
        sensor.feed(MOMENT)
        assert sensor.ready == (cycle == DOUBT)
        assert sensor.read() is not None


def test_a_duplicate_is_no_doubt():
    sensor = asked()
    for frame in (FORCE, FORCE, MOMENT):
        sensor.feed(frame)
    assert sensor.read().force == (1.0, 2.0, -3.0)


def test_tare_is_an_order_to_the_sensor():
    (frame,) = CanSensor().tare()
    assert codec.decode(frame) == messages.Set(8, 54, 0)


def test_mounted_gives_the_force_on_the_tissue():
    # pressing down, the tissue pushes the tool up: the sensor feels +5 N, the tissue −5 N
    assert Mounted(Fixed((0.0, 0.0, 5.0))).read().force == (0.0, 0.0, -5.0)
    assert Mounted(Fixed((0.0, 0.0, 5.0)), bias=(0.0, 0.0, 1.0)).read().force[2] == -4.0


def test_mounted_against_numpy():
    draw = np.random.default_rng(0)
    for _ in range(50):
        rotation = np.linalg.qr(draw.normal(size=(3, 3)))[0]
        rotation *= np.linalg.det(rotation)
        force, moment, bias = draw.normal(size=(3, 3))
        mounted = Mounted(Fixed(tuple(force), tuple(moment), 7), rotation.tolist(), bias.tolist())
        wrench = mounted.read()
        np.testing.assert_allclose(wrench.force, -rotation @ (force - bias), rtol=0, atol=1e-14)
        np.testing.assert_allclose(wrench.moment, -rotation @ moment, rtol=0, atol=1e-14)
        assert wrench.flags == 7


def test_mounted_passes_the_rest_on():
    sensor = Fixed()
    mounted = Mounted(sensor, bias=(1.0, 2.0, 3.0))
    assert mounted.ready
    assert mounted.request() == sensor.request()
    assert mounted.feed(FORCE)
    assert not mounted.feed(MOMENT)
    assert mounted.read().force == (0.0, 0.0, 0.0)
    mounted.tare()
    assert sensor.tared == 1
    assert mounted.read().force == (-1.0, -2.0, -3.0)  # the bias was of the old zero
    sensor.wrench = None
    assert mounted.read() is None


@pytest.mark.parametrize(
    "rotation",
    [
        [[1, 0, 0], [0, 1, 0], [0, 0, -1]],
        [[2, 0, 0], [0, 1, 0], [0, 0, 1]],
        [[1, 0, 0], [0, 1, 0]],
        [[1, 0], [0, 1], [0, 0]],
        [[math.nan, 0, 0], [0, 1, 0], [0, 0, 1]],
    ],
)
def test_what_is_no_rotation_is_refused(rotation):
    with pytest.raises(CalibrationError, match="rotation"):
        Mounted(Fixed(), rotation)


@pytest.mark.parametrize("bias", [(0.0, math.nan, 0.0), (0.0, 0.0)])
def test_what_is_no_bias_is_refused(bias):
    with pytest.raises(CalibrationError, match="bias"):
        Mounted(Fixed(), bias=bias)


def test_mean_force_for_a_bias():
    draw = random.Random(0)
    forces = [tuple(draw.gauss(m, 0.1) for m in (1.0, -2.0, 3.0)) for _ in range(100)]
    mean = mean_force(Wrench(force, (0.0, 0.0, 0.0), TARE_AGAIN) for force in forces)
    np.testing.assert_allclose(mean, np.mean(forces, axis=0), rtol=0, atol=1e-14)
    for bad in ([], *([Wrench((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), flag)] for flag in (BAD_DATA, 0x01, 0x20))):
        with pytest.raises(CalibrationError, match="no sound reading"):
            mean_force(bad)
