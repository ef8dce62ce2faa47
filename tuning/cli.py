"""`jaxmpc tune`: from a spec to a params.toml that holds its margins."""

import argparse
import sys
import textwrap
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

from jaxmpc.terminal.arguments import engine_argument

if TYPE_CHECKING:
    from tuning import TuneSpec


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument(
        "spec",
        type=Path,
        help="what to tune (TOML; docs/tuning.md explains its keys), or a job that comes with the program: "
        f"{', '.join(shipped())}",
    )
    parser.add_argument("-o", "--out", type=Path, metavar="DIR", help="folder of the results (runs/SPEC)")
    parser.add_argument(
        "--limit", action="store_true", help="also how far it is from the best of all linear laws (extra `limit`)"
    )
    engine_argument(parser)
    parser.add_argument("--quiet", action="store_true", help="no progress")


def run(args: argparse.Namespace) -> int:
    """Tune, print the comparison; 1 if no point meets every goal.

    Raises:
        InputError: The spec or the folder is wrong; nothing has been written by then.
    """
    from jaxmpc.terminal.process import use_all_cores

    use_all_cores()
    from jaxmpc.tracers import trace_apart

    trace_apart("tuning.objective.problem")
    from jaxmpc.xla.place import wake_beside

    wake_beside()
    from msgspec.structs import replace

    from jaxmpc.engine.registry import named
    from jaxmpc.engine.scenario import program_spec
    from jaxmpc.files.errors import InputError, nearest, plain_name
    from jaxmpc.files.outputs import check_folder
    from jaxmpc.files.sealed import write_atomic
    from jaxmpc.limit.conic import solver
    from jaxmpc.terminal.layout import columns_of_output
    from tuning import TuneSpec, pareto, report, tune
    from tuning.reports.limit import limit_section
    from tuning.reports.text import section_text

    jobs = shipped()
    path = args.spec if args.spec.is_file() else jobs.get(f"{args.spec}", args.spec)
    if not path.exists() and not path.suffix:
        raise InputError("SPEC", path, "a TOML file or a job that comes with the program", nearest(f"{path}", [*jobs]))
    args.out = args.out or Path("runs") / plain_name("the job's name", path.stem)
    check_folder("-o", args.out)
    if (args.out / "manifest.json").exists():
        raise InputError("-o", args.out, "a folder without a sweep", "Choose another with -o.")
    spec = TuneSpec.from_toml(path)
    named(program_spec(spec.experiment), args.engine, "reverse")
    spec = replace(spec, engine=args.engine)
    if args.limit:
        # Sooner than after an hour of tuning.
        solver()
    print(f"{args.spec}: {spec.tune.starts} starts, {spec.tune.steps} steps, results to {args.out}")
    print(_resolved(spec))
    before = _files(args.out)
    result = tune(spec, args.out, progress=not args.quiet)
    print(report(result, columns_of_output()))
    if spec.pareto and result.met:
        pareto(result.spec, args.out, not args.quiet, result.state.leader_z)
    if args.limit and result.feasible:
        try:
            section = limit_section(result)
        except InputError as error:  # nothing is wrong with what was asked to be tuned
            print(f"no limit: {error}")
        else:
            print(section_text(section, columns_of_output()))
            write_atomic(args.out / "limit.txt", section_text(section).encode())
    print("\n".join(f"wrote {path}" for path, changed in _files(args.out).items() if changed != before.get(path)))
    if not result.met:
        print(f"jaxmpc tune: {result.unmet()}; no params.toml was written", file=sys.stderr)
        return 1
    return 0


def _files(folder: Path) -> dict[Path, int]:
    """When each file of a folder was last changed, by its path [ns]; none where there is no folder."""
    found = sorted(folder.iterdir()) if folder.is_dir() else []
    return {path: path.stat().st_mtime_ns for path in found if path.is_file() and not path.name.startswith(".")}


def _resolved(spec: "TuneSpec") -> str:
    """What is tuned on what, in a few lines; all of it is in the spec that lies beside the results."""
    from jaxmpc.terminal.layout import columns_of_output

    width = min(columns_of_output(), 120)
    lines = [f"  {title:<11} {text}" for title, text in spec.resolved().items()]
    return "\n".join(textwrap.fill(line, width, subsequent_indent=" " * 14) for line in lines)


def shipped() -> dict[str, Path]:
    """Jobs that come with the program, by name."""
    folder = Path(str(resources.files("jaxmpc") / "examples"))
    return {path.stem: path for path in sorted(folder.glob("*-tune.toml"))}
