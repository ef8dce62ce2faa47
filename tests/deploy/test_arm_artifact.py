"""The kind "wam" as a file: what is in it comes back, whole or not at all."""

import numpy as np
import pytest

from deploy.controller.arm_model import ROBOT
from deploy.controller.file import ArtifactError, from_bytes, load, to_bytes
from deploy.controller.freeze import freeze
from jaxmpc.files.errors import InputError
from jaxmpc.files.sealed import unseal
from tests.deploy import made
from tests.deploy.changed_files import arm_file


@pytest.fixture
def data():
    return arm_file()


@pytest.mark.parametrize("gains", [made.text_gains(), made.guarded_gains()], ids=["text", "guarded"])
@pytest.mark.parametrize("preview", [False, True])
@pytest.mark.parametrize("cancelling", [{}, {"compensated": True}, {"momentum_observer": 60.0}])
def test_round_trip(preview, cancelling, gains):
    artifact = made.arm_artifact(6, preview, gains=gains, **cancelling)
    content = to_bytes(artifact)
    again = from_bytes(content)
    assert to_bytes(again) == content
    assert again.kind == "wam"
    assert again.gains == artifact.gains == gains
    # Files of controllers without a guard are those of before there was one.
    assert ("guard" in unseal(content)[0]["gains"]) == (gains.guard is not None)
    assert ("momentum_observer" in unseal(content)[0]["arm"]) == ("momentum_observer" in cancelling)
    for name in (
        "chain",
        "nominal",
        "compensated",
        "momentum_observer",
        "posture",
        "limits",
        "robot",
        "tool_length",
        "encoder_counts",
    ):
        assert getattr(again.arm, name) == getattr(artifact.arm, name)
    assert all(type(x) is float for x in (*again.arm.posture, *again.arm.chain.tip, again.arm.chain.links[3].mass))


def test_same_input_gives_the_same_bytes_however_it_is_given(tmp_path):
    arguments = made.arm_arguments(6)
    golden = tuple(arguments.pop(name) for name in ("golden_force", "golden_force_ref", "golden_v"))
    arm = arguments.pop("arm")
    arm |= {"limits": arm["limits"].plain()}
    freeze(tmp_path / "a.npz", **arguments, golden=golden, arm=arm)
    arm = dict(reversed(arm.items())) | {"posture": np.array(arm["posture"])}
    arm |= {"chain": {"links": [link._asdict() for link in arm["chain"].links]} | arm["chain"]._asdict()}
    frozen = freeze(tmp_path / "b.npz", **arguments, golden=tuple(each.tolist() for each in golden), arm=arm)
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes() == to_bytes(frozen)


def test_every_flipped_bit_and_truncation_is_refused(data):
    flipped = bytearray(data)
    for index in range(len(data)):
        for bit in range(8):
            flipped[index] ^= 1 << bit
            with pytest.raises(ArtifactError, match="seal does not match"):
                from_bytes(bytes(flipped))
            flipped[index] ^= 1 << bit
        with pytest.raises(ArtifactError, match="cut short"):
            from_bytes(data[:index])


def test_rate_and_robot_are_asked_for(data, tmp_path, arguments):
    path, linear = tmp_path / "arm.npz", tmp_path / "linear.npz"
    path.write_bytes(data)
    freeze(linear, **arguments)
    assert load(path, expect_rate=1000.0, expect_robot=ROBOT).arm is not None
    assert load(linear, expect_rate=1000.0).arm is None
    for file, expected, message in [
        (path, {"expect_rate": 500.0}, "its law runs 1000 times a second, not 500: run it at its rate, or freeze it"),
        (path, {"expect_rate": 1000.01}, "its law runs 1000 times a second, not 1000.01"),
        (path, {"expect_robot": "another"}, "it drives a Barrett WAM 4-DoF, and this is a another"),
        (linear, {"expect_robot": ROBOT}, "of the kind 'linear', which replays and drives no arm: freeze it with"),
    ]:
        with pytest.raises(ArtifactError, match=message):
            load(file, **expected)


def test_what_cannot_be_made_cannot_be_frozen(tmp_path):
    arguments = made.arm_arguments(6)
    golden = tuple(arguments.pop(name) for name in ("golden_force", "golden_force_ref", "golden_v"))
    good = arguments.pop("arm")
    good |= {"limits": good["limits"].plain()}
    for change, message in [
        ({"limits": good["limits"] | {"force": 1.0}}, "golden_force"),
        ({"chain": None}, "arm.chain = None: must be a table"),
        ({"golden_torque": good["golden_torque"] + 1e-8}, "deviation from the golden torques"),
        ({"golden_torque": None}, "golden_torque = an array of object"),
        ({"name": "arm"}, "arm.name = arm: must be a known key"),
    ]:
        with pytest.raises(InputError, match=message):
            freeze(tmp_path / "c.npz", **arguments, golden=golden, arm=good | change)
    del good["golden_q"]
    with pytest.raises(InputError, match="golden_q = missing: must be given"):
        freeze(tmp_path / "c.npz", **arguments, golden=golden, arm=good)
    assert not list(tmp_path.iterdir())
