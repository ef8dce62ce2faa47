r"""How fast a cable mode may be for a step of the physics, beyond which the numbers alone swing without end.

Springs K and dampers (2ζ/ω) K between motors and links, K = ω² diag(M_ii), leave to the stretch δ of the cables

    δ̈ = −(M⁻¹ + A⁻¹) K (δ + (2ζ/ω) δ̇)

with the mass matrix M of the links and the inertias A of the motors. Its fastest mode is faster than one link against
its locked motor, by √ρ with ρ the largest eigenvalue of (M⁻¹ + A⁻¹) diag(M_ii): 2.3 times in the nominal posture, 3
with the arm outstretched. Steps h of leapfrog that take the damper at their start hold each mode while

    ρ w (w + 4 ζ) < 4,   w = ω h

whose left side is a + 2 b in the step's characteristic polynomial z² − (2 − a − b) z + 1 − b. Viscous friction, which
is implicit, only helps.
"""

from functools import lru_cache
from math import pi, sqrt

import numpy as np

from jaxmpc.law.chain import mass_matrix, pose, with_point_mass
from jaxmpc.law.ops import FLOATS
from jaxmpc.law.scalar import Vector
from jaxmpc.world.arm import TOOL_MASS, chain, link_inertias


def fastest_stable(posture: Vector, tool_mass: float, damping: float, h: float) -> float:
    """Cable mode from which on steps are unstable: of each link against its locked motor [Hz].

    Args:
        posture: Joint angles at rest, 4 numbers [rad].
        tool_mass: Tool and sensor at the tip [kg].
        damping: Damping ratio ζ of the mode [-].
        h: Step [s].
    """
    longest = sqrt(4.0 * damping**2 + 4.0 / quickening(posture, tool_mass)) - 2.0 * damping
    return longest / (2.0 * pi * h)


@lru_cache(maxsize=64)
def quickening(posture: Vector, tool_mass: float) -> float:
    """ρ [-] of a posture [rad] under a tool [kg]; arguments as of `fastest_stable`."""
    arm = with_point_mass(chain(), tool_mass - TOOL_MASS)
    M: np.ndarray = np.array(mass_matrix(arm, pose(arm, posture, FLOATS)))
    mobility = np.linalg.inv(M) + np.diag(1.0 / np.array(arm.armature))
    return float(np.linalg.eigvals(mobility * link_inertias(posture)).real.max())
