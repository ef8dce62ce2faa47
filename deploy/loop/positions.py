"""Joint angles from the encoders of each cycle: those that are believed, and how old the oldest of them is."""

from collections.abc import Callable

from deploy.loop.force_watch import ForceWatch
from deploy.safety.machine import BRIDGED, OperatingState, SafetyState, Task
from deploy.safety.plausible import EncoderState, beyond_stop, encoder_step
from deploy.safety.reasons import Reason
from deploy.safety.unmoved import unmoved
from deploy.wam.arm import WamArm
from deploy.wam.encoder_bridge import EncoderBridge
from deploy.wam.reading import Reading
from jaxmpc.law.vectors import Vector3, Vector4


class Positions:
    """Takes the encoders' counts, cycle by cycle.

    Attributes:
        q: Joint angles that were believed last [rad].
    """

    def __init__(self, arm: WamArm, T_s: float, velocity: Callable[[Vector4], Vector4]) -> None:
        """Begin where a started arm is.

        Args:
            arm: It.
            T_s: Sampling time [s].
            velocity: Hears of the angles in cycles that were left out, for the joint velocities.
        """
        self._pucks, self._T_s, self._velocity = arm.pucks, T_s, velocity
        self._counts_per_turn = tuple(info.counts_per_turn for info in arm.pucks.infos)
        self._bridge, self._state, self._age = EncoderBridge(arm.counts), EncoderState(), [0] * 4
        self._unbridged = 0  # cycles since the bridge was asked
        self._unmoved, self._withdrawing, self._state_before = -1, 0, OperatingState.IDLE
        self.q = arm.pucks.angles(arm.counts)

    @property
    def age(self) -> tuple[int, ...]:
        """Age of each motor's last believed position (4,) [cycles]; one that was refused has not come."""
        return tuple(self._age)

    @property
    def still(self) -> tuple[int, ...]:
        """Samples in a row in which each motor has told the same, less one (4,)."""
        return self._state.still

    def take(self, reading: Reading, missed: int) -> tuple[Reason, int, int]:
        """Take those of a cycle.

        Args:
            reading: Of this cycle.
            missed: Cycles that were left out before it.

        Returns:
            Why to distrust them, the age of the oldest [cycles], and its motor (0–3).
        """
        counts, elapsed = reading.counts, self._T_s * (1 + missed)
        self._state, reason, culprit = encoder_step(self._state, counts, self._counts_per_turn, elapsed, self._unmoved)
        if reason is not None:
            counts = tuple(None if i == culprit else each for i, each in enumerate(counts))
        for i, (each, late) in enumerate(zip(counts, reading.position_age, strict=True)):
            cycles = self._age[i] + 1 if each is None else late
            self._age[i] = cycles + missed if cycles else 0
        age = max(self._age)
        oldest = culprit if reason is not None else self._age.index(age)
        self._unbridged += 1 + missed
        if age <= BRIDGED:
            out, self._unbridged = self._unbridged - 1, 0
            for between in self._bridge.take(counts, out):
                q = self._pucks.angles(between)
                if between is not self._bridge.counts:
                    self._velocity(q)
            if (joint := beyond_stop(q)) >= 0:
                return Reason.ENCODER_RANGE, age, joint
            self.q = q
        return reason or Reason.NONE, age, oldest

    def weigh(self, now: SafetyState, task: Task, watch: ForceWatch, force: Vector3 | None) -> None:
        """Look for a motor that a retraction, or what holds the arm after it, pushes in vain; the next cycle says so.

        An arm that is held so far may be leant on, and in contact joints stand still for friction.

        Args:
            now: State of the last cycle.
            task: Of the last cycle.
            watch: Knows what disturbs the joints.
            force: Measured force on the tissue [N]; None where there is none.
        """
        self._unmoved = -1
        # Not those of the state itself, which begin again with another reason.
        self._withdrawing = self._withdrawing + 1 if now.state is self._state_before else 0
        self._state_before = now.state
        if task in (Task.RETRACT, Task.HOLD) and now.state is not OperatingState.ARMED:
            read = None if force is None or now.reason is Reason.FORCE_MODEL else watch.read
            self._unmoved = unmoved(self._state.still, watch.disturbance, read, self._withdrawing, self._T_s)
