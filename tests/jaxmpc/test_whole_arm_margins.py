"""Margins of the whole arm: the axis' own on a heavy perfect arm, poles on the unit circle, what an observer costs."""

from dataclasses import replace
from functools import cache
from typing import Any

import msgspec
import numpy as np
import pytest

from jaxmpc import InputError, Params, design
from jaxmpc.stability.loop import contact_of
from jaxmpc.stability.response import loop_response
from jaxmpc.stability.whole_arm import System, radii, whole_arm_system
from jaxmpc.stability.whole_arm_margins import WholeArmMargins, _designed, sensitivity, whole_arm_margins
from jaxmpc.world.arm import chain
from jaxmpc.world.friction import SMALL_VELOCITY
from tests.jaxmpc.test_whole_arm import T_S, experiment, world_of

ARM = experiment().arm
CUTS = ("at_v", "at_a", "at_force")


@cache
def system(bandwidth: float = 0.0, stiffness: float = 375.0, sticking: bool = False) -> System:
    kind, robot = world_of(experiment(stiffness=(stiffness,), momentum_observer=bandwidth))
    return System(*map(np.asarray, whole_arm_system(chain(), kind, robot, design(Params()), 10.0, sticking)))


def uncompiled(*arguments: Any) -> WholeArmMargins:
    """The same without a program for the system, which takes longer to compile than all else in a test."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("jaxmpc.stability.whole_arm_margins._system", _designed)
        return whole_arm_margins(*arguments)


@cache
def found(bandwidth: float = 0.0, stiffness: float = 375.0, sticking: bool = False) -> WholeArmMargins:
    """By the program where there is an observer, which is the larger one."""
    told = whole_arm_margins if bandwidth else uncompiled
    return told(Params(), experiment(stiffness=(stiffness,), momentum_observer=bandwidth), sticking)


@pytest.mark.oracle
@pytest.mark.parametrize(("bandwidth", "K2"), [(0.0, 0.0), (100.0, 0.0), (0.0, 48.4)])
def test_a_heavy_perfect_arm_has_the_sensitivity_of_the_axis(bandwidth: float, K2: float) -> None:
    """With an observer as well: where the model holds, it is not in the loop at all.

    Heavy, so that the tissue's force, which is cancelled a sample late, moves nothing.
    """
    heavy = 1e5
    given = experiment(viscous=(0.0,) * 4, mass_error=0.0, momentum_observer=bandwidth)
    kind, robot = world_of(given)
    robot = robot._replace(tool_mass=heavy, nominal=robot.nominal._replace(tool_error=heavy))
    gains = design(Params())
    arm = whole_arm_system(chain()._replace(gravity=(0.0, 0.0, 0.0)), kind, robot, gains, K2)
    contact = contact_of(810.0, K2, given.loop_path())
    for theta in np.geomspace(2e-2, 3.0, 25):
        at_v, at_a = (1.0 / (1.0 + complex(loop_response(gains, contact, theta, cut))) for cut in (0.0, 1.0))
        # K_s over the mass, 8e-3 1/s² a sample or two late, beside frequencies of 20 rad/s and more; masses of 1e5 kg
        # round the observer's torques to 1e-8.
        np.testing.assert_allclose(np.asarray(sensitivity(arm, theta)), np.repeat([at_v, at_a, at_v], 3), rtol=1e-4)


@pytest.mark.oracle
@pytest.mark.parametrize("bandwidth", [0.0, 60.0])
def test_gain_at_the_margin_puts_a_pole_on_the_unit_circle(bandwidth: float) -> None:
    """At each cut of each axis k times the signal goes on instead of it: w = (k − 1) times what came without w."""
    loop, margins = system(bandwidth), found(bandwidth)
    assert float(margins.spectral_radius) == pytest.approx(radii(loop.A), rel=1e-9)
    for cut, name in enumerate(CUTS):
        for axis in range(3):
            row, column = loop.C[3 * cut + axis], loop.B[:, 3 * (cut == 2) + axis]
            for change, sign in (
                (getattr(margins, name).gain_margin_db, 1.0),
                (getattr(margins, name).gain_reduction_db, -1.0),
            ):
                if not np.isfinite(change[axis]):
                    continue
                k = 10.0 ** (sign * float(change[axis]) / 20.0)
                assert radii(loop.A + (k - 1.0) * np.outer(column, row)) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.oracle
@pytest.mark.parametrize("bandwidth", [0.0, 60.0])
def test_lags_and_delays_are_those_of_the_crossovers(bandwidth: float) -> None:
    """By numpy from the same matrices, where |L| crosses 1; between neighbours logarithm and angle are straight."""
    loop, margins = system(bandwidth), found(bandwidth)
    theta = np.geomspace(1e-3, np.pi, 6000)
    at = np.exp(1j * theta)[:, None, None]
    seen = np.concatenate(
        [loop.C @ np.linalg.solve(z * np.eye(len(loop.A)) - loop.A, loop.B + 0j) for z in np.split(at, 60)]
    )
    seen = seen + loop.D
    for cut, name in enumerate(CUTS):
        for axis in range(3):
            S = (cut < 2) + seen[:, 3 * cut + axis, 3 * (cut == 2) + axis]
            L = 1.0 / S - 1.0
            size = np.log(np.abs(L))
            first = np.flatnonzero(size[:-1] * size[1:] < 0.0)
            way = size[first] / (size[first] - size[first + 1])
            lag = np.mod(np.angle(L[first]) + way * np.angle(L[first + 1] / L[first]) + np.pi, 2.0 * np.pi)
            where = theta[first] * (theta[first + 1] / theta[first]) ** way
            told = getattr(margins, name)
            assert float(told.M_s[axis]) == pytest.approx(np.max(np.abs(S)), rel=1e-4)
            assert float(told.phase_margin_deg[axis]) == pytest.approx(np.degrees(lag.min()), rel=1e-3)
            assert float(told.delay_margin_s[axis]) == pytest.approx(T_S * np.min(lag / where), rel=1e-3)


@pytest.mark.oracle
def test_what_an_observer_costs() -> None:
    """On the softest tissue M_s of the text design, 4.3 to 5.2, becomes 5.8 to 7.2; on the hardest it stays."""
    for stiffness, low, high in ((375.0, 1.2, 1.6), (1900.0, 0.97, 1.0)):
        plain, observed = found(0.0, stiffness), found(60.0, stiffness)
        assert float(observed.spectral_radius) < 1.0
        for name in CUTS:
            ratio = np.asarray(getattr(observed, name).M_s) / np.asarray(getattr(plain, name).M_s)
            assert (low < ratio).all()
            assert (ratio < high).all()


@pytest.mark.oracle
def test_sticking_joints_are_springs() -> None:
    """A bristle follows the joint by T_s/z, and forgets T_s ε/z of itself, a sample; so stiff a tip hardly swings."""
    sliding, sticking = system(), system(sticking=True)
    moved, kept = T_S / ARM.presliding, 1.0 + T_S * SMALL_VELOCITY / ARM.presliding
    assert np.abs(sticking.A - sliding.A).max() == pytest.approx(moved / kept, rel=1e-12)
    assert (np.asarray(found(sticking=True).at_v.M_s) < 0.6 * np.asarray(found().at_v.M_s)).all()


@pytest.mark.oracle
def test_a_loop_that_is_unstable_has_none() -> None:
    """With K̂_s = 200 N/m on 1900; a peak over frequency would be there all the same."""
    lost = whole_arm_margins(Params(Khat_s=200.0), experiment(stiffness=(1900.0,), momentum_observer=60.0))
    assert float(lost.spectral_radius) > 1.05
    for name in CUTS:
        M_s, *others = getattr(lost, name)
        assert np.isinf(M_s).all()
        assert np.isnan(others).all()


@pytest.mark.oracle
def test_a_low_pass_of_ones_own_takes_the_place_of_the_arms() -> None:
    damped, given = Params(K2=100.0), experiment(stiffness=(375.0,), momentum_observer=60.0)
    slow = msgspec.structs.replace(given, velocity_lowpass=60.0)
    own = uncompiled(replace(damped, velocity_cutoff=60.0), given)
    there, quick = whole_arm_margins(damped, slow), whole_arm_margins(damped, given)
    for name in CUTS:
        np.testing.assert_allclose(getattr(own, name).M_s, getattr(there, name).M_s, rtol=1e-9)
        assert (np.abs(np.asarray(getattr(own, name).M_s) / np.asarray(getattr(quick, name).M_s) - 1.0) > 1e-3).all()


@pytest.mark.oracle
def test_a_filter_of_the_force_is_one_wherever_it_is_named() -> None:
    """The experiment's, or the controller's own."""
    given = experiment(stiffness=(375.0,))
    sensor = msgspec.structs.replace(given.sensor, kalman=160.0 * given.sensor.noise)
    filtered = msgspec.structs.replace(given, sensor=sensor)
    pairs = (Params(force_cutoff=filtered.force_cutoff), given), (Params(), filtered), (Params(), given)
    own, there, bare = (uncompiled(*pair) for pair in pairs)
    for name in CUTS:
        np.testing.assert_allclose(getattr(own, name).M_s, getattr(there, name).M_s, rtol=1e-9)
        assert (np.abs(np.asarray(getattr(own, name).M_s) / np.asarray(getattr(bare, name).M_s) - 1.0) > 1e-3).all()


def test_one_controller_at_a_time() -> None:
    with pytest.raises(InputError, match="one controller"):
        whole_arm_margins(Params.stack([Params(), Params()]), experiment())
