"""Goals: normalisation, the violation that leads back, stability first."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmpc.metrics import Metrics
from jaxmpc.stability import Margins
from tuning.job.goals import OVERSHOOT, margin_goals, run_goals

LIMITS = {
    "M_s": 2.0,
    "gain_margin_db": 6.0,
    "gain_reduction_db": 4.0,
    "phase_margin_deg": 30.0,
    "delay_margin_s": 1.5e-3,
}


def found(radius: float = 0.99, **changes: float) -> Margins:
    """Margins of one stiffness, all of them exactly at their limits unless changed."""
    values = {name: jnp.asarray([value]) for name, value in {**LIMITS, **changes}.items()}
    return Margins(**values, spectral_radius=jnp.asarray([radius]), status=jnp.asarray([0]))


def test_every_goal_is_one_at_its_limit() -> None:
    np.testing.assert_allclose(margin_goals(found(), LIMITS).normalised, 1.0)
    assert float(margin_goals(found(), LIMITS).violation) == 0.0


@pytest.mark.parametrize("name", LIMITS)
def test_better_is_below_one_and_worse_is_above(name: str) -> None:
    better, worse = (0.8, 1.25) if name == "M_s" else (1.25, 0.8)
    row = list(LIMITS).index(name)
    good, bad = (margin_goals(found(**{name: factor * LIMITS[name]}), LIMITS) for factor in (better, worse))
    assert float(good.normalised[row, 0]) == pytest.approx(0.8)
    assert float(good.violation) == 0.0
    assert float(bad.normalised[row, 0]) == pytest.approx(1.25)
    assert float(bad.violation) == pytest.approx(0.2)


def test_an_infinite_margin_meets_its_goal() -> None:
    assert float(margin_goals(found(gain_reduction_db=np.inf), LIMITS).normalised[2, 0]) == 0.0


def test_unstable_is_worse_than_any_stable_loop_and_falls_with_the_radius() -> None:
    edge = margin_goals(found(M_s=1e9, **dict.fromkeys(list(LIMITS)[1:], 1e-9)), LIMITS)

    def violation(radius: float) -> float:
        unstable = {"M_s": np.inf, **dict.fromkeys(list(LIMITS)[1:], np.nan)}
        return margin_goals(found(radius, **unstable), LIMITS).violation

    assert float(violation(1.2)) > float(violation(1.01)) > float(edge.violation)
    assert float(jax.grad(violation)(1.1)) == pytest.approx(1 / 1.1)
    assert np.isposinf(margin_goals(found(1.1), LIMITS).normalised).all()


def cells(**fields: np.ndarray) -> Metrics:
    """Metrics (stiffness, scenarios, 3), ones unless given."""
    return Metrics(**{name: fields.get(name, np.ones((2, 4, 3))) for name in Metrics._fields})


def test_a_goal_of_the_runs_sees_its_axis_and_its_reference() -> None:
    rms = np.arange(1.0, 25.0).reshape(2, 4, 3)
    before = rms * 2.0
    before[1, 2, 0] = np.nan
    limits = {"rms": 2.0, "rms_z": 4.0, "rms_ratio": 0.5, "effort_x": 10.0, "chatter": 4.0, OVERSHOOT: 0.2}
    found = run_goals(cells(rms=rms), cells(rms=before), np.array([0.1, 0.3]), limits)
    np.testing.assert_allclose(found["rms"], rms / 2.0)
    np.testing.assert_allclose(found["rms_z"], rms[..., 2:] / 4.0)
    np.testing.assert_allclose(found["effort_x"], 0.1)
    np.testing.assert_allclose(found["chatter"], np.full((2, 4, 3), 0.25))
    np.testing.assert_allclose(found[OVERSHOOT].ravel(), [0.5, 1.5])
    ratio = np.asarray(found["rms_ratio"])
    assert ratio[1, 2, 0] == 0.0, "where the controller before was unstable there is nothing to compare with"
    np.testing.assert_allclose(np.delete(ratio.ravel(), 18), 1.0)


def test_a_ratio_to_nothing() -> None:
    """Whatever is a number is better than a lost run; a lost one is no better than another; more than 0 is no 0."""
    before = cells(clamped=np.array([[[np.nan, np.nan, 0.0], [0.0, 0.5, 0.5]]]))
    after = cells(clamped=np.array([[[0.5, np.nan, 0.5], [0.0, np.nan, 0.25]]]))
    ratio = run_goals(after, before, None, {"clamped_ratio": 0.5})["clamped_ratio"]
    np.testing.assert_array_equal(ratio, [[[0.0, np.nan, np.inf], [0.0, np.nan, 1.0]]])


def test_plain_numbers_stand_to_their_goals_as_traced_ones() -> None:
    """Infinite margins and unstable loops among them; nothing is warned of."""
    for one in (found(), found(gain_reduction_db=np.inf, M_s=3.0), found(1.1), found(0.0)):
        plain = jax.tree.map(np.asarray, one)
        for here, there in zip(margin_goals(plain, LIMITS), margin_goals(one, LIMITS), strict=True):
            assert not isinstance(here, jax.Array)
            np.testing.assert_allclose(here, there, rtol=1e-14)
    values, before = np.array([[[0.0, 1.0, np.nan]]]), np.array([[[0.0, 0.0, 2.0]]])
    limits = {"clamped_ratio": 0.5, "clamped": 0.1, "clamped_y": 0.1}

    def cells(clamped: np.ndarray) -> Metrics:
        return Metrics(**{name: 0.0 * clamped for name in Metrics._fields} | {"clamped": clamped})

    plain_goals = run_goals(cells(values), cells(before), None, limits)
    traced = run_goals(*jax.tree.map(jnp.asarray, (cells(values), cells(before))), None, limits)
    for name in limits:
        assert isinstance(plain_goals[name], np.ndarray)
        np.testing.assert_array_equal(plain_goals[name], traced[name])
