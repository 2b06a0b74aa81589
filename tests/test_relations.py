"""Relations of cells to outlines and blocks: against polygons, and when the world is turned."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from learn2assemble.constants import EDGE, HALF
from learn2assemble.tasks.graph.features import Graph
from learn2assemble.tasks.graph.placements import Placements, distinct_placements
from learn2assemble.tasks.graph.relations import OFFSETS, REACH, WINDOW, relate
from learn2assemble.tasks.simulator import Simulator
from learn2assemble.tasks.task import Task
from learn2assemble.tasks.world.coverage import pixel_vertex, unproject
from learn2assemble.tasks.world.state import State
from learning_data import advance, turned_graph

TASKS = {
    sides: Task(f"{sides}-sided", num_sides=sides, grid=3, num_nodes=14 + 6 * (sides - 1))
    for sides in (1, 2, 3, 4)
}
TASKS[5] = Task("robot", num_sides=4, grid=3, num_nodes=30, pitch=0.06)
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


def some_state(task: Task, seed: int, count: int = 1) -> tuple[Simulator, State]:
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
    simulator, state = some_state(TASKS[number], seed)
    sides = TASKS[number].num_sides
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
    simulator, state = some_state(TASKS[number], seed, count=2)
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
    [(TASKS[2], 2), (OBJECTS, 2), (TASKS[4], 1), (TASKS[4], 2), (TASKS[4], 3)],
    ids=["two", "objects", "four-90", "four-180", "four-270"],
)
@given(seed=st.integers(0, 10_000))
@settings(max_examples=15, deadline=None)
def test_turning_the_world_changes_nothing(task: Task, quarters: int, seed: int) -> None:
    """Turned with its sides exchanged, every cell sees the same from the side that is now there."""
    simulator, state = some_state(task, seed, count=2)
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
