"""``l2a tasks``: the presets and the agents trained on them."""

from __future__ import annotations

import argparse

from learn2assemble.cli.output import Output
from learn2assemble.networks.agent import agent_info, pretrained_names
from learn2assemble.tasks import PRESETS


def run(options: argparse.Namespace) -> int:
    output = Output(options.json)
    agents: dict[str, list[str]] = {}
    for name in pretrained_names():
        agents.setdefault(agent_info(name)["task"], []).append(name)
    rows = []
    for name, task in PRESETS.items():
        low, high = task.block_range
        rows.append({
            "name": name, "sides": task.num_sides, "grid": task.grid, "nodes": task.num_nodes,
            "blocks": [low, high], "objects": task.objects, "arm": task.arm,
            "actions": task.num_actions, "discount": task.discount,
            "success_threshold": task.success_threshold, "agents": agents.get(name, []),
        })  # fmt: skip
    output.table("", ("task", "sides", "grid", "nodes", "blocks", "objects", "arm", "agents"), [
        (r["name"], r["sides"], f"{r['grid']}x{r['grid']}", r["nodes"],
         f"{r['blocks'][0]}-{r['blocks'][1]}", r["objects"], r["arm"],
         ", ".join(r["agents"]) or "-")
        for r in rows
    ])  # fmt: skip
    output.finish({"tasks": rows})
    return 0
