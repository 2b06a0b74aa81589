"""A training run in a folder: progress, logs, checkpoints, resume.

``config.json`` (task, configuration, seed, versions), ``log.jsonl`` (one line per interval),
``tensorboard/`` where TensorBoard is installed, ``state.safetensors`` (everything needed to go
on), ``agent.safetensors`` and ``agent.json`` (the network so far).
"""

from __future__ import annotations

import dataclasses
import importlib.metadata
import importlib.util
import json
import os
import platform
import subprocess
import time
from pathlib import Path
from typing import Any

import torch
from tqdm import tqdm

from learn2assemble.errors import InputError
from learn2assemble.learning.config import TrainConfig
from learn2assemble.learning.trainer import Trainer
from learn2assemble.networks.agent import Agent, save_agent
from learn2assemble.tasks import Task

LOG_SECONDS = 10.0
CHECKPOINT_SECONDS = 45.0
"""A kill loses at most this much work."""


def choose_device(name: str) -> str:
    """``auto`` becomes ``cuda`` where a GPU is usable.

    Raises:
        InputError: for an unknown device or CUDA without a GPU.
    """
    if name not in ("auto", "cpu", "cuda"):
        raise InputError("--device", name, "auto, cpu or cuda")
    available = torch.cuda.is_available()
    if name == "cuda" and not available:
        raise InputError("--device", name, "cpu (no CUDA device is usable here)")
    return "cuda" if name != "cpu" and available else "cpu"


def _commit() -> str:
    """Commit of the checkout that holds this package; its version where none tracks it."""
    here = Path(__file__)
    # Variables of git that a hook sets would point to another repository.
    env = {name: value for name, value in os.environ.items() if not name.startswith("GIT_")}
    found = ""
    try:
        for words in (["ls-files", "--error-unmatch", here.name], ["rev-parse", "--short", "HEAD"]):
            done = subprocess.run(
                ["git", *words], cwd=here.parent, env=env, capture_output=True, text=True,
                check=True, timeout=5,
            )  # fmt: skip
            found = done.stdout.strip()
    except (OSError, subprocess.SubprocessError):
        found = ""
    if found:
        return found
    try:
        return f"version {importlib.metadata.version('learn2assemble')}"
    except importlib.metadata.PackageNotFoundError:
        return "unknown"


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
        self.writer = None
        if importlib.util.find_spec("tensorboard") is not None:
            from torch.utils.tensorboard import SummaryWriter

            self.writer = SummaryWriter(str(out / "tensorboard"), purge_step=samples)

    def write(self, metrics: dict[str, float]) -> None:
        """One line, unless nothing was sampled since the last one."""
        if metrics["samples"] == self.last:
            return
        self.last = int(metrics["samples"])
        with self.file.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps(metrics) + "\n")
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
    kept = []
    for number, line in enumerate(file.read_bytes().splitlines(), 1):
        try:
            values = json.loads(line)
        except (ValueError, RecursionError):
            continue  # A line cut off by the kill.
        if not isinstance(values, dict) or type(values.get("samples")) is not int:
            got = line.decode(errors="replace")
            raise InputError(f"{file} line {number}", got, "a JSON object with samples")
        if values["samples"] <= samples:
            kept.append(line + b"\n")
    part = file.with_suffix(".part")
    part.write_bytes(b"".join(kept))
    part.replace(file)


def train(
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
    device = choose_device(device)
    state_file = out / "state.safetensors"
    # First what can be refused without leaving a folder behind.
    trainer = Trainer(task, config, seed or 0, device)
    started_from = None
    if init is not None:
        trainer.start_from(init.network)
        started_from = {"name": init.name, "origin": init.origin}
    _prepare_folder(out, state_file, resume)
    if resume:
        trainer.load(state_file)
        if seed not in (None, trainer.seed):
            raise InputError("--resume --seed", seed, f"the run's own: {trainer.seed}")
        started_from = _started_from(out / "config.json")
    else:
        run = {
            "task": dataclasses.asdict(task), "seed": trainer.seed, "minutes": minutes,
            "init": started_from,
            "config": config.to_dict(), **provenance(device),
        }  # fmt: skip
        (out / "config.json").write_text(json.dumps(run, indent=1) + "\n", encoding="utf-8")
    logs = _Logs(out, trainer.samples)
    limit = float("inf") if minutes is None else minutes * 60
    bar = tqdm(
        total=config.num_samples, initial=trainer.samples, unit=" samples", disable=quiet,
        desc=task.name, dynamic_ncols=True,
    )  # fmt: skip
    if not resume:
        _save(trainer, out, state_file, started_from)
    started, base = time.monotonic(), trainer.seconds
    next_log, next_save = started + LOG_SECONDS, started + CHECKPOINT_SECONDS
    try:
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
                _save(trainer, out, state_file, started_from)
                next_save = time.monotonic() + CHECKPOINT_SECONDS
    finally:
        if trainer.between_rounds:
            _save(trainer, out, state_file, started_from)
            logs.write(trainer.metrics())
        logs.close()
        bar.close()
    return trainer.metrics()


def _started_from(file: Path) -> dict[str, Any] | None:
    """The agent whose weights the run in ``config.json`` began with."""
    try:
        return json.loads(file.read_text(encoding="utf-8")).get("init")
    except (OSError, ValueError, AttributeError, RecursionError):
        raise InputError("--resume", str(file), "the configuration of a run") from None


def _save(
    trainer: Trainer, out: Path, state_file: Path, started_from: dict[str, Any] | None
) -> None:
    trainer.save(state_file)
    origin = {
        "config": trainer.config.to_dict(),
        "seed": trainer.seed,
        "samples": trainer.samples,
        "updates": trainer.updates,
        "seconds": round(trainer.seconds, 1),
        "init": started_from,
        **provenance(trainer.device),
    }
    save_agent(Agent("agent", trainer.agent_network, trainer.task.name, origin), out)


def _prepare_folder(out: Path, state_file: Path, resume: bool) -> None:
    if resume:
        if not state_file.is_file():
            raise InputError("--resume", str(out), "a folder with a state.safetensors")
        return
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError("--out", str(out), "an empty or new folder (or --resume)")
    try:
        out.mkdir(parents=True, exist_ok=True)
        probe = out / ".write-test"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise InputError("--out", str(out), f"a writable folder ({error.strerror})") from None
