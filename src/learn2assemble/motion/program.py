"""What a robot is told: a motion through all time, within the limits, and states of its tool.

The record of a build holds joint positions and velocities every 20 ms. Between two samples a
program follows the quintic with their positions, velocities and accelerations, where the
accelerations are those that make the jerk continuous (which is the least squared jerk through the
samples). A part of the motion from rest to rest that breaks a limit somewhere is played slower as a
whole: its path stays what it was. Positions, velocities, accelerations and jerks are bounded
between the samples, too, by the control points of the polynomials, which contain them.
"""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

import math
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from learn2assemble.errors import InputError
from learn2assemble.geometry.hulls import Hull
from learn2assemble.geometry.rotations import (
    matrix_quaternion,
    quaternion_matrix,
    yaw_quaternion,
)
from learn2assemble.motion.knots import REST, Knots, fit, slow_down
from learn2assemble.motion.record import ArmFacts, BuildRecord, ByHand, Samples, require_sound
from learn2assemble.robot.arm import Arm, arm_model, get_arm
from learn2assemble.robot.moves import DENSITY, STAGES, Outcome

LOAD_TIME = 0.1
"""In which the controller takes over another load [s]: at once, the arm would jump."""


class ToolState(NamedTuple):
    """What the tool is told from some time on."""

    time: float
    """[s]"""
    width: float
    """Opening between the pads of a gripper to go to [m]; where ``force`` is given, the width of
    what it closes on."""
    speed: float
    """Of the opening [m/s]."""
    force: float
    """To hold with [N]; 0: only move."""
    vacuum: bool
    """Of a suction tool."""
    load: float
    """Mass at the tool the controller is told of [kg]."""


class ProgramStep(NamedTuple):
    """An attempt to pick up an object and to put it down."""

    number: int
    cells: tuple[int, ...]
    """Of the object, the grasped one first."""
    target: np.ndarray
    """float64[7]: pose the grasped cell shall have."""
    end: float
    """When the attempt is over [s]."""
    reached: bool
    """Whether it went as ordered."""
    checks: tuple[float, ...]
    """When the object has to be in the hand [s]: lifted, and over its place; none where the
    attempt failed."""
    held: tuple[float, float] | None
    """When the object begins and ceases to follow the hand [s]."""
    after: np.ndarray | None = None
    """float64[C, 7]: poses of all cells after the step, as in :class:`Blocks`; None where that was
    not told."""


class Supply(NamedTuple):
    """A magazine presents a block, or takes one back."""

    time: float
    """[s]"""
    cells: tuple[int, ...]
    poses: np.ndarray
    """float64[m, 7]: where they are from then on; below the table: in a magazine."""


class Blocks(NamedTuple):
    """The cells of a build: each is one box."""

    objects: tuple[tuple[int, ...], ...]
    """Cells of every rigid object."""
    edge: float
    """Of a cube [m]."""
    half: np.ndarray | None
    """float64[C, 3]: half extents of the boxes [m]; None: all are cubes of that edge."""
    start: np.ndarray
    """float64[C, 7]: poses before the program: x, y, z [m, world], quaternion (w, x, y, z). What
    is below the table waits in a magazine."""
    end: np.ndarray
    """The same at its end."""
    supply: tuple[Supply, ...] = ()
    """In the order of their times."""
    density: np.ndarray | None = None
    """float64[C] of the cells [kg/m3]; None: that of the cubes."""
    hull: tuple[Hull | None, ...] | None = None
    """Of each cell about its centre, where it is no box; None: all are boxes."""

    @property
    def halves(self) -> np.ndarray:
        """float64[C, 3]: half extents of all boxes [m]."""
        return np.full((len(self.start), 3), self.edge / 2) if self.half is None else self.half

    def mass(self, cells: Sequence[int]) -> float:
        """Of some cells [kg]."""
        density = DENSITY if self.density is None else self.density[list(cells)]
        volume = 8 * self.halves[list(cells)].prod(1)
        for k, cell in enumerate(cells):
            hull = None if self.hull is None else self.hull[cell]
            volume[k] = volume[k] if hull is None else hull.volume
        return float((density * volume).sum())

    def middles(self, cells: Sequence[int], poses: np.ndarray) -> np.ndarray:
        """float64[m, 3]: centres of mass of some cells at poses float64[C, 7] of all [m]."""
        found = poses[list(cells), :3].copy()
        for k, cell in enumerate(cells):
            hull = None if self.hull is None else self.hull[cell]
            if hull is not None:
                found[k] += quaternion_matrix(poses[cell, 3:]) @ hull.centroid
        return found


@dataclass(frozen=True, eq=False)
class Program:
    """All a robot is told during a build."""

    arm: str
    """Name of the arm."""
    tool: str
    """Name of the tool."""
    suction: bool
    """Whether it holds by suction."""
    knots: Knots
    stage: np.ndarray
    """int8[k-1]: index into :data:`~.moves.STAGES` per piece, -1 for none."""
    step: np.ndarray
    """int64[k-1]: number of the step per piece."""
    motion: np.ndarray
    """int64[k-1]: 1, 2, ... per piece that is part of a motion from rest to rest; 0 at rest."""
    states: tuple[ToolState, ...]
    """In the order of their times, the first one at the beginning."""
    steps: tuple[ProgramStep, ...]
    blocks: Blocks
    stretch: float = 1.0
    """Largest factor by which the time of a motion was stretched."""
    hands: tuple[ByHand, ...] = ()
    """What is done by hand between the steps, while the robot waits."""

    @property
    def seconds(self) -> float:
        """[s]"""
        return float(self.knots.time[-1])

    def states_at(self, time: np.ndarray) -> np.ndarray:
        """int64[m]: indices of the tool's states at times float64[m] [s]."""
        begins = np.array([state.time for state in self.states])
        return np.clip(np.searchsorted(begins, time + 1e-9, "right") - 1, 0, None)


class Driver(NamedTuple):
    """What the robot's own driver calls things, and where its frames are."""

    joints: tuple[str, ...]
    base_frame: str
    base: np.ndarray
    """float64[7]: pose of that frame: x, y, z [m, world], quaternion (w, x, y, z)."""
    flange_frame: str
    tcp: np.ndarray
    """float64[7]: pose of the tool point in the frame of the flange."""
    tool_mass: float
    """Of all that hangs on the flange [kg]."""
    tool_centre: np.ndarray
    """float64[3]: its centre of mass in the frame of the flange [m]."""


@lru_cache(maxsize=16)
def driver_of(arm: Arm) -> Driver:
    """Names and frames of an arm's driver: table ``driver`` of its ``arm.toml``; by default those
    of its MJCF, with the hand as flange."""
    import mujoco

    file = arm.mjcf.parent / "arm.toml"
    told = tomllib.loads(file.read_text(encoding="utf-8")).get("driver", {})
    model = arm_model(arm)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    flange = data.body(told.get("flange_body", arm.gripper.hand))
    turn = flange.xmat.reshape(3, 3)
    position = flange.xpos + turn @ told.get("flange_position", np.zeros(3))
    turn = turn @ quaternion_matrix(np.array(told.get("flange_quaternion", [1.0, 0, 0, 0])))
    tool = data.site(arm.tool)
    tcp = turn.T @ (tool.xpos - position), matrix_quaternion(turn.T @ tool.xmat.reshape(3, 3))
    yaw = yaw_quaternion(arm.base_yaw + told.get("base_yaw", 0.0))
    return Driver(
        tuple(told.get("joints", arm.joints)),
        told.get("base_frame", "base"),
        np.concatenate([arm.base_position, yaw]),
        told.get("flange_frame", "flange"),
        np.concatenate(tcp),
        float(model.body(arm.gripper.hand).subtreemass[0]),
        turn.T @ (data.body(arm.gripper.hand).subtree_com - position),
    )


def stand(name: str, tool: str, base: np.ndarray) -> Arm:
    """An arm with its tool where it stands: x, y, z [m, world] and turn about z [rad]."""
    arm = get_arm(name, tool)
    if np.allclose(base, (*arm.base_position, arm.base_yaw), rtol=0, atol=1e-6):
        return arm
    x, y, z, yaw = base.tolist()
    return get_arm(name, tool, (x, y, z, yaw))


def arm_of(facts: ArmFacts) -> Arm:
    """The arm of a record.

    Raises:
        UnknownNameError: for an arm or a tool that does not exist.
    """
    return stand(facts.name, facts.tool_name, np.append(facts.base_position, facts.base_yaw))


def make_program(record: BuildRecord, arm: Arm) -> Program:
    """What the arm has to be told to repeat a recorded build.

    Failed attempts are part of it where the arm moved: later ones begin where they left things.

    Args:
        record: of the build.
        arm: the one it names.

    Raises:
        InputError: for a record that is not sound, that of another arm, or one without motion.
    """
    if record.arm.name != arm.name or len(record.arm.joints) != len(arm.joints):
        raise InputError("trajectory.arm", record.arm.name, f"the arm {arm.name}")
    require_sound(record)
    if sum(len(step.samples.time) for step in record.steps) < 2:
        raise InputError("trajectory", "no motion", "a build with motions")
    samples, number = _stopped(*record.joined(), 1 / record.rate)
    q, v = samples.joints, samples.velocity
    same = (np.abs(np.diff(q, axis=0)).max(1) <= REST) & (np.abs(v[1:]).max(1) <= REST)
    same &= np.abs(v[:-1]).max(1) <= REST
    time, parts, motion, stretch = [samples.time[:1]], [], np.zeros(len(same), np.int64), 1.0
    start = 0
    edges = np.flatnonzero(np.diff(same)) + 1
    for count, end in enumerate([*edges.tolist(), len(same)], 1):
        span = slice(start, end + 1)
        knots = Knots(samples.time[span], q[span], np.zeros_like(q[span]), np.zeros_like(q[span]))
        if not same[start]:
            if max(np.abs(v[start]).max(), np.abs(v[end]).max()) > REST:
                raise InputError("trajectory", f"a motion at {samples.time[start]:.2f} s", "rest")
            knots, factor = slow_down(fit(samples.time[span], q[span], v[span]), arm.bounds)
            stretch = max(stretch, factor)
            motion[start:end] = count
        knots = knots._replace(time=knots.time - knots.time[0] + time[-1][-1])
        time.append(knots.time[1:])
        parts.append([part[1:] for part in knots[1:]])
        start = end
    first = q[:1], np.zeros_like(q[:1]), np.zeros_like(q[:1])
    whole = Knots(
        np.concatenate(time),
        *(np.concatenate([one, *(p[k] for p in parts)]) for k, one in enumerate(first)),
    )
    middle = (samples.time[1:] + samples.time[:-1]) / 2
    by_number = {step.number: step for step in record.steps}
    names = [by_number[int(n)].stage_at(t) for n, t in zip(number[1:], middle, strict=True)]
    stage = np.array([STAGES.index(name) if name else -1 for name in names], np.int8)
    program = Program(
        arm.name,
        record.arm.tool_name,
        record.arm.suction,
        whole,
        stage,
        number[1:],
        motion,
        (),
        (),
        Blocks(
            record.objects,
            record.block_edge,
            record.half,
            record.steps[0].before,
            record.steps[-1].after,
            (),
            record.density,
            record.hull,
        ),
        stretch,
        record.hands,
    )
    return _with_tool(program, record, arm, samples)


def _stopped(samples: Samples, number: np.ndarray, period: float) -> tuple[Samples, np.ndarray]:
    """The samples of a build and their steps, with a last one at rest: an attempt ends between two
    samples, the next one begins at rest, but after the last attempt there is none."""
    q, v = samples.joints[-1], samples.velocity[-1]
    if np.abs(v).max() <= REST:
        return samples, number
    more = Samples(
        samples.time[-1:] + period,
        (q + 0.4 * v * period)[None],
        np.zeros((1, len(v))),
        samples.width[-1:],
        samples.command[-1:],
    )
    joined = (
        np.concatenate(pair)
        for pair in zip(vars(samples).values(), vars(more).values(), strict=True)
    )
    return Samples(*joined), np.append(number, number[-1])


class _Teller:
    """States of the tool in the order they are told, and the time that has to be added for it.

    Args:
        program: without states.
        arm: the robot.
        first: the state it begins with.
    """

    def __init__(self, program: Program, arm: Arm, first: ToolState) -> None:
        self.time, self.arm = program.knots.time, arm
        self.told = [(0, 0.0, first)]
        """Knot, time after it [s], state."""
        self.extra = np.zeros(len(program.stage))
        """float64[k-1]: how much longer each piece has to be [s]."""

    @property
    def state(self) -> ToolState:
        return self.told[-1][2]

    def tell(self, index: int, end: int, wait: float, **change: Any) -> None:
        """The state changes ``wait`` after knot ``index``; the arm moves on at knot ``end``, once
        it has changed."""
        before, state = self.state, self.state._replace(**change)
        if state == before:
            return
        self.told.append((index, wait, state))
        gripper, suction, takes = self.arm.gripper, self.arm.suction, 0.0
        if state.load != before.load:
            takes = LOAD_TIME
        if suction is not None and state.vacuum != before.vacuum:
            takes = suction.grip_time if state.vacuum else suction.release_time
        if (state.width, state.force) != (before.width, before.force):
            way = abs(state.width - before.width)
            way += max(state.force, before.force) / gripper.stiffness
            takes = max(takes, way / gripper.speed)
        short = wait + takes - (self.time[end] - self.time[index]) - self.extra[index]
        self.extra[max(end - 1, 0)] += max(short, 0.0)


def _with_tool(program: Program, record: BuildRecord, arm: Arm, samples: Samples) -> Program:
    """The program with what the tool is told, and with time for it to do that.

    Args:
        samples: of the record, one for each knot.
    """
    stage, still, edge = program.stage, program.motion == 0, record.block_edge
    blocks, command = program.blocks, samples.command
    opened = 0.0 if program.suction else round(float(command[0]), 4)
    first = ToolState(0.0, opened, 0.0 if program.suction else arm.gripper.speed, 0.0, False, 0.0)
    teller, steps = _Teller(program, arm, first), []
    tell = teller.tell
    for step in record.steps:
        here = np.flatnonzero(program.step == step.number)
        checks: list[int] = []
        if len(here):
            begin = int(here[0])
            # The next attempt begins with an open hand, whatever came of the last one.
            opened = 0.0 if program.suction else round(float(command[begin + 1]), 4)
            tell(begin, begin, 0.0, width=opened, force=0.0, vacuum=False, load=0.0)
            for start, end in _runs(here[still[here] & (stage[here] == STAGES.index("pick"))])[-1:]:
                if program.suction:
                    on = np.flatnonzero(command[start : end + 1] > 0.5)
                    if len(on):
                        tell(start + max(int(on[0]) - 1, 0), end, 0.0, vacuum=True)
                elif np.ptp(samples.width[start : end + 1]) > arm.gripper.speed / record.rate:
                    width = _meant(samples, slice(start, end + 1), arm, edge)
                    tell(start, end, 0.0, width=width, force=arm.gripper.force)
            if step.grip is not None:
                end = int(np.searchsorted(samples.time, step.grip - 1e-9))
                told, clock = teller.told[-1][0], program.knots.time
                wait = max(clock[end] - LOAD_TIME - clock[told], 0.0)
                tell(told, end, wait, load=blocks.mass(step.cells))
                lifted = here[stage[here] == STAGES.index("lift")]
                over = here[stage[here] == STAGES.index("place")]
                if step.outcome == Outcome.REACHED and len(lifted) and len(over):
                    checks = [int(lifted[-1]) + 1, int(over[0])]
            for start, end in _runs(here[still[here] & (stage[here] == STAGES.index("release"))]):
                wait = LOAD_TIME if teller.state.load else 0.0
                tell(start, end, 0.0, load=0.0)
                tell(start, end, wait, width=opened, force=0.0, vacuum=False)
        steps.append((step, checks, here))
    time = program.knots.time + np.concatenate([[0.0], np.cumsum(teller.extra)])

    def now(recorded: float | None) -> float:
        return float(time[-1] if recorded is None else np.interp(recorded, samples.time, time))

    made, end = [], 0.0
    for step, checks, here in steps:
        end = float(time[int(here[-1]) + 1]) if len(here) else end
        held = None if step.grip is None else (now(step.grip), now(step.release))
        made.append(
            ProgramStep(
                step.number,
                step.cells,
                step.target,
                end,
                step.outcome == Outcome.REACHED,
                tuple(float(time[k]) for k in checks),
                held,
                step.after,
            )
        )
    return replace(
        program,
        knots=program.knots._replace(time=time),
        states=tuple(state._replace(time=float(time[k] + wait)) for k, wait, state in teller.told),
        steps=tuple(made),
        blocks=blocks._replace(supply=tuple(_supply(record, [one.end for one in made]))),
    )


def _meant(samples: Samples, span: slice, arm: Arm, edge: float) -> float:
    """The width of what fingers that close were meant to hold [m]."""
    told, width = float(samples.command[span].min()), samples.width[span]
    if told < width.min() - 1e-3:
        return round(told + arm.gripper.force / arm.gripper.stiffness, 4)
    # No command below the width, as of a cell without forces: what it closed on, also nothing.
    return max(math.ceil(1e3 * float(width[-1]) - 1e-6) / 1e3, edge)


def _supply(record: BuildRecord, ends: list[float]) -> Iterator[Supply]:
    """When magazines present blocks or take them: those that are under the table before a step
    and above it afterwards, or the other way round."""
    for step, end in zip(record.steps, ends, strict=True):
        hidden, shown = step.before[:, 2] < 0, step.after[:, 2] >= 0
        for cells in record.objects:
            if hidden[list(cells)].all() == shown[list(cells)].all():
                yield Supply(end, cells, step.after[list(cells)])


def _runs(indices: np.ndarray) -> list[tuple[int, int]]:
    """First and one past the last of every run of numbers that follow each other."""
    if not len(indices):
        return []
    parts = np.split(indices, np.flatnonzero(np.diff(indices) > 1) + 1)
    return [(int(part[0]), int(part[-1]) + 1) for part in parts]
