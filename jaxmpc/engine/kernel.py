"""The engine for GPUs: every lane's whole episode in one kernel, only metrics leave it."""

from math import inf
from typing import Any, ClassVar

import jax
import jax.numpy as jnp

from jaxmpc import swing
from jaxmpc.engine.base import CellResults, Engine, Mode, ProgramSpec, ScenarioData, scalars
from jaxmpc.engine.differentiable import FEW, Program, episodes
from jaxmpc.engine.episode import ArmEpisode, ArmFound, ArmLane, AxisEpisode, AxisFound, AxisLane, on_tissues
from jaxmpc.engine.forward_dynamics import implicit
from jaxmpc.engine.pallas_triton import Shape
from jaxmpc.engine.scan import Scan
from jaxmpc.engine.tangents import movers
from jaxmpc.law.gains import Gains
from jaxmpc.loop.arm import ArmLoop, ArmSignals, Cell, Trouble
from jaxmpc.metrics import Extremes, JointTotals, Metrics, Sums, metrics, no_extremes, no_joints, no_sums
from jaxmpc.world.arm import chain
from jaxmpc.world.contact import Contact
from jaxmpc.xla import ops

ARM, AXIS = Shape(64, 2), Shape(64, 1, samples=5)
"""A program of the arm, and of the linear loop (measured)."""
WARP = 32
"""Lanes that a multiprocessor cannot but run together."""
ARM_ALONG, AXIS_ALONG = Shape(256, 8, 2), Shape(32, 1, 4, samples=5)
"""The same of one that differentiates along so many directions if slopes of few things are wanted, else along half as
many: more need too many registers (measured)."""


class Kernel(Engine):
    """One Pallas kernel around the scan's steps and their tangents; interpreted, and slow, where there is no GPU."""

    name = "kernel"
    modes: ClassVar[tuple[Mode, ...]] = ("forward",)
    devices = ("gpu",)
    traces = False
    text = "whole episodes in one kernel"

    def simulate(
        self,
        spec: ProgramSpec,
        gains: Gains,
        K2: Any,
        contacts: Contact | None,
        data: ScenarioData,
        dtype: Any,
        traced: bool = False,
    ) -> CellResults:
        """See `Engine.simulate`; samples, which a kernel does not keep, come from the scan."""
        if traced:
            return Scan().simulate(spec, gains, K2, contacts, data, dtype, traced)
        apart = scalars(gains, spec.preview)
        if spec.robot is None:
            assert contacts is not None
            return _axes(spec, apart, contacts, data, dtype)
        return _arm(spec, apart, K2, data, dtype)


def _axes(spec: ProgramSpec, gains: Gains, contacts: Contact, data: ScenarioData, dtype: Any) -> CellResults:
    """The linear loop: a group is an axis."""
    signals, judged = data.signals, data.signals.late is not None
    contact = jax.tree.map(jnp.transpose, contacts)
    lane = AxisLane(
        gains,
        contact,
        jnp.reshape(data.lsb, (-1, 1, 1)),
        data.force_limit,
        swing.high_pass(contact.T_s, ops) if judged else None,
    )
    shape = len(signals.heart), *contact.T_s.shape
    of_sums, of_extremes, _ = _made_of(spec.slopes)
    wanted = AxisFound(of_sums, of_extremes, diverged=False, over_limit=False)
    sums, extremes, *trouble = _run(AxisEpisode(), lane, shape, signals, (AXIS, AXIS_ALONG), dtype, wanted)
    diverged, over_limit = jax.lax.stop_gradient(trouble)
    scored, late = _per_group(signals.score), _per_group(signals.late) if judged else None
    steps = signals.heart.shape[1]
    found = metrics(sums, extremes, scored, steps, late, no_joints(jnp.zeros_like(sums.error_squared)), ops)
    never = jnp.transpose(diverged) + inf
    return CellResults(
        jax.tree.map(jnp.transpose, found), jnp.transpose(diverged), jnp.transpose(over_limit), never, never, None
    )


def _arm(spec: ProgramSpec, gains: Gains, K2: Any, data: ScenarioData, dtype: Any) -> CellResults:
    """The arm: a group is a motion."""
    assert spec.robot is not None
    assert isinstance(data.signals, ArmSignals)
    assert data.robot is not None
    signals, judged = data.signals, data.signals.late is not None
    cell = Cell(gains, K2, on_tissues(data.robot, jnp.asarray(data.stiffness)[..., None]))
    high_pass = swing.high_pass(cell.robot.measurement.T_s, ops) if judged else None
    lane = ArmLane(cell, data.force_limit, high_pass)
    motions, steps = signals.time.shape
    shape = motions, jnp.shape(data.stiffness)[-1], *jnp.shape(K2)
    episode = ArmEpisode(ArmLoop(chain(), spec.robot, implicit))
    of_sums, of_extremes, of_joints = _made_of(spec.slopes)
    wanted = ArmFound((of_sums,) * 3, (of_extremes,) * 3, of_joints, Trouble(*(False,) * len(Trouble._fields)))
    sums, extremes, joints, trouble = _run(episode, lane, shape, signals, (ARM, ARM_ALONG), dtype, wanted)
    scored, late = jnp.sum(signals.score, axis=1), _per_group(signals.late) if judged else None
    axes = zip(sums, extremes, jnp.moveaxis(scored, 1, 0)[..., None, None], strict=True)
    each = [metrics(added, most, counted, steps, late, joints, ops) for added, most, counted in axes]

    def per_cell(*fields: Any) -> Any:
        return jnp.stack(jax.tree.map(jnp.transpose, fields), axis=-1).reshape(*shape[:0:-1], 3 * motions)

    found: Metrics = jax.tree.map(per_cell, *each)
    diverged, over_limit, lost_contact, backed_off = map(jnp.transpose, jax.lax.stop_gradient(trouble))
    return CellResults(found, diverged, over_limit, lost_contact, backed_off, None)


def _run(episode: Any, lane: Any, shape: Any, signals: Any, cut: tuple[Shape, Shape], dtype: Any, wanted: Any) -> Any:
    interpret = jax.default_backend() == "cpu"
    lanes = shape[1] * shape[2]
    alone, along = (_as_wide_as_needed(_of_precision(one, dtype), lanes) for one in cut)
    slopes = tuple(jax.tree.leaves(wanted))
    if sum(slopes) > FEW:
        along = along._replace(directions=-(-along.directions // 2))
    return episodes(Program(episode, shape, jnp.dtype(dtype), alone, along, interpret, slopes), lane, signals)


def _made_of(names: tuple[str, ...] | None) -> tuple[Sums, Extremes, JointTotals]:
    """Whether metrics are made of each thing that is gathered; None are all metrics."""

    def chosen(sums: Sums, extremes: Extremes, joints: JointTotals) -> list[Any]:
        found = metrics(sums, extremes, 1.0, 1.0, 1.0, joints, ops)
        return [getattr(found, name) for name in (found._fields if names is None else names)]

    zero = jnp.zeros(())
    gathered = no_sums(zero), no_extremes(zero), no_joints(zero)
    closed = jax.make_jaxpr(chosen)(*gathered)
    made: tuple[Sums, Extremes, JointTotals] = jax.tree.unflatten(
        jax.tree.structure(gathered), movers(closed, (True,) * len(closed.out_avals))
    )
    return made


def _of_precision(cut: Shape, dtype: Any) -> Shape:
    """Programs with a thread for each lane in float64, whose numbers take two registers (measured)."""
    return cut if jnp.dtype(dtype).itemsize == 4 else cut._replace(warps=max(cut.warps, cut.lanes // WARP))


def _as_wide_as_needed(cut: Shape, lanes: int) -> Shape:
    """Programs of half the lanes where a group has so few that fewer of them idle: trials have 30 to a motion."""
    half = cut.lanes // 2
    if half < WARP or lanes > 4 * cut.lanes or -lanes % half == -lanes % cut.lanes:
        return cut
    return cut._replace(lanes=half, warps=max(1, cut.warps // 2))


def _per_group(counts: Any) -> Any:
    return jnp.sum(counts, axis=1)[:, None, None]
