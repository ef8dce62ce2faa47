"""The golden trace of a frozen controller, replayed: does the law on this machine answer as the one that was frozen?"""

from typing import Any

import numpy as np

from deploy.controller import known_tissue
from deploy.controller.artifact import Artifact
from deploy.controller.checks import array
from deploy.controller.runtimes import arm_runtime, linear_runtime
from jaxmpc.files.errors import InputError

TOLERANCE = 1e-9
"""Largest deviation from the golden trace at load [-, N m]; `replay` says why."""
FLOOR = 1e-12
"""What is added to the size of a number that is remembered, in its own unit: far below a mean square of the sensor's
noise, 1e-8 N² after a few samples."""


def replay(artifact: Artifact) -> tuple[float, float, float]:
    """Largest deviations from the golden trace: of v, relative to its largest [-], of torques [N m], of the memory [-].

    Torques of a schedule are also those at its knots, each with its gains in control, and beyond its bounds; its memory
    is what it remembers of these, each number relative to itself (`known_tissue`), else 0.

    The trace begins in contact at rest at its first sample. Every force and angle comes from the trace, as do the
    torques that were applied, not from a loop that reacts, so no feedback amplifies rounding. What remains is that XLA
    may fuse a multiplication with an addition, and may sum the weights of the reference in another order: about 1e-15
    a step. A load therefore asks for 1e-9, far above rounding and far below any other law or changed gain.
    """
    v, torque, memory = _linear(artifact) if artifact.arm is None else _on_arm(artifact)
    deviation = float(np.max(np.abs(v - artifact.golden_v))) / float(np.max(np.abs(artifact.golden_v)))
    return deviation, torque, memory


def check_golden(artifact: Artifact) -> float:
    """Replay the golden trace and return the deviation of the commands, relative to the largest one [-].

    Raises:
        InputError: It is not reproduced, or on the arm its torques or its memory are not.
    """
    remedy = "Its constants and its trace do not belong together: freeze the controller again."
    v, torque, memory = replay(artifact)
    for name, deviation, unit in (("trace", v, ""), ("torques", torque, " N m"), ("memory", memory, "")):
        if not deviation <= TOLERANCE:
            bound = f"at most {TOLERANCE:g}{unit}"
            raise InputError(f"deviation from the golden {name}", f"{deviation:.3g}{unit}", bound, remedy)
    return v


def arm_inputs(artifact: Artifact) -> list[tuple[Any, Any, Any]]:
    """Angles [rad], measured and wanted force [N] of each golden sample, as the runtime of an arm takes them."""
    arm = artifact.arm
    assert arm is not None
    return known_tissue.samples(arm.golden_q, artifact.golden_force, artifact.golden_force_ref, artifact.preview)


def _linear(artifact: Artifact) -> tuple[np.ndarray, float, float]:
    runtime = linear_runtime(artifact)
    runtime.init(artifact.golden_force[0])
    rows = zip(artifact.golden_force, artifact.golden_force_ref, strict=True)
    return np.array([runtime.step(*row) for row in rows]), 0.0, 0.0


def _on_arm(artifact: Artifact) -> tuple[np.ndarray, float, float]:
    runtime, arm = arm_runtime(artifact), artifact.arm
    assert arm is not None
    v, torques, known, memory, trace = [], [], np.zeros(0), 0.0, arm_inputs(artifact)
    if artifact.gains.schedule is not None:
        known, remembered = known_tissue.replayed(runtime, artifact.gains.schedule, trace)
        expected = array("golden_memory", arm.golden_memory, remembered.shape)
        known = known - np.asarray(arm.golden_known)
        memory = float(np.max(np.abs(remembered - expected) / (np.abs(expected) + FLOOR)))
    runtime.start(tuple(arm.golden_q[0].tolist()))
    runtime.enter(tuple(artifact.golden_force[0].tolist()), tuple(arm.golden_q[0].tolist()))
    for (q, force, force_ref), applied in zip(trace, arm.golden_applied.tolist(), strict=True):
        torques.append(runtime.control(q, runtime.velocity(q), force, force_ref))
        v.append(runtime.last_v)
        runtime.applied(applied)
    off = np.append(np.array(torques) - arm.golden_torque, known)
    return np.array(v), float(np.max(np.abs(off))), memory
