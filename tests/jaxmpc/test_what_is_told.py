"""What verbs say of a result is of all of it: of lost runs, of a family's two sets of gains, of a first step."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from jaxmpc import Experiment, InputError, Status
from jaxmpc.cli import main
from jaxmpc.cli.simulate import _statuses
from jaxmpc.pictures.experiment_figures import drawn_of, row_to_draw
from jaxmpc.terminal.arguments import params_from

OK, LOST, BEYOND = int(Status.OK), int(Status.LOST_CONTACT), int(Status.FORCE_LIMIT)


def ran(*statuses: int) -> Any:
    rms = np.outer(np.arange(1.0, 1.0 + len(statuses)), np.ones(3))
    when = np.full(len(statuses), np.nan)
    return SimpleNamespace(status=np.array(statuses), when=when, metrics=SimpleNamespace(rms=rms))


@pytest.mark.parametrize(
    ("moving", "still", "row", "words"),
    [
        ((OK, LOST, OK), (OK, OK, OK), 2, ", the worst of 3"),
        ((OK, OK, BEYOND), (OK, OK, OK), 1, ", the worst of 2 that held, of 3"),
        ((OK, OK, OK), (OK, OK, BEYOND), 1, ", the worst of 2 that held, of 3"),
        ((OK,), (OK,), 0, ""),
    ],
)
def test_a_figure_says_what_it_is_the_worst_of(
    moving: tuple[int, ...], still: tuple[int, ...], row: int, words: str
) -> None:
    assert (row_to_draw(ran(*moving), ran(*still)), drawn_of(ran(*moving), ran(*still))) == (row, words)


@pytest.mark.parametrize(
    ("physics", "z", "statuses", "hinted"),
    [
        ("wam", -5.0, (OK, BEYOND), True),
        ("wam", -5.0, (OK, OK), False),
        ("wam", 0.0, (OK, BEYOND), False),
        ("linear", -5.0, (OK, BEYOND), False),
        ("wam", [{"kind": "ramp", "to": -5.0, "rate": 2.0}], (OK, BEYOND), False),
    ],
)
def test_a_force_that_is_wanted_at_once_is_told_where_the_arm_fails(
    physics: str, z: Any, statuses: tuple[int, ...], hinted: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    experiment = Experiment.from_dict({"physics": physics, "stiffness": [375.0, 810.0], "reference": {"z": z}})
    _statuses("", ran(*statuses), experiment)
    assert ("reference.z is wanted at once" in capsys.readouterr().out) == hinted


def test_freezing_a_family_tells_the_worst_of_all_that_it_declares(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    frozen = SimpleNamespace(
        margins=[{"M_s": 1.9}], family={"rows": [{"M_s": 1.25}, {"M_s": 1.99}]}, floor={}, arm=None
    )

    def freeze(path: Path, *_: Any, **__: Any) -> Any:
        path.touch()
        return frozen

    monkeypatch.setattr("jaxmpc.terminal.process.use_all_cores", lambda: None)
    monkeypatch.setattr("jaxmpc.export.freezing.freeze_controller", freeze)
    for told in ("1.990", "1.900"):
        assert main(["freeze", "text", "-o", str(tmp_path / "controller.npz")]) == 0
        assert f"worst M_s {told}" in capsys.readouterr().out
        frozen.family = None


def test_a_frozen_controller_in_the_place_of_parameters_is_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"controller\.npz: must be a params\.toml, .* A frozen controller is flown"):
        params_from(str(tmp_path / "controller.npz"))
