"""By how long the measured force comes after the tip's displacement, as the sine tells that a family adds.

A tissue answers with its force at once. The lock-in (`jaxmpc.law.identification`) has the sine's part of force and
displacement, Y and X, at its angular frequency ω; a force that comes T late lags by

    ω T = −arg(Y X*)

on every axis, whatever the stiffness. Damping makes the force lead instead.
"""

import math

from jaxmpc.law.stiffness import StiffnessIdentification

HEARD = 0.73
"""Share of the lock-in's memory that must be filled before anything is told [-]: 1.2 s of the sine."""


def lag(
    constants: StiffnessIdentification,
    listening: float,
    heard: float,
    Y: float,
    Y_imaginary: float,
    X: float,
    X_imaginary: float,
) -> float:
    """Lag of an axis' force [s]; 0 while the sine does not tell it.

    Args:
        constants: Of the identification.
        listening: Share of the sine's amplitude that is on [-].
        heard: How much of the memory is filled [-].
        Y: Force behind the last low-pass [N], real part.
        Y_imaginary: Its imaginary part [N].
        X: Displacement likewise [m].
        X_imaginary: [m].
    """
    if listening < 0.5 or heard < HEARD:
        return 0.0
    ahead = math.atan2(Y_imaginary * X - Y * X_imaginary, Y * X + Y_imaginary * X_imaginary)
    cosine, sine = constants.turn
    late: float = -ahead * constants.T_s / math.atan2(sine, cosine)
    return late
