"""A report as one HTML file: text and tables stand in it, rows and charts are drawn from its data by its own script."""

import base64
import hashlib
from functools import cache
from html import escape
from importlib.resources import files
from pathlib import Path

from jaxmpc.files.sealed import write_atomic
from jaxmpc.report.content import Report, Section, Table
from jaxmpc.report.html import Html, fold, note, table, tag
from jaxmpc.report.payload import payload

SCRIPTS = ("data", "state", "plot", "parallel", "table", "scatter", "maps", "detail", "main")
"""Files of the script, in the order in which they need each other."""


def write_report(report: Report, path: str | Path) -> None:
    """Write a report.

    Raises:
        OSError: The file cannot be written.
    """
    write_atomic(Path(path), page(report).encode())


def page(report: Report) -> str:
    """The whole file; it fetches nothing, and runs no script but its own.

    Args:
        report: What it shows.
    """
    from jaxmpc import __version__

    style, script = _asset("report.css"), _script()
    policy = "; ".join(
        (
            "default-src 'none'",
            f"script-src 'sha256-{_digest(script)}'",
            f"style-src 'sha256-{_digest(style)}'",
            "base-uri 'none'",
            "form-action 'none'",
        )
    )
    data = base64.b64encode(payload(report)).decode()
    parts = [_section(section, place) for place, section in enumerate(report.sections)]
    explorer = [] if report.rows is None else [tag("main", id="explorer")]
    parts[report.first : report.first] = explorer
    body = [
        tag("header", tag("h1", report.title), *(tag("p", line) for line in report.lead)),
        tag("noscript", note("Rows and charts need the script of this file; text and tables stand without it.")),
        *parts,
        tag("footer", note(f"jaxmpc {__version__}. Charts: Apache ECharts 6.1.0, Apache License 2.0.")),
    ]
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{escape(policy)}">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        '<meta name="color-scheme" content="light dark">'
        f"<title>{escape(report.title)}</title><style>{style}</style></head>\n<body>\n"
        + "\n".join(body)
        + f'\n<script type="application/octet-stream" id="data">{data}</script>'
        + f"\n<script>{script}</script>\n</body></html>\n"
    )


def _section(section: Section, place: int) -> Html:
    charts = [
        tag("div", class_="chart", data_section=str(place), data_chart=str(i)) for i in range(len(section.charts))
    ]
    drawn = [tag("div", *charts, class_="charts")] if charts else []
    return tag("section", tag("h2", section.title), *map(note, section.sentences), *drawn, *map(_table, section.tables))


def _table(content: Table) -> Html:
    found = table(content.head, content.rows)
    return fold(content.folded, found) if content.folded else found


@cache
def _script() -> str:
    """One script in strict mode that leaves no names behind."""
    own = "\n".join(_asset(f"{name}.js") for name in SCRIPTS)
    return f'{_asset("echarts.min.js", "vendor")}\n(function () {{\n"use strict";\n{own}\n}})();\n'


def _asset(name: str, folder: str = "assets") -> str:
    return (files("jaxmpc.report") / folder / name).read_text(encoding="utf-8")


def _digest(text: str) -> str:
    return base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
