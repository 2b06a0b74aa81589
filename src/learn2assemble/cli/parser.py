"""What a command is, and the parser over all of them."""

from __future__ import annotations

import argparse
import inspect
import math
import re
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, cast

from learn2assemble import __version__
from learn2assemble.errors import closest
from learn2assemble.files import UNITS
from learn2assemble.registry import Registry, add_plugin
from learn2assemble.robot.registry import ARMS

if TYPE_CHECKING:
    from learn2assemble.cli.output import Output


Run = Callable[[argparse.Namespace, "Output"], "int | None"]
"""What a command does; returns the exit code."""


@dataclass(frozen=True)
class Command:
    """A command of ``l2a``."""

    help: str
    example: str
    arguments: Callable[[argparse.ArgumentParser], None]
    """Adds the arguments to its parser."""
    run: Run
    learns: bool = False
    """Whether it needs the extra ``learn``."""


Adder = Callable[[argparse.ArgumentParser], object]
"""Adds arguments to a parser."""
COMMANDS: Registry[Command] = Registry("command", {})
"""Every command by name, in the order of the help."""
add_plugin("learn2assemble.cli.commands", "command")
LABORATORY: Registry[Command] = Registry("laboratory command", {})
"""Those of ``l2a-lab``, where there is a laboratory."""
add_plugin("l2a_lab.commands", "laboratory command", optional=True)


def arg(*names: str, **options: Any) -> Adder:
    """An argument of a command, as ``add_argument`` takes it."""
    return lambda parser: parser.add_argument(*names, **options)


def group(title: str, *arguments: Adder) -> Adder:
    """Arguments under a title of their own in the help."""
    return lambda parser: _add_all(cast("Any", parser.add_argument_group(title)), arguments)


def either(*arguments: Adder) -> Adder:
    """Arguments of which exactly one is given."""
    return lambda parser: _add_all(
        cast("Any", parser.add_mutually_exclusive_group(required=True)), arguments
    )


def at_most_one(*arguments: Adder) -> Adder:
    """Arguments of which not more than one is given."""
    return lambda parser: _add_all(cast("Any", parser.add_mutually_exclusive_group()), arguments)


def _add_all(parser: argparse.ArgumentParser, arguments: Iterable[Adder]) -> None:
    for add in arguments:
        add(parser)


def command(
    table: dict[str, Command],
    name: str,
    help: str,
    example: str,
    *arguments: Adder,
    learns: bool = False,
) -> Callable[[Run], Run]:
    """Enter a function in a table of commands."""

    def enter(run: Run) -> Run:
        def fill(parser: argparse.ArgumentParser) -> None:
            _add_all(parser, arguments)

        table[name] = Command(help, example, fill, run, learns)
        return run

    return enter


def asked(
    function: Callable[..., Any], options: argparse.Namespace, *without: str
) -> dict[str, Any]:
    """The options of a command that are arguments of a function, but those that are named."""
    names = set(inspect.signature(function).parameters) - set(without)
    return {name: value for name, value in vars(options).items() if name in names}


COMMAND = "COMMAND"
"""What help and messages call the first word."""
MOST_IN_USAGE = 15
"""Where a command has more options than this, its usage names those alone that are needed."""


class _Parser(argparse.ArgumentParser):
    """Reports a wrong call in one line and exits with 2.

    The arguments of a command are added when it has been chosen: their help may name what takes
    time to list.
    """

    fill: Callable[[argparse.ArgumentParser], None] | None = None
    elsewhere = ""
    """What a message about an unknown command adds, see :class:`Registry`."""

    def parse_known_args(  # pyright: ignore[reportIncompatibleMethodOverride]
        self, args: Any = None, namespace: Any = None
    ) -> Any:
        if self.fill is not None:
            fill, self.fill = self.fill, None
            fill(self)
            self.usage = self._usage_of_the_needed()
            # Here, where the options of the command are known; the parser above knows none.
            read, unknown = super().parse_known_args(args, namespace)
            if unknown:
                near = closest(unknown[0], self._option_string_actions)
                hint = f"; did you mean {near}?" if near else ""
                self.error(f"unrecognized arguments: {' '.join(unknown)}{hint}")
            return read, unknown
        return super().parse_known_args(args, namespace)

    def _usage_of_the_needed(self) -> str | None:
        """The usage with what is needed alone, where there are more than :data:`MOST_IN_USAGE`
        options; None: with all of them."""
        required = [group for group in self._mutually_exclusive_groups if group.required]
        needed = {action for group in required for action in group._group_actions}
        needed |= {a for a in self._actions if a.required or not a.option_strings}
        if len(self._actions) - len(needed) <= MOST_IN_USAGE:
            return None
        formatter = self._get_formatter()
        actions = [action for action in self._actions if action in needed]
        formatter.add_usage(None, actions, required)
        words = formatter.format_help().split()[1:]
        return f"{' '.join(words).replace('%', '%%')} [options]"

    def error(self, message: str) -> NoReturn:
        text = " ".join(message.split())
        if "invalid choice" in text and "(choose from" in text:
            text = self._with_hint(text)
        # As all other errors begin, with the name of the program alone.
        sys.stderr.write(f"{self.prog.split()[0]}: error: {text} (see {self.prog} --help)\n")
        raise SystemExit(2)

    def _with_hint(self, text: str) -> str:
        head, _, choices = text.partition(" (choose from ")
        got = head.split("invalid choice: ", 1)[1].strip("'")
        valid = [choice.strip(" ')") for choice in choices.split(",")]
        near = closest(got, valid)
        hint = f"did you mean {near!r}?" if near else ""
        if not head.startswith(f"argument {COMMAND}:"):
            return f"{text}; {hint}" if near else text
        if self.prog == L2A.name and got in LABORATORY:
            hint = f"it is a command of the laboratory: l2a-lab {got}, or python -m l2a_lab {got}"
        elsewhere = self.elsewhere or (LABORATORY.elsewhere if self.prog == L2A.name else "")
        return f"command: got {got!r}, {hint or 'which there is not'}{elsewhere}"


def number(cast: type, low: float, high: float, words: str) -> Callable[[str], Any]:
    """An argparse type for numbers in a range."""

    def parse(text: str) -> Any:
        try:
            value = cast(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f"got {text!r}, expected {words}") from None
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"got {text!r}, expected {words}")
        return value

    return parse


count: Callable[[str], int] = number(int, 1, 10**9, "a whole number from 1 to 1000000000")
natural: Callable[[str], int] = number(int, 0, 2**31 - 1, f"a whole number from 0 to {2**31 - 1}")
share: Callable[[str], float] = number(float, 0, 1, "a number from 0 to 1")
positive: Callable[[str], float] = number(float, 1e-3, 1e7, "a number from 0.001 to 10000000")
friction: Callable[[str], float] = number(float, 0, 10, "a coefficient of friction from 0 to 10")
pull: Callable[[str], float] = number(float, 0, 1e3, "a force from 0 to 1000 N")


def percent(text: str) -> float:
    """A share, ``0.3`` or ``30%``, above 0 and up to 1."""
    body, whole = (text[:-1], 100.0) if text.endswith("%") else (text, 1.0)
    try:
        found = float(body) / whole
    except ValueError:
        found = 0.0
    if not 0 < found <= 1:
        raise argparse.ArgumentTypeError(f"got {text!r}, expected a share as 0.3 or 30%, up to 1")
    return found


def named(text: str) -> Path:
    """The name of a file or folder; an empty one, as of a variable that is not set, would be the
    folder one is in."""
    if not text:
        raise argparse.ArgumentTypeError("got '', expected the name of a file or folder")
    return Path(text)


def length(text: str) -> float:
    """A length with its unit, ``0.5mm`` or ``3 cm``, from 0; a bare number is metres."""
    return _length(text, "a length from 0 to 1000 m, such as 0.5mm")


def extent(text: str) -> float:
    """How large something is: a length above 0."""
    words = "a length above 0, up to 1000 m, such as 30mm"
    if not (value := _length(text, words)):
        raise argparse.ArgumentTypeError(f"got {text!r}, expected {words}")
    return value


def edges(text: str) -> float | tuple[float, ...]:
    """Edges of a cell: an extent, or three as ``80x120x30mm``, as messages write them, too.

    A unit may stand behind the last only.
    """
    parts = re.split("[x×]", text)
    if len(parts) == 1:
        return extent(text)
    if len(parts) != 3:
        expected = "one length or three, such as 50mm or 80x120x30mm"
        raise argparse.ArgumentTypeError(f"got {text!r}, expected {expected}")
    unit = _unit(parts[-1])
    return tuple(extent(part if _unit(part) else part + unit) for part in parts)


def _unit(text: str) -> str:
    """The unit behind a length; nothing without one."""
    return next((name for name in UNITS if text.strip().endswith(name)), "")


def _length(text: str, words: str) -> float:
    body = text.strip()
    unit = _unit(body)
    try:
        value = float(body.removesuffix(unit)) * UNITS.get(unit, 1.0)
    except ValueError:
        value = -1.0
    if not 0 <= value <= 1e3:
        raise argparse.ArgumentTypeError(f"got {text!r}, expected {words}")
    return value


def span_of(parse: Any) -> Any:
    """An argparse type for one value or a range of two, ``LOW:HIGH``.

    A unit may stand behind the last only: ``0:0.5mm``.
    """

    def parse_span(text: str) -> Any:
        low, colon, high = text.partition(":")
        if not colon:
            return parse(low)
        unit = high.lstrip("0123456789.+-eE ") if parse is length else ""
        first = parse(low if low.endswith(unit) else low + unit)
        second = parse(high)
        if first > second:
            raise argparse.ArgumentTypeError(f"got {text!r}, expected LOW:HIGH")
        return first, second

    return parse_span


def noise(text: str) -> tuple[float, float]:
    """Standard deviations ``MM[:DEG]`` as metres and radians."""
    parse = number(float, 0, 100, "millimetres and degrees, such as 0.5:0.2")
    place, _, turn = text.partition(":")
    return parse(place) / 1e3, math.radians(parse(turn)) if turn else 0.0


def kit_argument(parser: Any) -> None:
    """Add ``--kit``, the blocks of a design."""
    parser.add_argument("--kit", default=None, help="name or .toml file (the design's own)")


def reading_arguments(parser: Any) -> None:
    """Add the options that say how a design is read."""
    add = parser.add_argument
    add("--unit", default=None, help="of the file where it does not say: mm, cm, m or in")
    words = "edge of a cell, and so of blocks, or 80x120x30mm"
    add("--cell", type=edges, default=None, metavar="L", help=words)
    add("--size", type=extent, default=None, metavar="L", help="largest side, instead of a unit")
    add("--up", default=None, metavar="AXIS", help="the axis that points up: y or z")
    add("--depth", type=extent, default=None, metavar="L", help="of the wall of a drawing")
    words = "of a drawing, picture or mesh"
    add("--cells-wide", type=count, default=None, metavar="N", help=words)
    add("--repair", action="store_true", default=None, help="close small holes of a mesh")
    words = "objects of a mesh are blocks where they stand"
    add("--blocks", action="store_true", default=None, help=words)


_READING = ("unit", "cell", "size", "up", "depth", "cells_wide", "repair", "blocks")
"""Options that say how to read the design, as arguments of the package."""


def reading_of(options: argparse.Namespace) -> dict[str, Any]:
    """What was said about how to read the design."""
    given = {name: getattr(options, name) for name in _READING}
    return {name: value for name, value in given.items() if value is not None}


def overwrite_argument(parser: Any) -> None:
    """Add ``--overwrite`` for files that are made again and again, see
    :func:`~learn2assemble.files.check_new`."""
    words = "replace the file that is there; what the command reads is never replaced"
    parser.add_argument("--overwrite", action="store_true", help=words)


def arm_argument(parser: argparse.ArgumentParser) -> None:
    """Add ``--arm`` for tasks with a robot."""
    names = ", ".join(ARMS)
    parser.add_argument("--arm", default=None, help=f"{names} or none; the task's own")


def workers_arguments(parser: argparse.ArgumentParser, what: str) -> None:
    """Add ``--workers`` and ``--ray``, see :func:`learn2assemble.workers.run_all`."""
    parser.add_argument("--workers", type=count, default=None, help=what)
    parser.add_argument(
        "--ray",
        metavar="ADDRESS",
        default=None,
        help="work on a Ray cluster: HOST:PORT, auto or local (extra ray)",
    )


@dataclass(frozen=True)
class CommandLine:
    """A program of the command line."""

    name: str
    description: str
    example: str
    commands: Mapping[str, Command]


L2A = CommandLine(
    "l2a",
    "From a target design to a verified build plan.",
    "l2a build examples/designs/gabled_house.json --out out/house",
    COMMANDS,
)


def make_parser(words: Sequence[str] = (), program: CommandLine = L2A) -> argparse.ArgumentParser:
    """The parser of a program and its commands; ``options.run`` is the command chosen.

    Args:
        words: what will be parsed: a command that is named first is the only one, so that a build
            does not load the commands of the laboratory.
        program: whose.
    """
    table = program.commands
    names = words[:1] if words and words[0] in table else table
    parser = _Parser(
        prog=program.name,
        description=program.description,
        epilog=f"example: {program.example}",
    )
    parser.add_argument("--version", action="version", version=f"learn2assemble {__version__}")
    commands = parser.add_subparsers(metavar=COMMAND, required=True, parser_class=_Parser)
    if isinstance(table, Registry):
        parser.elsewhere = table.elsewhere
    for name in names:
        command = table[name]
        added = commands.add_parser(
            name, help=command.help, description=command.help, epilog=f"example: {command.example}"
        )
        assert isinstance(added, _Parser)
        added.fill = command.arguments
        added.add_argument(
            "--json",
            action="store_true",
            help="end with one JSON object, all else on standard error",
        )
        added.add_argument(
            "--verbose",
            action="store_true",
            help="a line for everything that is tried",
        )
        added.set_defaults(run=command.run, learns=command.learns)
    return parser
