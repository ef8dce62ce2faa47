"""`jaxmpc tune`: from a spec to a params.toml that holds its margins."""

import argparse
import sys
import textwrap
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

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
    parser.add_argument("--quiet", action="store_true", help="no progress")


def run(args: argparse.Namespace) -> int:
    """Tune, print the comparison; 1 if no point meets every goal.

    Raises:
        InputError: The spec or the folder is wrong; nothing has been written by then.
    """
    from jaxmpc.terminal.process import use_all_cores

    use_all_cores()
    from jaxmpc.files.errors import InputError, nearest, plain_name
    from jaxmpc.files.outputs import check_folder
    from jaxmpc.files.sealed import write_atomic
    from jaxmpc.limit.conic import solver
    from tuning import TuneSpec, pareto, report, tune
    from tuning.reports.limit import limit_section
    from tuning.reports.text import section_text

    jobs = shipped()
    path = args.spec if args.spec.exists() else jobs.get(f"{args.spec}", args.spec)
    if not path.exists() and not path.suffix:
        raise InputError("SPEC", path, "a TOML file or a job that comes with the program", nearest(f"{path}", [*jobs]))
    args.out = args.out or Path("runs") / plain_name("the job's name", path.stem)
    check_folder("-o", args.out)
    spec = TuneSpec.from_toml(path)
    if args.limit:
        # Sooner than after an hour of tuning.
        solver()
    print(f"{args.spec}: {spec.tune.starts} starts, {spec.tune.steps} steps, results to {args.out}")
    print(_resolved(spec))
    result = tune(spec, args.out, progress=not args.quiet)
    print(report(result))
    if args.limit and result.feasible:
        text = section_text(limit_section(result))
        print(text)
        write_atomic(args.out / "limit.txt", text.encode())
    if spec.pareto and result.met:
        pareto(result.spec, args.out, not args.quiet, result.state.leader_z)
    print("\n".join(f"wrote {path}" for path in sorted(args.out.iterdir()) if not path.name.startswith(".")))
    if not result.met:
        print(f"jaxmpc tune: {result.unmet()}; no params.toml was written", file=sys.stderr)
        return 1
    return 0


def _resolved(spec: "TuneSpec") -> str:
    """What is tuned on what, in a few lines; all of it is in the spec that lies beside the results."""
    from tuning.job.goals import GOALS

    experiment, met = spec.experiment, spec.scenarios
    tissues = ", ".join(f"{K:g}" for K in experiment.stiffness)
    hard = [f"{name} {GOALS[name].sign} {GOALS[name].amount(limit)}" for name, limit in spec.goals.items()]
    implied = [f"{name} {GOALS[name].sign} {GOALS[name].amount(limit)}" for name, limit in spec.implied.items()]
    start = {axis.name: spec.params.to_dict().get(axis.name) for axis in spec.space.axes}
    rows = {
        "experiment": f"{experiment.name}, physics {experiment.physics}, {experiment.duration:g} s, K_s {tissues} N/m",
        "free": ", ".join(name if value is None else f"{name} from {value:.4g}" for name, value in start.items()),
        "held": ", ".join(hard) + (f"; by the robot's limits {', '.join(implied)}" if implied else ""),
        "minimised": ", ".join(f"{name} over {limit:g}" for name, limit in spec.soft.items()),
        "met": f"rhythms {', '.join(met.rhythms) or 'none'}; friction ±{100 * met.friction:g} %, "
        f"masses ±{100 * met.mass:g} %, delay {', '.join(map(str, met.delays)) or experiment.delay}",
        "risk": ", ".join(f"{name} {value}" for name, value in spec.to_dict()["risk"].items()),
    }
    lines = [f"  {title:<11} {text}" for title, text in rows.items()]
    return "\n".join(textwrap.fill(line, 120, subsequent_indent=" " * 14) for line in lines)


def shipped() -> dict[str, Path]:
    """Jobs that come with the program, by name."""
    folder = Path(str(resources.files("jaxmpc") / "examples"))
    return {path.stem: path for path in sorted(folder.glob("*-tune.toml"))}
