"""What Python shows of parameters, margins and outcomes: names, values and units, in text and in a notebook."""

import html
import textwrap
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxmpc.quantities import MARGINS, METRICS, PARAMETERS, Quantity
from jaxmpc.status import Status

WIDTH = 100
"""Columns of a line at most."""
MOST = 6
"""Values that are written out; of more, the least and the largest."""
CELL = "<td style='padding: 0 .6em; text-align: left'>"
"""How a cell of a notebook's table begins; a page that is made of a notebook brings no style for it."""


class Line(NamedTuple):
    """What is known of one quantity."""

    name: str
    value: str
    unit: str
    text: str


def as_text(title: str, lines: Sequence[Line]) -> str:
    """A title, and a line for each quantity below it; what is too long for a line goes on in the next."""
    name = max((len(line.name) for line in lines), default=0)
    value = min(max((len(f"{line.value} {line.unit}") for line in lines), default=0), 48)
    rows = [f"  {line.name:<{name}}  {f'{line.value} {line.unit}'.strip():<{value}}  {line.text}" for line in lines]
    below = " " * (min(name, WIDTH // 3) + 6)
    return "\n".join(textwrap.fill(row.rstrip(), WIDTH, subsequent_indent=below) for row in [title, *rows])


def as_html(title: str, lines: Sequence[Line]) -> str:
    """The same as a table for a notebook."""
    rows = "".join(f"<tr>{''.join(f'{CELL}{html.escape(cell)}</td>' for cell in line)}</tr>" for line in lines)
    return f"<table><caption>{html.escape(title)}</caption>{rows}</table>"


def parameters(params: Any) -> tuple[str, list[Line]]:
    """Title and lines of a controller or a batch."""
    batch = tuple(params.batch_shape)
    title = f"Params, {params.architecture}, disturbance order {params.disturbance_order}"
    title += f", for {params.designed_delay} samples of delay" if params.designed_delay > 1 else ""
    title += ", guarded" if params.guarded else ""
    title += f", {len(params.knots)} knots" if params.knots else ""
    title += f", a batch {batch}" if batch else ""
    return title, _lines({name: PARAMETERS[name] for name in params.numbers}, params)


def margins(found: Any) -> tuple[str, list[Line]]:
    """Title and lines of margins."""
    return f"Margins{_of(found.M_s)}", [*_lines(MARGINS, found), _status(found.status)]


def metrics(found: Any) -> tuple[str, list[Line]]:
    """Title and lines of metrics; each number is the worst axis of a tissue."""
    return f"Metrics{_of(found.rms)}, (…, stiffness, axis)", _lines(METRICS, found)


def outcome(found: Any) -> tuple[str, list[Line]]:
    """Title and lines of an outcome: residuals, margins, status."""
    traced = "with a trace" if found.trace is not None else "without a trace"
    lines = [*_lines(METRICS, found.metrics), *_lines(MARGINS, found.margins), _status(found.status)]
    return f"Outcome{_of(found.status)}, {traced}", lines


def experiment(one: Any) -> tuple[str, list[Line]]:
    """Title and lines of an experiment."""
    path = "ideal damping" if one.damping == "ideal" and one.physics == "linear" else "sampled damping"
    motion = one.motion.rhythm if one.motion.kind == "rhythm" else one.motion.kind
    tissue = f"{one.tissue.kind}, {'holds the tip' if one.tissue.attached else 'does not hold the tip'}"
    lines = [
        Line("physics", one.physics, "", path),
        Line("duration", f"{one.duration:g}", "s", f"of which {one.settle:g} s are not scored"),
        Line("stiffness", values(np.asarray(one.stiffness)), "N/m", tissue),
        Line("sampling_time", f"{one.sampling_time:g}", "s", f"delay {one.delay} samples"),
        Line("motion", motion, "", f"scale {one.motion.scale:g}, seed {one.motion.seed}"),
        Line("sensor", f"{one.sensor.noise:g}", "N", "noise of the force sensor, RMS"),
        Line("force_limit", f"{one.force_limit:g}", "N", "largest measured force of a run that is fine"),
    ]
    return f"Experiment {one.name}", lines


def settings(one: Any, units: Mapping[str, str]) -> tuple[str, list[Line]]:
    """Title and lines of a frozen struct of settings, units where a name does not say its own."""
    pairs = ((name, getattr(one, name)) for name in one.__struct_fields__)
    return type(one).__name__, [Line(name, _setting(value), units.get(name, ""), "") for name, value in pairs]


def _setting(value: Any) -> str:
    if not isinstance(value, tuple):
        return f"{value}"
    words = any(isinstance(each, str) for each in value)
    return (", ".join(map(str, value)) if words else values(value)) if value else "none"


def _lines(table: Any, holder: Any) -> list[Line]:
    return [_line(row, getattr(holder, name)) for name, row in table.items()]


def _line(row: Quantity, value: Any) -> Line:
    return Line(row.name, values(value), unit(row), row.text)


def unit(row: Any) -> str:
    """Unit of a quantity or an axis; empty where it has none."""
    return "" if row.unit == "-" else f"{row.unit}"


def values(value: Any) -> str:
    """Few numbers written out, of more the least, the largest and the shape."""
    try:
        numbers = np.asarray(value, float)
    except Exception:  # what JAX traces has no value yet
        return f"traced {getattr(value, 'shape', '')}"
    if numbers.size <= MOST:
        return ", ".join(f"{x:.4g}" for x in numbers.ravel())
    known = numbers[~np.isnan(numbers)]
    if not known.size:
        return f"nan {numbers.shape}"
    return f"{known.min():.4g} … {known.max():.4g} {numbers.shape}"


def _status(codes: Any) -> Line:
    try:
        found = np.asarray(codes, int).ravel()
    except Exception:  # traced, as above
        return Line("status", "traced", "", "")
    if found.size <= MOST:
        return Line("status", ", ".join(Status(code).name for code in found), "", "")
    counts = ", ".join(f"{status.name} {n}" for status in Status if (n := int(np.sum(found == status))))
    return Line("status", counts, "", "")


def _of(array: Any) -> str:
    shape = tuple(getattr(array, "shape", ()))
    return f" {shape}" if shape else ""
