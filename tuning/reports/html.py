"""One HTML file that needs nothing but itself: text escaped, pictures inline as SVG, no script."""

import re
from collections.abc import Callable, Iterable, Sequence
from html import escape
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from tuning.reports.figures import HINT

SALT = "jaxmpc"
"""Makes the names within a picture depend on its contents alone: the same result gives the same bytes."""
STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; color: #22262b; max-width: 72rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.6rem; } h2 { font-size: 1.2rem; margin-top: 2.2rem; border-bottom: 1px solid #d8dbe0; }
table { border-collapse: collapse; margin: .8rem 0; font-variant-numeric: tabular-nums; }
th, td { padding: .15rem .7rem; white-space: nowrap; border-bottom: 1px solid #e6e8eb; text-align: right; }
th:first-child, td:first-child { text-align: left; } th { color: #5b626b; font-weight: 600; }
svg { max-width: 100%; height: auto; } .bad { color: #d1495b; } .good { color: #0b6e99; }
.note { color: #5b626b; max-width: 52rem; } summary { cursor: pointer; color: #0b6e99; }
"""


class Html(str):
    """Text that is HTML already; anything else is escaped."""

    __slots__ = ()


def text(value: Any) -> Html:
    """Anything as HTML."""
    return value if isinstance(value, Html) else Html(escape(str(value)))


def tag(name: str, *contents: Any, **attributes: str) -> Html:
    """An element around contents."""
    named = "".join(f' {key.rstrip("_")}="{escape(value)}"' for key, value in attributes.items())
    return Html(f"<{name}{named}>{''.join(map(text, contents))}</{name}>")


def note(*contents: Any) -> Html:
    """A paragraph that explains."""
    return tag("p", *contents, class_="note")


def table(head: Sequence[Any], rows: Iterable[Sequence[Any]]) -> Html:
    """A table; its first column names the rows."""
    lines = [tag("tr", *(tag("th", cell) for cell in head))]
    lines += [tag("tr", *(tag("td", cell) for cell in row)) for row in rows]
    return tag("table", Html("\n".join(lines)))


def fold(title: str, *contents: Any, opened: bool = False) -> Html:
    """Contents behind a title that opens them."""
    return Html(f"<details{' open' if opened else ''}>{tag('summary', title)}{''.join(map(text, contents))}</details>")


def section(title: str, *contents: Any) -> Html:
    """A part of the page."""
    return tag("section", tag("h2", title), *contents)


def page(title: str, *contents: Any) -> str:
    """The whole file."""
    head = f'<meta charset="utf-8"><title>{escape(title)}</title><style>{STYLE}</style>'
    body = "\n".join(map(text, contents))
    return f'<!DOCTYPE html>\n<html lang="en"><head>{head}</head><body>\n{body}\n</body></html>\n'


def picture(draw: Callable[[Path], None]) -> Html:
    """A figure as inline SVG, its hints shown while the pointer rests on what they belong to.

    Args:
        draw: Draws it into a file.
    """
    import matplotlib as mpl

    with TemporaryDirectory() as folder, mpl.rc_context({"svg.hashsalt": SALT, "svg.fonttype": "none"}):
        path = Path(folder) / "picture.svg"
        draw(path)
        svg = path.read_text(encoding="utf-8")
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    svg = re.sub(rf'<g id="{HINT}([^"]*)">', r"<g><title>\1</title>", svg)
    # Groups are numbered alike in every picture; only what is referred to keeps its name.
    return Html(re.sub(r'<g id="[^"]*">', "<g>", svg))
