"""The simulator's law over the recorded inputs of a robot: the source that JAX traces, in float64."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxmpc.law import cascade, computed_torque, force_control, friction_compensation, gain_backoff
from jaxmpc.law.cascade import Gains
from jaxmpc.law.chain import Chain
from jaxmpc.law.computed_torque import Nominal
from jaxmpc.law.scalar import Vector, add, scale
from jaxmpc.xla import ops
from jaxmpc.xla.precision import in_float64


class RecordedInputs(NamedTuple):
    """What the law was given, one row a sample."""

    q: Any
    """Measured joint angles (n, 4) [rad]."""
    qd: Any
    """Measured joint velocities (n, 4) [rad/s]."""
    force: Any
    """Measured force on the tissue (n, 3) [N]; NaN where it was missing."""
    force_ref: Any
    """Wanted force (n, 3, ahead) [N]."""
    applied: Any
    """Joint torques that the limits let pass (n, 4) [N m]."""
    a: Any
    """Acceleration asked of the tip before the sample (n, 3) [m/s²]; counts where contact is made."""
    contact: Any
    """Whether the law was in control (n,)."""
    enters: Any
    """Whether it was for the first time (n,)."""
    servo: Any
    """Whether the servo was, which only moves the friction's bristles (n,)."""
    gain: Any
    """Gain that a guard left after the sample (n,) [-]; NaN where it is to be found."""


@in_float64
def replay_law(
    chain: Chain, nominal: Nominal, posture: Vector, gains: Gains, K2: float, compensated: bool, flown: RecordedInputs
) -> dict[str, np.ndarray]:
    """Signals of the law by their names in a trace, and `wanted`, the torques before any limit [N m].

    Args:
        chain: The arm.
        nominal: How the controller believes it to differ.
        posture: Joint angles of its null space [rad].
        gains: Floats; as many weights of the reference as `force_ref` has samples ahead.
        K2: Damping [1/s].
        compensated: Whether friction is cancelled.
        flown: Inputs.

    Returns:
        Arrays (n, 3), (n, 4) and, the gain, (n, 1); where the law was not in control they mean nothing.
    """

    def one(
        state: force_control.ControllerState, now: RecordedInputs
    ) -> tuple[force_control.ControllerState, dict[str, Any]]:
        q, qd, force, applied, a = (tuple(row) for row in (now.q, now.qd, now.force, now.applied, now.a))
        at_entry = tuple(jnp.where(jnp.isnan(y), 0.0, y) for y in force)
        state = _chosen(now.enters, _entered(state, at_entry, q, qd, a), state)
        scaled = blind if state.guard is None else cascade.with_gain(blind, state.guard.gain)
        predicted = tuple(cascade.estimate(scaled, axis, 0.0)[0][0] for axis in state.axes)
        known = ~jnp.any(jnp.isnan(now.force))
        force = tuple(jnp.where(known, y, guess) for y, guess in zip(force, predicted, strict=True))
        wanted = tuple(tuple(axis) for axis in now.force_ref)
        following, command = force_control.step(chain, nominal, posture, gains, K2, state, q, qd, force, wanted, ops)
        sample = {
            "u": tuple(axis.u for axis in following.axes),
            "v": command.v,
            "a": command.a,
            "p_hat": tuple(axis.p_hat for axis in following.axes),
            "gain": (jnp.ones(()) if following.guard is None else following.guard.gain,),
            "wanted": command.torque.torque,
        }
        if following.guard is not None:
            gain = jnp.where(jnp.isnan(now.gain), following.guard.gain, now.gain)
            following = following._replace(guard=following.guard._replace(gain=gain))
        if state.bristles is not None:
            moved, _ = friction_compensation.step(nominal.friction, state.bristles, q, qd, ops)
            state = state._replace(bristles=_chosen(now.servo, moved, state.bristles))
        state = _chosen(now.contact, force_control.applied(following, command, applied), state)
        return state, {name: jnp.stack(values) for name, values in sample.items()}

    def _entered(
        state: force_control.ControllerState, force: Vector, q: Vector, qd: Vector, a: Vector
    ) -> force_control.ControllerState:
        # All that was asked of the tip so far is taken for the disturbance, so that nothing jumps.
        v = add(a, scale(K2, computed_torque.tip_velocity(chain, q, qd, ops)))
        x, y, z = (
            cascade.init(felt, cascade.order(gains))._replace(p_hat=-held, v=held)
            for felt, held in zip(force, v, strict=True)
        )
        return state._replace(axes=(x, y, z), guard=guard)

    guard = None if gains.guard is None else jax.tree.map(jnp.asarray, gain_backoff.init())
    blind = gains._replace(K=(0.0,) * len(gains.K))
    flown = RecordedInputs(*map(jnp.asarray, flown))
    q, force = tuple(flown.q[0]), tuple(jnp.nan_to_num(flown.force[0]))
    axes: Any = tuple(cascade.init(y, cascade.order(gains)) for y in force)
    start = force_control.ControllerState(axes, friction_compensation.init(q) if compensated else None, guard)
    start = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float64), start)
    _, signals = jax.jit(lambda start, flown: jax.lax.scan(one, start, flown))(start, flown)
    return {name: np.asarray(values) for name, values in signals.items()}


def _chosen(condition: Any, yes: Any, no: Any) -> Any:
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), yes, no)
