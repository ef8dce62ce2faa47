"""Random frames into the decoder: no exception, and nothing accepted that the encoder would not say again."""

import random

import pytest

from deploy.puck import codec
from deploy.puck.codec import decode
from deploy.puck.frame import Frame
from deploy.puck.messages import AccelerationReply, ForceReply, Get, MomentReply, Position, PropertyReply, Set, Torques

KNOWN = [*range(1, 12), 0x400, 0x401, 0x404, *(0x403 | n << 5 for n in range(32)), *(0x406 | n << 5 for n in range(32))]
KNOWN += [0x50A, 0x50B, 0x50C, 0x540]


def said_again(decoded, length):
    """The frame that says the same in so many bytes."""
    short = length == 4
    match decoded:
        case Get(to, number):
            return codec.get(to, number)
        case Set(to, number, value):
            return codec.set_value(to, number, value, short)
        case PropertyReply(node, number, value):
            return codec.encode_property(node, number, value, short)
        case Torques(units, number):
            return codec.pack_torques(units, number)
        case Position(node, counts, joint_counts):
            return codec.encode_position(node, counts, joint_counts)
        case ForceReply(force, flags):
            return codec.encode_force(force, flags)
        case MomentReply(moment, flags):
            return codec.encode_moment(moment, flags)
        case AccelerationReply(acceleration):
            return codec.encode_acceleration(acceleration)


def fuzz(n, seed):
    draw = random.Random(seed)
    lengths = [0, 1, 2, 3, 3, 4, 5, 6, 6, 7, 8, 8]
    accepted = 0
    for _ in range(n):
        pick = draw.random()
        id = KNOWN[int(2 * pick * len(KNOWN))] if pick < 0.5 else int(2048 * (2 * pick - 1))
        data = bytearray(draw.randbytes(lengths[int(draw.random() * 12)]))
        if len(data) > 1 and draw.random() < 0.5:  # otherwise next to none has the marks of an order or a reply
            data[0] |= 0x80
            data[1] = 0
        frame = Frame(id, bytes(data))
        decoded = decode(frame)
        if decoded is not None:
            accepted += 1
            if isinstance(decoded, Position):  # two bits above each value are nobody's
                data[0] &= 0x3F
                if len(data) == 6:
                    data[3] &= 0x3F
            assert said_again(decoded, len(data)) == (id, bytes(data))
    return accepted / n


def test_100_000_random_frames():
    assert 0.1 < fuzz(100_000, 1) < 0.5


@pytest.mark.slow
def test_1_000_000_random_frames():
    assert 0.1 < fuzz(1_000_000, 2) < 0.5
