"""Goals in families, drawn at random, and fixed ones to be measured on.

A family draws a goals file of a lattice of 5 cm cells, planar (one cell deep) or spatial. The fixed
tasks are families and seeds.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from learn2assemble.design.goals import FORMAT, VERSION, Goals, parse_goals
from learn2assemble.errors import look_up

EDGE, CLEAR = 0.05, 0.003
"""Of a cell, and how far obstacles stay inside theirs, so that an arm passes them [m]."""
Json = dict[str, Any]


class _Draft:
    """A goals file in the making; places are cells."""

    def __init__(self, rng: np.random.Generator, x: int, y: int, z: int) -> None:
        self.rng, self.shape = rng, (x, y, z)
        self.file: Json = {
            "format": FORMAT,
            "version": VERSION,
            "site": [round(EDGE * n, 6) for n in (x, y, z)],
            "kit": "bricks-lintels",
            "occupy": [],
            "reach": [],
            "load": [],
            "obstacles": [],
        }

    def point(self, x: float, y: float, z: float) -> list[float]:
        """Of a cell's middle, with the height of its top."""
        a, b, _ = self.shape
        return [round(EDGE * v, 6) for v in (x + 0.5 - a / 2, y + 0.5 - b / 2, z + 1)]

    def reach(self, x: int, y: int, z: int, mass: float = 0.0) -> None:
        """The top of a cell, with a load."""
        if mass:
            self.file["load"].append({"at": self.point(x, y, z), "mass": round(mass, 2)})
        else:
            self.file["reach"].append(self.point(x, y, z))

    def occupy(self, low: tuple[int, int, int], high: tuple[int, int, int]) -> None:
        """The cells from ``low`` up to and without ``high``."""
        self.file["occupy"].append({"box": self._box(low, high, 0.001)})

    def block(self, low: tuple[int, int, int], high: tuple[int, int, int]) -> None:
        """An obstacle in the cells from ``low`` up to and without ``high``."""
        self.file["obstacles"].append(self._box(low, high, CLEAR))

    def _box(self, low: tuple[int, ...], high: tuple[int, ...], inset: float) -> list[list[float]]:
        corner = np.array([self.shape[0] / 2, self.shape[1] / 2, 0.0])
        ends = (np.array(low) - corner) * EDGE + inset, (np.array(high) - corner) * EDGE - inset
        return [[round(float(v), 6) for v in end] for end in ends]

    def heap(self, **counts: int) -> None:
        """Kinds such as ``b4=3``: three 1x4; ``w4``: 2x4."""
        self.file["heap"] = {f"{'2' if k[0] == 'w' else '1'}x{k[1:]}": n for k, n in counts.items()}

    def pick(self, low: int, high: int) -> int:
        """A whole number from ``low`` to ``high``."""
        return int(self.rng.integers(low, high + 1))


Family = Callable[[_Draft, bool], None]


def _bridge(d: _Draft, deep: bool) -> None:
    """Both banks and the middle of a gap, which may carry a load."""
    x, y, _ = d.shape
    gap, high = d.pick(3, 6), d.pick(2, 3)
    left, row = (x - gap) // 2, y // 2
    d.block((left, 0, 0), (left + gap, y, d.pick(1, high - 1)))
    d.reach(left - d.pick(1, 2), row, high)
    d.reach(left + gap // 2, row, high, d.pick(0, 1) * d.rng.uniform(0.2, 0.6))
    d.reach(left + gap - 1 + d.pick(1, 2), row if not deep else d.pick(0, y - 1), high)
    if d.rng.random() < 0.7:
        d.heap(b1=6, b2=6, b4=5, b3=d.pick(1, 4), b5=d.pick(0, 2), b6=1)


def _corbel(d: _Draft, deep: bool) -> None:
    """A point beyond the only ground there is."""
    x, y, _ = d.shape
    edge, high = x // 2 - d.pick(0, 1), d.pick(2, 4)
    beyond = edge + d.pick(2, 4)
    d.block((edge, 0, 0), (x, y, d.pick(1, high - 1)))
    d.occupy((beyond, y // 2, high), (beyond + 1, y // 2 + 1, high + 1))
    if d.rng.random() < 0.7:
        d.heap(b1=4, b2=4, b4=5, b6=2)


def _tower(d: _Draft, deep: bool) -> None:
    """A high point, and perhaps another, above obstacles that stand in the way."""
    x, y, z = d.shape
    at, row, high = d.pick(3, x - 4), d.pick(1, y - 2) if deep else 0, z - 2 - d.pick(0, 1)
    wide, tall = d.pick(1, 4), d.pick(1, 3)
    low = max(at - d.pick(0, wide - 1), 0)
    rows = (max(row - 1, 0), min(row + 2, y)) if deep else (0, 1)
    d.block((low, rows[0], 0), (low + wide, rows[1], tall))
    d.reach(at, row, high, d.pick(0, 1) * d.rng.uniform(0.2, 1.0))
    if d.rng.random() < 0.4:
        d.reach(at + (3 if at < x // 2 else -3), row, high - d.pick(0, 1))
    if d.rng.random() < 0.7:
        d.heap(b1=3, b2=5, b3=3, b4=3, b5=2)


def _cantilever(d: _Draft, deep: bool) -> None:
    """A load beyond the ground, near it."""
    x, y, _ = d.shape
    edge, high = x // 2 + d.pick(-1, 1), d.pick(1, 3)
    d.block((edge, 0, 0), (x, y, d.pick(1, high)))
    d.reach(edge + d.pick(1, 3), y // 2, high, d.rng.uniform(0.2, 0.9))
    if d.rng.random() < 0.7:
        d.heap(b1=2, b2=3, b4=3, b6=2, b8=1)


def _table(d: _Draft, deep: bool) -> None:
    """Loads at one height, far apart, with something under the table."""
    x, y, _ = d.shape
    high, width = d.pick(1, 3), d.pick(4, 7)
    left = (x - width) // 2
    d.block((left + 1, 0, 0), (left + width - 1, y - (1 if deep else 0), 1))
    rows = (1, y - 2) if deep else (0, 0)
    d.reach(left, rows[0], high, d.rng.uniform(0.2, 1.0))
    d.reach(left + width - 1, rows[1], high, d.rng.uniform(0.2, 1.0))
    if d.rng.random() < 0.6:
        d.reach(left + width // 2, rows[0], high)
    if d.rng.random() < 0.7:
        d.heap(b1=5, b2=5, b4=4, b3=2, b6=d.pick(0, 1), b8=d.pick(0, 1))


def _joined(d: _Draft, deep: bool) -> None:
    """Two points, the beam between them, and a point above it."""
    x, y, _ = d.shape
    high, width = d.pick(2, 4), d.pick(4, 6)
    left, row = (x - width) // 2, y // 2
    d.occupy((left, row, high), (left + width, row + 1, high + 1))
    d.block((left + 1, 0, 0), (left + width - 1, y - 1 if deep else 1, d.pick(1, high - 1)))
    d.reach(left + d.pick(0, width - 1), row, high + d.pick(1, 2))
    if d.rng.random() < 0.7:
        d.heap(b1=4, b2=5, b4=4, b3=3)


def _stairs(d: _Draft, deep: bool) -> None:
    """Points that rise one level each."""
    x, y, _ = d.shape
    steps, run = d.pick(3, 5), d.pick(2, 3) if not deep else d.pick(1, 2)
    at = max((x - steps * run) // 2, 0)
    for k in range(steps):
        d.reach(min(at + k * run, x - 1), min(k, y - 1) if deep else 0, k)
    if d.rng.random() < 0.5:
        spot = min(at + (steps - 1) * run + 1, x - 2)
        d.block((spot, 0, 0), (spot + 1, y, 1))
    if d.rng.random() < 0.7:
        d.heap(b1=5, b2=4, b3=3, b4=3, b5=1)


def _arch(d: _Draft, deep: bool) -> None:
    """A point over the middle of an obstacle, with short blocks only."""
    x, y, _ = d.shape
    wide, tall = d.pick(2, 4), d.pick(1, 3)
    left, row = (x - wide) // 2, y // 2
    d.block((left, max(row - 2, 0), 0), (left + wide, min(row + 3, y), tall))
    d.reach(left + wide // 2, row, tall + d.pick(2, 3), d.pick(0, 1) * d.rng.uniform(0.2, 0.6))
    d.heap(b1=8, b2=8, b3=8, b4=d.pick(0, 6))


FAMILIES: dict[str, Family] = {
    "bridge": _bridge,
    "corbel": _corbel,
    "tower": _tower,
    "cantilever": _cantilever,
    "table": _table,
    "joined": _joined,
    "stairs": _stairs,
    "arch": _arch,
}
PLANAR, SPATIAL = "planar", "spatial"


def draw(family: str, seed: int, spatial: bool = False) -> Json:
    """The goals file of a family and a seed."""
    make = look_up("family", family, FAMILIES)
    rng = np.random.default_rng([seed, spatial, *family.encode()])
    draft = _new_draft(rng, spatial)
    make(draft, spatial)
    kind = SPATIAL if spatial else PLANAR
    return {**draft.file, "name": f"{family} {kind} {seed}"}


def _new_draft(rng: np.random.Generator, spatial: bool) -> _Draft:
    return _Draft(rng, *((10, 5, 6) if spatial else (14, 1, 8)))


# ---------------------------------------------------------------- fixed tasks

_Seeds = dict[str, dict[str, tuple[int, ...]]]
FIRST_FIXED_SEED = 20_000
"""The fixed tasks have seeds from here on; nothing was chosen or tuned on any of them."""
_SEEDS: _Seeds = {
    PLANAR: {
        "bridge": (20000, 20001, 20002, 20003),
        "corbel": (20001, 20002, 20003, 20005),
        "tower": (20000, 20001, 20002, 20003),
        "cantilever": (20000, 20001, 20003, 20004),
        "table": (20000, 20001, 20002, 20003),
        "joined": (20000, 20001, 20002),
        "stairs": (20001, 20002, 20004),
        "arch": (20000, 20001, 20002, 20003),
    },
    SPATIAL: {
        "bridge": (20000, 20001, 20002),
        "corbel": (20001, 20002),
        "tower": (20000, 20001, 20002),
        "cantilever": (20001, 20003),
        "table": (20000, 20001, 20002),
        "joined": (20000, 20001),
        "stairs": (20000, 20001),
        "arch": (20001, 20002, 20003),
    },
}
"""Of every family the first seeds. A seed is left out only where its goals contradict one another,
are proven impossible (by a bound or by the exact program), or are those of another task."""
_DEVELOPED: _Seeds = {
    family: {name: tuple(range(count)) for name, count in zip(_SEEDS[family], counts, strict=True)}
    for family, counts in ((PLANAR, (4, 4, 4, 4, 4, 3, 3, 4)), (SPATIAL, (3, 2, 3, 2, 3, 2, 2, 3)))
}
"""The search was tuned on these; the first seeds whose goals the plain search had met."""
IMPOSSIBLE = "impossible"


def _short_heap(d: _Draft) -> None:
    """The heap spans no such gap: its blocks reach one cell beyond the ground a level."""
    d.block((3, 0, 0), (11, 1, 1))
    d.reach(7, 0, 2)
    d.heap(b1=20, b2=20, b3=20)


def _walled(d: _Draft) -> None:
    """The goal is in a shaft of obstacles that is closed below it."""
    d.block((5, 0, 0), (6, 1, 6))
    d.block((6, 0, 0), (7, 1, 2))
    d.block((7, 0, 0), (8, 1, 6))
    d.reach(6, 0, 4)


def _low_heap(d: _Draft) -> None:
    """All blocks on one another are lower than the goal."""
    d.reach(6, 0, 6)
    d.heap(b4=3, b6=2)


def _heavy(d: _Draft) -> None:
    """The heap does not weigh enough to hold the load."""
    d.block((5, 0, 0), (10, 5, 1))
    d.reach(7, 2, 1, 40.0)
    d.heap(b2=4, b4=4, b8=3)


def _far(d: _Draft) -> None:
    """Cubes reach nowhere beyond the ground."""
    d.block((4, 0, 0), (10, 5, 2))
    d.reach(6, 2, 4)
    d.heap(b1=60)


_CANNOT = {
    "short heap": (_short_heap, False),
    "walled": (_walled, False),
    "low heap": (_low_heap, False),
    "heavy load": (_heavy, True),
    "cubes": (_far, True),
}


def fixed_names(*, development: bool = False) -> list[str]:
    """Names of the fixed tasks, such as ``planar/bridge/20000``; the impossible ones last.

    Args:
        development: those the search was tuned on instead, which are no measure of it.
    """
    names = [
        f"{kind}/{family}/{seed}"
        for kind, families in (_DEVELOPED if development else _SEEDS).items()
        for family, seeds in families.items()
        for seed in seeds
    ]
    return names if development else names + [f"{IMPOSSIBLE}/{name}" for name in _CANNOT]


def fixed_file(name: str) -> Json:
    """The goals file of a fixed task, or of one of development."""
    look_up("goals", name, dict.fromkeys(fixed_names() + fixed_names(development=True)))
    kind, family, *seed = name.split("/")
    if kind != IMPOSSIBLE:
        return {**draw(family, int(seed[0]), kind == SPATIAL), "name": name}
    make, spatial = _CANNOT[family]
    draft = _new_draft(np.random.default_rng(0), spatial)
    make(draft)
    return {**draft.file, "name": name}


def fixed_goals(name: str) -> Goals:
    """The goals of a fixed task, or of one of development."""
    return parse_goals(fixed_file(name), name)
