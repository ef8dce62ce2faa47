"""A frozen controller as a file: sealed npz, canonical JSON header, golden trace, declared floor."""

import math
import os
import stat
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from deploy.controller import arm_model, frozen_gains, margin_floor
from deploy.controller.arm_model import ArmModel
from deploy.controller.checks import AGAIN, array, plain
from deploy.runtime import arm as arm_runtime
from deploy.runtime.linear import replay
from jaxmpc.files.errors import InputError
from jaxmpc.files.sealed import LARGEST, SealError, seal, unseal
from jaxmpc.law.cascade import Gains

SCHEMA, VERSION = "jaxmpc controller", 1
KINDS = ("linear", "wam")
"""The three cascades alone, which only replay; and all that drives an arm."""
TOLERANCE = 1e-9
"""Largest deviation from the golden trace at load [-, N m]; `deploy.runtime.linear.replay` says why."""
GOLDEN = ("golden_force", "golden_force_ref", "golden_v")
HEADER = ("gains", "T_s", "K2", "preview", "params", "margins", "floor", "provenance")


class ArtifactError(ValueError):
    """A file is not a controller that may be run; the message is a sentence that says why."""


@dataclass(frozen=True, eq=False)
class Artifact:
    """A frozen controller; whatever exists is stable, above its floor and well formed.

    Attributes:
        gains: Gains of the law, floats and tuples of floats. A guard takes an arm: it watches all axes together, so
            the cascades alone are refused with one rather than replayed without it.
        T_s: Sampling time [s].
        K2: Damping of the tip velocity, subtracted from v outside the law [1/s].
        preview: Whether the runtime takes the future reference along H_p, or a constant.
        params: Parameters that it was designed from.
        margins: One row per stiffness [N/m], delay [samples] and kind of damping; see `deploy.controller.margin_floor`.
        floor: Most M_s [-] and least other margins that it promises in every row.
        provenance: Who, what and which versions made it.
        golden_force: Measured force of the trace (n, 3) [N]; it begins with a reset to its first row.
        golden_force_ref: Wanted force (n, 3) [N], with preview (n, 3, H).
        golden_v: Command of the JAX law (n, 3) [m/s²].
        arm: What it takes to drive an arm; None only replays.

    Raises:
        InputError: A value is missing, malformed, out of range, unstable or below the floor.
    """

    gains: Gains
    T_s: float
    K2: float
    preview: bool
    params: dict[str, Any]
    margins: list[dict[str, Any]]
    floor: dict[str, float]
    provenance: dict[str, Any]
    golden_force: np.ndarray
    golden_force_ref: np.ndarray
    golden_v: np.ndarray
    arm: ArmModel | None = None

    def __post_init__(self) -> None:
        gains = frozen_gains.checked(self.gains)
        if gains.guard is not None and self.arm is None:
            remedy = "Freeze it with an experiment on the arm, such as table-1-wam."
            raise InputError("guard", "given", "left out where no arm is driven", remedy)
        if not isinstance(self.preview, bool):
            raise InputError("preview", self.preview, "true or false", "Say whether the future reference is known.")
        T_s, K2 = margin_floor.number("T_s", self.T_s), margin_floor.number("K2", self.K2)
        if not 1e-5 <= T_s <= 0.1:
            raise InputError("T_s", T_s, "in [1e-5, 0.1] s", "The paper's controller runs at 1e-3.")
        if not 0.0 <= K2 <= 1e4:
            raise InputError("K2", K2, "in [0, 1e4] 1/s", "The paper's controller has 10.")
        for name in ("params", "provenance"):
            plain(name, getattr(self, name))
        force = array("golden_force", self.golden_force, (None, 3))
        ahead = (len(gains.mpc_ref),) if self.preview else ()
        checked = {
            "gains": gains,
            "T_s": T_s,
            "K2": K2,
            "margins": margin_floor.plain_margins(self.margins),
            "floor": margin_floor.plain_floor(self.floor),
            "golden_force": force,
            "golden_force_ref": array("golden_force_ref", self.golden_force_ref, (len(force), 3, *ahead)),
            "golden_v": array("golden_v", self.golden_v, (len(force), 3)),
        }
        for name, value in checked.items():
            object.__setattr__(self, name, value)
        if not np.any(self.golden_v):
            raise InputError("golden_v", "all zero", "a trace that moves", "Nothing could be told from this one.")
        margin_floor.check(self.margins, self.floor)
        if self.arm is not None:
            self._check_arm(self.arm)

    def _check_arm(self, arm: ArmModel) -> None:
        """What only a controller that drives must keep."""
        if any(row["ideal"] for row in self.margins):
            remedy = "Freeze it without --ideal: no arm has ideal damping."
            raise InputError("margins", "of the ideal loop", "those of the loop as it runs", remedy)
        if len(arm.golden_q) != len(self.golden_force):
            bound = f"of as many samples as golden_force, {len(self.golden_force)}"
            raise InputError("golden_q", f"{len(arm.golden_q)} samples", bound, AGAIN)
        felt = max(math.hypot(*row) for row in self.golden_force.tolist())
        if felt > arm.limits.force:
            remedy = "Choose limits that its own run keeps, or another controller."
            raise InputError("golden_force", f"{felt:.3g} N", f"at most {arm.limits.force:g} N, its limit", remedy)

    @property
    def kind(self) -> str:
        """What it can do; see `KINDS`."""
        return KINDS[self.arm is not None]


def check_golden(artifact: Artifact) -> float:
    """Replay the golden trace and return the deviation of the commands, relative to the largest one [-].

    Raises:
        InputError: It is not reproduced, or on the arm its torques are not.
    """
    remedy = "Its constants and its trace do not belong together: freeze the controller again."
    deviation, torque = (replay(artifact), 0.0) if artifact.arm is None else arm_runtime.replay(artifact)
    if not deviation <= TOLERANCE:
        raise InputError("deviation from the golden trace", f"{deviation:.3g}", f"at most {TOLERANCE:g}", remedy)
    if not torque <= TOLERANCE:
        bound = f"at most {TOLERANCE:g} N m"
        raise InputError("deviation from the golden torques", f"{torque:.3g} N m", bound, remedy)
    return deviation


def to_bytes(artifact: Artifact) -> bytes:
    """The file's content; the same artifact gives the same bytes."""
    rows = [{key: "inf" if value == np.inf else value for key, value in row.items()} for row in artifact.margins]
    plainly = {"gains": frozen_gains.plain(artifact.gains), "margins": rows}
    header = {name: getattr(artifact, name) for name in HEADER} | plainly
    golden = {name: getattr(artifact, name) for name in GOLDEN}
    if artifact.arm is not None:
        header |= {"arm": artifact.arm.plain()}
        golden |= {name: getattr(artifact.arm, name) for name in arm_model.GOLDEN}
    return seal({"schema": SCHEMA, "version": VERSION, "kind": artifact.kind, **header}, golden)


def from_bytes(data: bytes) -> Artifact:
    """The artifact in a file's content, checked throughout and replayed.

    Raises:
        ArtifactError: Something is wrong with it.
    """
    header, arrays = _opened(data)
    if header.get("schema") != SCHEMA:
        raise ArtifactError(f"it is sealed, but not a controller: its schema is {header.get('schema')!r}")
    version, kind = header.get("version"), header.get("kind")
    if isinstance(version, int) and version > VERSION:
        raise ArtifactError(f"it has schema version {version}, newer than {VERSION}: update jaxmpc on this machine")
    if version != VERSION:
        raise ArtifactError(f"it has schema version {version!r}, which never existed")
    if kind not in KINDS:
        raise ArtifactError(
            f"it is of the kind {kind!r}; this version of jaxmpc knows {' and '.join(map(repr, KINDS))}"
        )
    keys, names = (HEADER, GOLDEN) if kind == "linear" else ((*HEADER, "arm"), (*GOLDEN, *arm_model.GOLDEN))
    if missing := [name for name in names if name not in arrays]:
        raise ArtifactError(f"it lacks the array {missing[0]}")
    if missing := [name for name in keys if name not in header]:
        raise ArtifactError(f"its header lacks {missing[0]}")
    gains = header["gains"]
    if not isinstance(gains, dict) or set(gains) - {"guard"} != set(frozen_gains.SHAPES):
        raise ArtifactError(f"its gains are not a table of {', '.join(frozen_gains.SHAPES)}")
    try:
        fields = {name: header[name] for name in HEADER} | {name: arrays[name] for name in GOLDEN}
        with np.errstate(all="ignore"):  # what overflows is refused for what it gives
            arm = ArmModel.from_plain(header["arm"], arrays) if kind == "wam" else None
            artifact = Artifact(**(fields | {"gains": Gains(**gains), "arm": arm}))
            check_golden(artifact)
    except InputError as error:
        raise ArtifactError(str(error)) from None
    except (ArithmeticError, ValueError) as error:
        raise ArtifactError(f"its law cannot be computed: {error}") from None
    return artifact


def load(path: Path | str, *, expect_rate: float | None = None, expect_robot: str | None = None) -> Artifact:
    """The artifact in a file, checked throughout and replayed.

    Args:
        path: Of the file.
        expect_rate: The rate at which it is to run [1/s]; None takes any.
        expect_robot: The robot that it is to drive; None also takes what only replays.

    Raises:
        ArtifactError: There is no such file, it cannot be read, something is wrong with it, or it is for another
            rate or robot.
    """
    try:
        artifact = from_bytes(read(Path(path)))
        if expect_rate is not None and not abs(artifact.T_s * expect_rate - 1.0) <= 1e-9:
            rates = f"{1.0 / artifact.T_s:g} times a second, not {expect_rate:g}"
            raise ArtifactError(f"its law runs {rates}: run it at its rate, or freeze it for yours")
        if expect_robot is not None and artifact.arm is None:
            raise ArtifactError(
                f"it is of the kind {artifact.kind!r}, which replays and drives no arm: "
                "freeze it with an experiment on the arm, such as table-1-wam"
            )
        if expect_robot is not None and artifact.arm is not None and artifact.arm.robot != expect_robot:
            raise ArtifactError(f"it drives a {artifact.arm.robot}, and this is a {expect_robot}")
    except ArtifactError as error:
        raise ArtifactError(f"{path}: {error}") from None
    return artifact


def is_artifact(path: Path) -> bool:
    """Whether a file is an intact artifact of any version, so that freezing may replace it."""
    try:
        header, _ = _opened(read(path))
    except ArtifactError:
        return False
    return header.get("schema") == SCHEMA


def read(path: Path) -> bytes:
    """The bytes of a regular file of bearable size.

    Raises:
        ArtifactError: It is no such file, or it cannot be read.
    """
    try:
        status = path.lstat()
        if stat.S_ISLNK(status.st_mode):
            raise ArtifactError("it is a symbolic link, behind which anybody may put another: name the file itself")
        if not stat.S_ISREG(status.st_mode):
            raise ArtifactError("it is not a file, but a folder or a device")
        if status.st_size > LARGEST:
            raise ArtifactError(f"it has {status.st_size} bytes, more than the {LARGEST} that are read")
        # Whatever has taken its place meanwhile is neither followed nor waited for, nor read without end.
        with open(os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK), "rb") as file:
            return file.read(LARGEST + 1)
    except OSError as error:
        raise ArtifactError(f"it cannot be read: {error.strerror}") from None


def _opened(data: bytes) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    try:
        return unseal(data)
    except SealError as error:
        raise ArtifactError(str(error)) from None
