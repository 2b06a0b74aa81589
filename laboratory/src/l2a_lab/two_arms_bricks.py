"""How much sooner two arms press bricks home than one, and than the same two one after the other:
the part ``bricks/`` of ``results/two_arms.json``.

What two arms would take one after the other is the sum of what both did, without what they waited
for one another: less than that it cannot be with these motions.
"""

from __future__ import annotations

import time
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

import learn2assemble as l2a
from l2a_lab.arm_distances import WatchedCell
from l2a_lab.measured import Result, table_lines
from learn2assemble.assembly.blocks import Assembly
from learn2assemble.assembly.bricks.files import of_stablelego
from learn2assemble.assembly.bricks.model import Brick, BrickModel, assembly_of
from learn2assemble.assembly.instructions.words import count_words
from learn2assemble.assembly.kit import load_kit
from learn2assemble.cell.site import Site
from learn2assemble.cell.site_arms import SiteArm
from learn2assemble.cell.workcell import Workcell
from learn2assemble.files import read_json_lines
from learn2assemble.team.members import set_up_team
from learn2assemble.team.pair import bricks_by_team, gather
from learn2assemble.team.together import Together, built_by

RECORDED = Path("tests/data/clutch_designs.jsonl.gz")
ARM, TOOL, BOTH = "panda", "gripper", "both"
TOOLS = TOOL, "socket"
WHO = tuple(f"{who}{'' if tool == TOOL else f', {tool}'}" for tool in TOOLS for who in (ARM, BOTH))
"""Who builds, and with what: fingers where nothing is said."""
TASKS = tuple(f"apex_{name}" for name in ("R", "fish_high", "cliff", "bridge", "rss", "vessel"))
"""Of APEX-MR (Huang et al., RSS 2025)."""
WALL, LENGTH, LAYERS = "wall of bricks", 28, 6
"""Small bricks of four studs by two in running bond, with halves at the ends of every other layer:
so many studs long and bricks high."""
BRICKS = (*TASKS, WALL)
ASKED = 0.52
"""Of the time of both one after the other, for the tasks; published."""


def entry(what: str, who: str) -> Result:
    """A build by one arm, or by both.

    Args:
        what: one of :data:`BRICKS`.
        who: one of :data:`WHO`.
    """
    started, bricks = time.process_time(), _bricks(what)
    who, _, tool = who.partition(", ")
    if who == BOTH:
        return _together(bricks, tool or TOOL, started)
    done = l2a.build(bricks, arm=ARM, tool=tool or TOOL)
    told: Result = {}
    if done.arm is not None:
        told = {"robot_s": done.arm.seconds, "attempts": done.arm.attempts}
    said = {"status": done.status, "reason": done.reason, "blocks": done.blocks.used}
    return {**said, **told, "building_s": round(time.process_time() - started, 2)}


def _together(bricks: Assembly, tool: str, started: float) -> Result:
    members = set_up_team(bricks, [SiteArm(n, ARM, tool) for n in ("one", "two")], Site())
    workcell = Workcell(ARM, tool, hands=True)
    plan, order = bricks_by_team(bricks, members, workcell)
    planned = round(time.process_time() - started, 2)
    if not plan.complete:
        return {"status": plan.status, "reason": plan.reason, "planning_s": planned}
    cells: list[WatchedCell] = []

    def opened(setup: Any) -> WatchedCell:
        cells.append(WatchedCell(setup))
        return cells[-1]

    both = Together(gather(plan, members, workcell, 0.0, order), opened)
    done, _ = built_by(both, plan, lambda text: None, time.perf_counter())
    least = cells[0].least()
    alone = sum(turn.end - turn.begin for turn in both.turns)
    return {
        "status": done.status,
        "reason": done.reason,
        "blocks": done.blocks.used,
        "robot_s": done.robot_s,
        "in_turn_s": round(alone - sum(arm.waited for arm in both.arms), 2),
        "attempts": len(both.turns),
        "least_distance": round(least.distance, 5),
        "moments": least.moments,
        "planning_s": planned,
        "building_s": round(time.process_time() - started, 2),
    }


def _bricks(what: str) -> Assembly:
    if what == WALL:
        return wall(LENGTH, LAYERS)
    found = {told["name"]: told for told in read_json_lines(RECORDED, "file of bricks")}
    return of_stablelego(found[what], what, what, None)


def wall(length: int, layers: int) -> Assembly:
    """See :data:`WALL`."""
    made: list[Brick] = []
    for z in range(layers):
        ends = [0, *range(2 * (z % 2) or 4, length, 4), length]
        for low, high in pairwise(ends):
            made.append(Brick((low, 0, 3 * z), (high - low, 2, 3), f"brick {len(made)}"))
    return assembly_of(BrickModel(tuple(made)), load_kit("lego"), WALL)


def _of(entries: dict[str, Result], what: str, who: str, tool: str) -> Result:
    """What was measured; empty where nothing was."""
    return entries.get(f"bricks/{what}/{who}{'' if tool == TOOL else f', {tool}'}", {})


def share(entries: dict[str, Result], what: str, tool: str = TOOL) -> float | None:
    """What both took of what they would have one after the other; None where they did not."""
    both = _of(entries, what, BOTH, tool)
    return both["robot_s"] / both["in_turn_s"] if both.get("status") == "complete" else None


def table(entries: dict[str, Result]) -> str:
    """What was reached, in Markdown, as far as it was measured, with the mean of the tasks."""
    head = ["bricks", "tool", "bricks", "two arms [s]", "one after the other [s]", "ratio"]
    head += ["one arm [s]", "least distance [mm]"]
    rows: list[list[str]] = []
    for tool in TOOLS:
        for what in BRICKS:
            both, one = (_of(entries, what, who, tool) for who in (BOTH, ARM))
            if not both:
                continue
            part = share(entries, what, tool)
            told = [both["status"], "", ""]
            if part is not None:
                told = [f"{both['robot_s']:.1f}", f"{both['in_turn_s']:.1f}", f"{part:.2f}"]
            alone = one.get("status", "")
            alone = f"{one['robot_s']:.1f}" if alone == "complete" else alone
            apart = f"{1e3 * both['least_distance']:.1f}" if part is not None else ""
            rows.append([what, tool, str(both.get("blocks", "")), *told, alone, apart])
        if found := _shares(entries, tool):
            words = f"mean of {count_words(len(found), 'task')} of APEX-MR"
            rows.append([words, tool, "", "", "", f"{np.mean(found):.2f}", "", ""])
    return "\n".join(table_lines(head, rows, 2))


def _shares(entries: dict[str, Result], tool: str) -> list[float]:
    """Of the tasks that were built."""
    return [part for what in TASKS if (part := share(entries, what, tool)) is not None]


def summary(entries: dict[str, Result]) -> list[tuple[str, str, str]]:
    """What was asked, and what was reached: (what, asked, got)."""
    rows: list[tuple[str, str, str]] = []
    for tool in TOOLS:
        for what in BRICKS:
            both = _of(entries, what, BOTH, tool)
            if not both:
                continue
            part = share(entries, what, tool)
            got = f"{both['status']} ({both['reason']})"
            if part is not None:
                got = f"{both['blocks']} bricks: {both['robot_s']:.1f} s over "
                got += f"{both['in_turn_s']:.1f} s one after the other, {part:.2f}, "
                got += f"{1e3 * both['least_distance']:.1f} mm apart at least"
            rows.append((f"{what}, {tool}", "complete, >= 10 mm apart", got))
        if found := _shares(entries, tool):
            got = f"{np.mean(found):.2f} mean of {len(found)}"
            asked = f"<= {ASKED} mean"
            rows.append((f"APEX-MR, {tool}, at once over one after the other", asked, got))
    return rows
