"""SVG is read as a browser draws it: the same pixels, the same cells; what is not read is said."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageDraw

from headless import find_browser
from learn2assemble.design.lattice import HALF, shares
from learn2assemble.design.svg.walk import read_svg
from learn2assemble.errors import InputError
from svg_drawings import DRAWINGS, SIZE, recorded, shown_by

CELLS = 16
"""Cells across a drawing, of an odd number of pixels each: no cell is half full by chance."""
VIEWS = {
    "page fitted": (12.0, 0.0, -5.0),
    "page cut off": (24.0, 0.0, -10.0),
    "page stretched": (24.0, 0.0, 0.0),
}
"""Pixels of a unit, and the unit at the left and upper edge, where these are not 1, 0 and 0."""


def contours(name: str) -> list[np.ndarray]:
    """What is read of a drawing in pixels, y down."""
    scale, x, y = VIEWS.get(name, (1.0, 0.0, 0.0))
    drawing = read_svg(DRAWINGS[name].encode(), name)
    assert drawing.not_read is None
    assert list(drawing.sides) == ["front"]
    return [(c * (1, -1) - (x, y)) * scale for c in drawing.sides["front"]]


def as_pixels(outlines: list[np.ndarray], fine: int = 4) -> np.ndarray:
    """Outlines and holes as ``bool[SIZE, SIZE]``: pixels of which half is inside."""
    whole = np.zeros((SIZE * fine,) * 2, bool)
    for outline in outlines:
        image = Image.new("1", (SIZE * fine, SIZE * fine))
        # A pixel belongs to a polygon of this library where its centre is inside.
        ImageDraw.Draw(image).polygon([tuple(p) for p in (outline * fine - 0.5).tolist()], fill=1)
        whole ^= np.asarray(image)
    return whole.reshape(SIZE, fine, SIZE, fine).mean((1, 3)) >= 0.5


def as_cells(outlines: list[np.ndarray]) -> np.ndarray:
    """The cells of which half is inside, ``bool[CELLS, CELLS]``, by the package's own volumes."""
    walls = []
    for outline in outlines:
        a = outline * (CELLS / SIZE) * (1, -1) + (0, CELLS)
        b = np.roll(a, -1, axis=0)
        low, high = (np.insert(a, 1, y, axis=1) for y in (0.0, 1.0))
        low_, high_ = (np.insert(b, 1, y, axis=1) for y in (0.0, 1.0))
        walls += [np.stack([low, low_, high_], 1), np.stack([low, high_, high], 1)]
    share = shares(np.concatenate(walls), (CELLS, 1, CELLS))[:, 0]
    return (np.abs(share) >= HALF).T[::-1]


def common(one: np.ndarray, other: np.ndarray) -> float:
    """Intersection over union."""
    return float((one & other).sum() / max((one | other).sum(), 1))


def compare(shown: dict[str, np.ndarray]) -> dict[str, tuple[float, float]]:
    """Intersection over union of pixels and of cells, by drawing."""
    made = {}
    for name, pixels in shown.items():
        outlines = contours(name)
        block = SIZE // CELLS
        cells = pixels.reshape(CELLS, block, CELLS, block).mean((1, 3)) >= HALF
        made[name] = common(as_pixels(outlines), pixels), common(as_cells(outlines), cells)
    return made


def test_drawings_are_read_as_recorded_of_a_browser() -> None:
    """Every pixel and cell of 78 drawings, nested in every way, as Chromium showed them."""
    shown = recorded()
    assert list(shown) == list(DRAWINGS)
    assert all(0.02 < pixels.mean() < 0.98 for pixels in shown.values())
    low = {name: both for name, both in compare(shown).items() if min(both) < 0.98}
    assert not low


def test_a_style_sheet_of_any_text_is_read_once() -> None:
    """Sheets without braces, quotes without ends, comments without ends: all is read past."""
    for text in (
        "a b, " * 9_000,
        "'\"" * 9_000,
        "/*" * 9_000,
        '\\"' * 9_000,
        "a{" * 9 + "}" * 9_000,
    ):
        style = f"<style><![CDATA[{text}]]></style>"
        drawn = read_svg(_page(f'{style}<rect width="9" height="9"/>'), "a.svg")
        assert np.ptp(drawn.sides["front"][0], axis=0) == pytest.approx((9, 9))


def _page(body: str, head: str = 'width="60mm" height="50mm" viewBox="0 0 60 50"') -> bytes:
    return f'<svg xmlns="http://www.w3.org/2000/svg" {head}>{body}</svg>'.encode()


GATE = '<path d="M0 0H60V50H40V20H20V50H0z"/>'


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ("<text>a</text><text>  </text><text fill='none'>b</text>", "1 text: convert"),
        ("<text>a</text><line x2='9' stroke='red'/>" * 2, "2 strokes, 2 texts: convert"),
        ("<rect width='9' height='9' stroke='red'/>", "1 stroke: convert"),
        ("<rect width='9' height='9' fill='none' stroke='red' stroke-width='0'/>", None),
        ("<rect width='9' height='9' fill='none' stroke='red' visibility='hidden'/>", None),
        ("<g opacity='0'><text>a</text></g>", None),
        ("<image width='9' height='9'/><foreignObject/>", "1 foreign object, 1 image"),
        ("<filter id='f'/><rect width='9' height='9' filter='url(#f)'/>", "1 filter"),
        ("<style>rect{filter:blur(2px)}</style><rect width='9' height='9'/>", "1 filter"),
        ("<g filter='url(#f)'><rect width='9' height='9' fill='none'/></g>", None),
        (
            "<style>@import 'x'; a ~ b{fill:red} a:hover{fill:red}</style>",
            "1 imported style sheet, 1 style rule",
        ),
        ("<pattern id='p'/><rect width='9' height='9' fill='url(#p)'/>", "1 pattern"),
        (
            "<linearGradient id='p'><stop/><stop stop-opacity='0'/></linearGradient>"
            "<rect width='9' height='9' fill='url(#p)'/>",
            "1 gradient",
        ),
        ("<rect width='9' height='9' style='fill:var(--a)'/>", "1 CSS variable"),
        ("<rect width='9' height='9' fill='oklch(0 0 0)'/>", "1 colour"),
        ("<path d='M0 0h9v9z L x'/>", "1 path with an error"),
        ("<rect width='9' height='9' transform='scale(a)'/>", "1 transform with an error"),
        (
            "<rect width='9' height='9' style='transform:translate(50%,0)'/>" * 2,
            "2 transforms with a percentage",
        ),
        ("<use href='other.svg#a'/>", "1 reference to another file"),
        ("<rect width='9' height='9'><animate attributeName='x'/></rect>", "1 animation"),
        ("<g><animate attributeName='x'/></g>", "1 animation"),
        ("<rect x='90' width='9' height='9'/>", "outside the page: 1 shape"),
    ],
)
def test_what_is_not_read_is_named(body: str, said: str | None) -> None:
    """Of a gate beside it nothing is missing."""
    drawn = read_svg(_page(GATE + body), "a.svg")
    assert said in drawn.not_read if said and drawn.not_read else drawn.not_read is said
    assert np.ptp(np.concatenate(drawn.sides["front"]), axis=0) == pytest.approx((60, 50))


def test_what_is_not_read_is_in_the_report(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    """On the terminal, in --json, in the plan and on the page, and where one only looks first."""
    from learn2assemble.cli import main

    path = tmp_path / "gate.svg"
    path.write_bytes(_page(GATE + "<text>gate</text>", 'width="60cm" viewBox="0 0 60 50"'))
    said = "not read: 1 text: convert them to paths"
    for asked in (("--out", "out"), ("--preview", "look.png")):
        assert main(["build", str(path), asked[0], str(tmp_path / asked[1]), "--json"]) == 0
        shown = capsys.readouterr()
        assert f"warning: {path}: {said}" in " ".join(shown.err.split())
        assert json.loads(shown.out.splitlines()[-1])["not_read"] == said
    for name in ("plan.json", "view.html"):
        assert said in (tmp_path / "out" / name).read_text(encoding="utf-8")
    path.write_bytes(_page("<text>gate</text>"))
    assert main(["build", str(path), "--out", str(tmp_path / "none")]) == 2
    assert "1 text" in capsys.readouterr().err


def test_closed_lines_are_material_only_where_nothing_is_filled() -> None:
    line = '<rect x="2" y="2" width="40" height="40" fill="none" stroke="black"/>'
    drawn = read_svg(_page(line), "a.svg")
    assert drawn.not_read is None
    assert np.ptp(drawn.sides["front"][0], axis=0) == pytest.approx((40, 40))
    both = read_svg(_page(f'{line}<rect x="9" y="9" width="9" height="9"/>'), "a.svg")
    assert np.ptp(both.sides["front"][0], axis=0) == pytest.approx((9, 9))
    assert both.not_read == "not read: 1 stroke: convert them to paths"


@pytest.mark.parametrize(
    ("origin", "about"),
    [
        ("", (0, 0)),
        ("center", (30, 25)),
        ("Left", (0, 25)),
        ("right", (60, 25)),
        ("top", (30, 0)),
        ("bottom", (30, 50)),
        ("12px", (12, 25)),
        ("top right", (60, 0)),
        ("right top", (60, 0)),
        ("bottom left", (0, 50)),
        ("center left", (0, 25)),
        ("bottom center", (30, 50)),
        ("center bottom", (30, 50)),
        ("center 10px", (30, 10)),
        ("10px bottom 0", (10, 50)),
        # No property of CSS: browsers drop them.
        ("top 10px", (0, 0)),
        ("10px left", (0, 0)),
        ("left right", (0, 0)),
        ("middle", (0, 0)),
    ],
)
def test_a_transform_is_about_what_css_says(origin: str, about: tuple[float, float]) -> None:
    turn = f"transform:scale(0.5);transform-origin:{origin}"
    drawn = read_svg(_page(f'<rect width="20" height="10" style="{turn}"/>'), "a.svg")
    low, high = (getattr(drawn.sides["front"][0], name)(0) for name in ("min", "max"))
    x, y = np.array(about) / 2
    assert (low[0], high[0], -high[1], -low[1]) == pytest.approx((x, x + 10, y, y + 5))


def test_a_calculated_origin_is_refused() -> None:
    turn = "transform:scale(0.5);transform-origin:calc(9px)"
    with pytest.raises(InputError, match="a length"):
        read_svg(_page(f'<rect width="20" height="10" style="{turn}"/>'), "a.svg")


@pytest.mark.parametrize("names", [("empty", "grid"), ("base", "background"), ("wall", "leaf")])
def test_groups_of_any_name_are_one_drawing(names: tuple[str, str]) -> None:
    one, other = names
    body = (
        f'<g id="{one}"><rect width="60" height="20"/></g><rect y="20" width="20" height="30"/>'
        f'<g id="{other}"><rect x="5" y="5" width="9" height="9" fill="white"/></g>'
    )
    drawn = read_svg(_page(body), "a.svg")
    assert list(drawn.sides) == ["front"]
    assert len(drawn.sides["front"]) == 2  # with the hole that the later group paints


def test_a_white_page_beside_sides_is_no_side() -> None:
    body = '<rect width="60" height="50" fill="white"/>' + "".join(
        f'<g id="{side}"><rect width="60" height="20"/></g>' for side in ("front", "left")
    )
    assert list(read_svg(_page(body), "a.svg").sides) == ["front", "left"]


@pytest.mark.browser
def test_the_browser_still_shows_what_was_recorded(tmp_path: Path) -> None:
    shown, before = shown_by(find_browser(), tmp_path), recorded()
    assert {name: common(shown[name], before[name]) > 0.995 for name in DRAWINGS} == dict.fromkeys(
        DRAWINGS, True
    )
    assert not {name: both for name, both in compare(shown).items() if min(both) < 0.98}
