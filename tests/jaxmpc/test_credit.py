"""Whether a schedule gets the control back after a push, and when it does not; a force that never calms."""

import math
from collections.abc import Callable, Iterator

import jax
import numpy as np
import pytest

from jaxmpc import Params, design
from jaxmpc.engine.base import scalars
from jaxmpc.law import credit
from jaxmpc.law.belief import UPSET, decide
from jaxmpc.law.ops import FLOATS
from jaxmpc.law.stiffness import SILENT, Alarm, StiffnessEstimate, StiffnessIdentification, unknown

STIFFNESS = 810.0
BEAT, TOO_LARGE = 0.2**2, 0.35**2
"""Mean squares of the force's error over a second, after an early beat and after more than one [N²]."""
States = list[StiffnessEstimate]


@pytest.fixture(scope="module")
def constants() -> StiffnessIdentification:
    found: StiffnessIdentification = jax.tree.map(
        float, scalars(design(Params.published("family")), preview=False).schedule.identification
    )
    return found


@pytest.fixture
def run(constants: StiffnessIdentification) -> Callable[..., States]:
    def run(samples: int, state: StiffnessEstimate, alarm: Alarm = SILENT, **heard: float) -> States:
        """What is decided while doubt, or what else is heard, stays as it is."""

        def states() -> Iterator[StiffnessEstimate]:
            now = state
            for _ in range(samples):
                now = decide(constants, now._replace(**heard), STIFFNESS, 0.0, 0.0, alarm, FLOATS)
                yield now

        return list(states())

    return run


@pytest.fixture
def settled(constants: StiffnessIdentification) -> StiffnessEstimate:
    """A schedule that has the control, of which all is known."""
    known = unknown(constants, 0.0)._replace(authority=1.0, learned=1.0, usual=1e-4, noise=1e-4, burst=1e-4)
    return known._replace(log_stiffness=np.log(STIFFNESS), credit=1.0, proven=1.0)


def upset(run: Callable[..., States], state: StiffnessEstimate, strain: float) -> StiffnessEstimate:
    """The state after a tenth of a second in which the force's error took the control."""
    taken = run(100, state, upset=2.0 * UPSET**2, strain=strain)[-1]
    assert taken.authority == 0.0
    return taken


def credit_after(turns: float, rate: float, T_s: float, state: StiffnessEstimate, **told: float) -> StiffnessEstimate:
    """The state when so many time constants of a rate [1/s] have passed, in steps of a sampling time [s]."""
    told = {"telling": 0.0, "settled": 0.0, "large": 0.0, "strain": BEAT, **told}
    for _ in range(round(turns / (rate * T_s))):
        state = credit.step(state, T_s, **told, ops=FLOATS)
    return state


@pytest.mark.parametrize(
    ("told", "authority", "proven", "rate"),
    [
        ({"strain": 0.0}, 0.0, 0.0, 3.6),
        ({"strain": 1.125 * 0.09**2}, 0.0, 0.0, 2.1),
        ({}, 0.0, 0.0, 0.6),
        ({"strain": TOO_LARGE}, 0.0, 0.0, 50.6),
        ({"strain": 1.125 * 0.29**2}, 0.0, 0.0, 25.6),
        ({"large": 1.0}, 0.0, 0.0, 0.6),
        ({"large": 1.0}, 0.5, 0.0, 820.6),
        ({"large": 1.0, "settled": 1.0, "telling": 1.0}, 1.0, 1.0, 20.0),
        ({"large": 1.0, "settled": 1.0, "telling": 1.0}, 1.0, 0.0, 820.0),
    ],
)
def test_credit_goes_at_the_rate_of_its_equation(settled, told, authority, proven, rate) -> None:
    """To 1/e in a time constant; steps of a thousandth of it are 0.1 % off, what is proven meanwhile 0.4 %."""
    begun = settled._replace(authority=authority, proven=proven, credit=1.0)
    assert credit_after(1.0, rate, 1e-3 / rate, begun, **told).credit == pytest.approx(math.exp(-1.0), rel=5e-3)


@pytest.mark.parametrize(("telling", "rate"), [(0.0, 1.0), (0.5, 6.0), (1.0, 11.0)])
def test_credit_grows_at_the_rate_of_its_equation(settled, telling, rate) -> None:
    after = credit_after(1.0, rate, 1e-3 / rate, settled._replace(credit=0.0), telling=telling, settled=1.0, strain=0.0)
    assert after.credit == pytest.approx(1.0 - math.exp(-1.0), rel=2e-3)


def test_no_sample_is_so_long_that_more_than_half_of_the_credit_goes(settled) -> None:
    """Nor does any turn its sign."""
    after = credit.step(settled._replace(proven=0.0), 0.05, 0.0, 1.0, 1.0, BEAT, FLOATS)
    assert after.credit == pytest.approx(0.5)


@pytest.mark.parametrize(("told", "begin", "end", "rate"), [(1.0, 0.0, 1.0, 1.0 / 0.35), (0.0, 1.0, 0.0, 1.0 / 0.8)])
def test_a_schedule_is_proven_and_forgotten_at_the_rates_of_the_equation(settled, told, begin, end, rate) -> None:
    after = credit_after(1.0, rate, 1e-3 / rate, settled._replace(proven=begin), settled=told)
    assert after.proven == pytest.approx(end + (begin - end) * math.exp(-1.0), rel=2e-3)


def test_each_condition_of_a_pardon_counts_by_itself(settled) -> None:
    """m = p clip(5 κ − 1, 0, 1) clip(4 t − 2, 0, 1) clip(10 l − 8, 0, 1), each at a half, and where it ends."""
    halves = {"credit": 0.3, "trust": 0.625, "learned": 0.85}
    nothing = {"credit": 0.2, "trust": 0.5, "learned": 0.8}
    half_a_push = 1.125 * 0.09**2
    assert credit.pardon(settled, BEAT, FLOATS) == 1.0
    assert credit.pardon(settled, half_a_push, FLOATS) == pytest.approx(0.5)
    for name, half in halves.items():
        assert credit.pardon(settled._replace(**{name: half}), BEAT, FLOATS) == pytest.approx(0.5)
        assert credit.pardon(settled._replace(**{name: nothing[name]}), BEAT, FLOATS) == pytest.approx(0.0, abs=1e-12)
    assert credit.pardon(settled._replace(**halves), half_a_push, FLOATS) == pytest.approx(0.5**4)


def test_after_a_beat_the_control_is_back_within_half_a_second_and_no_sine_sounds(run, settled) -> None:
    after = run(500, upset(run, settled, BEAT), upset=0.0, strain=BEAT)
    assert after[-1].authority == 1.0
    assert max(state.listening for state in after) == 0.0
    assert [state.authority for state in after[:100]] == pytest.approx(
        np.arange(1, 101) * 1e-3 * credit.RETURNING, rel=1e-9
    )


@pytest.mark.parametrize("strain", [0.0, TOO_LARGE], ids=["no push", "too large a push"])
def test_what_is_no_beat_has_the_tissue_heard_first(run, settled, strain) -> None:
    after = run(1000, upset(run, settled, strain), upset=0.0, strain=strain)
    assert all(state.authority == 0.0 for state in after)
    assert after[-1].listening == 1.0


def test_a_push_of_another_axis_excuses_too(run, settled) -> None:
    taken = run(100, settled, Alarm(2.0, BEAT))[-1]
    assert taken.authority == 0.0
    assert run(500, taken, Alarm(0.0, BEAT))[-1].authority == 1.0


def test_a_schedule_that_is_doubted_each_time_it_comes_back_is_heard_first(run, settled) -> None:
    """It rings again before it has had the control for a while: the gains are not those for the tissue."""
    state, most = settled, []
    for _ in range(6):
        state = upset(run, state, BEAT)
        returning = run(120, state, upset=0.0, strain=BEAT)
        state = returning[-1]
        most.append(state.authority)
    assert most[0] > 0.4
    assert most[-1] == 0.0
    assert state.listening > 0.5


def test_a_schedule_that_proves_itself_between_beats_is_pardoned_every_time(run, settled) -> None:
    state = settled
    for _ in range(10):
        state = run(1480, upset(run, state, BEAT), upset=0.0, strain=BEAT)[-1]
        assert state.authority == 1.0
        assert state.listening == 0.0


def test_a_doubt_that_does_not_end_has_the_tissue_heard(run, settled) -> None:
    """Fixed gains on stiff tissue leave as much as a push, for ever: no schedule waits on its credit then."""
    after = run(3500, settled, Alarm(2.0, BEAT), strain=BEAT)
    assert after[-1].authority == 0.0
    assert after[-1].listening == 1.0


def test_without_trust_there_is_no_pardon(run, settled) -> None:
    """A guard took gain back under it."""
    after = run(500, upset(run, settled._replace(trust=0.4), BEAT), upset=0.0, strain=BEAT)
    assert all(state.authority == 0.0 for state in after)


def test_a_force_that_never_calms_has_the_tissue_heard(run, settled) -> None:
    """Gains for stiffer tissue: the loop swings, though by less than takes the control at once."""
    swung = run(1000, settled, upset=0.1**2)
    assert swung[850].authority == 1.0
    assert swung[-1].authority == 0.0
    assert max(state.strain for state in swung) > credit.HEAVY**2  # which tells the other axes
    after = run(500, swung[-1], upset=0.0)
    assert all(state.authority == 0.0 for state in after)
    assert after[-1].listening > 0.9


def test_a_calm_between_two_beats_is_enough(run, settled) -> None:
    state = settled
    for _ in range(5):
        state = run(100, run(700, state, upset=0.3**2)[-1], upset=0.05**2)[-1]
        assert state.authority == 1.0
        assert state.listening == 0.0
