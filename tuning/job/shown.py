"""A tuning job in some lines: what is tuned on what, held to what, judged in which scenarios."""

from typing import TYPE_CHECKING

from tuning.job.goals import GOALS

if TYPE_CHECKING:
    from tuning.job.spec import TuneSpec


def resolved(spec: "TuneSpec") -> dict[str, str]:
    """Title and text of each line; all of it is in the spec that lies beside the results."""
    experiment, met = spec.experiment, spec.scenarios
    tissues = ", ".join(f"{K:g}" for K in experiment.stiffness)
    hard = [f"{name} {GOALS[name].sign} {GOALS[name].amount(limit)}" for name, limit in spec.goals.items()]
    implied = [f"{name} {GOALS[name].sign} {GOALS[name].amount(limit)}" for name, limit in spec.implied.items()]
    start = {axis.name: spec.params.to_dict().get(axis.name) for axis in spec.space.axes}
    return {
        "experiment": f"{experiment.name}, physics {experiment.physics}, {experiment.duration:g} s, K_s {tissues} N/m",
        "free": ", ".join(name if value is None else f"{name} from {value:.4g}" for name, value in start.items()),
        "held": ", ".join(hard) + (f"; by the robot's limits {', '.join(implied)}" if implied else ""),
        "minimised": ", ".join(f"{name} over {limit:g}" for name, limit in spec.soft.items()),
        "met": f"rhythms {', '.join(met.rhythms) or 'none'}; friction ±{100 * met.friction:g} %, "
        f"masses ±{100 * met.mass:g} %, delay {', '.join(map(str, met.delays)) or experiment.delay}",
        "risk": ", ".join(f"{name} {value}" for name, value in spec.to_dict()["risk"].items()),
    }
