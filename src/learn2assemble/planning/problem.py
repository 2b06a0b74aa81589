"""What a plan is made for: one target with its blocks."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from learn2assemble.task import Task
from learn2assemble.world.blocks import EDGE, HALF
from learn2assemble.world.design_pixels import MAX_COLUMN, Cell, Terms, face_pixels
from learn2assemble.world.rules import target_cell
from learn2assemble.world.sides import side_frames, to_world
from learn2assemble.world.state import State

Key = tuple[int, int, int, int]


def placement_key(target: np.ndarray, way: int) -> Key:
    """A placement with another of its kind nearby: target in half edges, and the way."""
    x, y, z = (round(float(c) / HALF) for c in target)
    return x, y, z, way


def terms_of(task: Task) -> Terms:
    """What a task means for its designs."""
    return Terms(
        task.pitch, task.aisle, task.cover_filter, task.normalise_initial,
        of_coverable=not task.touching,
    )  # fmt: skip


@dataclass(frozen=True)
class Problem:
    """One target with its blocks."""

    name: str
    task: Task
    state: State
    """A batch of one, before the first placement."""
    elevation_names: tuple[str, ...]
    inside: tuple[frozenset[Cell], ...] | None
    """Cells of each elevation inside its outline; ``None`` where every cell counts as inside."""
    supports: bool = True
    """Whether blocks may stand outside every outline."""
    refusal: str | None = None
    """Why it cannot be built, where that is known beforehand."""
    avoid: frozenset[Key] = frozenset()
    """Placements that failed in reality, see :func:`placement_key`."""

    @property
    def frames(self) -> np.ndarray:
        """float64[S, 4], see :mod:`learn2assemble.world.sides`."""
        return side_frames(self.task.num_sides, self.task.pitch, self.task.aisle)

    @cached_property
    def ground(self) -> np.ndarray:
        """float64[n, 2]: centres of the cells on the table under what is needed [m, world]."""
        found = {}
        for frame, cells in zip(self.frames, self.needed, strict=True):
            for column in {cell.column for cell in cells}:
                x = np.array(self.task.pitch * column)
                found[tuple(np.round(to_world(frame, x, 0 * x, 0 * x)[:2], 6).tolist())] = None
        return np.array(list(found))

    def target(self, state: State, action: np.ndarray) -> np.ndarray:
        """float64[3]: where an action puts its block in row 0 [m]."""
        relation = int(action[2]) // self.task.rotations
        return np.array(target_cell(state, 0, int(action[1]), relation, self.task.pitch))

    def allows(self, state: State, action: np.ndarray) -> bool:
        """Whether an action in row 0 keeps to the design and has not failed in reality before."""
        target = self.target(state, action)
        if not self.supports and self.is_outside(target):
            return False
        return placement_key(target, int(action[2]) % self.task.rotations) not in self.avoid

    @property
    def outlines(self) -> list[np.ndarray]:
        """Target outline of every side, local (x, z) [m]."""
        count = self.state.num_vertices[0]
        return [self.state.vertices[0, side, :n].copy() for side, n in enumerate(count)]

    @cached_property
    def needed(self) -> list[frozenset[Cell]]:
        """Cells of each side whose face holds mask pixels."""
        faces = face_pixels(terms_of(self.task)) & self.state.mask[0][:, None, None]
        counts = np.bitwise_count(faces).sum((-1, -2))
        return [
            frozenset(Cell(int(column) - MAX_COLUMN, int(level)) for column, level in cells)
            for cells in map(np.argwhere, counts)
        ]

    def accepts(self, state: State) -> bool:
        """Whether the world in row 0 shows the target: for a design, the blocks must stand in the
        planes of the outlines, so blocks that only hide them from the camera do not count."""
        cover = state.complete_coverage[0]
        if self.inside is not None:
            cover = min(cover, state.plane_coverage[0])
        return bool(cover > self.task.success_threshold)

    def is_outside(self, centre: np.ndarray) -> bool:
        """Whether a block with this centre [m] stands outside the outlines of all its planes."""
        if self.inside is None:
            return False
        for frame, cells in zip(self.frames, self.inside, strict=True):
            c, s, tx, ty = frame
            wx, wy = centre[0] - tx, centre[1] - ty
            x, y = c * wx + s * wy, c * wy - s * wx
            cell = Cell(round(x / self.task.pitch), round((centre[2] - HALF) / EDGE))
            if abs(y) < HALF and cell in cells:
                return False
        return True
