"""Gains of the moment: those for a stiffness that is known, blended in as it becomes known.

Between two knots the gains, each brought to a tissue of 1 N/m, are linear in ln K̂; `with_gain` brings them to K̂.
With the authority w of what is known, each gain and the damping are

    g = g_fixed + w (g(K̂) − g_fixed)

All states are forces, force rates and accelerations and mean the same with all gains, so nothing jumps as K̂ or w move.
"""

from collections.abc import Iterable
from typing import Any

from jaxmpc.law import identification
from jaxmpc.law.cascade import AxisState
from jaxmpc.law.gains import Gains, GainSchedule, with_gain
from jaxmpc.law.ops import Ops
from jaxmpc.law.repetition import Repetition
from jaxmpc.law.scalar import Scalar
from jaxmpc.law.stiffness import SILENT, Alarm


def at(schedule: GainSchedule, log_stiffness: Scalar, ops: Ops) -> tuple[Gains, Scalar]:
    """Gains, and damping [1/s], for a tissue of known stiffness.

    Args:
        schedule: The family.
        log_stiffness: ln K̂, K̂ in N/m.
        ops: Scalar functions.
    """
    first, *others = schedule.knots
    found = (_numbers(first.gains), first.K2)
    for lower, upper in zip(schedule.knots, others, strict=False):
        way = (log_stiffness - lower.log_stiffness) / (upper.log_stiffness - lower.log_stiffness)
        below, above = (_numbers(lower.gains), lower.K2), (_numbers(upper.gains), upper.K2)
        found = _moved(found, ops.clip(way, 0.0, 1.0), below, above)
    numbers, K2 = found
    return with_gain(Gains(*numbers), ops.exp(-log_stiffness)), K2


def listen(
    gains: Gains,
    axis: AxisState,
    force: Scalar,
    tip: Scalar,
    wanted: Scalar,
    backed_off: Scalar,
    anywhere: Alarm,
    ops: Ops,
) -> tuple[AxisState, Scalar, Scalar]:
    """Learn from one sample of the tissue, where there is a schedule.

    Args:
        gains: The controller.
        axis: State.
        force: Measured force on the tissue [N].
        tip: Measured displacement of the tip [m].
        wanted: Wanted force [N].
        backed_off: Share of the gain that a guard is taking back [-].
        anywhere: The `alarm` of all axes at the last sample.
        ops: Scalar functions.

    Returns:
        The state; what is added to the wanted force, and what of the measured force answers to that [N].
    """
    if gains.schedule is None or axis.tissue is None:
        return axis, 0.0, 0.0
    constants = gains.schedule.identification
    tissue = identification.step(constants, axis.tissue, force, tip, wanted, backed_off, anywhere, ops)
    heard = identification.answer(constants, tissue)
    return axis._replace(tissue=tissue), identification.dither(constants, tissue), heard


def repetition_of(gains: Gains) -> Repetition | None:
    """What learns of each beat for the next; None without a schedule, or where nothing learns."""
    return None if gains.schedule is None else gains.schedule.repetition


def alarm(axes: Iterable[AxisState], ops: Ops) -> Alarm:
    """The most of any axis; 0 without a schedule."""
    doubt, strain, wave = SILENT
    for axis in axes:
        if axis.tissue is not None:
            doubt, strain = ops.maximum(doubt, axis.tissue.doubt), ops.maximum(strain, axis.tissue.strain)
            wave = wave or axis.tissue.wave
    return Alarm(doubt, strain, wave)


def now(gains: Gains, K2: Scalar, axis: AxisState, ops: Ops) -> tuple[Gains, Scalar]:
    """Gains, and damping [1/s], with what is known of the tissue; the fixed ones without a schedule."""
    tissue = axis.tissue
    if gains.schedule is None or tissue is None:
        return gains, K2
    known, known_K2 = at(gains.schedule, tissue.log_stiffness, ops)
    fixed = _numbers(gains), K2
    numbers, K2 = _moved(fixed, tissue.authority, fixed, (_numbers(known), known_K2))
    return gains._replace(**dict(zip(Gains._fields, numbers, strict=False))), K2


def _numbers(gains: Gains) -> tuple[Any, ...]:
    """The gains without their parts."""
    return gains[: Gains._fields.index("guard")]


def _moved(start: Any, share: Scalar, lower: Any, upper: Any) -> Any:
    """Start + share · (upper − lower), number by number; None where there is none."""
    if start is None:
        return None
    if isinstance(start, tuple):
        return tuple(_moved(*each) for each in zip(start, (share,) * len(start), lower, upper, strict=True))
    return start + share * (upper - lower)
