"""The published numbers (``published.csv``, typed once from the paper; protocol 12.2)."""

from __future__ import annotations

import csv
import functools
from dataclasses import dataclass
from pathlib import Path

from learn2assemble.evaluation.table_spec import Column, Row, Table

FILE = Path(__file__).with_name("published.csv")
EPISODES = 500
"""Episodes behind a published number: five agents, 100 each."""


@dataclass(frozen=True)
class Published:
    """One published cell; ``None`` where the paper gives no number."""

    R: float | None
    R_ci95: float | None
    a: float | None
    b: float | None
    f: float | None


@functools.cache
def _lines() -> tuple[dict[str, str], ...]:
    with FILE.open(encoding="utf-8") as stream:
        return tuple(csv.DictReader(stream))


def published(table: Table, row: Row, column: Column) -> Published | None:
    """The published cell of a row and a column; ``None`` where there is none.

    Raises:
        LookupError: where the fields of table, row and column pick more than one line.
    """
    if not (table.paper and row.paper and column.paper):
        return None
    wanted = {**table.paper, **row.paper, **column.paper}
    found = [line for line in _lines() if all(line[key] == v for key, v in wanted.items())]
    if len(found) > 1:
        raise LookupError(f"table {table.name}: {len(found)} published lines fit {wanted}")
    if not found:
        return None
    line = found[0]
    number = {
        key: float(line[name]) if line[name] else None
        for key, name in (("R", "R"), ("R_ci95", "R_ci95"), ("a", "a_mean"), ("b", "b"), ("f", "f"))
    }
    return Published(**number)
