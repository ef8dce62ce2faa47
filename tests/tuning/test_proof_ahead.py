"""What is compiled beside the search is what its proof runs."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jaxmpc.engine.base import ProgramSpec
from jaxmpc.files.errors import InputError
from jaxmpc.metrics import Metrics
from jaxmpc.synthesis.params import Params
from jaxmpc.xla.shared import kind_of
from tuning import TuneSpec
from tuning.job.scenarios import scenarios
from tuning.objective import comparison
from tuning.proof import flyable
from tuning.proof.ahead import programs


class Recorded:
    """A program that is compiled and run on paper."""

    def __init__(self) -> None:
        self.compiled: list[Any] = []
        self.ran: list[Any] = []

    def compile(self, batch: Params, scene: Any, world: ProgramSpec) -> None:
        self.compiled.append((kind_of((batch, scene)), world))

    def __call__(self, batch: Params, scene: Any, world: ProgramSpec) -> Metrics:
        self.ran.append((kind_of((batch, scene)), world))
        scenes = scene.signals.force_ref.shape[0] // 3
        return Metrics(*[np.ones((len(batch.lam), scenes, len(scene.stiffness), 3))] * len(Metrics._fields))


def job(**tables: dict[str, Any]) -> TuneSpec:
    base: dict[str, Any] = {
        "experiment": {"published": "table-1-wam", "duration": 4.0, "settle": 3.0},
        "tune": {"starts": 2, "validation_seeds": [500], "heldout_seeds": list(range(1000, 1014)), "duration": 4.0},
        "goals": {"soft": {"rms": 0.1}},
    }
    return TuneSpec.from_dict({**base, **tables})


@pytest.mark.parametrize(
    "spec",
    [job(), job(params={"published": "text", "guarded": True}, baseline={"published": "text"})],
    ids=["alike", "before and after apart"],
)
def test_comparisons_run_what_was_compiled(spec: TuneSpec, monkeypatch: pytest.MonkeyPatch) -> None:
    run = Recorded()
    monkeypatch.setattr(comparison, "_run", run)
    monkeypatch.setattr("tuning.proof.ahead.rehearse", lambda _: None)
    for program in programs(spec):
        program()
    tuned = spec.space.exact(spec.space.encode(spec.space.base) + 0.1)
    for seeds, candidates in ((spec.tune.validation_seeds, [tuned] * 2), (spec.tune.heldout_seeds, [tuned])):
        comparison.versus(spec, candidates, scenarios(spec.experiment, spec.scenarios, seeds))
    assert run.ran
    assert all(one in run.compiled for one in run.ran)
    assert all(one in run.ran for one in run.compiled), "nothing is compiled in vain"


def test_freezing_is_rehearsed_with_what_the_search_begins_with(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever its margins are; one that cannot be frozen spoils nothing."""
    asked: list[tuple[Path, Params, float]] = []

    def freeze(path: Path, params: Params, _: Any, floor: dict[str, float], ideal: bool) -> None:
        asked.append((path, params, floor["M_s"]))
        raise InputError("spectral radius", 1.2, "below 1", "Tune it.")

    monkeypatch.setattr(flyable, "freeze_controller", freeze)
    spec = job()
    flyable.rehearse(spec)
    ((path, params, floor),) = asked
    assert not path.parent.exists()
    assert params is spec.space.base
    assert floor > 1e300
    flyable.rehearse(job(experiment={"published": "table-1", "duration": 4.0, "settle": 3.0}))
    assert len(asked) == 1, "of the linear loop nothing flies"
