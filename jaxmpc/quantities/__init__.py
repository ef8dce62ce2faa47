"""The table of quantities: what a run measures, how far a loop is from instability, what a controller is made of.

A row says all that goals, sweeps, tables, reports, freezing and the robot's own checks have to know of a quantity, so
that a new one is written here and where it is computed, nowhere else. No row needs JAX.
"""

from jaxmpc.quantities.limits import check_limit
from jaxmpc.quantities.measured import FLOOR_FLAGS, HIGHEST_M_S, MARGINS, METRICS
from jaxmpc.quantities.parameters import FILTERS, HORIZONS, HP_MAX, HU_MAX, PARAMETERS, ParameterValues
from jaxmpc.quantities.row import Metric, Parameter, Quantity, SearchRange, Sense

__all__ = [
    "AXES",
    "FILTERS",
    "FLOOR_FLAGS",
    "HIGHEST_M_S",
    "HORIZONS",
    "HP_MAX",
    "HU_MAX",
    "MARGINS",
    "METRICS",
    "PARAMETERS",
    "Metric",
    "Parameter",
    "ParameterValues",
    "Quantity",
    "SearchRange",
    "Sense",
    "check_limit",
]

AXES = ("x", "y", "z")
