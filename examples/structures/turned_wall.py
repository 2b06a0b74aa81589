"""A wall of turned bricks: ``python examples/structures/turned_wall.py [FOLDER [BRICKS]]``."""

import sys
from itertools import count
from pathlib import Path

import numpy as np

import learn2assemble as l2a

BRICK = 0.24, 0.115, 0.065
"""Length, width and height [m]."""
MOST = np.radians(25.0)
"""Largest turn about the vertical, to either side."""
PITCH = float(np.hypot(BRICK[0], BRICK[1])) + 0.001
"""Between the middles of neighbours [m]: as long as a brick's diagonal, so that no two bricks of a
course ever meet, however they are turned."""
HALF = 0.47 * BRICK[0]
"""Length of a half brick, which ends every other course and is not turned [m]."""


def waves() -> np.ndarray:
    """float64[64, 64]: a picture of two waves, 0 is dark and 1 is light; the first row is the top.

    Any picture in grey will do as well.
    """
    v, u = np.mgrid[0:1:64j, 0:1:64j]
    return 0.5 + 0.25 * np.sin(2 * np.pi * (2 * u + v)) + 0.25 * np.cos(3 * np.pi * (v - u))


def turned_wall(
    bricks: int = 64, long: int | None = None, picture: np.ndarray | None = None
) -> l2a.Assembly:
    """A running bond in which grey turns: dark to the right by 25 degrees, light to the left.

    Every other course begins and ends with a half brick. Every whole brick lies on two.

    Args:
        bricks: how many there are, half ones included; the top course may be unfinished.
        long: bricks of an even course; without it the wall is about as high as it is long.
        picture: float64[rows, columns] of 0..1, which the wall shows.
    """
    picture = waves() if picture is None else picture
    long = long or max(2, round(float(np.sqrt(bricks * BRICK[2] / PITCH))))
    courses = -(-2 * bricks // (2 * long + 1))
    blocks: list[l2a.Block] = []
    for course in count():
        odd = course % 2
        middles = (np.arange(long - odd) + odd / 2) * PITCH
        row = [
            (x, BRICK[0], _turn(picture, (x / PITCH + 0.5) / long, (course + 0.5) / courses))
            for x in middles
        ]
        if odd:
            end = (BRICK[0] - HALF) / 2
            row.insert(0, (-end, HALF, 0.0))
            row.append(((long - 1) * PITCH + end, HALF, 0.0))
        for number, (x, length, turn) in enumerate(row):
            if len(blocks) == bricks:
                return l2a.Assembly(tuple(blocks), friction=0.6, name=f"turned_wall_{bricks}")
            blocks.append(_brick(f"c{course}b{number}", (x, course * BRICK[2]), length, turn))
    raise AssertionError("courses never end")


def _turn(picture: np.ndarray, u: float, v: float) -> float:
    """The turn of a brick from the grey at these shares of the length and of the height [rad]."""
    rows, columns = picture.shape
    grey = picture[int(max(1 - v, 0.0) * rows), int(u * columns)]
    return float(MOST * (2 * grey - 1))


def _brick(name: str, place: tuple[float, float], length: float, turn: float) -> l2a.Block:
    """A box with its middle at x, its bottom at z and turned about its middle."""
    flat = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * [length / 2, BRICK[1] / 2]
    cosine, sine = np.cos(turn), np.sin(turn)
    flat = flat @ np.array([[cosine, sine], [-sine, cosine]]) + [place[0], 0.0]
    corners = [[*xy, z] for z in (place[1], place[1] + BRICK[2]) for xy in flat]
    return l2a.hull_block(name, corners, kind="brick" if length == BRICK[0] else "half")


def main() -> None:
    """Write the wall, its plan, and the page and picture of the plan."""
    out = Path(sys.argv[1] if len(sys.argv) > 1 else "out/turned_wall")
    assembly = turned_wall(int(sys.argv[2]) if len(sys.argv) > 2 else 64)
    out.mkdir(parents=True, exist_ok=True)
    l2a.write_assembly(assembly, out / f"{assembly.name}.json", overwrite=True)
    print(assembly.name, l2a.check(assembly).verdict)
    plan = l2a.build(assembly, progress=print)
    print(plan.status, plan.reason or "")
    print(*plan.save(out).values(), sep="\n")


if __name__ == "__main__":
    main()
