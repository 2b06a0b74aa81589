"""A barrel vault and a cross vault: ``python examples/structures/vaults.py [FOLDER]``."""

import sys
from itertools import pairwise
from pathlib import Path

import numpy as np

import learn2assemble as l2a


def barrel_vault(
    voussoirs: int = 9,
    courses: int = 10,
    radius: float = 0.5,
    thickness: float = 0.1,
    course: float = 0.1,
    bond: bool = False,
    apart: float = 0.0,
) -> l2a.Assembly:
    """Semicircular courses of voussoirs one behind the other along y, on the ground, their middle
    at the origin.

    Args:
        voussoirs: of a course.
        courses: how many.
        radius: to the middle of the thickness of every joint [m].
        thickness: along the radius [m].
        course: depth of a course [m].
        bond: every other row is shifted by half a course, with half voussoirs at both ends.
        apart: width of the joints between courses [m].
    """
    blocks = []
    for row, section in enumerate(_sections(voussoirs, radius, thickness)):
        ends = course * (np.arange(courses + 1.0) - courses / 2)
        if bond and row % 2:
            ends = np.concatenate([ends[:1], ends[:-1] + course / 2, ends[-1:]])
        for number, (y0, y1) in enumerate(pairwise(ends)):
            sides = y0 + apart / 2, y1 - apart / 2
            corners = [(x, y, z) for x, z in section for y in sides]
            blocks.append(l2a.hull_block(f"r{row}c{number}", corners))
    return l2a.Assembly(tuple(blocks), friction=0.6, name="barrel_vault")


def cross_vault(
    voussoirs: int = 9, radius: float = 0.5, thickness: float = 0.1, course: float = 0.1
) -> l2a.Assembly:
    """Two barrel vaults that cross, cut along their diagonals, on four feet on the ground.

    The four parts are quarter turns of one, whose rows of voussoirs lie along x and end in the
    planes x = y and x = -y. There they press against the next part.

    Args:
        voussoirs: in a section, an odd number.
        radius: to the middle of the thickness of every joint [m].
        thickness: along the radius [m].
        course: length of the stones of a row [m]; the one at the diagonal is longer or shorter.
    """
    edge = radius + thickness / 2 + course
    quarter: list[tuple[str, np.ndarray]] = []
    for row, section in enumerate(_sections(voussoirs, radius, thickness)):
        inner = np.abs(section[:, 0]).max()
        ends = [edge]
        while ends[-1] - (length := course * (0.5 if row % 2 and len(ends) == 1 else 1)) > inner:
            ends.append(ends[-1] - length)
        for number, (x1, x0) in enumerate(pairwise(ends)):
            quarter.append((f"r{row}c{number}", _box_along(section, [x0] * 4, [x1] * 4)))
        last = _box_along(section, np.abs(section[:, 0]), [ends[-1]] * 4)
        if section[0, 0] * section[2, 0] < 0:
            # The row of the crown ends in a point, where all four parts meet.
            last = np.concatenate([last, [[0.0, 0.0, z] for z in np.unique(section[:, 1])]])
        quarter.append((f"r{row}groin", last))
    blocks = []
    for name, (cosine, sine) in {"e": (1, 0), "n": (0, 1), "w": (-1, 0), "s": (0, -1)}.items():
        turn = np.array([[cosine, sine, 0.0], [-sine, cosine, 0], [0, 0, 1]])
        blocks += [l2a.hull_block(name + id, corners @ turn) for id, corners in quarter]
    return l2a.Assembly(tuple(blocks), friction=0.6, name="cross_vault")


def _sections(voussoirs: int, radius: float, thickness: float) -> np.ndarray:
    """float64[voussoirs, 4, 2]: corners of the voussoirs of an arch, across and up."""
    angles = np.linspace(0, np.pi, voussoirs + 1)
    joints = np.stack([np.cos(angles), np.sin(angles)], 1)
    joints = joints[:, None] * (radius + np.array([-0.5, 0.5]) * thickness)[:, None]
    return np.concatenate([joints[:-1], joints[1:]], 1)


def _box_along(section: np.ndarray, start: object, stop: object) -> np.ndarray:
    """float64[8, 3]: a section (y, z) drawn along x from and to these values of its corners."""
    return np.concatenate([np.column_stack([x, section]) for x in (start, stop)])


def main() -> None:
    """Write both vaults, their plans, and the pages and pictures of the plans."""
    out = Path(sys.argv[1] if len(sys.argv) > 1 else "out/vaults")
    for assembly in (barrel_vault(), cross_vault()):
        folder = out / assembly.name
        folder.mkdir(parents=True, exist_ok=True)
        l2a.write_assembly(assembly, folder / f"{assembly.name}.json", overwrite=True)
        print(assembly.name, l2a.check(assembly).verdict)
        plan = l2a.build(assembly, progress=print)
        print(plan.status, plan.reason or "")
        print(*plan.save(folder).values(), sep="\n")


if __name__ == "__main__":
    main()
