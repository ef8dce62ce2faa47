"""A sweep for people: all its rows as one page to explore, the best ones as a table and with their curves."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from jaxmpc.report.content import Report, Section, Table
from jaxmpc.report.page import write_report
from sweeps.goal import MEASURED
from sweeps.result import Result
from sweeps.show.best_rows import caption, chance, goal_of, progress, rendered
from sweeps.show.candidates import candidates
from sweeps.show.curves import details, length_words, note, that_matter, world_words
from sweeps.show.in_the_way import in_the_way

MOST_ROWS = 100_000
"""Rows of a page; of a larger sweep the front, the best and an even sample of the others."""
MOST_DRAWN = 600_000
"""Values of drawn parameters, of which every bit is kept."""


def sweep_report(result: Result, path: Path, max_M_s: float | None = None, curves: bool = True) -> None:
    """Write the report of a sweep.

    Args:
        result: The sweep.
        path: Where it goes.
        max_M_s: Largest accepted peak sensitivity [-]; None is the spec's.
        curves: Whether to compute the curves of the rows that matter; that takes compiling and a run.

    Raises:
        OSError: The file cannot be written.
    """
    wide = result.explored
    again = [] if wide is result else that_matter(result, max_M_s)
    shown = _sample(wide, max_M_s, result["row"][again])
    rows = candidates(shown, max_M_s)
    chosen = that_matter(shown, max_M_s)
    if curves and chosen:
        told, found = note(shown, len(chosen)), details(shown, chosen)
        if wide is not result:
            places = {row: place for place, row in enumerate(shown["row"].tolist())}
            for place, detail in details(result, again).items():
                # Of a stage before, a chunk may be lost since.
                if (row := int(result["row"][place])) in places:
                    found[places[row]] = detail
            told += f" Of the best {len(again)} of those that ran once more, as they ran on the {world_words(result)}."
        rows = replace(rows, details=found, note=told)
    counts = ", ".join(f"{count} {name}" for name, count in wide.status_counts().items() if count)
    tissues = len(wide.plan.stiffness)
    lead = [
        f"{len(wide)} rows on {tissues} {'stiffness' if tissues == 1 else 'stiffnesses'}; row × stiffness: {counts}.",
        f"Result sha256 {result.hash}, spec {result.plan.spec_hash[:12]}.",
    ]
    if not result.complete:
        lead.append(f"Unfinished: {progress(result)}.")
    lead += _told(wide, max_M_s)
    if len(shown) < len(wide):
        lead.append(
            f"Shown are {len(shown)}: the Pareto front, the best 1000 and an even sample of the others; all are in the "
            "folder, and `--csv` writes them."
        )
    again_part = [] if wide is result else [_again(result, wide, max_M_s)]
    best = Section("Best rows", [caption(wide, max_M_s)], [Table(*rendered(wide, 10, max_M_s))])
    parts = [*again_part, best, *_stages(result, max_M_s), *_base(wide)]
    write_report(Report(f"Sweep of {_swept(wide)}", lead, rows, parts, 0), path)


def _again(result: Result, wide: Result, max_M_s: float | None) -> Section:
    """The best rows as they ran once more, beside what they were before.

    Args:
        result: As they ran once more.
        wide: All rows before.
        max_M_s: Largest accepted peak sensitivity [-]; None is the spec's.
    """
    quantity, before = MEASURED[wide.goal.best], wide.worst(wide.goal.best)
    head, lines = rendered(result, len(result), max_M_s)
    order = wide["row"][wide.ranked(goal_of(wide, max_M_s))].tolist()
    rank = {row: k + 1 for k, row in enumerate(order)}
    there = dict(zip(wide["row"].tolist(), before.tolist(), strict=True))
    for line in lines:
        row = int(line[0])
        line += [quantity.entry(there.get(row, np.nan)), str(rank.get(row, "–"))]
    words = (
        f"The best {len(result)} of {len(wide)} rows once more, on the {world_words(result)}; {len(lines)} of them "
        f"keep the limits there too. The last columns are what they were on the {world_words(wide)}."
    )
    table = Table([*head, f"{quantity.heading} before", "rank before"], lines)
    return Section("Best rows, run once more", [words, *_told(result, max_M_s), caption(result, max_M_s)], [table])


def _told(result: Result, max_M_s: float | None) -> list[str]:
    lines = [*in_the_way(result, goal_of(result, max_M_s)), *chance(result, max_M_s)]
    return [f"{line[0].upper()}{line[1:]}." for line in lines]


def _sample(result: Result, max_M_s: float | None, more: np.ndarray) -> Result:
    """Not more rows than a page can hold: those that matter, and evenly of the others.

    Args:
        result: All rows.
        max_M_s: Largest accepted peak sensitivity [-]; None is the spec's.
        more: Numbers of rows that matter for another reason.
    """
    most = MOST_ROWS
    if result.plan.space.kind != "grid":
        most = min(most, MOST_DRAWN // len(result.plan.space.axes))
    if len(result) <= most:
        return result
    keep = np.zeros(len(result), bool)
    matter = np.concatenate([result.pareto()["row"], result.best(1000, max_M_s)["row"], more])
    keep[np.isin(result["row"], matter)] = True
    others = np.flatnonzero(~keep)
    keep[others[np.linspace(0, len(others) - 1, max(0, most - int(keep.sum()))).round().astype(int)]] = True
    return result.take(np.flatnonzero(keep))


def _stages(result: Result, max_M_s: float | None) -> Iterator[Section]:
    """The best rows of every stage of a refined sweep, as each saw them."""
    for name, stage in result.stages:
        if len(stage):
            words = f"{len(stage)} rows on the {world_words(stage)}, {length_words(stage)}."
            yield Section(f"Stage {name}", [words], [Table(*rendered(stage, 5, max_M_s))])


def _base(result: Result) -> list[Section]:
    base = result.baseline
    if base is None:
        return []
    words = f"Worst RMS {1e3 * base.rms:.4g} mN, worst M_s {base.M_s:.4g}."
    return [Section("Base controller", [words if np.isfinite(base.rms) else "It is not OK at every stiffness."])]


def _swept(result: Result) -> str:
    return ", ".join(axis.name for axis in result.axes)
