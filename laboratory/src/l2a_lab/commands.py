"""Commands that reproduce the paper: its tables and curves, recordings, the arm's fidelities."""

from __future__ import annotations

import argparse
import dataclasses
import importlib
import math
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

from l2a_lab import runs, table_command
from l2a_lab.builder import commands as builders
from l2a_lab.runs import RUNS
from learn2assemble.cli.output import write_result
from learn2assemble.cli.parser import (
    Command,
    arg,
    arm_argument,
    command,
    count,
    named,
    natural,
)
from learn2assemble.errors import InputError, check_name
from learn2assemble.files import check_exists, check_new, make_folder
from learn2assemble.registry import Registry

if TYPE_CHECKING:
    from learn2assemble.cli.output import Output
    from learn2assemble.tasks.evaluation.fidelities import Comparison


COMMANDS: dict[str, Command] = {}
PICTURES = Path("results/curves")
"""Where curves are drawn, and drawn anew; in another folder they are new files."""


def register_laboratory_command(commands: Registry[Command]) -> None:
    """Add the commands of the laboratory; all of them play or judge what was learned."""
    for table in (COMMANDS, table_command.COMMANDS, runs.COMMANDS, builders.COMMANDS):
        for name, one in table.items():
            commands.register(name, dataclasses.replace(one, learns=True))


# ---------------------------------------------------------------- curves


def _run_scaling(options: argparse.Namespace, output: Output) -> None:
    from l2a_lab import curves
    from l2a_lab.drawing import write_curves
    from l2a_lab.measured import measure

    make_folder(options.out, "--out")
    path: Path = options.out / f"{curves.SIZES}.png"
    check_new(path, "--out", overwrite=options.out == PICTURES or None)
    found = measure(curves.TIMES, options.out / "decisions.json", progress=output.say)
    rows = curves.load_scaled(options.out.parent, found["entries"])
    write_curves(
        "Targets larger than those of training (DQN: 3x3, ours: 5x5)",
        rows,
        f"ε = 0. Decisions: of one core, worlds a third built, {curves.TIMED_WORLDS} at a time.",
        path,
        curves.SCALING,
        "grid",
    )
    output.table(
        "targets by size",
        ("row", "grid", *curves.SCALING),
        [
            (r.label, int(grid), *[float(r.mean[key][n]) for key in curves.SCALING])
            for r in rows
            for n, grid in enumerate(r.samples)
            if math.isfinite(r.mean["f"][n])
        ],
    )
    output.say(str(path))
    output.finish({"figure": curves.SIZES, "picture": str(path), "rows": [r.label for r in rows]})


@command(
    COMMANDS,
    "curves",
    "draw learning curves",
    "l2a-lab curves algorithms",
    arg(
        "name",
        metavar="NAME",
        help="architectures, connectivity, algorithms, or robot-two-sided, robot-four-sided, "
        "robot-objects, robot-one-sided; scaling: over the size of targets, decision times are "
        "measured where missing",
    ),
    arg("--runs", type=named, default=RUNS, help="file with logs of runs"),
    arg("--out", type=named, default=PICTURES, help="folder"),
)
def _run_curves(options: argparse.Namespace, output: Output) -> None:
    from l2a_lab.curves import FIGURES, SIZES, load_curves, time_to
    from l2a_lab.drawing import write_curves

    if options.name == SIZES:
        return _run_scaling(options, output)
    check_name("figure", options.name, [*FIGURES, SIZES])
    figure = FIGURES[options.name]
    curves = load_curves(figure, options.runs)
    reached = time_to(figure, options.runs)
    path: Path = options.out / f"{figure.name}.png"
    make_folder(options.out, "--out")
    check_new(path, "--out", overwrite=options.out == PICTURES or None)
    note = (
        "Training episodes, exploration included; mean over agents, band from the lowest to the "
        "highest, smoothed. " + figure.note
    ).strip()
    write_curves(figure.title, curves, note, path)
    output.table(
        figure.title,
        ("line", "agents", "samples", "R", "f", "success"),
        [
            (
                c.label,
                c.seeds,
                int(c.samples[-1]),
                *[float(c.mean[q][-1]) for q in ("R", "f", "success")],
            )
            for c in curves
        ],
    )
    output.table(
        "first reached, quartiles over agents",
        (
            "line",
            "R",
            "agents",
            "reached",
            "samples: 25 %",
            "50 %",
            "75 %",
            "minutes: 25 %",
            "50 %",
            "75 %",
        ),
        [
            (
                r.label,
                r.level,
                r.seeds,
                r.reached,
                *[_known(n) for n in r.samples],
                *[_known(n, 60) for n in r.seconds],
            )
            for r in reached
        ],
    )
    absent = sorted({label for label, _ in figure.lines} - {c.label for c in curves})
    if absent:
        output.say(f"no runs of {', '.join(absent)}")
    output.say(str(path))
    output.finish(
        {
            "figure": figure.name,
            "picture": str(path),
            "absent": absent,
            "lines": [{"label": c.label, "seeds": c.seeds} for c in curves],
            "reached": [
                {
                    **r._asdict(),
                    **{
                        key: [n if math.isfinite(n) else None for n in getattr(r, key)]
                        for key in ("samples", "seconds")
                    },
                }
                for r in reached
            ],
        }
    )


def _known(number: float, unit: float = 1) -> str:
    return f"{number / unit:,.0f}" if math.isfinite(number) else "never"


# ---------------------------------------------------------------- replay

REPLAY_COLUMNS = (
    "file",
    "lines",
    "mask_exact",
    "plane_exact",
    "complete_exact",
    "max_px_diff",
    "valid_static",
    "valid_rigid",
    "edge_lines",
    "valid_static_firm",
    "valid_rigid_firm",
    "reward",
    "done",
)
ARM_COLUMNS = ("file", "cell", "lines", "agree", "same_class", "rule")


@command(
    COMMANDS,
    "replay",
    "repeat recorded transitions and report the agreement",
    "l2a-lab replay tests/data/transitions_sample.jsonl",
    arg("files", metavar="FILE", nargs="+", type=named),
)
def _run_replay(options: argparse.Namespace, output: Output) -> None:
    from l2a_lab.recordings import read_lines
    from l2a_lab.replay import is_robot_line, replay_file, replay_robot_file
    from learn2assemble.tasks.physics.rigid import RigidPhysics

    reports, robots = list[dict[str, Any]](), list[dict[str, Any]]()
    for path in options.files:
        output.progress(f"replaying {path.name}")
        reports.append(replay_file(path, RigidPhysics).to_dict())
        if any(map(is_robot_line, read_lines(path))):
            robots.append(replay_robot_file(path).to_dict())
    output.table(
        "agreement with recorded transitions",
        REPLAY_COLUMNS,
        [[report[column] for column in REPLAY_COLUMNS] for report in reports],
    )
    if robots:
        output.table(
            "agreement of the arm on success or failure",
            ARM_COLUMNS,
            [[report[column] for column in ARM_COLUMNS] for report in robots],
        )
    output.finish({"files": reports, "robot": robots})


# ---------------------------------------------------------------- fidelities

FIDELITY_COLUMNS = (
    "task",
    "arm",
    "actions",
    "agree",
    "same outcome",
    "kinematic [ms]",
    "dynamic [ms]",
    "times faster",
)


@command(
    COMMANDS,
    "fidelities",
    "the kinematic workcell of an arm against the dynamic one",
    "l2a-lab fidelities robot-two-sided-3x3-10-14 robot-four-sided-3x3-10-18 --actions 250",
    arg("tasks", metavar="TASK", nargs="+"),
    arg("--actions", type=count, default=100, help="moves of every task"),
    arg("--agent", default=None, help="who builds what the moves are drawn from"),
    arm_argument,
    arg("--seed", type=natural, default=0),
    arg("--out", type=named, default=None, help="new file for the result"),
)
def _run_fidelities(options: argparse.Namespace, output: Output) -> None:
    from learn2assemble.tasks.evaluation.fidelities import compare
    from learn2assemble.tasks.networks.agent import default_agent, load_agent, one_thread
    from learn2assemble.tasks.task import get_task

    tasks = [get_task(name, options.arm) for name in options.tasks]
    for task in tasks:
        if not task.has_arm:
            raise InputError("task", task.name, "tasks with an arm")
    if options.out is not None:
        check_new(options.out, "--out")
    found: list[Comparison] = []
    for task in tasks:
        agent = load_agent(options.agent or default_agent(task.name))
        output.progress(f"{task.name}: {options.actions} moves in both cells")

        def progress(done: int) -> None:
            if done % 50 == 0:
                output.progress(f"{done} of {options.actions}")

        with one_thread():
            found.append(compare(task, agent, options.actions, options.seed, progress))
    result = {"fidelities": [one.to_dict() for one in found]}
    output.table(
        "the same moves in both cells",
        FIDELITY_COLUMNS,
        [
            (
                one["task"],
                one["arm"],
                one["actions"],
                f"{one['share']:.1%}",
                one["same_outcome"],
                one["kinematic_ms"],
                one["dynamic_ms"],
                one["times_faster"],
            )
            for one in result["fidelities"]
        ],
    )
    outcomes = sum((one.outcomes for one in found), Counter[tuple[str, str]]())
    output.table(
        "outcomes",
        ("kinematic", "dynamic", "moves"),
        [(*pair, count) for pair, count in outcomes.most_common()],
    )
    write_result(options.out, result)
    output.finish(result)


# ---------------------------------------------------------------- figures


_WORKERS = arg("--workers", type=count, default=1, help="entries measured at once")


def _figures(module: str, title: str, help: str, example: str) -> None:
    """The command that measures the figures of a module and prints what was asked beside them."""
    name = f"measure-{module.replace('_', '-')}"

    @command(
        COMMANDS,
        name,
        help,
        f"l2a-lab {name} {example}".rstrip(),
        arg(
            "--out",
            type=named,
            default=Path(f"results/{module}.json"),
            help="file of the results",
        ),
        arg("--only", default="", metavar="WORD", help="entries with this in their name"),
        arg("--again", action="store_true", help="also those that were measured before"),
        _WORKERS,
    )
    def run(options: argparse.Namespace, output: Output) -> None:
        from l2a_lab.measured import measure

        figures = importlib.import_module(f"l2a_lab.{module}").FIGURES
        make_folder(options.out.parent, "--out")
        found = measure(
            figures,
            options.out,
            only=options.only,
            again=options.again,
            workers=options.workers,
            progress=output.progress,
        )
        rows = figures.summary(found["entries"])
        output.table(title, ("what", "asked", "got"), rows)
        output.finish({"rows": [list(row) for row in rows], "file": str(options.out)})


for _row in (
    (
        "goals",
        "figures of goals without a drawing",
        "measure the search for structures that meet goals, beside the exact program",
        "--only planar/ --workers 2",
    ),
    (
        "builds",
        "figures of builds by an arm",
        "measure builds by an arm: large ones, with noise, with faults",
        "--only noise/ --workers 2",
    ),
    (
        "two_arms",
        "how much sooner two arms build than one",
        "measure builds by two arms together beside those by each alone",
        "--only pyramid",
    ),
    (
        "designs",
        "figures of the exact planner and the check",
        "measure the exact planner and the check on shapes and drawings",
        "--only shape/ --workers 2",
    ),
    (
        "hidden",
        "planners under hidden errors",
        "measure who gets through hidden errors, by the factor that scales them",
        "--only 1.4/",
    ),
    (
        "sensing",
        "figures of what cameras tell",
        "measure poses of blocks in depth pictures, lost blocks, and calibrated cameras",
        "--only alone/",
    ),
    (
        "speed",
        "steps a second beside another library",
        "measure steps a second of the environments beside jumanji's BinPack (extra speed)",
        "",
    ),
    (
        "structures",
        "figures of given blocks",
        "measure order, supports and proof of given blocks, and their states in simulation",
        "--only pile/ --workers 2",
    ),
):
    _figures(*_row)


# ---------------------------------------------------------------- workbenchmark


@command(
    COMMANDS,
    "workbenchmark",
    "play the tasks of WorkBenchMark, and print what was solved beside what is published",
    "l2a-lab workbenchmark --tasks workbenchmark.jsonl.gz --only 3",
    arg("--tasks", type=named, required=True, metavar="FILE", help="tasks as JSON lines, .gz too"),
    arg("--only", default="", metavar="TIER", help="tasks of this tier (3), or one task (3/012)"),
    arg(
        "--physics",
        default="kinematic",
        choices=("kinematic", "dynamic"),
        help="cell in which the arm builds (kinematic)",
    ),
    arg(
        "--state",
        default="known",
        choices=("known", "sensed"),
        help="where bricks wait: as the task says, or seen by two cameras (known)",
    ),
    arg(
        "--out", type=named, default=None, help="file of the results (results/workbenchmark-*.json)"
    ),
    arg("--resume", action="store_true", help="keep what the file of the results has already"),
    _WORKERS,
)
def _run_workbenchmark(options: argparse.Namespace, output: Output) -> None:
    from l2a_lab import workbenchmark
    from l2a_lab.measured import measure

    check_exists(options.tasks, "--tasks")
    figures = workbenchmark.figures(options.tasks, options.physics, options.state)
    names = figures.names()
    only: str = options.only
    wanted = [name for name in names if only in ("", name, name.split("/")[0])]
    if not wanted:
        tiers = ", ".join(sorted({name.split("/")[0] for name in names}))
        raise InputError("--only", only, f"a tier ({tiers}) or a task such as {names[0]}")
    seen = "-sensed" if options.state == "sensed" else ""
    out: Path = options.out or Path(f"results/workbenchmark-{options.physics}{seen}.json")
    make_folder(out.parent, "--out")
    found = measure(
        dataclasses.replace(figures, names=lambda: wanted),
        out,
        again=not options.resume,
        workers=options.workers,
        progress=output.progress,
    )
    entries = {name: found["entries"][name] for name in wanted}
    rows = figures.summary(entries)
    title = f"WorkBenchMark, {options.state} state, {options.physics} cell"
    output.table(title, ("tasks", "asked", "solved"), rows)
    shares = workbenchmark.success(entries)
    every = shares.pop("all")
    output.finish(
        {
            "success": shares,
            "all": every,
            "tasks": len(entries),
            "state": options.state,
            "physics": options.physics,
            "file": str(out),
        }
    )
