"""Blocks of README and guides in the order printed, and what the page says of those that no test can run as they stand.

A comment right above a block, which no reader sees, says so with its reason:

    <!-- not run (hours): four tuning jobs -->                   the whole block; the word is one of NEEDS
    <!-- not run (a registry) `pip`: the tests have the extra -->   only its lines that begin so
    <!-- slow: a minute of compiling -->                         left to the slow tests
    <!-- ends with 1: the fault that it shows -->                another exit code than 0
"""

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from markdown_it import MarkdownIt

from tests.sources import ROOT

NEEDS = ("a robot", "a GPU", "other hosts", "a registry", "hours", "two terminals", "a clone of its own")
"""Reasons for which a block is not run."""
MARKER = re.compile(
    r"<!-- (?:not run \((?P<needs>[^)]+)\)(?: `(?P<begin>[^`]+)`)?|(?P<slow>slow)|ends with (?P<code>[1-9]))"
    r": (?P<why>.+?) -->"
)
SHELL = ("", "sh", "bash")


class Block(NamedTuple):
    """A fenced block."""

    document: str
    """Path of the page in the repository."""
    line: int
    language: str
    text: str
    """What of it is run: all, or without the lines that a marker names."""
    needs: str | None = None
    """Why it, or a part of it, is not run."""
    slow: bool = False
    code: int = 0
    """Exit code that it ends with."""
    left_out: str = ""
    """What of it is not run."""

    @property
    def place(self) -> str:
        return f"{self.document}:{self.line}"

    @property
    def file(self) -> str | None:
        """The name of a file that is printed: TOML whose first line is `# NAME.toml`."""
        named = re.match(r"# ([\w-]+\.toml)\n", self.text) if self.language == "toml" else None
        return named[1] if named else None


def pages() -> list[Path]:
    """README, the guides in the order of the site, then those that only others link to."""
    listed = re.search(
        r"```\{toctree\}\n.*?\n\n(.*?)```", (ROOT / "docs/index.md").read_text(encoding="utf-8"), re.DOTALL
    )
    assert listed
    named = [ROOT / "docs" / f"{name}.md" for name in listed[1].split()]
    rest = sorted(set((ROOT / "docs").glob("*.md")) - set(named))
    return [ROOT / "README.md", *(path for path in [*named, *rest] if path.exists())]


def blocks(page: Path) -> list[Block]:
    """All blocks of a page."""
    return list(_blocks(page.relative_to(ROOT).as_posix(), page.read_text(encoding="utf-8")))


def _blocks(name: str, text: str) -> Iterator[Block]:
    marker: re.Match[str] | None = None
    for token in MarkdownIt("commonmark").parse(text):
        if token.type == "html_block":
            marker = MARKER.fullmatch(token.content.strip())
            assert marker, f"{name}: a comment that is no marker: {token.content!r}"
        elif token.type == "fence" and token.map:
            block = Block(name, token.map[0] + 1, token.info.split(" ")[0], token.content)
            yield _marked(block, marker) if marker else block
            marker = None
        else:
            assert marker is None, f"{name}: a marker that stands above no block: {marker}"


def _marked(block: Block, marker: re.Match[str]) -> Block:
    if marker["slow"] or marker["code"]:
        return block._replace(slow=bool(marker["slow"]), code=int(marker["code"] or 0))
    begin, lines = marker["begin"], block.text.splitlines(keepends=True)
    left_out = [line for line in lines if begin is None or line.startswith(begin)]
    assert left_out, f"{block.place}: no line begins with {begin}"
    kept = "".join(line for line in lines if line not in left_out)
    return block._replace(text=kept, needs=marker["needs"], left_out="".join(left_out))


def check(block: Block) -> None:
    """What may be asked of a block without running it."""
    if block.needs is not None:
        assert block.needs in NEEDS, f"{block.place}: not run for {block.needs}, which is none of {NEEDS}"
    if block.language == "toml":
        tomllib.loads(block.text)
