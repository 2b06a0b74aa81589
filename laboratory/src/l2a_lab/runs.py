"""What is kept of trainings: configuration and log of every run in one pack, and its agent.

A run is a line of the pack (:mod:`.packed`), ``results/runs.jsonl.gz``: ``name``, ``config``
(``config.json`` of its folder), ``log`` (the objects of ``log.jsonl``) and, where they are in the
folder, ``evaluations`` (``eval-NAME.json`` by ``NAME``).
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from l2a_lab.packed import read_pack, write_pack
from learn2assemble.cli.parser import Command, arg, command, named, overwrite_argument
from learn2assemble.errors import InputError, Remedy
from learn2assemble.files import (
    check_exists,
    check_new,
    make_folder,
    read_json,
    read_json_lines,
    write_file,
)

if TYPE_CHECKING:
    import argparse

    from learn2assemble.cli.output import Output
    from learn2assemble.tasks.networks.agent import Agent

COMMANDS: dict[str, Command] = {}
RUNS = Path("results/runs.jsonl.gz")
"""The pack of a checkout."""
STAGE = ".stage"
"""What follows the name of an agent in that of an early stage of its training."""

Run = Mapping[str, Any]


def read_runs(pack: Path) -> dict[str, Run]:
    """The runs of a pack by name.

    Raises:
        InputError: for a file that does not exist, and what is no pack of runs.
    """
    check_exists(pack, "file of runs")
    try:
        if not pack.is_file():
            raise ValueError
        runs = {name: json.loads(text) for name, text in read_pack(pack).items()}
    except (OSError, EOFError, ValueError, zlib.error):
        raise InputError("--runs", str(pack), "a file of runs, runs.jsonl.gz") from None
    for name, run in runs.items():
        if not isinstance(run.get("config"), dict) or not isinstance(run.get("log"), list):
            raise InputError(f"{pack}: {name}", "no run", "config and log of a training")
    return runs


def runs_in(folders: Iterable[Path]) -> dict[str, Run]:
    """The runs in folders of trainings, called as these are.

    Raises:
        InputError: where one of them is no folder of a training.
    """
    return {folder.absolute().name: _run(folder) for folder in folders}


def _run(folder: Path) -> Run:
    check_exists(folder, "folder of a training run")
    run: dict[str, Any] = {
        "config": read_json(folder / "config.json", "configuration of a run")[0],
        "log": [dict(line) for line in read_json_lines(folder / "log.jsonl", "log of a run")],
    }
    evaluations = {
        file.stem.removeprefix("eval-"): read_json(file, "evaluation")[0]
        for file in sorted(folder.glob("eval-*.json"))
    }
    return {**run, "evaluations": evaluations} if evaluations else run


def keep_runs(runs: Mapping[str, Run], pack: Path) -> None:
    """Put runs into a pack; one of the same name takes the old one's place.

    Args:
        runs: by name.
        pack: is made where it does not exist, in a folder that does.

    Raises:
        InputError: where it is no pack of runs, or cannot be written.
    """
    write_pack(pack, {**(read_runs(pack) if pack.exists() else {}), **runs})


def trained_agent(folder: Path) -> Agent | None:
    """The agent of a training, called as its folder is; ``None`` for an early stage, whose agent is
    only what the next one starts from.

    Raises:
        InputError: where there is none.
    """
    # PyTorch is loaded only by those who keep agents.
    from learn2assemble.tasks.networks.agent import load_agent

    name = folder.absolute().name
    return None if STAGE in name else replace(load_agent(folder), name=name)


def list_agents(folder: Path) -> None:
    """Bring the package's list of agents to fetch up to date, where ``folder`` is that of the
    checkout."""
    from learn2assemble.tasks.networks.agent import PRETRAINED, REPOSITORY
    from learn2assemble.tasks.networks.agent_fetch import (
        ENDING,
        LIST,
        AgentList,
        ListedAgent,
        listed_agents,
    )

    if folder.resolve() == REPOSITORY:
        found = {file.stem: ListedAgent.of(file) for file in folder.glob(f"*{ENDING}")}
        text = AgentList(listed_agents().release, found).text()
        write_file(PRETRAINED / LIST, text, "list of agents")
        listed_agents.cache_clear()


# ---------------------------------------------------------------- the command


@command(
    COMMANDS,
    "keep",
    "keep a finished training: its agent in agents/, configuration and log with the results",
    "l2a-lab keep runs/dqn-s0",
    arg("folders", metavar="FOLDER", nargs="+", type=named, help="of a training; its name is kept"),
    arg("--runs", type=named, default=RUNS, help="file that takes configuration and log"),
    arg("--agents", type=named, default=Path("agents"), help="folder that takes the agent"),
    overwrite_argument,
)
def _run_keep(options: argparse.Namespace, output: Output) -> None:
    """Keep finished trainings: all of them, or none."""
    from learn2assemble.tasks.networks.agent import save_agent
    from learn2assemble.tasks.networks.agent_fetch import ENDING

    # All of them are read before anything is written.
    runs = runs_in(options.folders)
    agents = [agent for agent in map(trained_agent, options.folders) if agent is not None]
    if len(runs) < len(options.folders):
        names = " ".join(folder.absolute().name for folder in options.folders)
        raise InputError("FOLDER", names, "trainings of different names")
    kept = read_runs(options.runs) if options.runs.exists() and not options.overwrite else {}
    for name in runs:
        if name in kept:
            new = Remedy("overwrite", True, "replaces it")
            raise InputError(f"{options.runs}", name, "trainings that it has not yet", new)
    make_folder(options.runs.parent, "--runs")
    make_folder(options.agents, "--agents")
    for agent in agents:
        file = options.agents / f"{agent.name}{ENDING}"
        check_new(file, "agent", *options.folders, overwrite=options.overwrite)
    files = [str(save_agent(agent, options.agents)) for agent in agents]
    list_agents(options.agents)
    keep_runs(runs, options.runs)
    for text in (*files, f"{options.runs}: {', '.join(runs)}"):
        output.say(text)
    output.finish({"runs": list(runs), "agents": files})
