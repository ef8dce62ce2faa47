"""What is measured of a run, gathered on the way so that no trajectory need be kept."""

from math import inf
from typing import Any, NamedTuple

from jaxtyping import Array, Float

Lane = Any
"""A scalar, or one per lane."""


class Totals(NamedTuple):
    """Sums and extremes over the samples that count."""

    error_squared: Lane
    highest_error: Lane
    lowest_error: Lane
    acceleration_squared: Lane
    change_squared: Lane
    highest_force: Lane
    """Over all samples, also those that do not count [N]."""
    largest_error: Lane
    """The same of |error| [N]."""


class Metrics(NamedTuple):
    """Metrics per controller (if batched), stiffness and axis: shape (…, stiffness, 3)."""

    rms: Float[Array, "..."]
    """Residual e = y_measured − F_d, root mean square about zero [N]."""
    peak_to_peak: Float[Array, "..."]
    """Largest minus smallest residual [N]."""
    effort: Float[Array, "..."]
    """Root mean square of the acceleration asked of the robot [m/s²]."""
    chatter: Float[Array, "..."]
    """Root mean square of its change from sample to sample [m/s²]."""
    peak_force: Float[Array, "..."]
    """Largest measured |force| over the whole run [N]."""
    peak_error: Float[Array, "..."]
    """Largest |residual| [N]."""
    clamped: Float[Array, "..."]
    """Share of all samples at which a torque limit acted, the same on each axis [-]."""


def nothing(like: Lane) -> Totals:
    """Totals before the first sample."""
    zero = 0.0 * like
    return Totals(zero, zero - inf, zero + inf, zero, zero, zero, zero)


def add(totals: Totals, counts: Any, error: Lane, a: Lane, change: Lane, force: Lane, ops: Any) -> Totals:
    """Totals with one more sample.

    Args:
        totals: So far.
        counts: Whether this sample counts.
        error: Measured minus wanted force [N].
        a: Acceleration asked of the robot [m/s²].
        change: Its change since the last sample [m/s²].
        force: Measured force [N].
        ops: Scalar functions.
    """
    weight = ops.where(counts, 1.0, 0.0)
    return Totals(
        totals.error_squared + weight * error * error,
        ops.where(counts, ops.maximum(totals.highest_error, error), totals.highest_error),
        ops.where(counts, ops.minimum(totals.lowest_error, error), totals.lowest_error),
        totals.acceleration_squared + weight * a * a,
        totals.change_squared + weight * change * change,
        ops.maximum(totals.highest_force, abs(force)),
        ops.maximum(totals.largest_error, abs(error)),
    )


def merge(first: Totals, second: Totals, ops: Any) -> Totals:
    """Totals of two stretches of time; summing stretch by stretch keeps float32 sums exact to 1e-6."""
    return Totals(
        first.error_squared + second.error_squared,
        ops.maximum(first.highest_error, second.highest_error),
        ops.minimum(first.lowest_error, second.lowest_error),
        first.acceleration_squared + second.acceleration_squared,
        first.change_squared + second.change_squared,
        ops.maximum(first.highest_force, second.highest_force),
        ops.maximum(first.largest_error, second.largest_error),
    )


def metrics(totals: Totals, samples: Lane, clamped: Lane, ops: Any) -> Metrics:
    """Metrics of a finished run.

    Args:
        totals: Over the run.
        samples: How many samples counted; broadcasts against the totals.
        clamped: Share of all samples at which a torque limit acted [-].
        ops: Scalar functions.
    """

    def root_mean(sum_of_squares: Lane) -> Lane:
        mean = sum_of_squares / samples
        # The slope of a root at 0 is infinite; a run without any residual has none to tune.
        return ops.where(mean > 0.0, ops.sqrt(ops.where(mean > 0.0, mean, 1.0)), mean)

    return Metrics(
        rms=root_mean(totals.error_squared),
        peak_to_peak=totals.highest_error - totals.lowest_error,
        effort=root_mean(totals.acceleration_squared),
        chatter=root_mean(totals.change_squared),
        peak_force=totals.highest_force,
        peak_error=ops.maximum(totals.highest_error, -totals.lowest_error),
        clamped=clamped,
    )
