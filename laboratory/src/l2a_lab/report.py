"""From result files to the numbers of a table, and to its text; the same files give the same bytes.

The published numbers are in ``published.csv``, typed once from the paper.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from itertools import groupby
from typing import Any, NamedTuple

from l2a_lab.measured import table_lines
from l2a_lab.numbers import EPISODES, NOT_MEASURED, Published, Summary, TableData, TableEntry
from l2a_lab.table import HELPS, LOOK_AHEAD, MODEL_LABELS, OWN, PAPER_PROTOCOL, SEARCHED, Condition

BETTER, LEVEL, WORSE = "▲", "=", "▼"
"""Ours beside a published number: better or worse by more than the intervals, or neither."""
COLOURS = {BETTER: "🟢", LEVEL: "🟡", WORSE: "🔴"}
"""The same on a page."""


def return_beside(paper: Published | None, ours: Summary) -> str:
    """R beside the published one: better by more than both intervals, worse than the paper's
    interval, or level; empty where there is nothing to compare with."""
    if paper is None or paper.R is None:
        return ""
    width = paper.R_ci95 or 0.0
    if ours.R - ours.R_ci95 > paper.R + width:
        return BETTER
    return WORSE if paper.R_ci95 is not None and paper.R - width > ours.R else LEVEL


def failures_beside(paper: Published | None, ours: Summary) -> str:
    """f beside the published one, by more than the sampling error of both (95 %)."""
    if paper is None or paper.f is None:
        return ""
    variance = paper.f * (1 - paper.f) / EPISODES + ours.f * (1 - ours.f) / ours.episodes
    error = 1.96 * math.sqrt(variance)
    if ours.f < paper.f - error:
        return BETTER
    return WORSE if ours.f > paper.f + error else LEVEL


def compared(condition: Condition) -> bool:
    """Whether a condition is the one of the published numbers."""
    return condition.epsilon == PAPER_PROTOCOL.epsilon and condition.physics != "rigid"


DASH = "–"
HARD = "†"
"""Where no agent that acts at random at times, without a search, is likely to be better."""


class TableSection(NamedTuple):
    """One task under one condition: a head, then rows of words."""

    task: str
    """With a star where agents were trained on it."""
    condition: Condition
    columns: list[str]
    rows: list[list[str]]


_Text = Callable[[TableEntry], str]


def sections(data: TableData) -> list[TableSection]:
    """What was measured, one section a task and condition, of eight columns at most; everything
    else is in :func:`lines`."""
    out: list[TableSection] = []
    for number, line in enumerate(zip(*data.entries, strict=True)):
        entries = [entry for entry in line if entry.row.played_in(number)]
        for condition in data.table.conditions:
            played = [entry for entry in entries if entry.row.played_at(condition)]
            columns = _columns(data, condition, played)
            rows = [[text(entry) for text in columns.values()] for entry in played]
            out.append(TableSection(entries[0].title, condition, list(columns), rows))
    return out


def _columns(
    data: TableData, condition: Condition, entries: Sequence[TableEntry]
) -> dict[str, _Text]:
    """Names of columns, and what stands in each."""
    columns: dict[str, _Text] = {
        "method": lambda entry: entry.row.name,
        "agents": partial(_agents, condition),
    }
    beside = compared(condition) and any(entry.paper for entry in entries)
    if beside:
        columns["R, paper"] = partial(_paper, "R")
    columns["R"] = partial(_return, condition)
    if data.table.reference is not None:
        columns["R − ours"] = partial(_ours, condition, "difference")
    if beside:
        columns["f, paper"] = partial(_paper, "f")
    columns["f"] = partial(_failures, condition)
    columns["success"] = partial(_ours, condition, "success")
    if condition == Condition(0.0):
        columns["of bound"] = partial(_ours, condition, "share")
    return columns


def markdown(data: TableData) -> str:
    """The table as a chapter of a page: a condition is shown when a reader opens it, that of
    the published numbers from the beginning."""
    out = [f"## {data.table.name}: {data.table.title}", ""]
    if data.quick:
        out += [f"**{QUICK}**", ""]
    for task, group in groupby(sections(data), key=lambda section: section.task):
        out += [f"### {data.table.name}, {_escape(task)}", ""]
        for number, section in enumerate(group):
            shown = " open" if number == 0 else ""
            words = f"<summary>{section.condition.label}</summary>"
            out += [f'<details markdown="1"{shown}>{words}', "", *_markdown_rows(section), ""]
            out += ["</details>", ""]
    return "\n".join([*out, *[f"* {_escape(note)}" for note in notes(data)], ""])


FIGURES = (
    *("table", "task", "trained_on_it", "method", "epsilon", "physics", "state"),
    *("agents", "problems", "paper_R", "paper_R_ci95", "paper_a", "paper_b", "paper_f"),
    *("R", "R_ci95", "R_ci95_problems", "difference", "difference_ci95", "R_other_discount"),
    *("a", "b", "f", "success", "of_bound"),
)
"""Columns of :func:`lines`: names of rows and conditions as in :mod:`.table`, numbers as in
:class:`.numbers.Summary` and :class:`.numbers.Published`."""


def lines(data: TableData) -> list[list[str]]:
    """All figures of a table, one line a task, method and condition, as words in the order of
    :data:`FIGURES`; empty where there is none."""
    out: list[list[str]] = []
    for number, line in enumerate(zip(*data.entries, strict=True)):
        for entry in (entry for entry in line if entry.row.played_in(number)):
            for condition in filter(entry.row.played_at, data.table.conditions):
                out.append([_written(value) for value in _figures(data, entry, condition)])
    return out


def _figures(data: TableData, entry: TableEntry, condition: Condition) -> list[Any]:
    paper = entry.paper if compared(condition) else None
    ours = entry.results.get(condition)
    state = "measured" if ours else entry.state or NOT_MEASURED
    told = [data.table.name, entry.column.name, entry.column.star, entry.row.name]
    told += [condition.epsilon, condition.physics, state]
    published = [None] * 5 if paper is None else [paper.R, paper.R_ci95, paper.a, paper.b, paper.f]
    if ours is None:
        return [*told, None, None, *published, *[None] * 11]
    difference = ours.difference or (None, None)
    spread = [ours.R, ours.R_ci95, ours.R_ci95_problems, *difference, ours.R_other]
    shares = [ours.a, ours.b, ours.f, ours.success, ours.share]
    agents = ours.agents if entry.row.agents else None
    return [*told, agents, ours.problems, *published, *spread, *shares]


def _written(value: Any) -> str:
    if value is None:
        return ""
    return f"{value:.6g}" if isinstance(value, float) else str(value)


QUICK = "A quick look: one agent and few episodes a cell. Not the numbers of record."


def notes(data: TableData) -> list[str]:
    """What has to be known to read the numbers."""
    shown = sections(data)
    low, high = data.problems
    count = str(low) if low == high else f"{low} to {high}"
    out = [QUICK] if data.quick else []
    out += [
        "R: mean discounted return; f: share of episodes ended by an invalid action. *: the agents "
        "were trained on this task.",
        f"Ours: {count} problems, the same for every method, none used in training; of several "
        "agents each plays an equal share. ± is the 95 % interval of R: over agents (Student; with "
        "the bound of the problems of each taken off) and, in brackets, over problems; where a row "
        "has one agent, over problems (marked °). Paper: five agents, 100 episodes each.",
    ]
    if any("%" in cell for section in shown for row in section.rows for cell in row):
        out.append(
            "of bound: mean return as a share of the mean upper bound on the return of the same "
            "problems (exact for cubes on one or two sides; for objects a packing bound that knows "
            "neither balance nor support)."
        )
    if data.table.reference is not None:
        name = data.table.rows[data.table.reference].name
        out.append(
            f'R − ours: R less that of "{name}" on the same problems, ± the 95 % interval of the '
            "paired differences."
        )
    against = [s for c in data.table.conditions if compared(c) for s in against_paper(data, c)]
    out += against
    if HARD in "".join(against):
        out.append(f"{HARD}: nor is the exact look-ahead, which knows all outcomes, better there.")
    if any("paper" in name for section in shown for name in section.columns):
        out.append(
            f"{BETTER} better than the paper: R by more than both intervals, f by more than the "
            f"sampling error of both; {WORSE} worse: R below the paper's interval, f by more than "
            f"the sampling error of both; {LEVEL} neither."
        )
    if any(row.distinct for row in data.table.rows):
        out.append(
            "distinct: the search expands one of several placements that lead to the same "
            "structure (deviation D14)."
        )
    if SEARCHED in data.table.conditions:
        out.append(f"{SEARCHED.label}: agents play with a search alone.")
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
            own, paper = _opponent(line, entry, condition), entry.paper
            if own is None or paper is None or paper.R is None:
                continue
            lacking.append(_lacking(paper, own))
            hard = set[str]()
            if best is not None and condition in best.results and not entry.row.budget:
                hard = _lacking(paper, best.results[condition])
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
    found = {"R": return_beside(paper, ours), "f": failures_beside(paper, ours)}
    return {name for name, word in found.items() if word != BETTER}


def _markdown_rows(section: TableSection) -> list[str]:
    rows = [[_coloured(_escape(cell)) for cell in row] for row in section.rows]
    return table_lines(section.columns, rows)


def _coloured(text: str) -> str:
    """With the mark at the end of a cell, if there is one, in its colour."""
    return text[:-1] + COLOURS[text[-1]] if text[-2:-1] == " " and text[-1] in COLOURS else text


def _escape(text: str) -> str:
    """For markdown, where a star is emphasis and a bar ends a cell."""
    return text.replace("*", "\\*").replace("|", "\\|")


def _agents(condition: Condition, entry: TableEntry) -> str:
    ours = entry.results.get(condition)
    return entry.state or (DASH if not entry.row.agents or ours is None else str(ours.agents))


def _paper(name: str, entry: TableEntry) -> str:
    paper = entry.paper
    more = f" ± {paper.R_ci95:.2f}" if paper and name == "R" and paper.R_ci95 is not None else ""
    return DASH if paper is None else f"{_two(getattr(paper, name))}{more}"


def _return(condition: Condition, entry: TableEntry) -> str:
    ours = entry.results.get(condition)
    if ours is None:
        return DASH
    more = f" ({ours.R_ci95_problems:.2f})" if ours.over_agents else "°"
    mark = return_beside(entry.paper, ours) if compared(condition) else ""
    return f"{ours.R:.2f} ± {ours.R_ci95:.2f}{more} {mark}".rstrip()


def _failures(condition: Condition, entry: TableEntry) -> str:
    ours = entry.results.get(condition)
    if ours is None:
        return DASH
    mark = failures_beside(entry.paper, ours) if compared(condition) else ""
    return f"{ours.f:.2f} {mark}".rstrip()


def _ours(condition: Condition, name: str, entry: TableEntry) -> str:
    ours = entry.results.get(condition)
    value = None if ours is None else getattr(ours, name)
    if value is None:
        return DASH
    if name == "difference":
        return "{:+.2f} ± {:.2f}".format(*value)
    return f"{100 * value:.1f} %" if name == "share" else _two(value)


def _two(value: float | None) -> str:
    return DASH if value is None else f"{value:.2f}"


def losses_told(rows: TableData, anywhere: TableData) -> list[str]:
    """What R of every row without a search loses from blocks that wait in rows to blocks that wait
    anywhere, as lines of a Markdown table; a dash where one of both was not measured.

    Args:
        rows, anywhere: two tables with the same rows, and columns in the same order.
    """
    conditions = [one for one in rows.table.conditions if compared(one)]
    head = ["method", *(column.task for column in rows.table.columns)]
    lines: list[list[str]] = []
    for near, far in zip(rows.entries, anywhere.entries, strict=True):
        if near[0].row.budget:
            continue
        told = list[str]()
        for one, other in zip(near, far, strict=True):
            pairs = [(one.results.get(c), other.results.get(c)) for c in conditions]
            lost = [_two(a.R - b.R if a and b else None) for a, b in pairs]
            told.append(" / ".join(lost))
        lines.append([near[0].row.name, *told])
    return table_lines(head, lines)
