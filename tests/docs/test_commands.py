"""Command lines in README and guides are understood by the parser, those too that nothing here can run."""

import shlex

import pytest

from jaxmpc.cli import whole_parser
from tests.docs.document import SHELL, blocks, pages


def commands(text: str) -> list[str]:
    """Command lines of `jaxmpc`, continuation lines joined."""
    lines = (line.strip() for line in text.replace("\\\n", " ").splitlines())
    return [line for line in lines if line.startswith("jaxmpc ")]


COMMANDS = [
    (block.place, line)
    for page in pages()
    for block in blocks(page)
    if block.language in SHELL
    for line in commands(block.text + block.left_out)
]


def test_there_are_commands_to_look_at() -> None:
    assert len(COMMANDS) > 20


@pytest.mark.parametrize(("place", "line"), COMMANDS)
def test_every_printed_command_is_understood(place: str, line: str) -> None:
    words = shlex.split(line, comments=True)[1:]
    words = words[: next((i for i, word in enumerate(words) if word in ("|", ">", "&", "&&")), len(words))]
    whole_parser().parse_args(words)


def test_a_wrong_command_would_be_seen() -> None:
    with pytest.raises(SystemExit):
        whole_parser().parse_args(["freeze", "text", "--stifness", "3"])
