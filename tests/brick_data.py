"""Models of bricks for tests.

``data/clutch_designs.jsonl.gz`` holds eight designs of StableLego with their verdicts, five samples
of StableText2Brick and six tasks of APEX-MR. All are published under the MIT licence: StableLego
(Liu et al., RA-L 2024), BrickGPT and StableText2Brick (Pun et al., ICCV 2025), APEX-MR (Huang et
al., RSS 2025).

Bricks before cameras, for the tests of what is seen.
"""

from __future__ import annotations

import gzip
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from learn2assemble.assembly.blocks import Assembly
from learn2assemble.assembly.bricks.files import of_stablelego
from learn2assemble.assembly.bricks.model import Brick, BrickModel, assembly_of
from learn2assemble.assembly.kit import load_kit
from learn2assemble.cell.bricks import BrickStates
from learn2assemble.geometry.rotations import quaternion_matrix, yaw_quaternion
from learn2assemble.robot.bodies import Part, Shape
from learn2assemble.robot.moves import Scene
from learn2assemble.robot.studs import Studs
from learn2assemble.sensing.camera import DepthCamera, looking

DATA = Path(__file__).parent / "data"
LEGO, DUPLO = load_kit("lego"), load_kit("duplo")
PUBLISHED = 0.98
"""Capacity of the published verdicts [N]."""
SIZES = [(1, 1), (1, 2), (1, 4), (2, 2), (2, 4), (2, 6), (1, 8), (2, 3)]


def designs() -> dict[str, dict[str, Any]]:
    """The designs by name."""
    with gzip.open(DATA / "clutch_designs.jsonl.gz", "rt") as file:
        return {d["name"]: d for d in map(json.loads, file)}


def design(name: str) -> Assembly:
    """One of them."""
    return of_stablelego(designs()[name], name, name, None)


def bricks(*given: tuple[tuple[int, int], tuple[int, int, int]]) -> Assembly:
    """Bricks of some extents in studs at corners in studs and bricks."""
    made = [
        Brick((x, y, 3 * z), (a, b, 3), f"brick {k}") for k, ((a, b), (x, y, z)) in enumerate(given)
    ]
    return assembly_of(BrickModel(tuple(made)), LEGO, "test")


def random_bricks(seed: int, count: int) -> list[tuple[tuple[int, int], tuple[int, int, int]]]:
    """A tree of bricks that lie on or hang under one another."""
    rng = np.random.default_rng(seed)
    taken: set[tuple[int, int, int]] = set()
    made: list[tuple[tuple[int, int], tuple[int, int, int]]] = []
    while len(made) < count:
        a, b = SIZES[rng.integers(len(SIZES))]
        if rng.random() < 0.5:
            a, b = b, a
        if not made:
            x, y, z = 20, 20, 0
        else:
            (c, d), (u, v, w) = made[rng.integers(len(made))]
            x = u + int(rng.integers(1 - a, c))
            y = v + int(rng.integers(1 - b, d))
            z = w + (1 if rng.random() < 0.75 else -1)
        cells = {(i, j, z) for i in range(x, x + a) for j in range(y, y + b)}
        if z >= 0 and not cells & taken:
            taken |= cells
            made.append(((a, b), (x, y, z)))
    return made


def duplo(*given: tuple[tuple[int, int], tuple[int, int, int]]) -> Assembly:
    """Large bricks of some extents at corners in studs and layers."""
    made = [Brick(at, (a, b, 1), f"brick {k}") for k, ((a, b), at) in enumerate(given)]
    return assembly_of(BrickModel(tuple(made)), DUPLO, "test")


def scene_of(assembly: Assembly, states: BrickStates, home: bool = True) -> Scene:
    """An assembly as a simulation takes it, every joint home or, of bricks on others, none."""
    boxes = np.array([[b.vertices.min(0), b.vertices.max(0)] for b in assembly.blocks])
    count = len(boxes)
    pairs = sorted(pair for pair in states.mates.knobs if home or pair[0] >= 0)
    joints = tuple(states.stud_joint(*pair)._replace(home=home) for pair in pairs)
    return Scene(
        boxes.mean(1),
        np.zeros(count),
        np.arange(count),
        count,
        np.diff(boxes, axis=1)[:, 0] / 2,
        np.array([block.density for block in assembly.blocks]),
        np.tile([1.0, 0, 0, 0], (count, 1)),
        studs=Studs(joints, assembly.joint.press),
    )


BRICK: Shape = (Part((0.0, 0.0, 0.0), (0.04, 0.02, 0.015)),)
TURNS = tuple(np.diag(d).astype(float) for d in ((1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)))
"""Rotations that leave the brick as it is."""
CORNER = DepthCamera("corner", (0.6, 0.5, 0.8, *looking(np.array([-0.6, -0.5, -0.8]))))
"""Looks over the table from one side."""


def lying(x: float, y: float, yaw: float, z: float = 0.015) -> np.ndarray:
    """float64[7]: pose of a brick."""
    return np.array([x, y, z, *yaw_quaternion(yaw)])


def shifted(pose: np.ndarray, by: Sequence[float] | np.ndarray) -> np.ndarray:
    """A pose float64[7] moved along the first axes of the world [m]."""
    moved = pose.copy()
    moved[: len(by)] += by
    return moved


def off_by(pose: np.ndarray, true: np.ndarray) -> np.ndarray:
    """float64[6]: how far a pose is off: position [m], rotation vector about world axes [rad]."""
    turn = quaternion_matrix(pose[3:]) @ quaternion_matrix(true[3:]).T
    spin = 0.5 * np.array(
        [turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]
    )
    return np.concatenate([pose[:3] - true[:3], spin])
