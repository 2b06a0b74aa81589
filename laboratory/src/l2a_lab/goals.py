"""Goals without a drawing, measured on fixed tasks: ``results/goals.json``.

Every entry is a player and a task. Players are the search, whose plan an arm then carries out in
the dynamic cell, and the exact program; ``optimum`` is the program without a limit of its own,
asked again and again for fewer blocks than are known.
"""

from __future__ import annotations

import time

from l2a_lab.measured import Figures, Result
from learn2assemble.acting.carry_out import Workcell, carry_out
from learn2assemble.cell.site import with_obstacles
from learn2assemble.errors import InputError
from learn2assemble.linear_programs import Clock
from learn2assemble.planning.goals.planner import (
    EXACT,
    SEARCH,
    plan_goals,
    prepare,
)
from learn2assemble.planning.goals.program import MOST, plan_program
from learn2assemble.planning.goals.search import search
from learn2assemble.planning.plan import Plan
from learn2assemble.tasks.goals import (
    IMPOSSIBLE,
    PLANAR,
    SPATIAL,
    fixed_goals,
    fixed_names,
)

PLAYERS = ("search", "program", "optimum")
SECONDS = {PLANAR: 10.0, SPATIAL: 30.0, IMPOSSIBLE: 30.0}
"""Limits of a search, in processor time."""
PROGRAM_SECONDS = OPTIMUM_SECONDS = 60.0
"""Limits of the program, on the clock: more than a search has, for where other programs run."""
ARM = "panda"


def names() -> list[str]:
    """Every measurement: player / task."""
    return [
        f"{player}/{task}"
        for player in PLAYERS
        for task in fixed_names()
        if player != "optimum" or not task.startswith(IMPOSSIBLE)
    ]


def configuration() -> Result:
    """Limits of the players, and the arm."""
    return {
        "seconds": SECONDS,
        "program_seconds": PROGRAM_SECONDS,
        "optimum_seconds": OPTIMUM_SECONDS,
        "arm": ARM,
        "tool": "suction",
    }


def entry(name: str) -> Result:
    """One measurement by its name."""
    player, task = name.split("/", 1)
    goals, seconds = fixed_goals(task), SECONDS[task.split("/")[0]]
    if player == "optimum":
        return _optimum(task)
    started = time.process_time()
    way = SEARCH
    if player == "program":
        way, seconds = EXACT, PROGRAM_SECONDS
    try:
        plan = plan_goals(goals, ways=(way,), seconds=seconds, timer=time.process_time)
    except InputError as error:
        return {"status": "refused", "reason": str(error), "blocks": 0}
    planned = time.process_time() - started
    stages = plan.search.attempts if plan.search else ()
    result: Result = {
        "status": plan.status,
        "reason": plan.reason,
        "blocks": plan.blocks.used,
        "planning_cpu_s": round(planned, 2),
        "margin_g": plan.margin_g,
        "stages": [f"{stage.stage}: {stage.result} ({stage.seconds:.2f} s)" for stage in stages],
    }
    if player == "search" and plan.complete:
        result["arm"] = _by_arm(task, plan)
    return result


def _by_arm(task: str, plan: Plan) -> Result:
    goals = fixed_goals(task)
    workcell = Workcell(ARM)
    try:
        done = carry_out(
            plan,
            Workcell(ARM, site=with_obstacles(workcell.site, goals)),
            joint=goals.kit.joint_gap,
        )
    except InputError as error:
        return {"status": "refused", "reason": str(error)}
    arm = done.arm
    return {
        "status": done.status,
        "reason": done.reason,
        "attempts": arm.attempts if arm else None,
        "robot_s": arm.seconds if arm else None,
        "error_worst": arm.error_worst if arm else None,
    }


def _optimum(task: str) -> Result:
    """The fewest blocks there are, where that can be proven in time."""
    problem, _ = prepare(fixed_goals(task))
    clock = Clock(OPTIMUM_SECONDS)
    best = search(problem, seconds=3.0, timer=time.process_time).blocks or MOST + 1
    bound = 1
    while clock.left > 0:
        exact = plan_program(problem, seconds=clock.left, most=best - 1)
        bound = max(bound, exact.bound)
        if exact.status == "infeasible":
            return {"status": "optimal", "blocks": best, "bound": best}
        if not exact.placements:
            break
        best = len(exact.placements)
    return {"status": "bounds", "blocks": best if best <= MOST else 0, "bound": min(bound, best)}


def summary(entries: dict[str, Result]) -> list[tuple[str, str, str]]:
    """What was asked, and what was reached: (what, asked, got)."""

    def tasks(of: str) -> dict[str, Result]:
        return {name.split("/", 1)[1]: one for name, one in entries.items() if name.startswith(of)}

    rows: list[tuple[str, str, str]] = []
    best = {task: one for task, one in tasks("optimum/").items() if one["status"] == "optimal"}
    for player in PLAYERS[:2]:
        for kind, asked in ((PLANAR, ">= 28 of 30"), (SPATIAL, ">= 17 of 20")):
            mine = tasks(f"{player}/{kind}/")
            if not mine:
                continue
            done = {task: one for task, one in mine.items() if one["status"] == "complete"}
            left = ", ".join(sorted(set(mine) - set(done))) or "none"
            rows.append(
                (
                    f"{player}: {kind} tasks solved",
                    asked,
                    f"{len(done)} of {len(mine)}; not: {left}",
                )
            )
            ratio = [done[task]["blocks"] / best[task]["blocks"] for task in done if task in best]
            if ratio:
                rows.append(
                    (
                        f"{player}: {kind} blocks by the optimum, where it is known",
                        "<= 1.15",
                        f"{sum(ratio) / len(ratio):.3f} on average, {max(ratio):.2f} at most, "
                        f"{sum(r > 1.15 for r in ratio)} of {len(ratio)} above",
                    )
                )
            armed = [one["arm"]["status"] for one in done.values() if "arm" in one]
            if armed:
                count = armed.count("complete")
                rows.append(
                    (
                        f"{player}: {kind} built by the {ARM}",
                        ">= 80 %",
                        f"{count} of {len(armed)} ({count / len(armed):.0%})",
                    )
                )
        cannot = [one["status"] for one in tasks(f"{player}/{IMPOSSIBLE}").values()]
        if cannot:
            wrong, told = cannot.count("complete"), cannot.count("refused")
            words = f"{wrong} complete, {told} of {len(cannot)} refused with a reason"
            rows.append((f"{player}: impossible tasks", "none complete", words))
    return rows


FIGURES = Figures("learn2assemble-goals-figures", names, entry, configuration, summary)
