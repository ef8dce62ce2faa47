import math
import random

import numpy as np
import pytest

from deploy.errors import CalibrationError
from deploy.wam.pucks import PuckInfo, Pucks
from jaxmpc.law.transmission import JOINT_TO_MOTOR

T = np.array(JOINT_TO_MOTOR)


def info(node=1, **changes):
    values = {
        "node": node, "pidx": node, "version": 150, "role": 0x100,
        "counts_per_turn": 4096, "units_per_torque": 2700, "largest_torque": 4860,
    }  # fmt: skip
    return PuckInfo(**values | changes)


def pucks(**changes):
    return Pucks(tuple(info(node, **changes) for node in (1, 2, 3, 4)))


def test_home_counts_are_those_of_the_reference():
    # wam.md §3.2: CTS 4096, home (0, -2, 0, 3.13)
    assert pucks().counts((0.0, -2.0, 0.0, 3.13)) == (0, -36833, 36832, -36728)


def test_angles_units_and_torques_against_numpy():
    draw = np.random.default_rng(0)
    ipnm = np.array([2700, 2562, 2472, 2755])
    cts = np.array([4096, 4096, 40960, 4096])
    made = Pucks(
        tuple(info(n, units_per_torque=int(ipnm[n - 1]), counts_per_turn=int(cts[n - 1])) for n in (1, 2, 3, 4))
    )
    for _ in range(300):
        counts = draw.integers(-40_000, 40_000, 4)
        angles = np.linalg.solve(T, 2.0 * np.pi * counts / cts)
        # 4 multiplications and additions of float64 each
        np.testing.assert_allclose(made.angles(counts.tolist()), angles, rtol=0, atol=1e-12)
        torque = draw.uniform(-20.0, 20.0, 4)
        units = np.linalg.solve(T.T, torque) * ipnm
        given = made.units(torque.tolist())
        assert all(type(each) is int for each in given)
        near = np.abs(units - np.round(units)) < 1e-9
        assert np.all((np.floor(units) == given) | near)
        np.testing.assert_allclose(made.torque(given), T.T @ (np.array(given) / ipnm), rtol=0, atol=1e-12)


def test_rounding_is_towards_minus_infinity_and_loses_less_than_a_unit():
    made = pucks()
    draw = random.Random(1)
    for _ in range(200):
        torque = [draw.uniform(-15, 15) for _ in range(4)]
        motor = np.linalg.solve(T.T, torque) * 2700
        lost = motor - np.array(made.units(torque))
        assert np.all(lost > -1e-9)
        assert np.all(lost < 1.0)


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_torque_that_is_no_number_is_not_rounded_to_one(value):
    with pytest.raises((ValueError, OverflowError)):
        pucks().units((0.0, value, 0.0, 0.0))


def test_the_order_is_that_of_pidx_not_of_nodes():
    swapped = Pucks((info(1, pidx=4), info(2), info(3), info(4, pidx=1)))
    assert swapped.nodes == (4, 2, 3, 1)
    assert swapped.ipnm == (2700,) * 4


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"role": 2}, "no motor puck but says safety"),
        ({"role": 0x1F}, "role 31"),
        ({"counts_per_turn": 0}, "CTS 0"),
        ({"counts_per_turn": -4096}, "CTS -4096"),
        ({"units_per_torque": 0}, "IPNM 0"),
        ({"units_per_torque": 1999}, "IPNM 1999"),
        ({"units_per_torque": 3501}, "IPNM 3501"),
        ({"units_per_torque": 27000}, "IPNM 27000"),
        ({"largest_torque": 0}, "MT 0"),
        ({"largest_torque": 9000}, "MT 9000"),
    ],
)
def test_what_no_working_puck_says_is_refused(changes, says):
    with pytest.raises(CalibrationError, match=says):
        info(3, **changes)


@pytest.mark.parametrize("units", [2000, 3500])
def test_a_motor_at_the_bound_is_taken(units):
    assert info(3, units_per_torque=units).units_per_torque == units


def test_pucks_that_do_not_go_together_are_refused():
    with pytest.raises(CalibrationError, match=r"places .* puck 2: 1.*PIDX"):
        Pucks((info(1), info(2, pidx=1), info(3), info(4)))
    with pytest.raises(CalibrationError, match=r"firmware differs in P .*puck 4: 50"):
        Pucks((info(1), info(2), info(3), info(4, version=50)))
    with pytest.raises(CalibrationError, match=r"firmware differs in T .*puck 4: 50"):
        Pucks((info(1, version=40), info(2, version=40), info(3, version=40), info(4, version=50)))
