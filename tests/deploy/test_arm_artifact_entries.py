"""Each entry of a file of the kind "wam" that is missing or wrong has a sentence of its own."""

import numpy as np
import pytest

from deploy.controller import arm_model
from deploy.controller.arm_model import MEANING
from deploy.controller.limits import ROWS
from jaxmpc.files.sealed import unseal
from tests.deploy.changed_files import arm_file, refused


@pytest.fixture
def opened():
    """Header and arrays, to be changed."""
    return unseal(arm_file())


@pytest.mark.parametrize("key", MEANING)
def test_each_missing_entry_is_named_with_what_it_is_for(opened, key):
    refused(opened, rf"arm\.{key} = missing: must be given: {MEANING[key]}", f"arm.{key}", ...)


@pytest.mark.parametrize("key", [name for name, row in ROWS.items() if not row.optional])
def test_each_missing_limit_is_named(opened, key):
    refused(opened, rf"limits\.{key} = missing: must be given.*Every limit is mandatory", f"arm.limits.{key}", ...)


@pytest.mark.parametrize("name", [*arm_model.GOLDEN, "golden_force"])
def test_each_missing_array_is_named(opened, name):
    refused(opened, f"it lacks the array {name}", **{name: None})


def test_a_model_without_a_table_is_refused(opened):
    refused(opened, "its header lacks arm", "arm", ...)
    refused(opened, "arm = None: must be a table of robot, chain", "arm", None)


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("version", 3, "newer than 2: update jaxmpc"),
        ("kind", "wam7", "of the kind 'wam7'; this version of jaxmpc knows 'linear' and 'wam'"),
        ("arm.robot", "Barrett WAM 7-DoF", "arm.robot = Barrett WAM 7-DoF: must be 'Barrett WAM 4-DoF'. Freeze a"),
        ("arm.robot", None, "arm.robot = None: must be"),
        ("arm.compensated", 1, "arm.compensated = 1: must be true or false"),
        ("arm.momentum_observer", 101.0, r"arm.momentum_observer = 101.0: must be in \[0, 100\]"),
        ("arm.encoder_counts", 4096.5, "arm.encoder_counts = 4096.5: must be a whole number"),
        ("arm.encoder_counts", -1, "arm.encoder_counts = -1: must be a whole number"),
        ("loop.velocity_cutoff", "fast", "loop.velocity_cutoff = fast: must be a number"),
        ("loop.velocity_cutoff", -1.0, r"loop.velocity_cutoff = -1.0: must be in \[0, 1e5\]"),
        ("arm.tool_length", 0.35, "arm.chain = another arm: its tip is 10 mm off: must be that of a Barrett WAM"),
        ("arm.chain.links.3.position", [0.045, 0.0, 0.5], "arm.chain = another arm: its tip is"),
        ("arm.chain.links.0.mass", -1.0, r"arm.chain.links\[0\].mass = -1.0: must be positive"),
        ("arm.chain.links.1.inertia", [[1, 2], [3, 4]], r"arm.chain.links\[1\].inertia = an array of shape \(2, 2\)"),
        ("arm.chain.links.1.inertia", [[-9, 0, 0], [0, -9, 0], [0, 0, -9]], "a mass matrix that is not one"),
        ("arm.chain.links.1.surplus", 1.0, r"arm.chain.links\[1\].surplus = 1.0: must be a known key"),
        ("arm.chain.links", [], r"arm.chain.links = \[\]: must be four links"),
        ("arm.chain.armature", [0.2, 0.2, 0.1, -0.1], "arm.chain.armature = .* must be not negative"),
        ("arm.chain.gravity", [0, 0, 0], "arm.chain.gravity = .* must be of 9.7 to 9.9"),
        ("arm.chain.gravity", [0, 0, -9.91], "arm.chain.gravity = .* must be of 9.7 to 9.9"),
        ("arm.chain.gravity", [0, 0, -9.69], "arm.chain.gravity = .* must be of 9.7 to 9.9"),
        ("arm.chain.tip", [0.0, "1e999", 0.0], "arm.chain.tip = an array of"),
        ("arm.nominal.mass_scale", 0.0, r"arm.nominal.mass_scale = 0.0: must be in \[0.1, 2\]"),
        ("arm.nominal.tool_error", 10**400, "arm.nominal.tool_error = 1000.*must be a number"),
        ("arm.nominal.friction", [], r"arm.nominal.friction = \[\]: must be a table of coulomb, viscous, presliding"),
        ("arm.nominal.friction.coulomb", [-1.0, 0, 0, 0], "arm.nominal.friction = .* must be not negative"),
        ("arm.nominal.friction.viscous", [0, 0, 0, -1.0], "arm.nominal.friction = .* must be not negative"),
        ("arm.nominal.friction.presliding", 0.0, r"friction.presliding = 0.0: must be in \[1e-05, 0.1\]"),
        ("arm.posture", [0.0, 0.7, 0.0], r"arm.posture = an array of shape \(3,\)"),
        ("arm.posture", [3.0, 0.7, 0.0, 2.2], r"arm.posture of J1 = 3: must be in \[-2.6, 2.6\] rad"),
        ("arm.posture", [0.0, 0.0, 0.0, 0.0], r"tip at arm.posture, x = .* m: must be in \["),
        ("arm.limits", None, "limits = None: must be a table of force"),
        ("arm.limits.force", 4.0, "golden_force = 5.* N: must be at most 4 N, its limit. Choose limits"),
        ("arm.limits.force", 1000.0, r"limits.force = 1000: must be in \[0.1, 100\] N"),
        (
            "arm.limits.joint_torque",
            [25.0, 2.0, 15.0, 15.0],
            "golden_torque of J2 = .* N m: must be at most 2 N m, its",
        ),
        ("arm.limits.torque_rates", [1.0] * 4, "limits.torque_rates = unknown"),
        ("loop.ideal", True, "margins = of the ideal loop: must be those of the loop as it runs"),
        (
            "margins.0.stiffness",
            14.9,
            "stiffness = 14.9: must be at least 15 N/m, into which the force limit sinks the tip",
        ),
        ("margins.2.spectral_radius", 1.01, "spectral_radius at 1900 N/m = 1.01: must be below 1"),
        ("T_s", 2e-3, "deviation from the golden t"),
        ("K2", 10.0001, "deviation from the golden trace"),
        ("gains.input_gain", 89.0, "deviation from the golden trace"),
    ],
)
def test_each_wrong_entry_has_its_sentence(opened, path, value, message):
    refused(opened, message, path, value)


@pytest.mark.parametrize("name", arm_model.GOLDEN)
def test_each_wrong_array_has_its_sentence(opened, name):
    good = opened[1][name]
    refused(opened, rf"{name} = an array of shape \(6, 3\)", **{name: good[:, :3]})
    refused(opened, f"its array {name} is of <U", **{name: good.astype(str)})
    refused(opened, f"{name} = not finite somewhere", **{name: np.where(good == good[2, 1], np.nan, good)})
    changed = good.copy()
    changed[3, 1] += 1e-6
    refused(opened, "deviation from the golden t", **{name: changed})
    if name == "golden_q":
        refused(opened, "golden_applied = an array of shape", **{name: good[:5]})


def test_a_trace_of_another_length_than_the_forces_is_refused(opened):
    short = {name: opened[1][name][:5] for name in arm_model.GOLDEN}
    refused(opened, "golden_q = 5 samples: must be of as many samples as golden_force, 6", **short)
