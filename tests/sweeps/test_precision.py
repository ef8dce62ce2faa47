"""Which precision a sweep has that names none."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax
import pytest

from jaxmpc.cli import main
from sweeps import store
from sweeps.plan import make_plan
from sweeps.precision import with_precision
from sweeps.refine.run import described
from sweeps.refine.run import run as refined
from sweeps.run import run as plain
from sweeps.spec import SweepSpec
from sweeps.tables import Precision
from tests.sweeps.drawn_rows import DATA

SERVER, GAMES = "9.0", "8.9"
LONG = {"experiment": {"duration": 100.0}}
WAM = {"experiment": {"duration": 100.0, "physics": "wam"}}
FAMILY = {"params": {"published": "family"}}
FRONT = {"method": "pareto", "rounds": 1, "points": 4}


@pytest.fixture
def computes(monkeypatch: pytest.MonkeyPatch) -> Any:
    """A function after which a sweep is run on a GPU of this compute capability."""

    def on(capability: str) -> None:
        monkeypatch.setattr(jax, "local_devices", lambda: [SimpleNamespace(compute_capability=capability)])
        monkeypatch.setattr(jax, "default_backend", lambda: "gpu")

    return on


def made(**tables: Any) -> SweepSpec:
    return SweepSpec.from_dict({**DATA, **{name: {**DATA.get(name, {}), **table} for name, table in tables.items()}})


def found(spec: SweepSpec, folder: Path) -> Precision | None:
    return with_precision(spec, folder).precision


def test_on_a_cpu_it_is_float32(tmp_path: Path) -> None:
    assert made().precision is None
    assert found(made(), tmp_path) == "float32"


@pytest.mark.parametrize(
    ("capability", "tables", "expected"),
    [
        (SERVER, {}, "float64"),
        (GAMES, {}, "float32"),
        (SERVER, {"sweep": {"precision": "float32"}}, "float32"),
        (GAMES, {"sweep": {"precision": "float64"}}, "float64"),
        # So much of the arm, whose steps take longer in float64, that it takes seconds: on two tissues, 100 s each.
        (SERVER, {**LONG, **WAM, "sweep": {"rows": 49_000}}, "float64"),
        (SERVER, {**LONG, **WAM, "sweep": {"rows": 51_000}}, "float32"),
        (SERVER, {**LONG, **WAM, **FAMILY, "sweep": {"rows": 14_000}}, "float64"),
        (SERVER, {**LONG, **WAM, **FAMILY, "sweep": {"rows": 16_000}}, "float32"),
        (SERVER, {**LONG, "sweep": {"rows": 51_000}}, "float64"),
        # Stages may be on the arm, and the last run there as a rule.
        (SERVER, {"refine": FRONT}, "float32"),
        # Rows with a world each are no kernel's.
        (
            SERVER,
            {"sweep": {"axes": {"lam": {"log": [0.1, 0.2]}, "sensor.noise": {"linear": [0.01, 0.02]}}}},
            "float32",
        ),
    ],
)
def test_on_a_gpu_it_is_float64_where_that_costs_little(
    tmp_path: Path, computes: Any, capability: str, tables: dict[str, Any], expected: Precision
) -> None:
    spec = made(**tables)
    computes(capability)
    assert found(spec, tmp_path) == expected


@pytest.mark.parametrize(("points", "expected"), [(24_000, "float64"), (26_000, "float32")])
def test_where_physics_are_swept_it_is_that_of_the_arm(
    tmp_path: Path, computes: Any, points: int, expected: Precision
) -> None:
    axes = {"physics": ["linear", "wam"], "lam": {"log": [0.1, 0.2], "points": points}}
    spec = SweepSpec.from_dict(
        {**DATA, "experiment": {**DATA["experiment"], **LONG["experiment"]}, "sweep": {"kind": "grid", "axes": axes}}
    )
    computes(SERVER)
    assert found(spec, tmp_path) == expected


@pytest.mark.parametrize(("begun", "goes_on"), [("float64", GAMES), ("float32", SERVER)])
@pytest.mark.parametrize("refine", [None, FRONT])
def test_whoever_goes_on_computes_as_the_folder_was_begun(
    tmp_path: Path, computes: Any, begun: Precision, goes_on: str, refine: dict[str, Any] | None
) -> None:
    spec = made() if refine is None else made(refine=refine)
    first = replace(spec, precision=begun)
    if refine is None:
        store.prepare(tmp_path / "run", make_plan(first))
    else:
        store.prepare_refined(tmp_path / "run", *described(first))
    computes(goes_on)
    assert found(spec, tmp_path / "run") == begun
    asked: Precision = "float32" if begun == "float64" else "float64"
    assert found(replace(spec, precision=asked), tmp_path / "run") == asked, "which the folder then refuses"


def test_a_dry_run_tells_it_and_a_folder_is_gone_on_with(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    spec = tmp_path / "spec.toml"
    spec.write_text('[experiment]\npublished = "table-1"\n[sweep]\nkind = "grid"\naxes = { lam = [0.1, 0.2] }\n')
    store.prepare(tmp_path / "run", make_plan(replace(SweepSpec.from_toml(spec), precision="float64")))
    for folder, told in (("run", "float64"), ("other", "float32")):
        assert main(["sweep", str(spec), "-o", str(tmp_path / folder), "--dry-run"]) == 0
        assert f", {told}\n" in capsys.readouterr().out


@pytest.mark.parametrize("refine", [None, FRONT])
def test_a_run_that_goes_on_is_in_it(tmp_path: Path, refine: dict[str, Any] | None) -> None:
    tables: dict[str, Any] = {"sweep": {"rows": 4, "axes": {"lam": {"log": [0.05, 0.1]}}}}
    if refine is not None:
        tables["refine"] = refine
    spec = made(**tables)
    exact, run = replace(spec, precision="float64"), refined if refine else plain
    begun = run(exact, tmp_path / "run")
    assert begun["rms"].dtype == "float64"
    assert run(spec, tmp_path / "run").hash == begun.hash


@pytest.mark.parametrize("content", ["", "[]", '{"spec": 3}', '{"spec": {"precision": ["float64"]}}'])
def test_a_manifest_that_says_nothing_decides_nothing(tmp_path: Path, content: str) -> None:
    (tmp_path / "manifest.json").write_text(content)
    assert found(made(), tmp_path) == "float32"
    (tmp_path / "file").write_text("")
    assert found(made(), tmp_path / "file") == "float32"
