"""Builds again what page, cards and PDF say, from the printed numbers alone.

``python tests/read_back.py`` prints how far the corners of the blocks are off at most.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from functools import cache
from html import unescape
from pathlib import Path

import numpy as np

import learn2assemble as l2a
from learn2assemble.assembly.blocks import Assembly, AssemblyStep, Block
from learn2assemble.assembly.instructions.shapes import corners_at
from learn2assemble.assembly.instructions.steps import instructions
from learn2assemble.design.cells import CellDesign
from learn2assemble.export.cards import step_cards
from learn2assemble.export.pdf import pdf
from learn2assemble.planning.tiling.construct import plan_cells
from learn2assemble.viewer.page import render_assembly_page

DESIGNS = Path(__file__).resolve().parents[1] / "examples" / "designs"
KITS = DESIGNS.parent / "kits"
ALLOWED = 0.5e-3
"""[m]"""
_NUMBER = r"(-?\d+(?:\.\d+)?)"
_ROW = re.compile(
    rf"(?<=\|)(\d+(?:, \d+)*)\|(?:(?:place|remove|hold|release)\|)?([A-Z]+)\|{_NUMBER}\|{_NUMBER}\|"
    rf"{_NUMBER}\|"
    r"((?:[xyz] -?[\d.]+° ?)+|0)(?=\|)"
)
_SHAPE = re.compile(
    r"(?<=\|)([A-Z]+)\|[^|]+\|[^|]+\|[–\d]+\|[\d. ×]+\|([\d.]+) × ([\d.]+) × ([\d.]+)\|"
)
_CORNERS = re.compile(r"Shape ([A-Z]+) ?, corners(?: \[mm\])?: ((?:\d+ \([^)]*\)[; ]*)+)")


def arch(count: int = 9, inner: float = 0.2, outer: float = 0.27) -> Assembly:
    """A round arch of wedges, turned out of the axes."""
    ends = np.linspace(np.pi, 0, count + 1)
    quarter = np.array([[np.cos(0.4), -np.sin(0.4), 0], [np.sin(0.4), np.cos(0.4), 0], [0, 0, 1]])
    faces = ((3, 2, 1, 0), (4, 5, 6, 7), (1, 5, 4, 0), (2, 6, 5, 1), (3, 7, 6, 2), (0, 4, 7, 3))
    blocks = []
    for k in range(count):
        a, b = ends[k : k + 2]
        polar = ((inner, a), (outer, a), (outer, b), (inner, b))
        flat = [(r * np.cos(t), r * np.sin(t)) for r, t in polar]
        points = np.array([(x, y, z) for y in (0.0, 0.1) for x, z in flat]) @ quarter.T
        blocks.append(Block(f"v{k}", points, faces))
    steps = tuple(AssemblyStep(block.id) for block in blocks)
    return Assembly(tuple(blocks), steps, name="Arch")


def built(name: str, kit: str | None = None) -> Assembly:
    """The blocks and steps of an example."""
    plan = l2a.build(DESIGNS / name, kit=kit)
    assert plan.complete, plan.reason
    assert plan.assembly is not None
    return plan.assembly


def house() -> Assembly:
    """A house of sixty bricks in three colours, whose wide door takes props to bridge."""
    wanted = np.zeros((14, 7, 6), bool)
    wanted[:, [0, -1], :] = True
    wanted[[0, -1], :, :] = True
    wanted[5:10, 0, :3] = False
    colours = np.full((*wanted.shape, 3), (200, 120, 60), np.uint8)
    colours[:, :, 0], colours[:, :, -1] = (90, 90, 100), (120, 40, 30)
    design = CellDesign("house", wanted, (0.05, 0.05, 0.05), colours, source="test")
    plan = plan_cells(design, "bricks")
    assert plan.complete, plan.reason
    assert plan.assembly is not None
    return plan.assembly


STRUCTURES: dict[str, Callable[[], Assembly]] = {
    "gate": cache(lambda: built("gate.svg")),
    "Soma cube": cache(lambda: built("soma_cube.npy", str(KITS / "soma.toml"))),
    "house": cache(house),
    "arch": cache(arch),
}


def visible_text(page: str) -> str:
    """What a reader sees of an HTML document, cells of tables parted by bars."""
    hidden = "<style>.*?</style>|<script.*?</script>|<defs>.*?</defs>|<svg.*?</svg>"
    page = re.sub(hidden, "", page, flags=re.DOTALL)
    return "|" + unescape(re.sub(r"(\s*<[^>]+>\s*)+", "|", page))


def cards_text(assembly: Assembly) -> str:
    """Of the step cards."""
    return visible_text(step_cards(assembly))


def page_text(assembly: Assembly) -> str:
    """Of the page."""
    return visible_text(render_assembly_page(assembly, title="x"))


def pdf_text(assembly: Assembly) -> str:
    """Of the PDF."""
    import pypdf

    lines: list[str] = []
    for page in pypdf.PdfReader(io.BytesIO(pdf(assembly))).pages:
        page.extract_text(visitor_text=lambda text, *_: lines.append(text.strip()))
    return "|" + "|".join(line for line in lines if line)


PRINTED: dict[str, Callable[[Assembly], str]] = {
    "page": page_text,
    "cards": cards_text,
    "PDF": pdf_text,
}


def read_back(text: str) -> dict[int, np.ndarray]:
    """Corners of the block of every step [m from O], from the printed numbers alone."""
    text = re.sub(r"\|[^|]* - page \d+ of\|\d+(?=\|)", "", text)
    shapes: dict[str, np.ndarray] = {}
    for letter, *size in _SHAPE.findall(text):
        ends = np.stack(np.meshgrid(*[(0, float(v)) for v in size], indexing="ij"), -1)
        shapes[letter] = ends.reshape(-1, 3) / 1000
    for letter, words in _CORNERS.findall(text.replace("|", " ")):
        points = re.findall(r"\(([^)]*)\)", words)
        shapes[letter] = np.array([[float(v) for v in p.split(",")] for p in points]) / 1000
    found = {}
    for numbers, letter, *at, words in _ROW.findall(text):
        angles = dict(re.findall(r"([xyz]) (-?[\d.]+)°", words))
        x, y, z = (float(angles.get(axis, 0)) for axis in "xyz")
        a, b, c = (float(v) / 1000 for v in at)
        corners = corners_at(shapes[letter], (a, b, c), (x, y, z))
        found |= dict.fromkeys(map(int, numbers.split(", ")), corners)
    return found


def largest_error(assembly: Assembly, text: str) -> float:
    """How far a corner of what was read back is off at most [m].

    Raises:
        AssertionError: where a step is missing, or one is there that is none.
    """
    told = read_back(text)
    assert sorted(told) == list(range(1, len(assembly.steps) + 1))
    origin, worst = instructions(assembly).origin, 0.0
    for number, step in enumerate(assembly.steps, 1):
        block = assembly.block(step.block)
        apart = told[number][:, None] - (block.vertices - origin)[None]
        distance = np.linalg.norm(apart, axis=-1)
        worst = max(worst, float(distance.min(0).max()), float(distance.min(1).max()))
    return worst


def main() -> None:
    """Print the largest error of every structure and document."""
    print(f"largest error of a corner [mm], allowed {1000 * ALLOWED:g}")
    for name, make in STRUCTURES.items():
        assembly = make()
        errors = [largest_error(assembly, printed(assembly)) for printed in PRINTED.values()]
        words = "  ".join(
            f"{document} {1000 * error:.3f}"
            for document, error in zip(PRINTED, errors, strict=True)
        )
        print(f"{name:9}  {len(assembly.steps):2} steps  {words}")


if __name__ == "__main__":
    main()
