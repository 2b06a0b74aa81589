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

import numpy as np
import torch

from learn2assemble.evaluation.bounds import return_bound
from learn2assemble.evaluation.episodes import (
    Policy,
    episode_generators,
    make_policy,
    run_episodes,
)
from learn2assemble.learning.run import provenance
from learn2assemble.networks.agent import default_agent, load_agent
from learn2assemble.physics.named import resolve_physics
from learn2assemble.planning.lookahead import lookahead_actions
from learn2assemble.presets import get_task
from learn2assemble.search.config import SearchConfig
from learn2assemble.simulator import Simulator
from learn2assemble.world.state import State

ROOT = Path(__file__).parent.parent
RESULTS = ROOT / "results" / "shipped_agent.json"
PUBLISHED = ROOT / "results" / "published.csv"
TRAINED_ON = "two-sided-3x3-20-24"
TASKS = (TRAINED_ON, "two-sided-3x3-30-34", "two-sided-4x4-30-34", "two-sided-5x5-40-44")
SEARCHES = ((0, False), (10, False), (10, True))
"""Budget, and whether only distinct structures are expanded (deviation D14)."""
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
            for budget, distinct in SEARCHES:
                for epsilon in (0.05, 0.0):
                    rows.append(_row(agent, name, budget, distinct, epsilon, physics))
                    sys.stderr.write(f"{rows[-1]}\n")
    result = {
        "agent": agent.name, "origin": agent.origin, **provenance("cpu"), "rows": rows,
        "references": [_reference(name) for name in TASKS],
    }  # fmt: skip
    RESULTS.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


def _row(
    agent: Any, name: str, budget: int, distinct: bool, epsilon: float, physics: str
) -> dict[str, Any]:
    task, config = get_task(name), None
    if budget:
        config = SearchConfig(budget=budget, epsilon=epsilon, distinct=distinct)
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
        "task": name, "physics": physics, "budget": budget, "distinct": distinct,
        "epsilon": epsilon,
        "seeds": list(seeds), "episodes": count * EPISODES, **means, "R_ci95": spread,
        "seconds": sum(run["seconds"] for run in runs),
    }  # fmt: skip


def _reference(name: str) -> dict[str, Any]:
    """The exact look-ahead on the same problems, and the mean bound on their return."""
    task = get_task(name)
    simulator = Simulator(task)
    bounds = []
    for seed in SEEDS:
        rng, _ = episode_generators(seed)
        state = simulator.new(EPISODES, rng)
        bounds.append(float(return_bound(state, task.discount).mean()))

    def policy(epsilon: float) -> Policy:
        def act(state: State, rng: np.random.Generator) -> np.ndarray:
            actions = lookahead_actions(simulator, state)
            for row in np.flatnonzero(rng.random(len(actions)) < epsilon):
                shape = (state.num_unplaced[row], state.num_placed[row], task.num_actions)
                actions[row] = [int(rng.integers(n)) for n in shape]
            return actions

        return act

    out: dict[str, Any] = {"task": name, "bound": sum(bounds) / len(bounds)}
    for epsilon in (0.05, 0.0):
        runs = [run_episodes(task, policy(epsilon), EPISODES, seed).to_dict() for seed in SEEDS]
        out[str(epsilon)] = {
            key: sum(run[key] for run in runs) / len(runs) for key in ("R", "f", "b", "success")
        }
    return out


def table() -> str:
    """The README's table, from the results file and the published numbers."""
    data = json.loads(RESULTS.read_text(encoding="utf-8"))
    lines = [
        "| task | search | paper, ε = 0.05: R / f | ours, ε = 0.05: R ± 95 % / f / success "
        "| ours, ε = 0: R / f / success | rigid, ε = 0.05: R / f / success |",
        "|---|---|---|---|---|---|",
    ]
    for name in TASKS:
        star = "\\*" if name == TRAINED_ON else ""
        for budget, distinct in SEARCHES:
            cells = {
                (row["physics"], row["epsilon"]): row
                for row in data["rows"]
                if (row["task"], row["budget"], row["distinct"]) == (name, budget, distinct)
            }
            noisy, paper = cells["static", 0.05], _paper(name, budget)
            search = f"budget {budget}{', distinct' if distinct else ''}" if budget else "none"
            lines.append(
                f"| {name}{star} | {search} | {paper['R']} / {paper['f']} "
                f"| {noisy['R']:.2f} ± {noisy['R_ci95']:.2f} / {_shares(noisy)} "
                f"| {_cell(cells['static', 0.0])} | {_cell(cells['rigid', 0.05])} |"
            )
        for reference in data["references"]:
            if reference["task"] == name:
                noisy, clean = reference["0.05"], reference["0.0"]
                lines.append(
                    f"| {name} | exact look-ahead, no learning | - | {_cell(noisy)} "
                    f"| {_cell(clean)} (bound on R: {reference['bound']:.2f}) | - |"
                )
    lines.append("")
    lines.append(
        "\\* the task it was trained on; the others it has never seen. Distinct: D14. "
        "The exact look-ahead knows what every placement brings; no play can exceed the bound."
    )
    return "\n".join(lines)


def _cell(row: dict[str, Any]) -> str:
    return f"{row['R']:.2f} / {_shares(row)}"


def _shares(row: dict[str, Any]) -> str:
    return f"{row['f']:.2f} / {row['success']:.2f}"


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
