"""A frozen controller with the paper's text gains (K̂_s = 900 N/m), on no arm and on the WAM, made of plain numbers.

`arm_artifact()` is what the robot's tests run; nothing here needs a simulator.
"""

import math
import random
from collections.abc import Sequence
from typing import Any

import numpy as np

from deploy.controller import known_tissue
from deploy.controller.arm_model import ROBOT, ArmModel, published_tip
from deploy.controller.artifact import Artifact
from deploy.controller.judged_loop import JudgedLoop
from deploy.controller.limits import Limits
from jaxmpc.law import entry, force_control, gain_backoff
from jaxmpc.law.chain import Chain, Link
from jaxmpc.law.computed_torque import Nominal
from jaxmpc.law.force_control import Controller
from jaxmpc.law.friction_compensation import NominalFriction
from jaxmpc.law.gains import Gains, GainSchedule, Knot, constant_reference, with_gain
from jaxmpc.law.measurement import Measurement
from jaxmpc.law.ops import FLOATS
from jaxmpc.law.pulse import PulseFinder
from jaxmpc.law.reference import split, told
from jaxmpc.law.repetition import Repetition
from jaxmpc.law.stiffness import StiffnessIdentification

K_HAT, K2, T_S = 900.0, 10.0, 1e-3
POSTURE = (0.0, 0.7, 0.0, 2.2)
TOOL, TOOL_MASS, TOOL_INERTIA = 0.36, 0.3, (7e-5, 7e-5, 6e-5)
"""Tip beyond the elbow's axis [m]; mass there [kg] and its own inertia [kg m²]."""
VELOCITY_CUTOFF = 180.0
LOOP = JudgedLoop(1, False, VELOCITY_CUTOFF, 2.0 * math.pi * 500.0)
SWING_HZ, SWINGING = 40.0, 800
SWING = 2.0 * gain_backoff.LIMIT * math.sqrt(2.0 / 3.0)
"""Of each axis' force, where a guarded controller is to feel it, in the first samples: together twice its limit [N]."""

MASS = (10.76768767, 3.87493756, 1.80228141, 1.06513649)
CENTRE = (
    (-0.00443422, 0.12189039, -0.00066489),
    (-0.00236983, 0.03105614, 0.01542114),
    (-0.03825858, 0.20750770, 0.00003309),
    (0.01095471, -0.00002567, 0.14053900),
)
INERTIA = (
    (0.13488033, 0.11328369, 0.09046330, 0.00213041, 0.00012485, -0.00068555),
    (0.02140958, 0.01377875, 0.01558906, -0.00027172, -0.00002461, 0.00181920),
    (0.05911077, 0.00324550, 0.05927043, 0.00249612, -0.00000738, 0.00001767),
    (0.01848577, 0.01891658, 0.00197517, -0.00000219, 0.00160868, -0.00000515),
)
"""Barrett's tables of 2008 (AC-02), in the Denavit–Hartenberg frames: mass [kg], centre of mass [m], and the tensor
about it as xx, yy, zz, xy, xz, yz [kg m²] with the signs of a tensor."""
ARMATURE = (0.20517, 0.18884, 0.06691, 0.03462)
GRAVITY = 9.805
ANCHOR = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (-0.045, 0.55, 0.0), (0.045, 0.0, 0.0))
"""A point on the joint's axis in the Denavit–Hartenberg frame [m]; the axis is −y, +y, −y, +y."""
POSITION = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.045, 0.0, 0.55))
TURN: Any = (
    ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, -1.0, 0.0)),
    ((1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0)),
    ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, -1.0, 0.0)),
)
"""Each joint's frame in its parent's, with z along the axis."""


def text_gains() -> Gains:
    decay = (1.0 - math.exp(-K2 * T_S)) / K2
    # 30 weights that differ, so that a wrong order of the preview shows, and 34 beyond the horizon
    shape = [1.0 + 0.1 * i for i in range(30)]
    mpc_ref = [1.98311185836792 * w / sum(shape) for w in shape] + [0.0] * 34
    L = (89.72993333, 0.66057566, 0.55698721)
    return Gains(
        phi=(0.000995016625083195, 0.9900498337491681),
        gamma=(K_HAT * (T_S - decay) / K2, K_HAT * decay),
        K=(0.14991379, 12.16723884, 0.6519533, 0.6519533),
        L=L,
        input_gain=L[0],
        mpc_ref=tuple(mpc_ref),
        mpc_x=(1.40035089, 0.00208595),
        mpc_u=0.58276126,
    )


def gains_alone() -> Gains:
    """The published MPC without the observer, whose output is the acceleration."""
    return Gains(
        phi=(0.000997235108679532, 0.9944753174979154),
        gamma=(0.0005958990648, 1.1906987197),
        K=(0.22784814, 29.41654838, 0.0, 0.0),
        L=(0.0, 0.0, 0.0),
        input_gain=1.0,
        mpc_ref=(70.60439422, *[0.0] * 63),
        mpc_x=(70.60439422, 0.35397271),
        mpc_u=1.0363459037628586,
    )


def guarded_gains() -> Gains:
    return text_gains()._replace(guard=gain_backoff.constants(T_S, FLOATS))


def scheduled_gains() -> Gains:
    """A family whose identification takes whatever it hears for known: K̂ and the authority move within a second."""
    knots = []
    for stiffness, more in ((50.0, 1.0), (150.0, 1.2)):
        own = text_gains()._replace(mpc_u=0.58276126 / more)
        knots.append(Knot(math.log(stiffness), K2 * more, with_gain(own, K_HAT)))
    angle = 2.0 * math.pi * 17.0 * T_S
    identification = StiffnessIdentification(
        T_s=T_S,
        amplitude=0.3,
        turn=(math.cos(angle), math.sin(angle)),
        mixing=0.05,
        averaging=0.02,
        confidence=1e-6,
        band=0.08,
        least=math.log(40.0),
        most=math.log(200.0),
        prediction=(0.6, 120.0, 1e4),
        watching=1e-3,
    )
    return text_gains()._replace(schedule=GainSchedule(tuple(knots), identification))


def learning_gains() -> Gains:
    """The same family, which learns of each beat, too: at the fastest rate the fifth harmonic fades."""
    finder = PulseFinder(T_S, slow=3e-3, cycles=1.0, following=1.0, pulling=1.0, first=7.5, least=3.8, most=16.3)
    learning = Repetition(finder, (1.3e-4,) * 5, smoothing=0.067, judging=1.6e-4, highest=88.0, lead=0.032)
    gains = scheduled_gains()
    assert gains.schedule is not None
    return gains._replace(schedule=gains.schedule._replace(repetition=learning))


def margin_row(stiffness: float, **changes: Any) -> dict[str, Any]:
    row = {
        "stiffness": stiffness,
        "M_s": 1.6,
        "gain_margin_db": 8.0,
        "gain_reduction_db": math.inf,
        "phase_margin_deg": 40.0,
        "delay_margin_s": 2e-3,
        "spectral_radius": 0.98,
    }
    return row | changes


def wam_chain() -> Chain:
    """The arm with its tool, each link about its joint; only numpy between the tables above and the law's constants."""
    links = []
    for i, (mass, centre, tensor, anchor) in enumerate(zip(MASS, CENTRE, INERTIA, ANCHOR, strict=True)):
        xx, yy, zz, xy, xz, yz = tensor
        about = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        com = np.array(centre)
        if i == 3:
            tool = np.array((0.0, 0.0, TOOL))
            together = mass + TOOL_MASS
            middle = (mass * com + TOOL_MASS * tool) / together
            about = about + np.diag(TOOL_INERTIA) + mass * spread(com - middle) + TOOL_MASS * spread(tool - middle)
            mass, com = together, middle
        # From the Denavit–Hartenberg frame into the joint's: x stays, y and z turn until z is the axis.
        side = -1.0 if i % 2 == 0 else 1.0
        turned = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -side], [0.0, side, 0.0]])
        com = turned @ (com - np.array(anchor))
        inertia = turned @ about @ turned.T + mass * spread(com)
        links.append(Link(POSITION[i], TURN[i], mass, tuple((mass * com).tolist()), tuples(inertia)))
    return Chain(tuple(links), ARMATURE, (-0.045, -TOOL, 0.0), (0.0, 0.0, -GRAVITY))


def spread(r: np.ndarray) -> np.ndarray:
    """Inertia of a unit mass at a point."""
    moment: np.ndarray = r @ r * np.eye(3) - np.outer(r, r)
    return moment


def tuples(matrix: np.ndarray) -> Any:
    return tuple(map(tuple, matrix.tolist()))


def nominal(compensated: bool) -> Nominal:
    share = 0.5 if compensated else 0.0
    coulomb, viscous = (2.025, 2.25, 1.125, 0.66), (1.5, 0.9, 0.5, 0.25)
    return Nominal(
        0.9, 0.05, NominalFriction(tuple(share * F for F in coulomb), tuple(share * D for D in viscous), 1e-3)
    )


def recorded_inputs(
    n: int, seed: int = 1, width: int = 1, swing: float = 0.0
) -> tuple[list[Any], list[Any], list[Any]]:
    """Angles that sway about the posture, a force that follows a heart, the wanted force: per sample.

    The force may begin with a swing of that amplitude [N].
    """
    draw = random.Random(seed)
    phases = [draw.uniform(0.0, 2.0 * math.pi) for _ in range(7)]

    def sway(k: int, i: int, hertz: float) -> float:
        return math.sin(2.0 * math.pi * hertz * k * T_S + phases[i])

    q = [[a + 0.01 * sway(k, i, 1.0 + i) for i, a in enumerate(POSTURE)] for k in range(n)]
    rest = (0.0, 0.0, -5.0)
    force = [[draw.gauss(F, 0.002) + 0.02 * sway(k, 4 + i, 1.2 + i) for i, F in enumerate(rest)] for k in range(n)]
    for k in range(min(n, SWINGING)):
        force[k] = [F + swing * math.sin(2.0 * math.pi * SWING_HZ * k * T_S) for F in force[k]]
    wanted = [
        [[F + 0.02 * sway(k + 1 + j, 4 + i, 1.2 + i) for j in range(width)] for i, F in enumerate(rest)]
        for k in range(n)
    ]
    return q, force, wanted


def on_floats(
    controller: Controller, compensated: bool, inputs: tuple[Sequence[Any], Sequence[Any], Sequence[Any]]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Commands, torques, and what is let pass: the law on floats, nothing recorded.

    Each 7th torque is cut a little on J2, and forty in a row by so much that a guard takes it for an overload.
    """
    q, force, _ = (tuple(signal[0]) for signal in inputs)
    state = entry.enter(controller, force_control.init(controller, q, force, compensated), force, (0.0,) * 3, FLOATS)
    v, torques, passed = [], [], []
    angles, forces, references = inputs
    weights = len(controller.gains.mpc_ref)
    for now, force, wanted in zip(angles, forces, told(references) if weights > 1 else references, strict=True):
        present, ahead = split(wanted, weights)
        state, command = force_control.step(controller, state, tuple(now), tuple(force), ahead, FLOATS, present=present)
        torque = command.torque.torque
        cut = 10.0 if 200 <= len(v) < 240 else 0.2 if len(v) % 7 == 3 else 0.0
        held = (torque[0], torque[1] - cut, *torque[2:])
        state = force_control.applied(state, command, held)
        v.append(command.v)
        torques.append(torque)
        passed.append(held)
    return np.array(v), np.array(torques), np.array(passed)


def arm_arguments(n: int = 40, preview: bool = False, compensated: bool = False, **changes: Any) -> dict[str, Any]:
    """What `ArmModel` and `Artifact` are made from, as (arguments of the artifact, with "arm" those of the model)."""
    gains = changes.pop("gains", text_gains())
    arm: dict[str, Any] = {
        "robot": ROBOT,
        "chain": wam_chain(),
        "tool_length": TOOL,
        "nominal": nominal(compensated),
        "compensated": compensated,
        "momentum_observer": 0.0,
        "posture": POSTURE,
        "encoder_counts": 4096,
        "limits": Limits.default(published_tip(POSTURE, TOOL).tolist()),
    }
    arm |= changes
    width = len(gains.mpc_ref) if preview else 1
    inputs = recorded_inputs(n, width=width, swing=SWING if gains.guard else 0.0)
    law = gains if preview else constant_reference(gains)
    measurement = Measurement(T_S, math.exp(-VELOCITY_CUTOFF * T_S))
    bandwidth = arm["momentum_observer"] or None
    controller = Controller(arm["chain"], arm["nominal"], arm["posture"], law, K2, measurement, bandwidth)
    v, torque, applied = on_floats(controller, arm["compensated"], inputs)
    wanted = np.array(inputs[2])
    arm |= {"golden_q": np.array(inputs[0]), "golden_applied": applied, "golden_torque": torque}
    if gains.schedule is not None:
        forces = wanted if preview else wanted[..., 0]
        trace = known_tissue.samples(arm["golden_q"], np.array(inputs[1]), forces, preview)
        arm |= known_tissue.answers(controller, arm["compensated"], trace, preview)
    return {
        "gains": gains,
        "T_s": T_S,
        "K2": K2,
        "preview": preview,
        "loop": LOOP,
        "params": {"Khat_s": 900.0},
        "margins": [margin_row(375.0), margin_row(810.0, M_s=1.4), margin_row(1900.0, M_s=1.9)],
        "floor": {"M_s": 2.0},
        "provenance": {"jaxmpc": "0.1.0"},
        "golden_force": np.array(inputs[1]),
        "golden_force_ref": wanted if preview else wanted[..., 0],
        "golden_v": v,
        "arm": arm,
        "family": None if gains.schedule is None else {"band": 0.08, "rows": [margin_row(810.0)]},
    }


def arm_artifact(n: int = 40, preview: bool = False, compensated: bool = False, **changes: Any) -> Artifact:
    """A controller of the kind "wam"; changes are other arguments of `ArmModel` (or other gains)."""
    arguments = arm_arguments(n, preview, compensated, **changes)
    return Artifact(**(arguments | {"arm": ArmModel(**arguments["arm"])}))
