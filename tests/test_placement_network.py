"""The placement network: size, padding, order, symmetry, gradients, choices."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from learn2assemble.constants import EDGE
from learn2assemble.errors import InputError, UnknownNameError
from learn2assemble.tasks.graph.batch import GraphTensors, cell_tensors, to_tensors
from learn2assemble.tasks.graph.features import Graph
from learn2assemble.tasks.graph.placements import MAX_CELLS, distinct_placements
from learn2assemble.tasks.graph.relations import EDGE_FEATURES, OFFSETS
from learn2assemble.tasks.networks.agent import fitted, make_network
from learn2assemble.tasks.networks.config import NetworkConfig
from learn2assemble.tasks.networks.placement import PlacementNetwork, PlacementValues
from learn2assemble.tasks.networks.qnetwork import QNetwork
from learn2assemble.tasks.simulator import Simulator
from learn2assemble.tasks.task import Task, get_task
from learn2assemble.tasks.world.blocks import get_action_spec
from learn2assemble.tasks.world.state import State
from learn2assemble.tasks.world_model import WorldModel
from learning_data import advance, random_actions, turned_graph

_GRIPPED = Task(
    "gripped", num_sides=2, grid=3, num_nodes=16, rotations=4, action_mode="grips", pitch=0.06
)
TASKS = {
    task.name: task
    for task in (
        Task("one", num_sides=1, grid=3, num_nodes=14),
        Task("two", num_sides=2, grid=3, num_nodes=20),
        Task("four", num_sides=4, grid=3, num_nodes=30),
        Task("bars", num_sides=1, grid=4, num_nodes=18, objects="bars"),
        Task("set-26", num_sides=2, grid=3, num_nodes=20, objects="set-26", rotations=4),
        _GRIPPED,
        _GRIPPED.replace(name="gripped-set-26", objects="set-26", layout="columns"),
    )
}
SIMULATORS = {name: Simulator(task) for name, task in TASKS.items()}
CUBES = ("one", "two", "four", "gripped")
some_graphs = given(
    name=st.sampled_from(list(TASKS)), seed=st.integers(0, 10_000), rounds=st.integers(1, 3)
)
few = settings(max_examples=20, deadline=None)
CLOSE: dict[str, Any] = {"rtol": 0.0, "atol": 2e-4}
"""Single precision: relations are float32."""


def network(
    task: Task, seed: int, rounds: int = 2, width: int = 16, hand: bool | None = None
) -> PlacementNetwork:
    """A random one whose outputs are of the size of 1 and which uses every layer; with a gripper
    it looks around the hand unless told otherwise."""
    torch.manual_seed(seed)
    config = NetworkConfig(
        encoder="relational",
        width=width,
        rounds=rounds,
        num_actions=task.num_actions,
        action_mode=task.action_mode,
        pitch=task.pitch,
        hand=task.action_mode == "grips" if hand is None else hand,
    )
    net = make_network(config)
    assert isinstance(net, PlacementNetwork)
    return net


def worlds(name: str, seed: int, count: int = 4) -> State:
    """Worlds at different stages, so that rows differ in blocks, cells and placements."""
    simulator, rng = SIMULATORS[name], np.random.default_rng(seed)
    state = simulator.new(count, rng)
    for row in range(count):
        one = advance(simulator, state.take(np.array([row])), row, rng)
        state.put(np.array([row]), one if one.batch_size else simulator.new(1, rng))
    return state


def graphs(name: str, seed: int, count: int = 4) -> Graph:
    return SIMULATORS[name].observe(worlds(name, seed, count))


def evaluate(net: PlacementNetwork, graph: Graph) -> PlacementValues:
    with torch.no_grad():
        return net(to_tensors(graph))


@few
@some_graphs
def test_encoder_layer_by_layer(name: str, seed: int, rounds: int) -> None:
    """The embeddings are those of its layers, one applied after the other."""
    task = TASKS[name]
    net = network(task, seed, rounds)
    spec = get_action_spec(task.action_mode, task.rotations, task.pitch)
    with torch.no_grad():
        cells = cell_tensors(to_tensors(graphs(name, seed)), spec)
        message = net.edge(cells.edges).relu() * cells.edge_used[..., None]
        near = [net.neighbour(one).relu() for one in cells.offsets]
        sides = net.side(torch.cat([message.sum(2), message.amax(2), torch.stack(near)], -1))
        x, context = sides.sum(1).relu(), net.summary(cells.summary)
        for pool, layer in zip(net.pools, net.rounds, strict=True):
            rows = [x[cells.row == row] for row in range(len(context))]
            pooled = [torch.cat([r.sum(0) / 10, r.amax(0).clamp(min=0)]) for r in rows]
            context = (context + pool(torch.stack(pooled))).relu()
            x = x + layer(torch.cat([x, context[cells.row]], -1))
        found = net.encode(cells)
    torch.testing.assert_close(found, (x.relu(), context), rtol=1e-5, atol=1e-5)


def test_what_is_beyond_has_no_weight() -> None:
    """No gradient reaches the row of offsets out of sight, which is 0."""
    net = network(TASKS["two"], 0)
    net(to_tensors(graphs("two", 0))).q.clamp(min=-100).sum().backward()
    gradient = net.neighbour.weight.grad
    assert gradient is not None
    assert gradient[:OFFSETS].any()
    assert not gradient[OFFSETS].any()
    assert not net.neighbour.weight[OFFSETS].any()


def test_the_encoder_chooses_the_network() -> None:
    assert isinstance(make_network(NetworkConfig(encoder="relational")), PlacementNetwork)
    for encoder in ("attention", "s2v"):
        assert isinstance(make_network(NetworkConfig(encoder=encoder)), QNetwork)


@pytest.mark.parametrize(("rounds", "expected"), [(2, 134_978), (3, 168_002)])
@pytest.mark.parametrize("num_actions", [5, 20])
def test_number_of_parameters(rounds: int, expected: int, num_actions: int) -> None:
    """Layer by layer for F = 64; the number of actions does not count."""
    config = NetworkConfig(encoder="relational", rounds=rounds, num_actions=num_actions)
    f = config.width

    def linear(inputs: int, outputs: int) -> int:
        return inputs * outputs + outputs

    written_out = (
        linear(EDGE_FEATURES, f)  # an edge of an outline
        + (OFFSETS + 1) * f  # the offsets to placed blocks
        + linear(3 * f, 2 * f)
        + linear(2 * f, f)  # a side
        + linear(4, f)  # the summary
        + rounds * (linear(2 * f, f) + linear(2 * f, 2 * f) + linear(2 * f, f))
        + linear(f, f)
        + 3 * f
        + f * f  # a member of a placement, its lever, the context
        + linear(f, f)
        + linear(f, 2)  # the read-out
    )
    found = sum(p.numel() for p in make_network(config).parameters())
    assert found == written_out == expected
    if num_actions == 20:
        gripped = make_network(dataclasses.replace(config, action_mode="grips"))
        assert sum(p.numel() for p in gripped.parameters()) == expected + 4 * f
        armed = make_network(dataclasses.replace(config, action_mode="grips", hand=True))
        hand = (3 * OFFSETS + 1) * f + linear(6, f) + 4 * f  # around it, where, by which grip
        hand += linear(f, 2 * f) + linear(2 * f, f)
        assert sum(p.numel() for p in armed.parameters()) == expected + 4 * f + hand


@some_graphs
@few
def test_neighbours_of_a_row_change_nothing(name: str, seed: int, rounds: int) -> None:
    """Alone, in a batch, in another order and with more padding: the same Q for every placement."""
    net, graph = network(TASKS[name], seed, rounds), graphs(name, seed)
    together = evaluate(net, graph)
    order = np.random.default_rng(seed).permutation(len(graph.num_nodes))
    shuffled = evaluate(net, graph.take(order))
    wide = graph._replace(
        nodes=np.pad(graph.nodes, ((0, 0), (0, 7), (0, 0))),
        object_id=np.pad(graph.object_id, ((0, 0), (0, 7)), constant_values=-1),
    )
    padded = evaluate(net, wide)
    torch.testing.assert_close(padded.q, together.q, **CLOSE)
    for row in range(len(graph.num_nodes)):
        alone = evaluate(net, graph.take(np.array([row])))
        count = int(alone.cells.placements.count[0])
        assert alone.q.shape[1] == count
        at = int(np.flatnonzero(order == row)[0])
        for part in ("q", "reward"):
            expected = getattr(alone, part)[0]
            torch.testing.assert_close(getattr(together, part)[row, :count], expected, **CLOSE)
            torch.testing.assert_close(getattr(shuffled, part)[at, :count], expected, **CLOSE)
        assert (together.q[row, count:] < -1e8).all()


def test_negative_maxima_are_treated_alike() -> None:
    """A network whose cells all have negative embeddings after the first round: the row with the
    most cells has no padding to be the largest."""
    net, graph = network(TASKS["two"], 0), graphs("two", 3)
    with torch.no_grad():
        *_, last = net.rounds[0].children()
        assert isinstance(last, torch.nn.Linear)
        last.bias.sub_(100)
        pool = net.pools[1]
        assert isinstance(pool, torch.nn.Linear)
        pool.weight[:, : net.config.width] = 0  # Only the maximum counts.
    together = evaluate(net, graph)
    largest = int(together.cells.placements.num_cells.argmax())
    for row in range(len(graph.num_nodes)):
        alone = evaluate(net, graph.take(np.array([row])))
        np.testing.assert_allclose(
            together.q[row, : alone.q.shape[1]], alone.q[0], rtol=1e-4, err_msg=str(row == largest)
        )


@some_graphs
@few
def test_order_of_nodes_carries_no_meaning(name: str, seed: int, rounds: int) -> None:
    """Placed blocks and waiting objects listed in another order: the same Q for every result.

    A hand gets another one of like objects then, which waits elsewhere.
    """
    net, graph = network(TASKS[name], seed, rounds, hand=False), graphs(name, seed, 3)
    rng = np.random.default_rng(seed)
    nodes, object_id = graph.nodes.copy(), graph.object_id.copy()
    for row in range(3):
        t, p, n = (int(c[row]) for c in (graph.num_targets, graph.num_placed, graph.num_nodes))
        for low, high in ((t, t + p), (t + p, n)):
            order = low + rng.permutation(high - low)
            nodes[row, low:high] = graph.nodes[row, order]
            object_id[row, low:high] = graph.object_id[row, order]
    mine = evaluate(net, graph)
    theirs = evaluate(net, graph._replace(nodes=nodes, object_id=object_id))
    for row in range(3):
        count = int(mine.cells.placements.count[row])
        before = dict(
            zip(mine.cells.placements.key[row, :count].tolist(), mine.q[row].tolist(), strict=False)
        )
        after = dict(
            zip(
                theirs.cells.placements.key[row, :count].tolist(),
                theirs.q[row].tolist(),
                strict=False,
            )
        )
        assert before.keys() == after.keys()
        for key, value in before.items():
            assert after[key] == pytest.approx(value, abs=2e-4)


@pytest.mark.parametrize(("name", "quarters"), [("two", 2), ("four", 1), ("four", 2), ("four", 3)])
@given(seed=st.integers(0, 10_000))
@settings(max_examples=10, deadline=None)
def test_turned_cubes_have_the_same_q(name: str, quarters: int, seed: int) -> None:
    """The world turned with its sides: every cell keeps its Q (only the lever of objects does not
    turn)."""
    task = TASKS[name]
    net, graph = network(task, seed), graphs(name, seed, 3)
    turn = turned_graph(graph, task.num_sides, quarters)
    mine, theirs = evaluate(net, graph), evaluate(net, turn.graph)
    np.testing.assert_array_equal(mine.cells.placements.count, theirs.cells.placements.count)
    for row in range(3):
        count = int(mine.cells.placements.count[row])

        def at(values: PlacementValues, row: int = row, count: int = count) -> np.ndarray:
            found = values.cells.placements
            return found.cells[row, found.members[row, :count, 0]].astype(float)

        here, there = turn.points(at(mine)), at(theirs)
        near = np.abs(here[:, None] - there).max(-1)
        assert (near.min(1) < 1e-4).all()
        same = torch.from_numpy(near.argmin(1))
        torch.testing.assert_close(theirs.q[row, same], mine.q[row, :count], **CLOSE)


def test_gradients_reach_every_parameter() -> None:
    """Of cubes all but the lever: their only cell is their centre."""
    for name in TASKS:
        net = network(TASKS[name], 0)
        values = net(to_tensors(graphs(name, 1)))
        values.q[values.cells.legal].square().sum().backward()
        for key, parameter in net.named_parameters():
            assert parameter.grad is not None, key
            if key == "lever.weight" and name in CUBES:
                assert not parameter.grad.any()
            else:
                assert parameter.grad.abs().max() > 0, (name, key)
        assert net.neighbour.weight.grad is not None
        assert not net.neighbour.weight.grad[OFFSETS].any(), "padding is not learned"
        assert not net.neighbour.weight[OFFSETS].any()


def test_rows_share_no_gradient() -> None:
    """Q of one graph depends on the parameters only through its own cells."""
    task = TASKS["set-26"]
    net, graph = network(task, 0), graphs("set-26", 2)
    values = net(to_tensors(graph))
    count = int(values.cells.placements.count[0])
    values.q[0, :count].sum().backward()
    together = [p.grad.clone() for p in net.parameters() if p.grad is not None]
    net.zero_grad()
    net(to_tensors(graph.take(np.array([0])))).q.sum().backward()
    alone = [p.grad for p in net.parameters() if p.grad is not None]
    for a, b in zip(together, alone, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-3, atol=1e-3)


@some_graphs
@settings(max_examples=10, deadline=None)
def test_best_and_select_are_those_of_q(name: str, seed: int, rounds: int) -> None:
    """``best`` is the maximum over legal actions asked for one by one; like actions share Q."""
    task = TASKS[name]
    net, graph = network(task, seed, rounds), graphs(name, seed, 3)
    tensors = to_tensors(graph)
    values = evaluate(net, graph)
    value, action = values.best(tensors)
    torch.testing.assert_close(values.select(action), value)
    rng = np.random.default_rng(seed)
    for _ in range(5):
        drawn = torch.from_numpy(random_actions(graph, task.num_actions, rng))
        assert (values.select(drawn) <= value).all()
    for row in range(3):
        t, p, n = (int(c[row]) for c in (graph.num_targets, graph.num_placed, graph.num_nodes))
        every = [
            (i, j, k)
            for i in range(t + p, n)
            for j in range(t, t + p)
            for k in range(task.num_actions)
        ]
        many = graph.take(np.full(len(every), row))
        one_by_one = evaluate(net, many).select(torch.tensor(every))
        assert float(one_by_one.max()) == pytest.approx(float(value[row]), abs=2e-4)
        count = int(values.cells.placements.count[row])
        assert float(values.q[row, :count].max()) == float(value[row])
        assert tuple(action[row].tolist()) in every
        # As many values as placements: like actions have one Q.
        assert len(set(np.round(one_by_one.numpy(), 3).tolist())) <= count


@pytest.mark.parametrize("name", ["gripped", "gripped-set-26"])
def test_q_knows_the_grip(name: str) -> None:
    """The same cells by another grip have another Q, unless the network knows no difference."""
    net, graph = network(TASKS[name], 0, hand=False), graphs(name, 0)
    values = evaluate(net, graph)
    found = values.cells.placements
    assert net.grip is not None
    with torch.no_grad():
        net.grip.weight[:] = net.grip.weight[0]
    alike = evaluate(net, graph)
    compared = 0
    for row in range(len(graph.num_nodes)):
        filled: dict[tuple[int, frozenset[int]], list[int]] = {}
        for n in range(int(found.count[row])):
            cells = found.members[row, n][found.members[row, n] >= 0].tolist()
            filled.setdefault((cells[0], frozenset(cells)), []).append(n)
        for same in filled.values():
            grips = found.action[row, same, 2] % 4
            assert len(set(grips.tolist())) == len(same), "each grip once"
            q = values.q[row, same].tolist()
            assert len(set(np.round(q, 6).tolist())) == len(same)
            torch.testing.assert_close(alike.q[row, same], alike.q[row, same[:1]].expand(len(same)))
            compared += len(same) > 1
    assert compared > 10


def test_a_network_moves_to_another_pitch_with_its_weights() -> None:
    """Trained where blocks touch, asked where they leave a gap: cells are those of the gap."""
    net = network(TASKS["one"], 3)
    moved = fitted(net, 0.055, 0)
    assert fitted(net, EDGE, 0) is net
    assert (net.config.pitch, moved.config.pitch) == (EDGE, 0.055)
    assert all(a is b for a, b in zip(net.parameters(), moved.parameters(), strict=True))
    spaced = TASKS["one"].replace(name="spaced", pitch=0.055)
    model = WorldModel(Simulator(spaced), net)
    assert (model.network.config.pitch, model.network.config.sight) == (0.055, 0)
    large = WorldModel(Simulator(get_task("two-sided-8x8-90-94")), net)
    assert large.network.config.sight == 3, "no sum over more blocks than were met in training"
    state = model.simulator.new(1, np.random.default_rng(0))
    before = state.copy()
    cells = {tuple(np.round(p - before.position[0, 0], 6)) for p in _first_cells(model, state)}
    assert (0.055, 0.0, 0.0) in cells
    assert (0.0, 0.0, 0.05) in cells
    assert (0.05, 0.0, 0.0) not in cells


def _first_cells(model: WorldModel, state: State) -> list[np.ndarray]:
    """Where each of the actions the model values puts its block [m]."""
    out = []
    for action in model.action_values(state)[0].actions:
        after = model.step(state, action[None]).states
        out.append(after.position[0, after.num_placed[0] - 1])
    return out


def test_a_network_for_other_actions_is_refused() -> None:
    turns = NetworkConfig(encoder="relational", num_actions=20)
    with pytest.raises(InputError, match=r"network\.action_mode: got 'turns', expected grips"):
        WorldModel(SIMULATORS["gripped"], make_network(turns))
    with pytest.raises(InputError, match=r"network\.num_actions: got 5"):
        WorldModel(SIMULATORS["gripped"], make_network(NetworkConfig()))
    with pytest.raises(UnknownNameError, match="did you mean 'grips'"):
        NetworkConfig(action_mode="grip")
    with pytest.raises(InputError, match="pitch"):
        NetworkConfig(pitch=0.0)
    with pytest.raises(InputError, match="hand: got True, expected false unless"):
        NetworkConfig(hand=True)


def test_without_a_placement_q_is_far_below() -> None:
    state = worlds("two", 5)
    state.num_blocks[1] = state.num_placed[1]
    graph = SIMULATORS["two"].observe(state)
    value, _ = evaluate(network(TASKS["two"], 0), graph).best(to_tensors(graph))
    assert float(value[1]) < -1e8
    assert (value[[0, 2, 3]] > -1e8).all()
    state.num_blocks[:] = state.num_placed
    graph = SIMULATORS["two"].observe(state)
    value, _ = evaluate(network(TASKS["two"], 0), graph).best(to_tensors(graph))
    assert (value < -1e8).all()


def test_placements_of_the_values_are_the_enumerated_ones() -> None:
    """Learning relies on the order: outcomes are stored in that of :func:`distinct_placements`."""
    graph = graphs("set-26", 0)
    values = evaluate(network(TASKS["set-26"], 0), graph)
    found = distinct_placements(graph, get_action_spec("turns", 4))
    np.testing.assert_array_equal(values.cells.action, found.action)
    np.testing.assert_array_equal(values.cells.legal, found.used)
    assert found.members.shape[2] <= MAX_CELLS
    assert isinstance(to_tensors(graph), GraphTensors)


def test_q_is_reward_and_rest() -> None:
    """Both parts come from the read-out, so labels of rewards shape Q."""
    net, graph = network(TASKS["two"], 0), graphs("two", 0)
    before = evaluate(net, graph)
    last = net.readout[2]
    assert isinstance(last, torch.nn.Linear)
    with torch.no_grad():
        last.bias[0] += 1.0
        shifted = evaluate(net, graph)
        last.bias[1] += 2.0
        both = evaluate(net, graph)
    legal = before.cells.legal
    torch.testing.assert_close(shifted.q[legal], before.q[legal] + 1)
    torch.testing.assert_close(shifted.reward[legal], before.reward[legal] + 1)
    torch.testing.assert_close(both.q[legal], before.q[legal] + 3)
    torch.testing.assert_close(both.reward[legal], shifted.reward[legal])
