"""The film of an experiment on the arm."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from jaxmpc.experiment import Experiment
from jaxmpc.files.errors import InputError

if TYPE_CHECKING:
    from jaxmpc.closed_loops import Outcome

SIZE = (960, 540)
"""Width and height [pixel]."""


def check_film(path: Path, experiment: Experiment) -> None:
    """Refuse, before anything is simulated, a film that could not be made.

    Raises:
        InputError: The experiment has no arm, the file has another suffix, a package is missing, or OpenGL does not
            work.
    """
    from tempfile import TemporaryDirectory

    from jaxmpc.pictures.video import write_video

    if experiment.physics == "linear":
        raise InputError("--video", str(path), "left out without an arm", "Add --physics wam.")
    if path.suffix.lower() != ".mp4":
        remedy = f"Name it {path.with_suffix('.mp4').name}."
        raise InputError("--video", str(path), "a file named *.mp4", remedy)
    q, zero = np.tile(experiment.arm.resting(), (2, 1)), np.zeros((2, 3))
    with TemporaryDirectory() as folder, _child_processes():
        probe = Path(folder) / "probe.mp4"
        write_video(probe, np.array([0.0, 0.1]), q, zero, zero, zero, fps=10, size=(320, 180), show=False)


def film(path: Path, experiment: Experiment, outcome: "Outcome", row: int) -> None:
    """Arm and heart beside the forces, in real time.

    Args:
        path: An MP4 file.
        experiment: What was run, on the arm.
        outcome: Its outcome, with trace.
        row: Which stiffness.

    Raises:
        InputError: A package is missing, or OpenGL does not work.
    """
    from jaxmpc.loop.arm import ArmSample
    from jaxmpc.pictures.video import write_video
    from jaxmpc.world.arm import tip_at
    from jaxmpc.world.heart.motion import displacement

    assert isinstance(outcome.trace, ArmSample)
    t = np.arange(experiment.steps) * experiment.sampling_time
    with _child_processes():
        write_video(
            path,
            t,
            np.asarray(outcome.trace.q)[row].T,
            displacement(experiment.motion, t)[0],
            np.asarray(outcome.trace.force)[row].T,
            experiment.signals.force_ref[: experiment.steps],
            touch=tip_at(experiment.arm.resting()),
            size=SIZE,
            title=f"{experiment.name}, $K_s$ = {experiment.stiffness[row]:g} N/m",
        )


@contextmanager
def _child_processes() -> Iterator[None]:
    """Without JAX's warning that a fork may deadlock: ffmpeg's process runs nothing of ours before it is replaced."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=r"os\.fork\(\) was called", category=RuntimeWarning)
        yield
