"""The margins that a frozen controller has at each stiffness, and the floor that it promises to keep."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from jaxmpc.files.errors import InputError
from jaxmpc.quantities import MARGINS

SOFTEST, HARDEST = 1.0, 1e6
"""Stiffnesses of a tissue for which anything can be promised [N/m]; K̂_s lies within the same."""


def number(key: str, value: Any) -> float:
    """A number, or the word "inf" for infinity, which JSON has no number for.

    Raises:
        InputError: It is neither.
    """
    try:
        result = math.nan if isinstance(value, bool) else float(value)
    except (TypeError, ValueError, OverflowError):
        result = math.nan
    if math.isnan(result):
        raise InputError(key, value, "a number", "Evaluate the controller again.")
    return result


def plain_margins(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Rows of margins as plain data.

    Raises:
        InputError: There is none, or one has other keys or values than it must have, or such as no stable loop has.
    """
    known = {"stiffness", *MARGINS}
    plain = []
    if not isinstance(rows, list | tuple):
        raise InputError("margins", rows, "a list of tables", "Give one for each stiffness.")
    for row in rows:
        if not isinstance(row, Mapping) or set(row) != known:
            raise InputError("margins", row, f"a table of {', '.join(sorted(known))}", "Give each of them once.")
        values = {key: number(key, row[key]) for key in sorted(known)}
        if not SOFTEST <= values["stiffness"] <= HARDEST:
            bound = f"in [{SOFTEST:g}, {HARDEST:g}] N/m"
            raise InputError("stiffness", values["stiffness"], bound, "Give the tissue's own.")
        _check_possible(values)
        plain.append(values)
    if not plain:
        raise InputError("margins", "none", "given for at least one stiffness", "Evaluate them where it will be used.")
    return plain


def _check_possible(row: Mapping[str, float]) -> None:
    """Refuse what no stable loop has; an unstable one is told by `check`."""
    if row["spectral_radius"] >= 1.0:
        return
    for key in MARGINS:
        least = {"M_s": 1.0, "spectral_radius": 0.0}.get(key)
        if row[key] <= 0.0 if least is None else row[key] < least:
            case = f"{key} at {row['stiffness']:g} N/m"
            bound = f"{'above 0' if least is None else f'at least {least:g}'}, as of any stable loop"
            raise InputError(case, f"{row[key]:.6g}", bound, "Evaluate the controller again.")


def plain_floor(floor: Mapping[str, Any]) -> dict[str, float]:
    """A declared floor as plain data.

    Raises:
        InputError: It bounds nothing, something unknown, or by a value that cannot refuse anything.
    """
    if not isinstance(floor, Mapping) or not floor or not set(floor) <= set(MARGINS):
        raise InputError(
            "floor", floor, f"a table of one or more of {', '.join(MARGINS)}", "Declare what it must keep."
        )
    plain = {key: number(f"floor.{key}", floor[key]) for key in floor}
    for key, bound in plain.items():
        if not 0.0 < bound < math.inf:
            raise InputError(f"floor.{key}", bound, "positive and finite", "Leave it out if it is not to be bounded.")
    return plain


def plain_family(family: Any) -> dict[str, Any] | None:
    """Margins with the stiffness known, as plain data; None for a controller without a schedule.

    Raises:
        InputError: It is no table of the band and its rows, or the band is out of bounds.
    """
    if family is None:
        return None
    if not isinstance(family, Mapping) or set(family) != {"band", "rows"}:
        raise InputError("family", family, "a table of band and rows", "Freeze the controller again.")
    band = number("family.band", family["band"])
    if not 0.0 < band < 1.0:
        raise InputError("family.band", band, "in (0, 1)", "It is the relative error that K̂ may have.")
    return {"band": band, "rows": plain_margins(family["rows"])}


def check(margins: Iterable[Mapping[str, Any]], floor: Mapping[str, float], where: str = "at") -> None:
    """Stability first, then the floor, in every row; `where` says what a row's stiffness is.

    Raises:
        InputError: A row is unstable or below the floor; it names stiffness, value and bound.
    """
    for row in margins:
        case = f"{where} {row['stiffness']:g} N/m"
        if not row["spectral_radius"] < 1.0:
            remedy = "The loop is unstable there: tune again with that stiffness in the set."
            raise InputError(f"spectral_radius {case}", f"{row['spectral_radius']:.6g}", "below 1", remedy)
        for key, bound in floor.items():
            margin, value = MARGINS[key], row[key]
            if not margin.kept(value, bound):
                limit = f"{'at most' if margin.ceiling else 'at least'} {margin.amount(bound)}, the declared floor"
                remedy = "Tune again with that goal, or declare a floor that it keeps."
                raise InputError(f"{key} {case}", margin.amount(value, ".6g"), limit, remedy)
