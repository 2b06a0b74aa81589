"""How a design is read: what the caller says of units, cells and sizes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from learn2assemble.design.lattice import MAX_CELLS
from learn2assemble.design.pictures import LOSSY, USUAL_WIDE
from learn2assemble.errors import InputError, Remedy, check_name, look_up
from learn2assemble.files import FARTHEST, UNITS

DEFAULT_CELL = (0.05, 0.05, 0.05)
"""Edges of a cell where neither the caller nor a kit says [m]."""
ARRAY, FOLDER = "array", "folder"
"""The kinds of a design that is a numpy array, and of a folder of meshes."""
_LENGTHS = 1e-4, 100.0
"""Shortest and longest length an option may give [m]."""

Lengths = tuple[float, float, float]

_DRAWING = frozenset({"unit", "size", "cells_wide", "cell", "depth", "kit"})
_MESH = frozenset({"unit", "size", "cells_wide", "up", "cell", "kit", "repair", "blocks"})
_CELLS = frozenset({"size", "up", "cell", "kit"})
_READ = {
    "json": _DRAWING - {"unit", "size", "cells_wide"},
    "svg": _DRAWING,
    "dxf": _DRAWING,
    **dict.fromkeys(LOSSY, _DRAWING - {"unit"}),
    **dict.fromkeys(("stl", "obj", "ply", "glb", "off", "3dm"), _MESH),
    **dict.fromkeys(("npy", "npz"), _CELLS),
    ARRAY: _CELLS | {"colours"},
    FOLDER: frozenset({"unit", "up", "blocks"}),
}
"""Options that mean something for a kind of design; others are refused."""


@dataclass(frozen=True, eq=False)
class Reading:
    """What the caller says about how to read a design; None is nothing."""

    unit: str | None = None
    """``"mm"``, ``"cm"``, ``"m"`` or ``"in"``: a unit of the file; before what the file says."""
    cell: float | Sequence[float] | None = None
    """Edges of a cell [m], one number or three. Without it, the pitch of the kit."""
    size: float | None = None
    """Largest side or height of the design [m]; instead of a unit."""
    up: str | None = None
    """``"y"`` or ``"z"``, the axis that points up. Without it, y in GLB and z elsewhere."""
    depth: float | None = None
    """Thickness of the walls of a drawing [m]. Without it, one cell."""
    cells_wide: int | None = None
    """Number of cells across a drawing, picture or mesh; instead of a unit."""
    kit: str | None = None
    """Name or file of a kit; before what the file says."""
    repair: bool | None = None
    """Whether small holes of a mesh are closed."""
    blocks: bool | None = None
    """Whether every object of a mesh is a block, where it shall stand, instead of a shape."""
    colours: np.ndarray | None = None
    """Of the cells of an array, ``uint8[X, Y, Z, 3]``."""

    @classmethod
    def of(cls, given: Mapping[str, Any]) -> Reading:
        """The same from keyword arguments.

        Raises:
            UnknownNameError: for a name that is none of the fields, with the nearest one.
        """
        for name in given:
            check_name("reading", name, OPTIONS)
        return cls(**given)

    def check(self, kind: str) -> None:
        """Refuse what a kind of design does not take.

        Args:
            kind: a key of the table of options.
        """
        for name, value in vars(self).items():
            if value is not None and name not in _READ[kind]:
                got = value if name != "colours" else "an array"
                raise InputError(name, got, f"no such option for {kind.upper()}")
        if self.unit is not None:
            look_up("unit", self.unit, UNITS)
        if self.up is not None:
            look_up("up", self.up, {"y": 1, "z": 2})
        for name in ("size", "depth"):
            if getattr(self, name) is not None:
                check_length(getattr(self, name), name)
        wide = self.cells_wide
        if wide is not None and (type(wide) is not int or not 1 <= wide <= MAX_CELLS):
            raise InputError("cells_wide", wide, f"a whole number from 1 to {MAX_CELLS}")
        for name in ("repair", "blocks"):
            value = getattr(self, name)
            if value is not None and not isinstance(value, bool):
                raise InputError(name, value, "True or False")
        # Each says how large the design is; a picture has pixels besides.
        sizes = {"unit": self.unit, "size": self.size, "cells_wide": wide}
        said = [name for name, value in sizes.items() if value is not None]
        if len(said) > 1 and kind not in LOSSY:
            raise InputError(said[0], sizes[said[0]], f"either {' or '.join(said)}")

    def edges(self, kit: str | None, own: Lengths | None = None) -> Lengths:
        """Edges of a cell [m]: as the caller says, else the file (``own``), else the kit."""
        if self.cell is not None:
            edges = np.atleast_1d(np.asarray(self.cell, dtype=object)).tolist()
        elif own is not None:
            edges = list(own)
        elif kit is not None:
            from learn2assemble.assembly.kit import load_kit

            edges = list(load_kit(kit).cell)
        else:
            edges = list(DEFAULT_CELL)
        if len(edges) not in (1, 3):
            raise InputError("cell", self.cell, "one length or three [m]")
        x, y, z = (check_length(edge, "cell") for edge in (edges * 3)[:3])
        return x, y, z


OPTIONS = tuple(item.name for item in fields(Reading))
"""What may be said."""


def check_length(value: Any, where: str) -> float:
    """``value`` where it is a length in metres."""
    low, high = _LENGTHS
    given: Any = value
    usable = isinstance(value, int | float | np.number) and not isinstance(value, bool)
    if not usable or not low <= float(given) <= high:
        raise InputError(where, given, f"a length from {low:g} to {high:g} m")
    return float(given)


@dataclass(frozen=True, eq=False)
class Extent:
    """How large a drawing or a mesh is.

    Args:
        units: ``float64[k]``, edges of the box around it, the first across, the last up.
        cell: edges of a cell along the same axes [m].
        source: what messages call the file.
        fixed: whether the file fixes its size, so that no other unit can be asked for.
    """

    units: np.ndarray
    cell: np.ndarray
    source: str
    fixed: bool = False

    def __str__(self) -> str:
        return f"{_times(f'{edge:.6g}' for edge in self.units)} units"

    def scale(self, given: Reading, metres: float | None) -> float:
        """Length of a unit [m].

        Args:
            metres: what the file says.

        Raises:
            InputError: where nobody says, and for what is larger than the limits, before anything
                of that size is made; with what would fit.
        """
        if given.cells_wide is not None:
            return given.cells_wide * float(self.cell[0]) / float(self.units[0])
        if given.size is not None:
            return given.size / float(self.units.max())
        unit = metres if given.unit is None else UNITS[given.unit]
        if unit is None:
            expected = "unit (mm, cm, m, in), or size in metres"
            got = f"{self} and no unit in the file"
            raise InputError(f"{self.source}: unit", got, expected, *self.remedies())
        size = unit * float(self.units.max())
        if not size <= FARTHEST:
            raise InputError(
                self.source, f"{size:g} m across", f"at most {FARTHEST:g} m", *self.remedies()
            )
        return unit

    def check(self, scale: float) -> None:
        """Refuse more cells than the limit.

        Args:
            scale: length of a unit [m].
        """
        cells = self.units * scale / self.cell
        if not (cells <= MAX_CELLS + 1e-6).all():
            edges = _times(f"{edge:g}" for edge in self.cell)
            got = f"{self}: {_counts(cells)} cells of {edges} m"
            expected = f"at most {MAX_CELLS} each way (another unit, size or cell?)"
            raise InputError(self.source, got, expected, *self.remedies(scale))

    def remedies(self, tried: float | None = None) -> tuple[Remedy, ...]:
        """The units in which it fits, most cells first, or a number of cells that does.

        Args:
            tried: length of a unit that does not fit [m].
        """
        if self.fixed:
            return ()
        sizes = {
            unit: self.units * length / self.cell
            for unit, length in UNITS.items()
            if tried is None or not math.isclose(length, tried)
        }
        fit = {
            unit: cells
            for unit, cells in sizes.items()
            if cells.max() <= MAX_CELLS + 1e-6 and cells.min() >= 0.5
        }
        if fit:
            found = sorted(fit, key=lambda unit: -fit[unit].max())[:2]
            return tuple(Remedy("unit", u, f"gives {_counts(fit[u].round())} cells") for u in found)
        shape = self.units / self.cell
        wide = int(min(USUAL_WIDE, MAX_CELLS * shape[0] / shape.max()))
        if wide < 1:
            return ()
        counts = _counts((shape * (wide / shape[0])).round())
        return (Remedy("cells_wide", wide, f"gives {counts} cells"),)


def check_cells(shape: Sequence[int], cell: Lengths, source: str) -> None:
    """Refuse more cells than the limit, where their number is fixed."""
    if max(shape) > MAX_CELLS:
        edges = _times(f"{edge:g}" for edge in cell)
        got = f"{_times(map(str, shape))} cells of {edges} m"
        raise InputError(source, got, f"at most {MAX_CELLS} each way")


def _counts(cells: np.ndarray) -> str:
    return _times(f"{max(math.ceil(n - 1e-6), 1):.6g}" for n in cells.tolist())


def _times(words: Any) -> str:
    return " × ".join(words)
