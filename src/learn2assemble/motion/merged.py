"""Records of several arms in one cell as one sequence of attempts, in the order in which these
ended."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

from learn2assemble.motion.record import BuildRecord, StepRecord


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
