"""Flat actions, and masks over them."""

from __future__ import annotations

import numpy as np
from numba import njit

from learn2assemble.tasks.task import Task
from learn2assemble.tasks.world.state import State


def num_flat_actions(task: Task) -> int:
    """N * N * Na, the size of the flat action space and of both masks."""
    return task.num_nodes * task.num_nodes * task.num_actions


def flatten_action(task: Task, i, j, k):
    """(i, j, k) to the flat index; integers or arrays of one shape."""
    return (i * task.num_nodes + j) * task.num_actions + k


def unflatten_action(task: Task, action):
    """Flat index to (i, j, k); an integer or an array."""
    pair, k = divmod(action, task.num_actions)
    i, j = divmod(pair, task.num_nodes)
    return i, j, k


# These two take single fields: handing a whole State to compiled code costs more than the work.
@njit(cache=True)
def _resolve(num_vertices, num_placed, num_blocks, flat, num_nodes, num_actions, actions, clipped):
    for row in range(len(flat)):
        targets = num_vertices[row].sum()
        placed, blocks = num_placed[row], num_blocks[row]
        pair = flat[row] // num_actions
        i, j = pair // num_nodes - targets - placed, pair % num_nodes - targets
        unplaced = max(min(i, blocks - placed - 1), 0)
        reference = max(min(j, placed - 1), 0)
        actions[row, 0], actions[row, 1] = unplaced, reference
        actions[row, 2] = flat[row] % num_actions
        clipped[row] = unplaced != i or reference != j


@njit(cache=True)
def _fill(num_vertices, num_placed, num_blocks, terminated, allowed, mask):
    last = allowed.shape[1] - 1
    for row in range(len(mask)):
        if terminated[row]:
            continue
        targets = num_vertices[row].sum()
        placed, blocks = num_placed[row], num_blocks[row]
        for i in range(targets + placed, targets + blocks):
            for j in range(placed):
                for k in range(mask.shape[3]):
                    mask[row, i, targets + j, k] = allowed[
                        row, min(i - targets - placed, last), j, k
                    ]


def resolve_actions(task: Task, state: State, flat: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Flat actions to what :meth:`Simulator.step` wants, clipped like the published code.

    An i outside the unplaced nodes becomes the nearest of them, likewise j and the placed nodes.

    Args:
        flat: int64[B], each in ``0..N*N*Na-1``.

    Returns:
        int64[B, 3] (number of the unplaced block, number of the reference block, action) and
        bool[B], where clipping changed the action.
    """
    actions = np.empty((len(flat), 3), np.int64)
    clipped = np.empty(len(flat), np.bool_)
    _resolve(
        state.num_vertices,
        state.num_placed,
        state.num_blocks,
        flat,
        task.num_nodes,
        task.num_actions,
        actions,
        clipped,
    )
    return actions, clipped


def expand_mask(task: Task, state: State, allowed: np.ndarray) -> np.ndarray:
    """A mask over placements as a mask over flat actions.

    Args:
        allowed: bool[B, M, Na] over (reference, action), where any unplaced block may go, or
            bool[B, M, M, Na] over (unplaced block, reference, action); see
            :meth:`Simulator.physics_mask`.

    Returns:
        bool[B, N * N * Na]; all False for worlds that have ended.
    """
    n = task.num_nodes
    mask = np.zeros((state.batch_size, n, n, task.num_actions), np.bool_)
    if allowed.ndim == 3:
        allowed = allowed[:, None]
    _fill(state.num_vertices, state.num_placed, state.num_blocks, state.terminated, allowed, mask)
    return mask.reshape(state.batch_size, -1)
