import random
from math import inf

import pytest

from deploy.puck import codec
from deploy.puck.codec import decode
from deploy.puck.frame import Frame
from deploy.puck.messages import AccelerationReply, ForceReply, Get, MomentReply, Position, PropertyReply, Set, Torques
from deploy.puck.pendant import CONDITIONS, DIGITS, Pendant, decode_pendant
from tests.deploy.pendants import encode_pendant


def frame(text):
    """From candump's way to write it: 401#AA01…"""
    id, _, data = text.partition("#")
    return Frame(int(id, 16), bytes.fromhex(data))


# wam.md §3.2, §3.5 and the identifiers of §3.1
VECTORS = [
    ("400#85000200", codec.set_value(0x400, 5, 2, short=True), Set(0x400, 5, 2)),
    ("400#88000200", codec.set_value(0x400, 8, 2, short=True), Set(0x400, 8, 2)),
    ("404#30", codec.get(0x404, 48), Get(0x404, 48)),
    ("400#30", codec.get(0x400, 48), Get(0x400, 48)),
    ("423#000002", codec.encode_position(1, 2), Position(1, 2, None)),
    ("483#3FFFFE", codec.encode_position(4, -2), Position(4, -2, None)),
    ("443#3FFFFE000002", codec.encode_position(2, -2, 2), Position(2, -2, 2)),
    ("463#200000", codec.encode_position(3, -(2**21)), Position(3, -(2**21), None)),
    ("463#1FFFFF", codec.encode_position(3, 2**21 - 1), Position(3, 2**21 - 1, None)),
    ("401#AA0193F9C0323FFF", codec.pack_torques((100, -100, 200, -1)), Torques((100, -100, 200, -1), 42)),
    ("401#AA00000000000000", codec.pack_torques((0, 0, 0, 0)), Torques((0, 0, 0, 0), 42)),
    ("401#8A7FFE001FFF8001", codec.pack_torques((8191, -8191, 8190, -8191 + 8192), 10), None),
    ("00A#AF007B12", codec.set_value(10, 47, 4731, short=True), Set(10, 47, 4731)),
    ("00A#B0005414", codec.set_value(10, 48, 5204, short=True), Set(10, 48, 5204)),
    ("00A#B00054140000", codec.set_value(10, 48, 5204), Set(10, 48, 5204)),
    ("001#B000FFFFFFFF", codec.set_value(1, 48, -1), Set(1, 48, -1)),
    ("546#88000100", codec.encode_property(10, 8, 1, short=True), PropertyReply(10, 8, 1)),
    ("426#C400FEFFFFFF", codec.encode_property(1, 68, -2), PropertyReply(1, 68, -2)),
    ("426#C400FEFF", codec.encode_property(1, 68, -2, short=True), PropertyReply(1, 68, -2)),
    ("008#36", codec.get(8, 54), Get(8, 54)),
    ("50A#000100FF0080", codec.encode_force((1.0, -1.0, -128.0)), ForceReply((1.0, -1.0, -128.0), None)),
    ("50A#000100FFFF7F41", codec.encode_force((1.0, -1.0, 500.0), 0x41), ForceReply((1.0, -1.0, 32767 / 256), 0x41)),
    ("50A#FF7F0080FF7F", codec.encode_force((inf, -inf, 1e308)), ForceReply((32767 / 256, -128.0, 32767 / 256), None)),
    ("50B#001000F00800C0", codec.encode_moment((1.0, -1.0, 2**-9), 0xC0), MomentReply((1.0, -1.0, 2**-9), 0xC0)),
    ("50C#000400FC0100", codec.encode_acceleration((1.0, -1.0, 2**-10)), AccelerationReply((1.0, -1.0, 2**-10))),
]


@pytest.mark.parametrize(("text", "encoded", "decoded"), [row for row in VECTORS if row[2]], ids=lambda x: str(x)[:24])
def test_vectors(text, encoded, decoded):
    assert encoded == frame(text)
    assert decode(frame(text)) == decoded


def test_the_torque_property_of_old_firmware_is_kept():
    packed = codec.pack_torques((1, 2, 3, 4), 10)
    assert packed.data[0] == 0x8A
    assert decode(packed) == Torques((1, 2, 3, 4), 10)


def test_home_position_is_that_of_the_reference():
    # counts of home (wam.md §3.2) through frames and back
    for counts in (0, -36833, 36832, -36728):
        assert decode(codec.encode_position(1, counts)).counts == counts


def test_packing_is_the_inverse_of_unpacking():
    draw = random.Random(3)
    corners = [-8191, -8190, -1, 0, 1, 63, 64, -64, -65, 8190, 8191]
    for k in range(5000):
        pick = (lambda: draw.choice(corners)) if k % 2 else (lambda: draw.randint(-8191, 8191))
        units = tuple(pick() for _ in range(4))
        assert codec.unpack_torques(codec.pack_torques(units).data) == units


@pytest.mark.parametrize("place", range(4))
@pytest.mark.parametrize("value", [8192, -8192, 10**9])
def test_torques_that_do_not_fit_are_refused(place, value):
    units = [0, 0, 0, 0]
    units[place] = value
    with pytest.raises(ValueError, match="do not fit"):
        codec.pack_torques(units)


@pytest.mark.parametrize(
    "encode",
    [
        lambda: codec.pack_torques((1, 2, 3)),
        lambda: codec.get(0, 48),
        lambda: codec.get(0x420, 48),
        lambda: codec.get(1, 128),
        lambda: codec.set_value(1, -1, 0),
        lambda: codec.set_value(1, 48, 2**31),
        lambda: codec.set_value(1, 48, 2**15, short=True),
        lambda: codec.set_value(1, 48, 0.5),
        lambda: codec.encode_position(0, 0),
        lambda: codec.encode_position(32, 0),
        lambda: codec.encode_position(1, 2**21),
        lambda: codec.encode_position(1, 0, -(2**21) - 1),
        lambda: codec.encode_force((float("nan"), 0.0, 0.0)),
        lambda: codec.encode_force((0.0, 0.0, 0.0), 256),
    ],
)
def test_what_cannot_be_said_is_refused(encode):
    with pytest.raises(ValueError):  # noqa: PT011  # each has a sentence of its own
        encode()


@pytest.mark.parametrize(
    "text",
    [
        # wrong lengths
        "423#", "423#00", "423#0000", "423#00000000", "423#0000000000", "423#00000000000000", "423#0000000000000000",
        "426#", "426#88", "426#880001", "426#8800010000", "426#88000100000000",
        "50A#", "50A#0000000000", "50A#0000000000000000", "50B#00", "50C#0000000000", "50C#00000000000000",
        "401#", "401#AA000000000000", "001#", "001#8000", "404#80",
        # right lengths, wrong marks: not set, no zero after the property, -8192
        "426#08000100", "426#88010100", "401#2A00000000000000", "401#AA80000000000000", "001#88010200", "001#08000200",
        # nobody's identifiers: safety module's broadcast, host to host, foreign groups
        "540#0000", "000#30", "420#000002", "4E8#00", "7FF#00", "40A#000100FF0080",
    ],
)  # fmt: skip
def test_what_is_none_of_the_protocol_is_none(text):
    assert decode(frame(text)) is None


def test_decoding_never_raises_whatever_the_identifier():
    draw = random.Random(1)
    for id in [*range(2048), -1, 2**29 - 1]:
        for length in (0, 1, 2, 3, 4, 5, 6, 7, 8, 64):
            decode(Frame(id, draw.randbytes(length)))


def test_a_frame_reads_like_the_manual():
    assert str(codec.pack_torques((100, -100, 200, -1))) == "401 [AA 01 93 F9 C0 32 3F FF]"


def test_pendant_bits():
    # bits 27-26 button, 25 and 24 lights, 23-16 digit, then three lamps for each of five conditions (wam.md §3.5)
    value = 0b01 << 26 | 1 << 25 | 0x5B << 16 | 0b001 << 12 | 0b001 << 9 | 0b100 << 6 | 0b010 << 3 | 0b001
    pendant = Pendant("activate", True, False, "2", "SAFE", "WARNING", "FAULT", "SAFE", "SAFE")
    assert decode_pendant(value) == pendant
    assert encode_pendant(pendant) == value
    assert pendant.faults == ("voltage",)


def test_pendant_round_trip_and_garbage():
    draw = random.Random(2)
    for _ in range(300):
        words = [draw.choice(["SAFE", "WARNING", "FAULT"]) for _ in CONDITIONS]
        button = draw.choice(["none", "idle", "activate", "e-stop"])
        pendant = Pendant(button, draw.random() < 0.5, draw.random() < 0.5, draw.choice([*DIGITS.values()]), *words)
        assert decode_pendant(encode_pendant(pendant)) == pendant
    # no lamp, or all of them: nobody can say that this is safe
    assert decode_pendant(0).faults == CONDITIONS
    assert decode_pendant(-1).faults == CONDITIONS
