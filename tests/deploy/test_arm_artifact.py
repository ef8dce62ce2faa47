"""The kind "wam" as a file: what is in it comes back, and whatever is missing or wrong has a sentence of its own."""

import math
from dataclasses import replace

import numpy as np
import pytest

from deploy.controller import arm_model, frozen_gains, golden
from deploy.controller.arm_model import MEANING, ROBOT, ArmModel
from deploy.controller.file import ArtifactError, from_bytes, load, to_bytes
from deploy.controller.freeze import freeze
from deploy.controller.limits import ROWS, Limits
from jaxmpc.files.errors import InputError
from jaxmpc.files.sealed import seal, unseal
from jaxmpc.law.force_filter import ForceFilter
from jaxmpc.law.gain_backoff import GainBackoff
from tests.deploy import made


@pytest.fixture(scope="module")
def data():
    return to_bytes(made.arm_artifact(6))


@pytest.fixture
def opened(data):
    """Header and arrays, to be changed."""
    return unseal(data)


def replaced(table, path, value):
    """The same nested table with another value at a dotted path; ... removes it."""
    key, _, rest = path.partition(".")
    if isinstance(table, list):
        return [replaced(each, rest, value) if str(i) == key else each for i, each in enumerate(table)]
    inner = replaced(table[key], rest, value) if rest else value
    return {k: v for k, v in (table | {key: inner}).items() if v is not ...}


def refused(opened, message, path=None, value=None, **arrays):
    header, held = opened
    header = replaced(header, path, value) if path else header
    with pytest.raises(ArtifactError, match=message):
        from_bytes(seal(header, {k: v for k, v in (held | arrays).items() if v is not None}))


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


@pytest.mark.parametrize(("ratio", "told_apart"), [(0.9, False), (1.0, False), (1.0009, False), (1.001, True)])
def test_knots_are_as_far_apart_as_a_design_has_them(ratio, told_apart):
    gains = made.scheduled_gains()
    first, second = gains.schedule.knots
    near = second._replace(log_stiffness=first.log_stiffness + math.log(ratio))
    near = gains._replace(schedule=gains.schedule._replace(knots=(first, near)))
    if told_apart:
        assert frozen_gains.checked(near) == near
    else:
        with pytest.raises(InputError, match=r"schedule\.knots = .*: must be in the order of their stiffness"):
            frozen_gains.checked(near)


@pytest.fixture(scope="module")
def guarded():
    """Header and arrays of a controller whose force swings."""
    return unseal(to_bytes(made.arm_artifact(512, gains=made.guarded_gains())))


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("", [0.9], r"guard = \[0.9\]: must be a table of corner, forgetting, sensitivity, attention, "),
        (".pace", ..., "guard.pace = missing: must be given"),
        (".gain", 1.0, "guard.gain = 1.0: must be a known key"),
        (".corner", 1.0, r"guard.corner = 1.0: must be in \[0, 1\)"),
        (".forgetting", -1e-3, r"guard.forgetting = -0.001: must be in \[0, 1\)"),
        (".pace", 1.5, r"guard.pace = 1.5: must be in \[0, 1\)"),
        (".recovery", None, "guard.recovery = an array of object: must be an array of numbers"),
        (".recovery", [0.0], r"guard.recovery = an array of shape \(1,\)"),
        (".sensitivity", 0.0, "guard.sensitivity = 0.0: must be at least 1e-09"),
        (".sensitivity", "1e999", "guard.sensitivity = an array of <U"),
        ("", None, "deviation from the golden trace"),
    ],
)
def test_a_wrong_guard_is_refused(guarded, path, value, message):
    refused(guarded, message, f"gains.guard{path}", value)


@pytest.mark.parametrize("name", GainBackoff._fields)
def test_every_constant_of_the_guard_is_held_by_the_trace(guarded, name):
    value = guarded[0]["gains"]["guard"][name] * 1.001
    refused(guarded, "deviation from the golden t", f"gains.guard.{name}", value)


def test_a_guard_of_nothing_is_none(opened):
    header, arrays = opened
    assert from_bytes(seal(replaced(header, "gains.guard", None), arrays)).gains.guard is None


def test_the_cascades_alone_have_no_guard(tmp_path, arguments):
    guarded = arguments | {"gains": made.guarded_gains()}
    with pytest.raises(InputError, match="guard = given: must be left out where no arm is driven"):
        freeze(tmp_path / "c.npz", **guarded)


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


@pytest.mark.parametrize("wrong", [{"M_s": 2.01}, {"spectral_radius": 1.0}])
def test_a_family_keeps_its_floor_where_the_tissue_is_known_too(wrong):
    family = made.arm_artifact(6, gains=made.scheduled_gains())
    rows = [made.margin_row(375.0), made.margin_row(810.0, **wrong)]
    with pytest.raises(InputError, match=f"^{min(wrong)} with the tissue known to have about 810 N/m"):
        replace(family, family={"band": 0.08, "rows": rows})


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


@pytest.mark.parametrize("share", [0.5, 2.0])
def test_a_filter_of_the_force_runs_at_the_rate_of_the_law(share):
    artifact = made.arm_artifact(6)
    own = ForceFilter(share * made.T_S, 0.3, 40.0)
    with pytest.raises(InputError, match=r"^force_filter\.T_s = "):
        replace(artifact, gains=artifact.gains._replace(force_filter=own))


@pytest.mark.parametrize(("found", "name"), [((np.nan, 0.0), "trace"), ((0.0, np.nan), "torques")])
def test_a_replay_that_is_no_number_reproduces_nothing(monkeypatch, found, name):
    monkeypatch.setattr(golden, "replay", lambda artifact: found)
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


def test_friction_is_cancelled_by_a_model_or_by_an_observer():
    arguments = made.arm_arguments(6, compensated=True)
    with pytest.raises(InputError, match=r"arm\.momentum_observer = 60\.0: must be 0 beside arm\.compensated"):
        arm_model.ArmModel(**arguments["arm"] | {"momentum_observer": 60.0})
