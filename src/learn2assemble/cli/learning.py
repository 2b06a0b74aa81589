"""The commands of the wing of the paper: train, eval, benchmark, tasks; and bench, which measures
both wings."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from learn2assemble.cli.output import write_result
from learn2assemble.cli.parser import (
    Command,
    arg,
    arm_argument,
    asked,
    command,
    count,
    named,
    natural,
    positive,
    share,
    workers_arguments,
)
from learn2assemble.errors import InputError, MissingExtraError, check_name
from learn2assemble.files import check_new
from learn2assemble.tasks.search.config import SEARCHES, TO_THE_END

if TYPE_CHECKING:
    from learn2assemble.cli.output import Output

COMMANDS: dict[str, Command] = {}
AGENT_HELP = "shipped agent, .safetensors or run folder"


# ---------------------------------------------------------------- train


@command(
    COMMANDS,
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

    chosen = asked(train, options, "task", "out") | {"settings": options.set}
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
    for name in ("workers", "ray"):
        if getattr(options, name):
            raise InputError(f"--{name}", getattr(options, name), "none without --seeds N")
    run = train(options.task, options.out, **chosen)
    output.table(f"{run.task} ({run.config})", ("quantity", "value"), list(run.metrics.items()))
    output.say(f"agent: {options.out / 'agent.safetensors'}")
    output.finish({"task": run.task, "out": str(options.out), **run.metrics})


# ---------------------------------------------------------------- eval


def _rollout(text: str) -> int:
    return TO_THE_END if text == "end" else count(text)


@command(
    COMMANDS,
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
    arg(
        "--look-ahead",
        default=None,
        metavar="PHYSICS",
        help="what checks the placements that a search tries (the task's own)",
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
    if options.out is not None:
        check_new(options.out, "--out")
    if options.legacy and options.search == "none":
        raise InputError(
            "--legacy", "--search none", f"--search NAME beside it, one of {', '.join(SEARCHES)}"
        )
    with tqdm(total=options.episodes, unit=" episodes", desc=task.name, delay=1) as bar:

        def advance(done: int) -> None:
            bar.update(done - bar.n)

        result = evaluate(
            task,
            **asked(evaluate, options, "task", "arm"),
            search_model=SEARCH_MODELS["published"] if options.legacy else None,
            progress=advance,
        )
    write_result(options.out, result.to_dict())
    output.table(task.name, ("metric", "value"), list(result.metrics.to_dict().items()))
    output.finish(result.to_dict())


# ---------------------------------------------------------------- bench, tasks


@command(
    COMMANDS,
    "bench",
    "measure the speed of this machine",
    "l2a bench --seconds 2",
    arg("names", nargs="*", metavar="NAME", help="of a measurement (all of them)"),
    arg("--seconds", type=positive, default=2.0, help="per measurement"),
)
def _bench(options: argparse.Namespace, output: Output) -> None:
    from learn2assemble.benchmark import MEASUREMENTS, machine

    results: dict[str, float] = {}
    left: dict[str, list[str]] = {}
    for name in options.names:
        check_name("measurement", name, MEASUREMENTS)
    for name in options.names or MEASUREMENTS:
        output.progress(f"measuring {name}")
        try:
            results[name] = MEASUREMENTS[name](options.seconds)
        except MissingExtraError as error:
            left.setdefault(str(error), []).append(name)
    for reason, names in left.items():
        output.progress(f"left out {', '.join(names)}: {reason}")
    rows = [(k, f"{v:,.3g}" if v < 10 else f"{v:,.1f}") for k, v in results.items()]
    output.table("speed", ("measurement", "value"), rows)
    output.finish({**results, "seconds": options.seconds, **machine()})


# ---------------------------------------------------------------- benchmark


@command(
    COMMANDS,
    "benchmark",
    "enter the benchmark: play it, check a file by playing it again, show the board",
    "l2a benchmark check results/benchmark/random.jsonl.gz",
    arg("action", choices=("run", "check", "board"), help="run writes one file; the others read"),
    arg("files", nargs="+", type=named, metavar="FILE", help="NAME.jsonl.gz"),
    arg(
        "--policy",
        dest="policies",
        action="append",
        help="random, random:SEED, look-ahead, exact-planner, planner-with-repair, "
        "planner-without-looks, shipped, agent:NAME, module:name or file.py:name; several are runs "
        "of one entry",
    ),
    arg("--server", default=None, metavar="HOST:PORT", help="a policy in another process"),
    arg("--name", default=None, help="of the entry (the policy's)"),
    arg("--task", dest="tasks", action="append", help="of the suite, may be repeated (all)"),
    arg("--problems", type=count, default=None, help="the first so many of every task (all)"),
    learns=True,
)
def _benchmark(options: argparse.Namespace, output: Output) -> None:
    from learn2assemble.envs import submission as entries

    if options.action == "run":
        return _enter(options, output)
    flags = {"policies": "--policy", "tasks": "--task"}
    for name in ("policies", "server", "name", "tasks", "problems"):
        if (given := getattr(options, name)) is not None:
            flag = flags.get(name, f"--{name}")
            raise InputError(flag, given, "nothing, but with run")
    read = entries.check if options.action == "check" else entries.read_submission
    found = [read(file) for file in options.files]
    output.say(entries.board(found).rstrip())
    output.finish({"action": options.action, "entries": [entries.summary(one) for one in found]})


def _enter(options: argparse.Namespace, output: Output) -> None:
    from learn2assemble.envs import submission as entries
    from learn2assemble.envs.policies import RemoteChoice, load_policy
    from learn2assemble.envs.suite import SUITE

    if len(options.files) != 1:
        raise InputError("FILE", [str(file) for file in options.files], "one file to write")
    if (options.policies is None) == (options.server is None):
        raise InputError("--policy or --server", "both or none of them", "one of them")
    entries.check_path(options.files[0])
    check_new(options.files[0], "FILE")
    policies = [load_policy(one) for one in options.policies or ()]
    name = ", ".join(one.rpartition(":")[2] for one in options.policies or ["server"])
    found = entries.enter(
        policies or RemoteChoice(options.server),
        options.name or name,
        tasks=tuple(options.tasks or SUITE),
        problems=options.problems,
        progress=output.progress,
    )
    found.write(options.files[0])
    output.say(entries.board([found]).rstrip())
    output.finish({"action": "run", "entries": [entries.summary(found)]})


@command(
    COMMANDS,
    "agents",
    "list the trained agents there are, or fetch others",
    "l2a agents fetch dqn-s0 --from ../agents-of-a-release",
    arg(
        "action",
        nargs="?",
        choices=("list", "fetch"),
        default="list",
        help="list names those that are here, and those to fetch",
    ),
    arg("names", nargs="*", metavar="NAME", help="with fetch: which (all)"),
    arg("--from", dest="source", default=None, help="folder or address (that of the release)"),
    learns=True,
)
def _agents(options: argparse.Namespace, output: Output) -> None:
    from learn2assemble.tasks.networks.agent import agent_files, agent_info
    from learn2assemble.tasks.networks.agent_fetch import fetch_agents, listed_agents

    if options.action == "fetch":
        files = fetch_agents(options.names, options.source, progress=output.progress)
        output.say(f"{len(files)} agents in {files[0].parent}" if files else "no agents")
        return output.finish({"files": [str(file) for file in files]})
    if options.source is not None:
        raise InputError("--from", options.source, "none, but with fetch")
    if options.names:
        raise InputError(
            "NAME", " ".join(options.names), f"none with {options.action}; fetch takes names"
        )
    here = {name: agent_info(name)["task"] for name in agent_files()}
    absent = {name: told.bytes for name, told in listed_agents().agents.items() if name not in here}
    output.table("", ("agent", "task"), list(here.items()))
    if absent:
        size = sum(absent.values()) / 1e6
        output.say(f"to fetch ({size:.1f} MB): {', '.join(absent)}")
    output.finish({"here": here, "to_fetch": list(absent)})


@command(
    COMMANDS,
    "demonstrate",
    "demonstrations as a data set of Minari: an agent plays, or the exact planner builds",
    "l2a demonstrate two-sided-3x3-20-24 --episodes 1000 --out out/demonstrations",
    arg("task", metavar="TASK", help="of placements, or of designs"),
    arg("--out", type=named, default=None, help="folder of the data sets (that of Minari)"),
    arg("--agent", default=None, help=f"{AGENT_HELP} (the shipped one)"),
    arg("--episodes", type=count, default=10_000),
    arg("--seed", type=natural, default=0),
    arg("--workers", type=count, default=1, help="processes"),
    learns=True,
)
def _demonstrate(options: argparse.Namespace, output: Output) -> None:
    from learn2assemble.envs.demonstrations import demonstrate

    made = demonstrate(
        options.task,
        options.out,
        agent=options.agent,
        episodes=options.episodes,
        seed=options.seed,
        workers=options.workers,
        progress=output.progress,
    )
    told = made._asdict() | {"folder": str(made.folder)}
    output.table("", ("quantity", "value"), list(told.items()))
    output.finish(told)


@command(COMMANDS, "tasks", "list the tasks and their agents", "l2a tasks", learns=True)
def _tasks(options: argparse.Namespace, output: Output) -> None:
    from learn2assemble.tasks.networks.agent import agent_files, agent_info
    from learn2assemble.tasks.task import DESIGN_TASKS, GOAL_TASKS, HIDDEN_TASKS, PRESETS

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
    _list(output, "task", ("sides", "grid", "nodes", "blocks", "objects", "arm", "agents"), rows)
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
    _list(output, "task of designs", ("families", "kit", "blocks", "heap"), designs)
    goals = {name: task.goals for name, task in GOAL_TASKS.items()}
    output.table("", ("task of goals", "goals"), list(goals.items()))
    hidden = {
        name: {"kit": task.kit, "blocks": list(task.blocks)} for name, task in HIDDEN_TASKS.items()
    }
    told = [
        (name, one["kit"], " to ".join(map(str, one["blocks"]))) for name, one in hidden.items()
    ]
    output.table("", ("task with hidden errors", "kit", "blocks"), told)
    output.finish({"tasks": rows, "designs": designs, "goals": goals, "hidden": hidden})


_SHOWN: dict[str, Callable[[dict[str, Any]], object]] = {
    "grid": lambda row: f"{row['grid']}x{row['grid']}",
    "blocks": lambda row: "{}-{}".format(*row["blocks"]),
    "agents": lambda row: ", ".join(row["agents"]) or "-",
    "families": lambda row: ", ".join(row["families"]),
    "heap": lambda row: "exact" if row["limited_heap"] else "no limit",
}
"""What a table shows of a task, where it is not the value as it is."""


def _list(output: Output, what: str, columns: tuple[str, ...], rows: list[dict[str, Any]]) -> None:
    names = ("name", *columns)
    shown = [[_SHOWN[k](row) if k in _SHOWN else row[k] for k in names] for row in rows]
    output.table("", (what, *columns), shown)
