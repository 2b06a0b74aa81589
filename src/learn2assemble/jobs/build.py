"""The main job: from a design to a plan, every step of which is proven or carried out by an arm.

The exact planner (:mod:`~learn2assemble.planning.tiling.construct`) fills the cells of a design
with the blocks of a kit, or the learned builder does where it is asked to, and an arm carries that
out where one is named. The agent of the paper builds random problems of its tasks
(:mod:`~learn2assemble.tasks.episode`).
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeGuard, cast

import numpy as np

from learn2assemble.assembly.blocks import Assembly
from learn2assemble.assembly.kit import Kit, load_kit
from learn2assemble.design.cells import CellDesign
from learn2assemble.design.files import open_design
from learn2assemble.design.goals import Goals
from learn2assemble.errors import InputError, check_arguments, check_name, is_number, is_whole
from learn2assemble.jobs.kinds import (
    PHYSICS,
    PLANNED,
    ArmChoice,
    Help,
    blocks_plan,
    bricks_plan,
    cells_plan,
    check_asked,
    check_laid,
    goals_plan,
    kit_of,
    rebuilt_by,
    studs_of,
    team_plan,
    with_plates,
    with_tools,
)
from learn2assemble.jobs.problems import NO_ARM, PROBLEMS
from learn2assemble.planning.plan import Plan
from learn2assemble.planning.tiling.planners import EXACT, PLANNERS, PlannerChoice
from learn2assemble.robot.registry import ARMS
from learn2assemble.statics.proofs import Bounds, value_range

if TYPE_CHECKING:
    from learn2assemble.cell.reach import ReachReport
    from learn2assemble.cell.site import Site
    from learn2assemble.team.members import TeamReach

SUPPORTS = ("auto", "none", "props", "posts")
"""What may carry blocks until they carry themselves."""
OF_AN_ARM = ("tool", "layout", "state", "physics", "noise")
"""What may be asked where an arm builds."""
AGENT_SECONDS, EXACT_SECONDS = 20.0, 60.0
"""Limits of the widest search of a task, and of planning a design with its proof [s]."""
Progress = Callable[[str], None]


def build(
    design: str | Path | np.ndarray | CellDesign | Goals | Assembly,
    *,
    planner: str | None = None,
    kit: str | Kit | None = None,
    friction: float | tuple[float, float] | None = None,
    gap: float | tuple[float, float] | None = None,
    supports: str = "auto",
    holds: int = 0,
    hands: bool = False,
    shell: int | None = None,
    plates: bool = False,
    arm: str | Sequence[str] | None = None,
    agent: str | Path | object | None = None,
    layout: str | Path | Site | None = None,
    seed: int = 0,
    seconds: float | None = None,
    progress: Progress = lambda text: None,
    tool: str | None = None,
    physics: str = "dynamic",
    noise: tuple[float, float] = (0.0, 0.0),
    state: Path | None = None,
    old: str | Path | Assembly | None = None,
    **reading: Any,
) -> Plan:
    """Plan a design and prove every step.

    Of a design, the exact planner or the learned builder chooses the blocks and their order, and
    every state is proven to be in static equilibrium; a simulated arm carries that out where one is
    named. A random problem of a task is built by the agent of the paper with its search.

    Args:
        design: a design, its file or its cells as an array (``docs/design_files.md``), goals
            instead of a design or their file (``docs/goals.md``), an assembly of given blocks, or
            the name of a task, of which a random problem is built.
        planner: of a design, ``"exact"``; ``"agent"``: the learned builder with its search alone
            of the laboratory; by default the builder where one is named, else exact. Goals and
            tasks have their own.
        kit: for designs of cells, a kit, its name or its file; by default the one the design
            names, else ``bricks-lintels``.
        friction: coefficient, or the range to prove every step for; by default the kit's.
        gap: width of vertical joints [m], or the range to prove every step for; with an arm,
            none but what it lays.
        supports: what may carry blocks until they carry themselves: ``"auto"``; ``"none"``;
            ``"props"``, blocks of the kit, for designs of cells and goals; ``"posts"``, cut to
            the blocks they carry, for assemblies.
        holds: of an assembly, how many blocks a hand may hold while the next one comes.
        hands: of bricks that clutch, whether they may come from below, and several as one, built
            beside; a hand then holds one while the next one comes.
        shell: of a design of bricks that clutch, how many cells its walls are thick; by default it
            is not hollow.
        plates: of a design and a kit of bricks that clutch, whether cells are as high as a plate,
            and plates fill it where bricks do not; else cells are as high as a brick.
        arm: name of the arm that builds; by default none, for a task its own. Two names, also the
            same twice: both build dry blocks in one cell; with ``physics="kinematic"`` they are
            planned for alone, one of which may hold while the other one places.
        agent: of a design, a builder by name or ``.safetensors`` file; of a task, an agent, a
            shipped one by name, a ``.safetensors`` file or the folder of a training; by default one
            that knows problems like this.
        layout: where the blocks wait for the arm (``docs/layouts.md``); by default around the
            building site.
        seed: of the search, and of the problem of a task.
        seconds: limit of planning and proof, or of the widest search of a task [s]; by default
            60 and 20.
        progress: called with a line of text for everything that takes long, and every 1.5 s with
            how far it has come, the best so far and the time that is left.
        tool: what the arm holds blocks with, ``"suction"`` (the default), ``"suction-side"``,
            ``"suction-wide"`` or ``"gripper"``; of bricks with studs ``"gripper"`` (the default),
            ``"socket"`` or, of large ones, ``"socket-large"``.
        physics: in which cell an exact plan is carried out, ``"dynamic"`` or ``"kinematic"``.
        noise: standard deviations of what is read of blocks while an exact plan is carried out:
            along each axis [m], about each axis [rad].
        state: file to which an exact plan's build by an arm appends every attempt; where it
            exists, the build goes on from it.
        old: a structure of dry blocks that stands already, or its file (:func:`~learn2assemble.
            assembly.files.read_assembly`): the plan begins with it and turns it into the design
            with its own blocks (:func:`~.rebuild.rebuild`): a drawing is
            filled with those alone, with others of their kinds, or with any of the kit, whichever
            takes the fewest moves. One arm or two may carry it out, by way of magazines.
        reading: how to read a file or an array: ``unit``, ``cell``, ``size``, ``up``, ``depth``,
            ``cells_wide``, ``repair``, ``blocks``, ``colours``, see
            :class:`learn2assemble.design.reading.Reading`.

    Returns:
        The plan: complete, incomplete or refused. With an arm, its motion is ``plan.record``; with
        two, theirs are ``plan.records``.

    Raises:
        InputError: for a design, arm, agent or layout that cannot be used.
    """
    # What can be refused at once comes before the libraries that take seconds to load.
    if planner is not None:
        check_name("planner", planner, PLANNERS)
    check_name("supports", supports, SUPPORTS)
    _check_values(noise=noise, holds=holds, seed=seed, seconds=seconds, progress=progress)
    _check_names(build, reading)
    arms = arm_names(arm)
    asked = {
        "kit": kit,
        "friction": friction,
        "gap": gap,
        "layout": layout,
        "tool": tool,
        "state": state,
        "supports": None if supports == "auto" else supports,
        "holds": holds or None,
        "hands": hands or None,
        "shell": shell,
        "plates": plates or None,
        "old": old,
        "noise": noise if any(noise) else None,
        "physics": None if physics == PHYSICS[0] else physics,
        **reading,
    }
    if is_task(design):
        if planner == EXACT:
            raise InputError("planner", EXACT, f"agent, for the task {design}")
        _refuse(asked, f"a design (not the task {design})")
        for name in arms:
            check_name("arm", name, (*ARMS, NO_ARM))
        if len(arms) > 1:
            raise InputError("arm", f"{len(arms)} arms", f"one, for the task {design}")
        limit = AGENT_SECONDS if seconds is None else seconds
        own = arms[0] if arms else None
        return PROBLEMS[design].build(
            arm=own, agent=agent, seed=seed, seconds=limit, progress=progress
        )
    source = Path(design).name if isinstance(design, str | Path) else ""
    opened = open_design(design, PROBLEMS) if isinstance(design, str | Path) else design
    if agent is not None:
        planner = planner or "agent"
        agent = PLANNERS[planner].resolve_agent(agent)
    choice = PlannerChoice(planner or EXACT, agent, seed)
    how = None
    standing = None if old is None else _read_old(old, reading.get("unit"))
    if standing is not None:
        alone = "where a structure stands, nothing is held and no prop comes"
        check_arguments(
            {"holds": holds, "hands": hands, "supports": supports},
            ("holds", not holds, f"none: {alone}"),
            ("hands", not hands, f"none: {alone}"),
            ("supports", supports in ("auto", "none"), f"auto or none: {alone}"),
        )
    if standing is not None and len(arms) > 1 and physics == PLANNED:
        got = f"{physics}, for two arms where a structure stands"
        raise InputError("physics", got, PHYSICS[0])
    if arms:
        how = ArmChoice(arms, tool, layout, physics, noise, state, seed)
        how.check()
    else:
        _refuse({name: asked[name] for name in OF_AN_ARM}, "an arm to build with (`arm=`)")
    limit = EXACT_SECONDS if seconds is None else seconds
    given = {"friction": friction, "gap": gap, "progress": progress, "seconds": limit}
    if shell is not None and not is_whole(shell, 1, 64):
        raise InputError("shell", shell, "a whole number of cells from 1 to 64")
    kit = with_plates(_kit(kit)) if plates else _kit(kit)
    help_ = Help(supports, holds, hands, shell)
    found = _read(opened, kit, supports != "none", reading)
    if plates and not isinstance(found, CellDesign):
        raise InputError("plates", True, "a design of cells: these blocks are given, or goals")
    check_asked(found, kit, help_, choice.name)
    if how is not None:
        check_laid(found, kit, gap)
        how = how.read(found, kit)
        if how.several and isinstance(found, CellDesign):
            own = kit_of(found, kit)
            if own.joint.law not in ("dry", "clutch"):
                raise InputError("kit", own.name, "dry blocks or bricks: arms lay no mortar")
        _check_helped(how, studs_of(found, kit), holds, hands)
    if how is not None and how.several and standing is None:
        return _with_friction(team_plan(found, kit, how, help_, choice, given), friction)
    # Where a structure stands, an arm carries out what is found from the plans of both.
    workcell = None
    if how is not None and standing is None:
        workcell = how.workcell(studs_of(found, kit))
    if isinstance(found, CellDesign):
        kit = kit_of(found, kit)
        props = supports != "none"
        if standing is not None:
            from learn2assemble.planning.rebuilding.rebuild import fewest_moved, kits_from

            kits = kits_from(kit, standing)
            given["seconds"] = limit / len(kits)
            tried = list[Plan]()
            for one in kits:
                try:
                    tried.append(cells_plan(found, one, None, props, choice, given))
                except InputError:
                    # Some of the blocks may not fill what all of them do.
                    if one is kits[-1]:
                        raise
            plan = _with_friction(fewest_moved(standing, tried, limit, progress), friction)
            return plan if how is None else rebuilt_by(how, plan, kit.joint_gap, progress)
        if kit.joint.law == "clutch":
            plan = bricks_plan(found, kit, workcell, help_, choice, given)
        else:
            plan = cells_plan(found, kit, workcell, props, choice, given)
    elif isinstance(found, Goals):
        plan = goals_plan(found, workcell, choice, given)
    else:
        plan = blocks_plan(found, workcell, help_, given)
        plan = replace(plan, design=replace(plan.design, source=source))
    if standing is None:
        return _with_friction(plan, friction)
    from learn2assemble.planning.rebuilding.rebuild import fewest_moved

    plan = _with_friction(fewest_moved(standing, [plan], limit, progress), friction)
    joint = found.kit.joint_gap if isinstance(found, Goals) else 0.0
    return plan if how is None else rebuilt_by(how, plan, joint, progress)


def reach(
    design: str | Path | np.ndarray | CellDesign | Assembly,
    *,
    arm: str | Sequence[str],
    tool: str | None = None,
    kit: str | Kit | None = None,
    layout: str | Path | Site | None = None,
    seconds: float | None = None,
    **reading: Any,
) -> ReachReport | TeamReach:
    """What of a design an arm reaches, and from where it reaches most; of two arms, what each and
    both reach.

    Args:
        design, kit, reading, seconds: see :func:`build`; the exact planner chooses the blocks.
        arm: name of the arm, or of two.
        tool: what it holds blocks with, as in :func:`build`.
        layout: with the base that is asked about (``docs/layouts.md``).

    Raises:
        InputError: for a design, arm, tool or layout that cannot be used.
    """
    if is_task(design):
        raise InputError("design", design, "a design; a task has places of its own")
    _check_names(reach, reading)
    how = ArmChoice(arm_names(arm), tool, layout, PLANNED, (0.0, 0.0), None, 0)
    how.check()
    how.team()  # A layout that is wrong is said before anything is planned.
    plan = build(design, planner="exact", kit=kit, seconds=seconds, **reading)
    studs = 0.0 if plan.assembly is None else plan.assembly.joint.studs
    if how.several:
        from learn2assemble.team.members import report_team

        return report_team(plan, with_tools(how.team()[0], studs))
    from learn2assemble.cell.reach import report_reach

    workcell = how.workcell(studs)
    return report_reach(plan, workcell.arm, workcell.tool, workcell.site)


def cells_of(
    design: object, kit: str | Kit | None, reading: Mapping[str, Any], function: Callable[..., Any]
) -> CellDesign:
    """The cells of a design that :func:`build` would fill; nothing is planned.

    Args:
        design, kit, reading: see :func:`build`.
        function: that takes these arguments, for messages.

    Raises:
        InputError: for what is no design of cells.
    """
    if is_task(design):
        raise InputError("design", design, "a design of cells; a task has none")
    _check_names(function, reading)
    from learn2assemble.design.read import read_given

    opened = open_design(design, PROBLEMS) if isinstance(design, str | Path) else design
    found = read_given(opened, _kit(kit), reading)
    if not isinstance(found, CellDesign):
        raise InputError("design", _called(design), "a design of cells, for a picture of them")
    return found


def is_task(design: object) -> TypeGuard[str]:
    """Whether this names a task; all else is a design."""
    return isinstance(design, str) and design in PROBLEMS


def arms_that_build(
    design: object, arm: str | Sequence[str] | None = None, physics: str = PHYSICS[0]
) -> int:
    """How many arms would carry this out; arguments of :func:`build`."""
    arms = arm_names(arm)
    if is_task(design):
        return int(PROBLEMS[design].has_arm(arms[0] if arms else None))
    return 0 if len(arms) > 1 and physics == PLANNED else len(arms)


def arm_names(arm: Any) -> tuple[str, ...]:
    """The names of arms that a caller gives: one, several or None.

    Raises:
        InputError: for anything else.
    """
    if arm is None or isinstance(arm, str):
        return () if arm is None else (arm,)
    if not _is(arm, list, tuple) or not all(isinstance(name, str) for name in arm):
        raise InputError("arm", arm, f"the name of an arm ({', '.join(ARMS)}), or two of them")
    return tuple(arm)


def _read_old(old: object, unit: object) -> Assembly:
    """A structure that stands, from what a caller gives; a mesh has the unit of the design."""
    from learn2assemble.assembly.files import read_assembly

    if isinstance(old, str | Path):
        try:
            old = read_assembly(old, unit=None)
        except InputError as error:
            if error.what != "unit" or not isinstance(unit, str):
                raise
            return read_assembly(old, unit=unit)
    if not isinstance(old, Assembly):
        raise InputError("old", _called(old), "an assembly or its file")
    return old


def _with_friction(plan: Plan, asked: Bounds) -> Plan:
    """The plan, which says for what friction its margins are: the least that was asked for, where
    the margins of its own states were not proven for another one."""
    if plan.assembly is None or plan.margin_friction is not None:
        return plan
    least = value_range(asked, plan.assembly.friction, "friction")[0]
    return replace(plan, margin_friction=round(least, 6))


def _check_helped(how: ArmChoice, studs: float, holds: int, hands: bool) -> None:
    """Refuse what arms have no use for.

    Args:
        studs: of the blocks, how far apart they are [m]; 0: they have none.
        holds, hands: as of :func:`build`.
    """
    if not how.several:
        if holds and studs:
            raise InputError("holds", holds, "none with one arm, which has one hand")
        return
    if how.physics == PLANNED and any(how.noise):
        expected = f"none: with physics {PLANNED!r} two arms are planned for, and nothing is read"
        raise InputError("noise", how.noise, expected)
    if holds and studs:
        raise InputError("holds", holds, "none of bricks, with two arms: neither holds any")
    if holds > 1:
        expected = "0 or 1 with two arms: one holds while the other one brings a block"
        raise InputError("holds", holds, expected)
    if hands and not studs:
        raise InputError("hands", hands, "bricks that clutch (a kit such as lego)")


def _refuse(given: Mapping[str, Any], expected: str) -> None:
    """Refuse those arguments that have a value, as they mean nothing here."""
    there = {name: value for name, value in given.items() if value is not None}
    if there:
        values = [_called(value) for value in there.values()]
        got = values[0] if len(values) == 1 else values
        raise InputError(", ".join(there), got, expected)


def _check_values(**given: Any) -> None:
    """Refuse arguments of :func:`build` that no design and no arm can do anything with."""
    noise, seconds = given["noise"], given["seconds"]
    pair = _is(noise, tuple, list) and len(noise) == 2
    check_arguments(
        given,
        ("holds", is_whole(given["holds"], 0), "a whole number of at least 0"),
        (
            "noise",
            pair and all(is_number(one, 0) for one in noise),
            "two standard deviations of at least 0, in m and rad",
        ),
        ("seed", is_whole(given["seed"], 0), "a whole number of at least 0"),
        ("seconds", seconds is None or (is_number(seconds) and seconds > 0), "a positive number"),
        ("progress", callable(given["progress"]), "a function of a line of text"),
    )


def _check_names(function: Callable[..., Any], reading: Mapping[str, Any]) -> None:
    """Refuse arguments of a function that are neither its own nor say how a design is read."""
    from learn2assemble.design.reading import OPTIONS

    names = {*inspect.signature(function).parameters, *OPTIONS} - {"reading"}
    for name in reading:
        check_name(f"argument of {function.__name__}", name, names)


def _is(value: Any, *kinds: type) -> bool:
    return isinstance(value, kinds)


def _read(
    design: object, kit: Kit | None, props: bool, reading: Mapping[str, Any]
) -> Assembly | CellDesign | Goals:
    """What is to be planned, from what a caller gives."""
    from learn2assemble.design.read import read_given

    found = read_given(design, kit, reading)
    if isinstance(found, Assembly):
        return _with_joints(found, kit)
    if isinstance(found, Goals):
        return found if props else replace(found, props=False)
    if not isinstance(found, CellDesign):
        raise InputError("design", _called(found), "a file, cells or an assembly")
    return found


def _with_joints(design: Assembly, kit: Kit | None) -> Assembly:
    """Given blocks whose joints hold as those of a kit do, where nothing else is said of them."""
    if kit is None or design.holds:
        return design
    if not kit.joint.holds:
        expected = "a design of cells, or a kit whose joints hold; these blocks are given"
        raise InputError("kit", kit.name, expected)
    return replace(design, joint=kit.joint)


def _kit(kit: Any) -> Kit | None:
    """The kit that is given, or named."""
    if isinstance(kit, str | Path):
        kit = load_kit(str(kit))
    if not (kit is None or isinstance(kit, Kit)):
        raise InputError("kit", kit, "a kit, its name or its file")
    return kit


def _called(value: object) -> object:
    """What a message calls a value that is not what it should be: itself, if that is short."""
    if isinstance(value, Path):
        return str(value)
    if value is None or isinstance(value, str | int | float | complex):
        return value
    return cast("object", value) if isinstance(value, tuple) else type(value).__name__
