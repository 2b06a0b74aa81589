"""How far blocks were from where they were believed to be, and from their places, attempt by
attempt: of a record whose simulation told where they really were."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from learn2assemble.motion.record import BuildRecord
from learn2assemble.robot.moves import Outcome


class BlockErrors(NamedTuple):
    """Errors of a block from the attempt on that put it where it belongs."""

    cell: int
    """By which it was held."""
    first: int
    """Number of that attempt, from 1."""
    belief: np.ndarray
    """float64[n]: after this attempt and the next ones, how far it really was from where it was
    believed to be [m]."""
    place: np.ndarray
    """float64[n]: how far from its place [m]."""


def block_errors(record: BuildRecord) -> tuple[BlockErrors, ...]:
    """Errors over time of all blocks that were put where they belong, until they were taken
    elsewhere or the build ended; empty where nobody has told where blocks really were."""
    found: list[BlockErrors] = []
    began: dict[int, tuple[int, np.ndarray]] = {}

    def end(cell: int, last: int) -> None:
        first, place = began.pop(cell)
        steps = [step for step in record.steps[first:last] if step.truth is not None]
        there = np.array([step.truth[cell, :3] for step in steps if step.truth is not None])
        if len(there):
            known = np.array([step.after[cell, :3] for step in steps])
            off = [np.linalg.norm(there - one, axis=1) for one in (known, place)]
            found.append(BlockErrors(cell, steps[0].number, *off))

    for number, step in enumerate(record.steps):
        for cell in set(step.cells) & set(began):
            end(cell, number)
        if step.outcome == Outcome.REACHED and step.plan_step is not None:
            began[step.cells[0]] = number, step.target[:3]
    for cell in list(began):
        end(cell, len(record.steps))
    return tuple(found)
