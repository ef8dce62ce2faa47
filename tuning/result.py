"""What a tuning run found, proven on motion that it has not seen, and its files."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from jaxmpc import __version__
from jaxmpc.params import Params
from jaxmpc.sealed import seal, write_atomic
from jaxmpc.spec import write_toml
from jaxmpc.stability import Margins
from tuning.goals import UNITS, standing
from tuning.heldout import compare
from tuning.spec import TuneSpec
from tuning.state import FEASIBLE, State


@dataclass(frozen=True)
class TuneResult:
    """Before and after, and the way there. Index 0 is the start point, 1 the tuned controller."""

    spec: TuneSpec
    params: Params
    """The tuned controller; without a feasible point, the one that came closest."""
    feasible: bool
    """Whether it holds every goal at every stiffness."""
    heldout: np.ndarray
    """Residual RMS on the held-out seeds, (2, seeds, stiffness, 3); NaN where unstable [N]."""
    margins: dict[str, Margins]
    """"as run" and "ideal", each field (2, stiffness)."""
    state: State
    """Histories of the descent."""

    @property
    def worst(self) -> tuple[float, float]:
        """Worst held-out residual RMS over seed, stiffness and axis, before and after; NaN where unstable [N]."""
        before, after = map(float, self.heldout.max(axis=(1, 2, 3)))
        return before, after

    @property
    def gain(self) -> float:
        """How far the worst held-out residual fell, relative to before [-]; NaN where either is unstable."""
        before, after = self.worst
        return 1.0 - after / before

    def unmet(self) -> str:
        """Which goal is missed, on which tissue and by how much, of the point that came closest; "" if all are met."""
        judged: Any = Margins(*(field[1] for field in self.margins["ideal" if self.spec.ideal else "as run"]))
        stiffness = self.spec.experiment.stiffness
        unstable = np.asarray(judged.spectral_radius) >= 1.0
        if unstable.any():
            K_s, radius = stiffness[int(np.argmax(judged.spectral_radius))], float(np.max(judged.spectral_radius))
            return f"no stable point was found: at {K_s:g} N/m the closest one has spectral radius {radius:.4f}"
        normalised = np.asarray(standing(judged, self.spec.goals).normalised)
        goal, tissue = np.unravel_index(int(np.argmax(normalised)), normalised.shape)
        if normalised[goal, tissue] <= FEASIBLE:
            return ""
        name = list(self.spec.goals)[goal]
        limit, found = self.spec.goals[name], float(getattr(judged, name)[tissue])
        sign, missed = ("≤", found - limit) if name == "M_s" else ("≥", limit - found)
        unit = f" {UNITS[name]}" if UNITS[name] else ""
        return (
            f"no point meets every goal: {name} {sign} {limit:g}{unit} is missed by {missed:.3g}{unit} "
            f"at {stiffness[tissue]:g} N/m by the point that came closest"
        )


def judge(spec: TuneSpec, state: State) -> TuneResult:
    """Compare the start point with what was found, on the held-out seeds and over the stiffness set."""
    feasible = bool(np.isfinite(state.best))
    params = spec.space.exact(state.best_z if feasible else state.closest_z)
    both = Params.stack([spec.params, params])
    heldout, found = compare(both, spec.experiment, spec.tune.heldout_seeds)
    return TuneResult(spec, params, feasible, heldout, found, state)


def write(result: TuneResult, folder: Path) -> list[Path]:
    """Write params.toml (if feasible), history.npz, report.txt and the figures.

    Returns:
        The files written.
    """
    from tuning.report import before_after_figure, history_figure, report

    written = []
    if result.feasible:
        written.append(folder / "params.toml")
        comment = "Tuned by jaxmpc. Freeze it: jaxmpc freeze params.toml -o controller.npz"
        write_toml(written[-1], {"params": result.params.to_dict(), "provenance": provenance(result)}, comment)
    written.append(folder / "history.npz")
    write_atomic(written[-1], history(result))
    written.append(folder / "report.txt")
    write_atomic(written[-1], report(result).encode())
    for name, draw in (("history.png", history_figure), ("before_after.png", before_after_figure)):
        written.append(folder / name)
        draw(result, written[-1])
    return written


def provenance(result: TuneResult) -> dict[str, Any]:
    """Where the parameters come from and what was measured of them."""
    spec, (before, after) = result.spec, result.worst
    stiffness = map(float, spec.experiment.stiffness)
    peaks = {kind: [float(x) for x in found.M_s[1]] for kind, found in result.margins.items()}
    return {
        "made_by": f"jaxmpc {__version__} tune",
        "spec_sha256": spec.digest,
        "experiment": spec.experiment.name,
        "train_seeds": list(spec.tune.train_seeds),
        "heldout_seeds": list(spec.tune.heldout_seeds),
        "goals": {**spec.goals, "ideal": spec.ideal},
        "stiffness": list(stiffness),
        "M_s_as_run": peaks["as run"],
        "M_s_ideal": peaks["ideal"],
        "heldout_worst_rms_before": before,
        "heldout_worst_rms_after": after,
    }


def history(result: TuneResult) -> bytes:
    """The descent as sealed arrays: engineering values of every look and start, up to the last look."""
    state, space, looks = result.state, result.spec.space, result.state.look
    arrays = {
        "worst": state.worst[:looks],
        "M_s": state.M_s[:looks],
        "incumbent": state.incumbent[:looks],
        "skipped": state.skipped,
        "values": space.values(state.path[:looks]),
        "heldout": result.heldout,
    }
    header = {"kind": "jaxmpc tuning history", "spec": result.spec.to_dict(), "names": space.names}
    return seal(header, arrays)
