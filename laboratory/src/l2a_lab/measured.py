"""Figures by name in one result file: what is there is kept, so a stopped run goes on."""

from __future__ import annotations

import json
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from learn2assemble.errors import InputError
from learn2assemble.files import check_output, read_json, write_file
from learn2assemble.tasks.learning.run import provenance
from learn2assemble.values import mapping
from learn2assemble.workers import run_all

VERSION = 1
Result = dict[str, Any]


@dataclass(frozen=True)
class Figures:
    """A set of measurements.

    Args:
        format: what its result file is called in its head.
        names: of all measurements.
        entry: one measurement by its name; a function of a module, so that workers find it.
        configuration: of all of them, written beside versions and hardware.
        summary: what was asked, and what was reached, of all entries: (what, asked, got).
    """

    format: str
    names: Callable[[], Sequence[str]]
    entry: Callable[[str], Result]
    configuration: Callable[[], Result]
    summary: Callable[[dict[str, Result]], list[tuple[str, str, str]]] = lambda entries: []


def measure(
    figures: Figures,
    out: Path,
    *,
    only: str = "",
    again: bool = False,
    workers: int = 1,
    progress: Callable[[str], None] = lambda text: None,
) -> Result:
    """Measure what is missing in ``out`` and write it after every entry.

    Args:
        figures: what is measured.
        out: the result file.
        only: measure entries whose name has this in it.
        again: also those that are there.
        workers: measurements at once.
        progress: told what has been measured.

    Returns:
        The content of the file. Every entry has its commit, and the seconds it took: on the clock
        (``measuring_s``) and of the processor, where other programs do not count.

    Raises:
        InputError: where ``out`` is no such file, or nothing is called ``only``.
    """
    check_output(out, "--out")
    found = _load(out, figures.format)
    wanted = [name for name in figures.names() if only in name]
    if not wanted:
        raise InputError("--only", only, "part of the name of a measurement")
    about = provenance("cpu")
    todo = [name for name in wanted if again or name not in found["entries"]]
    began = time.monotonic()
    for done, (name, result) in enumerate(
        run_all(partial(_timed, figures.entry), todo, workers=workers), 1
    ):
        found["entries"][name] = {**result, "commit": about["commit"]}
        found["configuration"] = {**figures.configuration(), **about}
        write_file(out, json.dumps(found, indent=1, sort_keys=True) + "\n", "--out")
        told = result.get("status") or result.get("verdict") or "measured"
        left = (time.monotonic() - began) / done * (len(todo) - done)
        progress(f"{name}: {told}, {done} of {len(todo)}, about {left:.0f} s left")
    return found


def by_kind(entries: Mapping[str, Result]) -> dict[str, dict[str, Result]]:
    """Entries by what their names begin with, and by the rest; nothing of what is not there."""
    found: dict[str, dict[str, Result]] = defaultdict(dict)
    for name, one in entries.items():
        kind, _, what = name.partition("/")
        found[kind][what] = one
    return found


def table_lines(head: Sequence[str], rows: Iterable[Sequence[str]], words: int = 1) -> list[str]:
    """A table in Markdown, numbers to the right.

    Args:
        head: names of the columns.
        rows: what stands in them.
        words: how many columns, from the left, are no numbers.
    """
    rule = [*["---"] * words, *["---:"] * (len(head) - words)]
    return [f"| {' | '.join(line)} |" for line in (head, rule, *rows)]


def _timed(entry: Callable[[str], Result], name: str) -> Result:
    started, used = time.perf_counter(), time.process_time()
    result = entry(name)
    result["measuring_s"] = round(time.perf_counter() - started, 3)
    result["measuring_cpu_s"] = round(time.process_time() - used, 3)
    return result


def _load(out: Path, format: str) -> Result:
    if not out.exists():
        return {"format": format, "version": VERSION, "entries": {}}
    try:
        found = dict(mapping(read_json(out, "result file")[0], str(out)))
    except InputError:
        found = {}
    if (found.get("format"), found.get("version")) == (format, VERSION):
        mapping(found.get("entries"), f"{out}: entries")
        return found
    raise InputError("--out", str(out), "a new file, or a result of this command")
