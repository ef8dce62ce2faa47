"""`jaxmpc identify`: joint friction from a recording, its table and its figure."""

import argparse
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

from jaxmpc.files.errors import InputError
from jaxmpc.terminal.progress import said_after

if TYPE_CHECKING:
    from jaxmpc.identify.identification import FrictionEstimate, Identification

EXAMPLES = Path(str(resources.files("jaxmpc"))) / "examples"
SAMPLE = "twin-motion"
"""Name of the recording that comes with the program."""
SUFFIXES = (".png", ".svg", ".pdf")


def configure(parser: argparse.ArgumentParser) -> None:
    """Arguments of the verb."""
    columns = "t [s], q1…q4 [rad], tau1…tau4 [N m]"
    parser.add_argument(
        "recording",
        help=f"CSV or npz of motion without contact: {columns}; or {SAMPLE}, a sample to try, made by the twin",
    )
    parser.add_argument(
        "-o", "--output", type=Path, default=Path("friction.toml"), help="the file to make (friction.toml)"
    )
    parser.add_argument("--figure", type=Path, help="measured and fitted friction over velocity")


def run(args: argparse.Namespace) -> int:
    """Identify, print, write, draw."""
    from jaxmpc.files.outputs import check_file
    from jaxmpc.identify.identification import identify, read_recording, write

    check_file("-o", args.output, ".toml")
    check_file("--figure", args.figure, *SUFFIXES)
    path = _file_of(args.recording)
    recording = read_recording(path)
    try:
        with said_after(f"fitting friction to {len(recording.t)} samples …"):
            found = identify(recording)
    except InputError as error:
        raise error.at(path) from None
    _show(found)
    if args.recording == SAMPLE:
        print("this recording was made by the twin of the arm (deploy/twin/own_motion.py): it tells of no robot")
    write(args.output, found)
    print(f"friction: {args.output}")
    if args.figure:
        _draw(args.figure, found)
        print(f"figure: {args.figure}")
    return 0


def _file_of(recording: str) -> Path:
    """A path as it is, unless it is the name of the sample."""
    return EXAMPLES / f"{SAMPLE}.csv" if recording == SAMPLE else Path(recording)


def _show(found: "Identification") -> None:
    from jaxmpc.terminal.tables import show

    def cell(estimate: "FrictionEstimate", joint: int, factor: float = 1.0) -> str:
        return f"{factor * estimate.value[joint]:.3f} ± {factor * estimate.error[joint]:.3f}"

    rows = [
        [
            f"J{joint + 1}",
            cell(found.coulomb, joint),
            cell(found.viscous, joint),
            cell(found.presliding, joint, 1e3),
            cell(found.offset, joint),
            f"{found.rms[joint]:.3f}",
            f"{found.r_squared[joint]:.5f}",
        ]
        for joint in range(4)
    ]
    header = ("joint", "Coulomb N m", "viscous N m s/rad", "presliding mrad", "offset N m", "residual RMS N m", "R²")
    show("", header, rows)
    print(f"masses of the links over the model's: {found.mass_scale:.4f} ± {found.mass_scale_error:.4f}")


def _draw(path: Path, found: "Identification") -> None:
    from jaxmpc.pictures.figures import BASELINE, TUNED, figure

    with figure(path, rows=2, columns=2, size=(8.0, 6.0)) as axes:
        for joint, panel in enumerate(axes.flat):
            v = found.velocity[:, joint]
            panel.plot(v, found.measured[:, joint], ".", ms=2.0, color=BASELINE, label="measured")
            panel.plot(v, found.fitted[:, joint], ".", ms=1.0, color=TUNED, label="fitted")
            panel.set_title(f"J{joint + 1}, residual {found.rms[joint]:.3f} N m RMS")
            panel.set_xlabel("velocity [rad/s]")
            panel.set_ylabel("friction torque [N m]")
        axes[0, 0].legend(markerscale=4.0)
