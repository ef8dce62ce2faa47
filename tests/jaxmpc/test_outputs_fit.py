"""Real output of the verbs at 60, 80 and 120 columns: tables, sheets and prose, no number cut or torn."""

import subprocess
from pathlib import Path

import pytest

from jaxmpc.cli import main
from jaxmpc.terminal.folding import Folded
from tests.screen import WIDTHS, Terminal, assert_whole, written

EXPERIMENT = """\
name = "short"
duration = 0.6
settle = 0.2
stiffness = [375.0, 810.0, 1900.0]
motion = { kind = "none" }
"""
SWEEP = """\
[experiment]
file = "short.toml"
[sweep]
kind = "grid"
[sweep.axes]
K2 = [10.0, 20.0, 30.0]
lam = { log = [0.01, 0.1], points = 3 }
delay = [1, 2]
"""
COMMANDS = {
    "simulate": ["simulate", "short.toml", "--compare", "-o", "simulated"],
    "freeze": ["freeze", "text", "--experiment", "short.toml", "--max-ms", "9", "-o", "c.npz"],
    "check": ["check", "c.npz"],
    "sign": ["sign", "c.npz", "--key", "key"],
    "sweep": ["sweep", "sweep.toml", "-o", "swept", "--quiet"],
    "sweep dry run": ["sweep", "sweep.toml", "-o", "another", "--dry-run"],
    "sweep best": ["sweep", "best", "swept", "--max-ms", "9"],
    "sweep pareto": ["sweep", "pareto", "swept", "--goals", "rms,M_s,chatter"],
    "sweep sensitivity": ["sweep", "sensitivity", "swept"],
    "sweep row": ["sweep", "row", "swept", "0"],
    "sweep report": ["sweep", "report", "swept", "--max-ms", "9"],
    "compare": ["compare", "text", "cautious", "--experiment", "short.toml", "--seeds", "0"],
    "limit": ["limit", "short.toml", "--params", "text"],
    "identify": ["identify", "twin-motion"],
    "list": ["list"],
}


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("desk")
    (folder / "short.toml").write_text(EXPERIMENT)
    (folder / "sweep.toml").write_text(SWEEP)
    subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", "key"], cwd=folder, check=True)
    return folder


QUICK = ("simulate", "freeze", "check", "sign", "identify", "list")
MARKED = [pytest.param(name, marks=pytest.mark.oracle if name in QUICK else pytest.mark.slow) for name in COMMANDS]


@pytest.mark.parametrize("columns", WIDTHS)
@pytest.mark.parametrize("name", MARKED)
def test_no_number_of_a_verb_is_cut(
    desk: Path, name: str, columns: int, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("jaxmpc.terminal.process.use_all_cores", lambda *_: None)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.chdir(desk)
    text = written(COMMANDS[name], columns, monkeypatch)
    assert_whole(text, columns)
    assert len(text) > 40


@pytest.mark.parametrize("columns", WIDTHS)
def test_prose_is_folded_between_words(columns: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("jaxmpc.terminal.layout.columns_of", lambda _: columns)
    terminal = Terminal()
    out = Folded(terminal)
    sentence = "  " + " ".join(f"{k * 1234.5678:.4f} mN," for k in range(40))
    for part in (sentence[:17], sentence[17:], "\n", "x" * 200, "\n", "\rstatus", "\n\nend\n"):
        out.write(part)
    text = terminal.getvalue()
    first = text[: text.index("x")]
    assert first.split() == sentence.split()
    assert max(map(len, first.splitlines())) <= columns
    assert len(first.splitlines()) > 4
    assert text.endswith(f"{'x' * 200}\n\rstatus\n\nend\n")


def test_a_list_fits_a_narrow_terminal(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """Wider than the terminal, its lines were folded once more: a word or two of each stood at its edge."""
    monkeypatch.setenv("COLUMNS", "40")
    assert main(["list", "jobs"]) == 0
    title, *lines = capsys.readouterr().out.splitlines()
    assert title.startswith("jobs")
    assert max(map(len, lines)) <= 40
    assert all(line.startswith("  ") for line in lines)


def test_what_is_no_terminal_is_left_alone(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list", "tissues"]) == 0
    assert "\n" in capsys.readouterr().out
