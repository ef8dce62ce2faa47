"""One flight in lock-step against the twin, with what the twin alone knows beside the recording.

start ─► armed ─► pendant pressed ─► approach ─► contact, for so long ─► retract
"""

import hashlib
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from deploy.bus.bus import Bus
from deploy.controller.artifact import Artifact
from deploy.controller.file import load
from deploy.loop.cycle import CycleResult, OperatorCommand
from deploy.loop.loop import RunResult
from deploy.loop.session import Options, Session
from deploy.reference.segments import from_words
from deploy.safety.machine import OperatingState
from deploy.safety.reasons import Reason
from deploy.twin.lockstep import LockstepBus, LockstepClock
from deploy.twin.settings import TwinSettings
from deploy.twin.twin import Twin

ACTIVATED = 200
"""Cycles in ARMED after which the pendant is pressed."""
RATE = 5.0
"""Largest rate of the wanted force [N/s]."""
APPROACHING = 20.0
"""Longest time that is recorded besides that in contact [s]."""


@dataclass(frozen=True)
class TwinFlight:
    """What came of it; rows are cycles in contact."""

    ended: RunResult
    said: str
    """Sentence on the recording."""
    time: np.ndarray
    """Since contact (n,) [s]."""
    signals: dict[str, np.ndarray]
    """Recorded signals (n, width)."""
    true_force: np.ndarray
    """Force on the tissue that the twin knows (n, 3) [N]."""

    def rms(self, settle: float) -> tuple[np.ndarray, np.ndarray]:
        """Residual RMS per axis after a time in contact [s]: measured and true [N]."""
        rows = self.time >= settle
        wanted = self.signals["force_ref"]
        errors = (force[rows] - wanted[rows] for force in (self.signals["force"], self.true_force))
        measured, true = (np.sqrt(np.nanmean(error**2, axis=0)) for error in errors)
        return measured, true

    def clamped(self, settle: float) -> float:
        """Share of the cycles after a time in contact [s] in which a clamp acted [-]."""
        return float(np.mean(self.signals["clamped"][self.time >= settle] > 0.0))


@dataclass
class _Watcher:
    """Presses the pendant, ends the flight, keeps the truth."""

    twin: Twin
    seconds: float
    session: Session
    rows: list[int] = field(default_factory=list)
    truth: list[tuple[float, ...]] = field(default_factory=list)
    cycle: int = 0

    def __call__(self, result: CycleResult) -> OperatorCommand:
        now = result.safety_state
        if now.state is OperatingState.ARMED and now.cycles == ACTIVATED:
            self.twin.press("activate")
        if now.state is OperatingState.CONTACT:
            self.rows.append(self.cycle)
            self.truth.append(self.twin.truth().force)
        self.cycle += 1
        over = self.session.controller.contact_time >= self.seconds
        return OperatorCommand(True, True, Reason.FINISHED if over else Reason.NONE)


def fly(controller: Path, settings: TwinSettings, reference: str, seconds: float, recording: Path) -> TwinFlight:
    """Fly a frozen controller.

    Args:
        controller: Its file.
        settings: What it meets.
        reference: Wanted force in words, such as "0,0,-5@2 hold@5".
        seconds: Time in contact [s].
        recording: Where the flight recording goes.

    Raises:
        ArtifactError: The file is no controller.
        InputError: It drives no arm, or the reference is wrong.
    """
    artifact: Artifact = load(controller)
    clock = LockstepClock(Twin(settings))
    bus = Bus(LockstepBus(clock), clock.now)
    source = from_words(reference, rate=RATE, largest=10.0)
    options = Options(source, RATE, turns=False, hook=clock.twin.force_hook, seconds=seconds + APPROACHING)
    session = Session(artifact, bus, clock, options, lambda sentence: None)
    watcher = _Watcher(clock.twin, seconds, session)
    ended = session.run(OperatorCommand(True, True), None, watcher)
    bus.close()
    said = session.write(recording, hashlib.sha256(controller.read_bytes()).hexdigest(), ended.safety_state)
    signals = {name: rows[watcher.rows] for name, rows in session.recorder.signals().items()}
    time = artifact.T_s * np.arange(len(watcher.rows))
    return TwinFlight(ended, said, time, signals, np.array(watcher.truth).reshape(-1, 3))
