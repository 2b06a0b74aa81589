r"""What makes a finished building stand, and how it falls.

Blocks are chosen together with their forces by one mixed-integer program.
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
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from learn2assemble.assembly.kit import Kit
from learn2assemble.linear_programs import INF, Clock, Entry, LinearProgram, Model, Repeated, solve
from learn2assemble.planning.tiling.cover.candidates import (
    BlockPlacement,
    from_below,
    placement_cells,
)
from learn2assemble.planning.tiling.cover.retiling import bonded_candidates, find_blocks
from learn2assemble.planning.tiling.cover.tile import Tiling
from learn2assemble.planning.tiling.stack import block_masses
from learn2assemble.statics.step_proof import EDGE_INSET, Stack, lies_above

if TYPE_CHECKING:
    from learn2assemble.statics.forces.block_forces import System

NEAR, LEVELS = 4, 3
"""How far round a block that falls the tiling is decided again [cells], and on how many levels."""
_GAP = 0.02
"""Share of its price by which a tiling may be dearer than the cheapest that stands."""
_SPARSER, _SPARSE = 6, 4
"""How often a mechanism is looked for that opens fewer joints, and how few are enough."""
_GLUED = 1e6
"""Price of parting a pair of blocks that a motion found before has parted."""


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
    tiling: Tiling,
    kit: Kit,
    stack: Stack,
    region: np.ndarray,
    *,
    barred: Collection[frozenset[BlockPlacement]] = (),
    seconds: float = INF,
) -> tuple[str, Tiling | None]:
    """The tiling, with the blocks of a region chosen anew so that they stand.

    Args:
        stack: of the tiling.
        region: bool[X, Y, Z], cells of whole blocks.
        barred: sets of blocks that are not all used together.

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
    heap = {kind.name: kind.count - used[kind.name] for kind in kit.kinds if kind.count is not None}
    apart = list[np.ndarray]()
    for together in barred:
        fixed = set(stays) & together
        chosen = find_blocks(found, together, kit)
        if len(fixed) + len(chosen) == len(together):
            apart.append(chosen)
    program = _program(tiling.wanted, kit, region, bodies, cost, heap, apart)
    answer = solve(program, seconds, gap=_GAP)
    if answer.x is None:
        return answer.status, None
    made = [*stays, *(bodies[p] for p in np.flatnonzero(answer.x[: len(found)] > 0.5))]
    return answer.status, replace(tiling, placements=from_below(made))


def _program(
    wanted: np.ndarray,
    kit: Kit,
    region: np.ndarray,
    bodies: list[BlockPlacement],
    cost: np.ndarray,
    heap: dict[str, int],
    apart: list[np.ndarray],
) -> LinearProgram:
    """Columns: whether each candidate is used, then the forces at four corners of every face.

    Args:
        bodies: the candidates, as many as ``cost`` has, then the blocks that rest on the region.
        heap: how many blocks of these kinds may be used.
        apart: int64 each: of these candidates at least one is not used.
    """
    n, cells = len(cost), [placement_cells(block, kit) for block in bodies]
    body, cell = np.repeat(np.arange(len(bodies)), [len(c) for c in cells]), np.concatenate(cells)
    loose = region.copy()  # cells of blocks whose balance is part of the program
    for own in cells[n:]:
        loose[tuple(own.T)] = True
    weight, centre = block_masses(tuple(bodies), kit, wanted.shape)
    weight = weight / float(weight.mean())
    middle = centre[:, :2] / np.array(kit.pitch[:2]) + np.array(wanted.shape[:2]) / 2
    boxes = all(len(c) == (np.ptp(c, axis=0) + 1).prod() for c in cells)
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
    for together in apart:
        model.rows(-INF, len(together) - 1.0, (0, together, 1.0))
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
    body: np.ndarray,
    cell: np.ndarray,
    wanted: np.ndarray,
    loose: np.ndarray,
    middle: np.ndarray,
    points: np.ndarray,
) -> Faces:
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
    n, count, arms = len(used), len(own), int(own.shape[1])
    m = int(faces.lever.shape[1])
    force = model.columns(np.zeros(faces.lever[:, :, 0].size)).reshape(-1, m)
    row, sign = arms * faces.body[:, None], faces.sign[:, None]
    lever = (np.ones_like(faces.lever[:, :, 0]), *np.moveaxis(faces.lever, 2, 0))
    balance = np.where(np.arange(count)[:, None] < n, 0.0, own).reshape(-1)
    model.rows(
        balance,
        balance,
        *((row + k, force, sign * lever[k]) for k in range(arms)),
        *((arms * np.arange(n) + k, used, -own[:n, k]) for k in range(arms)),
    )
    loads = (faces.sign < 0) & (faces.body < n)  # what is not used bears nothing
    model.rows(
        np.full(n, -INF),
        0.0,
        (faces.body[loads, None], force[loads], 1.0),
        (np.arange(n), used, -most),
    )
    row = m * faces.plane[:, None] + np.arange(m)
    model.rows(
        np.zeros(m * (int(faces.plane.max(initial=-1)) + 1)),
        0.0,
        (row, force[faces.joined], sign[faces.joined]),
    )


# ---------------------------------------------------------------- how it falls


def find_mechanisms(
    stack: Stack,
    owner: np.ndarray,
    most: int = 12,
    seconds: float = INF,
    moving: np.ndarray | None = None,
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Ways in which a stack falls down, as the joints that would have to be glued.

    A mechanism is a virtual motion of the blocks, each along z and tilting about x and y, that
    presses nothing into anything and lowers the centre of mass. It exists exactly where no bed
    forces balance the blocks (Farkas). Of all of them a linear program takes one that opens the
    vertical joints least. **Cut:** any tiling of the same cells in which no block bridges one of
    the joints that open can move in the same way, so it falls, too.

    Args:
        owner: int64[X, Y, Z]: which block fills each cell, -1 for none.
        most: how many mechanisms without a common joint are looked for.
        moving: bool[n], blocks that may move; all by default.

    Returns:
        bool[X - 1, Y, Z] and bool[X, Y - 1, Z] for each: joints that open.
    """
    places, sides = _joints(owner)
    n, m, unit = len(stack), len(sides), stack.pitch
    axis, at = np.repeat([0, 1], [len(cells) for cells in places]), np.concatenate(places)[:, :2]
    size = stack.cell
    foot = (
        at + np.stack([1 - axis / 2, 0.5 + axis / 2], -1) - np.array(owner.shape[:2]) / 2
    ) * size
    model = Model()
    free = np.full(3 * n, INF) if moving is None else np.where(np.repeat(moving, 3), INF, 0.0)
    motion = model.columns(np.zeros(3 * n), free, lower=-free).reshape(n, 3)
    jumps = model.columns(np.zeros(6 * m)).reshape(2, 3 * m)

    def along_z(row: np.ndarray, block: np.ndarray, xy: np.ndarray, sign: float) -> list[Entry]:
        """Velocity of points of blocks."""
        lever = (xy - stack.centre[block, :2]) / unit
        arms = (np.ones(len(row)), lever[:, 0], lever[:, 1])
        return [(row, motion[block, k], sign * arm) for k, arm in enumerate(arms)]

    point, bears = np.arange(len(stack.point)), np.flatnonzero(stack.lower >= 0)
    model.rows(
        np.zeros(len(point)),
        INF,
        *along_z(point, stack.upper, stack.point[:, :2], 1.0),
        *along_z(bears, stack.lower[bears], stack.point[bears, :2], -1.0),
    )
    model.rows(1.0, 1.0, (0, motion[:, 0], -stack.weight / stack.weight.mean()))
    number = 3 * np.arange(m)
    model.rows(
        np.zeros(3 * m),
        0.0,
        *((np.arange(3 * m), jump, sign) for jump, sign in zip(jumps, (-1.0, 1.0), strict=True)),
        *along_z(number, sides[:, 0], foot, 1.0),
        *along_z(number, sides[:, 1], foot, -1.0),
        *(
            (number + k, motion[sides[:, side], k], sign)
            for k in (1, 2)
            for side, sign in ((0, 1.0), (1, -1.0))
        ),
    )
    program, clock = Repeated(model.program()), Clock(seconds)

    def part(price: np.ndarray, closed: np.ndarray) -> np.ndarray | None:
        opens = np.tile(np.repeat(~closed, 3), 2)
        upper = np.concatenate([free, np.where(opens, INF, 0.0)])
        cost = np.concatenate([np.zeros(3 * n), np.tile(np.repeat(price, 3), 2)])
        answer = program.solve(cost, upper, clock.left)
        if answer.x is None:
            return None
        gap = np.abs(answer.x[jumps[0]] - answer.x[jumps[1]])
        return gap.reshape(-1, 3).max(1)

    return [_edges(owner, places, opened) for opened in _partings(part, np.ones(m), most, 1e-7)]


def _partings(
    part: Callable[[np.ndarray, np.ndarray], np.ndarray | None],
    size: np.ndarray,
    most: int,
    rounding: float,
) -> list[np.ndarray]:
    """bool[m] for each of up to ``most`` motions without a common joint: which joints it opens.

    Args:
        part: how far each joint opens in the cheapest motion, from the prices of opening them and
            which of them stay closed (bool[m]); None where there is no motion.
        size: float64[m], prices to begin with.
        rounding: what counts as closed, in the widest opening.
    """
    closed, found = np.zeros(len(size), bool), list[np.ndarray]()
    while len(found) < most:
        price, opened, last = size, None, None
        for _ in range(1 + _SPARSER):
            gap = part(price, closed)
            if gap is None:
                break
            widest = float(gap.max(initial=0.0))
            if last is not None and np.allclose(gap / widest, last, atol=1e-9):
                break  # The prices are those of before, and so is the answer.
            last = gap / widest if widest > 0 else None
            now = gap > max(rounding * widest, 1e-7)
            if opened is None or size[now].sum() < size[opened].sum():
                opened = now
            if size[opened].sum() <= _SPARSE:
                break
            # Joints that hardly open cost more: the next motion does without them.
            price = size / (gap / widest + 1e-3)
        if opened is None:
            break
        found.append(opened)
        if not opened.any():
            break
        closed |= opened
    return found


def _joints(owner: np.ndarray) -> tuple[list[np.ndarray], np.ndarray]:
    """Where two blocks stand side by side: the cells of the lower ones of pairs in x and in y
    (int64[., 3] each), and the blocks of all pairs (int64[m, 2])."""
    places, sides = list[np.ndarray](), list[np.ndarray]()
    for low, high in ((owner[:-1], owner[1:]), (owner[:, :-1], owner[:, 1:])):
        places.append(np.argwhere((low >= 0) & (high >= 0) & (low != high)))
        sides.append(np.stack([cells[tuple(places[-1].T)] for cells in (low, high)], 1))
    return places, np.concatenate(sides)


def _edges(
    owner: np.ndarray, places: list[np.ndarray], opened: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Opened joints (bool[m], those across x first) as pairs of neighbouring cells."""
    edges = np.zeros_like(owner[:-1], bool), np.zeros_like(owner[:, :-1], bool)
    for edge, at, open_ in zip(edges, places, np.split(opened, [len(places[0])]), strict=True):
        edge[tuple(at[open_].T)] = True
    return edges


def find_slides(
    system: System, owner: np.ndarray, friction: float, most: int = 4
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Ways in which blocks with tight joints fall down, as the joints that would have to be glued.

    As :func:`find_mechanisms`, with motions in all six directions of every block that friction on
    side faces does not hold back either. **Cut:** any tiling of boxes of the same cells in which no
    block bridges one of these joints can move in the same way, since the same faces part.

    Args:
        system: of all blocks, in the order of ``owner``, with vertical joints of width 0.
        owner: int64[X, Y, Z]: which block fills each cell, -1 for none.
    """
    import scipy.sparse as sp

    places, sides = _joints(owner)
    pairs, which = np.unique(sides, axis=0, return_inverse=True)
    which, m = which.reshape(-1), len(pairs)
    middle = system.centre[pairs].mean(1)
    rows, columns, values = list[np.ndarray](), list[np.ndarray](), list[np.ndarray]()
    for side, sign in ((0, 1.0), (1, -1.0)):
        body = pairs[:, side]
        arm = middle - system.centre[body]
        # Of a block that turns by w: its angle of a radius, and the velocity w x arm.
        turn = sign / system.radius[body]
        cross = np.cross(np.eye(3)[None], arm[:, None])
        block = np.zeros((m, 6, 6))
        block[:, :3, :3] = sign * np.eye(3)
        block[:, :3, 3:] = turn[:, None, None] * cross.transpose(0, 2, 1)
        block[:, 3:, 3:] = turn[:, None, None] * np.eye(3)
        row = 6 * np.arange(m)[:, None, None] + np.arange(6)[:, None]
        column = 6 * body[:, None, None] + np.arange(6)
        for entries, whole in ((row, rows), (column, columns), (block, values)):
            whole.append(np.broadcast_to(entries, block.shape).reshape(-1))
    index = np.concatenate(rows), np.concatenate(columns)
    jump = sp.csc_matrix((np.concatenate(values), index), (6 * m, 6 * system.count))

    def part(price: np.ndarray, closed: np.ndarray) -> np.ndarray | None:
        gap = system.least_parting(friction, jump, np.where(closed, _GLUED, price))
        held = gap is not None and (gap[closed] <= 1e-5 * gap.max(initial=0.0)).all()
        return gap if held else None

    size = np.bincount(which, minlength=m).astype(float)
    found = _partings(part, size, most, 1e-5)
    return [_edges(owner, places, opened[which]) for opened in found]
