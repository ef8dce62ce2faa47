"""Whether a schedule gets the control back after a push, and when it does not; a force that never calms."""

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
