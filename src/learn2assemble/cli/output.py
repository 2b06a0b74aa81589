"""Where a command's words go: tables and progress for people, one JSON object for programs."""

from __future__ import annotations

import json
import os
import sys
import textwrap
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from learn2assemble.errors import InputError
from learn2assemble.files import printable, write_file


class Output:
    """Standard output and standard error of one command.

    Args:
        as_json: tables go to standard error, :meth:`finish` prints to standard output.
    """

    def __init__(self, as_json: bool) -> None:
        from rich.console import Console  # not needed for help and refusals

        self.as_json = as_json
        self.console = Console(stderr=as_json, highlight=False, soft_wrap=True)
        if not self.console.is_terminal and "COLUMNS" not in os.environ:
            # A file or a pipe has no width to fit into.
            self.console.width = 200

    def say(self, text: str) -> None:
        """One line for people."""
        self.console.print(text, markup=False)

    def progress(self, text: str) -> None:
        """One line on standard error."""
        sys.stderr.write(f"l2a: {text}\n")
        sys.stderr.flush()

    def table(self, title: str, columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
        """A table for people."""
        from rich.table import Table

        if title:
            self.say(title)  # A title of the table would be broken to its width.
        table = Table(box=None, pad_edge=False)
        for number, column in enumerate(columns):
            table.add_column(column, justify="right" if number else "left", no_wrap=number == 0)
        lines = [[_cell(value) for value in row] for row in rows]
        for line in lines:
            table.add_row(*[cell.replace("[", "\\[") for cell in line])
        free = self.console.options.update(width=100_000)
        if self.console.measure(table, options=free).minimum <= self.console.width:
            self.console.print(table, soft_wrap=False)
        else:  # Columns would be cut off.
            self._records(columns, lines)

    def _records(self, columns: Sequence[str], lines: Sequence[Sequence[str]]) -> None:
        """The rows of a table that is too wide, one below the other with the names of columns."""
        for first, *rest in lines:
            self.say(first)
            words = "; ".join(
                f"{name} {cell}" for name, cell in zip(columns[1:], rest, strict=True)
            )
            indent = " " * 2
            for line in textwrap.wrap(
                words, max(self.console.width, 10), initial_indent=indent,
                subsequent_indent=indent, break_on_hyphens=False,
            ):  # fmt: skip
                self.say(line)

    def finish(self, result: dict[str, Any]) -> None:
        """The result as JSON on the last line of standard output, if it was asked for."""
        if self.as_json:
            sys.stdout.write(json.dumps(result) + "\n")
            sys.stdout.flush()


def check_new_file(path: Path | None) -> None:
    """Refuse a result file that could not be written, before hours of episodes.

    Raises:
        InputError: where it exists, or its folder does not or cannot be written.
    """
    if path is None:
        return
    try:
        if os.path.lexists(path):
            raise InputError("--out", printable(str(path)), "a new file")
        with path.open("x"):
            pass
        path.unlink()
    except OSError as error:
        reason = error.strerror or "unwritable"
        raise InputError("--out", printable(str(path)), f"a writable file ({reason})") from None


def write_result(path: Path | None, result: dict[str, Any]) -> None:
    """Write a result file where one is asked for."""
    if path is not None:
        write_file(path, json.dumps(result, indent=1) + "\n", "--out")


def _cell(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.3f}"
    return str(value)
