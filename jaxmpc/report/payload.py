"""The data of a report as bytes: columns quantised where they are many, deflated, within a budget."""

import json
import math
import zlib
from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxmpc.report.content import Candidates, Chart, Measure, Report
from jaxmpc.status import Status

EXACT_ROWS = 20_000
"""Up to so many rows every number keeps its bits; beyond, what is measured has 16 of them."""
BUDGET = 7_800_000
"""Most bytes of deflated columns; a page is 4/3 of that and 0.7 MB."""
LEVELS = 65_533
"""Steps between the least and the largest value of a quantised column; three more codes say NaN, ∞ and −∞."""
NAN, INFINITE, MINUS_INFINITE = 65_535, 65_534, 65_533
SIGNIFICANT = 5
"""Digits of a point of a chart."""


class _Columns:
    """Deflated columns one after the other."""

    def __init__(self) -> None:
        self.parts: list[bytes] = []
        self.length = 0

    def add(self, values: np.ndarray) -> dict[str, Any]:
        """Append an array; what tells how to read it."""
        kind = {"u1": "u8", "u2": "u16", "u4": "u32", "f8": "f64"}[values.dtype.str[1:]]
        flat = np.ascontiguousarray(values, values.dtype.newbyteorder("<")).ravel()
        # Bytes of equal weight side by side deflate better.
        planes = flat.view(np.uint8).reshape(len(flat), -1).T if len(flat) else np.zeros(0, np.uint8)
        packed = zlib.compress(np.ascontiguousarray(planes).tobytes(), 6)
        found = {"type": kind, "at": self.length, "bytes": len(packed), "size": len(flat)}
        self.parts.append(packed)
        self.length += len(packed)
        return found


def payload(report: Report) -> bytes:
    """Length of the text (4 bytes), the text (JSON, deflated), the columns.

    Args:
        report: What is shown.
    """
    columns = _Columns()
    text = {
        "title": report.title,
        "rows": None if report.rows is None else _rows(report.rows, columns),
        "charts": [[_chart(chart) for chart in section.charts] for section in report.sections],
    }
    packed = zlib.compress(json.dumps(text, ensure_ascii=False, allow_nan=False, separators=(",", ":")).encode(), 6)
    return len(packed).to_bytes(4, "little") + packed + b"".join(columns.parts)


def _rows(rows: Candidates, columns: _Columns) -> dict[str, Any]:
    exact = len(rows) <= EXACT_ROWS
    order = sorted(rows.measures, key=lambda each: _weight(each, rows.goals))
    described: dict[str, dict[str, Any]] = {}
    lean = []
    status = columns.add(np.asarray(rows.status, np.uint8).T)
    for each in order:
        if each.values.ndim == 2 and columns.length + 2 * each.values.size > BUDGET and not exact:
            lean.append(each.head)
            each = _worst_alone(each)
        described[each.name] = _measure(each, columns, exact or each.role == "parameter")
    return {
        "count": len(rows),
        "names": _names(rows.names),
        "tissues": list(rows.tissues),
        "states": [{"name": each.name, "text": each.sentence} for each in Status],
        "status": status,
        "measures": [described[each.name] for each in rows.measures],
        "goals": list(rows.goals),
        "toml": [piece if isinstance(piece, str) else {"name": piece.name} for piece in rows.toml],
        "details": {
            str(place): {"charts": [_chart(chart) for chart in detail.charts], "toml": detail.toml}
            for place, detail in rows.details.items()
        },
        "note": rows.note,
        "lean": lean,
        "influence": {name: np.round(shares, 4).tolist() for name, shares in rows.influence.items()},
        "exact": exact,
        "group": rows.group,
        "file": rows.file,
    }


def _names(names: Sequence[str]) -> Any:
    """Names, or where they are a word and ascending numbers the word and the differences."""
    split = [name.rpartition(" ") for name in names]
    if len(names) > 50 and all(word == split[0][0] and number.isdecimal() for word, _, number in split):
        numbers = np.array([int(number) for _, _, number in split])
        return {"word": split[0][0], "steps": np.diff(numbers, prepend=0).tolist()}
    return list(names)


def _weight(each: Measure, goals: Sequence[str]) -> int:
    """What is written first is the last to be thinned."""
    if each.role == "parameter" or each.values.ndim == 1:
        return 0
    return 1 if each.name in goals else 2 if each.role == "margin" else 3


def _worst_alone(each: Measure) -> Measure:
    from dataclasses import replace

    return replace(each, values=each.worst)


def _measure(each: Measure, columns: _Columns, exact: bool) -> dict[str, Any]:
    values = each.values.T if each.values.ndim == 2 else each.values[None]
    said = {
        "name": each.name,
        "head": each.head,
        "unit": each.unit,
        "text": each.text,
        "role": each.role,
        "sense": each.sense,
        "digits": each.digits,
        "limit": each.limit,
        "whole": each.whole,
        "log": each.logarithmic,
        "tissues": each.values.ndim == 2,
    }
    return said | (_exact(values, columns) if exact else quantised(values, columns))


def _exact(values: np.ndarray, columns: _Columns) -> dict[str, Any]:
    points, place = np.unique(values, return_inverse=True)
    if 4 * len(points) > values.size or len(points) > 65_536:
        return {"values": columns.add(values.astype(np.float64))}
    index = place.astype(np.uint8 if len(points) <= 256 else np.uint16)
    return {"points": columns.add(points.astype(np.float64)), "index": columns.add(index)}


def quantised(values: np.ndarray, columns: Any) -> dict[str, Any]:
    """Codes of 16 bits in equal steps between the least and the largest value, of the logarithm where all are positive.

    Args:
        values: Any numbers.
        columns: What takes the codes.
    """
    finite = np.isfinite(values)
    some = values[finite]
    log = len(some) > 0 and float(some.min()) > 0.0
    low, high = (float(some.min()), float(some.max())) if len(some) else (0.0, 1.0)
    if log:
        low, high = math.log(low), math.log(high)
    scaled = np.log(np.where(finite, values, 1.0)) if log else np.where(finite, values, low)
    steps = (scaled - low) / max(high - low, 1e-300) * (LEVELS - 1)
    codes = np.where(finite, np.clip(np.round(steps), 0, LEVELS - 1), NAN)
    codes = np.where(values == np.inf, INFINITE, np.where(values == -np.inf, MINUS_INFINITE, codes))
    scale = {"low": low, "high": high, "log": log, "levels": LEVELS}
    return {"codes": columns.add(codes.astype(np.uint16)), "scale": scale}


def _chart(chart: Chart) -> dict[str, Any]:
    return {
        "title": chart.title,
        "x": chart.x,
        "y": chart.y,
        "series": [
            {"name": each.name, "x": _points(each.x), "y": _points(each.y), "color": each.color, "style": each.style}
            for each in chart.series
        ],
        "marks": [{"text": mark.text, "x": mark.x, "y": mark.y} for mark in chart.marks],
        "xLog": chart.x_log,
        "yLog": chart.y_log,
        "xRange": chart.x_range,
        "yRange": chart.y_range,
        "categories": list(chart.categories),
        "square": chart.square,
    }


def _points(values: Any) -> list[float | None]:
    """Numbers with a few digits, None where there is none."""
    numbers = np.asarray(values, float).tolist()
    return [float(f"{value:.{SIGNIFICANT}g}") if math.isfinite(value) else None for value in numbers]
