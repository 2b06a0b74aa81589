"""Where an arm takes blocks from: what a person, or a feeder, has to prepare for a build; and where
they are while it is played.

A place is where blocks of a kind wait, each at the same pose. Of several the first one may lie
there from the beginning; the others come when the one before has been taken, as a magazine presents
them in the simulation: nothing lies at its pose otherwise, and ways of the arm were looked at so.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import groupby, pairwise
from typing import Any, NamedTuple

import numpy as np

from learn2assemble.geometry.hulls import Hull
from learn2assemble.geometry.rotations import quaternion_matrix
from learn2assemble.motion.record import BuildRecord, StepRecord
from learn2assemble.robot.moves import DENSITY
from learn2assemble.robot.studs import Studs

SQUARE = 5e-5
"""Sides that differ by no more are told as equal: those of a square [m]."""
NEAR, TURNED = 0.003, math.radians(2.0)
"""Blocks that wait no farther from each other lie at one place [m], [rad]."""


class Pick(NamedTuple):
    """Where a step takes its block from, where that waits at a place."""

    place: int
    """Number of the place, from 1."""
    refill: bool
    """The block comes there after the program has begun: someone has to lay it there first."""


@dataclass(frozen=True, eq=False)
class Lying:
    """How something lies, or stands, before an arm."""

    kind: str
    """Of it; empty where nobody tells."""
    size: np.ndarray
    """float64[3]: long side, short side and height of the box round it as it lies [m]."""
    mass: float
    """[kg]"""
    centre: np.ndarray
    """float64[3]: middle of that box [m, world]."""
    turn: float
    """Direction of its long side: from x about z, above -pi/2, up to pi/2 [rad]."""
    corners: np.ndarray | None
    """float64[k, 3]: its corners where it is no box [m, world]."""


@dataclass(frozen=True, eq=False)
class PickPlace(Lying):
    """Where blocks of a kind are taken from, one after the other; how one lies there."""

    number: int
    """1, 2, ... in the order in which they are needed."""
    blocks: tuple[str, ...]
    """Names of its blocks in the order in which they are taken."""
    steps: tuple[int, ...]
    """Numbers of the steps that take them."""
    at_start: bool
    """The first block lies there before the build begins."""
    refills: int
    """How many times a block is laid there after that."""

    @property
    def what(self) -> str:
        """What lies there, in words."""
        return self.kind or "block"

    @property
    def step_words(self) -> str:
        """Its steps, e.g. ``1 to 8, 10``."""
        return ranges(self.steps)

    @property
    def refill_words(self) -> str:
        """How often it is refilled, in a word or two."""
        if not self.refills:
            return "its own place"
        times = "once" if self.refills == 1 else f"{self.refills} times"
        return times + ", first empty" * (not self.at_start)


@dataclass(frozen=True, eq=False)
class Stands(Lying):
    """What stands there and is taken from no place."""

    name: str
    """Of it; empty: an obstacle."""
    by_hand: bool
    """It is set by hand during the build; else it stands there from the start."""

    @property
    def what(self) -> str:
        """What it is, in words."""
        return f"{self.name or 'obstacle'}{f' ({self.kind})' * bool(self.kind)}"


class Supplied(NamedTuple):
    """What a build needs besides its arm."""

    places: tuple[PickPlace, ...]
    picks: tuple[Pick | None, ...]
    """One for each step of the record; None: the step takes nothing from a place."""
    turns: tuple[float, ...]
    """For each step, :func:`put_turn`."""
    stands: tuple[Stands, ...] = ()
    """What else has to stand there: from the start, and what hands set, in their order."""


def ranges(numbers: Sequence[int]) -> str:
    """Numbers that rise, more than two that follow each other as one, e.g. ``1 to 8, 10``."""
    found = list[str]()
    for _, group in groupby(enumerate(numbers), lambda one: one[1] - one[0]):
        run = [number for _, number in group]
        found += map(str, run) if len(run) < 3 else [f"{run[0]} to {run[-1]}"]
    return ", ".join(found)


def step_numbers(record: BuildRecord) -> list[int]:
    """What the steps of a record are called: as the plan does, where each has a step of its own
    there and these come in order; else by the numbers of the attempts."""
    told = [step.plan_step for step in record.steps]
    found = [number for number in told if number is not None]
    whole = len(found) == len(told) and all(a < b for a, b in pairwise(found))
    return found if whole else [step.number for step in record.steps]


def name_of(record: BuildRecord, cell: int) -> str:
    """What the plan calls the block of a cell; where nobody tells, ``block`` and the number of the
    cell."""
    number = next((k for k, cells in enumerate(record.objects) if cell in cells), None)
    name = record.names[number] if record.names and number is not None else ""
    return name or f"block {cell}"


def supplied(record: BuildRecord) -> Supplied:
    """The places that blocks are taken from in a build, and which step takes from which.

    What stands or lies somewhere because the arm has put it there is at no place, until a magazine
    has taken it back and presents it again.
    """
    numbers, places = step_numbers(record), list[PickPlace]()
    picks, first = list[Pick | None](), [cells[0] for cells in record.objects]
    owner = {cell: k for k, cells in enumerate(record.objects) for cell in cells}
    moved, hidden = np.zeros(len(first), bool), np.zeros(len(first), bool)
    last: np.ndarray | None = None
    for step, number in zip(record.steps, numbers, strict=True):
        here = step.before[first, :3]
        last = here if last is None else last
        below = here[:, 2] < 0  # A magazine has it.
        # Another arm may have moved it.
        moved |= (np.linalg.norm(here - last, axis=1) > NEAR) & (last[:, 2] >= 0)
        moved &= ~below
        hidden |= below
        last, k = here, owner[step.cells[0]]
        stays = np.linalg.norm(step.target[:3] - step.before[step.cells[0], :3]) < NEAR
        if not len(step.samples.time) or moved[k] or stays:
            picks.append(None)
            continue
        refill = bool(hidden[k])
        picks.append(Pick(_listed(places, _lying(record, k, step), number, refill), refill))
        moved[k], hidden[k] = True, False
    turns = tuple(put_turn(record, step) for step in record.steps)
    return Supplied(tuple(places), tuple(picks), turns, tuple(_stands(record, picks)))


def _stands(record: BuildRecord, picks: Sequence[Pick | None]) -> Iterator[Stands]:
    """See :attr:`Supplied.stands`."""
    owner = {cell: k for k, cells in enumerate(record.objects) for cell in cells}
    placed = [hand for hand in record.hands if hand.place]
    others = {owner[hand.cells[0]] for hand in placed}
    others |= {owner[s.cells[0]] for s, pick in zip(record.steps, picks, strict=True) if pick}
    start = record.steps[0].before if record.steps else np.empty((0, 7))
    for k, cells in enumerate(record.objects if record.steps else ()):
        if k not in others and (start[list(cells), 2] >= 0).all():
            yield _standing(record, k, start[list(cells)], False)
    for hand in placed:
        if hand.poses:
            k = owner[hand.cells[0]]
            rows = dict(zip(hand.cells, hand.poses, strict=True))
            yield _standing(record, k, np.array([rows[c] for c in record.objects[k]]), True)


def _standing(record: BuildRecord, number: int, poses: np.ndarray, by_hand: bool) -> Stands:
    """An object that stands at poses float64[m, 7] of its cells."""
    cells = record.objects[number]
    pairs = zip(cells, poses, strict=True)
    points = np.concatenate([_corners(record, cell, pose) for cell, pose in pairs])
    name = record.names[number] if record.names else name_of(record, cells[0])
    return Stands(**vars(_seen(record, number, points)), name=name, by_hand=by_hand)


def _seen(record: BuildRecord, number: int, points: np.ndarray) -> Lying:
    """How an object lies whose corners are at float64[k, 3] [m]."""
    cells, (size, centre, turn) = record.objects[number], _box(points)
    kind = record.kinds[number] if record.kinds else ""
    corners = _outline(record, cells, points)
    return Lying(kind, size, _mass(record, cells), centre, turn, corners)


def _outline(record: BuildRecord, cells: tuple[int, ...], points: np.ndarray) -> np.ndarray | None:
    """float64[k, 3]: corners of an object [m]; None: it is one box."""
    boxes = record.hull is None or all(record.hull[cell] is None for cell in cells)
    return None if boxes and len(cells) == 1 else np.unique(points.round(6), axis=0)


def _lying(record: BuildRecord, number: int, step: StepRecord) -> PickPlace:
    """A place with one block, where a step finds it; where that was not seen exactly, as it is
    meant to lie there.

    Args:
        number: of the object.
    """
    cells, poses = record.objects[number], step.before
    points = np.concatenate([_corners(record, cell, poses[cell]) for cell in cells])
    if step.source is not None:
        seen = poses[step.cells[0]]
        turn = quaternion_matrix(step.source[3:]) @ quaternion_matrix(seen[3:]).T
        points = step.source[:3] + (points - seen[:3]) @ turn.T
    lies = _seen(record, number, points)
    return PickPlace(
        **vars(lies),
        number=0,
        blocks=(name_of(record, cells[0]),),
        steps=(),
        at_start=False,
        refills=0,
    )


def put_turn(record: BuildRecord, step: StepRecord) -> float:
    """Direction of the long side of the block of a step where that shall put it, as
    :attr:`PickPlace.turn` of where it waits [rad]."""
    cells, poses, here = step.cells, step.before, step.before[step.cells[0]]
    points = np.concatenate([_corners(record, cell, poses[cell]) for cell in cells])
    turn = quaternion_matrix(step.target[3:]) @ quaternion_matrix(here[3:]).T
    return _box(step.target[:3] + (points - here[:3]) @ turn.T)[2]


def _listed(places: list[PickPlace], here: PickPlace, number: int, refill: bool) -> int:
    """The number of the place of a block, which is added to the list of its blocks.

    Args:
        places: all that are known, to which a new one is added.
        here: where the block lies.
        number: of the step that takes it.
        refill: whether it came after the build had begun.
    """
    for k, place in enumerate(places):
        turned = abs((here.turn - place.turn + math.pi / 2) % math.pi - math.pi / 2)
        if (
            place.kind == here.kind
            and np.abs(place.size - here.size).max() < NEAR
            and np.abs(place.centre - here.centre).max() < NEAR
            and turned < TURNED
        ):
            again = here.blocks[0] in place.blocks  # An attempt before has failed.
            places[k] = replace(
                place,
                blocks=place.blocks if again else place.blocks + here.blocks,
                steps=(*place.steps, number),
                refills=place.refills + refill,
            )
            return k + 1
    new = replace(here, steps=(number,), at_start=not refill, refills=int(refill))
    places.append(replace(new, number=len(places) + 1))
    return len(places)


def _mass(record: BuildRecord, cells: tuple[int, ...]) -> float:
    """Of an object [kg]."""
    found = 0.0
    for cell in cells:
        half = np.full(3, record.block_edge / 2) if record.half is None else record.half[cell]
        hull = None if record.hull is None else record.hull[cell]
        density = DENSITY if record.density is None else float(record.density[cell])
        found += density * (8 * float(half.prod()) if hull is None else hull.volume)
    return found


def _corners(record: BuildRecord, cell: int, pose: np.ndarray) -> np.ndarray:
    """float64[k, 3]: corners of a cell at a pose float64[7] [m, world]."""
    hull = None if record.hull is None else record.hull[cell]
    if hull is None:
        half = np.full(3, record.block_edge / 2) if record.half is None else record.half[cell]
        points = (2.0 * np.array(list(np.ndindex(2, 2, 2))) - 1.0) * half
    else:
        points = hull.points
    return pose[:3] + points @ quaternion_matrix(pose[3:]).T


def _box(points: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Size float64[3] and middle float64[3] of the upright box round points [m], with the least
    area, and the direction of its long side [rad]."""
    import shapely

    library: Any = shapely
    low, high = points.min(0), points.max(0)
    around = library.MultiPoint(points[:, :2]).minimum_rotated_rectangle
    ring = np.array(around.exterior.coords)
    edges = np.diff(ring, axis=0)[:2]
    length = np.linalg.norm(edges, axis=1)
    along = edges[int(length[1] > length[0] + SQUARE)]
    turn = math.atan2(along[1], along[0])
    # Of a square the side nearest to x, from below 45 degrees on either side.
    if abs(length[1] - length[0]) <= SQUARE:
        turn = (turn + math.pi / 4) % (math.pi / 2) - math.pi / 4
    size = np.array([length.max(), length.min(), high[2] - low[2]])
    middle = np.array([*ring[:4].mean(0), (low[2] + high[2]) / 2])
    return size, middle, half_turn(turn)


def half_turn(angle: float) -> float:
    """The direction of a side, which has no beginning: above -pi/2, up to pi/2 and what rounding
    adds to it [rad]."""
    most = math.pi / 2 + 1e-4
    return most - (most - angle) % math.pi


# ---------------------------------------------------------------- where blocks are meanwhile


class Supply(NamedTuple):
    """A magazine presents a block, or takes one back."""

    time: float
    """[s]"""
    cells: tuple[int, ...]
    poses: np.ndarray
    """float64[m, 7]: where they are from then on; below the table: in a magazine."""


class Blocks(NamedTuple):
    """The cells of a build: each is one box."""

    objects: tuple[tuple[int, ...], ...]
    """Cells of every rigid object."""
    edge: float
    """Of a cube [m]."""
    half: np.ndarray | None
    """float64[C, 3]: half extents of the boxes [m]; None: all are cubes of that edge."""
    start: np.ndarray
    """float64[C, 7]: poses before the program: x, y, z [m, world], quaternion (w, x, y, z). What
    is below the table waits in a magazine."""
    end: np.ndarray
    """The same at its end."""
    supply: tuple[Supply, ...] = ()
    """In the order of their times."""
    density: np.ndarray | None = None
    """float64[C] of the cells [kg/m3]; None: that of the cubes."""
    hull: tuple[Hull | None, ...] | None = None
    """Of each cell about its centre, where it is no box; None: all are boxes."""
    studs: Studs | None = None
    """Joints that bricks make in the structure, in cells, none of them home; None: there are
    none."""
    names: tuple[str, ...] = ()
    """What the plan calls the block of each cell."""
    kinds: tuple[str, ...] = ()
    """Its kind, for each cell."""

    def name(self, cell: int) -> str:
        """What messages call the block of a cell."""
        return self.names[cell] if self.names else f"block {cell}"

    @property
    def halves(self) -> np.ndarray:
        """float64[C, 3]: half extents of all boxes [m]."""
        return np.full((len(self.start), 3), self.edge / 2) if self.half is None else self.half

    def mass(self, cells: Sequence[int]) -> float:
        """Of some cells [kg]."""
        density = DENSITY if self.density is None else self.density[list(cells)]
        volume = 8 * self.halves[list(cells)].prod(1)
        for k, cell in enumerate(cells):
            hull = None if self.hull is None else self.hull[cell]
            volume[k] = volume[k] if hull is None else hull.volume
        return float((density * volume).sum())

    def middles(self, cells: Sequence[int], poses: np.ndarray) -> np.ndarray:
        """float64[m, 3]: centres of mass of some cells at poses float64[C, 7] of all [m]."""
        found = poses[list(cells), :3].copy()
        for k, cell in enumerate(cells):
            hull = None if self.hull is None else self.hull[cell]
            if hull is not None:
                found[k] += quaternion_matrix(poses[cell, 3:]) @ hull.centroid
        return found


def supply_of(record: BuildRecord, ends: list[float]) -> Iterator[Supply]:
    """When magazines present blocks or take them: those that are under the table before a step
    and above it afterwards, or the other way round."""
    for step, end in zip(record.steps, ends, strict=True):
        hidden, shown = step.before[:, 2] < 0, step.after[:, 2] >= 0
        for cells in record.objects:
            if hidden[list(cells)].all() == shown[list(cells)].all():
                yield Supply(end, cells, step.after[list(cells)])
