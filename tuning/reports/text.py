"""A tuning run as plain text."""

from jaxmpc.report.content import Section
from jaxmpc.terminal import layout
from tuning.proof.result import TuneResult
from tuning.reports.sections import sections, summary, way


def report(result: TuneResult, width: int = layout.UNLIMITED) -> str:
    """The whole result as plain text, but for what is folded on the page.

    Args:
        result: Of a job.
        width: Characters of a line that its tables may take; what does not fit is stacked [-].
    """
    parts = [section_text(section, width) for section in sections(result)]
    return "\n".join([*summary(result), "", *parts, "THE WAY THERE", *way(result)]) + "\n"


def section_text(section: Section, width: int = layout.UNLIMITED) -> str:
    """One part of it."""
    tables = [layout.table(table.head, table.rows, width) for table in section.tables if not table.folded]
    lines = [section.title.upper(), *section.sentences, *(["\n\n".join(tables)] if tables else [])]
    return "\n".join(lines) + "\n"
