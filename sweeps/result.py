"""The result of a sweep, by name: residuals and margins together, the best rows, the Pareto front."""

import csv
import hashlib
import io
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from jaxmpc.experiment import AXES
from jaxmpc.files.errors import InputError, nearest
from jaxmpc.files.sealed import canonical_json, write_atomic
from jaxmpc.quantities import MARGINS, METRICS, PARAMETERS
from jaxmpc.status import Status
from jaxmpc.synthesis.params import Params
from sweeps import store
from sweeps.plan import Plan

if TYPE_CHECKING:
    import xarray


class Point(NamedTuple):
    """One controller in the plane of the Pareto front."""

    rms: float
    """Largest residual RMS over stiffness and axis [N]; ∞ unless the status is OK at every stiffness."""
    M_s: float
    """Largest peak sensitivity over stiffness [-]."""


def baseline_of(summary: Mapping[str, Any]) -> Point | None:
    """The baseline in a folder's summary, where an infinity is null."""
    found = summary.get("baseline")
    if not (isinstance(found, list) and len(found) == 2 and all(isinstance(x, float | int | None) for x in found)):
        return None
    return Point(*(np.inf if value is None else value for value in found))


@dataclass(frozen=True)
class Result:
    """Rows of a sweep; `result["rms"]` is a column, shape (rows, stiffness, 3).

    Attributes:
        plan: What was swept.
        columns: Row number, swept parameters, status, metrics and margins (`jaxmpc.quantities`).
        baseline: The base controller on the same experiment, once the sweep is finished.
    """

    plan: Plan
    columns: Mapping[str, np.ndarray]
    baseline: Point | None = None

    @staticmethod
    def load(folder: str | Path) -> "Result":
        """The rows that a sweep's folder holds so far.

        Raises:
            InputError: The folder is no sweep's.
        """
        folder = Path(folder)
        plan = store.read_plan(folder)
        columns, there = store.read_chunks(folder, plan)
        rows = {name: values[there] for name, values in columns.items()}
        return Result(plan, rows, baseline_of(store.read_summary(folder)))

    def __repr__(self) -> str:
        swept = ", ".join(axis.name for axis in self.plan.space.axes)
        counts = ", ".join(f"{count} {name}" for name, count in self.status_counts().items() if count)
        tissues = f"{len(self.plan.stiffness)} stiffnesses [N/m]"
        return f"Result of a sweep of {swept}\n  {len(self)} rows × {tissues}: {counts}"

    def __contains__(self, name: object) -> bool:
        return name in self.columns

    def __len__(self) -> int:
        return len(self.columns["row"])

    def __getitem__(self, name: str) -> np.ndarray:
        if name not in self.columns:
            raise InputError("column", name, "a column of the result", nearest(name, list(self.columns)))
        return self.columns[name]

    @property
    def complete(self) -> bool:
        """Whether every planned row is here."""
        return len(self) == len(self.plan.rows)

    @cached_property
    def hash(self) -> str:
        """sha256 over the little-endian bytes of all columns in their fixed order; that of the result itself."""
        total = hashlib.sha256()
        for name, column in self.plan.layout.items():
            values = np.ascontiguousarray(self.columns[name], np.dtype(column.dtype))
            total.update(canonical_json([name, column.dtype, list(values.shape)]).encode())
            total.update(values.tobytes())
        return total.hexdigest()

    @cached_property
    def worst_rms(self) -> np.ndarray:
        """Largest residual RMS over stiffness and axis, (rows,) [N]; ∞ unless OK at every stiffness."""
        ok = (self["status"] == Status.OK).all(axis=1)
        return np.where(ok, np.max(self["rms"], axis=(1, 2), where=ok[:, None, None], initial=0.0), np.inf)

    @cached_property
    def worst_M_s(self) -> np.ndarray:  # noqa: N802 - the symbol
        """Largest peak sensitivity over stiffness, (rows,) [-]; ∞ when unstable or ill-posed."""
        worst: np.ndarray = np.nan_to_num(self["M_s"], nan=np.inf, posinf=np.inf).max(axis=1)
        return worst

    def take(self, places: np.ndarray) -> "Result":
        """Some rows, in the order given, by their places in this result."""
        return replace(self, columns={name: values[places] for name, values in self.columns.items()})

    def best(self, n: int = 10, max_M_s: float = 2.0) -> "Result":
        """The rows of least worst-case residual among those that are robust enough.

        Args:
            n: How many at most.
            max_M_s: Largest accepted worst-case peak sensitivity [-].
        """
        order = np.argsort(self.worst_rms, kind="stable")
        good = np.isfinite(self.worst_rms[order]) & (self.worst_M_s[order] <= max_M_s)
        return self.take(order[good][:n])

    def pareto(self) -> "Result":
        """The rows that no other beats in both worst-case residual and worst-case M_s, ordered by M_s."""
        order = np.lexsort((self.worst_rms, self.worst_M_s))
        front: list[int] = []
        for place in order[np.isfinite(self.worst_rms[order]) & np.isfinite(self.worst_M_s[order])]:
            if (
                not front
                or self.worst_rms[place] < self.worst_rms[front[-1]]
                or self._point(place) == self._point(front[-1])
            ):
                front.append(int(place))
        return self.take(np.array(front, int))

    def _point(self, place: int) -> Point:
        return Point(float(self.worst_rms[place]), float(self.worst_M_s[place]))

    def controller(self, place: int) -> Params:
        """The controller of one row, by its place in this result."""
        return self.plan.base.with_columns({a.name: self[a.name][[place]] for a in self.plan.space.axes})[0]

    def status_counts(self) -> dict[str, int]:
        """How many (row, stiffness) pairs ended in each `Status`."""
        return {status.name: int((self["status"] == status).sum()) for status in Status}

    def to_csv(self, path: str | Path) -> None:
        """Write one line per row and stiffness; units stand in the head, status by name.

        Raises:
            OSError: The file cannot be written.
        """
        swept = [axis.name for axis in self.plan.space.axes]
        head = ["row", *(f"{name} [{PARAMETERS[name].unit}]" for name in swept), "stiffness [N/m]", "status"]
        head += [f"{name}_{axis} [{metric.unit}]" for name, metric in METRICS.items() for axis in AXES]
        head += [f"{name} [{margin.unit}]" for name, margin in MARGINS.items()]
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(head)
        for place in range(len(self)):
            start = [int(self["row"][place]), *(float(self[name][place]) for name in swept)]
            for tissue, stiffness in enumerate(self.plan.stiffness):
                values = np.concatenate([np.atleast_1d(self[name][place, tissue]) for name in (*METRICS, *MARGINS)])
                status = Status(self["status"][place, tissue]).name
                writer.writerow([*start, stiffness, status, *values.tolist()])
        write_atomic(Path(path), text.getvalue().encode())

    def to_xarray(self) -> "xarray.Dataset":
        """A dataset with dimensions row, stiffness and axis, units and texts as attributes.

        Raises:
            InputError: xarray is not installed.
        """
        try:
            import xarray
        except ModuleNotFoundError:
            remedy = "Install the extra: pip install 'jaxmpc[analysis]'."
            raise InputError("xarray", "not installed", "installed for labelled arrays", remedy) from None
        coordinates: dict[str, Any] = {
            "row": self["row"],
            "stiffness": ("stiffness", list(self.plan.stiffness), {"units": "N/m", "long_name": "tissue stiffness"}),
            "axis": list(AXES),
        }
        for axis in self.plan.space.axes:
            coordinates[axis.name] = ("row", self[axis.name], {"units": PARAMETERS[axis.name].unit})
        meanings = {status.name: int(status) for status in Status}
        variables: dict[str, Any] = {"status": (("row", "stiffness"), self["status"], meanings)}
        for name, row in {**METRICS, **MARGINS}.items():
            dimensions = ("row", "stiffness", "axis")[: 3 if name in METRICS else 2]
            variables[name] = (dimensions, self[name], {"units": row.unit, "long_name": row.text})
        attributes = {"result_hash": self.hash, "spec": canonical_json(self.plan.canonical)}
        return xarray.Dataset(variables, coordinates, attributes)
