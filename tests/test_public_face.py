"""Every public object shows what it holds: values with units, in lines of at most 100 columns."""

import re
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

import sweeps
import tuning
from jaxmpc import Experiment, InputError, Margins, Params, Status, Timing, design, evaluate, margins
from jaxmpc.metrics import Metrics
from jaxmpc.quantities import MARGINS, METRICS, PARAMETERS
from sweeps.result import Result

ROOT = Path(__file__).parents[1]
PACKAGES = ("jaxmpc", "tuning", "sweeps")
FAMILY = Experiment.published("family-wam")
JOB = tuning.TuneSpec.from_toml(ROOT / "jaxmpc" / "examples" / "arm-tune.toml")
SWEEP = sweeps.SweepSpec.from_toml(ROOT / "jaxmpc" / "examples" / "demo-sweep.toml")
SHORT = Experiment.from_dict({"duration": 0.6, "settle": 0.2, "motion": {"kind": "none"}})


def result_of_a_sweep() -> Result:
    from sweeps.plan import make_plan

    plan = make_plan(SWEEP)
    count = len(plan.rows)
    return Result(plan, {"row": np.arange(count), "status": np.zeros((count, len(plan.stiffness)), int)})


def tuned() -> tuning.TuneResult:
    """A result whose numbers are given, as no test here has an hour to tune."""
    held = Metrics(*(np.full((2, 4, 3, 3), 0.02) * [[[[1.0]]], [[[0.5]]]] for _ in Metrics._fields))
    numbers = np.array([1.5, 8.0, 8.0, 40.0, 2e-3, 0.9])[:, None, None] * np.ones((2, len(JOB.judged_at)))
    found = Margins(*numbers, np.zeros((2, len(JOB.judged_at)), int))
    return tuning.TuneResult(
        JOB, Params.published("cautious"), True, {"as run": found, "ideal": found}, (None, None), [], {}, held
    )


MADE: dict[str, Callable[[], Any]] = {
    "Experiment": lambda: FAMILY,
    "InputError": lambda: InputError("lam", -1.0, "above 0", "Take 0.1.", ROOT / "x.toml", 3),
    "Margins": lambda: margins(Params(), 810.0),
    "Outcome": lambda: evaluate(Params(), SHORT),
    "Params": lambda: Params.published("family"),
    "Status": lambda: Status.UNSTABLE,
    "Timing": Timing,
    "Front": lambda: tuning.Front(
        {"M_s": np.linspace(1.6, 3.0, 5)}, [None] * 5, np.full(5, 0.5), np.ones((5, 1)), None
    ),
    "Risk": tuning.Risk,
    "Scenarios": lambda: tuning.Scenarios(
        ("own", "variability", "premature", "hold"), 0.3, 0.1, 0.2, (1, 2), (15.0, 60.0)
    ),
    "TuneResult": tuned,
    "TuneSettings": tuning.TuneSettings,
    "TuneSpec": lambda: JOB,
    "Result": result_of_a_sweep,
    "SweepSpec": lambda: SWEEP,
}
"""One of each public class."""
RETURNED = {
    "gains": lambda: design(Params()),
    "a batch of gains": lambda: jax.tree.map(lambda x: np.stack([x, x]), design(Params())),
    "metrics": lambda: evaluate(Params(), SHORT).metrics,
    "a batch": lambda: Params.stack([Params()] * 9),
}
"""What public functions return besides."""


def public_classes() -> set[str]:
    named = ((import_module(package), name) for package in PACKAGES for name in import_module(package).__all__)
    return {name for package, name in named if isinstance(getattr(package, name), type)}


def test_every_public_class_is_looked_at() -> None:
    assert set(MADE) == public_classes()


@pytest.mark.parametrize("package", [*PACKAGES, "jaxmpc.experiment"])
def test_completion_offers_what_loads_when_asked_for(package: str) -> None:
    module = import_module(package)
    assert set(module.__all__) <= set(dir(module))
    assert {"__name__", "__doc__"} <= set(dir(module))


@pytest.mark.parametrize("name", [*MADE, *RETURNED])
def test_lines_fit(name: str) -> None:
    lines = repr({**MADE, **RETURNED}[name]()).splitlines()
    assert max(map(len, lines)) <= 100, lines
    assert len(lines) <= 40
    assert not any("…" in line and not any(c.isdigit() for c in line) for line in lines)


def test_gains_have_values_and_units() -> None:
    found = design(Params())
    text = repr(found)
    assert f"{float(found.K[0]):.4g}, {float(found.K[1]):.4g}" in text
    assert re.search(r"mpc_ref .*\(64,\) +-", text)
    for name in ("phi", "gamma", "K", "L", "input_gain", "mpc_ref", "mpc_x", "mpc_u"):
        assert f"\n  {name} " in text
    assert "m/(s² N)" in text
    shown = []
    jax.jit(lambda lam: shown.append(repr(design(Params(lam=lam)))) or lam)(0.1)
    assert "traced" in shown[0]


def test_a_tuned_result_tells_before_and_after() -> None:
    text = repr(tuned())
    assert text.startswith("TuneResult, every goal met")
    assert "0.02 → 0.01 N" in text
    own = [PARAMETERS[name] for name in tuned().params.numbers]
    for row in (METRICS["rms"], *MARGINS.values(), *own):
        assert row.name in text
    assert re.search(r"<td[^>]*>0.02 → 0.01</td><td[^>]*>N</td>", tuned()._repr_html_())


def test_a_job_and_a_sweep_tell_what_they_vary() -> None:
    assert "M_s ≤ 2" in repr(JOB)
    assert "Khat_s" in repr(SWEEP)
    assert "N/m" in repr(SWEEP)
    assert "5120 rows" in repr(SWEEP)
