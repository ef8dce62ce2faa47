"""Laws of the tissue under the tip, by name; a new one is a file and a line here."""

from collections.abc import Sequence
from typing import Any

from jaxmpc.world.tissue.base import WIDTH, Axes, Memory, Scalar, Tissue, TissueLaw
from jaxmpc.world.tissue.elastic import Elastic
from jaxmpc.world.tissue.fung import Fung
from jaxmpc.world.tissue.hunt_crossley import HuntCrossley
from jaxmpc.world.tissue.kelvin_voigt import KelvinVoigt
from jaxmpc.world.tissue.standard_linear import StandardLinear, TissueState

__all__ = ["KINDS", "LAWS", "WIDTH", "Tissue", "TissueLaw", "TissueState", "force", "init", "relax"]

LAWS: dict[str, TissueLaw] = {
    law.name: law for law in (Elastic(), KelvinVoigt(), StandardLinear(), HuntCrossley(), Fung())
}
KINDS = tuple(LAWS)
"""Names of the laws."""


def init(kind: str, like: Scalar = 0.0) -> Memory:
    """What a tissue at rest remembers, its numbers in the form of a finite number or batch."""
    return LAWS[kind].init(like)


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
    return (law.held if attached else law.touched)(tissue, memory, d, ddot, ops)


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
    return LAWS[kind].relax(attached, tissue, memory, d, ddot, h, ops)
