"""Rows of a sweep, computed by a pure function of what can be pickled: any process on any machine may be asked.

    compute(plan, first, last) → columns of the planned rows first … last − 1
    begin(plan, first, last)() → the same, in two steps: devices work while the process does something else

No bit of a row depends on which others are asked for: every row runs in a block whose size follows from the spec
(`block_of`), and blocks are calls of one program. Two ways, of which the spec alone decides:

- neighbours in number share their world (no axis of the world, or many controllers in each): controllers × one scene;
- every row may have a world of its own: pairs of a controller and a scene, what differs stacked.
"""

import shutil
import tempfile
import weakref
from collections.abc import Callable
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxmpc.closed_loops import Outcome, evaluate_block
from jaxmpc.engine.base import ProgramSpec, ScenarioData
from jaxmpc.engine.scenario import program_spec, scenario_data
from jaxmpc.experiment import Experiment
from jaxmpc.experiment.build import robot_of
from jaxmpc.synthesis.params import Params
from jaxmpc.xla.blocks import BLOCK, OverBlocks
from sweeps.blocks import block_of, in_pairs, shares_signals
from sweeps.engines import chosen
from sweeps.plan import Columns, Plan
from sweeps.rows import Meeting, experiment_of, meetings, world_of

PendingOutcome = Callable[[], Outcome]
"""Waits for the devices."""


def compute(plan: Plan, first: int, last: int) -> Columns:
    """Columns of the planned rows first … last − 1.

    Args:
        plan: The sweep, with the content of its recordings.
        first: Place of the first row among the planned ones.
        last: Place behind the last.

    Raises:
        InputError: A row's world is none: its values do not go together.
    """
    return begin(plan, first, last)()


def begin(plan: Plan, first: int, last: int) -> Callable[[], Columns]:
    """Have the devices begin with rows; what is returned waits for them. See `compute`."""
    site = _site(plan.spec_hash, plan)
    rows = site.plan.rows[first:last]
    swept = {name: entries[first:last] for name, entries in site.swept.items()}
    met = meetings(site.plan.base, site.plan.space.axes, swept, by_world=not in_pairs(plan))
    begun = [part for meeting in met for part in site.outcomes(meeting)]

    def finish() -> Columns:
        layout = site.plan.layout
        found = {name: np.zeros((len(rows), *column.shape), column.dtype) for name, column in layout.items()}
        found |= {"row": rows, **swept}
        for places, outcome_of in begun:
            outcome = outcome_of()
            measured = outcome.metrics._asdict() | outcome.margins._asdict()
            found["status"][places] = outcome.status
            for name in site.plan.kept:
                # One NaN, whatever sign and payload the processor made.
                found[name][places] = np.where(np.isnan(measured[name]), np.nan, measured[name])
        return {name: np.asarray(found[name], column.dtype) for name, column in layout.items()}

    return finish


def round_of(plan: Plan) -> int:
    """Rows that are computed side by side: one block a device."""
    return block_of(plan) * jax.local_device_count()


def compiles_long() -> bool:
    """Whether a program takes so long to compile here, a kernel's, that it is to be begun before it is needed."""
    return jax.default_backend() == "gpu"


def baseline(plan: Plan) -> Outcome:
    """What the base controller comes to on the base experiment, (1, stiffness, …)."""
    site = _site(plan.spec_hash, plan)
    experiment = experiment_of(site.world(()))
    batch = plan.base.with_columns({"K2": plan.base.K2[None]})
    # The rows' own program, where they have one of its kind: compiling another takes longer than filling a block.
    block = BLOCK if in_pairs(plan) else block_of(plan)
    return _begun(partial(_program, block=block), experiment, plan, batch)()


class _Site:
    """What a process keeps of a sweep between two calls."""

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        # At once: of a sample the whole is drawn for any part.
        self.swept = plan.space.columns(plan.rows)
        self._folder = Path()
        if plan.files:
            self._folder = Path(tempfile.mkdtemp(prefix="jaxmpc-sweep-"))
            weakref.finalize(self, shutil.rmtree, self._folder, True)
        self._base = plan.with_files(plan.canonical["experiment"], self._folder)
        self._experiments = lru_cache(maxsize=64)(lambda entries: experiment_of(self.world(entries)))
        self._signals: Any = None

    def world(self, entries: tuple[float, ...]) -> dict[str, Any]:
        """Plain data of a world; of the base's, without entries."""
        if not entries:
            return self._base
        data = world_of(self._base, self.plan.space.axes, entries)
        return self.plan.with_files(data, self._folder)

    def outcomes(self, meeting: Meeting) -> list[tuple[np.ndarray, PendingOutcome]]:
        """Places of rows, and what they are coming to."""
        if not in_pairs(self.plan):
            experiment = self._experiments(tuple(meeting.worlds[0].tolist()))
            run = partial(_program, block=block_of(self.plan))
            return [(meeting.places, _begun(run, experiment, self.plan, meeting.params))]
        scenes: dict[Any, list[tuple[int, ScenarioData]]] = {}
        for i, entries in enumerate(meeting.worlds.tolist()):
            experiment = self._experiments(tuple(entries))
            scene = self._scene(experiment)
            key = program_spec(experiment), scene.path.ideal, experiment.steps
            scenes.setdefault(key, []).append((i, scene))
        found = []
        for (world, *_), members in scenes.items():
            which = np.array([i for i, _ in members])
            batch = jax.tree.map(lambda leaf, which=which: leaf[which], meeting.params)
            found.append((meeting.places[which], self._paired(world, batch, [scene for _, scene in members])))
        return found

    def _scene(self, experiment: Experiment) -> ScenarioData:
        swinging = experiment.physics != "linear"
        if not shares_signals(self.plan):
            return scenario_data(experiment, swinging)
        self._signals = self._signals or scenario_data(experiment, swinging).signals
        robot = robot_of(experiment) if experiment.physics != "linear" else None
        stiffness, lsb = np.asarray(experiment.stiffness), np.asarray(experiment.sensor.lsb)
        return ScenarioData(stiffness, self._signals, lsb, experiment.force_limit, robot, experiment.loop_path())

    def _paired(self, world: ProgramSpec, batch: Params, scenes: list[ScenarioData]) -> PendingOutcome:
        shared = shares_signals(self.plan)
        nothing: Any = None
        apart = [scene._replace(signals=nothing) if shared else scene for scene in scenes]
        stacked = jax.tree.map(lambda *leaves: np.stack([np.asarray(leaf) for leaf in leaves]), *apart)
        program = _pairs(chosen(world, self.plan), self.plan.canonical["precision"], block_of(self.plan))
        with jax.enable_x64(True):
            return program.begin((batch, stacked), scenes[0].signals if shared else None)


_sites: dict[str, _Site] = {}


def _site(spec_hash: str, plan: Plan) -> _Site:
    """The site of a sweep; a process keeps the last two, since one may be readied while another runs."""
    if spec_hash not in _sites:
        for oldest in [*_sites][:-1]:
            del _sites[oldest]
        _sites[spec_hash] = _Site(plan)
    return _sites[spec_hash]


def _begun(program: Callable[..., OverBlocks], experiment: Experiment, plan: Plan, batch: Params) -> PendingOutcome:
    with jax.enable_x64(True):
        run = program(chosen(program_spec(experiment), plan), plan.canonical["precision"])
        return run.begin(batch, _scenario(experiment))


@lru_cache(maxsize=8)
def _scenario(experiment: Experiment) -> ScenarioData:
    # The filter behind it would slow the linear loop down, which swings only where it is unstable.
    found = scenario_data(experiment, swinging=experiment.physics != "linear")
    # On the device, once for all rounds.
    on_device: ScenarioData = jax.tree.map(jnp.asarray, found)
    return on_device


@lru_cache(maxsize=8)
def _program(world: ProgramSpec, precision: str, block: int) -> OverBlocks:
    return OverBlocks(evaluate_block, block, {"world": world, "dtype": precision})


@lru_cache(maxsize=8)
def _pairs(world: ProgramSpec, precision: str, block: int) -> OverBlocks:
    return OverBlocks(_block_of_pairs, block, {"world": world, "dtype": precision})


def _block_of_pairs(pairs: tuple[Params, ScenarioData], signals: Any, *, world: ProgramSpec, dtype: str) -> Outcome:
    """Each controller in a scene of its own; with signals that all share, unless None."""

    def one(params: Params, scene: ScenarioData) -> Outcome:
        met = scene if signals is None else scene._replace(signals=signals)
        alone = jax.tree.map(lambda leaf: leaf[None], params)
        outcome = evaluate_block(alone, met, world=world, dtype=dtype)
        first: Outcome = jax.tree.map(lambda leaf: leaf[0], outcome)
        return first

    found: Outcome = jax.vmap(one)(*pairs)
    return found
