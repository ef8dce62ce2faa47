"""How the lungs move the heart, and what a beat's strength and an axis' size do to it: by hand and by differences."""

import numpy as np
import pytest

from jaxmpc.world.heart.motion import Motion, displacement
from jaxmpc.world.heart.phase import beat_gain


@pytest.mark.parametrize("ventilation", ["hold", "cough"])
def test_velocity_is_the_derivative_while_breathing_stops_and_starts_again(ventilation: str) -> None:
    """At every 2 ms; differences over 20 µs are off by a thousandth of a µm/s."""
    motion, step = Motion(kind="rhythm", ventilation=ventilation, ventilation_at=2.0, hold_duration=2.0), 1e-5
    t = np.arange(1.5, 5.5, 2e-3)
    before, after = (displacement(motion, t + way * step)[0] for way in (-1.0, 1.0))
    np.testing.assert_allclose(displacement(motion, t)[1], (after - before) / (2.0 * step), rtol=0, atol=1e-6)


def test_a_cough_goes_where_breathing_goes() -> None:
    """By the table's amplitudes at 0.34 and 0.72 Hz, in mm."""
    t = np.array([10.3])
    cough, none = (displacement(Motion(kind="rhythm", ventilation=each), t)[0][0] for each in ("cough", "steady"))
    direction = np.hypot([0.80, 0.90, 1.90], [0.28, 0.30, 0.60])
    np.testing.assert_allclose(cough - none, 0.010 * direction / np.linalg.norm(direction), rtol=1e-9)


def test_each_axis_has_a_size_of_its_own() -> None:
    t = np.linspace(3.0, 8.0, 50)
    drawn, table = (displacement(Motion(kind="rhythm", amplitude_spread=spread), t)[0] for spread in (0.5, 0.0))
    sizes = np.sum(drawn * table, axis=0) / np.sum(table * table, axis=0)
    np.testing.assert_allclose(drawn, sizes * table, rtol=0, atol=1e-12)
    assert np.all((sizes > 0.5) & (sizes < 1.5))
    assert np.ptp(sizes) > 0.01


def test_the_strength_of_a_beat_goes_over_in_the_last_third_of_the_one_before() -> None:
    gain, slope = beat_gain(np.array([1.0, 2.0, 0.5]), np.array([0.5, 0.7, 0.85, 1.0, 1.6, 1.85, 2.0]))
    np.testing.assert_allclose(gain, [1.0, 1.0, 1.5, 2.0, 2.0, 1.25, 0.5], rtol=0, atol=1e-12)
    # 15/8 of the mean slope half way.
    np.testing.assert_allclose(slope, [0.0, 0.0, 1.875 / 0.3, 0.0, 0.0, -1.5 * 1.875 / 0.3, 0.0], rtol=0, atol=1e-9)
