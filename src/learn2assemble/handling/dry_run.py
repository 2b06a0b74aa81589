"""A program played in the dynamic cell, open loop: the same commands, without looking.

Bricks that clutch are judged by the law of their joints, as in a build: what is pressed with the
force of the kit comes home, what bears more than it can opens (:mod:`.clutch`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from learn2assemble.errors import InputError
from learn2assemble.geometry.rotations import cube_yaw, quaternion_matrix
from learn2assemble.handling.dynamic_cell import REST_TIME, DynamicCell, clutch_of
from learn2assemble.kinematics.time_law import PathSamples
from learn2assemble.motion.places import Blocks
from learn2assemble.motion.program import LOAD_TIME, Program, ProgramStep
from learn2assemble.robot.arm import Arm
from learn2assemble.robot.grasps import Attitude, facing
from learn2assemble.robot.moves import Failure, Move, Scene
from learn2assemble.robot.studs import GROUND, Studs
from learn2assemble.simulation.contacts import BLIND, PUSH, Rules, Watch
from learn2assemble.simulation.model import TIMESTEP
from learn2assemble.simulation.objects import rigid_objects
from learn2assemble.simulation.simulation import SimulatedState, Simulation, Trace

SAME = 0.002
"""A structure is the same when no block is farther from where it should be [m]."""
DOWN = np.array([0.0, 0.0, -1.0])
FOLLOWS = 0.03
"""Share of what is lacking of a push that the controller adds in each step: it has a sensor of
forces, as arms give way."""


class DryRun(NamedTuple):
    """What came of a program that was played without looking."""

    poses: np.ndarray
    """float64[C, 7] of all cells at the end, as in :class:`~.places.Blocks`."""
    error: np.ndarray
    """float64[C]: distance of each cell from where the program says it ends [m]; 0 of those that
    end in a magazine and are in one."""
    seconds: float
    """How long the robot moved [s]."""
    fault: str = ""
    """What the arm ran into, or which brick was not pressed home, where that ended the run."""
    names: tuple[str, ...] = ()
    """What the block of each cell is called."""
    brought: int = 0
    """Of a build by two arms, blocks that this one does not move: they were put where the build had
    them."""

    @property
    def same(self) -> bool:
        """Whether the same structure results."""
        return not self.fault and bool(self.error.max(initial=0.0) <= SAME)


def play(program: Program, arm: Arm) -> DryRun:
    """Play a program open loop in the dynamic cell, from its first pose to its last.

    The drives get positions, velocities, accelerations, openings or vacuum, loads and pushes, and
    nothing is looked at until the end; blocks go on from where the step before has left them. As in
    the build, boxes that a step does not concern are held still; an arm that pushes against one
    ends the run, and so does a brick that a step leaves loose on its studs.

    Raises:
        InputError: for the program of another arm.
        SimulationDivergedError: where the simulation left the numbers.
    """
    if program.arm != arm.name:
        raise InputError("arm", arm.name, f"{program.arm}, which the program is for")
    blocks, cell = program.blocks, DynamicCell(arm)
    poses, supply, fault = blocks.start.copy(), list(blocks.supply), ""
    count = math.ceil(program.seconds / TIMESTEP - 1e-9)
    clock = np.arange(1, count + 1) * TIMESTEP
    told = _driven(program, arm, clock)
    home = set[tuple[int, int]]()
    if program.of_two:
        home = _put_home(blocks.studs, poses, set(range(len(poses))))
    first = 0
    for step in program.steps:
        last = count if step is program.steps[-1] else round(step.end / TIMESTEP)
        if last > first:
            rows, scene, move = _order(blocks, poses, step, home)
            objects, state, names = rigid_objects(scene, poses[rows, 3:], move)
            names = [blocks.name(int(rows[int(name.split()[-1])])) for name in names]
            start = program.knots.at(np.array([first * TIMESTEP]))[0][0]
            target = int(objects.owner[move.cell])
            world = cell.world(objects, scene.studs)
            shared = SimulatedState(world, state, names)
            tool = float(told.tool[first])
            sim = Simulation(shared, arm, start, tool, target, Trace(count + 10**6))
            shared.clutch = clutch_of(sim, objects, scene.studs, target)
            watch = BLIND
            if step.reached and len(objects.still):
                watch = BLIND._replace(rules=Rules(PUSH, None, None))
            try:
                for begin, end, opens in _parts(told, first, last):
                    span = slice(begin, end)
                    run = PathSamples(np.zeros((end - begin, 3)), *program.knots.at(clock[span]))
                    _run(sim, run, told.of(span), watch, opens)
            except Failure as failure:
                fault = f"step {step.number}: {failure.detail}"
            sim.wait(round(REST_TIME / TIMESTEP), "home", BLIND._replace(until=sim.asleep))
            position, quaternion, _ = objects.cells(sim.poses)
            poses[rows] = np.hstack([position, quaternion])
            clutch = shared.clutch
            if clutch is not None:
                home -= {_cells(rows, pair) for pair in _pairs(scene.studs)}
                home |= {_cells(rows, pair) for pair in clutch.home}
                if step.reached and clutch.unmade and not fault:
                    name = blocks.name(step.cells[0])
                    fault = f"step {step.number}: {name} is loose on its studs"
            if fault:
                break
            first = last
        while supply and supply[0].time <= step.end + 1e-6:
            present = supply.pop(0)
            poses[list(present.cells)] = present.poses
            if program.of_two:
                home |= _put_home(blocks.studs, poses, set(present.cells))
    error = np.linalg.norm(poses[:, :3] - blocks.end[:, :3], axis=1)
    # In which magazine a block waits that was taken away is no matter of the structure.
    error[(poses[:, 2] < 0) & (blocks.end[:, 2] < 0)] = 0.0
    names = tuple(map(blocks.name, range(len(poses))))
    brought = _left_alone(program) if program.of_two else 0
    return DryRun(poses, error, program.seconds, fault, names, brought)


class _Told(NamedTuple):
    """What the drives are told, step by step of the simulation."""

    tool: np.ndarray
    """float64[k]: opening [m], or whether the vacuum is on."""
    load: np.ndarray
    """float64[k]: at the tool [kg]."""
    press: np.ndarray
    """float64[k]: with which the tool pushes down [N]."""
    opens: np.ndarray
    """bool[k]: a gripper begins to open then."""

    def of(self, span: slice) -> _Told:
        """The same of some steps."""
        return _Told(*(part[span] for part in self))


def _parts(told: _Told, first: int, last: int) -> Iterator[tuple[int, int, bool]]:
    """A program step cut where the gripper opens: begin and end of each part, and whether it begins
    with that."""
    cuts = [first, *(first + np.flatnonzero(told.opens[first:last])).tolist(), last]
    for begin, end in pairwise(cuts):
        if end > begin:
            yield begin, end, bool(told.opens[begin])


def _run(sim: Simulation, run: PathSamples, told: _Told, watch: Watch, opens: bool) -> None:
    """Follow a part of a program; where the hand opens, joints that were made hold."""
    clutch, begun = sim.clutch, sim.steps
    if clutch is not None:
        sim.contacts.along = DOWN

        lacking = 0.0

        def pressed() -> bool:
            nonlocal lacking
            push = float(told.press[min(sim.steps - begun, len(told.press)) - 1])
            force = sim.contacts.support() if push else 0.0
            lacking = lacking + FOLLOWS * (push - force) if push else 0.0
            sim.drives.push = push + lacking if push else 0.0
            if push and force >= clutch.press:
                clutch.join()
            return False

        watch = watch._replace(until=pressed)
        if opens:
            clutch.take()
    sim.run(run, told.tool, "approach", watch, told.load)
    if opens and clutch is not None:
        clutch.draw()


def _put_home(studs: Studs | None, poses: np.ndarray, cells: set[int]) -> set[tuple[int, int]]:
    """Joints of studs of cells that the other arm has pressed home: where one is in its place on
    the other one.

    Args:
        poses: float64[C, 7] of all cells.
    """
    found = set[tuple[int, int]]()
    for joint in () if studs is None else studs.joints:
        pair = joint.lower, joint.upper
        if not cells.intersection(pair) or (poses[[k for k in pair if k >= 0], 2] < 0).any():
            continue
        below = np.zeros(3) if joint.lower == GROUND else poses[joint.lower, :3]
        if np.linalg.norm(poses[joint.upper, :3] - below - joint.at) <= SAME:
            found.add(pair)
    return found


def _cells(rows: np.ndarray, pair: tuple[int, int]) -> tuple[int, int]:
    """The cells of the program that rows of a scene are."""
    low, high = (k if k == GROUND else int(rows[k]) for k in pair)
    return low, high


def _pairs(studs: Studs | None) -> list[tuple[int, int]]:
    return [] if studs is None else [(joint.lower, joint.upper) for joint in studs.joints]


def _order(
    blocks: Blocks, poses: np.ndarray, step: ProgramStep, home: set[tuple[int, int]]
) -> tuple[np.ndarray, Scene, Move]:
    """The cells that are on the table, their scene, and what the step does in it.

    Args:
        home: cells of the joints of studs that hold.
    """
    rows = np.flatnonzero(poses[:, 2] >= 0)
    owner = np.empty(len(poses), np.int64)
    for number, cells in enumerate(blocks.objects):
        owner[list(cells)] = number
    # Several that are brought as one.
    owner[list(step.cells)] = owner[step.cells[0]]
    yaw = np.array([cube_yaw(quaternion_matrix(turn)) for turn in poses[rows, 3:]])
    half, density = (
        None if of_all is None else of_all[rows] for of_all in (blocks.half, blocks.density)
    )
    hull = None if blocks.hull is None else tuple(blocks.hull[k] for k in rows.tolist())
    scene = Scene(
        poses[rows, :3],
        yaw,
        owner[rows],
        0,
        half,
        density,
        None if half is None else poses[rows, 3:],
        hull,
        _there(blocks.studs, rows, home),
    )
    row = int(np.searchsorted(rows, step.cells[0]))
    turn = quaternion_matrix(step.target[3:]) @ quaternion_matrix(poses[step.cells[0], 3:]).T
    grasp = Attitude()
    return rows, scene, Move(row, step.target[:3], grasp, facing(turn @ grasp.rotation()))


def _there(studs: Studs | None, rows: np.ndarray, home: set[tuple[int, int]]) -> Studs | None:
    """The joints of studs of cells that are there, in rows of the scene."""
    if studs is None:
        return None
    number = {GROUND: GROUND, **{int(cell): row for row, cell in enumerate(rows)}}
    found = (
        joint._replace(
            lower=number[joint.lower],
            upper=number[joint.upper],
            home=(joint.lower, joint.upper) in home,
        )
        for joint in studs.joints
        if joint.lower in number and joint.upper in number
    )
    return Studs(tuple(found), studs.press)


def _driven(program: Program, arm: Arm, time: np.ndarray) -> _Told:
    """What the drives are told at times float64[m]: openings of a gripper, which change at the
    speed of the state and press by being too small, or whether the vacuum is on; loads and pushes
    come little by little."""
    lines: tuple[list[tuple[float, float]], ...] = ([], [], [])
    opens, closed = np.zeros(len(time), bool), False
    for state in program.states:
        width = state.width - state.force / max(arm.gripper.stiffness, 1e-9)
        wanted = width, state.load, state.press
        if closed and not state.force and len(time):
            opens[min(int(np.searchsorted(time, state.time - 1e-9)), len(time) - 1)] = True
        closed = bool(state.force)
        for line, value, speed in zip(lines, wanted, (state.speed, None, None), strict=True):
            if line and value == line[-1][1]:
                continue  # told before, and perhaps still on the way there
            past = np.array(line or [(0.0, value)])
            now = float(np.interp(state.time, past[:, 0], past[:, 1]))
            while line and line[-1][0] >= state.time:
                line.pop()
            line.append((state.time, now))
            if value != now:
                takes = abs(value - now) / speed if speed else LOAD_TIME
                line.append((state.time + takes, value))
    drawn: list[np.ndarray] = [np.interp(time, *np.array(line).T) for line in lines]
    told, loads, pushes = drawn
    if program.suction:
        told = np.array([state.vacuum for state in program.states], float)
        told = told[program.states_at(time)]
    return _Told(told, loads, pushes, opens)


def _left_alone(program: Program) -> int:
    """How many objects stand there at the end that no step moves."""
    moved, end = {cell for step in program.steps for cell in step.cells}, program.blocks.end
    others = (cells for cells in program.blocks.objects if not moved.intersection(cells))
    return sum(bool(end[cells[0], 2] >= 0) for cells in others)
