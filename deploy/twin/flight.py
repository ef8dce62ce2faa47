"""One flight in lock-step against the twin, with what the twin alone knows beside the recording.

start ─► armed ─► pendant pressed ─► approach ─► contact, for so long ─► retract
"""

import hashlib
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from deploy.bus.bus import Bus
from deploy.controller.artifact import Artifact
from deploy.controller.file import load
from deploy.loop.cycle import CycleResult, OperatorCommand
from deploy.loop.loop import RunResult
from deploy.loop.options import Options
from deploy.loop.session import Session
from deploy.reference.segments import from_words
from deploy.safety.machine import OperatingState
from deploy.safety.reasons import Reason
from deploy.twin.lockstep import LockstepBus, LockstepClock
from deploy.twin.settings import TwinSettings
from deploy.twin.twin import Twin
from deploy.twin.world import Truth

ACTIVATED = 100
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
    began: float
    """Time of the twin, and of its heart, when contact began [s]; NaN if it never did."""
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


class Pilot:
    """Whoever holds the pendant of a twin: presses it once the arm is armed, and ends contact after a time [s]."""

    def __init__(self, session: Session, twin: Twin, seconds: float) -> None:
        """Wait for the arm."""
        self._session, self._twin, self._seconds = session, twin, seconds

    def __call__(self, result: CycleResult) -> OperatorCommand:
        """What is pressed after a cycle."""
        now = result.safety_state
        if now.state is OperatingState.ARMED and now.cycles == ACTIVATED:
            self._twin.press("activate")
        over = self._session.controller.contact_time >= self._seconds
        return OperatorCommand(True, True, Reason.FINISHED if over else Reason.NONE)


def started(
    artifact: Artifact, clock: LockstepClock, reference: str, rate: float, **options: Any
) -> tuple[Session, Bus]:
    """Start a controller against a twin, whose bus is to be closed afterwards.

    Args:
        artifact: The controller.
        clock: Of the twin.
        reference: Wanted force in words, such as "0,0,-5@2 hold@5".
        rate: Largest rate of it [N/s].
        **options: Further fields of `Options`.

    Raises:
        InputError: It drives no arm, or the reference is wrong.
    """
    bus = Bus(LockstepBus(clock), clock.now)
    source = from_words(reference, rate=rate, largest=10.0)
    chosen = Options(source, rate, turns=False, hook=clock.twin.force_hook, **options)
    return Session(artifact, bus, clock, chosen, lambda sentence: None), bus


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
    artifact = load(controller)
    clock = LockstepClock(Twin(settings))
    session, bus = started(artifact, clock, reference, RATE, seconds=seconds + APPROACHING)
    pilot = Pilot(session, clock.twin, seconds)
    contact: list[bool] = []
    truth: list[Truth] = []

    def each(result: CycleResult) -> OperatorCommand:
        contact.append(result.safety_state.state is OperatingState.CONTACT)
        if contact[-1]:
            truth.append(clock.twin.truth())
        return pilot(result)

    ended = session.run(OperatorCommand(True, True), None, each)
    bus.close()
    said = session.write(recording, hashlib.sha256(controller.read_bytes()).hexdigest(), ended.safety_state)
    signals = {name: rows[contact] for name, rows in session.recorder.signals().items()}
    began = truth[0].time if truth else math.nan
    time = artifact.T_s * np.arange(len(truth))
    forces = np.array([now.force for now in truth]).reshape(-1, 3)
    return TwinFlight(ended, said, began, time, signals, forces)
