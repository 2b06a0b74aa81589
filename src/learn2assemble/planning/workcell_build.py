"""A build that goes on: attempt by attempt, read back, corrected, repaired, and resumed.

Whatever an attempt leaves behind is where the next decision begins. What was done is appended to
a file after every attempt, so a build that is interrupted goes on from there.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Protocol

import numpy as np

from learn2assemble.geometry.rotations import (
    matrix_quaternion,
    quaternion_matrix,
    yaw_quaternion,
)
from learn2assemble.planning.workcell import (
    FLAT,
    LOOSE,
    LOST,
    RETURNED,
    STANDING,
    STOCK,
    TRIES,
    Disturbance,
    Job,
    Progress,
    Rows,
    StepOf,
    Structure,
    describe,
    frame_of,
    moves,
    named,
    rows_of,
)
from learn2assemble.planning.workcell_choice import Action, Choice, Done
from learn2assemble.planning.workcell_log import Book, append_state, packed_step, read_states
from learn2assemble.planning.workcell_sense import STEADY, STEADY_YAW, read_back
from learn2assemble.planning.workcell_site import QUARTER
from learn2assemble.robot.kinematic.cell import KinematicCell
from learn2assemble.robot.moves import Attempt, Move, Outcome, Scene

GONE = 0.02
"""A block farther from its place than this is not in its place any more [m]."""
PUSH, DROP = 0.015, (0.07, 0.04)
"""Of the disturbances: how far a block is pushed, and let go beside and above its place [m]."""


class PhysicalCell(Protocol):
    """What carries moves out, see :class:`learn2assemble.robot.dynamic.cell.DynamicCell`."""

    def attempt(
        self, scene: Scene, move: Move, *, joints: np.ndarray | None = None,
        quaternion: np.ndarray | None = None,
    ) -> Attempt:  # fmt: skip
        """Carry out a move; the scene is left alone."""
        ...


class Building:
    """A build that goes on.

    Args:
        job: what is to be built.
        order: proven, and possible for the arm.
        structure: what rests on what.
        kinematic: to look before the arm moves.
        physical: carries moves out; None: they go as ordered where ``kinematic`` allows them.
        seed: of noise and disturbances.
        noise: standard deviations of what is read back: x and y [m], yaw [rad].
        log: file that is appended to after every attempt, and read first where it exists.
        key: what the file must have been written for.
    """

    def __init__(
        self, job: Job, order: tuple[StepOf, ...], structure: Structure, kinematic: KinematicCell,
        physical: PhysicalCell | None, *, seed: int = 0, noise: tuple[float, float] = (0.0, 0.0),
        disturbance: Disturbance | None = None, log: Path | None = None, key: str = "",
        words: str = "",
    ) -> None:  # fmt: skip
        self.job, self.known = job, Choice(job, order, structure)
        self.kinematic, self.physical = kinematic, physical
        self.seed, self.noise, self.key = seed, noise, key
        self.disturbance = disturbance or Disturbance()
        self.world = self.known.world
        rng = np.random.default_rng([seed, 10**6])
        share, count = self.disturbance.mass, len(self.world.pieces)
        masses = 1.0 + rng.uniform(-share, share, count) if share else np.ones(count)
        for k in self.world.visible():
            self._set_out(k, rng)
        self.known.believe()
        self.joints = job.arm.home.copy()
        self.book = Book(self.world, self.joints, masses, words)
        self.log = log
        if log is not None:
            self._resume(log)

    # ------------------------------------------------------------ going on

    def run(self, progress: Progress = lambda text: None) -> str | None:
        """Until everything is done; why not, in words, where it cannot be."""
        most = 2 * len(self.known.order) + 20
        while len(self.known.done) < most:
            action = self.known.choose()
            if not isinstance(action, Action):
                return action
            if not self.act(action):
                continue
            last = self.known.done[-1]
            piece = self.world.pieces[action.block]
            left = sum(not self.known.satisfied(step) for step in self.known.order)
            progress(f"attempt {last.number}: {last.what} {piece.id} ({piece.name}): "
                     f"{last.outcome}, {left} steps left")  # fmt: skip
        return f"given up after {most} attempts"

    # ------------------------------------------------------------ one attempt

    def act(self, action: Action) -> bool:
        """Try an action; False where the arm did not move because it cannot."""
        k, world = action.block, self.world
        key = (
            action.block,
            "again" if action.what == "again" else ("away" if action.what == "away" else "place"),
        )
        rng = np.random.default_rng([self.seed, len(self.known.done) + 1])
        before = world.pose[k].copy(), world.state[k], self.known.belief[k].copy()
        if world.state[k] == STOCK:
            assert action.source is not None
            world.pose[k] = world.presented(k, action.source)
            self._set_out(k, rng)
            self.known.belief[k] = world.pose[k]
        skip = self.known.fails.get(key, 0) % TRIES
        move, why = self._look(k, action.goal, skip)
        if move is None:
            world.pose[k], world.state[k], self.known.belief[k] = before
            if world.state[k] == LOOSE and action.what == "place" and world.magazine(k) is not None:
                self._replace(k)
                return False
            self.known.fails[key] = self.known.fails.get(key, 0) + TRIES
            if action.what in ("place", "remove"):
                self.known.refused[k] = why
            return False
        if before[1] == STOCK and action.source is not None:
            world.used[action.source] += 1
        self.book.sync()  # What was presented or taken in has moved during the last attempt.
        found = self._carry_out(action, move, rng)
        self._update(action, found)
        self.known.done.append(
            Done(len(self.known.done) + 1, k, action.what, found.outcome.label,
                 found.detail, found.stage, move.grasp.sideways)
        )  # fmt: skip
        self.known.fails[key] = 0 if found.reached else self.known.fails.get(key, 0) + 1
        self.known.refused.clear()
        if len(self.known.done) in self.disturbance.push:
            self._push(rng)
        self._read(action, found, rng)
        self._append()
        return True

    def _look(self, k: int, goal: np.ndarray, skip: int) -> tuple[Move | None, str]:
        """The first way the kinematic cell allows, after as many as have failed in reality."""
        rows, why, first = rows_of(self.world, self.known.belief, k), "", None
        if frame_of(self.known.belief[k, 3:]).tilt > FLAT:
            return None, "it leans too much to be picked up"
        for move in moves(self.world, rows, k, goal):
            found = self.kinematic.attempt(rows.scene, move)
            if found.reached:
                first = first or move
                if not skip:
                    return move, ""
                skip -= 1
            why = why or named(describe(found), rows, self.world)
        return first, why or "the tool cannot hold it"

    def _carry_out(self, action: Action, move: Move, rng: np.random.Generator) -> Attempt:
        k, number = action.block, len(self.known.done) + 1
        rows = rows_of(self.world, self.world.pose, k, self.book.masses)
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
                    where[2] = self.world.pieces[k].half[2]
                    found = found._replace(outcome=Outcome.DROPPED, stage="place", detail="let go")
            self.world.pose[k] = where
            after = self.book.poses()
            self.book.recorder.poses = after
            return found
        found = self.physical.attempt(
            rows.scene, move, joints=self.joints, quaternion=rows.quaternion
        )
        step = next((n for n, s in enumerate(self.known.order, 1)
                     if s.block == k and s.remove == (action.what == "remove")), None)  # fmt: skip
        if not self.book.recorder.steps and found.trajectory is not None:
            self.book.begin(self.joints, float(found.trajectory.width[0]))
        found = found._replace(detail=named(found.detail, rows, self.world))
        self.book.recorder.add_attempt(found, rows.scene, move, self.book.numbers(rows), step)
        if found.joints is not None:
            self.joints = found.joints
        if found.after is not None and found.quaternion is not None:
            self._take_over(rows, move, found.after, found.quaternion)
        return found

    def _take_over(self, rows: Rows, move: Move, after: Scene, quaternion: np.ndarray) -> None:
        """The poses a simulation has left."""
        members = rows.scene.members(move.cell)
        order = np.concatenate([np.arange(rows.scene.num_placed), members])
        seen: set[int] = set()
        for row, old in enumerate(order.tolist()):
            k = int(rows.owner[old])
            if k < 0 or k in seen:
                continue
            seen.add(k)
            piece, side = self.world.pieces[k], frame_of(self.world.pose[k, 3:]).side
            turn = quaternion_matrix(quaternion[row]) @ side.T
            centre = np.array(piece.shape[rows.part[old]][0])
            self.world.pose[k, :3] = after.position[row] - turn @ centre
            self.world.pose[k, 3:] = self._upright(k, matrix_quaternion(turn))
        self.book.sync()

    def _upright(self, k: int, quaternion: np.ndarray) -> np.ndarray:
        """The same box with its own z axis up, where its sides are alike."""
        piece, frame = self.world.pieces[k], frame_of(quaternion)
        if len(piece.shape) > 1 or (frame.side == np.eye(3)).all():
            return quaternion
        half = piece.half
        if np.abs(np.abs(frame.side.T) @ half - half).max() > 1e-6:
            return quaternion
        return matrix_quaternion(quaternion_matrix(quaternion) @ frame.side)

    def _update(self, action: Action, found: Attempt) -> None:
        """Which block is where now."""
        world, k = self.world, action.block
        placing = action.what in ("place", "again")
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
            frame, off = frame_of(world.pose[n, 3:]), world.pose[n, :3] - world.target(n)[:3]
            upright = bool((frame.side == np.eye(3)).all()) and frame.tilt < FLAT
            in_place = np.linalg.norm(off) < GONE and upright
            if in_place and (n != k or found.outcome not in (Outcome.UNREACHABLE,) or
                             world.state[n] == STANDING):  # fmt: skip
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
        self.book.sync()

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
        world, spare = self.world, self.book.replace(k)
        world.pose[spare], world.state[spare] = world.pose[k].copy(), LOST
        world.state[k], world.source[k] = STOCK, None
        world.hide(k)
        self.known.replace(k, spare)
        self.book.grow(k)

    def _set_out(self, k: int, rng: np.random.Generator) -> None:
        """A block is presented, not exactly where it should be."""
        place, turn = self.disturbance.supply
        if place or turn:
            self.world.pose[k, :2] += rng.normal(0.0, place, 2)
            yaw = frame_of(self.world.pose[k, 3:]).yaw + rng.normal(0.0, turn)
            self.world.pose[k, 3:] = yaw_quaternion(yaw)

    def _push(self, rng: np.random.Generator) -> None:
        """Somebody pushes a block that carries nothing, to where there is room."""
        standing = self.known.standing()
        free = [k for k in sorted(standing) if not self.known.structure.above[k] & standing]
        for k in rng.permutation(free).tolist():
            piece = self.world.pieces[k]
            for way in rng.permutation(4).tolist():
                step = PUSH * np.array([math.cos(way * QUARTER), math.sin(way * QUARTER), 0.0])
                mine = piece.boxes(self.world.pose[k, :3] + step, piece.yaw)
                hits = any(
                    (np.minimum(b, d) - np.maximum(a, c) > 1e-4).all()
                    for n in standing - {k}
                    for c, d in self.world.pieces[n].boxes(self.world.pose[n, :3],
                                                           self.world.pieces[n].yaw)
                    for a, b in mine
                )  # fmt: skip
                if not hits:
                    self.world.pose[k] += [*step, 0, 0, 0, 0]
                    self.book.sync()
                    return

    def _read(self, action: Action, found: Attempt, rng: np.random.Generator) -> None:
        """Read the poses of all blocks back, and what to believe of them."""
        if action.what in ("place", "again") and found.reached:
            self.known.belief[action.block] = action.goal
            self.known.variance[action.block] = STEADY**2, STEADY_YAW**2
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
            "pose": world.pose.tolist(), "state": world.state, "used": world.used,
            "source": world.source, "joints": self.joints.tolist(),
            **self.known.state(), **self.book.state(),
        }  # fmt: skip
        if self.physical is not None:
            state["record"] = packed_step(self.book.recorder.steps[-1])
        append_state(self.log, state)

    def _resume(self, log: Path) -> None:
        """Go on from what the file says, or begin it."""
        states = read_states(log, self.key)
        if not states:
            return
        last, world = states[-1], self.world
        for piece in last["like"]:
            world.add(piece)
        world.pose = np.array(last["pose"])
        world.state, world.used, world.source = last["state"], last["used"], last["source"]
        self.joints = np.array(last["joints"])
        self.known.restore(last, [state["done"] for state in states])
        self.book.restore(last, [state["record"] for state in states if "record" in state])
