"""Specs: what is resolved, what counts in the hash, and what axes may name."""

import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jaxmpc.files.errors import InputError
from sweeps.plan import describe, make_plan
from sweeps.spec import SweepSpec
from sweeps.targets import read

Write = Callable[[str], Path]
Command = Callable[..., int]


def hash_of(path: Path) -> str:
    return make_plan(SweepSpec.from_toml(path)).spec_hash


def test_overrides_reach_experiment_and_base(write_spec: Write, spec_text: str) -> None:
    text = spec_text.replace('"text"', '"printed"\ndisturbance_order = 2\nK2 = 20').replace(
        "duration", 'damping = "sampled"\nduration'
    )
    spec = SweepSpec.from_toml(write_spec(text))
    assert spec.experiment.damping == "sampled"
    assert spec.experiment.stiffness == (375.0, 1900.0)
    assert spec.experiment.sensor.noise == 0.010
    assert (spec.params.disturbance_order, float(spec.params.K2), float(spec.params.Khat_s)) == (2, 20.0, 500.0)
    assert spec.precision is None


def test_files_are_looked_for_beside_the_spec(write_spec: Write, spec_text: str, tmp_path: Path) -> None:
    (tmp_path / "own.toml").write_text("duration = 1.0\nsettle = 0.3\nstiffness = [500.0]\n")
    (tmp_path / "params.toml").write_text("[params]\nlam = 0.7\n")
    text = '[experiment]\nfile = "own.toml"\nsettle = 0.2\n[params]\nfile = "params.toml"\nK2 = 30\n'
    spec = SweepSpec.from_toml(write_spec(text + spec_text[spec_text.index("[sweep]") :]))
    assert (spec.experiment.stiffness, spec.experiment.settle) == ((500.0,), 0.2)
    assert (float(spec.params.lam), float(spec.params.K2)) == (0.7, 30.0)


def test_the_hash_knows_content_not_names(write_spec: Write, spec_text: str, tmp_path: Path) -> None:
    first = hash_of(write_spec(spec_text))
    assert hash_of(write_spec("# a comment\n" + spec_text.replace("[375.0, 1900.0]", "[375, 1900]"))) == first
    assert hash_of(write_spec(spec_text.replace("duration", 'name = "other"\nduration'))) == first
    for old, new in (
        ("40", "41"),
        ('"text"', '"printed"'),
        ("1900.0", "1901.0"),
        ('"grid"', '"grid"\nprecision = "float64"'),
    ):
        assert hash_of(write_spec(spec_text.replace(old, new))) != first


def test_a_recording_counts_by_its_content(write_spec: Write, spec_text: str, tmp_path: Path) -> None:
    t = np.arange(0.0, 2.0, 0.01)
    table = np.stack([t, 0 * t, 0 * t, 1e-3 * np.sin(t)], axis=1)
    motion = 'motion = { kind = "recording", file = "NAME" }\nduration'
    hashes = []
    for name, factor in (("a.csv", 1.0), ("b.csv", 1.0), ("a.csv", 2.0)):
        np.savetxt(tmp_path / name, table * [1.0, 1.0, 1.0, factor], delimiter=",", header="t,x,y,z", comments="")
        hashes.append(hash_of(write_spec(spec_text.replace("duration", motion.replace("NAME", name)))))
    assert hashes[0] == hashes[1] != hashes[2]


def test_the_example_of_the_guide_works() -> None:
    guide = (Path(__file__).parents[2] / "docs" / "sweeps.md").read_text(encoding="utf-8")
    example = guide.split("```toml\n")[1].split("```")[0]
    assert len(make_plan(SweepSpec.from_dict(tomllib.loads(example))).rows) == 24 * 20 * 4 * 3


@pytest.mark.parametrize(
    ("axes", "words"),
    [
        ({"delay": [1, 3]}, ["sweep.axes.delay = 3", "<= 2"]),
        ({"arm.cable_hz": [0.0, 250.0]}, ["sweep.axes.arm.cable_hz = 250", "arm.substeps"]),
        (
            {"arm.cable_hz": [40.0], "arm.cable_damping": [0.05, 1.0], "physics": ["wam"], "damping": ["sampled"]},
            ["sweep.axes.arm.cable_hz = 40", "arm.cable_damping = 1"],
        ),
        ({"tissue.kind": ["elastic", "fung"]}, ["sweep.axes.tissue.kind = fung", 'physics = "wam"']),
        ({"arm.coulom": [1.0]}, ["sweep.axes.arm.coulom", "Did you mean 'arm.coulomb'"]),
        ({"arm.posture.7": [1.0]}, ["sweep.axes.arm.posture.7", "an entry that is there"]),
        ({"arm.target": {"values": [1.0], "relative": True}}, ["sweep.axes.arm.target", "a number to multiply"]),
        ({"stiffness": ["papier"]}, ["sweep.axes.stiffness = papier", "Did you mean 'paper'"]),
        ({"stiffness": ["paper", "family"]}, ["[3, 5] tissues", "sets of one length"]),
    ],
)
def test_worlds_that_cannot_be_are_refused(axes: dict[str, object], words: list[str]) -> None:
    with pytest.raises(InputError) as caught:
        SweepSpec.from_dict({"sweep": {"kind": "grid", "axes": axes}})
    assert [word for word in words if word not in str(caught.value)] == []


@pytest.mark.parametrize(
    ("experiment", "axes", "words"),
    [
        ({}, ["motion.seed"], ["sweep.axes.motion.seed", "is drawn", 'motion.phases = "random"']),
        ({"motion": {"phases": "random"}}, ["motion.seed"], None),
        (
            {"motion": {"kind": "rhythm"}},
            ["motion.seed"],
            ["sweep.axes.motion.seed", "is drawn", "a motion.rhythm that"],
        ),
        ({"motion": {"kind": "rhythm", "rhythm": "premature"}}, ["motion.seed"], None),
        ({"motion": {"kind": "none", "phases": "random"}}, ["motion.seed"], ["sweep.axes.motion.seed"]),
        ({}, ["motion.phases", "motion.seed"], None),
        ({"published": "table-1-wam"}, ["tissue.viscosity"], ["where the tissue is of the law kelvin-voigt"]),
        ({"published": "table-1-wam", "tissue": {"kind": "kelvin-voigt"}}, ["tissue.viscosity"], None),
        ({"published": "table-1-wam"}, ["tissue.kind", "tissue.viscosity"], None),
        ({"published": "table-1-wam"}, ["tissue.time_constants.1"], ["time_constants.1", "law standard-linear"]),
        ({"published": "table-1-wam", "tissue": {"kind": "standard-linear"}}, ["tissue.time_constants.1"], None),
        ({"sensor": {"noise": 0.0}}, ["sensor.seed"], ["sensor.seed", "where the sensor has noise"]),
        ({}, ["sensor.seed"], None),
        ({}, ["velocity_cutoff"], ["velocity_cutoff", "where the damping is sampled"]),
        ({"damping": "sampled"}, ["velocity_cutoff"], None),
    ],
)
def test_an_axis_of_no_effect_is_refused(
    experiment: dict[str, object], axes: list[str], words: list[str] | None
) -> None:
    values = {
        "motion.seed": [1, 2],
        "sensor.seed": [1, 2],
        "velocity_cutoff": [50.0, 100.0],
        "motion.phases": ["table", "random"],
        "tissue.viscosity": [1.0, 2.0],
        "tissue.time_constants.1": [1.0, 2.0],
        "tissue.kind": ["elastic", "kelvin-voigt"],
    }
    given = {"experiment": experiment, "sweep": {"kind": "grid", "axes": {name: values[name] for name in axes}}}
    if words is None:
        SweepSpec.from_dict(given)
        return
    with pytest.raises(InputError) as caught:
        SweepSpec.from_dict(given)
    assert [word for word in words if word not in str(caught.value)] == []


def test_an_axis_of_which_the_rerun_alone_depends_is_taken() -> None:
    motion = {"motion": {"kind": "rhythm", "rhythm": "premature"}}
    sweep = {"kind": "grid", "axes": {"motion.seed": [1, 2]}}
    SweepSpec.from_dict({"sweep": sweep, "refine": {"method": "none", "rerun": {"experiment": motion}}})


@pytest.mark.parametrize(
    ("axis", "changed"),
    [("delay", {"delay": 2}), ("tissue", {"tissue": {"kind": "kelvin-voigt"}}), ("physics", {"physics": "wam"})],
)
def test_what_rows_give_no_rerun_changes(axis: str, changed: dict[str, object]) -> None:
    """The rerun would be on what the rows had before."""
    values = {"delay": [1, 2], "tissue": ["elastic", "kelvin-voigt"], "physics": ["linear", "wam"]}
    name = "tissue.kind" if axis == "tissue" else axis
    sweep = {"kind": "grid", "axes": {name: values[axis]}}
    experiment = {"published": "table-1-wam" if axis == "tissue" else "table-1"}
    refine = {"method": "none", "rerun": {"experiment": changed}}
    with pytest.raises(InputError, match=rf"refine\.rerun\.experiment\.{name}.*leave it out of one"):
        SweepSpec.from_dict({"experiment": experiment, "sweep": sweep, "refine": refine})


def test_a_seed_is_an_axis_as_toml_has_it(write_spec: Write) -> None:
    """There it is a table with the one key "seed", which a range has, too."""
    text = '[experiment]\npublished = "table-1"\nmotion = { kind = "rhythm", rhythm = "premature" }\n'
    spec = SweepSpec.from_toml(write_spec(f'{text}[sweep]\nkind = "grid"\n[sweep.axes]\nmotion.seed = [1, 2, 3]\n'))
    assert [(axis.name, axis.values) for axis in spec.space.axes] == [("motion.seed", (1, 2, 3))]


@pytest.mark.parametrize("name", ["stiffness.1", "arm.coulomb.2", "sensor.lsb.0"])
def test_an_entry_is_an_axis_as_toml_has_it(name: str, write_spec: Write) -> None:
    """There it is a table in a table; a key outside the experiment's tables was taken for a range."""
    text = '[experiment]\npublished = "table-1-wam"\n[sweep]\nkind = "grid"\n[sweep.axes]\n'
    for axis in ("[1.0, 2.0]", "{ linear = [0.5, 2.0], points = 2, relative = true }"):
        spec = SweepSpec.from_toml(write_spec(f"{text}{name} = {axis}\n"))
        assert [axis.name for axis in spec.space.axes] == [name]
        assert spec.space.count == 2


def test_a_zipped_list_may_hold_a_number_twice() -> None:
    """What exists once is a row: two horizons of one move, say."""
    table = {"kind": "grid", "zip": [{"Hp": [10, 20, 20], "Hu": [3, 3, 5]}]}
    columns = SweepSpec.from_dict({"sweep": table}).space.columns(np.arange(3))
    assert [columns["Hp"].tolist(), columns["Hu"].tolist()] == [[10.0, 20.0, 20.0], [3.0, 3.0, 5.0]]
    table = {"kind": "grid", "zip": [{"Hp": [10, 20, 20], "Hu": [3, 5, 5]}]}
    with pytest.raises(InputError, match=r"sweep\.zip = 20\.0, 5\.0: must be free of repetition"):
        SweepSpec.from_dict({"sweep": table})


def test_points_that_are_zipped_are_told_apart_by_what_they_are() -> None:
    table = {"kind": "grid", "zip": [{"Q_x": [0.0, -0.0], "K2": [5, 5.0]}]}
    with pytest.raises(InputError, match=r"sweep\.zip = .*: must be free of repetition"):
        SweepSpec.from_dict({"sweep": table})


@pytest.mark.parametrize("name", ["delay", "arm.encoder_counts", "arm.substeps", "disturbance_order"])
def test_what_is_counted_is_multiplied_to_whole_numbers(name: str) -> None:
    """Refused: `delay = 1: must be a whole number, got a number. It makes delay = 1.0`."""
    data = {"experiment": {"published": "table-1-wam"}, "params": {"published": "text"}}
    axes = {name: {"values": [1, 2], "relative": True}}
    spec = SweepSpec.from_dict({**data, "sweep": {"kind": "grid", "axes": axes}})
    (axis,), own = spec.space.axes, read(name, spec.params, spec.experiment.to_dict())
    assert [axis.setting(value, own) for value in axis.values] == [own, 2 * own]
    assert {type(axis.setting(value, own)) for value in axis.values} == {int}
    axes = {name: {"values": [1, 1.3], "relative": True}}
    with pytest.raises(InputError, match=f"sweep.axes.{name} = 1.3: must be "):
        SweepSpec.from_dict({**data, "sweep": {"kind": "grid", "axes": axes}})


@pytest.mark.parametrize("kind", [{"kind": "grid"}, {"kind": "random", "rows": 20}])
@pytest.mark.parametrize("name", ["arm.encoder_counts", "disturbance_order"])
def test_a_range_of_multiples_of_what_is_counted_is_refused(name: str, kind: dict[str, Any]) -> None:
    """The multiples themselves were rounded: of 0.5 to 2 the encoders had 0, 1 and 2 times their counts, 0 is ideal."""
    axis = {"linear": [0.5, 2.0], "relative": True} | ({"points": 4} if kind["kind"] == "grid" else {})
    data = {"experiment": {"published": "table-1-wam"}, "sweep": {**kind, "axes": {name: axis}}}
    with pytest.raises(InputError, match=rf"^sweep\.axes\.{name}\.relative = .* left out of a range .* values"):
        SweepSpec.from_dict(data)


def test_what_is_counted_is_drawn_in_whole_numbers() -> None:
    axes = {"disturbance_order": {"linear": [1, 2]}, "designed_delay": {"linear": [1, 2]}}
    space = SweepSpec.from_dict({"sweep": {"kind": "random", "rows": 20, "axes": axes}}).space
    for axis in space.axes:
        assert set(axis.draw(np.linspace(0.0, 0.999, 20))) == {1.0, 2.0}


GALLERY = sorted((Path(__file__).parents[2] / "docs" / "gallery").glob("*.toml"))


@pytest.mark.parametrize(
    ("params", "axes", "own"),
    [
        ({"velocity_cutoff": 90.0}, ("velocity_lowpass",), "velocity_cutoff"),
        ({}, ("velocity_lowpass", "velocity_cutoff"), "velocity_cutoff"),
        ({"force_cutoff": 900.0}, ("sensor.kalman",), "force_cutoff"),
    ],
)
def test_a_filter_that_no_row_would_use_is_refused(params: dict[str, float], axes: tuple[str, ...], own: str) -> None:
    data = {
        "experiment": {"published": "table-1"},
        "params": {"published": "text", **params},
        "sweep": {"kind": "grid", "axes": {name: [90.0, 400.0] for name in axes}},
    }
    with pytest.raises(InputError, match=f"{axes[0]}.*Sweep {own} instead"):
        SweepSpec.from_dict(data)


@pytest.mark.parametrize("path", GALLERY, ids=[path.stem for path in GALLERY])
def test_the_gallery_has_the_rows_that_it_says(path: Path) -> None:
    page = (path.parents[1] / "sweeps-gallery.md").read_text(encoding="utf-8")
    line = next(line for line in page.splitlines() if path.name in line)
    rows = line.split("|")[3].split(",")[0].split(" on ")[0].split(" in ")[0].replace(" ", "")
    assert len(make_plan(SweepSpec.from_toml(path)).rows) == int(rows)


@pytest.mark.parametrize(
    ("world", "axes", "path"),
    [
        ({"published": "table-1"}, {}, "ideal"),
        ({"published": "table-1", "damping": "sampled"}, {}, "sampled"),
        ({"published": "table-1-wam", "damping": "ideal"}, {}, "sampled"),
        ({"published": "table-1"}, {"physics": ["wam"]}, "sampled"),
    ],
)
def test_what_is_resolved_tells_the_damping_that_runs(world: dict[str, str], axes: dict[str, Any], path: str) -> None:
    """An arm's is sampled, whatever its file says or leaves out."""
    spec = SweepSpec.from_dict({"experiment": world, "sweep": {"kind": "grid", "axes": {"lam": [0.1, 0.2], **axes}}})
    assert f", {path} damping, " in describe(make_plan(spec))
