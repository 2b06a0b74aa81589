"""What a person draws or gives, read: cells to fill, goals, or blocks.

``docs/design_files.md`` lists the kinds of files and their options.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, cast

import numpy as np

from learn2assemble.assembly.blocks import Assembly
from learn2assemble.assembly.instructions.appearance import millimetres
from learn2assemble.design import drawings, solids
from learn2assemble.design.cells import (
    CellDesign,
    NothingToFillError,
    Origin,
    design_of,
    floating,
)
from learn2assemble.design.dxf import read_dxf
from learn2assemble.design.elevations import from_drawing, upright
from learn2assemble.design.files import DesignFile, open_design
from learn2assemble.design.goals import Goals, parse_goals
from learn2assemble.design.holes import in_words
from learn2assemble.design.lattice import MAX_CELLS, fit
from learn2assemble.design.pictures import LOSSY, read_picture
from learn2assemble.design.reading import (
    ARRAY,
    FOLDER,
    Extent,
    Lengths,
    Reading,
    check_cells,
    check_length,
)
from learn2assemble.design.solids import Solid, Voxels
from learn2assemble.design.svg.walk import read_svg
from learn2assemble.errors import InputError, Remedy
from learn2assemble.files import UNITS

if TYPE_CHECKING:
    from learn2assemble.assembly.kit import Kit


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
    found = read_given(design, None, reading)
    if isinstance(found, Goals):
        raise InputError("design", found.source, "a design; load_goals and build read goals")
    if not isinstance(found, CellDesign | Assembly):
        raise InputError("design", found, "the path of a design file, or an array of cells")
    return found


def read_given(design: object, kit: Kit | None, reading: Mapping[str, Any]) -> object:
    """The design, goals or blocks in a file or an array; all else as it is.

    Args:
        kit: the one that is given, of which a cell is as large where nothing else is said.
        reading: how to read it.

    Raises:
        InputError: one line, also for a way of reading that means nothing here.
    """
    if isinstance(design, str | Path):
        design = open_design(design)
    if isinstance(design, DesignFile):
        return READERS[design.kind](design, kit, reading)
    if isinstance(design, np.ndarray):
        given = _reading(ARRAY, kit, reading)
        voxels = solids.voxels_of(cast("np.ndarray", design), given.colours, ARRAY)
        return _from_voxels(voxels, Origin(given, ARRAY, ARRAY, given.kit))
    _refuse(reading, "a design file or an array, which it tells how to read")
    return design


def _refuse(reading: Mapping[str, Any], expected: str, *but: str) -> None:
    """Refuse ways of reading that mean nothing here, ``but`` for those of these names."""
    given = {name: value for name, value in sorted(reading.items()) if name not in but}
    for name, value in given.items():
        raise InputError(name, str(value) if isinstance(value, Path) else value, expected)


def _reading(kind: str, kit: Kit | None, reading: Mapping[str, Any]) -> Reading:
    """How cells are read; they are those of a kit where nothing else is said."""
    given = Reading.of(reading if kit is None else {"cell": kit.cell, **reading})
    given.check(kind)
    return given


# ---------------------------------------------------------------- from each kind of file


def _goals(file: DesignFile, kit: Kit | None, reading: Mapping[str, Any]) -> Goals:
    _refuse(reading, "none; goals are read with cell alone", "cell")
    return parse_goals(file.document, file.source, kit, reading.get("cell"))


def _blocks(file: DesignFile, kit: Kit | None, reading: Mapping[str, Any]) -> Assembly:
    from learn2assemble.assembly.files import parse_assembly

    joints: Any = reading.get("kit")
    if file.kind == "bricks":
        _refuse(reading, "none; a file of bricks says it all", "kit")
        joints = kit or joints
    document, unit = file.document, None
    if file.kind == "assembly":
        # A file of COMPAS does not say its unit.
        units = ("unit",) if "dtype" in document else ()
        _refuse(
            reading, "none; the blocks of this file are given as they are", "blocks", "kit", *units
        )
        if (given := Reading.of({k: reading[k] for k in units if k in reading})).unit is not None:
            unit = UNITS[given.unit]
    return parse_assembly(
        file.content, file.source, file.name, document=document, unit=unit, kit=joints
    )


def _objects(file: DesignFile, kit: Kit | None, reading: Mapping[str, Any]) -> object:
    """The objects of a mesh as blocks where that is asked for, else the cells it fills."""
    if not reading.get("blocks"):
        return _cells(_mesh)(file, kit, reading)
    from learn2assemble.assembly.files import parse_assembly
    from learn2assemble.assembly.meshes import KINDS

    given = Reading.of(reading)
    _refuse(reading, "none with blocks; unit and up alone", "blocks", "unit", "up")
    given.check(file.kind)
    if file.kind not in KINDS:
        raise InputError("blocks", file.source, f"a mesh of {', '.join(KINDS)}")
    unit = None if given.unit is None else UNITS[given.unit]
    return parse_assembly(file.content, file.source, file.name, unit=unit, up=_upward(given))


def _folder(file: DesignFile, kit: Kit | None, reading: Mapping[str, Any]) -> Assembly:
    """The blocks of a folder, one mesh each, or of the plan in it."""
    from learn2assemble.assembly.files import read_assembly

    assert file.folder is not None
    given = Reading.of(reading)
    given.check(file.kind)
    return read_assembly(file.folder, unit=given.unit, up=_upward(given), kit=kit)


def _upward(given: Reading) -> Literal["y", "z"] | None:
    return None if given.up is None else ("y" if given.up == "y" else "z")


def _cells(
    read: Callable[[DesignFile, Origin], CellDesign],
) -> Callable[[DesignFile, Kit | None, Mapping[str, Any]], CellDesign]:
    """A reader of a kind of file that holds cells, or what becomes cells."""

    def reader(file: DesignFile, kit: Kit | None, reading: Mapping[str, Any]) -> CellDesign:
        given = _reading(file.kind, kit, reading)
        origin = Origin(given, file.name, file.source, given.kit)
        try:
            return read(file, origin)
        except NothingToFillError as error:
            helps = [remedy for remedy in error.remedies if _fills(read, file, origin, remedy)]
            raise NothingToFillError(error.what, error.got, error.expected, *helps) from None

    return reader


def _fills(
    read: Callable[[DesignFile, Origin], CellDesign],
    file: DesignFile,
    origin: Origin,
    remedy: Remedy,
) -> bool:
    """Whether something is filled where a remedy is followed; what else is refused then does not
    count."""
    other = {"unit": None, "size": None, "cells_wide": None, remedy.argument: remedy.value}
    try:
        read(file, replace(origin, given=replace(origin.given, **other)))
    except NothingToFillError:
        return False
    except InputError:
        return True
    return True


def _elevations(file: DesignFile, origin: Origin) -> CellDesign:
    drawing = drawings.read_elevations(file.document, file.source)
    return from_drawing(drawing, replace(origin, name=drawing.name or origin.name))


def _drawing(file: DesignFile, origin: Origin) -> CellDesign:
    drawing = (read_svg if file.kind == "svg" else read_dxf)(file.content, file.source)
    return replace(from_drawing(drawing, origin), not_read=drawing.not_read)


def _voxels(file: DesignFile, origin: Origin) -> CellDesign:
    reader = solids.read_npy if file.kind == "npy" else solids.read_npz
    return _from_voxels(reader(file.content, file.source, MAX_CELLS), origin)


def _mesh(file: DesignFile, origin: Origin) -> CellDesign:
    repair = bool(origin.given.repair)
    return _from_solid(solids.read_mesh(file.content, file.kind, file.source, repair), origin)


def _picture(file: DesignFile, origin: Origin) -> CellDesign:
    given = origin.given
    cell = given.edges(given.kit)
    share, colours, outline = read_picture(
        file.content, file.kind, file.source, given.cells_wide, MAX_CELLS, cell[0] / cell[2]
    )
    thick = max(1, round((given.depth or cell[1]) / cell[1]))
    shape = (len(share), thick, share.shape[1])
    share = np.broadcast_to(share[:, None, :], shape)
    colours = np.broadcast_to(colours[:, None], (*shape, 3))
    cell = _sized(given, cell, shape)
    surface = None
    if outline is not None:
        surface = upright(outline[:, 0], outline[:, 1], 0) * (1, thick, 1)
    made = design_of(share, origin, cell, colours=colours, surface=surface)
    return replace(made, drawn=("front",))


def _from_voxels(voxels: Voxels, origin: Origin) -> CellDesign:
    wanted, colours, given = voxels.wanted, voxels.colours, origin.given
    if given.up == "y":  # (x, y, z) -> (x, -z, y)
        wanted = wanted.transpose(0, 2, 1)[:, ::-1]
        colours = None if colours is None else colours.transpose(0, 2, 1, 3)[:, ::-1]
    cell = _sized(given, given.edges(given.kit, voxels.cell), wanted.shape)
    check_cells(wanted.shape, cell, origin.source)
    return design_of(wanted, origin, cell, colours=colours, exact=True, trim=False)


def _sized(given: Reading, cell: Lengths, shape: Sequence[int]) -> Lengths:
    """The cell, made as large as ``size`` asks for."""
    if given.size is None:
        return cell
    if given.cell is not None:
        raise InputError("size", given.size, "either size or cell: the number of cells is fixed")
    factor = given.size / max(n * edge for n, edge in zip(shape, cell, strict=True))
    x, y, z = (check_length(edge * factor, "size") for edge in cell)
    return x, y, z


def _from_solid(solid: Solid, origin: Origin) -> CellDesign:
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
        floating(lowest, cell, source)
    placed = (triangles - points.min(0)) * scale / cell
    share, first = fit(placed, (0, 1))
    if share.min() < -1e-3 or share.max() > 1 + 1e-3:
        got = "parts that overlap, or are inside out"
        raise InputError(source, got, "a mesh with one inside, all faces outward")
    note = ""
    if solid.holes:
        largest = millimetres(max(solid.holes) * scale)
        note = f"{in_words(len(solid.holes))} of the mesh closed, up to {largest} wide"
    origin = replace(origin, remedies=extent.remedies(scale), note=note)
    return design_of(np.clip(share, 0, 1), origin, cell, surface=placed - first)


READERS: dict[str, Callable[[DesignFile, Kit | None, Mapping[str, Any]], object]] = {
    "goals": _goals,
    "assembly": _blocks,
    "bricks": _blocks,
    "json": _cells(_elevations),
    **dict.fromkeys(("svg", "dxf"), _cells(_drawing)),
    **dict.fromkeys(LOSSY, _cells(_picture)),
    **dict.fromkeys(("npy", "npz"), _cells(_voxels)),
    **dict.fromkeys(("stl", "obj", "ply", "off", "glb", "3dm"), _objects),
    FOLDER: _folder,
}
"""What reads each kind of file that :func:`~learn2assemble.design.files.kind_of` tells."""
