"""SVG drawings as regions, as a browser draws them.

One walk over the tree follows transforms, references, viewports, styles, clip paths and masks, and
leaves parts in the order of painting. What is not read is counted, so that nothing visible is
left out without a word. The walk is bounded: it counts what it visits, not what the file promises.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

import numpy as np

from learn2assemble.design.drawings import (
    MAX_DEPTH,
    MAX_ENTITIES,
    MAX_VERTICES,
    SIDES,
    Drawing,
)
from learn2assemble.design.svg import paths
from learn2assemble.design.svg import style as styles
from learn2assemble.design.svg.parts import OPAQUE, Page, PaintedPart, counted, paint
from learn2assemble.design.svg.paths import Curve, LengthContext, Matrix
from learn2assemble.design.svg.style import Sheets, Style, local
from learn2assemble.errors import InputError, trusted

MAX_SVG = 1_500_000
"""Most characters of an SVG drawing."""
MAX_VISITED = 3 * MAX_ENTITIES
"""Most elements that are visited, those of copies, clip paths and masks each time."""
MAX_ENTITY_NAMES = 100
"""Most XML entities that a file may define."""
MAX_FADED = 100
"""Most white areas one after another in a half transparent group."""
_CLEAR = 0.02
"""Opacity or brightness up to which there is nothing."""
_ENTITY = re.compile(rb"""<!ENTITY\s+([\w.:-]+)\s+(?:"([^"]*)"|'([^']*)')\s*>""")
_INKSCAPE = "{http://www.inkscape.org/namespaces/inkscape}"
_HREF = "{http://www.w3.org/1999/xlink}href"
_AUTOMATIC = re.compile(r"(g|group|path|svg|layer|layer_|layer )[\W_\d]*$", re.IGNORECASE)
_SHAPES = frozenset(("path", "rect", "circle", "ellipse", "line", "polyline", "polygon"))
_GROUPS = frozenset(("g", "a", "switch", "svg", "symbol", "use"))
_NOT_READ = {
    "text": "text",
    "image": "image",
    "foreignObject": "foreign object",
    "video": "video",
    "canvas": "canvas",
    "iframe": "frame",
    "animate": "animation",
    "set": "animation",
    "animateTransform": "animation",
    "animateMotion": "animation",
}
"""Elements that show something and are not read, in words."""
_MARKED = ("start", "mid", "end")
_IDENTITY = np.eye(3)


_Drawn = tuple[list[PaintedPart], np.ndarray | None]
"""Parts of an element, and its box in the user units of what it stands in, ``float64[2, 2]``."""


@dataclass(frozen=True)
class _Context:
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

    def moved(self, matrix: Matrix) -> _Context:
        """The same with user units of its own."""
        return replace(self, matrix=self.matrix @ matrix, local=self.local @ matrix)


def read_svg(content: bytes, source: str) -> Drawing:
    """What an SVG drawing shows as regions.

    Args:
        source: the file, as messages call it.

    Raises:
        InputError: one line, for a damaged or too large file, and where nothing can be read.
    """
    root = _parsed(content, source)
    with trusted(source, "a valid SVG drawing"), np.errstate(all="ignore"):
        page = _page(root, source)
        walk = _Walk(root, source)
        if b"<?xml-stylesheet" in content:
            walk.not_read["external style sheet"] += 1
        parts = walk.whole(page)
        return paint(parts, page, walk.not_read, source)


def _parsed(content: bytes, source: str) -> ElementTree.Element:
    """The tree of the file, once it is known to stay small."""
    if len(content) > MAX_SVG:
        got = f"{len(content)} bytes"
        raise InputError(source, got, f"an SVG drawing of at most {MAX_SVG} bytes")
    if b"\0" in content:
        raise InputError(source, "an encoding of two bytes a letter", "an SVG drawing in UTF-8")
    promised = content.count(b"<!ENTITY")
    entities = [(n, a or b) for n, a, b in _ENTITY.findall(content)] if promised else []
    few = promised <= MAX_ENTITY_NAMES
    grown = few and sum(len(v) * content.count(b"&" + n + b";") for n, v in entities)
    nested = any(b"&" in value or b"%" in value for _, value in entities)
    if not few or nested or grown > MAX_SVG or promised != len(entities):
        raise InputError(source, "XML entities made of entities", "a plain SVG drawing")
    if b"<!ATTLIST" in content and content.find(b"]>") * content.count(b"<") > 100 * MAX_SVG:
        raise InputError(source, "XML attributes by default", "a plain SVG drawing")
    try:
        return ElementTree.fromstring(content)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        got = f"XML that cannot be read ({error})"
        raise InputError(source, got, "a valid SVG drawing") from None


# ---------------------------------------------------------------- viewports


def _view_box(element: ElementTree.Element) -> list[float] | None:
    """x, y, width and height of the view box of an element, if it says one."""
    box = paths.numbers(element.get("viewBox", ""))
    return box if box is not None and len(box) == 4 and min(box[2:]) >= 0 else None


def _page(root: ElementTree.Element, source: str) -> Page:
    """The view of the whole drawing, as in a page that gives it the size it asks for."""
    box, sizes, real = _view_box(root), [], False
    for key in ("width", "height"):
        given = root.get(key, "").strip()
        number, unit = paths.pair(given) or (0.0, "%")
        if re.match(r"[-+.\d]", given) and paths.pair(given) is None:
            raise InputError(source, f"a {key} {given!r}", "a length")
        known = unit in paths.PIXELS
        sizes.append(number * paths.PIXELS[unit] if known else None)
        if known and not number > 0:
            raise InputError(source, f"a {key} of {number:g}", "a page with an area")
        real = real or (known and unit not in ("", "px"))
    wide, high = sizes
    pixel = 0.0254 / 96 if real else None
    if box is None:
        window = None if wide is None or high is None else (0.0, 0.0, wide, high)
        return Page(_IDENTITY, LengthContext(wide, high), window, pixel)
    if not min(box[2:]) > 0:
        raise InputError(source, "a viewBox without an area", "a page with an area")
    ratio = box[3] / box[2]
    wide = wide or (high / ratio if high else box[2])
    high = high or wide * ratio
    across, up, x, y = paths.fitted(box, (0, 0, wide, high), root.get("preserveAspectRatio", ""))
    matrix = paths.affine(across / up, 0, 0, 1, 0, 0)
    window = -x / up, -y / up, wide / up, high / up
    return Page(matrix, LengthContext(box[2], box[3]), window, up * pixel if pixel else None)


def _area(x: float, y: float, wide: float, high: float, matrix: Matrix) -> tuple[PaintedPart, ...]:
    """A rectangle to confine parts to."""
    curves = paths.polygon([x, y, x + wide, y, x + wide, y + high, x, y + high])
    return (PaintedPart(tuple(curve.moved(matrix) for curve in curves), False),)


# ---------------------------------------------------------------- the walk


class _Walk:
    """Goes through a drawing once, as it is painted.

    Args:
        root: its tree.
        source: the file, as messages call it.
    """

    def __init__(self, root: ElementTree.Element, source: str) -> None:
        self.root, self.source = root, source
        self.named: dict[str, ElementTree.Element] = {}
        self.parents: dict[ElementTree.Element, ElementTree.Element] = {}
        for element in root.iter():
            self.named.setdefault(element.get("id", ""), element)
            self.parents.update(dict.fromkeys(element, element))
        self.sheets = Sheets.of(root, source)
        self.not_read = Counter(self.sheets.not_read)
        self.visited = self.points = self.letters = 0
        self.open: set[ElementTree.Element] = set()
        self.boxed = any(local(element) in ("clipPath", "mask") for element in root.iter())
        self.masking = False
        self.read: dict[str, tuple[list[Curve], bool]] = {}
        """Path data that was read."""
        self.turns: dict[str, Matrix | None] = {}
        """Transforms that were read."""
        self.places: dict[ElementTree.Element, _Context] = {}
        """Places of what is drawn by reference."""
        self.gradients: dict[ElementTree.Element, tuple[tuple[int, int, int], float] | None] = {}
        """Colours of gradients; None for one that is not read."""

    def whole(self, page: Page) -> list[PaintedPart]:
        """What the drawing paints."""
        style = self._style(self.root, {}, (), page.frame)
        frame = replace(page.frame, font=float(style["font-size"]))
        if style.get("display") == "none":
            return []
        if style.get("transform", "none") != "none":
            self.not_read["transform of the whole"] += 1
        place = _Context(page.matrix, style, frame, (self.root,))
        parts = self._finish(*self._children(self.root, place), style, place)
        if page.window is None:
            return parts
        window = _area(*page.window, _IDENTITY)
        return [replace(part, clips=(window, *part.clips)) for part in parts]

    # ------------------------------------------------ elements

    def _style(
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

    def _computed(self, element: ElementTree.Element) -> _Context:
        """The place of what is in an element that is only drawn by reference."""
        if element in self.places:
            return self.places[element]
        chain = [element]
        while chain[-1] in self.parents:
            chain.append(self.parents[chain[-1]])
            self._check_depth(len(chain))
        style, around, frame = {}, (), LengthContext(None, None)
        for each in reversed(chain):
            style = self._style(each, style, around, frame)
            around, frame = (*around, each), replace(frame, font=float(style["font-size"]))
        self.places[element] = _Context(_IDENTITY, style, frame, around)
        return self.places[element]

    def _check_depth(self, depth: int) -> None:
        if depth > MAX_DEPTH:
            expected = f"at most {MAX_DEPTH} levels"
            raise InputError(self.source, "groups nested too deeply", expected)

    def _visit(self, element: ElementTree.Element | None = None, points: int = 0) -> None:
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
    def _following(self, target: ElementTree.Element) -> Iterator[None]:
        """Go to what a reference names, but in no circle."""
        if target in self.open:
            expected = "references without a circle"
            raise InputError(self.source, "a reference to itself", expected)
        self._check_depth(len(self.open))
        self.open.add(target)
        yield
        self.open.discard(target)

    def _target(self, name: str) -> ElementTree.Element | None:
        """The element that ``#name`` means."""
        return self.named.get(name[1:]) if name[:1] == "#" and len(name) > 1 else None

    def _children(self, element: ElementTree.Element, place: _Context) -> _Drawn:
        drawn = [self.draw(child, place) for child in element]
        return [part for parts, _ in drawn for part in parts], _joined(box for _, box in drawn)

    def draw(
        self,
        element: ElementTree.Element,
        place: _Context,
        sizes: tuple[str | None, str | None] | None = None,
    ) -> _Drawn:
        """What an element paints.

        Args:
            sizes: width and height that the ``use`` says by which it is drawn; None in place.
        """
        tag = local(element)
        drawn = tag in _SHAPES or (tag in _GROUPS and (tag != "symbol" or sizes is not None))
        if not (drawn or tag in _NOT_READ) or not _applies(element):
            return [], None
        self._visit(element)
        self._check_depth(place.depth + 1)
        style = self._style(element, place.style, place.around, place.frame)
        if style.get("display") == "none":
            return [], None
        if tag in _NOT_READ:
            self._leave_out(tag, element, style)
            return [], None
        frame = replace(place.frame, font=float(style["font-size"]))
        inside = replace(
            place,
            style=style,
            frame=frame,
            around=(*place.around, element),
            layer=_layer(element, place),
            depth=place.depth + 1,
            local=_IDENTITY,
        ).moved(self._transform(style, frame))
        before = None if styles.share(style.get("opacity", "1")) else Counter(self.not_read)
        inside, parts, box = self._content(tag, element, inside, sizes)
        parts = self._finish(parts, box, style, inside)
        self.not_read = self.not_read if before is None else before  # Nothing of it is seen.
        return parts, _mapped(box, inside.local)

    def _content(
        self,
        tag: str,
        element: ElementTree.Element,
        place: _Context,
        sizes: tuple[str | None, str | None] | None,
    ) -> tuple[_Context, list[PaintedPart], np.ndarray | None]:
        """Parts and box of what is in an element, and the place where that stands."""
        if tag in ("svg", "symbol"):
            return self._viewport(element, place, sizes or (None, None))
        if tag == "switch":
            first = next((child for child in element if local(child) and _applies(child)), None)
            parts, box = ([], None) if first is None else self.draw(first, place)
            return place, parts, box
        if tag not in _SHAPES and tag != "use":
            return place, *self._children(element, place)
        self.not_read["animation"] += sum(_NOT_READ.get(local(c)) == "animation" for c in element)
        if tag == "use":
            return self._use(element, place)
        return place, *self._shape(tag, element, place)

    def _leave_out(self, tag: str, element: ElementTree.Element, style: Style) -> None:
        """Count an element that is not read, where it is seen."""
        shown = style.get("visibility", "visible") == "visible"
        if tag == "text":
            inked = style.get("fill") != "none" or style.get("stroke", "none") != "none"
            shown = shown and inked and any(word.strip() for word in element.itertext())
        if shown and styles.share(style.get("opacity", "1")) > 0:
            self.not_read[_NOT_READ[tag]] += 1

    def _transform(self, style: Style, frame: LengthContext) -> Matrix:
        """The transform of an element; browsers ignore a wrong one."""
        given = style.get("transform", "none")
        if given not in self.turns:
            self.turns[given] = paths.transform(given)
        made = self.turns[given]
        if made is None:
            self.not_read["transform with an error"] += 1
            return _IDENTITY
        words = {"left": "0", "top": "0", "center": "50%", "right": "100%", "bottom": "100%"}
        origin = re.split(r"[\s,]+", style.get("transform-origin", "").strip())
        if len(origin) < 2 or given == "none":
            return made
        x, y = (
            paths.length(words.get(word, word), along, frame, self.source)
            for word, along in zip(origin, "xy", strict=False)
        )
        return paths.shift(x, y) @ made @ paths.shift(-x, -y)

    def _use(
        self, element: ElementTree.Element, place: _Context
    ) -> tuple[_Context, list[PaintedPart], np.ndarray | None]:
        """A copy of another element."""
        x, y = (self._length(place, name, "0") for name in "xy")
        place = place.moved(paths.shift(x, y))
        name = (element.get("href") or element.get(_HREF) or "").strip()
        target = self._target(name)
        if target is None:
            self.not_read["reference to another file"] += name[:1] not in ("", "#")
            return place, [], None
        with self._following(target):
            sizes = element.get("width"), element.get("height")
            return place, *self.draw(target, replace(place, around=()), sizes)

    def _viewport(
        self, element: ElementTree.Element, place: _Context, sizes: tuple[str | None, str | None]
    ) -> tuple[_Context, list[PaintedPart], np.ndarray | None]:
        """An ``svg`` inside another, or a symbol."""
        box = _view_box(element)
        x, y = (self._length(place, name, "0") for name in "xy")
        wide, high = (
            paths.length(given, "xy"[k], place.frame, self.source)
            if given
            else self._length(place, ("width", "height")[k], "100%")
            for k, given in enumerate(sizes)
        )
        if not (wide > 0 and high > 0) or (box and not min(box[2:]) > 0):
            return place, [], None
        clip = _area(x, y, wide, high, place.matrix)
        matrix, frame = paths.shift(x, y), replace(place.frame, wide=wide, high=high)
        if box:
            keep = element.get("preserveAspectRatio", "")
            across, up, *to = paths.fitted(box, (x, y, wide, high), keep)
            matrix = paths.affine(across, 0, 0, up, *to)
            frame = replace(frame, wide=box[2], high=box[3])
        place = replace(place.moved(matrix), frame=frame)
        parts, bounds = self._children(element, place)
        if place.style.get("overflow", "hidden") not in ("visible", "auto"):
            parts = [replace(part, clips=(*part.clips, clip)) for part in parts]
        return place, parts, bounds

    def _length(self, place: _Context, name: str, default: str) -> float:
        """A property that is a length."""
        along = {"x": "x", "cx": "x", "width": "x", "rx": "x", "r": ""}.get(name, "y")
        given = place.style.get(name, default)
        given = default if given == "auto" else given
        return paths.length(given, along, place.frame, self.source)

    # ------------------------------------------------ shapes

    def _shape(self, tag: str, element: ElementTree.Element, place: _Context) -> _Drawn:
        """What a shape paints."""
        curves, box = self._outline(tag, element, place)
        if not curves:
            return [], None
        style = place.style
        shown = style.get("visibility", "visible") == "visible"
        colour, alpha, stroked = (0, 0, 0), 0.0, False
        if shown:
            if tag != "line":
                colour, alpha = self._paint("fill", style)
            width = paths.length(style.get("stroke-width", "1"), "", place.frame, self.source)
            stroked = width > 0 and self._paint("stroke", style)[1] > 0
            marks = [
                styles.reference(style.get(f"marker-{k}", "")) for k in ("start", "mid", "end")
            ]
            if tag not in ("rect", "circle", "ellipse"):
                self.not_read["marker"] += any(m and self._target(m[0]) is not None for m in marks)
        even_odd = style.get("fill-rule") == "evenodd"
        return [PaintedPart(curves, even_odd, colour, alpha, stroked, place.layer)], box

    def _outline(
        self, tag: str, element: ElementTree.Element, place: _Context
    ) -> tuple[tuple[Curve, ...], np.ndarray | None]:
        """The curves of a shape in coordinates of the drawing, and its box in its user units."""
        sound = True
        if tag == "path":
            data = place.style.get("d", element.get("d", ""))
            if data.startswith("path("):
                data = data[5:].strip(" \"')")
            if data not in self.read:
                self.read[data] = paths.path(data, MAX_VERTICES)
            curves, sound = self.read[data]
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
        self.not_read[f"{tag} with an error"] += not sound
        self._visit(points=sum(len(curve.points) for curve in curves))
        box = paths.box_of(curves) if self.boxed else None
        return tuple(curve.moved(place.matrix) for curve in curves), box

    def _basic(self, tag: str, place: _Context) -> list[Curve]:
        """Rectangles and ellipses; a corner radius that is not said is that of the other axis."""
        if tag == "circle":
            rx = ry = self._length(place, "r", "0")
        else:
            given = [name for name in ("rx", "ry") if place.style.get(name, "auto") != "auto"]
            radii = {name: self._length(place, name, "0") for name in given}
            radii = {name: radius for name, radius in radii.items() if radius >= 0}
            rx = radii.get("rx", radii.get("ry", 0.0))
            ry = radii.get("ry", rx)
        if tag == "rect":
            x, y, wide, high = (self._length(place, n, "0") for n in ("x", "y", "width", "height"))
            return paths.rectangle(x, y, wide, high, rx, ry) if wide > 0 and high > 0 else []
        cx, cy = (self._length(place, name, "0") for name in ("cx", "cy"))
        return paths.ellipse(cx, cy, rx, ry) if rx > 0 and ry > 0 else []

    def _paint(self, name: str, style: Style) -> tuple[tuple[int, int, int], float]:
        """Colour and opacity of a fill or stroke; opacity 0 where there is none."""
        value = style.get(name, "black" if name == "fill" else "none")
        alpha = styles.share(style.get(f"{name}-opacity", "1"))
        if alpha and (named := styles.reference(value)):
            target = self._target(named[0])
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
            other = self._target(target.get("href") or target.get(_HREF) or "")
            if stops or other is None:
                break
            target = other
        kinds, mixed = set(), []
        for stop in stops:
            self._visit(stop)
            style = self._computed(stop).style
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

    # ------------------------------------------------ clip paths, masks, opacity

    def _finish(
        self, parts: list[PaintedPart], box: np.ndarray | None, style: Style, place: _Context
    ) -> list[PaintedPart]:
        """What of an element is left by its clip path, mask and opacity."""
        if not any(part.seen for part in parts):
            return parts
        self.not_read.update(filter(None, style.get(styles.UNREAD, "").split(",")))
        parts = self._limited(parts, box, style, place)
        alpha = styles.share(style.get("opacity", "1"))
        return parts if alpha >= 1 else self._faded(parts, alpha)

    def _faded(self, parts: list[PaintedPart], alpha: float) -> list[PaintedPart]:
        """A group that is partly transparent: its white parts hide others of it, and no more."""
        if self.masking and alpha > 0:
            raise InputError(self.source, "a mask that is partly transparent", "black and white")
        if alpha <= 0:
            return [replace(part, alpha=0.0, stroked=False) for part in parts]
        made, above, runs, was_paper = [], (), 0, False
        for part in reversed(parts):
            if part.paper:
                above, runs = (part, *above), runs + (not was_paper)
                made.append(replace(part, alpha=0.0))
            else:
                cuts = (*part.cuts, *above) if part.cuts else above
                made.append(replace(part, alpha=part.alpha * alpha, cuts=cuts))
            was_paper = part.paper
        if runs > MAX_FADED:
            got = "many white shapes in a transparent group"
            raise InputError(self.source, got, f"at most {MAX_FADED}")
        return made[::-1]

    def _limited(
        self, parts: list[PaintedPart], box: np.ndarray | None, style: Style, place: _Context
    ) -> list[PaintedPart]:
        """Parts within the clip path and the mask of their element."""
        for name, tag in (("clip-path", "clipPath"), ("mask", "mask")):
            value = style.get(name, "none")
            named = styles.reference(value)
            if named is None and value != "none":
                got = f"a {name} {value}, which is not read"
                raise InputError(self.source, got, f"a {name} url(#...), or paths without it")
            target = self._target(named[0]) if named else None
            if target is None or local(target) != tag or box is None:
                continue
            with self._following(target):
                make = self._clip if name == "clip-path" else self._mask
                clip = make(target, place, box)
            if clip is not None:
                parts = [replace(part, clips=(*part.clips, clip)) for part in parts]
        return parts

    def _clip(
        self, target: ElementTree.Element, place: _Context, box: np.ndarray
    ) -> tuple[PaintedPart, ...] | None:
        """The region of a clip path; None where there is none."""
        inside = self._computed(target)
        if inside.style.get("display") == "none":
            return None
        boxed = target.get("clipPathUnits") == "objectBoundingBox"
        frame = LengthContext(1.0, 1.0) if boxed else place.frame
        matrix = place.matrix @ (_unit(box) if boxed else _IDENTITY)
        own = replace(inside, matrix=matrix @ self._transform(inside.style, frame), frame=frame)
        made = [part for child in target for part in self._clip_part(child, own)[0]]
        return tuple(self._limited(made, box, inside.style, place))

    def _clip_part(self, element: ElementTree.Element, place: _Context) -> _Drawn:
        """A shape of a clip path, or a copy of one."""
        tag = local(element)
        if tag == "text":
            self.not_read["text in a clip path"] += 1
        if tag not in _SHAPES and tag != "use":
            return [], None
        self._visit(element)
        style = self._style(element, place.style, place.around, place.frame)
        shown = style.get("visibility", "visible") == "visible"
        if style.get("display") == "none" or not (shown or tag == "use"):
            return [], None
        frame = replace(place.frame, font=float(style["font-size"]))
        inside = replace(
            place, style=style, frame=frame, around=(*place.around, element), local=_IDENTITY
        ).moved(self._transform(style, frame))
        if tag == "use":
            target = self._target((element.get("href") or element.get(_HREF) or "").strip())
            x, y = (self._length(inside, name, "0") for name in "xy")
            inside = replace(inside.moved(paths.shift(x, y)), around=())
            parts, box = [], None
            if target is not None and local(target) in _SHAPES:
                parts, box = self._clip_part(target, inside)
        else:
            curves, box = self._outline(tag, element, inside)
            parts = [PaintedPart(curves, style.get("clip-rule") == "evenodd")] if curves else []
        clipped = {name: value for name, value in style.items() if name != "mask"}
        return self._limited(parts, box, clipped, inside), _mapped(box, inside.local)

    def _mask(
        self, target: ElementTree.Element, place: _Context, box: np.ndarray
    ) -> tuple[PaintedPart, ...]:
        """The region of a mask that is all or nothing everywhere.

        Raises:
            InputError: for any other.
        """
        inside = self._computed(target)
        boxed = target.get("maskUnits", "objectBoundingBox") == "objectBoundingBox"
        frame = LengthContext(1.0, 1.0) if boxed else place.frame
        x, y, wide, high = (
            paths.length(inside.style.get(name, default), "xy"[k % 2], frame, self.source)
            for k, (name, default) in enumerate(
                (("x", "-10%"), ("y", "-10%"), ("width", "120%"), ("height", "120%"))
            )
        )
        whole = _area(
            x,
            y,
            max(wide, 0.0),
            max(high, 0.0),
            place.matrix @ (_unit(box) if boxed else _IDENTITY),
        )
        boxed = target.get("maskContentUnits") == "objectBoundingBox"
        matrix = place.matrix @ (_unit(box) if boxed else _IDENTITY)
        own = replace(
            inside,
            matrix=matrix,
            frame=LengthContext(1.0, 1.0) if boxed else place.frame,
            depth=place.depth + 1,
        )
        outer, self.not_read = self.not_read, Counter()
        was, self.masking = self.masking, True
        parts, _ = self._children(target, own)
        painted = [part for part in parts if part.alpha > 0 or part.stroked]
        self.masking = was
        found, self.not_read = +self.not_read, outer
        found["stroke"] += sum(part.stroked for part in painted)
        if +found:
            got = f"a mask with {counted(found)}, which is not read"
            raise InputError(self.source, got, "a mask of black and white shapes")
        by_alpha = inside.style.get("mask-type") == "alpha"
        made = [part for part in (self._stencil(p, by_alpha) for p in painted) if part]
        made = [replace(part, clips=(*part.clips, whole)) for part in made]
        return tuple(self._limited(made, box, inside.style, place))

    def _stencil(self, part: PaintedPart, by_alpha: bool) -> PaintedPart | None:
        """A part of a mask as one of a region: black where it shows, white where it hides."""
        light = float(np.dot(part.colour, (0.2126, 0.7152, 0.0722))) / 255
        if part.alpha < _CLEAR:
            return None
        if part.alpha >= OPAQUE and (by_alpha or light >= OPAQUE):
            return replace(part, colour=(0, 0, 0))
        if part.alpha >= OPAQUE and light <= _CLEAR:
            return replace(part, colour=(255, 255, 255))
        got = "a mask that is neither black nor white, which is not read"
        raise InputError(self.source, got, "a mask of black and white shapes")


def _unit(box: np.ndarray) -> Matrix:
    """From the unit square to a box."""
    wide, high = (box[1] - box[0]).tolist()
    return paths.affine(wide, 0, 0, high, float(box[0, 0]), float(box[0, 1]))


def _mapped(box: np.ndarray | None, matrix: Matrix) -> np.ndarray | None:
    """The box around a transformed box: Chromium takes that for the box of a group."""
    if box is None:
        return None
    corners = np.array([(box[i, 0], box[j, 1], 1.0) for i in (0, 1) for j in (0, 1)])
    points = (corners @ matrix.T)[:, :2]
    return np.array([points.min(0), points.max(0)])


def _joined(boxes: Iterable[np.ndarray | None]) -> np.ndarray | None:
    """The box around boxes."""
    known = [box for box in boxes if box is not None]
    if not known:
        return None
    return np.array([np.min([box[0] for box in known], 0), np.max([box[1] for box in known], 0)])


def _applies(element: ElementTree.Element) -> bool:
    """Whether the conditions hold that an element is drawn on; the language is English."""
    spoken = element.get("systemLanguage")
    english = spoken is None or any(
        re.match(r"en\b", word.strip(), re.IGNORECASE) for word in spoken.split(",")
    )
    return english and not element.get("requiredExtensions", "").strip()


def _layer(element: ElementTree.Element, place: _Context) -> str | None:
    """The layer of what is in an element.

    A layer is a group that an editor marked as one, one at the top that somebody named, or one
    that is called like a side.
    """
    marked = element.get(f"{_INKSCAPE}groupmode") == "layer"
    own = element.get("id")
    name = element.get(f"{_INKSCAPE}label") if marked else own
    if local(element) not in _GROUPS or not name or (not marked and _AUTOMATIC.match(name)):
        return place.layer
    return name if marked or not place.depth or name.casefold() in SIDES else place.layer
