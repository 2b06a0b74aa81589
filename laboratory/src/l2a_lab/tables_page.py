"""All tables in two files: a page for readers (``tables.md``), and every figure as CSV
(``tables.csv``); both follow from the cells alone, and a table replaces its own part of them."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable
from pathlib import Path

from l2a_lab.numbers import TableData
from l2a_lab.report import FIGURES, lines, markdown
from l2a_lab.tables import TABLES
from learn2assemble.errors import InputError
from learn2assemble.files import check_output, read_text, write_file

PAGE, FIGURES_FILE = "tables.md", "tables.csv"
HEAD = """# Tables

Every table of the paper beside ours, and tables of our own ([how they are made](../docs/results.md\
)). A task opens at the first condition, mostly that of the published numbers; others open by a \
click. All figures are in [tables.csv](tables.csv), one line a table, task, method and condition.
"""
_BEGIN, _END = "<!-- table ", " -->"


def put_table(data: TableData, root: Path) -> dict[str, Path]:
    """Write a table into the page and the figures of a folder of results; the rest stays.

    Args:
        data: the table with its numbers.
        root: the folder.

    Returns:
        The files by what they are: ``markdown`` and ``csv``.

    Raises:
        InputError: where one of them cannot be read or written.
    """
    chapters, rows = read_tables(root)
    chapters[data.table.name], rows[data.table.name] = markdown(data), lines(data)
    page, figures = root / PAGE, root / FIGURES_FILE
    write_file(page, page_of(chapters), "--out")
    write_file(figures, figures_of(rows), "--out")
    return {"markdown": page, "csv": figures}


def read_tables(root: Path) -> tuple[dict[str, str], dict[str, list[list[str]]]]:
    """Chapters of the page and lines of the figures, by the names of their tables.

    Raises:
        InputError: where a file of that name is another one, or cannot be written.
    """
    page, figures = root / PAGE, root / FIGURES_FILE
    chapters: dict[str, str] = {}
    rows: dict[str, list[list[str]]] = {}
    for file in (page, figures):
        check_output(file, "--out")
    if page.exists():
        text, _ = read_text(page, "page of tables")
        head, *parts = text.split(_BEGIN)
        if not head.startswith(HEAD.partition("\n")[0]) or not all(_END in p for p in parts):
            raise InputError("--out", str(page), "a new file, or a page of this command")
        for part in parts:
            name, _, chapter = part.partition(_END)
            chapters[name] = chapter
    if figures.exists():
        text, _ = read_text(figures, "figures of tables")
        head, *found = [*csv.reader(io.StringIO(text))] or [[]]
        if tuple(head) != FIGURES or any(len(row) != len(FIGURES) for row in found):
            raise InputError("--out", str(figures), "a new file, or figures of this command")
        for row in found:
            rows.setdefault(row[0], []).append(row)
    return chapters, rows


def page_of(chapters: dict[str, str]) -> str:
    """The page with chapters by the names of their tables."""
    parts = [f"{_BEGIN}{name}{_END}\n{chapters[name].strip()}\n" for name in _ordered(chapters)]
    return "\n".join([HEAD, *parts])


def figures_of(rows: dict[str, list[list[str]]]) -> str:
    """The figures of tables by their names, as CSV."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(FIGURES)
    for name in _ordered(rows):
        writer.writerows(rows[name])
    return stream.getvalue()


def _ordered(names: Iterable[str]) -> list[str]:
    """As the tables are listed; those that are no longer known are left out."""
    there = set(names)
    return [name for name in TABLES if name in there]
