"""Drawings of sides as regions: our elevation JSON, SVG and DXF.

Everything here is bounded before a library expands it, so that no file takes long to refuse.
"""

from __future__ import annotations

import io
import itertools
import logging
import math
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from learn2assemble.errors import InputError, UnknownNameError, trusted
from learn2assemble.files import (
    FARTHEST,
    MAX_BYTES,
    UNITS,
    Range,
    decoded,
    from_plain,
    load_json,
    mapping,
    read_head,
)

if TYPE_CHECKING:
    from manifold3d import CrossSection

SIDES = ("front", "back", "right", "left")
"""Names of sides, in the order in which the elevations of a JSON design stand and in that of
:func:`learn2assemble.world.layouts.side_frames`."""
MAX_ENTITIES = 3000
"""Most entities of a drawing, references expanded."""
MAX_DRAWN = 1_500_000
"""Most characters of a drawing, references expanded."""
MAX_PAINTS = 300
"""Most changes of colour of a drawing whose colours are read."""
MAX_DEPTH = 60
"""Deepest nesting of groups or blocks."""
_SPAN = 1000.0
"""Drawings are scaled to about this before they are clipped, whatever their unit."""
_FINE = 5e-5
"""Largest distance of a curve from the lines that stand for it, as a share of the drawing, where
there are not too many."""
MAX_VERTICES = 100_000
"""Most vertices of a drawing, curves as lines."""
MAX_OVERLAPS = {"outlines": 300_000, "lines": 1_500_000}
"""Most pairs of them whose boxes overlap; clipping takes time with their number."""

Contours = list[np.ndarray]
Colour = tuple[int, int, int]
Paint = tuple[Contours, Colour]


@dataclass(frozen=True)
class Drawing:
    """Outlines by side, as its viewer sees it.

    Args:
        sides: name of a side to its contours, ``float64[V, 2]`` (x right, z up) in units of the
            drawing; counter-clockwise around material, clockwise around holes.
        metres: length of a unit [m]; None where the file does not say.
        placed: whether coordinates count from the middle of the table. Otherwise the drawing
            stands on its lowest point, wherever it was drawn.
    """

    sides: dict[str, Contours]
    metres: float | None
    placed: bool = False
    name: str | None = None
    kit: str | None = None
    blocks: int | None = None
    """How many blocks there are; None where the file does not say."""
    paints: Mapping[str, list[Paint]] = field(default_factory=dict)
    """By side, what is painted in which colour, later over earlier; empty for one of one colour."""


# ---------------------------------------------------------------- elevation JSON

_FORMAT = "learn2assemble-design"
_IGNORED = ("description", "first_block", "success_threshold", "supports")
_Coordinate = Annotated[float, Range(-FARTHEST, FARTHEST)]
Point = tuple[_Coordinate, _Coordinate]


@dataclass(frozen=True)
class _Elevation:
    outline: tuple[Point, ...]
    name: str = ""


@dataclass(frozen=True)
class _Elevations:
    elevations: tuple[_Elevation, ...]
    name: str | None = None
    kit: str | None = None
    blocks: Annotated[int, Range(1, 1e9)] | None = None


def read_elevations(content: bytes, source: str) -> Drawing:
    """The elevation JSON of ``docs/designs.md``; its two format keys may be missing."""
    if len(content) > MAX_BYTES:
        raise InputError(source, f"{len(content)} bytes", f"at most {MAX_BYTES} bytes")
    root = mapping(load_json(decoded(content, source), source, _FORMAT), source)
    keys = tuple(_Elevations.__dataclass_fields__)
    valid = ("format", "version", "units", *keys, *_IGNORED)
    root = read_head({"version": 1, **root}, source, _FORMAT, 1, valid, ("elevations",))
    file: _Elevations = from_plain(_Elevations, {k: root[k] for k in keys if k in root}, source)
    if not 1 <= len(file.elevations) <= len(SIDES):
        got = f"{len(file.elevations)} of them"
        raise InputError(f"{source}: elevations", got, "1 to 4 elevations")
    for key in ("name", "kit"):
        check_line(getattr(file, key) or "", f"{source}: {key}")
    sides = {
        side: _outline(elevation.outline, f"{source}: elevations[{k}].outline")
        for k, (side, elevation) in enumerate(zip(SIDES, file.elevations, strict=False))
    }
    return Drawing(sides, 1.0, True, file.name, file.kit, file.blocks)


def check_line(given: str, where: str) -> None:
    """Refuse text that is not one line of printable characters."""
    if not given.isprintable():
        raise InputError(where, given, "one line of printable characters")


def _outline(points: tuple[Point, ...], where: str) -> Contours:
    import shapely

    for k, point in enumerate(points):
        if point[1] < -1e-9:
            expected = "z >= 0: nothing is below the table"
            raise InputError(f"{where}[{k}]", list(point), expected)
    if not 3 <= len(points) <= MAX_ENTITIES:
        raise InputError(where, f"{len(points)} vertices", f"3 to {MAX_ENTITIES} vertices")
    polygon = shapely.Polygon(points)
    if not polygon.is_valid or polygon.area == 0:
        reason = shapely.is_valid_reason(polygon) if polygon.area else "zero area"
        raise InputError(where, reason, "an outline that neither crosses nor touches itself")
    ring = np.array(points)
    return [ring if polygon.exterior.is_ccw else ring[::-1]]


# ---------------------------------------------------------------- regions


@dataclass(frozen=True)
class _Shape:
    """What is drawn at once."""

    contours: Contours
    even_odd: bool
    """Whether it is filled by the even-odd rule."""
    paper: bool = False
    """Whether it is painted in the colour of paper, over what is below it."""
    colour: Colour | None = None

    def region(self, scale: float) -> CrossSection:
        """What it fills."""
        from manifold3d import CrossSection, FillRule

        rule = FillRule.EvenOdd if self.even_odd else FillRule.NonZero
        return CrossSection([contour * scale for contour in self.contours], rule)


@dataclass
class _Layer:
    """What is drawn on one layer."""

    filled: list[_Shape] = field(default_factory=list)
    """In the order of drawing."""
    lines: Contours = field(default_factory=list)
    """Closed outlines that are only drawn as lines: those inside others are holes."""

    def contours(self) -> Contours:
        """All contours of the layer."""
        return [*self.lines, *(c for shape in self.filled for c in shape.contours)]

    def simplify(self, tolerance: float) -> None:
        """Leave out vertices that matter less than ``tolerance``."""
        self.lines = _simple(self.lines, tolerance)
        self.filled = [replace(s, contours=_simple(s.contours, tolerance)) for s in self.filled]

    def region(self, scale: float) -> CrossSection:
        """The material of the layer; even-odd among lines, filled shapes painted over another."""
        from manifold3d import CrossSection, OpType

        made = CrossSection()
        for paper, shapes in itertools.groupby(self.filled, key=lambda shape: shape.paper):
            parts = [made, *(shape.region(scale) for shape in shapes)]
            made = CrossSection.batch_boolean(parts, OpType.Subtract if paper else OpType.Add)
        return (made + _Shape(self.lines, True).region(scale)).simplify(_FINE * _SPAN)

    def paints(self, scale: float) -> list[Paint]:
        """What is filled in which colour, in the order of painting; neighbours in one joined."""
        from manifold3d import CrossSection, OpType

        made, material = [], self.region(scale)
        shapes = [shape for shape in self.filled if not shape.paper and shape.colour is not None]
        for colour, group in itertools.groupby(shapes, key=lambda shape: shape.colour):
            parts = [shape.region(scale) for shape in group]
            region = CrossSection.batch_boolean(parts, OpType.Add) ^ material
            if colour is not None and not region.is_empty():
                made.append(([p / scale for p in region.to_polygons()], colour))
        return made


def _simple(contours: Contours, tolerance: float) -> Contours:
    import shapely

    closed = (np.concatenate([contour, contour[:1]]) for contour in contours)
    rings = [shapely.LineString(c).simplify(tolerance, preserve_topology=False) for c in closed]
    return [np.array(ring.coords[:-1]) for ring in rings if len(ring.coords) > 3]


def _drawing(
    layers: Mapping[str | None, _Layer], metres: float | None, source: str, hint: str
) -> Drawing:
    """Regions of the layers as sides. ``None`` is what is drawn on no named layer."""
    drawn = {name: layer for name, layer in layers.items() if layer.filled or layer.lines}
    points = [p for layer in drawn.values() for p in layer.contours()]
    if not points:
        raise InputError(source, "no closed outline", f"at least one closed outline ({hint})")
    everything = np.concatenate(points)
    if not np.isfinite(everything).all() or np.abs(everything).max() > FARTHEST:
        raise InputError(source, "coordinates that are not numbers or beyond 1e9", "a drawing")
    span = float(np.ptp(everything, axis=0).max())
    if not span > 0:
        raise InputError(source, "outlines of no extent", "outlines with an area")
    if len(everything) > MAX_VERTICES:
        raise InputError(source, "a very fine drawing", f"at most {MAX_VERTICES} vertices")
    for layer in drawn.values():
        layer.simplify(_FINE * span)
    contours = [p for layer in drawn.values() for p in layer.contours()]
    if not contours:
        raise InputError(source, "outlines without an area", "material inside closed outlines")
    _check_overlaps(contours, source)
    sides: dict[str, Contours] = {}
    paints: dict[str, list[Paint]] = {}
    for name, layer in drawn.items():
        side = "front"
        if len(drawn) > 1 or (name or "").casefold() in SIDES:
            side = (name or "").casefold()
            if side not in SIDES:
                raise UnknownNameError(f"{source}: layer", name or "(none)", SIDES)
        region = layer.region(_SPAN / span)
        if not region.is_empty():
            sides.setdefault(side, []).extend(p * (span / _SPAN) for p in region.to_polygons())
            paints.setdefault(side, []).extend(layer.paints(_SPAN / span))
    if not sides:
        raise InputError(source, "outlines without an area", "material inside closed outlines")
    sides = dict(sorted(sides.items(), key=lambda item: SIDES.index(item[0])))
    colours = {colour for found in paints.values() for _, colour in found}
    if colours <= {(0, 0, 0)} or sum(map(len, paints.values())) > MAX_PAINTS:
        paints = {}  # Black alone is ink.
    return Drawing(sides, metres, paints=paints)


def _check_overlaps(contours: Contours, source: str) -> None:
    """Refuse contours that cross so often that clipping them would take long."""
    import shapely

    edges = [np.stack([c, np.roll(c, -1, axis=0)]) for c in contours]
    boxes = {
        "outlines": np.array([(*c.min(0), *c.max(0)) for c in contours]).reshape(-1, 4),
        "lines": np.concatenate([np.hstack([e.min(0), e.max(0)]) for e in edges]),
    }
    for what, most in MAX_OVERLAPS.items():
        shapes: Any = shapely.box(*boxes[what].T)
        tree, left = shapely.STRtree(shapes), most
        for start in range(0, len(shapes), 64):
            left -= tree.query(shapes[start : start + 64]).shape[1]
            if left < 0:
                got = f"{what} that overlap or cross too often"
                raise InputError(source, got, f"at most {most} pairs of {what} that might cross")


def _expanded(
    start: Any, parts: Callable[[Any], Iterable[tuple[Any, int]]],
    weight: Callable[[Any], tuple[int, int]], source: str,
) -> None:  # fmt: skip
    """Refuse what grows too large when references are followed, without following them twice.

    Args:
        parts: items inside an item or named by it, and how often.
        weight: entities and characters of an item itself.
    """
    known: dict[Any, tuple[int, int, int]] = {}
    open_items: set[Any] = set()

    def total(item: Any) -> tuple[int, int, int]:
        if item in open_items:
            raise InputError(source, "a reference to itself", "references without a circle")
        if item not in known:
            open_items.add(item)
            (entities, drawn), depth = weight(item), len(open_items)
            inside = 0
            for part, times in parts(item) if depth <= MAX_DEPTH else ():
                more = total(part)
                entities, drawn = entities + times * more[0], drawn + times * more[1]
                inside = max(inside, more[2])
            if max(depth, inside + 1) > MAX_DEPTH:
                raise InputError(source, "groups nested too deeply", f"at most {MAX_DEPTH} levels")
            open_items.discard(item)
            known[item] = entities, drawn, inside + 1
        return known[item]

    entities, drawn, _ = total(start)
    if entities > MAX_ENTITIES or drawn > MAX_DRAWN:
        got = f"a drawing of {entities} entities and {drawn} characters, references expanded"
        raise InputError(source, got, f"at most {MAX_ENTITIES} and {MAX_DRAWN}")


# ---------------------------------------------------------------- SVG

_LENGTH = re.compile(r"\s*([0-9.eE+-]+)\s*(mm|cm|in|pt|pc)\s*$")
_POINTS = {"pt": 0.0254 / 72, "pc": 0.0254 / 6}
_PIXEL = 0.0254 / 96
_ENTITY = re.compile(rb"""<!ENTITY\s+([\w.:-]+)\s+(?:"([^"]*)"|'([^']*)')\s*>""")
_LABEL = "{http://www.inkscape.org/namespaces/inkscape}label"
_LAYER = "{http://www.inkscape.org/namespaces/inkscape}groupmode"
_HREF = "{http://www.w3.org/1999/xlink}href"
_CURVED = {"Arc", "CubicBezier", "QuadraticBezier"}
_AUTOMATIC = re.compile(r"(g|group|path|svg|layer|layer_|layer )[\W_\d]*$", re.IGNORECASE)


def read_svg(content: bytes, source: str) -> Drawing:
    """Closed outlines of an SVG drawing, references and transforms followed."""
    from svgelements import SVG

    root = _svg_root(content, source)
    metres = _svg_unit(root)
    _check_svg_read(root, source)
    layers: dict[str | None, _Layer] = {}
    with trusted(source, "a valid SVG drawing"):
        _in_user_units(root)
        parsed = SVG.parse(io.BytesIO(ElementTree.tostring(root)), reify=False, ppi=96.0)
        shapes = list(_svg_shapes(parsed, root))
        curves = sum(type(part).__name__ in _CURVED for _, path in shapes for part in path)
        sampled = np.linspace(0, 1, int(np.clip(MAX_VERTICES // 2 // max(curves, 1), 4, 49)))
        for name, path in shapes:
            _add_svg_shape(layers.setdefault(name, _Layer()), path, sampled, source)
    return _drawing(layers, metres, source, "a rect, circle, polygon, or a path that ends in Z")


def _svg_root(content: bytes, source: str) -> ElementTree.Element:
    """The tree of the file, once it is known to stay small."""
    entities = [(name, (a or b)) for name, a, b in _ENTITY.findall(content)]
    grown = sum(len(value) * content.count(b"&" + name + b";") for name, value in entities)
    nested = any(b"&" in value or b"%" in value for _, value in entities)
    if nested or grown > MAX_DRAWN or content.count(b"<!ENTITY") != len(entities):
        raise InputError(source, "XML entities made of entities", "a plain SVG drawing")
    if len(content) > MAX_DRAWN:
        got = f"{len(content)} bytes"
        raise InputError(source, got, f"an SVG drawing of at most {MAX_DRAWN} bytes")
    try:
        root = ElementTree.fromstring(content)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        got = f"XML that cannot be read ({error})"
        raise InputError(source, got, "a valid SVG drawing") from None
    named = {e.get("id"): e for e in root.iter() if e.get("id")}

    def parts(element: ElementTree.Element) -> Iterator[tuple[ElementTree.Element, int]]:
        yield from ((child, 1) for child in element)
        target = element.get("href") or element.get(_HREF) or ""
        if element.tag.endswith("}use") and target[1:] in named:
            yield named[target[1:]], 1

    def weight(element: ElementTree.Element) -> tuple[int, int]:
        return 1, sum(map(len, element.attrib.values())) + len(element.text or "")

    _expanded(root, parts, weight, source)
    return root


_NOT_READ = ("clip-path", "mask", "filter")
"""Properties that change what is visible and are not read."""
_CLEAR = re.compile(r"\s*[-+]?0*\.?0*\s*%?\s*$")
_DRAWN = {"path", "rect", "circle", "ellipse", "line", "polyline", "polygon"}
_UNDRAWN = {"defs", "symbol", "clipPath", "mask", "filter", "marker", "pattern", "linearGradient",
            "radialGradient", "metadata", "style"}  # fmt: skip
"""Elements whose content is drawn only where another element names it, or never."""


def _declared(declarations: str, name: str) -> str:
    """The last value of a property in a list of declarations; empty where there is none."""
    found = re.findall(rf"(?:^|;)\s*{name}\s*:([^;]*)", declarations)
    return found[-1].partition("!")[0].strip() if found else ""


def _property(element: ElementTree.Element, name: str) -> str:
    """A property of an element itself; its style counts before its attribute."""
    return _declared(element.get("style", ""), name) or element.get(name, "").strip()


@dataclass
class _Sheets:
    """The rules of the style sheets that say what is not read, by the last part of a selector.

    Only the element that a selector ends in is compared: a rule may count for too many elements,
    never for too few.
    """

    rules: dict[str, list[tuple[set[str], str]]] = field(default_factory=dict)

    @classmethod
    def of(cls, root: ElementTree.Element, source: str) -> _Sheets:
        """Those of a file."""
        text = " ".join(e.text or "" for e in root.iter() if e.tag.endswith("}style"))
        first, *others = text.split("/*")
        text = " ".join([first, *(other.partition("*/")[2] for other in others)])
        made, count = cls(), 0
        for rule in text.split("}"):
            head, _, declarations = rule.rpartition("{")
            if all(_declared(declarations, name) in ("", "none") for name in _NOT_READ):
                continue
            for selector in head.rpartition("{")[2].split(","):  # of @media: the rule in it
                count += 1
                if count > MAX_ENTITIES:
                    got = f"over {MAX_ENTITIES} rules of clip paths, masks or filters"
                    raise InputError(source, got, f"at most {MAX_ENTITIES}")
                parts: set[str] = set()  # every element, where a selector is not simple
                if not set(selector) & set("[]()\\"):
                    last = re.split(r"[\s>+~]+", selector.strip())[-1].partition(":")[0]
                    parts = set(re.findall(r"[.#]?[\w-]+", last))
                key = min(parts, default="*")  # an id or a class before a tag
                made.rules.setdefault(key, []).append((parts, declarations))
        return made

    def not_read(self, element: ElementTree.Element) -> Iterator[str]:
        """Properties in use on an element that are not read."""
        tag = str(element.tag).rpartition("}")[2]
        classes = element.get("class", "").split()
        own = {tag, f"#{element.get('id')}", *(f".{name}" for name in classes)}
        found = [d for key in ("*", *own) for parts, d in self.rules.get(key, ()) if parts <= own]
        for name in _NOT_READ:
            itself = _declared(element.get("style", ""), name)
            given = [itself] if itself else [element.get(name, "").strip()]
            if not itself:  # A sheet counts before an attribute.
                given.extend(_declared(declarations, name) for declarations in found)
            if any(value not in ("", "none") for value in given):
                yield name


def _check_svg_read(root: ElementTree.Element, source: str) -> None:
    """Leave out what is fully transparent, and refuse what would be drawn otherwise than seen.

    Only what is drawn is refused: editors leave unused definitions and rules in their files.
    """
    for parent in root.iter():
        for child in list(parent):
            opacity = _property(child, "opacity")
            if opacity and _CLEAR.match(opacity):
                parent.remove(child)
    sheets = _Sheets.of(root, source)
    named = {e.get("id"): e for e in root.iter() if e.get("id")}
    expected = "a drawing without it: apply it to the paths in the editor"

    def draws(element: ElementTree.Element, hidden: bool) -> bool:
        """Whether an element draws something; refuses what is not read on those that do."""
        tag = str(element.tag).rpartition("}")[2]
        if _property(element, "display") == "none":
            return False
        visibility = _property(element, "visibility")
        hidden = visibility in ("hidden", "collapse") if visibility else hidden
        drawn = tag in _DRAWN and not hidden
        for child in element:
            if str(child.tag).rpartition("}")[2] not in _UNDRAWN:
                drawn = draws(child, hidden) or drawn
        target = named.get((element.get("href") or element.get(_HREF) or "")[1:])
        if tag == "use" and target is not None:
            drawn = draws(target, hidden) or drawn
        if drawn:
            for name in sheets.not_read(element):
                raise InputError(source, f"a {name}, which is not read", expected)
            if tag == "symbol" and element.get("viewBox"):
                raise InputError(source, "a symbol with a viewBox, which is not read", expected)
            if tag == "svg" and element is not root:
                raise InputError(source, "an svg inside an svg, which is not read", expected)
        return drawn

    draws(root, False)
    _set_aside(root)


def _set_aside(root: ElementTree.Element) -> None:
    """Move what is drawn only by reference into definitions: the parser would draw it in place."""
    apart = ElementTree.Element("{http://www.w3.org/2000/svg}defs")
    for parent in list(root.iter()):
        tag = str(parent.tag).rpartition("}")[2]
        for child in list(parent) if tag not in _UNDRAWN else ():
            if str(child.tag).rpartition("}")[2] in _UNDRAWN - {"defs", "style"}:
                parent.remove(child)
                apart.append(child)
    root.insert(0, apart)


def _in_user_units(root: ElementTree.Element) -> None:
    """Let a user unit be 1, whatever the size on a page; percentages are of the view box."""
    box = re.findall(r"[-+0-9.eE]+", root.attrib.pop("viewBox", ""))
    root.attrib.pop("preserveAspectRatio", None)
    sizes = []
    for key, index in (("width", 2), ("height", 3)):
        given = root.attrib.pop(key, "")
        found = re.match(r"\s*([0-9.eE+-]+)\s*(px|mm|cm|in|pt|pc)?\s*$", given)
        if len(box) == 4:
            sizes.append(float(box[index]))
        elif found:
            pixels = {**UNITS, **_POINTS, "px": _PIXEL}[found[2] or "px"] / _PIXEL
            sizes.append(float(found[1]) * pixels)
    if len(sizes) < 2:
        return  # The window of the browser would say.
    wide, high = sizes
    lengths = {"x": wide, "width": wide, "cx": wide, "rx": wide, "x1": wide, "x2": wide,
               "y": high, "height": high, "cy": high, "ry": high, "y1": high, "y2": high,
               "r": math.hypot(wide, high) / math.sqrt(2)}  # fmt: skip
    for element in root.iter():
        for key, length in lengths.items():
            given = element.get(key, "").strip()
            if given.endswith("%"):
                element.set(key, repr(float(given[:-1]) / 100 * length))


def _svg_unit(root: ElementTree.Element) -> float | None:
    """Length of a user unit [m], where width or height are given in a unit of the real world."""
    box = re.findall(r"[-+0-9.eE]+", root.get("viewBox", ""))
    for key, index in (("width", 2), ("height", 3)):
        given = _LENGTH.match(root.get(key, ""))
        try:
            if given:
                length = float(given[1]) * {**UNITS, **_POINTS}[given[2]]
                inside = float(box[index]) if len(box) == 4 else length / _PIXEL
                return length / inside if length > 0 and inside > 0 else None
        except ValueError:
            return None
    return None


def _svg_shapes(parsed: Any, root: ElementTree.Element) -> Iterator[tuple[str | None, Any]]:
    """Visible shapes with the layer they are on.

    A layer is a group that an editor marked as one, or one at the top that somebody named.
    """
    from svgelements import Group, Path, Shape, Use

    marked = {e.get("id") for e in root.iter() if e.get(_LAYER) == "layer"}

    def walk(items: Any, layer: str | None, depth: int) -> Iterator[tuple[str | None, Any]]:
        for item in items:
            values = getattr(item, "values", {})
            if isinstance(item, Group | Use):
                own = getattr(item, "id", None)
                name = values.get(_LABEL) if own in marked else own
                named = bool(name) and not (own not in marked and _AUTOMATIC.match(name))
                is_layer = named and (own in marked or depth == 0 or str(name).casefold() in SIDES)
                yield from walk(item, name if is_layer else layer, depth + 1)
            elif isinstance(item, Shape) and values.get("visibility") not in ("hidden", "collapse"):
                yield layer, Path(item)

    yield from walk(parsed, None, 0)


def _add_svg_shape(layer: _Layer, path: Any, sampled: np.ndarray, source: str) -> None:
    """Sort a path into filled shapes, paper, and outlines that are only lines."""
    filled, stroked = _visible(path.fill), _visible(path.stroke)
    if not (filled or stroked):
        return
    paper = filled and min(path.fill.red, path.fill.green, path.fill.blue) >= 250
    # Curves become lines before they are transformed: a skewed arc is no arc.
    matrix = path.transform
    turn = np.array([(matrix.a, matrix.b), (matrix.c, matrix.d)], dtype=np.float64)
    move = np.array([matrix.e, matrix.f], dtype=np.float64)
    closed, is_open = [], False
    for part in path.as_subpaths():
        points = _svg_points(part, sampled) @ turn + move
        reach = np.ptp(points, axis=0).max() if len(points) else 0.0
        if len(points) < 3 or not reach > 0:
            continue
        gap = np.abs(points[0] - points[-1]).max()
        if type(part[-1]).__name__ != "Close" and gap > 1e-3 * reach:
            is_open = True
        else:
            closed.append(points * (1, -1))  # z up
    if is_open and filled and not paper:
        name = f" {path.id!r}" if path.id else ""
        raise InputError(source, f"a filled path{name} that is open", "closed outlines (end in Z)")
    if closed and filled and not (paper and stroked):
        colour = (path.fill.red, path.fill.green, path.fill.blue)
        even_odd = path.values.get("fill-rule") == "evenodd"
        layer.filled.append(_Shape(closed, even_odd, paper, colour))
    elif closed:
        layer.lines.extend(closed)


def _visible(colour: Any) -> bool:
    return colour is not None and colour.value is not None and colour.alpha > 0


def _svg_points(part: Any, sampled: np.ndarray) -> np.ndarray:
    """Vertices of a subpath, curves ``sampled`` in their parameter."""
    points: list[np.ndarray] = []
    for segment in part:
        if type(segment).__name__ in _CURVED:
            points.append(np.array([[p[0], p[1]] for p in segment.npoint(sampled)]))
        elif segment.end is not None:
            points.append(np.array([[segment.end.x, segment.end.y]]))
    return np.concatenate(points) if points else np.zeros((0, 2))


# ---------------------------------------------------------------- DXF

_DXF_UNITS = {1: 0.0254, 2: 0.3048, 4: 1e-3, 5: 1e-2, 6: 1.0, 14: 0.1}
_DXF_LINES = {"LINE", "ARC", "CIRCLE", "ELLIPSE", "LWPOLYLINE", "POLYLINE", "SPLINE"}
_DXF_FILLED = {"HATCH", "MPOLYGON", "SOLID", "TRACE"}
MAX_DXF = 6_000_000
"""Largest DXF drawing [bytes]."""


def read_dxf(content: bytes, source: str) -> Drawing:
    """Closed outlines of the model space of an ASCII DXF drawing, blocks expanded.

    Lines and arcs that meet end to end are outlines, too. Texts, dimensions and points are not
    read.
    """
    from ezdxf import filemanagement

    if content.startswith(b"AutoCAD Binary DXF"):
        raise InputError(source, "a binary DXF drawing", "one saved as ASCII DXF")
    if b"ENTITIES" not in content:
        raise InputError(source, "no section of entities", "a whole DXF drawing")
    entities = len(re.findall(rb"^[ \t]*0[ \t]*\r?$", content, re.MULTILINE))
    if len(content) > MAX_DXF or entities > 8 * MAX_ENTITIES:
        got = f"{len(content)} bytes, about {entities} entities"
        raise InputError(source, got, f"at most {MAX_DXF} bytes and {MAX_ENTITIES} entities")
    logging.getLogger("ezdxf").addHandler(logging.NullHandler())
    chains: dict[str | None, list[np.ndarray]] = {}
    layers: dict[str | None, _Layer] = {}
    with trusted(source, "a valid DXF drawing"):
        document = filemanagement.read(io.StringIO(content.decode("utf-8", "replace")))
        _dxf_bounded(document, source)
        paths = [
            (name, path, entity.dxftype() in _DXF_FILLED)
            for name, entity in _dxf_entities(document.modelspace(), "0")
            for path in _dxf_paths(entity)
        ]
        for name, filled, points in _dxf_flat(paths):
            if filled:
                layers.setdefault(name, _Layer()).filled.append(_Shape([points], True))
            else:
                chains.setdefault(name, []).append(points)
    for name, lines in chains.items():
        layers.setdefault(name, _Layer()).lines.extend(_closed(lines))
    metres = _DXF_UNITS.get(int(document.header.get("$INSUNITS", 0)))
    return _drawing(layers, metres, source, "a closed polyline, a circle, lines end to end")


def _dxf_bounded(document: Any, source: str) -> None:
    """Refuse blocks that expand to too much, before they are expanded."""

    def entities(name: str | None) -> Any:
        return document.modelspace() if name is None else document.blocks.get(name) or ()

    def parts(name: str | None) -> Iterator[tuple[str, int]]:
        for entity in entities(name):
            if entity.dxftype() == "INSERT":
                yield entity.dxf.name, max(entity.mcount, 1)

    def weight(name: str | None) -> tuple[int, int]:
        return len(entities(name)), 0

    _expanded(None, parts, weight, source)


def _dxf_entities(entities: Iterable[Any], inherited: str) -> Iterator[tuple[str, Any]]:
    """Entities with the layer they are drawn on; layer 0 in a block is that of the block."""
    for entity in entities:
        own = entity.dxf.get("layer", "0")
        layer = inherited if own == "0" else own
        if entity.dxftype() != "INSERT":
            yield layer, entity
        else:
            many = entity.mcount > 1
            inside = entity.multi_insert() if many else entity.virtual_entities()
            yield from _dxf_entities(inside, layer)


def _dxf_paths(entity: Any) -> list[Any]:
    """What an entity draws, as paths of lines and Bezier curves."""
    from ezdxf import path

    kind = entity.dxftype()
    if kind in ("HATCH", "MPOLYGON"):
        return list(path.from_hatch(entity))
    if kind not in _DXF_LINES | _DXF_FILLED:
        return []
    made = path.make_path(entity)
    if kind in _DXF_FILLED or getattr(entity, "is_closed", False):
        made.close()
    return [made]


def _dxf_flat(paths: list[tuple[str, Any, bool]]) -> Iterator[tuple[str, bool, np.ndarray]]:
    """Vertices ``float64[V, 2]`` of every path, curves as lines."""
    drawn = [(name, path, filled) for name, path, filled in paths if len(path)]
    boxes = [np.array([(v.x, v.y) for v in path.control_vertices()]) for _, path, _ in drawn]
    everything = np.concatenate(boxes) if boxes else np.zeros((1, 2))
    if not np.isfinite(everything).all():
        raise ValueError("coordinates that are no numbers")
    reach = max(float(np.ptp(everything, axis=0).max()), 1e-12)
    vertices = 0
    for name, path, filled in drawn:
        flat = path.flattening(_FINE * reach, segments=2)
        points = np.array([(v.x, v.y) for v in itertools.islice(flat, MAX_VERTICES)])
        vertices += len(points)
        if vertices > MAX_VERTICES:
            break  # refused for their number
        yield name, filled, points


def _closed(chains: list[np.ndarray]) -> Contours:
    """Closed loops of chains of points that meet end to end, to 1e-5 of their extent."""
    import shapely

    everything = np.concatenate(chains)
    if not np.isfinite(everything).all():
        return chains  # refused with the rest
    ends = np.array([(chain[0], chain[-1]) for chain in chains]).reshape(-1, 2)
    points: Any = shapely.points(ends)
    near = 1e-5 * float(np.ptp(everything, axis=0).max())
    one, other = shapely.STRtree(points).query(points, predicate="dwithin", distance=near)
    first = np.arange(len(ends))
    np.minimum.at(first, one, other)
    same = ends[first].reshape(-1, 2, 2)
    met = [
        shapely.LineString(np.concatenate([[start], chain[1:-1], [end]]))
        for chain, (start, end) in zip(chains, same, strict=True)
    ]
    merged = shapely.line_merge(shapely.MultiLineString([x for x in met if not x.is_closed]))
    loops = [*(x for x in met if x.is_closed), *shapely.get_parts(merged)]
    return [np.array(x.coords[:-1]) for x in loops if x.is_closed and len(x.coords) > 3]
