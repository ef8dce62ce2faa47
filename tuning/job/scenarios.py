"""What a controller may meet: one seed draws rhythm, phases, friction, masses, delay and noise of one scenario."""

from collections.abc import Sequence
from functools import lru_cache
from typing import Annotated, Literal, NamedTuple

import jax
import msgspec
import numpy as np

from jaxmpc import described
from jaxmpc.engine.base import ScenarioData
from jaxmpc.engine.scenario import scenario_data, side_by_side
from jaxmpc.experiment import Experiment
from jaxmpc.experiment.tables import Change
from jaxmpc.files.errors import InputError
from jaxmpc.world.heart.motion import Motion

RHYTHMS = (
    "own",
    "steady",
    "variability",
    "rate-step",
    "premature",
    "bigeminy",
    "fibrillation",
    "hold",
    "cough",
)
"""The experiment's own motion, the rhythms of `world.rhythm`, and two events of the ventilation."""
STREAM = 7
"""Stream of the random numbers of a scenario, apart from those of its motion and noise."""
KEPT = 48
"""Scenarios whose arrays are kept: 5 MB each of 25 s on the arm."""
EVENT_AFTER = 0.2
"""Where in the scored part a rate step, hold or cough begins if it would come too late otherwise [-]."""

Share = Annotated[float, msgspec.Meta(ge=0.0, le=0.9)]
Rhythm = Literal["own", "steady", "variability", "rate-step", "premature", "bigeminy", "fibrillation", "hold", "cough"]


class Scenarios(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The table [scenarios]: how far reality may lie from the experiment."""

    rhythms: tuple[Rhythm, ...] = ("own",)
    """Taken in turn, seed by seed."""
    friction: Share = 0.0
    """Half-width of a factor on each joint's Coulomb and viscous friction [-]; on the arm alone."""
    mass: Share = 0.0
    """Half-width of a factor on the true masses over the believed ones [-]; on the arm alone."""
    stiffness: Share = 0.0
    """Half-width of a factor on the tissue's stiffness [-]; on the arm alone."""
    delays: tuple[Annotated[int, msgspec.Meta(ge=1, le=2)], ...] = ()
    """Delays to choose from [samples]; none is the experiment's own. Margins are judged at the experiment's."""
    cable_hz: tuple[Annotated[float, msgspec.Meta(gt=0.0, le=300.0)], ...] = ()
    """Lowest and highest cable mode [Hz]; none is the experiment's own. On the arm alone."""

    def __repr__(self) -> str:
        return described.as_text(*described.settings(self, {"delays": "samples", "cable_hz": "Hz"}))

    def check(self, experiment: Experiment) -> None:
        """Refuse what an experiment cannot show.

        Raises:
            InputError: Names key, value, bound and remedy.
        """
        if not self.rhythms:
            raise InputError("scenarios.rhythms", "[]", "at least one rhythm", 'Give ["own"] for the experiment\'s.')
        if len(self.cable_hz) not in (0, 2) or list(self.cable_hz) != sorted(self.cable_hz):
            raise InputError("scenarios.cable_hz", list(self.cable_hz), "[lowest, highest] Hz", "Give both, in order.")
        if self.cable_hz and experiment.physics != "linear":
            try:
                stiffest = msgspec.structs.replace(experiment.arm, cable_hz=self.cable_hz[1])
                msgspec.structs.replace(experiment, arm=stiffest)
            except InputError as error:
                key, remedy = "scenarios.cable_hz", f"{error.remedy.rstrip('.')} in [experiment], or lower it."
                raise InputError(key, list(self.cable_hz), error.bound, remedy) from None
        arm = experiment.arm
        if self.friction and experiment.physics != "linear" and not any((*arm.coulomb, *arm.viscous)):
            remedy = "Remove it, or give the joints friction."
            raise InputError("scenarios.friction", self.friction, "given where the arm has friction", remedy)
        if experiment.physics == "linear":
            for key in ("friction", "mass", "stiffness", "delays", "cable_hz"):
                if value := getattr(self, key):
                    remedy = f'Set experiment.physics = "wam" or remove scenarios.{key}.'
                    raise InputError(f"scenarios.{key}", value, "given on the arm only", remedy)


class Draw(NamedTuple):
    """How far the robot and tissue of one scenario lie from the experiment's."""

    friction: np.ndarray
    """Factor on Coulomb and viscous friction, (joints,) [-]."""
    mass: float
    """Factor on the true masses over the believed ones [-]."""
    stiffness: float
    """Factor on the tissue's [-]."""
    delay: int
    """Between command and effect [samples]."""
    cable_hz: float
    """Mode of the cables [Hz]."""


def draw(base: Experiment, settings: Scenarios, seed: int) -> Draw:
    """What a seed draws of robot and tissue, without an experiment around it; on the arm alone they count."""
    # Everything is drawn whether it is used or not, so that one half-width does not change what another draws.
    *joints, mass, stiffness, delay, cable = random_of(seed, STREAM).uniform(-1.0, 1.0, 8).tolist()
    chosen, cable_hz = settings.delays or (base.delay,), base.arm.cable_hz
    if settings.cable_hz:
        low, high = np.log(settings.cable_hz)
        cable_hz = float(np.exp(low + (high - low) * 0.5 * (1.0 + cable)))
    return Draw(
        friction=1.0 + settings.friction * np.array(joints),
        mass=1.0 + settings.mass * mass,
        stiffness=1.0 + settings.stiffness * stiffness,
        delay=chosen[int(0.5 * (1.0 + delay) * len(chosen)) % len(chosen)],
        cable_hz=cable_hz,
    )


def scenario(base: Experiment, settings: Scenarios, seed: int) -> Experiment:
    """The experiment that a seed stands for; the same seed is the same scenario whatever else is drawn.

    A joint's friction is multiplied as a whole, Coulomb and viscous. The arm itself is always the one of the MJCF:
    heavier than believed means that the controller believes less, (1 + mass_error)/factor. What it compensates of
    friction stays what it believes of the nominal arm.
    """
    drawn = base.with_seed(seed)
    rhythm = settings.rhythms[seed % len(settings.rhythms)]
    drawn = msgspec.structs.replace(drawn, motion=_motion(drawn, rhythm, seed))
    if base.physics == "linear":
        return drawn
    own, arm, tissue = draw(base, settings, seed), base.arm, base.tissue
    if settings.stiffness:
        # A change tells the stiffness over the experiment's, not over what was drawn.
        later = (msgspec.structs.replace(each, factor=own.stiffness * each.factor) for each in tissue.changes)
        tissue = msgspec.structs.replace(tissue, changes=(Change(0.0, own.stiffness, 0.0), *later))
    arm = msgspec.structs.replace(
        arm,
        coulomb=tuple((own.friction * arm.coulomb).tolist()),
        viscous=tuple((own.friction * arm.viscous).tolist()),
        mass_error=(1.0 + arm.mass_error) / own.mass - 1.0,
        nominal_coulomb=arm.nominal_coulomb or arm.coulomb,
        nominal_viscous=arm.nominal_viscous or arm.viscous,
        cable_hz=own.cable_hz,
    )
    return msgspec.structs.replace(drawn, arm=arm, tissue=tissue, delay=own.delay)


def random_of(seed: int, stream: int) -> np.random.Generator:
    """Random numbers of a seed, apart from those of its other streams."""
    return np.random.Generator(np.random.Philox([seed, stream]))


def scenarios(base: Experiment, settings: Scenarios, seeds: Sequence[int]) -> list[Experiment]:
    """One experiment per seed."""
    return [scenario(base, settings, seed) for seed in seeds]


def scene_over(experiments: Sequence[Experiment], swinging: bool = True) -> ScenarioData:
    """Several scenarios of one experiment as one scene, each with axes of its own; rest as for `scenario_data`."""
    return _joined(tuple(experiments), swinging, jax.config.jax_enable_x64)


@lru_cache(maxsize=2)  # what is compiled ahead for a proof is met again in it: in validation, and held out
def _joined(experiments: tuple[Experiment, ...], swinging: bool, in_float64: bool) -> ScenarioData:
    return side_by_side([_data(experiment, swinging, in_float64) for experiment in experiments])


@lru_cache(maxsize=KEPT)  # scenes share scenarios
def _data(experiment: Experiment, swinging: bool, _in_float64: bool) -> ScenarioData:
    return scenario_data(experiment, swinging)


def describe(experiment: Experiment) -> str:
    """What sets a scenario apart, in a few words."""
    motion, arm = experiment.motion, experiment.arm
    events = {"steady": motion.rhythm, "hold": "ventilator hold", "cough": "cough"}
    name = events[motion.ventilation] if motion.kind == "rhythm" else motion.kind
    words = [f"{name}, seed {motion.seed}"]
    if experiment.physics != "linear":
        nominal = np.array(arm.nominal_coulomb or arm.coulomb)
        factors = np.divide(arm.coulomb, nominal, out=np.ones(len(nominal)), where=nominal != 0.0)
        words += [
            f"friction × {', '.join(f'{factor:.2f}' for factor in factors)}",
            f"masses believed {100 * arm.mass_error:+.0f} %",
        ]
        words += [f"delay {experiment.delay}"] if experiment.delay > 1 else []
        words += [f"cable {arm.cable_hz:.0f} Hz"] if arm.cable_hz else []
    return "; ".join(words)


def _motion(drawn: Experiment, rhythm: str, seed: int) -> Motion:
    if rhythm == "own":
        return drawn.motion
    own = drawn.motion
    event = drawn.settle + EVENT_AFTER * (drawn.duration - drawn.settle)
    beats = rhythm if rhythm not in ("hold", "cough") else "steady"
    defaults = Motion()
    return Motion(
        kind="rhythm",
        scale=own.scale,
        phases="random",
        seed=seed,
        start=own.start,
        fade=own.fade,
        rhythm=beats,  # type: ignore[arg-type]  # one of Rhythm, without "own", "hold" and "cough"
        ventilation=rhythm if rhythm in ("hold", "cough") else "steady",  # type: ignore[arg-type]  # both exist
        rate_step_at=min(defaults.rate_step_at, event),
        ventilation_at=min(defaults.ventilation_at, event),
        hold_duration=max(1.0, min(defaults.hold_duration, 0.5 * (drawn.duration - event))),
    )
