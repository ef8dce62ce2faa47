"""Pictures that explain a result: the residual by its causes and by the parameters."""

from pathlib import Path

import numpy as np

from jaxmpc.experiment import AXES
from jaxmpc.pictures.figures import ACCENT, BASELINE, TUNED, figure
from tuning.proof.result import TuneResult
from tuning.proof.sensitivities import Sensitivities
from tuning.proof.split import Split
from tuning.reports.figures import HINT

PARTS = (("motion", TUNED), ("friction", ACCENT), ("noise", BASELINE))
FADED = 0.45
"""Opacity of the bars before."""


def split_figure(result: TuneResult, parts: Split, path: Path) -> None:
    """What each cause alone would leave of the residual, before (pale) beside after, per tissue and axis.

    Args:
        result: What `tune` returned.
        parts: The causes.
        path: Where the figure goes.
    """
    stiffness = result.spec.experiment.stiffness
    shown = [(name, color) for name, color in PARTS if np.nanmax(getattr(parts, name), initial=0.0) > 0.0]
    width = 0.8 / (2 * len(shown) or 1)
    places = np.arange(len(stiffness))
    with figure(path, 1, 3, size=(9.0, 3.0)) as axes:
        for a, panel in enumerate(axes):
            for k, (name, color) in enumerate(shown):
                for which, when in enumerate(("before", "after")):
                    heights = 1e3 * getattr(parts, name)[which, :, a]
                    at = places + width * (which * len(shown) + k + 0.5) - 0.4
                    label = name if which else None
                    bars = panel.bar(at, np.nan_to_num(heights), 0.92 * width, color=color, label=label)
                    for bar, K_s, height in zip(bars, stiffness, heights, strict=True):
                        bar.set_alpha(1.0 if which else FADED)
                        bar.set_gid(f"{HINT}{AXES[a]} axis, {K_s:g} N/m, {when}: {name} alone {height:.1f} mN")
            for which in range(2):
                whole = 1e3 * parts.whole[which, :, a]
                ends = places - 0.4 + 0.4 * which
                label = None if which else "all together"
                panel.hlines(whole, ends + 0.01, ends + 0.39, color="black", lw=1.2, label=label)
            panel.set_xticks(places, [f"{K:g}" for K in stiffness])
            panel.set_xlabel("stiffness [N/m], before | after")
            panel.set_title(f"{AXES[a]} axis")
        axes[0].set_ylabel("residual RMS [mN]")
        axes[0].set_ylim(top=1.3 * axes[0].get_ylim()[1])
        axes[0].legend(loc="upper right", ncols=2)


def sensitivities_figure(result: TuneResult, found: Sensitivities, path: Path) -> None:
    """Heat map of d log metric / d log parameter; arguments as above."""
    stiffness = result.spec.experiment.stiffness
    count = len(found.metrics)
    size = (1.6 + (0.75 * len(stiffness) + 0.5) * count, 1.2 + 0.32 * len(found.parameters))
    strongest = max(float(np.nanmax(np.abs(found.slopes), initial=0.0)), 1e-3)
    with figure(path, 1, count, size=size) as axes:
        for panel, name, table in zip(np.ravel(axes), found.metrics, found.slopes, strict=True):
            panel.grid(visible=False)
            panel.pcolormesh(table, cmap="RdBu_r", vmin=-strongest, vmax=strongest)
            for (i, j), slope in np.ndenumerate(table):
                color = "white" if abs(slope) > 0.6 * strongest else "black"
                panel.text(
                    j + 0.5,
                    i + 0.5,
                    f"{slope:+.2f}" if abs(slope) >= 0.005 else "0",
                    ha="center",
                    va="center",
                    fontsize=7.5,
                    color=color,
                )
            panel.set_xticks(np.arange(len(stiffness)) + 0.5, [f"{K:g}" for K in stiffness])
            panel.set_yticks(np.arange(len(found.parameters)) + 0.5, found.parameters)
            panel.invert_yaxis()
            panel.set_title(name)
            panel.set_xlabel("stiffness [N/m]")
