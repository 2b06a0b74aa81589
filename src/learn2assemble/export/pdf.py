"""Instructions as PDF on A4 paper, made without a browser: the same as the step cards."""

from __future__ import annotations

import io
from functools import lru_cache
from typing import Any, cast

import numpy as np

from learn2assemble.assembly.blocks import Assembly
from learn2assemble.assembly.instructions.appearance import rgb
from learn2assemble.assembly.instructions.words import BILL_HEAD, CUT_HEAD, DOT, HEAD, reading_words
from learn2assemble.export.pictures import (
    Booklet,
    Card,
    Picture,
    Use,
    booklet,
    shape_words,
)
from learn2assemble.fonts import font_file

_WIDTH, _HEIGHT = 595.28, 841.89
"""A4 [pt]."""
_EDGE, _GAP = 36.0, 14.0
_COLUMN = (_WIDTH - 2 * _EDGE - _GAP) / 2
_PICTURE = 150.0
"""Largest height of the picture of a card, so that three cards fit below one another [pt]."""
_SHAPE = (140.0, 86.0)
"""Room for the picture of the largest shape, width and height [pt]."""
_TOTAL = "number-of-pages"
_LINE = 11.0
_FORM = 1000.0
"""Units of stored parts to a metre."""
_INK, _SOFT, _RULE, _OLD = (0.12, 0.14, 0.16), (0.35, 0.39, 0.43), (0.8, 0.78, 0.75), (0.92,) * 3
_MARK, _RIM = (0.04, 0.38, 0.72), (0.29, 0.27, 0.25)
_LINES = {"new": _MARK, "gone": (0.76, 0.18, 0.13), "held": (0.49, 0.31, 0.84)}
"""Colours of outlines."""
_TABS = (0.0, 40.0, 66.0, 102.0, 138.0, 174.0)
_BILL_TABS = (0.0, 38.0, 150.0, 200.0, 240.0, 350.0, 460.0)
_CUT_TABS = (0.0, 38.0, 90.0, 190.0, 280.0, 370.0)


def pdf(assembly: Assembly) -> bytes:
    """The instructions of an assembly as a PDF: a cover with the bill of blocks, then the steps in
    two columns; every page has its number."""
    from reportlab.pdfgen.canvas import Canvas

    book = booklet(assembly)
    out = io.BytesIO()
    # Without the time of day, equal instructions are equal files.
    canvas = Canvas(out, pagesize=(_WIDTH, _HEIGHT), pageCompression=1, invariant=1)
    canvas.setTitle(book.title)
    _Pages(canvas, book).all()
    return out.getvalue()


@lru_cache(maxsize=2)
def _own_font(bold: bool) -> tuple[str, frozenset[int]]:
    """The name of the font that is put into a PDF, and the letters that it has."""
    from reportlab.pdfbase.pdfmetrics import (
        registerFont,  # pyright: ignore[reportUnknownVariableType]
    )
    from reportlab.pdfbase.ttfonts import TTFont

    font = TTFont("DejaVuSans-Bold" if bold else "DejaVuSans", str(font_file(bold)))
    registerFont(font)
    return str(font.fontName), frozenset(font.face.charToGlyph)


def _written(text: str, bold: bool = False) -> tuple[str, str]:
    """A text and the font it is written in: one that every PDF has, where that has all letters of
    it; what ours has no letters for either is replaced."""
    try:
        text.encode("cp1252")
    except UnicodeEncodeError:
        font, letters = _own_font(bold)
        return "".join(one if ord(one) in letters else "?" for one in text), font
    return text, "Helvetica-Bold" if bold else "Helvetica"


def _scale(picture: Picture, width: float, height: float) -> float:
    """The scale at which a picture and all others of its scale fit into a box [pt/m]."""
    across, up = picture.within or picture.size.tolist()
    return min(width / across, height / up)


def _picture_height(picture: Picture) -> float:
    """What a picture takes on a card [pt]: no more than it needs at the scale of all cards."""
    return float(picture.size[1]) * _scale(picture, _COLUMN, _PICTURE)


class _Pages:
    """Fills pages from the top, column by column."""

    def __init__(self, canvas: Any, book: Booklet) -> None:
        self.canvas, self.book = canvas, book
        self.pages, self.column, self.y = 1, 0, _HEIGHT - _EDGE
        self.top = self.y
        """Where the columns of this page begin."""
        self.forms: set[str] = set()
        self.wanted: list[tuple[str, int, str | None, bool]] = []

    def all(self) -> None:
        self._cover()
        if self.pages == 1:
            self._next_page()
        else:
            self.top = self.y = self.y - 14
        heights = [self._height(card) for card in self.book.cards]
        for card, height in zip(self.book.cards, heights, strict=True):
            if self.y - height < _EDGE + 14:
                if self.column == 0:
                    self.column, self.y = 1, self.top
                else:
                    self._next_page()
            self._card(card)
            self.y -= height + 10
        self._finish_page()
        self.canvas.beginForm(_TOTAL, 0, -3, 40, 12)
        self._write(0, 0, str(self.pages), 8, _SOFT)
        self.canvas.endForm()
        self.canvas.save()

    def _next_page(self) -> None:
        self._finish_page()
        self.pages, self.column, self.y = self.pages + 1, 0, _HEIGHT - _EDGE
        self.top = self.y

    def _finish_page(self) -> None:
        end = _WIDTH / 2 + 60
        self._write(end, 22, f"{self.book.title[:60]} - page {self.pages} of ", 8, _SOFT, "right")
        self.canvas.saveState()
        self.canvas.translate(end, 22)
        self.canvas.doForm(_TOTAL)  # Made in the end, when it is known.
        self.canvas.restoreState()
        self.canvas.showPage()
        self._store()

    def _room(self, height: float) -> None:
        """Go on to the next page where less than ``height`` is left."""
        if self.y - height < _EDGE + 10:
            self._next_page()

    # ------------------------------------------------------------ text

    def _write(
        self,
        x: float,
        y: float,
        text: str,
        size: float = 8.5,
        colour: tuple[float, ...] = _INK,
        side: str = "left",
        bold: bool = False,
    ) -> None:
        text, font = _written(text, bold)
        self.canvas.setFont(font, size)
        self.canvas.setFillColorRGB(*colour)
        draw = {
            "left": self.canvas.drawString,
            "middle": self.canvas.drawCentredString,
            "right": self.canvas.drawRightString,
        }[side]
        draw(x, y, text)

    def _wrapped(self, text: str, width: float, size: float) -> list[str]:
        from reportlab.lib.utils import (
            simpleSplit,  # pyright: ignore[reportUnknownVariableType]
        )

        return cast("list[str]", simpleSplit(*_written(text), size, width))

    def _paragraph(self, text: str, size: float = 9.0) -> None:
        for line in self._wrapped(text, _WIDTH - 2 * _EDGE, size):
            self._room(size * 1.3)
            self.y -= size * 1.3
            self._write(_EDGE, self.y, line, size)

    def _heading(self, text: str) -> None:
        self._room(60)
        self.y -= 22
        self._write(_EDGE, self.y, text, 12, bold=True)
        self.y -= 3

    def _table(
        self, head: tuple[str, ...], rows: list[tuple[str, ...]], tabs: tuple[float, ...]
    ) -> None:
        for k, row in enumerate([head, *rows]):
            self._room(_LINE + 2)
            self.y -= _LINE + 2
            for cell, tab, end in zip(row, tabs, (*tabs[1:], 523.0), strict=True):
                fits = self._wrapped(cell, end - tab - 4, 8.5)
                self._write(_EDGE + tab, self.y, fits[0] if fits else "", 8.5, _INK if k else _SOFT)

    # ------------------------------------------------------------ cover

    def _cover(self) -> None:
        for line in self._wrapped(self.book.title, 360, 24)[:3]:
            self.y -= 26
            self._write(_EDGE, self.y, line, 24, bold=True)
        self.y -= 6
        for fact in self.book.facts:
            self._paragraph(fact, 10)
        self.y -= 6
        width, height = _WIDTH - 2 * _EDGE, 270.0
        scale = _scale(self.book.cover, width, height)
        self._picture(self.book.cover, _EDGE, self.y - height, width, height, scale)
        self.y -= height
        self._heading("Bill of blocks")
        self._table(BILL_HEAD, self.book.bill, _BILL_TABS)
        self.y -= 6
        self._shapes()
        for letter, words in self.book.corners:
            self._paragraph(f"Shape {letter}, corners: {words}", 7.5)
        if self.book.cuts:
            self._heading("Posts to cut")
            self._table(CUT_HEAD, self.book.cuts, _CUT_TABS)
        self._heading("How to read the steps")
        self._paragraph(reading_words(self.book.told, DOT))
        if self.book.start:
            self._heading("Stands from the start")
            self._table(HEAD, self.book.start, _TABS)

    def _shapes(self) -> None:
        """Pictures of the shapes side by side, standing on one line."""
        line: list[tuple[Picture, str, float, float, float]] = []
        room = _WIDTH - 2 * _EDGE

        def draw() -> None:
            tall = max((size for *_, size in line), default=0.0)
            self._room(tall + 18)
            x = _EDGE
            for picture, words, scale, width, height in line:
                self._picture(picture, x, self.y - tall - 2, width, height, scale)
                middle = x + width / 2
                self._write(middle, self.y - tall - 12, words, 9, side="middle", bold=True)
                x += width + 8
            self.y -= tall + 18 if line else 0
            line.clear()

        for shape, picture in self.book.shapes:
            scale, words = _scale(picture, *_SHAPE), shape_words(shape, picture)
            scale *= self.book.shape_room
            across, up = (scale * picture.size).tolist()
            width = max(across, 5.0 * len(words))
            if sum(other[3] + 8 for other in line) + width > room:
                draw()
            line.append((picture, words, scale, width, up))
        draw()

    # ------------------------------------------------------------ cards

    def _height(self, card: Card) -> float:
        lines = sum(len(self._wrapped(text, _COLUMN, 8.5)) for text in card.words)
        lines += len(card.wanted) + len(card.rows) + 1
        return 18 + lines * _LINE + _picture_height(card.picture) + 6

    def _card(self, card: Card) -> None:
        x, y = _EDGE + self.column * (_COLUMN + _GAP), self.y
        self.canvas.setStrokeColorRGB(*_RULE)
        self.canvas.setLineWidth(0.6)
        self.canvas.line(x, y, x + _COLUMN, y)
        y -= 15
        self._write(x, y, card.heading, 12, bold=True)
        self._write(x + _COLUMN, y, card.number, 8, _SOFT, "right")
        y -= 3
        for (shape, _), text in zip(card.group.wanted, card.wanted, strict=True):
            y -= _LINE
            self.canvas.setFillColorRGB(*(rgb(shape.colour) / 255).tolist())
            self.canvas.setStrokeColorRGB(*_RIM)
            self.canvas.rect(x, y - 1, 7, 7, stroke=1, fill=1)
            self._write(x + 11, y, text, 8.5, bold=True)
        for text in card.words:
            for line in self._wrapped(text, _COLUMN, 8.5):
                y -= _LINE
                self._write(x, y, line)
        height, scale = _picture_height(card.picture), _scale(card.picture, _COLUMN, _PICTURE)
        self._picture(card.picture, x, y - height - 2, _COLUMN, height, scale)
        y -= height + 2
        for k, row in enumerate([HEAD, *card.rows]):
            y -= _LINE
            for cell, tab in zip(row, _TABS, strict=True):
                self._write(x + tab, y, cell, 8 if len(row[-1]) < 24 else 7, _INK if k else _SOFT)

    # ------------------------------------------------------------ pictures

    def _picture(
        self, picture: Picture, x: float, y: float, width: float, height: float, scale: float
    ) -> None:
        """Draw a picture in the middle of a box [pt], at a scale [pt/m]."""
        size = picture.size
        shift = np.array([x + (width - scale * size[0]) / 2, y + (height - scale * size[1]) / 2])
        shift = shift - scale * picture.low
        canvas = self.canvas
        canvas.saveState()
        canvas.setLineJoin(1)
        self._lines(picture.grid.lines, scale, shift, _RULE, 0.4)
        for point, text, side in picture.grid.labels:
            px, py = point * scale + shift
            below = side == "below"
            at = (px, py - 7) if below else (px - 2, py - 2)
            self._write(*at, text, 5.5, _SOFT, "middle" if below else "right")
        canvas.saveState()
        canvas.transform(scale / _FORM, 0, 0, scale / _FORM, *shift)
        canvas.setLineWidth(0.4 * _FORM / scale)
        for use in picture.uses:
            if use.mark != "gone":
                self._form(use, use.colour)
        canvas.setLineWidth(0.8 * _FORM / scale)
        canvas.setDash(3 * _FORM / scale, 2 * _FORM / scale)
        for use in sorted(picture.outlines, key=lambda use: use.mark == "held"):
            if use.mark == "held":
                canvas.setDash()
            self._form(use, use.mark, outline=True)
        canvas.restoreState()
        for start, end in picture.arrows:
            self._arrow(start * scale + shift, end * scale + shift)
        for point in picture.dots:
            canvas.setFillColorRGB(*_MARK)
            canvas.circle(*(point * scale + shift), 1.8, stroke=0, fill=1)
        for point, text in picture.labels:
            px, py = point * scale + shift
            self._write(px, py + 2, text, 7, _MARK, "middle", bold=True)
        if picture.place is not None:
            self._map(picture.place, x, y + height)
        canvas.restoreState()

    def _form(self, use: Use, colour: str | None, outline: bool = False) -> None:
        """Draw a part of a block; equal ones of one colour are stored once."""
        name = f"f{use.name}-{colour}-{int(outline)}".replace("#", "")
        canvas = self.canvas
        if name not in self.forms:
            self.forms.add(name)
            self.wanted.append((name, use.name, colour, outline))
        canvas.saveState()
        canvas.translate(*(use.at * _FORM).round(1))
        canvas.doForm(name)
        canvas.restoreState()

    def _store(self) -> None:
        """The parts that the last page used for the first time."""
        canvas = self.canvas
        for name, number, colour, outline in self.wanted:
            figure = self.book.scene.figures[number]
            (x0, y0), (x1, y1) = figure.frame * _FORM
            pad = 0.1 * max(x1 - x0, y1 - y0)
            canvas.beginForm(name, x0 - pad, y0 - pad, x1 + pad, y1 + pad)
            paint = np.array(_OLD if colour is None else _OLD if outline else rgb(colour) / 255)
            for face, light in () if outline else figure.faces:
                path = canvas.beginPath()
                path.moveTo(*(face[0] * _FORM).round(2))
                for point in face[1:]:
                    path.lineTo(*(point * _FORM).round(2))
                path.close()
                canvas.setFillColorRGB(*(paint * light).round(3).tolist())
                canvas.drawPath(path, stroke=0, fill=1)
            line = _LINES[colour or ""] if outline else _RIM
            rims = () if outline else [np.vstack([rim, rim[:1]]) for rim in figure.rims]
            self._lines([*figure.edges, *rims], _FORM, np.zeros(2), line, None)
            canvas.endForm()
        self.wanted.clear()

    def _lines(
        self,
        lines: Any,
        scale: float,
        shift: np.ndarray,
        colour: tuple[float, ...],
        width: float | None,
    ) -> None:
        if not len(lines):
            return
        self.canvas.setStrokeColorRGB(*colour)
        if width is not None:
            self.canvas.setLineWidth(width)
        path = self.canvas.beginPath()
        for line in lines:
            start, *others = (line * scale + shift).round(2).tolist()
            path.moveTo(*start)
            for point in others:
                path.lineTo(*point)
        self.canvas.drawPath(path, stroke=1, fill=0)

    def _arrow(self, start: np.ndarray, end: np.ndarray) -> None:
        back = (start - end) / max(float(np.linalg.norm(start - end)), 1e-9) * 4
        across = np.array([-back[1], back[0]]) * 0.6
        lines = [
            np.array([start, end]),
            np.array([end + back + across, end]),
            np.array([end + back - across, end]),
        ]
        self._lines(lines, 1.0, np.zeros(2), _MARK, 1.1)

    def _map(self, place: tuple[float, float, float, float], x: float, top: float) -> None:
        """Where the step is in the whole, seen from above, in the corner of its picture."""
        size = self.book.told.extent
        w = 36.0
        h = min(w * float(size[1] / size[0]), 1.5 * w)
        self.canvas.setStrokeColorRGB(*_SOFT)
        self.canvas.setLineWidth(0.5)
        self.canvas.rect(x + 2, top - 2 - h, w, h, stroke=1, fill=0)
        self.canvas.setFillColorRGB(*_MARK)
        px, py, width, depth = place
        self.canvas.rect(
            x + 2 + px * w,
            top - 2 - h + py * h,
            max(width * w, 2),
            max(depth * h, 2),
            stroke=0,
            fill=1,
        )
