"""A small refined sweep for tests."""

from typing import Any

from sweeps.spec import SweepSpec
from tests.sweeps.short_experiment import EXPERIMENT

STAGE = {"keep": 12, "experiment": {"duration": 0.6, "settle": 0.3}}
DATA: dict[str, Any] = {
    "experiment": EXPERIMENT,
    "params": {"published": "cautious"},
    "sweep": {
        "kind": "random",
        "rows": 100,
        "constraints": {"M_s": 3.0},
        "seed": 1,
        "decide": 0,
        "axes": {"lam": {"log": [0.01, 1.0]}, "T_cl": {"log": [0.001, 0.01]}, "Hu": [2, 5, 10]},
    },
}


def made(**table: Any) -> SweepSpec:
    return SweepSpec.from_dict({**DATA, "refine": table})
