"""Goals instead of a drawing: what has to be occupied, reached or loaded, and what stays empty.

``docs/goals.md`` describes the file. On the lattice of a kit, every goal is cells to fill: a point
that is reached, or that carries a load, is the top face of a filled cell with nothing above it.
Blocks come from above, so nothing is built below an obstacle either.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np

from learn2assemble.assembly.kit import DEFAULT_KIT, MAX_COUNT, Cell, Kit, load_kit
from learn2assemble.constants import GRAVITY
from learn2assemble.design.drawings import check_line
from learn2assemble.design.lattice import MAX_CELLS
from learn2assemble.errors import InputError, look_up
from learn2assemble.files import as_path, read_text
from learn2assemble.values import Range, integer, load_json, mapping, read_document

FORMAT, VERSION = "learn2assemble-goals", 1
MAX_GOALS, MAX_LOADS = 64, 5
_GRAIN = 1e-3
"""Share of a cell that counts as rounding."""

Metre = Annotated[float, Range(-100, 100)]
Point = tuple[Metre, Metre, Metre]
Box = tuple[Point, Point]


@dataclass(frozen=True)
class Place:
    """A point, or a box from its lowest corner to its highest [m]."""

    at: Point | None = None
    box: Box | None = None


@dataclass(frozen=True)
class Load:
    """A load on a point of a top face."""

    at: Point
    mass: Annotated[float, Range(1e-6, 1e4)] | None = None
    """[kg]"""
    force: Annotated[float, Range(1e-6, 1e5)] | None = None
    """[N], instead of a mass."""


@dataclass(frozen=True)
class GoalsFile:
    """What a goals file says, besides its heap; see ``docs/goals.md``."""

    site: tuple[Metre, Metre, Metre]
    """Size of the place to build in [m]; its middle is x = y = 0, the table z = 0."""
    name: str = "goals"
    kit: str | None = None
    cell: tuple[Metre, Metre, Metre] | None = None
    """Edges of a cell [m]; those of the kit without it."""
    occupy: tuple[Place, ...] = ()
    reach: tuple[Point, ...] = ()
    load: tuple[Load, ...] = ()
    obstacles: tuple[Box, ...] = ()
    props: bool = False
    """Whether blocks may be taken away again in the end."""


@dataclass(frozen=True)
class Surface:
    """A top face that has to be there."""

    cell: Cell
    """The filled cell below it."""
    point: Point
    """[m]"""
    mass: float = 0.0
    """Of the load on it [kg]."""


@dataclass(frozen=True, eq=False)
class Goals:
    """Goals on the lattice of a kit. Cell (i, j, k) lies as in a design of cells."""

    name: str
    source: str
    kit: Kit
    """With the heap as counts, and its pitch as the edges of a cell."""
    open: np.ndarray
    """bool[X, Y, Z]: cells that blocks may fill."""
    must: np.ndarray
    """bool[X, Y, Z]: cells that have to be filled, those below surfaces included."""
    surfaces: tuple[Surface, ...]
    obstacles: tuple[Box, ...]
    """[m]"""
    props: bool = False

    @property
    def shape(self) -> Cell:
        """Cells along x, y and z."""
        x, y, z = self.open.shape
        return x, y, z

    @property
    def loads(self) -> tuple[Surface, ...]:
        """Surfaces with a load."""
        return tuple(surface for surface in self.surfaces if surface.mass > 0)

    def boxes(self) -> list[tuple[Literal["occupy", "reach", "load", "obstacle"], Point, Point]]:
        """What to show of the goals: kind and corners of a box [m]; a face has no height."""
        pitch = np.array(self.kit.pitch)
        origin = np.array([-pitch[0] * self.shape[0] / 2, -pitch[1] * self.shape[1] / 2, 0.0])

        def corners(cell: Sequence[int] | np.ndarray, face: bool = False) -> tuple[Point, Point]:
            high = origin + (np.array(cell) + 1) * pitch
            low = high - pitch * (1, 1, not face)
            return _point(low), _point(high)

        faces = {surface.cell for surface in self.surfaces}
        filled = [tuple(cell) for cell in np.argwhere(self.must).tolist()]
        return [
            *(("occupy", *corners(cell)) for cell in filled if cell not in faces),
            *(("load" if s.mass else "reach", *corners(s.cell, True)) for s in self.surfaces),
            *(("obstacle", low, high) for low, high in self.obstacles),
        ]

    def unmet(self, filled: np.ndarray) -> list[str]:
        """What cells leave undone, in words; nothing of equilibrium.

        Args:
            filled: bool[X, Y, Z].
        """
        found = [f"the cell {_cell(c)} has to be filled" for c in np.argwhere(self.must & ~filled)]
        found += [f"the cell {_cell(c)} stays empty" for c in np.argwhere(filled & ~self.open)]
        return found


def _point(values: np.ndarray) -> Point:
    x, y, z = (round(float(v), 6) for v in values)
    return x, y, z


def read_goals(
    path: str | Path, kit: Kit | str | None = None, cell: float | Sequence[float] | None = None
) -> Goals:
    """The goals in a file; every fault is an :class:`InputError` of one line.

    Args:
        kit: instead of the one the file names; its heap is taken where the file has none.
        cell: edges of a cell [m], one number or three, instead of those of the file.
    """
    content, source = read_text(as_path(path, "goals"), "goals file")
    return parse_goals(load_json(content, source, "goals file"), source, kit, cell)


def parse_goals(
    given: Any,
    source: str = "goals",
    kit: Kit | str | None = None,
    cell: float | Sequence[float] | None = None,
) -> Goals:
    """The goals of parsed JSON; see :func:`read_goals`."""
    file, root = read_document(GoalsFile, given, source, FORMAT, VERSION, "heap")
    check_line(file.name, f"{source}: name")
    if not isinstance(kit, Kit):
        kit = load_kit(kit or file.kit or DEFAULT_KIT)
    edges = file.cell if cell is None else cell
    if edges is not None:
        x, y, z = np.broadcast_to(np.asarray(edges, float), 3).tolist()
        if not min(x, y, z) >= 1e-4:
            raise InputError(f"{source}: cell", edges, "lengths from 0.0001 m")
        kit = kit.at_pitch((x, y, z))
    if "heap" in root:
        kit = _with_heap(kit, root["heap"], f"{source}: heap")
    return _on_lattice(file, kit, source)


def _with_heap(kit: Kit, given: Any, where: str) -> Kit:
    """The kit with only the kinds that are named, and as many of them."""
    counts = dict[str, int]()
    for name, count in mapping(given, where).items():
        kind = look_up(where, name, {kind.name: kind for kind in kit.kinds})
        if not 0 <= integer(count, f"{where}.{name}") <= MAX_COUNT:
            raise InputError(f"{where}.{name}", count, f"0 to {MAX_COUNT} blocks")
        counts[kind.name] = count
    kinds = tuple(replace(k, count=counts[k.name]) for k in kit.kinds if counts.get(k.name))
    if not kinds:
        raise InputError(where, dict(given), "at least one block")
    return replace(kit, kinds=kinds)


def _on_lattice(file: GoalsFile, kit: Kit, source: str) -> Goals:
    pitch = np.array(kit.pitch)
    shape = np.floor(np.array(file.site) / pitch + _GRAIN).astype(int)
    if shape.min() < 1 or shape.max() > MAX_CELLS:
        words = f"1 to {MAX_CELLS} cells of {kit.pitch} m along every axis"
        raise InputError(f"{source}: site", list(file.site), words)
    for what in ("occupy", "reach", "load", "obstacles"):
        count, most = len(getattr(file, what)), MAX_LOADS if what == "load" else MAX_GOALS
        if count > most:
            raise InputError(f"{source}: {what}", count, f"at most {most}")
    corner = np.array([-shape[0] / 2, -shape[1] / 2, 0.0])

    def cell_of(point: Point, where: str, below: float = 0.0) -> Cell:
        """The cell of a point, or of what is so much below it [m]."""
        inside = point[0], point[1], point[2] - below
        place = np.floor(np.array(inside) / pitch - corner + 1e-6).astype(int)
        if (place < 0).any() or (place >= shape).any():
            half = shape * pitch / 2
            words = (
                f"a point inside the site, |x| < {half[0]:g}, |y| < {half[1]:g} and "
                f"0 <= z < {2 * half[2]:g} m"
            )
            raise InputError(where, list(point), words)
        return _cell(place)

    def slices(box: Box, where: str, inside: bool) -> tuple[slice, slice, slice]:
        low, high = (np.array(end) / pitch - corner for end in box)
        if (high - low <= _GRAIN).any():
            raise InputError(where, [list(end) for end in box], "a lowest corner, then the highest")
        first = np.floor(low + _GRAIN).astype(int)
        last = np.ceil(high - _GRAIN).astype(int)
        if inside and ((first < 0).any() or (last > shape).any()):
            raise InputError(where, [list(end) for end in box], "a box inside the site")
        first, last = np.maximum(first, 0), np.clip(last, 0, shape)
        a, b, c = (slice(int(u), int(v)) for u, v in zip(first, last, strict=True))
        return a, b, c

    solid = np.zeros(shape, bool)
    for k, box in enumerate(file.obstacles):
        solid[slices(box, f"{source}: obstacles[{k}]", False)] = True
    free = ~np.flip(np.logical_or.accumulate(np.flip(solid, 2), 2), 2)
    must = np.zeros(shape, bool)
    names: list[tuple[str, Cell]] = []
    for k, place in enumerate(file.occupy):
        where = f"{source}: occupy[{k}]"
        if (place.at is None) == (place.box is None):
            raise InputError(where, "both or neither", "either 'at' or 'box'")
        part = np.zeros(shape, bool)
        if place.at is not None:
            part[cell_of(place.at, f"{where}.at")] = True
        elif place.box is not None:
            part[slices(place.box, f"{where}.box", True)] = True
        names += [(where, _cell(c)) for c in np.argwhere(part & ~must)]
        must |= part
    surfaces: list[Surface] = []
    loads = [
        (f"load[{k}]", load.at, _mass(load, f"{source}: load[{k}]"))
        for k, load in enumerate(file.load)
    ]
    for key, point, mass in [(f"reach[{k}]", p, 0.0) for k, p in enumerate(file.reach)] + loads:
        where = f"{source}: {key}"
        level = point[2] / pitch[2]
        if level < 0.5 or abs(level - round(level)) > _GRAIN:
            nearest = max(round(level), 1) * pitch[2]
            raise InputError(where, point[2], f"the height of a top face, such as {nearest:g} m")
        x, y, z = cell_of(point, where, (level - round(level) + 0.5) * float(pitch[2]))
        must[x, y, z] = True
        names.append((where, (x, y, z)))
        surfaces.append(Surface((x, y, z), point, mass))
    for where, (x, y, z) in names[len(names) - len(surfaces) :]:
        if solid[x, y, z + 1 :].any():
            raise InputError(where, [x, y, z], "a cell with no obstacle above it")
        free[x, y, z + 1 :] = False
    for where, at in names:
        if solid[at]:
            raise InputError(where, list(at), "a cell outside the obstacles")
        if not free[at]:
            raise InputError(
                where,
                list(at),
                "a cell with no obstacle above it and above no "
                "surface that is to be reached or loaded",
            )
    if not names:
        raise InputError(source, "no goal", "a goal: 'occupy', 'reach' or 'load'")
    for array in (free, must):
        array.setflags(write=False)
    return Goals(file.name, source, kit, free, must, tuple(surfaces), file.obstacles, file.props)


def _mass(load: Load, where: str) -> float:
    if (load.mass is None) == (load.force is None):
        raise InputError(where, "both or neither", "either 'mass' or 'force'")
    return load.mass if load.mass is not None else (load.force or 0.0) / GRAVITY


def _cell(at: Any) -> Cell:
    x, y, z = (int(v) for v in at)
    return x, y, z
