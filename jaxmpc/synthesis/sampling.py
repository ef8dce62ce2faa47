"""Which parts of a controller a sampling time leaves without effect, told before anything is designed."""

from typing import Any

import jax
import numpy as np

from jaxmpc.files.errors import InputError
from jaxmpc.synthesis.params import Params

SLOWEST_GUARDED = 5e-3
"""Longest sampling time of a guarded controller [s]: a swing of 30 Hz and 3 N still takes the gain to its least there,
at 10 ms to a third, and at 15 ms no swing takes any."""
LEAST_PER_PERIOD = 4.0
"""Samples of a period of the sine that listens, at least [-]: the lock-in divides by 1 − cos of the angle between
two, which is 0 where they are a period apart."""


def check_sampling(params: Params, T_s: Any) -> None:
    """Refuse a controller of which a part would do nothing, or divide by zero, at a sampling time.

    Args:
        params: One controller or a batch.
        T_s: Sampling time [s]; a traced one passes, whoever traces has asked before.

    Raises:
        InputError: It is guarded and sampled too slowly, or listens with a sine that is too quick for the samples.
    """
    if isinstance(T_s, jax.core.Tracer):
        return
    # Inside a program JAX's own maximum of an array that is known would be a traced one.
    slowest = float(np.asarray(T_s).max())
    if params.guarded and slowest > SLOWEST_GUARDED:
        bound = f"false at a sampling time above {SLOWEST_GUARDED:g} s (= {slowest:g})"
        raise InputError("guarded", True, bound, "Sample faster: so slow a guard sees no swing.")
    quickest = 1.0 / (LEAST_PER_PERIOD * slowest)
    if params.listening is not None and params.listening.frequency > quickest * (1.0 + 1e-9):
        bound = f"at most {quickest:g} Hz at a sampling time of {slowest:g} s, {LEAST_PER_PERIOD:g} samples a period"
        raise InputError("listening.frequency", params.listening.frequency, bound, "Lower it or sample faster.")
