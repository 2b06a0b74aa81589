"""Builds of exact plans by an arm, with noise and with faults: one JSON line for each.

``python tests/workcell_builds.py --out builds.jsonl --designs wall-100 --arms panda ur5e`` builds a
wall with a window from 100 blocks; other designs are the examples by name. ``--mode noise``: supply
poses of 1 mm and 1 degree, friction and masses of 20 % and 10 %, readings of 0.5 mm and 0.1 degree;
``--mode faults``: two blocks dropped and one pushed.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from learn2assemble.assembly.kit import Kit, load_kit
from learn2assemble.design.cells import CellDesign, read_design
from learn2assemble.planning.construct import plan_cells
from learn2assemble.planning.workcell import Disturbance
from learn2assemble.planning.workcell_plan import Workcell, carry_out_cells
from learn2assemble.reproduction.shapes import wall

DESIGNS = Path(__file__).parent.parent / "examples" / "designs"
NAMES = ("arch_pair", "gabled_house", "keep", "pavilion", "pyramid", "skyline", "stepped_tower")
"""The examples that the exact planner builds."""
WALLS = {
    "wall-100": (20, 3, 16, (7, 13, 5, 10)),
    "wall-130": (20, 5, 14, (7, 13, 4, 9)),
    "wall-158": (20, 6, 18, (7, 13, 5, 11)),
}
"""Walls with a window, by their number of blocks; cells of 32 mm."""
PITCH = 0.032


def design_of(name: str) -> tuple[CellDesign, Kit]:
    """A design and its kit."""
    if name in WALLS:
        kit = replace(load_kit("bricks-lintels"), pitch=(PITCH, PITCH, PITCH))
        return CellDesign(name, wall(*WALLS[name]), kit.pitch, None, 0.0, None, "", None), kit
    design = read_design(DESIGNS / f"{name}.json")
    return design, load_kit(design.kit or "bricks-lintels")


def disturbance_of(mode: str, seed: int, steps: int) -> Disturbance | None:
    """What goes otherwise than planned."""
    rng = np.random.default_rng(seed)
    if mode == "noise":
        return Disturbance((1e-3, math.radians(1.0)), float(rng.uniform(-0.2, 0.2)), 0.1)
    if mode == "faults":
        when = rng.choice(np.arange(2, max(steps, 6)), 3, replace=False).tolist()
        return Disturbance(drop=frozenset(when[:2]), push=frozenset(when[2:]))
    return None


def build(name: str, arm: str, tool: str, mode: str, seed: int) -> dict[str, Any]:
    """Plan, prove and carry out one design."""
    started, busy = time.perf_counter(), time.process_time()
    design, kit = design_of(name)
    plan = plan_cells(design, kit)
    noise = (5e-4, math.radians(0.1)) if mode == "noise" else (0.0, 0.0)
    how = Workcell(arm, tool, seed=seed, noise=noise,
                   disturbance=disturbance_of(mode, seed, len(plan.steps)))  # fmt: skip
    done = carry_out_cells(
        plan, kit, how, lambda text: None, lambda other: plan_cells(design, other)
    )
    return {
        "design": name, "arm": arm, "tool": tool, "mode": mode, "seed": seed,
        "status": done.status, "reason": done.reason, "steps": len(done.steps),
        "report": None if done.arm is None else asdict(done.arm),
        "seconds": round(time.perf_counter() - started, 2),
        "processor_seconds": round(time.process_time() - busy, 2),
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--designs", nargs="+", default=NAMES)
    parser.add_argument("--arms", nargs="+", default=("panda", "ur5e"))
    parser.add_argument("--tools", nargs="+", default=("suction",))
    parser.add_argument("--mode", choices=("plain", "noise", "faults"), default="plain")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    for name in options.designs:
        for arm in options.arms:
            for tool in options.tools:
                for seed in range(options.seeds):
                    row = build(name, arm, tool, options.mode, seed)
                    with options.out.open("a", encoding="utf-8") as file:
                        file.write(json.dumps(row) + "\n")


if __name__ == "__main__":
    main()
