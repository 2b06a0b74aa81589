"""Gumbel root selection with sequential halving and completed Q-values (Danihelka et al. 2022).

A Q-network takes the place of policy and value: the logits are Q / temperature, and the completed
Q-value of an action that was not simulated is its Q (the original fills in a mixed state value).
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from learn2assemble.search.config import SearchConfig
from learn2assemble.search.tree import Node


def halving(root: Node, config: SearchConfig, rng: np.random.Generator) -> Iterator[list[int]]:
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
        score = scores(root, config)
        alive.sort(key=lambda key: -score[key])
        alive = alive[: max(2, len(alive) // 2)]


def scores(root: Node, config: SearchConfig) -> np.ndarray:
    """``g + logits + sigma(completed Q)`` of every root action: float64[A]."""
    noise = 0.0 if root.noise is None else root.noise
    return noise + _logits(root, config) + _sigma(root, config)


def completed_policy(node: Node, config: SearchConfig) -> np.ndarray:
    """The improved policy ``softmax(logits + sigma(completed Q))``: float64[A]."""
    logits = _logits(node, config) + _sigma(node, config)
    weights = np.exp(logits - logits.max())
    return weights / weights.sum()


def interior(node: Node, config: SearchConfig) -> int:
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
