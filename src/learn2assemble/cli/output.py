"""Where a command's words go: tables and progress for people, one JSON object for programs."""

from __future__ import annotations

import json
import os
import shutil
import sys
import textwrap
import threading
import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from learn2assemble.compiling import compiling_so_far
from learn2assemble.errors import as_options, printable
from learn2assemble.files import write_file
from learn2assemble.progress import Detail

QUIET = 1.5
"""So long nothing may be shown on a terminal before a line says what is going on [s]."""

WIDEST = 80
"""Columns that a paragraph takes at most on a terminal."""
SELDOM = 10.0
"""How far a phase has come is written to a file or a pipe after so long [s]."""


class Heartbeat:
    """A line on a terminal that says what is going on, for how long, and what time is left.

    It takes the place of silence only: the line goes away before anything else is shown, and where
    a progress bar runs there is none.

    Args:
        phase: what the command does first.
        limit: it ends after about so long [s]; None: not known.
    """

    started: float
    told: float

    def __init__(self, phase: str, limit: float | None = None) -> None:
        self.phase: str = phase
        self.limit = limit
        self.started = self.told = time.monotonic()
        self._compiled_before, _ = compiling_so_far()
        self._shown, self._lock, self._done = False, threading.Lock(), threading.Event()

    def __enter__(self) -> Heartbeat:
        if sys.stderr.isatty():
            threading.Thread(target=self._beat, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self._done.set()
        self.clear()

    def clear(self, phase: str | None = None) -> None:
        """Take the line away, as something is about to be shown: the next ``phase``, if any."""
        with self._lock:
            self.phase = phase or self.phase
            self.told = time.monotonic()
            if self._shown:
                sys.stderr.write("\r\x1b[K")
                sys.stderr.flush()
                self._shown = False

    def stop(self) -> None:
        """The command has its result."""
        self._done.set()
        self.clear()

    def words(self, now: float) -> str:
        """The line at a time of the monotonic clock."""
        spent = now - self.started
        compiled, compiling = compiling_so_far()
        # No limit counts compiling.
        used = max(spent - (compiled - self._compiled_before), 0.0)
        left = "" if self.limit is None else f", at most {max(self.limit - used, 0):.0f} s left"
        phase = "compiling, once for this machine" if compiling > 0.2 else self.phase
        return f"l2a: {phase} ... {spent:.0f} s{left}"

    def _beat(self) -> None:
        while not self._done.wait(0.5):
            bars: Any = getattr(sys.modules.get("tqdm"), "tqdm", None)
            with self._lock:
                now = time.monotonic()
                bar = bool(getattr(bars, "_instances", ()))
                if not bar and not self._done.is_set() and now - self.told > QUIET:
                    width = shutil.get_terminal_size().columns
                    line = printable(self.words(now))[: max(width - 1, 1)]
                    sys.stderr.write(f"\r\x1b[K{line}")
                    sys.stderr.flush()
                    self._shown = True


class Output:
    """Standard output and standard error of one command.

    Args:
        as_json: tables go to standard error, :meth:`finish` prints to standard output.
        heartbeat: is told of everything that is shown.
        verbose: how far a phase has come is a line each time.
    """

    def __init__(
        self, as_json: bool, heartbeat: Heartbeat | None = None, verbose: bool = False
    ) -> None:
        from rich.console import Console  # not needed for help and refusals

        self.as_json = as_json
        self.verbose = verbose
        self._detailed = time.monotonic()
        self.heartbeat: Heartbeat = heartbeat or Heartbeat("")
        self.console: Console = Console(stderr=as_json, highlight=False, soft_wrap=True)
        if not self.console.is_terminal and "COLUMNS" not in os.environ:
            # A file or a pipe has no width to fit into.
            self.console.width = 200

    def say(self, text: str) -> None:
        """One line for people: the command has its result."""
        self.heartbeat.stop()
        self.console.print(as_options(text), markup=False)

    def paragraph(self, text: str) -> None:
        """Words for people that may be longer than a line: on a terminal never beyond
        :data:`WIDEST`."""
        told = as_options(text)
        width = min(max(self.console.width, 20), WIDEST)
        if self.console.is_terminal:
            told = textwrap.fill(
                told,
                width,
                subsequent_indent="  ",
                break_on_hyphens=False,
                break_long_words=False,
            )
        self.say(told)

    def phase(self, text: str) -> None:
        """What begins, for the line that takes the place of silence."""
        self.heartbeat.phase = text

    def progress(self, text: str) -> None:
        """One line on standard error: what begins, or has been reached."""
        if isinstance(text, Detail) and not self.verbose:
            now = time.monotonic()
            if sys.stderr.isatty():
                # The heartbeat shows it until the next one, and the time left where it has it.
                self.heartbeat.phase = str(text) if self.heartbeat.limit is None else text.what
                return
            if now - self._detailed < SELDOM:
                return
            self._detailed = now
        self.heartbeat.clear(text)
        sys.stderr.write(f"l2a: {as_options(text)}\n")
        sys.stderr.flush()

    def table(self, title: str, columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
        """A table for people."""
        from rich.table import Table

        self.heartbeat.stop()
        if title:
            self.say(title)  # A title of the table would be broken to its width.
        table = Table(box=None, pad_edge=False)
        for number, column in enumerate(columns):
            table.add_column(
                column.replace("[", "\\["),
                justify="right" if number else "left",
                no_wrap=number == 0,
            )
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
                words,
                max(self.console.width, 10),
                initial_indent=indent,
                subsequent_indent=indent,
                break_on_hyphens=False,
            ):
                self.say(line)

    def finish(self, result: dict[str, Any]) -> None:
        """The result as JSON on the last line of standard output, if it was asked for."""
        if self.as_json:
            sys.stdout.write(as_options(json.dumps(result)) + "\n")
            sys.stdout.flush()


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
    return as_options(str(value))
