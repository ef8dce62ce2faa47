"""Labels and ticks that the figures of a sweep share."""

from typing import Any

from jaxmpc.quantities import MARGINS

WORST_RMS = "worst-case residual RMS [N]"
WORST_M_S = f"worst-case {MARGINS['M_s'].label}"


def plain_ticks(which: Any) -> None:
    """Numbers as people write them on a logarithmic axis that may span less than a decade."""
    from matplotlib.ticker import FuncFormatter, LogLocator

    which.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    which.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    which.set_minor_formatter("")
