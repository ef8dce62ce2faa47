import math
import os
import random
import time
from importlib import resources
from itertools import pairwise, product

import numpy as np
import pytest

from deploy.reference import parse
from deploy.reference.parse import from_text
from deploy.reference.segments import from_table
from deploy.reference.sources import ConstantForce, ForceTable, Lines
from deploy.reference.stream import Stream
from jaxmpc.files.errors import InputError

T_S = 1e-3


class Garbage:
    """Wants anything at all."""

    def __init__(self, seed):
        self.draw = random.Random(seed)

    def wanted(self, t):
        kinds = (math.nan, math.inf, -math.inf, 1e300, -1e300, 0.0, 5.0, self.draw.gauss(0.0, 10.0))
        return tuple(self.draw.choice(kinds) for _ in range(3))

    def notes(self):
        return []


def run(stream, samples, T_s=T_S):
    return [stream.at(k * T_s) for k in range(samples)]


@pytest.mark.parametrize("seed", range(3))
def test_garbage_can_neither_jump_nor_grow(seed):
    forces = run(Stream(Garbage(seed), T_S, (0.0, 0.0, -1.0), rate=5.0, largest=6.0), 5000)
    assert forces[0] == (0.0, 0.0, -1.0)
    assert max(math.dist(a, b) for a, b in pairwise(forces)) <= 5.0 * T_S * (1.0 + 1e-12)
    assert max(math.hypot(*force) for force in forces) <= 6.0 * (1.0 + 1e-12)
    assert len(set(forces)) > 1000


def test_a_constant_is_reached_at_its_rate_and_kept():
    forces = run(Stream(ConstantForce((3.0, 0.0, -4.0)), T_S, rate=2.0), 3000)
    assert forces[1000] == pytest.approx((1.2, 0.0, -1.6), abs=1e-12)
    assert forces[2499] != (3.0, 0.0, -4.0)
    assert forces[2501:] == [(3.0, 0.0, -4.0)] * 499


def test_what_is_wanted_beyond_the_largest_force_becomes_that_force():
    """It goes there straight, and rests: a swaying source alone would not come so far."""
    forces = run(Stream(ConstantForce((0.0, 12.0, -16.0)), T_S, rate=100.0, largest=6.0), 1000)
    assert forces[-1] == pytest.approx((0.0, 3.6, -4.8), abs=1e-12)


def test_missed_samples_are_followed_no_faster_than_three_at_once():
    stream = Stream(ConstantForce((0.0, 0.0, -5.0)), T_S, rate=2.0)
    stream.at(0.0)
    before = stream.at(0.010)
    assert before[2] == pytest.approx(-3 * 0.002)
    assert stream.at(0.010) == before
    assert stream.at(0.005) == before
    assert stream.at(100.0)[2] == pytest.approx(-6 * 0.002)
    assert stream.at(100.001)[2] == pytest.approx(-7 * 0.002)


@pytest.mark.parametrize("ahead", [1, 5, 64])
def test_preview_is_what_is_wanted_and_what_comes(ahead):
    table = ForceTable([0.0, 0.1, 0.2, 0.3], [(0.0, 0.0, 0.0), (0.1, 0.0, -0.4), (0.0, 0.2, -0.1), (0.0, 0.0, 0.0)])
    seen = run(Stream(table, T_S, rate=100.0, ahead=ahead), 400)
    plain = Stream(table, T_S, rate=100.0)
    came = run(plain, 400 + ahead)
    for k, window in enumerate(seen):
        assert len(window) == 3
        assert [len(axis) for axis in window] == [1 + ahead] * 3
        assert list(zip(*window, strict=True)) == came[k : k + 1 + ahead]


def test_a_measured_start_that_is_no_number_becomes_zero():
    assert Stream(ConstantForce((0.0, 0.0, 0.0)), T_S, (math.nan, 0.0, 0.0)).at(0.0) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("limits", [{"rate": 0.0}, {"rate": math.inf}, {"largest": -1.0}, {"largest": math.nan}])
def test_limits_must_limit(limits):
    with pytest.raises(InputError, match="positive and finite"):
        Stream(ConstantForce((0.0, 0.0, 0.0)), T_S, **limits)


def test_a_table_is_interpolated_and_held():
    table = ForceTable([1.0, 2.0, 4.0], [(0.0, 0.0, -1.0), (1.0, 0.0, -3.0), (0.0, 2.0, -3.0)], "f.csv")
    assert table.notes() == []
    asked = [0.0, 1.0, 1.5, 2.0, 3.0, 4.0, 9.0, 1.5]
    wanted = [(0, 0, -1), (0, 0, -1), (0.5, 0, -2), (1, 0, -3), (0.5, 1, -3), (0, 2, -3), (0, 2, -3), (0.5, 0, -2)]
    assert [table.wanted(t) for t in asked] == wanted
    assert table.notes() == ["f.csv: ended at 4 s, its last force was held"]


def test_ramps():
    table = from_text("ramps:0,0,-5@2 hold@5 0,0,2@1 0,0,2@1", rate=2.0)
    times = [0.0, 1.0, 2.5, 7.0, 7.5, 10.5, 14.5, 20.0]
    assert [table.wanted(t)[2] for t in times] == [0.0, -2.0, -5.0, -5.0, -5.0, -2.0, 2.0, 2.0]


def test_fig_3b_needs_no_more_than_its_ramps():
    table = from_text("ramps:0,0,2@2 hold@5 0,0,-5@2 hold@5", start=(0.0, 0.0, 0.0))
    assert [table.wanted(t)[2] for t in (0.5, 1.0, 6.0, 8.0, 9.5, 20.0)] == [1.0, 2.0, 2.0, -2.0, -5.0, -5.0]


def test_a_sweep_stands_on_the_force_reached_and_leaves_it_there():
    source = from_text("ramps:0,0,-5@5 sweep@0,1,2@0.25@1@4 hold@1", rate=20.0)
    assert source.wanted(1.0) == (0.0, 0.0, -5.0)
    since = 1.5
    sine = math.sin(2.0 * math.pi * (0.25 + 0.5 * 0.1875 * since) * since)
    assert source.wanted(1.0 + since) == pytest.approx((0.0, sine, -5.0 + 2.0 * sine), abs=1e-12)
    assert source.wanted(9.0) == (0.0, 0.0, -5.0)
    assert source.notes() == ["reference: ended at 6 s, its last force was held"]


@pytest.mark.parametrize("name", ["table-1", "figure-3", "figure-3-wam", "table-1-wam"])
def test_an_experiments_table_is_flown_as_it_is_simulated(name):
    pytest.importorskip("jax")
    from jaxmpc import Experiment

    path = resources.files("jaxmpc.experiment") / "published" / f"{name}.toml"
    source = from_text(str(path), rate=20.0)
    simulated = Experiment.published(name).signals.force_ref
    flown = [source.wanted(1e-3 * k) for k in range(len(simulated))]
    np.testing.assert_allclose(flown, simulated, rtol=0.0, atol=1e-12)


def test_the_robot_knows_the_segments_of_the_experiments_and_their_bounds():
    msgspec = pytest.importorskip("msgspec")
    from jaxmpc.experiment.reference import Reference

    wrong, right = [-1.0, 0.0, 0.5, 100.0, 101.0, 500.0, 501.0, 1e4, 1.1e4, True, "1"], 0
    kinds = {"hold": ["duration"], "ramp": ["to", "rate"], "sweep": ["amplitude", "start", "stop", "duration"]}
    for kind, names in kinds.items():
        for name, value in product([*names, "typo"], wrong):
            segment = {"kind": kind, **dict.fromkeys(names, 1.0), name: value}
            try:
                msgspec.convert({"z": [segment]}, Reference)
                allowed = True
            except msgspec.ValidationError:
                allowed = False
            try:
                from_table({"z": [segment]}, rate=1e9, largest=1e9)
            except InputError:
                assert not allowed, segment
            else:
                assert allowed, segment
                right += 1
    assert right > 30


def test_words_that_are_none_ask_for_no_force():
    for text in ("ramps:", "ramps: \t"):
        with pytest.raises(InputError, match=r"For example 0,0,-5@2 hold@5"):
            from_text(text)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ("[motion]", r"a table \[reference\]"),
        ("reference = 1", r"a table \[reference\]"),
        ("[reference]\nzz = 1", "zz"),
        ("[reference]\nz = -11", "at most 10 N"),
        ("[reference]\nz = nan", r"a number in \[-100, 100\]"),
        ('[reference]\nz = [{kind = "romp"}]', "Did you mean 'ramp'"),
        ('[reference]\nz = ["ramp"]', "a known kind"),
        ('[reference]\nz = [{kind = "ramp", to = -5}]', "rate = missing"),
        ('[reference]\nz = [{kind = "ramp", to = -5, rate = 6}]', "at most 5 N/s fast"),
        (
            '[reference]\nz = [{kind = "sweep", amplitude = 9, start = 0.01, stop = 1, duration = 9}]',
            "at most 5 N/s fast",
        ),
        ("[reference]\nx = 8\ny = -7", "at most 10 N"),
        (
            '[reference]\nz = [{kind = "hold"}, {kind = "ramp", to = -5, rate = 2}]',
            r"reference.z\[0\].duration = missing: must be given \[s\] before another segment",
        ),
        ("[reference", "TOML"),
    ],
)
def test_a_wrong_table_is_refused_with_its_file(tmp_path, table, message):
    path = tmp_path / "e.toml"
    path.write_text(table)
    with pytest.raises(InputError, match=message) as caught:
        from_text(str(path))
    assert str(caught.value).startswith(f"{path}:")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("ramps:sweep@0,0,1@1@2", "X,Y,Z@RATE"),
        ("ramps:sweep@0,0,1@0@2@1", "X,Y,Z@RATE"),
        ("ramps:0,0,-5@2 sweep@0,0,6@0.01@0.02@9", "at most 10 N"),
        ("0,0", "X,Y,Z"),
        ("0,0,x", "X,Y,Z"),
        ("0,0,nan", "X,Y,Z"),
        ("no-such-file.csv", "existing file"),
        ("0,0,-11", "at most 10 N"),
        ("ramps:0,0,-5", "X,Y,Z@RATE"),
        ("ramps:0,0,-5@0", "X,Y,Z@RATE"),
        ("ramps:0,0,-5@inf", "X,Y,Z@RATE"),
        ("ramps:0,0,-5@9", "at most 5 N/s fast"),
        ("ramps:0,0,-50@1", "at most 10 N"),
        ("ramps:wait@1", "X,Y,Z@RATE"),
        ("ramps:hold@x", "hold@SECONDS"),
    ],
)
def test_wrong_words_are_refused(text, message):
    with pytest.raises(InputError, match=message):
        from_text(text)


def test_a_constant_from_words():
    assert from_text("0,0,-5") == ConstantForce((0.0, 0.0, -5.0))
    assert ConstantForce((0.0, 0.0, -5.0)).notes() == []


def write(tmp_path, text):
    path = tmp_path / "f.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return str(path)


@pytest.mark.parametrize(
    "text", ["t,x,y,z\n0,0,0,0\n2, 0.0, 0.0, -5\n\n", b"\xef\xbb\xbft,x,y,z\r\n0,0,0,0\r\n2,0,0,-5"]
)
def test_a_file(tmp_path, text):
    table = from_text(write(tmp_path, text))
    assert table.wanted(1.0) == (0.0, 0.0, -2.5)
    table.wanted(3.0)
    assert table.notes() == ["f.csv: ended at 2 s, its last force was held"]


@pytest.mark.parametrize(
    ("text", "line", "message"),
    [
        ("", None, "at least one"),
        ("0,0,0,0\n", 1, "t,x,y,z"),
        ("t,x,y,z\n", None, "at least one"),
        ("t,x,y,z\n0,0,0\n", 2, "four finite numbers"),
        ("t,x,y,z\n0,0,0,0\n1,0,0,nan\n", 3, "four finite numbers"),
        ("t,x,y,z\n0,0,0,0\n1,0,0,a\n", 3, "four finite numbers"),
        ("t,x,y,z\n0,0,0,0\n0,0,0,-1\n", 3, "above 0 s"),
        ("t,x,y,z\n0,0,0,0\n9,0,0,-12\n", 3, "at most 10 N"),
        ("t,x,y,z\n0,0,0,0\n1,0,0,-6\n", 3, "at most 5 N/s"),
        ("t,x,y,z\n10,0,0,0\n11,0,0,-6\n", 3, "at most 5 N/s"),
        (b"t,x,y,z\n0,0,0,\xff\n", None, "UTF-8"),
    ],
)
def test_wrong_files_are_refused_with_their_line(tmp_path, text, line, message):
    path = write(tmp_path, text)
    with pytest.raises(InputError, match=message) as caught:
        from_text(path)
    assert str(caught.value).startswith(f"{path}:{line}: " if line else f"{path}: ")


def test_files_that_cannot_be_read_or_are_too_long(tmp_path, monkeypatch):
    with pytest.raises(InputError, match="cannot be read"):
        from_text(str(tmp_path))
    monkeypatch.setattr(parse, "_LARGEST_FILE", 10)
    with pytest.raises(InputError, match="more than 10"):
        from_text(write(tmp_path, "t,x,y,z\n0,0,0,0\n"))


class Pipe:
    def __init__(self):
        self.reading, self.writing = os.pipe()
        self.lines = Lines(self.reading, (0.0, 0.0, -1.0), largest=10.0)

    def say(self, data):
        os.write(self.writing, data)

    def until(self, condition):
        end = time.monotonic() + 10.0
        while not condition() and time.monotonic() < end:
            time.sleep(0.001)
        assert condition()


@pytest.fixture
def pipe():
    pipe = Pipe()
    yield pipe
    if pipe.writing is not None:
        os.close(pipe.writing)
    pipe.until(lambda: pipe.lines._ended)
    os.close(pipe.reading)


def test_lines_the_last_valid_one_counts_and_the_end_holds(pipe):
    lines = pipe.lines
    assert lines.wanted(0.0) == (0.0, 0.0, -1.0)
    pipe.say(b"0 0 -2\n1,2,")
    pipe.until(lambda: lines.lines == 1)
    assert lines.wanted(0.0) == (0.0, 0.0, -2.0)
    pipe.say(b"-3\n\n")
    pipe.until(lambda: lines.lines == 2)
    assert lines.wanted(0.0) == (1.0, 2.0, -3.0)
    pipe.say(b"0 0 -4")
    os.close(pipe.writing)
    pipe.writing = None
    pipe.until(lambda: lines._ended)
    assert lines.wanted(0.0) == (0.0, 0.0, -4.0)
    assert lines.notes() == ["reference: 3 lines taken", "reference: its stream has ended, the last force was held"]


@pytest.mark.parametrize(
    "line",
    [
        *(
            b"0 0",
            b"0 0 0 0",
            b"a b c",
            b"nan 0 0",
            b"0 0 -inf",
            b"0 0 -10.1",
            b"\xff\xfe 0 0",
            b"0 0 -0." + b"0" * 300,
        ),
        *(b"0,0,,-3", b"0,,-3", b"0,0,-3,", b"1_0 0 0", b"0 0 -1\r0 0 -3"),
    ],
)
def test_malformed_lines_are_counted_said_and_change_nothing(pipe, line):
    pipe.say(line + b"\n0 0 -2\n")
    pipe.until(lambda: pipe.lines.lines == 1)
    assert pipe.lines.wanted(0.0) == (0.0, 0.0, -2.0)
    assert pipe.lines.refused == 1
    assert "1 lines refused, the first was" in pipe.lines.notes()[1]


def test_an_endless_line_keeps_no_memory(pipe):
    for _ in range(50):
        pipe.say(b"1" * 4096)
    pipe.until(lambda: pipe.lines.refused)  # whoever ends his lines otherwise is told, too
    pipe.say(b" 0 0 0\n0 0 -2\n")
    pipe.until(lambda: pipe.lines.lines == 1)
    assert pipe.lines.refused == 1
    assert pipe.lines.wanted(0.0) == (0.0, 0.0, -2.0)


def test_a_stream_says_what_its_source_says(pipe):
    assert Stream(pipe.lines, T_S).notes() == ["reference: 0 lines taken"]
    assert isinstance(from_text("0,0,0"), ConstantForce)
