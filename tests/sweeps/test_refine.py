"""Refined sweeps: fewer steps to the same best row, a front that moves on, the same rows every time."""

import re
from argparse import Namespace
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

import sweeps
from jaxmpc import evaluate
from jaxmpc.cli import main
from jaxmpc.files.errors import InputError
from jaxmpc.status import Status
from jaxmpc.synthesis.params import Params
from sweeps import store
from sweeps.axis import SweepAxis
from sweeps.merging import merge
from sweeps.plan import make_plan
from sweeps.refine.proposal import REACH, around, survivors
from sweeps.refine.run import ENTRY_BYTES, check
from sweeps.refine.run import run as refine
from sweeps.result import Result, merged
from sweeps.run import run
from sweeps.show.report import sweep_report
from sweeps.space import SweepSpace
from sweeps.spec import SweepSpec
from tests.sweeps.refined import DATA, STAGE, made
from tests.sweeps.short_experiment import EXPERIMENT


@pytest.mark.oracle
def test_halving_finds_the_best_row_and_resumes(tmp_path: Path) -> None:
    spec = replace(made(method="halving", stages=[STAGE]), precision="float64")
    half = refine(spec, tmp_path / "half")
    full = run(replace(spec, refine=None), tmp_path / "full")
    assert [name for name, _ in half.stages] == ["0-screen", "1-full"]
    assert len(half) == 12
    best = half.best(1)
    assert best["row"].tolist() == full.best(1)["row"].tolist() != []
    # A survivor has the bits that it has in the full sweep.
    places = np.searchsorted(full["row"], half["row"])
    for name in half.columns:
        np.testing.assert_array_equal(half[name], full[name][places], err_msg=name)
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "half").rglob("*.npz")}
    chunk = sorted(before)[0]
    chunk.unlink()
    again = refine(spec, tmp_path / "half")
    assert again.hash == half.hash
    assert {path: path.stat().st_mtime_ns for path in before if path != chunk} == {
        path: when for path, when in before.items() if path != chunk
    }
    assert sweeps.load(tmp_path / "half").hash == half.hash
    wider = replace(made(method="halving", stages=[{**STAGE, "keep": 13}]), precision="float64")
    with pytest.raises(InputError, match=r"refine\.stages\[0\]\.keep: there 12, here 13"):
        refine(wider, tmp_path / "half")


@pytest.mark.oracle
def test_rows_around_the_front_move_it_and_are_the_same_every_time(tmp_path: Path) -> None:
    refined = made(method="pareto", rounds=2, points=40, seed=5, rerun={"best": 3, "experiment": {"delay": 2}})
    # What float32 cannot decide runs in float64 in every stage.
    spec = replace(refined, goal=msgspec.structs.replace(refined.goal, decide=100))
    found = refine(spec, tmp_path / "one")
    assert [name for name, _ in found.stages] == ["0-full", "1-around", "2-around", "3-rerun"]
    rounds = [result for _, result in found.stages[:3]]
    together = merged(rounds)
    assert len(together) == sum(map(len, rounds))
    assert together["row"].tolist() == list(range(len(together)))
    first, all_rows = rounds[0].best(1).worst("rms")[0], together.best(1).worst("rms")[0]
    assert all_rows < first
    # A row of the merged sweep is the controller that was run.
    place = len(rounds[0]) + 3
    assert together.controller(place).to_dict() == rounds[1].controller(3).to_dict()
    assert (together["Hu"] <= 47).all()
    # The best three once more, on the loop that is a sample later.
    rerun = found.stages[-1][1]
    assert sorted(rerun["lam"].tolist()) == sorted(together.best(3)["lam"].tolist())
    assert rerun.experiment(0).delay == 2
    assert any(result.decided is not None for result in rounds)
    other = refine(spec, tmp_path / "other")
    assert [result.hash for _, result in other.stages] == [result.hash for _, result in found.stages]


def test_good_rows_go_on_first_then_those_with_margins_then_those_that_are_ok() -> None:
    limits = {"M_s": 3.0, "chatter": 1.0}
    plan = make_plan(SweepSpec.from_dict({**DATA, "sweep": {**DATA["sweep"], "rows": 6, "constraints": limits}}))
    columns = {name: np.zeros((6, *column.shape), column.dtype) for name, column in plan.layout.items()}
    columns |= {"row": plan.rows, **plan.space.columns(plan.rows)}
    columns["rms"] += np.array([5.0, 1.0, 0.5, 0.1, 4.0, 0.6])[:, None, None]
    columns["chatter"][1] = columns["M_s"][[2, 5]] = 4.0
    columns["status"][3] = Status.FORCE_LIMIT
    found = Result.of(plan, columns, np.ones(6, bool))
    order = [4, 0, 1, 2, 5]
    for keep in range(1, 8):
        assert survivors(found, keep) == tuple(sorted(order[:keep]))


def test_rows_move_by_a_tenth_of_a_range_and_half_as_far_each_round() -> None:
    sweep = {**DATA["sweep"], "rows": 4, "axes": {"K2": {"linear": [10.0, 110.0]}, "lam": {"log": [0.01, 1.0]}}}
    plan = make_plan(SweepSpec.from_dict({**DATA, "sweep": sweep}))
    columns = {name: np.zeros((4, *column.shape), column.dtype) for name, column in plan.layout.items()}
    columns |= {"row": plan.rows, "K2": np.full(4, 60.0), "lam": np.full(4, 0.1)}
    found = Result.of(plan, columns, np.ones(4, bool))
    for number in (1, 2, 3):
        (K2, lam) = (
            np.array(axis.values) for axis in around(found, plan.space.factors, ("rms",), 2000, 1, number).axes
        )
        for moved in ((K2 - 60.0) / 100.0, np.log(lam / 0.1) / np.log(100.0)):
            assert moved.std() == pytest.approx(REACH / 2.0 ** (number - 1), rel=0.05)
            assert abs(moved.mean()) < 0.1 * moved.std()
    assert REACH == 0.1


@pytest.mark.parametrize(
    ("M_s", "failed", "parents"),
    [([2.5, 2.0, 5.0], [], {0.0, 1.0}), ([5.0, 4.5, 6.0], [], {0.0, 1.0, 2.0}), ([2.5, 2.0, 5.0], [0, 1, 2], {0.0})],
    ids=["the good part", "all of it", "no row is OK"],
)
def test_rows_are_added_around_the_good_part_of_a_front(
    M_s: list[float], failed: list[int], parents: set[float]
) -> None:
    sweep = {**DATA["sweep"], "rows": 3, "axes": {"K2": {"linear": [10.0, 110.0]}, "Hu": [2, 5, 10]}}
    plan = make_plan(SweepSpec.from_dict({**DATA, "sweep": sweep}))
    columns = {name: np.zeros((3, *column.shape), column.dtype) for name, column in plan.layout.items()}
    columns |= {"row": plan.rows, "K2": np.array([40.0, 60.0, 80.0]), "Hu": np.array([2.0, 5.0, 10.0])}
    columns["rms"] += np.array([2.0, 3.0, 1.0])[:, None, None]
    columns["M_s"] += np.array(M_s)[:, None]
    columns["status"][failed] = Status.FORCE_LIMIT
    found = Result.of(plan, columns, np.ones(3, bool))
    _, Hu = around(found, plan.space.factors, ("rms", "M_s"), 90, 1, 1).axes
    assert {(2.0, 5.0, 10.0).index(value) for value in Hu.values} == parents


def test_zipped_numbers_stay_together_around_a_front(tmp_path: Path) -> None:
    sweep = {key: value for key, value in DATA["sweep"].items() if key not in ("axes", "rows", "seed")} | {
        "kind": "grid",
        "zip": [
            {"lam": {"log": [0.01, 1.0], "points": 4}, "K2": {"linear": [10.0, 40.0], "points": 4}},
            {"T_cl": {"log": [0.001, 0.01], "points": 2}, "R": [1.0, 2.0]},
        ],
    }
    spec = SweepSpec.from_dict({**DATA, "sweep": sweep})
    full = run(spec, tmp_path / "full")
    space = around(full, spec.space.factors, ("rms", "M_s"), 30, 1, 1)
    lam, K2, T_cl, _ = (np.array(axis.values) for axis in space.axes)
    assert len(set(lam)) > 10
    np.testing.assert_allclose((K2 - 10.0) / 30.0, np.log(lam / 0.01) / np.log(100.0), atol=1e-12)
    # A list has nothing between its values, nor has what is zipped with it.
    assert set(T_cl) <= set(full["T_cl"])


@pytest.mark.parametrize(
    "horizons",
    [
        {"axes": {"Hp": {"linear": [3, 40]}, "Hu": [3, 10]}},
        {"axes": {"Hp": {"linear": [3, 40]}, "Hu": {"linear": [10, 15]}}},
        {"axes": {"Hp": [5, 12], "Hu": {"linear": [4, 15]}}},
        {"axes": {"Hu": {"linear": [4, 16]}}, "params": {"Hp": 8, "Hu": 4}},
        {"zip": [{"Hp": {"linear": [3, 40]}, "K2": {"linear": [3, 40]}}], "axes": {"Hu": {"linear": [10, 15]}}},
    ],
)
def test_horizons_around_a_front_stay_in_their_lists_ranges_and_zips(horizons: dict[str, Any]) -> None:
    """Where Hp moved below Hu, Hu took its value: 5, 8 and 9 of a list of 3 and 10."""
    given = {"lam": {"log": [0.01, 1.0]}, **horizons["axes"]}
    sweep = {"kind": "random", "rows": 60, "seed": 1, "axes": given, "zip": horizons.get("zip", [])}
    params = {"published": "cautious", **horizons.get("params", {})}
    plan = make_plan(SweepSpec.from_dict({**DATA, "sweep": sweep, "params": params}))
    count = len(plan.rows)
    columns = {name: np.zeros((count, *column.shape), column.dtype) for name, column in plan.layout.items()}
    columns |= {"row": plan.rows, **plan.space.columns(plan.rows)}
    # All of them span the front.
    columns["rms"] += np.arange(count)[:, None, None]
    columns["M_s"] += 2.0 - np.arange(count)[:, None] / count
    found = Result.of(plan, columns, np.ones(count, bool))
    space = around(found, plan.space.factors, ("rms", "M_s"), 400, 1, 1)
    assert space.count > 300
    assert len(space.rows()) == space.count, "Hu above Hp"
    moved = {axis.name: np.array(axis.values) for axis in space.axes}
    for axis in plan.space.axes:
        assert moved[axis.name].min() >= min(axis.values)
        assert moved[axis.name].max() <= max(axis.values)
        assert axis.ranged or set(moved[axis.name]) <= set(axis.values)
    if "zip" in horizons:
        np.testing.assert_allclose(np.round(moved["K2"]), moved["Hp"], atol=1.0)


@pytest.mark.oracle
def test_the_best_rows_run_once_more_on_the_arm(tmp_path: Path) -> None:
    # In float64, and no rows that are good on the linear loop alone: one that blows up on the arm has no numbers.
    axes = {"lam": {"log": [0.05, 1.0]}, "Q_p": {"log": [0.02, 1.0]}, "Hu": [2, 5, 10]}
    sweep = {**DATA["sweep"], "axes": axes, "precision": "float64", "constraints": {"M_s": 2.0}}
    rerun = {"best": 3, "experiment": {"physics": "wam"}}
    spec = SweepSpec.from_dict(
        {**DATA, "sweep": sweep, "refine": {"method": "halving", "stages": [STAGE], "rerun": rerun}}
    )
    found = refine(spec, tmp_path / "run")
    assert [name for name, _ in found.stages] == ["0-screen", "1-full", "2-rerun"]
    linear = found.stages[1][1]
    assert sorted(found["row"].tolist()) == sorted(linear.best(3)["row"].tolist())
    assert found.plan.canonical["experiment"]["physics"] == "wam"
    assert found.explored.hash == linear.hash
    assert refine(spec, tmp_path / "run").hash == sweeps.load(tmp_path / "run").hash == found.hash
    # What the arm itself says of them.
    arm = msgspec.structs.replace(spec.experiment, physics="wam")
    exact = evaluate(Params.stack([found.controller(place) for place in range(3)]), arm)
    np.testing.assert_array_equal(found["status"], exact.status)
    measured = exact.metrics._asdict() | exact.margins._asdict()
    # Where the force runs away the last bit decides the digits; elsewhere two programs of one law agree.
    ok = exact.status == Status.OK
    assert ok.any()
    for name in found.plan.kept:
        np.testing.assert_allclose(found[name][ok], measured[name][ok], rtol=1e-6, err_msg=name)
    assert not np.allclose(found["rms"], linear.best(3)["rms"], rtol=1e-2)
    # The page lets one explore all rows, and says what the best ones were before.
    sweep_report(found, tmp_path / "report.html", curves=False)
    page = (tmp_path / "report.html").read_text()
    assert "The best 3 of 12 rows once more, on the arm" in page
    assert "rank before" in page
    assert f"{len(linear)} rows on 2 stiffnesses" in page
    assert main(["sweep", "report", f"{tmp_path / 'run'}", "--csv", f"{tmp_path / 'rows.csv'}"]) == 0
    assert len((tmp_path / "rows.csv").read_text().splitlines()) == 1 + 2 * len(linear)


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"method": "halving"}, ["refine.stages", "one stage or more"]),
        ({"method": "pareto", "stages": [STAGE]}, ["refine.stages", 'method = "halving"']),
        ({"method": "halving", "stages": [STAGE], "seed": 3}, ["refine.seed", 'method = "pareto"']),
        ({"method": "pareto", "goals": ["rms", "Ms"]}, ["refine.goals", "Did you mean 'M_s'"]),
        ({"method": "pareto", "goals": []}, ["refine.goals", "at least one goal"]),
        ({"method": "halving", "stages": [{"keep": 5}, {"keep": 6}]}, ["ever fewer rows"]),
        ({"method": "halving", "stages": [{"keep": 5, "experiment": {"duration": 0.1}}]}, ["settle"]),
        ({}, ["refine.method"]),
    ],
)
def test_wrong_tables_are_refused(table: dict[str, Any], words: list[str]) -> None:
    with pytest.raises(InputError) as caught:
        made(**table)
    assert [word for word in words if word not in str(caught.value)] == []


RAMPS = {"z": [{"kind": "ramp", "to": -5.0, "rate": 2.0}]}


@pytest.mark.parametrize(
    ("axes", "changed", "words"),
    [
        ({"settle": [0.2, 0.8]}, {"duration": 0.6}, ["sweep.axes.settle = 0.8", "0.6 s"]),
        ({"arm.cable_hz": [0.0, 250.0]}, {"physics": "wam", "arm": {"substeps": 1}}, ["cable_hz = 250", "substep"]),
        (
            {"duration": [1.0, 2.0]},
            {"settle": 0.9, "reference": RAMPS},
            ["sweep.axes.duration = 1", "No sample is left"],
        ),
        ({"lam": [0.1, 0.2]}, {"reference": RAMPS}, ["settle", "No sample is left to score"]),
        ({"guarded": [False, True]}, {"physics": "wam", "sampling_time": 0.01}, ["guarded", "0.005 s"]),
    ],
)
@pytest.mark.parametrize("stage", ["stages[0]", "rerun"])
def test_a_stage_on_which_some_row_has_no_run_is_refused_before_any_is_run(
    axes: dict[str, Any], changed: dict[str, Any], words: list[str], stage: str
) -> None:
    """The rerun was set aside as a whole when all else had been computed."""
    refine = {"rerun": {"best": 2, "experiment": changed}}
    if stage != "rerun":
        refine = {"method": "halving", "stages": [{"keep": 2, "experiment": changed}], "rerun": {"best": 1}}
    experiment = {**EXPERIMENT, "arm": {"substeps": 5}}
    data = {"experiment": experiment, "sweep": {"kind": "grid", "axes": axes}, "refine": refine}
    with pytest.raises(InputError) as caught:
        SweepSpec.from_dict(data)
    assert [word for word in (*words, f"refine.{stage}.experiment") if word not in str(caught.value)] == []


def test_a_front_of_lists_alone_is_refused() -> None:
    """It has no row beside it, so nothing was added, and nobody was told."""
    sweep = {"kind": "grid", "axes": {"lam": [0.1, 0.2]}, "zip": [{"T_cl": [0.002, 0.003], "K2": [10.0, 20.0]}]}
    with pytest.raises(InputError, match=r"refine\.method = pareto: must be with a range"):
        SweepSpec.from_dict({**DATA, "sweep": sweep, "refine": {"method": "pareto"}})


@pytest.mark.parametrize(
    ("rows", "table", "words"),
    [
        (100, {"method": "pareto", "points": 1_000_000}, "refine.points = 1000000 rows: must be at most 894784 rows"),
        (
            900_000,
            {"method": "pareto", "points": 10, "rerun": {}},
            "refine.rerun = 900030 rows: must be at most 894784",
        ),
        (10_000_000, {"method": "halving", "stages": [{"keep": 7_000_000}]}, "refine.stages[0].keep = 7000000 rows"),
    ],
)
def test_rows_that_no_manifest_could_hold_are_refused_before_any_is_run(
    rows: int, table: dict[str, Any], words: str, tmp_path: Path
) -> None:
    spec = SweepSpec.from_dict({**DATA, "sweep": {**DATA["sweep"], "rows": rows}, "refine": table})
    for begin in (lambda: check(tmp_path / "run", spec), lambda: refine(spec, tmp_path / "run")):
        with pytest.raises(InputError, match=re.escape(words)):
            begin()
    assert not (tmp_path / "run").exists()


def test_rows_that_are_written_out_take_what_is_reckoned_with(spec: SweepSpec, tmp_path: Path) -> None:
    rows = 50_000
    values = np.random.default_rng(0).random((2, rows)) * 1e-5
    axes = tuple(
        SweepAxis(name, "log", tuple(each.tolist())) for name, each in zip(("lam", "Q_p"), values, strict=True)
    )
    plan = make_plan(replace(spec, space=SweepSpace("grid", (axes,), rows, 0, spec.space.horizons)))
    store.prepare(tmp_path / "run", plan)
    assert (tmp_path / "run" / "manifest.json").stat().st_size < 2 * rows * ENTRY_BYTES
    assert store.check(tmp_path / "run", plan)


def test_rows_of_one_choice_are_of_one_kind(spec: SweepSpec) -> None:
    """Where rows are written out each has its own copy of the choice."""
    axis = SweepAxis("architecture", "choice", ("mpc", "aob", "mpc", "aob"))
    plan = make_plan(replace(spec, space=SweepSpace("grid", ((axis,),), 4, 0, spec.space.horizons)))
    _, columns = merge([(plan, {"row": np.arange(4), "architecture": axis.column()})] * 2)
    assert columns["architecture"].tolist() == [0.0, 1.0] * 4


@pytest.mark.parametrize(
    ("axes", "stage", "told"),
    [
        ({"duration": [1.0, 3.0]}, {"sampling_time": 0.002}, ["8 rows on linear, 8e+03", "4 rows on linear, 8e+03"]),
        ({"sampling_time": {"values": [1.0, 0.5], "relative": True}}, {}, ["8 rows on linear, 1.2e+04"]),
        ({"physics": ["linear", "wam"]}, {}, ["8 rows on linear and wam, 8e+03"]),
    ],
)
def test_steps_of_a_stage_are_those_of_its_rows(
    axes: dict[str, Any], stage: dict[str, Any], told: list[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    sweep = {"kind": "grid", "axes": {**axes, "lam": {"log": [0.01, 1.0], "points": 4}}}
    table = {"method": "halving", "stages": [{"keep": 4, "experiment": stage}]}
    lines: list[str] = []
    # The rows themselves are not asked for: the first four of a stage go on.
    done = Namespace(complete=True, hash="")
    monkeypatch.setattr("sweeps.refine.run.run_plain", lambda *_, **__: done)
    monkeypatch.setattr("sweeps.refine.run.survivors", lambda result, keep: (0, 1, 4, 5))
    monkeypatch.setattr("sweeps.refine.run.of_stages", lambda stages, ended: done)
    refine(SweepSpec.from_dict({**DATA, "sweep": sweep, "refine": table}), tmp_path / "run", told=lines.append)
    assert [line.partition(": ")[2].removesuffix(" steps a tissue") for line in lines][: len(told)] == told
