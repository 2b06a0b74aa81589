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
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from learn2assemble.errors import InputError
from learn2assemble.motion.knots import REST, Knots, fit, slow_down
from learn2assemble.motion.places import (
    Blocks,
    Pick,
    PickPlace,
    Stands,
    name_of,
    step_numbers,
    supplied,
    supply_of,
)
from learn2assemble.motion.record import (
    BuildRecord,
    ByHand,
    Samples,
    StepRecord,
    require_sound,
)
from learn2assemble.robot.arm import Arm
from learn2assemble.robot.moves import STAGES, Outcome
from learn2assemble.robot.studs import GROUND, StudJoint, Studs

LOAD_TIME = 0.1
"""In which the controller takes over another load, or a push [s]: at once, the arm would jump."""
PRESS_TIME, PRESS_SHARE = 0.6, 1.15
"""How long bricks are pressed home [s], and with which share of what that takes."""
PRESSED = 0.002
"""A brick has come to another one where it is so near to its place there [m]."""


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
    press: float = 0.0
    """With which the tool pushes down where it stands [N]."""


class ProgramStep(NamedTuple):
    """An attempt to pick up an object and to put it down."""

    number: int
    """What the plan calls it, see :func:`~.places.step_numbers`."""
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
    """float64[C, 7]: poses of all cells after the step, as in :class:`~.places.Blocks`; None where
    that was not told."""
    plan_step: int | None = None
    """The step of the plan that it carries out, or tries to."""
    pick: Pick | None = None
    """Where its block waits; None: at no place of :attr:`Program.places`."""
    turn: float | None = None
    """Direction of the long side of its block where it shall stand, as the turn of a place [rad];
    None: not told by a program that was read from a file."""
    before: np.ndarray | None = None
    """float64[m, 7]: poses of its cells before the step; None: not told, as the turn."""


class Wait(NamedTuple):
    """For the other arm of a build by two."""

    time: float
    """The robot goes on from here [s] ..."""
    other: float
    """... when the other one's program has come so far [s, of that program]."""
    number: int
    """1, 2, ...: of :attr:`Program.awaited` of that program."""
    hands: tuple[str, ...] = ()
    """What is done by hand by then, for which that program asks, in words."""


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
    """What is done by hand between the steps, while the robot waits; its times are those of the
    record."""
    halts: tuple[float, ...] = ()
    """Of a build by two, when the robot begins to wait for each of these [s]."""
    places: tuple[PickPlace, ...] = ()
    """Where its blocks are taken from; not told by a program that was read from a file."""
    stands: tuple[Stands, ...] = ()
    """What else has to stand there; not told, as the places."""
    recorded: np.ndarray | None = None
    """float64[k]: when the build was where a knot is [s]; not told, as the places."""
    waits: tuple[Wait, ...] = ()
    """For the other arm, of a build by two, in the order of their times."""
    awaited: tuple[float, ...] = ()
    """Times for which the other arm waits [s], in their order."""

    @property
    def seconds(self) -> float:
        """[s]"""
        return float(self.knots.time[-1])

    @property
    def asks(self) -> list[tuple[ByHand, float]]:
        """What is done by hand, and when the robot begins to wait for it [s]."""
        ends = [0.0, *(step.end for step in self.steps)]
        times = self.halts or [ends[hand.after] for hand in self.hands]
        return list(zip(self.hands, times, strict=True))

    @property
    def of_two(self) -> bool:
        """Whether another arm builds with it, and one waits for the other."""
        return bool(self.waits or self.awaited)

    def states_at(self, time: np.ndarray) -> np.ndarray:
        """int64[m]: indices of the tool's states at times float64[m] [s]."""
        begins = np.array([state.time for state in self.states])
        return np.clip(np.searchsorted(begins, time + 1e-9, "right") - 1, 0, None)


def motions(program: Program) -> Iterator[tuple[int, int]]:
    """First and last knot of every motion from rest to rest."""
    moving = np.concatenate([[0], program.motion, [0]])
    for begin, end in pairwise(np.flatnonzero(np.diff(moving)).tolist()):
        if program.motion[begin]:
            yield begin, end


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
    time, motion, stretch = [samples.time[:1]], np.zeros(len(same), np.int64), 1.0
    parts: list[list[np.ndarray]] = []
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
            record.studs,
        ),
        stretch,
        record.hands,
        recorded=samples.time,
    )
    return _as_planned(_with_tool(program, record, arm, samples), record)


def _as_planned(program: Program, record: BuildRecord) -> Program:
    """The program with steps and blocks called as in the plan, and the places of its blocks."""
    numbers, told = np.array(step_numbers(record)), supplied(record)
    steps = tuple(
        step._replace(number=number, plan_step=one.plan_step, pick=pick, turn=turn)
        for step, one, number, pick, turn in zip(
            program.steps, record.steps, numbers.tolist(), told.picks, told.turns, strict=True
        )
    )
    blocks = program.blocks
    if record.names:
        cells = range(record.num_cells)
        owner = {cell: k for k, one in enumerate(record.objects) for cell in one}
        kinds = tuple(record.kinds[owner[k]] if record.kinds else "" for k in cells)
        blocks = blocks._replace(names=tuple(name_of(record, k) for k in cells), kinds=kinds)
    step = numbers[program.step - 1]
    return replace(
        program, step=step, steps=steps, blocks=blocks, places=told.places, stands=told.stands
    )


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
        takes = self.takes(state, before)
        short = wait + takes - (self.time[end] - self.time[index]) - self.extra[index]
        self.extra[max(end - 1, 0)] += max(short, 0.0)

    def takes(self, state: ToolState, before: ToolState | None = None) -> float:
        """How long it takes until the tool is as told [s].

        Args:
            before: as it was told last, by default.
        """
        before = before or self.state
        gripper, suction, takes = self.arm.gripper, self.arm.suction, 0.0
        if (state.load, state.press) != (before.load, before.press):
            takes = LOAD_TIME
        if suction is not None and state.vacuum != before.vacuum:
            takes = suction.grip_time if state.vacuum else suction.release_time
        if (state.width, state.force) != (before.width, before.force):
            way = abs(state.width - before.width)
            way += max(state.force, before.force) / gripper.stiffness
            takes = max(takes, way / gripper.speed)
        return takes


def _with_tool(program: Program, record: BuildRecord, arm: Arm, samples: Samples) -> Program:
    """The program with what the tool is told, and with time for it to do that.

    Args:
        samples: of the record, one for each knot.
    """
    stage, still, edge = program.stage, program.motion == 0, record.block_edge
    blocks, command = program.blocks, samples.command
    opened = 0.0 if program.suction else round(float(command[0]), 4)
    first = ToolState(0.0, opened, 0.0 if program.suction else arm.gripper.speed, 0.0, False, 0.0)
    teller = _Teller(program, arm, first)
    steps: list[tuple[StepRecord, list[int], np.ndarray]] = []
    tell = teller.tell
    for step in record.steps:
        here = np.flatnonzero(program.step == step.number)
        checks: list[int] = []
        if len(here):
            begin = int(here[0])
            closings = _runs(here[still[here] & (stage[here] == STAGES.index("pick"))])[-1:]
            # The next attempt begins with an open hand, whatever came of the last one; how far it
            # is open is said by what it closes from, as it may open on its way.
            reach = closings[0][0] if closings else int(here[-1])
            opened = 0.0 if program.suction else round(float(command[reach]), 4)
            # It opens on its way, as it did, where that takes no longer than the way.
            takes = teller.takes(teller.state._replace(width=opened, force=0.0, vacuum=False))
            on_its_way = takes <= program.knots.time[reach] - program.knots.time[begin]
            until = reach if on_its_way else begin
            tell(begin, until, 0.0, width=opened, force=0.0, vacuum=False, load=0.0)
            for start, end in closings:
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
            press = _press(blocks.studs, step)
            for start, end in _runs(here[still[here] & (stage[here] == STAGES.index("release"))]):
                wait = 0.0
                if press and teller.state.load:
                    tell(start, end, 0.0, press=press)
                    tell(start, end, PRESS_TIME, press=0.0)
                    wait = PRESS_TIME + LOAD_TIME
                took = LOAD_TIME if teller.state.load else 0.0
                tell(start, end, wait, load=0.0)
                tell(start, end, wait + took, width=opened, force=0.0, vacuum=False)
        steps.append((step, checks, here))
    time = program.knots.time + np.concatenate([[0.0], np.cumsum(teller.extra)])

    def now(recorded: float | None) -> float:
        return float(time[-1] if recorded is None else np.interp(recorded, samples.time, time))

    made, end = list[ProgramStep](), 0.0
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
                before=step.before[list(step.cells)],
            )
        )
    return replace(
        program,
        knots=program.knots._replace(time=time),
        states=tuple(state._replace(time=float(time[k] + wait)) for k, wait, state in teller.told),
        steps=tuple(made),
        blocks=blocks._replace(supply=tuple(supply_of(record, [one.end for one in made]))),
    )


def _press(studs: Studs | None, step: StepRecord) -> float:
    """With which what a step brought has to be pressed home [N]; 0: it came onto no studs."""
    if studs is None or step.outcome != Outcome.REACHED:
        return 0.0
    own = set(step.cells)
    made = any(joint.leaves(own) and _met(joint, step.after) for joint in studs.joints)
    return PRESS_SHARE * studs.press if made else 0.0


def _met(joint: StudJoint, poses: np.ndarray) -> bool:
    """Whether the upper cell of a joint is where it shall be on the lower one.

    Args:
        poses: float64[C, 7] of all cells.
    """
    below = np.zeros(3) if joint.lower == GROUND else poses[joint.lower, :3]
    return bool(np.linalg.norm(poses[joint.upper, :3] - below - joint.at) < PRESSED)


def _meant(samples: Samples, span: slice, arm: Arm, edge: float) -> float:
    """The width of what fingers that close were meant to hold [m]."""
    told, width = float(samples.command[span].min()), samples.width[span]
    if told < width.min() - 1e-3:
        return round(told + arm.gripper.force / arm.gripper.stiffness, 4)
    # No command below the width, as of a cell without forces: what it closed on, also nothing.
    return max(math.ceil(1e3 * float(width[-1]) - 1e-6) / 1e3, edge)


def _runs(indices: np.ndarray) -> list[tuple[int, int]]:
    """First and one past the last of every run of numbers that follow each other."""
    if not len(indices):
        return []
    parts = np.split(indices, np.flatnonzero(np.diff(indices) > 1) + 1)
    return [(int(part[0]), int(part[-1]) + 1) for part in parts]
