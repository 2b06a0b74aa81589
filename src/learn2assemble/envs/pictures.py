"""Pictures in place of states: what a camera or a drawing would show, as ``uint8[H, W, 3]``.

The three channels are what is *wanted*, what is *there*, and what *waits*. Panels stand side by
side, see the classes; each has its own scale. ``boxes`` float32[A, P, 4] tells what the numbers of
actions mean, in the picture as well: where the block of an action would be in each of the P panels
that show the structure (top, left, bottom, right [px]); zeros where it would not be seen there, and
for what is no placement.
"""

from __future__ import annotations

from typing import Any, Protocol

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs

from learn2assemble.constants import HALF
from learn2assemble.envs import hidden
from learn2assemble.envs.actions import PlacementActions
from learn2assemble.envs.assembly import WAITING_REACH, AssemblyEnv
from learn2assemble.envs.designs import DesignEnv
from learn2assemble.envs.drawing import ground_pixels
from learn2assemble.envs.hidden import HiddenEnv
from learn2assemble.errors import InputError
from learn2assemble.tasks.world.coverage import IMAGE_SIZE, project, to_pixels

WANTED, THERE, WAITING = range(3)
"""Channels."""
HIDDEN_SIZE, HIDDEN_PIXEL = 128, 0.01
"""Edge of a panel of a task with hidden errors [px], and of its pixels [m]; what covers a pixel in
part makes it as bright, so that a tenth of a pixel shows."""
_FULL = 255


class Pictures(Protocol):
    """Pictures of an environment as it is now.

    Attributes:
        space: of what :meth:`observe` gives.
    """

    space: spaces.Dict

    def observe(self) -> dict[str, np.ndarray]:
        """``picture`` and ``boxes``."""
        ...


class PlacementPictures:
    """Of a task of placements: an elevation for each side of the target, as its camera sees it, and
    a plan, 2.5 m wide, of what has been placed and what waits.

    In an elevation, what stands in front of the plane of the face is half as bright.

    Raises:
        InputError: for flat actions, which name nodes of a graph.
    """

    def __init__(self, env: AssemblyEnv) -> None:
        if not isinstance(env.numbering, PlacementActions):
            raise InputError("actions", "flat", "actions='placements' where pictures are seen")
        self.env = env
        self.actions: PlacementActions = env.numbering
        sides = env.task.num_sides
        self.space: spaces.Dict = _space(
            (IMAGE_SIZE, IMAGE_SIZE * (sides + 1)), env.numbering.size, sides
        )

    def observe(self) -> dict[str, np.ndarray]:
        """See :class:`Pictures`."""
        env, size = self.env, IMAGE_SIZE
        state, sides = env.state, env.task.num_sides
        mask, covered, occluded = (
            to_pixels(image[0]) for image in (state.mask, state.covered, state.occluded)
        )
        picture = np.zeros((size, size * (sides + 1), 3), np.uint8)
        # The ground hides the lowest pixels of a target; these count as covered.
        there = covered & (mask | ~ground_pixels(env.simulator.depths))
        shown = np.where(occluded & there, _FULL // 2, _FULL * there).astype(np.uint8)
        for side in range(sides):
            panel = picture[:, size * side : size * (side + 1)]
            panel[..., WANTED] = _FULL * mask[side]
            panel[..., THERE] = shown[side]
        plan = picture[:, size * sides :]
        scale, count = size / (2 * WAITING_REACH), int(state.num_placed[0])
        for k, place in enumerate(state.position[0, : state.num_blocks[0], :2].tolist()):
            column, row = (round(scale * (v + WAITING_REACH - HALF)) for v in place)
            edge = max(round(2 * HALF * scale), 1)
            part = plan[max(row, 0) : max(row + edge, 0), max(column, 0) : max(column + edge, 0)]
            part[..., THERE if k < count else WAITING] = _FULL
        return {"picture": picture, "boxes": self._boxes()}

    def _boxes(self) -> np.ndarray:
        self.env.look()
        middle = self.actions.describe()[0].astype(float)
        boxes = np.zeros((len(middle), self.env.task.num_sides, 4), np.float32)
        used = self.env.action_masks()
        for side, (cos, sin, tx, ty) in enumerate(self.env.simulator.frames.tolist()):
            x, y = middle[:, 0] - tx, middle[:, 1] - ty
            along, across = cos * x + sin * y, cos * y - sin * x
            left, top = project(along - HALF, middle[:, 2] + HALF)
            right, bottom = project(along + HALF, middle[:, 2] - HALF)
            seen = used & (np.abs(across) < HALF)
            box = np.clip(np.stack([top, left, bottom, right], 1), 0, IMAGE_SIZE)
            boxes[seen, side] = box[seen] + [0, IMAGE_SIZE * side, 0, IMAGE_SIZE * side]
        return boxes


class DesignPictures:
    """Of a task of random designs: plan, front and side, a pixel for each line of cells, as bright
    as many of them are wanted or filled; and the heap, a bar for each kind of its kit, a pixel for
    each block, full where there is no limit."""

    def __init__(self, env: DesignEnv) -> None:
        self.env = env
        self.size: int = env.task.extent
        self.space: spaces.Dict = _space((self.size, 4 * self.size), env.task.max_candidates, 3)

    def observe(self) -> dict[str, np.ndarray]:
        """See :class:`Pictures`."""
        size, world = self.size, self.env.world
        assert world is not None
        wanted = world.site.wanted
        picture = np.zeros((size, 4 * size, 3), np.uint8)
        filled = (world.owner >= 0).reshape(wanted.shape)
        for channel, cells in (WANTED, wanted), (THERE, filled):
            for panel, axis in enumerate((2, 1, 0)):
                seen = cells.sum(axis).T * _FULL // size
                rows = seen if axis == 2 else seen[::-1]
                top = 0 if axis == 2 else size - len(rows)
                left = panel * size
                picture[top : top + rows.shape[0], left : left + rows.shape[1], channel] = rows
        height = max(size // len(world.heap), 1)
        for kind, left in enumerate(world.heap.tolist()):
            row, count = height * kind, size if left < 0 else min(left, size)
            bar = picture[row : row + max(height - 1, 1), 3 * size : 3 * size + count]
            bar[..., WAITING] = _FULL
        return {"picture": picture, "boxes": self._boxes()}

    def _boxes(self) -> np.ndarray:
        size, world, offered = self.size, self.env.world, self.env.offered
        assert world is not None
        found = world.site.found
        extent = np.array([np.max(way.cells, axis=0) + 1 for way in found.ways])
        low = found.origin[offered]
        high = low + extent[found.way[offered]]
        boxes = np.zeros((self.env.task.max_candidates, 3, 4), np.float32)
        boxes[: len(offered)] = _three_views(low, high, size)
        return boxes


class HiddenPictures:
    """Of a task with hidden errors: plan, front and side of the places of all blocks, of those that
    stand where they are believed to be (as they were seen, else as they were put down; turns do not
    show), and the places of those that wait."""

    def __init__(self, env: HiddenEnv) -> None:
        self.env = env
        shape = (HIDDEN_SIZE, 3 * HIDDEN_SIZE)
        self.space: spaces.Dict = _space(shape, env.actions.count, 3)

    def observe(self) -> dict[str, np.ndarray]:
        """See :class:`Pictures`."""
        rows: np.ndarray = self.env.observe()["blocks"].astype(float)
        rows = rows[rows[:, hidden.THERE] > 0]
        stands, seen = rows[:, hidden.STANDS] > 0, rows[:, hidden.SEEN] > 0
        off: np.ndarray = np.where(
            seen[:, None], rows[:, hidden.MEASURED], rows[:, hidden.COMMANDED]
        )[:, :2]
        more = np.append(off, np.zeros((len(off), 1)), 1) / 1e3
        place = _views(rows[:, hidden.MIDDLE], rows[:, hidden.SIZE])
        real = rows[:, hidden.SIZE].copy()
        real[:, :2] += rows[:, hidden.EXTENT] / 1e3
        believed = _views(rows[:, hidden.MIDDLE] + more, real)
        picture = np.zeros((HIDDEN_SIZE, 3 * HIDDEN_SIZE, 3), np.uint8)
        for channel, boxes in (
            (WANTED, place),
            (THERE, believed[stands]),
            (WAITING, place[~stands]),
        ):
            for box in boxes.reshape(-1, 4):
                _shade(picture[..., channel], box)
        table = np.zeros((self.env.actions.count, 3, 4), np.float32)
        table[: len(place)] = place
        return {"picture": picture, "boxes": table}


def pictures_of(env: gymnasium.Env[Any, Any]) -> Pictures:
    """The pictures of an environment.

    Raises:
        InputError: for one that has none: the goals.
    """
    plain: Any = env.unwrapped
    if isinstance(plain, AssemblyEnv):
        return PlacementPictures(plain)
    if isinstance(plain, DesignEnv):
        return DesignPictures(plain)
    if isinstance(plain, HiddenEnv):
        return HiddenPictures(plain)
    name = getattr(getattr(plain, "task", None), "name", type(plain).__name__)
    raise InputError("pictures of", name, "a task of placements, designs or hidden errors")


class PictureObservation(
    gymnasium.ObservationWrapper[dict[str, np.ndarray], np.int64, dict[str, Any]],
    RecordConstructorArgs,
):
    """An environment whose observations are pictures.

    Args:
        env: of placements with ``actions="placements"``, of designs, or with hidden errors.

    Raises:
        InputError: for another one.
    """

    def __init__(self, env: gymnasium.Env[dict[str, Any], np.int64]) -> None:
        RecordConstructorArgs.__init__(self)
        gymnasium.ObservationWrapper.__init__(self, env)
        self._pictures = pictures_of(env)
        self.observation_space: spaces.Dict = self._pictures.space

    def observation(self, observation: dict[str, Any]) -> dict[str, np.ndarray]:
        """The picture of the state that it is of."""
        return self._pictures.observe()

    def action_masks(self) -> np.ndarray:
        """bool[A]: the legal actions, as maskable algorithms ask for them."""
        plain: Any = self.env.unwrapped
        return plain.action_masks()


def _space(shape: tuple[int, int], actions: int, panels: int) -> spaces.Dict:
    return spaces.Dict(
        {
            "picture": spaces.Box(0, _FULL, (*shape, 3), np.uint8),
            "boxes": spaces.Box(0.0, float(max(shape)), (actions, panels, 4), np.float32),
        }
    )


def _three_views(low: np.ndarray, high: np.ndarray, size: int) -> np.ndarray:
    """float64[n, 3, 4]: boxes in plan, front and side, from corners in pixels, z up."""
    (x, y, z), (right, back, top) = low.T, high.T
    views = [
        (y, x, back, right),
        (size - top, size + x, size - z, size + right),
        (size - top, 2 * size + y, size - z, 2 * size + back),
    ]
    return np.stack([np.stack(view, 1) for view in views], 1).astype(float)


def _views(middle: np.ndarray, size: np.ndarray) -> np.ndarray:
    """The same of blocks in the world [m]."""
    low, high = (
        (middle + sign * size / 2) / HIDDEN_PIXEL + [HIDDEN_SIZE / 2, HIDDEN_SIZE / 2, 0]
        for sign in (-1, 1)
    )
    low, high = np.clip(low, 0, HIDDEN_SIZE), np.clip(high, 0, HIDDEN_SIZE)
    return _three_views(low, high, HIDDEN_SIZE)


def _shade(image: np.ndarray, box: np.ndarray) -> None:
    """Make pixels as bright as a box covers them, in place."""
    top, left, bottom, right = box.tolist()
    rows = np.arange(int(top), min(int(np.ceil(bottom)), image.shape[0]))
    columns = np.arange(int(left), min(int(np.ceil(right)), image.shape[1]))
    down = np.minimum(rows + 1, bottom) - np.maximum(rows, top)
    along = np.minimum(columns + 1, right) - np.maximum(columns, left)
    part = image[int(top) : int(top) + len(rows), int(left) : int(left) + len(columns)]
    np.maximum(part, np.round(_FULL * np.outer(down, along)).astype(np.uint8), out=part)
