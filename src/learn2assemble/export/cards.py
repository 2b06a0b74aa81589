"""Step cards: instructions as an HTML document, to print or to read on a screen."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from string import Template

import numpy as np

from learn2assemble.assembly.blocks import Assembly
from learn2assemble.assembly.instructions.appearance import rgb
from learn2assemble.assembly.instructions.words import BILL_HEAD, CUT_HEAD, DOT, HEAD, reading_words
from learn2assemble.export import asset
from learn2assemble.export.pictures import (
    Booklet,
    Card,
    Grid,
    Picture,
    booklet,
    shape_words,
)

_DONE = {"remove": "take a block away", "hold": "hold a block", "release": "let go of a block"}
"""What is done in steps that take no block from the heap."""
_LINES = {"new": "n", "gone": "x", "held": "h"}
"""Classes of outlines."""
_SHAPE = (14.0, 9.0)
"""Room for the picture of the largest shape, width and height [rem]."""
_SHAPE_FONT = 0.62
"""Size of the numbers of corners [rem]."""
_UNITS = 40
"""Of the drawing, to a usual block."""


def step_cards(assembly: Assembly) -> str:
    """A stand-alone HTML document: a cover with the bill of blocks, and cards that tell the steps.

    What the cards say is :func:`~.steps.instructions`; equal figures
    are stored once.
    """
    book = booklet(assembly)
    pen = _CardPen(book)
    shapes = "".join(
        f"<figure>{pen.shape(picture)}"
        f"<figcaption>{shape_words(shape, picture)}</figcaption></figure>"
        for shape, picture in book.shapes
    )
    cards = "".join(_card(pen, card) for card in book.cards)
    cover = pen.draw(book.cover)
    start = _table(HEAD, book.start) if book.start else ""
    cuts = _table(CUT_HEAD, book.cuts, "bill") if book.cuts else ""
    return Template(asset("cards.html")).substitute(
        title=escape(book.title),
        style=pen.style(),
        symbols=pen.symbols(),
        cover=cover,
        facts="".join(f"<li>{escape(fact)}</li>" for fact in book.facts),
        read=escape(reading_words(book.told, DOT)),
        bill=_table(BILL_HEAD, book.bill, "bill"),
        shapes=shapes,
        cuts=cuts and f"<h2>Posts to cut</h2><div class='wide'>{cuts}</div>",
        corners="".join(
            f"<p class='corners'><b>Shape {letter}</b>, corners: {words}</p>"
            for letter, words in book.corners
        ),
        start=start and f"<h2>Stands from the start</h2>{start}",
        cards=cards,
    )


def _card(pen: _CardPen, card: Card) -> str:
    words = "".join(f"<p>{escape(text)}</p>" for text in card.words)
    wanted = "".join(
        f'<li><i class="{pen.paint(shape.colour)}"></i>{escape(text)}</li>'
        for (shape, _), text in zip(card.group.wanted, card.wanted, strict=True)
    )
    part = f"<ul>{wanted}</ul>" if wanted else ""
    label = f"{card.heading}: {', '.join(card.wanted) or _DONE[card.group.main.action]}"
    head = f"<h3>{card.heading} <small>{card.number}</small></h3>"
    _, tallest = card.picture.within or card.picture.size.tolist()
    share = float(card.picture.size[1]) / tallest
    picture = pen.draw(card.picture, label, f"--h:{share:.3f}" if share < 0.999 else "")
    return f"<article>{head}{part}{words}{picture}{_table(HEAD, card.rows)}</article>"


def _table(head: tuple[str, ...], rows: Sequence[tuple[str, ...]], name: str = "") -> str:
    top = "".join(f"<th>{escape(word)}" for word in head)
    body = "".join("<tr>" + "".join(f"<td>{escape(cell)}" for cell in row) for row in rows)
    return f"<table{name and f' class={name}'}><tr>{top}{body}</table>"


class _CardPen:
    """Draws pictures, and remembers what they share."""

    def __init__(self, book: Booklet) -> None:
        self.book = book
        self.unit = _UNITS / book.scene.usual
        self.colours: dict[str, str] = {}
        self.figures: set[int] = set()
        self.grids: dict[int, str] = {}
        self.grid_text: list[str] = []

    def paint(self, colour: str) -> str:
        return self.colours.setdefault(colour, f"k{len(self.colours)}")

    def at(self, point: np.ndarray) -> str:
        return f"{_short(point[0] * self.unit)} {_short(-point[1] * self.unit)}"

    def path(self, points: np.ndarray, close: bool = True) -> str:
        whole = np.round(points * (self.unit, -self.unit), 1)
        steps = np.round(np.diff(whole, axis=0), 1)
        text = f"M{_short(whole[0, 0])} {_short(whole[0, 1])}l"
        text += " ".join(f"{_short(x)} {_short(y)}" for x, y in steps)
        return text.replace(" -", "-") + "z" * close

    def shape(self, picture: Picture) -> str:
        """The picture of a shape, as large as its scale asks for."""
        wide, tall = picture.within or picture.size.tolist()
        scale = self.book.shape_room * min(_SHAPE[0] / wide, _SHAPE[1] / tall)
        font = _SHAPE_FONT / scale * self.unit
        return self.draw(picture, "", f"width:{scale * picture.size[0]:.2f}rem", font)

    def draw(self, picture: Picture, label: str = "", style: str = "", font: float = 0.0) -> str:
        """A picture.

        Args:
            picture: what is drawn.
            label: what it is, for those who do not see it.
            style: CSS of its own.
            font: size of letters in units of the drawing; what suits its size where it is 0.
        """
        x0, y0 = picture.low[0] * self.unit, -picture.high[1] * self.unit
        width, height = picture.size * self.unit
        font = font or max(picture.within or picture.size) * self.unit * 0.034
        parts = [self._grid(picture.grid, font)]
        for use in picture.uses:
            self.figures.add(use.name)
            name = "g" if use.mark == "gone" else self.paint(use.colour) if use.colour else ""
            name = name and f" class={name}"
            parts.append(
                f"<use{name} href=#f{use.name} x={_short(use.at[0] * self.unit)}"
                f" y={_short(-use.at[1] * self.unit)} />"
            )
        for use in picture.outlines:
            parts.append(
                f"<use class={_LINES[use.mark]} href=#e{use.name}"
                f" x={_short(use.at[0] * self.unit)}"
                f" y={_short(-use.at[1] * self.unit)} />"
            )
        for start, end in picture.arrows:
            parts.append(f'<path class=a d="{self._arrow(start, end, font)}"/>')
        for point in picture.dots:
            x, y = point * (self.unit, -self.unit)
            parts.append(
                f'<circle class=o cx="{_short(x)}" cy="{_short(y)}" r="{_short(0.28 * font)}"/>'
            )
        for point, text in picture.labels:
            x, y = point * (self.unit, -self.unit)
            parts.append(f'<text x="{_short(x)}" y="{_short(y - 0.2 * font)}">{text}</text>')
        if picture.place is not None:
            parts.append(self._map(picture.place, x0, y0, 0.16 * float(width)))
        words = f' role="img" aria-label="{escape(label)}"' if label else ""
        words += f' style="{style}"' if style else ""
        return (
            f'<svg viewBox="{x0:.0f} {y0:.0f} {width:.0f} {height:.0f}" font-size="{font:.0f}"'
            f"{words}>{''.join(parts)}</svg>"
        )

    def _arrow(self, start: np.ndarray, end: np.ndarray, font: float) -> str:
        a, b = start * (self.unit, -self.unit), end * (self.unit, -self.unit)
        back = (a - b) / max(float(np.linalg.norm(a - b)), 1e-9) * 0.6 * font
        across = np.array([-back[1], back[0]]) * 0.6
        p, q = b + back + across, b + back - across
        return (
            f"M{_short(a[0])} {_short(a[1])}L{_short(b[0])} {_short(b[1])}"
            f"M{_short(p[0])} {_short(p[1])}L{_short(b[0])} {_short(b[1])}"
            f"L{_short(q[0])} {_short(q[1])}"
        )

    def _map(self, place: tuple[float, float, float, float], x0: float, y0: float, w: float) -> str:
        x, y, width, depth = place
        size = self.book.told.extent
        h = min(w * float(size[1] / size[0]), 1.5 * w)
        return (
            f'<g class=m><path d="M{x0 + 4:.0f} {y0 + 4:.0f}h{w:.0f}v{h:.0f}h{-w:.0f}z"/>'
            f'<rect x="{x0 + 4 + x * w:.1f}" y="{y0 + 4 + (1 - y - depth) * h:.1f}" '
            f'width="{max(width * w, 3):.1f}" height="{max(depth * h, 3):.1f}"/></g>'
        )

    def _grid(self, grid: Grid, font: float) -> str:
        if not grid.lines:
            return ""
        if id(grid) not in self.grids:
            self.grids[id(grid)] = f"r{len(self.grids)}"
            lines = "".join(self.path(line, close=False) for line in grid.lines)
            words = ""
            for point, text, side in grid.labels:
                x, y = point * (self.unit, -self.unit)
                x, y = (x, y + 1.1 * font) if side == "below" else (x - 0.3 * font, y + 0.3 * font)
                name = "" if side == "below" else " class=e"
                words += f'<text{name} x="{x:.0f}" y="{y:.0f}">{text}</text>'
            self.grid_text.append(
                f'<g id="{self.grids[id(grid)]}" class=r><path d="{lines}"/>{words}</g>'
            )
        return f'<use href="#{self.grids[id(grid)]}"/>'

    def symbols(self) -> str:
        """What the drawings share."""
        found = list[str]()
        for number in sorted(self.figures):
            figure = self.book.scene.figures[number]
            faces = "".join(
                f'<path d="{self.path(face)}"/><path class=s opacity="{1 - light:.2f}" '
                f'd="{self.path(face)}"/>'
                for face, light in figure.faces
            )
            edges = "".join(self.path(edge, close=False) for edge in figure.edges)
            found.append(f'<path id="e{number}" d="{edges}"/>')
            rims = "".join(self.path(rim) for rim in figure.rims)
            rims = rims and f'<path class=l d="{rims}"/>'
            found.append(f'<g id="f{number}">{faces}{rims}<use class=l href="#e{number}"/></g>')
        return "".join([*found, *self.grid_text])

    def style(self) -> str:
        """The colours of kinds."""
        return "".join(
            f".{name}{{fill:{colour};background:{colour}}}"
            for colour, name in (
                ("#{:02x}{:02x}{:02x}".format(*rgb(given).astype(int)), name)
                for given, name in self.colours.items()
            )
        )


def _short(value: float) -> str:
    text = f"{value:.1f}"
    text = text.removesuffix(".0")
    return "0" if text == "-0" else text
