"""How a family of controllers learns what beats of the heart repeat, in engineering units."""

import math
from typing import Any

import jax
import jax.numpy as jnp

from jaxmpc.law.pulse import PulseFinder
from jaxmpc.law.repetition import Repetition

SLOWEST, FIRST, FASTEST = 0.6, 1.2, 2.6
"""Rates of a heart: lowest, believed at first, and highest [Hz]."""
BREATHING = 0.5
"""Below which the tip's displacement is not taken for the heart's [Hz]; breathing is at 0.35."""
CYCLES, FOLLOWING, PULLING = 1.0, 1.0, 1.0
"""Memory of the resonator [cycles], how fast the rate follows, over that [-], and the phase [1/s]. A rate that goes
from 60 to 110 beats a minute in 3 s is followed to 5 % within 3 s after."""
HIGHEST = 14.0
"""Highest frequency of a harmonic that is learned [Hz]: the fifth at the fastest rate. The sine that finds the
stiffness is at 17."""
SMOOTHING = 11.0
"""Cut-off of each low-pass of the error [Hz]: the family's largest M_s stays 1.99, where it would be 2.05."""
JUDGING = 1.0
"""Memory of what the error would be with what is learned, and without [beats]."""
ANSWER = 0.003
"""What the loop takes to answer a wanted force [s]: 2.6 to 4.2 ms over the family's knots up to 12 Hz."""


def repetition(harmonics: int, beats: float, T_s: Any) -> Repetition | None:
    """Constants of `jaxmpc.law.repetition`; None where nothing is learned. Traceable.

    Args:
        harmonics: How many.
        beats: Time constant with which each is learned [beats].
        T_s: Sampling time [s].
    """
    if harmonics == 0:
        return None
    turn = 2.0 * math.pi
    finder = PulseFinder(
        T_s=T_s,
        slow=1.0 - jnp.exp(-turn * BREATHING * T_s),
        cycles=CYCLES,
        following=FOLLOWING,
        pulling=PULLING,
        first=turn * FIRST,
        least=turn * SLOWEST,
        most=turn * FASTEST,
    )
    found = Repetition(
        finder=finder,
        # A resonator of gain 2 T_s/τ has the time constant τ.
        gains=(2.0 * T_s / (turn * beats),) * harmonics,
        judging=T_s / (turn * JUDGING),
        smoothing=1.0 - jnp.exp(-turn * SMOOTHING * T_s),
        highest=turn * HIGHEST,
        lead=ANSWER + 2.0 / (turn * SMOOTHING),
    )
    constants: Repetition = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float64), found)
    return constants
