"""What the frames of the pucks, the safety module and the force sensor say, as values."""

from typing import NamedTuple

from jaxmpc.law.vectors import Vector3

Units = tuple[int, int, int, int]


class Get(NamedTuple):
    """The host asks a node, or a group by its identifier 0x400…, for a property."""

    to: int
    property: int


class Set(NamedTuple):
    """The host sets a property of a node, or of a group by its identifier 0x400…."""

    to: int
    property: int
    value: int


class Torques(NamedTuple):
    """Torques of the pucks with PIDX 1, 2, 3, 4 [puck units], and the property they are set as."""

    units: Units
    property: int


class Position(NamedTuple):
    """Counts of a motor's encoder, and of the joint's own where there is one."""

    node: int
    counts: int
    joint_counts: int | None


class PropertyReply(NamedTuple):
    """A node tells the value of a property."""

    node: int
    property: int
    value: int


class ForceReply(NamedTuple):
    """Force [N] and, if the sensor sends them, its flags: 0x80 tare again, 0x40 bad data, 0x3F saturated gauges."""

    force: Vector3
    flags: int | None


class MomentReply(NamedTuple):
    """Moment [N m] and, if the sensor sends them, its flags."""

    moment: Vector3
    flags: int | None


class AccelerationReply(NamedTuple):
    """Acceleration of the sensor [m/s²]."""

    acceleration: Vector3


Decoded = Get | Set | Torques | Position | PropertyReply | ForceReply | MomentReply | AccelerationReply
