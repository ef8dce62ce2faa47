"""Which engine runs a job's loops: the fastest where they are only evaluated, or the one that somebody names."""

import dataclasses
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from msgspec.structs import replace

import tuning
from jaxmpc.cli import main
from jaxmpc.engine.base import ProgramSpec
from jaxmpc.files.errors import InputError
from jaxmpc.metrics import Metrics
from tuning import TuneSpec
from tuning.job.scenarios import scenarios
from tuning.objective import comparison
from tuning.objective.problem import problem_of, training


@pytest.fixture
def spec() -> TuneSpec:
    """A job on the arm; no goal is a ratio, so that nothing runs while it is made."""
    return TuneSpec.from_dict({"experiment": {"published": "table-1-wam"}, "goals": {"soft": {"rms": 0.1}}})


@pytest.fixture
def on_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")


@pytest.mark.usefixtures("on_gpu")
def test_runs_that_are_only_evaluated_are_the_kernels_where_there_is_a_gpu(spec: TuneSpec) -> None:
    """What is differentiated, as a front is, keeps the scan and its reverse mode."""
    met = training(spec, [0])
    found = [problem_of(spec, met, evaluated=evaluated).structure.world.engine for evaluated in (True, False)]
    assert found == ["kernel", "scan"]


@pytest.mark.usefixtures("on_gpu")
def test_who_names_the_scan_gets_it_and_the_same_job(spec: TuneSpec) -> None:
    named = replace(spec, engine="scan")
    assert problem_of(named, training(named, [0]), evaluated=True).structure.world.engine == "scan"
    assert named.digest == spec.digest


@pytest.mark.usefixtures("on_gpu")
@pytest.mark.parametrize(("engine", "expected"), [(None, "kernel"), ("scan", "scan")])
def test_so_do_the_comparisons(
    engine: str | None, expected: str, spec: TuneSpec, monkeypatch: pytest.MonkeyPatch
) -> None:
    ran = []

    def run(batch: Any, scene: Any, world: ProgramSpec) -> Metrics:
        ran.append(world.engine)
        return Metrics(*[np.zeros((len(batch.lam), 1, 3, 3))] * len(Metrics._fields))

    monkeypatch.setattr(comparison, "_run", run)
    met = scenarios(spec.experiment, spec.scenarios, [0])
    comparison.versus(replace(spec, engine=engine), [spec.params], met)
    assert set(ran) == {expected}


@pytest.mark.usefixtures("on_gpu")
def test_one_program_of_the_kernel_serves_validation_and_what_is_held_out(
    spec: TuneSpec, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Filled up to what either needs, and each gets what was found of its own."""
    shapes = set()

    def run(batch: Any, scene: Any, world: ProgramSpec) -> Metrics:
        scenes = len(scene.signals.force_ref)
        shapes.add((len(batch.lam), scenes))
        each = np.asarray(batch.lam)[:, None] + np.arange(scenes)
        return Metrics(*[np.broadcast_to(each[..., None, None], (*each.shape, 3, 3))] * len(Metrics._fields))

    monkeypatch.setattr(comparison, "_run", run)
    job = replace(spec, tune=replace(spec.tune, starts=2, validation_seeds=(500, 501), heldout_seeds=(7, 8, 9)))
    candidates = [dataclasses.replace(spec.params, lam=lam) for lam in (0.2, 0.3)]
    for seeds, some in ((job.tune.validation_seeds, candidates), (job.tune.heldout_seeds, candidates[1:])):
        before, each = comparison.versus(job, some, scenarios(job.experiment, job.scenarios, seeds))
        for params, found in zip([job.before, *some], [before, *each], strict=True):
            expected = float(np.mean(params.lam)) + np.arange(len(seeds))
            np.testing.assert_allclose(found.rms[:, 0, 0], expected, rtol=1e-6)  # in float32
    assert shapes == {(3, 3)}


def test_the_command_line_hands_the_engine_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    engines = []

    def told(spec: TuneSpec, *_: Any, **__: Any) -> None:
        engines.append(spec.engine)
        raise InputError("tune", "told", "enough", "Stop here.")

    monkeypatch.setattr(tuning, "tune", told)
    for words in ((), ("--engine", "scan")):
        assert main(["tune", "arm-tune", "-o", str(tmp_path), "--quiet", *words]) == 2
    assert engines == [None, "scan"]
