"""Shapes as people draw them, as cells: walls, houses, towers, stairs, bridges, arches, domes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from learn2assemble.tasks.designs import grounded

Cells = np.ndarray
"""bool[X, Y, Z]."""


def _full(x: int, y: int, z: int) -> Cells:
    return np.ones((x, y, z), bool)


def _shell(x: int, y: int, z: int, thick: int = 1) -> Cells:
    """Four walls without floor and roof."""
    cells = _full(x, y, z)
    cells[thick:-thick, thick:-thick] = False
    return cells


def wall(x: int, y: int, z: int, *holes: tuple[int, int, int, int]) -> Cells:
    """A wall along x with openings ``(x0, x1, z0, z1)`` right through it."""
    cells = _full(x, y, z)
    for x0, x1, z0, z1 in holes:
        cells[x0:x1, :, z0:z1] = False
    return cells


def house(
    x: int,
    y: int,
    eaves: int,
    thick: int,
    door: tuple[int, int, int],
    *,
    windows: tuple[tuple[int, int, int, int], ...] = (),
    gables: bool = True,
) -> Cells:
    """Walls with a door in the front, windows in front and back, and gables at both ends of x.

    Args:
        door: ``(x0, x1, height)`` in the wall at y = 0.
        windows: ``(x0, x1, z0, z1)``.
    """
    rise = (y + 1) // 2 if gables else 0
    cells = np.zeros((x, y, eaves + rise), bool)
    cells[:, :, :eaves] = _shell(x, y, eaves, thick)
    for k in range(rise):
        cells[:thick, k : y - k, eaves + k] = cells[-thick:, k : y - k, eaves + k] = True
    cells[door[0] : door[1], :thick, : door[2]] = False
    for x0, x1, z0, z1 in windows:
        cells[x0:x1, :thick, z0:z1] = cells[x0:x1, -thick:, z0:z1] = False
    return cells


def big_house() -> Cells:
    """24 x 20 x 24 cells: two storeys, a door, windows on all sides, gables."""
    cells = house(
        24,
        20,
        14,
        2,
        (10, 14, 6),
        windows=((3, 7, 3, 6), (17, 21, 3, 6), (3, 7, 9, 12), (10, 14, 9, 12), (17, 21, 9, 12)),
    )
    cells[:2, 8:12, 9:12] = cells[-2:, 8:12, 9:12] = False
    return cells


def tower(x: int, y: int, z: int, thick: int, storey: int = 0) -> Cells:
    """A hollow tower; every ``storey`` levels slits two cells high in the middle of its walls."""
    cells = _shell(x, y, z, thick)
    for k in range(storey, z - 3, storey) if storey else ():
        cells[x // 2 - 1 : x // 2 + 1, :, k : k + 2] = False
        cells[:, y // 2 - 1 : y // 2 + 1, k : k + 2] = False
    return cells


def stairs(steps: int, width: int, tread: int = 2, rise: int = 1) -> Cells:
    """Solid stairs along x."""
    cells = np.zeros((steps * tread, width, steps * rise), bool)
    for k in range(steps):
        cells[k * tread :, :, k * rise : (k + 1) * rise] = True
    return cells


def bridge(spans: int, gap: int, pier: int, height: int, width: int, deck: int = 2) -> Cells:
    """A deck on piers."""
    length = spans * gap + (spans + 1) * pier
    cells = np.zeros((length, width, height + deck), bool)
    cells[:, :, height:] = True
    for k in range(spans + 1):
        cells[k * (gap + pier) : k * (gap + pier) + pier] = True
    return cells


def arch(span: int, side: int, springing: int, thick: int, top: int = 2) -> Cells:
    """A wall with a round opening of ``span`` cells, its half circle from level ``springing``."""
    levels = springing + span // 2 + top
    x, z = np.meshgrid(np.arange(span + 2 * side) + 0.5, np.arange(levels) + 0.5, indexing="ij")
    dx, dz = x - (side + span / 2), z - springing
    opening = (np.abs(dx) < span / 2) & ((dz < 0) | (dx**2 + dz**2 < (span / 2) ** 2))
    return np.repeat(~opening[:, None, :], thick, 1)


def corbel_arch(span: int, side: int, base: int, thick: int, step: int = 1, rise: int = 1) -> Cells:
    """A wall with an opening that steps inwards from level ``base`` on."""
    levels = -(-span // (2 * step)) * rise
    cells = _full(span + 2 * side, thick, base + levels + 1)
    cells[side:-side, :, :base] = False
    for k in range(levels):
        inset = (k // rise) * step
        cells[side + inset : side + span - inset, :, base + k] = False
    return cells


def dome(radius: float, thick: float, lift: float = 0.0) -> Cells:
    """Half a hollow sphere of outer ``radius`` cells, raised by straight walls of ``lift``."""
    n = int(np.ceil(2 * radius))
    c = np.arange(n) + 0.5 - n / 2
    z = np.maximum(np.arange(int(np.ceil(radius + lift))) + 0.5 - lift, 0.0)
    r = np.sqrt(c[:, None, None] ** 2 + c[None, :, None] ** 2 + z[None, None, :] ** 2)
    return (r <= radius) & (r > radius - thick)


def blob(seed: int, n: int, balls: int) -> Cells:
    """A solid union of balls that stands on the table."""
    rng = np.random.default_rng(seed)
    grid = np.stack(np.meshgrid(*[np.arange(n) + 0.5] * 3, indexing="ij"), -1)
    cells = np.zeros((n, n, n), bool)
    centre = np.array([n / 2, n / 2, n / 4])
    for _ in range(balls):
        radius = rng.uniform(n / 6, n / 3.5)
        cells |= ((grid - centre) ** 2).sum(-1) < radius**2
        centre = np.clip(centre + rng.uniform(-n / 6, n / 6, 3) + [0, 0, n / 10], n / 5, 4 * n / 5)
    return grounded(cells[:, :, np.flatnonzero(cells.any((0, 1)))[0] :])


def letter(rows: str, thick: int, scale: int = 1) -> Cells:
    """A drawing of ``#`` and ``.``, top row first, lines parted by ``/``."""
    picture = np.array([[c == "#" for c in row] for row in rows.split("/")])[::-1].T
    picture = np.repeat(np.repeat(picture, scale, 0), scale, 1)
    return np.repeat(picture[:, None, :], thick, 1)


def table(x: int, y: int, height: int, leg: int, top: int = 1) -> Cells:
    """A plate on four legs."""
    cells = np.zeros((x, y, height + top), bool)
    cells[:, :, height:] = True
    for xs in (slice(0, leg), slice(x - leg, x)):
        for ys in (slice(0, leg), slice(y - leg, y)):
            cells[xs, ys] = True
    return cells


SHAPES: dict[str, Callable[[], Cells]] = {
    "wall": lambda: wall(20, 2, 10),
    "wall-window": lambda: wall(20, 2, 12, (6, 10, 4, 8)),
    "wall-two-windows": lambda: wall(26, 1, 12, (4, 8, 4, 8), (17, 22, 4, 8)),
    "wall-door-wide": lambda: wall(22, 2, 10, (8, 14, 0, 6)),
    "wall-thick": lambda: wall(16, 3, 8, (6, 9, 2, 5)),
    "house-small": lambda: house(16, 12, 8, 1, (6, 9, 5), windows=((2, 5, 3, 6), (11, 14, 3, 6))),
    "house-thick": lambda: house(18, 14, 8, 2, (7, 11, 5), windows=((2, 5, 3, 6),)),
    "house-flat": lambda: house(12, 10, 9, 1, (4, 7, 5), gables=False),
    "tower-slim": lambda: tower(6, 6, 24, 1, 6),
    "tower-thick": lambda: tower(10, 10, 20, 2, 5),
    "tower-solid": lambda: _full(5, 5, 20),
    "stairs": lambda: stairs(8, 4),
    "stairs-steep": lambda: stairs(7, 3, 1, 2),
    "bridge": lambda: bridge(2, 4, 3, 5, 3),
    "bridge-wide": lambda: bridge(1, 6, 4, 4, 4),
    "bridge-long": lambda: bridge(3, 5, 2, 6, 2, 3),
    "arch-4": lambda: arch(4, 3, 4, 2),
    "arch-8": lambda: arch(8, 5, 4, 2, 3),
    "arch-12": lambda: arch(12, 6, 3, 2, 3),
    "arch-corbel": lambda: corbel_arch(10, 6, 3, 2),
    "arch-corbel-2": lambda: corbel_arch(12, 6, 2, 2, 2, 2),
    "dome": lambda: dome(6, 2.5),
    "dome-lean": lambda: dome(6, 1.6),
    "dome-thin": lambda: dome(8, 1.2, 2),
    "blob-1": lambda: blob(1, 12, 5),
    "blob-2": lambda: blob(2, 14, 6),
    "letter-h": lambda: letter("##...##/##...##/#######/##...##/##...##", 1, 2),
    "table": lambda: table(10, 8, 5, 2, 2),
}
"""The 28 shapes of the benchmark, ready to be built with the kit ``bricks-lintels``."""
