"""The exact planner: a design and a kit in, blocks in a proven order out.

Tile; if the finished building would fall, rule that mechanism out and tile again, until it stands
or no tiling does (:mod:`learn2assemble.planning.standing`); prop up what cannot be put down on
its own; order, with more props where the order gets stuck. Where nothing helps, say which cells
are not carried and what would carry them.

What is found first is taken: dry without props, dry with props, then with tight joints. Side faces
press only where no gap is left, so tight joints are used where a gap of 0 is asked for and nowhere
else; a refusal says where they would do.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from functools import partial

import numpy as np

from learn2assemble.assembly.kit import Kit, kit_names, load_kit, orientations, parts_of
from learn2assemble.planning.ordering import Bounds, Coupled, Ordering, order, value_range
from learn2assemble.planning.programs import INF, Clock
from learn2assemble.planning.props import FIRM, choose_props, unsupported
from learn2assemble.planning.retiling import Retiling, improve_bond, mirrored
from learn2assemble.planning.standing import (
    find_mechanisms,
    find_slides,
    region_above,
    region_near,
    tile_standing,
)
from learn2assemble.planning.step_proof import Proof, Stack, find_stack, lies_above
from learn2assemble.planning.tiling import (
    TIME_OPTION,
    Tiling,
    find_candidates,
    owners,
    placement_cells,
    tile,
)

MAX_ROUNDS = 200
"""Of tiling again, and of adding props."""
CUT_ROUNDS = 4
"""Rounds of ruling out mechanisms, mostly enough and fast, before blocks are chosen together with
their forces."""
MAX_NEAR, MAX_ABOVE = 500, 700
"""Cells that one program decides together with their forces: round what falls, and all above."""
MAX_COUPLED = 400
"""Of a building of more blocks it is not said whether tight joints would do; that takes minutes."""
TIGHT_OPTION = "it stands only with tight joints (--gap 0)"


def plan_exact(
    wanted: np.ndarray, kit: Kit, *, seconds: float = 60.0, friction: Bounds = None,
    gap: Bounds = None, props_allowed: bool = True,
) -> tuple[Tiling, Ordering | None]:  # fmt: skip
    """Blocks of ``kit`` that fill ``wanted`` exactly, and an order in which every state stands.

    Args:
        wanted: bool[X, Y, Z].
        seconds: wall-clock limit for everything.
        friction, gap: as for :func:`learn2assemble.planning.ordering.order`.
        props_allowed: whether temporary blocks may be used.

    Returns:
        the tiling with its props; the order, None where there was nothing to order. Status and
        reason of the last of the two say how it went.
    """
    clock = Clock(seconds)
    mu = value_range(friction, kit.friction, "friction")
    tight = value_range(gap, kit.joint_gap, "gap")[1] == 0
    tiling = tile(wanted, kit, seconds=seconds)
    if tiling.status != "complete":
        return tiling, None
    tiling = improve_bond(tiling, kit, clock) if kit.limited else tiling
    stood = stand(tiling, kit, clock)
    pressed = None
    if stood.status == "refused":
        pressed, words = stand_pressed(tiling, kit, mu, clock, MAX_ROUNDS if tight else 0)
        stood = replace(stood, reason=f"{stood.reason}{words}")
    if stood.status != "complete" and not (pressed and tight):
        return stood, None

    ordered = partial(prop_and_order, kit=kit, clock=clock, friction=friction, gap=gap,
                      props_allowed=props_allowed)  # fmt: skip
    if pressed is None:
        made, ordering = ordered(stood, tight=False)
        if not tight or (ordering or made).status != "refused":
            return made, ordering
    return ordered(pressed or stood, tight=True)


def stand_pressed(
    tiling: Tiling, kit: Kit, friction: tuple[float, float], clock: Clock, rounds: int
) -> tuple[Tiling | None, str]:
    """The tiling, changed where it falls even with tight joints, until the finished building stands
    with them.

    Args:
        friction: smallest and largest coefficient at which it has to.
        rounds: how often it may be changed.

    Returns:
        the tiling, None where none was found; what to add to the refusal of :func:`stand`.
    """
    from learn2assemble.physics.block_forces import System

    square = bool(np.isclose(kit.pitch[0], kit.pitch[1]))
    boxes = all(np.prod(np.ptp(np.array(way.cells), axis=0) + 1) == len(way.cells)
                for way in orientations(kit))  # fmt: skip
    again: Retiling | None = None
    for number in range(rounds + 1):
        if len(tiling.placements) > MAX_COUPLED or clock.left <= 0:
            break
        coupled = Coupled(tiling, kit, friction)
        if coupled.margin(np.ones(len(tiling.placements), bool)) is not None:
            return tiling, f"; {TIGHT_OPTION}"
        slides = []
        if boxes and number < rounds:
            system = System(*coupled.assembly)
            owner = owners(tiling.placements, kit, tiling.wanted.shape)
            slides = find_slides(system, owner, friction[0])
        if not slides:
            break
        again = again or Retiling(tiling, kit, tight=True)
        new = [again.add(cut) for edges in slides for cut in mirrored(edges, tiling.wanted, square)]
        better = again.solve(clock.left) if any(new) else None
        if better is None:
            return None, "; it would fall with tight joints, too"
        if better.status != "complete":
            break
        tiling = better
    return None, "; nor was a way found that holds it with tight joints" if rounds else ""


def prop_and_order(
    structure: Tiling, kit: Kit, clock: Clock, *, friction: Bounds, gap: Bounds,
    props_allowed: bool, tight: bool,
) -> tuple[Tiling, Ordering | None]:  # fmt: skip
    """The order of a building that stands, with the fewest props it takes.

    Args:
        tight: whether side faces may press; they also hold what no prop reaches.
    """
    hanging = unsupported(structure, kit)
    if hanging and not (props_allowed or tight):
        return _not_carried(structure, kit, hanging, "props are not allowed"), None
    demands = {block: frozenset((block,)) for block in hanging if props_allowed}
    largest: int | None = None
    count, tiling, ordering = len(structure.placements), structure, None
    for _ in range(MAX_ROUNDS):
        props = choose_props(structure, kit, demands, clock.left, largest)
        if props is None and not tight:
            if ordering is None:
                return _not_carried(structure, kit, [max(demands)], "no prop reaches them"), None
            break
        if props is None:
            demands = {}
        tiling = replace(structure, placements=structure.placements + tuple(props or ()))
        ordering = order(tiling, kit, friction=friction, gap=gap, seconds=clock.left, tight=tight)
        if ordering.status != "refused" or not props_allowed or props is None:
            break
        new = [b for b in ordering.stuck if b < count and b not in demands]
        walled = [len(placement_cells(tiling.placements[b], kit))
                  for b in ordering.stuck if b >= count]  # fmt: skip
        if new:
            demands[new[0]] = frozenset((*ordering.falls, new[0]))
        elif walled:
            # Props that wall one another in, or that what is above them does, are made smaller.
            largest = max(walled) - 1
        else:
            break
    assert ordering is not None
    return tiling, ordering


def _not_carried(structure: Tiling, kit: Kit, blocks: list[int], why: str) -> Tiling:
    """The refusal of blocks that nothing holds while they are put down."""
    cells = uncarried_cells(structure.wanted, kit)
    if not len(cells) or why.startswith("no prop"):
        cells = np.concatenate([placement_cells(structure.placements[b], kit) for b in blocks])
    reason = f"{describe_lack(structure.wanted, kit, cells)}, and {why}"
    return replace(structure, status="refused", reason=reason)


# ---------------------------------------------------------------- the finished building


def stand(tiling: Tiling, kit: Kit, clock: Clock) -> Tiling:
    """The tiling, changed as little as it takes for the finished building to stand.

    The answer is exact: where its status is ``"refused"``, every tiling of these cells with this
    kit falls as long as bed faces alone carry it.
    """
    again: Retiling | None = None
    wanted, shape = tiling.wanted, tiling.wanted.shape
    loose = uncarried_cells(wanted, kit, -INF)
    if len(loose):
        return _falls(tiling, kit, loose)
    square = bool(np.isclose(kit.pitch[0], kit.pitch[1]))
    tried: set[bytes] = set()
    first = tiling
    for number in range(MAX_ROUNDS):
        # Tilings that cuts led to fall in more places than the one they began with.
        tiling = first if number == CUT_ROUNDS else tiling
        stack = find_stack(tiling.placements, kit, shape)
        proof, everything = Proof(stack), np.ones(len(stack), bool)
        if proof.settle(everything, everything) or proof.program(
            everything, everything, clock.left
        ):
            return tiling
        held = proof.held(everything, clock.left)
        if clock.left <= 0 or not held:
            break
        status, better = "unknown", None
        if number >= CUT_ROUNDS:
            status, better = _stand_near(tiling, kit, stack, held, tried, clock)
        if status == "infeasible":
            return _falls(tiling, kit, uncarried_cells(wanted, kit), held)
        if better is not None:
            tiling = better
            continue
        owner = owners(tiling.placements, kit, shape)
        # What has to be held moves, and what stands on it: a much smaller program.
        moving = lies_above(stack, held)
        found = find_mechanisms(stack, owner, seconds=clock.left, moving=moving)
        found = found or find_mechanisms(stack, owner, seconds=clock.left)
        if clock.left <= 0:
            break
        again = again or Retiling(tiling, kit)
        new = [again.add(cut) for edges in found for cut in mirrored(edges, wanted, square)]
        rigid = any(not (x.any() or y.any()) for x, y in found)
        better = None if rigid or not any(new) else again.solve(clock.left)
        if better is None:
            moves = sorted({int(b) for edges in found for b in _opened(edges, owner)})
            return _falls(tiling, kit, uncarried_cells(wanted, kit), moves or range(len(stack)))
        if better.status != "complete":
            break
        tiling = better
    cells = uncarried_cells(wanted, kit)
    reason = f"time ran out after {clock.limit:g} s while looking for blocks that stand"
    if len(cells):
        reason += f" ({describe_lack(wanted, kit, cells)})"
    reason += f"; {TIME_OPTION} gives more"
    return replace(tiling, status="time", reason=reason)


def _stand_near(
    tiling: Tiling, kit: Kit, stack: Stack, held: list[int], tried: set[bytes], clock: Clock
) -> tuple[str, Tiling | None]:
    """Blocks that stand round those that fall, or ``"infeasible"`` where no tiling does.

    Args:
        tried: regions that were decided before, which are not decided again.
    """
    near, above = region_near(tiling, kit, held), region_above(tiling, kit, held)
    # Where blocks below could be of other kinds or reach up, what is above alone proves nothing.
    proves = (kit.flat and not kit.limited) or bool((above == tiling.wanted).all())
    for region, most in ((near, MAX_NEAR), (above, MAX_ABOVE)):
        key = np.packbits(region).tobytes()
        if key in tried or region.sum() > most:
            continue
        tried.add(key)
        status, made = tile_standing(tiling, kit, stack, region, seconds=clock.left / 2)
        if made is not None or (status == "infeasible" and proves and (region == above).all()):
            return status, made
    return "unknown", None


def _falls(tiling: Tiling, kit: Kit, cells: np.ndarray, blocks: Iterable[int] = ()) -> Tiling:
    """The refusal of what falls with every tiling, for ``cells`` or else those of ``blocks``."""
    if not len(cells):
        cells = np.concatenate([placement_cells(tiling.placements[b], kit) for b in blocks])
    reason = f"{describe_lack(tiling.wanted, kit, cells)}; the finished building would fall"
    return replace(tiling, status="refused", reason=reason)


def _opened(edges: tuple[np.ndarray, np.ndarray], owner: np.ndarray) -> np.ndarray:
    """Blocks at joints that open."""
    x, y = edges
    return np.unique(
        np.concatenate([owner[:-1][x], owner[1:][x], owner[:, :-1][y], owner[:, 1:][y]])
    )


# ---------------------------------------------------------------- what is not carried


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


def describe_lack(wanted: np.ndarray, kit: Kit, cells: np.ndarray) -> str:
    """Which cells no block of ``kit`` carries, and which built-in kit has one that does.

    Args:
        cells: int[n, 3], not carried; the lowest group of neighbours is named.
    """
    level = int(cells[:, 2].min())
    mask = np.zeros(wanted.shape[:2], bool)
    mask[tuple(cells[cells[:, 2] == level, :2].T)] = True
    group = parts_of(mask)[0]
    at = np.argwhere(group)
    run = int(max(group.sum(0).max(), group.sum(1).max()))
    first = (int(at[0, 0]), int(at[0, 1]), level)
    text = f"no block of kit `{kit.name}` carries the cell {first}"
    if run > 1:
        text = (f"no block of kit `{kit.name}` spans {run} cells at level {level} "
                f"(the first is {first})")  # fmt: skip
    remedy = _remedy(wanted, kit, group, level)
    return f"{text}; {remedy} does" if remedy else text


def _remedy(wanted: np.ndarray, kit: Kit, group: np.ndarray, level: int) -> str:
    """The smallest block of a built-in kit that carries most of a group of cells, in words."""
    cells = np.zeros(wanted.shape, bool)
    cells[:, :, level] = group
    low = max(0, level - 1)
    part = wanted[:, :, low : level + 1]
    best: tuple[int, int, str] | None = None
    for name in kit_names():
        other = load_kit(name)
        fills_any = any(kind.cells == ((0, 0, 0),) for kind in other.kinds)
        if name == kit.name or not fills_any:
            continue
        found = find_candidates(part, other, None if level else np.ones(group.shape, bool), True)
        good = np.flatnonzero((found.support > FIRM) & (found.origin[:, 2] == level - low))
        if not len(good):
            continue
        good_ones = found.take(good)
        flat = cells[:, :, low : level + 1].reshape(-1)
        covers = np.add.reduceat(flat[good_ones.cell].astype(int), good_ones.start[:-1])
        for p in np.flatnonzero(covers > 0):
            kind = other.kinds[good_ones.ways[good_ones.way[p]].kind]
            key = (-int(covers[p]), len(kind.cells), f"`{name}` with {kind.name}")
            best = min(best, key) if best else key
    return best[2] if best else ""
