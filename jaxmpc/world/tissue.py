"""Force of the tip on the tissue: four laws besides the paper's spring, attached or merely touching.

With d = x_tip − x_heart per axis, Z up, indentation δ = −d_z and y the force on the tissue:

    elastic           y = K_s d
    kelvin-voigt      y = K_s d + b ḋ
    standard-linear   y = K_s (d − Σᵢ ½ s zᵢ),  żᵢ = (d − zᵢ) / τᵢ,  so K_∞ = (1 − s) K_s
    hunt-crossley     −y_z = k δ^1.5 (1 + c δ̇)         (X, Y: the spring K_s)
    fung              −y_z = a (exp(β δ) − 1)           (X, Y: the spring K_s)

K_s is the secant stiffness at 5 N for each law at its first loading. An attached tissue pulls as it pushes.
One that merely touches never pulls; there is no kink, because δ enters through

    p(δ) = (δ + r)² / 4r,  r = √(δ² + w²):   → δ in contact, → 0 as w⁴ away from it, p ≥ 0, p′ ≥ 0, p″ ≥ 0

which is the algebraic smooth maximum (δ + r)/2 times its own slope, and X and Y fade by p′.
JAX, the robot's recorder and plain floats run this same source: only `+ - * /` and the functions of `ops`.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

Scalar = Any
"""A float, a traced JAX scalar, a batch of either, or a recorded operation."""
Axes = tuple[Scalar, Scalar, Scalar]

KINDS = ("elastic", "kelvin-voigt", "standard-linear", "hunt-crossley", "fung")
"""Names of the laws."""

WIDTH = 5e-5
"""Depth over which contact begins, w [m]."""
_SECANT_FORCE = 5.0
"""Force at which every law has the secant stiffness K_s: the paper's push [N]."""
_FUNG_EXPONENT = 1.543
"""β δ at that force: tangents of 0.42 and 1.96 K_s at 0 and 5 N, 340 and 1590 N/m on a heart of 810 N/m [-]."""
_FUNG_SCALE = 1.3592109
"""a, the 5 N over exp(1.543) − 1 [N]."""
_NO_FALL = 0.05
"""Factor 1 + c δ̇ below which Hunt-Crossley's damping is let run out, so that it never pulls [-]."""


class Tissue(NamedTuple):
    """Constants of one tissue; what a law does not use it ignores. Each may differ from sample to sample."""

    stiffness: Scalar
    """Secant stiffness at 5 N, K_s > 0 [N/m]."""
    viscosity: Scalar = 3.0
    """Kelvin-Voigt's b [N s/m]; above 3 it flatters the phase margin."""
    relaxing: Scalar = 0.25
    """Share s of the stiffness that relaxes in the standard linear solid, half in each branch [-]."""
    tau_1: Scalar = 0.1
    """Time constant of the fast branch [s]."""
    tau_2: Scalar = 1.0
    """Time constant of the slow branch [s]."""
    dissipation: Scalar = 0.5
    """Hunt-Crossley's c [s/m]."""


class TissueState(NamedTuple):
    """What the standard linear solid remembers; held as lengths, it outlives a change of stiffness."""

    z_1: Axes
    """Dashpot of the fast branch, X, Y, Z [m]."""
    z_2: Axes
    """Dashpot of the slow branch, X, Y, Z [m]."""


TissueMemory = TissueState | tuple[()]
"""Laws without memory carry an empty tuple."""


def init(kind: str, like: Scalar = 0.0) -> TissueMemory:
    """State of a tissue at rest, its numbers in the form of `like`.

    Args:
        kind: One of `KINDS`.
        like: A finite number, or a batch.
    """
    zero = 0.0 * like
    return TissueState((zero, zero, zero), (zero, zero, zero)) if kind == "standard-linear" else ()


def force(
    kind: str,
    attached: bool,
    tissue: Tissue,
    state: TissueMemory,
    d: Sequence[Scalar],
    ddot: Sequence[Scalar],
    ops: Any,
) -> Axes:
    """Force on the tissue; the robot feels its opposite.

    Args:
        kind: One of `KINDS`.
        attached: Whether the tip is held by the tissue (the paper's); if not, it can only press.
        tissue: Constants.
        state: What `init` or `relax` returned.
        d: Tip less heart, X, Y, Z [m].
        ddot: Its rate [m/s].
        ops: Where `exp`, `sqrt` and `maximum` are.

    Returns:
        X, Y, Z [N].
    """
    K_s = tissue.stiffness
    if attached and kind == "elastic":
        return K_s * d[0], K_s * d[1], K_s * d[2]
    x, y, z = (_linear(kind, tissue, state, i, d[i], ddot[i]) for i in range(3))
    delta, deltadot = -d[2], -ddot[2]
    if attached:
        if kind == "hunt-crossley":
            z = -_hunt_crossley(tissue, delta, deltadot, ops)
        elif kind == "fung":
            # Two one-sided exponentials meet at 0 with the same slope, and neither overflows on the other side.
            z = -_fung(tissue, ops.maximum(delta, 0.0), ops) + _fung(tissue, ops.maximum(-delta, 0.0), ops)
        return x, y, z
    depth, contact = _touching(delta, WIDTH, ops)
    if kind == "hunt-crossley":
        normal = _hunt_crossley(tissue, depth, 0.0, ops)
        normal = normal * _touching(1.0 + tissue.dissipation * deltadot, _NO_FALL, ops)[0]
    elif kind == "fung":
        normal = _fung(tissue, depth, ops)
    else:
        # The rate counts only in contact. K_s p(δ; w) = p(K_s δ; K_s w), so damping is inside and cannot pull.
        wanted = -_linear(kind, tissue, state, 2, d[2], contact * ddot[2])
        normal = _touching(wanted, K_s * WIDTH, ops)[0]
    return contact * x, contact * y, -normal


def relax(
    kind: str,
    attached: bool,
    tissue: Tissue,
    state: TissueMemory,
    d: Sequence[Scalar],
    ddot: Sequence[Scalar],
    h: Scalar,
    ops: Any,
) -> TissueMemory:
    """State advanced by h, exact on a steady ramp and otherwise second order, stable at any h.

    With q = h / τ and e⁻q ≈ 1 / (1 + q + q²/2), for a tissue displaced from r₀ to r₁ meanwhile:

        z⁺ = (z + ½q r₀ + ½(q + q²) r₁) / (1 + q + ½q²)

    a weighted mean, so z never leaves the range of what it has followed. Without contact it returns to 0.

    Args:
        kind: One of `KINDS`.
        attached: As for `force`.
        tissue: Constants.
        state: State at the beginning.
        d: Tip less heart at the beginning, X, Y, Z [m].
        ddot: Mean of its rate over h [m/s].
        h: Time to advance [s].
        ops: Where `sqrt` is.
    """
    if kind != "standard-linear":
        return state
    begin, end = (d[0], d[1], d[2]), (d[0] + h * ddot[0], d[1] + h * ddot[1], d[2] + h * ddot[2])
    if not attached:
        begin, end = _surface(begin, ops), _surface(end, ops)
    assert isinstance(state, TissueState)
    z_1, z_2 = state
    return TissueState(_follow(z_1, begin, end, h / tissue.tau_1), _follow(z_2, begin, end, h / tissue.tau_2))


def _follow(z: Axes, begin: Axes, end: Axes, q: Scalar) -> Axes:
    first, second = 0.5 * q, 0.5 * (q + q * q)
    scale = 1.0 / (1.0 + first + second)
    x, y, z_ = ((z[i] + first * begin[i] + second * end[i]) * scale for i in range(3))
    return x, y, z_


def _surface(d: Axes, ops: Any) -> Axes:
    """Displacement of the tissue's surface where the tip merely touches [m]."""
    depth, contact = _touching(-d[2], WIDTH, ops)
    return contact * d[0], contact * d[1], -depth


def _touching(value: Scalar, width: Scalar, ops: Any) -> tuple[Scalar, Scalar]:
    """The smooth positive part p and its slope p′ = ¼(1 + u)²(2 − u), u = δ/r."""
    r = ops.sqrt(value * value + width * width)
    u = value / r
    rise = 0.25 * (1.0 + u) * (1.0 + u)
    return r * rise, rise * (2.0 - u)


def _linear(kind: str, tissue: Tissue, state: TissueMemory, axis: int, d: Scalar, ddot: Scalar) -> Scalar:
    if kind == "kelvin-voigt":
        return tissue.stiffness * d + tissue.viscosity * ddot
    if kind == "standard-linear":
        assert isinstance(state, TissueState)
        z_1, z_2 = state
        return tissue.stiffness * (d - 0.5 * tissue.relaxing * (z_1[axis] + z_2[axis]))
    return tissue.stiffness * d


def _hunt_crossley(tissue: Tissue, delta: Scalar, deltadot: Scalar, ops: Any) -> Scalar:
    """k δ √r (1 + c u δ̇), odd in δ: k δ^1.5 outside w, a finite slope inside; u makes pulling damped too.

    k = 5 N / (5 N / K_s)^1.5 = K_s √(K_s / 5 N).
    """
    r = ops.sqrt(delta * delta + WIDTH * WIDTH)
    k = tissue.stiffness * ops.sqrt(tissue.stiffness / _SECANT_FORCE)
    return k * delta * ops.sqrt(r) * (1.0 + tissue.dissipation * (delta / r) * deltadot)


def _fung(tissue: Tissue, delta: Scalar, ops: Any) -> Scalar:
    """a (exp(β δ) − 1) with β = 1.543 K_s / 5 N."""
    return _FUNG_SCALE * (ops.exp(_FUNG_EXPONENT / _SECANT_FORCE * tissue.stiffness * delta) - 1.0)
