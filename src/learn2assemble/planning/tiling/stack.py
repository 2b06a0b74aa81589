"""The stack of a tiling: weights of its blocks, and their bed joints as parts of the lattice."""

from __future__ import annotations

import numpy as np

from learn2assemble.assembly.kit import Kit
from learn2assemble.planning.tiling.candidates import BlockPlacement, hull_of_boxes, placement_cells
from learn2assemble.planning.tiling.tile import owners
from learn2assemble.statics.step_proof import EDGE_INSET, Stack, ranks


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
