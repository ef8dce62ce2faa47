"""Loops that tests of margins judge, and their margins at one cut."""

from dataclasses import replace
from functools import partial
from typing import Any

import jax
import numpy as np

from jaxmpc import Params
from jaxmpc.stability.crossings import loop_margins
from jaxmpc.stability.loop import contact_of
from jaxmpc.stability.response import loop_response
from jaxmpc.synthesis import design_one
from jaxmpc.world.contact import hertz
from jaxmpc.world.loop_path import loop_path

T_S = 1e-3
SENSOR = hertz(500.0)
TUNED = Params(K2=100.0, Khat_s=970.0, Q_p=10.0, T_cl=2e-4)
RAMP = Params(K2=40.0, Khat_s=550.0, Q_p=1e-6, T_cl=2e-4, disturbance_order=2)
PARABOLA = Params(K2=40.0, Khat_s=550.0, Q_p=1e-9, T_cl=2e-4, disturbance_order=3)
CLASSICAL = Params(architecture="mpc", Q_p=1e3, Hp=60, Hu=10)
LATE = [
    (Params(designed_delay=2), 810.0, 2, True),
    (Params.from_dict({**Params.published("cautious").to_dict(), "designed_delay": 2}), 1900.0, 2, False),
    (Params(K2=40.0, Khat_s=550.0, Q_p=1e-9, disturbance_order=3, designed_delay=2), 600.0, 2, False),
    (Params(architecture="aob", designed_delay=2), 810.0, 1, False),
    (Params(architecture="mpc", Q_p=1e3, Hp=60, Hu=10, designed_delay=2), 600.0, 2, False),
]
"""Designed for two samples of delay."""
CASES = [
    (Params(), 375.0, 1, True),
    (Params(), 810.0, 2, True),
    (Params(), 1900.0, 1, False),
    (Params.published("printed"), 1200.0, 1, False),
    (TUNED, 1900.0, 1, False),
    (TUNED, 375.0, 1, True),
    (RAMP, 600.0, 1, False),
    (Params(architecture="aob"), 810.0, 1, False),
    (CLASSICAL, 810.0, 1, True),
]
PARABOLIC = (PARABOLA, 600.0, 2, False)


@partial(jax.jit, static_argnames="ideal")
def cut_margins(params: Params, K_s: Any, delay: Any, ideal: bool, cut: Any) -> Any:
    gains, _ = design_one(params, T_S)
    contact = contact_of(K_s, params.K2, replace(loop_path(ideal=ideal), delay=delay))

    def loop(theta: Any, late: Any = None) -> Any:
        return loop_response(gains, contact, theta, cut, late)

    return loop_margins(loop, loop, T_S)


def radius(A: np.ndarray) -> float:
    return float(np.abs(np.linalg.eigvals(A)).max())
