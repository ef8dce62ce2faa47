"""One small problem for all tests here: whatever is data may differ, so it compiles once."""

from collections.abc import Callable
from typing import Any

import pytest

from tuning import TuneSpec


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
