"""``l2a table``: the paper's numbers beside ours."""

from __future__ import annotations

import argparse
import dataclasses
import os
from pathlib import Path
from typing import Any

from tqdm import tqdm

from learn2assemble.cli.output import Output
from learn2assemble.errors import InputError
from learn2assemble.reproduction.cells import Job, find_agents, jobs, run_jobs, stale
from learn2assemble.reproduction.pictures import Block, write_table
from learn2assemble.reproduction.recipes import copy_logs, get_recipe, train_recipes
from learn2assemble.reproduction.report import (
    QUICK,
    TableData,
    compact_markdown,
    headings,
    load_table,
    markdown,
    notes,
    sections,
)
from learn2assemble.reproduction.tables import Table, get_table

EPISODES, QUICK_EPISODES = 100, 50


def run(options: argparse.Namespace) -> int:
    output = Output(options.json)
    table = get_table(options.name)
    page: Path | None = options.into
    before = "" if page is None else _page(page, table)
    root: Path = options.out / "quick" if options.quick else options.out
    agents = {} if options.train or options.from_files else find_agents(options.agents)
    _prepare(root)
    if options.quick:
        output.progress(QUICK)
    if options.train:
        _train(table, root, options, output)
        agents = find_agents(options.runs)
    todo: list[Job] = []
    if not options.from_files:
        wanted = jobs(table, agents, *_extent(options))
        todo = stale(root, wanted)
        output.progress(f"{len(wanted)} cells, {len(todo)} to measure")
        _measure(root, todo, options)
    data = load_table(table, root, options.quick)
    files = _write(data, root)
    if page is not None:
        page.write_text(_insert(before, table, compact_markdown(data)), encoding="utf-8")
        files["page"] = page
    _print(output, data, files)
    output.finish(_summary(data, len(todo), files))
    return 0


def _extent(options: argparse.Namespace) -> tuple[int, int | None]:
    """Episodes a cell and agents a row."""
    if options.quick:
        return options.episodes or QUICK_EPISODES, 1
    return options.episodes or EPISODES, None


def _prepare(root: Path) -> None:
    """Make the folder of results, before hours of episodes."""
    try:
        root.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        reason = error.strerror or "unwritable"
        raise InputError("--out", str(root), f"a writable folder ({reason})") from None


def _train(table: Table, root: Path, options: argparse.Namespace, output: Output) -> None:
    recipes = [get_recipe(name) for name in table.trainings]
    seeds = 1 if options.quick else None
    train_recipes(
        recipes, options.runs, seeds=seeds, workers=_workers(options), progress=output.progress
    )
    copy_logs(recipes, options.runs, root / "runs")


def _workers(options: argparse.Namespace) -> int:
    return options.workers or os.cpu_count() or 1


def _measure(root: Path, todo: list[Job], options: argparse.Namespace) -> None:
    if not todo:
        return
    total = round(sum(job.cost for job in todo))
    with tqdm(total=total, desc=options.name, unit="", unit_scale=True, dynamic_ncols=True,
              bar_format="{desc} {percentage:3.0f}% |{bar}| {elapsed}<{remaining} {postfix}",
              ) as bar:  # fmt: skip
        done = 0

        def advance(job: Job) -> None:
            nonlocal done
            done += 1
            bar.set_postfix_str(f"{done}/{len(todo)} cells, last: {job.cell.path[6:]}")
            bar.update(round(job.cost))

        run_jobs(root, todo, _workers(options), advance)


def _write(data: TableData, root: Path) -> dict[str, Path]:
    folder = root / "tables"
    text, picture = folder / f"{data.table.name}.md", folder / f"{data.table.name}.png"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        text.write_text(markdown(data), encoding="utf-8")
    except OSError as error:
        reason = error.strerror or "unwritable"
        raise InputError("--out", str(root), f"a writable folder ({reason})") from None
    title = f"{data.table.name}  {data.table.title}{'  (quick look)' if data.quick else ''}"
    write_table(title, [Block(*section) for section in sections(data)], notes(data), picture)
    return {"markdown": text, "picture": picture}


def _print(output: Output, data: TableData, files: dict[str, Path]) -> None:
    output.say(f"{data.table.name}: {data.table.title}")
    for section in sections(data, brief=True):
        output.say("")
        output.table(section.title, headings(section, "\n"), section.rows)
    output.say("")
    for note in notes(data):
        output.say(note)
    if data.left_out:
        output.say(f"not measured yet: {len(data.left_out)} cells")
    for path in files.values():
        output.say(str(path))


def _summary(data: TableData, measured: int, files: dict[str, Path]) -> dict[str, Any]:
    rows = []
    for row, entries in zip(data.table.rows, data.entries, strict=True):
        for column, entry in zip(data.table.columns, entries, strict=True):
            rows.append({
                "task": column.name, "method": row.name, "state": entry.state or "measured",
                "paper": entry.paper and dataclasses.asdict(entry.paper),
                "ours": [
                    {**dataclasses.asdict(condition), **dataclasses.asdict(summary)}
                    for condition, summary in entry.results.items()
                ],
            })  # fmt: skip
    return {
        "table": data.table.name, "quick": data.quick, "measured": measured, "rows": rows,
        "files": {name: str(path) for name, path in files.items()},
    }  # fmt: skip


def markers(table: Table) -> tuple[str, str]:
    """The lines between which a page carries a table."""
    return f"<!-- table {table.name}: begin -->", f"<!-- table {table.name}: end -->"


def _page(path: Path, table: Table) -> str:
    begin, end = markers(table)
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, ValueError):
        raise InputError("--into", str(path), "an existing text file") from None
    if text.count(begin) != 1 or end not in text.partition(begin)[2]:
        raise InputError("--into", str(path), f"a file with the lines {begin} and {end}")
    return text


def _insert(page: str, table: Table, text: str) -> str:
    begin, end = markers(table)
    head, _, rest = page.partition(begin)
    return f"{head}{begin}\n{text}\n{end}{rest.partition(end)[2]}"
