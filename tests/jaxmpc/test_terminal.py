"""What a user sees at 60, 80 and 120 columns, read from a terminal emulator: no number cut, none torn apart."""

import sys
from io import StringIO
from pathlib import Path

import numpy as np
import pytest

from jaxmpc.cli.comparison import PAPER_HEADER, REDUCTION_HEADER
from jaxmpc.cli.limit import HEADER, PLACE
from jaxmpc.files.errors import nearest
from jaxmpc.quantities import MARGINS
from jaxmpc.terminal import layout
from jaxmpc.terminal.progress import progress
from jaxmpc.terminal.tables import RESIDUAL_HEADER
from tests.screen import WIDTHS, on_terminal, shown

HIDE_CURSOR, SHOW_CURSOR = "\x1b[?25l", "\x1b[?25h"
TRIALS = ("controller", "RMS N, median", "true", "|e| N, 99 %", "largest", "swing N, median", "95 %", "guard at rest %")
TABLES = {
    "residuals": (RESIDUAL_HEADER, 2, "paper's text design, as it was published"),
    "Table I": (PAPER_HEADER, 2, "1900"),
    "reduction": (REDUCTION_HEADER, 2, "MPC alone"),
    "limit": ((*PLACE, *HEADER, "× limit"), 2, "810"),
    "check": (("K_s [N/m]", *MARGINS), 1, "375"),
    "trials": (TRIALS, 1, "a-controller-with-a-name-that-nobody-would-type"),
    "tissues": (("metric", *(f"{K:g} N/m" for K in np.geomspace(300, 2200, 33))), 1, "peak error [mN]"),
}


@pytest.mark.parametrize("columns", WIDTHS)
@pytest.mark.parametrize("name", TABLES)
def test_every_number_of_a_table_stands_whole_on_the_screen(name: str, columns: int) -> None:
    header, keys, first = TABLES[name]
    random = np.random.default_rng(1)
    figures = [[f"{x:.4f} / {y:.1f}" for x, y in random.uniform(-999, 999, (len(header) - keys, 2))] for _ in range(4)]
    rows = [[first, *(["1900"] * (keys - 1)), *each] for each in figures]
    text = layout.table(header, rows, columns, keys)
    assert max(map(layout.cells, text.splitlines())) <= columns
    lines = shown(text.replace("\n", "\r\n").encode(), columns)
    for cell in (cell for row in figures for cell in row):
        assert sum(cell in line for line in lines) == 1, cell
    assert "…" not in "".join(lines)


def test_an_output_that_is_no_terminal_has_each_row_on_one_line() -> None:
    text = layout.table(["a", *"b" * 50], [["x", *["1234.5678"] * 50]])
    assert len(text.splitlines()) == 3


def test_accents_and_wide_characters_take_the_places_that_a_terminal_gives_them() -> None:
    assert layout.cells("K̂_s") == 3
    assert layout.cells("心") == 2
    assert len(layout.table(["controller", "RMS"], [["printed, K̂_s 500", "1"]], 80).splitlines()) == 3
    head, rule, row = layout.table(["K̂", "λ"], [["心臓", "1"]], 80).splitlines()
    assert layout.cells(head) == layout.cells(row) == layout.cells(rule)


PROGRESS = """
import time
from jaxmpc.terminal.progress import progress
with progress("sweep", 1234567) as tick:
    for done in (1, 654321, 1234567):
        tick(done, "987654 rows/s, 1357 not OK, best 0.02468 N at M_s ≤ 2, 43210 lost / 56789 swinging")
        time.sleep(0.3)
"""


@pytest.mark.parametrize("columns", WIDTHS)
def test_progress_keeps_its_numbers(columns: int, tmp_path: Path) -> None:
    ran = on_terminal(columns, "-c", PROGRESS, cwd=tmp_path)
    text = ran.said
    assert not ran.torn
    for number in ("1234567/1234567", "987654", "1357", "0.02468", "43210", "56789"):
        assert number in text
    assert "…" not in text


class Terminal(StringIO):
    """One that is written to."""

    def isatty(self) -> bool:
        return True


def test_a_bar_that_is_interrupted_as_it_begins_leaves_the_terminal_as_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its cursor is back, what is printed goes where it went, and the next bar begins."""
    stderr = Terminal()
    monkeypatch.setattr("sys.stderr", stderr)
    monkeypatch.setenv("TERM", "xterm")
    before = sys.stdout

    def struck(self: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as once:
        once.setattr("rich.live.Live.refresh", struck)
        with pytest.raises(KeyboardInterrupt), progress("laws", 9):
            pass
    assert stderr.getvalue().rindex(SHOW_CURSOR) > stderr.getvalue().rindex(HIDE_CURSOR)
    assert (sys.stdout, sys.stderr) == (before, stderr)
    with progress("laws", 9) as tick:
        tick(9, "all of them")
    assert "all of them" in stderr.getvalue()


def test_the_time_that_is_left_knows_no_compiling(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A hundred seconds until the first rows were there, and ten for the same number once more."""
    clock = iter([0.0, 100.0, 110.0])
    monkeypatch.setattr("jaxmpc.terminal.progress.time.monotonic", lambda: next(clock))
    monkeypatch.setattr("jaxmpc.terminal.progress.PATIENCE", 1e3)
    with progress("sweep", 1000) as tick:
        tick(100, "")
        tick(200, "")
    assert capsys.readouterr().err.split("\n")[1] == "sweep: 200/1000 rows, 80 s left  "


@pytest.mark.parametrize("columns", WIDTHS)
def test_help_and_lists_fit(columns: int, tmp_path: Path) -> None:
    for command in (["list", "experiments", "params"], ["--help"]):
        ran = on_terminal(columns, "-m", "jaxmpc", *command, cwd=tmp_path)
        assert not ran.torn
        text = " ".join(ran.said.split())
        assert "Traceback" not in text
        if command[0] == "list":
            assert "10 mm in 0.3 s along" in text
            assert "from 375 to 1900 N/m at twice" in text


@pytest.mark.parametrize("columns", WIDTHS)
def test_a_mistake_is_told_between_words(columns: int, tmp_path: Path) -> None:
    wrong = ["trials", "text", "--experiment", f"{'no such ' * 12}1234567890.toml"]
    ran = on_terminal(columns, "-m", "jaxmpc", *wrong, cwd=tmp_path)
    assert ran.code == 2
    assert not ran.torn
    assert "1234567890" in ran.said


def test_options_are_alike_by_their_letters_and_not_by_their_dashes() -> None:
    known = ["--no-tare", "--reference", "--stiffness"]
    assert nearest("--stifness", known).startswith("Did you mean '--stiffness'?")
    assert nearest("--force", known).startswith("Known: --no-tare")
