"""A tuning run for people: the table before and after, and two figures."""

from pathlib import Path
from typing import Any

import numpy as np

from jaxmpc.experiment import AXES
from jaxmpc.figures import ACCENT, BASELINE, TUNED, figure
from jaxmpc.params import BOUNDS
from tuning.heldout import KINDS
from tuning.result import TuneResult


def report(result: TuneResult) -> str:
    """The whole result as plain text."""
    spec, (before, after) = result.spec, result.worst
    lines = [
        f"goals: {goals_text(result)} at {', '.join(f'{K:g}' for K in spec.experiment.stiffness)} N/m",
        result.unmet() or "all goals are met",
        "",
        f"{'parameter':<10} {'before':>12} {'after':>12}  unit",
    ]
    for axis in spec.space.axes:
        values = (_short(np.asarray(getattr(params, axis.name))) for params in (spec.params, result.params))
        lines.append(f"{axis.name:<10} " + " ".join(f"{value:>12}" for value in values) + f"  {BOUNDS[axis.name][2]}")
    lines += ["", f"residual RMS on {len(spec.tune.heldout_seeds)} held-out motion seeds, worst [mN]"]
    lines.append(f"{'K_s [N/m]':<10} " + " ".join(f"{axis + ' before':>10} {axis + ' after':>10}" for axis in AXES))
    for i, K_s in enumerate(spec.experiment.stiffness):
        cells = result.heldout[:, :, i].max(axis=1)
        lines.append(f"{K_s:<10g} " + " ".join(f"{_millinewton(cell):>10}" for a in range(3) for cell in cells[:, a]))
    change = f" ({-100 * result.gain:+.1f} %)" if np.isfinite(result.gain) else ""
    lines.append(f"worst of all: {_millinewton(before)} → {_millinewton(after)} mN{change}")
    lines += ["", "margins after (before)"]
    head = ("M_s", "gain up dB", "gain down dB", "phase deg", "delay ms")
    lines.append(f"{'K_s [N/m]':<10} {'loop':<7}" + "".join(f"{name:>18}" for name in head))
    for i, K_s in enumerate(spec.experiment.stiffness):
        for kind in KINDS:
            m = result.margins[kind]
            columns = (m.M_s, m.gain_margin_db, m.gain_reduction_db, m.phase_margin_deg, 1e3 * m.delay_margin_s)
            cells_text = "".join(f"{f'{c[1, i]:.2f} ({c[0, i]:.2f})':>18}" for c in columns)
            lines.append(f"{K_s:<10g} {kind:<7}{cells_text}")
    looks, skipped = result.state.look, int(result.state.skipped.sum())
    lines += ["", f"{looks} looks at {len(result.state.z)} starts, {skipped} steps skipped for a gradient not finite"]
    return "\n".join(lines) + "\n"


def goals_text(result: TuneResult) -> str:
    """The goals in a line."""
    signs = {"M_s": "≤"}
    goals = ", ".join(f"{name} {signs.get(name, '≥')} {limit:g}" for name, limit in result.spec.goals.items())
    return f"{goals} ({'ideal damping' if result.spec.ideal else 'as run'})"


def history_figure(result: TuneResult, path: Path) -> None:
    """Worst residual, worst M_s and the parameters over the steps, every start a line, the winner's in colour.

    Args:
        result: What `tune` returned.
        path: Where the figure goes.
    """
    state, space = result.state, result.spec.space
    looks, chosen = state.look, winner(result)
    values = space.values(state.path[:looks])
    shown = list(range(space.size)) if space.size <= 10 else [0]
    columns = 5 if space.size > 1 else 3
    rows = -(-(2 + len(shown)) // columns)
    with figure(path, rows, columns, size=(2.6 * columns, 2.4 * rows)) as axes:
        panels = np.ravel(axes)
        _lines(panels[0], 1e3 * state.worst[:looks], chosen, "worst residual RMS [mN]")
        panels[0].plot(1e3 * state.incumbent[:looks], color=ACCENT, lw=1.2, label="best that holds its goals")
        panels[0].legend()
        panels[0].set_yscale("log")
        peaks = np.where(np.isfinite(state.M_s), state.M_s, np.nan).max(axis=2)[:looks]
        _lines(panels[1], peaks, chosen, "M_s, worst stiffness")
        panels[1].set_ylim(1.0, 6.0)
        if "M_s" in result.spec.goals:
            panels[1].axhline(result.spec.goals["M_s"], color=ACCENT, lw=1.0, ls="--", label="goal")
            panels[1].legend()
        for panel, i in zip(panels[2:], shown, strict=False):
            name = space.names[i]
            _lines(panel, values[:, :, i], chosen, f"{name} [{BOUNDS[name.partition('[')[0]][2]}]")
            panel.set_yscale("linear" if name in ("Hp", "Hu") else "log")
        for panel in panels[2 + len(shown) :]:
            panel.set_visible(False)


def before_after_figure(result: TuneResult, path: Path) -> None:
    """Held-out residual per stiffness and axis, before and after: bars of the median, whiskers over the seeds.

    Args:
        result: What `tune` returned.
        path: Where the figure goes.
    """
    stiffness = result.spec.experiment.stiffness
    places = np.arange(len(stiffness))
    with figure(path, 1, 3, size=(8.0, 3.0)) as axes:
        for a, panel in enumerate(axes):
            for which, color, label in ((0, BASELINE, "before"), (1, TUNED, "after")):
                cells = 1e3 * result.heldout[which, :, :, a]
                middle = np.median(cells, axis=0)
                spread = np.abs(np.stack([cells.min(axis=0), cells.max(axis=0)]) - middle)
                at = places + 0.4 * (which - 0.5)
                panel.bar(at, middle, 0.36, color=color, label=label)
                panel.errorbar(at, middle, spread, fmt="none", ecolor="black", elinewidth=0.8, capsize=2)
            panel.set_xticks(places, [f"{K:g}" for K in stiffness])
            panel.set_xlabel("stiffness [N/m]")
            panel.set_title(f"{AXES[a]} axis")
        axes[0].set_ylabel(f"residual RMS [mN], {len(result.heldout[0])} unseen seeds")
        axes[0].set_ylim(top=1.25 * axes[0].get_ylim()[1])
        axes[0].legend(loc="upper right", ncols=2)


def winner(result: TuneResult) -> int:
    """The start from which the result came."""
    wanted = result.state.best_z if result.feasible else result.state.closest_z
    return int(np.argwhere((result.state.path[: result.state.look] == wanted).all(axis=2))[0, 1])


def _lines(panel: Any, columns: np.ndarray, chosen: int, title: str) -> None:
    panel.plot(columns, color=BASELINE, lw=0.6, alpha=0.6)
    panel.plot(columns[:, chosen], color=TUNED, lw=1.6)
    panel.set_title(title)
    panel.set_xlabel("step")


def _millinewton(force: float) -> str:
    """A force in millinewton."""
    return f"{1e3 * force:.1f}" if np.isfinite(force) else "unstable"


def _short(value: np.ndarray) -> str:
    """A value, or the range of a diagonal."""
    return f"{value:.4g}" if value.ndim == 0 else f"{value.min():.2g}…{value.max():.2g}"
