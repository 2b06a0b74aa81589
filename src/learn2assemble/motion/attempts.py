"""What the attempts of a build say together: how far blocks were from where they were believed to
be and from their places, where a simulation told where they really were; and the attempts of
several arms in one cell, in the order in which these ended."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from learn2assemble.motion.record import BuildRecord, StepRecord
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


class ArmStep(NamedTuple):
    """An attempt of one of the arms."""

    arm: int
    """Number of its record."""
    step: StepRecord
    """``number`` counts the attempts of all; what another arm carries meanwhile has not moved."""
    start: float
    """When it begins [s]; what the arm waits before it does not belong to it."""
    end: float
    """[s]."""


def anything_to_play(records: Sequence[BuildRecord]) -> bool:
    """Whether pages and videos have an attempt to show: of several arms one that has moved."""
    if len(records) < 2:
        return any(record.steps for record in records)
    return any(step.stages for record in records for step in record.steps)


def merged(records: Sequence[BuildRecord]) -> list[ArmStep]:
    """The attempts of arms that have built side by side, on one clock; of several arms those in
    which they moved."""
    found = [
        ArmStep(arm, step, start, end)
        for arm, record in enumerate(records)
        for step, (start, end) in zip(record.steps, record.spans(), strict=True)
    ]
    if len(records) == 1:
        return found
    moved = [one for one in found if one.step.stages]
    moved = [one._replace(start=one.step.stages[0].start) for one in moved]
    moved.sort(key=lambda one: one.end)
    told: list[ArmStep] = []
    poses = records[0].steps[0].before if records[0].steps else None
    for number, one in enumerate(moved, 1):
        # Between its attempts each arm is told what the other one has done.
        others = {c for o in moved if o.arm != one.arm and o.end >= one.start for c in o.step.cells}
        own, step = list(one.step.cells), one.step
        before = step.before.copy() if poses is None else poses.copy()
        before[own] = step.before[own]
        seen = [cell for cell in range(len(before)) if cell not in others or cell in own]
        after = before.copy()
        after[seen] = step.after[seen]
        truth = None
        if step.truth is not None:
            truth = after.copy()
            truth[seen] = step.truth[seen]
        poses = after
        whole = replace(step, number=number, before=before, after=after, truth=truth)
        told.append(one._replace(step=whole))
    return told
