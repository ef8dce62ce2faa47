"""What is asked of trials in Python: of another type or out of bounds it is told before any trial is drawn."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from jaxmpc import Experiment, InputError, Params
from tuning import trials
from tuning.job.scenarios import Scenarios
from tuning.trials import HARD, MOST, NOMINAL, Job
from tuning.trials.drawn import BLOCK, FIRST_SEED

BASE = Experiment.published("table-1-wam")
ONE = (Params(),)
NAN = float("nan")


@pytest.mark.parametrize("number", [-1, MOST, 1.5, True, "3", None])
def test_a_trial_is_one_of_its_seed(number: Any) -> None:
    """−1 was the last of the seed before."""
    job = Job(ONE, BASE)
    with pytest.raises(InputError, match=r"^trial = .*: must be a whole number in \[0, "):
        job.trial(number)
    with pytest.raises(InputError, match=r"^first = "):
        job.drawn(number, 1)
    assert job.trial(np.int64(3)) == job.trial(3)  # type: ignore[arg-type]  # on purpose


@pytest.mark.parametrize("count", [0, -2, 1.5, True, "3", None])
def test_drawn_trials_are_counted(count: Any) -> None:
    with pytest.raises(InputError, match=r"^count = "):
        Job(ONE, BASE).drawn(0, count)


def test_as_many_trials_as_a_seed_has_fill_whole_blocks() -> None:
    """What is computed beyond what was asked for ends before the next seed begins."""
    assert MOST % BLOCK == 0
    assert MOST <= FIRST_SEED < MOST + BLOCK
    assert Job(ONE, BASE).trial(MOST - 1) != Job(ONE, BASE, seed=1).trial(0)


@pytest.mark.parametrize(
    ("key", "given"),
    [
        ("controllers", (Params(), BASE)),
        ("controllers", (("text",), BASE)),
        ("controllers", ((Params.stack([Params(), Params()]),), BASE)),
        ("base", (ONE, "table-1-wam")),
        ("base", (ONE, None)),
        ("spread", (ONE, BASE, "hard")),
        ("spread", (ONE, BASE, None)),
    ],
)
def test_a_job_is_of_controllers_an_experiment_and_a_spread(key: str, given: tuple[Any, ...]) -> None:
    """A path in place of the experiment was "'str' object has no attribute 'physics'"."""
    with pytest.raises(InputError, match=f"^{key} = "):
        Job(*given)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        *(("stiffness", ends) for ends in ((-1.0, 3.0), (900.0, 300.0), (900.0,), (NAN, 9.0), (3.0, np.inf), 5.0)),
        *(("cable_damping", ends) for ends in ((-0.1, 0.1), (0.1, 0.05), (0.5, 1.5), ("a", "b"))),
        *(("substeps", count) for count in (0, 65, "2", True)),
        ("scenarios", None),
    ],
)
def test_a_spread_has_ends(key: str, value: Any) -> None:
    """Tissues of −1 … 3 N/m were drawn, as NaN."""
    with pytest.raises(InputError, match=rf"^spread\.{key} = "):
        Job(ONE, BASE, NOMINAL._replace(**{key: value}))


@pytest.mark.parametrize(
    ("key", "change"),
    [
        ("rhythms", {"rhythms": ()}),
        ("rhythms[0]", {"rhythms": ("samba",)}),
        ("cable_hz", {"cable_hz": (60.0, 15.0)}),
        ("cable_hz", {"cable_hz": (15.0, 290.0)}),
        ("friction", {"friction": 5.0}),
    ],
)
def test_scenarios_of_a_spread_are_those_of_a_file(key: str, change: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=rf"^scenarios\.{re.escape(key)} = "):
        Job(ONE, BASE, HARD._replace(scenarios=replace(HARD.scenarios, **change)))


def test_an_arm_without_friction_is_tried() -> None:
    still = replace(BASE, arm=replace(BASE.arm, coulomb=(0.0,) * 4, viscous=(0.0,) * 4))
    assert Job(ONE, still).trial(0).arm.coulomb == (0.0,) * 4
    Job(ONE, BASE, NOMINAL._replace(scenarios=Scenarios(), cable_damping=None))


@pytest.mark.parametrize(
    ("key", "given"),
    [("job", (3, 1)), ("job", (None, 1)), ("controllers", (Job((), BASE), 1)), ("folder", (Job(ONE, BASE), 1, 3))],
)
def test_a_run_is_of_a_job(key: str, given: tuple[Any, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=f"^{key} = "):
        trials.run(*given)
    assert not list(tmp_path.iterdir())
