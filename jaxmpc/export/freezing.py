"""Parameters → a sealed controller for the robot: design, margins and simulation here, its checks in `deploy`."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from deploy.controller import known_tissue
from deploy.controller.arm_model import ROBOT
from deploy.controller.artifact import Artifact
from deploy.controller.freeze import freeze
from deploy.controller.judged_loop import JudgedLoop
from deploy.controller.limits import Limits
from deploy.controller.margin_floor import check, plain_floor
from jaxmpc import __version__, design, margins
from jaxmpc.beside import Beside
from jaxmpc.experiment import Experiment
from jaxmpc.experiment.build import robot_of
from jaxmpc.export.golden import (
    ArmRun,
    arm_law_trace,
    law_trace,
    nominal_controller,
    simulated_arm_runs,
    simulated_run,
)
from jaxmpc.files.errors import InputError, nearest
from jaxmpc.files.sealed import digest
from jaxmpc.files.toml import located, read_toml
from jaxmpc.law.gain_backoff import GainBackoff
from jaxmpc.law.gains import Gains
from jaxmpc.quantities import MARGINS
from jaxmpc.stability.family import family_margins, judged_where
from jaxmpc.synthesis.params import Params
from jaxmpc.world.arm import chain
from jaxmpc.world.loop_path import LoopPath
from jaxmpc.xla.place import on_cpu

STIFFNESSES = 33
"""Between the softest and the hardest tissue, log-spaced, besides the experiment's own."""
GOLDEN_FROM, GOLDEN_SAMPLES = 2.0, 512
"""Start [s] and length [samples] of the golden trace: the ramp's end, with the heart already moving."""
LISTENING = 5.0
"""Length of the golden trace where there is a schedule: from contact on, until the schedule has the control [s]."""
SWING_HZ, SWING = 40.0, 1.6
"""Frequency [Hz], and RMS over the guard's limit [-], of what a guarded controller's golden force swings besides: a
calm one would not tell what the guard does. At 40 Hz the answer takes a third of the torque that joints are allowed."""
QUICKER_HZ, LESS = 20.0, 1.25
"""The same for a controller with a schedule, whose gain at 40 Hz is higher."""


@on_cpu()  # one run and a few margins
def freeze_controller(
    path: Path,
    params: Params,
    experiment: Experiment,
    floor: dict[str, float],
    *,
    ideal: bool,
    limits: Path | None = None,
    run: ArmRun | None = None,
) -> Artifact:
    """Connect design, margins and simulation to the robot-side `deploy.controller.freeze`, which takes plain data.

    Args:
        path: Where to.
        params: One controller.
        experiment: Its stiffnesses, sampling and delay are what is promised; its run is the golden trace. On the
            arm, its arm and posture are the controller's nominal ones.
        floor: Margins to be kept at every stiffness.
        ideal: Whether the declared margins are those of the ideal loop.
        limits: A TOML file of limits that differ from the default ones.
        run: What the controller read on the experiment's arm, for the golden trace; None simulates that.

    Raises:
        InputError: The controller is unstable or below its floor, a limit is wrong, or it is guarded without an arm,
            where nothing would guard it; nothing has been written.
    """
    on_arm = experiment.physics != "linear"
    if limits is not None and not on_arm:
        remedy = "Freeze it with an experiment on the arm: `--experiment table-1-wam`."
        raise InputError("--limits", limits, "given for an arm only", remedy)
    if ideal and on_arm:
        raise InputError("--ideal", experiment.name, "left out on the arm", "No arm has ideal damping.")
    if params.guarded and not on_arm:
        remedy = "Freeze it with an experiment on the arm: `--experiment table-1-wam`."
        raise InputError("guarded", params.guarded, "false where no arm is driven", remedy)
    if params.listening is not None and not on_arm:
        remedy = "Freeze it with an experiment on the arm: `--experiment family-wam`."
        raise InputError("knots", f"{len(params.knots)} of them", "none where no arm is driven", remedy)
    arm = nominal_arm(experiment, limits) if on_arm else None
    own_cutoff = None if params.velocity_cutoff is None else float(params.velocity_cutoff)
    loop = experiment.loop_path(ideal).with_cutoff(own_cutoff)
    # Compiling is most of both, and goes on side by side.
    with Beside(1) as beside:
        pending = None if params.listening is None else beside.submit(_family, params, loop)
        rows = _rows(params, experiment, loop)
        family = None if pending is None else pending.result()
    check(rows, plain_floor(floor))  # before the long part
    if family is not None:
        check(family["rows"], plain_floor(floor), "with the tissue known to have about")
    gains, K2 = design(params, experiment.timing, loop.force_filter), float(params.K2)
    if arm is None:
        force, wanted = (_cut(experiment, signal) for signal in simulated_run(params, experiment))
        v = law_trace(gains, force, wanted, experiment.reference.preview)
    else:
        force, wanted, v = _arm_trace(params, experiment, gains, loop.velocity_cutoff, arm, run)
    provenance = {
        "jaxmpc": __version__,
        "experiment": experiment.name,
        "experiment_sha256": digest(experiment.content),
    }
    return freeze(
        path,
        gains,
        experiment.sampling_time,
        K2,
        JudgedLoop(int(loop.delay), ideal, loop.velocity_cutoff, loop.sensor_cutoff),
        params.to_dict(),
        rows,
        floor,
        (force, wanted, v),
        provenance,
        experiment.reference.preview,
        arm,
        family,
    )


def _rows(params: Params, experiment: Experiment, loop: LoopPath) -> list[dict[str, Any]]:
    """Margins of the experiment's loop at its stiffnesses and between them."""
    own = np.unique(experiment.stiffness)
    between = np.geomspace(own[0], own[-1], STIFFNESSES) if len(own) > 1 else own[:0]
    stiffness = np.unique([*own, *between])
    found = margins(params, stiffness, path=loop)
    return _tables(stiffness, found._asdict())


@on_cpu()  # which is a thread's own
def _family(params: Params, loop: LoopPath) -> dict[str, Any]:
    """Worst margins over the band of K_s/K̂ that the identification leaves, with K̂ held at and between the knots."""
    assert params.listening is not None
    stiffness, ratios = judged_where(params.listening)
    found = family_margins(params, stiffness, ratios, loop)
    worst = {name: MARGINS[name].worst(np.asarray(getattr(found, name)), axis=1) for name in MARGINS}
    return {"band": params.listening.band, "rows": _tables(stiffness, worst)}


def _tables(stiffness: np.ndarray, found: Mapping[str, Any]) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = []
    plain = {name: np.asarray(found[name]) for name in MARGINS}
    for i, K_s in enumerate(stiffness.tolist()):
        row = {name: float(plain[name][i]) for name in MARGINS}
        if not row["spectral_radius"] < 1.0:
            remedy = "Tune it over this stiffness, or promise a narrower set."
            raise InputError("spectral radius", f"{row['spectral_radius']:.4f} at {K_s:.4g} N/m", "below 1", remedy)
        rows.append({"stiffness": K_s, **row})
    return rows


def nominal_arm(experiment: Experiment, limits: Path | None) -> dict[str, Any]:
    """The controller's model of the experiment's arm, and the limits there: entries of `ArmModel` but its trace."""
    robot, arm = robot_of(experiment), chain()
    return {
        "robot": ROBOT,
        "chain": arm,
        "tool_length": -arm.tip[1],
        "nominal": robot.nominal,
        "compensated": experiment.arm.compensation > 0.0,
        "momentum_observer": experiment.arm.momentum_observer,
        "posture": robot.posture,
        "encoder_counts": experiment.arm.encoder_counts,
        "limits": _limits(robot.touch, limits),
    }


def _limits(tip: Sequence[float], path: Path | None) -> dict[str, Any]:
    """The default limits around the tip, with those of a TOML file instead."""
    default = Limits.default(tip).plain()
    if path is None:
        return default
    given = read_toml(path)
    with located(path):
        for key, value in given.items():
            if key not in default:
                raise InputError(f"limits.{key}", value, "a known limit", nearest(key, list(default)))
        return Limits.from_plain(default | given).plain()


def _arm_trace(
    params: Params,
    experiment: Experiment,
    gains: Gains,
    velocity_cutoff: float,
    arm: dict[str, Any],
    run: ArmRun | None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Force, wanted force and commands of the golden trace; its angles and torques go to the arm's table."""
    if run is None:
        middle = len(experiment.stiffness) // 2
        (run,) = simulated_arm_runs(params, experiment, experiment.stiffness[middle : middle + 1])
    T_s = experiment.sampling_time
    whole = slice(0, round(LISTENING / T_s))
    run = ArmRun(*(_cut(experiment, signal) if gains.schedule is None else signal[whole] for signal in run))
    if gains.guard is not None:
        swung = run.force.copy()
        hertz, size = (SWING_HZ, SWING) if gains.schedule is None else (QUICKER_HZ, LESS)
        swung[-GOLDEN_SAMPLES:] += _swing(gains.guard, T_s, hertz, size, min(GOLDEN_SAMPLES, len(swung)))
        run = run._replace(force=swung)
    K2 = float(params.K2)
    answer = arm_law_trace(gains, K2, experiment, run, velocity_cutoff)
    arm |= {"golden_q": run.q, "golden_applied": answer.applied, "golden_torque": answer.torque}
    if gains.schedule is not None:
        preview = experiment.reference.preview
        controller, compensated = nominal_controller(gains, K2, experiment, velocity_cutoff)
        trace = known_tissue.samples(run.q, run.force, run.force_ref, preview)
        arm |= known_tissue.answers(controller, compensated, trace, preview)
    return run.force, run.force_ref, answer.v


def _swing(guard: GainBackoff, T_s: float, hertz: float, size: float, samples: int) -> np.ndarray:
    """A swing beyond the guard's limit, the same on each axis, shape (samples, 1) [N]."""
    amplitude = size * np.sqrt(2.0 / 3.0 / float(guard.sensitivity))
    wave: np.ndarray = amplitude * np.sin(2.0 * np.pi * hertz * T_s * np.arange(samples))[:, None]
    return wave


def _cut(experiment: Experiment, signal: np.ndarray) -> np.ndarray:
    """That part of a run which is kept as the golden trace."""
    first = min(round(GOLDEN_FROM / experiment.sampling_time), max(experiment.steps - GOLDEN_SAMPLES, 0))
    return signal[first : first + GOLDEN_SAMPLES]
