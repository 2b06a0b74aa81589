"""Meshes in files: the objects of an STL, OBJ, PLY, OFF or GLB file.

Nothing is read that a header only promises, and whatever the library raises about a damaged file
becomes one line.
"""

from __future__ import annotations

import io
import json
import logging
import re
import warnings
from collections import Counter
from typing import Any, NamedTuple

import numpy as np

from learn2assemble.errors import InputError, trusted
from learn2assemble.files import FARTHEST

MAX_NODES = 10_000
"""Of a GLB scene, each of which may be an instance of a mesh."""
MAX_TRIANGLES = 200_000
MAX_BYTES = 50_000_000
"""Largest mesh file."""
KINDS = ("stl", "obj", "ply", "glb", "off")
_COMMENT = re.compile(rb"^([ \t]*(?:f|vt?|vn)[ \t][^#\n]*)#[^\n]*", re.MULTILINE)
"""Behind the numbers of an OBJ file, where the library reads on; names may have this sign."""


class MeshPart(NamedTuple):
    """An object of a mesh file, where it is in the scene."""

    name: str
    vertices: np.ndarray
    """float64[V, 3], in units of the file."""
    faces: np.ndarray
    """int64[F, 3]."""


def mesh_kind(content: bytes) -> str:
    """The format of a mesh, one of :data:`KINDS`, from its content; OBJ is what nothing else is."""
    if content[:4] == b"glTF":
        return "glb"
    if content[:3] == b"ply":
        return "ply"
    if content.lstrip()[:3] == b"OFF":
        return "off"
    triangles = int.from_bytes(content[80:84], "little")
    binary = len(content) == 84 + 50 * triangles
    return "stl" if binary or content.lstrip()[:5] == b"solid" else "obj"


def read_parts(content: bytes, kind: str, source: str) -> list[MeshPart]:
    """The objects of a mesh file.

    Args:
        kind: one of :data:`KINDS`.
        source: what errors call the file.

    Raises:
        InputError: for what is too large, damaged, or says more than it holds.
    """
    import trimesh

    library: Any = trimesh
    check_size(content, source)
    _promises(content, kind, source)
    if kind == "glb":
        content = _geometry_only(content, source)
    logging.getLogger("trimesh").addHandler(logging.NullHandler())
    options: dict[str, Any] = {"process": False}
    if kind == "obj":
        content = _counted_from_one(_COMMENT.sub(rb"\1", content), source)
        options |= {"split_objects": True, "group_material": False, "skip_materials": True}
    expected = "a whole mesh file"
    with trusted(source, expected, f" as {kind.upper()}"), np.errstate(all="ignore"):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            scene = library.load_scene(io.BytesIO(content), file_type=kind, **options)
        parts = list[MeshPart]()
        for node in scene.graph.nodes_geometry:
            transform, name = scene.graph[node]
            mesh = scene.geometry[name]
            if isinstance(mesh, trimesh.Trimesh):
                vertices = trimesh.transform_points(mesh.vertices, transform)
                faces = np.asarray(mesh.faces, np.int64)
                parts.append(MeshPart(str(node), np.asarray(vertices, np.float64), faces))
    return checked(parts, source)


def check_size(content: bytes, source: str) -> None:
    """Refuse a file that is larger than any mesh taken."""
    if len(content) > MAX_BYTES:
        got = f"{len(content) / 1e6:.4g} MB"
        raise InputError(source, got, f"a mesh of at most {MAX_BYTES // 1_000_000} MB")


def checked(parts: list[MeshPart], source: str) -> list[MeshPart]:
    """Those of ``parts`` that have faces, if their vertices are in space."""
    parts = [part for part in parts if len(part.faces)]
    count = sum(len(part.faces) for part in parts)
    if not 0 < count <= MAX_TRIANGLES:
        raise InputError(source, f"{count} triangles", f"1 to {MAX_TRIANGLES} triangles")
    for _, vertices, faces in parts:
        if vertices.shape[1] != 3 or faces.min() < 0 or faces.max() >= len(vertices):
            raise InputError(source, "faces without vertices in space", "a whole mesh file")
        if not np.isfinite(vertices).all() or np.abs(vertices).max() > FARTHEST:
            raise InputError(source, "coordinates that are not numbers or beyond 1e9", "a mesh")
    return parts


def _promises(content: bytes, kind: str, source: str) -> None:
    """Refuse a header that promises more than the file can hold."""
    promised = 0
    if kind == "ply":
        counts = re.findall(rb"^element\s+\w+\s+(\d{1,40})", content[:10_000], re.MULTILINE)
        promised = sum(map(int, counts))
    elif kind == "stl" and content.lstrip()[:5] != b"solid":
        promised = int.from_bytes(content[80:84], "little")
    elif kind == "off":
        lines = re.sub(rb"#[^\n]*", b"", content[:10_000]).replace(b"OFF", b"", 1).split()
        promised = sum(int(word) for word in lines[:2] if word.isdigit())
        held = sum(1 for line in content.splitlines() if line.split(b"#", 1)[0].strip())
        if held < promised + 1:  # The counts may stand in the first line.
            got = f"{promised} vertices and faces in {held} lines"
            raise InputError(source, got, "a whole mesh file")
    elif kind == "obj":
        promised = content.count(b"\nv ") + content.count(b"\nf ")
    if promised > min(len(content), 4 * MAX_TRIANGLES):
        got = f"{promised} vertices and faces in {len(content)} bytes"
        raise InputError(source, got, f"a whole mesh file, at most {MAX_TRIANGLES} triangles")


def groups_as_objects(content: bytes, source: str) -> bytes | None:
    """An OBJ file with its groups as its objects, as Rhino may name objects and layers.

    Returns:
        None where it names objects, where it has fewer than two groups, and where one of them is
        no closed surface.

    Raises:
        InputError: for faces that name vertices that there are not.
    """
    if not re.search(rb"^[ \t]*g[ \t]+\S", content, re.MULTILINE):
        return None
    content = re.sub(rb"\\\r?\n", b" ", _counted_from_one(content, source))
    name, edges = b"", dict[bytes, Counter[tuple[bytes, bytes]]]()
    lines = content.splitlines()
    for place, line in enumerate(lines):
        key, *words = line.split() or [b""]
        if key == b"o":
            return None
        if key == b"g":
            name = b" ".join(words)
            lines[place] = b"o " + name
        elif key == b"f":
            written = line.split(b"#", 1)[0].split()[1:]
            corners = [word.split(b"/", 1)[0] for word in written]
            around = zip(corners, [*corners[1:], corners[0]], strict=True) if corners else ()
            edges.setdefault(name, Counter()).update(around)
    closed = all(one[b, a] == n for one in edges.values() for (a, b), n in one.items())
    return b"\n".join(lines) if closed and len(edges) > 1 else None


def _counted_from_one(content: bytes, source: str) -> bytes:
    """An OBJ file whose faces name no vertex by how far back it is.

    Such a number counts from the face; the library counts from the end of the file.
    """
    joined = re.sub(rb"\\\r?\n", b" ", content)
    if not re.search(rb"^[ \t]*f\s[^\n]*-", joined, re.MULTILINE):
        return content
    counts, lines = {b"v": 0, b"vt": 0, b"vn": 0}, joined.splitlines()
    for place, line in enumerate(lines):
        key, *corners = line.split(b"#", 1)[0].split() or [b""]
        if key in counts:
            counts[key] += 1
        elif key == b"f" and any(b"-" in corner for corner in corners):
            corners = [_counted_corner(corner, list(counts.values()), source) for corner in corners]
            lines[place] = b" ".join([key, *corners])
    return b"\n".join(lines)


def _counted_corner(corner: bytes, counts: list[int], source: str) -> bytes:
    """A corner of a face, ``v/vt/vn``, counted from 1.

    Args:
        counts: vertices, texture coordinates and normals before the face.
    """
    made = list[bytes]()
    for word, count in zip(corner.split(b"/"), counts, strict=False):
        back = re.fullmatch(rb"-(\d{1,18})", word)
        if back and not 1 <= int(back[1]) <= count:
            got = f"a face with {word.decode()}, after {count} of what it counts"
            raise InputError(source, got, "a whole mesh file")
        made.append(str(count + 1 - int(back[1])).encode() if back else word)
    return b"/".join(made)


def _geometry_only(content: bytes, source: str) -> bytes:
    """A GLB file without textures and the like, once its promises are checked."""
    expected = "a whole GLB file, its meshes not compressed"
    length = int.from_bytes(content[12:16], "little")
    try:
        if int.from_bytes(content[8:12], "little") > len(content):
            raise ValueError("it is cut short")
        root = json.loads(content[20 : 20 + length])
        accessors = root.get("accessors", [])
        if sum(max(a["count"], 0) for a in accessors) > 20 * MAX_TRIANGLES or any(
            "bufferView" not in a or "sparse" in a for a in accessors
        ):
            raise ValueError("too many or sparse values")
        if len(root.get("nodes", [])) > MAX_NODES:
            raise ValueError(f"more than {MAX_NODES} nodes")
        faces = [_primitives(root, node) for node in root.get("nodes", [])]
        if sum(faces) > MAX_TRIANGLES:
            raise ValueError(f"more than {MAX_TRIANGLES} triangles")
        if root.get("extensionsRequired"):
            raise ValueError(f"extensions {root['extensionsRequired']}")
        for key in ("materials", "textures", "images", "samplers", "animations", "skins"):
            root.pop(key, None)
        for mesh in root.get("meshes", []):
            for primitive in mesh["primitives"]:
                primitive.pop("material", None)
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError, IndexError) as error:
        reason = f"{type(error).__name__}: {error}"
        raise InputError(source, f"GLB that cannot be read ({reason})", expected) from None
    text = json.dumps(root).encode()
    text += b" " * (-len(text) % 4)
    rest = content[20 + length :]
    head = b"glTF" + (2).to_bytes(4, "little") + (20 + len(text) + len(rest)).to_bytes(4, "little")
    return head + len(text).to_bytes(4, "little") + b"JSON" + text + rest


def _primitives(root: dict[str, Any], node: dict[str, Any]) -> int:
    """Triangles of a node of a GLB scene."""
    if "mesh" not in node:
        return 0
    used = [
        p.get("indices", p["attributes"]["POSITION"])
        for p in root["meshes"][node["mesh"]]["primitives"]
    ]
    return sum(root["accessors"][k]["count"] for k in used) // 3
