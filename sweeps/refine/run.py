"""Run a refined sweep: stages in order, each a sweep in a folder of its own, so that each resumes and is shared.

manifest.json       the spec of the whole, its hash
stages/0-screen/    a sweep's folder each
stages/1-full/ …
result.json         the hash of each stage's result, once all are there
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
from msgspec.structs import replace as changed

from jaxmpc.files.errors import InputError
from jaxmpc.files.foreign import LARGEST_JSON
from jaxmpc.files.sealed import digest
from sweeps import store
from sweeps.interrupt import gently
from sweeps.plan import make_plan
from sweeps.precision import with_precision
from sweeps.rates import samples_of
from sweeps.refine.proposal import around, survivors
from sweeps.result import AROUND, FULL, RERUN, SCREEN, Result, merged, of_stages
from sweeps.run import run as run_plain
from sweeps.spec import SweepSpec
from sweeps.tables import RefineTable

NUMBER_BYTES, ENTRY_BYTES = 10, 25
"""Most that a row's number takes in a manifest, and the entry of an axis [bytes]."""
Told = Callable[[str], None]


class Leg(NamedTuple):
    """A stage that can be run, the earlier ones being there."""

    name: str
    spec: SweepSpec


def run(spec: SweepSpec, folder: str | Path, *, told: Told = lambda text: None, **how: Any) -> Result:
    """Run a refined sweep, or what is missing of it.

    Args:
        spec: What is swept and refined.
        folder: Where its stages go: new, empty, or begun by the same spec.
        told: Called with a line before each stage.
        how: See `sweeps.run.run`.

    Returns:
        The rows of the last stage, or of all rounds around a front, `stages` being all stages; incomplete where
        somebody stopped it.

    Raises:
        InputError: The folder belongs to something else, or a stage could not be read again.
        OSError: The folder cannot be written, or the disk is full.
    """
    folder = Path(folder)
    spec = with_precision(spec, folder)
    assert spec.refine is not None
    _check_size(spec, spec.refine)
    store.prepare_refined(folder, *described(spec))
    if (finished := _finished(folder)) is not None:
        return finished
    done: list[tuple[str, Result]] = []
    with gently(how.get("gentle", False)) as stop:
        for leg in _legs(spec, spec.refine, done):
            if done and stop():
                return of_stages(done, ended=False)
            told(_announced(leg))
            result = run_plain(leg.spec, folder / "stages" / leg.name, told=told, **how)
            done.append((leg.name, result))
            if not result.complete:
                return of_stages(done, ended=False)
    store.write_summary(folder, {"stages": {name: result.hash for name, result in done}})
    return of_stages(done, ended=True)


def _finished(folder: Path) -> Result | None:
    """The result as it was when all stages were there, if they still are; another version may propose other rows."""
    if not (listed := store.read_summary(folder).get("stages")):
        return None
    found = Result.load(folder)
    return found if found.complete and {name: stage.hash for name, stage in found.stages} == listed else None


def check(folder: Path, spec: SweepSpec) -> bool:
    """Whether the folder already holds this very refined sweep; writes nothing.

    Raises:
        InputError: It holds something else, or a stage could not be read again.
    """
    assert spec.refine is not None
    _check_size(spec, spec.refine)
    return store.check_refined(folder, *described(spec))


def _check_size(spec: SweepSpec, refine: RefineTable) -> None:
    """Refuse a stage whose rows are more than a manifest can hold that is read again, before any stage is run."""
    rows, axes = spec.space.count, len(spec.space.axes)
    if refine.method == "halving":
        key, number, each = "refine.stages[0].keep", min(refine.stages[0].keep, rows), NUMBER_BYTES
    elif refine.method == "pareto" and refine.rerun is not None:
        # Those that run once more keep their numbers among all rows, which are written out.
        key, number, each = "refine.rerun", rows + refine.rounds * refine.points, axes * ENTRY_BYTES
    else:
        key, number, each = "refine.points", refine.points, axes * ENTRY_BYTES
    if refine.method != "none" and number > (most := LARGEST_JSON // each):
        remedy = "More could not be read again: take fewer rows" + ", or leave the rerun out." * (key == "refine.rerun")
        raise InputError(key, f"{number} rows", f"at most {most} rows that are written out", remedy)


def described(spec: SweepSpec) -> tuple[dict[str, Any], str]:
    """The whole as plain data, and its hash: here the ranking counts, since later stages follow from it."""
    refine, goal = msgspec.to_builtins(spec.refine), msgspec.to_builtins(spec.goal)
    for stage in (*refine["stages"], *filter(None, [refine["rerun"]])):
        if isinstance(motion := stage["experiment"].get("motion"), dict) and motion.get("file"):
            # As in the spec of a plain sweep: by its content, wherever it lies.
            motion["file"] = spec.on(stage["experiment"]).experiment.content["motion"]["file"]
    if spec.precision == "float64" or not spec.goal.decide:
        # Folders from before anything ran once more in float64 go on.
        del goal["decide"]
    canonical = {"sweep": make_plan(spec).canonical, "goal": goal, "refine": refine}
    plain = msgspec.json.decode(msgspec.json.encode(canonical))
    return plain, digest(plain)


def _announced(leg: Leg) -> str:
    """How many rows a stage has, on what, and what they cost, for a person."""
    plan = make_plan(leg.spec)
    swept = {axis.name: axis.values for axis in plan.space.axes}
    physics = " and ".join(swept.get("physics", (leg.spec.experiment.physics,)))
    steps = len(plan.rows) * samples_of(plan) / len(plan.stiffness)
    return f"{leg.name}: {len(plan.rows)} rows on {physics}, {steps:.3g} steps a tissue"


def _legs(spec: SweepSpec, refine: RefineTable, done: list[tuple[str, Result]]) -> Iterator[Leg]:
    """Stages in order; what each of them is follows from those that are done."""
    plain = replace(spec, refine=None)
    wanted: tuple[int, ...] | None = None
    if refine.method == "halving":
        for i, stage in enumerate(refine.stages):
            # Chance among those that hardly go on, or hardly do not, costs nothing.
            screened = replace(plain, goal=changed(plain.goal, decide=0))
            yield Leg(f"{i}{SCREEN}", _only(screened.on(stage.experiment), wanted))
            wanted = survivors(done[-1][1], stage.keep)
            if not wanted:
                raise InputError("refine.stages", f"stage {i}", "survived by a row", "No row is OK: widen the axes.")
    yield Leg(f"{len(done)}{FULL}", _only(plain, wanted))
    if refine.method == "pareto":
        for number in range(1, refine.rounds + 1):
            before = merged([result for _, result in done])
            space = around(before, spec.space.factors, refine.goals, refine.points, refine.seed, number)
            if space.count:
                yield Leg(f"{len(done)}{AROUND}", replace(plain, space=space))
    if refine.rerun is not None:
        before = merged([result for name, result in done if not name.endswith(SCREEN)])
        best = before.best(refine.rerun.best)
        if len(best):
            again = plain.on(refine.rerun.experiment)
            space = before.plan.space if refine.method == "pareto" else plain.space
            yield Leg(f"{len(done)}{RERUN}", replace(again, space=space).only(tuple(best["row"].tolist())))


def _only(spec: SweepSpec, rows: tuple[int, ...] | None) -> SweepSpec:
    return spec if rows is None else spec.only(rows)
