"""What the builder builds with an arm, and whether it helps the exact planner there.

Designs of held-out families, drawn from seeds that no training uses. The *sets* count the designs
that the builder with its search plans and the kinematic cell carries out in that order. The
*comparison* lets four planners find an order for the same designs of 100 to 300 blocks, on the
same terms: the exact planner's blocks from far to near; the same with other orders where that one
is stuck; the same blocks in the order of the builder's search; blocks and order by the builder.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from l2a_lab.builder.arm import Hand, build_by_arm
from l2a_lab.builder.measure import FIRST_SEED
from l2a_lab.builder.network import Builder, load_builder
from l2a_lab.builder.search import build
from learn2assemble.acting.carry_out import Workcell
from learn2assemble.assembly.kit import Kit
from learn2assemble.design.cells import CellDesign
from learn2assemble.errors import InputError
from learn2assemble.linear_programs import INF
from learn2assemble.planning.plan import Plan
from learn2assemble.planning.tiling.construct import plan_cells
from learn2assemble.planning.tiling.planners import PlannerChoice
from learn2assemble.planning.tiling.world import LatticeWorld, make_site, only, run
from learn2assemble.tasks.designs import Solved, make_design
from learn2assemble.tasks.task import DesignTask

Progress = Callable[[str], None]
ASKED = {"suction": 0.90, "gripper": 0.80}
SMALL = DesignTask("up to 40 blocks", ("held-out",), blocks=(5, 40))
_CUBES = DesignTask("100 to 300 cubes", ("held-out",), "cubes", (100, 300), extent=20)
_BRICKS = DesignTask("100 to 300 bricks", ("held-out",), blocks=(100, 300), extent=16)
LARGE = (_CUBES, _CUBES, _BRICKS)
"""By turns; small enough to be within the reach of the arm."""
PITCH = 0.032
"""Of the large designs [m]: the smallest blocks that the cup of 30 mm holds."""
WAYS = ("far to near", "search over orders", "agent as prior", "agent alone")


@dataclass(frozen=True)
class ArmMeasure:
    """What is measured.

    Args:
        suction, gripper: designs of each set, the first of the same ones; 0 leaves out a set.
        compared: designs of the comparison.
        seconds: of processor time for each of its planners.
        arm: which arm.
        seed: of the designs.
    """

    suction: int = 200
    gripper: int = 200
    compared: int = 50
    seconds: float = 60.0
    arm: str = "panda"
    seed: int = 0


def measure_arm(
    builder: str,
    config: ArmMeasure,
    progress: Progress = lambda text: None,
    keep: Callable[[dict[str, Any]], None] = lambda found: None,
    known: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Sets and comparison.

    Args:
        builder: its name or file.
        keep: given what is known so far from time to time.
        known: what such a measurement has found before; it goes on from there.
    """
    agent = load_builder(builder)
    known = {} if known is None else known
    sets: dict[str, Any] = dict(known.get("sets", {}))
    beside: list[dict[str, Any]] = list(known.get("comparison", {}).get("rows", []))
    found: dict[str, Any] = {"sets": sets, "comparison": known.get("comparison", {})}
    rows = {tool: list(sets.get(tool, {}).get("rows", [])) for tool in ASKED}
    # All of it grows together, so that what is known at any time is of use.
    for k in range(max(config.suction, config.gripper, config.compared)):
        tools = [tool for tool in ASKED if len(rows[tool]) <= k < getattr(config, tool)]
        if not tools and not len(beside) <= k < config.compared:
            continue
        for tool in tools:
            progress(f"{tool}, design {k + 1} of {getattr(config, tool)}")
            design = make_design(SMALL, np.random.default_rng((FIRST_SEED + config.seed, 9, k)))
            at = Workcell(config.arm, tool, physics="kinematic")
            rows[tool].append(_built(design, at, builder))
            sets[tool] = {**_counted(rows[tool], ASKED[tool]), "rows": rows[tool]}
        if len(beside) <= k < config.compared:
            progress(f"comparison, design {k + 1} of {config.compared}")
            rng = np.random.default_rng((FIRST_SEED + config.seed, 11, k))
            beside.append(_compared(make_design(LARGE[k % len(LARGE)], rng), config, agent))
            found["comparison"] = {**compare(beside), "rows": beside}
        keep(found)
    return found


def _built(design: Solved, workcell: Workcell, builder: str) -> dict[str, Any]:
    """One design of a set."""
    hands: list[Hand] = []
    started = time.process_time()

    def plan_with(kit: Kit, hand: Hand) -> Plan:
        hands.append(hand)
        return plan_cells(
            CellDesign("design", design.site.wanted, design.kit.pitch),
            kit,
            planner=PlannerChoice("agent", builder, hand=hand),
            seconds=INF,
        )

    row: dict[str, Any] = {"family": design.family, "blocks": len(design.order)}
    try:
        plan = build_by_arm(plan_with, design.site.wanted, design.kit, workcell, lambda text: None)
        row |= {
            "status": plan.status,
            "reason": plan.reason,
            "steps": len(plan.steps),
            "joint_mm": round(1e3 * (hands[-1].job.joint if hands[-1].job else 0), 2),
            "attempts": plan.arm.attempts if plan.arm else 0,
        }
    except InputError as error:
        row |= {"status": "refused", "reason": str(error)}
    row |= {
        "tried": sum(hand.tried for hand in hands),
        "failed": sum(hand.failed for hand in hands),
        "joints": len(hands),
        "seconds": round(time.process_time() - started, 2),
    }
    return row


def _counted(rows: list[dict[str, Any]], asked: float) -> dict[str, Any]:
    done = [row for row in rows if row["status"] == "complete"]
    short = [row for row in rows if row["status"] != "complete"]
    return {
        "task": SMALL.name,
        "asked": asked,
        "designs": len(rows),
        "complete": round(len(done) / len(rows), 4),
        "interval": wilson(len(done), len(rows)),
        "attempts_in_the_build_per_block": round(
            sum(r["attempts"] for r in done) / max(sum(r["steps"] for r in done), 1), 4
        ),
        "placements_tried_per_block": round(
            sum(r["tried"] for r in done) / max(sum(r["steps"] for r in done), 1), 3
        ),
        "wider_joints": sum(row["joint_mm"] > 1 for row in done),
        "seconds_median": round(float(np.median([row["seconds"] for row in rows])), 2),
        "not_complete": [(r["family"], r["blocks"], r["status"], r["reason"]) for r in short],
    }


def wilson(done: int, count: int) -> tuple[float, float]:
    """95 % interval of a share."""
    z, share = 1.96, done / count
    middle = (share + z * z / (2 * count)) / (1 + z * z / count)
    half = z / (1 + z * z / count) * np.sqrt(share * (1 - share) / count + (z / 2 / count) ** 2)
    return round(float(middle - half), 4), round(float(middle + half), 4)


# ---------------------------------------------------------------- comparison


def _compared(design: Solved, config: ArmMeasure, agent: Builder) -> dict[str, Any]:
    """One design, by every planner; the arm and its magazines stand where the blocks of the exact
    planner ask for them, and the tool tries every placement with the same cell."""
    site = make_site(design.site.wanted, design.kit.at_pitch((PITCH, PITCH, PITCH)))
    row: dict[str, Any] = {
        "family": design.family,
        "kit": site.kit.name,
        "blocks": len(design.order),
    }
    known = run(site, list(design.order))
    hand = Hand(Workcell(config.arm, "suction", physics="kinematic"))
    try:
        if known is None:
            raise InputError("design", "what does not stand with smaller blocks", "another")
        kit = hand.set_up(known)
    except InputError as error:
        return row | {"left_out": str(error)}
    placements = [site.placement(candidate) for candidate in design.order]
    site = make_site(site.wanted, kit)
    chosen = site.candidates(placements)
    for way in WAYS:
        hand.tried = hand.failed = 0
        hand.enter(site)
        begun = time.process_time()
        if way in WAYS[:2]:
            most = config.seconds if way == WAYS[1] else 0.0
            world = _by_order(only(site, chosen), hand, chosen, most, config.seed)
        else:
            start = LatticeWorld(site) if way == WAYS[3] else only(site, chosen)
            world = build(start, agent, seed=config.seed, hand=hand).world
        spent = time.process_time() - begun
        row[way] = {
            "complete": world.complete and spent <= config.seconds,
            "placed": len(world.placed),
            "tried": hand.tried,
            "failed": hand.failed,
            "props": 0,
            "seconds": round(spent, 2),
        }
    return row


def _by_order(
    start: LatticeWorld, hand: Hand, chosen: np.ndarray, seconds: float, seed: int
) -> LatticeWorld:
    """Place what can be placed, the lowest and farthest first; where that gets stuck, in random
    orders of every level while there are ``seconds`` of processor time. The best is returned."""
    assert hand.job is not None
    site, rng = start.site, np.random.default_rng(seed)
    level = site.found.origin[chosen, 2]
    pitch, middle = np.array(site.kit.pitch[:2]), np.array(site.wanted.shape[:2]) / 2
    sizes = np.array([np.max(way.cells, axis=0)[:2] + 1 for way in site.found.ways])
    at = site.found.origin[chosen, :2] + sizes[site.found.way[chosen]] / 2 - middle
    away = np.linalg.norm(at * pitch - hand.job.base, axis=1)
    best, begun = start, time.process_time()
    while True:
        world, left = start.copy(), chosen[np.lexsort((-away, level))].tolist()
        while left:
            for candidate in left:
                trial = world.copy()
                if world.waits[candidate] or not trial.place(candidate, program=True):
                    continue
                if hand.blocked(world, candidate) is None:
                    break
            else:
                break
            left.remove(candidate)
            world = trial
        best = world if world.open < best.open else best
        if best.complete or time.process_time() - begun >= seconds:
            break
        away = rng.random(len(chosen))
    return best


def compare(rows: list[dict[str, Any]], draws: int = 10_000) -> dict[str, Any]:
    """The comparison in figures, with differences design by design to the exact planner's.

    The rule: the builder orders what the exact planner has chosen, where it has at least 30 %
    fewer failed attempts, or completes 10 points more, than the exact planner from far to near.
    """
    good = [row for row in rows if "left_out" not in row]
    if not good:
        return {"designs": 0, "left_out": len(rows)}
    rng = np.random.default_rng(0)
    picked = rng.integers(len(good), size=(draws, len(good)))
    found: dict[str, Any] = {"designs": len(good), "left_out": len(rows) - len(good)}
    value = {
        way: {
            "complete": np.array([row[way]["complete"] for row in good], float),
            "failed_per_block": np.array([row[way]["failed"] / row["blocks"] for row in good]),
            "tried_per_placed": np.array(
                [row[way]["tried"] / max(row[way]["placed"], 1) for row in good]
            ),
            "seconds": np.array([row[way]["seconds"] for row in good]),
        }
        for way in WAYS
    }
    for way in WAYS:
        found[way] = {name: round(float(v.mean()), 4) for name, v in value[way].items()}
        found[way]["failed"] = sum(row[way]["failed"] for row in good)
        found[way]["props"] = 0
        if way != WAYS[0]:
            found[way]["minus_far_to_near"] = {
                name: [
                    round(float(v), 4)
                    for v in (change.mean(), *np.quantile(change[picked].mean(1), (0.025, 0.975)))
                ]
                for name in value[way]
                for change in [value[way][name] - value[WAYS[0]][name]]
            }
    exact, prior = found[WAYS[0]], found[WAYS[2]]
    fewer = exact["failed"] > 0 and prior["failed"] <= 0.7 * exact["failed"]
    found["helps"] = bool(fewer or prior["complete"] >= exact["complete"] + 0.1)
    return found
