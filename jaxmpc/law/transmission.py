"""The WAM's transmission: joints 2 and 3 share motors 2 and 3 through a differential.

    θ_motor = T q,   τ_joint = Tᵀ τ_motor

T is libbarrett's joint-to-motor matrix.
"""

from jaxmpc.law.scalar import Matrix, Vector

N1, N2, N3, N4 = 42.0, 28.25, 16.8155, 18.0
"""Transmission ratios per motor (libbarrett, wam4.conf); N3 is N2/n3."""
JOINT_TO_MOTOR: Matrix = ((-N1, 0.0, 0.0, 0.0), (0.0, N2, -N3, 0.0), (0.0, -N2, -N3, 0.0), (0.0, 0.0, 0.0, -N4))
MOTOR_TO_JOINT: Matrix = (
    (-1.0 / N1, 0.0, 0.0, 0.0),
    (0.0, 0.5 / N2, -0.5 / N2, 0.0),
    (0.0, -0.5 / N3, -0.5 / N3, 0.0),
    (0.0, 0.0, 0.0, -1.0 / N4),
)
IPNM = 2700.0
"""Puck torque units per motor torque [1/(N m)] (libbarrett's default)."""
MOTOR_TORQUE_LIMIT: Vector = (4860 / IPNM, 4860 / IPNM, 4860 / IPNM, 4320 / IPNM)
"""Motor torque at the pucks' cap MT [N m] (btutil defaults)."""
