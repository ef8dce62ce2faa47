"""The loop that a frozen controller was judged in, and flies in: delay and filters between arm, sensor and law."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from deploy.controller.checks import AGAIN, keyed
from deploy.controller.margin_floor import number
from jaxmpc.files.errors import InputError


class JudgedLoop(NamedTuple):
    """What the margins hold with; the filter of the measured force is among the gains."""

    delay: int
    """Samples between a command and its effect [samples]."""
    ideal: bool
    """Whether the damping was the paper's ideal one, or the loop as it runs."""
    velocity_cutoff: float
    """Low-pass of the measured velocities [rad/s]; 0 is none."""
    sensor_cutoff: float
    """Low-pass of the force sensor [rad/s]; 0 is none."""


MEANING: Mapping[str, str] = {
    "delay": "the samples between a command and its effect",
    "ideal": "whether the damping was ideal",
    "velocity_cutoff": "the low-pass of the joint velocities",
    "sensor_cutoff": "the low-pass of the force sensor",
}
"""What each entry of the table is."""


def checked(value: Any) -> JudgedLoop:
    """The loop from one, or from the table of one.

    Raises:
        InputError: Something is missing, unknown, malformed or out of range; it is named.
    """
    table = keyed("loop", value, JudgedLoop._fields, MEANING)
    delay = table["delay"]
    if isinstance(delay, bool) or delay not in (1, 2):
        raise InputError("loop.delay", delay, "1 or 2 samples", "Longer ones are judged by delay_margin_s.")
    if not isinstance(table["ideal"], bool):
        remedy = "Say whether the damping was the paper's ideal one."
        raise InputError("loop.ideal", table["ideal"], "true or false", remedy)
    return JudgedLoop(int(delay), table["ideal"], *(_cutoff(name, table[name]) for name in JudgedLoop._fields[2:]))


def _cutoff(name: str, value: Any) -> float:
    found = number(f"loop.{name}", value)
    if not 0.0 <= found <= 1e5:
        raise InputError(f"loop.{name}", found, "in [0, 1e5] rad/s", AGAIN)
    return found
