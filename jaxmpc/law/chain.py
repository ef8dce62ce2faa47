"""A serial chain of hinges as scalar arithmetic: kinematics, Jacobian, mass matrix, bias force.

Body-frame recursions (Featherstone, Rigid Body Dynamics Algorithms, 2008, ch. 5 and 6): Newton–Euler for the bias
force, composite rigid bodies for the mass matrix. All constants come from the compiled MJCF (`world.arm`), those
that are 0 or 1 fold away while the program is traced, and what two functions have in common the compiler merges.
"""

from typing import NamedTuple

from jaxmpc.law.ops import Ops
from jaxmpc.law.scalar import (
    ZERO,
    Matrix,
    Scalar,
    Vector,
    add,
    apply,
    apply_transposed,
    cross,
    dot,
    matmul,
    minus,
    plus,
    scale,
    times,
    transpose,
)


class Link(NamedTuple):
    """One moving body, in its joint's frame: origin on the joint axis, z along it; constants."""

    position: Vector
    """Origin in the parent's frame [m]."""
    rotation: Matrix
    """Orientation in the parent's frame at joint angle 0."""
    mass: Scalar
    """[kg]"""
    moment: Vector
    """Mass × centre of mass [kg m]."""
    inertia: Matrix
    """About the origin [kg m²]."""


class Chain(NamedTuple):
    """The arm; constants."""

    links: tuple[Link, ...]
    armature: Vector
    """Drive inertia reflected to the joints [kg m²]."""
    tip: Vector
    """Tip in the last link's frame [m]."""
    gravity: Vector
    """[m/s²]"""


Pose = tuple[Matrix, ...]
"""Rotation from each link's frame to its parent's."""


class Tip(NamedTuple):
    """The tip in the world frame."""

    position: Vector
    """[m]"""
    jacobian: Matrix
    """∂position/∂q, three rows of one scalar per joint [m/rad]."""


class Dynamics(NamedTuple):
    """M(q) q̈ + c(q, q̇) = τ, without armature, damping and friction."""

    mass: Matrix
    """M, of links and tool alone [kg m²]."""
    bias: Vector
    """c: Coriolis, centripetal and gravity torques [N m]."""
    drift: Vector
    """Acceleration of the tip at q̈ = 0, J̇q̇, world frame [m/s²]."""


def pose(chain: Chain, q: Vector, ops: Ops) -> Pose:
    """How each link is turned relative to its parent at joint angles q [rad]."""
    turned = []
    for link, angle in zip(chain.links, q, strict=True):
        s, c = ops.sin(angle), ops.cos(angle)
        turned.append(matmul(link.rotation, ((c, minus(0.0, s), 0.0), (s, c, 0.0), (0.0, 0.0, 1.0))))
    return tuple(turned)


def tip(chain: Chain, at: Pose) -> Tip:
    """Position and Jacobian of the tip.

    From the tip inwards: where a link's frame meets its parent's the joint's axis is a constant, and all that has been
    found so far turns with the link.
    """
    arm = chain.tip
    columns: list[Vector] = []
    for link, rotation in zip(reversed(chain.links), reversed(at), strict=True):
        arm = apply(rotation, arm)
        axis = tuple(row[2] for row in rotation)
        columns = [cross(axis, arm), *(apply(rotation, column) for column in columns)]
        arm = add(arm, link.position)
    return Tip(arm, transpose(tuple(columns)))


def dynamics(chain: Chain, at: Pose, qd: Vector) -> Dynamics:
    """Mass matrix, bias force and tip drift at joint velocities qd [rad/s]."""
    chain = regrouped(chain)
    bias, acceleration = _newton_euler(chain, at, qd, (0.0,) * len(qd))
    for rotation in reversed(at):
        acceleration = apply(rotation, acceleration)
    # The recursion carries gravity as an acceleration of the base, which the tip's is free of.
    return Dynamics(mass_matrix(chain, at), bias, add(acceleration, chain.gravity))


def inverse_dynamics(chain: Chain, at: Pose, qd: Vector, qdd: Vector) -> Vector:
    """Torques M(q) q̈ + c(q, q̇) of links and tool [N m]."""
    return _newton_euler(regrouped(chain), at, qd, qdd)[0]


def _newton_euler(chain: Chain, at: Pose, qd: Vector, qdd: Vector) -> tuple[Vector, Vector]:
    """Torques, and the acceleration of the tip against gravity in the last link's frame."""
    omega: Vector = ZERO
    alpha: Vector = ZERO
    linear = scale(-1.0, chain.gravity)
    forces, moments = [], []
    for link, rotation, speed, acceleration in zip(chain.links, at, qd, qdd, strict=True):
        linear = apply_transposed(rotation, add(linear, _carried(omega, alpha, link.position)))
        omega, alpha = apply_transposed(rotation, omega), apply_transposed(rotation, alpha)
        alpha = add(alpha, (times(omega[1], speed), minus(0.0, times(omega[0], speed)), acceleration))
        omega = add(omega, (0.0, 0.0, speed))
        forces.append(add(scale(link.mass, linear), _carried(omega, alpha, link.moment)))
        turning = add(apply(link.inertia, alpha), cross(omega, apply(link.inertia, omega)))
        moments.append(add(turning, cross(link.moment, linear)))
    tip_acceleration = add(linear, _carried(omega, alpha, chain.tip))

    torques: list[Scalar] = []
    force, moment = ZERO, ZERO
    for i in reversed(range(len(at))):
        force, moment = add(force, forces[i]), add(moment, moments[i])
        torques.append(moment[2])
        force = apply(at[i], force)
        moment = add(apply(at[i], moment), cross(chain.links[i].position, force))
    return tuple(reversed(torques)), tip_acceleration


def mass_matrix(chain: Chain, at: Pose) -> Matrix:
    """M(q) of links and tool, without armature [kg m²]."""
    n = len(chain.links)
    entries: list[list[Scalar]] = [[0.0] * n for _ in range(n)]
    mass: Scalar = 0.0
    moment: Vector = ZERO
    inertia: Matrix = (ZERO, ZERO, ZERO)
    for i in reversed(range(n)):
        link = chain.links[i]
        mass, moment = plus(mass, link.mass), add(moment, link.moment)
        inertia = tuple(map(add, inertia, link.inertia))
        # Force and moment about the origin that turn the composite body about its joint, carried to each ancestor.
        force = (minus(0.0, moment[1]), moment[0], 0.0)
        turning = tuple(row[2] for row in inertia)
        for j in reversed(range(i + 1)):
            entries[i][j] = entries[j][i] = turning[2]
            force = apply(at[j], force)
            turning = add(apply(at[j], turning), cross(chain.links[j].position, force))
        if i:
            moment, inertia = _seen_from_parent(at[i], link.position, mass, moment, inertia)
    return tuple(map(tuple, entries))


def with_point_mass(chain: Chain, mass: Scalar) -> Chain:
    """The same arm with a point mass [kg] more at its tip."""
    *links, last = chain.links
    x, y, z = chain.tip
    inertia = ((y * y + z * z, -x * y, -x * z), (-x * y, x * x + z * z, -y * z), (-x * z, -y * z, x * x + y * y))
    heavier = last._replace(
        mass=plus(last.mass, mass),
        moment=add(last.moment, scale(mass, chain.tip)),
        inertia=tuple(add(row, scale(mass, more)) for row, more in zip(last.inertia, inertia, strict=True)),
    )
    return chain._replace(links=(*links, heavier))


def regrouped(chain: Chain) -> Chain:
    """The same equation of motion from fewer numbers: what lies on a link's axis is its parent's.

    There it moves in the same way whether the joint turns it or not: a link leaves its parent its mass, what its
    moment has along the axis, and of its inertia diag(I_yy, I_yy, 0). M q̈ + c stays that of the arm; no link does.

    Source: Gautier and Khalil, IEEE Trans. Robotics and Automation 6(3), 1990.
    """
    links = list(chain.links)
    for i in reversed(range(1, len(links))):
        own, parent = links[i], links[i - 1]
        (I_xx, *xy_xz), (I_yx, I_yy, I_yz), along_z = own.inertia
        along = (I_yy, 0.0, 0.0), (0.0, I_yy, 0.0), ZERO
        on_axis = (0.0, 0.0, own.moment[2])
        moment, inertia = _seen_from_parent(own.rotation, own.position, own.mass, on_axis, along)
        links[i] = own._replace(
            mass=0.0,
            moment=(*own.moment[:2], 0.0),
            inertia=((minus(I_xx, I_yy), *xy_xz), (I_yx, 0.0, I_yz), along_z),
        )
        links[i - 1] = parent._replace(
            mass=plus(parent.mass, own.mass),
            moment=add(parent.moment, moment),
            inertia=tuple(map(add, parent.inertia, inertia)),
        )
    return chain._replace(links=tuple(links))


def with_diagonal(mass: Matrix, diagonal: Vector) -> Matrix:
    """A matrix with a diagonal added, such as the armature."""
    return tuple(
        tuple(plus(value, diagonal[i]) if i == j else value for j, value in enumerate(row))
        for i, row in enumerate(mass)
    )


def _carried(omega: Vector, alpha: Vector, arm: Vector) -> Vector:
    """Acceleration that turning gives to a point: α × r + ω × (ω × r)."""
    return add(cross(alpha, arm), cross(omega, cross(omega, arm)))


def _seen_from_parent(
    rotation: Matrix, position: Vector, mass: Scalar, moment: Vector, inertia: Matrix
) -> tuple[Vector, Matrix]:
    """Moment and inertia of a body about the origin of its parent, in the parent's frame.

    I' = R I Rᵀ + (2 p·h + m p·p) 1 − p hᵀ − h pᵀ − m p pᵀ with h the moment, turned.
    """
    turned = apply(rotation, moment)
    half = matmul(rotation, inertia)
    diagonal = plus(times(2.0, dot(position, turned)), times(mass, dot(position, position)))
    moved: list[list[Scalar]] = [[0.0] * 3 for _ in range(3)]
    for i in range(3):
        for j in range(i + 1):
            products = plus(times(position[i], turned[j]), times(turned[i], position[j]))
            products = plus(products, times(mass, times(position[i], position[j])))
            value = minus(dot(half[i], rotation[j]), products)
            moved[i][j] = moved[j][i] = plus(value, diagonal) if i == j else value
    return add(turned, scale(mass, position)), tuple(map(tuple, moved))
