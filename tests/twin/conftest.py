"""Controllers frozen for the arm by `jaxmpc freeze` itself, and what makes many flights of one cheap."""

from copy import copy
from functools import cache

import pytest

from deploy.controller.file import load
from deploy.controller.runtimes import arm_runtime
from deploy.loop import loop, session
from deploy.safety.force_estimate import ForceEstimate
from jaxmpc.cli import main
from tests.deploy.made import arm_artifact
from tests.twin.flying import HELD


def frozen(folder, params, *flags):
    path = folder / f"{params}.npz"
    assert main(["freeze", params, "--experiment", "table-1-wam", "-o", str(path), *flags]) == 0
    return load(path)


@pytest.fixture(scope="session")
def cautious(tmp_path_factory):
    """M_s below 2 from 375 to 1900 N/m, so that a beating heart may be met at any moment."""
    return frozen(tmp_path_factory.mktemp("frozen"), "cautious")


@pytest.fixture(scope="session")
def text(tmp_path_factory):
    """The paper's, whose M_s of 4.5 no default floor accepts."""
    return frozen(tmp_path_factory.mktemp("frozen"), "text", "--max-ms", "5")


@pytest.fixture(scope="session")
def plain():
    """The paper's gains as plain numbers, which need no freezing."""
    return arm_artifact()


@pytest.fixture
def held_briefly(monkeypatch):
    """A run that is over holds the arm for a tenth of a second; `test_every_run_ends` sees the whole one."""
    monkeypatch.setattr(loop, "LINGER", HELD)


_runtime, _estimate = cache(arm_runtime), cache(ForceEstimate)


@pytest.fixture
def recorded_once(monkeypatch):
    """What every session would record again of the one controller: it takes longer than many flights."""

    def at_rest(artifact):
        runtime = copy(_runtime(artifact))
        runtime.start(artifact.arm.posture)
        return runtime

    monkeypatch.setattr(session, "arm_runtime", at_rest)
    monkeypatch.setattr(session, "ForceEstimate", lambda *model: copy(_estimate(*model)))
