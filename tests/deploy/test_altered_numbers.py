"""A file whose numbers were altered and that was sealed again is refused, number by number."""

import re
from collections.abc import Iterator
from typing import Any

import pytest

from deploy.controller.file import ArtifactError, from_bytes, to_bytes
from jaxmpc.files.sealed import seal, unseal
from jaxmpc.law.pulse import PulseFinder
from jaxmpc.law.repetition import Repetition
from jaxmpc.law.stiffness import StiffnessIdentification
from tests.deploy import made
from tests.deploy.changed_files import refused, replaced

SCHEDULE = "gains.schedule"
LISTENS = [f"identification.{name}" for name in StiffnessIdentification._fields]
LEARNS = [f"repetition.{name}" for name in Repetition._fields if name != "finder"]
LEARNS += [f"repetition.finder.{name}" for name in PulseFinder._fields]

FREE = {
    r"params\.|provenance\.": "tells where it comes from",
    r"margins\.|family\.rows\.|floor\.": "is told and never flown; `check` computes margins again",
    r"loop\.(delay|sensor_cutoff)": "is what margins hold with, which `check` computes again",
    r"arm\.encoder_counts": "is told",
    r"arm\.limits\.": "is the choice of whoever freezes, within what nobody may exceed",
    r"arm\.chain\.links\.0\.(mass|moment|inertia\.([01]\..|2\.[01]))": "turns about the vertical alone",
    r"arm\.chain\.links\.[12]\.mass|arm\.chain\.links\.1\.moment\.2": "does not move: the shoulder is one point",
}
"""Numbers that may be others, and why: each of them …"""


@pytest.fixture(scope="module")
def family():
    """Header and arrays of a family that learns, whose trace is over before its schedule has any of the control."""
    return unseal(to_bytes(made.arm_artifact(6, compensated=True, gains=made.learning_gains())))


def numbers(table: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted path and value of each number of a nested table."""
    if isinstance(table, dict | list):
        for key, value in table.items() if isinstance(table, dict) else enumerate(table):
            yield from numbers(value, f"{path}.{key}" if path else str(key))
    elif isinstance(table, int | float):
        yield path, table


def altered(value: Any) -> Any:
    """By a thousandth; a switch turned, a whole number one more, and a small one by a millionth of its unit."""
    if isinstance(value, bool):
        return not value
    return value + 1 if isinstance(value, int) else value + max(1e-3 * abs(value), 1e-6)


def under(opened, path):
    """The numbers of a part."""
    return [(at, value) for at, value in numbers(opened[0]) if f"{at}.".startswith(f"{path}.")]


@pytest.mark.parametrize("name", LISTENS + LEARNS)
def test_what_listens_watches_and_learns_is_held_by_the_trace(family, name):
    for path, value in under(family, f"{SCHEDULE}.{name}"):
        refused(family, "deviation from the golden |family.band", path, 1.001 * value)


@pytest.mark.parametrize("part", ["identification", "repetition.finder"])
def test_bounds_are_held_one_by_one(family, part):
    """Where a believed stiffness begins is their middle, and no heart comes near its own."""
    header, arrays = family
    for bound, more in (("least", 0.01), ("most", -0.01)):
        ((path, value),) = under(family, f"{SCHEDULE}.{part}.{bound}")
        header = replaced(header, path, value + more)
    refused((header, arrays), "deviation from the golden ")


@pytest.mark.slow
def test_every_number_is_held_or_does_not_matter(family):
    header, arrays = family
    free = re.compile("|".join(FREE))
    loaded = []
    for path, value in numbers(header):
        if not free.match(path):
            try:
                from_bytes(seal(replaced(header, path, altered(value)), arrays))
                loaded.append(path)
            except ArtifactError:
                pass
    assert loaded == []
