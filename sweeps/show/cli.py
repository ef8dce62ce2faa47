"""`jaxmpc sweep best | pareto | row | sensitivity | report`: what came out of a sweep's folder."""

import argparse
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from jaxmpc.files.errors import InputError
from jaxmpc.files.outputs import check_file, check_folder
from jaxmpc.quantities import MARGINS, check_limit

if TYPE_CHECKING:
    from sweeps.result import Result

TAKES = {
    "report": ("-o", "--csv", "--max-ms", "-n"),
    "best": ("--csv", "--max-ms", "-n", "--params"),
    "pareto": ("--csv", "-n", "--goals", "--params"),
    "row": ("--csv", "--params"),
    "sensitivity": ("--max-ms", "--params"),
}
"""Flags of each verb."""
VERBS = tuple(TAKES)


def show_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verbs."""
    showing = parser.add_argument_group("showing what came out")
    showing.add_argument("--csv", type=Path, help="also write the rows there (all of them, with report)")
    showing.add_argument("--max-ms", type=float, help="largest accepted M_s of best, report and --params (the spec's)")
    showing.add_argument("-n", type=int, help="rows to list (10; of pareto all)")
    showing.add_argument("--goals", help="of pareto: metrics and margins, by commas (default rms,M_s)")
    showing.add_argument("--params", type=Path, help="also write the first row's controller there, for tune and freeze")


def show(verb: str, args: argparse.Namespace) -> int:
    """Show what a folder holds.

    Raises:
        InputError: It is no sweep's, or there is no such row or goal.
    """
    given = {"-o": args.out, "--csv": args.csv, "--max-ms": args.max_ms, "-n": args.n}
    given |= {"--goals": args.goals, "--params": args.params}
    for flag in [flag for flag, value in given.items() if value is not None and flag not in TAKES[verb]]:
        takers = " | ".join(other for other, flags in TAKES.items() if flag in flags)
        raise InputError(flag, given[flag], f"left out of `sweep {verb}`", f"It belongs to `jaxmpc sweep {takers}`.")
    check_file("--csv", args.csv, ".csv")
    check_file("--params", args.params, ".toml")
    limit, n = args.max_ms, 10 if args.n is None else args.n
    if limit is not None:
        check_limit("--max-ms", MARGINS["M_s"], limit, "No loop has a smaller peak sensitivity; 2 is usual.")
    if n < 1:
        raise InputError("-n", n, "at least 1", "Ask for one row or more.")
    from sweeps.goal import ON_ARM
    from sweeps.result import Result
    from sweeps.show.best_rows import chance, goal_of, progress
    from sweeps.show.curves import world_words
    from sweeps.show.in_the_way import in_the_way

    folder = Path(args.what[1])
    result = Result.load(folder)
    if not len(result):
        raise InputError("sweep folder", folder, "begun", "It has no finished chunk yet.")
    if not result.complete:
        print(f"jaxmpc sweep: unfinished: {progress(result)}", file=sys.stderr)
    if verb == "report":
        return _report(result, folder, args, n)
    from sweeps.show.tables import row_sheet, rows_table, sensitivity_table

    if verb == "sensitivity":
        # The best alone, run once more, tell little of what matters.
        print(sensitivity_table(result.explored))
        return 0 if args.params is None else _written(result.best(1, limit), args)
    if verb == "row":
        shown = result.take(_place(result, args.what[2]))
        print(row_sheet(shown))
    elif verb == "best":
        shown = result.best(n, limit)
        print(rows_table(shown, f"best of {len(result)} rows: {goal_of(result, limit).text}"))
        notes = [*in_the_way(result, goal_of(result, limit)), *chance(result, limit)]
        print("".join(f"{line}\n" for line in notes), end="")
    else:
        goals = ("rms", "M_s") if args.goals is None else tuple(name.strip() for name in args.goals.split(","))
        if "linear loop" in world_words(result) and (absent := next((name for name in goals if name in ON_ARM), None)):
            raise InputError("--goals", absent, "what the linear loop measures, too", "Only runs on the arm have it.")
        front = result.pareto(*goals)
        shown = front.take(slice(n)) if args.n else front
        told = f"Pareto front of {', '.join(goals)}"
        if len(front):
            told += f", {f'{len(shown)} of ' * (len(shown) < len(front))}{len(front)} rows"
        print(rows_table(shown, told, goals))
    return _written(shown, args)


def counts(result: "Result") -> str:
    """How many runs ended how."""
    found = ", ".join(f"{name} {count}" for name, count in result.status_counts().items() if count)
    return f"status over rows × stiffness: {found}"


def _place(result: "Result", text: str) -> "slice":
    from sweeps.targets import numbered

    if not numbered(text):
        raise InputError("row", text, "the number of a row", "`jaxmpc sweep best DIR` lists some.")
    place = result.place(int(text))
    return slice(place, place + 1)


def _written(shown: "Result", args: argparse.Namespace) -> int:
    """Write what was asked for, of the rows that are shown."""
    if args.params and not len(shown):
        place = f"`jaxmpc sweep best {shlex.quote(args.what[1])}` tells what stands in the way."
        raise InputError("--params", args.params, "written of a row that keeps the constraints", place)
    if args.csv:
        shown.to_csv(args.csv)
        print(f"written: {args.csv}")
    if args.params:
        write_params(shown, args.params)
        print(f"written: {args.params}, the controller of row {shown['row'][0]}")
    return 0


def write_params(result: "Result", path: Path) -> None:
    """Write the controller of the first row, with the world that it met as a comment.

    Raises:
        OSError: The file cannot be written.
    """
    from jaxmpc.files.toml import write_toml

    worlds = ", ".join(
        f"{axis.name} {axis.label(float(result[axis.name][0]))}{' times the base' * axis.relative}"
        for axis in result.axes
        if axis.of_world
    )
    note = f"Row {result['row'][0]} of a sweep, spec {result.plan.spec_hash}"
    write_toml(path, {"params": result.controller(0).to_dict()}, note + (f"\nIt met {worlds}" if worlds else ""))


def _report(result: "Result", folder: Path, args: argparse.Namespace, n: int) -> int:
    from jaxmpc.files.toml import write_toml
    from sweeps.show.best_rows import chance, table
    from sweeps.show.report import sweep_report

    limit = args.max_ms
    out = args.out or folder / "report"
    check_folder("-o", out)
    out.mkdir(parents=True, exist_ok=True)
    written = [out / "report.html"]
    print("computing the curves of the rows that matter …", file=sys.stderr, flush=True)
    sweep_report(result, written[0], limit)
    best, controller = result.best(n, limit), out / "best.toml"
    if not len(best):
        controller.unlink(missing_ok=True)  # of an earlier report, which had a row
    else:
        written.append(controller)
        note = f"Row {best['row'][0]} of a sweep, result {result.hash}"
        write_toml(written[-1], {"params": best.controller(0).to_dict()}, note)
    if args.csv:
        result.explored.to_csv(args.csv)
        written.append(args.csv)
    print(counts(result))
    print(table(result, n, limit))
    print("".join(f"{line}\n" for line in chance(result, limit)), end="")
    print(f"result {result.hash}\nwritten: {', '.join(map(str, written))}")
    return 0
