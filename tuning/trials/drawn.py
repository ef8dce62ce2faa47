"""What a trial meets, drawn from its seed and number alone: robot, tissue, delay, rhythm."""

from dataclasses import dataclass
from functools import lru_cache
from math import ceil
from typing import NamedTuple, get_args

import msgspec
import numpy as np
from msgspec.structs import replace

from jaxmpc.experiment import Experiment
from jaxmpc.files.errors import InputError, check_type, counted, within
from jaxmpc.files.sealed import digest
from jaxmpc.files.toml import check_built
from jaxmpc.synthesis.params import Params
from jaxmpc.synthesis.sampling import check_sampling
from jaxmpc.synthesis.values import MAKE_PARAMS
from jaxmpc.world.heart.motion import Motion
from tuning.job.scenarios import Rhythm, Scenarios, draw, random_of, scenario

DURATION, SETTLE = 30.0, 2.0
"""Length of a trial, and what is not judged of it [s]: a guard has found its gain by the end, and probed it."""
POOL, COPIES = 24, 30
"""Motions of a block, and trials on each: 10 000 trials fill 14 blocks."""
BLOCK = POOL * COPIES
"""Trials of a block: computed together, kept in one file."""
FIRST_SEED = 10_000_000
"""Distance between the scenarios of two seeds, and from all that a tuner sees."""
MOST = FIRST_SEED - FIRST_SEED % BLOCK
"""Largest number of trials: those of a seed, in whole blocks."""
STREAM = 8
"""Stream of the random numbers of a trial, apart from those of its scenario."""


DRAWABLE = 1e-6, 1e6
"""Between which tissues may be drawn [N/m]."""


class Drawn(NamedTuple):
    """What sets trials apart, (trials,) each."""

    motion: np.ndarray
    """Rhythm and ventilation, in words."""
    motion_seed: np.ndarray
    stiffness: np.ndarray
    """Tissue's [N/m]."""
    delay: np.ndarray
    """Between command and effect [samples]."""
    mass_error: np.ndarray
    """Masses believed over the true ones, less 1 [-]."""
    friction: np.ndarray
    """True over believed, (trials, joints) [-]; 1 where none is believed."""
    cable_hz: np.ndarray
    """Mode of the cables [Hz]; 0 where they are stiff."""
    cable_damping: np.ndarray
    """Damping ratio of that mode [-]."""


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

    def check(self) -> None:
        """Refuse ends between which nothing can be drawn.

        Raises:
            InputError: Names key, value, bound and remedy.
        """
        damping = self.cable_damping or (0.0, 1.0)
        for key, ends, span in (("stiffness", self.stiffness, DRAWABLE), ("cable_damping", damping, (0.0, 1.0))):
            try:
                low, high = ends
                good = span[0] <= low <= high <= span[1]
            except (TypeError, ValueError):
                good = False
            if not good:
                remedy = f"Give both: NOMINAL._replace({key}=(…, …))."
                raise InputError(f"spread.{key}", ends, f"lowest and highest, {within(*span, '-')}", remedy)
        counted("spread.substeps", self.substeps, "Two resolve 60 Hz, five 250 Hz.", 1, 64)
        check_type("spread.scenarios", self.scenarios, Scenarios, "Change some of NOMINAL.scenarios.")
        check_built(self.scenarios, "scenarios")


STIFFNESS = 300.0, 2200.0
"""Lowest and highest of the tissues [N/m]."""
_ANY = Scenarios(rhythms=get_args(Rhythm), friction=0.5, mass=0.15)
NOMINAL = Spread(STIFFNESS, replace(_ANY, delays=(1,), cable_hz=(90.0, 250.0)), (0.03, 0.1), 5, "plausible")
"""Arms on which the paper's text design is stable on its three tissues."""
HARD = Spread(STIFFNESS, replace(_ANY, delays=(1, 2), cable_hz=(15.0, 60.0)), (0.03, 0.1), 2, "stress")
"""Arms on which it is not: there a guard has to end what no fixed margin prevents."""


def on_own_tissues(spread: Spread, base: Experiment) -> Spread:
    """The same from the softest to the hardest of the experiment's tissues, where it has others than the paper's."""
    if sorted(base.stiffness) == sorted(Experiment().stiffness):
        return spread
    return spread._replace(stiffness=(min(base.stiffness), max(base.stiffness)))


@dataclass(frozen=True)
class Job:
    """Which controllers meet which trials.

    Attributes:
        controllers: One or several, of any structure, none of them a batch.
        base: An experiment on the arm; its duration, settling time and stiffness are the trials' own.
        spread: How far reality may lie from it.
        seed: Draws other trials.
        engine: Which one runs them; None is the fastest here.

    Raises:
        InputError: The experiment is not on the arm ("wam"), its recording ends before a trial, or anything else is of
            another type or out of bounds.
    """

    controllers: tuple[Params, ...]
    base: Experiment
    spread: Spread = NOMINAL
    seed: int = 0
    engine: str | None = None

    def __post_init__(self) -> None:
        check_type("controllers", self.controllers, tuple | list, "Give (params,), or (params, other).")
        for params in self.controllers:
            check_type("controllers", params, Params, MAKE_PARAMS)
            if params.batch_shape:
                raise InputError("controllers", f"a batch {params.batch_shape}", "single ones", "Give tuple(batch).")
        check_type("base", self.base, Experiment, 'Take Experiment.published("table-1-wam").')
        check_type("spread", self.spread, Spread, "Take tuning.trials.NOMINAL or HARD.")
        self.spread.check()
        if self.base.physics != "wam":
            raise InputError("physics", self.base.physics, '"wam" for trials', "Take table-1-wam, or set it so.")
        seed = counted("seed", self.seed, "Any other number draws other trials.", 0, 10**9 - 1)
        object.__setattr__(self, "seed", seed)
        for params in self.controllers:
            check_sampling(params, self.base.sampling_time)
        # Those of the spread are for 1 ms.
        resolving = ceil(self.spread.substeps * max(1.0, self.base.sampling_time / 1e-3) - 1e-9)
        # No trial's cables are damped more, and those of more might need more substeps.
        damping = min(self.base.arm.cable_damping, max(self.spread.cable_damping or (1.0,)))
        arm = replace(self.base.arm, substeps=max(self.base.arm.substeps, resolving), cable_damping=damping)
        short = replace(self.base, duration=DURATION, settle=SETTLE, arm=arm)
        if short.motion.kind == "recording" and "own" in self.spread.scenarios.rhythms:
            try:
                _ = short.heart
            except InputError as error:
                remedy = f"Trials last {DURATION:g} s: set motion.repeat = true."
                raise InputError(error.key, error.value, error.bound, remedy) from None
        # An arm without friction has none to be drawn.
        replace(self.spread.scenarios, friction=0.0).check(short)
        object.__setattr__(self, "base", short)

    @property
    def digest(self) -> str:
        """sha256 of all that the outcome of a trial depends on; engines and devices differ in rounding alone."""
        controllers = [params.to_dict() for params in self.controllers]
        spread = msgspec.to_builtins(self.spread)
        return digest([controllers, self.base.content, spread, self.seed, POOL, COPIES])

    def trial(self, number: int) -> Experiment:
        """The experiment of a trial.

        Raises:
            InputError: It has no such number; another seed's would be drawn.
        """
        number = counted("trial", number, "Trials are counted from 0; another seed draws others.", 0, MOST - 1)
        drawn, shared = scenario(self.base, self.spread.scenarios, self._seed(number)), self._motion_of(number)
        stiffness, cable_damping = self._own(number)
        arm = replace(drawn.arm, cable_damping=cable_damping)
        return replace(drawn, motion=shared.motion, sensor=shared.sensor, stiffness=(stiffness,), arm=arm)

    def drawn(self, first: int, count: int) -> Drawn:
        """What sets some trials apart, from the first one on: two fifths of the work of `trial` for each.

        Raises:
            InputError: There are none, or no such.
        """
        first = counted("first", first, "Trials are counted from 0.", 0, MOST - 1)
        count = counted("count", count, "Ask for one trial or more.", 1, MOST - first)
        arm, numbers = self.base.arm, range(first, first + count)
        shared = {number: self._motion_of(number).motion for number in set(map(motion_of, numbers))}
        motions = [shared[motion_of(number)] for number in numbers]
        draws = [draw(self.base, self.spread.scenarios, self._seed(number)) for number in numbers]
        stiffness, cable_damping = zip(*map(self._own, numbers), strict=True)
        true = np.array([each.friction for each in draws]) * arm.coulomb
        nominal = np.broadcast_to(arm.nominal_coulomb or arm.coulomb, true.shape)
        return Drawn(
            motion=np.array([_name(each) for each in motions]),
            motion_seed=np.array([each.seed for each in motions]),
            stiffness=np.array(stiffness),
            delay=np.array([each.delay for each in draws]),
            mass_error=(1.0 + arm.mass_error) / np.array([each.mass for each in draws]) - 1.0,
            friction=np.divide(true, nominal, out=np.ones(true.shape), where=nominal != 0.0),
            cable_hz=np.array([each.cable_hz for each in draws]),
            cable_damping=np.array(cable_damping),
        )

    def _seed(self, number: int) -> int:
        return FIRST_SEED * (1 + self.seed) + number

    def _motion_of(self, number: int) -> Experiment:
        """Whose motion and sensor a trial has."""
        return _scenario(self.base, self.spread.scenarios, self._seed(motion_of(number)))

    def _own(self, number: int) -> tuple[float, float]:
        """Stiffness of the tissue [N/m], damping ratio of the cable mode [-]."""
        stiffness, damping = random_of(self._seed(number), STREAM).uniform(size=2).tolist()
        low, high = np.log(self.spread.stiffness)
        least, most = self.spread.cable_damping or (self.base.arm.cable_damping,) * 2
        return float(np.exp(low + (high - low) * stiffness)), least + (most - least) * damping


_scenario = lru_cache(maxsize=POOL)(scenario)


def motion_of(number: int) -> int:
    """The trial whose motion this one shares: the first of its block that has it."""
    return number - number % BLOCK + number % POOL


def _name(motion: Motion) -> str:
    return motion.kind if motion.kind != "rhythm" else f"{motion.rhythm}/{motion.ventilation}"
