"""What a plan is made for: one target with its blocks.

Where problems come from: a design, or a preset.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from learn2assemble.errors import InputError
from learn2assemble.geometry.coverage import FILTERS
from learn2assemble.simulator import Simulator
from learn2assemble.tasks import Task, get_task, robot_task
from learn2assemble.world.blocks import EDGE, HALF
from learn2assemble.world.design import MAX_COLUMN, Cell, Terms, face_pixels
from learn2assemble.world.design_bounds import (
    Design,
    explain_refusal,
    inside_cells,
    minimum_blocks,
    required_share,
)
from learn2assemble.world.layouts import side_frames, to_world, waiting_places
from learn2assemble.world.rules import target_cell
from learn2assemble.world.sampling import start_objects
from learn2assemble.world.state import State, empty_state

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
        """float64[S, 4], see :mod:`learn2assemble.world.layouts`."""
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


SPARE_SHARE = 0.5
"""Blocks offered beyond the least number, as a share of it, where a design names no number."""
MIN_SPARE = 4
PROBLEM_STREAM = 3
"""First word of the seed of a preset's problem: neither training's nor evaluation's stream."""

MOST_WITH_ARM = 40
"""Spare blocks are offered up to this many blocks with an arm, whose table is small."""


def design_task(design: Design, arm: str | None = None) -> Task:
    """The task a design poses, without its number of blocks.

    With an arm it is a cell of the paper, with blocks apart and coverage as there; the threshold is
    the design's share of what such blocks can cover. Two walls get an aisle between them: next to
    each other, the last block of a square of four has neighbours on both axes, and no finger gets
    in.
    """
    if arm is None:
        return Task(
            design.name, design.num_sides, grid=6, num_nodes=5 * design.num_sides + 2,
            success_threshold=design.success_threshold,
        )  # fmt: skip
    task = robot_task(
        design.name, num_sides=design.num_sides, grid=6, num_nodes=5 * design.num_sides + 2,
        aisle=1 if design.num_sides == 2 else 0, arm=arm,
    )  # fmt: skip
    return task.replace(success_threshold=required_share(design, terms_of(task)))


def design_problem(
    design: Design, arm: str | None = None, num_waiting: int | None = None
) -> Problem:
    """The problem a design poses; spare blocks are offered where it names no number.

    Args:
        arm: which arm shall build, if any; its blocks wait nowhere yet, see
            :func:`learn2assemble.planning.supply.set_out`.
        num_waiting: how many blocks wait, where the design leaves it open.
    """
    task = design_task(design, arm)
    terms = terms_of(task)
    refusal = explain_refusal(design, terms)
    blocks = design.num_blocks
    if blocks is None and num_waiting is not None:
        blocks = num_waiting + 1
    least = minimum_blocks(design, terms) if refusal is None else 2
    if blocks is None:
        blocks = least + max(MIN_SPARE, round(SPARE_SHARE * least))
        if arm is not None:
            blocks = max(least, min(blocks, MOST_WITH_ARM))
    elif refusal is None and blocks < least:
        refusal = f"needs at least {least} blocks, and there are {blocks}"
    counts = [len(elevation.outline) for elevation in design.elevations]
    task = task.replace(num_nodes=max(sum(counts) + blocks, task.num_nodes))
    state = empty_state(1, design.num_sides, max(counts), blocks)
    for side, elevation in enumerate(design.elevations):
        state.vertices[0, side, : counts[side]] = elevation.outline
        state.num_vertices[0, side] = counts[side]
    state.mask[0] = design.masks()
    state.mask_pixels[0] = int(np.bitwise_count(state.mask[0]).sum())
    start_objects(
        state, 0, side_frames(task.num_sides, task.pitch, task.aisle),
        waiting_places(task.layout, blocks), design.first_elevation, blocks,
        FILTERS[task.cover_filter],
    )  # fmt: skip
    if not task.normalise_initial:
        state.initial_pixels[0] = 0
    names = tuple(elevation.name for elevation in design.elevations)
    inside = inside_cells(design, terms)
    return Problem(design.name, task, state, names, inside, design.supports, refusal)


def preset_problem(name: str, seed: int, arm: str | None = None) -> Problem:
    """A random problem of a preset, with the masks and the number of blocks of the paper.

    Raises:
        UnknownNameError: for a preset or an arm that does not exist.
        InputError: for a negative seed, and for an arm where the preset has no robot.
    """
    task = get_task(name, arm)
    if seed < 0:
        raise InputError("--seed", seed, "a whole number of at least 0")
    state = Simulator(task).new(1, np.random.default_rng([PROBLEM_STREAM, seed]))
    names = tuple(f"side {side + 1}" for side in range(task.num_sides))
    refusal = None
    if task.objects != "cubes":
        refusal = "plans are made of cubes, not yet of objects"
    elif not task.touching and not task.has_arm:
        refusal = "blocks are kept apart for the fingers of an arm, and there is none"
    return Problem(f"{name}, seed {seed}", task, state, names, inside=None, refusal=refusal)
