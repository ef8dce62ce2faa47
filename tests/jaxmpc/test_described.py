"""What Python shows of public objects: values with units, in lines of at most 100 columns."""

import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest

from jaxmpc import Experiment, Params, Status, Timing, evaluate, margins
from jaxmpc.quantities import MARGINS, METRICS, PARAMETERS

SHORT = Experiment.from_dict({"duration": 0.6, "settle": 0.2, "motion": {"kind": "none"}})


@pytest.fixture(scope="module")
def shown() -> dict[str, str]:
    out = evaluate(Params(), SHORT)
    batch = Params.stack([Params()] * 9)
    held = {
        "params": Params(),
        "filters": Params(velocity_cutoff=180.0, force_cutoff=900.0),
        "batch": batch,
        "family": Params.published("family"),
        "margins": margins(Params(), 810.0),
    }
    held |= {"many": margins(Params(), np.linspace(375, 1900, 33)), "outcome": out, "metrics": out.metrics}
    held |= {"experiment": SHORT, "arm": Experiment.published("cough"), "timing": Timing(), "status": Status.OK}
    return {name: repr(each) for name, each in held.items()}


def test_lines_fit_and_units_stand_beside_values(shown: dict[str, str]) -> None:
    for name, text in shown.items():
        assert max(map(len, text.splitlines())) <= 100, name
    assert "Khat_s  900 N/m" in shown["params"]
    assert "T_cl    0.003 s" in shown["params"]
    assert "a batch (9,)" in shown["batch"]
    assert "5 knots" in shown["family"]
    assert "status" in shown["margins"]
    assert "OK" in shown["outcome"]
    for table, names in (
        (PARAMETERS, ["filters"]),
        (MARGINS, ["margins", "many", "outcome"]),
        (METRICS, ["metrics", "outcome"]),
    ):
        for row in table.values():
            for name in names:
                assert row.name in shown[name]
                assert row.unit == "-" or row.unit in shown[name]
    assert "375, 810, 1900 N/m" in shown["experiment"]


def test_values_are_those_of_the_object(shown: dict[str, str]) -> None:
    found = margins(Params(), 810.0)
    assert f"{float(found.M_s):.4g}" in shown["margins"]
    assert f"{float(found.phase_margin_deg):.4g} deg" in shown["margins"]


def test_a_notebook_gets_a_table_without_foreign_marks() -> None:
    assert Params()._repr_html_().startswith("<table><caption>Params, mpc-aob")
    assert ">N/m</td>" in Params()._repr_html_()


def test_what_is_traced_can_be_shown() -> None:
    seen = []
    jax.jit(lambda p: seen.append(repr(p)) or p.lam)(Params())
    assert "traced" in seen[0]


def test_where_jax_is_missing_the_import_says_what_to_install(tmp_path: Path) -> None:
    (tmp_path / "jax.py").write_text("raise ModuleNotFoundError('No module named jax', name='jax')")
    (tmp_path / "equinox.py").write_text("raise ModuleNotFoundError('No module named equinox', name='equinox')")
    program = f"import sys; sys.path.insert(0, {str(tmp_path)!r}); from jaxmpc import Params"
    root = Path(__file__).parents[2]
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, cwd=root, check=False)
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1].startswith("ModuleNotFoundError: jaxmpc.Params needs ")
    assert "jaxmpc[sim]" in done.stderr
