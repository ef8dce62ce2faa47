"""Hazards that forbid to drive the arm, of bus, pendant, safety module and pucks; lateness explains lost replies."""

from typing import NamedTuple

from deploy.durations import cycles
from deploy.safety import machine
from deploy.safety.reasons import Reason
from deploy.wam.arm import POLL_EVERY, WamArm
from deploy.wam.reading import Reading

FOREIGN, FOREIGN_CYCLES = 4000.0, 2
"""Foreign frames a second, so many cycles in a row, that are a babbling node: half of what a full bus can hold."""
SILENT, QUESTIONS = 0.1, 10
"""Time without a word of the safety module [s], and the fewest questions: it is asked by every second poll."""
UNANSWERED = 5
"""Polls without a word of the safety module: it was asked at least twice."""
UNTOLD, ROUNDS, ROUND = 0.5, 6, 16
"""Time without a word of a puck on its state [s], and the fewest rounds of polls: each has two questions to it."""
NOBODY = "nobody answers, nor does the safety module: the bus is cut, or what answers on it stands still or is late"
LATELY = 1.0
"""Time for which lateness explains replies that do not come [s]."""
CHANGING = 0.2
"""Time after an activation in which pucks may still report their old mode [s]."""


class CycleTiming(NamedTuple):
    """Timing of a cycle, and the watchdog's verdict."""

    missed: int = 0
    """Cycles left out before this one."""
    late: bool = False
    """Overruns are too many."""
    hazard: Reason = Reason.NONE
    """The watchdog has acted or is gone, or the controller stood still."""


class Hazards:
    """Judges cycle by cycle whether the arm may be driven.

    Attributes:
        lately: Whether this computer or a reply was late in the last second: then missing positions are late, not lost.
    """

    def __init__(self, arm: WamArm, T_s: float) -> None:
        """Begin before motion.

        Args:
            arm: Started.
            T_s: Sampling time [s].
        """
        self._arm, self._T_s, self.lately = arm, T_s, False
        self._foreign, self._hosts, self._busy = arm.bus.counters.foreign, arm.bus.counters.hosts, 0
        self._lately = cycles(LATELY, T_s)
        self._late, self._late_at, self._active = arm.late, -self._lately, 0
        polls = cycles(POLL_EVERY, T_s)
        self._babble = cycles(FOREIGN, 1.0 / T_s)
        self._untold = cycles(UNTOLD, T_s, ROUNDS * ROUND * polls)
        self._silent, self._unanswered = cycles(SILENT, T_s, 2 * QUESTIONS * polls), UNANSWERED * polls

    @property
    def active(self) -> bool:
        """Whether the pendant has activated the pucks."""
        return self._active > 0

    def judge(self, reading: Reading, timing: CycleTiming, youngest: int) -> tuple[Reason, str]:
        """Reason that forbids to drive the arm in this cycle, and its detail.

        Args:
            reading: Measurements of this cycle.
            timing: Timing of this cycle.
            youngest: Age of the youngest position [cycles].
        """
        arm = self._arm
        if timing.missed or timing.late or arm.late > self._late:
            self._late, self._late_at = arm.late, arm.cycle
        self.lately = arm.cycle - self._late_at < self._lately
        if timing.hazard is not Reason.NONE:
            return timing.hazard, ""
        reason, detail = self._of_bus()
        if reason is not Reason.NONE:
            return reason, detail
        if reading.safety_mode == 0:
            return Reason.E_STOP, ""
        was_active, self._active = self._active, self._active + 1 if reading.safety_mode == 2 else 0
        if was_active and not self._active:
            return Reason.IDLE, ""
        if youngest >= machine.BRIDGED and not self.lately:
            nobody = reading.safety_age > self._unanswered and reading.force_age >= machine.BRIDGED
            return Reason.POSITION_LOST, NOBODY if nobody else "no puck answers, as after an e-stop"
        if reading.safety_age > self._silent and arm.cycle > self._silent:
            return Reason.PENDANT_FAULT, "the safety module is silent"
        if reading.pendant is not None and (faults := reading.pendant.faults):
            return Reason.PENDANT_FAULT, ", ".join(faults)
        return self._of_pucks(reading)

    def _of_bus(self) -> tuple[Reason, str]:
        bus = self._arm.bus
        if bus.state == "down":
            return Reason.BUS_OFF, bus.remedy
        if bus.state != "active":
            return Reason.BUS_OFF if bus.state == "off" else Reason.BUS_ERROR, ""
        foreign = bus.counters.foreign
        self._busy = self._busy + 1 if foreign - self._foreign >= self._babble else 0
        self._foreign = foreign
        if self._busy >= FOREIGN_CYCLES:
            return Reason.BUS_LOAD, "frames of a stranger fill the bus"
        if bus.counters.hosts > self._hosts:
            self._hosts = bus.counters.hosts
            return Reason.BUS_LOAD, "another host sends on this bus"
        return Reason.NONE, ""

    def _of_pucks(self, reading: Reading) -> tuple[Reason, str]:
        nodes = self._arm.pucks.nodes
        for node, age in zip(nodes, reading.puck_age, strict=True):
            if age > self._untold:
                return Reason.PUCK_FAULT, f"puck {node} does not tell its state"
        for node, status in zip(nodes, reading.puck_status, strict=True):
            if status != 2:
                return Reason.PUCK_FAULT, f"puck {node} reports STAT {status}"
        if self._active * self._T_s > CHANGING:
            for node, mode in zip(nodes, reading.puck_mode, strict=True):
                if mode != 2:
                    return Reason.PUCK_FAULT, f"puck {node} left its torque mode"
        return Reason.NONE, ""
