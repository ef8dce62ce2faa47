"""Parameters that are built in Python: of whatever holds numbers, and kept as they were checked."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmpc import InputError, Params
from jaxmpc.quantities import HU_MAX
from jaxmpc.synthesis.listening import Listening
from sweeps import SweepSpec
from tuning import TuneSpec

BATCH = Params.stack([Params(), Params(lam=0.3)])


@pytest.mark.parametrize(
    "values",
    [
        {"lam": np.float64(0.2), "Hp": np.int64(20)},
        {"lam": np.array(0.2), "Hp": jnp.asarray(20)},
        {"lam": np.full(HU_MAX, 0.2), "Hp": 20},
        {"lam": np.array([0.2, 0.2]), "Hp": 20, "disturbance_order": np.int64(1), "guarded": np.False_},
        {"lam": jnp.full(HU_MAX, 0.2, float), "Hp": 20},
    ],
)
def test_plain_values_may_be_arrays_and_their_numbers(values: dict[str, Any]) -> None:
    found = Params.from_dict(values)
    assert np.ravel(found.lam) == pytest.approx(0.2)
    assert found.Hp == 20.0
    assert np.asarray(found.lam).dtype == np.float64


def test_knots_may_be_arrays_too() -> None:
    table = Params.published("family").to_dict()
    knots = [{name: np.float64(value) for name, value in knot.items()} for knot in table["knots"]]
    listening = {**table["listening"], "stiffness": np.array(table["listening"]["stiffness"])}
    assert Params.from_dict({**table, "knots": knots, "listening": listening}).to_dict() == table


@pytest.mark.parametrize(
    "value",
    [
        *("0.1", b"0.1", np.str_("0.1"), 1j, np.complex64(1.0), 10**400),
        *(np.array("0.1"), np.array(1 + 5j), jnp.asarray(1j), np.array(None), np.array(["a"] * HU_MAX)),
    ],
    ids=lambda value: f"{value!r:.20}",
)
def test_what_is_no_real_number_is_told_by_its_name(value: Any) -> None:
    for build in (lambda: Params(lam=value), lambda: Params.from_dict({"lam": value})):
        with pytest.raises(InputError, match=r"^lam = .*: must be a number"):
            build()


def test_what_is_traced_has_no_value_that_plain_data_could_be() -> None:
    with pytest.raises(InputError, match=r"^lam = .*: must be a number"):
        jax.jit(lambda lam: Params.from_dict({"lam": lam}).lam)(0.1)
    assert jax.jit(lambda lam: Params(lam=lam).lam)(0.1) == np.float32(0.1)


@pytest.mark.parametrize("key", [3, None, ("lam", "delta")])
@pytest.mark.parametrize(
    "read",
    [
        Params.from_dict,
        lambda table: Params.from_dict({"knots": [table]}),
        Params().with_columns,
        lambda table: TuneSpec.from_dict({"tune": {"free": table}}),
        TuneSpec.from_dict,
        SweepSpec.from_dict,
    ],
)
def test_a_key_that_is_no_text_is_told(read: Callable[[Any], Any], key: Any) -> None:
    with pytest.raises(InputError) as caught:
        read({key: 0.1})
    assert f"{caught.value}".removeprefix("tune.free.").startswith(f"{key} = ")


@pytest.mark.parametrize("column", [["a", "b"], ["1", "2"], [1j, 2j], [[0.1], [0.2, 0.3]], [None, 1.0]])
def test_a_column_of_something_else_is_told_by_its_name(column: Any) -> None:
    with pytest.raises(InputError, match=r"^lam = .*: must be numbers"):
        Params().with_columns({"lam": column})


@pytest.mark.parametrize("build", [Params, lambda lam: replace(Params(), lam=lam)])
def test_a_controller_stays_what_was_checked(build: Callable[..., Params]) -> None:
    lam = np.full(HU_MAX, 0.1)
    built = build(lam=lam)
    lam *= -1.0
    assert np.all(np.asarray(built.lam) == 0.1)
    columns = {"lam": np.array([0.1, 0.2])}
    batch = Params().with_columns(columns)
    columns["lam"] *= -1.0
    assert np.asarray(batch.lam).tolist() == [0.1, 0.2]
    for value in (built.lam, built.K2, batch.lam):
        with pytest.raises(ValueError, match="read-only"):
            value[...] = -1.0


def test_rows_are_counted_by_numbers_of_numpy_too() -> None:
    for batch in (BATCH, jax.tree.map(jnp.asarray, BATCH)):
        assert float(batch[np.int64(1)].lam) == float(batch[np.int64(-1)].lam) == 0.3
        with pytest.raises(IndexError, match="row 2 of a batch of 2"):
            batch[np.int64(2)]


@pytest.mark.parametrize("rows", [3, HU_MAX])
def test_batches_with_numbers_and_with_diagonals_are_stacked_row_by_row(rows: int) -> None:
    """As many rows as a diagonal has entries were spread along it."""
    numbers = Params().with_columns({"lam": np.geomspace(0.01, 1.0, rows)})
    diagonals = Params().with_columns({"lam": np.full((rows, HU_MAX), 0.1)})
    lam = np.asarray(Params.stack([numbers, diagonals]).lam)
    assert lam.shape == (2, rows, HU_MAX)
    assert np.array_equal(lam[0], np.repeat(np.asarray(numbers.lam)[:, None], HU_MAX, axis=1))
    assert np.all(lam[1] == 0.1)


def test_whatever_can_be_gone_through_is_stacked() -> None:
    assert np.asarray(Params.stack(Params(lam=lam) for lam in (0.1, 0.2)).lam).tolist() == [0.1, 0.2]
    with pytest.raises(InputError, match="batch = text: must be a list of Params"):
        Params.stack([Params(), "text"])  # type: ignore[list-item]  # on purpose


@pytest.mark.parametrize(
    ("name", "given", "kept"),
    [
        *[("disturbance_order", given, 2) for given in (np.int64(2), np.uint8(2), np.array(2))],
        *[("designed_delay", given, 2) for given in (np.int32(2), jnp.asarray(2))],
        *[("guarded", given, True) for given in (np.True_, np.array(True), jnp.asarray(True))],
        ("architecture", np.str_("aob"), "aob"),
    ],
)
@pytest.mark.filterwarnings("error")
def test_what_is_no_number_to_be_tuned_may_be_numpys_too(name: str, given: Any, kept: Any) -> None:
    built, usual = Params(**{name: given}), Params(**{name: kept})
    assert type(getattr(built, name)) is type(kept)
    assert built.structure == usual.structure
    assert built.to_dict() == usual.to_dict() == Params.from_dict({name: given}).to_dict()
    assert jax.tree.structure(built) == jax.tree.structure(usual)


@pytest.mark.parametrize("value", [2.0, np.float64(2.0), True, np.True_, np.array([2]), "2", None, 4, np.int64(-1)])
@pytest.mark.parametrize("name", ["disturbance_order", "designed_delay"])
def test_what_is_no_whole_number_stays_refused(name: str, value: Any) -> None:
    with pytest.raises(InputError, match=rf"^{name} = "):
        Params(**{name: value})


def test_listening_takes_numbers_of_numpy_and_keeps_pythons() -> None:
    given = Listening(jnp.array([375.0, 810.0]), amplitude=np.float32(0.25), harmonics=np.int64(3))  # type: ignore[arg-type]  # on purpose
    assert given == Listening((375.0, 810.0), amplitude=0.25, harmonics=3)
    assert given.to_dict() == {**Listening((375.0, 810.0)).to_dict(), "amplitude": 0.25, "harmonics": 3}
    assert {type(value) for value in given.to_dict().values()} == {list, float, int}
    for wrong in ({"harmonics": 2.5}, {"harmonics": True}, {"amplitude": np.nan}, {"amplitude": np.True_}):
        with pytest.raises(InputError, match=rf"^listening\.{next(iter(wrong))} = "):
            Listening((375.0, 810.0), **wrong)  # type: ignore[arg-type]  # on purpose


@pytest.mark.parametrize("batch", [[], None, 3, "text", Params()])
def test_what_is_no_batch_is_told(batch: Any) -> None:
    with pytest.raises(InputError, match=r"^batch = .*: must be a list of Params"):
        Params.stack(batch)
