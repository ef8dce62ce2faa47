"""A result as a CSV file and as labelled arrays."""

import csv
import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from jaxmpc.files.errors import InputError
from jaxmpc.quantities import MARGINS, METRICS
from jaxmpc.status import Status
from sweeps import labelled
from sweeps.result import Result

Finished = tuple[Path, Result]
ROWS = 120


def test_csv_holds_every_row_and_stiffness(finished: Finished, tmp_path: Path) -> None:
    _, result = finished
    result.to_csv(tmp_path / "rows.csv")
    with (tmp_path / "rows.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 2 * ROWS
    last = rows[-1]
    assert int(last["row"]) == result["row"][-1]
    assert float(last["T_cl [s]"]) == result["T_cl"][-1]
    assert (float(last["stiffness [N/m]"]), last["status"]) == (1900.0, Status(result["status"][-1, 1]).name)
    assert float(last["rms_z [N]"]) == result["rms"][-1, 1, 2]
    assert [row["in_float64"] == "True" for row in rows[::2]] == result["in_float64"].tolist()
    assert float(last["delay_margin_s [s]"]) == result["delay_margin_s"][-1, 1]


def test_a_csv_takes_little_memory_beside_the_result(
    finished: Finished, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    finished[1].to_csv(tmp_path / "at once.csv")
    monkeypatch.setattr(labelled, "LINES", 50)
    finished[1].to_csv(tmp_path / "pieces.csv")
    assert (tmp_path / "pieces.csv").read_bytes() == (tmp_path / "at once.csv").read_bytes()
    many = finished[1].take(np.tile(np.arange(ROWS), 20))
    columns = sum(values.nbytes for _, _, values in labelled._table(many))
    tracemalloc.start()
    try:
        many.to_csv(tmp_path / "many.csv")
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    # All lines at once are ten times the columns, as Python's numbers and as text.
    assert peak < 2 * columns


def test_xarray_has_dimensions_coordinates_and_units(finished: Finished) -> None:
    pytest.importorskip("xarray")
    _, result = finished
    data = result.to_xarray()
    assert data["rms"].dims == ("row", "stiffness", "axis")
    assert data["M_s"].dims == data["status"].dims == ("row", "stiffness")
    assert data["in_float64"].values.tolist() == result["in_float64"].tolist()
    assert data.sizes == {"row": ROWS, "stiffness": 2, "axis": 3}
    known = {**METRICS, **MARGINS}
    assert {name: data[name].attrs["units"] for name in known} == {name: row.unit for name, row in known.items()}
    assert data["T_cl"].attrs["units"] == "s"
    assert data.attrs["result_hash"] == result.hash
    row = int(result["row"][5])
    assert data["rms"].sel(row=row, stiffness=375.0, axis="z") == result["rms"][5, 0, 2]


def test_without_xarray_the_extra_is_named(finished: Finished, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(InputError, match=r"jaxmpc\[analysis\]"):
        finished[1].to_xarray()
