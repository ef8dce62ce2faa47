"""The cascade controller of one axis: AOB estimate → MPC move → acceleration.

Only `+ - * /` on scalars. JAX traces this source for simulation, the robot records it once into a
straight-line function; there is no second implementation. With ŷ = C x̂⁻ and [P] the paper:

    x̂⁻ₖ = Φᵣ x̂ₖ₋₁ + Γᵣ (vₖ₋₁ + p̂ₖ₋₁)                        [P] (13), open-loop form
    p̂⁻ₖ = p̂ₖ₋₁ + d̂¹ₖ₋₁,  d̂ʲ⁻ₖ = d̂ʲₖ₋₁ + d̂ʲ⁺¹ₖ₋₁,  d̂ᴺ = 0    [P] (12), where N = 1
    (x̂ₖ, p̂ₖ, d̂ₖ) = (x̂⁻ₖ, p̂⁻ₖ, d̂⁻ₖ) + K (yₖ − ŷₖ)            [P] (11)
    uₖ = uₖ₋₁ + Σᵢ rᵢ F_d,ₖ₊ᵢ − mₓ x̂ₖ[:2] − mᵤ uₖ₋₁            [P] (29), first row
    vₖ = g uₖ − L x̂ₖ − p̂ₖ                                     [P] Fig. 1, g = L₁

The disturbance order N takes p for an N-th order random walk: noise w drives the last of p and its N − 1 differences
d, so Σⱼ (−1)ʲ C(N,j) pₖ₋ⱼ = w, N − 1 samples late, which changes no estimate. The differences only predict: pₖ acts
where vₖ does, so p̂ₖ alone cancels it.

Where commands act after two samples, two inputs are on the way: the last, x̂₃, and the one before, ŵ, which acts first.
MPC and state feedback of the design for one sample are then given force and rate a sample ahead,

    x̃ₖ = Φ₂ x̂ₖ[:2] + Γ₂ ŵₖ,   ŵ⁻ₖ = x̂₃,ₖ₋₁,   and x̂⁻ₖ[:2] = x̃ₖ₋₁

so that the loop has the poles of that design and one more at 0.

Where a schedule moves the gains, g, L and what x̂ and p̂ stand for change in the middle of a motion, and limits may hold
commands back besides. There the MPC begins each sample with the reference that has the inner loop go on, with the gains
of this sample, from the command that was applied; its own, if neither was changed:

    uₖ₋₁ = (vₖ₋₁ + L x̂ₖ₋₁ + p̂ₖ₋₁)/g

Erratum: eq. (12) prints [C 1]; [C 0] is needed to obtain (33).
Erratum: eq. (13) prints the input Γᵣ u; Γᵣ L₁ u is needed for a DC gain of 1 (Fig. 1 shows L₁).
"""

from collections.abc import Sequence
from typing import NamedTuple

from jaxmpc.law import force_filter, repetition
from jaxmpc.law.force_filter import FilteredForce
from jaxmpc.law.gains import Gains, force_share, order
from jaxmpc.law.repetition import Learned
from jaxmpc.law.scalar import Scalar
from jaxmpc.law.stiffness import StiffnessEstimate, unknown

ANSWER_FLOOR = 1e-30
"""Far below the square of what an MPC answers to an input: one that answers to nothing needs no input to begin with."""


class AxisState(NamedTuple):
    """What one axis remembers between two samples."""

    x_hat: tuple[Scalar, Scalar, Scalar]
    """Estimate of force [N], force rate [N/s] and last input, which has yet to act [m/s²]."""
    p_hat: Scalar
    """Active state: estimated disturbance at the input [m/s²]."""
    u: Scalar
    """Previous MPC output, the force reference of the inner loop [N]; MPC alone asks for an acceleration [m/s²]."""
    v: Scalar
    """Previous command [m/s²]. After a clamp, put what was really applied: `state._replace(v=…)`."""
    trend: tuple[Scalar, ...] = ()
    """Estimated differences of the active state from sample to sample, 1st to (N − 1)-th [m/s²]."""
    filtered: FilteredForce | None = None
    """What the filter of the measured force remembers; None without one."""
    tissue: StiffnessEstimate | None = None
    """What is known of the tissue; None without a schedule."""
    earlier: Scalar | None = None
    """Estimate of the input before the last, where that has yet to act too [m/s²]; None where it has acted."""
    learned: Learned | None = None
    """What every beat repeats [N]; None where nothing is learned."""


def init(gains: Gains, force: Scalar = 0.0) -> AxisState:
    """State at rest in contact with a measured force [N]: no rate, no disturbance, no command."""
    zero = 0.0 * force
    schedule = gains.schedule
    tissue = None if schedule is None else unknown(schedule.identification, force)
    filtered = None if gains.force_filter is None else FilteredForce(force, zero)
    earlier = None if gains.K_earlier is None else zero
    learning = None if schedule is None else schedule.repetition
    learned = None if learning is None else repetition.nothing(learning, force)
    trend = (zero,) * (order(gains) - 1)
    u = force_share(gains) * force
    return AxisState((force, zero, zero), zero, u, zero, trend, filtered, tissue, earlier, learned)


def going_on(gains: Gains, force: Scalar, v: Scalar) -> AxisState:
    """State in contact with a measured force [N] that goes on with a command v [m/s²] while that force is wanted.

    The cascades take what v has held for a disturbance, p̂ = −v. MPC alone, which knows of none and would keep a p̂ for
    ever, takes v for its own, and begins with an input x̂₃ = a that has it ask for v once more: with Y, Ẏ the force and
    force rate that it is given per input, a (mₓ₁ Y + mₓ₂ Ẏ) = −mᵤ v. Its observer forgets a as it does any error.

    Args:
        gains: The controller.
        force: Measured force on the tissue [N].
        v: What was asked of the tip so far [m/s²].
    """
    state, share = init(gains, force), force_share(gains)
    own = (1.0 - share) * v
    # Where commands act after two samples, the MPC is given a prediction with a; else a is corrected by the observer.
    K_1, K_2 = (gains.K[0], gains.K[1]) if gains.K_earlier is None else (0.0, 0.0)
    gamma_1, gamma_2 = gains.gamma
    answer = gains.mpc_x[0] * (1.0 - K_1) * gamma_1 + gains.mpc_x[1] * (gamma_2 - K_2 * gamma_1)
    last = -gains.mpc_u * answer / (answer * answer + ANSWER_FLOOR) * own
    y, ydot, at_rest = state.x_hat
    return state._replace(x_hat=(y, ydot, at_rest + last), p_hat=-(share * v), u=state.u + own, v=v)


def filter_force(gains: Gains, state: AxisState, force: Scalar) -> tuple[AxisState, Scalar]:
    """Pass a measured force [N] through its filter, if there is one; returns the force that all else reads [N]."""
    if gains.force_filter is None or state.filtered is None:
        return state, force
    filtered = force_filter.step(gains.force_filter, state.filtered, force)
    return state._replace(filtered=filtered), filtered.force


def expected_force(gains: Gains, state: AxisState) -> Scalar:
    """What is to be measured at the next sample [N], so that it would correct neither filter nor observer."""
    if gains.force_filter is not None and state.filtered is not None:
        return force_filter.expected(gains.force_filter, state.filtered)
    blind = gains._replace(K=(0.0,) * len(gains.K))  # without a correction, an estimate is a prediction
    return estimate(blind, state, 0.0).x_hat[0]


def _moved(gains: Gains, y: Scalar, ydot: Scalar, acting: Scalar) -> tuple[Scalar, Scalar]:
    """Force [N] and force rate [N/s] a sample on, in which an acceleration [m/s²] acts."""
    (phi_12, phi_22), (gamma_1, gamma_2) = gains.phi, gains.gamma
    return y + phi_12 * ydot + gamma_1 * acting, phi_22 * ydot + gamma_2 * acting


def estimate(gains: Gains, state: AxisState, force: Scalar) -> AxisState:
    """Active observer: predict with the command that was applied, correct with the measured force [N]."""
    K_1, K_2, K_3, *K_p = gains.K
    y, ydot, last = state.x_hat
    y_prior, ydot_prior = _moved(gains, y, ydot, last if state.earlier is None else state.earlier)
    innovation = force - y_prior
    x_hat = (
        y_prior + K_1 * innovation,
        ydot_prior + K_2 * innovation,
        state.v + state.p_hat + K_3 * innovation,
    )
    active = (state.p_hat, *state.trend)
    prior = (*(value + change for value, change in zip(active[:-1], state.trend, strict=True)), active[-1])
    p_hat, *trend = (value + gain * innovation for value, gain in zip(prior, K_p, strict=True))
    earlier = None if gains.K_earlier is None else last + gains.K_earlier * innovation
    return state._replace(x_hat=x_hat, p_hat=p_hat, trend=tuple(trend), earlier=earlier)


def step(gains: Gains, state: AxisState, force: Scalar, force_ref: Sequence[Scalar]) -> tuple[AxisState, Scalar]:
    """Advance one axis by one sample: filter the force, then respond to it.

    Args:
        gains: The controller.
        state: What `init` or the last `step` returned.
        force: Measured force on the tissue [N].
        force_ref: Wanted force 1…n samples ahead [N], as many as `gains.mpc_ref` has weights; one
            value, with the weights summed (`constant_reference`), where the future is not known.

    Returns:
        The next state and the acceleration command vₖ [m/s²]; damping is not yet subtracted.
    """
    return respond(gains, *filter_force(gains, state, force), force_ref)


def respond(gains: Gains, state: AxisState, force: Scalar, force_ref: Sequence[Scalar]) -> tuple[AxisState, Scalar]:
    """Advance one axis by one sample, with the filtered force yₖ [N]; else as `step`."""
    if state.tissue is not None:
        state = carried_on(gains, state)
    state = estimate(gains, state, force)
    y, ydot = _delayed(gains, state)
    u = state.u - gains.mpc_x[0] * y - gains.mpc_x[1] * ydot - gains.mpc_u * state.u
    for weight, wanted in zip(gains.mpc_ref, force_ref, strict=True):
        u = u + weight * wanted
    v = gains.input_gain * u - gains.L[0] * y - gains.L[1] * ydot - gains.L[2] * state.x_hat[2] - state.p_hat
    return state._replace(u=u, v=v), v


def _delayed(gains: Gains, state: AxisState) -> tuple[Scalar, Scalar]:
    """Force [N] and force rate [N/s] that MPC and state feedback are given."""
    y, ydot, _ = state.x_hat
    return (y, ydot) if state.earlier is None else _moved(gains, y, ydot, state.earlier)


def carried_on(gains: Gains, state: AxisState) -> AxisState:
    """The state whose MPC goes on from the command that was applied, whatever the gains have been."""
    y, ydot = _delayed(gains, state)
    fed_back = gains.L[0] * y + gains.L[1] * ydot + gains.L[2] * state.x_hat[2] + state.p_hat
    return state._replace(u=(state.v + fed_back) / gains.input_gain)
