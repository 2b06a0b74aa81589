r"""Blocks chosen together with the bed forces that make them stand: one mixed-integer program.

For every block :math:`p` that may be used, with binary :math:`x_p`, weight :math:`w_p` and centre
:math:`c_p`, forces :math:`f \ge 0` at the corners of the cells below it and :math:`g \ge 0` at
those above it belong to this block alone:

.. math::

    \sum f\,(1, u - c_p) - \sum g\,(1, u - c_p) = w_p x_p\,(1, 0), \qquad \sum g \le W x_p ,

and at every corner between two cells the :math:`f` of all blocks above sum to the :math:`g` of all
blocks below. With integer :math:`x` these are the equations of :mod:`.step_proof`, so an answer
stands. Blocks outside the part that is decided again keep their place: those that rest on it with
their equations, those below as ground that bears anything. So where the part reaches up to the
top, *infeasible* proves that no tiling of the design stands.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

import numpy as np

from learn2assemble.assembly.kit import Kit
from learn2assemble.planning.mechanisms import bonded_candidates
from learn2assemble.planning.programs import INF, Model, Program, solve
from learn2assemble.planning.step_proof import EDGE_INSET, Stack, block_masses, lies_above
from learn2assemble.planning.tiling import BlockPlacement, Tiling, from_below, placement_cells

NEAR, LEVELS = 4, 3
"""How far round a block that falls the tiling is decided again [cells], and on how many levels."""
_GAP = 0.02
"""Share of its price by which a tiling may be dearer than the cheapest that stands."""


def region_near(tiling: Tiling, kit: Kit, blocks: list[int]) -> np.ndarray:
    """bool[X, Y, Z]: cells round ``blocks`` and above them, without cutting any block."""
    region = np.zeros(tiling.wanted.shape, bool)
    for number in blocks:
        cells = placement_cells(tiling.placements[number], kit)
        low, high = np.maximum(cells.min(0) - NEAR, 0), cells.max(0) + NEAR + 1
        bottom = int(cells[:, 2].min())
        region[low[0] : high[0], low[1] : high[1], bottom : bottom + LEVELS] = True
    return _whole_blocks(tiling, kit, region)


def region_above(tiling: Tiling, kit: Kit, blocks: list[int]) -> np.ndarray:
    """bool[X, Y, Z]: all cells from the level of the lowest of ``blocks`` on."""
    bottom = min(int(placement_cells(tiling.placements[b], kit)[:, 2].min()) for b in blocks)
    region = np.zeros(tiling.wanted.shape, bool)
    region[:, :, bottom:] = True
    return _whole_blocks(tiling, kit, region)


def _whole_blocks(tiling: Tiling, kit: Kit, region: np.ndarray) -> np.ndarray:
    region &= tiling.wanted
    touched = region.copy()
    for block in tiling.placements:
        index = tuple(placement_cells(block, kit).T)
        if touched[index].any():
            region[index] = True
    return region


def tile_standing(
    tiling: Tiling, kit: Kit, stack: Stack, region: np.ndarray, *, seconds: float = INF,
) -> tuple[str, Tiling | None]:  # fmt: skip
    """The tiling, with the blocks of a region chosen anew so that they stand.

    Args:
        stack: of the tiling.
        region: bool[X, Y, Z], cells of whole blocks.

    Returns:
        ``"optimal"``, ``"infeasible"`` or ``"time"``, and the tiling where there is one.
    """
    found, cost = bonded_candidates(tiling, kit)
    inside = np.logical_and.reduceat(region.reshape(-1)[found.cell], found.start[:-1])
    found, cost = found.take(np.flatnonzero(inside)), cost[inside]
    blocks = tiling.placements
    anew = np.array([region[tuple(placement_cells(block, kit)[0])] for block in blocks])
    rests = lies_above(stack, np.flatnonzero(anew).tolist()) & ~anew
    stays = [block for block, again in zip(blocks, anew, strict=True) if not again]
    bodies = found.blocks(kit, np.arange(len(found)))
    bodies += [blocks[b] for b in np.flatnonzero(rests)]
    used = Counter(block.kind for block in stays)
    heap = {kind.name: kind.count - used[kind.name] for kind in kit.kinds
            if kind.count is not None}  # fmt: skip
    answer = solve(_program(tiling.wanted, kit, region, bodies, cost, heap), seconds, gap=_GAP)
    if answer.x is None:
        return answer.status, None
    made = [*stays, *(bodies[p] for p in np.flatnonzero(answer.x[: len(found)] > 0.5))]
    return answer.status, replace(tiling, placements=from_below(made))


def _program(
    wanted: np.ndarray, kit: Kit, region: np.ndarray, bodies: list[BlockPlacement],
    cost: np.ndarray, heap: dict[str, int],
) -> Program:  # fmt: skip
    """Columns: whether each candidate is used, then the forces at four corners of every face.

    Args:
        bodies: the candidates, as many as ``cost`` has, then the blocks that rest on the region.
        heap: how many blocks of these kinds may be used.
    """
    n, cells = len(cost), [placement_cells(block, kit) for block in bodies]
    body, cell = np.repeat(np.arange(len(bodies)), [len(c) for c in cells]), np.concatenate(cells)
    loose = region.copy()  # cells of blocks whose balance is part of the program
    for own in cells[n:]:
        loose[tuple(own.T)] = True
    weight, centre = block_masses(tuple(bodies), kit, wanted.shape)
    weight = weight / float(weight.mean())
    middle = centre[:, :2] / np.array(kit.pitch[:2]) + np.array(wanted.shape[:2]) / 2
    boxes = all(len(c) == np.prod(np.ptp(c, axis=0) + 1) for c in cells)
    corner = np.array([[0, 0], [1, 0], [0, 1], [1, 1]])
    faces = find_faces(body, cell, wanted, loose, middle, face_points(kit, corner, boxes))
    must: np.ndarray = np.flatnonzero(region.reshape(-1))
    row_of_cell = np.full(wanted.size, -1)
    row_of_cell[must] = np.arange(len(must))
    optional = body < n
    flat: np.ndarray = np.asarray(np.ravel_multi_index(tuple(cell[optional].T), wanted.shape))
    model = Model()
    used = model.columns(cost, 1.0, integer=True)
    model.rows(np.ones(len(must)), 1.0, (row_of_cell[flat], body[optional], 1.0))
    own = np.stack([weight, np.zeros_like(weight), np.zeros_like(weight)], 1)
    add_forces(model, used, faces, own, float(weight.sum()))
    kinds = np.array([block.kind for block in bodies[:n]])
    for name, count in heap.items():
        mine = np.flatnonzero(kinds == name)
        model.rows(-INF, float(max(count, 0)), (0, mine, 1.0))
    return model.program()


# ---------------------------------------------------------------- forces


@dataclass(frozen=True)
class Faces:
    """Faces on which bodies may press: first those they lie on, then tops on which others lie."""

    body: np.ndarray
    """int64[f]"""
    sign: np.ndarray
    """float64[f]: 1 below the body, -1 on top of it."""
    lever: np.ndarray
    """float64[f, m, 2]: of the points where forces act, about the centre of mass [cells]."""
    joined: np.ndarray
    """int64[j]: the faces between two bodies."""
    plane: np.ndarray
    """int64[j]: which of them are one."""


def face_points(kit: Kit, points: np.ndarray, inset: bool = True) -> np.ndarray:
    """float64[m, 2]: ``points`` (0 to 1) of the face of a cell [cells], those on its edge by half
    a joint and ``EDGE_INSET`` inside it."""
    room = (EDGE_INSET * min(kit.pitch[:2]) + kit.joint_gap / 2) / np.array(kit.pitch[:2]) * inset
    return np.where(points == 0, room, np.where(points == 1, 1 - room, points))


def find_faces(
    body: np.ndarray, cell: np.ndarray, wanted: np.ndarray, loose: np.ndarray,
    middle: np.ndarray, points: np.ndarray,
) -> Faces:  # fmt: skip
    """The faces of bodies, each a set of cells.

    Args:
        body, cell: int64[c] and int64[c, 3], the cells of all bodies.
        wanted: bool[X, Y, Z], what may carry a cell.
        loose: bool[X, Y, Z], cells of blocks whose balance is asked for.
        middle: float64[bodies, 2], centres of mass [cells].
        points: float64[m, 2], see :func:`face_points`.
    """
    shape, size = wanted.shape, wanted.size
    flat: np.ndarray = np.asarray(np.ravel_multi_index(tuple(cell.T), shape))
    key = body * size + flat
    under = np.pad(wanted[:, :, :-1], ((0, 0), (0, 0), (1, 0)), constant_values=True)
    roof = np.pad(loose[:, :, 1:], ((0, 0), (0, 0), (0, 1)))
    bottom = (~np.isin(key - 1, key) | (cell[:, 2] == 0)) & under.reshape(-1)[flat]
    top = ~np.isin(key + 1, key) & roof.reshape(-1)[flat]
    face = np.concatenate([np.flatnonzero(bottom), np.flatnonzero(top)])
    sign = np.where(np.arange(len(face)) < bottom.sum(), 1.0, -1.0)
    plane = flat[face] + (sign < 0)  # the cell above the face
    joined = np.flatnonzero(loose.reshape(-1)[np.maximum(plane - 1, 0)] & (plane % shape[2] > 0))
    _, which = np.unique(plane[joined], return_inverse=True)
    lever = cell[face, None, :2] + points - middle[body[face], None]
    return Faces(body[face], sign, lever, joined, which.reshape(-1))


def add_forces(model: Model, used: np.ndarray, faces: Faces, own: np.ndarray, most: float) -> None:
    """Forces at the points of all faces that balance all bodies, action being reaction.

    Args:
        used: columns that say whether each of the first bodies is used; all others are.
        own: float64[bodies, 2 or 3]: weight of every body, and its moments about the centre of
            mass; without the last one, in x and z alone.
        most: no force on top of a body is larger.
    """
    n, (count, arms), m = len(used), own.shape, faces.lever.shape[1]
    force = model.columns(np.zeros(faces.lever[:, :, 0].size)).reshape(-1, m)
    row, sign = arms * faces.body[:, None], faces.sign[:, None]
    lever = (np.ones_like(faces.lever[:, :, 0]), *np.moveaxis(faces.lever, 2, 0))
    balance = np.where(np.arange(count)[:, None] < n, 0.0, own).reshape(-1)
    model.rows(
        balance, balance, *((row + k, force, sign * lever[k]) for k in range(arms)),
        *((arms * np.arange(n) + k, used, -own[:n, k]) for k in range(arms)),
    )  # fmt: skip
    loads = (faces.sign < 0) & (faces.body < n)  # what is not used bears nothing
    model.rows(np.full(n, -INF), 0.0, (faces.body[loads, None], force[loads], 1.0),
               (np.arange(n), used, -most))  # fmt: skip
    row = m * faces.plane[:, None] + np.arange(m)
    model.rows(np.zeros(m * (faces.plane.max(initial=-1) + 1)), 0.0,
               (row, force[faces.joined], sign[faces.joined]))  # fmt: skip
