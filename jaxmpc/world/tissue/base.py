"""What every law of a tissue is: force of the tip on it, held by it or merely touching.

With d = x_tip − x_heart per axis, Z up, indentation δ = −d_z and y the force on the tissue, K_s is the secant stiffness
at 5 N for each law at its first loading, to 0.3 % up to 10 kN/m: on stiffer tissue 5 N press no deeper than some w. An
attached tissue pulls as it pushes. One that merely touches never pulls; there is no kink, because δ enters through

    p(δ) = (δ + r)² / 4r,  r = √(δ² + w²):   → δ in contact, → 0 as w⁴ away from it, p ≥ 0, p′ ≥ 0, p″ ≥ 0

which is the algebraic smooth maximum (δ + r)/2 times its own slope, and X and Y fade by p′.
JAX, the robot's recorder and plain floats run this same source: only `+ - * /` and the functions of `ops`.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, ClassVar, NamedTuple

Scalar = Any
"""A float, a traced JAX scalar, a batch of either, or a recorded operation."""
Axes = tuple[Scalar, Scalar, Scalar]
Memory = Any
"""What a law remembers, a tuple; laws without memory carry an empty one."""

WIDTH = 5e-5
"""Depth over which contact begins, w [m]."""
SECANT_FORCE = 5.0
"""Force at which every law has the secant stiffness K_s: the paper's push [N]."""


class TissueConstant(NamedTuple):
    """A constant that a law needs besides the stiffness: a key of the table [tissue]."""

    name: str
    default: float | tuple[float, ...]
    """One number or several."""
    low: float
    high: float


class Tissue(NamedTuple):
    """Constants of one tissue. Each may differ from sample to sample."""

    stiffness: Scalar
    """Secant stiffness at 5 N, K_s > 0 [N/m]."""
    constants: tuple[Any, ...] = ()
    """Those of its law, in the order of its parameters; none are the defaults."""


class TissueLaw(ABC):
    """A law of a tissue: numbers come with each call, so one object serves all.

    Attributes:
        name: As an experiment has it.
        parameters: Its constants besides the stiffness.
    """

    name: ClassVar[str]
    parameters: ClassVar[tuple[TissueConstant, ...]] = ()

    @abstractmethod
    def held(self, tissue: Tissue, memory: Memory, d: Sequence[Scalar], ddot: Sequence[Scalar], ops: Any) -> Axes:
        """Force on a tissue that holds the tip [N].

        Args:
            tissue: Constants.
            memory: What `init` or `relax` returned.
            d: Tip less heart, X, Y, Z [m].
            ddot: Its rate [m/s].
            ops: Where `exp`, `sqrt` and `maximum` are.
        """

    @abstractmethod
    def touched(self, tissue: Tissue, memory: Memory, d: Sequence[Scalar], ddot: Sequence[Scalar], ops: Any) -> Axes:
        """Force on a tissue that the tip can only press; as `held`."""

    def init(self, like: Scalar = 0.0) -> Memory:
        """What the law remembers at rest, its numbers in the form of a finite number or batch."""
        del like
        return ()

    def relax(
        self,
        attached: bool,
        tissue: Tissue,
        memory: Memory,
        d: Sequence[Scalar],
        ddot: Sequence[Scalar],
        h: Scalar,
        ops: Any,
    ) -> Memory:
        """What the law remembers, h later.

        Args:
            attached: Whether the tip is held by the tissue.
            tissue: Constants.
            memory: What it remembers at the beginning.
            d: Tip less heart at the beginning, X, Y, Z [m].
            ddot: Mean of its rate over h [m/s].
            h: Time to advance [s].
            ops: Where `sqrt` is.
        """
        del attached, tissue, d, ddot, h, ops
        return memory

    def constants(self, tissue: Tissue) -> tuple[Any, ...]:
        """Values of the constants."""
        return tissue.constants or tuple(parameter.default for parameter in self.parameters)


def smooth_part(value: Scalar, width: Scalar, ops: Any) -> tuple[Scalar, Scalar]:
    """The smooth positive part p and its slope p′ = ¼(1 + u)²(2 − u), u = δ/r."""
    r = ops.sqrt(value * value + width * width)
    u = value / r
    rise = 0.25 * (1.0 + u) * (1.0 + u)
    return r * rise, rise * (2.0 - u)


def touched_springs(
    along: Callable[[int, Scalar, Scalar], Scalar],
    stiffness: Scalar,
    d: Sequence[Scalar],
    ddot: Sequence[Scalar],
    ops: Any,
) -> Axes:
    """Force on a merely touched tissue whose axes are springs of their own.

    Args:
        along: Force of a held tissue along an axis, at a displacement [m] and a rate [m/s] [N].
        stiffness: K_s [N/m].
        d: Tip less heart, X, Y, Z [m].
        ddot: Its rate [m/s].
        ops: Where `sqrt` is.
    """
    contact = smooth_part(-d[2], WIDTH, ops)[1]
    # The rate counts only in contact. K_s p(δ; w) = p(K_s δ; K_s w), so damping is inside and cannot pull.
    wanted = -along(2, d[2], contact * ddot[2])
    normal = smooth_part(wanted, stiffness * WIDTH, ops)[0]
    return contact * along(0, d[0], ddot[0]), contact * along(1, d[1], ddot[1]), -normal
