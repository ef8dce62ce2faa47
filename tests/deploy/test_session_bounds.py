"""What a session asks of the tare, of the wanted force and of the way down: bounds that follow from the controller."""

import math
from argparse import ArgumentParser
from dataclasses import replace
from types import SimpleNamespace

import pytest

from deploy.cli.run_arguments import configure, options
from deploy.errors import CalibrationError
from deploy.force import jr3
from deploy.force.sensor import IDENTITY, Mounted, Wrench
from deploy.loop.control import Contacting
from deploy.loop.session import CHECKED, HEART, STILL, TARING, _tare, deepest, largest_wanted, other_lowpass
from tests.deploy.made import T_S, margin_row


class Felt:
    """A sensor that is tared at once and then reads a force [N], now and then nothing."""

    ready = True

    def __init__(self, force, flags=0):
        self.wrench, self.flags, self.reads = force, flags, 0

    def request(self):
        return ()

    def feed(self, frame):
        return False

    def read(self):
        self.reads += 1
        return None if self.reads % 10 == 0 else Wrench(self.wrench, (0.0, 0.0, 0.0), self.flags)

    def tare(self):
        return ()


class Clock:
    ns = 0

    def now(self):
        return self.ns

    def wait_until(self, deadline):
        self.ns = max(self.ns, deadline)


def tare(felt):
    clock = Clock()
    bus = SimpleNamespace(send=lambda frame: True, receive=lambda timeout: None)
    _tare(SimpleNamespace(bus=bus, sensor=Mounted(felt, IDENTITY)), clock, T_S)
    return clock.ns


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_what_presses_on_the_tool_after_its_tare_is_told_whatever_its_direction(axis, sign):
    def force(newtons):
        return tuple(sign * newtons if i == axis else 0.0 for i in range(3))

    assert tare(Felt(force(STILL - 0.01))) == round(1e9 * (TARING + CHECKED * T_S))
    with pytest.raises(CalibrationError, match="let nothing touch the tool"):
        tare(Felt(force(STILL + 0.01)))


def test_a_tare_leaves_less_than_a_contact():
    tare(Felt((0.6 * STILL,) * 2 + (0.5 * STILL,)))
    with pytest.raises(CalibrationError, match="let nothing touch the tool"):
        tare(Felt((0.6 * STILL,) * 3))
    assert STILL < Contacting().threshold
    assert TARING >= 1.2  # Barrett's sensor takes about 1 s, and reads 0 meanwhile


@pytest.mark.parametrize("flags", [0x01, 0x20, 0x40])
def test_a_tare_needs_sound_readings(flags):
    with pytest.raises(CalibrationError, match="no sound reading"):
        tare(Felt((0.0, 0.0, 0.0), flags))


def test_the_wanted_force_leaves_room_below_the_limit(arm_artifact):
    assert arm_artifact.arm.limits.force == 15.0
    assert largest_wanted(arm_artifact) == pytest.approx(12.0)


def test_the_way_down_is_that_of_the_softest_promised_tissue_and_a_heart(arm_artifact):
    rows = [margin_row(810.0), margin_row(375.0), margin_row(1900.0)]
    assert deepest(replace(arm_artifact, margins=rows)) == pytest.approx(15.0 / 375.0 + HEART)
    assert HEART == 0.025  # docs/robot.md


@pytest.mark.parametrize(
    ("judged", "sensor", "said"),
    [
        (500.0, 500.0, ""),
        (500.0, None, ""),
        (227.0, 227.0, ""),
        (500.0, 227.0, "with a low-pass of 500 Hz in the force sensor, and this kind has 227 Hz"),
        (227.0, 500.0, "with a low-pass of 227 Hz in the force sensor, and this kind has 500 Hz"),
        (0.0, 227.0, "with no low-pass in the force sensor, and this kind has 227 Hz"),
    ],
)
def test_a_sensor_with_another_low_pass_than_the_margins_hold_with_is_told(arm_artifact, judged, sensor, said):
    loop = arm_artifact.loop._replace(sensor_cutoff=2.0 * math.pi * judged)
    told = other_lowpass(replace(arm_artifact, loop=loop), sensor)
    assert bool(told) == bool(said)
    assert said in told


def test_barretts_sensor_and_a_jr3_have_low_passes_of_their_own(arm_artifact, monkeypatch):
    parser = ArgumentParser()
    configure(parser)
    monkeypatch.setattr(jr3, "open_comedi", lambda path: path)
    monkeypatch.setattr(jr3, "Jr3", lambda device: device)
    for sensor, hz in (("can", 227.0), ("jr3", 500.0), ("jr3:/dev/comedi1", 500.0)):
        args = parser.parse_args(["controller.npz", "--sensor", sensor, "--reference", "0,0,-5"])
        assert options(args, arm_artifact).lowpass_hz == hz
