"""Whether the force sensor tells what the motors tell: its scale and its sign, at contact and ever after.

    push beyond the reading = what the motors tell − what was read, both as slow, less the same in the air

Friction and gravity's error make the motors' word uncertain by some newtons, but not unknown. On the way down they
add up to what they add while the tip presses on; an arm that moves up, or stands, shows less. So what the motors tell
in the air, on the way down, is learned once, and a push beyond that is the tissue's. A sensor that reads a fifth of the
force, or its negative, is seen at 3 to 6 N. One that reads too much presses too little: it is not seen, and does no
harm.
"""

from typing import NamedTuple

from deploy.safety.force_estimate import BANDWIDTH
from deploy.safety.reasons import Reason
from jaxmpc.law.vectors import Vector3

LEARNED_FROM, LEARNED_TO = 200, 400
"""Cycles of an approach in which the air is learned: later ones may already press on what the sensor does not tell."""
UNLEARNED = 3.0
"""Push in the air where contact came before it was learned [N]; seen: 1.4 to 2.3 N, with twice the friction too."""
PUSH = 5.0
"""Push beyond the reading that no healthy sensor leaves [N]: 2.5 N is the most that was seen over tissues and rhythms,
and 4.3 N with twice the usual friction on an arm a fifth heavier than its model."""
ASIDE = 9.0
"""The same across the normal, where friction counts either way [N]; seen: 3.5 N."""
SAMPLES = 3
"""In a row."""


class BalanceState(NamedTuple):
    """Memory of the check."""

    reading: Vector3 = (0.0, 0.0, 0.0)
    """Measured force, made as slow as the estimate [N]."""
    cycles: int = 0
    """How long the approach has lasted."""
    learned: float = 0.0
    """Sum of the push in the air [N]."""
    beyond: int = 0
    """Samples in a row beyond the bounds."""

    @property
    def air(self) -> float:
        """Push that the motors tell of in the air [N]."""
        if self.cycles < LEARNED_TO:
            return UNLEARNED
        return self.learned / (LEARNED_TO - LEARNED_FROM)


def balance_step(
    state: BalanceState, estimate: Vector3, force: Vector3 | None, normal: Vector3, approaching: bool, T_s: float
) -> tuple[BalanceState, Reason | None]:
    """Take a sample of an approach or of contact.

    Args:
        state: What the last step returned; `BalanceState()` at first.
        estimate: Force on the tissue as the motors tell it [N].
        force: Measured force on the tissue [N]; None where there was none.
        normal: From the tissue to the air, unit length.
        approaching: Whether the tip is on its way down, and has met nothing by the sensor's word.
        T_s: Sampling time [s].

    Returns:
        The next state, and why the sensor is not to be believed, or None.
    """
    reading = state.reading
    if force is not None:
        share = min(BANDWIDTH * T_s, 1.0)
        reading = tuple(old + share * (new - old) for old, new in zip(reading, force, strict=True))  # type: ignore[assignment]  # three as before
    apart = tuple(told - read for told, read in zip(estimate, reading, strict=True))
    push = -sum(n * each for n, each in zip(normal, apart, strict=True))
    aside = max(abs(each + push * n) for n, each in zip(normal, apart, strict=True))
    cycles, learned = state.cycles, state.learned
    if approaching:
        learned += push if LEARNED_FROM <= cycles < LEARNED_TO else 0.0
        cycles += 1
        state = state._replace(cycles=cycles, learned=learned)
    beyond = push - state.air > PUSH or aside > ASIDE
    count = state.beyond + 1 if beyond else 0
    return BalanceState(reading, cycles, learned, count), Reason.FORCE_MODEL if count >= SAMPLES else None
