"""Constants of a controller: the gains of one cascade, and how the same controller reads on other tissue."""

from typing import Annotated, Any, NamedTuple

from jaxmpc.law.force_filter import ForceFilter
from jaxmpc.law.gain_backoff import GainBackoff
from jaxmpc.law.ops import Ops
from jaxmpc.law.repetition import Repetition
from jaxmpc.law.scalar import Constant, Scalar
from jaxmpc.law.stiffness import StiffnessIdentification

Vector = Any
"""A sequence of scalars, or an array whose last dimension is that sequence."""
_PAIR, _ANY = Constant((2,)), Constant((None,))


class Gains(NamedTuple):
    """Everything the law needs to know of one controller.

    A field is a scalar or a sequence of scalars; in a batch each has the batch's leading dimensions.
    The MPC output u is a force [N]; for the architecture "mpc" it is the acceleration v itself [m/s²].
    """

    phi: Annotated[Vector, _PAIR]
    """φ₁₂ [s] and φ₂₂ [-] of the contact model Φ₂ = [[1, φ₁₂], [0, φ₂₂]], shape (2,)."""
    gamma: Annotated[Vector, _PAIR]
    """Γ₂: force [N] and force rate [N/s] gained in one sample per acceleration [m/s²], shape (2,)."""
    K: Annotated[Vector, _ANY]
    """Kalman gain: force [-], force rate [1/s], last input, active state and its differences [m/s²/N], (3 + N,)."""
    L: Annotated[Vector, Constant((3,))]
    """State feedback: force [m/s²/N], force rate [m/s/N], last input [-], shape (3,)."""
    input_gain: Annotated[Scalar, Constant(low=1e-30)]
    """g, acceleration per unit of u: L₁ [m/s²/N] makes the DC gain u → y one."""
    mpc_ref: Annotated[Vector, _ANY]
    """Weights r on the force reference 1…n samples ahead [-], shape (n,); their sum acts on a constant."""
    mpc_x: Annotated[Vector, _PAIR]
    """MPC feedback of the estimated force [-] and force rate [s], shape (2,)."""
    mpc_u: Annotated[Scalar, Constant()]
    """MPC feedback of the previous output [-]."""
    K_earlier: Annotated[Scalar | None, Constant(optional=True)] = None
    """Kalman gain of the input before the last [m/s²/N], for commands that act after two samples; None after one."""
    guard: GainBackoff | None = None
    """What takes the gain back while the force swings; None takes none."""
    force_filter: ForceFilter | None = None
    """What the measured force passes before anything else reads it; None passes it as it is."""
    schedule: "GainSchedule | None" = None
    """Gains for a stiffness that is known; None has none, and these gains then serve every tissue."""

    def __repr__(self) -> str:
        rows = [f"  {name:<10}  {_shown(getattr(self, name)):<40}  {unit}".rstrip() for name, unit in _UNITS.items()]
        besides = [name for name in ("guard", "force_filter", "schedule") if getattr(self, name) is not None]
        return "\n".join([f"Gains{', with ' if besides else ''}{', '.join(besides)}", *rows])


_UNITS = {
    "phi": "s, -",
    "gamma": "N s²/m, N s/m",
    "K": "-, 1/s, then m/(s² N)",
    "L": "m/(s² N), m/(s N), -",
    "input_gain": "m/(s² N)",
    "mpc_ref": "-",
    "mpc_x": "-, s",
    "mpc_u": "-",
}
"""Units of the entries of each gain."""
_MOST = 5
"""Entries that are written out; of more, the least and the largest."""


def _shown(value: Any) -> str:
    """Numbers in a few words, be they floats, arrays or what a compiler traces."""
    shape = getattr(value, "shape", ())
    try:
        nested = value.tolist() if hasattr(value, "tolist") else value
        numbers = _flat(nested)
    except Exception:  # what is traced has no value yet
        return f"traced {shape}"
    if len(numbers) <= _MOST:
        return ", ".join(f"{x:.4g}" for x in numbers)
    return f"{min(numbers):.4g} … {max(numbers):.4g} {shape or (len(numbers),)}"


def _flat(nested: Any) -> list[float]:
    return [x for each in nested for x in _flat(each)] if isinstance(nested, list | tuple) else [float(nested)]


KNOTS_APART = 1.001
"""Least ratio of the stiffnesses of two neighbouring knots [-]: float32 tells ln K̂ apart by a thousandth of that."""


class Knot(NamedTuple):
    """The controller for one known stiffness of the tissue."""

    log_stiffness: Annotated[Scalar, Constant(low=0.0, below=20.0)]
    """ln K̂, K̂ in N/m."""
    K2: Annotated[Scalar, Constant(low=0.0, below=1e4)]
    """Damping [1/s]."""
    gains: Gains
    """What it would be on a tissue of 1 N/m: `with_gain` brings it to K̂."""


class GainSchedule(NamedTuple):
    """A family of controllers over the tissue's stiffness, and how that stiffness is found."""

    knots: tuple[Knot, ...]
    """In the order of their stiffness."""
    identification: StiffnessIdentification
    repetition: Repetition | None = None
    """What learns of each beat for the next, where the stiffness is known; None learns nothing."""


def order(gains: Gains) -> int:
    """Disturbance order N of one controller."""
    return len(gains.K) - 3


def force_share(gains: Gains) -> Scalar:
    """L₁/g, the u that asks for no acceleration, per force [-]: exactly 1, and 0 for the architecture "mpc"."""
    share: Scalar = gains.L[0] / gains.input_gain
    return share


def with_gain(gains: Gains, gain: Scalar) -> Gains:
    """The same controller for a tissue of stiffness K̂_s/gain: what it commands is scaled, what it estimates is not."""
    K_1, K_2, *K_v = (gains.K[i] for i in range(len(gains.K)))
    return gains._replace(
        K_earlier=None if gains.K_earlier is None else gain * gains.K_earlier,
        gamma=tuple(each / gain for each in gains.gamma),
        K=(K_1, K_2, *(gain * each for each in K_v)),
        L=(gain * gains.L[0], gain * gains.L[1], gains.L[2]),
        input_gain=gain * gains.input_gain,
    )


def backed_off(gains: Gains, gain: Scalar, ops: Ops) -> Gains:
    """The same controller with a share g of its gain, half of it taken by a slower loop.

    `with_gain(gains, gain)` leaves the closed loop of observer and state feedback as quick as it was: torques that the
    limits hold would swing in that for ever. So √g goes into the model's gain, and with √g the poles of the state
    feedback move towards zero: each gain on a derivative by √g less than the one below it. The active state integrates
    what the loop has not yet made good; so that a slow loop does not swing slowly, its gain falls by √g more, that of
    its j-th difference by √gʲ more.
    """
    slow = ops.sqrt(gain)
    inverse, cubed = 1.0 / slow, slow * gain
    K_1, K_2, K_3, *K_p = (gains.K[i] for i in range(len(gains.K)))
    slower, factor = [], cubed
    for each in K_p:
        slower.append(factor * each)
        factor = factor * slow
    return gains._replace(
        K_earlier=None if gains.K_earlier is None else gain * gains.K_earlier,
        gamma=tuple(inverse * each for each in gains.gamma),
        K=(K_1, K_2, gain * K_3, *slower),
        L=(cubed * gains.L[0], gain * gains.L[1], slow * gains.L[2]),
        input_gain=cubed * gains.input_gain,
        mpc_x=(gains.mpc_x[0], inverse * gains.mpc_x[1]),
    )


def constant_reference(gains: Gains) -> Gains:
    """The same controller for a reference held constant along H_p, as in the paper: one summed weight."""
    total = gains.mpc_ref[0]
    for weight in gains.mpc_ref[1:]:
        total = total + weight
    family = gains.schedule
    if family is not None:
        knots = (knot._replace(gains=constant_reference(knot.gains)) for knot in family.knots)
        family = family._replace(knots=tuple(knots))
    return gains._replace(mpc_ref=(total,), schedule=family)
