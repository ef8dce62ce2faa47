"""`jaxmpc replay`: a flight recording through the runtime, and where jax is installed through the simulator's law."""

import argparse
import hashlib
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from jaxmpc.files.errors import InputError, plain
from jaxmpc.terminal.progress import said_after

if TYPE_CHECKING:
    from deploy.flight.recorder import FlightRecording
    from jaxmpc.law.recorded import RecordedInputs


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument("recording", type=Path, help="a flight recording, as `jaxmpc run` writes it (.npz)")
    parser.add_argument(
        "--artifact", type=Path, default=Path("controller.npz"), help="the controller that flew (controller.npz)"
    )
    parser.add_argument(
        "--report", type=Path, metavar="HTML", help="every signal that flew, and what was computed anew over it"
    )
    parser.add_argument("--picture", type=Path, metavar="PNG", help="draw the flight: forces, states, clamps, guard")
    parser.add_argument("--tolerance", type=float, default=1e-9, help="share of the largest value (1e-9)")


def run(args: argparse.Namespace) -> int:
    """Replay; 0: the same within the tolerance, 1: they part.

    Raises:
        InputError: The recording or the controller is not what it must be, or they do not belong together.
    """
    from deploy.controller.file import ArtifactError, load
    from deploy.controller.runtimes import flown_controller
    from deploy.flight.inputs import LAW, inputs_of
    from deploy.flight.recorder import RecordingError, read
    from deploy.flight.replay import compare, table, through_runtime
    from jaxmpc.files.outputs import check_file

    check_file("--report", args.report, ".html")
    check_file("--picture", args.picture, ".png", ".svg", ".pdf")
    if not 0.0 < args.tolerance < 1.0:
        raise InputError("--tolerance", args.tolerance, "in (0, 1)", "Rounding stays below 1e-12.")
    try:
        recording, artifact = read(args.recording), load(args.artifact)
        if artifact.arm is None:
            raise ArtifactError(f"{args.artifact}: it is of the kind {artifact.kind!r}, which drives no arm")
        inputs = inputs_of(recording, artifact, hashlib.sha256(args.artifact.read_bytes()).hexdigest())
    except RecordingError as error:
        bound = "a recording of a flight with this controller"
        raise InputError("recording", args.recording, bound, f"{error}.") from None
    except ArtifactError as error:
        raise InputError("--artifact", args.artifact, "the controller that flew", f"{error}.") from None

    _introduce(recording, inputs)
    with said_after(f"the runtime computes {len(inputs.time)} samples anew …"):
        again = {"runtime": through_runtime(inputs, artifact)}
    if find_spec("jax"):
        from jaxmpc.export.replay import replay_law

        with said_after(f"the simulator's law computes {len(inputs.time)} samples anew …"):
            again["simulator's law"] = replay_law(*flown_controller(artifact), inputs)
    else:
        print("simulator's law: not compared, jax is not installed here")
    rows = {name: compare(recording, inputs, signals, args.tolerance) for name, signals in again.items()}
    for name, found in rows.items():
        print(table(f"\n{name} against what flew", found))
    everything = [row for found in rows.values() for row in found]
    if not any(row.samples for row in everything):
        bound = "one with at least a second of control in it"
        raise InputError("recording", args.recording, bound, "Nothing of this one can be computed anew.")
    if inputs.contact.any() and not any(row.samples for row in everything if row.signal in LAW):
        bound = "one with the beginning of its contact, or with more of it than the controller remembers"
        remedy = "No sample of the law could be judged: fly with a longer recorder, `jaxmpc run --recorded S`."
        raise InputError("recording", args.recording, bound, remedy)
    parted = [row for row in everything if row.parts]
    if parted:
        first = min(parted, key=lambda row: row.first)
        verdict = f"they part: first {first.signal} at {first.first:.3f} s, by {first.by:.3g} {first.unit}"
    else:
        verdict = "the same, within the tolerance"
    print(f"\n{verdict}")
    if args.report:
        from jaxmpc.cli.flight_report import flight_report

        flight_report(args.report, args.recording.stem, recording, inputs, again, rows, verdict)
        print(f"report: {args.report}")
    if args.picture and find_spec("matplotlib"):
        _draw(args.picture, recording, f"replayed: {verdict}", artifact.gains.guard is not None)
        print(f"picture: {args.picture}")
    elif args.picture:
        print("picture: none, matplotlib is not installed here: install the workstation, jaxmpc[sim]")
    return 1 if parted else 0


def _introduce(recording: "FlightRecording", inputs: "RecordedInputs") -> None:
    """Print what the file holds."""
    header = recording.header
    length = f"{len(inputs.time)} samples"
    if len(inputs.time):
        length += f", {inputs.time[0]:.3f} to {inputs.time[-1]:.3f} s"
    print(f"recording: {length}, {int(inputs.contact.sum())} in contact")
    print(f"written because: {plain(str(header.get('reason') or '-'), 200)}")
    missing = int((inputs.contact & (inputs.force != inputs.force).any(axis=1)).sum())
    if missing:
        print(
            f"forces missing in contact, bridged: {missing} (rows of NaN: the sensor gave none, the law predicted it)"
        )


def _draw(path: Path, recording: "FlightRecording", parted: str, guarded: bool) -> None:
    """The flight, and below it what the replay found."""
    from jaxmpc.pictures.recording_figure import recording_figure

    header, names = recording.header, recording.header.get("names")
    why = " ".join(plain(f"{header.get(key) or ''}", 80) for key in ("reason", "detail")).strip() or "as it was to"
    title = f"flight with {plain(str(header.get('artifact')), 80)[:12]}…, ended: {why}"
    recording_figure(path, recording.signals, names if isinstance(names, dict) else {}, title, parted, guarded)
