"""Risk: each kind against its definition in numpy, and its slope."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tuning.job.risk import ORDER, Risk, soft_worst
from tuning.objective.evaluated import _geometric_mean

VALUES = np.random.default_rng(0).uniform(0.5, 2.0, (3, 10))


def test_kinds_are_what_their_names_say() -> None:
    def over(kind: Any, share: float = 0.25) -> np.ndarray:
        risk = Risk(kind, share) if kind == "cvar" else Risk(kind)
        return np.asarray(risk.over(jnp.asarray(VALUES)))

    np.testing.assert_allclose(over("mean"), VALUES.mean(axis=1))
    np.testing.assert_allclose(over("worst"), VALUES.max(axis=1))
    np.testing.assert_allclose(over("soft-worst"), np.mean(VALUES**ORDER, axis=1) ** (1 / ORDER))
    np.testing.assert_allclose(over("cvar", 1.0), VALUES.mean(axis=1))
    np.testing.assert_allclose(over("cvar", 0.1), VALUES.max(axis=1))


@pytest.mark.parametrize("kind", ["mean", "worst", "soft-worst", "cvar"])
def test_plain_values_have_the_risk_of_traced_ones(kind: Any) -> None:
    values = VALUES.copy()
    values[1], values[2, 3] = 0.0, np.nan
    risk = Risk(kind=kind)
    np.testing.assert_allclose(risk.over(values), risk.over(jnp.asarray(values)), rtol=1e-14)


@pytest.mark.parametrize("share", [0.1, 0.25, 0.37, 0.9])
def test_cvar_is_the_minimum_of_rockafellar_and_uryasev(share: float) -> None:
    """CVaR = min over t of t + mean(max(x − t, 0))/share, whose minimum lies at one of the values."""
    found = Risk(kind="cvar", share=share).over(jnp.asarray(VALUES))
    t = VALUES[:, :, None]
    expected = np.min(t[..., 0] + np.maximum(VALUES[:, None, :] - t, 0.0).mean(axis=2) / share, axis=1)
    np.testing.assert_allclose(found, expected)


@pytest.mark.parametrize("kind", ["mean", "worst", "soft-worst", "cvar"])
def test_slope(kind: Any) -> None:
    risk = Risk(kind=kind)
    x = jnp.asarray(VALUES[0])
    found = jax.grad(lambda v: risk.over(v))(x)
    steps = 1e-6 * np.eye(len(x))
    expected = [(risk.over(x + d) - risk.over(x - d)) / 2e-6 for d in steps]
    np.testing.assert_allclose(found, expected, atol=1e-8)


@pytest.mark.parametrize("kind", ["mean", "worst", "soft-worst", "cvar"])
def test_a_run_that_was_lost_has_no_risk(kind: Any) -> None:
    lost = jnp.asarray(VALUES).at[1, 3].set(jnp.nan)
    assert np.isnan(Risk(kind=kind).over(lost)).tolist() == [False, True, False]
    assert np.isnan(_geometric_mean(lost)).tolist() == [False, True, False]
    beside_nothing = _geometric_mean(lost.at[:2, 0].set(0.0))
    assert float(beside_nothing[0]) == 0.0
    assert np.isnan(beside_nothing[1]), "0 is the best there is"


def test_nothing_at_all_has_a_slope_of_zero() -> None:
    assert float(soft_worst(jnp.zeros(4))) == 0.0
    assert np.isfinite(jax.grad(soft_worst)(jnp.zeros(4))).all()
