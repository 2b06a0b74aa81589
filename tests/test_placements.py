"""Distinct placements and their outcomes against every single action of the simulator.

Relations of cells to outlines and blocks: against polygons, and when the world is turned.
"""

from __future__ import annotations

from typing import NamedTuple

import gymnasium
import numpy as np
import pytest
import shapely
from gymnasium.spaces import Discrete
from gymnasium.utils.env_checker import check_env, data_equivalence
from gymnasium.vector import AutoresetMode
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import learn2assemble.tasks.physics.static as static_module
from learn2assemble.constants import EDGE, HALF
from learn2assemble.envs import env_id
from learn2assemble.envs.actions import flatten_action, num_placement_actions, resolve_actions
from learn2assemble.envs.assembly import REFUSED, AssemblyEnv, AssemblyVectorEnv
from learn2assemble.errors import UnknownNameError
from learn2assemble.tasks.graph.features import Graph, node_offset
from learn2assemble.tasks.graph.placements import (
    Placements,
    action_keys,
    distinct_placements,
    locate,
)
from learn2assemble.tasks.graph.relations import OFFSETS, REACH, WINDOW, relate
from learn2assemble.tasks.simulator import Simulator
from learn2assemble.tasks.task import PRESETS, Task, get_task
from learn2assemble.tasks.world.blocks import get_action_spec
from learn2assemble.tasks.world.coverage import pixel_vertex, unproject
from learn2assemble.tasks.world.state import State
from learning_data import advance, look_ahead, turned_graph

PITCH = 0.06
_OBJECTS = Task(
    "set-26",
    num_sides=2,
    grid=3,
    num_nodes=20,
    objects="set-26",
    rotations=4,
    reward="scaled",
    success_threshold=0.75,
)
_GRIPPED = Task(
    "gripped",
    num_sides=2,
    grid=3,
    num_nodes=18,
    rotations=4,
    action_mode="grips",
    pitch=PITCH,
    layout="slanted-rows",
    success_threshold=0.75,
    cover_filter="wide",
    normalise_initial=False,
    max_initial_cover=0.6,
)
TASKS = {
    task.name: task
    for task in (
        Task("one", num_sides=1, grid=3, num_nodes=14),
        Task("two", num_sides=2, grid=3, num_nodes=20),
        Task("four", num_sides=4, grid=3, num_nodes=30),
        Task("scaled", num_sides=2, grid=3, num_nodes=20, reward="scaled"),
        Task("turned-cubes", num_sides=2, grid=3, num_nodes=18, rotations=4),
        Task("bars", num_sides=1, grid=4, num_nodes=18, objects="bars", reward="scaled"),
        Task("set-20", num_sides=2, grid=3, num_nodes=20, objects="set-20", rotations=4),
        Task("set-21", num_sides=1, grid=4, num_nodes=20, objects="set-21"),
        _OBJECTS,
        _GRIPPED,
        _GRIPPED.replace(
            name="gripped-set-26", objects="set-26", layout="columns", reward="scaled"
        ),
    )
}
SIMULATORS = {name: Simulator(task) for name, task in TASKS.items()}
some_state = given(
    name=st.sampled_from(list(TASKS)), seed=st.integers(0, 10_000), steps=st.integers(0, 5)
)

Cells = frozenset[tuple[int, int, int]]
Result = tuple[Cells, int, tuple[int, int, int] | None]
"""The cells an action fills, the grip by which it does and the one of them that the hand holds;
without a gripper always 0 and none."""


def whole(positions: np.ndarray) -> list[tuple[int, int, int]]:
    """Centres [m] in whole half edges, which tells apart the cells of a wider lattice, too."""
    return [tuple(cell) for cell in np.rint(positions / HALF).astype(int).tolist()]


class Tried(NamedTuple):
    """Every legal action of one world, made."""

    actions: np.ndarray
    """int64[m, 3], numbers within unplaced and placed blocks, in lexical order."""
    cells: list[Cells]
    """Cells each of them fills."""
    result: list[Result]
    first: list[tuple[int, int, int]]
    """Cell of the chosen block."""
    reward: np.ndarray
    terminated: np.ndarray
    valid: np.ndarray
    gain: np.ndarray


def try_everything(simulator: Simulator, state: State, row: int) -> Tried:
    counts = state.num_unplaced[row], state.num_placed[row], simulator.task.num_actions
    actions = np.indices([int(n) for n in counts]).reshape(3, -1).T
    many = state.take(np.full(len(actions), row))
    placed, before = int(state.num_placed[row]), state.plane_coverage[row]
    step = simulator.step(many, actions)
    filled = [whole(many.position[n, placed : many.num_placed[n]]) for n in range(len(actions))]
    cells = [frozenset(one) for one in filled]
    gripped = simulator.task.action_mode == "grips"
    grips = (actions[:, 2] % simulator.task.rotations * gripped).tolist()
    first = [one[0] for one in filled]
    held = first if gripped else [None] * len(first)
    return Tried(
        actions,
        cells,
        list(zip(cells, grips, held, strict=True)),
        first,
        step.reward,
        step.terminated,
        step.verdict == 0,
        many.plane_coverage - before,
    )


def in_the_way(simulator: Simulator, graph: Graph, row: int, action: np.ndarray) -> int:
    """Waiting cells of other objects that the hand would come down on, beside the chosen one along
    the way its fingers close (y for grasp A, x for B): higher ones, or level ones that are near."""
    if simulator.task.action_mode != "grips":
        return 0
    first = int(graph.num_targets[row] + graph.num_placed[row])
    nodes = graph.nodes[row, first : graph.num_nodes[row], :3].astype(float)
    object_id = graph.object_id[row, first : graph.num_nodes[row]]
    away = np.abs(nodes[:, :2] - nodes[action[0], :2])
    along = 1 if "AABB"[action[2] % 4] == "A" else 0
    levels = np.rint((nodes[:, 2] - nodes[action[0], 2]) / EDGE)
    reach = np.where(levels > 0, 2.25, 1.25) * PITCH
    beside = (away[:, along] < reach) & (away[:, 1 - along] < 0.75 * PITCH) & (levels >= 0)
    return int((beside & (object_id != object_id[action[0]])).sum())


def some_worlds(name: str, seed: int, steps: int, count: int = 2) -> tuple[Simulator, State]:
    """Worlds on their way; at least one."""
    simulator, rng = SIMULATORS[name], np.random.default_rng(seed)
    state = advance(simulator, simulator.new(count, rng), steps, rng)
    return simulator, state if state.batch_size else simulator.new(1, rng)


@some_state
@settings(max_examples=40, deadline=None)
def test_placements_are_what_the_actions_can_make(name: str, seed: int, steps: int) -> None:
    """One placement for every set of cells that some action fills by some grip of one of them: the
    first action that does, or with a gripper the first with the fewest in the way of the hand."""
    simulator, state = some_worlds(name, seed, steps)
    graph = simulator.observe(state)
    found = distinct_placements(graph, simulator.action_spec)
    local = found.action - node_offset(graph)[:, None]
    for row in range(state.batch_size):
        tried = try_everything(simulator, state, row)
        known: dict[Result, int] = {}
        room = [in_the_way(simulator, graph, row, action) for action in tried.actions]
        for number, result in enumerate(tried.result):
            if room[number] < room[known.setdefault(result, number)]:
                known[result] = number
        count = int(found.count[row])
        assert local[row, :count].tolist() == tried.actions[list(known.values())].tolist()
        assert found.used[row].sum() == count == len(known)
        for n, ((cells, *_), number) in enumerate(known.items()):
            members = [int(m) for m in found.members[row, n] if m >= 0]
            there = whole(found.cells[row, members])
            assert len(there) == len(cells)
            assert frozenset(there) == cells
            assert there[0] == tried.first[number], "the chosen block's cell comes first"
        # Cells: all that can be filled, then what only placed blocks fill; each once.
        every = whole(found.cells[row, : found.num_cells[row]])
        assert len(set(every)) == len(every)
        fillable = set().union(*(cells for cells, *_ in known))
        assert set(every[: len(fillable)]) == fillable
        placed = set(whole(state.position[row, : state.num_placed[row]]))
        assert set(every[len(fillable) :]) == placed - fillable


@some_state
@settings(max_examples=25, deadline=None)
def test_keys_and_numbers_are_those_of_the_result(name: str, seed: int, steps: int) -> None:
    """``action_keys`` are equal just where cells and grip are; ``locate`` finds the placement."""
    simulator, state = some_worlds(name, seed, steps)
    graph, spec = simulator.observe(state), simulator.action_spec
    found = distinct_placements(graph, spec)
    for row in range(state.batch_size):
        tried = try_everything(simulator, state, row)
        keys = action_keys(graph, row, spec).ravel().tolist()
        assert len(set(zip(keys, tried.result, strict=True))) == len(set(keys))
        assert len(set(keys)) == len(set(tried.result))
        many = graph.take(np.full(len(keys), row))
        repeated = type(found)(*[field[np.full(len(keys), row)] for field in found])
        action = tried.actions + node_offset(graph)[row]
        number = locate(repeated, many, action, spec)
        assert found.key[row, number].tolist() == keys
        order = list(dict.fromkeys(tried.result))
        assert number.tolist() == [order.index(result) for result in tried.result]


def test_locate_says_where_nothing_is_found() -> None:
    simulator, state = some_worlds("two", 0, 1)
    graph = simulator.observe(state)
    found = distinct_placements(graph, get_action_spec())
    action = found.action[:, 0]
    none = found._replace(count=0 * found.count)
    assert locate(found, graph, action, get_action_spec()).tolist() == [0] * state.batch_size
    assert locate(none, graph, action, get_action_spec()).tolist() == [-1] * state.batch_size


@given(seed=st.integers(0, 1000))
@settings(max_examples=10, deadline=None)
def test_rows_do_not_leak_into_each_other(seed: int) -> None:
    simulator, state = some_worlds("set-26", seed, seed % 4, count=4)
    graph = simulator.observe(state)
    together = distinct_placements(graph, simulator.action_spec)
    for row in range(state.batch_size):
        alone = distinct_placements(graph.take(np.array([row])), simulator.action_spec)
        count, cells = int(alone.count[0]), int(alone.num_cells[0])
        assert together.count[row] == count
        assert together.num_cells[row] == cells
        np.testing.assert_array_equal(together.action[row, :count], alone.action[0, :count])
        np.testing.assert_array_equal(together.key[row, :count], alone.key[0, :count])
        np.testing.assert_array_equal(together.cells[row, :cells], alone.cells[0, :cells])


def test_more_placements_than_fit_at_first() -> None:
    """A wide floor: far more distinct placements than the first capacity of the tables."""
    width = 30
    nodes = np.zeros((1, 3 + width**2 + 1, 5), np.float32)
    x, y = np.divmod(np.arange(width**2), width)
    # Every other cell, so that each has four free neighbours of which two are shared.
    nodes[0, 3:-1, :3] = np.stack([0.1 * x, 0.1 * y, 0 * x + HALF], -1)
    object_id = np.arange(nodes.shape[1], dtype=np.int32)[None]
    counts = [np.array([n]) for n in (3, width**2, nodes.shape[1])]
    found = distinct_placements(Graph(nodes, object_id, *counts), get_action_spec())
    between = 2 * width * (width + 1)
    assert int(found.count[0]) == width**2 + between
    assert int(found.num_cells[0]) == 2 * width**2 + between


def test_nothing_left_to_place() -> None:
    simulator, state = some_worlds("two", 3, 2)
    state.num_blocks[:] = state.num_placed
    graph = simulator.observe(state)
    found = distinct_placements(graph, get_action_spec())
    assert not found.count.any()
    assert found.num_cells.tolist() == state.num_placed.tolist()
    out = simulator.outcomes(state, graph, found)
    assert not any(field.any() for field in out)


# Outcomes.


@some_state
@settings(max_examples=40, deadline=None)
def test_outcomes_are_what_the_steps_bring(name: str, seed: int, steps: int) -> None:
    """Reward, end, validity and gain of every placement against a step of the simulator.

    What is left undecided is exactly what static physics asks the equilibrium program about.
    """
    simulator, state = some_worlds(name, seed, steps)
    before = state.copy()
    found, out = look_ahead(simulator, state)
    for mine, theirs in zip(state, before, strict=True):
        np.testing.assert_array_equal(mine, theirs)
    assert out.reward.dtype == out.gain.dtype == np.float32
    asked: set[Cells] = set()
    equilibrium = static_module._equilibrium

    def spy(centres: np.ndarray, object_id: np.ndarray) -> int:
        asked.add(frozenset(whole(centres[object_id == object_id[-1]])))
        return equilibrium(centres, object_id)

    for row in range(state.batch_size):
        asked.clear()
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(static_module, "_equilibrium", spy)
            tried = try_everything(simulator, state, row)
        first = list({made: n for n, made in reversed(list(enumerate(tried.result)))}.values())
        first.sort()
        count = int(found.count[row])
        assert len(first) == count
        known = out.valid[row, :count] | out.terminal[row, :count]
        undecided = {tried.cells[n] for n, k in zip(first, known, strict=True) if not k}
        assert undecided == asked
        at = np.array(first)[known]
        for mine, theirs in (
            (out.reward, tried.reward.astype(np.float32)),
            (out.terminal, tried.terminated),
            (out.valid, tried.valid),
        ):
            np.testing.assert_array_equal(mine[row, :count][known], theirs[at])
            assert not mine[row, :count][~known].any()
            assert not mine[row, count:].any()
        gain = np.where(tried.valid[at], tried.gain[at], 0)
        np.testing.assert_allclose(out.gain[row, :count][known], gain, atol=1e-6)
        assert not out.gain[row, count:].any()


def test_outcomes_of_every_kind_occur() -> None:
    """So that the comparison above says something: good and bad ends, and open questions."""
    valid = invalid = final = undecided = negative = 0
    for name, steps in (("two", 4), ("set-26", 2), ("set-26", 3), ("set-20", 3)):
        simulator, state = some_worlds(name, 1, steps, count=10)
        found, out = look_ahead(simulator, state)
        valid += int((out.valid & ~out.terminal).sum())
        invalid += int((out.terminal & ~out.valid).sum())
        final += int((out.terminal & out.valid).sum())
        undecided += int((~(out.terminal | out.valid) & found.used).sum())
        negative += int((out.gain < 0).sum())
    assert min(valid, invalid, final, undecided, negative) > 0


def test_the_last_object_ends_the_episode() -> None:
    simulator, state = some_worlds("two", 0, 1, count=8)
    state.num_blocks[1] = state.num_placed[1] + 1
    _, out = look_ahead(simulator, state)
    assert out.valid[1].any()
    assert out.terminal[1][out.valid[1]].all()
    assert not out.terminal[0][out.valid[0]].all()


# Distinct placements as actions of an environment.

SMALL = "two-sided-3x3-20-24"
some_preset = st.sampled_from(sorted(PRESETS))


def make(name: str = SMALL, **kwargs) -> AssemblyEnv:
    env = gymnasium.make(env_id(name), actions="placements", **kwargs).unwrapped
    assert isinstance(env, AssemblyEnv)
    return env


@pytest.mark.parametrize("name", PRESETS)
def test_gymnasium_accepts_every_preset(name: str) -> None:
    check_env(make(name), skip_render_check=True)


@settings(max_examples=15, deadline=None)
@given(some_preset, st.integers(0, 2**32))
def test_a_placement_does_what_its_flat_action_does(name: str, seed: int) -> None:
    """All along one episode; only the observation of the compact one says more."""
    flat, compact, rng = AssemblyEnv(name), make(name), np.random.default_rng(seed)
    (_, other), (seen, info) = flat.reset(seed=seed), compact.reset(seed=seed)
    ended = False
    while not ended:
        choices = np.flatnonzero(info["physics_mask"])
        if not len(choices):
            choices = np.flatnonzero(info["action_masks"])
        number = int(rng.choice(choices))
        graph = compact.simulator.observe(compact.state)
        placements = distinct_placements(graph, compact.simulator.action_spec)
        filled = placements.members[0, number]
        middle = placements.cells[0, filled[filled >= 0]].mean(0)
        assert np.allclose(seen["placements"][number], middle, atol=1e-6)
        action = int(flatten_action(flat.task, *placements.action[0, number].tolist()))
        assert other["action_masks"][action]
        assert other["physics_mask"][action] == info["physics_mask"][number]
        told, expected = compact.step(number), flat.step(action)
        assert told[1:4] == expected[1:4]
        assert data_equivalence({key: told[0][key] for key in expected[0]}, expected[0], exact=True)
        assert {k: v for k, v in told[4].items() if "mask" not in k} == {
            k: v for k, v in expected[4].items() if "mask" not in k
        }
        (seen, _, ended, _, info), other = told, expected[4]


@settings(max_examples=15, deadline=None)
@given(some_preset, st.integers(0, 2**32))
def test_the_mask_holds_every_result_of_the_flat_actions_once(name: str, seed: int) -> None:
    env, rng = make(name), np.random.default_rng(seed)
    _, info = env.reset(seed=seed)
    for _ in range(3):
        stable = np.flatnonzero(info["physics_mask"])
        if not len(stable):
            break
        _, _, ended, _, info = env.step(int(rng.choice(stable)))
        if ended:
            break
    mask = env.action_masks()
    assert mask.dtype == np.bool_
    assert env.action_space == Discrete(len(mask))
    assert len(mask) == num_placement_actions(env.task)
    assert np.array_equal(mask, info["action_masks"].astype(bool))
    assert not (info["physics_mask"].astype(bool) & ~mask).any()
    graph = env.simulator.observe(env.state)
    placements = distinct_placements(graph, env.simulator.action_spec)
    count = int(placements.count[0]) if not env.state.terminated[0] else 0
    assert mask.sum() == count
    assert mask[:count].all()
    assert len(set(placements.key[0, :count].tolist())) == count
    flat = AssemblyEnv(name)
    flat.state = env.state.copy()
    flat._started = True
    local = placements.action[0, :count] - node_offset(graph)[0]
    numbers = flatten_action(env.task, *placements.action[0, :count].T)
    resolved = [resolve_actions(env.task, env.state, numbers[n : n + 1]) for n in range(count)]
    assert all(np.array_equal(a[0], b) and not c for (a, c), b in zip(resolved, local, strict=True))


def test_padding_is_refused() -> None:
    env = make()
    _, info = env.reset(seed=0)
    before = env.state.copy()
    padding = int(np.flatnonzero(~env.action_masks())[0])
    _, reward, ended, truncated, info = env.step(padding)
    assert (reward, ended, truncated) == (-1.0, True, False)
    assert info["verdict"] == REFUSED
    assert not info["success"]
    assert not info["action_masks"].any()
    assert np.array_equal(env.state.position, before.position)
    assert env.state.num_placed[0] == before.num_placed[0]


def test_the_vector_environment_refuses_padding_as_single_ones_do() -> None:
    rng, count = np.random.default_rng(0), 4
    vector = AssemblyVectorEnv(SMALL, count, actions="placements")
    single = gymnasium.vector.SyncVectorEnv(
        [lambda: AssemblyEnv(SMALL, actions="placements")] * count,
        autoreset_mode=AutoresetMode.NEXT_STEP,
    )
    vector.reset(seed=3)
    single.reset(seed=3)
    verdicts: set[str | None] = set()
    for _ in range(12):
        actions = rng.integers(0, 40, count)
        told, expected = vector.step(actions), single.step(actions)
        assert data_equivalence(told[0], expected[0], exact=True)
        assert all(np.array_equal(a, b) for a, b in zip(told[1:4], expected[1:4], strict=True))
        told, expected = (one[4].get("verdict", np.empty(0)).tolist() for one in (told, expected))
        assert told == expected
        verdicts |= set(told)
    assert REFUSED in verdicts


def test_it_is_compact() -> None:
    assert num_placement_actions(get_task(SMALL)) == 115


def test_a_wrong_kind_gets_the_nearest_one() -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'placements'"):
        AssemblyEnv(SMALL, actions="placement")


RELATED_TASKS = {
    sides: Task(f"{sides}-sided", num_sides=sides, grid=3, num_nodes=14 + 6 * (sides - 1))
    for sides in (1, 2, 3, 4)
}
RELATED_TASKS[5] = Task("robot", num_sides=4, grid=3, num_nodes=30, pitch=0.06)
OBJECTS = Task("objects", num_sides=2, grid=3, num_nodes=20, objects="set-26", rotations=4)
FAR = 10.0


def random_outline(count: int, rng: np.random.Generator) -> np.ndarray:
    """A simple polygon with ``count`` corners (x, z) [m], star-shaped, either orientation."""
    angle = np.sort(rng.uniform(0, 2 * np.pi, count))
    radius = rng.uniform(0.03, 0.14, count)
    centre = [rng.uniform(-0.03, 0.03), 0.1]
    outline = np.stack([np.cos(angle), np.sin(angle)], -1) * radius[:, None] + centre
    return outline if rng.random() < 0.5 else outline[::-1]


def in_frame(frame: np.ndarray, world: np.ndarray) -> np.ndarray:
    """World points [m] in local coordinates of a side."""
    c, s, tx, ty = frame
    x, y = world[..., 0] - tx, world[..., 1] - ty
    return np.stack([c * x + s * y, c * y - s * x, world[..., 2]], -1)


def related_state(task: Task, seed: int, count: int = 1) -> tuple[Simulator, State]:
    simulator, rng = Simulator(task), np.random.default_rng(seed)
    state = advance(simulator, simulator.new(count, rng), seed % 4, rng)
    return simulator, state if state.batch_size else simulator.new(1, rng)


def half_plane(a: np.ndarray, b: np.ndarray, inward: np.ndarray) -> shapely.Polygon:
    """Everything within some metres on the inner side of the line through a and b."""
    along = (b - a) / np.linalg.norm(b - a) * FAR
    return shapely.Polygon(
        [a - along, b + along, b + along + FAR * inward, a - along + FAR * inward]
    )


@pytest.mark.parametrize("drawn", [False, True], ids=["sampled", "random"])
@given(number=st.sampled_from([1, 2, 3, 4, 5]), seed=st.integers(0, 10_000))
@settings(max_examples=15, deadline=None)
def test_edges_against_polygons(drawn: bool, number: int, seed: int) -> None:
    """Normals, distances, margins, corners, depth and area of every cell and side."""
    simulator, state = related_state(RELATED_TASKS[number], seed)
    sides = RELATED_TASKS[number].num_sides
    if drawn:
        rng = np.random.default_rng(seed)
        for side in range(sides):
            count = int(state.num_vertices[0, side])
            state.vertices[0, side, :count] = random_outline(count, rng)
    graph = simulator.observe(state)
    placements = distinct_placements(graph, simulator.action_spec)
    found = relate(graph, placements, simulator.task.pitch)
    area = 0.0
    for side in range(sides):
        outline = state.vertices[0, side, : state.num_vertices[0, side]]
        assume(abs(outline[0, 0] - outline[-1, 0]) > 1e-3)
        corners = np.array([unproject(*pixel_vertex(x, z)) for x, z in outline])
        polygon = shapely.Polygon(corners)
        # A corner on another edge, up to rounding, leaves no inner side to compare with.
        assume(
            polygon.is_valid and shapely.minimum_clearance(polygon) > 1e-4 and polygon.area > 1e-4
        )
        assume(min(np.linalg.norm(corners - np.roll(corners, 1, 0), axis=1)) > 1e-3)
        area += polygon.area / EDGE**2
        convex = polygon.convex_hull.area - polygon.area < 1e-9
        count = len(outline)
        assert found.edge_used[0, side].tolist() == [
            k < count for k in range(found.edge_used.shape[2])
        ]
        x, y, z = in_frame(simulator.frames[side], placements.cells[0].astype(float)).T
        faces = shapely.box(x - HALF, z - HALF, x + HALF, z + HALF)
        ends = shapely.points(shapely.get_coordinates(faces).reshape(len(faces), -1, 2))
        centres = shapely.points(x, z)
        for k in range(count):
            a, b = corners[k], corners[(k + 1) % count]
            out = found.edges[0, : len(faces), side, k].astype(float)
            ways, number_of = np.unique(out[:, :2], axis=0, return_inverse=True)
            assert np.linalg.norm(ways, axis=1) == pytest.approx(1, abs=1e-5)
            assert ways @ (b - a) == pytest.approx(0, abs=1e-6)
            assert all(polygon.contains(shapely.Point((a + b) / 2 + 1e-6 * way)) for way in ways)
            inner = np.array([half_plane(a, b, way) for way in ways])[number_of]
            outer = np.array([half_plane(a, b, -way) for way in ways])[number_of]
            inside = (shapely.distance(centres, outer) - shapely.distance(centres, inner)) / EDGE
            assert out[:, 2] == pytest.approx(np.clip(inside, -4, 4) / 2, abs=1e-4)
            # How deep the face reaches into the inner side; negative: how far it is away.
            deepest = shapely.distance(ends, outer[:, None]).max(1)
            margin = (deepest - shapely.distance(faces, inner)) / EDGE
            assert out[:, 3] == pytest.approx(np.clip(margin, -1, 1), abs=1e-4)
            assert out[:, 4] == pytest.approx(np.clip(8 * margin, -1, 1), abs=1e-3)
            if convex:
                assert not shapely.intersects(faces[margin < -1e-4], polygon).any()
            for column, point in ((5, a), (7, b)):
                offset = np.clip((point - np.stack([x, z], 1)) / EDGE, -6, 6) / 2
                np.testing.assert_allclose(out[:, column : column + 2], offset, atol=1e-4)
            assert out[:, 9] == pytest.approx(np.clip(-y / EDGE, -2, 2), abs=1e-4)
            assert out[:, 10].tolist() == (np.abs(y) < EDGE / 4).tolist()
            assert (out[:, 11] == (count == 5 and k in (1, 2))).all()
            assert out[:, 12] == pytest.approx(z / EDGE / 4, abs=1e-4)
    assert found.area[0] == pytest.approx(area, rel=1e-4)


@given(
    number=st.sampled_from([1, 2, 3, 4, 5]), seed=st.integers(0, 10_000), sight=st.integers(0, 3)
)
@settings(max_examples=25, deadline=None)
def test_offsets_written_out(number: int, seed: int, sight: int) -> None:
    """To every placed block in sight, in whole cells in the frame of every side; else padding."""
    simulator, state = related_state(RELATED_TASKS[number], seed, count=2)
    graph, pitch = simulator.observe(state), simulator.task.pitch
    placements = distinct_placements(graph, simulator.action_spec)
    found = relate(graph, placements, pitch, sight)
    for row in range(state.batch_size):
        placed = int(state.num_placed[row])
        assert (found.offsets[row, :, :, placed:] == OFFSETS).all()
        for c in range(int(placements.num_cells[row])):
            for side, frame in enumerate(simulator.frames):
                mine = in_frame(frame, placements.cells[row, c].astype(float))
                theirs = in_frame(frame, state.position[row, :placed])
                # Right, towards the viewer, up.
                steps = np.rint((theirs - mine) * [1, -1, 1] / [pitch, pitch, EDGE]).astype(int)
                i, j, k = (np.clip(steps, -REACH, REACH) + REACH).T
                numbers = (i * WINDOW + j) * WINDOW + k
                if sight:
                    numbers[np.abs(steps).max(1) > sight] = OFFSETS
                assert found.offsets[row, c, side, :placed].tolist() == numbers.tolist()


def rows_by_cell(graph: Graph, placements: Placements, row: int) -> dict[tuple, int]:
    at = np.rint(placements.cells[row, : placements.num_cells[row]] / HALF).astype(int)
    return {tuple(cell): n for n, cell in enumerate(at.tolist())}


@pytest.mark.parametrize(
    ("task", "quarters"),
    [
        (RELATED_TASKS[2], 2),
        (OBJECTS, 2),
        (RELATED_TASKS[4], 1),
        (RELATED_TASKS[4], 2),
        (RELATED_TASKS[4], 3),
    ],
    ids=["two", "objects", "four-90", "four-180", "four-270"],
)
@given(seed=st.integers(0, 10_000))
@settings(max_examples=15, deadline=None)
def test_turning_the_world_changes_nothing(task: Task, quarters: int, seed: int) -> None:
    """Turned with its sides exchanged, every cell sees the same from the side that is now there."""
    simulator, state = related_state(task, seed, count=2)
    graph = simulator.observe(state)
    turn = turned_graph(graph, task.num_sides, quarters)
    mine, theirs = (distinct_placements(g, task.action_spec) for g in (graph, turn.graph))
    before, after = relate(graph, mine), relate(turn.graph, theirs)
    np.testing.assert_array_equal(mine.num_cells, theirs.num_cells)
    np.testing.assert_allclose(before.area, after.area, rtol=1e-5)
    for row in range(state.batch_size):
        where = rows_by_cell(turn.graph, theirs, row)
        cells = turn.points(mine.cells[row, : mine.num_cells[row]].astype(float))
        order = [where[tuple(cell)] for cell in np.rint(cells / HALF).astype(int).tolist()]
        for side in range(task.num_sides):
            other = turn.sides[side]
            np.testing.assert_array_equal(before.edge_used[row, side], after.edge_used[row, other])
            np.testing.assert_allclose(
                before.edges[row, : len(order), side], after.edges[row, order, other], atol=1e-4
            )
            np.testing.assert_array_equal(
                before.offsets[row, : len(order), side], after.offsets[row, order, other]
            )
