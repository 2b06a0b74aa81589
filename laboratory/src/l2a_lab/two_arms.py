"""How much sooner two arms build than one, measured in the dynamic workcell:
``results/two_arms.json``.

Every design is built by each arm alone and by both together; times are those of the robots, which
are simulated, so that they are the same whenever and wherever they are measured. How far the arms
keep from each other is measured by another collision library (:mod:`.arm_distances`).
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from l2a_lab import two_arms_bricks
from l2a_lab.arm_distances import MOMENTS, WatchedCell
from l2a_lab.builds import EXAMPLES, PLAN_SECONDS, READINGS, SMALL_FIRST, SUPPLY
from l2a_lab.measured import Figures, Result, table_lines
from l2a_lab.shapes import SHAPES, wall
from l2a_lab.stopped_arm import APART, Job, drawn, stopped
from l2a_lab.structures import script
from l2a_lab.two_arms_bricks import BOTH, BRICKS, WHO
from learn2assemble.acting.carry_out import carry_out
from learn2assemble.assembly.instructions.words import count_words
from learn2assemble.assembly.kit import DEFAULT_KIT, Kit, load_kit
from learn2assemble.cell.reach import Base
from learn2assemble.cell.site import Site
from learn2assemble.cell.site_arms import SiteArm
from learn2assemble.cell.workcell import Workcell
from learn2assemble.design.cells import CellDesign
from learn2assemble.design.read import read_design
from learn2assemble.planning.plan import Plan
from learn2assemble.planning.tiling.construct import plan_cells
from learn2assemble.plants.setup import Disturbance
from learn2assemble.team.crew import Member
from learn2assemble.team.in_turn import build_by_two
from learn2assemble.team.members import plan_by_team, set_up_team

ARMS = ("ur5e", "panda")
WALLS = {f"wall {x} x {y} x {z}": (x, y, z) for x, y, z in ((10, 2, 3), (16, 2, 5), (16, 2, 9))}
"""Of the kit of bricks: cells along each axis."""
CELL = 0.032
"""Edge of a cell of the shapes that follow [m]: a cup has just room on a block of one cell."""
SCALED: dict[str, Callable[[], np.ndarray]] = {
    name: SHAPES[name]
    for name in (
        *("wall-two-windows", "bridge", "house-flat", "dome"),
        *("tower-solid", "house-small", "house-thick"),
    )
}
"""Shapes of the benchmark, of the kit of bricks and lintels."""
EIGHT = ("keep.json", *SCALED)
"""Designs of 40 to 100 blocks: the shipped one and all shapes of the benchmark that have so many
and no props. They were chosen by that, before any of them was built by two arms."""
OTHERS = tuple(what for what in (*WALLS, *SMALL_FIRST) if what not in EIGHT)
SETS = {"others": OTHERS, "eight": EIGHT}
"""By the name that their measurements begin with."""
ASKED = 0.62
"""Of the time of one arm, for the eight."""
LONGEST = 60.0
"""That planning may take [s]."""


class Held(NamedTuple):
    """What is built with one arm holding while the other one brings the next block."""

    file: str
    """Of the example, and its function, ..."""
    made: str
    size: dict[str, float]
    """... with these arguments, a radius among them."""
    builds: int
    """How often, see :data:`SWAY`."""
    density: float | None = None
    """Where it is not the usual one [kg/m^3]."""
    bases: tuple[Base, ...] = ()
    """Of both arms, where they do not stand as they do by themselves."""


HELD = {
    "arch of 9": Held("arch", "arch", {"voussoirs": 9, "radius": 0.3, "thickness": 0.08}, 8),
    "arch of 21": Held(
        "arch", "arch", {"voussoirs": 21, "radius": 0.5, "thickness": 0.14}, 3, 400.0
    ),
    "vault of 45": Held(
        "vaults",
        "barrel_vault",
        {
            "voussoirs": 5,
            "courses": 9,
            "radius": 0.2,
            "thickness": 0.08,
            "course": 0.06,
            "apart": 1e-3,
        },
        3,
        800.0,
        ((0.0, -0.53, 0.0, math.pi / 2), (0.0, 0.5, 0.0, -math.pi / 2)),
    ),
    "dome of 60": Held(
        "dome",
        "dome",
        {
            "rings": 5,
            "voussoirs": 12,
            "radius": 0.25,
            "thickness": 0.08,
            "top": 75.0,
            "key": False,
        },
        3,
        800.0,
        ((-0.6, 0.0, 0.0, 0.0), (0.6, 0.0, 0.0, math.pi)),
    ),
}
WIDE = "suction-wide"
"""The tool of both: the cup of 30 mm slips under what an arch thrusts, and its blocks end so far
from their places that the last one does not go in."""
SWAY = 1e-7
"""Each build has a radius larger by this [m]: where the last blocks come to rest between their
neighbours hangs on less than that, so one build alone says little."""
NOISY, NOISY_SHARE = 20, 0.8
"""How often it is built by what is sensed, and which share of these shall be complete."""
MOST_OFF = 1e-3
"""So far from its place a block may be then [m]."""
STOPPED, STOPPED_SECONDS, STOPS = "pyramid.json", 40.0, 10
"""What is built when an arm is stopped, in how many seconds at least, and how often it is."""


def names() -> list[str]:
    """Every measurement: set / design / who builds it, or its number."""
    built = [
        f"{kind}/{what}/{who}"
        for kind, designs in SETS.items()
        for what in designs
        for who in (*ARMS, BOTH)
    ]
    built += [f"bricks/{what}/{who}" for what in BRICKS for who in WHO]
    built += [f"holds/{what}/{number}" for what in HELD for number in range(HELD[what].builds)]
    built += [f"noise/{next(iter(HELD))}/{number}" for number in range(NOISY)]
    return [*built, *(f"stopped/{STOPPED}/{number}" for number in range(STOPS))]


def entry(name: str) -> Result:
    """One measurement by its name."""
    kind, what, who = name.split("/")
    started = time.process_time()
    if kind == "holds":
        return _holding(what, SWAY * int(who), Workcell(ARMS[0], hands=True), started)
    if kind == "noise":
        return _holding(what, 0.0, _inexact(what, int(who)), started)
    if kind == "bricks":
        return two_arms_bricks.entry(what, who)
    design, kit = _design(what)
    plan = plan_cells(design, kit, seconds=PLAN_SECONDS)
    if kind == "stopped":
        shared, members = _shared(plan, kit)
        job = Job(shared, members, Workcell(ARMS[0]), kit.joint_gap)
        return stopped(job, drawn(STOPS, STOPPED_SECONDS)[int(who)])
    if who != BOTH:
        done = carry_out(plan, Workcell(who, "suction"), joint=kit.joint_gap)
        told: Result = {} if done.arm is None else {"robot_s": done.arm.seconds}
    else:
        done, told = _together(plan, kit, started)
    said = {"status": done.status, "reason": done.reason, "blocks": plan.blocks.used}
    return {**said, **told, "building_s": round(time.process_time() - started, 2)}


def _holding(what: str, radius: float, workcell: Workcell, started: float) -> Result:
    """An arch without falsework as far as two hands go, and how far its blocks are off then.

    Args:
        what: of :data:`HELD`.
        radius: larger by this [m].
        workcell: how it is built.
        started: as of :func:`_together`.
    """
    plan, members = _planned(what, radius)
    done, told = _watched(plan, members, 0.0, started, workcell)
    worst = [one.did.error_worst for one in done.arms if one.did is not None]
    tried = [one.did.attempts for one in done.arms if one.did is not None]
    return {
        "status": done.status,
        "reason": done.reason,
        "blocks": done.blocks.used,
        "holds": sum(step.action == "hold" for step in done.steps),
        "posts": sum(step.action == "place" and step.prop for step in done.steps),
        "attempts": sum(tried),
        **told,
        "error_worst": max((one for one in worst if one is not None), default=None),
        "building_s": round(time.process_time() - started, 2),
    }


@lru_cache(maxsize=1)
def _planned(what: str, radius: float) -> tuple[Plan, list[Member]]:
    """An arch or a vault that is planned with both arms, and these."""
    held = HELD[what]
    size = {**held.size, "radius": held.size["radius"] + radius}
    arch = script(held.file, held.made, **size)()
    if held.density is not None:
        blocks = tuple(replace(block, density=held.density) for block in arch.blocks)
        arch = replace(arch, blocks=blocks)
    arms = [SiteArm(arm, arm, WIDE) for arm in ARMS]
    if held.bases:
        arms = [arm._replace(base=at) for arm, at in zip(arms, held.bases, strict=True)]
    members = set_up_team(arch, arms, Site())
    # The clock is not to decide: seconds of planning are told, not limited.
    options = {"friction": None, "gap": None, "seconds": 10 * LONGEST}
    return plan_by_team(arch, members, options=options), members


def _inexact(what: str, number: int) -> Workcell:
    """A cell in which nothing is exact, as those in which one arm builds (:mod:`.builds`)."""
    rng = np.random.default_rng([number, *what.encode()])
    told = Disturbance(supply=SUPPLY, friction=float(rng.uniform(-0.2, 0.2)), mass=0.1)
    seed = int(rng.integers(2**31))
    return Workcell(ARMS[0], hands=True, seed=seed, noise=READINGS, disturbance=told)


def _together(plan: Plan, kit: Kit, started: float) -> tuple[Plan, Result]:
    """A build by both arms, and what is told of it.

    Args:
        plan: of the tiling; its order is found again, with the arms.
        started: when planning has begun, on the clock of the process [s].
    """
    shared, members = _shared(plan, kit)
    return _watched(shared, members, kit.joint_gap, started)


def _watched(
    plan: Plan,
    members: list[Member],
    joint: float,
    started: float,
    workcell: Workcell | None = None,
) -> tuple[Plan, Result]:
    """The same of a plan that was found with the arms.

    Args:
        joint: width of a vertical joint [m].
        started: as of :func:`_together`.
        workcell: how they build; by default as planned.
    """
    cells: list[WatchedCell] = []
    planned: list[float] = []

    def opened(setup: Any) -> WatchedCell:
        planned.append(time.process_time() - started)
        cells.append(WatchedCell(setup))
        if plan.by_turns:
            cells[-1].places = {piece.id: piece.pose for piece in members[0].job.pieces}
        return cells[-1]

    if not plan.complete:
        return plan, {"planning_s": round(time.process_time() - started, 2)}
    at = workcell or Workcell(ARMS[0], hands=plan.by_turns)
    done = build_by_two(plan, members, at, joint=joint, opened=opened)
    least = cells[0].least()
    return done, {
        "robot_s": done.robot_s,
        "least_distance": round(least.distance, 5),
        "moments": least.moments,
        "planning_s": round(planned[0], 2),
    }


def _shared(plan: Plan, kit: Kit) -> tuple[Plan, list[Member]]:
    """A plan whose order is found again, with both arms; and these."""
    assert plan.assembly is not None
    members = set_up_team(plan.assembly, [SiteArm(arm, arm) for arm in ARMS], Site())
    options = {"friction": None, "gap": kit.joint_gap, "seconds": PLAN_SECONDS}
    return plan_by_team(plan.assembly, members, options=options), members


def _design(what: str) -> tuple[CellDesign, Kit]:
    if what in WALLS or what in SCALED:
        kit = load_kit("bricks")
        if what in SCALED:
            kit = load_kit(DEFAULT_KIT).at_pitch((CELL, CELL, CELL))
        cells = wall(*WALLS[what]) if what in WALLS else SCALED[what]()
        return CellDesign(what, cells, kit.pitch), kit
    design = read_design(EXAMPLES / what)
    assert isinstance(design, CellDesign)
    return design, load_kit(design.kit or DEFAULT_KIT).at_pitch(design.cell)


def configuration() -> Result:
    """Who builds, and what is looked at."""
    return {"arms": list(ARMS), "moments_at_most": MOMENTS}


def beside_one(entries: dict[str, Result], what: str) -> tuple[Result, float | None]:
    """What both arms have done, and the time of the faster one alone [s]; None where neither
    builds it.

    Args:
        what: set / design.
    """
    found = [entries.get(f"{what}/{who}", {}) for who in ARMS]
    alone = [one["robot_s"] for one in found if one.get("status") == "complete"]
    return entries.get(f"{what}/{BOTH}", {}), min(alone, default=None)


def table(entries: dict[str, Result]) -> str:
    """What was reached by both arms, in Markdown, as far as it was measured; designs of 40 to 100
    blocks last, with their mean."""
    head = ("design", "blocks", "two arms [s]", "one [s]", "ratio", "least distance [mm]")
    rows: list[list[str]] = []
    for kind, designs in SETS.items():
        shares: list[float] = []
        for design in designs:
            both, first = beside_one(entries, f"{kind}/{design}")
            if not both:
                continue
            told = [both["status"], "", "", ""]
            if both["status"] == "complete":
                share = None if first is None else both["robot_s"] / first
                shares += [] if share is None else [share]
                alone = ("no arm alone", "") if first is None else (f"{first:.1f}", f"{share:.2f}")
                told = [f"{both['robot_s']:.1f}", *alone, f"{1e3 * both['least_distance']:.1f}"]
            rows.append([design, str(both["blocks"]), *told])
        if kind == "eight" and shares:
            mean = f"mean of {len(shares)} of the eight"
            rows.append([mean, "", "", "", f"{np.mean(shares):.2f}", ""])
    return "\n".join(table_lines(head, rows))


def stops_told(entries: dict[str, Result]) -> str:
    """What came of the builds of which an arm was stopped, in a sentence."""
    stops = [entries[name] for name in entries if name.startswith("stopped/")]
    safe = sum(one["other_safe"] for one in stops)
    complete = sum(one["status"] == "complete" for one in stops)
    least = min(min(one["least_distance"], one["resumed_least_distance"]) for one in stops)
    words = f"Of {len(stops)} such builds, the other arm was safe in {safe}, and {complete} were"
    return f"{words} complete after that; the arms were {1e3 * least:.0f} mm apart at least."


def holds_told(entries: dict[str, Result], what: str = "arch of 9", kind: str = "holds") -> str:
    """What came of the builds in which one arm holds, in some sentences.

    Args:
        what: of :data:`HELD`.
        kind: ``holds``, or ``noise`` of those by what is sensed.
    """
    built = [entries[name] for name in entries if name.startswith(f"{kind}/{what}/")]
    done = [one for one in built if one["status"] == "complete"]
    were = "was" if len(done) == 1 else "were"
    words = f"Of {count_words(len(built), 'build')} of the {what}, {len(done)} {were} complete"
    if not done:
        reasons = {one["reason"] for one in built}
        return f"{words} ({'; '.join(sorted(map(str, reasons)))})."
    most = {what: max(one[what] for one in done) for what in ("holds", "posts", "robot_s")}
    held, posts = (count_words(most[f"{what}s"], what) for what in ("hold", "post"))
    words += f", with {held} and {posts} set by hand at most, in {most['robot_s']:.1f} s at most. "
    off = 1e3 * np.array([one["error_worst"] for one in done])
    words += f"The block that was farthest from its place was {off.max():.2f} mm off at most, "
    words += f"{np.median(off):.2f} mm in the middle of them; {int((off <= 1e3 * MOST_OFF).sum())} "
    least = min(one["least_distance"] for one in done)
    words += f"kept {1e3 * MOST_OFF:g} mm; the arms were {1e3 * least:.0f} mm apart at least."
    return words


def summary(entries: dict[str, Result]) -> list[tuple[str, str, str]]:
    """What was asked, and what was reached: (what, asked, got)."""
    rows: list[tuple[str, str, str]] = []
    shares: dict[str, list[float]] = {}
    asked = f"complete, >= {1e3 * APART:g} mm apart, planned in <= {LONGEST:g} s"
    stops = [entries[name] for name in entries if name.startswith("stopped/")]
    for what in dict.fromkeys(name.rpartition("/")[0] for name in entries):
        kind, _, design = what.partition("/")
        if kind not in SETS:
            continue
        both, first = beside_one(entries, what)
        if both.get("status") != "complete" or first is None:
            why = f"{both.get('status', 'not measured')} ({both.get('reason')})"
            rows.append((design, asked, why if both.get("status") != "complete" else "by two only"))
            continue
        share = both["robot_s"] / first
        shares.setdefault(kind, []).append(share)
        words = f"{both['blocks']} blocks: {both['robot_s']:.1f} s over {first:.1f} s, {share:.2f}"
        apart = f"{1e3 * both['least_distance']:.1f} mm apart at least"
        rows.append((design, asked, f"{words}, {apart}, planned in {both['planning_s']:.1f} s"))
    for what in HELD:
        asked = f"complete, no post, <= {1e3 * MOST_OFF:g} mm, >= {1e3 * APART:g} mm apart"
        for kind, more in {"holds": asked, "noise": f">= {NOISY_SHARE:.0%} complete"}.items():
            if any(name.startswith(f"{kind}/{what}/") for name in entries):
                told = f"{what}, one holds while the other one builds"
                told += ", by what is sensed" if kind == "noise" else ""
                rows.append((told, more, holds_told(entries, what, kind)))
    rows += two_arms_bricks.summary(entries)
    for kind, found in shares.items():
        mean = f"{np.mean(found):.2f} mean of {len(found)}"
        rows.append((f"two arms over one, {kind}", f"<= {ASKED} mean", mean))
    if stops:
        safe = sum(one["other_safe"] for one in stops)
        complete = sum(one["status"] == "complete" for one in stops)
        got = f"{safe} of {len(stops)}, {complete} of {len(stops)}"
        rows.append(("one arm stopped: other one safe, resumed and complete", ">= 9 of 10", got))
    return rows


FIGURES = Figures("learn2assemble-two-arm-figures", names, entry, configuration, summary)
