"""A tuning run as plain text."""

from collections.abc import Iterator

from jaxmpc.report.content import Section, Table
from tuning.proof.result import TuneResult
from tuning.reports.sections import sections, summary, way


def report(result: TuneResult) -> str:
    """The whole result as plain text, but for what is folded on the page."""
    parts = [section_text(section) for section in sections(result)]
    return "\n".join([*summary(result), "", *parts, "THE WAY THERE", *way(result)]) + "\n"


def section_text(section: Section) -> str:
    """One part of it."""
    lines = [section.title.upper(), *section.sentences]
    for table in section.tables:
        lines += [] if table.folded else aligned(table)
    return "\n".join(lines) + "\n"


def aligned(table: Table) -> Iterator[str]:
    """Lines of a table: the first column to the left, the others to the right."""
    lines = [list(table.head), *table.rows]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    for first, *others in lines:
        cells = (cell.rjust(width) for cell, width in zip(others, widths[1:], strict=True))
        yield "  ".join([first.ljust(widths[0]), *cells]).rstrip()
