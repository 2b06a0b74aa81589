"""A problem with cubes as towers in the face planes: the rules of that game and a quick bound.

A structure is the list ``heights`` (int64[n], blocks on every place). It grows by one block on a
tower, or on the table beside one (protocol 5: a cube is valid on the table or on a cube, next to
a placed one). What it shows is a sum over towers and pairs of neighbours, because a ray meets the
cubes of two places of a side at most.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import njit

from learn2assemble.errors import InputError
from learn2assemble.simulator import Simulator
from learn2assemble.world.blocks import EDGE
from learn2assemble.world.design_pixels import MAX_COLUMN, tower_pixels
from learn2assemble.world.rules import DISCRETE, judge_counts
from learn2assemble.world.sides import to_world
from learn2assemble.world.state import State

Piece = tuple[float, int, float]
"""Beginning of a chain: index (negative, so that they sort), length, discounted reward."""


class Towers(NamedTuple):
    """``n`` places in the face planes; ``H`` is the greatest height looked at."""

    place: np.ndarray
    """int64[n, 2]: x, y [block edges, world], side by side, each from left to right as seen."""
    cap: np.ndarray
    """int64[n]: blocks above this show no open pixels, or there are not so many; at least 1, as any
    place may be passed."""
    low: np.ndarray
    """int64[n]: height at the start, 1 for the first block's tower, else 0."""
    beside: np.ndarray
    """int64[n, 3]: neighbouring places, -1 where there is none."""
    own: np.ndarray
    """int64[n, H + 1]: open mask pixels that a tower of that height shows."""
    shared: np.ndarray
    """int64[n, H + 1, H + 1]: of these, shown by the place before it (second index) as well."""
    counts: np.ndarray
    """int64[4]: A, c0, c_co at the start (protocol 3.4), number of blocks."""
    threshold: float
    """Delta."""

    @property
    def num_structures(self) -> int:
        """Number of height lists from ``low`` to ``cap``."""
        return int(np.prod((self.cap - self.low + 1).astype(object)))


def find_towers(simulator: Simulator, state: State, row: int) -> Towers:
    """The towers of a fresh problem.

    Open pixels are mask pixels not yet covered at the start. Places beyond the outermost ones with
    open pixels are left out: passing them is never shorter than staying.

    Raises:
        InputError: for more than two sides, a scaled reward, or a problem that is not fresh.
    """
    task = simulator.task
    if task.num_sides > 2:
        raise InputError("num_sides", task.num_sides, "1 or 2 for exact returns")
    if task.reward != "discrete":
        raise InputError("reward", task.reward, "'discrete' for exact returns")
    if state.num_placed[row] != 1:
        raise InputError("num_placed", int(state.num_placed[row]), "1, a fresh problem")
    seen = tower_pixels() & (state.mask[row] & ~state.covered[row])[:, None, None]
    own = np.bitwise_count(seen).sum((-1, -2), dtype=np.int64)
    useful = np.argmax(own == own[..., -1:], -1)
    x, y = _places(simulator.frames)
    start = np.rint(state.position[row, 0, :2] / EDGE).astype(np.int64)
    first = (x == start[0]) & (y == start[1])
    inside = x[(useful > 0) | first]
    kept = np.argwhere((x >= inside.min()) & (x <= inside.max()))
    side, column = kept.T
    place = np.stack([x[side, column], y[side, column]], -1)
    shared = np.zeros((len(kept), *own.shape[-1:] * 2), np.int64)
    for n in range(1, len(kept)):
        if side[n] == side[n - 1]:
            both = seen[side[n], column[n] - 1][:, None] & seen[side[n], column[n]][None]
            shared[n] = np.bitwise_count(both).sum((-1, -2))
    low = first[side, column].astype(np.int64)
    return Towers(
        place=place,
        cap=np.minimum(np.maximum(useful[side, column], 1), low + state.num_blocks[row] - 1),
        low=low,
        beside=_neighbours(place),
        own=own[side, column],
        shared=shared,
        counts=np.array(
            [
                state.mask_pixels[row],
                state.initial_pixels[row],
                state.complete_pixels[row],
                state.num_blocks[row],
            ]
        ),
        threshold=task.success_threshold,
    )


def _places(frames: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """World x and y [block edges] of every column of every side: int64[S, NUM_COLUMNS] each."""
    column = EDGE * np.arange(-MAX_COLUMN, MAX_COLUMN + 1)
    points = np.stack([to_world(f, column, 0 * column, 0 * column) for f in frames])
    index = np.rint(points[..., :2] / EDGE).astype(np.int64)
    return index[..., 0], index[..., 1]


def _neighbours(place: np.ndarray) -> np.ndarray:
    beside = np.full((len(place), 3), -1, np.int64)
    for n, p in enumerate(place):
        near = np.flatnonzero(np.abs(place - p).sum(-1) == 1)
        beside[n, : len(near)] = near
    return beside


@njit(cache=True)
def has_ended(towers, heights):
    """Whether the episode is over: success, or no blocks left (protocol 6.4)."""
    if heights.sum() >= towers.counts[3]:
        return True
    complete = towers.counts[2]
    for n in range(len(heights)):
        complete += towers.own[n, heights[n]]
        if n > 0:
            complete -= towers.shared[n, heights[n - 1], heights[n]]
    _, success = judge_counts(
        towers.counts[0], towers.counts[1], 0, 0, complete, True, DISCRETE, towers.threshold
    )
    return success


@njit(cache=True)
def gains(towers, heights, n):
    """Whether one more block on tower ``n`` shows pixels that are not yet shown."""
    h = heights[n]
    new = towers.own[n, h + 1] - towers.own[n, h]
    if n > 0:
        left = heights[n - 1]
        new -= towers.shared[n, left, h + 1] - towers.shared[n, left, h]
    if n + 1 < len(heights):
        right = heights[n + 1]
        new -= towers.shared[n + 1, h + 1, right] - towers.shared[n + 1, h, right]
    return new > 0


@njit(cache=True)
def is_in_reach(towers, heights, n):
    """Whether tower ``n`` can take a block: it stands already, or a neighbour does."""
    if heights[n] > 0:
        return True
    for near in towers.beside[n]:  # noqa: SIM110 (compiled)
        if near >= 0 and heights[near] > 0:
            return True
    return False


def tower_bound(towers: Towers, discount: float) -> float:
    """Upper bound on the return in closed form: towers grow independently, none waits.

    The order of levels within a tower remains, so supports without pixels delay. The best order of
    independent chains under discounting is by falling index, the greatest reward rate
    ``sum gamma^i r_i / sum gamma^i`` of a chain's beginning (Gittins), and is found by sorting.
    Success and pixels shared by neighbours are left out; the number of blocks limits the rewards.
    """
    chains = tower_chains(towers, discount)
    return merge_chains(chains, towers.low.tolist(), int(towers.counts[3]), discount)


def tower_chains(towers: Towers, discount: float) -> list[list[list[Piece]]]:
    """What is left of every tower (first index) from every height (second), cut into pieces."""
    return [
        [_pieces(own[h + 1 : cap + 1] > own[h:cap], discount) for h in range(cap + 1)]
        for own, cap in zip(towers.own, towers.cap, strict=True)
    ]


def merge_chains(
    chains: list[list[list[Piece]]], heights: Sequence[int], blocks: int, discount: float
) -> float:
    """:func:`tower_bound` from ``heights`` on; ``chains`` as of :func:`tower_chains`."""
    total, factor = 0.0, 1.0
    pieces = (piece for chain, h in zip(chains, heights, strict=True) for piece in chain[h])
    for _, length, value in sorted(pieces):
        total += factor * value
        factor *= discount**length
    left = blocks - sum(heights)
    return min(total, (1 - discount**left) / (1 - discount) if discount < 1 else float(left))


def _pieces(rewarded: np.ndarray, discount: float) -> list[Piece]:
    """A chain cut into beginnings of greatest index."""
    found, bits = [], rewarded.astype(float)
    while bits.any():
        weight = discount ** np.arange(len(bits))
        value = np.cumsum(weight * bits)
        rate = value / np.cumsum(weight)
        k = int(np.argmax(rate))
        found.append((-float(rate[k]), k + 1, float(value[k])))
        bits = bits[k + 1 :]
    return found
