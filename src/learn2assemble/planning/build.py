"""The main job: from a design to a plan, every step of which is proven or carried out by an arm.

Without an arm the exact planner (:mod:`.construct`) fills the cells of any design with the blocks
of a kit, or the learned builder does where it is asked to or the record of both is for it; the
learned agent with its search plans the tasks of the paper.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, cast

from learn2assemble.errors import InputError, UnknownNameError, look_up
from learn2assemble.files import MAX_BYTES, MAX_GENERATED, load_json, read_bytes
from learn2assemble.planning.plan import Plan
from learn2assemble.robot.registry import ARMS
from learn2assemble.tasks import PRESETS, check_actions, get_task

if TYPE_CHECKING:
    from learn2assemble.assembly.blocks import Assembly
    from learn2assemble.assembly.kit import Kit
    from learn2assemble.design.cells import CellDesign
    from learn2assemble.design.goals import Goals
    from learn2assemble.networks.agent import Agent
    from learn2assemble.planning.agent.arm import Hand
    from learn2assemble.planning.discover import Progress, Sequence
    from learn2assemble.planning.problem import Problem
    from learn2assemble.planning.supply import Layout
    from learn2assemble.planning.verify import Proof
    from learn2assemble.planning.workcell_plan import Workcell
    from learn2assemble.planning.workcell_reach import ReachReport
    from learn2assemble.planning.workcell_site import Site
    from learn2assemble.world.design_bounds import Design

PLANNERS = ("auto", "exact", "agent")
DEFAULT_TOOL = "suction"
"""Of an arm that carries out an exact plan: with fingers, blocks cannot stand close."""
PHYSICS = ("dynamic", "kinematic")
"""Cells in which an arm carries out exact plans."""
AGENT_SECONDS, EXACT_SECONDS = 20.0, 60.0
"""Limits of the agent's widest search, and of the exact planner with its proof [s]."""
DEFAULT_AGENT_TASK = "two-sided-3x3-20-24"
DEFAULT_ARM_TASKS = ("robot-two-sided-3x3-10-14", "robot-four-sided-3x3-10-18")
"""With an arm: walls, and what has more than two sides."""


def build(
    design: str | Path | Design | CellDesign | Goals | Assembly,
    *,
    planner: str = "auto",
    kit: str | Kit | None = None,
    friction: float | tuple[float, float] | None = None,
    gap: float | tuple[float, float] | None = None,
    props: bool = True,
    reading: Mapping[str, Any] | None = None,
    arm: str | None = None,
    agent: str | Agent | None = None,
    layout: str | Path | Layout | Site | None = None,
    seed: int = 0,
    seconds: float | None = None,
    progress: Progress = lambda text: None,
    tool: str | None = None,
    physics: str = "dynamic",
    noise: tuple[float, float] = (0.0, 0.0),
    state: Path | None = None,
) -> Plan:
    """Plan a design and prove every step.

    The exact planner chooses the blocks and their order, and every state is proven to be in static
    equilibrium; a simulated arm carries the plan out where one is named. The learned agent plans
    tasks and, where it is asked to, elevations; after an attempt of the arm that fails, it plans
    the rest anew.

    Args:
        design: a design or its file (``docs/design_files.md``), goals instead of a design or their
            file (``docs/goals.md``), an assembly of given blocks, or the name of a task, of which a
            random problem is built.
        planner: ``"exact"``; ``"agent"``: for designs the learned builder with its search alone
            (:mod:`.agent`), for tasks the agent of the paper; or ``"auto"``: the agent for tasks
            and where one is named, else what the record of both planners says.
        kit: for designs of cells, a kit, its name or its file; by default the one the design
            names, else ``bricks-lintels``.
        friction: coefficient, or the range to prove every step for; by default the kit's.
        gap: width of vertical joints [m], or the range to prove every step for.
        props: whether the exact planner may use temporary blocks.
        reading: how to read a file that does not say it: keyword arguments of
            :func:`learn2assemble.design.cells.read_design` such as ``unit`` and ``cells_wide``.
        arm: name of the arm that builds; by default none, for a task its own.
        agent: proposes the placements: an agent, a shipped one by name, a ``.safetensors`` file or
            the folder of a training; by default one that knows problems like this.
        layout: where the blocks wait for the arm (``docs/layouts.md``); by default around the
            building site.
        seed: of the search, and of the problem of a task.
        seconds: limit of planning and proof, or of the agent's widest search [s]; by default
            60 and 20.
        progress: called with a line of text for everything that takes long.
        tool: what the arm holds the blocks of an exact plan with, ``"suction"`` (the default) or
            ``"gripper"``.
        physics: in which cell an exact plan is carried out, ``"dynamic"`` or ``"kinematic"``.
        noise: standard deviations of what is read back while an exact plan is carried out: x and y
            [m], yaw [rad].
        state: file to which an exact plan's build by an arm appends every attempt; where it
            exists, the build goes on from it.

    Returns:
        The plan: complete, incomplete or refused. With an arm, its motion is ``plan.record``.

    Raises:
        InputError: for a design, arm, agent or layout that cannot be used.
    """
    # What can be refused at once comes before the libraries that take seconds to load.
    if planner not in PLANNERS:
        raise UnknownNameError("planner", planner, PLANNERS)
    if uses_exact_planner(design, planner, arm, agent, layout):
        if agent is not None and planner != "agent":
            raise InputError("agent", str(agent), "none with the exact planner")
        how = None
        if arm is not None:
            how = _Arm(arm, tool, layout, physics, noise, state, seed)
            how.check()
        elif tool is not None or layout is not None or state is not None:
            got = tool or str(layout or state)
            raise InputError("tool, layout or state", got, "an arm to build with (--arm)")
        return _build_exact(
            design, kit, friction, gap, props, dict(reading or {}),
            EXACT_SECONDS if seconds is None else seconds, progress, how, planner,
            cast("str | None", agent), seed,
        )  # fmt: skip
    if tool not in (None, "gripper") or physics != "dynamic" or any(noise) or state is not None:
        raise InputError("tool, physics, noise or state", tool or physics, "an exact plan")
    if not isinstance(design, str | Path) and not hasattr(design, "elevations"):
        raise InputError("planner", planner, "exact, for a design without elevations")
    if kit is not None or friction is not None or gap is not None or not props or reading:
        raise InputError("kit, friction, gap, props or reading", "given", "the exact planner")
    seconds = AGENT_SECONDS if seconds is None else seconds
    _check_names(design, arm, layout)
    problem, source, places = _problem(
        cast("str | Path | Design", design), seed, arm, cast("str | Path | Layout | None", layout)
    )
    from learn2assemble.networks.agent import default_agent, load_agent, one_thread

    if agent is None or isinstance(agent, str):
        agent = load_agent(agent or default_agent(_agent_task(problem)))
    network = agent.network.config
    check_actions(network.num_actions, network.action_mode, problem.task)
    with one_thread():
        if not problem.task.has_arm:
            return build_problem(
                problem, agent, source, seed=seed, seconds=seconds, progress=progress
            )
        from learn2assemble.planning.execute import build_with_arm, real_cell
        from learn2assemble.planning.supply import set_out
        from learn2assemble.robot.arm import get_arm
        from learn2assemble.robot.kinematic.cell import KinematicCell

        chosen = get_arm(problem.task.arm)
        if problem.inside is not None and problem.refusal is None:
            blocks = int(problem.state.num_blocks[0])
            problem = set_out(problem, KinematicCell(chosen, blocks), places)
        return build_with_arm(
            problem, agent, source, real_cell(chosen), seed=seed, seconds=seconds, progress=progress
        )


def reach(
    design: str | Path | CellDesign | Assembly,
    *,
    arm: str,
    tool: str = DEFAULT_TOOL,
    kit: str | Kit | None = None,
    layout: str | Path | Site | None = None,
    reading: Mapping[str, Any] | None = None,
    seconds: float | None = None,
) -> ReachReport:
    """What of a design an arm reaches, and from where it reaches most.

    Args:
        design, kit, reading, seconds: see :func:`build`; the exact planner chooses the blocks.
        arm: name of the arm.
        tool: what it holds blocks with.
        layout: with the base that is asked about (``docs/layouts.md``).

    Raises:
        InputError: for a design, arm, tool or layout that cannot be used.
    """
    how = _Arm(arm, tool, layout, PHYSICS[0], (0.0, 0.0), None, 0)
    how.check()
    site = how.workcell().site
    plan = build(design, planner="exact", kit=kit, reading=reading, seconds=seconds)
    from learn2assemble.planning.workcell_reach import report_reach

    return report_reach(plan, arm, tool, site)


def uses_exact_planner(
    design: object, planner: str = "auto", arm: object = None, agent: object = None,
    layout: object = None,
) -> bool:  # fmt: skip
    """Whether :func:`build` with these arguments plans designs of cells, or given blocks."""
    task = isinstance(design, str) and design in PRESETS
    elevations = hasattr(design, "elevations")
    if planner == "agent":
        from learn2assemble.planning.agent.network import is_builder

        named = agent is None or (isinstance(agent, str) and is_builder(agent))
        return not (task or elevations) and named
    if planner != "auto":
        return planner == "exact"
    return not (task or elevations) and agent is None


class _Arm(NamedTuple):
    """How an arm carries out an exact plan; fields as the arguments of :func:`build`."""

    arm: str
    tool: str | None
    layout: str | Path | Layout | Site | None
    physics: str
    noise: tuple[float, float]
    state: Path | None
    seed: int

    def check(self) -> None:
        """Refuse names that do not exist, before libraries load."""
        from learn2assemble.robot.registry import TOOLS

        look_up("arm", self.arm, ARMS)
        if self.tool is not None:
            look_up("tool", self.tool, TOOLS)
        look_up("physics", self.physics, dict.fromkeys(PHYSICS))

    def workcell(self) -> Workcell:
        """The same with defaults, the layout read."""
        from learn2assemble.planning.workcell_plan import Workcell
        from learn2assemble.planning.workcell_site import Site, read_site

        site = Site() if self.layout is None else self.layout
        if isinstance(site, str | Path):
            site = read_site(Path(site))
        if not isinstance(site, Site):
            raise InputError("layout", type(site).__name__, "a file or a Site")
        tool = self.tool or DEFAULT_TOOL
        return Workcell(self.arm, tool, site, self.physics, self.seed, self.noise, log=self.state)


def _build_exact(
    design: object, kit: Any, friction: Any, gap: Any, props: bool, reading: dict[str, Any],
    seconds: float, progress: Progress, how: _Arm | None, planner: str, builder: str | None,
    seed: int,
) -> Plan:  # fmt: skip
    if isinstance(design, str) and design in PRESETS:
        raise InputError("planner", "exact", f"agent, for the task {design}")
    _check_names(design, None, None)
    from learn2assemble.assembly.blocks import Assembly
    from learn2assemble.assembly.kit import load_kit
    from learn2assemble.design.cells import CellDesign, read_design
    from learn2assemble.planning.construct import DEFAULT_KIT, plan_assembly, plan_cells

    if isinstance(kit, str | Path):
        kit = load_kit(str(kit))
    goals = _goals(design, kit, props, reading)
    if goals is not None:
        from learn2assemble.planning.goals.planner import plan_goals, with_obstacles
        from learn2assemble.planning.workcell_plan import carry_out

        workcell = None if how is None else how.workcell()
        plan = plan_goals(
            goals, planner=planner, seed=seed, seconds=seconds, friction=friction, gap=gap,
            progress=progress,
        )  # fmt: skip
        if workcell is None:
            return plan
        workcell = replace(workcell, site=with_obstacles(workcell.site, goals))
        return carry_out(plan, workcell, joint=goals.kit.joint_gap, progress=progress)
    source = ""
    if isinstance(design, str | Path):
        path = Path(design)
        source = path.name
        cell = reading.pop("cell", None) or (None if kit is None else kit.pitch)
        design = read_design(path, cell=cell, **reading)
    elif reading:
        raise InputError("reading", sorted(reading), "a design file, which it tells how to read")
    if isinstance(design, Assembly):
        if kit is not None or isinstance(friction, tuple) or gap is not None:
            raise InputError("kit, gap or a range of friction", "given", "a design of cells")
        if planner == "agent":
            raise InputError("planner", planner, "exact, for blocks that are given")
        workcell = None if how is None else how.workcell()
        plan = plan_assembly(
            design, friction=friction, seconds=seconds, progress=progress, source=source
        )
        if workcell is None:
            return plan
        from learn2assemble.planning.workcell_plan import carry_out

        return carry_out(plan, workcell, joint=0.0, progress=progress)
    if not isinstance(design, CellDesign):
        raise InputError("design", type(design).__name__, "a file, cells or an assembly")
    # Blocks are as large as the cells that were asked for.
    kit = (kit or load_kit(design.kit or DEFAULT_KIT)).at_pitch(design.cell)
    workcell = None if how is None else how.workcell()

    def plan_with(blocks: Kit, hand: Hand | None = None) -> Plan:
        return plan_cells(
            design, blocks, friction=friction, gap=gap if blocks is kit else None, props=props,
            seconds=seconds,
            progress=progress, planner=planner if how is None or planner == "agent" else "exact",
            builder=builder, seed=seed, hand=hand,
        )  # fmt: skip

    if workcell is None:
        return plan_with(kit)
    if planner == "agent":
        from learn2assemble.planning.agent.arm import build_by_arm

        return build_by_arm(plan_with, kit, workcell, progress)
    from learn2assemble.planning.workcell_plan import carry_out_cells

    return carry_out_cells(plan_with(kit), kit, workcell, progress, plan_with)


def _goals(design: object, kit: Kit | None, props: bool, reading: dict[str, Any]) -> Goals | None:
    """The goals that are given instead of a design, or that a file holds; else None."""
    from learn2assemble.design.goals import Goals, is_goals, read_goals

    if isinstance(design, str | Path) and is_goals(read_bytes(Path(design), "design file")[0]):
        if set(reading) - {"cell"}:
            raise InputError("reading", sorted(reading), "no option but cell, for goals")
        design = read_goals(design, kit, reading.get("cell"))
    if not isinstance(design, Goals):
        return None
    return design if props else replace(design, props=False)


def _check_file(path: Path) -> None:
    """Refuse what is no file, a word that may be a misspelt task, and damaged JSON."""
    if path.suffix == "" and not path.exists():
        raise UnknownNameError("design", str(path), PRESETS)
    content, source = read_bytes(path, "design file", MAX_GENERATED)
    if content.lstrip()[:1] in (b"{", b"[") and len(content) <= MAX_BYTES:
        load_json(content.decode("utf-8-sig", "replace"), source, "design file")


def _check_names(design: object, arm: str | None, layout: object) -> None:
    """Refuse arms, tasks and files that do not exist, and files that are not JSON."""
    if arm is not None and arm not in ARMS:
        raise UnknownNameError("arm", arm, ARMS)
    if isinstance(design, str) and design in PRESETS:
        if layout is not None:
            raise InputError("layout", str(layout), "a design (a task has a layout of its own)")
        return
    if isinstance(design, str | Path):
        _check_file(Path(design))
    if layout is not None and arm is None:
        raise InputError("layout", str(layout), "an arm to take blocks from there (--arm)")


def _problem(
    design: str | Path | Design, seed: int, arm: str | None, layout: str | Path | Layout | None
) -> tuple[Problem, str, Layout | None]:
    """What is to be built, where it comes from, and where its blocks wait if that is given."""
    from learn2assemble.planning.problem import design_problem, preset_problem
    from learn2assemble.world.design_bounds import read_design

    if isinstance(design, str) and design in PRESETS:
        return preset_problem(design, seed, arm), f"preset {design}, seed {seed}", None
    source = None
    if isinstance(design, str | Path):
        source, design = Path(design).name, read_design(design)
    if isinstance(layout, str | Path):
        from learn2assemble.planning.supply import read_layout

        layout = read_layout(Path(layout))
    problem = design_problem(design, arm, len(layout.places) if layout else None)
    return problem, source or design.name, layout


def builds_with_arm(design: str | Path | Design, arm: str | None = None) -> bool:
    """Whether an arm would build this; arguments of :func:`build`."""
    if isinstance(design, str) and design in PRESETS:
        return get_task(design, arm).has_arm
    return arm is not None


def _agent_task(problem: Problem) -> str:
    """A task whose agent knows problems like this one."""
    if not problem.task.has_arm:
        return DEFAULT_AGENT_TASK
    if problem.inside is None:
        return problem.task.name
    return DEFAULT_ARM_TASKS[problem.task.num_sides > 2]


def build_problem(
    problem: Problem,
    agent: Agent,
    source: str,
    *,
    seed: int = 0,
    seconds: float = 20.0,
    progress: Progress = lambda text: None,
) -> Plan:
    """Plan, verify, widen the search until the plan holds, and say what it took.

    Args:
        source: where the problem comes from, for the report.
        seconds: limit of the last, widest search.
        progress: told what is being tried.
    """
    from learn2assemble.planning.discover import Sequence, plan_sequences
    from learn2assemble.planning.verify import Proof, make_plan, verify

    started = time.perf_counter()
    if problem.refusal is not None:
        nothing = Sequence([], False, "none: refused before planning", 0)
        return make_plan(problem, agent, source, nothing, Proof([], False), started)
    best: tuple[Sequence, Proof] | None = None
    for sequence in plan_sequences(problem, agent.network, seed, seconds, progress):
        progress("verifying by rigid-body simulation")
        proof = verify(problem, sequence.placements)
        held = proof.stable and proof.filled
        if sequence.success and not held:
            sequence.attempts[-1].result = "fills the target, but does not hold in simulation"
        if best is None or _rank(proof) > _rank(best[1]):
            best = sequence, proof
        best[0].attempts = sequence.attempts
        if held:
            break
    assert best is not None
    return make_plan(problem, agent, source, *best, started)


def _rank(proof: Proof) -> tuple[bool, float]:
    held = [step.coverage for step in proof.steps if step.stable]
    return proof.stable and proof.filled, held[-1] if held else 0.0
