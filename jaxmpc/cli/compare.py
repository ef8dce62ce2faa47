"""`jaxmpc compare`: controllers side by side: one table with differences, one report with everything overlaid."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jaxmpc.files.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from jaxmpc.experiment import Experiment
    from jaxmpc.report.comparison import Contender

MOST = 8
"""Controllers that one picture can tell apart."""
SEEDS = 8
"""Drawn motions unless told otherwise."""
SAME = 1e-6
"""Share of its largest number by which two designs of one constant differ on two machines, and some room [-]."""
FIRST_SEED = 1000
"""Seed of the first drawn motion; tuners train on others unless told otherwise."""


def configure(parser: argparse.ArgumentParser) -> None:
    """Arguments of the verb."""
    parser.add_argument(
        "what",
        nargs="+",
        metavar="CONTROLLER",
        help="a published set (text, printed, cautious, family, …), a params.toml, a frozen controller (.npz) or the "
        "folder of a tuning run; the others are compared with the first; NAME=… gives one another name",
    )
    parser.add_argument("--experiment", default="table-1", help="a TOML file, or a published one (table-1)")
    parser.add_argument(
        "--seeds",
        type=int,
        help="drawn motions over which differences get their interval; 0: none (8; 0 where nothing is drawn)",
    )
    parser.add_argument("--limit", action="store_true", help="also the ratio to the least residual of any linear law")
    parser.add_argument("-o", "--output", type=Path, default=Path("compare.html"), help="the report (compare.html)")


def run(args: argparse.Namespace) -> int:
    """Compare; 1 where a controller was not OK somewhere.

    Raises:
        InputError: A controller, the experiment or an argument is wrong.
    """
    from jaxmpc.files.outputs import check_file, check_folder
    from jaxmpc.terminal.arguments import experiment_from
    from jaxmpc.terminal.process import use_all_cores

    if not 1 <= len(args.what) <= MOST:
        raise InputError("controllers", len(args.what), f"at most {MOST}", "Compare fewer at once.")
    if args.seeds is not None and not 0 <= args.seeds <= 10_000:
        raise InputError("--seeds", args.seeds, "in [0, 10000]", f"{SEEDS} are usual; 0 leaves the intervals out.")
    check_folder("-o", args.output.parent)
    if args.output.suffix != ".html" or args.output.parent.is_dir():
        check_file("-o", args.output, ".html")
    contenders = named([contender_from(text) for text in args.what])
    experiment = experiment_from(args.experiment)
    seeds = seeds_of(args.seeds, experiment)
    use_all_cores()
    for one in contenders:
        if one.frozen is not None:
            check_law(one, experiment)
    from jaxmpc.report.compare_page import report_of
    from jaxmpc.report.comparison import compared
    from jaxmpc.report.page import write_report
    from jaxmpc.report.side_by_side import table
    from jaxmpc.terminal.tables import show

    for one in contenders:
        print(f"{one.name}: {one.origin}")
    print(f"experiment {experiment.name}: {experiment.duration:g} s, physics {experiment.physics}")
    ratios = _ratios(contenders, experiment) if args.limit else None
    found = compared(contenders, experiment, seeds, ratios=ratios, said=_progress)
    whole = table(found)
    note = (
        f", differences over {len(seeds)} {experiment.draws} ± 95 % (over how many, where some were lost), * where "
        "that does not hold zero"
        if seeds
        else ""
    )
    show(f"side by side{note}", whole.head, whole.rows)
    args.output.parent.mkdir(parents=True, exist_ok=True)
    write_report(report_of(found), args.output)
    print(f"report: {args.output}")
    failures = list(found.failures())
    print("\n".join(failures), end="\n" if failures else "")
    return int(bool(failures))


def seeds_of(count: int | None, experiment: "Experiment") -> range:
    """What draws the motions; none where all would be the same run, whose differences have no interval.

    Args:
        count: How many were asked for; None is the usual number.
        experiment: What is met.

    Raises:
        InputError: Some were asked for, and nothing is drawn.
    """
    if not experiment.draws_anything:
        if count:
            remedy = "Every run would be the same one, and its differences certain: leave it out."
            raise InputError("--seeds", count, "0 where neither motion nor noise is drawn", remedy)
        count = 0
    return range(FIRST_SEED, FIRST_SEED + (SEEDS if count is None else count))


def contender_from(text: str) -> "Contender":
    """A controller from what the user wrote.

    Raises:
        InputError: It is none.
    """
    from jaxmpc.report.comparison import Contender
    from jaxmpc.synthesis.params import Params
    from jaxmpc.terminal.arguments import name_and_place, params_from, tuned_file

    given, place = name_and_place(text)
    path = Path(place)
    if place and path.is_dir():
        file = tuned_file(path)
        return Contender(given or path.name, Params.from_toml(file), f"tuned, {file}")
    if path.suffix == ".npz":
        from deploy.controller.file import ArtifactError, load

        try:
            artifact = load(path)
        except (ArtifactError, OSError) as error:
            raise InputError("controller", path, "a frozen controller", f"{error}.") from None
        try:
            params = Params.from_dict(artifact.params)
        except InputError as error:  # another version's
            raise error.at(path) from None
        return Contender(given or path.stem, params, f"frozen, {path}", artifact)
    params = params_from(place)
    if path.suffix == ".toml":
        return Contender(given or path.stem, params, f"{path}")
    return Contender(given or place, params, f"the published set {place}")


def check_law(contender: "Contender", experiment: "Experiment") -> None:
    """Refuse a frozen controller that would be another one here: what runs is designed anew from its parameters.

    Raises:
        InputError: It samples at another time, or has other gains than its parameters have on this experiment.
    """
    import jax
    import numpy as np

    from deploy.controller import frozen_gains
    from jaxmpc.synthesis import design

    artifact, params = contender.frozen, contender.params
    if artifact.T_s != experiment.sampling_time:
        bound = f"{experiment.sampling_time:g} s, as {experiment.name} samples"
        remedy = "Its gains hold for no other: compare it on an experiment with its sampling_time."
        raise InputError(f"sampling time of {contender.name}", f"{artifact.T_s:g} s", bound, remedy)
    found = design(params, experiment.timing, experiment.loop_path().force_filter)
    anew = frozen_gains.checked(jax.tree.map(np.asarray, found))
    if not _alike(frozen_gains.plain(artifact.gains), frozen_gains.plain(anew)):
        bound = f"of the gains that its parameters have on {experiment.name}"
        remedy = (
            "Compare it on an experiment with its filter of the force; if another version froze it, freeze it anew."
        )
        raise InputError(f"controller {contender.name}", "one of other gains", bound, remedy)


def _alike(frozen: Any, anew: Any) -> bool:
    """Whether two tables of gains, or lists of numbers or of tables, are the same but for rounding."""
    import numpy as np

    if isinstance(frozen, dict):
        return frozen.keys() == anew.keys() and all(_alike(frozen[key], anew[key]) for key in frozen)
    if isinstance(frozen, list):
        return len(frozen) == len(anew) and all(map(_alike, frozen, anew))
    a, b = np.asarray(frozen, float), np.asarray(anew, float)
    return a.shape == b.shape and bool(np.all(np.abs(a - b) <= SAME * np.max(np.abs(a), initial=0.0)))


def named(contenders: Sequence["Contender"]) -> "list[Contender]":
    """The same, each with a name of its own: two files `params.toml` take those of their folders along."""
    names = [one.name for one in contenders]
    found = []
    for k, one in enumerate(contenders):
        name = one.name if names.count(one.name) == 1 else f"{one.name} ({k + 1})"
        found.append(one._replace(name=name))
    return found


def _progress(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _ratios(contenders: Sequence["Contender"], experiment: "Experiment") -> "np.ndarray":
    """Residual over the least of any linear law that keeps the robot's demands, (contenders, stiffness, 3) [-]."""
    import numpy as np

    from jaxmpc.limit.comparison import cells, flown_by, left_by
    from jaxmpc.limit.least import LINES
    from jaxmpc.spectra.spectrum import spectrum_of

    _progress("looking for the least residual of any linear law …")
    least = list(cells(experiment))
    spectrum, path = spectrum_of(experiment, LINES), experiment.loop_path()
    limit = np.array([cell.limit.reached.rms for cell in least])
    found = []
    for one in contenders:
        flown = flown_by(one.params, experiment)
        left = [left_by(one.params, spectrum, path, cell.stiffness, cell.axis).rms for cell in least]
        found.append((np.array(left) if flown is None else flown.ravel()) / limit)
    return np.array(found).reshape(len(contenders), len(experiment.stiffness), 3)
