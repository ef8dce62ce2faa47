"""What is measured of a run, gathered on the way so that no trajectory need be kept."""

from math import inf, nan
from typing import Any, NamedTuple

from jaxtyping import Array, Float

from jaxmpc import described

Lane = Any
"""A scalar, or one per lane."""


class Sums(NamedTuple):
    """Sums over samples."""

    error_squared: Lane
    true_squared: Lane
    acceleration_squared: Lane
    change_squared: Lane
    swing_squared: Lane
    """Over the end of the run alone, whatever counts [N²]."""


class Extremes(NamedTuple):
    """Extremes over the samples that count."""

    highest_error: Lane
    lowest_error: Lane
    highest_true: Lane
    lowest_true: Lane
    highest_force: Lane
    """Over all samples, also those that do not count [N]."""
    largest_error: Lane
    """The same of |error| [N]."""


class JointTotals(NamedTuple):
    """What the joints met, which all axes share."""

    clamped: Lane
    """Number of all samples at which a torque limit acted."""
    torque: Lane
    """Largest |torque| wanted of a joint, over all samples [N m]."""
    step: Lane
    """Largest change of it from one sample to the next, while any axis counts [N m]."""


class Metrics(NamedTuple):
    """Metrics per controller (if batched), stiffness and axis: shape (…, stiffness, 3)."""

    rms: Float[Array, "..."]
    """Residual e = y_measured − F_d, root mean square about zero [N]."""
    peak_to_peak: Float[Array, "..."]
    """Largest minus smallest residual [N]."""
    true_rms: Float[Array, "..."]
    """Residual of the force on the tissue itself, without noise, rounding and filter of the sensor, RMS [N]."""
    true_peak_to_peak: Float[Array, "..."]
    """Its largest minus its smallest [N]."""
    effort: Float[Array, "..."]
    """Root mean square of the acceleration asked of the robot [m/s²]."""
    chatter: Float[Array, "..."]
    """Root mean square of its change from sample to sample [m/s²]."""
    peak_force: Float[Array, "..."]
    """Largest measured |force| over the whole run [N]."""
    peak_error: Float[Array, "..."]
    """Largest |residual| [N]."""
    clamped: Float[Array, "..."]
    """Share of all samples at which a torque limit acted, the same on each axis [-]; 0 on the linear loop."""
    joint_torque: Float[Array, "..."]
    """Largest |torque| that the law wanted of any joint, over the whole run [N m]; the rest as for `clamped`."""
    torque_step: Float[Array, "..."]
    """Largest change of it from one sample to the next while scored [N m]; the rest as for `clamped`."""
    swing: Float[Array, "..."]
    """True force above 12 Hz, RMS over the last 10 s of the run, of a shorter one over what comes after settling [N],
    see `jaxmpc.swing`; NaN unless `scenario_data` was asked for it, and of samples too far apart to hold it."""

    def __repr__(self) -> str:
        return described.as_text(*described.metrics(self))

    def _repr_html_(self) -> str:
        return described.as_html(*described.metrics(self))


def no_sums(like: Lane) -> Sums:
    """Sums before the first sample."""
    zero = 0.0 * like
    return Sums(zero, zero, zero, zero, zero)


def no_extremes(like: Lane) -> Extremes:
    """Extremes before the first sample."""
    zero = 0.0 * like
    low, high = zero - inf, zero + inf
    return Extremes(low, high, low, high, zero, zero)


def no_joints(like: Lane) -> JointTotals:
    """Totals of the joints before the first sample, and of a loop that has none."""
    zero = 0.0 * like
    return JointTotals(zero, zero, zero)


def add(
    sums: Sums,
    extremes: Extremes,
    counts: Any,
    error: Lane,
    true_error: Lane,
    a: Lane,
    change: Lane,
    force: Lane,
    swing: Lane,
    ops: Any,
) -> tuple[Sums, Extremes]:
    """Sums and extremes with one more sample.

    Args:
        sums: So far.
        extremes: So far.
        counts: Whether this sample counts.
        error: Measured minus wanted force [N].
        true_error: True minus wanted force [N].
        a: Acceleration asked of the robot [m/s²].
        change: Its change since the last sample [m/s²].
        force: Measured force [N].
        swing: True force above 12 Hz if this sample is of the end of the run, else 0 [N].
        ops: Scalar functions.
    """
    weight = ops.where(counts, 1.0, 0.0)
    return Sums(
        sums.error_squared + weight * error * error,
        sums.true_squared + weight * true_error * true_error,
        sums.acceleration_squared + weight * a * a,
        sums.change_squared + weight * change * change,
        sums.swing_squared + swing * swing,
    ), Extremes(
        ops.where(counts, ops.maximum(extremes.highest_error, error), extremes.highest_error),
        ops.where(counts, ops.minimum(extremes.lowest_error, error), extremes.lowest_error),
        ops.where(counts, ops.maximum(extremes.highest_true, true_error), extremes.highest_true),
        ops.where(counts, ops.minimum(extremes.lowest_true, true_error), extremes.lowest_true),
        ops.maximum(extremes.highest_force, abs(force)),
        ops.maximum(extremes.largest_error, abs(error)),
    )


def add_joints(totals: JointTotals, counts: Any, clamped: Lane, wanted: Any, before: Any, ops: Any) -> JointTotals:
    """Totals of the joints with one more sample.

    Args:
        totals: So far.
        counts: Whether this sample counts on any axis.
        clamped: 1 if a torque limit acted, else 0.
        wanted: Torques that the law wanted, a scalar per joint [N m].
        before: Those of the sample before [N m].
        ops: Scalar functions.
    """
    largest, change = totals.torque, 0.0
    for now, then in zip(wanted, before, strict=True):
        largest, change = ops.maximum(largest, abs(now)), ops.maximum(change, abs(now - then))
    step = ops.where(counts, ops.maximum(totals.step, change), totals.step)
    return JointTotals(totals.clamped + clamped, largest, step)


def merge(first: Sums, second: Sums) -> Sums:
    """Sums of two stretches of time; summing stretch by stretch keeps float32 sums exact to 1e-6."""
    return Sums(*(one + other for one, other in zip(first, second, strict=True)))


def metrics(
    sums: Sums, extremes: Extremes, samples: Lane, steps: Lane, late: Lane | None, joints: JointTotals, ops: Any
) -> Metrics:
    """Metrics of a finished run.

    Args:
        sums: Over the run.
        extremes: Over the run.
        samples: How many samples counted; broadcasts against the sums.
        steps: How many samples there were.
        late: How many of them were of the end of the run; None if nobody asked how the force swings.
        joints: Over the run.
        ops: Scalar functions.
    """

    def root_mean(sum_of_squares: Lane, count: Lane = samples) -> Lane:
        mean = sum_of_squares / count
        # The slope of a root at 0 is infinite; a run without any residual has none to tune.
        return ops.where(mean > 0.0, ops.sqrt(ops.where(mean > 0.0, mean, 1.0)), mean)

    return Metrics(
        rms=root_mean(sums.error_squared),
        peak_to_peak=extremes.highest_error - extremes.lowest_error,
        true_rms=root_mean(sums.true_squared),
        true_peak_to_peak=extremes.highest_true - extremes.lowest_true,
        effort=root_mean(sums.acceleration_squared),
        chatter=root_mean(sums.change_squared),
        peak_force=extremes.highest_force,
        peak_error=ops.maximum(extremes.highest_error, -extremes.lowest_error),
        clamped=joints.clamped / steps,
        joint_torque=joints.torque,
        torque_step=joints.step,
        swing=sums.swing_squared + nan if late is None else root_mean(sums.swing_squared, late),
    )
