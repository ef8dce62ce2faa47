"""A sweep's folder: a manifest and sealed chunks; what is there and intact need not be computed again.

    manifest.json                    the canonical spec, its hash, the environments that computed
    chunks/000000000-000002048.npz   planned rows 0 … 2047, sealed
    result.json                      the hash of the result, once every row is there

A chunk is named by the rows that it holds, so the chunk size may differ from run to run. Two processes in
one folder do double work and no harm: they write the same rows, and every write is atomic.
"""

import json
import logging
import os
import platform
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxmpc import __version__
from jaxmpc.files.errors import InputError
from jaxmpc.files.foreign import LARGEST_JSON, json_of, read_bytes, read_text
from jaxmpc.files.sealed import LARGEST, SealError, canonical_json, digest, seal, unseal, write_atomic
from sweeps.plan import SCHEMA, Columns, Plan

log = logging.getLogger(__name__)


class StoredChunks(NamedTuple):
    """What a folder holds."""

    columns: Columns
    """Every column of the plan's layout; rows that are not there hold zeros."""
    there: np.ndarray
    """Whether each planned row is there."""


def environment() -> dict[str, str]:
    """What the bits of a result may depend on besides its spec; no host name, no path."""
    import jax
    import jaxlib.version

    # Neither a dump of the compiler nor how many devices there are changes a row; only one or several does.
    neutral = ("--xla_force_host_platform_device_count", "--xla_dump")
    flags = [flag for flag in os.environ.get("XLA_FLAGS", "").split() if not flag.startswith(neutral)]
    return {
        "jaxmpc": __version__,
        "python": platform.python_version(),
        "jax": jax.__version__,
        "jaxlib": jaxlib.version.__version__,
        "numpy": np.__version__,
        "platform": f"{platform.system()} {platform.machine()}",
        "cpu": _cpu(),
        "device": jax.local_devices()[0].device_kind,
        "devices": "one" if jax.local_device_count() == 1 else "several",
        "xla_flags": " ".join(flags),
    }


def _cpu() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "")


def read_plan(folder: Path) -> Plan:
    """The plan of an existing sweep.

    Raises:
        InputError: The folder holds none, or one that was changed by hand.
    """
    manifest = _read(folder / "manifest.json")
    if manifest.get("schema") != SCHEMA or not isinstance(manifest.get("spec"), dict):
        raise InputError("sweep folder", folder, "a folder made by `jaxmpc sweep`", "It has no manifest of a sweep.")
    if digest(manifest["spec"]) != manifest.get("spec_hash"):
        raise InputError("spec_hash", folder / "manifest.json", "that of its spec", "The manifest was changed by hand.")
    try:
        plan = Plan(manifest["spec"])
        _ = plan.rows, plan.base, plan.layout, plan.stiffness
    # Its hash is right, so it was written as one of ours, by another version or on purpose.
    except (InputError, LookupError, TypeError, ValueError) as error:
        raise InputError("spec", folder / "manifest.json", "that of a sweep", f"It cannot be read: {error}.") from None
    return plan


def check(folder: Path, plan: Plan) -> bool:
    """Whether the folder already holds this very sweep; writes nothing.

    Raises:
        InputError: It is no folder, holds something else, or the sweep of another spec.
    """
    if not folder.exists():
        return False
    if not folder.is_dir():
        raise InputError("output folder", folder, "a folder", "A file is in its place: choose another with -o.")
    # A dot file is what a kill leaves of an unfinished write.
    if all(entry.name.startswith(".") for entry in folder.iterdir()):
        return False
    if not (folder / "manifest.json").exists():
        raise InputError("output folder", folder, "empty or a sweep's", "It holds other files: choose another with -o.")
    there = read_plan(folder)
    if there.spec_hash != plan.spec_hash:
        differing = differences(there.canonical, plan.canonical)
        remedy = f"It holds the sweep of another spec ({'; '.join(differing[:4])}): choose another with -o."
        raise InputError("output folder", folder, "empty or of the same spec", remedy)
    return True


def prepare(folder: Path, plan: Plan) -> None:
    """Make the folder, or note that it is being continued.

    Raises:
        InputError: See `check`.
        OSError: The folder cannot be written.
    """
    now = environment()
    known = _read(folder / "manifest.json").get("environments") if check(folder, plan) else []
    if not isinstance(known, list):
        raise InputError("environments", known, "a list", "The manifest was changed by hand.", folder / "manifest.json")
    folder.mkdir(parents=True, exist_ok=True)
    if now not in known:
        if known:
            changed = ", ".join(differences(known[-1], now))
            log.warning("this sweep was begun in another environment (%s): bits of its rows may differ", changed)
        manifest = {
            "schema": SCHEMA,
            "spec_hash": plan.spec_hash,
            "spec": plan.canonical,
            "environments": [*known, now],
        }
        write_atomic(folder / "manifest.json", _pretty(manifest))
    # After the manifest: chunks without one would be a folder of something else, to a rerun or a second process.
    (folder / "chunks").mkdir(exist_ok=True)


def read_chunks(folder: Path, plan: Plan) -> StoredChunks:
    """Every intact row of this sweep; a damaged chunk is reported and counts as absent."""
    rows = len(plan.rows)
    columns = {name: np.zeros((rows, *column.shape), column.dtype) for name, column in plan.layout.items()}
    there = np.zeros(rows, bool)
    for path in sorted((folder / "chunks").glob("[0-9]*.npz")):
        try:
            first, last, arrays = _read_chunk(path, plan)
        except SealError as error:
            log.warning("%s is computed again: %s", path.name, error)
            continue
        for name, values in arrays.items():
            columns[name][first:last] = values
        there[first:last] = True
    return StoredChunks(columns, there)


def write_chunk(folder: Path, plan: Plan, first: int, last: int, columns: Mapping[str, np.ndarray]) -> None:
    """Write planned rows first … last − 1, whole or not at all.

    Raises:
        OSError: The disk is full or the folder not writable.
    """
    header = {"schema": SCHEMA, "spec_hash": plan.spec_hash, "first": first, "last": last}
    write_atomic(folder / "chunks" / f"{first:09d}-{last:09d}.npz", seal(header, columns))


def write_summary(folder: Path, summary: Mapping[str, Any]) -> None:
    """Write `result.json`, unless it is there already with this content."""
    path = folder / "result.json"
    if not path.exists() or path.read_bytes() != _pretty(summary):
        write_atomic(path, _pretty(summary))


def read_summary(folder: Path) -> dict[str, Any]:
    """What `write_summary` wrote; empty before the sweep is finished."""
    return _read(folder / "result.json")


def _read_chunk(path: Path, plan: Plan) -> tuple[int, int, Columns]:
    try:
        header, arrays = unseal(read_bytes(path, LARGEST))
    except InputError as error:
        raise SealError(f"{error}") from None
    if header.get("spec_hash") != plan.spec_hash or header.get("schema") != SCHEMA:
        raise SealError("it belongs to another sweep")
    first, last = header.get("first"), header.get("last")
    if type(first) is not int or type(last) is not int or not 0 <= first < last <= len(plan.rows):
        raise SealError("it does not say which rows it holds")
    shapes = {name: (column.dtype, (last - first, *column.shape)) for name, column in plan.layout.items()}
    if {name: (values.dtype.str, values.shape) for name, values in arrays.items()} != shapes:
        raise SealError("its columns are not those of this sweep")
    if not np.array_equal(arrays["row"], plan.rows[first:last]):
        raise SealError("its rows are not those of this sweep")
    return first, last, arrays


def differences(there: Any, here: Any, path: str = "") -> list[str]:
    """Where two plain structures differ, as sentences."""
    if isinstance(there, dict) and isinstance(here, dict):
        keys = sorted(there.keys() | here.keys())
        return [
            text for key in keys for text in differences(there.get(key), here.get(key), f"{path}.{key}".lstrip("."))
        ]
    if isinstance(there, list) and isinstance(here, list) and len(there) == len(here):
        return [
            text for i, pair in enumerate(zip(there, here, strict=True)) for text in differences(*pair, f"{path}[{i}]")
        ]
    return [] if there == here else [f"{path}: there {_brief(there)}, here {_brief(here)}"]


def _brief(value: Any) -> str:
    text = canonical_json(value)
    return text if len(text) <= 60 else f"{text[:57]}…"


def _pretty(data: Mapping[str, Any]) -> bytes:
    return (json.dumps(data, indent=2, ensure_ascii=False, allow_nan=False) + "\n").encode()


def _read(path: Path) -> dict[str, Any]:
    """A JSON file's table; empty where there is none or it is no such file."""
    try:
        return json_of(read_text(path, LARGEST_JSON), path)
    except InputError:
        return {}
