"""What a force sensor says of its own reading counts: "bad" is none, "saturated" none to rely on; and its zero."""

import pytest

from deploy.force.sensor import BAD_DATA
from deploy.safety.machine import OperatingState
from deploy.safety.reasons import Reason
from deploy.twin.force_torque import ForceTorque
from tests.twin.flying import fly

pytestmark = pytest.mark.once


@pytest.fixture
def saying(monkeypatch):
    """Has the sensor say flags with its readings of a numbered stretch."""
    own, count = ForceTorque.reading, 0

    def say(flags, first=0, last=10**9):
        def reading(self, force, orientation):
            nonlocal count
            count += 1
            found, said = own(self, force, orientation)
            return found, flags if first <= count < last else said

        monkeypatch.setattr(ForceTorque, "reading", reading)

    return say


LATER = 2000
"""A reading in contact."""


def test_three_bad_readings_in_a_row_end_contact(plain, saying):
    saying(BAD_DATA, LATER)
    assert fly(plain, seconds=3.0).reason is Reason.FORCE_LOST


def test_a_bad_reading_is_bridged(plain, saying):
    saying(BAD_DATA, LATER, LATER + 2)
    assert fly(plain, seconds=2.0).reason is Reason.FINISHED


def test_a_gauge_that_saturates_ends_contact(plain, saying):
    saying(0x04, LATER)
    flight = fly(plain, seconds=3.0)
    assert flight.reason is Reason.FORCE_RANGE
    assert OperatingState.CONTACT in {now.state for now in flight.safety_states}


def test_a_gauge_that_saturated_before_the_start_stays_flagged_and_is_of_the_past(plain, saying):
    saying(0x04)
    assert fly(plain, seconds=1.0).reason is Reason.FINISHED


@pytest.mark.parametrize("bias", [(0.0, 0.0, 0.35), (0.0, 0.0, -0.35), (0.35, 0.0, 0.0)])
def test_a_zero_that_reads_as_a_contact_is_told_before_the_law_looks_for_the_tissue_in_the_air(plain, bias):
    flight = fly(plain, bias=bias, gap=0.02, seconds=1.0)
    assert flight.reason is Reason.TARE
    assert OperatingState.APPROACH not in {now.state for now in flight.safety_states}
