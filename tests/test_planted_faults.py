"""Every fault still has its place in the sources; that tests catch it, `make planted-faults` shows."""

from pathlib import Path

import pytest

from tests.planted_faults import FAULTS, Fault, plant
from tests.sources import ROOT, SOURCES


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("tree")
    for path in SOURCES:
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_bytes((ROOT / path).read_bytes())
    return folder


@pytest.mark.parametrize("fault", FAULTS, ids=[fault.name for fault in FAULTS])
def test_it_can_be_planted(tree: Path, fault: Fault) -> None:
    path = tree / plant(fault, tree)
    source = path.read_text(encoding="utf-8")
    assert fault.wrong in source
    compile(source, path, "exec")


def test_a_fault_without_a_place_is_told(tree: Path) -> None:
    with pytest.raises(SystemExit, match="lost: 'no such line' stands 0 times"):
        plant(Fault("lost", "no such line", ""), tree)
