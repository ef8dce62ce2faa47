"""A flight recording through the recorded runtime once more: where does it part from what flew?

Every input comes from the recording: angles, velocities, force, wanted force and the torques that were applied. So
nothing feeds back, and what remains of a difference is a difference of the two programs.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from deploy.controller.artifact import Artifact
from deploy.controller.runtimes import arm_runtime
from deploy.flight.inputs import COMPARED, KNOWN, LAW
from deploy.flight.recorder import COLUMNS, FlightRecording
from jaxmpc.law.recorded import RecordedInputs
from jaxmpc.terminal import layout

TOLERANCE = 1e-9
"""Largest difference, as a share of the largest value or of 1 in its unit, whichever is more: rounding stays below
1e-12, another law or gain does not."""


class Difference(NamedTuple):
    """How a signal differs."""

    signal: str
    unit: str
    samples: int
    """That were compared."""
    largest: float
    at: float
    """Time of the largest [s]."""
    tolerance: float
    first: float
    """Time of the first beyond the tolerance [s]; NaN if there is none."""
    by: float
    """How far there."""

    @property
    def parts(self) -> bool:
        """Whether it does."""
        return not math.isnan(self.first)


def through_runtime(inputs: RecordedInputs, artifact: Artifact) -> dict[str, np.ndarray]:
    """The signals of `COMPARED` from the runtime; NaN where it does not make them."""
    runtime = arm_runtime(artifact)
    found = {name: np.full((len(inputs.time), COLUMNS[name][0]), np.nan) for name in COMPARED}
    q = [tuple(row) for row in inputs.q.tolist()]
    runtime.start(q[0])
    for k, angles in enumerate(q):
        if not np.all(np.isfinite(inputs.q[k])):
            continue
        found["qd"][k] = runtime.velocity(angles)
        qd, applied = tuple(inputs.qd[k].tolist()), tuple(inputs.applied[k].tolist())
        known = bool(np.all(np.isfinite(inputs.force[k])))
        force = tuple(inputs.force[k].tolist()) if known else None
        if inputs.contact[k]:
            if inputs.enters[k] and np.all(np.isfinite(inputs.a[k - 1])):
                runtime.last_a = tuple(inputs.a[k - 1].tolist())
            if inputs.enters[k] or k == 0:
                runtime.enter(force or (0.0, 0.0, 0.0), angles, qd)
            wanted = tuple(map(tuple, inputs.force_ref[k].tolist())) if inputs.force_ref.ndim == 3 else None
            found["wanted"][k] = runtime.control(angles, qd, force, wanted or tuple(inputs.force_ref[k].tolist()))
            found["v"][k], found["a"][k] = runtime.last_v, runtime.last_a
            for name in ("p_hat", "u", "gain", *KNOWN):
                found[name][k] = getattr(runtime, name)
            runtime.applied(applied)
            g, ceiling, lately, share = inputs.memory[k].tolist()
            if math.isfinite(g + ceiling + lately):
                runtime.memory = g, ceiling, lately
            if math.isfinite(share):
                runtime.swing_share = share
        elif inputs.servo[k]:
            a = tuple(inputs.a[k].tolist())
            found["wanted"][k] = runtime.servo(angles, qd, a, force or (0.0, 0.0, 0.0))
        if np.all(np.isfinite(inputs.deflection[k])):
            runtime.deflection = tuple(inputs.deflection[k].tolist())
    return found


def compare(
    recording: FlightRecording, inputs: RecordedInputs, replayed: Mapping[str, np.ndarray], tolerance: float = TOLERANCE
) -> list[Difference]:
    """How each signal that was computed anew differs from the recorded one.

    Args:
        recording: What flew.
        inputs: What `inputs_of` made of it.
        replayed: Signals (n, width), NaN where they are not made.
        tolerance: See `TOLERANCE`.
    """
    rows = []
    for signal, again in replayed.items():
        if signal not in recording.signals:
            continue
        where = inputs.fresh if signal == "qd" else inputs.judged & (inputs.contact | inputs.servo)
        if signal in LAW:
            where = where & inputs.contact
        if signal == "wanted":
            where = where & np.any(np.isnan(inputs.deflection), axis=1)
        made = np.all(np.isfinite(again), axis=1)
        if signal in LAW:
            # In control the law makes all of them: one that is no number here differs, and is not left out.
            made |= inputs.contact & np.all(np.isfinite(inputs.q), axis=1)
        where = where & made
        recorded, found, time = recording.signals[signal][where], again[where], inputs.time[where]
        if not len(recorded):
            rows.append(Difference(signal, COMPARED[signal], 0, 0.0, math.nan, tolerance, math.nan, 0.0))
            continue
        # What is no number in one of them alone is an infinite difference, not none.
        same = (recorded == found) | (np.isnan(recorded) & np.isnan(found))
        with np.errstate(invalid="ignore"):
            apart = np.nan_to_num(np.max(np.where(same, 0.0, np.abs(recorded - found)), axis=1), nan=math.inf)
        bound = tolerance * max(1.0, float(np.max(np.abs(found), initial=0.0, where=np.isfinite(found))))
        beyond = np.flatnonzero(apart > bound)
        most = int(np.argmax(apart))
        first, by = (float(time[beyond[0]]), float(apart[beyond[0]])) if len(beyond) else (math.nan, 0.0)
        rows.append(
            Difference(signal, COMPARED[signal], len(time), float(apart[most]), float(time[most]), bound, first, by)
        )
    return rows


def table(title: str, rows: list[Difference]) -> str:
    """The differences as text."""
    lines = []
    for row in rows:
        at = f"{row.at:.3f}" if row.samples else "-"
        parts = f"at {row.first:.3f} s by {row.by:.3g} {row.unit}" if row.parts else "no" if row.samples else "-"
        lines.append([row.signal, str(row.samples), f"{row.largest:.3g}", at, f"{row.tolerance:.3g}", parts])
    return f"{title}\n{layout.table(['signal', 'samples', 'largest', 'at [s]', 'allowed', 'parts'], lines)}"
