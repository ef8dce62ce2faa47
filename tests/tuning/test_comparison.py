"""Controllers side by side in the same scenarios, of one structure or of several."""

from typing import Any

import numpy as np
import pytest

from jaxmpc import Experiment, Params
from jaxmpc.metrics import Metrics
from tuning.objective import comparison


def test_controllers_of_several_structures_keep_their_order(monkeypatch: pytest.MonkeyPatch) -> None:
    batches = []

    def told(batch: Params, *_: Any) -> Metrics:
        batches.append(len(batch.Khat_s))
        return Metrics(*[np.asarray(batch.Khat_s)] * len(Metrics._fields))

    monkeypatch.setattr(comparison, "_compare", told)
    stiffness = [100.0, 200.0, 300.0, 400.0]
    controllers = [Params(Khat_s=K, guarded=K in (200.0, 400.0)) for K in stiffness]
    found = comparison.compare(controllers, [Experiment.published("table-1")])
    assert (found.rms.tolist(), batches) == (stiffness, [2, 2])
