"""Recorded transitions of the published simulator: reading them, restoring worlds from them, and
why a step may differ when repeated."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from learn2assemble.constants import EDGE, HALF
from learn2assemble.errors import InputError
from learn2assemble.files import read_json_lines
from learn2assemble.tasks.physics.equilibrium import find_contacts, is_stable
from learn2assemble.tasks.physics.rigid import RULES
from learn2assemble.tasks.physics.support import BALANCE_TOLERANCE
from learn2assemble.tasks.task import Task
from learn2assemble.tasks.world.coverage import FILTERS, paper_mask
from learn2assemble.tasks.world.layouts import side_frames
from learn2assemble.tasks.world.rules import count_row, recover_all
from learn2assemble.tasks.world.state import State, empty_state

LOG_ROUNDING = 5e-8
"""Half a unit of the last decimal of the recorded vertices [m]."""
DRIFT_LIMIT = 8e-4
"""A block that an arm has left farther beside the lattice [m] was pushed. Then it has also turned,
by an angle the log does not hold."""

Line = dict[str, Any]


VARIANTS = {
    "1mimic": "one-sided-3x3-22-24",
    "2wo": "two-sided-3x3-20-24",
    "4wo": "four-sided-3x3-10-18",
    "1wo": "bars-one-sided-5x5-25-27",
    "2more20": "objects21-two-sided-5x5-20-24",
    "1robo": "robot-one-sided-5x5-15-17",
    "2robo": "robot-two-sided-3x3-10-14",
    "4robo": "robot-four-sided-3x3-10-18",
    "2robomore": "robot-objects-two-sided-5x5-20-24",
}
"""The preset that each recorded environment is, but for its grid and number of nodes."""


def read_lines(path: Path) -> Iterator[Line]:
    """The JSON objects of a ``.jsonl`` or ``.jsonl.gz`` file.

    Raises:
        InputError: where the file is missing, unreadable or not lines of JSON objects.
    """
    for value in read_json_lines(path, "recording (.jsonl or .jsonl.gz)"):
        yield dict(value)


def is_real(line: Line) -> bool:
    """Whether a line is a step of an episode; logs without ``kind`` hold nothing else."""
    return line.get("kind", "real") == "real"


class Log:
    """The lines of one file, and the problem of each of its steps.

    Raises:
        InputError: for a file without lines.
        KeyError: for a line that has no step number.
    """

    def __init__(self, path: Path) -> None:
        self.lines = list(read_lines(path))
        if not self.lines:
            raise InputError("recorded transitions", path.name, "a file with at least one line")
        # A probe comes before the real step of the same state, which holds the problem.
        self.problems: dict[tuple[int, int], Line] = {
            (line["ep"], line["t"]): line for line in self.lines if is_real(line)
        }

    def placed_objects(self, line: Line) -> list[int]:
        """Number of the object that each placed block belongs to.

        The log tells the cells of an object while it waits and when it is placed; so the steps
        before this one are needed.
        """
        episode, step = line["ep"], line["t"]
        try:
            earlier = [self.problems[episode, t] for t in range(step)]
            first = len(earlier[0]["placed"]) if earlier else len(line["placed"])
        except KeyError:
            raise ValueError(f"episode {episode} lacks a step before {step}") from None
        sizes = [first, *(_num_members(one) for one in earlier)]
        numbers = [number for number, size in enumerate(sizes) for _ in range(size)]
        if len(numbers) != len(line["placed"]):
            raise ValueError(f"{len(line['placed'])} blocks placed, {len(numbers)} expected")
        return numbers


def _num_members(line: Line) -> int:
    """Number of cells of the object that is placed; logs with a robot do not list them."""
    if "grasp_variant" in line:
        return len(line["placed_after"]) - len(line["placed"])
    return len(line["members"])


def waiting_rows(line: Line, task: Task) -> list[list[float]]:
    """Nodes of the waiting blocks; with a robot, objects count where they were planned to be."""
    planned = task.objects != "cubes" and not task.touching
    return line["unplaced_info"] if planned else line["unplaced"]


def drifted(blocks: list[list[float]], pitch: float) -> bool:
    """Whether a block stands beside its place on the lattice."""
    places = np.asarray(blocks, float)[:, :2]
    return bool(np.abs(places - pitch * np.rint(places / pitch)).max() > DRIFT_LIMIT)


def waiting_objects(unplaced: list[list[float]]) -> list[int]:
    """Number of the object that each waiting block belongs to; a row lists its fellow cells."""
    numbers: list[int] = []
    while len(numbers) < len(unplaced):
        size = max(len(unplaced[len(numbers)]) - 3, 1)
        numbers += [len(numbers)] * size
    if len(numbers) != len(unplaced):
        raise ValueError("the last waiting object lacks cells")
    return numbers


class RecordedScene:
    """One world restored from a recorded line, with the targets of its episode."""

    def __init__(self, line: Line, task: Task) -> None:
        self.task, self.depths = task, FILTERS[task.cover_filter]
        frames = side_frames(task.num_sides, task.pitch, task.aisle)
        targets, sides = line["targets"], len(frames)
        if len(targets) != sides or any(not 3 <= len(side) <= 5 for side in targets):
            raise ValueError(f"targets are not {sides} outlines of 3 to 5 vertices")
        blocks = len(line["placed"]) + len(line["unplaced"]) + 1
        self.state: State = empty_state(1, sides, max(map(len, targets)), blocks)
        self.frames, self.mask_px = frames, list[int]()
        for side, points in enumerate(targets):
            c, s, tx, ty = frames[side]
            world = np.asarray(points, float)
            local_x = c * (world[:, 0] - tx) + s * (world[:, 1] - ty)
            self.state.vertices[0, side, : len(points)] = np.stack([local_x, world[:, 2]], -1)
            self.state.num_vertices[0, side] = len(points)
            outline = self.state.vertices[0, side]
            self.mask_px.append(paper_mask(outline, len(points), self.state.mask[0, side]))
        self.state.mask_rows[0] = 0, self.state.mask.shape[2]
        self.state.mask_pixels[0] = sum(self.mask_px)

    def rounding_explains(self, side: int, recorded: int) -> bool:
        """Whether the mask has the recorded size for vertices within the rounding of the log.

        Vertices are rounded to whole pixels, so one that lies on a pixel boundary up to the last
        decimal of the log may fall on either side of it.
        """
        count = int(self.state.num_vertices[0, side])
        outline = self.state.vertices[0, side]
        mask = np.empty_like(self.state.mask[0, side])
        for vertex, axis, sign in itertools.product(range(count), range(2), (-1, 1)):
            moved = outline.copy()
            moved[vertex, axis] += sign * LOG_ROUNDING
            if paper_mask(moved, count, mask) == recorded:
                self.state.mask[0, side] = mask
                return True
        return False

    def place(self, placed: list[list[float]], num_unplaced: int) -> State:
        """Put the recorded blocks; returns the state with both pixel sets computed."""
        count = len(placed)
        self.state.position[0] = 0.0
        self.state.position[0, :count] = placed
        self.state.num_placed[0], self.state.num_blocks[0] = count, count + num_unplaced
        recover_all(self.state, 0, self.frames, self.depths)
        count_row(self.state, 0)
        return self.state

    def group(self, placed: list[int], unplaced: list[list[float]]) -> None:
        """Say which blocks are one object, and where its waiting cells are."""
        count, total = len(placed), len(placed) + len(unplaced)
        self.state.object_id[0] = np.arange(len(self.state.object_id[0]))
        self.state.object_id[0, :count] = placed
        waiting = waiting_objects(unplaced)
        self.state.object_id[0, count:total] = [max(placed) + 1 + n for n in waiting]
        self.state.position[0, count:total] = [row[:3] for row in unplaced]
        if not self.task.touching:
            return  # An arm counts from the axes of the world, however its blocks stand.
        for number in set(placed):
            cells = [k for k, other in enumerate(placed) if other == number]
            self.state.quaternion[0, cells] = fit_tilt(self.state.position[0, cells])

    def counts(self) -> tuple[list[int], list[int]]:
        """Plane and complete pixels of every side."""
        mask, covered, occluded = self.state.mask[0], self.state.covered[0], self.state.occluded[0]
        seen = np.stack([mask & covered & ~occluded, mask & covered])
        plane, complete = np.bitwise_count(seen).sum((-1, -2), dtype=np.int64).tolist()
        return plane, complete


def fit_tilt(cells: np.ndarray) -> np.ndarray:
    """Orientation of an object from its cells, which logs hold without it: float64[4].

    The rotation that takes the object's lattice closest to ``cells`` (float64[n, 3] [m]), and of
    those the one that turns least; identity for a single cube.
    """
    offset = cells - cells[0]
    lattice = EDGE * np.rint(offset / EDGE)
    weak = 1e-9 * np.eye(3)
    u, _, vt = np.linalg.svd((offset - offset.mean(0)).T @ (lattice - lattice.mean(0)) + weak)
    r = u @ vt
    w = np.sqrt(max(1.0 + np.trace(r), 1e-9)) / 2
    x, y, z = r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]
    return np.array([w, x / (4 * w), y / (4 * w), z / (4 * w)])


EDGE_CASE, STUCK, JITTER, UNEXPLAINED = "edge", "stuck", "jitter", "unexplained"


def snap(centres: np.ndarray) -> np.ndarray:
    """Nearest lattice cells: recorded structures have drifted by less than a millimetre or two."""
    ground = np.array([0.0, 0.0, HALF])
    return EDGE * np.rint((centres - ground) / EDGE) + ground


def starts_or_ends_on_edge(centres: np.ndarray, object_id: np.ndarray, new: int) -> bool:
    """Whether it takes less than a millimetre to make this structure stand, or fall.

    Asked with the cells from ``new`` on, and without them: a bar that has begun to tip slowly goes
    on doing so. In both cases the recorded outcome is one of chance: the same bar at the same
    place, its centre of mass exactly above the edge of a cube, was recorded with summed speeds
    from 0.25 to 1.0 m/s.

    Args:
        centres: float64[n, 3] [m], the structure with the new object.
        object_id: int64[n].
        new: first cell of the new object.
    """
    cells = snap(centres)
    return any(
        _overhangs(cells[:count])
        and is_stable(cells[:count], object_id[:count], slack=BALANCE_TOLERANCE)
        and not is_stable(cells[:count], object_id[:count], slack=-BALANCE_TOLERANCE)
        for count in (new, len(cells))
    )


def _overhangs(cells: np.ndarray) -> bool:
    """Whether some cell of the lattice has nothing below it."""
    filled = {tuple(cell) for cell in np.rint(cells / HALF).astype(int).tolist()}
    return any(z > 1 and (x, y, z - 2) not in filled for x, y, z in filled)


def explain(
    centres: np.ndarray, object_id: np.ndarray, new: int, invalid: bool, speeds: list[float]
) -> str:
    """The class of a disagreement.

    Args:
        centres, object_id, new: see :func:`starts_or_ends_on_edge`.
        invalid: the recorded outcome.
        speeds: the recorded V of each block [m/s].

    Returns:
        ``edge``: see :func:`starts_or_ends_on_edge`; ``stuck``: nothing carries some block, but
        it touches others, where the published engine may let it hang; ``jitter``: only the sum of
        the speeds was over its limit, not that of any block; ``unexplained``.
    """
    if starts_or_ends_on_edge(centres, object_id, new):
        return EDGE_CASE
    cells = snap(centres)
    if not is_stable(cells, object_id, slack=BALANCE_TOLERANCE):
        contacts = find_contacts(cells, object_id)
        touched = np.union1d(contacts.body_a, contacts.body_b)
        return STUCK if len(touched) == len(np.unique(object_id)) + 1 else UNEXPLAINED
    if invalid and max(speeds, default=np.inf) <= RULES["block"]:
        return JITTER
    return UNEXPLAINED
