"""Controllers frozen for the arm by `jaxmpc freeze` itself."""

import pytest

from deploy.controller.file import load
from jaxmpc.cli import main
from tests.deploy.made import arm_artifact


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
