"""The published search: golden trees by hand, enumeration, expansion rule, determinism."""

from __future__ import annotations

import math
from collections import Counter
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from learn2assemble.errors import InputError
from learn2assemble.tasks.search.config import TO_THE_END, SearchConfig
from learn2assemble.tasks.search.mcts import epsilon_greedy_expansions, final_key, search
from learn2assemble.tasks.search.tree import ActionValues, TreeNode
from search_data import (
    THREE,
    Edge,
    TreeModel,
    best_return,
    decide,
    explored,
    explored_actions,
    greedy_return,
    random_tree,
    root,
    size,
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
    """Visits and values computed by hand."""
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
    """Once every root action is tried, one expansion at a time goes below."""
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

    def check(node: TreeNode) -> None:
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
    """A uniform *explored* child."""
    counts = Counter(
        int(decide(THREE, seed, budget=2, epsilon=1.0).action[0]) - 7 for seed in range(600)
    )
    # Both the expansions and the choice are uniform: 200 each, standard deviation 11.5.
    assert set(counts) == {0, 1, 2}
    assert all(abs(n - 200) < 60 for n in counts.values())


def test_equal_values_are_chosen_at_random() -> None:
    """Ties at random."""
    node = TreeNode(None, legal=ActionValues(np.zeros((3, 3), np.int64), np.zeros(3), np.arange(3)))
    for key, total in enumerate((2.0, 2.0, 1.0)):
        node.children[key] = TreeNode(None, visits=2, total=total)
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
    """Untried actions only, as many as asked for or left; with epsilon 0 the
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
