"""What the residual costs where cables swing: the least under all margins against how many hard trials are lost.

    python -m benchmarks.cable_frontier -o DIR [--cutoff 180 600] [--fractions 0.6 0.3] [--tuned PARAMS.toml]

Minimised is the residual of `arm-unlimited-tune` by its spectra, over that of the text design with the WAM's
own velocity filter; held are its margins, and a bound on the share of trials, of those that `jaxmpc trials --hard`
begins with, in which the linear loop of the whole arm is unstable, no guard (`jaxmpc.law.gain_backoff`) beside it. By
CMA-ES, from the least strict bound to the strictest, each search begun at the best that is known for its bound;
whatever was seen counts for every bound that it meets, so fronts are monotone. A local search: a residual that it finds
can be had, a lower one may be too.
"""

import argparse
from collections.abc import Callable, Sequence
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import jax
import msgspec
import numpy as np
from cmaes import CMA
from jaxtyping import Array

from benchmarks.rivals.objective import BATCH, evaluator, mpc_aob
from benchmarks.rivals.room import shares, vectors
from jaxmpc import Params
from jaxmpc.experiment.build import structure_of
from jaxmpc.files.errors import InputError
from jaxmpc.files.sealed import write_atomic
from jaxmpc.files.toml import write_toml
from jaxmpc.pictures.figures import ACCENT, BASELINE, TUNED, figure
from jaxmpc.stability.whole_arm import ROUNDING, radii, robots_of, whole_arm_matrix
from jaxmpc.synthesis import design_one
from jaxmpc.terminal.process import use_all_cores
from jaxmpc.terminal.progress import progress
from jaxmpc.world.arm import chain
from jaxmpc.world.robot import Robot
from tuning import TuneSpec
from tuning.job.space import SearchSpace
from tuning.objective.problem import problem_of, training
from tuning.search.state import FEASIBLE
from tuning.trials import HARD, Job

STEP = 0.1
"""First step size of each search, in shares of the room [-]."""
PRICE = 20.0
"""Of a share of lost trials beyond its bound, in units of log residual [-]."""
SLOPE, FAST = 0.2, 0.02
"""Of those beyond the bound, a loop that grows by `FAST` a sample adds `SLOPE` of a trial, a slower one less: else all
were steps [-]."""
COLORS = (TUNED, ACCENT, "#e0a030", "#5c9e5c")


class Judged(NamedTuple):
    """Controllers and how they stand, each (controllers, …)."""

    z: np.ndarray
    """Unconstrained, as the tuner moves them."""
    loss: np.ndarray
    """The tuner's [-]."""
    residual: np.ndarray
    """Over the text design's, worst tissue, axis and scenario [-]; NaN where unstable."""
    hard: np.ndarray
    """Largest normalised margin goal [-]; met at 1 and below."""
    lost: np.ndarray
    """Share of the hard trials whose linear loop is unstable [-]."""
    growth: np.ndarray
    """How quickly each trial's loop grows over `FAST`, 0 to 1, the quickest first, (controllers, trials) [-]."""

    def best(self, bound: float) -> int | None:
        """Which has the least residual of those that hold everything."""
        held = (self.hard <= FEASIBLE) & (self.lost <= bound + 1e-12) & np.isfinite(self.residual)
        return int(np.argmin(np.where(held, self.residual, np.inf))) if held.any() else None


class Room(NamedTuple):
    """Where a front is searched."""

    space: SearchSpace
    judge: Callable[[np.ndarray], Judged]


def room_of(cutoff: float, count: int) -> Room:
    """The tuner's room and objective with a velocity filter [rad/s], and so many hard trials."""
    guarded = TuneSpec.from_toml(Path(str(resources.files("jaxmpc") / "examples" / "arm-unlimited-tune.toml")))
    bare = Params.from_dict({**guarded.params.to_dict(), "guarded": False})
    published = msgspec.structs.replace(guarded, params=bare)
    experiment = msgspec.structs.replace(published.experiment, velocity_lowpass=cutoff)
    spec = msgspec.structs.replace(published, experiment=experiment)
    problem = problem_of(spec, training(spec, spec.tune.train_seeds), spectral=True)
    if cutoff != published.experiment.velocity_lowpass:
        own = problem_of(published, training(published, published.tune.train_seeds), spectral=True)
        problem = problem._replace(data=problem.data._replace(reference=own.data.reference))
    evaluate, space = evaluator(problem, mpc_aob), spec.space
    job = Job((spec.params,), experiment, HARD)
    trials = [job.trial(i) for i in range(count)]
    kind, robots = structure_of(trials[0].arm, trials[0].tissue), robots_of(trials)

    @jax.jit
    def matrices(z: Array, robots: Robot) -> Array:
        def one(vector: Array) -> Array:
            params = space.decode(vector, 1.0)
            gains, _ = design_one(params, experiment.sampling_time)
            return jax.vmap(lambda robot: whole_arm_matrix(chain(), kind, robot, gains, params.K2))(robots)

        return jax.vmap(one)(z)

    def judge(z: np.ndarray) -> Judged:
        seen = evaluate(z)
        padded = np.concatenate([z, np.repeat(z[-1:], -len(z) % BATCH, axis=0)])
        radius = np.concatenate(
            [radii(np.asarray(matrices(part, robots))) for part in np.split(padded, len(padded) // BATCH)]
        )
        lost = (radius > 1.0 + ROUNDING)[: len(z)].mean(axis=1)
        growth = np.sort(np.clip(np.log(np.maximum(radius, 1.0)) / FAST, 0.0, 1.0)[: len(z)], axis=1)[:, ::-1]
        residual = spec.soft["rms_ratio"] * np.asarray(seen.score)
        return Judged(z, np.asarray(seen.loss), residual, np.asarray(seen.hard), lost, growth)

    return Room(space, judge)


def front(room: Room, bounds: Sequence[float], start: Params, generations: int, tick: Any) -> Judged:
    """Everything that the searches of one front saw.

    Args:
        room: Where.
        bounds: On the share of lost trials [-].
        start: Where the first search begins.
        generations: Of each search, `BATCH` controllers each.
        tick: Told how far it is.
    """
    axes, known = room.space.axes, room.judge(room.space.encode(start)[None])
    bounds = sorted(bounds, reverse=True)
    for i, bound in enumerate(bounds):
        best = int(np.argmin(_loss(known, bound)))
        search = CMA(
            mean=shares(axes, known.z[[best]])[0],
            sigma=STEP,
            bounds=np.tile([0.0, 1.0], (room.space.size, 1)),
            population_size=BATCH,
            seed=i,
        )
        for generation in range(generations):
            asked = np.stack([search.ask() for _ in range(BATCH)])
            found = room.judge(vectors(axes, asked))
            search.tell(list(zip(asked, _loss(found, bound).tolist(), strict=True)))
            known = Judged(*map(np.concatenate, zip(known, found, strict=True)))
            at = known.best(bound)
            least = "none" if at is None else f"residual {known.residual[at]:.3f}"
            tick(i * generations + generation + 1, f"lost ≤ {bound:g}: {least}")
    return known


def _loss(found: Judged, bound: float) -> np.ndarray:
    count = found.growth.shape[1]
    beyond = found.growth[:, int(bound * count + 1e-9) :].sum(axis=1) / count
    loss: np.ndarray = found.loss + PRICE * (np.maximum(found.lost - bound, 0.0) + SLOPE * beyond)
    return loss


def compare(args: argparse.Namespace) -> str:
    """Search every front, write the controllers and the picture; the table."""
    points = {"text": Params.published("text"), "cautious": Params.published("cautious")}
    points |= {"tuned": Params.from_toml(args.tuned)} if args.tuned else {}
    start = points.get("tuned", points["text"])
    args.out.mkdir(parents=True, exist_ok=True)
    lines = [f"{'filter':>7} {'bound':>6} {'lost':>5} {'residual over text':>19}  controller"]
    fronts: dict[float, list[tuple[float, float]]] = {}
    stand: dict[str, tuple[float, float]] = {}
    for cutoff in args.cutoff:
        room = room_of(cutoff, args.trials)
        if not stand:
            found = room.judge(np.stack([room.space.encode(params) for params in points.values()]))
            stand = dict(zip(points, zip(found.lost.tolist(), found.residual.tolist(), strict=True), strict=True))
            for name, (lost, residual) in stand.items():
                lines.append(f"{cutoff:7g} {name:>8} {lost:3.2f} {residual:19.2f}")
        with progress(f"{cutoff:g} rad/s", len(args.fractions) * args.generations, "generations") as tick:
            known = front(room, args.fractions, start, args.generations, tick)
        fronts[cutoff] = []
        for bound in sorted(args.fractions, reverse=True):
            best = known.best(bound)
            if best is None:
                lines.append(f"{cutoff:7g} {bound:6.2f}  none holds the margins and this bound")
                continue
            params, lost, residual = room.space.exact(known.z[best]), known.lost[best], known.residual[best]
            fronts[cutoff].append((float(lost), float(residual)))
            said = ", ".join(f"{name} {float(getattr(params, name)):.3g}" for name in room.space.names)
            lines.append(f"{cutoff:7g} {bound:6.2f} {lost:5.2f} {residual:19.2f}  {said}")
            comment = f"Residual {residual:.2f} of text, {lost:.2f} of hard trials lost; found by cable_frontier."
            write_toml(args.out / f"{cutoff:g}-{bound:g}.toml", {"params": params.to_dict()}, comment)
    picture(fronts, stand, args.out)
    return "\n".join(lines)


def picture(fronts: dict[float, list[tuple[float, float]]], points: dict[str, tuple[float, float]], out: Path) -> None:
    """Residual over lost trials, a line per velocity filter, and known controllers."""
    with figure(out / "cable-frontier.png", size=(6.0, 4.0)) as axes:
        for (cutoff, found), color in zip(fronts.items(), COLORS * len(fronts), strict=False):
            axes.plot(
                [lost for lost, _ in found],
                [residual for _, residual in found],
                "o-",
                ms=4,
                color=color,
                label=f"velocity filter {cutoff:g} rad/s",
            )
        for name, (lost, residual) in points.items():
            axes.plot(lost, residual, "s", color=BASELINE)
            axes.annotate(name, (lost, residual), xytext=(5, 5), textcoords="offset points")
        axes.set_yscale("log")
        axes.set_yticks([0.5, 0.7, 1.0, 1.5, 2.0, 3.0], ["0.5", "0.7", "1", "1.5", "2", "3"])
        axes.minorticks_off()
        axes.set_xlim(0.0, 1.0)
        axes.set_xlabel("share of hard trials that the linear whole arm loses [-]")
        axes.set_ylabel("largest residual over text's [-]")
        axes.legend(fontsize=8.0)


def main() -> None:
    """Search, print, draw."""
    parser = argparse.ArgumentParser(prog="benchmarks.cable_frontier", description=__doc__.split("\n")[0])
    parser.add_argument("-o", "--out", type=Path, required=True, metavar="DIR", help="folder of the results")
    parser.add_argument("--cutoff", type=float, nargs="+", default=[180.0], help="velocity filters [rad/s]")
    parser.add_argument(
        "--fractions", type=float, nargs="+", default=[0.8, 0.6, 0.45, 0.3, 0.2], help="bounds on lost trials"
    )
    parser.add_argument("--trials", type=int, default=60, help="hard trials that are looked at")
    parser.add_argument("--generations", type=int, default=60, help=f"of each search, {BATCH} controllers each")
    parser.add_argument(
        "--tuned", type=Path, metavar="PARAMS", help="a tuned controller: start, and point of the picture"
    )
    args = parser.parse_args()
    use_all_cores()
    try:
        _check(args)
        text = compare(args)
    except InputError as error:
        parser.error(str(error))
    print(f"\n{text}")
    write_atomic(args.out / "report.txt", f"{text}\n".encode())


def _check(args: argparse.Namespace) -> None:
    for name, values, low, high, unit in (
        ("trials", [args.trials], 1, 10_000, ""),
        ("generations", [args.generations], 1, 10_000, ""),
        ("fractions", args.fractions, 0.0, 1.0, ""),
        ("cutoff", args.cutoff, 1.0, 1e5, " rad/s"),
    ):
        for value in values:
            if not low <= value <= high:
                raise InputError(f"--{name}", value, f"in [{low:g}, {high:g}]{unit}", "Leave it out for the usual.")


if __name__ == "__main__":
    main()
