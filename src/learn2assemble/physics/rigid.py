"""The paper's rule of stability: place, simulate for 0.2 s, look at the speeds (protocol 6.1)."""

# The compiled module has no stubs that pyright finds.
# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

import mujoco
import numpy as np

from learn2assemble.errors import InputError, UnknownNameError
from learn2assemble.geometry.boxes import classify_cube
from learn2assemble.physics.mjcf import TIMESTEP, Grouping, compile_model, group_cells, rotation
from learn2assemble.physics.protocol import Verdict
from learn2assemble.world.blocks import EDGE, HALF
from learn2assemble.world.rules import STABILITY
from learn2assemble.world.state import State

SETTLE_STEPS = 50
RULES = STABILITY
"""Rules by name, with the published thresholds [m/s]."""
STILL_SPEED = 0.1
"""Rule ``object``: a chosen block that rises or falls faster [m/s] is waited for ..."""
WAIT_STEPS = 200
"""... so many steps at most."""
HEIGHT_LIMIT = 1e-3
"""Rule ``object``: the cells of the new object keep their heights, relative to each other [m]."""
SHIFT_LIMIT = 0.01
"""Rule ``object``: no earlier block may move by so much in x and y [m]."""
_MAX_WORLDS = 64


class RigidPhysics:
    """MuJoCo settle of the block placed last.

    With V_b the sum over the settle steps of |vx| + |vy| + |vz| of block b [m/s], counted at the
    published step of 4 ms, a placement is invalid where max_b V_b exceeds the threshold (``rule``
    "block"), or where the sum of V_b over all blocks does ("sum"; the published rule for cubes,
    which grows with the number of blocks). The rule "object" is "block", then waits until the
    chosen block no longer rises or falls, and also fails where the new object tilts or an earlier
    block shifts (the published rule for objects of several cells).

    Every settle starts at the poses of the state, at rest and without memory of an earlier one,
    so a step is a pure function of the state. One instance serves one thread.

    Args:
        rule: ``block``, ``sum`` or ``object``.
        threshold: limit on V [m/s]; the published one of the rule by default.
        settle_steps: number of steps simulated.
        timestep: length of a step [s].
        pitch: horizontal distance of neighbouring cells of an object [m].

    Raises:
        UnknownNameError: for another rule.
        InputError: for a value that is not positive.
    """

    name = "rigid"
    moves_blocks = True

    def __init__(
        self,
        rule: str = "block",
        threshold: float | None = None,
        settle_steps: int = SETTLE_STEPS,
        timestep: float = TIMESTEP,
        pitch: float = EDGE,
    ) -> None:
        if rule not in RULES:
            raise UnknownNameError("rule", rule, RULES)
        self.rule = rule
        self.threshold = RULES[rule] if threshold is None else threshold
        self.settle_steps = settle_steps
        self.timestep = timestep
        self.pitch = pitch
        for what in ("threshold", "settle_steps", "timestep", "pitch"):
            if not getattr(self, what) > 0:
                raise InputError(what, getattr(self, what), "a positive number")
        self.last_speed_sums: list[np.ndarray] = []
        """V_b of every placed block (float64[num_placed]) of each row of the last call of
        :meth:`settle`; empty where geometry alone decided."""
        self._worlds: dict[object, mujoco.MjData] = {}

    def __getstate__(self) -> dict[str, object]:
        return {**self.__dict__, "_worlds": {}}

    def prepare(self, state: State, rows: np.ndarray, actions: np.ndarray) -> None:
        """Nothing: only where the object comes to matters."""

    def settle(self, state: State, rows: np.ndarray) -> np.ndarray:
        """Verdict on the object placed last of each row; moves the placed blocks of the row.

        An occupied cell and one below the ground are facts of geometry: nothing is simulated and
        nothing moves. FLOATING is reported where the simulation fails and nothing was below the
        object. See :class:`Physics`.

        Raises:
            InputError: where cells of one object are not on one lattice.
        """
        verdict = np.empty(len(rows), np.int8)
        self.last_speed_sums = []
        for n, row in enumerate(rows):
            verdict[n] = self._settle_row(state, int(row))
        return verdict

    def _settle_row(self, state: State, row: int) -> Verdict:
        count = int(state.num_placed[row])
        position, quaternion = state.position[row, :count], state.quaternion[row, :count]
        object_id = state.object_id[row, :count]
        geometric = _classify_last(position, object_id)
        if geometric in (Verdict.OVERLAP, Verdict.BELOW_GROUND):
            self.last_speed_sums.append(np.empty(0))
            return geometric
        before = position.copy()
        speeds = self._simulate(position, quaternion, object_id)
        self.last_speed_sums.append(speeds)
        total = speeds.sum() if self.rule == "sum" else speeds.max()
        # Written so that a simulation that diverged (NaN) fails.
        if total <= self.threshold and (
            self.rule != "object" or _kept_place(before, position, object_id)
        ):
            return Verdict.STABLE
        return Verdict.FLOATING if geometric == Verdict.FLOATING else Verdict.UNSTABLE

    def _simulate(
        self, position: np.ndarray, quaternion: np.ndarray, object_id: np.ndarray
    ) -> np.ndarray:
        """Settle the given cells in place; returns V_b, float64[n]."""
        group = group_cells(position, quaternion, object_id, self.pitch)
        data = self._world(group)
        model = data.model
        pose = data.qpos.reshape(-1, 7)
        mujoco.mj_resetData(model, data)
        pose[:, :3] = position[group.lead]
        pose[:, 3:] = quaternion[group.lead]
        several = len(group.lead) < len(group.body)
        if several:
            for number, head in enumerate(group.lead):
                pose[number, :3] -= rotation(quaternion[head]) @ group.offset[head]
        velocity = np.empty((self.settle_steps, len(pose), 6))
        turn = np.empty((self.settle_steps, len(pose), 3, 3)) if several else None
        flat_velocity, now = velocity.reshape(self.settle_steps, -1), data.qvel
        matrices = data.xmat.reshape(-1, 3, 3)[1:]
        for k in range(self.settle_steps):
            mujoco.mj_step(model, data)
            flat_velocity[k] = now
            if turn is not None:
                turn[k] = matrices
        if self.rule == "object":
            _wait(model, data, int(group.body[np.argmax(object_id == object_id[-1])]))
        if not (np.isfinite(velocity).all() and np.isfinite(pose).all()):
            return np.full(len(position), np.nan)
        position[:], quaternion[:] = pose[group.body, :3], pose[group.body, 3:]
        speed = velocity[:, group.body, :3]
        if turn is not None:
            # A cell also moves with its object's rotation, which MuJoCo gives in the body's frame.
            swing = np.cross(velocity[:, group.body, 3:], group.offset)
            speed = speed + np.einsum("kcij,kcj->kci", turn[:, group.body], swing)
            for cell, number in enumerate(group.body):
                position[cell] += rotation(pose[number, 3:]) @ group.offset[cell]
        return np.abs(speed).sum((0, 2)) * (self.timestep / TIMESTEP)

    def _world(self, group: Grouping) -> mujoco.MjData:
        data = self._worlds.get(group.layout)
        if data is None:
            if len(self._worlds) >= _MAX_WORLDS:
                self._worlds.pop(next(iter(self._worlds)))
            data = mujoco.MjData(compile_model(group.layout, self.timestep, self.pitch))
            self._worlds[group.layout] = data
        return data


def _wait(model: mujoco.MjModel, data: mujoco.MjData, body: int) -> None:
    """Go on until ``body`` no longer rises or falls."""
    vertical = data.qvel[6 * body + 2 : 6 * body + 3]
    for _ in range(WAIT_STEPS):
        if not abs(vertical[0]) > STILL_SPEED:
            return
        mujoco.mj_step(model, data)


def _kept_place(before: np.ndarray, after: np.ndarray, object_id: np.ndarray) -> bool:
    """Whether the last object kept its attitude and the others their places, rule ``object``."""
    mine = object_id == object_id[-1]
    sunk = after[mine, 2] - before[mine, 2]
    shift = np.linalg.norm(after[~mine, :2] - before[~mine, :2], axis=1)
    return bool(np.ptp(sunk) <= HEIGHT_LIMIT and (shift < SHIFT_LIMIT).all())


def _classify_last(position: np.ndarray, object_id: np.ndarray) -> Verdict:
    """Geometric verdict on the object of the last cell; UNDECIDED unless it is plain."""
    mine = object_id == object_id[-1]
    others = np.ascontiguousarray(position[~mine])
    found = {
        classify_cube(others, len(others), x, y, z, HALF) for x, y, z in position[mine].tolist()
    }
    for plain in (Verdict.OVERLAP, Verdict.BELOW_GROUND):
        if plain in found:
            return plain
    return Verdict.FLOATING if found == {int(Verdict.FLOATING)} else Verdict.UNDECIDED
