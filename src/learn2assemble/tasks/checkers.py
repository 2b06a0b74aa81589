"""Placement checkers by name: physics, and the arm at its fidelities, which is a physics like any
other: what it cannot do is invalid.

Placements of a task without an arm are checked by ``static`` or ``rigid`` physics. With one, these
names mean the kinematic workcell with that check of balance; ``kinematic`` means ``static`` then,
``dynamic`` simulates arm and blocks together, and ``published`` is the fast mode of the authors.
This is the one place where the worlds of :mod:`learn2assemble.tasks.world` and the scenes of the
robot meet.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np

from learn2assemble.constants import HALF
from learn2assemble.errors import InputError, look_up
from learn2assemble.geometry.rotations import yaw_quaternion
from learn2assemble.registry import Registry
from learn2assemble.robot.grasps import QUARTER, GraspPair, along, get_grasps
from learn2assemble.robot.moves import Attempt, Move, Outcome, Scene, put_down
from learn2assemble.tasks.physics.protocol import ARM, Physics, PlacementVerdict
from learn2assemble.tasks.physics.static import StaticPhysics
from learn2assemble.tasks.task import Task
from learn2assemble.tasks.world.blocks import GRAVITY
from learn2assemble.tasks.world.rules import last_object
from learn2assemble.tasks.world.state import State


class Cell(Protocol):
    """A robot cell at one of its fidelities."""

    name: str

    def attempt(self, scene: Scene, move: Move) -> Attempt:
        """What becomes of a move; the scene is left alone."""
        ...


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
        self.cell = cell
        self.grasps = grasps
        self.balance = balance
        rigid = balance is not None and balance.name == "rigid"
        self.name: str = cell.name + ("+rigid" if rigid else "")
        self.moves_blocks: bool = balance is None or balance.moves_blocks
        self.last_attempts: list[Attempt | None] = []
        """What the arm did in each row of the last call of :meth:`settle`; None where balance
        alone decided."""
        self._before: tuple[State, np.ndarray] | None = None

    def prepare(self, state: State, rows: np.ndarray, actions: np.ndarray) -> None:
        """See :class:`Physics`: the places the objects wait at, and the attitudes asked for."""
        self._before = state.take(rows), actions[rows]

    def settle(self, state: State, rows: np.ndarray) -> np.ndarray:
        """See :class:`Physics`."""
        verdict = np.zeros(len(rows), np.int8)
        if self.balance is not None:
            verdict = self.balance.settle(state, rows)
        self.last_attempts = [None] * len(rows)
        for n in np.flatnonzero(verdict == PlacementVerdict.STABLE).tolist():
            scene, move = self.order(state, rows, n)
            attempt = self.last_attempts[n] = self.cell.attempt(scene, move)
            if attempt.outcome != Outcome.REACHED:
                verdict[n] = ARM + attempt.outcome
            if self.balance is None and attempt.after is not None:
                _write(state, int(rows[n]), put_down(scene, move), attempt.after)
        return verdict

    def order(self, state: State, rows: np.ndarray, n: int) -> tuple[Scene, Move]:
        """What row ``n`` of those prepared asks of the arm, once the object is at its place."""
        assert self._before is not None, "prepare comes first"
        (before, actions), row = self._before, int(rows[n])
        placed, count = int(before.num_placed[n]), int(before.num_blocks[n])
        chosen: list[int] = actions[n].tolist()
        unplaced, _, action = chosen
        scene = scene_of(
            before.position[n, :count],
            before.quaternion[n, :count],
            before.object_id[n, :count],
            placed,
        )
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


# ---------------------------------------------------------------- by name

BALANCE = {"static": "static", "rigid": "rigid", "kinematic": "static"}
"""What checks balance beside the kinematic workcell."""


# MuJoCo is loaded only by those who ask for it.


def _physics(name: str, task: Task) -> Physics:
    if name == "static":
        return StaticPhysics()
    from learn2assemble.tasks.physics.rigid import RigidPhysics

    return RigidPhysics(task.stability, pitch=task.pitch)


def _kinematic(name: str, task: Task) -> Physics:
    from learn2assemble.kinematics.cell import KinematicCell
    from learn2assemble.robot.arm import get_arm

    cell = KinematicCell(get_arm(task.arm), task.max_blocks)
    return ArmPhysics(cell, get_grasps(task.grasps), _physics(BALANCE[name], task))


def _dynamic(task: Task) -> Physics:
    from learn2assemble.handling.dynamic_cell import DynamicCell
    from learn2assemble.handling.rest import ONE_SIDED
    from learn2assemble.robot.arm import get_arm
    from learn2assemble.simulation.worlds import WorldForces

    rule = ONE_SIDED if task.num_sides == 1 else None
    # What the hand does where nothing is near changes nothing for the blocks.
    cell = DynamicCell(
        get_arm(task.arm),
        shift_rule=rule,
        skip_free_motion=True,
        forces=WorldForces(gravity=GRAVITY),
    )
    return ArmPhysics(cell, get_grasps(task.grasps))


CELLS: Registry[Callable[[Task], Physics]] = Registry("physics", {"dynamic": _dynamic})
"""Checkers that find out about balance themselves."""


def checker_names() -> tuple[str, ...]:
    """Every name that :func:`resolve_checker` knows."""
    return (*BALANCE, *CELLS)


def resolve_checker(checker: str | Physics | None, task: Task) -> Physics:
    """A checker by name, the one given, or by default static physics, with the task's arm if any.

    Raises:
        UnknownNameError: naming the nearest checker.
        InputError: for a robot cell where the task has no arm.
    """
    if checker is not None and not isinstance(checker, str):
        if not callable(getattr(checker, "settle", None)):
            raise InputError("physics", checker, "a name or a Physics")
        return checker
    name = "static" if checker is None else checker
    look_up("physics", name, dict.fromkeys(checker_names()))
    if not task.has_arm:
        if name not in ("static", "rigid"):
            raise InputError("physics", name, f"static or rigid ({task.name} has no arm)")
        return _physics(name, task)
    return CELLS[name](task) if name in CELLS else _kinematic(name, task)
