"""Figures without a display, in one look."""

import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import RLock
from typing import Any

import numpy as np

from jaxmpc.files.sealed import write_atomic

BASELINE, TUNED, ACCENT = "#8a8f98", "#0b6e99", "#d1495b"
"""Colours: what was, what is now, what to look at."""

STYLE: Any = {
    "font.size": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.25,
    "legend.frameon": False,
    "figure.constrained_layout.use": True,
    "savefig.dpi": 150,
}

_drawing = RLock()


@contextmanager
def in_style() -> Iterator[None]:
    """The style above within it, for one thread at a time: settings of matplotlib are those of all threads."""
    import matplotlib as mpl

    with _drawing, mpl.rc_context(STYLE):
        yield


@contextmanager
def figure(path: Path, rows: int = 1, columns: int = 1, size: tuple[float, float] = (7.0, 4.0)) -> Iterator[Any]:
    """A figure and its axes, written to `path` on the way out, whole or not at all; the user's settings are untouched.

    Args:
        path: Where it goes; the suffix chooses the format (png, svg, pdf).
        rows: Rows of axes.
        columns: Columns of axes.
        size: Width and height [inch].

    Yields:
        The array of axes (rows, columns), or the one axes object.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with in_style():
        drawing = Figure(figsize=size, dpi=STYLE["savefig.dpi"])
        canvas: Any = FigureCanvasAgg(drawing)
        axes = drawing.subplots(rows, columns)
        yield axes
        data = io.BytesIO()
        if path.suffix == ".png":
            # The picture of `savefig`, which draws it twice; without the writer's version the same data gives the
            # same bytes.
            canvas.print_png(data, metadata={"Software": None})
        else:
            drawing.savefig(data, format=path.suffix.removeprefix("."))
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(path, data.getvalue())


def outline(t: np.ndarray, x: np.ndarray, points: int = 3000) -> tuple[np.ndarray, np.ndarray]:
    """A long signal as its extremes: what a picture of so many points can show, drawn ten times faster.

    Args:
        t: Times, shape (n,) [s].
        x: Signal, shape (n,).
        points: Twice the number of stretches; each keeps its lowest and its highest sample.
    """
    length = -(-len(t) // (points // 2))
    if length < 3:
        return t, x
    whole = len(t) // length * length
    stretches = x[:whole].reshape(-1, length)
    first = np.arange(0, whole, length)
    kept = np.sort(np.concatenate([first + stretches.argmin(axis=1), first + stretches.argmax(axis=1)]))
    return t[kept], x[kept]
