"""Pucks as the host sees them: sequences of frames."""

import math

import numpy as np
import pytest

from deploy.puck import codec
from deploy.puck.frame import Frame
from deploy.puck.properties import number
from deploy.twin.settings import HOME, TwinSettings
from deploy.twin.twin import Twin
from jaxmpc.law.transmission import JOINT_TO_MOTOR
from tests.twin.talking import MOTOR, QUIET, SAFETY, active, ask, positions, value, wait


def test_enumeration_finds_the_nodes_of_a_four_joint_arm():
    twin = Twin()
    found = [node for node in range(1, 32) if ask(twin, node, MOTOR["STAT"])]
    assert found == [1, 2, 3, 4, 8, 10]


def test_properties_are_those_that_were_set_up():
    twin = Twin(TwinSettings(counts=40960, ipnm=(2700.0, 2562.0, 2562.0, 2472.0)))
    for i, node in enumerate(codec.PUCKS):
        named = {name: value(twin, node, number(name, "motor", 200)) for name in ("VERS", "CTS", "IPNM", "PIDX", "MT")}
        assert named == {
            **{"VERS": 200, "CTS": 40960, "IPNM": (2700, 2562, 2562, 2472)[i], "PIDX": node},
            "MT": 4320 if node == 4 else 4860,
        }
        groups = [value(twin, node, number(name, "motor", 200)) for name in ("GRPA", "GRPB", "GRPC")]
        assert groups == [0, 1, 4]
    assert [value(twin, node, 1) & 0x1F for node in (1, 8, 10)] == [0, 6, 2]
    # What does not exist is not answered, and nobody falls over foreign frames.
    assert ask(twin, 1, 127) == ask(twin, 5, 0) == []
    for frame in (Frame(0x7FF, b""), Frame(0x123, b"12345678"), Frame(0x404, b""), Frame(0x401, b"\xaa")):
        twin.receive(frame)
    assert twin.take() == []


def test_waking_takes_a_while_and_only_the_monitor_answers_before():
    twin = Twin(TwinSettings(cold=True))
    assert [value(twin, node, MOTOR["STAT"]) for node in codec.PUCKS] == [0] * 4
    assert [ask(twin, 1, MOTOR["CTS"]), ask(twin, 1, MOTOR["P"]), ask(twin, 8, codec.FORCE_READING)] == [[], [], []]
    twin.receive(Frame(0x400, bytes.fromhex("85000200")))
    assert ask(twin, 1, MOTOR["STAT"]) == []
    assert value(twin, 8, MOTOR["STAT"]) == 0
    wait(twin, 0.25)
    assert [value(twin, node, MOTOR["STAT"]) for node in codec.PUCKS] == [2] * 4
    twin.receive(codec.set_value(8, MOTOR["STAT"], 2))
    wait(twin, 0.25)
    assert value(twin, 8, MOTOR["STAT"]) == 2


def test_a_cold_arm_is_at_home_and_learns_where_that_is():
    """Positions lost, but absolute within a turn; after the host has told them they follow the arm being carried."""
    twin = Twin(TwinSettings(cold=True))
    twin.receive(codec.set_value(0x400, MOTOR["STAT"], 2))
    wait(twin, 0.25)
    home = np.floor(np.array(JOINT_TO_MOTOR) @ HOME * 4096 / (2 * math.pi)).astype(int)
    for node, counts in positions(twin).items():
        assert 0 <= counts < 4096
        assert counts == value(twin, node, MOTOR["MECH"])
        assert abs((counts - home[node - 1] + 2048) % 4096 - 2048) <= 1
    assert value(twin, 10, SAFETY["ZERO"]) == 0
    for node, counts in zip(codec.PUCKS, home.tolist(), strict=True):
        twin.receive(codec.set_value(node, MOTOR["P"], counts))
    twin.receive(codec.set_value(10, SAFETY["ZERO"], 1))
    assert list(positions(twin).values()) == home.tolist()
    assert value(twin, 10, SAFETY["ZERO"]) == 1
    # Folded beside the heart it is lower than its surface, and does not touch it.
    assert not twin.truth().touching
    twin.carry()
    largest = 0
    for _ in range(2000):
        before = twin.truth().q
        twin.advance()
        largest = max(largest, np.abs(np.subtract(twin.truth().q, before)).max())
    # By hand, not through the air: no encoder jumps.
    assert largest < 4e-3
    np.testing.assert_allclose(twin.truth().q, twin.world.posture, atol=1e-12)
    wanted = np.array(JOINT_TO_MOTOR) @ twin.truth().q * 4096 / (2 * math.pi)
    np.testing.assert_allclose(list(positions(twin).values()), wanted, atol=2.0)


def test_positions_are_the_motors_angles():
    twin = Twin(TwinSettings(**QUIET))
    wanted = np.array(JOINT_TO_MOTOR) @ twin.truth().q * 4096 / (2 * math.pi)
    np.testing.assert_allclose(list(positions(twin).values()), wanted, atol=0.5)
    assert [frame.id for frame in _frames(twin)] == [0x423, 0x443, 0x463, 0x483]


def test_a_group_reaches_those_who_are_in_it():
    twin = Twin(TwinSettings(**QUIET))
    assert ask(twin, 0x405, MOTOR["P"]) == []
    twin.receive(codec.set_value(3, number("GRPC", "motor", 200), 5))
    assert set(positions(twin)) == {1, 2, 4}
    assert [reply.node for reply in ask(twin, 0x405, MOTOR["P"])] == [3]


def _frames(twin):
    twin.receive(codec.get(0x404, MOTOR["P"]))
    return twin.take()


def test_torque_is_ignored_unless_the_mode_is_torque():
    twin = Twin(TwinSettings(**QUIET))
    wait(twin, 0.01, (0, 500, 0, 0))
    assert not any(twin.truth().torque)
    twin.press("activate")
    wait(twin, 0.01, (100, 500, 0, -200))
    wanted = np.array(JOINT_TO_MOTOR).T @ np.array([100, 500, 0, -200]) / 2700.0
    np.testing.assert_allclose(twin.truth().torque, wanted, atol=1e-12)
    # It is held until the next frame, and saturates at MT.
    twin.receive(codec.pack_torques((5000, 0, 0, 5000)))
    wait(twin, 0.003)
    np.testing.assert_allclose(twin.truth().torque, np.array(JOINT_TO_MOTOR).T @ [1.8, 0.0, 0.0, 1.6], atol=1e-12)
    # Idle takes it away at once.
    twin.receive(codec.set_value(0x404, MOTOR["MODE"], 0))
    twin.advance()
    assert not any(twin.truth().torque)


def test_a_torque_in_units_of_another_puck_is_another_torque():
    twin = active(ipnm=(2472.0, 2700.0, 2700.0, 2700.0))
    wait(twin, 0.005, (1000, 0, 0, 0))
    assert twin.truth().torque[0] == pytest.approx(-42.0 * 1000 / 2472)


def test_the_host_that_sets_torque_mode_is_counted():
    twin = Twin()
    twin.receive(codec.set_value(0x400, MOTOR["MODE"], 2))
    assert twin.counters["torque mode set by the host"] == 4


def test_replies_take_their_time_on_a_wire_with_a_bit_rate():
    """The budget of wam.md §6: 57 µs for the question, 73 µs for each of four answers."""
    twin = Twin(TwinSettings(bit_rate=1e6))
    twin.receive(codec.get(0x404, MOTOR["P"]))
    assert twin.take() == []
    assert twin.next_ns() == 130_000
    assert len(twin.take(290_000)) == 3
    assert len(twin.take(349_000)) == 1
