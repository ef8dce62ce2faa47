import json
import math

import numpy as np
import pytest

from deploy.controller.limits import MECHANICAL_STOPS, ROWS, Limits
from jaxmpc.files.errors import InputError

TIP = (0.51856, 0.0, 0.05289)
PLAIN = Limits.default(TIP).plain()
MANDATORY = [name for name, row in ROWS.items() if not row.optional]


def changed(name, value, index=None):
    table = json.loads(json.dumps(PLAIN))
    if index is None:
        table[name] = value
    else:
        table[name][index] = value
    return table


def refusal(table):
    with pytest.raises(InputError) as caught:
        Limits.from_plain(table)
    return str(caught.value)


def test_plain_data_survives_a_file():
    assert Limits.from_plain(json.loads(json.dumps(PLAIN))) == Limits.default(TIP)
    assert Limits.from_plain(Limits.default(np.array(TIP)).plain()) == Limits.default(TIP)


def test_default_is_around_the_tip_and_within_reach():
    assert Limits.default(TIP).workspace == tuple((at - 0.10, at + 0.10) for at in TIP)
    assert Limits.default((0.0, -0.95, 0.95)).workspace == ((-0.1, 0.1), (-1.0, -0.85), (0.85, 1.0))


@pytest.mark.parametrize("name", MANDATORY)
def test_each_limit_is_mandatory(name):
    table = {key: value for key, value in PLAIN.items() if key != name}
    assert refusal(table).startswith(f"limits.{name} = missing: must be given [")
    with pytest.raises(TypeError, match=name):
        Limits(**table)


def test_a_file_older_than_a_limit_takes_its_default(monkeypatch):
    monkeypatch.setitem(ROWS, "force", ROWS["force"]._replace(optional=True, default=12.0))
    assert Limits.from_plain({key: value for key, value in PLAIN.items() if key != "force"}).force == 12.0
    assert Limits.from_plain(PLAIN).force == PLAIN["force"]


@pytest.mark.parametrize("table", [None, [], "force", 3])
def test_something_else_than_a_table_is_refused(table):
    assert "must be a table of force" in refusal(table)


def test_unknown_limits_are_refused():
    assert "limits.speed = unknown" in refusal({**PLAIN, "speed": 1.0})


CEILINGS = [
    (name, i, low, high)
    for name, row in ROWS.items()
    if not row.widest
    for i, (low, high) in enumerate(zip(np.ravel(row.lowest), np.ravel(row.highest), strict=True))
]


@pytest.mark.parametrize(("name", "index", "low", "high"), CEILINGS)
def test_nobody_can_declare_more_or_less(name, index, low, high):
    at = index if isinstance(PLAIN[name], list) else None
    for value in (low, high):
        limits = Limits.from_plain(changed(name, float(value), at))
        assert np.ravel(getattr(limits, name))[index] == value
    for value in (np.nextafter(low, -np.inf), np.nextafter(high, np.inf), 0.0, -high, 1e300):
        message = refusal(changed(name, float(value), at))
        assert f"limits.{name}" in message
        assert f"in [{low:g}, {high:g}]" in message


def test_the_ceilings_are_the_published_ones():
    assert ROWS["motor_torque"].highest == (4860 / 2700, 4860 / 2700, 4860 / 2700, 4320 / 2700)
    assert ROWS["joint_velocity"].highest == (2.5,) * 4
    assert (ROWS["tip_velocity"].highest, ROWS["force"].highest) == (1.0, 100.0)
    assert ROWS["joint_torque"].highest == pytest.approx((75.6, 101.7, 60.5358, 28.8), abs=0.01)


@pytest.mark.parametrize("name", ["joint_range", "workspace"])
def test_ranges_are_within_what_can_be_reached(name):
    for i, (lowest, highest) in enumerate(MECHANICAL_STOPS if name == "joint_range" else ((-1.0, 1.0),) * 3):
        assert getattr(Limits.from_plain(changed(name, [lowest, highest], i)), name)[i] == (lowest, highest)
        beyond = ([np.nextafter(lowest, -9), highest], [lowest, np.nextafter(highest, 9)], [0.1, 0.1], [0.2, 0.1])
        for pair in [*beyond, [0.0], [0.0, 0.1, 0.2], 0.5, ["a", "b"], [math.nan, 0.1], None]:
            assert f"limits.{name}[{i}]" in refusal(changed(name, pair, i))


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, "5", b"5", True, None, [], {}, 10**400])
def test_what_is_no_number_is_refused(value):
    assert "must be a finite number" in refusal(changed("force", value))
    assert "limits.torque_rate[2]" in refusal(changed("torque_rate", value, 2))


@pytest.mark.parametrize("value", [5.0, "abcd", [1.0] * 3, [1.0] * 5, {1: 1, 2: 2, 3: 3, 4: 4}, None])
def test_a_list_needs_its_length(value):
    assert "limits.joint_torque = " in refusal(changed("joint_torque", value))


def test_limits_cannot_be_changed():
    with pytest.raises(AttributeError):
        Limits.default(TIP).force = 1.0
