"""Elements of an SVG drawing: their style, transform, outline and paint, wherever they stand."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from collections import Counter
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

import numpy as np

from learn2assemble.design.drawings import MAX_DEPTH, MAX_ENTITIES, MAX_VERTICES
from learn2assemble.design.svg import paths
from learn2assemble.design.svg import style as styles
from learn2assemble.design.svg.parts import PaintedPart
from learn2assemble.design.svg.paths import Curve, LengthContext, Matrix
from learn2assemble.design.svg.style import Sheets, Style, local
from learn2assemble.errors import InputError

MAX_SVG = 1_500_000
"""Most characters of an SVG drawing."""
MAX_VISITED = 3 * MAX_ENTITIES
"""Most elements that are visited, those of copies, clip paths and masks each time."""
HREF = "{http://www.w3.org/1999/xlink}href"
IDENTITY = np.eye(3)
TOLD = 3
"""So many paths with an error are told by name."""
Drawn = tuple[list[PaintedPart], np.ndarray | None]
"""Parts of an element, and its box in the user units of what it stands in, ``float64[2, 2]``."""


@dataclass(frozen=True)
class Context:
    """Where an element stands: what it takes from what is around it."""

    matrix: Matrix
    """From its user units to those of the drawing."""
    style: Style
    frame: LengthContext
    around: tuple[ElementTree.Element, ...]
    layer: str | None = None
    depth: int = 0
    local: Matrix = field(default_factory=lambda: np.eye(3))
    """From its user units to those of what it stands in."""

    def moved(self, matrix: Matrix) -> Context:
        """The same with user units of its own."""
        return replace(self, matrix=self.matrix @ matrix, local=self.local @ matrix)


class Elements:
    """The elements of a drawing, and what was not read of them.

    Args:
        root: its tree.
        source: the file, as messages call it.
    """

    visited: int
    points: int
    letters: int

    def __init__(self, root: ElementTree.Element, source: str) -> None:
        self.root = root
        self.source = source
        self.named: dict[str, ElementTree.Element] = {}
        self.parents: dict[ElementTree.Element, ElementTree.Element] = {}
        for element in root.iter():
            self.named.setdefault(element.get("id", ""), element)
            self.parents.update(dict.fromkeys(element, element))
        self.sheets: Sheets = Sheets.of(root, source)
        self.not_read: Counter[str] = Counter(self.sheets.not_read)
        self.visited = self.points = self.letters = 0
        self.open: set[ElementTree.Element] = set()
        self.boxed: bool = any(local(element) in ("clipPath", "mask") for element in root.iter())
        self.read: dict[str, tuple[list[Curve], int | None]] = {}
        """Path data that was read."""
        self.told: set[tuple[int, int]] = set()
        """Paths with an error that are told by name, and where that is."""
        self.turns: dict[str, Matrix | None] = {}
        """Transforms that were read."""
        self.places: dict[ElementTree.Element, Context] = {}
        """Places of what is drawn by reference."""
        self.gradients: dict[ElementTree.Element, tuple[tuple[int, int, int], float] | None] = {}
        """Colours of gradients; None for one that is not read."""

    def style(
        self,
        element: ElementTree.Element,
        parent: Style,
        around: tuple[ElementTree.Element, ...],
        frame: LengthContext,
    ) -> Style:
        """The style of an element; the size of its letters is a number."""
        declared = self.sheets.declared(element, around, self.source)
        style = styles.inherited(parent, declared)
        size, unit = paths.pair(style.get("font-size", "16")) or (16.0, "")
        units = {**paths.PIXELS, "em": frame.font, "rem": 16.0, "%": frame.font / 100}
        style["font-size"] = repr(size * units.get(unit, 1.0))
        return style

    def computed(self, element: ElementTree.Element) -> Context:
        """The place of what is in an element that is only drawn by reference."""
        if element in self.places:
            return self.places[element]
        chain = [element]
        while chain[-1] in self.parents:
            chain.append(self.parents[chain[-1]])
            self.check_depth(len(chain))
        style, around, frame = {}, (), LengthContext(None, None)
        for each in reversed(chain):
            style = self.style(each, style, around, frame)
            around, frame = (*around, each), replace(frame, font=float(style["font-size"]))
        self.places[element] = Context(IDENTITY, style, frame, around)
        return self.places[element]

    def check_depth(self, depth: int) -> None:
        if depth > MAX_DEPTH:
            expected = f"at most {MAX_DEPTH} levels"
            raise InputError(self.source, "groups nested too deeply", expected)

    def visit(self, element: ElementTree.Element | None = None, points: int = 0) -> None:
        """Count what is visited."""
        if element is not None:
            self.visited += 1
            self.letters += sum(map(len, element.attrib.values())) + len(element.text or "")
        self.points += points
        most = self.visited > MAX_VISITED or self.letters > 2 * MAX_SVG
        if most or self.points > MAX_VERTICES:
            got = "a drawing of too many elements or points, references expanded"
            raise InputError(self.source, got, f"at most {MAX_VISITED} and {MAX_VERTICES}")

    @contextmanager
    def following(self, target: ElementTree.Element) -> Generator[None, None, None]:
        """Go to what a reference names, but in no circle."""
        if target in self.open:
            expected = "references without a circle"
            raise InputError(self.source, "a reference to itself", expected)
        self.check_depth(len(self.open))
        self.open.add(target)
        yield
        self.open.discard(target)

    def target(self, name: str) -> ElementTree.Element | None:
        """The element that ``#name`` means."""
        return self.named.get(name[1:]) if name[:1] == "#" and len(name) > 1 else None

    def transform(self, style: Style, frame: LengthContext) -> Matrix:
        """The transform of an element; browsers ignore a wrong one."""
        given = style.get("transform", "none")
        if given not in self.turns:
            self.turns[given] = paths.transform(given)
        made = self.turns[given]
        if made is None:
            share = re.search(r"translate[xy]?\([^()]*%", given, re.IGNORECASE)
            self.not_read[f"transform with {'a percentage' if share else 'an error'}"] += 1
            return IDENTITY
        origin = _origin(style.get("transform-origin", ""))
        if origin is None or given == "none":
            return made
        x, y = (
            paths.length(word, along, frame, self.source)
            for word, along in zip(origin, "xy", strict=True)
        )
        return paths.shift(x, y) @ made @ paths.shift(-x, -y)

    def length(self, place: Context, name: str, default: str) -> float:
        """A property that is a length."""
        along = {"x": "x", "cx": "x", "width": "x", "rx": "x", "r": ""}.get(name, "y")
        given = place.style.get(name, default)
        given = default if given == "auto" else given
        return paths.length(given, along, place.frame, self.source)

    def shape(self, tag: str, element: ElementTree.Element, place: Context) -> Drawn:
        """What a shape paints."""
        curves, box = self.outline(tag, element, place)
        if not curves:
            return [], None
        style = place.style
        shown = style.get("visibility", "visible") == "visible"
        colour, alpha, stroked = (0, 0, 0), 0.0, False
        if shown:
            if tag != "line":
                colour, alpha = self.paint("fill", style)
            width = paths.length(style.get("stroke-width", "1"), "", place.frame, self.source)
            stroked = width > 0 and self.paint("stroke", style)[1] > 0
            marks = [
                styles.reference(style.get(f"marker-{k}", "")) for k in ("start", "mid", "end")
            ]
            if tag not in ("rect", "circle", "ellipse"):
                self.not_read["marker"] += any(m and self.target(m[0]) is not None for m in marks)
        even_odd = style.get("fill-rule") == "evenodd"
        return [PaintedPart(curves, even_odd, colour, alpha, stroked, place.layer)], box

    def outline(
        self, tag: str, element: ElementTree.Element, place: Context
    ) -> tuple[tuple[Curve, ...], np.ndarray | None]:
        """The curves of a shape in coordinates of the drawing, and its box in its user units."""
        sound, where = True, ""
        if tag == "path":
            data = place.style.get("d", element.get("d", ""))
            if data.startswith("path("):
                data = data[5:].strip(" \"')")
            if data not in self.read:
                self.read[data] = paths.path(data, MAX_VERTICES)
            curves, wrong = self.read[data]
            sound = wrong is None
            where = "" if wrong is None else self._where(element, data.strip(), wrong)
        elif tag in ("polyline", "polygon"):
            points = paths.numbers(element.get("points", ""))
            sound = points is not None
            curves = paths.polygon(points or [])
            curves = [replace(curve, closed=tag == "polygon") for curve in curves]
        elif tag == "line":
            ends = [
                paths.length(element.get(name, "0"), name[0], place.frame, self.source)
                for name in ("x1", "y1", "x2", "y2")
            ]
            curves = [replace(curve, closed=False) for curve in paths.polygon(ends)]
        else:
            curves = self._basic(tag, place)
        self.not_read[f"{tag} with an error{where}"] += not sound
        self.visit(points=sum(len(curve.points) for curve in curves))
        box = paths.box_of(curves) if self.boxed else None
        return tuple(curve.moved(place.matrix) for curve in curves), box

    def _where(self, element: ElementTree.Element, data: str, wrong: int) -> str:
        """Which path has an error, and where, of the first few: its id or how it begins."""
        if len(self.told) >= TOLD and (id(element), wrong) not in self.told:
            return ""
        self.told.add((id(element), wrong))
        wrong += len(data[wrong:]) - len(data[wrong:].lstrip())
        name = element.get("id")
        which = f"d={data[:12]!r}..." if name is None else f"id={name!r}"
        return f" ({which}, letter {wrong + 1}: {data[wrong : wrong + 8]!r})"

    def _basic(self, tag: str, place: Context) -> list[Curve]:
        """Rectangles and ellipses; a corner radius that is not said is that of the other axis."""
        if tag == "circle":
            rx = ry = self.length(place, "r", "0")
        else:
            given = [name for name in ("rx", "ry") if place.style.get(name, "auto") != "auto"]
            radii = {name: self.length(place, name, "0") for name in given}
            radii = {name: radius for name, radius in radii.items() if radius >= 0}
            rx = radii.get("rx", radii.get("ry", 0.0))
            ry = radii.get("ry", rx)
        if tag == "rect":
            x, y, wide, high = (self.length(place, n, "0") for n in ("x", "y", "width", "height"))
            return paths.rectangle(x, y, wide, high, rx, ry) if wide > 0 and high > 0 else []
        cx, cy = (self.length(place, name, "0") for name in ("cx", "cy"))
        return paths.ellipse(cx, cy, rx, ry) if rx > 0 and ry > 0 else []

    def paint(self, name: str, style: Style) -> tuple[tuple[int, int, int], float]:
        """Colour and opacity of a fill or stroke; opacity 0 where there is none."""
        value = style.get(name, "black" if name == "fill" else "none")
        alpha = styles.share(style.get(f"{name}-opacity", "1"))
        if alpha and (named := styles.reference(value)):
            target = self.target(named[0])
            if target is not None and "Gradient" in local(target):
                found = self._gradient(target)
                return found[0], found[1] * alpha
            if target is not None and local(target) == "pattern":
                self.not_read["pattern"] += name == "fill"
                return (0, 0, 0), float(name == "stroke")
            value = named[1] or "none"
        if value.lower() == "currentcolor":
            value = style.get("color", "black")
        *mixed, own = styles.colour(value) or (0, 0, 0, 0.0)
        return (int(mixed[0]), int(mixed[1]), int(mixed[2])), own * alpha

    def _gradient(self, target: ElementTree.Element) -> tuple[tuple[int, int, int], float]:
        """Mean colour of a gradient that is seen, or not, all over; others are not read."""
        if target not in self.gradients:
            self.gradients[target] = self._mean(target)
        found = self.gradients[target]
        self.not_read["gradient"] += found is None
        return ((0, 0, 0), 0.0) if found is None else found

    def _mean(self, target: ElementTree.Element) -> tuple[tuple[int, int, int], float] | None:
        stops: list[ElementTree.Element] = []
        for _ in range(10):  # Gradients may take their stops from others.
            stops = [child for child in target if local(child) == "stop"]
            other = self.target(target.get("href") or target.get(HREF) or "")
            if stops or other is None:
                break
            target = other
        kinds, mixed = set[tuple[bool, bool]](), list[tuple[float, ...]]()
        for stop in stops:
            self.visit(stop)
            style = self.computed(stop).style
            value = style.get("stop-color", "black")
            value = style.get("color", "black") if value.lower() == "currentcolor" else value
            r, g, b, alpha = styles.colour(value) or (0, 0, 0, 1.0)
            part = PaintedPart(
                (), False, (r, g, b), alpha * styles.share(style.get("stop-opacity", "1"))
            )
            kinds.add((part.paper, part.inked))
            mixed.append((*part.colour, part.alpha))
        if len(kinds) != 1:
            return None if kinds else ((0, 0, 0), 0.0)
        r, g, b, alpha = np.mean(mixed, axis=0).tolist()
        return (round(r), round(g), round(b)), alpha


def _origin(text: str) -> tuple[str, str] | None:
    """Lengths of ``transform-origin`` along x and y; None where browsers drop it.

    One word has ``center`` beside it, and two words may stand in any order.
    """
    both = {"center": "50%"}
    across, down = both | {"left": "0", "right": "100%"}, both | {"top": "0", "bottom": "100%"}
    x, y = [*re.split(r"[\s,]+", text.strip().lower()), "center"][:2]
    if x in down and y in across:
        x, y = y, x
    x, y = across.get(x, x), down.get(y, y)
    wrong = paths.pair(x) is None or paths.pair(y) is None
    return None if wrong and "(" not in text else (x, y)  # What is calculated is refused.
