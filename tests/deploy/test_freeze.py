import math

import numpy as np
import pytest

from deploy.controller.arm_model import ROBOT
from deploy.controller.file import load, to_bytes
from deploy.controller.freeze import freeze
from jaxmpc.files.errors import InputError
from jaxmpc.files.sealed import seal
from tests.deploy import made


def test_frozen_file_is_what_load_returns(arguments, tmp_path):
    artifact = freeze(tmp_path / "controller.npz", **arguments)
    again = load(str(tmp_path / "controller.npz"))
    assert again.gains == artifact.gains == arguments["gains"]
    assert [path.name for path in tmp_path.iterdir()] == ["controller.npz"]


def test_same_input_gives_the_same_bytes(arguments, tmp_path):
    freeze(tmp_path / "a.npz", **arguments)
    arguments["params"] = dict(reversed(arguments["params"].items()))
    gains = arguments["gains"]
    arrays = {name: np.array(value) for name, value in gains._asdict().items() if value is not None}
    arguments["gains"] = gains._replace(**arrays)
    freeze(tmp_path / "b.npz", **arguments)
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_preview_freezes_and_replays(arguments, law, tmp_path):
    golden = law.trace(law.gains, 8, preview=True)
    artifact = freeze(tmp_path / "a.npz", **(arguments | {"golden": golden, "preview": True}))
    assert artifact.golden_force_ref.shape == (8, 3, 64)
    with pytest.raises(
        InputError, match=r"golden_force_ref = an array of shape \(12, 3\): must be of shape \(12, 3, 64\)"
    ):
        freeze(tmp_path / "b.npz", **arguments, preview=True)


def changed(arguments, law, **row):
    arguments["margins"][1] = law.row(810.0, **row)
    return arguments


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ({"spectral_radius": 1.0}, "spectral_radius at 810 N/m = 1: must be below 1. .*tune again"),
        ({"spectral_radius": 1.035}, "810 N/m = 1.035"),
        ({"M_s": 2.0001}, "M_s at 810 N/m = 2.0001: must be at most 2, the declared floor. .*Tune again"),
        ({"M_s": math.inf}, "M_s at 810 N/m = inf"),
        ({"gain_reduction_db": 5.0}, "gain_reduction_db at 810 N/m = 5 dB: must be at least 6 dB"),
        ({"M_s": math.nan}, "M_s = nan: must be a number"),
        ({"spectral_radius": math.nan}, "spectral_radius = nan: must be a number"),
    ],
)
def test_unstable_and_below_the_floor_is_refused_and_nothing_written(arguments, law, tmp_path, row, message):
    with pytest.raises(InputError, match=message):
        freeze(tmp_path / "controller.npz", **changed(arguments, law, **row))
    assert not list(tmp_path.iterdir())


def test_every_bound_of_the_floor_acts(arguments, law, tmp_path):
    row = law.row(810.0, gain_reduction_db=7.0)
    arguments["margins"] = [row]
    for key in ("M_s", "gain_margin_db", "gain_reduction_db", "phase_margin_deg", "delay_margin_s"):
        freeze(tmp_path / "a.npz", **(arguments | {"floor": {key: row[key]}}))
        stricter = row[key] * (0.999 if key == "M_s" else 1.001)
        with pytest.raises(InputError, match=f"{key} at 810 N/m"):
            freeze(tmp_path / "a.npz", **(arguments | {"floor": {key: stricter}}))


def test_values_beyond_what_is_asked_are_refused(arguments, tmp_path):
    gains = arguments["gains"]
    force, force_ref, v = arguments["golden"]
    for change, message in [
        ({"T_s": math.nan}, "T_s = nan"),
        ({"K2": math.inf}, "K2 = inf"),
        ({"params": {"a": math.nan}}, "params"),
        ({"provenance": {"a": object()}}, "provenance"),
        ({"gains": gains._replace(L=(1.0, 2.0))}, "L = an array of shape"),
        ({"gains": gains._replace(mpc_u=np.zeros(3))}, "mpc_u = an array of shape"),
        ({"gains": gains._replace(L=((1.0,), (1.0, 2.0), 3.0))}, "L = an array of object"),
        ({"golden": (force, force_ref, v * (1 + 1e-8))}, "deviation from the golden trace"),
        ({"golden": (force, force_ref, v[:-1])}, "golden_v = an array of shape"),
    ]:
        with pytest.raises(InputError, match=message):
            freeze(tmp_path / "controller.npz", **(arguments | change))
        assert not list(tmp_path.iterdir())


def test_only_an_artifact_is_overwritten(arguments, tmp_path):
    path = tmp_path / "controller.npz"
    freeze(path, **arguments)
    freeze(path, **(arguments | {"K2": 20.0}))
    assert load(path).K2 == 20.0
    for foreign in (b"notes", b"", path.read_bytes()[:-1], seal({"schema": "other"}, {})):
        other = tmp_path / "other"
        other.write_bytes(foreign)
        with pytest.raises(InputError, match=r"output = .*other: must be new or an intact artifact"):
            freeze(other, **arguments)
        assert other.read_bytes() == foreign
    for place, message in (
        (tmp_path, "new or an intact artifact"),
        (tmp_path / "none" / "a.npz", "a folder that exists"),
    ):
        with pytest.raises(InputError, match=message):
            freeze(place, **arguments)
    assert sorted(each.name for each in tmp_path.iterdir()) == ["controller.npz", "other"]


def test_a_controller_for_the_arm_is_one_that_runs(tmp_path):
    given = made.arm_arguments(6)
    golden = tuple(given.pop(name) for name in ("golden_force", "golden_force_ref", "golden_v"))
    given["arm"] |= {"limits": given["arm"]["limits"].plain()}
    path = tmp_path / "controller.npz"
    frozen = freeze(path, **given, golden=golden)
    assert frozen.kind == "wam"
    assert to_bytes(load(path, expect_rate=1000.0, expect_robot=ROBOT)) == path.read_bytes()
    del given["arm"]["limits"]["workspace"]
    with pytest.raises(InputError, match=r"limits\.workspace = missing"):
        freeze(tmp_path / "b.npz", **given, golden=golden)
    assert [each.name for each in tmp_path.iterdir()] == ["controller.npz"]
