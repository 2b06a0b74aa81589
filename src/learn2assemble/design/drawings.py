"""Drawings of sides as regions, and our elevation JSON; ``svg`` and ``dxf`` read the others.

Everything here is bounded before a library expands it, so that no file takes long to refuse.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from learn2assemble.errors import InputError, UnknownNameError, closest
from learn2assemble.files import FARTHEST
from learn2assemble.values import Range, mapping, read_document

if TYPE_CHECKING:
    from manifold3d import CrossSection

SIDES = ("front", "back", "right", "left")
"""Names of sides, in the order in which the elevations of a JSON design stand and in that of
:func:`learn2assemble.tasks.world.layouts.side_frames`."""
MAX_ENTITIES = 3000
"""Most entities of a drawing, references expanded."""
MAX_PAINTS = 300
"""Most changes of colour of a drawing whose colours are read."""
MAX_DEPTH = 60
"""Deepest nesting of groups or blocks."""
_SPAN = 1000.0
"""Drawings are scaled to about this before they are clipped, whatever their unit."""
FINE = 5e-5
"""Largest distance of a curve from the lines that stand for it, as a share of the drawing, where
there are not too many."""
MAX_VERTICES = 100_000
"""Most vertices of a drawing, curves as lines."""
MAX_OVERLAPS = {"outlines": 300_000, "lines": 1_500_000}
"""Most pairs of them whose boxes overlap; clipping takes time with their number."""

_FAR = 1e6
"""Farthest that a coordinate may be, in extents of what is seen."""
MAX_CLIPPED = 1_000_000
"""Most vertices of regions that shapes are confined to, each time."""
MAX_PAINTED = 20_000_000
"""Most vertices painted, times changes from material to paper."""

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
    paints: Mapping[str, list[Paint]] = field(default_factory=dict[str, list[Paint]])
    """By side, what is painted in which colour, later over earlier; empty for one of one colour."""
    not_read: str | None = None
    """What is visible in the file and is not read, in one line."""


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


def read_elevations(document: Any, source: str) -> Drawing:
    """The elevation JSON of ``docs/design_files.md``; its two format keys may be missing."""
    given = mapping(document, source)
    kind = given.get("format", _FORMAT)
    if "elevations" not in given and kind != _FORMAT:
        expected = f"{_FORMAT!r}; of a plan, its folder or assembly.json"
        raise InputError(f"{source}: format", kind, expected)
    if "elevations" not in given and not any(closest(key, ["elevations"]) for key in given):
        raise InputError(source, sorted(given) or "no keys", "the key 'elevations'")
    root = {"format": _FORMAT, "version": 1, **given}
    file, _ = read_document(_Elevations, root, source, _FORMAT, 1, *_IGNORED)
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


@dataclass(frozen=True, eq=False)
class DrawnShape:
    """What is drawn at once.

    Args:
        even_odd: whether it is filled by the even-odd rule.
        paper: whether it is painted in the colour of paper, over what is below it.
        clips: regions it is confined to, each painted by shapes of its own.
        cuts: shapes that hide it, and nothing else.
        order: its number in the order of painting.
    """

    contours: Contours
    even_odd: bool
    paper: bool = False
    colour: Colour | None = None
    clips: tuple[tuple[DrawnShape, ...], ...] = ()
    cuts: tuple[DrawnShape, ...] = ()
    order: int = 0

    def box(self, known: dict[int, np.ndarray]) -> np.ndarray:
        """Lowest and highest corner, ``float64[2, 2]``, of what is left of it; the lowest is not
        below the highest where nothing is.

        Args:
            known: boxes of regions by their identity, which are kept there.
        """
        low, high = np.full(2, np.inf), np.full(2, -np.inf)
        for contour in self.contours:
            low, high = np.minimum(low, contour.min(0)), np.maximum(high, contour.max(0))
        for clip in self.clips:
            if id(clip) not in known:
                boxes = [shape.box(known) for shape in clip if not shape.paper]
                ends = np.array(boxes or [((np.inf,) * 2, (-np.inf,) * 2)])
                known[id(clip)] = np.stack([ends[:, 0].min(0), ends[:, 1].max(0)])
            low, high = np.maximum(low, known[id(clip)][0]), np.minimum(high, known[id(clip)][1])
        return np.stack([low, high])

    def region(self, scale: float, known: dict[int, CrossSection]) -> CrossSection:
        """What it fills.

        Args:
            known: regions of clips by their identity, which are kept there.
        """
        from manifold3d import CrossSection, FillRule

        rule = FillRule.EvenOdd if self.even_odd else FillRule.NonZero
        made = CrossSection([contour * scale for contour in self.contours], rule)
        for clip in self.clips:
            if id(clip) not in known:
                known[id(clip)] = _painted(clip, scale, known)
            made = made ^ known[id(clip)]
        return made - _united(self.cuts, scale, known) if self.cuts else made


def _united(
    shapes: Iterable[DrawnShape], scale: float, known: dict[int, CrossSection]
) -> CrossSection:
    from manifold3d import CrossSection, OpType

    return CrossSection.batch_boolean([s.region(scale, known) for s in shapes], OpType.Add)


def _painted(
    shapes: Iterable[DrawnShape], scale: float, known: dict[int, CrossSection]
) -> CrossSection:
    """What is left of shapes that are painted one after another, paper over material."""
    from manifold3d import CrossSection

    made = CrossSection()
    for paper, group in itertools.groupby(shapes, key=lambda shape: shape.paper):
        part = _united(group, scale, known)
        made = made - part if paper else made + part
    return made


def polygons_of(region: CrossSection) -> Contours:
    """The outlines of a region, ``float64[V, 2]`` each."""
    whole: Any = region
    return whole.to_polygons()


@dataclass
class Layer:
    """What is drawn on one layer."""

    filled: list[DrawnShape] = field(default_factory=list[DrawnShape])
    """In the order of drawing."""
    lines: Contours = field(default_factory=list[np.ndarray])
    """Closed outlines that are only drawn as lines: those inside others are holes."""
    known: dict[int, CrossSection] = field(default_factory=dict[int, "CrossSection"])
    """Regions of clips."""

    def shapes(self) -> list[DrawnShape]:
        """All shapes of the layer."""
        return [*self.filled, *([DrawnShape(self.lines, True)] if self.lines else ())]

    def simplify(self, tolerance: float) -> None:
        """Leave out vertices that matter less than ``tolerance``."""
        self.lines = _simple(self.lines, tolerance)
        self.filled = [replace(s, contours=_simple(s.contours, tolerance)) for s in self.filled]

    def region(self, scale: float) -> CrossSection:
        """The material of the layer; even-odd among lines, filled shapes painted over another."""
        made = _painted(self.filled, scale, self.known)
        lines = DrawnShape(self.lines, True).region(scale, self.known)
        return (made + lines).simplify(FINE * _SPAN)

    def paints(self, scale: float, material: CrossSection) -> list[Paint]:
        """What is filled in which colour, in the order of painting; neighbours in one joined."""
        made = list[Paint]()
        shapes = [shape for shape in self.filled if not shape.paper and shape.colour is not None]
        runs = [(c, list(group)) for c, group in itertools.groupby(shapes, lambda s: s.colour)]
        if len(runs) > MAX_PAINTS:
            return []
        for colour, group in runs:
            region = _united(group, scale, self.known) ^ material
            if colour is not None and not region.is_empty():
                made.append(([p / scale for p in polygons_of(region)], colour))
        return made


def _simple(contours: Contours, tolerance: float) -> Contours:
    import shapely

    closed = (np.concatenate([contour, contour[:1]]) for contour in contours)
    rings = [shapely.LineString(c).simplify(tolerance, preserve_topology=False) for c in closed]
    return [np.array(ring.coords[:-1]) for ring in rings if len(ring.coords) > 3]


def to_drawing(layers: Mapping[str | None, Layer], metres: float | None, source: str) -> Drawing:
    """Regions of the layers as sides. ``None`` is what is drawn on no named layer."""
    drawn = {name: layer for name, layer in layers.items() if layer.filled or layer.lines}
    shapes = [shape for layer in drawn.values() for shape in layer.shapes()]
    points = [p for shape in shapes for p in shape.contours]
    if not points:
        expected = "at least one closed outline (polyline, circle, lines end to end)"
        raise InputError(source, "no closed outline", expected)
    limits = _regions(shapes)
    everything = np.concatenate([*points, *(p for s in limits for p in s.contours)])
    if not np.isfinite(everything).all() or np.abs(everything).max() > FARTHEST:
        raise InputError(source, "coordinates that are not numbers or beyond 1e9", "a drawing")
    if len(everything) > MAX_VERTICES:
        raise InputError(source, "a very fine drawing", f"at most {MAX_VERTICES} vertices")
    span = _span(shapes)
    if not span > 0:
        raise InputError(source, "outlines without an area", "material inside closed outlines")
    if np.abs(everything).max() > _FAR * span:
        got = "coordinates far beyond what is seen"
        raise InputError(source, got, f"at most {_FAR:g} times its extent")
    for layer in drawn.values():
        layer.simplify(FINE * span)
    shapes = [shape for layer in drawn.values() for shape in layer.shapes()]
    contours = [p for shape in shapes for p in shape.contours]
    if not contours:
        raise InputError(source, "outlines without an area", "material inside closed outlines")
    _check_overlaps([*contours, *(p for s in limits for p in s.contours)], source)
    _check_work([*shapes, *limits], source)
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
            sides.setdefault(side, []).extend(p * (span / _SPAN) for p in polygons_of(region))
            paints.setdefault(side, []).extend(layer.paints(_SPAN / span, region))
    if not sides:
        raise InputError(source, "outlines without an area", "material inside closed outlines")
    sides = dict(sorted(sides.items(), key=lambda item: SIDES.index(item[0])))
    colours = {colour for found in paints.values() for _, colour in found}
    if colours <= {(0, 0, 0)} or sum(map(len, paints.values())) > MAX_PAINTS:
        paints = {}  # Black alone is ink.
    return Drawing(sides, metres, paints=paints)


def _regions(shapes: Iterable[DrawnShape]) -> list[DrawnShape]:
    """The shapes of the regions that others are confined to or hidden by, each once."""
    made: dict[int, DrawnShape] = {}
    todo = list(shapes)
    while todo:
        shape = todo.pop()
        for region in (*shape.clips, shape.cuts):
            todo.extend(other for other in region if id(other) not in made)
            made.update((id(other), other) for other in region)
    return list(made.values())


def _span(shapes: Iterable[DrawnShape]) -> float:
    """Width or height of what is seen of shapes; not above 0 where nothing is."""
    known: dict[int, np.ndarray] = {}
    boxes = np.array(
        [shape.box(known) for shape in shapes if not shape.paper] or [np.zeros((2, 2))]
    )
    boxes = boxes[(boxes[:, 1] >= boxes[:, 0]).all(1)]
    return float((boxes[:, 1].max(0) - boxes[:, 0].min(0)).max()) if len(boxes) else 0.0


def _check_work(shapes: Sequence[DrawnShape], source: str) -> None:
    """Refuse shapes whose regions would take long: each goes through its clips, and every change
    from material to paper through all that is painted so far."""
    sizes: dict[int, int] = {}
    for shape in shapes:
        for region in (*shape.clips, shape.cuts):
            sizes.setdefault(id(region), sum(len(c) for s in region for c in s.contours))
    clipped = sum(sizes[id(region)] for s in shapes for region in (*s.clips, s.cuts))
    turns = sum(one.paper != other.paper for one, other in itertools.pairwise(shapes))
    painted = turns * sum(len(c) for s in shapes for c in s.contours)
    for got, work, most in (
        ("clip paths and masks of many vertices over many shapes", clipped, MAX_CLIPPED),
        ("black and white over one another too often", painted, MAX_PAINTED),
    ):
        if work > most:
            raise InputError(source, got, f"at most {most} vertices in all")


def _check_overlaps(contours: Contours, source: str) -> None:
    """Refuse contours that cross so often that clipping them would take long."""
    import shapely

    edges = [np.stack([c, np.roll(c, -1, axis=0)]) for c in contours]
    boxes = {
        "outlines": np.array([(*c.min(0), *c.max(0)) for c in contours]).reshape(-1, 4),
        "lines": np.concatenate([np.hstack([e.min(0), e.max(0)]) for e in edges]),
    }
    for what, most in MAX_OVERLAPS.items():
        library: Any = shapely
        shapes: Any = library.box(*boxes[what].T)
        tree, left = shapely.STRtree(shapes), most
        for start in range(0, len(shapes), 64):
            left -= tree.query(shapes[start : start + 64]).shape[1]
            if left < 0:
                got = f"{what} that overlap or cross too often"
                raise InputError(source, got, f"at most {most} pairs of {what} that might cross")
