"""The twin's bus in lock-step: time by waiting alone, several programs, and every run the same."""

import can
import pytest

from deploy.bus.bus import Bus
from deploy.force.can_sensor import CanSensor
from deploy.force.sensor import Mounted
from deploy.puck import codec
from deploy.puck.frame import Frame
from deploy.twin.lockstep import LockstepBus, LockstepClock
from deploy.twin.scenario import motion_named
from deploy.twin.settings import TwinSettings
from deploy.twin.twin import Twin
from deploy.wam.startup import startup

P, FT, STAT = 48, 54, 5


def message(frame):
    return can.Message(arbitration_id=frame.id, data=frame.data, is_extended_id=False)


@pytest.fixture
def connect():
    buses = []

    def connected(clock):
        buses.append(LockstepBus(clock))
        return buses[-1]

    yield connected
    for bus in buses:
        bus.shutdown()


def frames(bus):
    found = []
    while (got := bus.recv(0.0)) is not None:
        found.append(Frame(got.arbitration_id, bytes(got.data)))
    return found


def test_time_goes_by_only_when_somebody_waits(connect):
    ticks = []
    clock = LockstepClock(Twin(), every_tick=lambda twin: ticks.append(twin.tick))
    bus = connect(clock)
    assert clock.now() == 0
    bus.send(message(codec.get(0x404, P)))
    assert len(frames(bus)) == 4
    assert (clock.now(), clock.twin.tick) == (0, 0)
    clock.wait_until(999_999)
    assert (clock.now(), clock.twin.tick) == (999_999, 0)
    clock.wait_until(3_500_000)
    assert (clock.now(), clock.twin.tick) == (3_500_000, 3)
    clock.wait_until(1)
    assert clock.now() == 3_500_000
    assert ticks == [1, 2, 3]


def test_waiting_for_a_frame_takes_its_time(connect):
    clock = LockstepClock(Twin())
    bus = connect(clock)
    assert bus.recv(0.0006) is None
    assert clock.now() == 600_000
    assert bus.recv(0.0016) is None
    assert (clock.now(), clock.twin.tick) == (2_200_000, 2)
    with pytest.raises(ValueError, match="time-out"):
        bus.recv()


def test_a_late_frame_is_waited_for(connect):
    clock = LockstepClock(Twin(TwinSettings(faults=("J1:late=0.4", "J2:late=1.5"))))
    bus = connect(clock)
    bus.send(message(codec.get(0x404, P)))
    arrived = []
    while (got := bus.recv(0.01)) is not None:
        arrived.append((got.arbitration_id, round(1e6 * got.timestamp)))
    assert arrived == [(0x463, 0), (0x483, 0), (0x423, 400), (0x443, 1500)]
    assert clock.now() == 11_500_000


def test_frames_take_their_time_on_the_wire(connect):
    clock = LockstepClock(Twin(TwinSettings(bit_rate=1e6)))
    bus = connect(clock)
    bus.send(message(codec.get(0x404, P)))
    bus.send(message(codec.get(8, FT)))
    stamps = []
    while (got := bus.recv(0.001)) is not None:
        stamps.append(round(1e6 * got.timestamp))
    # The budget of wam.md §6, without the torque: 349 and 267 µs.
    assert len(stamps) == 6
    assert 560 < stamps[-1] < 680


def test_programs_see_each_other_and_filters_hold(connect):
    clock = LockstepClock(Twin())
    controller, watchdog = connect(clock), connect(clock)
    watchdog.set_filters([{"can_id": 0x404, "can_mask": 0x7FF}])
    controller.send(message(codec.get(0x404, P)))
    assert len(frames(controller)) == 4
    assert frames(watchdog) == [codec.get(0x404, P)]


def test_what_is_no_classical_frame_is_ignored(connect):
    clock = LockstepClock(Twin())
    bus = connect(clock)
    bus.send(can.Message(arbitration_id=0x404, data=b"\x30", is_extended_id=True))
    bus.send(can.Message(arbitration_id=0x404, is_remote_frame=True, is_extended_id=False))
    assert frames(bus) == []
    assert clock.twin.counters["not understood"] == 2


def test_bus_off_refuses_and_is_seen(connect):
    clock = LockstepClock(Twin(TwinSettings(faults=("bus:off@0.005",))))
    mine = connect(clock)
    bus = Bus(mine, now=clock.now)
    assert bus.state == "active"
    bus.send(codec.get(1, STAT))
    assert bus.receive(0.0)[0] == codec.encode_property(1, STAT, 2)
    clock.wait_until(5_000_000)
    with pytest.raises(can.CanOperationError, match="bus-off"):
        mine.send(message(codec.get(1, STAT)))
    assert bus.state == "off"


@pytest.mark.parametrize("cold", [False, True])
def test_the_robots_own_start_up_finds_an_arm(cold, connect):
    """It wakes, homes, and reads in cycles what the arm really does."""
    twin = Twin(TwinSettings(cold=cold, motion=motion_named("none"), gap=0.0, ipnm=(2700.0, 2562.0, 2562.0, 2700.0)))
    clock = LockstepClock(twin)
    said = []
    bus = Bus(connect(clock), now=clock.now)
    arm = startup(bus, clock, Mounted(CanSensor()), home=cold, report=said.append)
    assert arm.pucks.ipnm == (2700, 2562, 2562, 2700)
    assert ("home position set" in said) == cold
    assert any("waking puck 1, puck 2, puck 3, puck 4, the force sensor" in each for each in said) == cold
    twin.carry()
    deadline = clock.now()
    for k in range(2500):
        if k == 2200:
            twin.press("activate")
        deadline += 1_000_000
        clock.wait_until(deadline)
        arm.request()
        reading = arm.collect(deadline + 800_000)
        truth = twin.truth()
        assert reading.position_age == (0, 0, 0, 0)
        # Half a count of each motor, and what the arm was off its home by when that was set.
        assert arm.pucks.angles(reading.counts) == pytest.approx(truth.q, abs=1e-4)
        assert reading.force == pytest.approx(truth.measured, abs=0.5 / 256 + 1e-9)
        bus.send(arm.torque_frame((0.0, -10.5, 0.0, -1.1) if k > 2200 else (0.0,) * 4))
    assert (reading.safety_mode, reading.puck_mode) == (2, (2, 2, 2, 2))
    assert truth.torque == pytest.approx((0.0, -10.5, 0.0, -1.1), abs=0.03)
    assert truth.time < 5.0
    for frame in arm.idle_frames():
        bus.send(frame)
    assert twin.safety.mode == 1


def control(settings, milliseconds=300):
    """A loop of requests, replies and torques: everything that came, and where the arm is at the end."""
    clock = LockstepClock(Twin(settings))
    heard = []
    with LockstepBus(clock) as bus:
        clock.twin.press("activate")
        for k in range(milliseconds):
            clock.wait_until(k * 1_000_000)
            bus.send(message(codec.get(0x404, P)))
            bus.send(message(codec.get(8, FT)))
            heard += frames(bus)
            bus.send(message(codec.pack_torques((0, -480, 480, 160))))
    return heard, clock.twin.truth()


def test_every_run_is_the_same():
    settings = TwinSettings(
        gap=0.005, motion=motion_named("fibrillation", 3), seed=3, faults=("frames:lost=0.01", "force:garbage@0.1")
    )
    assert control(settings) == control(settings)
    assert control(settings) != control(
        TwinSettings(gap=0.005, motion=motion_named("fibrillation", 4), seed=4, faults=settings.faults)
    )


def test_the_whole_bus_of_a_millisecond_fits():
    heard, truth = control(TwinSettings())
    assert len([frame for frame in heard if frame.id != 0x540]) == 300 * 6
    assert truth.time == pytest.approx(0.299)
