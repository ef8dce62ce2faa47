"""The closed loop on the arm over time, as a scan: law, robot, heart and metrics, one cell of a batch."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxmpc.engine.rollout import STRETCH
from jaxmpc.law import cascade, force_control
from jaxmpc.law.cascade import Gains
from jaxmpc.law.chain import Chain
from jaxmpc.metrics import Metrics, Totals, add, merge, metrics, nothing
from jaxmpc.world import drive
from jaxmpc.world import robot as world
from jaxmpc.world.robot import HeartSample, Robot, RobotStructure
from jaxmpc.xla import ops
from jaxmpc.xla.cse import sharing


class ArmSignals(NamedTuple):
    """What the arm meets, sample by sample; the same for every controller."""

    heart: Float[Array, "steps 2 3"]
    """Position [m] and velocity [m/s] of the heart at the samples."""
    between: Float[Array, "steps substeps 2 3"]
    """The same where the integrator asks."""
    noise: Float[Array, "steps 3"]
    """[N]"""
    force_ref: Float[Array, "steps 3 ahead"]
    """[N]"""
    score: Float[Array, "steps 3"]
    """1 where a sample counts, else 0."""
    softening: Float[Array, " steps"]
    """Factor on the tissue's stiffness [-]."""
    watch: Float[Array, " steps"]
    """1 once contact must not be lost, else 0."""
    time: Float[Array, " steps"]
    """[s]"""


class ArmSample(NamedTuple):
    """What a recorded run keeps of one sample; vectors over X, Y, Z or J1–J4."""

    force: Any
    """Measured force [N]."""
    force_ref: Any
    """[N]"""
    u: Any
    """MPC output [N]."""
    v: Any
    """Command of the cascade [m/s²]."""
    a: Any
    """Acceleration asked of the tip [m/s²]."""
    p_hat: Any
    """Estimated disturbance [m/s²]."""
    tip: Any
    """Displacement of the tip from where it touched [m]."""
    q: Any
    """Joint angles [rad]."""
    torque: Any
    """Torques sent [N m]."""
    gain: Any = (1.0,)
    """Share of the loop's gain that the guard leaves [-]; 1 without one."""


class Trouble(NamedTuple):
    """When something happened first [s]; ∞ if it did not."""

    diverged: Any
    lost_contact: Any


class ArmCarry(NamedTuple):
    """State of the whole loop between two samples."""

    controller: force_control.ControllerState
    robot: world.RobotState
    a: Any
    """Accelerations asked at the last sample [m/s²]."""
    trouble: Trouble


class Cell(NamedTuple):
    """One controller on one tissue."""

    gains: Gains
    """Taken apart into scalars."""
    K2: Any
    robot: Robot


class Program(NamedTuple):
    """What the program is built from; hashable."""

    chain: Chain
    kind: RobotStructure
    accelerate: Callable[..., Any]
    highest_force: float


def start(program: Program, cell: Cell) -> ArmCarry:
    """The loop at rest: the tip touches without force."""
    zero = 0.0 * cell.K2
    state = world.init(program.chain, program.kind, cell.robot, zero, ops)
    never = Trouble(zero + jnp.inf, zero + jnp.inf)
    resting = state.drive.angle if program.kind.compensated else None
    controller = force_control.init(zero, cascade.order(cell.gains), resting, cell.gains.guard is not None)
    return ArmCarry(controller, state, (zero, zero, zero), never)


def advance(program: Program, cell: Cell, carry: ArmCarry, now: ArmSignals) -> tuple[ArmCarry, ArmSample]:
    """One sample of the closed loop."""
    chain, kind = program.chain, program.kind
    tissue = cell.robot.tissue
    robot = cell.robot._replace(tissue=tissue._replace(stiffness=tissue.stiffness * now.softening))
    force, tip, state = world.sense(chain, kind, robot, carry.robot, _heart(now.heart), tuple(now.noise), ops)
    seen = state.drive
    wanted = tuple(tuple(axis) for axis in now.force_ref)
    controller, command = force_control.step(
        chain,
        robot.nominal,
        robot.posture,
        cell.gains,
        cell.K2,
        carry.controller,
        seen.angle,
        seen.velocity,
        force,
        wanted,
        ops,
    )
    held, sent = drive.command(robot.drive, command.torque.torque, ops)
    controller = force_control.applied(controller, command, held)
    following = world.move(chain, kind, robot, state, sent, tuple(map(_heart, now.between)), program.accelerate, ops)
    gain = 1.0 + 0.0 * cell.K2 if controller.guard is None else controller.guard.gain
    sample = ArmSample(
        force,
        now.force_ref,
        tuple(axis.u for axis in controller.axes),
        command.v,
        command.a,
        tuple(axis.p_hat for axis in controller.axes),
        tip,
        state.q,
        sent,
        (gain,),
    )
    largest = jnp.maximum(jnp.maximum(abs(force[0]), abs(force[1])), abs(force[2]))
    indented = now.heart[0, 2] - tip[2]
    trouble = Trouble(
        _first(carry.trouble.diverged, ~(largest < program.highest_force), now.time),
        _first(carry.trouble.lost_contact, (indented < 0.0) & (now.watch > 0.0), now.time),
    )
    return ArmCarry(controller, following, command.a, trouble), sample


def run(program: Program, cell: Cell, signals: ArmSignals, traced: bool) -> tuple[Metrics, Trouble, ArmSample | None]:
    """Metrics per axis, first troubles and, if wanted, every sample of one cell.

    Each sample is one checkpoint of the reverse mode, which then holds the carry of every step and no more.
    """
    steps = len(signals.time)
    full = -(-steps // STRETCH) * STRETCH

    def stretches(signal: Array) -> Array:
        # The last sample goes on beyond the end: its score is 0, so it changes no metric.
        padded = jnp.pad(signal, [(0, full - steps)] + [(0, 0)] * (signal.ndim - 1), mode="edge")
        return padded.reshape(-1, STRETCH, *signal.shape[1:])

    def one(state: tuple[ArmCarry, Any], now: ArmSignals) -> tuple[tuple[ArmCarry, Any], ArmSample | None]:
        carry, totals = state
        opaque = 1.0 + 0.0 * now.time.ravel()[0]
        following, sample = sharing(partial(advance, program), opaque)(cell, carry, now)
        totals = tuple(
            add(total, now.score[i] > 0.0, force - now.force_ref[i, 0], a, a - before, force)
            for i, (total, force, a, before) in enumerate(zip(totals, sample.force, sample.a, carry.a, strict=True))
        )
        return (following, totals), sample if traced else None

    def stretch(state: tuple[ArmCarry, Any], part: ArmSignals) -> tuple[tuple[ArmCarry, Any], ArmSample | None]:
        carry, totals = state
        (carry, partial), samples = jax.lax.scan(jax.checkpoint(one), (carry, empty), part)
        return (carry, tuple(map(merge, totals, partial))), samples

    empty: tuple[Totals, ...] = (nothing(0.0 * cell.K2),) * 3
    parts = ArmSignals(*map(stretches, signals))
    parts = parts._replace(score=parts.score.at[-1, STRETCH - (full - steps) :].set(0.0)) if full > steps else parts
    (carry, totals), samples = jax.lax.scan(stretch, (start(program, cell), empty), parts)
    count = jnp.sum(signals.score, axis=0)
    found = [metrics(total, count[i]) for i, total in enumerate(totals)]
    per_axis: Metrics = jax.tree.map(lambda *axes: jnp.stack(axes), *found)
    if traced:
        samples = jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:])[:steps], samples)
    return per_axis, carry.trouble, samples


def _heart(values: Array) -> HeartSample:
    return HeartSample(tuple(values[0]), tuple(values[1]))


def _first(when: Any, happens: Any, time: Any) -> Any:
    return jnp.minimum(when, jnp.where(happens, time, jnp.inf))
