"""Kits of blocks as data: what kinds there are, how many, and what they are made of.

A kit lives on a lattice. A *kind* is a set of lattice cells that are glued together; it may be
turned by quarters about the vertical, or lie on any of its sides, as the kit allows. A file, of
which only the kinds are needed::

    format = "learn2assemble-kit"
    version = 1
    name = "bricks"              # else that of the file
    pitch = [0.05, 0.05, 0.05]   # edges of a lattice cell [m]
    density = 800.0              # [kg/m3]
    friction = 0.5               # Coulomb coefficient between blocks
    joint_gap = 0.0001           # width of a vertical joint [m]
    plates = false               # of bricks that clutch: whether plates fill designs, too

    [joint]                      # optional: how joints hold, see learn2assemble.assembly.joints
    law = "clutch"               # or "dry" (default), "mortar"
    capacity = 0.70              # [N] a contact point

    [[kinds]]
    name = "2x4"                 # else that of the edges of its box
    box = [4, 2, 1]              # or cells = [[0, 0, 0], [1, 0, 0], ...]
    count = 12                   # optional; without it there is no limit
    colour = "#b5523b"           # optional
    density = 2400.0             # optional; or mass = 0.002 of a block [kg]
    turns = "z"                  # "none", "z" (default) or "any"
"""

from __future__ import annotations

import math
import re
import tomllib
from collections import Counter
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np

from learn2assemble.assembly.joints import DRY, Joint, joint_of_json
from learn2assemble.assembly.values import Colour
from learn2assemble.errors import InputError, look_up, printable
from learn2assemble.files import read_text
from learn2assemble.values import By, Range, from_plain, read_document

Cell = tuple[int, int, int]
FORMAT, VERSION = "learn2assemble-kit", 1
Turns = Literal["none", "z", "any"]
DEFAULT_KIT = "bricks-lintels"
"""Of a design that names none."""
MAX_KINDS, MAX_CELLS, MAX_EXTENT, MAX_COUNT, MAX_NAME = 64, 512, 64, 100_000, 40
Length = Annotated[float, Range(1e-4, 10.0, "m")]
Density = Annotated[float, Range(1.0, 30_000.0, "kg/m3")]
Mass = Annotated[float, Range(1e-6, 1e5, "kg")]
_Size = Annotated[int, Range(1, MAX_EXTENT, "cells")]
_Place = Annotated[int, Range(-MAX_EXTENT, MAX_EXTENT, "cells")]


@dataclass(frozen=True)
class Kind:
    """One kind of block."""

    name: str
    cells: tuple[Cell, ...]
    """Lattice cells at turn 0, sorted, with their smallest corner at (0, 0, 0)."""
    count: int | None = None
    """How many there are; None: no limit."""
    colour: Colour | None = None
    density: float | None = None
    """[kg/m3]; None: that of the kit."""
    turns: Turns = "z"
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
    joint: Joint = DRY
    """How joints hold."""
    plates: bool = False
    """Of bricks that clutch: whether designs are cut into layers as high as a plate, which bricks
    and plates fill, or as high as a brick."""

    @property
    def cell(self) -> tuple[float, float, float]:
        """Edges of a cell of a design for it [m]: of its lattice; of bricks that clutch, which come
        in layers of plates, one stud wide and a brick high unless ``plates`` fill it, too."""
        x, y, z = self.pitch
        if self.joint.law != "clutch" or self.plates:
            return self.pitch
        return x, y, z * max(cell[2] + 1 for kind in self.kinds for cell in kind.cells)

    @property
    def limited(self) -> bool:
        """Whether there is a limited number of any kind."""
        return any(kind.count is not None for kind in self.kinds)

    @property
    def unlimited(self) -> Kit:
        """The same kinds, without limits."""
        return replace(self, kinds=tuple(replace(kind, count=None) for kind in self.kinds))

    @property
    def most_cells(self) -> int | None:
        """How many cells all blocks together fill; None without a limit."""
        if any(kind.count is None for kind in self.kinds):
            return None
        return sum(len(kind.cells) * (kind.count or 0) for kind in self.kinds)

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
        joint = replace(self.joint, pitch=(cell[0], cell[2])) if self.joint.holds else self.joint
        return replace(self, pitch=cell, joint=joint)

    def kind(self, name: str) -> Kind:
        """The kind called ``name``."""
        return look_up("kind of block", name, {kind.name: kind for kind in self.kinds})


def _colour(value: Any, where: str) -> Colour:
    """Red, green and blue, from numbers or ``#rrggbb``."""
    if not isinstance(value, str):
        return from_plain(Colour, value, where)
    if not re.fullmatch("#?[0-9a-fA-F]{6}", value):
        raise InputError(where, value, "'#rrggbb' or three whole numbers from 0 to 255")
    red, green, blue = bytes.fromhex(value.removeprefix("#"))
    return red, green, blue


@dataclass(frozen=True)
class _KindFile:
    name: str | None = None
    box: tuple[_Size, _Size, _Size] | None = None
    cells: tuple[tuple[_Place, _Place, _Place], ...] | None = None
    count: Annotated[int, Range(0, MAX_COUNT, "blocks")] | None = None
    colour: Annotated[Colour, By(_colour)] | None = None
    density: Density | None = None
    mass: Mass | None = None
    turns: Turns = "z"


@dataclass(frozen=True)
class _KitFile:
    name: str
    kinds: tuple[_KindFile, ...]
    pitch: tuple[Length, Length, Length] = Kit.pitch
    density: Density = Kit.density
    friction: Annotated[float, Range(0.0, 5.0, "(Coulomb coefficient)")] = Kit.friction
    joint_gap: Annotated[float, Range(0.0, 10.0, "m")] = Kit.joint_gap
    plates: bool = Kit.plates


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
    found = list[Orientation]()
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
            return parse_kit(*read_text(Path(given), "kit file"))
        look_up("kit", given, dict.fromkeys(kit_names()))
        return _built_in(given)
    return parse_kit(*read_text(Path(given), "kit file"))


@cache
def _built_in(name: str) -> Kit:
    source = resources.files("learn2assemble") / "assets" / "kits" / f"{name}.toml"
    return parse_kit(source.read_text(encoding="utf-8"), f"{name}.toml")


def parse_kit(content: str, source: str = "kit") -> Kit:
    """The kit of TOML text; messages call it ``source``."""
    try:
        root = tomllib.loads(content)
    except (tomllib.TOMLDecodeError, ValueError, RecursionError) as error:
        words = "a kit file, which is TOML (docs/kits.md)"
        raise InputError(source, printable(str(error)), words) from None
    head = {"format": FORMAT, "version": VERSION, "name": Path(source).stem[:MAX_NAME].strip()}
    file, head = read_document(_KitFile, head | root, source, FORMAT, VERSION, "joint")
    if not 1 <= len(file.kinds) <= MAX_KINDS:
        raise InputError(f"{source}: kinds", f"{len(file.kinds)} kinds", f"1 to {MAX_KINDS}")
    if file.joint_gap > min(file.pitch) / 4:
        expected = f"0 to {min(file.pitch) / 4:g} m, a quarter of the pitch"
        raise InputError(f"{source}: joint_gap", file.joint_gap, expected)
    cell = math.prod(file.pitch)
    kinds = tuple(_kind(kind, f"{source}: kinds[{k}]", cell) for k, kind in enumerate(file.kinds))
    repeated = [name for name, n in Counter(kind.name for kind in kinds).items() if n > 1]
    if repeated:
        raise InputError(f"{source}: kinds", repeated[0], "every name once")
    _check_name(file.name, f"{source}: name")
    joint = _joint(head.get("joint"), file, kinds, source)
    if file.plates and joint.law != "clutch":
        raise InputError(f"{source}: plates", True, f"bricks that clutch, not {joint.law} joints")
    material = file.pitch, file.density, file.friction, file.joint_gap
    return Kit(file.name, kinds, *material, joint, file.plates)


def _joint(given: Any, file: _KitFile, kinds: tuple[Kind, ...], source: str) -> Joint:
    """The law of the joints of a kit; a clutch has its studs on the lattice of the kit."""
    if given is None:
        return DRY
    where = f"{source}: joint"
    joint = joint_of_json(given, where, pitch=(file.pitch[0], file.pitch[2]))
    if joint.law != "clutch":
        return joint
    if "pitch" in given or not math.isclose(file.pitch[0], file.pitch[1]):
        got = "a pitch of its own" if "pitch" in given else list(file.pitch)
        raise InputError(where, got, "studs on the pitch of the kit, the same along x and y")
    for k, kind in enumerate(kinds):
        if math.prod(np.max(kind.cells, 0) + 1) != len(kind.cells) or kind.turns == "any":
            got = "studs on a side" if kind.turns == "any" else "studs on nothing"
            expected = "a box whose top is all studs, turned about z alone, for clutch"
            raise InputError(f"{source}: kinds[{k}]", got, expected)
    return joint


def _kind(given: _KindFile, where: str, cell: float) -> Kind:
    if given.box is not None and given.cells is None:
        if math.prod(given.box) > MAX_CELLS:
            raise InputError(f"{where}.box", list(given.box), f"at most {MAX_CELLS} cells")
        cells = _normal(np.argwhere(np.ones(given.box, bool)))
    elif given.cells is not None and given.box is None:
        cells = _checked(given.cells, f"{where}.cells")
    else:
        got = "neither" if given.box is None else "both"
        raise InputError(where, got, "either 'box' or 'cells'")
    density = given.density
    if given.mass is not None:
        if density is not None:
            raise InputError(where, "density and mass", "one of them")
        density = given.mass / (len(cells) * cell)
        if not 1e-2 <= density <= 1e6:
            raise InputError(f"{where}.mass", given.mass, "a mass of 0.01 to 1e6 kg/m3")
    name = given.name if given.name is not None else _box_name(given.box, where)
    _check_name(name, f"{where}.name")
    return Kind(name, cells, given.count, given.colour, density, given.turns)


def _box_name(box: tuple[int, int, int] | None, where: str) -> str:
    """The name of a box that has none, as those of the package: ``2x4``, or ``2x4x3`` of height 3.

    Raises:
        InputError: for a kind that is no box.
    """
    if box is None:
        raise InputError(where, "a kind of cells without a name", "the key 'name'")
    *sides, height = box
    return "x".join(map(str, (*sorted(sides), height) if height > 1 else sorted(sides)))


def _check_name(name: str, where: str) -> None:
    if not (name and len(name) <= MAX_NAME and name.isprintable() and name == name.strip()):
        raise InputError(where, name, f"1 to {MAX_NAME} printable characters")


def _checked(listed: tuple[Cell, ...], where: str) -> tuple[Cell, ...]:
    """Cells that hang together by their faces and touch themselves nowhere by an edge alone."""
    if not 1 <= len(listed) <= MAX_CELLS:
        raise InputError(where, f"{len(listed)} cells", f"1 to {MAX_CELLS}")
    cells = _normal(np.array(listed, np.int64))
    if len(set(cells)) < len(cells):
        raise InputError(where, list(listed), "every cell once")
    if max(max(cell) for cell in cells) >= MAX_EXTENT:
        raise InputError(where, "a wider block", f"at most {MAX_EXTENT} cells along an axis")
    taken = np.zeros(np.max(cells, 0) + 1, bool)
    taken[tuple(np.array(cells).T)] = True
    if len(parts_of(taken)) > 1:
        raise InputError(where, list(listed), "cells that hang together by their faces")
    for a, b in ((0, 1), (0, 2), (1, 2)):  # two diagonal cells of a square of four
        grid = np.moveaxis(taken, (a, b), (0, 1))
        p, q, r, s = grid[:-1, :-1], grid[1:, 1:], grid[1:, :-1], grid[:-1, 1:]
        if ((p & q & ~r & ~s) | (r & s & ~p & ~q)).any():
            raise InputError(where, list(listed), "no two cells that touch along an edge alone")
    return cells


def parts_of(mask: np.ndarray) -> list[np.ndarray]:
    """bool[...] each: parts of ``mask`` that hang together by faces (edges) of cells."""
    from scipy import ndimage  # pyright: ignore[reportMissingTypeStubs]

    library: Any = ndimage
    labels, count = library.label(mask, _touching(mask.ndim))
    return [labels == number for number in range(1, count + 1)]


def boxed_parts_of(
    mask: np.ndarray, whole: bool = False
) -> list[tuple[tuple[slice, ...], np.ndarray]]:
    """The same parts, or all as one, each as the cells it spans and which of these are in it."""
    from scipy import ndimage  # pyright: ignore[reportMissingTypeStubs]

    library: Any = ndimage
    labels = mask.astype(np.int64) if whole else library.label(mask, _touching(mask.ndim))[0]
    boxes: list[tuple[slice, ...]] = library.find_objects(labels)
    return [(box, labels[box] == number) for number, box in enumerate(boxes, 1)]


@cache
def _touching(axes: int) -> np.ndarray:
    """bool[3, 3, ...]: a cell and those it has a face in common with."""
    from scipy import ndimage  # pyright: ignore[reportMissingTypeStubs]

    library: Any = ndimage
    return library.generate_binary_structure(axes, 1)
