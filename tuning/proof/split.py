"""What the residual is made of: what motion, friction and noise alone would leave, from the frequency response."""

from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from jaxmpc.law.gains import Gains
from jaxmpc.spectra.residual import Parts, residual_parts, residual_rms
from jaxmpc.spectra.spectrum import Spectrum, spectrum_of, stacked
from jaxmpc.stability.family import gains_on
from jaxmpc.stability.loop import contact_of
from jaxmpc.world.loop_path import LoopPath
from jaxmpc.xla.once import JitOnce
from jaxmpc.xla.place import on_cpu
from jaxmpc.xla.precision import in_float64
from tuning.objective.problem import training
from tuning.proof.found import FoundController

MOST = 8
"""Scenarios of training that it is averaged over, at most."""
CAUSES = ("motion", "friction", "noise")


class Split(NamedTuple):
    """Before and after, root mean square over the scenarios of training [N]."""

    whole: Float[np.ndarray, "2 stiffness 3"]
    """All together. Friction follows the velocity of the heart, so the squares of the parts do not add up to it."""
    motion: Float[np.ndarray, "2 stiffness 3"]
    friction: Float[np.ndarray, "2 stiffness 3"]
    """And model error; zero in the linear world, which has neither."""
    noise: Float[np.ndarray, "2 stiffness 3"]


@on_cpu()
@in_float64
def split(result: FoundController) -> Split:
    """The residual by its causes; NaN on a tissue where the loop is unstable."""
    spec = result.spec
    experiment = spec.experiment
    path, stiffness = experiment.loop_path(), np.asarray(experiment.stiffness)
    met = training(spec, spec.tune.train_seeds[:MOST])
    found = []
    for params, seen in ((spec.before, spec.met_before(met)), (result.params, met)):
        spectra = stacked([*map(spectrum_of, seen)])
        gains, K2 = gains_on(params, stiffness, path)
        own = path.with_cutoff(params.velocity_cutoff)
        whole, parts = _parts(gains, K2, stiffness, spectra, own)
        found.append([np.sqrt(np.mean(np.square(field), axis=1)) for field in (whole, *parts)])
    stable = result.stable(path.ideal)[..., None]
    return Split(*(np.where(stable, np.stack(pair), np.nan) for pair in zip(*found, strict=True)))


def _parts_of(gains: Gains, K2: Any, stiffness: Any, spectra: Spectrum, path: LoopPath) -> tuple[Any, Parts]:
    """Residual and its parts, (stiffness, scenarios, 3), of gains for each tissue; traceable."""

    def one(gains: Gains, K2: Any, K_s: Any, spectrum: Spectrum) -> tuple[Any, Parts]:
        contact = contact_of(K_s, K2, path)
        return residual_rms(gains, contact, spectrum), residual_parts(gains, contact, spectrum)

    over_scenarios = jax.vmap(one, (None, None, None, 0))
    found: tuple[Any, Parts] = jax.vmap(over_scenarios, (0, 0, 0, None))(gains, K2, stiffness, spectra)
    return found


_parts = JitOnce(_parts_of)
