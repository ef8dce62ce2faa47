"""The arm's closed loop as CasADi C code: law and world traced symbolically, compiled by gcc, one episode a call.

The strongest way there is to run one environment on one core. It traces the very source that JAX traces, so the
comparison is between compilers, not between models.
"""

import ctypes
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import casadi
import numpy as np

from jaxmpc.engine.base import ProgramSpec, ScenarioData
from jaxmpc.law import force_control, torque_limits
from jaxmpc.world import arm, drive, robot
from jaxmpc.world.joint_acceleration import accelerate

FLAGS = ("-O3", "-march=native", "-ffast-math", "-shared", "-fPIC")


class Ops:
    """Scalar functions on CasADi expressions and plain numbers."""

    sin, cos, floor = casadi.sin, casadi.cos, casadi.floor
    exp, log, sqrt = casadi.exp, casadi.log, casadi.sqrt
    minimum, maximum = casadi.fmin, casadi.fmax

    @staticmethod
    def where(condition: Any, a: Any, b: Any) -> Any:
        return (a if condition else b) if isinstance(condition, bool) else casadi.if_else(condition, a, b)

    @staticmethod
    def clip(value: Any, low: Any, high: Any) -> Any:
        return casadi.fmin(casadi.fmax(value, low), high)

    @staticmethod
    def near(angle: Any, other: Any) -> Any:
        return angle

    @staticmethod
    def replaced(value: Any, new: Any) -> Any:
        return new


class Episode:
    """One controller on one tissue from start to end, in compiled C."""

    def __init__(
        self, world: ProgramSpec, scene: ScenarioData, gains: Any, K2: float, stiffness: float, precision: str
    ) -> None:
        self.real = {"float32": np.float32, "float64": np.float64}[precision]
        step, self.start, self.inputs = _step(world, scene, gains, K2, stiffness)
        self.steps = len(self.inputs)
        self.library = _compiled(step, precision)
        self.inputs = np.ascontiguousarray(self.inputs, self.real)

    def run(self) -> np.ndarray:
        """Residual RMS of X, Y, Z [N]."""
        state = np.array(self.start, self.real)
        pointer = ctypes.POINTER(ctypes.c_float if self.real is np.float32 else ctypes.c_double)
        self.library.episode(state.ctypes.data_as(pointer), self.inputs.ctypes.data_as(pointer), self.steps)
        squares, count = state[-6:-3], state[-3:]
        rms: np.ndarray = np.sqrt(squares / count)
        return rms


def _step(
    world: ProgramSpec, scene: ScenarioData, gains: Any, K2: float, stiffness: float
) -> tuple[Any, Any, np.ndarray]:
    """One sample as a CasADi function (state, input) → state, its first state, and all inputs."""
    assert world.robot is not None
    chain, kind = arm.chain(), world.robot
    numbers = _floats(scene.robot)
    constants = numbers._replace(tissue=numbers.tissue._replace(stiffness=stiffness))
    body = robot.init(chain, kind, constants, 0.0, Ops)
    law = force_control.Controller(chain, constants.nominal, constants.posture, gains, K2, constants.measurement)
    resting = robot.encoders(kind, constants, body, Ops)
    controller = force_control.init(law, resting, (0.0,) * 3, kind.compensated)
    empty = (controller, body, (0.0,) * 6)
    leaves = _flat(empty)
    x = casadi.SX.sym("x", len(leaves))
    signals = [np.asarray(field)[0] for field in scene.signals[:8]]
    steps = signals[0].shape[0]
    columns = [field.reshape(steps, -1) for field in signals[:5]]
    sizes = [column.shape[1] for column in columns]
    z = casadi.SX.sym("z", sum(sizes))
    heart, between, noise, wanted, score = (_take(z, sizes, i) for i in range(5))
    controller, body, totals = _like(empty, iter(casadi.vertsplit(x)))

    hearts = [
        robot.HeartSample(tuple(between[6 * i : 6 * i + 3]), tuple(between[6 * i + 3 : 6 * i + 6]))
        for i in range(kind.substeps)
    ]
    now = robot.HeartSample(tuple(heart[:3]), tuple(heart[3:]))
    force, _, q, _, body = robot.sense(chain, kind, constants, body, now, tuple(noise), Ops)
    refs = tuple((value,) for value in wanted)
    controller, command = force_control.step(law, controller, q, force, refs, Ops)
    passed, _ = torque_limits.limit(constants.limits, command.torque.torque, body.pending[0], Ops)
    controller = force_control.applied(controller, command, passed)
    sent = drive.send(constants.drive, passed, Ops)
    body = robot.move(chain, kind, constants, body, sent, hearts, accelerate, Ops)
    errors = [y - w for y, w in zip(force, wanted, strict=True)]
    totals = (
        *(t + s * e * e for t, s, e in zip(totals[:3], score, errors, strict=True)),
        *(t + s for t, s in zip(totals[3:], score, strict=True)),
    )
    following = casadi.vertcat(*_flat((controller, body, totals)))
    return (
        casadi.Function("tick", [x, z], [following]),
        [float(leaf) for leaf in leaves],
        np.concatenate(columns, axis=1),
    )


def _compiled(step: Any, precision: str) -> Any:
    real = {"float32": "float", "float64": "double"}[precision]
    folder = Path(tempfile.mkdtemp())
    generator = casadi.CodeGenerator("tick.c", {"casadi_real": real, "with_header": False})
    generator.add(step)
    generator.generate(f"{folder}/")
    (folder / "episode.c").write_text(f"""
#include "tick.c"
#include <string.h>
void episode({real}* x, const {real}* z, long steps) {{
  {real} next[{step.nnz_out(0)}]; {real} work[{max(step.sz_w(), 1)}]; long long iw[{max(step.sz_iw(), 1)}];
  for (long k = 0; k < steps; ++k) {{
    const {real}* arg[{max(step.sz_arg(), 2)}] = {{x, z + k * {step.nnz_in(1)}}};
    {real}* res[{max(step.sz_res(), 1)}] = {{next}};
    tick(arg, res, iw, work, 0);
    memcpy(x, next, sizeof(next));
  }}
}}
""")
    subprocess.run(["gcc", *FLAGS, "episode.c", "-o", "episode.so", "-lm"], cwd=folder, check=True)
    library = ctypes.CDLL(f"{folder}/episode.so")
    library.episode.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_long]
    return library


def _take(z: Any, sizes: list[int], i: int) -> list[Any]:
    begin = sum(sizes[:i])
    return [z[k] for k in range(begin, begin + sizes[i])]


def _flat(tree: Any) -> list[Any]:
    if tree is None:  # a controller that cancels no friction remembers none; nor does one without a guard
        return []
    return [leaf for part in tree for leaf in _flat(part)] if isinstance(tree, tuple) else [tree]


def _like(tree: Any, leaves: Any) -> Any:
    if tree is None:
        return None
    if not isinstance(tree, tuple):
        return next(leaves)
    parts = [_like(part, leaves) for part in tree]
    return type(tree)(*parts) if hasattr(tree, "_fields") else tuple(parts)


def _floats(tree: Any) -> Any:
    if not isinstance(tree, tuple):
        return float(tree)
    parts = [_floats(part) for part in tree]
    return type(tree)(*parts) if hasattr(tree, "_fields") else tuple(parts)
