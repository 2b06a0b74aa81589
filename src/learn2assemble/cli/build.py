"""``l2a build``: plan a design, prove every step, write the report."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import torch

from learn2assemble.cli.arm_files import write_arm_files
from learn2assemble.cli.output import Output
from learn2assemble.errors import InputError, UnknownNameError
from learn2assemble.networks.agent import default_agent, load_agent
from learn2assemble.planning.build import build
from learn2assemble.planning.problem import Problem, design_problem, preset_problem
from learn2assemble.presets import PRESETS
from learn2assemble.robot.record import BuildRecord
from learn2assemble.viewer import write_page, write_progress
from learn2assemble.world.designs import read_design

DEFAULT_AGENT_TASK = "two-sided-3x3-20-24"


def run(options: argparse.Namespace) -> int:
    """Exit code 0 for a complete plan, 1 for an incomplete or refused one."""
    output = Output(options.json)
    # One thread: small batches lose more by sharing than they gain.
    torch.set_num_threads(1)
    problem, source = _problem(options.design, options.seed)
    agent = load_agent(options.agent or default_agent(DEFAULT_AGENT_TASK))
    prepare_folder(options.out)
    plan = build(
        problem, agent, source, seed=options.seed, seconds=options.seconds,
        progress=output.progress,
    )  # fmt: skip
    files = _write(plan, options.out)
    _report(output, plan, files)
    output.finish({**_summary(plan), "files": {k: str(v) for k, v in files.items()}})
    return 0 if plan["status"] == "complete" else 1


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


def _problem(text: str, seed: int) -> tuple[Problem, str]:
    """A design file, or a preset where there is no such file."""
    if text in PRESETS:
        return preset_problem(text, seed), f"preset {text}, seed {seed}"
    path = Path(text)
    if path.suffix == "" and not path.exists():
        raise UnknownNameError("DESIGN", text, PRESETS)
    return design_problem(read_design(path)), path.name


def _write(
    plan: dict[str, Any], folder: Path, record: BuildRecord | None = None
) -> dict[str, Path]:
    files = {"plan": folder / "plan.json", "page": folder / "view.html"}
    files["plan"].write_text(json.dumps(plan, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    write_page(plan, files["page"], record)
    files["picture"] = folder / "progress.png"
    write_progress(plan, files["picture"])
    if record is not None:
        files |= write_arm_files(plan, record, folder)
    return files


def _summary(plan: dict[str, Any]) -> dict[str, Any]:
    steps = plan["steps"]
    return {
        "design": plan["design"]["name"],
        "status": plan["status"],
        "reason": plan["reason"],
        "steps": len(steps),
        "blocks_used": plan["blocks"]["used"],
        "blocks_available": plan["blocks"]["available"],
        "coverage": plan["coverage"],
        "stable": all(step["stable"] for step in steps),
        "smallest_margin": min((step["stability_margin"] for step in steps), default=None),
        "needed": plan["search"]["needed"],
        "backtracks": plan["search"]["backtracks"],
        "agent": plan["agent"],
        "seconds": plan["seconds"],
    }


def _report(output: Output, plan: dict[str, Any], files: dict[str, Path]) -> None:
    waiting = plan["steps"]
    output.table(
        plan["design"]["name"],
        ("step", "block", "placed", "against", "coverage", "margin [g]", "stable"),
        [
            (
                step["step"], step["block"], step["relation"],
                "first block" if step["reference"] == 0 else f"step {step['reference']}",
                f"{step['coverage']:.1%}", step["stability_margin"], step["stable"],
            )
            for step in waiting
        ],
    )  # fmt: skip
    summary = _summary(plan)
    head = f"{summary['status']}: {summary['blocks_used']} of {summary['blocks_available']} blocks"
    output.say(
        f"{head}, coverage {summary['coverage']:.1%}, needed {summary['needed']}, "
        f"{summary['seconds']:.1f} s"
    )
    if plan["reason"]:
        output.say(f"why: {plan['reason']}")
    output.say(f"page: {files['page']}")
