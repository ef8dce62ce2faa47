"""The table of quantities: nothing that is computed lacks a row, and no row lacks a reader."""

import math
from argparse import ArgumentParser
from dataclasses import fields
from pathlib import Path

import jax.numpy as jnp
import pytest

from deploy.controller.margin_floor import check, plain_floor
from jaxmpc import Experiment, Params
from jaxmpc.cli import main
from jaxmpc.cli.freeze import configure
from jaxmpc.closed_loops import Outcome
from jaxmpc.files.errors import InputError
from jaxmpc.metrics import Metrics
from jaxmpc.quantities import FILTERS, FLOOR_FLAGS, MARGINS, METRICS, PARAMETERS, Quantity
from jaxmpc.stability import Margins
from jaxmpc.synthesis.structure import STRUCTURE
from jaxmpc.terminal.tables import RESIDUAL_HEADER, metric_rows, residual_rows
from sweeps.plan import make_plan
from sweeps.spec import SweepSpec
from tuning import TuneSpec
from tuning.job.goals import GOALS, MEASURED, margin_goals, run_goals
from tuning.job.space import FREE, axis_of
from tuning.objective.measures import SPECTRAL

EVERY = {**METRICS, **MARGINS, **PARAMETERS}


def test_everything_computed_has_a_row_and_the_other_way_round() -> None:
    assert tuple(METRICS) == Metrics._fields
    assert (*MARGINS, "status") == Margins._fields
    assert (*PARAMETERS, *STRUCTURE, "knots") == tuple(field.name for field in fields(Params))
    assert len(EVERY) == len(METRICS) + len(MARGINS) + len(PARAMETERS)


@pytest.mark.parametrize("row", EVERY.values(), ids=EVERY)
def test_a_row_says_what_its_readers_need(row: Quantity) -> None:
    assert row.unit
    assert row.text
    assert row.symbol
    assert row.heading
    assert row.label.endswith(f"[{row.unit}]")
    assert (row.sense == "none") == (row.name in PARAMETERS)


@pytest.mark.parametrize(
    ("name", "limit", "bound"),
    [
        ("M_s", -1.0, "1"),
        ("M_s", 1.0, "1"),
        ("gain_margin_db", -3.0, "0 dB"),
        ("phase_margin_deg", 200.0, "0°( on)?, at most 180°"),
        ("spectral_radius", 1.5, "0( on)?, at most 1"),
        ("rms", -0.1, "0 N"),
        ("clamped", 1.5, "0( on)?, at most 1"),
        ("effort", math.inf, "0 m/s²"),
    ],
)
def test_a_limit_that_nothing_can_keep_or_nothing_can_miss_is_refused(
    name: str, limit: float, bound: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    experiment = {"published": "table-1-wam"}
    for make, table in (
        (TuneSpec, {"goals": {name: limit}}),
        (TuneSpec, {"pareto": {name: [limit]}}),
        (SweepSpec, {"sweep": {"kind": "grid", "axes": {"lam": [0.1]}, "constraints": {name: limit}}}),
    ):
        with pytest.raises(InputError, match=rf"{name} = {limit}: must be a number (above|from) {bound}"):
            make.from_dict({"experiment": experiment, **table})
    if name in FLOOR_FLAGS:
        assert main(["freeze", "text", FLOOR_FLAGS[name], f"{limit}", "-o", f"{tmp_path / 'a.npz'}"]) == 2
        assert f"{FLOOR_FLAGS[name]} = {limit}: must be" in capsys.readouterr().err


def test_what_a_limit_may_be() -> None:
    """None of the samples may be clamped; of a ratio to another's a tune may ask for more than 1."""
    axes = {"kind": "grid", "axes": {"lam": [0.1]}}
    SweepSpec.from_dict(
        {"experiment": {"published": "table-1-wam"}, "sweep": {**axes, "constraints": {"clamped": 0.0}}}
    )
    TuneSpec.from_dict({"experiment": {"published": "table-1-wam"}, "goals": {"clamped_ratio": 1.5, "clamped": 1.0}})


def test_parameters_can_be_searched_and_swept() -> None:
    base = Params()
    for name, row in PARAMETERS.items():
        (low, high), (least, most, scale) = row.bounds, row.search
        assert low <= least < most <= high
        assert scale > 0.0
        assert (name in FILTERS) == (name not in base.numbers)
        assert least <= float(base.numbers.get(name, least)) <= most
        assert (name in FREE) == row.free
        assert axis_of(name, None, diagonal=bool(row.entries)).length == row.entries
        swept = [value for value in (least, most) if name != "Hu" or value <= float(base.Hp)]
        # Ideal damping has no filter to sweep.
        data = {"experiment": {"damping": "sampled"}, "sweep": {"kind": "grid", "axes": {name: swept}}}
        SweepSpec.from_dict(data)


def test_metrics_and_margins_can_be_goals() -> None:
    hard = {**dict.fromkeys(MARGINS, 1.5), **dict.fromkeys(METRICS, 1.0), "spectral_radius": 0.99}
    goals = {**hard, "soft": dict.fromkeys(METRICS, 1.0)}
    spec = TuneSpec.from_dict({"experiment": {"published": "table-1-wam"}, "goals": goals})
    assert {*spec.margin_goals, *spec.hard_goals} == {*MARGINS, *METRICS}
    assert set(METRICS) < set(MEASURED) < set(GOALS)
    assert set(SPECTRAL) == {name for name, row in METRICS.items() if row.spectral}
    cells = Metrics(*(jnp.full((1, 1, 3), 1.0 + i) for i in range(len(METRICS))))
    for name in MEASURED:
        whole = run_goals(cells, cells, jnp.ones(1), {name: 1.0})[name]
        assert jnp.isfinite(whole).all()
    for name, row in MARGINS.items():
        better = {other: jnp.array([0.5]) for other in MARGINS} | {name: jnp.array([0.8 if row.ceiling else 1.25])}
        found = margin_goals(Margins(**better, status=jnp.zeros(1)), {name: 1.0})
        assert float(found.normalised[0, 0]) == pytest.approx(0.8)


def test_goals_stand_in_the_manual() -> None:
    manual = (Path(__file__).parents[1] / "docs" / "tuning.md").read_text(encoding="utf-8")
    assert {name for name in {**METRICS, **MARGINS} if f"`{name}`" not in manual} == set()


def test_every_margin_has_a_flag_of_freeze() -> None:
    assert set(FLOOR_FLAGS) == set(MARGINS)
    parser = ArgumentParser()
    configure(parser)
    floor = [word for flag in FLOOR_FLAGS.values() for word in (flag, "1.5")]
    given = vars(parser.parse_args(["text", *floor]))
    assert {name: given[name] for name in MARGINS} == dict.fromkeys(MARGINS, 1.5)


@pytest.mark.parametrize("name", MARGINS)
def test_margins_can_be_promised(name: str) -> None:
    row = {"stiffness": 375.0, **dict.fromkeys(MARGINS, 0.5)}
    bound = 0.5 * (0.999 if MARGINS[name].ceiling else 1.001)
    check([row], plain_floor({name: 0.5}))
    with pytest.raises(InputError, match=name):
        check([row], plain_floor({name: bound}))


def test_metrics_and_margins_are_columns_of_a_sweep() -> None:
    plan = make_plan(SweepSpec.from_dict({"sweep": {"kind": "grid", "axes": {"lam": [0.1, 0.2]}}}))
    tissues = len(plan.stiffness)
    assert {name: plan.layout[name].shape for name in METRICS} == dict.fromkeys(METRICS, (tissues, 3))
    assert {name: plan.layout[name].shape for name in MARGINS} == dict.fromkeys(MARGINS, (tissues,))


def test_metrics_and_margins_are_in_the_tables() -> None:
    experiment = Experiment.published("table-1")
    tissues = len(experiment.stiffness)
    metrics = Metrics(*(jnp.ones((tissues, 3)) for _ in Metrics._fields))
    margins = Margins(*(jnp.ones(tissues) for _ in Margins._fields))
    outcome = Outcome(metrics, margins, jnp.zeros(tissues), jnp.zeros(tissues), None)
    assert [row[0] for row in metric_rows(outcome, experiment)] == [row.heading for row in METRICS.values()]
    cells = {name: row[1:] for name, row in zip(METRICS, metric_rows(outcome, experiment), strict=True)}
    none = {name for name, row in cells.items() if set(row) == {"– / – / –"}}
    assert none == {"clamped", "joint_torque", "torque_step"}, "the linear loop has no joints"
    on_arm = Experiment.published("table-1-wam")
    assert not any("–" in cell for row in metric_rows(outcome, on_arm) for cell in row)
    assert {row.heading for row in MARGINS.values()} < set(RESIDUAL_HEADER)
    assert {len(row) for row in residual_rows("text", outcome, experiment)} == {len(RESIDUAL_HEADER)}
