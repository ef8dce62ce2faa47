"""The force sensor at the tip: inertia of the tool beyond it, low-pass, noise, quantisation."""

from typing import Any, NamedTuple

from jaxmpc.law.ops import Ops
from jaxmpc.law.scalar import Scalar, Vector, add, scale, sub
from jaxmpc.world.quantise import quantise

SENSOR_LOWPASS_HZ = 500.0
"""Fastest low-pass of the JR3 force sensor, which a loop that runs has unless it is told otherwise [Hz]."""


class SensorModel(NamedTuple):
    """Constants; each scalar may be a batch."""

    pole: Scalar
    """Pole of its low-pass [-]; 0 passes everything."""
    lsb: Vector
    """Least significant bit per axis [N]; 0 is a perfect one."""
    tool_mass: Scalar
    """Mass beyond the sensor, whose inertia it reads [kg]; its weight is tared."""


class SensorState(NamedTuple):
    """What the sensor remembers."""

    force: Vector
    """Behind the low-pass [N]."""
    tip_velocity: Any
    """Velocity of the tip at the last sample, for the inertia [m/s]; () if it reads none."""


def init(tool_inertia: bool, zero: Scalar) -> SensorState:
    """A sensor that has read nothing yet, its numbers in the form of `zero`."""
    three = (zero,) * 3
    return SensorState(three, three if tool_inertia else ())


def read(
    sensor: SensorModel, state: SensorState, true: Vector, velocity: Vector, noise: Vector, T_s: Scalar, ops: Ops
) -> tuple[Vector, SensorState]:
    """Measured force at a sample [N], and the filters moved on.

    Args:
        sensor: Constants.
        state: What `init` or the last `read` returned.
        true: Force on the tissue, 3 scalars [N].
        velocity: Of the tip, 3 scalars [m/s].
        noise: Of this sample, 3 scalars [N].
        T_s: Sampling time [s].
        ops: Scalar functions.
    """
    felt, remembered = true, state.tip_velocity
    if remembered:
        felt = add(true, scale(sensor.tool_mass / T_s, sub(velocity, remembered)))
        remembered = velocity
    force = tuple(now + sensor.pole * (before - now) for now, before in zip(felt, state.force, strict=True))
    measured = tuple(
        quantise(value + error, lsb, ops) for value, error, lsb in zip(force, noise, sensor.lsb, strict=True)
    )
    return measured, SensorState(force, remembered)
