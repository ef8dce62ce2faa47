"""What `jaxmpc demo` tells at its end: simulated and flown residuals over the same stretch, and worst margins."""

from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    import numpy as np

    from deploy.controller.artifact import Artifact
    from deploy.twin.flight import TwinFlight
    from jaxmpc import Experiment
    from jaxmpc.closed_loops import Outcome
    from sweeps.result import Result
    from tuning import TuneResult

STIFFNESS, SETTLE = 810.0, 8.0
"""Stiffness of the tissue on the arm [N/m]; what is left out of the flight in contact [s]."""


class Arm(NamedTuple):
    """Two controllers on the simulated arm, within the robot's limits."""

    experiment: "Experiment"
    text: "Outcome"
    family: "Outcome"


def summary(
    folder: Path,
    swept: "Result",
    tuned: "TuneResult",
    arm: Arm,
    artifact: "Artifact",
    flight: "TwinFlight",
    seconds: float,
) -> None:
    """Print it all, and what lies in the folder."""
    import numpy as np

    from jaxmpc.quantities import MARGINS
    from jaxmpc.terminal.tables import show

    print("\nlinear loop, without the robot's limits, unseen motion: worst residual", end=" ")
    print(" → ".join(f"{1e3 * rms:.1f}" for rms in tuned.worst), "mN, text → autotuned", end="")
    best = swept.best(1, 2.0)
    print(f"; best of the sweep with M_s ≤ 2: {1e3 * best.worst('rms')[0]:.1f} mN" if len(best) else "")

    flown = flight.rms(SETTLE)
    text, family = (_residuals(arm, outcome, flight) for outcome in (arm.text, arm.family))
    show(
        f"the arm within the robot's limits, {STIFFNESS:g} N/m, unseen motion: residual RMS of X / Y / Z",
        ("controller", "measured [mN]", "true force [mN]", "clamped"),
        [
            ["paper's text design, simulated", *_told(*text)],
            ["family, simulated", *_told(*family)],
            ["family, flown in lock-step", *_told(*flown, flight.clamped(SETTLE))],
        ],
    )
    as_run = tuned.margins["as run"]
    published = {name: row.worst(np.asarray(getattr(as_run, name))[0]) for name, row in MARGINS.items()}
    names = ("family, stiffness unknown", f"family, known to {band(artifact)}")
    tables = {"paper's text design": published, **dict(zip(names, worst_tables(artifact), strict=True))}
    show(
        "worst margins from 375 to 1900 N/m, as it runs",
        ("controller", *(row.heading for row in MARGINS.values())),
        [[name, *(row.entry(table[key]) for key, row in MARGINS.items())] for name, table in tables.items()],
    )
    share = np.max(flown[0] / text[0])
    print(f"flown: at most {share:.2f} of the residual of the paper's text design")
    print(f"\neverything lies in {folder}/ ({seconds:.0f} s):")
    for path in sorted(folder.glob("*")):
        print(f"  {path}{'/' if path.is_dir() else ''}")


def millinewtons(values: Any) -> str:
    """Forces [N] of the three axes, in mN."""
    return " / ".join(f"{1e3 * float(value):.0f}" for value in values)


def errors(arm: Arm, outcome: "Outcome", flight: "TwinFlight") -> "tuple[np.ndarray, np.ndarray, np.ndarray]":
    """Errors of a simulated run while the heart moved as under the flight.

    Returns:
        Of the measured and of the true force (n, 3) [N], and where a limit acted (n,); rows are the flight's cycles.
    """
    import numpy as np

    from jaxmpc.loop.arm import ArmSample

    trace = outcome.trace
    assert isinstance(trace, ArmSample)
    first = round(flight.began / arm.experiment.sampling_time)
    rows = slice(first, first + len(flight.time))
    wanted = np.asarray(trace.force_ref)[0, :, rows, 0]
    measured, true = (np.asarray(force)[0, :, rows] - wanted for force in (trace.force, trace.true_force))
    return measured.T, true.T, np.asarray(trace.clamped)[0, 0, rows]


def _residuals(arm: Arm, outcome: "Outcome", flight: "TwinFlight") -> "tuple[np.ndarray, np.ndarray, float]":
    """Residual RMS (3,) [N] of a simulated run, measured and true, and the share of clamped samples [-], as flown."""
    import numpy as np

    measured, true, clamped = (values[flight.time[: len(values)] >= SETTLE] for values in errors(arm, outcome, flight))
    return np.sqrt(np.mean(measured**2, axis=0)), np.sqrt(np.mean(true**2, axis=0)), float(np.mean(clamped > 0.0))


def _told(measured: Any, true: Any, clamped: float) -> list[str]:
    """Residuals, measured and true, and the share of clamped samples."""
    return [millinewtons(measured), millinewtons(true), f"{clamped:.2%}"]


def worst_tables(artifact: "Artifact") -> list[dict[str, float]]:
    """Worst margins of both tables: of the fixed gains on every tissue, and where the stiffness is known."""
    from jaxmpc.quantities import MARGINS

    assert artifact.family is not None
    tables = artifact.margins, artifact.family["rows"]
    return [
        {name: (max if row.ceiling else min)(each[name] for each in table) for name, row in MARGINS.items()}
        for table in tables
    ]


def band(artifact: "Artifact") -> str:
    """How well the stiffness is known where the second table holds, in per cent."""
    assert artifact.family is not None
    return f"±{100 * artifact.family['band']:g} %"
