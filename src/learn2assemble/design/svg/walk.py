"""SVG drawings as regions, as a browser draws them.

One walk over the tree follows transforms, references, viewports, styles, clip paths and masks, and
leaves parts in the order of painting. What is not read is counted, so that nothing visible is
left out without a word. The walk is bounded: it counts what it visits, not what the file promises.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from collections import Counter
from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from learn2assemble.design.drawings import (
    SIDES,
    Drawing,
)
from learn2assemble.design.svg import paths
from learn2assemble.design.svg import style as styles
from learn2assemble.design.svg.elements import HREF, IDENTITY, Context, Drawn, Elements
from learn2assemble.design.svg.page import page_of, parsed, view_box
from learn2assemble.design.svg.parts import OPAQUE, Page, PaintedPart, counted, paint
from learn2assemble.design.svg.paths import LengthContext, Matrix
from learn2assemble.design.svg.style import Style, local
from learn2assemble.errors import InputError, trusted

MAX_FADED = 100
"""Most white areas one after another in a half transparent group."""
_CLEAR = 0.02
"""Opacity or brightness up to which there is nothing."""
_INKSCAPE = "{http://www.inkscape.org/namespaces/inkscape}"
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


def read_svg(content: bytes, source: str) -> Drawing:
    """What an SVG drawing shows as regions.

    Args:
        source: the file, as messages call it.

    Raises:
        InputError: one line, for a damaged or too large file, and where nothing can be read.
    """
    root = parsed(content, source)
    with trusted(source, "a valid SVG drawing"), np.errstate(all="ignore"):
        page = page_of(root, source)
        walk = _Walk(root, source)
        if b"<?xml-stylesheet" in content:
            walk.elements.not_read["external style sheet"] += 1
        parts = walk.whole(page)
        return paint(parts, page, walk.elements.not_read, source)


# ---------------------------------------------------------------- viewports


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
        self.elements = Elements(root, source)
        self.masking = False

    def whole(self, page: Page) -> list[PaintedPart]:
        """What the drawing paints."""
        style = self.elements.style(self.root, {}, (), page.frame)
        frame = replace(page.frame, font=float(style["font-size"]))
        if style.get("display") == "none":
            return []
        if style.get("transform", "none") != "none":
            self.elements.not_read["transform of the whole"] += 1
        place = Context(page.matrix, style, frame, (self.root,))
        parts = self._finish(*self._children(self.root, place), style, place)
        if page.window is None:
            return parts
        window = _area(*page.window, IDENTITY)
        return [replace(part, clips=(window, *part.clips)) for part in parts]

    # ------------------------------------------------ elements

    def _children(self, element: ElementTree.Element, place: Context) -> Drawn:
        drawn = [self.draw(child, place) for child in element]
        return [part for parts, _ in drawn for part in parts], _joined(box for _, box in drawn)

    def draw(
        self,
        element: ElementTree.Element,
        place: Context,
        sizes: tuple[str | None, str | None] | None = None,
    ) -> Drawn:
        """What an element paints.

        Args:
            sizes: width and height that the ``use`` says by which it is drawn; None in place.
        """
        tag = local(element)
        drawn = tag in _SHAPES or (tag in _GROUPS and (tag != "symbol" or sizes is not None))
        if not (drawn or tag in _NOT_READ) or not _applies(element):
            return [], None
        self.elements.visit(element)
        self.elements.check_depth(place.depth + 1)
        style = self.elements.style(element, place.style, place.around, place.frame)
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
            local=IDENTITY,
        ).moved(self.elements.transform(style, frame))
        seen = styles.share(style.get("opacity", "1")) > 0
        before = Counter(self.elements.not_read)
        inside, parts, box = self._content(tag, element, inside, sizes)
        parts = self._finish(parts, box, style, inside)
        if not seen:
            self.elements.not_read = before
        return parts, _mapped(box, inside.local)

    def _content(
        self,
        tag: str,
        element: ElementTree.Element,
        place: Context,
        sizes: tuple[str | None, str | None] | None,
    ) -> tuple[Context, list[PaintedPart], np.ndarray | None]:
        """Parts and box of what is in an element, and the place where that stands."""
        if tag in ("svg", "symbol"):
            return self._viewport(element, place, sizes or (None, None))
        if tag == "switch":
            first = next((child for child in element if local(child) and _applies(child)), None)
            parts, box = ([], None) if first is None else self.draw(first, place)
            return place, parts, box
        if tag not in _SHAPES and tag != "use":
            return place, *self._children(element, place)
        self.elements.not_read["animation"] += sum(
            _NOT_READ.get(local(c)) == "animation" for c in element
        )
        if tag == "use":
            return self._use(element, place)
        return place, *self.elements.shape(tag, element, place)

    def _leave_out(self, tag: str, element: ElementTree.Element, style: Style) -> None:
        """Count an element that is not read, where it is seen."""
        shown = style.get("visibility", "visible") == "visible"
        if tag == "text":
            inked = style.get("fill") != "none" or style.get("stroke", "none") != "none"
            shown = shown and inked and any(word.strip() for word in element.itertext())
        if shown and styles.share(style.get("opacity", "1")) > 0:
            self.elements.not_read[_NOT_READ[tag]] += 1

    def _use(
        self, element: ElementTree.Element, place: Context
    ) -> tuple[Context, list[PaintedPart], np.ndarray | None]:
        """A copy of another element."""
        x, y = (self.elements.length(place, name, "0") for name in "xy")
        place = place.moved(paths.shift(x, y))
        name = (element.get("href") or element.get(HREF) or "").strip()
        target = self.elements.target(name)
        if target is None:
            self.elements.not_read["reference to another file"] += name[:1] not in ("", "#")
            return place, [], None
        with self.elements.following(target):
            sizes = element.get("width"), element.get("height")
            return place, *self.draw(target, replace(place, around=()), sizes)

    def _viewport(
        self, element: ElementTree.Element, place: Context, sizes: tuple[str | None, str | None]
    ) -> tuple[Context, list[PaintedPart], np.ndarray | None]:
        """An ``svg`` inside another, or a symbol."""
        box = view_box(element)
        x, y = (self.elements.length(place, name, "0") for name in "xy")
        wide, high = (
            paths.length(given, "xy"[k], place.frame, self.source)
            if given
            else self.elements.length(place, ("width", "height")[k], "100%")
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

    # ------------------------------------------------ clip paths, masks, opacity

    def _finish(
        self, parts: list[PaintedPart], box: np.ndarray | None, style: Style, place: Context
    ) -> list[PaintedPart]:
        """What of an element is left by its clip path, mask and opacity."""
        if not any(part.seen for part in parts):
            return parts
        self.elements.not_read.update(filter(None, style.get(styles.UNREAD, "").split(",")))
        parts = self._limited(parts, box, style, place)
        alpha = styles.share(style.get("opacity", "1"))
        return parts if alpha >= 1 else self._faded(parts, alpha)

    def _faded(self, parts: list[PaintedPart], alpha: float) -> list[PaintedPart]:
        """A group that is partly transparent: its white parts hide others of it, and no more."""
        if self.masking and alpha > 0:
            raise InputError(self.source, "a mask that is partly transparent", "black and white")
        if alpha <= 0:
            return [replace(part, alpha=0.0, stroked=False) for part in parts]
        made, above, runs, was_paper = list[PaintedPart](), tuple[PaintedPart, ...](), 0, False
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
        self, parts: list[PaintedPart], box: np.ndarray | None, style: Style, place: Context
    ) -> list[PaintedPart]:
        """Parts within the clip path and the mask of their element."""
        for name, tag in (("clip-path", "clipPath"), ("mask", "mask")):
            value = style.get(name, "none")
            named = styles.reference(value)
            if named is None and value != "none":
                got = f"a {name} {value}, which is not read"
                raise InputError(self.source, got, f"a {name} url(#...), or paths without it")
            target = self.elements.target(named[0]) if named else None
            if target is None or local(target) != tag or box is None:
                continue
            with self.elements.following(target):
                make = self._clip if name == "clip-path" else self._mask
                clip = make(target, place, box)
            if clip is not None:
                parts = [replace(part, clips=(*part.clips, clip)) for part in parts]
        return parts

    def _clip(
        self, target: ElementTree.Element, place: Context, box: np.ndarray
    ) -> tuple[PaintedPart, ...] | None:
        """The region of a clip path; None where there is none."""
        inside = self.elements.computed(target)
        if inside.style.get("display") == "none":
            return None
        boxed = target.get("clipPathUnits") == "objectBoundingBox"
        frame = LengthContext(1.0, 1.0) if boxed else place.frame
        matrix = place.matrix @ (_unit(box) if boxed else IDENTITY)
        own = replace(
            inside, matrix=matrix @ self.elements.transform(inside.style, frame), frame=frame
        )
        made = [part for child in target for part in self._clip_part(child, own)[0]]
        return tuple(self._limited(made, box, inside.style, place))

    def _clip_part(self, element: ElementTree.Element, place: Context) -> Drawn:
        """A shape of a clip path, or a copy of one."""
        tag = local(element)
        if tag == "text":
            self.elements.not_read["text in a clip path"] += 1
        if tag not in _SHAPES and tag != "use":
            return [], None
        self.elements.visit(element)
        style = self.elements.style(element, place.style, place.around, place.frame)
        shown = style.get("visibility", "visible") == "visible"
        if style.get("display") == "none" or not (shown or tag == "use"):
            return [], None
        frame = replace(place.frame, font=float(style["font-size"]))
        inside = replace(
            place, style=style, frame=frame, around=(*place.around, element), local=IDENTITY
        ).moved(self.elements.transform(style, frame))
        if tag == "use":
            target = self.elements.target((element.get("href") or element.get(HREF) or "").strip())
            x, y = (self.elements.length(inside, name, "0") for name in "xy")
            inside = replace(inside.moved(paths.shift(x, y)), around=())
            parts, box = [], None
            if target is not None and local(target) in _SHAPES:
                parts, box = self._clip_part(target, inside)
        else:
            curves, box = self.elements.outline(tag, element, inside)
            parts = [PaintedPart(curves, style.get("clip-rule") == "evenodd")] if curves else []
        clipped = {name: value for name, value in style.items() if name != "mask"}
        return self._limited(parts, box, clipped, inside), _mapped(box, inside.local)

    def _mask(
        self, target: ElementTree.Element, place: Context, box: np.ndarray
    ) -> tuple[PaintedPart, ...]:
        """The region of a mask that is all or nothing everywhere.

        Raises:
            InputError: for any other.
        """
        inside = self.elements.computed(target)
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
            place.matrix @ (_unit(box) if boxed else IDENTITY),
        )
        boxed = target.get("maskContentUnits") == "objectBoundingBox"
        matrix = place.matrix @ (_unit(box) if boxed else IDENTITY)
        own = replace(
            inside,
            matrix=matrix,
            frame=LengthContext(1.0, 1.0) if boxed else place.frame,
            depth=place.depth + 1,
        )
        outer, self.elements.not_read = self.elements.not_read, Counter()
        was, self.masking = self.masking, True
        parts, _ = self._children(target, own)
        painted = [part for part in parts if part.alpha > 0 or part.stroked]
        self.masking = was
        found, self.elements.not_read = +self.elements.not_read, outer
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


def _layer(element: ElementTree.Element, place: Context) -> str | None:
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
