"""`jaxmpc check`: is this file a controller that may run? Works with numpy alone."""

import argparse
import hashlib
import math
import os
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jaxmpc.files.errors import InputError, plain
from jaxmpc.terminal import layout

if TYPE_CHECKING:
    from deploy.controller.arm_model import ArmModel
    from deploy.controller.artifact import Artifact


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument("artifact", type=Path, help="a frozen controller, as `jaxmpc freeze` writes it (.npz)")
    parser.add_argument(
        "--require-signature", type=Path, metavar="KEY.pub", help="refuse what this Ed25519 key has not signed"
    )


def run(args: argparse.Namespace) -> int:
    """Check an artifact and print what it is; 1 if it is refused, or its margins are not those of its gains.

    Raises:
        InputError: There is no such file.
    """
    from deploy.controller.file import ArtifactError, check_kind, from_bytes, read
    from deploy.controller.golden import TOLERANCE, check_golden
    from deploy.controller.recomputed_margins import differences
    from deploy.controller.signature import SignatureError, public_key
    from jaxmpc.law.gain_backoff import INSISTENT
    from jaxmpc.quantities import MARGINS

    path: Path = args.artifact
    if not os.path.lexists(path):
        raise InputError("artifact", path, "an existing file", "Make one with `jaxmpc freeze PARAMS.toml -o FILE`.")
    check_kind(path)
    key = None if args.require_signature is None else public_key(args.require_signature)
    try:
        data = read(path)
        owner = _owner(path, data, key)
        artifact = from_bytes(data)
    except (ArtifactError, SignatureError) as error:
        print(f"jaxmpc check: refused: {path}: {error}", file=sys.stderr)
        return 1

    reference = "known along the horizon" if artifact.preview else "held constant along the horizon"
    print(f"{path}: intact\n  sha256      {hashlib.sha256(data).hexdigest()}\n  signed      {owner}")
    runs = "runs: `jaxmpc run` drives an arm with it" if artifact.arm else "replay only: it drives no arm"
    print(f"  kind        {artifact.kind}, {runs}")
    print(f"  T_s         {artifact.T_s:g} s\n  K2          {artifact.K2:g} 1/s\n  reference   {reference}")
    guard, gain = artifact.gains.guard, "not guarded: the same whatever the force does"
    if guard is not None:
        once, held = guard.sensitivity**-0.5, guard.relief**-0.5
        lasting = (INSISTENT / (1.0 - INSISTENT) / guard.attention) ** 0.5
        gain = (
            f"guarded: falls when the force swings by some {once:.3g} N (RMS), or by {lasting:.2g} N for long, "
            f"or when the limits hold back {held:.3g} m/s²"
        )
    print(f"  gain        {gain}")
    print(f"  schedule    {_schedule(artifact)}")
    print(f"  loop        {_loop(artifact)}")
    for title, table in (("made by", artifact.provenance), ("params", artifact.params)):
        print(f"  {title:<11} {', '.join(f'{plain(key)} {_short(value)}' for key, value in table.items()) or '-'}")
    if artifact.arm is not None:
        _print_arm(artifact.arm)
    limits = {"spectral_radius": "< 1"}
    limits |= {key: f"{MARGINS[key].sign} {bound:g}" for key, bound in artifact.floor.items()}
    header = ["K_s [N/m]", *MARGINS]
    rows = [[f"{row['stiffness']:g}", *(f"{row[key]:.4g}" for key in MARGINS)] for row in artifact.margins]
    rows.append(["limit", *(limits.get(key, "") for key in MARGINS)])
    print(f"\n{layout.table(header, rows)}")
    if artifact.family is not None:
        band = 100.0 * artifact.family["band"]
        rows = [[f"{row['stiffness']:.4g}", *(f"{row[key]:.4g}" for key in MARGINS)] for row in artifact.family["rows"]]
        print(f"\n  known K̂: with the schedule, the worst where the tissue's stiffness lies within ±{band:g} % of it")
        print(layout.table(["K̂ [N/m]", *MARGINS], rows))
    print(f"\n  golden trace: {len(artifact.golden_v)} samples replayed,", end=" ")
    torques = f" and {TOLERANCE:g} N m" if artifact.arm else ""
    print(f"deviation {check_golden(artifact):.1e} of the largest command (limit {TOLERANCE:g}{torques})")
    took, what = _times(artifact), "tick of the arm, without the bus" if artifact.arm else "step of three axes"
    print(f"  one {what}: median {took[50]:.1f} µs, 99 % within {took[99]:.1f} µs")
    found = differences(artifact)
    known = "" if artifact.family is None else " (those with K̂ known were not)"
    print(f"  margins computed again from the gains{known}: {'they DIFFER' if found else 'the same'}")
    for each in found:
        print(f"    {each}")
    if found:
        print(f"jaxmpc check: {path}: its margins are not those of its gains: freeze it again", file=sys.stderr)
    return 1 if found else 0


def _owner(path: Path, data: bytes, required: str | None) -> str:
    """Who signed it.

    Raises:
        SignatureError: The signature is not one of this file, or not by the key that is required.
        InputError: It is to be verified, and the library is missing.
    """
    from deploy.controller.signature import read, require, verify

    if required is not None:
        return f"by {require(path, data, required).fingerprint}, the key that is required"
    signature = read(path)
    if signature is None:
        return "by nobody"
    try:
        verify(signature, data)
    except InputError as error:
        return f"NOT VERIFIED, by {signature.fingerprint} if it is true ({error})"
    return f"by {signature.fingerprint}; `ssh-keygen -l -f KEY.pub` names a key so"


def _loop(artifact: "Artifact") -> str:
    """Delay and filters that the margins hold with."""
    loop, force_filter = artifact.loop, artifact.gains.force_filter
    low_passes = (("velocity", loop.velocity_cutoff, "rad/s"), ("sensor", loop.sensor_cutoff / (2.0 * math.pi), "Hz"))
    designed = "" if artifact.gains.K_earlier is None else ", designed for 2"
    parts = [f"delay {loop.delay}{designed}", "ideal damping" if loop.ideal else "as it runs"]
    parts += [
        f"{name} low-pass {cutoff:g} {unit}" if cutoff else f"no {name} low-pass" for name, cutoff, unit in low_passes
    ]
    return ", ".join(parts + ["Kalman filter on the force"] * (force_filter is not None))


def _schedule(artifact: "Artifact") -> str:
    """Where its knots stand, and how the stiffness is found."""
    family = artifact.gains.schedule
    if family is None:
        return "none: the same gains on every tissue"
    places = ", ".join(f"{math.exp(knot.log_stiffness):.4g}" for knot in family.knots)
    listening = family.identification
    hertz = math.atan2(listening.turn[1], listening.turn[0]) / (2.0 * math.pi * artifact.T_s)
    learning = family.repetition
    learns = "" if learning is None else f"; then it learns {len(learning.gains)} harmonics of the heart's beat"
    return (
        f"knots at {places} N/m; begins with the gains for every tissue, finds the stiffness by a sine of "
        f"{listening.amplitude:g} N at {hertz:g} Hz, and takes over when it is known to ±{100.0 * listening.band:g} %"
        f"{learns}"
    )


def _print_arm(arm: "ArmModel") -> None:
    """Model and limits of what drives an arm."""
    from deploy.controller.limits import ROWS

    nominal, links = arm.nominal, arm.chain.links
    friction = "cancels friction" if arm.compensated else "cancels no friction"
    if arm.momentum_observer:
        friction = f"cancels what disturbs the momentum, {arm.momentum_observer:g} rad/s"
    print(f"\n  robot       {arm.robot}, tip {arm.tool_length:g} m beyond the elbow")
    print(f"  model       links {sum(link.mass for link in links):.3f} kg × {nominal.mass_scale:g}", end="")
    print(f", {nominal.tool_error:+g} kg at the tip, {friction}")
    print(f"  posture     {_list(arm.posture)} rad")
    print(f"  encoders    judged with {arm.encoder_counts} counts per motor turn")
    print("\n  limit")
    for name, value in arm.limits.plain().items():
        print(f"  {name:<22}{_list(value)} {ROWS[name].unit}".removesuffix(" -"))


def _times(artifact: "Artifact", count: int = 20_000) -> list[float]:
    """Percentiles 0 to 99 of the time of one step or, on the arm, tick [µs]."""
    from deploy.controller.golden import arm_inputs
    from deploy.controller.runtimes import arm_runtime, linear_runtime

    if artifact.arm is None:
        runtime = linear_runtime(artifact)
        force, force_ref = artifact.golden_force[0].tolist(), artifact.golden_force_ref[0].tolist()

        def once() -> None:
            runtime.step(force, force_ref)
    else:
        arm, applied = arm_runtime(artifact), artifact.arm.golden_applied[0].tolist()
        q, measured, wanted = arm_inputs(artifact)[0]

        def once() -> None:
            arm.control(q, arm.velocity(q), measured, wanted)
            arm.applied(applied)

    took = []
    for _ in range(count):
        start = time.perf_counter_ns()
        once()
        took.append(time.perf_counter_ns() - start)
    return [each / 1e3 for each in sorted(took)[:: count // 100]]


def _list(value: Any) -> str:
    """Nested numbers in a few digits."""
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_list, value))}]"
    return f"{value:.4g}"


def _short(value: Any) -> str:
    """A value on the same line: long lists by their first entries."""
    if isinstance(value, list) and len(value) > 3:
        return f"[{', '.join(map(_short, value[:3]))}, … {len(value)} in all]"
    return f"{value:g}" if isinstance(value, float) else plain(f"{value}", 200)
