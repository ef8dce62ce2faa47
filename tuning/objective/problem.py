"""A job on one set of scenarios as a function of all starts: by runs, which decide, or by spectra, which propose."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple

import jax
import msgspec
import numpy as np

from jaxmpc.engine.base import ProgramSpec, ScenarioData
from jaxmpc.engine.registry import fastest, named
from jaxmpc.engine.scenario import program_spec
from jaxmpc.experiment import Experiment
from jaxmpc.files.errors import InputError
from jaxmpc.loop.linear import HIGHEST_FORCE
from jaxmpc.metrics import Metrics
from jaxmpc.spectra.spectrum import Spectrum, spectrum_of, stacked
from jaxmpc.xla.blocks import OverDevices, fetched
from jaxmpc.xla.place import placed
from tuning.job.goals import OVERSHOOT, RATIO, RUN_GOALS, run_goals
from tuning.job.scenarios import scenarios, scene_over
from tuning.job.space import SearchSpace
from tuning.job.spec import TuneSpec
from tuning.objective.evaluated import visible_goals, visible_soft
from tuning.objective.judged_cells import judged_cells
from tuning.objective.loss import (
    MarginValues,
    RunValues,
    Values,
    margin_slopes,
    run_cells,
    run_slopes,
    together,
    value_alone,
)
from tuning.objective.measures import Data, ProblemStructure, measure

FUNCTIONS: dict[str, Callable[..., Any]] = {
    each.__name__: each for each in (value_alone, margin_slopes, run_slopes, run_cells)
}
"""By name: a traced program that is kept is told from others by what can be written down."""


class Problem(NamedTuple):
    """What the descent descends on."""

    data: Data
    structure: ProblemStructure

    def differentiate(self, z: np.ndarray, width: float) -> Values:
        """Value and gradient of all starts, dealt out to all local devices.

        Args:
            z: Unconstrained parameters, (starts, size).
            width: Softness of the horizons, 1 is whole [samples].
        """
        rows, shared = self._arguments(z, width)
        margins: MarginValues = over_starts(margin_slopes, self.structure).launched(rows, shared)
        runs: RunValues = over_starts(run_slopes, self.structure).launched(rows, shared, margins.stable)
        return together(*fetched((margins, runs), len(z)))

    def evaluate(self, z: np.ndarray) -> Values:
        """The same with whole horizons and without the gradient (NaN), at a fraction of its price."""
        values: Values = over_starts(value_alone, self.structure)(*self._arguments(z, 1.0))
        return values

    def compile_evaluation(self, starts: int) -> None:
        """Compile `evaluate` for so many starts."""
        over_starts(value_alone, self.structure).compile(*self._arguments(self._anywhere(starts), 1.0))

    def compile_margins(self, starts: int) -> None:
        """Compile of `differentiate` for so many starts what judges margins."""
        over_starts(margin_slopes, self.structure).compile(*self._arguments(self._anywhere(starts), 1.0))

    def compile_runs(self, starts: int) -> None:
        """Compile of `differentiate` for so many starts the rest."""
        rows, shared = self._arguments(self._anywhere(starts), 1.0)
        over_starts(run_slopes, self.structure).compile((*rows, np.ones(starts, bool)), shared)

    def cells(self, z: np.ndarray, held: np.ndarray) -> Metrics:
        """What is measured of those that hold the heart, (starts, stiffness, scenarios, 3); NaN of the others."""
        rows, shared = self._arguments(z, 1.0)
        found: Metrics = over_starts(run_cells, self.structure)((*rows, held), shared)
        return found

    def compile_cells(self, starts: int) -> None:
        """Compile `cells` for so many starts."""
        rows, shared = self._arguments(self._anywhere(starts), 1.0)
        over_starts(run_cells, self.structure).compile((*rows, np.ones(starts, bool)), shared)

    def _anywhere(self, starts: int) -> np.ndarray:
        return np.zeros((starts, SearchSpace(self.data.base, self.structure.axes).size))

    def _arguments(self, z: np.ndarray, width: float) -> tuple[Any, Any]:
        """What each start has of its own, and what all share."""

        def wide(limit: Any) -> Any:
            return np.broadcast_to(np.asarray(limit, float), (len(z),))

        rows = z, jax.tree.map(wide, self.data.margins), jax.tree.map(wide, self.data.hard)
        return rows, (self.data._replace(margins={}, hard={}), width)

    @property
    def soft_goals(self) -> tuple[str, ...]:
        """Those that can be seen, and stand-ins for others."""
        return tuple(visible_soft(self.data))

    @property
    def hard_goals(self) -> tuple[str, ...]:
        """Those on the runs that can be seen."""
        return visible_goals(self.data.hard, self.data)

    def hard_at(self, cells: Metrics) -> np.ndarray:
        """Where each of these stands worst, index into the stiffnesses; NaN of the overshoot, which no run tells.

        Args:
            cells: What was measured of the starts, each field (starts, stiffness, scenarios, 3).

        Returns:
            (starts, goals); a tissue on which a run was lost comes first.
        """
        found = np.full((len(cells.rms), len(self.hard_goals)), np.nan)
        plain, reference = jax.tree.map(np.asarray, (cells, self.data.reference))
        for i, name in enumerate(self.hard_goals):
            if name != OVERSHOOT:
                goal = np.asarray(run_goals(plain, reference, None, {name: 1.0})[name])
                found[:, i] = np.argmax(goal.max(axis=(2, 3)), axis=1)
        return found

    def with_limits(self, limits: Mapping[str, np.ndarray]) -> "Problem":
        """The same with hard limits of each start's own, (starts,)."""
        data = self.data
        margins = {name: np.asarray(limits.get(name, value), float) for name, value in data.margins.items()}
        hard = {name: np.asarray(limits.get(name, value), float) for name, value in data.hard.items()}
        margins, hard = placed((margins, hard))
        return self._replace(data=data._replace(margins=margins, hard=hard))


@cache
def over_starts(function: Callable[..., Any], structure: ProblemStructure) -> OverDevices:
    """Compiled once per structure and shapes; each device has its share of the starts."""
    return OverDevices(_on_device, {"name": function.__name__, "structure": structure})


def _on_device(rows: Any, shared: Any, name: str, structure: ProblemStructure) -> Any:
    (z, margins, hard, *stable), (data, width) = rows, shared
    return FUNCTIONS[name](z, data._replace(margins=margins, hard=hard), width, structure, *stable)


def training(spec: TuneSpec, seeds: Sequence[int]) -> list[Experiment]:
    """Scenarios at the length of a training run."""
    tune = spec.tune
    base = msgspec.structs.replace(spec.experiment, duration=tune.duration, settle=tune.settle)
    return scenarios(base, spec.scenarios, seeds)


def problem_of(
    spec: TuneSpec,
    met: Sequence[Experiment],
    spectral: bool = False,
    evaluated: bool = False,
    begun: Callable[[Problem], object] = lambda _: None,
) -> Problem:
    """A job as a function of all starts.

    Args:
        spec: The job.
        met: The scenarios.
        spectral: Whether spectra of the scenarios tell of the linear loop what they can, and nothing runs.
        evaluated: Whether it will only be evaluated, not differentiated: by the fastest engine, or the one named.
        begun: Called with the problem before spectra are read, and before it is known what ratios are taken to: its
            programs can be compiled.
    """
    swinging = any(name in RUN_GOALS and RUN_GOALS[name].metric.name == "swing" for name in {**spec.soft, **spec.held})
    scene = _scene(met, spectral, swinging)
    # Scenarios may differ in delay; the linear loop has the experiment's, as the margins do.
    scene = scene._replace(path=replace(scene.path, delay=float(spec.experiment.delay)))

    def engined(experiment: Experiment) -> ProgramSpec:
        found = program_spec(experiment)
        return named(fastest(found), spec.engine) if evaluated else found

    world = program_spec(_linear(met[0])) if spectral else engined(met[0])
    structure = ProblemStructure(spec.space.axes, world, spec.tune.precision, spec.risk)
    ones: Any = np.ones((len(scene.stiffness), len(met), 3))
    judged_at, believed = judged_cells(spec, spectral)
    data = Data(
        scene=scene,
        spectra=stacked([Spectrum.blank()] * len(met)) if spectral else None,
        correction=None,
        base=spec.space.base,
        margins=spec.margin_goals,
        hard=spec.hard_goals,
        soft=dict(spec.soft),
        judged=spec.experiment.loop_path(spec.ideal),
        judged_at=judged_at,
        believed=believed,
        reference=Metrics(**dict.fromkeys(Metrics._fields, ones)),
    )
    data = placed(data)
    begun(Problem(data, structure))
    if spectral:
        data = data._replace(spectra=_spectra(met))
    if any(name in RUN_GOALS and RUN_GOALS[name].part == RATIO for name in {**spec.soft, **spec.goals}):
        old = spec.met_before(met)
        world = structure.world if spectral else engined(old[0])
        scene = placed(_scene(old, spectral, swinging))
        seen_before = data._replace(scene=scene, spectra=_spectra(old) if spectral else None)
        reference = measure(spec.before, seen_before, structure._replace(world=world))
        data = data._replace(reference=reference if spectral else _held(spec, reference))
    return Problem(data, structure)


def _held(spec: TuneSpec, reference: Metrics) -> Metrics:
    """What ratios are taken to, NaN where the controller before was lost: whatever lasts is better there.

    Raises:
        InputError: It was lost everywhere, so that every controller would be as good as any other; or beside a family
            on a tissue, of which a risk of 0 would make the mean over the tissues 0.
    """
    plain = jax.device_get(reference)
    held = np.all(plain.peak_error < HIGHEST_FORCE, axis=2, keepdims=True)
    on_tissue = held.any(axis=(1, 2))
    ratios = all(name in RUN_GOALS and RUN_GOALS[name].part == RATIO for name in spec.soft)
    each_counts = ratios and spec.params.listening is not None
    if not (on_tissue.all() if each_counts else on_tissue.any()):
        where = f" on {spec.experiment.stiffness[int(np.argmin(on_tissue))]:g} N/m" if on_tissue.any() else ""
        remedy = "Compare with one that is stable, or minimise goals in units of their own, such as rms."
        raise InputError("baseline", f"lost in every run{where}", "held in one at least, for ratios to it", remedy)
    found: Metrics = placed(jax.tree.map(lambda field: np.where(held, field, np.nan), plain))
    return found


def _scene(met: Sequence[Experiment], spectral: bool, swinging: bool) -> ScenarioData:
    """A scene; where spectra are all that is known of the scenarios, that of the linear loop."""
    return scene_over([_linear(met[0])], False) if spectral else scene_over(met, swinging)


def _spectra(met: Sequence[Experiment]) -> Spectrum:
    found: Spectrum = placed(stacked([*map(spectrum_of, met)]))
    return found


def _linear(experiment: Experiment) -> Experiment:
    return msgspec.structs.replace(experiment, physics="linear")
