"""Batched Monte-Carlo tree search with a small budget (paper section 2.2).

One decision for each of several roots. In every round each root names a wave of root actions, all
waves walk down their trees in lockstep, and all leaves of all roots are simulated in one batched
step and valued in one batched network evaluation. Variants differ only in the rules, which stand
first: which action a walk takes, and which one is played in the end. They include Gumbel root
selection with sequential halving and completed Q-values (Danihelka et al. 2022): a Q-network takes
the place of policy and value, the logits are Q / temperature, and the completed Q-value of an
action that was not simulated is its Q.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

import numpy as np

from learn2assemble.tasks.search.config import SearchConfig
from learn2assemble.tasks.search.tree import (
    ActionValues,
    SearchModel,
    StepResult,
    TreeNode,
    back_up,
    gather,
)


def gumbel_waves(
    root: TreeNode, config: SearchConfig, rng: np.random.Generator
) -> Iterator[list[int]]:
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


def gumbel_scores(root: TreeNode, config: SearchConfig) -> np.ndarray:
    """``g + logits + sigma(completed Q)`` of every root action: float64[A]."""
    noise = 0.0 if root.noise is None else root.noise
    return noise + _logits(root, config) + _sigma(root, config)


def completed_policy(node: TreeNode, config: SearchConfig) -> np.ndarray:
    """The improved policy ``softmax(logits + sigma(completed Q))``: float64[A]."""
    logits = _logits(node, config) + _sigma(node, config)
    weights = np.exp(logits - logits.max())
    return weights / weights.sum()


def gumbel_interior(node: TreeNode, config: SearchConfig) -> int:
    """Below the root: where the visits lag most behind the improved policy; no chance."""
    share = node.simulated / (1 + node.simulated.sum())
    return int(np.argmax(completed_policy(node, config) - share))


def _logits(node: TreeNode, config: SearchConfig) -> np.ndarray:
    return node.actions.values / config.gumbel.temperature


def _sigma(node: TreeNode, config: SearchConfig) -> np.ndarray:
    """The monotone transform of completed Q-values, which search results sharpen."""
    low, high = node.estimates.min(), node.estimates.max()
    scaled = (node.estimates - low) / max(high - low, 1e-8)
    return (config.gumbel.visit_offset + node.simulated.max()) * config.gumbel.value_scale * scaled


def root_waves(
    root: TreeNode, config: SearchConfig, rng: np.random.Generator
) -> Iterator[list[int]]:
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


def choose(node: TreeNode, config: SearchConfig, rng: np.random.Generator) -> int | None:
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


def _anything(node: TreeNode, room: bool, config: SearchConfig, rng: np.random.Generator) -> int:
    """The choice among explored and, where there is room, untried actions."""
    keys = np.arange(len(node.actions.values)) if room else node.tried
    if config.expansion == "uct":
        return int(keys[largest(uct_scores(node, keys, config), rng)])
    if rng.random() < config.epsilon:
        return int(keys[int(rng.integers(len(keys)))])
    return int(keys[largest(node.estimates[keys], rng)])


def uct_scores(node: TreeNode, keys: np.ndarray | list[int], config: SearchConfig) -> np.ndarray:
    """``mean + c sqrt(ln n(node) / n(child))`` of some actions.

    An untried action has visit count 1 and mean Q with the prior, an infinite score without.
    """
    counts = node.counts[keys]
    bonus = np.sqrt(math.log(max(node.visits, 1)) / np.maximum(counts, 1))
    scores = node.estimates[keys] + config.exploration * bonus
    if not config.prior:
        scores[counts == 0] = math.inf
    return scores


def _untried(
    node: TreeNode, count: int, config: SearchConfig, rng: np.random.Generator
) -> list[int]:
    """The next ``count`` untried actions, or as many as there are."""
    values = node.actions.values
    if config.expansion == "epsilon-greedy":
        return epsilon_greedy_expansions(values, set(node.children), count, config.epsilon, rng)
    # All untried children of a node have the same bonus, so Q decides.
    order = rng.permutation(len(values))
    if config.prior:
        order = order[np.argsort(-values[order], kind="stable")]
    untried = (key for key in order.tolist() if key not in node.children)
    return list(islice(untried, count))


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


def final_key(root: TreeNode, config: SearchConfig, rng: np.random.Generator) -> int:
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
    ties = (values >= values.max() - 1e-12).nonzero()[0]
    return int(ties[0] if len(ties) == 1 else ties[rng.integers(len(ties))])


def returns(
    model: SearchModel, result: StepResult, config: SearchConfig, rng: np.random.Generator
) -> np.ndarray:
    """``G = sum_t gamma^t r_t + gamma^eta max Q`` of the steps just made: float64[B].

    The first step is ``result``; ``eta - 1`` steps of the rollout policy follow. Episodes that
    end on the way have no bootstrap. All rows go on together.
    """
    total = np.asarray(result.reward, float).copy()
    alive = np.flatnonzero(~result.terminal)
    states = model.take(result.states, alive)
    scale = model.discount
    for _ in range(config.rollout - 1):
        if not len(alive):
            return total
        step = model.step(states, _rollout_actions(model, states, len(alive), config, rng))
        total[alive] += scale * step.reward
        scale *= model.discount
        going = np.flatnonzero(~step.terminal)
        alive, states = alive[going], model.take(step.states, going)
    if len(alive):
        total[alive] += scale * model.best(states)[0]
    return total


def _rollout_actions(
    model: SearchModel, states: object, count: int, config: SearchConfig, rng: np.random.Generator
) -> np.ndarray:
    """One action a row: uniform, or greedy with a uniform one at the rate epsilon."""
    if config.rollout_policy == "random":
        return model.random_actions(states, rng)
    _, actions = model.best(states)
    if config.epsilon:
        chance = rng.random(count) < config.epsilon
        actions = np.where(chance[:, None], model.random_actions(states, rng), actions)
    return actions


@dataclass
class SearchResult:
    """What a search decided at one root."""

    action: np.ndarray
    """int64[3]."""
    root: TreeNode
    """The tree, with visits and values."""
    random: bool
    """Whether a draw of epsilon chose the action."""

    def explored(self) -> list[tuple[np.ndarray, float, int]]:
        """Explored root actions with their value and visit count."""
        return [
            (self.root.actions.actions[key], child.value, child.visits)
            for key, child in self.root.children.items()
        ]


@dataclass
class _Descent:
    """A way down a tree: nodes from the root, and the action taken at the last of them."""

    path: list[TreeNode]
    key: int


def search(
    model: SearchModel, states: Any, config: SearchConfig, rng: np.random.Generator
) -> list[SearchResult]:
    """Choose one action for every row of ``states`` (left unchanged).

    With ``budget`` 0 this is the epsilon-free greedy policy. The final choice is a uniformly
    random explored child with probability ``epsilon``, else the one ``config.final`` names.
    """
    if config.random_first:
        return _random_first(model, states, config, rng)
    legal = _legal(model, states, config)
    roots = [TreeNode((states, row)) for row in range(len(legal))]
    for root, values in zip(roots, legal, strict=True):
        root.open(values)
    plans = [root_waves(root, config, rng) for root in roots]
    while True:
        walks = [
            _Descent([root], key)
            for root, plan in zip(roots, plans, strict=True)
            for key in next(plan, ())
        ]
        if not walks:
            return [_decide(root, config, rng) for root in roots]
        _descend(model, walks, config, rng)
        _simulate(model, walks, config, rng)


def _random_first(
    model: SearchModel, states: Any, config: SearchConfig, rng: np.random.Generator
) -> list[SearchResult]:
    """Random actions without a search at the rate epsilon, searches in the other rows."""
    actions = model.random_actions(states, rng)
    searched = np.flatnonzero(rng.random(len(actions)) >= config.epsilon)
    out = [SearchResult(action, TreeNode(None), random=True) for action in actions]
    if len(searched):
        plain = replace(config, random_first=False)
        found = search(model, model.take(states, searched), plain, rng)
        for row, decision in zip(searched, found, strict=True):
            out[row] = decision
    return out


def _legal(model: SearchModel, states: Any, config: SearchConfig) -> list[ActionValues]:
    """The actions a search may expand, for every row."""
    values = model.action_values(states) if config.uses_q else model.legal(states)
    return [row.distinct() for row in values] if config.distinct else values


def _descend(
    model: SearchModel, walks: list[_Descent], config: SearchConfig, rng: np.random.Generator
) -> None:
    """Lead every walk to the edge it simulates: an untried one, an end, or the depth limit."""
    while walks:
        going: list[_Descent] = []
        for walk in walks:
            child = walk.path[-1].children.get(walk.key)
            if child is not None and not child.terminal and len(walk.path) < config.depth:
                walk.path.append(child)
                going.append(walk)
        fresh = [walk.path[-1] for walk in going if walk.path[-1].legal is None]
        if fresh:
            for node, values in zip(
                fresh, _legal(model, gather(model, fresh), config), strict=True
            ):
                node.open(values)
        for walk in going:
            key = choose(walk.path[-1], config, rng)
            assert key is not None, "a node that is not done has something to try"
            walk.key = key
        walks = going


def _simulate(
    model: SearchModel, walks: list[_Descent], config: SearchConfig, rng: np.random.Generator
) -> None:
    """Take the last edge of every walk in one batch, roll out, back up."""
    parents = [walk.path[-1] for walk in walks]
    actions = np.stack([p.actions.actions[w.key] for p, w in zip(parents, walks, strict=True)])
    result = model.step(gather(model, parents), actions)
    values = returns(model, result, config, rng)
    for n, (walk, parent) in enumerate(zip(walks, parents, strict=True)):
        child = parent.children.get(walk.key)
        if child is None:
            terminal = bool(result.terminal[n])
            state = None if terminal else (result.states, n)
            child = TreeNode(state, float(result.reward[n]), terminal, key=walk.key)
            child.done = terminal or len(walk.path) >= config.depth
            if config.prior:
                child.prior = float(parent.actions.values[walk.key])
                child.visits, child.total = 1, child.prior
            parent.children[walk.key] = child
        back_up(walk.path, child, float(values[n]), model.discount, config.backup)


def _decide(root: TreeNode, config: SearchConfig, rng: np.random.Generator) -> SearchResult:
    legal = root.actions
    if not root.children:
        return SearchResult(legal.actions[int(np.argmax(legal.values))], root, random=False)
    if rng.random() < config.epsilon:
        keys = list(root.children)
        return SearchResult(legal.actions[keys[int(rng.integers(len(keys)))]], root, random=True)
    return SearchResult(legal.actions[final_key(root, config, rng)], root, random=False)
