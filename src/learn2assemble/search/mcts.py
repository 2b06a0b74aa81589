"""Batched small-budget Monte-Carlo tree search (paper 2.2, protocol 11.1 to 11.3).

One decision for each of several roots. Every wave expands at most the remaining budget at one
node of each root, simulates all expansions of all roots in one batched step and values all leaves
in one batched network evaluation. At the root a wave may hold many expansions, because the
expansion rule does not depend on simulated results; below the root it holds one at a time.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from learn2assemble.search.config import SearchConfig
from learn2assemble.search.model import ActionValues, SearchModel, StepResult
from learn2assemble.search.tree import Node, best_child, epsilon_greedy_expansions


@dataclass
class Decision:
    """What a search decided at one root."""

    action: np.ndarray
    """int64[3]."""
    root: Node
    """The tree, with visits and values."""
    random: bool
    """Whether a draw of epsilon chose the action."""

    def explored(self) -> list[tuple[np.ndarray, float, int]]:
        """Explored root actions with their mean value and visit count."""
        return [
            (_legal(self.root).actions[key], child.value, child.visits)
            for key, child in self.root.children.items()
        ]


@dataclass
class _Leaf:
    path: list[Node]
    key: int


def search(
    model: SearchModel, states: Any, config: SearchConfig, rng: np.random.Generator
) -> list[Decision]:
    """Choose one action for every row of ``states`` (left unchanged).

    With ``budget`` 0 this is the epsilon-free greedy policy. The final choice is a uniformly
    random explored child with probability ``epsilon``, else the child of largest mean value.
    """
    if config.random_first:
        return _random_first(model, states, config, rng)
    rows = range(model.batch_size(states))
    legal = _candidates(model, states, config)
    roots = [Node(model.take(states, np.array([row])), legal=legal[row]) for row in rows]
    remaining = np.full(len(roots), config.budget)
    while True:
        leaves: list[_Leaf] = []
        for number, root in enumerate(roots):
            if remaining[number] > 0:
                wave = _select(model, root, int(remaining[number]), config, rng)
                remaining[number] = remaining[number] - len(wave) if wave else 0
                leaves += wave
        if not leaves:
            break
        _simulate(model, leaves, config, rng)
    return [_final(root, config, rng) for root in roots]


def _random_first(
    model: SearchModel, states: Any, config: SearchConfig, rng: np.random.Generator
) -> list[Decision]:
    """Random actions without a search at the rate epsilon, searches in the other rows."""
    actions = model.random_actions(states, rng)
    searched = np.flatnonzero(rng.random(len(actions)) >= config.epsilon)
    out = [Decision(action, Node(None), random=True) for action in actions]
    if len(searched):
        plain = replace(config, random_first=False)
        found = search(model, model.take(states, searched), plain, rng)
        for row, decision in zip(searched, found, strict=True):
            out[row] = decision
    return out


def _candidates(model: SearchModel, states: Any, config: SearchConfig) -> list[ActionValues]:
    """The actions a search may expand, for every row."""
    values = model.action_values(states)
    return [row.distinct() for row in values] if config.distinct else values


def _select(
    model: SearchModel, root: Node, budget: int, config: SearchConfig, rng: np.random.Generator
) -> list[_Leaf]:
    """Walk down to a node with untried actions; empty where the whole tree is known."""
    path = [root]
    while path[-1].fully_expanded:
        node = path[-1]
        open_keys = [k for k, child in node.children.items() if not _exhausted(child)]
        if not open_keys:
            return []
        if rng.random() < config.epsilon:
            key = open_keys[int(rng.integers(len(open_keys)))]
        else:
            key = max(open_keys, key=lambda k: node.children[k].value)
        child = node.children[key]
        if child.legal is None:
            child.legal = _candidates(model, child.state, config)[0]
        path.append(child)
    node = path[-1]
    assert node.legal is not None
    count = budget if len(path) == 1 else 1
    epsilon = config.epsilon if config.expansion == "epsilon-greedy" else 0.0
    keys = epsilon_greedy_expansions(node.legal.values, set(node.children), count, epsilon, rng)
    return [_Leaf(list(path), key) for key in keys]


def _exhausted(node: Node) -> bool:
    """Whether nothing below a node is left to try."""
    if node.terminal:
        return True
    return node.fully_expanded and all(_exhausted(child) for child in node.children.values())


def _simulate(
    model: SearchModel, leaves: list[_Leaf], config: SearchConfig, rng: np.random.Generator
) -> None:
    """Expand all leaves in one batch, roll out, back up."""
    parents = [leaf.path[-1] for leaf in leaves]
    keys = [leaf.key for leaf in leaves]
    priors = [_legal(p).values[k] for p, k in zip(parents, keys, strict=True)]
    actions = np.stack([_legal(p).actions[k] for p, k in zip(parents, keys, strict=True)])
    result = model.step(model.join([parent.state for parent in parents]), actions)
    returns = np.asarray(result.reward, float) + model.discount * _continue(
        model, result, config, rng
    )
    for n, (leaf, parent) in enumerate(zip(leaves, parents, strict=True)):
        terminal = bool(result.terminal[n])
        state = None if terminal else model.take(result.states, np.array([n]))
        child = Node(state, float(result.reward[n]), terminal)
        if config.prior:
            child.visits, child.total = 1, float(priors[n])
        parent.children[leaf.key] = child
        _back_up(leaf.path, child, float(returns[n]), model.discount)


def _back_up(path: list[Node], child: Node, value: float, discount: float) -> None:
    """Add the return ``value`` of the new child to it and to every node above."""
    child.visits += 1
    child.total += value
    for node in reversed(path[1:]):
        value = node.reward + discount * value
        node.visits += 1
        node.total += value
    path[0].visits += 1
    path[0].total += value


def _continue(
    model: SearchModel, result: StepResult, config: SearchConfig, rng: np.random.Generator
) -> np.ndarray:
    """Return from the successors on: ``rollout - 1`` epsilon-greedy steps, then the largest Q."""
    total = np.zeros(len(result.reward))
    alive = np.flatnonzero(~result.terminal)
    states = model.take(result.states, alive)
    scale = 1.0
    for _ in range(config.rollout - 1):
        if not len(alive):
            return total
        _, actions = model.best(states)
        for n in np.flatnonzero(rng.random(len(alive)) < config.epsilon):
            legal = model.action_values(model.take(states, np.array([n])))[0].actions
            actions[n] = legal[int(rng.integers(len(legal)))]
        step = model.step(states, actions)
        total[alive] += scale * step.reward
        scale *= model.discount
        going = np.flatnonzero(~step.terminal)
        alive, states = alive[going], model.take(step.states, going)
    if len(alive):
        total[alive] += scale * model.best(states)[0]
    return total


def _legal(node: Node) -> ActionValues:
    assert node.legal is not None
    return node.legal


def _final(root: Node, config: SearchConfig, rng: np.random.Generator) -> Decision:
    legal = _legal(root)
    if not root.children:
        return Decision(legal.actions[int(np.argmax(legal.values))], root, random=False)
    if rng.random() < config.epsilon:
        key = list(root.children)[int(rng.integers(len(root.children)))]
        return Decision(legal.actions[key], root, random=True)
    return Decision(legal.actions[best_child(root, rng)], root, random=False)
