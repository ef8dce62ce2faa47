"""A puck cuts torque at a cap of its own: below the controller's limits that is cut here, or the run is refused."""

from dataclasses import replace

import numpy as np
import pytest

from deploy.controller.least_rate import CAPPED
from deploy.controller.limits import Limits
from deploy.doctor_pucks import torque_caps
from deploy.errors import CalibrationError
from deploy.safety.clamp import bounds, clamp
from deploy.safety.puck_caps import within_caps
from deploy.wam.pucks import PuckInfo, Pucks

T_S = 1e-3
LIMITS = Limits.default((0.5, 0.0, 0.2))
NEEDED = (37.0 / 42.0, 50.0 / 56.5 + 30.0 / 33.631, 50.0 / 56.5 + 30.0 / 33.631, 14.0 / 18.0)
"""What the joints' limits leave the motors [N m]."""
USUAL = (1.8, 1.8, 1.8, 1.6)


def capped(motor, cap):
    return tuple(cap if i == motor else each for i, each in enumerate(USUAL))


def test_usual_caps_change_nothing():
    assert within_caps(LIMITS, USUAL) == (LIMITS, "")
    assert within_caps(LIMITS, tuple(1.0001 * each for each in NEEDED)) == (LIMITS, "")


@pytest.mark.parametrize("motor", range(4))
def test_a_cap_a_little_below_becomes_the_limit_and_is_told(motor):
    for share in (CAPPED + 1e-9, 1.0 - 1e-9):
        cap = share * NEEDED[motor]
        limits, said = within_caps(LIMITS, capped(motor, cap))
        assert limits == replace(LIMITS, motor_torque=capped(motor, cap))
        assert f"motor {motor + 1} at" in said


@pytest.mark.parametrize("motor", range(4))
def test_a_cap_far_below_is_refused_with_a_remedy(motor):
    with pytest.raises(
        CalibrationError, match=rf"motor {motor + 1} .* counts on: set its MT .*motor_torque\[{motor}\]"
    ):
        within_caps(LIMITS, capped(motor, (CAPPED - 1e-9) * NEEDED[motor]))


def test_a_controller_that_declares_less_asks_for_less():
    limits = replace(LIMITS, motor_torque=(0.5, 1.0, 1.0, 0.5))
    assert within_caps(limits, (0.5, 1.0, 1.0, 0.5)) == (limits, "")
    assert within_caps(limits, (0.5, 0.95, 1.0, 0.5))[0].motor_torque == (0.5, 0.95, 1.0, 0.5)


@pytest.mark.parametrize(("ipnm", "mt"), [(2755, 4860), (2472, 4200), (3500, 5700), (2700, 4400)])
def test_no_torque_that_the_clamp_lets_pass_is_cut_by_a_puck(ipnm, mt):
    """From any torque to any other, at the arm's limits and beyond them, in whole units."""
    pucks = Pucks(tuple(PuckInfo(n, n, 150, 0, 4096, ipnm, mt) for n in (1, 2, 3, 4)))
    limits, said = within_caps(LIMITS, pucks.caps)
    assert said
    within, last, draw, most = bounds(limits, T_S, pucks.ipnm), (0.0,) * 4, np.random.default_rng(1), 0
    for _ in range(5000):
        wanted = tuple(draw.choice((-1.0, 1.0), 4) * draw.uniform(0.5, 2.0) * np.array(LIMITS.joint_torque))
        units = pucks.units(clamp(wanted, last, within)[0])
        last, most = pucks.torque(units), max(most, *map(abs, units))
        assert max(map(abs, units)) <= mt
    assert most > 0.99 * mt


class Told:
    """Pucks that answer questions; their places in a torque are not their numbers."""

    def __init__(self, caps, ipnm=2700, **changed):
        self.values = {n: {0: 150, 70: 5 - n, 86: ipnm, 43: round(caps[4 - n] * ipnm)} for n in (1, 2, 3, 4)}
        for node, values in changed.items():
            self.values[int(node[-1])].update(values)

    def __call__(self, node, number):
        return self.values[node].get(number)


def test_the_doctor_tells_what_a_run_would():
    assert torque_caps(LIMITS, Told(USUAL)) == (True, "")
    fine, said = torque_caps(LIMITS, Told(capped(2, 0.95 * NEEDED[2])))
    assert (fine, said) == (True, within_caps(LIMITS, capped(2, round(0.95 * NEEDED[2] * 2700) / 2700))[1])
    fine, said = torque_caps(LIMITS, Told(capped(0, 0.5 * NEEDED[0])))
    assert not fine
    assert "the puck of motor 1 cuts its torque at" in said


@pytest.mark.parametrize(
    ("changed", "fine", "says"),
    [
        ({"puck3": {0: None}}, True, "do not tell their torque caps"),
        ({"puck3": {43: None}}, True, "do not tell their torque caps"),
        ({"puck3": {0: 10}}, False, "36 or newer"),
        ({"puck3": {70: 1}}, False, "PIDX"),
        ({"puck3": {86: 0}}, False, "cuts its torque at 0 N m"),
    ],
)
def test_the_doctor_bears_pucks_that_tell_little_or_nonsense(changed, fine, says):
    found, said = torque_caps(LIMITS, Told(USUAL, **changed))
    assert found is fine
    assert says in said
