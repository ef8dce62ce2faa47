"""The whole story in one go: it ends with an artifact for the arm that flew, and tells what lies in its files."""

import hashlib
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from deploy.controller.artifact import Artifact
from deploy.controller.file import load
from deploy.flight.recorder import FlightRecording, read
from deploy.loop.loop import REASONS, STATES
from deploy.safety.machine import OperatingState
from deploy.safety.reasons import Reason
from jaxmpc.cli.demo import SECONDS
from jaxmpc.cli.demo_summary import SETTLE
from sweeps.result import Result

PICTURES = ("tuning-history.png", "flight.png")
pytestmark = pytest.mark.slow


class Demo(NamedTuple):
    folder: Path
    told: str


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Demo:
    folder = tmp_path_factory.mktemp("demo")
    command = [sys.executable, "-m", "jaxmpc", "demo", "-o", str(folder)]
    # Rich breaks its tables at the width of the terminal.
    ran = subprocess.run(command, env=os.environ | {"COLUMNS": "160"}, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    return Demo(folder, ran.stdout)


@pytest.fixture
def artifact(demo: Demo) -> Artifact:
    return load(demo.folder / "controller.npz")


@pytest.fixture
def recording(demo: Demo) -> FlightRecording:
    return read(demo.folder / "flight.npz")


def numbers(told: str, pattern: str) -> list[float]:
    """The numbers in the one place of a text that a pattern finds."""
    (found,) = re.findall(pattern, told)
    return [float(number) for number in re.findall(r"[\d.]+", found)]


def test_what_flew_is_the_artifact_for_the_arm(demo: Demo, artifact: Artifact, recording: FlightRecording) -> None:
    file = demo.folder / "controller.npz"
    assert artifact.kind == "wam"
    assert artifact.gains.schedule is not None
    assert recording.header["artifact"] == hashlib.sha256(file.read_bytes()).hexdigest()
    last = recording.signals["state"][-1, 0], recording.signals["reason"][-1, 0]
    assert (STATES[int(last[0])], REASONS[int(last[1])]) == (OperatingState.STOPPED, Reason.FINISHED)
    assert "ended: stopped, finished" in demo.told
    assert re.search(r"replay of \d+ samples in the runtime: the same\n", demo.told)


def test_the_residual_that_it_tells_is_that_of_the_recording(demo: Demo, recording: FlightRecording) -> None:
    signals = recording.signals
    rows = np.flatnonzero(signals["state"][:, 0] == STATES.index(OperatingState.CONTACT))
    assert len(rows) >= round(SECONDS * 1e3)
    rows = rows[round(SETTLE * 1e3) :]
    error = signals["force"][rows] - signals["force_ref"][rows]
    measured = 1e3 * np.sqrt(np.nanmean(error**2, axis=0))
    told = numbers(demo.told, r"family, flown in lock-step([\s\d/]+)")
    np.testing.assert_allclose(told[:3], measured, atol=0.5 + 1e-9)  # told in whole mN
    assert max(told) < 40.0


def test_the_flight_leaves_what_the_simulation_leaves(demo: Demo) -> None:
    """Within 5 %, on the stretch of the heart's motion that both met; both are told in whole mN."""
    flown, simulated = (
        numbers(demo.told, rf"family, {how}([\s\d/]+)")[:3] for how in ("flown in lock-step", "simulated")
    )
    np.testing.assert_allclose(flown, simulated, rtol=0.05, atol=1.0)


def test_the_margins_that_it_tells_are_those_of_the_artifact(demo: Demo, artifact: Artifact) -> None:
    assert artifact.family is not None
    fixed, known = (max(row["M_s"] for row in table) for table in (artifact.margins, artifact.family["rows"]))
    assert numbers(demo.told, r"1900 N/m: worst M_s ([\d.]+)") == [pytest.approx(fixed, abs=0.005)]
    assert numbers(demo.told, r"known to ±[\d.]+ %: worst M_s ([\d.]+)") == [pytest.approx(known, abs=0.005)]
    assert max(fixed, known) <= 2.0


def test_the_sweep_and_the_tuned_controller_lie_there(demo: Demo) -> None:
    result = Result.load(demo.folder / "sweep")
    assert result.complete
    (found,) = re.findall(r"result sha256 (\w{16})…", demo.told)
    assert result.hash.startswith(found)
    tuned = numbers(demo.told, r"worst residual ([\d.]+ → [\d.]+) mN")
    report = (demo.folder / "tune" / "report.txt").read_text(encoding="utf-8")
    assert tuned == numbers(report, r"worst held-out RMS \[mN\]: ([\d.]+ → [\d.]+)")
    assert tuned[1] < tuned[0]


@pytest.mark.parametrize("name", PICTURES)
def test_its_pictures_are_drawn(demo: Demo, name: str) -> None:
    assert (demo.folder / name).read_bytes().startswith(b"\x89PNG")


def test_its_sweep_can_be_explored(demo: Demo) -> None:
    page = (demo.folder / "sweep.html").read_text(encoding="utf-8")
    assert 'id="explorer"' in page
    assert "5120 rows on 3 stiffnesses" in page
