"""Blocks of trials computed: what they meet is made ahead, and a GPU runs many blocks at a time.

To make what a trial meets takes a core a millisecond, and a tenth of a second for each motion: more than a GPU needs to
run it. There processes make what comes next while each device runs a wave of blocks.
"""

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from functools import partial
from itertools import cycle, islice
from math import inf
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxmpc.beside import Beside
from jaxmpc.engine.registry import fastest, named
from jaxmpc.engine.scenario import program_spec, scenario_data
from jaxmpc.experiment.build import robot_on_its_tissue
from jaxmpc.loop.arm import ArmSignals
from jaxmpc.stability import whole_arm
from jaxmpc.synthesis.params import Params
from jaxmpc.xla.precision import in_float64
from jaxmpc.xla.shared import kind_of
from tuning.trials import drawn
from tuning.trials.drawn import Job
from tuning.trials.makers import made_by_processes
from tuning.trials.outcomes import Outcomes
from tuning.trials.program import Met, Shared, traced_ahead, wave_program

BLOCKS_OF_A_WAVE = 47
"""Blocks that a GPU runs at a time, 33 840 trials: of `family` an H100 runs 11 in 3.6 s, 23 in 4.8 and 35 in 5.5. For
10⁵ trials an H200 took 62 s with 47 and 67 s with 28 if nothing is compiled (54 since), else 44 s with either."""
COPIES_OF_A_BLOCK = 5
"""How often a GPU's memory holds what a block meets: two waves ahead, the one that runs, and two forms of that."""
ASKED = 0.07
"""Share of the trials on stress arms in which the force leaves 2 N, of `family`: of those the whole arm is asked."""


class Constants(NamedTuple):
    """What the trials of a job share."""

    robot: list[float]
    """All leaves of the first trial's `Robot`."""
    varied: tuple[int, ...]
    """Which of them are a trial's own."""
    structure: Any
    """Tree structure of a `Robot`."""
    signals: ArmSignals
    """Those of the first trial."""


class _Program(NamedTuple):
    """One controller's; those of one structure are calls of one compiled program."""

    run: Callable[[tuple[Met, ...], Shared], Any]
    shared: Shared


def outcomes_of(job: Job, firsts: Sequence[int]) -> Iterator[Outcomes]:
    """What came of blocks, in their order.

    Args:
        job: Who meets what.
        firsts: First trial of each block.
    """
    if not firsts:
        return
    constants, on_cpu = constants_of(job), jax.default_backend() == "cpu"
    devices = jax.local_devices()[:1] if on_cpu else jax.local_devices()
    size = 1 if on_cpu else _blocks_of_a_wave(constants, devices[0])
    make = partial(met_in_block, job, constants.varied)
    blocks = map(make, firsts) if on_cpu else made_by_processes(make, firsts)
    programs = _programs(job, constants, size)
    waves = [firsts[i : i + size] for i in range(0, len(firsts), size)]
    # Devices never wait: beside the waves that run, one more is put together, and those that have run are judged.
    with Beside(len(devices)) as running, Beside(1) as judging:
        ran, judged = deque[Future[Outcomes]](), deque[Future[list[Outcomes]]]()
        if not on_cpu:
            # While the first wave is made; its program is traced first, since two at a time make each other late.
            traced = running.submit(_traced, programs, (_sent(_blank(constants), devices[0]),) * size)
            running.submit(lambda: [finish() for finish in traced.result()])
            judging.submit(_rehearsed, job, len(waves[0]) * drawn.BLOCK, traced)
        for wave, device in zip(waves, cycle(devices), strict=False):
            met = [block if on_cpu else _sent(block, device) for block in islice(blocks, len(wave))]
            met += met[-1:] * (size - len(wave))
            ran.append(running.submit(_ran, programs, len(wave), tuple(met)))
            judged.append(judging.submit(_judged, job, wave, ran[-1]))
            del met
            if len(ran) > len(devices):
                ran.popleft().exception()  # `_judged` raises it
            while judged and (on_cpu or judged[0].done()):
                yield from judged.popleft().result()
        for each in judged:
            yield from each.result()


_sent = in_float64(jax.device_put)


def constants_of(job: Job) -> Constants:
    """What the trials of a job share."""
    robots = [robot_on_its_tissue(job.trial(i)) for i in range(drawn.POOL)]
    leaves, structure = [jax.tree.leaves(robot) for robot in robots], jax.tree.structure(robots[0])
    # What differs in these differs everywhere: which it is must not depend on how many trials there are.
    varied = tuple(k for k, values in enumerate(zip(*leaves, strict=True)) if len(set(values)) > 1)
    met = scenario_data(job.trial(0), swinging=True).signals
    assert isinstance(met, ArmSignals)
    # Judged from the start, ramps included.
    late = np.asarray(met.time) >= job.base.settle
    judged = met._replace(score=np.broadcast_to(late[..., None] * 1.0, np.shape(met.score)))
    return Constants(leaves[0], varied, structure, judged)


def met_in_block(job: Job, varied: tuple[int, ...], first: int) -> Met:
    """What the trials of a block meet."""
    trials = [job.trial(first + i) for i in range(drawn.BLOCK)]
    signals: list[Any] = [scenario_data(trial, swinging=True).signals for trial in trials[: drawn.POOL]]
    robots = [jax.tree.leaves(robot_on_its_tissue(trial)) for trial in trials]
    rows = np.array([[leaves[k] for k in varied] for leaves in robots], np.float64)
    # Trial first + POOL·copy + motion: motions lead, and are dealt to the devices.
    own = rows.reshape(drawn.COPIES, drawn.POOL, len(varied)).transpose(1, 0, 2)
    heart, between, noise = (
        np.concatenate([getattr(each, name) for each in signals]) for name in ("heart", "between", "noise")
    )
    return Met(heart, between, noise, own)


def _blocks_of_a_wave(constants: Constants, device: jax.Device) -> int:
    """How many a GPU runs at a time: fewer where its memory is short."""
    block = sum(array.nbytes for array in _blank(constants))
    room = (device.memory_stats() or {}).get("bytes_limit", inf)
    return int(max(1, min(BLOCKS_OF_A_WAVE, room / (COPIES_OF_A_BLOCK * block))))


def _blank(constants: Constants) -> Met:
    """Nothing, in the form of a block."""
    signals = constants.signals
    heart, between, noise = (
        np.zeros((drawn.POOL, *np.shape(each)[1:])) for each in (signals.heart, signals.between, signals.noise)
    )
    return Met(heart, between, noise, np.zeros((drawn.POOL, drawn.COPIES, len(constants.varied))))


@in_float64
def _traced(programs: list[_Program], met: tuple[Met, ...]) -> list[Callable[[], None]]:
    kinds = {kind_of(program.shared): program for program in programs}.values()
    return [traced_ahead(program.run, met, program.shared) for program in kinds]


@in_float64
def _rehearsed(job: Job, trials: int, after: Future[Any]) -> None:
    """Ask the whole arm of as many as a wave on stress arms will: its programs take as long as the wave's."""
    asked = round(ASKED * trials)
    if job.spread.arms == drawn.HARD.arms and asked >= whole_arm.MANY:
        after.exception()
        for params in job.controllers:
            whole_arm.lost(params, [job.trial(0)] * asked)


def _programs(job: Job, constants: Constants, size: int) -> list[_Program]:
    base = job.trial(0)
    spec = named(fastest(program_spec(base)), job.engine)
    run = wave_program(spec, constants.varied, constants.structure, size * drawn.POOL)
    path, limit = base.loop_path(), base.force_limit
    # Each alone: of several at a time XLA makes another program, with other bits, and who is tried beside would matter.
    alone = (Params.stack([params]) for params in job.controllers)
    return [_Program(run, Shared(one, constants.robot, constants.signals, path, limit)) for one in alone]


@in_float64
def _ran(programs: list[_Program], blocks: int, met: tuple[Met, ...]) -> Outcomes:
    """What came of so many blocks of a wave, one after another; nobody has asked the whole arm yet."""
    of_each = [[np.asarray(field) for field in program.run(met, program.shared)] for program in programs]
    stacked = [np.concatenate(each, 2) for each in zip(*of_each, strict=True)]
    cut = -1, drawn.POOL, drawn.COPIES
    # Motions led; trial first + POOL·copy + motion.
    flat = [field.reshape(*cut, *field.shape[2:]).swapaxes(1, 2)[:blocks] for field in stacked]
    flat = [field.reshape(blocks * drawn.BLOCK, *field.shape[3:]) for field in flat]
    flat[0] = flat[0].astype(np.int8)
    return Outcomes(*[*flat, np.zeros(flat[0].shape, bool)])


@in_float64
def _judged(job: Job, wave: Sequence[int], running: Future[Outcomes]) -> list[Outcomes]:
    """The blocks of a wave, each by itself; the whole arm is asked where the force left 2 N."""
    ran = running.result()
    numbers = [first + i for first in wave for i in range(drawn.BLOCK)]
    for c, params in enumerate(job.controllers):
        asked = np.flatnonzero(ran.beyond[:, c])
        ran.whole_arm_unstable[asked, c] = whole_arm.lost(params, [job.trial(numbers[i]) for i in asked])
    return [Outcomes(*each) for each in zip(*(np.split(field, len(wave)) for field in ran), strict=True)]
