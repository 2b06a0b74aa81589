"""Values of SVG: lengths, transforms, and shapes as lines and cubic curves.

Every reader here takes time in proportion to its text.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from learn2assemble.errors import InputError

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_NEXT = re.compile(rf"[\s,]*({_NUMBER})")
_FLAG = re.compile(r"[\s,]*([01])")
_LETTER = re.compile(r"[\s,]*([MmZzLlHhVvCcSsQqTtAa])")
_LENGTH = re.compile(rf"\s*({_NUMBER})\s*(%|[a-zA-Z]*)\s*")
_FUNCTION = re.compile(r"[\s,]*([a-zA-Z]+)\s*\(([^()]*)\)")
_TAKES = {"M": 2, "L": 2, "H": 1, "V": 1, "C": 6, "S": 4, "Q": 4, "T": 2, "A": 7, "Z": 0}
LARGEST = 1e30
"""Numbers beyond this are errors; they could not be squared."""
PIXELS = {
    "": 1.0,
    "px": 1.0,
    "in": 96.0,
    "cm": 96 / 2.54,
    "mm": 96 / 25.4,
    "q": 24 / 25.4,
    "pt": 4 / 3,
    "pc": 16.0,
}
"""User units of a length without a view box."""
RELATIVE = ("%", "em", "rem", "ex", "ch", "vw", "vh", "vmin", "vmax")
"""Units of lengths that are as long as something else is."""
_DEGREES = {"": 1.0, "deg": 1.0, "grad": 0.9, "turn": 360.0, "rad": 180 / math.pi}

Matrix = np.ndarray
"""``float64[3, 3]``; points are columns (x, y, 1)."""


@dataclass(frozen=True)
class LengthContext:
    """What relative lengths are relative to.

    Args:
        wide: width of the view box around an element in its user units; None where only a window
            would say.
        high: height of it.
        font: size of letters.
    """

    wide: float | None
    high: float | None
    font: float = 16.0


def pair(text: str) -> tuple[float, str] | None:
    """Number and unit of a length; None where it is none, or too large."""
    found = _LENGTH.fullmatch(text)
    if not found or abs(float(found[1])) > LARGEST:
        return None
    return float(found[1]), found[2].lower()


def length(text: str, along: str, frame: LengthContext, source: str) -> float:
    """A length in user units.

    Args:
        along: "x", "y", or "" where it has no direction, such as a radius.

    Raises:
        InputError: for what is no length.
    """
    found = pair(text)
    number, unit = found or (0.0, "?")
    if unit in PIXELS:
        return number * PIXELS[unit]
    if unit in ("em", "rem"):
        return number * (frame.font if unit == "em" else 16.0)
    if unit != "%":
        raise InputError(source, f"a length {text!r}", "a number with a unit such as mm, px or %")
    if frame.wide is None or frame.high is None:
        raise InputError(source, f"a length {text!r} of a page of no size", "a viewBox")
    whole = {"x": frame.wide, "y": frame.high}.get(along)
    if whole is None:
        whole = math.hypot(frame.wide, frame.high) / math.sqrt(2)
    return number / 100 * whole


def numbers(text: str) -> list[float] | None:
    """The numbers of a list; None where anything else is in it, or one is too large."""
    made, position, text = list[float](), 0, text.rstrip()
    while position < len(text):
        found = _NEXT.match(text, position)
        if not found or abs(float(found[1])) > LARGEST:
            return None
        made.append(float(found[1]))
        position = found.end()
    return made


# ---------------------------------------------------------------- transforms


def affine(a: float, b: float, c: float, d: float, e: float, f: float) -> Matrix:
    """The matrix of SVG's ``matrix(a b c d e f)``."""
    return np.array([(a, c, e), (b, d, f), (0.0, 0.0, 1.0)])


def shift(x: float, y: float = 0.0) -> Matrix:
    """A translation."""
    return affine(1, 0, 0, 1, x, y)


def _lift(y: float) -> Matrix:
    return shift(0, y)


def _scale(x: float, y: float | None = None) -> Matrix:
    return affine(x, 0, 0, x if y is None else y, 0, 0)


def _widen(x: float) -> Matrix:
    return _scale(x, 1)


def _raise(y: float) -> Matrix:
    return _scale(1, y)


def _skew(x: float, y: float = 0.0) -> Matrix:
    return affine(1, math.tan(math.radians(y)), math.tan(math.radians(x)), 1, 0, 0)


def _skew_up(y: float) -> Matrix:
    return _skew(0, y)


def _turn(angle: float, x: float = 0.0, y: float = 0.0) -> Matrix:
    sine, cosine = math.sin(math.radians(angle)), math.cos(math.radians(angle))
    return shift(x, y) @ affine(cosine, sine, -sine, cosine, 0, 0) @ shift(-x, -y)


_FUNCTIONS: dict[str, tuple[tuple[int, ...], Callable[..., Matrix]]] = {
    "matrix": ((6,), affine),
    "translate": ((1, 2), shift),
    "translatex": ((1,), shift),
    "translatey": ((1,), _lift),
    "scale": ((1, 2), _scale),
    "scalex": ((1,), _widen),
    "scaley": ((1,), _raise),
    "rotate": ((1, 3), _turn),
    "skewx": ((1,), _skew),
    "skewy": ((1,), _skew_up),
    "skew": ((1, 2), _skew),
}


def transform(text: str) -> Matrix | None:
    """The matrix of a list of transforms; None where it has an error, as browsers drop it then."""
    made, position, text = np.eye(3), 0, text.strip()
    if text == "none":
        return made
    while position < len(text):
        found = _FUNCTION.match(text, position)
        takes, make = _FUNCTIONS.get(found[1].lower() if found else "", ((), None))
        values = _arguments(found[2], found[1].lower()) if found and make else None
        if found is None or make is None or values is None or len(values) not in takes:
            return None
        made = made @ make(*values)
        position = found.end()
    return made if np.isfinite(made).all() else None


def _arguments(text: str, name: str) -> list[float] | None:
    """Numbers in the brackets of a transform; lengths in pixels, angles in degrees."""
    units = _DEGREES if name.startswith(("rotate", "skew")) else PIXELS
    units = {"": 1.0} if name.startswith(("scale", "matrix")) else units
    if (plain := numbers(text)) is not None:
        return plain
    made = list[float]()
    for part in re.split(r"[\s,]+", text.strip()):
        number, unit = pair(part) or (0.0, "?")
        if unit not in units:
            return None
        made.append(number * units[unit])
    return made


def fitted(
    box: Sequence[float], place: Sequence[float], keep: str
) -> tuple[float, float, float, float]:
    """How a view box is fitted into a place: scales and shifts along x and y.

    Args:
        box: x, y, width, height of the view box, both sides positive.
        place: the same of where it is to appear.
        keep: ``preserveAspectRatio``.
    """
    words = keep.split() or ["xMidYMid"]
    words = words[1:] if words[0] == "defer" else words
    wide, high = place[2] / box[2], place[3] / box[3]
    where = (
        words[0]
        if words and re.fullmatch(r"none|x(Min|Mid|Max)Y(Min|Mid|Max)", words[0])
        else "xMidYMid"
    )
    if where != "none":
        wide = high = (max if "slice" in words else min)(wide, high)
    share = {"Min": 0.0, "Mid": 0.5, "Max": 1.0, "": 0.0}
    x = (
        place[0]
        - box[0] * wide
        + share[where[1:4] if where != "none" else ""] * (place[2] - box[2] * wide)
    )
    y = (
        place[1]
        - box[1] * high
        + share[where[5:8] if where != "none" else ""] * (place[3] - box[3] * high)
    )
    return wide, high, x, y


# ---------------------------------------------------------------- curves


@dataclass(frozen=True, eq=False)
class Curve:
    """A subpath of lines and cubic curves.

    Args:
        points: ``float64[P, 2]``, ends and control points in their order.
        cubics: index of the first of the four points of every curve; other points are joined by
            lines.
        closed: whether it says that it is.
    """

    points: np.ndarray
    cubics: tuple[int, ...] = ()
    closed: bool = True

    def moved(self, matrix: Matrix) -> Curve:
        """The subpath, transformed."""
        return Curve(self.points @ matrix[:2, :2].T + matrix[:2, 2], self.cubics, self.closed)

    def flat(self, tolerance: float, most: int) -> np.ndarray:
        """Its vertices ``float64[V, 2]``, no further from it than ``tolerance``.

        Args:
            most: most lines that a curve may become.
        """
        if not self.cubics:
            return self.points
        at = np.array(self.cubics)
        a, b, c, d = (self.points[at + k] for k in range(4))
        bend = np.maximum(np.hypot(*(a - 2 * b + c).T), np.hypot(*(b - 2 * c + d).T))
        lines = np.clip(np.ceil(np.sqrt(0.75 * bend / tolerance)), 1, most).astype(int)
        pieces, last = list[np.ndarray](), 0
        for first, many in zip(self.cubics, lines.tolist(), strict=True):
            t = np.linspace(0, 1, many + 1)[1:, None]
            weights = (1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t**2 * (1 - t), t**3
            pieces.append(self.points[last : first + 1])
            ends = zip(weights, self.points[first:], strict=False)
            pieces.append(np.sum([w * p for w, p in ends], axis=0))
            last = first + 4
        return np.concatenate([*pieces, self.points[last:]])


def box_of(curves: Sequence[Curve]) -> np.ndarray | None:
    """Lowest and highest corner of curves, ``float64[2, 2]``; None where there are none."""
    flat = [curve.flat(1e-9, 24) for curve in curves if len(curve.points)]
    if not flat:
        return None
    points = np.concatenate(flat)
    return np.array([points.min(0), points.max(0)])


class _Pen:
    """Draws subpaths."""

    def __init__(self) -> None:
        self.made: list[Curve] = []
        self.points: list[tuple[float, float]] = []
        self.cubics: list[int] = []
        self.at = self.start = (0.0, 0.0)
        self.control = (0.0, 0.0)
        self.last = ""

    def lift(self, closed: bool) -> None:
        """End the subpath."""
        if len(self.points) > 1:
            self.made.append(Curve(np.array(self.points), tuple(self.cubics), closed))
        self.points, self.cubics = [], []

    def curve(self, *points: tuple[float, float]) -> None:
        """A cubic curve from where the pen is."""
        self.cubics.append(len(self.points) - 1)
        self.points.extend(points)
        self.control, self.at = points[1], points[2]

    def quadratic(self, middle: tuple[float, float], end: tuple[float, float]) -> None:
        """A quadratic curve as a cubic one."""
        (x, y), (u, v), (p, q) = self.at, middle, end
        self.curve(((x + 2 * u) / 3, (y + 2 * v) / 3), ((p + 2 * u) / 3, (q + 2 * v) / 3), end)
        self.control = middle

    def arc(
        self,
        radii: tuple[float, float],
        turn: float,
        large: float,
        sweep: float,
        end: tuple[float, float],
    ) -> None:
        """An arc of an ellipse, by the formulas of the SVG specification (appendix B.2.4)."""
        rx, ry = abs(radii[0]), abs(radii[1])
        if self.at == end:
            return
        if not rx or not ry:
            self.points.append(end)
            self.at = end
            return
        sine, cosine = math.sin(math.radians(turn)), math.cos(math.radians(turn))
        x, y = (self.at[0] - end[0]) / 2, (self.at[1] - end[1]) / 2
        x, y = (cosine * x + sine * y) / rx, (cosine * y - sine * x) / ry
        far = x * x + y * y
        grown = math.sqrt(max(far, 1.0))  # Radii that are too small grow.
        rx, ry, x, y, far = rx * grown, ry * grown, x / grown, y / grown, min(far, 1.0)
        off = math.sqrt(max(1 / far - 1, 0)) * (-1 if bool(large) == bool(sweep) else 1)
        u, v = off * y, -off * x
        first, last = math.atan2(y - v, x - u), math.atan2(-y - v, -x - u)
        span = (last - first) % (2 * math.pi)
        span -= 0 if sweep else 2 * math.pi
        middle = (self.at[0] + end[0]) / 2, (self.at[1] + end[1]) / 2
        many = max(1, math.ceil(abs(span) / (math.pi / 4) - 1e-9))
        reach = 4 / 3 * math.tan(span / many / 4)

        def at(p: float, q: float) -> tuple[float, float]:
            p, q = (p + u) * rx, (q + v) * ry
            return middle[0] + cosine * p - sine * q, middle[1] + sine * p + cosine * q

        for k in range(many):
            one, two = first + span * k / many, first + span * (k + 1) / many
            a, b, c, d = math.cos(one), math.sin(one), math.cos(two), math.sin(two)
            stop = at(c, d) if k < many - 1 else end
            self.curve(at(a - reach * b, b + reach * a), at(c + reach * d, d - reach * c), stop)

    def draw(self, command: str, v: Sequence[float]) -> None:
        """One command of path data with its numbers."""
        kind, (x, y) = command.upper(), self.at if command.islower() else (0.0, 0.0)
        if kind == "Z":
            self.lift(True)
            self.at = self.start
        elif kind == "M":
            self.lift(False)
            self.at = self.start = (v[0] + x, v[1] + y)
            self.points.append(self.at)
        else:
            if not self.points:
                self.points.append(self.at)
            self._line_or_curve(kind, v, x, y)
        self.last = kind

    def _line_or_curve(self, kind: str, v: Sequence[float], x: float, y: float) -> None:
        if kind in "LHV":
            end = {
                "L": lambda: (v[0] + x, v[1] + y),
                "H": lambda: (v[0] + x, self.at[1]),
                "V": lambda: (self.at[0], v[0] + y),
            }[kind]()
            self.points.append(end)
            self.at = end
        elif kind == "A":
            self.arc((v[0], v[1]), v[2], v[3], v[4], (v[5] + x, v[6] + y))
        else:
            given = [(v[k] + x, v[k + 1] + y) for k in range(0, len(v), 2)]
            smooth = self.last in ("CS" if kind in "CS" else "QT")
            from_ = self.control if smooth else self.at
            mirrored = 2 * self.at[0] - from_[0], 2 * self.at[1] - from_[1]
            if kind in "CS":
                self.curve(*([mirrored, *given] if kind == "S" else given))
            else:
                self.quadratic(mirrored if kind == "T" else given[0], given[-1])


def path(data: str, most: int) -> tuple[list[Curve], int | None]:
    """The subpaths of path data up to its first error, as browsers draw them, and the letter at
    which that is, from 0; None where there is none.

    Args:
        most: points after which reading ends.
    """
    pen, start, position, command, drawn = _Pen(), 0, 0, "", 0
    data, sound = data.strip(), True
    while position < len(data) and drawn <= most:
        start, letter = position, _LETTER.match(data, position)
        if letter:
            command, position = str(letter[1]), letter.end()
        elif command in ("", "Z", "z"):
            sound = False
            break
        else:
            command = "L" if command == "M" else "l" if command == "m" else command
        values = list[float]()
        for k in range(_TAKES[command.upper()]):
            flag = command in "Aa" and k in (3, 4)
            found = (_FLAG if flag else _NEXT).match(data, position)
            if not found or abs(float(found[1])) > LARGEST:
                break
            values.append(float(found[1]))
            position = found.end()
        sound = len(values) == _TAKES[command.upper()] and (drawn > 0 or command in "Mm")
        if not sound:
            break
        pen.draw(command, values)
        drawn += 8 if command in "Aa" else 1 + len(values) // 2
    pen.lift(False)
    return pen.made, None if sound else start


def polygon(points: list[float]) -> list[Curve]:
    """Lines from point to point."""
    corners = np.array(points[: len(points) // 2 * 2]).reshape(-1, 2)
    return [Curve(corners)] if len(corners) > 1 else []


def rectangle(x: float, y: float, wide: float, high: float, rx: float, ry: float) -> list[Curve]:
    """A rectangle with round corners."""
    rx, ry = min(rx, wide / 2), min(ry, high / 2)
    if not (rx > 0 and ry > 0):
        return polygon([x, y, x + wide, y, x + wide, y + high, x, y + high])
    pen, right, low = _Pen(), x + wide, y + high
    pen.draw("M", (x + rx, y))
    for line, end in (
        ((right - rx, y), (right, y + ry)),
        ((right, low - ry), (right - rx, low)),
        ((x + rx, low), (x, low - ry)),
        ((x, y + ry), (x + rx, y)),
    ):
        pen.draw("L", line)
        pen.draw("A", (rx, ry, 0, 0, 1, *end))
    pen.lift(True)
    return pen.made


def ellipse(cx: float, cy: float, rx: float, ry: float) -> list[Curve]:
    """An ellipse."""
    pen = _Pen()
    pen.draw("M", (cx + rx, cy))
    pen.draw("A", (rx, ry, 0, 0, 1, cx - rx, cy))
    pen.draw("A", (rx, ry, 0, 0, 1, cx + rx, cy))
    pen.lift(True)
    return pen.made
