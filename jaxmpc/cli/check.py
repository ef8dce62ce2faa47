"""`jaxmpc check`: is this file a controller that may run? Works with numpy alone."""

import argparse
import hashlib
import os
import sys
import time
from pathlib import Path
from typing import Any

from jaxmpc.errors import InputError


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument("artifact", type=Path, help="a frozen controller, as `jaxmpc freeze` writes it (.npz)")


def run(args: argparse.Namespace) -> int:
    """Check an artifact and print what it is; 1 if it is refused.

    Raises:
        InputError: There is no such file.
    """
    from deploy.artifact import KIND, TOLERANCE, ArtifactError, load
    from deploy.floor import UNITS
    from deploy.runtime import Runtime, replay

    path: Path = args.artifact
    if not os.path.lexists(path):
        raise InputError("artifact", path, "an existing file", "Make one with `jaxmpc freeze PARAMS.toml -o FILE`.")
    try:
        artifact = load(path)
    except ArtifactError as error:
        print(f"jaxmpc check: refused: {error}", file=sys.stderr)
        return 1

    reference = "known along the horizon" if artifact.preview else "held constant along the horizon"
    print(f"{path}: intact\n  sha256      {hashlib.sha256(path.read_bytes()).hexdigest()}")
    print(f"  kind        {KIND}: to replay, not to drive an arm")
    print(f"  T_s         {artifact.T_s:g} s\n  K2          {artifact.K2:g} 1/s\n  reference   {reference}")
    for title, table in (("made by", artifact.provenance), ("params", artifact.params)):
        print(f"  {title:<11} {', '.join(f'{key} {_short(value)}' for key, value in table.items()) or '-'}")
    print("\n  stiffness  delay  damping  " + "".join(f"{key:>18}" for key in (*UNITS, "spectral_radius")))
    for row in artifact.margins:
        values = "".join(f"{row[key]:>18.4g}" for key in (*UNITS, "spectral_radius"))
        print(f"  {row['stiffness']:>9g}  {row['delay']:>5}  {'ideal' if row['ideal'] else 'as run':<7}  {values}")
    sign = {key: "≤" if key == "M_s" else "≥" for key in artifact.floor}
    limits = [f"{sign[key]} {artifact.floor[key]:g}" if key in sign else "" for key in UNITS]
    print(f"  {'limit':<25}  " + "".join(f"{limit:>18}" for limit in (*limits, "< 1")))
    print(f"\n  golden trace: {len(artifact.golden_v)} samples replayed,", end=" ")
    print(f"deviation {replay(artifact):.1e} of the largest command (limit {TOLERANCE:g})")
    took = _step_times(Runtime(artifact), artifact)
    print(f"  one step of three axes: median {took[50]:.1f} µs, 99 % within {took[99]:.1f} µs")
    return 0


def _step_times(runtime: Any, artifact: Any, count: int = 20_000) -> list[float]:
    """Percentiles 0 to 99 of the time of one step [µs]."""
    force, force_ref = artifact.golden_force[0].tolist(), artifact.golden_force_ref[0].tolist()
    took = []
    for _ in range(count):
        start = time.perf_counter_ns()
        runtime.step(force, force_ref)
        took.append(time.perf_counter_ns() - start)
    return [each / 1e3 for each in sorted(took)[:: count // 100]]


def _short(value: Any) -> str:
    """A value on the same line: long lists by their first entries."""
    if isinstance(value, list) and len(value) > 3:
        return f"[{', '.join(map(str, value[:3]))}, … {len(value)} in all]"
    return f"{value:g}" if isinstance(value, float) else str(value)
