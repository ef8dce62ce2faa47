"""The force sensor's word, weighed against what else tells of the force: motors, travel, the law's demand, its sine."""

from typing import NamedTuple

from deploy.loop.control import TaskController
from deploy.safety.force_balance import BalanceState, balance_step
from deploy.safety.force_estimate import ForceEstimate
from deploy.safety.late_force import late_step
from deploy.safety.machine import OperatingState
from deploy.safety.reasons import Reason
from deploy.safety.runaway import runaway_step
from deploy.wam.tip_pose import TipKinematics
from jaxmpc.law.vectors import Vector3, Vector4


class ForceSample(NamedTuple):
    """A cycle's motion and force, and the torque that led to it."""

    q: Vector4
    """Joint angles [rad]."""
    qd: Vector4
    """Joint velocities [rad/s]."""
    kinematics: TipKinematics
    force: Vector3 | None
    """Measured force on the tissue [N]."""
    torque: Vector4
    """Joint torques that were sent after the last cycle [N m]."""


class ForceWatch:
    """Weighs the sensor's word, cycle by cycle.

    Attributes:
        balance: What the motors tell beside it.
    """

    def __init__(self, controller: TaskController, estimate: ForceEstimate | None, deepest: float, T_s: float) -> None:
        """Know nothing.

        Args:
            controller: Of the torques.
            estimate: The force as the motors tell it; None leaves the sensor's scale and sign unchecked.
            deepest: Travel in contact beyond which the softest promised tissue gives more than the limit [m].
            T_s: Sampling time [s].
        """
        self._controller, self._estimate, self._deepest, self._T_s = controller, estimate, deepest, T_s
        self.balance, self._runaway, self._late = BalanceState(), 0, 0

    @property
    def disturbance(self) -> Vector4:
        """All that disturbs the joints, by their motion [N m]; 0 where the motors tell nothing."""
        return (0.0, 0.0, 0.0, 0.0) if self._estimate is None else self._estimate.disturbance

    @property
    def read(self) -> Vector4:
        """What the force that is read explains of it [N m]: the disturbance is minus that, and what nobody knows."""
        return (0.0, 0.0, 0.0, 0.0) if self._estimate is None else self._estimate.read

    def judge(self, state: OperatingState, sample: ForceSample, driven: bool, missed: bool) -> Reason:
        """Reason not to believe the sensor, NONE if there is none.

        Args:
            state: Before this cycle.
            sample: Of this cycle.
            driven: Whether the pucks are active and the positions fresh.
            missed: Whether cycles were left out before this one.
        """
        found = self._weighed(state, sample, driven, missed)
        if state is not OperatingState.CONTACT:
            return found
        self._runaway, runaway = runaway_step(self._runaway, self._controller.runtime.last_a)
        self._late, late = late_step(self._late, self._controller.runtime.lag, self._T_s)
        too_deep = self._controller.depth(sample.kinematics.tip) > self._deepest
        return runaway or late or (Reason.FORCE_MODEL if too_deep else found)

    def _weighed(self, state: OperatingState, sample: ForceSample, driven: bool, missed: bool) -> Reason:
        """Whether the motors' torques agree with the measured force."""
        estimate, (q, qd, kinematics, force, torque) = self._estimate, sample
        if estimate is None:
            return Reason.NONE
        if not driven:
            estimate.start(qd)
            return Reason.NONE
        if missed:
            estimate.skip(qd)
            return Reason.NONE
        told = estimate.step(q, qd, torque, force)
        approaching = state is OperatingState.APPROACH
        if not (approaching or state is OperatingState.CONTACT):
            return Reason.NONE
        normal = self._controller.contacting.normal
        self.balance, reason = balance_step(
            self.balance, told, force, kinematics.velocity, normal, approaching, self._T_s
        )
        return reason or Reason.NONE
