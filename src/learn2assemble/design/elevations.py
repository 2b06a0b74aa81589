"""Elevations as cells: a wall for every side, where it stands."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from learn2assemble.design import drawings
from learn2assemble.design.cells import CellDesign, Origin, design_of
from learn2assemble.design.drawings import SIDES, Contours, Drawing
from learn2assemble.design.lattice import HALF, fit, shares
from learn2assemble.design.lost import (
    MOVED,
    fitting_cell,
    fitting_words,
    lost_features,
    lost_words,
    moved_edges,
    rounded_words,
)
from learn2assemble.design.reading import Extent, Lengths


def from_drawing(drawing: Drawing, origin: Origin) -> CellDesign:
    """Walls where the sides stand.

    Front and back face each other, and so do right and left; where there are both pairs, they are
    the faces of a box as wide as the wider of front and back and as deep as the wider of right and
    left. Each wall is ``depth`` thick. Walls of a placed drawing keep their distance from the
    middle of the table, on the lattice.
    """
    given, source = origin.given, origin.source
    kit = given.kit or drawing.kit
    cell = given.edges(kit)
    points = {side: np.concatenate(contours) for side, contours in drawing.sides.items()}
    boxes = {side: np.stack([p.min(0), p.max(0)]) for side, p in points.items()}
    extents = np.array([box[1] - box[0] for box in boxes.values()]).max(0)
    across = cell[0] if "front" in boxes or "back" in boxes else cell[1]
    extent = Extent(extents, np.array([across, cell[2]]), source, drawing.placed)
    scale = extent.scale(given, drawing.metres)
    origins = _origins(boxes, drawing.placed)
    palette = sorted({colour for paints in drawing.paints.values() for _, colour in paints})
    pairs: list[_Walls] = []
    lost = list[str]()
    far, changed = 0.0, None
    for axis, (one, other) in enumerate((SIDES[:2], SIDES[2:])):
        names = [side for side in (one, other) if side in boxes]

        def seen(contours: Contours, side: str) -> Contours:
            """On the lattice. From the right and from the front, x of the viewer runs along y and
            x; from the other two sides it runs against them."""
            turn = -1 if side == other else 1  # noqa: B023
            unit = (turn * cell[axis], cell[2])  # noqa: B023
            return [((c - origins[side]) * scale / unit)[::turn] for c in contours]

        walls: list[Contours] = [seen(drawing.sides[side], side) for side in names]
        if walls:
            triangles = _around(walls)
            points_ = triangles.reshape(-1, 3)
            ends = np.abs(points_[:, 0]).max() * 2 if drawing.placed else np.ptp(points_[:, 0])
            edges = np.array([cell[axis], cell[2]])
            drawn = np.array([ends, points_[:, 2].max()]) * edges / scale
            Extent(drawn, edges, source, drawing.placed).check(scale)
            share, first = fit(triangles, (0,))
            words, off = _not_shown(walls, (cell[axis], cell[2]), first)
            lost += words
            far = max(far, off)
            changed = changed or _thickness(given.depth, cell[1 - axis])
            tint = np.zeros(share.shape, np.int64)
            for k, side in enumerate(names):
                paints = [
                    (seen(contours, side), colour)
                    for contours, colour in drawing.paints.get(side, ())
                ]
                tint[:, k] = _tints(paints, palette, first, (len(share), share.shape[2]))
            whole = [
                np.concatenate([*(_prism(contour, k) for contour in wall), _caps(wall, k)])
                for k, wall in enumerate(walls)
            ]
            pairs.append(_Walls(axis, names, np.stack([share, tint]), first, whole))
    moves = rounded_words((across, cell[2]), far, changed)
    least = 3 if drawing.placed and len(boxes) > 2 else 1
    share, tint, surface = _footprint(pairs, given.depth, cell, least, drawing.placed)
    colours = None
    if tint.any():
        common = np.bincount(tint[(tint > 0) & (share >= HALF)], minlength=2)
        colours = np.array([(0, 0, 0), *palette], np.uint8)[
            np.where(tint > 0, tint, common.argmax())
        ]
    thick = given.depth / (cell[1] * max(1, round(given.depth / cell[1]))) if given.depth else 1.0
    origin = replace(
        origin,
        kit=kit,
        remedies=extent.remedies(scale),
        blocks=drawing.blocks,
        note="; ".join(dict.fromkeys(filter(None, (origin.note, moves, *lost)))),
    )
    made = design_of(
        share,
        origin,
        cell,
        thickness=thick,
        trim=not drawing.placed,
        colours=colours,
        surface=surface,
    )
    return replace(made, drawn=tuple(side for side in SIDES if side in boxes))


def _not_shown(
    walls: list[Contours], edges: tuple[float, float], first: np.ndarray
) -> tuple[list[str], float]:
    """What cells of such edges [m] do not show of walls [cells], and which cells would; and how
    far edges of walls move [m], 0 where something is said that tells more.

    Args:
        first: lower corner of the first cell, ``float64[3]`` [cells].
    """

    def fitted(walls: list[Contours]) -> tuple[np.ndarray, np.ndarray]:
        return fit(_around(walls), (0,))

    found, finer = lost_features(walls, fitted, edges)
    fitting = fitting_cell(walls, fitted, edges)
    if found:
        return [lost_words(found, fitting or finer)], 0.0
    words = [fitting_words(fitting)] if fitting else []
    return words, moved_edges(walls, first, edges)


def _thickness(depth: float | None, edge: float) -> tuple[float, float] | None:
    """How thick walls are asked for and made of cells with such an edge [m]; None if alike."""
    made = edge * max(1, round((depth or edge) / edge))
    return None if depth is None or abs(depth - made) < MOVED * edge else (depth, made)


def _origins(boxes: dict[str, np.ndarray], placed: bool) -> dict[str, np.ndarray]:
    """Where the middle of each side is on the table, in coordinates of the drawing.

    Sides that are all drawn over one another share it; sides drawn apart have their own.
    """
    if placed:
        return dict.fromkeys(boxes, np.zeros(2))
    low = np.array([box[0] for box in boxes.values()])
    high = np.array([box[1] for box in boxes.values()])
    if (low.max(0) < high.min(0)).all():
        shared = np.array([(low.min(0)[0] + high.max(0)[0]) / 2, low.min(0)[1]])
        return dict.fromkeys(boxes, shared)
    return {side: np.array([box[:, 0].mean(), box[0, 1]]) for side, box in boxes.items()}


def _tints(
    paints: list[drawings.Paint],
    palette: list[drawings.Colour],
    origin: np.ndarray,
    shape: tuple[int, int],
) -> np.ndarray:
    """Which colour shows most in every cell of a wall, int64[X, Z]: index into palette + 1, or 0.

    Args:
        paints: contours [cells] and colours, later over earlier.
        origin: float64[3], lower corner of the first cell [cells].
    """
    seen = np.zeros((len(palette) + 1, *shape))
    for contours, colour in paints:
        walls = np.concatenate([_prism(contour, 0) for contour in contours])
        moved = walls - (origin[0], 0, origin[2])
        low, high = (f(moved.reshape(-1, 3), axis=0) for f in (np.min, np.max))
        if (low < -1e-6).any() or (high[[0, 2]] > np.array(shape) + 1e-6).any():
            continue  # It was cut away, or painted over with paper.
        share = np.clip(shares(moved, (shape[0], 1, shape[1]))[:, 0], 0.0, 1.0)
        seen *= 1 - share
        seen[palette.index(colour) + 1] += share
    return np.where(seen.max(0) > 0, seen.argmax(0), 0)


def _prism(contour: np.ndarray, place: int) -> np.ndarray:
    """Walls of a contour (x, z) that is extruded from y = place to place + 1."""
    return upright(contour, np.roll(contour, -1, axis=0), place)


def _around(walls: list[Contours]) -> np.ndarray:
    """Triangles around walls one behind the other, but for those that face along y."""
    prisms = [_prism(contour, k) for k, wall in enumerate(walls) for contour in wall]
    return np.concatenate(prisms)


def _caps(contours: Contours, place: int) -> np.ndarray:
    """The two sides of a wall between its contours (x, z), at y = place and place + 1."""
    import manifold3d

    points, library = np.concatenate(contours), cast("Any", manifold3d)
    corners: np.ndarray = np.asarray(library.triangulate(contours), np.int64)
    flat = points[corners.reshape(-1, 3)]
    return np.concatenate([np.insert(flat, 1, place + k, axis=2) for k in (0, 1)])


def upright(start: np.ndarray, end: np.ndarray, place: int) -> np.ndarray:
    """Two triangles on every line from ``start`` to ``end`` (x, z), from y = place to place + 1."""

    def at(points: np.ndarray, y: int) -> np.ndarray:
        return np.column_stack([points[:, 0], np.full(len(points), float(y)), points[:, 1]])

    a, b = at(start, place), at(end, place)
    c, d = at(end, place + 1), at(start, place + 1)
    return np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])[:, ::-1]


@dataclass(frozen=True)
class _Walls:
    """One or two walls that face each other, on the lattice."""

    axis: int
    """Along which they run: 0 for front and back, 1 for right and left."""
    names: list[str]
    both: np.ndarray
    """Shares and tints, ``float64[2, across, walls, high]``."""
    first: np.ndarray
    """Lower corner of the first cell, ``float64[3]`` [cells]."""
    triangles: list[np.ndarray]
    """Around each wall; x across, y of its place among the walls, z up [cells]."""


def _footprint(
    pairs: list[_Walls], depth: float | None, cell: Lengths, least: int, placed: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Shares of the cells of all walls together, ``float64[X, Y, Z]``, their tints alike, and the
    triangles around them, ``float64[N, 3, 3]`` [cells]."""
    thick = [max(1, round((depth or edge) / edge)) for edge in cell]
    walls: dict[str, np.ndarray] = {}
    around: dict[str, np.ndarray] = {}
    spans = [0, 0]
    for pair in pairs:
        axis, both = pair.axis, pair.both
        wide, below = both.shape[1], int(pair.first[2])
        across = sum(len(other.names) for other in pairs if other.axis != axis)
        room = max(least, thick[axis] * across)  # for the walls of the other pair
        low = round(2 * float(pair.first[0])) / 2 if placed else -wide / 2
        half = max(-low, low + wide, room / 2)
        if (2 * half) % 1 or (half + low) % 1:
            half += 0.5
        before = round(half + low)
        after = round(2 * half) - before - wide
        both = np.pad(both, ((0, 0), (before, after), (0, 0), (below, 0)))
        spans[axis] = both.shape[1]
        walls |= {name: both[:, :, k] for k, name in enumerate(pair.names)}
        moved = (before - pair.first[0], 0.0, below - pair.first[2])
        around |= {name: pair.triangles[k] - (0, k, 0) + moved for k, name in enumerate(pair.names)}
    for axis, pair in enumerate((SIDES[2:], SIDES[:2])):
        # Without the other pair, walls stand back to back.
        spans[axis] = max(spans[axis], thick[axis] * sum(side in walls for side in pair))
    made = np.zeros((2, *spans, max(wall.shape[2] for wall in walls.values())))
    for name, wall in walls.items():
        axis = 1 if name in ("front", "back") else 0
        near = name in ("front", "left")
        line = slice(0, thick[axis]) if near else slice(-thick[axis], None)
        part = made[:, :, line] if axis == 1 else made[:, line].swapaxes(1, 2)
        part = part[..., : wall.shape[2]]
        np.maximum(part, wall[:, :, None], out=part)
        start = 0 if near else spans[axis] - thick[axis]
        around[name] = around[name] * (1, thick[axis], 1) + (0, start, 0)
        if axis == 0:
            around[name] = around[name][..., [1, 0, 2]]
    return made[0], made[1].astype(np.int64), np.concatenate(list(around.values()))
