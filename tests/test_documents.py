"""What README and guides print runs: every command line is understood, Python blocks and the notebook are executed."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from jaxmpc.cli import whole_parser
from tests.sources import ROOT

DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
NOTEBOOK = ROOT / "docs" / "story.ipynb"


def blocks(path: Path, language: str) -> list[str]:
    """Fenced blocks of a language; "" is that of command lines."""
    return re.findall(rf"^```{language}\n(.*?)^```", path.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)


def commands(path: Path) -> list[str]:
    """Command lines of `jaxmpc` in a document's blocks, comments and continuation lines resolved."""
    lines = "\n".join(text for language in ("", "sh", "bash") for text in blocks(path, language)).replace("\\\n", " ")
    return [line.strip() for line in lines.splitlines() if line.strip().startswith("jaxmpc ")]


COMMANDS = [(path.name, line) for path in DOCUMENTS for line in commands(path)]


def test_there_are_commands_to_look_at() -> None:
    assert len(COMMANDS) > 20


@pytest.mark.parametrize(("document", "line"), COMMANDS)
def test_every_printed_command_is_understood(document: str, line: str) -> None:
    words = shlex.split(line, comments=True)[1:]
    words = words[: next((i for i, word in enumerate(words) if word in ("|", ">", "&", "&&")), len(words))]
    whole_parser().parse_args([word.strip("[]") for word in words])


def test_a_wrong_command_would_be_seen() -> None:
    with pytest.raises(SystemExit):
        whole_parser().parse_args(["freeze", "text", "--stifness", "3"])


@pytest.mark.oracle
def test_the_python_of_the_readme_runs(tmp_path: Path) -> None:
    program = "\n".join(blocks(ROOT / "README.md", "python"))
    assert "from jaxmpc import" in program
    env = {"PYTHONPATH": str(ROOT), "HOME": str(tmp_path), "PATH": ""}
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, cwd=tmp_path, env=env)
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_the_notebook_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import nbformat
    from nbclient import NotebookClient

    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    NotebookClient(notebook, timeout=600, resources={"metadata": {"path": str(tmp_path)}}).execute()
    printed = "".join(output.get("text", "") for cell in notebook.cells for output in cell.get("outputs", ()))
    assert "cautious  worst RMS" in printed


@pytest.mark.slow
def test_the_site_is_made_without_a_network(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "-b", "html", "docs", str(tmp_path / "site")]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=False)
    assert done.returncode == 0, done.stderr
    for page in (tmp_path / "site").glob("*.html"):
        assert not re.search(r'<(script|link)[^>]+(src|href)="https?://', page.read_text(encoding="utf-8")), page.name


@pytest.mark.slow
def test_ones_own_recording_flies_by_the_readme_alone(tmp_path: Path) -> None:
    """The block below "Your own heart", as printed; the environment is that of the tests."""
    text = (ROOT / "README.md").read_text(encoding="utf-8").partition("## Your own heart")[2]
    lines = text.split("```")[1].strip().splitlines()
    assert lines[0] == ". .venv/bin/activate"
    assert len(lines) + 1 <= 6  # `make demo` before them
    rows = [f"{i / 100:.2f},0,0,{0.003 * ((i % 80) / 80 - 0.5) ** 2:.6f}" for i in range(1000)]
    (tmp_path / "heart.csv").write_text("\n".join(["t,x,y,z", *rows]) + "\n")
    for line in lines[1:]:
        command = [sys.executable, "-m", *shlex.split(line)]
        done = subprocess.run(command, cwd=tmp_path, env={"PYTHONPATH": str(ROOT), "HOME": str(tmp_path), "PATH": ""})
        assert done.returncode == 0, line
    assert (tmp_path / "flight.png").stat().st_size > 20_000
