"""A frozen controller as a file: sealed npz, canonical JSON header, golden trace, declared floor."""

import stat
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from deploy import floor as margin_floor
from deploy.runtime import replay
from jaxmpc.errors import InputError
from jaxmpc.law.cascade import Gains, constant_reference, order
from jaxmpc.sealed import LARGEST, SealError, canonical_json, seal, unseal

SCHEMA, VERSION, KIND = "jaxmpc controller", 1, "linear"
TOLERANCE = 1e-9
"""Largest deviation from the golden trace at load [-]; `deploy.runtime.replay` says why."""
GAIN_SHAPES: Mapping[str, tuple[int | None, ...]] = {
    "phi": (2,), "gamma": (2,), "K": (None,), "L": (3,), "input_gain": (),
    "mpc_ref": (None,), "mpc_x": (2,), "mpc_u": (),
}  # fmt: skip
GOLDEN = ("golden_force", "golden_force_ref", "golden_v")
HEADER = ("gains", "T_s", "K2", "preview", "params", "margins", "floor", "provenance")


class ArtifactError(ValueError):
    """A file is not a controller that may be run; the message is a sentence that says why."""


@dataclass(frozen=True, eq=False)
class Artifact:
    """A frozen controller; whatever exists is stable, above its floor and well formed.

    Attributes:
        gains: Gains of the law, floats and tuples of floats.
        T_s: Sampling time [s].
        K2: Damping of the tip velocity, subtracted from v outside the law [1/s].
        preview: Whether the runtime takes the future reference along H_p, or a constant.
        params: Parameters that it was designed from.
        margins: One row per stiffness [N/m], delay [samples] and kind of damping; see `deploy.floor`.
        floor: Most M_s [-] and least other margins that it promises in every row.
        provenance: Who, what and which versions made it.
        golden_force: Measured force of the trace (n, 3) [N]; it begins with a reset to its first row.
        golden_force_ref: Wanted force (n, 3) [N], with preview (n, 3, H).
        golden_v: Command of the JAX law (n, 3) [m/s²].

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

    def __post_init__(self) -> None:
        arrays = {name: _array(name, getattr(self.gains, name), shape) for name, shape in GAIN_SHAPES.items()}
        plain = {name: array.tolist() for name, array in arrays.items()}
        gains = Gains(**{name: tuple(value) if isinstance(value, list) else value for name, value in plain.items()})
        if not 1 <= order(gains) <= 3:
            raise InputError("K", f"{len(gains.K)} numbers", "4 to 6", "The disturbance order is 1, 2 or 3.")
        _array("sum of mpc_ref", constant_reference(gains).mpc_ref, (1,))
        if not isinstance(self.preview, bool):
            raise InputError("preview", self.preview, "true or false", "Say whether the future reference is known.")
        T_s, K2 = margin_floor.number("T_s", self.T_s), margin_floor.number("K2", self.K2)
        if not 1e-5 <= T_s <= 0.1:
            raise InputError("T_s", T_s, "in [1e-5, 0.1] s", "The paper's controller runs at 1e-3.")
        if not 0.0 <= K2 <= 1e4:
            raise InputError("K2", K2, "in [0, 1e4] 1/s", "The paper's controller has 10.")
        for name in ("params", "provenance"):
            _check_plain(name, getattr(self, name))
        force = _array("golden_force", self.golden_force, (None, 3))
        ahead = (len(gains.mpc_ref),) if self.preview else ()
        checked = {
            "gains": gains,
            "T_s": T_s,
            "K2": K2,
            "margins": margin_floor.plain_margins(self.margins),
            "floor": margin_floor.plain_floor(self.floor),
            "golden_force": force,
            "golden_force_ref": _array("golden_force_ref", self.golden_force_ref, (len(force), 3, *ahead)),
            "golden_v": _array("golden_v", self.golden_v, (len(force), 3)),
        }
        for name, value in checked.items():
            object.__setattr__(self, name, value)
        if not np.any(self.golden_v):
            raise InputError("golden_v", "all zero", "a trace that moves", "Nothing could be told from this one.")
        margin_floor.check(self.margins, self.floor)


def check_golden(artifact: Artifact) -> float:
    """Replay the golden trace and return its deviation [-].

    Raises:
        InputError: It is not reproduced.
    """
    deviation = replay(artifact)
    if not deviation <= TOLERANCE:
        remedy = "Its gains and its trace do not belong together: freeze the controller again."
        raise InputError("deviation from the golden trace", f"{deviation:.3g}", f"at most {TOLERANCE:g}", remedy)
    return deviation


def to_bytes(artifact: Artifact) -> bytes:
    """The file's content; the same artifact gives the same bytes."""
    rows = [{key: "inf" if value == np.inf else value for key, value in row.items()} for row in artifact.margins]
    header = {name: getattr(artifact, name) for name in HEADER} | {"gains": artifact.gains._asdict(), "margins": rows}
    golden = {name: getattr(artifact, name) for name in GOLDEN}
    return seal({"schema": SCHEMA, "version": VERSION, "kind": KIND, **header}, golden)


def from_bytes(data: bytes) -> Artifact:
    """The artifact in a file's content, checked throughout and replayed.

    Raises:
        ArtifactError: Something is wrong with it.
    """
    header, arrays = _opened(data)
    if header.get("schema") != SCHEMA:
        raise ArtifactError(f"it is sealed, but not a controller: its schema is {header.get('schema')!r}")
    version = header.get("version")
    if isinstance(version, int) and version > VERSION:
        raise ArtifactError(f"it has schema version {version}, newer than {VERSION}: update jaxmpc on this machine")
    if version != VERSION:
        raise ArtifactError(f"it has schema version {version!r}, which never existed")
    if header.get("kind") != KIND:
        raise ArtifactError(f"it is of the kind {header.get('kind')!r}; this version of jaxmpc runs {KIND!r}")
    if missing := [name for name in GOLDEN if name not in arrays]:
        raise ArtifactError(f"it lacks the array {missing[0]}")
    if missing := [name for name in HEADER if name not in header]:
        raise ArtifactError(f"its header lacks {missing[0]}")
    gains = header["gains"]
    if not isinstance(gains, dict) or set(gains) != set(GAIN_SHAPES):
        raise ArtifactError(f"its gains are not a table of {', '.join(GAIN_SHAPES)}")
    try:
        fields = {name: header[name] for name in HEADER} | {name: arrays[name] for name in GOLDEN}
        artifact = Artifact(**(fields | {"gains": Gains(**gains)}))
        check_golden(artifact)
    except InputError as error:
        raise ArtifactError(str(error)) from None
    return artifact


def load(path: Path | str) -> Artifact:
    """The artifact in a file, checked throughout and replayed.

    Raises:
        ArtifactError: There is no such file, it cannot be read, or something is wrong with it.
    """
    try:
        return from_bytes(read(Path(path)))
    except ArtifactError as error:
        raise ArtifactError(f"{path}: {error}") from None


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
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):
            raise ArtifactError("it is not a file, but a folder or a device")
        if status.st_size > LARGEST:
            raise ArtifactError(f"it has {status.st_size} bytes, more than the {LARGEST} that are read")
        return path.read_bytes()
    except OSError as error:
        raise ArtifactError(f"it cannot be read: {error.strerror}") from None


def _opened(data: bytes) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    try:
        return unseal(data)
    except SealError as error:
        raise ArtifactError(str(error)) from None


def _array(name: str, value: Any, shape: tuple[int | None, ...]) -> np.ndarray:
    """A read-only float64 copy of a finite array; None in the shape stands for any length but 0."""
    try:
        array = np.array(value)
    except ValueError:
        array = np.array(None)
    if array.dtype.kind not in "fiu":
        raise InputError(name, f"an array of {array.dtype}", "an array of numbers", "Freeze the controller again.")
    wrong = [have for have, want in zip(array.shape, shape, strict=False) if have != (want or max(have, 1))]
    if array.ndim != len(shape) or wrong:
        bound = f"of shape ({', '.join('n' if length is None else str(length) for length in shape)})"
        raise InputError(name, f"an array of shape {array.shape}", bound, "Freeze one controller, with three axes.")
    if not np.all(np.isfinite(array)):
        raise InputError(name, "not finite somewhere", "finite everywhere", "Its design or its trace has failed.")
    array = np.ascontiguousarray(array, np.float64).reshape(array.shape)
    array.setflags(write=False)
    return array


def _check_plain(name: str, value: Any) -> None:
    try:
        if isinstance(value, dict) and canonical_json(value):
            return
    except (TypeError, ValueError):
        pass
    remedy = "Use numbers, words, lists and tables, and no infinity."
    raise InputError(name, value, "a table of plain data", remedy)
