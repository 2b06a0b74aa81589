"""Setting blocks out for an arm, before it builds."""

from __future__ import annotations

import dataclasses

import numpy as np

from learn2assemble.errors import InputError
from learn2assemble.planning.problem import Problem
from learn2assemble.robot.grasps import get_grasps
from learn2assemble.robot.kinematic import KinematicCell
from learn2assemble.robot.waiting import check_places, supply_places
from learn2assemble.world.blocks import HALF
from learn2assemble.world.layout_file import Layout

NEAREST_FIRST = "places the arm reaches around the building site, the nearest first"
"""Where blocks wait unless somebody says otherwise."""


def set_out(problem: Problem, cell: KinematicCell, layout: Layout | None = None) -> Problem:
    """The problem with its blocks at places from which the arm can take them.

    Args:
        cell: of the arm.
        layout: block k waits at the (k - 1)-th place; more places than blocks are left empty. By
            default they are :data:`NEAREST_FIRST`.

    Raises:
        InputError: for places blocks cannot wait at, and where there are too few.
    """
    first, count = int(problem.state.num_placed[0]), int(problem.state.num_blocks[0])
    waiting = count - first
    if layout is None:
        layout = Layout(
            supply_places(cell, waiting, problem.ground, problem.state.position[0, 0]),
            NEAREST_FIRST,
        )
    places, source = layout
    if len(places) < waiting:
        what = f"{source}: positions"
        raise InputError(what, f"{len(places)} places", f"{waiting}, one for each waiting block")
    places = places[:waiting]
    order = check_places(
        cell, get_grasps(problem.task.grasps), places, problem.ground, problem.state.position[0, 0],
        source,
    )  # fmt: skip
    state = problem.state.copy()
    chosen = places[order]
    state.position[0, first:count] = np.column_stack([chosen[:, :2], np.full(waiting, HALF)])
    # A block keeps its number; the list is in an order in which all can be taken.
    state.object_id[0, first:count] = state.object_id[0, first:count][order]
    state.quaternion[0, first:count] = 0.0
    state.quaternion[0, first:count, 0] = np.cos(chosen[:, 2] / 2)
    state.quaternion[0, first:count, 3] = np.sin(chosen[:, 2] / 2)
    return dataclasses.replace(problem, state=state)
