"""A frozen controller as a file: sealed npz, canonical JSON header, golden trace that is replayed at every load."""

import os
import shlex
import stat
from pathlib import Path
from typing import Any

import numpy as np

from deploy.controller import arm_model, frozen_gains
from deploy.controller.arm_model import ArmModel
from deploy.controller.artifact import KINDS, Artifact
from deploy.controller.golden import check_golden
from jaxmpc.files.errors import LONGEST_VALUE, InputError, plain
from jaxmpc.files.sealed import LARGEST, SealError, seal, unseal

SCHEMA, VERSION = "jaxmpc controller", 2
GOLDEN = ("golden_force", "golden_force_ref", "golden_v")
HEADER = ("gains", "T_s", "K2", "preview", "loop", "params", "margins", "floor", "provenance")


class ArtifactError(ValueError):
    """A file is not a controller that may be run; the message is a sentence that says why."""


def to_bytes(artifact: Artifact) -> bytes:
    """The file's content; the same artifact gives the same bytes."""
    rows = _rows(artifact.margins)
    plainly = {"gains": frozen_gains.plain(artifact.gains), "loop": artifact.loop._asdict(), "margins": rows}
    header = {name: getattr(artifact, name) for name in HEADER} | plainly
    golden = {name: getattr(artifact, name) for name in GOLDEN}
    if artifact.family is not None:
        header |= {"family": {"band": artifact.family["band"], "rows": _rows(artifact.family["rows"])}}
    if artifact.arm is not None:
        header |= {"arm": artifact.arm.plain()}
        golden |= {name: getattr(artifact.arm, name) for name in arm_model.GOLDEN}
        if artifact.gains.schedule is not None:
            golden |= {name: getattr(artifact.arm, name) for name in arm_model.KNOWN}
    return seal({"schema": SCHEMA, "version": VERSION, "kind": artifact.kind, **header}, golden)


def _rows(margins: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [{key: "inf" if value == np.inf else value for key, value in row.items()} for row in margins]


def from_bytes(data: bytes) -> Artifact:
    """The artifact in a file's content, checked throughout and replayed.

    Raises:
        ArtifactError: Something is wrong with it.
    """
    header, arrays = _opened(data)
    if header.get("schema") != SCHEMA:
        raise ArtifactError(f"it is sealed, but not a controller: its schema is {_said(header.get('schema'))}")
    version, kind = header.get("version"), header.get("kind")
    if type(version) is not int:  # true is 1 to Python
        raise ArtifactError(f"it has schema version {_said(version)}, which never existed")
    if version > VERSION:
        newer = f"newer than {VERSION}: update jaxmpc on this machine"
        raise ArtifactError(f"it has schema version {_said(version)}, {newer}")
    if version == 1:
        raise ArtifactError("it has schema version 1, which does not say what filters it flies with: freeze it again")
    if version != VERSION:
        raise ArtifactError(f"it has schema version {_said(version)}, which never existed")
    if kind not in KINDS:
        raise ArtifactError(
            f"it is of the kind {_said(kind)}; this version of jaxmpc knows {' and '.join(map(repr, KINDS))}"
        )
    keys, names = (HEADER, GOLDEN) if kind == "linear" else ((*HEADER, "arm"), (*GOLDEN, *arm_model.GOLDEN))
    if missing := [name for name in names if name not in arrays]:
        raise ArtifactError(f"it lacks the array {missing[0]}")
    if missing := [name for name in keys if name not in header]:
        raise ArtifactError(f"its header lacks {missing[0]}")
    if surplus := [name for name in arrays if name not in names and not (kind == "wam" and name in arm_model.KNOWN)]:
        raise ArtifactError(f"it holds the array {_said(surplus[0])}, which no controller of its kind has")
    if surplus := [name for name in header if name not in ("schema", "version", "kind", *keys, "family")]:
        raise ArtifactError(f"its header has the key {_said(surplus[0])}, which no controller of its kind has")
    for name, array in arrays.items():
        if array.dtype != np.dtype("<f8"):
            raise ArtifactError(f"its array {name} is of {array.dtype}, not of float64")
    try:
        fields = {name: header[name] for name in HEADER} | {name: arrays[name] for name in GOLDEN}
        with np.errstate(all="ignore"):  # what overflows is refused for what it gives
            arm = ArmModel.from_plain(header["arm"], arrays) if kind == "wam" else None
            artifact = Artifact(**(fields | {"arm": arm, "family": header.get("family")}))
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


def check_kind(path: Path) -> None:
    """Refuse by its name or kind what cannot be a controller, and say what makes one of it.

    Raises:
        InputError: It is a folder or a device, or a file of parameters.
    """
    if path.suffix == ".toml":
        command = f"jaxmpc freeze {shlex.quote(str(path))} --experiment table-1-wam -o controller.npz"
        remedy = f"If it holds parameters, `{command}` makes one."
        raise InputError("artifact", path, "a frozen controller (.npz)", remedy)
    if path.exists() and not path.is_file():
        raise InputError("artifact", path, "a file", "It is a folder or a device.")


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


def _said(value: Any) -> str:
    """What a header holds, as much of it as a sentence has room for."""
    return plain(repr(value), LONGEST_VALUE)


def _opened(data: bytes) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    try:
        return unseal(data)
    except SealError as error:
        raise ArtifactError(str(error)) from None
