"""What a recorded flight says the law was given: replayed by the robot's runtime and by the simulator's law alike."""

from typing import Any, NamedTuple


class RecordedInputs(NamedTuple):
    """Arrays with one row a sample."""

    time: Any
    """(n,) [s]"""
    q: Any
    """Measured joint angles (n, 4) [rad]."""
    qd: Any
    """Measured joint velocities (n, 4) [rad/s]."""
    force: Any
    """Measured force on the tissue (n, 3) [N]; NaN where it was missing."""
    force_ref: Any
    """Wanted force (n, 3), with preview of the sample and of H after it (n, 3, 1 + H) [N]."""
    applied: Any
    """Joint torques that the limits let pass (n, 4) [N m]."""
    a: Any
    """Acceleration asked of the tip (n, 3) [m/s²]."""
    contact: Any
    """Whether the law was in control (n,)."""
    enters: Any
    """Whether it was for the first time (n,)."""
    servo: Any
    """Whether the servo was, which only moves the friction's bristles (n,)."""
    memory: Any
    """What a guard remembered after the sample, gain first, and its share of a lasting swing, where they are taken from
    the recording, NaN where they are found (n, 4) [-]."""
    deflection: Any
    """Deflection of the friction's bristles after the sample, where it is taken from the recording, NaN where it is
    found (n, 4) [-]."""
    judged: Any
    """Whether the law's outputs can be told from the recording (n,)."""
    fresh: Any
    """Whether velocities can be (n,)."""
