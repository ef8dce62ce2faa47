"""Motion of the heart's surface as a table of harmonics, in time or in cardiac and respiratory phase."""

import numpy as np

HARMONICS_HZ = np.array([0.34, 0.72, 1.25, 2.53, 3.78, 5.08, 6.32])
"""The seven peaks of the paper's Fig. 4: two of respiration, five of the heartbeat [Hz]."""
AMPLITUDES_MM = np.array(
    [
        [0.80, 0.28, 1.50, 0.80, 0.46, 0.28, 0.16],
        [0.90, 0.30, 1.15, 0.60, 0.35, 0.20, 0.12],
        [1.90, 0.60, 2.85, 1.45, 0.80, 0.45, 0.26],
    ]
)
"""Zero-to-peak amplitudes of X, Y, Z; chosen with Table I in view, so matching it is a calibration [mm]."""
PHASES_DEG = np.array(
    [
        [0.0, 70.0, 265.0, 190.0, 130.0, 70.0, 20.0],
        [35.0, 110.0, 250.0, 150.0, 60.0, 330.0, 270.0],
        [15.0, 85.0, 270.0, 190.0, 110.0, 30.0, 310.0],
    ]
)
"""Phases of the cosines; no publication gives any, hence the option to draw them [deg]."""

RESPIRATION = slice(0, 2)
"""Columns of the table that breathing causes, its harmonics 1 and 2."""
HEARTBEAT = slice(2, 7)
"""Columns of the table that the heartbeat causes, its harmonics 1 to 5."""


def harmonic_motion(t: np.ndarray, scale: float = 1.0, phase_seed: int | None = None) -> np.ndarray:
    """x(t) = Σ A cos(2π f t + φ) per axis, at the table's own seven frequencies.

    Args:
        t: Times, shape (n,) [s].
        scale: Factor on all amplitudes [-].
        phase_seed: Draws all phases uniformly; None keeps the table's.

    Returns:
        Displacement, shape (n, 3) [m].
    """
    phases = harmonic_phases(phase_seed)
    angle = 2.0 * np.pi * HARMONICS_HZ * t[:, None]
    motion: np.ndarray = (
        1e-3
        * scale
        * np.stack(
            [np.cos(angle + phase) @ amplitude for phase, amplitude in zip(phases, AMPLITUDES_MM, strict=True)], axis=1
        )
    )
    return motion


def harmonic_velocity(t: np.ndarray, scale: float = 1.0, phase_seed: int | None = None) -> np.ndarray:
    """Derivative of `harmonic_motion`, same arguments, shape (n, 3) [m/s]."""
    return _series(t, HARMONICS_HZ, 1e-3 * scale * AMPLITUDES_MM, harmonic_phases(phase_seed))[1]


def heartbeat(cardiac_phase: np.ndarray, phase_seed: int | None = None) -> tuple[np.ndarray, np.ndarray]:
    """What the beating alone displaces: the table's harmonics 1 to 5 of the cardiac phase.

    Args:
        cardiac_phase: Cycles since a beat's onset, shape (n,) [cycles]. With the table's phases the stroke
            and most of its return take the first 0.4 of each cycle. The rest moves a fifth to a quarter as fast (RMS),
            its last half by 0.05 to 0.11 of the whole stroke.
        phase_seed: As in `harmonic_motion`.

    Returns:
        Displacement, shape (n, 3) [m], and its derivative by the phase, shape (n, 3) [m/cycle].
    """
    return _locked(cardiac_phase, HEARTBEAT, phase_seed)


def respiration(respiratory_phase: np.ndarray, phase_seed: int | None = None) -> tuple[np.ndarray, np.ndarray]:
    """What breathing alone displaces: the table's harmonics 1 and 2 of the respiratory phase; as `heartbeat`."""
    return _locked(respiratory_phase, RESPIRATION, phase_seed)


def harmonic_phases(phase_seed: int | None) -> np.ndarray:
    """Phases of the cosines, the table's or drawn ones, shape (3, 7) [rad]."""
    phases: np.ndarray = np.deg2rad(PHASES_DEG)
    if phase_seed is None:
        return phases
    return np.random.Generator(np.random.Philox(phase_seed)).uniform(0.0, 2.0 * np.pi, phases.shape)


def _locked(phase: np.ndarray, columns: slice, phase_seed: int | None) -> tuple[np.ndarray, np.ndarray]:
    amplitudes = 1e-3 * AMPLITUDES_MM[:, columns]
    orders = np.arange(1.0, amplitudes.shape[1] + 1.0)
    return _series(phase, orders, amplitudes, harmonic_phases(phase_seed)[:, columns])


def _series(
    at: np.ndarray, frequencies: np.ndarray, amplitudes: np.ndarray, phases: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Σ A cos(2π f u + φ) per axis and its derivative by u."""
    circular = 2.0 * np.pi * frequencies
    turned = circular[:, None] * at
    real, imaginary = amplitudes * np.cos(phases), amplitudes * np.sin(phases)
    weights = np.block([[real, -imaginary], [-imaginary * circular, -real * circular]])
    # Not by a matrix product of BLAS: its rounding would depend on how many times are asked for.
    found = np.einsum("ak,kn->na", weights, np.concatenate([np.cos(turned), np.sin(turned)]))
    return found[:, :3], found[:, 3:]


def fade_in(t: np.ndarray, start: float, duration: float) -> np.ndarray:
    """0 before `start`, 1 after `start + duration` [s], with continuous velocity and acceleration between."""
    s = np.clip((t - start) / duration, 0.0, 1.0) if duration > 0.0 else (t >= start).astype(float)
    faded: np.ndarray = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    return faded


def fade_in_rate(t: np.ndarray, start: float, duration: float) -> np.ndarray:
    """Derivative of `fade_in` [1/s]; 0 for a duration of 0, where it jumps."""
    if duration <= 0.0:
        return np.zeros(np.shape(t))
    s = np.clip((t - start) / duration, 0.0, 1.0)
    rate: np.ndarray = 30.0 * (s * (1.0 - s)) ** 2 / duration
    return rate
