"""What a controller is made of."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from jaxmpc.quantities.row import Parameter, SearchRange, table

HP_MAX = 64
"""Longest prediction horizon [samples]; arrays along H_p have this length and are masked."""
HU_MAX = 16
"""Longest control horizon [samples]."""

_CUTOFF: SearchRange = (30.0, 3e3, 1.0)


def _array(value: Any) -> Any:
    """Numbers become float64 arrays; what is an array already, traced or not, left open or no number stays as it is.

    Arrays of numpy are copied unless nobody can write to them, so that a controller stays what was checked.
    """
    if isinstance(value, np.ndarray):
        return _fixed(value.copy()) if value.flags.writeable else value
    no_number = value is None or isinstance(value, bool | np.bool_ | str | bytes | complex | np.complexfloating)
    if no_number or (hasattr(value, "dtype") and not np.isscalar(value)):
        return value
    try:
        return _fixed(np.array(value, np.float64))
    except (TypeError, ValueError, OverflowError):  # whoever knows its name says so
        return value


def _fixed(array: np.ndarray) -> np.ndarray:
    array.setflags(write=False)
    return array


def _number(default: float | None, unit: str, text: str, symbol: str, **row: Any) -> Any:
    """A field with its row, whose name is the field's; equinox calls the converter."""
    return field(default=default, metadata={"converter": _array, "row": Parameter("", unit, text, symbol, **row)})


@dataclass(eq=False, repr=False)
class ParameterValues:
    """Numbers of `jaxmpc.Params` with the text design's values; each with its row of `PARAMETERS`.

    δ and R only set the scales of λ and Q, so that a search leaves them alone; the filters stay the experiment's.
    """

    lam: Any = _number(
        *(0.1, "-", "weight on moves", "λ"), bounds=(1e-12, 1e12), search=(1e-4, 1e3, 1.0), entries=HU_MAX
    )
    """λ, weight on the moves of the MPC [-]: one number, or a diagonal of `HU_MAX`, an entry for every move."""
    delta: Any = _number(
        *(0.9, "-", "weight on errors", "δ"), bounds=(0.0, 1e12), search=(1e-3, 1e3, 1.0), entries=HP_MAX, free=False
    )
    """δ, weight on the predicted force errors [-]: one number, or a diagonal of `HP_MAX`, an entry for every error."""
    Q_p: Any = _number(
        *(0.5, "(m/s²)²/N²", "variance of the active state", "$Q_p$"),
        bounds=(1e-12, 1e12),
        search=(1e-2, 1e3, 1.0),
        # Differences of higher order are smaller by a factor of some 1e-3 each.
        search_of_order={2: (1e-9, 1e1, 2.0), 3: (1e-12, 1e-1, 3.0)},
    )
    """Variance of the active state's N-th differences, its increments for N = 1, relative to R [(m/s²)²/N²]."""
    Q_x: Any = _number(1e-12, "-", "variance of the states", "$Q_x$", bounds=(0.0, 1e12), search=(1e-14, 1e2, 3.0))
    """Variance of each state's process noise, relative to R [-]."""
    R: Any = _number(
        *(1.0, "-", "variance of the measurement", "$R$"), bounds=(1e-12, 1e12), search=(1e-3, 1e3, 1.0), free=False
    )
    """Variance of the force measurement [-]; only Q/R matters."""
    T_cl: Any = _number(
        3e-3, "s", "closed-loop time constant", "$T_{cl}$", bounds=(1e-6, 10.0), search=(1e-4, 2e-2, 1.0)
    )
    """Time constant of the wanted closed loop [s]; below the sampling time is allowed and useful."""
    K2: Any = _number(10.0, "1/s", "damping", "$K_2$", bounds=(0.0, 1e4), search=(1.0, 100.0, 1.0))
    """Damping of the tip velocity [1/s]."""
    Khat_s: Any = _number(
        *(900.0, "N/m", "stiffness assumed", r"$\hat{K}_s$"), bounds=(1.0, 1e6), search=(100.0, 4000.0, 1.0)
    )
    """Tissue stiffness that the design assumes [N/m]."""
    Hp: Any = _number(
        *(30.0, "samples", "prediction horizon", "$H_p$"), bounds=(1, HP_MAX), search=(2.0, HP_MAX, 10.0), whole=True
    )
    """Prediction horizon [samples]; whole numbers, but for a tuner on its way to one."""
    Hu: Any = _number(
        *(5.0, "samples", "control horizon", "$H_u$"), bounds=(1, HU_MAX), search=(1.0, HU_MAX, 3.0), whole=True
    )
    """Control horizon [samples]."""
    velocity_cutoff: Any = _number(
        *(None, "rad/s", "cut-off of the velocity filter", r"$\omega_v$"), bounds=(1.0, 1e5), search=_CUTOFF, free=False
    )
    """Cut-off of the low-pass on the measured velocity [rad/s]; None is the experiment's, `velocity_lowpass`."""
    force_cutoff: Any = _number(
        *(None, "rad/s", "cut-off of the force filter", r"$\omega_y$"), bounds=(1.0, 1e4), search=_CUTOFF, free=False
    )
    """Natural frequency of the Kalman filter on the measured force [rad/s]; None is the experiment's, if it has one."""


PARAMETERS: Mapping[str, Parameter] = table(
    *(replace(each.metadata["row"], name=each.name) for each in fields(ParameterValues))
)
HORIZONS = tuple(name for name, row in PARAMETERS.items() if row.whole)
FILTERS = ("velocity_cutoff", "force_cutoff")
"""Those that an experiment has too: a controller's own take the place of the experiment's."""
