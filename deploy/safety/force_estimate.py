r"""The force on the tissue as the motors tell it: what torques and the arm's own motion leave over.

The joints' momentum balance with the controller's nominal model, p = Mₙ q̇, as in `jaxmpc.law.momentum_observer`, but
without the force sensor:

    n = τ − cₙ,  rₖ = rₖ₋₁ + K (Mₙ (q̇ₖ − q̇ₖ₋₁) − T_s fₖ),  f = n + r as the measured velocity shows it
    ŷ = −(J W Jᵀ)⁻¹ J W r,  W = diag(1/F²)

r is all that disturbs the joints: the tissue's push Jᵀy, friction, wrong masses. W weighs joints by their friction F.
What gravity's error makes of ŷ stands still while the arm does: it is what ŷ reads in the air, before contact. Beside
r stands Jᵀy, what the sensor's reading explains of it, made as slow as r.
"""

from collections.abc import Callable
from typing import Any

from deploy.controller.arm_model import ArmModel
from deploy.runtime.straightline import OPS, compile_straightline
from jaxmpc.law.chain import dynamics, pose, tip, with_diagonal, with_point_mass
from jaxmpc.law.measurement import Measurement
from jaxmpc.law.momentum_observer import MomentumState, init, step
from jaxmpc.law.scalar import add, apply, apply_transposed, factor_ldl, matmul, scale, solve_ldl, sub, transpose
from jaxmpc.law.vectors import Vector3, Vector4

BANDWIDTH = 100.0
"""K [rad/s]: 10 ms late. Encoders' counts and the heart's acceleration then move ŷ by less than 1 N."""
FRICTION: Vector4 = (2.0, 2.25, 1.1, 0.66)
"""Usual friction of the joints [N m]."""
_FOUR: Vector4 = (0.0, 0.0, 0.0, 0.0)
_NONE: Vector3 = (0.0, 0.0, 0.0)


class ForceEstimate:
    """The force on the tissue without its sensor, sample by sample."""

    def __init__(self, model: ArmModel, measurement: Measurement) -> None:
        """Record the arithmetic.

        Args:
            model: The arm in the controller's model.
            measurement: How the velocities come about.
        """
        self._state: Any = tuple(init(_FOUR))
        self._read: Vector4 = _FOUR
        recorded = compile_straightline(
            _recorded(model, measurement), (self._state, self._read, _FOUR, _FOUR, _FOUR, _NONE)
        )
        self._run: Callable[..., Any] = recorded.function

    def start(self, qd: Vector4) -> None:
        """Begin at joint velocities [rad/s], with nothing disturbing."""
        self._state, self._read = tuple(init(qd)), _FOUR

    def skip(self, qd: Vector4) -> None:
        """Go on after samples were left out, at joint velocities [rad/s]: what was known of the force is kept."""
        self._state = tuple(MomentumState(*self._state)._replace(velocity=qd))

    @property
    def disturbance(self) -> Vector4:
        """r, all that disturbs the joints [N m]."""
        found: Vector4 = MomentumState(*self._state).residual
        return found

    @property
    def read(self) -> Vector4:
        """Jᵀy, what the force that is read makes of the joints' torques, as late as r [N m]."""
        return self._read

    def step(self, q: Vector4, qd: Vector4, torque: Vector4, force: Vector3 | None = None) -> Vector3:
        """Force on the tissue [N].

        Args:
            q: Joint angles of this sample [rad].
            qd: Joint velocities of this sample [rad/s].
            torque: Joint torques that were sent after the last sample [N m].
            force: Force on the tissue that the sensor reads [N]; None is taken for 0.
        """
        self._state, self._read, told = self._run(self._state, self._read, q, qd, torque, force or _NONE)
        found: Vector3 = told
        return found


def _recorded(model: ArmModel, measurement: Measurement) -> Callable[..., Any]:
    nominal, weights = model.nominal, tuple(1.0 / (f * f) for f in FRICTION)
    share = nominal.mass_scale
    chain = with_point_mass(model.chain, nominal.tool_error / share)

    late = min(BANDWIDTH * measurement.T_s, 1.0)

    def run(state: Any, read: Any, q: Any, qd: Any, torque: Any, reading: Any) -> Any:
        at = pose(chain, q, OPS)
        found = dynamics(chain, at, qd)
        mass = with_diagonal(tuple(scale(share, row) for row in found.mass), model.chain.armature)
        J = tip(chain, at).jacobian
        before = MomentumState(*state)
        # w = n + r of the last sample, whose torque is known only now.
        told = before._replace(accelerating=add(torque, before.accelerating))
        now = step(BANDWIDTH, measurement, told, mass, qd, _FOUR)
        now = now._replace(accelerating=sub(now.residual, scale(share, found.bias)))
        weighted = tuple(tuple(w * each for w, each in zip(weights, row, strict=True)) for row in J)
        force = solve_ldl(factor_ldl(matmul(weighted, transpose(J))), apply(weighted, now.residual))
        read = add(read, scale(late, sub(apply_transposed(J, reading), read)))
        return tuple(now), read, scale(-1.0, force)

    return run
