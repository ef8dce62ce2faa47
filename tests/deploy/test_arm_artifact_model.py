"""Model, limits and trace of a file of the kind "wam" hold one another."""

from dataclasses import replace

import numpy as np
import pytest

from deploy.controller import arm_model, golden
from deploy.controller.arm_model import ArmModel
from deploy.controller.limits import Limits
from jaxmpc.files.errors import InputError
from jaxmpc.files.sealed import unseal
from tests.deploy import made
from tests.deploy.changed_files import arm_file, refused


@pytest.fixture
def opened():
    """Header and arrays, to be changed."""
    return unseal(arm_file())


CONSTANTS = [
    *(f"chain.links.{i}.inertia" for i in range(4)),
    *(f"chain.links.{i}.moment" for i in range(1, 4)),  # that of the first turns about the vertical only
    *("chain.links.3.mass", "chain.armature", "chain.gravity"),  # the other links' origins rest
    *("nominal.mass_scale", "nominal.tool_error", "posture"),
]


@pytest.mark.parametrize("path", CONSTANTS)
def test_every_constant_of_the_model_is_held_by_the_trace(opened, path):
    """Changed by a thousandth it is refused; those that are left out have no effect on any torque."""
    value = opened[0]["arm"]
    for key in path.split("."):
        value = value[int(key) if key.isdigit() else key]
    refused(opened, "deviation from the golden t", f"arm.{path}", (np.array(value) * 1.001).tolist())


def test_the_velocity_filter_is_held_by_the_trace(opened):
    refused(opened, "deviation from the golden t", "loop.velocity_cutoff", 1.001 * opened[0]["loop"]["velocity_cutoff"])


def without(ranges, i, place, above):
    """The same ranges, the one of them shut at one side of a place that it held."""
    low, high = ranges[i]
    shut = (place + 0.01, high) if above else (low, place - 0.01)
    return tuple(shut if k == i else each for k, each in enumerate(ranges))


@pytest.mark.parametrize("above", [False, True])
def test_limits_hold_the_posture_of_every_joint_and_its_tip(above):
    model = made.arm_artifact(6).arm
    limits, tip = model.limits, arm_model.published_tip(model.posture, model.tool_length).tolist()
    for i, angle in enumerate(model.posture):
        narrow = without(limits.joint_range, i, angle, above)
        with pytest.raises(InputError, match=f"^arm.posture of J{i + 1} = "):
            replace(model, limits=replace(limits, joint_range=narrow))
    for i, name in enumerate("xyz"):
        narrow = without(limits.workspace, i, tip[i], above)
        with pytest.raises(InputError, match=f"^tip at arm.posture, {name} = "):
            replace(model, limits=replace(limits, workspace=narrow))


@pytest.mark.parametrize("joint", range(4))
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_limits_bear_the_torques_of_the_trace_either_way(joint, sign):
    model = made.arm_artifact(6).arm
    torque = model.golden_torque.copy()
    torque[3, joint] = sign * (model.limits.joint_torque[joint] + 0.1)
    with pytest.raises(InputError, match=f"^golden_torque of J{joint + 1} = "):
        replace(model, golden_torque=torque)


def test_an_arm_whose_third_joint_turns_the_other_way_is_another_though_its_tip_at_the_posture_is_the_same():
    model = made.arm_artifact(6).arm
    first, second, third, fourth = model.chain.links
    over = np.diag((1.0, -1.0, -1.0))
    third = third._replace(rotation=made.tuples(np.array(third.rotation) @ over))
    turned = fourth._replace(
        position=tuple((over @ fourth.position).tolist()), rotation=made.tuples(over @ np.array(fourth.rotation))
    )
    with pytest.raises(InputError, match=r"another arm: its tip is .* mm off"):
        replace(model, chain=model.chain._replace(links=(first, second, third, turned)))


@pytest.mark.parametrize(("place", "name"), [(0, "trace"), (1, "torques"), (2, "memory")])
def test_a_replay_that_is_no_number_reproduces_nothing(monkeypatch, place, name):
    monkeypatch.setattr(golden, "replay", lambda artifact: [np.nan if i == place else 0.0 for i in range(3)])
    with pytest.raises(InputError, match=f"^deviation from the golden {name} = nan"):
        golden.check_golden(made.arm_artifact(6))


def test_limits_are_limits():
    arguments = made.arm_arguments(6)["arm"]
    with pytest.raises(InputError, match=r"arm\.limits = .* must be a table of limits"):
        ArmModel(**(arguments | {"limits": arguments["limits"].plain()}))
    assert isinstance(ArmModel(**arguments).limits, Limits)


def test_a_law_that_cannot_be_computed_is_a_refusal(opened):
    """A straight arm cannot move its tip along itself, and Python's arithmetic raises."""
    straight = opened[1]["golden_q"].copy()
    straight[-1] = 0.0
    refused(opened, "its law cannot be computed: float division by zero", golden_q=straight)


def test_an_observer_too_quick_for_the_samples_is_refused():
    """At 10 ms one of 100 rad/s swings by itself, whatever the margins of the cascades are."""
    artifact = made.arm_artifact(6, momentum_observer=60.0)
    with pytest.raises(InputError, match=r"arm\.momentum_observer = 60\.0: must be at most 50 rad/s at T_s = 0\.01 s"):
        replace(artifact, T_s=0.01)


def test_friction_is_cancelled_by_a_model_or_by_an_observer():
    arguments = made.arm_arguments(6, compensated=True)
    with pytest.raises(InputError, match=r"arm\.momentum_observer = 60\.0: must be 0 beside arm\.compensated"):
        arm_model.ArmModel(**arguments["arm"] | {"momentum_observer": 60.0})
