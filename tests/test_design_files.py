"""Designs from files: one shape in every kind of file, and what must be refused."""

from __future__ import annotations

import gzip
import io
import json
import pickle
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from PIL import Image

from learn2assemble.design.cells import CellDesign
from learn2assemble.design.files import kind_of
from learn2assemble.design.lattice import fit, shares
from learn2assemble.design.read import read_design
from learn2assemble.design.solids import crossed
from learn2assemble.design.svg.walk import read_svg
from learn2assemble.errors import InputError, MissingExtraError

EXAMPLES = Path(__file__).parents[1] / "examples" / "designs"
GATE = np.array(
    [[c == "#" for c in row] for row in ("######", "######", "##..##", "##..##", "##..##")]
)[::-1].T[:, None, :]
"""A gate, ``bool[6, 1, 5]``; cells of 50 mm."""


def cells(path: Path, **options: Any) -> CellDesign:
    made = read_design(path, **options)
    assert isinstance(made, CellDesign)
    return made


def write(path: Path, content: str | bytes) -> Path:
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


# ---------------------------------------------------------------- writers, by other libraries


def svg(body: str, head: str = 'width="300mm" height="250mm" viewBox="0 0 300 250"') -> str:
    return f'<svg xmlns="http://www.w3.org/2000/svg" {head}>{body}</svg>'


def dxf(draw: Callable[[Any, Any], Any], units: int = 4) -> bytes:
    """An ASCII DXF file; ``draw`` gets the document and its model space."""
    import ezdxf

    document = ezdxf.new()
    document.header["$INSUNITS"] = units
    draw(document, document.modelspace())
    text = io.StringIO()
    document.write(text)
    return text.getvalue().encode()


def png(image: np.ndarray, kind: str = "PNG", **options: Any) -> bytes:
    """A picture of ``uint8[H, W]`` or ``[H, W, 3 or 4]``."""
    file = io.BytesIO()
    Image.fromarray(image).save(file, kind, **options)
    return file.getvalue()


def npy(array: np.ndarray, **options: Any) -> bytes:
    file = io.BytesIO()
    np.save(file, array, **options)
    return file.getvalue()


def npz(**named: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.savez_compressed(file, **named)
    return file.getvalue()


def mesh(shape: trimesh.Trimesh | trimesh.Scene, kind: str) -> bytes:
    data = shape.export(file_type=kind)
    return data if isinstance(data, bytes) else data.encode()


def voxel_mesh(wanted: np.ndarray, edge: float) -> trimesh.Trimesh:
    """The surface of cells, as the union of boxes by another library."""
    from manifold3d import Manifold, OpType

    boxes = [
        Manifold.cube((edge, edge, edge)).translate(tuple(edge * index))
        for index in np.argwhere(wanted).astype(float)
    ]
    whole = Manifold.batch_boolean(boxes, OpType.Add).to_mesh64()
    return trimesh.Trimesh(whole.vert_properties[:, :3], whole.tri_verts)


RING = [(0, 0), (0, 250), (300, 250), (300, 0), (200, 0), (200, 150), (100, 150), (100, 0)]
"""The gate as an outline, mm, z up."""


def _hatched(space: Any, style: int, *holes: int) -> None:
    """The gate as one hatch with an outline for its opening, and in that one that the style leaves
    out."""
    hatch = space.add_hatch()
    hatch.dxf.hatch_style = style
    hatch.paths.add_polyline_path([(0, 0), (300, 0), (300, 250), (0, 250)], is_closed=True)
    for number, flags in enumerate(holes):
        left, right, top = 100 + 25 * number, 200 - 25 * number, 150 - 50 * number
        inner = [(left, 0), (right, 0), (right, top), (left, top)]
        hatch.paths.add_polyline_path(inner, is_closed=True, flags=flags)


def _with_hidden(document: Any, space: Any) -> None:
    """The gate in a block on a layer that is off, which layers of its own show, and much that is
    not shown."""
    document.layers.add("Off").off()
    document.layers.add("Frozen").freeze()
    document.layers.add("Shown")
    whole = [(0, 0), (300, 0), (300, 250), (0, 250)]
    for seen in ({"layer": "OFF"}, {"layer": "frozen"}, {"invisible": 1}):
        space.add_lwpolyline(whole, close=True, dxfattribs=seen)
    block = document.blocks.new("GATE")
    block.add_lwpolyline(whole, close=True)
    block.add_lwpolyline(RING, close=True, dxfattribs={"layer": "Shown"})
    space.add_blockref("GATE", (0, 0), dxfattribs={"layer": "Off"})
    space.add_blockref("GATE", (500, 0), dxfattribs={"layer": "Frozen"})


def _lines(document: Any, space: Any) -> None:
    """The gate as single lines in a block that is turned and moved."""
    block = document.blocks.new("GATE")
    for start, end in zip(RING, RING[1:] + RING[:1], strict=True):
        block.add_line(start, end)
    space.add_blockref("GATE", (1000, -70), dxfattribs={"rotation": 90}).set_scale(1)
    # Turned by 90 degrees the gate would lie on its side: a second turn stands it up again.
    outer = document.blocks.new("OUTER")
    outer.add_blockref("GATE", (0, 0), dxfattribs={"rotation": 90})
    for reference in list(space):
        space.delete_entity(reference)
    space.add_blockref("OUTER", (1000, -70), dxfattribs={"rotation": -90})


SAME: dict[str, tuple[str | bytes, dict[str, Any]]] = {
    "path.svg": (svg('<path d="M0 0H300V250H200V100H100V250H0z"/>'), {}),
    "hole.svg": (
        svg('<path fill-rule="evenodd" d="M0 0H300V250H0zM100 100V250H200V100z"/>'),
        {},
    ),
    "nonzero.svg": (svg('<path d="M0 0H300V250H0zM100 100V250H200V100z"/>'), {}),
    "paper.svg": (
        svg(
            '<rect width="100%" height="100%" fill="#fff"/><rect width="300" height="250"/>'
            '<rect x="100" y="100" width="100" height="150" style="fill:white"/>'
        ),
        {},
    ),
    "lines.svg": (
        svg(
            '<g fill="none" stroke="black"><rect width="300" height="250"/>'
            '<rect x="100" y="100" width="100" height="150"/><path d="M0 0 L500 500"/></g>'
        ),
        {},
    ),
    "use.svg": (
        svg(
            '<defs><rect id="post" width="10" height="25"/></defs><g transform="scale(10)">'
            '<use href="#post"/><use href="#post" x="20"/><rect width="30" height="10"/></g>'
        ),
        {},
    ),
    "mirrored.svg": (
        svg('<path transform="matrix(-1 0 0 1 300 0)" d="M0 0H300V250H200V100H100V250H0z"/>'),
        {},
    ),
    "pixels.svg": (svg('<path d="M0 0h6v5h-2V2H2v3H0z"/>', ""), {"unit": "m", "cell": 1.0}),
    "size.svg": (svg('<path d="M0 0h6v5h-2V2H2v3H0z"/>', 'viewBox="0 0 6 5"'), {"size": 0.3}),
    "wide.svg": (svg('<path d="M0 0h6v5h-2V2H2v3H0z"/>', ""), {"cells_wide": 6}),
    "polyline.dxf": (dxf(lambda d, s: s.add_lwpolyline(RING, close=True)), {}),
    "inches.dxf": (
        dxf(lambda d, s: s.add_lwpolyline([(x / 25.4, y / 25.4) for x, y in RING], close=True), 1),
        {},
    ),
    "yards.dxf": (
        dxf(
            lambda d, s: s.add_lwpolyline([(x / 914.4, y / 914.4) for x, y in RING], close=True), 10
        ),
        {},
    ),
    "blocks.dxf": (dxf(_lines, 0), {"unit": "mm"}),
    "hatch.dxf": (
        dxf(lambda d, s: s.add_hatch().paths.add_polyline_path(RING, is_closed=True)),
        {},
    ),
    "hole_in_hatch.dxf": (dxf(lambda d, s: _hatched(s, 0, 16)), {}),
    "island_in_hatch.dxf": (dxf(lambda d, s: _hatched(s, 1, 16, 0)), {}),
    "hidden.dxf": (dxf(_with_hidden), {}),
    "dark.png": (png(np.where(GATE[:, 0].T[::-1], 20, 250).astype(np.uint8)), {}),
    "clear.png": (
        png(
            np.pad(
                np.dstack([np.full((5, 6, 3), 255), GATE[:, 0].T[::-1] * 255]).astype(np.uint8),
                ((2, 3), (1, 4), (0, 0)),
            )
        ),
        {},
    ),
    "fine.png": (
        png(np.kron(np.where(GATE[:, 0].T[::-1], 0, 255), np.ones((30, 30))).astype(np.uint8)),
        {"cells_wide": 6},
    ),
    "dark.jpg": (
        png(
            np.kron(np.where(GATE[:, 0].T[::-1], 0, 255), np.ones((16, 16))).astype(np.uint8),
            "JPEG",
        ),
        {"cells_wide": 6},
    ),
    "clear.webp": (
        png(
            np.dstack([np.full((5, 6, 3), 255), GATE[:, 0].T[::-1] * 255]).astype(np.uint8),
            "WEBP",
            lossless=True,
        ),
        {},
    ),
    "bool.npy": (npy(GATE), {}),
    "fortran.npy": (npy(np.asfortranarray(GATE.astype(np.float32))), {}),
    "one.npz": (npz(anything=GATE), {}),
    "named.npz": (npz(wanted=GATE, cell=np.array(0.05)), {}),
    "outline.json": (
        json.dumps({"elevations": [{"outline": [[(x - 150) / 1e3, z / 1e3] for x, z in RING]}]}),
        {},
    ),
    **{
        f"mesh.{kind}": (mesh(voxel_mesh(GATE, 50.0), kind), {"unit": "mm"})
        for kind in ("stl", "ply", "obj", "stl_ascii", "off")
    },
    "mesh.glb": (
        mesh(
            voxel_mesh(GATE, 0.05).apply_transform(
                trimesh.transformations.rotation_matrix(-np.pi / 2, (1, 0, 0))
            ),
            "glb",
        ),
        {},
    ),
}
"""One gate in files of every kind, with what the file does not say."""


@pytest.mark.parametrize("name", SAME)
def test_one_shape_gives_the_same_cells(name: str, tmp_path: Path) -> None:
    content, options = SAME[name]
    made = cells(write(tmp_path / name, content), **options)
    assert np.array_equal(made.wanted, GATE), made.wanted[:, 0].T[::-1].astype(int)
    assert made.volume_error == pytest.approx(0, abs=1e-6)
    assert made.iou is None or made.iou == pytest.approx(1, abs=1e-6)
    assert made.cell == pytest.approx((options.get("cell", 0.05),) * 3)
    assert made.name == name.split(".")[0]


def test_the_kind_is_found_by_content(tmp_path: Path) -> None:
    for name, (content, options) in SAME.items():
        other = tmp_path / "design.txt"
        assert np.array_equal(cells(write(other, content), **options).wanted, GATE), name


def test_a_circle_in_all_drawings(tmp_path: Path) -> None:
    """Curves: the disc as SVG circle, SVG path of arcs, DXF circle and arcs."""
    files = {
        "a.svg": svg('<circle cx="9" cy="-3" r="5"/>', ""),
        "b.svg": svg('<path d="M0 0A5 5 0 0 1 10 0A5 5 0 0 1 0 0z"/>', ""),
        "c.dxf": dxf(lambda d, s: s.add_circle((3, 4), 5)),
        "d.dxf": dxf(
            lambda d, s: [s.add_arc((0, 0), 5, a, b) for a, b in ((0, 90), (90, 200), (200, 360))]
        ),
    }
    made = [cells(write(tmp_path / n, c), size=0.5).wanted for n, c in files.items()]
    centre = np.arange(10) - 4.5
    assert made[0].shape == (10, 1, 10)
    assert np.array_equal(made[0][:, 0], made[0][::-1, 0])
    assert made[0][:, 0][np.hypot(*np.meshgrid(centre, centre)) < 4.4].all()
    assert all(np.array_equal(other, made[0]) for other in made[1:])


TURNED = {
    "rect": '<rect x="2" y="-2" width="9" height="4" transform="{}"/>',
    "circle": '<circle cx="5" cy="2" r="4" transform="{}"/>',
    "ellipse": '<ellipse cx="5" cy="2" rx="5" ry="2" transform="{}"/>',
    "use": '<defs><rect id="a" width="9" height="4"/></defs><use href="#a" transform="{}"/>',
    "group": '<g transform="{}"><rect width="9" height="4" rx="1"/></g>',
    "path": '<path d="M0 0h4a4 2 0 0 1 0 4h-4z" transform="{}"/>',
}
"""Shapes with a place for a transform."""
AREAS = {
    "rect": 36,
    "circle": 16 * np.pi,
    "ellipse": 10 * np.pi,
    "use": 36,
    "group": 32 + np.pi,
    "path": 16 + 4 * np.pi,
}
TURNS = {
    "rotate(30)": (0.5, 0.75**0.5, 1.0),
    "skewX(40)": (0.0, 1.0, 1.0),
    "matrix(1 .5 -.3 2 7 8)": (0.5, 1.0, 2.15),
}


@pytest.mark.parametrize("turn", TURNS)
@pytest.mark.parametrize("shape", TURNED)
def test_shapes_of_svg_are_transformed(shape: str, turn: str) -> None:
    """A corner or a middle lies where the transform puts it, and areas grow by its determinant."""
    import shapely

    page = 'viewBox="-50 -50 300 250"'
    contours = read_svg(svg(TURNED[shape].format(turn), page).encode(), "a.svg").sides["front"]
    made = shapely.union_all([shapely.Polygon(c) for c in contours])
    b, d, growth = TURNS[turn]
    assert made.area == pytest.approx(AREAS[shape] * growth, rel=2e-3)
    # Height of what a transform maps: y' = b x + d y (+ 8), drawn upwards.
    if shape in ("circle", "ellipse"):
        rx, ry = (4, 4) if shape == "circle" else (5, 2)
        d = 2.0 if "matrix" in turn else d
        reach = 2 * np.hypot(b * rx, d * ry)
        assert made.bounds[3] - made.bounds[1] == pytest.approx(reach, rel=2e-3)
    if shape == "rect":
        d = 2.0 if "matrix" in turn else d
        assert made.bounds[3] - made.bounds[1] == pytest.approx(9 * b + 4 * d, rel=1e-3)


UNSEEN = '<rect x="150" width="100" height="100"/>'
SYMBOL = '<symbol id="k"><rect width="100" height="100"/></symbol>'


@pytest.mark.parametrize(
    "body",
    [
        "<style>.u{clip-path:url(#c)} /* path{filter:url(#c)} */</style>",
        f'<defs><g clip-path="url(#c)">{UNSEEN}</g></defs>',
        f'<g display="none" mask="url(#c)">{UNSEEN}</g>',
        f'<g visibility="hidden" filter="url(#c)">{UNSEEN}</g>',
        '<g filter="url(#c)"/><text filter="url(#c)">house</text>',
        *(
            f'<{tag} viewBox="0 0 1 1" id="c">{UNSEEN}</{tag}>'
            for tag in ("symbol", "clipPath", "mask", "marker", "pattern")
        ),
    ],
)
def test_leftovers_of_an_svg_are_neither_refused_nor_drawn(body: str) -> None:
    drawn = read_svg(svg(body + f'<path d="{SQUARE}"/>').encode(), "x.svg")
    assert np.ptp(np.concatenate(drawn.sides["front"]), axis=0) == pytest.approx((100, 100))


def test_a_symbol_is_drawn_where_it_is_used_only() -> None:
    drawn = read_svg(svg(f'{SYMBOL}<use href="#k" x="150"/>').encode(), "x.svg")
    points = np.concatenate(drawn.sides["front"])
    assert points.min(0) == pytest.approx((150, -100))
    assert points.max(0) == pytest.approx((250, 0))


def test_percentages_and_opacity_of_svg() -> None:
    """Percentages are of the view box; what is fully transparent is not there."""
    body = (
        '<rect width="50%" height="20%"/><rect width="300" height="250" opacity="0"/>'
        '<g style="opacity: 0.0"><rect width="300" height="250"/></g>'
    )
    contours = read_svg(svg(body).encode(), "a.svg").sides["front"]
    assert np.ptp(np.concatenate(contours), axis=0).tolist() == pytest.approx([150, 50])


# ---------------------------------------------------------------- sides, units, options


def test_sides_stand_where_their_viewer_sees_them(tmp_path: Path) -> None:
    """Four groups drawn apart: mirrored at the back, corners served twice."""
    made = cells(EXAMPLES / "courtyard.svg").wanted
    assert made.shape == (8, 6, 5)
    assert made[:, 0, 0].tolist() == [True] * 3 + [False] * 2 + [True] * 3  # the gate is in front
    assert made[:, -1, 4].any()
    assert not made[1:-1, 1:-1].any()
    step = '<path d="M0 0h1v1h2v1h-3z"/>'  # high on the left of its viewer
    drawn = svg(f'<g id="front">{step}</g><g id="Back">{step}</g>', "")
    file = write(tmp_path / "two.svg", drawn)
    assert cells(file, cell=1.0, unit="m").drawn == ("front", "back")
    both = cells(file, cell=1.0, unit="m").wanted
    assert both.shape == (3, 2, 2)
    assert both[:, 0, 1].tolist() == [True, False, False]
    assert both[:, 1, 1].tolist() == [False, False, True]
    right = svg(f'<g id="right">{step}</g>', "")
    made = cells(write(tmp_path / "right.svg", right), cell=1.0, unit="m")
    assert made.drawn == ("right",)
    for name, drawn in (("gate.svg", ("front",)), ("figure.png", ("front",)), ("dome.npy", ())):
        assert cells(EXAMPLES / name).drawn == drawn
    wall = made.wanted
    assert wall.shape == (1, 3, 2)
    assert wall[0, :, 1].tolist() == [True, False, False]


def test_layers_of_dxf_are_sides(tmp_path: Path) -> None:
    def draw(document: Any, space: Any) -> None:
        for name, wide in (("FRONT", 3), ("LEFT", 4)):
            document.layers.add(name)
            ring = [(0, 0), (wide, 0), (wide, 2), (0, 2)]
            space.add_lwpolyline(ring, close=True, dxfattribs={"layer": name})

    made = cells(write(tmp_path / "x.dxf", dxf(draw, 6)), cell=1.0).wanted
    assert made.shape == (3, 4, 2)
    assert made[:, 0].all()
    assert made[0].all()
    assert made.sum() == 2 * (3 + 4 - 1)


def test_walls_have_the_depth_asked_for(tmp_path: Path) -> None:
    content, options = SAME["path.svg"]
    made = cells(write(tmp_path / "gate.svg", content), depth=0.1, **options)
    assert np.array_equal(made.wanted, GATE.repeat(2, 1))
    thin = cells(write(tmp_path / "gate.svg", content), depth=0.12, **options)
    assert thin.wanted.shape[1] == 2
    assert thin.volume_error == pytest.approx(2 / 2.4 - 1)
    assert thin.iou == pytest.approx(2 / 2.4)


def test_positions_of_elevations_are_kept() -> None:
    made = cells(EXAMPLES / "off_centre_tower.json")
    assert made.kit == "bricks-lintels"
    x = (np.flatnonzero(made.wanted.any((1, 2))) + 0.5 - made.wanted.shape[0] / 2) * made.cell[0]
    assert x.tolist() == pytest.approx([0.225, 0.275])


def test_the_lattice_is_moved_to_where_it_fits() -> None:
    """A box of 3 x 2 x 1 cells anywhere is found exactly; so is one beside a smaller one."""
    for offset in (0.0, 0.3, 0.5, 0.77):
        box = trimesh.creation.box((3, 2, 1)).apply_translation((offset, 10 + offset, 0.5))
        share, _ = fit(box.triangles, (0, 1))
        assert share.shape == (3, 2, 1)
        assert share.ravel().tolist() == pytest.approx([1.0] * 6)
    small = trimesh.creation.box((0.3, 2, 1)).apply_translation((4.15, 10, 0.5))
    big = trimesh.creation.box((3, 2, 1)).apply_translation((0.5, 10, 0.5))
    share, origin = fit(np.concatenate([big.triangles, small.triangles]), (0, 1))
    assert origin[0] == pytest.approx(-1)
    assert share.sum((1, 2))[:3].tolist() == pytest.approx([2, 2, 2])


@pytest.mark.parametrize("up", ["y", "z"])
def test_up_turns_the_solid(up: str, tmp_path: Path) -> None:
    tower = trimesh.creation.box((1, 3, 1) if up == "y" else (1, 1, 3))
    made = cells(write(tmp_path / "t.obj", mesh(tower, "obj")), unit="m", cell=1.0, up=up)
    assert made.wanted.shape == (1, 1, 3)
    voxels = cells(write(tmp_path / "t.npy", npy(np.ones((1, 3, 2), bool))), up=up)
    assert voxels.wanted.shape == ((1, 2, 3) if up == "y" else (1, 3, 2))


def test_colours_go_with_the_cells(tmp_path: Path) -> None:
    made = cells(EXAMPLES / "figure.png")
    assert made.colours is not None
    assert made.colours.shape == (*made.wanted.shape, 3)
    assert made.colours[3, 0, 0].tolist() == [109, 76, 65]
    assert made.colours[1, 0, 3].tolist() == [198, 40, 40]
    assert not made.wanted[0, 0, 0]
    fine = np.asarray(Image.open(EXAMPLES / "figure.png")).repeat(7, 0).repeat(7, 1)
    again = cells(write(tmp_path / "fine.png", png(fine)), cells_wide=8, size=0.45)
    assert again.colours is not None
    assert np.array_equal(again.wanted, made.wanted)
    assert np.array_equal(again.colours[made.wanted], made.colours[made.wanted])
    assert again.cell == pytest.approx((0.05,) * 3)


RED, BLUE, GREEN = (200, 0, 0), (0, 0, 200), (0, 160, 0)


@pytest.mark.parametrize(
    ("paper", "grey", "cells_there"),
    [
        (255, 150, True),
        (255, 185, True),
        (255, 205, False),
        (200, 130, True),
        (200, 150, False),
        (100, 60, True),
    ],
)
def test_grey_on_white_is_material(
    tmp_path: Path, paper: int, grey: int, cells_there: bool
) -> None:
    """Of a black wall with a grey tower, the tower is built, too; a shade of the paper is not."""
    picture = np.full((6, 8), paper, np.uint8)
    picture[3:, 1:5] = 0
    picture[1:, 5:7] = grey
    made = cells(write(tmp_path / "a.png", png(picture)))
    # On dark paper all is material, as in a picture of nothing but a wall.
    assert made.wanted.sum() == (48 if paper < 128 else 12 + 10 * cells_there)


def test_fill_colours_of_a_drawing_go_to_its_cells(tmp_path: Path) -> None:
    """Blue is painted over red; a cell takes the colour that shows most of it."""
    body = (
        '<rect width="300" height="100" fill="rgb(200,0,0)"/>'
        '<rect x="100" width="130" height="50" fill="rgb(0,0,200)"/>'
    )
    head = 'width="300mm" height="100mm" viewBox="0 0 300 100"'
    made = cells(write(tmp_path / "a.svg", svg(body, head)))
    assert made.colours is not None
    expected = np.full((6, 1, 2, 3), RED)
    expected[2:5, :, 1] = BLUE  # the last of them to three fifths
    assert (made.colours == expected).all()
    # In one colour, black, nothing is said about colours.
    for fill in ("black", ""):
        bar = f'<rect width="300" height="100" fill="{fill}"/>'
        assert cells(write(tmp_path / "b.svg", svg(bar, head))).colours is None


def test_colours_stand_where_their_viewer_sees_them(tmp_path: Path) -> None:
    body = "".join(
        f'<g id="{side}"><rect width="300" height="100" fill="rgb{RED}"/>'
        f'<rect width="100" height="100" fill="rgb{colour}"/></g>'
        for side, colour in (("front", BLUE), ("back", GREEN))
    )
    head = 'width="300mm" height="100mm" viewBox="0 0 300 100"'
    made = cells(write(tmp_path / "a.svg", svg(body, head)))
    assert made.colours is not None
    assert made.colours.shape[:3] == (6, 2, 2)
    assert (made.colours[:2, 0] == BLUE).all()
    assert (made.colours[2:, 0] == RED).all()
    assert (made.colours[4:, 1] == GREEN).all()
    assert (made.colours[:4, 1] == RED).all()


def test_a_cell_of_many_pixels_takes_the_most_frequent_colour(tmp_path: Path) -> None:
    picture = np.full((20, 40, 3), RED, np.uint8)
    picture[:, 17:20] = BLUE  # a third of a cell
    picture[:, 22:40] = GREEN
    made = cells(write(tmp_path / "a.png", png(picture)), cells_wide=4)
    assert made.colours is not None
    row = made.colours[:, 0, 0].tolist()
    assert row == [list(RED), list(RED), list(GREEN), list(GREEN)]
    # Of a photograph's many colours none is a mixture of two far apart.
    noise = np.random.default_rng(0).integers(0, 20, picture.shape)
    made = cells(write(tmp_path / "b.png", png((picture + noise).astype(np.uint8))), cells_wide=4)
    assert made.colours is not None
    assert np.abs(made.colours[:, 0, 0].astype(int) - row).max() <= 20


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.json")), ids=lambda path: path.stem)
def test_elevations_of_today_become_cells(path: Path) -> None:
    made = cells(path)
    assert made.wanted[:, :, 0].any()
    assert made.iou is not None
    assert made.iou > 0.75
    whole = {"arch_pair", "keep", "off_centre_tower", "skyline", "stepped_tower"}
    assert path.stem not in whole or made.iou == pytest.approx(1)


# ---------------------------------------------------------------- volumes


SHAPES = {
    "sphere": trimesh.creation.icosphere(subdivisions=3, radius=0.5),
    "cylinder": trimesh.creation.cylinder(radius=0.4, height=1.0, sections=64),
    "cone": trimesh.creation.cone(radius=0.5, height=1.0, sections=48),
    "ring": trimesh.creation.annulus(0.2, 0.5, 0.6),
    "torus": trimesh.creation.torus(0.4, 0.15),
}


@pytest.mark.parametrize("name", SHAPES)
def test_a_mesh_and_its_cells_agree_in_volume(name: str, tmp_path: Path) -> None:
    shape = SHAPES[name]
    path = write(tmp_path / "x.stl", mesh(shape, "stl"))
    made = cells(path, unit="m", cell=float(shape.extents.max()) / 48)
    assert made.wanted.sum() * np.prod(made.cell) == pytest.approx(shape.volume, rel=0.01)
    assert abs(made.volume_error) < 0.01


def test_shares_are_exact() -> None:
    """Against intersections with boxes by another library."""
    from manifold3d import Manifold, Mesh64

    generator = np.random.default_rng(5)
    for shape in (SHAPES["torus"], trimesh.creation.icosphere(subdivisions=1)):
        turned = shape.copy()
        turned.apply_transform(trimesh.transformations.random_rotation_matrix(generator.random(3)))
        points = turned.vertices / np.ptp(turned.vertices, axis=0).max() * 3.7
        points -= points.min(0) - 0.15
        shape_ = tuple(np.ceil(points.max(0)).astype(int))
        share = shares(points[turned.faces], shape_)
        solid = Manifold(Mesh64(points, turned.faces.astype(np.uint64)))
        assert share.sum() == pytest.approx(solid.volume(), rel=1e-9)
        for i, j, k in np.ndindex(shape_):
            cube = Manifold.cube((1, 1, 1)).translate((i, j, k))
            assert share[i, j, k] == pytest.approx((solid ^ cube).volume(), abs=1e-6)


def test_a_hollow_mesh_stays_hollow_and_objects_are_united(tmp_path: Path) -> None:
    outer, inner = trimesh.creation.box((5, 5, 5)), trimesh.creation.box((3, 3, 3))
    inner.invert()
    hollow = trimesh.util.concatenate([outer, inner])
    made = cells(write(tmp_path / "h.stl", mesh(hollow, "stl")), unit="m", cell=1.0)
    assert made.wanted.sum() == 125 - 27
    inside_out = hollow.copy()
    inside_out.invert()
    again = cells(write(tmp_path / "i.stl", mesh(inside_out, "stl")), unit="m", cell=1.0)
    assert np.array_equal(made.wanted, again.wanted)
    scene = trimesh.Scene()
    scene.add_geometry(trimesh.creation.box((2, 1, 2)))
    move = trimesh.transformations.translation_matrix((1, 0, 0))
    scene.add_geometry(trimesh.creation.box((2, 1, 2)), transform=move)
    both = cells(write(tmp_path / "two.glb", mesh(scene, "glb")), cell=1.0, up="z")
    assert both.wanted.shape == (3, 1, 2)
    assert both.volume_error == pytest.approx(0, abs=1e-6)


def test_rhino_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rhino3dm = pytest.importorskip("rhino3dm")
    model = rhino3dm.File3dm()
    model.Settings.ModelUnitSystem = rhino3dm.UnitSystem.Millimeters
    made, shape = rhino3dm.Mesh(), voxel_mesh(GATE, 50.0)
    for x, y, z in shape.vertices:
        made.Vertices.Add(x, y, z)
    for a, b, c in shape.faces.tolist():
        made.Faces.AddFace(a, b, c)
    model.Objects.AddMesh(made)
    path = tmp_path / "gate.3dm"
    assert model.Write(str(path), 7)
    assert np.array_equal(cells(path).wanted, GATE)
    whole = path.read_bytes()
    solid = rhino3dm.File3dm()
    solid.Objects.AddSphere(rhino3dm.Sphere(rhino3dm.Point3d(0, 0, 0), 1))
    assert solid.Write(str(tmp_path / "solid.3dm"), 7)
    with pytest.raises(InputError, match="without its mesh"):
        read_design(tmp_path / "solid.3dm", unit="m")
    for cut in (40, len(whole) // 2):
        with pytest.raises(InputError):
            read_design(write(tmp_path / "cut.3dm", whole[:cut]))
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(MissingExtraError, match=r"learn2assemble\[rhino\]"):
        read_design(path)


# ---------------------------------------------------------------- round trips

GRIDS = arrays.arrays(np.bool_, st.tuples(*[st.integers(1, 7)] * 3))


@given(wanted=GRIDS, order=st.sampled_from("CF"), kind=st.sampled_from(["?", "u1", "<f8", ">i4"]))
@settings(
    deadline=None, max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_cells_come_back(wanted: np.ndarray, order: Any, kind: str, tmp_path: Path) -> None:
    wanted = wanted.copy()
    wanted[:, :, 0] |= wanted.any(2)  # every column stands on the table
    wanted = np.logical_or.accumulate(wanted[:, :, ::-1], axis=2)[:, :, ::-1]
    wanted[0, 0, 0] = True
    path = write(tmp_path / "x.npy", npy(np.asarray(wanted.astype(kind), order=order)))
    assert np.array_equal(cells(path).wanted, wanted)
    colours = np.random.default_rng(1).integers(0, 256, (*wanted.shape, 3), np.uint8)
    path = write(tmp_path / "x.npz", npz(wanted=wanted, colours=colours, cell=np.full(3, 0.02)))
    made = cells(path)
    assert np.array_equal(made.wanted, wanted)
    assert np.array_equal(made.colours, colours)
    assert made.cell == (0.02,) * 3
    # As a picture: the cells in front, seen from the front.
    face = wanted[:, 0]
    if face.any():
        alpha = np.dstack([colours[:, 0], face[:, :, None] * np.uint8(255)])
        picture = alpha.transpose(1, 0, 2)[::-1]
        seen = cells(write(tmp_path / "x.png", png(np.pad(picture, ((0, 0), (1, 1), (0, 0))))))
        used = np.flatnonzero(face.any(1))
        window = slice(used[0], used[-1] + 1), slice(0, np.flatnonzero(face.any(0))[-1] + 1)
        assert np.array_equal(seen.wanted[:, 0], face[window])
        assert seen.colours is not None
        assert np.array_equal(seen.colours[:, 0][face[window]], colours[:, 0][window][face[window]])


@given(wanted=GRIDS)
@settings(
    deadline=None, max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_the_surface_of_cells_gives_the_cells(wanted: np.ndarray, tmp_path: Path) -> None:
    wanted = np.logical_or.accumulate(wanted[:, :, ::-1], axis=2)[:, :, ::-1].copy()
    wanted[0, 0, :2] = True
    path = write(tmp_path / "x.stl", mesh(voxel_mesh(wanted, 1.0), "stl"))
    made = cells(path, unit="cm", cell=0.01)
    used = np.argwhere(wanted)
    low, high = used.min(0), used.max(0) + 1
    window = tuple(slice(int(a), int(b)) for a, b in zip(low, high, strict=True))
    assert np.array_equal(made.wanted, wanted[window])


# ---------------------------------------------------------------- what must be refused


def _nested_use(levels: int, times: int) -> str:
    body = '<rect id="a0" width="1" height="1"/>'
    for k in range(levels):
        uses = f'<use href="#a{k}" x="1"/>' * times
        body += f'<g id="a{k + 1}">{uses}</g>'
    return svg(f'<defs>{body}</defs><use href="#a{levels}"/>')


def _nested_masks(levels: int, times: int) -> str:
    body = ""
    for k in range(levels):
        mask = f'mask="url(#m{k - 1})"' if k else ""
        shapes = f'<rect width="9" height="9" fill="white" {mask}/>' * times
        body += f'<mask id="m{k}">{shapes}</mask>'
    return svg(f'{body}<rect width="9" height="9" mask="url(#m{levels - 1})"/>')


def _nested_blocks(document: Any, space: Any) -> None:
    document.blocks.new("B0").add_circle((0, 0), 1)
    for k in range(8):
        block = document.blocks.new(f"B{k + 1}")
        for _ in range(10):
            block.add_blockref(f"B{k}", (1, 0))
    space.add_blockref("B8", (0, 0))


def _cyclic_blocks(document: Any, space: Any) -> None:
    block = document.blocks.new("B0")
    block.add_circle((0, 0), 1)
    block.add_blockref("B0", (1, 0))
    space.add_blockref("B0", (0, 0))


def _many_copies(document: Any, space: Any) -> None:
    document.blocks.new("B0").add_circle((0, 0), 1)
    attributes = {"column_count": 30000, "row_count": 30000, "column_spacing": 1}
    space.add_blockref("B0", (0, 0), dxfattribs=attributes)


def _png_header(width: int, height: int) -> bytes:
    def chunk(kind: bytes, data: bytes) -> bytes:
        check = struct.pack(">I", zlib.crc32(kind + data))
        return struct.pack(">I", len(data)) + kind + data + check

    head = struct.pack(">IIBBBBB", width, height, 1, 0, 0, 0, 0)
    body = zlib.compress(bytes(10_000_000))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", body) + chunk(b"IEND", b"")


def _npy_header(text: str) -> bytes:
    head = text.encode().ljust(118) + b"\n"
    return b"\x93NUMPY\1\0" + struct.pack("<H", len(head)) + head + bytes(64)


def _glb(**changes: Any) -> bytes:
    """The gate as GLB with some parts of its JSON replaced."""
    whole = SAME["mesh.glb"][0]
    assert isinstance(whole, bytes)
    length = int.from_bytes(whole[12:16], "little")
    text = json.dumps(json.loads(whole[20 : 20 + length]) | changes).encode()
    text += b" " * (-len(text) % 4)
    rest = whole[20 + length :]
    head = b"glTF" + struct.pack("<II", 2, 20 + len(text) + len(rest))
    return head + struct.pack("<I", len(text)) + b"JSON" + text + rest


def _zip_bomb() -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(
            "wanted.npy",
            _npy_header("{'descr': '|b1', 'fortran_order': False, 'shape': (64, 64, 65536), }")
            + bytes(100_000_000),
        )
    return file.getvalue()


BOX = trimesh.creation.box((0.2, 0.2, 0.2))
OPEN = trimesh.Trimesh(BOX.vertices, BOX.faces[:-1], process=False)
PULLED = BOX.vertices.copy()
PULLED[0] += (0.5, 0.45, 0.4)
CROSSED = trimesh.Trimesh(PULLED, BOX.faces, process=False)
OVERLAP = trimesh.util.concatenate([BOX, BOX.copy().apply_translation((0.07, 0.06, 0.03))])
ALONG = trimesh.util.concatenate([BOX, BOX.copy().apply_translation((0.1, 0, 0))])
RAISED = BOX.copy().apply_translation((0, 0, 1))
SQUARE = "M0 0h100v100h-100z"
FLOATS = np.zeros((3, 3, 4), bool)
FLOATS[:, :, 2:] = True
PARTLY = np.zeros((3, 1, 4), bool)
PARTLY[0, 0, 0] = PARTLY[2, 0, 3] = True
NAN = np.zeros((3, 3, 3))
NAN[1, 1, 1] = np.nan

BAD: dict[str, tuple[str | bytes, dict[str, Any], str]] = {
    "open.stl": (mesh(OPEN, "stl"), {"unit": "m"}, "open mesh"),
    "open.ply": (mesh(OPEN, "ply"), {"unit": "m"}, "open mesh"),
    "open.obj": (mesh(OPEN, "obj"), {"unit": "m"}, "open mesh"),
    "open.glb": (mesh(OPEN, "glb"), {}, "open mesh"),
    "crossed.stl": (mesh(CROSSED, "stl"), {"unit": "m"}, "crosses itself"),
    "overlap.stl": (mesh(OVERLAP, "stl"), {"unit": "m"}, "crosses itself"),
    "along.stl": (mesh(ALONG, "stl"), {"unit": "m"}, "overlap"),
    "flat.obj": ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nf 3 2 1\n", {"unit": "m"}, "without volume"),
    "points.obj": ("v 0 0 0\nv 1 0 0\nv 0 1 0\n", {"unit": "m"}, "expected"),
    "nan.obj": (mesh(BOX, "obj").replace(b"0.1", b"nan", 1), {"unit": "m"}, "expected"),
    "index.obj": (mesh(BOX, "obj") + b"\nf 1 2 999999\n", {"unit": "m"}, "expected"),
    "raised.stl": (mesh(RAISED, "stl"), {"unit": "m"}, "lowest level is 18"),
    "no_unit.stl": (mesh(BOX, "stl"), {}, "unit"),
    "big.stl": (mesh(BOX, "stl"), {"unit": "m", "cell": 0.001}, "at most 64"),
    "huge.stl": (mesh(BOX, "stl"), {"size": 1e9}, "size"),
    "small.stl": (mesh(BOX, "stl"), {"unit": "mm"}, "half full"),
    "promise.stl": (bytes(80) + struct.pack("<I", 4_000_000_000) + bytes(60), {}, "4000000000"),
    "promise.ply": (
        mesh(BOX, "ply").replace(b"element vertex 8", b"element vertex 1000000000000"),
        {"unit": "m"},
        "1000000000012 vertices",
    ),
    "promise.glb": (
        _glb(accessors=[{"count": 10**12, "componentType": 5126, "type": "VEC3"}] * 2),
        {},
        "too many",
    ),
    "draco.glb": (_glb(extensionsRequired=["KHR_draco_mesh_compression"]), {}, "draco"),
    "none.glb": (_glb(nodes=[{"children": [0]}]), {}, "expected"),
    "text.glb": (_glb(nodes=7), {}, "expected"),
    "lines.svg": (svg('<path d="M0 0L9 9L9 0" fill="none" stroke="red"/>'), {}, "no closed"),
    "wide.svg": (
        svg(f'<path d="{SQUARE}"/>', 'width="1e308400mm" viewBox="0 0 9 9"'),
        {},
        "width='1e308400mm'",
    ),
    "metres.svg": (
        svg(f'<path d="{SQUARE}"/>', 'width="48m" height="24mm" viewBox="0 0 9 9"'),
        {},
        "the unit m of width='48m'\", expected a length in one of px, in, cm, mm, q, pt, pc",
    ),
    "empty.svg": (svg(""), {}, "no closed outline"),
    "words.svg": (svg("<text>house</text>"), {}, "no closed outline"),
    "hidden.svg": (svg(f'<path d="{SQUARE}" display="none"/>'), {}, "no closed outline"),
    "white.svg": (svg(f'<path d="{SQUARE}" fill="white"/>'), {}, "without an area"),
    "clip.svg": (svg(f'<path d="{SQUARE}" clip-path="circle(9px)"/>'), {}, "clip-path circle"),
    "clipped.svg": (
        svg(f'<clipPath id="c"/><path d="{SQUARE}" clip-path="url(#c)"/>'),
        {},
        "without an area",
    ),
    "grey.svg": (
        svg(
            '<mask id="m"><rect width="99" height="99" fill="#888"/></mask>'
            f'<path d="{SQUARE}" mask="url(#m)"/>'
        ),
        {},
        "neither black nor white",
    ),
    "faint.svg": (
        svg(
            '<mask id="m"><g opacity=".5"><rect width="99" height="99" fill="white"/></g></mask>'
            f'<path d="{SQUARE}" mask="url(#m)"/>'
        ),
        {},
        "partly transparent",
    ),
    "mask.svg": (
        svg(f'<mask id="m"><text>x</text></mask><g style="mask:url(#m)"><path d="{SQUARE}"/></g>'),
        {},
        "a mask with 1 text",
    ),
    "unread.svg": (
        svg('<text>house</text><image/><line x2="9" stroke="red"/><path d="M0 0h9" stroke="red"/>'),
        {},
        "1 image, 2 strokes, 1 text: convert them to paths",
    ),
    "clip_loop.svg": (
        svg(
            '<clipPath id="c"><rect width="9" height="9" clip-path="url(#c)"/></clipPath>'
            f'<path d="{SQUARE}" clip-path="url(#c)"/>'
        ),
        {},
        "itself",
    ),
    "masks.svg": (_nested_masks(12, 10), {}, "references expanded"),
    "long_masks.svg": (_nested_masks(500, 1), {}, "nested too deeply"),
    "rects.svg": (svg("<rect/>" * 100_000), {}, "too many elements"),
    "entities.svg": (
        "<!DOCTYPE svg [" + '<!ENTITY a "x">' * 60_000 + "]>" + svg("&a;"),
        {},
        "entities",
    ),
    "defaults.svg": (
        f'<!DOCTYPE svg [<!ATTLIST rect z CDATA "{"x" * 99_999}">]>' + svg("<rect/>" * 99_999),
        {},
        "attributes by default",
    ),
    "wide_letters.svg": (b"<svg" + svg("").encode("utf-16-le"), {}, "two bytes"),
    "selectors.svg": (svg(f"<style>{'a,' * 600_000}b{{fill:red}}</style>"), {}, "3000 rules"),
    "rules.svg": (svg(f"<style>{'a{fill:red}' * 9_999}</style>"), {}, "3000 rules"),
    "braces.svg": (svg(f"<style>{'{' * 1_400_000}</style>"), {}, "nested too deeply"),
    "fits.svg": (
        svg(f"<style>{'*{fill:red}' * 2_900}</style>" + '<rect width="9" height="9"/>' * 999),
        {},
        "fit too many",
    ),
    "nan.svg": (svg('<rect width="nan" height="9"/>'), {}, "a length 'nan'"),
    "infinite.svg": (svg('<rect width="1e999" height="9"/>'), {}, "a length '1e999'"),
    "grown.svg": (
        svg('<g transform="scale(1e30)">' * 20 + '<circle r="9"/>' + "</g>" * 20),
        {},
        "beyond 1e9",
    ),
    "no_page.svg": (svg('<rect width="50%" height="50%"/>', ""), {}, "a viewBox"),
    "flat_page.svg": (svg(f'<path d="{SQUARE}"/>', 'viewBox="0 0 0 9"'), {}, "without an area"),
    "far_off.svg": (svg('<rect x="900" width="9" height="9"/>'), {}, "without an area"),
    "thin.svg": (svg('<path d="M0 0L5 5L9 9z"/>'), {}, "expected"),
    "no_unit.svg": (svg(f'<path d="{SQUARE}"/>', 'viewBox="0 0 9 9"'), {}, "size in metres"),
    "layers.svg": (
        svg(f'<g id="front"><path d="{SQUARE}"/></g><g id="bcak"><path d="{SQUARE}"/></g>'),
        {},
        "did you mean 'back'",
    ),
    "beside.svg": (svg(f'<g id="left"><path d="{SQUARE}"/></g><path d="{SQUARE}"/>'), {}, "layer"),
    "apart.svg": (svg(f'<path d="{SQUARE}"/><path d="M0 150h50v50h-50z"/>'), {}, "floats"),
    "uses.svg": (_nested_use(12, 10), {}, "references expanded"),
    "deep.svg": (_nested_use(500, 1), {}, "nested too deeply"),
    "groups.svg": (svg("<g>" * 20_000 + "</g>" * 20_000), {}, "nested too deeply"),
    "itself.svg": (svg('<g id="a"><use href="#a"/></g>'), {}, "itself"),
    "copies.svg": (
        svg(f'<defs><path id="a" d="{"M0 0h1v1z" * 3000}"/></defs>' + '<use href="#a"/>' * 1000),
        {},
        "references expanded",
    ),
    "laughs.svg": (
        '<!DOCTYPE svg [<!ENTITY a "lol"><!ENTITY b "&a;&a;&a;&a;">]>' + svg("&b;"),
        {},
        "entities",
    ),
    "file.svg": (
        '<!DOCTYPE svg [<!ENTITY a SYSTEM "file:///etc/passwd">]>' + svg("<text>&a;</text>"),
        {},
        "entities",
    ),
    "star.svg": (
        svg(f'<path d="M{"L".join(f"{k * k % 977} {k * 313 % 983}" for k in range(9000))}z"/>'),
        {},
        "might cross",
    ),
    "rings.svg": (
        svg("".join(f'<circle fill="none" stroke="red" r="{k}"/>' for k in range(1, 900))),
        {},
        "might cross",
    ),
    "many.obj": ("v 0 0 0\n" * 900_000, {"unit": "m"}, "at most 200000 triangles"),
    "cut.svg": (svg(f'<path d="{SQUARE}"/>')[:-9], {}, "XML"),
    "junk_path.svg": (svg('<path d="M nan inf L 1e999 2 z foo"/>'), {}, "expected"),
    "far.svg": (svg('<path d="M0 0h1e300v1e300z"/>', ""), {"unit": "mm"}, "expected"),
    "blocks.dxf": (dxf(_nested_blocks), {}, "references expanded"),
    "cycle.dxf": (dxf(_cyclic_blocks), {}, "itself"),
    "array.dxf": (dxf(_many_copies), {}, "references expanded"),
    "many.dxf": (
        dxf(lambda d, s: None).replace(b"ENDSEC", b"0\nPOINT\n" * 50_000, 1),
        {},
        "entities",
    ),
    "open.dxf": (dxf(lambda d, s: s.add_line((0, 0), (9, 9))), {}, "no closed outline"),
    "empty.dxf": (dxf(lambda d, s: None), {}, "no closed outline"),
    "no_unit.dxf": (dxf(lambda d, s: s.add_circle((0, 0), 99), 0), {}, "no unit"),
    "layers.dxf": (
        dxf(
            lambda d, s: [
                s.add_circle((0, 0), 99, dxfattribs={"layer": name}) for name in ("front", "roof")
            ]
        ),
        {},
        "layer",
    ),
    "cut.dxf": (dxf(lambda d, s: s.add_circle((0, 0), 99))[:9000], {}, "expected"),
    "binary.dxf": (b"AutoCAD Binary DXF\r\n\x1a\0" + bytes(99), {}, "ASCII"),
    "nan.dxf": (
        dxf(lambda d, s: s.add_lwpolyline([(0, 0), (float("nan"), 0), (9, 9)], close=True)),
        {},
        "expected",
    ),
    "bomb.png": (_png_header(100_000, 100_000), {}, "100000 x 100000"),
    "cut.png": (png(np.zeros((60, 60, 3), np.uint8))[:60], {}, "expected"),
    "white.png": (png(np.full((9, 9, 3), 255, np.uint8)), {}, "no opaque or dark"),
    "clear.png": (png(np.zeros((9, 9, 4), np.uint8)), {}, "no opaque or dark"),
    "large.png": (png(np.zeros((90, 90), np.uint8)), {}, "cells_wide=32 gives 32 × 32 cells"),
    "tall.png": (png(np.zeros((90, 9), np.uint8)), {"cells_wide": 20}, "=6 gives 6 × 60 cells"),
    "apart.png": (png(np.array([[0, 255], [255, 0]], np.uint8)), {}, "lowest level is 1"),
    "pickled.npy": (
        npy(np.array([print], object), allow_pickle=True),
        {},
        "never unpickled",
    ),
    "pickle.npy": (pickle.dumps([1]), {}, "expected"),
    "pickled.npz": (npz(wanted=np.array([{}], object)), {}, "never unpickled"),
    "promise.npy": (
        _npy_header("{'descr': '|b1', 'fortran_order': False, 'shape': (10000, 10000, 10000), }"),
        {},
        "1000000000000 values",
    ),
    "code.npy": (_npy_header("__import__('os').system('false')"), {}, "header"),
    "short.npy": (npy(GATE)[:-1], {}, "cut short"),
    "flat.npy": (npy(GATE[:, 0]), {}, "shape"),
    "none.npy": (npy(np.zeros((0, 3, 3), bool)), {}, "shape"),
    "empty.npy": (npy(np.zeros((3, 3, 3), bool)), {}, "half full"),
    "large.npy": (npy(np.ones((65, 1, 1), bool)), {}, "at most 64"),
    "nan.npy": (npy(NAN), {}, "nan"),
    "half.npy": (npy(np.full((2, 2, 2), 0.5)), {}, "0.5"),
    "floats.npy": (npy(FLOATS), {}, "lowest level is 2"),
    "partly.npy": (npy(PARTLY), {}, "lowest level is 3"),
    "wide.npy": (npy(GATE), {"cells_wide": 3}, "no such option"),
    "bomb.npz": (_zip_bomb(), {}, "values"),
    "cut.npz": (npz(wanted=GATE)[:-30], {}, "ZIP"),
    "other.npz": (npz(a=GATE, b=GATE), {}, "wanted"),
    "misspelt.npz": (npz(wanted=GATE, colurs=GATE), {}, "did you mean 'colours'"),
    "cell.npz": (npz(wanted=GATE, cell=np.array([np.nan])), {}, "cell"),
    "packed.npy": (gzip.compress(npy(GATE)), {}, "gzip"),
    "bomb.json": (gzip.compress(bytes(30_000_000)), {}, "gzip"),
    "deep.json": ("[" * 500_000, {}, "nested"),
    "digits.json": ('{"elevations": 1' + "0" * 9999 + "}", {}, "ordinary size"),
    "other.json": ("{}", {}, "elevations"),
    "format.json": ('{"format": "x", "elevations": []}', {}, "learn2assemble-design"),
    "bell.json": (
        '{"name": "a\\u0007", "elevations": [{"outline": [[0,0],[1,0],[0,1]]}]}',
        {},
        "printable",
    ),
    "none.json": ('{"elevations": []}', {}, "1 to 4"),
    "empty.json": ("{}", {}, "got 'no keys', expected the key 'elevations'"),
    "alone.json": ('{"name": "x"}', {}, "got ['name'], expected the key 'elevations'"),
    "plan.json": (
        '{"format": "learn2assemble-plan", "steps": []}',
        {},
        "format: got 'learn2assemble-plan', expected 'learn2assemble-design'; of a plan, its fold",
    ),
    "key.json": ('{"elevation": []}', {}, "did you mean 'elevations'"),
    "nan.json": ('{"elevations": [{"outline": [[0, 0], [1, NaN], [1, 0]]}]}', {}, "finite"),
    "tall.json": ('{"elevations": [{"outline": [[0, 0], [1, 1e308], [1, 0]]}]}', {}, "1e+09"),
    "cross.json": ('{"elevations": [{"outline": [[0,0],[1,1],[1,0],[0,1]]}]}', {}, "crosses"),
    "below.json": ('{"elevations": [{"outline": [[0,-1],[1,0],[0,1]]}]}', {}, "below the table"),
    "up.json": (
        '{"elevations": [{"outline": [[0,0.1],[0.1,0.1],[0.1,0.3],[0,0.3]]}]}',
        {},
        "lowest level is 2",
    ),
    "far.json": ('{"elevations": [{"outline": [[9,0],[9.1,0],[9,0.3]]}]}', {}, "at most 64"),
    "long.json": (json.dumps({"elevations": [], "name": "x" * 2_000_000}), {}, "at most"),
    "none": (b"", {}, "empty file"),
    "unit.svg": (svg(f'<path d="{SQUARE}"/>'), {"unit": "km"}, "unit"),
    "cell.svg": (svg(f'<path d="{SQUARE}"/>'), {"cell": float("nan")}, "cell"),
    "cells.svg": (svg(f'<path d="{SQUARE}"/>'), {"cell": (1, 2)}, "cell"),
    "size.svg": (svg(f'<path d="{SQUARE}"/>'), {"size": -1.0}, "size"),
    "depth.svg": (svg(f'<path d="{SQUARE}"/>'), {"depth": 50.0}, "at most 64"),
    "up.svg": (svg(f'<path d="{SQUARE}"/>'), {"up": "z"}, "no such option"),
    "x.stl": (mesh(BOX, "stl"), {"unit": "m", "up": "x"}, "up"),
    "both.svg": (svg(f'<path d="{SQUARE}"/>'), {"size": 1.0, "cells_wide": 3}, "either"),
    "kit.svg": (svg(f'<path d="{SQUARE}"/>'), {"kit": "brickz"}, "bricks"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_files_are_refused_in_one_line(name: str, tmp_path: Path) -> None:
    content, options, fragment = BAD[name]
    with pytest.raises(InputError) as caught:
        read_design(write(tmp_path / name, content), **options)
    message = str(caught.value)
    assert fragment in message
    assert "\n" not in message
    assert len(message) < 600


@pytest.mark.parametrize("name", SAME)
def test_truncated_files_are_refused_or_read(name: str, tmp_path: Path) -> None:
    """Whatever is left of a file, there are cells or one line of words, and no other error."""
    content, options = SAME[name]
    whole = content.encode() if isinstance(content, str) else content
    generator = np.random.default_rng(len(whole))
    refused = []
    for cut in generator.integers(0, len(whole), 6).tolist():
        spoilt = bytearray(whole)
        spoilt[cut] ^= 1 << int(generator.integers(8))
        for content in (whole[:cut], bytes(spoilt)):
            try:
                cells(write(tmp_path / name, content), **options)
            except InputError as error:
                refused.append(str(error))
    assert refused
    assert not any("\n" in message for message in refused)


@pytest.mark.parametrize(
    "ending", ["json", "svg", "dxf", "png", "stl", "obj", "ply", "glb", "3dm", "npy", "npz"]
)
def test_garbage_is_refused_under_every_name(ending: str, tmp_path: Path) -> None:
    generator = np.random.default_rng(3)
    starts = [
        b"",
        b"\x89PNG\r\n\x1a\n",
        b"\x93NUMPY",
        b"PK\x03\x04",
        b"glTF",
        b"ply\n",
        b"{",
        b"<svg",
        b"0\nSECTION\n",
        b"solid\nfacet ",
        b"v 1 ",
    ]
    for start in starts if ending != "3dm" else [b"3D Geometry File Format "]:
        path = write(tmp_path / f"x.{ending}", start + generator.bytes(3000))
        with pytest.raises(InputError) as caught:
            read_design(path, **({"unit": "m"} if start in (b"solid\nfacet ", b"v 1 ") else {}))
        assert "\n" not in str(caught.value)


def test_names_that_are_no_files(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "nosuch.svg", tmp_path / "a\0b"):
        with pytest.raises(InputError):
            read_design(path)


def test_assemblies_are_known_by_content() -> None:
    for text in (
        b'{"format": "learn2assemble-assembly", "version": 1}',
        b'{"dtype": "compas_assembly.datastructures/Assembly", "data": {}}',
    ):
        assert kind_of(text, "x") == "assembly"


def test_crossings_are_found_and_contact_is_none() -> None:
    box = trimesh.creation.box()
    for shift, expected in (((0.5, 0.4, 0.3), True), ((1, 0, 0), False), ((3, 0, 0), False)):
        both = trimesh.util.concatenate([box, box.copy().apply_translation(shift)])
        assert crossed(both.vertices, both.faces) is expected
