"""The page of an assembly: what it holds is the assembly, whatever the shapes of its blocks."""

from __future__ import annotations

import base64
import html
import itertools
import json
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from headless import FLAT, SPATIAL, browse, find_browser, pixels, shoot
from learn2assemble.assembly.blocks import Assembly, AssemblyStep, Block
from learn2assemble.assembly.boxes import box_block
from learn2assemble.assembly.contacts import find_contacts
from learn2assemble.assembly.instructions.appearance import PALETTE, millimetres
from learn2assemble.assembly.kit import load_kit
from learn2assemble.errors import InputError
from learn2assemble.export.cards import step_cards
from learn2assemble.geometry.rotations import yaw_matrix
from learn2assemble.planning.tiling.ordering import polycube
from learn2assemble.viewer.page import Verdict, render_assembly_page
from learn2assemble.viewer.scene import first_view, is_behind, side_covers
from learn2assemble.viewer.tables import StepNote
from learn2assemble.viewer.words import newtons
from read_back import STRUCTURES

EDGE = 0.05


def wall(length: int, height: int) -> Assembly:
    """Bricks of two cells in bond, one cell at the ends, one behind the other in two rows."""
    blocks = []
    for z in range(height):
        for y in range(2):
            ends = sorted({0, *range(z % 2, length, 2), length})
            for a, b in itertools.pairwise(ends):
                box = EDGE * np.array([(a, y, z), (b, y + 1, z + 1)])
                blocks.append(box_block(f"b{len(blocks)}", *box.tolist(), kind=f"1x{b - a}"))
    return Assembly(tuple(blocks), tuple(AssemblyStep(place=block.id) for block in blocks))


def corner(id_: str, at: tuple[float, float, float]) -> Block:
    """An L of three cells, which is not convex."""
    flat = [(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)]
    points = [(x, y, z) for z in (0, 1) for x, y in flat]
    sides = tuple((k, (k + 1) % 6, (k + 1) % 6 + 6, k + 6) for k in range(6))
    faces = (tuple(range(5, -1, -1)), tuple(range(6, 12)), *sides)
    return Block(id_, EDGE * np.array(points) + at, faces, kind="corner")


def with_prop() -> Assembly:
    base = box_block("plate", (0, 0, -0.02), (0.5, 0.2, 0), support=True)
    post = box_block("post", (0, 0, 0), (EDGE, EDGE, EDGE), colour=(10, 200, 30))
    prop = box_block("prop", (0.2, 0, 0), (0.25, EDGE, EDGE), prop=True)
    steps = (
        AssemblyStep("post"),
        AssemblyStep("prop"),
        AssemblyStep("L"),
        AssemblyStep(remove="prop"),
    )
    return Assembly((base, post, prop, corner("L", (0, 0, EDGE))), steps)


def write_assembly_page(path: Path, assembly: Assembly, **words: Any) -> None:
    path.write_text(render_assembly_page(assembly, **words), encoding="utf-8")


def steps_and_gate() -> Assembly:
    """Two blocks of cells on several levels: one goes up like stairs, one is open below."""
    kit = load_kit("tetrominoes")
    stairs = np.array([[0, 0, 0], [1, 0, 0], [1, 0, 1], [1, 1, 1]])
    gate = np.array([[0, 0, 0], [2, 0, 0], [0, 0, 1], [1, 0, 1], [2, 0, 1]])
    blocks = []
    for cells, x in ((stairs, 0.0), (gate, 0.5)):
        vertices, faces = polycube(cells, kit, kit.joint_gap)
        blocks.append(Block(f"at {x}", vertices + np.array([x, 0, 0]), faces))
    blocks.append(box_block("beside the second level", (1.0, 0.0, 0.05), (1.05, 0.05, 0.1)))
    return Assembly(tuple(blocks), tuple(AssemblyStep(block.id) for block in blocks))


def page_data(text: str) -> dict[str, Any]:
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', text)
    assert found
    return json.loads(found[1])


def unpacked(field: dict[str, Any]) -> np.ndarray:
    raw = np.frombuffer(base64.b64decode(field["data"]), "<u2").reshape(-1, len(field["low"]))
    return np.array(field["low"]) + raw * np.array(field["scale"])


def solid(data: dict[str, Any], number: int) -> np.ndarray:
    """float64[t, 3, 3]: triangles of a block as the page draws them."""
    shapes, (shape, *at) = data["shapes"], data["blocks"][number][:4]
    kind = "<u4" if shapes["wide"] else "<u2"
    triangles = np.frombuffer(base64.b64decode(shapes["triangles"]), kind).reshape(-1, 3)
    points = unpacked(shapes["vertices"])[shapes["first"][shape] : shapes["first"][shape + 1]]
    return points[triangles[shapes["faces"][shape] : shapes["faces"][shape + 1]]] + at


def area(ring: list[list[float]]) -> float:
    x, y = np.array(ring).T
    return float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2


def test_lengths_are_told_without_powers_of_ten() -> None:
    assert millimetres(0.1, 0.04995, 11.4) == "100 × 49.95 × 11400 mm"


@pytest.mark.parametrize("assembly", [wall(5, 3), with_prop(), steps_and_gate()])
def test_the_page_draws_the_solids_of_the_assembly(assembly: Assembly) -> None:
    data = page_data(render_assembly_page(assembly, title="x"))
    for number, block in enumerate(assembly.blocks):
        corners = solid(data, number)
        for end in (np.min, np.max):
            drawn = end(corners.reshape(-1, 3), 0)
            np.testing.assert_allclose(drawn, end(block.vertices, 0), atol=2e-5)
        volume = np.einsum("ti,ti->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
        assert volume == pytest.approx(block.volume, rel=2e-3), "closed, faces outward"
        cuts = data["shapes"]["sections"][data["blocks"][number][0]]
        filled = sum(abs(sum(map(area, rings))) * (top - low) for low, top, rings, _ in cuts)
        assert filled == pytest.approx(block.volume, rel=2e-3), "these are all prisms"
        assert (cuts[0][0], cuts[-1][1]) == pytest.approx(
            (0, np.ptp(block.vertices[:, 2])), abs=2e-5
        )


def test_the_table_tells_positions_and_nominal_sizes() -> None:
    gap = 1e-4
    blocks = [
        box_block(
            f"b{k}", (EDGE * k + gap / 2, 0.02, 0), (EDGE * (k + 1) - gap / 2, 0.07 - gap, EDGE)
        )
        for k in (0, 1)
    ]
    text = render_assembly_page(
        Assembly(tuple(blocks), tuple(AssemblyStep(b.id) for b in blocks)), title="x"
    )
    rows = re.findall(r'<tr data-step="\d">(.*?)</tr>', text)
    told = [re.findall(r"<td[^>]*>([^<]*)</td>", row)[1:] for row in rows]
    assert [row[:5] for row in told] == [["A", "0", "0", "0", "0"], ["A", "50", "0", "0", "0"]]
    assert {row[6] for row in told} == {"50 × 50 × 50"}
    assert "<td>50 × 50 × 50</td><td>49.9 × 49.9 × 50</td>" in text
    assert "joints are 0.1 mm wide" in text


def test_equal_shapes_are_stored_once() -> None:
    assembly = wall(6, 5)
    data = page_data(render_assembly_page(assembly, title="x"))
    assert len(data["shapes"]["sections"]) == 2
    assert [row[-1] for row in data["blocks"]] == [block.id for block in assembly.blocks]
    assert len(data["layers"]) == 5
    layers = [row[-4] for row in data["blocks"]]
    bottoms = [round(block.vertices[:, 2].min() / EDGE) for block in assembly.blocks]
    assert layers == bottoms


@given(st.lists(st.floats(0, 3), min_size=1, max_size=60))
@settings(max_examples=40, deadline=None)
def test_layers_are_few_and_follow_the_heights(heights: list[float]) -> None:
    blocks = [box_block(f"b{k}", (k, 0, z), (k + 1, 1, z + 1)) for k, z in enumerate(heights)]
    data = page_data(render_assembly_page(Assembly(tuple(blocks)), title="x"))
    layers = np.array([row[-4] for row in data["blocks"]])
    assert len(data["layers"]) <= 4 * max(np.ceil(np.ptp(heights)), 1) + 1
    assert set(layers) == set(range(len(data["layers"]))), "none is empty"
    order = np.argsort(heights, kind="stable")
    assert (np.diff(layers[order]) >= 0).all()


def test_steps_of_props_and_supports() -> None:
    text = render_assembly_page(with_prop(), title="x", verdict=Verdict("complete"))
    data = page_data(text)
    history = {row[-1]: (data["colours"][row[5]], *row[-3:-1]) for row in data["blocks"]}
    assert history == {
        "plate": ("support", 0, 0),
        "post": ("#0ac81e", 1, 0),
        "prop": ("prop", 2, 4),
        "L": (PALETTE[0], 3, 0),
    }
    assert data["captions"][4].startswith("Remove prop (")
    rows = re.findall(r'<tr data-step="(\d)">.*?<td>(place|remove)</td>', text)
    assert rows == [("1", "place"), ("2", "place"), ("3", "place"), ("4", "remove")]
    bill = text.split("Bill of blocks")[1].split("</table>")[0]
    lines = [
        re.findall(r"<td[^>]*>(?:<svg.*?</svg>)?([^<]*)</td>", row)
        for row in re.findall(r"<tr>(.*?)</tr>", bill)[1:]
    ]
    assert [line[2:4] for line in lines] == [
        ["0 + 1 standing", "–"],
        ["1", "–"],
        ["0", "1"],
        ["1", "–"],
    ]


def test_a_prop_that_is_used_twice_stays_twice() -> None:
    post, prop = with_prop().blocks[1:3]
    steps = (
        AssemblyStep("post"),
        AssemblyStep("prop"),
        AssemblyStep(remove="prop"),
        AssemblyStep("prop"),
        AssemblyStep(remove="prop"),
    )
    text = render_assembly_page(Assembly((post, prop), steps), title="x")
    stays = [row[-3:] for row in page_data(text)["blocks"]]
    assert stays == [[1, 0, "post"], [2, 3, "prop"], [4, 5, "prop"]]
    actions = re.findall(r"<td>(place|remove)</td>", text)
    assert actions == ["place", "place", "remove", "place", "remove"]
    assert "1 block, " in text
    assert "1 prop, 5 steps" in text


def test_notes_joints_and_forces_are_those_given() -> None:
    assembly = wall(4, 2)
    contacts = find_contacts(assembly.finished)
    forces = np.random.default_rng(0).normal(size=contacts.points.shape)
    notes = [StepNote("local certificate", 0.25)] * (len(assembly.steps) - 1)
    notes.append(StepNote("program"))
    text = render_assembly_page(
        assembly,
        title="x",
        step_notes=notes,
        forces=(contacts, forces),
        verdict=Verdict(moving=["b1"]),
    )
    data = page_data(text)
    np.testing.assert_allclose(unpacked(data["joints"]["points"]), contacts.points, atol=1e-5)
    np.testing.assert_allclose(unpacked(data["joints"]["forces"]), forces, atol=1e-3)
    assert data["joints"]["start"] == contacts.start.tolist()
    assert text.count("<td>local certificate</td>") == len(notes) - 1
    for number in (1, 4):
        mass = sum(assembly.block(step.place or "").mass for step in assembly.steps[:number])
        push = newtons(0.25 * 9.80665 * mass)
        assert float(push) == float(f"{0.25 * 9.80665 * mass:.2g}")
        words = f"a sideways push of {push} N in every direction, shared by all blocks by weight"
        assert f"{words} (0.25 g)" in data["captions"][number]
        assert "or a tilt of 14.0°" in data["captions"][number]
        row = text.split(f'<tr data-step="{number}">')[1].split("</tr>")[0]
        assert f'<td class="number">{push}</td><td class="number">0.25</td>' in row
    assert data["colours"][data["blocks"][1][5]] == "bad"
    plain = render_assembly_page(assembly, title="x", forces=(contacts, None))
    assert 'id="show-joints"' in plain
    assert 'id="show-forces"' not in plain
    with pytest.raises(InputError, match="step_notes"):
        render_assembly_page(assembly, title="x", step_notes=notes[1:])


def test_forces_are_plain_numbers() -> None:
    given = 0.0, 0.5, 0.03149, 7.0, 66.6, 671.2, 1290.0, 1.2e6, 3.14e-5
    told = "0", "0.5", "0.031", "7", "67", "670", "1300", "1200000", "0.000031"
    assert tuple(map(newtons, given)) == told


@pytest.mark.parametrize(
    "evil", ["</script><script>alert(1)</script>", '"><img src=x onerror=a()>']
)
def test_text_of_an_assembly_never_becomes_markup(evil: str) -> None:
    def render(text: str) -> str:
        block = box_block(text, (0, 0, 0), (1, 1, 1), kind=text)
        assembly = Assembly((block,), (AssemblyStep(place=text),))
        return render_assembly_page(
            assembly,
            title=text,
            facts=[(text, text)],
            verdict=Verdict(text, text),
            step_notes=[StepNote(text, 1.0)],
        )

    clean, page = render("plain"), render(evil)
    assert page.count("<script") == clean.count("<script")
    assert "<img" not in page
    assert html.escape(evil) in page
    policy = re.search(r'Security-Policy" content="([^"]*)"', page)
    assert policy
    assert "unsafe" not in policy[1]


def test_two_thousand_blocks_are_a_small_page(tmp_path: Path) -> None:
    assembly = wall(40, 50)
    assert len(assembly.blocks) > 2000
    contacts = find_contacts(assembly)
    write_assembly_page(
        tmp_path / "view.html",
        assembly,
        title="large",
        step_notes=[StepNote("local certificate", 0.3)] * len(assembly.steps),
        forces=(contacts, np.ones_like(contacts.points)),
    )
    assert (tmp_path / "view.html").stat().st_size < 5_000_000


@pytest.mark.browser
def test_blocks_and_layers_follow_the_timeline(browser: str, tmp_path: Path) -> None:
    assembly = wall(6, 4)
    for name in ("flat", "spatial"):
        (tmp_path / name).mkdir()
        path = tmp_path / name / "view.html"
        write_assembly_page(path, assembly, title="wall", verdict=Verdict("complete"))
    half = len(assembly.steps) // 2
    anchors = ("step=0", f"step={half}", f"step={len(assembly.steps)}")
    flat, log = shoot(browser, tmp_path / "flat", anchors, (1000, 900), *FLAT)
    assert "CONSOLE" not in log, log
    assert len({image.tobytes() for image in flat}) == 3, "the plan of the layer changes"
    images, log = shoot(browser, tmp_path / "spatial", anchors, (1000, 900), *SPATIAL)
    assert "Uncaught" not in log, log
    stage = [image[240:680, 40:560] for image in images]
    if pixels(stage[0], "#f1efea") > 0.95 * stage[0][..., 0].size:
        pytest.skip("this browser has no software WebGL")
    red = [(image[..., 0] > 1.5 * image[..., 2]).mean() for image in stage]
    assert red[0] + 0.02 < red[1] < red[2] - 0.02, red


@pytest.mark.browser
def test_blocks_are_drawn_in_every_layer_they_reach_into(browser: str, tmp_path: Path) -> None:
    write_assembly_page(tmp_path / "view.html", steps_and_gate(), title="levels")
    dom, log = browse(
        browser,
        tmp_path / "run",
        f"{(tmp_path / 'view.html').as_uri()}#step=3",
        *FLAT,
        "--dump-dom",
    )
    assert "CONSOLE" not in log, log
    assert dom.count('class="block reaching"') == 2, "stairs and gate, in the second layer"


@pytest.mark.browser
def test_layers_are_those_of_what_is_built(browser: str, tmp_path: Path) -> None:
    """A tower of three is turned into one block on the old ground: the tower has no layers."""
    tower = [box_block(f"old {z}", (0, 0, z), (1, 1, z + 1), kind="old") for z in range(3)]
    new = box_block("new", (2, 0, 0), (3, 1, 1), kind="new")
    away = [AssemblyStep(remove=block.id) for block in tower[::-1]]
    turned = Assembly((*tower, new), (*away, AssemblyStep("new")))
    write_assembly_page(tmp_path / "view.html", turned, title="turned")
    (layer,) = page_data((tmp_path / "view.html").read_text())["layers"]
    assert layer.startswith("Layer 1 of 1, from 0 mm: 1 of new. Its first block, of step 4")
    page = f"{(tmp_path / 'view.html').as_uri()}#step=4"
    dom, log = browse(browser, tmp_path / "run", page, *FLAT, "--dump-dom")
    assert "CONSOLE" not in log, log
    plan = re.search(r'id="layer-plan".*?</svg>', dom, re.DOTALL)
    assert plan
    assert set(re.findall(r'data-step="(\d+)"', plan[0])) == {"4"}


@pytest.mark.browser
def test_the_page_runs_without_an_error(browser: str, tmp_path: Path) -> None:
    write_assembly_page(tmp_path / "view.html", with_prop(), title="prop")
    dom, log = browse(
        browser,
        tmp_path / "run",
        f"{(tmp_path / 'view.html').as_uri()}#step=4",
        *SPATIAL,
        "--dump-dom",
        "--window-size=500,600",
    )
    root = re.search(r"<html[^>]*>", dom)
    assert root, log
    assert 'data-ready="yes"' in root[0], log
    assert "data-error" not in root[0]
    assert "Uncaught" not in log
    assert "Content Security Policy" not in log
    assert re.findall(r'<tr data-step="(\d+)" class="[^"]*current', dom) == ["4"]
    layer = re.search(r'id="layer-words"[^>]*>([^<]*)', dom)
    assert layer
    assert layer[1].startswith("Layer 2 of 3"), "the layer of the prop that is removed"


@pytest.mark.browser
def test_keys_turn_the_view_and_print_has_a_picture_of_it(browser: str, tmp_path: Path) -> None:
    """The keys of the 3-D view leave the timeline alone; what is printed is drawn without WebGL."""
    text = render_assembly_page(wall(6, 4), title="wall")
    text = re.sub(r'<meta http-equiv="Content-Security-Policy"[^>]*>', "", text)
    harness = """<pre id="out"></pre><script>
    const canvas = document.getElementById("canvas"), print = document.getElementById("print-view");
    const shot = () => {
      dispatchEvent(new Event("beforeprint"));
      return print.width ? print.toDataURL() : "";
    };
    const shots = [shot()];
    canvas.focus();
    for (const key of ["ArrowLeft", "+", "0"]) {
      canvas.dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true }));
      shots.push(shot());
    }
    const found = {
      focus: document.activeElement === canvas, step: document.documentElement.dataset.step,
      same: shots.map((one) => shots.indexOf(one)), length: shots[0].length };
    document.getElementById("out").textContent = JSON.stringify(found);
    </script></body>"""
    (tmp_path / "view.html").write_text(text.replace("</body>", harness), encoding="utf-8")
    address = (tmp_path / "view.html").as_uri()
    dom, log = browse(browser, tmp_path / "run", f"{address}#step=5", *SPATIAL, "--dump-dom")
    if 'data-webgl="missing"' in dom:
        pytest.skip("this browser has no software WebGL")
    out = re.search(r'<pre id="out">(.*?)</pre>', dom)
    assert out, log
    found = json.loads(html.unescape(out[1]))
    assert found["focus"]
    assert found["step"] == "5"
    assert found["length"] > 3000, "not an empty picture"
    assert found["same"] == [0, 1, 2, 0], "two other views, and back to the first"


@pytest.mark.parametrize(
    ("size", "yaw", "arm", "view"),
    [
        ((5, 1, 2), 0, None, (0, -0.5)),
        ((1, 5, 2), 0, None, (-90, -0.5)),
        ((5, 1, 2), 30, None, (30, -0.5)),
        ((2, 2, 8), 0, None, (0, -0.5)),
        # The arm is behind the wall, and beside it in the picture.
        ((5, 1, 2), 0, (0.0, 3.0), (0, -0.8)),
        ((5, 1, 2), 0, (2.0, 3.0), (0, 0.8)),
        ((5, 1, 2), 0, (0.0, -3.0), (180, -0.8)),
        ((1, 5, 2), 0, (-3.0, 0.0), (90, -0.8)),
        # At one end of it, or of a tower: on the left.
        ((5, 1, 2), 0, (-5.0, 0.0), (0, 0.5)),
        ((2, 2, 8), 0, (-3.0, 0.0), (0, 0.5)),
        ((2, 2, 8), 0, (0.0, -3.0), (90, 0.5)),
    ],
)
def test_the_wide_side_faces_the_viewer_first(
    size: tuple[float, float, float],
    yaw: float,
    arm: tuple[float, float] | None,
    view: tuple[float, float],
) -> None:
    half = np.array(size) / 2
    box = box_block("b", (1 - half).tolist(), (1 + half).tolist())
    turned = replace(box, vertices=(box.vertices - 1) @ yaw_matrix(math.radians(yaw)).T + 1)
    turn, aside = first_view([turned], [] if arm is None else [np.array(arm) + 1])
    assert (round(math.degrees(turn)) % 360, aside) == (view[0] % 360, view[1])


@pytest.mark.parametrize(
    ("size", "arms", "view", "behind"),
    [
        # It stands behind, or at an end: as of what nobody has drawn.
        ((0.4, 0.05), [(0.0, 0.5)], (0, -0.8), False),
        ((0.4, 0.05), [(-0.5, 0.0)], (0, 0.5), False),
        # Before it: from so far on the other side that it stands beside it.
        ((0.4, 0.05), [(0.0, -0.5)], (0, 0.8), False),
        ((0.4, 0.05), [(0.15, -0.5)], (0, -0.5), False),
        ((0.9, 0.05), [(0.0, -0.5)], (0, 1.5), False),
        ((0.1, 0.1), [(0.0, -0.5)], (0, 0.5), False),
        # It is too wide for that, or a second arm stands there: from behind, which is said.
        ((2.0, 0.05), [(0.0, -0.5)], (180, -0.8), True),
        ((0.6, 0.05), [(0.0, -0.5), (0.5, -0.5), (-0.5, -0.5)], (180, -0.8), True),
        # Deeper than wide: the narrow front was drawn.
        ((0.1, 0.5), [], (0, 0.5), False),
    ],
)
def test_the_drawn_front_is_seen_where_no_arm_hides_it(
    size: tuple[float, float],
    arms: list[tuple[float, float]],
    view: tuple[float, float],
    behind: bool,
) -> None:
    half = np.array([*size, 0.3]) / 2
    box = box_block("b", (1 - half).tolist(), (1 + half).tolist())
    found = first_view([box], [np.array(arm) + 1 for arm in arms], front=True)
    assert (round(math.degrees(found[0])) % 360, found[1]) == view
    assert is_behind(found) is behind


def test_sides_are_left_out_only_where_blocks_cover_them() -> None:
    """A cube of 3 x 3 x 3 boxes with joints of 0.1 mm, its top middle one replaced by a bar."""
    edge, gap = 0.05, 1e-4
    places = [(x, y, z) for x in range(3) for y in range(3) for z in range(3)]
    blocks = []
    for place in places:
        low = np.array(place) * edge
        inset = np.array([gap / 2, gap / 2, 0])
        blocks.append(box_block("-".join(map(str, place)), low + inset, low + edge - inset))
    covers = side_covers(blocks)
    number = {place: k for k, place in enumerate(places)}
    middle = covers[number[1, 1, 1]]
    assert middle is not None
    assert middle == [
        [number[0, 1, 1]],
        [number[2, 1, 1]],
        [number[1, 0, 1]],
        [number[1, 2, 1]],
        [number[1, 1, 0]],
        [number[1, 1, 2]],
    ]
    corner = covers[number[0, 0, 0]]
    assert corner is not None
    assert [bool(side) for side in corner] == [False, True, False, True, False, True]
    # Half of a side is not enough, two halves are, and a slanted block covers nothing.
    low = box_block("low", (0, 0, 0), (2, 1, 1))
    half = box_block("half", (0, 0, 1), (1, 1, 2))
    rest = box_block("rest", (1, 0, 1), (2, 1, 2))
    assert side_covers([low, half]) == [None, [[], [], [], [], [0], []]]
    assert side_covers([low, half, rest])[0] == [[], [], [], [], [], [1, 2]]
    raised = rest.vertices + [[0, 0, 0.3 * (k == 7)] for k in range(8)]
    cut = replace(rest, vertices=raised)
    assert side_covers([low, half, cut])[0] is None


# On paper and on small screens, cards too.

SCREENS = ((1400, 900), (900, 900), (390, 844))


@pytest.fixture(scope="module")
def house() -> Assembly:
    return STRUCTURES["house"]()


def page_of(assembly: Assembly) -> str:
    notes = [StepNote("bed faces, local", 0.2, 0.5)] * len(assembly.steps)
    return render_assembly_page(
        assembly, title="house", step_notes=notes, verdict=Verdict("complete")
    )


@pytest.mark.browser
@pytest.mark.parametrize("document", ["page", "cards"])
def test_no_printed_page_is_empty_and_none_cuts_a_line(
    house: Assembly, document: str, tmp_path: Path
) -> None:
    pypdf = pytest.importorskip("pypdf")
    browser = find_browser()
    text = page_of(house) if document == "page" else step_cards(STRUCTURES["gate"]())
    (tmp_path / "view.html").write_text(text, encoding="utf-8")
    paper = tmp_path / "paper.pdf"
    address = (tmp_path / "view.html").as_uri()
    browse(
        browser,
        tmp_path / "run",
        address,
        *FLAT,
        "--no-pdf-header-footer",
        f"--print-to-pdf={paper}",
    )
    pages = [page.extract_text() for page in pypdf.PdfReader(paper).pages]
    assert len(pages) > 1
    assert all(len(words.split()) > 20 for words in pages)
    for number, words in enumerate(pages, 1):
        assert re.search(rf"{number}\s*/\s*{len(pages)}", words), "every page has its number"
    if document == "page":
        rows = [re.findall(r"^\s*(\d+)\s*(?:place|remove)", words, re.MULTILINE) for words in pages]
        told = [int(number) for found in rows for number in found]
        assert told == list(range(1, len(house.steps) + 1))
        parts = sum(bool(found) for found in rows)
        heads = sum("Nominal size" in w and "Turn" in w and "Push" in w for w in pages)
        assert heads >= parts, "the head of the table stands on each of its pages"


@pytest.mark.browser
def test_the_timeline_is_in_sight_without_scrolling(house: Assembly, tmp_path: Path) -> None:
    """Measured inside frames of the size of three screens, which tell the page around them."""
    browser = find_browser()
    text = re.sub(r'<meta http-equiv="Content-Security-Policy"[^>]*>', "", page_of(house))
    measure = """<script>
    const seen = [...document.querySelectorAll(".timeline button, #slider, #stage")]
      .map((item) => item.getBoundingClientRect());
    parent.postMessage({ width: innerWidth, height: innerHeight,
      low: Math.min(...seen.map((one) => one.left)),
      right: Math.max(...seen.map((one) => one.right)),
      bottom: Math.max(...seen.slice(1).map((one) => one.bottom)),
      wide: document.documentElement.scrollWidth, stage: seen[0].height }, "*");
    </script></body>"""
    (tmp_path / "view.html").write_text(text.replace("</body>", measure), encoding="utf-8")
    frames = "".join(
        f'<iframe src="view.html#step=5" style="border:0;width:{w}px;height:{h}px"></iframe>'
        for w, h in SCREENS
    )
    listen = """<pre id="out"></pre><script>
    const found = [];
    addEventListener("message", ({ data }) => {
      found.push(data);
      document.getElementById("out").textContent = JSON.stringify(found);
    });
    </script>"""
    around = tmp_path / "around.html"
    around.write_text(f"<!doctype html><body>{listen}{frames}", encoding="utf-8")
    dom, log = browse(browser, tmp_path / "run", around.as_uri(), *SPATIAL, "--dump-dom")
    out = re.search(r'<pre id="out">(.*?)</pre>', dom)
    assert out, log
    found = json.loads(html.unescape(out[1]))
    assert {(one["width"], one["height"]) for one in found} == set(SCREENS)
    for one in found:
        assert one["bottom"] <= one["height"], one
        assert one["low"] >= 0, one
        assert max(one["right"], one["wide"]) <= one["width"], one
