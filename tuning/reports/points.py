"""The points that a search visited, as rows to explore: parameters, score, worst residual, hard goals."""

import numpy as np

from jaxmpc.files.toml import toml_text
from jaxmpc.quantities import PARAMETERS
from jaxmpc.report.content import Candidates, Detail, Measure
from jaxmpc.synthesis.params import Params
from tuning.job.goals import GOALS
from tuning.job.spec import TuneSpec
from tuning.proof.flyable import freeze_command
from tuning.proof.result import TuneResult

MOST = 20_000
"""Points of a page; of a longer search every so many iterations."""


def points(result: TuneResult) -> Candidates | None:
    """Every iteration and start of the last step of a search; None where it has not taken one.

    Points that follow a descent are no sample of the space, so that nothing is said of shares of variance: exact
    gradients tell what matters.

    Args:
        result: What `tune` returned.
    """
    step = result.steps[-1]
    state, space, names = step.state, result.spec.space, [*result.spec.margin_goals, *step.problem.hard_goals]
    if not state.iteration:
        return None
    starts = state.path.shape[1]
    iterations = np.arange(0, state.iteration, -(-state.iteration * starts // MOST))
    z = state.path[iterations].reshape(-1, space.size)
    values, ends = space.values(z), np.cumsum([axis.size for axis in space.axes])
    parameters = [
        Measure(
            axis.name,
            axis.name,
            axis.unit,
            PARAMETERS[axis.parameter].text + (", geometric mean" if axis.length else ""),
            np.exp(np.mean(np.log(values[:, end - axis.size : end]), axis=1)),
            "parameter",
        )
        for axis, end in zip(space.axes, ends, strict=True)
    ]
    score, worst = state.score[iterations].ravel(), 1e3 * state.worst[iterations].ravel()
    found = [
        Measure("score", "score", "-", "risk of the soft goals in training", score, "metric", "ceiling"),
        Measure("worst", "worst RMS", "mN", "worst residual in training", worst, "metric", "ceiling"),
        Measure(
            "worst_M_s", "M_s", "-", "largest over the tissues", state.M_s[iterations].ravel(), "margin", "ceiling"
        ),
    ]
    for i, name in enumerate(names):
        normalised = np.where(np.isfinite(hard := state.hard[iterations, :, i].ravel()), hard, np.inf)
        text = f"{GOALS[name].text}, relative to its limit: at most 1 where it is kept"
        found.append(Measure(f"{name}/limit", f"{name} / limit", "-", text, normalised, "margin", "ceiling", 3, 1.0))
    where = np.stack(np.meshgrid(iterations, np.arange(starts), indexing="ij"), axis=-1).reshape(-1, 2)
    return Candidates(
        names=[f"iteration {i}, start {k}" for i, k in where.tolist()],
        measures=[*parameters, *found],
        status=np.where(np.isfinite(score), 0, 1)[:, None].astype(np.uint8),
        tissues=["worst"],
        goals=("worst", "worst_M_s", "score"),
        details=_controllers(result, z),
        note="the best of each start, as whole controllers ready to freeze.",
    )


def _controllers(result: TuneResult, z: np.ndarray) -> dict[int, Detail]:
    """The best vector of each start, by its place among the rows."""
    state, found = result.state, {}
    for start in np.flatnonzero(np.isfinite(state.best)):
        same = np.flatnonzero((z == state.best_z[start]).all(axis=1))
        if len(same):
            found[int(same[0])] = Detail(toml=toml_of(result.spec, result.spec.space.exact(state.best_z[start])))
    return found


def toml_of(spec: TuneSpec, params: Params) -> str:
    """A params.toml."""
    command = freeze_command(spec, "experiment.toml")
    note = f"A point of a search. Beside the experiment.toml of its result, freeze it: {command}"
    return toml_text({"params": params.to_dict()}, note)
