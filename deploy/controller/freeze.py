"""Freeze a designed controller into a sealed file that the robot can check."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from deploy.controller.arm_model import GOLDEN, KNOWN, ArmModel
from deploy.controller.artifact import Artifact
from deploy.controller.file import is_artifact, load, to_bytes
from deploy.controller.golden import check_golden
from deploy.controller.judged_loop import JudgedLoop
from jaxmpc.files.errors import InputError
from jaxmpc.files.sealed import LARGEST, write_atomic
from jaxmpc.law.gains import Gains


def freeze(
    path: Path | str,
    gains: Gains,
    T_s: float,
    K2: float,
    loop: JudgedLoop,
    params: dict[str, Any],
    margins: Sequence[Mapping[str, Any]],
    floor: Mapping[str, float],
    golden: tuple[np.ndarray, np.ndarray, np.ndarray],
    provenance: dict[str, Any],
    preview: bool = False,
    arm: Mapping[str, Any] | None = None,
    family: Mapping[str, Any] | None = None,
) -> Artifact:
    """Write an artifact, atomically, and load it back.

    Args:
        path: Where to; an artifact that is there is replaced, any other file is not.
        gains: One controller: numbers and arrays of any library that numpy can read; guarded only with an arm.
        T_s: Sampling time [s].
        K2: Damping of the tip velocity [1/s].
        loop: Delay and filters that it was judged with.
        params: Parameters that it was designed from, plain data.
        margins: Rows of stiffness [N/m], M_s [-], gain_margin_db and gain_reduction_db [dB], phase_margin_deg [°],
            delay_margin_s [s], spectral_radius [-].
        floor: Most M_s and least other margins, one at least, to be kept in every row.
        golden: Measured force (n, 3) [N], wanted force (n, 3) or with preview (n, 3, H) [N], and what the
            law answered (n, 3) [m/s²] after a reset to the first measured force.
        provenance: What made it, plain data; a clock or a host name in it makes its bytes differ.
        preview: Whether the future reference along H_p is known at run time.
        arm: What the controller drives; None makes one that only replays. Entries as in
            `deploy.controller.arm_model.MEANING`, and of the trace `golden_q` [rad], `golden_applied` and
            `golden_torque` [N m], each (n, 4), with a schedule what `known_tissue.answers` gives.
        family: With a schedule, the `band` of K_s/K̂ [-] and `rows` as those of the margins, one per known stiffness.

    Raises:
        InputError: The controller is unstable or below its floor, an argument is malformed, the golden
            trace is not reproduced, or the path is not to be written. Nothing has been written then.
        OSError: The disk is full or the folder not writable.
    """
    path = Path(path)
    force, force_ref, v = golden
    rows = list(map(dict, margins))
    model = None if arm is None else _model(arm)
    artifact = Artifact(
        gains,
        T_s,
        K2,
        preview,
        loop,
        params,
        rows,
        dict(floor),
        provenance,
        force,
        force_ref,
        v,
        model,
        None if family is None else dict(family),
    )
    check_golden(artifact)
    data = to_bytes(artifact)
    if len(data) > LARGEST:
        raise InputError("golden", f"{len(force)} samples", f"at most {LARGEST} bytes", "Take a shorter trace.")
    if not path.parent.is_dir():
        raise InputError("output", path, "in a folder that exists", f"Make {path.parent} first.")
    if (path.exists() or path.is_symlink()) and not is_artifact(path):
        raise InputError("output", path, "new or an intact artifact", "Something else is there: choose another name.")
    write_atomic(path, data)
    return load(path)


def _model(arm: Mapping[str, Any]) -> ArmModel:
    table = {key: value for key, value in arm.items() if key not in (*GOLDEN, *KNOWN)}
    return ArmModel.from_plain(table, arm)
