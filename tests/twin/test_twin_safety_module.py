"""Safety module and pendant as the host sees them: who activates the arm, and what lowers it."""

import numpy as np
import pytest

from deploy.puck import codec
from deploy.puck.frame import Frame
from deploy.twin.settings import TwinSettings
from deploy.twin.twin import Twin
from jaxmpc.files.errors import InputError
from tests.twin.talking import MOTOR, QUIET, SAFETY, active, ask, pendant, positions, value, wait


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
    # Zero torque clears a warning (wam.md §3.5); a fault waits for somebody at the pendant.
    for units in ((0, 0, 0, 0), (0, 4800, 0, 0)):
        wait(twin, 0.001, units)
        assert pendant(twin).faults == ("torque",)
    twin.press("idle")
    assert pendant(twin).faults == ()


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


def test_so_it_does_after_too_much_torque():
    """What was wrong first does not matter: the arm moves too fast half a second after it was made idle."""
    for began, limit, mode in ((0.3, 4096, 0), (1.0, 4096, 1), (0.3, 0, 1)):
        twin = active(faults=(f"J4:garbage@{began}+0.6",))
        twin.receive(codec.set_value(10, SAFETY["VL2"], limit))
        wait(twin, 0.1, (0, 0, -5300, 0))
        assert pendant(twin).faults == ("torque",)
        wait(twin, 0.8, (0, 0, 0, 0))
        assert value(twin, 10, SAFETY["MODE"]) == mode


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
