"""The report of a tuning run as one page: what was reached, how robust it is, why it is as it is, the way there."""

from functools import partial

from jaxmpc import __version__
from tuning.proof.result import TuneResult
from tuning.reports import html
from tuning.reports.explained import Study, explained
from tuning.reports.figures import before_after_figure, history_figure
from tuning.reports.html import Html, fold, note, page, picture, section, tag
from tuning.reports.loop_figures import nyquist_figure, sensitivity_figure, step_figure
from tuning.reports.sections import Section, Table, sections, summary


def html_report(result: TuneResult, study: Study) -> str:
    """The page; it needs no network and no other file.

    Args:
        result: What `tune` returned.
        study: What explains it.
    """
    found, residual = summary(result)
    title = f"Tuning report: {result.spec.experiment.name}"
    heldout, goals, parameters, scenarios, robustness = sections(result)
    histories = (
        fold(step.name, picture(partial(history_figure, result, step=step)), opened=step is result.steps[-1])
        for step in result.steps
    )
    return page(
        title,
        tag("h1", title),
        tag("p", found + ".", class_="bad" if result.unmet() else "good"),
        tag("p", residual[0].upper() + residual[1:] + "."),
        _rendered(heldout, picture(partial(before_after_figure, result)), note(BARS)),
        *map(_rendered, (goals, parameters, scenarios)),
        _rendered(robustness, *_loops(result, study)),
        *explained(result, study),
        section("The way there", note("Every start is a line, the winner's in colour."), *histories),
        note(f"jaxmpc {__version__}, job {result.spec.digest[:12]}."),
    )


BARS = "Bars are medians, whiskers ranges; the pointer resting on a bar shows each scenario."


def _rendered(part: Section, *pictures: Html) -> Html:
    """A section: sentences, pictures with their notes, tables."""
    return section(part.title, *map(note, part.sentences), *pictures, *map(_table, part.tables))


def _table(table: Table) -> Html:
    found = html.table(table.head, table.rows)
    return fold(table.folded, found) if table.folded else found


def _loops(result: TuneResult, study: Study) -> list[Html]:
    ideal = result.spec.ideal
    cut = "" if ideal else " Of its two cuts, at v and at a = v − K₂ẋ, the worse is shown."
    kind = "ideal loop" if ideal else "loop as it runs"
    return [
        picture(partial(sensitivity_figure, result, study.loops)),
        note(f"Sensitivity |S| = |1/(1 + L)| of the {kind}.{cut}"),
        picture(partial(nyquist_figure, result, study.loops)),
        note("Open loop L from 0.1 Hz up. It must stay out of the disc around −1, whose radius is 1/M_s."),
        picture(partial(step_figure, result, study.loops)),
        note("Force of the linear loop, without the arm, after a step of its reference by 1 N."),
    ]
