"""What trials come to, in the table of files and on the terminal, against plain formulas; no two fields are alike."""

import csv
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jaxmpc import Experiment, Params, Status
from jaxmpc.report.content import Table
from tuning.trials import HARD, Job, Outcomes
from tuning.trials.cli import _tables
from tuning.trials.outcomes import SWINGING
from tuning.trials.report import trials_report, write_csv

COUNT = 40
NAMES = "a,b", 'μ"<b>'
JOB = Job((Params(), Params.published("cautious")), Experiment.published("table-1-wam"), HARD)


@pytest.fixture
def found() -> Outcomes:
    """Of the first controller trials 3 and 7 are lost, by a status and by swinging on; 5 left 2 N; 9 swings."""
    random = np.random.default_rng(1)
    rms, true_rms, peak, swing = random.uniform(0.01, 0.09, (4, COUNT, 2, 3))
    flat = np.zeros((COUNT, 2))
    status, when, back = flat.astype(np.int8), flat + np.nan, flat + np.inf
    status[3, 0], when[3, 0], back[3:5, 1] = Status.FORCE_LIMIT, 4.25, 6.5
    rms[3, 0] = np.nan
    peak[[5, 7], 0, 2], swing[[7, 9], 0, 2] = (2.5, 2.6), 0.2
    status[7, 1] = Status.DIVERGED
    return Outcomes(status, when, random.uniform(0.9, 0.99, flat.shape), back, rms, true_rms, peak, swing, flat == 1.0)


def test_every_cell_of_the_table_stands_under_its_name(found: Outcomes, tmp_path: Path) -> None:
    drawn = JOB.drawn(0, COUNT)
    write_csv(tmp_path / "trials.csv", drawn, NAMES, found)
    with (tmp_path / "trials.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == COUNT

    def number(text: str) -> float:
        return float(text or "nan")

    for i, row in enumerate(rows):
        own = [("mass_error [-]", drawn.mass_error[i]), ("cable [Hz]", drawn.cable_hz[i])]
        own += [("stiffness [N/m]", drawn.stiffness[i]), ("cable_damping [-]", drawn.cable_damping[i])]
        own += [(f"friction_J{j + 1} [-]", drawn.friction[i, j]) for j in range(4)]
        for c, name in enumerate(NAMES):
            finite = np.where(np.isinf(found.backed_off), np.nan, found.backed_off)
            of = {"when [s]": found.when, "backed_off [s]": finite, "spectral_radius [-]": found.spectral_radius}
            own += [(f"{name}: {column}", field[i, c]) for column, field in of.items()]
            for field in ("rms", "true_rms", "peak_error", "swing"):
                values = getattr(found, field)[i, c]
                own += [(f"{name}: {field}_{axis} [N]", value) for axis, value in zip("xyz", values, strict=True)]
            assert row[f"{name}: status"] == Status(int(found.status[i, c])).name
        for column, value in own:
            np.testing.assert_allclose(number(row[column]), value, rtol=1e-6, err_msg=column)
        assert (row["trial"], row["motion"], row["delay [samples]"]) == (str(i), drawn.motion[i], str(drawn.delay[i]))
        assert row["motion_seed"] == str(drawn.motion_seed[i])
    for verdict, trials in (("lost", {3, 7}), ("left 2 N", {5}), ("swinging", {7, 9})):
        assert {i for i, row in enumerate(rows) if row[f"{NAMES[0]}: {verdict}"] == "1"} == trials
    write_csv(tmp_path / "stiff.csv", drawn._replace(cable_hz=0.0 * drawn.cable_hz), NAMES, found)
    with (tmp_path / "stiff.csv").open(encoding="utf-8") as file:
        assert {(row["cable [Hz]"], row["cable_damping [-]"]) for row in csv.DictReader(file)} == {("", "")}


def test_what_is_printed_is_what_plain_formulas_say(found: Outcomes, capsys: pytest.CaptureFixture[str]) -> None:
    told = _tables(JOB, list(NAMES), found)
    rows = [row[2:] for row in told.rows]
    for hits, row in zip((2, 1, 2, 1, 0, 0), rows, strict=True):
        z, share = 1.959963984540054, hits / COUNT
        middle, half = share + z * z / (2 * COUNT), z * math.sqrt(share * (1 - share) / COUNT + (z / (2 * COUNT)) ** 2)
        ends = [100 * max(0.0, end) / (1 + z * z / COUNT) for end in (middle - half, middle + half)]
        assert row[:3] == [str(hits), f"{100 * share:.2f}", f"{ends[0]:.3f}–{ends[1]:.3f}"]
        assert row[3] == f"{hits} of 24"
    said = capsys.readouterr().out
    assert f"{NAMES[0]} lost: FORCE_LIMIT 1, |e| ≥ 2 N in a loop that is unstable or grows 1\n" in said
    assert f"both 1, only {NAMES[0]} 1, only {NAMES[1]} 0, neither 38" in said

    def worst(field: np.ndarray, c: int) -> list[float]:
        return sorted(np.inf if math.isnan(max(each)) else max(each) for each in field[:, c].tolist())

    for c, name in enumerate(NAMES):
        figures = next(line for line in said.splitlines() if re.match(rf" {re.escape(name)} +\d\.\d+ ", line))
        wanted: list[Any] = [worst(found.rms, c)[19], worst(found.true_rms, c)[19], worst(found.peak_error, c)[38]]
        wanted += [worst(found.peak_error, c)[39], worst(found.swing, c)[19], worst(found.swing, c)[37]]
        assert figures.removeprefix(f" {name}").split()[:6] == [f"{value:.3f}" for value in wanted]
    for kind, field in (("RMS", found.rms), ("true RMS", found.true_rms)):
        lower = sorted(100 * (1 - max(a) / max(b)) for i, (a, b) in enumerate(field.tolist()) if i not in {3, 7})
        middle = 0.5 * (lower[18] + lower[19])
        assert (
            f"{kind} of the worst axis, in the 38 trials where neither is, lower than with {NAMES[1]}: median " in said
        )
        assert re.search(rf"^{kind} .*: median {middle:.0f} %", said, re.M)


def test_rows_of_the_report_are_of_their_fields(found: Outcomes) -> None:
    drawn = JOB.drawn(0, COUNT)
    report = trials_report(JOB, drawn, NAMES, found, Table(("",), []))
    assert report.rows is not None
    by_name = {each.name: each for each in report.rows.measures}
    np.testing.assert_array_equal(by_name["lost"].values, found.lost)
    np.testing.assert_array_equal(by_name["spectral_radius"].values, found.spectral_radius)
    np.testing.assert_array_equal(report.rows.status, found.status)
    for field in ("rms", "true_rms", "swing"):
        np.testing.assert_allclose(by_name[field].values, 1e3 * getattr(found, field).max(axis=-1))
    peaks = report.sections[0].charts[0].series[0]
    for value, share in zip(peaks.x, peaks.y, strict=True):
        assert share == pytest.approx(np.mean(found.peak_error[:, 0].max(axis=-1) > value))
    still = drawn._replace(delay=0 * drawn.delay + 1)
    shown = trials_report(JOB, still, NAMES, found, Table(("",), [])).rows
    assert shown is not None
    assert "delay" not in {each.name for each in shown.measures}


def test_a_swing_is_beyond_its_bound_and_a_guard_that_acted_was_not_at_rest() -> None:
    assert SWINGING == 0.1
    at, flat = np.full((1, 1, 3), SWINGING), np.zeros((1, 1))
    found = Outcomes(flat, flat, flat, np.full((1, 1), 6.5), at, at, at, at, flat == 1.0)
    assert not found.swinging.any()
    assert not found.at_rest.any()
    assert found._replace(backed_off=flat + np.inf).at_rest.all()
