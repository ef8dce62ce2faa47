"""Verbs with progress or a status line, on real terminals of 60, 80 and 120 columns: nothing torn, nothing cut."""

import re
from collections.abc import Callable

import pytest

from jaxmpc.terminal import layout
from tests.screen import WIDTHS, Ran, on_terminal

TUNE = """\
[tune]
starts = 4
steps = 4
train_seeds = [0]
heldout_seeds = [1000, 1001]
duration = 5.0
settle = 1.2
margin_points = 0
[goals]
ideal = true
M_s = 9.0
"""
TRIALS = """
import sys
import numpy as np
from jaxmpc.cli import main
from tuning import trials
from tuning.trials import Outcomes, drawn

def outcomes_of(job, firsts):
    '''Flights that nobody flies: what is told of them is the matter here.'''
    for first in firsts:
        flat = np.zeros((drawn.BLOCK, len(job.controllers)))
        peak = np.random.default_rng(first).uniform(0.0, 60.0, (*flat.shape, 3))
        when = flat + 12.34, flat + 0.9, flat + np.inf
        status = np.where(peak[..., 0] > 30.0, 5, 0).astype(np.int8)
        yield Outcomes(status, *when, 0.1 * peak, 0.1 * peak, peak, 0.01 * peak, flat == 1.0)

trials.outcomes_of = outcomes_of
sys.exit(main(sys.argv[1:]))
"""
MODULE = ("-m", "jaxmpc")
AGAINST = ["trials", "text", "--against", "cautious", "--hard", "--trials", "40"]
CASES = {
    "tune": (MODULE, ["tune", "tune.toml", "-o", "tuned{columns}"], 0),
    "trials": (("-c", TRIALS), [*AGAINST, "-o", "tried{columns}"], 1),
    "run": (MODULE, ["run", "controller.npz", "--lockstep", "--duration", "11", "-o", "flights{columns}"], 0),
    "a fault": (MODULE, ["run", "controller.npz", "--lockstep", "--fault", "force:stuck@5", "-o", "flights"], 1),
    "replay": (MODULE, ["replay", "flights/flight-0000.npz", "--picture", "flight{columns}.png"], 0),
    "twin": (
        MODULE,
        ["twin", "--port", "0", "--duration", "3.5", "--activate-after", "1", "--fault", "force:off@3"],
        0,
    ),
    "demo": (MODULE, ["demo", "-o", "demo{columns}"], 0),
}
"""How each is called, its arguments, and the code with which it ends."""

OnDesk = Callable[[str, int], Ran]


@pytest.fixture(scope="module")
def on_desk(tmp_path_factory: pytest.TempPathFactory) -> OnDesk:
    """Runs a case in a folder with what the cases need; what one width compiles serves the next."""
    folder, cache = tmp_path_factory.mktemp("desk"), tmp_path_factory.mktemp("cache")
    variables = {"XDG_CACHE_HOME": str(cache), "JAX_ENABLE_COMPILATION_CACHE": "true"}

    def run(name: str, columns: int) -> Ran:
        program, words, code = CASES[name]
        ran = on_terminal(columns, *program, *(word.format(columns=columns) for word in words), cwd=folder, **variables)
        assert ran.code == code, ran.said
        return ran

    (folder / "tune.toml").write_text(TUNE)
    freeze = ["freeze", "cautious", "--experiment", "table-1-wam", "-o", "controller.npz"]
    assert on_terminal(80, *MODULE, *freeze, cwd=folder, **variables).code == 0
    run("a fault", 80)
    return run


@pytest.mark.slow
@pytest.mark.parametrize("columns", WIDTHS)
@pytest.mark.parametrize("name", CASES)
def test_nothing_is_torn_or_cut(on_desk: OnDesk, name: str, columns: int) -> None:
    ran = on_desk(name, columns)
    # Nobody can fold a word that is longer than the screen, such as a sha256.
    assert [line for line in ran.torn if " " in line.strip()] == []
    assert max(map(layout.cells, ran.said.splitlines())) <= columns
    # An ellipsis stands for what goes on, a range, or the rest of a hash; else something was cut.
    cut = re.sub(r"[0-9a-f]{8}…|\d … \d| …$|^… and", "", ran.said, flags=re.MULTILINE)
    assert "…" not in cut
