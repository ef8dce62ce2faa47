"""Whether the pucks give the torque that a controller counts on, for `jaxmpc doctor`: it asks and sets nothing."""

from collections.abc import Callable

from deploy.controller.limits import Limits
from deploy.errors import CalibrationError
from deploy.puck.codec import PUCKS
from deploy.puck.properties import number
from deploy.safety.puck_caps import within_caps
from jaxmpc.files.errors import InputError

VERS = 0
UNTOLD = "pucks: they do not tell their torque caps (MT); a run reads them once they are awake"


def torque_caps(limits: Limits, ask: Callable[[int, int], int | None]) -> tuple[bool, str]:
    """Whether no cap prevents a run, and a sentence; an empty one where no cap is below the controller's limits.

    Args:
        limits: Of the controller.
        ask: What a node answers to the question for a property; None if it does not.
    """
    caps: dict[int, float] = {}
    for node in PUCKS:
        version = ask(node, VERS)
        if version is None:
            return True, UNTOLD
        try:
            pidx, ipnm, mt = (ask(node, number(name, "motor", version)) for name in ("PIDX", "IPNM", "MT"))
        except InputError as error:
            return False, f"puck {node}: {error}"
        if pidx is None or ipnm is None or mt is None:
            return True, UNTOLD
        caps[pidx] = mt / ipnm if ipnm > 0 else 0.0
    if sorted(caps) != [1, 2, 3, 4]:
        return False, f"pucks: their places in a torque (PIDX) are {sorted(caps)}, not 1 to 4: set them with btutil"
    try:
        return True, within_caps(limits, [caps[i] for i in (1, 2, 3, 4)])[1]
    except CalibrationError as error:
        return False, str(error)
