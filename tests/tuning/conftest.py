"""One small problem for all tests here: whatever is data may differ, so it compiles once; and a result, made up."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest

from jaxmpc.metrics import Metrics
from jaxmpc.report.loops import Curves
from jaxmpc.stability import Margins
from tuning import TuneResult, TuneSpec
from tuning.proof.limits import Active, LimitStudy
from tuning.proof.sensitivities import Sensitivities
from tuning.proof.split import Split
from tuning.reports.explained import Study
from tuning.search.run import Step
from tuning.search.state import SearchState

Job = Callable[..., dict[str, Any]]
SEEDS = (1000, 1001, 1002, 1007)


@pytest.fixture
def small() -> Callable[..., dict[str, Any]]:
    """A function that gives a small job as its TOML file would; its arguments replace or add tables' keys."""

    def job(**tables: dict[str, Any]) -> dict[str, Any]:
        base: dict[str, dict[str, Any]] = {
            "experiment": {},
            "params": {},
            "tune": {
                "starts": 8,
                "steps": 10,
                "train_seeds": [0],
                "heldout_seeds": [1000, 1001],
                "duration": 5.0,
                "settle": 1.2,
                "margin_points": 0,
            },
            "goals": {"ideal": True},
        }
        return {name: {**base.get(name, {}), **tables.get(name, {})} for name in (*base, *tables)}

    return job


@pytest.fixture
def spec(small: Callable[..., dict[str, Any]]) -> TuneSpec:
    return TuneSpec.from_dict(small())


@pytest.fixture
def result(small: Job) -> TuneResult:
    """A made-up one: scenario 1001 was lost before, M_s is active, λ is a diagonal, before has another structure."""
    spec = TuneSpec.from_dict(
        small(
            baseline={"disturbance_order": 2, "Q_p": 1e-3},
            tune={
                "heldout_seeds": list(SEEDS),
                "validation_seeds": [500],
                "margin_points": 5,
                "free": {"lam": True, "Q_p": True, "Hp": True},
                "diagonals": ["lam"],
            },
            goals={"M_s": 2.0, "delay_margin_s": 1e-3, "ideal": False, "soft": {"rms": 0.1, "peak_to_peak_ratio": 1.0}},
        )
    )
    # No file may give such a name; should one come another way, the page must not believe it.
    msgspec.structs.force_setattr(spec.experiment, "name", '<b>"a & b"</b>')
    random = np.random.default_rng(0)
    heldout = Metrics(*(random.uniform(0.02, 0.08, (2, len(SEEDS), 3, 3)) for _ in Metrics._fields))
    heldout.peak_error[0, 1, 2] = 3.0
    judged = len(spec.judged_at)
    M_s = np.stack([np.linspace(5.0, 3.0, judged), np.linspace(1.4, 1.98, judged)])
    one = np.ones((2, judged))
    found = Margins(M_s, 6.0 * one, 7.0 * one, 40.0 * one, 2e-3 * one, 0.9 * one, 0.0 * one)
    state = SearchState.new(spec.space.draw(2, 0), None, 3, (2, 2))
    for iteration in range(3):
        state.record(_values(0.9 - 0.1 * iteration, judged), exact=True, worth=0.0)
        state.iteration += 1
    problem: Any = SimpleNamespace(hard_goals=())
    steps = [Step("linear", problem, state)]
    margins = {"as run": found, "ideal": found}
    params = spec.space.exact(state.leader_z)
    return TuneResult(spec, params, True, margins, (None, None), steps, {1: 0.5, 2: 0.7}, heldout)


def _values(hard: float, judged: int) -> Any:
    cells = Metrics(*(np.full((2, 3, 1, 3), 0.05) for _ in Metrics._fields))
    numbers = {"score": np.array([hard, 1.0]), "worst": np.full(2, 0.05), "tissue": np.zeros(2, int), "cells": cells}
    return SimpleNamespace(**numbers, M_s=np.full((2, judged), 1.9), hard=np.full((2, 2), hard), soft=np.ones((2, 2)))


@pytest.fixture
def study() -> Study:
    frequency, time = np.geomspace(0.1, 500.0, 40), np.arange(50) * 1e-3
    loop = np.tile(10.0 / (1j * frequency), (3, 1))
    curve = Curves(frequency, loop, time, np.tile(1.0 - np.exp(-time / 0.01), (3, 1)))
    slopes = np.arange(18.0).reshape(2, 3, 3) / 10.0
    metrics, parameters = ("score", "M_s"), ("lam", "Q_p", "Hp")
    parts = (np.full((2, 3, 3), size) for size in (0.05, 0.03, 0.04, 0.01))
    return Study(
        (curve, curve),
        Sensitivities(metrics, parameters, np.ones((2, 3)), slopes),
        Split(*parts),
        LimitStudy([Active("M_s", 1900.0, 0.99, 0.5)], 0.2),
    )
