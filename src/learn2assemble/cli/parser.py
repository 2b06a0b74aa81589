"""Arguments of every command. Nothing heavy is imported before a command is chosen."""

from __future__ import annotations

import argparse
import difflib
import importlib
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

from learn2assemble import __version__
from learn2assemble.search.config import SEARCHES

ARM_HELP = "panda, ur5e or none; the task's own"
COMMANDS = (
    "build",
    "train",
    "eval",
    "table",
    "curves",
    "replay",
    "fidelities",
    "bench",
    "tasks",
    "view",
)


class _Parser(argparse.ArgumentParser):
    """Reports a wrong call in one line and exits with 2."""

    def error(self, message: str) -> NoReturn:
        text = " ".join(message.split())
        if "invalid choice" in text and "(choose from" in text:
            text = self._with_hint(text)
        sys.stderr.write(f"{self.prog}: error: {text} (see {self.prog} --help)\n")
        raise SystemExit(2)

    def _with_hint(self, text: str) -> str:
        head, _, choices = text.partition(" (choose from ")
        got = head.split("invalid choice: ", 1)[1].strip("'")
        valid = [choice.strip(" ')") for choice in choices.split(",")]
        near = difflib.get_close_matches(got, valid, n=1, cutoff=0.4)
        return text + (f"; did you mean {near[0]!r}?" if near else "")


def _number(cast: type, low: float, high: float, words: str) -> Callable[[str], Any]:
    """An argparse type for finite numbers in a range."""

    def parse(text: str) -> Any:
        try:
            value = cast(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f"got {text!r}, expected {words}") from None
        if not math.isfinite(value) or not low <= value <= high:
            raise argparse.ArgumentTypeError(f"got {text!r}, expected {words}")
        return value

    return parse


_count = _number(int, 1, 10**9, "a whole number of at least 1")
_natural = _number(int, 0, 2**31 - 1, "a whole number of at least 0")
_share = _number(float, 0, 1, "a number between 0 and 1")
_positive = _number(float, 1e-3, 1e7, "a positive number")


def _rollout(text: str) -> int:
    return 10_000 if text == "end" else _count(text)


def _run(module: str) -> Callable[[argparse.Namespace], int]:
    """The command's function, imported when it is called."""

    def run(options: argparse.Namespace) -> int:
        return importlib.import_module(f"learn2assemble.cli.{module}").run(options)

    return run


def make_parser() -> argparse.ArgumentParser:
    """The parser of ``l2a`` and its commands; ``options.run`` is the command chosen."""
    parser = _Parser(
        prog="l2a", description="From a target design to a verified build plan.",
        epilog="example: l2a build examples/designs/gabled_house.json --out out/house",
    )  # fmt: skip
    parser.add_argument("--version", action="version", version=f"learn2assemble {__version__}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True, parser_class=_Parser)

    def command(name: str, module: str, help_text: str, example: str) -> argparse.ArgumentParser:
        added = commands.add_parser(
            name, help=help_text, description=help_text, epilog=f"example: {example}"
        )
        added.add_argument(
            "--json", action="store_true",
            help="end standard output with one JSON object; all else goes to standard error",
        )  # fmt: skip
        added.set_defaults(run=_run(module))
        return added

    build = command(
        "build", "build", "plan a design, prove every step, write the report",
        "l2a build examples/designs/gabled_house.json --arm panda --out out/house",
    )  # fmt: skip
    build.add_argument("design", metavar="DESIGN", help="a design file, or the name of a preset")
    build.add_argument("--out", type=Path, required=True, help="new or empty folder")
    build.add_argument("--arm", default=None, help="an arm builds it: panda or ur5e")
    build.add_argument(
        "--layout", type=Path, default=None, metavar="FILE",
        help="where the blocks wait for the arm (docs/layouts.md); by default around the site",
    )  # fmt: skip
    build.add_argument(
        "--video", action=argparse.BooleanOptionalAction, default=True,
        help="of the arm, build.mp4 (needs the extra video)",
    )  # fmt: skip
    build.add_argument("--seed", type=_natural, default=0, help="of the preset's problem")
    build.add_argument("--agent", default=None, help="shipped agent, .safetensors or run folder")
    build.add_argument(
        "--seconds", type=_positive, default=20.0, help="limit of the widest search [s]"
    )

    train = command(
        "train", "train", "train an agent",
        "l2a train two-sided-3x3-20-24 --out runs/first --minutes 15",
    )  # fmt: skip
    train.add_argument("task", metavar="TASK")
    train.add_argument("--method", default=None, help="learner: dqn, q-mcts or eps-mcts")
    train.add_argument(
        "--config",
        default="relational",
        help="relational, relational-objects (ours), published or paper",
    )
    train.add_argument("--out", type=Path, required=True, help="new or empty folder, or --resume")
    length = train.add_mutually_exclusive_group()
    length.add_argument("--minutes", type=_positive, default=None)
    length.add_argument("--samples", type=_count, default=None)
    train.add_argument("--seed", type=_natural, default=None, help="0 by default")
    train.add_argument("--device", default="auto", help="auto, cpu or cuda")
    train.add_argument("--threads", type=_count, default=None, help="CPU threads of PyTorch")
    train.add_argument("--arm", default=None, help=ARM_HELP)
    train.add_argument("--init", default=None, help="agent whose weights to start from")
    train.add_argument("--resume", action="store_true", help="go on with the run in --out")
    train.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE",
        help="change one setting, e.g. learning_rate=1e-3 or network.heads=1",
    )  # fmt: skip

    evaluate = command(
        "eval", "evaluate", "play whole episodes and report the paper's metrics",
        "l2a eval two-sided-3x3-20-24 --search mcts --budget 10 --epsilon 0.05 --episodes 100",
    )  # fmt: skip
    evaluate.add_argument("task", metavar="TASK")
    evaluate.add_argument("--agent", default=None, help="shipped agent, .safetensors or run folder")
    evaluate.add_argument(
        "--search",
        choices=("none", *SEARCHES, "mcts"),
        default="none",
        help=f"none, {', '.join(SEARCHES)}, or mcts for dqn-mcts",
    )
    evaluate.add_argument(
        "--budget", type=_natural, default=None, help="the search's own: mostly 10"
    )
    evaluate.add_argument(
        "--rollout", type=_rollout, default=None, help="steps, or 'end'; the search's own: mostly 1"
    )
    evaluate.add_argument(
        "--distinct", action="store_true",
        help="expand one of several placements that lead to the same structure (ours, D14)",
    )  # fmt: skip
    evaluate.add_argument(
        "--legacy", action="store_true", help="search in copies with the published restore faults"
    )
    evaluate.add_argument("--epsilon", type=_share, default=0.05)
    evaluate.add_argument("--episodes", type=_count, default=100)
    evaluate.add_argument("--seed", type=_natural, default=0)
    evaluate.add_argument(
        "--physics", default="static",
        help="the judge: static or rigid; with an arm these stand for its kinematic cell, and "
        "dynamic and published are others",
    )  # fmt: skip
    evaluate.add_argument("--arm", default=None, help=ARM_HELP)
    evaluate.add_argument("--out", type=Path, default=None, help="write the result to this file")

    table = command(
        "table", "table", "measure a table of the paper and print it beside the paper's numbers",
        "l2a table T2",
    )  # fmt: skip
    table.add_argument("name", metavar="NAME", help="T1, T2, T5, A2, A3, A4, A6 or shipped")
    table.add_argument("--out", type=Path, default=Path("results"), help="folder of the results")
    table.add_argument("--episodes", type=_count, default=None, help="of an agent in a cell (100)")
    table.add_argument("--workers", type=_count, default=None, help="processes (all cores)")
    table.add_argument(
        "--quick", action="store_true",
        help="one agent a row and 50 episodes, into the folder quick below --out",
    )  # fmt: skip
    source = table.add_mutually_exclusive_group()
    source.add_argument(
        "--agents", type=Path, default=None, help="folder of agents or runs (the shipped ones)"
    )
    source.add_argument(
        "--train", action="store_true", help="first train all its agents in --runs, or go on"
    )
    source.add_argument(
        "--from-files", action="store_true", help="measure nothing: print what --out holds"
    )
    table.add_argument("--runs", type=Path, default=Path("runs"), help="folder of --train")
    table.add_argument(
        "--into", type=Path, default=None, help="also put the main numbers into this page"
    )

    curves = command("curves", "curves", "draw learning curves", "l2a curves algorithms")
    curves.add_argument("name", metavar="NAME", help="architectures, connectivity or algorithms")
    curves.add_argument(
        "--runs", type=Path, default=Path("results/runs"), help="folder with logs of runs"
    )
    curves.add_argument("--out", type=Path, default=Path("results/curves"), help="folder")

    replay = command(
        "replay", "replay", "repeat recorded transitions and report the agreement",
        "l2a replay tests/data/transitions_sample.jsonl",
    )  # fmt: skip
    replay.add_argument("files", metavar="FILE", nargs="+", type=Path)

    fidelities = command(
        "fidelities", "fidelities", "the kinematic cell of an arm against the dynamic one",
        "l2a fidelities robot-two-sided-3x3-10-14 robot-four-sided-3x3-10-18 --actions 250",
    )  # fmt: skip
    fidelities.add_argument("tasks", metavar="TASK", nargs="+")
    fidelities.add_argument("--actions", type=_count, default=100, help="moves of every task")
    fidelities.add_argument(
        "--agent", default=None, help="who builds what the moves are drawn from"
    )
    fidelities.add_argument("--arm", default=None, help=ARM_HELP)
    fidelities.add_argument("--seed", type=_natural, default=0)
    fidelities.add_argument("--out", type=Path, default=None, help="new file for the result")

    bench = command("bench", "bench", "measure the speed of this machine", "l2a bench --seconds 2")
    bench.add_argument("--seconds", type=_positive, default=2.0, help="per measurement")

    command("tasks", "tasks", "list the presets and their agents", "l2a tasks")

    view = command("view", "view", "open the page of a finished plan", "l2a view out/house")
    view.add_argument("plan", metavar="PLAN", type=Path, help="plan.json or its folder")
    view.add_argument("--port", type=_number(int, 0, 65535, "a port number"), default=0)
    view.add_argument("--no-browser", action="store_true", help="only serve the page")
    return parser
