"""The few rates of the heart at which the tuner judges a family tell no more margin than freezing, which looks for the
worst."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from jaxmpc import Experiment, Params
from jaxmpc.quantities import MARGINS
from jaxmpc.stability import Margins
from jaxmpc.stability.family import family_margins
from jaxmpc.stability.held_beat import telling_rates
from tuning.objective.evaluated import HEADROOM

FAMILY = Params.published("family")
PATH = Experiment.published("family-wam").loop_path()


def learning(**settings: Any) -> Params:
    """The published family that learns in another way."""
    assert FAMILY.listening is not None
    return replace(FAMILY, listening=replace(FAMILY.listening, **settings))


def livelier() -> Params:
    """The published family with less weight on moves and a quicker loop."""
    return replace(FAMILY, knots=tuple(replace(k, lam=0.5 * k.lam, T_cl=0.85 * k.T_cl) for k in FAMILY.knots))


@pytest.mark.parametrize(
    "family",
    [
        pytest.param(FAMILY, id="published", marks=pytest.mark.oracle),
        pytest.param(livelier(), id="livelier", marks=pytest.mark.oracle),
        pytest.param(learning(beats=1.0), id="learns in a beat", marks=pytest.mark.oracle),
        pytest.param(learning(harmonics=5), id="5 harmonics", marks=pytest.mark.oracle),
        pytest.param(learning(harmonics=12), id="12 harmonics", marks=pytest.mark.oracle),
    ],
)
def test_what_the_tuner_holds_freezing_accepts(family: Params) -> None:
    """Three rates spread evenly, slowest and fastest among them, told 0.24 dB more."""
    where = np.array([375.0, 1900.0]), np.array([0.94, 1.06]), PATH
    few, many = (family_margins(family, *where, rates) for rates in (telling_rates, None))
    for name, margin in MARGINS.items():
        # What the search takes for held keeps half of the headroom at least.
        room = 1.0 + 0.5 * HEADROOM if margin.ceiling else 1.0 - 0.5 * HEADROOM
        assert margin.kept(worst(many, name), room * worst(few, name)), name


def worst(found: Margins, name: str) -> float:
    """Over all cells."""
    return float(MARGINS[name].worst(np.asarray(getattr(found, name))))
