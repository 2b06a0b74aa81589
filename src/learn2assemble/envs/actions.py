"""Numbers of actions, flat or of distinct placements, and masks over them."""

from __future__ import annotations

from typing import NamedTuple, TypeVar

import numpy as np

from learn2assemble.constants import HALF
from learn2assemble.kernels import kernel
from learn2assemble.tasks.graph.features import Graph, empty_graph, graph_row, node_offset
from learn2assemble.tasks.graph.placements import distinct_placements
from learn2assemble.tasks.physics.support import STABLE, UNDECIDED, classify_cube
from learn2assemble.tasks.simulator import (
    Simulator,
    StepArrays,
    WorldTransition,
    advance,
    step_arrays,
)
from learn2assemble.tasks.task import Task
from learn2assemble.tasks.world.rules import Rules, target_cell
from learn2assemble.tasks.world.state import State


def num_flat_actions(task: Task) -> int:
    """N * N * Na, the size of the flat action space and of both masks."""
    return task.num_nodes * task.num_nodes * task.num_actions


def num_placement_actions(task: Task) -> int:
    """No state of the task has more distinct placements than this.

    Each is an object beside one of P placed cells, by one of five relations. Cubes are alike and
    differ by the grip at most; of other objects each of the waiting cells may be the chosen one.
    """
    placed, spec = task.max_blocks - 1, task.action_spec
    if task.objects == "cubes":
        return 5 * placed * len(np.unique(spec.grips))
    half = task.max_blocks // 2
    return task.num_actions * half * (task.max_blocks - half)


INVALID = -1.0
"""Reward of an action that is refused, as of an invalid placement."""
Index = TypeVar("Index", int, np.ndarray)
"""Numbers of actions or nodes."""


def flatten_action(task: Task, i: Index, j: Index, k: Index) -> Index:
    """(i, j, k) to the flat index; integers or arrays of one shape."""
    return (i * task.num_nodes + j) * task.num_actions + k


def unflatten_action(task: Task, action: Index) -> tuple[Index, Index, Index]:
    """Flat index to (i, j, k); an integer or an array."""
    pair = action // task.num_actions
    return pair // task.num_nodes, pair % task.num_nodes, action % task.num_actions


# These two take single fields: handing a whole State to compiled code costs more than the work.
@kernel
def _resolve(
    num_vertices: np.ndarray,
    num_placed: np.ndarray,
    num_blocks: np.ndarray,
    flat: np.ndarray,
    num_nodes: int,
    num_actions: int,
    actions: np.ndarray,
    clipped: np.ndarray,
) -> None:
    for row in range(len(flat)):
        targets = num_vertices[row].sum()
        placed, blocks = num_placed[row], num_blocks[row]
        pair = flat[row] // num_actions
        i, j = pair // num_nodes - targets - placed, pair % num_nodes - targets
        unplaced = max(min(i, blocks - placed - 1), 0)
        reference = max(min(j, placed - 1), 0)
        actions[row, 0], actions[row, 1] = unplaced, reference
        actions[row, 2] = flat[row] % num_actions
        clipped[row] = unplaced != i or reference != j


@kernel
def _fill(
    num_vertices: np.ndarray,
    num_placed: np.ndarray,
    num_blocks: np.ndarray,
    terminated: np.ndarray,
    allowed: np.ndarray,
    mask: np.ndarray,
) -> None:
    last = allowed.shape[1] - 1
    for row in range(len(mask)):
        if terminated[row]:
            continue
        targets = num_vertices[row].sum()
        placed, blocks = num_placed[row], num_blocks[row]
        for i in range(targets + placed, targets + blocks):
            for j in range(placed):
                for k in range(mask.shape[3]):
                    mask[row, i, targets + j, k] = allowed[
                        row, min(i - targets - placed, last), j, k
                    ]


@kernel
def _middles(cells: np.ndarray, members: np.ndarray, count: np.ndarray, out: np.ndarray) -> None:
    """Middle of the cells that every placement fills; members are numbers of cells, -1 for none."""
    for row in range(len(count)):
        for n in range(count[row]):
            filled = 0
            for member in members[row, n]:
                if member >= 0:
                    filled += 1
                    for axis in range(3):
                        out[row, n, axis] += cells[row, member, axis]
            for axis in range(3):
                out[row, n, axis] /= max(filled, 1)


@kernel
def _named(
    local: np.ndarray,
    count: np.ndarray,
    terminated: np.ndarray,
    allowed: np.ndarray,
    mask: np.ndarray,
) -> None:
    """Which placements are allowed, of those that are named by local indices."""
    last = allowed.shape[1] - 1
    for row in range(len(count)):
        if not terminated[row]:
            for n in range(count[row]):
                block, reference, way = local[row, n]
                mask[row, n] = allowed[row, min(block, last), reference, way]


@kernel
def _see(
    state: State,
    frames: np.ndarray,
    pitch: float,
    rotations: int,
    surveys: bool,
    nodes: np.ndarray,
    object_id: np.ndarray,
    counts: np.ndarray,
    coverage: np.ndarray,
    masks: np.ndarray,
) -> int:
    """Graph, coverage and masks of all rows; returns what placements of cubes are undecided."""
    undecided = 0
    legal, stable = masks[0], masks[1]
    for row in range(len(nodes)):
        graph_row(state, row, frames, nodes, object_id, counts)
        start = state.initial_pixels[row]
        span = state.mask_pixels[row] - start
        coverage[0, row] = (state.complete_pixels[row] - start) / span
        coverage[1, row] = (state.plane_pixels[row] - start) / span
        if state.terminated[row]:
            continue
        targets, placed, blocks = counts[0, row], counts[1, row], state.num_blocks[row]
        for j in range(placed):
            found = UNDECIDED
            for k in range(legal.shape[3]):
                if surveys and k % rotations == 0:
                    x, y, z = target_cell(state, row, j, k // rotations, pitch)
                    found = classify_cube(state.position[row], placed, x, y, z, HALF)
                    undecided += found == UNDECIDED
                for i in range(targets + placed, targets + blocks):
                    legal[row, i, targets + j, k] = True
                    stable[row, i, targets + j, k] = found == STABLE
    return undecided


@kernel
def _step(
    state: State,
    flat: np.ndarray,
    rules: Rules,
    actions: np.ndarray,
    clipped: np.ndarray,
    arrays: StepArrays,
    rotations: int,
    surveys: bool,
    nodes: np.ndarray,
    object_id: np.ndarray,
    counts: np.ndarray,
    coverage: np.ndarray,
    masks: np.ndarray,
) -> tuple[int, int]:
    """Resolve flat actions, carry them out and see what there is then; returns how many rows are
    still to be judged, and how many placements behind that are undecided.

    One call, as handing the state over three times costs more than the work on one world.
    """
    _, num_nodes, _, num_actions = masks.shape[1:]
    _resolve(
        state.num_vertices,
        state.num_placed,
        state.num_blocks,
        flat,
        num_nodes,
        num_actions,
        actions,
        clipped,
    )
    spec, _, _, frames, _, _, _ = rules
    left = advance(state, actions, rules, arrays)
    undecided = 0
    if left == 0:
        undecided = _see(
            state,
            frames,
            spec.pitch,
            rotations,
            surveys,
            nodes,
            object_id,
            counts,
            coverage,
            masks,
        )
    return left, undecided


@kernel
def outside(numbers: np.ndarray, size: int) -> bool:
    """Whether any of the numbers int[B] is not in ``0..size-1``."""
    found = False
    for number in numbers:
        found |= number < 0 or number >= size
    return found


def resolve_actions(task: Task, state: State, flat: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Flat actions to what :meth:`Simulator.step` wants, clipped like the published code.

    An i outside the unplaced nodes becomes the nearest of them, likewise j and the placed nodes.

    Args:
        flat: int64[B], each in ``0..N*N*Na-1``.

    Returns:
        int64[B, 3] (number of the unplaced block, number of the reference block, action) and
        bool[B], where clipping changed the action.
    """
    actions = np.empty((len(flat), 3), np.int64)
    clipped = np.empty(len(flat), np.bool_)
    _resolve(
        state.num_vertices,
        state.num_placed,
        state.num_blocks,
        flat,
        task.num_nodes,
        task.num_actions,
        actions,
        clipped,
    )
    return actions, clipped


def expand_mask(task: Task, state: State, allowed: np.ndarray) -> np.ndarray:
    """A mask over placements as a mask over flat actions.

    Args:
        allowed: bool[B, M, Na] over (reference, action), where any unplaced block may go, or
            bool[B, M, M, Na] over (unplaced block, reference, action); see
            :meth:`Simulator.physics_mask`.

    Returns:
        bool[B, N * N * Na]; all False for worlds that have ended.
    """
    n = task.num_nodes
    mask = np.zeros((state.batch_size, n, n, task.num_actions), np.bool_)
    if allowed.ndim == 3:
        allowed = allowed[:, None]
    _fill(state.num_vertices, state.num_placed, state.num_blocks, state.terminated, allowed, mask)
    return mask.reshape(state.batch_size, -1)


class Seen(NamedTuple):
    """What observations and infos say of the states of B worlds; A numbers of actions."""

    graph: Graph
    legal: np.ndarray
    """bool[B, A]: i unplaced, j placed, no padding, world not ended."""
    stable: np.ndarray
    """bool[B, A]: legal, free and stable by static physics; nothing where it was not asked for."""
    coverage: np.ndarray
    """float64[B]: F_co."""
    plane_coverage: np.ndarray
    """float64[B]: F_pl."""


class Stepped(NamedTuple):
    """What actions did to B worlds."""

    done: WorldTransition
    clipped: np.ndarray
    """bool[B]: the action was an illegal one, and became the nearest legal one."""
    refused: np.ndarray
    """bool[B]: the action was padding, so nothing was placed."""
    seen: Seen | None
    """What there is to say of the states then; None where nobody has looked yet."""


class FlatActions:
    """What the number of an action means: the flat index of the published triple.

    Args:
        simulator: of the worlds.
    """

    def __init__(self, simulator: Simulator) -> None:
        self.simulator: Simulator = simulator
        self.task: Task = simulator.task
        self.size: int = num_flat_actions(simulator.task)
        self._cubes = simulator.task.objects == "cubes"

    def see(self, state: State, surveys: bool) -> Seen:
        """What there is to say of a state; everything else is asked of the one seen last.

        Args:
            surveys: whether it is said what static physics lets stand.
        """
        task, views = self.task, self._views(state.batch_size)
        undecided = _see(
            state,
            self.simulator.frames,
            task.pitch,
            task.rotations,
            surveys and self._cubes,
            *views,
        )
        return self._seen(state, views, undecided, surveys)

    def _views(self, batch: int) -> tuple[np.ndarray, ...]:
        """Arrays that are seen: graph, coverage and masks."""
        n = self.task.num_nodes
        masks = np.zeros((2, batch, n, n, self.task.num_actions), np.bool_)
        return *empty_graph(batch, n), np.empty((2, batch)), masks

    def _seen(
        self, state: State, views: tuple[np.ndarray, ...], undecided: int, surveys: bool
    ) -> Seen:
        nodes, object_id, counts, coverage, masks = views
        flat = masks.reshape(2, len(nodes), -1)
        # Indexed, as taking an array apart costs as much as the compiled call.
        legal, stable = flat[0], flat[1]
        if surveys and (undecided or not self._cubes):
            stable = expand_mask(self.task, state, self.simulator.physics_mask(state))
        graph = Graph(nodes, object_id, counts[0], counts[1], counts[2])
        return Seen(graph, legal, stable, coverage[0], coverage[1])

    def step(self, state: State, numbers: np.ndarray, surveys: bool) -> Stepped:
        """Carry out an action in every world, in place.

        Args:
            numbers: int64[B].
            surveys: whether it is said what static physics lets stand then.
        """
        simulator, batch = self.simulator, len(numbers)
        refused = np.zeros(batch, np.bool_)
        if not simulator.decides:
            actions, clipped = resolve_actions(self.task, state, numbers)
            return Stepped(simulator.step(state, actions), clipped, refused, None)
        actions, clipped = np.empty((batch, 3), np.int64), np.empty(batch, np.bool_)
        arrays, views = step_arrays(batch), self._views(batch)
        left, undecided = _step(
            state,
            numbers,
            simulator.rules,
            actions,
            clipped,
            arrays,
            self.task.rotations,
            surveys and self._cubes,
            *views,
        )
        done = simulator.finish(state, arrays, left)
        seen = None if left else self._seen(state, views, undecided, surveys)
        return Stepped(done, clipped, refused, seen)


class PlacementActions:
    """The number of a distinct placement, in the order of :func:`distinct_placements`.

    Numbers from the number of placements on are padding. They are never in a mask, and are
    refused: nothing is placed, and the episode ends as with an invalid placement.

    Args:
        simulator: of the worlds.
    """

    def __init__(self, simulator: Simulator) -> None:
        self.simulator: Simulator = simulator
        self.size: int = num_placement_actions(simulator.task)

    def see(self, state: State, surveys: bool) -> Seen:
        """See :meth:`FlatActions.see`: placements are found once for every state."""
        graph = self.simulator.observe(state)
        self._found = distinct_placements(graph, self.simulator.action_spec)
        local = self._found.action - node_offset(graph)[:, None]
        self._local = local * self._found.used[..., None]
        offered = np.where(state.terminated, 0, self._found.count)
        legal = np.arange(self.size) < offered[:, None]
        stable = np.zeros((state.batch_size, self.size), np.bool_)
        if surveys:
            good = self.simulator.physics_mask(state)
            named = good[:, None] if good.ndim == 3 else good
            _named(self._local, self._found.count, state.terminated, named, stable)
        return Seen(graph, legal, stable, state.complete_coverage, state.plane_coverage)

    def describe(self) -> np.ndarray:
        """float32[B, size, 3]: middle of the cells that every placement fills [m, world]; zeros
        in the padding."""
        found = self._found
        out = np.zeros((len(found.count), self.size, 3), np.float32)
        _middles(found.cells, found.members, found.count, out)
        return out

    def step(self, state: State, numbers: np.ndarray, surveys: bool) -> Stepped:
        """As :meth:`FlatActions.step`, of what was seen last; none is clipped, and the padding is
        refused, which ends an episode as an invalid placement does."""
        padding = numbers >= self._found.count
        chosen = self._local[np.arange(len(numbers)), np.where(padding, 0, numbers)]
        refused = padding & ~state.terminated
        state.terminated[refused] = True
        done = self.simulator.step(state, chosen)
        done.reward[refused], done.terminated[refused] = INVALID, True
        return Stepped(done, np.zeros(len(numbers), np.bool_), refused, None)


ACTION_SPACES: dict[str, type[FlatActions] | type[PlacementActions]] = {
    "flat": FlatActions,
    "placements": PlacementActions,
}
"""Meanings of the number of an action, by name."""
