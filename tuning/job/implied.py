"""Goals that freezing for a robot implies: where a job on the arm leaves them out, they are held all the same.

The law turns each count of the force sensor into torque within the same sample, and neither residual nor margins mind.
What a joint is asked to change from one sample to the next grows with the chatter: on the arm of Table I the largest
change of joint 2, the one that carries most, is some 7 N m per m/s². Chatter is also what spectra see without a run.
"""

from jaxmpc.experiment import Experiment
from jaxmpc.quantities import HIGHEST_M_S

CLAMPED = 1e-3
"""Largest share of samples at which a limit acts, of a controller that flies [-] (`definitions.md`)."""
CHATTER_PER_STEP = 0.12
"""Chatter that a torque step allows joint 2 [m/s² per N m]: 1/7, and some room for tissues and rhythms."""
JOINT_2 = 1


def implied_goals(experiment: Experiment) -> dict[str, float]:
    """M_s as any frozen controller promises it, and limits of metrics that those of the arm imply.

    Args:
        experiment: What is tuned on; the linear world or a study implies nothing.
    """
    if not experiment.limited:
        return {}
    torque, step = experiment.arm.joint_torque_limit, experiment.arm.torque_step_limit
    found = {"M_s": HIGHEST_M_S, "clamped": CLAMPED}
    # What is measured is the largest of all joints, whichever it is.
    if all(torque):
        found["joint_torque"] = max(torque)
    if all(step):
        found |= {"torque_step": max(step), "chatter": CHATTER_PER_STEP * step[JOINT_2]}
    return found
