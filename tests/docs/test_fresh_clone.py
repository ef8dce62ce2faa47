"""README in a fresh clone, with nothing installed and nothing compiled: what its first block makes, the others use.

It installs packages, so it needs the registry that pip is set up for; Python is the one that runs the tests.
"""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.docs.desk import Desk
from tests.docs.document import blocks
from tests.sources import ROOT


@pytest.mark.slow
def test_the_readme_runs_in_a_fresh_clone(tmp_path: Path) -> None:
    clone = tmp_path / "jaxmpc"
    subprocess.run(["git", "clone", "--quiet", str(ROOT), str(clone)], check=True)
    first, *rest = blocks(ROOT / "README.md")
    assert first.left_out.startswith("make demo")
    desk = Desk(clone, environment=None)
    desk.do(["make", "demo", f"PYTHON={sys.executable}"], first.place)
    assert (clone / "demo" / "flight.png").stat().st_size > 20_000
    for block in rest:
        desk.run(block)
    # The first screen's promise: a picture of one's own recording, by six commands at most.
    own = next(block for block in rest if "heart.csv" in block.text)
    assert len(own.text.splitlines()) + 1 <= 6
    assert (clone / "flight.png").stat().st_size > 20_000
