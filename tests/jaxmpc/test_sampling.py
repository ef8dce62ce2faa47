"""A sampling time at which a guard guards nothing, or a sine has no samples, is refused wherever there is one."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from jaxmpc import Experiment, InputError, Params, design, evaluate, margins
from jaxmpc.export.freezing import freeze_controller
from jaxmpc.law import gain_backoff
from jaxmpc.law.ops import FLOATS
from jaxmpc.stability.family import family_margins, gains_on
from jaxmpc.stability.whole_arm import lost
from jaxmpc.stability.whole_arm_margins import whole_arm_margins
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
