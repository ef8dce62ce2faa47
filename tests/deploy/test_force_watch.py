"""The force sensor's word weighed cycle by cycle: who is asked, when, and who ends contact."""

import math
from types import SimpleNamespace

import pytest

from deploy.loop.force_watch import ForceSample, ForceWatch
from deploy.safety import late_force, runaway
from deploy.safety.force_balance import BalanceState
from deploy.safety.machine import OperatingState
from deploy.safety.reasons import Reason

FOUR, ZERO, UP = (0.0,) * 4, (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)
DEEPEST = 0.04
NOT_JUDGED = [each for each in OperatingState if each not in (OperatingState.APPROACH, OperatingState.CONTACT)]


class Estimate:
    """The motors' word, as a test has it; keeps what it was asked."""

    def __init__(self):
        self.told, self.asked, self.heard = ZERO, [], []

    def start(self, qd):
        self.asked.append("start")

    def skip(self, qd):
        self.asked.append("skip")

    def step(self, q, qd, torque, force):
        self.asked.append("step")
        self.heard.append(force)
        return self.told


class Watch:
    def __init__(self, estimate):
        self.runtime = SimpleNamespace(last_a=ZERO, lag=ZERO)
        self.depth, self.estimate = 0.0, estimate
        controller = SimpleNamespace(
            runtime=self.runtime, depth=lambda tip: self.depth, contacting=SimpleNamespace(normal=UP)
        )
        self.made = ForceWatch(controller, estimate, DEEPEST, 1e-3)

    def __call__(self, state=OperatingState.CONTACT, force=ZERO, driven=True, missed=False):
        kinematics = SimpleNamespace(tip=ZERO, velocity=ZERO)
        return self.made.judge(state, ForceSample(FOUR, FOUR, kinematics, force, FOUR), driven, missed)

    def all(self, count, **cycle):
        return [self(**cycle) for _ in range(count)]


@pytest.fixture
def watch():
    return Watch(Estimate())


def test_a_push_that_the_sensor_does_not_tell_ends_approach_and_contact():
    for state in (OperatingState.APPROACH, OperatingState.CONTACT):
        watch = Watch(Estimate())
        watch.estimate.told = (0.0, 0.0, -10.0)
        assert watch.all(3, state=state) == [Reason.NONE, Reason.NONE, Reason.FORCE_MODEL]


def test_elsewhere_the_motors_are_heard_and_not_judged(watch):
    watch.estimate.told = (0.0, 0.0, -30.0)
    for state in NOT_JUDGED:
        assert set(watch.all(10, state=state)) == {Reason.NONE}
    assert watch.estimate.asked == ["step"] * 10 * len(NOT_JUDGED)
    assert watch.made.balance == BalanceState()
    watch(OperatingState.RETRACT, force=UP)
    assert watch.estimate.heard[-1] == UP  # what the tissue does there is explained by it


def test_an_arm_that_is_not_driven_tells_nothing_and_its_estimate_begins_anew(watch):
    watch.estimate.told = (0.0, 0.0, -30.0)
    assert set(watch.all(10, driven=False)) == {Reason.NONE}
    assert watch.estimate.asked == ["start"] * 10


def test_over_missed_cycles_the_estimate_is_not_asked(watch):
    watch.estimate.told = (0.0, 0.0, -30.0)
    assert set(watch.all(10, missed=True)) == {Reason.NONE}
    assert watch.estimate.asked == ["skip"] * 10


@pytest.mark.parametrize("estimate", [None, Estimate()])
def test_a_loop_that_runs_away_ends_contact(estimate):
    watch = Watch(estimate)
    watch.runtime.last_a = (0.0, 0.0, 1.01 * runaway.ASKED)
    assert set(watch.all(10, state=OperatingState.APPROACH)) == {Reason.NONE}
    assert watch.all(runaway.SAMPLES)[-2:] == [Reason.NONE, Reason.FORCE_MODEL]


def test_a_force_that_is_late_on_every_axis_ends_contact(watch):
    late = 1.01 * late_force.LATE
    watch.runtime.lag = (late, 0.0, late)
    assert set(watch.all(100)) == {Reason.NONE}
    watch.runtime.lag = (late, late, late)
    assert watch.all(20)[-2:] == [Reason.NONE, Reason.FORCE_MODEL]


@pytest.mark.parametrize("estimate", [None, Estimate()])
def test_deeper_than_any_promised_tissue_bears_ends_contact_at_once(estimate):
    watch = Watch(estimate)
    watch.depth = DEEPEST
    assert watch() is Reason.NONE
    watch.depth = math.nextafter(DEEPEST, 1.0)
    assert watch(OperatingState.RETRACT) is Reason.NONE
    assert watch() is Reason.FORCE_MODEL
