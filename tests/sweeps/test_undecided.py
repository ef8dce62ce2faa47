"""What float32 cannot decide runs in float64: status and best rows are those of the whole sweep in float64."""

import importlib
from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jaxmpc.files.errors import InputError
from jaxmpc.quantities import METRICS
from jaxmpc.status import Status
from sweeps import crew
from sweeps.compute import baseline, compute
from sweeps.decided import plan_in_float64, with_decided
from sweeps.dry_run import dry_run
from sweeps.goal import SweepGoal
from sweeps.met import scored_time
from sweeps.plan import Columns, Plan, make_plan
from sweeps.refine.run import described
from sweeps.result import Result
from sweeps.run import run
from sweeps.show.best_rows import chance
from sweeps.show.report import sweep_report
from sweeps.spec import SweepSpec
from sweeps.undecided import IN_FLOAT64, TOP, amplification, undecided

ROWS = 500
DATA: dict[str, Any] = {
    "experiment": {
        "published": "table-1",
        "duration": 1.0,
        "settle": 0.3,
        "stiffness": [375.0, 1900.0],
        "reference": {"z": -5.0},
    },
    "params": {"published": "text"},
    "sweep": {
        "kind": "random",
        "rows": ROWS,
        "constraints": {"M_s": 5.0},
        "axes": {
            "lam": {"log": [0.01, 10.0]},
            "Q_p": {"log": [0.02, 5.0]},
            "T_cl": {"log": [0.001, 0.02]},
            "K2": {"linear": [5.0, 50.0]},
            "Hp": [5, 10, 20, 30],
        },
    },
}
GOALS = (
    SweepGoal("rms", {"M_s": 5.0}),
    SweepGoal("true_rms", {"M_s": 3.0, "chatter": 0.5}),
    SweepGoal("peak_error", {}),
    SweepGoal("M_s", {"rms": 0.05}),
)


@pytest.fixture(scope="module")
def spec() -> SweepSpec:
    return SweepSpec.from_dict(DATA)


@pytest.fixture(scope="module")
def exact(spec: SweepSpec) -> Result:
    """Every row in float64."""
    plan = make_plan(replace(spec, precision="float64"))
    return Result.of(plan, compute(plan, 0, ROWS), np.ones(ROWS, bool))


@pytest.fixture(scope="module")
def single(spec: SweepSpec) -> Result:
    """Every row in float32."""
    plan = make_plan(spec)
    return Result.of(plan, compute(plan, 0, ROWS), np.ones(ROWS, bool))


def on(goal: SweepGoal, result: Result) -> Result:
    return replace(result, plan=replace(result.plan, goal=goal))


def completed(result: Result, exact: Result) -> Result:
    """A float32 result in which what is undecided is taken from the sweep in float64."""
    again = plan_in_float64(result.plan, result.columns)
    if again is None:
        return result
    columns, decided = with_decided(result.columns, again, exact.take(again.rows).columns)
    return replace(result, columns=columns, decided=decided)


def assert_decided(found: Result, exact: Result) -> None:
    np.testing.assert_array_equal(found["status"], exact["status"])
    np.testing.assert_array_equal(found.feasible, exact.feasible)
    assert found.best(TOP)["row"].tolist() == exact.best(TOP)["row"].tolist()
    assert len(found.undecided()) == 0


@pytest.mark.oracle
def test_float32_is_as_near_as_it_is_said_to_be(single: Result, exact: Result) -> None:
    np.testing.assert_array_equal(single["status"], exact["status"])
    ok = exact.ok
    assert 200 < ok.sum() < ROWS
    amplified = amplification(exact.plan, exact.columns)[ok]
    for name, metric in METRICS.items():
        one, other = single.worst(name)[ok], exact.worst(name)[ok]
        measured = np.isfinite(other)
        assert measured.all() == (name != "swing")
        allowed = metric.float32_error * amplified * np.abs(other)
        assert (np.abs(one[measured] - other[measured]) <= allowed[measured]).all(), name
    for name in ("M_s", "gain_margin_db", "spectral_radius"):
        np.testing.assert_allclose(single[name], exact[name], rtol=1e-9, err_msg=name)


@pytest.mark.oracle
@pytest.mark.parametrize("goal", GOALS, ids=lambda goal: goal.text)
def test_status_and_best_rows_are_those_of_float64(goal: SweepGoal, single: Result, exact: Result) -> None:
    found = completed(on(goal, single), exact)
    assert_decided(found, on(goal, exact))
    assert found[IN_FLOAT64].sum() < ROWS / 2


def shaken(exact: Result, plan: Plan, seed: int) -> Result:
    """A sweep in float32 whose errors are as large as they are said to become, on each row by chance."""
    random = np.random.default_rng(seed)
    columns = dict(exact.columns) | {IN_FLOAT64: np.zeros(ROWS, bool)}
    amplified = amplification(plan, columns)
    for name, metric in METRICS.items():
        error = 0.95 * metric.float32_error * amplified * random.choice([-1.0, 1.0], ROWS)
        columns[name] = (columns[name] / np.maximum(1.0 + error, 1e-3)[:, None, None]).astype(np.float32)
    return Result(plan, columns)


def test_errors_as_large_as_they_are_said_to_become_do_no_harm(spec: SweepSpec, exact: Result) -> None:
    wrong = 0
    for seed, goal in product(range(5), GOALS):
        before = shaken(exact, replace(make_plan(spec), goal=goal), seed)
        wrong += int(before.best(1)["row"][0] != on(goal, exact).best(1)["row"][0])
        assert_decided(completed(before, exact), on(goal, exact))
    # Float32 alone takes another row for the best one.
    assert wrong > 0


def test_a_sweep_that_ranks_wrongly_is_put_right(
    spec: SweepSpec,
    exact: Result,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    command: Callable[..., int],
    capsys: pytest.CaptureFixture[str],
) -> None:
    begin, first = crew.begin, int(exact.best(1)["row"][0])

    def unlucky(plan: Plan, start: int, end: int) -> Callable[[], Columns]:
        finish = begin(plan, start, end)

        def finished() -> Columns:
            columns = finish()
            if plan.canonical["precision"] == "float32":
                true = exact.take(columns["row"])
                error = 0.9 * METRICS["rms"].float32_error * amplification(plan, true.columns)
                luck = 1.0 + np.where(true["row"] == first, error, -error)
                columns["rms"] = (true["rms"] * luck[:, None, None]).astype(np.float32)
            return columns

        return finished

    monkeypatch.setattr(crew, "begin", unlucky)
    chance_alone = run(replace(spec, goal=SweepGoal("rms", {"M_s": 5.0}, decide=0)), tmp_path / "alone")
    assert chance_alone.best(1)["row"][0] != first
    lines: list[str] = []
    found = run(spec, tmp_path / "run", told=lines.append)
    assert found.best(TOP)["row"].tolist() == exact.best(TOP)["row"].tolist()
    best = found.best(1)
    np.testing.assert_array_equal(best["rms"], exact.best(1)["rms"])
    assert best[IN_FLOAT64].all()
    (sentence,) = chance(found)
    assert "rows that float32 cannot decide were run once more in float64: 0 ended otherwise" in sentence
    assert [line for line in lines if "rows that float32 cannot decide" in line] == lines != []
    sweep_report(found, tmp_path / "report.html", curves=False)
    assert sentence in (tmp_path / "report.html").read_text()
    assert command("sweep", "best", tmp_path / "run", "-n", 1) == 0
    said = capsys.readouterr().out
    assert sentence in said
    assert f"\n{first} " in said


def test_a_dry_run_says_that_rows_may_run_once_more(spec: SweepSpec) -> None:
    assert "what float32 cannot decide, 1000 rows at most" in dry_run(spec, make_plan(spec), 2, measure=False)
    exact = replace(spec, precision="float64")
    assert "cannot decide" not in dry_run(exact, make_plan(exact), 2, measure=False)


def test_it_resumes_and_has_one_hash(tmp_path: Path) -> None:
    sweep = {**DATA["sweep"], "rows": 24, "best": "peak_error", "constraints": {}}
    spec, folder = SweepSpec.from_dict({**DATA, "sweep": sweep}), tmp_path / "run"
    found = run(spec, folder)
    assert found.decided is not None
    loaded = Result.load(folder)
    assert (loaded.hash, loaded.complete) == (found.hash, True)
    (again,) = (folder / "float64").iterdir()
    assert len(found.decided.after["row"]) > 8
    parts = run(spec, tmp_path / "parts", chunk=8)
    assert len(list((tmp_path / "parts" / "float64" / again.name / "chunks").iterdir())) > 1
    assert parts.hash == found.hash
    # Interrupted between two chunks of the rows in float64.
    sorted((tmp_path / "parts" / "float64" / again.name / "chunks").iterdir())[0].unlink()
    assert not Result.load(tmp_path / "parts").complete
    assert run(spec, tmp_path / "parts").hash == found.hash
    # Another ranking leaves other rows undecided; those of the first stay.
    other = replace(spec, goal=SweepGoal("chatter", {}))
    changed = run(other, folder)
    assert changed.hash != found.hash
    assert Result.load(folder).hash == changed.hash
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*.npz")}
    assert run(spec, folder).hash == found.hash
    assert {path: path.stat().st_mtime_ns for path in folder.rglob("*.npz")} == before


def test_what_takes_long_to_compile_is_readied_beside_the_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sweep = DATA["sweep"] | {"rows": 40}
    spec = SweepSpec.from_dict(DATA | {"sweep": sweep})
    plain, readied = run(spec, tmp_path / "plain"), []
    module = importlib.import_module("sweeps.run")
    monkeypatch.setattr(module, "compiles_long", lambda: True)
    monkeypatch.setattr(module, "baseline", lambda plan: readied.append(plan) or baseline(plan))
    assert run(spec, tmp_path / "few").hash == plain.hash
    assert [plan.canonical["precision"] for plan in readied] == ["float32"]
    readied.clear()
    monkeypatch.setattr("sweeps.decided.MANY", 40)
    assert run(spec, tmp_path / "many").hash == plain.hash
    first, last = readied
    assert (first.canonical["precision"], len(first.rows)) == ("float64", 1)
    assert last.canonical["precision"] == "float32"
    readied.clear()
    assert plain.decided is not None
    run(spec, tmp_path / "many")
    assert not readied, "what has been run once more needs nothing"


def test_the_most_important_run_where_they_are_too_many(spec: SweepSpec, single: Result, exact: Result) -> None:
    goal = SweepGoal("peak_error", {}, decide=3)
    result = on(goal, single)
    places = result.undecided()
    assert len(places) > 3
    again = plan_in_float64(result.plan, result.columns)
    assert again is not None
    assert again.rows.tolist() == sorted(result["row"][places[:3]].tolist())
    told = chance(completed(result, exact))
    assert [line.split(" rows")[0] for line in told] == ["3", str(len(completed(result, exact).undecided()))]
    for nothing in (on(replace_decide(goal, 0), single), on(goal, exact)):
        assert plan_in_float64(nothing.plan, nothing.columns) is None


def replace_decide(goal: SweepGoal, decide: int) -> SweepGoal:
    return SweepGoal(goal.best, goal.constraints, decide)


def made_up(columns: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """Rows of which every number is given, on one tissue."""
    rows = len(columns["rms"])
    full = {name: np.zeros((rows, 1, 3)) for name in METRICS}
    for name, values in columns.items():
        full[name] = np.reshape(values, (rows, 1, 1)) * np.ones(3) if name in METRICS else np.reshape(values, (rows, 1))
    return {**full, "row": np.arange(rows), IN_FLOAT64: np.zeros(rows, bool)}


def test_of_no_rows_none_is_undecided(single: Result) -> None:
    """As where every row was set aside."""
    nothing = single.take(slice(0))
    assert len(nothing.undecided()) == 0
    assert chance(nothing) == []


def test_what_counts_as_undecided(spec: SweepSpec) -> None:
    plan = replace(make_plan(spec), goal=SweepGoal("rms", {"M_s": 2.0}))
    limit = plan.canonical["experiment"]["force_limit"]
    OK, FORCE, UNSTABLE, DIVERGED = Status.OK, Status.FORCE_LIMIT, Status.UNSTABLE, Status.DIVERGED
    table = [
        # rms, M_s, status, peak force, clamped, place in the order
        (0.0200, 1.5, OK, 5.0, 0.0, 0),  # two that float32 cannot tell apart
        (0.0201, 1.5, OK, 5.0, 0.0, 1),
        (0.0300, 1.5, OK, 5.0, 0.0, None),  # alone
        (0.0199, 2.1, OK, 5.0, 0.0, None),  # beyond a margin, which is certain
        (0.0400, 1.5, OK, 0.99 * limit, 0.0, 2),  # near the limit of the force
        (0.0500, 1.5, FORCE, 1.01 * limit, 0.0, 3),
        (0.0600, 1.5, FORCE, 2.00 * limit, 0.0, None),  # far from it
        (0.0100, 1.5, OK, 5.0, 0.01, 4),  # a torque limit acts
        (np.nan, 1.5, DIVERGED, np.nan, np.nan, 6),
        (0.0150, 3.0, FORCE, 900.0, 0.5, 5),
        (np.nan, np.inf, UNSTABLE, np.nan, np.nan, None),
    ]
    rms, M_s, status, peak_force, clamped, order = zip(*table, strict=True)
    given = {"rms": rms, "M_s": M_s, "status": status, "peak_force": peak_force, "clamped": clamped}
    columns = made_up(given)
    found = undecided(plan, columns).tolist()
    wanted = sorted((place, row) for row, place in enumerate(order) if place is not None)
    assert found[:4] == [row for _, row in wanted][:4]
    assert set(found) == {row for _, row in wanted}
    assert found[4] == 7
    columns[IN_FLOAT64][:] = True
    assert undecided(plan, columns).tolist() == []


@pytest.mark.parametrize("reduction", [20.0, np.inf])
def test_rows_that_are_infinitely_good_are_decided(spec: SweepSpec, reduction: float) -> None:
    plan = replace(make_plan(spec), goal=SweepGoal("gain_reduction_db", {"chatter": 1.0}))
    columns = made_up({"rms": [0.02] * 3, "peak_force": [5.0] * 3, "chatter": [1.001, 0.999, 0.5], "M_s": [1.5] * 3})
    columns |= {"status": np.zeros((3, 1), np.int8), "gain_reduction_db": np.full((3, 1), reduction)}
    assert sorted(undecided(plan, columns).tolist()) == [0, 1]
    columns["gain_reduction_db"][:2] = -np.inf  # as of a loop that is lost
    assert undecided(plan, columns).tolist() == []


RAMPS: Any = (
    {"kind": "ramp", "to": -5.0, "rate": 10.0},
    {"kind": "hold", "duration": 1.0},
    {"kind": "ramp", "to": -2.0, "rate": 8.0},
)


@pytest.mark.parametrize(
    ("base", "axes"),
    [
        (-5.0, {"settle": [0.2, 0.3], "duration": [2.0, 1.5]}),
        (RAMPS, {"settle": {"linear": [0.5, 1.5], "points": 3, "relative": True}, "sampling_time": [0.002, 0.001]}),
        (RAMPS, {"reference.z": [-5.0, -2.0], "duration": [2.0, 3.0]}),
        (-5.0, {"reference.z": [[*RAMPS], [*RAMPS[:1]], -3.0], "reference.x": [1.0, 2.0], "lam": [0.1, 0.2]}),
    ],
    ids=["no ramp", "ramps", "numbers in place of ramps", "ramps among the choices"],
)
def test_the_scored_time_is_that_of_the_experiment(base: Any, axes: dict[str, Any]) -> None:
    experiment = {**DATA["experiment"], "duration": 2.0, "reference": {"z": base}}
    plan = make_plan(SweepSpec.from_dict({**DATA, "experiment": experiment, "sweep": {"kind": "grid", "axes": axes}}))
    columns = plan.space.columns(plan.rows) | {"row": plan.rows}
    result = Result(plan, columns)
    for place, found in enumerate(scored_time(plan, columns)):
        exact = result.experiment(place)
        assert found == pytest.approx(exact.scored[1].sum(axis=0).min() * exact.sampling_time, abs=0.009)


def test_older_folders_and_stages_go_on_where_nothing_is_decided() -> None:
    refine = {"method": "pareto", "rounds": 1, "points": 4}
    for more, there in (({}, True), ({"decide": 0}, False), ({"precision": "float64"}, False)):
        spec = SweepSpec.from_dict({**DATA, "sweep": {**DATA["sweep"], **more}, "refine": refine})
        assert ("decide" in described(spec)[0]["goal"]) == there


def test_the_bound_is_bounded() -> None:
    with pytest.raises(InputError, match=r"sweep\.decide"):
        SweepSpec.from_dict({**DATA, "sweep": {**DATA["sweep"], "decide": -1}})
