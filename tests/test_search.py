"""The tree search: golden trees by hand, enumeration, expansion rule, determinism, real worlds."""

from __future__ import annotations

import math
from collections import Counter
from typing import Any, NamedTuple

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from learn2assemble.errors import InputError
from learn2assemble.networks.config import NetworkConfig
from learn2assemble.networks.qnetwork import QNetwork
from learn2assemble.planning.world_model import WorldModel
from learn2assemble.search.config import TO_THE_END, SearchConfig
from learn2assemble.search.mcts import Decision, search
from learn2assemble.search.model import ActionValues, StepResult
from learn2assemble.search.rules import epsilon_greedy_expansions, final_key
from learn2assemble.search.tree import Node
from learn2assemble.simulator import Simulator
from learn2assemble.task import Task
from learn2assemble.world.state import State

torch.set_num_threads(1)


class Edge(NamedTuple):
    """One action: its Q-value, its reward, and where it leads (``None``: the end)."""

    q: float
    reward: float
    to: str | None


class TreeModel:
    """A :class:`SearchModel` over a written-out tree; a batch is an array of state names."""

    def __init__(self, edges: dict[str, list[Edge]], discount: float = 0.5) -> None:
        self.edges, self.discount = edges, discount
        self.groups: dict[str, list[int]] = {}
        """By state, where several of its actions lead to the same structure."""

    def batch_size(self, states: np.ndarray) -> int:
        return len(states)

    def take(self, states: np.ndarray, rows: np.ndarray) -> np.ndarray:
        return states[rows].copy()

    def join(self, states: list[np.ndarray]) -> np.ndarray:
        return np.concatenate(states)

    def step(self, states: np.ndarray, actions: np.ndarray) -> StepResult:
        taken = [self.edges[s][a[0] - 7] for s, a in zip(states, actions, strict=True)]
        return StepResult(
            np.array([edge.to for edge in taken], object),
            np.array([edge.reward for edge in taken], float),
            np.array([edge.to is None for edge in taken], bool),
        )

    def action_values(self, states: np.ndarray) -> list[ActionValues]:
        out = []
        for name in states:
            q = np.array([edge.q for edge in self.edges[name]])
            # Numbered from 7, so that an action is not mistaken for its place in the list.
            actions = np.stack([7 + np.arange(len(q)), 0 * q, 0 * q], -1).astype(np.int64)
            group = np.array(self.groups.get(name, range(len(q))), np.int64)
            out.append(ActionValues(actions, q, group))
        return out

    def legal(self, states: np.ndarray) -> list[ActionValues]:
        return [v._replace(values=0 * v.values) for v in self.action_values(states)]

    def random_actions(self, states: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        return np.array([rng.choice(v.actions) for v in self.action_values(states)])

    def best(self, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        values = self.action_values(states)
        place = [int(np.argmax(v.values)) for v in values]
        return (
            np.array([v.values[n] for v, n in zip(values, place, strict=True)]),
            np.array([v.actions[n] for v, n in zip(values, place, strict=True)]),
        )


def root(*names: str) -> np.ndarray:
    return np.array(names or ("root",), object)


def decide(model: Any, seed: int = 0, **arguments: Any) -> Decision:
    """One decision at ``root``; without chance unless asked for."""
    config = SearchConfig(**{"epsilon": 0.0, **arguments})
    return search(model, root(), config, np.random.default_rng(seed))[0]


def explored(decision: Decision) -> dict[int, tuple[float, int]]:
    """Value and visits of every explored root action, by its place in the list."""
    return {number - 7: found for number, found in explored_actions(decision).items()}


def explored_actions(decision: Decision) -> dict[int, tuple[float, int]]:
    """The same by the first number of the action."""
    return {int(a[0]): (round(v, 9), n) for a, v, n in decision.explored()}


THREE = TreeModel(
    {
        "root": [Edge(0.9, 0.0, "A"), Edge(0.5, 1.0, None), Edge(0.1, 0.5, "C")],
        "A": [Edge(0.4, 0.25, None), Edge(0.2, 1.0, "A2")],
        "A2": [Edge(3.0, 0.0, None)],
        "C": [Edge(2.0, 0.1, "C2")],
        "C2": [Edge(0.7, -1.0, None), Edge(0.6, 0.3, None)],
    }
)


@pytest.mark.parametrize(
    ("arguments", "expected", "choice"),
    [
        # value = (Q + G) / 2 with G = r + 0.5 max Q(s').
        ({"budget": 1}, {0: (0.55, 2)}, 0),
        ({"budget": 2}, {0: (0.55, 2), 1: (0.75, 2)}, 1),
        ({"budget": 3}, {0: (0.55, 2), 1: (0.75, 2), 2: (0.8, 2)}, 2),
        # Without the prior, G alone.
        ({"budget": 3, "prior": False}, {0: (0.2, 1), 1: (1.0, 1), 2: (1.5, 1)}, 2),
        # Two simulated steps: A ends with 0.25; C gives 0.5 + 0.5 (0.1 + 0.5 * 0.7).
        (
            {"budget": 3, "prior": False, "rollout": 2},
            {0: (0.125, 1), 1: (1.0, 1), 2: (0.725, 1)},
            1,
        ),
        # To the end: C2 greedily takes -1: 0.5 + 0.5 (0.1 + 0.5 * -1).
        (
            {"budget": 3, "prior": False, "rollout": TO_THE_END},
            {0: (0.125, 1), 1: (1.0, 1), 2: (0.3, 1)},
            1,
        ),
        (
            {"budget": 3, "rollout": TO_THE_END},
            {0: (0.5125, 2), 1: (0.75, 2), 2: (0.2, 2)},
            1,
        ),
    ],
)
def test_golden_values_of_depth_one(
    arguments: dict[str, Any], expected: dict[int, tuple[float, int]], choice: int
) -> None:
    """Visits and values computed by hand (protocol 11.1)."""
    decision = decide(THREE, **arguments)
    assert explored(decision) == expected
    assert decision.action.tolist() == [7 + choice, 0, 0]


TWO_LEVELS = TreeModel(
    {
        "root": [Edge(1.0, 0.0, "A"), Edge(0.5, 0.2, None)],
        "A": [Edge(0.6, 1.0, None), Edge(0.8, 0.0, None)],
    }
)


@pytest.mark.parametrize(
    ("prior", "children", "below", "total"),
    [
        # a: 0.5*0.8, then 0 + 0.5*0 for y, then 0 + 0.5*1 for x; b: 0.2.
        (False, {0: (0.3, 3), 1: (0.2, 1)}, {1: (0.0, 1), 0: (1.0, 1)}, 1.1),
        # The same with one more visit worth Q in every child.
        (True, {0: (0.475, 4), 1: (0.35, 2)}, {1: (0.4, 2), 0: (0.8, 2)}, 1.1),
    ],
)
def test_golden_tree_of_depth_two(
    prior: bool, children: dict[int, Any], below: dict[int, Any], total: float
) -> None:
    """Once every root action is tried, one expansion at a time goes below (protocol 11.1)."""
    decision = decide(TWO_LEVELS, budget=4, prior=prior)
    assert explored(decision) == children
    deeper = decision.root.children[0].children
    assert {k: (round(c.value, 9), c.visits) for k, c in deeper.items()} == below
    assert list(deeper) == [1, 0], "the larger Q is expanded first"
    assert decision.root.visits == 4
    assert decision.root.total == pytest.approx(total)
    assert decision.action[0] == 7


def test_below_the_root_every_result_counts_before_the_next_choice() -> None:
    """The best Q below A turns out bad, so the next expansion goes below B, not below A again."""
    model = TreeModel(
        {
            "root": [Edge(1.0, 0.0, "A"), Edge(0.5, 0.0, "B")],
            "A": [Edge(1.0, -1.0, None), Edge(0.9, 0.0, None)],
            "B": [Edge(0.8, 0.6, None), Edge(0.7, 0.0, None)],
        }
    )
    decision = decide(model, budget=4, prior=False)
    # a: 0.5 * 1.0, then 0.5 * -1; b: 0.5 * 0.8, then 0.5 * 0.6.
    assert explored(decision) == {0: (0.0, 2), 1: (0.35, 2)}
    assert [list(child.children) for child in decision.root.children.values()] == [[0], [0]]
    assert decision.action[0] == 8


def test_distinct_search_expands_the_best_of_every_group() -> None:
    """Deviation D14: the first two root actions lead to the same structure, and so do both
    actions below it; the budget goes to what is left."""
    model = TreeModel(
        {
            "root": [Edge(0.5, 1.0, None), Edge(0.9, 0.0, "A"), Edge(0.1, 0.5, None)],
            "A": [Edge(0.4, 0.25, None), Edge(0.2, 1.0, None)],
        }
    )
    model.groups = {"root": [4, 4, 2], "A": [0, 0]}
    # Q = 0.9 and 0.1 remain: (0.9 + 0 + 0.5 * 0.4) / 2 and (0.1 + 0.5) / 2.
    decision = decide(model, budget=2, distinct=True)
    assert explored_actions(decision) == {8: (0.55, 2), 9: (0.3, 2)}
    assert decision.action.tolist() == [8, 0, 0]
    whole = decide(model, budget=50, distinct=True, prior=False)
    assert size(whole.root) == 3, "two actions at the root, one below"
    assert size(decide(model, budget=50, prior=False).root) == 5
    # Budget 0 stays the greedy policy.
    assert decide(model, budget=0, distinct=True).action[0] == 8


@given(st.lists(st.tuples(st.integers(0, 4), st.floats(-1, 1, width=16)), min_size=1, max_size=12))
def test_distinct_keeps_one_best_action_of_every_group(drawn: list[tuple[int, float]]) -> None:
    group, values = (np.array(column) for column in zip(*drawn, strict=True))
    actions = np.arange(3 * len(group)).reshape(-1, 3)
    kept = ActionValues(actions, values, group).distinct()
    assert sorted(kept.group) == sorted(set(group))
    for action, value, number in zip(*kept, strict=True):
        assert value == values[group == number].max()
        assert values[action[0] // 3] == value
        assert group[action[0] // 3] == number
    assert (np.diff(kept.actions[:, 0]) > 0).all(), "the order stays"


def random_tree(seed: int, discount: float = 0.8, width: int = 3, depth: int = 4) -> TreeModel:
    """A tree of up to ``width`` actions a state, with values that never tie."""
    rng = np.random.default_rng(seed)
    edges: dict[str, list[Edge]] = {}

    def grow(name: str, level: int) -> None:
        edges[name] = []
        for number in range(int(rng.integers(1, width + 1))):
            to = None if level == depth or rng.random() < 0.3 else f"{name}.{number}"
            edges[name].append(Edge(float(rng.normal()), float(rng.normal()), to))
            if to is not None:
                grow(to, level + 1)

    grow("root", 1)
    return TreeModel(edges, discount)


def greedy_return(model: TreeModel, state: str, action: int, steps: int) -> float:
    """Return of ``action`` and greedy play, bootstrapped after ``steps`` steps."""
    edge = model.edges[state][action]
    if edge.to is None:
        return edge.reward
    q = [e.q for e in model.edges[edge.to]]
    if steps == 1:
        return edge.reward + model.discount * max(q)
    follow = greedy_return(model, edge.to, int(np.argmax(q)), steps - 1)
    return edge.reward + model.discount * follow


def best_return(model: TreeModel, state: str) -> tuple[float, int]:
    """Largest return by exhaustive enumeration, and the action that starts it."""
    values = []
    for edge in model.edges[state]:
        later = 0.0 if edge.to is None else model.discount * best_return(model, edge.to)[0]
        values.append(edge.reward + later)
    return max(values), int(np.argmax(values))


def size(node: Node) -> int:
    return sum(1 + size(child) for child in node.children.values())


@given(
    seed=st.integers(0, 10_000),
    rollout=st.sampled_from([1, 2, 3, TO_THE_END]),
    prior=st.booleans(),
)
@settings(max_examples=60, deadline=None)
def test_one_level_against_enumeration(seed: int, rollout: int, prior: bool) -> None:
    """With the budget of all root actions: (Q + G) / 2, or G, and the largest of them."""
    model = random_tree(seed)
    edges = model.edges["root"]
    decision = decide(model, budget=len(edges), rollout=rollout, prior=prior)
    returns = [greedy_return(model, "root", n, rollout) for n in range(len(edges))]
    expected = [(e.q + g) / 2 if prior else g for e, g in zip(edges, returns, strict=True)]
    got = explored(decision)
    assert got == {n: (round(v, 9), 1 + prior) for n, v in enumerate(expected)}
    assert decision.action[0] - 7 == int(np.argmax(expected))


@given(seed=st.integers(0, 10_000), epsilon=st.sampled_from([0.0, 0.4, 1.0]))
@settings(max_examples=40, deadline=None)
def test_large_budget_explores_everything_once(seed: int, epsilon: float) -> None:
    """As many nodes as the tree has actions, visits that count them, and then it stops."""
    model = random_tree(seed)
    actions = sum(len(edges) for edges in model.edges.values())
    decision = decide(model, seed, budget=10 * actions, epsilon=epsilon, prior=False)
    assert size(decision.root) == actions
    assert decision.root.visits == actions

    def check(node: Node) -> None:
        for child in node.children.values():
            assert child.visits == 1 + size(child)
            check(child)

    check(decision.root)


@given(seed=st.integers(0, 10_000))
@settings(max_examples=40, deadline=None)
def test_best_of_chains_is_the_exhaustive_best(seed: int) -> None:
    """Where only the first action is a choice, means are exact returns."""
    rng = np.random.default_rng(seed)
    edges: dict[str, list[Edge]] = {"root": []}
    for chain in range(4):
        names = [f"{chain}.{n}" for n in range(int(rng.integers(0, 4)))]
        steps = [*names, None]
        edges["root"].append(Edge(float(rng.normal()), float(rng.normal()), steps[0]))
        for here, there in zip(names, steps[1:], strict=True):
            edges[here] = [Edge(float(rng.normal()), float(rng.normal()), there)]
    model = TreeModel(edges, 0.8)
    value, action = best_return(model, "root")
    decision = decide(model, budget=100, prior=False, rollout=TO_THE_END)
    assert decision.action[0] - 7 == action
    assert max(v for _, v, _ in decision.explored()) == pytest.approx(value)


@given(seed=st.integers(0, 10_000), epsilon=st.sampled_from([0.0, 1.0]))
@settings(max_examples=30, deadline=None)
def test_budget_zero_is_greedy(seed: int, epsilon: float) -> None:
    model = random_tree(seed)
    decision = decide(model, seed, budget=0, epsilon=epsilon)
    assert decision.action[0] - 7 == int(np.argmax([e.q for e in model.edges["root"]]))
    assert decision.explored() == []


@given(seed=st.integers(0, 10_000), budget=st.integers(1, 12))
@settings(max_examples=30, deadline=None)
def test_several_roots_are_independent(seed: int, budget: int) -> None:
    """One call with many roots equals one call each, so no row leaks into another."""
    model = random_tree(seed)
    names = list(model.edges)[:5]
    config = SearchConfig(budget=budget, epsilon=0.0, rollout=2)
    together = search(model, root(*names), config, np.random.default_rng(0))
    for name, decision in zip(names, together, strict=True):
        alone = search(model, root(name), config, np.random.default_rng(0))[0]
        assert decision.action.tolist() == alone.action.tolist()
        assert explored(decision) == explored(alone)
        assert size(decision.root) == size(alone.root)


@given(seed=st.integers(0, 10_000))
@settings(max_examples=20, deadline=None)
def test_same_seed_same_search_and_states_stay(seed: int) -> None:
    model = random_tree(seed)
    states = root(*list(model.edges)[:3])
    before = states.tolist()
    config = SearchConfig(budget=6, epsilon=0.5, rollout=TO_THE_END)
    runs = [search(model, states, config, np.random.default_rng(seed)) for _ in range(2)]
    assert states.tolist() == before
    for a, b in zip(*runs, strict=True):
        assert a.action.tolist() == b.action.tolist()
        assert list(a.root.children) == list(b.root.children)
        assert explored(a) == explored(b)


def test_final_choice_is_random_with_epsilon_one() -> None:
    """A uniform *explored* child (protocol 11.3)."""
    counts = Counter(
        int(decide(THREE, seed, budget=2, epsilon=1.0).action[0]) - 7 for seed in range(600)
    )
    # Both the expansions and the choice are uniform: 200 each, standard deviation 11.5.
    assert set(counts) == {0, 1, 2}
    assert all(abs(n - 200) < 60 for n in counts.values())


def test_equal_values_are_chosen_at_random() -> None:
    """Protocol 11.3, ties random."""
    node = Node(None, legal=ActionValues(np.zeros((3, 3), np.int64), np.zeros(3), np.arange(3)))
    for key, total in enumerate((2.0, 2.0, 1.0)):
        node.children[key] = Node(None, visits=2, total=total)
    rng = np.random.default_rng(0)
    counts = Counter(final_key(node, SearchConfig(), rng) for _ in range(400))
    assert set(counts) == {0, 1}
    assert abs(counts[0] - 200) < 50


values_and_tried = st.integers(1, 12).flatmap(
    lambda n: st.tuples(
        st.permutations(range(n)),
        st.sets(st.integers(0, n - 1)),
        st.integers(0, n + 3),
        st.sampled_from([0.0, 0.2, 1.0]),
        st.integers(0, 999),
    )
)


@given(values_and_tried)
@settings(max_examples=150, deadline=None)
def test_expansions_never_repeat(drawn: tuple[Any, set[int], int, float, int]) -> None:
    """Protocol 11.2: untried actions only, as many as asked for or left; with epsilon 0 the
    best by Q, in order."""
    order, tried, count, epsilon, seed = drawn
    values, given_set = np.array(order, float), set(tried)
    chosen = epsilon_greedy_expansions(values, tried, count, epsilon, np.random.default_rng(seed))
    assert tried == given_set, "the caller's set is not touched"
    assert len(set(chosen)) == len(chosen) == min(count, len(values) - len(tried))
    assert not set(chosen) & tried
    if epsilon == 0:
        left = [n for n in np.argsort(-values) if n not in tried]
        assert chosen == left[:count]


def test_expansions_with_epsilon_one_are_uniform() -> None:
    """Every untried pair is equally likely, whatever the values."""
    values, rng = np.array([5.0, 4.0, 3.0, 2.0, 1.0]), np.random.default_rng(0)
    draws = 3000
    pairs = Counter(
        frozenset(epsilon_greedy_expansions(values, {2}, 2, 1.0, rng)) for _ in range(draws)
    )
    assert set(pairs) == {frozenset(p) for p in ((0, 1), (0, 3), (0, 4), (1, 3), (1, 4), (3, 4))}
    # 500 each; standard deviation 20.
    assert all(abs(n - draws / 6) < 100 for n in pairs.values())


def test_expansions_mix_at_the_given_rate() -> None:
    """The first draw is the best action with probability 1 - epsilon + epsilon / A."""
    values, rng = np.arange(4.0), np.random.default_rng(0)
    first = [epsilon_greedy_expansions(values, set(), 1, 0.4, rng)[0] for _ in range(4000)]
    assert np.mean(np.array(first) == 3) == pytest.approx(0.7, abs=0.03)


@pytest.mark.parametrize(
    "changes",
    [{"budget": -1}, {"epsilon": -0.1}, {"epsilon": 1.1}, {"epsilon": math.nan}, {"rollout": 0}],
    ids=str,
)
def test_config_refuses(changes: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=next(iter(changes))):
        SearchConfig(**changes)


# The same search over the real world.

TINY = Task("tiny", num_sides=1, grid=2, num_nodes=8)
"""Up to five blocks; rows with exactly three are picked below."""


def three_block_worlds(count: int) -> tuple[WorldModel, State]:
    simulator = Simulator(TINY)
    state = simulator.new(200, np.random.default_rng(5))
    # Worlds with a rewarding structure: more than the first block is needed.
    rows = np.flatnonzero(state.num_blocks == 3)[:count]
    assert len(rows) == count
    torch.manual_seed(1)
    network = QNetwork(NetworkConfig(width=16, heads=2, rounds=1, position_scale=0.1))
    return WorldModel(simulator, network), state.take(rows)


def enumerate_world(
    model: WorldModel, state: State, rollout: int
) -> dict[tuple[int, ...], tuple[float, int]]:
    """Mean return and visits of every root action when the whole tree is searched, prior off.

    Written out for three blocks, of which the first is placed: two placements, then the end.
    """
    simulator, gamma = model.simulator, model.discount
    out = {}
    for i, j, k in np.ndindex(2, 1, 5):
        after = state.copy()
        first = simulator.step(after, np.array([[i, j, k]]))
        returns = []
        if first.terminated[0]:
            returns.append(first.reward[0])
        else:
            second = []
            for j2, k2 in np.ndindex(2, 5):
                last = simulator.step(after.copy(), np.array([[0, j2, k2]]))
                assert last.terminated[0]
                second.append(float(last.reward[0]))
            q = model.action_values(after)[0].values
            estimate = q.max() if rollout == 1 else second[int(np.argmax(q))]
            returns.append(first.reward[0] + gamma * estimate)
            returns += [first.reward[0] + gamma * r for r in second]
        out[(i, j, k)] = (float(np.mean(returns)), len(returns))
    return out


@pytest.mark.parametrize("rollout", [1, 2, TO_THE_END])
def test_three_blocks_against_enumeration(rollout: int) -> None:
    """The whole tree of a real problem: visits, means and the choice; the world is untouched."""
    model, states = three_block_worlds(6)
    before = states.copy()
    config = SearchConfig(budget=1000, epsilon=0.0, rollout=rollout, prior=False)
    decisions = search(model, states, config, np.random.default_rng(0))
    for mine, theirs in zip(states, before, strict=True):
        np.testing.assert_array_equal(mine, theirs)
    going = 0
    for row, decision in enumerate(decisions):
        expected = enumerate_world(model, states.take(np.array([row])), rollout)
        got = {tuple(a.tolist()): (v, n) for a, v, n in decision.explored()}
        assert {a: n for a, (_, n) in got.items()} == {a: n for a, (_, n) in expected.items()}
        for action, (value, _) in expected.items():
            assert got[action][0] == pytest.approx(value, abs=1e-5)
        best = max(value for value, _ in expected.values())
        assert expected[tuple(decision.action.tolist())][0] == pytest.approx(best, abs=1e-5)
        going += sum(n > 1 for _, n in expected.values())
    assert going > 10, "the problems must not end at once"


def test_world_model_values_are_the_networks() -> None:
    """Local actions in order of (block, reference, relation), and ``best`` is their maximum."""
    model, states = three_block_worlds(4)
    value, action = model.best(states)
    for row, legal in enumerate(model.action_values(states)):
        assert legal.actions.tolist() == [[i, 0, k] for i in range(2) for k in range(5)]
        assert value[row] == pytest.approx(legal.values.max(), abs=1e-5)
        place = legal.actions.tolist().index(action[row].tolist())
        assert legal.values[place] == pytest.approx(value[row], abs=1e-5)


def test_world_model_steps_copies() -> None:
    model, states = three_block_worlds(4)
    before = states.copy()
    result = model.step(states, np.tile([0, 0, 1], (4, 1)))
    for mine, theirs in zip(states, before, strict=True):
        np.testing.assert_array_equal(mine, theirs)
    assert (result.states.num_placed == 2).all()
    both = model.join([states, result.states])
    assert both.num_placed.tolist() == [1] * 4 + [2] * 4
    taken = model.take(states, np.array([0, 0]))
    taken.position[:] = 9.0
    np.testing.assert_array_equal(states.position, before.position)


def test_groups_are_structures() -> None:
    """Two actions share a group exactly where the simulator puts the block into the same cell."""
    simulator, rng = (
        Simulator(Task("two", num_sides=2, grid=3, num_nodes=20)),
        np.random.default_rng(0),
    )
    state = simulator.new(12, rng)
    for relation in (1, 0, 4):
        # Left of the first block, on top of it, behind it: all stand.
        simulator.step(state, np.tile([0, 0, relation], (12, 1)))
    state = state.take(np.flatnonzero(~state.terminated & (state.num_placed == 4))[:3])
    assert state.batch_size == 3
    torch.manual_seed(0)
    model = WorldModel(simulator, QNetwork(NetworkConfig(width=16, heads=2, rounds=1)))
    for row, legal in enumerate(model.action_values(state)):
        many = state.take(np.full(len(legal.values), row))
        simulator.step(many, legal.actions)
        cells = [tuple(np.round(p, 4).tolist()) for p in many.position[:, 4]]
        assert len(set(legal.group.tolist())) == len(set(cells)) < 20
        assert len(set(zip(legal.group.tolist(), cells, strict=True))) == len(set(cells))
