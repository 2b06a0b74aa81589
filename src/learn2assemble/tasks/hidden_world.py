"""A world of given blocks that are put down with hidden errors: what happens, and what stands.

Blocks are boxes, each with one place in a design. They lie level, in courses, but turned and
displaced as the hand left them. What stands is judged where the blocks truly are, by the statics
that ``l2a check`` asks: a local proof first, the program of rigid blocks else.

* A block that would overlap another one of its course is not put down: the hand feels it.
* While a block is put down or taken up all that stands is jolted, by a sideways acceleration; then
  it has to stand at rest. Blocks that move first fall with all that rests on them, back to the
  heap, until the rest stands.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from learn2assemble.assembly.blocks import Assembly, Block
from learn2assemble.assembly.boxes import box_block
from learn2assemble.assembly.contacts import Contacts, find_contacts, shrunk
from learn2assemble.statics.forces.equilibrium import solve
from learn2assemble.statics.rigid_blocks import bed_patches
from learn2assemble.statics.step_proof import (
    EDGE_INSET,
    Proof,
    Stack,
    lies_above,
    stack_of_contacts,
)
from learn2assemble.tasks.designs import FAMILIES, make_design
from learn2assemble.tasks.hidden_errors import HiddenNumbers, Placing
from learn2assemble.tasks.task import DesignTask, HiddenTask

JOINT = 2e-3
"""Blocks are narrower than their cells by this, along x and y, so that they can go in beside one
another [m]."""
TOLERANCE = 3e-3
"""A block is in its place where no corner of it, were its size exact, is farther from its place
[m]."""
_DRAWN = 50
"""Designs that are drawn before one has to stand with joints as wide."""


@dataclass(frozen=True, eq=False)
class GivenBlocks:
    """A design as blocks, numbered from below."""

    family: str
    middle: np.ndarray
    """float64[n, 3]: of every block in its place [m]."""
    size: np.ndarray
    """float64[n, 3]: nominal, along x, y and z [m]."""
    density: float
    order: tuple[int, ...]
    """One in which every state stands, where nothing goes wrong."""

    def __len__(self) -> int:
        return len(self.middle)

    @cached_property
    def rests_on(self) -> np.ndarray:
        """bool[n, n]: whether block i rests on block j in the design."""
        low, high = self.middle - self.size / 2, self.middle + self.size / 2
        meet = (low[:, None, :2] < high[None, :, :2]) & (low[None, :, :2] < high[:, None, :2])
        return meet.all(2) & (np.abs(low[:, None, 2] - high[None, :, 2]) < 1e-6)

    @cached_property
    def beside(self) -> np.ndarray:
        """bool[n, n]: other blocks of the same course."""
        same = np.abs(self.middle[:, None, 2] - self.middle[None, :, 2]) < 1e-6
        return same & ~np.eye(len(self), dtype=bool)


def make_given_blocks(task: HiddenTask, rng: np.random.Generator) -> GivenBlocks:
    """A random design whose known order stands without errors, drawn again until one does."""
    drawn = DesignTask(task.name, task.families or tuple(FAMILIES), task.kit, task.blocks)
    found = _given(drawn, rng)
    for _ in range(_DRAWN):
        world = HiddenWorld(found, exact_numbers(len(found)))
        if all(world.place(block, np.zeros(3), STILL).verdict == "placed" for block in found.order):
            break
        found = _given(drawn, rng)
    return found


def _given(task: DesignTask, rng: np.random.Generator) -> GivenBlocks:
    solved = make_design(task, rng)
    site, kit = solved.site, solved.kit
    pitch = np.array(kit.pitch)
    shape = site.wanted.shape
    corners = [np.stack(np.unravel_index(site.cells(c), shape), 1) for c in solved.order]
    low = pitch * [cells.min(0) for cells in corners]
    high = pitch * [cells.max(0) + 1 for cells in corners]
    # The middle of the design is that of the world, and numbers tell nothing of the order.
    low[:, :2], high[:, :2] = (end[:, :2] - pitch[:2] * shape[:2] / 2 for end in (low, high))
    number = np.lexsort((low[:, 0], low[:, 1], low[:, 2]))
    size = (high - low - [JOINT, JOINT, 0.0])[number]
    middle = ((low + high) / 2)[number]
    order = np.argsort(number)
    return GivenBlocks(solved.family, middle, size, kit.density, tuple(order.tolist()))


def exact_numbers(count: int) -> HiddenNumbers:
    """Of a build in which nothing goes wrong."""
    return HiddenNumbers(np.zeros(3), np.zeros((count, 2)), 0.5)


STILL = Placing(np.zeros(3), np.zeros(2))
"""A placement in which nothing goes wrong."""


@dataclass(frozen=True)
class Happened:
    """What came of an attempt.

    Attributes:
        verdict: ``placed``, ``taken``, ``collides`` or ``falls``.
        fallen: the blocks that are back in the heap.
    """

    verdict: str
    fallen: tuple[int, ...] = ()


class HiddenWorld:
    """Where blocks truly are.

    Args:
        design: the blocks and their places.
        numbers: that nobody is told.
    """

    def __init__(self, design: GivenBlocks, numbers: HiddenNumbers) -> None:
        self.design = design
        self.numbers = numbers
        self.size: np.ndarray = design.size.copy()
        """float64[n, 3]: true ones [m]."""
        self.size[:, :2] += numbers.size
        self.pose: np.ndarray = np.zeros((len(design), 3))
        """float64[n, 3]: x, y [m], yaw [rad], of blocks that stand."""
        self.stands: np.ndarray = np.zeros(len(design), bool)
        self._blocks: dict[int, Block] = {}

    def copy(self) -> HiddenWorld:
        """One that may be changed."""
        other = HiddenWorld(self.design, self.numbers)
        other.pose, other.stands = self.pose.copy(), self.stands.copy()
        other._blocks = dict(self._blocks)
        return other

    # ------------------------------------------------------------ what may be done

    def may_place(self) -> np.ndarray:
        """bool[n]: in the heap, all that carries it in the design stands, nothing above it does."""
        on = self.design.rests_on
        ready = ~(on & ~self.stands).any(1)
        return ~self.stands & ready & ~(on.T & self.stands).any(1)

    def may_take(self) -> np.ndarray:
        """bool[n]: stands, and nothing of the design that rests on it does."""
        return self.stands & ~(self.design.rests_on.T & self.stands).any(1)

    # ------------------------------------------------------------ what happens

    def place(self, block: int, correction: np.ndarray, placing: Placing) -> Happened:
        """Put a block down at its place and a correction float64[3], x, y [m], yaw [rad]."""
        released = np.append(self.design.middle[block, :2], 0.0) + correction + self.numbers.bias
        pose = released + placing.slip
        others = np.flatnonzero(self.design.beside[block] & self.stands)
        size = self.size[block, :2]
        if any(overlap(pose, size, self.pose[k], self.size[k, :2]) > 0 for k in others.tolist()):
            return Happened("collides")
        self.put(block, pose)
        return self._settled("placed", placing.jolt)

    def put(self, block: int, pose: np.ndarray) -> None:
        """Have a block stand somewhere, whatever comes of it."""
        self.pose[block], self.stands[block] = pose, True
        self._blocks.pop(block, None)

    def take(self, block: int, placing: Placing) -> Happened:
        """Take a block up, back to the heap."""
        self._drop([block])
        return self._settled("taken", placing.jolt)

    def _settled(self, verdict: str, jolt: np.ndarray) -> Happened:
        fallen: list[int] = []
        for push in (jolt, np.zeros(2)):
            while len(gone := self.moving(push)):
                self._drop(gone)
                fallen += gone
        return Happened("falls" if fallen else verdict, tuple(sorted(fallen)))

    def _drop(self, blocks: list[int]) -> None:
        self.stands[blocks], self.pose[blocks] = False, 0.0
        for block in blocks:
            self._blocks.pop(block, None)

    # ------------------------------------------------------------ what stands

    def assembly(self) -> Assembly:
        """What stands, where it truly is."""
        blocks = tuple(self._block(k) for k in np.flatnonzero(self.stands).tolist())
        return Assembly(blocks, friction=self.numbers.friction)

    def stack(self) -> tuple[Assembly, Contacts, Stack]:
        """What stands, its bed joints, and these as a proof takes them."""
        assembly = self.assembly()
        every = find_contacts(assembly)
        contacts = every.only(bed_patches(every))
        least = float(self.size[self.stands, :2].min())
        return (
            assembly,
            contacts,
            stack_of_contacts(assembly.blocks, shrunk(contacts, EDGE_INSET * least)),
        )

    def moving(self, jolt: np.ndarray) -> list[int]:
        """Blocks that fall under a sideways acceleration float64[2] [g]; none where all stands."""
        if not self.stands.any():
            return []
        assembly, contacts, stack = self.stack()
        size, every = float(np.hypot(*jolt)), np.ones(len(stack), bool)
        proven = Proof(stack, (float(jolt[0]), float(jolt[1]))).settle(every, every, mends=True)
        if proven and size <= self.numbers.friction:
            return []
        if size > 0:
            # Tilted, weight acts on the blocks as it does with the acceleration.
            assembly, contacts = tilted(assembly, contacts, jolt)
        found = solve(assembly, contacts, coupled=size == 0)
        if found.stands:
            return []
        numbers = np.flatnonzero(self.stands)
        return numbers[lies_above(stack, found.moving.tolist() or range(len(stack)))].tolist()

    def in_place(self) -> np.ndarray:
        """bool[n]: blocks that stand within the tolerance of their place."""
        off = np.array(
            [
                corner_distance(pose - np.append(middle[:2], 0.0), size[:2])
                for pose, middle, size in zip(
                    self.pose, self.design.middle, self.design.size, strict=True
                )
            ]
        )
        return self.stands & (off <= TOLERANCE)

    def _block(self, block: int) -> Block:
        if block not in self._blocks:
            half, z = self.size[block] / 2, self.design.middle[block, 2]
            made = box_block(str(block), -half, half, density=self.design.density)
            x, y, yaw = self.pose[block]
            cos, sin = np.cos(yaw), np.sin(yaw)
            turned = made.vertices @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]])
            self._blocks[block] = replace(made, vertices=turned + np.array([x, y, z]))
        return self._blocks[block]


def tilted(assembly: Assembly, contacts: Contacts, jolt: np.ndarray) -> tuple[Assembly, Contacts]:
    """Blocks and contacts turned so that an acceleration float64[2] [g] and weight act downwards.

    Which way is up does not matter to programs of forces, nor how large gravity is.
    """
    up = np.append(jolt, 1.0) / np.hypot(1.0, np.hypot(*jolt))
    axis = np.array([up[1], -up[0], 0.0])
    cross = np.array([[0, 0, axis[1]], [0, 0, -axis[0]], [-axis[1], axis[0], 0]])
    turn = np.eye(3) + cross + cross @ cross / (1 + up[2])
    blocks = tuple(replace(one, vertices=one.vertices @ turn.T) for one in assembly.blocks)
    contacts = contacts._replace(normal=contacts.normal @ turn.T, points=contacts.points @ turn.T)
    return replace(assembly, blocks=blocks), contacts


# ---------------------------------------------------------------- rectangles


def corners(pose: np.ndarray, size: np.ndarray) -> np.ndarray:
    """float64[4, 2] of a rectangle at x, y, yaw with a length along x and along y."""
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    local = size / 2 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    return pose[:2] + local @ np.array([[cos, sin], [-sin, cos]])


def overlap(pose: np.ndarray, size: np.ndarray, other: np.ndarray, extent: np.ndarray) -> float:
    """How deep two rectangles are in one another; where they are not, less their gap [m].

    The gap is that along the normal of a side, the largest of all four.
    """
    mine, its = corners(pose, size), corners(other, extent)
    deep = np.inf
    for yaw in (pose[2], other[2]):
        for normal in ((np.cos(yaw), np.sin(yaw)), (-np.sin(yaw), np.cos(yaw))):
            a, b = mine @ normal, its @ normal
            deep = min(deep, a.max() - b.min(), b.max() - a.min())
    return float(deep)


def corner_distance(deviation: np.ndarray, size: np.ndarray) -> float:
    """The farthest that a deviation float64[3], x, y [m], yaw [rad], takes a corner [m]."""
    moved = corners(deviation, size) - corners(np.zeros(3), size)
    return float(np.sqrt((moved**2).sum(1)).max())
