"""The lattice of blocks on one elevation and the camera pixels each cell fills.

Cell ``(column k, level n)`` is centred at local ``x = p k``, ``z = 0.025 + 0.05 n`` [m], in the
plane of the elevation (``y = 0``); the pitch p is 0.05 where blocks touch. Pixel sets come from the
same ray casting as the world's own coverage, so counts agree with the simulator
exactly.

What a design is: one to four outlines and the terms under which they are to be built.

Every value here is checked when it is made, so code that holds a :class:`Design` need not check
again. ``docs/designs.md`` states the rules for users.

From JSON text to the fields of a design, with the JSON path of whatever is wrong.

Only structure and types are checked here; ranges and geometry belong to
:mod:`learn2assemble.world.design`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import Any, NamedTuple

import numpy as np
import shapely

from learn2assemble.errors import InputError
from learn2assemble.files import (
    check_keys,
    integer,
    mapping,
    number,
    read_head,
    sequence,
    text,
    too_deep,
)
from learn2assemble.geometry.coverage import FILTERS, DepthFilter, add_box, clear_to_ground
from learn2assemble.geometry.images import CAMERA_Z, ROWS, WORDS, polygon_mask
from learn2assemble.world.blocks import EDGE, HALF

MAX_COLUMN = 7
"""Columns run from -MAX_COLUMN to MAX_COLUMN: faces up to |x| = 0.375 m where blocks touch, inside
the view."""
NUM_COLUMNS = 2 * MAX_COLUMN + 1
NUM_LEVELS = 12
"""Levels run from 0 to NUM_LEVELS - 1: faces up to z = 0.6 m, inside the view."""


class Cell(NamedTuple):
    """One place of the lattice on an elevation."""

    column: int
    """k: the face spans x = p k ± 0.025 m as the viewer sees it, p the pitch."""
    level: int
    """n: the face spans z = 0.05 n .. 0.05 (n + 1) m."""


class Terms(NamedTuple):
    """On which lattice a design is built, and how cameras count what covers it."""

    pitch: float = EDGE
    """Horizontal distance of the centres of neighbouring blocks [m]."""
    aisle: int = 0
    """Empty rows of cells between two walls."""
    cover_filter: str = "narrow"
    """A name of :data:`~learn2assemble.geometry.coverage.FILTERS`."""
    from_first: bool = True
    """Coverage counts what the first block leaves open; else all of the outlines."""
    of_coverable: bool = False
    """A design's threshold is a share of what such blocks can cover; else of everything."""
    margin: float = 0.0
    """How much smaller than it is every block is taken to be, on each side [m]."""

    @property
    def depths(self) -> DepthFilter:
        """The camera."""
        depths = FILTERS[self.cover_filter]
        return depths._replace(margin=depths.margin + self.margin)


TOUCHING = Terms()
"""Blocks that touch, as a hand of god can put them."""


def count_pixels(image: np.ndarray) -> int:
    """Number of pixels in a pixel set ``uint64[...]`` of any shape."""
    return int(np.bitwise_count(image).sum())


def _frozen(array: np.ndarray) -> np.ndarray:
    array.setflags(write=False)
    return array


@lru_cache(maxsize=4)
def table_pixels(terms: Terms = TOUCHING) -> tuple[np.ndarray, np.ndarray]:
    """``(covered, occluded)`` of the empty table: ``uint64[ROWS, WORDS]`` each, read-only."""
    covered, occluded = np.zeros((2, ROWS, WORDS), np.uint64)
    clear_to_ground(covered, occluded, terms.depths)
    return _frozen(covered), _frozen(occluded)


@lru_cache(maxsize=4)
def cell_pixels(terms: Terms = TOUCHING) -> np.ndarray:
    """Pixels each cell fills that the table does not: ``uint64[NUM_COLUMNS, NUM_LEVELS, ...]``.

    The complete filter of the paper; index ``k + MAX_COLUMN`` is column ``k``. Read-only. Two
    neighbouring cells may both fill a pixel that sees their common edge.
    """
    table, _ = table_pixels(terms)
    cells = np.zeros((NUM_COLUMNS, NUM_LEVELS, ROWS, WORDS), np.uint64)
    unused = np.zeros((ROWS, WORDS), np.uint64)
    for index in range(NUM_COLUMNS):
        for level in range(NUM_LEVELS):
            x, z = terms.pitch * (index - MAX_COLUMN), HALF + EDGE * level
            add_box(cells[index, level], unused, x, 0.0, z, HALF, terms.depths)
    return _frozen(cells & ~table)


@lru_cache(maxsize=4)
def face_pixels(terms: Terms = TOUCHING) -> np.ndarray:
    """As :func:`cell_pixels`, but every pixel belongs to one cell: the one whose face it sees.

    The other one shows it only its flank, so it loses to the cell nearer to the optical axis; the
    row of pixels exactly on that axis, at the edge of levels 4 and 5, goes to the lower cell.
    """
    faces = cell_pixels(terms).copy()
    taken = np.zeros((ROWS, WORDS), np.uint64)
    columns = sorted(range(NUM_COLUMNS), key=lambda index: abs(index - MAX_COLUMN))
    levels = sorted(range(NUM_LEVELS), key=lambda n: round(abs(HALF + EDGE * n - CAMERA_Z), 6))
    for index, level in product(columns, levels):
        faces[index, level] &= ~taken
        taken |= faces[index, level]
    return _frozen(faces)


@lru_cache(maxsize=4)
def tower_pixels(terms: Terms = TOUCHING) -> np.ndarray:
    """Pixels of a tower of ``h`` blocks in each column: ``uint64[NUM_COLUMNS, NUM_LEVELS + 1, …]``.

    Read-only; ``h = 0`` is the empty set.
    """
    towers = np.zeros((NUM_COLUMNS, NUM_LEVELS + 1, ROWS, WORDS), np.uint64)
    towers[:, 1:] = np.bitwise_or.accumulate(cell_pixels(terms), axis=1)
    return _frozen(towers)


DEFAULT_NAMES = ("front", "back", "right", "left")
"""Names of the elevations in the order of :func:`learn2assemble.world.layouts.side_frames`."""
MAX_ELEVATIONS = len(DEFAULT_NAMES)
MIN_VERTICES, MAX_VERTICES = 3, 64
MIN_BLOCKS, MAX_BLOCKS = 2, 400
MAX_X, MAX_Z = 0.35, 0.6
"""Largest |x| and z of an outline [m]; the camera shows |x| <= 0.389 and z <= 0.639."""
MAX_X_FOOTPRINT = 0.075
"""Largest |x| with three or four elevations [m]: faces of a 3x3 footprint."""
BELOW_TABLE = -1e-9
"""A vertex lower than this is below the table [m]."""
SLACK = 1e-9
"""Rounding allowed at the largest |x| and z [m]: 12 * 0.05 is not 0.6 in binary."""
MIN_AREA = EDGE * EDGE
"""Smallest area of an outline: one block face [m^2]."""
MIN_MASK_PIXELS = 50
"""Fewer mask pixels over all elevations are refused, as the paper's problems are at reset."""
MAX_INITIAL_COVER = 0.95
"""Refused when the first block alone fills more than this share."""
MAX_NAME, MAX_DESCRIPTION = 100, 2000
"""Longest name and description [characters]."""


@dataclass(frozen=True, eq=False)
class Elevation:
    """The outline of one side, seen from outside.

    Args:
        name: how reports call it.
        outline: ``float64[V, 2]`` local (x, z) [m], x right as the viewer sees it and 0 in the
            middle of the side, z up and 0 on the table. Either orientation is taken; it is kept
            clockwise as seen, beginning with the same vertex, and read-only.

    Raises:
        InputError: see ``docs/designs.md``; ``what`` is relative to the elevation.
    """

    name: str
    outline: np.ndarray

    def __post_init__(self) -> None:
        check_text(self.name, "name", MAX_NAME)
        try:
            outline = np.array(self.outline, np.float64) + 0.0  # turns -0.0 into 0.0
        except (TypeError, ValueError):
            raise InputError("outline", self.outline, "a list of [x, z] vertices") from None
        _check_outline(outline)
        if _signed_area(outline) > 0:
            outline = np.roll(outline[::-1], 1, axis=0)
        outline.setflags(write=False)
        object.__setattr__(self, "outline", outline)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Elevation):
            return NotImplemented
        return self.name == other.name and np.array_equal(self.outline, other.outline)

    def __hash__(self) -> int:
        return hash((self.name, self.outline.tobytes()))

    @property
    def area(self) -> float:
        """Area inside the outline [m^2]."""
        return -_signed_area(self.outline)

    @property
    def polygon(self) -> shapely.Polygon:
        """The outline as a shapely polygon [m]."""
        return shapely.Polygon(self.outline)

    def mask(self) -> np.ndarray:
        """Mask pixels, ``uint64[ROWS, WORDS]``.

        Pixels in which the table hides the face plane (the row under the bottom edge) are left
        out, as the published masks do: no block could ever change them.
        """
        _, hidden = table_pixels()
        return polygon_mask(self.outline) & ~hidden


@dataclass(frozen=True)
class Design:
    """What is to be built.

    Args:
        name: one line.
        elevations: one to four; their number fixes where they stand
            (:func:`learn2assemble.world.layouts.side_frames`).
        num_blocks: blocks available, the first one included; None leaves it to the planner.
        first_elevation: index of the elevation whose bottom centre holds the first block.
        success_threshold: Delta; the design is built when the filled share of the mask pixels
            the first block leaves, F_co, exceeds it.
        supports: whether blocks may stand outside every outline to carry others.
        description: free text.
        kit: the blocks the exact planner uses; the agent plays with cubes.

    Raises:
        InputError: for a value outside its range, and for a design the first block already fills.
    """

    name: str
    elevations: tuple[Elevation, ...]
    num_blocks: int | None = None
    first_elevation: int = 0
    success_threshold: float = 0.975
    supports: bool = True
    description: str = ""
    kit: str | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "elevations", tuple(self.elevations))
        check_text(self.name, "name", MAX_NAME)
        if self.kit is not None:
            check_text(self.kit, "kit", MAX_NAME)
        check_text(self.description, "description", MAX_DESCRIPTION, lines=True)
        if not 1 <= len(self.elevations) <= MAX_ELEVATIONS:
            raise InputError("elevations", f"{len(self.elevations)} of them", "1 to 4 elevations")
        _check_names([elevation.name for elevation in self.elevations])
        if self.num_blocks is not None and not MIN_BLOCKS <= self.num_blocks <= MAX_BLOCKS:
            raise InputError(
                "blocks",
                self.num_blocks,
                f"{MIN_BLOCKS} to {MAX_BLOCKS} blocks, the first one included",
            )
        if not 0 <= self.first_elevation < len(self.elevations):
            raise InputError(
                "first_block.elevation",
                self.first_elevation,
                f"the index of an elevation, 0 to {len(self.elevations) - 1}",
            )
        if not 0 < self.success_threshold < 1:
            raise InputError("success_threshold", self.success_threshold, "0 < threshold < 1")
        _check_width(self.elevations)
        _check_masks(self)

    @property
    def num_sides(self) -> int:
        return len(self.elevations)

    def masks(self) -> np.ndarray:
        """Mask pixels of every elevation, ``uint64[S, ROWS, WORDS]``; see :class:`Elevation`."""
        return np.stack([elevation.mask() for elevation in self.elevations])

    def first_cover(self, terms: Terms = TOUCHING) -> np.ndarray:
        """What the table and the first block fill, ``uint64[S, ROWS, WORDS]``."""
        table, _ = table_pixels(terms)
        cover = np.repeat(table[None], self.num_sides, axis=0)
        cover[self.first_elevation] |= cell_pixels(terms)[MAX_COLUMN, 0]
        return cover


def check_text(value: str, where: str, limit: int, lines: bool = False) -> None:
    """Refuse text that a report could not print: empty, too long, or with control characters.

    ``lines`` allows empty text and line breaks.
    """
    printable = value.replace("\n", "").replace("\t", "") if lines else value
    if not printable.isprintable():
        raise InputError(where, value, "printable characters only")
    if len(value) > limit:
        raise InputError(where, f"{len(value)} characters", f"at most {limit} characters")
    if not lines and not value.strip():
        raise InputError(where, value, "some text")


def _signed_area(outline: np.ndarray) -> float:
    """Positive for counter-clockwise as seen [m^2]."""
    x, z = outline.T
    return float(0.5 * np.sum(x * np.roll(z, -1) - np.roll(x, -1) * z))


def _check_outline(outline: np.ndarray) -> None:
    if outline.ndim != 2 or outline.shape[1] != 2:
        raise InputError("outline", f"shape {outline.shape}", "a list of [x, z] vertices")
    count = len(outline)
    if not MIN_VERTICES <= count <= MAX_VERTICES:
        expected = f"{MIN_VERTICES} to {MAX_VERTICES} vertices"
        raise InputError("outline", f"{count} vertices", expected)
    for k, (x, z) in enumerate(outline.tolist()):
        where = f"outline[{k}]"
        if not np.isfinite([x, z]).all():
            raise InputError(where, [x, z], "finite numbers")
        if z < BELOW_TABLE:
            raise InputError(where, [x, z], "z >= 0: nothing is below the table")
        if abs(x) > MAX_X + SLACK or z > MAX_Z + SLACK:
            expected = f"|x| <= {MAX_X} and z <= {MAX_Z} m, what the camera can see"
            raise InputError(where, [x, z], expected)
        if np.array_equal(outline[k], outline[k - 1]):
            hint = "; the outline closes by itself" if k == 0 else ""
            raise InputError(where, [x, z], f"a vertex other than the one before it{hint}")
    _check_shape(outline)


def _check_shape(outline: np.ndarray) -> None:
    if np.linalg.matrix_rank(outline - outline[0], tol=1e-12) < 2:
        raise InputError("outline", "zero area", "vertices that are not all on one line")
    polygon = shapely.Polygon(outline)
    if not polygon.is_valid:
        reason = shapely.is_valid_reason(polygon)
        raise InputError("outline", reason, "an outline that neither crosses nor touches itself")
    if polygon.area < MIN_AREA - SLACK:
        raise InputError(
            "outline", f"{polygon.area:.6f} m^2", f"at least one block face, {MIN_AREA:.4f} m^2"
        )


def _check_names(names: Sequence[str]) -> None:
    for k, name in enumerate(names):
        if name in names[:k]:
            raise InputError(f"elevations[{k}].name", name, "a name no other elevation has")


def _check_width(elevations: Sequence[Elevation]) -> None:
    """With three or four elevations, all stand on one 3x3 footprint."""
    if len(elevations) < 3:
        return
    for k, elevation in enumerate(elevations):
        widest = elevation.outline[np.argmax(np.abs(elevation.outline[:, 0]))]
        if abs(widest[0]) > MAX_X_FOOTPRINT + SLACK:
            raise InputError(
                f"elevations[{k}].outline",
                widest.tolist(),
                f"|x| <= {MAX_X_FOOTPRINT} m, because {len(elevations)} elevations are the faces "
                "of a footprint of 3x3 blocks; wider designs take 1 or 2 elevations",
            )


def _check_masks(design: Design) -> None:
    masks = design.masks()
    for k, mask in enumerate(masks):
        if not mask.any():
            expected = "an outline the camera can see (one pixel is 7.8 mm)"
            raise InputError(f"elevations[{k}].outline", "no pixel", expected)
    total = count_pixels(masks)
    if total < MIN_MASK_PIXELS:
        raise InputError(
            "elevations",
            f"{total} pixels in total",
            f"at least {MIN_MASK_PIXELS} (a block face is about 41)",
        )
    share = count_pixels(masks & design.first_cover()) / total
    if share > MAX_INITIAL_COVER:
        raise InputError(
            "elevations",
            f"a design of which the first block fills {100 * share:.0f} %",
            f"at most {100 * MAX_INITIAL_COVER:.0f} %, so that something is left to build",
        )


FORMAT, VERSION = "learn2assemble-design", 1
_KEYS = (
    "format", "version", "name", "description", "units", "elevations", "blocks", "first_block",
    "success_threshold", "supports", "kit",
)  # fmt: skip
_REQUIRED = ("format", "version", "name", "elevations")


def design_from(value: Any, source: str) -> Design:
    """The design in parsed JSON ``value``; ``source`` begins every message.

    Raises:
        InputError: naming the JSON path, for example ``house.json: elevations[1].outline[3]``.
    """
    try:
        return _design(value, source)
    except RecursionError:
        raise too_deep(source) from None


def _design(value: Any, source: str) -> Design:
    root = read_head(value, source, FORMAT, VERSION, _KEYS, _REQUIRED)
    sides = sequence(root["elevations"], f"{source}: elevations", "1 to 4 elevations")
    if not 1 <= len(sides) <= len(DEFAULT_NAMES):
        raise InputError(f"{source}: elevations", f"{len(sides)} of them", "1 to 4 elevations")
    elevations = tuple(_elevation(side, k, source) for k, side in enumerate(sides))
    blocks = root.get("blocks")
    fields: dict[str, Any] = {
        "name": text(root["name"], f"{source}: name"),
        "elevations": elevations,
        "num_blocks": None if "blocks" not in root else integer(blocks, f"{source}: blocks"),
        "description": text(root.get("description", ""), f"{source}: description"),
    }
    if "first_block" in root:
        fields["first_elevation"] = _first_block(root["first_block"], source)
    if "success_threshold" in root:
        where = f"{source}: success_threshold"
        fields["success_threshold"] = number(root["success_threshold"], where)
    if "kit" in root:
        fields["kit"] = text(root["kit"], f"{source}: kit")
    if "supports" in root:
        if not isinstance(root["supports"], bool):
            raise InputError(f"{source}: supports", root["supports"], "true or false")
        fields["supports"] = root["supports"]
    try:
        return Design(**fields)
    except InputError as error:
        raise InputError(f"{source}: {error.what}", error.got, error.expected) from None


def _first_block(value: Any, source: str) -> int:
    first = mapping(value, f"{source}: first_block")
    check_keys(first, source, "first_block", ("elevation",), ("elevation",))
    return integer(first["elevation"], f"{source}: first_block.elevation")


def _elevation(value: Any, index: int, source: str) -> Elevation:
    path = f"elevations[{index}]"
    side = mapping(value, f"{source}: {path}")
    check_keys(side, source, path, ("name", "outline"), ("outline",))
    name = text(side.get("name", DEFAULT_NAMES[index]), f"{source}: {path}.name")
    where = f"{source}: {path}.outline"
    vertices = sequence(side["outline"], where, "a list of [x, z] vertices")
    outline = [_vertex(vertex, f"{where}[{k}]") for k, vertex in enumerate(vertices)]
    try:
        return Elevation(name, np.array(outline, np.float64).reshape(-1, 2))
    except InputError as error:
        raise InputError(f"{source}: {path}.{error.what}", error.got, error.expected) from None


def _vertex(value: Any, where: str) -> list[float]:
    pair = sequence(value, where, "[x, z], two numbers in metres")
    if len(pair) != 2:
        raise InputError(where, value, "[x, z], two numbers in metres")
    return [number(value, where) for value in pair]
