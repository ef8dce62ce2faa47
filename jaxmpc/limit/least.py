r"""The least residual of any linear law in a loop, its sensitivity and its chatter bounded.

With S the sensitivity and e the residual, both affine in Q (`youla`), and stiffnesses K_s/K̂ in [1 − b, 1 + b],

    min RMS(e)   with   RMS(aₖ − aₖ₋₁) ≤ chatter,   |S| ≤ M_s (1 ± b Re(1 − S))   at every angle

which is a second-order cone program. For b = 0 the last is |S| ≤ M_s, and nothing is lost. For a band it suffices: a
gain 1 + δ makes S/(1 + δ (1 − S)) of S, and |1 + δ (1 − S)| ≥ 1 + δ Re(1 − S). So the loop stays stable and below M_s
in the whole band; a law that is not found this way may do better, and the residual is that at K_s = K̂.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Complex, Float

from jaxmpc.experiment import Experiment
from jaxmpc.files.errors import InputError, nearest
from jaxmpc.limit.conic import Rows, least_norm
from jaxmpc.limit.judged import Judged, judged
from jaxmpc.limit.law import LinearLaw, response, spectral_radius_of
from jaxmpc.limit.plant import plant_of
from jaxmpc.limit.youla import DECAY, Affine, law_of, signals, stabiliser
from jaxmpc.quantities import AXES
from jaxmpc.spectra.residual import noise_grid
from jaxmpc.spectra.spectrum import Spectrum, spectrum_of
from jaxmpc.stability.loop import contact_of
from jaxmpc.stability.response import closed_around, filters, tip_response
from jaxmpc.world.contact import Contact
from jaxmpc.world.loop_path import LoopPath
from jaxmpc.xla.precision import in_float64

FUNCTIONS = 40
"""Laguerre functions of Q: with their pole, a memory of 0.36 s, too short to learn a heart's rhythm by heart."""
LINES = 2000
"""Lines that stand for an experiment: few ones would let a law put its notches where they happen to be."""
ANGLES = 300
"""Angles of noise and sensitivity below and above the bend."""
SMALLEST_UNIT = 1e-3
"""The solver counts the residual in the sensor's noise, or where that is less in this [N]."""
TISSUES = 9
"""Tissues of a band on which the sensitivity is looked at."""


class Demands(NamedTuple):
    """What a law is held to."""

    M_s: float = 2.0
    """Largest sensitivity, of the cuts at v and at a [-]."""
    chatter: float = 1.2
    """Largest change of the acceleration asked per sample, RMS [m/s²]; ∞ is none."""
    band: float = 0.0
    """b: it holds for K_s/K̂ in [1 − b, 1 + b]."""


ROBOT = Demands()
"""What a robot's controller is held to."""


class Limit(NamedTuple):
    """The least residual, and the law that reaches it."""

    reached: Judged
    """What the law leaves on the tissue that it is made for; M_s is the largest in the band."""
    law: LinearLaw


def limit_of(
    experiment: Experiment, stiffness: float, axis: str, M_s: float = 2.0, chatter: float = 1.2, band: float = 0.0
) -> Limit:
    """The least residual on one axis of an experiment; of several, `least` shares the spectrum.

    Args:
        experiment: Its heart, noise, delay and filters; on the arm its friction and model error.
        stiffness: K_s = K̂ of the tissue [N/m].
        axis: "x", "y" or "z".
        M_s: Largest sensitivity [-].
        chatter: Largest change of the acceleration asked per sample, RMS [m/s²]; ∞ is none.
        band: b of the stiffness, known to be in K̂ (1 ± b); 0 is known exactly.

    Raises:
        InputError: An argument makes no sense; no law of the class keeps the bounds; the solver is not installed.
    """
    _ = experiment.within_bounds
    return least(spectrum_of(experiment, LINES), experiment.loop_path(), stiffness, axis, Demands(M_s, chatter, band))


@in_float64
def least(
    spectrum: Spectrum,
    path: LoopPath,
    stiffness: float,
    axis: str,
    demands: Demands = ROBOT,
    *,
    damping: float = 0.0,
    functions: int = FUNCTIONS,
) -> Limit:
    """The same in a loop that is disturbed by a spectrum.

    Args:
        spectrum: Of an experiment, with many lines.
        path: Delay and filters.
        stiffness: K̂ [N/m].
        axis: "x", "y" or "z".
        demands: What the law is held to.
        damping: K₂ of the velocity path around which the law is looked for [1/s].
        functions: Laguerre functions.

    Raises:
        InputError: An argument makes no sense; no law of the class keeps the bounds; the solver is not installed.
    """
    _check(stiffness, axis, demands)
    index = AXES.index(axis)
    contact = contact_of(stiffness, damping, path)
    plant, pole = plant_of(contact), float(np.exp(-path.T_s / DECAY))
    around = stabiliser(plant, stiffness, path.T_s)
    theta, shares = noise_grid(ANGLES)
    force, acceleration = signals(plant, around, pole, functions, np.concatenate([spectrum.theta, theta]))
    change = 1.0 - np.exp(-1j * np.concatenate([spectrum.theta, theta]))
    nervous = Affine(change[:, None] * acceleration.base, change[:, None, None] * acceleration.per_weight)

    cones = _sensitivity(force, contact, theta, demands)
    if np.isfinite(demands.chatter):
        moved = _root_mean_square(nervous, spectrum, index, shares, demands.chatter)
        cones.append(Rows(np.append(1.0, moved.offset), np.vstack([0.0 * moved.matrix[:1], moved.matrix])))
    unit = max(float(spectrum.noise[index]), SMALLEST_UNIT)
    weights = least_norm(_root_mean_square(force, spectrum, index, shares, unit), cones)
    if weights is None:
        asked = f"M_s {demands.M_s:g}, chatter {demands.chatter:g} m/s², band ±{100.0 * demands.band:g} %"
        remedy = "Allow more chatter or a larger M_s, or take a narrower band."
        raise InputError("limit", asked, f"reachable at {stiffness:g} N/m, {axis.upper()}", remedy)
    law = law_of(plant, around, pole, weights)
    M_s = largest_sensitivity(law, contact, demands.band)
    return Limit(judged(lambda angles: response(law, angles), contact, spectrum, index, M_s), law)


def _check(stiffness: float, axis: str, demands: Demands) -> None:
    if axis not in AXES:
        raise InputError("axis", axis, "an axis", nearest(f"{axis}", list(AXES)))
    if not (np.isfinite(stiffness) and stiffness > 0.0):
        raise InputError("stiffness", stiffness, "positive [N/m]", "Tissue has 300 to 1900.")
    check_demands(demands)


def check_demands(demands: Demands) -> None:
    """Refuse what no law can be held to.

    Raises:
        InputError: A demand is out of range.
    """
    if not demands.M_s > 1.0:
        raise InputError("M_s", demands.M_s, "above 1", "No loop with delay stays at 1; a robot's has 2.")
    if not demands.chatter > 0.0:
        raise InputError("chatter", demands.chatter, "positive [m/s²]", "Motors bear 1.2; inf is no bound.")
    if not 0.0 <= demands.band < 1.0:
        raise InputError("band", demands.band, "in [0, 1)", "0.08 is ±8 %; 0 is known exactly.")


def _root_mean_square(
    signal: Affine, spectrum: Spectrum, axis: int, shares: Float[np.ndarray, " angles"], unit: float
) -> Rows:
    """Rows whose norm is the root mean square of a signal on one axis, as in `jaxmpc.spectra.residual`, in a unit."""
    lines = len(spectrum.theta)
    met = np.sqrt(0.5) * np.stack([spectrum.heart[axis], spectrum.acceleration[axis]], 1)
    heard = np.sqrt(shares) * spectrum.noise[axis]
    offset = np.concatenate([np.sum(signal.base[:lines, :2] * met, axis=1), signal.base[lines:, 2] * heard])
    slopes = np.einsum("tdw,td->tw", signal.per_weight[:lines, :2], met)
    matrix = np.concatenate([slopes, signal.per_weight[lines:, 2] * heard[:, None]])
    return Rows(np.concatenate([offset.real, offset.imag]) / unit, np.concatenate([matrix.real, matrix.imag]) / unit)


def _sensitivity(force: Affine, contact: Contact, theta: Float[np.ndarray, " angles"], demands: Demands) -> list[Rows]:
    """A cone per angle, cut and end of the band; what the noise does to the measured force is S, cut at v."""
    S, slopes = force.base[-len(theta) :, 2], force.per_weight[-len(theta) :, 2]
    cuts = [np.ones(len(theta))]
    if float(contact.K2):
        cuts.append(1.0 + _damping(contact, theta))
    cones: list[Rows] = []
    for cut in cuts:
        for delta in {demands.band, -demands.band}:
            head, head_slopes = 1.0 + delta * (1.0 - S.real), -delta * slopes.real
            here, here_slopes = S / cut / demands.M_s, slopes / cut[:, None] / demands.M_s
            offsets = np.stack([head, here.real, here.imag], 1)
            cones += map(Rows, offsets, np.stack([head_slopes, here_slopes.real, here_slopes.imag], 1))
    return cones


def _damping(contact: Contact, theta: Float[np.ndarray, " angles"]) -> Complex[np.ndarray, " angles"]:
    """Loop of the damping alone, D."""
    from_velocity = filters(contact, jnp.exp(-1j * theta)).damping
    loop: Complex[np.ndarray, " angles"] = np.asarray(from_velocity * tip_response(contact, theta)[1])
    return loop


def largest_sensitivity(law: LinearLaw, contact: Contact, band: float) -> float:
    """M_s of a law, the largest over the band, of the cuts at v and at a; ∞ where it is unstable.

    Args:
        law: Made for this contact.
        contact: The world, on the tissue in the middle of the band.
        band: b; K_s/K̂ in [1 − b, 1 + b].
    """
    theta, _ = noise_grid(4 * ANGLES)
    controller, peaks = response(law, theta), []
    for gain in np.linspace(1.0 - band, 1.0 + band, TISSUES if band else 1):
        tissue = contact._replace(stiffness=gain * contact.stiffness)
        if spectral_radius_of(law, plant_of(tissue)) >= 1.0:
            return float("inf")
        loop = closed_around(controller, tissue, theta)
        whole = np.asarray(loop.whole)
        peaks.append(max(np.abs(1.0 / whole).max(), np.abs((1.0 + np.asarray(loop.damping)) / whole).max()))
    return float(max(peaks))
