"""The exact planner: a design and a kit in, blocks in a proven order out.

Tile; if the finished building would fall, rule that mechanism out and tile again, until it stands
or no tiling does (:mod:`learn2assemble.planning.tiling.standing`); prop up what cannot be put down
on its
own; order, with more props where the order gets stuck. Where a tiling has no order, what is to
blame is barred and the next tiling is tried.

What is found first is taken: dry joints without friction, friction on bed faces, then tight joints.
Side faces press only where no gap is left, so tight joints are used where a gap of 0 is asked for
and nowhere else. Of a kit with mortar the finished building may stand by what mortar holds, and the
order waits for it where dry joints do not do; its young vertical joints do not press.

*Refused* means that no plan exists: no blocks fill the cells, or everything that does falls, with
friction, too. Where that is not proven the answer is *not found*, with what was tried.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import reduce

import numpy as np

from learn2assemble.assembly.kit import Kit, orientations, parts_of
from learn2assemble.errors import InputError
from learn2assemble.linear_programs import INF, Clock
from learn2assemble.planning.tiling.cover.candidates import BlockPlacement, placement_cells
from learn2assemble.planning.tiling.cover.retiling import Retiling, improve_bond, mirrored
from learn2assemble.planning.tiling.cover.tile import Tiling, check_cells, owners, tile
from learn2assemble.planning.tiling.finished import (
    MAX_EXACT,
    MAX_ROUNDS,
    alike,
    describe_cells,
    describe_lack,
    in_blocks,
    open_below,
    stand,
    stand_by_mortar,
    to_cells,
    uncarried_cells,
)
from learn2assemble.planning.tiling.ordering import Coupled, Ordering, order
from learn2assemble.planning.tiling.props import FIRM, choose_props, unsupported
from learn2assemble.planning.tiling.stack import find_stack
from learn2assemble.planning.tiling.standing import (
    find_slides,
)
from learn2assemble.progress import Progress, silent
from learn2assemble.statics.proofs import BED, FRICTIONLESS, MORTAR, TIGHT, Bounds, value_range
from learn2assemble.statics.step_proof import find_ring

MAX_TILINGS, MAX_TRIED = 24, 400
"""Tilings that are tried one after the other because none of those before has an order, and blocks
of all of them together; at least ``MIN_TILINGS``."""
MIN_TILINGS = 4
NEXT_SECONDS = 5.0
"""Of the program that looks for another tiling; it mostly takes a fraction of a second."""
FRICTION_ROUNDS = 24
"""Of tiling again where friction carries."""
DRY_SHARE = 0.4
"""Of the time, for blocks that stand dry, where mortar may hold others."""
MAX_COUPLED = 400
"""Of a building of more blocks it is not asked whether friction carries it; that takes minutes."""
MAX_PLACEMENTS = 10_000
"""Blocks of a plan."""

Blame = tuple[frozenset[BlockPlacement], bool]
"""Blocks that are not to be used together, and whether it is proven that they cannot be."""


def plan_exact(
    wanted: np.ndarray,
    kit: Kit,
    *,
    seconds: float = 60.0,
    friction: Bounds = None,
    gap: Bounds = None,
    props_allowed: bool = True,
    shades: np.ndarray | None = None,
    progress: Progress = silent,
) -> tuple[Tiling, Ordering | None]:
    """Blocks of ``kit`` that fill ``wanted`` exactly, and an order in which every state stands.

    Args:
        wanted: bool[X, Y, Z].
        seconds: wall-clock limit for everything.
        friction, gap: as for :func:`learn2assemble.planning.tiling.ordering.order`.
        props_allowed: whether temporary blocks may be used.
        shades: int[X, Y, Z], equal where cells have one colour; blocks keep to one where they can.
        progress: told the phase, the best so far and the time that is left.

    Returns:
        the tiling with its props; the order, None where there was nothing to order. Status and
        reason of the last of the two say how it went.
    """
    clock = Clock(seconds, progress=progress)
    mu = value_range(friction, kit.friction, "friction")
    laws = _laws(kit, gap)
    wanted = check_cells(wanted)
    reason, cells = _impossible(wanted, kit)
    if reason:
        return Tiling((), wanted, "refused", reason, missing=to_cells(cells)), None
    tiling = tile(wanted, kit, seconds=seconds, shades=shades, progress=progress)
    if tiling.status != "complete":
        return tiling, None
    _check_size(len(tiling.placements), kit)
    tiling = improve_bond(tiling, kit, clock) if kit.limited else tiling
    first: tuple[Tiling, Ordering | None] | None = None
    proven, also = True, ""
    for number, law in enumerate(laws, 1):
        part = clock
        if law == FRICTIONLESS and MORTAR in laws:
            part = Clock(DRY_SHARE * clock.left, progress=progress)
        search = _TilingSearch(tiling, kit, part, law, mu, friction, gap, props_allowed)
        made, ordering = search.run()
        status = (ordering or made).status
        late = status == "time" and part is clock and (first is None or law == MORTAR)
        if status == "complete" or late:
            return made, ordering
        # With friction the same tilings fall in fewer ways, so only the last proof counts.
        proven = status == "refused"
        first = first or (made, ordering)
        also = made.reason if made is not first[0] and not search.tried else ""
        if clock.left <= 0 or not (search.friction_may_help or laws[number:] == (MORTAR,)):
            break
    assert first is not None
    made, ordering = first
    made = replace(made, reason="; ".join(filter(None, (made.reason, also))))
    status = "refused" if proven else "not found"
    if ordering is not None:
        reason = "; ".join(filter(None, (ordering.reason, also)))
        return replace(made, status="complete"), replace(ordering, status=status, reason=reason)
    return replace(made, status=status), None


def _laws(kit: Kit, gap: Bounds) -> tuple[str, ...]:
    """What may carry, in the order in which it is tried; joints that may open hold no mortar."""
    if kit.joint.law == "mortar" and kit.joint.holds and gap is None:
        return FRICTIONLESS, MORTAR
    tight = value_range(gap, kit.joint_gap, "gap")[1] == 0
    return (FRICTIONLESS, BED, TIGHT) if tight else (FRICTIONLESS, BED)


def _impossible(wanted: np.ndarray, kit: Kit) -> tuple[str, np.ndarray]:
    """Why numbers alone rule a design out, in one line (empty where they do not), and the cells
    that they rule out (int64[n, 3])."""
    sizes = [len(kind.cells) for kind in kit.kinds]
    cells, none = np.argwhere(wanted), np.empty((0, 3), np.int64)
    _check_size(-(-len(cells) // max(sizes)), kit)
    if reason := _uneven(cells, kit, "the design"):
        return reason, none
    if kit.flat:
        # Blocks that are one cell high fill every part of a level on its own.
        for level in range(wanted.shape[2]):
            for part in parts_of(wanted[:, :, level]):
                at = np.argwhere(part)
                what = f"a part of level {level}"
                if len(at) > MAX_EXACT and (reason := _uneven(at, kit, what)):
                    return reason, np.insert(at, 2, level, axis=1)
    if kit.most_cells is not None and kit.most_cells < len(cells):
        lacking = len(cells) - kit.most_cells
        return (
            f"the heap of kit `{kit.name}` has {kit.most_cells} cells; the design has "
            f"{len(cells)}: it lacks {lacking}, such as {in_blocks(lacking, kit, wanted)}",
            none,
        )
    return "", none


def _uneven(cells: np.ndarray, kit: Kit, what: str) -> str:
    """Why no blocks of ``kit`` fill ``cells`` (int64[n, 2 or 3]), by their numbers alone."""
    sizes = [len(kind.cells) for kind in kit.kinds]
    count, step = len(cells), reduce(math.gcd, sizes)
    if count % step:
        return f"all blocks of kit `{kit.name}` have a multiple of {step} cells; {what} has {count}"
    # On a checkerboard in space, how many cells more of one colour a block has does not depend on
    # where it lies.
    uneven = [abs(int(np.sum((-1) ** np.sum(kind.cells, axis=1)))) for kind in kit.kinds]
    odd = abs(int(np.sum((-1) ** cells.sum(1))))
    most_odd = count * max(n / size for n, size in zip(uneven, sizes, strict=True))
    if odd > most_odd + 1e-6:
        return (
            f"on a checkerboard {what} has {odd} cells more of one colour; blocks of kit "
            f"`{kit.name}` that fill it have at most {int(most_odd + 1e-6)}"
        )
    return ""


def _check_size(blocks: int, kit: Kit) -> None:
    if blocks > MAX_PLACEMENTS:
        raise InputError(
            "design",
            f"at least {blocks} blocks of kit `{kit.name}`",
            f"at most {MAX_PLACEMENTS} (larger cells or blocks?)",
        )


class _TilingSearch:
    """Tilings of a design, one after the other, until one has an order.

    Args:
        law: what may carry a state, see :func:`learn2assemble.planning.tiling.ordering.order`.
        mu: smallest and largest coefficient of friction.
    """

    def __init__(
        self,
        tiling: Tiling,
        kit: Kit,
        clock: Clock,
        law: str,
        mu: tuple[float, float],
        friction: Bounds,
        gap: Bounds,
        props_allowed: bool,
    ) -> None:
        self.first, self.kit, self.clock, self.law, self.mu = tiling, kit, clock, law, mu
        self.friction, self.gap, self.props_allowed = friction, gap, props_allowed
        self.width = value_range(gap, kit.joint_gap, "gap")[1]
        self.again = Retiling(tiling, kit, tight=law in (TIGHT, MORTAR))
        self.tried: list[frozenset[BlockPlacement]] = []
        self.certain: list[frozenset[BlockPlacement]] = []
        self.friction_may_help = True
        self.gave_up = False
        size = max(len(tiling.placements), 1)
        most = MAX_TILINGS if law == FRICTIONLESS else MIN_TILINGS
        self.most = int(np.clip(MAX_TRIED // size, MIN_TILINGS, most))

    def run(self) -> tuple[Tiling, Ordering | None]:
        """The first tiling with an order, else what became of the first that stands."""
        failed: tuple[Tiling, Ordering | None] | None = None
        tiling: Tiling | None = self.first
        whole = False  # whether what is barred are whole tilings
        while tiling is not None:
            self.clock.tell(f"tiling {len(self.tried) + 1} of at most {self.most}")
            stood = self._stand(tiling)
            if stood.status != "complete":
                # That the others fall says nothing of those that were barred.
                barred = stood.status == "refused" and len(self.certain) < len(self.again.barred)
                if failed is None:
                    return stood, None
                if stood.status != "refused" or not barred or whole:
                    return self._ended(failed, "not found" if barred else stood.status)
                tiling, whole = self._next(whole=True), True
                continue
            made, ordering, blamed = self._order(stood)
            if (ordering or made).status in ("complete", "time"):
                return made, ordering
            failed = failed or (made, ordering)
            self.tried.append(frozenset(stood.placements))
            new = [self._bar(*blame) for blame in blamed]
            if len(self.tried) >= self.most or self.clock.left <= 0 or not any(new):
                return self._ended(failed, "not found")
            tiling = self._next(whole)
            barred = len(self.certain) < len(self.again.barred)
            if tiling is None and not whole and barred and not self.gave_up:
                tiling, whole = self._next(whole=True), True
        assert failed is not None
        proven = len(self.certain) == len(self.again.barred) and not self.gave_up
        return self._ended(failed, "refused" if proven else "not found")

    def _bar(self, blocks: frozenset[BlockPlacement], certain: bool) -> bool:
        new = self.again.bar(blocks)
        if new and certain:
            self.certain.append(blocks)
        return new

    def _next(self, whole: bool) -> Tiling | None:
        """Another tiling; None where there is none.

        Args:
            whole: bar whole tilings that failed, in place of what was taken to be to blame.
        """
        if whole:
            self.again.barred = {
                blocks: self.again.barred[blocks]
                for blocks in self.again.barred
                if blocks in set(self.certain)
            }
            for blocks in self.tried:
                self.again.bar(blocks)
        better = self.again.solve(min(self.clock.left, NEXT_SECONDS))
        self.gave_up |= better is not None and better.status != "complete"
        return None if self.gave_up else better

    def _ended(
        self, failed: tuple[Tiling, Ordering | None], status: str
    ) -> tuple[Tiling, Ordering | None]:
        made, ordering = failed
        others = len(self.tried) - 1
        words = f"; nor has any of {others} other tilings an order" if others > 0 else ""
        reason = f"{(ordering or made).reason}{words}"
        if ordering is not None:
            return made, replace(ordering, status=status, reason=reason)
        return replace(made, status=status, reason=reason), None

    def _stand(self, tiling: Tiling) -> Tiling:
        if self.law == FRICTIONLESS:
            stood = stand(tiling, self.kit, self.clock, self.again)
            # What lies on nothing falls, whatever friction does.
            self.friction_may_help = not len(uncarried_cells(tiling.wanted, self.kit, -INF)) or (
                self.width == 0
            )
            return stood
        if self.law == MORTAR:
            return stand_by_mortar(tiling, self.kit, self.mu[0], self.clock, self.again)
        return stand_by_friction(
            tiling, self.kit, self.law, self.mu, self.clock, gap=self.width, again=self.again
        )

    def _order(self, stood: Tiling) -> tuple[Tiling, Ordering | None, list[Blame]]:
        """The order, and what is to blame where there is none."""
        blocks, kit = stood.placements, self.kit
        stack = find_stack(blocks, kit, stood.wanted.shape)
        if ring := find_ring(stack):
            names = " and ".join(f"{blocks[b].kind} at {blocks[b].origin}" for b in ring[:2])
            made = replace(stood, status="not found", reason=f"{names} lie on one another")
            return made, None, [(frozenset(blocks[b] for b in ring), True)]
        made, ordering = prop_and_order(
            stood,
            kit,
            self.clock,
            friction=self.friction,
            gap=self.gap,
            props_allowed=self.props_allowed,
            law=self.law,
        )
        if ordering is None:
            hanging = unsupported(stood, kit)
            if not self.props_allowed:
                found = self.again.found
                bad = found.blocks(kit, np.flatnonzero(found.support <= FIRM))
                return made, None, [(frozenset((block,)), True) for block in bad]
            endless = kit.unlimited
            bad = [
                b
                for b in hanging
                if choose_props(stood, endless, {b: frozenset((b,))}, self.clock.left) is None
            ]
            # Where the heap is short of props, a tiling that needs fewer may do.
            blamed = [(frozenset((blocks[b],)), False) for b in bad or hanging]
            return made, None, blamed or [(frozenset(blocks), False)]
        near = {b for b in (*ordering.stuck, *ordering.falls) if b < len(blocks)}
        stacked = find_stack(blocks, kit, stood.wanted.shape)
        for b in tuple(near):
            near |= {*stacked.below(b).tolist(), *stacked.tops[b].tolist()}
        return made, ordering, [(frozenset(blocks[b] for b in near or range(len(blocks))), False)]


def stand_by_friction(
    tiling: Tiling,
    kit: Kit,
    law: str,
    friction: tuple[float, float],
    clock: Clock,
    *,
    gap: float = 0.0,
    rounds: int = FRICTION_ROUNDS,
    again: Retiling | None = None,
) -> Tiling:
    """The tiling, changed where it falls even with friction, until the finished building stands.

    Args:
        law: ``BED``, friction on bed faces, or ``TIGHT``, on side faces that touch, too.
        friction: smallest and largest coefficient at which it has to.
        gap: width of vertical joints [m].
        rounds: how often it may be changed.
        again: what is barred so far.

    Returns:
        the tiling; its status is ``"refused"`` where every tiling was proven to fall.
    """
    from learn2assemble.statics.forces.block_forces import System

    square = bool(np.isclose(kit.pitch[0], kit.pitch[1]))
    boxes = all(
        (np.ptp(np.array(way.cells), axis=0) + 1).prod() == len(way.cells)
        for way in orientations(kit)
    )
    again = again or Retiling(tiling, kit, tight=law == TIGHT)
    what = "tight joints" if law == TIGHT else "friction on bed faces"
    falls = f"it would fall with {what}, too"
    reason = f"nor was a way found in which {what} carries it"
    if len(tiling.placements) > MAX_COUPLED:
        reason = f"whether {what} carries it is not tried beyond {MAX_COUPLED} blocks"
    unknown = replace(tiling, status="not found", reason=reason)
    for number in range(rounds + 1):
        if len(tiling.placements) > MAX_COUPLED or clock.left <= 0:
            break
        clock.tell(f"looking for blocks that {what} carries: tiling {number + 1}")
        coupled = Coupled(tiling, kit, friction, law, gap)
        if coupled.margin(np.ones(len(tiling.placements), bool)) is not None:
            return tiling
        slides = []
        if boxes and number < rounds:
            system = System(*coupled.assembly)
            owner = owners(tiling.placements, kit, tiling.wanted.shape)
            slides = find_slides(system, owner, friction[0])
        if not slides:
            break
        rigid = any(not (x.any() or y.any()) for x, y in slides)
        new = [again.add(cut) for edges in slides for cut in mirrored(edges, tiling.wanted, square)]
        if not rigid and not any(new):
            break
        better = None if rigid else again.solve(clock.left)
        if better is None:
            return replace(tiling, status="refused" if alike(kit) else "not found", reason=falls)
        if better.status != "complete":
            break
        tiling = better
    return unknown


def prop_and_order(
    structure: Tiling,
    kit: Kit,
    clock: Clock,
    *,
    friction: Bounds,
    gap: Bounds,
    props_allowed: bool,
    law: str = FRICTIONLESS,
) -> tuple[Tiling, Ordering | None]:
    """The order of a building that stands, with the fewest props it takes.

    Args:
        law: what may carry; tight joints, and mortar that holds at once, also hold what no prop
            reaches.
    """
    tight = law == TIGHT or (law == MORTAR and kit.joint.age == 0)
    hanging = unsupported(structure, kit)
    if hanging and not (props_allowed or tight):
        return _not_carried(structure, kit, hanging), None
    demands = {block: frozenset((block,)) for block in hanging if props_allowed}
    largest: int | None = None
    count, tiling, ordering = len(structure.placements), structure, None
    for _ in range(MAX_ROUNDS):
        clock.tell(f"choosing props for {len(demands)} of {count} blocks")
        props = choose_props(structure, kit, demands, clock.left, largest)
        if props is None and not tight:
            if ordering is None:
                return _not_carried(structure, kit, sorted(demands), props=demands), None
            break
        if props is None:
            demands = {}
        tiling = replace(structure, placements=structure.placements + tuple(props or ()))
        ordering = order(
            tiling,
            kit,
            friction=friction,
            gap=gap,
            seconds=clock.left,
            law=law,
            progress=clock.progress,
        )
        if ordering.status != "not found" or not props_allowed or props is None:
            break
        new = [b for b in ordering.stuck if b < count and b not in demands]
        walled = [
            len(placement_cells(tiling.placements[b], kit)) for b in ordering.stuck if b >= count
        ]
        if new:
            demands[new[0]] = frozenset((*ordering.falls, new[0]))
        elif walled:
            # Props that wall one another in, or that what is above them does, are made smaller.
            largest = max(walled) - 1
        else:
            break
    assert ordering is not None
    return tiling, ordering


def _not_carried(
    structure: Tiling,
    kit: Kit,
    blocks: list[int],
    *,
    props: dict[int, frozenset[int]] | None = None,
) -> Tiling:
    """The refusal of blocks that nothing holds while they are put down.

    Args:
        props: what was asked of props (:func:`.props.choose_props`) where these are allowed, and
            none were found.
    """
    why, wanted = "props are not allowed", structure.wanted
    if props is not None:
        lacks = kit.limited and choose_props(structure, kit.unlimited, props) is not None
        why = "the heap has too few blocks left for props" if lacks else "no prop reaches them"
    cells = uncarried_cells(wanted, kit)
    reason = describe_lack(kit, wanted, cells) if len(cells) else ""
    if props is not None or not len(cells):
        cells = open_below(wanted, [placement_cells(structure.placements[b], kit) for b in blocks])
        reason = f"nothing below carries {describe_cells(wanted, cells)[0]}"
    reason = f"{reason}, and {why}"
    return replace(structure, status="not found", reason=reason, lacking=to_cells(cells))
