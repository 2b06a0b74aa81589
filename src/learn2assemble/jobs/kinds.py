"""Each kind of what is built: what it has a use for, and its way to a plan and through an arm."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from learn2assemble.assembly.blocks import Assembly
from learn2assemble.assembly.kit import DEFAULT_KIT, Kit, load_kit
from learn2assemble.design.cells import CellDesign
from learn2assemble.design.goals import Goals
from learn2assemble.errors import (
    InputError,
    check_arguments,
    check_name,
    look_up,
)
from learn2assemble.planning.plan import Plan
from learn2assemble.planning.tiling.planners import EXACT, PLANNERS, PlannerChoice
from learn2assemble.robot.registry import ARMS, TOOLS

if TYPE_CHECKING:
    from learn2assemble.acting.carry_out import Workcell
    from learn2assemble.cell.site import Site
    from learn2assemble.cell.site_arms import SiteArm
    from learn2assemble.cell.workcell import StepOf
    from learn2assemble.team.crew import Member


DEFAULT_TOOL, FINGERS = "suction", "gripper"
"""Of an arm that carries out an exact plan: with fingers, blocks cannot stand close; but what has
studs is held by fingers, or by a socket."""


PLANNED = "kinematic"
PHYSICS = ("dynamic", PLANNED)
"""Cells in which arms carry out exact plans; in the second one two arms are planned for alone."""


class Help(NamedTuple):
    """What may help blocks to stand; fields as the arguments of :func:`build`."""

    supports: str
    holds: int
    hands: bool
    shell: int | None


class ArmChoice(NamedTuple):
    """How arms carry out an exact plan; fields as the arguments of :func:`build`."""

    arms: tuple[str, ...]
    tool: str | None
    layout: str | Path | Site | None
    physics: str
    noise: tuple[float, float]
    state: Path | None
    seed: int

    def check(self) -> None:
        """Refuse what cannot be, before libraries load. A layout may have names of its own."""
        for name in self.arms if self.layout is None else ():
            check_name("arm", name, ARMS)
        if self.tool is not None:
            check_name("tool", self.tool, TOOLS)
        check_name("physics", self.physics, PHYSICS)

    def read(self, design: Assembly | CellDesign | Goals, kit: Kit | None) -> ArmChoice:
        """The same with the layout read, and looked at as far as that goes before planning.

        Raises:
            InputError: also for arms it has not, and kinds of blocks that are not in the kit.
        """
        from learn2assemble.cell.site import check_kinds

        how = self._replace(layout=self._site())
        _, site = how.team()
        if isinstance(design, CellDesign) and (own := kit_of(design, kit)).joint.law == "dry":
            check_kinds(site, {kind.name for kind in own.kinds})
        return how

    @property
    def several(self) -> bool:
        """Whether more than one arm builds."""
        return len(self.arms) > 1

    def team(self) -> tuple[list[SiteArm], Site]:
        """The arms by name, and the layout without them."""
        from learn2assemble.cell.site_arms import named_arms

        site = self._site()
        return named_arms(self.arms, self.tool, site.arms), replace(site, arms=())

    def workcell(self, studs: float = 0.0) -> Workcell:
        """That of one arm with defaults, the layout read.

        Args:
            studs: of the blocks, how far apart they are [m]; 0: they have none.
        """
        from learn2assemble.acting.carry_out import Workcell

        (one, *_), site = self.team()
        if one.base is not None:
            site = replace(site, base=one.base)
        if one.magazines is not None:
            site = replace(site, magazines=tuple(site.magazines[n] for n in one.magazines))
        if site.cameras and any(self.noise):
            names = ", ".join(camera.name for camera in site.cameras)
            raise InputError("noise", self.noise, f"none: blocks are seen by {names}")
        tool = _tool(one, studs)
        return Workcell(one.arm, tool, site, self.physics, self.seed, self.noise, log=self.state)

    def _site(self) -> Site:
        """The layout, read."""
        from learn2assemble.cell.site import Site, read_site

        site = Site() if self.layout is None else self.layout
        if isinstance(site, str | Path):
            site = read_site(Path(site))
        if not isinstance(site, Site):  # pyright: ignore[reportUnnecessaryIsInstance]
            raise InputError("layout", site, "a layout (docs/layouts.md) or its file")
        return site


def _tool(one: SiteArm, studs: float) -> str:
    """What an arm holds blocks with: where they have studs fingers, or a socket where it has none.

    Args:
        studs: how far apart they are [m]; 0: there are none.

    Raises:
        InputError: for a tool that was asked for and is none for such blocks.
    """
    from learn2assemble.cell.reach import check_tool, with_other_tools
    from learn2assemble.robot.arm import get_arm, load_arm
    from learn2assemble.robot.registry import ARMS

    tool = one.tool
    if tool is None:
        tool = DEFAULT_TOOL
        if studs and load_arm(look_up("arm", one.arm, ARMS)).gripper.fingers:
            tool = FINGERS
        elif studs:
            tool = next(iter(with_other_tools(get_arm(one.arm, DEFAULT_TOOL), studs)), DEFAULT_TOOL)
    check_tool(get_arm(one.arm, tool), studs)
    return tool


def with_tools(arms: list[SiteArm], studs: float) -> list[SiteArm]:
    """The arms with what holds blocks whose studs are so far apart [m]; as they are where there are
    none (0)."""
    return [one._replace(tool=_tool(one, studs)) for one in arms] if studs else arms


def check_asked(
    design: Assembly | CellDesign | Goals, kit: Kit | None, help_: Help, planner: str
) -> None:
    """Refuse what a kind of design has no use for."""
    given, clutch = isinstance(design, Assembly), False
    if isinstance(design, CellDesign):
        clutch = kit_of(design, kit).joint.law == "clutch"
    elif planner != EXACT:
        words = "blocks that are given" if given else "goals instead of a design"
        raise InputError("planner", planner, f"exact, for {words}")
    _, holds, hands, shell = help_
    if shell is not None and not clutch:
        raise InputError("shell", shell, "a design of cells and a kit that clutches, such as lego")
    if not (given or clutch):
        none = "none; they are for given blocks and bricks that clutch"
        check_arguments(
            help_._asdict(),
            ("holds", not holds, none),
            ("hands", not hands, none),
            (
                "supports",
                help_.supports != "posts",
                "auto, none or props; posts carry given blocks",
            ),
        )


def check_laid(
    design: Assembly | CellDesign | Goals,
    kit: Kit | None,
    gap: float | tuple[float, float] | None,
) -> None:
    """Refuse to prove an arm's build for other vertical joints [m] than those it lays."""
    if isinstance(design, Assembly):
        laid, source = 0.0, "as blocks are given"
    else:
        blocks = design.kit if isinstance(design, Goals) else kit_of(design, kit)
        laid, source = blocks.joint_gap, "the joint_gap of its kit"
    if gap is not None and set(np.ravel(gap).tolist()) != {laid}:
        raise InputError("gap", gap, f"none with an arm, which lays joints of {laid:g} m, {source}")


def goals_plan(
    goals: Goals, workcell: Workcell | None, planner: PlannerChoice, given: dict[str, Any]
) -> Plan:
    from learn2assemble.planning.goals.planner import plan_goals

    plan = plan_goals(goals, seed=planner.seed, **given)
    if workcell is None:
        return plan
    from learn2assemble.acting.carry_out import carry_out
    from learn2assemble.cell.site import with_obstacles

    workcell = replace(workcell, site=with_obstacles(workcell.site, goals))
    joint = goals.kit.joint_gap
    return carry_out(plan, workcell, joint=joint, progress=given["progress"])


def blocks_plan(
    blocks: Assembly, workcell: Workcell | None, help_: Help, given: dict[str, Any]
) -> Plan:
    """The plan of given blocks, with a note where the unit of their sizes is in doubt."""
    from learn2assemble.assembly.instructions.appearance import unit_doubt

    plan = _blocks_plan(blocks, workcell, help_, given)
    if not (doubt := unit_doubt(blocks)):
        return plan
    note = "; ".join(filter(None, (plan.design.note, doubt)))
    return replace(plan, design=replace(plan.design, note=note))


def _blocks_plan(
    blocks: Assembly, workcell: Workcell | None, help_: Help, given: dict[str, Any]
) -> Plan:
    from learn2assemble.planning.brick_plan import plan_for_arm
    from learn2assemble.planning.given import plan_assembly, supports_called

    supports, holds, hands, _ = help_
    if workcell is not None:
        workcell = _for_given(blocks, workcell)  # What no tool can hold is said before planning.
    if workcell is None or not blocks.holds:
        arm = workcell is not None
        by = supports_called(supports, holds, hands, table=True) if arm else supports
        plan = plan_assembly(blocks, supports=by, holds=holds, hands=hands, **given)
        if workcell is None:
            return plan
    else:
        _check_pressed(blocks, supports)
        plan = plan_for_arm(blocks)
    from learn2assemble.acting.carry_out import carry_out

    return carry_out(plan, workcell, joint=0.0, progress=given["progress"])


def bricks_plan(
    design: CellDesign,
    kit: Kit,
    workcell: Workcell | None,
    help_: Help,
    planner: PlannerChoice,
    given: dict[str, Any],
) -> Plan:
    from learn2assemble.linear_programs import Clock
    from learn2assemble.planning.brick_plan import plan_for_arm
    from learn2assemble.planning.sequence import Supports
    from learn2assemble.planning.tiling.cover.bricks import plan_brick_cells

    if np.allclose(design.cell, kit.pitch, rtol=1e-6):
        kit = with_plates(kit)
    _check_bricks(design, kit, help_, given, planner.name)
    _, holds, hands, shell = help_
    bricks = Supports(holds=max(holds, 1) if hands else holds, hands=hands)
    clock, progress = Clock(given["seconds"]), given["progress"]
    plan = plan_brick_cells(design, kit, bricks, clock, progress, shell=shell, seed=planner.seed)
    if workcell is None or plan.assembly is None or not plan.complete:
        return plan
    from learn2assemble.acting.carry_out import carry_out

    ordered = replace(
        plan_for_arm(plan.assembly),
        design=plan.design,
        kit=plan.kit,
        cells=plan.cells,
        seconds=plan.seconds,
        planning_s=plan.planning_s,
    )
    return carry_out(ordered, _for_given(plan.assembly, workcell), joint=0.0, progress=progress)


def cells_plan(
    design: CellDesign,
    kit: Kit,
    workcell: Workcell | None,
    props: bool,
    planner: PlannerChoice,
    given: dict[str, Any],
) -> Plan:
    from learn2assemble.planning.tiling.construct import plan_cells

    # Blocks are as large as the cells that were asked for.
    kit = kit.at_pitch(design.cell)

    def plan_with(blocks: Kit, hand: Any = None) -> Plan:
        options: dict[str, Any] = given if blocks is kit else {**given, "gap": None}
        return plan_cells(
            design, blocks, props=props, planner=replace(planner, hand=hand), **options
        )

    if workcell is None:
        return plan_with(kit)
    if kit.joint.law != "dry":
        raise InputError("kit", kit.name, "dry blocks, for an arm: it lays no mortar")
    by_arm = PLANNERS[planner.name].carry_out
    if by_arm is not None:
        return by_arm(plan_with, design.wanted, kit, workcell, given["progress"])
    from learn2assemble.acting.carry_out import carry_out_cells

    return carry_out_cells(plan_with(kit), kit, workcell, given["progress"], plan_with)


def _for_given(design: Assembly, workcell: Workcell) -> Workcell:
    """How an arm builds blocks that are given, of which it can hold every one: with posts by hand
    where it cannot set them.

    Raises:
        InputError: for blocks that the tool cannot hold at any face.
    """
    from learn2assemble.cell.pieces import pieces_of
    from learn2assemble.cell.reach import check_held
    from learn2assemble.robot.arm import get_arm

    pieces = [
        p
        for p, b in zip(pieces_of(design), design.blocks, strict=True)
        if not (b.support or b.prop)
    ]
    check_held(get_arm(workcell.arm, workcell.tool), pieces, design.joint.studs)
    return replace(workcell, hands=True)


def team_plan(
    design: Assembly | CellDesign | Goals,
    kit: Kit | None,
    how: ArmChoice,
    help_: Help,
    planner: PlannerChoice,
    given: dict[str, Any],
) -> Plan:
    """The plan by which several arms build, which hold for one another, and but for
    ``physics="kinematic"`` the build.

    Raises:
        InputError: for goals and mortar, and for arms that cannot build it together.
    """
    from learn2assemble.team.in_turn import build_by_two
    from learn2assemble.team.members import plan_by_team
    from learn2assemble.team.pair import bricks_by_team, shared_by_team

    if isinstance(design, Goals):
        raise InputError("goals", f"{len(how.arms)} arms", "one arm, or a design")
    studs = studs_of(design, kit)
    options = {name: value for name, value in given.items() if name != "progress"}
    posts, progress = help_.supports != "none", given["progress"]

    def built(assembly: Assembly, joint: float) -> Plan:
        members, cell = _team(assembly, how, studs, progress)
        order: tuple[StepOf, ...] | None = None
        if studs:
            plan, order = bricks_by_team(assembly, members, cell, progress)
        else:
            plan = plan_by_team(assembly, members, posts=posts, options=options, progress=progress)
        if how.physics == PLANNED and plan.complete and order is not None:
            return shared_by_team(plan, members, cell, order)
        if how.physics == PLANNED or not plan.complete:
            return plan
        return build_by_two(plan, members, cell, joint=joint, progress=progress, order=order)

    if isinstance(design, Assembly):
        if studs:
            _check_pressed(design, help_.supports)
        return built(design, 0.0)
    kit = kit_of(design, kit)
    if studs:
        plan = bricks_plan(design, kit, None, help_, planner, given)
    else:
        plan = cells_plan(design, kit, None, posts, planner, given)
    if not plan.complete or plan.assembly is None:
        return plan
    if options["gap"] is None:
        options["gap"] = kit.joint_gap  # Side faces carry nothing.
    found = built(plan.assembly, kit.joint_gap)
    return replace(
        found,
        design=plan.design,
        kit=plan.kit,
        cells=plan.cells,
        planner=plan.planner,
        seconds=round(plan.seconds + found.seconds, 3),
        planning_s=plan.planning_s,
    )


def rebuilt_by(how: ArmChoice, plan: Plan, joint: float, progress: Callable[[str], None]) -> Plan:
    """A plan from a structure that stands, carried out by one arm or two: every block goes to a
    magazine of its kind, and comes from there.

    Args:
        plan: of :func:`learn2assemble.planning.rebuilding.rebuild.rebuild`.
        joint: width of a vertical joint [m].

    Raises:
        InputError: for what the arms cannot hold or reach.
    """
    from learn2assemble.acting.carry_out import carry_out
    from learn2assemble.planning.rebuilding.rebuild import with_copies
    from learn2assemble.team.in_turn import build_by_two
    from learn2assemble.team.members import told_of

    if not plan.complete or plan.assembly is None:
        return plan
    plan = with_copies(plan)
    if not how.several:
        return carry_out(plan, how.workcell(), joint=joint, progress=progress)
    assert plan.assembly is not None
    members, cell = _team(plan.assembly, how, 0.0, progress)
    plan = replace(plan, arms=told_of(members))
    return build_by_two(plan, members, cell, joint=joint, progress=progress)


def _team(
    assembly: Assembly, how: ArmChoice, studs: float, progress: Callable[[str], None]
) -> tuple[list[Member], Workcell]:
    """Two arms in their cell, and how they build.

    Args:
        studs: of the blocks, how far apart they are [m]; 0: they have none.
    """
    from learn2assemble.cell.workcell import Workcell
    from learn2assemble.team.members import set_up_team

    arms, site = how.team()
    if site.cameras:
        raise InputError("layout", "cameras", "none, for several arms")
    progress("looking where the arms stand and where blocks wait")
    members = set_up_team(assembly, with_tools(arms, studs), site, progress)
    first = members[0].job.arm
    name, tool = first.name, first.tool_name
    physics, seed, noise = how.physics, how.seed, how.noise
    return members, Workcell(name, tool, site, physics, seed, noise, log=how.state, hands=True)


def kit_of(design: CellDesign, kit: Kit | None) -> Kit:
    """The kit that a design of cells is built with."""
    return kit or load_kit(design.kit or DEFAULT_KIT)


def with_plates(kit: Kit | None) -> Kit:
    """The kit, with plates in its designs.

    Raises:
        InputError: for one whose blocks do not clutch.
    """
    if kit is None or kit.joint.law != "clutch":
        got = "no kit" if kit is None else f"kit {kit.name}"
        raise InputError("plates", got, "a kit of bricks that clutch, such as lego (`kit=`)")
    return replace(kit, plates=True)


def _check_bricks(
    design: CellDesign,
    kit: Kit,
    help_: Help,
    given: Mapping[str, Any],
    planner: str,
) -> None:
    """Refuse what bricks that clutch do not take."""
    if not np.allclose(design.cell, kit.cell, rtol=1e-6):
        raise InputError("cell", list(design.cell), f"cells of kit {kit.name}, {list(kit.cell)} m")
    for name in ("gap", "friction"):
        if given[name] is not None:
            raise InputError(name, given[name], f"none: bricks of kit {kit.name} clutch")
    if help_.supports in ("props", "posts"):
        raise InputError("supports", help_.supports, f"hands: bricks of kit {kit.name} clutch")
    if planner != EXACT:
        raise InputError("planner", planner, f"exact, for bricks of kit {kit.name}")


def studs_of(design: Assembly | CellDesign | Goals, kit: Kit | None) -> float:
    """How far apart the studs are of what a design is built of [m]; 0: it does not clutch."""
    if isinstance(design, Goals):
        return 0.0
    joint = kit_of(design, kit).joint if isinstance(design, CellDesign) else design.joint
    return joint.studs


def _check_pressed(blocks: Assembly, supports: str) -> None:
    """Refuse joints that an arm cannot make, and help that bricks do not take."""
    if blocks.joints or blocks.joint.law != "clutch":
        laws = ", ".join(sorted({joint.law for joint in blocks.laws}))
        raise InputError("joints", laws, "clutch alone, for an arm: it lays no mortar")
    if supports == "posts":
        raise InputError("bricks that clutch", "posts", "parts that are built beside to help them")
