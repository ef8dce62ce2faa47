"""Margins of a frozen controller, computed again from its gains: what the header declares need not be believed.

The law itself and a tip on an elastic tissue are run on unit vectors, which gives the loop as matrices; it is cut where
the robot takes v, or a = v − K₂ẋ, and its response follows by solving with them. No formula of the design's is used
(`jaxmpc.stability` has the response in closed form), and no more than numpy.

    s⁺ = A s + B w,  c = C s + D w,  L = −(C (z − A)⁻¹ B + D)
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from deploy.controller.artifact import Artifact
from deploy.runtime.straightline import map_leaves
from jaxmpc.law import cascade
from jaxmpc.law.gains import Gains, constant_reference
from jaxmpc.quantities import MARGINS

SAME: Mapping[str, tuple[float, float]] = {
    "M_s": (2e-3, 0.0),
    "gain_margin_db": (0.0, 0.02),
    "gain_reduction_db": (0.0, 0.02),
    "phase_margin_deg": (0.0, 0.1),
    "delay_margin_s": (0.03, 2e-5),
    "spectral_radius": (1e-5, 0.0),
}
"""Relative and absolute difference up to which two values count as the same: a delay of part of a sample is taken as a
pure one here, and a narrow resonance may lie between the points of the grid."""
ANGLES = np.append(np.geomspace(1e-6, 1e-3, 45, endpoint=False), np.geomspace(1e-3, math.pi, 500))
"""Angles θ = ω T_s, as low as the design looks (`stability.crossings`) [rad]; features between are zoomed in on."""
ZOOMED, ZOOMS = 17, 4
TIP = 7
"""Numbers that the tip remembers: position, velocity, displacement, both measurements and two commands."""


class OpenLoop(NamedTuple):
    """A loop that is cut open, as matrices."""

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: float

    def response(self, theta: np.ndarray) -> np.ndarray:
        """L at angles [rad]."""
        z = np.exp(1j * theta)[:, None, None] * np.eye(len(self.A))
        solved = np.linalg.solve(z - self.A, np.broadcast_to(self.B[:, None], (len(theta), len(self.B), 1)))
        found: np.ndarray = -(solved[..., 0] @ self.C + self.D)
        return found


class TipOnTissue(NamedTuple):
    """A tip that presses on a tissue, between samples: x⁺ = x + φ₁ ẋ + γ₁ a, ẋ⁺ = φ₂ ẋ + γ₂ a.

    Its velocity is measured as the difference of positions over T_s, behind a low-pass.
    """

    T_s: float
    """[s]"""
    stiffness: float
    """[N/m]"""
    phi: tuple[float, float]
    """[s], [-]"""
    gamma: tuple[float, float]
    """[s²], [s]"""
    K2: float
    """Damping by the measured velocity [1/s]; 0 where it is ideal, which is in φ and γ."""
    velocity_pole: float
    sensor_pole: float
    """Poles of the low-passes [-]; 0 passes everything."""
    late: bool
    """Whether a command acts a sample later than the next."""


def margins_at(artifact: Artifact, stiffness: float) -> dict[str, float]:
    """Margins of the fixed gains on a tissue [N/m], as a row of the artifact has them; the worse of both cuts."""
    contact = _contact(artifact, stiffness)
    gains = constant_reference(artifact.gains)._replace(guard=None, schedule=None)
    loops = [_cut(gains, contact, at_a) for at_a in ((False,) if artifact.loop.ideal else (False, True))]
    with np.errstate(all="ignore"):  # what overflows is no loop
        whole = loops[0].A + np.outer(loops[0].B, loops[0].C) / (1.0 - loops[0].D)
    finite = np.all(np.isfinite(whole))
    radius = float(np.max(np.abs(np.linalg.eigvals(whole)))) if finite else math.inf
    if not radius < 1.0:
        lost = dict.fromkeys(MARGINS, math.nan)
        return lost | {"stiffness": stiffness, "M_s": math.inf, "spectral_radius": radius}
    found = [_margins(loop, artifact.T_s) for loop in loops]
    worst = {key: (max if MARGINS[key].ceiling else min)(each[key] for each in found) for key in found[0]}
    return {"stiffness": stiffness, **worst, "spectral_radius": radius}


def differences(artifact: Artifact) -> list[str]:
    """Where declared margins are not those of the gains, a sentence each; empty if they are.

    Those of a schedule where the stiffness is known are not computed again.
    """
    found = []
    for row in artifact.margins:
        again = margins_at(artifact, row["stiffness"])
        for key, margin in MARGINS.items():
            relative, absolute = SAME[key]
            declared, computed = row[key], again[key]
            if declared == computed or abs(declared - computed) <= absolute + relative * abs(computed):
                continue
            said = f"declared {margin.amount(declared, '.4g')}, computed {margin.amount(computed, '.4g')}"
            found.append(f"{key} at {row['stiffness']:g} N/m: {said}")
    return found


def _contact(artifact: Artifact, stiffness: float) -> TipOnTissue:
    loop, T_s = artifact.loop, artifact.T_s
    inside = artifact.K2 if loop.ideal else 0.0
    first = -math.expm1(-inside * T_s) / inside if inside else T_s
    second = (T_s - first) / inside if inside else 0.5 * T_s * T_s
    velocity, sensor = (math.exp(-cut * T_s) if cut else 0.0 for cut in (loop.velocity_cutoff, loop.sensor_cutoff))
    phi = (first, 1.0 - inside * first)
    return TipOnTissue(T_s, stiffness, phi, (second, first), artifact.K2 - inside, velocity, sensor, loop.delay == 2)


def _cut(gains: Gains, contact: TipOnTissue, at_a: bool) -> OpenLoop:
    """The loop's matrices, column by column."""
    size = len(_numbers(cascade.init(gains, 0.0)))
    columns = []
    for vector in np.eye(size + TIP + 1).tolist():
        *state, w = vector
        following, out = _step(gains, contact, state[:size], state[size:], w, at_a)
        columns.append([*following, out])
    whole = np.array(columns).T
    return OpenLoop(whole[:-1, :-1], whole[:-1, -1], whole[-1, :-1], float(whole[-1, -1]))


def _step(
    gains: Gains, contact: TipOnTissue, controller: list[float], tip: list[float], w: float, at_a: bool
) -> tuple[list[float], float]:
    """A sample of the loop that is cut: the next state, and what came to the cut."""
    numbers = iter(controller)
    state: cascade.AxisState = map_leaves(lambda _: next(numbers), cascade.init(gains, 0.0))
    # Without gain (MPC alone) the active state stays at its start, zero: it is no mode of the loop.
    state = state if gains.K[3] else state._replace(p_hat=0.0)
    x, xdot, moved, velocity, force, newest, older = tip
    force = contact.stiffness * x + contact.sensor_pole * (force - contact.stiffness * x)
    measured = moved / contact.T_s
    velocity = measured + contact.velocity_pole * (velocity - measured)
    state, v = cascade.step(gains, state, force, (0.0,))
    damping = contact.K2 * velocity
    applied = older if contact.late else newest
    moved = contact.phi[0] * xdot + contact.gamma[0] * applied
    xdot = contact.phi[1] * xdot + contact.gamma[1] * applied
    tip = [x + moved, xdot, moved, velocity, force, w if at_a else w - damping, newest]
    return [*_numbers(state), *tip], v - damping if at_a else v


def _numbers(state: cascade.AxisState) -> list[float]:
    """All that an axis remembers."""
    found: list[float] = []
    map_leaves(found.append, state)
    return found


def _margins(loop: OpenLoop, T_s: float) -> dict[str, float]:
    theta = ANGLES
    L = loop.response(theta)
    peak = int(np.argmin(np.abs(1.0 + L)))
    M_s = 1.0 / _least(loop, theta[max(peak - 1, 0)], theta[min(peak + 1, len(theta) - 1)])
    real = [_zoomed(loop, theta[i], theta[i + 1], np.imag) for i in _changes(np.imag(L))] + [math.pi]
    at_real = np.real(loop.response(np.array(real)))
    crossing = [_zoomed(loop, theta[i], theta[i + 1], _size) for i in _changes(_size(L))]
    lags = np.mod(np.angle(loop.response(np.array(crossing))) + math.pi, 2.0 * math.pi) if crossing else np.array([])
    return {
        "M_s": float(M_s),
        "gain_margin_db": min((-20.0 * math.log10(-x) for x in at_real if -1.0 < x < 0.0), default=math.inf),
        "gain_reduction_db": min((20.0 * math.log10(-x) for x in at_real if x < -1.0), default=math.inf),
        "phase_margin_deg": math.degrees(min(lags, default=math.inf)),
        "delay_margin_s": float(min(lags / np.array(crossing) * T_s, default=math.inf)) if crossing else math.inf,
    }


def _size(L: np.ndarray) -> np.ndarray:
    found: np.ndarray = np.abs(L) - 1.0
    return found


def _changes(values: np.ndarray) -> list[int]:
    """Where a sign changes to the next value."""
    found: list[int] = np.flatnonzero(np.signbit(values[:-1]) != np.signbit(values[1:])).tolist()
    return found


def _least(loop: OpenLoop, low: float, high: float) -> float:
    """The least |1 + L| between two angles."""
    for _ in range(ZOOMS):
        theta = np.linspace(low, high, ZOOMED)
        values = np.abs(1.0 + loop.response(theta))
        best = int(np.argmin(values))
        low, high = theta[max(best - 1, 0)], theta[min(best + 1, ZOOMED - 1)]
    return float(values[best])


def _zoomed(loop: OpenLoop, low: float, high: float, of: Any) -> float:
    """Where a function of L changes its sign between two angles."""
    for _ in range(ZOOMS):
        theta = np.linspace(low, high, ZOOMED)
        found = _changes(of(loop.response(theta)))
        if not found:
            break
        low, high = theta[found[0]], theta[found[0] + 1]
    return 0.5 * (low + high)
