"""MuJoCo models of blocks on the ground: one free body per object, one box per cell and filler.

The settings let exact structures rest:

- boxes are 0.15 mm thinner per side in x and y, so that neighbours do not rub, but not in z; with
  0.25 mm an overhang of exactly one half tips faster than it did in the published logs;
- contacts begin 20 um before the surfaces meet: without it a block that stands exactly on
  another falls freely for one step, and the tremor grows with the height (V, as defined in
  :mod:`learn2assemble.tasks.physics.rigid`, of a column of 12 / 45 cubes: 1.5 / 5.8, not 0.04 /
  0.08);
- solimp 0.998/0.9998: with 0.95/0.99 the same columns sink and reach V = 0.4 / 6.7;
- linear and angular damping of 10/s as published, without its quadratic part: an overhang of
  exactly one half then reaches V = 0.22 in 0.2 s, tilts by less than 1 mm and passes, as it did
  in most of the published logs;
- resting islands sleep where MuJoCo can: half the time, V within 0.002 and no other verdict.

The paper's rule of stability: place, simulate for 0.2 s, look at the speeds.
"""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import mujoco
import numpy as np

from learn2assemble.constants import EDGE, HALF
from learn2assemble.errors import InputError, UnknownNameError
from learn2assemble.robot.scene import (
    ContactSurface,
    add_ground,
    add_object,
    rotation_matrix,
    set_options,
)
from learn2assemble.tasks.physics.protocol import PlacementVerdict
from learn2assemble.tasks.physics.support import classify_cube, filler_centres
from learn2assemble.tasks.world.blocks import GRAVITY
from learn2assemble.tasks.world.rules import STABILITY
from learn2assemble.tasks.world.state import State

Layout = tuple[tuple[tuple[int, int, int], ...], ...]
"""Per object its cells in whole cells, relative to its first cell, in the object's frame."""

TIMESTEP = 0.004
SHRINK = 1.5e-4
"""How much thinner a box is on each side in x and y [m]."""
SURFACE = ContactSurface(margin=1e-5)
"""A pair pushes at the sum of both margins (at the larger before MuJoCo 3.5). MuJoCo 3.3 ignores
them between boxes, so tall columns fail there."""
DAMPING = 10.0
"""Linear and angular velocity decay [1/s]."""
CELL_TOLERANCE = 1e-3
"""How far a cell may be from its place in the object's own lattice [m]."""
_CUBE = ((0, 0, 0),)


class Grouping(NamedTuple):
    """How ``n`` cells make up ``b`` bodies."""

    layout: Layout
    body: np.ndarray
    """int64[n]: body of each cell; bodies are numbered by their first cell."""
    offset: np.ndarray
    """float64[n, 3]: cell centre in its body's frame [m], whose origin is the centre of mass."""
    lead: np.ndarray
    """int64[b]: first cell of each body."""


class Parts(NamedTuple):
    """What an object is made of; lengths in metres from its centre of mass, in its own frame."""

    cells: np.ndarray
    """float64[n, 3]: centres of its cells."""
    fillers: np.ndarray
    """float64[f, 3]: centres of what fills the gaps between them."""
    sizes: np.ndarray
    """float64[f, 3]: half edges of the fillers."""


def object_parts(cells: tuple[tuple[int, int, int], ...] | np.ndarray, pitch: float) -> Parts:
    """The object with the given cells (in whole cells) at a horizontal distance of ``pitch``."""
    lattice, spacing = np.asarray(cells, float), np.array([pitch, pitch, EDGE])
    between = np.rint(2 * filler_centres(spacing * lattice, HALF) / spacing) / 2
    # A filler lies off the lattice along the axis on which it fills a gap.
    sizes = np.full(between.shape, HALF)
    sizes[:, :2] = np.where(between[:, :2] % 1 == 0, HALF - SHRINK, (pitch - EDGE) / 2)
    centre = np.concatenate([lattice, between]).mean(0)
    return Parts(spacing * (lattice - centre), spacing * (between - centre), sizes)


def group_cells(
    position: np.ndarray, quaternion: np.ndarray, object_id: np.ndarray, pitch: float = EDGE
) -> Grouping:
    """Bodies of the given cells.

    Args:
        position: float64[n, 3] cell centres [m, world].
        quaternion: float64[n, 4] orientations (w, x, y, z), the same for all cells of an object.
        object_id: int64[n]; cells with the same number are one body.
        pitch: horizontal distance of neighbouring cells of an object [m].

    Raises:
        InputError: where the cells of an object are not on one lattice.
    """
    ids = object_id.tolist()
    count = len(ids)
    if len(set(ids)) == count:
        cells = np.arange(count)
        return Grouping((_CUBE,) * count, cells, np.zeros((count, 3)), cells)
    first: dict[int, int] = {}
    body = np.array([first.setdefault(k, len(first)) for k in ids])
    lead = np.array([ids.index(k) for k in first])
    offset = np.zeros((count, 3))
    layout = list[tuple[tuple[int, int, int], ...]]()
    spacing = np.array([pitch, pitch, EDGE])
    for number, head in enumerate(lead):
        cells = np.flatnonzero(body == number)
        relative = (position[cells] - position[head]) @ rotation_matrix(quaternion[head])
        lattice = np.rint(relative / spacing)
        if np.abs(relative - spacing * lattice).max() > CELL_TOLERANCE:
            raise InputError(
                f"object {ids[head]}",
                position[cells].tolist(),
                f"cells on one {100 * pitch:g} cm lattice",
            )
        layout.append(tuple((int(x), int(y), int(z)) for x, y, z in lattice))
        offset[cells] = object_parts(lattice, pitch).cells
    return Grouping(tuple(layout), body, offset, lead)


def build_spec(layout: Layout, timestep: float = TIMESTEP, pitch: float = EDGE) -> mujoco.MjSpec:
    """An editable scene: the ground and one free body ``object<k>`` per object.

    Args:
        layout: see :data:`Layout`.
        timestep: simulation step [s].
        pitch: horizontal distance of neighbouring cells of an object [m].
    """
    spec = mujoco.MjSpec()
    set_options(spec, timestep, mujoco.mjtIntegrator.mjINT_EULER, GRAVITY)
    add_ground(spec, "ground", SURFACE)
    for number, cells in enumerate(layout):
        parts = object_parts(cells, pitch)
        cube = np.array([[HALF - SHRINK, HALF - SHRINK, HALF]])
        places = np.concatenate([parts.cells, parts.fillers])
        sizes = np.concatenate([cube.repeat(len(parts.cells), 0), parts.sizes])
        add_object(spec, f"object{number}", zip(places, sizes, strict=True), SURFACE)
    return spec


@lru_cache(maxsize=256)
def compile_model(
    layout: Layout, timestep: float = TIMESTEP, pitch: float = EDGE
) -> mujoco.MjModel:
    """The compiled scene with damping; shared between callers, so do not change it."""
    model = build_spec(layout, timestep, pitch).compile()
    damping = model.dof_damping.reshape(-1, 6)
    damping[:, :3] = DAMPING * model.body_mass[1:, None]
    damping[:, 3:] = DAMPING * model.body_inertia[1:].mean(1, keepdims=True)
    return model


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
        self.threshold: float = RULES[rule] if threshold is None else threshold
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

    def _settle_row(self, state: State, row: int) -> PlacementVerdict:
        count = int(state.num_placed[row])
        position, quaternion = state.position[row, :count], state.quaternion[row, :count]
        object_id = state.object_id[row, :count]
        geometric = _classify_last(position, object_id)
        if geometric in (PlacementVerdict.OVERLAP, PlacementVerdict.BELOW_GROUND):
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
            return PlacementVerdict.STABLE
        return (
            PlacementVerdict.FLOATING
            if geometric == PlacementVerdict.FLOATING
            else PlacementVerdict.UNSTABLE
        )

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
                pose[number, :3] -= rotation_matrix(quaternion[head]) @ group.offset[head]
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
                position[cell] += rotation_matrix(pose[number, 3:]) @ group.offset[cell]
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


def _classify_last(position: np.ndarray, object_id: np.ndarray) -> PlacementVerdict:
    """Geometric verdict on the object of the last cell; UNDECIDED unless it is plain."""
    mine = object_id == object_id[-1]
    others = np.ascontiguousarray(position[~mine])
    found = {
        classify_cube(others, len(others), x, y, z, HALF) for x, y, z in position[mine].tolist()
    }
    for plain in (PlacementVerdict.OVERLAP, PlacementVerdict.BELOW_GROUND):
        if plain in found:
            return plain
    return (
        PlacementVerdict.FLOATING
        if found == {int(PlacementVerdict.FLOATING)}
        else PlacementVerdict.UNDECIDED
    )
