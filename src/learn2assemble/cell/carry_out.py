"""From an exact plan to a build by an arm: set up, find an order, carry it out, report.

A build goes on attempt by attempt: poses are read back, the next ones corrected, what stands
wrongly is repaired. Whatever an attempt leaves behind is where the next decision begins; a build
that is interrupted goes on from its file.
"""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from learn2assemble.assembly.blocks import AssemblyStep
from learn2assemble.cell.bricks import BrickStructure
from learn2assemble.cell.journal import Recording, append_state, packed, read_states
from learn2assemble.cell.pieces import QUARTER, overlaps, solids
from learn2assemble.cell.reach import cells_of, set_up
from learn2assemble.cell.state import STEADY, STEADY_YAW, Action, Choice, Done, read_back
from learn2assemble.cell.taking_apart import arrange_bricks, plan_in_order
from learn2assemble.cell.workcell import (
    DOWN,
    FLAT,
    LOOSE,
    LOST,
    RETURNED,
    STANDING,
    STOCK,
    TRIES,
    Arranged,
    Direction,
    Disturbance,
    Job,
    Progress,
    Rows,
    StepOf,
    Structure,
    Workcell,
    arrange,
    describe,
    job_of,
    moves,
    named,
    rows_of,
)
from learn2assemble.geometry.rotations import (
    matrix_quaternion,
    quaternion_matrix,
    yaw_matrix,
)
from learn2assemble.planning.plan import ArmFailure, ArmReport, Plan, Step
from learn2assemble.robot.arm import get_arm
from learn2assemble.robot.kinematic import KinematicCell
from learn2assemble.robot.moves import Attempt, Move, Outcome, Scene
from learn2assemble.robot.studs import Studs

if TYPE_CHECKING:
    from learn2assemble.assembly.kit import Kit
    from learn2assemble.simulation.cell import DynamicCell

PLACING = ("place", "again", "attach")
"""Actions after which a block is in its place."""
ASIDE = ("away", "attach")
"""Actions that are no step of a plan."""
GONE = 0.02
"""A block farther from its place than this is not in its place any more [m]."""
PUSH, DROP = 0.015, (0.07, 0.04)
"""Of the disturbances: how far a block is pushed, and let go beside and above its place [m]."""


class Prepared(NamedTuple):
    """What a build begins with."""

    job: Job
    structure: Structure
    """What rests on what."""
    order: Arranged
    """Proven, and possible for the arm."""
    cell: KinematicCell
    """To look before the arm moves."""


class Building:
    """A build that goes on.

    Args:
        found: what is to be built, in which order.
        workcell: how it is carried out.
        key: what the file it goes on from must have been written for.
    """

    def __init__(self, found: Prepared, workcell: Workcell, key: str = "") -> None:
        self.job, self.kinematic, self.key = found.job, found.cell, key
        self.known = Choice(found.job, found.order, found.structure)
        self.seed, self.noise, self.log = workcell.seed, workcell.noise, workcell.log
        self.disturbance = workcell.disturbance or Disturbance()
        self.physical = _physical(self.job, workcell.physics, self.disturbance.friction)
        """Carries moves out; None: they go as ordered where the kinematic cell allows them."""
        self.world = self.known.world
        rng = np.random.default_rng([self.seed, 10**6])
        share, count = self.disturbance.mass, len(self.world.pieces)
        masses = 1.0 + rng.uniform(-share, share, count) if share else np.ones(count)
        for k in self.world.visible():
            self._set_out(k, rng)
        self.known.believe()
        self.joints = self.job.arm.home.copy()
        self.recording = Recording(self.world, self.joints, masses, _words(self.job, workcell))
        self._resume()

    # ------------------------------------------------------------ going on

    def run(self, progress: Progress = lambda text: None) -> str | None:
        """Until everything is done; why not, in words, where it cannot be."""
        most = 2 * len(self.known.order) + 20
        while len(self.known.done) < most:
            action = self.known.choose()
            if action is None and self._let_go():
                action = self.known.choose()
            if not isinstance(action, Action):
                return action
            if not self.act(action):
                continue
            last = self.known.done[-1]
            piece = self.world.pieces[action.block]
            left = sum(not self.known.satisfied(step) for step in self.known.order)
            how = "by hand" if last.hand else f"attempt {last.number}"
            progress(
                f"{how}: {last.what} {piece.id} ({piece.name}): {last.outcome}, {left} steps left"
            )
        return f"given up after {most} attempts"

    # ------------------------------------------------------------ one attempt

    def act(self, action: Action) -> bool:
        """Try an action; False where the arm did not move because it cannot."""
        k, world = action.block, self.world
        if action.what == "hand":
            return self._by_hand(action)
        key = k, "place" if action.what == "remove" else action.what
        rng = np.random.default_rng([self.seed, len(self.known.done) + 1])
        before = world.pose[k].copy(), world.state[k], self.known.belief[k].copy()
        if world.state[k] == STOCK:
            assert action.source is not None
            world.pose[k] = world.presented(k, action.source)
            self._set_out(k, rng)
            self.known.belief[k] = world.pose[k]
        skip = self.known.fails[key] % TRIES
        move, why = self._look(action, skip)
        if move is None:
            world.pose[k], world.state[k], self.known.belief[k] = before
            if world.state[k] == LOOSE and action.what == "place" and world.magazine(k) is not None:
                self._replace(k)
                return False
            self.known.fails[key] += TRIES
            if action.what in ("place", "remove", "attach"):
                self.known.refused[k] = why
            return False
        if before[1] == STOCK and action.source is not None:
            world.used[action.source] += 1
        self.recording.sync()  # What was presented or taken in has moved during the last attempt.
        found = self._carry_out(action, move, rng)
        self._update(action, found)
        self.known.done.append(
            Done(
                len(self.known.done) + 1,
                k,
                action.what,
                found.outcome.label,
                found.detail,
                found.stage,
                move.grasp.sideways,
            )
        )
        self.known.fails[key] = 0 if found.reached else self.known.fails[key] + 1
        self.known.refused.clear()
        if len(self.known.done) in self.disturbance.push:
            self._push(rng)
        placed = action.what in PLACING and found.reached
        self._read(k, action.goal if placed else None, rng)
        self._append()
        return True

    def _by_hand(self, action: Action) -> bool:
        """A step is done by hand: the block is where it shall be, or gone."""
        k, world = action.block, self.world
        number = len(self.known.done) + 1
        what = "remove" if world.state[k] == STANDING else "place"
        self.recording.by_hand(k, what == "place")
        if what == "remove":
            world.state[k] = RETURNED
            world.hide(k)
        else:
            world.state[k], world.pose[k] = STANDING, action.goal
        self._settle()
        self.known.done.append(Done(number, k, what, Outcome.REACHED.label, "", "", hand=True))
        self.known.refused.clear()
        self._read(k, action.goal, np.random.default_rng([self.seed, number]))
        self.recording.sync()
        self._append()
        return True

    def _let_go(self) -> bool:
        """Let everything that clutches go at once, which single moves do not; whether that was
        done."""
        if self.physical is None or not self.job.assembly.holds:
            return False
        self._settle()
        self._read(0, None, np.random.default_rng([self.seed, 10**6 + 1]))
        return True

    def _settle(self) -> None:
        """All blocks come to rest by themselves, as after a step that was done by hand."""
        standing = self.world.visible()
        if self.physical is None or not standing:
            return
        rows = rows_of(self.world, self.world.pose, standing[-1], self.recording.masses)
        studs = self.known.structure.joints_of(self.world, rows, False)
        after, quaternion, _ = self.physical.settle(rows.scene._replace(studs=studs))
        self._put(rows, np.arange(len(rows.owner)), after.position, quaternion)

    def _look(self, action: Action, skip: int) -> tuple[Move | None, str]:
        """The first way the kinematic cell allows, after as many as have failed in reality."""
        k, goal = action.block, action.goal
        rows, why, first = rows_of(self.world, self.known.belief, k, group=action.group), "", None
        into: tuple[Direction, ...] = (DOWN,)
        if action.what in ("place", "again"):
            into = self.known.structure.ways_in(k, self.known.standing() - {k})
        press = self._press(action) if action.what in PLACING else None
        for move in moves(self.world, rows, k, goal, into, press):
            found = self.kinematic.attempt(rows.scene, move)
            if found.reached:
                first = first or move
                if not skip:
                    return move, ""
                skip -= 1
            why = why or named(describe(found), rows, self.world)
        return first, why or "the tool cannot hold it"

    def _press(self, action: Action) -> tuple[float, float] | None:
        """Where a block is pressed home, x and y [m]; None: it is not."""
        k, taken = action.block, (action.block, *action.group)
        beside = np.zeros(3) if action.group else self.world.beside[k]
        apart = (self.world.beside == beside).all(1)
        standing = {n for n in self.known.standing() if apart[n]} - set(taken)
        at = self.known.structure.press_at(k, action.group, standing)
        return None if at is None else (action.goal[0] + at[0], action.goal[1] + at[1])

    def _carry_out(self, action: Action, move: Move, rng: np.random.Generator) -> Attempt:
        k, number = action.block, len(self.known.done) + 1
        rows = rows_of(self.world, self.world.pose, k, self.recording.masses, action.group)
        placing = action.what in PLACING
        studs = self.known.structure.joints_of(self.world, rows, placing, action.group)
        if number in self.disturbance.drop:
            away = self.job.base - move.target[:2]
            beside = DROP[0] * away / np.linalg.norm(away)
            move = move._replace(target=move.target + np.array([*beside, DROP[1]]))
        if self.physical is None:
            found = self.kinematic.attempt(rows.scene, move)
            where = self.world.pose[k].copy()
            if found.reached:
                where = action.goal.copy()
                if number in self.disturbance.drop:
                    where[:2] = move.target[:2]
                    where[2] -= self.world.pieces[k].corners(where)[:, 2].min()
                    found = found._replace(outcome=Outcome.DROPPED, stage="place", detail="let go")
            if found.reached:
                for n in action.group:
                    self.world.pose[n, :3] += where[:3] - self.world.pose[k, :3]
                self._come_home(rows, studs)
            self.world.pose[k] = where
            return found
        scene = rows.scene._replace(studs=studs)
        found = self.physical.attempt(scene, move, joints=self.joints)
        if found.home is not None:
            self._come_home(rows, studs, found.home)
        step = next(
            (
                n
                for n, s in enumerate(self.known.order, 1)
                if s.block == k and s.remove == (action.what == "remove")
            ),
            None,
        )
        if not self.recording.recorder.steps and found.trajectory is not None:
            self.recording.begin(self.joints, float(found.trajectory.width[0]))
        found = found._replace(detail=named(found.detail, rows, self.world))
        self.recording.recorder.add_attempt(
            found, rows.scene, move, self.recording.numbers(rows), step
        )
        if found.joints is not None:
            self.joints = found.joints
        if found.after is not None and found.quaternion is not None:
            self._take_over(rows, move, found.after, found.quaternion)
        return found

    def _come_home(
        self, rows: Rows, studs: Studs | None, home: tuple[tuple[int, int], ...] | None = None
    ) -> None:
        """Joints of studs that are home now.

        Args:
            rows: the scene.
            studs: its joints.
            home: those that are, as lower and upper row; by default all.
        """
        for joint in () if studs is None else studs.joints:
            ends = joint.lower, joint.upper
            below = joint.lower if joint.lower < 0 else int(rows.owner[joint.lower])
            pair = below, int(rows.owner[joint.upper])
            self.world.home.discard(pair)
            if home is None or ends in home:
                self.world.home.add(pair)

    def _take_over(self, rows: Rows, move: Move, after: Scene, quaternion: np.ndarray) -> None:
        """The poses a simulation has left."""
        members = rows.scene.members(move.cell)
        order = np.concatenate([np.arange(rows.scene.num_placed), members])
        self._put(rows, order, after.position, quaternion)
        self.recording.sync()

    def _put(
        self, rows: Rows, order: np.ndarray, position: np.ndarray, quaternion: np.ndarray
    ) -> None:
        """Blocks are where a simulation has left them.

        Args:
            rows: the scene before.
            order: int64[n]: which of its rows each row of the other arguments is.
            position: float64[n, 3], centres of the parts [m].
            quaternion: float64[n, 4].
        """
        seen: set[int] = set()
        for row, old in enumerate(order.tolist()):
            k = int(rows.owner[old])
            if k < 0 or k in seen:
                continue
            seen.add(k)
            turn = quaternion_matrix(quaternion[row])
            centre = np.array(self.world.pieces[k].shape[rows.part[old]].centre)
            self.world.pose[k, :3] = position[row] - turn @ centre
            self.world.pose[k, 3:] = self._upright(k, quaternion[row])

    def _upright(self, k: int, quaternion: np.ndarray) -> np.ndarray:
        """The same block with its own z axis up as far as it looks the same so."""
        turn = quaternion_matrix(quaternion)
        same = max(
            (turn @ one for one in self.world.pieces[k].turns()),
            key=lambda found: round(float(found[2, 2]), 3),
        )
        if round(float(same[2, 2]), 3) <= round(float(turn[2, 2]), 3):
            return quaternion
        return matrix_quaternion(same)

    def _update(self, action: Action, found: Attempt) -> None:
        """Which block is where now."""
        world, k = self.world, action.block
        placing = action.what in PLACING
        if found.reached and action.what == "attach":
            world.beside[[k, *action.group]] = 0.0
        if found.reached and not placing:
            back = action.source is not None and world.job.sources[action.source].magazine
            world.state[k] = RETURNED if action.what == "remove" else STOCK if back else LOOSE
            if k >= len(self.job.pieces):
                world.state[k] = LOST
            elif back and action.what == "away":
                world.used[action.source or 0] -= 1
        for n in [k, *(n for n in world.visible() if n != k)]:
            if n == k and found.reached and not placing:
                continue
            if n >= len(self.job.pieces):
                world.state[n] = LOST
                continue
            piece, now = world.pieces[n], world.pose[n, 3:]
            off = world.pose[n, :3] - world.target(n)[:3]
            in_place = np.linalg.norm(off) < GONE and piece.lean(now, piece.pose[3:]) < FLAT
            upright = piece.lean(now, piece.waits[3:]) < FLAT
            if in_place and (
                n != k or found.outcome not in (Outcome.UNREACHABLE,) or world.state[n] == STANDING
            ):
                world.state[n] = STANDING
                self.known.accepted.discard(n) if n == k else None
            elif n == k and action.source is not None and self._still_there(n, action.source):
                world.state[n] = STOCK
                world.used[action.source] -= 1
            elif upright:
                world.state[n] = LOOSE
            else:
                self._lose(n)
        for n, state in enumerate(world.state):
            if state in (STOCK, RETURNED):
                world.hide(n)
        self.recording.sync()

    def _still_there(self, k: int, source: int) -> bool:
        """Whether a block lies at its magazine, which takes it back then."""
        at = self.world.presented(k, source)
        near = np.linalg.norm(self.world.pose[k, :3] - at[:3]) < GONE
        return bool(near) and self.job.sources[source].magazine

    def _lose(self, k: int) -> None:
        """The block cannot be used from where it lies; the next one of its kind takes its place."""
        if self.world.magazine(k) is None:
            self.world.state[k] = LOST
        else:
            self._replace(k)

    def _replace(self, k: int) -> None:
        """Another block of the kind takes its place in the plan; this one lies where it lies."""
        world, spare = self.world, self.recording.replace(k)
        world.pose[spare], world.state[spare] = world.pose[k].copy(), LOST
        world.state[k], world.source[k] = STOCK, None
        world.hide(k)
        self.known.replace(k, spare)
        self.recording.sync()

    def _set_out(self, k: int, rng: np.random.Generator) -> None:
        """A block is presented, not exactly where it should be."""
        place, turn = self.disturbance.supply
        if place or turn:
            self.world.pose[k, :2] += rng.normal(0.0, place, 2)
            spun = yaw_matrix(rng.normal(0.0, turn)) @ quaternion_matrix(self.world.pose[k, 3:])
            self.world.pose[k, 3:] = matrix_quaternion(spun)

    def _push(self, rng: np.random.Generator) -> None:
        """Somebody pushes a block that carries nothing, to where there is room."""
        standing = self.known.standing()
        free = [k for k in sorted(standing) if not self.known.structure.above[k] & standing]
        for k in rng.permutation(free).tolist():
            piece = self.world.pieces[k]
            for way in rng.permutation(4).tolist():
                step = PUSH * np.array([math.cos(way * QUARTER), math.sin(way * QUARTER), 0.0])
                there = self.world.pose[k].copy()
                there[:3] += step
                mine = solids(piece.shape, there)
                hits = any(
                    overlaps(mine, solids(self.world.pieces[n].shape, self.world.pose[n]), 1e-4)
                    for n in standing - {k}
                )
                if not hits:
                    self.world.pose[k] += [*step, 0, 0, 0, 0]
                    self.recording.sync()
                    return

    def _read(self, placed: int, goal: np.ndarray | None, rng: np.random.Generator) -> None:
        """Read the poses of all blocks back, and what to believe of them.

        Args:
            placed: a block that was moved.
            goal: float64[7]: where it was put; None where it was not.
        """
        if goal is not None:
            self.known.belief[placed] = goal
            self.known.variance[placed] = STEADY**2, STEADY_YAW**2
        for k, state in enumerate(self.world.state):
            true = self.world.pose[k]
            if state in (STANDING, LOOSE, LOST) and any(self.noise):
                read_back(self.known.belief[k], self.known.variance[k], true, self.noise, rng)
            else:
                self.known.belief[k] = true

    # ------------------------------------------------------------ going on after an interruption

    def _append(self) -> None:
        if self.log is None:
            return
        world = self.world
        state = {
            "pose": world.pose.tolist(),
            "state": world.state,
            "used": world.used,
            "source": world.source,
            "joints": self.joints.tolist(),
            **self.known.state(),
            **self.recording.state(),
        }
        if self.physical is not None and not self.known.done[-1].hand:
            state["record"] = packed(self.recording.recorder.steps[-1])
        append_state(self.log, state)

    def _resume(self) -> None:
        """Go on from what the file says, or begin it."""
        states = [] if self.log is None else read_states(self.log, self.key)
        if not states:
            return
        last, world = states[-1], self.world
        for piece in last["like"]:
            world.add(piece)
        world.pose = np.array(last["pose"])
        world.state, world.used, world.source = last["state"], last["used"], last["source"]
        self.joints = np.array(last["joints"])
        self.known.restore(last, [state["done"] for state in states])
        self.recording.restore(last, [state["record"] for state in states if "record" in state])


# ---------------------------------------------------------------- the whole of it

FINGER_ROOMS = (0.011, 0.02, 0.03, 0.036)
"""Gaps between blocks that are tried where fingers have no room [m]."""


def wider(kit: Kit, gap: float) -> Kit:
    """The kit with vertical joints of this width [m]: blocks as they are, farther apart."""
    dx, dy, dz = kit.pitch
    room = gap - kit.joint_gap
    return replace(kit, pitch=(dx + room, dy + room, dz), joint_gap=gap)


def prepare(
    plan: Plan, workcell: Workcell, joint: float, progress: Progress = lambda text: None
) -> Prepared:
    """The job, what rests on what, an order, and the cell that found it.

    Raises:
        InputError: for what cannot be held or reached, and for a layout that does not work.
    """
    job = job_of(plan, workcell.arm, joint, workcell.hands)
    job = set_up(job, workcell.arm, workcell.tool, workcell.site)
    cell = KinematicCell(job.arm, cells_of(job))
    if job.assembly.holds:
        bricks = BrickStructure(job)
        return Prepared(job, bricks, arrange_bricks(job, bricks, cell, progress), cell)
    structure = Structure(job)
    return Prepared(job, structure, arrange(job, structure, cell, progress), cell)


def carry_out(
    plan: Plan,
    workcell: Workcell,
    *,
    joint: float = 1e-4,
    progress: Progress = lambda text: None,
    found: Prepared | None = None,
) -> Plan:
    """A complete exact plan, carried out by an arm.

    Args:
        joint: width of a vertical joint [m].
        found: of :func:`prepare`, where that has been called.

    Raises:
        InputError: for what cannot be held or reached, and for a layout that does not work.
    """
    if not plan.complete or plan.assembly is None:
        return plan
    started = time.perf_counter()
    found = found or prepare(plan, workcell, joint, progress)
    job, order = found.job, found.order
    if order.stuck:
        number, why = next(iter(order.stuck.items()))
        blocks = [job.pieces[k].id for k in order.stuck]
        listed = ", ".join(blocks[:3]) + (f" and {len(blocks) - 3} more" if blocks[3:] else "")
        gone = any(step.block == number and step.remove for step in job.steps)
        gone = gone and StepOf(number) in order.steps
        what = "take away" if gone else "place"
        reason = f"the arm cannot {what} {listed}: {job.pieces[number].id}: {why}"
        if gone and not (job.arm.suction and job.arm.suction.cups[1:]):
            reason += "; a tool that also takes hold of side faces, `tool=suction-side`, may"
        report = _report(job, workcell, None)
        return replace(
            plan,
            status="refused",
            reason=reason,
            steps=(),
            coverage=0.0,
            arm=report,
            blocks=replace(plan.blocks, used=0),
            assembly=replace(plan.assembly, steps=(), not_built=()),
        )
    if plan.assembly.holds:
        plan = plan_in_order(plan, order.steps)
    building = Building(found, workcell, _key(plan, workcell))
    reason = building.run(progress)
    return _carried_out(plan, building, workcell, reason, time.perf_counter() - started)


def carry_out_cells(
    plan: Plan,
    kit: Kit,
    workcell: Workcell,
    progress: Progress,
    plan_again: Callable[[Kit], Plan],
) -> Plan:
    """As :func:`carry_out`, with the blocks farther apart where fingers have no room otherwise.

    Args:
        kit: of the plan.
        plan_again: plans the same cells with another kit.
    """
    if not plan.complete:
        return plan
    found = prepare(plan, workcell, kit.joint_gap, progress)
    gap = kit.joint_gap
    for room in FINGER_ROOMS:
        if not found.order.stuck or found.job.arm.suction is not None or room <= kit.joint_gap:
            continue
        progress(f"fingers have no room between the blocks: trying {1e3 * room:g} mm")
        other = plan_again(wider(kit, room))
        if other.complete:
            again = prepare(other, workcell, room, progress)
            if len(again.order.steps) > len(found.order.steps):
                plan, found, gap = other, again, room
    return carry_out(plan, workcell, joint=gap, progress=progress, found=found)


def _physical(job: Job, physics: str, change: float) -> DynamicCell | None:
    if physics == "kinematic":
        return None
    from learn2assemble.simulation.cell import DynamicCell, WorldForces

    return DynamicCell(job.arm, recover=True, forces=WorldForces(job.friction * (1 + change)))


def _words(job: Job, workcell: Workcell) -> str:
    import mujoco

    if workcell.physics == "kinematic":
        return "kinematic cell: reach and collisions"
    holds = "a suction cup" if job.arm.suction else "friction of the fingers"
    return f"MuJoCo {mujoco.__version__}, arm and blocks together, held by {holds}"


def _key(plan: Plan, workcell: Workcell) -> str:
    """What a build must have in common with the one it goes on from."""
    steps = [(s.block, s.action, s.kind, s.position) for s in plan.steps]
    # A magazine that ran empty may have been filled again.
    filled = tuple(magazine._replace(count=None) for magazine in workcell.site.magazines)
    site = replace(workcell.site, magazines=filled, source="")
    told = (
        steps,
        workcell.arm,
        workcell.tool,
        site,
        workcell.physics,
        workcell.seed,
        workcell.noise,
    )
    return hashlib.sha256(repr(told).encode()).hexdigest()[:24]


def _report(job: Job, workcell: Workcell, building: Building | None) -> ArmReport:
    x, y, z = job.arm.base_position.tolist()
    facing = float(job.arm.base_yaw - get_arm(workcell.arm).base_yaw)
    base = round(x, 6), round(y, 6), round(z, 6), round(facing, 6)
    if building is None:
        return ArmReport(workcell.arm, 0.0, 0, (), 0.0, workcell.tool, base, len(job.sources))
    failures = tuple(
        ArmFailure(
            d.number,
            d.outcome,
            f"{d.what} {building.world.pieces[d.block].id}, {d.stage}: {d.detail}",
            False,
        )
        for d in building.known.attempts()
        if d.outcome != Outcome.REACHED.label
    )
    attempts = len(building.known.attempts())
    satisfied = sum(
        building.known.satisfied(step)
        for step in building.known.order
        if step not in building.known.by_hand
    )
    errors = [
        float(np.linalg.norm(building.world.pose[k, :3] - building.world.target(k)[:3]))
        for k in building.known.standing()
    ]
    return ArmReport(
        workcell.arm,
        _pitch(job),
        attempts,
        failures,
        round(building.recording.recorder.now, 2),
        workcell.tool,
        base,
        len(job.sources),
        round(attempts / max(satisfied, 1), 4),
        round(float(np.mean(errors)), 6) if errors else None,
        round(max(errors), 6) if errors else None,
    )


def _pitch(job: Job) -> float:
    """Horizontal distance of neighbouring cells: the smallest block and a joint [m]."""
    return round(2 * min(float(p.half[:2].min()) for p in job.pieces) + job.joint, 6)


def _carried_out(
    plan: Plan, building: Building, workcell: Workcell, reason: str | None, seconds: float
) -> Plan:
    """The plan with what really happened."""
    job, world = building.job, building.world
    assert plan.assembly is not None
    last = {
        d.step: d
        for d in building.known.done
        if d.outcome == Outcome.REACHED.label and d.what not in ASIDE
    }
    order = [step for step in building.known.order if not step.group]
    apart = {step.block for step in order if step.beside is not None}
    done = [step.plain for step in order if building.known.satisfied(step)]
    done.sort(key=lambda step: last[step].number if step in last else 0)
    proven = {StepOf(s.block, s.action == "remove"): s for s in plan.steps}
    same, standing, covered, before = done == list(proven), set[int](), 0.0, 0.0
    steps: list[Step] = []
    share = {s.block: 0.0 for s in plan.steps}
    for step in plan.steps:
        share[step.block] += step.coverage - before if step.action == "place" else 0.0
        before = step.coverage
    for number, step in enumerate(done, 1):
        standing = standing - {step.block} if step.remove else standing | {step.block}
        old, attempt = proven[step], last.get(step)
        covered += 0.0 if step.remove else share[step.block]
        if not same:
            shown = building.known.structure.proof(frozenset(standing))
            old = old.with_proof(*(shown or ("carried out", None)))
        there = not step.remove and world.state[step.block] == STANDING
        pose = world.pose[step.block] if there else world.target(step.block)
        x, y, z, w, a, b, c = (round(float(v), 6) for v in pose)
        above = "above" if attempt is None or not attempt.sideways else "the side"
        how = f"suction from {above}" if job.arm.suction else "fingers"
        hand = attempt is not None and attempt.hand
        steps.append(
            replace(
                old,
                step=number,
                position=(x, y, z),
                quaternion=(w, a, b, c),
                coverage=round(covered, 6),
                outcome=attempt.outcome if attempt and not hand else None,
                way="beside" if step.block in apart else old.way,
                grasp="by hand" if hand else how,
                by_hand=hand,
            )
        )
    made = tuple(
        AssemblyStep(
            **{"remove" if s.remove else "place": plan.assembly.blocks[s.block].id},
            by_hand=step.by_hand or None,
        )
        for s, step in zip(done, steps, strict=True)
    )
    assembly = replace(plan.assembly, steps=made, not_built=()).as_far_as_placed()
    ranges: dict[str, Any] = {}
    if not same:
        # The ranges of the planner hold for its states; these were proven for one of each.
        whole = all(step.margin_g is not None for step in steps)
        ranges = {
            name: (value, value) if whole else None
            for name, value in (("friction_range", job.friction), ("gap_range", job.joint))
        }
    record = building.recording.record() if building.physical is not None else None
    if record is not None:
        numbers = {step: n for n, step in enumerate(done, 1)}
        record = replace(
            record,
            steps=tuple(
                replace(step, plan_step=None if d.what in ASIDE else numbers.get(d.step))
                for step, d in zip(record.steps, building.known.attempts(), strict=True)
            ),
        )
    return replace(
        plan,
        status="incomplete" if reason else "complete",
        reason=reason,
        steps=tuple(steps),
        coverage=steps[-1].coverage if steps else 0.0,
        seconds=round(plan.seconds + seconds, 3),
        blocks=replace(
            plan.blocks, used=len(building.known.standing()), waiting=_waiting(building)
        ),
        verified_by=f"{plan.verified_by}, and {_words(job, workcell)}",
        arm=_report(job, workcell, building),
        record=record,
        assembly=assembly,
        **ranges,
    )


def _waiting(building: Building) -> tuple[Any, ...]:
    """Where every block is taken from."""
    world, out = building.world, []
    for k in range(len(building.job.pieces)):
        number = world.source[k] if world.source[k] is not None else world.magazine(k)
        pose = world.target(k) if number is None else world.presented(k, number)
        out.append(tuple(round(float(v), 6) for v in pose[:3]))
    return tuple(out)
