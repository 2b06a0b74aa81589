"""The numbers of a table as words: sections for a page or a picture, and markdown.

Byte-stable: the same result files give the same text.
"""

from __future__ import annotations

from typing import NamedTuple

from learn2assemble.evaluation.published import Published
from learn2assemble.evaluation.table_report import (
    Entry,
    Summary,
    TableData,
    below_paper,
    compared,
    fails_more,
)
from learn2assemble.evaluation.table_spec import AGENT, HELPS, PAPER_PROTOCOL, Condition

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
            agents = _agents(entry) if row.policy == AGENT or entry.state else DASH
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
        f"Ours: {count} episodes an agent, evaluation problems never used in training. ± is the "
        "95 % interval of R: over agents (Student) where a row has at least two, over episodes "
        "(marked °) where it has one. Paper: five agents, 100 episodes each.",
    ]
    if "%" in text:
        out.append(
            "of bound: mean return as a share of the mean upper bound on the return of the same "
            "problems (exact for cubes on one or two sides; for objects a packing bound that knows "
            "neither balance nor support)."
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
    names = ["R", *other, "a", "b", "f", "success", *bound]
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
        "R": f"{_interval(ours)}{low}", "R'": _two(ours.R_other), "a": f"{ours.a:.2f}",
        "b": _two(ours.b), "f": f"{ours.f:.2f}{high}", "success": _two(ours.success),
        "of bound": _percent(ours.share),
    }  # fmt: skip
    return [words[name] for name in names]


def _main(entry: Entry, condition: Condition, ours: Summary) -> str:
    low, high = _marks(entry, condition, ours)
    return f"{_interval(ours)}{low} / {ours.f:.2f}{high} / {ours.success:.2f}"


def _marks(entry: Entry, condition: Condition, ours: Summary) -> tuple[str, str]:
    if not compared(condition):
        return "", ""
    low = f" {LOW}" if below_paper(entry.paper, ours) else ""
    return low, f" {HIGH}" if fails_more(entry.paper, ours) else ""


def _interval(ours: Summary) -> str:
    return f"{ours.R:.2f} ± {ours.R_ci95:.2f}{'' if ours.over_agents else '°'}"


def _two(value: float | None) -> str:
    return DASH if value is None else f"{value:.2f}"


def _percent(value: float | None) -> str:
    return DASH if value is None else f"{100 * value:.1f} %"
