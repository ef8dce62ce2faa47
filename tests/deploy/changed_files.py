"""Files of a controller on the arm with one thing changed, and what is said of them."""

from functools import cache

import pytest

from deploy.controller.file import ArtifactError, from_bytes, to_bytes
from jaxmpc.files.sealed import seal
from tests.deploy import made


def replaced(table, path, value):
    """The same nested table with another value at a dotted path; ... removes it."""
    key, _, rest = path.partition(".")
    within = table[int(key)] if isinstance(table, list) else table.get(key)
    inner = replaced(within, rest, value) if rest else value
    if isinstance(table, list):
        return [inner if str(i) == key else each for i, each in enumerate(table)]
    return {k: v for k, v in (table | {key: inner}).items() if v is not ...}


def refused(opened, message, path=None, value=None, **arrays):
    header, held = opened
    header = replaced(header, path, value) if path else header
    with pytest.raises(ArtifactError, match=message):
        from_bytes(seal(header, {k: v for k, v in (held | arrays).items() if v is not None}))


@cache
def arm_file():
    """Bytes of a controller with a short trace."""
    return to_bytes(made.arm_artifact(6))
