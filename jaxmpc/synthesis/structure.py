"""What of a controller is no number to be tuned, and which of it goes together."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Literal, get_args

from jaxmpc.files.errors import InputError, nearest
from jaxmpc.quantities import FILTERS
from jaxmpc.synthesis.listening import Listening

Architecture = Literal["mpc-aob", "aob", "mpc"]
Order = Literal[1, 2, 3]
Delay = Literal[1, 2]
SHARED = ("architecture", "disturbance_order", "designed_delay")
STRUCTURE = (*SHARED, "guarded", "listening")
"""What needs a program of its own; the first of it knots share."""
IDLE: Mapping[str, frozenset[str]] = MappingProxyType(
    {"aob": frozenset({"lam", "delta", "Hp", "Hu"}), "mpc": frozenset({"T_cl"})}
)
"""Parameters that an architecture leaves without effect."""


def check_structure(params: Any) -> None:
    """Refuse a structure that no controller has.

    Args:
        params: One controller or a batch.

    Raises:
        InputError: Names the field, its value, what it must be and the remedy.
    """
    if params.architecture not in get_args(Architecture):
        known = list(get_args(Architecture))
        raise InputError("architecture", params.architecture, "a known one", nearest(str(params.architecture), known))
    order = params.disturbance_order
    if type(order) is not int or order not in get_args(Order):
        raise InputError("disturbance_order", order, "1, 2 or 3", "The paper's active state has order 1.")
    if params.architecture == "mpc" and order != 1:
        remedy = "MPC alone has no active state: leave it out."
        raise InputError("disturbance_order", order, '1 with the architecture "mpc"', remedy)
    delay = params.designed_delay
    if type(delay) is not int or delay not in get_args(Delay):
        raise InputError("designed_delay", delay, "1 or 2", "The paper's design has 1.")
    if not isinstance(params.guarded, bool):
        raise InputError("guarded", params.guarded, "true or false", "True lets the gain fall while the force swings.")
    if params.guarded and params.architecture == "mpc":
        remedy = "MPC alone has no model of the tissue to scale: leave it out."
        raise InputError("guarded", params.guarded, 'false with the architecture "mpc"', remedy)


def check_knots(params: Any, kind: type[Any]) -> None:
    """Refuse knots that are no controllers of the structure above them, or not one for each stiffness.

    Args:
        params: One controller or a batch.
        kind: Class of a controller, which imports this module.

    Raises:
        InputError: Names the field, its value, what it must be and the remedy.
    """
    if not isinstance(params.listening, Listening | None):
        raise InputError("listening", params.listening, "a Listening", "`Params.from_dict` takes a table for it.")
    if not isinstance(params.knots, tuple):
        raise InputError("knots", params.knots, "a tuple of Params", "One for each stiffness that listening names.")
    places = () if params.listening is None else params.listening.stiffness
    if len(places) != len(params.knots):
        remedy = "Give [params.listening] a stiffness for every [[params.knots]]."
        raise InputError("knots", f"{len(params.knots)} of them", f"as many as stiffnesses, {len(places)}", remedy)
    for knot in params.knots:
        if not isinstance(knot, kind):
            raise InputError("knots", knot, "a tuple of Params", "`Params.from_dict` takes tables for them.")
        same = all(getattr(knot, name) == getattr(params, name) for name in SHARED)
        if knot.knots or knot.guarded or not same:
            remedy = f"Leave {', '.join(SHARED)} and guarded to the table above it."
            raise InputError("knots", "of another structure", "of the structure of [params]", remedy)
        if own := [name for name in FILTERS if getattr(knot, name) is not None]:
            remedy = "A signal is filtered before the tissue is known: put it under [params]."
            raise InputError(f"knots.{own[0]}", getattr(knot, own[0]), "left out of knots", remedy)
