"""Every variant of the search against trees worked out by hand, and against enumeration."""

from __future__ import annotations

import dataclasses
from collections import Counter
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from learn2assemble.errors import InputError, UnknownNameError
from learn2assemble.tasks.search.config import (
    SEARCHES,
    TO_THE_END,
    GumbelConfig,
    SearchConfig,
    training_search,
)
from learn2assemble.tasks.search.mcts import completed_policy, final_key, gumbel_scores, search
from learn2assemble.tasks.search.tree import TreeNode
from search_data import Edge, TreeModel, best_return, decide, explored, random_tree, root, size

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
