"""Which action a walk takes, and which one is played in the end.

Includes Gumbel root selection with sequential halving and completed Q-values (Danihelka et al.
2022). A Q-network takes the place of policy and value: the logits are Q / temperature, and the
completed Q-value of an action that was not simulated is its Q.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from learn2assemble.search.config import SearchConfig
from learn2assemble.search.tree import Node


def gumbel_waves(root: Node, config: SearchConfig, rng: np.random.Generator) -> Iterator[list[int]]:
    """Waves of root actions: all that are still considered, in every phase half as many."""
    logits = _logits(root, config)
    if config.gumbel.noise:
        root.noise = rng.gumbel(size=len(logits))
        logits = logits + root.noise
    count = max(1, min(config.gumbel.considered, len(logits), config.budget))
    phases = max(1, math.ceil(math.log2(count)))
    alive = np.argsort(-logits, kind="stable")[:count].tolist()
    left = config.budget
    while left > 0:
        for _ in range(max(1, config.budget // (phases * len(alive)))):
            wave = alive[:left]
            if not wave:
                return
            left -= len(wave)
            yield wave
        score = gumbel_scores(root, config)
        alive.sort(key=(-score).__getitem__)
        alive = alive[: max(2, len(alive) // 2)]


def gumbel_scores(root: Node, config: SearchConfig) -> np.ndarray:
    """``g + logits + sigma(completed Q)`` of every root action: float64[A]."""
    noise = 0.0 if root.noise is None else root.noise
    return noise + _logits(root, config) + _sigma(root, config)


def completed_policy(node: Node, config: SearchConfig) -> np.ndarray:
    """The improved policy ``softmax(logits + sigma(completed Q))``: float64[A]."""
    logits = _logits(node, config) + _sigma(node, config)
    weights = np.exp(logits - logits.max())
    return weights / weights.sum()


def gumbel_interior(node: Node, config: SearchConfig) -> int:
    """Below the root: where the visits lag most behind the improved policy; no chance."""
    share = node.simulated / (1 + node.simulated.sum())
    return int(np.argmax(completed_policy(node, config) - share))


def _logits(node: Node, config: SearchConfig) -> np.ndarray:
    return node.actions.values / config.gumbel.temperature


def _sigma(node: Node, config: SearchConfig) -> np.ndarray:
    """The monotone transform of completed Q-values, which search results sharpen."""
    low, high = node.estimates.min(), node.estimates.max()
    scaled = (node.estimates - low) / max(high - low, 1e-8)
    return (config.gumbel.visit_offset + node.simulated.max()) * config.gumbel.value_scale * scaled


def root_waves(root: Node, config: SearchConfig, rng: np.random.Generator) -> Iterator[list[int]]:
    """Root actions to simulate next, again and again until the budget is spent.

    The actions of one wave can be simulated together: none depends on the outcome of another.
    """
    if config.expansion == "gumbel":
        yield from gumbel_waves(root, config, rng)
        return
    left = config.budget
    while left > 0:
        if len(root.children) < len(root.actions.values) and _blind(config):
            wave = _untried(root, left, config, rng)
        else:
            key = choose(root, config, rng)
            if key is None:
                return
            wave = [key]
        left -= len(wave)
        yield wave


def _blind(config: SearchConfig) -> bool:
    """Whether every untried action comes before any look at simulated results."""
    first = not config.repeats or (config.expansion == "uct" and not config.prior)
    return first and config.widening == 1


def choose(node: Node, config: SearchConfig, rng: np.random.Generator) -> int | None:
    """The action a walk takes at ``node``; ``None`` where nothing is left to try."""
    if config.expansion == "gumbel":
        return gumbel_interior(node, config)
    room = not node.fully_expanded and len(node.children) < math.ceil(
        (node.below + 1) ** config.widening - 1e-9
    )
    if config.repeats:
        return _anything(node, room, config, rng)
    if room:
        return _untried(node, 1, config, rng)[0]
    keys = [key for key, child in node.children.items() if not child.done]
    if not keys:
        return None if node.fully_expanded else _untried(node, 1, config, rng)[0]
    if config.expansion == "uct":
        return keys[largest(uct_scores(node, keys, config), rng)]
    if rng.random() < config.epsilon:
        return keys[int(rng.integers(len(keys)))]
    return keys[largest([node.children[key].value for key in keys], rng)]


def _anything(node: Node, room: bool, config: SearchConfig, rng: np.random.Generator) -> int:
    """The choice among explored and, where there is room, untried actions."""
    keys = list(range(len(node.actions.values))) if room else list(node.children)
    if config.expansion == "uct":
        return keys[largest(uct_scores(node, keys, config), rng)]
    if rng.random() < config.epsilon:
        return keys[int(rng.integers(len(keys)))]
    return keys[largest(node.estimates[keys], rng)]


def uct_scores(node: Node, keys: list[int], config: SearchConfig) -> np.ndarray:
    """``mean + c sqrt(ln n(node) / n(child))`` of some actions.

    An untried action has visit count 1 and mean Q with the prior, an infinite score without.
    """
    visits = np.maximum(node.counts, 1)
    bonus = np.sqrt(math.log(max(node.visits, 1)) / visits)
    scores = node.estimates + config.exploration * bonus
    if not config.prior:
        scores[node.counts == 0] = math.inf
    return scores[keys]


def _untried(node: Node, count: int, config: SearchConfig, rng: np.random.Generator) -> list[int]:
    """The next ``count`` untried actions, or as many as there are."""
    values = node.actions.values
    if config.expansion == "epsilon-greedy":
        return epsilon_greedy_expansions(values, set(node.children), count, config.epsilon, rng)
    # All untried children of a node have the same bonus, so Q decides.
    order = rng.permutation(len(values))
    if config.prior:
        order = order[np.argsort(-values[order], kind="stable")]
    return [int(key) for key in order if int(key) not in node.children][:count]


def epsilon_greedy_expansions(
    values: np.ndarray, tried: set[int], count: int, epsilon: float, rng: np.random.Generator
) -> list[int]:
    """Numbers of the next ``count`` untried actions to expand.

    Each draw is a uniform action with probability ``epsilon``, else the best by Q; one that has
    been tried is rejected for good and the draw repeated. The rule does not look at simulated
    results, so a whole budget can be chosen at once and simulated in one batch.
    """
    order = np.argsort(-values, kind="stable")
    open_actions = np.ones(len(values), bool)
    chosen: list[int] = []
    tried = set(tried)
    cursor = 0
    while len(chosen) < count and len(tried) < len(values):
        if rng.random() < epsilon:
            pick = int(rng.choice(np.flatnonzero(open_actions)))
        else:
            while not open_actions[order[cursor]]:
                cursor += 1
            pick = int(order[cursor])
        if pick in tried:
            open_actions[pick] = False
        else:
            tried.add(pick)
            chosen.append(pick)
    return chosen


def final_key(root: Node, config: SearchConfig, rng: np.random.Generator) -> int:
    """Number of the explored root action to play, chance aside."""
    keys = list(root.children)
    if config.final != "best-mean":
        most = max(root.children[key].visits for key in keys)
        keys = [key for key in keys if root.children[key].visits == most]
    if config.final == "gumbel":
        return keys[largest(gumbel_scores(root, config)[keys], rng)]
    return keys[largest([root.children[key].value for key in keys], rng)]


def largest(values: np.ndarray | list[float], rng: np.random.Generator) -> int:
    """Place of the largest value; ties at random."""
    values = np.asarray(values)
    ties = np.flatnonzero(values >= values.max() - 1e-12)
    return int(ties[0] if len(ties) == 1 else rng.choice(ties))
