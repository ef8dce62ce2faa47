"""A result as a table or as labelled arrays: names, units, dimensions."""

import csv
import io
from collections.abc import Iterable, Iterator, Mapping
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from jaxmpc.experiment import AXES
from jaxmpc.files.errors import InputError
from jaxmpc.files.sealed import canonical_json, write_atomic
from jaxmpc.quantities import METRICS
from jaxmpc.status import Status
from sweeps.goal import MEASURED
from sweeps.plan import Plan
from sweeps.undecided import IN_FLOAT64

if TYPE_CHECKING:
    import pandas
    import xarray

LINES = 10_000
"""Lines of a CSV file that are made at once: as Python's numbers they take ten times what they do in a result."""


class Labelled(Protocol):
    """What of a `Result` is needed here."""

    @property
    def plan(self) -> Plan:
        """What was swept."""

    @property
    def columns(self) -> Mapping[str, np.ndarray]:
        """Its columns."""

    @property
    def tissues(self) -> np.ndarray:
        """(rows, stiffness) [N/m]."""

    @property
    def hash(self) -> str:
        """sha256 of all columns."""


def to_csv(result: Labelled, path: str | Path) -> None:
    """Write one line per row and stiffness; units stand in the head, words of a choice and status by name.

    Raises:
        OSError: The file cannot be written.
    """
    table = _table(result)
    head = [name if unit is None else f"{name} [{unit}]" for name, unit, _ in table]
    stretches = range(0, len(table[0][2]), LINES)
    columns = ([values[first : first + LINES].tolist() for _, _, values in table] for first in stretches)
    lines = chain([[head]], (zip(*each, strict=True) for each in columns))
    write_atomic(Path(path), map(_csv, lines))


def _csv(lines: Iterable[Iterable[Any]]) -> bytes:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(lines)
    return text.getvalue().encode()


def to_pandas(result: Labelled) -> "pandas.DataFrame":
    """A table with a line per row and stiffness, indexed by both; `.attrs` has units, result hash and spec.

    Raises:
        InputError: pandas is not installed.
    """
    try:
        import pandas
    except ModuleNotFoundError:
        raise _missing("pandas") from None
    table = list(_table(result))
    frame = pandas.DataFrame({name: values for name, _, values in table}).set_index(["row", "stiffness"])
    frame.attrs = {"units": {name: unit for name, unit, _ in table if unit}, **_attributes(result)}
    return frame


def to_xarray(result: Labelled) -> "xarray.Dataset":
    """A dataset with dimensions row, stiffness and axis, units and texts as attributes.

    Where stiffness itself is swept, its dimension is `tissue` and the values stand in `tissue_stiffness`.

    Raises:
        InputError: xarray is not installed.
    """
    try:
        import xarray
    except ModuleNotFoundError:
        raise _missing("xarray") from None
    plan, columns = result.plan, result.columns
    swept = bool(np.isnan(plan.stiffness).any())
    tissue, attributes = "tissue" if swept else "stiffness", {"units": "N/m", "long_name": "tissue stiffness"}
    coordinates: dict[str, Any] = {"row": columns["row"], "axis": list(AXES)}
    if swept:
        coordinates["tissue_stiffness"] = (("row", tissue), result.tissues, attributes)
    else:
        coordinates[tissue] = (tissue, list(plan.stiffness), attributes)
    for axis in plan.space.axes:
        # A dimension has that name already.
        name = "stiffness_set" if axis.name == "stiffness" else axis.name
        values = columns[axis.name] if axis.numeric else _words(axis, columns[axis.name])
        coordinates[name] = ("row", values, {"units": axis.unit})
    meanings = {status.name: int(status) for status in Status}
    variables: dict[str, Any] = {"status": (("row", tissue), columns["status"], meanings)}
    variables[IN_FLOAT64] = ("row", columns[IN_FLOAT64], {"long_name": "whether it ran in float64"})
    for name in plan.kept:
        dimensions = ("row", tissue, "axis")[: 3 if name in METRICS else 2]
        row = MEASURED[name]
        variables[name] = (dimensions, columns[name], {"units": row.unit, "long_name": row.text})
    return xarray.Dataset(variables, coordinates, _attributes(result))


def _table(result: Labelled) -> list[tuple[str, str | None, np.ndarray]]:
    """Name, unit and values of every column of a flat table, a line per row and stiffness."""
    return list(_columns(result))


def _columns(result: Labelled) -> Iterator[tuple[str, str | None, np.ndarray]]:
    plan, columns, tissues = result.plan, result.columns, len(result.plan.stiffness)
    yield "row", None, np.repeat(columns["row"], tissues)
    for axis in plan.space.axes:
        values = columns[axis.name] if axis.numeric else _words(axis, columns[axis.name])
        name = "stiffness_set" if axis.name == "stiffness" else axis.name
        yield name, axis.unit, np.repeat(values, tissues)
    yield "stiffness", "N/m", result.tissues.ravel()
    names = np.array([status.name for status in Status])
    yield "status", None, names[columns["status"].astype(int).ravel()]
    yield IN_FLOAT64, None, np.repeat(columns[IN_FLOAT64], tissues)
    for name in plan.kept:
        if name in METRICS:
            for i, letter in enumerate(AXES):
                yield f"{name}_{letter}", MEASURED[name].unit, columns[name][:, :, i].ravel()
        else:
            yield name, MEASURED[name].unit, columns[name].ravel()


def _words(axis: Any, entries: np.ndarray) -> np.ndarray:
    words: np.ndarray = np.array([axis.label(i) for i in range(len(axis.values))])[entries.astype(int)]
    return words


def _attributes(result: Labelled) -> dict[str, str]:
    return {"result_hash": result.hash, "spec": canonical_json(result.plan.canonical)}


def _missing(package: str) -> InputError:
    remedy = "Install the extra: pip install 'jaxmpc[analysis]'."
    return InputError(package, "not installed", "installed for labelled tables", remedy)
