"""What the network sees of a candidate: its surroundings cell by cell, the heap, and the whole.

A candidate is described in its own frame: its longer side lies along u, the other along v, and
what is seen on its four sides is listed side by side (u-, u+, v-, v+), so that a mirrored design
gives the same numbers in another order. Nothing depends on the size of the design or on the number
of kinds of the kit.
"""

from __future__ import annotations

import numpy as np

from learn2assemble.kernels import kernel
from learn2assemble.planning.tiling.laying import SiteArrays, WorldArrays
from learn2assemble.planning.tiling.world import LatticeWorld

DEPTH = 5
"""How far the cells beside a candidate are seen one by one [cells]."""
_RUN = 9
"""Longest run of open cells beside a candidate that is counted."""
SIDE = DEPTH * 6 + _RUN + 4
"""Numbers for each of the four sides."""
OWN = 40
NUM_FEATURES = OWN + 4 * SIDE
NUM_SUMMARY = 24
"""Numbers that describe the whole."""
_CELLS, _LONG, _SHORT, _HIGH, _LENGTH = range(5)
"""Features of a candidate by name; there are eight of a length, and six of a heap."""
(
    _NARROW,
    _PAIRED,
    _BOX,
    _SUPPORT,
    _HANGING,
    _OVERHANG,
    _CARRIERS,
    _BRIDGED,
    _CONTINUED,
    _ABOVE,
    _ONLY,
    _ONE_OTHER,
    _FEWEST,
    _FRAGILE,
    _STRANDS,
    _STRANDED,
    _ONE_LEFT,
    _LEAST,
    _WEAK,
    _RISE,
    _LOWEST,
    _HEAP,
) = range(_LENGTH + 8, 34)
_NEAR = _HEAP + 6
_OPEN_SHARE, _TOTAL, _OPEN, _PLACED, _LEGAL, _LOWEST_LEVEL, _LIMITED, _SPARE, _DEAD = range(9)
"""Features of a summary by name."""
_COVERED, _KINDS, _LARGEST, _CUBE, _SIZES = 9, 13, 14, 15, 16
_SUMMED_SIZES = (1, 2, 3, 4, 5, 6, 8)
"""Sizes of kinds that the summary tells of [cells]."""
_NO_LIMIT = 10_000
"""So many blocks of a kind are left where the heap has no limit."""


def mirrored(features: np.ndarray, u: bool, v: bool) -> np.ndarray:
    """The features of the candidates of a mirrored design.

    Args:
        features: float32[m, NUM_FEATURES].
        u, v: along which axes of a candidate.
    """
    sides = features[:, OWN:].reshape(len(features), 4, SIDE)
    order = [1, 0] if u else [0, 1]
    order += [3, 2] if v else [2, 3]
    return np.concatenate([features[:, :OWN], sides[:, order].reshape(len(features), -1)], 1)


def describe(world: LatticeWorld, candidates: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Features of candidates, and of the whole.

    Args:
        candidates: int64[m].

    Returns:
        float32[m, NUM_FEATURES] and float32[NUM_SUMMARY].
    """
    site, found = world.site, world.site.found
    out = np.zeros((len(candidates), NUM_FEATURES), np.float32)
    summary = np.zeros(NUM_SUMMARY, np.float32)
    sizes = np.array([len(kind.cells) for kind in site.kit.kinds])
    heap = np.empty((len(sizes), 6))
    built = np.array([world.open, len(world.placed), len(candidates)])
    lowest = _sum_up(summary, heap, site.wanted, site.kind, world.arrays, sizes, built)
    last = found.origin[world.placed[-1]] if world.placed else np.full(3, -1)
    _describe(
        out,
        candidates,
        site.arrays,
        world.arrays,
        found.support,
        found.hanging,
        site.wanted,
        heap,
        lowest,
        last,
    )
    return out, summary


@kernel
def _sum_up(
    out: np.ndarray,
    table: np.ndarray,
    wanted: np.ndarray,
    kind: np.ndarray,
    world: WorldArrays,
    sizes: np.ndarray,
    built: np.ndarray,
) -> int:
    """Fill the summary and the table of the heap; the lowest level that has an open cell.

    Args:
        out: float32[NUM_SUMMARY], zeros.
        table: float64[kinds, 6]: what a candidate shows of the heap of its kind.
        sizes: int64[kinds] [cells].
        built: how many cells are open, blocks are placed and candidates are offered.
    """
    size_x, size_y, size_z = wanted.shape
    open_, placed, offered = built
    owner, cover, alive, heap = world.owner, world.cover, world.alive, world.heap
    lowest, total, open_count = size_z, 0, 0
    few = np.zeros(5, np.int64)  # Open cells that so many candidates fill.
    cell = 0
    for x in range(size_x):
        for y in range(size_y):
            for z in range(size_z):
                if wanted[x, y, z]:
                    total += 1
                    if owner[cell] < 0:
                        open_count += 1
                        lowest = min(lowest, z)
                        if cover[cell] < len(few):
                            few[cover[cell]] += 1
                cell += 1
    places = np.zeros(len(sizes), np.int64)
    for c in range(len(alive)):
        if alive[c]:
            places[kind[c]] += 1
    limited, stock = 0.0, 0.0
    for k in range(len(sizes)):
        if heap[k] >= 0:
            limited = 1.0
        stock += float((heap[k] if heap[k] >= 0 else _NO_LIMIT) * sizes[k])
    least_open = max(open_, 1)
    spare = min(max((stock - least_open) / 8, -4.0), 4.0)
    for k in range(len(sizes)):
        left = heap[k] if heap[k] >= 0 else _NO_LIMIT
        table[k, 0] = limited
        table[k, 1] = min(left, 50) / 10.0
        table[k, 2] = min(left * sizes[k] / least_open, 2.0)
        table[k, 3] = np.log1p(float(places[k])) / 5.0
        table[k, 4] = min(left / max(places[k], 1), 2.0)
        table[k, 5] = spare
    total = max(total, 1)
    out[_OPEN_SHARE] = open_ / total
    out[_TOTAL] = np.log1p(float(total)) / 8
    out[_OPEN] = np.log1p(float(open_)) / 8
    out[_PLACED] = np.log1p(float(placed)) / 6
    out[_LEGAL] = np.log1p(float(offered)) / 7
    out[_LOWEST_LEVEL] = lowest / max(size_z, 1)
    out[_LIMITED] = limited
    out[_SPARE] = min(max((stock - open_) / 8, -4.0), 4.0)
    out[_DEAD] = np.log1p(float(few[0]))
    for k in range(1, 5):
        out[_COVERED + k - 1] = few[k] / max(open_count, 1)
    kinds, largest = 0, 0
    for k in range(len(sizes)):
        if heap[k] == 0:
            continue
        kinds += 1
        largest = max(largest, sizes[k])
        if sizes[k] == 1:
            out[_CUBE] = 1.0
        for i in range(len(_SUMMED_SIZES)):
            if sizes[k] == _SUMMED_SIZES[i]:
                out[_SIZES + i] = 1.0
    out[_KINDS] = kinds / 10
    out[_LARGEST] = largest / 16
    return lowest


@kernel
def _describe(
    out: np.ndarray,
    candidates: np.ndarray,
    site: SiteArrays,
    world: WorldArrays,
    support: np.ndarray,
    hanging: np.ndarray,
    wanted: np.ndarray,
    heap: np.ndarray,
    lowest: int,
    last: np.ndarray,
) -> None:
    size_x, size_y, size_z = wanted.shape
    kind, origin, start, cell = site.kind, site.origin, site.start, site.cell
    over_start, over = site.over_start, site.over
    owner, cover, alive = world.owner, world.cover, world.alive
    lost = np.zeros(len(cover), np.int64)
    seen = np.full(len(alive), -1)
    touched = np.empty(len(cover), np.int64)
    for row in range(len(candidates)):
        c = candidates[row]
        f = out[row]
        first, last_cell = start[c], start[c + 1]
        count = last_cell - first
        x0, y0, z = origin[c]
        x1, y1, z1 = x0, y0, z
        fragile, fewest, reach = 0.0, 1 << 30, 0
        pieces, hang, above = 0, 0, 0
        base = -1
        for j in range(first, last_cell):
            p = cell[j]
            pz = p % size_z
            py = (p // size_z) % size_y
            px = p // (size_z * size_y)
            x1, y1, z1 = max(x1, px), max(y1, py), max(z1, pz)
            fewest = min(fewest, cover[p])
            fragile += 1.0 / cover[p]
            if pz > 0:
                if owner[p - 1] >= 0:
                    if owner[p - 1] != base:
                        base = owner[p - 1]
                        pieces += 1
                elif not wanted[px, py, pz - 1]:
                    hang += 1
            if pz + 1 < size_z and wanted[px, py, pz + 1]:
                above += 1
        ex, ey, ez = x1 - x0 + 1, y1 - y0 + 1, z1 - z + 1
        along_x = ex >= ey
        long, short = (ex, ey) if along_x else (ey, ex)
        # Candidates that this one would rule out, and cells that nothing else would fill.
        touches, stranded, least = 0, 0, 1 << 30
        for j in range(first, last_cell):
            p = cell[j]
            for k in range(over_start[p], over_start[p + 1]):
                d = over[k]
                if not alive[d] or seen[d] == row:
                    continue
                seen[d] = row
                for i in range(start[d], start[d + 1]):
                    q = cell[i]
                    if lost[q] == 0:
                        touched[touches] = q
                        touches += 1
                    lost[q] += 1
        # Its own cells are filled: what they lose does not count.
        for j in range(first, last_cell):
            lost[cell[j]] = -lost[cell[j]]
        weak = 0.0
        for t in range(touches):
            q = touched[t]
            if lost[q] > 0:
                rest = cover[q] - lost[q]
                least = min(least, rest)
                weak += 1.0 / (1.0 + rest)
                reach += 1
                if rest == 0:
                    stranded += 1
            lost[q] = 0
        # Seams of the layer below: bridged by it, and continued by its own sides.
        bridged, continued = 0, 0
        for j in range(first, last_cell):
            p = cell[j]
            pz = p % size_z
            py = (p // size_z) % size_y
            px = p // (size_z * size_y)
            if pz == 0 or owner[p - 1] < 0:
                continue
            for side in range(4):
                dx = (side == 1) - (side == 0)
                dy = (side == 3) - (side == 2)
                nx, ny = px + dx, py + dy
                if nx < 0 or ny < 0 or nx >= size_x or ny >= size_y:
                    continue
                other = owner[(nx * size_y + ny) * size_z + pz - 1]
                if other < 0 or other == owner[p - 1]:
                    continue
                inside = x0 <= nx <= x1 and y0 <= ny <= y1
                if inside:
                    bridged += 1
                elif wanted[nx, ny, pz]:
                    continued += 1
        f[_CELLS] = count / 8.0
        f[_LONG] = long / 8.0
        f[_SHORT] = short / 4.0
        f[_HIGH] = ez / 4.0
        if long <= 8:
            f[_LENGTH + long - 1] = 1.0
        f[_NARROW] = short == 1
        f[_PAIRED] = short == 2
        f[_BOX] = count == long * short * ez
        f[_SUPPORT] = min(support[c], 2.0)
        f[_HANGING] = hanging[c]
        f[_OVERHANG] = hang / 4.0
        f[_CARRIERS] = pieces / 4.0
        f[_BRIDGED] = bridged / 4.0
        f[_CONTINUED] = continued / 4.0
        f[_ABOVE] = above / count
        f[_ONLY] = fewest == 1
        f[_ONE_OTHER] = fewest == 2
        f[_FEWEST] = np.log(1.0 + fewest) / 4.0
        f[_FRAGILE] = fragile / count
        f[_STRANDS] = stranded > 0
        f[_STRANDED] = min(stranded, 4) / 4.0
        f[_ONE_LEFT] = least == 1
        f[_LEAST] = np.log(1.0 + min(least, 200)) / 4.0
        f[_WEAK] = weak / max(reach, 1)
        f[_RISE] = min(z - lowest, 8) / 4.0
        f[_LOWEST] = z == lowest
        for k in range(6):
            f[_HEAP + k] = heap[kind[c], k]
        if last[0] >= 0:
            near = abs(origin[c, 0] - last[0]) + abs(origin[c, 1] - last[1])
            f[_NEAR] = min(near + 2 * abs(z - last[2]), 20) / 10.0
        for side in range(4):
            # u-, u+, v-, v+ in the frame of the candidate.
            along_u = side < 2
            forward = side % 2 == 1
            in_x = along_u == along_x
            breadth = ey if in_x else ex
            at = OWN + side * SIDE
            run, ended = _RUN - 1, 0
            running = True
            for depth in range(1, _RUN + 1):
                if not running and depth > DEPTH:
                    break
                open_, filled, bare, up, thin, on = 0, 0, 0, 0, 0.0, 0
                for b in range(breadth):
                    if in_x:
                        nx, ny = (x1 + depth if forward else x0 - depth), y0 + b
                    else:
                        nx, ny = x0 + b, (y1 + depth if forward else y0 - depth)
                    if nx < 0 or ny < 0 or nx >= size_x or ny >= size_y:
                        continue
                    q = (nx * size_y + ny) * size_z + z
                    if owner[q] >= 0:
                        filled += 1
                    elif wanted[nx, ny, z]:
                        open_ += 1
                        thin += 1.0 / max(cover[q], 1)
                        if z > 0 and not wanted[nx, ny, z - 1]:
                            bare += 1
                    if z > 0 and owner[q - 1] >= 0:
                        on += 1
                    if z + 1 < size_z and wanted[nx, ny, z + 1]:
                        up += 1
                if depth <= DEPTH:
                    k = at + 6 * (depth - 1)
                    f[k] = open_ / breadth
                    f[k + 1] = filled / breadth
                    f[k + 2] = bare / breadth
                    f[k + 3] = up / breadth
                    f[k + 4] = thin / breadth
                    f[k + 5] = on / breadth
                if running and open_ < breadth:
                    running = False
                    run = depth - 1
                    ended = 1 if filled == breadth else (2 if open_ + filled == 0 else 3)
            f[at + 6 * DEPTH + run] = 1.0
            f[at + 6 * DEPTH + _RUN + ended] = 1.0
