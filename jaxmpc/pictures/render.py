"""The arm and the heart as pixels: an OpenGL context without a display, MuJoCo's renderer, a force arrow."""

import contextlib
import copy
import importlib
import os
import sys
from collections.abc import Iterator
from typing import Any

import numpy as np

from jaxmpc.files.errors import InputError

METRES_PER_NEWTON = 0.018
"""Length of the force arrow."""
_ARROW = np.array([0.98, 0.72, 0.15, 1.0], np.float32)

_GL_REMEDY = (
    "Install libEGL and a Mesa driver (Debian: apt install libegl1 libgl1-mesa-dri), "
    "or libOSMesa (libosmesa6) and set MUJOCO_GL=osmesa."
)
PACKAGES_REMEDY = "Install them: pip install 'jaxmpc[sim,video]'."


class RenderedScene:
    """The model, its state and an OpenGL context.

    `mujoco.Renderer` would use the platform that MUJOCO_GL named when mujoco was first imported.
    """

    def __init__(self, mujoco: Any, model: Any, gl: Any, size: tuple[int, int], quick: bool) -> None:
        self._mj, self._model, self._gl = mujoco, model, gl
        model.vis.global_.offwidth, model.vis.global_.offheight = size
        if quick:
            # Without a GPU the shadows are most of the work, and a film does not show the difference.
            model.vis.quality.shadowsize = 2048
            model.vis.quality.numslices, model.vis.quality.numstacks = 24, 16
        self._data = mujoco.MjData(model)
        self._scene = mujoco.MjvScene(model, maxgeom=model.ngeom + 50)
        self._option = mujoco.MjvOption()
        self._option.sitegroup[:] = 0
        self._render = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._render)

    def picture(
        self,
        q: np.ndarray,
        heart: np.ndarray,
        force: np.ndarray,
        camera: str,
        size: tuple[int, int],
        shadows: bool = True,
    ) -> Any:
        """One picture, shape (height, width, 3), of bytes."""
        mj, scene = self._mj, self._scene
        self._data.qpos[:] = [*q, *heart]
        mj.mj_kinematics(self._model, self._data)
        mj.mj_camlight(self._model, self._data)
        view = mj.MjvCamera()
        view.type, view.fixedcamid = mj.mjtCamera.mjCAMERA_FIXED, self._model.camera(camera).id
        mj.mjv_updateScene(self._model, self._data, self._option, None, view, mj.mjtCatBit.mjCAT_ALL, scene)
        if np.linalg.norm(force) > 0.05:
            tip = self._data.site("tip").xpos
            arrow = scene.geoms[scene.ngeom]
            mj.mjv_initGeom(arrow, mj.mjtGeom.mjGEOM_ARROW, np.zeros(3), np.zeros(3), np.eye(3).ravel(), _ARROW)
            # MuJoCo draws an arrow half as long as the way it connects.
            tail = tip - METRES_PER_NEWTON * force
            mj.mjv_connector(arrow, mj.mjtGeom.mjGEOM_ARROW, 0.006, tail, 2.0 * tip - tail)
            scene.ngeom += 1
        scene.flags[mj.mjtRndFlag.mjRND_SHADOW] = shadows
        pixels = np.empty((size[1], size[0], 3), np.uint8)
        area = mj.MjrRect(0, 0, *size)
        mj.mjr_render(area, scene, self._render)
        mj.mjr_readPixels(pixels, None, area, self._render)
        return pixels[::-1]

    def close(self) -> None:
        """Give the context back."""
        self._render.free()
        self._gl.free()


@contextlib.contextmanager
def scene_on(size: tuple[int, int], touch: Any, quick: bool = False) -> Iterator[RenderedScene]:
    """A scene of a size [pixel] whose heart stands at `touch` [m], or where the model has it.

    Raises:
        InputError: A package is missing, or no OpenGL works here.
    """
    platform = _platform()
    try:
        with packages():
            mujoco = importlib.import_module("mujoco")
            gl = importlib.import_module(f"mujoco.{platform}").GLContext(*size)
        try:
            gl.make_current()
            scene = RenderedScene(mujoco, model_at(touch), gl, size, quick)
        except BaseException:
            gl.free()
            raise
    except InputError:
        raise
    except Exception as error:  # each platform has its own: ImportError, AttributeError, GLError, FatalError, …
        reason = " ".join(str(error).split())[:200]
        bound = "a platform of OpenGL that works here"
        raise InputError("MUJOCO_GL", platform, bound, f"{_GL_REMEDY} ({reason})") from None
    try:
        yield scene
    finally:
        scene.close()


def _platform() -> str:
    """The module of mujoco that makes contexts: what MUJOCO_GL names, or what needs no display where there is none."""
    asked = os.environ.get("MUJOCO_GL", "").strip().lower()
    if asked in ("egl", "osmesa", "cgl", "glfw"):
        return asked
    if sys.platform == "darwin":
        return "cgl"
    return "egl" if sys.platform == "linux" and not os.environ.get("DISPLAY") else "glfw"


def model_at(touch: Any) -> Any:
    """A copy of the model whose heart, Heartbox and close-up stand at `touch`."""
    from jaxmpc.world.arm import model

    moved = copy.copy(model())
    if touch is None:
        return moved
    heart = moved.body("heart").id
    by = finite_array("touch", touch, (3,)) - moved.body_pos[heart]
    moved.body_pos[heart] += by
    moved.cam_pos[moved.camera("contact").id] += by
    for geom in range(moved.ngeom):
        if moved.geom(geom).name.startswith("heartbox_"):
            moved.geom_pos[geom] += by
    # The foot stays on the table, and the case reaches down to it.
    moved.geom_pos[moved.geom("heartbox_foot").id, 2] -= by[2]
    case = moved.geom("heartbox_case").id
    moved.geom_pos[case, 2] -= 0.5 * by[2]
    moved.geom_size[case, 2] = max(moved.geom_size[case, 2] + 0.5 * by[2], 1e-3)
    return moved


@contextlib.contextmanager
def packages() -> Iterator[None]:
    """Turn a missing package into an input error that says how to get it."""
    try:
        yield
    except ModuleNotFoundError as error:
        raise InputError(str(error.name), "not found", "installed", PACKAGES_REMEDY) from None


def finite_array(key: str, value: Any, shape: tuple[int | None, ...]) -> np.ndarray:
    """A finite array of a shape, of which None is any length.

    Raises:
        InputError: It is not.
    """
    array = np.asarray(value, float)
    sides = list(zip(shape, array.shape, strict=False))
    if array.ndim != len(shape) or any(want not in (None, found) for want, found in sides):
        wanted = ", ".join("n" if side is None else str(side) for side in shape)
        remedy = "One row a sample, one column an axis or joint."
        raise InputError(key, f"an array of shape {array.shape}", f"of shape ({wanted})", remedy)
    if not np.isfinite(array).all():
        raise InputError(key, "nan or inf", "finite", "Leave out the samples after a failure.")
    return array
