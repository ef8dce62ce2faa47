"""What nodes say of themselves when asked, and what of it prevents a run; nothing is set here.

`must` asks a node for a property by its number, and raises `BusError` where it does not answer.
"""

from collections.abc import Callable, Iterable
from functools import partial
from typing import Final

from deploy.errors import BusError, CalibrationError
from deploy.puck import properties
from deploy.puck.codec import GROUPS, SAFETY_MODULE
from deploy.puck.pendant import decode_pendant
from deploy.puck.properties import ROLE, VERS
from deploy.wam.pucks import PuckInfo

SEVENTH: Final = (5, 6, 7)
"""Pucks of an arm with seven joints, which one with four has not."""

Must = Callable[[int, int], int]


def safety_version(must: Must) -> int:
    """Version of the safety module's firmware.

    Raises:
        BusError: It does not answer, or the node is another one.
    """
    version = must(SAFETY_MODULE, VERS)
    role = must(SAFETY_MODULE, ROLE) & 0x1F
    if role != properties.ROLES.index("safety"):
        raise BusError(f"node {SAFETY_MODULE} is no safety module (role {role}): check who is on this bus")
    return version


def no_faults(must: Must, version: int) -> None:
    """Refuse an arm whose pendant shows a fault.

    Raises:
        BusError: It does, or it does not answer.
        InputError: The firmware is too old.
    """
    faults = decode_pendant(must(SAFETY_MODULE, properties.number("PEN", "safety", version))).faults
    if faults:
        shown = " and ".join(faults)
        raise BusError(
            f"the pendant shows a FAULT of {shown}: find its cause, clear it by Shift-idle, then start again"
        )


def four_joints(nodes: Iterable[int]) -> None:
    """Refuse an arm with seven joints, by the nodes that answer.

    Raises:
        BusError: It has.
    """
    if more := [node for node in SEVENTH if node in nodes]:
        raise BusError(f"puck {more[0]} answers too: this is a WAM with 7 joints, and only one with 4 is driven here")


def read_puck(must: Must, node: int) -> PuckInfo:
    """Properties of an awake puck.

    Raises:
        BusError: It does not answer.
        CalibrationError: It is set up wrongly.
        InputError: Its firmware is too old.
    """
    version, role = must(node, VERS), must(node, ROLE)
    number = partial(properties.number, kind="motor", version=version)
    group = must(node, number("GRPB"))
    if group != GROUPS["torque"] & 0x1F:
        raise CalibrationError(f"puck {node} listens to torques of group {group}, not 1: set its GRPB with btutil")
    pidx, cts, ipnm, mt = (must(node, number(name)) for name in ("PIDX", "CTS", "IPNM", "MT"))
    return PuckInfo(node, pidx, version, role, cts, ipnm, mt)
