"""The table of quantities: what a run measures, how far a loop is from instability, what a controller is made of.

A row says all that goals, sweeps, tables, reports, freezing and the robot's own checks have to know of a quantity, so
that a new one is written here and where it is computed, nowhere else. No row needs JAX.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from types import MappingProxyType
from typing import Any, Literal, TypeVar

import numpy as np

HP_MAX = 64
"""Longest prediction horizon [samples]; arrays along H_p have this length and are masked."""
HU_MAX = 16
"""Longest control horizon [samples]."""

AXES = ("x", "y", "z")

Sense = Literal["ceiling", "floor", "none"]
SearchRange = tuple[float, float, float]
"""Lowest and highest value, and the change per unit of a search's variable: in the logarithm, or in samples."""


@dataclass(frozen=True)
class Quantity:
    """A number with a name, the same in every file, table and goal."""

    name: str
    unit: str
    """SI; "-" where there is none."""
    text: str
    """A few words that explain it."""
    symbol: str
    """As matplotlib sets it."""
    sense: Sense = "ceiling"
    """How a limit bounds it: from above, from below, or not at all."""
    head: str = ""
    """Its heading in a table, without the unit."""
    shown_unit: str = ""
    """Unit in a table, where that is another one."""
    times: float = 1.0
    """A value times this is in the unit of a table."""
    digits: int = 2
    """Decimals in a table."""

    @property
    def label(self) -> str:
        """Text, symbol and unit, for the axis of a figure."""
        return f"{self.text} {self.symbol} [{self.unit}]"

    @property
    def heading(self) -> str:
        """Heading and unit of a column."""
        unit = self.shown_unit or self.unit
        return f"{self.head or self.name}{'' if unit == '-' else f' [{unit}]'}"

    @property
    def ceiling(self) -> bool:
        """Whether a limit bounds it from above."""
        return self.sense == "ceiling"

    @property
    def sign(self) -> str:
        """How it stands to its limit where that is kept: ≤ or ≥."""
        return "≤" if self.ceiling else "≥"

    def entry(self, value: Any) -> str:
        """A value in a table; – where there is none, ∞ where there is no limit."""
        value = self.times * float(value)
        if math.isnan(value):
            return "–"
        return "∞" if math.isinf(value) else f"{value:.{self.digits}f}"

    def amount(self, value: Any, digits: str = "g") -> str:
        """A value with its unit."""
        unit = {"-": "", "deg": "°"}.get(self.unit, f" {self.unit}")
        return f"{value:{digits}}{unit}"

    def worst(self, values: np.ndarray, axis: int | tuple[int, ...] | None = None) -> Any:
        """The value that is farthest from keeping a limit; NaN where one is."""
        return np.max(values, axis=axis) if self.ceiling else np.min(values, axis=axis)

    def kept(self, value: Any, limit: Any) -> Any:
        """Whether a value keeps a limit; never so where it is not a number."""
        return value <= limit if self.ceiling else value >= limit


@dataclass(frozen=True)
class Metric(Quantity):
    """What a run measures, per tissue and axis."""

    spectral: bool = False
    """Whether a spectrum tells it."""
    crest: float = 1.0
    """Its usual ratio to the residual's RMS, where that stands in for it; a weight, no more."""
    follows: str = "rms"
    """The metric that a spectrum tells and that it grows with, where spectra are corrected by runs."""
    float32_error: float = 0.2
    """Largest relative difference between float32 and float64 of a row's worst value, where M_s ≤ 3, 4 s or more are
    scored and no torque limit acts [-]; see `sweeps.undecided`."""


@dataclass(frozen=True, kw_only=True)
class Parameter(Quantity):
    """What a controller is designed from."""

    sense: Sense = "none"
    bounds: tuple[float, float]
    """Smallest and largest accepted value."""
    search: SearchRange
    """In a search, where nobody says otherwise."""
    search_of_order: Mapping[int, SearchRange] = field(default_factory=dict)
    """The same for an active state of higher order, where that differs."""
    free: bool = True
    """Whether a search moves it unless told otherwise."""
    whole: bool = False
    """Whether it counts samples."""
    entries: int = 0
    """Length of the diagonal that may stand for the number; 0 where none may."""


Row = TypeVar("Row", bound=Quantity)


def _table(*rows: Row) -> Mapping[str, Row]:
    return MappingProxyType({row.name: row for row in rows})


METRICS = _table(
    Metric(
        "rms", "N", "residual force, root mean square", "RMS", "ceiling", "RMS", "mN", 1e3, 1, True, float32_error=0.01
    ),
    # 5.7 to 6.6 times the RMS on Table I's arm.
    Metric("peak_to_peak", "N", "residual force, peak to peak", "pp", "ceiling", "pp", "mN", 1e3, 1, crest=6.0),
    Metric(
        "true_rms",
        "N",
        "true residual, root mean square",
        "true RMS",
        head="true RMS",
        shown_unit="mN",
        times=1e3,
        digits=1,
        spectral=True,
        float32_error=0.01,
    ),
    Metric(
        *("true_peak_to_peak", "N", "true residual, largest span", "true pp", "ceiling", "true pp", "mN", 1e3, 1),
        crest=6.0,
        follows="true_rms",
    ),
    Metric(
        "effort", "m/s²", "acceleration asked of the robot, root mean square", "$a$", spectral=True, float32_error=0.05
    ),
    Metric(
        "chatter",
        "m/s²",
        "its change from sample to sample, root mean square",
        r"$\Delta a$",
        spectral=True,
        float32_error=0.05,
    ),
    Metric("peak_force", "N", "largest force over the whole run", "$|y|$", head="peak force", float32_error=0.05),
    Metric("peak_error", "N", "largest residual force", "$|e|$", "ceiling", "peak error", "mN", 1e3, 1, crest=3.0),
    Metric(
        *("clamped", "-", "share of samples at which a torque limit acted", "clamped", "ceiling", "clamped", "%"),
        times=100.0,
        follows="chatter",
        float32_error=1.0,
    ),
    Metric(
        "joint_torque", "N m", "largest torque wanted of a joint", r"$|\tau|$", head="joint torque", follows="chatter"
    ),
    Metric(
        *("torque_step", "N m", "largest change of it per sample", r"$|\Delta\tau|$"),
        head="torque step",
        follows="chatter",
        float32_error=0.4,
    ),
    Metric(
        *("swing", "N", "true force above 12 Hz", "swing", "ceiling", "swing", "mN", 1e3, 1, True),
        float32_error=0.05,
    ),
)
"""Fields of `jaxmpc.metrics.Metrics`."""

MARGINS = _table(
    Quantity("M_s", "-", "peak sensitivity", "$M_s$"),
    Quantity("gain_margin_db", "dB", "gain increase to instability", "GM", "floor", "GM"),
    Quantity("gain_reduction_db", "dB", "gain decrease to instability", "GR", "floor", "GR"),
    Quantity("phase_margin_deg", "deg", "smallest lag to instability", "PM", "floor", "PM", "°"),
    Quantity("delay_margin_s", "s", "smallest added delay to instability", "DM", "floor", "DM", "ms", 1e3),
    Quantity("spectral_radius", "-", "largest eigenvalue of the closed loop", r"$\rho$", head="radius", digits=4),
)
"""Fields of `jaxmpc.stability.Margins`, but for the status."""
HIGHEST_M_S = 2.0
"""Held by the tuner and promised by a frozen controller unless told otherwise [-]."""
_CUTOFF: SearchRange = (30.0, 3e3, 1.0)


def _array(value: Any) -> Any:
    """Numbers become float64 arrays; what is an array already, traced or not, and what is left open stay so."""
    kept = value is None or (hasattr(value, "dtype") and not np.isscalar(value))
    return value if kept else np.asarray(value, np.float64)


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


PARAMETERS: Mapping[str, Parameter] = _table(
    *(replace(each.metadata["row"], name=each.name) for each in fields(ParameterValues))
)
HORIZONS = tuple(name for name, row in PARAMETERS.items() if row.whole)
FILTERS = ("velocity_cutoff", "force_cutoff")
"""Those that an experiment has too: a controller's own take the place of the experiment's."""
