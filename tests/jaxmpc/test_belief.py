"""What is decided from what is heard, by hand: every rate, threshold and half way between two, one sample at a time."""

import math
from typing import Any

import jax
import pytest

from jaxmpc import Params, design
from jaxmpc.engine.base import scalars
from jaxmpc.law.belief import decide
from jaxmpc.law.ops import FLOATS
from jaxmpc.law.stiffness import Alarm, StiffnessEstimate, StiffnessIdentification, unknown

pytestmark = pytest.mark.once

T_s, BAND, STIFFNESS = 1e-3, 0.06, 810.0
NOISE = 1e-2
"""Usual noise, far above the 1e-6 N² that is added to all [N²]."""


@pytest.fixture(scope="module")
def constants() -> StiffnessIdentification:
    found: StiffnessIdentification = jax.tree.map(
        float, scalars(design(Params.published("family")), preview=False).schedule.identification
    )
    assert (found.T_s, found.band) == (T_s, BAND)
    return found


@pytest.fixture
def decided(constants: StiffnessIdentification) -> Any:
    """What a sample changes of a schedule that has the control, knows 810 N/m and hears nothing unusual."""

    def decided(miss: float = 0.0, lead: float = 0.0, taken: float = 0.0, others: Any = (0.0, 0.0), **of: float) -> Any:
        known = unknown(constants, 0.0)._replace(log_stiffness=math.log(STIFFNESS), authority=1.0, width=0.0, heard=1.0)
        known = known._replace(learned=1.0, usual=NOISE, noise=NOISE, burst=NOISE, credit=0.0, proven=1.0)
        before = known._replace(**of)
        after = decide(constants, before, STIFFNESS * (1.0 + miss), lead, taken, Alarm(*others), FLOATS)

        def change(name: str) -> float:
            return float(getattr(after, name) - getattr(before, name))

        assert isinstance(after, StiffnessEstimate)
        return after, change

    return decided


SURE = [
    ({}, 1.0),
    ({"heard": 0.85}, 0.5),
    ({"heard": 0.8}, 0.0),
    ({"lead": 0.05}, 1.0),
    ({"lead": 0.07}, 0.5),
    ({"lead": 0.09}, 0.0),
    ({"lead": -0.5}, 1.0),
    ({"width": 0.5 * BAND}, 1.0),
    ({"width": 0.75 * BAND}, 0.5),
    ({"width": BAND}, 0.0),
]
"""How sure the stiffness is of which one hears this."""


@pytest.mark.parametrize(("heard", "sure"), SURE)
@pytest.mark.parametrize(("miss", "followed"), [(0.04, 0.04), (-0.04, -0.04), (2.0, 0.5), (-0.9, -0.5)])
def test_the_stiffness_is_followed_where_it_is_surely_heard(decided, heard, sure, miss, followed) -> None:
    """At 6 per second of what it is off, of at most one half."""
    _, change = decided(miss, **heard)
    assert change("log_stiffness") == pytest.approx(6.0 * T_s * sure * followed, abs=1e-12)


def test_the_stiffness_stays_a_little_beyond_the_outer_knots(decided) -> None:
    for outer, miss in ((1900.0 * math.exp(0.25), 2.0), (375.0 * math.exp(-0.25), -0.9)):
        after, _ = decided(miss * outer / STIFFNESS + outer / STIFFNESS - 1.0, log_stiffness=math.log(outer))
        assert math.exp(after.log_stiffness) == pytest.approx(outer, rel=1e-12)


@pytest.mark.parametrize(("end", "factor"), [("most", 1.0), ("least", -1.0)])
def test_a_tissue_beyond_what_is_believed_is_held_for_known_within_a_tenth(
    decided, constants, end: str, factor: float
) -> None:
    """K̂ stays 25 % in the logarithm beyond an outer knot, and the schedule has control of tissue a tenth farther."""
    bound = getattr(constants, end)
    places = Params.published("family").listening.stiffness
    assert math.exp(bound) == pytest.approx(places[-1 if factor > 0.0 else 0] * math.exp(0.25 * factor))
    for miss, rising in ((0.09, 2.0 - 20.0 * 0.09), (0.11, 0.0)):
        heard = math.exp(bound) * (1.0 + factor * miss) / STIFFNESS - 1.0
        after, change = decided(heard, log_stiffness=bound, authority=0.5, listening=1.0)
        assert after.log_stiffness == bound
        assert change("authority") == pytest.approx(2.0 * T_s * rising, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize(("heard", "sure"), SURE)
@pytest.mark.parametrize(("miss", "arrived"), [(0.05, 1.0), (-0.075, 0.5), (0.075, 0.5), (0.1, 0.0)])
def test_authority_rises_where_what_is_believed_is_what_is_heard(decided, heard, sure, miss, arrived) -> None:
    """At 2 per second."""
    _, change = decided(miss, authority=0.2, **heard)
    assert change("authority") == pytest.approx(2.0 * T_s * sure * arrived, abs=1e-12)


@pytest.mark.parametrize(
    ("of", "doubt"),
    [
        ({}, 0.0),
        ({"noise": 1.55 * NOISE}, 0.5),
        ({"noise": 3.0 * NOISE}, 2.0),
        ({"burst": 3.2 * NOISE}, 0.5),
        # A sensor without noise has a millionth of a square newton that nobody hears.
        ({"noise": 0.0, "burst": 0.0, "usual": 0.0}, 0.0),
        ({"burst": 10.0 * NOISE}, 2.0),
        # Of what has half been learned, half counts, and the mean so far is what is usual.
        ({"noise": 1.55 * NOISE, "learned": 0.85, "usual": 0.85 * NOISE}, 0.25),
        ({"noise": 9.0 * NOISE, "learned": 0.8, "usual": 0.8 * NOISE}, 0.0),
        ({"upset": 1.25 * 0.4**2}, 0.5),
        ({"upset": 9.0}, 2.0),
        ({"taken": 0.2}, 0.5),
        ({"taken": 0.1}, 0.0),
        ({"taken": 0.9}, 2.0),
        ({"unrest": 0.95}, 0.5),
        ({"unrest": 0.9}, 0.0),
        ({"unrest": 0.45, "authority": 0.0}, 0.5),
        ({"unrest": 0.9, "authority": 0.0}, 2.0),
        ({"noise": 1.55 * NOISE, "burst": 2.8 * NOISE, "upset": 1.1 * 0.4**2, "taken": 0.15, "unrest": 0.93}, 0.5),
        ({"noise": 1.35 * NOISE, "burst": 2.8 * NOISE, "upset": 1.1 * 0.4**2, "taken": 0.18, "unrest": 0.93}, 0.4),
    ],
)
def test_doubt_is_the_most_of_what_tells_of_it(decided, of, doubt) -> None:
    after, _ = decided(**of)
    assert after.doubt == pytest.approx(doubt, abs=2e-4)  # 1e-6 N² are a ten thousandth of the noise


@pytest.mark.parametrize(("of", "large"), [({"taken": 0.2}, 0.0), ({"taken": 0.25}, 0.5), ({"taken": 0.3}, 1.0)])
def test_from_one_half_on_doubt_takes_the_authority(decided, of, large) -> None:
    """At 150 per second; that of another axis as one's own."""
    _, change = decided(miss=1.0, **of)
    assert change("authority") == pytest.approx(-150.0 * T_s * large, abs=1e-12)
    _, change = decided(miss=1.0, others=(5.0 * (of["taken"] - 0.1), 0.0))
    assert change("authority") == pytest.approx(-150.0 * T_s * large, abs=1e-12)


def test_authority_is_no_more_than_trust_and_comes_back_by_pardon(decided) -> None:
    after, _ = decided(trust=0.7)
    assert after.authority == pytest.approx(0.7, abs=1e-3)
    beat, credited = 0.2**2, {"credit": 1.0, "authority": 0.2, "miss": 1.0}
    for found in (decided(strain=beat, **credited), decided(others=(0.0, beat), **credited)):
        assert found[1]("authority") == pytest.approx(4.0 * T_s)
    _, change = decided(strain=beat, others=(0.75, 0.0), **credited)  # half of it while doubt is half large
    assert change("authority") == pytest.approx((0.5 * 4.0 - 0.5 * 150.0) * T_s)


@pytest.mark.parametrize(
    ("of", "sounding"),
    [
        # Who has not the control listens, but for where the control comes back by itself.
        ({"authority": 0.0}, 1.0),
        ({"authority": 0.0, "credit": 1.0, "strain": 0.2**2}, -1.0),
        # Half of the control is none; of the last hundredth a half is half of it.
        ({"authority": 0.99, "listening": 0.7, "miss": 1.0}, 0.5),
        ({"authority": 0.99, "listening": 0.7}, 0.0),
        # The sine ends where the stiffness is known, and where it has hardly begun.
        ({"listening": 0.9}, -1.0),
        ({"listening": 0.9, "miss": 0.075}, -0.5),
        ({"listening": 0.9, "width": 0.75 * BAND}, -0.5),
        ({"listening": 0.9, "miss": 1.0}, 0.0),
        ({"listening": 0.55, "miss": 1.0}, -0.5),
        ({"listening": 0.3, "miss": 1.0}, -1.0),
        # What is more than half on goes on until the stiffness has been heard.
        ({"listening": 0.9, "heard": 0.75, "miss": 1.0}, 1.0),
        ({"listening": 0.9, "heard": 0.8, "miss": 1.0}, 0.5),
        ({"listening": 0.55, "heard": 0.0, "miss": 1.0}, 0.25),
        # A tenth of doubt brings it.
        ({"listening": 0.9, "taken": 0.11, "miss": 1.0}, 0.5),
        ({"listening": 0.9, "taken": 0.12}, 1.0),
        ({"listening": 0.5, "taken": 0.9, "miss": 1.0}, 1.0),
        ({"listening": 0.9, "taken": 0.12, "credit": 1.0, "strain": 0.2**2}, 1.0),
        # Within the time that it may, and with as much trust as that takes.
        ({"authority": 0.0, "listening": 0.1, "spent": 0.54}, 1.0),
        ({"authority": 0.0, "listening": 0.1, "spent": 0.59}, 0.5 - 0.5),
        ({"authority": 0.0, "listening": 0.1, "spent": 0.7}, -1.0),
        ({"authority": 0.0, "listening": 0.99, "spent": 0.8}, 1.0),
        ({"authority": 0.0, "listening": 0.5, "trust": 0.625}, 0.0),
        ({"authority": 0.0, "listening": 0.5, "trust": 0.5}, -1.0),
    ],
)
def test_the_sine_goes_on_and_off(decided, of, sounding) -> None:
    """At 2 per second, between 0 and 1."""
    after, change = decided(**{"listening": 0.5, **of})
    assert change("listening") == pytest.approx(2.0 * T_s * sounding, abs=1e-12)
    for end in (0.0, 1.0):
        after, _ = decided(**{**of, "listening": end})
        assert 0.0 <= after.listening <= 1.0


@pytest.mark.parametrize(("listening", "spent"), [(0.0, 0.6), (1.0, 0.0), (0.4, 0.3)])
def test_the_time_that_the_sine_may_sound_is_spent_in_12_s_and_back_with_60_s(decided, listening, spent) -> None:
    _, change = decided(listening=listening, spent=spent)
    assert change("spent") == pytest.approx(T_s * (listening / 12.0 - spent / 60.0), rel=1e-9)


@pytest.mark.parametrize(
    ("authority", "trust", "taken", "swinging"), [(1.0, 1.0, 0.2, 0.5), (0.5, 0.8, 0.2, 0.5), (0.0, 0.4, 0.2, 0.5)]
)
def test_trust_goes_with_the_gain_that_a_guard_takes_from_a_schedule(
    decided, authority, trust, taken, swinging
) -> None:
    """At 150 per second, to the share of the control that it has; and comes back with 150 s."""
    _, change = decided(taken=taken, authority=authority, trust=trust)
    expected = T_s * ((1.0 - trust) / 150.0 - 150.0 * authority * trust * swinging)
    assert change("trust") == pytest.approx(expected, rel=1e-9)


def test_no_sample_is_so_long_that_trust_is_below_nothing(constants) -> None:
    """The longest of a guard, 5 ms, in which 1.5 of it would go."""
    known = unknown(constants, 0.0)._replace(authority=1.0, width=0.0, heard=1.0)
    after = decide(constants._replace(T_s=5e-3), known, STIFFNESS, 0.0, 0.9, Alarm(0.0, 0.0), FLOATS)
    assert after.trust == 0.0


@pytest.mark.parametrize(
    ("of", "rate"),
    [
        # (10 q + 1) (1 − D) (1 − κ) − (50 h + (20 + 800 (1 − π)) D) κ, half of the credit being there.
        ({}, 11.0 * 0.5),
        ({"miss": 0.075}, 6.0 * 0.5),
        ({"width": 0.75 * BAND}, 6.0 * 0.5),
        ({"miss": 1.0, "taken": 0.22}, 0.8 * 0.5 - 0.2 * 20.0 * 0.5),
        ({"miss": 1.0, "others": (0.6, 0.0)}, 0.8 * 0.5 - 0.2 * 20.0 * 0.5),
        ({"miss": 1.0, "others": (0.0, 1.125 * 0.29**2)}, 0.5 - 0.5 * 50.0 * 0.5),
        ({"miss": 1.0, "strain": 1.125 * 0.29**2}, 0.5 - 0.5 * 50.0 * 0.5),
    ],
)
def test_credit_is_told_what_is_decided(decided, of, rate) -> None:
    _, change = decided(credit=0.5, **of)
    assert change("credit") == pytest.approx(T_s * rate, rel=1e-9)


@pytest.mark.parametrize(
    ("of", "rate"),
    [
        ({"upset": 1.5 * 0.07**2, "unrest": 0.2}, 1.0),
        ({"upset": 1.25 * 0.07**2, "unrest": 0.02}, 0.5 - 0.5 * 0.02 / 0.05),
        ({"upset": 0.07**2, "unrest": 0.02}, -0.02 / 0.05),
        ({"upset": 1.0, "unrest": 0.02, "authority": 0.5}, -0.02 / 0.05),
    ],
)
def test_unrest_counts_seconds_without_a_calm_while_the_schedule_has_the_control(decided, of, rate) -> None:
    _, change = decided(**of)
    assert change("unrest") == pytest.approx(T_s * rate, rel=1e-9)


def test_unrest_tells_the_other_axes_of_a_push_that_nothing_pardons(decided) -> None:
    after, _ = decided(unrest=1.0, strain=0.01)
    assert after.strain == pytest.approx(0.65 * 0.29**2)
    after, _ = decided(unrest=0.9, strain=0.01)
    assert after.strain == 0.01


@pytest.mark.parametrize(
    ("of", "rate"),
    [
        # 1 − 2.2 and 1 − 1.3 of the usual noise are 0.6 of a calm.
        ({"learned": 0.5, "usual": 0.5 * NOISE}, 0.5 + 0.02 * 0.6),
        ({"learned": 0.85, "usual": 0.85 * NOISE}, 0.25 + 0.02 * 0.6),
        ({"learned": 0.95, "usual": 0.95 * NOISE}, 0.02 * 0.6),
        ({"learned": 0.95, "usual": 0.95 * NOISE, "burst": 2.2 * NOISE}, 0.0),
        ({"learned": 0.95, "usual": 0.95 * NOISE, "noise": 1.3 * NOISE}, 0.0),
        ({"learned": 0.95, "usual": 0.95 * NOISE, "noise": 2.0 * NOISE}, 0.0),
        ({"learned": 0.5, "usual": 0.5 * NOISE, "listening": 0.6, "miss": 1.0}, 0.4 * (0.5 + 0.02 * 0.6)),
        ({"learned": 0.5, "usual": 0.5 * NOISE, "authority": 0.9}, 0.0),
    ],
)
def test_what_is_usual_is_learned_in_quiet(decided, of, rate) -> None:
    """At 0.5 per second, once it is known at 0.02 in calms; with all of the control and no sine."""
    _, change = decided(**of)
    assert change("learned") == pytest.approx(T_s * rate * (1.0 - of["learned"]), rel=2e-3, abs=1e-9)
    expected = T_s * rate * (of.get("noise", NOISE) - of["usual"])
    assert change("usual") == pytest.approx(expected, rel=2e-3, abs=1e-9 * NOISE)
