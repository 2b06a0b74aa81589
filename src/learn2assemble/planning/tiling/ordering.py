"""In which order blocks are put down, and props taken away, so that every state is proven to stand.

Blocks go from below, each on what carries it in the finished building; one that does not stand yet
waits until others have been placed. Every state is proven by :mod:`step_proof`: on bed faces
alone, without friction, so for every coefficient of friction and however open the vertical joints
are. What the sideways acceleration and the tilt of a state are worth is proven the same way.

A state that these forces do not balance may stand by friction on its bed faces (``BED``) and, only
where no gap is asked for, by side faces that press (``TIGHT``): the coupled analysis of
:mod:`learn2assemble.statics.rigid_blocks` proves it at both ends of the range of friction, and the
step says so. Of a kit with mortar (``MORTAR``) joints hold once one has waited their age; blocks
that come later are dry until the next wait.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from learn2assemble.assembly.blocks import Assembly, AssemblyStep, Block
from learn2assemble.assembly.kit import Kit
from learn2assemble.errors import InputError
from learn2assemble.linear_programs import INF, Clock
from learn2assemble.planning.forward import BuildingSite, Forward
from learn2assemble.planning.sequence import depth_first, reported
from learn2assemble.planning.tiling.cover.candidates import BlockPlacement, placement_cells
from learn2assemble.planning.tiling.cover.tile import MORE_TIME, Tiling, owners
from learn2assemble.planning.tiling.stack import find_stack
from learn2assemble.progress import Progress, silent
from learn2assemble.statics.laws import ByLoads, ByMortar, Law, Shown
from learn2assemble.statics.proofs import (
    BED,
    FRICTIONLESS,
    LEVEL,
    MORTAR,
    TIGHT,
    Bounds,
    value_range,
    widest_joint,
)
from learn2assemble.statics.sideways import Sideways
from learn2assemble.statics.states import State
from learn2assemble.statics.step_proof import Proof, Stack, changed

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
    """One of ``LEVEL``, ``BED``, ``TIGHT`` or ``MORTAR``."""
    margin_g: float | None
    """Sideways acceleration that the state at least withstands in every direction [g], where it is
    known."""
    wait: bool = False
    """Whether one waits before it until the mortar of all that is there holds."""

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
    """Of the weakest step of which it is known [g]."""
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
    margin_friction: float | None = None
    """That margins are for: the least that was asked for."""


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
        self.tiling = tiling
        self.kit = kit
        self.friction: list[float] = sorted(set(friction))
        self.law = law
        self.gap = gap
        self._stiffness = 0.0
        self._known: dict[bytes, float | None] = {}

    @cached_property
    def assembly(self) -> tuple[Assembly, Contacts]:
        from learn2assemble.assembly.contacts import find_contacts
        from learn2assemble.statics.rigid_blocks import bed_patches

        made = to_assembly(self.tiling, None, self.kit, gap=self.gap)
        contacts = find_contacts(made)
        return made, contacts if self.law == TIGHT else contacts.only(bed_patches(contacts))

    def stands(self, state: State, thorough: bool = True) -> bool:
        """As of a :class:`~learn2assemble.statics.laws.Law`; answers are kept."""
        key = state.present.tobytes()
        if key not in self._known:
            self._known[key] = self.margin(state.present)
        return self._known[key] is not None

    def rests(self, state: State, block: int) -> bool:
        return True  # What the coupled law balances is not squeezed in.

    def report(self, state: State) -> Shown:
        assert self.stands(state)
        known = self._known[state.present.tobytes()] or 0.0
        return Shown(self.law, min(known, self.friction[0]))

    def moving(self, state: State) -> list[int]:
        return []

    def falls(self, state: State) -> bool:
        return False  # That is not decided here.

    def margin(self, placed: np.ndarray) -> float | None:
        """The sideways acceleration in every direction [g] that the blocks ``placed`` (bool[n])
        withstand by rigid-block equilibrium, where they stand.

        None where they fall, and where they are balanced on an edge.
        """
        from learn2assemble.statics.forces.equilibrium import STIFFNESS, margin, solve
        from learn2assemble.statics.rigid_blocks import NO_MARGIN

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


class CellWays:
    """Ways of props among the cells of a tiling; blocks of the structure come as they may.

    Args:
        tiling: with its props.
    """

    def __init__(self, tiling: Tiling, kit: Kit) -> None:
        self.blocks: tuple[BlockPlacement, ...] = tiling.placements
        self.cells: list[np.ndarray] = [placement_cells(block, kit) for block in self.blocks]
        self._owner = owners(self.blocks, kit, tiling.wanted.shape)

    def free(self, block: int, present: np.ndarray, sliding: bool = True) -> bool:
        """Whether a block can be moved out from among those that are there (bool[n]).

        Args:
            sliding: makes no difference: a prop goes any way its cells have room for.
        """
        if not self.blocks[block].prop:
            return True
        return leaves(np.append(present, False)[self._owner], self.cells[block])


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
        law: what may carry a state: ``FRICTIONLESS``, ``BED``, where the gap is 0 ``TIGHT``, or
            ``MORTAR``, of a kit whose joints hold so.
        given: try the blocks in the order of the tiling instead of from below.
        progress: told how many steps are proven, and what the weakest withstands.
    """
    clock = Clock(seconds, progress=progress)
    ends = value_range(friction, kit.friction, "friction")
    widest = widest_joint(gap, kit.joint_gap, kit.pitch)
    if law == TIGHT and widest > 0:
        raise InputError("gap", widest, "0, for tight joints")
    blocks, count = tiling.placements, len(tiling.placements)
    stack, nothing = find_stack(blocks, kit, tiling.wanted.shape, widest), np.zeros(count, bool)
    loads = ByLoads(stack, nothing, ends[0], clock)
    laws: list[Law] = [loads]
    if law == MORTAR:
        whole = to_assembly(tiling, None, kit, friction=ends[0], gap=widest)
        laws.append(ByMortar(whole, loads, clock))
    elif law != FRICTIONLESS:
        laws.append(Coupled(tiling, kit, ends, law, widest))
    below = [stack.below(b).tolist() for b in range(count)]
    turns = sorted(range(count), key=lambda b: (blocks[b].origin[::-1], b))
    site = BuildingSite(
        fixed=nothing,
        prop=np.array([block.prop for block in blocks], bool),
        near=[[*below[b], *stack.tops[b].tolist()] for b in range(count)],
        below=below,
        rank=np.arange(count) if given else np.argsort(turns),
        laws=laws,
        ways=CellWays(tiling, kit),
        mortar=law == MORTAR and kit.joint.age > 0,
        onward=True,
    )
    rules = Forward(site)
    found = depth_first(rules, clock, lambda text: clock.tell(f"looking for an order: {text}"))
    doings, steps = [doing for move in found.path for doing in move.steps], list[OrderedStep]()
    total = sum(doing.action != "wait" for doing in doings)
    for step in reported(laws, rules.law, rules.start, doings):
        place, remove = (step.block, None) if step.action == "place" else (None, step.block)
        steps.append(OrderedStep(place, remove, step.proof, step.margin_g, step.wait))
        _tell(clock, steps, count)
        if clock.left <= 0:
            break
    status, reason, falls, stuck = "complete", "", (), []
    if clock.left <= 0 and not (found.complete and len(steps) == total):
        status = "time"
        reason = f"time ran out with {len(steps)} steps proven; {MORE_TIME}"
    elif not found.complete:
        stuck = sorted(rules.stuck(found), key=lambda b: blocks[b].prop)
        status, reason = "not found", _why_stuck(blocks[stuck[0]], stuck[0], found.last.state, law)
        if not blocks[stuck[0]].prop:
            falls = tuple(loads.moving(found.last.state.change(place=stuck[:1])))
    if status == "complete" and count <= _FIRM_BLOCKS:
        _firm(steps, stack, ends[0], clock)
    margin = _weakest(steps)
    rubs = any(step.proof in (BED, TIGHT, MORTAR) for step in steps)
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
        ends[0],
    )


def _tell(clock: Clock, steps: list[OrderedStep], count: int) -> None:
    """How far the order has come."""
    clock.tell(
        f"proving the order: {len(steps)} steps of {count} blocks, the weakest withstands "
        f"{_weakest(steps):.3f} g"
    )


def _weakest(steps: list[OrderedStep]) -> float:
    """The smallest margin that is known [g]."""
    return min((step.margin_g for step in steps if step.margin_g is not None), default=0.0)


def _firm(steps: list[OrderedStep], stack: Stack, friction: float, clock: Clock) -> None:
    """Look again, by programs, for the margins of the weakest steps that bed faces carry."""
    for _ in range(_FIRMED):
        _tell(clock, steps, len(stack))
        known = [step.margin_g for step in steps if step.margin_g is not None]
        if not known or min(known) >= _WEAK or clock.left <= 0:
            break
        weakest = [step.margin_g for step in steps].index(min(known))
        step = steps[weakest]
        if step.proof not in LEVEL:
            break
        placed = np.zeros(len(stack), bool)
        for done in steps[: weakest + 1]:
            placed[done.block] = done.place is not None
        sideways = Sideways(stack, friction)
        sideways.firm(placed, clock)
        if sideways.radius <= min(known):
            break
        steps[weakest] = replace(step, margin_g=sideways.radius)


def _why_stuck(block: BlockPlacement, number: int, state: State, law: str) -> str:
    """Why a block cannot be placed, or a prop not be taken away, in one line."""
    name = f"{'prop' if block.prop else 'block'} {block.kind} at {block.origin}"
    if not block.prop:
        carries = BED if law == FRICTIONLESS else law
        return f"{name} does not stand: nothing balances it on {carries}"
    if not state.present[number]:
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
    from scipy import ndimage  # pyright: ignore[reportMissingTypeStubs]

    library: Any = ndimage
    corner = cells.min(0)
    shape, extent = cells - corner, np.ptp(cells, axis=0) + 1
    room = np.pad(filled, [(int(n), int(n)) for n in extent[:2]] + [(0, int(extent[2]))])
    places = np.array(room.shape) - extent + 1
    free = np.ones(places, bool)
    for x, y, z in shape:
        free &= ~room[x : x + places[0], y : y + places[1], z : z + places[2]]
    part, _ = library.label(free)
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
        before, placed = placed, placed.copy()
        placed[step.block] = step.place is not None
        dirty = changed(stack, before, placed)
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
    blocks, ids = list[Block](), list[str]()
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
    steps = list[AssemblyStep]()
    for step in ordering.steps if ordering else ():
        done: dict[str, Any] = {"place" if step.remove is None else "remove": ids[step.block]}
        steps.append(AssemblyStep(**done, wait=kit.joint.age if step.wait else None))
    friction = kit.friction if friction is None else friction
    made = Assembly(tuple(blocks), tuple(steps), friction, name, joint=kit.joint)
    return made.as_far_as_placed()


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
    shape: list[int] = (cells.max(0) + 1).tolist()
    solid: np.ndarray = np.zeros(shape, bool)
    solid[tuple(cells.T)] = True
    planes = list[np.ndarray]()
    for axis, pitch in enumerate(kit.pitch):
        inset = gap / 2 if axis < 2 else 0.0
        solid, count = np.moveaxis(solid, axis, 0), int(solid.shape[axis])
        # A slab for every cell and, of the width of the gap, for every border of cells.
        slabs = np.zeros((2 * count + 1, *solid.shape[1:]), bool)
        slabs[1::2] = solid
        slabs[2:-1:2] = solid[:-1] & solid[1:]
        at = np.repeat(np.arange(count + 1) * pitch, 2)[1:-1] + np.tile([inset, -inset], count)
        if not inset:
            slabs, at = slabs[[0, *range(1, 2 * count, 2), 0]], np.arange(count + 1) * pitch
        is_face = (slabs[1:] != slabs[:-1]).reshape(len(at), -1).any(1)
        planes.append(at[is_face])
        solid = np.moveaxis(slabs[[0, *(np.flatnonzero(is_face) + 1).tolist()]], 0, axis)
    corners = list[list[tuple[int, ...]]]()
    for cell in np.argwhere(solid):
        for (axis, side), face in _SQUARE.items():
            near = cell.copy()
            near[axis] += 2 * side - 1
            if not solid[tuple(near)]:
                corners.append([tuple((cell - 1 + corner).tolist()) for corner in face])
    number = {corner: k for k, corner in enumerate(sorted({c for face in corners for c in face}))}
    vertices = np.array([[planes[axis][k] for axis, k in enumerate(corner)] for corner in number])
    return vertices, tuple(tuple(number[corner] for corner in face) for face in corners)
