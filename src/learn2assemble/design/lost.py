"""What cells cannot show of a drawing: windows that vanish or get narrower, teeth and piers that
vanish, straight edges that move.

Cells take what is half full, so a window that lies across two cells can vanish although nearly all
of the drawing is kept, and the share in common says nothing of it. Here the outline is compared
with the cells as areas; what a cell does to a slope or a curve is thinner than what is called lost.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from learn2assemble.assembly.instructions.appearance import millimetres
from learn2assemble.design.lattice import HALF, MAX_CELLS, misfit

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry

THICK = 0.35
"""A piece in which a circle of this radius has room is a feature [cells]. What a straight edge
leaves over at a cell that is just half full has room for 0.29 (cut from corner to corner), or 0.25
(cut along a side)."""
SLIT = 0.2
"""A hole that vanishes altogether is one from this width on [cells]."""
FINER = (2, 3, 4)
"""Into so many parts the edges of a cell are divided to find one that keeps everything."""
RESIZED = 0.7
"""By so much an opening is wider or higher than drawn, or less, before it is said [cells]: each of
its edges may move by half a cell."""
MOVED = 0.05
"""A straight edge that moves by less is where it was drawn [cells]."""
STRAIGHT = 0.5
"""Lines from this length on are edges [cells]; shorter ones may be parts of a curve."""
POOR = 0.85
"""A smaller share of drawing and cells in common is warned of."""
ALIKE = 1e-4
"""Lengths that differ by less are equal [cells]: what numbers of a file are rounded to."""

Contours = list[np.ndarray]
Fitted = Callable[[list[Contours]], tuple[np.ndarray, np.ndarray]]
"""Where walls lie on the lattice: their contours, each ``float64[V, 2]`` [cells], to the shares of
the cells, ``float64[across, wall, high]``, and where the first cell begins, ``float64[3]``."""


class Lost(NamedTuple):
    """A feature of a drawing that its cells do not show."""

    what: str
    """``an opening``, or ``a part``."""
    wide: float
    """[m]"""
    high: float
    """[m]"""
    shown: tuple[float, float] | None = None
    """How wide and high the cells show it [m]; None: not at all."""


def lost_features(
    walls: list[Contours], fitted: Fitted, edges: tuple[float, float]
) -> tuple[list[Lost], tuple[float, float] | None]:
    """What cells do not show of walls, the largest first, and edges of a cell that shows it.

    Args:
        walls: contours of each wall [cells]; counter-clockwise around material, clockwise around
            holes.
        fitted: how walls are laid on a lattice.
        edges: of a cell, along the wall and up [m].

    Returns:
        The features, and the edges [m] of the largest of some finer cells with which none is lost;
        None where all lose something, or nothing is lost.
    """
    found = _lost(walls, fitted, edges)
    for parts in FINER if found else ():
        finer = [[contour * parts for contour in wall] for wall in walls]
        span = np.ptp(np.concatenate([c for wall in finer for c in wall]), axis=0)
        smaller = edges[0] / parts, edges[1] / parts
        if span.max() <= MAX_CELLS and not _lost(finer, fitted, smaller):
            return found, smaller
    return found, None


def fitting_cell(
    walls: list[Contours], fitted: Fitted, edges: tuple[float, float]
) -> tuple[float, float] | None:
    """Edges of a cell of the same shape that shows all of a drawing, where its own does not.

    All edges of the drawing have to lie along the wall or upright, at multiples of one length.

    Args:
        walls, fitted, edges: as in `lost_features`.

    Returns:
        The edges [m] closest to those of the cell, at least a quarter of them; None where the cell
        shows all, or no such cell does.
    """
    share, _ = fitted(walls)
    if misfit(share) < ALIKE:
        return None
    contours = [contour for wall in walls for contour in wall]
    steps = np.concatenate([np.abs(c - np.roll(c, 1, axis=0)) for c in contours])
    if (steps.min(1) > ALIKE).any():
        return None
    points = np.concatenate(contours)
    lengths = np.abs(np.concatenate([points[:, 0] - points[:, 0].min(), points[:, 1]]))
    # In cells of which 1, 2, ... make the longest one.
    measures = lengths.max() / np.arange(1, MAX_CELLS + 1)
    measures = measures[measures >= 1 / max(FINER)]
    many = lengths / measures[:, None]
    measures = measures[(np.abs(many - many.round()) < max(FINER) * ALIKE).all(1)]
    if not len(measures):
        return None
    measure = float(measures[np.abs(np.log(measures)).argmin()])
    whole = [[contour / measure for contour in wall] for wall in walls]
    if misfit(fitted(whole)[0]) > ALIKE:
        return None
    return edges[0] * measure, edges[1] * measure


def moved_edges(walls: list[Contours], first: np.ndarray, edges: tuple[float, float]) -> float:
    """How far the level and upright edges of walls are from the planes of the lattice, at most.

    Args:
        walls, edges: as in `lost_features`.
        first: lower corner of the first cell, ``float64[3]`` [cells].

    Returns:
        [m]; 0 where all are within `MOVED`.
    """
    farthest = 0.0
    for contour in (contour for wall in walls for contour in wall):
        along = np.abs(np.roll(contour, -1, axis=0) - contour)
        for axis, edge in enumerate(edges):
            straight = (along[:, axis] < ALIKE) & (along[:, 1 - axis] >= STRAIGHT)
            places = contour[straight, axis] - first[2 * axis]
            off = np.abs(places - places.round())
            farthest = max(farthest, float((off * (off >= MOVED)).max(initial=0.0)) * edge)
    return farthest


def rounded_words(edges: tuple[float, float], far: float, thick: tuple[float, float] | None) -> str:
    """One line, such as `rounded to cells of 50 mm: edges move by up to 20 mm`.

    Args:
        edges: of a cell [m].
        far: as of `moved_edges`.
        thick: of the walls, as drawn and in cells [m]; None where they are alike.

    Returns:
        Nothing where neither differs.
    """
    words = [f"edges move by up to {millimetres(far)}"] if far else []
    if thick is not None:
        words.append(f"walls {millimetres(thick[0])} thick become {millimetres(thick[1])}")
    return f"rounded to cells of {_size(edges)}: {', '.join(words)}" if words else ""


def fitting_words(fitting: tuple[float, float]) -> str:
    """One line, such as `cells of 20 mm show all of it`."""
    return f"cells of {_size(fitting)} show all of it"


def _size(cell: tuple[float, float]) -> str:
    return millimetres(*(cell[:1] if abs(cell[0] - cell[1]) < 1e-9 else cell))


def lost_words(found: list[Lost], finer: tuple[float, float] | None) -> str:
    """One line, e.g. ``not shown by the cells: an opening of 50 × 100 mm; shown by cells of 25
    mm``."""
    words: list[str] = []
    resized = [one for one in found if one.shown is not None]
    if resized:
        one = resized[0]
        assert one.shown is not None
        sizes = f"{millimetres(one.wide, one.high)} becomes {millimetres(*one.shown)}"
        more = f" ({len(resized)} openings change)" if len(resized) > 1 else ""
        words.append(f"an opening of {sizes}{more}")
    lost = [one for one in found if one.shown is None]
    kinds = {what: [one for one in lost if one.what == what] for what in (_OPENING, _PART)}
    first = len(words)
    for what, ones in kinds.items():
        if ones:
            size = millimetres(ones[0].wide, ones[0].high)
            many = f"{len(ones)} {what}s of up to {size}" if len(ones) > 1 else f"{what} of {size}"
            words.append(many if len(ones) > 1 else f"{_ARTICLE[what]} {many}")
    if len(words) > first:
        words[first] = f"not shown by the cells: {words[first]}"
    text = "; ".join(words[:first] + [", ".join(words[first:])] * (len(words) > first))
    if finer is not None:
        text += f"; shown by cells of {_size(finer)}"
    return text


_OPENING, _PART = "opening", "part"
_ARTICLE = {_OPENING: "an", _PART: "a"}


def _lost(walls: list[Contours], fitted: Fitted, edges: tuple[float, float]) -> list[Lost]:
    """Where a cell is a square of size 1, as what bounds features is known for these alone."""
    share, first = fitted(walls)
    size = np.array(edges)
    found: list[Lost] = []
    for k, contours in enumerate(walls):
        drawn = _area(contours)
        cells = _cells(share[:, k] >= HALF, (first[0], first[2]))
        closed = [hole for hole in _holes(drawn, SLIT) if hole.within(cells)]
        resized = _resized(drawn, cells)
        found += [
            Lost(_OPENING, *_pair(size * _extent(a)), _pair(size * _extent(b))) for a, b in resized
        ]
        # What narrows an opening is said of the opening.
        told = _all([*closed, *(opening for opening, _ in resized)]).buffer(ALIKE)
        filled = [one for one in _features(cells - drawn) if one.disjoint(told)]
        for what, ones in ((_OPENING, [*filled, *closed]), (_PART, _features(drawn - cells))):
            found += [Lost(what, *_pair(size * _extent(one))) for one in ones]
    return sorted(found, key=lambda one: (-round(one.wide * one.high, 9), one.what))


def _extent(area: Any) -> np.ndarray:
    """Width and height of an area."""
    return np.subtract(area.bounds[2:], area.bounds[:2])


def _pair(size: np.ndarray) -> tuple[float, float]:
    return float(size[0]), float(size[1])


def _resized(drawn: Any, cells: Any) -> list[tuple[Any, Any]]:
    """Openings, as drawn and as shown, that the cells show narrower, lower, wider or higher."""
    found: list[tuple[Any, Any]] = []
    here, there = _openings(drawn), _openings(cells)
    for opening in here:
        shown = [one for one in there if one.intersection(opening).area > 0]
        if len(shown) != 1 or sum(shown[0].intersects(one) for one in here) > 1:
            continue
        if (np.abs(_extent(opening) - _extent(shown[0])) >= RESIZED).any():
            found.append((opening, shown[0]))
    return found


def _openings(area: Any) -> list[Any]:
    """What an area leaves free of the rectangle around it, with something on either side."""
    import shapely

    if area.is_empty:  # No cell is half full.
        return []
    library: Any = shapely
    left, low, right, high = area.bounds
    rest: Any = library.box(left, low, right, high) - area
    # Without the slivers that rounding leaves between cells.
    rest = rest.buffer(-ALIKE, join_style="mitre").buffer(ALIKE, join_style="mitre")
    ones: list[Any] = list(getattr(rest, "geoms", [rest]))
    return [
        one
        for one in ones
        if not one.is_empty
        and one.bounds[0] > left + 2 * ALIKE
        and one.bounds[2] < right - 2 * ALIKE
    ]


def _area(contours: Contours) -> Any:
    """Material between contours."""
    import shapely

    # What holes take away is drawn after what they are in; islands in holes come once more.
    area: BaseGeometry = shapely.Polygon()
    for ring in contours:
        area = area.symmetric_difference(shapely.Polygon(ring).buffer(0))
    return area


def _cells(wanted: np.ndarray, first: tuple[float, float]) -> Any:
    """Area of the cells bool[across, high] that are filled."""
    import shapely

    low = np.argwhere(wanted) + np.array(first)
    library: Any = shapely
    return library.union_all(library.box(*low.T, *(low + 1).T))


def _all(areas: list[Any]) -> Any:
    import shapely

    return shapely.union_all(areas)


def _holes(area: Any, least: float) -> list[Any]:
    """What an area goes round, where it is at least so wide and high."""
    import shapely

    rings = [ring for one in getattr(area, "geoms", [area]) for ring in one.interiors]
    holes = [shapely.Polygon(ring) for ring in rings]
    return [hole for hole in holes if _extent(hole).min() >= least]


def _features(piece: Any) -> list[Any]:
    """The parts of an area in which a circle has room, each without its thin margins."""
    core = piece.buffer(-THICK, join_style="mitre")
    ones = getattr(core, "geoms", [core])
    return [one.buffer(THICK, join_style="mitre") for one in ones if not one.is_empty]
