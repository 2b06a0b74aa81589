"""An arm as a physics: what it cannot do is invalid.

The one place where the worlds of :mod:`learn2assemble.world` and the scenes of the robot meet.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from learn2assemble.geometry.rotations import yaw_quaternion
from learn2assemble.physics.protocol import ARM, Physics, Verdict
from learn2assemble.robot.grasps import QUARTER, GraspPair, along
from learn2assemble.robot.moves import Attempt, Move, Outcome, Scene, put_down
from learn2assemble.world.blocks import HALF
from learn2assemble.world.rules import last_object
from learn2assemble.world.state import State


class Cell(Protocol):
    """A robot cell at one of its fidelities."""

    name: str

    def attempt(self, scene: Scene, move: Move) -> Attempt:
        """What becomes of a move; the scene is left alone."""
        ...


class _Before(NamedTuple):
    """Rows before a placement; arrays as in :class:`State`."""

    position: np.ndarray
    quaternion: np.ndarray
    object_id: np.ndarray
    num_placed: np.ndarray
    num_blocks: np.ndarray
    actions: np.ndarray


class ArmPhysics:
    """Implements :class:`Physics` for worlds that an arm builds.

    A placement is valid where ``balance`` says so and the arm can carry it out. A cell that
    simulates dynamics finds out about balance itself; where it does, ``balance`` is None.

    Args:
        cell: the robot cell.
        grasps: the (grasp, place) attitudes that way r of an action stands for.
        balance: the checker of stability, or None.
    """

    def __init__(
        self, cell: Cell, grasps: tuple[GraspPair, ...], balance: Physics | None = None
    ) -> None:
        self.cell, self.grasps, self.balance = cell, grasps, balance
        rigid = balance is not None and balance.name == "rigid"
        self.name = cell.name + ("+rigid" if rigid else "")
        self.moves_blocks = balance is None or balance.moves_blocks
        self.last_attempts: list[Attempt | None] = []
        """What the arm did in each row of the last call of :meth:`settle`; None where balance
        alone decided."""
        self._before: _Before | None = None

    def prepare(self, state: State, rows: np.ndarray, actions: np.ndarray) -> None:
        """See :class:`Physics`: the places the objects wait at, and the attitudes asked for."""
        self._before = _Before(
            state.position[rows], state.quaternion[rows], state.object_id[rows],
            state.num_placed[rows], state.num_blocks[rows], actions[rows],
        )  # fmt: skip

    def settle(self, state: State, rows: np.ndarray) -> np.ndarray:
        """See :class:`Physics`."""
        assert self._before is not None, "prepare comes first"
        if self.balance is None:
            verdict = np.zeros(len(rows), np.int8)
        else:
            verdict = self.balance.settle(state, rows)
        self.last_attempts = [None] * len(rows)
        for n in np.flatnonzero(verdict == Verdict.STABLE).tolist():
            scene, move = self.order(state, rows, n)
            attempt = self.last_attempts[n] = self.cell.attempt(scene, move)
            if attempt.outcome != Outcome.REACHED:
                verdict[n] = ARM + attempt.outcome
            if self.balance is None and attempt.after is not None:
                _write(state, int(rows[n]), put_down(scene, move), attempt.after)
        return verdict

    def order(self, state: State, rows: np.ndarray, n: int) -> tuple[Scene, Move]:
        """What row ``n`` of those prepared asks of the arm, once the object is at its place."""
        before, row = self._before, int(rows[n])
        assert before is not None
        placed, count = int(before.num_placed[n]), int(before.num_blocks[n])
        unplaced, _, action = before.actions[n].tolist()
        scene = scene_of(
            before.position[n, :count], before.quaternion[n, :count],
            before.object_id[n, :count], placed,
        )  # fmt: skip
        target = state.position[row, last_object(state, row)].copy()
        pair = self.grasps[action % len(self.grasps)]
        grasp = along(pair.grasp, float(scene.yaw[placed + unplaced]))
        return scene, Move(placed + unplaced, target, grasp, pair.place)


def scene_of(
    position: np.ndarray, quaternion: np.ndarray, object_id: np.ndarray, num_placed: int
) -> Scene:
    """A world as the robot sees it; waiting objects stand on the table.

    Args:
        position: float64[n, 3] [m]; quaternion: float64[n, 4]; object_id: int64[n].
    """
    position = position.copy()
    # Planned heights of waiting cells need not count from the centre of a cell.
    start = num_placed
    while start < len(position):
        stop = start + 1
        while stop < len(position) and object_id[stop] == object_id[start]:
            stop += 1
        position[start:stop, 2] += HALF - position[start:stop, 2].min()
        start = stop
    yaw = 2 * np.arctan2(quaternion[:, 3], quaternion[:, 0])
    return Scene(position, yaw, object_id.copy(), num_placed)


def _write(state: State, row: int, meant: Scene, real: Scene) -> None:
    """Where the cells really are, into a row whose placement has been proposed.

    Args:
        meant: the scene had everything gone as ordered; waiting objects keep their node positions
            unless they were pushed.
    """
    count, placed = len(real.position), real.num_placed
    state.position[row, :placed] = real.position[:placed]
    state.position[row, placed:count] += real.position[placed:] - meant.position[placed:]
    # A cube turned by a quarter is the same cube, and directions are those of its frame.
    yaw = real.yaw[:placed] - np.rint(real.yaw[:placed] / QUARTER) * QUARTER
    state.quaternion[row, :placed] = yaw_quaternion(yaw)
