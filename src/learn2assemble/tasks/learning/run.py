"""A training run in a folder: progress, logs, checkpoints, resume.

``config.json`` (task, configuration, seed, versions), ``log.jsonl`` (one line per interval),
``tensorboard/`` where TensorBoard is installed, ``state.safetensors`` (everything needed to go
on), ``agent.safetensors`` (the network so far).
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import importlib.metadata
import importlib.util
import json
import math
import os
import platform
import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from learn2assemble.errors import (
    InputError,
    check_arguments,
    check_instance,
    extra,
    is_number,
    is_whole,
)
from learn2assemble.files import (
    MAX_GENERATED,
    append_line,
    as_path,
    check_exists,
    claim_folder,
    holds_something,
    read_json,
    read_text,
    write_file,
)
from learn2assemble.tasks.learning.config import CONFIGS, TrainConfig, fit_to, override
from learn2assemble.tasks.learning.trainer import Trainer
from learn2assemble.tasks.networks.agent import Agent, load_agent, save_agent
from learn2assemble.tasks.task import NO_ARM, Task, get_task
from learn2assemble.values import integer, load_json, mapping, number, text
from learn2assemble.workers import run_all

with extra("torch", "learn"):
    import torch
with extra("tqdm", "learn"):
    from tqdm import tqdm

MAX_THREADS = 1024
LOG_SECONDS = 10.0
CHECKPOINT_SECONDS = 45.0
"""A kill loses at most this much work."""
_GO_ON = "go on with `resume=`"
"""What can be done with a folder in which a training stands already."""


def choose_device(name: str) -> str:
    """``auto`` becomes ``cuda`` where a GPU is usable.

    Raises:
        InputError: for an unknown device or CUDA without a GPU.
    """
    if name not in ("auto", "cpu", "cuda"):
        raise InputError("device", name, "auto, cpu or cuda")
    available = torch.cuda.is_available()
    if name == "cuda" and not available:
        raise InputError("device", name, "cpu (no CUDA device is usable here)")
    return "cuda" if name != "cpu" and available else "cpu"


def _commit() -> str:
    """Commit of the checkout that holds this package, and whether its code was changed since; where
    none tracks it, version and fingerprint of the code."""
    here = Path(__file__)
    # Variables of git that a hook sets would point to another repository.
    env = {name: value for name, value in os.environ.items() if not name.startswith("GIT_")}
    git = functools.partial(
        subprocess.run,
        cwd=here.parent,
        env=env,
        capture_output=True,
        text=True,
        check=True,
        timeout=5,
    )
    try:
        git(["git", "ls-files", "--error-unmatch", here.name])
        commit = git(["git", "rev-parse", "--short", "HEAD"]).stdout.strip()
        changed = git(["git", "status", "-s", "-uno", "--", ":/src", ":/laboratory/src"])
        return commit + (" and changes" if changed.stdout.strip() else "")
    except (OSError, subprocess.SubprocessError):
        return f"version {_version()}, code {_fingerprint(here.parents[2])}"


def _version() -> str:
    try:
        return importlib.metadata.version("learn2assemble")
    except importlib.metadata.PackageNotFoundError:
        return "unknown"


def _fingerprint(package: Path) -> str:
    """Twelve digits that change with any module of a package."""
    digest = hashlib.sha256()
    for file in sorted(package.rglob("*.py")):
        digest.update(file.read_bytes())
    return digest.hexdigest()[:12]


def provenance(device: str) -> dict[str, Any]:
    """Versions, hardware and commit, for run files and results."""
    hardware = f"{os.cpu_count()} CPU cores ({platform.machine()})"
    if device == "cuda":
        hardware += f", {torch.cuda.get_device_name()}"
    return {
        "commit": _commit(),
        "python": platform.python_version(),
        "torch": torch.__version__,
        "hardware": hardware,
        "threads": torch.get_num_threads(),
        "device": device,
    }


class _Logs:
    """``log.jsonl`` and, where installed, TensorBoard."""

    def __init__(self, out: Path, samples: int) -> None:
        self.file = out / "log.jsonl"
        _drop_lines_after(self.file, samples)
        self.last = samples if self.file.exists() and self.file.stat().st_size else -1
        self.writer: Any = None
        if importlib.util.find_spec("tensorboard") is not None:
            from torch.utils.tensorboard import SummaryWriter

            self.writer = SummaryWriter(str(out / "tensorboard"), purge_step=samples)

    def write(self, metrics: dict[str, float]) -> None:
        """One line, unless nothing was sampled since the last one."""
        if metrics["samples"] == self.last:
            return
        self.last = int(metrics["samples"])
        append_line(self.file, json.dumps(metrics), "log")
        if self.writer is not None:
            for key, value in metrics.items():
                if key != "samples":
                    self.writer.add_scalar(key, value, int(metrics["samples"]))

    def close(self) -> None:
        if self.writer is not None:
            self.writer.close()


def _drop_lines_after(file: Path, samples: int) -> None:
    """A resumed run repeats what came after its checkpoint; so must its log.

    Raises:
        InputError: for a file that is no such log.
    """
    if not file.exists():
        return
    kept: list[str] = []
    lines, source = read_text(file, "log", MAX_GENERATED)
    for count, line in enumerate(lines.splitlines(), 1):
        where = f"{source}: line {count}"
        try:
            value = load_json(line, where, "log")
        except InputError:
            continue  # A line cut off by the kill.
        if integer(mapping(value, where).get("samples"), f"{where}: samples") <= samples:
            kept.append(line + "\n")
    write_file(file, "".join(kept), "log")


@dataclass(frozen=True)
class TrainingRun:
    """A finished training."""

    task: str
    out: Path
    """Folder of the run; ``agent.safetensors`` in it is the agent."""
    config: str
    """Name of the configuration it began with."""
    metrics: dict[str, float]
    """The last numbers of the log."""

    def load_agent(self) -> Agent:
        """The trained agent."""
        return load_agent(str(self.out))


def train(
    task: str | Task,
    out: str | Path,
    *,
    minutes: float | None = None,
    samples: int | None = None,
    config: str | TrainConfig = "relational",
    method: str | None = None,
    settings: Sequence[str] = (),
    seed: int | None = None,
    device: str = "auto",
    threads: int | None = None,
    arm: str | None = None,
    init: str | Path | Agent | None = None,
    resume: bool = False,
    quiet: bool = False,
) -> TrainingRun:
    """Train an agent.

    Args:
        task: a task or its name.
        out: new or empty folder of the run; the one to go on with where ``resume`` is given.
        minutes: stop after so long, resumed parts counted in; by default at the number of samples.
        samples: environment steps of the whole training, in place of the configuration's
            ``num_samples``.
        config: a configuration or its name: ``relational``, ``relational-objects`` (ours),
            ``published`` or ``paper``.
        method: the learner, in place of the configuration's.
        settings: changes of the configuration, such as ``"network.heads=1"``.
        seed: of everything random; 0 by default.
        device: ``auto``, ``cpu`` or ``cuda``.
        threads: of PyTorch on the CPU.
        arm: builds in place of the task's own, for tasks with a robot.
        init: agent whose weights to start from.
        resume: go on with the run in ``out``; it keeps its configuration and its seed.
        quiet: show no progress.

    Raises:
        InputError: for names that do not exist, values out of range, and folders that cannot be
            used.
    """
    check_arguments(
        {"samples": samples, "seed": seed, "minutes": minutes, "threads": threads},
        ("samples", samples is None or is_whole(samples, 1), "a whole number of at least 1"),
        ("seed", seed is None or is_whole(seed, 0), "a whole number of at least 0"),
        ("minutes", minutes is None or (is_number(minutes) and minutes > 0), "a positive number"),
        (
            "threads",
            threads is None or is_whole(threads, 1, MAX_THREADS),
            f"a whole number from 1 to {MAX_THREADS}",
        ),
    )
    check_instance("config", config, (str, TrainConfig), "a TrainConfig, or the name of one")
    check_instance("resume", resume, bool, "True or False")
    check_instance("init", init, (str, Path, Agent, type(None)), "an agent, or its name or file")
    words = "a list such as ['network.heads=1']"
    check_instance("settings", settings, (list, tuple), words)
    for setting in settings:
        check_instance("settings", setting, str, words)
    out, task = as_path(out, "out"), get_task(task, arm)
    words = config if isinstance(config, str) else "custom"
    if resume:
        if init is not None:
            raise InputError("init", init, "not together with `resume=`")
        if settings or any(value is not None for value in (samples, arm, method, seed)):
            got = "settings, samples, method, arm or seed"
            raise InputError("resume", got, "the run's own configuration")
        task, config, seed, saved_minutes = _saved(out, task)
        minutes = saved_minutes if minutes is None else minutes
    else:
        wanted = [] if method is None else [f"method={method}"]
        config = override(_fitted(config, task), [*wanted, *settings])
        if samples is not None:
            config = dataclasses.replace(config, num_samples=samples)
    if threads is not None:
        torch.set_num_threads(threads)
    metrics = run_training(
        task,
        config,
        out,
        seed=seed or 0,
        minutes=minutes,
        device=device,
        resume=resume,
        init=load_agent(init) if isinstance(init, str | Path) else init,
        quiet=quiet,
    )
    return TrainingRun(task.name, out, words, metrics)


def _fitted(config: str | TrainConfig, task: Task) -> TrainConfig:
    return fit_to(CONFIGS[config] if isinstance(config, str) else config, task)


def train_seeds(
    task: str | Task,
    out: str | Path,
    *,
    seeds: int,
    workers: int = 1,
    ray: str | None = None,
    resume: bool = False,
    progress: Callable[[str], None] = lambda text: None,
    **options: Any,
) -> list[TrainingRun]:
    """Train several agents that differ in their seed: the folders ``OUT-s0``, ``OUT-s1``, ...

    Args:
        task: a task or its name.
        out: what the folders are called.
        seeds: how many.
        workers, ray: trainings at once, see :func:`learn2assemble.workers.run_all`.
        resume: go on with those that were begun; what is missing is begun.
        progress: told of every agent that is finished.
        options: see :func:`train`, for all of them.

    Raises:
        InputError: as :func:`train` does; nothing is begun then.
    """
    if seeds < 1 or options.get("seed") is not None:
        raise InputError("seeds", seeds, "1 or more, and no seed beside it")
    out, task = Path(out), get_task(task)
    folders = [out.with_name(f"{out.name}-s{seed}") for seed in range(seeds)]
    taken = [folder for folder in folders if folder.exists() and any(folder.iterdir())]
    if taken and not resume:
        raise holds_something(taken[0], _GO_ON)
    _fitted(options.get("config", "relational"), task)
    options["quiet"] = True
    jobs = [(task, folder, {**options, "seed": seed}) for seed, folder in enumerate(folders)]
    runs: dict[Path, TrainingRun] = {}
    for (_, folder, _), run in run_all(_train_seed, jobs, workers=workers, ray=ray):
        runs[folder] = run
        progress(f"{folder}: R {run.metrics.get('R', float('nan')):.2f} in training")
    return [runs[folder] for folder in folders]


def _train_seed(job: tuple[Task, Path, dict[str, Any]]) -> TrainingRun:
    task, out, options = job
    if not (out / "state.safetensors").is_file():
        return train(task, out, **options)
    kept = {key: options[key] for key in ("minutes", "device", "quiet") if key in options}
    return train(task, out, resume=True, **kept)


def _saved(out: Path, task: Task) -> tuple[Task, TrainConfig, int, float | None]:
    """Task, configuration, seed and minutes of the run to resume."""
    check_exists(out, "folder of a training run, to go on with (`resume=`)")
    refused = InputError("resume", str(out), "the folder of a training run")
    if not (out / "config.json").is_file():
        raise refused
    try:
        saved = _read_config(out)
        config = TrainConfig.from_dict(saved["config"])
        name, seed = text(saved["task"]["name"], "task"), integer(saved["seed"], "seed")
        arm = saved["task"].get("arm", NO_ARM)
        minutes = None if saved["minutes"] is None else number(saved["minutes"], "minutes")
    except (KeyError, TypeError, AttributeError, InputError):
        raise refused from None
    if name != task.name:
        raise InputError("task", task.name, f"{name}, the task of the run to resume")
    return get_task(task, arm if task.has_arm else None), config, seed, minutes


def _read_config(out: Path) -> Mapping[str, Any]:
    """What ``config.json`` of a run says."""
    file = out / "config.json"
    try:
        return mapping(read_json(file, "configuration")[0], str(file))
    except InputError:
        raise InputError("resume", str(file), "the configuration of a run") from None


def run_training(
    task: Task,
    config: TrainConfig,
    out: Path,
    *,
    seed: int | None = None,
    minutes: float | None = None,
    device: str = "auto",
    resume: bool = False,
    init: Agent | None = None,
    quiet: bool = False,
) -> dict[str, float]:
    """Train, or continue a training, in the folder ``out``; returns the last metrics.

    Args:
        seed: of everything random, 0 by default; a resumed run has its own.
        minutes: stop after this many minutes of training in all, resumed parts counted in;
            ``None``: run to ``config.num_samples``.
        init: start from the weights of this agent instead of random ones.
        resume: continue ``out``; without it ``out`` must be empty or absent.

    Raises:
        InputError: for an output folder that is not usable, or nothing to resume.
    """
    # First what can be refused without leaving a folder behind.
    trainer = Trainer(task, config, seed or 0, choose_device(device))
    started_from = None
    if init is not None:
        trainer.start_from(init.network)
        started_from = {"name": init.name, "origin": init.origin}
    if resume and not (out / "state.safetensors").is_file():
        raise InputError("resume", str(out), "a folder with a state.safetensors")
    with claim_folder(out, resume, _GO_ON):
        if resume:
            trainer.load(out / "state.safetensors")
            if seed not in (None, trainer.seed):
                raise InputError("resume: seed", seed, f"the run's own: {trainer.seed}")
            started_from = _read_config(out).get("init")
        else:
            run = {
                "task": dataclasses.asdict(task),
                "seed": trainer.seed,
                "minutes": minutes,
                "init": started_from,
                "config": config.to_dict(),
                **provenance(trainer.device),
            }
            write_file(out / "config.json", json.dumps(run, indent=1) + "\n", "configuration")
        logs = _Logs(out, trainer.samples)
        if not resume:
            _save(trainer, out, started_from)
        try:
            _rounds(trainer, minutes, quiet, logs, lambda: _save(trainer, out, started_from))
        finally:
            if trainer.between_rounds:
                _save(trainer, out, started_from)
                logs.write(trainer.metrics())
            logs.close()
    return trainer.metrics()


def _rounds(
    trainer: Trainer, minutes: float | None, quiet: bool, logs: _Logs, save: Callable[[], None]
) -> None:
    """Rounds of training until it is finished or time is up."""
    limit = math.inf if minutes is None else minutes * 60
    started, base = time.monotonic(), trainer.seconds
    next_log, next_save = started + LOG_SECONDS, started + CHECKPOINT_SECONDS
    with tqdm(
        total=trainer.config.num_samples,
        initial=trainer.samples,
        unit=" samples",
        disable=quiet,
        desc=trainer.task.name,
        dynamic_ncols=True,
    ) as bar:
        while not trainer.finished and trainer.seconds < limit:
            before = trainer.samples
            trainer.round()
            bar.update(trainer.samples - before)
            now = time.monotonic()
            trainer.seconds = base + now - started
            if now >= next_log:
                metrics = trainer.metrics()
                logs.write(metrics)
                bar.set_postfix_str(
                    f"R {metrics.get('R', 0):.2f} success {metrics.get('success', 0):.2f} "
                    f"eps {metrics['epsilon']:.2f}"
                )
                next_log = now + LOG_SECONDS
            if now >= next_save:
                save()
                next_save = time.monotonic() + CHECKPOINT_SECONDS


def _save(trainer: Trainer, out: Path, started_from: dict[str, Any] | None) -> None:
    trainer.save(out / "state.safetensors")
    origin = {
        "config": trainer.config.to_dict(),
        "seed": trainer.seed,
        "samples": trainer.samples,
        "updates": trainer.updates,
        "seconds": round(trainer.seconds, 1),
        "init": started_from,
        **provenance(trainer.device),
    }
    save_agent(Agent("agent", trainer.online, trainer.task.name, origin), out)
