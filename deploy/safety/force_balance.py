"""Whether the force sensor tells what the motors tell: its scale and its sign, at contact and ever after.

    push beyond the reading = what the motors tell − what was read, both as slow, less the same in the air

Friction and gravity's error make the motors' word uncertain by some newtons, but not unknown. On the way down they
add up to what they add while the tip presses on; an arm that moves up, or stands, shows less. So what the motors tell
in the air, on the way down, is learned once, and a push beyond that is the tissue's. A sensor that reads a fifth of the
force, or its negative, is seen at 3 to 6 N, at once. Smaller pushes are told from friction within two seconds, where
the heart beats (`deploy.safety.hidden_push`). A sensor that reads too much presses too little: it is not seen, and does
no harm.
"""

from math import tanh
from typing import NamedTuple

from deploy.durations import cycles
from deploy.safety.force_estimate import BANDWIDTH
from deploy.safety.hidden_push import SLOW, MotionSums, gathered, hidden_push
from deploy.safety.reasons import Reason
from jaxmpc.law.vectors import Vector3

LEARNED_FROM, LEARNED_TO = 0.2, 0.4
"""Time of an approach in which the air is learned [s]: later it may press on what the sensor hides."""
UNLEARNED = 3.0
"""Push in the air where contact came before it was learned [N]; seen: 1.4 to 2.3 N, with twice the friction too."""
PUSH = 5.0
"""Push beyond the reading that no healthy sensor leaves [N]: 2.5 N is the most that was seen over tissues and rhythms,
and 4.3 N with twice the usual friction on an arm a fifth heavier than its model."""
ASIDE = 9.0
"""The same across the normal, where friction counts either way [N]; seen: 3.5 N."""
SAMPLES = 3
"""In a row."""
HIDDEN = 1.2
"""Push without friction that no healthy sensor hides [N]; seen: 0.5 N, and 1.0 N with twice the friction on an arm a
tenth heavier than its model."""


class BalanceState(NamedTuple):
    """Memory of the check."""

    reading: Vector3 = (0.0, 0.0, 0.0)
    """Measured force, made as slow as the estimate [N]."""
    push: float = 0.0
    """Push beyond it that the motors tell of [N]."""
    approached: int = 0
    """Samples of the approach."""
    samples: int = 0
    """Those in which the air was learned."""
    known: bool = False
    """Whether it has been learned."""
    learned: float = 0.0
    """Sum of the push in the air [N]."""
    slip: float = 0.0
    """Which way the tip goes, as slow as the estimate [-]."""
    learned_slip: float = 0.0
    """Its sum in the air [-]."""
    sums: MotionSums = MotionSums()
    """Sums in contact."""
    beyond: int = 0
    """Samples in a row beyond the bounds."""

    @property
    def air(self) -> float:
        """Push that the motors tell of in the air [N]."""
        return self.learned / self.samples if self.known else UNLEARNED

    @property
    def hidden(self) -> float:
        """Push that the sensor hides, without friction [N]; 0 where it cannot be told."""
        if not self.known:
            return 0.0
        return hidden_push(self.sums, self.learned_slip / self.samples, self.air) or 0.0


def balance_step(
    state: BalanceState,
    estimate: Vector3,
    force: Vector3 | None,
    velocity: Vector3,
    normal: Vector3,
    approaching: bool,
    T_s: float,
) -> tuple[BalanceState, Reason | None]:
    """Take a sample of an approach or of contact.

    Args:
        state: What the last step returned; `BalanceState()` at first.
        estimate: Force on the tissue as the motors tell it [N].
        force: Measured force on the tissue [N]; None where there was none.
        velocity: Of the tip [m/s].
        normal: From the tissue to the air, unit length.
        approaching: Whether the tip is on its way down, and has met nothing by the sensor's word.
        T_s: Sampling time [s].

    Returns:
        The next state, and why the sensor is not to be believed, or None.
    """
    share, reading = min(BANDWIDTH * T_s, 1.0), state.reading
    if force is not None:
        reading = tuple(old + share * (new - old) for old, new in zip(reading, force, strict=True))  # type: ignore[assignment]  # three as before
    apart = tuple(told - read for told, read in zip(estimate, reading, strict=True))
    push = -_dot(normal, apart)
    aside = max(abs(each + push * n) for n, each in zip(normal, apart, strict=True))
    slip = state.slip + share * (tanh(_dot(normal, velocity) / SLOW) - state.slip)
    state = state._replace(reading=reading, push=push, slip=slip)
    if approaching:
        first, last = cycles(LEARNED_FROM, T_s, 0), cycles(LEARNED_TO, T_s)
        if first <= state.approached < last:
            learned, learned_slip = state.learned + push, state.learned_slip + slip
            state = state._replace(samples=state.samples + 1, learned=learned, learned_slip=learned_slip)
        state = state._replace(approached=state.approached + 1, known=state.approached + 1 >= last)
    else:
        state = state._replace(sums=gathered(state.sums, slip, push, T_s))
    beyond = push - state.air > PUSH or aside > ASIDE or state.hidden > HIDDEN
    count = state.beyond + 1 if beyond else 0
    return state._replace(beyond=count), Reason.FORCE_MODEL if count >= SAMPLES else None


def _dot(a: tuple[float, ...], b: tuple[float, ...]) -> float:
    return sum(x * y for x, y in zip(a, b, strict=True))
