"""Instructions to build by: who has only the printed numbers builds the same structure."""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from html import unescape
from pathlib import Path

import numpy as np
import pytest

import learn2assemble as l2a
from learn2assemble.assembly.blocks import Assembly, Block, Step, box_block
from learn2assemble.design.cells import CellDesign
from learn2assemble.export.cards import step_cards
from learn2assemble.assembly.instructions import MOST_TOGETHER, corners_at, instructions
from learn2assemble.export.pdf import pdf
from learn2assemble.export.projection import Scene
from learn2assemble.planning.construct import plan_cells

DESIGNS = Path(__file__).resolve().parents[1] / "examples" / "designs"
KITS = DESIGNS.parent / "kits"
_NUMBER = r"(-?\d+(?:\.\d+)?)"
_ROW = re.compile(
    rf"(?<=\|)(\d+)\|([A-Z]+)\|{_NUMBER}\|{_NUMBER}\|{_NUMBER}\|((?:[xyz] -?[\d.]+° ?)+|0)(?=\|)"
)
_SHAPE = re.compile(
    r"(?<=\|)([A-Z]+)\|[^|]+\|[^|]+\|[–\d]+\|[\d. ×]+\|([\d.]+) × ([\d.]+) × ([\d.]+)\|"
)


def arch(count: int = 9, inner: float = 0.2, outer: float = 0.27) -> Assembly:
    """A round arch of wedges, turned out of the axes, its feet fixed."""
    ends = np.linspace(np.pi, 0, count + 1)
    quarter = np.array([[np.cos(0.4), -np.sin(0.4), 0], [np.sin(0.4), np.cos(0.4), 0], [0, 0, 1]])
    faces = ((3, 2, 1, 0), (4, 5, 6, 7), (1, 5, 4, 0), (2, 6, 5, 1), (3, 7, 6, 2), (0, 4, 7, 3))
    blocks = []
    for k in range(count):
        a, b = ends[k : k + 2]
        flat = [(r * np.cos(t), r * np.sin(t)) for r, t in
                ((inner, a), (outer, a), (outer, b), (inner, b))]  # fmt: skip
        points = np.array([(x, y, z) for y in (0.0, 0.1) for x, z in flat]) @ quarter.T
        blocks.append(Block(f"v{k}", points, faces))
    steps = tuple(Step(block.id) for block in blocks)
    return Assembly(tuple(blocks), steps, name="Arch")


def built(name: str, kit: str | None = None) -> Assembly:
    plan = l2a.build(DESIGNS / name, kit=kit)
    assert plan.complete, plan.reason
    assert plan.assembly is not None
    return plan.assembly


def house() -> Assembly:
    """A house of about sixty bricks with a door under a lintel."""
    wanted = np.zeros((8, 6, 6), bool)
    wanted[:, [0, -1], :] = True
    wanted[[0, -1], :, :] = True
    wanted[3:5, 0, :3] = False
    given = CellDesign("house", wanted, (0.05, 0.05, 0.05), None, 0.0, None, "test", None)
    plan = plan_cells(given, "bricks-lintels")
    assert plan.complete, plan.reason
    assert plan.assembly is not None
    return plan.assembly


def html_text(assembly: Assembly) -> str:
    """What a reader sees, cells of tables parted by bars."""
    page = re.sub("<style>.*?</style>|<defs>.*?</defs>|<svg.*?</svg>", "", step_cards(assembly))
    return "|" + unescape(re.sub(r"(<[^>]+>)+", "|", page))


def pdf_text(assembly: Assembly) -> str:
    pypdf = pytest.importorskip("pypdf")
    pages = pypdf.PdfReader(io.BytesIO(pdf(assembly))).pages
    lines: list[str] = []
    for page in pages:
        page.extract_text(visitor_text=lambda text, *_: lines.append(text.strip()))
    return "|" + "|".join(line for line in lines if line)


def read_back(text: str) -> dict[int, np.ndarray]:
    """Corners of the block of every step [m from O], from the printed numbers alone."""
    text = re.sub(r"\|[^|]* - page \d+ of\|\d+(?=\|)", "", text)
    shapes: dict[str, np.ndarray] = {}
    for letter, *size in _SHAPE.findall(text):
        ends = np.stack(np.meshgrid(*[(0, float(v)) for v in size], indexing="ij"), -1)
        shapes[letter] = ends.reshape(-1, 3) / 1000
    joined = text.replace("|", " ")
    for letter, _, words in re.findall(
        r"Shape ([A-Z]+) ?(, corners:) ((?:\d+ \([^)]*\)[; ]*)+)", joined
    ):
        points = re.findall(r"\(([^)]*)\)", words)
        shapes[letter] = np.array([[float(v) for v in p.split(",")] for p in points]) / 1000
    found = {}
    for number, letter, *at, words in _ROW.findall(text):
        angles = dict(re.findall(r"([xyz]) (-?[\d.]+)°", words))
        x, y, z = (float(angles.get(axis, 0)) for axis in "xyz")
        a, b, c = (float(v) / 1000 for v in at)
        found[int(number)] = corners_at(shapes[letter], (a, b, c), (x, y, z))
    return found


@pytest.mark.parametrize("printed", [html_text, pdf_text])
@pytest.mark.parametrize("make", [
    lambda: built("gate.svg"), lambda: built("soma_cube.npy", str(KITS / "soma.toml")), house, arch,
], ids=["gate", "soma", "house", "arch"])  # fmt: skip
def test_the_printed_numbers_are_enough(
    make: Callable[[], Assembly], printed: Callable[[Assembly], str]
) -> None:
    assembly = make()
    told = read_back(printed(assembly))
    origin = instructions(assembly).origin
    assert sorted(told) == list(range(1, len(assembly.steps) + 1))
    worst = 0.0
    for number, step in enumerate(assembly.steps, 1):
        block = assembly.block(step.place or step.remove or "")
        apart = told[number][:, None] - (block.vertices - origin)[None]
        distance = np.linalg.norm(apart, axis=-1)
        worst = max(worst, float(distance.min(0).max()), float(distance.min(1).max()))
    assert worst <= 0.5e-3


def wide(count: int) -> Assembly:
    blocks = [box_block(f"b{k}", (0.1 * k, 0, 0), (0.1 * k + 0.05, 0.05, 0.05))
              for k in range(count)]  # fmt: skip
    return Assembly(tuple(blocks), tuple(Step(b.id) for b in blocks))


def test_blocks_where_nothing_is_at_stake_are_one_step() -> None:
    groups = instructions(wide(MOST_TOGETHER + 2)).groups
    assert [len(group.placements) for group in groups] == [MOST_TOGETHER, 2]


def test_what_hangs_over_and_props_are_steps_of_their_own() -> None:
    posts = wide(2).blocks
    lintels = [box_block(f"l{k}", (0, 0.025 * k, 0.05), (0.15, 0.025 * k + 0.025, 0.1))
               for k in range(2)]  # fmt: skip
    prop = box_block("p", (0.05, 0, 0), (0.1, 0.05, 0.05), prop=True)
    ids = ["b0", "p", "b1", "l0", "l1"]
    steps = (*map(Step, ids), Step(remove="p"))
    groups = instructions(Assembly((*posts, prop, *lintels), steps)).groups
    assert [len(group.placements) for group in groups] == [1] * 6
    text = html_text(Assembly((*posts, prop, *lintels), steps))
    assert "it stands only for a while until step 6" in text
    assert "Take the prop away" in text


def test_near_blocks_are_drawn_over_far_ones() -> None:
    blocks = (
        box_block("front", (0, 0, 0), (1, 1, 1)), box_block("back", (0, 1, 0), (1, 2, 1)),
        box_block("top", (0, 0, 1), (1, 2, 2)), box_block("right", (1, 0, 0), (2, 1, 1)),
    )  # fmt: skip
    scene = Scene(instructions(Assembly(blocks)))
    order = [blocks[drawn.block].id for drawn in scene.drawn]
    assert order.index("back") < order.index("front") < order.index("top")
    assert order.index("right") < order.index("front")


def test_pages_have_numbers_and_none_is_empty() -> None:
    pypdf = pytest.importorskip("pypdf")
    made = pdf(wide(40))
    pages = pypdf.PdfReader(io.BytesIO(made)).pages
    assert len(pages) > 2
    for number, page in enumerate(pages, 1):
        text = page.extract_text()
        assert f"page {number}" in text
        assert len(text) > 60
    assert made == pdf(wide(40)), "equal instructions are equal files"


def test_many_steps_stay_small() -> None:
    """Blocks of a bond that hangs over, so that every block is a step of its own."""
    post = box_block("post", (0, 0, 0), (0.03, 0.05, 0.05))
    rows = [
        box_block(f"b{k}", (0.1 * x + 0.05 * (z % 2), 0, 0.05 * (z + 1)),
                  (0.1 * x + 0.05 * (z % 2) + 0.1, 0.05, 0.05 * (z + 2)))
        for k, (z, x) in enumerate((z, x) for z in range(20) for x in range(30))
    ]  # fmt: skip
    blocks = (post, *rows)
    made = Assembly(blocks, tuple(Step(b.id) for b in blocks))
    assert len(instructions(made).groups) == 601
    for size in (len(step_cards(made)), len(pdf(made))):
        assert size / 601 < 4e6 / 2400
