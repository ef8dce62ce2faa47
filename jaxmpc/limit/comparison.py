"""A controller beside the limit: what it leaves, and how many times the least residual that is."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxmpc.evaluation import evaluate
from jaxmpc.experiment import Experiment
from jaxmpc.limit.judged import Judged, judged
from jaxmpc.limit.least import LINES, ROBOT, Demands, Limit, least
from jaxmpc.quantities import AXES
from jaxmpc.spectra.spectrum import Spectrum, spectrum_of
from jaxmpc.stability import margins
from jaxmpc.stability.controller import controller_response
from jaxmpc.stability.family import family_margins, gains_on
from jaxmpc.stability.loop import contact_of
from jaxmpc.synthesis.params import Params
from jaxmpc.world.loop_path import LoopPath
from jaxmpc.xla.precision import in_float64


class LimitCell(NamedTuple):
    """One tissue and axis of an experiment."""

    stiffness: float
    """[N/m]"""
    axis: str
    limit: Limit
    yours: Judged | None
    """What a controller leaves there, from spectra, with nothing learned of the beat."""
    flown: float | None = None
    """What one leaves that learns the beat, flown on the experiment [N]; None of one that does not."""

    @property
    def ratio(self) -> float:
        """The controller's residual over the least [-], flown where it learns; NaN without either."""
        if self.yours is None or not self.limit.reached.rms > 0.0:
            return float("nan")
        return (self.yours.rms if self.flown is None else self.flown) / self.limit.reached.rms


def cells(experiment: Experiment, demands: Demands = ROBOT, params: Params | None = None) -> Iterator[LimitCell]:
    """The limit on each tissue and axis of an experiment, one after the other, and a controller beside it.

    Raises:
        InputError: The demands make no sense, no law of the class keeps them, or the solver is not installed.
    """
    spectrum, path = spectrum_of(experiment, LINES), experiment.loop_path()
    flown = None if params is None else flown_by(params, experiment)
    for i, stiffness in enumerate(experiment.stiffness):
        for k, axis in enumerate(AXES):
            yours = None if params is None else left_by(params, spectrum, path, stiffness, axis, demands.band)
            own = None if flown is None else float(flown[i, k])
            yield LimitCell(stiffness, axis, least(spectrum, path, stiffness, axis, demands), yours, own)


def flown_by(params: Params, experiment: Experiment) -> np.ndarray | None:
    """Residual of a controller that learns the beat, which no spectrum tells, (stiffness, 3) [N]; None of others."""
    if params.listening is None or not params.listening.harmonics or experiment.physics == "linear":
        return None
    return np.asarray(evaluate(params, experiment).metrics.rms)


def told(found: Sequence[LimitCell], demands: Demands = ROBOT) -> str:
    """What it comes to in a sentence: how many times the limit, and whether both kept the same bounds."""
    if any(cell.yours and not np.isfinite(cell.yours.M_s) for cell in found):
        return "yours is unstable on a tissue of these: no residual, no ratio"
    found = [cell for cell in found if cell.ratio == cell.ratio]
    if not found:
        return "nothing disturbs the loop: the limit leaves nothing, and there is no ratio to it"
    ratios = [cell.ratio for cell in found]
    worst = max(found, key=lambda cell: cell.ratio)
    M_s, chatter = (max(getattr(cell.yours, name) for cell in found if cell.yours) for name in ("M_s", "chatter"))
    kept = M_s <= 1.01 * demands.M_s and chatter <= 1.01 * demands.chatter
    note = "" if kept else f"; it keeps other bounds than the limit: M_s {M_s:.2f}, chatter {chatter:.2f} m/s²"
    where = f"{worst.stiffness:g} N/m, {worst.axis.upper()}"
    return f"yours is {min(ratios):.2f} to {worst.ratio:.2f} × the limit, the most at {where}{note}"


@in_float64
def left_by(
    params: Params, spectrum: Spectrum, path: LoopPath, stiffness: float, axis: str, band: float = 0.0
) -> Judged:
    """What a controller leaves, judged as the limit is; NaN, with M_s = ∞, where its loop is unstable.

    Args:
        params: One controller; one with knots is judged with the stiffness known.
        spectrum: What disturbs the loop.
        path: Delay and filters.
        stiffness: K_s [N/m].
        axis: "x", "y" or "z".
        band: b; its M_s is the largest for stiffnesses in K_s (1 ± b).
    """
    ratios = np.linspace(1.0 - band, 1.0 + band, 3 if band else 1)
    if params.listening is None:
        M_s = float(np.max(margins(params, stiffness * ratios, path=path).M_s))
    else:
        M_s = float(np.max(family_margins(params, [stiffness], ratios, path).M_s))
    if not np.isfinite(M_s):
        nan = float("nan")
        return Judged(nan, nan, nan, nan, nan, nan, M_s)
    gains, K2 = jax.tree.map(lambda leaf: leaf[0], gains_on(params, [stiffness], path))
    contact = contact_of(stiffness, K2, path.with_cutoff(params.velocity_cutoff))
    return judged(
        lambda theta: controller_response(gains, jnp.exp(-1j * theta)), contact, spectrum, AXES.index(axis), M_s
    )
