"""Controllers side by side in the same scenarios, of one structure or of several."""

import msgspec
import numpy as np

from jaxmpc import Experiment, Params
from tuning.proof.heldout import compare


def test_controllers_of_several_structures_keep_their_order() -> None:
    experiment = msgspec.structs.replace(Experiment.published("table-1"), duration=3.2, settle=0.5)
    controllers = [Params(), Params(disturbance_order=2, Q_p=1e-4), Params(Khat_s=700.0)]
    found = compare(controllers, [experiment])
    for params, rms in zip(controllers, found.rms, strict=True):
        # Batches of another size add up in another order.
        np.testing.assert_allclose(rms, compare([params], [experiment]).rms[0], rtol=1e-9)
