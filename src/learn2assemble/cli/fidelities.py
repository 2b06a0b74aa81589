"""``l2a fidelities``: the kinematic cell of an arm against the dynamic one."""

from __future__ import annotations

import argparse
import json
from collections import Counter

import torch

from learn2assemble.cli.output import Output
from learn2assemble.errors import InputError
from learn2assemble.evaluation.fidelities import Comparison, compare
from learn2assemble.networks.agent import default_agent, load_agent
from learn2assemble.tasks import get_task

COLUMNS = (
    "task", "arm", "actions", "agree", "same outcome", "kinematic [ms]", "dynamic [ms]",
    "times faster",
)  # fmt: skip


def run(options: argparse.Namespace) -> int:
    output = Output(options.json)
    torch.set_num_threads(1)
    tasks = [get_task(name, options.arm) for name in options.tasks]
    for task in tasks:
        if not task.has_arm:
            raise InputError("task", task.name, "tasks with an arm")
    if options.out is not None and options.out.exists():
        raise InputError("--out", str(options.out), "a new file")
    found: list[Comparison] = []
    for task in tasks:
        agent = load_agent(options.agent or default_agent(task.name))
        output.progress(f"{task.name}: {options.actions} moves in both cells")

        def progress(done: int) -> None:
            if done % 50 == 0:
                output.progress(f"{done} of {options.actions}")

        found.append(compare(task, agent, options.actions, options.seed, progress))
    output.table("the same moves in both cells", COLUMNS, [_row(one) for one in found])
    outcomes: Counter[tuple[str, str]] = sum((one.outcomes for one in found), Counter())
    output.table("outcomes", ("kinematic", "dynamic", "moves"), [
        (*pair, count) for pair, count in outcomes.most_common()
    ])  # fmt: skip
    result = {"fidelities": [one.to_dict() for one in found]}
    if options.out is not None:
        options.out.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    output.finish(result)
    return 0


def _row(one: Comparison) -> tuple[object, ...]:
    data = one.to_dict()
    return (
        one.task, one.arm, one.actions, f"{one.share:.1%}", one.same_outcome,
        data["kinematic_ms"], data["dynamic_ms"], data["times_faster"],
    )  # fmt: skip
