"""Verbs of the workstation where the robot's packages alone are: one sentence says what to install."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ROBOTS = """
import json, sys
from jaxmpc.cli import _WORKSTATION, main

class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in _WORKSTATION:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Missing())
for words in json.loads(sys.argv[1]):
    try:
        code = main(words)
    except BaseException as error:
        code = f"{error!r}"
    print(words, code, file=sys.stderr)
"""
COMMANDS = (
    *(["demo"], ["simulate", "table-1"], ["sweep", "spec.toml"], ["sweep", "report", "folder"], ["tune", "arm-tune"]),
    *(["compare", "text", "cautious"], ["limit", "table-1"], ["trials", "text"], ["freeze", "text"]),
    *(["identify", "twin-motion"], ["twin"], ["list", "params"], ["completion", "bash"]),
)


def test_what_to_install_is_told_by_every_verb(tmp_path: Path) -> None:
    command = [sys.executable, "-c", ROBOTS, json.dumps(COMMANDS)]
    done = subprocess.run(command, cwd=tmp_path, env={"PYTHONPATH": str(ROOT)}, capture_output=True, text=True)
    said = iter(done.stderr.splitlines())
    for words in COMMANDS:
        assert next(said).endswith("install the workstation, jaxmpc[sim]"), done.stderr
        assert next(said) == f"{words} 2"


@pytest.mark.parametrize("name", ["design", "evaluate", "Params"])
def test_what_to_install_is_told_in_python(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    import jaxmpc

    monkeypatch.setattr(jaxmpc, "_HOME", {name: "jax_that_is_missing"})
    with pytest.raises(ModuleNotFoundError, match="install the workstation, pip install 'jaxmpc") as caught:
        getattr(jaxmpc, name)
    assert caught.value.name == "jax_that_is_missing"
