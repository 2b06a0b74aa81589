"""The commands of the product: arguments, a call of the package, what is printed."""

from __future__ import annotations

import argparse
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

from learn2assemble.cli.exports import COMMANDS as EXPORTS
from learn2assemble.cli.learning import COMMANDS as LEARNING
from learn2assemble.cli.parser import (
    Command,
    arg,
    asked,
    at_most_one,
    command,
    count,
    either,
    friction,
    group,
    kit_argument,
    length,
    named,
    natural,
    noise,
    number,
    positive,
    reading_arguments,
    reading_of,
    span_of,
)
from learn2assemble.cli.running import COMMANDS as RUNNING
from learn2assemble.cli.structures import COMMANDS as STRUCTURES
from learn2assemble.compiling import compiling_so_far, compiling_words
from learn2assemble.errors import InputError, check_name, require
from learn2assemble.files import check_exists, check_new, claim_folder
from learn2assemble.registry import Registry
from learn2assemble.robot.registry import ARMS
from learn2assemble.values import to_plain

if TYPE_CHECKING:
    from learn2assemble.cli.output import Output
    from learn2assemble.planning.plan import Plan
    from learn2assemble.planning.reports import ArmReport

_COMMANDS: dict[str, Command] = {}
_MOST_SHAPES = 12
"""Shapes of blocks without a kind that have a line each on the terminal."""
_FAILURES = 3
"""Attempts that failed that have a line each."""


def register_command(commands: Registry[Command]) -> None:
    """Add the commands of the product."""
    for name, made in {**_COMMANDS, **RUNNING, **LEARNING, **STRUCTURES, **EXPORTS}.items():
        commands.register(name, made)


# ---------------------------------------------------------------- build

CELL_COUNTS = ("wanted", "missing", "outside", "other_colour")
"""Of cells, in the summary."""
STATE = "build.jsonl"
"""What a build by an arm appends to, in its folder; gone when the plan is written."""


@command(
    _COMMANDS,
    "build",
    "plan a design, prove every step, write the report (docs/commands.md)",
    "l2a build examples/designs/gate.svg --arm panda --out out/gate",
    arg("design", metavar="DESIGN", help="a drawing, picture, mesh, voxels, blocks, or a task"),
    either(
        arg("--out", type=named, metavar="DIR", help="new or empty folder"),
        arg("--preview", type=named, metavar="PNG", help="only draw the cells that were chosen"),
    ),
    arg("--overwrite", action="store_true", help="replace the file of --preview"),
    kit_argument,
    arg("--arm", action="append", help=f"an arm builds it: {' or '.join(ARMS)}; twice: two"),
    arg("--resume", action="store_true", help="go on with the interrupted build in --out"),
    arg("--seconds", type=positive, metavar="S", help="limit of planning (60), of a task (20)"),
    group("how a file is read (docs/design_files.md)", reading_arguments),
    group(
        "what is chosen and proven (docs/building.md)",
        arg("--from", dest="old", type=named, metavar="OLD", help="turn this structure into it"),
        arg("--planner", help="of a design: exact (the default) or agent"),
        arg("--agent", help="a builder of designs; of a task, an agent or its run"),
        arg("--seed", type=natural, default=0, metavar="N", help="of the search, of a task"),
        arg(
            "--friction",
            type=span_of(friction),
            metavar="MU[:MU]",
            help="coefficient or range to prove for (the kit's)",
        ),
        arg(
            "--gap",
            type=span_of(length),
            metavar="W[:W]",
            help="vertical joints or range, as 0:0.5mm (the kit's)",
        ),
        at_most_one(
            arg(
                "--supports",
                default="auto",
                metavar="WHAT",
                help="auto, none, props (of the kit) or posts (cut)",
            ),
            arg(
                "--no-props",
                dest="supports",
                action="store_const",
                const="none",
                help="the same as --supports none",
            ),
        ),
        arg("--holds", type=count, default=0, metavar="K", help="given blocks held by hand (0)"),
    ),
    group(
        "bricks that clutch (docs/bricks.md)",
        arg("--shell", type=count, metavar="N", help="hollow, with walls N cells thick"),
        arg("--plates", action="store_true", help="cells as high as a plate, filled with both"),
        arg("--hands", action="store_true", help="also from below, and several built beside"),
    ),
    group(
        "how the arm builds (docs/arms.md)",
        arg(
            "--tool",
            help="suction (default), suction-side, suction-wide, gripper; of bricks with studs "
            "gripper (default), socket, socket-large",
        ),
        arg("--layout", type=named, metavar="FILE", help="where blocks wait (docs/layouts.md)"),
        arg(
            "--physics",
            default="dynamic",
            metavar="CELL",
            help="dynamic (default) or kinematic: nothing is simulated",
        ),
        arg(
            "--sense-noise",
            type=noise,
            default=(0.0, 0.0),
            metavar="MM",
            help="MM[:DEG], deviations of what is read of blocks",
        ),
        arg(
            "--video",
            action=argparse.BooleanOptionalAction,
            default=None,
            help="build.mp4 (needs the extra video)",
        ),
    ),
)
def _build(options: argparse.Namespace, output: Output) -> int:
    """Exit code 0 for a complete plan, 1 for an incomplete or refused one."""
    if options.preview is not None:
        return _preview(options, output)
    if options.overwrite:
        raise InputError("--overwrite", "no --preview", "one beside it; a build takes a new folder")
    from learn2assemble.jobs.build import arms_that_build, build, is_task
    from learn2assemble.planning.tiling.planners import PLANNERS

    task = is_task(options.design)
    arms = arms_that_build(options.design, options.arm, options.physics)
    still = not task and options.physics == "kinematic"
    if options.video and (still or not arms):
        got = "a cell in which nothing moves" if options.arm and still else "no arm"
        raise InputError("--video", got, "an arm that carries the plan out, whose motion it is")
    video = options.video is not False and arms > 0
    state = options.out / STATE if arms and not task else None
    if options.resume and (state is None or not state.exists()):
        return _resume_finished(options, output)
    planner = options.planner or (None if options.agent is None or task else "agent")
    if planner is not None:
        check_name("planner", planner, PLANNERS)
    # What is missing shows before the work, not after it.
    needs: list[tuple[str, str, str]] = []
    if task:
        needs.append(("torch", "learn", ""))
    elif planner == "agent":
        needs.append(("safetensors", "learn", ""))
    if arms and options.physics != "kinematic":
        needs.append(("ruckig", "robot", "" if task else "--physics kinematic"))
    if video:
        needs.append(("av", "video", "--no-video"))
    require(*needs)
    interrupted = state is not None and state.exists()
    with claim_folder(options.out, options.resume, "go on with `resume=`" * interrupted):
        output.phase(f"reading {options.design}")
        before, _ = compiling_so_far()
        plan = build(
            options.design,
            **asked(build, options, "design"),
            noise=options.sense_noise,
            state=state,
            progress=output.progress,
            **reading_of(options),
        )
        # Now, as pages and videos are drawn by kernels, too.
        compiled = compiling_so_far()[0] - before
        output.phase("writing the files of the plan")
        files = plan.save(options.out, video=video, progress=output.progress)
        if state is not None and plan.complete:
            state.unlink(missing_ok=True)  # Everything is in the files of the plan now.
    _print_plan(output, plan, files, compiled)
    output.finish(
        {
            **_summary(plan),
            "compiling_s": round(compiled, 3),
            "files": {k: str(v) for k, v in files.items()},
        }
    )
    return 0 if plan.complete else 1


def _resume_finished(options: argparse.Namespace, output: Output) -> int:
    """What ``--resume`` does where nothing is left to do: say so."""
    from learn2assemble.jobs.build import is_task
    from learn2assemble.planning.plan import Plan

    file = options.out / "plan.json"
    refused = InputError("--resume", str(options.out), f"a folder with {STATE} or a complete plan")
    if not file.is_file():
        check_exists(options.out, "folder of a build, to --resume")
        raise refused
    plan = Plan.load(options.out)
    arms = [arm.arm for arm in plan.arms] or ([] if plan.arm is None else [plan.arm.name])
    task = is_task(options.design)
    if not task:
        check_exists(Path(options.design), "design")
    given = options.design if task else Path(options.design).name
    made = Path(plan.design.source).name or plan.design.name
    if given not in (made, plan.design.name):
        raise InputError("--resume", f"a plan of {made}", f"the folder of a build of {given}")
    if not plan.complete:
        raise refused
    if not (task and options.arm is None) and (options.arm or []) != arms:
        built, asked_for = (" and ".join(names) or "no arm" for names in (arms, options.arm or []))
        raise InputError("--resume", f"a plan for {built}", f"the folder of a build by {asked_for}")
    output.say(f"{plan.design.name}: {plan.status} already, {plan.blocks.used} blocks; {file}")
    output.finish({**_summary(plan), "files": {"plan": str(file)}})
    return 0


def _preview(options: argparse.Namespace, output: Output) -> int:
    from learn2assemble.assembly.kit import load_kit
    from learn2assemble.jobs.kinds import with_plates
    from learn2assemble.viewer.preview import check_png, preview

    kit = options.kit
    if options.plates:
        kit = with_plates(None if kit is None else load_kit(kit))
    check_new(
        options.preview,
        "--preview",
        *(options.design, options.kit, options.layout, options.old),
        overwrite=options.overwrite,
    )
    check_png(options.preview, "--preview")
    found = preview(options.design, options.preview, kit=kit, overwrite=True, **reading_of(options))
    shape, cells = list(found.wanted.shape), int(found.wanted.sum())
    common, note = _reading(found.iou, found.note)
    output.say(f"{found.name}: {' × '.join(map(str, shape))} cells, {cells} to fill{common}")
    unread = found.not_read and f"warning: {found.source}: {found.not_read}"
    for words in filter(None, (note, unread)):
        output.paragraph(words)
    output.say(f"preview: {options.preview}")
    output.finish(
        {
            "design": found.name,
            "shape": shape,
            "cells_wanted": cells,
            "cell": list(found.cell),
            **{k: getattr(found, k) for k in ("iou", "volume_error", "note", "not_read")},
            "files": {"preview": str(options.preview)},
        }
    )
    return 0


def _summary(plan: Plan) -> dict[str, Any]:
    cells, design = plan.cells, plan.design
    return {
        "design": design.name,
        "status": plan.status,
        "reason": plan.reason,
        "planner": plan.planner,
        "agent": plan.agent,
        "planner_chosen": [a.result for a in plan.search.attempts] if plan.search else [],
        "kit": plan.kit,
        "blocks": plan.blocks.used,
        "blocks_not_placed": plan.not_placed,
        "props": sum(step.prop and step.action == "place" for step in plan.steps),
        "holds": sum(step.action == "hold" for step in plan.steps),
        "steps": len(plan.steps),
        "coverage": plan.coverage,
        **{f"cells_{k}": cells and getattr(cells, k) for k in CELL_COUNTS},
        "iou": design.iou,
        "volume_error": design.volume_error,
        "note": design.note,
        "not_read": design.not_read,
        "planning_s": plan.planning_s,
        "proof_s": plan.proof_s,
        "seconds": plan.seconds,
        "margin_g": plan.margin_g,
        "margin_friction": plan.margin_friction,
        "margin_n": min((s.margin_n for s in plan.steps if s.margin_n is not None), default=None),
        "friction_range": plan.friction_range,
        "gap_range": plan.gap_range,
        **({"arm": to_plain(plan.arm)} if plan.arm else {}),
        **({"arms": [to_plain(arm) for arm in plan.arms]} if plan.arms else {}),
        **({"robot_s": plan.robot_s} if plan.robot_s is not None else {}),
        **(to_plain(plan.rebuilt) if plan.rebuilt else {}),
    }


def _hands_of(plan: Plan) -> list[str]:
    """What a plan asks of hands beside placing blocks from above, in words."""
    counts = {
        "hold": sum(step.action == "hold" for step in plan.steps),
        "place from below": sum(step.way == "below" for step in plan.steps),
        "build beside": sum(step.way == "beside" for step in plan.steps),
    }
    return [f"{words} {count}x" for words, count in counts.items() if count]


def _counted(plan: Plan) -> list[tuple[str, str, int]]:
    """How many blocks of every kind are placed, props apart; what has no kind is listed by its
    shape, as in the bill."""
    from learn2assemble.assembly.instructions.steps import shapes_of

    placed = [step for step in plan.steps if step.action == "place"]
    kinds = [(step.kind or "block", 0) for step in placed]
    if plan.assembly is not None and not all(step.kind for step in placed):
        shapes, blocks = shapes_of(plan.assembly), plan.assembly.blocks
        plain = shapes.but_for_colour()
        number = {shape.letter: k for k, shape in enumerate(shapes.found, 1)}
        for k, step in enumerate(placed):
            if not step.kind:
                shape = plain[shapes.shape(blocks[step.block]).letter]
                kinds[k] = shape.kind, number[shape.letter]
        several = len({kind for kind in kinds if kind[1]})
        if several > _MOST_SHAPES:
            kinds = [(f"block ({several} shapes)", 0) if k else (name, 0) for name, k in kinds]
    counts = Counter((k, name, step.prop) for (name, k), step in zip(kinds, placed, strict=True))
    return [(name, "prop" if prop else "", n) for (_, name, prop), n in sorted(counts.items())]


def _print_plan(output: Output, plan: Plan, files: dict[str, Path], compiled: float = 0.0) -> None:
    """Blocks by kind, then what was filled and what is proven.

    Args:
        output: for people.
        plan: what came of it.
        files: which file is what.
        compiled: seconds of planning in which kernels were compiled.
    """
    from learn2assemble.assembly.instructions.words import count_words
    from learn2assemble.viewer.words import weakest_words

    output.table(plan.design.name, ("block", "", "number"), _counted(plan))
    number = f"{count_words(plan.blocks.used, 'block')}, {count_words(len(plan.steps), 'step')}"
    status = plan.status
    if found := plan.not_placed:
        status, number = f"{status} by the arm", f"{found} blocks found, none placed"
    output.paragraph(f"{status}: {number}, {plan.planner} planner, {plan.seconds:.1f} s")
    if words := compiling_words(plan.seconds, compiled):
        output.say(words)
    if helped := _hands_of(plan):
        output.say(f"hands: {', '.join(helped)}")
    for stage in plan.search.attempts if plan.search else ():
        output.paragraph(f"{stage.stage}: {stage.result}")
    shape, note = _reading(plan.design.iou, plan.design.note)
    if note:
        output.paragraph(note)
    if plan.cells:
        cells, design = plan.cells, plan.design
        other = cells.other_colour
        planned = "cells, as planned" if plan.as_planned else "cells"
        output.paragraph(
            f"{planned}: {cells.wanted} wanted, {cells.missing} open, "
            f"{cells.outside} outside{shape}"
        )
        if other is not None:
            output.say(f"cells in a block of another colour: {other}")
        if design.not_read:
            output.paragraph(f"warning: {design.source}: {design.not_read}")
    elif plan.design.targets:
        needed = f"{plan.design.success_threshold:.1%}"
        output.say(f"coverage {plan.coverage:.1%} of the target, more than {needed} is needed")
    if (made := plan.rebuilt) is not None:
        moves = "moves by hand" if plan.arm or plan.arms else "moves"
        output.say(
            f"{made.moves} {moves} (no order without help has fewer than {made.moves_bound})"
        )
        output.say(f"blocks: {made.kept} stay, {made.taken} are taken away, {made.placed} placed")
    if plan.steps and plan.margin_g is not None:
        left = plan.without_margin
        output.paragraph(f"every step is proven; the weakest is {weakest_words(plan)}")
        if left:
            output.say(f"{left} of {len(plan.steps)} steps are without a computed margin")
    proven = plan.proven_for
    if "friction" in proven and "joints" in proven:
        output.paragraph(
            f"proven for friction {proven['friction']} and vertical joints of {proven['joints']}"
        )
    if plan.arm is not None:
        _print_arm(output, plan.arm, plan.arm.name)
    for arm in plan.arms:
        steps = sum(step.arm == arm.name for step in plan.steps)
        told = f"arm {arm.name}: {steps} of {len(plan.steps)} steps, reaches {arm.reaches}"
        output.paragraph(told)
        if arm.did is not None:
            _print_arm(output, arm.did, arm.name)
    if plan.robot_s is not None:
        output.say(f"{plan.robot_s:.0f} s of both arms until the last block")
    blocks = plan.assembly.blocks if plan.assembly else ()
    if by_hand := [f"{s.step} ({s.action} {blocks[s.block].id})" for s in plan.steps if s.by_hand]:
        output.paragraph(f"by hand, while the arm waits: steps {', '.join(by_hand)}")
    if waits := [f"{s.step} ({s.wait_h:g} h)" for s in plan.steps if s.wait_h is not None]:
        output.paragraph(f"wait until the mortar holds before steps {', '.join(waits)}")
    if plan.reason:
        output.paragraph(f"why: {plan.reason}")
    for what, path in files.items():
        output.say(f"{what}: {path}")


def _reading(iou: float | None, note: str | None) -> tuple[str, str]:
    """How far cells are what was drawn, in words.

    Args:
        iou: of drawing and cells, see `CellDesign`.
        note: what was done to the design to read it.

    Returns:
        What is added to a line about the cells, and a line with the note: with a warning where
        little is common. Either may be empty.
    """
    from learn2assemble.design.lost import POOR

    # What is not all of it is never rounded up to that.
    share = iou if iou is None or iou > 1 - 1e-9 else min(iou, 0.99)
    common = "" if share is None else f"{share:.0%} of drawing and cells are common"
    if iou is not None and iou < POOR:
        return "", f"warning: only {': '.join(filter(None, (common, note)))}"
    return f"; {common}" if common else "", note or ""


def _print_arm(output: Output, arm: ArmReport, name: str) -> None:
    """What an arm did, which steps call by a name."""
    shown = len(arm.failures) if output.verbose else _FAILURES
    for failure in arm.failures[:shown]:
        after = "; the rest was planned anew" if failure.replanned else ""
        output.paragraph(f"attempt {failure.attempt}: {failure.outcome} ({failure.detail}){after}")
    if rest := Counter(failure.outcome for failure in arm.failures[shown:]):
        told = ", ".join(f"{count} {outcome}" for outcome, count in rest.items())
        output.paragraph(f"more attempts that failed: {told} (--verbose shows each)")
    where = f" at [{', '.join(f'{v:g}' for v in arm.base[:3])}] m" if arm.base else ""
    places = f"blocks from {arm.places} place{'s'[: arm.places != 1]}" if arm.places else ""
    output.paragraph(f"arm {name} with {arm.tool}{where}{', ' * bool(places)}{places}")
    a_step = "" if arm.attempts_per_step is None else f" ({arm.attempts_per_step:.3f} a step)"
    took = "" if arm.seconds is None else f", {arm.seconds:.0f} s of robot time"
    output.say(f"{arm.attempts} attempts{a_step}{took}")
    if arm.planed_words:
        output.paragraph(arm.planed_words)
    if arm.error_mean is not None and arm.error_worst is not None:
        output.paragraph(
            f"blocks stand {1e3 * arm.error_mean:.2f} mm from their places on average, "
            f"{1e3 * arm.error_worst:.2f} mm at most"
        )


# ---------------------------------------------------------------- view


@command(
    _COMMANDS,
    "view",
    "open the page of a finished plan",
    "l2a view out/house",
    arg("plan", metavar="PLAN", type=named, help="plan.json or its folder"),
    arg("--port", type=number(int, 0, 65535, "a port number"), default=0),
    arg("--no-browser", action="store_true", help="only serve the page"),
)
def _view(options: argparse.Namespace, output: Output) -> None:
    from learn2assemble.planning.plan import Plan

    plan = Plan.load(options.plan)
    folder = options.plan if options.plan.is_dir() else options.plan.parent
    page = folder / "view.html"
    from learn2assemble.viewer.server import serve

    if not page.exists():
        plan.write_page(folder)

    def tell(url: str) -> None:
        output.say(f"{url} (Ctrl-C ends it)")
        output.finish({"url": url, "page": str(page)})

    serve(page, options.port, not options.no_browser, tell)
