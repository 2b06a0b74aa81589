"""Kinematic against dynamic on random moves with suction: boxes of many sizes into slots, on
courses, beside towers, onto occupied places, out of reach, into the table.

    PYTHONPATH=src python tests/suction_moves.py [MOVES] [SEED]
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterator

import numpy as np

from learn2assemble.robot.arm import get_arm
from learn2assemble.robot.kinematic import KinematicCell
from learn2assemble.robot.moves import Move, Scene, put_down
from learn2assemble.simulation.cell import DynamicCell
from robot_scenes import hands as hands_of

ARMS = tuple(get_arm(name, "suction") for name in ("panda", "ur5e"))
KINDS = {"slot": 0.4, "course": 0.3, "tower": 0.12, "blocked": 0.08, "far": 0.05, "sunk": 0.05}


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
        hands = hands_of(ARMS[0], size)
        if hands:
            hand = hands[int(rng.integers(len(hands)))]
            grasp = hand._replace(yaw=hand.yaw + yaw)
            yield kind, scene, Move(placed, place, grasp, hand)


def main(moves: int, seed: int) -> None:
    cells = [(KinematicCell(arm), DynamicCell(arm)) for arm in ARMS]
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
