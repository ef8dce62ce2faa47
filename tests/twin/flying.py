"""A frozen controller flown in lock-step against the twin, with everything that the twin knows kept."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from deploy.controller.limits import Limits
from deploy.loop.cycle import CycleResult, OperatorCommand
from deploy.loop.loop import STATES, RunResult
from deploy.loop.session import Session
from deploy.puck.codec import unpack_torques
from deploy.safety.machine import OperatingState, SafetyState
from deploy.safety.reasons import Reason
from deploy.twin.flight import Pilot, started
from deploy.twin.lockstep import LockstepClock
from deploy.twin.scenario import twin_settings
from deploy.twin.twin import Twin

HELD = 0.1
"""Time for which a run that is over holds the arm where nobody asks [s], longer than positions may be old."""


@dataclass(frozen=True)
class Flight:
    """What came of it; rows are cycles."""

    ended: RunResult
    session: Session
    twin: Twin
    safety_states: list[SafetyState]
    time: np.ndarray
    """Of the twin at each cycle [s]."""
    force: np.ndarray
    """True force on the tissue at every millisecond of the twin (n, 3) [N]."""
    force_time: np.ndarray
    """[s]"""
    frames: list[tuple[float, tuple[int, ...]]]
    """Time [s] and units of every torque frame."""
    contact: float
    """When contact was made [s]; NaN if never."""
    clamped: int
    """Cycles in contact in which a clamp acted."""
    fastest: np.ndarray
    """Largest true speed of each joint, let go or not (4,) [rad/s]."""

    @property
    def reason(self) -> Reason:
        return self.ended.safety_state.reason

    def signals(self) -> dict[str, np.ndarray]:
        return self.session.recorder.signals()

    def residual(self, settle: float = 5.0) -> np.ndarray:
        """RMS per axis of the measured force after a time in contact [N]."""
        signals = self.signals()
        contact = np.flatnonzero(signals["state"][:, 0] == STATES.index(OperatingState.CONTACT))
        rows = contact[round(settle * 1e3) :]
        error = signals["force"][rows] - signals["force_ref"][rows]
        rms: np.ndarray = np.sqrt(np.nanmean(error**2, axis=0))
        return rms

    def peak(self, start: float = 0.0) -> float:
        """Largest true force on the tissue from a time in contact on [N]."""
        later = self.force_time >= self.contact + start
        return float(np.linalg.norm(self.force[later], axis=1).max(initial=0.0))

    def push(self) -> float:
        """Largest true push on the tissue since contact [N]; an attached tip that leaves also pulls."""
        return float(-self.force[self.force_time >= self.contact, 2].min(initial=0.0))

    def detected(self, since: float) -> int:
        """Cycles from a time until the state left contact; −1 if it never did."""
        for time, now in zip(self.time, self.safety_states, strict=True):
            if time >= since - 1e-9 and now.state not in (
                OperatingState.CONTACT,
                OperatingState.APPROACH,
                OperatingState.ARMED,
            ):
                return round((time - since) * 1e3)
        return -1


def fly(
    artifact: Any,
    *faults: str,
    stiffness: float = 810.0,
    seconds: float = 3.0,
    reference: str = "0,0,-5@2",
    limits: Limits | None = None,
    tare: bool = False,
    record: float = 50.0,
    **settings: Any,
) -> Flight:
    """Start, approach, hold the force for some seconds [s], retract.

    Faults are timed from the twin's beginning; contact comes at about 0.8 s.
    """
    twin = Twin(twin_settings(stiffness=stiffness, gap=settings.pop("gap", 0.005), faults=faults, **settings))
    truth: list[tuple[float, ...]] = []
    fastest = np.zeros(4)

    def watch(now: Twin) -> None:
        seen = now.truth()
        truth.append((seen.time, *seen.force))
        np.maximum(fastest, np.abs(seen.qd), out=fastest)

    clock = LockstepClock(twin, watch)
    frames: list[tuple[float, tuple[int, ...]]] = []

    def log(frame: Any, stamp: int, sent: bool) -> None:
        frames.append((1e-9 * stamp, unpack_torques(frame.data)))

    if limits is not None:
        artifact = replace(artifact, arm=replace(artifact.arm, limits=limits))
    session, bus = started(artifact, clock, reference, 20.0, tare=tare, log=log, seconds=record)
    pilot = Pilot(session, twin, seconds)
    safety_states: list[SafetyState] = []
    times: list[float] = []
    clamped = [0]

    def each(result: CycleResult) -> OperatorCommand:
        times.append(1e-9 * clock.now())
        safety_states.append(result.safety_state)
        clamped[0] += result.safety_state.state is OperatingState.CONTACT and result.clamp.acted
        return pilot(result)

    ended = session.run(OperatorCommand(True, True), None, each)
    bus.close()
    entered = [time for time, now in zip(times, safety_states, strict=True) if now.state is OperatingState.CONTACT]
    rows = np.array(truth)
    return Flight(
        ended,
        session,
        twin,
        safety_states,
        np.array(times),
        rows[:, 1:],
        rows[:, 0],
        frames,
        entered[0] if entered else float("nan"),
        clamped[0],
        fastest,
    )
