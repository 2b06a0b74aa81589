"""Assemblies in files: our JSON, the JSON of COMPAS assemblies, and meshes, one a block.

The kind of a file is found from its content. Our format is::

    {"format": "learn2assemble-assembly", "version": 1, "units": "m", "friction": 0.5,
     "blocks": [{"id": "a", "kind": "1x2", "density": 1000, "support": false, "prop": false,
                 "vertices": [[x, y, z], ...], "faces": [[0, 1, 2], ...]}, ...],
     "steps": [{"place": "a"}, {"remove": "a"}, ...]}

COMPAS JSON is read and written with the standard library: a graph whose nodes hold a mesh each, as
``compas_assembly`` and ``compas_cra`` write it. Friction, density and steps, which COMPAS does not
know, travel as attributes.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal
from uuid import NAMESPACE_URL, uuid5

import numpy as np

from learn2assemble.assembly.blocks import MAX_BLOCKS, Assembly, Block, Step, shells
from learn2assemble.assembly.meshes import KINDS, mesh_kind, read_parts
from learn2assemble.errors import InputError, UnknownNameError, is_number, look_up
from learn2assemble.files import (
    UNITS,
    boolean,
    check_keys,
    decoded,
    from_plain,
    integer,
    load_json,
    mapping,
    number,
    printable,
    read_bytes,
    read_head,
    sequence,
    text,
    to_plain,
    write_file,
)  # fmt: skip

FORMAT, VERSION = "learn2assemble-assembly", 1
KIND = "file of blocks: JSON, a mesh, or a folder of meshes"
MAX_BYTES = 64_000_000
"""Largest file; of a folder, all files together."""
DIGITS = 9
"""Of coordinates written."""
NAME = "assembly.json"
"""What the blocks of a plan are called, in its folder."""
MESH_SUFFIXES = tuple(f".{kind}" for kind in KINDS)
_BLOCK_KEYS = ("id", "kind", "density", "support", "prop", "colour", "vertices", "faces")
_KEYS = ("format", "version", "units", "name", "friction", "blocks", "steps")
_COMPAS_ASSEMBLIES = (
    "compas_cra.datastructures/CRA_Assembly",
    "compas_assembly.datastructures/Assembly",
)
"""The class that is written, and the one to use where compas_cra is not installed."""
_COMPAS_BLOCK = "compas_assembly.datastructures/Block"


def read_assembly(
    path: str | Path,
    *,
    unit: float | str = 1.0,
    up: Literal["y", "z"] | None = None,
    supports: Collection[str] = (),
) -> Assembly:
    """Read an assembly from a file, or from a folder with one mesh a block.

    Meshes whose name begins with ``support`` are supports. Without any support, the plane z = 0 is
    the ground.

    Args:
        path: our JSON, COMPAS JSON, STL, OBJ, PLY, OFF or GLB; a folder of such meshes; or a plan,
            its folder or its ``plan.json``, with ``assembly.json`` beside it.
        unit: of the file: ``mm``, ``cm``, ``m``, ``in``, or its length in metres; our JSON is
            always in metres.
        up: the axis of a mesh that points up; by default y for GLB, whose standard says so, else z.
        supports: ids of blocks that are supports besides those the file names.

    Raises:
        InputError: for whatever is not a readable assembly of valid blocks; UnknownNameError for a
            support that is no block.
    """
    path = Path(path)
    # What l2a build has written names its blocks in a file of their own.
    beside = path / NAME if path.is_dir() else path.with_name(NAME)
    if (path.is_dir() or path.name == "plan.json") and beside.is_file():
        path = beside
    source = printable(str(path))
    if isinstance(unit, str):
        unit = look_up("unit", unit, UNITS)
    if not is_number(unit, 1e-6, 1e6):
        raise InputError("unit", unit, "metres in a unit of the file, from 1e-6 to 1e6")
    if path.is_dir():
        assembly = _read_folder(path, source, unit, up)
    else:
        content, source = read_bytes(path, KIND, MAX_BYTES)
        if content.lstrip(b"\xef\xbb\xbf \t\r\n")[:1] in (b"{", b"["):
            assembly = _read_json(content, path, source, unit)
        else:
            blocks = _mesh_blocks(content, source, "block", unit, up)
            assembly = Assembly(tuple(blocks), name=path.stem)
    return _with_supports(assembly, supports)


def write_assembly(assembly: Assembly, path: str | Path) -> None:
    """Write our format, all or nothing.

    Raises:
        InputError: where the file cannot be written.
    """
    write_file(Path(path), _compact(to_json(assembly)), "assembly")


def write_compas(assembly: Assembly, path: str | Path) -> None:
    """Write COMPAS JSON, all or nothing; see :func:`to_compas`.

    Raises:
        InputError: where the file cannot be written.
    """
    write_file(Path(path), _compact(to_compas(assembly)), "assembly")


def to_json(assembly: Assembly) -> dict[str, Any]:
    """The JSON document of our format."""
    blocks = [
        {
            "id": block.id,
            "kind": block.kind,
            "density": block.density,
            "support": block.support,
            "prop": block.prop,
            **({"colour": list(block.colour)} if block.colour else {}),
            "vertices": np.round(block.vertices, DIGITS).tolist(),
            "faces": [list(face) for face in block.faces],
        }
        for block in assembly.blocks
    ]
    return {
        "format": FORMAT, "version": VERSION, "units": "m",
        **({"name": assembly.name} if assembly.name else {}), "friction": assembly.friction,
        "blocks": blocks, "steps": [to_plain(step) for step in assembly.steps],
    }  # fmt: skip


def from_json(document: Any, source: str = "assembly") -> Assembly:
    """The assembly of a JSON document of our format.

    Raises:
        InputError: with the path of what is wrong; unknown keys are refused.
    """
    root = read_head(document, source, FORMAT, VERSION, _KEYS, ("format", "version", "blocks"))
    given = sequence(root["blocks"], f"{source}: blocks", "a list of blocks")
    _check_count(len(given), source)
    blocks = []
    for place, entry in enumerate(given):
        where = f"blocks[{place}]"
        block = mapping(entry, f"{source}: {where}")
        check_keys(block, source, where, _BLOCK_KEYS, ("id", "vertices", "faces"))
        where = f"{source}: {where}"
        blocks.append(
            Block(
                text(block["id"], f"{where}.id"),
                _coordinates(block["vertices"], f"{where}.vertices"),
                _indices(block["faces"], f"{where}.faces"),
                kind=text(block.get("kind", ""), f"{where}.kind"),
                density=number(block.get("density", 1000.0), f"{where}.density"),
                support=boolean(block.get("support", False), f"{where}.support"),
                prop=boolean(block.get("prop", False), f"{where}.prop"),
                colour=_own_colour(block.get("colour"), f"{where}.colour"),
            )
        )
    friction = number(root.get("friction", 0.5), f"{source}: friction")
    steps = from_plain(tuple[Step, ...], root.get("steps", ()), source, "steps")
    name = text(root.get("name", ""), f"{source}: name")
    return Assembly(tuple(blocks), steps, friction, name)


def to_compas(assembly: Assembly) -> dict[str, Any]:
    """The JSON document of a COMPAS assembly, which ``compas.json_load`` reads.

    Identifiers are made from the ids of the blocks, so that the same assembly gives the same file.
    """
    nodes: dict[str, Any] = {}
    for place, block in enumerate(assembly.blocks):
        attributes = {
            "name": block.id, "node": place, "kind": block.kind, "density": block.density,
            "prop": block.prop, "colour": block.colour,
        }  # fmt: skip
        vertices = np.round(block.vertices, DIGITS).tolist()
        data = {
            "attributes": attributes,
            "default_vertex_attributes": {"x": 0.0, "y": 0.0, "z": 0.0},
            "default_edge_attributes": {},
            "default_face_attributes": {},
            "vertex": {
                str(k): dict(zip("xyz", xyz, strict=True)) for k, xyz in enumerate(vertices)
            },
            "face": {str(k): list(face) for k, face in enumerate(block.faces)},
            "facedata": {str(k): {} for k in range(len(block.faces))},
            "edgedata": {},
            "max_vertex": len(vertices) - 1,
            "max_face": len(block.faces) - 1,
        }
        mesh = {
            "dtype": _COMPAS_BLOCK, "data": data, "name": block.id,
            "inheritance": ["compas.datastructures/Mesh"],
            "guid": str(uuid5(NAMESPACE_URL, f"{place}/{block.id}")),
        }  # fmt: skip
        nodes[str(place)] = {"block": mesh, "is_support": block.support}
    graph = {
        "attributes": {"name": "Graph"},
        "default_node_attributes": {
            "block": None, "is_support": False, "section": None, "mesh_size": None,
        },
        "default_edge_attributes": {"interfaces": None},
        "node": nodes,
        "edge": {key: {} for key in nodes},
        "max_node": len(nodes) - 1,
    }  # fmt: skip
    attributes = {
        "name": assembly.name or "Assembly", "friction": assembly.friction, "units": "m",
        "steps": [to_plain(step) for step in assembly.steps],
    }  # fmt: skip
    return {
        "dtype": _COMPAS_ASSEMBLIES[0],
        "data": {
            "attributes": attributes,
            "graph": {"dtype": "compas.datastructures/Graph", "data": graph},
        },
        "inheritance": list(_COMPAS_ASSEMBLIES[1:]),
        "guid": str(uuid5(NAMESPACE_URL, assembly.name)),
    }


def from_compas(document: Any, source: str = "assembly", unit: float = 1.0) -> Assembly:
    """The assembly of a COMPAS document; blocks turned inside out are turned back.

    The name of a block becomes its id where all names differ, else the key of its node does.

    Raises:
        InputError: where it holds no graph of meshes, or a mesh that is no block.
    """
    data = _compas_data(document, source)
    graph = _compas_data(data.get("graph"), f"{source}: graph")
    nodes = mapping(graph.get("node"), f"{source}: graph.node")
    _check_count(len(nodes), source)
    meshes: list[tuple[str, bool, Mapping[str, Any], Mapping[str, Any]]] = []
    for key, entry in nodes.items():
        where = f"{source}: node {key!r}"
        node = mapping(entry, where)
        mesh = _compas_data(node.get("block"), f"{where}: block")
        extra = mapping(mesh.get("attributes") or {}, f"{where}: attributes")
        support = boolean(node.get("is_support") or False, f"{where}: is_support")
        meshes.append((key, support, mesh, extra))
    names = [extra.get("name") for _, _, _, extra in meshes]
    named = all(isinstance(n, str) and n for n in names) and len(set(names)) == len(names)
    blocks = []
    for (key, support, mesh, extra), name in zip(meshes, names, strict=True):
        where = f"{source}: node {key!r}"
        vertex = mapping(mesh.get("vertex"), f"{where}: vertex")
        rows = [
            [mapping(at, f"{where}: vertex {k!r}").get(axis, 0.0) for axis in "xyz"]
            for k, at in vertex.items()
        ]
        order = {label: k for k, label in enumerate(vertex)}
        faces = []
        for label, face in mapping(mesh.get("face"), f"{where}: face").items():
            corners = sequence(face, f"{where}: face {label!r}", "a list of vertices")
            unknown = [k for k in corners if str(k) not in order]
            if unknown:
                raise InputError(f"{where}: face {label!r}", unknown[0], "a key of a vertex")
            faces.append(tuple(order[str(k)] for k in corners))
        density = number(extra.get("density") or 1000.0, f"{where}: density")
        kind = text(extra.get("kind") or "", f"{where}: kind")
        id_ = str(name) if named else str(key)
        points = _coordinates(rows, f"{where}: vertex") * unit
        prop = extra.get("prop") is True
        made = outward(id_, points, tuple(faces), kind=kind, density=density,
                       support=support, prop=prop)  # fmt: skip
        blocks.append(replace(made, colour=_colour(extra.get("colour"))))
    attributes = mapping(data.get("attributes") or {}, f"{source}: attributes")
    friction = number(attributes.get("friction", 0.5), f"{source}: friction")
    steps = from_plain(tuple[Step, ...], attributes.get("steps") or (), source, "steps")
    name = attributes.get("name")
    return Assembly(tuple(blocks), steps, friction, name if isinstance(name, str) else "")


def outward(id: str, vertices: np.ndarray, faces: tuple[tuple[int, ...], ...], **kwargs) -> Block:
    """A block whose faces may all be turned inside; arguments as :class:`Block`."""
    try:
        return Block(id, vertices, faces, **kwargs)
    except InputError as error:
        if not error.what.endswith(": volume"):
            raise
    return Block(id, vertices, tuple(face[::-1] for face in faces), **kwargs)


def _read_json(content: bytes, path: Path, source: str, unit: float) -> Assembly:
    document = mapping(load_json(decoded(content, source), source, FORMAT), source)
    if "dtype" in document:
        assembly = from_compas(document, source, unit)
    else:
        if "format" not in document:
            expected = f'"format": "{FORMAT}", or the "dtype" of a COMPAS assembly'
            raise InputError(source, sorted(document)[:6], expected)
        assembly = from_json(document, source)
    return assembly if assembly.name else replace(assembly, name=path.stem)


def _compact(document: dict[str, Any]) -> str:
    return json.dumps(document, separators=(",", ":"))


def _compas_data(value: Any, where: str) -> Mapping[str, Any]:
    """What a COMPAS object holds, with or without its envelope."""
    given = mapping(value, where)
    for key in ("data", "value"):
        if "dtype" in given and key in given:
            return mapping(given[key], where)
    return given


def _check_count(count: int, source: str) -> None:
    if not 0 < count <= MAX_BLOCKS:
        raise InputError(f"{source}: blocks", count, f"1 to {MAX_BLOCKS} blocks")


def _coordinates(rows: Any, where: str) -> np.ndarray:
    expected = "a list of points [x, y, z]"
    points = sequence(rows, where, expected)
    for k, row in enumerate(points):
        if len(sequence(row, f"{where}[{k}]", expected)) != 3:
            raise InputError(f"{where}[{k}]", row, "three numbers")
        for value in row:
            number(value, f"{where}[{k}]")
    return np.array(points, np.float64).reshape(-1, 3)


def _indices(faces: Any, where: str) -> tuple[tuple[int, ...], ...]:
    expected = "a list of lists of vertex numbers"
    rows = sequence(faces, where, expected)
    return tuple(
        tuple(integer(k, f"{where}[{n}]")
              for k in sequence(row, f"{where}[{n}]", expected))
        for n, row in enumerate(rows)
    )  # fmt: skip


def _colour(value: Any) -> tuple[int, int, int] | None:
    """A colour where it is one; files of others may hold anything there."""
    if isinstance(value, list) and len(value) == 3 and all(type(k) is int for k in value):
        return (value[0], value[1], value[2])
    return None


def _own_colour(value: Any, where: str) -> tuple[int, int, int] | None:
    """A colour of our own format."""
    found = _colour(value)
    if value is not None and (found is None or not all(0 <= k <= 255 for k in found)):
        raise InputError(where, value, "three whole numbers from 0 to 255")
    return found


def _with_supports(assembly: Assembly, supports: Collection[str]) -> Assembly:
    wanted = set(supports)
    unknown = wanted - {block.id for block in assembly.blocks}
    if unknown:
        raise UnknownNameError("support", sorted(unknown)[0], [b.id for b in assembly.blocks])
    if not wanted:
        return assembly
    blocks = (replace(b, support=True) if b.id in wanted else b for b in assembly.blocks)
    return replace(assembly, blocks=tuple(blocks))


def _read_folder(path: Path, source: str, unit: float, up: Literal["y", "z"] | None) -> Assembly:
    files = sorted(p for p in path.iterdir() if p.suffix.lower() in MESH_SUFFIXES)
    if not files:
        expected = f"{NAME} or {' '.join(MESH_SUFFIXES)}"
        raise InputError(source, "a folder without a plan or meshes", expected)
    _check_count(len(files), source)
    blocks: list[Block] = []
    left = MAX_BYTES
    for file in files:
        content, where = read_bytes(file, "mesh", MAX_BYTES)
        left -= len(content)
        if left < 0:
            raise InputError(source, "larger files", f"at most {MAX_BYTES // 10**6} MB in all")
        found = list(_mesh_blocks(content, where, file.stem, unit, up))
        # One mesh in a file is called as the file is, whatever the mesh calls itself.
        if len(found) == 1:
            support = file.stem.lower().startswith("support")
            found = [replace(found[0], id=file.stem, support=support)]
        blocks += found
    return Assembly(tuple(blocks), name=path.name)


def _mesh_blocks(
    content: bytes, source: str, stem: str, unit: float, up: Literal["y", "z"] | None
) -> Iterator[Block]:
    """The blocks of a mesh file: one for each object of a scene, or for each shell of a mesh."""
    import trimesh

    kind = mesh_kind(content)
    if kind == "obj" and not any(line[:2] == b"v " for line in content.splitlines()):
        got = "an unknown format" if content.strip() else "an empty file"
        raise InputError(source, got, "JSON or a mesh (STL, OBJ, PLY, OFF, GLB)")
    objects = []
    for part in read_parts(content, kind, source):
        mesh = trimesh.Trimesh(part.vertices, part.faces, process=False)
        mesh.merge_vertices(merge_tex=True, merge_norm=True)
        objects.append((part.name, np.asarray(mesh.vertices), mesh.faces.tolist()))
    _check_count(len(objects), source)
    # A quarter turn about x takes y to z.
    turn = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]) if _up(kind, up) == "y" else np.eye(3)
    many = Counter(name for name, _, _ in objects)
    for place, (name, vertices, faces) in enumerate(objects):
        id_ = stem if len(objects) == 1 else name if many[name] == 1 else f"{name}-{place}"
        points = unit * vertices @ turn.T
        support = id_.lower().startswith("support")
        whole = outward(id_, points, tuple(map(tuple, faces)), support=support)
        if len(objects) > 1:
            yield whole
            continue
        # Where shells share an edge it is ambiguous which faces belong together.
        edges = Counter((f[k - 1], f[k]) for f in whole.faces for k in range(len(f)))
        if max(edges.values()) > 1:
            expected = "one file, or one object of a scene, for each block that touches another"
            raise InputError(f"{source}: {id_}", "blocks that share edges", expected)
        yield from shells(whole)


def _up(kind: str, up: Literal["y", "z"] | None) -> str:
    if up not in (None, "y", "z"):
        raise InputError("up", up, "'y' or 'z'")
    return up or ("y" if kind == "glb" else "z")
