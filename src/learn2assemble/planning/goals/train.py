"""Training the guide of the search on goals of the training families: expert iteration.

The search solves drawn goals, at first without a network, later with the one learned so far. In
every state on the way to a solution, in random orders, the blocks that are left of it are right;
what it still took beyond the relaxed plan is an auxiliary task. Nothing comes from the exact
program.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from learn2assemble.planning.agent.world import World
from learn2assemble.planning.goals.network import (
    NUM_SUMMARY,
    Guide,
    describe,
    forward,
    initial_weights,
)
from learn2assemble.planning.goals.search import Search, search
from learn2assemble.planning.goals.tasks import FIRST_TRAINING_SEED, TRAINED, draw_goals
from learn2assemble.planning.goals.world import Problem, legal, make_problem, put, relax
from learn2assemble.planning.scorer import check_file_name


@dataclass(frozen=True)
class GuideConfig:
    """What a training does.

    Args:
        name: of the guide.
        seed: of goals, weights and choices.
        seconds: limit of the whole training, in processor time.
        rounds: of solving goals, each with the network of the one before, and learning.
        limit: of one search, in processor time.
        replays: random orders in which a solution is built.
        steps: of gradient, in every round.
        batch: states of a step.
        rate: first learning rate; it falls to a tenth.
        most: candidates kept of a state.
    """

    name: str = "goals-s0"
    seed: int = 0
    seconds: float = 120.0
    rounds: int = 1
    limit: float = 0.3
    replays: int = 3
    steps: int = 1200
    batch: int = 48
    rate: float = 2e-3
    most: int = 96


@dataclass(frozen=True, eq=False)
class _Sample:
    rows: np.ndarray
    summary: np.ndarray
    right: np.ndarray
    more: float
    """Blocks it took beyond the relaxed plan."""


def train(
    config: GuideConfig, report: Callable[[dict[str, float]], None] = lambda told: None
) -> Guide:
    """Train a guide.

    Args:
        report: told after every round what was solved and learned.
    """
    import torch

    check_file_name(config.name)
    torch.set_num_threads(1)
    started, rng = time.process_time(), np.random.default_rng(config.seed)
    samples: list[_Sample] = []
    guide: Guide | None = None
    weights = initial_weights(config.seed)
    drawn = solved = 0
    figures: dict[str, float] = {}
    for number in range(config.rounds):
        # A fifth of the time is kept for learning.
        until = config.seconds * 0.8 * (number + 1) / config.rounds
        while time.process_time() - started < until:
            family, seed = str(rng.choice(TRAINED)), int(rng.integers(FIRST_TRAINING_SEED, 2**31))
            goals = draw_goals(family, seed, bool(rng.random() < 0.4))
            if goals is None:
                continue
            problem = make_problem(goals)
            found = search(problem, guide, seconds=config.limit, seed=seed, timer=time.process_time)
            drawn += 1
            if found.placements:
                solved += 1
                chosen = [problem.site.candidate(block) for block in found.placements]
                for _ in range(config.replays):
                    samples += _replay(problem, chosen, rng, config)
        torch.manual_seed(config.seed)
        weights, figures = _learn(weights, samples, config, rng)
        guide = Guide(config.name, weights)
        report({"round": number + 1, "goals": drawn, "solved": solved, "states": len(samples),
                "seconds": round(time.process_time() - started, 1), **figures})  # fmt: skip
    origin = {
        "config": dataclasses.asdict(config), "families": list(TRAINED), "goals": drawn,
        "solved": solved, "states": len(samples), "demonstrations": False,
        "processor_seconds": round(time.process_time() - started, 1), **figures,
    }  # fmt: skip
    return Guide(config.name, weights, origin)


def _replay(
    problem: Problem, chosen: list[int], rng: np.random.Generator, config: GuideConfig
) -> list[_Sample]:
    """States on the way to a solution, in a random order."""
    look, world, left = Search(problem, None), World(problem.site), set(chosen)
    found: list[_Sample] = []
    relaxed = relax(problem, world)
    while left:
        children = legal(problem, world)
        helps, _ = look.advice(world, relaxed, children)
        rows, summary = describe(problem, world, relaxed, children, helps)
        right = np.isin(children, list(left))
        if not right.any():
            break
        kept = np.argsort(rng.random(len(children)) - right - relaxed.used[children] - helps)
        kept = kept[: config.most]
        found.append(
            _Sample(rows[kept].astype(np.float16), summary, right[kept],
                    max(len(left) - relaxed.blocks, -3.0))
        )  # fmt: skip
        ways = (put(world, int(k)) for k in rng.permutation(children[right]))
        grown = next((w for w in ways if w is not None), None)
        if grown is None:
            break
        left.discard(grown.placed[-1])
        world, relaxed = grown, relax(problem, grown, relaxed.price)
    return found


def _learn(
    weights: dict[str, np.ndarray], samples: list[_Sample], config: GuideConfig,
    rng: np.random.Generator,
) -> tuple[dict[str, np.ndarray], dict[str, float]]:  # fmt: skip
    """Better weights, and how they do on the last steps."""
    import torch

    tensors = {k: torch.tensor(v, requires_grad=True) for k, v in weights.items()}
    optimiser = torch.optim.Adam(list(tensors.values()), config.rate)
    figures = np.zeros(3)
    told = max(config.steps // 5, 1)
    for step in range(config.steps):
        for group in optimiser.param_groups:
            group["lr"] = config.rate * 0.1 ** (step / config.steps)
        picked = [samples[k] for k in rng.integers(len(samples), size=config.batch)]
        most = max(len(sample.right) for sample in picked)
        rows = np.zeros((len(picked), most, picked[0].rows.shape[1]), np.float32)
        right = np.zeros((len(picked), most), bool)
        padding = np.full((len(picked), most), -1e9, np.float32)
        summary = np.zeros((len(picked), 1, NUM_SUMMARY), np.float32)
        for k, sample in enumerate(picked):
            count = len(sample.right)
            rows[k, :count], right[k, :count], padding[k, :count] = sample.rows, sample.right, 0
            summary[k, 0] = sample.summary
        logits, more = forward(tensors, *map(torch.from_numpy, (rows, summary, padding)))
        good = logits.masked_fill(~torch.from_numpy(right), -1e9)
        policy = (logits.logsumexp(1) - good.logsumexp(1)).mean()
        target = torch.tensor([sample.more for sample in picked], dtype=torch.float32)
        value = torch.nn.functional.smooth_l1_loss(more, target)
        loss = policy + 0.3 * value
        optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(list(tensors.values()), 1.0)
        optimiser.step()
        if step >= config.steps - told:
            hit = torch.gather(torch.from_numpy(right), 1, logits.argmax(1, keepdim=True))
            figures += float(policy.detach()), float(hit.float().mean()), float(value.detach())
    policy, hit, value = (figures / told).round(4).tolist()
    return (
        {k: v.detach().numpy().copy() for k, v in tensors.items()},
        {"policy_loss": policy, "right": hit, "value_loss": value},
    )  # fmt: skip
