"""Random designs with known solutions, in families, some of them never trained on.

A family draws cells; a design counts where the exact planner's blocks for it stand in some order
without props. For a kit that cannot carry an overhang (cubes), what nothing carries is left out of
the drawing first.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from learn2assemble.assembly.kit import Kit, load_kit, parts_of
from learn2assemble.errors import InputError, UnknownNameError
from learn2assemble.planning.tiling.cover.tile import MAX_EXTENT, tile
from learn2assemble.planning.tiling.world import LatticeSite, LatticeWorld, make_site
from learn2assemble.tasks.task import DesignTask

Cells = np.ndarray
"""bool[X, Y, Z]."""
Family = Callable[[np.random.Generator, float], Cells]
"""Draws cells; the number says how large: roughly the edge of the drawing in cells."""


# ---------------------------------------------------------------- families


def _span(rng: np.random.Generator, size: float, low: float, high: float, least: int = 1) -> int:
    """A length of ``low`` to ``high`` times ``size``, at least ``least`` cells."""
    return max(least, round(size * rng.uniform(low, high)))


def _thick(rng: np.random.Generator) -> int:
    return int(rng.choice([1, 2, 3], p=[0.6, 0.3, 0.1]))


def _extruded(picture: np.ndarray, thick: int) -> Cells:
    """bool[X, Z] as a wall."""
    return np.repeat(picture[:, None, :], thick, 1)


def _wall(rng: np.random.Generator, size: float) -> Cells:
    """A wall with openings: windows and doors in a row, or battlements."""
    wide, high = _span(rng, size, 0.8, 1.8, 4), _span(rng, size, 0.5, 1.0, 3)
    picture = np.ones((wide, high), bool)
    x = int(rng.integers(1, 4))
    while x < wide - 2:
        opening = int(rng.integers(1, 5))
        low = 0 if rng.random() < 0.3 else int(rng.integers(1, max(2, high - 2)))
        top = min(high - 1, low + int(rng.integers(1, 6)))
        if rng.random() < 0.2:
            low, top = high - int(rng.integers(1, 3)), high
        if x + opening < wide - 1:
            picture[x : x + opening, low:top] = False
        x += opening + int(rng.integers(2, 6))
    return _extruded(picture, _thick(rng))


def _stairs(rng: np.random.Generator, size: float) -> Cells:
    """Stairs up, or up and down again, on solid ground."""
    tread, rise = int(rng.integers(1, 4)), int(rng.integers(1, 3))
    steps = max(2, round(size * rng.uniform(0.6, 1.2) / tread))
    heights = [rise * (k + 1) for k in range(steps) for _ in range(tread)]
    if rng.random() < 0.4:
        heights += [heights[-1]] * int(rng.integers(0, 4)) + heights[::-1]
    if rng.random() < 0.5:
        heights = heights[::-1]
    z = np.arange(max(heights))
    return _extruded(z[None, :] < np.array(heights)[:, None], _thick(rng))


def _bridge(rng: np.random.Generator, size: float) -> Cells:
    """A deck on piers."""
    spans = int(rng.integers(1, 2 + int(size // 8)))
    gap, pier = int(rng.integers(2, 7)), int(rng.integers(1, 4))
    high, deck = _span(rng, size, 0.2, 0.6, 1), int(rng.integers(1, 4))
    picture = np.zeros((spans * (gap + pier) + pier, high + deck), bool)
    picture[:, high:] = True
    for k in range(spans + 1):
        picture[k * (gap + pier) : k * (gap + pier) + pier] = True
    return _extruded(picture, _thick(rng))


def _stepped_arch(rng: np.random.Generator, size: float) -> Cells:
    """A wall whose opening steps inwards."""
    span, side = _span(rng, size, 0.2, 0.6, 2), _span(rng, size, 0.2, 0.4, 2)
    base, rise, top = int(rng.integers(0, 5)), int(rng.integers(1, 3)), int(rng.integers(1, 4))
    levels = -(-span // 2) * rise
    picture = np.ones((span + 2 * side, base + levels + top), bool)
    picture[side : side + span, :base] = False
    for k in range(levels):
        inset = k // rise + 1 if rng.random() < 0.9 else k // rise
        picture[side + inset : side + span - inset, base + k] = False
    return _extruded(picture, _thick(rng))


def _gable(rng: np.random.Generator, size: float) -> Cells:
    """The front of a house, or a house of four walls with two gables."""
    wide, eaves = _span(rng, size, 0.5, 1.0, 4), _span(rng, size, 0.3, 0.7, 2)
    rise = (wide + 1) // 2
    front = np.zeros((wide, eaves + rise), bool)
    front[:, :eaves] = True
    for k in range(rise):
        front[k : wide - k, eaves + k] = True
    door = int(rng.integers(1, 4))
    at, high = int(rng.integers(1, max(2, wide - door))), int(rng.integers(1, max(2, eaves)))
    opened = front.copy()
    opened[at : min(at + door, wide - 1), :high] = False
    if rng.random() < 0.5:
        return _extruded(opened, _thick(rng))
    deep = _span(rng, size, 0.4, 1.0, 3)
    cells = np.zeros((wide, deep, eaves + rise), bool)
    cells[:, 0], cells[:, -1] = opened, front
    cells[0, :, :eaves] = cells[-1, :, :eaves] = True
    return cells


def _court(rng: np.random.Generator, size: float) -> Cells:
    """Two, three or four walls around a court, each with an opening or none."""
    wide, deep = _span(rng, size, 0.5, 1.1, 4), _span(rng, size, 0.5, 1.1, 4)
    high, thick = _span(rng, size, 0.3, 0.8, 2), int(rng.integers(1, 3))
    cells = np.zeros((wide, deep, high), bool)
    walls = rng.permutation(4)[: int(rng.integers(2, 5))]
    for side in walls:
        along = cells[:, :thick] if side == 0 else cells[:, -thick:]
        if side > 1:
            along = (cells[:thick] if side == 2 else cells[-thick:]).swapaxes(0, 1)
        along[:] = True
        opening = int(rng.integers(0, 4))
        length: int = along.shape[0]
        if opening and length > opening + 2 * thick + 2:
            x = int(rng.integers(thick + 1, length - opening - thick))
            low = int(rng.integers(0, high))
            along[x : x + opening, :, low : low + int(rng.integers(1, 5))] = False
    return cells


def _union(rng: np.random.Generator, size: float) -> Cells:
    """Boxes that stand on the table or on one another."""
    x, y = _span(rng, size, 0.5, 1.0, 3), _span(rng, size, 0.2, 0.7, 1)
    cells = np.zeros((x, y, _span(rng, size, 0.5, 1.0, 3)), bool)
    for _ in range(int(rng.integers(2, 7))):
        a, b = int(rng.integers(0, x)), int(rng.integers(0, y))
        w, d, h = (_span(rng, size, 0.1, 0.5) for _ in range(3))
        foot = cells[a : a + w, b : b + d]
        top = np.flatnonzero(foot.any((0, 1)))
        z = int(top[-1]) + 1 if len(top) and rng.random() < 0.7 else 0
        foot[:, :, z : z + h] = True
    return cells


def _ziggurat(rng: np.random.Generator, size: float) -> Cells:
    """Solid, in storeys that step back, not always in the middle."""
    x, y = _span(rng, size, 0.4, 0.9, 3), _span(rng, size, 0.3, 0.8, 2)
    storey, levels = int(rng.integers(1, 4)), list[np.ndarray]()
    low, high = np.zeros(2, int), np.array([x, y])
    while (high - low).min() >= 1 and len(levels) < size:
        floor = np.zeros((x, y), bool)
        floor[low[0] : high[0], low[1] : high[1]] = True
        levels += [floor] * storey
        low, high = low + rng.integers(0, 2, 2), high - rng.integers(0, 2, 2)
    return np.stack(levels[: max(2, round(size))], 2)


_SEGMENTS = {
    **{"A": "abcefg", "C": "adef", "E": "adefg", "F": "aefg", "G": "acdef", "H": "bcefg"},
    **{"I": "adil", "J": "bcde", "L": "def", "O": "abcdef", "P": "abefg", "S": "acdfg"},
    **{"T": "ail", "U": "bcdef", "Y": "bfgl", "1": "il", "2": "abdeg", "3": "abcdg", "4": "bcfg"},
    **{"6": "acdefg", "7": "abc", "8": "abcdefg", "9": "abcdfg"},
}
"""Strokes of letters and digits: a top, g middle, d bottom; f, e left, b, c right, i, l centre,
the first of each pair above."""


def draw_letter(name: str, wide: int, low: int, high: int, stroke: int) -> np.ndarray:
    """bool[X, Z] of a letter.

    Args:
        low, high: heights between the strokes.
        stroke: how thick they are.
    """
    if name not in _SEGMENTS:
        raise UnknownNameError("letter", name, _SEGMENTS)
    total, middle = 3 * stroke + low + high, (wide - stroke) // 2
    picture = np.zeros((wide, total), bool)
    below, above = slice(0, 2 * stroke + low), slice(stroke + low, total)
    columns = {"f": 0, "e": 0, "b": wide - stroke, "c": wide - stroke, "i": middle, "l": middle}
    rows = {"d": 0, "g": stroke + low, "a": total - stroke}
    for segment in _SEGMENTS[name]:
        if segment in rows:
            picture[:, rows[segment] : rows[segment] + stroke] = True
        else:
            x = columns[segment]
            picture[x : x + stroke, above if segment in "fbi" else below] = True
    return picture


def _letters(rng: np.random.Generator, size: float) -> Cells:
    """One to three letters or digits beside each other."""
    stroke = 1 if size < 10 or rng.random() < 0.5 else 2
    low, high = (_span(rng, size, 0.15, 0.4, 1) for _ in range(2))
    parts = list[np.ndarray]()
    for name in rng.choice(list(_SEGMENTS), int(rng.integers(1, 4))):
        wide = max(_span(rng, size, 0.3, 0.6, 3), 2 * stroke + 1)
        parts += [draw_letter(str(name), wide, low, high, stroke), np.zeros((2, 1), bool)]
    height = max(part.shape[1] for part in parts)
    picture = np.concatenate([np.pad(p, ((0, 0), (0, height - p.shape[1]))) for p in parts[:-1]])
    return _extruded(picture, _thick(rng))


def _round_arch(rng: np.random.Generator, size: float) -> Cells:
    """A wall, or only a band, with a round opening."""
    radius = size * rng.uniform(0.15, 0.35) + 1
    side, base, top = (int(v) for v in rng.integers([2, 0, 1], [6, 5, 4]))
    half = int(np.ceil(radius)) + side
    x = np.arange(2 * half) + 0.5 - half
    z = np.arange(base + int(np.ceil(radius)) + top) + 0.5 - base
    inside = (np.abs(x)[:, None] < radius) & (
        (z < 0)[None, :] | (np.hypot(x[:, None], z[None, :]) < radius)
    )
    picture = ~inside
    if rng.random() < 0.3:
        picture &= np.hypot(x[:, None], np.maximum(z, 0)[None, :]) < radius + side
    return _extruded(picture, _thick(rng))


def _towers(rng: np.random.Generator, size: float) -> Cells:
    """One tower beside the middle of its base, or several, hollow or solid."""
    count = int(rng.integers(1, 4))
    parts = list[np.ndarray]()
    for _ in range(count):
        wide, deep = int(rng.integers(1, 5)), int(rng.integers(1, 4))
        part = np.ones((wide, deep, _span(rng, size, 0.5, 1.4, 3)), bool)
        if wide > 3 and deep > 2 and rng.random() < 0.5:
            part[1:-1, 1:-1] = False
        parts += [part, np.zeros((int(rng.integers(1, 6)), 1, 1), bool)]
    parts = parts[:-1]
    shape = np.array([part.shape for part in parts]).max(0)
    cells = np.concatenate(
        [np.pad(p, [(0, 0), (0, shape[1] - p.shape[1]), (0, shape[2] - p.shape[2])]) for p in parts]
    )
    if rng.random() < 0.4:
        # A base that they share, or a link half way up.
        z = 0 if rng.random() < 0.5 else int(rng.integers(1, max(2, shape[2] // 2)))
        cells[:, 0, z] = True
    before, after = (int(v) for v in rng.integers(0, 6, 2))
    return np.pad(cells, ((before, after), (0, 0), (0, 0)))


def _rings(rng: np.random.Generator, size: float) -> Cells:
    """A standing disc or ring, or a round wall."""
    radius = size * rng.uniform(0.3, 0.6) + 1
    n = round(2 * radius)
    c = np.arange(n) + 0.5 - n / 2
    distance = np.hypot(c[:, None], c[None, :])
    hole = rng.choice([0.0, rng.uniform(0.2, 0.6)]) * radius
    ring = (distance < n / 2) & (distance >= hole)
    if rng.random() < 0.5:
        return _extruded(ring, _thick(rng))
    wall = (distance < n / 2) & (distance > n / 2 - rng.uniform(1.2, 2.6))
    return np.repeat(wall[:, :, None], _span(rng, size, 0.2, 0.7, 2), 2)


def _figures(rng: np.random.Generator, size: float) -> Cells:
    """A random pixel figure, the same left and right."""
    half, high = _span(rng, size, 0.2, 0.45, 2), _span(rng, size, 0.4, 1.0, 3)
    # Half the resolution, doubled: solid limbs instead of noise.
    noise = rng.random((half // 2 + 1, high // 2 + 1))
    coarse = noise < rng.uniform(0.55, 0.8)
    coarse[0] = True
    picture = np.repeat(np.repeat(coarse, 2, 0), 2, 1)[:half, :high]
    picture = np.concatenate([picture[::-1], picture[int(rng.integers(0, 2)) :]])
    return _extruded(picture, _thick(rng))


FAMILIES: dict[str, Family] = {
    "walls": _wall,
    "stairs": _stairs,
    "bridges": _bridge,
    "stepped-arches": _stepped_arch,
    "gables": _gable,
    "courts": _court,
    "unions": _union,
    "ziggurats": _ziggurat,
    "letters": _letters,
    "round-arches": _round_arch,
    "towers": _towers,
    "rings": _rings,
    "figures": _figures,
}
_TRIES, _DRAWINGS = 100, 12
"""Families and sizes that are tried, and drawings of each."""
HELD_OUT = ("letters", "round-arches", "towers", "rings", "figures")
"""Families no agent is trained on."""
TRAINED = tuple(name for name in FAMILIES if name not in HELD_OUT)


# ---------------------------------------------------------------- designs with solutions


@dataclass(frozen=True, eq=False)
class Solved:
    """A design and one way to build it."""

    family: str
    site: LatticeSite
    order: tuple[int, ...]
    """Candidates of the site in an order in which every state is proven."""

    @property
    def kit(self) -> Kit:
        """The kit, with its heap."""
        return self.site.kit


def draw(family: str, rng: np.random.Generator, size: float, carried: bool) -> Cells | None:
    """Cells of a family, turned at random and grounded; None for an empty drawing.

    Args:
        size: roughly the edge of the drawing [cells].
        carried: keep only what is filled all the way down.
    """
    if family not in FAMILIES:
        raise UnknownNameError("family", family, FAMILIES)
    cells = FAMILIES[family](rng, size)
    if not cells.any():
        return None
    cells = cells[:, :, int(np.flatnonzero(cells.any((0, 1)))[0]) :]
    if rng.random() < 0.5:
        cells = cells.swapaxes(0, 1)
    cells = grounded(cells)
    if carried:
        cells = np.logical_and.accumulate(cells, 2)
    used = [np.flatnonzero(cells.any(tuple(a for a in range(3) if a != k))) for k in range(3)]
    cells = cells[:, :, : used[2][-1] + 1]
    return np.ascontiguousarray(cells) if max(cells.shape) <= MAX_EXTENT else None


def grounded(cells: Cells) -> Cells:
    """What hangs together by faces with the lowest level."""
    return np.any([part for part in parts_of(cells) if part[:, :, 0].any()], 0)


def solve(wanted: Cells, kit: Kit, seconds: float = 60.0) -> tuple[LatticeSite, list[int]] | None:
    """Exact blocks of a design and an order without props; None where there is none.

    As the exact planner does it, without margins and ranges of joints, and without other blocks
    where those of its first choice fall.
    """
    site = make_site(wanted, kit)
    world = LatticeWorld(site)
    if len(world.stranded()):
        return None
    tiling = tile(wanted, kit, seconds=seconds)
    blocks = site.candidates(tiling.placements)
    if tiling.status != "complete" or (blocks < 0).any():
        return None
    order = put_in_order(world, blocks.tolist())
    return None if order is None else (site, order)


def put_in_order(world: LatticeWorld, candidates: list[int]) -> list[int] | None:
    """An order in which candidates can be placed, every state proven; None where none is found.

    Each comes as soon as what is below it is there and the local proof holds; where that holds for
    none of them, the first for which the linear program does.

    Args:
        world: is changed.
    """
    order = world.lay(candidates)
    while len(order) < len(candidates):
        there = set(order)
        left = [candidate for candidate in candidates if candidate not in there]
        for candidate in left:
            if world.waits[candidate] == 0 and world.place(candidate, program=True):
                order.append(candidate)
                left.remove(candidate)
                break
        else:
            return None
        order += world.lay(left)
    return order


def with_exact_heap(solved: Solved) -> Solved:
    """The same design with a heap of exactly the blocks of its solution."""
    used = Counter[int](solved.site.kind[list(solved.order)].tolist())
    kinds = tuple(replace(kind, count=used[number]) for number, kind in enumerate(solved.kit.kinds))
    # Limits only say how many: the candidates stay the same.
    site = make_site(solved.site.wanted, replace(solved.kit, kinds=kinds))
    return replace(solved, site=site)


def make_design(task: DesignTask, rng: np.random.Generator) -> Solved:
    """A random design of a task with its solution: family and number of blocks are uniform.

    Raises:
        InputError: where the task asks for what its families and kit do not give.
    """
    families = TRAINED if task.families == ("train",) else task.families
    families = HELD_OUT if task.families == ("held-out",) else families
    kit = load_kit(task.kit)
    carried = max(len(kind.cells) for kind in kit.kinds) == 1
    low, high = task.blocks

    def fits(blocks: int, goal: float) -> bool:
        return low <= blocks <= high and 0.7 < blocks / goal < 1.4

    for _ in range(_TRIES):
        family, goal = str(rng.choice(families)), float(rng.uniform(low, high))
        size = (goal * (1.3 if carried else 5.0)) ** 0.5
        for _ in range(_DRAWINGS):
            wanted = draw(family, rng, min(size, 0.7 * task.extent), carried)
            if wanted is None or max(wanted.shape) > task.extent:
                continue
            cells = int(wanted.sum())
            if not max(low, goal) / 1.6 <= cells <= 12 * goal:
                size *= 1.1 if cells < goal else 0.9
                continue
            blocks = cells
            # What is carried all the way down stands, of as many cubes as cells.
            if not carried or fits(blocks, goal):
                solved = solve(wanted, kit)
                if solved is None:
                    continue
                site, order = solved
                blocks = len(order)
                if fits(blocks, goal):
                    found = Solved(family, site, tuple(order))
                    return with_exact_heap(found) if task.limited_heap else found
            size *= np.clip((goal / blocks) ** 0.4, 0.7, 1.4)
    raise InputError(
        "design task", task.name, f"families that give designs of {low} to {high} blocks"
    )
