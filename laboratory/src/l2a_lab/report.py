"""From result files to the numbers of a table, and to its text; the same files give the same bytes.

The published numbers are in ``published.csv``, typed once from the paper.
"""

from __future__ import annotations

import csv
import functools
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

import numpy as np

from l2a_lab.bounds import has_bound
from l2a_lab.cells import (
    BOUND,
    Cell,
    Result,
    measured_agents,
    read_result,
    row_cells,
)
from l2a_lab.tables import (
    HELPS,
    LOOK_AHEAD,
    MODEL_LABELS,
    OWN,
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
    names = ("R", "R_ci95", "a_mean", "b", "f")
    return Published(*[float(found[0][name]) if found[0][name] else None for name in names])


NOT_AVAILABLE, NOT_TRAINED, NOT_MEASURED = "not available", "not trained", "not measured"


@dataclass(frozen=True)
class Summary:
    """Means over agents (each a mean over its episodes) of one row, column and condition."""

    R: float
    R_ci95: float
    """Half width of the 95 % interval: Student's over agents, of one agent normal over problems.

    Agents that played different problems are compared by how far they stay below the upper bounds
    of these, where there are any: so the luck of the draw counts once, among the problems."""
    R_ci95_problems: float
    """The same over problems, of the mean of the agents on each."""
    a: float
    b: float
    f: float
    success: float
    agents: int
    episodes: int
    """Of all agents together."""
    problems: int
    """Different ones that were played."""
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

    row: Row
    column: Column
    paper: Published | None
    state: str
    """Empty where there are results, else the reason why not."""
    results: dict[Condition, Summary]

    @property
    def title(self) -> str:
        """The task, with a star where the agents were trained on it."""
        return f"{self.column.name}{'*' if self.column.star else ''}"


@dataclass(frozen=True)
class TableData:
    """A table with its numbers: ``entries[row][column]``."""

    table: Table
    entries: tuple[tuple[Entry, ...], ...]
    problems: tuple[int, int]
    """Fewest and most problems of a cell; (0, 0) without results."""
    quick: bool
    left_out: tuple[str, ...]
    """Result files of the table that are absent."""


def load_table(table: Table, root: Path, quick: bool = False) -> TableData:
    """Read the numbers of ``table`` from the result files below ``root`` and nothing else."""
    missing: set[str] = set()
    found = [
        [_results(table, row, number, root, missing) for number in range(len(table.columns))]
        for row in table.rows
    ]
    reference = found[table.reference] if table.reference is not None else None
    entries = tuple(
        tuple(
            _entry(table, row, number, root, results, reference[number] if reference else None)
            for number, results in enumerate(line)
        )
        for row, line in zip(table.rows, found, strict=True)
    )
    played = [
        summary.problems for line in entries for entry in line for summary in entry.results.values()
    ]
    span = (min(played), max(played)) if played else (0, 0)
    return TableData(table, entries, span, quick, tuple(sorted(missing)))


Results = dict[Condition, list[Result]]
"""Of one row in one column; of all its agents."""


def _results(table: Table, row: Row, number: int, root: Path, missing: set[str]) -> Results | None:
    """What has been measured; ``None`` where nothing can be. Adds absent files to ``missing``."""
    agents = row.pick(measured_agents(root, table.columns[number].name)) if row.agents else []
    cells = row_cells(table, row, number, agents)
    found: Results = {}
    for cell in cells:
        result = read_result(root / cell.path)
        if result is None:
            missing.add(cell.path)
        elif result.cell == cell:
            found.setdefault(Condition(cell.epsilon, cell.physics), []).append(result)
    return {key: _shares(results) for key, results in found.items()} if cells else None


def _shares(results: list[Result]) -> list[Result]:
    """Of agents that share the problems as much as each has played: the first share may be the
    beginning of more; shares of another size are left out."""
    size = min(result.episodes for result in results)
    return [
        result if result.episodes == size else result.head(size)
        for result in results
        if result.episodes == size or not result.cell.share
    ]


def _entry(
    table: Table,
    row: Row,
    number: int,
    root: Path,
    results: Results | None,
    reference: Results | None,
) -> Entry:
    column, state = table.columns[number], ""
    if results is None:
        state = NOT_TRAINED if row.agents else NOT_AVAILABLE
    elif not results:
        state = NOT_MEASURED
    summaries = {}
    for condition in table.conditions:
        good, base = (results or {}).get(condition), (reference or {}).get(condition)
        if good:
            other = None if results is reference else base
            summaries[condition] = _summary(table, condition, good, other, root)
    return Entry(row, column, published(table, row, column), state, summaries)


def _summary(
    table: Table,
    condition: Condition,
    results: list[Result],
    base: list[Result] | None,
    root: Path,
) -> Summary:
    def mean(name: str) -> float:
        return float(np.mean([result.array(name).mean() for result in results]))

    returns = [result.array("returns") for result in results]
    means = np.array([r.mean() for r in returns])
    bounds = _bounds(results, root)
    ran_out = [((1 - r.array("failed")) * (1 - r.array("success"))).mean() for r in results]
    problems, other = _by_problem(results), f"returns_at_{table.other_discount or 0:g}"
    return Summary(
        R=float(means.mean()),
        R_ci95=_half_width(returns, means if bounds is None else means - bounds),
        R_ci95_problems=_half_width([problems[np.isfinite(problems)]], means[:1]),
        a=mean("actions"),
        b=float(np.mean(ran_out)),
        f=mean("failed"),
        success=mean("success"),
        agents=len(results),
        episodes=sum(r.episodes for r in results),
        problems=int(np.isfinite(problems).sum()),
        R_other=mean(other) if all(other in r.data for r in results) else None,
        share=None
        if bounds is None or condition != Condition(0.0)
        else float(means.sum() / bounds.sum()),
        difference=None if base is None else paired(problems, _by_problem(base)),
    )


def _by_problem(results: list[Result]) -> np.ndarray:
    """float64[E]: mean return on each problem of the agents that have played it; NaN of none."""
    total, count = np.zeros((2, max(result.first + result.episodes for result in results)))
    for result in results:
        played = slice(result.first, result.first + result.episodes)
        total[played] += result.array("returns")
        count[played] += 1
    return np.divide(total, count, out=np.full(len(total), np.nan), where=count > 0)


def paired(returns: np.ndarray, others: np.ndarray) -> tuple[float, float]:
    """Mean difference on the same problems, and half the width of its 95 % interval.

    Args:
        returns, others: float64[E] by problem; those count that both have, and neither as NaN.
    """
    count = min(len(returns), len(others))
    apart = returns[:count] - others[:count]
    apart = apart[np.isfinite(apart)]
    return float(apart.mean()), _half_width([apart], apart[:1])


def _half_width(returns: list[np.ndarray], means: np.ndarray) -> float:
    """Half width of the 95 % interval of R."""
    sample, factor = (means, student(len(means))) if len(means) >= 2 else (returns[0], 1.96)
    count = len(sample)
    return factor * float(sample.std(ddof=1)) / math.sqrt(count) if count > 1 else 0.0


def student(count: int) -> float:
    """97.5 % point of Student's t for the mean of ``count`` values, as tables print it."""
    from scipy.special import stdtrit

    return round(float(stdtrit(count - 1, 0.975)), 3)


def _bounds(results: list[Result], root: Path) -> np.ndarray | None:
    """float64[A]: mean upper bound of the very problems that each agent played."""
    means = []
    for result in results:
        cell = Cell(result.cell.task, BOUND, seed=result.cell.seed)
        bound = read_result(root / cell.path) if has_bound(cell.task) else None
        end = result.first + result.episodes
        if bound is None or bound.cell != cell or bound.episodes < end:
            return None
        means.append(bound.array("returns")[result.first : end].mean())
    return np.array(means)


def below_paper(paper: Published | None, ours: Summary) -> bool:
    """R under the paper's 95 % interval."""
    if paper is None or paper.R is None or paper.R_ci95 is None:
        return False
    return paper.R - paper.R_ci95 > ours.R


def fails_more(paper: Published | None, ours: Summary) -> bool:
    """f above the paper's by more than the sampling error of both (95 %)."""
    return paper is not None and paper.f is not None and ours.f > paper.f + _error(paper.f, ours)


def _error(f: float, ours: Summary) -> float:
    variance = f * (1 - f) / EPISODES + ours.f * (1 - ours.f) / ours.episodes
    return 1.96 * math.sqrt(variance)


def compared(condition: Condition) -> bool:
    """Whether a condition is the one of the published numbers."""
    return condition.epsilon == PAPER_PROTOCOL.epsilon and condition.physics != "rigid"


DASH = "–"
LOW, HIGH = "▼", "▲"
"""R below the paper's interval; f above the paper's by more than sampling error."""
HARD = "†"
"""Where no agent that acts at random at times, without a search, is likely to be better."""
PAPER = "paper"


class Section(NamedTuple):
    """A block of the table, one task or all of them: a head of two lines, then rows of words."""

    title: str
    groups: list[tuple[str, int]]
    """Name and number of columns of each group of columns."""
    columns: list[str]
    rows: list[list[str]]
    kinds: list[str]
    """Kind of every row: ``method``, ``own`` or ``reference``."""


BRIEF = ("R", "f", "success", "of bound")
"""What fits into a terminal."""


class _Column(NamedTuple):
    group: str
    name: str
    text: Callable[[Entry], str]


def _section(title: str, columns: list[_Column], entries: list[Entry]) -> Section:
    groups = [(name, len(list(of))) for name, of in groupby(column.group for column in columns)]
    rows = [[column.text(entry) for column in columns] for entry in entries]
    kinds = [entry.row.kind for entry in entries]
    return Section(title, groups, [column.name for column in columns], rows, kinds)


def sections(data: TableData, brief: bool = False) -> list[Section]:
    """Everything that was measured, one section a task; ``brief``: the main numbers."""
    table, all_entries = data.table, [entry for line in data.entries for entry in line]
    paper = PAPER if brief else f"{PAPER}, {PAPER_PROTOCOL.label}"
    columns = [_Column("", "method", lambda entry: entry.row.name), _Column("", "agents", _agents)]
    columns += [
        _Column(paper, name, partial(_paper, name))
        for name in ("R", "a", "b", "f")
        if any(e.paper and getattr(e.paper, name) is not None for e in all_entries)
    ]
    for condition in table.conditions:
        ours = condition.label if brief else f"ours, {condition.label}"
        names = ["R", "− ours", "R'", "a", "b", "f", "success", "of bound"]
        absent = {
            "− ours": table.reference is None,
            "R'": table.other_discount is None,
            "of bound": condition != Condition(0.0),
        }
        columns += [
            _Column(ours, name, partial(_ours, condition, name))
            for name in names
            if not absent.get(name)
        ]
    if brief:
        columns = [column for column in columns if not column.group or column.name in BRIEF]
    shown = [
        [entry for entry in line if entry.row.played_in(n)]
        for n, line in enumerate(zip(*data.entries, strict=True))
    ]
    return [_section(entries[0].title, columns, entries) for entries in shown]


def compact(data: TableData) -> Section:
    """The main numbers of all tasks in one section: for a terminal and the README."""
    columns = [
        _Column("", "task", lambda entry: entry.title),
        _Column("", "method", lambda entry: entry.row.name),
        _Column(
            f"{PAPER}, {PAPER_PROTOCOL.label}",
            "R / f",
            lambda entry: (
                DASH if entry.paper is None else f"{_two(entry.paper.R)} / {_two(entry.paper.f)}"
            ),
        ),
    ]
    for condition in data.table.conditions:
        ours = f"ours, {condition.label}"
        columns.append(_Column(ours, "R / f / success", partial(_main, condition)))
        if condition == Condition(0.0):
            columns.append(_Column(ours, "of bound", partial(_ours, condition, "of bound")))
    entries = [
        entry
        for line in zip(*data.entries, strict=True)
        for entry in line
        if entry.results or entry.paper
    ]
    return _section(data.table.title, columns, entries)


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
    low, high = data.problems
    count = str(low) if low == high else f"{low} to {high}"
    out = [QUICK] if data.quick else []
    out += [
        "R: mean discounted return; a: actions an episode; b: share that ran out of blocks; f: "
        "share ended by an invalid action. *: the agents were trained on this task.",
        f"Ours: {count} problems, the same for every method, none used in training; of several "
        "agents each plays an equal share. ± is the 95 % interval of R: over agents (Student; with "
        "the bound of the problems of each taken off) and, in brackets, over problems; where a row "
        "has one agent, over problems (marked °). Paper: five agents, 100 episodes each.",
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
    against = [s for c in data.table.conditions if compared(c) for s in against_paper(data, c)]
    out += against
    if HARD in "".join(against):
        out.append(f"{HARD}: nor is the exact look-ahead, which knows all outcomes, better there.")
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


def against_paper(data: TableData, condition: Condition) -> list[str]:
    """Sentences on our own agents against the published numbers; none where there are none.

    Published rows without a search stand against our last one without, rows with a search against
    our last one with it, and rows of ours that have published numbers beside them against these.
    Of rows without a search it is also said where the exact look-ahead is not better either.
    """
    lacking: list[set[str]] = []
    missed: list[str] = []
    for line in zip(*data.entries, strict=True):
        best = next((entry for entry in line if entry.row.policy == LOOK_AHEAD), None)
        for entry in line:
            own = _opponent(line, entry, condition)
            if own is None or entry.paper is None or entry.paper.R is None:
                continue
            lacking.append(_lacking(entry.paper, own))
            hard = set[str]()
            if best is not None and condition in best.results and not entry.row.budget:
                hard = _lacking(entry.paper, best.results[condition])
            if lacking[-1]:
                names = (f"{name}{HARD * (name in hard)}" for name in sorted(lacking[-1]))
                missed.append(f"{entry.row.label} on {entry.column.name} ({', '.join(names)})")
    if not lacking:
        return []
    R, f, both = (
        sum(not found & names for found in lacking) for names in ({"R"}, {"f"}, {"R", "f"})
    )
    return [
        f"Ours against {len(lacking)} published numbers at {condition.label} (without a search, "
        f"and with one, our last row): R above by more than both intervals in {R}, f below by more "
        f"than the sampling error of both in {f}, both in {both}."
        + (f" Not so: {'; '.join(missed)}." if missed else "")
    ]


def _opponent(line: tuple[Entry, ...], entry: Entry, condition: Condition) -> Summary | None:
    """Of our agents in one column, what stands against a published number."""
    if entry.row.kind == OWN:
        return entry.results.get(condition)
    found = [
        other.results[condition]
        for other in line
        if other.row.help == MODEL_LABELS
        and condition in other.results
        and bool(other.row.budget) == bool(entry.row.budget)
    ]
    return found[-1] if found else None


def _lacking(paper: Published, ours: Summary) -> set[str]:
    """Which of R and f is not better than the published one by more than the intervals."""
    lacking = set[str]()
    if paper.R is None or ours.R - ours.R_ci95 <= paper.R + (paper.R_ci95 or 0):
        lacking.add("R")
    if paper.f is None or ours.f >= paper.f - _error(paper.f, ours):
        lacking.add("f")
    return lacking


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


def _agents(entry: Entry) -> str:
    counts = sorted({summary.agents for summary in entry.results.values()})
    return entry.state or (DASH if not entry.row.agents else "–".join(map(str, counts)))


def _paper(name: str, entry: Entry) -> str:
    paper = entry.paper
    more = f" ± {paper.R_ci95:.2f}" if paper and name == "R" and paper.R_ci95 is not None else ""
    return DASH if paper is None else f"{_two(getattr(paper, name))}{more}"


def _ours(condition: Condition, name: str, entry: Entry) -> str:
    ours = entry.results.get(condition)
    if ours is None:
        return DASH
    low, high = _marks(entry, condition, ours)
    return {
        "R": f"{_interval_text(ours)}{low}",
        "− ours": _difference(ours),
        "R'": _two(ours.R_other),
        "a": f"{ours.a:.2f}",
        "b": _two(ours.b),
        "f": f"{ours.f:.2f}{high}",
        "success": _two(ours.success),
        "of bound": DASH if ours.share is None else f"{100 * ours.share:.1f} %",
    }[name]


def _main(condition: Condition, entry: Entry) -> str:
    ours = entry.results.get(condition)
    if ours is None:
        return entry.state or DASH
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
