"""What keeps the robot from starting: a sentence that says what is wrong and what to check at the arm."""


class DeployError(ValueError):
    """The robot side cannot go on; raised before anything moves, never while it moves."""


class BusError(DeployError):
    """The bus, or somebody who should be on it, does not answer as the protocol says."""


class CalibrationError(DeployError):
    """What the arm says about itself cannot be right, or it does not know where it is."""
