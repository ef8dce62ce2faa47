"""Axes of the world: every row meets the experiment that its entries describe, in whatever way it is run."""

import dataclasses
import errno
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jaxmpc import evaluate
from jaxmpc.files import sealed
from jaxmpc.files.errors import InputError
from jaxmpc.quantities import MARGINS, METRICS
from jaxmpc.status import Status
from sweeps import store
from sweeps.blocks import block_of, in_pairs, shares_signals
from sweeps.compute import compute
from sweeps.plan import make_plan
from sweeps.result import Result
from sweeps.rows import world_of
from sweeps.spec import SweepSpec
from sweeps.targets import UNITS, known_names, target
from tests.sources import ROOT

pytestmark = pytest.mark.once

SHORT: dict[str, Any] = {
    "published": "table-1",
    "duration": 0.6,
    "settle": 0.2,
    "stiffness": [375.0, 1900.0],
    "reference": {"z": -5.0},
    "damping": "sampled",
    "sensor": {"lsb": [0.0, 0.0, 0.0]},
}
"""Without quantisation, which lets float32 and float64 drift apart."""
FORTY: dict[str, Any] = {"lam": {"log": [0.01, 1.0], "points": 40}, "delay": [1, 2]}
"""Forty controllers in each of two worlds: a program serves whatever else these experiments have."""


def made(axes: dict[str, Any], kind: str = "grid", **more: Any) -> SweepSpec:
    experiment = {**SHORT, **more.pop("experiment", {})}
    sweep = {"kind": kind, "axes": axes, "decide": 0, **more}
    return SweepSpec.from_dict({"experiment": experiment, "sweep": sweep})


def computed(spec: SweepSpec) -> Result:
    plan = make_plan(spec)
    return Result.of(plan, compute(plan, 0, len(plan.rows)), np.ones(len(plan.rows), bool))


def agrees_with_evaluate(result: Result, places: range) -> int:
    """How many (row, stiffness) were compared with one evaluation of a row's own controller on its own experiment."""
    compared = 0
    for place in places:
        alone = evaluate(result.controller(place), result.experiment(place))
        np.testing.assert_array_equal(result["status"][place], alone.status)
        ok = result["status"][place] == Status.OK
        compared += int(ok.sum())
        for name in {*METRICS, *MARGINS} - {"swing"}:
            found = np.asarray(getattr(alone.metrics if name in METRICS else alone.margins, name))
            # Margins are float64 on both sides; 600 float32 steps lose three of seven digits.
            single = name in METRICS and result[name].dtype == np.float32
            rtol, atol = (5e-4, 1e-6) if single else (1e-9, 0.0)
            np.testing.assert_allclose(result[name][place][ok], found[ok], rtol=rtol, atol=atol, err_msg=name)
    return compared


@pytest.mark.parametrize(
    ("experiment", "axes"),
    [
        ({}, {"K2": [1.0, 2.0]}),
        ({"damping": "ideal"}, {"damping": ["ideal", "sampled"]}),
        ({"physics": "wam"}, {"K2": [1.0]}),
    ],
)
def test_rows_damped_by_another_velocity_are_not_put_beside_those_of_today(
    experiment: dict[str, Any], axes: dict[str, Any], tmp_path: Path
) -> None:
    plan = make_plan(made(axes, experiment=experiment))
    before = {key: value for key, value in plan.canonical.items() if key != "velocity"}
    store.prepare(tmp_path, dataclasses.replace(plan, canonical=before))
    with pytest.raises(InputError, match="velocity"):
        store.check(tmp_path, plan)
    assert "velocity" not in make_plan(made({"K2": [1.0]}, experiment={"damping": "ideal"})).canonical


@pytest.mark.parametrize(
    ("experiment", "more", "short"),
    [
        ({"physics": "wam"}, {}, True),
        ({"physics": "wam", "duration": 14.0, "settle": 5.0}, {}, True),
        ({"physics": "wam", "duration": 15.0, "settle": 5.0}, {}, False),
        ({"physics": "wam", "duration": 15.0, "settle": 5.0}, {"duration": [8.0, 9.0]}, True),
        ({}, {"physics": ["linear", "wam"]}, True),
        ({}, {}, False),
    ],
)
def test_rows_whose_swing_was_of_the_beginning_too_are_not_put_beside_those_of_today(
    experiment: dict[str, Any], more: dict[str, Any], short: bool, tmp_path: Path
) -> None:
    plan = make_plan(made({"K2": [1.0, 2.0], **more}, experiment=experiment))
    assert ("swing" in plan.canonical) == short
    assert "swing" not in make_plan(made({"K2": [1.0], **more}, experiment=experiment, columns=["rms"])).canonical
    before = {key: value for key, value in plan.canonical.items() if key != "swing"}
    store.prepare(tmp_path, dataclasses.replace(plan, canonical=before))
    if short:
        with pytest.raises(InputError, match="swing: there null"):
            store.check(tmp_path, plan)
    else:
        assert store.check(tmp_path, plan)


@pytest.mark.oracle
@pytest.mark.parametrize(("precision", "noise"), [("float64", [0.0, 0.02]), ("float32", [0.01, 0.02])])
def test_many_controllers_share_a_world(precision: str, noise: list[float]) -> None:
    """Without noise some 14 mm/s² of chatter are left, of which float32 makes 0.3 %."""
    spec = made({**FORTY, "sensor.noise": noise}, precision=precision)
    plan = make_plan(spec)
    assert (plan.space.same_world, plan.worlds, in_pairs(plan), block_of(plan)) == (40, 4, False, 32)
    result = computed(spec)
    # The world is the slowest index, whatever was written first.
    assert result["delay"].tolist() == [1] * 80 + [2] * 80
    assert agrees_with_evaluate(result, range(0, 160, 23)) > 8
    part = compute(plan, 70, 90)
    for name, values in part.items():
        np.testing.assert_array_equal(values, result[name][70:90], err_msg=name)


@pytest.mark.oracle
@pytest.mark.parametrize("signals", [False, True])
def test_every_row_has_a_world_of_its_own(signals: bool) -> None:
    axes = {
        "lam": {"log": [0.01, 1.0]},
        "delay": [1, 2],
        "velocity_lowpass": {"linear": [100.0, 400.0]},
        "force_limit": {"linear": [10.0, 20.0]},
    }
    if signals:
        axes["sensor.noise"] = {"linear": [0.0, 0.05]}
        axes["motion.scale"] = {"linear": [0.5, 1.5]}
    spec = made(axes, "random", rows=20, seed=4)
    plan = make_plan(spec)
    assert (in_pairs(plan), shares_signals(plan)) == (True, not signals)
    result = computed(spec)
    assert agrees_with_evaluate(result, range(0, 20, 4)) > 4
    for name, values in compute(plan, 7, 9).items():
        np.testing.assert_array_equal(values, result[name][7:9], err_msg=name)


@pytest.mark.oracle
def test_structure_and_stiffness_sets_are_axes() -> None:
    axes = {
        "disturbance_order": [1, 2],
        "Q_p": {"values": [0.5, 2.0], "relative": True},
        "stiffness": ["soft", [500.0, 600.0]],
        "sensor.noise": {"values": [0.5, 1.0], "relative": True},
    }
    result = computed(made(axes, stiffness_sets={"soft": [300.0, 400.0]}))
    assert len(result) == 16
    assert result.tissues[0].tolist() == [300.0, 400.0]
    assert result.tissues[-1].tolist() == [500.0, 600.0]
    controller = result.controller(15)
    assert (controller.disturbance_order, float(controller.Q_p)) == (2, 1.0)
    assert result.experiment(0).sensor.noise == pytest.approx(0.005)
    assert result.settings(0)["stiffness"] == "soft"
    data = result.to_xarray()
    assert data["rms"].dims == ("row", "tissue", "axis")
    assert data["tissue_stiffness"].values[0].tolist() == [300.0, 400.0]
    frame = result.to_pandas()
    assert frame.loc[(0, 300.0), "stiffness_set"] == "soft"
    assert agrees_with_evaluate(result, range(0, 16, 5)) > 2


def test_a_relative_axis_of_a_vector_multiplies_each_entry() -> None:
    axes = {"arm.coulomb": {"values": [0.5, 1.0], "relative": True}}
    spec = made(axes, experiment={"physics": "wam"})
    world = world_of(spec.experiment.to_dict(), spec.space.axes, (0.5,))
    assert world["arm"]["coulomb"] == pytest.approx((1.0125, 1.125, 0.5625, 0.33))
    made({**axes, "physics": ["linear", "wam"]})


def test_zipped_axes_advance_together() -> None:
    spec = made({"lam": [0.1, 0.2]}, zip=[{"Hp": [10, 20, 30], "Hu": [2, 4, 6]}])
    columns = make_plan(spec).space.columns(np.arange(6))
    assert list(zip(columns["Hp"], columns["Hu"], strict=True)) == [(10, 2), (20, 4), (30, 6)] * 2
    with pytest.raises(InputError, match="equally long"):
        made({}, zip=[{"Hp": [10, 20], "Hu": [2, 4, 6]}])


def test_a_sobol_sequence_fills_evenly_and_longer_ones_begin_with_shorter() -> None:
    axes = {"lam": {"log": [0.01, 1.0]}, "T_cl": {"log": [0.001, 0.01]}}
    few, many = (make_plan(made(axes, "sobol", rows=rows, seed=3)).space for rows in (50, 256))
    whole = many.columns(np.arange(256))
    for name, values in few.columns(np.arange(50)).items():
        np.testing.assert_array_equal(values, whole[name][:50])
    # Each of the 16 equal stretches of either axis holds exactly 16 of the first 256 points: what a Sobol sequence is.
    place = (np.log10(whole["lam"]) + 2.0) / 2.0
    assert np.bincount((16 * place).astype(int)).tolist() == [16] * 16


def test_a_recording_travels_by_its_content(tmp_path: Path) -> None:
    t = np.arange(0.0, 2.0, 0.01)
    table = np.stack([t, 0 * t, 0 * t, 1e-3 * np.sin(6.0 * t)], axis=1)
    path = tmp_path / "own.csv"
    np.savetxt(path, table, delimiter=",", header="t,x,y,z", comments="")
    plan = make_plan(made(FORTY, experiment={"motion": {"kind": "recording", "file": str(path)}}))
    path.unlink()
    rows = len(plan.rows)
    columns = compute(plan, 0, rows)
    assert np.isfinite(columns["rms"]).any()
    # Rows of one world have one experiment, which a report runs once, and one file, which does not stay behind.
    here, other = (Result.of(plan, columns, np.ones(rows, bool)).experiment(place) for place in (0, 1))
    assert here.to_dict() == other.to_dict()
    script = "import sweeps.result as s; print(s._recordings())"
    said = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=ROOT)
    assert said.stdout.strip()
    assert not Path(said.stdout.strip()).exists()


def test_a_recording_that_a_full_disk_cuts_short_is_not_taken_for_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "own.csv"
    path.write_text("t,x,y,z\n" + "".join(f"{0.01 * k:.2f},0,0,0\n" for k in range(200)))
    plan = make_plan(made({"lam": [0.1]}, experiment={"motion": {"kind": "recording", "file": str(path)}}))
    folder = tmp_path / "there"
    folder.mkdir()

    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(sealed.os, "fsync", full)
        with pytest.raises(OSError, match="No space left"):
            plan.experiment(folder)
    assert list(folder.iterdir()) == []
    file = plan.experiment(folder).motion.file
    assert Path(file).read_bytes() == path.read_bytes()


def test_every_key_of_controller_and_experiment_has_a_place() -> None:
    names = known_names()
    assert {
        "lam",
        "disturbance_order",
        "designed_delay",
        "delay",
        "arm.coulomb",
        "sensor.noise",
        "motion.seed",
        "tissue.kind",
    } <= {*names}
    assert len(names) == len(set(names))
    assert all(target(name).unit for name in names)
    assert set(UNITS) <= set(names)


def test_ranking_is_no_part_of_the_hash() -> None:
    one, other = made(FORTY), made(FORTY, constraints={"gain_margin_db": 6.0})
    assert make_plan(one).spec_hash == make_plan(other).spec_hash
    fewer = made(FORTY, columns=["true_rms"])
    assert make_plan(fewer).kept == ("rms", "true_rms", "M_s")
    assert make_plan(fewer).spec_hash != make_plan(one).spec_hash
    result = computed(other)
    assert (result.feasible <= result.ok).all()


@pytest.mark.oracle
def test_filters_of_controllers_are_swept_as_those_of_the_experiment() -> None:
    """An axis of either name tells the same rows; the controllers' own share one world."""
    own, of_world = (computed(made({name: [90.0, 400.0]})) for name in ("velocity_cutoff", "velocity_lowpass"))
    for name in ("M_s", "chatter", "rms"):
        np.testing.assert_allclose(own[name], of_world[name], rtol=5e-4 if name != "M_s" else 1e-12)
    assert agrees_with_evaluate(own, range(2)) == 4
