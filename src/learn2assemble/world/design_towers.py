"""Towers: what can be built in the planes of the elevations, and how much of them it shows.

Cubes carry no sideways load, so a cube stays only on the table or straight on another cube
(:mod:`learn2assemble.geometry.boxes`): whatever is built in the plane of an elevation is a row of
towers. A block in front of an elevation hides it from the camera and is never counted on.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import shapely

from learn2assemble.world.blocks import EDGE
from learn2assemble.world.design_model import Design
from learn2assemble.world.design_pixels import (
    MAX_COLUMN,
    NUM_LEVELS,
    TOUCHING,
    Cell,
    Terms,
    count_pixels,
    face_pixels,
    tower_pixels,
)
from learn2assemble.world.sides import side_frames, to_world

INSIDE_SHARE = 0.01
"""A cell is inside an outline when more than this share of its face is."""


class Tower(NamedTuple):
    """One place on the table where a tower may stand."""

    place: tuple[int, int]
    """World x and y [cells]."""
    faces: tuple[tuple[int, int], ...]
    """(elevation, column) of every plane it stands in: two at a corner of a 3x3 footprint."""
    inside: np.ndarray
    """bool[NUM_LEVELS]: whether the cell is inside at least one outline."""


class Limit(NamedTuple):
    """How high a tower must and may be [blocks]."""

    tower: Tower
    low: int
    high: int


def needed_cells(design: Design, terms: Terms = TOUCHING) -> tuple[dict[Cell, int], ...]:
    """Per elevation, the cells whose face holds mask pixels, with their number.

    Pixels that show the table are covered from the start and belong to no cell. A pixel sees a
    point up to 7.8 mm below the one its mask bit stands for (protocol 3.5), so the cell under an
    overhang may hold one row of pixels.
    """
    counts = [np.bitwise_count(face_pixels(terms) & m).sum((-1, -2)) for m in design.masks()]
    return tuple(
        {Cell(int(i) - MAX_COLUMN, int(n)): int(count[i, n]) for i, n in np.argwhere(count)}
        for count in counts
    )


def inside_cells(design: Design, terms: Terms = TOUCHING) -> tuple[frozenset[Cell], ...]:
    """Per elevation, the cells where a block stands inside the outline (more than 1 % of its face).

    With ``supports`` off, every block stands in such a cell of at least one elevation.
    """
    k = np.arange(-MAX_COLUMN, MAX_COLUMN + 1)[:, None] * terms.pitch
    z = np.arange(NUM_LEVELS)[None, :] * EDGE
    faces = shapely.box(k - EDGE / 2, z, k + EDGE / 2, z + EDGE)
    result = []
    for elevation in design.elevations:
        area = shapely.area(shapely.intersection(faces, elevation.polygon))
        cells = np.argwhere(area > INSIDE_SHARE * EDGE * EDGE)
        result.append(frozenset(Cell(int(i) - MAX_COLUMN, int(n)) for i, n in cells))
    return tuple(result)


def share_of(design: Design, pixels: np.ndarray, terms: Terms) -> np.ndarray:
    """F_co for a number of pixels filled after the first block (protocol 3.4)."""
    masks = design.masks()
    left = count_pixels(masks & ~design.first_cover(terms))
    if terms.from_first:
        return pixels / left
    total = count_pixels(masks)
    return (pixels + total - left) / total


def towers_of(design: Design, terms: Terms) -> list[Tower]:
    """Every place in the planes of the elevations, in the order of elevation and column."""
    inside, pitch = inside_cells(design, terms), terms.pitch
    frames = side_frames(design.num_sides, pitch, terms.aisle)
    span = MAX_COLUMN if design.num_sides < 3 else 1
    faces: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for side, frame in enumerate(frames):
        for column in range(-span, span + 1):
            x, y, _ = to_world(frame, np.array(pitch * column), np.array(0.0), np.array(0.0))
            faces.setdefault((round(x / pitch), round(y / pitch)), []).append((side, column))
    return [
        Tower(
            place,
            tuple(seen),
            np.array([any(Cell(k, n) in inside[s] for s, k in seen) for n in range(NUM_LEVELS)]),
        )
        for place, seen in faces.items()
    ]


def first_tower(design: Design, towers: list[Tower]) -> Tower:
    """The tower that begins with the first block."""
    return next(t for t in towers if (design.first_elevation, 0) in t.faces)


def solid_height(tower: Tower) -> int:
    """Cells inside the outlines from the table up to the first one outside."""
    return NUM_LEVELS if tower.inside.all() else int(np.argmin(tower.inside))


def connected(towers: list[Tower], start: tuple[int, int]) -> set[tuple[int, int]]:
    """Places reached from ``start`` over neighbouring places with a cell inside on the table."""
    free = {tower.place for tower in towers if tower.inside[0]}
    reached, stack = {start}, [start]
    while stack:
        x, y = stack.pop()
        for place in ((x - 1, y), (x + 1, y), (x, y - 1), (x, y + 1)):
            if place in free and place not in reached:
                reached.add(place)
                stack.append(place)
    return reached


def limits_of(design: Design, terms: Terms) -> list[Limit]:
    """The towers worth building and how high they may be; the first block is always there."""
    needed, towers = needed_cells(design, terms), towers_of(design, terms)
    first = first_tower(design, towers)
    # A block is put next to a placed one, and every tower begins on the table.
    reached = connected(towers, first.place)
    limits = []
    for tower in towers:
        levels = [c.level for s, k in tower.faces for c in needed[s] if c.column == k]
        high = max(levels, default=-1) + 1
        if not design.supports:
            high = min(high, solid_height(tower)) if tower.place in reached else 0
        low = 1 if tower is first else 0
        if max(low, high) > 0:
            limits.append(Limit(tower, low, max(low, high)))
    return limits


def most_pixels(design: Design, limits: list[Limit], terms: Terms) -> np.ndarray:
    """Most mask pixels that ``b`` blocks in towers add to the first block's: ``int64[B + 1]``.

    Towers of one elevation share pixels only with their neighbours (those that see their common
    edge), so the height of the tower before is all a tower has to know. Entry 0 is 0, and the
    array never falls.
    """
    target = design.masks() & ~design.first_cover(terms)
    most = np.array([[0]])  # [height of the tower before, blocks used]; -1 is impossible
    before = np.zeros((1, *target.shape), np.uint64)
    for tower, low, high in limits:
        towers = np.zeros((high - low + 1, *target.shape), np.uint64)
        for side, column in tower.faces:
            pixels = tower_pixels(terms)[column + MAX_COLUMN, low : high + 1]
            towers[:, side] = pixels & target[side]
        new = np.full((len(towers), most.shape[1] + high), -1)
        for k, tower_image in enumerate(towers):
            gain = np.bitwise_count(tower_image & ~before).sum((-1, -2, -3)).astype(np.int64)
            reached = np.where(most >= 0, most + gain[:, None], -1).max(0)
            new[k, low + k : low + k + len(reached)] = reached
        most, before = new, towers
    return np.maximum(np.maximum.accumulate(most.max(0)), 0)
