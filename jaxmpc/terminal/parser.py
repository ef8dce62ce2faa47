"""A command line whose mistakes are one sentence each, with the likeliest meant word."""

import argparse
import re
import sys
from collections.abc import Sequence
from typing import Any, NoReturn

from jaxmpc.files.errors import nearest, plain

KINDS = {"int": "a whole number", "float": "a number"}
_WRONG_VALUE = re.compile(r"argument (.*?): invalid (\w+) value: (.*)", re.DOTALL)
_WRONG_CHOICE = re.compile(r"argument (.*?): invalid choice: '?(.*?)'? \(choose from (.*)\)", re.DOTALL)
"""How argparse says it; where another version does otherwise, its own words are printed."""


class CommandParser(argparse.ArgumentParser):
    """The standard library's parser; what it says of a mistake takes one line, and unknown options find a neighbour."""

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse; an unknown option is told first, since what follows it would be taken for something else."""
        words = list(args or ())
        if not self._subparsers:
            self.check_options(words)
        return super().parse_known_args(args, namespace)

    def check_options(self, words: Sequence[str]) -> None:
        """Refuse an option that does not exist."""
        known = sorted(name for name in self._option_string_actions if name.startswith("--"))
        for word in words:
            if word == "--":
                return
            name = word.partition("=")[0]
            if word.startswith("--") and not any(each.startswith(name) for each in known):
                self.error(f"{name}: must be a known option. {nearest(name, known)}")

    def _print_message(self, message: str, file: Any = None) -> None:
        """Help that was asked for arrives, or the system's error is raised, which the standard library swallows."""
        if file is not sys.stdout:
            super()._print_message(message, file)
        elif message:
            file.write(message)
            file.flush()

    def of_verb(self, verb: str) -> "CommandParser":
        """The parser of a verb."""
        assert self._subparsers is not None
        (action,) = self._subparsers._group_actions
        found: CommandParser = action.choices[verb]  # type: ignore[index]  # a parser of verbs has some
        return found

    def taking_values(self) -> list[argparse.Action]:
        """Arguments that are followed by a value."""
        return [action for action in self._actions if action.nargs != 0 and action.dest != "help"]

    def error(self, message: str) -> NoReturn:
        """Say it in one line and exit with 2."""
        if found := _WRONG_VALUE.fullmatch(message):
            option, kind, value = found.groups()
            value = plain(value.strip("'"), 80)
            message = f"{option} = {value}: must be {KINDS.get(kind, kind)}"
        elif found := _WRONG_CHOICE.fullmatch(message):
            option, value, choices = found.groups()
            known = [each.strip("' ") for each in choices.split(",")]
            message = f"{option} = {plain(value, 80)}: must be a known one. {nearest(value, known)}"
        text = plain(message).rstrip(".")
        self.exit(2, f"{self.prog}: {text}. `{self.prog} --help` says more.\n")
