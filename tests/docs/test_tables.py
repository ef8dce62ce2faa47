"""Guides name every key that a file may have, with the default that the code has, and their files are taken."""

import re
import tomllib
from pathlib import Path
from typing import Any

import msgspec
import pytest

from deploy.controller.limits import ROWS
from deploy.twin.faults import WORDS
from jaxmpc.experiment import Experiment
from jaxmpc.synthesis.params import Params
from jaxmpc.world.heart.motion import Motion
from sweeps import SweepSpec
from sweeps.tables import Range, RefineTable, Rerun, Stage, SweepTable
from tests.docs.desk import write_heart
from tests.docs.document import blocks, pages
from tests.sources import ROOT
from tuning import Risk, Scenarios, TuneSettings, TuneSpec

TOML = [block for page in pages() for block in blocks(page) if block.language == "toml"]


def page(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def plain(value: Any) -> Any:
    """As TOML has it, of what is no whole decimal three digits."""
    if isinstance(value, tuple):
        return [plain(each) for each in value]
    return round(value, 3) if isinstance(value, float) else value


def value_of(text: str) -> Any:
    """A value as it is written; of a list with `…` in it, all whole numbers between its ends."""
    found = tomllib.loads(f"x = {text.replace('…,', '')}")["x"]
    return list(range(found[0], found[-1] + 1)) if "…" in text else found


@pytest.mark.parametrize(("kind", "table"), [(TuneSettings, "tune"), (Scenarios, "scenarios"), (Risk, "risk")])
def test_a_job_is_printed_with_every_key_and_what_it_is_when_left_out(kind: type, table: str) -> None:
    job = next(block.text for block in TOML if "\n[scenarios]" in block.text)
    lines = job.split(f"\n[{table}]", 1)[1].split("\n[", 1)[0].splitlines()[1:]
    told = dict(re.findall(r"^(\w+) = .*left out: (.+)$", "\n".join(lines), re.M))
    assert list(told) == [line.split(" = ")[0] for line in lines if " = " in line]
    for each in msgspec.structs.fields(kind):
        default = plain(each.default)
        if default not in ([], None) or told[each.name] == "[]":
            assert value_of(told[each.name]) == default, each.name
        else:
            assert told[each.name].startswith("the "), each.name


def test_the_heart_is_told_with_every_key_and_what_it_is_when_left_out() -> None:
    table = page("docs/arm.md").split("**The heart**")[1].split("\n\n")[1]
    rows = re.findall(r"^\| (`\w+`(?:, `\w+`)?) \| (.+?) \| .+ \|$", table, re.M)
    keys = [key for row, _ in rows for key in re.findall(r"\w+", row)]
    defaults = [value for _, row in rows for value in re.findall(r"`(.+?)`", row)]
    assert {key: value_of(value) for key, value in zip(keys, defaults, strict=True)} == {
        each.name: plain(each.default) for each in msgspec.structs.fields(Motion)
    }


def numbers(text: str) -> list[float]:
    return [float(number) for number in re.findall(r"[\d.]+", text)]


def test_limits_are_told_with_default_least_and_most() -> None:
    table = page("docs/robot.md").split("## Limits")[1].split("##")[0]
    cells = [[cell.strip() for cell in line.split("|")[1:-1]] for line in table.splitlines() if line.startswith("| `")]
    rows = [(re.findall(r"`(\w+)`", name)[0], *rest) for name, *rest in cells]
    assert [name for name, *_ in rows] == list(ROWS)
    for name, unit, *told in rows:
        row = ROWS[name]
        assert unit == row.unit
        for text, value in zip(told, (row.default, row.lowest, row.highest), strict=True):
            if not row.widest:
                assert numbers(text) == list(value if isinstance(value, tuple) else (value,)), name
    ranges = dict((name, told) for name, _, *told in rows)["joint_range"]
    for text, wanted in ((ranges[0], ROWS["joint_range"].default), (ranges[2], ROWS["joint_range"].widest)):
        ends = [f"±{high:g}" if low == -high else f"−{-low:g}…{high:g}" for low, high in wanted]
        assert text == ", ".join(ends)


def test_faults_are_told_by_target_and_word() -> None:
    rows = [
        row.split(" | ") for row in page("docs/robot.md").split("| target | words")[1].split("\n\n")[0].splitlines()
    ]
    told = {target: set[str]() for target in WORDS}
    for targets, words in rows[2:]:
        names = re.sub(
            r"`(\w+?)(\d)` to `\w+?(\d)`", lambda found: " ".join(f"`{found[1]}{k}`" for k in "1234"), targets
        )
        for target in re.findall(r"`(\w+)`", names):
            told[target] |= set(re.findall(r"`([a-z-]+)(?:=\w+)?`", words))
    # Three words of the force are no frame's, so that no command line means them.
    assert told == {target: set(words) - {"nan", "inf", "-inf"} for target, words in WORDS.items()}


@pytest.mark.parametrize("kind", [SweepTable, Range, RefineTable, Stage, Rerun])
def test_the_guide_to_sweeps_names_every_key(kind: type) -> None:
    guide = page("docs/sweeps.md")
    assert not [each.name for each in msgspec.structs.fields(kind) if not re.search(rf"\b{each.name}( = |\])", guide)]


@pytest.mark.parametrize("block", TOML, ids=lambda block: block.place)
def test_what_is_printed_as_a_file_is_taken(block: Any, tmp_path: Path) -> None:
    data, whole = tomllib.loads(block.text), next(each.text for each in TOML if each.file == "spec.toml")
    write_heart(tmp_path / "heart.csv")
    if "physics" in data:
        Experiment.from_dict(data, tmp_path)
    elif "scenarios" in data:
        TuneSpec.from_dict(data, tmp_path)
    elif "tune" in data:
        job = {"experiment": {"published": "family-wam"}, "params": {"published": "family"}, **data}
        TuneSpec.from_dict(job, tmp_path)
    elif "sweep" in data or "refine" in data:
        spec = tomllib.loads(whole)
        zipped = {key for each in data.get("sweep", {}).get("zip", []) for key in each}
        spec["sweep"] |= {"axes": {k: v for k, v in spec["sweep"]["axes"].items() if k not in zipped}}
        SweepSpec.from_dict({**spec, **data, "sweep": {**spec["sweep"], **data.get("sweep", {})}}, tmp_path)
    elif "params" in data:
        knots = data["params"]["knots"] * len(data["params"]["listening"]["stiffness"])
        assert Params.from_dict({**data["params"], "knots": knots}).knots
    else:
        assert set(data) <= set(ROWS), block.place
