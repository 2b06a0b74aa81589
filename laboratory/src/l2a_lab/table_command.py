"""The command that measures a table of the paper, and prints it beside the paper's numbers."""

from __future__ import annotations

import argparse
import dataclasses
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from learn2assemble.cli.parser import (
    Command,
    arg,
    at_most_one,
    command,
    count,
    named,
    workers_arguments,
)
from learn2assemble.files import make_folder

if TYPE_CHECKING:
    from l2a_lab.cell_jobs import CellJob
    from l2a_lab.numbers import TableData
    from learn2assemble.cli.output import Output


QUICK_EPISODES = 50


COMMANDS: dict[str, Command] = {}


def _name(parser: argparse.ArgumentParser) -> None:
    from l2a_lab.tables import TABLES

    parser.add_argument("name", metavar="NAME", help=", ".join(TABLES))


@command(
    COMMANDS,
    "table",
    "measure a table of the paper and print it beside the paper's numbers",
    "l2a-lab table T2",
    _name,
    arg("--out", type=named, default=Path("results"), help="folder of the results"),
    arg(
        "--episodes",
        type=count,
        default=None,
        help="problems of a cell, in place of 1000 (200 and 100 with an arm)",
    ),
    lambda parser: workers_arguments(parser, "processes (all cores)"),
    arg(
        "--quick",
        action="store_true",
        help="one agent a row and 50 episodes, into the folder quick below --out",
    ),
    at_most_one(
        arg("--agents", type=named, default=None, help="folder of agents or runs (shipped ones)"),
        arg("--train", action="store_true", help="first train all its agents in --runs, or go on"),
        arg("--from-files", action="store_true", help="measure nothing: print what --out holds"),
    ),
    arg("--runs", type=named, default=Path("runs"), help="folder of --train"),
)
def _run_table(options: argparse.Namespace, output: Output) -> None:
    from l2a_lab import cell_jobs, report
    from l2a_lab.cells import find_agents
    from l2a_lab.numbers import load_table
    from l2a_lab.tables import get_table
    from l2a_lab.tables_page import put_table, read_tables

    table = get_table(options.name)
    root: Path = options.out / "quick" if options.quick else options.out
    workers: int = options.workers or os.cpu_count() or 1
    most = 1 if options.quick else None
    agents = {} if options.train or options.from_files else find_agents(options.agents)
    make_folder(root, "--out")  # Before hours of work.
    read_tables(root)  # What cannot be written is told before hours of work.
    if options.quick:
        output.progress(report.QUICK)
    if options.train:
        from l2a_lab.recipes import RECIPES, keep_logs, train_recipes
        from l2a_lab.runs import RUNS

        wanted = [RECIPES[name] for name in table.stems if name in RECIPES]
        train_recipes(
            wanted,
            options.runs,
            seeds=most,
            workers=workers,
            ray=options.ray,
            progress=output.progress,
        )
        keep_logs(wanted, options.runs, root / RUNS.name)
        agents = find_agents(options.runs)
    todo: list[CellJob] = []
    if not options.from_files:
        episodes = options.episodes or (QUICK_EPISODES if options.quick else None)
        jobs = cell_jobs.jobs(table, agents, episodes, most)
        todo = cell_jobs.stale(root, jobs)
        output.progress(f"{len(jobs)} cells, {len(todo)} to measure{_words(todo, workers)}")
        _measure(root, todo, options.name, workers, options.ray)
    data = load_table(table, root, options.quick)
    files = put_table(data, root)
    _print(output, data, files)
    output.finish(_summary(data, len(todo), files))


def _words(todo: list[CellJob], workers: int) -> str:
    """What is about to be measured, and how long that takes."""
    if not todo:
        return ""
    episodes, tasks = sum(job.episodes for job in todo), {job.cell.task.name for job in todo}
    hours = sum(job.seconds for job in todo) / workers / 3600
    long = f"{hours:.1f} hours" if hours >= 1 else f"{max(60 * hours, 1):.0f} minutes"
    return (
        f": {episodes} episodes on {len(tasks)} tasks, roughly {long} with {workers} processes; "
        "--quick measures less, --from-files nothing"
    )


def _measure(root: Path, todo: list[CellJob], name: str, workers: int, ray: str | None) -> None:
    from tqdm import tqdm

    from l2a_lab.cell_jobs import run_jobs
    from l2a_lab.packed import pack

    if not todo:
        return
    total = sum(job.seconds for job in todo)
    with tqdm(
        total=total,
        desc=name,
        unit="",
        unit_scale=True,
        dynamic_ncols=True,
        bar_format="{desc} {percentage:3.0f}% |{bar}| {elapsed}<{remaining} {postfix}",
    ) as bar:
        done = 0

        def advance(job: CellJob) -> None:
            nonlocal done
            done += 1
            bar.set_postfix_str(f"{done}/{len(todo)} cells, last: {job.cell.path[6:]}")
            bar.update(job.seconds)

        run_jobs(root, todo, workers, advance, ray)
    pack(root / "cells")


def _print(output: Output, data: TableData, files: dict[str, Path]) -> None:
    from l2a_lab import report

    output.say(f"{data.table.name}: {data.table.title}")
    first, *others = data.table.conditions
    for section in report.sections(data):
        if section.condition == first:
            output.say("")
            output.table(f"{section.task}, {first.label}", section.columns, section.rows)
    output.say("")
    for note in report.notes(data):
        output.say(note)
    if data.left_out:
        output.say(f"not measured yet: {len(data.left_out)} cells")
    if others:
        output.say(f"the same at {', '.join(one.label for one in others)}: {files['markdown']}")
    for path in files.values():
        output.say(str(path))


def _summary(data: TableData, measured: int, files: dict[str, Path]) -> dict[str, Any]:
    rows = [
        {
            "task": entry.column.name,
            "method": entry.row.name,
            "state": entry.state or "measured",
            "paper": entry.paper and dataclasses.asdict(entry.paper),
            "ours": [
                {**dataclasses.asdict(condition), **dataclasses.asdict(summary)}
                for condition, summary in entry.results.items()
            ],
        }
        for line in data.entries
        for entry in line
    ]
    return {
        "table": data.table.name,
        "quick": data.quick,
        "measured": measured,
        "rows": rows,
        "files": {name: str(path) for name, path in files.items()},
    }
