"""What the demo tells, on terminals of 60, 80 and 120 columns, with numbers made by hand; nothing is computed."""

from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from jaxmpc.cli import demo
from jaxmpc.cli.demo_summary import Arm
from jaxmpc.loop.arm import ArmSample
from jaxmpc.metrics import Metrics
from jaxmpc.quantities import MARGINS
from jaxmpc.stability import Margins
from tests.screen import WIDTHS, assert_whole, numbers, written

STEPS = 20_000


def arm() -> Arm:
    """A run of 20 s, whose residuals have three digits [mN]."""
    trace = dict.fromkeys(ArmSample._fields, np.full((1, 3, STEPS), 810.25)) | {
        "force": np.full((1, 3, STEPS), -4.876),
        "true_force": np.full((1, 3, STEPS), -4.988),
        "force_ref": np.full((1, 3, STEPS, 1), -5.0),
        "clamped": np.zeros((1, 3, STEPS)),
    }
    metrics = Metrics(*(np.full((1, 3), 0.12345) for _ in Metrics._fields))
    outcome: Any = SimpleNamespace(status=[0], metrics=metrics, trace=ArmSample(**trace))
    experiment: Any = SimpleNamespace(sampling_time=1e-3)
    return Arm(experiment, outcome, outcome)


def artifact() -> Any:
    row = dict.fromkeys(MARGINS, 12.34)
    return SimpleNamespace(kind="wam-cascade", margins=[row], family={"rows": [row], "band": 0.06})


def flight() -> Any:
    three = np.array([0.0271, 0.0242, 0.0253])
    ended = SimpleNamespace(well=True, safety_state=SimpleNamespace(state="idle", reason="finished"))
    return SimpleNamespace(
        began=4.321,
        time=np.arange(15_000) * 1e-3,
        rms=lambda _: (three, three),
        clamped=lambda _: 0.00123,
        ended=ended,
        said="flight.npz: 17321 cycles",
        signals={},
    )


class Best:
    """Rows of a sweep: one."""

    def __len__(self) -> int:
        return 1

    def worst(self, _: str) -> list[float]:
        return [0.0361]


@pytest.fixture
def nothing_runs(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("jaxmpc.terminal.process.use_all_cores", lambda *_: None)
    margins = Margins(*(np.full((2, 5), 32.78) for _ in Margins._fields))
    tuned = SimpleNamespace(feasible=True, worst=(0.0474, 0.0254), margins={"as run": margins})
    swept = SimpleNamespace(best=lambda *_: Best())

    def of_the_arm(folder: Path) -> Any:
        (folder / "controller.npz").write_bytes(bytes(98_765))
        return arm(), artifact(), flight(), [SimpleNamespace(signal="torque", samples=17_321, parts=False)]

    for name, found in {"_paper": None, "_sweep": swept, "_tune": tuned}.items():
        monkeypatch.setattr(demo, name, lambda *_, found=found: found)
    monkeypatch.setattr(
        demo, "Apart", lambda _, folder: nullcontext(SimpleNamespace(result=lambda: of_the_arm(folder)))
    )


@pytest.mark.usefixtures("nothing_runs")
def test_no_number_is_cut(monkeypatch: pytest.MonkeyPatch) -> None:
    said = [written(["demo", "-o", "shown"], columns, monkeypatch) for columns in WIDTHS]
    for text, columns in zip(said, WIDTHS, strict=True):
        assert_whole(text, columns)
        assert "── 6/6" in text
        assert "5120 controllers" in " ".join(text.split())
    # Tables turn where they do not fit; each number stands as often, but those of headings.
    figures = [{*numbers(text)} for text in said]
    assert figures[0] == figures[1] == figures[2]
    assert {"47.4", "25.4", "36.1", "12.34", "98765", "810"} <= figures[0]
