"""What to tune, as a TOML file: experiment, starting point, free parameters, goals."""

from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from msgspec.structs import replace

from jaxmpc import described
from jaxmpc.experiment import Experiment
from jaxmpc.files.errors import InputError
from jaxmpc.files.sealed import digest
from jaxmpc.files.toml import located, read_toml
from jaxmpc.quantities import MARGINS
from jaxmpc.stability.family import judged_where
from jaxmpc.synthesis.params import Params
from jaxmpc.synthesis.sampling import check_sampling
from tuning.job.axes import axes_of, begun, check_axis, check_horizons
from tuning.job.built import made_plain
from tuning.job.goals import GOALS, MEASURED, OVERSHOOT, check_goals, refuse_goals_of_joints
from tuning.job.implied import implied_goals
from tuning.job.risk import Risk
from tuning.job.scenarios import Scenarios
from tuning.job.settings import TuneSettings
from tuning.job.space import FREE, KNOTS, Bounds, SearchSpace, axis_of
from tuning.job.tables import HARD, SOFT, read_tables

MAKE_SPEC = "Read one with TuneSpec.from_toml(FILE)."
"""What to do about a job that is none."""


class TuneSpec(msgspec.Struct, frozen=True, dict=True):
    """A tuning job; `from_toml`, or built in Python.

    Raises:
        InputError: Names key, value, bound and remedy.
    """

    experiment: Experiment
    params: Params
    """Where the first start stands, and the values of what is frozen."""
    baseline: Params | None = None
    """What the result is compared with, and what ratios are taken to; None is `params`."""
    baseline_compensation: float | None = None
    """Share of the joints' friction that this one compensates [-]; None is the experiment's, as for the tuned one."""
    tune: TuneSettings = TuneSettings()
    free: Mapping[str, Bounds | None] = msgspec.field(default_factory=lambda: dict.fromkeys(FREE))
    """Free parameters and their bounds; None takes the default ones."""
    goals: Mapping[str, float] = msgspec.field(default_factory=lambda: dict(HARD))
    """Hard goals as given: limits that are held, of margins at every stiffness between the softest and the hardest."""
    soft: Mapping[str, float] = msgspec.field(default_factory=lambda: dict(SOFT))
    """Soft goals: what is minimised, each relative to its limit."""
    ideal: bool = False
    """Whether margins are those of the ideal loop, or of the loop as it runs."""
    scenarios: Scenarios = Scenarios()
    risk: Risk = Risk()
    pareto: Mapping[str, tuple[float, ...]] = msgspec.field(default_factory=dict)
    """Limits of hard goals for which the front is wanted; empty for no front."""
    engine: str | None = None
    """What evaluates the loops; None is the fastest here. No part of what the job is: engines differ in rounding."""

    def __post_init__(self) -> None:
        made_plain(self)
        self.tune.check()
        self.scenarios.check(self.experiment)
        check_goals(self.goals, "goals", GOALS)
        check_goals(self.soft, "goals.soft", MEASURED)
        for name, limits in self.pareto.items():
            if not isinstance(limits, list | tuple) or not limits:
                raise InputError(f"pareto.{name}", limits, "a list of limits", "Write such as [1.6, 2.0, 3.0].")
            for limit in limits:
                check_goals({name: limit}, "pareto", GOALS)
        if self.params.batch_shape:
            raise InputError("params", f"a batch {self.params.batch_shape}", "one controller", "Give one start point.")
        if not self.free:
            raise InputError("tune.free", "empty", "at least one parameter", f"Free by default: {', '.join(FREE)}.")
        check_sampling(self.params, self.experiment.sampling_time)
        self._check_orders()
        self._check_knots()
        self._check_arm()
        for key, prefix in (("diagonals", ""), ("tied", KNOTS)):
            for name in getattr(self.tune, key):
                if prefix + name not in self.free:
                    remedy = f"Add `{prefix}{name} = true` to [tune.free]."
                    raise InputError(f"tune.{key}", name, "a free parameter", remedy)
        for axis in self.space.axes:
            check_axis(axis, self.space.base)
        check_horizons(self.space.axes)
        self._check_lengths()

    def _goals(self) -> Iterator[tuple[str, Mapping[str, Any]]]:
        """Tables of the job's file that name goals."""
        yield from (("goals.soft", self.soft), ("goals", self.goals), ("pareto", self.pareto))

    def _check_lengths(self) -> None:
        """Refuse runs in which nothing would count, those of the proof too, which come last."""
        _ = self.experiment.scored
        try:
            _ = msgspec.structs.replace(self.experiment, duration=self.tune.duration, settle=self.tune.settle).scored
        except InputError as error:
            raise InputError(f"tune.{error.key}", error.value, error.bound, error.remedy) from None

    def _check_orders(self) -> None:
        """Refuse other orders than that of the parameters where Q_p stays: each order has one of its own."""
        others = [order for order in self.tune.orders if order != self.params.disturbance_order]
        if others and not self.params.knots and "Q_p" not in self.free:
            bound = f"the order of params (= {self.params.disturbance_order}) alone where Q_p is not free"
            raise InputError("tune.orders", list(self.tune.orders), bound, "Add `Q_p = true` to [tune.free].")

    def _check_arm(self) -> None:
        """Refuse what only an arm can have, and what no robot's arm has."""
        if self.ideal and self.experiment.limited:
            remedy = (
                "Leave it out: freezing judges a robot's loop as it runs. "
                "A study has experiment.arm.joint_torque_limit and torque_step_limit of 0."
            )
            raise InputError("goals.ideal", True, "false on an arm with a robot's limits", remedy)
        if self.on_arm:
            return
        if self.tune.mapping != TuneSettings().mapping:
            remedy = 'Set experiment.physics = "wam" or remove it: runs of the linear loop need no spectra.'
            raise InputError("tune.mapping", self.tune.mapping, "given on the arm only", remedy)
        for key, goals in self._goals():
            refuse_goals_of_joints(goals, key)
        remedy = 'Tune it on the arm, experiment.physics = "wam"; freezing refuses it too.'
        if self.params.guarded:
            raise InputError("params.guarded", True, "false on the linear loop", remedy)
        if self.baseline_compensation is not None:
            remedy = 'Set experiment.physics = "wam" or remove baseline.compensation.'
            raise InputError("baseline.compensation", self.baseline_compensation, "given on the arm only", remedy)

    def _check_knots(self) -> None:
        """Refuse what would leave a knot without a judge."""
        if self.params.listening is None:
            return
        if not self.on_arm:
            remedy = 'The linear world finds no stiffness: take published = "family-wam".'
            raise InputError("experiment.physics", self.experiment.physics, "an arm for a job with knots", remedy)
        for K in self.params.listening.stiffness:
            if K not in self.experiment.stiffness:
                remedy = f"Add {K:g}: a knot is judged on tissue of its own stiffness."
                raise InputError("experiment.stiffness", list(self.experiment.stiffness), "with every knot's", remedy)
        for key, goals in self._goals():
            if OVERSHOOT in goals:
                remedy = "It is of the fixed gains alone."
                raise InputError(f"{key}.{OVERSHOOT}", goals[OVERSHOOT], "left out with knots", remedy)

    def __repr__(self) -> str:
        lines = [described.Line(title, text, "", "") for title, text in self.resolved().items()]
        return described.as_text(f"TuneSpec, {self.tune.starts} starts, {self.tune.steps} steps", lines)

    def resolved(self) -> dict[str, str]:
        """Title and text of some lines: what is tuned on what, held to what, met where."""
        experiment, met = self.experiment, self.scenarios
        tissues = ", ".join(f"{K:g}" for K in experiment.stiffness)
        hard = [f"{name} {GOALS[name].sign} {GOALS[name].amount(limit)}" for name, limit in self.goals.items()]
        implied = [f"{name} {GOALS[name].sign} {GOALS[name].amount(limit)}" for name, limit in self.implied.items()]
        start = {axis.name: self.space.base.to_dict().get(axis.name) for axis in self.space.axes}
        return {
            "experiment": f"{experiment.name}, physics {experiment.physics}, {experiment.duration:g} s, "
            f"K_s {tissues} N/m",
            "free": ", ".join(name if value is None else f"{name} from {value:.4g}" for name, value in start.items()),
            "held": ", ".join(hard) + (f"; for a robot {', '.join(implied)}" if implied else ""),
            "minimised": ", ".join(f"{name} over {limit:g}" for name, limit in self.soft.items()),
            "met": f"rhythms {', '.join(met.rhythms) or 'none'}; friction ±{100 * met.friction:g} %, "
            f"masses ±{100 * met.mass:g} %, delay {', '.join(map(str, met.delays)) or experiment.delay}",
            "risk": ", ".join(f"{name} {value}" for name, value in self.to_dict()["risk"].items()),
        }

    @property
    def before(self) -> Params:
        """The controller before tuning."""
        return self.baseline or self.params

    def met_before(self, met: Sequence[Experiment]) -> list[Experiment]:
        """Scenarios as the controller before tuning meets them."""
        share = self.baseline_compensation
        if share is None or self.experiment.physics == "linear":
            return list(met)
        return [replace(one, arm=replace(one.arm, compensation=share)) for one in met]

    def with_order(self, order: int) -> "TuneSpec":
        """The same job with an active state of another order; Q_p then starts and moves where that order has it."""
        if order == self.params.disturbance_order:
            return self
        axis = axis_of("Q_p", None, False, order)
        middle = {"Q_p": float(np.sqrt(axis.low * axis.high))}
        values = {**self.params.to_dict(), "disturbance_order": order, **middle}
        if self.params.knots:
            values["knots"] = [{**knot, **middle} for knot in values["knots"]]
        free = {name: None if name.rpartition(".")[2] == "Q_p" else bounds for name, bounds in self.free.items()}
        return replace(self, params=Params.from_dict(values), baseline=self.before, free=free)

    @cached_property
    def space(self) -> SearchSpace:
        """The free parameters as one vector; free filters begin as the experiment's."""
        axes = axes_of(self.free, self.tune.diagonals, self.tune.tied, self.params)
        return SearchSpace(begun(self.params, axes, self.experiment), axes)

    @property
    def on_arm(self) -> bool:
        """Whether runs of the arm decide, which spectra propose; else those of the linear loop."""
        return self.experiment.physics != "linear"

    @cached_property
    def judged_at(self) -> np.ndarray:
        """Stiffnesses at which margins are judged [N/m]: the experiment's, and many between."""
        own = np.asarray(self.experiment.stiffness)
        between = np.geomspace(own.min(), own.max(), self.tune.margin_points) if len(own) > 1 else own[:0]
        return np.unique(np.concatenate([own, between]))

    @property
    def fixed_stay(self) -> bool:
        """Whether it is a family whose knots alone are free."""
        return all(axis.knots for axis in self.space.axes)

    def judged_known(self, *counts: int) -> tuple[np.ndarray, np.ndarray]:
        """Where margins are judged with the stiffness known: K_s and K̂, (cells,) each [N/m]; none without knots.

        Args:
            counts: How many known stiffnesses and ratios, where not as `jaxmpc freeze` judges.
        """
        if self.params.listening is None:
            return np.zeros(0), np.zeros(0)
        known, ratios = judged_where(self.params.listening, *counts)
        return np.outer(known, ratios).ravel(), np.repeat(known, len(ratios))

    @property
    def implied(self) -> dict[str, float]:
        """Hard goals that freezing for a robot implies where none is given."""
        found = implied_goals(self.experiment)
        return {name: limit for name, limit in found.items() if name not in self.goals}

    @property
    def held(self) -> dict[str, float]:
        """All hard goals, those that are implied included."""
        return {**self.goals, **self.implied}

    @property
    def margin_goals(self) -> dict[str, float]:
        """Hard goals on margins, sorted as JAX sorts the keys of what it traces."""
        return {name: limit for name, limit in sorted(self.held.items()) if name in MARGINS}

    @property
    def hard_goals(self) -> dict[str, float]:
        """Hard goals on what the runs measure, sorted likewise."""
        return {name: limit for name, limit in sorted(self.held.items()) if name in MEASURED}

    @cached_property
    def digest(self) -> str:
        """Hash of the whole job, all defaults written out, and of the order in which vectors and fronts have them."""
        order = [[axis.name for axis in self.space.axes], list(self.pareto)]
        return digest({**self.to_dict(), "experiment": self.experiment.content, "order": order})

    def to_dict(self) -> dict[str, Any]:
        """Plain data, every default written out."""
        free = {axis.name: [axis.low, axis.high] for axis in self.space.axes}
        return {
            "experiment": self.experiment.to_dict(),
            "params": self.params.to_dict(),
            "baseline": {**self.before.to_dict(), "compensation": self.baseline_compensation},
            "tune": {**msgspec.to_builtins(self.tune), "free": free},
            "goals": {**self.held, "ideal": self.ideal, "soft": dict(self.soft)},
            "scenarios": msgspec.to_builtins(self.scenarios),
            "risk": {key: value for key, value in msgspec.to_builtins(self.risk).items() if value is not None},
            "pareto": {name: list(limits) for name, limits in self.pareto.items()},
        }

    @staticmethod
    def from_toml(path: str | Path) -> "TuneSpec":
        """A job from its file; files that it names are looked for beside it.

        Raises:
            InputError: Names file, line, key, value, bound and remedy.
        """
        data = read_toml(path)
        with located(path):
            return TuneSpec.from_dict(data, Path(path).parent)

    @staticmethod
    def from_dict(data: Mapping[str, Any], folder: Path = Path()) -> "TuneSpec":
        """A job from plain data, as the TOML file has it.

        Args:
            data: Tables experiment, params, baseline, tune, goals, scenarios, risk, pareto; each may be left out.
            folder: Where files that it names lie.

        Raises:
            InputError: Names key, value, bound and remedy.
        """
        spec = TuneSpec(**read_tables(data, folder))
        for order in spec.tune.orders:
            spec.with_order(order)  # what is wrong with one is told before any is tuned
        return spec
