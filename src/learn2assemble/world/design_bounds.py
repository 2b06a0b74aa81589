"""Towers: what can be built in the planes of the elevations, and how much of them it shows.

Cubes carry no sideways load, so a cube stays only on the table or straight on another cube
(:mod:`learn2assemble.geometry.support`): whatever is built in the plane of an elevation is a row of
towers. A block in front of an elevation hides it from the camera and is never counted on.

What a design asks of the blocks: how much is enough, the fewest, and why it cannot be built.

All bounds are about towers in the planes of the elevations (:mod:`~.design_towers`).

Designs: what a user hands over to be built, as a value and as a JSON file.

The file format is documented in ``docs/designs.md``. This module reads and writes it; the value
itself is in :mod:`~learn2assemble.world.design` and what it asks of the blocks in
:mod:`~learn2assemble.world.design_bounds` and
:mod:`~learn2assemble.world.design_bounds`.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import shapely

from learn2assemble.errors import InputError
from learn2assemble.files import load_json, printable, read_text
from learn2assemble.world.blocks import EDGE
from learn2assemble.world.design import (
    FORMAT,
    MAX_COLUMN,
    NUM_LEVELS,
    TOUCHING,
    VERSION,
    Cell,
    Design,
    Elevation,
    Terms,
    count_pixels,
    design_from,
    face_pixels,
    tower_pixels,
)
from learn2assemble.world.layouts import side_frames, to_world

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
    point up to 7.8 mm below the one its mask bit stands for, so the cell under an
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
    """F_co for a number of pixels filled after the first block."""
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


BESIDE = 0.001
"""How far beside its place a block may stand that an arm has put down [m]."""


def unsupported_cells(design: Design, terms: Terms = TOUCHING) -> tuple[tuple[Cell, ...], ...]:
    """Per elevation, the needed cells inside its outline with a cell below them that is not.

    "Not" means inside no elevation. No cube can bridge such a gap, so these cells need blocks
    outside the outlines to carry them. Sorted by column, then level.
    """
    needed, inside = needed_cells(design, terms), inside_cells(design, terms)
    result: list[list[Cell]] = [[] for _ in design.elevations]
    for tower in towers_of(design, terms):
        height = solid_height(tower)
        for side, column in tower.faces:
            cells = (Cell(column, level) for level in range(height, NUM_LEVELS))
            result[side] += [c for c in cells if c in needed[side] and c in inside[side]]
    return tuple(tuple(sorted(cells)) for cells in result)


def required_share(design: Design, terms: Terms = TOUCHING) -> float:
    """F_co that must be exceeded.

    Where blocks stand apart, it is the design's share of what they can cover, as nobody can fill
    the gaps between them. They may stand a little beside their places then, so pixels that see the
    very edge of a block count half.
    """
    if not terms.of_coverable:
        return design.success_threshold
    free = dataclasses.replace(design, supports=True)
    most = [_most_share(free, terms._replace(margin=margin)) for margin in (0.0, BESIDE)]
    return design.success_threshold * sum(most) / len(most)


def _most_share(design: Design, terms: Terms) -> float:
    """F_co with as many blocks as there is room for."""
    return float(share_of(design, most_pixels(design, limits_of(design, terms), terms), terms)[-1])


def minimum_blocks(design: Design, terms: Terms = TOUCHING) -> int:
    """The fewest blocks, the first one included, with which F_co exceeds the threshold.

    Exact over all sets of towers that stand in the planes of the elevations, by dynamic
    programming over the towers; a block at the corner of a 3x3 footprint counts once. That the
    towers must also touch one another is left out, so it is a lower bound where they do not.
    With ``supports`` off, towers end below the first cell outside the outlines.

    Raises:
        InputError: where ``supports`` is off and no number of blocks suffices.
    """
    best = most_pixels(design, limits_of(design, terms), terms)
    enough = np.flatnonzero(share_of(design, best, terms) > required_share(design, terms))
    if len(enough) == 0:
        reason = explain_refusal(design, terms) or "out of reach"
        raise InputError("supports", design.supports, f"true, because {reason}")
    return int(enough[0])


def explain_refusal(design: Design, terms: Terms = TOUCHING) -> str | None:
    """Why the design cannot be built, in one sentence without a full stop, or None."""
    if not design.supports:
        reason = _explain_overhang(design, terms)
        if reason is not None:
            return reason
    least = minimum_blocks(design, terms)
    if design.num_blocks is not None and design.num_blocks < least:
        return f"needs at least {least} blocks, the design gives {design.num_blocks}"
    return None


def _explain_overhang(design: Design, terms: Terms) -> str | None:
    """Why it cannot be built from blocks inside the outlines alone, or None where it can."""
    if Cell(0, 0) not in inside_cells(design, terms)[design.first_elevation]:
        name = design.elevations[design.first_elevation].name
        return (
            f"the first block stands at the bottom centre of elevation {name!r}, outside its "
            "outline, and supports are off"
        )
    share = share_of(design, most_pixels(design, limits_of(design, terms), terms), terms)[-1]
    if share > required_share(design, terms):
        return None
    tail = (
        f"and supports are off: the rest is {100 * share:.1f} % of what the first block leaves, "
        f"more than {100 * required_share(design, terms):g} % are asked for"
    )
    for elevation, cells in zip(design.elevations, unsupported_cells(design, terms), strict=True):
        if cells:
            listed = ", ".join(f"(column {c.column}, level {c.level})" for c in cells[:4])
            more = f" and {len(cells) - 4} more" if len(cells) > 4 else ""
            name = elevation.name
            return f"elevation {name!r} overhangs at {listed}{more}, no cube can bridge it, {tail}"
    towers = towers_of(design, terms)
    reached = connected(towers, first_tower(design, towers).place)
    if any(tower.inside[0] and tower.place not in reached for tower in towers):
        return f"parts of it stand apart from the first block, {tail}"
    return f"the outlines only graze some of the cells they need, {tail}"


__all__ = [
    "Cell",
    "Design",
    "Elevation",
    "dump_design",
    "explain_refusal",
    "inside_cells",
    "minimum_blocks",
    "needed_cells",
    "parse_design",
    "read_design",
    "required_share",
    "unsupported_cells",
    "write_design",
]


def parse_design(text_or_obj: str | Mapping[str, Any], source: str) -> Design:
    """The design in JSON text, or in an object already parsed from JSON.

    Args:
        text_or_obj: the text of a design file, or its content as a mapping.
        source: what messages call it, for example the file name.

    Raises:
        InputError: one line that names ``source`` and the JSON path of the fault.
    """
    source = printable(source)
    value = load_json(text_or_obj, source, FORMAT) if isinstance(text_or_obj, str) else text_or_obj
    return design_from(value, source)


def read_design(path: str | Path) -> Design:
    """The design in the file ``path``.

    Raises:
        InputError: for a file that is missing, unreadable, larger than 1 MB or not UTF-8, and
            for everything :func:`parse_design` refuses.
    """
    text, source = read_text(Path(path), "design file")
    return parse_design(text, source)


def dump_design(design: Design) -> str:
    """The design as JSON text; :func:`parse_design` gives back an equal design."""
    head: dict[str, Any] = {"format": FORMAT, "version": VERSION, "name": design.name}
    if design.description:
        head["description"] = design.description
    head["units"] = "m"
    if design.kit is not None:
        head["kit"] = design.kit
    if design.num_blocks is not None:
        head["blocks"] = design.num_blocks
    head["first_block"] = {"elevation": design.first_elevation}
    head["success_threshold"] = design.success_threshold
    head["supports"] = design.supports
    lines = [f"  {_json(key)}: {_json(value)},\n" for key, value in head.items()]
    sides = [
        f'    {{"name": {_json(side.name)}, "outline": {_json(side.outline.tolist())}}}'
        for side in design.elevations
    ]
    return "{\n" + "".join(lines) + '  "elevations": [\n' + ",\n".join(sides) + "\n  ]\n}\n"


def write_design(design: Design, path: Path) -> None:
    """Write the design to a new file ``path``.

    Raises:
        InputError: where something of that name exists already, or the file cannot be written.
    """
    path = Path(path)
    try:
        with path.open("x", encoding="utf-8", newline="\n") as file:
            file.write(dump_design(design))
    except FileExistsError:
        raise InputError(printable(str(path)), "an existing file", "a new file name") from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        expected = "a file name that can be written"
        raise InputError(printable(str(path)), reason, expected) from None


def _json(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False, allow_nan=False)
