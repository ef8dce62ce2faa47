"""Settings of the twin: arm, heart, tissue, sensor and bus.

Arm, heart and tissue have the tables of an experiment, and their defaults: the nominal imperfect arm.
"""

import math
from dataclasses import dataclass
from typing import Any

import msgspec

from jaxmpc.experiment.tables import ArmSettings, SensorSettings, TissueSettings
from jaxmpc.files.errors import InputError, nearest
from jaxmpc.files.toml import convert
from jaxmpc.law.transmission import IPNM
from jaxmpc.law.vectors import Vector3, Vector4
from jaxmpc.world.heart.motion import Motion
from jaxmpc.world.sensor import SENSOR_LOWPASS_HZ

Rotation = tuple[Vector3, Vector3, Vector3]

_ARM, _SENSOR, _TISSUE, _MOTION = ArmSettings(), SensorSettings(), TissueSettings(), Motion()
HOME: Vector4 = (0.0, -2.0, 0.0, 3.13)
"""Where the arm stands when it is switched on, libbarrett's home [rad]."""


@dataclass(frozen=True)
class TwinSettings:
    """Plain data; everything random is drawn from `seed`."""

    stiffness: float = 810.0
    """Stiffness of the tissue [N/m]."""
    tissue: TissueSettings = _TISSUE
    """What the tip presses on; the stiffness apart."""
    pull_off: float = 8.0
    """Pull at which an attached tip comes off [N] (chosen here: above the +2 N of Fig. 3b)."""
    motion: Motion = _MOTION
    """How the heart moves."""
    posture: Vector4 = _ARM.posture
    """Joint angles at which the tip touches the resting heart [rad]."""
    gap: float = 0.02
    """How far above that the tip starts [m]; 0 starts in contact."""
    mass_scale: float = 1.0
    """Masses and inertias of the links over the nominal ones [-]."""
    tool_mass: float = _ARM.tool_mass
    """Tool and sensor at the tip [kg]."""
    coulomb: Vector4 = _ARM.coulomb
    """Coulomb friction of the joints [N m]."""
    presliding: float = _ARM.presliding
    """Deflection over which it builds up [rad]."""
    viscous: Vector4 = _ARM.viscous
    """Viscous friction of the joints [N m s/rad]."""
    delay: int = 1
    """Samples from a torque frame to its action."""
    substeps: int = 2
    """Physics steps per millisecond."""
    noise: float = _SENSOR.noise
    """Noise of the force sensor, per axis and sample [N]."""
    lsb: Vector3 = _SENSOR.lsb
    """Its resolution [N], before the int16/256 N of its frames."""
    lowpass_hz: float = SENSOR_LOWPASS_HZ
    """Its low-pass [Hz]; 0 is none."""
    beyond_sensor: float = _ARM.beyond_sensor
    """Mass beyond it, whose inertia and (until tared) weight it reads [kg]."""
    bias: Vector3 = (0.0, 0.0, 0.0)
    """What it reads without force until it is tared [N]."""
    tare_s: float = 1.0
    """How long a tare takes [s]; its outputs are 0 meanwhile."""
    mount: Rotation = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    """Rotation from the sensor's axes to those of `frame`."""
    frame: str = "world"
    """"world": the sensor keeps its direction, as in the simulator; "tool": it turns with the forearm."""
    counts: int = _ARM.encoder_counts
    """CTS, encoder counts per motor turn."""
    ipnm: Vector4 = (IPNM,) * 4
    """Torque units per newton metre of each motor [1/(N m)]."""
    max_torque: Vector4 = (4860.0, 4860.0, 4860.0, 4320.0)
    """MT, the pucks' torque cap [units]."""
    heartbeat_s: float = 0.1
    """Silence after which an active safety module falls idle [s]; the maker publishes none, OpenWAM says below 0.1."""
    cold: bool = False
    """Just switched on: at home, pucks in reset, positions lost; else homed, awake, above the heart."""
    bit_rate: float = 0.0
    """Bit rate of the bus [bit/s], for replies that take their time on the wire; 0 sends them at once."""
    seed: int = 0
    faults: tuple[str, ...] = ()
    """See `deploy.twin.faults`."""

    def __post_init__(self) -> None:
        # What was built in Python has not met its bounds yet.
        convert(msgspec.to_builtins(self.tissue), TissueSettings, "tissue")
        convert(msgspec.to_builtins(self.motion), Motion, "motion")
        _one_of("frame", self.frame, ("world", "tool"))
        _within("stiffness", self.stiffness, 1.0, 1e5, "N/m")
        _within("delay", self.delay, 0, 10, "ms")
        _within("substeps", self.substeps, 1, 64)
        _within("gap", self.gap, 0.0, 0.3, "m")
        _within("counts", self.counts, 16, 2**20)
        for name in ("mass_scale", "presliding", "pull_off", "heartbeat_s"):
            _within(name, getattr(self, name), 1e-6, 1e6)
        for name in ("tool_mass", "noise", "lowpass_hz", "beyond_sensor", "tare_s"):
            _within(name, getattr(self, name), 0.0, 1e6)
        _within("seed", self.seed, 0, 2**63 - 1)
        _within("bit_rate", self.bit_rate, 0.0, 1e7)
        for name in ("posture", "coulomb", "viscous", "lsb", "bias", "ipnm", "max_torque"):
            for value in getattr(self, name):
                _within(name, value, -100.0 if name in ("posture", "bias") else 0.0, 8191.0)


def _one_of(key: str, value: str, known: tuple[str, ...]) -> None:
    if value not in known:
        raise InputError(key, value, "a known name", nearest(value, list(known)))


def _within(key: str, value: Any, low: float, high: float, unit: str = "") -> None:
    if not (math.isfinite(value) and low <= value <= high):
        raise InputError(key, value, f"in [{low:g}, {high:g}] {unit}".rstrip(), "Choose another value.")
