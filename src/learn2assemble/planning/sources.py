"""Where problems come from: a design, or a preset."""

from __future__ import annotations

import numpy as np

from learn2assemble.errors import InputError
from learn2assemble.geometry.coverage import FILTERS
from learn2assemble.planning.problem import Problem, terms_of
from learn2assemble.presets import ROBOT, get_task
from learn2assemble.simulator import Simulator
from learn2assemble.task import Task
from learn2assemble.world.designs import (
    Design,
    explain_refusal,
    inside_cells,
    minimum_blocks,
    required_share,
)
from learn2assemble.world.layouts import waiting_places
from learn2assemble.world.sampling import start_objects
from learn2assemble.world.sides import side_frames
from learn2assemble.world.state import empty_state

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
    task = ROBOT.replace(
        name=design.name, num_sides=design.num_sides, grid=6, num_nodes=5 * design.num_sides + 2,
        aisle=1 if design.num_sides == 2 else 0, arm=arm,
    )  # fmt: skip
    return task.replace(success_threshold=required_share(design, terms_of(task)))


def design_problem(
    design: Design, arm: str | None = None, num_waiting: int | None = None
) -> Problem:
    """The problem a design poses; spare blocks are offered where it names no number.

    Args:
        arm: which arm shall build, if any; its blocks wait nowhere yet, see
            :func:`learn2assemble.planning.site.set_out`.
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
