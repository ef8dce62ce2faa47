"""Help or results that were asked for and reached nobody: the exit code tells, and one sentence of a full disk."""

import os
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
@pytest.mark.parametrize("buffered", [True, False])
@pytest.mark.parametrize("arguments", [[], ["--version"], ["sweep", "--help"], ["list"]], ids=" ".join)
def test_what_reaches_nobody_is_told_by_the_exit_code(arguments: list[str], buffered: bool) -> None:
    command = [sys.executable, *([] if buffered else ["-u"]), "-m", "jaxmpc", *arguments]
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    with open("/dev/full", "w") as full:
        found = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False, env=environment)
    assert (found.returncode, found.stderr.count("\n")) == (1, 1)
    assert "No space left on device" in found.stderr

    gone, mine = os.pipe()
    os.close(gone)
    found = subprocess.run(command, stdout=mine, stderr=subprocess.PIPE, text=True, check=False, env=environment)
    os.close(mine)
    assert (found.returncode, found.stderr) == (141, "")
