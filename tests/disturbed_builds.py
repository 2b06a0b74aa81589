"""Builds of the example designs whose blocks do not wait exactly where they should.

A measurement, not a test: every buildable example with every arm, several times, each with other
disturbances. One JSON line per build goes to a file; what is in it already is not repeated.

    python tests/disturbed_builds.py --runs 10 --out disturbed.jsonl
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import time
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch

from learn2assemble.networks.agent import default_agent, load_agent
from learn2assemble.planning.execute import build_with_arm, real_cell
from learn2assemble.planning.problem import Problem, design_problem
from learn2assemble.planning.supply import set_out
from learn2assemble.robot.arm import get_arm
from learn2assemble.robot.kinematic.cell import KinematicCell
from learn2assemble.robot.registry import ARMS
from learn2assemble.world.blocks import HALF
from learn2assemble.world.design_bounds import read_design

DESIGNS = Path(__file__).parent.parent / "examples" / "designs"
NAMES = (
    "arch_pair", "gabled_house", "keep", "leaning_parallelogram",
    "pavilion", "pyramid", "skyline", "stepped_tower",
)  # fmt: skip
"""The examples that can be built."""
SMALLEST, LARGEST = 1e-6, 1e-3
"""Amplitudes of the disturbances [m]."""
SECONDS = 600.0
"""Limit of a search: so long that a busy machine does not change what is found."""


def disturbed(problem: Problem, amplitude: float, rng: np.random.Generator) -> Problem:
    """The problem with every block moved by up to ``amplitude`` [m] in x and in y, and turned so
    that its faces move by as much."""
    state = problem.state.copy()
    count = int(state.num_blocks[0])
    x, y, turn = rng.uniform(-amplitude, amplitude, (3, count))
    state.position[0, :count, 0] += x
    state.position[0, :count, 1] += y
    w, z = state.quaternion[0, :count, 0], state.quaternion[0, :count, 3]
    half = np.arctan2(z, w) + turn / HALF / 2
    state.quaternion[0, :count, 0], state.quaternion[0, :count, 3] = np.cos(half), np.sin(half)
    return dataclasses.replace(problem, state=state)


def disturbed_build(name: str, arm: str, run: int) -> dict[str, Any]:
    """Build an example; run 0 is undisturbed, every other number stands for its disturbance."""
    rng = np.random.default_rng([zlib.crc32(name.encode()), zlib.crc32(arm.encode()), run])
    amplitude = float(np.exp(rng.uniform(np.log(SMALLEST), np.log(LARGEST)))) if run else 0.0
    design = read_design(DESIGNS / f"{name}.json")
    cell = real_cell(get_arm(arm))
    problem = design_problem(design, arm)
    problem = set_out(problem, KinematicCell(cell.arm, int(problem.state.num_blocks[0])))
    problem = disturbed(problem, amplitude, rng)
    sides = "four-sided-3x3-10-18" if problem.task.num_sides > 2 else "two-sided-3x3-10-14"
    agent = load_agent(default_agent(f"robot-{sides}"))
    started = time.perf_counter()
    plan = build_with_arm(problem, agent, name, cell, seconds=SECONDS).to_dict()
    return {
        "design": name, "arm": arm, "run": run, "amplitude": amplitude,
        "status": plan["status"], "reason": plan["reason"],
        "attempts": plan["arm"]["attempts"], "failures": plan["arm"]["failures"],
        "plans": [[a["stage"], a["result"]] for a in plan["search"]["attempts"]],
        "seconds": round(time.perf_counter() - started, 2),
    }  # fmt: skip


def left_to_do(runs: int, out: Path) -> Iterator[tuple[str, str, int]]:
    """What is not in the file yet."""
    lines = out.read_text(encoding="utf-8").splitlines() if out.exists() else []
    done = {(row["design"], row["arm"], row["run"]) for row in map(json.loads, lines)}
    for run in range(1, runs + 1):
        for name in NAMES:
            for arm in ARMS:
                if (name, arm, run) not in done:
                    yield name, arm, run


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=10, help="of each example and arm")
    parser.add_argument("--out", type=Path, required=True, help="one JSON line per build")
    options = parser.parse_args()
    torch.set_num_threads(1)
    for name, arm, run in left_to_do(options.runs, options.out):
        row = disturbed_build(name, arm, run)
        with options.out.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")
    rows = [json.loads(line) for line in options.out.read_text(encoding="utf-8").splitlines()]
    complete = sum(row["status"] == "complete" for row in rows)
    print(f"{complete} of {len(rows)} complete")


if __name__ == "__main__":
    main()
