"""Every class of linux/can/error.h, and what it does to a run."""

import can
import pytest

from deploy.bus.bus import Bus
from deploy.bus.error_frames import CLASSES, CONTROLLER_STATES, graver, state_of
from tests.deploy.test_bus import Clock, Scripted, message

# Written out from linux/can/error.h, not taken from the code: identifier's bit, byte 1, what is left of the bus.
TABLE = [
    (0x001, 0x00, "active"),  # CAN_ERR_TX_TIMEOUT
    (0x002, 0x00, "active"),  # CAN_ERR_LOSTARB
    (0x004, 0x00, "active"),  # CAN_ERR_CRTL, unspecified
    (0x004, 0x01, "active"),  # CAN_ERR_CRTL_RX_OVERFLOW
    (0x004, 0x02, "active"),  # CAN_ERR_CRTL_TX_OVERFLOW
    (0x004, 0x04, "active"),  # CAN_ERR_CRTL_RX_WARNING
    (0x004, 0x08, "active"),  # CAN_ERR_CRTL_TX_WARNING
    (0x004, 0x10, "error"),  # CAN_ERR_CRTL_RX_PASSIVE
    (0x004, 0x20, "error"),  # CAN_ERR_CRTL_TX_PASSIVE
    (0x004, 0x30, "error"),
    (0x004, 0x40, "active"),  # CAN_ERR_CRTL_ACTIVE: recovered
    (0x004, 0x80, "active"),  # not defined
    (0x008, 0xFF, "active"),  # CAN_ERR_PROT; byte 1 is not the controller's then
    (0x010, 0x00, "active"),  # CAN_ERR_TRX
    (0x020, 0x00, "active"),  # CAN_ERR_ACK
    (0x040, 0x00, "off"),  # CAN_ERR_BUSOFF
    (0x044, 0x40, "off"),
    (0x080, 0x00, "active"),  # CAN_ERR_BUSERROR
    (0x100, 0x00, "active"),  # CAN_ERR_RESTARTED
    (0x200, 0x00, "active"),  # CAN_ERR_CNT
    (0x204, 0x48, "active"),
    (0x20C, 0x08, "active"),  # a warning with a protocol violation and counters, as drivers combine them
]


@pytest.mark.parametrize(("identifier", "controller", "state"), TABLE)
def test_what_each_class_does(identifier, controller, state):
    driver, clock = Scripted(), Clock()
    bus = Bus(driver, clock.now)
    data = bytes([0, controller, 0, 0, 0, 0, 0, 0])
    driver.queue.append(message(id=identifier, data=data, is_error_frame=True))
    driver.queue.append(message())
    assert state_of(identifier, data) == state
    assert bus.receive(0.0) is not None  # the frame behind it is not lost
    assert bus.state == state
    assert bus.counters.malformed == 1


def test_every_class_and_every_bit_stands_in_the_table():
    assert set(CLASSES) == {1 << bit for bit in range(10)}
    assert set(CONTROLLER_STATES) == {1 << bit for bit in range(7)}
    told = {(identifier, controller) for identifier, controller, _ in TABLE}
    assert {identifier for identifier, _ in told} >= set(CLASSES)
    assert {controller for identifier, controller in told if identifier == 4} >= set(CONTROLLER_STATES)


@pytest.mark.parametrize("length", range(9))
def test_no_bytes_make_it_raise(length):
    for identifier in range(0x400):
        assert state_of(identifier, b"\xff" * length) in ("active", "error", "off")


def test_a_passing_warning_that_recovers_does_not_end_a_run_and_passive_does_for_good():
    driver = Scripted()
    bus = Bus(driver, Clock().now)
    for controller in (0x08, 0x40):
        driver.queue.append(message(id=4, data=bytes([0, controller]), is_error_frame=True))
    assert bus.drain() == []
    assert bus.state == "active"
    for controller in (0x20, 0x40):
        driver.queue.append(message(id=4, data=bytes([0, controller]), is_error_frame=True))
    assert bus.drain() == []
    assert bus.state == "error"
    driver.queue.append(message(id=0x100, data=bytes(8), is_error_frame=True))
    assert bus.drain() == []
    assert bus.state == "error"


def test_the_gravest_stays():
    assert [graver(a, b) for a, b in (("active", "error"), ("off", "down"), ("error", "down"), ("off", "error"))] == [
        "error",
        "off",
        "down",
        "off",
    ]
    assert can.BusState.ERROR is not can.BusState.PASSIVE
