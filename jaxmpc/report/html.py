"""HTML from Python values: everything is escaped but what is HTML already."""

from collections.abc import Iterable, Sequence
from html import escape
from typing import Any


class Html(str):
    """Text that is HTML already; anything else is escaped."""

    __slots__ = ()


def text(value: Any) -> Html:
    """Anything as HTML."""
    return value if isinstance(value, Html) else Html(escape(str(value)))


def tag(name: str, *contents: Any, **attributes: str) -> Html:
    """An element around contents."""
    named = "".join(f' {key.rstrip("_").replace("_", "-")}="{escape(value)}"' for key, value in attributes.items())
    return Html(f"<{name}{named}>{''.join(map(text, contents))}</{name}>")


def note(*contents: Any) -> Html:
    """A paragraph that explains."""
    return tag("p", *contents, class_="note")


def table(head: Sequence[Any], rows: Iterable[Sequence[Any]]) -> Html:
    """A table; its first column names the rows."""
    lines = [tag("tr", *(tag("th", cell, scope="col") for cell in head))]
    lines += [tag("tr", tag("th", row[0], scope="row"), *(tag("td", cell) for cell in row[1:])) for row in rows]
    # One that is wider than the page scrolls by itself, by keys too.
    return tag("div", tag("table", Html("\n".join(lines))), class_="scroll", tabindex="0")


def fold(title: str, *contents: Any) -> Html:
    """Contents behind a title that opens them."""
    return tag("details", tag("summary", title), *contents)
