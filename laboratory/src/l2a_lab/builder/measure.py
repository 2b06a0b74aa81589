"""How much of what people draw builders build, and what learning and search add.

Designs of held-out families, drawn from seeds that no training uses, are built by several players
over the same candidates and rules: networks, and rules that nobody had to learn
(:data:`~.search.RULES`), each with the same search and alone. The exact planner is timed on the
first of them, proof and margins included, beside the plan of the first network with the same proof.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from l2a_lab.builder.network import Builder
from l2a_lab.builder.planner import plan_with_agent
from l2a_lab.builder.search import BUDGET, RULES, Score, build
from l2a_lab.builds import DESIGNS, FALLS
from l2a_lab.measured import table_lines
from l2a_lab.shapes import letter
from learn2assemble.assembly.kit import Kit, load_kit
from learn2assemble.design.cells import CellDesign
from learn2assemble.design.read import read_design
from learn2assemble.planning.tiling.exact import plan_exact
from learn2assemble.planning.tiling.planners import PlanLimits, PlannerChoice
from learn2assemble.tasks.designs import Solved, draw_letter, make_design, with_exact_heap
from learn2assemble.tasks.task import DESIGN_TASKS

Progress = Callable[[str], None]
BUDGETS = {"with search": BUDGET, "alone": 1}
"""How every player builds: states per block that it may score."""
SETS: dict[str, tuple[str, float]] = {
    "cubes, up to 60 blocks": ("designs-cubes-60-held-out", 0.95),
    "bricks-lintels, up to 60 blocks": ("designs-lintels-60-held-out", 0.90),
    "bricks-lintels, up to 60 blocks, limited heap": ("designs-lintels-60-heap-held-out", 0.80),
    "bricks-lintels, 200 to 400 blocks": ("designs-lintels-400-held-out", 0.85),
}
"""Task of every set, and the share asked of a builder with search. The designs of a set with a
limited heap are those of the set before, with exactly the blocks of their solutions."""
_EXACT_SECONDS = 120.0
FIRST_SEED = 20_000_000
"""Evaluation seeds begin here; trainings use small ones, and other families."""


@dataclass(frozen=True)
class Measure:
    """What is measured.

    Args:
        designs: of every set of small designs.
        large: of the set of large ones.
        exact: of every set, planned by the exact planner, too, and proven again.
        seed: of the designs.
    """

    designs: int = 200
    large: int = 20
    exact: int = 40
    seed: int = 0


def measure(
    builders: Sequence[Builder],
    config: Measure,
    examples: Path | None,
    progress: Progress = lambda text: None,
    keep: Callable[[dict[str, Any]], None] = lambda found: None,
) -> dict[str, Any]:
    """All figures of builders, of which the first one plans the examples.

    Args:
        keep: given what is known so far after every set.
        examples: the folder of the examples; left out without it.
    """
    players: dict[str, Score | None] = {builder.name: builder for builder in builders}
    players |= RULES
    sets: dict[str, Any] = {}
    shown = {} if examples is None else measure_examples(builders[0], examples, progress)
    found = {"examples": shown, "sets": sets}
    designs: list[Solved] = []
    for number, (name, (task, asked)) in enumerate(SETS.items()):
        large = DESIGN_TASKS[task].blocks[1] > 60
        count = config.large if large else config.designs
        if DESIGN_TASKS[task].limited_heap:
            designs = [with_exact_heap(design) for design in designs]
        else:
            designs = []
            for k in range(count):
                progress(f"{name}: drawing design {k + 1} of {count}")
                rng = np.random.default_rng((FIRST_SEED + config.seed, number, k))
                designs.append(make_design(DESIGN_TASKS[task], rng))
        exact = min(config.exact // 5 if large else config.exact, count)
        sets[name] = {
            "task": task,
            "asked": asked,
            "designs": count,
            "families": dict(Counter(d.family for d in designs)),
            "blocks": [int(v) for v in np.quantile([len(d.order) for d in designs], (0, 0.5, 1))],
            "players": {
                player: {
                    how: _play(designs, score, budget, f"{name}: {player} {how}", progress)
                    for how, budget in BUDGETS.items()
                }
                for player, score in players.items()
            },
            "planners": _time_planners(designs[:exact], builders[0], progress, name),
        }
        keep(found)
    return found


def complete_told(sets: dict[str, Any]) -> list[str]:
    """What share of the designs of bricks and lintels up to 60 blocks players complete, as a table
    of the documents; and how many blocks for one of the known solution they take with search."""
    some = [name for name in sets if name.startswith("bricks-lintels, up to")]
    heads = ("any number: with search", "alone", "tight heap: with search", "alone")
    rows: list[list[str]] = []
    for player in sets[some[0]]["players"]:
        played = [sets[name]["players"][player] for name in some]
        shares = [f"{100 * one[how]['complete']:.4g} %" for one in played for how in BUDGETS]
        blocks = played[0]["with search"]["blocks_per_block_of_exact"]
        rows.append([player, *shares, f"{blocks:.2f}"])
    return table_lines(["complete", *heads, "blocks"], rows)


def _play(
    designs: list[Solved], score: Score | None, budget: int, what: str, progress: Progress
) -> dict[str, Any]:
    complete, ratio, expanded, seconds, decisions = (list[float]() for _ in range(5))
    failed: Counter[str] = Counter()
    repairs = 0
    for k, design in enumerate(designs):
        progress(f"{what}, design {k + 1} of {len(designs)}")
        outcome = build(design.site, score, budget=budget, seed=k)
        blocks = len(outcome.world.placed)
        complete.append(outcome.complete)
        if outcome.complete:
            ratio.append(blocks / len(design.order))
        else:
            failed[design.family] += 1
        expanded.append(outcome.expanded / max(blocks, 1))
        seconds.append(outcome.seconds)
        decisions += outcome.decisions
        repairs += outcome.repairs
    return {
        "designs": len(designs),
        "complete": round(float(np.mean(complete)), 4),
        "failed_by_family": dict(failed),
        "blocks_per_block_of_exact": round(float(np.mean(ratio)), 3) if ratio else None,
        "expanded_per_block": round(float(np.mean(expanded)), 2),
        "repairs": repairs,
        "seconds_median": round(float(np.median(seconds)), 4),
        "decision_ms_mean": round(1e3 * float(np.mean(decisions)), 2),
        "decision_ms_95": round(1e3 * float(np.quantile(decisions, 0.95)), 2),
    }


def _time_planners(
    designs: list[Solved], builder: Builder, progress: Progress, name: str
) -> dict[str, Any]:
    """Exact planner and agent with search, both with the proof of every step and its margin."""
    times: dict[str, list[float]] = defaultdict(list)
    done: dict[str, list[bool]] = defaultdict(list)
    for k, design in enumerate(designs):
        progress(f"{name}: planners, design {k + 1} of {len(designs)}")
        wanted, kit = design.site.wanted, design.kit
        started = perf_counter()
        tiling, ordering = plan_exact(wanted, kit, seconds=_EXACT_SECONDS, props_allowed=False)
        found = {"exact": (tiling.status, ordering and ordering.status, perf_counter() - started)}
        started = perf_counter()
        tiling, ordering, _, _ = plan_with_agent(
            wanted, kit, PlanLimits(), PlannerChoice("agent", builder, k)
        )
        found["agent"] = tiling.status, ordering.status, perf_counter() - started
        for planner, (tiled, ordered, seconds) in found.items():
            good = tiled == ordered == "complete"
            done[planner].append(good)
            times[planner].append(seconds)
    return {
        planner: {
            "designs": len(done[planner]),
            "complete_and_proven": round(float(np.mean(done[planner])), 4),
            "seconds_median": round(float(np.median(times[planner])), 3),
            "seconds_mean": round(float(np.mean(times[planner])), 3),
        }
        for planner in done
    }


# ---------------------------------------------------------------- examples and hand-drawn designs


_DRAWN = {
    "bridge": "##########/##########/##......##/##......##",
    "bridge, two spans": "############/#....##....#/#....##....#",
    "bridge, too wide": "############/############/##........##/##........##",
    "stair": "........##/......####/....######/..########/##########",
    "off-centre tower": ".......##./.......##./.......##./.......##./##########",
    "bridge on props": "/".join(["#" * 18] * 4 + ["#####........#####"] * 2),
    "window on props": "/".join(["#" * 16] * 4 + ["####........####"] * 3 + ["#" * 16] * 2),
}
"""Rows from the top; a wall one cell thick."""


def example_designs(folder: Path) -> dict[str, tuple[np.ndarray, Kit]]:
    """The eight buildable examples, and hand-drawn designs: cells and kit by name."""
    found: dict[str, tuple[np.ndarray, Kit]] = {}
    files = sorted({*DESIGNS, FALLS} - {"gate.svg"})
    files += ["h.svg", "t.svg", "gate.svg", "circle.svg", "two_towers.svg", "arch.svg"]
    for file in files:
        design = read_design(folder / file)
        assert isinstance(design, CellDesign)
        name = file.partition(".")[0]
        found[name] = design.wanted, load_kit(design.kit or "bricks-lintels")
    for name, rows in _DRAWN.items():
        found[name] = letter(rows, 1), load_kit("bricks-lintels")
    for one in "AHILOPTUYE":
        picture = draw_letter(one, 5, 2, 2, 1)
        found[f"letter {one}"] = picture[:, None, :], load_kit("bricks-lintels")
    return found


def measure_examples(
    builder: Builder, folder: Path, progress: Progress = lambda text: None
) -> dict[str, Any]:
    """Agent with search and exact planner on the examples and the hand-drawn designs."""
    rows: dict[str, Any] = {}
    for name, (wanted, kit) in example_designs(folder).items():
        progress(f"example {name}")
        started = perf_counter()
        tiling, ordering, report, _ = plan_with_agent(
            wanted, kit, PlanLimits(), PlannerChoice("agent", builder)
        )
        agent = perf_counter() - started
        started = perf_counter()
        exact, ordered = plan_exact(wanted, kit, seconds=_EXACT_SECONDS)
        rows[name] = {
            "kit": kit.name,
            "cells": int(wanted.sum()),
            "agent": tiling.status if tiling.status != "complete" else ordering.status,
            "agent_reason": tiling.reason or ordering.reason,
            "blocks": sum(not block.prop for block in tiling.placements),
            "props": sum(block.prop for block in tiling.placements),
            "how": report.attempts[0].result,
            "agent_s": round(agent, 3),
            "exact": exact.status if exact.status != "complete" else ordered and ordered.status,
            "exact_reason": exact.reason or (ordered.reason if ordered else ""),
            "exact_blocks": sum(not block.prop for block in exact.placements),
            "exact_props": sum(block.prop for block in exact.placements),
            "exact_s": round(perf_counter() - started, 3),
        }
    return rows
