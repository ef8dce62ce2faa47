"""Row number → parameters: enumerated as written, independent of everything else."""

import itertools
import re
from typing import Any

import numpy as np
import pytest

from jaxmpc.files.errors import InputError
from sweeps.axis import SweepAxis, make_axis
from sweeps.space import SweepSpace, make_space

TEXT = (30.0, 5.0)
"""H_p and H_u of the text design."""


def sample(rows: int, seed: int = 7) -> SweepSpace:
    axes = (
        make_axis("lam", "log", (1e-3, 10.0), None),
        make_axis("Hp", "linear", (1.0, 64.0), None),
        make_axis("Hu", "linear", (1.0, 16.0), None),
        make_axis("K2", "list", (5.0, 10.0, 50.0), None),
    )
    return make_space("random", tuple((axis,) for axis in axes), rows, seed, TEXT)


def test_a_grid_is_row_major_in_the_order_written() -> None:
    axes = (SweepAxis("lam", "list", (3.0, 1.0)), SweepAxis("K2", "list", (5.0, 7.0, 9.0)))
    space = make_space("grid", tuple((axis,) for axis in axes), 0, 0, TEXT)
    columns = space.columns(space.rows())
    assert list(zip(columns["lam"], columns["K2"], strict=True)) == list(itertools.product((3.0, 1.0), (5.0, 7.0, 9.0)))


def test_a_part_of_a_grid_holds_what_the_whole_has_there() -> None:
    axes = (SweepAxis("lam", "list", (3.0, 1.0)), SweepAxis("K2", "list", (5.0, 7.0, 9.0)))
    space = make_space("grid", tuple((axis,) for axis in axes), 0, 0, TEXT)
    whole, part = space.columns(space.rows()), space.columns(np.array([4, 1]))
    for name in ("lam", "K2"):
        np.testing.assert_array_equal(part[name], whole[name][[4, 1]])


def test_pairs_with_hu_above_hp_are_left_out_and_numbers_stay() -> None:
    axes = (SweepAxis("Hp", "list", (1.0, 2.0, 3.0)), SweepAxis("Hu", "list", (1.0, 2.0, 3.0)))
    space = make_space("grid", tuple((axis,) for axis in axes), 0, 0, TEXT)
    assert space.count == 9
    assert space.rows().tolist() == [0, 3, 4, 6, 7, 8]


def test_a_fixed_hu_counts_as_well() -> None:
    space = make_space("grid", ((SweepAxis("Hp", "list", (4.0, 5.0)),),), 0, 0, (30.0, 5.0))
    assert space.rows().tolist() == [1]


def test_a_random_row_does_not_depend_on_the_others() -> None:
    few, many = sample(10), sample(1000)
    whole = many.columns(many.rows())
    for name, values in few.columns(np.array([9, 3])).items():
        np.testing.assert_array_equal(values, whole[name][[9, 3]])


def test_another_seed_gives_other_rows() -> None:
    rows = np.arange(5)
    assert (sample(5, 1).columns(rows)["lam"] != sample(5, 2).columns(rows)["lam"]).all()


def test_random_rows_fill_their_ranges_and_keep_hu_below_hp() -> None:
    columns = sample(2000).columns(np.arange(2000))
    assert (columns["Hu"] <= columns["Hp"]).all()
    assert set(columns["K2"]) == {5.0, 10.0, 50.0}
    assert set(columns["Hu"]) == set(range(1, 17))
    # log λ is uniform on four decades: mean −1, standard error 4/√12/√2000 = 0.026; allow four of them.
    assert np.log10(columns["lam"]).mean() == pytest.approx(-1.0, abs=0.11)


def test_ranges_end_where_they_are_told_to_and_horizons_are_whole() -> None:
    assert make_axis("lam", "log", (1e-3, 10.0), 5).values == pytest.approx((1e-3, 1e-2, 0.1, 1.0, 10.0))
    assert make_axis("Hp", "log", (5.0, 60.0), 4).values == (5.0, 11.0, 26.0, 60.0)
    assert make_axis("Hu", "linear", (1.0, 3.0), 10).values == (1.0, 2.0, 3.0)


@pytest.mark.parametrize("seed", [2**53, 2**53 + 1, 2**63 - 1])
def test_a_number_that_no_column_holds_is_refused(seed: int) -> None:
    """A column is of float64: 2^53 + 1 ran as 2^53, without a word."""
    with pytest.raises(InputError, match=re.escape("sweep.axes.motion.seed = ") + ".* below 9007199254740992"):
        make_axis("motion.seed", "list", (1, seed), None)
    make_axis("motion.seed", "list", (1, 2**53 - 1), None)


def test_what_counts_is_told_to_the_last_digit() -> None:
    """Seeds that are dates were all told as 2.02611e+07."""
    axis = make_axis("motion.seed", "list", (20261129, 20261130, 2**53 - 1), None)
    assert [axis.label(value) for value in axis.column()] == ["20261129", "20261130", "9007199254740991"]
    assert SweepAxis("arm.encoder_counts", "list", (0.25, 1.0), relative=True).label(0.25) == "0.25"


@pytest.mark.parametrize(
    ("name", "scale", "values"),
    [
        ("Q_x", "list", (0.0, -0.0)),
        ("arm.coulomb", "choice", ((1, 1, 1, 0), (1.0, 1.0, 1.0, -0.0))),
        ("stiffness", "choice", ((375.0, 810.0), (375, 810))),
        ("reference.z", "choice", (({"kind": "hold", "force": -5},), ({"force": -5.0, "kind": "hold"},))),
    ],
)
def test_what_is_one_value_however_it_is_written_stands_once(name: str, scale: Any, values: tuple[Any, ...]) -> None:
    with pytest.raises(InputError, match="must be free of repetition"):
        make_axis(name, scale, values, None)
