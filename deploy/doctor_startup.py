"""What the start of a run would refuse of the nodes on the bus, for `jaxmpc doctor`: it asks and sets nothing."""

from collections.abc import Callable, Mapping
from typing import Literal

from deploy.errors import BusError, CalibrationError
from deploy.puck import properties
from deploy.puck.codec import PUCKS, SAFETY_MODULE
from deploy.puck.properties import STAT
from deploy.wam.asked import SEVENTH, four_joints, no_faults, read_puck, safety_version
from deploy.wam.pucks import Pucks
from jaxmpc.files.errors import InputError

UNHOMED = "arm: it does not know where it is (ZERO is not set): fold it to its home position, then `run --home`"


class _UntoldError(BusError):
    """A node does not answer; who is missing is told elsewhere."""


def refused(
    ask: Callable[[int, int], int | None], states: Mapping[int, int]
) -> list[tuple[Literal["note", "wrong"], str]]:
    """Sentences on what a run would be refused for, or needs to be told.

    Args:
        ask: What a node answers to the question for a property; None if it does not.
        states: STAT of the nodes that answered.
    """

    def must(node: int, number: int) -> int:
        if (value := ask(node, number)) is None:
            raise _UntoldError
        return value

    found: list[tuple[Literal["note", "wrong"], str]] = []

    def tried(step: Callable[[], object]) -> None:
        try:
            step()
        except _UntoldError:
            pass
        except (BusError, CalibrationError, InputError) as error:
            found.append(("wrong", f"arm: {error}"))

    def safety() -> None:
        version = safety_version(must)
        no_faults(must, version)
        if must(SAFETY_MODULE, properties.number("ZERO", "safety", version)) != 1:
            found.append(("note", UNHOMED))

    if SAFETY_MODULE in states:
        tried(safety)
    tried(lambda: four_joints([node for node in SEVENTH if ask(node, STAT) is not None]))
    if all(states.get(node) == properties.STAT_READY for node in PUCKS):  # asleep, they know no more than that
        tried(lambda: Pucks(tuple(read_puck(must, node) for node in PUCKS)))
    return found
