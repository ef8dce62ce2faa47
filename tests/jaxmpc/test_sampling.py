"""A sampling time at which a guard guards nothing, or a sine has no samples, is refused wherever there is one."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from msgspec.structs import replace

from jaxmpc import Experiment, InputError, Params, design, evaluate, margins
from jaxmpc.export.freezing import freeze_controller
from jaxmpc.law import gain_backoff
from jaxmpc.law.ops import FLOATS
from jaxmpc.stability.family import family_margins, gains_on
from jaxmpc.stability.loop import closed_loop_matrix, contact_of
from jaxmpc.stability.whole_arm import lost
from jaxmpc.stability.whole_arm_margins import whole_arm_margins
from jaxmpc.status import Status
from jaxmpc.synthesis.listening import Listening
from jaxmpc.synthesis.sampling import SLOWEST_GUARDED, check_sampling
from jaxmpc.synthesis.timing import Timing
from jaxmpc.world.loop_path import loop_path
from tuning.trials.drawn import Job

FAMILY = Params.published("family")
SLOW = replace(Experiment.published("table-1-wam"), sampling_time=0.015, stiffness=(810.0,))
PATH = loop_path(0.015)


@pytest.mark.parametrize(
    "used",
    [
        lambda: design(FAMILY, Timing(0.015)),
        lambda: margins(FAMILY, 810.0, path=PATH),
        lambda: family_margins(FAMILY, [810.0], [1.0], PATH),
        lambda: gains_on(FAMILY, [810.0], PATH),
        lambda: evaluate(FAMILY, SLOW),
        lambda: whole_arm_margins(FAMILY, SLOW),
        lambda: lost(FAMILY, [SLOW]),
        lambda: Job((FAMILY,), SLOW),
        lambda: freeze_controller(Path("none.npz"), FAMILY, SLOW, {}, ideal=False),
    ],
)
def test_a_slow_guard_is_refused_before_anything_runs(used: Callable[[], Any]) -> None:
    with pytest.raises(
        InputError, match=r"guarded = True: must be false at a sampling time above 0\.005 s \(= 0\.015\)"
    ):
        used()


def swung(T_s: float) -> float:
    """Least gain of a guard that meets a second of a swing of 30 Hz and 3 N."""
    guard, state, least = gain_backoff.constants(T_s, FLOATS), gain_backoff.init(), 1.0
    for k in range(round(1.0 / T_s)):
        error = 3.0 * math.sin(2.0 * math.pi * 30.0 * T_s * k + 0.3)
        state = gain_backoff.step(guard, state, (error,) * 3, FLOATS)
        least = min(least, state.memory.gain)
    return least


def test_a_guard_that_is_not_refused_takes_the_gain_back() -> None:
    assert swung(SLOWEST_GUARDED) < 0.1
    check_sampling(Params(guarded=True), SLOWEST_GUARDED)
    assert swung(0.015) > 0.9


@pytest.mark.parametrize(
    ("hertz", "T_s", "heard"), [(100.0, 0.0025, True), (100.0, 0.0026, False), (17.0, 0.015, False)]
)
def test_the_sine_has_four_samples_in_a_period(hertz: float, T_s: float, heard: bool) -> None:
    listening = Params(listening=Listening((375.0,), frequency=hertz), knots=(Params(),))
    if heard:
        check_sampling(listening, T_s)
        return
    with pytest.raises(InputError, match="4 samples a period") as refused:
        check_sampling(listening, T_s)
    assert refused.value.key == "listening.frequency"


def test_a_time_in_an_array_is_known_inside_a_program() -> None:
    T_s = jnp.asarray(0.015)

    def designed(x: Any) -> Any:
        with pytest.raises(InputError, match="guarded"):
            check_sampling(FAMILY, T_s)
        return x

    assert jax.jit(designed)(1.0) == 1.0


@pytest.mark.oracle
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("T_s", [1e-4, 2e-4])
def test_no_instability_is_missed_at_the_quickest_sampling(order: Any, T_s: float) -> None:
    """Down to the least `Q_p`, whose observers are slow; the loop's gain is lowered at v and at a = v − K₂ẋ."""
    random, n = np.random.default_rng(1), 80
    columns = {
        "Q_p": np.geomspace(1e-12, 1e-2, n),
        "K2": np.exp(random.uniform(-3.9, 3.9, n)),
        "Khat_s": random.uniform(300.0, 2500.0, n),
        "T_cl": np.exp(random.uniform(np.log(2e-3), np.log(0.3), n)),
    }
    batch, path = Params(disturbance_order=order).with_columns(columns), loop_path(T_s)
    found, gains = margins(batch, 810.0, path=path), design(batch, Timing(T_s))
    told = np.asarray(found.gain_reduction_db)
    lowered = 10.0 ** (-np.where(np.isfinite(told), 0.98 * told, 40.0) / 20.0)

    def loop(own: Any, K2: Any, gain: Any, at_a: Any) -> Any:
        contact = contact_of(810.0 * gain, K2, path)
        return closed_loop_matrix(own, contact._replace(K2=jnp.where(at_a, gain, 1.0) * contact.K2))

    loops = jax.jit(jax.vmap(jax.vmap(loop, (0, 0, 0, None)), (None, None, None, 0)))
    matrices = np.asarray(loops(gains, batch.K2, lowered, jnp.array([False, True])))
    radii = np.abs(np.linalg.eigvals(matrices)).max(axis=(0, -1))
    stable = np.asarray(found.status) == Status.OK
    assert stable.sum() > 10
    assert (radii[stable] <= 1.0 + 1e-9).all()


def test_sampling_quicker_than_the_least_is_refused() -> None:
    with pytest.raises(InputError, match="sampling_time"):
        Experiment.from_dict({"sampling_time": 5e-5})
