"""What a machine remembers of its runs: how fast rows are, what starting costs, and what compiling adds."""

import json
import os
import pickle
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import msgspec
import numpy as np
import pytest

from jaxmpc.xla import store
from sweeps import rates
from sweeps.axis import SweepAxis
from sweeps.blocks import block_of, padded, programs
from sweeps.compiling import Compiling, so_far
from sweeps.dry_run import dry_run
from sweeps.engines import Devices, devices
from sweeps.pace import Pace
from sweeps.plan import Plan, make_plan
from sweeps.space import make_space
from sweeps.spec import SweepSpec

DEVICES, PER_ROW, START, COMPILE = Devices(2, "a processor"), 0.01, 2.0, 10.0


@pytest.fixture
def plan(spec: SweepSpec) -> Plan:
    return make_plan(spec)


@pytest.fixture
def longer(spec: SweepSpec) -> Plan:
    """Twice the samples: another program."""
    return make_plan(replace(spec, experiment=msgspec.structs.replace(spec.experiment, duration=2.0)))


def paced(plan: Plan, compiling: Compiling, start: float = START) -> Pace:
    """Of a run whose first round started and compiled."""
    width = block_of(plan) * DEVICES.number
    pace = Pace(None, width, plan.largest_chunk)
    pace.tell(width, PER_ROW * width + start + compiling.spent, compiling)
    for _ in range(3):
        pace.tell(width, PER_ROW * width)
    return pace


def seconds(plan: Plan, per_row: float = PER_ROW) -> float:
    return per_row * padded(plan, DEVICES.number, 0, len(plan.rows))


def test_what_was_compiled_before_is_loaded(plan: Plan, longer: Plan, tmp_path: Path) -> None:
    where = tmp_path / "rates.json"
    assert rates.estimate(plan, DEVICES, where=where) is None
    rates.record(plan, paced(plan, Compiling(COMPILE, COMPILE)), DEVICES, where)
    again = rates.estimate(plan, DEVICES, where=where)
    assert again is not None
    assert again.remembered
    assert again.seconds == pytest.approx(START + seconds(plan))
    other = rates.estimate(longer, DEVICES, where=where)
    assert other is not None
    assert not other.remembered
    assert other.seconds == pytest.approx(START + COMPILE + seconds(longer, 2.0 * PER_ROW))


def test_a_loaded_program_says_what_compiling_takes(plan: Plan, longer: Plan, tmp_path: Path) -> None:
    where = tmp_path / "rates.json"
    rates.record(plan, paced(plan, Compiling(0.5, COMPILE)), DEVICES, where)
    other = rates.estimate(longer, DEVICES, where=where)
    assert other is not None
    assert other.start_s == pytest.approx(START + COMPILE)


def test_a_second_run_of_one_process_leaves_what_starting_takes(plan: Plan, tmp_path: Path) -> None:
    where = tmp_path / "rates.json"
    rates.record(plan, paced(plan, Compiling(COMPILE, COMPILE)), DEVICES, where)
    rates.record(plan, paced(plan, Compiling(), start=0.0), DEVICES, where)
    again = rates.estimate(plan, DEVICES, where=where)
    assert again is not None
    assert again.start_s == pytest.approx(START)


def test_without_a_cache_of_programs_compiling_counts(
    plan: Plan, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    where = tmp_path / "rates.json"
    rates.record(plan, paced(plan, Compiling(COMPILE, COMPILE)), DEVICES, where)
    config: Any = jax.config
    request.addfinalizer(partial(config.update, "jax_enable_compilation_cache", config.jax_enable_compilation_cache))
    config.update("jax_enable_compilation_cache", False)
    again = rates.estimate(plan, DEVICES, where=where)
    assert again is not None
    assert again.start_s == pytest.approx(START + COMPILE)


@pytest.mark.parametrize("entry", [{"6000": [0.01, 2.0]}, {"6000": []}, {"6000": 3.0}, [], None])
def test_rates_of_another_version_are_none(plan: Plan, tmp_path: Path, entry: object) -> None:
    where = tmp_path / "rates.json"
    where.write_text(json.dumps({rates.kind_of(plan, DEVICES): entry}))
    assert rates.estimate(plan, DEVICES, where=where) is None
    rates.record(plan, paced(plan, Compiling(COMPILE, COMPILE)), DEVICES, where)
    assert rates.estimate(plan, DEVICES, where=where) is not None


@pytest.mark.parametrize(
    ("samples", "entry"),
    [
        *(("600", entry) for entry in ([0.0, 1.0, 1.0], [None, 1.0, 1.0], ["1", 1.0, 1.0], [1.0, float("nan"), 1.0])),
        ("0", [PER_ROW, START, COMPILE]),
        ("many", [PER_ROW, START, COMPILE]),
    ],
)
def test_rates_that_no_run_left_are_none(plan: Plan, tmp_path: Path, samples: str, entry: list[Any]) -> None:
    where = tmp_path / "rates.json"
    where.write_text(json.dumps({rates.kind_of(plan, DEVICES): {samples: entry}}))
    assert rates.estimate(plan, DEVICES, where=where) is None
    rates.record(plan, paced(plan, Compiling(COMPILE, COMPILE)), DEVICES, where)
    assert rates.estimate(plan, DEVICES, where=where) is not None


def test_who_has_no_home_keeps_no_rates(plan: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Under a user whom the system does not know, as in many containers, every sweep ended in a traceback."""
    for name in ("HOME", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(os, "getuid", lambda: 54_321)  # of no entry among the users
    monkeypatch.chdir(tmp_path)
    rates.record(plan, paced(plan, Compiling(COMPILE, COMPILE)), DEVICES)
    assert rates.estimate(plan, DEVICES) is None
    assert not list(tmp_path.iterdir())


def test_compiling_is_heard_of() -> None:
    before = so_far()
    jax.jit(lambda x: jnp.sin(x) * 3.125)(jnp.arange(3.0)).block_until_ready()
    took = so_far().since(before)
    assert 0.0 < took.spent < 60.0
    assert took.anew > 0.0
    before = so_far()
    jnp.arange(3.0)
    assert so_far().since(before).spent == 0.0


def slow_to_trace(x: Any) -> Any:
    time.sleep(0.3)
    return x + 1.0


def test_a_trace_that_is_kept_says_what_tracing_takes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(store, "_folder", tmp_path)
    took = []
    for _ in range(2):
        before = so_far()
        assert store.program("name", slow_to_trace, {"x": np.ones(3)}, {}) is not None
        took.append(so_far().since(before))
    traced, loaded = took
    assert min(traced.spent, traced.anew, loaded.anew) >= 0.3
    assert loaded.spent < 0.3


def test_rates_are_of_the_device_and_engine_that_will_run(spec: SweepSpec, tmp_path: Path) -> None:
    plan, file, pace = make_plan(spec), tmp_path / "rates.json", Pace(None, 256, 10_000)
    pace.tell(256, 9.0)
    pace.tell(256, 1.0)
    here = devices(2)
    rates.record(plan, pace, here, file)
    found = rates.estimate(plan, here, where=file)
    assert found is not None
    assert found.rate == 256.0
    for other in (Devices(1, "NVIDIA H100"), Devices(4, here.kind)):
        assert rates.estimate(plan, other, where=file) is None
    on_kernel = Plan(plan.canonical, plan.files, plan.goal, "kernel")
    assert pickle.loads(pickle.dumps(on_kernel)).engine == "kernel"
    assert on_kernel.spec_hash == plan.spec_hash
    assert rates.estimate(on_kernel, here, where=file) is None


def test_rows_of_other_lengths_count_and_leave_no_rate(
    spec: SweepSpec, plan: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    where = tmp_path / "rates.json"
    monkeypatch.setattr(rates, "kept_in", lambda: where)

    def swept(name: str, scale: Any, *values: Any, relative: bool = False) -> SweepSpec:
        axis = SweepAxis(name, scale, values, relative)
        factors = ((axis,), *((each,) for each in spec.space.axes))
        return replace(spec, space=make_space("grid", factors, 0, 0, spec.space.horizons))

    lengths, there = swept("duration", "list", 1.0, 3.0), devices(2)
    mixed = make_plan(lengths)
    for unlike in (lengths, swept("physics", "choice", "linear", "wam"), swept("arm.substeps", "choice", 1, 2)):
        rates.record(make_plan(unlike), paced(make_plan(unlike), Compiling()), there)
        assert not where.exists()
        assert "unknown: an axis changes what a row costs" in dry_run(unlike, make_plan(unlike), 2, measure=True)
    assert "axis-steps  2.88e+06\n" in dry_run(lengths, mixed, 2, measure=False)
    assert rates.samples_of(mixed) == 2.0 * rates.samples_of(plan) == 4000.0
    assert rates.samples_of(make_plan(swept("sampling_time", "list", 1.0, 0.5, relative=True))) == 3000.0
    # What is known of rows of one length tells of both.
    one = make_plan(swept("force_limit", "list", 10.0, 20.0))
    rates.record(one, paced(one, Compiling()), there)
    even, both = rates.estimate(one, there), rates.estimate(mixed, there)
    assert even is not None
    assert both is not None
    assert both.rate == pytest.approx(even.rate / 2.0)
    # Each length is a program of its own.
    rates.record(one, paced(one, Compiling(COMPILE, COMPILE)), there)
    compiled = rates.estimate(mixed, there)
    assert compiled is not None
    assert compiled.start_s == pytest.approx(START + 2 * COMPILE)
    assert rates.estimate(make_plan(swept("physics", "choice", "linear", "wam")), there) is None


def test_programs_are_counted_among_the_rows() -> None:
    zipped = {"kind": "grid", "zip": [{"architecture": ["mpc", "aob"], "guarded": [False, True], "lam": [0.1, 0.2]}]}
    drawn = {"kind": "random", "rows": 6, "axes": {"duration": {"linear": [20.0, 30.0]}, "lam": [0.1, 0.2]}}
    for table, name, count in ((zipped, "table-1-wam", 2), (drawn, "table-1", 6)):
        spec = SweepSpec.from_dict({"experiment": {"published": name}, "sweep": table})
        assert programs(make_plan(spec)) == count
