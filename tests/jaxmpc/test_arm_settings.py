"""The tables [arm] and [tissue]: what is refused and how it is said; targets and what reaches them."""

from copy import copy
from pathlib import Path
from typing import Any

import hypothesis.strategies as st
import mujoco
import numpy as np
import pytest
from hypothesis import example, given, settings

from jaxmpc import Experiment, InputError, Params
from jaxmpc.engine.scenario import with_physics
from jaxmpc.experiment.build import robot_of
from jaxmpc.experiment.tables import ArmSettings, TissueSettings, softening
from jaxmpc.law import computed_torque
from jaxmpc.law.ops import FLOATS
from jaxmpc.world.arm import JOINTS, TOOL_MASS, chain, joint_ranges, link_inertias, model, tip_at
from tuning.trials.drawn import NOMINAL, Job

WAM = 'physics = "wam"\n'


def refused(folder: Path, text: str) -> InputError:
    path = folder / "experiment.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        Experiment.from_toml(path)
    assert caught.value.file == path
    assert str(caught.value).startswith(f"{path}:{caught.value.line}: {caught.value.key} = ")
    return caught.value


@pytest.mark.parametrize(
    ("text", "line", "key", "value", "bound", "remedy"),
    [
        (
            "[arm]\nposture = [0.0, 0.7, 0.0, 3.5]",
            3,
            "arm.posture",
            3.5,
            "in [-0.9, 3.15] rad for J4",
            "within the joint limits",
        ),
        ("[arm]\nposture = [0.0, 2.1, 0.0, 2.2]", 3, "arm.posture", 2.1, "in [-2, 2] rad for J2", "joint limits"),
        ("[arm]\nposture = [0.0, 0.7, 0.0]", 3, "arm.posture", "[0.0, 0.7, 0.0]", "a list of length 4", "Correct"),
        ("[arm]\nsubsteps = 2\ntarget = [1.2, 0.0, 0.1]", 4, "arm.target", "[1.2, 0.0, 0.1]", "within reach", "0.9 m"),
        ("[arm]\nbeyond_sensor = 0.4", 3, "arm.beyond_sensor", 0.4, "at most arm.tool_mass (= 0.3 kg)", "part of"),
        (
            '[arm]\ncable_hz = 20.0\nintegrator = "euler"',
            4,
            "arm.integrator",
            "euler",
            '"leapfrog" with a cable mode',
            "Set arm.cable_hz = 0",
        ),
        ("[arm]\ncable_damping = 2.0", 3, "arm.cable_damping", 2.0, "<= 1.0", "Correct"),
        ("[arm]\nsubsteps = 0", 3, "arm.substeps", 0, ">= 1", "Correct"),
        ("[arm]\nmass_error = -0.9", 3, "arm.mass_error", -0.9, "> -0.9", "Correct"),
        ("[arm]\ncolomb = [1.0, 1.0, 1.0, 1.0]", 3, "arm.colomb", "[1.0, 1.0, 1.0, 1.0]", "a known key", "'coulomb'"),
        ('[tissue]\nkind = "elastik"', 3, "tissue.kind", "elastik", "a known law", "Did you mean 'elastic'"),
        ("[tissue]\nviscous = 1.0", 3, "tissue.viscous", 1.0, "a known key", "'viscosity'"),
        ("[tissue]\nstiffness = 810.0", 3, "tissue.stiffness", 810.0, "a known key", "Known"),
        ("stiffness = [810.0, 0.0]", 2, "stiffness[1]", 0.0, "> 0.0", "Correct"),
        ("stiffness = []", 2, "stiffness", "[]", "at least one stiffness [N/m]", "The paper has"),
        ("[tissue]\nchanges = [{ at = 1.0 }]", 3, "tissue.changes[0].factor", "missing", "given", "factor"),
        (
            "[tissue]\nchanges = [{ at = 1.0, factor = 0.0 }]",
            3,
            "tissue.changes[0].factor",
            0.0,
            "> 0.0",
            "Correct",
        ),
    ],
)
def test_wrong_input_is_told_with_its_place(
    tmp_path: Path, text: str, line: int, key: str, value: Any, bound: str, remedy: str
) -> None:
    found = refused(tmp_path, WAM + text)
    assert (found.line, found.key, str(found.value)) == (line, key, str(value))
    assert bound in found.bound
    assert remedy in found.remedy


def test_a_tissue_changes_in_order_of_time() -> None:
    """One that came too late would be lost: each goes on from what the one before it has left."""
    later, sooner = {"at": 10.0, "factor": 2.0, "duration": 0.0}, {"at": 5.0, "factor": 0.5, "duration": 0.0}
    with pytest.raises(InputError, match=r"tissue\.changes\[1\]\.at = 5\.0: must be at least 10 s"):
        Experiment.from_dict({"physics": "wam", "tissue": {"changes": [later, sooner]}})
    Experiment.from_dict({"physics": "wam", "tissue": {"changes": [sooner, later]}})


def test_a_cable_is_resolved_by_substeps_of_a_millisecond_at_any_sampling() -> None:
    """A hundred hertz on 2 ms blow up within nine samples."""
    slow: dict[str, Any] = {"physics": "wam", "sampling_time": 0.002}
    with pytest.raises(InputError, match=r"cable_hz = 100\.0: must be at most 50 Hz with arm\.substeps = 1"):
        Experiment.from_dict({**slow, "arm": {"cable_hz": 100.0}})
    assert Experiment.from_dict({**slow, "arm": {"cable_hz": 100.0, "substeps": 2}}).arm.substeps == 2
    base = Experiment.from_dict({**slow, "settle": 2.0, "duration": 30.0})
    assert Job((Params(),), base, NOMINAL).base.arm.substeps == 10


@pytest.mark.parametrize(
    ("arm", "highest"),
    [
        ({"cable_hz": 60.0, "cable_damping": 0.5}, "50.45"),
        ({"cable_hz": 100.0, "posture": [-1.9, 0.89, 0.14, 0.36]}, "92.02"),
    ],
)
def test_cables_that_the_numbers_alone_would_swing_are_refused(arm: dict[str, Any], highest: str) -> None:
    """Of the most cautious controller both had said that it diverged, within 52 and 35 ms."""
    with pytest.raises(
        InputError, match=rf"arm\.cable_hz = .*: must be within what .* below {highest} Hz with arm\.substeps = 1"
    ):
        Experiment.from_dict({"physics": "wam", "arm": arm})
    assert Experiment.from_dict({"physics": "wam", "arm": {**arm, "substeps": 2}}).arm.substeps == 2


@pytest.mark.parametrize("text", ["[arm]\nsubsteps = 2", "[arm]\ncable_hz = 20.0"])
def test_stock_mjx_has_neither_substeps_nor_cables(tmp_path: Path, text: str) -> None:
    found = refused(tmp_path, 'physics = "mjx"\n' + text)
    assert (found.line, found.key, found.value) == (1, "physics", "mjx")
    assert "substeps and cable mode" in found.bound
    assert "arm.substeps = 1" in found.remedy


def test_without_arm_the_same_mistakes_of_structure_are_told(tmp_path: Path) -> None:
    """A linear experiment needs no posture, but what is written must be right."""
    assert refused(tmp_path, "[arm]\nbeyond_sensor = 1.0").key == "arm.beyond_sensor"


def test_everything_in_python_is_checked_as_well() -> None:
    with pytest.raises(InputError, match=r"arm\.integrator"):
        ArmSettings(cable_hz=20.0, integrator="euler")
    with pytest.raises(InputError, match=r"arm\.posture"):
        robot_of(Experiment(physics="wam", arm=ArmSettings(posture=(3.0, 0.7, 0.0, 2.2))))


@settings(max_examples=5)
@example(q=(0.6386565589879094, 1.0, 0.0, 1.0), centre=(0.0, 0.7, 0.0, 2.2))
@given(
    q=st.tuples(*[st.floats(-1.0, 1.0)] * 4),
    centre=st.sampled_from([(0.0, 0.7, 0.0, 2.2), (0.3, -0.5, 0.4, 1.2), (-0.8, 0.9, -0.6, 1.5)]),
)
def test_a_target_is_reached_within_the_limits(q: tuple[float, ...], centre: tuple[float, ...]) -> None:
    """Any point that some posture up to 0.8 rad away touches, to 1 µm."""
    low, high = joint_ranges().T
    target = tip_at(np.clip(np.array(centre) + 0.8 * np.array(q), low, high))
    found = np.array(ArmSettings(target=tuple(target.tolist()), posture=centre).resting())
    assert np.linalg.norm(tip_at(found) - target) <= 1e-6
    assert (found >= low - 1e-12).all()
    assert (found <= high + 1e-12).all()


def test_a_target_at_the_posture_is_the_posture() -> None:
    posture = ArmSettings().posture
    found = ArmSettings(target=tuple(tip_at(posture).tolist())).resting()
    np.testing.assert_allclose(found, posture, atol=1e-6)


def test_constants_of_the_world() -> None:
    """Those that are not copied but computed."""
    arm = ArmSettings(
        tool_mass=0.5, compensation=0.5, mass_error=-0.2, cable_hz=20.0, cable_damping=0.1, encoder_counts=2048
    )
    found = robot_of(Experiment(physics="wam", arm=arm, delay=2, velocity_lowpass=100.0))
    assert found.tool_mass == pytest.approx(0.5 - TOOL_MASS)
    assert found.nominal.mass_scale == pytest.approx(0.8)
    np.testing.assert_allclose(found.nominal.friction.coulomb, 0.5 * np.array(arm.coulomb))
    np.testing.assert_allclose(found.nominal.friction.viscous, 0.5 * np.array(arm.viscous))
    np.testing.assert_allclose(found.touch, tip_at(arm.posture))
    assert found.drive.angle_lsb == pytest.approx(2.0 * np.pi / 2048)
    assert found.measurement.velocity_pole == pytest.approx(np.exp(-0.1))
    assert found.extra_delay == 1.0
    omega = 2.0 * np.pi * 20.0
    np.testing.assert_allclose(found.cable.stiffness, omega**2 * link_inertias(arm.posture))
    np.testing.assert_allclose(found.cable.damping, 0.2 * omega * link_inertias(arm.posture))


@pytest.mark.parametrize("error", [0.0, 0.1])
@pytest.mark.parametrize("share", [1.0, 0.8])
@pytest.mark.parametrize("tool", [0.0, TOOL_MASS, 0.8, 4.0])
def test_the_law_knows_the_tool(tool: float, share: float, error: float) -> None:
    """Links and tool are believed in by the same share, whatever the tool weighs; the error comes on top."""
    settings = ArmSettings(tool_mass=tool, mass_error=share - 1.0, tool_mass_error=error)
    believed = robot_of(Experiment(physics="wam", arm=settings)).nominal
    still, four = (0.0,) * 3, (0.0,) * 4
    posture = settings.posture
    found = computed_torque.torque(chain(), believed, posture, posture, four, still, still, four, FLOATS).torque
    compiled = copy(model())
    compiled.body("tool").mass = tool + error / share
    data = mujoco.MjData(compiled)
    data.qpos[:4] = posture
    mujoco.mj_forward(compiled, data)
    np.testing.assert_allclose(found, share * data.qfrc_bias[:4], atol=1e-9)


def test_changes_of_the_tissue_come_one_after_the_other() -> None:
    """Smooth within their duration, half way at its middle; a duration of 0 is a step."""
    tissue = {"changes": [{"at": 1.0, "factor": 4.0, "duration": 0.2}, {"at": 2.0, "factor": 0.5, "duration": 0.0}]}
    found: TissueSettings = Experiment.from_dict({"physics": "wam", "tissue": tissue}).tissue
    at = softening(found, np.array([0.0, 1.0, 1.1, 1.2, 1.999, 2.0, 3.0]))
    np.testing.assert_allclose(at, [1.0, 1.0, 2.5, 4.0, 4.0, 0.5, 0.5])


def test_defaults_are_those_of_the_model_file() -> None:
    compiled = model()
    dofs = [int(compiled.joint(joint).dofadr[0]) for joint in JOINTS]
    np.testing.assert_array_equal(compiled.dof_damping[dofs], ArmSettings().viscous)
    assert compiled.body("tool").mass == ArmSettings().tool_mass == TOOL_MASS


@pytest.mark.parametrize("tissue", [{"kind": "fung"}, {"attached": False}, {"changes": [{"at": 1.0, "factor": 2.0}]}])
def test_the_linear_world_says_which_tissue_it_has(tissue: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="elastic, attached and unchanged") as told:
        Experiment.from_dict({"physics": "linear", "tissue": tissue})
    # The key that is wrong, not a kind that is right.
    assert told.value.key == f"tissue.{next(iter(tissue))}"
    on_arm = Experiment.from_dict({"physics": "wam", "tissue": tissue})
    with pytest.raises(InputError, match="elastic, attached and unchanged"):
        with_physics(on_arm, "linear")
