"""What a shell offers where `jaxmpc completion` has been read."""

import shutil
import subprocess
from pathlib import Path

import pytest

from jaxmpc.cli import VERBS, main, whole_parser
from jaxmpc.cli.completion import NAMES
from jaxmpc.cli.listing import KINDS

ASKED = """
source ./completion
cd files
COMP_WORDS=(jaxmpc "$@")
COMP_CWORD=$#
_shtab_jaxmpc 2> errors
printf '%s\\n' "${COMPREPLY[@]}"
"""


@pytest.mark.skipif(not shutil.which("bash"), reason="no bash here")
def test_bash_offers_names_where_there_are_names_and_files_where_there_are_files(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["completion", "bash"]) == 0
    (tmp_path / "completion").write_text(capsys.readouterr().out)
    (tmp_path / "files").mkdir()
    (tmp_path / "files" / "my.toml").touch()

    def offered(*words: str) -> set[str]:
        asked = subprocess.run(["bash", "-c", ASKED, "-", *words], cwd=tmp_path, capture_output=True, text=True)
        return set(asked.stdout.split()) - {"errors"}

    assert offered("list", "") == offered("list", "params", "") == set(KINDS)
    assert offered("simulate", "") == {*KINDS["experiments"][1](), "my.toml"}
    assert offered("compare", "text", "") == {*KINDS["params"][1](), "my.toml"}
    assert {"arm-tune", "my.toml"} <= offered("tune", "")
    assert "demo-sweep" not in offered("tune", "")
    assert offered("twin", "--tissue", "") == set(KINDS["tissues"][1]())
    assert offered("check", "") == {"my.toml"}
    assert offered("sweep", "--params", "") == {"my.toml"}  # a file that is written
    assert offered("twin", "--seed", "") == set()


def test_zsh_completes_each_of_several(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion", "zsh"]) == 0
    lines = [line.strip() for line in capsys.readouterr().out.splitlines()]
    assert not any(line.startswith('"(*):') for line in lines)
    assert any(line.startswith('"*:') and line.endswith(f':({" ".join(KINDS)})"') for line in lines)


def test_arguments_that_take_names_exist() -> None:
    parser = whole_parser()
    for verb, taken in NAMES.items():
        assert verb in VERBS
        assert set(taken) <= {action.dest for action in parser.of_verb(verb).taking_values()}
        assert set(taken.values()) <= set(KINDS)
