"""Least norm under second-order cones: min ‖o + M x‖ with every ‖tail‖ ≤ head of oᵢ + Mᵢ x, by Clarabel.

Goulart and Chen, Clarabel: An interior-point solver for conic programs with quadratic objectives, 2024.
"""

from collections.abc import Sequence
from types import ModuleType
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxmpc.files.errors import InputError

SOLVED = ("Solved", "AlmostSolved")
"""What counts: to 1e-8, or to 5e-5 where the numbers allow no more; either is far below what a residual is told to."""


class Rows(NamedTuple):
    """Values affine in the unknown: offset + matrix @ x; as a cone, the first bounds the norm of the others."""

    offset: Float[np.ndarray, " rows"]
    matrix: Float[np.ndarray, "rows unknowns"]


def solver() -> ModuleType:
    """Clarabel.

    Raises:
        InputError: It is not installed.
    """
    try:
        import clarabel
    except ModuleNotFoundError:
        raise InputError("clarabel", "missing", "installed", "Run: pip install 'jaxmpc[limit]'") from None
    found: ModuleType = clarabel
    return found


def least_norm(objective: Rows, cones: Sequence[Rows]) -> Float[np.ndarray, " unknowns"] | None:
    """The x of least ‖objective‖ within all cones; None where there is none, or the solver did not find it.

    Raises:
        InputError: The solver is not installed.
    """
    from scipy.sparse import csc_matrix

    clarabel = solver()

    objective, cones = _compressed(objective), [_compressed_cone(cone) for cone in cones]
    # Unknowns in which all that is asked has slopes of one size: otherwise weights of 1e3 and 1e-3 meet in the solver.
    stacked = np.vstack([objective.matrix, *(cone.matrix / np.sqrt(len(cones)) for cone in cones)])
    scale = np.linalg.inv(np.linalg.qr(stacked, mode="r"))

    size = stacked.shape[1]
    bound = np.append(np.zeros(size), 1.0)
    blocks = [np.hstack([cone.matrix @ scale, np.zeros((len(cone.offset), 1))]) for cone in cones]
    blocks.append(np.vstack([bound, np.hstack([objective.matrix @ scale, np.zeros((len(objective.offset), 1))])]))
    offsets = [cone.offset for cone in cones] + [np.append(0.0, objective.offset)]

    settings = clarabel.DefaultSettings()
    settings.verbose = False
    kinds = [clarabel.SecondOrderConeT(len(offset)) for offset in offsets]
    free, sides = csc_matrix((size + 1, size + 1)), np.concatenate(offsets)
    found = clarabel.DefaultSolver(free, bound, csc_matrix(-np.vstack(blocks)), sides, kinds, settings).solve()
    return scale @ np.array(found.x[:size]) if str(found.status) in SOLVED else None


def _compressed(rows: Rows) -> Rows:
    """As many rows as unknowns and one more, of the same norm for every x."""
    if len(rows.offset) <= rows.matrix.shape[1] + 1:
        return rows
    triangle = np.linalg.qr(np.hstack([rows.matrix, rows.offset[:, None]]), mode="r")
    return Rows(triangle[:, -1], triangle[:, :-1])


def _compressed_cone(cone: Rows) -> Rows:
    tail = _compressed(Rows(cone.offset[1:], cone.matrix[1:]))
    return Rows(np.append(cone.offset[0], tail.offset), np.vstack([cone.matrix[:1], tail.matrix]))
