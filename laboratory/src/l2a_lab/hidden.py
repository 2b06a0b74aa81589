"""Who gets through hidden errors, by the factor that scales them: ``results/hidden.json``.

Problems are those of environments reset with seeds of their own, not those of the benchmark: the
factor of ``hidden-designs-20`` was chosen on them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from l2a_lab.measured import Figures, Result, table_lines
from learn2assemble.envs.hidden import HiddenEnv
from learn2assemble.envs.hidden_policies import (
    BelievedBlocks,
    PlannerWithoutLooks,
    RepairingPlanner,
    sturdiness,
)
from learn2assemble.tasks.hidden_world import HiddenWorld, exact_numbers
from learn2assemble.tasks.task import HIDDEN_TASKS

TASK = "hidden-designs-20"
FIRST, COUNT = 1000, 40
"""Seeds of the problems."""
FACTORS = (0.0, 0.5, 1.0, 1.4, 2.0, 3.0)


class SturdiestFirst(RepairingPlanner):
    """With repair, but of what may come next what leaves the largest margin."""

    def next_block(self, now: BelievedBlocks, waiting: list[int]) -> int:
        """See :class:`RepairingPlanner`."""
        world = HiddenWorld(now.design, exact_numbers(len(now.design)))
        off = np.where(now.seen[:, None], now.measured, now.commanded)
        for block in np.flatnonzero(now.stands).tolist():
            world.put(block, np.append(now.design.middle[block, :2], 0.0) + off[block])
        # Margins that differ by less than this are one.
        margin = {block: round(sturdiness(world, block), 2) for block in waiting}
        best = max(margin.values())
        return super().next_block(now, [block for block in waiting if margin[block] == best])


PLAYERS: dict[str, Callable[[], RepairingPlanner]] = {
    "with repair": RepairingPlanner,
    "without looks": PlannerWithoutLooks,
    "sturdiest first": SturdiestFirst,
}


def names() -> list[str]:
    """Of all measurements; the last player at the factor of the task alone."""
    own = HIDDEN_TASKS[TASK].factor
    swept = [f"{factor:g}/{who}" for factor in FACTORS for who in ("with repair", "without looks")]
    return [*swept, f"{own:g}/sturdiest first"]


def entry(name: str) -> Result:
    """Scores and completed problems of a player at a factor."""
    factor, _, who = name.partition("/")
    env = HiddenEnv(replace(HIDDEN_TASKS[TASK], factor=float(factor)))
    scores: list[float] = []
    completed = falls = collisions = 0
    for seed in range(FIRST, FIRST + COUNT):
        player = PLAYERS[who]()
        observation, info = env.reset(seed=seed)
        player.begin(env.imagined())
        total, ended = 0.0, False
        while not ended:
            observation, reward, ended, _, info = env.step(player(observation, info))
            total += reward
            falls += info["verdict"] == "falls"
            collisions += info["verdict"] == "collides"
        scores.append(total)
        completed += info["success"]
    return {
        "score": round(float(np.mean(scores)), 4),
        "completed": completed,
        "falls": falls,
        "collisions": collisions,
    }


def configuration() -> Result:
    """Of all measurements."""
    return {"task": TASK, "first_seed": FIRST, "problems": COUNT}


def summary(entries: dict[str, Result]) -> list[tuple[str, str, str]]:
    """The share that the planner with repair completes, beside what was asked."""
    own = f"{HIDDEN_TASKS[TASK].factor:g}/with repair"
    rows: list[tuple[str, str, str]] = []
    for name, one in entries.items():
        asked = "60 to 80 %" if name == own else "say"
        got = f"{one['completed'] / COUNT:.0%} of {COUNT}, score {one['score']:.3f}"
        rows.append((name, asked, got))
    return rows


def page_table(entries: dict[str, Result]) -> str:
    """The sweep as Markdown, as the page of the benchmark has it."""
    own = f"{HIDDEN_TASKS[TASK].factor:g}"
    head = ["factor", "with repair: score", f"completed, of {COUNT}"]
    head += ["without looks: score", "completed"]
    rows: list[list[str]] = []
    for factor in (f"{value:g}" for value in FACTORS):
        repair, blind = (entries[f"{factor}/{who}"] for who in ("with repair", "without looks"))
        told = [
            t for one in (repair, blind) for t in (f"{one['score']:.3f}", f"{one['completed']}")
        ]
        shown = f"**{factor}**" if factor == own else factor
        rows.append([shown, *told])
    return "\n".join(table_lines(head, rows)) + "\n"


FIGURES = Figures("learn2assemble-hidden-figures", names, entry, configuration, summary)
