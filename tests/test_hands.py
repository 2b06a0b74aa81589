"""What a hand sees at a placement: against rotation matrices, when the world is turned, and that
it is what the arm's answer depends on."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from learn2assemble.constants import EDGE
from learn2assemble.geometry.rotations import yaw_matrix
from learn2assemble.robot.grasps import get_grasps
from learn2assemble.robot.moves import Outcome
from learn2assemble.tasks.graph.batch import to_tensors
from learn2assemble.tasks.graph.features import Graph, node_offset
from learn2assemble.tasks.graph.placements import Placements, distinct_placements
from learn2assemble.tasks.graph.relations import AROUND, OFFSETS, REACH, WINDOW, look_around
from learn2assemble.tasks.networks.agent import make_network
from learn2assemble.tasks.networks.config import NetworkConfig
from learn2assemble.tasks.networks.placement import PlacementNetwork
from learn2assemble.tasks.simulator import Simulator
from learn2assemble.tasks.task import Task
from learn2assemble.tasks.world.state import State
from learning_data import advance, turned_graph

PITCH = 0.06
CUBES = Task(
    "cubes",
    num_sides=4,
    grid=3,
    num_nodes=30,
    rotations=4,
    action_mode="grips",
    pitch=PITCH,
    layout="slanted-rows",
    cover_filter="wide",
    normalise_initial=False,
)
TASKS = {
    "cubes": CUBES,
    "objects": CUBES.replace(
        name="objects", num_sides=2, num_nodes=24, objects="set-26", layout="columns"
    ),
    "turned": Task("turned", num_sides=2, grid=3, num_nodes=20, objects="set-26", rotations=4),
}
SIMULATORS = {name: Simulator(task) for name, task in TASKS.items()}
# The turned world of the quarter turns: sides and lattice as one.
EVEN = Simulator(CUBES.replace(name="even", pitch=EDGE, layout="line"))
GRASPS = get_grasps("paper")


def some_graph(simulator: Simulator, seed: int, count: int = 2) -> tuple[State, Graph]:
    rng = np.random.default_rng(seed)
    state = advance(simulator, simulator.new(count, rng), seed % 5, rng)
    if not state.batch_size:
        state = simulator.new(1, rng)
    return state, simulator.observe(state)


def numbers(away: np.ndarray, yaw: float, pitch: float) -> list[int]:
    """Numbers of offsets float[n, 3] [m] as a hand at ``yaw`` sees them."""
    mine = away @ yaw_matrix(yaw)  # Columns of the matrix are the hand's axes.
    steps = np.rint(mine * [1, -1, 1] / [pitch, pitch, EDGE]).astype(int)
    i, j, k = (np.clip(steps, -REACH, REACH) + REACH).T
    return ((i * WINDOW + j) * WINDOW + k).tolist()


@given(name=st.sampled_from(["cubes", "objects"]), seed=st.integers(0, 10_000))
@settings(max_examples=25, deadline=None)
def test_surroundings_written_out(name: str, seed: int) -> None:
    """Placed blocks and the object itself as the placing hand sees them, then what stands in the
    way of the picking one; the attitudes are those of the arm."""
    simulator = SIMULATORS[name]
    state, graph = some_graph(simulator, seed)
    placements = distinct_placements(graph, simulator.action_spec)
    found = look_around(graph, placements, simulator.action_spec)
    rng = np.random.default_rng(seed)
    for row in range(state.batch_size):
        targets, first = int(graph.num_targets[row]), int(node_offset(graph)[row, 0])
        nodes = graph.nodes[row, : graph.num_nodes[row], :3].astype(float)
        object_id = graph.object_id[row]
        count = int(placements.count[row])
        assert (found.around[row, count:] == AROUND).all()
        for n in rng.permutation(count)[:40]:
            members = [m for m in placements.members[row, n].tolist() if m >= 0]
            cells = placements.cells[row, members].astype(float)
            block, _, action = placements.action[row, n].tolist()
            grasp, place = (attitude.yaw for attitude in GRASPS[action % 4])
            expected = numbers(nodes[targets:first] - cells[0], place, PITCH)
            expected += [OFFSETS + k for k in numbers(cells[1:] - cells[0], place, PITCH)]
            away = nodes[first:] - nodes[block]
            across, along = np.abs(away @ yaw_matrix(grasp))[:, :2].T
            levels = np.rint(away[:, 2] / EDGE)
            way = (across < 0.75 * PITCH) & (levels >= 0)
            way &= along < np.where(levels > 0, 2.25, 1.25) * PITCH
            way &= object_id[first : len(nodes)] != object_id[block]
            expected += [2 * OFFSETS + k for k in numbers(away[way], grasp, PITCH)]
            seen = found.around[row, n].tolist()
            assert sorted(seen) == sorted(expected + [AROUND] * (len(seen) - len(expected)))
            np.testing.assert_allclose(found.place[row, n, :3], cells[0], atol=1e-6)
            np.testing.assert_allclose(found.place[row, n, 3:], nodes[block], atol=1e-6)


def test_without_a_gripper_hands_are_turned_with_the_object() -> None:
    """Objects that turn by themselves: the hand turns with them, and nothing is in its way."""
    simulator = SIMULATORS["turned"]
    _, graph = some_graph(simulator, 3)
    placements = distinct_placements(graph, simulator.action_spec)
    found = look_around(graph, placements, simulator.action_spec)
    assert (found.around[found.around < AROUND] < 2 * OFFSETS).all()
    compared = 0
    for row in range(len(graph.num_nodes)):
        for n in range(int(placements.count[row])):
            members = [m for m in placements.members[row, n].tolist() if m >= 0]
            cells = placements.cells[row, members].astype(float)
            yaw = np.pi / 2 * (placements.action[row, n, 2] % 4)
            own = [OFFSETS + k for k in numbers(cells[1:] - cells[0], yaw, EDGE)]
            seen = found.around[row, n]
            assert sorted(own) == sorted(seen[(seen >= OFFSETS) & (seen < AROUND)].tolist())
            compared += len(own) > 0
    assert compared > 20


def by_cell(graph: Graph, placements: Placements, row: int, place: str) -> dict[tuple, int]:
    """Number of the placement of a cube in each cell, grasped by A and put down by ``place``."""
    way = "AB".index(place)
    count = int(placements.count[row])
    found = [n for n in range(count) if placements.action[row, n, 2] % 4 == way]
    at = np.rint(placements.cells[row, placements.members[row, found, 0]] / (EDGE / 2))
    return {tuple(cell): n for cell, n in zip(at.astype(int).tolist(), found, strict=True)}


@pytest.mark.parametrize(("quarters", "before", "after"), [(1, "B", "A"), (3, "A", "B")])
@given(seed=st.integers(0, 10_000))
@settings(max_examples=15, deadline=None)
def test_the_hand_turns_with_the_world(quarters: int, before: str, after: str, seed: int) -> None:
    """The world turned by a quarter and the grip exchanged: every hand sees the same, and a
    network that is not told where in the world it is has the same Q."""
    state, graph = some_graph(EVEN, seed)
    turned = turned_graph(graph, 4, quarters)
    spec = EVEN.action_spec
    mine, theirs = (distinct_placements(g, spec) for g in (graph, turned.graph))
    here, there = look_around(graph, mine, spec), look_around(turned.graph, theirs, spec)
    net = network(EDGE)
    assert net.hand is not None
    assert net.grip is not None
    with torch.no_grad():
        for blind in (net.grip.weight, net.hand.grip.weight, net.hand.place.weight):
            blind.zero_()
        q, q_turned = (net(to_tensors(g)).q for g in (graph, turned.graph))
    for row in range(state.batch_size):
        theirs_at = by_cell(turned.graph, theirs, row, after)
        compared = 0
        for cell, n in by_cell(graph, mine, row, before).items():
            goal = turned.points(np.array(cell) * EDGE / 2)
            m = theirs_at[tuple(np.rint(goal / (EDGE / 2)).astype(int).tolist())]
            assert sorted(here.around[row, n].tolist()) == sorted(there.around[row, m].tolist())
            assert float(q[row, n]) == pytest.approx(float(q_turned[row, m]), abs=2e-4)
            compared += 1
        assert compared == len(theirs_at) > 3


def network(pitch: float, hand: bool = True) -> PlacementNetwork:
    torch.manual_seed(0)
    config = NetworkConfig(
        encoder="relational",
        width=16,
        rounds=1,
        num_actions=20,
        action_mode="grips",
        pitch=pitch,
        hand=hand,
    )
    net = make_network(config)
    assert isinstance(net, PlacementNetwork)
    return net


def alike(simulator: Simulator) -> State:
    """A world whose four sides have the same outline, with one block in the middle."""
    state = simulator.new(1, np.random.default_rng(0))
    state.vertices[0, 1:] = state.vertices[0, :1]
    state.num_vertices[0, 1:] = state.num_vertices[0, 0]
    state.position[0, 0] = [0.0, PITCH, EDGE / 2]
    return state


def test_only_a_hand_tells_beside_from_behind() -> None:
    """The fault it was made for: of four equal sides the old network has one Q for a block that the
    fingers close beside and one that they close before, though the arm can only do one of them."""
    simulator = Simulator(CUBES.replace(arm="panda"))
    graph = simulator.observe(alike(simulator))
    placements = distinct_placements(graph, simulator.action_spec)
    # Relations: 2 is right of the block, 4 behind it; way 0 closes the fingers along y.
    spec = {relation: 4 * relation for relation in (2, 4)}
    number = {r: placements.action[0, :, 2].tolist().index(k) for r, k in spec.items()}
    with torch.no_grad():
        old = network(PITCH, hand=False)(to_tensors(graph)).q[0]
        new = network(PITCH)(to_tensors(graph)).q[0]
    assert float(old[number[2]]) == pytest.approx(float(old[number[4]]), abs=1e-5)
    assert abs(float(new[number[2]] - new[number[4]])) > 1e-3
    outcomes = {}
    for relation, action in spec.items():
        step = simulator.step(alike(simulator), np.array([[0, 0, action]]))
        outcomes[relation] = int(step.verdict[0])
    assert outcomes[2] == 0
    assert outcomes[4] == 16 + Outcome.PLACE_COLLISION


def test_of_like_objects_a_hand_takes_one_it_can_get_at() -> None:
    """Two waiting cubes, the first beside a standing pair: it is left to the other grip."""
    simulator = SIMULATORS["objects"]
    nodes = np.zeros((1, 8, 5), np.float32)
    waiting = [(0.0, -0.2, 0.0), (0.4, -0.2, 0.0), (0.1, -0.2, 0.0), (0.1, -0.2, EDGE)]
    nodes[0, 4:, :3] = waiting
    nodes[0, 3, :3] = [0.0, 0.0, EDGE / 2]
    object_id = np.array([[-1, -1, -1, 0, 1, 2, 3, 3]], np.int32)
    graph = Graph(nodes, object_id, *(np.array([n]) for n in (3, 1, 8)))
    found = distinct_placements(graph, simulator.action_spec)
    chosen = {(int(w) % 4, int(block)) for block, _, w in found.action[0] if block < 6}
    # A closes along y, where nothing is; B along x, where the pair is in the way.
    assert chosen == {(0, 4), (1, 4), (2, 5), (3, 5)}
    hands = look_around(graph, found, simulator.action_spec)
    pair = found.action[0, :, 0] >= 6
    assert not (hands.around[0, ~pair] >= 2 * OFFSETS)[hands.around[0, ~pair] < AROUND].any()
    alone = graph._replace(object_id=np.array([[-1, -1, -1, 0, 1, 3, 3, 3]], np.int32))
    crowded = distinct_placements(alone, simulator.action_spec)
    seen = look_around(alone, crowded, simulator.action_spec).around[0]
    by_x = (crowded.action[0, :, 0] == 4) & (crowded.action[0, :, 2] % 4 >= 2)
    assert ((seen >= 2 * OFFSETS) & (seen < AROUND)).any(1).tolist() == by_x.tolist()
