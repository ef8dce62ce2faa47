"""What one loop passes on its way from the command to the measurement: sampling, delay and filters.

Whoever judges, tunes, simulates or freezes a loop takes it from here, so that all of them mean the same one.
"""

from dataclasses import replace
from typing import Any

import equinox as eqx
import numpy as np

from jaxmpc.files.errors import InputError, truth
from jaxmpc.law.force_filter import ForceFilter
from jaxmpc.world.contact import hertz
from jaxmpc.world.sensor import SENSOR_LOWPASS_HZ

VELOCITY_CUTOFF = 180.0
"""Default velocity low-pass of the WAM [rad/s] (libbarrett, `wam4.conf`)."""


class LoopPath(eqx.Module):
    """Filters and delays of a loop; the numbers may be traced, `ideal` is structure.

    Attributes:
        T_s: Sampling time [s].
        delay: Between a command and its effect, 1 or 2 [samples].
        velocity_cutoff: Low-pass of the velocity [rad/s]; unused with ideal damping.
        sensor_cutoff: Low-pass of the force sensor [rad/s]; 0 is none.
        ideal: Whether the damping is the paper's ideal one (6), or goes through the measured velocity.
        force_filter: What the controller makes the measured force pass; None is nothing.
    """

    T_s: Any
    delay: Any
    velocity_cutoff: Any
    sensor_cutoff: Any
    ideal: bool = eqx.field(static=True)
    force_filter: ForceFilter | None = None

    def with_cutoff(self, velocity_cutoff: Any) -> "LoopPath":
        """The same behind a controller's own low-pass of the velocity, one or one for each of a batch [rad/s].

        None leaves it as it is.
        """
        return self if velocity_cutoff is None else replace(self, velocity_cutoff=velocity_cutoff)


def check_delay(delay: Any) -> None:
    """Refuse what is no delay of a loop [samples].

    Raises:
        InputError: It is not 1 or 2.
    """
    given = np.asarray(delay)
    if given.ndim or given.dtype.kind not in "iuf" or given not in (1, 2):
        raise InputError("delay", delay, "1 or 2 samples", "Longer delays are judged by the delay margin.")


def loop_path(
    T_s: float = 1e-3,
    delay: int = 1,
    ideal: bool = False,
    *,
    velocity_cutoff: float = VELOCITY_CUTOFF,
    lowpass_hz: float | None = None,
    force_filter: ForceFilter | None = None,
) -> LoopPath:
    """Path of a loop as it runs, or of the paper's ideal one.

    Args:
        T_s: Sampling time [s].
        delay: Between a command and its effect, 1 or 2 [samples].
        ideal: Whether the damping is ideal.
        velocity_cutoff: Low-pass of the velocity [rad/s].
        lowpass_hz: Low-pass of the force sensor [Hz], 0 is none. None is `SENSOR_LOWPASS_HZ` as it runs, and none in
            the ideal loop.
        force_filter: What the controller makes the measured force pass; None is nothing.

    Raises:
        InputError: The delay is not 1 or 2, or `ideal` no truth value.
    """
    check_delay(delay)
    ideal = truth("ideal", ideal, "True is the paper's ideal damping.")
    if lowpass_hz is None:
        lowpass_hz = 0.0 if ideal else SENSOR_LOWPASS_HZ
    return LoopPath(T_s, float(delay), velocity_cutoff, hertz(lowpass_hz), ideal, force_filter)
