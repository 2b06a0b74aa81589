"""What a command is, and the parser over all of them."""

from __future__ import annotations

import argparse
import difflib
import math
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NoReturn

from learn2assemble import __version__
from learn2assemble.registry import Registry, add_plugin

if TYPE_CHECKING:
    from learn2assemble.cli.output import Output


@dataclass(frozen=True)
class Command:
    """A command of ``l2a``."""

    help: str
    example: str
    arguments: Callable[[argparse.ArgumentParser], None]
    """Adds the arguments to its parser."""
    run: Callable[[argparse.Namespace, Output], int | None]
    """Returns the exit code."""


COMMANDS: Registry[Command] = Registry("command", {})
"""Every command by name, in the order of the help."""
add_plugin("learn2assemble.cli.commands", "command")
add_plugin("learn2assemble.reproduction.commands", "command")


class _Parser(argparse.ArgumentParser):
    """Reports a wrong call in one line and exits with 2.

    The arguments of a command are added when it has been chosen: their help may name what takes
    time to list.
    """

    fill: Callable[[argparse.ArgumentParser], None] | None = None

    def parse_known_args(  # pyright: ignore[reportIncompatibleMethodOverride]
        self, args: Any = None, namespace: Any = None
    ) -> Any:
        if self.fill is not None:
            fill, self.fill = self.fill, None
            fill(self)
        return super().parse_known_args(args, namespace)

    def error(self, message: str) -> NoReturn:
        text = " ".join(message.split())
        if "invalid choice" in text and "(choose from" in text:
            text = self._with_hint(text)
        sys.stderr.write(f"{self.prog}: error: {text} (see {self.prog} --help)\n")
        raise SystemExit(2)

    def _with_hint(self, text: str) -> str:
        head, _, choices = text.partition(" (choose from ")
        got = head.split("invalid choice: ", 1)[1].strip("'")
        valid = [choice.strip(" ')") for choice in choices.split(",")]
        near = difflib.get_close_matches(got, valid, n=1, cutoff=0.4)
        return text + (f"; did you mean {near[0]!r}?" if near else "")


def number(cast: type, low: float, high: float, words: str) -> Callable[[str], Any]:
    """An argparse type for finite numbers in a range."""

    def parse(text: str) -> Any:
        try:
            value = cast(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f"got {text!r}, expected {words}") from None
        if not math.isfinite(value) or not low <= value <= high:
            raise argparse.ArgumentTypeError(f"got {text!r}, expected {words}")
        return value

    return parse


count = number(int, 1, 10**9, "a whole number of at least 1")
natural = number(int, 0, 2**31 - 1, "a whole number of at least 0")
share = number(float, 0, 1, "a number between 0 and 1")
positive = number(float, 1e-3, 1e7, "a positive number")


def make_parser() -> argparse.ArgumentParser:
    """The parser of ``l2a`` and its commands; ``options.run`` is the command chosen."""
    parser = _Parser(
        prog="l2a", description="From a target design to a verified build plan.",
        epilog="example: l2a build examples/designs/gabled_house.json --out out/house",
    )  # fmt: skip
    parser.add_argument("--version", action="version", version=f"learn2assemble {__version__}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True, parser_class=_Parser)
    for name, command in COMMANDS.items():
        added = commands.add_parser(
            name, help=command.help, description=command.help, epilog=f"example: {command.example}"
        )
        assert isinstance(added, _Parser)
        added.fill = command.arguments
        added.add_argument(
            "--json", action="store_true",
            help="end standard output with one JSON object; all else goes to standard error",
        )  # fmt: skip
        added.set_defaults(run=command.run)
    return parser
