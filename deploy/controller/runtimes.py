"""The recorded law of a frozen controller."""

from deploy.controller.artifact import Artifact
from deploy.runtime.arm import ArmRuntime
from deploy.runtime.linear import Runtime
from jaxmpc.files.errors import InputError
from jaxmpc.law.force_control import Controller
from jaxmpc.law.measurement import Measurement, lowpass_pole
from jaxmpc.law.ops import FLOATS


def linear_runtime(artifact: Artifact) -> Runtime:
    """The cascades alone."""
    return Runtime(artifact.flown_gains, artifact.preview)


def arm_runtime(artifact: Artifact) -> ArmRuntime:
    """The whole tick.

    Raises:
        InputError: The controller is of the kind "linear".
    """
    return ArmRuntime(*flown_controller(artifact), artifact.preview)


def flown_controller(artifact: Artifact) -> tuple[Controller, bool]:
    """Constants of the law as they fly, and whether friction is cancelled.

    Raises:
        InputError: The controller is of the kind "linear".
    """
    arm = artifact.arm
    if arm is None:
        remedy = "Freeze it with an experiment on the arm: `--experiment table-1-wam`."
        raise InputError("kind", artifact.kind, "wam: a linear controller only replays", remedy)
    T_s = artifact.T_s
    measurement = Measurement(T_s, lowpass_pole(artifact.loop.velocity_cutoff, T_s, FLOATS))
    gains, K2 = artifact.flown_gains, artifact.K2
    bandwidth = arm.momentum_observer or None
    return Controller(arm.chain, arm.nominal, arm.posture, gains, K2, measurement, bandwidth), arm.compensated
