"""Checkpoints, resume, interrupts and damaged files."""

from __future__ import annotations

import dataclasses
import functools
import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import save_file

import learn2assemble.tasks.learning.run as run_module
from learn2assemble.errors import InputError
from learn2assemble.tasks.graph.features import Graph
from learn2assemble.tasks.learning.run import run_training
from learn2assemble.tasks.learning.trainer import Trainer
from learn2assemble.tasks.networks.agent_file import bare_weights
from learn2assemble.tasks.simulator import Simulator
from learn2assemble.tasks.world.state import State
from learning_data import OWN, QUICK, TINY, assert_same_training, contents

RESUMED: dict[str, dict[str, Any]] = {
    "published": {},
    "own": OWN,
    "own, plain": {**OWN, "double": False},
    "q-mcts": {"method": "q-mcts"},
    "eps-mcts": {"method": "eps-mcts", "search_budget": 3},
    "own, q-mcts": {**OWN, "method": "q-mcts"},
}


@pytest.mark.parametrize("name", RESUMED)
def test_resumed_training_is_bitwise_the_same(name: str, tmp_path: Path) -> None:
    config = dataclasses.replace(QUICK, **RESUMED[name])
    straight = Trainer(TINY, config, 3)
    while not straight.finished:
        straight.round()
    straight.save(tmp_path / "straight.safetensors")

    part = Trainer(TINY, config, 3)
    for rounds in (4, 27):
        for _ in range(rounds):
            part.round()
        part.save(tmp_path / "part.safetensors")
        # Another seed: everything random must come from the file.
        part = Trainer(TINY, config, 99)
        part.load(tmp_path / "part.safetensors")
    while not part.finished:
        part.round()
    part.save(tmp_path / "part.safetensors")
    assert straight.updates > 70
    assert_same_training(tmp_path / "straight.safetensors", tmp_path / "part.safetensors")
    assert straight.metrics().keys() == part.metrics().keys()


def samples_in_log(out: Path) -> list[int]:
    lines = (out / "log.jsonl").read_text(encoding="utf-8").splitlines()
    return [json.loads(line)["samples"] for line in lines]


def interrupt_after(monkeypatch: pytest.MonkeyPatch, rounds: int) -> None:
    """Ctrl-C between two rounds."""
    whole: Callable[[Trainer], None] = Trainer.round
    count = iter(range(10**6))

    def round_or_stop(self: Trainer) -> None:
        if next(count) == rounds:
            raise KeyboardInterrupt
        whole(self)

    monkeypatch.setattr(Trainer, "round", round_or_stop)


@pytest.mark.parametrize("changes", [{}, OWN], ids=["published", "own"])
def test_interrupted_run_goes_on_as_if_nothing_happened(
    changes: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """``train`` stopped by Ctrl-C and resumed equals ``train`` in one go, files included."""
    monkeypatch.setattr(run_module, "LOG_SECONDS", 0.02)
    config = dataclasses.replace(QUICK, **changes)
    run_training(TINY, config, tmp_path / "a", seed=5, device="cpu", quiet=True)
    with monkeypatch.context() as patch:
        interrupt_after(patch, 30)
        with pytest.raises(KeyboardInterrupt):
            run_training(TINY, config, tmp_path / "b", seed=5, device="cpu", quiet=True)
    stopped, _ = contents(tmp_path / "b" / "state.safetensors")
    assert stopped["samples"] == 150
    with (tmp_path / "b" / "log.jsonl").open("a", encoding="utf-8") as stream:
        stream.write('{"samples": 152}\n{"samp')  # Written after the checkpoint, then cut off.
    metrics = run_training(
        TINY, config, tmp_path / "b", seed=5, device="cpu", quiet=True, resume=True
    )
    assert metrics["samples"] == QUICK.num_samples
    assert_same_training(tmp_path / "a" / "state.safetensors", tmp_path / "b" / "state.safetensors")
    weights = [bare_weights(tmp_path / name / "agent.safetensors") for name in "ab"]
    assert weights[0] == weights[1]
    log = samples_in_log(tmp_path / "b")
    assert 150 in log
    assert 152 not in log
    assert log == sorted(log)
    assert log[-1] == QUICK.num_samples
    assert sorted(p.name for p in (tmp_path / "b").iterdir() if p.is_file()) == [
        "agent.safetensors",
        "config.json",
        "log.jsonl",
        "state.safetensors",
    ]


def test_log_lines_after_the_checkpoint_are_dropped(tmp_path: Path) -> None:
    file = tmp_path / "log.jsonl"
    file.write_text('{"samples": 10}\n{"samples": 20}\n{"samples": 30}\n{"samp', encoding="utf-8")
    run_module._drop_lines_after(file, 20)
    assert samples_in_log(tmp_path) == [10, 20]


def test_log_never_repeats_a_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """``samples`` strictly increases, also when a finished run is resumed."""
    monkeypatch.setattr(run_module, "LOG_SECONDS", 0.0)
    run_training(TINY, QUICK, tmp_path / "a", device="cpu", quiet=True)
    run_training(TINY, QUICK, tmp_path / "a", device="cpu", quiet=True, resume=True)
    log = samples_in_log(tmp_path / "a")
    assert log == sorted(set(log))


def test_interrupt_inside_a_step_leaves_no_dead_world(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever moment the interrupt comes at, the saved run can be continued properly."""
    whole = Simulator.observe

    def observe(self: Simulator, state: State) -> Graph:
        if state.terminated.any():
            raise KeyboardInterrupt
        return whole(self, state)

    with monkeypatch.context() as patch:
        patch.setattr(Simulator, "observe", observe)
        with pytest.raises(KeyboardInterrupt):
            run_training(TINY, QUICK, tmp_path / "a", device="cpu", quiet=True)
    trainer = Trainer(TINY, QUICK, 0)
    trainer.load(tmp_path / "a" / "state.safetensors")
    for _ in range(20):
        trainer.collect()
    assert not trainer.state.terminated.any()


KILLED = """
import sys
from pathlib import Path
import torch
torch.set_num_threads(1)
import learn2assemble.tasks.learning.run as run
from learn2assemble.tasks.learning.config import TrainConfig
from learn2assemble.tasks.task import Task
run.CHECKPOINT_SECONDS = 0.2
run.LOG_SECONDS = 0.05
import json
task = Task(**json.loads(sys.argv[2]))
config = TrainConfig.from_dict(json.loads(sys.argv[3]))
run.run_training(task, config, Path(sys.argv[1]), device="cpu", quiet=True)
"""


def test_killed_run_resumes_from_its_last_checkpoint(tmp_path: Path) -> None:
    """SIGKILL in the middle of training; then on to the end."""
    out = tmp_path / "run"
    config = dataclasses.replace(QUICK, num_samples=10**6)
    arguments = [json.dumps(dataclasses.asdict(TINY)), json.dumps(config.to_dict())]
    process = subprocess.Popen(
        [sys.executable, "-c", KILLED, str(out), *arguments],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
    )
    try:
        deadline, checkpoints = time.monotonic() + 60, set[int]()
        while len(checkpoints) < 3:
            assert process.poll() is None, process.communicate()[1].decode()[-500:]
            assert time.monotonic() < deadline, "no checkpoint within a minute"
            if (out / "state.safetensors").exists():
                checkpoints.add((out / "state.safetensors").stat().st_mtime_ns)
            time.sleep(0.02)
        time.sleep(0.15)
    finally:
        process.send_signal(signal.SIGKILL)
        process.communicate()
    assert process.returncode == -signal.SIGKILL
    saved, _ = contents(out / "state.safetensors")
    assert saved["samples"] > 0
    trainer = Trainer(TINY, config, 0)
    trainer.load(out / "state.safetensors")
    assert trainer.samples == saved["samples"]

    # A goal close to the checkpoint; only the length of the training differs.
    goal = saved["samples"] + 100
    with safe_open(out / "state.safetensors", "pt") as stream:
        counters = json.loads(stream.metadata()["counters"])
        tensors = {key: stream.get_tensor(key) for key in stream.keys()}  # noqa: SIM118
    counters["config"]["num_samples"] = goal
    save_file(tensors, out / "state.safetensors", metadata={"counters": json.dumps(counters)})
    metrics = run_training(
        TINY,
        dataclasses.replace(config, num_samples=goal),
        out,
        device="cpu",
        quiet=True,
        resume=True,
    )
    assert metrics["samples"] >= goal
    assert metrics["updates"] > saved["updates"]
    assert metrics["episodes"] >= saved["episodes"]
    log = samples_in_log(out)
    assert log == sorted(set(log))
    assert log[-1] >= goal


def test_resume_of_another_task_or_configuration_is_refused(tmp_path: Path) -> None:
    trainer = Trainer(TINY, QUICK, 0)
    trainer.save(tmp_path / "state.safetensors")
    other_config = dataclasses.replace(QUICK, learning_rate=2e-3)
    for task, config, words in (
        (TINY, other_config, "config"),
        (TINY.replace(name="another"), QUICK, "task"),
    ):
        with pytest.raises(InputError, match=f"resume: {words}"):
            Trainer(task, config, 0).load(tmp_path / "state.safetensors")


def test_a_run_of_other_settings_is_refused(tmp_path: Path) -> None:
    """Every setting counts: one that the run does not name, too."""
    file, trainer = tmp_path / "state.safetensors", Trainer(TINY, QUICK, 0)
    trainer.round()
    trainer.save(file)
    with safe_open(file, "pt") as stream:
        counters = json.loads(stream.metadata()["counters"])
        tensors = {key: stream.get_tensor(key) for key in stream.keys()}  # noqa: SIM118
    again = Trainer(TINY, QUICK, 0)
    again.load(file)
    assert again.samples == trainer.samples > 0
    del counters["config"]["network"]["pitch"]
    save_file(tensors, file, metadata={"counters": json.dumps(counters)})
    with pytest.raises(InputError, match="resume: config"):
        again.load(file)


def test_resume_of_nothing_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="a folder with a state"):
        run_training(TINY, QUICK, tmp_path, device="cpu", quiet=True, resume=True)


def test_output_folder_must_be_new(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("keep")
    with pytest.raises(InputError, match="out"):
        run_training(TINY, QUICK, tmp_path, device="cpu", quiet=True)
    with pytest.raises(InputError, match="out"):
        run_training(TINY, QUICK, tmp_path / "mine.txt" / "below", device="cpu", quiet=True)
    assert [p.name for p in tmp_path.iterdir()] == ["mine.txt"]


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """State of a training that has begun to learn."""
    file = tmp_path_factory.mktemp("saved") / "state.safetensors"
    trainer = Trainer(TINY, dataclasses.replace(QUICK, **OWN), 0)
    while not trainer.updates:
        trainer.round()
    trainer.save(file)
    return file


def read_state(file: Path) -> tuple[dict[str, Any], dict[str, torch.Tensor]]:
    with safe_open(file, "pt") as stream:
        counters = json.loads(stream.metadata()["counters"])
        return counters, {key: stream.get_tensor(key) for key in stream.keys()}  # noqa: SIM118


@functools.cache
def another_trainer() -> Trainer:
    """Refuses states, which leave it unchanged."""
    return Trainer(TINY, dataclasses.replace(QUICK, **OWN), 0)


def refused(file: Path) -> str:
    """What the refusal of a state file says."""
    with pytest.raises(InputError) as caught:
        another_trainer().load(file)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("content", [b"", b"junk" * 100, None], ids=["empty", "junk", "cut"])
def test_damaged_state_is_refused_in_one_line(
    saved: Path, tmp_path: Path, content: bytes | None
) -> None:
    file = tmp_path / "state.safetensors"
    whole = saved.read_bytes()
    file.write_bytes(whole[: len(whole) // 2] if content is None else content)
    refused(file)


def test_every_tensor_of_a_state_is_checked(saved: Path, tmp_path: Path) -> None:
    """Absent, of another shape or kind, or with numbers that are not finite."""
    file = tmp_path / "state.safetensors"
    counters, tensors = read_state(saved)
    metadata = {"counters": json.dumps(counters)}
    assert any(key.startswith("adam.") for key in tensors)
    for number, (key, value) in enumerate(tensors.items()):
        bad = [torch.zeros(3, 5, 7), value.to(torch.complex64)]
        if value.ndim:
            bad += [value[..., :0], torch.cat([value, value], -1)]
        if value.is_floating_point():
            bad.append(torch.full_like(value, float("nan")))
        changed = bad[number % len(bad)]
        if key.startswith("replay.outcome.") and changed.shape[-1:] == (128,):
            changed = bad[0]  # memories of outcomes grow like this
        save_file({**tensors, key: changed.contiguous()}, file, metadata=metadata)
        assert key in refused(file) or "replay" in key
    for key in ("running_return", "recent", "online.readout.0.bias", "replay.action"):
        save_file({k: v for k, v in tensors.items() if k != key}, file, metadata=metadata)
        refused(file)
    extra = {**tensors, "adam.99.exp_avg": torch.zeros(3)}
    save_file(extra, file, metadata=metadata)
    refused(file)
    placed = tensors["state.num_placed"]
    for count in (-placed - 1, placed + 10**6):
        save_file({**tensors, "state.num_placed": count}, file, metadata=metadata)
        assert "num_placed" in refused(file)


def test_every_counter_of_a_state_is_checked(saved: Path, tmp_path: Path) -> None:
    file = tmp_path / "state.safetensors"
    counters, tensors = read_state(saved)
    for key in ("seed", "samples", "updates", "episodes", "cursor", "seconds"):
        for value in (-1, 10**9 if key == "cursor" else "many", None, [1]):
            changed = {**counters, key: value}
            save_file(tensors, file, metadata={"counters": json.dumps(changed)})
            assert key in refused(file) or value in (None, [1], "many")
    for changed in ([], 3, {**counters, "rng": {}}, {**counters, "config": 3}, {}):
        save_file(tensors, file, metadata={"counters": json.dumps(changed)})
        refused(file)
    save_file(tensors, file)
    refused(file)


@pytest.mark.parametrize("line", [b"[1]", b"3", b"{}", b'{"samples": "many"}', b'"\xc3\xa9"'])
def test_a_log_of_something_else_is_refused(tmp_path: Path, line: bytes) -> None:
    run_training(TINY, QUICK, tmp_path / "a", device="cpu", quiet=True)
    log = tmp_path / "a" / "log.jsonl"
    content = log.read_bytes() + line + b"\n"
    log.write_bytes(content)
    with pytest.raises(InputError, match=r"log.jsonl: line") as caught:
        run_training(TINY, QUICK, tmp_path / "a", device="cpu", quiet=True, resume=True)
    assert "\n" not in str(caught.value)
    assert log.read_bytes() == content


def test_a_resumed_run_has_its_own_seed(tmp_path: Path) -> None:
    run_training(TINY, QUICK, tmp_path / "a", seed=4, device="cpu", quiet=True)
    with pytest.raises(InputError, match="resume: seed"):
        run_training(TINY, QUICK, tmp_path / "a", seed=5, device="cpu", quiet=True, resume=True)
    for seed in (None, 4):
        run_training(TINY, QUICK, tmp_path / "a", seed=seed, device="cpu", quiet=True, resume=True)


def test_a_run_records_the_commit_of_its_own_checkout(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Installed below another repository, the package records its version and its code."""
    git = ["git", "-c", "user.name=a", "-c", "user.email=a@b.c"]
    subprocess.run([*git, "init", "-q"], cwd=tmp_path, check=True)
    subprocess.run([*git, "commit", "-q", "--allow-empty", "-m", "x"], cwd=tmp_path, check=True)
    here = tmp_path / "src" / "a" / "b" / "run.py"
    here.parent.mkdir(parents=True)
    here.touch()
    monkeypatch.setattr(run_module, "__file__", str(here))
    known = run_module.provenance("cpu")["commit"]
    assert known.startswith(f"version {version('learn2assemble')}, code ")
    here.write_text("x = 1\n", encoding="utf-8")
    assert run_module.provenance("cpu")["commit"] != known
    subprocess.run([*git, "add", "src"], cwd=tmp_path, check=True)
    assert run_module.provenance("cpu")["commit"].endswith(" and changes")
    subprocess.run([*git, "commit", "-q", "-m", "y"], cwd=tmp_path, check=True)
    head = subprocess.run(
        [*git, "rev-parse", "HEAD"], cwd=tmp_path, check=True, capture_output=True, text=True
    )
    commit = run_module.provenance("cpu")["commit"]
    assert len(commit) >= 7
    assert head.stdout.startswith(commit)
