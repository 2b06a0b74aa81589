"""The Q-network: sizes, symmetries, connectivity, the factored read-out, rotation, arguments."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from learn2assemble.errors import InputError
from learn2assemble.tasks.graph.batch import GraphTensors, to_tensors
from learn2assemble.tasks.graph.features import Graph, connectivity
from learn2assemble.tasks.networks.config import NetworkConfig
from learn2assemble.tasks.networks.qnetwork import (
    ROTARY,
    AttentionRound,
    QFactors,
    QNetwork,
    Rotation,
    barred,
)

torch.set_num_threads(1)

SMALL: dict[str, Any] = {"width": 16, "heads": 2, "rounds": 2}
VARIANTS: list[dict[str, Any]] = [
    {},
    {"connectivity": "full"},
    {"feed_forward": "wide"},
    {"feed_forward": "none"},
    {"rotary": True},
    {"encoder": "s2v"},
    {"encoder": "s2v", "connectivity": "full"},
    {"rotary": True, "connectivity": "full", "position_scale": 0.1},
]


def network(seed: int = 0, **changes: Any) -> QNetwork:
    torch.manual_seed(seed)
    return QNetwork(NetworkConfig(**{**SMALL, **changes})).double()


def random_graph(counts: list[tuple[int, int, int]], num_nodes: int, seed: int) -> Graph:
    """Rows with (targets, placed, unplaced) nodes at random places; pairs of blocks are objects."""
    rng = np.random.default_rng(seed)
    nodes = np.zeros((len(counts), num_nodes, 5), np.float32)
    object_id = np.full((len(counts), num_nodes), -1, np.int32)
    for row, (targets, placed, unplaced) in enumerate(counts):
        used = targets + placed + unplaced
        nodes[row, :used, :3] = rng.uniform(-0.5, 0.5, (used, 3))
        nodes[row, :used, 3] = np.where(np.arange(used) < targets + placed, 1, -1)
        nodes[row, :used, 4] = np.where(np.arange(used) < targets, 1, -1)
        object_id[row, targets:used] = np.arange(placed + unplaced) // 2
    t, p, u = np.array(counts, np.int64).T
    return Graph(nodes, object_id, t, p, t + p + u)


def tensors(graph: Graph) -> GraphTensors:
    """The graph with nodes in double precision, so that tests compare to 1e-9."""
    out = to_tensors(graph)
    return out._replace(nodes=out.nodes.double())


counts_of_rows = st.lists(
    st.tuples(st.integers(3, 5), st.integers(1, 4), st.integers(1, 5)), min_size=1, max_size=3
)
few = settings(max_examples=15, deadline=None)


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"feed_forward": "wide", "heads": 4}, 252_869),
        ({"feed_forward": "wide", "heads": 1}, 252_869),
        ({"feed_forward": "wide", "heads": 4, "num_actions": 20}, 255_764),
        ({"feed_forward": "wide", "heads": 1, "num_actions": 20}, 255_764),
        ({"feed_forward": "none"}, 54_533),
        ({"feed_forward": "none", "rotary": True}, 54_533),
        # One 64 -> 64 layer with bias a round: 54 533 + 3 * 4160.
        ({"feed_forward": "light"}, 67_013),
        # Structure2Vec has neither heads nor a feed-forward.
        ({"encoder": "s2v"}, 59_007),
        ({"encoder": "s2v", "heads": 1, "feed_forward": "wide"}, 59_007),
    ],
)
def test_number_of_parameters(changes: dict[str, Any], expected: int) -> None:
    """Parameter counts (F = 64, L = 3)."""
    net = QNetwork(NetworkConfig(**changes))
    assert sum(p.numel() for p in net.parameters()) == expected


@pytest.mark.parametrize("changes", VARIANTS, ids=str)
def test_no_parameter_is_dead(changes: dict[str, Any]) -> None:
    """A gradient reaches every tensor, so none is forgotten in the forward pass."""
    net = network(**changes)
    graph = tensors(random_graph([(3, 2, 3), (4, 1, 2)], 9, 0))
    net(graph).dense().square().sum().backward()
    for name, parameter in net.named_parameters():
        assert parameter.grad is not None, name
        assert parameter.grad.abs().max() > 0, name


def test_initialisation_of_the_attention() -> None:
    """U(+-1/sqrt(head size)) for Q, K, V and U(+-1/sqrt(F)) for the output."""
    torch.manual_seed(0)
    layer = AttentionRound(64, 4, "none")
    for parameter, bound in ((layer.query_key_value.weight, 1 / 4), (layer.merge.weight, 1 / 8)):
        weight = parameter.detach()
        assert float(weight.abs().max()) <= bound
        assert float(weight.std()) == pytest.approx(bound / math.sqrt(3), rel=0.05)


@pytest.mark.parametrize("changes", VARIANTS, ids=str)
@given(counts=counts_of_rows, seed=st.integers(0, 99))
@few
def test_permuting_nodes_permutes_q(
    changes: dict[str, Any], counts: list[tuple[int, int, int]], seed: int
) -> None:
    """The order within targets, placed and unplaced blocks carries no meaning."""
    net, graph = network(seed, **changes), random_graph(counts, 14, seed)
    rng = np.random.default_rng(seed)
    order = np.tile(np.arange(14), (len(counts), 1))
    for row, (t, p, u) in enumerate(counts):
        for low, high in ((0, t), (t, t + p), (t + p, t + p + u)):
            order[row, low:high] = low + rng.permutation(high - low)
    rows = np.arange(len(counts))[:, None]
    shuffled = graph._replace(
        nodes=graph.nodes[rows, order], object_id=graph.object_id[rows, order]
    )
    q, permuted = net(tensors(graph)).dense(), net(tensors(shuffled)).dense()
    index = torch.from_numpy(order)
    for row in range(len(counts)):
        expected = q[row][index[row]][:, index[row]]
        used = int(graph.num_nodes[row])
        torch.testing.assert_close(
            permuted[row, :used, :used], expected[:used, :used], rtol=0, atol=1e-9
        )


@pytest.mark.parametrize("changes", VARIANTS, ids=str)
@given(counts=counts_of_rows, seed=st.integers(0, 99), extra=st.integers(1, 9))
@few
def test_padding_changes_nothing(
    changes: dict[str, Any], counts: list[tuple[int, int, int]], seed: int, extra: int
) -> None:
    """Q on its own, in a batch with others and with more padding are the same."""
    net = network(seed, **changes)
    graph = random_graph(counts, 14, seed)
    wide = random_graph(counts, 14 + extra, seed)
    for field in ("nodes", "object_id"):
        getattr(wide, field)[:, :14] = getattr(graph, field)
    q, padded = net(tensors(graph)), net(tensors(wide))
    for row, used in enumerate(graph.num_nodes):
        alone = graph.take(np.array([row]))
        alone = alone._replace(nodes=alone.nodes[:, :used], object_id=alone.object_id[:, :used])
        expected = net(tensors(alone)).dense()[0]
        for other in (q, padded):
            got = other.dense()[row, :used, :used]
            torch.testing.assert_close(got, expected, rtol=0, atol=1e-9)
    best, action = q.best(tensors(graph))
    best_padded, action_padded = padded.best(tensors(wide))
    torch.testing.assert_close(best, best_padded, rtol=0, atol=1e-9)
    assert action.tolist() == action_padded.tolist()


@given(counts=counts_of_rows, seed=st.integers(0, 999), num_actions=st.sampled_from([1, 5, 20]))
@settings(max_examples=40, deadline=None)
def test_best_is_the_maximum_over_legal_pairs(
    counts: list[tuple[int, int, int]], seed: int, num_actions: int
) -> None:
    """Brute force over every (i, j, k) with the masks; ``select`` and ``dense`` agree."""
    generator = torch.Generator().manual_seed(seed)
    batch, n = len(counts), 14

    def draw(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=generator, dtype=torch.float64)

    factors = QFactors(
        draw(batch, n, num_actions), draw(batch, n, num_actions), draw(batch, num_actions)
    )
    graph = to_tensors(random_graph(counts, n, seed))
    dense = factors.dense()
    value, action = factors.best(graph)
    for row, (t, p, u) in enumerate(counts):
        legal = [
            (i, j, k)
            for i in range(t + p, t + p + u)
            for j in range(t, t + p)
            for k in range(num_actions)
        ]
        brute = max(float(dense[row][a]) for a in legal)
        assert float(value[row]) == pytest.approx(brute, abs=1e-12)
        assert tuple(action[row].tolist()) in legal
        for a in legal:
            # float[1] of this row only: select takes one action a row.
            one = QFactors(*[f[row : row + 1] for f in factors]).select(torch.tensor([a]))
            assert float(one[0]) == pytest.approx(float(dense[row][a]), abs=1e-12)
    torch.testing.assert_close(factors.select(action), value, rtol=0, atol=1e-12)


def test_best_without_a_legal_action_is_far_below() -> None:
    graph = random_graph([(3, 2, 0), (3, 2, 1)], 7, 0)
    net = network()
    value, _ = net(tensors(graph)).best(tensors(graph))
    assert float(value[0].detach()) < -1e8 < float(value[1].detach())


@pytest.mark.parametrize("changes", VARIANTS, ids=str)
def test_read_out_is_the_published_form(changes: dict[str, Any]) -> None:
    """``Q(i, j, :) = W_o ReLU([p, h_i, h_j]) + b`` formed naively (equation 5)."""
    net = network(3, **changes)
    counts = [(3, 2, 2), (4, 1, 3)]
    graph = tensors(random_graph(counts, 9, 1))
    with torch.no_grad():
        h, dense = net.encode(graph), net(graph).dense()
        weight, bias = net.readout.weight, net.readout.bias
        for row, triple in enumerate(counts):
            used = sum(triple)
            pooled = net.pool.weight @ h[row, :used].mean(0)
            for i in range(used):
                for j in range(used):
                    x = torch.relu(torch.cat([pooled, h[row, i], h[row, j]]))
                    torch.testing.assert_close(
                        dense[row, i, j], weight @ x + bias, rtol=0, atol=1e-10
                    )


def _attention_by_hand(layer: AttentionRound, x: torch.Tensor, adjacency: np.ndarray) -> Any:
    """Multi-head attention with loops (equations 2 to 4): float[N, F]."""
    n, width = x.shape
    size = layer.head_size
    parts = layer.query_key_value.weight.reshape(3, layer.heads, size, width)
    out = torch.zeros_like(x)
    for i in range(n):
        heads = []
        for head in range(layer.heads):
            q, k, v = (parts[which, head] @ x.T for which in range(3))
            seen = np.flatnonzero(adjacency[i])
            score = torch.stack([q[:, i] @ k[:, j] / math.sqrt(size) for j in seen])
            share = torch.softmax(score, 0)
            heads.append(sum(share[m] * v[:, j] for m, j in enumerate(seen)))
        out[i] = x[i] + layer.merge.weight @ torch.cat(heads)
    return out


@pytest.mark.parametrize("kind", ["partial", "full"])
def test_attention_round_written_out(kind: str) -> None:
    torch.manual_seed(2)
    layer = AttentionRound(8, 2, "none").double()
    graph = random_graph([(3, 1, 3)], 7, 5)
    x = torch.randn(1, 7, 8, dtype=torch.float64)
    with torch.no_grad():
        got = layer(x, barred(to_tensors(graph).adjacency(kind), 2, x))
        expected = _attention_by_hand(layer, x[0], connectivity(graph, kind)[0])
    torch.testing.assert_close(got[0], expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("kind", ["partial", "full"])
def test_structure2vec_written_out(kind: str) -> None:
    """Structure2Vec, pair by pair and without the shortcut that A_ij is 0 or 1."""
    net = network(5, encoder="s2v", connectivity=kind)
    (t, p, u), used = (3, 2, 4), 9
    raw = random_graph([(t, p, u)], 11, 6)
    graph = tensors(raw)
    a = connectivity(raw, kind)[0][:used, :used].astype(float)
    assert net.edges is not None
    with torch.no_grad():
        x = (graph.nodes[0] * net.scale)[:used]
        h = torch.relu(x @ net.embed.weight.T)
        count = [sum(a[j][i] for j in range(used)) for i in range(used)]
        e = []
        for i in range(used):
            total = torch.zeros(SMALL["width"] - 1, dtype=torch.float64)
            for j in range(used):
                pair = torch.cat([torch.tensor([a[i, j]]), x[j]]) * a[i, j]
                total = total + torch.relu(net.edges.pair.weight @ pair)
            degree = torch.tensor([count[i] / max(count)], dtype=torch.float64)
            row = torch.cat([total / count[i], degree])
            e.append(torch.relu(net.edges.merge.weight @ row))
        for layer in net.rounds:
            after = []
            for i in range(used):
                near = sum(a[i, j] * h[j] for j in range(used)) / count[i]
                m = torch.relu(layer.message.weight @ torch.cat([near, e[i]]))
                after.append(torch.relu(layer.update.weight @ torch.cat([h[i], m])))
            h = torch.stack(after)
        torch.testing.assert_close(net.encode(graph)[0, :used], h, rtol=0, atol=1e-10)


@pytest.mark.parametrize("kind", ["partial", "full"])
@given(counts=counts_of_rows, seed=st.integers(0, 99))
@few
def test_adjacency_of_tensors_is_the_one_of_arrays(
    kind: str, counts: list[tuple[int, int, int]], seed: int
) -> None:
    """Up to the self loops of padding, which keep its softmax defined."""
    graph = random_graph(counts, 15, seed)
    arrays, got = connectivity(graph, kind), to_tensors(graph).adjacency(kind).numpy()
    for row, used in enumerate(graph.num_nodes):
        np.testing.assert_array_equal(got[row, :used], arrays[row, :used])
        np.testing.assert_array_equal(got[row, used:], np.eye(15, dtype=bool)[used:])
        assert not arrays[row, used:].any()


def test_connectivity_written_out() -> None:
    """An unplaced block sees targets, placed blocks and its own object.

    The protocol calls this asymmetric; by its own rule for every row it is not, because targets
    and placed blocks attend to unplaced ones as well. The rows count. Three targets, one placed
    block, three unplaced ones of which the first two are one object, one node of padding.
    """
    graph = random_graph([(3, 1, 3)], 8, 0)
    graph.object_id[0] = [-1, -1, -1, 0, 1, 1, 2, -1]
    settled = [1, 1, 1, 1, 1, 1, 1, 0]
    expected = np.array(
        [
            settled,
            settled,
            settled,
            settled,
            [1, 1, 1, 1, 1, 1, 0, 0],
            [1, 1, 1, 1, 1, 1, 0, 0],
            [1, 1, 1, 1, 0, 0, 1, 0],
            [0] * 8,
        ],
        bool,
    )
    np.testing.assert_array_equal(connectivity(graph, "partial")[0], expected)
    full = np.zeros((8, 8), bool)
    full[:7, :7] = True
    np.testing.assert_array_equal(connectivity(graph, "full")[0], full)


def test_masks_follow_the_counts() -> None:
    graph = to_tensors(random_graph([(3, 1, 2), (4, 2, 1)], 8, 0))
    assert graph.used.int().tolist() == [[1] * 6 + [0, 0], [1] * 7 + [0]]
    assert graph.placed.int().tolist() == [[0, 0, 0, 1, 0, 0, 0, 0], [0, 0, 0, 0, 1, 1, 0, 0]]
    assert graph.unplaced.int().tolist() == [[0, 0, 0, 0, 1, 1, 0, 0], [0, 0, 0, 0, 0, 0, 1, 0]]


@given(seed=st.integers(0, 999), head_size=st.sampled_from([4, 16, 24, 32]))
@few
def test_rotated_scores_depend_on_offsets_only(seed: int, head_size: int) -> None:
    """Deviation D5: q_i . k_j is unchanged when all positions move together, and moves otherwise.

    Rotation is an isometry, and entries beyond the rotated pairs pass unchanged.
    """
    generator = torch.Generator().manual_seed(seed)
    position = torch.rand(1, 6, 3, generator=generator, dtype=torch.float64)
    shift = torch.rand(3, generator=generator, dtype=torch.float64)
    q, k = torch.randn(2, 1, 2, 6, head_size, generator=generator, dtype=torch.float64)

    def scores(at: torch.Tensor, others: torch.Tensor) -> torch.Tensor:
        a, b = Rotation.of(at, head_size), Rotation.of(others, head_size)
        return a(q) @ b(k).transpose(-1, -2)

    here = scores(position, position)
    torch.testing.assert_close(scores(position + shift, position + shift), here, rtol=0, atol=1e-9)
    assert (scores(position + shift, position) - here).abs().max() > 1e-3
    turned = Rotation.of(position, head_size)(q)
    torch.testing.assert_close(turned.norm(dim=-1), q.norm(dim=-1))
    pairs = min(len(ROTARY), head_size // 2)
    torch.testing.assert_close(turned[..., 2 * pairs :], q[..., 2 * pairs :], rtol=0, atol=0)


def test_rotation_repeats_after_the_longest_period() -> None:
    """Every period divides 0.8 m, so a shift by that much is no shift."""
    position = torch.rand(1, 4, 3, dtype=torch.float64)
    a, b = Rotation.of(position, 24), Rotation.of(position + 0.8, 24)
    torch.testing.assert_close(a.cos, b.cos, rtol=0, atol=1e-9)
    torch.testing.assert_close(a.sin, b.sin, rtol=0, atol=1e-9)


def test_rotary_attention_ignores_a_common_shift() -> None:
    """With equal inputs, the whole round depends on where nodes are relative to each other."""
    torch.manual_seed(0)
    layer = AttentionRound(16, 2, "light").double()
    x = torch.randn(1, 5, 16, dtype=torch.float64)
    position = torch.rand(1, 5, 3, dtype=torch.float64)
    everyone = torch.zeros(2, 5, 5, dtype=torch.float64)
    here = layer(x, everyone, Rotation.of(position, 8))
    moved = layer(x, everyone, Rotation.of(position + 0.123, 8))
    torch.testing.assert_close(here, moved, rtol=0, atol=1e-10)
    scaled = layer(x, everyone, Rotation.of(position * 0.5, 8))
    assert (here - scaled).abs().max() > 1e-3


def test_positions_are_divided_by_the_scale() -> None:
    """Normalisation: scaled positions with an unscaled network are the same."""
    a, b = network(position_scale=0.25), network(position_scale=1.0)
    b.load_state_dict(a.state_dict())
    graph = tensors(random_graph([(3, 2, 2)], 7, 4))
    nodes = graph.nodes.clone()
    nodes[..., :3] /= 0.25
    torch.testing.assert_close(a(graph).dense(), b(graph._replace(nodes=nodes)).dense())


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"feed_forward": "wyde"}, "did you mean 'wide'"),
        ({"feed_forward": ""}, "light, none, wide"),
        ({"connectivity": "parital"}, "did you mean 'partial'"),
        ({"encoder": "s2w"}, "did you mean 's2v'"),
        ({"encoder": "relation"}, "did you mean 'relational'"),
        ({"encoder": "s2v", "rotary": True}, "false for the encoder s2v"),
        ({"encoder": "s2v", "width": 1, "heads": 1}, "at least 2"),
        ({"heads": 3}, "a divisor of width 64"),
        ({"heads": 5, "width": 64}, "heads"),
        ({"rounds": 0}, "a whole number from 1 to 100"),
        ({"position_scale": 0.0}, "position_scale"),
        ({"position_scale": -1.0}, "a positive length"),
        ({"position_scale": math.nan}, "position_scale"),
    ],
)
def test_config_refuses(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words) as caught:
        NetworkConfig(**changes)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "changes",
    [
        {"heads": 0},
        {"heads": -1},
        {"width": 0},
        {"width": -64},
        {"num_actions": 0},
        {"position_scale": math.inf},
    ],
    ids=str,
)
def test_config_refuses_impossible_sizes(changes: dict[str, Any]) -> None:
    with pytest.raises(InputError):
        NetworkConfig(**changes)
