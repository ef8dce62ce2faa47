"""The force sensor as the host sees it."""

import numpy as np
import pytest

from deploy.puck import codec
from deploy.twin.scenario import motion_named
from deploy.twin.settings import TwinSettings
from deploy.twin.twin import Twin
from tests.twin.talking import MOTOR, active, ask, force, value, wait


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
