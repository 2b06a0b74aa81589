"""Drawings of all that is read of SVG, to be compared with what a browser shows.

``python tests/svg_drawings.py`` records what headless Chromium shows of them in
``tests/data/svg_shown.npz``: once when drawings are added or changed.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

SIZE = 240
"""Width and height of a drawing as it is shown [pixels]."""
SHOWN = Path(__file__).parent / "data" / "svg_shown.npz"
_ACROSS = 10
_DARK = 140
"""Lightest channel up to which a pixel is material; all shapes here are darker."""

_HEAD = 'width="240" height="240" viewBox="0 0 240 240"'
_STAR = "M120 10L185 210L15 85H225L55 210z"
_RING = "M20 20H220V220H20zM80 80V160H160V80z"
_GATE = "M20 20H220V220H160V100H80V220H20z"
_LEAF = "M20 220C20 60 120 20 220 20C220 140 160 220 20 220z"
_CLIP_CIRCLE = '<clipPath id="c"><circle cx="120" cy="120" r="90"/></clipPath>'
_ROOF = '<symbol id="s" viewBox="0 0 10 10"><path d="M0 10L5 0L10 10z"/></symbol>'


def _svg(body: str, head: str = _HEAD) -> str:
    names = 'xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink"'
    return f"<svg {names} {head}>{body}</svg>"


_PLAIN: dict[str, str] = {
    "star of winding": f'<path d="{_STAR}"/>',
    "star of even-odd": f'<path fill-rule="evenodd" d="{_STAR}"/>',
    "path left open": '<path d="M20 20H220V220" fill="black"/>',
    "polyline": '<polyline points="20,220 60,40 120 160 180,40 220,220"/>',
    "smooth curves": '<path d="M20 120C20 20 100 20 120 120S220 220 220 120V220H20z'
    'M40 60q20-60 40 0t40 0v20h-80z"/>',
    "arcs": '<path d="M20 120A100 60 30 0 1 220 120A40 90-20 10 20 120zM150 150a30 30 0 1020 0z"/>',
    "rect turned": '<rect x="70" y="60" width="100" height="120" transform="rotate(30 120 120)"/>',
    "rect round": '<rect x="20" y="40" width="200" height="160" rx="70" ry="30"/>'
    '<rect x="30" y="90" width="60" height="9" rx="50%"/>',
    "rect skewed": '<rect x="10" y="60" width="140" height="120" rx="40" transform="skewX(25)"/>',
    "ellipse in a matrix": '<ellipse cx="60" cy="50" rx="50" ry="30" '
    'transform="matrix(1.5 .6 -.4 1.8 40 20)"/>',
    "circle stretched": '<g transform="scale(2 1)"><circle cx="60" cy="120" r="50"/></g>',
    "polygon in groups": '<g transform="translate(120 120)"><g transform="rotate(-20)">'
    '<g transform="scale(1.2,.8) skewY(10)"><polygon points="-80,-80 80,-80 60,80 0,20 -60,80"/>'
    "</g></g></g>",
    "CSS transform": "<style>.a{transform:translate(20px,30px) rotate(0.2rad);"
    "transform-origin:50% 120px}</style>"
    '<rect class="a" x="60" y="60" width="120" height="90"/>',
    "transform of an attribute about": '<rect x="60" y="60" width="100" height="100" '
    'transform="rotate(45)" transform-origin="110 110"/>',
    "use of a path": f'<defs><path id="p" d="{_LEAF}" transform="scale(.5)"/></defs>'
    '<use href="#p"/><use xlink:href="#p" x="110" y="100"/>'
    '<use href="#p" transform="translate(230 10) scale(-1 1) rotate(10)"/>',
    "use of a group in a use": '<defs><g id="a"><rect width="40" height="70"/>'
    '<circle cx="60" cy="50" r="20"/></g><g id="b"><use href="#a"/><use href="#a" y="90" '
    'transform="rotate(-8)"/></g></defs><use href="#b" x="20" y="20"/>'
    '<use href="#b" x="120" y="30"/>',
    "use that inherits": '<defs><g id="a"><rect width="80" height="80"/>'
    '<rect x="90" width="80" height="80" fill="white"/></g></defs>'
    '<rect width="240" height="120"/><g fill="none"><use href="#a" x="30" y="140"/></g>'
    '<use href="#a" x="30" y="20" fill="navy"/>',
    "symbol with a view box": f'{_ROOF}<use href="#s" x="20" y="20" width="200" height="90"/>'
    '<use href="#s" x="60" y="120" width="100" height="100" transform="rotate(5 110 170)"/>',
    "symbol stretched": '<symbol id="s" viewBox="0 0 10 10" preserveAspectRatio="none">'
    '<path d="M0 10L5 0L10 10z"/><circle r="3"/></symbol>'
    '<use href="#s" x="20" y="60" width="200" height="120"/>',
    "symbol cut off": '<symbol id="s" viewBox="0 0 10 10" preserveAspectRatio="xMinYMax slice">'
    '<circle cx="5" cy="5" r="6"/></symbol><use href="#s" x="20" y="60" width="200" height="90"/>',
    "symbol that overflows": '<symbol id="s" viewBox="0 0 10 10" overflow="visible">'
    '<circle cx="5" cy="5" r="7"/></symbol><use href="#s" x="70" y="70" width="90" height="90"/>',
    "symbol of its own size": '<symbol id="s" viewBox="0 0 10 10" x="20" y="10" width="120" '
    'height="60%"><rect width="9" height="10"/></symbol><use href="#s" y="30"/>',
    "svg in svg": '<svg x="30" y="40" width="150" height="120" viewBox="0 0 30 30">'
    '<rect width="30" height="20"/><circle cx="30" cy="30" r="10"/></svg>',
    "svg in svg aligned": '<svg x="10" y="10" width="220" height="100" viewBox="0 0 10 10" '
    'preserveAspectRatio="xMaxYMid"><rect width="10" height="10" rx="3"/></svg>'
    '<svg y="50%" width="100%" height="50%" viewBox="-5 -5 10 10" preserveAspectRatio="xMinYMin">'
    '<circle r="5"/><svg x="2" width="100%" height="2"><rect width="9" height="9"/></svg></svg>',
    "svg without a view box": '<svg x="20%" y="20%" width="60%" height="60%" overflow="hidden">'
    '<circle cx="50%" cy="50%" r="45%"/></svg>',
    "clip circle": f'{_CLIP_CIRCLE}<path clip-path="url(#c)" d="{_GATE}"/>',
    "clip by even-odd": f'<clipPath id="c"><path clip-rule="evenodd" d="{_STAR}"/></clipPath>'
    '<rect width="240" height="240" clip-path="url(#c)"/>',
    "clip of the box": '<clipPath id="c" clipPathUnits="objectBoundingBox">'
    '<ellipse cx=".5" cy=".5" rx=".5" ry=".4"/></clipPath>'
    '<rect x="40" y="20" width="160" height="200" clip-path="url(#c)"/>',
    "clip of a turned group": f"{_CLIP_CIRCLE}"
    '<g clip-path="url(#c)" transform="translate(30 -10) rotate(15) scale(.9)">'
    '<rect width="120" height="240"/><rect x="150" y="90" width="120" height="240"/></g>',
    "clip in a clip": '<clipPath id="d"><rect width="240" height="120"/></clipPath>'
    '<clipPath id="c" clip-path="url(#d)"><circle cx="120" cy="120" r="90"/>'
    '<rect y="20" width="60" height="200" clip-path="url(#e)"/></clipPath>'
    '<clipPath id="e"><circle cy="60" r="50"/></clipPath>'
    '<rect width="240" height="240" clip-path="url(#c)"/>',
    "clip by a use": '<defs><circle id="k" r="60"/></defs><clipPath id="c" '
    'transform="translate(10)"><use href="#k" x="80" y="90"/><use href="#k" x="150" y="150"/>'
    '<g><rect width="240" height="240"/></g></clipPath>'
    '<rect width="240" height="240" clip-path="url(#c)"/>',
    "clip of a group's box": '<clipPath id="c" clipPathUnits="objectBoundingBox">'
    '<path d="M0 0H1L0 1z"/></clipPath><g clip-path="url(#c)"><rect x="30" y="30" width="60" '
    'height="160"/><circle cx="150" cy="150" r="60"/>'
    '<rect x="90" y="100" width="130" height="9" visibility="hidden"/></g>',
    "clip on a use": f'{_CLIP_CIRCLE}<defs><rect id="r" width="100" height="200"/></defs>'
    '<use href="#r" x="60" y="20" clip-path="url(#c)"/>',
    "clip that is missing": f'<path d="{_GATE}" clip-path="url(#none)"/>',
    "mask black and white": '<mask id="m"><rect width="240" height="240" fill="white"/>'
    '<circle cx="120" cy="150" r="60"/></mask><rect x="20" y="20" width="200" height="200" '
    'mask="url(#m)"/>',
    "mask of alpha": '<mask id="m" style="mask-type:alpha"><path d="M20 20H220L120 220z"/></mask>'
    '<rect width="240" height="240" mask="url(#m)"/>',
    "mask in its box": '<mask id="m" x="0" y="0" width=".5" height="1" '
    'maskContentUnits="objectBoundingBox"><circle cx=".5" cy=".5" r=".5" fill="#fff"/></mask>'
    '<g mask="url(#m)"><rect x="40" y="40" width="160" height="160"/></g>',
    "mask with a clip": f'{_CLIP_CIRCLE}<mask id="m" maskUnits="userSpaceOnUse" x="0" y="0" '
    'width="240" height="150"><g clip-path="url(#c)"><rect width="240" height="240" fill="white"/>'
    '<rect x="100" width="30" height="200" fill="black"/></g></mask>'
    '<rect width="240" height="240" mask="url(#m)" transform="rotate(8 120 120)"/>',
    "paper": '<rect width="100%" height="100%" fill="white"/><rect x="20" y="40" width="200" '
    'height="180"/><circle cx="120" cy="130" r="50" fill="#fff"/><rect x="100" y="110" width="40" '
    'height="40" fill="maroon"/>',
    "transparent": '<rect width="240" height="240" opacity="0"/><g opacity="0%">'
    '<rect width="240" height="100"/></g><rect width="240" height="200" fill-opacity="0"/>'
    '<rect width="240" height="200" fill="rgb(0 0 0 / 0)"/><rect width="120" height="90" '
    'fill="transparent"/><rect y="120" width="150" height="100"/>',
    "half transparent": '<rect width="240" height="120"/><g opacity=".5">'
    '<rect x="40" y="60" width="160" height="160" fill="navy"/>'
    '<circle cx="120" cy="140" r="50" fill="white"/></g>',
    "not displayed": '<g display="none"><rect width="240" height="240"/></g>'
    '<g visibility="hidden"><rect width="240" height="90"/><circle cx="120" cy="150" r="60" '
    'visibility="visible"/></g><rect style="display:none" width="240" height="240"/>',
    "style sheets": "<style><![CDATA[/* { */ .a, #b {fill:white} rect.a{fill:black}"
    "#b{fill:none!important} * {fill:white} g > circle{fill:navy} g circle.z{fill:white}"
    "@media print{rect{fill:none}} @media screen{polygon{fill:green}}]]></style>"
    '<rect class="a" width="100" height="100"/><rect id="b" width="200" height="240" '
    'style="fill:red"/><g><circle cx="180" cy="60" r="50"/><circle class="z" cx="180" cy="60" '
    'r="20"/></g><polygon points="20,220 120,120 220,220"/><ellipse rx="50" ry="50"/>',
    "style of a copy": '<style>.w rect{fill:white} .x{fill:black}</style><g class="w">'
    '<rect width="90" height="90"/><rect id="r" y="120" width="90" height="90"/></g>'
    '<use href="#r" x="110"/><rect class="x" x="120" width="90" height="90"/>',
    "geometry by CSS": "<style>rect{x:30px;width:50%;height:120px;rx:20px} circle{r:40px}</style>"
    '<rect y="20" width="10"/><circle cx="180" cy="180" r="9"/>',
    "current colour": '<g color="white"><rect width="240" height="240" fill="currentColor"/>'
    '<g color="black" fill="currentColor"><circle cx="120" cy="120" r="80"/>'
    '<circle color="white" cx="120" cy="120" r="30"/></g></g>',
    "percentages": '<rect x="10%" y="20%" width="50%" height="60%"/>'
    '<circle cx="75%" cy="50%" r="20%"/><ellipse cx="30%" cy="90%" rx="20%" ry="8%"/>',
    "units": '<rect x="5mm" y="0.5cm" width="1in" height="72pt"/>'
    '<g font-size="20"><rect x="6em" y="10pc" width="80px" height="1.5em"/></g>',
    "switch and a": '<switch><rect systemLanguage="de" width="240" height="240"/>'
    '<g systemLanguage="fr,en"><rect x="20" y="20" width="90" height="200"/></g>'
    '<rect width="240" height="120"/></switch><a href="#x"><circle cx="170" cy="120" r="50"/></a>'
    '<g requiredExtensions="http://x"><rect width="240" height="9"/></g>',
    "gradients": '<linearGradient id="g"><stop stop-color="#400"/><stop offset="1" '
    'stop-color="#004"/></linearGradient><linearGradient id="w" xlink:href="#v"/>'
    '<linearGradient id="v"><stop stop-color="white"/></linearGradient>'
    '<rect x="20" y="20" width="200" height="200" fill="url(#g)"/>'
    '<circle cx="120" cy="120" r="50" fill="url(#w)"/>'
    '<rect width="240" height="60" fill="url(#none)"/>'
    '<rect y="200" width="240" height="40" fill="url(#none) black"/>',
    "unused definitions": '<defs><clipPath id="c"/><filter id="f"/><rect width="240" '
    'height="240"/></defs><symbol><rect width="240" height="240"/></symbol>'
    '<title>x</title><metadata><rect width="240" height="240"/></metadata>'
    '<x:rect xmlns:x="urn:x" width="240" height="240"/><path d="M20 220L120 20L220 220"/>',
}
_HEADS: dict[str, tuple[str, str]] = {
    "page fitted": (
        'width="240" height="240" viewBox="0 0 20 10"',
        '<circle cx="10" cy="5" r="8"/>',
    ),
    "page cut off": (
        'width="240" height="240" viewBox="-10 -10 20 10" preserveAspectRatio="xMaxYMin slice"',
        '<circle r="9"/>',
    ),
    "page stretched": (
        'width="240" height="240" viewBox="0 0 20 10" preserveAspectRatio="none"',
        '<circle cx="10" cy="5" r="4"/><rect width="40%" height="20%"/>',
    ),
}


class _Mixed:
    """Random drawings in which all of this is nested."""

    def __init__(self, seed: int) -> None:
        self.random = np.random.default_rng(seed)
        self.defs: list[str] = []

    def number(self, low: float, high: float) -> str:
        return f"{self.random.uniform(low, high):.3g}"

    def turn(self) -> str:
        kind = self.random.integers(5)
        return (
            f"rotate({self.number(-60, 60)} 120 120)",
            f"translate({self.number(-30, 30)},{self.number(-30, 30)})",
            f"translate(120 120) scale({self.number(0.6, 1.2)} {self.number(-1.2, -0.6)}) "
            "translate(-120 -120)",
            f"skewX({self.number(-20, 20)})",
            f"matrix(1 {self.number(-0.3, 0.3)} {self.number(-0.3, 0.3)} 1 9 -9)",
        )[kind]

    def shape(self, attributes: str) -> str:
        x, y, r = (self.number(*span) for span in ((40, 120), (40, 120), (40, 80)))
        return (
            f'<rect x="{x}" y="{y}" width="{r}" height="{self.number(40, 110)}" {attributes}/>',
            f'<rect x="{x}" y="{y}" width="35%" height="40%" rx="15" {attributes}/>',
            f'<circle cx="50%" cy="{y}" r="{r}" {attributes}/>',
            f'<ellipse cx="{x}" cy="{y}" rx="{r}" ry="40" {attributes}/>',
            f'<path d="{_STAR}" {attributes}/>',
            f'<path d="{_RING}" {attributes}/>',
            f'<path d="{_LEAF}" {attributes}/>',
            f'<polygon points="{x},{y} 220,60 180,{self.number(120, 230)} 60 200" {attributes}/>',
        )[self.random.integers(8)]

    def define(self, kind: str) -> str:
        name = f"d{len(self.defs)}"
        turn = f'transform="{self.turn()}"' if self.random.random() < 0.5 else ""
        if kind == "mask":
            body = (
                f'<rect x="-240" y="-240" width="720" height="720" fill="white"/>{self.shape("")}'
            )
        elif kind == "clipPath":
            # Of a shape with a hole and another one Chromium 156 shows what only one of them
            # covers; by the specification a clip path is what any of its shapes covers.
            rule = self.random.random() < 0.4
            body = self.shape(('clip-rule="evenodd" ' if rule else "") + turn)
            body += "" if rule or _RING in body else self.shape("").replace(_RING, _LEAF)
        else:
            body = self.shape(turn) + self.shape('fill="white"') + self.shape("")
        more = ' viewBox="0 0 240 240"' if kind == "symbol" else ""
        self.defs.append(f'<{kind} id="{name}"{more}>{body}</{kind}>')
        return name

    def group(self, depth: int) -> str:
        inside = "".join(
            self.group(depth - 1) if depth and self.random.random() < 0.6 else self.leaf()
            for _ in range(2)
        )
        kind = self.random.integers(6)
        if kind == 0:
            return f'<g clip-path="url(#{self.define("clipPath")})">{inside}</g>'
        if kind == 1:
            return f'<g mask="url(#{self.define("mask")})" {self.place()}>{inside}</g>'
        if kind == 2:
            return (
                f'<svg x="10" y="5%" width="90%" height="{self.number(150, 230)}" '
                f'viewBox="0 0 240 240">{inside}</svg>'
            )
        return f"<g {self.place()}>{inside}</g>"

    def place(self) -> str:
        return f'transform="{self.turn()}"'

    def leaf(self) -> str:
        kind = self.random.integers(6)
        if kind == 0:
            size = f'width="{self.number(120, 240)}" height="{self.number(120, 240)}"'
            return f'<use href="#{self.define("symbol")}" x="9" {size} {self.place()}/>'
        if kind == 1:
            return f'<use href="#{self.define("g")}" {self.place()}/>'
        if kind == 2:
            return self.shape('style="fill:white"')
        if kind == 3:
            return self.shape(f'opacity=".8" {self.place()}')
        return self.shape(f'fill-rule="evenodd" {self.place()}')

    def drawing(self) -> str:
        body = self.shape("") + self.group(3) + self.shape("") + self.group(2)
        return _svg(f"<defs>{''.join(self.defs)}</defs>{body}")


DRAWINGS: dict[str, str] = {
    **{name: _svg(body) for name, body in _PLAIN.items()},
    **{name: _svg(body, head) for name, (head, body) in _HEADS.items()},
    **{f"mixture {seed}": _Mixed(seed).drawing() for seed in range(24)},
}


def shown_by(browser: str, folder: Path) -> dict[str, np.ndarray]:
    """What a browser shows of every drawing as material, ``bool[SIZE, SIZE]``, from above."""
    from headless import FLAT, browse, read_picture

    rows = -(-len(DRAWINGS) // _ACROSS)
    places = [divmod(k, _ACROSS) for k in range(len(DRAWINGS))]
    images = []
    for k, ((row, column), text) in enumerate(zip(places, DRAWINGS.values(), strict=True)):
        (folder / f"{k}.svg").write_text(text, encoding="utf-8")
        images.append(
            f'<img src="{k}.svg" style="position:absolute;left:{column * SIZE}px;'
            f'top:{row * SIZE}px;width:{SIZE}px;height:{SIZE}px">'
        )
    page = folder / "drawings.html"
    page.write_text(f'<!doctype html><body style="margin:0">{"".join(images)}', encoding="utf-8")
    shot = folder / "shot.png"
    _, log = browse(
        browser,
        folder / "run",
        page.as_uri(),
        *FLAT,
        f"--screenshot={shot}",
        f"--window-size={_ACROSS * SIZE},{rows * SIZE}",
    )
    assert shot.is_file(), log
    image = np.rint(255 * read_picture(shot)[..., :3]).min(-1)
    return {
        name: image[row * SIZE : (row + 1) * SIZE, column * SIZE : (column + 1) * SIZE] <= _DARK
        for name, (row, column) in zip(DRAWINGS, places, strict=True)
    }


def recorded() -> dict[str, np.ndarray]:
    """What Chromium showed of every drawing when it was recorded."""
    with np.load(SHOWN) as file:
        bits = {name: np.unpackbits(file[name], count=SIZE * SIZE) for name in file.files}
    return {name: flat.reshape(SIZE, SIZE).astype(bool) for name, flat in bits.items()}


if __name__ == "__main__":
    from headless import find_browser

    with tempfile.TemporaryDirectory() as made:
        seen = shown_by(find_browser(), Path(made))
    packed: dict[str, Any] = {name: np.packbits(mask) for name, mask in seen.items()}
    np.savez_compressed(SHOWN, **packed)
