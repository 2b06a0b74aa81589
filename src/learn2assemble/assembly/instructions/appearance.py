"""How blocks look on pages, pictures, cards and in other programs: names, colours, outlines."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from learn2assemble.assembly.blocks import Assembly, Block, fan_triangles
from learn2assemble.assembly.cuts import POST
from learn2assemble.assembly.parts import to_manifold

PALETTE = (
    "#c96f4a",
    "#ecca90",
    "#8fae7a",
    "#b98bb0",
    "#d8a13f",
    "#7f9fa3",
    "#a88468",
    "#c7cf8b",
    "#d99a94",
    "#8d8fb5",
    "#6f9a86",
    "#b7b2a6",
)
"""Colours of kinds, in the order in which they first appear."""
COLOURS = {
    "current": "#63b0f2",
    "support": "#aeb9c4",
    "prop": "#d66fb5",
    "held": "#7d4fd6",
    "soft": "#5a636d",
}
"""Colours of the page's style sheet, by its names."""
_ALIKE = 1e-4
"""Blocks whose corners are apart by distances that differ by less are of one kind [m]."""
_MANY = 200
"""Corners of a block whose distances from one another are too many."""
_LEVEL = 1e-6
"""Sine of the angle below which a face counts as level or upright, and lengths that count as
nothing, as a share of the block's size."""
_STEADY = 1e-5
"""How far out of level the face may be on which a block stands, in extents of the block: less than
the hundredth of a degree to which turns are told."""
_ODD = 100.0
"""A block that is so many times longer than the median, or more, may be in another unit."""
_HUGE = 10.0
"""So may blocks that are all longer than this [m]."""
_MOST_LOOKED_AT = 240
"""Blocks of so many different shapes have more sizes than there are colours."""


def rgb(colour: str) -> np.ndarray:
    """float32[3], 0 to 255: of ``#rrggbb``, or of a name in :data:`COLOURS`."""
    return np.array(list(bytes.fromhex(COLOURS.get(colour, colour)[1:])), np.float32)


def colour_words(block: Block) -> str:
    """The colour a block is to have as ``#rrggbb``; empty where the design does not say."""
    return "#{:02x}{:02x}{:02x}".format(*block.colour) if block.colour and not block.prop else ""


def kinds_and_colours(assembly: Assembly) -> list[tuple[str, str]]:
    """What every block is called, and its colour: ``#rrggbb``, or a name in :data:`COLOURS`.

    Blocks without a kind are called by their size, which is one for all that are alike, however
    they are turned; of more sizes than there are colours all are called ``block``.
    """
    sizes = _sizes([block for block in assembly.blocks if not block.kind])
    found, of_kind = list[tuple[str, str]](), dict[str, str]()
    for block in assembly.blocks:
        kind = block.kind or (next(sizes) if sizes else "block")
        colour = "prop" if block.prop else "support" if block.support else colour_words(block)
        colour = colour or of_kind.setdefault(kind, PALETTE[len(of_kind) % len(PALETTE)])
        found.append((kind, colour))
    return found


def _sizes(blocks: list[Block]) -> Iterator[str] | None:
    """The size of each block as its shape is drawn; None where they are too many."""
    known: dict[bytes, int] = {}
    apart_of = list[np.ndarray]()
    members = list[list[int]]()
    shape_of = list[int]()
    for number, block in enumerate(blocks):
        key = ((block.vertices - block.vertices[0]) / 1e-6).round().tobytes()
        if key not in known:
            apart = spread(block.vertices)
            same = (
                k
                for k, other in enumerate(apart_of)
                if other.shape == apart.shape and np.abs(other - apart).max() <= _ALIKE
            )
            known[key] = next(same, len(apart_of))
            if known[key] == len(apart_of):
                apart_of.append(apart)
                members.append([])
            if len(apart_of) > _MOST_LOOKED_AT:
                return None
        shape_of.append(known[key])
        members[known[key]].append(number)
    words = list[str]()
    for numbers in members:
        k, turning = drawn_as([blocks[n] for n in numbers])
        words.append(millimetres(*np.ptp(blocks[numbers[k]].vertices @ turning.T, axis=0)))
    return iter([words[k] for k in shape_of]) if len(set(words)) <= len(PALETTE) else None


def spread(corners: np.ndarray) -> np.ndarray:
    """float64[n]: distances that a turn does not change, sorted: of all corners from one another,
    of many corners only from their mean [m]."""
    if len(corners) > _MANY:
        return np.sort(np.linalg.norm(corners - corners.mean(0), axis=1))
    return np.sort(np.linalg.norm(corners[:, None] - corners, axis=-1), None)


def drawn_as(blocks: Sequence[Block]) -> tuple[int, np.ndarray]:
    """How the shape of blocks that are alike is drawn.

    It is drawn as the first of them stands that has level faces below and above, or that is a post;
    where at least half of them have a level face below or above, as the first of those. Otherwise
    none shows how it stands, as of the wedges of an arch, and the first lies on its largest face.
    Its longest edge goes along x.

    Args:
        blocks: in the order in which they are given.

    Returns:
        Which of the blocks is drawn, and the rotation that turns it to be so, float64[3, 3].
    """
    known: dict[tuple[object, bytes], int] = {}
    found = list[int]()
    for block in blocks:
        relative = ((block.vertices - block.vertices[0]) / 1e-7).round()
        key = block.faces, relative.tobytes()
        if key not in known:
            known[key] = _level_ends(block)
        found.append(known[key])
        if known[key] == 2:
            return len(found) - 1, _along_x(block)
    if 2 * sum(found) >= len(found):
        first = found.index(1)
        return first, _along_x(blocks[first])
    return 0, _laid_down(blocks[0])


def _level_ends(block: Block) -> int:
    """How many of the lower and upper ends of a block are a level face; 2 of a post, and of a block
    whose edges run along the axes."""
    if block.kind == POST or is_square(block):
        return 2
    z = block.vertices[:, 2]
    near = _STEADY * block.extent
    low, high = z <= z.min() + near, z >= z.max() - near
    return sum(any(end[list(face)].all() for face in block.faces) for end in (low, high))


def _along_x(block: Block) -> np.ndarray:
    """float64[3, 3]: turns a block about z until its longest level edge goes along x, by no more
    than is needed; of a block whose edges run along the axes, its longer side.

    A block with more than two longest edges, such as a round column, stays as it is.
    """
    quarter = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    if is_square(block):
        x, y, _ = np.ptp(block.vertices, axis=0)
        return quarter if y > x + 1e-6 else np.eye(3)
    edges = _sharp_edges(block)
    edges = edges[np.abs(edges[:, 2]) <= _STEADY * block.extent, :2]
    if not len(edges):
        return np.eye(3)
    length = np.linalg.norm(edges, axis=1)
    edges = edges[length >= length.max() - _ALIKE]
    # Of a line, so that half a turn is none.
    angles = np.sort(np.arctan2(edges[:, 1], edges[:, 0]) % np.pi)
    ends = np.concatenate([angles, angles[:1] + np.pi])
    if (np.diff(ends) > 1e-3).sum() > 2:
        return np.eye(3)
    angles = np.where(angles > np.pi / 2 + 1e-6, angles - np.pi, angles)
    turn = -float(angles[np.argmin(np.abs(angles).round(6))])
    if abs(turn) <= 1e-6:
        return np.eye(3)
    if abs(abs(turn) - np.pi / 2) <= 1e-6:
        return quarter
    cos, sin = np.cos(turn), np.sin(turn)
    return np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])


def _sharp_edges(block: Block) -> np.ndarray:
    """float64[E, 3]: from end to end of every edge but those between faces in one plane [m]."""
    normal_of: dict[tuple[int, int], np.ndarray] = {}
    found = list[np.ndarray]()
    for face in block.faces:
        corners = block.vertices[list(face)]
        normal = np.cross(corners - corners[0], np.roll(corners, -1, 0) - corners[0]).sum(0)
        normal = normal / max(float(np.linalg.norm(normal)), 1e-300)
        for a, b in zip(face, (*face[1:], face[0]), strict=True):
            other = normal_of.pop((b, a), None)
            if other is None:
                normal_of[a, b] = normal
            elif other @ normal < 1 - 1e-9:
                found.append(block.vertices[b] - block.vertices[a])
    return np.array(found).reshape(-1, 3)


def _laid_down(block: Block) -> np.ndarray:
    """float64[3, 3]: turns a block onto its largest face, the longest edge of that along x."""
    normals = list[np.ndarray]()
    for face in block.faces:
        corners = block.vertices[list(face)]
        normals.append(np.cross(corners - corners[0], np.roll(corners, -1, 0) - corners[0]).sum(0))
    largest = int(np.argmax([np.linalg.norm(n) for n in normals]))
    down = normals[largest] / np.linalg.norm(normals[largest])
    corners = block.vertices[list(block.faces[largest])]
    edges = np.roll(corners, -1, 0) - corners
    edge = edges[int(np.argmax(np.linalg.norm(edges, axis=1)))]
    edge = edge - (edge @ down) * down
    along = edge / np.linalg.norm(edge)
    return np.stack([along, np.cross(-down, along), -down])


def size_words(block: Block) -> str:
    """Bounding box, e.g. ``100 × 50 × 50 mm``."""
    return millimetres(*np.ptp(block.vertices, axis=0))


def millimetres(*lengths: float) -> str:
    """Lengths [m], with four digits below a metre and whole from there on."""
    words = (f"{1000 * v:.4g}" if abs(v) < 1 else f"{1000 * v:.0f}" for v in lengths)
    return " × ".join(words) + " mm"


def unit_doubt(assembly: Assembly) -> str:
    """A question in one line where the sizes of blocks look as if their unit were wrong, such as
    ``blocks from 100 mm to 108.1 m (b3) long: is the unit right?``; else nothing."""
    blocks = [block for block in assembly.blocks if not (block.prop or block.support)]
    if not blocks:
        return ""
    longest = [block.extent for block in blocks]
    low, high = min(longest), max(longest)
    if low <= _HUGE and high <= _ODD * float(np.median(longest)):
        return ""
    named = blocks[int(np.argmax(longest))].id
    which = f" ({named})" if low <= _HUGE else ""
    return f"blocks from {_length(low)} to {_length(high)}{which} long: is the unit right?"


def unbuilt_words(assembly: Assembly) -> str:
    """How many blocks stand in the end of how many that are wanted, and which are not built, as
    those of a plan that is incomplete or refused; empty where all are."""
    left = [id_ for id_ in assembly.not_built if not assembly.block(id_).prop]
    if not left:
        return ""
    names = ", ".join(left[:4]) + (f" and {len(left) - 4} more" if left[4:] else "")
    stand = len(assembly.finished.blocks)
    verb = "is" if len(left) == 1 else "are"
    return f"{stand} of {stand + len(left)}; {names} {verb} not built"


def _length(value: float) -> str:
    return f"{value:.4g} m" if value >= 1 else millimetres(value)


class Section(NamedTuple):
    """What a block covers seen from above, between two heights."""

    bottom: float
    """[m, world]"""
    top: float
    area: Any
    """shapely area [m, world]."""

    @property
    def rings(self) -> list[list[tuple[float, float]]]:
        """Its outlines and those of its holes, not closed [m, world]."""
        polygons = getattr(self.area, "geoms", [self.area])
        rings = [ring for one in polygons for ring in (one.exterior, *one.interiors)]
        return [[(x, y) for x, y, *_ in ring.coords[:-1]] for ring in rings]


def sections(block: Block) -> list[Section]:
    """The sections of a block, from below: between the heights of its level faces where all others
    are upright, so that they are exact; otherwise one for its whole height, what it covers there.
    """
    import shapely

    bottom, top = float(block.vertices[:, 2].min()), float(block.vertices[:, 2].max())
    if block.is_convex:
        return [Section(bottom, top, shapely.MultiPoint(block.vertices[:, :2]).convex_hull)]
    mesh: Any = to_manifold(block).to_mesh64()
    corners: np.ndarray = np.asarray(mesh.vert_properties)[np.asarray(mesh.tri_verts), :3]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1)
    up, level = normal[:, 2] > _LEVEL * length, np.abs(normal[:, 2]) > (1 - _LEVEL) * length
    flat = np.asarray(shapely.polygons(corners[:, :, :2]))
    # A grid closes the seams between triangles.
    grid = _LEVEL * float(np.ptp(block.vertices, axis=0).max())
    upright = np.abs(normal[:, 2]) <= _LEVEL * length
    if not (level | upright).all():
        return [Section(bottom, top, shapely.union_all(flat[up], grid_size=grid).simplify(grid))]
    height = corners[:, :, 2].mean(1)
    heights = np.sort(height[level])
    heights = heights[np.concatenate([[True], np.diff(heights) > grid])]
    found, area = list[Section](), shapely.Polygon()
    for low, high in pairwise(heights.tolist()):
        here = level & (np.abs(height - low) <= grid)
        area = shapely.difference(
            area, shapely.union_all(flat[here & up], grid_size=grid), grid_size=grid
        )
        area = shapely.union_all([area, *flat[here & ~up]], grid_size=grid)
        found.append(Section(low, high, area.simplify(grid)))
    return found


def joint_width(assembly: Assembly) -> float:
    """Width of the vertical joints of blocks on a lattice [m]; 0 where they have none.

    It is the smallest distance of two sides that face one another; where none do, what every block
    lacks to whole half millimetres.
    """
    blocks = [b for b in assembly.blocks if not b.support and b.kind != POST]
    upright = all(is_prism(b) for b in blocks if len(b.vertices) == 8)
    if not upright or any(not is_square(b) for b in blocks):
        return 0.0
    sizes = np.concatenate([np.ptp(b.vertices[:, :2], axis=0) for b in blocks])
    gaps: list[float] = []
    for axis in (0, 1):
        low = np.unique(np.round([b.vertices[:, axis].min() for b in blocks], 7))
        high = np.unique(np.round([b.vertices[:, axis].max() for b in blocks], 7))
        before = np.searchsorted(high, low + 1e-7, side="left")
        near = low[before > 0] - high[before[before > 0] - 1]
        gaps += near[(near > 1e-6) & (near < sizes.min() / 4)].tolist()
    if gaps:
        return float(min(gaps))
    lack = np.ceil(sizes / 5e-4 - 1e-6) * 5e-4 - sizes
    return float(lack.mean()) if np.ptp(lack) < 1e-6 and lack.mean() > 1e-6 else 0.0


def is_square(block: Block) -> bool:
    """Whether every edge runs along x, y or z."""
    starts = np.array([k for face in block.faces for k in face])
    ends = np.array([k for face in block.faces for k in (*face[1:], face[0])])
    along = np.abs(block.vertices[starts] - block.vertices[ends])
    return bool((np.sort(along, axis=1)[:, 1] <= 1e-7).all())


def has_leaning_face(block: Block) -> bool:
    """Whether a face is neither level nor upright."""
    corners = fan_triangles(block.vertices, block.faces)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1)
    sloping = np.abs(normal[:, 2]) > _LEVEL * length
    return bool((sloping & (np.hypot(normal[:, 0], normal[:, 1]) > _LEVEL * length)).any())


def is_prism(block: Block) -> bool:
    """Whether it has a level lower and upper face and upright sides."""
    z = block.vertices[:, 2]
    size = float(np.ptp(block.vertices, axis=0).max())
    low, high = np.abs(z - z.min()) <= 1e-6 * size, np.abs(z - z.max()) <= 1e-6 * size
    if not (low | high).all():
        return False
    below, above = block.vertices[low, :2], block.vertices[high, :2]
    below, above = (np.unique(np.round(p / (1e-5 * size)), axis=0) for p in (below, above))
    return below.shape == above.shape and bool(np.abs(below - above).max() <= 1)
