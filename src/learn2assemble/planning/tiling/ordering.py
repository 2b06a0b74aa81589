"""In which order blocks are put down, and props taken away, so that every state is proven to stand.

Blocks go from below, each on what carries it in the finished building; one that does not stand yet
waits until others have been placed. Every state is proven by :mod:`step_proof`: on bed faces
alone, without friction, so for every coefficient of friction and however open the vertical joints
are. What the sideways acceleration and the tilt of a state are worth is proven the same way.

A state that these forces do not balance may stand by friction on its bed faces (``BED``) and, only
where no gap is asked for, by side faces that press (``TIGHT``): the coupled analysis of
:mod:`learn2assemble.statics.rigid_blocks` proves it at both ends of the range of friction, and the
step says so.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from learn2assemble.assembly.blocks import Assembly, AssemblyStep, Block
from learn2assemble.assembly.kit import Kit
from learn2assemble.errors import InputError
from learn2assemble.linear_programs import INF, Clock
from learn2assemble.planning.tiling.stack import find_stack
from learn2assemble.planning.tiling.tile import (
    MORE_TIME,
    Tiling,
    placement_cells,
)
from learn2assemble.progress import Progress, silent
from learn2assemble.statics.proofs import (
    BED,
    FRICTIONLESS,
    LOCAL,
    PROGRAM,
    TIGHT,
    Bounds,
    value_range,
)
from learn2assemble.statics.sideways import Sideways
from learn2assemble.statics.step_proof import Proof, Stack, lies_below

if TYPE_CHECKING:
    from learn2assemble.assembly.contacts import Contacts

_FIRMED, _WEAK, _FIRM_BLOCKS = 6, 0.02, 200
"""How many of the weakest steps are looked at again by programs, below which margin [g], and of at
most how many blocks."""
_GAP_TRIALS = 7


@dataclass(frozen=True)
class OrderedStep:
    """One step of building and what is proven about the state after it."""

    place: int | None
    remove: int | None
    """Index into ``Tiling.placements``; exactly one of the two is given."""
    proof: str
    """``LOCAL``, ``PROGRAM``, ``BED`` or ``TIGHT``."""
    margin_g: float
    """Sideways acceleration that the state at least withstands in every direction [g]."""

    @property
    def block(self) -> int:
        """What is placed or removed."""
        index = self.remove if self.place is None else self.place
        assert index is not None
        return index


@dataclass(frozen=True)
class Ordering:
    """The order of building a tiling."""

    steps: tuple[OrderedStep, ...]
    status: str
    """``"complete"``, ``"refused"``, ``"not found"`` or ``"time"``."""
    reason: str = ""
    """Why it is not complete, in one line."""
    margin_g: float = 0.0
    """Of the weakest step [g]."""
    friction_range: tuple[float, float] = (0.0, INF)
    """Coefficients of friction for which every step is proven to stand; where it is needed, the
    two ends at which it was. (Margins need a friction of at least their own size.)"""
    gap_range: tuple[float, float] = (0.0, 0.0)
    """Widths of vertical joints for which every step is proven to stand [m]."""
    stuck: tuple[int, ...] = ()
    """Placements that could not be placed, or props that could not be removed."""
    falls: tuple[int, ...] = ()
    """Placements that would move if the next one were placed."""
    seconds: float = 0.0


class Coupled:
    """The blocks of a tiling, for the coupled analysis of any of its states.

    Args:
        friction: the coefficients at which a state has to stand.
        law: ``TIGHT``, without gaps and with side faces that press, or ``BED``.
        gap: width of vertical joints [m], of ``BED``.
    """

    def __init__(
        self,
        tiling: Tiling,
        kit: Kit,
        friction: tuple[float, float],
        law: str = TIGHT,
        gap: float = 0.0,
    ) -> None:
        self.tiling, self.kit, self.friction = tiling, kit, sorted(set(friction))
        self.law, self.gap = law, gap
        self._stiffness = 0.0

    @cached_property
    def assembly(self) -> tuple[Assembly, Contacts]:
        from learn2assemble.assembly.contacts import find_contacts
        from learn2assemble.statics.rigid_blocks import bed_patches

        made = to_assembly(self.tiling, None, self.kit, gap=self.gap)
        contacts = find_contacts(made)
        return made, contacts if self.law == TIGHT else contacts.only(bed_patches(contacts))

    def margin(self, placed: np.ndarray) -> float | None:
        """The sideways acceleration in every direction [g] that the blocks ``placed`` (bool[n])
        withstand by rigid-block equilibrium, where they stand.

        None where they fall, and where they are balanced on an edge.
        """
        from learn2assemble.statics.rigid_blocks import NO_MARGIN, STIFFNESS, margin, solve

        made, contacts = self.assembly
        for mu in self.friction:
            # What worked for the state before mostly does again.
            ratios = sorted(STIFFNESS, key=lambda ratio: ratio != self._stiffness)
            found = solve(made, contacts, mu, present=placed, stiffness=tuple(ratios))
            if not found.stands:
                return None
            self._stiffness = found.stiffness
        worth = margin(made, contacts, self.friction[0], present=placed)
        return worth if worth >= NO_MARGIN else None


def _changed(
    stack: Stack, placed: np.ndarray, block: int, place: bool
) -> tuple[np.ndarray, np.ndarray]:
    """``placed`` (bool[n]) with a block placed or removed, and the blocks to balance again."""
    after, dirty = placed.copy(), np.zeros_like(placed)
    after[block] = place
    if place:
        dirty[block] = True
    else:
        dirty[stack.tops[block]] = True
        dirty[stack.below(block)] = True
        dirty &= after
    return after, dirty


class _ProvenStack:
    """What stands, and the forces that prove it under gravity and under sideways acceleration."""

    def __init__(
        self,
        tiling: Tiling,
        kit: Kit,
        gap: float,
        friction: float,
        clock: Clock,
        coupled: Coupled | None,
    ) -> None:
        self.blocks, self.clock, self.coupled = tiling.placements, clock, coupled
        self.law = BED if coupled is None else coupled.law
        self.cells = [placement_cells(block, kit) for block in self.blocks]
        self.wanted, self.filled = tiling.wanted, np.zeros_like(tiling.wanted)
        self.stack = stack = find_stack(self.blocks, kit, tiling.wanted.shape, gap)
        self.placed, self.done = np.zeros((2, len(stack)), bool)  # done: or taken away again
        self.proof, self.friction = Proof(stack), friction
        self.sideways = Sideways(stack, friction)
        self.timed_out = self.by_friction = False
        self.pressed: dict[bytes, float | None] = {}
        self.steps: list[OrderedStep] = []

    @property
    def late(self) -> bool:
        """Whether time has run out."""
        return self.clock.left <= 0 or self.timed_out

    def tell(self) -> None:
        """How far the order has come."""
        weakest = min((step.margin_g for step in self.steps), default=0.0)
        self.clock.tell(
            f"proving the order: {len(self.steps)} steps of {len(self.blocks)} blocks, the "
            f"weakest withstands {weakest:.3f} g"
        )

    def fill(self, block: int, there: bool) -> None:
        """Mark the cells of a block."""
        self.filled[tuple(self.cells[block].T)] = there

    def props_on(self, block: int) -> list[int]:
        """Props that stand on a block."""
        upper = self.stack.tops[block].tolist()
        return [b for b in upper if self.placed[b] and self.blocks[b].prop]

    def change(self, block: int, place: bool, raising: bool) -> bool:
        """Place or remove a block where the state that this makes is proven; whether it was.

        Args:
            raising: look for larger margins than those of the state before.
        """
        self.tell()
        method = self._proven(block, place)
        if method is None:
            return False
        if raising:
            self.raise_margins()
        self.fill(block, place)
        self.done |= self.placed
        step = (block, None) if place else (None, block)
        self.steps.append(OrderedStep(*step, method, self.margin()))
        return True

    def _proven(self, block: int, place: bool) -> str | None:
        """How the state with a block placed or removed is proven; None (and no change) if it
        falls."""
        placed, dirty = _changed(self.stack, self.placed, block, place)
        if self.by_friction:
            dirty = placed.copy()  # There are no bed forces to begin with.
        method = LOCAL if self.proof.settle(dirty, placed) else self._by_program(placed, dirty)
        if method is None and self.coupled is not None:
            if placed.tobytes() not in self.pressed:
                self.pressed[placed.tobytes()] = self.coupled.margin(placed)
            method = None if self.pressed[placed.tobytes()] is None else self.coupled.law
        if method is None:
            return None
        had_friction, self.by_friction = self.by_friction, method in (BED, TIGHT)
        self.placed = placed
        if self.by_friction:
            self.sideways.drop()
        elif not had_friction:
            self.sideways.follow(dirty, placed, self.proof.force, self.clock)
        if had_friction or (method == PROGRAM and self.margin() <= 0):
            self.raise_margins()
        return method

    def _by_program(self, placed: np.ndarray, dirty: np.ndarray) -> str | None:
        for block in np.flatnonzero(dirty):
            alone = np.zeros_like(placed)
            alone[block] = True
            # With nothing on it, a block that its own bed faces cannot balance falls for sure.
            free = not placed[self.stack.tops[block]].any()
            if free and self.proof.program(placed, alone, self.clock.left) is False:
                return None
        if not self.by_friction and self.proof.settle(dirty, placed, mends=True):
            return PROGRAM
        changing = lies_below(self.stack, np.flatnonzero(dirty).tolist(), placed)
        for blocks in (placed,) if self.by_friction else (changing, placed):
            found = self.proof.program(placed, blocks, self.clock.left)
            if found:
                return PROGRAM
            self.timed_out |= found is None
        return None

    def margin(self) -> float:
        """Sideways acceleration the state at least withstands in every direction [g]."""
        if self.by_friction:
            return min(self.pressed[self.placed.tobytes()] or 0.0, self.friction)
        return self.sideways.radius

    def raise_margins(self) -> None:
        """Look for larger margins than those that have come down from states before."""
        if not self.by_friction:
            self.sideways.search(self.placed, self.proof.force, self.clock)

    def place_all(self, given: bool) -> list[int]:
        """Place everything; what is stuck, or all that is left where time ran out.

        A prop that the finished building encloses is taken away before the block that would close
        its way out; where all that is left waits for that, the props are what is stuck.
        """
        count = len(self.blocks)
        below = [self.stack.below(b) for b in range(count)]
        enclosed = [
            b
            for b in range(count)
            if self.blocks[b].prop and not way_out(self.wanted, self.cells[b])
        ]
        left, level = list(range(count)), 0
        if not given:
            left.sort(key=lambda b: (self.blocks[b].origin[::-1], b))
        waits: dict[int, list[int]] = {}
        # Props are kept as long as anything else can be placed.
        freeing = False
        while left:
            before = len(left)
            for b in list(left):
                if self.late:
                    return left
                if not self.done[below[b]].all() or (freeing and not waits.get(b)):
                    continue
                self.fill(b, True)
                waits[b] = self.trapped(enclosed)
                self.fill(b, False)
                if waits[b] and freeing:
                    waits[b] = self.remove(waits[b])
                high = self.blocks[b].origin[2]
                if not waits[b] and self.change(b, True, high > level):
                    level = max(level, high)
                    left.remove(b)
                    if freeing:
                        break
            if len(left) == before and freeing:
                break
            freeing = len(left) == before
        ready = [b for b in left if self.done[below[b]].all()] or left
        held = {p for b in ready for p in waits.get(b, ())}
        return [b for b in ready if not waits.get(b)] or sorted(held)

    def trapped(self, props: list[int]) -> list[int]:
        """Those of ``props`` that stand and that the structure walls in, and the props on them."""
        there = [p for p in props if self.placed[p]]
        if not there:
            return []
        structure = self.filled.copy()
        structure[tuple(np.concatenate([self.cells[p] for p in there]).T)] = False
        found = [p for p in there if not way_out(structure, self.cells[p])]
        for p in found:
            found += [a for a in self.props_on(p) if a not in found]
        return found

    def remove(self, props: list[int]) -> list[int]:
        """Take props away, from above; those that cannot be."""
        left = sorted(
            (b for b in props if self.placed[b]),
            key=lambda b: (-self.blocks[b].origin[2], self.blocks[b].origin),
        )
        before = None
        while left != before:
            before = list(left)
            for b in before:
                if self.late:
                    return left
                free = not self.props_on(b) and leaves(self.filled, self.cells[b])
                if free and self.change(b, False, True):
                    left.remove(b)
        return left


def order(
    tiling: Tiling,
    kit: Kit,
    *,
    friction: Bounds = None,
    gap: Bounds = None,
    seconds: float = 60.0,
    law: str = FRICTIONLESS,
    given: bool = False,
    progress: Progress = silent,
) -> Ordering:
    """The order of building ``tiling``, every state proven before the next.

    Args:
        friction: coefficient, or the range (smallest, largest) to prove it for; that of the kit
            without it. It bounds the margins; standing itself needs none on bed faces.
        gap: width of vertical joints [m], or the range to prove it for; that of the kit without it.
        seconds: wall-clock limit.
        law: what may carry a state: ``FRICTIONLESS``, ``BED`` or, where the gap is 0, ``TIGHT``.
        given: try the blocks in the order of the tiling instead of from below.
        progress: told how many steps are proven, and what the weakest withstands.
    """
    clock = Clock(seconds, progress=progress)
    ends = value_range(friction, kit.friction, "friction")
    widest = value_range(gap, kit.joint_gap, "gap")[1]
    if law == TIGHT and widest > 0:
        raise InputError("gap", widest, "0, for tight joints")
    limit = min(kit.pitch[:2]) / 2
    if widest >= limit:
        raise InputError("gap", widest, f"less than half the pitch, {limit:g} m")
    blocks = tiling.placements
    coupled = None if law == FRICTIONLESS else Coupled(tiling, kit, ends, law, widest)
    site = _ProvenStack(tiling, kit, widest, ends[0], clock, coupled)
    stuck = site.place_all(given) or site.remove([b for b in range(len(blocks)) if blocks[b].prop])
    stuck.sort(key=lambda b: blocks[b].prop)
    steps, status, reason, falls = site.steps, "complete", "", ()
    if stuck and site.late:
        status, stuck = "time", []
        reason = f"time ran out after {seconds:g} s with {len(steps)} steps proven; {MORE_TIME}"
    elif stuck:
        status, reason = "not found", _why_stuck(site, stuck[0])
        if not blocks[stuck[0]].prop:
            placed = site.placed.copy()
            placed[stuck[0]] = True
            falls = tuple(site.proof.held(placed, clock.left))
    if status == "complete" and len(blocks) <= _FIRM_BLOCKS:
        _firm(site)
    margin = min((step.margin_g for step in steps), default=0.0)
    rubs = any(step.proof in (BED, TIGHT) for step in steps)
    gaps = (0.0, widest)
    if status == "complete" and not rubs:
        gaps = 0.0, _widest_gap(tiling, kit, steps, widest, clock)
    return Ordering(
        tuple(steps),
        status,
        reason,
        margin,
        ends if rubs else (0.0, INF),
        gaps,
        tuple(stuck),
        falls,
        clock.spent,
    )


def _firm(site: _ProvenStack) -> None:
    """Look again, by programs, for the margins of the weakest steps that bed faces carry."""
    for _ in range(_FIRMED):
        site.tell()
        weakest = min(range(len(site.steps)), key=lambda n: site.steps[n].margin_g)
        step = site.steps[weakest]
        if step.margin_g >= _WEAK or step.proof not in (LOCAL, PROGRAM) or site.late:
            break
        placed = np.zeros(len(site.stack), bool)
        for done in site.steps[: weakest + 1]:
            placed[done.block] = done.place is not None
        sideways = Sideways(site.stack, site.friction)
        sideways.firm(placed, site.clock)
        if sideways.radius <= step.margin_g:
            break
        site.steps[weakest] = replace(step, margin_g=sideways.radius)


def _why_stuck(site: _ProvenStack, number: int) -> str:
    """Why a block cannot be placed, or a prop not be taken away, in one line."""
    block = site.blocks[number]
    name = f"{'prop' if block.prop else 'block'} {block.kind} at {block.origin}"
    if not block.prop:
        return f"{name} does not stand: nothing balances it on {site.law}"
    if not site.placed[number]:
        return f"{name} can only be placed where it would be walled in"
    return f"{name} cannot be taken away: it is walled in, or what it carries would fall"


def leaves(filled: np.ndarray, cells: np.ndarray) -> bool:
    """Whether a block can be moved out from where it stands among the ``filled`` cells."""
    others = filled.copy()
    others[tuple(cells.T)] = False
    return way_out(others, cells)


def way_out(filled: np.ndarray, cells: np.ndarray) -> bool:
    """Whether steps of a cell along the axes, not through the table, lead a block outside.

    Args:
        filled: bool[X, Y, Z], cells it may not pass.
        cells: int[m, 3], its own.
    """
    from scipy.ndimage import label

    corner = cells.min(0)
    shape, extent = cells - corner, np.ptp(cells, axis=0) + 1
    room = np.pad(filled, [(int(n), int(n)) for n in extent[:2]] + [(0, int(extent[2]))])
    places = np.array(room.shape) - extent + 1
    free = np.ones(places, bool)
    for x, y, z in shape:
        free &= ~room[x : x + places[0], y : y + places[1], z : z + places[2]]
    part, _ = label(free)  # pyright: ignore[reportGeneralTypeIssues]
    return bool(part[corner[0] + extent[0], corner[1] + extent[1], corner[2]] == part[0, 0, 0])


def _widest_gap(
    tiling: Tiling, kit: Kit, steps: list[OrderedStep], proven: float, clock: Clock
) -> float:
    """The widest vertical joint, up to a quarter of the pitch, with a proof of every step [m]."""
    low, high = proven, min(kit.pitch[:2]) / 4
    trial = high
    for _ in range(_GAP_TRIALS if high > low else 0):
        if clock.left <= 0 or low == high:
            break
        clock.tell(f"how wide joints may be: {1e3 * low:.2f} mm so far")
        if _holds(tiling, kit, steps, trial, clock):
            low = trial
        else:
            high = trial
        trial = (low + high) / 2
    return low


def _holds(tiling: Tiling, kit: Kit, steps: list[OrderedStep], gap: float, clock: Clock) -> bool:
    """Whether every step is proven with vertical joints of another width."""
    stack = find_stack(tiling.placements, kit, tiling.wanted.shape, gap)
    proof, placed = Proof(stack), np.zeros(len(stack), bool)
    for step in steps:
        placed, dirty = _changed(stack, placed, step.block, step.place is not None)
        if not proof.settle(dirty, placed) and not proof.settle(dirty, placed, mends=True):
            proof = Proof(stack)  # Forces from nothing are spread, which leaves room for the next.
            if not proof.program(placed, placed, clock.left):
                return False
    return True


# ---------------------------------------------------------------- as an assembly


def to_assembly(
    tiling: Tiling,
    ordering: Ordering | None,
    kit: Kit,
    *,
    name: str = "",
    friction: float | None = None,
    gap: float | None = None,
) -> Assembly:
    """Blocks as polyhedra where they stand, with the steps of the ordering.

    Cell (i, j, k) of X x Y x Z is centred at ((i + 0.5 - X/2) dx, (j + 0.5 - Y/2) dy,
    (k + 0.5) dz); the sides of blocks lie inside their cells by half the joint gap.

    Args:
        gap: width of vertical joints [m]; that of the kit without it.
    """
    gap = kit.joint_gap if gap is None else gap
    kinds = {kind.name: kind for kind in kit.kinds}
    shapes: dict[tuple[str, int], tuple[np.ndarray, tuple[tuple[int, ...], ...]]] = {}
    middle = np.array([tiling.wanted.shape[0] / 2, tiling.wanted.shape[1] / 2, 0.0])
    blocks, ids = [], []
    for number, block in enumerate(tiling.placements):
        key = block.kind, block.turn
        if key not in shapes:
            shapes[key] = polycube(placement_cells(block, kit) - block.origin, kit, gap)
        vertices, faces = shapes[key]
        kind = kinds[block.kind]
        ids.append(f"{'prop' if block.prop else 'block'}-{number + 1}")
        moved = vertices + (np.array(block.origin) - middle) * kit.pitch
        density = kit.density if kind.density is None else kind.density
        blocks.append(
            Block(ids[-1], moved, faces, block.kind, density, prop=block.prop, colour=kind.colour)
        )
    steps = [
        AssemblyStep(ids[step.block])
        if step.remove is None
        else AssemblyStep(remove=ids[step.block])
        for step in (ordering.steps if ordering else ())
    ]
    friction = kit.friction if friction is None else friction
    return Assembly(tuple(blocks), tuple(steps), friction, name).as_far_as_placed()


_SQUARE = {
    (axis, side): [
        [side if k == axis else (u if k == (axis + 1) % 3 else v) for k in range(3)]
        for u, v in (((0, 0), (1, 0), (1, 1), (0, 1)) if side else ((0, 0), (0, 1), (1, 1), (1, 0)))
    ]
    for axis in range(3)
    for side in (0, 1)
}
"""Corners of the faces of a unit cell, counter-clockwise from outside."""


def polycube(
    cells: np.ndarray, kit: Kit, gap: float
) -> tuple[np.ndarray, tuple[tuple[int, ...], ...]]:
    """Vertices float64[V, 3] [m] and faces of cells (int[m, 3]) glued together.

    Faces are those of the cells, upright ones half a gap inside; the planes of faces, and no
    others, cut each other.
    """
    solid = np.zeros(cells.max(0) + 1, bool)
    solid[tuple(cells.T)] = True
    planes = []
    for axis, pitch in enumerate(kit.pitch):
        inset = gap / 2 if axis < 2 else 0.0
        solid, count = np.moveaxis(solid, axis, 0), solid.shape[axis]
        # A slab for every cell and, of the width of the gap, for every border of cells.
        slabs = np.zeros((2 * count + 1, *solid.shape[1:]), bool)
        slabs[1::2] = solid
        slabs[2:-1:2] = solid[:-1] & solid[1:]
        at = np.repeat(np.arange(count + 1) * pitch, 2)[1:-1] + np.tile([inset, -inset], count)
        if not inset:
            slabs, at = slabs[[0, *range(1, 2 * count, 2), 0]], np.arange(count + 1) * pitch
        is_face = (slabs[1:] != slabs[:-1]).reshape(len(at), -1).any(1)
        planes.append(at[is_face])
        solid = np.moveaxis(slabs[[0, *np.flatnonzero(is_face) + 1]], 0, axis)
    corners = []
    for cell in np.argwhere(solid):
        for (axis, side), face in _SQUARE.items():
            near = cell.copy()
            near[axis] += 2 * side - 1
            if not solid[tuple(near)]:
                corners.append([tuple((cell - 1 + corner).tolist()) for corner in face])
    number = {corner: k for k, corner in enumerate(sorted({c for face in corners for c in face}))}
    vertices = np.array([[planes[axis][k] for axis, k in enumerate(corner)] for corner in number])
    return vertices, tuple(tuple(number[corner] for corner in face) for face in corners)
