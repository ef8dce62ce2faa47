"""Pictures: shapes that weigh nothing and fit, films of the right length, and plain words where OpenGL is missing."""

import subprocess
import sys
import types
from pathlib import Path

import numpy as np
import pytest

from jaxmpc.files.errors import InputError
from jaxmpc.pictures import render, video
from jaxmpc.pictures.video import still, write_video
from jaxmpc.world.arm import mjcf, model
from tests.sources import ROOT

mujoco = pytest.importorskip("mujoco")

POSTURE = (0.0, 0.7, 0.0, 2.2)
HEART = ("heart",)
ARM = ("shoulder_yaw", "shoulder_pitch", "upper_arm", "forearm", "tool")


@pytest.fixture(scope="module")
def touching():
    data = mujoco.MjData(model())
    data.qpos[:4] = POSTURE
    mujoco.mj_forward(model(), data)
    return data


@pytest.fixture(scope="module")
def picture(tmp_path_factory):
    path = tmp_path_factory.mktemp("picture") / "still.png"
    skip_without(lambda: still(path, POSTURE, np.zeros(3), size=(320, 240)))
    from PIL import Image

    return np.asarray(Image.open(path)).astype(int)


def skip_without(make):
    try:
        make()
    except InputError as error:
        if error.key in ("MUJOCO_GL", "imageio_ffmpeg"):
            pytest.skip(str(error))
        raise


def geoms(*bodies):
    return [g for g in range(model().ngeom) if model().body(model().geom_bodyid[g]).name in bodies]


def distance(data, one, other):
    return mujoco.mj_geomDistance(model(), data, one, other, 1.0, None)


def test_shapes_change_no_dynamics():
    spec = mujoco.MjSpec.from_string(mjcf())
    for geom in list(spec.geoms):
        spec.delete(geom)
    bare, full = spec.compile(), model()
    assert bare.ngeom == 0
    assert full.ngeom > 50
    for name in ("nq", "nv", "nbody", "nsite"):
        assert getattr(bare, name) == getattr(full, name)
    for name in (
        *("body_mass", "body_inertia", "body_ipos", "body_iquat", "body_pos", "body_quat", "body_subtreemass"),
        *("jnt_pos", "jnt_axis", "jnt_range", "dof_armature", "dof_damping", "dof_M0", "site_pos", "qpos0"),
    ):
        assert np.array_equal(getattr(bare, name), getattr(full, name)), name
    states = [mujoco.MjData(m) for m in (bare, full)]
    for m, data in zip((bare, full), states, strict=True):
        data.qpos[:4], data.qvel[:4] = POSTURE, (0.3, -0.5, 0.2, 0.7)
        for _ in range(20):
            mujoco.mj_step(m, data)
    assert np.array_equal(states[0].qpos, states[1].qpos)


def test_shapes_collide_with_nothing():
    assert not model().geom_contype.any()
    assert not model().geom_conaffinity.any()


def test_nominal_posture_touches(touching):
    assert np.allclose(touching.site("tip").xpos, touching.site("target").xpos, atol=1e-6)


def test_surface_of_the_heart_lies_at_the_target(touching):
    """A ray from above meets the heart at the target, and the surface is level there."""
    down, hits = np.array([0.0, 0.0, -1.0]), []
    for dx, dy in ((0.0, 0.0), (0.004, 0.0), (-0.004, 0.0), (0.0, 0.004), (0.0, -0.004)):
        above = touching.site("target").xpos + np.array([dx, dy, 0.05])
        lengths = [_ray(touching, g, above, down) for g in geoms(*HEART)]
        hits.append(0.05 - min(length for length in lengths if length >= 0.0))
    assert hits[0] == pytest.approx(0.0, abs=1e-6)
    assert max(hits[1:]) < 0.0
    assert min(hits[1:]) > -5e-4


def _ray(data, geom, start, direction):
    size, kind = model().geom_size[geom], model().geom_type[geom]
    return mujoco.mju_rayGeom(data.geom_xpos[geom], data.geom_xmat[geom], size, start, direction, kind)


def test_only_the_tip_touches_the_heart(touching):
    heart, tip = geoms(*HEART), model().geom("tool_tip").id
    for geom in geoms(*ARM):
        nearest = min(distance(touching, geom, other) for other in heart)
        assert abs(nearest) < 1e-3 if geom == tip else nearest > 2e-3, model().geom(geom).name


def test_heart_and_heartbox_stand_clear(touching):
    """Only the rod under the heart meets the Heartbox, in its opening; the box stands on the table."""
    box = [g for g in geoms("world") if model().geom(g).name.startswith("heartbox_")]
    fixed = [g for g in geoms("world") if g not in box]
    assert min(distance(touching, g, other) for g in geoms(*HEART) for other in fixed) > 0.05
    rod = model().geom("cradle_rod").id
    assert min(distance(touching, g, other) for g in geoms(*HEART) if g != rod for other in box) > 0.01
    assert distance(touching, rod, model().geom("heartbox_opening").id) < 0.0
    foot, table, case = (model().geom(name).id for name in ("heartbox_foot", "table", "heartbox_case"))
    bottom = touching.geom_xpos[foot, 2] - model().geom_size[foot, 2]
    assert bottom == pytest.approx(touching.geom_xpos[table, 2] + model().geom_size[table, 2], abs=1e-9)
    assert touching.geom_xpos[case, 2] - model().geom_size[case, 2] == pytest.approx(bottom + 6e-3, abs=1e-9)


def test_heartbox_follows_the_touching_point():
    touch = np.array([0.45, 0.10, 0.00])
    moved = render.model_at(touch)
    data = mujoco.MjData(moved)
    mujoco.mj_forward(moved, data)
    assert np.allclose(data.site("target").xpos, touch)
    assert np.allclose(data.geom("heartbox_opening").xpos[:2], touch[:2])
    bottoms = [m.geom("heartbox_case").pos[2] - m.geom("heartbox_case").size[2] for m in (model(), moved)]
    assert bottoms[0] == pytest.approx(bottoms[1], abs=1e-12)
    assert moved.geom("heartbox_foot").pos[2] == pytest.approx(model().geom("heartbox_foot").pos[2], abs=1e-12)


def test_import_is_light_and_leaves_the_environment():
    code = (
        "import os, sys; before = dict(os.environ); import jaxmpc.pictures.video; assert dict(os.environ) == before;"
        "assert not {'mujoco', 'matplotlib', 'mediapy', 'imageio_ffmpeg', 'PIL', 'jax'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


class BrokenContext:
    def __init__(self, width, height):
        raise AttributeError("'NoneType' object has no attribute 'eglQueryString'")


@pytest.mark.parametrize("asked", ["", "egl", "osmesa", "EGL "])
def test_without_opengl_the_error_names_the_remedy(monkeypatch, tmp_path, asked):
    monkeypatch.setenv("MUJOCO_GL", asked)
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    platform = asked.strip().lower() or "egl"
    monkeypatch.setitem(sys.modules, f"mujoco.{platform}", types.SimpleNamespace(GLContext=BrokenContext))
    with pytest.raises(InputError, match=r"libegl1 libgl1-mesa-dri.*MUJOCO_GL=osmesa.*eglQueryString") as caught:
        still(tmp_path / "a.png", POSTURE, np.zeros(3))
    assert (caught.value.key, caught.value.value) == ("MUJOCO_GL", platform)
    assert not list(tmp_path.iterdir())


def test_missing_package_is_named(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with (
        pytest.raises(InputError, match=r"imageio_ffmpeg = not found.*jaxmpc\[sim,video\]"),
        video._encoder(tmp_path / "a.mp4", (64, 64), 30),
    ):
        pytest.fail("an encoder without its package")


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({"path": "film.avi"}, "path"),
        ({"size": (321, 240)}, "size"),
        ({"size": (320, 16)}, "size"),
        ({"fps": 0}, "fps"),
        ({"t": np.zeros(5)}, "t"),
        ({"q": np.zeros((4, 4))}, "q"),
        ({"heart": np.zeros((5, 2))}, "heart"),
        ({"force": np.full((5, 3), np.nan)}, "force"),
    ],
)
def test_wrong_input_is_named(tmp_path, change, key):
    rows = {"heart": np.zeros((5, 3)), "force": np.zeros((5, 3)), "force_ref": np.zeros((5, 3))}
    arguments = {"t": np.arange(5.0), "q": np.tile(POSTURE, (5, 1)), **rows, "size": (320, 240)} | change
    path = tmp_path / str(arguments.pop("path", "film.mp4"))
    with pytest.raises(InputError) as caught:
        write_video(path, **arguments)
    assert caught.value.key == key
    assert not list(tmp_path.iterdir())


def test_unknown_camera_is_named(tmp_path):
    with pytest.raises(InputError, match="Did you mean 'contact'"):
        still(tmp_path / "a.png", POSTURE, np.zeros(3), "contacts")


def test_still_shows_arm_and_heart(picture):
    red, green, blue = picture[..., 0], picture[..., 1], picture[..., 2]
    heart = (red > 90) & (red > 1.8 * green) & (red > 1.8 * blue)
    white = picture.min(axis=-1) > 215
    sensor = (blue > 1.8 * red) & (blue > 80)
    assert picture.shape == (240, 320, 3)
    assert heart.sum() > 400
    assert white.sum() > 600
    assert sensor.sum() > 30
    # The arm reaches from the left down onto the heart at the right: sensor above heart.
    assert np.nonzero(white)[1].mean() < 160 < np.nonzero(heart)[1].mean()
    assert np.nonzero(sensor)[0].mean() < np.nonzero(heart)[0].mean()


# JAX, which other tests have started, warns of every fork; ffmpeg's runs nothing of ours.
@pytest.mark.filterwarnings(r"ignore:os\.fork\(\) was called:RuntimeWarning")
def test_film_has_its_frames_and_size(tmp_path):
    t = np.arange(0.0, 0.5, 1e-3)
    zero = np.zeros((len(t), 3))
    force = zero + np.array([0.0, 0.0, -5.0])
    path, q = tmp_path / "film.mp4", np.tile(POSTURE, (len(t), 1))
    skip_without(lambda: write_video(path, t, q, zero, force, force, fps=8, size=(320, 180), title="title", show=False))
    ffmpeg = pytest.importorskip("imageio_ffmpeg").get_ffmpeg_exe()
    command = [ffmpeg, "-v", "error", "-i", path, "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    film = np.frombuffer(subprocess.run(command, check=True, capture_output=True).stdout, np.uint8)
    film = film.reshape(4, 180, 320, 3)
    about = subprocess.run([ffmpeg, "-i", path], check=False, capture_output=True, text=True).stderr
    assert "320x180" in about
    assert "8 fps" in about
    assert [p.name for p in Path(tmp_path).iterdir()] == ["film.mp4"]
    # The cursor moves: where it stood in the first frame it no longer stands in the last.
    panel = film[:, :, 190:].astype(int)
    cursor = (panel[..., 0] - panel[..., 1] > 60).sum(axis=1)
    columns = [int(np.argmax(frame)) for frame in cursor]
    assert columns == sorted(columns)
    assert columns[-1] > columns[0] + 40


ENCODE = """
import sys
from pathlib import Path
import numpy as np
from jaxmpc.pictures.video import _encoder

frame = np.random.default_rng(0).integers(0, 255, (64, 64, 3), np.uint8)
with _encoder(Path(sys.argv[1]), (64, 64), 25) as encoder:
    for _ in range(int(sys.argv[2])):
        encoder.send(frame)
"""


@pytest.mark.parametrize("frames", [3, 3000])
def test_a_film_that_a_full_disk_cuts_short_takes_no_whole_ones_place(tmp_path, frames):
    """ffmpeg then ends as if all were well, or goes before the last frame."""
    pytest.importorskip("imageio_ffmpeg")
    (tmp_path / "film.mp4").write_bytes(b"of before")
    command = ["bash", "-c", 'ulimit -f 4; exec "$@"', "-", sys.executable, "-c", ENCODE]
    command += [str(tmp_path / "film.mp4"), str(frames)]
    ran = subprocess.run(command, cwd=ROOT, check=False, capture_output=True, text=True)
    assert "could not write the whole film; is the disk full?" in ran.stderr.splitlines()[-1]
    assert [(path.name, path.read_bytes()) for path in tmp_path.iterdir()] == [("film.mp4", b"of before")]


def test_panel_draws_up_to_the_cursor():
    t = np.linspace(0.0, 1.0, 200)
    force = np.tile(np.sin(20.0 * t)[:, None], (1, 3))
    panel = video._Panel(t, force, 0.0 * force, (400, 400), "")
    half, whole = (np.zeros((400, 400, 3), np.uint8) for _ in range(2))
    panel.draw(half, 0.5)
    panel.draw(whole, 1.0)
    left, right = (round(x) for x in panel._columns)
    middle = (left + right) // 2
    assert np.array_equal(half[:, : middle - 3], whole[:, : middle - 3])
    assert np.array_equal(half[:, middle + 6 :], panel._empty[:, middle + 6 :])
    assert not np.array_equal(whole[:, middle + 6 : right], half[:, middle + 6 : right])
