"""The force sensor at the tip: inertia of the tool beyond it, low-pass, noise, quantisation, Kalman filter."""

from typing import Any, NamedTuple

from jaxmpc.law.scalar import Scalar, Vector, add, scale, sub
from jaxmpc.world.quantise import quantise


class SensorModel(NamedTuple):
    """Constants; each scalar may be a batch."""

    pole: Scalar
    """Pole of its low-pass [-]; 0 passes everything."""
    lsb: Vector
    """Least significant bit per axis [N]; 0 is a perfect one."""
    tool_mass: Scalar
    """Mass beyond the sensor, whose inertia it reads [kg]; its weight is tared."""
    kalman: tuple[Scalar, Scalar]
    """Steady gains of the Kalman filter: force [-] and force rate [1/s]."""


class SensorState(NamedTuple):
    """What the sensor remembers; () where the experiment has no such filter."""

    force: Vector
    """Behind the low-pass [N]."""
    filtered: Any
    """Force [N] and force rate [N/s] of the Kalman filter."""
    tip_velocity: Any
    """At the last sample, for the inertia [m/s]."""


def init(kalman: bool, tool_inertia: bool, zero: Scalar) -> SensorState:
    """A sensor that has read nothing yet, its numbers in the form of `zero`."""
    three = (zero,) * 3
    return SensorState(three, (three, three) if kalman else (), three if tool_inertia else ())


def read(
    sensor: SensorModel, state: SensorState, true: Vector, velocity: Vector, noise: Vector, T_s: Scalar, ops: Any
) -> tuple[Vector, SensorState]:
    """Measured force at a sample [N], and the filters moved on.

    Args:
        sensor: Constants.
        state: What `init` or the last `read` returned.
        true: Force on the tissue, 3 scalars [N].
        velocity: Of the tip, 3 scalars [m/s].
        noise: Of this sample, 3 scalars [N].
        T_s: Sampling time [s].
        ops: Where `where` and `floor` are.
    """
    felt, remembered = true, state.tip_velocity
    if remembered:
        felt = add(true, scale(sensor.tool_mass / T_s, sub(velocity, remembered)))
        remembered = velocity
    force = tuple(now + sensor.pole * (before - now) for now, before in zip(felt, state.force, strict=True))
    measured = tuple(
        quantise(value + error, lsb, ops) for value, error, lsb in zip(force, noise, sensor.lsb, strict=True)
    )
    filtered = state.filtered
    if filtered:
        filtered = _kalman(sensor, filtered, measured, T_s)
        measured = filtered[0]
    return measured, SensorState(force, filtered, remembered)


def _kalman(
    sensor: SensorModel, filtered: tuple[Vector, Vector], measured: Vector, T_s: Scalar
) -> tuple[Vector, Vector]:
    """Force and force rate by a steady Kalman filter whose model is a constant rate."""
    predicted = add(filtered[0], scale(T_s, filtered[1]))
    innovation = sub(measured, predicted)
    return add(predicted, scale(sensor.kalman[0], innovation)), add(filtered[1], scale(sensor.kalman[1], innovation))
