"""A row at its worst: over tissues and axes, and where there is no number."""

import numpy as np
import pytest

from jaxmpc.status import Status
from sweeps.goal import SweepGoal
from sweeps.judged import keeps, worst

NAN, INF = np.nan, np.inf


@pytest.mark.parametrize(
    ("name", "values", "found"),
    [
        ("rms", [[0.1, 0.3, 0.2], [0.25, 0.1, 0.1]], 0.3),
        ("rms", [[0.1, NAN, 0.2], [0.25, 0.1, 0.1]], INF),
        ("M_s", [1.5, 1.7], 1.7),
        ("M_s", [1.5, NAN], INF),
        ("gain_margin_db", [9.0, 6.0], 6.0),
        ("gain_margin_db", [INF, 6.0], 6.0),
        ("gain_margin_db", [NAN, 9.0], -INF),
    ],
)
def test_the_worst_over_tissue_and_axis_counts_and_no_number_is_worse(
    name: str, values: list[object], found: float
) -> None:
    """A floor that is no number, as of an unstable loop, is kept by nobody."""
    columns = {"status": np.full((1, 2), Status.OK, np.int8), name: np.array([values])}
    assert worst(columns, name).tolist() == [found]
    assert keeps(columns, name, 7.0).tolist() == [name in ("rms", "M_s") and np.isfinite(found)]


@pytest.mark.parametrize("name", ["rms", "M_s"])
def test_a_metric_counts_where_every_tissue_is_ok_and_a_margin_anywhere(name: str) -> None:
    statuses = np.array(
        [[Status.OK, Status.OK], [Status.OK, Status.DIVERGED], [Status.FORCE_LIMIT, Status.OK]], np.int8
    )
    values = np.full((3, 2, 3) if name == "rms" else (3, 2), 1.5)
    expected = [1.5, INF, INF] if name == "rms" else [1.5, 1.5, 1.5]
    assert worst({"status": statuses, name: values}, name).tolist() == expected


def test_what_ranks_and_is_limited_is_needed_once() -> None:
    """`sweep sensitivity` had a column of it twice."""
    assert SweepGoal("gain_margin_db", {"M_s": 2.0, "gain_margin_db": 6.0}).names == ("gain_margin_db", "M_s")
