"""The environments that computed a sweep, each in a file of its own, so that of hosts that begin at once none is lost.

    environments/0123456789ab.json     named by the hash of its content

Folders from before have theirs in the manifest.
"""

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jaxmpc.files.errors import InputError
from jaxmpc.files.foreign import table_if_any
from jaxmpc.files.sealed import digest, write_atomic
from sweeps.store import differences, pretty, read_manifest

log = logging.getLogger(__name__)


def note(folder: Path, environment: Mapping[str, str]) -> None:
    """Add an environment, unless it is there; another one that is there already is told of.

    Args:
        folder: The sweep's, with its manifest.
        environment: As `machine.environment` tells it.

    Raises:
        InputError: See `noted`.
        OSError: The folder cannot be written.
    """
    path = folder / "environments" / f"{digest(environment)[:12]}.json"
    if path.exists() or environment in noted(folder):
        return
    path.parent.mkdir(exist_ok=True)
    write_atomic(path, pretty(environment))
    # Looked for once the own one is there: of two that begin at once one at least sees the other.
    others = [each for each in noted(folder) if each != environment]
    if others:
        changed = ", ".join(differences(others[-1], environment))
        log.warning("this sweep was begun in another environment (%s): bits of its rows may differ", changed)


def noted(folder: Path) -> list[dict[str, Any]]:
    """The environments of a sweep's folder, in the order in which they came.

    Raises:
        InputError: The manifest of a folder from before holds something else in their place.
    """
    before = read_manifest(folder).get("environments", [])
    if not isinstance(before, list):
        raise InputError(
            "environments", before, "a list", "The manifest was changed by hand.", folder / "manifest.json"
        )
    files = sorted((folder / "environments").glob("[0-9a-f]*.json"), key=lambda path: path.stat().st_mtime_ns)
    return [*before, *filter(None, map(table_if_any, files))]
