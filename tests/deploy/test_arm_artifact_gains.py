"""Guard, schedule and filter among the gains of a file of the kind "wam"."""

import math
from dataclasses import replace

import numpy as np
import pytest

from deploy.controller import frozen_gains
from deploy.controller.arm_model import KNOWN
from deploy.controller.file import from_bytes, to_bytes
from deploy.controller.freeze import freeze
from jaxmpc.files.errors import InputError
from jaxmpc.files.sealed import seal, unseal
from jaxmpc.law.force_filter import ForceFilter
from jaxmpc.law.gain_backoff import GainBackoff
from tests.deploy import made
from tests.deploy.changed_files import arm_file, refused, replaced


@pytest.fixture
def opened():
    """Header and arrays, to be changed."""
    return unseal(arm_file())


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


@pytest.fixture(scope="module")
def family():
    """Header and arrays of a family whose trace is over before its schedule has any of the control."""
    return unseal(to_bytes(made.arm_artifact(6, gains=made.scheduled_gains())))


KNOT_GAINS = ("phi", "gamma", "K", "L", "input_gain", "mpc_ref", "mpc_x", "mpc_u")


@pytest.mark.parametrize("name", [*(f"gains.{each}" for each in KNOT_GAINS), "K2", "log_stiffness"])
@pytest.mark.parametrize("knot", [0, 1])
def test_the_gains_of_every_knot_are_held_by_the_trace(family, knot, name):
    """Also those on which the run's own tissue never comes."""
    value = family[0]["gains"]["schedule"]["knots"][knot]
    for key in name.split("."):
        value = value[key]
    # Of the weights of the reference, which are summed here, the first few stand for all.
    for place in range(min(len(value), 4)) if isinstance(value, list) else [None]:
        more = 1.001 * value if place is None else [x * (1.001 if i == place else 1.0) for i, x in enumerate(value)]
        refused(family, "deviation from the golden torques", f"gains.schedule.knots.{knot}.{name}", more)


def test_a_family_of_before_its_knots_were_traced_is_refused(family, guarded):
    known, memory = (family[1][name] for name in KNOWN)
    for name, given in ((KNOWN[0], np.zeros((4, 16, 4))), (KNOWN[1], np.zeros((4, 9)))):
        message = f"{name} = missing: must be given for a controller with a schedule, .* Freeze the controller again"
        refused(family, message, **{name: None})
        refused(guarded, f"{name} = given: must be given for .* and for no other", **{name: given})
    refused(family, r"golden_known = an array of shape \(1, 6, 4\)", golden_known=known[:1])
    refused(family, r"golden_known = an array of shape \(4, 5, 4\)", golden_known=known[:, :5])
    refused(family, r"golden_memory = an array of shape \(2, ", golden_memory=memory[:2])
    refused(family, r"golden_memory = an array of shape \(4, 9\)", golden_memory=memory[:, :9])
    refused(family, "deviation from the golden torques", golden_known=known + 1e-8)
    refused(family, "deviation from the golden memory", golden_memory=memory * (1.0 + 1e-8))


def test_a_guard_of_nothing_is_none(opened):
    header, arrays = opened
    assert from_bytes(seal(replaced(header, "gains.guard", None), arrays)).gains.guard is None


def test_the_cascades_alone_have_no_guard(tmp_path, arguments):
    guarded = arguments | {"gains": made.guarded_gains()}
    with pytest.raises(InputError, match="guard = given: must be left out where no arm is driven"):
        freeze(tmp_path / "c.npz", **guarded)


@pytest.mark.parametrize("wrong", [{"M_s": 2.01}, {"spectral_radius": 1.0}])
def test_a_family_keeps_its_floor_where_the_tissue_is_known_too(wrong):
    family = made.arm_artifact(6, gains=made.scheduled_gains())
    rows = [made.margin_row(375.0), made.margin_row(810.0, **wrong)]
    with pytest.raises(InputError, match=f"^{min(wrong)} with the tissue known to have about 810 N/m"):
        replace(family, family={"band": 0.08, "rows": rows})


ROWS = [made.margin_row(810.0)]


@pytest.mark.parametrize(
    ("wrong", "key"),
    [
        ({"band": 0.0, "rows": ROWS}, "family.band"),
        ({"band": 1.0, "rows": ROWS}, "family.band"),
        ({"band": -0.08, "rows": ROWS}, "family.band"),
        ({"band": True, "rows": ROWS}, "family.band"),
        ({"band": 0.25, "rows": ROWS}, "family.band"),
        ({"band": 0.08}, "family"),
        ({"band": 0.08, "rows": ROWS, "knots": 2}, "family"),
        (7, "family"),
        ({"band": 0.08, "rows": []}, "margins"),
    ],
)
def test_a_family_tells_its_band_and_its_margins_and_nothing_else(wrong, key):
    family = made.arm_artifact(6, gains=made.scheduled_gains())
    with pytest.raises(InputError, match=f"^{key} = "):
        replace(family, family=wrong)
    assert replace(family, family={"band": 0.08, "rows": ROWS}).family == {"band": 0.08, "rows": ROWS}


@pytest.mark.parametrize("share", [0.5, 2.0])
def test_a_filter_of_the_force_runs_at_the_rate_of_the_law(share):
    artifact = made.arm_artifact(6)
    own = ForceFilter(share * made.T_S, 0.3, 40.0)
    with pytest.raises(InputError, match=r"^force_filter\.T_s = "):
        replace(artifact, gains=artifact.gains._replace(force_filter=own))
