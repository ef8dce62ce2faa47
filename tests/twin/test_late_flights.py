"""A family whose force sensor is late ends contact; a sensor in time, or a tissue that damps, does not."""

import numpy as np
import pytest

from benchmarks.lying_sensor import fly
from deploy.controller.artifact import Artifact
from deploy.controller.file import load
from deploy.safety.reasons import Reason
from jaxmpc import Experiment, Params
from jaxmpc.export.freezing import freeze_controller
from jaxmpc.export.golden import ArmRun
from tests.deploy import made

pytestmark = [pytest.mark.oracle, pytest.mark.usefixtures("held_briefly")]


@pytest.fixture(scope="module")
def family(tmp_path_factory: pytest.TempPathFactory) -> Artifact:
    """With its own margins, by which it may fly; nobody asks here what its golden trace is of."""
    file = tmp_path_factory.mktemp("family") / "controller.npz"
    params, experiment = Params.published("family"), Experiment.published("family-wam")
    q, force, wanted = map(np.array, made.recorded_inputs(100))
    run = ArmRun(q, force, wanted[..., 0])
    freeze_controller(file, params, experiment, {"M_s": 2.0}, ideal=False, run=run)
    return load(file)


@pytest.mark.parametrize("wanted", [-2.0, -5.0])
def test_a_force_that_comes_5_ms_late_is_stopped(family: Artifact, wanted: float) -> None:
    found = fly(family, ("force:delayed=5@0.15",), 810.0, "elastic", wanted)
    assert found.reason is Reason.FORCE_MODEL


@pytest.mark.parametrize(("fault", "tissue"), [("force:delayed=1@0.15", "elastic"), (None, "hunt-crossley")])
def test_a_millisecond_and_damping_are_not(family: Artifact, fault: str | None, tissue: str) -> None:
    found = fly(family, (fault,) if fault else (), 810.0, tissue, -5.0)
    assert found.reason is Reason.FINISHED


def test_the_sine_counts_as_wanted(family: Artifact) -> None:
    """To its whole amplitude, which is met within a 20th of its period of 59 samples."""
    listening = Params.published("family").listening
    assert listening is not None
    assert fly(family, (), 810.0, "elastic", -2.0).wanted_peak == pytest.approx(2.0 + listening.amplitude, abs=2e-3)
