"""The transition of a task: reset, step, snapshot and observation of many worlds at once.

One step is `placement -> rules -> physics -> coverage -> reward -> state`. Everything above
(environments, search, learning, evaluation) uses this class and nothing below it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from learn2assemble.errors import Learn2AssembleError
from learn2assemble.kernels import kernel
from learn2assemble.tasks.checkers import resolve_checker
from learn2assemble.tasks.graph.features import Graph, build_graph, node_offset
from learn2assemble.tasks.graph.placements import Placements
from learn2assemble.tasks.physics.protocol import Physics
from learn2assemble.tasks.physics.static import (
    StaticPhysics,
    classify_last,
    survey,
    survey_objects,
)
from learn2assemble.tasks.physics.support import STABLE, UNDECIDED
from learn2assemble.tasks.task import MAX_VERTICES, Task, get_task
from learn2assemble.tasks.world.blocks import ActionSpec, inventory
from learn2assemble.tasks.world.coverage import FILTERS, DepthFilter
from learn2assemble.tasks.world.layouts import (
    Problems,
    sample_problem,
    side_frames,
    waiting_places,
)
from learn2assemble.tasks.world.outcomes import Outcomes, outcomes
from learn2assemble.tasks.world.rules import (
    REWARDS,
    Rules,
    count_row,
    cover_block,
    last_object,
    move_block,
    move_cell,
    recover_all,
    reward_and_end,
    target_cell,
    waiting_level,
)
from learn2assemble.tasks.world.state import State, empty_state


class WorldTransition(NamedTuple):
    """What one step did; arrays over the batch. Rows that had already ended report zeros."""

    reward: np.ndarray
    """float64[B]."""
    terminated: np.ndarray
    """bool[B]."""
    success: np.ndarray
    """bool[B]: the target is filled and everything stands."""
    verdict: np.ndarray
    """int8[B] of `physics.protocol.PlacementVerdict`."""


class StepArrays(NamedTuple):
    """What :func:`advance` writes into; few arrays, as each costs where one world is stepped."""

    reward: np.ndarray
    """float64[B]."""
    flags: np.ndarray
    """bool[2, B]: whether it has ended; success."""
    verdict: np.ndarray
    """int8[B]."""
    rows: np.ndarray
    """int64[3, B]: plane-filtered cover before; rows still to be judged; rows that were."""


def step_arrays(batch: int) -> StepArrays:
    """Nothing has flags yet."""
    return StepArrays(
        np.zeros(batch),
        np.zeros((2, batch), np.bool_),
        np.zeros(batch, np.int8),
        np.empty((3, batch), np.int64),
    )


@kernel
def _propose_cubes(
    state: State, actions: np.ndarray, rotations: int, pitch: float, previous: np.ndarray
) -> None:
    # Apart from _propose, as a choice inside the loop would double its cost.
    for row in range(len(actions)):
        previous[row] = state.plane_pixels[row]
        if not state.terminated[row]:
            reference, relation = actions[row, 1], actions[row, 2] // rotations
            x, y, z = target_cell(state, row, reference, relation, pitch)
            source = state.num_placed[row] + actions[row, 0]
            move_cell(state, row, source, reference, x, y, z)


@kernel
def _propose(state: State, actions: np.ndarray, spec: ActionSpec, previous: np.ndarray) -> None:
    for row in range(len(actions)):
        previous[row] = state.plane_pixels[row]
        if not state.terminated[row]:
            unplaced, reference = actions[row, 0], actions[row, 1]
            relation, way = divmod(actions[row, 2], len(spec.turns))
            x, y, z = target_cell(state, row, reference, relation, spec.pitch)
            if spec.level:
                z += waiting_level(state.position[row, state.num_placed[row] + unplaced, 2])
            turn = int(spec.turns[way])
            move_block(state, row, unplaced, reference, x, y, z, turn, spec.pitch)


@kernel
def _score(
    state: State, rows: np.ndarray, rules: Rules, arrays: StepArrays, recompute: bool
) -> None:
    _, _, _, frames, depths, kind, threshold = rules
    reward, (ended, success), verdict, (previous, _, _) = arrays
    for row in rows:
        if recompute:
            recover_all(state, row, frames, depths)
        else:
            for block in range(last_object(state, row), state.num_placed[row]):
                cover_block(state, row, frames, block, depths)
        count_row(state, row)
        reward[row], ended[row], success[row] = reward_and_end(
            state, row, int(previous[row]), verdict[row] == STABLE, kind, threshold
        )
        state.terminated[row] = ended[row]


@kernel
def advance(state: State, actions: np.ndarray, rules: Rules, arrays: StepArrays) -> int:
    """Put one object into every row that has not ended.

    One call, as handing the state to compiled code costs as much as a step of one world. Where the
    rules of static physics are asked for and ``decide``, a row is scored at once; the others are
    pending, and their number is returned.

    Args:
        rules: :attr:`Simulator.rules`.
        arrays: what it writes into.
    """
    spec, cubes, decide, _, _, _, _ = rules
    verdict = arrays.verdict
    previous, pending, scored = arrays.rows
    if cubes:
        _propose_cubes(state, actions, len(spec.turns), spec.pitch, previous)
    else:
        _propose(state, actions, spec, previous)
    # One loop for each is faster than one for both, where there are many rows.
    left = judged = 0
    for row in range(len(actions)):
        if not state.terminated[row]:
            verdict[row] = classify_last(state, row) if decide else UNDECIDED
            if verdict[row] == UNDECIDED:
                pending[left] = row
                left += 1
            else:
                scored[judged] = row
                judged += 1
    _score(state, scored[:judged], rules, arrays, False)
    return left


@kernel
def _reset_rows(
    state: State, rows: np.ndarray, rng: np.random.Generator, problems: Problems
) -> int:
    draws = 0
    for n in range(len(rows)):
        d = sample_problem(state, rows[n], rng, problems)
        if d == 0:
            return -1
        draws += d
    return draws


class Simulator:
    """Steps a batch of worlds of one task under one physics.

    Args:
        task: the problem distribution, or its name.
        physics: the check of placements, or its name, see :mod:`learn2assemble.tasks.checkers`; by
            default static equilibrium, and the kinematic cell where the task has an arm.

    Raises:
        UnknownNameError, InputError: see :func:`resolve_checker`.
    """

    task: Task

    def __init__(self, task: str | Task, physics: str | Physics | None = None) -> None:
        self.task = task = get_task(task)
        self.physics: Physics = resolve_checker(physics, task)
        self.frames: np.ndarray = side_frames(task.num_sides, task.pitch, task.aisle)
        self.depths: DepthFilter = FILTERS[task.cover_filter]
        self.action_spec: ActionSpec = task.action_spec
        self._problems = Problems(
            self.frames,
            inventory(task.objects),
            waiting_places(task.layout, task.max_blocks),
            task.grid,
            task.num_nodes,
            task.min_mask_pixels,
            task.max_initial_cover,
            task.unseen_shapes_only,
            task.pitch,
            self.depths,
            task.normalise_initial,
        )
        self.decides: bool = type(self.physics) is StaticPhysics
        """Whether the compiled rules decide, where they can."""
        self.rules: Rules = (
            self.action_spec,
            task.objects == "cubes",
            self.decides,
            self.frames,
            self.depths,
            REWARDS[task.reward],
            task.success_threshold,
        )

    def empty(self, batch: int) -> State:
        """A state for ``batch`` worlds; reset its rows before use."""
        return empty_state(batch, self.task.num_sides, MAX_VERTICES, self.task.max_blocks)

    def reset(self, state: State, rows: np.ndarray, rng: np.random.Generator) -> int:
        """Draw fresh problems into ``rows`` (int64[R]); returns the number of draws it took.

        Raises:
            Learn2AssembleError: where no acceptable problem is found in 100,000 draws.
        """
        if not len(rows):
            return 0
        draws = _reset_rows(state, np.asarray(rows, np.int64), rng, self._problems)
        if draws < 0:
            name = self.task.name
            raise Learn2AssembleError(f"task {name}: no acceptable target in 100,000 draws")
        return int(draws)

    def new(self, batch: int, rng: np.random.Generator) -> State:
        """A state of ``batch`` fresh problems."""
        state = self.empty(batch)
        self.reset(state, np.arange(batch), rng)
        return state

    def step(self, state: State, actions: np.ndarray) -> WorldTransition:
        """Place one object in every row, in place; rows that have ended are left alone.

        Args:
            actions: int64[B, 3]: number of the unplaced block, number of the placed reference
                block (both counted within their group), relative action. They must be legal.
        """
        if not self.decides:
            self.physics.prepare(state, np.flatnonzero(~state.terminated), actions)
        arrays = step_arrays(state.batch_size)
        return self.finish(state, arrays, advance(state, actions, self.rules, arrays))

    def finish(self, state: State, arrays: StepArrays, left: int) -> WorldTransition:
        """What a step did, once the physics has judged those rows that :func:`advance` left."""
        reward, flags, verdict, scratch = arrays
        if left or not self.decides:
            rows = scratch[1, :left]
            verdict[rows] = self.physics.settle(state, rows)
            _score(state, rows, self.rules, arrays, self.physics.moves_blocks)
        return WorldTransition(reward, flags[0], flags[1], verdict)

    def random_actions(self, state: State, rng: np.random.Generator) -> np.ndarray:
        """A uniform legal action for every row: int64[B, 3]."""
        kinds = np.full(state.batch_size, self.task.num_actions)
        counts = np.stack([state.num_unplaced, state.num_placed, kinds], -1)
        return (rng.random(counts.shape) * counts).astype(np.int64)

    def observe(self, state: State) -> Graph:
        """The graph of every row."""
        return build_graph(state, self.frames, self.task.num_nodes)

    def outcomes(
        self, state: State, graph: Graph, placements: Placements, without_arm: bool = False
    ) -> Outcomes:
        """What every placement of ``placements``, those of ``graph``, would bring to ``state``.

        By static physics; see :class:`Outcomes`. Whether an arm could do it takes an attempt, so
        with an arm what is valid otherwise is left undecided, unless ``without_arm``. A help the
        paper's agent does not have.
        """
        actions = (placements.action - node_offset(graph)[:, None]) * placements.used[..., None]
        found = outcomes(state, actions, placements.count, self.rules)
        if self.task.has_arm and not without_arm:
            undecided = found.valid.copy()
            for field in found:
                field[undecided] = 0
        return found

    def physics_mask(self, state: State) -> np.ndarray:
        """Which placements are free and stable by static physics.

        bool[B, M, 5] over (reference, relation) for cubes; for objects of several cells, which
        differ, bool[B, M, M, Na] over (unplaced block, reference, action).
        A help the paper's agent does not have; never applied silently.
        """
        if self.task.objects == "cubes":
            stable = survey(state, self.task.pitch) == STABLE
            return stable if self.task.rotations == 1 else stable.repeat(self.task.rotations, -1)
        return survey_objects(state, self.action_spec) == STABLE
