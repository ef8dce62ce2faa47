"""What a flight recording says that the law was given, and which of its samples a replay can judge."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from deploy.controller.artifact import Artifact
from deploy.flight.forgetting import FILTER, guard_forgets, observers_forget, velocity_forgets
from deploy.flight.recorder import COLUMNS, FlightRecording, RecordingError
from jaxmpc.law.recorded import RecordedInputs

INPUTS = ("time", "q", "qd", "force", "force_ref", "applied", "a", "state", "position_age")
GIVEN = ("qd", "force_ref", "applied")
"""Those that the law was given in every cycle of contact; a force may be missing."""
SHOWN = ("torque", "clamped")
"""Those that pictures need besides."""
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
MISSED = 1.999
"""Periods from a sample to the next that are no longer one: the loop counts 2 as a cycle missed [-]."""
LARGEST = 1e60
"""No signal is larger, whatever its unit: of such inputs products leave the finite numbers, at which Python raises."""
LONGEST_NAME = 40
"""Longest name of a state [characters]."""
SERVO = ("armed", "approach", "retract", "stopped")
"""States in which the torque is that of a servo on the tip."""


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
    needed += [*SHOWN, *(["gain_memory"] if guarded else [])]
    if missing := [name for name in needed if name not in signals]:
        raise RecordingError(f"it lacks the signal {missing[0]}")
    names = header.get("names")
    states = names.get("state") if isinstance(names, dict) else None
    if not isinstance(states, list) or "contact" not in states or not all(map(_is_word, states)):
        raise RecordingError("its header does not name the states")
    if not len(signals["time"]):
        raise RecordingError("it holds no samples")
    number = signals["state"][:, 0]
    if not np.isin(number, np.arange(len(states))).all():
        raise RecordingError("it is in states that its header does not name")
    if not np.all(np.diff(signals["time"][:, 0], prepend=-math.inf) > 0.0):
        raise RecordingError("its times do not rise")
    for name in COLUMNS:
        size = np.abs(signals.get(name, np.zeros(1)))
        if np.any((size > LARGEST) & (np.isfinite(size) | (name in (*INPUTS, "deflection")))):
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
        if guarded and "swing_share" not in signals:
            judged &= time > time[0] + guard_forgets(artifact)
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
    memory = np.full((len(time), 4), np.nan)
    if guarded:
        memory[:, :3] = np.concatenate([gain, signals["gain_memory"]], axis=1)
        memory[:, 3:] = signals.get("swing_share", np.nan)
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


def _is_word(name: Any) -> bool:
    """Whether it can name a state: letters and dashes, which no picture takes for anything else."""
    return isinstance(name, str) and name.replace("-", "a").isalpha() and len(name) <= LONGEST_NAME


def _windows(force_ref: np.ndarray, contact: np.ndarray, width: int) -> tuple[np.ndarray, np.ndarray]:
    """What was known of each sample and its future: what came later. And where all of that is in the recording."""
    count = len(force_ref)
    padded = np.concatenate([force_ref, np.repeat(force_ref[-1:], width - 1, axis=0)])
    windows = np.lib.stride_tricks.sliding_window_view(padded, width, axis=0)
    stays = np.concatenate([contact, np.zeros(width - 1, bool)])
    whole = np.all(np.lib.stride_tricks.sliding_window_view(stays, width), axis=1)
    return windows[:count], whole | ~contact
