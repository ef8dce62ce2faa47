"""A file that a verb would write, but that holds something of another kind, stays as it is."""

from pathlib import Path

import pytest

from jaxmpc.cli import main


@pytest.mark.parametrize(
    ("arguments", "name", "suffix"),
    [
        (["sweep", "best", "run", "--params"], "controller.npz", ".toml"),
        (["sweep", "best", "run", "--params"], "rows.csv", ".toml"),
        (["sweep", "best", "run", "--csv"], "params.toml", ".csv"),
        (["sweep", "report", "run", "--csv"], "controller.npz", ".csv"),
        (["identify", "twin-motion", "-o"], "motion.csv", ".toml"),
        (["identify", "twin-motion", "-o"], "controller.npz", ".toml"),
    ],
)
def test_a_file_of_another_kind_is_refused(
    arguments: list[str],
    name: str,
    suffix: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path(name).write_bytes(b"years of work")
    assert main([*arguments, name]) == 2
    assert f"{arguments[-1]} = {name}: must be a file ending in {suffix}. Rename it." in capsys.readouterr().err
    assert Path(name).read_bytes() == b"years of work"
