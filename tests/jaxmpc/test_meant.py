"""What was given in the place of something else is told for what it is."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from jaxmpc import Experiment, InputError, Params, design, evaluate, margins
from jaxmpc.cli import main

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
    ],
)
def test_an_argument_of_another_type(wrong: Callable[[], Any], says: str) -> None:
    with pytest.raises(InputError) as caught:
        wrong()
    assert says in str(caught.value)


@pytest.mark.parametrize(("more", "key"), [({"delay": 2}, "delay"), ({"ideal": True}, "ideal")])
def test_a_path_has_its_own_delay_and_damping(more: dict[str, Any], key: str) -> None:
    """Margins of another loop than the one that was asked for were returned, without a word."""
    path = Experiment.published("table-1").loop_path()
    with pytest.raises(InputError, match=f"{key} = .* beside a path: must be left out") as caught:
        margins(Params(), 810.0, path=path, **more)
    assert caught.value.key == key
