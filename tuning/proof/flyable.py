"""Whether a tuned controller may fly: `jaxmpc freeze` itself is asked, with the robot's default limits."""

import sys
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory

from jaxmpc.export.freezing import freeze_controller
from jaxmpc.files.errors import InputError
from jaxmpc.quantities import FLOOR_FLAGS, HIGHEST_M_S, MARGINS
from jaxmpc.synthesis.params import Params
from tuning.job.spec import TuneSpec


def floor_of(spec: TuneSpec) -> dict[str, float]:
    """Margins that a controller of this job promises as it runs: its goals, and M_s whatever they are."""
    return {"M_s": HIGHEST_M_S, **({} if spec.ideal else spec.margin_goals)}


def freeze_command(spec: TuneSpec, experiment: str) -> str:
    """What freezes the job's result with the promises that it was tuned to, on what it was tuned on.

    Args:
        spec: The job.
        experiment: Name or file of its experiment.
    """
    ideal = spec.ideal and not spec.on_arm
    floor = {"M_s": HIGHEST_M_S, **spec.margin_goals} if ideal else floor_of(spec)
    flags = [f"{FLOOR_FLAGS[name]} {limit * MARGINS[name].times:.12g}" for name, limit in floor.items()]
    loop = ["--ideal"] if ideal else []
    return " ".join(["jaxmpc freeze params.toml --experiment", experiment, *loop, *flags, "-o controller.npz"])


def refusal(spec: TuneSpec, params: Params) -> str:
    """Why freezing refuses a controller; "" where it accepts, and for jobs that are not for a robot.

    Args:
        spec: The job; a robot's if its experiment has a robot's limits.
        params: The controller.
    """
    if not spec.experiment.limited:
        return ""
    with TemporaryDirectory() as folder:
        try:
            freeze_controller(Path(folder) / "controller.npz", params, spec.experiment, floor_of(spec), ideal=False)
        except InputError as error:
            return str(error)
    return ""


def rehearse(spec: TuneSpec) -> None:
    """Compile what `refusal` runs: by freezing the controller that the search begins with, with a floor of no height.

    Where that one is unstable, the rest compiles when it is needed.
    """
    if spec.experiment.limited:
        with TemporaryDirectory() as folder, suppress(InputError):
            anything = {"M_s": sys.float_info.max}
            freeze_controller(Path(folder) / "controller.npz", spec.space.base, spec.experiment, anything, ideal=False)
