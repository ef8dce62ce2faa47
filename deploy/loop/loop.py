"""The loop: a cycle per period by absolute deadlines, until nothing leads on and the arm is let go.

    wait ─► ask ─► collect ─► `Cycle` ─► send ─► beat ─► count ─► record

Clock, bus and watchdog are handed in, so the same loop runs in real time and in lock-step with the twin.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from deploy.flight.recorder import FlightRecorder
from deploy.loop.cycle import Cycle, CycleResult, CycleTiming, OperatorCommand
from deploy.loop.statistics import Statistics
from deploy.safety.checker import check_service
from deploy.safety.clamp import Clamp
from deploy.safety.machine import HELD, OperatingState, SafetyState, Task
from deploy.safety.reasons import Reason
from deploy.wam.arm import Reading
from deploy.wam.dialogue import Clock

REPLIES = 0.7
"""Share of the period that replies are waited for; asking, computing and sending need the rest."""
LINGER = 1.0
"""How long the arm is still held once nothing leads on, before it is let go [s]."""
LETTING_GO = 0.05
"""How long zero torque and idle are repeated at the end [s]: a frame can be lost."""
IDLE_EVERY = 10
"""Cycles between two orders to idle."""
STATES, REASONS = tuple(OperatingState), tuple(Reason)
"""What the recorder's numbers stand for."""


class Watching(Protocol):
    """A watchdog."""

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
    """How a run ended."""

    situation: SafetyState
    contact_cycles: int
    """Spent in contact."""

    @property
    def well(self) -> bool:
        """Whether it ended because it was to end."""
        return self.situation.state is OperatingState.STOPPED and self.situation.reason in (
            Reason.FINISHED,
            Reason.OPERATOR,
        )


class Loop:
    """Runs cycles."""

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
        """Put it together.

        Args:
            cycle: What is done in each.
            clock: The bus's own.
            period: [ns]
            recorder: Takes a row of every cycle.
            watchdog: Standing by; None only where time is simulated.
            each: Shown what every cycle came to; says what the operator wants next.
            log: Takes every torque frame sent and its time.
        """
        self._cycle, self._clock, self._period = cycle, clock, period
        self._recorder, self._watchdog, self._each, self._log = recorder, watchdog, each, log
        self.statistics = Statistics(period)
        self._contact = 0

    def run(self, wishes: OperatorCommand) -> RunResult:
        """Run until the arm has been let go.

        Args:
            wishes: Of the operator, at first.
        """
        try:
            return self._run(wishes)
        except BaseException:
            # A defect of this program: whatever it is, the arm is let go before anybody reads about it.
            self._let_go(self._clock.now())
            raise

    def _run(self, wishes: OperatorCommand) -> RunResult:
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
            done = self._cycle.step(reading, timing, wishes)
            self._send(done, woke)
            if self._watchdog is not None:
                self._watchdog.beat(woke, done.task is not Task.OFF)
            if done.situation.state is OperatingState.CONTACT:
                self._contact += 1
            if done.clamp.acted:
                self._count(done.clamp)
            wishes = self._each(done)
            ended = clock.now()
            self._recorder.append(self._row(done, reading, woke - started, woke - deadline, ended - woke))
            deadline, late = statistics.cycle(deadline, woke, ended)
            over = over + 1 if done.situation.over else 0
            if over > (letting_go if done.task is Task.OFF else linger):
                self._let_go(deadline)
                return RunResult(done.situation, self._contact)

    def _let_go(self, deadline: int) -> None:
        """Zero torque and idle, several times."""
        arm = self._cycle.arm
        zero = arm.torque_frame((0.0, 0.0, 0.0, 0.0))
        for i in range(round(LETTING_GO * 1e9 / self._period)):
            self._clock.wait_until(deadline + i * self._period)
            arm.bus.drain()
            arm.bus.send(zero)
            if i % IDLE_EVERY == 0:
                self._idle()
            if self._watchdog is not None:
                self._watchdog.beat(self._clock.now(), False)

    def _send(self, done: CycleResult, woke: int) -> None:
        arm, now, frame = self._cycle.arm, self._clock.now(), done.frame
        # Stopped between measuring and sending, this cycle must not act on what is old by now.
        if now - woke > HELD * self._period or (self._watchdog is not None and self._watchdog.fired):
            frame = arm.torque_frame((0.0, 0.0, 0.0, 0.0))
        arm.bus.send(frame)
        if self._log is not None:
            self._log(frame, now, True)
        # An undriven puck left in torque mode would go on with the last command it heard.
        if (
            done.task is Task.OFF
            and done.situation.state is OperatingState.FAULT
            and done.situation.cycles % IDLE_EVERY == 0
        ):
            self._idle()

    def _idle(self) -> None:
        for frame in self._cycle.arm.idle_frames():
            assert check_service(frame) is None
            self._cycle.arm.bus.send(frame)

    def _judged(self, woke: int, missed: int) -> Reason:
        """What clock and watchdog forbid, once the replies are there."""
        now = self._clock.now()
        if missed > HELD or now - woke > HELD * self._period:
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

    def _row(self, done: CycleResult, reading: Reading, since: int, lateness: int, compute: int) -> tuple[float, ...]:
        """A row of `deploy.flight.recorder.COLUMNS`."""
        controller, arm = self._cycle.controller, self._cycle.arm
        runtime = controller.runtime
        nan = float("nan")
        return (
            1e-9 * since,
            *(done.force or (nan, nan, nan)),
            *controller.force_ref,
            *runtime.u,
            *runtime.last_v,
            *runtime.last_a,
            *runtime.p_hat,
            runtime.gain,
            *done.where.tip,
            *done.q,
            *self._cycle.checker.torque,
            *done.qd,
            *done.wanted,
            *done.applied,
            STATES.index(done.situation.state),
            REASONS.index(done.situation.reason),
            float(sum(1 << i for i, acted in enumerate(done.clamp) if acted)),
            *arm.counts,
            *reading.position_age,
            reading.force_age,
            1e-9 * lateness,
            1e-9 * compute,
        )
