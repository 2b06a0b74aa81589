"""Where blocks wait for an arm, as a user gives it: a JSON file (``docs/layouts.md``).

Where blocks wait for an arm: places it can take them from, and faults of places that are given.

Facts: blocks need about 90 mm along the axis on which the fingers close (measured), and a table
0.75 m x 0.5 m to each side of the origin.

Setting blocks out for an arm, before it builds.
"""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import shapely

from learn2assemble.errors import InputError
from learn2assemble.files import load_json, number, read_head, read_text, sequence, too_deep
from learn2assemble.geometry.rotations import yaw_quaternion
from learn2assemble.planning.problem import Problem
from learn2assemble.robot.approach import ApproachCache
from learn2assemble.robot.grasps import Attitude, GraspPair, along, get_grasps
from learn2assemble.robot.kinematic.cell import KinematicCell
from learn2assemble.robot.kinematic.collision import TABLE
from learn2assemble.robot.moves import Attempt, Move, Outcome, Scene
from learn2assemble.world.blocks import EDGE, HALF

FORMAT, VERSION = "learn2assemble-layout", 1
_KEYS = ("format", "version", "units", "positions")
_REQUIRED = ("format", "version", "positions")
_PLACE = "[x, y] in metres, or [x, y, yaw] with the yaw in radians"
MAX_PLACES = 400


class Layout(NamedTuple):
    """Where blocks wait."""

    places: np.ndarray
    """float64[n, 3]: x, y [m, world] and yaw [rad] of every waiting block, on the table."""
    source: str
    """What messages call it."""


def read_layout(path: Path) -> Layout:
    """The layout in the file ``path``.

    Raises:
        InputError: one line that names the file and the JSON path of the fault.
    """
    text, source = read_text(Path(path), "layout file")
    try:
        return Layout(_places(load_json(text, source, FORMAT), source), source)
    except RecursionError:
        raise too_deep(source) from None


def _places(value: Any, source: str) -> np.ndarray:
    root = read_head(value, source, FORMAT, VERSION, _KEYS, _REQUIRED)
    where = f"{source}: positions"
    expected = f"a list of 1 to {MAX_PLACES} places"
    places = sequence(root["positions"], where, expected)
    if not 1 <= len(places) <= MAX_PLACES:
        raise InputError(where, f"{len(places)} places", expected)
    return np.array([_place(place, f"{where}[{k}]") for k, place in enumerate(places)])


def _place(value: Any, where: str) -> list[float]:
    place = sequence(value, where, _PLACE)
    if len(place) not in (2, 3):
        raise InputError(where, value, _PLACE)
    return [*(number(item, where) for item in place), 0.0][:3]


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
            _reached(cell.approaches, x, y, yaw) is None
            and _pick(cell, alone, Attitude(yaw)).reached
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
        why = [_reached(cell.approaches, x, y, yaw + turn) for turn in (0.0, -math.pi / 2)]
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


def _reached(approaches: ApproachCache, x: float, y: float, yaw: float) -> str | None:
    """Why an arm cannot take a block from there at this yaw of the hand; None where it can."""
    found: np.ndarray | str = ""
    for attitude in (Attitude(yaw), Attitude(yaw).flipped()):
        found = approaches.solve(np.array([x, y, HALF]), attitude, LIFT)
        if not isinstance(found, str):
            return None
    return str(found)


NEAREST_FIRST = "places the arm reaches around the building site, the nearest first"
"""Where blocks wait unless somebody says otherwise."""


def set_out(problem: Problem, cell: KinematicCell, layout: Layout | None = None) -> Problem:
    """The problem with its blocks at places from which the arm can take them.

    Args:
        cell: of the arm.
        layout: block k waits at the (k - 1)-th place; more places than blocks are left empty. By
            default they are :data:`NEAREST_FIRST`.

    Raises:
        InputError: for places blocks cannot wait at, and where there are too few.
    """
    first, count = int(problem.state.num_placed[0]), int(problem.state.num_blocks[0])
    waiting = count - first
    if layout is None:
        layout = Layout(
            supply_places(cell, waiting, problem.ground, problem.state.position[0, 0]),
            NEAREST_FIRST,
        )
    places, source = layout
    if len(places) < waiting:
        what = f"{source}: positions"
        raise InputError(what, f"{len(places)} places", f"{waiting}, one for each waiting block")
    places = places[:waiting]
    order = check_places(
        cell, get_grasps(problem.task.grasps), places, problem.ground, problem.state.position[0, 0],
        source,
    )  # fmt: skip
    state = problem.state.copy()
    chosen = places[order]
    state.position[0, first:count] = np.column_stack([chosen[:, :2], np.full(waiting, HALF)])
    # A block keeps its number; the list is in an order in which all can be taken.
    state.object_id[0, first:count] = state.object_id[0, first:count][order]
    state.quaternion[0, first:count] = yaw_quaternion(chosen[:, 2])
    return dataclasses.replace(problem, state=state)
