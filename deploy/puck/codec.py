"""Frames of the pucks, the safety module and the force sensor, to values and back (wam.md §3.1-§3.3, §4.1).

Whatever the bytes, `decode` never raises: what is no frame of the protocol is None. Encoders raise ValueError
for what cannot be said in a frame. `wam.dbc` beside this file says the same for other tools.
"""

import struct
from collections.abc import Callable, Sequence
from typing import Any, Final

from deploy.puck.frame import Frame
from deploy.puck.messages import (
    AccelerationReply,
    Decoded,
    ForceReply,
    Get,
    MomentReply,
    Position,
    PropertyReply,
    Set,
    Torques,
    Units,
)
from jaxmpc.law.vectors import Vector3

HOST: Final = 0
PUCKS: Final = (1, 2, 3, 4)
SENSOR: Final = 8
SAFETY_MODULE: Final = 10
BROADCAST: Final = 0x540
"""Identifier of what the safety module tells everybody; its contents are unpublished."""

GROUP: Final = 0x400
"""Flag: bits 4-0 are a group, not a node."""
GROUPS: Final = {
    "motors": GROUP | 0,
    "torque": GROUP | 1,
    "position": GROUP | 3,
    "wam": GROUP | 4,
    "property": GROUP | 6,
    "force": GROUP | 10,
    "moment": GROUP | 11,
    "acceleration": GROUP | 12,
}
"""Identifiers that the host would send to them with; a sender's own has its node number << 5 besides."""

SET: Final = 0x80
TORQUE, POSITION, FORCE_READING, ACCELERATION_READING = 42, 48, 54, 64
"""Property numbers that the layout itself depends on, of newer firmware; see `deploy.puck.properties`."""
LARGEST_TORQUE: Final = 8191
LARGEST_POSITION: Final = 2**21
PER_NEWTON, PER_NEWTON_METRE, PER_ACCELERATION = 256, 4096, 1024
"""Counts of the force sensor per N, per N m and per m/s²."""


def get(to: int, number: int) -> Frame:
    """The question for a property of a node or a group (by its identifier in `GROUPS`)."""
    return Frame(_receiver(to), bytes((_property(number),)))


def set_value(to: int, number: int, value: int, short: bool = False) -> Frame:
    """The order to set a property of a node or a group, to an integer of 32 bits or, as in Barrett's manual, of 16."""
    return Frame(_receiver(to), _with_value(number, value, short))


def pack_torques(units: Sequence[int], number: int = TORQUE) -> Frame:
    """Torques for the pucks with PIDX 1, 2, 3, 4 [puck units], four times 14 bits, the highest first.

    Raises:
        ValueError: There are not four, or one is beyond ±8191.
    """
    a, b, c, d = units
    if not (-8192 < a < 8192 and -8192 < b < 8192 and -8192 < c < 8192 and -8192 < d < 8192):
        raise ValueError(f"torques {tuple(units)} do not fit: a puck takes -{LARGEST_TORQUE} to {LARGEST_TORQUE} units")
    packed = (SET | number) << 56 | (a & 0x3FFF) << 42 | (b & 0x3FFF) << 28 | (c & 0x3FFF) << 14 | d & 0x3FFF
    return Frame(0x401, packed.to_bytes(8, "big"))


def unpack_torques(data: bytes) -> Units:
    """Torques [puck units] in the 8 bytes of a packed frame, whatever property they are for."""
    packed = int.from_bytes(data, "big")
    return (
        (packed >> 42 & 0x3FFF ^ 0x2000) - 0x2000,
        (packed >> 28 & 0x3FFF ^ 0x2000) - 0x2000,
        (packed >> 14 & 0x3FFF ^ 0x2000) - 0x2000,
        (packed & 0x3FFF ^ 0x2000) - 0x2000,
    )


def position_counts(data: bytes) -> int | None:
    """Motor counts in the bytes of a position reply, or None for a wrong number of bytes.

    The two highest bits belong to no value, and libbarrett ignores them too.
    """
    if len(data) != 3 and len(data) != 6:
        return None
    return (((data[0] & 0x3F) << 16 | data[1] << 8 | data[2]) ^ 0x200000) - 0x200000


def encode_position(node: int, counts: int, joint_counts: int | None = None) -> Frame:
    """What a puck answers when it is asked for its position."""
    data = _22_bits(counts) if joint_counts is None else _22_bits(counts) + _22_bits(joint_counts)
    return Frame(GROUPS["position"] | _node(node) << 5, data)


def encode_property(node: int, number: int, value: int, short: bool = False) -> Frame:
    """What a node answers when it is asked for any other property, in 32 bits or in 16."""
    return Frame(GROUPS["property"] | _node(node) << 5, _with_value(number, value, short))


def encode_force(force: Sequence[float], flags: int | None = None) -> Frame:
    """The force sensor's first answer; forces [N] saturate at the ends of their scale."""
    return _encode_triple("force", force, PER_NEWTON, flags)


def encode_moment(moment: Sequence[float], flags: int | None = None) -> Frame:
    """The force sensor's second answer; moments [N m] saturate at the ends of their scale."""
    return _encode_triple("moment", moment, PER_NEWTON_METRE, flags)


def encode_acceleration(acceleration: Sequence[float]) -> Frame:
    """The force sensor's answer about its acceleration [m/s²]."""
    return _encode_triple("acceleration", acceleration, PER_ACCELERATION, None)


def decode(frame: Frame) -> Decoded | None:
    """What a frame says, or None if it is none of the protocol."""
    decoder = _DECODERS.get(frame.id)
    return decoder(frame.id, frame.data) if decoder else None


def _receiver(to: int) -> int:
    if not (0 < to < 32 or GROUP <= to < GROUP + 32):
        raise ValueError(f"{to:#x} is neither a node (1 to 31) nor the identifier of a group (0x400 to 0x41F)")
    return to


def _node(node: int) -> int:
    if not 0 < node < 32:
        raise ValueError(f"{node} is no node: they have the numbers 1 to 31")
    return node


def _property(number: int) -> int:
    if not 0 <= number < 128:
        raise ValueError(f"{number} is no property: they have the numbers 0 to 127")
    return number


def _with_value(number: int, value: int, short: bool) -> bytes:
    try:
        return struct.pack("<BBh" if short else "<BBi", SET | _property(number), 0, value)
    except struct.error:
        raise ValueError(f"{value!r} is no integer of {16 if short else 32} bits") from None


def _22_bits(counts: int) -> bytes:
    if not -LARGEST_POSITION <= counts < LARGEST_POSITION:
        raise ValueError(f"{counts} counts do not fit into 22 bits")
    return (counts & 0x3FFFFF).to_bytes(3, "big")


def _encode_triple(group: str, values: Sequence[float], per_unit: int, flags: int | None) -> Frame:
    counts = [round(min(max(value * per_unit, -32768.0), 32767.0)) for value in values]
    data = struct.pack("<hhh", *counts) + (b"" if flags is None else bytes((flags,)))
    return Frame(GROUPS[group] | SENSOR << 5, data)


def _host(id: int, data: bytes) -> Decoded | None:
    if len(data) == 1:
        return Get(id, data[0]) if data[0] < SET else None
    value = _value(data)
    return None if value is None else Set(id, data[0] & 0x7F, value)


def _torques(id: int, data: bytes) -> Decoded | None:
    if len(data) != 8:
        return _host(id, data)
    units = unpack_torques(data)
    return Torques(units, data[0] & 0x7F) if data[0] >= SET and min(units) >= -LARGEST_TORQUE else None


def _position(id: int, data: bytes) -> Decoded | None:
    counts = position_counts(data)
    return None if counts is None else Position(id >> 5 & 0x1F, counts, position_counts(data[3:]))


def _property_reply(id: int, data: bytes) -> Decoded | None:
    value = _value(data)
    return None if value is None else PropertyReply(id >> 5 & 0x1F, data[0] & 0x7F, value)


def _force(id: int, data: bytes) -> Decoded | None:
    triple = _triple(data, PER_NEWTON)
    return triple and ForceReply(triple, data[6] if len(data) == 7 else None)


def _moment(id: int, data: bytes) -> Decoded | None:
    triple = _triple(data, PER_NEWTON_METRE)
    return triple and MomentReply(triple, data[6] if len(data) == 7 else None)


def _acceleration(id: int, data: bytes) -> Decoded | None:
    triple = _triple(data, PER_ACCELERATION) if len(data) == 6 else None
    return triple and AccelerationReply(triple)


def _value(data: bytes) -> int | None:
    """The integer after a property's number and a zero, of 16 or 32 bits."""
    if len(data) not in (4, 6) or data[0] < SET or data[1]:
        return None
    return int.from_bytes(data[2:], "little", signed=True)


def _triple(data: bytes, per_unit: int) -> Vector3 | None:
    if len(data) != 6 and len(data) != 7:
        return None
    x, y, z = _THREE(data)
    return x / per_unit, y / per_unit, z / per_unit


_THREE: Final[Callable[[bytes], Any]] = struct.Struct("<hhh").unpack_from
_DECODERS: Final[dict[int, Callable[[int, bytes], Decoded | None]]] = {
    **{node: _host for node in range(1, 32)},
    **{GROUP | group: _host for group in range(32)},
    **{GROUPS["position"] | node << 5: _position for node in range(1, 32)},
    **{GROUPS["property"] | node << 5: _property_reply for node in range(1, 32)},
    GROUPS["torque"]: _torques,
    GROUPS["force"] | SENSOR << 5: _force,
    GROUPS["moment"] | SENSOR << 5: _moment,
    GROUPS["acceleration"] | SENSOR << 5: _acceleration,
}
"""By identifier, so that the cycle pays one look-up for a frame."""
