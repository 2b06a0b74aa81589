"""Instructions to build an assembly by hand: what cards and PDF both draw.

Lengths are told from one corner, *O*: the front left lower corner of the box round what stands in
the end; x goes to the right, y to the back, z up. A block is told by its shape, a position and a
turn, which are enough to put it exactly where it belongs
(:func:`~learn2assemble.assembly.instructions.shapes.corners_at`).
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from learn2assemble.assembly.blocks import Action, Assembly
from learn2assemble.assembly.instructions.appearance import (
    is_prism,
    joint_width,
    kinds_and_colours,
    sections,
)
from learn2assemble.assembly.instructions.shapes import BlockShape, Named, Shapes, Turn

MOST_TOGETHER = 6
"""Blocks of one card."""
_COVERED = 0.98
"""Share of a bed face that rests on what is below, where a block is carried straight down; the rest
is open joints."""
_CHANGE = {"place": 1, "remove": -1}
"""What actions change the number of blocks by that stand."""
HANDS: frozenset[Action] = frozenset(("hold", "release"))
"""What hands do with a block that stays where it is."""


@dataclass(frozen=True, eq=False)
class Placement:
    """What a step does to a block, and where that is."""

    number: int
    """The step of the assembly, from 1; 0: it stands from the start."""
    block: int
    """Index in the assembly."""
    shape: BlockShape
    position: tuple[float, float, float]
    """As :class:`~learn2assemble.assembly.instructions.shapes.ToldPose` says [m]."""
    turn: Turn
    action: Action = "place"
    prop: bool = False
    by_hand: bool = False
    """Whether a person does it while an arm waits."""
    way: str | None = None
    """Whence a brick comes that does not come from above: ``below`` or ``beside``."""
    wait: float | None = None
    """Hours that one waits before it, until mortar holds."""

    @property
    def askew(self) -> bool:
        """Whether it is turned by other than quarters, so that its corner 1 is told."""
        return any(angle % 90 for angle in self.turn)


@dataclass(frozen=True)
class Group:
    """What one card tells: a step of the assembly, or several that follow one another."""

    number: int
    """Of the card, from 1."""
    placements: tuple[Placement, ...]
    layer: int
    """From 1."""
    level: float
    """Height of the layer over O [m]."""
    first: bool
    """Whether the layer begins with it."""
    held: frozenset[int] = frozenset()
    """Blocks that hands hold when it is done."""

    @property
    def steps(self) -> tuple[int, int]:
        """The numbers of its first and its last step, from 1."""
        return self.placements[0].number, self.placements[-1].number

    @property
    def main(self) -> Placement:
        """What comes or goes first in it; where hands alone do something, the first of that."""
        return next((p for p in self.placements if p.action not in HANDS), self.placements[0])

    @property
    def in_hands(self) -> frozenset[int]:
        """Blocks that hands hold when it is done or while it is."""
        return self.held | {p.block for p in self.placements if p.action == "hold"}

    @property
    def wanted(self) -> list[tuple[BlockShape, int]]:
        """Shapes and how many of each the card takes."""
        count = Counter(id(p.shape) for p in self.placements if p.action == "place")
        shapes = {id(p.shape): p.shape for p in self.placements}
        return [(shapes[key], number) for key, number in count.items()]


class BillLine(NamedTuple):
    """How many blocks of a shape there have to be."""

    shape: BlockShape
    built: int
    """Placed, and there in the end."""
    props: int
    """The most that serve as props at one time."""
    standing: int
    """There from the start."""


@dataclass(frozen=True, eq=False)
class Instructions:
    """How an assembly is built by hand."""

    assembly: Assembly
    origin: np.ndarray
    """float64[3]: O [m, world]."""
    extent: np.ndarray
    """float64[3]: of what stands in the end [m]."""
    joint: float
    """Width of vertical joints of a lattice [m]; 0 where there are none."""
    shapes: tuple[BlockShape, ...]
    start: tuple[Placement, ...]
    """What stands from the start."""
    groups: tuple[Group, ...]
    layers: int
    """How many there are, of what stands from the start, too."""

    @property
    def askew(self) -> bool:
        """Whether the corner 1 of any block is told."""
        return any(p.askew for p in (*self.start, *self.placements))

    @property
    def in_order(self) -> bool:
        """Whether blocks of one card are placed in the order of their numbers, not in any."""
        return self.assembly.joint.law == "clutch"

    @property
    def bill(self) -> list[BillLine]:
        """What is needed of every shape."""
        built: Counter[str] = Counter()
        props: Counter[str] = Counter()
        most: Counter[str] = Counter()
        needed: Counter[str] = Counter()
        there = Counter(placement.shape.letter for placement in self.start)
        for placement in (p for group in self.groups for p in group.placements):
            letter = placement.shape.letter
            change = _CHANGE.get(placement.action, 0)
            if placement.prop:
                props[letter] += change
                most |= props
            else:
                # What has been taken away may come again elsewhere.
                built[letter] += change
                needed |= built
        lines = [
            BillLine(s, needed[s.letter], most[s.letter], there[s.letter]) for s in self.shapes
        ]
        return [line for line in lines if any(line[1:])]

    @property
    def placements(self) -> list[Placement]:
        """What is done to which block, in order."""
        return [placement for group in self.groups for placement in group.placements]


def instructions(assembly: Assembly) -> Instructions:
    """The instructions to build an assembly, card by card; steps are those of the assembly.

    Several blocks are on one card where nothing is at stake: blocks of one layer that follow one
    another in the order of building, none of them a prop, each carried straight down to the ground,
    so that whatever is placed first stands. Bricks that clutch are on one card wherever they are
    in a layer, as they are placed in the order that is proven. At most :data:`MOST_TOGETHER`. All
    others have cards of their own, with what hands do before and after: a block that has just come
    is held, others are let go; who holds another one does so for what comes next. Blocks without
    steps are told one by one in the order they are given.
    """
    finished = np.concatenate([block.vertices for block in assembly.finished.blocks])
    origin, high = finished.min(0), finished.max(0)
    joint = joint_width(assembly)
    shapes = shapes_of(assembly, origin, joint)
    steps: list[tuple[int, Action]] = [(assembly.index(s.block), s.action) for s in assembly.steps]
    steps = steps or [(k, "place") for k, b in enumerate(assembly.blocks) if not b.support]
    told = assembly.at_first if assembly.steps else [b.support for b in assembly.blocks]
    placements = [_placement(assembly, shapes, k, n, a) for n, (k, a) in enumerate(steps, 1)]
    heights = np.array([block.vertices[:, 2].min() for block in assembly.blocks]) - origin[2]
    # What only goes has no layer of its own.
    gone = {k for k, action in steps if action == "remove"}
    there = {k for k, action in steps if action == "place"}
    there |= {k for k, first in enumerate(told) if first and k not in gone}
    layers = _layers(heights[sorted(there or gone)])
    return Instructions(
        assembly,
        origin,
        high - origin,
        joint,
        tuple(shapes.found),
        tuple(_placement(assembly, shapes, k, 0, "place") for k, there in enumerate(told) if there),
        tuple(_groups(assembly, placements, heights, layers)),
        len(layers),
    )


def shapes_of(assembly: Assembly, origin: np.ndarray | None = None, joint: float = 0.0) -> Shapes:
    """The shapes of all blocks, those that are not built after the others.

    Args:
        assembly: their letters are those of its instructions.
        origin: O, float64[3] [m, world]; the world's where places are not asked for.
        joint: width of vertical joints of a lattice [m].
    """
    origin = np.zeros(3) if origin is None else origin
    left_out = set(assembly.not_built)
    pairs = zip(assembly.blocks, kinds_and_colours(assembly), strict=True)
    named = [Named(block, kind, colour) for block, (kind, colour) in pairs]
    return Shapes(origin, joint, sorted(named, key=lambda one: one.block.id in left_out))


def _placement(
    assembly: Assembly, shapes: Shapes, index: int, number: int, action: Action
) -> Placement:
    """What a step does to a block, with what the step says besides."""
    block = assembly.blocks[index]
    found = Placement(number, index, *shapes.pose(block), action, block.prop)
    if not number or not assembly.steps:
        return found
    step = assembly.steps[number - 1]
    return replace(found, by_hand=bool(step.by_hand), way=step.way, wait=step.wait)


def _layers(heights: np.ndarray) -> list[float]:
    """Heights at which layers begin, from below [m over O]."""
    layers: list[float] = []
    for height in np.sort(heights).tolist():
        if not layers or height > layers[-1] + 1e-4:
            layers.append(height)
    return layers


def _groups(
    assembly: Assembly, placements: list[Placement], heights: np.ndarray, layers: list[float]
) -> list[Group]:
    """What every card tells.

    Args:
        heights: float64[B], of all blocks over O [m].
        layers: as of :func:`_layers`.
    """
    found, seen, held = list[Group](), set[int](), frozenset[int]()
    for number, members in enumerate(_together(assembly, placements, heights), 1):
        for p in members:
            held = held ^ {p.block} if p.action in HANDS else held
        group = Group(number, tuple(members), 0, 0.0, False, held)
        height = float(heights[group.main.block])
        layer = max(int(np.searchsorted(np.array(layers) - 1e-9, height, side="right")), 1)
        first = layer not in seen and group.main.action == "place"
        seen |= {layer} if first else set[int]()
        found.append(replace(group, layer=layer, level=height, first=first))
    return found


def _together(
    assembly: Assembly, placements: list[Placement], heights: np.ndarray
) -> list[list[Placement]]:
    """What is told on each card, see :func:`instructions`."""
    upright, clutches = _carried_straight_down(assembly), assembly.joint.law == "clutch"
    # Where blocks of the structure go, what is below at last may not be there yet.
    goes = any(p.action == "remove" and not p.prop for p in placements)
    found: list[list[Placement]] = []
    free = False
    for p in placements:
        members = found[-1] if found else []
        mains = [q for q in members if q.action not in HANDS]
        hands = p.action in HANDS
        alone = p.action != "place" or p.prop or p.by_hand or p.way or p.wait or goes
        # Bricks come in the proven order, so nothing is at stake however they stand.
        alone = bool(alone or not (upright[p.block] or clutches))
        if p.wait is not None or not members:
            joins = False  # Time passes before it.
        elif not mains:
            joins = True  # Hands that hold for what comes now.
        elif hands:
            joins = p.action == "release" or (
                mains[-1] is members[-1] and mains[-1].block == p.block
            )
        else:
            level = abs(heights[p.block] - heights[mains[-1].block]) <= 1e-4
            joins = free and not alone and level and len(mains) < MOST_TOGETHER
        if joins:
            members.append(p)
        else:
            found.append([p])
        free = not alone and not any(q.action in HANDS for q in found[-1])
    return found


def _carried_straight_down(assembly: Assembly) -> np.ndarray:
    """bool[B]: whether the column below a block is filled down to the ground.

    Its weight then goes straight down, whatever else stands, so no order can make it fall.
    """
    import shapely

    prisms = [is_prism(block) for block in assembly.blocks]
    areas = [
        sections(b)[0].area if good else shapely.Point()
        for b, good in zip(assembly.blocks, prisms, strict=True)
    ]
    low = np.array([block.vertices[:, 2].min() for block in assembly.blocks])
    high = np.array([block.vertices[:, 2].max() for block in assembly.blocks])
    floor = min(0.0, float(low.min())) if abs(low.min()) > 1e-6 else float(low.min())
    tree = shapely.STRtree(areas)
    filled = np.zeros(len(areas), bool)
    order: list[int] = np.argsort(low, kind="stable").tolist()
    for k in order:
        block = assembly.blocks[k]
        if not prisms[k] or block.prop:
            continue
        if block.support or abs(low[k] - floor) <= 1e-5:
            filled[k] = True
            continue
        below: list[int] = [
            j for j in tree.query(areas[k]).tolist() if filled[j] and abs(high[j] - low[k]) <= 1e-5
        ]
        carried = sum(areas[k].intersection(areas[j]).area for j in below)
        filled[k] = carried >= _COVERED * areas[k].area
    return filled
