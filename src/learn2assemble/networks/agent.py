"""A Q-network from its configuration.

A trained agent: network weights and what they were trained for.

An agent is two files: ``NAME.safetensors`` (weights) and ``NAME.json`` (architecture, task,
training configuration, counters). Agents shipped with the package lie in ``pretrained/``.
"""

from __future__ import annotations

import copy
import dataclasses
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file

from learn2assemble.errors import InputError, UnknownNameError
from learn2assemble.networks.config import NetworkConfig
from learn2assemble.networks.placement import PlacementNetwork, PlacementValues
from learn2assemble.networks.qnetwork import QFactors, QNetwork

Network = QNetwork | PlacementNetwork
Values = QFactors | PlacementValues


def make_network(config: NetworkConfig) -> Network:
    """The published networks, or the placement network for the encoder ``relational``."""
    return PlacementNetwork(config) if config.encoder == "relational" else QNetwork(config)


def at_pitch(network: Network, pitch: float) -> Network:
    """The network for blocks at another distance [m]; weights are shared.

    What it has learned in block edges may hold on another lattice, too.
    """
    if network.config.pitch == pitch:
        return network
    other = copy.copy(network)
    other.config = dataclasses.replace(network.config, pitch=pitch)
    return other


FORMAT = "learn2assemble-agent"
PRETRAINED = Path(__file__).parent.parent / "pretrained"


@dataclass(frozen=True)
class Agent:
    """A Q-network with its origin."""

    name: str
    network: Network
    task: str
    """Name of the task it was trained on."""
    origin: dict[str, Any] = field(default_factory=dict)
    """Training configuration, seed, samples, gradient steps, seconds, commit, hardware."""


def pretrained_names() -> list[str]:
    """Names of the shipped agents."""
    return sorted(path.stem for path in PRETRAINED.glob("*.json"))


def agent_info(name: str) -> dict[str, Any]:
    """The JSON part of a shipped agent."""
    return json.loads((PRETRAINED / f"{name}.json").read_text(encoding="utf-8"))


DEFAULTS = {
    "robot-four": "relational-four-sided-s0",
    "robot-one": "robot-one-sided-s0",
    "robot-objects": "relational-robot-objects-s0",
    "robot": "relational-two-sided-s0",
    "objects": "relational-objects-s0",
    "bars": "relational-bars-s0",
    "other-bars": "relational-bars-s0",
    "": "relational-cubes-s0",
}
"""Our agent for tasks by how their names begin: what is built with."""


def default_agent(task: str) -> str:
    """Our shipped agent for tasks like ``task``, else one trained on it, else the first.

    Raises:
        InputError: where no agent is shipped.
    """
    names = pretrained_names()
    if not names:
        raise InputError("agent", None, "a trained agent (none is shipped)")
    for start, name in DEFAULTS.items():
        if task.startswith(start) and name in names:
            return name
    for name in names:
        if agent_info(name)["task"] == task:
            return name
    return names[0]


def save_agent(agent: Agent, folder: Path) -> Path:
    """Write both files into ``folder``; returns the path of the weights."""
    weights = folder / f"{agent.name}.safetensors"
    info = {
        "format": FORMAT,
        "version": 1,
        "name": agent.name,
        "task": agent.task,
        "network": dataclasses.asdict(agent.network.config),
        "origin": agent.origin,
    }
    tensors = {k: v.detach().cpu().contiguous() for k, v in agent.network.state_dict().items()}
    save_file(tensors, weights)
    weights.with_suffix(".json").write_text(json.dumps(info, indent=1) + "\n", encoding="utf-8")
    return weights


def load_agent(name_or_path: str, device: torch.device | str = "cpu") -> Agent:
    """A shipped agent by name, or one from a ``.safetensors`` file or a run folder.

    Raises:
        UnknownNameError: for a name that is neither shipped nor a path.
        InputError: for files that are damaged or do not belong together.
    """
    path = Path(name_or_path)
    if path.is_dir():
        path = path / "agent.safetensors"
    if path.suffix != ".safetensors":
        if name_or_path not in pretrained_names():
            raise UnknownNameError("agent", name_or_path, pretrained_names())
        path = PRETRAINED / f"{name_or_path}.safetensors"
    for file in (path, path.with_suffix(".json")):
        if not file.is_file():
            raise InputError("agent", str(file), "an existing file")
    try:
        info = json.loads(path.with_suffix(".json").read_text(encoding="utf-8"))
        if info["format"] != FORMAT:
            raise ValueError(f"format {info['format']!r}")
        network = make_network(NetworkConfig(**info["network"]))
        network.load_state_dict(load_file(path))
        name, task, origin = info["name"], info["task"], info.get("origin", {})
    except (SafetensorError, OSError, ValueError, KeyError, TypeError, RuntimeError) as error:
        reason = " ".join(str(error).split())
        raise InputError("agent", str(path), f"a trained agent ({reason[:120]})") from None
    return Agent(name, network.to(device).eval(), task, origin)
