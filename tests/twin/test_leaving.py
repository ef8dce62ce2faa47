"""How contact ends as planned: the law lets the force down and lifts the tip off before the stiff servo takes it."""

from types import SimpleNamespace

import numpy as np
import pytest

from deploy.loop.control import EASING, LEAVING, LIFTED, PULL, Contacting, TaskController
from deploy.reference.sources import ConstantForce
from deploy.safety.machine import OperatingState, Task
from deploy.safety.reasons import Reason
from deploy.twin.flight import Pilot
from tests.twin.flying import fly

RISING = {"stiffness": 1900.0, "seconds": 3.2, "reference": "0,0,-10@5", "gap": 0.012, "rhythm": "steady"}
"""Contact is to end as a beat begins to rise."""
T_S = 0.001


def pushed_out(flight):
    """Largest true push on the way out [N]."""
    out = [state.state is OperatingState.RETRACT for state in flight.safety_states]
    first, last = flight.time[out][[0, -1]]
    return float(-flight.force[(flight.force_time >= first) & (flight.force_time <= last), 2].min())


@pytest.mark.oracle
@pytest.mark.parametrize("touching", [False, True])
def test_a_beat_that_rises_meets_no_servo(cautious, touching):
    flight = fly(cautious, touching=touching, **RISING)
    assert flight.reason is Reason.FINISHED
    assert pushed_out(flight) < 1.0
    assert flight.push() < 10.5


@pytest.mark.oracle
def test_a_servo_that_takes_over_at_once_presses_a_third_more_and_says_so(cautious, monkeypatch):
    """The check can fail: it is what happens without."""
    monkeypatch.setattr(TaskController, "leave", lambda self, force: True)
    flight = fly(cautious, **RISING)
    assert flight.reason is Reason.OVERSHOOT
    assert pushed_out(flight) > 13.0


def test_the_end_is_asked_for_once(plain, monkeypatch):
    asked = []

    def once(self, result):
        command = pilot(self, result)
        if command.finish is Reason.NONE or asked:
            return command._replace(finish=Reason.NONE)
        asked.append(len(asked))
        return command

    pilot = Pilot.__call__
    monkeypatch.setattr(Pilot, "__call__", once)
    flight = fly(plain, seconds=1.0)
    assert asked
    assert flight.reason is Reason.FINISHED


def test_what_is_lost_on_the_way_out_of_contact_is_told(plain):
    """The force fails while it is let down: the servo takes the tip away at once."""
    clean = fly(plain, seconds=1.0)
    ending = clean.contact + 1.1
    flight = fly(plain, f"force:off@{ending:.3f}", seconds=1.0)
    assert flight.reason is Reason.FORCE_LOST
    assert flight.detected(ending) <= 10


@pytest.mark.parametrize("ahead", [0, 8])
def test_the_force_is_let_down_at_its_rate_and_a_tissue_that_holds_is_left_in_the_end(ahead):
    controller = TaskController(runtime(), ConstantForce((0.0, 0.0, -3.0)), T_S, Contacting(), ahead, rate=5.0)
    rows = held(controller, 700)
    assert rows[-1] == pytest.approx(-3.0)
    assert not controller.leaving
    ends = [(controller.leave((0.0, 0.0, -1.0)), held(controller, 1)[0]) for _ in range(1000)]
    wanted = np.array([row for _, row in ends])
    assert np.diff(wanted).max() == pytest.approx(EASING * T_S)
    assert wanted[-1] == pytest.approx(PULL)
    assert [over for over, _ in ends].index(True) == pytest.approx(1e3 * ((3.0 + PULL) / EASING + LEAVING), abs=1)


def test_the_tip_is_off_once_it_has_not_pressed_for_a_while():
    controller = TaskController(runtime(), ConstantForce((0.0, 0.0, -3.0)), T_S, Contacting())
    held(controller, 100)
    forces = [(0.0, 0.0, -0.2)] * (LIFTED - 1) + [(0.0, 0.0, -0.4), None] + [(0.5, 0.0, 0.7)] * LIFTED
    assert [controller.leave(force) for force in forces] == [False] * (len(forces) - 1) + [True]


def test_without_a_sample_of_contact_there_is_nothing_to_let_down():
    controller = TaskController(runtime(), ConstantForce((0.0, 0.0, -3.0)), T_S, Contacting())
    assert controller.leave(None)


def runtime():
    """A law that asks for nothing."""
    zero = (0.0,) * 4
    return SimpleNamespace(enter=lambda force, q: None, control=lambda q, qd, force, wanted: zero)


def held(controller, samples):
    """Wanted normal force of so many samples in contact [N]."""
    zero, rows = (0.0,) * 4, []
    for _ in range(samples):
        controller.torque(Task.CONTROL, zero, zero, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
        rows.append(controller.force_ref[2])
    return rows
