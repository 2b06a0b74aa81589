"""Blocks, their contacts, and assemblies in files."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from learn2assemble.assembly.blocks import Assembly, AssemblyStep, Block
from learn2assemble.assembly.boxes import BoxFields, box_block, box_blocks
from learn2assemble.assembly.compas import from_compas, to_compas, write_compas
from learn2assemble.assembly.contacts import (
    GROUND,
    Contacts,
    check_overlaps,
    contact_tolerance,
    find_contacts,
)
from learn2assemble.assembly.files import (
    from_json,
    read_assembly,
    to_json,
    write_assembly,
)
from learn2assemble.assembly.parts import check_simple, convex_parts, shells, to_manifold
from learn2assemble.errors import InputError

TETRAHEDRON = ((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2))


def tetrahedron(id_: str = "t", **kwargs: Any) -> Block:
    return Block(
        id_, np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]]), TETRAHEDRON, **kwargs
    )


def ell(id_: str = "ell") -> Block:
    """An L of three unit cells lying on the ground, as one polyhedron."""
    outline = [(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)]
    vertices = [(x, y, z) for z in (0.0, 1.0) for x, y in outline]
    sides = [(k, (k + 1) % 6, (k + 1) % 6 + 6, k + 6) for k in range(6)]
    return Block(id_, np.array(vertices), ((5, 4, 3, 2, 1, 0), tuple(range(6, 12)), *sides))


def two(gap: float = 0.0, shift: float = 0.0) -> Assembly:
    """A unit cube on another, moved sideways, over a gap."""
    upper = box_block("upper", (shift, 0, 1 + gap), (1 + shift, 1, 2 + gap))
    return Assembly((box_block("lower", (0, 0, 0), (1, 1, 1)), upper))


def moved(assembly: Assembly, matrix: np.ndarray, shift: float = 0.0) -> Assembly:
    """All blocks under a linear map; faces turn round where it mirrors."""
    flip = np.linalg.det(matrix) < 0
    blocks = [
        replace(
            b,
            vertices=b.vertices @ matrix.T + shift,
            faces=tuple(f[::-1] for f in b.faces) if flip else b.faces,
        )
        for b in assembly.blocks
    ]
    return replace(assembly, blocks=tuple(blocks))


def about_z(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])


# ---------------------------------------------------------------- blocks


def test_volume_and_centroid_of_known_solids() -> None:
    assert tetrahedron().volume == pytest.approx(1 / 6)
    assert tetrahedron().centroid == pytest.approx([0.25] * 3)
    box = box_block("b", (1, 2, 3), (3, 5, 4), density=2.0)
    assert box.volume == pytest.approx(6)
    assert box.mass == pytest.approx(12)
    assert box.centroid == pytest.approx([2, 3.5, 3.5])
    assert ell().volume == pytest.approx(3)
    assert ell().centroid == pytest.approx([5 / 6, 5 / 6, 0.5])


@given(
    st.floats(0, 6.28), st.tuples(*[st.floats(0.1, 10)] * 3), st.tuples(*[st.floats(-50, 50)] * 3)
)
@settings(max_examples=30, deadline=None, derandomize=True)
def test_volume_moves_with_the_block(
    angle: float, size: tuple[float, ...], to: tuple[float, ...]
) -> None:
    vertices = ell().vertices * size @ about_z(angle).T + to
    block = Block("b", vertices, ell().faces)
    assert block.volume == pytest.approx(3 * np.prod(size))
    centre = ell().centroid * size @ about_z(angle).T + to
    assert block.centroid == pytest.approx(centre, abs=1e-9)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"vertices": [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, float("nan")]]}, "finite"),
        ({"vertices": [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1e9]]}, "at most"),
        ({"vertices": [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]}, "volume"),
        ({"vertices": [[0, 0], [1, 0]]}, "shape"),
        ({"vertices": "abc"}, "numbers"),
        ({"faces": TETRAHEDRON[:3]}, "faces"),
        ({"faces": (*TETRAHEDRON[:3], (0, 3, 2), (0, 1, 2))}, "closed"),
        ({"faces": (*TETRAHEDRON[:3], (0, 3, 7))}, "vertex numbers"),
        ({"faces": tuple(f[::-1] for f in TETRAHEDRON)}, "counter-clockwise"),
        ({"density": 0.0}, "density"),
        ({"density": float("inf")}, "density"),
        ({"id": ""}, "block id"),
        ({"colour": (300, 0, 0)}, "colour"),
        ({"colour": (0.5, 0, 0)}, "colour"),
        ({"colour": "red"}, "colour"),
        ({"support": "yes"}, "support"),
        ({"prop": 1}, "prop"),
        ({"kind": None}, "kind"),
    ],
)
def test_what_is_no_block_is_refused(change: dict[str, Any], words: str) -> None:
    whole = {"id": "t", "vertices": tetrahedron().vertices, "faces": TETRAHEDRON} | change
    with pytest.raises(InputError, match=words) as error:
        Block(**whole)
    assert "\n" not in str(error.value)


def test_fields_of_numpy_are_fields_of_a_block() -> None:
    values = {"colour": np.array([1, 2, 3], np.uint8), "support": np.bool_(True)}
    block = box_block("b", (0, 0, 0), (1, 1, 1), **values)
    assert (block.colour, block.support) == ((1, 2, 3), True)
    assert json.loads(json.dumps(to_json(Assembly((block,)))))["blocks"][0]["colour"] == [1, 2, 3]


def test_what_is_no_assembly_is_refused() -> None:
    a, b = box_block("a", (0, 0, 0), (1, 1, 1)), box_block("b", (0, 0, 1), (1, 1, 2))
    for blocks, steps, friction in (
        ((), (), 0.5),
        ((a, a), (), 0.5),
        ((a, b), (AssemblyStep("c"),), 0.5),
        ((a, b), (AssemblyStep("a"), AssemblyStep("a")), 0.5),
        ((a, b), (AssemblyStep(remove="a"), AssemblyStep(remove="a")), 0.5),
        ((a, b), (), -0.1),
        ((a, b), (), float("nan")),
        ((a, box_block("speck", (2, 0, 0), (2.00001, 1e-5, 1e-5))), (), 0.5),
    ):
        with pytest.raises(InputError):
            Assembly(blocks, steps, friction)
    with pytest.raises(InputError):
        AssemblyStep()
    with pytest.raises(InputError, match="lower < upper"):
        box_block("a", (0, 0, 0), (1, 0, 1))
    for corners in (((0, 0), (1, 1, 1)), ("low", "high"), ((0, 0, [0]), (1, 1, 1))):
        with pytest.raises(InputError, match=r"block 'a': box: .* expected two corners"):
            box_block("a", *corners)  # pyright: ignore[reportArgumentType]
    with pytest.raises(InputError, match="name: got 3, expected a text"):
        Assembly((a,), name=3)  # pyright: ignore[reportArgumentType]


def test_removed_props_are_not_in_what_is_finished() -> None:
    a, prop = box_block("a", (0, 0, 0), (1, 1, 1)), box_block("p", (2, 0, 0), (3, 1, 1), prop=True)
    steps = (AssemblyStep("p"), AssemblyStep("a"), AssemblyStep(remove="p"))
    assert [b.id for b in Assembly((a, prop), steps).finished.blocks] == ["a"]
    assert [b.id for b in Assembly((a, prop), steps[:2]).finished.blocks] == ["a", "p"]
    assert [b.id for b in Assembly((a, prop)).finished.blocks] == ["a"]


def test_convex_parts_fill_the_block() -> None:
    assert not ell().is_convex
    parts = convex_parts(ell())
    assert all(part.is_convex for part in parts)
    assert sum(part.volume for part in parts) == pytest.approx(3)
    whole = to_manifold(ell())
    for part in parts:
        assert (to_manifold(part) ^ whole).volume() == pytest.approx(part.volume)
    box = box_block("b", (0, 0, 0), (1, 1, 1))
    assert convex_parts(box) == (box,)


def test_shells_of_a_block_of_several_parts() -> None:
    """Two boxes in one block, sharing a face, are two shells."""
    a, b = box_block("a", (0, 0, 0), (1, 1, 1)), box_block("b", (1, 0, 0), (2, 1, 1))
    faces = (*a.faces, *(tuple(k + 8 for k in face) for face in b.faces))
    both = Block("ab", np.concatenate([a.vertices, b.vertices]), faces)
    assert both.volume == pytest.approx(2)
    assert [shell.volume for shell in shells(both)] == pytest.approx([1, 1])
    assert not both.is_convex
    assert len(convex_parts(both)) == 2


# ---------------------------------------------------------------- contacts


def patch(contacts: Contacts, a: int, b: int) -> np.ndarray:
    """The corners of the only patch between two blocks."""
    (k,) = np.flatnonzero((contacts.a == a) & (contacts.b == b))
    return contacts.points[contacts.patch == k]


@given(st.floats(-0.9, 0.9), st.floats(0, 6.28), st.floats(0.01, 100))
@settings(max_examples=40, deadline=None, derandomize=True)
def test_patch_of_two_cubes(shift: float, angle: float, scale: float) -> None:
    contacts = find_contacts(moved(two(shift=shift), scale * about_z(angle)))
    assert contacts.a.tolist() == [0, GROUND]
    assert contacts.b.tolist() == [1, 0]
    assert contacts.normal == pytest.approx(np.array([[0, 0, 1.0]] * 2))
    assert contacts.area == pytest.approx([scale**2 * (1 - abs(shift)), scale**2])
    local = patch(contacts, 0, 1) @ about_z(angle) / scale
    assert local[:, 2] == pytest.approx(np.ones(4))
    assert local[:, 0].min() == pytest.approx(max(shift, 0), abs=1e-6)
    assert local[:, 0].max() == pytest.approx(1 + min(shift, 0), abs=1e-6)


def test_gaps_and_thin_strips_are_no_contact() -> None:
    wide = contact_tolerance(two().blocks).min()
    assert len(find_contacts(two(gap=0.5 * wide)).a) == 2
    assert len(find_contacts(two(gap=2 * wide)).a) == 1
    assert len(find_contacts(two(gap=2 * wide), tolerance=3 * wide).a) == 2
    assert len(find_contacts(two(shift=1 - 0.5 * wide)).a) == 1
    with pytest.raises(InputError, match="tolerance"):
        find_contacts(two(), tolerance=0.0)


def test_a_grain_on_a_slab() -> None:
    """The tolerance is that of the smaller block."""
    grain = box_block("grain", (5, 5, 1), (5.01, 5.01, 1.01))
    contacts = find_contacts(Assembly((box_block("slab", (0, 0, 0), (10, 10, 1)), grain)))
    assert contacts.area == pytest.approx([1e-4, 100])


def test_triangles_of_a_face_give_one_patch() -> None:
    """A mesh and the polyhedron it triangulates touch alike."""
    plain = two(shift=0.3)
    halves = [
        replace(
            b, faces=tuple(t for f in b.faces for t in ((f[0], f[1], f[2]), (f[0], f[2], f[3])))
        )
        for b in plain.blocks
    ]
    meshed = find_contacts(replace(plain, blocks=tuple(halves)))
    assert meshed.area == pytest.approx(find_contacts(plain).area)
    assert len(patch(meshed, 0, 1)) == 4


def test_an_open_corner_is_part_of_the_hull_but_not_of_the_area() -> None:
    lid = box_block("lid", (0, 0, 1), (2, 2, 2))
    contacts = find_contacts(Assembly((ell(), lid)))
    assert contacts.area[contacts.a == 0] == pytest.approx([3])
    assert len(patch(contacts, 0, 1)) == 5


def test_several_planes_between_two_blocks() -> None:
    corner = box_block("corner", (1, 1, 0), (2, 2, 1))
    contacts = find_contacts(Assembly((ell(), corner)))
    between = contacts.only(contacts.a == 0)
    assert sorted(map(tuple, between.normal.round(9).tolist())) == [(0, 1, 0), (1, 0, 0)]
    assert between.start.tolist() == [0, 4, 8]


def test_ground_only_where_no_block_is_a_support() -> None:
    base, upper = two().blocks
    contacts = find_contacts(Assembly((replace(base, support=True), upper)))
    assert contacts.a.tolist() == [0]
    both = find_contacts(Assembly((replace(base, support=True), replace(upper, support=True))))
    assert len(both.a) == 0


@pytest.mark.parametrize("turn", [0.0, 0.5])
def test_contacts_of_a_wall_against_all_pairs(turn: float) -> None:
    """The broad phase loses nothing: bricks of a wall against an exhaustive count."""
    bricks = [
        (x + 0.5 * (z % 2), z, min(2.0, 9.5 - x)) for z in range(5) for x in np.arange(0, 9, 2.0)
    ]
    boxes = [((x, 0, z), (x + w, 1, z + 1)) for x, z, w in bricks]
    blocks = [box_block(f"{k}", *box) for k, box in enumerate(boxes)]
    found = find_contacts(moved(Assembly(tuple(blocks)), about_z(turn)))
    expected = set()
    for i, (low, high) in enumerate(boxes):
        if low[2] == 0:
            expected.add((GROUND, i))
        for j in range(i + 1, len(boxes)):
            meet = np.minimum(high, boxes[j][1]) - np.maximum(low, boxes[j][0])
            if (meet > -1e-9).all() and (meet > 1e-9).sum() == 2:
                expected.add((i, j))
    assert set(zip(found.a.tolist(), found.b.tolist(), strict=True)) == expected


@given(st.floats(0.05, 0.9), st.floats(0, 6.28))
@settings(max_examples=25, deadline=None, derandomize=True)
def test_overlap_is_refused_and_named(depth: float, angle: float) -> None:
    check_overlaps(moved(two(), about_z(angle)))
    with pytest.raises(InputError, match=r"'lower' and 'upper'.*overlap"):
        check_overlaps(moved(two(gap=-depth), about_z(angle)))


def test_overlap_of_shapes_that_are_not_convex() -> None:
    inside = box_block("inside", (1, 1, 0), (2, 2, 1))
    check_overlaps(Assembly((ell(), inside)))
    with pytest.raises(InputError, match="overlap"):
        check_overlaps(Assembly((ell(), box_block("through", (0.9, 0.9, 0), (2, 2, 1)))))


def test_crossing_bars_overlap_though_no_corner_is_inside() -> None:
    bars = (box_block("x", (0, 1, 0), (3, 2, 1)), box_block("y", (1, 0, 0), (2, 3, 1)))
    with pytest.raises(InputError, match="overlap"):
        check_overlaps(Assembly(bars))


def test_surfaces_that_cross_themselves_are_refused() -> None:
    """An L whose free end is bent through its foot; and two shells in one another."""
    check_simple(ell(), 1e-3)
    bent = ell().vertices.copy()
    bent[[4, 5, 10, 11], 1] = -1.0
    bent[[4, 10], 0], bent[[5, 11], 0] = 0.5, 0.4
    with pytest.raises(InputError, match="cross"):
        check_simple(Block("bent", bent, ell().faces), 1e-3)
    a, b = box_block("a", (0, 0, 0), (1, 1, 1)), box_block("b", (0, 0, 0), (1, 1, 1))
    faces = (*a.faces, *(tuple(k + 8 for k in face) for face in b.faces))
    twice = Block("twice", np.concatenate([a.vertices, b.vertices]), faces)
    with pytest.raises(InputError, match="overlap"):
        check_simple(twice, 1e-3)


@pytest.mark.parametrize(("gap", "apart"), [(0.0, False), (4e-4, False), (2e-3, True), (9.0, True)])
def test_shells_of_one_block_hang_together(gap: float, apart: bool) -> None:
    """Two objects of one name in a file would be one rigid block."""
    boxes = [box_block("k", (x, 0, 0), (x + 1, 1, 1)) for x in (2 + 2 * gap, 0, 1 + gap)]
    faces = tuple(tuple(k + 8 * n for k in f) for n, box in enumerate(boxes) for f in box.faces)
    row = Block("row", np.concatenate([box.vertices for box in boxes]), faces)
    if not apart:
        check_overlaps(Assembly((row,)), 1e-3)
        return
    with pytest.raises(InputError, match=r"block 'row': got '3 parts, not all of which touch'"):
        check_overlaps(Assembly((row,)), 1e-3)


# ---------------------------------------------------------------- files


def example() -> Assembly:
    base = box_block("base", (0, 0, 0), (2, 2, 1), kind="2x2", support=True)
    prop = box_block("prop", (0, 0, 1), (0.5, 0.5, 2), prop=True, density=500.0)
    steps = (
        AssemblyStep("base"),
        AssemblyStep("prop"),
        AssemblyStep("t"),
        AssemblyStep(remove="prop"),
    )
    top = replace(tetrahedron(), vertices=tetrahedron().vertices + 1.0)
    return Assembly((base, prop, top), steps, 0.7, "example")


def same(a: Assembly, b: Assembly) -> bool:
    pairs = list(zip(a.blocks, b.blocks, strict=True))
    return (a.steps, a.friction, a.name) == (b.steps, b.friction, b.name) and all(
        (x.id, x.kind, x.density, x.support, x.prop, x.faces)
        == (y.id, y.kind, y.density, y.support, y.prop, y.faces)
        and np.allclose(x.vertices, y.vertices, atol=1e-9)
        for x, y in pairs
    )


def test_round_trips(tmp_path: Path) -> None:
    write_assembly(example(), tmp_path / "example.json")
    write_compas(example(), tmp_path / "compas.json")
    ours = read_assembly(tmp_path / "example.json")
    theirs = read_assembly(tmp_path / "compas.json")
    for found in (ours, theirs):
        assert same(found, example())
    assert not list(tmp_path.glob(".*")), "nothing partial is left"
    scaled = read_assembly(tmp_path / "compas.json", unit="mm")
    assert scaled.blocks[0].volume == pytest.approx(4e-9)


def test_compas_reads_what_is_written(tmp_path: Path) -> None:
    compas = pytest.importorskip("compas")
    pytest.importorskip("compas_assembly")
    write_compas(example(), tmp_path / "compas.json")
    found = compas.json_load(tmp_path / "compas.json")
    graph = found.graph
    assert [graph.node_attribute(k, "is_support") for k in graph.nodes()] == [True, False]
    assert [graph.node_attribute(k, "step") for k in graph.nodes()] == [1, 3]
    volumes = [abs(block.volume()) for block in found.blocks()]
    assert volumes == pytest.approx([b.volume for b in example().finished.blocks])
    (prop,) = found.attributes["props"]
    assert abs(prop.volume()) == pytest.approx(example().blocks[1].volume)
    assert found.attributes["steps"][-1] == {"remove": "prop"}


def tower() -> Assembly:
    """Two blocks on the plane z = 0, and one on both, without a support."""
    blocks = [box_block(f"{k}", (k, 0, 0), (k + 1, 1, 1)) for k in range(2)]
    top = box_block("top", (0.25, 0, 1), (1.75, 1, 2))
    return Assembly(
        (top, *blocks), (AssemblyStep("1"), AssemblyStep("0"), AssemblyStep("top")), 0.6, "tower"
    )


def test_compas_has_order_ground_and_interfaces(tmp_path: Path) -> None:
    compas = pytest.importorskip("compas")
    pytest.importorskip("compas_assembly")
    write_compas(tower(), tmp_path / "compas.json")
    found = compas.json_load(tmp_path / "compas.json")
    graph = found.graph
    (ground,) = graph.nodes_where({"is_support": True})
    slab = found.node_block(ground)
    corners = np.array([slab.vertex_coordinates(k) for k in slab.vertices()])
    assert corners[:, 2].max() == 0
    assert (corners.min(0)[:2] < 0).all()
    assert (corners.max(0)[:2] > [2, 1]).all()
    order = sorted(set(graph.nodes()) - {ground}, key=lambda k: graph.node_attribute(k, "step"))
    assert [found.node_block(k).name for k in order] == ["1", "0", "top"]
    assert found.number_of_interfaces() == 5
    for edge in found.edges():
        lower, upper = found.edge_blocks(edge)
        for interface in found.edge_interfaces(edge):
            assert interface.polygon.area == pytest.approx(interface.size)
            between = upper.centroid() - lower.centroid()
            assert interface.frame.zaxis.dot(between) > 0
    # As another program writes it again.
    compas.json_dump(found, tmp_path / "again.json")
    assert same(read_assembly(tmp_path / "again.json"), tower())


def test_the_ground_of_compas_is_a_block_where_it_was_moved_or_is_not_alone() -> None:
    for change in ("moved", "beside"):
        document = json.loads(json.dumps(to_compas(tower())))
        nodes = document["data"]["graph"]["data"]["node"]
        assert same(from_compas(document), tower())
        if change == "moved":
            for at in nodes["3"]["block"]["data"]["vertex"].values():
                at["z"] -= 0.5
        else:
            nodes["1"]["is_support"] = True
        assert [b.support for b in from_compas(document).blocks][3:] == [True]


def of_parts() -> dict[str, Any]:
    """The tower as an assembly of COMPAS's own, whose nodes hold parts."""
    document = json.loads(json.dumps(to_compas(tower())))
    graph = document["data"]["graph"]["data"]
    nodes = {key: node["block"] for key, node in graph["node"].items() if not node.get("ground")}
    frame = {"point": [0.0, 0.0, 0.0], "xaxis": [1.0, 0.0, 0.0], "yaxis": [0.0, 1.0, 0.0]}
    for key, mesh in nodes.items():
        attributes = {"name": mesh["data"].pop("attributes")["name"], "geometry": mesh}
        data = {"attributes": attributes, "key": int(key), "frame": dict(frame), "features": []}
        graph["node"][key] = {"part": {"dtype": "compas.datastructures/Part", "data": data}}
    graph["node"] = {key: graph["node"][key] for key in nodes}
    return {"dtype": "compas.datastructures/Assembly", "data": {"attributes": {}, "graph": graph}}


def test_parts_of_an_assembly_of_compas_are_blocks() -> None:
    document = of_parts()
    nodes = document["data"]["graph"]["node"]
    nodes["0"]["is_support"] = True
    nodes["1"]["part"]["data"]["attributes"]["density"] = 3000
    found, meant = from_compas(document), tower()
    assert [b.id for b in found.blocks] == [b.id for b in meant.blocks]
    for block, other in zip(found.blocks, meant.blocks, strict=True):
        assert np.allclose(block.vertices, other.vertices)
    assert [b.support for b in found.blocks] == [True, False, False]
    assert [b.density for b in found.blocks] == [1000, 3000, 1000]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"frame": {"point": [0.0, 0.0, 1.0]}}, "part.frame"),
        ({"attributes": {"geometry": {"dtype": "compas.geometry/Box", "data": {}}}}, "Box"),
        ({"attributes": {}}, "geometry: got None, expected a Mesh"),
    ],
)
def test_parts_without_a_mesh_in_its_place_are_refused(change: dict[str, Any], words: str) -> None:
    document = of_parts()
    nodes = document["data"]["graph"]["node"]
    nodes["1"]["part"]["data"] |= change
    with pytest.raises(InputError, match=words):
        from_compas(document)
    nodes["1"] = {}
    with pytest.raises(InputError, match="a part of compas whose geometry is a Mesh"):
        from_compas(document)
    mesh = {"dtype": "compas.datastructures/Mesh", "data": {"vertex": {}, "face": {}}}
    with pytest.raises(InputError, match="Mesh', expected an Assembly of COMPAS"):
        from_compas(mesh)


def test_compas_structure() -> None:
    """What ``compas`` needs to load it, where ``compas`` itself is not installed."""
    document = json.loads(json.dumps(to_compas(example())))
    graph = document["data"]["graph"]
    assert graph["dtype"] == "compas.datastructures/Graph"
    assert set(graph["data"]) >= {"node", "edge", "max_node", "default_node_attributes"}
    for node in graph["data"]["node"].values():
        mesh = node["block"]
        assert "compas.datastructures/Mesh" in mesh["inheritance"]
        data = mesh["data"]
        keys = {str(k) for face in data["face"].values() for k in face}
        assert keys == set(data["vertex"])
        assert set(data["facedata"]) == set(data["face"])


def test_foreign_compas_files() -> None:
    """Node keys as ids where names repeat; faces turned inside are turned back."""
    document = to_compas(example())
    nodes = document["data"]["graph"]["data"]["node"]
    for node in nodes.values():
        data = node["block"]["data"]
        data["attributes"] = {"name": None}
        data["face"] = {k: face[::-1] for k, face in data["face"].items()}
    document["data"]["attributes"] = {"name": "Assembly"}
    found = from_compas(document)
    assert [b.id for b in found.blocks] == ["0", "2"]
    volumes = [b.volume for b in example().finished.blocks]
    assert [b.volume for b in found.blocks] == pytest.approx(volumes)


def broken(path: str, value: Any) -> dict[str, Any]:
    """Our document with one value replaced; a path is keys and numbers with dots."""
    document = json.loads(json.dumps(to_json(example())))
    *way, last = (int(k) if k.isdigit() else k for k in path.split("."))
    at = document
    for key in way:
        at = at[key]
    at[last] = value
    return document


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        ("format", "something", "format"),
        ("version", 2, "version"),
        ("units", "mm", "units"),
        ("colour", 1, "colour"),
        ("blocks", [], "blocks"),
        ("blocks", {}, "blocks"),
        ("blocks.0", 5, r"blocks\[0\]"),
        ("blocks.0.id", 5, "id"),
        ("blocks.0.weight", 5, "weight"),
        ("blocks.0.density", "heavy", "density"),
        ("blocks.0.support", 1, "support"),
        ("blocks.0.vertices", [[0, 0]], "vertices"),
        ("blocks.0.vertices.0", [0, 0, "x"], "vertices"),
        ("blocks.0.faces.0", [0, 1, 99], r"faces\[0\]"),
        ("blocks.0.faces.0", [0, 1, 1.5], r"faces\[0\]"),
        ("blocks.1.id", "base", "every id once"),
        ("friction", -1, "friction"),
        ("steps.0", {"put": "base"}, "put"),
        ("steps.0", {"place": "nobody"}, "nobody"),
        ("steps.0", {}, "step"),
    ],
)
def test_bad_documents(path: str, value: Any, words: str) -> None:
    with pytest.raises(InputError, match=words) as error:
        from_json(broken(path, value), "file.json")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"{",
        b"[]",
        b"{}",
        b'{"dtype": "compas"}',
        b'{"dtype": "c", "data": {"graph": {}}}',
        b"\x80\x81",
        b"hello",
        b"glTF rubbish",
        b"ply\nrubbish",
        b"solid nothing\nendsolid",
        b'{"format": NaN}',
        b"[" * 100_000,
        b"v 1 2 3\nf 1 2 3\n",
    ],
)
def test_bad_files(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "bad"
    file.write_bytes(content)
    with pytest.raises(InputError) as error:
        read_assembly(file)
    assert "\n" not in str(error.value)


def test_a_file_that_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(InputError):
        write_assembly(example(), tmp_path / "none" / "a.json")
    with pytest.raises(InputError, match="no such file"):
        read_assembly(tmp_path / "none")
    with pytest.raises(InputError, match="unit"):
        read_assembly(tmp_path, unit=float("nan"))
    with pytest.raises(InputError, match="folder without a plan or meshes"):
        read_assembly(tmp_path)


@pytest.mark.parametrize("suffix", ["stl", "obj", "ply", "glb", "off"])
def test_a_folder_and_a_scene_of_meshes(tmp_path: Path, suffix: str) -> None:
    trimesh = pytest.importorskip("trimesh")
    scene = trimesh.Scene()
    folder = tmp_path / "folder"
    folder.mkdir()
    source = two(shift=0.25)
    upright = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1.0]])
    for block in source.blocks:
        triangles = [t for f in block.faces for t in (f[:3], (f[0], f[2], f[3]))]
        mesh = trimesh.Trimesh(block.vertices, triangles)
        if suffix == "glb":  # its y is up
            mesh.apply_transform(upright)
        mesh.export(folder / f"{block.id}.{suffix}")
        scene.add_geometry(mesh, node_name=block.id, geom_name=block.id)
    expected = find_contacts(source)
    from_folder = read_assembly(folder)
    assert {b.id for b in from_folder.blocks} == {"lower", "upper"}
    found = [from_folder]
    if suffix != "off":
        scene.export(tmp_path / f"scene.{suffix}")
        found.append(read_assembly(tmp_path / f"scene.{suffix}"))
    for assembly in found:
        assert sorted(find_contacts(assembly).area) == pytest.approx(sorted(expected.area))
    fixed = read_assembly(folder, supports=["lower"])
    assert [b.id for b in fixed.blocks if b.support] == ["lower"]
    with pytest.raises(InputError, match="support"):
        read_assembly(folder, supports=["nobody"])
    if suffix == "glb":
        assert len(read_assembly(folder, unit=None).blocks) == 2
    else:
        with pytest.raises(InputError, match="unit: got None, expected mm, cm, m or in"):
            read_assembly(folder, unit=None)


def test_instances_of_one_mesh_are_blocks(tmp_path: Path) -> None:
    """A scene with one mesh and many nodes, mirrored and turned ones among them."""
    trimesh = pytest.importorskip("trimesh")
    scene = trimesh.Scene()
    upright = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1.0]])
    wedge = np.array([(x, y, z * (x < 0.15)) for x in (0, 0.2) for y in (0, 0.1) for z in (0, 0.1)])
    hull = trimesh.convex.convex_hull(wedge)
    for k in range(1200):
        matrix = np.eye(4)
        matrix[:3, 3] = 0.5 * (k % 40), 0.5 * (k // 40), 0
        if k % 3 == 1:
            matrix[:3, :3] = np.diag([-1, 1, 1])
        elif k % 3 == 2:
            matrix[:2, :2] = [[0, -1], [1, 0]]
        if k:
            scene.graph.update(frame_to=f"w{k}", matrix=upright @ matrix, geometry="wedge")
        else:
            scene.add_geometry(hull, node_name="w0", geom_name="wedge", transform=upright)
    scene.export(tmp_path / "instances.glb")
    made = read_assembly(tmp_path / "instances.glb")
    assert {block.id for block in made.blocks} == {f"w{k}" for k in range(1200)}
    for block in made.blocks:
        k = int(block.id[1:])
        assert block.volume == pytest.approx(1e-3, rel=1e-5)
        corner = [0.5 * (k % 40) - 0.2 * (k % 3 == 1) - 0.1 * (k % 3 == 2), 0.5 * (k // 40), 0]
        assert block.vertices.min(0) == pytest.approx(corner, abs=1e-5)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.ply", b"ply\nformat ascii 1.0\nelement vertex 1000000000000\nend_header\n", "promise"),
        ("a.off", b"OFF\n# a box\n1000000000000 12 0\n0 0 0\n", "promise"),
        ("a.glb", b"glTF" + bytes(16), "GLB"),
        ("a.stl", b"solid a\nfacet\n", "triangles"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\n", "triangles"),
        ("a.obj", b"v 0 0 0\n" + b"# \0" * 17_000_000, "at most 50 MB"),
    ],
    ids=["ply", "off", "glb", "stl", "obj", "long obj"],
)
def test_meshes_that_hold_less_than_they_say_are_one_line(
    tmp_path: Path, name: str, content: bytes, words: str
) -> None:
    (tmp_path / name).write_bytes(content)
    expected = "vertices and faces in" if words == "promise" else words
    with pytest.raises(InputError, match=expected) as error:
        read_assembly(tmp_path / name)
    assert "\n" not in str(error.value)


def obj(boxes: dict[str, tuple[int, int]], corner: str) -> bytes:
    """Unit boxes from x to y, of one height each.

    Args:
        boxes: name to (x, z) of the low corner.
        corner: how a face names vertex {k} of its box, where {far} are written so far.
    """
    faces = "1 2 4 3", "5 7 8 6", "1 5 6 2", "3 4 8 7", "1 3 7 5", "2 6 8 4"
    lines, far = list[str](), 0
    for name, (x, z) in boxes.items():
        lines.append(f"o {name}\nvt 0 0\nvn 0 0 1")
        points = [(x + a, b, z + c) for a in (0, 1) for b in (0, 1) for c in (0, 1)]
        lines += [f"v {a} {b} {c}" for a, b, c in points]
        far += 8
        for face in faces:
            words = [corner.format(back=int(k) - 9, on=far - 8 + int(k)) for k in face.split()]
            lines.append("f " + " ".join(words) + " # -1")
    return "\n".join(lines).encode()


@pytest.mark.parametrize("corner", ["{back}", "{back}/-1/-1", "{on}//-1", "{back}//-1"])
def test_corners_of_faces_may_be_counted_back(tmp_path: Path, corner: str) -> None:
    """Back from the face, not from the end of the file, as in OBJ."""
    boxes = {"lintel": (0, 5), "left": (0, 0), "right": (3, 0)}
    (tmp_path / "back.obj").write_bytes(obj(boxes, corner))
    made = {block.id: block for block in read_assembly(tmp_path / "back.obj").blocks}
    assert made.keys() == boxes.keys()
    for name, (x, z) in boxes.items():
        assert made[name].vertices.min(0).tolist() == [x, 0, z]
        assert made[name].volume == pytest.approx(1)
    (tmp_path / "far.obj").write_bytes(obj(boxes, corner).replace(b"f ", b"f -9 ", 1))
    with pytest.raises(InputError, match="a face with -9, after 8 of what it counts"):
        read_assembly(tmp_path / "far.obj")


def test_groups_are_blocks_where_a_file_names_no_objects(tmp_path: Path) -> None:
    """As Rhino exports names of objects or of layers; blocks share the edges of their joint."""
    file = tmp_path / "groups.obj"
    content = obj({"low": (0, 0), "high": (0, 1), "aside": (5, 0)}, "{on}")
    file.write_bytes(content.replace(b"o ", b"g "))
    made = {block.id: block for block in read_assembly(file).blocks}
    assert made.keys() == {"low", "high", "aside"}
    assert made["high"].vertices.min(0).tolist() == [0, 0, 1]
    # Blocks of one layer, which are apart, are blocks of their own.
    layers = obj({"low": (0, 0), "aside": (5, 0), "high": (0, 1)}, "{on}")
    layers = layers.replace(b"o high", b"g upper #1").replace(b"o aside", b"")
    file.write_bytes(layers.replace(b"o ", b"g "))
    assert sorted(b.id for b in read_assembly(file).blocks) == ["low/0", "low/1", "upper #1"]
    # A group in which two blocks share edges.
    file.write_bytes(content.replace(b"o high", b"").replace(b"o ", b"g "))
    with pytest.raises(InputError, match="share edges"):
        read_assembly(file)


def test_meshes_that_share_an_edge_in_one_file_are_refused(tmp_path: Path) -> None:
    """Which of four faces at an edge belong together cannot be told."""
    trimesh = pytest.importorskip("trimesh")
    a = trimesh.creation.box(bounds=[[0, 0, 0], [1, 1, 1]])
    b = trimesh.creation.box(bounds=[[0, 0, 1], [1, 1, 2]])
    trimesh.util.concatenate([a, b]).export(tmp_path / "both.stl")
    with pytest.raises(InputError, match="share edges"):
        read_assembly(tmp_path / "both.stl")


def test_far_too_many_blocks_are_refused_before_they_are_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "many.json"
    file.write_text('{"blocks": [' + ", ".join(['{"vertices": []}'] * 100_000) + "]}")
    monkeypatch.setattr("learn2assemble.assembly.files.load_json", None)
    with pytest.raises(InputError, match="got 100000, expected 1 to 10000 blocks"):
        read_assembly(file)


def test_boxes_by_the_thousand_are_as_one_by_one() -> None:
    rng = np.random.default_rng(0)
    low = rng.normal(size=(50, 3))
    high = low + rng.uniform(0.01, 2.0, (50, 3))
    given = [BoxFields(f"b{k}", "kind", 100.0 + k, (1, 2, k)) for k in range(50)]
    for block, box, lower, upper in zip(
        box_blocks(given, low, high), given, low, high, strict=True
    ):
        one = box_block(box.id, lower, upper, kind=box.kind, density=box.density, colour=box.colour)
        assert (block.id, block.kind, block.faces) == (one.id, one.kind, one.faces)
        assert (block.density, block.colour, block.support) == (one.density, one.colour, False)
        assert np.array_equal(block.vertices, one.vertices)
        assert block.volume == pytest.approx(one.volume)
        assert block.centroid == pytest.approx(one.centroid)
        assert block.extent == pytest.approx(one.extent)
        assert replace(block, id="other").volume == pytest.approx(one.volume)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"high": 0.0}, "lower < upper"),
        ({"high": np.nan}, "lower < upper"),
        ({"high": 1e9}, "at most 1e6"),
        ({"high": 1e-12}, "more than 0"),
        ({"density": -1.0}, "density"),
        ({"id": ""}, "1 to 200"),
    ],
)
def test_a_wrong_box_among_others_is_named(wrong: dict[str, Any], said: str) -> None:
    low, high = np.zeros((3, 3)), np.ones((3, 3))
    high[1, 2] = wrong.get("high", 1.0)
    boxes = [BoxFields(f"b{k}", "", 1000.0) for k in range(3)]
    boxes[1] = boxes[1]._replace(**{k: v for k, v in wrong.items() if k != "high"})
    with pytest.raises(InputError, match=said):
        box_blocks(boxes, low, high)
