"""The loop: a cycle per period by absolute deadlines, until nothing leads on and the arm is let go.

    wait ─► ask ─► collect ─► `Cycle` ─► send ─► beat ─► count ─► record

Clock, bus and watchdog are handed in, so the same loop runs in real time and in lock-step with the twin.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from deploy.durations import cycles
from deploy.flight.recorder import FlightRecorder
from deploy.loop.cycle import Cycle, CycleResult, OperatorCommand
from deploy.loop.hazards import CycleTiming
from deploy.loop.statistics import Statistics
from deploy.puck.frame import Frame
from deploy.safety.checker import check_service
from deploy.safety.clamp import Clamp
from deploy.safety.machine import OperatingState, SafetyState, Task, patience
from deploy.safety.reasons import Reason
from deploy.wam.dialogue import Clock
from deploy.wam.reading import Reading

REPLIES = 0.7
"""Share of the period that replies are waited for; asking, computing and sending need the rest."""
LINGER = 1.0
"""How long the arm is still held once nothing leads on, before it is let go [s]."""
LETTING_GO = 0.05
"""How long zero torque and idle are repeated at the end [s]: a frame can be lost."""
INSISTING = 0.85
"""How much longer there is for an order to idle where the bus has taken none [s]: a run ends within a second."""
IDLE_EVERY = 0.01
"""Time between two orders to idle [s]."""
STATES, REASONS = tuple(OperatingState), tuple(Reason)
"""What the recorder's numbers stand for."""


class Watching(Protocol):
    """Watchdog as the loop uses it."""

    @property
    def fired(self) -> bool:
        """Whether it has acted."""
        ...

    def beat(self, now: int, torques_on: bool) -> None:
        """Say that the controller lives."""
        ...

    def answers(self, now: int) -> bool:
        """Whether it lives itself."""
        ...


@dataclass(frozen=True)
class RunResult:
    """State in which a run ended, and its time in contact."""

    safety_state: SafetyState
    contact_cycles: int
    """Cycles spent in contact."""

    @property
    def well(self) -> bool:
        """Whether the run ended as planned, by time or operator."""
        return self.safety_state.state is OperatingState.STOPPED and self.safety_state.reason in (
            Reason.FINISHED,
            Reason.OPERATOR,
        )


class Loop:
    """Runs a control cycle per period until the arm has been let go."""

    def __init__(
        self,
        cycle: Cycle,
        clock: Clock,
        period: int,
        recorder: FlightRecorder,
        watchdog: Watching | None,
        each: Callable[[CycleResult], OperatorCommand],
        log: Callable[..., None] | None = None,
    ) -> None:
        """Assemble the loop.

        Args:
            cycle: Control cycle.
            clock: The bus's own.
            period: [ns]
            recorder: Takes a row of every cycle.
            watchdog: Standing by; None only where time is simulated.
            each: Takes the result of every cycle, returns the operator's next command.
            log: Takes every torque frame that the bus took, and its time.
        """
        self._cycle, self._clock, self._period = cycle, clock, period
        self._recorder, self._watchdog, self._each, self._log = recorder, watchdog, each, log
        self.statistics = Statistics(period)
        self._contact = 0
        self._held, self._idle_every = patience(1e-9 * period).held, cycles(IDLE_EVERY, 1e-9 * period)
        # Whether pucks may be driven, as far as the bus has taken frames; and whether any order to idle was tried.
        self._on = self._ordered = False
        self._undriven = -1  # cycles since the arm was let go, or since another reason for it; −1 while it is not

    def run(self, command: OperatorCommand) -> RunResult:
        """Run until the arm has been let go.

        Args:
            command: First command of the operator.
        """
        try:
            return self._run(command)
        except BaseException:
            # A defect of this program: whatever it is, the arm is let go before anybody reads about it.
            self._let_go(self._clock.now())
            raise

    def _run(self, command: OperatorCommand) -> RunResult:
        clock, arm, statistics = self._clock, self._cycle.arm, self.statistics
        deadline = started = last = clock.now() + self._period
        late, over = False, 0
        linger, letting_go = round(LINGER * 1e9 / self._period), round(LETTING_GO * 1e9 / self._period)
        while True:
            clock.wait_until(deadline)
            woke = clock.now()
            missed = max(0, (woke - last) // self._period - 1) if woke > last else 0
            last = woke
            arm.request()
            reading = arm.collect(woke + int(REPLIES * self._period))
            timing = CycleTiming(missed, late, self._judged(woke, missed))
            result = self._cycle.step(reading, timing, command)
            self._send(result, woke)
            if self._watchdog is not None:
                self._watchdog.beat(woke, self._on)
            if result.safety_state.state is OperatingState.CONTACT:
                self._contact += 1
            if result.clamp.acted:
                self._count(result.clamp)
            command = self._each(result)
            ended = clock.now()
            self._recorder.append(self._row(result, reading, woke - started, woke - deadline, ended - woke))
            deadline, late = statistics.cycle(deadline, woke, ended)
            over = over + 1 if result.safety_state.over else 0
            if over > (letting_go if result.task is Task.OFF else linger):
                self._let_go(deadline)
                return RunResult(result.safety_state, self._contact)

    def _let_go(self, deadline: int) -> None:
        """Send zero torque and idle, several times; where no order to idle was taken, wait and try for the last time.

        Then there are no more beats either, so that the watchdog tries by its own connection.
        """
        arm = self._cycle.arm
        zero = arm.torque_frame((0.0, 0.0, 0.0, 0.0))
        count = round((LETTING_GO + INSISTING) * 1e9 / self._period)
        for i in range(count):
            insisting = i * self._period >= LETTING_GO * 1e9
            if insisting and not self._on:
                return
            self._clock.wait_until(deadline + i * self._period)
            arm.bus.drain()
            if arm.bus.state == "active":
                self._hand_over(zero)
                if i % self._idle_every == 0:
                    self._idle()
            elif i == count - 1 or not self._ordered:
                self._idle()
            if self._watchdog is not None and not insisting:
                self._watchdog.beat(self._clock.now(), self._on)

    def _send(self, result: CycleResult, woke: int) -> None:
        arm, frame = self._cycle.arm, result.frame
        # Stopped between measuring and sending, this cycle must not act on what is old by now.
        stale = self._clock.now() - woke > self._held * self._period
        if stale or (self._watchdog is not None and self._watchdog.fired):
            frame = arm.torque_frame((0.0, 0.0, 0.0, 0.0))
        off, now = result.task is Task.OFF, result.safety_state
        self._on = self._on or not off
        # After an error few frames are still tried: an order to idle at once, another soon, and the last in `_let_go`.
        refused = off and arm.bus.state != "active"
        if not refused:
            self._hand_over(frame)
        # An undriven puck left in torque mode would go on with the last command it heard.
        if not (off and now.over):
            self._undriven = -1
            return
        self._undriven = self._undriven + 1 if now.cycles else 0
        if self._undriven % self._idle_every == 0 and not (refused and self._undriven > self._idle_every):
            self._idle()

    def _idle(self) -> None:
        pucks, module = self._cycle.arm.idle_frames()
        assert check_service(pucks) is None
        assert check_service(module) is None
        self._ordered = True
        # A bus that refuses the one takes few frames more: they are for the pucks.
        if self._cycle.arm.bus.send(pucks):
            self._on = False
            self._cycle.arm.bus.send(module)

    def _hand_over(self, torques: Frame) -> None:
        """Send torques, and log them if the bus took them."""
        if self._cycle.arm.bus.send(torques) and self._log is not None:
            self._log(torques, self._clock.now(), True)

    def _judged(self, woke: int, missed: int) -> Reason:
        """Reason of the clock or the watchdog to stop, once the replies are there."""
        now = self._clock.now()
        if missed > self._held or now - woke > self._held * self._period:
            return Reason.STALLED
        if self._watchdog is not None:
            if self._watchdog.fired:
                return Reason.STALLED
            if not self._watchdog.answers(now):
                return Reason.WATCHDOG
        return Reason.NONE

    def _count(self, clamp: Clamp) -> None:
        for name, acted in zip(clamp._fields, clamp, strict=True):
            if acted:
                self.statistics.tally("clamps", name)

    def _row(self, result: CycleResult, reading: Reading, since: int, lateness: int, compute: int) -> tuple[float, ...]:
        """A row of `deploy.flight.recorder.COLUMNS`."""
        controller, arm = self._cycle.controller, self._cycle.arm
        runtime = controller.runtime
        nan = float("nan")
        return (
            1e-9 * since,
            *(result.force or (nan, nan, nan)),
            *controller.force_ref,
            *runtime.u,
            *runtime.last_v,
            *runtime.last_a,
            *runtime.p_hat,
            runtime.gain,
            *runtime.stiffness,
            *runtime.authority,
            *runtime.dither,
            *result.kinematics.tip,
            *result.q,
            *self._cycle.checker.torque,
            *result.qd,
            *runtime.memory[1:],
            *runtime.deflection,
            runtime.swing_share,
            *result.wanted,
            *result.applied,
            STATES.index(result.safety_state.state),
            REASONS.index(result.safety_state.reason),
            float(sum(1 << i for i, acted in enumerate(result.clamp) if acted)),
            *arm.counts,
            *self._cycle.positions.age,
            reading.force_age,
            1e-9 * lateness,
            1e-9 * compute,
        )
