"""One training: losses, collecting with the learner's policy, updates, state saved and restored.

Losses are the temporal difference, cross-entropy to search values (Q-MCTS, epsilon-MCTS), and
labels of a one-step model (deviation D6).
"""

from __future__ import annotations

import json
import math
from collections import deque
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from learn2assemble.errors import InputError, extra
from learn2assemble.tasks.graph.batch import tensor_of, to_tensors
from learn2assemble.tasks.graph.features import Graph, node_offset
from learn2assemble.tasks.graph.placements import distinct_placements
from learn2assemble.tasks.learning.config import METHODS, Learner, TrainConfig
from learn2assemble.tasks.learning.replay import Batch, Replay, Searched, random_symmetry
from learn2assemble.tasks.networks.agent import (
    Network,
    Values,
    fitted,
    make_network,
    write_tensors,
)
from learn2assemble.tasks.networks.placement import PlacementValues
from learn2assemble.tasks.networks.qnetwork import NEGATIVE
from learn2assemble.tasks.search.config import SearchConfig
from learn2assemble.tasks.search.mcts import search
from learn2assemble.tasks.simulator import Simulator
from learn2assemble.tasks.task import Task, check_actions
from learn2assemble.tasks.world.outcomes import Outcomes
from learn2assemble.tasks.world.state import State
from learn2assemble.tasks.world_model import WorldModel

with extra("torch", "learn"):
    import torch
    from torch.nn import functional as F
with extra("safetensors", "learn"):
    from safetensors import SafetensorError, safe_open


def search_cross_entropy(values: Values, searched: Searched, taken: torch.Tensor) -> torch.Tensor:
    """``-(1/B) sum_s sum_e softmax_e(Q_S(s, a_e)) log softmax_e(Q(s, a_e))``, a scalar.

    The softmax runs over the explored actions e of each state at temperature 1; the stored search
    values Q_S are constants. States without a search add 0 and still count in the divisor B.

    Args:
        taken: int64[B, 3]: the actions taken; they stand in where fewer were explored.
    """
    device = taken.device
    actions = tensor_of(searched.action).to(device)
    count = tensor_of(searched.count).to(device)
    explored = torch.arange(actions.shape[1], device=device) < count[:, None]
    actions = torch.where(explored[..., None], actions, taken[:, None])
    q = torch.stack([values.select(action) for action in actions.unbind(1)], 1)
    stored = tensor_of(searched.value).to(device)
    # A finite stand-in for minus infinity keeps rows without any search free of NaN.
    log_policy = q.masked_fill(~explored, NEGATIVE).log_softmax(1)
    goal = stored.masked_fill(~explored, NEGATIVE).softmax(1)
    terms = torch.where(explored, goal * log_policy, 0.0)
    return -terms.sum() / len(terms)


def q_loss(
    online: Network, target: Network, batch: Batch, config: TrainConfig, device: str
) -> tuple[torch.Tensor, dict[str, float]]:
    """Loss of one batch and numbers to log.

    The TD part is the paper's smooth L1; where the batch carries searches, it is weighed against
    the cross-entropy to their values (:mod:`~learn2assemble.tasks.learning.trainer`).
    ``dense_weight`` adds :func:`dense_error`.
    """
    values = online(to_tensors(batch.graph, device))
    action = tensor_of(batch.action).to(device)
    y = td_targets(online, target, batch, config, device)
    value = values.select(action)
    loss = td = F.smooth_l1_loss(value, y)
    logs = {"td": float(td.detach()), "q": float(value.detach().mean())}
    if batch.searched is not None:
        ce = search_cross_entropy(values, batch.searched, action)
        logs["search"] = float(ce.detach())
        loss = (1 - config.search_weight) * td + config.search_weight * ce
    if config.dense_weight:
        assert batch.outcomes is not None
        assert isinstance(values, PlacementValues)
        dense, parts = dense_error(values, batch.outcomes)
        logs |= parts
        loss = loss + config.dense_weight * dense
    return loss, {"loss": float(loss.detach()), **logs}


def td_targets(
    online: Network, target: Network, batch: Batch, config: TrainConfig, device: str
) -> torch.Tensor:
    """``y = r + gamma (1 - terminal) max Q_T(s', .)`` over legal actions: float[B]."""
    reward = tensor_of(batch.reward).to(device)
    alive = tensor_of(~batch.terminal).to(device)
    discount = tensor_of(batch.discount).to(device)
    # Only states that go on are valued.
    rows = np.flatnonzero(~batch.terminal)
    following = reward.new_zeros(len(reward))
    if len(rows):
        graph = to_tensors(batch.next_graph.take(rows), device)
        with torch.no_grad():
            if config.double:
                _, action = online(graph).best(graph)
                following[alive] = target(graph).select(action)
            else:
                following[alive] = target(graph).best(graph)[0]
    return reward + discount * following


def dense_error(
    values: PlacementValues, outcomes: Outcomes
) -> tuple[torch.Tensor, dict[str, float]]:
    """Smooth L1 of what a one-step model tells about *every* placement of the states.

    Three means: the reward part of Q against the reward; Q against the reward where the placement
    is invalid; the same where it ends the episode otherwise (there the reward is the exact Q).
    """
    rows, width = values.q.shape
    reward, terminal, valid = (
        tensor_of(field[:, :width]).to(values.q.device) for field in outcomes[:3]
    )
    used = values.cells.legal & (terminal | valid)

    def mean(q: torch.Tensor, where: torch.Tensor, least: int = 1) -> torch.Tensor:
        error = F.smooth_l1_loss(q, reward, reduction="none")
        return (error * where).sum() / where.sum().clamp(min=least)

    parts = {
        "reward": mean(values.reward, used),
        "invalid": mean(values.q, used & terminal & ~valid),
        # Placements that finish the structure are few: one counts like one action of the batch.
        "final": mean(values.q, used & terminal & valid, rows),
    }
    error = parts["reward"] + parts["invalid"] + parts["final"]
    return error, {k: float(v.detach()) for k, v in parts.items()}


def epsilon_greedy(
    model: WorldModel, state: State, epsilon: float, rng: np.random.Generator
) -> np.ndarray:
    """Actions int64[B, 3], uniform with probability ``epsilon``."""
    action = model.random_actions(state, rng)
    rows = np.flatnonzero(rng.random(len(action)) >= epsilon)
    if len(rows):
        _, action[rows] = model.best(state.take(rows))
    return action


def searching(
    model: WorldModel, state: State, config: SearchConfig, rng: np.random.Generator
) -> tuple[np.ndarray, Searched]:
    """One search for every row: actions int64[B, 3], and what the searches found at their roots."""
    decisions = search(model, state, config, rng)
    count = len(decisions)
    found = Searched(
        np.zeros((count, config.budget, 3), np.int64),
        np.zeros((count, config.budget), np.float32),
        np.zeros(count, np.int64),
    )
    offset = node_offset(model.simulator.observe(state))
    for row, decision in enumerate(decisions):
        explored = decision.explored()
        found.count[row] = len(explored)
        for n, (local, value, _) in enumerate(explored):
            found.action[row, n], found.value[row, n] = local + offset[row], value
    return np.stack([decision.action for decision in decisions]), found


TRAINING_STREAM = 1
"""First word of every training seed; evaluation uses another, so no problem is seen twice."""
EPISODES_AVERAGED = 300
_COUNTERS = ("seed", "samples", "updates", "episodes")
_LOGGED = ("samples", "updates", "episodes", "seconds", "epsilon", "learning_rate")


class Trainer:
    """Collects with the learner's policy in vectorised worlds and learns from replay.

    Args:
        task: what to learn.
        config: how.
        seed: of everything random.
        device: ``cpu`` or ``cuda``.
    """

    samples: int
    updates: int
    episodes: int

    def __init__(self, task: Task, config: TrainConfig, seed: int, device: str = "cpu") -> None:
        check_actions(config.network.num_actions, config.network.action_mode, task)
        self.task = task
        self.config = config
        self.seed = seed
        self.device = device
        self.learner: Learner = METHODS[config.method]
        self.simulator: Simulator = Simulator(task, config.physics or None)
        self.rng: np.random.Generator = np.random.default_rng([TRAINING_STREAM, seed])
        torch.manual_seed(seed)  # pyright: ignore[reportUnknownMemberType]
        self.online: Network = make_network(config.network).to(device)
        self.model: WorldModel = WorldModel(self.simulator, self.online, device)
        """What the searches of training look ahead with."""
        self.target: Network = make_network(config.network).to(device)
        self.target.load_state_dict(self.online.state_dict())
        self.optimizer: torch.optim.Adam = torch.optim.Adam(
            self.online.parameters(), lr=config.learning_rate, fused=True
        )
        self.replay: Replay = Replay(
            config.replay_size,
            task.num_nodes,
            outcomes=config.dense_weight > 0,
            explored=config.search_budget if self.learner.search else 0,
        )
        self.state: State = self.simulator.new(config.num_envs, self.rng)
        self.graph: Graph = self.simulator.observe(self.state)
        self.samples = self.updates = self.episodes = 0
        self.seconds: float = 0.0
        self.running_return: NDArray[np.float64] = np.zeros(config.num_envs)
        self.running_discount: NDArray[np.float64] = np.ones(config.num_envs)
        self.recent: deque[tuple[float, bool, bool]] = deque(maxlen=EPISODES_AVERAGED)
        """Discounted return, success and failure of the latest training episodes."""
        self.logs: dict[str, float] = {}
        self.between_rounds: bool = True
        """Whether the state is one to save; an interrupted round leaves half a step behind."""

    def start_from(self, network: Network) -> None:
        """Take over the weights of a trained network.

        Raises:
            InputError: where its architecture is another one.
        """
        config = self.config.network
        if fitted(network, config.pitch, config.sight).config != config:
            raise InputError("init", network.config, f"an agent with {self.config.network}")
        for mine in (self.online, self.target):
            mine.load_state_dict(network.state_dict())

    @property
    def epsilon(self) -> float:
        """Exploration rate now: linear in the samples."""
        c = self.config
        return max(c.epsilon_final, 1 - (1 - c.epsilon_final) * self.samples / c.epsilon_samples)

    @property
    def learning_rate(self) -> float:
        """Cosine from ``learning_rate`` to ``final_learning_rate`` over ``num_samples``."""
        c, share = self.config, min(self.samples / self.config.num_samples, 1.0)
        swing = 0.5 * (1 + math.cos(math.pi * share))
        return c.final_learning_rate + (c.learning_rate - c.final_learning_rate) * swing

    @property
    def finished(self) -> bool:
        return self.samples >= self.config.num_samples

    def round(self) -> None:
        """One phase of collection and one of learning."""
        self.between_rounds = False
        for _ in range(self.config.steps_per_round):
            self.collect()
        if self.samples >= self.config.initial_samples:
            for group in self.optimizer.param_groups:
                group["lr"] = self.learning_rate
            for _ in range(self.config.updates_per_round):
                self.update()
        self.between_rounds = True

    def collect(self) -> None:
        """One step of every world by the learner's policy, into the replay memory."""
        state, graph, offset = self.state, self.graph, node_offset(self.graph)
        searched = outcomes = None
        if self.config.dense_weight:
            placements = distinct_placements(graph, self.task.action_spec)
            outcomes = self.simulator.outcomes(state, graph, placements)
        if self.learner.search is not None:
            how = self.learner.search(self.config.search_budget, self.epsilon)
            action, searched = searching(self.model, state, how, self.rng)
        else:
            action = epsilon_greedy(self.model, state, self.epsilon, self.rng)
        step = self.simulator.step(state, action)
        after = self.simulator.observe(state)
        discount = np.full(len(action), self.task.discount, np.float32)
        self.replay.add(
            Batch(
                graph,
                action + offset,
                step.reward.astype(np.float32),
                step.terminated,
                after,
                discount,
                outcomes,
                searched,
            )
        )
        self.samples += len(action)
        self.running_return += self.running_discount * step.reward
        self.running_discount *= self.task.discount
        ended = np.flatnonzero(step.terminated)
        for row in ended:
            failed = bool(step.verdict[row] != 0)
            self.recent.append((float(self.running_return[row]), bool(step.success[row]), failed))
        self.episodes += len(ended)
        self.running_return[ended], self.running_discount[ended] = 0.0, 1.0
        if len(ended):
            self.simulator.reset(state, ended, self.rng)
            after = self.simulator.observe(state)
        self.graph = after

    def update(self) -> None:
        """One gradient step."""
        config = self.config
        batch = self.replay.sample(config.batch_size, self.rng)
        if config.augment:
            batch = random_symmetry(batch, self.task.num_sides, self.rng)
        loss_of = self.learner.loss or q_loss
        loss, self.logs = loss_of(self.online, self.target, batch, config, self.device)
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()  # pyright: ignore[reportUnknownMemberType]
        self.optimizer.step()  # pyright: ignore[reportUnknownMemberType]
        self.updates += 1
        if self.updates % config.target_period == 0:
            self.target.load_state_dict(self.online.state_dict())

    def metrics(self) -> dict[str, float]:
        """Numbers to log; returns are discounted and include exploration.

        Those of episodes are left out until one has ended.
        """
        out = {name: getattr(self, name) for name in _LOGGED}
        if self.recent:
            means = np.asarray(self.recent, float).reshape(-1, 3).mean(0)
            out |= dict(zip(("R", "success", "f"), means.tolist(), strict=True))
        return out | {f"batch_{k}": v for k, v in self.logs.items()}

    def save(self, path: Path) -> None:
        """Write the whole training state to one file, atomically."""
        tensors = self._tensors()
        for number, slots in self.optimizer.state_dict()["state"].items():
            tensors |= {f"adam.{number}.{k}": v.cpu() for k, v in slots.items()}
        counters = {
            **{name: getattr(self, name) for name in (*_COUNTERS, "seconds")},
            "task": self.task.name,
            "config": self.config.to_dict(),
            "cursor": self.replay.cursor,
            "rng": self.rng.bit_generator.state,
        }
        write_tensors(path, tensors, "state", {"counters": json.dumps(counters)})

    def _worlds(self) -> dict[str, np.ndarray]:
        """State and running sums of the worlds, by their names in a state file."""
        fields = {f"state.{name}": field for name, field in self.state._asdict().items()}
        names = ("running_return", "running_discount")
        return {**fields, **{name: getattr(self, name) for name in names}}

    def _tensors(self) -> dict[str, torch.Tensor]:
        """Everything but the counters and the optimiser's moments, by its name in a state file."""
        arrays = {**self._worlds(), **self.replay.state()}
        arrays["recent"] = np.asarray(self.recent, float).reshape(-1, 3)
        tensors = {k: tensor_of(np.ascontiguousarray(v)) for k, v in arrays.items()}
        for prefix, network in (("online", self.online), ("target", self.target)):
            tensors |= {f"{prefix}.{k}": v.cpu() for k, v in network.state_dict().items()}
        return tensors

    def load(self, path: Path) -> None:
        """Continue exactly where :meth:`save` was called.

        Raises:
            InputError: where the file belongs to another task or configuration.
        """
        try:
            with cast("Any", safe_open)(path, "pt") as file:
                counters: dict[str, Any] = json.loads(file.metadata()["counters"])
                names: list[str] = file.keys()
                tensors: dict[str, torch.Tensor] = {key: file.get_tensor(key) for key in names}
            self._restore(counters, tensors)
        except (
            SafetensorError,
            OSError,
            LookupError,
            ValueError,
            TypeError,
            RuntimeError,
            AttributeError,
        ) as error:
            if isinstance(error, InputError):
                raise
            reason = " ".join(str(error).split())[:120]
            raise InputError("resume", str(path), f"an undamaged state ({reason})") from None

    def _check_tensors(self, tensors: dict[str, torch.Tensor]) -> None:
        """ValueError for a tensor of another shape or kind, or with numbers that are not finite."""
        parameters = [p for group in self.optimizer.param_groups for p in group["params"]]
        expected = self._tensors()
        for key in tensors:
            if key.startswith("adam."):
                _, number, slot = key.split(".")
                parameter = parameters[int(number)].detach()
                expected[key] = torch.zeros(()) if slot == "step" else parameter
        length = len(tensors["replay.reward"])
        if length > self.replay.size:
            raise ValueError(f"{length} transitions in a memory of {self.replay.size}")
        for key, mine in expected.items():
            given, shape = tensors[key], list(mine.shape)
            if key.startswith("replay."):
                shape[0] = length
                if key.startswith("replay.outcome."):  # these grow by doubling
                    shape[1] = max(shape[1], given.shape[-1])
            elif key == "recent":
                shape[0] = min(len(given), EPISODES_AVERAGED)
            if list(given.shape) != shape or given.dtype != mine.dtype:
                raise ValueError(f"{key} is {given.dtype}{list(given.shape)}, not {shape}")
            if given.is_floating_point() and not given.isfinite().all():
                raise ValueError(f"{key} holds numbers that are not finite")
        placed, blocks = tensors["state.num_placed"], tensors["state.num_blocks"]
        most = self.state.position.shape[1]
        if not ((placed >= 0) & (placed <= blocks) & (blocks <= most)).all():
            raise ValueError("state.num_placed and state.num_blocks are no counts of blocks")

    def _restore(self, counters: dict[str, Any], tensors: dict[str, torch.Tensor]) -> None:
        for key, value in {"task": self.task.name, "config": self.config.to_dict()}.items():
            if counters[key] != value:
                raise InputError(f"resume: {key}", value, f"the run's own: {counters[key]}")
        for name in (*_COUNTERS, "cursor"):
            if type(counters[name]) is not int or counters[name] < 0:
                raise ValueError(f"{name} is {counters[name]!r}")
        if counters["cursor"] >= self.config.replay_size:
            raise ValueError(f"cursor is {counters['cursor']} of {self.config.replay_size}")
        if not 0 <= counters["seconds"] < math.inf:
            raise ValueError(f"seconds is {counters['seconds']!r}")
        self._check_tensors(tensors)
        arrays = {k: v.numpy() for k, v in tensors.items() if not k.startswith("adam.")}
        for name, field in self._worlds().items():
            field[:] = arrays[name]
        self.graph = self.simulator.observe(self.state)
        self.replay.load(arrays, counters["cursor"])
        self.recent.extend((r, bool(s), bool(f)) for r, s, f in arrays["recent"].tolist())
        for prefix, network in (("online", self.online), ("target", self.target)):
            network.load_state_dict({k: tensors[f"{prefix}.{k}"] for k in network.state_dict()})
        optimizer = self.optimizer.state_dict()
        for key, value in tensors.items():
            if key.startswith("adam."):
                _, number, slot = key.split(".")
                optimizer["state"].setdefault(int(number), {})[slot] = value
        self.optimizer.load_state_dict(optimizer)
        for name in (*_COUNTERS, "seconds"):
            setattr(self, name, counters[name])
        self.rng.bit_generator.state = counters["rng"]
