"""From result files to the numbers of a table, and to its text; the same files give the same bytes.

The published numbers are in ``published.csv``, typed once from the paper.
"""

from __future__ import annotations

import csv
import functools
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from learn2assemble.reproduction.cells import (
    BOUND,
    Cell,
    Result,
    measurable,
    measured_agents,
    read_result,
    row_cells,
)
from learn2assemble.reproduction.tables import (
    HELPS,
    PAPER_PROTOCOL,
    Column,
    Condition,
    Row,
    Table,
)

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


NOT_AVAILABLE, NOT_TRAINED, NOT_MEASURED = "not available", "not trained", "not measured"


@dataclass(frozen=True)
class Summary:
    """Means over agents (each a mean over its episodes) of one row, column and condition."""

    R: float
    R_ci95: float
    """Half width of the 95 % interval: Student's over agents, of one agent normal over problems."""
    R_ci95_problems: float
    """The same over problems, of the mean of the agents on each."""
    a: float
    b: float
    f: float
    success: float
    agents: int
    episodes: int
    """Of all agents together."""
    R_other: float | None
    """R at the table's other discount."""
    share: float | None
    """Mean return over the mean upper bound of the same problems; at epsilon 0 only."""
    difference: tuple[float, float] | None = None
    """R less that of the table's reference, problem by problem, and half its 95 % interval."""

    @property
    def over_agents(self) -> bool:
        return self.agents >= 2


@dataclass(frozen=True)
class Entry:
    """One row in one column."""

    paper: Published | None
    state: str
    """Empty where there are results, else the reason why not."""
    results: dict[Condition, Summary]


@dataclass(frozen=True)
class TableData:
    """A table with its numbers: ``entries[row][column]``."""

    table: Table
    entries: tuple[tuple[Entry, ...], ...]
    episodes: tuple[int, int]
    """Fewest and most episodes an agent played; (0, 0) without results."""
    quick: bool
    left_out: tuple[str, ...]
    """Result files of the table that are absent."""


def load_table(table: Table, root: Path, quick: bool = False) -> TableData:
    """Read the numbers of ``table`` from the result files below ``root`` and nothing else."""
    played: list[int] = []
    missing: list[str] = []
    entries = []
    compared_with: dict[tuple[int, Condition], np.ndarray] = {}
    reference = table.reference
    # The reference first: all others are compared with it.
    order = sorted(range(len(table.rows)), key=lambda n: n != reference)
    for row in (table.rows[n] for n in order):
        line = []
        for number, column in enumerate(table.columns):
            agents = row.pick(measured_agents(root, column.name)) if row.agents else []
            cells = row_cells(table, row, number, agents)
            results = {}
            for condition in table.conditions:
                wanted = [
                    cell for cell in cells
                    if (cell.epsilon, cell.physics) == (condition.epsilon, condition.physics)
                ]  # fmt: skip
                found = [(cell, read_result(root / cell.path)) for cell in wanted]
                missing += [cell.path for cell, result in found if result is None]
                good = [r for cell, r in found if r is not None and r.cell == cell]
                if good:
                    returns = _by_problem(good)
                    base = compared_with.get((number, condition))
                    if not entries and reference is not None:
                        compared_with[number, condition] = returns
                    results[condition] = replace(
                        _summary(table, condition, good, root),
                        difference=None if base is None else paired(returns, base),
                    )
                    played += [r.episodes for r in good]
            paper = published(table, row, column)
            line.append(Entry(paper, _state(table, row, number, cells, results), results))
        entries.append(tuple(line))
    span = (min(played), max(played)) if played else (0, 0)
    entries = [entries[order.index(n)] for n in range(len(entries))]
    return TableData(table, tuple(entries), span, quick, tuple(sorted(set(missing))))


def _state(
    table: Table, row: Row, number: int, cells: list[Cell], results: dict[Condition, Summary]
) -> str:
    """Why there is nothing to show; empty where there is."""
    if results:
        return ""
    if table.columns[number].preset is None:
        return NOT_AVAILABLE
    if not row.known or (row.columns is not None and number not in row.columns):
        return NOT_AVAILABLE
    if not cells:
        return NOT_TRAINED if row.agents else NOT_AVAILABLE
    return NOT_MEASURED


def _summary(table: Table, condition: Condition, results: list[Result], root: Path) -> Summary:
    returns = [result.array("returns") for result in results]
    means = np.array([r.mean() for r in returns])
    failed = [result.array("failed") for result in results]
    success = [result.array("success") for result in results]
    other = None
    if table.other_discount is not None:
        key = f"returns_at_{table.other_discount:g}"
        other = _mean([r.array(key) for r in results if key in r.data])
    share = None
    if condition == Condition(0.0):
        share = _share(results, root)
    return Summary(
        R=float(means.mean()), R_ci95=_half_width(returns, means),
        R_ci95_problems=_half_width([_by_problem(results)], means[:1]),
        a=_mean([r.array("actions") for r in results]) or 0.0,
        b=_mean([(1 - f) * (1 - s) for f, s in zip(failed, success, strict=True)]) or 0.0,
        f=_mean(failed) or 0.0, success=_mean(success) or 0.0,
        agents=len(results), episodes=sum(r.episodes for r in results),
        R_other=other, share=share,
    )  # fmt: skip


def _by_problem(results: list[Result]) -> np.ndarray:
    """float64[E]: mean return of the agents on each problem that all have played."""
    count = min(result.episodes for result in results)
    return np.mean([result.array("returns")[:count] for result in results], axis=0)


def paired(returns: np.ndarray, others: np.ndarray) -> tuple[float, float]:
    """Mean difference on the same problems, and half the width of its 95 % interval.

    Args:
        returns, others: float64[E] by problem; of different lengths, the first ones count.
    """
    count = min(len(returns), len(others))
    apart = returns[:count] - others[:count]
    return float(apart.mean()), _half_width([apart], apart[:1])


def _mean(arrays: list[np.ndarray]) -> float | None:
    return float(np.mean([array.mean() for array in arrays])) if arrays else None


def _half_width(returns: list[np.ndarray], means: np.ndarray) -> float:
    """Half width of the 95 % interval of R."""
    sample, factor = (means, student(len(means))) if len(means) >= 2 else (returns[0], 1.96)
    count = len(sample)
    return factor * float(sample.std(ddof=1)) / math.sqrt(count) if count > 1 else 0.0


def student(count: int) -> float:
    """97.5 % point of Student's t for the mean of ``count`` values, as tables print it."""
    from scipy.special import stdtrit

    return round(float(stdtrit(count - 1, 0.975)), 3)


def _share(results: list[Result], root: Path) -> float | None:
    """Mean return over mean bound of the very problems that were played."""
    reached, bounds = [], []
    for result in results:
        cell = Cell(result.cell.task, BOUND, seed=result.cell.seed)
        bound = read_result(root / cell.path) if measurable(cell) else None
        if bound is None or bound.cell != cell or bound.episodes < result.episodes:
            return None
        reached.append(result.array("returns").mean())
        bounds.append(bound.array("returns")[: result.episodes].mean())
    return float(np.sum(reached) / np.sum(bounds))


def below_paper(paper: Published | None, ours: Summary) -> bool:
    """R under the paper's 95 % interval."""
    if paper is None or paper.R is None or paper.R_ci95 is None:
        return False
    mean, lowest = ours.R, paper.R - paper.R_ci95
    return mean < lowest


def fails_more(paper: Published | None, ours: Summary) -> bool:
    """f above the paper's by more than the sampling error of both (95 %)."""
    if paper is None or paper.f is None:
        return False
    variance = paper.f * (1 - paper.f) / EPISODES + ours.f * (1 - ours.f) / ours.episodes
    return ours.f > paper.f + 1.96 * math.sqrt(variance)


def compared(condition: Condition) -> bool:
    """Whether a condition is the one of the published numbers."""
    return condition.epsilon == PAPER_PROTOCOL.epsilon and condition.physics != "rigid"


DASH = "–"
LOW, HIGH = "▼", "▲"
"""R below the paper's interval; f above the paper's by more than sampling error."""
PAPER = "paper"


class Section(NamedTuple):
    """A block of the table: one task, or all of them."""

    title: str
    groups: list[tuple[str, int]]
    """Name and number of columns of each group of columns."""
    columns: list[str]
    rows: list[list[str]]
    kinds: list[str]
    """Kind of every row (``table_spec``)."""


BRIEF = ("R", "f", "success", "of bound")
"""What fits into a terminal."""


def sections(data: TableData, brief: bool = False) -> list[Section]:
    """Everything that was measured, one section a task; ``brief``: the main numbers."""
    table, out = data.table, []
    fields = [
        name for name in ("R", "a", "b", "f") if not brief or name in BRIEF
        if any(e.paper and getattr(e.paper, name) is not None for row in data.entries for e in row)
    ]  # fmt: skip
    names = {condition: _names(data, condition, brief) for condition in table.conditions}
    for number in range(len(table.columns)):
        paper = PAPER if brief else f"{PAPER}, {PAPER_PROTOCOL.label}"
        groups = [("", 2)] + ([(paper, len(fields))] if fields else [])
        columns = ["method", "agents", *fields]
        for condition in table.conditions:
            ours = condition.label if brief else f"ours, {condition.label}"
            groups.append((ours, len(names[condition])))
            columns += names[condition]
        rows, kinds = [], []
        for row, entries in zip(table.rows, data.entries, strict=True):
            if row.columns is not None and number not in row.columns:
                continue
            entry = entries[number]
            agents = _agents(entry) if row.agents or entry.state else DASH
            line = [row.name, agents, *_paper(entry.paper, fields)]
            kinds.append(row.kind)
            for condition in table.conditions:
                line += _ours(entry, condition, names[condition])
            rows.append(line)
        out.append(Section(_title(data, number), groups, columns, rows, kinds))
    return out


def compact(data: TableData) -> Section:
    """The main numbers of all tasks in one section: for a terminal and the README."""
    table = data.table
    groups = [("", 2), (f"{PAPER}, {PAPER_PROTOCOL.label}", 1)]
    columns = ["task", "method", "R / f"]
    for condition in table.conditions:
        clean = condition == Condition(0.0)
        groups.append((f"ours, {condition.label}", 1 + clean))
        columns += ["R / f / success"] + (["of bound"] if clean else [])
    rows, kinds = [], []
    for number in range(len(table.columns)):
        for row, entries in zip(table.rows, data.entries, strict=True):
            entry, paper = entries[number], entries[number].paper
            if not entry.results and not paper:
                continue
            line = [_title(data, number), row.name, DASH]
            if paper is not None:
                line[2] = f"{_two(paper.R)} / {_two(paper.f)}"
            for condition in table.conditions:
                ours = entry.results.get(condition)
                line.append(_main(entry, condition, ours) if ours else entry.state or DASH)
                if condition == Condition(0.0):
                    line.append(_percent(ours.share) if ours else DASH)
            rows.append(line)
            kinds.append(row.kind)
    return Section(table.title, groups, columns, rows, kinds)


def markdown(data: TableData) -> str:
    """The whole table as a page of its own."""
    lines = [f"# {data.table.name}: {data.table.title}", ""]
    if data.quick:
        lines += [f"**{QUICK}**", ""]
    for section in sections(data):
        lines += [f"## {_escape(section.title)}", "", *_markdown_rows(section), ""]
    return "\n".join([*lines, *[f"* {_escape(note)}" for note in notes(data)], ""])


def compact_markdown(data: TableData) -> str:
    """The main numbers as a table to put into another page."""
    rows = _markdown_rows(compact(data))
    return "\n".join([*rows, "", *[f"* {_escape(note)}" for note in notes(data)]])


QUICK = "A quick look: one agent and few episodes a cell. Not the numbers of record."


def notes(data: TableData) -> list[str]:
    """What has to be known to read the numbers."""
    text = "".join(cell for section in sections(data) for row in section.rows for cell in row)
    low, high = data.episodes
    count = str(low) if low == high else f"{low} to {high}"
    out = [QUICK] if data.quick else []
    out += [
        "R: mean discounted return; a: actions an episode; b: share that ran out of blocks; f: "
        "share ended by an invalid action. *: the agents were trained on this task.",
        f"Ours: {count} problems an agent, the same for every method, none used in training. ± is "
        "the 95 % interval of R: over agents (Student) and, in brackets, over problems; where a "
        "row has one agent, over problems (marked °). Paper: five agents, 100 episodes each.",
    ]
    if "%" in text:
        out.append(
            "of bound: mean return as a share of the mean upper bound on the return of the same "
            "problems (exact for cubes on one or two sides; for objects a packing bound that knows "
            "neither balance nor support)."
        )
    if data.table.reference is not None:
        name = data.table.rows[data.table.reference].name
        out.append(
            f'− ours: R less that of "{name}" on the same problems, ± the 95 % interval of the '
            "paired differences."
        )
    if data.table.other_discount is not None:
        out.append(f"R': the same episodes at the discount {data.table.other_discount:g}.")
    if LOW in text:
        out.append(f"{LOW}: R below the paper's 95 % interval.")
    if HIGH in text:
        out.append(f"{HIGH}: f above the paper's by more than the sampling error of both.")
    if any(row.distinct for row in data.table.rows):
        out.append(
            "distinct: the search expands one of several placements that lead to the same "
            "structure (deviation D14)."
        )
    tags = {row.help: HELPS[row.help] for row in data.table.rows if row.help}
    out += [f"{tag}: {words}" for tag, words in tags.items()]
    return out + list(data.table.notes)


def headings(section: Section, between: str) -> list[str]:
    """Group and name of every column in one."""
    groups = [name for name, width in section.groups for _ in range(width)]
    pairs = zip(groups, section.columns, strict=True)
    return [f"{group}{between}{column}" if group else column for group, column in pairs]


def _markdown_rows(section: Section) -> list[str]:
    heads = headings(section, ": ")
    left = 2 if heads[0] == "task" else 1
    rule = ["---"] * left + ["---:"] * (len(heads) - left)
    rows = [[_escape(cell) for cell in row] for row in section.rows]
    return [f"| {' | '.join(line)} |" for line in (heads, rule, *rows)]


def _escape(text: str) -> str:
    """For markdown, where a star is emphasis and a bar ends a cell."""
    return text.replace("*", "\\*").replace("|", "\\|")


def _title(data: TableData, number: int) -> str:
    column = data.table.columns[number]
    return f"{column.name}{'*' if column.star else ''}"


def _names(data: TableData, condition: Condition, brief: bool) -> list[str]:
    other = ["R'"] if data.table.other_discount is not None else []
    bound = ["of bound"] if condition == Condition(0.0) else []
    paired_with = ["− ours"] if data.table.reference is not None else []
    names = ["R", *paired_with, *other, "a", "b", "f", "success", *bound]
    return [name for name in names if name in BRIEF] if brief else names


def _agents(entry: Entry) -> str:
    if entry.state:
        return entry.state
    counts = sorted({summary.agents for summary in entry.results.values()})
    return "–".join(str(n) for n in counts)


def _paper(paper: Published | None, fields: list[str]) -> list[str]:
    if paper is None:
        return [DASH] * len(fields)
    out = [_two(getattr(paper, name)) for name in fields]
    if fields[:1] == ["R"] and paper.R_ci95 is not None:
        out[0] += f" ± {paper.R_ci95:.2f}"
    return out


def _ours(entry: Entry, condition: Condition, names: list[str]) -> list[str]:
    ours = entry.results.get(condition)
    if ours is None:
        return [DASH] * len(names)
    low, high = _marks(entry, condition, ours)
    words = {
        "R": f"{_interval_text(ours)}{low}", "− ours": _difference(ours),
        "R'": _two(ours.R_other), "a": f"{ours.a:.2f}",
        "b": _two(ours.b), "f": f"{ours.f:.2f}{high}", "success": _two(ours.success),
        "of bound": _percent(ours.share),
    }  # fmt: skip
    return [words[name] for name in names]


def _main(entry: Entry, condition: Condition, ours: Summary) -> str:
    low, high = _marks(entry, condition, ours)
    return f"{_interval_text(ours)}{low} / {ours.f:.2f}{high} / {ours.success:.2f}"


def _marks(entry: Entry, condition: Condition, ours: Summary) -> tuple[str, str]:
    if not compared(condition):
        return "", ""
    low = f" {LOW}" if below_paper(entry.paper, ours) else ""
    return low, f" {HIGH}" if fails_more(entry.paper, ours) else ""


def _interval_text(ours: Summary) -> str:
    more = f" ({ours.R_ci95_problems:.2f})" if ours.over_agents else "°"
    return f"{ours.R:.2f} ± {ours.R_ci95:.2f}{more}"


def _difference(ours: Summary) -> str:
    return DASH if ours.difference is None else "{:+.2f} ± {:.2f}".format(*ours.difference)


def _two(value: float | None) -> str:
    return DASH if value is None else f"{value:.2f}"


def _percent(value: float | None) -> str:
    return DASH if value is None else f"{100 * value:.1f} %"
