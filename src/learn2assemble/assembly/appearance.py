"""How blocks look on pages, pictures, cards and in other programs: names, colours, outlines."""

from __future__ import annotations

from collections.abc import Iterator
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
    """The size of each block, laid down where it leans; None where they are too many."""
    known: dict[bytes, str] = {}
    examples: list[tuple[np.ndarray, str]] = []
    found = list[str]()
    for block in blocks:
        key = ((block.vertices - block.vertices[0]) / 1e-6).round().tobytes()
        if key not in known:
            apart = spread(block.vertices)
            same = (
                words
                for other, words in examples
                if other.shape == apart.shape and np.abs(other - apart).max() <= _ALIKE
            )
            words = next(same, "")
            if not words:
                words = millimetres(*np.ptp(block.vertices @ laid_down(block).T, axis=0))
                examples.append((apart, words))
            if len({words for _, words in examples}) > len(PALETTE):
                return None
            known[key] = words
        found.append(known[key])
    return iter(found)


def spread(corners: np.ndarray) -> np.ndarray:
    """float64[n]: distances that a turn does not change, sorted: of all corners from one another,
    of many corners only from their mean [m]."""
    if len(corners) > _MANY:
        return np.sort(np.linalg.norm(corners - corners.mean(0), axis=1))
    return np.sort(np.linalg.norm(corners[:, None] - corners, axis=-1), None)


def laid_down(block: Block) -> np.ndarray:
    """float64[3, 3]: turns a block onto its largest face, its longest edge along x.

    A block whose edges run along the axes keeps what is up, with its longer side along x; any other
    that has a level face below is left as it is, and so is a post with a cut top.
    """
    if is_square(block):
        x, y, _ = np.ptp(block.vertices, axis=0)
        quarter = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
        return quarter if y > x + 1e-6 else np.eye(3)
    if is_prism(block) or block.kind == POST:
        return np.eye(3)
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
