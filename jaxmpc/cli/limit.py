"""`jaxmpc limit`: the least residual that any linear law could reach, and a controller beside it."""

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jaxmpc.files.errors import InputError

if TYPE_CHECKING:
    from jaxmpc.experiment import Experiment
    from jaxmpc.limit.comparison import LimitCell
    from jaxmpc.limit.flight import Flown
    from jaxmpc.limit.judged import Judged
    from jaxmpc.limit.least import Demands

MILLI = 1e3
PLACE = ("K_s N/m", "axis")
FLAGS = {"M_s": "--sensitivity", "chatter": "--chatter", "band": "--band"}
"""What asks for a demand."""
HEADER = ("measured", "motion", "friction", "noise", "true", "chatter m/s²", "M_s")


def configure(parser: argparse.ArgumentParser) -> None:
    """Arguments of the verb."""
    parser.add_argument("experiment", help="a TOML file, or a published one: table-1-wam, rhythm-fibrillation, …")
    parser.add_argument("--params", help="a params.toml or a published set to put beside it: text, cautious, …")
    parser.add_argument("--sensitivity", type=float, default=2.0, metavar="M_S", help="largest M_s (2)")
    parser.add_argument(
        "--chatter",
        type=float,
        default=1.2,
        help="RMS change of the acceleration asked per sample, m/s²; inf: no bound (1.2)",
    )
    parser.add_argument(
        "--band", type=float, default=0.0, help="0.08: the law has to hold for K_s within ±8 %% of what it knows (0)"
    )
    parser.add_argument("--fly", action="store_true", help="also fly each law in time, in the linear loop")
    parser.add_argument("-o", "--output", type=Path, metavar="FILE.json", help="everything as JSON, the laws too")


def run(args: argparse.Namespace) -> int:
    """Look for the laws, print, write."""
    from jaxmpc.files.outputs import check_file
    from jaxmpc.files.sealed import write_atomic
    from jaxmpc.limit.comparison import cells, told
    from jaxmpc.limit.least import Demands, check_demands
    from jaxmpc.terminal.arguments import experiment_from, params_from
    from jaxmpc.terminal.progress import progress, said_after
    from jaxmpc.terminal.tables import number, show

    check_file("-o", args.output, ".json")
    demands = Demands(args.sensitivity, args.chatter, args.band)
    try:
        check_demands(demands)
    except InputError as error:
        raise replace(error, key=FLAGS[error.key]) from None
    experiment = experiment_from(args.experiment)
    params = params_from(args.params) if args.params else None
    known = f"known to ±{100.0 * demands.band:g} %" if demands.band else "known"
    print(
        f"experiment {experiment.name}, physics {experiment.physics}: any linear law, stiffness {known}, "
        f"M_s ≤ {demands.M_s:g}, chatter ≤ {demands.chatter:g} m/s²"
    )
    found = []
    with progress("laws", 3 * len(experiment.stiffness), "of tissue and axis") as tick:
        for cell in cells(experiment, demands, params):
            found.append(cell)
            tick(len(found), f"{cell.stiffness:g} N/m, {cell.axis.upper()}")
    with said_after("flying each of them …"):
        flights = _flights(experiment, found) if args.fly else []

    table = [[*_place(cell), *_entries(cell.limit.reached)] for cell in found]
    for row, flight in zip(table, flights, strict=False):
        row.append(number(MILLI * flight.rms, 1))
    show("least residual, RMS in mN", (*PLACE, *HEADER, *(["flown"] if flights else [])), table, keys=2)
    if params is not None:
        table = [
            [*_place(cell), *_entries(cell.yours), *_flown(cell), number(cell.ratio, 2)] for cell in found if cell.yours
        ]
        learns = found[0].flown is not None
        besides = ", but for the column flown with nothing learned of the beat" if learns else ""
        header = (*PLACE, *HEADER, *(["flown"] if learns else []), "× limit")
        show(f"{args.params}, RMS in mN{besides}", header, table, keys=2)
        print(told(found, demands))
    if args.output:
        text = json.dumps(_plain(experiment.name, demands, found, flights), indent=1) + "\n"
        write_atomic(args.output, text.encode())
        print(f"written: {args.output}")
    return 0


def _place(cell: "LimitCell") -> list[str]:
    return [f"{cell.stiffness:g}", cell.axis.upper()]


def _entries(of: "Judged") -> list[str]:
    from jaxmpc.terminal.tables import number

    residuals = (of.rms, of.motion, of.friction, of.noise, of.true_rms)
    return [*(number(MILLI * value, 1) for value in residuals), number(of.chatter, 2), number(of.M_s, 2)]


def _flown(cell: "LimitCell") -> list[str]:
    from jaxmpc.terminal.tables import number

    return [] if cell.flown is None else [number(MILLI * cell.flown, 1)]


def _flights(experiment: "Experiment", found: "list[LimitCell]") -> "list[Flown]":
    """Each law in the linear loop; on the arm under the push of friction and model error."""
    from jaxmpc.limit.flight import flown
    from jaxmpc.quantities import AXES
    from jaxmpc.spectra.input_disturbance import uncompensated_acceleration

    pushed = None if experiment.physics == "linear" else uncompensated_acceleration(experiment)
    return [
        flown(
            cell.limit.law,
            cell.stiffness,
            experiment,
            cell.axis,
            None if pushed is None else pushed[:, AXES.index(cell.axis)],
        )
        for cell in found
    ]


def _plain(name: str, demands: "Demands", found: "list[LimitCell]", flights: "list[Flown]") -> dict[str, Any]:
    """Everything as JSON has it; infinite and missing numbers are null."""
    places = []
    for index, cell in enumerate(found):
        law = {key: _numbers(value) for key, value in cell.limit.law._asdict().items()}
        place = {"stiffness": cell.stiffness, "axis": cell.axis, "limit": _all(cell.limit.reached)}
        if flights:
            place["flown"] = _all(flights[index])
        if cell.yours is not None:
            place |= {"yours": _all(cell.yours), "ratio": _numbers(cell.ratio)}
        if cell.flown is not None:
            place["yours_flown"] = _numbers(cell.flown)
        places.append(place | {"law": law})
    return {"experiment": name, "demands": _all(demands), "cells": places}


def _all(of: Any) -> dict[str, Any]:
    return {key: _numbers(value) for key, value in of._asdict().items()}


def _numbers(value: Any) -> Any:
    import numpy as np

    return np.asarray(value).tolist() if np.all(np.isfinite(value)) else None
