"""Five hundred drawn controllers on two tissues, in float32 and float64, for tests."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from sweeps.compute import compute
from sweeps.plan import make_plan
from sweeps.result import Result
from sweeps.spec import SweepSpec
from sweeps.tables import Precision
from tests.sweeps.short_experiment import EXPERIMENT

ROWS = 500
DATA: dict[str, Any] = {
    "experiment": EXPERIMENT,
    "params": {"published": "text"},
    "sweep": {
        "kind": "random",
        "rows": ROWS,
        "constraints": {"M_s": 5.0},
        "axes": {
            "lam": {"log": [0.01, 10.0]},
            "Q_p": {"log": [0.02, 5.0]},
            "T_cl": {"log": [0.001, 0.02]},
            "K2": {"linear": [5.0, 50.0]},
            "Hp": [5, 10, 20, 30],
        },
    },
}


@cache
def drawn_rows(precision: Precision) -> Result:
    """Every row of them."""
    plan = make_plan(replace(SweepSpec.from_dict(DATA), precision=precision))
    return Result.of(plan, compute(plan, 0, ROWS), np.ones(ROWS, bool))
