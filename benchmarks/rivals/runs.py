"""Who runs: names, what each is given, and one run of each."""

import msgspec
import numpy as np

from benchmarks.rivals import pi
from benchmarks.rivals.costs import Costs
from benchmarks.rivals.gradient import tuned
from benchmarks.rivals.objective import evaluator, mpc_aob, pi_control
from benchmarks.rivals.record import Clock, Run, Spent
from benchmarks.rivals.search import TUNERS, search
from tuning.job.spec import TuneSpec
from tuning.objective.problem import problem_of, training

GRADIENT, PI, TEXTBOOK, COARSE = "gradient", "PI, CMA-ES", "PI, textbook", " + coarse"


def names(spec: TuneSpec) -> list[str]:
    """Everybody, the tuner first: others start where its descent on spectra ended."""
    ends = ["", COARSE] if spec.on_arm else [""]
    return [GRADIENT, *(tuner + end for tuner in TUNERS for end in ends), PI, TEXTBOOK]


def rivals(spec: TuneSpec) -> list[str]:
    """Who tunes the same controller."""
    return [name for name in names(spec) if name.removesuffix(COARSE) in TUNERS]


def run(name: str, seed: int, spec: TuneSpec, evaluations: int, costs: Costs, proposed: Run | None) -> Run:
    """One run of one tuner.

    Args:
        name: One of `names`.
        seed: Of all that it draws.
        spec: The job.
        evaluations: Budget of a rival.
        costs: Of evaluations and gradients.
        proposed: The tuner's run with this seed, whose coarse starts are offered.
    """
    if name == GRADIENT:
        seeded = msgspec.structs.replace(spec, tune=msgspec.structs.replace(spec.tune, seed=seed))
        return tuned(seeded, costs.cost_ratio, costs.rate, costs.steps)
    coarse = proposed if name.endswith(COARSE) else None
    clock = Clock(Spent(*coarse.coarse.tolist()) if coarse else None)
    # As the tuner does, everybody builds the problem by himself, which runs the controller before tuning once.
    problem = problem_of(spec, training(spec, spec.tune.train_seeds))
    if name in (PI, TEXTBOOK):
        textbook = pi.encode(pi.textbook(spec.experiment))[None]
        tuner, budget = TUNERS["CMA-ES"](len(pi.AXES), seed), 1 if name == TEXTBOOK else evaluations
        return search(tuner, pi.AXES, evaluator(problem, pi_control), textbook, budget, costs.steps, clock)
    starts = coarse.starts if coarse else np.array([spec.space.encode(spec.params)])
    tuner = TUNERS[name.removesuffix(COARSE)](spec.space.size, seed)
    return search(tuner, spec.space.axes, evaluator(problem, mpc_aob), starts, evaluations, costs.steps, clock)
