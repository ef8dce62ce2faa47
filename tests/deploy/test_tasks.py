"""What tasks around contact ask for: ways that end, a servo that never pulls ever harder, what counts as a touch."""

from types import SimpleNamespace

import pytest

from deploy.loop.control import (
    DAMPING,
    INTEGRAL,
    LARGEST_ERROR,
    SOFTER,
    STIFFNESS,
    Contacting,
    TaskController,
)
from deploy.reference.sources import ConstantForce
from deploy.safety.machine import Task

T_S = 1e-3
REST = (0.0, 0.0, 0.0, 0.0)
TIP = (0.5, 0.1, 0.2)
WAYS = Contacting()


class Made(TaskController):
    """One whose runtime keeps what the servo asked of the tip [m/s²]."""

    def __init__(self):
        self.asked = []
        runtime = SimpleNamespace(
            servo=lambda q, qd, a, force: self.asked.append(a),
            enter=lambda force, q: None,
            control=lambda q, qd, force, wanted: REST,
        )
        super().__init__(runtime, ConstantForce((0.0, 0.0, -5.0)), T_S, WAYS)

    def __call__(self, task, z=0.0, x=0.0, active=True, velocity=(0.0, 0.0, 0.0)):
        tip = (TIP[0] + x, TIP[1], TIP[2] + z)
        self.torque(task, REST, REST, tip, velocity, None, active)
        return tip


def test_a_force_known_ahead_is_told_with_that_of_the_sample_first():
    """What is recorded and compared with the measured force is the same, however far the law looks."""

    def flown(ahead):
        told = []
        runtime = SimpleNamespace(
            enter=lambda force, q: None, control=lambda q, qd, force, wanted: told.append(wanted) or REST
        )
        controller = TaskController(runtime, ConstantForce((1.0, 0.0, -5.0)), T_S, WAYS, ahead, rate=5.0)
        recorded = []
        for _ in range(50):
            controller.torque(Task.CONTROL, REST, REST, TIP, (0.0, 0.0, 0.0), (0.0, 0.0, -1.0))
            recorded.append(controller.force_ref)
        return recorded, told

    blind, told = flown(0)
    known, seen = flown(4)
    assert told == blind == known
    assert blind[0] == (0.0, 0.0, -1.0)
    assert [tuple(zip(*window, strict=True)) for window in seen[:40]] == [tuple(blind[k : k + 5]) for k in range(40)]


@pytest.fixture
def made():
    return Made()


def test_an_approach_ends_where_it_may_go_no_farther(made):
    far = WAYS.approach_limit
    made(Task.APPROACH)
    assert not made.travelled(made(Task.APPROACH, -far + 1e-6))
    assert made.travelled(made(Task.APPROACH, -far - 1e-6))


@pytest.mark.parametrize(
    ("task", "way", "speed"),
    [
        (Task.APPROACH, WAYS.approach_limit + LARGEST_ERROR, WAYS.approach_speed),
        (Task.RETRACT, 2.0 * WAYS.retract_distance, WAYS.retract_speed),
    ],
)
def test_a_way_on_which_the_arm_is_held_back_ends_by_what_it_has_asked_for(made, task, way, speed):
    tip = made(task)
    for _ in range(round(way / speed / T_S) - 2):
        made(task)
    assert not made.travelled(tip)
    for _ in range(3):
        made(task)
    assert made.travelled(tip)


def test_a_retraction_ends_where_it_was_to_go_and_then_stands(made):
    far = WAYS.retract_distance
    made(Task.RETRACT)
    assert not made.travelled(made(Task.RETRACT, far - 1e-6))
    assert made.travelled(made(Task.RETRACT, far + 1e-6))
    # The reference is far behind this leap in both: what changes is the integral, and the speed that is none any more.
    change = -INTEGRAL * T_S * LARGEST_ERROR - DAMPING * WAYS.retract_speed
    assert made.asked[-1][2] - made.asked[-2][2] == pytest.approx(change)


def test_nothing_else_travels(made):
    for task in (Task.OFF, Task.HOLD, Task.CONTROL):
        made.torque(task, REST, REST, TIP, (0.0, 0.0, 0.0), None)
        assert not made.travelled((TIP[0], TIP[1], TIP[2] + 1.0))
        assert not made.travelled((TIP[0], TIP[1], TIP[2] - 1.0))


def test_a_servo_that_is_held_back_never_pulls_harder_than_its_bounds(made):
    made(Task.HOLD)
    for _ in range(5000):
        made(Task.HOLD, x=0.3)
    # The error, and the integral's share, count as LARGEST_ERROR each.
    assert made.asked[0] == (0.0, 0.0, 0.0)
    assert made.asked[1][0] == pytest.approx(-(STIFFNESS + INTEGRAL * T_S) * LARGEST_ERROR)
    assert made.asked[-1] == pytest.approx((-2.0 * STIFFNESS * LARGEST_ERROR, 0.0, 0.0))


def test_a_servo_damps_towards_its_own_speed(made):
    made(Task.APPROACH, velocity=(0.0, 0.0, -WAYS.approach_speed))
    still = made.asked[-1][2]
    made = Made()
    made(Task.APPROACH)
    assert made.asked[-1][2] - still == pytest.approx(-DAMPING * WAYS.approach_speed)


def test_an_arm_that_nobody_drives_is_held_where_it_is_and_a_driven_one_where_it_was(made):
    made(Task.HOLD, active=False)
    made(Task.HOLD, 0.01, active=False)
    assert made.asked[-1] == (0.0, 0.0, 0.0)
    made(Task.HOLD, 0.012)
    assert made.asked[-1][2] == pytest.approx(-(STIFFNESS + INTEGRAL * T_S) * 0.002)


@pytest.mark.parametrize("force", [(0.0, 0.0, -0.31), (0.0, 0.0, 0.31), (0.31, 0.0, 0.0), (0.2, -0.2, 0.15)])
def test_whatever_way_a_tissue_drags_it_is_touched(made, force):
    assert made.touching(force)
    assert not made.touching(tuple(0.9 * each for each in force))
    assert not made.touching(None)


def test_depth_is_counted_from_the_contact_downwards(made):
    made(Task.APPROACH)
    met = made(Task.CONTROL, -0.01)
    deeper = made(Task.CONTROL, -0.013)
    assert (made.depth(met), made.depth(deeper)) == pytest.approx((0.0, 0.003))
    made(Task.RETRACT, -0.013)
    assert made.depth(deeper) == 0.0


def test_a_servo_that_was_softened_is_the_same_one_slowed():
    """Poles a share s as fast: k_p falls by s², k_i by s³, k_d by s; and its integral holds back as much of e."""
    made = Made()
    made(Task.HOLD)
    made.soften()
    made.soften()
    share = SOFTER**2
    made(Task.HOLD, z=0.01)
    assert made.asked[-1][2] == pytest.approx(-(share**2) * STIFFNESS * 0.01 - share**3 * INTEGRAL * 0.01 * T_S)
    made(Task.HOLD, velocity=(0.0, 0.0, 0.1))
    assert made.asked[-1][2] == pytest.approx(-share * DAMPING * 0.1 - share**3 * INTEGRAL * 0.01 * T_S)
    for _ in range(round(1.0 / (share * T_S))):
        made(Task.HOLD, z=0.05)
    assert made.asked[-1][2] == pytest.approx(-2.0 * share**2 * STIFFNESS * LARGEST_ERROR)
