"""A spiral stair: ``python examples/structures/spiral_stair.py [FOLDER]``."""

import sys
from pathlib import Path

import numpy as np

import learn2assemble as l2a


def spiral_stair(
    steps: int = 24,
    radius: float = 0.3,
    newel: float = 0.04,
    rise: float = 0.04,
    wall: float = 0.05,
) -> l2a.Assembly:
    """Steps round a newel, one turn of ``steps`` steps, whose outer ends lie in a wall.

    A step is a piece of the newel and a tread in one stone, twice as wide as the next step leaves
    free: it lies on the newel, on the back half of the step below and on the wall. Floor and wall
    are supports.

    Args:
        steps: of one turn.
        radius: of the stair with its wall [m].
        newel: radius of the newel [m].
        rise: height of a step [m].
        wall: how far a step reaches into the wall [m].
    """
    angle = 2 * np.pi / steps

    def arc(distance: float, numbers: range) -> list[tuple[float, float]]:
        return [(distance * np.cos(k * angle), distance * np.sin(k * angle)) for k in numbers]

    floor = arc(1.1 * radius, range(steps))
    blocks = [_prism("floor", floor, -rise, 0.0, support=True)]
    for k in range(steps):
        back = max(k - 1, 0)
        tread = arc(radius, range(back, k + 2)) + arc(newel, range(k + 1, back + steps + 1))
        blocks.append(_prism(f"step{k}", tread, k * rise, (k + 1) * rise))
        if k:
            part = arc(radius, range(k, k + 2)) + arc(radius - wall, range(k + 1, k - 1, -1))
            blocks.append(_prism(f"wall{k}", part, 0.0, k * rise, support=True))
    return l2a.Assembly(tuple(blocks), friction=0.6, name="spiral_stair")


def _prism(
    name: str, outline: list[tuple[float, float]], bottom: float, top: float, **kwargs: bool
) -> l2a.Block:
    """An upright prism over a simple outline that runs counter-clockwise."""
    n = len(outline)
    corners = [(x, y, z) for z in (bottom, top) for x, y in outline]
    sides = [(k, (k + 1) % n, n + (k + 1) % n, n + k) for k in range(n)]
    faces = (tuple(range(n))[::-1], tuple(range(n, 2 * n)), *sides)
    return l2a.Block(name, np.array(corners), faces, **kwargs)


def main() -> None:
    """Write the stair, its plan, and the page and picture of the plan."""
    out = Path(sys.argv[1] if len(sys.argv) > 1 else "out/spiral_stair")
    assembly = spiral_stair()
    out.mkdir(parents=True, exist_ok=True)
    l2a.write_assembly(assembly, out / f"{assembly.name}.json", overwrite=True)
    print(assembly.name, l2a.check(assembly).verdict)
    plan = l2a.build(assembly, progress=print)
    print(plan.status, plan.reason or "")
    print(*plan.save(out).values(), sep="\n")


if __name__ == "__main__":
    main()
