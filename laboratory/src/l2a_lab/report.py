"""From result files to the numbers of a table, and to its text; the same files give the same bytes.

The published numbers are in ``published.csv``, typed once from the paper.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from itertools import groupby
from typing import NamedTuple

from l2a_lab.numbers import EPISODES, Published, Summary, TableData, TableEntry
from l2a_lab.table import HELPS, LOOK_AHEAD, MODEL_LABELS, OWN, PAPER_PROTOCOL, Condition


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


class TableSection(NamedTuple):
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


class _ShownColumn(NamedTuple):
    group: str
    name: str
    text: Callable[[TableEntry], str]


def _section(title: str, columns: list[_ShownColumn], entries: list[TableEntry]) -> TableSection:
    groups = [(name, len(list(of))) for name, of in groupby(column.group for column in columns)]
    rows = [[column.text(entry) for column in columns] for entry in entries]
    kinds = [entry.row.kind for entry in entries]
    return TableSection(title, groups, [column.name for column in columns], rows, kinds)


def sections(data: TableData, brief: bool = False) -> list[TableSection]:
    """Everything that was measured, one section a task; ``brief``: the main numbers."""
    table, all_entries = data.table, [entry for line in data.entries for entry in line]
    paper = PAPER if brief else f"{PAPER}, {PAPER_PROTOCOL.label}"
    columns = [
        _ShownColumn("", "method", lambda entry: entry.row.name),
        _ShownColumn("", "agents", _agents),
    ]
    columns += [
        _ShownColumn(paper, name, partial(_paper, name))
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
            _ShownColumn(ours, name, partial(_ours, condition, name))
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


def compact(data: TableData) -> TableSection:
    """The main numbers of all tasks in one section: for a terminal and the README."""
    columns = [
        _ShownColumn("", "task", lambda entry: entry.title),
        _ShownColumn("", "method", lambda entry: entry.row.name),
        _ShownColumn(
            f"{PAPER}, {PAPER_PROTOCOL.label}",
            "R / f",
            lambda entry: (
                DASH if entry.paper is None else f"{_two(entry.paper.R)} / {_two(entry.paper.f)}"
            ),
        ),
    ]
    for condition in data.table.conditions:
        ours = f"ours, {condition.label}"
        columns.append(_ShownColumn(ours, "R / f / success", partial(_main, condition)))
        if condition == Condition(0.0):
            columns.append(_ShownColumn(ours, "of bound", partial(_ours, condition, "of bound")))
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


def _opponent(
    line: tuple[TableEntry, ...], entry: TableEntry, condition: Condition
) -> Summary | None:
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


def headings(section: TableSection, between: str) -> list[str]:
    """Group and name of every column in one."""
    groups = [name for name, width in section.groups for _ in range(width)]
    pairs = zip(groups, section.columns, strict=True)
    return [f"{group}{between}{column}" if group else column for group, column in pairs]


def _markdown_rows(section: TableSection) -> list[str]:
    heads = headings(section, ": ")
    left = 2 if heads[0] == "task" else 1
    rule = ["---"] * left + ["---:"] * (len(heads) - left)
    rows = [[_escape(cell) for cell in row] for row in section.rows]
    return [f"| {' | '.join(line)} |" for line in (heads, rule, *rows)]


def _escape(text: str) -> str:
    """For markdown, where a star is emphasis and a bar ends a cell."""
    return text.replace("*", "\\*").replace("|", "\\|")


def _agents(entry: TableEntry) -> str:
    counts = sorted({summary.agents for summary in entry.results.values()})
    return entry.state or (DASH if not entry.row.agents else "–".join(map(str, counts)))


def _paper(name: str, entry: TableEntry) -> str:
    paper = entry.paper
    more = f" ± {paper.R_ci95:.2f}" if paper and name == "R" and paper.R_ci95 is not None else ""
    return DASH if paper is None else f"{_two(getattr(paper, name))}{more}"


def _ours(condition: Condition, name: str, entry: TableEntry) -> str:
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


def _main(condition: Condition, entry: TableEntry) -> str:
    ours = entry.results.get(condition)
    if ours is None:
        return entry.state or DASH
    low, high = _marks(entry, condition, ours)
    return f"{_interval_text(ours)}{low} / {ours.f:.2f}{high} / {ours.success:.2f}"


def _marks(entry: TableEntry, condition: Condition, ours: Summary) -> tuple[str, str]:
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
