"""The search: the published one and every variant, against trees worked out by hand and
against enumeration, of three blocks of real worlds, too."""

from __future__ import annotations

import dataclasses
import math
from collections import Counter
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from learn2assemble.errors import InputError, UnknownNameError
from learn2assemble.tasks.networks.agent import make_network
from learn2assemble.tasks.networks.config import NetworkConfig
from learn2assemble.tasks.networks.qnetwork import QNetwork
from learn2assemble.tasks.search.config import (
    SEARCHES,
    TO_THE_END,
    GumbelConfig,
    SearchConfig,
    training_search,
)
from learn2assemble.tasks.search.mcts import (
    completed_policy,
    epsilon_greedy_expansions,
    final_key,
    gumbel_scores,
    search,
)
from learn2assemble.tasks.search.tree import ActionValues, TreeNode
from learn2assemble.tasks.simulator import Simulator
from learn2assemble.tasks.task import Task
from learn2assemble.tasks.world.state import State
from learn2assemble.tasks.world_model import WorldModel
from learning_data import (
    THREE,
    Edge,
    TreeModel,
    advance,
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


UCT = {"expansion": "uct", "prior": False, "repeats": True}

BANDIT = TreeModel(
    {
        "root": [Edge(0.0, 1.0, None), Edge(0.0, 0.0, "A")],
        "A": [Edge(0.8, 2.0, None)],
    }
)


@pytest.mark.parametrize(
    ("budget", "expected"),
    [
        # Untried ones first: 1, and 0.5 * Q(A) = 0.4.
        (2, {0: (1.0, 1), 1: (0.4, 1)}),
        # With c = 1, the sums of mean and bonus: 1 + 0.833 against 0.4 + 0.833.
        (3, {0: (1.0, 2), 1: (0.4, 1)}),
        # 1 + 0.741 against 0.4 + 1.048.
        (4, {0: (1.0, 3), 1: (0.4, 1)}),
        # 1 + 0.680 against 0.4 + 1.177.
        (5, {0: (1.0, 4), 1: (0.4, 1)}),
        # 1 + 0.634 against 0.4 + 1.269: down to A, whose only action returns 2, worth 0.5 * 2.
        (6, {0: (1.0, 4), 1: (0.7, 2)}),
    ],
)
def test_golden_tree_of_plain_uct(budget: int, expected: dict[int, tuple[float, int]]) -> None:
    """Mean + c sqrt(ln n(root) / n(child)); ends count again."""
    decision = decide(BANDIT, budget=budget, exploration=1.0, **UCT)
    assert explored(decision) == expected
    assert decision.root.visits == budget
    assert decision.action[0] == 7


def test_depth_one_simulates_the_same_edge_again() -> None:
    """As above, but the sixth simulation may not go down to A: it repeats the step, 0.4 again."""
    decision = decide(BANDIT, budget=6, exploration=1.0, depth=1, **UCT)
    assert explored(decision) == {0: (1.0, 4), 1: (0.4, 2)}
    assert size(decision.root) == 2


def test_uct_with_prior_goes_deep_before_all_is_tried() -> None:
    """Untried actions compete with visit count 1 and mean Q; c = 0.1.

    First Q = 1 brings (1 + 0) / 2; then Q = 0.9 brings 0.9 twice over, and the third action
    (Q = 0.2) is never tried.
    """
    model = TreeModel({"root": [Edge(1.0, 0.0, None), Edge(0.9, 0.9, None), Edge(0.2, 5.0, None)]})
    for budget, expected in (
        (1, {0: (0.5, 2)}),
        (2, {0: (0.5, 2), 1: (0.9, 2)}),
        (3, {0: (0.5, 2), 1: (0.9, 3)}),
    ):
        decision = decide(model, budget=budget, expansion="uct", repeats=True, exploration=0.1)
        assert explored(decision) == expected


@given(seed=st.integers(0, 10_000), budget=st.integers(1, 3), epsilon=st.sampled_from([0.0, 1.0]))
@settings(max_examples=40, deadline=None)
def test_eps_mcts_expands_the_best_by_q(seed: int, budget: int, epsilon: float) -> None:
    """UCT without repeats: the deterministic top B by Q, whatever epsilon is."""
    model = random_tree(seed)
    q = [edge.q for edge in model.edges["root"]]
    config = dataclasses.replace(
        SEARCHES["eps-mcts"], budget=budget, epsilon=epsilon, random_first=False
    )
    decision = search(model, root(), config, np.random.default_rng(seed))[0]
    assert list(decision.root.children)[: len(q)] == np.argsort([-v for v in q])[:budget].tolist()
    if budget <= len(q):
        greedy = decide(model, budget=budget)
        assert explored(decision) == explored(greedy)


def test_random_first_acts_without_search() -> None:
    """Eps-MCTS: at the rate epsilon a uniform action and nothing explored."""
    model = random_tree(3)
    width = len(model.edges["root"])
    assert width > 1
    config = dataclasses.replace(SEARCHES["eps-mcts"], budget=1, epsilon=0.4)
    decisions = search(model, root(*["root"] * 3000), config, np.random.default_rng(0))
    blind = [d for d in decisions if not d.explored()]
    assert len(blind) / 3000 == pytest.approx(0.4, abs=0.04)
    assert all(d.random for d in blind)
    counts = Counter(int(d.action[0]) - 7 for d in blind)
    assert all(abs(counts[n] - len(blind) / width) < 120 for n in range(width))
    # The only explored child is the best by Q, whichever way it is chosen.
    best = int(np.argmax([edge.q for edge in model.edges["root"]]))
    assert {int(d.action[0]) - 7 for d in decisions if d.explored()} == {best}


WIDE = TreeModel(
    {
        "root": [Edge(1.0, 0.0, "A"), Edge(0.5, 0.2, None), Edge(0.1, 5.0, None)],
        "A": [Edge(0.8, 0.0, None), Edge(0.6, 1.0, None)],
    }
)


@pytest.mark.parametrize(
    ("backup", "budget", "expected"),
    [
        # Room for ceil(sqrt(n + 1)) children: 1, 2, 2, 2, 3. a: 0.5 * 0.8; b: 0.2.
        ("mean", 2, {0: (0.4, 1), 1: (0.2, 1)}),
        # Down to x: a = (0.4 + 0.5 * 0) / 2.
        ("mean", 3, {0: (0.2, 2), 1: (0.2, 1)}),
        # Down to y: (0.4 + 0 + 0.5) / 3.
        ("mean", 4, {0: (0.3, 3), 1: (0.2, 1)}),
        # The third child of the root.
        ("mean", 5, {0: (0.3, 3), 1: (0.2, 1), 2: (5.0, 1)}),
        # The largest below: Q(y) = 0.6 once x turns out to be 0, then y's 1.
        ("max", 3, {0: (0.3, 2), 1: (0.2, 1)}),
        ("max", 4, {0: (0.5, 3), 1: (0.2, 1)}),
    ],
)
def test_golden_tree_of_progressive_widening(
    backup: str, budget: int, expected: dict[int, tuple[float, int]]
) -> None:
    decision = decide(WIDE, budget=budget, prior=False, widening=0.5, backup=backup)
    assert explored(decision) == expected


def test_max_backup_keeps_the_prior_as_one_vote() -> None:
    """a: (Q + r + gamma max) / 2 with Q = 1 and A worth 0.8, 0.6, then (0.6 + 1) / 2 for y."""
    values = [
        explored(decide(WIDE, budget=budget, widening=0.5, backup="max"))[0][0]
        for budget in (1, 3, 4)
    ]
    # Below A: x is worth (0.8 + 0) / 2 = 0.4, so Q(y) = 0.6 leads; then y is (0.6 + 1) / 2.
    assert values == pytest.approx([0.7, (1 + 0.3) / 2, (1 + 0.4) / 2])


@given(
    seed=st.integers(0, 10_000),
    widening=st.sampled_from([0.3, 0.6, 1.0]),
    expansion=st.sampled_from(["epsilon-greedy", "uct"]),
)
@settings(max_examples=60, deadline=None)
def test_whole_tree_with_max_backup_is_exact(seed: int, widening: float, expansion: str) -> None:
    """Every edge once, the largest below: the exhaustive optimum of every root action."""
    model = random_tree(seed)
    actions = sum(len(edges) for edges in model.edges.values())
    decision = decide(
        model,
        budget=10 * actions,
        prior=False,
        backup="max",
        widening=widening,
        expansion=expansion,
    )
    assert size(decision.root) == actions
    for key, edge in enumerate(model.edges["root"]):
        later = 0.0 if edge.to is None else model.discount * best_return(model, edge.to)[0]
        assert decision.root.children[key].value == pytest.approx(edge.reward + later)
    assert decision.action[0] - 7 == best_return(model, "root")[1]


def random_return(model: TreeModel, state: str, action: int) -> tuple[float, float]:
    """Mean and largest size of the return of ``action`` and uniformly random play to the end."""
    edge = model.edges[state][action]
    if edge.to is None:
        return edge.reward, abs(edge.reward)
    later = [random_return(model, edge.to, n) for n in range(len(model.edges[edge.to]))]
    mean, bound = np.mean([m for m, _ in later]), max(b for _, b in later)
    return edge.reward + model.discount * float(mean), abs(edge.reward) + model.discount * bound


@pytest.mark.parametrize("seed", range(4))
def test_random_rollouts_against_enumeration(seed: int) -> None:
    """The mean over many rollouts to the end is the expected return of random play."""
    model, count = random_tree(seed), 1500
    width = len(model.edges["root"])
    config = SearchConfig(
        budget=width,
        epsilon=0.0,
        expansion="uct",
        prior=False,
        rollout=TO_THE_END,
        rollout_policy="random",
    )
    decisions = search(model, root(*["root"] * count), config, np.random.default_rng(0))
    for action in range(width):
        values = np.array([d.root.children[action].value for d in decisions])
        expected, bound = random_return(model, "root", action)
        assert values.mean() == pytest.approx(expected, abs=5 * bound / count**0.5 + 1e-9)
        assert all(d.root.children[action].visits == 1 for d in decisions[:5])


class Counting:
    """Counts the calls of a model."""

    def __init__(self, model: TreeModel) -> None:
        self.model, self.discount, self.calls = model, model.discount, Counter[str]()

    def __getattr__(self, name: str) -> Any:
        def call(*arguments: Any) -> Any:
            self.calls[name] += 1
            return getattr(self.model, name)(*arguments)

        return call


@pytest.mark.parametrize("name", ["dqn-mcts", "eps-mcts", "distinct"])
def test_one_level_of_many_roots_is_one_step_and_two_evaluations(name: str) -> None:
    model = Counting(
        TreeModel({"root": [Edge(n / 9, 0.1, "A") for n in range(9)], "A": [Edge(0.0, 0.0, None)]})
    )
    config = dataclasses.replace(SEARCHES[name], budget=7)
    search(model, root(*["root"] * 20), config, np.random.default_rng(0))
    assert {k: model.calls[k] for k in ("action_values", "step", "best")} == {
        "action_values": 1,
        "step": 1,
        "best": 1,
    }


def test_plain_uct_never_looks_at_q() -> None:
    model = Counting(random_tree(1))
    config = dataclasses.replace(SEARCHES["uct"], budget=60)
    search(model, root("root", "root"), config, np.random.default_rng(0))
    assert model.calls["legal"] > 0
    assert model.calls["action_values"] == model.calls["best"] == 0


# Gumbel.

EIGHT = TreeModel({"root": [Edge(0.0, 0.1 * ((3 * n) % 8), None) for n in range(8)]})
"""Equal Q, rewards 0, 0.3, 0.6, 0.1, 0.4, 0.7, 0.2, 0.5."""


@pytest.mark.parametrize(
    ("budget", "considered", "visits"),
    [
        # Three phases: 8 once, 4 twice, 2 four times.
        (24, 8, [1, 1, 7, 1, 3, 7, 1, 3]),
        # Two phases: the first 4 once, 2 twice, and the rest of the budget for both.
        (10, 4, [1, 4, 4, 1, 0, 0, 0, 0]),
        # Fewer simulations than actions considered: each of the first three once.
        (3, 8, [1, 1, 1, 0, 0, 0, 0, 0]),
    ],
)
def test_sequential_halving(budget: int, considered: int, visits: list[int]) -> None:
    gumbel = GumbelConfig(considered=considered)
    decision = decide(
        EIGHT, budget=budget, expansion="gumbel", prior=False, final="gumbel", gumbel=gumbel
    )
    found = explored(decision)
    assert [found[n][1] if n in found else 0 for n in range(8)] == visits
    rewards = [edge.reward for edge in EIGHT.edges["root"]]
    most = [n for n in range(8) if visits[n] == max(visits)]
    assert decision.action[0] - 7 == max(most, key=lambda n: rewards[n])


def test_gumbel_scores_by_hand() -> None:
    """``logits + (c + max visits) * scale * q`` with q scaled to 0..1; softmax of it."""
    model = TreeModel({"root": [Edge(1.0, 0.0, None), Edge(0.0, 2.0, None), Edge(0.5, 9.0, None)]})
    gumbel = GumbelConfig(considered=2, temperature=2.0, value_scale=0.1, visit_offset=4.0)
    config = SearchConfig(
        budget=2, epsilon=0.0, expansion="gumbel", prior=False, final="gumbel", gumbel=gumbel
    )
    decision = search(model, root(), config, np.random.default_rng(0))[0]
    # Considered are Q = 1 and Q = 0.5; completed Q: 0, 0 (never simulated), 9.
    expected = np.array([0.5, 0.0, 0.25]) + (4 + 1) * 0.1 * np.array([0.0, 0.0, 1.0])
    np.testing.assert_allclose(gumbel_scores(decision.root, config), expected)
    np.testing.assert_allclose(
        completed_policy(decision.root, config), np.exp(expected) / np.exp(expected).sum()
    )
    assert decision.action[0] == 9


def test_gumbel_noise_samples_the_softmax() -> None:
    """The Gumbel-max trick: one simulation goes to an action drawn from softmax(logits)."""
    q = np.array([1.0, 0.0, 0.5])
    model = TreeModel({"root": [Edge(float(v), 0.0, None) for v in q]})
    config = SearchConfig(
        budget=1, epsilon=0.0, expansion="gumbel", final="gumbel", gumbel=GumbelConfig(noise=True)
    )
    decisions = search(model, root(*["root"] * 4000), config, np.random.default_rng(0))
    counts = np.bincount([int(d.action[0]) - 7 for d in decisions], minlength=3)
    np.testing.assert_allclose(counts / 4000, np.exp(q) / np.exp(q).sum(), atol=0.03)


def test_gumbel_visits_below_the_root() -> None:
    """One way down to A, where the first simulation finds 1; its visits then follow
    ``policy - visits / (1 + sum)``: the policy is all but certain, so every visit goes there."""
    model = TreeModel(
        {"root": [Edge(0.0, 0.0, "A")], "A": [Edge(0.0, 1.0, None), Edge(0.0, 0.0, None)]}
    )
    for backup, value in (("mean", (0 + 3 * 0.5) / 4), ("max", 0.5)):
        decision = decide(model, budget=4, expansion="gumbel", prior=False, backup=backup)
        assert explored(decision) == {0: (value, 4)}
        below = decision.root.children[0].children
        assert {key: child.visits for key, child in below.items()} == {0: 3}


# What holds for all.

VARIANTS = {
    "uct": {"expansion": "uct", "repeats": True},
    "widening": {"expansion": "uct", "widening": 0.5, "backup": "max"},
    "greedy, repeats": {"repeats": True, "widening": 0.7},
    "gumbel": {"expansion": "gumbel", "final": "gumbel", "backup": "max"},
    "depth 2": {"expansion": "uct", "depth": 2},
}


@pytest.mark.parametrize("name", VARIANTS)
@given(seed=st.integers(0, 10_000), budget=st.integers(1, 12))
@settings(max_examples=15, deadline=None)
def test_variants_keep_roots_apart_and_their_books(name: str, seed: int, budget: int) -> None:
    """One call with many roots equals one each; visits add up to the simulations made."""
    model = random_tree(seed)
    names = list(model.edges)[:4]
    config = SearchConfig(budget=budget, epsilon=0.0, **VARIANTS[name])
    together = search(model, root(*names), config, np.random.default_rng(0))
    for start, decision in zip(names, together, strict=True):
        alone = search(model, root(start), config, np.random.default_rng(0))[0]
        assert decision.action.tolist() == alone.action.tolist()
        assert explored(decision) == explored(alone)
        if config.repeats or config.expansion == "gumbel":
            assert decision.root.visits == budget
        assert_books(decision.root, config)


def assert_books(node: TreeNode, config: SearchConfig, level: int = 0) -> None:
    assert level <= config.depth
    if node.legal is None:
        return
    passed = sum(child.visits - 1 for child in node.children.values())
    assert node.below == passed, "every simulation that left the node is in one child"
    for key, child in node.children.items():
        assert child.key == key
        assert node.estimates[key] == child.value
        assert node.counts[key] == child.visits
        assert node.simulated[key] == child.visits - 1
        assert_books(child, config, level + 1)
    for key in set(range(len(node.actions.values))) - set(node.children):
        assert node.estimates[key] == node.actions.values[key]
        assert node.counts[key] == 0


def test_final_choices() -> None:
    """``best-mean`` and ``most-visits`` differ; equal visits are parted by the mean."""
    node = TreeNode(None)
    for key, (visits, total) in enumerate(((1, 3.0), (4, 4.0), (4, 6.0))):
        node.children[key] = TreeNode(None, key=key, visits=visits, total=total)
    rng = np.random.default_rng(0)
    assert final_key(node, SearchConfig(final="best-mean"), rng) == 0
    assert final_key(node, SearchConfig(final="most-visits"), rng) == 2


def test_named_searches() -> None:
    """The published searches by name."""
    assert SEARCHES["dqn-mcts"] == SEARCHES["q-mcts"] == SearchConfig()
    uct = SEARCHES["uct"]
    assert (uct.budget, uct.exploration, uct.prior, uct.repeats) == (1000, 2.0, False, True)
    assert (uct.rollout, uct.rollout_policy) == (TO_THE_END, "random")
    training = training_search("eps-mcts", 5, 0.3)
    assert (training.budget, training.epsilon, training.rollout) == (5, 0.3, 1)
    assert training.random_first
    assert not training.repeats
    with pytest.raises(UnknownNameError, match="did you mean 'gumbel'"):
        SEARCHES["gumbl"]


@pytest.mark.parametrize("name", SEARCHES)
def test_named_searches_play(name: str) -> None:
    model = random_tree(5)
    config = dataclasses.replace(SEARCHES[name], budget=min(SEARCHES[name].budget, 30))
    decisions = search(model, root("root", "root"), config, np.random.default_rng(0))
    assert all(0 <= d.action[0] - 7 < len(model.edges["root"]) for d in decisions)


@pytest.mark.parametrize(
    "changes",
    [
        {"budget": -1},
        {"epsilon": -0.1},
        {"epsilon": 1.1},
        {"epsilon": math.nan},
        {"rollout": 0},
        {"expansion": "uctt"},
        {"exploration": -1.0},
        {"widening": 0.0},
        {"widening": 1.5},
        {"depth": 0},
        {"rollout_policy": "best"},
        {"backup": "min"},
        {"final": "first"},
        {"final": "gumbel"},
    ],
    ids=str,
)
def test_config_refuses(changes: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=next(iter(changes))):
        SearchConfig(**changes)


@pytest.mark.parametrize(
    "changes",
    [
        {"considered": 0},
        {"temperature": 0.0},
        {"value_scale": float("nan")},
        {"visit_offset": -1.0},
    ],
    ids=str,
)
def test_gumbel_config_refuses(changes: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=next(iter(changes))):
        GumbelConfig(**changes)


# ---------------------------------------------------------------- real worlds


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


def walls(task: Task, count: int = 60, placements: int = 3) -> tuple[WorldModel, State]:
    """Worlds after some random valid placements."""
    simulator, rng = Simulator(task), np.random.default_rng(1)
    state = advance(simulator, simulator.new(count, rng), placements, rng)
    torch.manual_seed(0)
    return WorldModel(simulator, QNetwork(NetworkConfig(width=16, heads=2, rounds=1))), state


def test_parts_of_a_forward_pass_agree(monkeypatch: pytest.MonkeyPatch) -> None:
    """More graphs than one part holds give the values of a single pass."""
    model, state = walls(TINY.replace(num_sides=2, num_nodes=20, grid=3), 30)
    whole = [model.best(state)[0], *[v.values for v in model.action_values(state)]]
    monkeypatch.setattr("learn2assemble.tasks.world_model.PART", 7)
    parts = [model.best(state)[0], *[v.values for v in model.action_values(state)]]
    for mine, theirs in zip(whole, parts, strict=True):
        np.testing.assert_allclose(mine, theirs, atol=1e-5)


@pytest.mark.parametrize("encoder", ["attention", "relational"])
def test_values_are_kept(encoder: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Graphs that were valued are not valued again, unless the network learns or they are many."""
    world, state = walls(TINY.replace(num_sides=2, num_nodes=20, grid=3), 30)
    simulator = world.simulator
    network = make_network(NetworkConfig(width=16, heads=2, rounds=1, encoder=encoder))
    calls: list[int] = []
    network.register_forward_pre_hook(lambda _, given: calls.append(len(given[0].nodes)))

    def values(model: WorldModel, rows: list[int]) -> np.ndarray:
        found = model.action_values(state.take(np.array(rows)))
        return np.concatenate([v.values for v in found])

    def fresh(rows: list[int]) -> np.ndarray:
        return values(WorldModel(simulator, network), rows)

    model = WorldModel(simulator, network.eval())
    model.best(state.take(np.arange(20)))
    expected = fresh([3, 25, 19])
    calls.clear()
    np.testing.assert_allclose(values(model, [3, 25, 19]), expected, atol=1e-5)
    np.testing.assert_allclose(values(model, [3, 25, 19]), expected, atol=1e-5)
    assert calls == [1], "only the one that is new"
    monkeypatch.setattr("learn2assemble.tasks.world_model.MEMORY", 2)
    values(model, [25])
    values(model, [25, 3])
    assert calls == [1, 1], "the latest are kept"
    network.train()
    values(model, [3])
    with torch.no_grad():
        for weight in network.parameters():
            weight += 0.1
    np.testing.assert_allclose(values(model, [3]), fresh([3]), atol=1e-5)


def test_legal_and_random_actions() -> None:
    model, state = walls(TINY.replace(num_sides=2, num_nodes=20, grid=3), 6)
    for mine, theirs in zip(model.legal(state), model.action_values(state), strict=True):
        np.testing.assert_array_equal(mine.actions, theirs.actions)
        np.testing.assert_array_equal(mine.group, theirs.group)
        assert not mine.values.any()
    many = state.take(np.zeros(3000, np.int64))
    drawn = model.random_actions(many, np.random.default_rng(0))
    counts = (int(state.num_unplaced[0]), int(state.num_placed[0]), 5)
    for column, count in zip(drawn.T, counts, strict=True):
        found = np.bincount(column, minlength=count)
        assert len(found) == count
        assert (np.abs(found - 3000 / count) < 5 * (3000 / count) ** 0.5).all()
