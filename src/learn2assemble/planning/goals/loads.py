"""Whether structures bear the loads of some goals."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np

from learn2assemble.design.goals import Goals, Surface
from learn2assemble.linear_programs import INF
from learn2assemble.planning.goals.world import GoalProblem
from learn2assemble.planning.tiling.world import LatticeWorld
from learn2assemble.statics.step_proof import Proof, Stack


def loaded(
    stack: Stack,
    owner: np.ndarray,
    loads: tuple[Surface, ...],
    shape: tuple[int, ...],
    pitch: tuple[float, ...],
) -> Stack:
    """The stack with masses on top faces, each a part of the block it lies on.

    Args:
        owner: int[X, Y, Z], the block of every cell.
    """
    weight, centre = stack.weight.copy(), stack.centre.copy()
    for load in loads:
        block = int(owner[load.cell])
        top = (load.cell[2] + 1) * pitch[2]
        at = np.array([load.point[0], load.point[1], top])
        both = weight[block] + load.mass
        centre[block] = (weight[block] * centre[block] + load.mass * at) / both
        weight[block] = both
    return replace(stack, weight=weight, centre=centre)


def load_cases(goals: Goals) -> list[tuple[Surface, ...]]:
    """All subsets of the loads, all together first: forces are convex, so whatever stands under
    every subset stands under any part of the loads."""
    loads = goals.loads
    return [case for count in range(len(loads), 0, -1) for case in combinations(loads, count)]


def failing_load(
    goals: Goals,
    stack: Stack,
    owner: np.ndarray,
    force: np.ndarray | None = None,
    seconds: float = INF,
) -> tuple[Surface, ...] | None:
    """The first set of loads under which a finished structure falls; None where it bears all.

    Args:
        owner: int[X, Y, Z].
        force: of a proof without loads, to begin with.
    """
    everything = np.ones(len(stack), bool)
    for case in load_cases(goals):
        heavy = Proof(loaded(stack, owner, case, goals.shape, goals.kit.pitch))
        if force is not None:
            heavy.force = force.copy()
        if not heavy.settle(everything, everything) and not heavy.program(
            everything, everything, seconds
        ):
            return case
    return None


def bears(problem: GoalProblem, world: LatticeWorld) -> bool:
    """Whether what stands bears the loads of the goals, all of which are met."""
    owner = world.owner.reshape(problem.goals.shape)
    proof = world.proof
    return failing_load(problem.goals, proof.stack, owner, proof.force) is None
