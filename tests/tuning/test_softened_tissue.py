"""A tissue that has turned a quarter as stiff, on the arm: with gains for the old one the force swings without end."""

import numpy as np
import pytest
from msgspec.structs import replace

from jaxmpc import Experiment, Params, Status, evaluate
from jaxmpc.experiment.tables import Change
from tuning.trials import Job

FAMILY = Params.published("family")
SWINGS = 63
"""A trial whose arm does so: heavy friction, masses believed 5 % too large."""


@pytest.mark.oracle
def test_a_force_that_never_calms_has_the_tissue_heard_anew() -> None:
    trial = Job((FAMILY,), Experiment.published("table-1-wam")).trial(SWINGS)
    tissue = replace(trial.tissue, changes=(Change(9.0, 0.25, 0.2),))
    outcome = evaluate(FAMILY, replace(trial, stiffness=(1850.0,), tissue=tissue, duration=20.0, settle=17.0))
    assert np.all(outcome.status == Status.OK)
    # 15 to 18 mN with the gains for what the tissue has become, 148 with those for what it was.
    assert np.max(outcome.metrics.rms) < 0.03
