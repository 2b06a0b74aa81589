"""Batched Monte-Carlo tree search with a small budget (paper section 2.2).

One decision for each of several roots. In every round each root names a wave of root actions, all
waves walk down their trees in lockstep, and all leaves of all roots are simulated in one batched
step and valued in one batched network evaluation. Variants differ only in the rules
(:mod:`~learn2assemble.search.rules`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from learn2assemble.search.config import SearchConfig
from learn2assemble.search.rules import choose, final_key, root_waves
from learn2assemble.search.tree import ActionValues, Node, SearchModel, StepResult, back_up, gather


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
class Decision:
    """What a search decided at one root."""

    action: np.ndarray
    """int64[3]."""
    root: Node
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
class _Walk:
    """A way down a tree: nodes from the root, and the action taken at the last of them."""

    path: list[Node]
    key: int


def search(
    model: SearchModel, states: Any, config: SearchConfig, rng: np.random.Generator
) -> list[Decision]:
    """Choose one action for every row of ``states`` (left unchanged).

    With ``budget`` 0 this is the epsilon-free greedy policy. The final choice is a uniformly
    random explored child with probability ``epsilon``, else the one ``config.final`` names.
    """
    if config.random_first:
        return _random_first(model, states, config, rng)
    legal = _legal(model, states, config)
    roots = [Node((states, row)) for row in range(len(legal))]
    for root, values in zip(roots, legal, strict=True):
        root.open(values)
    plans = [root_waves(root, config, rng) for root in roots]
    while True:
        walks = [
            _Walk([root], key)
            for root, plan in zip(roots, plans, strict=True)
            for key in next(plan, ())
        ]
        if not walks:
            return [_decide(root, config, rng) for root in roots]
        _descend(model, walks, config, rng)
        _simulate(model, walks, config, rng)


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


def _legal(model: SearchModel, states: Any, config: SearchConfig) -> list[ActionValues]:
    """The actions a search may expand, for every row."""
    values = model.action_values(states) if config.uses_q else model.legal(states)
    return [row.distinct() for row in values] if config.distinct else values


def _descend(
    model: SearchModel, walks: list[_Walk], config: SearchConfig, rng: np.random.Generator
) -> None:
    """Lead every walk to the edge it simulates: an untried one, an end, or the depth limit."""
    while walks:
        going: list[_Walk] = []
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
    model: SearchModel, walks: list[_Walk], config: SearchConfig, rng: np.random.Generator
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
            child = Node(state, float(result.reward[n]), terminal, key=walk.key)
            child.done = terminal or len(walk.path) >= config.depth
            if config.prior:
                child.prior = float(parent.actions.values[walk.key])
                child.visits, child.total = 1, child.prior
            parent.children[walk.key] = child
        back_up(walk.path, child, float(values[n]), model.discount, config.backup)


def _decide(root: Node, config: SearchConfig, rng: np.random.Generator) -> Decision:
    legal = root.actions
    if not root.children:
        return Decision(legal.actions[int(np.argmax(legal.values))], root, random=False)
    if rng.random() < config.epsilon:
        keys = list(root.children)
        return Decision(legal.actions[keys[int(rng.integers(len(keys)))]], root, random=True)
    return Decision(legal.actions[final_key(root, config, rng)], root, random=False)
