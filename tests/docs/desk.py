"""A reader's desk: a folder, what a reader brings along, and a shell that does what the pages print."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np

from jaxmpc.files.toml import write_toml
from jaxmpc.synthesis.params import Params
from tests.docs.document import SHELL, Block
from tests.sources import ROOT

LONGEST = 900.0
"""Time after which a block is taken to hang [s]."""


class Desk:
    """A folder in which blocks are run one after the other."""

    def __init__(self, folder: Path, environment: Path | None = Path(sys.prefix)) -> None:
        """Lay out what a reader has before the first line; the cache of compiled programs is empty.

        Args:
            folder: An empty one, or a clone.
            environment: The virtual environment that `. .venv/bin/activate` enters, with the sources that are tested;
                None is one that the reader makes.
        """
        self.folder = folder
        (folder / "home").mkdir()
        path = f"{folder}/.venv/bin:{os.environ['PATH']}"
        self._variables = {"HOME": str(folder / "home"), "LANG": "C.UTF-8", "PATH": path}
        if environment is not None:
            (folder / ".venv").symlink_to(environment)
            self._variables["PYTHONPATH"] = str(ROOT)
        write_heart(folder / "heart.csv")
        # As `jaxmpc tune` would have left it.
        write_toml(folder / "params.toml", {"params": Params.published("cautious").to_dict()})

    def run(self, block: Block) -> None:
        """Do what a block says.

        Raises:
            AssertionError: It ends with another code than its page says; its last lines are in the message.
        """
        if block.file is not None:
            (self.folder / block.file).write_text(block.text, encoding="utf-8")
        elif block.language in SHELL:
            self.do(["bash", "-euo", "pipefail", "-c", block.text], block.place, block.code)
        elif block.language == "python":
            self.do(["python", "-c", block.text], block.place, block.code)

    def do(self, command: list[str], place: str, code: int = 0) -> None:
        """Run a command in the folder."""
        program = shutil.which(command[0], path=self._variables["PATH"])
        assert program, command[0]
        done = subprocess.run(
            [program, *command[1:]], cwd=self.folder, env=self._variables, capture_output=True, text=True,
            timeout=LONGEST, stdin=subprocess.DEVNULL, check=False,
        )  # fmt: skip
        said = "\n".join([*done.stdout.splitlines()[-20:], *done.stderr.splitlines()[-20:]])
        assert done.returncode == code, f"{place} ended with {done.returncode}:\n{said}"


def write_heart(path: Path) -> None:
    """Ten seconds of a heart's surface at 100 Hz: 75 beats a minute over breathing, some millimetres."""
    t = np.arange(0.0, 10.0, 0.01)
    beat, breath = 2.0 * np.pi * 1.25 * t, 2.0 * np.pi * 0.25 * t
    z = 3e-3 * np.sin(beat) + 1e-3 * np.sin(2.0 * beat + 1.0) + 2e-3 * np.sin(breath)
    rows = np.column_stack([t, 0.3 * z, 0.2 * z, z])
    np.savetxt(path, rows, delimiter=",", header="t,x,y,z", comments="", fmt="%.6f")
