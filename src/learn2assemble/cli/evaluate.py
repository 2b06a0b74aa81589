"""``l2a eval``: whole episodes and the paper's metrics."""

from __future__ import annotations

import argparse
import dataclasses
import json
from pathlib import Path
from typing import Any

import torch
from tqdm import tqdm

from learn2assemble.checkers import resolve_judge
from learn2assemble.cli.output import Output
from learn2assemble.errors import InputError
from learn2assemble.evaluation.episodes import make_policy, run_episodes
from learn2assemble.learning.run import provenance
from learn2assemble.networks.agent import default_agent, load_agent
from learn2assemble.reproduction.restore_faults import with_restore_faults
from learn2assemble.search.config import SearchConfig, get_search
from learn2assemble.tasks import get_task


def _advance(bar: tqdm, done: int) -> None:
    bar.update(done - bar.n)


def search_config(options: argparse.Namespace) -> SearchConfig | None:
    """The named search with the options that were given in place of its own."""
    if options.search == "none":
        return None
    config = get_search("dqn-mcts" if options.search == "mcts" else options.search)
    given: dict[str, Any] = {"epsilon": options.epsilon}
    for name in ("budget", "rollout"):
        if getattr(options, name) is not None:
            given[name] = getattr(options, name)
    if options.distinct:
        given["distinct"] = True
    return dataclasses.replace(config, **given)


def check_new_file(path: Path) -> None:
    """Refuse a result file that could not be written, before hours of episodes.

    Raises:
        InputError: where it exists, or its folder does not or cannot be written.
    """
    try:
        if path.exists():
            raise InputError("--out", str(path), "a new file")
        path.touch()
        path.unlink()
    except OSError as error:
        reason = error.strerror or "unwritable"
        raise InputError("--out", str(path), f"a writable file ({reason})") from None


def run(options: argparse.Namespace) -> int:
    output = Output(options.json)
    task = get_task(options.task, options.arm)
    physics = resolve_judge(options.physics, task)
    agent = load_agent(options.agent or default_agent(task.name))
    if options.out is not None:
        check_new_file(options.out)
    # One thread: small batches lose more by sharing than they gain.
    torch.set_num_threads(1)
    config = search_config(options)
    model = with_restore_faults if options.legacy else lambda exact: exact
    policy = make_policy(task, agent.network, config, options.epsilon, search_model=model)
    with tqdm(total=options.episodes, unit=" episodes", desc=task.name) as bar:
        metrics = run_episodes(
            task, policy, options.episodes, options.seed, physics,
            progress=lambda done: _advance(bar, done),
        )  # fmt: skip
    result = {
        **metrics.to_dict(),
        "task": task.name,
        "agent": agent.name,
        "search": options.search,
        "budget": config.budget if config else 0,
        "rollout": config.rollout if config else 0,
        "distinct": bool(config and config.distinct),
        "legacy": options.legacy,
        "epsilon": options.epsilon,
        "seed": options.seed,
        "provenance": provenance("cpu"),
    }
    if options.out is not None:
        try:
            options.out.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
        except OSError as error:
            reason = error.strerror or "unwritable"
            raise InputError("--out", str(options.out), f"a writable file ({reason})") from None
    output.table(task.name, ("metric", "value"), list(metrics.to_dict().items()))
    output.finish(result)
    return 0
