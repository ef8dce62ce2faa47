"""Joint friction of the arm, identified from a recording of its own motion without contact.

    τ = μ (M_L(q) q̈ + c(q, q̇)) + A q̈ + D q̇ + F_c s(q; z) + τ₀

with the rigid body M_L, c (gravity included) and the drives' inertia A of `jaxmpc/world/wam.xml`, one mass scale μ,
and per joint viscous friction D, Coulomb friction F_c on a Dahl bristle s of presliding z, and an offset τ₀.
How it is fitted stands in `jaxmpc/identify/friction_fit.py`.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxmpc.files.errors import InputError
from jaxmpc.files.samples import csv_lines, npz_vectors
from jaxmpc.world.friction import SMALL_VELOCITY

COLUMNS = ("t", "q1", "q2", "q3", "q4", "tau1", "tau2", "tau3", "tau4")
FEWEST_SAMPLES = 1000
FEWEST_FITTED = 100
"""Samples behind the low-pass, some eight a period of its cutoff: from 41 the sample's first joint had 0.08 ± 0.17
instead of 2.01 N m of Coulomb friction, and presliding displacements came out at the bounds of their search."""
SLOWEST_SAMPLING_HZ = 200.0
LEAST_TRAVEL = 0.1
"""What a joint must span, and the path after which its bristle has forgotten where it began [rad]."""
EDGE = 1.5
"""Left out at both ends, where spline and low-pass have data on one side only [periods of the cutoff]."""
LIGHTEST, HEAVIEST = 0.5, 10.0
"""Masses over the model's [-], between which an experiment can have them."""
LEAST_EXPLAINED = 0.5
"""R² of each joint [-]: the sample has 0.9999, and a torque of the other sign has less than none."""


class MotionRecording(NamedTuple):
    """Motion without contact."""

    t: np.ndarray
    """Times, shape (n,) [s]."""
    q: np.ndarray
    """Joint positions, shape (n, 4) [rad]."""
    tau: np.ndarray
    """Joint torques of the drives, shape (n, 4) [N m]."""


class FrictionEstimate(NamedTuple):
    """Values and their standard errors, four of each, in joint order."""

    value: np.ndarray
    error: np.ndarray


class Identification(NamedTuple):
    """What a recording says of the arm."""

    coulomb: FrictionEstimate
    """Coulomb friction F_c [N m]."""
    viscous: FrictionEstimate
    """Viscous friction D [N m s/rad]."""
    presliding: FrictionEstimate
    """Presliding displacement z [rad]."""
    offset: FrictionEstimate
    """Constant torque τ₀ [N m]; zeros where it was not wanted."""
    mass_scale: float
    """μ: masses of the links over the model's [-]."""
    mass_scale_error: float
    """Its standard error [-]."""
    rms: np.ndarray
    """Residual torque, shape (4,) [N m]."""
    r_squared: np.ndarray
    """Share of each measured torque's variance that is explained, shape (4,) [-]."""
    velocity: np.ndarray
    """Joint velocities of the samples used, shape (m, 4) [rad/s]."""
    measured: np.ndarray
    """Measured torque less rigid body, drives and offset, shape (m, 4) [N m]."""
    fitted: np.ndarray
    """Friction torque of the model, shape (m, 4) [N m]."""


def read_recording(path: str | Path) -> MotionRecording:
    """A recording from CSV (columns named in its first line) or npz, with columns t, q1…q4, tau1…tau4.

    Raises:
        InputError: The file is unreadable, lacks a column or has it twice, has a row of another length, or holds
            something that is no finite number.
    """
    path = Path(path)
    if path.suffix == ".npz":
        columns = npz_vectors(path, "recording")
        _check_columns(path, list(columns))
        values = np.stack([columns[name] for name in COLUMNS], axis=1)
        lines: Sequence[int | None] = [None] * len(values)
    else:
        values, lines = _read_csv(path)
    if not np.isfinite(values).all():
        row, column = (int(index) for index in np.argwhere(~np.isfinite(values))[0])
        remedy = f"Cut the recording there or repair sample {row + 1}."
        raise InputError(COLUMNS[column], float(values[row, column]), "finite", remedy, path, lines[row])
    return MotionRecording(values[:, 0], values[:, 1:5], values[:, 5:9])


def _check_columns(path: Path, names: list[str]) -> None:
    if missing := [name for name in COLUMNS if name not in names]:
        remedy = f"Add {', '.join(missing)}; units: t [s], q1…q4 [rad], tau1…tau4 [N m]."
        raise InputError("columns", ", ".join(names) or "none", ", ".join(COLUMNS), remedy, path, 1)
    if twice := [name for name in COLUMNS if names.count(name) > 1]:
        bound = f"{', '.join(COLUMNS)}, once each"
        raise InputError("columns", ", ".join(names), bound, f"Remove or rename the other {twice[0]}.", path, 1)


def _read_csv(path: Path) -> tuple[np.ndarray, list[int]]:
    names, texts = csv_lines(path, "recording")
    _check_columns(path, names)
    chosen = [names.index(name) for name in COLUMNS]
    rows, lines = [], []
    for line, text in enumerate(texts, 2):
        if not text.strip():
            continue
        try:
            cells = [float(cell) for cell in text.split(",")]
        except ValueError:
            cells = []
        if len(cells) != len(names):
            remedy = "Correct or remove this row."
            raise InputError("row", text.strip(), f"{len(names)} numbers", remedy, path, line)
        rows.append([cells[i] for i in chosen])
        lines.append(line)
    return np.array(rows).reshape(-1, len(COLUMNS)), lines


def _rate(t: np.ndarray) -> float:
    return 1.0 / float(np.median(np.diff(t)))


def _check(recording: MotionRecording, cutoff: float) -> None:
    t, q, _ = recording
    if len(t) < FEWEST_SAMPLES:
        raise InputError("samples", len(t), f"at least {FEWEST_SAMPLES}", "Record for longer.")
    steps = np.diff(t)
    if (steps <= 0.0).any():
        row = int(np.argmax(steps <= 0.0)) + 1
        found = f"{t[row]:g} s after {t[row - 1]:g} s at sample {row + 1}"
        raise InputError("t", found, "increasing", "Sort the rows, drop duplicates.")
    rate = _rate(t)
    if rate < 0.999 * SLOWEST_SAMPLING_HZ:
        bound = f"at least {SLOWEST_SAMPLING_HZ:g} Hz"
        raise InputError("sampling", f"{rate:.3g} Hz", bound, "Is t in s? Else record faster: reversals are short.")
    if not 0.0 < cutoff <= rate / 12.0:
        raise InputError("cutoff", f"{cutoff:g} Hz", f"above 0 and at most {rate / 12.0:g} Hz", "Lower the cutoff.")
    longest = 0.5 / cutoff
    if steps.max() > longest:
        row = int(np.argmax(steps))
        found = f"a gap of {steps[row]:.3g} s after {t[row]:.6g} s, sample {row + 1}"
        remedy = "Give one of its two sides alone: what the torques did meanwhile is not known."
        raise InputError("t", found, f"without gaps above {longest:.3g} s, half a period of the cutoff", remedy)
    for joint in range(4):
        if np.ptp(q[:, joint]) < LEAST_TRAVEL:
            found = f"a span of {np.ptp(q[:, joint]):.3g} rad"
            remedy = f"Move J{joint + 1} too: friction that is not slid over cannot be identified."
            raise InputError(f"q{joint + 1}", found, f"at least {LEAST_TRAVEL:g} rad", remedy)


def identify(recording: MotionRecording, cutoff: float = 15.0, offsets: bool = True) -> Identification:
    """Friction, presliding and mass scale, with standard errors.

    Args:
        recording: At least 1000 samples at 200 Hz or more; every joint moves both ways, at several speeds.
        cutoff: Up to where torques are explained [Hz]; at most a twelfth of the sampling.
        offsets: Whether a constant torque per joint is estimated too.

    Raises:
        InputError: Too few samples, or too few for this cutoff; time that does not increase or has a gap, sampling
            below 200 Hz, a joint whose friction cannot be told from this motion, or torques that are none of an arm
            with these masses.
    """
    from jaxmpc.identify.friction_fit import Band, JointData, fit, rigid_body, smooth

    _check(recording, cutoff)
    t, tau = recording.t, recording.tau
    q, qdot, qddot = smooth(t, recording.q, 4.0 * cutoff)
    links, drives = rigid_body(q, qdot, qddot)
    path = np.cumsum(np.abs(np.diff(q, axis=0)), axis=0).min(axis=1)
    inside = np.searchsorted(t, (t[0] + EDGE / cutoff, t[-1] - EDGE / cutoff))
    used = slice(max(int(inside[0]), int(np.searchsorted(path, LEAST_TRAVEL)) + 1), int(inside[1]))
    band = Band(_rate(t), cutoff, used)
    fitted = len(t[used][:: band.every])
    if fitted < FEWEST_FITTED:
        bound = f"high enough to fit {FEWEST_FITTED} samples (= {fitted} of {t[-1] - t[0]:.3g} s)"
        remedy = f"Raise it or record for longer: {EDGE:g} of its periods are left out at both ends."
        raise InputError("cutoff", f"{cutoff:g} Hz", bound, remedy)
    _check_directions(qdot[used])
    velocity, links, net, tau = band(qdot), band(links), band(tau - drives * qddot), band(tau)
    joints = [JointData(np.diff(q[:, j]), np.diff(t), band, velocity[:, j], links[:, j], net[:, j]) for j in range(4)]
    found = fit(joints, t[used][:: band.every], offsets)
    if not LIGHTEST <= found.mass_scale < HEAVIEST:
        remedy = "q must be in rad, tau in N m, and a positive tau must turn a joint the way in which its q grows."
        bound = f"between {LIGHTEST:g} and {HEAVIEST:g} times the model's"
        raise InputError("masses", f"{found.mass_scale:.3g} times the model's", bound, remedy)
    r_squared = 1.0 - np.mean(found.residual**2, axis=0) / np.var(tau, axis=0)
    worst = int(np.argmin(r_squared))
    if not r_squared[worst] >= LEAST_EXPLAINED:
        name, joint = f"tau{worst + 1}", worst + 1
        remedy = f"Does a positive {name} turn J{joint} the way in which q{joint} grows?"
        raise InputError(name, f"explained to R² = {r_squared[worst]:.2f}", f"at least {LEAST_EXPLAINED:g}", remedy)

    def estimate(row: int) -> FrictionEstimate:
        return FrictionEstimate(found.per_joint[:, row], found.per_joint_error[:, row])

    log_z = estimate(2)
    z = np.exp(log_z.value)
    return Identification(
        coulomb=estimate(1),
        viscous=estimate(0),
        presliding=FrictionEstimate(z, z * log_z.error),
        offset=estimate(3) if offsets else FrictionEstimate(np.zeros(4), np.zeros(4)),
        mass_scale=found.mass_scale,
        mass_scale_error=found.mass_scale_error,
        rms=np.sqrt(np.mean(found.residual**2, axis=0)),
        r_squared=r_squared,
        velocity=velocity,
        measured=found.friction + found.residual,
        fitted=found.friction,
    )


def _check_directions(v: np.ndarray) -> None:
    for joint in range(4):
        moving = v[np.abs(v[:, joint]) > 10.0 * SMALL_VELOCITY, joint]
        share = float(np.mean(moving > 0.0)) if len(moving) else 0.0
        if not 0.02 < share < 0.98:
            found = f"forward in {100.0 * share:.0f} % of its motion"
            remedy = f"Record J{joint + 1} with reversals: Coulomb friction looks like an offset without them."
            raise InputError(f"q{joint + 1}", found, "moved both ways", remedy)


def write(path: str | Path, found: Identification) -> None:
    """The estimates as a table `[arm]` for an experiment; its comment gives every joint's value and standard error.

    An experiment has one presliding: the geometric mean. Its mass error is that of a controller which believes the
    model: 1 / μ − 1.
    """
    from jaxmpc.files.toml import write_toml

    def row(name: str, unit: str, estimate: FrictionEstimate) -> str:
        pairs = zip(estimate.value, estimate.error, strict=True)
        return f"{name} [{unit}], J1 … J4: " + ", ".join(f"{value:.4g} ± {error:.2g}" for value, error in pairs)

    comment = "\n".join(
        (
            "Identified from a recording of the arm; value ± standard error.",
            row("coulomb", "N m", found.coulomb),
            row("viscous", "N m s/rad", found.viscous),
            row("presliding", "rad", found.presliding),
            f"masses of the links over the model's [-]: {found.mass_scale:.4g} ± {found.mass_scale_error:.2g}",
        )
    )
    arm = {
        "coulomb": [_rounded(value) for value in found.coulomb.value],
        "viscous": [_rounded(value) for value in found.viscous.value],
        "presliding": _rounded(np.exp(np.mean(np.log(found.presliding.value)))),
        "mass_error": _rounded(1.0 / found.mass_scale - 1.0),
    }
    write_toml(path, {"arm": arm}, comment)


def _rounded(value: float) -> float:
    return float(f"{value:.5g}")
