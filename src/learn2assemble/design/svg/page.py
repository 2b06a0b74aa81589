"""The page of an SVG drawing: its tree, once it is known to stay small, and its view."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree

from learn2assemble.design.svg import paths
from learn2assemble.design.svg.elements import IDENTITY, MAX_SVG
from learn2assemble.design.svg.parts import Page
from learn2assemble.design.svg.paths import LengthContext
from learn2assemble.errors import InputError

MAX_ENTITY_NAMES = 100
"""Most XML entities that a file may define."""


_ENTITY = re.compile(rb"""<!ENTITY\s+([\w.:-]+)\s+(?:"([^"]*)"|'([^']*)')\s*>""")


def parsed(content: bytes, source: str) -> ElementTree.Element:
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


def view_box(element: ElementTree.Element) -> list[float] | None:
    """x, y, width and height of the view box of an element, if it says one."""
    box = paths.numbers(element.get("viewBox", ""))
    return box if box is not None and len(box) == 4 and min(box[2:]) >= 0 else None


def page_of(root: ElementTree.Element, source: str) -> Page:
    """The view of the whole drawing, as in a page that gives it the size it asks for."""
    box, sizes, real = view_box(root), list[float | None](), False
    for key in ("width", "height"):
        given = root.get(key, "").strip()
        number, unit = paths.pair(given) or (0.0, "%")
        no_length = re.match(r"[-+.\d]", given) is not None and paths.pair(given) is None
        if no_length or unit not in (*paths.PIXELS, *paths.RELATIVE):
            got = f"{key}={given!r}" if no_length else f"the unit {unit} of {key}={given!r}"
            units = ", ".join(filter(None, paths.PIXELS))
            raise InputError(source, got, f"a length in one of {units}")
        known = unit in paths.PIXELS
        sizes.append(number * paths.PIXELS[unit] if known else None)
        if known and not number > 0:
            raise InputError(source, f"a {key} of {number:g}", "a page with an area")
        real = real or (known and unit not in ("", "px"))
    wide, high = sizes
    pixel = 0.0254 / 96 if real else None
    if box is None:
        window = None if wide is None or high is None else (0.0, 0.0, wide, high)
        return Page(IDENTITY, LengthContext(wide, high), window, pixel)
    if not min(box[2:]) > 0:
        raise InputError(source, "a viewBox without an area", "a page with an area")
    ratio = box[3] / box[2]
    wide = wide or (high / ratio if high else box[2])
    high = high or wide * ratio
    across, up, x, y = paths.fitted(box, (0, 0, wide, high), root.get("preserveAspectRatio", ""))
    matrix = paths.affine(across / up, 0, 0, 1, 0, 0)
    window = -x / up, -y / up, wide / up, high / up
    return Page(matrix, LengthContext(box[2], box[3]), window, up * pixel if pixel else None)
