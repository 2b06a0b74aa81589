"""How much sooner two arms build than one, measured in the dynamic workcell:
``results/two_arms.json``.

Every design is planned once and built by each arm alone and by both together; times are those of
the robots, which are simulated, so that they are the same whenever and wherever they are measured.
How far the arms keep from each other is measured by MuJoCo, from one solid to the other, ten times
a second.
"""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

import math
import time
from typing import Any

import mujoco
import numpy as np

from l2a_lab.builds import EXAMPLES, PLAN_SECONDS, SMALL_FIRST
from l2a_lab.measured import Figures, Result
from l2a_lab.shapes import wall
from learn2assemble.assembly.kit import DEFAULT_KIT, Kit, load_kit
from learn2assemble.cell.carry_out import carry_out
from learn2assemble.cell.site import Site
from learn2assemble.cell.site_arms import SiteArm
from learn2assemble.cell.team import set_up_team
from learn2assemble.cell.together import build_together
from learn2assemble.cell.workcell import Workcell
from learn2assemble.design.cells import CellDesign
from learn2assemble.design.read import read_design
from learn2assemble.planning.plan import Plan
from learn2assemble.planning.tiling.construct import plan_cells
from learn2assemble.simulation.plant import DynamicPlant

ARMS, BOTH = ("ur5e", "panda"), "both"
EVERY, FAR = 50, 0.1
"""Of the steps of a simulation one in so many is looked at, and no distance above this [m]."""
WALLS = {f"wall {x} x {y} x {z}": (x, y, z) for x, y, z in ((10, 2, 3), (16, 2, 5), (16, 2, 9))}
"""Of the kit of bricks: cells along each axis."""


class Watched(DynamicPlant):
    """A cell whose arms' distance MuJoCo measures, from one solid to the other."""

    least = math.inf
    """Of what was looked at [m]; infinite where that was always more than :data:`FAR`."""
    looks = 0

    def _advance(self, moving: frozenset[int]) -> None:
        super()._advance(moving)
        state = self.simulated
        if state.steps % EVERY:
            return
        m, d, world = state.model, mujoco.MjData(state.model), state.world
        d.qpos[:] = state.data.qpos
        mujoco.mj_kinematics(m, d)
        solid = (m.geom_contype | m.geom_conaffinity) > 0
        one, two = (np.flatnonzero(solid & np.isin(world.kind, p.kinds)) for p in world.arms)
        far = (
            np.linalg.norm(d.geom_xpos[one][:, None] - d.geom_xpos[two], axis=2)
            - m.geom_rbound[one][:, None]
            - m.geom_rbound[two]
        )
        for a, b in np.argwhere(far < FAR).tolist():
            gap = mujoco.mj_geomDistance(m, d, int(one[a]), int(two[b]), FAR, None)
            self.least = min(self.least, gap)
        self.looks += 1


def names() -> list[str]:
    """Every measurement: design / who builds it."""
    return [f"{what}/{who}" for what in (*WALLS, *SMALL_FIRST) for who in (*ARMS, BOTH)]


def entry(name: str) -> Result:
    """One measurement by its name."""
    what, who = name.split("/")
    design, kit = _design(what)
    plan = plan_cells(design, kit, seconds=PLAN_SECONDS)
    started = time.process_time()
    if who != BOTH:
        done = carry_out(plan, Workcell(who, "suction"), joint=kit.joint_gap)
        told: Result = {} if done.arm is None else {"robot_s": done.arm.seconds}
    else:
        done, told = _together(plan, kit)
    said = {"status": done.status, "reason": done.reason, "blocks": plan.blocks.used}
    return {**said, **told, "building_s": round(time.process_time() - started, 2)}


def _together(plan: Plan, kit: Kit) -> tuple[Plan, Result]:
    """A build by both arms, and what is told of it."""
    assert plan.assembly is not None
    cells: list[Watched] = []

    def opened(setup: Any) -> Watched:
        cells.append(Watched(setup))
        return cells[-1]

    members = set_up_team(plan.assembly, [SiteArm(arm, arm) for arm in ARMS], Site())
    done = build_together(plan, members, Workcell(ARMS[0]), joint=kit.joint_gap, opened=opened)
    return done, {
        "robot_s": done.robot_s,
        "least_distance": round(cells[0].least, 5) if math.isfinite(cells[0].least) else None,
        "looks": cells[0].looks,
    }


def _design(what: str) -> tuple[CellDesign, Kit]:
    if what in WALLS:
        kit = load_kit("bricks")
        return CellDesign(what, wall(*WALLS[what]), kit.pitch, None, 0.0, None, "", None), kit
    design = read_design(EXAMPLES / what)
    assert isinstance(design, CellDesign)
    return design, load_kit(design.kit or DEFAULT_KIT).at_pitch(design.cell)


def configuration() -> Result:
    """Who builds, and what is looked at."""
    return {"arms": list(ARMS), "looked_at_one_step_in": EVERY, "farthest_looked_at": FAR}


def summary(entries: dict[str, Result]) -> list[tuple[str, str, str]]:
    """What was asked, and what was reached: (what, asked, got)."""
    rows: list[tuple[str, str, str]] = []
    shares: list[float] = []
    for what in dict.fromkeys(name.split("/")[0] for name in entries):
        found = [entries.get(f"{what}/{who}") for who in (*ARMS, BOTH)]
        if any(one is None or one["status"] != "complete" for one in found):
            why = [f"{one['status']} ({one['reason']})" for one in found if one is not None]
            rows.append((what, "complete", ", ".join(why)))
            continue
        *alone, both = (one for one in found if one is not None)
        first = min(one["robot_s"] for one in alone)
        shares.append(both["robot_s"] / first)
        near = both["least_distance"]
        apart = f"{1e3 * (FAR if near is None else near):.0f} mm apart at least"
        words = f"{both['blocks']} blocks: {both['robot_s']:.1f} s over {first:.1f} s, "
        rows.append((what, ">= 10 mm apart", f"{words}{shares[-1]:.2f}, {apart}"))
    if shares:
        rows.append(("two arms over one", "<= 0.62 mean", f"{np.mean(shares):.2f} mean"))
    return rows


FIGURES = Figures("learn2assemble-two-arm-figures", names, entry, configuration, summary)
