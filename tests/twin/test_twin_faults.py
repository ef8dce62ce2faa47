"""Each fault as its words promise, seen in the frames."""

import math

import can
import numpy as np
import pytest

from deploy.puck import codec, messages
from deploy.twin.faults import ENCODERS, WORDS, Distortion, Fault, parse
from deploy.twin.lockstep import LockstepBus, LockstepClock
from deploy.twin.settings import TwinSettings
from deploy.twin.twin import Twin
from jaxmpc.files.errors import InputError

P, FT, STAT, MODE, ERROR = 48, 54, 5, 8, 4
START, DURATION = 20, 30
"""Of the faults below [ms]."""


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("force:stuck@12.0", Fault("force", "stuck", math.nan, 12.0, math.inf)),
        ("J2:off@3.0+0.1", Fault("J2", "off", math.nan, 3.0, 0.1)),
        ("frames:lost=0.001", Fault("frames", "lost", 0.001, 0.0, math.inf)),
        ("J1:lost=3@5", Fault("J1", "lost", 3.0, 5.0, math.inf)),
        ("puck3:fault@5", Fault("puck3", "fault", math.nan, 5.0, math.inf)),
        ("pendant:e-stop@5", Fault("pendant", "e-stop", math.nan, 5.0, math.inf)),
        ("bus:babble=8000@5+10", Fault("bus", "babble", 8000.0, 5.0, 10.0)),
        ("force:wrong", Fault("force", "wrong", 2.0, 0.0, math.inf)),
        ("J4:wrong", Fault("J4", "wrong", 200.0, 0.0, math.inf)),
        ("force:jump=-10", Fault("force", "jump", -10.0, 0.0, math.inf)),
    ],
)
def test_text_is_a_fault(text, fault):
    found = parse(text)
    assert (found.target, found.word, found.start, found.duration) == (
        fault.target,
        fault.word,
        fault.start,
        fault.duration,
    )
    assert found.value == fault.value or math.isnan(fault.value)


@pytest.mark.parametrize(
    ("text", "hint"),
    [
        ("force:stuk", "'stuck'"),
        ("forse:stuck", "'force'"),
        ("J5:off", "Known: force"),
        ("J1:nan", "a word of J1"),
        ("puck1:faul", "'fault'"),
        ("pendant:estop", "'e-stop'"),
        ("stuck", "TARGET:WORD"),
        ("force:stuck@soon", "its start"),
        ("force:stuck@1+x", "its duration"),
        ("force:wrong=much", "its value"),
        ("force:wrong=nan", "finite"),
        ("force:stuck@-1", "from 0 s on"),
        ("force:stuck@1+0", "longer than 0 s"),
        ("frames:lost", "with a value"),
        ("frames:late=-1", "0 or more"),
        ("bus:babble=1e9@5", "at most 20000 frames per second"),
        ("force:stuck=7@5", "without a value"),
        ("force:nan=1", "without a value"),
        ("J2:off=0.5", "without a value"),
        ("puck1:off=3@5", "without a value"),
        ("pendant:e-stop=1", "without a value"),
        ("bus:off=2", "without a value"),
        ("puck1:off@5+0.1", "an instant"),
        ("pendant:e-stop@5+1", "an instant"),
        ("force:intermittent=2", "at most 1"),
        ("commands:duplicated=3", "at most 1"),
        ("frames:lost=1.5", "whole number of frames"),
        ("force:unit=1e308", "at most 1e\\+09"),
        ("J1:unit=-1e308", "at most 1e\\+09"),
        ("force:delayed=1e30", "at most 1e\\+09"),
        ("", "TARGET:WORD"),
    ],
)
def test_a_wrong_word_is_told_with_a_remedy(text, hint):
    with pytest.raises(InputError, match=hint):
        parse(text)
    with pytest.raises(InputError):
        Twin(TwinSettings(faults=(text,)))


def run(fault, milliseconds=80, ask=(0x404, P), **settings):
    """Answers of each millisecond with a fault from `START` on for `DURATION`, and the same without it."""
    both = []
    for faults in ((f"{fault}@{1e-3 * START}+{1e-3 * DURATION}",), ()):
        twin = Twin(TwinSettings(**{"gap": 0.0, "faults": faults, "bias": (3.0, 4.0, 5.0)} | settings))
        answers = []
        for _ in range(milliseconds):
            twin.advance()
            twin.receive(codec.get(*ask))
            answers.append([codec.decode(frame) for frame in twin.take()])
        both.append(answers)
    return both


def forces(answers):
    """Of each millisecond, on the tissue; NaN where none came, shape (ms, 3)."""
    found = [[a.force for a in each if isinstance(a, messages.ForceReply)] for each in answers]
    return -np.array([each[0] if each else (math.nan,) * 3 for each in found])


def counts(answers, node):
    found = [[a.counts for a in each if isinstance(a, messages.Position) and a.node == node] for each in answers]
    return np.array([each[0] if each else math.nan for each in found])


DURING = slice(START - 1, START - 1 + DURATION)
"""Answers number k is that of millisecond k + 1."""


def outside(readings):
    return np.delete(readings, np.arange(80)[DURING], axis=0)


SENSOR = {
    "off": lambda faulty, clean: np.isnan(faulty).all(),
    "stuck": lambda faulty, clean: (faulty == clean[0]).all(),
    "garbage": lambda faulty, clean: np.ptp(faulty, axis=0).min() > 50.0,
    "wrong": lambda faulty, clean: np.allclose(faulty - clean, [0.0, 0.0, 2.0], atol=1 / 200),
    "wrong=-3": lambda faulty, clean: np.allclose(faulty - clean, [0.0, 0.0, -3.0], atol=1 / 200),
    "slow": lambda faulty, clean: (faulty == clean[[0] * 10 + [10] * 10 + [20] * 10]).all(),
    "slow=5": lambda faulty, clean: (faulty[:10] == clean[[0] * 5 + [5] * 5]).all(),
    "delayed": lambda faulty, clean: (faulty[20:] == clean[:10]).all(),
    "intermittent": lambda faulty, clean: 5 < np.isnan(faulty[:, 0]).sum() < 25,
    "sign": lambda faulty, clean: np.allclose(faulty, -clean, atol=1 / 200),
    "unit": lambda faulty, clean: np.allclose(np.abs(faulty), 128.0, atol=0.01),
    "jump": lambda faulty, clean: np.allclose(faulty - clean, [0.0, 0.0, 10.0], atol=1 / 200),
    "lost=0.5": lambda faulty, clean: 5 < np.isnan(faulty[:, 0]).sum() < 25,
}


@pytest.mark.parametrize("word", SENSOR)
def test_the_force_sensor_is(word):
    faulty, clean = (forces(answers) for answers in run(f"force:{word}", ask=(8, FT)))
    assert SENSOR[word](faulty[DURING], clean[DURING])
    np.testing.assert_array_equal(outside(faulty), outside(clean))


def test_a_saturated_force_is_flagged():
    faulty, _ = run("force:unit", ask=(8, FT))
    flags = [answers[0].flags for answers in faulty]
    assert flags[DURING] == [0x40] * DURATION
    assert not any(outside(np.array(flags)))


ENCODER = {
    "off": lambda faulty, clean: np.isnan(faulty).all(),
    "stuck": lambda faulty, clean: (faulty == clean[0]).all(),
    "garbage": lambda faulty, clean: np.ptp(faulty) > 1e6,
    "wrong": lambda faulty, clean: (faulty == clean + 200).all(),
    "delayed=5": lambda faulty, clean: (faulty[5:] == clean[:-5]).all(),
    "intermittent": lambda faulty, clean: 5 < np.isnan(faulty).sum() < 25,
    "sign": lambda faulty, clean: (faulty == -clean).all(),
    "unit=10": lambda faulty, clean: (faulty == 10 * clean).all(),
    "jump": lambda faulty, clean: (faulty == clean + 4096).all(),
}


@pytest.mark.parametrize("word", ENCODER)
def test_an_encoder_is(word):
    for joint in ("J2", "J4"):
        node = int(joint[1])
        faulty, clean = run(f"{joint}:{word}", posture=(0.1, 0.7, 0.1, 2.2))
        mine = counts(faulty, node), counts(clean, node)
        assert ENCODER[word](*(each[DURING] for each in mine))
        np.testing.assert_array_equal(*map(outside, mine))
        for other in {1, 2, 3, 4} - {node}:
            np.testing.assert_array_equal(counts(faulty, other), counts(clean, other))


def test_not_a_number_comes_by_the_hook_alone():
    """No frame can carry it."""
    for word, what in {"nan": math.isnan, "inf": lambda x: x == math.inf, "-inf": lambda x: x == -math.inf}.items():
        twin = Twin(TwinSettings(faults=(f"force:{word}@0.01+0.01",)))
        seen = []
        for _ in range(30):
            twin.advance()
            twin.receive(codec.get(8, FT))
            reply = codec.decode(twin.take()[0])
            assert np.isfinite(reply.force).all()
            seen.append(twin.force_hook(reply.force))
        assert [all(map(what, force)) for force in seen] == [10 <= k + 1 < 20 for k in range(30)]


# Frames.


@pytest.mark.parametrize(("target", "ids"), [("J3", [0x463]), ("positions", [0x423, 0x443, 0x463, 0x483])])
@pytest.mark.parametrize("count", [1, 2, 3])
def test_so_many_replies_in_a_row_are_lost(target, ids, count):
    twin = Twin(TwinSettings(faults=(f"{target}:lost={count}@0.01",)))
    lost = []
    for _ in range(30):
        twin.advance()
        twin.receive(codec.get(0x404, P))
        there = {frame.id for frame in twin.take()}
        lost += [each for each in (0x423, 0x443, 0x463, 0x483) if each not in there]
    assert len(lost) == count
    assert set(lost) <= set(ids)
    assert twin.counters["lost"] == count


def test_replies_are_lost_at_random_and_the_seed_decides():
    def lost(seed):
        twin = Twin(TwinSettings(seed=seed, faults=("positions:lost=0.05",)))
        there = []
        for _ in range(500):
            twin.receive(codec.get(0x404, P))
            there.append(tuple(frame.id for frame in twin.take()))
        return there

    missing = 4 * 500 - sum(map(len, lost(1)))
    # 100 expected, standard deviation 10.
    assert 60 < missing < 140
    assert lost(1) == lost(1)
    assert lost(1) != lost(2)


def test_late_replies_come_later_and_doubled_ones_twice():
    twin = Twin(TwinSettings(faults=("J1:late=2", "J2:duplicated")))
    twin.receive(codec.get(0x404, P))
    assert [frame.id for frame in twin.take()] == [0x443, 0x443, 0x463, 0x483]
    twin.advance()
    assert twin.take() == []
    twin.advance()
    assert [frame.id for frame in twin.take()] == [0x423]


def test_commands_can_be_lost():
    twin = Twin(TwinSettings(faults=("commands:lost=1",)))
    for answers in (0, 4):
        twin.receive(codec.get(0x404, P))
        assert len(twin.take()) == answers


# Pucks, pendant, bus.


def ask(twin, node, prop):
    twin.take()
    twin.receive(codec.get(node, prop))
    return [codec.decode(frame).value for frame in twin.take()]


def drive(faults, milliseconds=20):
    """An active arm under torque, with a fault at 10 ms."""
    twin = Twin(TwinSettings(faults=tuple(f"{fault}@0.01" for fault in faults)))
    twin.press("activate")
    told = []
    for _ in range(milliseconds):
        twin.receive(codec.get(0x404, P))
        twin.receive(codec.pack_torques((200, -500, 500, 300)))
        told += [(twin.tick, frame) for frame in twin.take()]
        twin.advance()
    return twin, [(tick, frame) for tick, frame in told if frame.id not in (0x423, 0x443, 0x463, 0x483)]


@pytest.mark.parametrize("late", [0.4, 1.0, 2.5, 30.0])
def test_late_commands_are_obeyed_late(late):
    """To the fraction of a millisecond, questions and torques alike."""
    twin = Twin(TwinSettings(faults=(f"commands:late={late}",)))
    twin.press("activate")
    twin.take()
    clock = LockstepClock(twin)
    bus = LockstepBus(clock)
    for frame in (codec.get(0x404, P), codec.pack_torques((0, -500, 500, 300))):
        bus.send(can.Message(arbitration_id=frame.id, data=frame.data, is_extended_id=False))

    def torques():
        return [puck.get(puck.number["T"]) for puck in twin.pucks]

    clock.wait_until(round(1e6 * late) - 1)
    assert (bus.recv(0.0), torques()) == (None, [0] * 4)
    came = []
    while (message := bus.recv(0.005)) is not None:
        came.append((message.arbitration_id, clock.now()))
    assert came == [(codec.encode_position(node, 0).id, round(1e6 * late)) for node in (1, 2, 3, 4)]
    assert torques() == [0, -500, 500, 300]
    bus.shutdown()


def test_late_commands_are_lost_where_the_bus_goes_off_meanwhile():
    twin = Twin(TwinSettings(faults=("commands:late=5", "bus:off@0.003")))
    twin.receive(codec.get(0x404, P))
    for _ in range(20):
        twin.advance()
        assert twin.take() == []


def test_a_puck_with_a_fault_falls_idle_and_says_so():
    twin, told = drive(["puck3:fault"])
    assert told[-1] == (10, codec.encode_property(3, STAT, 1))
    assert [ask(twin, 3, prop) for prop in (STAT, MODE, ERROR)] == [[1], [0], [2]]
    assert twin.pucks[2].torque == 0.0
    assert twin.pucks[1].torque != 0.0


def test_a_mute_one_says_nothing_and_an_off_one_is_gone():
    twin, told = drive(["puck3:mute"])
    assert [tick for tick, _ in told] == [0]
    assert ask(twin, 3, STAT) == [1]
    twin, told = drive(["puck3:off"])
    assert ask(twin, 3, STAT) == []
    assert ask(twin, 2, STAT) == [2]
    assert twin.pucks[2].torque == 0.0


def test_a_puck_that_resets_needs_to_be_woken():
    twin, _ = drive(["puck1:reset"])
    assert ask(twin, 1, STAT) == [0]
    assert ask(twin, 1, MODE) == []


@pytest.mark.parametrize(("button", "mode"), [("idle", 1), ("e-stop", 0)])
def test_the_pendant_is_pressed_under_way(button, mode):
    twin, _ = drive([f"pendant:{button}"], 10)
    assert ask(twin, 10, MODE) == [mode]
    assert not any(puck.driving for puck in twin.pucks)
    twin.advance()
    assert not any(twin.truth().torque)


def test_the_pendant_activates_by_itself():
    twin = Twin(TwinSettings(faults=("pendant:activate@0.005",)))
    modes = []
    for _ in range(10):
        modes.append(twin.safety.mode)
        twin.advance()
    assert modes == [1] * 5 + [2] * 5


def test_bus_off_is_silence_both_ways_and_then_the_safety_module_hears_nothing():
    twin, _ = drive(["bus:off"], 50)
    assert twin.bus_off
    assert twin.pucks[1].torque != 0.0
    assert ask(twin, 10, MODE) == []
    for _ in range(100):
        twin.advance()
    assert twin.safety.mode == 1


def test_a_babbling_node_fills_the_bus_with_foreign_frames():
    twin = Twin(TwinSettings(faults=("bus:babble=2500@0.01+0.04",)))
    heard = []
    for _ in range(100):
        twin.advance()
        heard += [(twin.tick, frame) for frame in twin.take()]
    assert len(heard) == 100
    assert {tick for tick, _ in heard} == set(range(10, 50))
    assert all(codec.decode(frame) is None and len(frame.data) == 8 for _, frame in heard)


@pytest.mark.parametrize("target", WORDS)
def test_every_word_of_every_target_can_be_run(target):
    """And leaves a twin that goes on."""
    for word in WORDS[target]:
        lasting = "" if target == "pendant" or target.startswith("puck") else "+0.01"
        twin = Twin(TwinSettings(faults=(f"{target}:{word}{'=0.5' if word == 'lost' else ''}@0.002{lasting}",)))
        twin.press("activate")
        for _ in range(20):
            twin.receive(codec.get(0x404, P))
            twin.receive(codec.get(8, FT))
            twin.receive(codec.pack_torques((0, -500, 500, 300)))
            twin.take()
            twin.advance()
        assert np.isfinite(twin.truth().q).all()
    assert len(ENCODERS) == 4


@pytest.mark.parametrize(
    "fault", ["force:unit=-1e9", "J1:unit=1e9", "J4:wrong=-1e9", "force:jump=1e9", "frames:late=1e9"]
)
def test_the_largest_values_leave_a_twin_that_goes_on(fault):
    twin = Twin(TwinSettings(faults=(fault,)))
    for _ in range(5):
        twin.receive(codec.get(0x404, P))
        twin.receive(codec.get(8, FT))
        twin.take()
        twin.advance()


@pytest.mark.parametrize("order", [("force:sign", "force:delayed=5"), ("force:delayed=5", "force:sign")])
def test_a_delay_does_not_undo_another_fault_of_the_sensor(order):
    distortion = Distortion("force", [parse(text) for text in order], np.random.default_rng(0))
    read = [distortion.read(tick, (0.0, 0.0, float(tick))) for tick in range(30)]
    assert [each[2] for each in read[5:]] == [-float(tick - 5) for tick in range(5, 30)]
