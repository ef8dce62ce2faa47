"""Where the margins of a job are judged."""

import numpy as np

from tuning.job.spec import TuneSpec

COARSER = 3
"""Spectra, which only propose, judge margins at one in so many stiffnesses."""
FEWER = (9, 3)
"""And so many known stiffnesses of a family besides its knots, at the middle and the ends of the band."""


def judged_cells(spec: TuneSpec, coarse: bool) -> tuple[np.ndarray, np.ndarray | None]:
    """Where margins are judged: K_s, and the K̂ that a family holds there, NaN for its fixed gains [N/m].

    Args:
        spec: The job.
        coarse: At fewer stiffnesses, the experiment's own and the knots among them.
    """
    own = coarser(spec) if coarse else spec.judged_at
    if spec.params.listening is None:
        return own, None
    if spec.fixed_stay:
        own = own[:0]
    stiffness, believed = spec.judged_known(*(FEWER if coarse else ()))
    return np.concatenate([own, stiffness]), np.concatenate([np.full(len(own), np.nan), believed])


def coarser(spec: TuneSpec) -> np.ndarray:
    """Fewer stiffnesses at which margins are judged, the experiment's own among them [N/m]."""
    return np.unique(np.concatenate([spec.experiment.stiffness, spec.judged_at[::COARSER]]))
