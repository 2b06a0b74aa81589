"""DXF drawings as regions."""

from __future__ import annotations

import io
import itertools
import logging
import re
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np

from learn2assemble.design.drawings import (
    FINE,
    MAX_DEPTH,
    MAX_ENTITIES,
    MAX_VERTICES,
    Contours,
    Drawing,
    DrawnShape,
    Layer,
    to_drawing,
)
from learn2assemble.errors import InputError, trusted

_FOOT = 1200 / 3937
"""Of the survey of the United States [m]."""
_DXF_UNITS = {
    **{1: 0.0254, 2: 0.3048, 3: 1609.344, 8: 2.54e-8, 9: 2.54e-5, 10: 0.9144},
    **{4: 1e-3, 5: 1e-2, 6: 1.0, 7: 1e3, 13: 1e-6, 14: 0.1, 15: 10.0, 16: 100.0},
    **{21: _FOOT, 22: _FOOT / 12, 23: 3 * _FOOT, 24: 5280 * _FOOT},
}
"""Lengths of a unit by the number that ``$INSUNITS`` has [m]."""
_DXF_LINES = {"LINE", "ARC", "CIRCLE", "ELLIPSE", "LWPOLYLINE", "POLYLINE", "SPLINE"}
_DXF_HATCHES = {"HATCH", "MPOLYGON"}
_DXF_FILLED = _DXF_HATCHES | {"SOLID", "TRACE"}
MAX_DXF = 6_000_000
"""Largest DXF drawing [bytes]."""


def read_dxf(content: bytes, source: str) -> Drawing:
    """Closed outlines of the model space of an ASCII DXF drawing, blocks expanded.

    Lines and arcs that meet end to end are outlines, too. Texts, dimensions and points are not
    read, nor is what a drawing does not show.
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
    layers: dict[str | None, Layer] = {}
    with trusted(source, "a valid DXF drawing"):
        document = filemanagement.read(io.StringIO(content.decode("utf-8", "replace")))
        _dxf_bounded(document, source)
        shown = _dxf_entities(document.modelspace(), "0", _Hidden.of(document))
        paths = [
            (name, path, number if entity.dxftype() in _DXF_FILLED else None)
            for number, (name, entity) in enumerate(shown)
            for path in _dxf_paths(entity)
        ]
        for (name, number), group in itertools.groupby(_dxf_flat(paths), lambda one: one[:2]):
            outlines = [points for *_, points in group]
            if number is None:
                chains.setdefault(name, []).extend(outlines)
            else:
                layers.setdefault(name, Layer()).filled.append(DrawnShape(outlines, True))
    for name, lines in chains.items():
        layers.setdefault(name, Layer()).lines.extend(_closed(lines))
    metres = _DXF_UNITS.get(int(document.header.get("$INSUNITS", 0)))
    return to_drawing(layers, metres, source)


def _dxf_bounded(document: Any, source: str) -> None:
    """Refuse blocks that expand to too much, before they are expanded."""
    known: dict[str | None, tuple[int, int]] = {}
    open_blocks: set[str | None] = set()

    def total(name: str | None) -> tuple[int, int]:
        """Entities in a block with those it refers to, and how deep they are."""
        if name in open_blocks:
            raise InputError(source, "a reference to itself", "references without a circle")
        if name not in known:
            open_blocks.add(name)
            inside: Any = document.modelspace() if name is None else document.blocks.get(name) or ()
            entities, depth = len(inside), len(open_blocks)
            for entity in inside if depth <= MAX_DEPTH else ():
                if entity.dxftype() == "INSERT":
                    more, deep = total(entity.dxf.name)
                    entities += max(entity.mcount, 1) * more
                    depth = max(depth, len(open_blocks) + deep)
            if depth > MAX_DEPTH:
                raise InputError(source, "blocks nested too deeply", f"at most {MAX_DEPTH} levels")
            open_blocks.discard(name)
            known[name] = entities, depth - len(open_blocks)
        return known[name]

    entities, _ = total(None)
    if entities > MAX_ENTITIES:
        got = f"a drawing of {entities} entities, references expanded"
        raise InputError(source, got, f"at most {MAX_ENTITIES}")


class _Hidden(NamedTuple):
    """Layers that a drawing does not show, in lower case: names of layers have none of their own.

    What a block has on layers of its own is shown where the block is on one that is off, but not
    where that is frozen.
    """

    off: set[str]
    frozen: set[str]

    @classmethod
    def of(cls, document: Any) -> _Hidden:
        """Those of a drawing."""
        layers: list[Any] = list(document.layers)
        return cls(
            {layer.dxf.name.lower() for layer in layers if layer.is_off()},
            {layer.dxf.name.lower() for layer in layers if layer.is_frozen()},
        )


def _dxf_entities(
    entities: Iterable[Any], inherited: str, hidden: _Hidden
) -> Iterator[tuple[str, Any]]:
    """Entities that are shown, with the layer they are drawn on; layer 0 in a block is that of the
    block."""
    for entity in entities:
        own = entity.dxf.get("layer", "0")
        layer = inherited if own == "0" else own
        if entity.dxf.get("invisible", 0) or layer.lower() in hidden.frozen:
            continue
        if entity.dxftype() == "INSERT":
            many = entity.mcount > 1
            inside = entity.multi_insert() if many else entity.virtual_entities()
            yield from _dxf_entities(inside, layer, hidden)
        elif layer.lower() not in hidden.off:
            yield layer, entity


def _dxf_paths(entity: Any) -> list[Any]:
    """What an entity draws, as paths of lines and Bezier curves."""
    from ezdxf import path

    kind = entity.dxftype()
    if kind in _DXF_HATCHES:
        made = (
            path.from_hatch_boundary_path(outline, entity.ocs(), entity.dxf.elevation.z)
            for outline in _hatch_outlines(entity)
        )
        return [part for one in made for part in (one.sub_paths() if one.has_sub_paths else [one])]
    if kind not in _DXF_LINES | _DXF_FILLED:
        return []
    made = path.make_path(entity)
    if kind in _DXF_FILLED or getattr(entity, "is_closed", False):
        made.close()
    return [made]


def _hatch_outlines(hatch: Any) -> list[Any]:
    """The outlines of a hatch between which it is filled by the even-odd rule: all, but where its
    style counts those alone that it marks as the outer ones."""
    from ezdxf.lldxf import const

    style = hatch.dxf.get("hatch_style", const.HATCH_STYLE_NESTED)
    outlines: list[Any] = list(hatch.paths)
    marked = any(one.path_type_flags & const.BOUNDARY_PATH_OUTERMOST for one in outlines)
    if style == const.HATCH_STYLE_IGNORE or (style == const.HATCH_STYLE_OUTERMOST and marked):
        return list(hatch.paths.rendering_paths(style)) or outlines
    return outlines


def _dxf_flat(
    paths: list[tuple[str, Any, int | None]],
) -> Iterator[tuple[str, int | None, np.ndarray]]:
    """Vertices ``float64[V, 2]`` of every path, curves as lines.

    Args:
        paths: each with its layer, and the number of what it fills, or None.
    """
    drawn = [(name, path, number) for name, path, number in paths if len(path)]
    boxes = [np.array([(v.x, v.y) for v in path.control_vertices()]) for _, path, _ in drawn]
    everything = np.concatenate(boxes) if boxes else np.zeros((1, 2))
    if not np.isfinite(everything).all():
        raise ValueError("coordinates that are no numbers")
    reach = max(float(np.ptp(everything, axis=0).max()), 1e-12)
    vertices = 0
    for name, path, number in drawn:
        flat = path.flattening(FINE * reach, segments=2)
        points = np.array([(v.x, v.y) for v in itertools.islice(flat, MAX_VERTICES)])
        vertices += len(points)
        if vertices > MAX_VERTICES:
            break  # refused for their number
        yield name, number, points


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
    library: Any = shapely
    merged: Any = library.line_merge(shapely.MultiLineString([x for x in met if not x.is_closed]))
    loops = [*(x for x in met if x.is_closed), *shapely.get_parts(merged)]
    return [np.array(x.coords[:-1]) for x in loops if x.is_closed and len(x.coords) > 3]
