"""The workcell around a build: where the arm stands, and what blocks come from.

World frame: that of the exact plan, whose design stands on the table (z = 0) with its middle at
x = y = 0. A *magazine* presents the next block of a kind at one pose whenever it is asked to, and
takes back what is put there; nothing stands at its pose otherwise. Blocks on *pallets* and at
single *positions* lie on the table from the beginning.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar, cast

import numpy as np

from learn2assemble.cell.pieces import (
    ON_TABLE,
    UPRIGHT,
    Piece,
    Pose,
    Turn,
    footprint,
    middle_of,
    turn_key,
    waiting,
)
from learn2assemble.cell.site_arms import SiteArm, parse_arms
from learn2assemble.errors import InputError, check_name, listed
from learn2assemble.files import read_text
from learn2assemble.plants.safety import SECTION as SAFETY
from learn2assemble.plants.safety import Safety, parse_safety
from learn2assemble.plants.settings import LAYOUT, SECTION, ProgramSettings, parse_settings
from learn2assemble.robot.bodies import Part, Shape
from learn2assemble.sensing.camera import (
    DepthCamera,
    check_names,
    checked_covariance,
    parse_camera,
)
from learn2assemble.values import (
    check_keys,
    integer,
    load_json,
    mapping,
    number,
    read_head,
    sequence,
    text,
    too_deep,
)

if TYPE_CHECKING:
    from learn2assemble.design.goals import Goals

MAX_PLACES, MAX_ENTRIES = 400, 64
MOST_LEAN = 0.2
"""A base leans by no more than this sine."""
_LISTS = ("obstacles", "magazines", "pallets", "positions", "cameras")
_KEYS = ("format", "version", "units", "base", "arms", "table", *_LISTS, SECTION, SAFETY)
TABLE = (1.5, 1.0)
"""Size along x and y of a table of which nothing is said [m]."""

T = TypeVar("T")


# ---------------------------------------------------------------- layouts


@dataclass(frozen=True)
class Magazine:
    """Presents the next block of a kind."""

    kind: str
    pose: Pose
    count: int | None = None
    """How many it holds; None: as many as needed."""


class Pallet(NamedTuple):
    """Blocks of a kind in rows."""

    kind: str
    pose: Pose
    """Of the first block; columns go on along its x, rows along its y."""
    rows: int
    columns: int
    pitch: tuple[float, float]
    """From column to column, and from row to row [m]."""

    def poses(self) -> list[Pose]:
        """Of all its blocks."""
        x, y, yaw = self.pose
        c, s = math.cos(yaw), math.sin(yaw)
        steps = [
            (i * self.pitch[0], j * self.pitch[1])
            for j in range(self.rows)
            for i in range(self.columns)
        ]
        return [Pose(x + c * u - s * v, y + s * u + c * v, yaw) for u, v in steps]


class Position(NamedTuple):
    """One block on the table."""

    kind: str | None
    """None: of the next block of the plan."""
    pose: Pose


class Obstacle(NamedTuple):
    """A box that nothing may touch."""

    centre: tuple[float, float]
    """[m]"""
    size: tuple[float, float, float]
    """[m]"""
    yaw: float = 0.0
    bottom: float = 0.0
    """Above the table [m]."""
    name: str = "obstacles"
    """What messages call it."""
    aside: int = 0
    """:data:`~learn2assemble.robot.moves.AT_THE_SIDE` or ``BASE_THERE`` where it stands for what
    another arm takes, or for that itself, which are in the cell themselves; such are the last ones
    of a job."""

    @property
    def middle(self) -> tuple[float, float, float]:
        """Its centre [m]."""
        return *self.centre, self.bottom + self.size[2] / 2


@dataclass(frozen=True)
class Site:
    """A workcell as a user describes it; what is not given is chosen."""

    base: tuple[float, float, float, float] | None = None
    """x, y, z [m] of the arm's base, and the direction it faces [rad from x]."""
    table: tuple[float, float] | None = None
    """Along x and y, its middle at the origin [m]; None: of :data:`TABLE`, its middle that of the
    structure."""
    obstacles: tuple[Obstacle, ...] = ()
    magazines: tuple[Magazine, ...] = ()
    pallets: tuple[Pallet, ...] = ()
    positions: tuple[Position, ...] = ()
    source: str = "layout"
    program: ProgramSettings = field(default_factory=ProgramSettings)
    """For the real robot, and programs of it that are exported later."""
    cameras: tuple[DepthCamera, ...] = ()
    """Where they are taken to be."""
    safety: Safety = field(default_factory=Safety)
    """What the arm may not do."""
    lean: tuple[float, float] = (0.0, 0.0)
    """Along x and y of the table, the axis of the base that should be upright, as a calibration
    found it. Builds are planned for an upright base."""
    arms: tuple[SiteArm, ...] = ()
    """Where there are several: who they are and where they stand; ``base`` then is of none."""

    @property
    def kept_out(self) -> tuple[Obstacle, ...]:
        """The boxes that the arm may not enter, as what nothing may touch."""
        found = list[Obstacle]()
        for k, (low, high) in enumerate(self.safety.keep_out):
            (u, v, _), (a, b, c) = np.add(low, high) / 2, np.subtract(high, low)
            at, name = (float(u), float(v)), f"safety.keep_out[{k}]"
            found.append(Obstacle(at, (float(a), float(b), float(c)), 0.0, low[2], name))
        return tuple(found)


def read_site(path: Path) -> Site:
    """The workcell in a layout file (``docs/layouts.md``).

    Raises:
        InputError: one line that names the file and the JSON path of the fault.
    """
    content, source = read_text(Path(path), "layout file")
    try:
        root = load_json(content, source, LAYOUT)
        return _site(root, source, Path(path).parent)
    except RecursionError:
        raise too_deep(source) from None


def _site(value: Any, source: str, folder: Path) -> Site:
    root = read_head(value, source, LAYOUT, 2, _KEYS, ("format", "version"))
    base, lean = None, (0.0, 0.0)
    if "base" in root:
        keys = ("position", "yaw", "lean", "covariance")
        given = _table(root["base"], f"{source}: base", keys, ("position",))
        x, y, z = _numbers(given["position"], f"{source}: base.position", 3)
        base = x, y, z, number(given.get("yaw", 0.0), f"{source}: base.yaw")
        a, b = _numbers(given.get("lean", (0.0, 0.0)), f"{source}: base.lean", 2)
        if max(abs(a), abs(b)) > MOST_LEAN:
            raise InputError(f"{source}: base.lean", [a, b], f"{MOST_LEAN:g} at most")
        lean = a, b
        if "covariance" in given:
            checked_covariance(given["covariance"], f"{source}: base.covariance", 6)
    table = None
    if "table" in root:
        width, depth = _numbers(root["table"], f"{source}: table", 2, positive=True)
        table = width, depth

    def every(key: str, make: Callable[[Any, str], T], most: int = MAX_ENTRIES) -> tuple[T, ...]:
        where = f"{source}: {key}"
        given = _entries(root[key], where, most) if key in root else ()
        return tuple(make(entry, f"{where}[{k}]") for k, entry in enumerate(given))

    boxes = every("obstacles", lambda entry, where: _obstacle(entry, where, folder))
    obstacles = tuple(box for found in boxes for box in found)
    if len(obstacles) > MAX_PLACES:
        raise InputError(f"{source}: obstacles", f"{len(obstacles)} boxes", f"at most {MAX_PLACES}")
    arms: tuple[SiteArm, ...] = ()
    if "arms" in root:
        if base is not None:
            raise InputError(
                f"{source}: base", list(base), "none beside arms, which have their own"
            )
        given: Any = root.get("magazines", ())
        count = len(cast("Sequence[object]", given)) if isinstance(given, Sequence) else 0
        arms = parse_arms(root["arms"], f"{source}: arms", count)
    site = Site(
        base,
        table,
        obstacles,
        every("magazines", _magazine),
        every("pallets", _pallet),
        every("positions", _position, MAX_PLACES),
        source,
        parse_settings(root.get(SECTION, {}), f"{source}: {SECTION}"),
        every("cameras", parse_camera),
        parse_safety(root.get(SAFETY, {}), f"{source}: {SAFETY}"),
        lean,
        arms,
    )
    check_names(site.cameras, f"{source}: cameras")
    blocks = len(site.positions) + sum(p.rows * p.columns for p in site.pallets)
    if blocks > MAX_PLACES:
        raise InputError(f"{source}: pallets", f"{blocks} blocks", f"at most {MAX_PLACES}")
    return site


def _obstacle(value: Any, where: str, folder: Path) -> list[Obstacle]:
    """A box, or the boxes that cover a mesh."""
    shape = "mesh" if "mesh" in mapping(value, where) else "size"
    keys = ("at", shape, "yaw", "unit") if shape == "mesh" else ("at", shape, "yaw")
    given = _table(value, where, keys, keys[:2])
    x, y = _numbers(given["at"], f"{where}.at", 2)
    yaw, name = number(given.get("yaw", 0.0), f"{where}.yaw"), where.split(": ")[-1]
    if "mesh" not in given:
        a, b, c = _numbers(given["size"], f"{where}.size", 3, positive=True)
        return [Obstacle((x, y), (a, b, c), yaw, 0.0, name)]
    unit = number(given["unit"], f"{where}.unit") if "unit" in given else None
    if unit is not None and not 0 < unit <= 100:
        raise InputError(f"{where}.unit", unit, "the length of a unit of the file in metres")
    from learn2assemble.design.solids import mesh_boxes

    boxes = mesh_boxes(folder / text(given["mesh"], f"{where}.mesh"), unit, f"{where}.mesh")
    cos, sin = math.cos(yaw), math.sin(yaw)
    found = list[Obstacle]()
    for low, high in boxes:
        (u, v, _), (a, b, c) = ((low + high) / 2).tolist(), (high - low).tolist()
        at = x + cos * u - sin * v, y + sin * u + cos * v
        found.append(Obstacle(at, (a, b, c), yaw, float(low[2]), name))
    return found


def _magazine(value: Any, where: str) -> Magazine:
    given = _table(value, where, ("kind", "at", "count"), ("kind", "at"))
    count = given.get("count")
    if count is not None and integer(count, f"{where}.count") < 0:
        raise InputError(f"{where}.count", count, "0 or more")
    return Magazine(text(given["kind"], f"{where}.kind"), _pose(given["at"], f"{where}.at"), count)


def _pallet(value: Any, where: str) -> Pallet:
    keys = ("kind", "at", "rows", "columns", "pitch")
    given = _table(value, where, keys, keys)
    rows, columns = (integer(given[key], f"{where}.{key}") for key in ("rows", "columns"))
    for key, count in (("rows", rows), ("columns", columns)):
        if not 1 <= count <= MAX_PLACES:
            raise InputError(f"{where}.{key}", count, f"1 to {MAX_PLACES}")
    u, v = _numbers(given["pitch"], f"{where}.pitch", 2, positive=True)
    kind, pose = text(given["kind"], f"{where}.kind"), _pose(given["at"], f"{where}.at")
    return Pallet(kind, pose, rows, columns, (u, v))


def _position(value: Any, where: str) -> Position:
    given = _table(value, where, ("kind", "at"), ("at",))
    kind = None if given.get("kind") is None else text(given["kind"], f"{where}.kind")
    return Position(kind, _pose(given["at"], f"{where}.at"))


def _entries(value: Any, where: str, most: int) -> Sequence[Any]:
    expected = f"a list of 1 to {most} entries"
    found = sequence(value, where, expected)
    if not 1 <= len(found) <= most:
        raise InputError(where, f"{len(found)} entries", expected)
    return found


def _table(value: Any, where: str, valid: tuple[str, ...], need: tuple[str, ...]) -> Any:
    check_keys(mapping(value, where), where, "", valid, need)
    return value


def _pose(value: Any, where: str) -> Pose:
    expected = "[x, y] in metres, or [x, y, yaw] with the yaw in radians"
    found = sequence(value, where, expected)
    if len(found) not in (2, 3):
        raise InputError(where, value, expected)
    return Pose(*(_bounded(item, where) for item in found))


def _numbers(value: Any, where: str, count: int, positive: bool = False) -> list[float]:
    expected = f"{count} {'positive ' * positive}numbers up to 100"
    found = [_bounded(item, where) for item in sequence(value, where, expected)]
    if len(found) != count or (positive and min(found) <= 0):
        raise InputError(where, value, expected)
    return found


def _bounded(value: Any, where: str) -> float:
    found = number(value, where)
    if abs(found) > 100:
        raise InputError(where, found, "at most 100 [m]")
    return found


# ---------------------------------------------------------------- what blocks come from


@dataclass(frozen=True)
class Source:
    """One pose at which blocks of a shape can be taken."""

    shape: Shape
    pose: Pose
    """Where blocks wait, see :meth:`~.pieces.Piece.waiting`."""
    left: int | None
    """How many blocks it can present; None: as many as needed."""
    magazine: bool
    """Presents blocks only when asked; else its one block lies there from the beginning."""
    name: str = "supply"
    """What messages call it."""
    rests: tuple[Turn, ...] = UPRIGHT
    """Rotations, at yaw 0, in which its blocks wait."""

    @property
    def area(self) -> Any:
        """What its blocks cover, as a shapely area."""
        import shapely

        return shapely.union_all(
            [footprint(self.shape, self.pose, np.array(rest)) for rest in self.rests]
        )

    def presents(self, piece: Piece) -> bool:
        """Whether a block may come from here."""
        return self.shape == piece.shape and turn_key(piece.rest) in self.rests

    def poses(self) -> Iterator[np.ndarray]:
        """Poses float64[7] in which its blocks wait."""
        for rest in self.rests:
            yield waiting(self.shape, self.pose, np.array(rest))


def rests_of(pieces: Sequence[Piece], shape: Shape) -> tuple[Turn, ...]:
    """Rotations in which blocks of a shape wait."""
    return tuple(sorted({turn_key(piece.rest) for piece in pieces if piece.shape == shape}))


def given_sources(
    site: Site, pieces: Sequence[Piece], order: Sequence[int], gone: Sequence[int] = ()
) -> list[Source]:
    """The sources a layout names, for the pieces of a plan in the order they are needed.

    Args:
        gone: pieces that are only taken away, to magazines.

    Raises:
        InputError: for a kind the plan does not use, places that overlap or lie off the table.
    """
    check_kinds(site, {piece.kind for piece in pieces})
    shapes: dict[str, list[Shape]] = {}
    for k in (*order, *gone):
        known = shapes.setdefault(pieces[k].kind, [])
        if pieces[k].shape not in known:
            known.append(pieces[k].shape)
    found: list[tuple[str, Source]] = []
    for n, magazine in enumerate(site.magazines):
        for shape in shapes.get(magazine.kind, []):
            where = f"{site.source}: magazines[{n}]"
            rests = rests_of(pieces, shape)
            source = Source(shape, magazine.pose, magazine.count, True, where, rests)
            found.append((where, source))
    lying = [
        (f"{site.source}: pallets[{n}]", p.kind, pose)
        for n, p in enumerate(site.pallets)
        for pose in p.poses()
    ]
    lying += [
        (f"{site.source}: positions[{n}]", p.kind, p.pose) for n, p in enumerate(site.positions)
    ]
    waiting = [k for k in order if pieces[k].shape not in {source.shape for _, source in found}]
    for where, kind, pose in lying:
        fits = (k for k in waiting if kind is None or pieces[k].kind == kind)
        k = next(fits, None)
        if k is not None:  # More places than blocks are left empty.
            waiting.remove(k)
            rests = (turn_key(pieces[k].rest),)
            found.append((where, Source(pieces[k].shape, pose, 1, False, where, rests)))
    check_sources(site, found, pieces)
    return [source for _, source in found]


def check_kinds(site: Site, kinds: set[str]) -> None:
    """Refuse a kind that is none of the plan's: the arm would be sent to an empty place, or a
    magazine be chosen where the user has meant another.

    Raises:
        UnknownNameError: naming the entry of the layout and the nearest kind.
    """
    for name in ("magazines", "pallets", "positions"):
        for n, entry in enumerate(getattr(site, name)):
            if entry.kind is not None:
                check_name(f"{site.source}: {name}[{n}].kind", entry.kind, kinds)


def table_of(site: Site, pieces: Sequence[Piece]) -> Any:
    """The table as a shapely polygon, seen from above: where no layout has one, about the
    structure."""
    at = np.zeros(2) if site.table is not None else middle_of(pieces)
    return _table_about(at, site)


def _table_about(at: np.ndarray, site: Site) -> Any:
    """The table as a shapely polygon with its middle at float64[2] [m]."""
    import shapely

    library: Any = shapely
    half = np.array(site.table or TABLE) / 2
    return library.box(*(at - half), *(at + half))


def check_sources(site: Site, found: list[tuple[str, Source]], pieces: Sequence[Piece]) -> None:
    """Refuse sources off the table, or where something else is, and blocks off a table that is
    given.

    Raises:
        InputError: naming the entry of the layout.
    """
    import shapely

    # Of a table of which nothing is said, who says where blocks wait may think of either place.
    table = table_of(site, pieces).union(_table_about(np.zeros(2), site))
    low = [p for p in pieces if p.extent[0][2] < ON_TABLE and not p.sunk]
    structure = shapely.union_all([p.face() for p in low])
    width, depth = site.table or TABLE
    if site.table is not None:
        ground = shapely.union_all([table, *(p.face() for p in pieces if p.sunk)]).buffer(ON_TABLE)
        off = [p.id for p in low if not ground.contains(p.foot())]
        if off:
            expected = f"all that stands on it inside, {width:g} x {depth:g} m about the origin"
            raise InputError(f"{site.source}: table", f"{listed(off)} not on it", expected)
    blocked = [(o.name, outline(o)) for o in site.obstacles]
    for k, (what, area) in enumerate(blocked):
        if area.intersection(structure).area > 1e-9:
            at = list(site.obstacles[k].centre)
            raise InputError(f"{site.source}: {what}", at, "a place outside the building site")
    for where, source in found:
        face, at = source.area, [round(v, 4) for v in source.pose]
        if not table.contains(face):
            raise InputError(where, at, f"a place on the table ({width:g} x {depth:g} m)")
        if face.intersection(structure).area > 1e-9:
            raise InputError(where, at, "a place outside the building site")
        name = where.split(": ")[-1]  # A magazine presents blocks of several shapes.
        for what, area in blocked:
            if (what != name or not source.magazine) and face.intersection(area).area > 1e-9:
                raise InputError(where, at, f"a place that does not overlap {what}")
        blocked.append((name, face))


def outline(obstacle: Obstacle) -> Any:
    """What an obstacle covers, as a shapely area."""
    a, b, c = obstacle.size
    part = Part((0.0, 0.0, 0.0), (a / 2, b / 2, c / 2))
    return footprint((part,), Pose(*obstacle.centre, obstacle.yaw), np.eye(3))


def with_obstacles(site: Site, goals: Goals) -> Site:
    """A workcell with the obstacles of some goals, each from the table up, for nothing is built
    below them."""
    found = list[Obstacle]()
    for low, high in goals.obstacles:
        size = high[0] - low[0], high[1] - low[1], high[2]
        found.append(Obstacle(((low[0] + high[0]) / 2, (low[1] + high[1]) / 2), size))
    return replace(site, obstacles=(*site.obstacles, *found))
