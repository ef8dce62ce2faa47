"""The report's file and its numbers, without a browser."""

import base64
import hashlib
import json
import re
import zlib
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jaxmpc.quantities import MARGINS, METRICS, PARAMETERS, Sense
from jaxmpc.report.content import Measure, Report, measure
from jaxmpc.report.influence import crossed, first_order, influence, stretches
from jaxmpc.report.page import page, write_report
from jaxmpc.report.payload import payload, quantised
from jaxmpc.report.thinning import thinned
from tests.report.made_up import FOREIGN, candidates, report

VENDOR = Path(__file__).parents[2] / "jaxmpc" / "report" / "vendor"


class Seen(HTMLParser):
    """Elements and their attributes, as a browser would take them."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.scripts: list[str] = []
        self.open: list[str] = []
        self.texts = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        assert tag not in ("link", "iframe", "img", "object", "embed", "base")
        for key, value in attrs:
            assert not key.startswith("on")
            assert not key.endswith(("href", "src"))
            assert "://" not in str(value)
        if tag != "meta":
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open[-1:] == ["script"]:
            self.scripts.append(data)
        else:
            self.texts += data


def test_the_page_is_whole_and_runs_its_own_script_alone() -> None:
    text = page(report(50))
    seen = Seen(text)
    assert seen.open == []
    data, script = seen.scripts
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', text)
    assert policy is not None
    assert "default-src &#x27;none&#x27;" in policy[1]
    assert base64.b64encode(hashlib.sha256(script.encode()).digest()).decode() in policy[1]
    assert "unsafe" not in policy[1]
    assert re.fullmatch(r"[A-Za-z0-9+/]*=*", data)
    assert FOREIGN in seen.texts
    assert "<img" not in text.replace(script, "")


def test_the_same_result_gives_the_same_bytes() -> None:
    assert page(report(50)) == page(report(50))
    assert page(report(50)) != page(report(50, seed=1))


def decoded(said: dict[str, Any], blob: bytes) -> np.ndarray:
    """An array of the payload, read as the page does."""
    planes = np.frombuffer(zlib.decompress(blob[said["at"] : said["at"] + said["bytes"]]), np.uint8)
    kind = np.dtype({"u8": "u1", "u16": "<u2", "u32": "<u4", "f64": "<f8"}[said["type"]])
    return np.ascontiguousarray(planes.reshape(kind.itemsize, -1).T).view(kind).ravel()


def test_a_page_is_written_wherever_its_path_says(tmp_path: Path) -> None:
    write_report(report(5), f"{tmp_path}/mine.html")
    assert (tmp_path / "mine.html").read_text() == page(report(5))


def test_few_rows_keep_every_bit() -> None:
    rows = candidates(300)
    data = payload(Report("title", rows=rows))
    size = int.from_bytes(data[:4], "little")
    said, blob = json.loads(zlib.decompress(data[4 : 4 + size])), data[4 + size :]
    for each, found in zip(rows.measures, said["rows"]["measures"], strict=True):
        flat = decoded(found["points"], blob)[decoded(found["index"], blob)] if "points" in found else None
        values = decoded(found["values"], blob) if flat is None else flat
        np.testing.assert_array_equal(values, each.values.T.ravel())


@pytest.mark.parametrize("positive", [True, False])
def test_many_rows_are_near(positive: bool) -> None:
    random = np.random.default_rng(3)
    values = np.exp(random.uniform(-9.0, 9.0, 5000)) if positive else random.normal(0.0, 3.0, 5000)
    values[:4] = [np.nan, np.inf, -np.inf, values[5]]
    codes = []
    scale = quantised(values, type("Takes", (), {"add": lambda _, found: codes.append(found)})())["scale"]
    share = codes[0].astype(float) / (scale["levels"] - 1)
    found = scale["low"] + share * (scale["high"] - scale["low"])
    found = np.exp(found) if scale["log"] else found
    finite = np.isfinite(values)
    # Half a step of 65,532: of the range, or of its logarithm.
    step = (scale["high"] - scale["low"]) / (scale["levels"] - 1) / 2
    error = np.abs(np.log(found / values, where=finite, out=np.zeros(5000)) if positive else found - values)[finite]
    assert error.max() <= 1.0001 * step
    assert codes[0][:3].tolist() == [65535, 65534, 65533]


def test_measures_are_in_the_units_of_tables() -> None:
    cells = np.array([[[0.01, 0.03, 0.02]], [[np.nan, 0.01, 0.01]]])
    rms = measure(METRICS["rms"], cells, limit=0.02)
    assert rms.worst.tolist()[0] == 30.0
    assert np.isnan(rms.worst[1])
    assert (rms.unit, rms.limit) == ("mN", 20.0)
    assert rms.kept.tolist() == [False, False]
    delay = measure(MARGINS["delay_margin_s"], [[0.002, 0.001]], limit=0.001)
    assert (delay.unit, delay.worst.tolist(), delay.kept.tolist()) == ("ms", [1.0], [True])
    assert measure(MARGINS["M_s"], [[np.inf, 1.0]], limit=np.inf).limit is None
    assert measure(PARAMETERS["Hp"], [5.0]).whole


def test_importance_is_that_of_the_ishigami_function() -> None:
    random = np.random.default_rng(0)
    x = random.uniform(-np.pi, np.pi, (40_000, 3))
    y = np.sin(x[:, 0]) + 7.0 * np.sin(x[:, 1]) ** 2 + 0.1 * x[:, 2] ** 4 * np.sin(x[:, 0])
    parameters = [Measure(f"x{k}", "", "-", "", x[:, k], "parameter") for k in range(3)]
    shares = influence(parameters, [Measure("y", "", "-", "", y, "metric")])["y"][:, 0]
    # Known in closed form; 32 stretches blur a sine by some per cent of its share, 40,000 rows by half a per cent.
    np.testing.assert_allclose(shares, [0.3139, 0.4424, 0.0], atol=0.012)


def test_what_explains_nothing_gets_nothing() -> None:
    random = np.random.default_rng(1)
    score = random.normal(size=2000)
    found = [first_order(stretches(random.uniform(size=2000)), score) for _ in range(50)]
    # Without the correction chance alone would give 31/2000 = 0.016 on average.
    assert np.mean(found) < 0.006
    assert first_order(stretches(np.arange(20.0)), np.ones(20)) == 0.0


def test_shares_of_a_whole_grid_are_those_of_its_own_analysis_of_variance() -> None:
    """In a grid whatever else is swept averages out: sums of squares of a sum of two functions add up to the whole."""
    a, b, twice = (each.ravel() for each in np.meshgrid([0.0, 1.0], [0.0, 1.0, 4.0], [0, 1], indexing="ij"))
    y = np.exp(0.2 * a + b)
    measures = [Measure(name, "", "-", "", values, "parameter") for name, values in (("a", a), ("b", b), ("c", twice))]
    shares = influence(measures, [Measure("y", "", "-", "", y, "metric")])["y"][:, 0]
    variances = np.array([np.var(0.2 * np.array([0.0, 1.0])), np.var([0.0, 1.0, 4.0]), 0.0])
    np.testing.assert_allclose(shares, variances / variances.sum(), atol=1e-12)
    assert crossed([a, b, twice])
    assert crossed([a, 2.0 * a, b, twice])
    assert not crossed([a[1:], b[1:], twice[1:]])
    assert not crossed([np.arange(12.0), b])
    assert not crossed([np.append(each, each[:1]) for each in (a, b)]), "one of the grid's rows is there once more"


def test_rows_without_a_finite_value_count_as_bad() -> None:
    x = np.repeat([0.0, 1.0], 100)
    lost = Measure("rms", "", "-", "", np.where(x > 0.5, np.nan, 1.0 + 0.001 * np.arange(200.0)), "metric", "ceiling")
    share = influence([Measure("x", "", "-", "", x, "parameter")], [lost])["rms"][0, 0]
    assert share > 0.9


@pytest.mark.parametrize("sense", ["ceiling", "floor"])
@pytest.mark.parametrize("level", [-2.0, 2.0])
def test_what_is_lost_is_worse_than_the_worst_of_either_sign(sense: Sense, level: float) -> None:
    """A quarter is lost: a value on the other side of the worst would cancel the difference."""
    x, good = np.repeat([0.0, 1.0], 100), level + (0.2 if sense == "floor" else -0.2)
    found = np.where(x > 0.5, level, good)
    found[100:150] = np.nan
    rows = [Measure("x", "", "-", "", x, "parameter")]
    share = influence(rows, [Measure("value", "", "-", "", found, "metric", sense)])["value"][0, 0]
    beyond = 2.0 * level if (sense == "floor") == (level < 0.0) else 0.5 * level
    scored = np.where(np.isnan(found), beyond, found)
    scored = np.log(scored) if level > 0.0 else scored
    groups = [scored[:100].mean(), scored[100:].mean()]
    assert share == pytest.approx(np.var(groups) / np.var(scored), abs=0.02)


def test_no_peak_is_thinned_out_and_a_gap_stays_one() -> None:
    x, y = np.arange(10_000.0), np.sin(np.arange(10_000.0))
    y[4321], y[8765], y[2000:2100] = 9.0, -9.0, np.nan
    across, found = thinned(x, y, 200)
    assert len(found) < 220
    assert np.all(np.diff(across) >= 0.0)
    assert {9.0, -9.0} <= {*found.tolist()}
    assert np.isnan(found[(across >= 2000.0) & (across < 2100.0)]).any()
    assert across[-1] == x[-1]


def test_the_library_and_its_licences_are_there() -> None:
    readme = (VENDOR / "README.md").read_text()
    library = (VENDOR / "echarts.min.js").read_bytes()
    assert hashlib.sha256(library).hexdigest() in readme
    for name in ("echarts", "zrender", "d3", "tslib"):
        assert (VENDOR / f"LICENSE-{name}").stat().st_size > 500
    # Nothing that a strict policy would refuse, nowhere to phone.
    assert b"new Function" not in library
    assert set(re.findall(rb"\w+(?=://)", library)) <= {b"image", b"path"}
