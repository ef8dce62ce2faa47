"""The whole arm as one writes it without this package: a Python loop around C MuJoCo, a controller in numpy.

It shares no formula with the engine: kinematics, inertia and Coriolis forces come from MuJoCo's own functions, the
cascade is written as matrices. So it is an oracle, and a peer for speed: `python -m benchmarks.mujoco_loop`.
A tick is sensor → encoders → cascade → computed torque → drives → delay → one Euler step of `wam.xml`.
"""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
from scipy.linalg.lapack import dposv

from jaxmpc.law.vectors import Vector3, Vector4

WAM = Path(__file__).resolve().parents[1] / "jaxmpc" / "world" / "wam.xml"
IPNM = 2700.0  # counts of the torque command per motor torque [1/(N m)]
JOINT_TO_MOTOR = np.array(
    [[-42.0, 0.0, 0.0, 0.0], [0.0, 28.25, -16.8155, 0.0], [0.0, -28.25, -16.8155, 0.0], [0.0, 0.0, 0.0, -18.0]]
)
BRISTLE, SMALL_SPEED = 1e-3, 1e-3  # z, Dahl's deflection [rad]; ε, the speed that rounds off |v| [rad/s]
PAPER = {375.0: (0.39, 0.34, 0.51), 810.0: (0.38, 0.35, 0.44), 1900.0: (0.39, 0.35, 0.39)}
PAPER_RMS = {375.0: (0.08, 0.06, 0.09), 810.0: (0.08, 0.06, 0.08), 1900.0: (0.07, 0.05, 0.08)}
"""Table I, residual of X, Y, Z at each stiffness: peak to peak, and RMS [N]."""


class Gains(NamedTuple):
    """One controller, as in `jaxmpc.law.gains.Gains`, with its damping."""

    phi: Any
    gamma: Any
    K: Any
    L: Any
    input_gain: Any
    mpc_ref: Any
    mpc_x: Any
    mpc_u: Any
    K2: Any

    @staticmethod
    def of(gains: Any, K2: float) -> "Gains":
        """Those of the law; a guard is left out, as this loop has none."""
        return Gains(*(np.asarray(getattr(gains, name)) for name in Gains._fields[:-1]), K2)


@dataclass(frozen=True)
class Loop:
    """Arm, tissue and imperfections; the defaults are the nominal arm. 0 switches an imperfection off."""

    stiffness: float = 810.0  # K_s [N/m]
    tissue_damping: float = 0.0  # b of the Kelvin-Voigt tissue [N s/m]
    posture: Vector4 = (0.0, 0.7, 0.0, 2.2)  # joint angles at the start [rad]
    delay: int = 1  # 1 or 2 [samples]
    T_s: float = 1e-3  # sampling time and physics step [s]
    sensor_lsb: Vector3 = (0.0061, 0.0061, 0.0122)  # [N]
    sensor_cutoff: float = 500.0  # low-pass of the force sensor [Hz]
    sensor_mass: float = 0.0  # tool mass beyond the sensor, whose inertia it reads [kg]
    encoder_counts: int = 4096  # per motor turn
    velocity_cutoff: float = 180.0  # low-pass of the joint velocities [rad/s]
    torque_quantised: bool = True  # whether a torque command is a whole number of counts
    torque_limit: Vector4 = (4860.0, 4860.0, 4860.0, 4320.0)  # of each motor [counts]
    mass_scale: float = 0.9  # nominal over true mass of links and tool [-]
    tool_mass_error: float = 0.0  # mass that only the nominal model has at the tip [kg]
    coulomb: Vector4 = (2.7, 2.5, 1.5, 1.1)  # friction of the joints [N m]
    damping: Vector4 | None = None  # viscous friction of the joints, None for the model file's [N m s/rad]
    compensation: float = 0.0  # part of the nominal friction that the controller compensates [-]
    nominal_coulomb: Vector4 = (2.7, 2.5, 1.5, 1.1)  # [N m]
    nominal_damping: Vector4 = (1.5, 0.9, 0.5, 0.25)  # [N m s/rad]


class Record(NamedTuple):
    """What happened at each tick; arrays of shape (steps, 3) or (steps, 4)."""

    force: np.ndarray  # measured force on the tissue [N]
    a: np.ndarray  # tip acceleration asked of the arm, v − K₂ẋ [m/s²]
    v: np.ndarray  # command of the cascade before anti-windup [m/s²]
    tip: np.ndarray  # tip displacement from its start [m]
    q: np.ndarray  # joint angles [rad]
    torque: np.ndarray  # torque command at the joints, which acts `delay` ticks later [N m]


def quantise(x: np.ndarray, lsb: np.ndarray) -> np.ndarray:
    """x rounded to multiples of a positive lsb, half up."""
    rounded: np.ndarray = np.floor(x / lsb + 0.5) * lsb
    return rounded


class Cascade:
    """Observer and MPC of the three axes. The law is linear, so a tick of all axes is one matrix product."""

    def __init__(self, gains: Gains) -> None:
        y, ydot, delayed, p, v, u, force, wanted = np.eye(8)
        K, L, m = np.asarray(gains.K), np.asarray(gains.L), np.asarray(gains.mpc_x)
        y_prior = y + gains.phi[0] * ydot + gains.gamma[0] * delayed
        ydot_prior = gains.phi[1] * ydot + gains.gamma[1] * delayed
        y, ydot, delayed, p = np.stack([y_prior, ydot_prior, v + p, p]) + np.outer(K, force - y_prior)
        u = (1.0 - gains.mpc_u) * u + np.sum(gains.mpc_ref) * wanted - m[0] * y - m[1] * ydot
        v = gains.input_gain * u - L[0] * y - L[1] * ydot - L[2] * delayed - p
        self.matrix, self.vector = np.stack([y, ydot, delayed, p, v, u]), np.zeros((8, 3))
        self.state, self.force, self.wanted = self.vector[:6], *self.vector[6:]
        self.v: np.ndarray = self.vector[4]

    def step(self, force: np.ndarray, wanted: np.ndarray) -> np.ndarray:
        """Acceleration command from measured and wanted force: a view. After a clamp, correct it in place."""
        self.force[:], self.wanted[:] = force, wanted
        self.state[:] = self.matrix @ self.vector
        return self.v


class NominalArm:
    """What the controller believes of the arm, at the joint angles and velocities it measured."""

    def __init__(self, model: mujoco.MjModel, loop: Loop) -> None:
        self.model, self.data, self.site = model, mujoco.MjData(model), model.site("tip").id
        self.body, self.point = int(model.site_bodyid[self.site]), self.data.site_xpos[self.site]
        self.scale, self.dm = loop.mass_scale, loop.tool_mass_error
        self.rotors = (1.0 - loop.mass_scale) * np.diag(model.dof_armature[:4])
        # MuJoCo fills whole arrays, heart included; the arm's parts are views of them.
        self.full, self.jac, self.jacdot, self.forces = (np.zeros(s) for s in ((7, 7), (3, 7), (3, 7), 7))
        self.J, self.Jdot = self.jac[:, :4], self.jacdot[:, :4]
        self.inertia, self.bias = self.full[:4, :4], self.forces[:4]
        self.q, self.v = self.data.qpos[:4], self.data.qvel[:4]

    def update(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """J, J̇v, nominal mass matrix and nominal Coriolis and gravity torque."""
        model, data = self.model, self.data
        self.q[:], self.v[:] = q, v
        # Only what is read below: mj_forward would also factor M and look for contacts.
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_makeM(model, data)
        mujoco.mj_comVel(model, data)
        mujoco.mj_rne(model, data, 0, self.forces)
        mujoco.mj_jacSite(model, data, self.jac, None, self.site)
        mujoco.mj_jacDot(model, data, self.jacdot, None, self.point, self.body)
        mujoco.mj_fullM(model, data, self.full)
        Jdot_v = self.Jdot @ v
        M = self.scale * self.inertia + self.rotors  # rotors are known exactly: only links and tool are scaled
        bias = self.scale * self.bias
        if self.dm != 0.0:
            M += self.dm * (self.J.T @ self.J)
            bias += self.dm * ((Jdot_v - model.opt.gravity) @ self.J)
        return self.J, Jdot_v, M, bias


def run(
    loop: Loop, gains: Gains, heart: np.ndarray, heart_velocity: np.ndarray, noise: np.ndarray, force_ref: np.ndarray
) -> Record:
    """One experiment; heart [m], its velocity [m/s], sensor noise and wanted force [N], each of shape (steps, 3)."""
    model = mujoco.MjModel.from_xml_path(str(WAM))
    model.opt.timestep = T_s = loop.T_s
    if loop.damping is not None:
        model.dof_damping[:4] = loop.damping
    data, site, steps = mujoco.MjData(model), model.site("tip").id, len(heart)
    q, v, heart_q, heart_v = data.qpos[:4], data.qvel[:4], data.qpos[4:], data.qvel[4:]
    tip, applied, jac = data.site_xpos[site], data.qfrc_applied[:4], np.zeros((3, 7))
    J = jac[:, :4]
    q[:] = posture = np.array(loop.posture)
    mujoco.mj_forward(model, data)

    force, a, v_cmd, moved = (np.zeros((steps, 3)) for _ in range(4))
    angles, commands = np.zeros((steps, 4)), np.zeros((steps + loop.delay, 4))
    commands[: loop.delay] = data.qfrc_bias[:4]  # until the first command arrives, gravity is held
    start, xdot_before, filtered = tip.copy(), np.zeros(3), np.zeros(3)
    bristle, believed = np.zeros(4), np.zeros(4)
    cascade, arm, K2 = Cascade(gains), NominalArm(model, loop), float(gains.K2)
    T, T_inverse = JOINT_TO_MOTOR, np.linalg.inv(JOINT_TO_MOTOR)
    limit, coulomb = np.array(loop.torque_limit) / IPNM, np.array(loop.coulomb)
    has_lsb = np.array(loop.sensor_lsb) > 0.0
    sensor_lsb = np.where(has_lsb, loop.sensor_lsb, 1.0)
    sensor_pole = np.exp(-2.0 * np.pi * loop.sensor_cutoff * T_s) if loop.sensor_cutoff > 0.0 else 0.0
    velocity_pole = np.exp(-loop.velocity_cutoff * T_s) if loop.velocity_cutoff > 0.0 else 0.0
    encoder_lsb = np.full(4, 2.0 * np.pi / (loop.encoder_counts or 1))
    q_before, v_f = T_inverse @ quantise(T @ q, encoder_lsb) if loop.encoder_counts else q.copy(), np.zeros(4)
    nominal_coulomb, nominal_damping = np.array(loop.nominal_coulomb), np.array(loop.nominal_damping)

    for k in range(steps):
        heart_q[:], heart_v[:] = heart[k], heart_velocity[k]
        mujoco.mj_step1(model, data)
        mujoco.mj_jacSite(model, data, jac, None, site)
        # 1. Tissue and sensor.
        p, xdot = np.subtract(tip, start, out=moved[k]), J @ v
        y = loop.stiffness * (p - heart[k])
        if loop.tissue_damping != 0.0:
            y += loop.tissue_damping * (xdot - heart_velocity[k])
        felt = y + (loop.sensor_mass / T_s) * (xdot - xdot_before) if loop.sensor_mass != 0.0 else y
        filtered = felt + sensor_pole * (filtered - felt)
        measured = np.add(filtered, noise[k], out=force[k])
        np.copyto(measured, quantise(measured, sensor_lsb), where=has_lsb)
        xdot_before = xdot
        # 2. Encoders, at the motors.
        angles[k] = q
        q_m = T_inverse @ quantise(T @ q, encoder_lsb) if loop.encoder_counts else angles[k]
        raw = (q_m - q_before) / T_s
        v_f = raw + velocity_pole * (v_f - raw)
        slid = q_m - q_before
        q_before = q_m
        # 3. Cascade and damping.
        v_cmd[k] = cascade.step(measured, force_ref[k])
        J_m, Jdot_v, M, bias = arm.update(q_m, v_f)
        np.subtract(v_cmd[k], K2 * (J_m @ v_f), out=a[k])
        # 4. Computed torque, with the posture held in the null space.
        qdd_0 = -20.0 * (q_m - posture) - 9.0 * v_f
        M_inverse_JT = dposv(M, J_m.T)[1]  # numpy's own solver spends most of its time on checks
        tip_force = dposv(J_m @ M_inverse_JT, a[k] - Jdot_v - J_m @ qdd_0)[1] + measured
        torque = M @ qdd_0 + tip_force @ J_m + bias
        if loop.compensation != 0.0:
            believed = (believed + slid / BRISTLE) / (1.0 + np.hypot(slid, 1e-7) / BRISTLE)
            torque += loop.compensation * (nominal_coulomb * believed + nominal_damping * v_f)
        # 5. Drives. What the clamp takes away at the tip, J M⁻¹ Δτ, the observer must know.
        wanted = torque @ T_inverse
        motor = np.minimum(np.maximum(wanted, -limit), limit)
        # Motors 2 and 3 move joints 2 and 3 together: both give way alike, which keeps the torques' direction.
        motor[1:3] = wanted[1:3] * min(1.0, *(limit[1:3] / np.maximum(np.abs(wanted[1:3]), limit[1:3])))
        cascade.v += ((motor - wanted) @ T) @ M_inverse_JT
        if loop.torque_quantised:
            motor = np.floor(motor * IPNM) / IPNM
        np.matmul(motor, T, out=commands[k + loop.delay])
        # 6. and 7. The delayed torque meets Dahl friction and the tissue.
        bristle += (T_s / BRISTLE) * v
        bristle /= 1.0 + (T_s / BRISTLE) * np.sqrt(v * v + SMALL_SPEED**2)
        np.subtract(commands[k], coulomb * bristle + y @ J, out=applied)
        mujoco.mj_step2(model, data)
    return Record(force, a, v_cmd, moved, angles, commands[loop.delay :])


def residual(record: Record, force_ref: np.ndarray, score: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Peak to peak and RMS of measured minus wanted force per axis over the samples that count [N]."""
    counted = [error[kept] for error, kept in zip((record.force - force_ref).T, score.T, strict=True)]
    return np.array([np.ptp(e) for e in counted]), np.array([np.sqrt(np.mean(e**2)) for e in counted])


def main() -> None:
    """Table I with the text design on the nominal arm, and the speed of the loop."""
    from scipy.interpolate import CubicSpline

    from benchmarks.sweep_throughput import machine
    from jaxmpc import Experiment, Params, design

    params = Params.published("text")
    gains = Gains.of(design(params), float(params.K2))
    experiment = Experiment.published("table-1")
    heart, noise, force_ref, score = experiment.signals
    t = np.arange(experiment.steps) * experiment.sampling_time
    heart_velocity = CubicSpline(t, heart)(t, 1)  # to 2e-7 m/s; differences at 1 kHz: 8e-6
    print(f"{machine()}; mujoco {mujoco.__version__}; residual pp/RMS [N], the paper's in brackets")
    for stiffness in PAPER:
        began = time.perf_counter()
        record = run(Loop(stiffness=stiffness), gains, heart, heart_velocity, noise, force_ref)
        rate = experiment.steps / (time.perf_counter() - began)
        pairs = zip("XYZ", *residual(record, force_ref, score), PAPER[stiffness], PAPER_RMS[stiffness], strict=True)
        told = "  ".join(f"{axis} {pp:.2f}/{rms:.3f} ({pp_0:.2f}/{rms_0:.2f})" for axis, pp, rms, pp_0, rms_0 in pairs)
        print(f"{stiffness:5.0f} N/m: {told}   {rate / 1e3:.1f} k ticks/s", flush=True)


if __name__ == "__main__":
    main()
