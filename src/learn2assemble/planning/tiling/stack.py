"""The stack of a tiling: weights of its blocks, and their bed joints as parts of the lattice."""

from __future__ import annotations

import numpy as np

from learn2assemble.assembly.kit import Kit
from learn2assemble.kernels import kernel
from learn2assemble.planning.tiling.cover.candidates import BlockPlacement, placement_cells
from learn2assemble.planning.tiling.cover.tile import owners
from learn2assemble.planning.tiling.cover.ways import convex_hull, hull_of_boxes
from learn2assemble.statics.step_proof import EDGE_INSET, Stack, StackArrays, ranks


def find_stack(
    placements: tuple[BlockPlacement, ...],
    kit: Kit,
    shape: tuple[int, ...],
    gap: float | None = None,
) -> Stack:
    """The blocks of a tiling, props included, and their bed joints.

    Args:
        shape: X, Y, Z of the lattice.
        gap: width of the vertical joints [m]; that of the kit without it. Weights stay those of
            the kit, so a wider gap only makes support polygons smaller.
    """
    gap = kit.joint_gap if gap is None else gap
    dx, dy, dz = pitch = np.array(kit.pitch)
    middle = np.array([shape[0] / 2, shape[1] / 2, 0.0])
    owner = owners(placements, kit, shape)
    padded = np.pad(owner, ((1, 1), (1, 1), (1, 0)), constant_values=-1)
    # Cells whose lower face rests on another block or on the table.
    under = padded[1:-1, 1:-1, :-1]
    on_table = np.zeros_like(owner, bool)
    on_table[:, :, 0] = True
    cells = np.argwhere((owner >= 0) & (owner != under) & ((under >= 0) | on_table))
    x, y, z = cells.T
    top, base = owner[x, y, z], under[x, y, z]
    inset = gap / 2 + EDGE_INSET * min(dx, dy)
    sides = list[np.ndarray]()
    for u, v in ((-1, 0), (1, 0), (0, -1), (0, 1)):
        ends = padded[x + 1 + u, y + 1 + v, z + 1] != top
        ends |= (base >= 0) & (padded[x + 1 + u, y + 1 + v, z] != base)
        sides.append(np.where(ends, inset, 0.0))
    low = np.stack([x * dx + sides[0], y * dy + sides[2]], -1) - middle[:2] * pitch[:2]
    high = np.stack([(x + 1) * dx - sides[1], (y + 1) * dy - sides[3]], -1) - middle[:2] * pitch[:2]
    order = np.lexsort((z, base, top))
    same = np.diff(np.stack([top, base, z])[:, order], axis=1).any(0)
    patches = np.split(order, np.flatnonzero(same) + 1) if len(order) else []
    points, upper, lower = list[np.ndarray](), list[int](), list[int]()
    share = list[float]()
    for patch in patches:
        a, b = low[patch].min(0), high[patch].max(0)
        area = float(np.prod(high[patch] - low[patch], axis=1).sum())
        corners = np.array([[a[0], a[1]], [b[0], a[1]], [b[0], b[1]], [a[0], b[1]]])
        if len(patch) > 1 and area < 0.999 * np.prod(b - a):
            corners = hull_of_boxes(low[patch], high[patch])
        height = np.full((len(corners), 1), z[patch[0]] * dz)
        points.append(np.concatenate([corners, height], 1))
        upper += [top[patch[0]]] * len(corners)
        lower += [base[patch[0]]] * len(corners)
        share += [area / len(corners)] * len(corners)
    weight, centre = block_masses(placements, kit, shape)
    tops = np.array(upper, np.int64)
    start = np.searchsorted(tops, np.arange(len(placements) + 1))
    stack = Stack(
        weight,
        centre,
        np.concatenate(points),
        tops,
        np.array(lower, np.int64),
        np.array(share),
        start,
        np.zeros(len(placements), np.int64),
        pitch[:2],
    )
    stack.rank[:] = ranks(stack)
    return stack


def block_masses(
    placements: tuple[BlockPlacement, ...], kit: Kit, shape: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Weights float64[n] [kg] and centres float64[n, 3] [m] of blocks on a lattice of ``shape``,
    whose sides lie half a joint inside their cells."""
    pitch, middle = np.array(kit.pitch), np.array([shape[0] / 2, shape[1] / 2, 0.0])
    kinds = {kind.name: kind for kind in kit.kinds}
    known: dict[tuple[str, int], tuple[float, np.ndarray]] = {}
    weight, centre = np.empty(len(placements)), np.empty((len(placements), 3))
    for number, block in enumerate(placements):
        key = block.kind, block.turn
        if key not in known:
            cells = placement_cells(block, kit) - block.origin
            own = {tuple(cell) for cell in cells.tolist()}
            low, high = cells * pitch, (cells + 1) * pitch
            for axis, (u, v) in enumerate(((1, 0), (0, 1))):
                for k, (a, b, c) in enumerate(cells.tolist()):
                    low[k, axis] += kit.joint_gap / 2 * ((a - u, b - v, c) not in own)
                    high[k, axis] -= kit.joint_gap / 2 * ((a + u, b + v, c) not in own)
            volume = np.prod(high - low, axis=1)
            density = kinds[block.kind].density or kit.density
            middle_of = ((low + high) / 2 * volume[:, None]).sum(0) / volume.sum()
            known[key] = density * float(volume.sum()), middle_of
        weight[number] = known[key][0]
        centre[number] = known[key][1] + (block.origin - middle) * pitch
    return weight, centre


# ---------------------------------------------------------------- one block more


@kernel
def grow_stack(
    cells: np.ndarray,
    owner: np.ndarray,
    propped: np.ndarray,
    shape: tuple[int, int, int],
    pitch: tuple[float, float, float],
    inset: float,
    block: tuple[float, np.ndarray, np.ndarray],
    old: StackArrays,
) -> StackArrays:
    """Arrays of a stack, all but its last, with one more block.

    Args:
        block: its weight, its centre of mass from the corner of its cells, and that corner.
    """
    weight, centre, point, upper, lower, share, start, rank = old
    n, size = len(weight), len(point)
    points, below, area = _beds(cells, owner, shape, pitch, inset)
    grown = size + len(below)
    weights, centres = np.empty(n + 1), np.empty((n + 1, 3))
    starts, ranks = np.empty(n + 2, np.int64), np.empty(n + 1, np.int64)
    weights[:n], centres[:n], starts[: n + 1], ranks[:n] = weight, centre, start, rank
    weights[n], starts[n + 1], highest = block[0], start[n] + len(below), -1
    for axis in range(3):
        middle = shape[axis] / 2 if axis < 2 else 0.0
        centres[n, axis] = block[1][axis] + (block[2][axis] - middle) * pitch[axis]
    corner, shares = np.empty((grown, 3)), np.empty(grown)
    uppers, lowers = np.empty(grown, np.int64), np.empty(grown, np.int64)
    corner[:size], uppers[:size], lowers[:size], shares[:size] = point, upper, lower, share
    for k in range(len(below)):
        base, p = below[k], size + k
        for other in propped:
            base = -1 if other == base else base
        if base >= 0:
            highest = max(highest, rank[base])
        for axis in range(3):
            middle = shape[axis] / 2 if axis < 2 else 0.0
            corner[p, axis] = points[k, axis] - middle * pitch[axis]
        uppers[p], lowers[p], shares[p] = n, base, area[k]
    ranks[n] = highest + 1
    return weights, centres, corner, uppers, lowers, shares, starts, ranks


@kernel
def _beds(
    cells: np.ndarray,
    owner: np.ndarray,
    shape: tuple[int, int, int],
    pitch: tuple[float, float, float],
    inset: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Corners of the bed joints of a new block [m] from the corner of the lattice.

    Returns:
        float64[P, 3]; the block below every corner, -1 for the table; the area that is its share.
    """
    size_x, size_y, size_z = shape
    dx, dy, dz = pitch
    own = np.zeros(len(owner), np.bool_)
    own[cells] = True
    # What every cell rests on: -1 the table, -2 nothing.
    base = np.full(len(cells), -2)
    for k, c in enumerate(cells):
        if c % size_z == 0:
            base[k] = -1
        elif owner[c - 1] >= 0 and not own[c - 1]:
            base[k] = owner[c - 1]
    most = 4 * len(cells)
    points, lower, share = np.empty((most, 3)), np.empty(most, np.int64), np.empty(most)
    boxes, count = np.empty((most, 2)), 0
    while True:
        # One bed after the other: all cells that rest on the same block at the same level.
        first = -1
        for k in range(len(cells)):
            if base[k] > -2:
                sooner = first < 0 or base[k] < base[first]
                lower_down = cells[k] % size_z < cells[first] % size_z
                if sooner or (base[k] == base[first] and lower_down):
                    first = k
        if first < 0:
            return points[:count], lower[:count], share[:count]
        block, z = base[first], cells[first] % size_z
        area, n = 0.0, 0
        low_x = low_y = np.inf
        high_x = high_y = -np.inf
        for k, c in enumerate(cells):
            if base[k] != block or c % size_z != z:
                continue
            base[k] = -2
            x, y = c // size_z // size_y, c // size_z % size_y
            a, b, e, f = x * dx, (x + 1) * dx, y * dy, (y + 1) * dy
            for side, (u, v) in enumerate(((-1, 0), (1, 0), (0, -1), (0, 1))):
                inside = 0 <= x + u < size_x and 0 <= y + v < size_y
                near = ((x + u) * size_y + y + v) * size_z + z
                if inside and own[near] and (block < 0 or owner[near - 1] == block):
                    continue
                if side == 0:
                    a += inset
                elif side == 1:
                    b -= inset
                elif side == 2:
                    e += inset
                else:
                    f -= inset
            area += (b - a) * (f - e)
            low_x, high_x = min(low_x, a), max(high_x, b)
            low_y, high_y = min(low_y, e), max(high_y, f)
            for i in range(4):
                boxes[n, 0], boxes[n, 1] = a if i < 2 else b, f if i % 2 else e
                n += 1
        corners = np.empty((4, 2))
        for i in range(4):
            corners[i, 0] = high_x if i in (1, 2) else low_x
            corners[i, 1] = high_y if i > 1 else low_y
        if n > 4 and area < 0.999 * (high_x - low_x) * (high_y - low_y):
            corners = convex_hull(boxes[:n])
        for i in range(len(corners)):
            points[count, 0], points[count, 1] = corners[i, 0], corners[i, 1]
            points[count, 2], lower[count], share[count] = z * dz, block, area / len(corners)
            count += 1
