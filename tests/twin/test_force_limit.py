"""The force limit is a limit on the tissue: what the sensor says is weighed against the motors."""

import numpy as np
import pytest

from benchmarks import lying_survey
from benchmarks.lying_sensor import Flown, contact_of, fly, moments
from deploy.loop import force_watch, session
from deploy.safety import force_balance
from deploy.safety.reasons import Reason
from deploy.twin.twin import Twin
from jaxmpc.world.tissue import KINDS

pytestmark = pytest.mark.usefixtures("recorded_once")
LIMIT = 15.0
"""Of the frozen controllers [N]."""
LYING = {
    "a fifth": (("force:unit=0.2",), -5.0),
    "half": (("force:unit=0.5",), -2.0),
    "minus a fifth": (("force:unit=-0.2",), -5.0),
    "sign": (("force:sign",), -5.0),
    "delayed": (("force:delayed=100",), -10.0),
    "delayed, positions lost": (("force:delayed=100", "positions:lost=0.02"), -10.0),
}


@pytest.fixture(autouse=True)
def held_briefly_once_withdrawn(request):
    """A run in which a late force ends in FAULT holds the tip where it is, and the heart comes back to it."""
    if "delayed" not in request.node.name:
        request.getfixturevalue("held_briefly")


def flown(artifact, lie, tissue, stiffness, phase):
    words, wanted = LYING[lie]
    contact = 0.0 if phase == "before" else contact_of(artifact, stiffness, tissue)
    at = moments(contact, wanted)[phase]
    return fly(artifact, tuple(f"{word}@{at:.3f}" for word in words), stiffness, tissue, wanted)


KNOWN = {"minus a fifth": 26.0, "delayed": 24.0, "delayed, positions lost": 24.0}
"""Largest true pushes [N] of lies that set in while the tip presses, where these pass the limit; see docs/robot.md."""


def check(found: Flown, most: float = LIMIT):
    assert found.push <= most
    assert found.reason not in (Reason.FINISHED, Reason.NONE)


@pytest.mark.oracle
@pytest.mark.parametrize(
    ("lie", "tissue", "stiffness", "phase"),
    [
        ("a fifth", "fung", 1900.0, "before"),
        ("a fifth", "elastic", 1300.0, "wanted"),
        ("half", "elastic", 810.0, "before"),
        ("half", "fung", 1900.0, "wanted"),
        ("minus a fifth", "fung", 1900.0, "before"),
        ("delayed", "elastic", 1900.0, "contact"),
    ],
)
def test_a_sensor_that_lies_is_stopped_below_the_limit(cautious, lie, tissue, stiffness, phase):
    check(flown(cautious, lie, tissue, stiffness, phase))


@pytest.mark.oracle
@pytest.mark.parametrize("tissue", KINDS)
@pytest.mark.parametrize("lie", LYING)
@pytest.mark.parametrize("stiffness", [pytest.param(1300.0, marks=pytest.mark.slow), 1900.0])
def test_no_lie_from_the_start_presses_beyond_the_limit_on_any_tissue(cautious, lie, tissue, stiffness):
    check(flown(cautious, lie, tissue, stiffness, "before"))


@pytest.mark.slow
@pytest.mark.parametrize("tissue", KINDS)
@pytest.mark.parametrize("lie", LYING)
@pytest.mark.parametrize("stiffness", [1300.0, 1900.0])
def test_a_lie_that_sets_in_while_the_tip_presses_is_stopped(cautious, lie, tissue, stiffness):
    for phase in ("contact", "wanted"):
        check(flown(cautious, lie, tissue, stiffness, phase), KNOWN.get(lie, LIMIT))


@pytest.mark.oracle
def test_without_the_motors_word_a_fifth_presses_beyond_the_limit(cautious, monkeypatch):
    """The check can fail: what it is there for is what happens without it."""
    monkeypatch.setattr(session, "ForceEstimate", lambda *arguments: None)
    found = flown(cautious, "a fifth", "fung", 1900.0, "before")
    assert found.push > LIMIT
    assert found.reason is Reason.FINISHED


@pytest.mark.oracle
def test_a_loop_that_swings_is_ended_before_it_presses_beyond_the_limit(cautious, monkeypatch):
    """Lost forces on tissue that is stiffer under load than promised; without the check it is 22 N."""
    swinging = ("force:intermittent=0.1@4.522",), 810.0, "fung", -10.0
    found = fly(cautious, *swinging, seed=339)
    assert found.reason is Reason.FORCE_MODEL
    assert found.push < LIMIT - 4.0
    monkeypatch.setattr(force_watch, "runaway_step", lambda count, asked: (0, None))
    assert fly(cautious, *swinging, seed=339).push > LIMIT + 4.0


@pytest.mark.oracle
@pytest.mark.parametrize("stiffness", [375.0, 1900.0])
def test_an_approach_that_no_sensor_tells_of_is_ended_by_the_motors(cautious, monkeypatch, stiffness):
    """A sensor that is alive and reads next to nothing: by its word the tissue is met at 30 N."""
    draw = np.random.default_rng(3)
    monkeypatch.setattr(Twin, "force_hook", lambda self, y: tuple(0.01 * f + draw.normal(0.0, 0.02) for f in y))
    found = fly(cautious, (), stiffness, "elastic", -5.0)
    assert found.reason is Reason.FORCE_MODEL
    assert found.push <= LIMIT


@pytest.mark.oracle
def test_half_the_force_is_not_seen_without_the_friction_told_apart(cautious, monkeypatch):
    """The check can fail: 2 N beyond the reading are less than friction's uncertainty."""
    monkeypatch.setattr(force_balance, "HIDDEN", 100.0)
    found = flown(cautious, "half", "elastic", 810.0, "before")
    assert found.reason is Reason.FINISHED
    assert found.push > 1.7 * 2.0


@pytest.mark.oracle
def test_a_survey_draws_and_flies(cautious, monkeypatch):
    monkeypatch.setattr(lying_survey, "_artifact", cautious, raising=False)
    number = next(n for n in range(50) if lying_survey.drawn(0, n).phase == "contact")
    case = lying_survey.drawn(0, number)
    contact = lying_survey._contact(lying_survey.Cell(case.tissue, case.stiffness))
    assert contact == contact_of(cautious, case.stiffness, case.tissue)
    row = lying_survey._row(number, case, contact, 0)
    assert 0.0 < row["push"] < LIMIT
    assert lying_survey.report([row], LIMIT) == 0


@pytest.mark.oracle
@pytest.mark.parametrize("settings", [{}, {"coulomb": (4.0, 4.5, 2.2, 1.3), "mass_scale": 1.1}, {"delay": 2}])
def test_a_healthy_sensor_is_believed_whatever_the_arm_and_the_rhythm(cautious, settings):
    found = fly(cautious, (), 810.0, "standard-linear", -5.0, rhythm="bigeminy", **settings)
    assert found.reason is Reason.FINISHED


@pytest.mark.oracle
def test_a_tissue_that_is_met_before_the_air_is_known(cautious, monkeypatch):
    monkeypatch.setattr("benchmarks.lying_sensor.GAP", 0.001)
    assert fly(cautious, (), 1900.0, "fung", -5.0, rhythm="none").reason is Reason.FINISHED
    found = fly(cautious, ("force:unit=0.2@0.15",), 1900.0, "fung", -5.0, rhythm="none")
    check(found)


@pytest.mark.oracle
def test_travel_times_the_promised_stiffness_bounds_what_the_motors_were_not_asked(cautious, monkeypatch):
    """On the softest promised tissue; without the motors' word, and with a sensor that reads a tenth of the force."""
    monkeypatch.setattr(session, "ForceEstimate", lambda *arguments: None)
    draw = np.random.default_rng(3)
    monkeypatch.setattr(Twin, "force_hook", lambda self, y: tuple(0.1 * f + draw.normal(0.0, 0.02) for f in y))
    bound = session.deepest(cautious)
    assert LIMIT / 375.0 < bound < LIMIT / 375.0 + 0.03
    found = fly(cautious, (), 375.0, "elastic", -5.0)
    assert found.reason is Reason.FORCE_MODEL
    assert found.push < 375.0 * (bound + 0.02)
    monkeypatch.setattr(session, "deepest", lambda artifact: 1.0)
    worse = fly(cautious, (), 375.0, "elastic", -5.0)
    assert worse.push > found.push + 3.0
