"""Pictures and films of the arm on the beating heart, without a display."""

import contextlib
import errno
import importlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from jaxmpc.files.errors import InputError, nearest
from jaxmpc.pictures.figures import ACCENT, BASELINE, TUNED, in_style
from jaxmpc.pictures.render import PACKAGES_REMEDY, finite_array, packages, scene_on
from jaxmpc.terminal.progress import progress

CAMERAS = ("overview", "contact")
SIZES = (64, 3840)
"""Least and largest width and height of a picture [pixel]."""


def still(
    path: str | Path,
    q: Any,
    heart: Any,
    camera: str = "overview",
    size: tuple[int, int] = (1280, 960),
    *,
    touch: Any = None,
    force: Any = None,
) -> None:
    """Write one picture of the arm and the heart.

    Args:
        path: A PNG file.
        q: Joint angles, shape (4,) [rad].
        heart: Displacement of the heart from `touch`, world axes, shape (3,) [m].
        camera: "overview" (arm and heart) or "contact" (tip and heart).
        size: Width and height [pixel].
        touch: Where the heart's target lies without displacement, shape (3,) [m]; None is the tip at
            the model's nominal posture q = (0, 0.7, 0, 2.2).
        force: Force on the tissue, drawn as an arrow into the tip, shape (3,) [N]; None draws none.

    Raises:
        InputError: An argument has another shape or is not finite, a package is missing, or OpenGL does not work.
    """
    path = _target(path, ".png")
    if camera not in CAMERAS:
        raise InputError("camera", camera, "a camera of the model", nearest(camera, list(CAMERAS)))
    _check_size(size, 1)
    angles, shift = finite_array("q", q, (4,)), finite_array("heart", heart, (3,))
    push = np.zeros(3) if force is None else finite_array("force", force, (3,))
    with packages():
        from PIL import Image
    fine = 2 * size[0], 2 * size[1]
    with scene_on(fine, touch) as scene:
        picture = Image.fromarray(scene.picture(angles, shift, push, camera, fine))
    # Four pixels to one soften the shadows' edges.
    picture.reduce(2).save(path)


def write_video(
    path: str | Path,
    t: Any,
    q: Any,
    heart: Any,
    force: Any,
    force_ref: Any,
    *,
    touch: Any = None,
    fps: int = 30,
    size: tuple[int, int] = (1280, 720),
    title: str = "",
    show: bool = True,
) -> None:
    """Write a film in real time: the scene with a close-up at the left, the forces drawn as they come at the right.

    Frame i shows the latest sample at t[0] + i / fps.

    Args:
        path: An MP4 file; it appears when it is complete.
        t: Times, increasing, shape (n,) [s].
        q: Joint angles, shape (n, 4) [rad].
        heart: Displacement of the heart from `touch`, world axes, shape (n, 3) [m].
        force: Measured force on the tissue, world axes, shape (n, 3) [N].
        force_ref: Wanted force, shape (n, 3) [N].
        touch: Where the heart's target lies without displacement, shape (3,) [m]; None is the tip at
            the model's nominal posture q = (0, 0.7, 0, 2.2).
        fps: Frames a second [1/s].
        size: Width and height, both even [pixel].
        title: A line above the plots.
        show: Whether progress is shown on standard error.

    Raises:
        InputError: An argument has another shape or is not finite, a package is missing, or OpenGL does not work.
    """
    path = _target(path, ".mp4")
    _check_size(size, 2)
    times = finite_array("t", t, (None,))
    n = len(times)
    if n < 2 or (np.diff(times) <= 0.0).any():
        raise InputError("t", f"{n} samples", "at least two increasing times", "Sort the samples by time.")
    if not 1 <= fps <= 240:
        raise InputError("fps", fps, "between 1 and 240", "30 suits most players.")
    angles, shift = finite_array("q", q, (n, 4)), finite_array("heart", heart, (n, 3))
    measured, wanted = finite_array("force", force, (n, 3)), finite_array("force_ref", force_ref, (n, 3))
    frames = int((times[-1] - times[0]) * fps + 1e-9) + 1
    width, height = size
    left = round(0.56 * width)
    inset = (round(0.34 * left), round(0.31 * height))
    with packages():
        panel = _Panel(times, measured, wanted, (width - left, height), title)
    image = np.empty((height, width, 3), np.uint8)
    with (
        scene_on((left, height), touch, quick=True) as scene,
        _encoder(path, size, fps) as encoder,
        progress("video", frames, "frames", show) as tick,
    ):
        for i in range(frames):
            now = times[0] + i / fps
            k = max(int(np.searchsorted(times, now + 1e-9, side="right")) - 1, 0)
            image[:, :left] = scene.picture(angles[k], shift[k], measured[k], "overview", (left, height))
            close_up = scene.picture(angles[k], shift[k], measured[k], "contact", inset, shadows=False)
            image[10 : 14 + inset[1], 10 : 14 + inset[0]] = 255
            image[12 : 12 + inset[1], 12 : 12 + inset[0]] = close_up
            panel.draw(image[:, left:], now)
            encoder.send(image)
            tick(i + 1, "")


class _Panel:
    """Force over time. Drawn twice by matplotlib, with and without the curves; a frame takes columns of both."""

    def __init__(
        self, t: np.ndarray, force: np.ndarray, force_ref: np.ndarray, size: tuple[int, int], title: str
    ) -> None:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        with in_style():
            dpi = 100.0 * size[1] / 720.0
            drawing: Any = Figure(figsize=(size[0] / dpi, size[1] / dpi), dpi=dpi)
            canvas: Any = FigureCanvasAgg(drawing)
            drawing.get_layout_engine().set(w_pad=0.12, h_pad=0.06)
            axes = drawing.subplots(4, 1, sharex=True, height_ratios=[2.2, 1.0, 1.0, 1.0])
            axes[0].plot(t, force_ref[:, 2], color=BASELINE, linewidth=2.0, label="wanted")
            curves = [axes[0].plot(t, force[:, 2], color=TUNED, linewidth=1.0, label="measured")[0]]
            axes[0].set_ylabel("force Z [N]")
            axes[0].legend(loc="upper right", ncols=2)
            residual = force - force_ref
            bound = 1.08 * max(float(np.abs(residual).max()), 1e-3)
            for k, name in enumerate("XYZ"):
                curves += axes[k + 1].plot(t, residual[:, k], color=TUNED, linewidth=0.8)
                axes[k + 1].set(ylabel=f"residual {name} [N]", ylim=(-bound, bound))
            axes[-1].set(xlabel="time [s]", xlim=(t[0], t[-1]))
            drawing.align_ylabels(axes)
            if title:
                drawing.suptitle(title, fontsize=11.0)
            canvas.draw()
            drawing.set_layout_engine("none")
            self._full = np.asarray(canvas.buffer_rgba())[..., :3].copy()
            boxes = [axis.get_window_extent() for axis in axes]
            for curve in curves:
                curve.set_visible(False)
            canvas.draw()
            self._empty = np.asarray(canvas.buffer_rgba())[..., :3].copy()
        self._span = float(t[0]), float(t[-1])
        self._columns = boxes[0].x0, boxes[0].x1
        self._rows = [slice(size[1] - int(box.y1), size[1] - int(box.y0)) for box in boxes]
        self._cursor = np.array([int(ACCENT[k : k + 2], 16) for k in (1, 3, 5)], np.uint8)

    def draw(self, out: np.ndarray, now: float) -> None:
        """Draw the curves up to `now` [s] into `out`, shape (height, width, 3)."""
        share = (now - self._span[0]) / (self._span[1] - self._span[0])
        column = round(self._columns[0] + share * (self._columns[1] - self._columns[0]))
        out[:] = self._empty
        out[:, :column] = self._full[:, :column]
        for rows in self._rows:
            out[rows, column : column + 2] = self._cursor


@contextlib.contextmanager
def _encoder(path: Path, size: tuple[int, int], fps: int) -> Iterator[Any]:
    """What takes frames, shape (height, width, 3), by `send`; the film appears under its name when all went well."""
    with packages():
        imageio_ffmpeg = importlib.import_module("imageio_ffmpeg")
    part = path.with_name(f".{path.stem}.part.mp4")
    options = ["-crf", "20", "-movflags", "+faststart"]
    # Blocks of 2 pixels are all that the colour format asks for; the default, 16, would scale the picture.
    writer = imageio_ffmpeg.write_frames(
        str(part), size, fps=fps, quality=None, macro_block_size=2, output_params=options, ffmpeg_log_level="fatal"
    )
    try:
        with contextlib.closing(writer):
            _start(writer)
            yield writer
        # What ffmpeg thinks of its end is not to be had; a film that a full disk cut short has no index.
        _check(imageio_ffmpeg, part)
        part.replace(path)
    except OSError:
        raise OSError(errno.EIO, "ffmpeg could not write the whole film; is the disk full?", f"{path}") from None
    finally:
        part.unlink(missing_ok=True)


def _start(writer: Any) -> None:
    try:
        writer.send(None)
    except RuntimeError as error:
        if "No ffmpeg exe" not in str(error):
            raise
        raise InputError("ffmpeg", "not found", "installed", PACKAGES_REMEDY) from None


def _check(imageio_ffmpeg: Any, path: Path) -> None:
    try:
        imageio_ffmpeg.count_frames_and_secs(str(path))
    except RuntimeError as error:
        raise OSError(f"{error}") from None


def _target(path: str | Path, suffix: str) -> Path:
    path = Path(path)
    if path.suffix.lower() != suffix:
        raise InputError("path", str(path), f"a file named *{suffix}", f"Name it {path.with_suffix(suffix).name}.")
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


def _check_size(size: tuple[int, int], multiple: int) -> None:
    if any(not SIZES[0] <= side <= SIZES[1] or side % multiple for side in size):
        even = "even, " if multiple == 2 else ""
        remedy = "Give width and height in pixels."
        raise InputError("size", f"{size[0]} x {size[1]}", f"{even}from {SIZES[0]} to {SIZES[1]}", remedy)
