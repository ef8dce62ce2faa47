"""The scalar functions of law and world on numpy's arrays, for what is computed once for every sample or pose."""

from typing import Any

import numpy as np

from jaxmpc.law.ops import FLOATS, Ops


class _Arrays:
    """The functions on numpy's arrays."""

    sin: Any = np.sin
    cos: Any = np.cos
    sqrt: Any = np.sqrt
    exp: Any = np.exp
    log: Any = np.log
    floor: Any = np.floor
    minimum: Any = np.minimum
    maximum: Any = np.maximum
    clip: Any = staticmethod(np.clip)
    where: Any = staticmethod(np.where)
    near: Any = staticmethod(FLOATS.near)
    replaced: Any = staticmethod(FLOATS.replaced)


ARRAYS: Ops = _Arrays()
