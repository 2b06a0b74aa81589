"""``l2a build``: plan a design, prove every step or let an arm build it, write the report."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import torch

from learn2assemble.cli.output import Output
from learn2assemble.errors import InputError, UnknownNameError, look_up
from learn2assemble.files import to_plain
from learn2assemble.networks.agent import default_agent, load_agent
from learn2assemble.planning.build import build
from learn2assemble.planning.execute import build_with_arm, real_cell
from learn2assemble.planning.plan import Plan
from learn2assemble.planning.problem import Problem, design_problem, preset_problem
from learn2assemble.planning.supply import Layout, read_layout, set_out
from learn2assemble.robot.arm import get_arm
from learn2assemble.robot.kinematic.cell import KinematicCell
from learn2assemble.robot.registry import ARMS
from learn2assemble.tasks import PRESETS, check_actions
from learn2assemble.viewer.video import require_video
from learn2assemble.world.design_bounds import read_design

DEFAULT_AGENT_TASK = "two-sided-3x3-20-24"
DEFAULT_ARM_TASKS = ("robot-two-sided-3x3-10-14", "robot-four-sided-3x3-10-18")
"""With an arm: walls, and what has more than two sides."""


def run(options: argparse.Namespace) -> int:
    """Exit code 0 for a complete plan, 1 for an incomplete or refused one."""
    output = Output(options.json)
    # One thread: small batches lose more by sharing than they gain.
    torch.set_num_threads(1)
    layout = read_layout(options.layout) if options.layout else None
    problem, source = _problem(options, layout)
    agent = load_agent(options.agent or default_agent(_agent_task(problem)))
    network = agent.network.config
    check_actions(network.num_actions, network.attitudes, problem.task)
    how = {"seed": options.seed, "seconds": options.seconds, "progress": output.progress}
    video = False
    if problem.task.has_arm:
        arm = get_arm(problem.task.arm)
        # What is missing shows before the work, not after it.
        cell, video = real_cell(arm), options.video and require_video() is not None
        if problem.inside is not None and problem.refusal is None:
            blocks = int(problem.state.num_blocks[0])
            problem = set_out(problem, KinematicCell(arm, blocks), layout)
        prepare_folder(options.out)
        plan = build_with_arm(problem, agent, source, cell, **how)
    else:
        prepare_folder(options.out)
        plan = build(problem, agent, source, **how)
    files = plan.save(options.out, video=video, progress=output.progress)
    _report(output, plan, files)
    output.finish({**_summary(plan), "files": {k: str(v) for k, v in files.items()}})
    return 0 if plan.complete else 1


def prepare_folder(folder: Path) -> None:
    """Make an empty output folder.

    Raises:
        InputError: where it exists and holds something, or cannot be written.
    """
    try:
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise InputError("--out", str(folder), "a new or empty folder")
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / ".write-test"
        probe.touch()
        probe.unlink()
    except (OSError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError("--out", str(folder), f"a folder that can be written ({reason})") from None


def _problem(options: argparse.Namespace, layout: Layout | None) -> tuple[Problem, str]:
    """A design file, or a preset where there is no such file."""
    text, seed, arm = options.design, options.seed, options.arm
    if arm is not None:
        look_up("arm", arm, dict.fromkeys(ARMS))
    if text in PRESETS:
        if layout is not None:
            raise InputError("--layout", layout.source, f"a design (preset {text} has its own)")
        return preset_problem(text, seed, arm), f"preset {text}, seed {seed}"
    path = Path(text)
    if path.suffix == "" and not path.exists():
        raise UnknownNameError("DESIGN", text, PRESETS)
    if layout is not None and arm is None:
        raise InputError("--layout", layout.source, "an arm to take blocks from there (--arm)")
    design = read_design(path)
    return design_problem(design, arm, len(layout.places) if layout else None), path.name


def _agent_task(problem: Problem) -> str:
    """A task whose agent knows problems like this one."""
    if not problem.task.has_arm:
        return DEFAULT_AGENT_TASK
    if problem.inside is None:
        return problem.task.name
    return DEFAULT_ARM_TASKS[problem.task.num_sides > 2]


def _summary(plan: Plan) -> dict[str, Any]:
    return {
        "design": plan.design.name,
        "status": plan.status,
        "reason": plan.reason,
        "steps": len(plan.steps),
        "blocks_used": plan.blocks.used,
        "blocks_available": plan.blocks.available,
        "coverage": plan.coverage,
        "stable": all(step.stable for step in plan.steps),
        "smallest_margin": plan.margin_g,
        "needed": plan.search.needed if plan.search else None,
        "backtracks": plan.search.backtracks if plan.search else 0,
        "agent": plan.agent,
        "seconds": plan.seconds,
        **({"arm": to_plain(plan.arm)} if plan.arm else {}),
    }


def _report(output: Output, plan: Plan, files: dict[str, Path]) -> None:
    how = ("grasped", "put down", "outcome") if plan.arm else ("stable",)
    output.table(
        plan.design.name,
        ("step", "block", "placed", "against", "coverage", "margin [g]", *how),
        [
            (
                step.step, step.block, step.relation,
                "first block" if step.reference == 0 else f"step {step.reference}",
                f"{step.coverage:.1%}", step.margin_g,
                *((step.grasp, step.place, step.outcome) if plan.arm else (step.stable,)),
            )
            for step in plan.steps
        ],
    )  # fmt: skip
    for failure in plan.arm.failures if plan.arm else ():
        after = "; the rest was planned anew" if failure.replanned else ""
        output.say(f"attempt {failure.attempt}: {failure.outcome} ({failure.detail}){after}")
    needed = plan.search.needed if plan.search else "none"
    output.say(
        f"{plan.status}: {plan.blocks.used} of {plan.blocks.available} blocks, "
        f"coverage {plan.coverage:.1%}, needed {needed}, {plan.seconds:.1f} s"
    )
    if plan.reason:
        output.say(f"why: {plan.reason}")
    for what in ("page", "video", "trajectory", "trajectory table"):
        if what in files:
            output.say(f"{what}: {files[what]}")
