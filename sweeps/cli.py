"""`jaxmpc sweep`: many controllers and worlds, resumable, shared among processes; and what came out of them."""

import argparse
import os
import shlex
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from jaxmpc.files.errors import InputError, plain_name
from jaxmpc.files.outputs import check_folder
from jaxmpc.terminal.arguments import engine_argument
from sweeps.arguments import verb_of
from sweeps.show.cli import counts, show, show_arguments

if TYPE_CHECKING:
    from sweeps.plan import Plan
    from sweeps.run import MakeCrew
    from sweeps.spec import SweepSpec


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.usage = (
        "jaxmpc sweep SPEC.toml [-o DIR] [--dry-run [--measure]] [--part K/N | --local-workers N | --cluster ADDRESS]\n"
        "       jaxmpc sweep report DIR [-o FOLDER] [--csv FILE.csv] [--max-ms M] [-n N]\n"
        "       jaxmpc sweep best DIR [-n N] [--max-ms M] [--params FILE.toml] [--csv FILE.csv]\n"
        "       jaxmpc sweep pareto DIR [-n N] [--goals A,B] [--params FILE.toml] [--csv FILE.csv]\n"
        "       jaxmpc sweep row DIR N [--params FILE.toml] [--csv FILE.csv]\n"
        "       jaxmpc sweep sensitivity DIR [--max-ms M] [--params FILE.toml]"
    )
    parser.add_argument("what", nargs="+", metavar="SPEC.toml | VERB DIR", help="the sweep to run, or what to show")
    parser.add_argument("-o", type=Path, dest="out", help="results (default runs/SPEC) or figures (default DIR/report)")
    running = parser.add_argument_group(
        "running a sweep; the result depends on none of these, but for last bits on the engine"
    )

    def switch(name: str, text: str) -> None:
        running.add_argument(name, action="store_const", const=True, help=text)

    switch("--dry-run", "say what it would take, from what this machine has computed before; write nothing")
    switch("--measure", "with --dry-run: compute the first rows to find out")
    running.add_argument("--chunk", type=int, help="rows of a chunk file (default: a few seconds of work)")
    running.add_argument("--cores", type=int, help="CPU cores to use (default: all)")
    engine_argument(running)
    running.add_argument("--part", metavar="K/N", help="begin with the K-th of N parts, then help with the others")
    running.add_argument("--local-workers", type=int, metavar="N", help="N processes of Dask on this machine")
    running.add_argument("--cluster", metavar="ADDRESS", help="a Dask scheduler, as tcp://HOST:PORT")
    running.add_argument("--lease", type=float, dest="silence", metavar="S", help=argparse.SUPPRESS)
    switch("--retry", "try again what was set aside")
    switch("--quiet", "no progress")
    show_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Run or continue a sweep, or show what came out.

    Raises:
        InputError: The spec, the folder or the arguments are wrong.
    """
    verb = verb_of(args)
    if verb is not None:
        return show(verb, args)
    try:
        return _sweep(args)
    except BrokenPipeError:
        raise  # nobody reads what is told, which costs no chunk
    except OSError as error:
        where = f" ({error.filename})" if error.filename else ""
        print(f"jaxmpc sweep: cannot write: {error.strerror}{where}. Finished chunks are kept.", file=sys.stderr)
        return 1


def _sweep(args: argparse.Namespace) -> int:
    for name, value in (("--cores", args.cores), ("--chunk", args.chunk), ("--local-workers", args.local_workers)):
        if value is not None and value < 1:
            raise InputError(name, value, "at least 1", "Leave it out for the default.")
    if args.silence is not None and not args.silence >= 1.0:
        raise InputError("--lease", args.silence, "at least 1 s", "Leave it out for the default.")
    if args.measure and not args.dry_run:
        raise InputError("--measure", "given", "given with --dry-run", "Add --dry-run.")
    part = _part(args.part)
    # XLA compiles for one device otherwise than for several, to other last bits: never take just one.
    cores = max(2, args.cores or len(os.sched_getaffinity(0)))
    from jaxmpc.terminal.process import use_all_cores

    if not args.dry_run or args.engine is not None:
        use_all_cores(cores)
    if not (args.dry_run or args.cluster or args.local_workers):
        from jaxmpc.xla.place import wake_beside

        wake_beside()
    from jaxmpc.files.toml import located
    from sweeps import store
    from sweeps.plan import check_chunk, describe, make_plan
    from sweeps.precision import with_precision
    from sweeps.spec import SweepSpec

    spec = replace(SweepSpec.from_toml(args.what[0]), engine=args.engine)
    folder = args.out or Path("runs") / plain_name("the spec's name", spec.name)
    check_folder("-o", folder)
    with located(args.what[0]):
        spec = with_precision(spec, folder)
        plan = make_plan(spec)
    if args.engine is not None:
        from sweeps import engines

        engines.check(spec, plan)
    if args.chunk is not None:
        check_chunk(plan, args.chunk)
    crew = _crew(args, cores)
    if spec.refine is not None:
        from sweeps.refine.run import check as check_refined

        begun = check_refined(folder, spec)
    else:
        begun = store.check(folder, plan)
    if args.cluster is not None and not args.dry_run:
        from sweeps.cluster import check_answers

        check_answers(args.cluster)
    left_out = plan.space.count - len(plan.rows) if plan.space.only is None else 0
    print(f"sweep {spec.name}, spec {plan.spec_hash[:12]}\n{describe(plan)}")
    print(f"  rows        {len(plan.rows)}" + (f" ({left_out} more with Hu > Hp are left out)" if left_out else ""))
    print(f"  results     {folder}" + (", continued" if begun else ""), flush=True)
    if args.dry_run:
        from sweeps.dry_run import dry_run, there

        if begun:
            print(f"  there       {there(folder, plan)}")
        print(dry_run(spec, plan, cores, measure=bool(args.measure)))
        return 0
    return _run(spec, plan, folder, part, cores, crew, args)


def _run(
    spec: "SweepSpec",
    plan: "Plan",
    folder: Path,
    part: tuple[int, int],
    cores: int,
    crew: "MakeCrew",
    args: argparse.Namespace,
) -> int:
    from functools import partial

    from sweeps import rates
    from sweeps.crew import Alone
    from sweeps.decided import folder_of
    from sweeps.engines import devices
    from sweeps.leases import SILENCE, given_up
    from sweeps.refine.run import run as run_refined
    from sweeps.run import SweepStoppedError
    from sweeps.run import run as run_plain
    from sweeps.show.best_rows import chance
    from sweeps.show.in_the_way import in_the_way

    began, told = time.monotonic(), partial(print, flush=True)
    try:
        result = (run_plain if spec.refine is None else run_refined)(
            spec,
            folder,
            chunk=args.chunk,
            part=part,
            progress=not args.quiet,
            gentle=True,
            retry=bool(args.retry),
            silence=args.silence or SILENCE,
            crew=crew,
            told=told,
            # Workers share cores with each other, or have others: their pace is no estimate of this process's.
            paced=(lambda plan, pace: rates.record(plan, pace, devices(cores))) if crew is Alone else None,
        )
    except KeyboardInterrupt:
        print("\njaxmpc sweep: interrupted; run the same command again to go on where it stopped", file=sys.stderr)
        return 130
    except SweepStoppedError as error:
        print(f"jaxmpc sweep: {error}. Finished chunks are kept.", file=sys.stderr)
        return 1
    print(f"{len(result)} rows after {time.monotonic() - began:.1f} s")
    print(counts(result))
    notes = [*(in_the_way(result, result.goal) if result.complete else ()), *chance(result)]
    print("".join(f"{line}\n" for line in notes), end="")
    if result.complete:
        print(f"result {result.hash}\nnext: jaxmpc sweep report {shlex.quote(str(folder))}")
        return 0
    where, stopped = folder, result
    if result.stages:
        name, stopped = result.stages[-1]
        where = folder / "stages" / name
    plan = stopped.plan
    if stopped.decided is not None:
        plan = stopped.decided.plan
        where = folder_of(where, plan)
    if aside := given_up(where):
        for (first, last), reason in aside.items():
            rows = f"{plan.rows[first]} … {plan.rows[last - 1]}"
            print(f"jaxmpc sweep: rows {rows} are set aside: {reason}", file=sys.stderr)
        print("jaxmpc sweep: --retry tries them again", file=sys.stderr)
        return 1
    print("jaxmpc sweep: stopped; run the same command again to go on where it stopped", file=sys.stderr)
    return 130


def _crew(args: argparse.Namespace, cores: int) -> "MakeCrew":
    given = [
        flag
        for flag, value in (("--local-workers", args.local_workers), ("--cluster", args.cluster))
        if value is not None
    ]
    if len(given) > 1:
        raise InputError("--cluster", args.cluster, "given without --local-workers", "Remove one of the two.")
    if not given:
        from sweeps.crew import Alone

        return Alone
    from sweeps.cluster import DaskCrew, check_address, check_installed

    check_installed()
    if args.cluster is not None:
        check_address(args.cluster)
        return lambda told: DaskCrew(told, address=args.cluster, cores=args.cores)
    each = max(2, cores // args.local_workers)
    return lambda told: DaskCrew(told, address=None, workers=args.local_workers, cores=each)


def _part(text: str | None) -> tuple[int, int]:
    """K and N of "K/N".

    Raises:
        InputError: It is none of N parts.
    """
    if text is None:
        return 1, 1
    from sweeps.targets import numbered

    k, _, n = text.partition("/")
    if not (numbered(k) and numbered(n) and 1 <= int(k) <= int(n)):
        raise InputError("--part", text, "K/N with 1 ≤ K ≤ N", "Write 2/3 for the second of three.")
    return int(k), int(n)
