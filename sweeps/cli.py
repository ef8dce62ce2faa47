"""`jaxmpc sweep`: many controllers over a set of stiffnesses, resumable; `jaxmpc sweep report` shows them."""

import argparse
import math
import os
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

from jaxmpc.files.errors import InputError, plain_name
from jaxmpc.files.outputs import check_file, check_folder

if TYPE_CHECKING:
    from sweeps.plan import Plan
    from sweeps.result import Result
    from sweeps.spec import SweepSpec

RUN_ONLY = {"dry_run": "--dry-run", "chunk": "--chunk", "quiet": "--quiet", "cores": "--cores"}
REPORT_ONLY = {"csv": "--csv", "max_ms": "--max-ms", "n": "-n"}


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.usage = (
        "jaxmpc sweep SPEC.toml [-o DIR] [--dry-run] [--chunk N] [--cores N] [--quiet]\n"
        "       jaxmpc sweep report DIR [-o FOLDER] [--csv FILE] [--max-ms M] [-n N]"
    )
    parser.add_argument("what", nargs="+", metavar="SPEC.toml | report DIR", help="the sweep to run, or to report on")
    parser.add_argument("-o", type=Path, dest="out", help="results (default runs/SPEC) or figures (default DIR/report)")
    running = parser.add_argument_group("running a sweep")
    running.add_argument("--dry-run", action="store_const", const=True, help="say what it would take; write nothing")
    running.add_argument("--chunk", type=int, help="rows of a chunk file; the result does not depend on it")
    running.add_argument("--cores", type=int, help="CPU cores to use (default: all); the result does not depend on it")
    running.add_argument("--quiet", action="store_const", const=True, help="no progress")
    reporting = parser.add_argument_group("reporting")
    reporting.add_argument("--csv", type=Path, help="also write every row there")
    reporting.add_argument("--max-ms", type=float, help="largest accepted peak sensitivity M_s (default 2.0)")
    reporting.add_argument("-n", type=int, help="best rows to list (default 10)")


def run(args: argparse.Namespace) -> int:
    """Run, continue or report on a sweep.

    Raises:
        InputError: The spec, the folder or the arguments are wrong.
    """
    reporting = args.what[0] == "report"
    if len(args.what) != (2 if reporting else 1):
        raise InputError("arguments", " ".join(args.what), "SPEC.toml, or report DIR", "See `jaxmpc sweep --help`.")
    for name, flag in (RUN_ONLY if reporting else REPORT_ONLY).items():
        if getattr(args, name) is not None:
            kind = "running a sweep" if reporting else "`jaxmpc sweep report`"
            raise InputError(flag, "given", "left out here", f"It belongs to {kind}.")
    try:
        return _report(args) if reporting else _sweep(args)
    except OSError as error:
        where = f" ({error.filename})" if error.filename else ""
        print(f"jaxmpc sweep: cannot write: {error.strerror}{where}. Finished chunks are kept.", file=sys.stderr)
        return 1


def _sweep(args: argparse.Namespace) -> int:
    from jaxmpc.terminal.process import use_all_cores

    for name, value in (("--cores", args.cores), ("--chunk", args.chunk)):
        if value is not None and value < 1:
            raise InputError(name, value, "at least 1", "Leave it out for the default.")
    # XLA compiles for one device otherwise than for several, to other last bits: never take just one.
    use_all_cores(max(2, args.cores or len(os.sched_getaffinity(0))))
    from sweeps import store
    from sweeps.plan import CHUNK, check_chunk, describe, make_plan
    from sweeps.run import run as run_sweep
    from sweeps.spec import SweepSpec

    spec = SweepSpec.from_toml(args.what[0])
    folder = args.out or Path("runs") / plain_name("the spec's name", spec.name)
    check_folder("-o", folder)
    chunk = args.chunk or CHUNK
    plan = make_plan(spec)
    check_chunk(plan, chunk)
    begun = store.check(folder, plan)
    left_out = plan.space.count - len(plan.rows)
    print(f"sweep {spec.name}, spec {plan.spec_hash[:12]}\n{describe(plan)}")
    print(f"  rows        {len(plan.rows)}" + (f" ({left_out} more with Hu > Hp are left out)" if left_out else ""))
    print(f"  results     {folder}" + (", continued" if begun else ""), flush=True)
    if args.dry_run:
        return _dry_run(spec, plan, chunk)
    began = time.monotonic()
    try:
        result = run_sweep(spec, folder, chunk=chunk, progress=not args.quiet)
    except KeyboardInterrupt:
        print("\njaxmpc sweep: interrupted; run the same command again to go on where it stopped", file=sys.stderr)
        return 130
    print(f"{len(result)} rows after {time.monotonic() - began:.1f} s")
    print(_counts(result))
    print(f"result {result.hash}\nnext: jaxmpc sweep report {folder}")
    return 0


def _dry_run(spec: "SweepSpec", plan: "Plan", chunk: int) -> int:
    from sweeps.run import estimate

    rows, experiment = len(plan.rows), spec.experiment
    steps = rows * len(plan.stiffness) * 3 * experiment.steps
    print(f"  chunks      {math.ceil(rows / chunk)} of {chunk} rows")
    print(f"  axis-steps  {steps:.3g}")
    print(f"  size        {rows * plan.row_bytes / 1e6:.1f} MB on disk and in memory", flush=True)
    took = estimate(spec)
    print(
        f"  time        {took.compile_s + rows / took.rate:.0f} s from nothing: {took.compile_s:.0f} s to compile, ",
        end="",
    )
    print(f"then {took.rate:.0f} rows/s (measured on the first rows)\ndry run: nothing was written")
    return 0


def _counts(result: "Result") -> str:
    counts = ", ".join(f"{name} {count}" for name, count in result.status_counts().items() if count)
    return f"status over rows × stiffness: {counts}"


def _report(args: argparse.Namespace) -> int:
    from jaxmpc.files.toml import write_toml
    from sweeps.report import heat_map, mapped_axes, pareto_figure, table
    from sweeps.result import Result

    folder = Path(args.what[1])
    limit = 2.0 if args.max_ms is None else args.max_ms
    n = 10 if args.n is None else args.n
    if not limit >= 1.0:
        raise InputError("--max-ms", limit, "at least 1", "No loop has a smaller peak sensitivity; 2 is usual.")
    if n < 1:
        raise InputError("-n", n, "at least 1", "Ask for one row or more.")
    result = Result.load(folder)
    if not len(result):
        raise InputError("sweep folder", folder, "begun", "It has no finished chunk yet.")
    if not result.complete:
        print(f"jaxmpc sweep: unfinished: {len(result)} of {len(result.plan.rows)} rows", file=sys.stderr)
    out = args.out or folder / "report"
    check_folder("-o", out)
    check_file("--csv", args.csv)
    out.mkdir(parents=True, exist_ok=True)
    written = [out / "pareto.png"]
    pareto_figure(result, written[0], max_M_s=limit)
    if mapped_axes(result):
        written.append(out / "heat-map.png")
        heat_map(result, written[-1], max_M_s=limit)
    best = result.best(n, limit)
    if len(best):
        written.append(out / "best.toml")
        note = f"Row {best['row'][0]} of a sweep, result {result.hash}"
        write_toml(written[-1], {"params": best.controller(0).to_dict()}, note)
    if args.csv:
        result.to_csv(args.csv)
        written.append(args.csv)
    print(_counts(result))
    print(table(result, n, limit))
    print(f"result {result.hash}\nwritten: {', '.join(map(str, written))}")
    return 0
