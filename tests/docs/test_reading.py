"""README and guides do as they say: each block runs as printed, in the order printed, on the desk of one reader."""

import pytest

from tests.docs.desk import Desk
from tests.docs.document import Block, blocks, check, pages

BLOCKS = [block for page in pages() for block in blocks(page)]


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Desk:
    return Desk(tmp_path_factory.mktemp("desk"))


@pytest.fixture(scope="module")
def slow_desk(tmp_path_factory: pytest.TempPathFactory) -> Desk:
    return Desk(tmp_path_factory.mktemp("desk"))


def runs(block: Block) -> bool:
    return bool(block.text.strip()) and block.language != "text"


@pytest.mark.parametrize("block", BLOCKS, ids=lambda block: block.place)
def test_what_is_left_out_says_why(block: Block) -> None:
    check(block)


def test_most_is_run() -> None:
    commands = [block for block in BLOCKS if block.language in ("", "sh", "bash", "python")]
    assert len([block for block in commands if runs(block)]) > 0.5 * len(commands) > 5.0


@pytest.mark.oracle
@pytest.mark.parametrize("block", [block for block in BLOCKS if runs(block) and not block.slow], ids=lambda b: b.place)
def test_a_block_runs_as_printed(desk: Desk, block: Block) -> None:
    desk.run(block)


@pytest.mark.slow
@pytest.mark.parametrize("block", [block for block in BLOCKS if runs(block)], ids=lambda block: block.place)
def test_every_block_runs_as_printed(slow_desk: Desk, block: Block) -> None:
    slow_desk.run(block)
