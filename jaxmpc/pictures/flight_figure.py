"""A flight of a controller that finds the tissue's stiffness first, in one look."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from jaxmpc.pictures.experiment_figures import COLOURS
from jaxmpc.pictures.figures import ACCENT, BASELINE, TUNED, figure, outline
from jaxmpc.quantities import AXES


def flight_figure(
    path: Path,
    time: np.ndarray,
    signals: Mapping[str, np.ndarray],
    stiffness: float,
    before: tuple[np.ndarray, np.ndarray],
    settle: float,
) -> None:
    """Force error, believed stiffness, authority and sine over the time in contact.

    Args:
        path: Where it goes.
        time: Since contact (n,) [s].
        signals: Of a flight recording, (n, width).
        stiffness: Of the tissue [N/m].
        before: Time (m,) [s] and force error on Z (m,) [N] of another controller, to compare with.
        settle: When scoring begins [s].
    """
    error = 1e3 * (signals["force"] - signals["force_ref"])
    scored = time >= settle
    old_time, old = before
    with figure(path, rows=3, size=(8.0, 6.4)) as axes:
        left, believed, share = axes
        for t, x, counts, label, colour in (
            (old_time, 1e3 * old, old_time >= settle, "paper's text design, simulated", BASELINE),
            (time, error[:, 2], scored, "this flight", TUNED),
        ):
            rms = np.sqrt(np.nanmean(x[counts] ** 2))
            left.plot(*outline(t, x), color=colour, lw=0.7, label=f"{label}: RMS {rms:.0f} mN")
        bound = 1.5 * np.nanmax(np.abs(1e3 * old[old_time >= settle]))
        left.set_ylim(-bound, bound)
        left.set_ylabel("force error Z [mN]")
        left.set_title(f"A flight over a beating heart, $K_s$ = {stiffness:g} N/m (shaded: not scored)", loc="left")
        left.legend(ncols=2, loc="upper right")
        for axis, colour in enumerate(COLOURS):
            believed.plot(time, signals["stiffness"][:, axis], color=colour, lw=1.0, label=AXES[axis].upper())
        believed.axhline(stiffness, color="black", lw=0.8, ls="--", label="true")
        believed.set_ylabel("$\\hat{K}$ [N/m]")
        believed.legend(ncols=4, loc="upper right")
        for axis, colour in enumerate(COLOURS):
            share.plot(
                time, signals["authority"][:, axis], color=colour, lw=1.0, label=f"authority {AXES[axis].upper()}"
            )
        share.plot(*outline(time, signals["dither"][:, 2]), color=ACCENT, lw=0.5, alpha=0.6, label="sine on Z [N]")
        share.set_ylabel("authority [-], sine [N]")
        share.legend(ncols=4, loc="center right")
        share.set_xlabel("time in contact [s]")
        for panel in axes:
            panel.set_xlim(0.0, time[-1])
            panel.axvspan(0.0, settle, color=BASELINE, alpha=0.15, lw=0.0)
        for panel in axes[:-1]:
            panel.tick_params(labelbottom=False)
        share.figure.align_ylabels(axes)
