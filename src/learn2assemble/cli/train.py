"""``l2a train``: train an agent."""

from __future__ import annotations

import argparse
import dataclasses
import json

import torch

from learn2assemble.cli.output import Output
from learn2assemble.errors import InputError, UnknownNameError
from learn2assemble.learning.config import METHODS, TrainConfig, fit_to, get_config, override
from learn2assemble.learning.run import train
from learn2assemble.networks.agent import load_agent
from learn2assemble.tasks import NO_ARM, get_task


def run(options: argparse.Namespace) -> int:
    output = Output(options.json)
    get_task(options.task, options.arm)
    if options.method is not None and options.method not in METHODS:
        raise UnknownNameError("--method", options.method, METHODS)
    if options.threads:
        torch.set_num_threads(options.threads)
    config, seed, minutes, arm = _settings(options)
    task = get_task(options.task, arm)
    init = None
    if options.init is not None:
        if options.resume:
            raise InputError("--init", options.init, "not together with --resume")
        init = load_agent(options.init)
    metrics = train(
        task, config, options.out, seed=seed, minutes=minutes, device=options.device,
        resume=options.resume, init=init,
    )  # fmt: skip
    output.table(f"{task.name} ({options.config})", ("quantity", "value"), list(metrics.items()))
    output.say(f"agent: {options.out / 'agent.safetensors'}")
    output.finish({"task": task.name, "out": str(options.out), **metrics})
    return 0


def _settings(
    options: argparse.Namespace,
) -> tuple[TrainConfig, int, float | None, str | None]:
    """Configuration, seed, minutes, arm: of the run that is resumed, else of the command line."""
    if not options.resume:
        method = [] if options.method is None else [f"method={options.method}"]
        config = fit_to(get_config(options.config), get_task(options.task))
        config = override(config, [*method, *options.set])
        if options.samples is not None:
            config = dataclasses.replace(config, num_samples=options.samples)
        return config, options.seed or 0, options.minutes, options.arm
    file = options.out / "config.json"
    try:
        saved = json.loads(file.read_text(encoding="utf-8"))
        config = TrainConfig.from_dict(saved["config"])
        task, seed, minutes = saved["task"]["name"], saved["seed"], saved["minutes"]
        arm = saved["task"].get("arm", NO_ARM)
    except (OSError, ValueError, KeyError, TypeError):
        raise InputError("--resume", str(options.out), "the folder of a training run") from None
    if task != options.task:
        raise InputError("TASK", options.task, f"{task}, the task of the run to resume")
    given = (options.samples, options.arm, options.seed)
    if options.set or any(value is not None for value in given):
        raise InputError(
            "--resume", "--set, --samples, --arm or --seed", "the run's own configuration"
        )
    minutes = options.minutes if options.minutes is not None else minutes
    return config, seed, minutes, arm if get_task(task).has_arm else None
