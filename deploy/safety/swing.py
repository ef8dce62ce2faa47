"""A servo that swings a joint: its encoder tells late, so that what should brake drives.

The servo that approaches, holds and withdraws the tip turns no joint fast. One that swings passes `FAST` some 80 ms
before it comes to 2 rad/s: in time to go on with less bandwidth, which bears more delay. It does go on: an arm that is
let go sags onto the tissue that it was to leave, and one that only bears its weight waits there for the next beat.
"""

from collections.abc import Sequence
from typing import NamedTuple

from deploy.durations import cycles

FAST = (0.7,) * 4
"""Speeds that no joint has under a servo that has braked it [rad/s]: healthy ones come to 0.3, and to 0.4 where the tip
withdraws four times as fast as is usual."""
BRAKED = 0.1
"""Time for the servo, new or softened, to brake a joint [s]."""
CONFIRMED = 0.003
"""Time beyond that speed that is a swing [s], of two samples at least."""


class SwingState(NamedTuple):
    """Memory of the check."""

    served: int = 0
    """Samples since the servo took over, or was last found to swing."""
    fast: int = 0
    """Samples in a row, up to now, with a fast joint."""
    ways: frozenset[tuple[int, bool]] = frozenset()
    """Joints that were fast, and whether forwards."""


def swing_step(
    state: SwingState, serving: bool, fresh: bool, qd: Sequence[float], bounds: Sequence[float], T_s: float, held: bool
) -> tuple[SwingState, bool]:
    """Take a sample.

    Args:
        state: What the last step returned; `SwingState()` at first.
        serving: Whether the servo drives the arm: else all is forgotten.
        fresh: Whether it does so by fresh positions: else nothing is learned.
        qd: Joint velocities (4,) [rad/s].
        bounds: Of their sizes (4,) [rad/s]: `FAST`; or limits that are less, of which it is no swing to be beyond.
        T_s: Sampling time [s].
        held: Whether the tip is to stand still. Somebody may then push it, one way: a swing turns a joint both ways.

    Returns:
        The next state, and whether a swing was found.
    """
    if not serving:
        return SwingState(), False
    if not fresh:
        return state, False
    now = {(i, v > 0.0) for i, (v, most) in enumerate(zip(qd, bounds, strict=True)) if abs(v) > most}
    count = state.fast + 1 if now and state.served >= cycles(BRAKED, T_s) else 0
    if count < cycles(CONFIRMED, T_s, 2):
        return SwingState(state.served + 1, count, state.ways), False
    if held and not any((i, not forwards) in state.ways for i, forwards in now):
        return SwingState(state.served + 1, count, state.ways | now), False
    return SwingState(), True
