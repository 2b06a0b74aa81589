"""LDraw: models of bricks as text, with submodels in one file (MPD) and steps of building.

Units are 0.4 mm, y points down, the origin of a part is the middle of its top. Bricks stand
upright, turned by quarters on one lattice of studs; lines, triangles and comments are left out.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from learn2assemble.assembly.blocks import MAX_BLOCKS, Assembly
from learn2assemble.assembly.bricks.model import Brick, BrickModel, bricks_of
from learn2assemble.assembly.bricks.parts import COLOURS, LDU, MAIN, PARTS, code_of, size_of_part
from learn2assemble.assembly.kit import Kit
from learn2assemble.errors import InputError

MAX_LINES = 200_000
MAX_NESTED = 32
"""Submodels within submodels."""
_EXACT = 1e-3
"""How far a turn may be from a quarter, and a place from the lattice, in studs."""
BEGIN = re.compile(
    rb"^\s*1[ \t]+\S+(([ \t]+[-+.\deE]+){12}[ \t]+\S|[ \t][^\r\n]*\.(dat|ldr)\s*$)",
    re.MULTILINE | re.IGNORECASE,
)
"""A line of a part, which every model has; one that ends in the name of a part may be damaged."""
_TURNS = {
    False: "1 0 0 0 1 0 0 0 1",
    True: "0 0 1 0 1 0 -1 0 0",
}
"""The turn of a part whose long side is along x, or along y."""


class _PartLine(NamedTuple):
    """A part or a submodel in a file."""

    colour: str
    turn: np.ndarray
    at: np.ndarray
    name: str
    where: str


class _File(NamedTuple):
    """A model: its lines, None where a step ends."""

    title: str
    lines: list[_PartLine | None]


class _PartPlace(NamedTuple):
    """A part where it is in the model."""

    turn: np.ndarray
    at: np.ndarray
    colour: tuple[int, int, int] | None
    name: str
    where: str


def parse_ldraw(text: str, source: str, kit: Kit, name: str = "") -> BrickModel:
    """The bricks of an LDraw file, in the order of its lines.

    That is the order of building where the file has steps.

    Raises:
        InputError: for unknown parts (with the nearest known), parts that lie, are off the lattice
            or do not fit the kit, submodels that hold themselves, and files that are too long.
    """
    if text.count("\n") > MAX_LINES:
        raise InputError(source, f"{text.count(chr(10))} lines", f"at most {MAX_LINES}")
    colours = dict(COLOURS)
    files = _files(text, source, colours)
    main = next(iter(files))
    sizes: dict[str, int] = {}
    _count(main, files, sizes, (), source)
    if not 0 < sizes[main] <= MAX_BLOCKS:
        raise InputError(f"{source}: parts", sizes[main], f"1 to {MAX_BLOCKS} bricks")
    start = _PartPlace(np.eye(3), np.zeros(3), None, main, source)
    places = list(_expand(start, files, colours))
    stepped = any(line is None for file in files.values() for line in file.lines)
    title = files[main].title or name
    return _on_lattice(places, kit, source, stepped, title)


def to_ldraw(assembly: Assembly) -> str:
    """The finished assembly as LDraw text, a step after every block that steps place.

    Raises:
        InputError: for a block that no part of LDraw is like.
    """
    ordered = {step.place for step in assembly.steps}
    title = " ".join((assembly.name or "model").split())
    lines = [f"0 {title}", "0 Name: model.ldr", "0 Author: learn2assemble"]
    for block, box in bricks_of(assembly):
        ldu = (box[1] - box[0]) / LDU
        x, y, z = ldu.round().astype(int).tolist()
        part = PARTS.get((max(x, y), min(x, y), z))
        if part is None or np.abs(ldu - [x, y, z]).max() > 20 * _EXACT:
            got = " x ".join(f"{edge * 1e3:.4g}" for edge in box[1] - box[0]) + " mm"
            raise InputError(f"block {block.id!r}", got, "the size of a brick that LDraw has here")
        middle = box.mean(0) / LDU
        at = " ".join(_number(v) for v in (middle[0], -box[1, 2] / LDU, middle[1]))
        lines.append(f"1 {code_of(block.colour)} {at} {_TURNS[y > x]} {part}.dat")
        if block.id in ordered:
            lines.append("0 STEP")
    return "\n".join([*lines, "0"]) + "\n"


def _number(value: float) -> str:
    return f"{round(value, 4):g}" if round(value, 4) else "0"


def _files(text: str, source: str, colours: dict[int, tuple[int, int, int]]) -> dict[str, _File]:
    """The models of a file by name in lower case, the first one being the whole."""
    files: dict[str, _File] = {}
    current: _File | None = None
    for number, raw in enumerate(text.splitlines(), 1):
        words = raw.split()
        if not words:
            continue
        where = f"{source}: line {number}"
        if words[0] == "0":
            meta = words[1].upper() if len(words) > 1 else ""
            if meta == "FILE":
                key = raw.split(None, 2)[2].strip().lower() if len(words) > 2 else ""
                if not key or key in files:
                    raise InputError(where, key, "a new name of a submodel")
                current = files[key] = _File("", [])
                continue
            if meta == "NOFILE":
                current = _File("", [])
                continue
            if current is None:
                current = files[""] = _File("", [])
            if meta in ("STEP", "ROTSTEP"):
                current.lines.append(None)
            elif meta == "!COLOUR":
                _add_colour(words, colours)
            elif not current.title and not current.lines and meta[:1] not in ("!", "/"):
                current = _titled(current, raw.split(None, 1)[1:], files)
        elif words[0] == "1":
            if current is None:
                current = files[""] = _File("", [])
            current.lines.append(_line(raw, words, where))
        elif words[0] not in ("2", "3", "4", "5"):
            raise InputError(where, raw, "a line of LDraw, which begins with 0 to 5")
    if not files:
        raise InputError(source, "no model", "LDraw with a line of a part")
    return files


def _titled(file: _File, words: list[str], files: dict[str, _File]) -> _File:
    """The same file with its title, which is its first comment."""
    title = words[0].strip() if words else ""
    named = file._replace(title=title if len(title) <= 200 and title.isprintable() else "")
    for key, one in files.items():
        if one is file:
            files[key] = named
    return named


def _add_colour(words: list[str], colours: dict[int, tuple[int, int, int]]) -> None:
    """A colour that the file defines: ``0 !COLOUR name CODE 4 VALUE #C91A09 ...``."""
    try:
        code = int(words[words.index("CODE") + 1])
        red, green, blue = bytes.fromhex(words[words.index("VALUE") + 1].lstrip("#"))
    except (ValueError, IndexError):
        return
    colours[code] = red, green, blue


def _line(raw: str, words: list[str], where: str) -> _PartLine:
    if len(words) < 15:
        raise InputError(where, raw, "1 colour x y z a b c d e f g h i part")
    try:
        numbers = np.array(words[2:14], float)
    except ValueError:
        raise InputError(where, raw, "twelve numbers after the colour") from None
    if not np.isfinite(numbers).all() or np.abs(numbers).max() > 1e7:
        raise InputError(where, raw, "numbers up to 1e7")
    return _PartLine(words[1], numbers[3:].reshape(3, 3), numbers[:3], " ".join(words[14:]), where)


def _count(
    name: str, files: dict[str, _File], sizes: dict[str, int], above: tuple[str, ...], source: str
) -> int:
    """Parts of a model with its submodels, before anything of that number is made."""
    if name in above:
        loop = " in ".join([name, *reversed(above[above.index(name) :])])
        raise InputError(f"{source}: submodels", loop, "no submodel that holds itself")
    if len(above) > MAX_NESTED:
        raise InputError(f"{source}: submodels", "deeper nesting", f"at most {MAX_NESTED} levels")
    if name not in sizes:
        total = 0
        for line in files[name].lines:
            if line is None:
                continue
            key = line.name.lower()
            total += _count(key, files, sizes, (*above, name), source) if key in files else 1
        sizes[name] = total
    return sizes[name]


def _expand(
    place: _PartPlace, files: dict[str, _File], colours: dict[int, tuple[int, int, int]]
) -> Iterator[_PartPlace]:
    """All parts of a model, in the order of its lines."""
    for line in files[place.name].lines:
        if line is None:
            continue
        turn, at = place.turn @ line.turn, place.turn @ line.at + place.at
        colour = _colour(line, place.colour, colours)
        inner = _PartPlace(turn, at, colour, line.name.lower(), line.where)
        if inner.name in files:
            yield from _expand(inner, files, colours)
        else:
            yield inner


def _colour(
    line: _PartLine, main: tuple[int, int, int] | None, colours: dict[int, tuple[int, int, int]]
) -> tuple[int, int, int] | None:
    word = line.colour
    if re.fullmatch("(0x|#)[0-9a-fA-F]{7,8}", word):
        red, green, blue = bytes.fromhex(word[-6:])
        return red, green, blue
    if not re.fullmatch(r"\d{1,6}", word):
        raise InputError(f"{line.where}: colour", word, "a code such as 4, or 0x2RRGGBB")
    code = int(word)
    if code == MAIN:
        return main
    if code not in colours:
        # The transparent colours of the first table are the opaque ones in the same order.
        near = f", as {code - 32}" if 32 < code < 48 else ""
        raise InputError(f"{line.where}: colour", code, f"an opaque colour{near}, or 0x2RRGGBB")
    return colours[code]


def _on_lattice(
    places: list[_PartPlace], kit: Kit, source: str, stepped: bool, title: str
) -> BrickModel:
    """The parts as bricks on one lattice."""
    stud, layer = kit.pitch[0] / LDU, kit.pitch[2] / LDU
    boxes = list[tuple[np.ndarray, np.ndarray]]()
    for place in places:
        length, width, height = size_of_part(place.name, place.where)
        extent = np.abs(place.turn) @ [length, height, width]
        upright = abs(place.turn[1, 1] - 1) < _EXACT
        whole = np.abs(np.abs(place.turn) - np.round(np.abs(place.turn))).max() < _EXACT
        unit = np.abs(np.abs(place.turn).sum(0) - 1).max() < _EXACT
        if not (upright and whole and unit):
            got = " ".join(f"{v:g}" for v in place.turn.reshape(-1))
            raise InputError(f"{place.where}: turn", got, "an upright part turned by quarters")
        size = np.round([extent[0], extent[2], height])
        # Of LDraw's axes, z becomes y, and y, which points down, becomes -z.
        top = np.array([place.at[0], place.at[2], -place.at[1]])
        boxes.append((top - [size[0] / 2, size[1] / 2, size[2]], size))
    low, size = (np.array(part) for part in zip(*boxes, strict=True))
    pitch = np.array([stud, stud, layer])
    origin = np.array([low[0, 0] % stud, low[0, 1] % stud, low[0, 2]])
    cells, sizes = (low - origin) / pitch, size / pitch
    for k, place in enumerate(places):
        if np.abs(sizes[k] - sizes[k].round()).max() > _EXACT:
            got = f"part {place.name}"
            raise InputError(place.where, got, f"a part of the lattice of kit {kit.name}")
        off = np.abs(cells[k] - cells[k].round())
        if off.max() > _EXACT * 10:
            at = " ".join(f"{v:g}" for v in place.at)
            raise InputError(
                f"{place.where}: place", at, f"a place on the lattice of the first part ({source})"
            )
    whole, extents = np.round(cells).astype(int).tolist(), np.round(sizes).astype(int).tolist()
    bricks = tuple(
        Brick((x, y, z), (a, b, c), place.where, place.colour)
        for (x, y, z), (a, b, c), place in zip(whole, extents, places, strict=True)
    )
    ordered = stepped and len(bricks) > 1
    shift = float(origin[0] * LDU), float(origin[1] * LDU)
    return BrickModel(bricks, ordered, title, shift)
