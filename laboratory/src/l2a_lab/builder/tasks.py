"""The tasks of the paper, played by the builder: a problem is a design seen from its sides.

Cells of the face planes that show open pixels of a mask are to be filled, with what stands below
them and what has to be passed on the way; the kit is what waits. Placements beside these cells are
offered only where they pay. The exact model tells which placements hold and what they pay at once,
a help that the paper's agent does not have; between those that pay the same, the network decides
with the weights that build designs. So for the logit :math:`l` of a placement,

.. math::  Q(s, a) = r(s, a) + 0.001\\,(l(s, a) + 30), \\quad Q = r \\text{ where the episode ends,}

and any search of :mod:`learn2assemble.tasks.search` adds what is paid later.
"""

from __future__ import annotations

from collections import Counter, OrderedDict
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from l2a_lab.builder.network import MAX_LOGIT, Builder
from l2a_lab.object_bounds import turns_of
from learn2assemble.assembly.kit import Kind, Kit
from learn2assemble.constants import EDGE, HALF
from learn2assemble.errors import InputError
from learn2assemble.planning.tiling.world import LatticeSite, LatticeWorld, make_site
from learn2assemble.tasks.design_features import describe
from learn2assemble.tasks.evaluation.bounds import MAX_COLUMN, NUM_LEVELS, cell_pixels
from learn2assemble.tasks.graph.features import node_offset
from learn2assemble.tasks.graph.placements import distinct_placements
from learn2assemble.tasks.search.tree import ActionValues
from learn2assemble.tasks.simulator import Simulator
from learn2assemble.tasks.world.layouts import to_world
from learn2assemble.tasks.world.rules import recover_all
from learn2assemble.tasks.world.state import State
from learn2assemble.tasks.world_model import WorldModel

PREFERENCE = 1e-3
"""What a logit is worth beside rewards: it decides between placements that pay the same."""
_KEPT = 256
"""Problems kept in memory."""


@dataclass(frozen=True, eq=False)
class Problem:
    """A problem of a task as a design."""

    site: LatticeSite
    corner: np.ndarray
    """int64[3]: place of the first cell of the design [block edges, world]."""
    strides: np.ndarray
    """int64[3]: of the flat cells."""
    names: np.ndarray
    """uint64[cells]: random numbers of the flat cells."""
    known: np.ndarray
    """uint64[n]: sums of the numbers of the cells of every candidate, sorted ..."""
    candidate: np.ndarray
    """int64[n]: ... and whose they are."""

    def find(self, cells: np.ndarray, count: np.ndarray) -> np.ndarray:
        """Candidates that fill some cells, -1 where none does: int64[P].

        Args:
            cells: int64[P, C, 3]: places [block edges, world].
            count: int64[P]: how many of them each has.
        """
        at, shape = cells - self.corner, self.site.wanted.shape
        used = np.arange(int(cells.shape[1])) < count[:, None]
        inside = (((at >= 0) & (at < shape)).all(-1) | ~used).all(1)
        flat = (np.clip(at, 0, np.array(shape) - 1) * self.strides).sum(-1)
        key: np.ndarray = np.where(used, self.names[flat], 0).sum(1, dtype=np.uint64)
        place = np.minimum(np.searchsorted(self.known, key), len(self.known) - 1)
        return np.where(inside & (self.known[place] == key), self.candidate[place], -1)


def _lattice(position: np.ndarray) -> np.ndarray:
    """Cells [block edges] of centres [m], both [..., 3]."""
    return np.rint(position / EDGE - [0, 0, 0.5]).astype(np.int64)


def _objects(state: State, row: int, blocks: int) -> tuple[np.ndarray, np.ndarray]:
    """Objects among the first blocks of a row, the placed ones first: their blocks, int64[O, m]
    with the last one repeated, and how many they are, int64[O]."""
    ids = state.object_id[row, :blocks]
    first = np.append(0, np.flatnonzero(ids[1:] != ids[:-1]) + 1)
    count = np.append(first[1:], blocks) - first
    return first[:, None] + np.minimum(np.arange(int(count.max())), count[:, None] - 1), count


def make_problem(simulator: Simulator, state: State, row: int) -> Problem:
    """The design of the problem in a row, however far it is built."""
    pixels, columns = cell_pixels(), EDGE * np.arange(-MAX_COLUMN, MAX_COLUMN + 1)
    at = _lattice(state.position[row])
    objects, count = _objects(state, row, int(state.num_blocks[row]))
    kinds = Counter(
        min(turns_of(at[blocks[:n]], 4)) for blocks, n in zip(objects, count, strict=True)
    )
    start = state.take(np.array([row]))
    start.num_placed[:] = count[0]
    recover_all(start, 0, simulator.frames, simulator.depths)
    cells = [at[: count[0]]]
    for side, frame in enumerate(simulator.frames):
        open_ = start.mask[0, side] & ~start.covered[0, side]
        shows = ((pixels & open_) != 0).any((-1, -2))
        high = np.where(shows.any(1), NUM_LEVELS - np.argmax(shows[:, ::-1], 1), 0)
        # From the middle on, where the first block stands, what is between is passed.
        used = np.append(np.flatnonzero(high), MAX_COLUMN)
        for column in range(used.min(), used.max() + 1):
            z = HALF + EDGE * np.arange(max(int(high[column]), 1))
            cells.append(_lattice(to_world(frame, columns[column] + 0 * z, 0 * z, z)))
    places = np.concatenate(cells)
    corner = places.min(0)
    wanted = np.zeros(places.max(0) - corner + 1, bool)
    wanted[tuple((places - corner).T)] = True
    kit = Kit(
        "blocks",
        tuple(
            Kind(f"block {number}", shape, count=count)
            for number, (shape, count) in enumerate(sorted(kinds.items()))
        ),
    )
    site = make_site(wanted, kit)
    names = np.random.default_rng(0).integers(2**63, size=wanted.size, dtype=np.uint64)
    known = np.add.reduceat(names[site.found.cell], site.found.start[:-1])
    order = np.argsort(known)
    _, y, z = places.max(0) - corner + 1
    strides = np.array([y * z, z, 1])
    return Problem(site, corner, strides, names, known[order], order)


class TaskModel(WorldModel):
    """The builder as the model of a search, see the module; states are the simulator's.

    Raises:
        InputError: for a task with an arm, and for blocks that do not touch.
    """

    def __init__(self, simulator: Simulator, builder: Builder) -> None:
        task = simulator.task
        if task.has_arm or not task.touching:
            raise InputError("agent", builder.name, f"an agent of the paper for task {task.name}")
        self.simulator, self.builder, self.discount = simulator, builder, task.discount
        self._problems: OrderedDict[bytes, Problem] = OrderedDict()

    def action_values(self, states: State) -> list[ActionValues]:
        simulator, found = self.simulator, list[ActionValues]()
        graph = simulator.observe(states)
        placements = distinct_placements(graph, simulator.action_spec)
        outcomes, offset = simulator.outcomes(states, graph, placements), node_offset(graph)
        for row, count in enumerate(placements.count.tolist()):
            problem = self.problem(states, row)
            members = placements.members[row, :count]
            cells = _lattice(placements.cells[row, members])
            candidate = problem.find(cells, (members >= 0).sum(1))
            valid, ends = outcomes.valid[row, :count], outcomes.terminal[row, :count]
            values = outcomes.reward[row, :count].astype(np.float64)
            inside = valid & (candidate >= 0)
            # Where there is neither, what holds; else the first placement, which fails.
            choices = (inside | (values > 0), valid, np.arange(int(count)) == 0)
            chosen = np.flatnonzero(next(choice for choice in choices if choice.any()))
            if inside.any():
                world = self.standing(states, row)
                logits = self.builder.scores(*describe(world, candidate[inside]))
                values[inside] += PREFERENCE * (logits + MAX_LOGIT) * ~ends[inside]
            actions = placements.action[row, chosen] - offset[row]
            found.append(ActionValues(actions, values[chosen], placements.key[row, chosen]))
        return found

    def legal(self, states: State) -> list[ActionValues]:
        found = self.action_values(states)
        return [row._replace(values=np.zeros(len(row.values))) for row in found]

    def best(self, states: State) -> tuple[np.ndarray, np.ndarray]:
        found = self.action_values(states)
        best = [int(np.argmax(row.values)) for row in found]
        return (
            np.array([row.values[k] for row, k in zip(found, best, strict=True)]),
            np.stack([row.actions[k] for row, k in zip(found, best, strict=True)]),
        )

    def problem(self, states: State, row: int) -> Problem:
        """The design of the problem in a row."""
        key = states.mask[row].tobytes() + _lattice(states.position[row, 0]).tobytes()
        if key not in self._problems:
            self._problems[key] = make_problem(self.simulator, states, row)
            if len(self._problems) > _KEPT:
                self._problems.popitem(last=False)
        self._problems.move_to_end(key)
        return self._problems[key]

    def standing(self, states: State, row: int) -> LatticeWorld:
        """The design in a row as far as it is built; objects beside it are left out."""
        problem, at = self.problem(states, row), _lattice(states.position[row])
        objects, count = _objects(states, row, int(states.num_placed[row]))
        world = LatticeWorld(problem.site)
        for candidate in problem.find(at[objects], count):
            if candidate >= 0:
                world.put(int(candidate))
        return world


class TaskPlayer(NamedTuple):
    """A builder that plays tasks.

    Implements :class:`learn2assemble.tasks.evaluation.episodes.Player`.
    """

    builder: Builder

    @property
    def name(self) -> str:
        return self.builder.name

    def world_model(self, simulator: Simulator) -> TaskModel:
        return TaskModel(simulator, self.builder)
