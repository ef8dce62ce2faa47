"""Words, symbols and ticks that the figures of a sweep share."""

from typing import Any

SYMBOLS = {
    "lam": "λ",
    "delta": "δ",
    "Q_p": "$Q_p$",
    "Q_x": "$Q_x$",
    "R": "$R$",
    "T_cl": "$T_{cl}$",
    "K2": "$K_2$",
    "Khat_s": r"$\hat{K}_s$",
    "Hp": "$H_p$",
    "Hu": "$H_u$",
}
TEXTS = {
    "lam": "weight on moves",
    "delta": "weight on errors",
    "Q_p": "variance of the active state",
    "Q_x": "variance of the states",
    "R": "variance of the measurement",
    "T_cl": "closed-loop time constant",
    "K2": "damping",
    "Khat_s": "stiffness assumed",
    "Hp": "prediction horizon",
    "Hu": "control horizon",
}
WORST_RMS = "worst-case residual RMS [N]"
WORST_M_S = "worst-case peak sensitivity $M_s$ [-]"


def plain_ticks(which: Any) -> None:
    """Numbers as people write them on a logarithmic axis that may span less than a decade."""
    from matplotlib.ticker import FuncFormatter, LogLocator

    which.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    which.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    which.set_minor_formatter("")
