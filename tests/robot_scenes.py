"""Scenes for tests of the fidelities of the robot cell: on its lattice, and random moves.

``PYTHONPATH=src python tests/robot_scenes.py [MOVES] [SEED]`` carries random moves with suction out
in the kinematic and in the dynamic cell: boxes of many sizes into slots, on courses, beside towers,
onto occupied places, out of reach, into the table.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterator

import mujoco
import numpy as np

from learn2assemble.handling.dynamic_cell import DynamicCell
from learn2assemble.kinematics.cell import KinematicCell
from learn2assemble.kinematics.collisions import BlockChecker, Collision
from learn2assemble.robot.arm import Arm, get_arm
from learn2assemble.robot.bodies import Part, Shape
from learn2assemble.robot.grasps import Attitude
from learn2assemble.robot.holding import attitudes
from learn2assemble.robot.moves import Move, Scene, put_down

PITCH, GROUND = 0.06, 0.025
SUCTION = tuple(get_arm(name, "suction") for name in ("panda", "ur5e"))
KINDS = {"slot": 0.4, "course": 0.3, "tower": 0.12, "blocked": 0.08, "far": 0.05, "sunk": 0.05}


def scene(placed: list[tuple], waiting: list[tuple], objects: list[int] | None = None) -> Scene:
    """Cells (x, y, z) [pitches; levels above the ground]."""
    cells = np.array([*placed, *waiting], float)
    position = cells * [PITCH, PITCH, 0.05] + [0.0, 0.0, GROUND]
    ids = np.arange(len(cells)) if objects is None else np.array(objects)
    return Scene(position, np.zeros(len(cells)), ids, len(placed))


def cell(x: float, y: float, z: float) -> np.ndarray:
    """Centre of a cell [m]."""
    return np.array([x * PITCH, y * PITCH, z * 0.05 + GROUND])


def box(half: np.ndarray) -> Shape:
    """A box with these half extents as the shape of a block."""
    x, y, z = half.tolist()
    return (Part((0.0, 0.0, 0.0), (x, y, z)),)


def hands(arm: Arm, half: np.ndarray, side: bool = False) -> list[Attitude]:
    """How the tool of an arm meets a box that stands upright: from above, or with a cup at its
    side."""
    found = attitudes(arm, box(half))
    return [hand for hand in found if hand.sideways == side and not hand.tilt]


def check_hit(model: BlockChecker, hit: Collision | None, near: float) -> None:
    """That a checker reports a collision where every pair of geoms by itself has one.

    Args:
        hit: what the checker reported for the joints that its data has.
        near: distances smaller than this decide nothing [m].
    """
    m, d = model.model, model.data
    mujoco.mj_kinematics(m, d)
    body = [m.body(b).name for b in m.geom_bodyid]
    things = [g for g in range(m.ngeom) if body[g].startswith(("table", "block"))]
    held = [g for g in range(m.ngeom) if body[g] == "carried 0"]
    links = [
        g
        for g in range(m.ngeom)
        if (m.geom_contype[g] and g not in things)
        and not body[g].startswith(("carried", "meshes", "link0"))
    ]
    nearest = min(
        mujoco.mj_geomDistance(m, d, a, b, 0.05, None) for a in (*links, *held) for b in things
    )
    if abs(nearest) < near:
        return
    if nearest < 0:
        assert hit is not None
    elif hit is not None:
        assert not hit.other.startswith(("table", "block"))


def random_moves(seed: int) -> Iterator[tuple[str, Scene, Move]]:
    """Kind of the place, scene and order, without end."""
    rng = np.random.default_rng(seed)
    while True:
        gap, depth, height = rng.choice([1e-4, 3e-4, 5e-4]), *rng.uniform(0.016, 0.04, 2)
        long = np.where(rng.random(6) < 0.2, 0.15, 0.06)
        length = rng.uniform(0.017, long)
        x = np.cumsum(2 * length + gap) - length - 0.2
        half = np.column_stack([length, 0 * x + depth, 0 * x + height])
        middle = np.column_stack([x, 0 * x + rng.uniform(-0.1, 0.25), 0 * x + height])
        row = x + length < 0.2
        half, middle = half[row], middle[row]
        kind, k = str(rng.choice(list(KINDS), p=list(KINDS.values()))), int(rng.integers(len(half)))
        size, place = half[k].copy(), middle[k].copy()
        if kind == "course":
            if k + 1 == len(half):
                continue
            size[0] = min(size[0], half[k + 1, 0])
            place += [half[k, 0], 0.0, 2 * height]
        elif kind == "blocked":
            place += [rng.uniform(-0.02, 0.02), 0.0, rng.uniform(0.0, 0.9) * height]
        else:
            half, middle = np.delete(half, k, 0), np.delete(middle, k, 0)
            place += {"far": [rng.uniform(0.2, 0.7), 0, 0], "sunk": [0, 0, -0.008]}.get(kind, 0.0)
        if kind == "tower":
            tall = rng.uniform(height, 0.15)
            beside = place[1] + depth + 0.025 + rng.uniform(0.0005, 0.03)
            middle = np.vstack([middle, [[place[0], beside, tall]]])
            half = np.vstack([half, [[0.025, 0.025, tall]]])
        yaw = float(rng.choice([0.0, np.pi / 2, rng.uniform(-0.6, 0.6)]))
        waits = np.array([*(rng.uniform(-0.15, 0.15), rng.uniform(-0.38, -0.28)), size[2]])
        placed, waiting, sizes = len(middle), [waits], [size]
        if rng.random() < 0.3:  # something waits beside it
            other = size * [1, 1, 0] + [0, 0, rng.uniform(0.01, 0.06)]
            off = 2 * size[1] + rng.uniform(5e-4, 0.01)
            across = np.array([-np.sin(yaw), np.cos(yaw), 0.0])
            waiting.append(waits * [1, 1, 0] - off * across + other * [0, 0, 1])
            sizes.append(other)
        turn = np.zeros(placed + len(waiting))
        turn[placed:] = yaw
        scene = Scene(
            np.vstack([middle, waiting]),
            turn,
            np.arange(len(turn)),
            placed,
            np.vstack([half, sizes]),
            np.full(len(turn), rng.uniform(300, 1500)),
        )
        ways = hands(SUCTION[0], size)
        if ways:
            hand = ways[int(rng.integers(len(ways)))]
            grasp = hand._replace(yaw=hand.yaw + yaw)
            yield kind, scene, Move(placed, place, grasp, hand)


def main(moves: int, seed: int) -> None:
    cells = [(KinematicCell(arm), DynamicCell(arm)) for arm in SUCTION]
    counts: Counter[tuple[str, str]] = Counter()
    errors, shifts, same = [], [], 0
    for k, (kind, scene, move) in zip(range(moves), random_moves(seed), strict=False):
        meant, real = (cell.attempt(scene, move) for cell in cells[k % 2])
        same += meant.reached == real.reached
        counts[meant.outcome.label, real.outcome.label] += 1
        if meant.reached != real.reached:
            print(k, kind, meant.outcome.label, meant.detail, "|", real.outcome.label, real.detail)
        if real.reached and real.after is not None:
            errors.append(real.error)
            off = np.linalg.norm(real.after.position - put_down(scene, move).position, axis=1)
            shifts.append(np.delete(off, scene.num_placed).max(initial=0.0))
    for (meant, real), count in sorted(counts.items()):
        print(f"{count:5d}  kinematic {meant}, dynamic {real}")
    print(f"{same} of {moves} agree on what is reached ({same / moves:.1%})")
    print(f"placement error: mean {1e3 * np.mean(errors):.3f}, worst {1e3 * np.max(errors):.3f} mm")
    print(f"other blocks were moved by {1e3 * np.max(shifts):.3f} mm at most")


if __name__ == "__main__":
    main(*(int(word) for word in (sys.argv[1:] + ["500", "0"][len(sys.argv) - 1 :])))
