"""Table entries: one policy on one task under one condition, measured over whole episodes.

Every entry has a result file, written whole or not at all, with everything needed to repeat it;
those that are missing or stale are measured on all cores or machines. All rows of a task play the
same problems, so that their returns can be compared problem by problem; where a row has several
agents, each plays a share of them.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, cast

import numpy as np

from l2a_lab.bounds import best_returns
from l2a_lab.builder.network import builder_files
from l2a_lab.packed import names, read_document
from l2a_lab.table import FARTHER, LOOK_AHEAD, MENDED, RANDOM
from learn2assemble.errors import InputError, extra
from learn2assemble.files import check_exists, make_folder, write_file
from learn2assemble.tasks.evaluation.episodes import (
    DISCOUNTS,
    Policy,
    episode_generators,
    load_player,
    lookahead_policy,
    make_policy,
    play_episodes,
    random_policy,
)
from learn2assemble.tasks.learning.run import provenance
from learn2assemble.tasks.networks.agent import Agent, agent_files
from learn2assemble.tasks.networks.agent_file import bare_weights, read_description
from learn2assemble.tasks.networks.config import NetworkConfig
from learn2assemble.tasks.networks.placement import PlacementNetwork
from learn2assemble.tasks.networks.qnetwork import QNetwork
from learn2assemble.tasks.physics.support import STABLE
from learn2assemble.tasks.search.config import SearchConfig
from learn2assemble.tasks.simulator import Simulator
from learn2assemble.tasks.task import Task
from learn2assemble.tasks.world.state import State
from learn2assemble.tasks.world_model import WorldModel, lookahead_actions
from learn2assemble.values import from_plain

with extra("torch", "learn"):
    import torch

BOUND = "bound"
"""The policy that does not play: upper bounds on the returns of the problems."""
DIGITS = 6
"""Decimals kept of returns and coverages."""


VIEWS = (4, 5)
"""How far an agent sees in turn where it looks farther [cells]."""


@dataclass(frozen=True)
class Cell:
    """What is measured.

    Args:
        task: the problems.
        policy: ``agent``, ``mended``, ``farther``, ``look-ahead``, ``untrained``, ``random`` or
            ``bound``.
        agent: name of the agent; empty without one.
        search: what precedes every decision.
        epsilon: chance of a random action.
        physics: placement checker of the episodes.
        seed: of problems and policy.
        share: number of the share of the problems that is played, see :data:`SHARES`; all shares
            are as large as this one.
        look_ahead: checks the placements that a search tries; empty: the task's own.
    """

    task: Task
    policy: str
    agent: str = ""
    search: SearchConfig | None = None
    epsilon: float = 0.0
    physics: str = "static"
    seed: int = 0
    share: int = 0
    look_ahead: str = ""

    @property
    def path(self) -> str:
        """Its file below the folder of results."""
        if self.policy == BOUND:
            return f"cells/{self.task.name}/{BOUND}.s{self.seed}.json"
        parts = [self.agent or self.policy, _slug(self.search), f"eps{self.epsilon:g}"]
        if self.policy in (MENDED, FARTHER):
            parts.insert(1, self.policy)
        if self.physics != "static":
            parts.append(self.physics)
        if self.look_ahead:
            parts.append(f"ahead-{self.look_ahead}")
        if self.share:
            parts.append(f"share{self.share}")
        return f"cells/{self.task.name}/{'.'.join(parts)}.json"

    def to_dict(self) -> dict[str, Any]:
        return dataclasses.asdict(self)

    @staticmethod
    def from_dict(values: dict[str, Any]) -> Cell:
        """Inverse of :meth:`to_dict`; fields that came later get their defaults.

        Raises:
            InputError, KeyError, TypeError: for what is no cell.
        """
        return from_plain(Cell, values, "cell")


def _slug(search: SearchConfig | None) -> str:
    """Budget and every setting that is not the default one, for file names."""
    if search is None:
        return "none"
    return "-".join([f"b{search.budget}", *_changes(search, SearchConfig(), "")])


def _changes(config: Any, default: Any, prefix: str) -> list[str]:
    words: list[str] = []
    for f in dataclasses.fields(config):
        value, usual = getattr(config, f.name), getattr(default, f.name)
        if f.name in ("budget", "epsilon") or value == usual:
            continue
        if dataclasses.is_dataclass(usual):
            words += _changes(value, usual, f"{f.name}.")
        else:
            words.append(f"{prefix}{f.name}={value}")
    return words


def measure(cell: Cell, agent_file: str | None, episodes: int) -> dict[str, Any]:
    """Play ``episodes`` episodes; the numbers of each, with versions and hardware.

    Args:
        agent_file: weights of the agent, for cells with one.
    """
    simulator = Simulator(cell.task, cell.physics)
    if cell.policy == BOUND:
        rng, _ = episode_generators(cell.seed)
        arrays = {"returns": _rounded(best_returns(simulator, episodes, rng))}
    else:
        played = play_episodes(
            simulator,
            make_cell_policy(cell, agent_file),
            episodes,
            cell.seed,
            first=cell.share * episodes,
        )
        other = {
            f"returns_at_{gamma:g}": _rounded(column)
            for gamma, column in zip(DISCOUNTS, played.returns_at.T, strict=True)
            if gamma != cell.task.discount
        }
        arrays = {
            "returns": _rounded(played.returns),
            **other,
            "actions": played.actions.tolist(),
            "failed": played.failed.astype(int).tolist(),
            "success": played.success.astype(int).tolist(),
            "coverage": _rounded(played.coverage),
        }
    return {**provenance("cpu"), "episodes": episodes, **arrays}


def make_cell_policy(cell: Cell, agent_file: str | None) -> Policy:
    """What chooses the actions of a cell."""
    if cell.policy == LOOK_AHEAD:
        return lookahead_policy(cell.task, cell.epsilon)
    if cell.policy == RANDOM:
        return random_policy(cell.task.num_actions)
    if cell.agent:
        assert agent_file is not None
        player = load_player(agent_file)
        network = player.network.eval() if isinstance(player, Agent) else player
    else:
        # Its values are never asked for: without a prior and with rollouts to the end.
        task = cell.task
        config = NetworkConfig(
            width=8, heads=1, rounds=1, num_actions=task.num_actions, action_mode=task.action_mode
        )
        torch.manual_seed(0)  # pyright: ignore[reportUnknownMemberType]
        network = QNetwork(config).eval()
    search = cell.search
    if cell.policy == FARTHER and search is not None:
        # One simulation is left for what the wider view finds.
        search = replace(search, budget=search.budget - 1)
    ahead = cell.look_ahead or None
    policy = make_policy(cell.task, network, search, cell.epsilon, look_ahead=ahead)
    if cell.policy == MENDED:
        simulator = Simulator(cell.task)
        return mended_policy(
            cell.task, policy, lambda state, _: lookahead_actions(simulator, state)
        )
    if cell.policy == FARTHER:
        assert isinstance(network, PlacementNetwork)
        return mended_policy(cell.task, policy, farther_view(cell.task, network))
    return policy


Mend = Callable[[State, np.ndarray], np.ndarray]
"""Other actions int64[B, 3] for states, from these and the ones chosen before."""


def mended_policy(task: Task, policy: Policy, mend: Mend) -> Policy:
    """``policy``, but where its action would bring no reward, the one that ``mend`` chooses.

    On targets larger than those of training an agent comes to places where only supports several
    blocks deep bring anything again; it does not see so far, and takes what is not even valid.
    """
    simulator = Simulator(task)

    def act(state: State, rng: np.random.Generator) -> np.ndarray:
        actions = policy(state, rng)
        idle = np.flatnonzero(simulator.step(state.copy(), actions).reward <= 0)
        if len(idle):
            actions[idle] = mend(state.take(idle), actions[idle])
        return actions

    return act


def farther_view(task: Task, network: PlacementNetwork) -> Mend:
    """What the network itself would do if it saw farther, where that is valid; see :data:`VIEWS`.

    What one view leaves open another often finishes; none of them is better from the beginning.
    """
    simulator = Simulator(task)
    models = [WorldModel(simulator, network, sight=cells) for cells in VIEWS]

    def mend(state: State, actions: np.ndarray) -> np.ndarray:
        found, turn = actions.copy(), state.num_placed % len(models)
        for number, model in enumerate(models):
            rows = np.flatnonzero(turn == number)
            if len(rows):
                found[rows] = model.best(state.take(rows))[1]
        valid = simulator.step(state.copy(), found).verdict == STABLE
        return np.where(valid[:, None], found, actions)

    return mend


def _rounded(values: Any) -> list[float]:
    return [round(float(value), DIGITS) for value in values]


FORMAT, VERSION = "learn2assemble-cell", 1


@dataclass(frozen=True)
class CellResult:
    """What a result file says."""

    cell: Cell
    agent_hash: str | None
    data: dict[str, Any]

    @property
    def episodes(self) -> int:
        return int(self.data["episodes"])

    @property
    def first(self) -> int:
        """Number of the first problem played."""
        return self.cell.share * self.episodes

    def array(self, name: str) -> np.ndarray:
        """One number an episode: float64[E]."""
        return np.asarray(self.data[name], float)

    def head(self, episodes: int) -> CellResult:
        """The first ``episodes`` of them."""
        cut: dict[str, Any] = {
            k: v[:episodes] if isinstance(v, list) else v for k, v in self.data.items()
        }
        return CellResult(self.cell, self.agent_hash, {**cut, "episodes": episodes})


def write_result(root: Path, cell: Cell, agent_hash: str | None, data: dict[str, Any]) -> Path:
    """Write the file of ``cell`` below ``root``; a kill leaves the old one or the new one. It stays
    until it is packed.

    Raises:
        InputError: where it cannot be written.
    """
    file = root / cell.path
    head = {
        "format": FORMAT,
        "version": VERSION,
        "cell": cell.to_dict(),
        "agent_hash": agent_hash,
    }
    lines = [f" {json.dumps(key)}: {json.dumps(value)}" for key, value in {**head, **data}.items()]
    make_folder(file.parent, "--out")
    write_file(file, "{\n" + ",\n".join(lines) + "\n}\n", "--out")
    return file


def read_result(file: Path) -> CellResult | None:
    """A result by the path of its file, also where that was packed (:mod:`.packed`); ``None`` where
    it is absent, damaged or of another version."""
    try:
        return _result(read_document(file))
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None


# Every row of a table looks at the same results again; all that are committed are fewer.
@lru_cache(maxsize=2048)
def _result(text: str) -> CellResult | None:
    """What the text of a file says, which nobody may change; ``None`` for another version.

    Raises:
        ValueError, KeyError, TypeError, AttributeError: where it is damaged.
    """
    data = json.loads(text)
    if (data.pop("format"), data.pop("version")) != (FORMAT, VERSION):
        return None
    result = CellResult(Cell.from_dict(data.pop("cell")), data.pop("agent_hash"), data)
    counts = {len(cast("list[Any]", v)) for v in data.values() if isinstance(v, list)}
    return result if counts == {result.episodes} else None


def is_current(root: Path, cell: Cell, agent_hash: str | None, episodes: int) -> bool:
    """Whether ``cell`` has been measured as it is now, with at least ``episodes`` episodes."""
    result = read_result(root / cell.path)
    return (
        result is not None
        and (result.cell, result.agent_hash) == (cell, agent_hash)
        and (result.episodes == episodes if cell.share else result.episodes >= episodes)
    )


def measured_agents(root: Path, task: str) -> set[str]:
    """Names of the agents with results on ``task``."""
    found, cells = set[str](), root / "cells"
    for name in names(cells, task):
        result = read_result(cells / name)
        if result is not None and result.cell.agent:
            found.add(result.cell.agent)
    return found


def find_agents(folder: Path | None) -> dict[str, Path]:
    """Name and weights of the agents in ``folder``; without it of all there are by name.

    An agent is ``NAME.safetensors`` or a run folder ``NAME``.

    Raises:
        InputError: where the folder does not exist.
    """
    if folder is None:
        return {**agent_files(), **builder_files()}
    check_exists(folder, "folder of agents")
    if not folder.is_dir():
        raise InputError("--agents", str(folder), "a folder")
    runs = {f.parent.name: f for f in folder.glob("*/agent.safetensors")}
    files = {f.stem: f for f in folder.glob("*.safetensors")}
    return dict(sorted({**runs, **files}.items()))


def agent_hash(file: Path) -> str:
    """16 hexadecimal digits that change with the weights or the architecture of an agent, and with
    nothing else of its description.

    Raises:
        InputError: for what is no agent.
    """
    info = read_description(file)
    if "format" not in info:
        raise InputError("agent", str(file), "a trained agent")
    digest = hashlib.sha256(bare_weights(file))
    digest.update(json.dumps(info.get("network", info["format"]), sort_keys=True).encode())
    return digest.hexdigest()[:16]
