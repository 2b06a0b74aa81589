"""Where a structure for some goals may grow: candidates, and what is still missing.

Candidates and states are those of the builder of designs, with every cell that may be filled as a
wanted one. A candidate is *legal* where something carries it and nothing is above any of its cells,
since blocks come from above.

The **relaxed plan** of a state forgets equilibrium of the whole and what blocks do to each other: a
candidate costs one block and the cheapest supports that its own centroid needs (with the loads it
bears), one below it or one on either side. It is found in one pass from below; what it takes for
all goals, common blocks counted once, estimates the blocks that are missing (the additive heuristic
and the relaxed plan of Hoffmann and Nebel 2001). Kinds of which it takes more than the heap has get
dearer until it does not, or a few times. A goal without a relaxed plan, loads forgotten, cannot be
met at all. A pass from above says what a candidate costs on its way to a goal beyond the cheapest
way there: its *detour*.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from learn2assemble.design.goals import Goals
from learn2assemble.kernels import kernel
from learn2assemble.planning.tiling.world import LatticeSite, LatticeWorld, make_site

PRICE, PRICE_ROUNDS = 0.4, 4
"""By how much a kind gets dearer, and how often [blocks]."""
MAX_CANDIDATES = 1_000_000
"""Cells times ways to put down a block."""


@dataclass(frozen=True, eq=False)
class GoalProblem:
    """What does not change while a structure for some goals grows."""

    goals: Goals
    site: LatticeSite
    order: np.ndarray
    """int64[n]: candidates from below."""
    beside: np.ndarray
    """bool[cells of candidates, 3]: whether the block has the next cell in x, in y, in both."""
    bed_start: np.ndarray
    bed: np.ndarray
    """Lowest cells of every candidate: ``bed[bed_start[k]:bed_start[k + 1]]``, flat."""
    centre: np.ndarray
    """float64[n, 2]: centroid of every candidate [cells]."""
    heavy: np.ndarray
    """float64[n, 2]: the same with the loads it bears."""
    must: np.ndarray
    """int64[m]: flat cells that have to be filled, the highest first."""


@dataclass(frozen=True, eq=False)
class Relaxed:
    """The relaxed plan of a state."""

    blocks: float
    """How many blocks it takes; infinite where some goal cannot be met."""
    used: np.ndarray
    """bool[n]: its candidates."""
    cost: np.ndarray
    """float64[n]: what each candidate takes, itself and its supports."""
    detour: np.ndarray
    """float64[n]: blocks it takes to a goal by each candidate beyond the cheapest way."""
    price: np.ndarray
    """float64[kinds]: what kinds cost beyond a block, because the heap has few."""


def make_problem(goals: Goals) -> GoalProblem:
    """Every candidate of some goals."""
    site = make_site(goals.open, goals.kit)
    found = site.found
    strides = np.array([goals.shape[1] * goals.shape[2], goals.shape[2], 1])
    middle = np.array([np.mean(way.cells, axis=0)[:2] + 0.5 for way in found.ways])
    must = np.argwhere(goals.must)
    must = must[np.argsort(-must[:, 2], kind="stable")] @ strides
    centre = found.origin[:, :2] + middle[found.way]
    heavy, mass = centre.copy(), site.weight[found.way].copy()
    for load in goals.loads:
        c = int(np.ravel_multi_index(load.cell, goals.shape))
        bears = np.unique(site.over[site.over_start[c] : site.over_start[c + 1]])
        at = np.array(load.point[:2]) / goals.kit.pitch[:2] + np.array(goals.shape[:2]) / 2
        heavy[bears] = mass[bears, None] * heavy[bears] + load.mass * at
        mass[bears] += load.mass
        heavy[bears] /= mass[bears, None]
    return GoalProblem(
        goals,
        site,
        np.argsort(found.origin[:, 2], kind="stable"),
        _beside(found.start, found.cell, strides[0], strides[1]),
        np.concatenate([[0], np.cumsum(found.lowest)])[found.start],
        found.cell[found.lowest],
        centre,
        heavy,
        must,
    )


def legal(problem: GoalProblem, world: LatticeWorld) -> np.ndarray:
    """int64[m]: candidates that nothing covers and whose centroid has something that carries on
    every side; the whole structure may still fall."""
    x, y, z = problem.goals.shape
    beds = problem.bed_start, problem.bed
    return _legal(world.owner, world.alive, beds, problem.centre, (x, y, z))


def put(world: LatticeWorld, candidate: int, program: bool = True) -> LatticeWorld | None:
    """The world with one more block; None where it would fall."""
    grown = world.copy()
    if not grown.place(candidate, program):
        return None
    site, depth = grown.site, grown.site.wanted.shape[2]
    _cover(site.cells(candidate), depth, grown.owner, grown.alive, site.over_start, site.over)
    return grown


def unmet(problem: GoalProblem, world: LatticeWorld) -> np.ndarray:
    """int64[k]: flat cells that have to be filled and are not."""
    return problem.must[world.owner[problem.must] < 0]


def relax(problem: GoalProblem, world: LatticeWorld, price: np.ndarray | None = None) -> Relaxed:
    """The relaxed plan of a state, see the module.

    Args:
        price: of the state before, to begin with.
    """
    site, found = problem.site, problem.site.found
    x, y, z = site.wanted.shape
    price = np.zeros(len(world.heap)) if price is None else price.copy()
    plan = _relax(
        (world.owner, world.alive, world.heap),
        price,
        problem.order,
        (found.start, found.cell, problem.bed_start, problem.bed),
        (problem.beside, problem.centre, problem.heavy, found.origin, site.kind),
        (unmet(problem, world), site.over_start, site.over),
        (x, y, z),
    )
    return Relaxed(*plan, price)


# ---------------------------------------------------------------- compiled


@kernel
def _legal(
    owner: np.ndarray,
    alive: np.ndarray,
    beds: tuple[np.ndarray, np.ndarray],
    centre: np.ndarray,
    shape: tuple[int, int, int],
) -> np.ndarray:
    (bed_start, bed), step_x, step_y = beds, shape[1] * shape[2], shape[2]
    found = np.empty(len(alive), np.int64)
    count = 0
    for k in range(len(alive)):
        if not alive[k]:
            continue
        left = right = front = back = False
        for j in range(bed_start[k], bed_start[k + 1]):
            c = bed[j]
            if c % step_y == 0 or owner[c - 1] >= 0:
                x, y = c // step_x - centre[k, 0], (c // step_y) % shape[1] - centre[k, 1]
                left, right = left or x < -1e-6, right or x > 1e-6 - 1
                front, back = front or y < -1e-6, back or y > 1e-6 - 1
        if left and right and front and back:
            found[count] = k
            count += 1
    return found[:count]


@kernel
def _cover(
    cells: np.ndarray,
    depth: int,
    owner: np.ndarray,
    alive: np.ndarray,
    over_start: np.ndarray,
    over: np.ndarray,
) -> None:
    """Nothing can be put down below ``cells`` any more."""
    for c in cells:
        k = c - 1
        while (k + 1) % depth != 0 and owner[k] < 0:
            for j in range(over_start[k], over_start[k + 1]):
                alive[over[j]] = False
            k -= 1


@kernel
def _beside(start: np.ndarray, cell: np.ndarray, step_x: int, step_y: int) -> np.ndarray:
    found = np.zeros((len(cell), 3), np.bool_)
    for k in range(len(start) - 1):
        for j in range(start[k], start[k + 1]):
            for i in range(start[k], start[k + 1]):
                found[j, 0] |= cell[i] == cell[j] + step_x
                found[j, 1] |= cell[i] == cell[j] + step_y
                found[j, 2] |= cell[i] == cell[j] + step_x + step_y
    return found


_Three = tuple[np.ndarray, np.ndarray, np.ndarray]
_Four = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
_Five = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]


@kernel
def _relax(
    state: _Three,
    price: np.ndarray,
    order: np.ndarray,
    place: _Four,
    about: _Five,
    goals: _Three,
    shape: tuple[int, int, int],
) -> tuple[float, np.ndarray, np.ndarray, np.ndarray]:
    """Fields of :class:`Relaxed`; ``price`` is raised in place.

    Args:
        state: ``owner``, ``alive`` and ``heap`` of a world.
        place: cells of candidates and their lowest cells, as the site and the problem have them.
        about: ``beside``, ``centre`` and ``heavy`` of the problem, origins and kinds of candidates.
        goals: flat cells, and ``over_start`` and ``over`` of the site.
    """
    heap, (beside, centre, _, origin, kind) = state[2], about
    best = _estimate(state, price, order, place, about, goals, shape)
    if np.isinf(best[0]):
        alone = beside, centre, centre, origin, kind  # Loads are forgotten.
        best = _estimate(state, price, order, place, alone, goals, shape)
    if np.isinf(best[0]):
        return best[0], best[1], best[2], best[2]
    paid = price.copy()
    for _ in range(PRICE_ROUNDS):
        taken, dearer = np.zeros(len(heap), np.int64), False
        for k in range(len(kind)):
            taken[kind[k]] += best[1][k]
        for k in range(len(heap)):
            if 0 <= heap[k] < taken[k]:
                price[k] += PRICE
                dearer = True
        if not dearer:
            break
        other = _estimate(state, price, order, place, about, goals, shape)
        if np.isinf(other[0]):
            break
        best, paid = other, price.copy()
    # Only those at the last prices are asked for.
    blocks, used, cost, need = best
    return blocks, used, cost, _detours(paid, order, place, kind, goals[0], cost, need, shape[2])


@kernel(forceinline=True)
def _support(
    need: np.ndarray,
    bed: np.ndarray,
    column: np.ndarray,
    first: int,
    last: int,
    cx: float,
    cy: float,
    ref_kind: np.ndarray,
    ref_cell: np.ndarray,
    k: int,
) -> float:
    """What it takes to carry a centroid (cx, cy); row k of ``ref_*`` becomes the supports.

    Args:
        column: int64[cells, 2]: x and y of every cell.
    """
    big = best = 1e9
    for n in range(4):
        ref_kind[k, n] = -1
    # Numbers, not arrays: these stay in registers.
    left = right = front = back = big
    at_left = at_right = at_front = at_back = 0
    # The cell below the centroid; two of them, or four, where it is over an edge.
    ex = 1 if abs(cx - np.rint(cx)) < 1e-6 else 0
    ey = 1 if abs(cy - np.rint(cy)) < 1e-6 else 0
    bx = int(np.rint(cx)) - 1 if ex else int(np.floor(cx))
    b_y = int(np.rint(cy)) - 1 if ey else int(np.floor(cy))
    # Straight to the left, to the right, in front and behind.
    for j in range(first, last):
        below = bed[j] - 1
        # No pair of cells and no square takes less than one of its cells.
        if need[below, 0] >= big:
            continue
        x, y = column[below, 0], column[below, 1]
        if y == b_y:
            value = need[below, ex + 2 * ey]
            if x == bx and value < best:
                best = value
                ref_kind[k, 0], ref_cell[k, 0] = ex + 2 * ey, below
            value = need[below, 2 * ey]
            if x < bx + ex and value < left:
                left, at_left = value, below
            if x > bx and value < right:
                right, at_right = value, below
        if x == bx:
            value = need[below, ex]
            if y < b_y + ey and value < front:
                front, at_front = value, below
            if y > b_y and value < back:
                back, at_back = value, below
    if left + right < best:
        best = left + right
        ref_kind[k, 0], ref_cell[k, 0] = 2 * ey, at_left
        ref_kind[k, 1], ref_cell[k, 1] = 2 * ey, at_right
    if front + back < best:
        best = front + back
        ref_kind[k, 0], ref_cell[k, 0] = ex, at_front
        ref_kind[k, 1], ref_cell[k, 1] = ex, at_back
    if best < big:
        return best
    # Anywhere on these sides.
    left = right = front = back = big
    for j in range(first, last):
        below = bed[j] - 1
        x, y, value = column[below, 0], column[below, 1], need[below, 0]
        if x < bx + 1 and value < left:
            left, at_left = value, below
        if x >= bx + ex and value < right:
            right, at_right = value, below
        if y < b_y + 1 and value < front:
            front, at_front = value, below
        if y >= b_y + ey and value < back:
            back, at_back = value, below
    worst = max(left, right, front, back)
    if worst < big:
        best = worst + 1.0
        for n, at in enumerate((at_left, at_right, at_front, at_back)):
            ref_kind[k, n], ref_cell[k, n] = 0, at
    return best


@kernel
def _estimate(
    state: _Three,
    price: np.ndarray,
    order: np.ndarray,
    place: _Four,
    about: _Five,
    goals: _Three,
    shape: tuple[int, int, int],
) -> tuple[float, np.ndarray, np.ndarray, np.ndarray]:
    """Blocks, ``used`` and ``cost`` of the relaxed plan at given prices, and what it takes to fill
    a cell, it and its neighbour in x, in y, or the square of four (float64[cells, 4])."""
    owner, alive, _ = state
    start, cell, bed_start, bed = place
    beside, centre, heavy, origin, kinds = about
    size_x, size_y, size_z = shape
    step_x, step_y = size_y * size_z, size_z
    count, cells = len(alive), len(owner)
    big = 1e9
    need = np.full((cells, 4), big)
    by = np.empty((cells, 4), np.int64)
    column = np.empty((cells, 2), np.int64)
    c = 0
    for x in range(size_x):
        for y in range(size_y):
            for _ in range(size_z):
                column[c, 0], column[c, 1] = x, y
                if owner[c] >= 0:
                    right = x + 1 < size_x and owner[c + step_x] >= 0
                    back = y + 1 < size_y and owner[c + step_y] >= 0
                    need[c, 0] = 0.0
                    if right:
                        need[c, 1] = 0.0
                    if back:
                        need[c, 2] = 0.0
                    if right and back and owner[c + step_x + step_y] >= 0:
                        need[c, 3] = 0.0
                c += 1
    cost = np.full(count, big)
    # A row for every candidate, and one to try in. Only those with a cost are read.
    ref_kind, ref_cell = np.empty((count + 1, 4), np.int64), np.empty((count + 1, 4), np.int64)
    k: int
    for k in order:
        if not alive[k]:
            continue
        best = 0.0
        if origin[k, 2] == 0:
            for n in range(4):
                ref_kind[k, n] = -1
        else:
            first, last = bed_start[k], bed_start[k + 1]
            x, y = centre[k, 0], centre[k, 1]
            best = _support(need, bed, column, first, last, x, y, ref_kind, ref_cell, k)
            if best < big and (heavy[k, 0] != x or heavy[k, 1] != y):
                x, y = heavy[k, 0], heavy[k, 1]
                more = _support(need, bed, column, first, last, x, y, ref_kind, ref_cell, count)
                if more > best:
                    best = more
                    for n in range(4):
                        ref_kind[k, n], ref_cell[k, n] = ref_kind[count, n], ref_cell[count, n]
        if best >= big:
            continue
        # Of equally dear ones the largest, on which most can lie.
        total = best + (1.0 + price[kinds[k]]) - 1e-4 * (start[k + 1] - start[k])
        cost[k] = total
        for j in range(start[k], start[k + 1]):
            c = cell[j]
            right, back, both = beside[j, 0], beside[j, 1], beside[j, 2]
            if total < need[c, 0]:
                need[c, 0], by[c, 0] = total, k
            if right and total < need[c, 1]:
                need[c, 1], by[c, 1] = total, k
            if back and total < need[c, 2]:
                need[c, 2], by[c, 2] = total, k
            if right and back and both and total < need[c, 3]:
                need[c, 3], by[c, 3] = total, k
    used = np.zeros(count, np.bool_)
    covered, wanted = np.zeros(cells, np.bool_), np.zeros(cells, np.bool_)
    cells_of_goals, over_start, over = goals
    for c in cells_of_goals:
        wanted[c] = True
        if need[c, 0] >= big:
            return np.inf, used, cost, need
    queue = np.empty(count + 1, np.int64)
    blocks = 0.0
    for goal in cells_of_goals:
        if covered[goal]:
            continue
        chosen, least = -1, big
        for j in range(over_start[goal], over_start[goal + 1]):
            k = over[j]
            if alive[k] and cost[k] < big:
                share = 0
                for i in range(start[k], start[k + 1]):
                    share += wanted[cell[i]] and not covered[cell[i]]
                if cost[k] / share < least:
                    chosen, least = k, cost[k] / share
        head, tail = 0, 0
        if not used[chosen]:
            used[chosen] = True
            queue[tail] = chosen
            tail += 1
        while head < tail:
            k = queue[head]
            head += 1
            blocks += 1.0
            for j in range(start[k], start[k + 1]):
                covered[cell[j]] = True
            for n in range(4):
                kind, c = ref_kind[k, n], ref_cell[k, n]
                if kind < 0 or need[c, kind] <= 0.0:
                    continue
                there = covered[c]
                there = there and (kind % 2 == 0 or covered[c + step_x])
                there = there and (kind < 2 or covered[c + step_y])
                other = by[c, kind]
                if not there and not used[other]:
                    used[other] = True
                    queue[tail] = other
                    tail += 1
    return blocks, used, cost, need


@kernel
def _detours(
    price: np.ndarray,
    order: np.ndarray,
    place: _Four,
    kind: np.ndarray,
    goals: np.ndarray,
    cost: np.ndarray,
    need: np.ndarray,
    levels: int,
) -> np.ndarray:
    """From above: what it takes by a candidate beyond the cheapest way to the same goal."""
    start, cell, bed_start, bed = place
    big = 1e9
    wanted = np.zeros(len(need), np.bool_)
    for c in goals:
        wanted[c] = True
    ahead = np.full(len(need), big)
    detour = np.full(len(order), big)
    for i in range(len(order) - 1, -1, -1):
        k = order[i]
        if cost[k] >= big:
            continue
        least = big
        for j in range(start[k], start[k + 1]):
            c = cell[j]
            least = min(least, -need[c, 0] if wanted[c] else ahead[c])
        detour[k] = cost[k] + least
        for j in range(bed_start[k], bed_start[k + 1]):
            c = bed[j]
            if c % levels:
                ahead[c - 1] = min(ahead[c - 1], least + (1.0 + price[kind[k]]))
    return detour
