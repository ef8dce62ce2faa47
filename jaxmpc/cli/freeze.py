"""`jaxmpc freeze`: parameters → a sealed controller for the robot."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jaxmpc.quantities import MARGINS

if TYPE_CHECKING:
    import numpy as np

    from deploy.controller.artifact import Artifact
    from jaxmpc.experiment import Experiment
    from jaxmpc.law.cascade import Gains
    from jaxmpc.law.gain_backoff import GainBackoff
    from jaxmpc.synthesis.params import Params
    from jaxmpc.world.loop_path import LoopPath

FLOOR_FLAGS = {
    "M_s": "--max-ms",
    "gain_margin_db": "--min-gain-db",
    "gain_reduction_db": "--min-reduction-db",
    "phase_margin_deg": "--min-phase-deg",
    "delay_margin_s": "--min-delay-ms",
    "spectral_radius": "--max-radius",
}
"""Flags of the margins that a controller may promise."""
HIGHEST_M_S = 2.0
"""Promised unless told otherwise [-]."""
STIFFNESSES = 33
"""Between the softest and the hardest tissue, log-spaced, besides the experiment's own."""
GOLDEN_FROM, GOLDEN_SAMPLES = 2.0, 256
"""Start [s] and length [samples] of the golden trace: the ramp's end, with the heart already moving."""
SWING_HZ, SWING = 40.0, 1.6
"""Frequency [Hz], and RMS over the guard's limit [-], of what a guarded controller's golden force swings besides: a
calm one would not tell what the guard does. At 40 Hz the answer takes half of the torque that joints are allowed."""


def configure(parser: argparse.ArgumentParser) -> None:
    """Arguments of the verb."""
    parser.add_argument("params", help="a params.toml, or a published set: text, printed, cautious")
    parser.add_argument("-o", "--output", type=Path, default=Path("controller.npz"), help="(controller.npz)")
    parser.add_argument(
        "--experiment",
        default="table-1",
        help="its stiffnesses are the promise (table-1, which only replays; to drive an arm: table-1-wam)",
    )
    parser.add_argument("--limits", type=Path, metavar="TOML", help="limits on the arm that differ from the default")
    parser.add_argument("--ideal", action="store_true", help="declare the margins of the ideal loop, not as it runs")
    floor = parser.add_argument_group("margin floor, held at every stiffness from softest to hardest")
    for name, flag in FLOOR_FLAGS.items():
        margin, default = MARGINS[name], HIGHEST_M_S if name == "M_s" else None
        said = f"{'highest' if margin.ceiling else 'lowest'} {margin.heading}: {margin.text}"
        said += "" if default is None else f" ({default})"
        floor.add_argument(flag, dest=name, type=float, default=default, metavar="BOUND", help=said)


def run(args: argparse.Namespace) -> int:
    """Design, judge, freeze; an unstable controller or one below its floor is refused with exit code 2."""
    from jaxmpc.terminal.arguments import experiment_from, params_from
    from jaxmpc.terminal.process import use_all_cores

    use_all_cores()
    given = {name: getattr(args, name) for name in FLOOR_FLAGS}
    floor = {name: value / MARGINS[name].times for name, value in given.items() if value is not None}
    params, experiment = params_from(args.params), experiment_from(args.experiment)
    artifact = freeze_controller(args.output, params, experiment, floor, ideal=args.ideal, limits=args.limits)
    loop = "ideal loop" if args.ideal else "loop as it runs"
    worst = max(row["M_s"] for row in artifact.margins)
    print(f"frozen: {args.output} ({args.output.stat().st_size} bytes), K_s {len(artifact.margins)} values, {loop}")
    print(f"worst M_s {worst:.3f}, floor {artifact.floor}")
    if artifact.arm is not None:
        print(f"drives a {artifact.arm.robot}, never beyond {artifact.arm.limits.force:g} N on the tissue")
    print(f"`jaxmpc check {args.output}` replays it anywhere")
    return 0


def freeze_controller(
    path: Path,
    params: "Params",
    experiment: "Experiment",
    floor: dict[str, float],
    *,
    ideal: bool,
    limits: Path | None = None,
) -> "Artifact":
    """Connect design, margins and simulation to the robot-side `deploy.controller.freeze`, which takes plain data.

    Args:
        path: Where to.
        params: One controller.
        experiment: Its stiffnesses, sampling and delay are what is promised; its run is the golden trace. On the
            arm, its arm and posture are the controller's nominal ones.
        floor: Margins to be kept at every stiffness.
        ideal: Whether the declared margins are those of the ideal loop.
        limits: A TOML file of limits that differ from the default ones.

    Raises:
        InputError: The controller is unstable or below its floor, a limit is wrong, or it is guarded without an arm,
            where nothing would guard it; nothing has been written.
    """
    from deploy.controller.freeze import freeze
    from deploy.controller.judged_loop import JudgedLoop
    from deploy.controller.margin_floor import check, plain_floor
    from jaxmpc import __version__, design
    from jaxmpc.export.golden import law_trace, simulated_run
    from jaxmpc.files.errors import InputError
    from jaxmpc.files.sealed import digest

    on_arm = experiment.physics != "linear"
    if limits is not None and not on_arm:
        remedy = "Freeze it with an experiment on the arm, such as table-1-wam."
        raise InputError("--limits", limits, "given for an arm only", remedy)
    if ideal and on_arm:
        raise InputError("--ideal", experiment.name, "left out on the arm", "No arm has ideal damping.")
    if params.guarded and not on_arm:
        remedy = "Freeze it with an experiment on the arm, such as table-1-wam."
        raise InputError("guarded", params.guarded, "false where no arm is driven", remedy)
    arm = nominal_arm(experiment, limits) if on_arm else None
    loop = experiment.loop_path(ideal)
    rows = _rows(params, experiment, loop)
    check(rows, plain_floor(floor))  # before the long part
    gains, K2 = design(params, experiment.timing, loop.force_filter), float(params.K2)
    if arm is None:
        force, wanted = (_cut(experiment, signal) for signal in simulated_run(params, experiment))
        v = law_trace(gains, force, wanted, experiment.reference.preview)
    else:
        force, wanted, v = _arm_trace(params, experiment, gains, arm)
    provenance = {
        "jaxmpc": __version__,
        "experiment": experiment.name,
        "experiment_sha256": digest(experiment.to_dict()),
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
    )


def _rows(params: "Params", experiment: "Experiment", loop: "LoopPath") -> list[dict[str, Any]]:
    """Margins of the experiment's loop at its stiffnesses and between them."""
    import numpy as np

    from jaxmpc import margins
    from jaxmpc.files.errors import InputError

    between = np.geomspace(min(experiment.stiffness), max(experiment.stiffness), STIFFNESSES)
    stiffness = np.unique([*experiment.stiffness, *between])
    found = margins(params, stiffness, path=loop)
    rows: list[dict[str, Any]] = []
    for i, K_s in enumerate(stiffness.tolist()):
        row = {name: float(getattr(found, name)[i]) for name in found._fields if name != "status"}
        if not row["spectral_radius"] < 1.0:
            remedy = "Tune it over this stiffness, or promise a narrower set."
            raise InputError("spectral radius", f"{row['spectral_radius']:.4f} at {K_s:.4g} N/m", "below 1", remedy)
        rows.append({"stiffness": K_s, **row})
    return rows


def nominal_arm(experiment: "Experiment", limits: Path | None) -> dict[str, Any]:
    """The controller's model of the experiment's arm, and the limits there: entries of `ArmModel` but its trace."""
    from deploy.controller.arm_model import ROBOT
    from jaxmpc.experiment.build import robot_of
    from jaxmpc.world.arm import chain

    robot, arm = robot_of(experiment), chain()
    return {
        "robot": ROBOT,
        "chain": arm,
        "tool_length": -arm.tip[1],
        "nominal": robot.nominal,
        "compensated": experiment.arm.compensation > 0.0,
        "posture": robot.posture,
        "encoder_counts": experiment.arm.encoder_counts,
        "limits": _limits(robot.touch, limits),
    }


def _limits(tip: Sequence[float], path: Path | None) -> dict[str, Any]:
    """The default limits around the tip, with those of a TOML file instead."""
    from deploy.controller.limits import Limits
    from jaxmpc.files.errors import InputError, nearest
    from jaxmpc.files.toml import located, read_toml

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
    params: "Params", experiment: "Experiment", gains: "Gains", arm: dict[str, Any]
) -> tuple["np.ndarray", "np.ndarray", "np.ndarray"]:
    """Force, wanted force and commands of the golden trace; its angles and torques go to the arm's table."""
    from jaxmpc.export.golden import ArmRun, arm_law_trace, simulated_arm_runs

    middle = len(experiment.stiffness) // 2
    (found,) = simulated_arm_runs(params, experiment, experiment.stiffness[middle : middle + 1])
    run = ArmRun(*(_cut(experiment, signal) for signal in found))
    if gains.guard is not None:
        run = run._replace(force=run.force + _swing(gains.guard, experiment.sampling_time, len(run.force)))
    answer = arm_law_trace(gains, float(params.K2), experiment, run)
    arm |= {"golden_q": run.q, "golden_applied": answer.applied, "golden_torque": answer.torque}
    return run.force, run.force_ref, answer.v


def _swing(guard: "GainBackoff", T_s: float, samples: int) -> "np.ndarray":
    """A swing beyond the guard's limit, the same on each axis, shape (samples, 1) [N]."""
    import numpy as np

    amplitude = SWING * np.sqrt(2.0 / 3.0 / float(guard.sensitivity))
    wave: np.ndarray = amplitude * np.sin(2.0 * np.pi * SWING_HZ * T_s * np.arange(samples))[:, None]
    return wave


def _cut(experiment: "Experiment", signal: "np.ndarray") -> "np.ndarray":
    """That part of a run which is kept as the golden trace."""
    first = min(round(GOLDEN_FROM / experiment.sampling_time), max(experiment.steps - GOLDEN_SAMPLES, 0))
    return signal[first : first + GOLDEN_SAMPLES]
