"""COMPAS assemblies, read and written with the standard library: a graph whose nodes hold a mesh
each, as ``compas_assembly`` and ``compas_cra`` write it, or a part with a mesh, as ``compas`` does.

Friction, density, steps and props, which COMPAS does not know, travel as attributes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple
from uuid import NAMESPACE_URL, uuid5

import numpy as np

from learn2assemble.assembly.blocks import Assembly, AssemblyStep, Block, check_count, outward
from learn2assemble.assembly.boxes import box_block
from learn2assemble.assembly.values import any_colour, compact, coordinates, written
from learn2assemble.errors import InputError
from learn2assemble.files import write_file
from learn2assemble.values import boolean, from_plain, mapping, number, sequence, text, to_plain

_COMPAS_ASSEMBLIES = (
    "compas_cra.datastructures/CRA_Assembly",
    "compas_assembly.datastructures/Assembly",
)
"""The class that is written, and the one to use where compas_cra is not installed."""
_COMPAS_BLOCK = "compas_assembly.datastructures/Block"
_WORLD = {"point": [0, 0, 0], "xaxis": [1, 0, 0], "yaxis": [0, 1, 0]}
"""The frame of a part that is not elsewhere than its mesh."""
_LEVEL = 1e-6
"""How far the top of the ground may be from z = 0 [m]."""


def write_compas(assembly: Assembly, path: str | Path) -> None:
    """Write COMPAS JSON, all or nothing; see :func:`to_compas`.

    Raises:
        InputError: where the file cannot be written.
    """
    write_file(Path(path), compact(to_compas(assembly)), "assembly")


def to_compas(assembly: Assembly) -> dict[str, Any]:
    """The JSON document of a COMPAS assembly, which ``compas.json_load`` reads.

    Its nodes are what stands in the end, each with ``is_support``, its centre (``x``, ``y``, ``z``)
    and the number of the step that places it (``step``, from 1; None without an order); its edges
    hold the interfaces. Where no block is a support, a slab below z = 0 is one, with the attribute
    ``ground``. The attributes of the assembly hold the whole order (``steps``), the meshes of
    ``props`` that are taken away again and of blocks that are ``not_built``, with the ids of the
    latter, friction and units.

    Identifiers are made from the ids of the blocks, so that the same assembly gives the same file.
    """
    finished = assembly.finished
    place = {block.id: k for k, block in enumerate(assembly.blocks)}
    nodes: dict[str, Any] = {}
    number = {step.place: k for k, step in enumerate(assembly.steps, 1)}
    for block in finished.blocks:
        nodes[str(place[block.id])] = {
            **dict(zip("xyz", written(block.centroid), strict=True)),
            "block": _compas_mesh(block, place[block.id]),
            "is_support": block.support,
            "step": number.get(block.id),
        }
    ground = len(assembly.blocks)
    if not any(block.support for block in finished.blocks):
        slab = _ground_slab(finished)
        nodes[str(ground)] = {
            **dict(zip("xyz", written(slab.centroid), strict=True)),
            "block": _compas_mesh(slab, ground),
            "is_support": True,
            "step": None,
            "ground": True,
        }
    graph = {
        "attributes": {"name": "Graph"},
        "default_node_attributes": {
            "x": 0.0,
            "y": 0.0,
            "z": 0.0,
            "block": None,
            "is_support": False,
            "section": None,
            "mesh_size": None,
            "displacement": [0, 0, 0, 0, 0, 0],
            "step": None,
            "ground": False,
        },
        "default_edge_attributes": {"interfaces": None},
        "node": nodes,
        "edge": _compas_edges(finished, [place[block.id] for block in finished.blocks], ground),
        "max_node": max(map(int, nodes)),
    }
    attributes = {
        "name": assembly.name or "Assembly",
        "friction": assembly.friction,
        "units": "m",
        "steps": [to_plain(step) for step in assembly.steps],
        "props": [
            _compas_mesh(block, k)
            for block in assembly.blocks
            if str(k := place[block.id]) not in nodes
        ],
        **({"not_built": list(assembly.not_built)} if assembly.not_built else {}),
    }
    return {
        "dtype": _COMPAS_ASSEMBLIES[0],
        "data": {
            "attributes": attributes,
            "graph": {"dtype": "compas.datastructures/Graph", "data": graph},
        },
        "inheritance": list(_COMPAS_ASSEMBLIES[1:]),
        "guid": str(uuid5(NAMESPACE_URL, assembly.name)),
    }


def _compas_mesh(block: Block, place: int) -> dict[str, Any]:
    """A block of compas_assembly; ``place`` is its number in our assembly and that of its node."""
    vertices: list[list[float]] = written(block.vertices)
    data: dict[str, Any] = {
        "attributes": {
            "name": block.id,
            "node": place,
            "kind": block.kind,
            "density": block.density,
            "prop": block.prop,
            "colour": block.colour,
        },
        "default_vertex_attributes": {"x": 0.0, "y": 0.0, "z": 0.0},
        "default_edge_attributes": {},
        "default_face_attributes": {},
        "vertex": {str(k): dict(zip("xyz", xyz, strict=True)) for k, xyz in enumerate(vertices)},
        "face": {str(k): list(face) for k, face in enumerate(block.faces)},
        "facedata": {str(k): {} for k in range(len(block.faces))},
        "edgedata": {},
        "max_vertex": len(vertices) - 1,
        "max_face": len(block.faces) - 1,
    }
    return {
        "dtype": _COMPAS_BLOCK,
        "data": data,
        "name": block.id,
        "inheritance": ["compas.datastructures/Mesh"],
        "guid": str(uuid5(NAMESPACE_URL, f"{place}/{block.id}")),
    }


def _ground_slab(assembly: Assembly) -> Block:
    """The plane z = 0 as a block: a tenth of the extent thick, and as much wider on every side."""
    points = np.concatenate([block.vertices for block in assembly.blocks])
    margin = 0.1 * float(np.ptp(points, axis=0).max())
    low, high = points.min(0) - margin, points.max(0) + margin
    return box_block("ground", (low[0], low[1], -margin), (high[0], high[1], 0.0), support=True)


def _compas_edges(assembly: Assembly, nodes: Sequence[int], ground: int) -> dict[str, Any]:
    """The edges of a graph whose nodes are the blocks of an assembly, with their interfaces: the
    polygons of contact, each with a frame whose normal points from the first node to the second."""
    from learn2assemble.assembly.contacts import GROUND, across, find_contacts

    edges: dict[str, dict[str, Any]] = {str(node): {} for node in (*nodes, ground)}
    contacts = find_contacts(assembly)
    basis = across(contacts.normal)
    for k, (first, last) in enumerate(pairwise(contacts.start)):
        points = contacts.points[first:last]
        frame: dict[str, np.ndarray] = {
            "point": points.mean(0),
            "xaxis": basis[k, 0],
            "yaxis": basis[k, 1],
        }
        interface: dict[str, Any] = {
            "dtype": "compas_assembly.datastructures/Interface",
            "data": {
                "points": written(points),
                "size": float(contacts.area[k]),
                "frame": {
                    "dtype": "compas.geometry/Frame",
                    "data": {key: written(at) for key, at in frame.items()},
                },
                "forces": None,
                "mesh": None,
            },
        }
        a = ground if contacts.a[k] == GROUND else nodes[int(contacts.a[k])]
        edge = edges[str(a)].setdefault(str(nodes[int(contacts.b[k])]), {"interfaces": []})
        edge["interfaces"].append(interface)
    return edges


def from_compas(document: Any, source: str = "assembly", unit: float = 1.0) -> Assembly:
    """The assembly of a COMPAS document; blocks turned inside out are turned back.

    The name of a block becomes its id where all names differ, else the key of its node does. A node
    with the attribute ``ground`` stands for the plane z = 0, as :func:`to_compas` writes it, where
    its slab ends there and nothing else is a support.

    Raises:
        InputError: where it holds no graph of meshes, or a mesh that is no block.
    """
    data = _compas_data(document, source)
    if "graph" not in data:
        kind = mapping(document, source).get("dtype", sorted(data))
        raise InputError(source, kind, "an Assembly of COMPAS, whose blocks are meshes")
    graph = _compas_data(data.get("graph"), f"{source}: graph")
    attributes = mapping(data.get("attributes") or {}, f"{source}: attributes")
    meshes: list[_CompasMesh] = []
    ground: list[_CompasMesh] = []
    for key, entry in mapping(graph.get("node"), f"{source}: graph.node").items():
        where = f"{source}: node {key!r}"
        node = mapping(entry, where)
        support = boolean(node.get("is_support") or False, f"{where}: is_support")
        if node.get("block") is None and node.get("part") is not None:
            mesh = _CompasMesh.of_part(str(key), node["part"], where, support)
        else:
            mesh = _CompasMesh.of(str(key), node.get("block"), where, support)
        (ground if node.get("ground") is True else meshes).append(mesh)
    moved = any(abs(one.block("ground", unit).vertices[:, 2].max()) > _LEVEL for one in ground)
    if moved or any(mesh.support for mesh in meshes):
        meshes += ground  # No longer the plane z = 0: a support like others.
    props = sequence(attributes.get("props") or (), f"{source}: props", "a list of meshes")
    for k, mesh in enumerate(props):
        meshes.append(_CompasMesh.of(f"prop-{k}", mesh, f"{source}: props[{k}]", False))
    check_count(len(meshes), source)
    if len({mesh.place for mesh in meshes} - {None}) == len(meshes):
        meshes.sort(key=lambda mesh: mesh.place or 0)
    names = [mesh.extra.get("name") for mesh in meshes]
    named = all(isinstance(n, str) and n for n in names) and len(set(names)) == len(names)
    blocks = tuple(
        mesh.block(str(name) if named else mesh.key, unit)
        for mesh, name in zip(meshes, names, strict=True)
    )
    friction = number(attributes.get("friction", 0.5), f"{source}: friction")
    steps = from_plain(tuple[AssemblyStep, ...], attributes.get("steps") or (), source, "steps")
    left = from_plain(tuple[str, ...], attributes.get("not_built") or (), source, "not_built")
    name = attributes.get("name")
    return Assembly(blocks, steps, friction, name if isinstance(name, str) else "", left)


class _CompasMesh(NamedTuple):
    """A mesh of a COMPAS document, and what is known of it."""

    key: str
    support: bool
    mesh: Mapping[str, Any]
    extra: Mapping[str, Any]
    """Its attributes."""
    where: str
    """What messages call it."""

    @classmethod
    def of(cls, key: str, value: Any, where: str, support: bool) -> _CompasMesh:
        if value is None:
            expected = "a block of compas_assembly, or a part of compas whose geometry is a Mesh"
            raise InputError(f"{where}: block", None, expected)
        mesh = _compas_data(value, f"{where}: block")
        extra = mapping(mesh.get("attributes") or {}, f"{where}: attributes")
        return cls(key, support, mesh, extra, where)

    @classmethod
    def of_part(cls, key: str, value: Any, where: str, support: bool) -> _CompasMesh:
        """A part of COMPAS's own assembly, which has its mesh among its attributes."""
        part = _compas_data(value, f"{where}: part")
        extra = mapping(part.get("attributes") or {}, f"{where}: part.attributes")
        inside = f"{where}: part.attributes.geometry"
        geometry: Any = extra.get("geometry")
        given: object = geometry
        known = isinstance(given, Mapping)
        mesh: Mapping[str, Any] = _compas_data(geometry, inside) if known else {}
        if "vertex" not in mesh:
            kind: Any = mapping(geometry, inside).get("dtype") if known else geometry
            raise InputError(inside, kind, "a Mesh in world coordinates (Mesh.from_shape)")
        where_of = f"{where}: part.frame"
        frame = mapping(part.get("frame") or {}, where_of)
        told = [k for k in _WORLD if k in frame]
        if not np.allclose(
            coordinates([frame[k] for k in told], where_of),
            np.reshape([_WORLD[k] for k in told], (-1, 3)),
            atol=1e-9,
        ):
            # COMPAS does not say whether geometry is told in it.
            raise InputError(where_of, dict(frame), "that of the world, with the mesh in its place")
        return cls(key, support or extra.get("is_support") is True, mesh, extra, where)

    @property
    def place(self) -> int | None:
        """Its number among the blocks, where :func:`to_compas` has written it."""
        number = self.extra.get("node")
        return number if type(number) is int else None

    def block(self, id_: str, unit: float) -> Block:
        """The block it is, in metres."""
        where, extra = self.where, self.extra
        vertex = mapping(self.mesh.get("vertex"), f"{where}: vertex")
        rows = [
            [mapping(at, f"{where}: vertex {k!r}").get(axis, 0.0) for axis in "xyz"]
            for k, at in vertex.items()
        ]
        order = {label: k for k, label in enumerate(vertex)}
        faces = list[tuple[int, ...]]()
        for label, face in mapping(self.mesh.get("face"), f"{where}: face").items():
            corners = sequence(face, f"{where}: face {label!r}", "a list of vertices")
            unknown = [k for k in corners if str(k) not in order]
            if unknown:
                raise InputError(f"{where}: face {label!r}", unknown[0], "a key of a vertex")
            faces.append(tuple(order[str(k)] for k in corners))
        density = number(extra.get("density") or 1000.0, f"{where}: density")
        kind = text(extra.get("kind") or "", f"{where}: kind")
        points = coordinates(rows, f"{where}: vertex") * unit
        made = outward(
            id_,
            points,
            tuple(faces),
            kind=kind,
            density=density,
            support=self.support,
            prop=extra.get("prop") is True,
        )
        return replace(made, colour=any_colour(extra.get("colour")))


def _compas_data(value: Any, where: str) -> Mapping[str, Any]:
    """What a COMPAS object holds, with or without its envelope."""
    given = mapping(value, where)
    for key in ("data", "value"):
        if "dtype" in given and key in given:
            return mapping(given[key], where)
    return given
