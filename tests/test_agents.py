"""Agents: saved and loaded unchanged, damaged files refused, what is shipped is complete."""

from __future__ import annotations

import json
import lzma
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save, save_file

from learn2assemble.errors import InputError, UnknownNameError
from learn2assemble.tasks.evaluation.episodes import make_policy, run_episodes
from learn2assemble.tasks.graph.batch import to_tensors
from learn2assemble.tasks.learning.config import TrainConfig
from learn2assemble.tasks.networks import agent as agent_module
from learn2assemble.tasks.networks.agent import (
    Agent,
    agent_files,
    agent_info,
    default_agent,
    load_agent,
    make_network,
    save_agent,
)
from learn2assemble.tasks.networks.agent_file import (
    KEY,
    bare_weights,
    described,
    read_description,
)
from learn2assemble.tasks.networks.config import NetworkConfig
from learn2assemble.tasks.networks.placement import PlacementNetwork, PlacementValues
from learn2assemble.tasks.simulator import Simulator
from learn2assemble.tasks.task import PRESETS, get_task

torch.set_num_threads(1)

TASK = "one-sided-3x3-22-24"


def random_agent(**changes: Any) -> Agent:
    torch.manual_seed(0)
    config = NetworkConfig(**{"width": 16, "heads": 2, "rounds": 1, **changes})
    return Agent("agent", make_network(config).eval(), TASK, {"seed": 7, "samples": 0})


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"rotary": True, "connectivity": "full"},
        {"encoder": "s2v"},
        {"feed_forward": "wide", "connectivity": "full", "position_scale": 0.1},
        {"feed_forward": "none", "num_actions": 20},
    ],
    ids=str,
)
def test_saved_and_loaded_agent_is_the_same(changes: dict[str, Any], tmp_path: Path) -> None:
    """Same Q-values, architecture and origin; by the file and by its folder."""
    agent = random_agent(**changes)
    file = save_agent(agent, tmp_path)
    simulator = Simulator(get_task(TASK))
    graph = to_tensors(simulator.observe(simulator.new(8, np.random.default_rng(0))))
    for where in (str(file), str(tmp_path)):
        loaded = load_agent(where)
        assert (loaded.name, loaded.task, loaded.origin) == ("agent", TASK, agent.origin)
        assert loaded.network.config == agent.network.config
        assert not loaded.network.training
        with torch.inference_mode():
            for mine, theirs in zip(agent.network(graph), loaded.network(graph), strict=True):
                assert torch.equal(mine, theirs)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["agent.safetensors"]


@pytest.mark.parametrize("num_actions", [5, 20])
def test_saved_and_loaded_placement_network_is_the_same(num_actions: int, tmp_path: Path) -> None:
    agent = random_agent(encoder="relational", num_actions=num_actions)
    loaded = load_agent(str(save_agent(agent, tmp_path)))
    assert isinstance(loaded.network, PlacementNetwork)
    assert loaded.network.config == agent.network.config
    simulator = Simulator(get_task(TASK))
    graph = to_tensors(simulator.observe(simulator.new(8, np.random.default_rng(0))))
    with torch.inference_mode():
        mine, theirs = agent.network(graph), loaded.network(graph)
    assert isinstance(mine, PlacementValues)
    assert isinstance(theirs, PlacementValues)
    assert torch.equal(mine.q, theirs.q)
    assert torch.equal(mine.reward, theirs.reward)


def test_loading_twice_shares_nothing(tmp_path: Path) -> None:
    file = save_agent(random_agent(), tmp_path)
    first, second = load_agent(str(file)), load_agent(str(file))
    with torch.no_grad():
        first.network.readout.weight.zero_()
    assert second.network.readout.weight.abs().max() > 0


FILE = "agent.safetensors"


def with_words(words: dict[str, str] | None) -> Callable[[Path], None]:
    """The same weights with other metadata."""

    def change(folder: Path) -> None:
        save_file(load_file(folder / FILE), folder / FILE, words)

    return change


def change_info(**changes: Any) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        info = read_description(folder / FILE)
        with_words(described({**info, **changes}))(folder)

    return change


def change_network(**changes: Any) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        network = read_description(folder / FILE)["network"]
        change_info(network=network | changes)(folder)

    return change


def with_header(header: bytes) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        (folder / FILE).write_bytes(len(header).to_bytes(8, "little") + header)

    return change


def write(name: str, content: bytes) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        (folder / name).write_bytes(content)

    return change


def cut(folder: Path) -> None:
    (folder / FILE).write_bytes((folder / FILE).read_bytes()[:-100])


def cut_in_the_header(folder: Path) -> None:
    (folder / FILE).write_bytes((folder / FILE).read_bytes()[:100])


def with_tensors(change_tensors: Callable[[dict[str, torch.Tensor]], object]) -> Any:
    """Other weights with the same description."""

    def change(folder: Path) -> None:
        tensors, info = load_file(folder / FILE), read_description(folder / FILE)
        change_tensors(tensors)
        save_file(tensors, folder / FILE, described(info))

    return change


def without_a_tensor(tensors: dict[str, torch.Tensor]) -> None:
    tensors.pop("readout.bias")


def with_a_weight(number: float) -> Callable[[dict[str, torch.Tensor]], None]:
    def change(tensors: dict[str, torch.Tensor]) -> None:
        tensors["readout.bias"][0] = number

    return change


def remove(name: str) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        (folder / name).unlink()

    return change


DAMAGES: dict[str, Callable[[Path], None]] = {
    "no file": remove(FILE),
    "an empty file": write(FILE, b""),
    "text": write(FILE, b"weights" * 50),
    "weights cut off": cut,
    "cut off in the header": cut_in_the_header,
    "header of gigabytes": write(FILE, b"\xff" * 64),
    "header is no JSON": with_header(b"{"),
    "header is a list": with_header(b"[]"),
    "header is binary": with_header(b"\xff\xfe\x00"),
    "header of words only": with_header(b'{"__metadata__": 3}'),
    "a tensor is missing": with_tensors(without_a_tensor),
    "a weight is not a number": with_tensors(with_a_weight(float("nan"))),
    "a weight is infinite": with_tensors(with_a_weight(float("inf"))),
    "no description": with_words(None),
    "another description": with_words({"format": "pt"}),
    "description is not JSON": with_words({KEY: "{"}),
    "description is a list": with_words({KEY: "[]"}),
    "description is nested too deep": with_words({KEY: "[" * 100_000}),
    "description of nothing": with_words({KEY: "{}"}),
    "another format": change_info(format="learn2assemble-plan"),
    "network is a word": change_info(network="large"),
    "network has another width": change_network(width=32),
    "network has more rounds": change_network(rounds=3),
    "network has an unknown field": change_network(depth=3),
    "network has an unknown choice": change_network(feed_forward="wyde"),
    "network width is a word": change_network(width="wide"),
    "network is too wide": change_network(width=10**9),
}


@pytest.mark.parametrize("name", DAMAGES)
def test_damaged_agents_are_refused_in_one_line(name: str, tmp_path: Path) -> None:
    save_agent(random_agent(), tmp_path)
    DAMAGES[name](tmp_path)
    with pytest.raises(InputError) as caught:
        load_agent(str(tmp_path))
    message = str(caught.value)
    assert "\n" not in message
    assert len(message) < 500
    assert "agent" in message


def test_an_agent_in_two_files_is_refused_and_told_why(tmp_path: Path) -> None:
    save_agent(random_agent(), tmp_path)
    info = read_description(tmp_path / FILE)
    with_words(None)(tmp_path)
    (tmp_path / "agent.json").write_text(json.dumps(info), encoding="utf-8")
    with pytest.raises(InputError, match="no description in its header; agents of two files"):
        load_agent(tmp_path)


def test_bare_weights_are_the_file_without_its_description(tmp_path: Path) -> None:
    """They are what the library writes of the weights alone, whatever the description says."""
    file = save_agent(random_agent(), tmp_path)
    bare = bare_weights(file)
    assert bare == save(load_file(file))
    change_info(origin={"a": "ä" * 7})(tmp_path)
    assert bare_weights(file) == bare
    with_words(None)(tmp_path)
    assert file.read_bytes() == bare_weights(file) == bare


def test_agent_without_heads_is_refused(tmp_path: Path) -> None:
    save_agent(random_agent(), tmp_path)
    change_network(heads=0)(tmp_path)
    with pytest.raises(InputError):
        load_agent(str(tmp_path))


def test_agent_with_other_actions_is_refused() -> None:
    """Relations beyond the task's five would be read beyond the end of a compiled array, so the
    refusal must come before the first step."""
    with pytest.raises(InputError):
        make_policy(get_task(TASK), random_agent(num_actions=20).network, None, 0.0)


def test_unknown_agents(tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match="agent"):
        load_agent("no-such-agent")
    with pytest.raises(InputError, match="no such file"):
        load_agent(str(tmp_path / "missing.safetensors"))
    with pytest.raises(InputError, match="no such file"):
        load_agent(str(tmp_path))


def test_default_agent_prefers_the_task(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(agent_module, "PRETRAINED", tmp_path)
    monkeypatch.setattr(agent_module, "REPOSITORY", tmp_path / "none")
    with pytest.raises(UnknownNameError, match="relational-cubes-s0"):
        default_agent(TASK)
    for name, task in (("a", "two-sided-3x3-20-24"), ("b", TASK)):
        save_agent(Agent(name, random_agent().network, task), tmp_path)
    assert list(agent_files()) == ["a", "b"]
    assert default_agent(TASK) == "b"
    assert load_agent("b").task == TASK
    with pytest.raises(UnknownNameError, match="relational-cubes-s0"):
        default_agent("four-sided-3x3-10-18")
    with pytest.raises(InputError, match=r"one that is here \(a, b\), or to fetch it"):
        load_agent("dqn-s0")
    with pytest.raises(UnknownNameError, match="did you mean"):
        load_agent("bb")


@pytest.mark.parametrize(
    "task",
    [
        "robot-four-sided-3x3-10-18",
        "robot-two-sided-3x3-10-14",
        "robot-objects-two-sided-5x5-20-24",
        "objects-two-sided-5x5-20-24",
    ],
)
def test_shipped_defaults_were_trained_on_such_tasks(task: str) -> None:
    assert agent_info(default_agent(task))["task"] == task


# What is shipped.


def test_an_agent_is_shipped() -> None:
    assert agent_files(), "no agent in src/learn2assemble/pretrained: l2a build cannot work"


def test_the_package_carries_only_defaults() -> None:
    files = agent_module.PRETRAINED.glob("*.safetensors.xz")
    carried = {path.name.removesuffix(".safetensors.xz") for path in files}
    assert carried
    assert carried < set(agent_module.DEFAULTS.values()) <= set(agent_files())
    assert not carried & {path.stem for path in agent_module.REPOSITORY.iterdir()}


def test_a_packed_agent_is_the_same_one(tmp_path: Path) -> None:
    """And one that was cut off is refused in one line."""
    packed = next(agent_module.PRETRAINED.glob("*.safetensors.xz"))
    plain, damaged = tmp_path / FILE, tmp_path / f"{FILE}.xz"
    plain.write_bytes(lzma.decompress(packed.read_bytes()))
    assert bare_weights(plain) == bare_weights(packed)
    one, other = load_agent(plain).network.state_dict(), load_agent(packed).network.state_dict()
    assert all((one[key] == other[key]).all() for key in one)
    for content in (packed.read_bytes()[:-1000], b"no xz", b""):
        damaged.write_bytes(content)
        with pytest.raises(InputError, match=r"agent: got .*xz', expected a trained agent"):
            load_agent(damaged)


@pytest.mark.parametrize("name", agent_files())
def test_shipped_agent_is_complete(name: str) -> None:
    """It loads, knows its task and how it came about, and runs on that task."""
    agent, info = load_agent(name), agent_info(name)
    assert agent.name == name
    assert agent.task in PRESETS
    origin = info["origin"]
    assert {"config", "seed", "samples", "commit"} <= set(origin)
    assert origin["samples"] > 0
    assert isinstance(origin["commit"], str)
    assert TrainConfig.from_dict(origin["config"]).network == agent.network.config
    assert all(p.isfinite().all() for p in agent.network.parameters())
    task = get_task(agent.task)
    metrics = run_episodes(task, make_policy(task, agent.network, None, 0.0), 10, 0)
    untrained = make_network(agent.network.config)
    chance = run_episodes(task, make_policy(task, untrained, None, 1.0), 10, 0)
    assert metrics.R > chance.R + 1
