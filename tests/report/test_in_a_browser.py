"""The report in a real browser: offline, safe, quick, and its views say what numpy says."""

import tomllib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from jaxmpc.report.content import Candidates
from jaxmpc.report.page import write_report
from tests.report.browser import Opened, opened
from tests.report.made_up import SWEPT, candidates, report

FEW, MANY = 3_000, 100_000
ASSETS = Path(__file__).parents[2] / "jaxmpc" / "report" / "assets"


@pytest.fixture(scope="module")
def rows() -> Candidates:
    return candidates(FEW)


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("small") / "report.html"
    write_report(report(FEW), path)
    return path


@pytest.fixture(scope="module")
def chrome(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Opened]:
    with opened(tmp_path_factory.mktemp("profile")) as found:
        yield found


def worst(rows: Candidates, name: str) -> np.ndarray:
    return next(each.worst for each in rows.measures if each.name == name)


def test_a_hundred_thousand_rows(chrome: Opened, tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    write_report(report(MANY), path)
    assert path.stat().st_size < 12e6
    assert chrome.open(path) < 10_000
    assert chrome.shown()[0] == MANY
    rail = chrome.page.locator(".rail").nth(1)
    rail.focus()
    answers = []
    for key in ("ArrowUp", "ArrowUp", "ArrowDown", "ArrowUp", "ArrowDown"):
        # From the key to the frame that shows what is left.
        answers.append(
            chrome.page.evaluate(
                """(key) => new Promise((done) => {
                    const began = performance.now();
                    document.activeElement.dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true }));
                    requestAnimationFrame(() => requestAnimationFrame(() => done(performance.now() - began)));
                })""",
                key,
            )
        )
        chrome.page.wait_for_timeout(400)
    assert 0 < chrome.shown()[0] < MANY
    # Others may use the machine: the least is what an answer costs.
    assert min(answers) < 200, answers
    assert (chrome.said, chrome.asked) == ([], [path.as_uri()])


@pytest.mark.parametrize(("dark", "width"), [(False, 1400), (True, 800), (False, 420)])
def test_it_fits_and_is_drawn(dark: bool, width: int, chrome: Opened, small: Path) -> None:
    page = chrome.page
    page.emulate_media(color_scheme="dark" if dark else "light")
    page.set_viewport_size({"width": width, "height": 900})
    chrome.said.clear()
    chrome.asked.clear()
    chrome.open(small)
    page.locator("button", has_text="row 0").first.click()
    page.wait_for_timeout(500)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    # A view that stood alone while it was drawn is as narrow as its column; parallel axes alone may scroll.
    wide = """() => [...document.querySelectorAll(".chart")].filter((box) =>
        [...box.querySelectorAll("canvas")].some((canvas) => canvas.clientWidth > box.clientWidth)).length"""
    assert page.evaluate(wide) == 0
    ground = page.evaluate("getComputedStyle(document.body).backgroundColor")
    assert ground == ("rgb(21, 24, 28)" if dark else "rgb(255, 255, 255)")
    # Lines, four views, the three charts of the section, the two of the row.
    painted = page.evaluate(
        """() => [...document.querySelectorAll(".stage, .chart")].map((box) =>
            [...box.querySelectorAll("canvas")].some((canvas) => {
                const data = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
                return new Set(new Uint32Array(data.buffer)).size > 8;
            }))"""
    )
    assert painted == [True] * (1 + 4 + 3 + 2)
    # Chromium advises on how to ask for so many pixels.
    assert [line for line in chrome.said if "willReadFrequently" not in line] == []
    assert chrome.asked == [small.as_uri()]
    page.emulate_media(color_scheme="light")
    page.set_viewport_size({"width": 1400, "height": 900})


def test_what_is_printed_from_a_dark_screen_can_be_read(chrome: Opened, small: Path) -> None:
    page = chrome.page
    page.emulate_media(color_scheme="dark")
    chrome.open(small)
    page.emulate_media(media="print", color_scheme="dark")
    # Text is dark on white paper; pictures stay as they are, on a ground of their own.
    assert page.evaluate("getComputedStyle(document.body).color") == "rgb(31, 35, 41)"
    grounds = page.evaluate(
        """() => [...document.querySelectorAll(".stage, .chart")].map((box) => {
            const canvas = box.querySelector("canvas");
            return [...canvas.getContext("2d").getImageData(1, canvas.height - 2, 1, 1).data]; })"""
    )
    assert grounds == [[21, 24, 28, 255]] * (1 + 4 + 3)
    page.emulate_media(media="screen", color_scheme="light")


def test_stability_over_controllers_names_no_tissue(chrome: Opened, tmp_path: Path) -> None:
    path, made = tmp_path / "trials.html", report(FEW)
    assert made.rows is not None
    write_report(replace(made, rows=replace(made.rows, group="controller")), path)
    chrome.open(path)
    part = chrome.page.locator("section", has=chrome.page.locator("h2", has_text="Stability over controller"))
    said = part.inner_text() + str(part.locator("[role=img]").get_attribute("aria-label"))
    assert "stable for a controller" in said
    assert "tissue" not in said


def test_foreign_text_stays_text(chrome: Opened, small: Path) -> None:
    chrome.open(small)
    page = chrome.page
    chrome.said.clear()
    page.locator("button", has_text="row 0").first.click()
    page.wait_for_timeout(300)
    assert page.locator("img").count() == 0
    assert "</script><img src=x" in page.inner_text("h1")
    # The policy holds: a script that gets in does not run, and no image is fetched.
    page.evaluate(
        """() => {
            document.body.append(Object.assign(document.createElement("script"), { textContent: "window.ran = 1" }));
            document.body.append(Object.assign(document.createElement("img"), { src: "https://example.org/x.png" }));
        }"""
    )
    page.wait_for_timeout(200)
    assert page.evaluate("window.ran") is None
    refused = [line for line in chrome.said if "Content Security Policy" in line]
    assert {word for word in ("inline script", "image") for line in refused if word in line} == {
        "inline script",
        "image",
    }
    chrome.said.clear()


def test_a_brush_leaves_what_lies_within(chrome: Opened, small: Path, rows: Candidates) -> None:
    chrome.open(small)
    rail = chrome.page.locator('.rail[data-name="T_cl"]')
    box = rail.bounding_box()
    x, top = box["x"] + box["width"] / 2, box["y"]
    chrome.page.mouse.move(x, top + 200)
    chrome.page.mouse.down()
    chrome.page.mouse.move(x, top + 120)
    chrome.page.mouse.move(x, top + 60)
    chrome.page.mouse.up()
    low, high = (float(part) for part in rail.get_attribute("aria-valuetext").split(" to "))
    T_cl = worst(rows, "T_cl")
    # The ends are told with three digits.
    least = ((T_cl > 1.01 * low) & (T_cl < 0.99 * high)).sum()
    most = ((T_cl > 0.99 * low) & (T_cl < 1.01 * high)).sum()
    assert 0 < least <= chrome.shown()[0] <= most < FEW
    rail.dblclick()
    assert chrome.shown() == (FEW, rows.feasible.sum())


def test_the_table_sorts_and_filters(chrome: Opened, small: Path, rows: Candidates) -> None:
    chrome.open(small)
    page, rms = chrome.page, worst(rows, "rms")
    page.fill('input[aria-label^="filter of lam"]', "0.1..1")
    within = (worst(rows, "lam") >= 0.1) & (worst(rows, "lam") <= 1.0)
    assert chrome.shown() == (within.sum(), (within & rows.feasible).sum())
    page.fill('input[aria-label^="filter of Hp"]', ">=20")
    within &= worst(rows, "Hp") >= 20
    page.wait_for_timeout(300)
    order = [place for place in np.argsort(rms, kind="stable") if within[place] and np.isfinite(rms[place])]
    first = [int(line.get_attribute("data-row")) for line in page.locator("tbody tr[data-row]").all()]
    assert first == order[: len(first)]
    page.locator("th button", has_text="RMS [mN]").first.click()
    page.wait_for_timeout(100)
    assert int(page.locator("tbody tr[data-row]").first.get_attribute("data-row")) == order[-1]
    page.locator("button", has_text="Clear filters").click()
    assert chrome.shown()[0] == FEW


def test_another_tissue_and_another_limit_judge_anew(chrome: Opened, small: Path, rows: Candidates) -> None:
    chrome.open(small)
    M_s = next(each for each in rows.measures if each.name == "M_s")
    chrome.page.select_option(".top select", "0")
    assert chrome.shown()[1] == ((rows.status[:, 0] == 0) & (M_s.values[:, 0] <= 2.0)).sum()
    chrome.page.fill(".top input", "1.5")
    chrome.page.locator(".top input").dispatch_event("change")
    assert chrome.shown()[1] == ((rows.status[:, 0] == 0) & (M_s.values[:, 0] <= 1.5)).sum()


def test_a_row_that_did_not_end_well_keeps_no_limit(chrome: Opened, tmp_path: Path) -> None:
    """Green words said that a row which had diverged keeps every limit: of M_s, say, the only one there was."""
    made = report(5)
    assert made.rows is not None
    status = np.zeros((5, 3), np.uint8)
    status[1, 2] = 2
    measures = [replace(each, values=np.full((5, 3), 1.5)) if each.limit else each for each in made.rows.measures]
    path = tmp_path / "report.html"
    write_report(replace(made, rows=replace(made.rows, status=status, measures=measures)), path)
    chrome.open(path)
    told = []
    for row in (0, 1):
        chrome.page.locator(f"tr[data-row='{row}']").click()
        chrome.page.wait_for_timeout(100)
        verdict = chrome.page.locator("h3 + p.good, h3 + p.bad")
        told.append((verdict.get_attribute("class"), verdict.inner_text()))
    assert told == [("good", "keeps every limit"), ("bad", "is not OK")]


def test_the_toml_of_a_row_has_every_bit(chrome: Opened, small: Path, rows: Candidates) -> None:
    chrome.open(small)
    sight = chrome.page.locator(".sight")
    sight.focus()
    sight.press("Home")
    sight.press("ArrowDown")
    row = int(chrome.page.locator("tr[aria-selected=true]").get_attribute("data-row"))
    with chrome.page.expect_download() as download:
        chrome.page.click("#save-toml")
    assert download.value.suggested_filename == "params.toml"
    text = Path(download.value.path()).read_text()
    assert text.startswith(f"# row {3 * row}\n")
    found = tomllib.loads(text)["params"]
    assert {name: found[name] for name in SWEPT} == {name: worst(rows, name)[row] for name in SWEPT}
    assert type(found["Hp"]) is int
    assert type(found["K2"]) is float


@pytest.mark.parametrize(
    ("goals", "endless"),
    [
        (("rms", "M_s"), False),
        (("rms", "gain_margin_db", "chatter"), False),
        (("rms", "gain_margin_db", "chatter"), True),
        (("gain_margin_db", "rms"), True),
    ],
)
def test_the_front_is_the_one_of_brute_force(
    goals: tuple[str, ...], endless: bool, chrome: Opened, rows: Candidates
) -> None:
    few = 400
    # Few distinct values, so that there are ties of every kind.
    columns = [np.round(worst(rows, name)[:few], 1 if name == "M_s" else 0) for name in goals]
    floors = [next(each.sense for each in rows.measures if each.name == name) == "floor" for name in goals]
    if endless:  # a loop that no lower or higher gain makes unstable has the best of margins
        columns = [
            np.where(c >= np.nanquantile(c, 0.8), np.inf, c) if f else c for c, f in zip(columns, floors, strict=True)
        ]
    takes = rows.feasible[:few]
    chrome.page.goto("about:blank")
    source = (ASSETS / "state.js").read_text()
    call = f"(([goals, takes]) => {{ {source}\nreturn paretoFront(goals, takes); }})"
    given = [[[None if np.isnan(x) else x for x in c], f] for c, f in zip(columns, floors, strict=True)]
    found = chrome.page.evaluate(call, [given, takes.astype(int).tolist()])
    costs = np.stack([-c if floor else c for c, floor in zip(columns, floors, strict=True)], axis=1)
    able = np.flatnonzero(takes & (costs < np.inf).all(axis=1))
    assert np.isneginf(costs[able]).any() == endless
    beaten = [((costs[able] <= costs[i]).all(axis=1) & (costs[able] < costs[i]).any(axis=1)).any() for i in able]
    assert sorted(found) == able[~np.array(beaten)].tolist()
    assert 2 < len(found) < len(able)


@pytest.mark.parametrize("share", [1.0, 0.3])
def test_a_margin_without_end_is_the_best_of_a_map(share: float, chrome: Opened, tmp_path: Path) -> None:
    """Cells of such rows were grey, which says that none is stable."""
    made = report(200)
    assert made.rows is not None
    some = np.random.default_rng(0).random((200, 1)) < share
    measures = [
        replace(each, values=np.where(some & np.isfinite(each.values), np.inf, each.values))
        if each.name == "gain_reduction_db"
        else each
        for each in made.rows.measures
    ]
    path = tmp_path / "report.html"
    write_report(replace(made, rows=replace(made.rows, measures=measures)), path)
    chrome.open(path)
    chosen = chrome.page.locator("label", has_text="Best").locator("select")
    map_of = chrome.page.locator('[aria-label^="best "]')
    told = []
    for name in ("gain_margin_db", "gain_reduction_db"):
        chosen.select_option(name)
        chrome.page.wait_for_timeout(300)
        told.append(map_of.get_attribute("aria-label").rpartition(", ")[2])
    assert told[0] == told[1]
    assert int(told[0].split()[0]) > 10
    assert [line for line in chrome.said if "willReadFrequently" not in line] == []


def test_what_is_kept_of_no_tissue_is_told(chrome: Opened, tmp_path: Path) -> None:
    one = candidates(5)
    path = tmp_path / "report.html"
    write_report(replace(report(5), rows=replace(one, toml=(), details={}, influence={})), path)
    chrome.open(path)
    chrome.page.locator("tbody tr[data-row]").first.click()
    assert chrome.page.locator("#toml").count() == 0
    assert chrome.said == []
