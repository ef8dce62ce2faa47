"""What numbers a controller, or a batch of them, may be built of in Python."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmpc import Experiment, InputError, Params, Status, design, evaluate, margins
from jaxmpc.quantities import HP_MAX
from jaxmpc.synthesis.listening import Listening
from jaxmpc.synthesis.timing import Timing
from jaxmpc.world.loop_path import loop_path

BATCH = Params.stack([Params(), Params()])
BEYOND = np.where(np.arange(HP_MAX) < 30, 0.0, 0.9)
"""Weights on errors beyond the default H_p alone."""
FIRST = np.where(np.arange(HP_MAX) < 1, 0.9, 0.0)
"""A weight on the first error alone, which no command of MPC alone changes."""


@pytest.mark.parametrize(
    ("values", "key"),
    [
        ({"lam": jnp.asarray(-0.1)}, "lam"),
        ({"K2": -1.0, "Khat_s": jnp.asarray(900.0)}, "K2"),
        ({"K2": float("nan"), "Khat_s": jnp.asarray(900.0)}, "K2"),
        ({"Hu": jnp.asarray(15.0), "Hp": 3}, "Hu"),
        ({"Hp": jnp.asarray(3.5)}, "Hp"),
        ({"delta": jnp.zeros(HP_MAX)}, "delta"),
        ({"delta": BEYOND, "Hp": 30}, "delta"),
        ({"delta": jnp.asarray(BEYOND)}, "delta"),
        ({"architecture": "mpc", "Hp": 1, "Hu": 1}, "Hp"),
        ({"architecture": "mpc", "delta": FIRST, "Hp": 30}, "delta"),
        ({"architecture": "mpc", "delta": jnp.asarray(FIRST)}, "delta"),
        ({"Khat_s": np.array([500.0, 900.0])}, "Khat_s"),
        ({"K2": [10.0, 20.0]}, "K2"),
        ({"lam": [0.1, 0.2]}, "lam"),
        ({"K2": None}, "K2"),
        ({"K2": "fast"}, "K2"),
        ({"K2": np.True_}, "K2"),
        ({"Hu": True}, "Hu"),
        ({"Hu": jnp.asarray(True)}, "Hu"),
        ({"lam": [0.1, "a"]}, "lam"),
        ({"delta": {"first": 0.9}}, "delta"),
        ({"listening": 3}, "listening"),
        ({"knots": 3}, "knots"),
        ({"knots": (3,), "listening": Listening((375.0,))}, "knots"),
        ({"knots": (BATCH,), "listening": Listening((375.0,))}, "knots"),
    ],
)
def test_no_controller_has_such_numbers(values: dict[str, Any], key: str) -> None:
    with pytest.raises(InputError) as refused:
        Params(**values)
    assert refused.value.key == key


@pytest.mark.parametrize(
    "stiffness",
    [375.0, None, "375", ("375",), (True,), (), (810.0, 810.0), (810.0, 810.1), [[375.0, 550.0]], np.eye(2)],
)
def test_no_family_has_such_stiffnesses(stiffness: Any) -> None:
    with pytest.raises(InputError) as refused:
        Listening(stiffness)
    assert refused.value.key == "listening.stiffness"


@pytest.mark.parametrize("stiffness", [[375.0, 550.0], (375, 550), np.array([375.0, 550.0])])
def test_any_sequence_of_stiffnesses_is_one_of_floats(stiffness: Any) -> None:
    assert Listening(stiffness) == Listening((375.0, 550.0))
    assert hash(Listening(stiffness)) == hash(Listening((375.0, 550.0)))


@pytest.mark.parametrize("T_s", ["1", None, True, [1e-3], np.array([1e-3]), 1.0, float("nan")])
def test_no_controller_samples_so(T_s: Any) -> None:
    with pytest.raises(InputError, match=r"T_s = .*: must be in \[1e-4, 0\.1\] s"):
        Timing(T_s=T_s)


@pytest.mark.parametrize("delay", [True, np.True_, 1.5, 3, "1", None, [1], np.array([1, 2])])
def test_no_loop_is_late_by_such(delay: Any) -> None:
    for late in (loop_path, Timing, lambda delay: margins(Params(), 810.0, delay=delay)):
        with pytest.raises(InputError, match=r"delay = .*: must be 1 or 2 samples"):
            late(delay=delay)
    with pytest.raises(InputError, match="delay"):
        _ = Experiment(delay=delay).within_bounds


@pytest.mark.parametrize("delay", [1, 2.0, np.int64(2), np.array(1)])
def test_whole_numbers_of_samples_are_taken_of_any_kind(delay: Any) -> None:
    assert float(loop_path(delay=delay).delay) == float(Timing(delay=delay).delay) == delay


def test_what_is_known_is_checked_beside_what_is_traced() -> None:
    def built(lam: Any, **values: Any) -> Any:
        return Params(lam=lam, **values).lam

    assert jax.jit(built)(-1.0) == jax.grad(built)(-1.0) * -1.0 == -1.0
    assert jax.vmap(built)(jnp.arange(3.0)).shape == (3,)
    for values in ({"K2": -1.0}, {"Hp": 3, "Hu": 5}, {"K2": np.ones(2)}):
        with pytest.raises(InputError):
            jax.jit(lambda lam, values=values: built(lam, **values))(0.1)


def test_weights_within_the_horizon_of_each_controller_count() -> None:
    assert np.asarray(Params(delta=BEYOND, Hp=31).delta)[30] == 0.9
    with pytest.raises(InputError, match=r"delta = 0\.0: must be positive somewhere within Hp \(= 20\)"):
        Params(delta=BEYOND, Hp=40).with_columns({"Hp": [40, 20]})


def test_mpc_alone_has_to_see_what_its_commands_do() -> None:
    """Its prediction holds the delay of a command, so that with H_p = 1 all its gains were 0."""
    alone = Params(architecture="mpc", Hp=2, Hu=1)
    assert np.asarray(design(alone).mpc_ref).any()
    assert np.asarray(design(Params(Hp=1, Hu=1)).mpc_ref).any()
    with pytest.raises(InputError, match="Hp = 1: must be at least 2 with the architecture 'mpc'"):
        alone.with_columns({"Hp": [2, 1]})
    unchecked = jax.jit(lambda Hp: margins(replace(alone, Hp=Hp), 810.0).status)
    assert unchecked(1.0) == Status.ILL_POSED != unchecked(2.0)


def test_shapes_and_other_marks_may_stand_for_numbers() -> None:
    shapes = jax.eval_shape(lambda: Params(K2=jnp.asarray(1.0)))
    assert replace(shapes, Hu=2).Hu == 2
    marks = jax.tree.map(lambda _: object(), Params())
    assert len({id(mark) for mark in jax.tree.leaves(marks)}) == len(Params().numbers)


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        (
            lambda: replace(BATCH, K2=20.0),
            r"K2 = an array of the shape \(\): must be of the shape \(2,\).* with_columns",
        ),
        (lambda: BATCH.with_columns({"lam": [1.0, 2.0]}), r"a batch \(2,\): must be one controller"),
        (lambda: Params().with_columns({"Hu": [True, True]}), r"Hu = \[True, True\]: must be numbers"),
        (lambda: list(Params()), "one controller: must be a batch"),
        (lambda: Params.stack(Params()), "one Params: must be a list of Params"),
        (lambda: Params.stack([]), "empty: must be a list of Params"),
        (lambda: margins(Params(), []), "stiffness = none: must be at least one"),
        (lambda: margins(Params(), True), "stiffness = True: must be a number"),
        (lambda: margins(Params(), "810"), "stiffness = 810: must be a number"),
        (lambda: margins(BATCH[2:], 810.0), "params = an empty batch: must be at least one controller"),
        (lambda: evaluate(BATCH[2:], Experiment()), "params = an empty batch: must be at least one controller"),
        (lambda: Params.stack([BATCH, Params.stack([Params()] * 3)]), "must be of one shape"),
    ],
)
def test_what_is_no_batch_is_told(wrong: Callable[[], Any], says: str) -> None:
    with pytest.raises(InputError, match=says):
        wrong()


def test_a_batch_ends_where_its_rows_do() -> None:
    for batch in (BATCH, jax.tree.map(jnp.asarray, BATCH)):
        assert [float(one.K2) for one in batch] == [10.0, 10.0]
        assert float(batch[-1].K2) == 10.0
        with pytest.raises(IndexError, match="row 2 of a batch of 2"):
            batch[2]


@pytest.mark.parametrize("transform", [jax.grad, jax.jit, jax.vmap])
def test_programs_of_32_bits_are_told_to_switch_64_on(transform: Callable[..., Any]) -> None:
    def peak(params: Params) -> Any:
        return margins(params, 810.0).M_s

    params = BATCH if transform is jax.vmap else Params()
    with jax.enable_x64(False):
        assert np.asarray(peak(params)).dtype == np.float64
        with pytest.raises(InputError, match="jax_enable_x64 = False: must be on"):
            transform(peak)(params)
    jax.eval_shape(transform(peak), params)
