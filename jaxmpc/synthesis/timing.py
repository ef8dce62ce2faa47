"""When the controller samples, and when its commands act."""

import math
from dataclasses import dataclass
from numbers import Real

import jax
import numpy as np

from jaxmpc.files.errors import InputError
from jaxmpc.world.loop_path import check_delay


@dataclass(frozen=True)
class Timing:
    """Sampling of the controller.

    Attributes:
        T_s: Sampling time [s].
        delay: Samples between a command and its effect, 1 or 2; the design assumes `Params.designed_delay` [samples].
    """

    T_s: float = 1e-3
    delay: int = 1

    def __post_init__(self) -> None:
        number = isinstance(self.T_s, Real | np.ndarray | jax.Array) and not isinstance(self.T_s, bool)
        if not (number and np.ndim(self.T_s) == 0 and math.isfinite(self.T_s) and 1e-4 <= self.T_s <= 0.1):
            raise InputError("T_s", self.T_s, "in [1e-4, 0.1] s", "The paper's controller runs at 1e-3.")
        check_delay(self.delay)
