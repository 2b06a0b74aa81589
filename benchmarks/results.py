"""Measure the shipped agent on every row of the README's table, and write the table.

    python benchmarks/results.py measure   # results/shipped_agent.json (about 20 minutes)
    python benchmarks/results.py table     # README.md, from results/ alone

Evaluation seeds are 0 to 4; their problems come from another random stream than training's.
"""

from __future__ import annotations

import csv
import json
import math
import sys
from pathlib import Path
from typing import Any

import torch

from learn2assemble.evaluation.episodes import make_policy, run_episodes
from learn2assemble.learning.run import provenance
from learn2assemble.networks.agent import default_agent, load_agent
from learn2assemble.physics.named import resolve_physics
from learn2assemble.presets import get_task
from learn2assemble.search.config import SearchConfig

ROOT = Path(__file__).parent.parent
RESULTS = ROOT / "results" / "shipped_agent.json"
PUBLISHED = ROOT / "results" / "published.csv"
TRAINED_ON = "two-sided-3x3-20-24"
TASKS = (TRAINED_ON, "two-sided-3x3-30-34", "two-sided-4x4-30-34", "two-sided-5x5-40-44")
SEEDS = range(5)
EPISODES = 100
BEGIN, END = "<!-- results:begin -->", "<!-- results:end -->"


def measure() -> None:
    """Play every row and write the results file."""
    torch.set_num_threads(1)
    agent = load_agent(default_agent(TRAINED_ON))
    rows = []
    for physics in ("static", "rigid"):
        for name in TASKS:
            for budget in (0, 10):
                for epsilon in (0.05, 0.0):
                    rows.append(_row(agent, name, budget, epsilon, physics))
                    sys.stderr.write(f"{rows[-1]}\n")
    result = {"agent": agent.name, "origin": agent.origin, **provenance("cpu"), "rows": rows}
    RESULTS.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


def _row(agent: Any, name: str, budget: int, epsilon: float, physics: str) -> dict[str, Any]:
    task = get_task(name)
    config = SearchConfig(budget=budget, epsilon=epsilon) if budget else None
    policy = make_policy(task, agent.network, config, epsilon)
    seeds = SEEDS if physics == "static" else SEEDS[:1]
    runs = [
        run_episodes(task, policy, EPISODES, seed, resolve_physics(physics)).to_dict()
        for seed in seeds
    ]
    count = len(runs)
    means = {
        key: sum(run[key] for run in runs) / count
        for key in ("R", "a", "f", "b", "success", "coverage")
    }
    spread = math.sqrt(sum(run["R_ci95"] ** 2 for run in runs)) / count
    return {
        "task": name, "physics": physics, "budget": budget, "epsilon": epsilon,
        "seeds": list(seeds), "episodes": count * EPISODES, **means, "R_ci95": spread,
        "seconds": sum(run["seconds"] for run in runs),
    }  # fmt: skip


def table() -> str:
    """The README's table, from the results file and the published numbers."""
    rows = json.loads(RESULTS.read_text(encoding="utf-8"))["rows"]
    lines = [
        "| task | search | paper, ε = 0.05: R / f | ours, ε = 0.05: R ± 95 % / f / success "
        "| ours, ε = 0: R / f / success | rigid, ε = 0.05: R / f / success |",
        "|---|---|---|---|---|---|",
    ]
    for name in TASKS:
        for budget in (0, 10):
            cells = {
                (row["physics"], row["epsilon"]): row
                for row in rows
                if row["task"] == name and row["budget"] == budget
            }
            noisy, clean = cells["static", 0.05], cells["static", 0.0]
            rigid, paper = cells["rigid", 0.05], _paper(name, budget)
            lines.append(
                f"| {name}{'*' if name == TRAINED_ON else ''} "
                f"| {f'budget {budget}' if budget else 'none'} "
                f"| {paper['R']} / {paper['f']} "
                f"| {noisy['R']:.2f} ± {noisy['R_ci95']:.2f} / {noisy['f']:.2f} "
                f"/ {noisy['success']:.2f} "
                f"| {clean['R']:.2f} / {clean['f']:.2f} / {clean['success']:.2f} "
                f"| {rigid['R']:.2f} / {rigid['f']:.2f} / {rigid['success']:.2f} |"
            )
    lines.append("")
    lines.append("\\* the task it was trained on; the others it has never seen.")
    return "\n".join(lines)


def _paper(name: str, budget: int) -> dict[str, str]:
    _, _, grid, low, high = name.split("-")
    method = "DQN+MCTS" if budget else "DQN"
    with PUBLISHED.open(encoding="utf-8") as stream:
        for row in csv.DictReader(stream):
            wanted = ("main_T2", method, str(budget), grid, f"{low}-{high}")
            keys = ("source_table", "method", "search_budget", "grid", "blocks")
            if tuple(row[key] for key in keys) == wanted:
                return row
    raise LookupError(f"no published row for {name}, budget {budget}")


def with_table(readme: str) -> str:
    """``readme`` with the table between its markers."""
    head, _, rest = readme.partition(BEGIN)
    _, _, tail = rest.partition(END)
    return f"{head}{BEGIN}\n{table()}\n{END}{tail}"


if __name__ == "__main__":
    command = sys.argv[1] if len(sys.argv) == 2 else ""
    if command == "measure":
        measure()
    elif command == "table":
        path = ROOT / "README.md"
        path.write_text(with_table(path.read_text(encoding="utf-8")), encoding="utf-8")
    else:
        sys.exit(__doc__)
