"""Blocks with which the finished building stands: tilings that fall are ruled out by how they fall,
until one stands or none is left; and the cells that no tiling can carry."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import replace

import numpy as np

from learn2assemble.assembly.kit import Cell, Kit, Orientation, orientations, parts_of
from learn2assemble.linear_programs import INF, Clock
from learn2assemble.planning.tiling.cover.candidates import (
    BlockPlacement,
    find_candidates,
    placement_cells,
)
from learn2assemble.planning.tiling.cover.retiling import Retiling, mirrored
from learn2assemble.planning.tiling.cover.tile import MORE_TIME, Tiling, owners
from learn2assemble.planning.tiling.ordering import to_assembly
from learn2assemble.planning.tiling.props import FIRM
from learn2assemble.planning.tiling.stack import find_stack
from learn2assemble.planning.tiling.standing import (
    find_mechanisms,
    region_above,
    region_near,
    tile_standing,
)
from learn2assemble.statics.holding.program import balance_of
from learn2assemble.statics.step_proof import Proof, Stack, lies_above

MAX_ROUNDS = 200
"""Of tiling again, and of adding props."""
CUT_ROUNDS = 4
"""Rounds of ruling out mechanisms, mostly enough and fast, before blocks are chosen together with
their forces."""
MAX_NEAR, MAX_ABOVE = 500, 700
"""Cells that one program decides together with their forces: round what falls, and all above."""
NEAR_SECONDS, NEAR_SHARE = 5.0, 0.08
"""Of one such program, or this share of the limit where that is more; it mostly takes a fraction of
a second or does not end."""
MAX_FALLEN, MIN_ROUNDS = 5_000, CUT_ROUNDS + 1
"""Blocks of all tilings together that are tried because those before fall; at least so many."""
MAX_WHOLE = 600
"""Of a building of more blocks, the uppermost part that falls is looked at first, and alone."""
MORTAR_ROUNDS = 12
"""Of tiling again where mortar does not hold."""
MAX_EXACT = 120
"""Cells of a part of a level, of which a program soon says which cannot be filled."""


def alike(kit: Kit) -> bool:
    """Whether all blocks are equally heavy for their size, so that how one tiling falls says how
    every tiling does that can move in the same way."""
    return len({kit.density if kind.density is None else kind.density for kind in kit.kinds}) == 1


def stand(tiling: Tiling, kit: Kit, clock: Clock, again: Retiling | None = None) -> Tiling:
    """The tiling, changed as little as it takes for the finished building to stand.

    The answer is exact: where its status is ``"refused"``, every tiling of these cells with this
    kit falls as long as bed faces alone carry it, without friction.

    Args:
        again: what is barred so far.
    """
    again = again or Retiling(tiling, kit)
    wanted, shape = tiling.wanted, tiling.wanted.shape
    loose = uncarried_cells(wanted, kit, -INF)
    if len(loose):
        return _falls(tiling, kit, loose, any_way=True)
    square = bool(np.isclose(kit.pitch[0], kit.pitch[1]))
    near = _NearPart(kit, clock, again.barred)
    first, meets_cuts = tiling, False
    held: list[int] = []
    rounds = int(np.clip(MAX_FALLEN // len(tiling.placements), MIN_ROUNDS, MAX_ROUNDS))
    for number in range(rounds):
        if number == CUT_ROUNDS:
            # Tilings that cuts led to fall in more places than the one they began with.
            tiling, meets_cuts = first, False
        stack = find_stack(tiling.placements, kit, shape)
        proof, everything = Proof(stack), np.ones(len(stack), bool)
        part = np.arange(len(stack))
        if proof.settle(everything, everything):
            return tiling
        if kit.flat and len(stack) > MAX_WHOLE:
            part = _falling_part(proof, tiling, clock)
            if not len(part):
                return tiling
        elif proof.program(everything, everything, clock.left):
            return tiling
        # What is below is ground: if the part falls there, it does on anything.
        small = stack.part(part)
        held_there = Proof(small).held(np.ones(len(small), bool), clock.left)
        held = part[held_there].tolist()
        if clock.left <= 0 or not held:
            return _too_late(tiling, kit, clock)
        clock.tell(
            f"looking for blocks that stand: tiling {number + 1} of at most {rounds}, "
            f"{len(held)} of {len(stack)} blocks fall"
        )
        status, better = "unknown", None
        if number >= CUT_ROUNDS:
            status, better = near.decide(tiling, stack, held)
        if status == "infeasible":
            return _falls(tiling, kit, uncarried_cells(wanted, kit), held)
        if better is not None:
            tiling, meets_cuts = better, False
            continue
        if number == rounds - 1:
            break
        owner = owners(tiling.placements, kit, shape)
        number_there = np.full(len(stack) + 1, -1)
        number_there[part] = np.arange(len(part))
        there = number_there[owner]
        # What has to be held moves, and what stands on it: a much smaller program.
        moving = lies_above(small, held_there)
        found = find_mechanisms(small, there, seconds=clock.left, moving=moving)
        # That there are no more takes as long to prove as the first to find.
        found = found or find_mechanisms(small, there, most=1, seconds=clock.left)
        if clock.left <= 0:
            return _too_late(tiling, kit, clock)
        new = [again.add(cut) for edges in found for cut in mirrored(edges, wanted, square)]
        rigid = any(not (x.any() or y.any()) for x, y in found)
        # A tiling that meets all cuts and falls gives a new one, unless rounding is in the way.
        lost = meets_cuts and not rigid and not any(new)
        better = None if rigid or lost else again.solve(clock.left)
        if better is None:
            sure = not lost
            if not alike(kit):
                # Which blocks are heavy decides what falls: ask the program that knows weights.
                status, better = _stand_whole(tiling, kit, stack, again.barred, clock)
                if better is not None:
                    tiling, meets_cuts = better, False
                    continue
                sure = status == "infeasible"
            moves = sorted({int(b) for edges in found for b in _opened(edges, owner)})
            fallen = _falls(tiling, kit, uncarried_cells(wanted, kit), moves or range(len(stack)))
            return fallen if sure else replace(fallen, status="not found")
        if better.status != "complete":
            return _too_late(tiling, kit, clock)
        tiling, meets_cuts = better, True
    fallen = _falls(tiling, kit, uncarried_cells(wanted, kit), held)
    reason = f"{fallen.reason}, as would each of {rounds} tilings that were tried"
    return replace(fallen, status="not found", reason=reason)


def stand_by_mortar(
    tiling: Tiling, kit: Kit, friction: float, clock: Clock, again: Retiling
) -> Tiling:
    """The tiling, changed where it falls, until the finished building stands with all mortar set.

    Args:
        kit: whose joints are of mortar.
        friction: the smallest coefficient.
        again: what is barred so far; blocks that move first are not used together again.

    Returns:
        the tiling; its status is ``"not found"`` where each of a few tilings falls, and ``"time"``
        where time ran out before one was found.
    """
    failed, least = tiling, INF
    for number in range(MORTAR_ROUNDS):
        clock.tell(f"looking for blocks that mortar holds: tiling {number + 1}")
        balance = balance_of(to_assembly(tiling, None, kit, friction=friction))
        balance.clock = clock
        none = np.zeros(len(tiling.placements), bool)
        if balance.stands(~none, none):
            return tiling
        least = min(least, balance.need().share)
        moving = [tiling.placements[b] for b in balance.holding().moving]
        if clock.left <= 0:
            return _too_late(tiling, kit, clock)
        new = again.bar(moving or tiling.placements)
        better = again.solve(clock.left) if new and clock.left > 0 else None
        if better is None or better.status != "complete":
            break
        tiling = better
    reason = f"nor does the mortar of kit `{kit.name}` hold it"
    if np.isfinite(least):
        reason += f": what was tried takes at least {least:.3g} times its strength"
    return replace(failed, status="not found", reason=reason)


def _too_late(tiling: Tiling, kit: Kit, clock: Clock) -> Tiling:
    """What is said where time ran out."""
    cells = uncarried_cells(tiling.wanted, kit)
    reason = f"time ran out after {clock.limit:g} s while looking for blocks that stand"
    if len(cells):
        reason += f" ({describe_lack(kit, tiling.wanted, cells)})"
    reason += f"; {MORE_TIME}"
    return replace(tiling, status="time", reason=reason)


def _falling_part(proof: Proof, tiling: Tiling, clock: Clock) -> np.ndarray:
    """int64: blocks of the fewest uppermost levels that fall on what is below them, which is taken
    for ground; empty where everything stands. Where time runs out, all that was looked at."""
    level = np.array([block.origin[2] for block in tiling.placements])
    everything = np.ones(len(level), bool)
    stands, falls, wide = int(level.max()) + 1, -1, 1  # what is from these levels up
    while stands > falls + 1:
        # Parts grow until one falls; then the border is looked for.
        middle = max(stands - wide, 0) if falls < 0 else (stands + falls) // 2
        if proof.program(everything, level >= middle, clock.left):
            stands, wide = middle, 2 * wide
        else:
            falls = middle
    return np.flatnonzero(level >= falls) if falls >= 0 else np.empty(0, np.int64)


class _NearPart:
    """Blocks that stand round those that fall, chosen together with their forces.

    Args:
        barred: sets of blocks that are not all used together.
    """

    def __init__(
        self, kit: Kit, clock: Clock, barred: Collection[frozenset[BlockPlacement]]
    ) -> None:
        self.kit, self.clock, self.barred = kit, clock, barred
        self._tried: set[bytes] = set()  # Regions that were decided are not decided again.
        self._most = [MAX_NEAR, MAX_ABOVE]

    def decide(self, tiling: Tiling, stack: Stack, held: list[int]) -> tuple[str, Tiling | None]:
        """The tiling with such blocks, or ``"infeasible"`` where no tiling stands.

        Args:
            held: blocks of ``tiling`` that fall.
        """
        kit = self.kit
        near, above = region_near(tiling, kit, held), region_above(tiling, kit, held)
        # Where blocks below could be of other kinds or reach up, what is above alone proves
        # nothing.
        proves = (kit.flat and not kit.limited) or bool((above == tiling.wanted).all())
        for k, region in enumerate((near, above)):
            key = np.packbits(region).tobytes()
            if key in self._tried or region.sum() > self._most[k]:
                continue
            self._tried.add(key)
            limit = max(NEAR_SECONDS, NEAR_SHARE * self.clock.limit)
            seconds = min(limit, self.clock.left / 2)
            status, made = tile_standing(
                tiling, kit, stack, region, barred=self.barred, seconds=seconds
            )
            if status == "time" and made is None:
                self._most[k] = 0
            if made is not None or (status == "infeasible" and proves and (region == above).all()):
                return status, made
        return "unknown", None


def _stand_whole(
    tiling: Tiling,
    kit: Kit,
    stack: Stack,
    barred: Collection[frozenset[BlockPlacement]],
    clock: Clock,
) -> tuple[str, Tiling | None]:
    """All blocks chosen together with their forces, where the design is small enough."""
    if tiling.wanted.sum() > MAX_ABOVE:
        return "unknown", None
    return tile_standing(
        tiling, kit, stack, tiling.wanted.copy(), barred=barred, seconds=clock.left / 2
    )


def _falls(
    tiling: Tiling, kit: Kit, cells: np.ndarray, blocks: Iterable[int] = (), any_way: bool = False
) -> Tiling:
    """The refusal of what falls with every tiling, for ``cells`` or else those of ``blocks``.

    Args:
        any_way: whether it does with any friction.
    """
    if len(cells):
        words = describe_lack(kit, tiling.wanted, cells)
    else:
        cells = open_below(
            tiling.wanted, [placement_cells(tiling.placements[b], kit) for b in blocks]
        )
        lack = describe_cells(tiling.wanted, cells)[0]
        words = f"nothing below carries {lack}, and blocks of kit `{kit.name}` fall there"
    reason = f"{words}; the finished building would fall"
    if not any_way:
        reason += " without friction"
    return replace(tiling, status="refused", reason=reason, lacking=to_cells(cells))


def _opened(edges: tuple[np.ndarray, np.ndarray], owner: np.ndarray) -> np.ndarray:
    """Blocks at joints that open."""
    x, y = edges
    return np.unique(
        np.concatenate([owner[:-1][x], owner[1:][x], owner[:, :-1][y], owner[:, 1:][y]])
    )


def uncarried_cells(wanted: np.ndarray, kit: Kit, least: float = FIRM) -> np.ndarray:
    """int64[n, 3]: cells in no block of ``kit`` whose centroid is above what carries it.

    Args:
        least: how far inside; with -INF, cells in no block that lies on anything, so that no tiling
            of the design stands on bed faces.
    """
    found = find_candidates(wanted, kit)
    good = found.take(np.flatnonzero(found.support > least))
    carried = np.zeros(wanted.size, bool)
    carried[good.cell] = True
    return np.argwhere(wanted & ~carried.reshape(wanted.shape))


def open_below(wanted: np.ndarray, blocks: list[np.ndarray]) -> np.ndarray:
    """int64[n, 3]: the cells of a design with nothing below them that hang together with such cells
    of some blocks (int64[m, 3] each)."""
    open_ = wanted.copy()
    open_[:, :, 1:] &= ~wanted[:, :, :-1]
    open_[:, :, 0] = False
    of_blocks = np.zeros_like(wanted)
    of_blocks[tuple(np.concatenate(blocks).T)] = True
    parts = [part for part in parts_of(open_) if (part & of_blocks).any()]
    return np.argwhere(np.logical_or.reduce(parts) if parts else of_blocks)


def to_cells(cells: np.ndarray) -> tuple[Cell, ...]:
    """The rows of int64[n, 3], each once."""
    rows: list[list[int]] = cells.tolist()
    return tuple(sorted({(x, y, z) for x, y, z in rows}))


def describe_lack(kit: Kit, wanted: np.ndarray, cells: np.ndarray) -> str:
    """Which cells no block of ``kit`` carries.

    Args:
        cells: int[n, 3], not carried; the lowest group of neighbours is named.
    """
    words, run, first = describe_cells(wanted, cells)
    if run == 1:
        return f"no block of kit `{kit.name}` carries the cell {first}"
    return (
        f"nothing below carries {words}, and no block of kit `{kit.name}` that stands by itself "
        "reaches over them"
    )


def describe_cells(wanted: np.ndarray, cells: np.ndarray) -> tuple[str, int, Cell]:
    """The lowest group of neighbours among int[n, 3] cells: in words, how many are in a row, and
    the first of them."""
    level = int(cells[:, 2].min())
    mask = np.zeros(wanted.shape[:2], bool)
    mask[tuple(cells[cells[:, 2] == level, :2].T)] = True
    group = parts_of(mask)[0]
    at = np.argwhere(group)
    run = int(max(group.sum(0).max(), group.sum(1).max()))
    first = (int(at[0, 0]), int(at[0, 1]), level)
    words = f"{run} cells in a row at level {level} (the first is {first})"
    return words if run > 1 else f"the cell {first}", run, first


def in_blocks(cells: int, kit: Kit, wanted: np.ndarray) -> str:
    """Blocks of ``kit`` that have so many cells or a few more, the largest first, in words: of
    those that have room among the wanted cells, where any has."""
    some = {way.kind for way in orientations(kit) if _has_room(way, wanted)}
    kinds = [kind for k, kind in enumerate(kit.kinds) if k in some or not some]
    kinds.sort(key=lambda kind: -len(kind.cells))
    found = dict[str, int]()
    for kind in kinds:
        last = kind is kinds[-1]
        count = -(-cells // len(kind.cells)) if last else cells // len(kind.cells)
        if count > 0:
            found[kind.name] = count
            cells -= count * len(kind.cells)
    return " and ".join(f"{n} x {name}" for name, n in found.items())


def _has_room(way: Orientation, wanted: np.ndarray) -> bool:
    """Whether a block that lies so is somewhere among the wanted cells."""
    cells = np.array(way.cells)
    room = np.array(wanted.shape) - cells.max(0)
    if room.min() < 1:
        return False
    free = np.ones(room, bool)
    for low in cells:
        free &= wanted[tuple(slice(a, a + n) for a, n in zip(low, room, strict=True))]
    return bool(free.any())
