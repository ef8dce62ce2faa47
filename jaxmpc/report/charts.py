"""Charts of controllers: force over time, |S|, Nyquist and Bode of the open loop, step, margins over stiffness."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxmpc.quantities import AXES, MARGINS
from jaxmpc.report.content import Chart, Mark, Series
from jaxmpc.report.loops import Curves
from jaxmpc.report.thinning import thinned

MARKED_HZ = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)
"""Frequencies that are marked on a Nyquist curve [Hz]."""
WINDOW = ((-3.0, 1.0), (-2.0, 2.0))
"""What a Nyquist chart shows: real and imaginary part."""
NOTHING = 1e-9
"""|L| below which its phase means nothing [-]."""
FRAME = 20.0
"""Residual beyond which a force is not drawn [N]: it would leave the others a line."""
SETTLED = 0.05
"""Share of a step within which it counts as settled."""


class LoopCurve(NamedTuple):
    """One curve of the charts of loops: a controller on a tissue."""

    name: str
    curves: Curves
    tissue: int
    """Place among those of the curves."""
    color: int
    stable: bool = True


def loop_charts(title: str, loops: Sequence[LoopCurve], limit: float | None = None) -> list[Chart]:
    """|S|, Nyquist, Bode magnitude and phase, and the step of some loops.

    Args:
        title: Before what each shows.
        loops: The curves of every chart.
        limit: Largest accepted M_s; None draws none [-].
    """
    names = [each.name if each.stable else f"{each.name} (unstable)" for each in loops]
    colors = [(each.color, "line" if each.stable else "dash") for each in loops]
    hertz = [each.curves.frequency for each in loops]
    open_loops = [each.curves.open_loop[each.tissue] for each in loops]

    def over(values: Sequence[np.ndarray], x: Sequence[np.ndarray] = hertz) -> list[Series]:
        return [
            Series(name, at, value, color, "dash" if style == "dash" else "line")
            for name, at, value, (color, style) in zip(names, x, values, colors, strict=True)
        ]

    sensitivity = [each.curves.sensitivity[each.tissue] for each in loops]
    phases = [_phase(loop) for loop in open_loops]
    circle = np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 91))
    nyquist = over([loop.imag for loop in open_loops], [loop.real for loop in open_loops])
    if limit is not None:
        inside = -1.0 + circle / limit
        nyquist.append(Series(f"M_s = {limit:g}", inside.real, inside.imag, 7, "dash"))
    marks = [Mark("−1", -1.0, 0.0)]
    for f, loop in zip(hertz, open_loops, strict=True):
        marks += [each for each in _marked(f, loop) if _apart(each, marks)]
    f_hz = "frequency [Hz]"
    ceiling = [Mark(f"M_s ≤ {limit:g}", y=limit)] if limit is not None else []
    levels: dict[str, Any] = {"y_log": True, "y_range": (1e-3, 10.0)}
    gains: dict[str, Any] = {"y_log": True, "y_range": (1e-3, 1e4)}
    return [
        Chart(f"{title}: sensitivity", f_hz, "|S| [-]", over(sensitivity), ceiling, x_log=True, **levels),
        Chart(f"{title}: Nyquist", "Re L", "Im L", nyquist, marks, x_range=WINDOW[0], y_range=WINDOW[1], square=True),
        Chart(f"{title}: |L|", f_hz, "|L| [-]", over([np.abs(loop) for loop in open_loops]), x_log=True, **gains),
        Chart(f"{title}: phase of L", f_hz, "arg L [°]", over(phases), [Mark("−180°", y=-180.0)], x_log=True),
        _step(title, loops, names),
    ]


def _phase(loop: np.ndarray) -> np.ndarray:
    """Unwrapped, beginning in (−360°, 0°]; none where L is but rounding, and at its end, the Nyquist frequency.

    There L is real by itself: where it vanishes its phase would jump to a whole turn.
    """
    phase = np.rad2deg(np.unwrap(np.angle(loop)))
    phase[np.abs(loop) < NOTHING] = np.nan
    phase[-1] = np.nan
    turned: np.ndarray = phase - 360.0 * np.ceil(phase[0] / 360.0)
    return turned


def _marked(frequency: np.ndarray, loop: np.ndarray) -> list[Mark]:
    """Some frequencies along a Nyquist curve, as far as they are in sight."""
    found = []
    for f in MARKED_HZ:
        at = complex(np.interp(f, frequency, loop.real), np.interp(f, frequency, loop.imag))
        if WINDOW[0][0] < at.real < WINDOW[0][1] and WINDOW[1][0] < at.imag < WINDOW[1][1]:
            found.append(Mark(f"{f:g} Hz", at.real, at.imag))
    return found


def _apart(mark: Mark, others: Sequence[Mark]) -> bool:
    """Whether the words of a mark would not lie on those of others."""
    assert mark.x is not None
    assert mark.y is not None
    return all(abs(mark.x - (other.x or 0.0)) > 0.5 or abs(mark.y - (other.y or 0.0)) > 0.15 for other in others)


def _step(title: str, loops: Sequence[LoopCurve], names: Sequence[str]) -> Chart:
    """Force of the linear loop after a step of its reference, until all have settled and a little longer."""
    series, ends = [], [0.02]
    for each, name in zip(loops, names, strict=True):
        force, time = each.curves.force[each.tissue], each.curves.time
        if each.stable:
            moving = time[np.abs(force - 1.0) > SETTLED]
            ends.append(1.3 * float(moving.max(initial=0.0)))
            name += f", overshoot {100.0 * each.curves.overshoot[each.tissue]:.0f} %"
        # An unstable answer soon leaves every frame.
        shown = np.where(np.abs(force) < 3.0, force, np.nan)
        series.append(Series(name, 1e3 * time, shown, each.color, "line" if each.stable else "dash"))
    end = 1e3 * min(max(ends), float(loops[0].curves.time[-1]))
    return Chart(f"{title}: step by 1 N", "time [ms]", "force [N]", series, [Mark("", y=1.0)], x_range=(0.0, end))


def margin_charts(stiffness: np.ndarray, named: Sequence[tuple[str, Any]], limits: dict[str, float]) -> list[Chart]:
    """Every margin over stiffness, a curve per controller.

    Args:
        stiffness: Where they are known, (points,) [N/m].
        named: Controllers, each with its `Margins`, fields (points,).
        limits: In SI, by margin.
    """
    found = []
    for name, row in MARGINS.items():
        series = [
            Series(label, stiffness, row.times * np.asarray(getattr(margins, name)), k)
            for k, (label, margins) in enumerate(named)
        ]
        limit = limits.get(name)
        marks = [] if limit is None else [Mark(f"{row.sign} {row.times * limit:g}", y=row.times * limit)]
        ends = (1.0, 6.0) if name == "M_s" else None
        found.append(
            Chart(f"{row.head or name}: {row.text}", "stiffness [N/m]", row.heading, series, marks, True, y_range=ends)
        )
    return found


def force_charts(
    time: np.ndarray, stiffness: Sequence[float], named: Sequence[tuple[str, np.ndarray]], wanted: np.ndarray
) -> list[Chart]:
    """Residual force of every axis on every tissue, a curve per controller.

    Args:
        time: Of the samples, (steps,) [s].
        stiffness: Of the tissues [N/m].
        named: Controllers, each with its measured force, (stiffness, 3, steps) [N].
        wanted: (steps, 3) [N].
    """
    return [
        Chart(
            f"{K_s:g} N/m, {axis.upper()}",
            "time [s]",
            "residual force [mN]",
            [_residual(name, time, force[i, a] - wanted[:, a], k) for k, (name, force) in named_at],
        )
        for named_at in [list(enumerate(named))]
        for i, K_s in enumerate(stiffness)
        for a, axis in enumerate(AXES)
    ]


def _residual(name: str, time: np.ndarray, residual: np.ndarray, color: int) -> Series:
    """A residual [N] over time in mN; of one that leaves the frame the name alone, which says so."""
    if np.all(np.abs(residual) <= FRAME):
        return Series(name, *thinned(time, 1e3 * residual), color)
    return Series(f"{name} (beyond {FRAME:g} N, not drawn)", time[:1], np.full(1, np.nan), color)
