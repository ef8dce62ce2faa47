"""A result by name: its columns, controllers, baseline, counts and stages."""

from pathlib import Path

import numpy as np
import pytest

from jaxmpc.files.errors import InputError
from jaxmpc.synthesis.params import Params
from sweeps.result import Result
from sweeps.store import stage_folders

Finished = tuple[Path, Result]
ROWS = 120


def test_a_row_is_a_controller(finished: Finished) -> None:
    _, result = finished
    controller, base = result.controller(7), Params.published("text")
    for name in ("lam", "T_cl", "Hp"):
        assert float(getattr(controller, name)) == result[name][7]
    assert float(controller.K2) == float(base.K2)
    assert controller.batch_shape == ()


def test_the_baseline_is_the_base_controller(finished: Finished) -> None:
    _, result = finished
    assert result.baseline is not None
    # λ = 0.1 and T_cl = 4.47e-3 are on the grid, the text design's T_cl = 3e-3 is not; M_s is the published one.
    assert result.baseline.M_s == pytest.approx(4.53, rel=0.01)


def test_counts_add_up(finished: Finished) -> None:
    _, result = finished
    counts = result.status_counts()
    assert sum(counts.values()) == 2 * ROWS
    assert counts["OK"] == (result["status"] == 0).sum() > 0
    assert counts["UNSTABLE"] == np.isinf(result["M_s"]).sum() > 0


def test_an_unknown_column_is_named(finished: Finished) -> None:
    with pytest.raises(InputError, match="Did you mean 'M_s'"):
        finished[1]["Ms"]


def test_a_row_that_is_not_there_has_neither_controller_nor_experiment(finished: Finished) -> None:
    best = finished[1].best(1, 1.01)
    for asked in best.controller, best.experiment:
        with pytest.raises(InputError, match=r"0 rows.*that keep the constraints"):
            asked(0)
    with pytest.raises(InputError):
        finished[1].controller(len(finished[1]))


def test_stages_come_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    names = ["0-full", "1-around", "2-around", "9-around", "10-rerun"]
    for name in (*reversed(names), "3-begun"):
        (tmp_path / "stages" / name).mkdir(parents=True)
    for name in names:
        (tmp_path / "stages" / name / "manifest.json").touch()
    assert [path.name for path in stage_folders(tmp_path)] == names
