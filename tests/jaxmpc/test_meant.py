"""What was given in the place of something else is told for what it is."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jaxmpc import Experiment, InputError, Params, design, evaluate, margins
from jaxmpc.cli import main

TABLE_1 = Experiment.published("table-1")
FILES = {
    "experiment": 'physics = "linear"\nduration = 3.0\nsettle = 1.0\n',
    "params": "[params]\nlam = 0.1\n",
    "bare": "lam = 0.1\n",
    "sweep": '[sweep]\nkind = "grid"\n[sweep.axes]\nK2 = [10.0, 20.0]\n',
    "job": "[params]\nlam = 0.1\n[tune]\nsteps = 2\n",
    "misspelt": '[experiments]\npublished = "table-1"\n',
    "slip": 'phisics = "linear"\nduration = 3.0\n',
}


@pytest.mark.parametrize(
    ("command", "says"),
    [
        ("simulate params.toml", "looks like parameters, which go with `--params`"),
        ("simulate sweep.toml", "looks like the spec of a sweep"),
        ("simulate slip.toml", "Did you mean 'physics'?"),
        ("simulate table-1 --params experiment.toml", "looks like an experiment, which `jaxmpc simulate` takes"),
        ("simulate table-1 --params job.toml", "looks like a tuning job, which `jaxmpc tune` takes"),
        ("simulate table-1 --params bare.toml", "Put the parameters under [params]."),
        ("freeze experiment.toml", "looks like an experiment"),
        ("sweep experiment.toml", "looks like an experiment"),
        ("sweep job.toml", "looks like a tuning job"),
        ("sweep misspelt.toml", "Did you mean 'experiment'?"),
        ("tune sweep.toml", "looks like the spec of a sweep"),
        ("tune experiment.toml", "looks like an experiment"),
        ("tune misspelt.toml", "Did you mean 'experiment'?"),
        ("twin --experiment params.toml", "looks like parameters"),
        ("twin --stiffness -4", "in [1, 100000] N/m"),
        ("check experiment.toml", "If it holds parameters, `jaxmpc freeze"),
    ],
)
def test_a_file_of_another_kind(
    command: str, says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for name, text in FILES.items():
        Path(f"{name}.toml").write_text(text)
    assert main(command.split()) == 2
    told = capsys.readouterr().err
    assert says in told
    assert len(told.splitlines()) == 1
    assert sorted(path.stem for path in tmp_path.iterdir()) == sorted(FILES)


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        (lambda: design("text"), 'params = text: must be of the type Params. Make one with Params.published("text")'),
        (lambda: margins("text", 810.0), "params = text: must be of the type Params"),
        (lambda: evaluate({"lam": 0.1}, Experiment.published("table-1")), "must be of the type Params"),
        (lambda: evaluate(Params(), "table-1"), "experiment = table-1: must be of the type Experiment"),
        (lambda: evaluate(Experiment.published("table-1"), Params()), "must be of the type Params"),
        (lambda: evaluate(Params(), TABLE_1, trace="no"), "trace = no: must be true or false"),
        (lambda: margins(Params(), 810.0, ideal="no"), "ideal = no: must be true or false"),
        (lambda: margins(Params(), 810.0, ideal=None), "ideal = None: must be true or false"),
        (lambda: margins(Params(), 810.0, path=TABLE_1), "must be of the type LoopPath. Take it of an experiment"),
        (lambda: TABLE_1.loop_path("no"), "ideal = no: must be true or false"),
        (lambda: design(Params(), 1e-3), "timing = 0.001: must be of the type Timing. Write Timing(T_s=1e-3)"),
        (lambda: design(Params(), None, 3.0), "force_filter = 3.0: must be of the type ForceFilter"),
        (lambda: Params.from_dict(["lam", 0.1]), "must be a table"),
        (lambda: Params.from_dict(None), "params = None: must be a table"),
        (lambda: Experiment.from_dict([1.0]), "experiment = [1.0]: must be a table"),
        (lambda: Params().with_columns([0.1, 0.2]), "columns = [0.1, 0.2]: must be a table"),
        (lambda: Params.published(["text"]), "must be a known name"),
    ],
)
def test_an_argument_of_another_type(wrong: Callable[[], Any], says: str) -> None:
    with pytest.raises(InputError) as caught:
        wrong()
    assert says in str(caught.value)


def test_a_truth_value_of_numpy_is_one() -> None:
    path = TABLE_1.loop_path(np.bool_(True))
    assert path == TABLE_1.loop_path(True)
    assert path.ideal is True


@pytest.mark.parametrize(("more", "key"), [({"delay": 2}, "delay"), ({"ideal": True}, "ideal")])
def test_a_path_has_its_own_delay_and_damping(more: dict[str, Any], key: str) -> None:
    """Margins of another loop than the one that was asked for were returned, without a word."""
    path = Experiment.published("table-1").loop_path()
    with pytest.raises(InputError, match=f"{key} = .* beside a path: must be left out") as caught:
        margins(Params(), 810.0, path=path, **more)
    assert caught.value.key == key
