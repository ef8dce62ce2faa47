"""An experiment: stiffness set × heart motion × force reference × imperfections, as a TOML file."""

from functools import cached_property
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import msgspec
import numpy as np

from jaxmpc.errors import InputError, nearest
from jaxmpc.params import HP_MAX, Timing
from jaxmpc.world import heart
from jaxmpc.world.reference import Reference, wanted_force

AXES = ("x", "y", "z")
Seed = Annotated[int, msgspec.Meta(ge=0, le=2**63 - 1)]
Seconds = Annotated[float, msgspec.Meta(ge=0.0, le=3600.0)]
Size = Annotated[float, msgspec.Meta(ge=0.0, le=100.0)]
Stiffness = Annotated[float, msgspec.Meta(gt=0.0, le=1e6)]


class Motion(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How the heart moves."""

    kind: Literal["harmonics", "recording", "none"] = "harmonics"
    scale: Size = 1.0
    """Factor on the displacement [-]."""
    phases: Literal["table", "random"] = "table"
    """Phases of the harmonics: the table's, or drawn from `seed`."""
    seed: Seed = 0
    file: str = ""
    """A recording, CSV or npz; relative to the experiment's file."""
    unit: Literal["m", "mm"] = "m"
    repeat: bool = False
    start: Seconds = 0.0
    """When the motion begins [s]."""
    fade: Seconds = 1.0
    """Time in which it grows to its full size [s]."""


class Sensor(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The JR3 force sensor; zero switches an imperfection off."""

    noise: Size = 0.010
    """Standard deviation of white noise per sample [N] (prior; the maker publishes none)."""
    lsb: tuple[Size, Size, Size] = (0.0061, 0.0061, 0.0122)
    """Least significant bit per axis, 2¹⁴ counts on 100/100/200 N [N]."""
    lowpass_hz: Annotated[float, msgspec.Meta(ge=0.0, le=1e4)] = 0.0
    """Cut-off of the built-in low-pass [Hz]; the fastest of the JR3 is 500."""
    seed: Seed = 0


class Signals(NamedTuple):
    """What the loop meets at each sample, the same for every controller."""

    heart: np.ndarray
    """Position of the heart's surface, shape (steps, 3) [m]."""
    noise: np.ndarray
    """Sensor noise, shape (steps, 3) [N]."""
    force_ref: np.ndarray
    """Wanted force, shape (steps, 3), longer by `HP_MAX` with preview [N]."""
    score: np.ndarray
    """Whether a sample counts in the metrics, shape (steps, 3)."""


class Experiment(msgspec.Struct, frozen=True, forbid_unknown_fields=True, dict=True):
    """One experiment; `from_toml`, `published`, or built in Python. Times in [s], forces in [N]."""

    name: str = "experiment"
    duration: Annotated[float, msgspec.Meta(gt=0.0, le=3600.0)] = 25.0
    settle: Seconds = 5.0
    """What is left out of the metrics at the start [s]; ramps are left out as well."""
    stiffness: tuple[Stiffness, ...] = (375.0, 810.0, 1900.0)
    """Tissue stiffnesses K_s [N/m]."""
    damping: Literal["ideal", "sampled"] = "ideal"
    """"ideal": the paper's (6). "sampled": through the velocity, sampled, filtered and delayed as on the robot."""
    velocity_lowpass: Annotated[float, msgspec.Meta(ge=0.0, le=1e5)] = 180.0
    """Cut-off of the velocity filter, for sampled damping [rad/s]."""
    sampling_time: Annotated[float, msgspec.Meta(ge=1e-5, le=0.1)] = 1e-3
    """T_s [s]."""
    delay: Annotated[int, msgspec.Meta(ge=1, le=2)] = 1
    """Samples between a command and its effect [samples]."""
    motion: Motion = Motion()
    reference: Reference = Reference()
    sensor: Sensor = Sensor()

    def __post_init__(self) -> None:
        if not self.stiffness:
            raise InputError("stiffness", "[]", "at least one stiffness [N/m]", "The paper has [375.0, 810.0, 1900.0].")
        if self.settle >= self.duration:
            remedy = "Lower settle or raise duration."
            raise InputError("settle", self.settle, f"below duration (= {self.duration:g} s)", remedy)
        if (self.motion.kind == "recording") != bool(self.motion.file):
            remedy = 'Give both motion.kind = "recording" and motion.file = "…", or neither.'
            raise InputError("motion.file", self.motion.file or "missing", "given for a recording only", remedy)

    @property
    def timing(self) -> Timing:
        """Sampling of the controller and delay of the world."""
        return Timing(self.sampling_time, self.delay)

    @property
    def steps(self) -> int:
        """Number of samples."""
        return round(self.duration / self.sampling_time)

    @staticmethod
    def published(name: str) -> "Experiment":
        """An experiment of the paper: "table-1" or "figure-3".

        Raises:
            InputError: The name is not one of these.
        """
        folder = resources.files("jaxmpc") / "experiments"
        known = sorted(entry.name.removesuffix(".toml") for entry in folder.iterdir() if entry.name.endswith(".toml"))
        if name not in known:
            raise InputError("published experiment", name, "a known name", nearest(name, known))
        with resources.as_file(folder / f"{name}.toml") as path:
            return Experiment.from_toml(path)

    @staticmethod
    def from_toml(path: str | Path) -> "Experiment":
        """An experiment from its file; a recording is looked for beside it.

        Raises:
            InputError: Names file, line, key, value, bound and remedy.
        """
        from jaxmpc.spec import located, read_toml

        data = read_toml(path)
        with located(path):
            return Experiment.from_dict(data, Path(path).parent)

    @staticmethod
    def from_dict(data: dict[str, Any], folder: Path | None = None, root: str = "") -> "Experiment":
        """An experiment from plain data.

        Args:
            data: Keys as in the TOML file.
            folder: Where a recording with a relative path lies.
            root: Name of the table that `data` is, for messages.

        Raises:
            InputError: A key is unknown, a value of the wrong type or out of bounds, a recording unusable.
        """
        from jaxmpc.spec import convert, known_keys

        known_keys(Experiment, data, root)
        for key, kind in (("motion", Motion), ("reference", Reference), ("sensor", Sensor)):
            if isinstance(table := data.get(key), dict):
                known_keys(kind, table, f"{root}.{key}".lstrip("."))
        experiment = convert(data, Experiment, root)
        if experiment.motion.file and folder is not None:
            found = str(folder / experiment.motion.file)
            motion = msgspec.structs.replace(experiment.motion, file=found)
            experiment = msgspec.structs.replace(experiment, motion=motion)
        if experiment.motion.kind == "recording":
            _ = experiment.signals
        return experiment

    def with_seed(self, seed: int) -> "Experiment":
        """The same experiment with the phases of the motion and the sensor noise drawn anew."""
        motion = msgspec.structs.replace(self.motion, phases="random", seed=seed)
        return msgspec.structs.replace(self, motion=motion, sensor=msgspec.structs.replace(self.sensor, seed=seed))

    def to_dict(self) -> dict[str, Any]:
        """Plain data, every default written out; for hashes and manifests."""
        data: dict[str, Any] = msgspec.to_builtins(self)
        return data

    @cached_property
    def signals(self) -> Signals:
        """Everything that does not depend on the controller, computed once on the host."""
        t = np.arange(self.steps) * self.sampling_time
        horizon = HP_MAX if self.reference.preview else 0
        ahead = np.arange(self.steps + horizon) * self.sampling_time
        wanted, ramps = zip(*(wanted_force(getattr(self.reference, axis), ahead) for axis in AXES), strict=True)
        score = (t >= self.settle)[:, None] & ~np.stack(ramps, 1)[: self.steps]
        if not score.any(axis=0).all():
            raise InputError("settle", self.settle, "shorter", "No sample is left to score: all are settling or ramps.")
        noise = np.random.Generator(np.random.Philox([self.sensor.seed, 1])).standard_normal((self.steps, 3))
        return Signals(self._heart(t), self.sensor.noise * noise, np.stack(wanted, 1), score)

    def _heart(self, t: np.ndarray) -> np.ndarray:
        motion = self.motion
        if motion.kind == "none":
            return np.zeros((len(t), 3))
        grown = heart.fade_in(t, motion.start, motion.fade)[:, None]
        if motion.kind == "harmonics":
            seed = motion.seed if motion.phases == "random" else None
            template: np.ndarray = grown * heart.harmonic_motion(t, motion.scale, seed)
            return template
        times, values = heart.read_recording(motion.file, motion.unit)
        played = heart.recorded_motion(np.maximum(t - motion.start, 0.0), times, values, motion.repeat, motion.file)
        moved: np.ndarray = grown * motion.scale * played
        return moved
