"""Trained agents: a Q-network, and what it was trained for.

An agent is one file, ``NAME.safetensors``: weights, with architecture, task, training configuration
and counters in its header (:mod:`.agent_file`). The package carries those that most tasks need by
default, in ``pretrained/``; all others are fetched (:mod:`.agent_fetch`), or lie in the folder
``agents/`` of a checkout.
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from learn2assemble.errors import InputError, extra, look_up
from learn2assemble.files import as_path, check_exists, replacing
from learn2assemble.tasks.networks.agent_fetch import ENDING, fetched_folder, listed_agents
from learn2assemble.tasks.networks.agent_file import (
    PACKED,
    content_of,
    described,
    read_description,
)
from learn2assemble.tasks.networks.config import NETWORKS, NetworkConfig
from learn2assemble.tasks.networks.placement import PlacementNetwork, PlacementValues
from learn2assemble.tasks.networks.qnetwork import QFactors, QNetwork

with extra("torch", "learn"):
    import torch
with extra("safetensors", "learn"):
    from safetensors import SafetensorError
    from safetensors.torch import load, save_file  # pyright: ignore[reportUnknownVariableType]

Network = QNetwork | PlacementNetwork
Values = QFactors | PlacementValues


def make_network(config: NetworkConfig) -> Network:
    """An untrained network of the kind that the configuration names."""
    return NETWORKS[config.encoder].make(config)


def fitted(network: Network, pitch: float, sight: int) -> Network:
    """The network for blocks at another distance [m] and another sight; weights are shared.

    What it has learned in block edges may hold on another lattice, too.
    """
    config = dataclasses.replace(network.config, pitch=pitch, sight=sight)
    if network.config == config:
        return network
    other = copy.copy(network)
    other.config = config
    return other


@contextmanager
def one_thread() -> Generator[None, None, None]:
    """Small batches lose more by sharing them among threads than they gain."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


FORMAT = "learn2assemble-agent"
PRETRAINED = Path(__file__).parents[2] / "pretrained"
REPOSITORY = Path(__file__).parents[4] / "agents"
"""Where a checkout holds the agents that are not installed with the package."""


@dataclass(frozen=True)
class Agent:
    """A Q-network with its origin."""

    name: str
    network: Network
    task: str
    """Name of the task it was trained on."""
    origin: dict[str, Any] = field(default_factory=dict[str, Any])
    """Training configuration, seed, samples, gradient steps, seconds, commit, hardware."""


def agent_files() -> dict[str, Path]:
    """Name and weights of the agents there are by name: those of the package, those of a checkout,
    and those that were fetched."""
    folders = fetched_folder(), REPOSITORY, PRETRAINED
    files = {
        f.name.removesuffix(ending).removesuffix(ENDING): f
        for folder in folders
        for ending in ("", PACKED)
        for f in folder.glob(f"*{ENDING}{ending}")
    }
    return {name: files[name] for name in sorted(files)}


def agent_info(name: str) -> Mapping[str, Any]:
    """The description of an agent by name.

    Raises:
        UnknownNameError: for a name there is no agent of.
        InputError: for a damaged file.
    """
    return read_description(_named(name))


def _named(name: str) -> Path:
    """Weights of the agent called ``name``."""
    files = agent_files()
    file = look_up("agent", name, {**dict.fromkeys(listed_agents().agents), **files})
    if file is None:
        here = ", ".join(files) or "none"
        raise InputError("agent", name, f"one that is here ({here}), or to fetch it (fetch_agents)")
    return file


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
    """Our agent for tasks like ``task``, else one trained on it.

    Raises:
        InputError: where there is neither.
    """
    wanted = next(name for start, name in DEFAULTS.items() if task.startswith(start))
    names = agent_files()
    trained = (name for name in names if agent_info(name)["task"] == task)
    return wanted if wanted in names else next(trained, None) or _named(wanted).stem


def write_tensors(
    path: Path, tensors: dict[str, torch.Tensor], what: str, metadata: dict[str, str] | None = None
) -> None:
    """Write tensors to a file all or nothing.

    Args:
        what: the thing that is written, for messages.
        metadata: words beside the tensors.

    Raises:
        InputError: where it cannot be written, saying why.
    """
    try:
        with replacing(path, what) as part:
            save_file(tensors, part, metadata)
    except SafetensorError as error:
        reason = " ".join(str(error).split())
        raise InputError(what, str(path), f"a place that can be written ({reason})") from None


def save_agent(agent: Agent, folder: Path) -> Path:
    """Write an agent into ``folder``; returns the path of its file."""
    file = folder / f"{agent.name}{ENDING}"
    info = {
        "format": FORMAT,
        "version": 1,
        "name": agent.name,
        "task": agent.task,
        "network": dataclasses.asdict(agent.network.config),
        "origin": agent.origin,
    }
    tensors = {k: v.detach().cpu().contiguous() for k, v in agent.network.state_dict().items()}
    write_tensors(file, tensors, "agent", described(info))
    return file


def load_agent(name_or_path: str | Path) -> Agent:
    """An agent by name, or one from a ``.safetensors`` file or a run folder.

    Raises:
        UnknownNameError: for a name that is neither an agent's nor a path.
        InputError: for a file that is damaged or none of an agent.
    """
    path = as_path(name_or_path, "agent")
    if path.is_dir():
        path = path / "agent.safetensors"
    if path.suffix not in (ENDING, PACKED):
        if len(path.parts) > 1:  # No agent's name: a file or folder that is misspelt.
            check_exists(path, "file or folder of an agent")
        path = _named(str(name_or_path))
    info = read_description(path)
    try:
        if info["format"] != FORMAT:
            raise ValueError(f"format {info['format']!r}")
        network = make_network(NetworkConfig(**info["network"]))
        weights = load(content_of(path))
        for key, value in weights.items():
            if not value.isfinite().all():
                raise ValueError(f"{key} holds numbers that are not finite")
        network.load_state_dict(weights)
        name, task, origin = info["name"], info["task"], info.get("origin", {})
    except (SafetensorError, OSError, ValueError, KeyError, TypeError, RuntimeError) as error:
        reason = " ".join(str(error).split())
        raise InputError("agent", str(path), f"a trained agent ({reason[:120]})") from None
    return Agent(name, network.eval(), task, origin)
