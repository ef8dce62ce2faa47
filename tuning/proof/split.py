"""What the residual is made of: what motion, friction and noise alone would leave, from the frequency response."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from jaxmpc.law.gains import Gains
from jaxmpc.spectra.residual import Parts, residual_parts, residual_rms
from jaxmpc.spectra.spectrum import Spectrum, spectrum_of, stacked
from jaxmpc.stability.family import gains_on
from jaxmpc.stability.loop import contact_of
from jaxmpc.synthesis.params import Params
from jaxmpc.world.loop_path import LoopPath
from jaxmpc.xla.once import JitOnce
from jaxmpc.xla.place import on_cpu
from jaxmpc.xla.precision import in_float64
from tuning.job.spec import TuneSpec
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
    found = []
    for asked in _asked(spec, result.params):
        whole, parts = _parts(*asked)
        found.append([np.sqrt(np.mean(np.square(field), axis=1)) for field in (whole, *parts)])
    stable = result.stable(spec.experiment.loop_path().ideal)[..., None]
    return Split(*(np.where(stable, np.stack(pair), np.nan) for pair in zip(*found, strict=True)))


@on_cpu()
@in_float64
def rehearse(spec: TuneSpec) -> None:
    """Compile what `split` runs."""
    for asked in _asked(spec, spec.space.base):
        _parts.compile(*asked)


def _asked(spec: TuneSpec, params: Params) -> Iterator[tuple[Any, ...]]:
    """What `_parts` is asked of the controller before, and of another."""
    path, stiffness = spec.experiment.loop_path(), np.asarray(spec.experiment.stiffness)
    met = training(spec, spec.tune.train_seeds[:MOST])
    for each, seen in ((spec.before, spec.met_before(met)), (params, met)):
        spectra = stacked([*map(spectrum_of, seen)])
        yield *gains_on(each, stiffness, path), stiffness, spectra, path.with_cutoff(each.velocity_cutoff)


def _parts_of(gains: Gains, K2: Any, stiffness: Any, spectra: Spectrum, path: LoopPath) -> tuple[Any, Parts]:
    """Residual and its parts, (stiffness, scenarios, 3), of gains for each tissue; traceable."""

    def one(gains: Gains, K2: Any, K_s: Any, spectrum: Spectrum) -> tuple[Any, Parts]:
        contact = contact_of(K_s, K2, path)
        return residual_rms(gains, contact, spectrum), residual_parts(gains, contact, spectrum)

    over_scenarios = jax.vmap(one, (None, None, None, 0))
    found: tuple[Any, Parts] = jax.vmap(over_scenarios, (0, 0, 0, None))(gains, K2, stiffness, spectra)
    return found


_parts = JitOnce(_parts_of)
