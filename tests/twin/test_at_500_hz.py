"""A controller of half the rate flies, and its arm is let go as soon as that of any other."""

from importlib.resources import files

import numpy as np
import pytest

from deploy.controller.file import load
from deploy.safety.reasons import Reason
from jaxmpc.cli import main
from tests.twin.flying import fly

T_S = 2e-3


@pytest.fixture(scope="module")
def slower(tmp_path_factory):
    folder = tmp_path_factory.mktemp("slower")
    table = (files("jaxmpc.experiment") / "published/table-1-wam.toml").read_text(encoding="utf-8")
    (folder / "slower.toml").write_text(table.replace("sampling_time = 0.001", f"sampling_time = {T_S}"))
    arguments = ["freeze", "cautious", "--experiment", str(folder / "slower.toml"), "-o", str(folder / "slower.npz")]
    assert main([*arguments, "--max-ms", "3"]) == 0
    return load(folder / "slower.npz")


@pytest.mark.oracle
def test_it_holds_its_force(slower):
    flight = fly(slower, reference="0,0,-5@2", seconds=3.0)
    assert flight.reason is Reason.FINISHED
    assert np.median(np.diff(flight.time)) == pytest.approx(T_S)


@pytest.mark.oracle
@pytest.mark.parametrize("rate", [500, 1000])
def test_a_puck_that_is_silent_is_let_go_after_twenty_milliseconds(slower, plain, rate):
    """Torque stops with the first answer that is more than 20 ms old, which comes a cycle later."""
    off, T_s = 1.5, 1.0 / rate
    flight = fly(slower if rate == 500 else plain, f"J2:off@{off}", seconds=3.0)
    assert flight.reason is Reason.POSITION_LOST
    driven = max(time for time, units in flight.frames if any(units))
    assert 0.018 <= driven - off <= 0.02 + 2.0 * T_s
