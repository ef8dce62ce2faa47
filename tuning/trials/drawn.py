"""What a trial meets, drawn from its seed and number alone: robot, tissue, delay, rhythm."""

from dataclasses import dataclass
from functools import lru_cache
from math import ceil
from typing import NamedTuple, get_args

import msgspec
import numpy as np
from msgspec.structs import replace

from jaxmpc.experiment import Experiment
from jaxmpc.files.errors import InputError
from jaxmpc.files.sealed import digest
from jaxmpc.synthesis.params import Params
from jaxmpc.synthesis.sampling import check_sampling
from tuning.job.scenarios import Rhythm, Scenarios, scenario

DURATION, SETTLE = 30.0, 2.0
"""Length of a trial, and what is not judged of it [s]: a guard has found its gain by the end, and probed it."""
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
        engine: Which one runs them; None is the fastest here.

    Raises:
        InputError: The experiment is not on the arm ("wam"), or the seed is out of bounds.
    """

    controllers: tuple[Params, ...]
    base: Experiment
    spread: Spread = NOMINAL
    seed: int = 0
    engine: str | None = None

    def __post_init__(self) -> None:
        if self.base.physics != "wam":
            raise InputError("physics", self.base.physics, '"wam" for trials', "Take table-1-wam, or set it so.")
        if not 0 <= self.seed < 10**9:
            raise InputError("seed", self.seed, "in [0, 1e9)", "Any other number draws other trials.")
        for params in self.controllers:
            check_sampling(params, self.base.sampling_time)
        # Those of the spread are for 1 ms.
        resolving = ceil(self.spread.substeps * max(1.0, self.base.sampling_time / 1e-3) - 1e-9)
        arm = replace(self.base.arm, substeps=max(self.base.arm.substeps, resolving))
        short = replace(self.base, duration=DURATION, settle=SETTLE, arm=arm)
        object.__setattr__(self, "base", short)

    @property
    def digest(self) -> str:
        """sha256 of all that the outcome of a trial depends on; engines and devices differ in rounding alone."""
        controllers = [params.to_dict() for params in self.controllers]
        spread = msgspec.to_builtins(self.spread)
        return digest([controllers, self.base.content, spread, self.seed, POOL, COPIES])

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
