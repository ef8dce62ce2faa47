"""On the way out the servo gives way to a beat that rises against the tip."""

from types import SimpleNamespace

import pytest

from deploy.loop import control
from deploy.loop.control import DAMPING, LARGEST_PUSH, LETTING_UP, YIELDING, Contacting, TaskController
from deploy.reference.sources import ConstantForce
from deploy.safety.machine import OperatingState, Task
from deploy.safety.reasons import Reason
from tests.twin.flying import fly

RISING = {"stiffness": 1900.0, "seconds": 3.2, "reference": "0,0,-10@5", "gap": 0.012, "rhythm": "steady"}
"""Contact ends as a beat begins to rise."""
STIFF = {"coulomb": (4.0, 4.5, 2.2, 1.3), "mass_scale": 1.1}
"""An arm with twice the friction and a tenth more mass."""
ZERO, T_S = (0.0, 0.0, 0.0), 0.001


def pushed_out(flight):
    """Largest true push on the way out [N]."""
    out = [state.state is OperatingState.RETRACT for state in flight.safety_states]
    first, last = flight.time[out][[0, -1]]
    return float(-flight.force[(flight.force_time >= first) & (flight.force_time <= last), 2].min())


@pytest.mark.oracle
@pytest.mark.parametrize("arm", [{}, STIFF, {"delay": 2}])
@pytest.mark.parametrize("touching", [False, True])
def test_a_beat_that_rises_presses_little_more_than_was_wanted(cautious, arm, touching):
    flight = fly(cautious, touching=touching, **RISING, **arm)
    assert flight.reason is Reason.FINISHED
    assert pushed_out(flight) < 11.0


@pytest.mark.oracle
@pytest.mark.parametrize(("arm", "least"), [({}, 13.0), (STIFF, 15.5)])
def test_a_servo_that_does_not_give_way_presses_half_as_much_again_and_says_so(cautious, monkeypatch, arm, least):
    """The check can fail: it is what happens without."""
    monkeypatch.setattr(control, "YIELDING", 0.0)
    flight = fly(cautious, **RISING, **arm)
    assert flight.reason is (Reason.FORCE if arm else Reason.OVERSHOOT)
    assert pushed_out(flight) > least


def asked(task, pushes):
    """Accelerations that the servo asks for along the normal at these pushes [N], the tip at rest [m/s²]."""
    found = []
    runtime = SimpleNamespace(servo=lambda q, qd, a, force: found.append(a[2]))
    controller = TaskController(runtime, ConstantForce((0.0, 0.0, -5.0)), T_S, Contacting())
    for push in pushes:
        force = None if push is None else (0.3, -0.2, -push)
        controller.torque(task, (0.0,) * 4, (0.0,) * 4, ZERO, ZERO, force)
    return found


def added(pushes):
    """What those pushes add to the acceleration [m/s²]."""
    return [
        with_push - without
        for with_push, without in zip(
            asked(Task.RETRACT, pushes), asked(Task.RETRACT, [None] * len(pushes)), strict=True
        )
    ]


def test_nothing_jumps_where_the_servo_takes_over():
    assert added([5.0])[0] == 0.0
    assert asked(Task.RETRACT, [5.0])[0] == pytest.approx(DAMPING * Contacting().retract_speed, rel=0.02)


def test_what_is_pressed_beyond_a_falling_bound_lifts_the_tip():
    fallen = LETTING_UP * T_S
    assert added([5.0, 5.0, 5.0 - 2.0 * fallen])[1:] == pytest.approx([YIELDING * fallen, 0.0])
    steps = round(5.0 / fallen) + 1  # the bound is 0 by then
    assert added([5.0] * steps + [1.0])[-1] == pytest.approx(YIELDING * 1.0)


def test_it_adds_no_more_than_a_bound_and_nothing_to_a_pull():
    assert added([1.0, 30.0])[-1] == pytest.approx(YIELDING * LARGEST_PUSH)
    assert added([1.0, -3.0, -8.0])[1:] == [0.0, 0.0]
    assert added([-4.0, -4.0, 1.0])[-1] == pytest.approx(YIELDING * 1.0)


def test_no_other_task_gives_way():
    for task in (Task.APPROACH, Task.HOLD):
        assert asked(task, [0.0, 9.0]) == asked(task, [None, None])
