"""An experiment: stiffness set × heart motion × force reference × imperfections, as a TOML file."""

import hashlib
from contextlib import suppress
from functools import cached_property
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np

from jaxmpc import described
from jaxmpc.experiment.reference import Reference
from jaxmpc.experiment.signals import Signals, fixed, scored
from jaxmpc.experiment.tables import ArmSettings, SensorSettings, TissueSettings
from jaxmpc.experiment.together import TABLES, check_kinds, check_together, tuple_of_floats
from jaxmpc.files.errors import InputError, check_table, nearest, plain_name
from jaxmpc.files.foreign import LARGEST_RECORDING, read_bytes
from jaxmpc.files.toml import check_built, convert, known_keys, located, plain_data, read_toml, told_by_type
from jaxmpc.law.ops import FLOATS
from jaxmpc.synthesis.force_filter import cutoff_of, force_filter
from jaxmpc.synthesis.timing import Timing
from jaxmpc.world.heart.bounds import Seconds
from jaxmpc.world.heart.motion import Motion, displacement
from jaxmpc.world.loop_path import LoopPath, loop_path

Physics = Literal["linear", "wam", "mjx"]
Stiffness = Annotated[float, msgspec.Meta(gt=0.0, le=1e6)]


class Experiment(msgspec.Struct, frozen=True, forbid_unknown_fields=True, dict=True):
    """One experiment; `from_toml`, `published`, or built in Python. Times in [s], forces in [N]."""

    name: str = "experiment"
    physics: Physics = "linear"
    """"linear": the contact loop per axis. "wam": the arm. "mjx": the same on stock MJX, slowly, for comparison."""
    duration: Annotated[float, msgspec.Meta(gt=0.0, le=3600.0)] = 25.0
    settle: Seconds = 5.0
    """What is left out of the metrics at the start [s]; ramps are left out as well."""
    stiffness: tuple[Stiffness, ...] = (375.0, 810.0, 1900.0)
    """Tissue stiffnesses K_s [N/m]."""
    damping: Literal["ideal", "sampled"] = "ideal"
    """"ideal": the paper's (6). "sampled": through the velocity, sampled, filtered and delayed as on the robot,
    and always so on the arm."""
    velocity_lowpass: Annotated[float, msgspec.Meta(ge=0.0, le=1e5)] = 180.0
    """Cut-off of the velocity filter, for sampled damping, of controllers without one of their own [rad/s]."""
    sampling_time: Annotated[float, msgspec.Meta(ge=1e-4, le=0.1)] = 1e-3
    """T_s [s]."""
    delay: Annotated[int, msgspec.Meta(ge=1, le=2)] = 1
    """Samples between a command and its effect [samples]."""
    force_limit: Annotated[float, msgspec.Meta(gt=0.0, le=1000.0)] = 15.0
    """Largest measured force of a run that is fine, as the robot's default limit has it: the Euclidean norm on the arm,
    on the linear loop each axis [N]."""
    motion: Motion = Motion()
    reference: Reference = Reference()
    sensor: SensorSettings = SensorSettings()
    tissue: TissueSettings = TissueSettings()
    """On the arm alone; the linear world's tissue is elastic."""
    arm: ArmSettings = ArmSettings()

    def __post_init__(self) -> None:
        check_kinds(self)
        msgspec.structs.force_setattr(self, "stiffness", tuple_of_floats(self.stiffness))
        with told_by_type(self):
            check_together(self)

    def __repr__(self) -> str:
        return described.as_text(*described.experiment(self))

    def _repr_html_(self) -> str:
        return described.as_html(*described.experiment(self))

    @property
    def timing(self) -> Timing:
        """Sampling of the controller and delay of the world."""
        return Timing(self.sampling_time, self.delay)

    def loop_path(self, ideal: bool | None = None) -> LoopPath:
        """Delay and filters of the loop that runs, is judged and is frozen, where a controller brings no own filters.

        Args:
            ideal: Whether the damping is ideal; None is as the experiment runs it, which on the arm is never ideal.
        """
        if ideal is None:
            ideal = self.physics == "linear" and self.damping == "ideal"
        sensor, T_s = self.sensor, self.sampling_time
        return loop_path(
            T_s,
            self.delay,
            ideal,
            velocity_cutoff=self.velocity_lowpass,
            lowpass_hz=sensor.lowpass_hz,
            force_filter=force_filter(self.force_cutoff, T_s, FLOATS),
        )

    @property
    def force_cutoff(self) -> float | None:
        """Natural frequency of the Kalman filter on the measured force [rad/s]; None without one."""
        return cutoff_of(self.sensor.kalman, self.sensor.noise, self.sampling_time)

    @property
    def steps(self) -> int:
        """Number of samples."""
        return round(self.duration / self.sampling_time)

    @staticmethod
    def published(name: str) -> "Experiment":
        """An experiment of the paper ("table-1", "figure-3", on the arm "table-1-wam", "figure-3-wam") or a scenario.

        Raises:
            InputError: The name is not one of these.
        """
        folder = resources.files("jaxmpc.experiment") / "published"
        known = sorted(entry.name.removesuffix(".toml") for entry in folder.iterdir() if entry.name.endswith(".toml"))
        if name not in known:
            raise InputError("published experiment", name, "a known name", nearest(name, known))
        with resources.as_file(folder / f"{name}.toml") as path:
            return Experiment.from_toml(path)

    @staticmethod
    def from_toml(path: str | Path) -> "Experiment":
        """An experiment from its file, whose name it has unless it gives another; a recording is looked for beside it.

        Raises:
            InputError: Names file, line, key, value, bound and remedy.
        """
        data = read_toml(path)
        with located(path):
            if not data:
                raise InputError("experiment", "empty", "a file with a key at least", 'One may be physics = "wam".')
            with suppress(InputError):  # one that is no plain name stays without
                data = {"name": plain_name("name", Path(path).stem), **data}
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
        check_table(root or "experiment", data)
        known_keys(Experiment, data, root)
        for key, kind in TABLES.items():
            if isinstance(table := data.get(key), dict):
                known_keys(kind, table, f"{root}.{key}".lstrip("."))
        experiment: Experiment = convert(data, Experiment, root)
        experiment.check_world()
        if experiment.motion.file and folder is not None:
            found = str(folder / experiment.motion.file)
            motion = msgspec.structs.replace(experiment.motion, file=found)
            experiment = msgspec.structs.replace(experiment, motion=motion)
        if experiment.motion.kind == "recording":
            _ = experiment.signals
        if experiment.physics != "linear":
            experiment.arm.resting()
        return experiment

    @cached_property
    def within_bounds(self) -> bool:
        """True; what was built in Python meets here the bounds that a file's values meet when it is read.

        Raises:
            InputError: A value of the wrong type or out of bounds, with its key as in the TOML file.
        """
        check_built(self)
        return True

    def check_world(self) -> None:
        """Refuse what the linear world would leave out without a word.

        Raises:
            InputError: The tissue is no spring that holds the tip and stays as it is.
        """
        if self.physics == "linear" and not self.tissue.linear:
            bound = "elastic, attached and unchanged on the linear loop"
            remedy = 'Set physics = "wam", or leave the table [tissue] as it is.'
            key, value = self.tissue.beyond_linear[0]
            raise InputError(f"tissue.{key}", value, bound, remedy)

    def with_seed(self, seed: int) -> "Experiment":
        """The same experiment with the phases of the motion and the sensor noise drawn anew."""
        motion = msgspec.structs.replace(self.motion, phases="random", seed=seed)
        return msgspec.structs.replace(self, motion=motion, sensor=msgspec.structs.replace(self.sensor, seed=seed))

    @property
    def draws_motion(self) -> bool:
        """Whether another seed is another motion; a recording is the same one for all."""
        return self.motion.kind in ("harmonics", "rhythm")

    @property
    def draws_anything(self) -> bool:
        """Whether runs differ from seed to seed at all."""
        return self.draws_motion or self.sensor.noise > 0.0

    @property
    def draws(self) -> str:
        """What differs from seed to seed, in words."""
        return "drawn motions" if self.draws_motion else "drawn noises, on one motion,"

    @property
    def limited(self) -> bool:
        """Whether it is an arm within a robot's limits, not one whose joints give whatever is asked for."""
        return self.physics != "linear" and any((*self.arm.joint_torque_limit, *self.arm.torque_step_limit))

    def without_limits(self) -> "Experiment":
        """The same arm, whose joints give whatever is asked for: a study, not a robot."""
        none = (0.0,) * 4
        arm = msgspec.structs.replace(self.arm, joint_torque_limit=none, torque_step_limit=none)
        return msgspec.structs.replace(self, arm=arm)

    def to_dict(self) -> dict[str, Any]:
        """Plain data, every default written out; for hashes and manifests."""
        data: dict[str, Any] = plain_data(self)
        return data

    @property
    def content(self) -> dict[str, Any]:
        """What results depend on, for hashes: as `to_dict`, but a recording by its content, wherever it lies."""
        data = self.to_dict()
        if file := data["motion"]["file"]:
            recorded = read_bytes(file, LARGEST_RECORDING, "motion.file")
            data["motion"]["file"] = f"sha256:{hashlib.sha256(recorded).hexdigest()}"
        return data

    @cached_property
    def heart(self) -> tuple[np.ndarray, np.ndarray]:
        """Position [m] and velocity [m/s] of the heart's surface at every sample, each (steps, 3)."""
        return fixed(displacement(self.motion, np.arange(self.steps) * self.sampling_time))

    @cached_property
    def scored(self) -> tuple[np.ndarray, np.ndarray]:
        """Wanted force [N] and whether a sample counts in the metrics, as in `Signals`.

        Raises:
            InputError: None counts.
        """
        return fixed(scored(self.reference, self.steps, self.sampling_time, self.settle))

    @cached_property
    def signals(self) -> Signals:
        """Everything that does not depend on the controller, computed once on the host."""
        wanted, score = self.scored
        noise = np.random.Generator(np.random.Philox([self.sensor.seed, 1])).standard_normal((self.steps, 3))
        return fixed(Signals(self.heart[0], self.sensor.noise * noise, wanted, score))
