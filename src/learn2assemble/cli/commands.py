"""The commands of the product: arguments, a call of the package, what is printed."""

from __future__ import annotations

import argparse
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

from learn2assemble.cli.output import check_new_file, write_result
from learn2assemble.cli.parser import (
    Command,
    arg,
    arm_argument,
    command,
    count,
    either,
    friction,
    group,
    length,
    named,
    natural,
    noise,
    number,
    positive,
    reading_arguments,
    reading_of,
    share,
    span_of,
    workers_arguments,
)
from learn2assemble.cli.structures import COMMANDS as STRUCTURES
from learn2assemble.errors import InputError, MissingExtraError, check_name, require
from learn2assemble.files import check_exists, claim_folder
from learn2assemble.registry import Registry
from learn2assemble.robot.registry import ARMS
from learn2assemble.tasks.search.config import SEARCHES, TO_THE_END
from learn2assemble.values import to_plain

if TYPE_CHECKING:
    from learn2assemble.cli.output import Output
    from learn2assemble.planning.plan import ArmReport, Plan

_COMMANDS: dict[str, Command] = {}
AGENT_HELP = "shipped agent, .safetensors or run folder"


def register_command(commands: Registry[Command]) -> None:
    """Add the commands of the product."""
    for name, made in {**_COMMANDS, **STRUCTURES}.items():
        commands.register(name, made)


# ---------------------------------------------------------------- build

CELL_COUNTS = ("wanted", "missing", "outside", "other_colour")
"""Of cells, in the summary."""
STATE = "build.jsonl"
"""What a build by an arm appends to, in its folder; gone when the plan is written."""
_BUILD = (
    "planner",
    "kit",
    "friction",
    "gap",
    "arm",
    "agent",
    "layout",
    "seed",
    "seconds",
    "tool",
    "physics",
    "supports",
    "holds",
    "hands",
    "shell",
)
"""Options that are arguments of :func:`learn2assemble.build`."""


@command(
    _COMMANDS,
    "build",
    "plan a design, prove every step, write the report",
    "l2a build examples/designs/gabled_house.json --arm panda --out out/house",
    arg("design", metavar="DESIGN", help="a drawing, picture, mesh, voxels, blocks, or a task"),
    either(
        arg("--out", type=named, help="new or empty folder"),
        arg(
            "--preview",
            type=named,
            metavar="PNG",
            help="only draw what was read and the cells that were chosen, and stop",
        ),
    ),
    arg("--planner", default=None, help="of a design: exact (the default) or agent"),
    group(
        "a design and its blocks (docs/building.md)",
        reading_arguments,
        arg(
            "--friction",
            type=span_of(friction),
            default=None,
            metavar="MU[:MU]",
            help="prove every step for this coefficient or range (the kit's)",
        ),
        arg(
            "--gap",
            type=span_of(length),
            default=None,
            metavar="W[:W]",
            help="width of vertical joints or range of it, e.g. 0:0.5mm (the kit's)",
        ),
        arg(
            "--supports",
            default="auto",
            help="what may carry blocks for a while: auto, none, props (of the kit) or posts "
            "(under given blocks)",
        ),
        arg(
            "--no-props",
            dest="supports",
            action="store_const",
            const="none",
            help="the same as --supports none",
        ),
        arg(
            "--shell",
            type=count,
            default=None,
            metavar="N",
            help="of a design of bricks that clutch: hollow, with walls N cells thick",
        ),
        arg(
            "--hands",
            action="store_true",
            help="of bricks that clutch: from below, too, and several as one, built beside",
        ),
        arg(
            "--holds",
            type=count,
            default=0,
            metavar="K",
            help="of given blocks, how many a hand may hold while the next one comes (0)",
        ),
    ),
    arg("--arm", default=None, help=f"an arm builds it: {' or '.join(ARMS)}"),
    arg(
        "--layout",
        type=named,
        default=None,
        metavar="FILE",
        help="where the blocks wait for the arm (docs/layouts.md); by default around the site",
    ),
    arg(
        "--video",
        action=argparse.BooleanOptionalAction,
        default=True,
        help="of the arm, build.mp4 (needs the extra video)",
    ),
    arg("--tool", default=None, help="of the arm: suction (default), suction-side or gripper"),
    arg(
        "--physics",
        default="dynamic",
        help="cell in which the arm carries out an exact plan: dynamic or kinematic",
    ),
    arg(
        "--sense-noise",
        type=noise,
        default=(0.0, 0.0),
        metavar="MM[:DEG]",
        help="standard deviations of the poses that are read back after every placement",
    ),
    arg("--resume", action="store_true", help="go on with the interrupted build in --out"),
    arg("--seed", type=natural, default=0, help="of the search and of a task's problem"),
    arg("--agent", default=None, help=f"of a design, a builder; of a task, a {AGENT_HELP}"),
    arg(
        "--seconds",
        type=positive,
        default=None,
        help="limit of planning and proof (60), or of the widest search of a task (20)",
    ),
)
def _build(options: argparse.Namespace, output: Output) -> int:
    """Exit code 0 for a complete plan, 1 for an incomplete or refused one."""
    if options.preview is not None:
        return _preview(options, output)
    from learn2assemble.jobs.build import build, builds_with_arm, is_task
    from learn2assemble.planning.tiling.planners import PLANNERS

    with_arm, task = builds_with_arm(options.design, options.arm), is_task(options.design)
    video = options.video and with_arm
    state = options.out / STATE if options.arm and not task else None
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
    if with_arm and options.physics != "kinematic":
        needs.append(("ruckig", "robot", "" if task else "--physics kinematic"))
    if video:
        needs.append(("av", "video", "--no-video"))
    require(*needs)
    with claim_folder(options.out, options.resume):
        output.phase(f"reading {options.design}")
        plan = build(
            options.design,
            **{name: getattr(options, name) for name in _BUILD},
            noise=options.sense_noise,
            state=state,
            progress=output.progress,
            **reading_of(options),
        )
        output.phase("writing the files of the plan")
        files = plan.save(options.out, video=video, progress=output.progress)
        if state is not None and plan.complete:
            state.unlink(missing_ok=True)  # Everything is in the files of the plan now.
    _print_plan(output, plan, files)
    output.finish({**_summary(plan), "files": {k: str(v) for k, v in files.items()}})
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
    arm = None if plan.arm is None else plan.arm.name
    own = options.arm is None and is_task(options.design)  # The arm of the task.
    if not plan.complete or not (own or options.arm == arm):
        raise refused
    output.say(f"{plan.design.name}: {plan.status} already, {plan.blocks.used} blocks; {file}")
    output.finish({**_summary(plan), "files": {"plan": str(file)}})
    return 0


def _preview(options: argparse.Namespace, output: Output) -> int:
    from learn2assemble.viewer.preview import preview

    found = preview(options.design, options.preview, kit=options.kit, **reading_of(options))
    shape, cells = list(found.wanted.shape), int(found.wanted.sum())
    output.say(f"{found.name}: {' × '.join(map(str, shape))} cells, {cells} to fill")
    if found.note:
        output.say(found.note)
    output.say(f"preview: {options.preview}")
    output.finish(
        {
            "design": found.name,
            "shape": shape,
            "cells_wanted": cells,
            "cell": list(found.cell),
            "iou": found.iou,
            "volume_error": found.volume_error,
            "note": found.note,
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
        "friction_range": plan.friction_range,
        "gap_range": plan.gap_range,
        **({"arm": to_plain(plan.arm)} if plan.arm else {}),
    }


def _print_plan(output: Output, plan: Plan, files: dict[str, Path]) -> None:
    """Blocks by kind, then what was filled and what is proven."""
    counts = Counter(
        (step.kind or "block", step.prop) for step in plan.steps if step.action == "place"
    )
    rows = [(kind, "prop" if prop else "", n) for (kind, prop), n in sorted(counts.items())]
    output.table(plan.design.name, ("block", "", "number"), rows)
    number = f"{plan.blocks.used} blocks, {len(plan.steps)} steps"
    output.say(f"{plan.status}: {number}, {plan.planner} planner, {plan.seconds:.1f} s")
    for stage in plan.search.attempts if plan.search else ():
        output.say(f"{stage.stage}: {stage.result}")
    if plan.design.note:
        output.say(plan.design.note)
    if plan.cells:
        cells, design = plan.cells, plan.design
        other = cells.other_colour
        colour = "" if other is None else f", {other} in a block of another colour"
        shape = "" if design.iou is None else f"; {design.iou:.0%} of drawing and cells are common"
        output.say(
            f"cells: {cells.wanted} wanted, {cells.missing} open, {cells.outside} outside"
            f"{colour}{shape}"
        )
        if design.not_read:
            output.say(f"warning: {design.source}: {design.not_read}")
    elif plan.design.targets:
        needed = f"{plan.design.success_threshold:.1%}"
        output.say(f"coverage {plan.coverage:.1%} of the target, more than {needed} is needed")
    if plan.steps and plan.margin_g is not None:
        left = plan.without_margin
        more = f" ({left} of {len(plan.steps)} steps without a computed margin)" * bool(left)
        output.say(
            f"every step is proven; the weakest withstands {plan.margin_g:.3f} g sideways{more}"
        )
    proven = plan.proven_for
    if "friction" in proven and "joints" in proven:
        output.say(
            f"proven for friction {proven['friction']} and vertical joints of {proven['joints']}"
        )
    if plan.arm is not None:
        _print_arm(output, plan.arm)
        blocks = plan.assembly.blocks if plan.assembly else ()
        by_hand = [f"{s.step} ({s.action} {blocks[s.block].id})" for s in plan.steps if s.by_hand]
        if by_hand:
            output.say(f"by hand, while the arm waits: steps {', '.join(by_hand)}")
    if plan.reason:
        output.say(f"why: {plan.reason}")
    for what, path in files.items():
        output.say(f"{what}: {path}")


def _print_arm(output: Output, arm: ArmReport) -> None:
    """What the arm did."""
    for failure in arm.failures:
        after = "; the rest was planned anew" if failure.replanned else ""
        output.say(f"attempt {failure.attempt}: {failure.outcome} ({failure.detail}){after}")
    where = f" at [{', '.join(f'{v:g}' for v in arm.base[:3])}]" if arm.base else ""
    places = f"blocks from {arm.places} places, " if arm.places else ""
    output.say(
        f"arm {arm.name} with {arm.tool}{where}: {arm.attempts} attempts, {places}"
        f"{arm.seconds:.0f} s of robot time"
    )
    if arm.error_mean is not None and arm.error_worst is not None:
        output.say(
            f"blocks stand {1e3 * arm.error_mean:.2f} mm from their places on average, "
            f"{1e3 * arm.error_worst:.2f} mm at most; {arm.attempts_per_step:.3f} attempts a step"
        )


# ---------------------------------------------------------------- train


_TRAIN = (
    "minutes",
    "samples",
    "config",
    "method",
    "seed",
    "device",
    "threads",
    "arm",
    "init",
    "resume",
)
"""Options that are arguments of :func:`learn2assemble.train`."""


@command(
    _COMMANDS,
    "train",
    "train an agent",
    "l2a train two-sided-3x3-20-24 --out runs/first --minutes 15",
    arg("task", metavar="TASK"),
    arg("--method", default=None, help="learner: dqn, q-mcts or eps-mcts"),
    arg(
        "--config",
        default="relational",
        help="relational, relational-objects (ours), published or paper",
    ),
    arg("--out", type=named, required=True, help="new or empty folder, or --resume"),
    arg("--minutes", type=positive, default=None, help="stop after so long"),
    arg("--samples", type=count, default=None, help="environment steps (the configuration's)"),
    arg("--seed", type=natural, default=None, help="of everything random (0)"),
    arg("--seeds", type=count, default=None, help="train so many agents: OUT-s0, OUT-s1, ..."),
    lambda parser: workers_arguments(parser, "trainings at once, with --seeds (1)"),
    arg("--device", default="auto", help="auto, cpu or cuda"),
    arg("--threads", type=count, default=None, help="CPU threads of PyTorch"),
    arm_argument,
    arg("--init", default=None, help="agent whose weights to start from"),
    arg("--resume", action="store_true", help="go on with the run in --out"),
    arg(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="change one setting, e.g. learning_rate=1e-3 or network.heads=1",
    ),
    learns=True,
)
def _train(options: argparse.Namespace, output: Output) -> None:
    from learn2assemble.tasks.learning.run import train, train_seeds

    chosen = {name: getattr(options, name) for name in _TRAIN} | {"settings": options.set}
    if options.seeds is not None:
        runs = train_seeds(
            options.task,
            options.out,
            seeds=options.seeds,
            workers=options.workers or 1,
            ray=options.ray,
            progress=output.progress,
            **chosen,
        )
        names = sorted({name for run in runs for name in run.metrics})
        output.table(
            f"{runs[0].task} ({runs[0].config})",
            ("agent", *names),
            [
                (run.out.name, *[run.metrics.get(name, float("nan")) for name in names])
                for run in runs
            ],
        )
        output.finish(
            {
                "task": runs[0].task,
                "runs": [{"out": str(run.out), **run.metrics} for run in runs],
            }
        )
        return
    if options.workers or options.ray:
        raise InputError("--workers or --ray", "given", "--seeds N beside it")
    run = train(options.task, options.out, **chosen)
    output.table(f"{run.task} ({run.config})", ("quantity", "value"), list(run.metrics.items()))
    output.say(f"agent: {options.out / 'agent.safetensors'}")
    output.finish({"task": run.task, "out": str(options.out), **run.metrics})


# ---------------------------------------------------------------- eval


_EVAL = (
    "agent",
    "search",
    "budget",
    "rollout",
    "distinct",
    "epsilon",
    "episodes",
    "seed",
    "physics",
)
"""Options that are arguments of :func:`learn2assemble.evaluate`."""


def _rollout(text: str) -> int:
    return TO_THE_END if text == "end" else count(text)


@command(
    _COMMANDS,
    "eval",
    "play whole episodes and report the paper's metrics",
    "l2a eval two-sided-3x3-20-24 --search mcts --budget 10 --epsilon 0.05 --episodes 100",
    arg("task", metavar="TASK"),
    arg("--agent", default=None, help=AGENT_HELP),
    arg(
        "--search", choices=("none", *SEARCHES), default="none", help=f"none, {', '.join(SEARCHES)}"
    ),
    arg("--budget", type=natural, default=None, help="the search's own: mostly 10"),
    arg(
        "--rollout", type=_rollout, default=None, help="steps, or 'end'; the search's own: mostly 1"
    ),
    arg(
        "--distinct",
        action="store_true",
        default=None,
        help="expand one of several placements that lead to the same structure (ours, D14)",
    ),
    arg("--legacy", action="store_true", help="search in copies with the published restore faults"),
    arg("--epsilon", type=share, default=None, help="the search's own: 0.05"),
    arg("--episodes", type=count, default=100),
    arg("--seed", type=natural, default=0),
    arg(
        "--physics",
        default=None,
        help="what checks placements: static or rigid; with an arm these stand for its kinematic "
        "workcell, and dynamic and published are others",
    ),
    arm_argument,
    arg("--out", type=named, default=None, help="write the result to this file"),
    learns=True,
)
def _evaluate(options: argparse.Namespace, output: Output) -> None:
    from tqdm import tqdm

    from learn2assemble.tasks.evaluation.episodes import SEARCH_MODELS, evaluate
    from learn2assemble.tasks.task import get_task

    task = get_task(options.task, options.arm)
    check_new_file(options.out)
    if options.legacy and options.search == "none":
        raise InputError("--legacy", "given", "--search NAME beside it")
    with tqdm(total=options.episodes, unit=" episodes", desc=task.name, delay=1) as bar:

        def advance(done: int) -> None:
            bar.update(done - bar.n)

        result = evaluate(
            task,
            **{name: getattr(options, name) for name in _EVAL},
            search_model=SEARCH_MODELS["published"] if options.legacy else None,
            progress=advance,
        )
    write_result(options.out, result.to_dict())
    output.table(task.name, ("metric", "value"), list(result.metrics.to_dict().items()))
    output.finish(result.to_dict())


# ---------------------------------------------------------------- bench, tasks, view


@command(
    _COMMANDS,
    "bench",
    "measure the speed of this machine",
    "l2a bench --seconds 2",
    arg("--seconds", type=positive, default=2.0, help="per measurement"),
)
def _bench(options: argparse.Namespace, output: Output) -> None:
    from learn2assemble.benchmark import MEASUREMENTS, machine

    results: dict[str, float] = {}
    left: dict[str, list[str]] = {}
    for name, measure in MEASUREMENTS.items():
        output.progress(f"measuring {name}")
        try:
            results[name] = measure(options.seconds)
        except MissingExtraError as error:
            left.setdefault(str(error), []).append(name)
    for reason, names in left.items():
        output.progress(f"left out {', '.join(names)}: {reason}")
    rows = [(k, f"{v:,.3g}" if v < 10 else f"{v:,.1f}") for k, v in results.items()]
    output.table("speed", ("measurement", "value"), rows)
    output.finish({**results, "seconds": options.seconds, **machine()})


@command(_COMMANDS, "tasks", "list the tasks and their agents", "l2a tasks", learns=True)
def _tasks(options: argparse.Namespace, output: Output) -> None:
    from learn2assemble.tasks.networks.agent import agent_files, agent_info
    from learn2assemble.tasks.task import DESIGN_TASKS, GOAL_TASKS, PRESETS

    agents: dict[str, list[str]] = {}
    for name in agent_files():
        agents.setdefault(agent_info(name)["task"], []).append(name)
    rows: list[dict[str, Any]] = []
    for name, task in PRESETS.items():
        low, high = task.block_range
        rows.append(
            {
                "name": name,
                "sides": task.num_sides,
                "grid": task.grid,
                "nodes": task.num_nodes,
                "blocks": [low, high],
                "objects": task.objects,
                "arm": task.arm,
                "actions": task.num_actions,
                "discount": task.discount,
                "success_threshold": task.success_threshold,
                "agents": agents.get(name, []),
            }
        )
    output.table(
        "",
        ("task", "sides", "grid", "nodes", "blocks", "objects", "arm", "agents"),
        [
            (
                r["name"],
                r["sides"],
                f"{r['grid']}x{r['grid']}",
                r["nodes"],
                f"{r['blocks'][0]}-{r['blocks'][1]}",
                r["objects"],
                r["arm"],
                ", ".join(r["agents"]) or "-",
            )
            for r in rows
        ],
    )
    designs: list[dict[str, Any]] = [
        {
            "name": name,
            "families": list(task.families),
            "kit": task.kit,
            "blocks": list(task.blocks),
            "limited_heap": task.limited_heap,
        }
        for name, task in DESIGN_TASKS.items()
    ]
    output.table(
        "",
        ("task of designs", "families", "kit", "blocks", "heap"),
        [
            (
                r["name"],
                ", ".join(r["families"]),
                r["kit"],
                f"{r['blocks'][0]}-{r['blocks'][1]}",
                "exact" if r["limited_heap"] else "no limit",
            )
            for r in designs
        ],
    )
    goals = {name: task.goals for name, task in GOAL_TASKS.items()}
    output.table("", ("task of goals", "goals"), list(goals.items()))
    output.finish({"tasks": rows, "designs": designs, "goals": goals})


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
