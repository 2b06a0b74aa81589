"""Kits of blocks as data: what kinds there are, how many, and what they are made of.

A kit lives on a lattice. A *kind* is a set of lattice cells that are glued together; it may be
turned by quarters about the vertical, or lie on any of its sides, as the kit allows. A file::

    format = "learn2assemble-kit"
    version = 1
    name = "bricks"
    pitch = [0.05, 0.05, 0.05]   # edges of a lattice cell [m]
    density = 800.0              # [kg/m3]
    friction = 0.5               # Coulomb coefficient between blocks
    joint_gap = 0.0001           # width of a vertical joint [m]

    [[kinds]]
    name = "2x4"
    box = [4, 2, 1]              # or cells = [[0, 0, 0], [1, 0, 0], ...]
    count = 12                   # optional; without it there is no limit
    colour = "#b5523b"           # optional
    density = 2400.0             # optional
    turns = "z"                  # "none", "z" (default) or "any"
"""

from __future__ import annotations

import math
import tomllib
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from learn2assemble.errors import InputError, look_up
from learn2assemble.files import (
    check_keys,
    integer,
    number,
    printable,
    read_head,
    read_text,
    sequence,
    text,
)

Cell = tuple[int, int, int]
FORMAT, VERSION = "learn2assemble-kit", 1
TURNS = ("none", "z", "any")
MAX_KINDS, MAX_CELLS, MAX_EXTENT, MAX_COUNT, MAX_NAME = 64, 512, 64, 100_000, 40
_KEYS = ("format", "version", "units", "name", "pitch", "density", "friction", "joint_gap", "kinds")
_KIND_KEYS = ("name", "box", "cells", "count", "colour", "density", "turns")


@dataclass(frozen=True)
class Kind:
    """One kind of block."""

    name: str
    cells: tuple[Cell, ...]
    """Lattice cells at turn 0, sorted, with their smallest corner at (0, 0, 0)."""
    count: int | None = None
    """How many there are; None: no limit."""
    colour: tuple[int, int, int] | None = None
    density: float | None = None
    """[kg/m3]; None: that of the kit."""
    turns: str = "z"
    """``"none"``, ``"z"``: quarter turns about the vertical, ``"any"``: all 24."""


@dataclass(frozen=True)
class Kit:
    """Kinds of blocks on one lattice."""

    name: str
    kinds: tuple[Kind, ...]
    pitch: tuple[float, float, float] = (0.05, 0.05, 0.05)
    """Edges of a lattice cell [m]."""
    density: float = 800.0
    """[kg/m3]."""
    friction: float = 0.5
    joint_gap: float = 0.0001
    """Width of a vertical joint [m]: the sides of blocks lie inside their cells by half of it."""

    @property
    def limited(self) -> bool:
        """Whether there is a limited number of any kind."""
        return any(kind.count is not None for kind in self.kinds)

    @property
    def flat(self) -> bool:
        """Whether every block, however it is put down, is one cell high."""
        return not any(cell[2] for way in orientations(self) for cell in way.cells)

    def at_pitch(self, cell: tuple[float, float, float]) -> Kit:
        """The kit with blocks of another size: a lattice cell has the edges ``cell`` [m].

        Raises:
            InputError: for cells that are not wider than two joints.
        """
        if np.allclose(cell, self.pitch, rtol=1e-9, atol=0):
            return self
        if min(cell[:2]) <= 2 * self.joint_gap:
            expected = f"more than two joints of kit {self.name}, {2 * self.joint_gap:g} m"
            raise InputError("cell", min(cell[:2]), expected)
        return replace(self, pitch=cell)

    def kind(self, name: str) -> Kind:
        """The kind called ``name``."""
        return look_up("kind of block", name, {kind.name: kind for kind in self.kinds})


@dataclass(frozen=True)
class Orientation:
    """One way to put down a kind: the cells it takes."""

    kind: int
    """Index into ``Kit.kinds``."""
    turn: int
    """See :func:`turned_cells`."""
    cells: tuple[Cell, ...]
    """Sorted, smallest corner at (0, 0, 0)."""


# ---------------------------------------------------------------- turning


def turned_cells(cells: tuple[Cell, ...], turn: int) -> tuple[Cell, ...]:
    """``cells`` after a turn, sorted, with their smallest corner at (0, 0, 0).

    Args:
        turn: ``4 * side + quarter``. First the block is laid on a side: 0 as it is, 1 to 3 by so
            many quarter turns about x, 4 and 5 by a quarter turn about y and back; then it is
            turned by ``quarter`` quarter turns about z, counter-clockwise from above.
    """
    side, quarter = divmod(turn, 4)
    x, y, z = np.array(cells, np.int64).T
    for _ in range(side if side < 4 else 0):
        y, z = -z, y
    if side == 4:
        x, z = z, -x
    elif side == 5:
        x, z = -z, x
    for _ in range(quarter):
        x, y = -y, x
    return _normal(np.stack([x, y, z], -1))


def _normal(cells: np.ndarray) -> tuple[Cell, ...]:
    moved = cells - cells.min(0)
    return tuple(sorted((int(x), int(y), int(z)) for x, y, z in moved))


@lru_cache(maxsize=64)
def orientations(kit: Kit) -> tuple[Orientation, ...]:
    """All ways to put down the kinds of ``kit`` that differ, in the order of kinds and turns.

    A quarter turn is left out where it would not fit the lattice (edges of a cell that differ).
    """
    dx, dy, dz = kit.pitch
    square, cubic = math.isclose(dx, dy), math.isclose(dx, dy) and math.isclose(dx, dz)
    found = []
    for index, kind in enumerate(kit.kinds):
        seen: set[tuple[Cell, ...]] = set()
        for turn in range({"none": 1, "z": 4, "any": 24}[kind.turns]):
            if (turn >= 4 and not cubic) or (turn % 2 and not square):
                continue
            cells = turned_cells(kind.cells, turn)
            if cells not in seen:
                seen.add(cells)
                found.append(Orientation(index, turn, cells))
    return tuple(found)


# ---------------------------------------------------------------- files


@cache
def kit_names() -> tuple[str, ...]:
    """Names of the kits that come with the package."""
    folder = resources.files("learn2assemble") / "assets" / "kits"
    return tuple(
        sorted(entry.name[:-5] for entry in folder.iterdir() if entry.name.endswith(".toml"))
    )


def load_kit(name_or_path: str | Path) -> Kit:
    """A kit that comes with the package, by name, or one read from a TOML file.

    Raises:
        UnknownNameError: for a name that is no built-in kit (and has no ``.toml`` or folder in it).
        InputError: for a file that cannot be read or says something that cannot be used.
    """
    given = str(name_or_path)
    if isinstance(name_or_path, str) and not (given.endswith(".toml") or "/" in given):
        if Path(given).is_file():
            return read_kit(Path(given))
        look_up("kit", given, dict.fromkeys(kit_names()))
        return _built_in(given)
    return read_kit(Path(given))


@cache
def _built_in(name: str) -> Kit:
    source = resources.files("learn2assemble") / "assets" / "kits" / f"{name}.toml"
    return parse_kit(source.read_text(encoding="utf-8"), f"{name}.toml")


def read_kit(path: Path) -> Kit:
    """The kit of a TOML file of at most 1 MB; every fault is an :class:`InputError`."""
    content, source = read_text(path, "kit file")
    return parse_kit(content, source)


def parse_kit(content: str, source: str = "kit") -> Kit:
    """The kit of TOML text; messages call it ``source``."""
    try:
        root = tomllib.loads(content)
    except (tomllib.TOMLDecodeError, ValueError, RecursionError) as error:
        raise InputError(source, printable(str(error)), "TOML") from None
    head = read_head(root, source, FORMAT, VERSION, _KEYS, ("format", "version", "name", "kinds"))
    default = Kit("", ())
    pitch = _vector(head.get("pitch", default.pitch), f"{source}: pitch")
    for value in pitch:
        _within(value, f"{source}: pitch", 1e-4, 10.0, "m")
    gap = number(head.get("joint_gap", default.joint_gap), f"{source}: joint_gap")
    _within(gap, f"{source}: joint_gap", 0.0, min(pitch) / 4, "m, a quarter of the pitch")
    density = number(head.get("density", default.density), f"{source}: density")
    friction = number(head.get("friction", default.friction), f"{source}: friction")
    _within(density, f"{source}: density", 1.0, 30_000.0, "kg/m3")
    _within(friction, f"{source}: friction", 0.0, 5.0, "(Coulomb coefficient)")
    given = sequence(head["kinds"], f"{source}: kinds", "a list of kinds")
    if not 1 <= len(given) <= MAX_KINDS:
        raise InputError(f"{source}: kinds", f"{len(given)} kinds", f"1 to {MAX_KINDS}")
    kinds = tuple(_kind(entry, f"{source}: kinds[{k}]") for k, entry in enumerate(given))
    repeated = [name for name, n in Counter(kind.name for kind in kinds).items() if n > 1]
    if repeated:
        raise InputError(f"{source}: kinds", repeated[0], "every name once")
    return Kit(_name(head["name"], f"{source}: name"), kinds, pitch, density, friction, gap)


def _kind(given: Any, where: str) -> Kind:
    if not isinstance(given, Mapping):
        raise InputError(where, given, "a table with a name and a box or cells")
    check_keys(given, where, "", _KIND_KEYS, ("name",))
    if ("box" in given) == ("cells" in given):
        raise InputError(where, sorted(given), "either 'box' or 'cells'")
    count = given.get("count")
    if count is not None:
        count = integer(count, f"{where}.count")
        _within(count, f"{where}.count", 0, MAX_COUNT, "blocks")
    density = given.get("density")
    if density is not None:
        density = number(density, f"{where}.density")
        _within(density, f"{where}.density", 1.0, 30_000.0, "kg/m3")
    turns = text(given.get("turns", "z"), f"{where}.turns")
    look_up(f"{where}.turns", turns, dict.fromkeys(TURNS))
    cells = _box(given["box"], where) if "box" in given else _cells(given["cells"], where)
    colour = None if given.get("colour") is None else _colour(given["colour"], f"{where}.colour")
    return Kind(_name(given["name"], f"{where}.name"), cells, count, colour, density, turns)


def _box(given: Any, where: str) -> tuple[Cell, ...]:
    sizes = sequence(given, f"{where}.box", "three whole numbers")
    if len(sizes) != 3:
        raise InputError(f"{where}.box", given, "three whole numbers")
    edges = [integer(size, f"{where}.box") for size in sizes]
    for edge in edges:
        _within(edge, f"{where}.box", 1, MAX_EXTENT, "cells")
    if math.prod(edges) > MAX_CELLS:
        raise InputError(f"{where}.box", given, f"at most {MAX_CELLS} cells")
    return _normal(np.argwhere(np.ones(edges, bool)))


def _cells(given: Any, where: str) -> tuple[Cell, ...]:
    """Cells that hang together by their faces and touch themselves nowhere by an edge alone."""
    where = f"{where}.cells"
    listed = sequence(given, where, "a list of [x, y, z]")
    if not 1 <= len(listed) <= MAX_CELLS:
        raise InputError(where, f"{len(listed)} cells", f"1 to {MAX_CELLS}")
    rows = []
    for k, entry in enumerate(listed):
        cell = sequence(entry, f"{where}[{k}]", "[x, y, z]")
        if len(cell) != 3:
            raise InputError(f"{where}[{k}]", entry, "[x, y, z]")
        rows.append([integer(value, f"{where}[{k}]") for value in cell])
        for value in rows[-1]:
            _within(value, f"{where}[{k}]", -MAX_EXTENT, MAX_EXTENT, "cells")
    cells = _normal(np.array(rows, np.int64))
    if len(set(cells)) < len(cells):
        raise InputError(where, listed, "every cell once")
    if max(max(cell) for cell in cells) >= MAX_EXTENT:
        raise InputError(where, "a wider block", f"at most {MAX_EXTENT} cells along an axis")
    if not _connected(cells):
        raise InputError(where, listed, "cells that hang together by their faces")
    if _pinched(cells):
        raise InputError(where, listed, "no two cells that touch along an edge alone")
    return cells


def _connected(cells: tuple[Cell, ...]) -> bool:
    left, queue = set(cells), [cells[0]]
    left.discard(cells[0])
    while queue:
        x, y, z = queue.pop()
        for near in ((x - 1, y, z), (x + 1, y, z), (x, y - 1, z), (x, y + 1, z),
                     (x, y, z - 1), (x, y, z + 1)):  # fmt: skip
            if near in left:
                left.discard(near)
                queue.append(near)
    return not left


def _pinched(cells: tuple[Cell, ...]) -> bool:
    """Whether two diagonal cells of a square of four are there and the two others are not."""
    taken = np.zeros(np.max(cells, 0) + 1, bool)
    taken[tuple(np.array(cells).T)] = True
    for a, b in ((0, 1), (0, 2), (1, 2)):
        grid = np.moveaxis(taken, (a, b), (0, 1))
        p, q, r, s = grid[:-1, :-1], grid[1:, 1:], grid[1:, :-1], grid[:-1, 1:]
        if ((p & q & ~r & ~s) | (r & s & ~p & ~q)).any():
            return True
    return False


def _colour(given: Any, where: str) -> tuple[int, int, int]:
    expected = "'#rrggbb' or three whole numbers from 0 to 255"
    if isinstance(given, str):
        digits = given.removeprefix("#")
        if len(digits) != 6 or any(c not in "0123456789abcdefABCDEF" for c in digits):
            raise InputError(where, given, expected)
        return int(digits[:2], 16), int(digits[2:4], 16), int(digits[4:], 16)
    parts = sequence(given, where, expected)
    if len(parts) != 3:
        raise InputError(where, given, expected)
    red, green, blue = (integer(value, where) for value in parts)
    if not all(0 <= value <= 255 for value in (red, green, blue)):
        raise InputError(where, given, expected)
    return red, green, blue


def _vector(given: Any, where: str) -> tuple[float, float, float]:
    parts = sequence(given, where, "three numbers")
    if len(parts) != 3:
        raise InputError(where, given, "three numbers")
    x, y, z = (number(value, where) for value in parts)
    return x, y, z


def _within(value: float, where: str, low: float, high: float, unit: str) -> None:
    if not low <= value <= high:
        raise InputError(where, value, f"{low:g} to {high:g} {unit}")


def _name(given: Any, where: str) -> str:
    name = text(given, where)
    if not (name and len(name) <= MAX_NAME and name.isprintable() and name == name.strip()):
        raise InputError(where, name, f"1 to {MAX_NAME} printable characters")
    return name
