"""Wrong words and flags of `jaxmpc sweep`: exit code 2, one sentence, nothing written."""

import socket
from collections.abc import Callable
from pathlib import Path

import pytest

Write = Callable[[str], Path]
Command = Callable[..., int]


@pytest.mark.parametrize(
    "arguments",
    [
        ["sweep", "spec.toml", "--chunk", "0"],
        ["sweep", "spec.toml", "--chunk", "10000000"],
        ["sweep", "spec.toml", "--cores", "0"],
        ["sweep", "spec.toml", "other.toml"],
        ["sweep", "spec.toml", "--csv", "rows.csv"],
        ["sweep", "report"],
        ["sweep", "report", "nowhere"],
        ["sweep", "report", "spec.toml", "--chunk", "5"],
        ["sweep", "report", "spec.toml", "--max-ms", "nan"],
        ["sweep", "missing.toml"],
        # Flags that a verb does not take would otherwise do nothing, without a word.
        ["sweep", "best", "nowhere", "--goals", "rms,M_s"],
        ["sweep", "best", "nowhere", "-o", "there"],
        ["sweep", "pareto", "nowhere", "--max-ms", "1.5"],
        ["sweep", "row", "nowhere", "3", "-n", "2"],
        ["sweep", "sensitivity", "nowhere", "--csv", "rows.csv"],
        ["sweep", "report", "nowhere", "--params", "row.toml"],
    ],
)
def test_wrong_arguments_are_refused(
    arguments: list[str], write_spec: Write, spec_text: str, command: Command, tmp_path: Path
) -> None:
    write_spec(spec_text)
    assert command(*arguments) == 2
    assert [entry.name for entry in tmp_path.iterdir()] == ["spec.toml"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["row", "here"], "must be row DIR N. `jaxmpc sweep best DIR` lists some rows"),
        (["row", "here", "1", "2"], "must be row DIR N"),
        (["best", "here", "there"], "must be best DIR. Give one folder"),
        (["spec.toml", "here"], "Results go to -o here"),
        (["here"], "It is a folder: `jaxmpc sweep best here` shows"),
        (["bset", "here"], "Did you mean 'best'?"),
    ],
)
def test_who_forgets_a_word_is_told_which(
    arguments: list[str], words: str, tmp_path: Path, command: Command, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "here").mkdir()
    assert command("sweep", *arguments) == 2
    assert words in capsys.readouterr().err


@pytest.mark.parametrize(
    "address",
    [
        "nowhere",
        "",
        "tcp://",
        "tcp://:8786",
        "tcp://host:port",
        "tcp://host:99999",
        "http://host:80",
        "tls://host:8786",
    ],
)
@pytest.mark.parametrize("how", [["--dry-run"], []])
def test_an_address_of_no_scheduler_is_refused_at_once(
    address: str,
    how: list[str],
    write_spec: Write,
    spec_text: str,
    command: Command,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    """Also one that asks for certificates of which Dask knows none."""
    pytest.importorskip("distributed")
    assert command("sweep", write_spec(spec_text), "--cluster", address, *how) == 2
    assert f"--cluster = {address or 'empty'}: must be" in capsys.readouterr().err
    assert [entry.name for entry in tmp_path.iterdir()] == ["spec.toml"]


@pytest.mark.parametrize("part", ["²/3", "1/²", f"1/{'9' * 5000}"])
def test_a_part_is_two_plain_numbers(part: str, write_spec: Write, spec_text: str, command: Command) -> None:
    assert command("sweep", write_spec(spec_text), "--part", part) == 2


def test_a_flag_of_another_verb_is_refused_by_name(command: Command, capsys: pytest.CaptureFixture[str]) -> None:
    assert command("sweep", "sensitivity", "nowhere", "--csv", "rows.csv") == 2
    assert "--csv = rows.csv: must be left out of `sweep sensitivity`. It belongs to `jaxmpc sweep report | best" in (
        capsys.readouterr().err
    )


def test_a_scheduler_that_does_not_answer_leaves_no_folder(
    write_spec: Write,
    spec_text: str,
    command: Command,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """An empty sweep was left behind, which the same command without Dask then went on with."""
    pytest.importorskip("distributed")
    monkeypatch.setattr("sweeps.cluster.CONNECT_S", 1.0)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"  # nobody listens
        assert command("sweep", write_spec(spec_text), "--cluster", address, "-o", tmp_path / "run") == 2
    told = capsys.readouterr()
    assert f"--cluster = {address}: must be a scheduler that answers" in told.err
    assert not told.out
    assert [entry.name for entry in tmp_path.iterdir()] == ["spec.toml"]
