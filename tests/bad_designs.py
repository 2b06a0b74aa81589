"""Designs that must be refused: name, content of the file, and what the message must say.

The content is bytes, or a callable that prepares a path under the given folder.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

BOX = [[-0.05, 0.0], [-0.05, 0.1], [0.05, 0.1], [0.05, 0.0]]
"""A valid outline, two blocks wide and high [m]."""
GOOD: dict[str, Any] = {
    "format": "learn2assemble-design",
    "version": 1,
    "name": "Box",
    "elevations": [{"name": "front", "outline": BOX}],
}
"""A valid design; every bad one below differs in one thing."""


class BadDesign(NamedTuple):
    name: str
    content: bytes | Callable[[Path], Path]
    fragment: str


def but(**changes: Any) -> bytes:
    """The good design with some keys changed."""
    return json.dumps(GOOD | changes).encode()


def without(key: str) -> bytes:
    return json.dumps({k: v for k, v in GOOD.items() if k != key}).encode()


def outlines(*outline: Any) -> bytes:
    """The good design with these outlines."""
    return but(elevations=[{"outline": o} for o in outline])


def at(index: int, vertex: Any) -> bytes:
    """The good design with one vertex replaced."""
    return outlines([*BOX[:index], vertex, *BOX[index + 1 :]])


def text(old: str, new: str) -> bytes:
    """The good design with a piece of its text replaced."""
    whole = json.dumps(GOOD)
    assert old in whole
    return whole.replace(old, new, 1).encode()


def _missing(folder: Path) -> Path:
    return folder / "nosuch.json"


def _folder(folder: Path) -> Path:
    return folder


def _broken_link(folder: Path) -> Path:
    link = folder / "link.json"
    link.symlink_to(folder / "gone.json")
    return link


def _pipe(folder: Path) -> Path:
    pipe = folder / "pipe.json"
    os.mkfifo(pipe)
    return pipe


def _under_a_file(folder: Path) -> Path:
    (folder / "file").write_bytes(b"")
    return folder / "file" / "x.json"


def _long_name(folder: Path) -> Path:
    return folder / ("x" * 400)


def _null_byte(folder: Path) -> Path:
    return folder / "a\0b.json"


def _line_break(folder: Path) -> Path:
    path = folder / "two\nlines.json"
    path.write_bytes(b"{")
    return path


WIDE = [[-0.1, 0.0], [-0.1, 0.1], [0.1, 0.1], [0.1, 0.0]]
BOW_TIE = [[-0.1, 0.0], [0.1, 0.1], [0.1, 0.0], [-0.1, 0.1]]
ANNOTATED = [{"name": "front", "outline": BOX, "colour": "red"}]
SAME_NAME = [{"name": "a", "outline": BOX}, {"name": "a", "outline": BOX}]
TOUCHING = [[-0.1, 0.0], [-0.1, 0.1], [0.0, 0.0], [0.1, 0.1], [0.1, 0.0], [0.0, 0.0]]
SPIKE = [[-0.05, 0.0], [-0.05, 0.1], [0.0, 0.1], [0.0, 0.2], [0.0, 0.1], [0.05, 0.1], [0.05, 0.0]]
COMB = [[k / 1000, 0.1 if k % 2 else 0.2] for k in range(-32, 32)] + [[0.1, 0.0]]
CELL = [[-0.0265, 0.0], [-0.0265, 0.0555], [-0.005, 0.0555], [0.0, 0.065], [0.005, 0.0555],
        [0.0265, 0.0555], [0.0265, 0.0]]  # fmt: skip
FACE = [[-0.025, 0.0], [-0.025, 0.05], [0.025, 0.05], [0.025, 0.0]]

BAD = [
    # the file
    BadDesign("missing", _missing, "no such file"),
    BadDesign("directory", _folder, "a directory"),
    BadDesign("broken link", _broken_link, "no such file"),
    BadDesign("pipe", _pipe, "not a plain file"),
    BadDesign("inside a file", _under_a_file, "no such file"),
    BadDesign("name too long", _long_name, "expected"),
    BadDesign("null byte in the name", _null_byte, "no file name"),
    BadDesign("line break in the name", _line_break, "two\\nlines.json"),
    BadDesign("too large", b" " * 1_000_001, "more than 1000000 bytes"),
    # the text
    BadDesign("empty", b"", "an empty file"),
    BadDesign("blank", b" \n\t\n", "an empty file"),
    BadDesign("not UTF-8", b'{"name": "\xff"}', "byte 0xff at offset 10"),
    BadDesign("UTF-16", json.dumps(GOOD).encode("utf-16"), "UTF-8 text"),
    BadDesign("binary", bytes(range(32)), "expected JSON"),
    BadDesign("not JSON", b"a house", "line 1 column 1"),
    BadDesign("cut off", json.dumps(GOOD).encode()[:-5], "expected JSON"),
    BadDesign("trailing comma", text('"Box",', '"Box",,'), "column"),
    BadDesign("single quotes", text('"Box"', "'Box'"), "expected JSON"),
    BadDesign("comment", b"// a house\n" + json.dumps(GOOD).encode(), "line 1 column 1"),
    BadDesign("two documents", json.dumps(GOOD).encode() * 2, "Extra data"),
    BadDesign("deep lists", b"[" * 100_000 + b"]" * 100_000, "nested too deeply"),
    BadDesign("deep objects", b'{"a":' * 50_000 + b"1" + b"}" * 50_000, "nested too deeply"),
    BadDesign("huge integer", text("0.05", "1" * 5000), "numbers of ordinary size"),
    # the outer object
    BadDesign("a list", b"[]", "a JSON object"),
    BadDesign("a number", b"3", "a JSON object"),
    BadDesign("null", b"null", "a JSON object"),
    BadDesign("empty object", b"{}", "the key 'format'"),
    BadDesign("no format", without("format"), "the key 'format'"),
    BadDesign("other format", but(format="ifc"), "format: got 'ifc'"),
    BadDesign("format is a list", but(format=[1]), "format: got [1]"),
    BadDesign("foreign file", b'{"format": "gltf", "meshes": []}', "expected 'learn2assemble-"),
    BadDesign("no version", without("version"), "the key 'version'"),
    BadDesign("version 2", but(version=2), "version: got 2, expected 1"),
    BadDesign("version 1.0", but(version=1.0), "an integer"),
    BadDesign("version true", but(version=True), "version: got True"),
    BadDesign("version text", but(version="1"), "version: got '1'"),
    BadDesign("no name", without("name"), "the key 'name'"),
    BadDesign("name is a number", but(name=3), "name: got 3, expected text"),
    BadDesign("name is empty", but(name=""), "some text"),
    BadDesign("name is blank", but(name="  "), "some text"),
    BadDesign("name of two lines", but(name="a\nb"), "printable"),
    BadDesign("name with an escape", but(name="\x1b[31m"), "printable"),
    BadDesign("name with half a character", text('"Box"', '"\\ud800"'), "printable"),
    BadDesign("name too long to print", but(name="x" * 101), "at most 100 characters"),
    BadDesign("description is null", but(description=None), "description: got None"),
    BadDesign("description too long", but(description="x" * 2001), "at most 2000 characters"),
    BadDesign("description with half a character", but(description="\udcff"), "printable"),
    BadDesign("inches", but(units="in"), "metres"),
    BadDesign("units is null", but(units=None), "metres"),
    BadDesign("unknown key", but(block=9), "did you mean 'blocks'?"),
    BadDesign("key in capitals", but(Blocks=9), "did you mean 'blocks'?"),
    BadDesign("key twice", text('"name": "Box"', '"name": "a", "name": "b"'), "every key once"),
    BadDesign("same key twice", text('"version": 1', '"version": 1, "version": 1'), "'version'"),
    # the terms
    BadDesign("blocks is 0", but(blocks=0), "blocks: got 0, expected 2 to 400"),
    BadDesign("one block", but(blocks=1), "the first one included"),
    BadDesign("blocks below zero", but(blocks=-3), "blocks: got -3"),
    BadDesign("too many blocks", but(blocks=10**9), "2 to 400"),
    BadDesign("blocks is a float", but(blocks=9.0), "an integer"),
    BadDesign("blocks is true", but(blocks=True), "blocks: got True"),
    BadDesign("blocks is null", but(blocks=None), "blocks: got None"),
    BadDesign("blocks is NaN", but(blocks=float("nan")), "blocks: got nan"),
    BadDesign("first block is a number", but(first_block=0), "first_block: got 0"),
    BadDesign("first block is empty", but(first_block={}), "the key 'elevation' in first_block"),
    BadDesign("first block elsewhere", but(first_block={"elevation": 1}), "0 to 0"),
    BadDesign("first block before", but(first_block={"elevation": -1}), "got -1"),
    BadDesign("first block by name", but(first_block={"elevation": "front"}), "an integer"),
    BadDesign("first block column", but(first_block={"elevation": 0, "column": 1}), "'column'"),
    BadDesign("threshold 0", but(success_threshold=0), "0 < threshold < 1"),
    BadDesign("threshold 1", but(success_threshold=1.0), "0 < threshold < 1"),
    BadDesign("threshold in percent", but(success_threshold=97.5), "got 97.5"),
    BadDesign("threshold is NaN", but(success_threshold=float("nan")), "a finite number"),
    BadDesign("threshold is true", but(success_threshold=True), "a number"),
    BadDesign("supports is 1", but(supports=1), "true or false"),
    BadDesign("supports is text", but(supports="no"), "true or false"),
    # the elevations
    BadDesign("no elevations", without("elevations"), "the key 'elevations'"),
    BadDesign("elevations empty", but(elevations=[]), "1 to 4 elevations"),
    BadDesign("five elevations", outlines(BOX, BOX, BOX, BOX, BOX), "5 of them"),
    BadDesign("elevations is an object", but(elevations=GOOD["elevations"][0]), "1 to 4"),
    BadDesign("elevation is a list", but(elevations=[BOX]), "elevations[0]: got"),
    BadDesign("elevation is null", but(elevations=[None]), "elevations[0]: got None"),
    BadDesign("elevation empty", but(elevations=[{}]), "the key 'outline' in elevations[0]"),
    BadDesign("elevation key", but(elevations=ANNOTATED), "key of elevations[0]: got 'colour'"),
    BadDesign("elevation misspelt", but(elevations=[{"outlin": BOX}]), "did you mean 'outline'?"),
    BadDesign("elevation key twice", text('"outline"', '"outline": 1, "outline"'), "key of elev"),
    BadDesign("elevation name", but(elevations=[{"name": 1, "outline": BOX}]), "].name: got 1"),
    BadDesign("elevation name blank", but(elevations=[{"name": "", "outline": BOX}]), "some text"),
    BadDesign("two of one name", but(elevations=SAME_NAME), "elevations[1].name: got 'a'"),
    BadDesign("wide pavilion", outlines(WIDE, WIDE, WIDE), "3 elevations are the faces"),
    BadDesign("wide left side", outlines(BOX, BOX, BOX, WIDE), "elevations[3].outline"),
    # the outlines
    BadDesign("outline is text", outlines("box"), "[x, z] vertices"),
    BadDesign("outline is an object", outlines({"x": 0}), "elevations[0].outline: got"),
    BadDesign("outline empty", outlines([]), "0 vertices"),
    BadDesign("two vertices", outlines(BOX[:2]), "2 vertices"),
    BadDesign("65 vertices", outlines(COMB), "65 vertices"),
    BadDesign("vertex is a number", outlines([1, 2, 3]), "outline[0]: got 1"),
    BadDesign("vertex of one", at(2, [0.05]), "outline[2]: got [0.05]"),
    BadDesign("vertex of three", at(1, [0, 0, 0.1]), "two numbers in metres"),
    BadDesign("vertex is text", at(3, ["0.05", 0]), "outline[3]: got '0.05'"),
    BadDesign("vertex is true", at(0, [True, 0]), "outline[0]: got True"),
    BadDesign("vertex is null", at(0, [None, 0]), "a number"),
    BadDesign("vertex is NaN", at(1, [float("nan"), 0.1]), "outline[1][0]: got nan"),
    BadDesign("vertex is infinite", at(1, [-0.05, float("inf")]), "a finite number"),
    BadDesign("vertex overflows", text("0.05", "1e999"), "a finite number"),
    BadDesign("vertex beyond floats", text("0.05", "1" + "0" * 400), "a finite number"),
    BadDesign("second outline", outlines(BOX, [*BOX[:3], [9, 0]]), "elevations[1].outline[3]"),
    BadDesign("below the table", at(0, [-0.05, -0.01]), "below the table"),
    BadDesign("just below the table", at(0, [-0.05, -1e-6]), "below the table"),
    BadDesign("millimetres", outlines([[0, 0], [0, 100], [100, 0]]), "|x| <= 0.35"),
    BadDesign("too far right", at(2, [0.3501, 0.1]), "what the camera can see"),
    BadDesign("too high", at(2, [0.05, 0.61]), "z <= 0.6 m"),
    BadDesign("closed by hand", outlines([*BOX, BOX[0]]), "the outline closes by itself"),
    BadDesign("vertex twice", outlines([BOX[0], *BOX]), "other than the one before it"),
    BadDesign("on one line", outlines([[-0.1, 0.0], [0.0, 0.1], [0.1, 0.2]]), "zero area"),
    BadDesign("all on the table", outlines([[-0.1, 0], [0.0, 0], [0.1, 0]]), "zero area"),
    BadDesign("bow tie", outlines(BOW_TIE), "Self-intersection[0"),
    BadDesign("touches itself", outlines(TOUCHING), "neither crosses nor touches itself"),
    BadDesign("spike", outlines(SPIKE), "neither crosses nor touches itself"),
    BadDesign("small", outlines([[0, 0], [0, 0.05], [0.05, 0]]), "at least one block face"),
    BadDesign("one block face", outlines(FACE), "pixels in total"),
    BadDesign("filled by the first block", outlines(CELL), "first block fills"),
]
