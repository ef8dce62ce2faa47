"""`jaxmpc tune`: from a spec to a params.toml that holds its margins."""

import argparse
import sys
from importlib import resources
from pathlib import Path


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument(
        "spec",
        type=Path,
        help="what to tune (TOML; docs/tuning.md explains its keys), or a job that comes with the program: "
        f"{', '.join(shipped())}",
    )
    parser.add_argument("-o", "--out", type=Path, required=True, metavar="DIR", help="folder of the results")
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
    import tomli_w

    from jaxmpc.files.errors import InputError
    from jaxmpc.files.sealed import write_atomic
    from jaxmpc.limit.conic import solver
    from tuning import TuneSpec, pareto, report, tune
    from tuning.reports.limit import limit_section
    from tuning.reports.text import section_text

    jobs = shipped()
    spec = TuneSpec.from_toml(jobs.get(str(args.spec), args.spec) if not args.spec.exists() else args.spec)
    if args.out.exists() and not args.out.is_dir():
        raise InputError("-o", args.out, "a folder", "Name a new one.")
    if args.limit:
        # Sooner than after an hour of tuning.
        solver()
    resolved = spec.to_dict()
    print(f"{args.spec}: {spec.tune.starts} starts, {spec.tune.steps} steps, results to {args.out}")
    print(tomli_w.dumps({key: resolved[key] for key in ("params", "tune", "goals", "scenarios", "risk")}))
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


def shipped() -> dict[str, Path]:
    """Jobs that come with the program, by name."""
    folder = Path(str(resources.files("jaxmpc") / "examples"))
    return {path.stem: path for path in sorted(folder.glob("*-tune.toml"))}
