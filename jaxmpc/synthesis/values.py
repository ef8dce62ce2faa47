"""Values of parameters as they come from files, sweeps and callers: read, and refused where no controller has them."""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxmpc.files.errors import InputError, check_table, nearest, within
from jaxmpc.quantities import HORIZONS, PARAMETERS


def is_number(value: Any) -> bool:
    """Whether a value is a real number or an array of them, or stands for one: nothing, a shape, a mark."""
    if (dtype := getattr(value, "dtype", None)) is None:
        return not isinstance(value, bool | int | complex | str | bytes | list | dict)
    return any(jnp.issubdtype(dtype, kind) for kind in (jnp.floating, jnp.integer))


def rows_of(columns: Mapping[str, Any]) -> int:
    """Length that columns share.

    Raises:
        InputError: There is none, a name is unknown, a column has another shape, or holds something else than numbers.
    """
    check_table("columns", columns)
    rows = 0
    for name, column in columns.items():
        if name not in PARAMETERS:
            raise InputError(name, "a column", "of a known parameter", nearest(name, list(PARAMETERS)))
        try:
            numbers = is_number(np.asarray(column))
        except ValueError:  # rows of several lengths
            numbers = False
        if not numbers:
            raise InputError(name, column, "numbers", f"Their unit is [{PARAMETERS[name].unit}].")
        shape, entries = np.shape(column), PARAMETERS[name].entries
        rows = rows or (shape[0] if shape else 0)
        if not rows or shape not in [(rows,), (rows, entries)][: 1 + bool(entries)]:
            allowed = f"({rows or 'n'},)" + (f" or ({rows or 'n'}, {entries})" if entries else "")
            raise InputError(name, f"a column of the shape {shape}", allowed, "Give one value for each controller.")
    if not rows:
        raise InputError("columns", "none", "at least one", f"Known: {', '.join(PARAMETERS)}.")
    return rows


def tables(name: str, value: Any) -> Sequence[Mapping[str, Any]]:
    """Tables of a file.

    Raises:
        InputError: It is something else.
    """
    if isinstance(value, Sequence) and all(isinstance(each, Mapping) for each in value):
        return value
    raise InputError(name, value, "tables", f"Write each as [[params.{name}]].")


def from_plain(name: str, value: Any) -> np.ndarray:
    """A number or a list of numbers, as a file has them."""
    given = value if isinstance(value, list) else [value]
    if not given or any(isinstance(x, bool) or not isinstance(x, int | float) for x in given):
        raise InputError(name, value, "a number", f"Its unit is [{PARAMETERS[name].unit}].")
    try:
        numbers = np.asarray(value, np.float64)
    except OverflowError:
        raise InputError(name, value, "a number of at most 64 bits", "Write 1e30, say.") from None
    if not isinstance(value, list):
        return numbers
    entries = PARAMETERS[name].entries
    if len(value) > entries:
        length = f"a number or at most {entries} of them" if entries else "one number"
        raise InputError(name, f"{len(value)} numbers", length, "Only lam (along Hu) and delta (along Hp) take a list.")
    return np.append(numbers, np.full(entries - len(value), numbers[-1]))


BATCHES = "Make a batch with Params.stack or with_columns."


MAKE_PARAMS = 'Make one with Params.published("text"), Params.from_toml(FILE) or Params(lam=0.2).'
"""What to do about an argument that is no Params."""


def batch_of(values: Mapping[str, Any]) -> tuple[int, ...]:
    """Leading dimensions that all numbers of a controller, or of a batch, share.

    Args:
        values: Arrays by their parameters' names, traced or not.

    Raises:
        InputError: Some have others; it names the first that differs from most.
    """
    counted = Counter(tuple(value.shape) for name, value in values.items() if not PARAMETERS[name].entries)
    batch: tuple[int, ...] = counted.most_common(1)[0][0] if counted else ()
    for name, value in values.items() if counted else ():
        entries = PARAMETERS[name].entries
        if value.shape != batch and not (entries and value.shape == (*batch, entries)):
            bound = f"of the shape {batch}, as the other parameters" if batch else "one number"
            if entries:
                bound += f", or of the shape {(*batch, entries)}"
            raise InputError(name, f"an array of the shape {tuple(value.shape)}", bound, BATCHES)
    return batch


def check_filled(batch: tuple[int, ...]) -> None:
    """Refuse a batch of this shape that holds no controller.

    Raises:
        InputError: It holds none.
    """
    if 0 in batch:
        raise InputError("params", "an empty batch", "at least one controller", "Take rows that are there.")


def least_horizon(architecture: str) -> int:
    """Shortest H_p within which a command does something [samples]; MPC alone predicts its delay, too."""
    return 2 if architecture == "mpc" else 1


def check_values(
    values: Mapping[str, np.ndarray], typical: Mapping[str, Any], batch: int, architecture: str = "mpc-aob"
) -> None:
    """Refuse values that no controller can have; works on whole batches.

    Args:
        values: An array of each parameter whose values are known, in its unit.
        typical: A value of each, for the remedy.
        batch: How many leading dimensions are the batch's.
        architecture: Of all of them.

    Raises:
        InputError: Names the parameter, the first wrong value, the bound and the remedy.
    """
    for name, value in values.items():
        parameter = PARAMETERS[name]
        low, high = parameter.bounds
        wrong = ~(np.isfinite(value) & (value >= low) & (value <= high))
        if wrong.any():
            usual = float(np.sqrt(np.prod(parameter.search[:2]))) if typical[name] is None else typical[name]
            remedy = f"Correct {name}; a typical value is {parameter.amount(usual, '')}."
            raise InputError(name, value[wrong].flat[0], within(low, high, parameter.unit), remedy)
    for name in (name for name in HORIZONS if name in values):
        fractional = values[name] != np.floor(values[name])
        if fractional.any():
            raise InputError(name, values[name][fractional].flat[0], "a whole number of samples", f"Round {name}.")
    if "Hu" in values and "Hp" in values and (values["Hu"] > values["Hp"]).any():
        row = np.flatnonzero(np.ravel(values["Hu"] > values["Hp"]))[0]
        hu, hp = np.ravel(values["Hu"])[row], np.ravel(values["Hp"])[row]
        raise InputError("Hu", f"{hu:g}", f"in [1, Hp (= {hp:g})] samples", "Lower Hu or raise Hp.")
    first = least_horizon(architecture)
    if "Hp" in values and (values["Hp"] < first).any():
        remedy = "Raise Hp: a command acts only on later samples, so that nothing is controlled."
        raise InputError(
            "Hp", f"{values['Hp'].min():g}", f"at least {first} with the architecture {architecture!r}", remedy
        )
    delta = values.get("delta")
    if delta is None:
        return
    nowhere = ~np.any(_predicted(delta, values.get("Hp"), batch, first), axis=tuple(range(batch, delta.ndim)))
    if nowhere.any():
        row = np.flatnonzero(nowhere)[0]
        reach = f" from sample {first} on" if first > 1 and delta.ndim > batch else ""
        reach += f" within Hp (= {np.ravel(values['Hp'])[row]:g})" if "Hp" in values else ""
        remedy = "Without weight on the force error nothing is controlled."
        raise InputError("delta", 0.0, f"positive somewhere{reach}", remedy)


def _predicted(delta: np.ndarray, Hp: np.ndarray | None, batch: int, first: int) -> np.ndarray:
    """Weights on errors that commands change and the horizon, where it is known, reaches: others control nothing."""
    if delta.ndim == batch:
        return delta
    sample = np.arange(1, delta.shape[-1] + 1)
    within = sample <= (np.inf if Hp is None else np.asarray(Hp)[..., None])
    return np.where(within & (sample >= first), delta, 0.0)
