"""Assemblies in files: our JSON, the JSON of COMPAS assemblies, and meshes, one a block.

The kind of a file is found from its content. Our format is::

    {"format": "learn2assemble-assembly", "version": 1, "units": "m", "friction": 0.5,
     "joint": {"law": "clutch", "capacity": 0.7}, "joints": [{"blocks": ["a", "b"], "law": "dry"}],
     "blocks": [{"id": "a", "kind": "1x2", "density": 1000, "support": false, "prop": false,
                 "vertices": [[x, y, z], ...], "faces": [[0, 1, 2], ...]}, ...],
     "steps": [{"place": "a"}, {"hold": "a"}, {"release": "a"}, {"remove": "a"}, ...],
     "not_built": ["b"]}

How joints hold (``joint``, and ``joints`` of two blocks or a kind) is :mod:`.joints`; without it
they are dry. COMPAS JSON is :mod:`.compas`; files of bricks are :mod:`.bricks.files`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from learn2assemble.assembly.blocks import Assembly, Block, check_count, outward
from learn2assemble.assembly.bricks.files import brick_format, of_stablelego, read_bricks
from learn2assemble.assembly.bricks.stablelego import is_stablelego
from learn2assemble.assembly.compas import from_compas
from learn2assemble.assembly.joints import (
    DRY,
    joint_to_json,
    joints_to_json,
)
from learn2assemble.assembly.kit import Kit, load_kit
from learn2assemble.assembly.meshes import KINDS, groups_as_objects, mesh_kind, read_parts
from learn2assemble.assembly.parts import shells
from learn2assemble.assembly.values import compact, written
from learn2assemble.errors import (
    InputError,
    UnknownNameError,
    check_instance,
    is_number,
    look_up,
    printable,
)
from learn2assemble.files import UNITS, as_path, check_new, decoded, read_bytes, write_file
from learn2assemble.values import load_json, mapping, read_document, to_plain

FORMAT, VERSION = "learn2assemble-assembly", 1
KIND = "file of blocks: JSON, a mesh, or a folder of meshes"
MAX_BYTES = 64_000_000
"""Largest file; of a folder, all files together."""
NAME = "assembly.json"
"""What the blocks of a plan are called, in its folder."""
MESH_SUFFIXES = tuple(f".{kind}" for kind in KINDS)


def read_assembly(
    path: str | Path,
    *,
    unit: float | str | None = 1.0,
    up: Literal["y", "z"] | None = None,
    supports: Collection[str] = (),
    kit: str | Kit | None = None,
) -> Assembly:
    """Read an assembly from a file, or from a folder with one mesh a block.

    Meshes whose name begins with ``support`` are supports. Without any support, the plane z = 0 is
    the ground.

    Args:
        path: our JSON, COMPAS JSON, STL, OBJ, PLY, OFF or GLB; LDraw, brick text or JSON of
            StableLego; a folder of meshes; or a plan, its folder or its ``plan.json``, with
            ``assembly.json`` beside it.
        unit: of meshes and COMPAS JSON: ``mm``, ``cm``, ``m``, ``in``, or its length in metres; our
            JSON is always in metres. None: as the file says; meshes that do not say it are refused.
        up: the axis of a mesh that points up; by default y for GLB, whose standard says so, else z.
        supports: ids of blocks that are supports besides those the file names.
        kit: whose blocks a file of bricks names, by default ``lego``; of other files, whose joints
            hold them where the file says nothing of joints.

    Raises:
        InputError: for whatever is not a readable assembly of valid blocks; UnknownNameError for a
            support that is no block.
    """
    path = as_path(path, "assembly")
    check_instance("supports", supports, Collection, "ids of blocks")
    # What l2a build has written names its blocks in a file of their own.
    beside = path / NAME if path.is_dir() else path.with_name(NAME)
    if (path.is_dir() or path.name == "plan.json") and beside.is_file():
        path = beside
    source = printable(str(path))
    length = look_up("unit", unit, UNITS) if isinstance(unit, str) else unit
    if length is not None and not is_number(length, 1e-6, 1e6):
        raise InputError("unit", unit, "metres in a unit of the file, from 1e-6 to 1e6")
    if path.is_dir():
        assembly = _with_joints(_read_folder(path, source, length, up), kit)
    else:
        content, source = read_bytes(path, KIND, MAX_BYTES)
        if isinstance(unit, str) and _is_json(content) and b'"dtype"' not in content:
            raise InputError("unit", unit, f"none: {source} is in metres, or of bricks")
        if isinstance(unit, str) and brick_format(content) is not None:
            raise InputError("unit", unit, f"none: {source} is of bricks, whose size is known")
        assembly = parse_assembly(content, source, path.stem, unit=length, up=up, kit=kit)
    return _with_supports(assembly, supports)


def parse_assembly(
    content: bytes,
    source: str,
    name: str,
    *,
    document: Any = None,
    unit: float | None = 1.0,
    up: Literal["y", "z"] | None = None,
    kit: str | Kit | None = None,
) -> Assembly:
    """The assembly of the content of a file; see :func:`read_assembly`.

    Args:
        source: what messages call the file.
        name: of the assembly, where the file has none.
        document: the value in it, where it is JSON that has been parsed.
        unit: of the file [m]; None: as it says.
    """
    if _is_json(content):
        if document is None:  # Every block has vertices: far too many are not even parsed.
            check_count(max(content.count(b'"vertices"'), 1), source)
            document = load_json(decoded(content, source), source, FORMAT)
        assembly = _of_document(mapping(document, source), source, name, unit or 1.0, kit)
    elif brick_format(content) is not None:
        assembly = read_bricks(content, source, name, kit)
    else:
        blocks = _mesh_blocks(content, source, "block", unit, up)
        return _with_joints(Assembly(tuple(blocks), name=name), kit)
    if up is not None:
        raise InputError("up", up, f"none: {source} is no mesh, so z is up")
    return _with_joints(assembly, kit)


def _is_json(content: bytes) -> bool:
    return content.lstrip(b"\xef\xbb\xbf \t\r\n")[:1] in (b"{", b"[")


def write_assembly(assembly: Assembly, path: str | Path, *, overwrite: bool = False) -> None:
    """Write our format, all or nothing.

    Args:
        path: a new file.
        overwrite: also one that is there.

    Raises:
        InputError: where the file is there, or cannot be written.
    """
    check_new(path := as_path(path, "path"), "path", overwrite=overwrite)
    write_file(path, compact(to_json(assembly)), "assembly")


def to_json(assembly: Assembly) -> dict[str, Any]:
    """The JSON document of our format."""
    blocks = [{**to_plain(block), "vertices": written(block.vertices)} for block in assembly.blocks]
    return {
        "format": FORMAT,
        "version": VERSION,
        "units": "m",
        **({"name": assembly.name} if assembly.name else {}),
        "friction": assembly.friction,
        "blocks": blocks,
        "steps": [to_plain(step) for step in assembly.steps],
        **({"not_built": list(assembly.not_built)} if assembly.not_built else {}),
        **({"joint": joint_to_json(assembly.joint)} if assembly.joint != DRY else {}),
        **({"joints": joints_to_json(assembly.joints)} if assembly.joints else {}),
    }


def from_json(document: Any, source: str = "assembly") -> Assembly:
    """The assembly of a JSON document of our format.

    Raises:
        InputError: with the path of what is wrong; unknown keys are refused.
    """
    blocks: Any = mapping(document, source).get("blocks")
    listed: object = blocks
    if isinstance(listed, list):
        check_count(len(blocks), source)
    return read_document(Assembly, document, source, FORMAT, VERSION)[0]


def _with_joints(assembly: Assembly, kit: str | Kit | None) -> Assembly:
    """With the joints of a kit where nothing is said of them."""
    if kit is None or assembly.joint != DRY or assembly.joints:
        return assembly
    return replace(assembly, joint=kit.joint if isinstance(kit, Kit) else load_kit(kit).joint)


def _of_document(
    document: Mapping[str, Any], source: str, name: str, unit: float, kit: str | Kit | None
) -> Assembly:
    if is_stablelego(document):
        return of_stablelego(document, source, name, kit)
    if "dtype" in document:
        assembly = from_compas(document, source, unit)
    else:
        if "format" not in document:
            expected = f'"format": "{FORMAT}", or the "dtype" of a COMPAS assembly'
            raise InputError(source, sorted(document)[:6], expected)
        assembly = from_json(document, source)
    return assembly if assembly.name else replace(assembly, name=name)


def _with_supports(assembly: Assembly, supports: Collection[str]) -> Assembly:
    wanted = set(supports)
    unknown = wanted - {block.id for block in assembly.blocks}
    if unknown:
        raise UnknownNameError("support", sorted(unknown)[0], [b.id for b in assembly.blocks])
    if not wanted:
        return assembly
    blocks = (replace(b, support=True) if b.id in wanted else b for b in assembly.blocks)
    return replace(assembly, blocks=tuple(blocks))


def meshes_in(path: Path, source: str) -> list[Path]:
    """The meshes in a folder that has no plan.

    Raises:
        InputError: where there are none.
    """
    files = sorted(p for p in path.iterdir() if p.suffix.lower() in MESH_SUFFIXES)
    if not files:
        expected = f"{NAME} or {' '.join(MESH_SUFFIXES)}"
        raise InputError(source, "a folder without a plan or meshes", expected)
    return files


def _read_folder(
    path: Path, source: str, unit: float | None, up: Literal["y", "z"] | None
) -> Assembly:
    files = meshes_in(path, source)
    check_count(len(files), source)
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
    content: bytes, source: str, stem: str, unit: float | None, up: Literal["y", "z"] | None
) -> Iterator[Block]:
    """The blocks of a mesh file: one for each object of a scene, or for each shell of a mesh or of
    a group of an OBJ file without objects."""
    import trimesh

    kind = mesh_kind(content)
    if kind == "obj" and not any(line[:2] == b"v " for line in content.splitlines()):
        got = "an unknown format" if content.strip() else "an empty file"
        meshes = "a mesh (STL, OBJ, PLY, OFF, GLB)"
        raise InputError(source, got, f"JSON, LDraw, brick text (as 4x2 (0,0,0)) or {meshes}")
    if unit is None and kind != "glb":
        raise InputError("unit", None, f"mm, cm, m or in: {source} does not say it")
    objects = list[tuple[str, np.ndarray, list[list[int]]]]()
    grouped = groups_as_objects(content, source) if kind == "obj" else None
    for part in read_parts(content if grouped is None else grouped, kind, source):
        mesh: Any = trimesh.Trimesh(part.vertices, part.faces, process=False)
        mesh.merge_vertices(merge_tex=True, merge_norm=True)
        objects.append((part.name, np.asarray(mesh.vertices), mesh.faces.tolist()))
    check_count(len(objects), source)
    # A quarter turn about x takes y to z.
    turn = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]) if _up(kind, up) == "y" else np.eye(3)
    many = Counter(name for name, _, _ in objects)
    for place, (name, vertices, faces) in enumerate(objects):
        id_ = stem if len(objects) == 1 else name if many[name] == 1 else f"{name}-{place}"
        points = (unit or 1.0) * vertices @ turn.T
        support = id_.lower().startswith("support")
        whole = outward(id_, points, tuple(map(tuple, faces)), support=support)
        if len(objects) > 1 and grouped is None:
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
