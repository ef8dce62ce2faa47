"""Laws of the tissue under the tip, by name; a new one is a file and a line here."""

from collections.abc import Sequence
from typing import Any

from jaxmpc.world.tissue.base import WIDTH, Axes, Memory, Scalar, Tissue, TissueLaw
from jaxmpc.world.tissue.elastic import Elastic
from jaxmpc.world.tissue.fung import Fung
from jaxmpc.world.tissue.grip import Touched, followed, from_anchor
from jaxmpc.world.tissue.hunt_crossley import HuntCrossley
from jaxmpc.world.tissue.kelvin_voigt import KelvinVoigt
from jaxmpc.world.tissue.standard_linear import StandardLinear, TissueState

__all__ = ["KINDS", "LAWS", "WIDTH", "Tissue", "TissueLaw", "TissueState", "force", "init", "relax"]

LAWS: dict[str, TissueLaw] = {
    law.name: law for law in (Elastic(), KelvinVoigt(), StandardLinear(), HuntCrossley(), Fung())
}
KINDS = tuple(LAWS)
"""Names of the laws."""


def init(kind: str, attached: bool, like: Scalar = 0.0) -> Memory:
    """What a tissue at rest remembers, its numbers in the form of a finite number or batch."""
    memory = LAWS[kind].init(like)
    return memory if attached else Touched((0.0 * like, 0.0 * like), memory)


def force(
    kind: str,
    attached: bool,
    tissue: Tissue,
    memory: Memory,
    d: Sequence[Scalar],
    ddot: Sequence[Scalar],
    ops: Any,
) -> Axes:
    """Force on the tissue; the robot feels its opposite.

    Args:
        kind: Name of its law.
        attached: Whether the tip is held by the tissue (the paper's); if not, it can only press.
        tissue: Constants.
        memory: What `init` or `relax` returned.
        d: Tip less heart, X, Y, Z [m].
        ddot: Its rate [m/s].
        ops: Where `exp`, `sqrt` and `maximum` are.

    Returns:
        X, Y, Z [N].
    """
    law = LAWS[kind]
    if attached:
        return law.held(tissue, memory, d, ddot, ops)
    return law.touched(tissue, memory.law, from_anchor(memory.anchor, d), ddot, ops)


def relax(
    kind: str,
    attached: bool,
    tissue: Tissue,
    memory: Memory,
    d: Sequence[Scalar],
    ddot: Sequence[Scalar],
    h: Scalar,
    ops: Any,
) -> Memory:
    """What the tissue remembers, h later; see `TissueLaw.relax`."""
    relax = LAWS[kind].relax
    if attached:
        return relax(True, tissue, memory, d, ddot, h, ops)
    law = relax(False, tissue, memory.law, from_anchor(memory.anchor, d), ddot, h, ops)
    return Touched(followed(memory.anchor, d, ddot, h, ops), law)
