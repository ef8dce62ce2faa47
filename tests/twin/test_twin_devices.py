"""Pucks, safety module and force sensor as the host sees them: sequences of frames."""

import math

import numpy as np
import pytest

from deploy.puck import codec
from deploy.puck.frame import Frame
from deploy.puck.pendant import decode_pendant
from deploy.puck.properties import number
from deploy.twin.scenario import motion_named
from deploy.twin.settings import HOME, TwinSettings
from deploy.twin.twin import Twin
from jaxmpc.files.errors import InputError
from jaxmpc.law.transmission import JOINT_TO_MOTOR

QUIET = {"motion": motion_named("none"), "noise": 0.0, "lsb": (0.0, 0.0, 0.0)}
MOTOR = {name: number(name, "motor", 200) for name in ("STAT", "MODE", "P", "MT", "ERROR", "MECH", "CTS", "IPNM")}
SAFETY = {
    name: number(name, "safety", 200) for name in ("MODE", "PEN", "ZERO", "VL1", "VL2", "TL2", "IFAULT", "LOAD", "DEF")
}


def ask(twin, to, prop):
    """All answers to a question."""
    twin.take()
    twin.receive(codec.get(to, prop))
    return [codec.decode(frame) for frame in twin.take()]


def value(twin, to, prop):
    (reply,) = ask(twin, to, prop)
    assert (reply.node, reply.property) == (to, prop)
    return reply.value


def positions(twin):
    return {reply.node: reply.counts for reply in ask(twin, 0x404, MOTOR["P"])}


def force(twin):
    return ask(twin, 8, codec.FORCE_READING)[0]


def wait(twin, seconds, units=None):
    """Let time go by with the traffic of a control loop, or in silence."""
    for _ in range(round(1e3 * seconds)):
        if units is not None:
            twin.receive(codec.get(0x404, MOTOR["P"]))
            twin.receive(codec.pack_torques(units))
        twin.advance()
    return twin.take()


def pendant(twin):
    return decode_pendant(value(twin, 10, SAFETY["PEN"]))


def active(**settings):
    twin = Twin(TwinSettings(**(QUIET | settings)))
    twin.press("activate")
    return twin


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


def _frames(twin):
    twin.receive(codec.get(0x404, MOTOR["P"]))
    return twin.take()


def test_only_the_pendant_activates_and_software_only_lowers():
    twin = Twin(TwinSettings(**QUIET))
    assert value(twin, 10, SAFETY["MODE"]) == 1
    twin.receive(codec.set_value(10, SAFETY["MODE"], 2))
    assert value(twin, 10, SAFETY["MODE"]) == 1
    assert pendant(twin) == ("none", False, True, "0", *["SAFE"] * 5)
    twin.press("activate")
    assert value(twin, 10, SAFETY["MODE"]) == 2
    assert [value(twin, node, MOTOR["MODE"]) for node in codec.PUCKS] == [2] * 4
    assert pendant(twin)[:3] == ("activate", True, False)
    twin.receive(codec.set_value(10, SAFETY["MODE"], 1))
    assert value(twin, 10, SAFETY["MODE"]) == 1
    assert [value(twin, node, MOTOR["MODE"]) for node in codec.PUCKS] == [0] * 4
    with pytest.raises(InputError, match="activate"):
        twin.press("activte")


def test_the_safety_module_tells_the_pucks_in_frames_of_its_own():
    twin = Twin(TwinSettings(**QUIET))
    twin.press("activate")
    assert [frame.id for frame in twin.take()] == [0x540]
    assert codec.decode(Frame(0x540, bytes(6))) is None


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


def test_silence_idles():
    twin = active()
    wait(twin, 0.3, (0, -500, 500, 0))
    assert value(twin, 10, SAFETY["MODE"]) == 2
    wait(twin, 0.09)
    assert value(twin, 10, SAFETY["MODE"]) == 2
    wait(twin, 0.02)
    assert value(twin, 10, SAFETY["MODE"]) == 1
    assert pendant(twin).faults == ("heartbeat",)
    twin.press("idle")
    assert pendant(twin).faults == ()
    # Torques alone are not enough: the board wants to hear positions too.
    twin.press("activate")
    for _ in range(150):
        twin.receive(codec.pack_torques((0, 0, 0, 0)))
        twin.advance()
    assert pendant(twin).faults == ("heartbeat",)


def test_too_much_torque_idles():
    twin = active()
    wait(twin, 0.01, (0, 4800, 0, 0))
    assert pendant(twin).torque == "WARNING"
    wait(twin, 0.001, (0, 0, 0, 0))
    assert pendant(twin).torque == "SAFE"
    wait(twin, 0.001, (0, 0, -5300, 0))
    assert value(twin, 10, SAFETY["MODE"]) == 1
    assert pendant(twin).faults == ("torque",)


def test_too_much_speed_idles_and_then_cuts_the_power_if_it_lasts():
    twin = active(gap=0.2, tare_s=0.0)
    twin.receive(codec.set_value(10, SAFETY["VL2"], 800))
    for _ in range(400):
        wait(twin, 1e-3, (0, 1500, -1500, 0))
        if twin.safety.mode != 2:
            break
    assert pendant(twin).faults == ("velocity",)
    assert value(twin, 10, SAFETY["MODE"]) == 1
    # Shorted motors have stopped it by then.
    wait(twin, 1.0, (0, 0, 0, 0))
    assert value(twin, 10, SAFETY["MODE"]) == 1
    # With a limit of zero there is none.
    twin = active(gap=0.2)
    twin.receive(codec.set_value(10, SAFETY["VL2"], 0))
    wait(twin, 0.4, (0, 1500, -1500, 0))
    assert value(twin, 10, SAFETY["MODE"]) == 2


def test_an_arm_that_goes_on_moving_loses_its_power():
    """The positions on the bus say so, whatever the arm does: an encoder reads garbage."""
    twin = active(faults=("J4:garbage@0.05",))
    wait(twin, 0.7, (0, 0, 0, 0))
    assert value(twin, 10, SAFETY["MODE"]) == 0


def test_limits_come_back_from_memory():
    twin = Twin()
    twin.receive(codec.set_value(10, SAFETY["VL2"], 100))
    assert value(twin, 10, SAFETY["VL2"]) == 100
    twin.receive(codec.set_value(10, SAFETY["DEF"], SAFETY["VL2"]))
    twin.receive(codec.set_value(10, SAFETY["LOAD"], SAFETY["VL2"]))
    assert [value(twin, 10, SAFETY[name]) for name in ("VL1", "VL2", "TL2")] == [2048, 4096, 5204]


def test_the_emergency_stop_takes_power_and_positions_away():
    twin = active()
    wait(twin, 0.1, (0, -500, 500, 0))
    twin.press("e-stop")
    assert value(twin, 10, SAFETY["MODE"]) == 0
    assert pendant(twin)[0] == "e-stop"
    wait(twin, 0.5)
    assert pendant(twin)[0] == "e-stop"
    assert positions(twin) == {}
    assert ask(twin, 1, MOTOR["STAT"]) == []
    twin.press("activate")
    assert value(twin, 10, SAFETY["MODE"]) == 0
    twin.press("idle")
    assert value(twin, 10, SAFETY["MODE"]) == 1
    assert value(twin, 10, SAFETY["ZERO"]) == 0
    assert [value(twin, node, MOTOR["STAT"]) for node in codec.PUCKS] == [0] * 4
    twin.receive(codec.set_value(0x400, MOTOR["STAT"], 2))
    wait(twin, 0.25)
    assert all(0 <= counts < 4096 for counts in positions(twin).values())


def test_an_idle_arm_sinks_and_its_encoders_live():
    twin = active(gap=0.1)
    wait(twin, 0.05, (0, -500, 500, 150))
    before = positions(twin)
    twin.press("idle")
    wait(twin, 0.5)
    after = positions(twin)
    assert abs(after[2] - before[2]) > 50
    assert 0.0 < np.abs(twin.truth().qd).max() < 0.2


# The force sensor.


def test_a_force_reply_is_what_the_tissue_does_to_the_robot():
    """In the sensor's axes, in 1/256 N: y is the force on the tissue, so the sensor feels −y."""
    mount = ((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    twin = active(gap=0.0, mount=mount)
    wait(twin, 0.3, (0, -300, 300, 150))
    y = np.array(twin.truth().force)
    assert np.abs(y).max() > 0.5
    felt = np.array(force(twin).force)
    np.testing.assert_allclose(np.array(mount) @ felt, -y, atol=0.5 / 256 + 1e-12)
    assert [type(reply).__name__ for reply in ask(twin, 8, codec.FORCE_READING)] == ["ForceReply", "MomentReply"]


def test_a_sensor_on_the_tool_turns_with_it():
    settings = {"gap": 0.0, "frame": "tool"}
    twin = active(**settings)
    wait(twin, 0.3, (0, -300, 300, 150))
    orientation = twin.world.orientation
    assert abs(orientation[2, 2]) < 0.99
    np.testing.assert_allclose(orientation @ force(twin).force, -np.array(twin.truth().force), atol=1 / 256)
    (reply,) = ask(twin, 8, codec.ACCELERATION_READING)
    np.testing.assert_allclose(orientation @ reply.acceleration, [0.0, 0.0, 9.805], atol=2 / 1024)


def test_taring_takes_its_time_and_then_the_bias_and_the_tools_weight_are_gone():
    twin = Twin(TwinSettings(motion=motion_named("none"), bias=(0.5, -1.0, 2.0), beyond_sensor=0.1, lowpass_hz=0.0))
    np.testing.assert_allclose(force(twin).force, [-0.5, 1.0, -2.0 - 0.1 * 9.805], atol=0.1)
    twin.receive(codec.set_value(8, codec.FORCE_READING, 0))
    wait(twin, 0.5)
    assert force(twin) == ((0.0, 0.0, 0.0), 0x40)
    assert value(twin, 8, MOTOR["ERROR"]) == 0x7F
    wait(twin, 0.6)
    assert value(twin, 8, MOTOR["ERROR"]) == 0
    readings = []
    for _ in range(100):
        twin.advance()
        readings.append(force(twin).force)
    np.testing.assert_allclose(np.mean(readings, axis=0), 0.0, atol=0.01)
    assert np.std(readings, axis=0) == pytest.approx([0.010] * 3, rel=0.3)


def test_replies_take_their_time_on_a_wire_with_a_bit_rate():
    """The budget of wam.md §6: 57 µs for the question, 73 µs for each of four answers."""
    twin = Twin(TwinSettings(bit_rate=1e6))
    twin.receive(codec.get(0x404, MOTOR["P"]))
    assert twin.take() == []
    assert twin.next_ns() == 130_000
    assert len(twin.take(290_000)) == 3
    assert len(twin.take(349_000)) == 1
