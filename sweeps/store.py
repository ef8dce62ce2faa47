"""A sweep's folder: a manifest beside its chunks, whose spec says what they are of.

manifest.json                    the canonical spec, its hash, how rows are ranked
environments/0123456789ab.json   where rows were computed (`sweeps.environments`)
recordings/…                     the content of recordings that the spec names
chunks/000000000-000002048.npz   planned rows 0 … 2047, sealed (`sweeps.chunks`)
leases/, aside/                  who works on what, and what is given up (`sweeps.leases`)
result.json                      the hash of the result, once every row is there
"""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec

from jaxmpc.files.errors import InputError
from jaxmpc.files.foreign import LARGEST_JSON, LARGEST_RECORDING, json_of, read_bytes, read_text
from jaxmpc.files.sealed import canonical_json, digest, write_atomic, write_first
from sweeps.goal import SweepGoal
from sweeps.plan import SCHEMA, Plan

REFINED = "jaxmpc-refine/1"
MOST_LINED = 2**20
"""Length of a file up to which each of its values has a line [bytes]."""


def read_plan(folder: Path) -> Plan:
    """The plan of an existing sweep.

    Raises:
        InputError: The folder holds none, or one that was changed by hand.
    """
    manifest = _manifest(folder)
    if manifest.get("schema") == REFINED:
        raise InputError(
            "sweep folder", folder, "begun", "It is of a refined sweep, none of whose stages is there yet."
        )
    if str(manifest.get("schema", "")).startswith("jaxmpc-sweep/") and manifest["schema"] != SCHEMA:
        raise InputError("schema", manifest["schema"], SCHEMA, "Another version made it: run the spec anew with -o.")
    if manifest.get("schema") != SCHEMA or not isinstance(manifest.get("spec"), dict):
        raise InputError("sweep folder", folder, "a folder made by `jaxmpc sweep`", "It has no manifest of a sweep.")
    if digest(manifest["spec"]) != manifest.get("spec_hash"):
        raise InputError("spec_hash", folder / "manifest.json", "that of its spec", "The manifest was changed by hand.")
    recordings = (folder / "recordings").glob("[0-9a-f]*")
    try:
        files = {f"sha256:{path.name}": read_bytes(path, LARGEST_RECORDING) for path in recordings}
        plan = Plan(manifest["spec"], files, msgspec.convert(manifest.get("goal", {}), SweepGoal))
        _ = plan.rows, plan.base, plan.layout, plan.stiffness
    # Its hash is right, so it was written as one of ours, by another version or on purpose.
    except (InputError, LookupError, TypeError, ValueError) as error:
        raise InputError("spec", folder / "manifest.json", "that of a sweep", f"It cannot be read: {error}.") from None
    return plan


def read_manifest(folder: Path) -> dict[str, Any]:
    """What the manifest of a folder says; empty where there is none."""
    return _read(folder / "manifest.json")


def _manifest(folder: Path) -> dict[str, Any]:
    """The same; one that is there and cannot be read is told of, since rows lie beside it.

    Raises:
        InputError: The manifest is damaged or may not be read.
    """
    path = folder / "manifest.json"
    if not path.is_file():
        return {}
    try:
        return json_of(read_text(path, LARGEST_JSON), path)
    except InputError as error:
        remedy = f"{error.remedy} Put it back from a copy, or run the spec anew with -o."
        raise InputError("manifest", path, "as `jaxmpc sweep` wrote it", remedy) from None


def check(folder: Path, plan: Plan) -> bool:
    """Whether the folder already holds this very sweep; writes nothing.

    Raises:
        InputError: It is no folder, holds something else, or the sweep of another spec.
    """
    if not _begun(folder):
        return False
    if _manifest(folder).get("schema") == REFINED:
        raise InputError(
            "output folder", folder, "empty or of a plain sweep", "It holds a refined one: choose with -o."
        )
    there = read_plan(folder)
    if there.spec_hash != plan.spec_hash:
        raise _another(folder, there.canonical, plan.canonical)
    return True


def check_refined(folder: Path, spec: Mapping[str, Any], spec_hash: str) -> bool:
    """The same of a refined sweep, whose spec is plain data."""
    if not _begun(folder):
        return False
    there = _manifest(folder)
    if there.get("schema") != REFINED:
        raise InputError("output folder", folder, "empty or a refined sweep's", "It holds another: choose with -o.")
    if there.get("spec_hash") != spec_hash:
        raise _another(folder, there.get("spec", {}), spec)
    return True


def prepare_refined(folder: Path, spec: Mapping[str, Any], spec_hash: str) -> None:
    """Make the folder of a refined sweep, unless it is there.

    Raises:
        InputError: See `check`.
        OSError: The folder cannot be written.
    """
    if not check_refined(folder, spec, spec_hash):
        folder.mkdir(parents=True, exist_ok=True)
        begun = pretty({"schema": REFINED, "spec_hash": spec_hash, "spec": spec})
        if not write_first(folder / "manifest.json", begun):
            check_refined(folder, spec, spec_hash)
    (folder / "stages").mkdir(exist_ok=True)


def _another(folder: Path, there: Any, here: Any) -> InputError:
    differing = "; ".join(differences(there, here)[:4])
    remedy = f"It holds the sweep of another spec ({differing}): choose another with -o."
    return InputError("output folder", folder, "empty or of the same spec", remedy)


def _begun(folder: Path) -> bool:
    """Whether a sweep has been begun in a folder.

    Raises:
        InputError: It is no folder, or holds something else.
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
    return True


def prepare(folder: Path, plan: Plan) -> None:
    """Make the folder, unless it is there; how rows are ranked is noted anew.

    Raises:
        InputError: See `check`.
        OSError: The folder cannot be written.
    """
    path, new = folder / "manifest.json", {"schema": SCHEMA, "spec_hash": plan.spec_hash}
    own = {"goal": msgspec.to_builtins(plan.goal), "spec": plan.canonical}
    if not check(folder, plan):
        folder.mkdir(parents=True, exist_ok=True)
        # Of several that begin now one does; to the others, of whatever spec, its folder is there.
        if not write_first(path, pretty({**new, **own})):
            check(folder, plan)
    there = read_manifest(folder)
    if there.get("goal") != own["goal"]:
        write_atomic(path, pretty({**new, **there, **own}))
    for name, content in plan.files.items():
        path = folder / "recordings" / name.removeprefix("sha256:")
        path.parent.mkdir(exist_ok=True)
        if not path.exists():
            write_atomic(path, content)
    # After the manifest: chunks without one would be a folder of something else, to a rerun or a second process.
    (folder / "chunks").mkdir(exist_ok=True)


def stage_folders(folder: Path) -> list[Path]:
    """Folders of the stages of a refined sweep that have begun, in order; none of a plain one."""
    stages = folder / "stages"
    # A glob may raise where there can be no such folder.
    found = list(stages.glob("[0-9]*-*")) if os.path.isdir(stages) else []
    numbers = {path: path.name.partition("-")[0] for path in found if (path / "manifest.json").exists()}
    return sorted((path for path in numbers if numbers[path].isdecimal()), key=lambda path: int(numbers[path]))


def write_summary(folder: Path, summary: Mapping[str, Any]) -> None:
    """Write `result.json`, unless it is there already with this content."""
    path = folder / "result.json"
    if not path.exists() or path.read_bytes() != pretty(summary):
        write_atomic(path, pretty(summary))


def read_summary(folder: Path) -> dict[str, Any]:
    """What `write_summary` wrote; empty before the sweep is finished."""
    return _read(folder / "result.json")


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


def pretty(data: Mapping[str, Any]) -> bytes:
    """A table as the text of a JSON file, a line for each value unless they are many."""
    text = json.dumps(data, indent=2, ensure_ascii=False, allow_nan=False)
    if len(text) > MOST_LINED:
        # Nobody reads rows that are written out, and indented they take half as much again.
        text = json.dumps(data, ensure_ascii=False, allow_nan=False)
    return f"{text}\n".encode()


def _read(path: Path) -> dict[str, Any]:
    """A JSON file's table; empty where there is none or it is no such file."""
    try:
        return json_of(read_text(path, LARGEST_JSON), path)
    except InputError:
        return {}
