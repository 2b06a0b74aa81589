"""Styles of SVG: sheets, the cascade, and colours.

Read are selectors of tags, classes, ids and ``*``, with descendants and children. Reading takes
time in proportion to the text.
"""

from __future__ import annotations

import colorsys
import functools
import re
import xml.etree.ElementTree as ElementTree
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

from learn2assemble.design.svg.paths import pair
from learn2assemble.errors import InputError

INHERITED = frozenset(
    (
        "fill",
        "fill-rule",
        "fill-opacity",
        "stroke",
        "stroke-opacity",
        "stroke-width",
        "visibility",
        "clip-rule",
        "color",
        "font-size",
        "marker-start",
        "marker-mid",
        "marker-end",
    )
)
_OWN = frozenset(
    (
        "opacity",
        "display",
        "clip-path",
        "mask",
        "overflow",
        "mask-type",
        "stop-color",
        "stop-opacity",
        "transform",
        "transform-origin",
        "x",
        "y",
        "width",
        "height",
        "cx",
        "cy",
        "r",
        "rx",
        "ry",
        "d",
    )
)
NOT_READ = {
    "filter": "filter",
    "mix-blend-mode": "blend mode",
    "transform-box": "transform box",
    "rotate": "CSS rotation",
    "scale": "CSS scale",
    "translate": "CSS translation",
    "offset-path": "motion path",
    "mask-image": "mask image",
    "zoom": "zoom",
}
"""Properties that change what is visible and are not read, in words."""
_ONLY_CSS = frozenset(NOT_READ) - {"filter"}
_PLAIN = frozenset(("", "none", "normal", "view-box", "auto", "initial", "unset", "1"))
UNREAD = "unread"
"""Key of a style under which an element says what is not read of it, in words."""
MAX_RULES = 3000
"""Most selectors of the style sheets of a drawing."""
MAX_COMPARED = 200_000
"""Most comparisons of an element with a selector."""
_DEEPEST = 20

_STRING = r"""\"[^"\\]*(?:\\.[^"\\]*)*\"|'[^'\\]*(?:\\.[^'\\]*)*'"""
_TOKENS = re.compile(rf"""{_STRING}|\\.|[{{}};]|[^"'\\{{}};]+|.""", re.DOTALL)
_PARTS = re.compile(rf"""{_STRING}|\([^()]*\)|;|[^"'(;]+|.""", re.DOTALL)
_COMPOUND = re.compile(r"(\*|[\w-]+)?((?:[.#][\w-]+)*)(:root)?")
_STATES = re.compile(r":(hover|active|focus|visited|target|focus-\w+)\b|::")
_URL = re.compile(r"""url\(\s*["']?([^"')]*)["']?\s*\)\s*(.*)""", re.DOTALL | re.IGNORECASE)

Style = dict[str, str]
Colour = tuple[int, int, int, float]
"""Red, green, blue from 0 to 255, and opacity."""


def local(element: ElementTree.Element) -> str:
    """The tag of an element of SVG; empty for one of another language."""
    given: Any = element.tag  # A function, of comments and instructions.
    tag = given if isinstance(given, str) else "{}"
    space, _, name = tag.rpartition("}")
    return name if space in ("", "{http://www.w3.org/2000/svg") else ""


# ---------------------------------------------------------------- colours


@functools.lru_cache(4096)
def colour(text: str) -> Colour | None:
    """A colour; None for what is none, or is not read."""
    from PIL.ImageColor import colormap

    text = text.strip().lower()
    named = colormap.get(text)
    text = named if isinstance(named, str) else text
    if text == "transparent":
        return 0, 0, 0, 0.0
    if re.fullmatch(r"#([0-9a-f]{3,4}|[0-9a-f]{6}|[0-9a-f]{8})", text):
        digits = text[1:] if len(text) > 5 else "".join(2 * digit for digit in text[1:])
        r, g, b, *a = bytes.fromhex(digits)
        return r, g, b, a[0] / 255 if a else 1.0
    found = re.fullmatch(r"(rgb|hsl)a?\(([^()]*)\)", text)
    values = [pair(part) for part in re.split(r"[\s,/]+", found[2].strip())] if found else []
    if not found or len(values) not in (3, 4):
        return None
    given = [value for value in values if value is not None]
    if len(given) < len(values):
        return None
    alpha = given[3][0] / (100 if given[3][1] == "%" else 1) if len(given) == 4 else 1.0
    if found[1] == "hsl":
        hue, lightness, strength = given[0][0] / 360 % 1, given[2][0] / 100, given[1][0] / 100
        mixed = [
            255 * v
            for v in colorsys.hls_to_rgb(hue, min(max(lightness, 0), 1), min(max(strength, 0), 1))
        ]
    else:
        mixed = [v * 2.55 if unit == "%" else v for v, unit in given[:3]]
    r, g, b = (round(min(max(v, 0), 255)) for v in mixed)
    return r, g, b, min(max(alpha, 0.0), 1.0)


def share(text: str) -> float:
    """An opacity from 0 to 1; 1 for what is none."""
    number, unit = pair(text) or (1.0, "")
    return min(max(number / (100 if unit == "%" else 1), 0.0), 1.0)


def reference(text: str) -> tuple[str, str] | None:
    """Name and rest of ``url(#name) rest``; None where it is no such thing."""
    found = _URL.match(text.strip())
    return (found[1].strip(), found[2].strip()) if found else None


def _is_valid(name: str, value: str) -> bool:
    """Whether a browser takes a declaration, as far as it matters here."""
    if name in ("fill", "stroke", "color", "stop-color"):
        word = value.lower()
        plain = word in ("none", "currentcolor", "inherit", "initial", "unset")
        return plain or reference(value) is not None or colour(value) is not None
    if name in ("opacity", "fill-opacity", "stroke-opacity", "stop-opacity"):
        found = pair(value)
        return value in ("inherit", "initial", "unset") or (
            found is not None and found[1] in ("", "%")
        )
    return bool(value)


# ---------------------------------------------------------------- declarations and selectors


def declarations(text: str) -> Iterator[tuple[str, str, bool]]:
    """Name, value and weight (``!important``) of every declaration of a list."""
    pieces: list[str] = []
    for part in (*_PARTS.findall(text), ";"):
        if part != ";":
            pieces.append(part)
            continue
        name, colon, value = "".join(pieces).partition(":")
        pieces = []
        value, mark, weight = value.partition("!")
        name = name.strip().lower()
        if colon and (name in INHERITED or name in _OWN or name in NOT_READ):
            yield name, value.strip(), bool(mark) and weight.strip().lower() == "important"


@dataclass(frozen=True)
class _Rule:
    """Declarations of a selector."""

    compounds: tuple[tuple[str, frozenset[str], bool], ...]
    """Tag or ``*``, ids and classes, whether it is the root; the last is the element itself."""
    children: tuple[bool, ...]
    """Whether a compound must be the parent of the next one, not only around it."""
    weight: tuple[int, int, int]
    order: int
    declared: tuple[tuple[str, str, bool], ...]


def _selector(text: str, order: int, declared: tuple[tuple[str, str, bool], ...]) -> _Rule | None:
    """The rule of a selector; None for one that is not read."""
    compounds, children = list[tuple[str, frozenset[str], bool]](), list[bool]()
    ids = classes = tags = 0
    for word in text.replace(">", " > ").split():
        if word == ">":
            if not compounds or len(children) == len(compounds):
                return None
            children.append(True)
            continue
        found = _COMPOUND.fullmatch(word)
        if not found:
            return None
        if len(children) < len(compounds):
            children.append(False)
        marks = re.findall(r"[.#][\w-]+", found[2])
        ids += found[2].count("#")
        classes += found[2].count(".") + bool(found[3])
        tags += found[1] not in (None, "*")
        compounds.append((found[1] or "*", frozenset(marks), bool(found[3])))
    if not compounds or len(children) != len(compounds) - 1 or len(compounds) > _DEEPEST:
        return None
    return _Rule(tuple(compounds), tuple(children), (ids, classes, tags), order, declared)


def _rules(text: str, source: str) -> Iterator[tuple[tuple[str, ...], str, str]]:
    """What is around a rule, its selectors, and its declarations; statements without a block."""
    first, *others = text.replace("<!--", " ").replace("-->", " ").split("/*")
    text = " ".join([first, *(other.partition("*/")[2] for other in others)])
    around: list[str] = []
    pieces: list[str] = []
    for token in (*_TOKENS.findall(text), *"}" * (_DEEPEST + 1)):
        if token == "{":
            around.append("".join(pieces).strip())
            pieces = []
            if len(around) > _DEEPEST:
                raise InputError(source, "a style sheet nested too deeply", "a flat one")
        elif token == "}":
            body, pieces = "".join(pieces), []
            head = around.pop() if around else "@"
            if not head.startswith("@"):
                yield tuple(around), head, body
        elif token == ";" and not (around and not around[-1].startswith("@")):
            yield (), "".join(pieces).strip(), ""
            pieces = []
        else:
            pieces.append(token)


def _shown(query: str) -> bool | None:
    """Whether a media query holds on a screen; None where that is not read."""
    words = query.lower().removeprefix("@media").strip()
    known = {"": True, "all": True, "screen": True, "only screen": True, "print": False}
    return known.get(words)


@dataclass
class Sheets:
    """The rules of the style sheets of a drawing."""

    rules: dict[str, list[_Rule]] = field(default_factory=dict[str, list[_Rule]])
    """By an id, a class or the tag of the element that a selector ends in."""
    not_read: Counter[str] = field(default_factory=Counter[str])
    """What of them is not read, in words."""
    compared: int = 0
    _known: dict[tuple[int, int], Style] = field(default_factory=dict[tuple[int, int], Style])
    _own: dict[int, frozenset[str]] = field(default_factory=dict[int, frozenset[str]])

    @classmethod
    def of(cls, root: ElementTree.Element, source: str) -> Sheets:
        """Those of a file.

        Raises:
            InputError: for too many rules.
        """
        made, count = cls(), 0
        for element in root.iter():
            if local(element) != "style" or element.get("type", "text/css") != "text/css":
                continue
            if not _shown(element.get("media", "all")):
                continue
            for around, head, body in _rules("".join(element.itertext()), source):
                count += made._add(around, head, body, count)
                if count > MAX_RULES:
                    got = f"style sheets of more than {MAX_RULES} rules"
                    raise InputError(source, got, f"at most {MAX_RULES}")
        return made

    def _add(self, around: tuple[str, ...], head: str, body: str, order: int) -> int:
        """Add a rule; how many selectors it has."""
        if head.startswith("@import"):
            self.not_read["imported style sheet"] += 1
        declared = tuple(declarations(body))
        shown = [_shown(query) if query.startswith("@media") else None for query in around]
        if not declared or False in shown:
            return 1
        selectors = head.split(",", MAX_RULES)
        for selector in selectors:
            rule = _selector(selector, order, declared) if None not in shown else None
            if rule is not None:
                tag, marks, _ = rule.compounds[-1]
                self.rules.setdefault(min(marks, default=tag), []).append(rule)
            elif not _STATES.search(selector):
                self.not_read["style rule"] += 1
        return len(selectors)

    def declared(
        self, element: ElementTree.Element, around: Sequence[ElementTree.Element], source: str
    ) -> Style:
        """The properties that an element itself is given: attributes, sheets, own style.

        Args:
            around: the elements it stands in, outermost first; those of a copy (``use``) begin
                with what is copied.
        """
        key = id(element), id(around[0]) if around else 0
        if key in self._known:
            return self._known[key]
        given = [
            (name, value.strip(), (0, -1, 0, 0, 0, 0))
            for name, value in element.items()
            if (name in INHERITED or name in _OWN or name in NOT_READ) and name not in _ONLY_CSS
        ]
        for rule in self._matching(element, around, source):
            given += [
                (name, value, (important, 0, *rule.weight, rule.order))
                for name, value, important in rule.declared
            ]
        given += [
            (name, value, (important, 1, 0, 0, 0, 0))
            for name, value, important in declarations(element.get("style", ""))
        ]
        made: Style = {}
        unread = set[str]()
        for name, value, _ in sorted(given, key=lambda item: item[2]):
            if name in NOT_READ:
                made[name] = value
            elif "var(" in value or (
                name in ("fill", "stroke") and "(" in value and not _is_valid(name, value)
            ):
                unread.add("CSS variable" if "var(" in value else "colour")
            elif _is_valid(name, value):
                made[name] = value
        unread |= {NOT_READ[name] for name in NOT_READ if made.pop(name, "") not in _PLAIN}
        if unread:
            made[UNREAD] = ",".join(sorted(unread))
        self._known[key] = made
        return made

    def _matching(
        self, element: ElementTree.Element, around: Sequence[ElementTree.Element], source: str
    ) -> Iterator[_Rule]:
        for key in ("*", local(element), *self._marks(element)):
            for rule in self.rules.get(key, ()):
                if self._fits(rule, [*around, element]):
                    yield rule
                if self.compared > MAX_COMPARED:
                    got = "style rules that fit too many elements"
                    raise InputError(source, got, f"at most {MAX_COMPARED} comparisons")

    def _marks(self, element: ElementTree.Element) -> frozenset[str]:
        """Id and classes of an element as selectors write them."""
        if id(element) not in self._own:
            names = (f".{name}" for name in element.get("class", "").split())
            self._own[id(element)] = frozenset((f"#{element.get('id')}", *names))
        return self._own[id(element)]

    def _fits(self, rule: _Rule, chain: Sequence[ElementTree.Element]) -> bool:
        """Whether a selector means the last element of a chain of parents."""
        places = {len(chain) - 1}
        for k in range(len(rule.compounds) - 1, -1, -1):
            tag, marks, root = rule.compounds[k]
            self.compared += len(places)
            places = {
                at
                for at in places
                if tag in ("*", local(chain[at]))
                and marks <= self._marks(chain[at])
                and (not root or (at == 0 and local(chain[at]) == "svg"))
            }
            if not places:
                return False
            if k:  # Of several ancestors that fit, any may be meant.
                near = rule.children[k - 1]
                places = {at - 1 for at in places if at} if near else set(range(max(places)))
        return True


def inherited(parent: Style, declared: Style) -> Style:
    """The style of an element in one of style ``parent``."""
    made = {name: value for name, value in parent.items() if name in INHERITED}
    for name, value in declared.items():
        if value == "inherit" or (value == "unset" and name in INHERITED):
            made |= {name: parent[name]} if name in parent else {}
        elif value in ("initial", "unset"):
            made.pop(name, None)
        else:
            made[name] = value
    return made
