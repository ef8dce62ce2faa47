"""One loop: whoever says M_s of a design on an experiment says the same number, whatever its filters and delays."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

from deploy.controller.file import load
from jaxmpc import Experiment, InputError, Margins, Params, evaluate, margins
from jaxmpc.closed_loops import close_loops
from jaxmpc.experiment.tables import SensorSettings
from jaxmpc.export.freezing import freeze_controller
from tuning import TuneSpec
from tuning.objective.measures import Data, judged_margins
from tuning.objective.problem import problem_of, training

STIFFNESS = (375.0, 810.0)
EXPERIMENT = {"damping": "sampled", "stiffness": list(STIFFNESS), "duration": 3.5, "settle": 3.0, "delay": 2}
SLOW_FILTERS = {"velocity_lowpass": 300.0, "sensor": {"lowpass_hz": 120.0}}
FORCE_FILTER = {"sensor": {"kalman": 20.0}}


@pytest.mark.oracle
@pytest.mark.parametrize("filters", [{}, SLOW_FILTERS, FORCE_FILTER], ids=["default", "slower", "force filter"])
def test_everybody_judges_one_loop(
    small: Callable[..., dict[str, Any]], tmp_path: Path, filters: dict[str, Any]
) -> None:
    experiment, params = Experiment.from_dict({**EXPERIMENT, **filters}), Params.published("cautious")
    found = np.asarray(margins(params, STIFFNESS, path=experiment.loop_path()).M_s)
    assert (np.abs(found / np.asarray(margins(params, STIFFNESS, delay=2).M_s) - 1.0) > 5e-4).any() == bool(filters)

    evaluated = np.asarray(evaluate(params, experiment).margins.M_s)
    job = small(experiment={**EXPERIMENT, **filters}, tune={"duration": 3.5, "settle": 3.0}, goals={"ideal": False})
    spec = TuneSpec.from_dict(job)
    problem = problem_of(spec, training(spec, [0]))

    def tuned_margins(batch: Params, data: Data) -> Margins:
        return judged_margins(close_loops(batch, data.scene.stiffness, data.scene.path), data)

    tuned = jax.tree.map(lambda field: field[0], jax.jit(tuned_margins)(Params.stack([params]), problem.data))
    at = np.searchsorted(spec.judged_at, STIFFNESS)
    freeze_controller(tmp_path / "a.npz", params, experiment, {"M_s": float(found.max()) + 1e-6}, ideal=False)
    frozen = {row["stiffness"]: row["M_s"] for row in load(tmp_path / "a.npz").margins}
    for others in (evaluated, np.asarray(tuned.M_s)[at], [frozen[K_s] for K_s in STIFFNESS]):
        np.testing.assert_allclose(others, found, rtol=1e-9)
    with pytest.raises(InputError, match="M_s at"):
        freeze_controller(tmp_path / "b.npz", params, experiment, {"M_s": float(found.max()) - 1e-6}, ideal=False)


def test_filters_that_are_told_count_and_the_default_is_one() -> None:
    told, silent = Experiment(damping="sampled", velocity_lowpass=300.0), Experiment(physics="wam", delay=2)
    assert told.loop_path().velocity_cutoff == 300.0
    assert silent.loop_path().sensor_cutoff == told.loop_path().sensor_cutoff == pytest.approx(2.0 * np.pi * 500.0)
    assert (silent.loop_path().ideal, silent.loop_path().delay) == (False, 2)
    assert Experiment().loop_path().ideal
    assert Experiment().loop_path().sensor_cutoff == Experiment().loop_path(ideal=True).sensor_cutoff == 0.0
    assert Experiment().loop_path(ideal=False).sensor_cutoff == silent.loop_path().sensor_cutoff
    for lowpass_hz in (0.0, 100.0):
        explicit = Experiment(sensor=SensorSettings(lowpass_hz=lowpass_hz))
        for ideal in (True, False):
            assert explicit.loop_path(ideal).sensor_cutoff == pytest.approx(2.0 * np.pi * lowpass_hz)
