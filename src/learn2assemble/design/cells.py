"""A design as cells to fill and cells to leave empty, read from whatever file people have.

``docs/design_files.md`` lists the kinds of files and their options.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from learn2assemble.assembly.appearance import millimetres
from learn2assemble.assembly.bricks.files import is_of_bricks
from learn2assemble.design import drawings, solids
from learn2assemble.design.drawings import SIDES, Contours, Drawing
from learn2assemble.design.dxf import read_dxf
from learn2assemble.design.holes import in_words
from learn2assemble.design.lattice import HALF, MAX_CELLS, fit, shares
from learn2assemble.design.pictures import LOSSY, near_colours, read_picture
from learn2assemble.design.reading import (
    ARRAY,
    Extent,
    Lengths,
    Reading,
    check_cells,
    check_length,
)
from learn2assemble.design.solids import Solid, Voxels
from learn2assemble.design.svg.walk import read_svg
from learn2assemble.errors import InputError, Remedy, check_fields, is_number
from learn2assemble.files import as_path, read_bytes

if TYPE_CHECKING:
    from learn2assemble.assembly.blocks import Assembly

MAX_FILE = 64_000_000
"""Largest file [bytes]; most kinds have a smaller limit of their own."""


@dataclass(frozen=True, eq=False)
class CellDesign:
    """What is to be built.

    Args:
        name: one line.
        wanted: ``bool[X, Y, Z]``, cells to fill; all others stay empty. Cell (i, j, k) is centred
            at ``((i + 0.5 - X/2) dx, (j + 0.5 - Y/2) dy, (k + 0.5) dz)``; the table is z = 0.
        cell: (dx, dy, dz) [m].
        colours: ``uint8[X, Y, Z, 3]``, or None.
        volume_error: (volume of the cells - volume drawn) / volume drawn.
        iou: volume of the intersection of cells and drawing by that of their union; None where
            cells were given as such.
        source: the file, as messages call it.
        kit: the kit that caller or file name.
        blocks: how many blocks there are, props included; None where the file does not say.
        surface: ``float64[N, 3, 3]``, triangles around what was drawn, in cells from the lower
            corner of cell (0, 0, 0); None where cells were given as such.
        note: what was done to the file to read it, in one line; empty where nothing was.
        not_read: what is visible in the file and is not read, in one line; None where nothing is.
    """

    name: str
    wanted: np.ndarray
    cell: Lengths
    colours: np.ndarray | None = None
    volume_error: float = 0.0
    iou: float | None = None
    source: str = "design"
    kit: str | None = None
    blocks: int | None = None
    surface: np.ndarray | None = None
    note: str = ""
    not_read: str | None = None

    def __post_init__(self) -> None:
        cells, edges = np.asarray(self.wanted), np.ravel(self.cell)
        check_fields(
            self,
            ("wanted", cells.ndim == 3 and cells.dtype == bool, "bool[X, Y, Z]"),
            (
                "cell",
                len(edges) == 3 and all(is_number(e, 1e-9) for e in edges),
                "three lengths [m]",
            ),
        )
        for array in (self.wanted, self.colours, self.surface):
            if array is not None:
                array.setflags(write=False)

    @property
    def shades(self) -> np.ndarray | None:
        """``int64[X, Y, Z]``, equal where cells have one colour, near colours as one; None where
        all cells have."""
        if self.colours is None:
            return None
        label = np.zeros(self.wanted.shape, np.int64)
        label[self.wanted] = near_colours(self.colours[self.wanted])
        return label if np.ptp(label[self.wanted]) else None


def read_design(design: str | Path | np.ndarray, **reading: Any) -> CellDesign | Assembly:
    """The design in a file, whose kind is found by content, or in an array of cells.

    Args:
        design: the file, or cells as ``bool[X, Y, Z]``; numbers that are all 0 or 1 will do.
        reading: what the file does not say: fields of :class:`~.reading.Reading` such as ``unit``,
            ``cell`` and ``cells_wide``.

    Returns:
        The cells; an :class:`~learn2assemble.assembly.blocks.Assembly` where the file gives
        blocks (our assembly JSON, COMPAS).

    Raises:
        InputError: one line, for everything that cannot be used or would float.
        MissingExtraError: for 3DM without rhino3dm.
    """
    given = Reading.of(reading)
    if isinstance(design, np.ndarray):
        given.check(ARRAY)
        voxels = solids.voxels_of(design, given.colours, ARRAY)
        return _from_voxels(voxels, _Origin(given, ARRAY, ARRAY, given.kit))
    path = as_path(design, "design")
    content, source = read_bytes(path, "design file", MAX_FILE)
    kind = kind_of(content, source)
    if kind == "assembly":
        from learn2assemble.assembly.files import read_assembly

        return read_assembly(path, kit=given.kit if is_of_bricks(content) else None)
    given.check(kind)
    origin = _Origin(given, path.stem or "design", source, given.kit)
    if kind == "json":
        drawing = drawings.read_elevations(content, source)
        return _from_drawing(drawing, replace(origin, name=drawing.name or origin.name))
    if kind in ("svg", "dxf"):
        drawing = (read_svg if kind == "svg" else read_dxf)(content, source)
        return replace(_from_drawing(drawing, origin), not_read=drawing.not_read)
    if kind in LOSSY:
        return _from_picture(content, kind, origin)
    if kind in ("npy", "npz"):
        reader = solids.read_npy if kind == "npy" else solids.read_npz
        return _from_voxels(reader(content, source, MAX_CELLS), origin)
    return _from_solid(solids.read_mesh(content, kind, source, bool(given.repair)), origin)


@dataclass(frozen=True)
class _Origin:
    """Where a design comes from, and how it is read."""

    given: Reading
    name: str
    source: str
    kit: str | None
    remedies: tuple[Remedy, ...] = ()
    """What would help where nothing of it is as large as a cell."""
    note: str = ""
    blocks: int | None = None


def kind_of(content: bytes, source: str) -> str:
    """The kind of a file: a key of the table of options, or ``"assembly"``.

    Raises:
        InputError: for content of no known kind.
    """
    for magic, kind in (
        (b"\x89PNG\r\n\x1a\n", "png"),
        (b"\x93NUMPY", "npy"),
        (b"PK\x03\x04", "npz"),
        (b"glTF", "glb"),
        (b"3D Geometry File Format", "3dm"),
        (b"ply\n", "ply"),
        (b"ply\r", "ply"),
        (b"OFF", "off"),
        (b"\xff\xd8\xff", "jpeg"),
        (b"AutoCAD Binary DXF", "dxf"),
    ):
        if content.startswith(magic):
            return kind
    if content[:4] == b"RIFF" and content[8:12] == b"WEBP":
        return "webp"
    facets = int.from_bytes(content[80:84], "little")
    if len(content) >= 84 and len(content) == 84 + 50 * facets:
        return "stl"
    start = content[:4096].removeprefix(b"\xef\xbb\xbf").lstrip()
    if start[:1] in (b"{", b"["):
        ours = re.search(rb'"format"\s*:\s*"learn2assemble-assembly"', content)
        compas = re.search(rb'"dtype"\s*:\s*"compas', content)
        return "assembly" if ours or compas or is_of_bricks(content) else "json"
    if is_of_bricks(content):
        return "assembly"
    if start[:1] == b"<" and b"<svg" in content:
        return "svg"
    if re.match(rb"(999[^\n]*\n[^\n]*\n\s*)*0[ \t]*\r?\n\s*SECTION", start):
        return "dxf"
    if start.startswith(b"solid") and re.search(rb"\bfacet\b", content):
        return "stl"
    if re.search(rb"^v\s+[-+.\d]", content, re.MULTILINE) and b"\0" not in start:
        return "obj"
    got = f"{len(content)} bytes that begin with {content[:12]!r}" if content else "an empty file"
    if content.startswith(b"\x1f\x8b"):
        got = "a file packed with gzip"
    elif Path(source).suffix.casefold() == ".stl":
        got = f"{got}; its header says {facets} triangles"
    raise InputError(
        source,
        got,
        "a whole file of elevation JSON, SVG, DXF, PNG, JPEG, WebP, STL, OBJ, PLY, GLB, OFF, 3DM, "
        "NPY, NPZ, LDraw, brick text or assembly JSON",
    )


# ---------------------------------------------------------------- from each kind to cells


def _from_drawing(drawing: Drawing, origin: _Origin) -> CellDesign:
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
    for axis, (one, other) in enumerate((SIDES[:2], SIDES[2:])):
        names = [side for side in (one, other) if side in boxes]

        def seen(contours: Contours, side: str) -> Contours:
            """On the lattice. From the right and from the front, x of the viewer runs along y and
            x; from the other two sides it runs against them."""
            turn = -1 if side == other else 1  # noqa: B023
            unit = (turn * cell[axis], cell[2])  # noqa: B023
            return [((c - origins[side]) * scale / unit)[::turn] for c in contours]

        walls = [
            np.concatenate([_prism(contour, k) for contour in seen(drawing.sides[side], side)])
            for k, side in enumerate(names)
        ]
        if walls:
            triangles = np.concatenate(walls)
            points_ = triangles.reshape(-1, 3)
            ends = np.abs(points_[:, 0]).max() * 2 if drawing.placed else np.ptp(points_[:, 0])
            edges = np.array([cell[axis], cell[2]])
            drawn = np.array([ends, points_[:, 2].max()]) * edges / scale
            Extent(drawn, edges, source, drawing.placed).check(scale)
            share, first = fit(triangles, (0,))
            tint = np.zeros(share.shape, np.int64)
            for k, side in enumerate(names):
                paints = [
                    (seen(contours, side), colour)
                    for contours, colour in drawing.paints.get(side, ())
                ]
                tint[:, k] = _tints(paints, palette, first, (len(share), share.shape[2]))
            whole = [
                np.concatenate([wall, _caps(seen(drawing.sides[side], side), k)])
                for k, (side, wall) in enumerate(zip(names, walls, strict=True))
            ]
            pairs.append(_Walls(axis, names, np.stack([share, tint]), first, whole))
    least = 3 if drawing.placed and len(boxes) > 2 else 1
    share, tint, surface = _footprint(pairs, given.depth, cell, least, drawing.placed)
    colours = None
    if tint.any():
        common = np.bincount(tint[(tint > 0) & (share >= HALF)], minlength=2)
        colours = np.array([(0, 0, 0), *palette], np.uint8)[
            np.where(tint > 0, tint, common.argmax())
        ]
    thick = given.depth / (cell[1] * max(1, round(given.depth / cell[1]))) if given.depth else 1.0
    origin = replace(origin, kit=kit, remedies=extent.remedies(), blocks=drawing.blocks)
    return _design(
        share,
        origin,
        cell,
        thickness=thick,
        trim=not drawing.placed,
        colours=colours,
        surface=surface,
    )


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
    return _upright(contour, np.roll(contour, -1, axis=0), place)


def _caps(contours: Contours, place: int) -> np.ndarray:
    """The two sides of a wall between its contours (x, z), at y = place and place + 1."""
    from manifold3d import triangulate

    points = np.concatenate(contours)
    flat = points[np.asarray(triangulate(contours)).astype(np.int64).reshape(-1, 3)]
    return np.concatenate([np.insert(flat, 1, place + k, axis=2) for k in (0, 1)])


def _upright(start: np.ndarray, end: np.ndarray, place: int) -> np.ndarray:
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


def _from_picture(content: bytes, kind: str, origin: _Origin) -> CellDesign:
    given = origin.given
    cell = given.edges(given.kit)
    share, colours, outline = read_picture(
        content, kind, origin.source, given.cells_wide, MAX_CELLS, cell[0] / cell[2]
    )
    thick = max(1, round((given.depth or cell[1]) / cell[1]))
    shape = (len(share), thick, share.shape[1])
    share = np.broadcast_to(share[:, None, :], shape)
    colours = np.broadcast_to(colours[:, None], (*shape, 3))
    cell = _sized(given, cell, shape)
    surface = None
    if outline is not None:
        surface = _upright(outline[:, 0], outline[:, 1], 0) * (1, thick, 1)
    return _design(share, origin, cell, colours=colours, surface=surface)


def _from_voxels(voxels: Voxels, origin: _Origin) -> CellDesign:
    wanted, colours, given = voxels.wanted, voxels.colours, origin.given
    if given.up == "y":  # (x, y, z) -> (x, -z, y)
        wanted = wanted.transpose(0, 2, 1)[:, ::-1]
        colours = None if colours is None else colours.transpose(0, 2, 1, 3)[:, ::-1]
    cell = _sized(given, given.edges(given.kit, voxels.cell), wanted.shape)
    check_cells(wanted.shape, cell, origin.source)
    return _design(wanted, origin, cell, colours=colours, exact=True, trim=False)


def _sized(given: Reading, cell: Lengths, shape: Sequence[int]) -> Lengths:
    """The cell, made as large as ``size`` asks for."""
    if given.size is None:
        return cell
    if given.cell is not None:
        raise InputError("size", given.size, "either size or cell: the number of cells is fixed")
    factor = given.size / max(n * edge for n, edge in zip(shape, cell, strict=True))
    x, y, z = (check_length(edge * factor, "size") for edge in cell)
    return x, y, z


def _from_solid(solid: Solid, origin: _Origin) -> CellDesign:
    given, source = origin.given, origin.source
    cell = given.edges(given.kit)
    triangles = solid.triangles
    if (given.up or solid.up) == "y":
        triangles = triangles[:, :, [0, 2, 1]] * (1, -1, 1)
    points = triangles.reshape(-1, 3)
    extent = Extent(np.ptp(points, axis=0), np.array(cell), source)
    scale = extent.scale(given, solid.metres)
    extent.check(scale)
    lowest = float(points[:, 2].min()) * scale
    if lowest >= cell[2] / 2:
        _floating(lowest, cell, source)
    placed = (triangles - points.min(0)) * scale / cell
    share, first = fit(placed, (0, 1))
    if share.min() < -1e-3 or share.max() > 1 + 1e-3:
        got = "parts that overlap, or are inside out"
        raise InputError(source, got, "a mesh with one inside, all faces outward")
    note = ""
    if solid.holes:
        largest = millimetres(max(solid.holes) * scale)
        note = f"{in_words(len(solid.holes))} of the mesh closed, up to {largest} wide"
    origin = replace(origin, remedies=extent.remedies(), note=note)
    return _design(np.clip(share, 0, 1), origin, cell, surface=placed - first)


def _design(
    share: np.ndarray,
    origin: _Origin,
    cell: Lengths,
    *,
    colours: np.ndarray | None = None,
    thickness: float = 1.0,
    exact: bool = False,
    trim: bool = True,
    surface: np.ndarray | None = None,
) -> CellDesign:
    """Cells from shares of cells.

    Args:
        thickness: thickness drawn by that of the cells, for walls.
        exact: whether the shares are cells as such.
        trim: whether empty margins at the sides are left out; without it x = y = 0 stays.
        surface: triangles around what was drawn [cells].
    """
    source = origin.source
    wanted = np.asarray(share >= HALF)
    if not wanted.any():
        edges = " x ".join(f"{edge:g}" for edge in cell)
        raise InputError(
            source,
            f"a design of which no cell of {edges} m is half full",
            "something to build (a smaller cell, a larger size?)",
            *origin.remedies,
        )
    drawn, filled = float(share.sum()) * thickness, int(wanted.sum())
    common = float(share[wanted].sum()) * min(thickness, 1.0)
    if trim:
        window = tuple(
            slice(int(used[0]), int(used[-1]) + 1)
            for used in (np.flatnonzero(wanted.any((1, 2))), np.flatnonzero(wanted.any((0, 2))))
        )
        wanted, colours = wanted[window], None if colours is None else colours[window]
        if surface is not None:
            surface = surface - (window[0].start, window[1].start, 0)
    if not exact:
        high = int(np.flatnonzero(wanted.any((0, 1)))[-1]) + 1
        wanted, colours = wanted[:, :, :high], None if colours is None else colours[:, :, :high]
    check_cells(wanted.shape, cell, source)
    _check_carried(wanted, cell, source)
    error = 0.0 if exact else filled / drawn - 1
    iou = None if exact else common / (drawn + filled - common)
    wanted = np.ascontiguousarray(wanted)
    colours = None if colours is None else np.ascontiguousarray(colours)
    return CellDesign(
        origin.name,
        wanted,
        cell,
        colours,
        error,
        iou,
        source,
        origin.kit,
        origin.blocks,
        surface,
        origin.note,
    )


def _check_carried(wanted: np.ndarray, cell: Lengths, source: str) -> None:
    """Refuse cells that are joined to the table by no chain of cells with common faces."""
    from scipy.ndimage import label

    if not wanted[:, :, 0].any():
        _floating(float(np.flatnonzero(wanted.any((0, 1)))[0]) * cell[2], cell, source)
    part, _ = label(wanted)  # pyright: ignore[reportGeneralTypeIssues]
    rest = wanted & ~np.isin(part, part[:, :, 0])
    if rest.any():
        level = int(np.flatnonzero(rest.any((0, 1)))[0])
        _floating(level * cell[2], cell, source)


def _floating(height: float, cell: Lengths, source: str) -> None:
    level = round(height / cell[2])
    got = f"a part that floats: its lowest level is {level}, {height:.4g} m above the table"
    raise InputError(source, got, "every part to reach the table (level 0, z = 0)")
