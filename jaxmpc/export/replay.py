"""The simulator's law over the recorded inputs of a robot: the source that JAX traces, in float64."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxmpc.law import entry, force_control, friction_compensation, identification
from jaxmpc.law.force_control import Controller, ControllerState
from jaxmpc.law.friction_compensation import Bristles
from jaxmpc.law.gain_backoff import BackoffMemory
from jaxmpc.law.measurement import MeasurementState
from jaxmpc.law.recorded import RecordedInputs
from jaxmpc.law.reference import split
from jaxmpc.xla import ops
from jaxmpc.xla.precision import in_float64


@in_float64
def replay_law(controller: Controller, compensated: bool, flown: RecordedInputs) -> dict[str, np.ndarray]:
    """Signals of the law by their names in a trace, and `wanted`, the torques before any limit [N m].

    Args:
        controller: Floats; as many weights of the reference as are known ahead.
        compensated: Whether friction is cancelled.
        flown: Inputs.

    Returns:
        Arrays (n, 3), (n, 4) and, the gain, (n, 1); NaN where the law was not in control.
    """

    def one(state: ControllerState, now: dict[str, Any]) -> tuple[ControllerState, dict[str, Any]]:
        q, qd, force, applied, a = (tuple(now[name]) for name in ("q", "qd", "force", "applied", "a_before"))
        state = state._replace(measured=MeasurementState(q, qd))
        felt = tuple(jnp.where(jnp.isnan(y), 0.0, y) for y in force)
        state = _chosen(now["enters"], entry.enter(controller, state, felt, a, ops), state)
        known = ~jnp.any(jnp.isnan(now["force"]))
        force = _chosen(known, force, entry.expected_force(controller, state, ops))
        present, ahead = split(tuple(map(tuple, now["force_ref"])), len(controller.gains.mpc_ref))
        following, command = force_control.respond(controller, state, force, ahead, ops, present=present)
        sample = {
            "u": tuple(axis.u for axis in following.axes),
            "v": command.v,
            "a": command.a,
            "p_hat": tuple(axis.p_hat for axis in following.axes),
            "gain": (jnp.ones(()) if following.guard is None else following.guard.memory.gain,),
            **_known(controller, following),
            "wanted": command.torque.torque,
        }
        if following.guard is not None:
            *kept, share = now["memory"]
            known = jnp.all(jnp.isfinite(jnp.stack(kept)))
            memory = _chosen(known, BackoffMemory(*kept), following.guard.memory)
            share = jnp.where(jnp.isfinite(share), share, following.guard.share)
            following = following._replace(guard=following.guard._replace(memory=memory, share=share))
        if state.bristles is not None:
            moved, _ = friction_compensation.step(controller.nominal.friction, state.bristles, q, qd, ops)
            state = state._replace(bristles=_chosen(now["servo"], moved, state.bristles))
        state = _chosen(now["contact"], force_control.applied(following, command, applied), state)
        if state.bristles is not None:
            known = jnp.all(jnp.isfinite(now["deflection"]))
            bristles = _chosen(known, Bristles(tuple(now["deflection"]), q), state.bristles)
            state = state._replace(bristles=bristles)
        return state, {name: jnp.stack(values) for name, values in sample.items()}

    if not np.any(flown.contact):
        return {}
    # A missing force stays NaN. Anything else that is none would spread, also from where it is not chosen.
    rows = {name: np.nan_to_num(getattr(flown, name)) for name in ("q", "qd", "force_ref", "applied", "a")}
    rows["a_before"] = np.concatenate([np.zeros((1, 3)), rows.pop("a")[:-1]])
    rows["force_ref"] = rows["force_ref"].reshape(len(flown.time), 3, -1)
    rows |= {name: getattr(flown, name) for name in ("force", "contact", "enters", "servo", "memory", "deflection")}
    start = force_control.init(controller, tuple(rows["q"][0]), tuple(np.nan_to_num(flown.force[0])), compensated)
    start = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float64), start)
    _, signals = jax.jit(lambda start, rows: jax.lax.scan(one, start, rows))(start, rows)
    return {name: np.where(flown.contact[:, None], values, np.nan) for name, values in signals.items()}


def _known(controller: Controller, state: ControllerState) -> dict[str, Any]:
    """What a schedule believes of the tissue, and its sine; nothing without one."""
    schedule = controller.gains.schedule
    tissues = [axis.tissue for axis in state.axes if axis.tissue is not None]
    if schedule is None or not tissues:
        return {}
    return {
        "stiffness": [ops.exp(tissue.log_stiffness) for tissue in tissues],
        "authority": [tissue.authority for tissue in tissues],
        "dither": [identification.dither(schedule.identification, tissue) for tissue in tissues],
    }


def _chosen(condition: Any, yes: Any, no: Any) -> Any:
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), yes, no)
