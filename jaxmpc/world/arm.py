"""The arm of the MJCF: its compiled model, the constants of its chain, and its postures."""

from functools import lru_cache
from importlib import resources
from typing import Any

import numpy as np

from jaxmpc.files.errors import InputError
from jaxmpc.law.chain import Chain, Link, mass_matrix, pose, tip
from jaxmpc.law.ops import FLOATS
from jaxmpc.law.scalar import Matrix, Vector

JOINTS = ("J1", "J2", "J3", "J4")
TOOL_MASS = 0.3
"""Tool and force sensor of the MJCF [kg]."""


@lru_cache(maxsize=1)
def model() -> Any:
    """The compiled MJCF, an `mujoco.MjModel` (shared: take a copy to change it)."""
    import mujoco

    return mujoco.MjModel.from_xml_string(mjcf())


def mjcf() -> str:
    """The MJCF as text."""
    return (resources.files("jaxmpc.world") / "wam.xml").read_text(encoding="utf-8")


@lru_cache(maxsize=1)
def chain() -> Chain:
    """Constants of the arm as Python floats, bodies fixed to a link (the tool) merged into it."""
    compiled = model()
    links = []
    # Where the parent's joint frame lies in the parent's body frame.
    outer, base = np.eye(3), np.zeros(3)
    for joint in JOINTS:
        j = compiled.joint(joint).id
        body = int(compiled.jnt_bodyid[j])
        inner, anchor = _joint_frame(compiled.jnt_axis[j]), compiled.jnt_pos[j]
        turned = _rotation(compiled.body_quat[body])
        mass, moment, inertia = _inertia(compiled, body, -inner.T @ anchor, inner.T)
        links.append(
            Link(
                _vector(outer.T @ (compiled.body_pos[body] + turned @ anchor - base)),
                _matrix(outer.T @ turned @ inner),
                float(mass),
                _vector(moment),
                # Halves that differ by 1e-17 would each be computed with.
                _matrix(0.5 * (inertia + inertia.T)),
            )
        )
        outer, base = inner, anchor
    dofs = [compiled.joint(joint).dofadr[0] for joint in JOINTS]
    last, site = compiled.jnt_bodyid[compiled.joint(JOINTS[-1]).id], compiled.site("tip")
    at = site.pos
    body = site.bodyid[0]
    while body != last:
        at = compiled.body_pos[body] + _rotation(compiled.body_quat[body]) @ at
        body = compiled.body_parentid[body]
    at = outer.T @ (at - base)
    return Chain(
        tuple(links),
        _vector(compiled.dof_armature[dofs]),
        _vector(at),
        _vector(compiled.opt.gravity),
    )


@lru_cache(maxsize=1)
def joint_ranges() -> np.ndarray:
    """Lower and upper limit of each joint, shape (4, 2), read-only [rad]."""
    compiled = model()
    ranges = np.array([compiled.joint(joint).range for joint in JOINTS])
    ranges.setflags(write=False)
    return ranges


def _joint_frame(axis: np.ndarray) -> np.ndarray:
    """A rotation whose z is the joint axis and whose x, where it can be, is the body's."""
    x = np.eye(3)[0] if abs(axis[0]) < 0.5 else np.eye(3)[1]
    return np.stack([x, np.cross(axis, x), axis], axis=1)


def _inertia(compiled: Any, body: int, position: np.ndarray, rotation: np.ndarray) -> tuple[float, Any, Any]:
    """Mass, moment and inertia of a body and all fixed to it, about the link's origin, in the link's frame."""
    mass = compiled.body_mass[body]
    centre = position + rotation @ compiled.body_ipos[body]
    principal = rotation @ _rotation(compiled.body_iquat[body])
    inertia = principal @ np.diag(compiled.body_inertia[body]) @ principal.T
    inertia = inertia + mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    moment = mass * centre
    for child in range(body + 1, compiled.nbody):
        if compiled.body_parentid[child] == body and compiled.body_jntnum[child] == 0:
            at = position + rotation @ compiled.body_pos[child]
            more = _inertia(compiled, child, at, rotation @ _rotation(compiled.body_quat[child]))
            mass, moment, inertia = mass + more[0], moment + more[1], inertia + more[2]
    return mass, moment, inertia


def _rotation(quaternion: np.ndarray) -> np.ndarray:
    import mujoco

    flat = np.zeros(9)
    mujoco.mju_quat2Mat(flat, quaternion)
    return flat.reshape(3, 3)


def _vector(values: Any) -> Vector:
    # What is 1e-16 beside 0 or ±1 would not fold away.
    return tuple(float(round(value)) if abs(value - round(value)) < 1e-15 else float(value) for value in values)


def _matrix(values: np.ndarray) -> Matrix:
    return tuple(map(_vector, values))


def tip_at(posture: Any) -> np.ndarray:
    """Position of the tip in the shoulder frame, shape (3,) [m]."""
    return np.array(tip(chain(), pose(chain(), tuple(map(float, posture)), FLOATS)).position)


def link_inertias(posture: Any) -> np.ndarray:
    """Inertia about each joint of all it carries, without drives, shape (4,) [kg m²]."""
    inertias: np.ndarray = np.array(mass_matrix(chain(), pose(chain(), tuple(map(float, posture)), FLOATS))).diagonal()
    return inertias


def posture_at(target: Any, near: Any) -> Vector:
    """Joint angles within the limits that bring the tip to a point, nearest to a posture.

    Args:
        target: Point in the shoulder frame, shape (3,) [m].
        near: Joint angles to stay near, shape (4,) [rad].

    Raises:
        InputError: The arm cannot reach it.
    """
    from scipy.optimize import least_squares, minimize

    low, high = joint_ranges().T
    wanted, begin = np.asarray(target, float), np.asarray(near, float)

    def miss(q: np.ndarray) -> np.ndarray:
        tenths: np.ndarray = 10.0 * (tip_at(q) - wanted)
        return tenths

    nearest = minimize(
        lambda q: float(np.sum((q - begin) ** 2)),
        begin,
        method="SLSQP",
        bounds=list(zip(low, high, strict=True)),
        constraints={"type": "eq", "fun": miss},
        options={"maxiter": 300, "ftol": 1e-14},
    )
    # SLSQP can lose itself; plain least squares then at least reaches the point.
    found = (nearest.x, least_squares(miss, begin, bounds=(low, high), xtol=1e-12).x)
    distances = [float(np.linalg.norm(tip_at(q) - wanted)) for q in found]
    if min(distances) > 1e-6:
        reach = f"within reach: the arm misses it by {1e3 * min(distances):.0f} mm"
        remedy = "Choose a point less than 0.9 m from the shoulder, or another arm.posture to start from."
        raise InputError("arm.target", [float(x) for x in wanted], reach, remedy)
    reached = [q for q, distance in zip(found, distances, strict=True) if distance <= 1e-6]
    return tuple(map(float, min(reached, key=lambda q: float(np.sum((q - begin) ** 2)))))
