"""Reasons for which the robot stops, is held back or refuses a frame: one word each, and a sentence for people."""

from collections.abc import Mapping
from enum import StrEnum


class Reason(StrEnum):
    """Reason for a stop or refusal; the word goes into statistics, recordings and the last line on the screen."""

    NONE = "none"
    # The outgoing frame.
    FRAME = "frame"
    STATE = "state"
    NOT_FINITE = "not-finite"
    JOINT_TORQUE = "joint-torque"
    MOTOR_TORQUE = "motor-torque"
    TORQUE_RATE = "torque-rate"
    # The arm.
    POSITION_OLD = "position-old"
    POSITION_LOST = "position-lost"
    POSTURE = "posture"
    JOINT_RANGE = "joint-range"
    JOINT_VELOCITY = "joint-velocity"
    TIP_VELOCITY = "tip-velocity"
    ELBOW_VELOCITY = "elbow-velocity"
    WORKSPACE = "workspace"
    SINGULARITY = "singularity"
    ENCODER_JUMP = "encoder-jump"
    ENCODER_STUCK = "encoder-stuck"
    ENCODER_RANGE = "encoder-range"
    # The force.
    TARE = "tare"
    FORCE = "force"
    FORCE_LOST = "force-lost"
    FORCE_NOT_FINITE = "force-not-finite"
    FORCE_RANGE = "force-range"
    FORCE_JUMP = "force-jump"
    FORCE_STUCK = "force-stuck"
    FORCE_SLOW = "force-slow"
    FORCE_MODEL = "force-model"
    # Time, bus, pucks and people.
    LATE = "late"
    STALLED = "stalled"
    BUS_OFF = "bus-off"
    BUS_ERROR = "bus-error"
    BUS_LOAD = "bus-load"
    PUCK_FAULT = "puck-fault"
    E_STOP = "e-stop"
    IDLE = "idle"
    PENDANT_FAULT = "pendant-fault"
    WATCHDOG = "watchdog"
    NOT_STARTED = "not-started"
    NO_CONTACT = "no-contact"
    OVERSHOOT = "overshoot"
    OPERATOR = "operator"
    FINISHED = "finished"
    ERROR = "error"

    @property
    def lets_go(self) -> bool:
        """Whether the arm can or may no longer be held: it is let go, pucks idle."""
        return self in _LETS_GO


_LETS_GO = {
    Reason.FRAME,
    Reason.STATE,
    Reason.NOT_FINITE,
    Reason.JOINT_TORQUE,
    Reason.MOTOR_TORQUE,
    Reason.TORQUE_RATE,
    Reason.POSITION_LOST,
    Reason.STALLED,
    Reason.BUS_OFF,
    Reason.BUS_ERROR,
    Reason.BUS_LOAD,
    Reason.PUCK_FAULT,
    Reason.E_STOP,
    Reason.IDLE,
    Reason.PENDANT_FAULT,
    Reason.WATCHDOG,
    Reason.ERROR,
}
EXPLANATION: Mapping[Reason, str] = {
    Reason.NONE: "Nothing is wrong.",
    Reason.FRAME: "An outgoing frame was not a packed torque, or one that may not be sent.",
    Reason.STATE: "Torque was about to be sent while the pucks may not be driven.",
    Reason.NOT_FINITE: "A torque, joint angle or joint velocity was not a finite number.",
    Reason.JOINT_TORQUE: "A joint torque was above its limit.",
    Reason.MOTOR_TORQUE: "A motor torque was above its limit; joints 2 and 3 share two motors.",
    Reason.TORQUE_RATE: "A joint torque changed faster than its limit.",
    Reason.POSITION_OLD: "A puck's positions were missing for longer than can be bridged.",
    Reason.POSITION_LOST: "A puck's positions were missing for too long to hold the arm.",
    Reason.POSTURE: "Armed, the arm was moved away from the posture that its controller was made for.",
    Reason.JOINT_RANGE: "A joint left its range.",
    Reason.JOINT_VELOCITY: "A joint was faster than its limit.",
    Reason.TIP_VELOCITY: "The tip was faster than its limit.",
    Reason.ELBOW_VELOCITY: "The elbow was faster than the tip may be.",
    Reason.WORKSPACE: "The tip left its box.",
    Reason.SINGULARITY: "The arm came too near to a pose in which its tip cannot move in every direction.",
    Reason.ENCODER_JUMP: "An encoder moved farther in a cycle than a motor can.",
    Reason.ENCODER_STUCK: "An encoder stood still while its motor moved or was pushed: it sticks, or the arm is held.",
    Reason.ENCODER_RANGE: "An encoder reads an angle beyond the joint's mechanical stop.",
    Reason.TARE: "The force sensor told a contact before the approach: its zero is off, or something touches the tool.",
    Reason.FORCE: "The force on the tissue was above its limit.",
    Reason.FORCE_LOST: "The force sensor did not answer.",
    Reason.FORCE_NOT_FINITE: "The measured force was not a finite number.",
    Reason.FORCE_RANGE: "The measured force was beyond what the sensor can measure.",
    Reason.FORCE_JUMP: "The measured force changed in a sample by more than a tissue can make it.",
    Reason.FORCE_STUCK: "The measured force repeated exactly, which a live sensor's noise does not allow.",
    Reason.FORCE_SLOW: "Too many measured forces repeated the one before: the sensor is slower than the loop.",
    Reason.FORCE_MODEL: "The measured force did not follow the arm: delay, sign, scale or tissue are not as designed.",
    Reason.LATE: "A cycle began or ended too late.",
    Reason.STALLED: "The controller stood still for many cycles; what it knows is too old to drive with.",
    Reason.BUS_OFF: "The CAN controller went bus-off.",
    Reason.BUS_ERROR: "Frames could not be sent.",
    Reason.BUS_LOAD: "Foreign frames fill the bus.",
    Reason.PUCK_FAULT: "A puck reported an error, left its mode or told its state no more.",
    Reason.E_STOP: "The emergency stop was pressed.",
    Reason.IDLE: "The pendant, or the safety module, set the arm to idle.",
    Reason.PENDANT_FAULT: "The safety module reported a fault.",
    Reason.WATCHDOG: "The watchdog process has ended or cannot be reached.",
    Reason.NOT_STARTED: "Nobody armed, activated or started the arm within the time that it waits.",
    Reason.NO_CONTACT: "The tissue was not met where it was expected.",
    Reason.OVERSHOOT: "The run is over, but the tip has pressed much more than was wanted.",
    Reason.OPERATOR: "The operator stopped it.",
    Reason.FINISHED: "The run is over.",
    Reason.ERROR: "The program failed; its message is above.",
}
"""Meaning of each reason, for people."""
