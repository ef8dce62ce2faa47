"""The door to every engine: what a program is made of, what it is given, what comes out, and who can run it."""

from abc import ABC, abstractmethod
from typing import Any, ClassVar, Literal, NamedTuple

import jax
import jax.numpy as jnp

from jaxmpc.law.gains import Gains
from jaxmpc.law.scalar import Constant, declared
from jaxmpc.loop.arm import ArmSample, ArmSignals
from jaxmpc.loop.linear import AxisSignals, Sample
from jaxmpc.metrics import Metrics
from jaxmpc.world.contact import Contact
from jaxmpc.world.loop_path import LoopPath
from jaxmpc.world.robot import Robot, RobotStructure

Mode = Literal["forward", "reverse"]
"""A mode of differentiation."""


class ProgramSpec(NamedTuple):
    """What of an experiment needs a program of its own; hashable."""

    engine: str
    """Name of the engine that runs it."""
    preview: bool
    robot: RobotStructure | None
    """Structure of the arm's world; None is the linear loop."""
    slopes: tuple[str, ...] | None = None
    """Metrics whose slopes are wanted, None for all. An engine may leave out the others', which then are NaN."""


class ScenarioData(NamedTuple):
    """What of an experiment is data for the compiled program."""

    stiffness: Any
    """(stiffness,); on the arm (motions, tissues) where each motion has tissues of its own [N/m]."""
    signals: AxisSignals | ArmSignals
    """Signals of the linear world with the axes first, of the arm with the motions first."""
    lsb: Any
    force_limit: Any
    """Largest measured force of a run that is fine [N]."""
    robot: Robot | None
    path: LoopPath


class CellResults(NamedTuple):
    """What came out of the cells."""

    metrics: Metrics
    """(controllers, stiffness, 3·motions)"""
    diverged: Any
    """When a run left the finite numbers or `HIGHEST_FORCE`, (controllers, stiffness, runs); ∞ if never [s]. A run is a
    motion on the arm, and on the linear loop an axis of one."""
    over_limit: Any
    """When the measured force left its limit or the residual 20 N; ∞ if never [s]."""
    lost_contact: Any
    """When the tip left the tissue; ∞ if never [s]."""
    backed_off: Any
    """When a guard first took gain back; ∞ if never [s]."""
    trace: Sample | ArmSample | None
    """(controllers, stiffness, axes, steps, …)"""


class Engine(ABC):
    """A way to run programs; it says how, never what.

    Attributes:
        name: As `ProgramSpec.engine` has it.
        modes: Modes of differentiation through `simulate`.
        precisions: Those of the time stepping.
        devices: Backends of JAX that it runs on.
        integrators: Those of the arm.
        physics: Those of an experiment.
        traces: Whether it keeps samples.
        text: What it is, in a few words.
    """

    name: ClassVar[str]
    modes: ClassVar[tuple[Mode, ...]] = ("forward", "reverse")
    precisions: ClassVar[tuple[str, ...]] = ("float64", "float32")
    devices: ClassVar[tuple[str, ...]] = ("cpu", "gpu")
    integrators: ClassVar[tuple[str, ...]] = ("leapfrog", "euler")
    physics: ClassVar[tuple[str, ...]] = ("linear", "wam")
    traces: ClassVar[bool] = True
    text: ClassVar[str]

    def unfit(self) -> str:
        """Why this machine cannot run it; empty where it can."""
        backend = jax.default_backend()
        return "" if backend in self.devices else f"needs a {' or '.join(self.devices)}; JAX finds only a {backend}"

    @abstractmethod
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
        """Every controller on every tissue, axis and motion; traceable.

        Args:
            spec: The structure.
            gains: Whole ones, each (controllers, …).
            K2: Damping, (controllers,) [1/s].
            contacts: The linear worlds, (controllers, stiffness); the arm needs none.
            data: The data.
            dtype: Precision of the time stepping.
            traced: Keep every sample.
        """


def scalars(gains: Gains, preview: bool) -> Gains:
    """Gains with every vector taken apart into scalars, as the law's inner loop wants them.

    Args:
        gains: One controller, or a batch in the leading dimensions.
        preview: Whether the reference is known along H_p; else its weights are summed.
    """
    ahead = gains.mpc_ref if preview else jnp.sum(gains.mpc_ref, axis=-1, keepdims=True)
    family = gains.schedule
    if family is not None:
        knots = (knot._replace(gains=scalars(knot.gains, preview)) for knot in family.knots)
        family = family._replace(knots=tuple(knots))
    names = (name for name, kind in declared(Gains).items() if isinstance(kind, Constant) and kind.shape)
    vectors = gains._replace(mpc_ref=ahead, schedule=family)
    apart: dict[str, Any] = {name: tuple(jnp.moveaxis(getattr(vectors, name), -1, 0)) for name in names}
    return vectors._replace(**apart)


def as_dtype(tree: Any, dtype: Any) -> Any:
    """Floating leaves in another precision; masks stay what they are."""

    def cast(leaf: Any) -> Any:
        leaf = jnp.asarray(leaf)
        return leaf.astype(dtype) if jnp.issubdtype(leaf.dtype, jnp.floating) else leaf

    return jax.tree.map(cast, tree)
