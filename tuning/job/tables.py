"""The tables of a tuning job's file, each checked and made into what a job is built from."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jaxmpc.experiment.job import experiment_table, params_table
from jaxmpc.files.errors import InputError, check_table
from jaxmpc.files.toml import convert, known_keys, known_tables, without_arrays
from jaxmpc.quantities import HIGHEST_M_S
from tuning.job.axes import free_table
from tuning.job.risk import Risk
from tuning.job.scenarios import Scenarios
from tuning.job.settings import TuneSettings
from tuning.job.space import usual

HARD = {"M_s": HIGHEST_M_S}
"""What is held unless the job says otherwise."""
SOFT = {"rms": 0.05}
"""What is minimised unless the job says otherwise [N]."""


def read_tables(data: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Fields of a `TuneSpec` by their names, from plain data as the TOML file has it.

    Args:
        data: Tables experiment, params, baseline, tune, goals, scenarios, risk, pareto; each may be left out.
        folder: Where files that it names lie.

    Raises:
        InputError: Names key, value, bound and remedy.
    """
    check_table("job", data)
    data = without_arrays(data)
    known_tables(data, ("experiment", "params", "baseline", "tune", "goals", "scenarios", "risk", "pareto"))
    tune, goals = dict(data.get("tune", {})), dict(data.get("goals", {}))
    params = params_table(data.get("params", {}), folder)
    free = free_table(tune.pop("free", dict.fromkeys(usual(params), True)))
    for kind, table, name in (
        (TuneSettings, tune, "tune"),
        (Scenarios, data.get("scenarios", {}), "scenarios"),
        (Risk, data.get("risk", {}), "risk"),
    ):
        known_keys(kind, table, name)
    ideal = goals.pop("ideal", False)
    if not isinstance(ideal, bool):
        raise InputError("goals.ideal", ideal, "true or false", "True judges the paper's ideal damping.")
    baseline = dict(data.get("baseline", {}))
    share = baseline.pop("compensation", None)
    if share is not None and (isinstance(share, bool) or not isinstance(share, int | float) or not 0 <= share <= 2):
        raise InputError("baseline.compensation", share, "in [0, 2]", "0 compensates no friction.")
    soft = goals.pop("soft", SOFT)
    if not isinstance(soft, dict) or not soft:
        raise InputError("goals.soft", soft, "a table with a goal", "Write `[goals.soft]` and `rms = 0.05`.")
    return dict(
        experiment=experiment_table(data.get("experiment", {}), folder),
        params=params,
        baseline=params_table(baseline, folder, "baseline") if baseline else None,
        baseline_compensation=share,
        tune=convert(tune, TuneSettings, "tune"),
        free=free,
        goals=goals or dict(HARD),
        soft=soft,
        ideal=ideal,
        scenarios=convert(data.get("scenarios", {}), Scenarios, "scenarios"),
        risk=convert(data.get("risk", {}), Risk, "risk"),
        pareto=data.get("pareto", {}),
    )
