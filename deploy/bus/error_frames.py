"""Error frames of a CAN controller, as Linux makes them (linux/can/error.h): which of them end a run.

An error frame is no frame of the bus but news from this side's own controller. Its identifier has a bit per class, and
byte 1 says more of the class "controller". News that a passing disturbance makes on any bus must not end a run; lost
frames show by themselves, as positions or forces that do not come.
"""

from collections.abc import Mapping
from typing import Literal

BusState = Literal["active", "error", "down", "off"]
"""What can be relied on: all; frames may be refused; the network interface is down; bus-off, or no interface."""

CONTROLLER, CONTROLLER_BYTE = 0x004, 1
CLASSES: Mapping[int, tuple[str, BusState]] = {
    0x001: ("a transmission timed out", "active"),
    0x002: ("arbitration lost", "active"),
    0x004: ("the controller's state, see byte 1", "active"),
    0x008: ("protocol violation", "active"),
    0x010: ("transceiver status", "active"),
    0x020: ("no acknowledgement", "active"),
    0x040: ("bus-off", "off"),
    0x080: ("bus error", "active"),
    0x100: ("the controller was restarted", "active"),
    0x200: ("error counters", "active"),
}
"""Classes: bit of the identifier, what it says, and the state that it means."""
CONTROLLER_STATES: Mapping[int, tuple[str, BusState]] = {
    0x01: ("its receive buffer ran over", "active"),
    0x02: ("its transmit buffer ran over", "active"),
    0x04: ("warning level of receive errors", "active"),
    0x08: ("warning level of transmit errors", "active"),
    0x10: ("error-passive in receiving", "error"),
    0x20: ("error-passive in transmitting", "error"),
    0x40: ("recovered to error-active", "active"),
}
"""Bits of byte 1 of the class "controller". A controller that is error-passive can no longer tell others of errors."""
_GRAVITY: Mapping[BusState, int] = {"active": 0, "error": 1, "down": 2, "off": 3}


def state_of(identifier: int, data: bytes) -> BusState:
    """The state that an error frame means, the gravest where it says several things."""
    said = [state for bit, (_, state) in CLASSES.items() if identifier & bit]
    if identifier & CONTROLLER and len(data) > CONTROLLER_BYTE:
        said += [state for bit, (_, state) in CONTROLLER_STATES.items() if data[CONTROLLER_BYTE] & bit]
    return max(said, key=_GRAVITY.__getitem__, default="active")


def graver(one: BusState, other: BusState) -> BusState:
    """The graver of two states."""
    return max(one, other, key=_GRAVITY.__getitem__)
