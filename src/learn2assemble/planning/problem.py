"""What a plan is made for: one target with its blocks, from a design or from a preset."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from learn2assemble.errors import InputError
from learn2assemble.presets import get_task
from learn2assemble.simulator import Simulator
from learn2assemble.task import Task
from learn2assemble.world.blocks import EDGE, HALF
from learn2assemble.world.design_pixels import MAX_COLUMN, Cell, face_pixels
from learn2assemble.world.designs import Design, explain_refusal, inside_cells, minimum_blocks
from learn2assemble.world.layouts import waiting_places
from learn2assemble.world.sampling import start_objects
from learn2assemble.world.state import State, empty_state

SPARE_SHARE = 0.5
"""Blocks offered beyond the least number, as a share of it, where a design names no number."""
MIN_SPARE = 4
PROBLEM_STREAM = 3
"""First word of the seed of a preset's problem: neither training's nor evaluation's stream."""


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

    @property
    def outlines(self) -> list[np.ndarray]:
        """Target outline of every side, local (x, z) [m]."""
        count = self.state.num_vertices[0]
        return [self.state.vertices[0, side, :n].copy() for side, n in enumerate(count)]

    @cached_property
    def needed(self) -> list[frozenset[Cell]]:
        """Cells of each side whose face holds mask pixels."""
        counts = np.bitwise_count(face_pixels() & self.state.mask[0][:, None, None]).sum((-1, -2))
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
        for frame, cells in zip(Simulator(self.task).frames, self.inside, strict=True):
            c, s, tx, ty = frame
            wx, wy = centre[0] - tx, centre[1] - ty
            x, y = c * wx + s * wy, c * wy - s * wx
            cell = Cell(round(x / EDGE), round((centre[2] - HALF) / EDGE))
            if abs(y) < HALF and cell in cells:
                return False
        return True


def design_problem(design: Design, layout: str = "line") -> Problem:
    """The problem a design poses; spare blocks are offered where it names no number."""
    refusal = explain_refusal(design)
    blocks = design.num_blocks
    if blocks is None:
        least = minimum_blocks(design) if refusal is None else 2
        blocks = least + max(MIN_SPARE, round(SPARE_SHARE * least))
    counts = [len(elevation.outline) for elevation in design.elevations]
    task = Task(
        name=design.name,
        num_sides=design.num_sides,
        grid=6,
        num_nodes=max(sum(counts) + blocks, 5 * design.num_sides + 2),
        layout=layout,
        success_threshold=design.success_threshold,
    )
    state = empty_state(1, design.num_sides, max(counts), blocks)
    for side, elevation in enumerate(design.elevations):
        state.vertices[0, side, : counts[side]] = elevation.outline
        state.num_vertices[0, side] = counts[side]
    state.mask[0] = design.masks()
    state.mask_pixels[0] = int(np.bitwise_count(state.mask[0]).sum())
    waiting = waiting_places(layout, blocks)
    start_objects(state, 0, Simulator(task).frames, waiting, design.first_elevation, blocks)
    names = tuple(elevation.name for elevation in design.elevations)
    return Problem(design.name, task, state, names, inside_cells(design), design.supports, refusal)


def preset_problem(name: str, seed: int) -> Problem:
    """A random problem of a preset, with the masks and the number of blocks of the paper.

    Raises:
        UnknownNameError: for a preset that does not exist.
        InputError: for a negative seed.
    """
    task = get_task(name)
    if seed < 0:
        raise InputError("--seed", seed, "a whole number of at least 0")
    state = Simulator(task).new(1, np.random.default_rng([PROBLEM_STREAM, seed]))
    names = tuple(f"side {side + 1}" for side in range(task.num_sides))
    refusal = None
    if task.objects != "cubes":
        refusal = "plans are made of cubes, not yet of objects"
    elif not task.touching:
        refusal = "plans are made of blocks that touch, not yet for the gaps a gripper needs"
    return Problem(f"{name}, seed {seed}", task, state, names, inside=None, refusal=refusal)
