"""Random trials of finished controllers on the arm: who is lost, or swings, where nobody has tuned?

A trial is an `Experiment` of its own, drawn from its seed and number alone, so that any one can be run again by itself;
every controller meets the same. A heart's motion costs more than running a controller on it, so `COPIES` trials, each
on a robot and a tissue of its own, share one (and its sensor noise). They are not independent then: of failures it also
matters on how many motions they occurred.

Three verdicts, of which a trial may deserve several:

- *lost*: its status is any but OK; or |e| ≥ 2 N after the first 2 s (ramps included) in a loop whose linearisation with
  the whole arm, at full gain, is unstable, or whose force grows: it still swings at the end.
- *left 2 N*: |e| ≥ 2 N after the first 2 s, not lost: an event pushed a stable loop.
- *swinging*: true force above 12 Hz of more than 0.1 N RMS on any axis over the last 10 s (`jaxmpc.swing`).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple, get_args

import jax
import msgspec
import numpy as np
from msgspec.structs import replace

from jaxmpc.engine.scenario import program_spec, scenario_data
from jaxmpc.experiment import Experiment
from jaxmpc.experiment.build import robot_on_its_tissue
from jaxmpc.files.errors import InputError
from jaxmpc.files.sealed import SealError, digest, seal, unseal, write_atomic
from jaxmpc.loop.arm import ArmSignals
from jaxmpc.stability import whole_arm
from jaxmpc.status import Status
from jaxmpc.synthesis.params import Params, by_structure
from jaxmpc.terminal.progress import progress
from jaxmpc.xla.precision import in_float64
from tuning.job.scenarios import Rhythm, Scenarios, scenario
from tuning.trials.program import block_program

DURATION, SETTLE = 30.0, 2.0
"""Length of a trial, and what is not judged of it [s]: a guard has found its gain by the end, and probed it."""
LARGEST_ERROR = 2.0
"""|e| from which on a trial is lost or left 2 N [N]."""
SWINGING = 0.1
"""RMS of the true force above 12 Hz from which on a trial swings [N]."""
POOL, COPIES = 24, 30
"""Motions of a block, and trials on each: 10 000 trials fill 14 blocks."""
BLOCK = POOL * COPIES
"""Trials of a block: computed together, kept in one file."""
FIRST_SEED = 10_000_000
"""Distance between the scenarios of two seeds, and from all that a tuner sees."""
MOST = FIRST_SEED - 1
"""Largest number of trials."""
STREAM = 8
"""Stream of the random numbers of a trial, apart from those of its scenario."""


class Spread(NamedTuple):
    """From what trials are drawn."""

    stiffness: tuple[float, float]
    """Lowest and highest, log-uniform [N/m]."""
    scenarios: Scenarios
    cable_damping: tuple[float, float] | None = None
    """Lowest and highest damping ratio of the cable mode [-]; None is the experiment's."""
    substeps: int = 1
    """Least physics steps per sample: as many as resolve the cable mode."""
    arms: str = "random"
    """What such arms are called."""


STIFFNESS = 300.0, 2200.0
"""Lowest and highest of the tissues [N/m]."""
_ANY = Scenarios(rhythms=get_args(Rhythm), friction=0.5, mass=0.15)
NOMINAL = Spread(STIFFNESS, replace(_ANY, delays=(1,), cable_hz=(90.0, 250.0)), (0.03, 0.1), 5, "plausible")
"""Arms on which the paper's text design is stable on its three tissues."""
HARD = Spread(STIFFNESS, replace(_ANY, delays=(1, 2), cable_hz=(15.0, 60.0)), (0.03, 0.1), 2, "stress")
"""Arms on which it is not: there a guard has to end what no fixed margin prevents."""


def on_own_tissues(spread: Spread, base: Experiment) -> Spread:
    """The same from the softest to the hardest of the experiment's tissues, where it has others than the paper's."""
    if base.stiffness == Experiment().stiffness:
        return spread
    return spread._replace(stiffness=(min(base.stiffness), max(base.stiffness)))


@dataclass(frozen=True)
class Job:
    """Which controllers meet which trials.

    Attributes:
        controllers: One or several, of any structure.
        base: An experiment on the arm; its duration, settling time and stiffness are the trials' own.
        spread: How far reality may lie from it.
        seed: Draws other trials.

    Raises:
        InputError: The experiment is not on the arm ("wam"), or the seed is out of bounds.
    """

    controllers: tuple[Params, ...]
    base: Experiment
    spread: Spread = NOMINAL
    seed: int = 0

    def __post_init__(self) -> None:
        if self.base.physics != "wam":
            raise InputError("physics", self.base.physics, '"wam" for trials', "Take table-1-wam, or set it so.")
        if not 0 <= self.seed < 10**9:
            raise InputError("seed", self.seed, "in [0, 1e9)", "Any other number draws other trials.")
        arm = replace(self.base.arm, substeps=max(self.base.arm.substeps, self.spread.substeps))
        short = replace(self.base, duration=DURATION, settle=SETTLE, arm=arm)
        object.__setattr__(self, "base", short)

    @property
    def digest(self) -> str:
        """sha256 of all that the outcome of a trial depends on."""
        controllers = [params.to_dict() for params in self.controllers]
        spread = msgspec.to_builtins(self.spread)
        return digest([controllers, self.base.to_dict(), spread, self.seed, POOL, COPIES])

    def trial(self, number: int) -> Experiment:
        """The experiment of a trial."""
        first = FIRST_SEED * (1 + self.seed)
        seed, drawn = first + number, scenario(self.base, self.spread.scenarios, first + number)
        shared = _scenario(self.base, self.spread.scenarios, first + motion_of(number))
        random = np.random.Generator(np.random.Philox([seed, STREAM]))
        stiffness, damping = random.uniform(size=2)
        low, high = np.log(self.spread.stiffness)
        arm = drawn.arm
        if self.spread.cable_damping:
            least, most = self.spread.cable_damping
            arm = replace(arm, cable_damping=float(least + (most - least) * damping))
        own = {"stiffness": (float(np.exp(low + (high - low) * stiffness)),), "arm": arm}
        return replace(drawn, motion=shared.motion, sensor=shared.sensor, **own)


_scenario = lru_cache(maxsize=POOL)(scenario)


def motion_of(number: int) -> int:
    """The trial whose motion this one shares: the first of its block that has it."""
    return number - number % BLOCK + number % POOL


class Outcomes(NamedTuple):
    """What happened; leading dimensions are trials and controllers."""

    status: np.ndarray
    """A `Status`: UNSTABLE where the linear loop of that tissue and delay is, whatever the arm's friction held."""
    when: np.ndarray
    """When that happened, or for a status of the linear loop when the run diverged; NaN where it did not [s]."""
    spectral_radius: np.ndarray
    """Spectral radius of the linear loop [-]."""
    backed_off: np.ndarray
    """When a guard took gain back; ∞ where it was at rest throughout, or there is none [s]."""
    rms: np.ndarray
    """RMS of the residual after 2 s, (trials, controllers, 3) [N]; NaN where the run diverged."""
    true_rms: np.ndarray
    """That of the force on the tissue itself, without what the sensor adds, the same [N]."""
    peak_error: np.ndarray
    """Largest |e| after 2 s, the same [N]."""
    swing: np.ndarray
    """True force above 12 Hz, RMS over the last 10 s, the same [N]."""
    whole_arm_unstable: np.ndarray
    """Whether the linear loop of the whole arm is unstable at full gain; asked only where |e| ≥ 2 N and status OK."""

    @property
    def swinging(self) -> np.ndarray:
        """Whether each trial swings at its end, (trials, controllers)."""
        found: np.ndarray = np.any(self.swing > SWINGING, axis=-1)
        return found

    @property
    def beyond(self) -> np.ndarray:
        """Whether |e| ≥ 2 N although the status is OK."""
        found: np.ndarray = (self.status == Status.OK) & np.any(self.peak_error >= LARGEST_ERROR, axis=-1)
        return found

    @property
    def lost(self) -> np.ndarray:
        """Whether each trial was lost."""
        lost: np.ndarray = (self.status != Status.OK) | self.beyond & (self.whole_arm_unstable | self.swinging)
        return lost

    @property
    def left(self) -> np.ndarray:
        """Whether an event pushed a stable loop to 2 N."""
        left: np.ndarray = self.beyond & ~self.lost
        return left

    @property
    def at_rest(self) -> np.ndarray:
        """Whether the guard left the gain above 0.99 throughout."""
        resting: np.ndarray = np.isinf(self.backed_off)
        return resting


Told = Callable[[int, "Outcomes"], None]
"""Called with the first trial of a block and its outcomes, as soon as they are there."""


def run(job: Job, count: int, folder: Path | None = None, show: bool = False, told: Told | None = None) -> Outcomes:
    """Run trials 0 … count − 1; no bit of one depends on how many there are or where a run was interrupted.

    Args:
        job: Who meets what.
        count: Number of trials.
        folder: Where finished blocks are kept and found again; None keeps none.
        show: Whether to show progress.
        told: Hears of each block.

    Raises:
        InputError: The count is out of bounds, or the folder holds blocks of another job.
    """
    if not 1 <= count <= MOST:
        raise InputError("trials", count, f"in [1, {MOST}]", "10000 is usual.")
    blocks: list[Outcomes] = []
    lost, swinging = np.zeros((2, len(job.controllers)), int)
    compute = _computer(job)
    with progress("trials", count, "trials", show) as tick:
        for first in range(0, count, BLOCK):
            found = _kept(job, folder, first, partial(compute, first))
            blocks.append(Outcomes(*(field[: count - first] for field in found)))
            lost += blocks[-1].lost.sum(axis=0)
            swinging += blocks[-1].swinging.sum(axis=0)
            said = " / ".join(f"{a} lost, {b} swinging" for a, b in zip(lost, swinging, strict=True))
            if told:
                told(first, blocks[-1])
            tick(min(first + BLOCK, count), said)
    return Outcomes(*map(np.concatenate, zip(*blocks, strict=True)))


def _kept(job: Job, folder: Path | None, first: int, compute: Callable[[], Outcomes]) -> Outcomes:
    """A block from its file, or computed and kept; a damaged file is computed again."""
    if folder is None:
        return compute()
    path = folder / f"{first:07d}.npz"
    header = {"kind": "jaxmpc trials", "job": job.digest, "first": first}
    if path.exists():
        try:
            said, arrays = unseal(path.read_bytes())
        except SealError:
            said, arrays = header, {}
        if said != header:
            raise InputError("output folder", folder, "one of these very trials", "Choose another with -o.")
        # A block from before something else was measured is computed again, as a damaged one is.
        if arrays.keys() == set(Outcomes._fields):
            return Outcomes(**arrays)
    found = compute()
    folder.mkdir(parents=True, exist_ok=True)
    write_atomic(path, seal(header, found._asdict()))
    return found


def _computer(job: Job) -> Callable[[int], Outcomes]:
    """A function of a block's first trial; nothing is computed before it is called."""

    @cache
    def of_all_blocks() -> tuple[Any, tuple[int, ...], Any]:
        robots = [robot_on_its_tissue(trial) for trial in map(job.trial, range(POOL))]
        structure = jax.tree.structure(robots[0])
        leaves = [jax.tree.leaves(robot) for robot in robots]
        # What differs in these differs everywhere: which it is must not depend on how many trials there are.
        varied = tuple(k for k, values in enumerate(zip(*leaves, strict=True)) if len(set(values)) > 1)
        return leaves[0], varied, structure

    @in_float64
    def compute(first: int) -> Outcomes:
        constant, varied, structure = of_all_blocks()
        trials = [job.trial(first + i) for i in range(BLOCK)]
        met = [_judged_from_the_start(scenario_data(trial, swinging=True).signals, job.base) for trial in trials[:POOL]]
        signals = jax.tree.map(lambda *parts: np.concatenate(parts), *met)
        robots = [jax.tree.leaves(robot_on_its_tissue(trial)) for trial in trials]
        rows = np.array([[leaves[k] for k in varied] for leaves in robots], np.float64)
        # Trial first + POOL·copy + motion: motions lead, and are dealt to the devices.
        own = tuple(rows.reshape(COPIES, POOL, len(varied)).transpose(2, 1, 0))
        base = trials[0]
        found: dict[int, list[np.ndarray]] = {}
        for members in by_structure(job.controllers):
            program = block_program(program_spec(base), varied, structure)
            batch = Params.stack([job.controllers[i] for i in members])
            shared = batch, constant, base.loop_path(), base.force_limit
            outcomes = program((signals, own), shared)
            found |= {i: [field[:, :, c] for field in outcomes] for c, i in enumerate(members)}
        ordered = [np.stack(fields, 2) for fields in zip(*(found[i] for i in sorted(found)), strict=True)]
        flat = [field.swapaxes(0, 1).reshape(BLOCK, *field.shape[2:]) for field in ordered]
        flat[0] = flat[0].astype(np.int8)
        ran = Outcomes(*[*flat, np.zeros(flat[0].shape, bool)])
        for c, params in enumerate(job.controllers):
            asked = np.flatnonzero(ran.beyond[:, c])
            ran.whole_arm_unstable[asked, c] = whole_arm.lost(params, [trials[i] for i in asked])
        return ran

    return compute


def _judged_from_the_start(signals: Any, base: Experiment) -> ArmSignals:
    """Ramps included."""
    late = np.asarray(signals.time) >= base.settle
    judged: ArmSignals = signals._replace(score=np.broadcast_to(late[..., None] * 1.0, signals.score.shape))
    return judged
