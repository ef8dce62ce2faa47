"""The report of a tuning run as one page: what was reached, how robust it is, why it is as it is, the way there."""

from collections.abc import Iterator

from jaxmpc.report.content import Chart, Report, Section
from jaxmpc.report.page import page
from tuning.proof.result import TuneResult
from tuning.reports.charts import heldout_charts, history_charts, loops
from tuning.reports.explained import Study, explained
from tuning.reports.points import points
from tuning.reports.sections import sections, summary


def html_report(result: TuneResult, study: Study) -> str:
    """The page; it needs no network and no other file.

    Args:
        result: What `tune` returned.
        study: What explains it.
    """
    found, residual = summary(result)
    heldout, goals, parameters, scenarios, robustness = sections(result)
    parts = [
        with_charts(heldout, heldout_charts(result), BARS),
        goals,
        parameters,
        scenarios,
        with_charts(robustness, loops(result, study.loops), _loops_note(result)),
        *explained(result, study),
        *_way(result),
    ]
    lead = [f"{found}.", f"{residual[0].upper()}{residual[1:]}.", f"Job {result.spec.digest[:12]}."]
    # The points of the search come last: they explain, but they are not what was found.
    return page(Report(f"Tuning report: {result.spec.experiment.name}", lead, points(result), parts, first=len(parts)))


BARS = "Bars are medians; dots are the scenarios, and the folded tables name each."


def with_charts(part: Section, charts: list[Chart], words: str) -> Section:
    """A section with charts and what they show."""
    return part._replace(sentences=[*part.sentences, words], charts=charts)


def _loops_note(result: TuneResult) -> str:
    ideal = result.spec.ideal
    cut = "" if ideal else " Of its two cuts, at v and at a = v − K₂ẋ, the worse is shown."
    return (
        f"L is the {'ideal loop' if ideal else 'loop as it runs'}, from 0.1 Hz up.{cut} It must stay out of the disc "
        "around −1, whose radius is 1/M_s. The step is that of the linear loop, without the arm."
    )


def _way(result: TuneResult) -> Iterator[Section]:
    for step in reversed(result.steps):
        words = "Every start is a line, the winner's in colour."
        if step.spectra is not None:
            words = "Every point is a dot, the best of each iteration in colour."
        yield Section(f"The way there: {step.name}", [words], (), history_charts(result, step))
