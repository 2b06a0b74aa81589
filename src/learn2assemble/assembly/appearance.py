"""How blocks look on pages, pictures, cards and in other programs: names, colours, outlines."""

from __future__ import annotations

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from learn2assemble.assembly.blocks import Assembly, Block, to_manifold

PALETTE = (
    "#c96f4a", "#ecca90", "#8fae7a", "#b98bb0", "#d8a13f", "#7f9fa3", "#a88468", "#c7cf8b",
    "#d99a94", "#8d8fb5", "#6f9a86", "#b7b2a6",
)  # fmt: skip
"""Colours of kinds, in the order in which they first appear."""
COLOURS = {"current": "#63b0f2", "support": "#aeb9c4", "prop": "#d66fb5", "soft": "#5a636d"}
"""Colours of the page's style sheet, by its names."""
_LEVEL = 1e-6
"""Sine of the angle below which a face counts as level or upright, and lengths that count as
nothing, as a share of the block's size."""


def rgb(colour: str) -> np.ndarray:
    """float32[3], 0 to 255: of ``#rrggbb``, or of a name in :data:`COLOURS`."""
    return np.array(list(bytes.fromhex(COLOURS.get(colour, colour)[1:])), np.float32)


def kinds_and_colours(assembly: Assembly) -> list[tuple[str, str]]:
    """What every block is called, and its colour: ``#rrggbb``, or a name in :data:`COLOURS`."""
    unnamed = {size_words(block) for block in assembly.blocks if not block.kind}
    found, of_kind = [], {}
    for block in assembly.blocks:
        kind = block.kind or (size_words(block) if len(unnamed) <= len(PALETTE) else "block")
        colour = "prop" if block.prop else "support" if block.support else ""
        if not colour and block.colour:
            colour = "#{:02x}{:02x}{:02x}".format(*block.colour)
        colour = colour or of_kind.setdefault(kind, PALETTE[len(of_kind) % len(PALETTE)])
        found.append((kind, colour))
    return found


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
    mesh = to_manifold(block).to_mesh64()
    corners = np.asarray(mesh.vert_properties)[np.asarray(mesh.tri_verts), :3]
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
    found, area = [], shapely.Polygon()
    for low, high in pairwise(heights.tolist()):
        here = level & (np.abs(height - low) <= grid)
        area = shapely.difference(
            area, shapely.union_all(flat[here & up], grid_size=grid), grid_size=grid
        )
        area = shapely.union_all([area, *flat[here & ~up]], grid_size=grid)
        found.append(Section(low, high, area.simplify(grid)))
    return found
