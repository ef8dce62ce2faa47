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
from deploy.flight.forgetting import FILTER, observers_forget, velocity_forgets
from deploy.flight.recorder import COLUMNS, FlightRecording, RecordingError
from jaxmpc.law.recorded import RecordedInputs
from jaxmpc.terminal import layout

INPUTS = ("time", "q", "qd", "force", "force_ref", "applied", "a", "state", "position_age")
GIVEN = ("qd", "force_ref", "applied")
"""Those that the law was given in every cycle of contact; a force may be missing."""
COMPARED: Mapping[str, str] = {
    "qd": "rad/s",
    "u": "N",
    "v": "m/s²",
    "a": "m/s²",
    "p_hat": "m/s²",
    "gain": "-",
    "stiffness": "N/m",
    "authority": "-",
    "dither": "N",
    "wanted": "N m",
}
"""Signals that are computed anew, with units."""
KNOWN = ("stiffness", "authority", "dither")
"""Those of a schedule; recordings from before there was one lack them."""
LAW = ("u", "v", "a", "p_hat", "gain", *KNOWN)
"""Those that the cascades and the guard make; elsewhere than in contact they rest."""
TOLERANCE = 1e-9
"""Largest difference, as a share of the largest value or of 1 in its unit, whichever is more: rounding stays below
1e-12, another law or gain does not."""
MISSED = 1.999
"""Periods from a sample to the next that are no longer one: the loop counts 2 as a cycle missed [-]."""
LARGEST = 1e60
"""No input is larger, whatever its unit: of such ones products leave the finite numbers, at which Python raises."""
SERVO = ("armed", "approach", "retract", "stopped")
"""States in which the torque is that of a servo on the tip."""


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


def inputs_of(recording: FlightRecording, artifact: Artifact, sha256: str) -> RecordedInputs:
    """What the law was given.

    Args:
        recording: What flew.
        artifact: The controller.
        sha256: Of its file.

    Raises:
        RecordingError: It was another controller, or the recording lacks something.
    """
    header, signals = recording.header, recording.signals
    if header.get("artifact") != sha256:
        flown = f"{str(header.get('artifact'))[:16]}…"
        raise RecordingError(f"the controller that flew has the sha256 {flown}, and this one has {sha256[:16]}…")
    if header.get("T_s") != artifact.T_s:
        raise RecordingError(f"it was recorded every {header.get('T_s')} s, and the law runs every {artifact.T_s:g} s")
    scheduled = artifact.gains.schedule is not None
    guarded = artifact.gains.guard is not None
    needed = [name for name in (*INPUTS, *COMPARED) if scheduled or name not in KNOWN]
    needed += ["gain_memory"] if guarded else []
    if missing := [name for name in needed if name not in signals]:
        raise RecordingError(f"it lacks the signal {missing[0]}")
    names = header.get("names")
    states = names.get("state") if isinstance(names, dict) else None
    if not isinstance(states, list) or "contact" not in states:
        raise RecordingError("its header does not name the states")
    if not len(signals["time"]):
        raise RecordingError("it holds no samples")
    number = signals["state"][:, 0]
    if not np.isin(number, np.arange(len(states))).all():
        raise RecordingError("it is in states that its header does not name")
    if not np.all(np.diff(signals["time"][:, 0], prepend=-math.inf) > 0.0):
        raise RecordingError("its times do not rise")
    for name in (*INPUTS, "deflection"):
        if np.any(np.abs(signals.get(name, np.zeros(1))) > LARGEST):
            raise RecordingError(f"its signal {name} is beyond what a robot has, {LARGEST:g}")
    contact = number == states.index("contact")
    for name in GIVEN:
        if np.any(np.isnan(signals[name][contact])):
            raise RecordingError(f"its signal {name} is no number somewhere in contact, where the law was given one")
    before = np.concatenate([[False], contact[:-1]])
    enters = contact & ~before
    enters[:1] = False  # there is no sample before it to enter from
    time = signals["time"][:, 0]
    judged = np.ones(len(time), bool)
    gain = signals["gain"]
    seen = np.cumsum(np.where(gain > 0.0, gain, 1.0)) * artifact.T_s
    if np.any(contact & (time < time[:1] + FILTER)):
        if scheduled:
            lacks = (
                "what the schedule believes of the tissue goes back to the contact, before the recording's first sample"
            )
            raise RecordingError(f"{lacks}: fly with a longer recorder, `jaxmpc run --recorded S`")
        judged &= seen >= observers_forget(artifact)
    force_ref = signals["force_ref"]
    if artifact.preview:
        force_ref, whole = _windows(force_ref, contact, 1 + len(artifact.gains.mpc_ref))
        judged &= whole
    q = signals["q"]
    unknown = np.any(signals["position_age"] > 0.0, axis=1) | ~np.all(np.isfinite(q), axis=1)
    lost = np.flatnonzero(unknown | (np.diff(time, prepend=time[:1]) > MISSED * artifact.T_s))
    last_lost = np.full(len(time), time[0])
    if len(lost):
        row = np.searchsorted(lost, np.arange(len(time)), side="right") - 1
        last_lost = np.where(row >= 0, np.maximum(time[lost[np.maximum(row, 0)]], last_lost), last_lost)
    fresh = time > last_lost + velocity_forgets(artifact)
    servo = np.isin(number, [i for i, name in enumerate(states) if name in SERVO]) & np.all(
        np.isfinite(signals["a"]), axis=1
    )
    memory = np.full((len(time), 3), np.nan)
    if guarded:
        memory = np.concatenate([gain, signals["gain_memory"]], axis=1)
    deflection = np.full((len(time), 4), np.nan)
    if artifact.arm is not None and artifact.arm.compensated and "deflection" in signals:
        deflection[0] = signals["deflection"][0]  # how it came about was before
    return RecordedInputs(
        time=time,
        q=q,
        qd=signals["qd"],
        force=signals["force"],
        force_ref=force_ref,
        applied=signals["applied"],
        a=signals["a"],
        contact=contact,
        enters=enters,
        servo=servo,
        deflection=deflection,
        judged=judged,
        fresh=fresh,
        memory=np.where(~judged[:, None] & (memory > 0.0), memory, np.nan),
    )


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
            if np.all(np.isfinite(inputs.memory[k])):
                g, ceiling, lately = inputs.memory[k].tolist()
                runtime.memory = g, ceiling, lately
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


def _windows(force_ref: np.ndarray, contact: np.ndarray, width: int) -> tuple[np.ndarray, np.ndarray]:
    """What was known of each sample and its future: what came later. And where all of that is in the recording."""
    count = len(force_ref)
    padded = np.concatenate([force_ref, np.repeat(force_ref[-1:], width - 1, axis=0)])
    windows = np.lib.stride_tricks.sliding_window_view(padded, width, axis=0)
    stays = np.concatenate([contact, np.zeros(width - 1, bool)])
    whole = np.all(np.lib.stride_tricks.sliding_window_view(stays, width), axis=1)
    return windows[:count], whole | ~contact
