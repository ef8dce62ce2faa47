"""Controllers side by side in the same scenarios, of one structure or of several."""

from typing import Any

import numpy as np
import pytest

from jaxmpc import Experiment, Params
from jaxmpc.metrics import Metrics
from tuning import TuneSpec
from tuning.objective import comparison


def test_controllers_of_several_structures_keep_their_order(monkeypatch: pytest.MonkeyPatch) -> None:
    batches = []

    def told(alike: list[Params], *_: Any) -> Metrics:
        batches.append(len(alike))
        return Metrics(*[np.array([each.Khat_s for each in alike])] * len(Metrics._fields))

    monkeypatch.setattr(comparison, "_compare", told)
    stiffness = [100.0, 200.0, 300.0, 400.0]
    controllers = [Params(Khat_s=K, guarded=K in (200.0, 400.0)) for K in stiffness]
    found = comparison.compare(controllers, [Experiment.published("table-1")])
    assert (found.rms.tolist(), batches) == (stiffness, [2, 2])


def test_the_choice_on_validation_scenarios_is_by_the_risk_of_the_job() -> None:
    """By the mean four scenarios of which one is bad stand better than four that are all mediocre; by the worst not."""

    def measured(rms: list[float]) -> Metrics:
        cells = np.broadcast_to(np.asarray(rms)[:, None, None], (len(rms), 3, 3))
        return Metrics(*[cells] * len(Metrics._fields))

    before, uneven, even = (measured(rms) for rms in ([0.1] * 4, [0.01, 0.01, 0.01, 0.1], [0.09] * 4))
    for kind, better in (("mean", uneven), ("worst", even)):
        spec = TuneSpec.from_dict({"risk": {"kind": kind}, "goals": {"soft": {"rms_ratio": 0.5}}})
        standing = [comparison.standing_of(spec, one, before) for one in (uneven, even)]
        assert standing[int(better is even)] == min(standing)
    assert standing == pytest.approx([2.0, 1.8])
    assert comparison.standing_of(spec, measured([0.01, np.nan, 0.01, 0.01]), before) == np.inf
    # A family serves each tissue by itself: the geometric mean over them.
    family = TuneSpec.from_dict(
        {
            "experiment": {"published": "family-wam"},
            "params": {"published": "family"},
            "risk": {"kind": "worst"},
            "tune": {"free": {"knots.Q_p": True}},
            "goals": {"soft": {"rms_ratio": 0.5}},
        }
    )
    one = np.array([0.01, 0.04, 0.02])[None, :, None] * np.ones((4, 3, 3))
    assert comparison.standing_of(family, Metrics(*[one] * len(Metrics._fields)), before) == pytest.approx(0.4)
