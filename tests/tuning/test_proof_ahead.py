"""What is compiled beside the search is what its proof runs."""

from concurrent.futures import Executor
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax
import numpy as np
import pytest

from jaxmpc.engine.base import ProgramSpec
from jaxmpc.files.errors import InputError
from jaxmpc.metrics import Metrics
from jaxmpc.report.loops import curves
from jaxmpc.synthesis.params import Params
from jaxmpc.xla.shared import kind_of
from tuning import TuneSpec
from tuning.job.scenarios import scenarios
from tuning.objective import comparison
from tuning.proof import flyable, found, split
from tuning.proof.ahead import programs
from tuning.search import ahead
from tuning.search.run import SearchHistory


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
    for rehearsed in ("flyable.rehearse", "found.rehearse", "split.rehearse", "curves"):
        monkeypatch.setattr(f"tuning.proof.ahead.{rehearsed}", lambda *_: None)
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


def test_margins_causes_and_curves_run_what_was_rehearsed() -> None:
    """Nothing is compiled for the tuned controller, which the search begins with another of."""
    spec = job(tune={"starts": 2, "duration": 4.0, "train_seeds": [0, 1]})
    for rehearsal in programs(spec):
        if getattr(rehearsal, "func", None) in (found.rehearse, split.rehearse, curves):
            rehearsal()
    compiled: list[str] = []

    def heard(event: str, seconds: float, **_: Any) -> None:
        if "backend_compile" in event:
            compiled.append(event)

    tuned = spec.space.exact(spec.space.encode(spec.space.base) + 0.1)
    last: Any = SimpleNamespace(state=SimpleNamespace(feasible=True))
    jax.monitoring.register_event_duration_secs_listener(heard)
    try:
        result = found.found_of(SearchHistory(spec, [last], {}), tuned)
        split.split(result)
        curves(tuned, spec.experiment, spec.ideal)
    finally:
        jax.monitoring.unregister_event_duration_listener(heard)
    assert compiled == []
    assert np.isfinite(result.judged(1).margins.M_s).all()


@pytest.mark.parametrize(("backend", "proof"), [("gpu", ["proof"]), ("cpu", [])])
def test_a_gpus_idle_cores_compile_the_proof_right_behind_the_search(
    backend: str, proof: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a CPU the descent needs the cores: there who searches has it begin later."""
    compiled: list[str] = []

    def compiling(*_: Any) -> None:
        compiled.append("search")

    class Told:
        compile_margins = compile_runs = compile_evaluation = compile_cells = staticmethod(compiling)
        data = SimpleNamespace(reference=None)

    class AtOnce(Executor):
        def submit(self, task: Any, /, *arguments: Any, **named: Any) -> Any:
            task(*arguments, **named)

    monkeypatch.setattr(jax, "default_backend", lambda: backend)
    monkeypatch.setattr(ahead, "problem_of", lambda *_, begun, **__: begun(Told))
    monkeypatch.setattr(ahead, "spectra_of", lambda *_: Told)
    monkeypatch.setattr(ahead, "Constraints", lambda *_: Told)
    own: Any = Told
    ahead.readied(job(), own, AtOnce(), lambda _: [lambda: compiled.append("proof")])
    assert compiled == ["search"] * 4 + proof
