"""Where blocks wait for an arm: places it can take them from, and faults of places that are given.

Facts: blocks need about 90 mm along the axis on which the fingers close (measured), and a table
0.75 m x 0.5 m to each side of the origin (protocol 1.1).
"""

from __future__ import annotations

import math

import numpy as np
import shapely

from learn2assemble.errors import InputError
from learn2assemble.robot.attempt import Attempt
from learn2assemble.robot.collision import TABLE
from learn2assemble.robot.columns import Columns
from learn2assemble.robot.grasps import Attitude, GraspPair, along
from learn2assemble.robot.kinematic import KinematicCell
from learn2assemble.robot.outcome import Outcome
from learn2assemble.robot.scene import Move, Scene
from learn2assemble.world.blocks import EDGE, HALF

SPACING = 0.09
"""Between waiting blocks [m]."""
CLEAR = 0.12
"""Between waiting blocks and the building site, centre to centre [m]."""
LIFT = 0.40
"""Height a tool must be able to reach over a waiting block [m]."""


def supply_places(
    cell: KinematicCell, count: int, site: np.ndarray, first: np.ndarray
) -> np.ndarray:
    """Places around a building site from which an arm can take blocks with either attitude.

    Args:
        cell: of the arm.
        count: how many.
        site: float64[n, 2], centres of the cells on the table that may be built on [m].
        first: float64[3]: centre of the first block [m].

    Returns:
        float64[count, 3]: x, y [m] and yaw of each block, the nearest to the site first.

    Raises:
        InputError: where there are not so many.
    """
    low, high = site.min(0) - CLEAR, site.max(0) + CLEAR
    middle = (low + high) / 2
    steps = np.arange(-8, 9) * SPACING
    grid = np.stack(np.meshgrid(steps, steps), -1).reshape(-1, 2)
    # Two sheets of a grid, so that rows begin right beside the site on both of its long sides.
    before = grid + np.array([middle[0], low[1]])
    behind = grid + np.array([middle[0], high[1]])
    sheets = [before[before[:, 1] < low[1] + 1e-9], behind[behind[:, 1] > high[1] - 1e-9]]
    places = np.vstack(sheets)
    places = places[(np.abs(places) < np.array(TABLE[:2]) - EDGE).all(1)]
    order = np.argsort(np.linalg.norm(places - middle, axis=1), kind="stable")
    found: list[tuple[float, float, float]] = []
    for x, y in places[order].tolist():
        if len(found) == count:
            break
        alone = Scene(np.array([first, [x, y, HALF]]), np.zeros(2), np.arange(2), 1)
        if all(
            _reached(cell.columns, x, y, yaw) is None and _pick(cell, alone, Attitude(yaw)).reached
            for yaw in (0.0, -math.pi / 2)
        ):
            found.append((x, y, 0.0))
    if len(found) < count:
        can = f"at most {len(found)}, what {cell.arm.name} can reach on the table"
        raise InputError("waiting blocks", count, can)
    return np.array(found).reshape(-1, 3)


def check_places(
    cell: KinematicCell,
    pairs: tuple[GraspPair, ...],
    places: np.ndarray,
    site: np.ndarray,
    first: np.ndarray,
    source: str,
) -> np.ndarray:
    """Refuse places blocks cannot wait at.

    Args:
        cell: of the arm that is to take them.
        pairs: the attitudes it may use.
        places: float64[n, 3]: x, y [m], yaw [rad].
        site: float64[m, 2]: centres of the cells on the table that are needed [m].
        first: float64[3]: centre of the first block [m].
        source: where they come from, for messages.

    Returns:
        int64[n]: an order in which all of them can be taken.

    Raises:
        InputError: naming the place, for one off the table, one that overlaps another or the
            building site, one out of reach, and one the fingers cannot get at.
    """
    faces = [_face(x, y, yaw) for x, y, yaw in places.tolist()]
    needed = shapely.union_all([_face(x, y, 0.0) for x, y in np.vstack([site, first[:2]]).tolist()])
    table = shapely.box(-TABLE[0], -TABLE[1], TABLE[0], TABLE[1])
    for n, face in enumerate(faces):
        what, at = f"{source}: positions[{n}]", places[n].tolist()
        if not table.contains(face):
            within = f"a place on the table (|x| <= {TABLE[0]}, |y| <= {TABLE[1]} m)"
            raise InputError(what, at, within)
        for other in range(n):
            if face.intersection(faces[other]).area > 1e-9:
                raise InputError(what, at, f"a place that does not overlap positions[{other}]")
        if face.intersection(needed).area > 1e-9:
            raise InputError(what, at, "a place outside the building site")
        x, y, yaw = at
        why = [_reached(cell.columns, x, y, yaw + turn) for turn in (0.0, -math.pi / 2)]
        if None not in why:
            raise InputError(what, at, f"a place {cell.arm.name} can reach ({why[0]})")
    ground = np.column_stack([places[:, :2], np.full(len(places), HALF)])
    scene = Scene(
        np.vstack([first, ground]), np.concatenate([[0.0], places[:, 2]]),
        np.arange(len(places) + 1), 1,
    )  # fmt: skip
    order, stuck = taking_order(cell, pairs, scene)
    for n, attempt in stuck.items():
        why = f"a place the fingers get at ({attempt.detail})"
        raise InputError(f"{source}: positions[{n - 1}]", places[n - 1].tolist(), why)
    return np.array(order, np.int64) - 1


def taking_order(
    cell: KinematicCell, pairs: tuple[GraspPair, ...], scene: Scene
) -> tuple[list[int], dict[int, Attempt]]:
    """An order in which the waiting cubes of a scene can be taken away, and those that cannot.

    What waits first in the scene goes first where all attitudes can take it, else what most can.

    Returns:
        indices of the scene, and by index why the others cannot be taken.
    """
    placed = list(range(scene.num_placed))
    left, order = list(range(scene.num_placed, len(scene.position))), []
    grasps = list(dict.fromkeys(pair.grasp for pair in pairs))
    while left:
        best, most = -1, 0
        stuck: dict[int, Attempt] = {}
        for n in left:
            rows = [*placed, n, *(k for k in left if k != n)]
            one = Scene(
                scene.position[rows], scene.yaw[rows], scene.object_id[rows], scene.num_placed
            )
            tries = [_pick(cell, one, grasp) for grasp in grasps]
            reached = sum(found.reached for found in tries)
            if reached > most:
                best, most = n, reached
            if most == len(grasps):
                break
            stuck[n] = tries[0]
        if best < 0:
            return order, stuck
        order.append(best)
        left.remove(best)
    return order, {}


def _pick(cell: KinematicCell, scene: Scene, grasp: Attitude) -> Attempt:
    """The attempt to lift the first waiting cell."""
    number = scene.num_placed
    high = np.array([0.0, 0.0, scene.position[:number, 2].max() + EDGE])
    turned = along(grasp, float(scene.yaw[number]))
    found = Attempt(Outcome.UNREACHABLE)
    for attitude in (turned, turned.flipped()):
        found = cell.pick(scene, Move(number, high, attitude, attitude))
        if found.reached:
            break
    return found


def _face(x: float, y: float, yaw: float) -> shapely.Polygon:
    corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * HALF
    c, s = math.cos(yaw), math.sin(yaw)
    return shapely.Polygon(corners @ np.array([[c, s], [-s, c]]) + [x, y])


def _reached(columns: Columns, x: float, y: float, yaw: float) -> str | None:
    """Why an arm cannot take a block from there at this yaw of the hand; None where it can."""
    found: np.ndarray | str = ""
    for attitude in (Attitude(yaw), Attitude(yaw).flipped()):
        found = columns.solve(np.array([x, y, HALF]), attitude, LIFT)
        if not isinstance(found, str):
            return None
    return str(found)
