"""A design as cells to fill and cells to leave empty, read from whatever file people have.

``docs/design_files.md`` lists the kinds of files and their options.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from learn2assemble.design.lattice import HALF
from learn2assemble.design.pictures import near_colours
from learn2assemble.design.reading import (
    Lengths,
    Reading,
    check_cells,
)
from learn2assemble.errors import InputError, Remedy, check_fields, is_number


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
        drawn: sides that were drawn, of ``front`` (its viewer stands at -y), ``back``, ``right``
            and ``left``; none where the file is no drawing and no picture.
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
    drawn: tuple[str, ...] = ()

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


class NothingToFillError(InputError):
    """No cell of a design is half full."""


@dataclass(frozen=True)
class Origin:
    """Where a design comes from, and how it is read."""

    given: Reading
    name: str
    source: str
    kit: str | None
    remedies: tuple[Remedy, ...] = ()
    """What would help where nothing of it is as large as a cell."""
    note: str = ""
    blocks: int | None = None


def design_of(
    share: np.ndarray,
    origin: Origin,
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
        raise NothingToFillError(
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
    from scipy import ndimage  # pyright: ignore[reportMissingTypeStubs]

    if not wanted[:, :, 0].any():
        floating(float(np.flatnonzero(wanted.any((0, 1)))[0]) * cell[2], cell, source)
    library: Any = ndimage
    part, _ = library.label(wanted)
    rest = wanted & ~np.isin(part, part[:, :, 0])
    if rest.any():
        level = int(np.flatnonzero(rest.any((0, 1)))[0])
        floating(level * cell[2], cell, source)


def floating(height: float, cell: Lengths, source: str) -> None:
    level = round(height / cell[2])
    got = f"a part that floats: its lowest level is {level}, {height:.4g} m above the table"
    raise InputError(source, got, "every part to reach the table (level 0, z = 0)")
