"""Files of designs, opened: their content, and which kind it is."""

from __future__ import annotations

import re
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from learn2assemble.assembly.blocks import check_count
from learn2assemble.assembly.bricks.files import is_of_bricks
from learn2assemble.design.reading import FOLDER
from learn2assemble.errors import InputError, UnknownNameError, printable
from learn2assemble.files import MAX_BYTES, as_path, decoded, nearest, read_bytes
from learn2assemble.values import load_json

GOALS = b'"learn2assemble-goals"'
"""What a file of goals says of its format."""
MAX_FILE = 64_000_000
"""Largest file [bytes]; most kinds have a smaller limit of their own."""


@dataclass(frozen=True, eq=False)
class DesignFile:
    """What a file holds.

    Args:
        name: of the file, without its ending.
        source: what messages call it.
        kind: see :func:`kind_of`.
        document: the value in a file of JSON; None for others.
        folder: where it is a folder of meshes; None for files.
    """

    name: str
    source: str
    kind: str
    content: bytes
    document: Any = None
    folder: Path | None = None


def open_design(path: str | Path, names: Collection[str] = ()) -> DesignFile:
    """The content of the file of a design, or a folder with a mesh for each block.

    Args:
        names: of what is no file; a word that is none of them may be one that is misspelt.

    Raises:
        InputError: for what cannot be read, damaged JSON and content of no known kind.
    """
    path = as_path(path, "design")
    alone = path.suffix == "" and len(path.parts) < 2
    if names and alone and not (path.exists() or nearest(path)):
        raise UnknownNameError("design", str(path), names)
    if path.is_dir():
        from learn2assemble.assembly.files import NAME, meshes_in  # It loads much.

        if not (path / NAME).is_file():
            meshes_in(path, printable(str(path)))
        return DesignFile(path.name, printable(str(path)), FOLDER, b"", folder=path)
    content, source = read_bytes(path, "design file", MAX_FILE)
    kind, document = kind_of(content, source), None
    if begin(content)[:1] in (b"{", b"["):
        if kind == "assembly":  # Every block has vertices: far too many are not even parsed.
            check_count(max(content.count(b'"vertices"'), 1), source)
        elif kind != "bricks" and len(content) > MAX_BYTES:
            raise InputError(source, f"{len(content)} bytes", f"at most {MAX_BYTES} bytes")
        document = load_json(decoded(content, source), source, "design file")
    return DesignFile(path.stem or "design", source, kind, content, document)


def begin(content: bytes) -> bytes:
    """The first bytes of a file that mean something."""
    return content[:4096].removeprefix(b"\xef\xbb\xbf").lstrip()


def kind_of(content: bytes, source: str) -> str:
    """The kind of a file: a key of the table of options, ``"assembly"``, ``"bricks"`` or
    ``"goals"``.

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
    if is_of_bricks(content):
        return "bricks"
    start = begin(content)
    if start[:1] in (b"{", b"["):
        if start[:1] == b"{" and GOALS in content:
            return "goals"
        ours = re.search(rb'"format"\s*:\s*"learn2assemble-assembly"', content)
        compas = re.search(rb'"dtype"\s*:\s*"compas', content)
        return "assembly" if ours or compas else "json"
    if start[:1] == b"<" and b"<svg" in content:
        return "svg"
    if re.match(rb"(999[^\n]*\n[^\n]*\n\s*)*0[ \t]*\r?\n\s*SECTION", start):
        return "dxf"
    if start.startswith(b"solid") and re.search(rb"\bfacet\b", content):
        return "stl"
    if re.search(rb"^v\s+[-+.\d]", content, re.MULTILINE) and b"\0" not in start:
        return "obj"
    shown = ascii(content[:12].decode("latin-1"))
    got = f"{len(content)} bytes that begin with {shown}" if content else "an empty file"
    if content.startswith(b"\x1f\x8b"):
        got = "a file packed with gzip"
    elif Path(source).suffix.casefold() == ".stl":
        got = f"{got}; its header says {facets} triangles"
    elif Path(source).suffix.casefold() == ".txt" and content:
        raise InputError(source, got, "brick text, with lines such as 4x2 (0,0,0)")
    raise InputError(
        source,
        got,
        "a whole file of elevation JSON, SVG, DXF, PNG, JPEG, WebP, STL, OBJ, PLY, GLB, OFF, 3DM, "
        "NPY, NPZ, LDraw, brick text or assembly JSON",
    )
