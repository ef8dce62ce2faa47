"""What has been compiled or traced once is not again, in this process or the next."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

from jaxmpc import Experiment, Params, evaluation, stability, synthesis
from jaxmpc.cli.simulate import simulated, with_heart_still, without_motion
from jaxmpc.terminal.process import use_all_cores
from jaxmpc.xla import store
from jaxmpc.xla.once import JitOnce
from tests.jaxmpc.short_table import experiment_file


@contextmanager
def compilations() -> Iterator[list[str]]:
    """Programs that XLA compiles meanwhile."""
    seen: list[str] = []

    def listen(event: str, seconds: float, **_: Any) -> None:
        if event == "/jax/core/compile/backend_compile_duration":
            seen.append(event)

    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        yield seen
    finally:
        jax.monitoring.unregister_event_duration_listener(listen)


def assert_second_run_compiles_nothing(experiment: Experiment) -> None:
    with compilations() as first:
        simulated(Params(), experiment, traced=True)
    with compilations() as second:
        simulated(Params(), without_motion(experiment), traced=True)
    assert len(first) > 0
    assert second == []


def test_heart_still_is_served_by_the_program_of_heart_moving() -> None:
    """A length of its own, so that no other test has compiled it before."""
    base = Experiment.published("table-1").to_dict()
    assert_second_run_compiles_nothing(Experiment.from_dict(base | {"duration": 6.123}))


@pytest.mark.slow
def test_heart_still_is_served_by_the_program_of_heart_moving_on_the_arm() -> None:
    base = Experiment.published("rhythm-steady").to_dict()
    assert_second_run_compiles_nothing(Experiment.from_dict(base | {"duration": 6.123}))


def test_second_run_traces_nothing_and_finds_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A second process is one whose programs have all been forgotten; the first kept them where the command does."""
    use_all_cores()
    monkeypatch.setattr(store, "_folder", tmp_path / "traced")
    experiment = Experiment.from_toml(experiment_file(tmp_path))
    modules = evaluation, stability, synthesis
    programs = [
        (module, name) for module in modules for name, value in vars(module).items() if isinstance(value, JitOnce)
    ]

    def forget() -> None:
        for module, name in programs:
            program = getattr(module, name)
            monkeypatch.setattr(module, name, JitOnce(program._function, program._static))

    forget()
    first = with_heart_still(Params(), experiment)
    monkeypatch.setattr(store, "_traced", None)
    forget()
    second = with_heart_still(Params(), experiment)
    jax.tree.map(np.testing.assert_array_equal, second, first)
    kept = {name: [*getattr(module, name)._kept.values()] for module, name in programs}
    assert {name for name, found in kept.items() if found} >= {"_design", "_block", "_run", "_outcome"}
    assert all(one is not None for found in kept.values() for one in found)
