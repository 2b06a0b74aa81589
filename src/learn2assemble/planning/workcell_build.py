"""A build that goes on: attempt by attempt, read back, corrected, repaired, and resumed.

Whatever an attempt leaves behind is where the next decision begins. What was done is appended to
a file after every attempt, so a build that is interrupted goes on from there.
"""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np

from learn2assemble.geometry.rotations import (
    matrix_quaternion,
    quaternion_matrix,
    yaw_quaternion,
)
from learn2assemble.planning.workcell import (
    FLAT,
    HIDDEN,
    LEANS,
    LOOSE,
    LOST,
    OBSTACLE_DENSITY,
    RETURNED,
    STANDING,
    STANDS,
    STOCK,
    TRIES,
    Disturbance,
    Job,
    Progress,
    Rows,
    StepOf,
    Structure,
    World,
    describe,
    frame_of,
    moves,
    named,
    rows_of,
    supply_of,
)
from learn2assemble.planning.workcell_log import (
    append_state,
    packed_step,
    read_states,
    unpacked_step,
)
from learn2assemble.planning.workcell_sense import STEADY, STEADY_YAW, fitted, read_back
from learn2assemble.planning.workcell_site import QUARTER, Pose, footprint
from learn2assemble.robot.kinematic.cell import KinematicCell
from learn2assemble.robot.moves import Attempt, Move, Outcome, Scene
from learn2assemble.robot.record import BuildRecord, StepRecord
from learn2assemble.robot.recorder import BuildRecorder

GONE = 0.02
"""A block farther from its place than this is not in its place any more [m]."""
NEAT = 8e-4
"""A neighbour that is off by more is put right where it leaves the next block no room [m]."""
BESIDE = 0.012
"""What lies nearer to a place than this is in its way [m]."""
PUSH, DROP = 0.015, (0.07, 0.04)
"""Of the disturbances: how far a block is pushed, and let go beside and above its place [m]."""
WAITING = "what it stands on is missing"


class PhysicalCell(Protocol):
    """What carries moves out, see :class:`learn2assemble.robot.dynamic.cell.DynamicCell`."""

    def attempt(
        self, scene: Scene, move: Move, *, joints: np.ndarray | None = None,
        quaternion: np.ndarray | None = None,
    ) -> Attempt:  # fmt: skip
        """Carry out a move; the scene is left alone."""
        ...


class Action(NamedTuple):
    """What the arm shall do next."""

    block: int
    goal: np.ndarray
    """float64[7]: pose the block shall have."""
    what: str
    """``place``, ``remove``, ``again`` (from where it stands wrongly) or ``away``."""
    source: int | None = None
    """Where it comes from, or where it goes to where it is taken away."""


@dataclasses.dataclass
class Done:
    """What came of one attempt."""

    number: int
    block: int
    what: str
    outcome: str
    detail: str
    stage: str
    sideways: bool = False
    """Whether the block was held by its side."""


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
        self.job, self.order, self.structure = job, order, structure
        self.kinematic, self.physical = kinematic, physical
        self.seed, self.noise, self.key = seed, noise, key
        self.disturbance = disturbance or Disturbance()
        self.world = World(job)
        count = len(self.world.pieces)
        self.body = list(range(count))
        """The physical block that each piece is; others where one was lost."""
        self.like: list[int] = []
        """Of every block beyond those of the plan, the piece it is like."""
        rng = np.random.default_rng([seed, 10**6])
        share = self.disturbance.mass
        self.masses = 1.0 + rng.uniform(-share, share, count) if share else np.ones(count)
        for k in self.world.visible():
            self._set_out(k, rng)
        self.joints = job.arm.home.copy()
        self.belief = self.world.pose.copy()
        self.variance = np.full((count, 2), STEADY**2)
        self.fails: dict[tuple[int, str], int] = {}
        self.refused: dict[int, str] = {}
        self.accepted: set[int] = set()
        self.done: list[Done] = []
        self.cells = [tuple(c) for c in self.world.cells()]
        self.fixed = [sum(map(len, self.cells)) + n for n in range(len(job.obstacles))]
        self.words = words
        self.recorder = self._recorder(0.0)
        self.log = log
        if log is not None:
            self._resume(log)

    # ------------------------------------------------------------ going on

    def run(self, progress: Progress = lambda text: None) -> str | None:
        """Until everything is done; why not, in words, where it cannot be."""
        most = 2 * len(self.order) + 20
        while len(self.done) < most:
            action = self.choose()
            if not isinstance(action, Action):
                return action
            if not self.act(action):
                continue
            last = self.done[-1]
            piece = self.world.pieces[action.block]
            left = sum(not self.satisfied(step) for step in self.order)
            progress(f"attempt {last.number}: {last.what} {piece.id} ({piece.name}): "
                     f"{last.outcome}, {left} steps left")  # fmt: skip
        return f"given up after {most} attempts"

    def standing(self) -> set[int]:
        """Pieces of the plan that are in their places."""
        return {k for k in range(len(self.job.pieces)) if self.world.state[k] == STANDING}

    def satisfied(self, step: StepOf) -> bool:
        """Whether a step is done and holds."""
        state = self.world.state[step.block]
        return state == RETURNED or (not step.remove and state == STANDING)

    def choose(self) -> Action | str | None:
        """The next action; None where all is done, words where nothing can be."""
        repair = self._repair()
        if repair is not None:
            return repair
        standing, blocked = self.standing(), dict[int, str]()
        ready: list[StepOf] = []
        for step in self.order:
            if self.satisfied(step):
                continue
            if step.remove:
                if not ready and not blocked:
                    ready.append(step)
                break
            missing = {k for k in self.structure.below[step.block] - standing
                       if self.world.state[k] != RETURNED}  # fmt: skip
            if missing:
                blocked[step.block] = WAITING
            elif not self.structure.stands(frozenset(standing | {step.block})):
                blocked[step.block] = "it would fall"
            else:
                ready.append(step)
        ready = [step for step in ready if self._left(step.block, "place") > 0]
        ready.sort(key=lambda step: self.fails.get((step.block, "place"), 0) // TRIES)
        for step in ready:
            why = self.refused.get(step.block)
            if why is None:
                action = self._place_or_remove(step)
                if isinstance(action, Action):
                    return action
                self.refused[step.block] = why = action
            crooked = self._crooked(step.block)
            if crooked is not None:
                return crooked
            blocked[step.block] = why
        if not blocked and all(self.satisfied(step) for step in self.order):
            return None
        for step in self.order:
            if not self.satisfied(step) and step.block not in blocked:
                last = [d for d in self.done if d.block == step.block]
                blocked[step.block] = last[-1].detail if last else "it comes later"
        causes = [k for k, why in blocked.items() if why != WAITING]
        number = next(iter(causes or blocked))
        why = blocked[number]
        others = f" and {len(blocked) - 1} others" if len(blocked) > 1 else ""
        piece = self.world.pieces[number]
        return f"{piece.id} ({piece.name}){others} cannot be placed: {why}"

    def _left(self, block: int, what: str) -> int:
        return 3 * TRIES - self.fails.get((block, what), 0)

    def _place_or_remove(self, step: StepOf) -> Action | str:
        world, k = self.world, step.block
        if step.remove:
            goal = self._away(k)
            return goal if isinstance(goal, str) else goal._replace(what="remove")
        if world.state[k] == LOOSE:
            return Action(k, self.fitted(k), "place", world.source[k])
        places = supply_of(world, k)
        if not places:
            return f"no {world.pieces[k].name} is left in the supply"
        return Action(k, self.fitted(k), "place", places[0])

    # ------------------------------------------------------------ repair

    def _repair(self) -> Action | None:
        """What has to be put right first."""
        world, standing = self.world, self.standing()
        wrong = [k for k in sorted(standing - self.accepted) if self._wrong(k)]
        for k in wrong:
            top = next(iter(self.structure.loads(k, standing)), k)
            whole = self._bed(top) <= standing | self.accepted
            if top == k and whole and self._left(k, "again") > 2 * TRIES:
                return Action(k, self.fitted(k), "again")
            action = self._away(top) if self._left(top, "away") > 2 * TRIES else ""
            if isinstance(action, Action):
                return action
            self.accepted.add(k)  # Nothing helps: it stays as it is.
        for k in range(len(world.pieces)):
            if world.state[k] in (LOOSE, LOST) and self._in_the_way(k):
                action = self._away(k) if self._left(k, "away") > TRIES else ""
                if isinstance(action, Action):
                    return action
        return None

    def _crooked(self, k: int) -> Action | None:
        """Put a neighbour right that leaves a block no room."""
        standing, place = self.standing(), footprint_of(self.world, k).buffer(BESIDE)
        for n in sorted(standing - self.accepted):
            off = self.belief[n, :2] - self.world.target(n)[:2]
            other, piece = self.job.pieces[n], self.job.pieces[k]
            level = abs(other.target[2] - piece.target[2]) < other.half[2] + piece.half[2] - 1e-3
            free = not self.structure.loads(n, standing) and self._left(n, "again") > 2 * TRIES
            beside = footprint_of(self.world, n).intersects(place)
            if level and free and beside and np.linalg.norm(off) > NEAT:
                return Action(n, self.fitted(n), "again")
        return None

    def _bed(self, k: int) -> set[int]:
        """What a piece stands on and that is not meant to be gone."""
        return {b for b in self.structure.below[k] if self.world.state[b] != RETURNED}

    def _wrong(self, k: int) -> bool:
        """Whether a block has to be taken up again."""
        target, found = self.world.target(k), self.belief[k]
        frame = frame_of(found[3:])
        turned = abs((frame.yaw - self.world.pieces[k].yaw + QUARTER / 2) % QUARTER - QUARTER / 2)
        off = float(np.linalg.norm(found[:3] - target[:3]))
        missing = self._bed(k) - self.standing()
        return off > STANDS or max(turned, frame.tilt) > LEANS or bool(missing)

    def _away(self, k: int) -> Action | str:
        """Back to a magazine, to where it came from, or to a free place on the table."""
        world, piece = self.world, self.world.pieces[k]
        if (frame_of(world.pose[k, 3:]).side == np.eye(3)).all():
            own = world.source[k]
            number = world.magazine(k) if own is None else own
            if number is not None:
                return Action(k, world.presented(k, number), "away", number)
        for x, y in self._free_places(k):
            goal = np.array([x, y, piece.half[2], *yaw_quaternion(0.0)])
            return Action(k, goal, "away")
        return "there is no free place for it"

    def _free_places(self, k: int) -> list[tuple[float, float]]:
        """Places on the table where a block may lie, the nearest to the arm first."""
        import shapely

        taken = shapely.union_all([self._area(n) for n in self.world.visible() if n != k] + [
            footprint(p.shape, Pose(p.target[0], p.target[1], p.yaw)) for p in self.job.pieces
        ] + [footprint(s.shape, s.pose) for s in self.job.sources])  # fmt: skip
        size = float(np.linalg.norm(self.world.pieces[k].half))
        tried = self.fails.get((k, "away"), 0)
        grid = np.arange(-0.6, 0.61, 0.1)
        around = [(float(x), float(y)) for x in grid + self.job.base[0]
                  for y in grid + self.job.base[1]]  # fmt: skip
        around.sort(key=lambda p: abs(math.dist(p, self.job.base) - 0.45))
        free = [p for p in around
                if shapely.Point(p).distance(taken) > size + 0.03
                and math.dist(p, self.job.base) > 0.25 + size]  # fmt: skip
        return free[tried : tried + 1]

    def _area(self, k: int) -> Any:
        import shapely

        piece, pose = self.world.pieces[k], self.world.pose[k]
        turn = quaternion_matrix(pose[3:])
        corners = [pose[:3] + turn @ (np.array(c) + np.array(h) * s)
                   for c, h in piece.shape for s in np.ndindex(2, 2, 2)]  # fmt: skip
        corners += [pose[:3] + turn @ (np.array(c) - np.array(h) * s)
                    for c, h in piece.shape for s in np.ndindex(2, 2, 2)]  # fmt: skip
        return shapely.MultiPoint(np.array(corners)[:, :2]).convex_hull

    def _in_the_way(self, k: int) -> bool:
        """Whether it lies where a block shall stand or is presented."""
        world = self.world
        if world.source[k] is not None and world.state[k] == LOOSE:
            at = self.job.sources[world.source[k] or 0].pose
            if math.dist((at.x, at.y), world.pose[k, :2]) < BESIDE:
                return False  # It still waits where it always has.
        area = self._area(k).buffer(BESIDE)
        open_places = [n for n in range(len(self.job.pieces))
                       if n != k and world.state[n] in (STOCK, LOOSE)]  # fmt: skip
        if any(footprint_of(world, n).intersects(area) for n in open_places):
            return True
        return any(source.magazine and footprint(source.shape, source.pose).intersects(area)
                   for source in self.job.sources)  # fmt: skip

    # ------------------------------------------------------------ one attempt

    def act(self, action: Action) -> bool:
        """Try an action; False where the arm did not move because it cannot."""
        k, world = action.block, self.world
        key = (
            action.block,
            "again" if action.what == "again" else ("away" if action.what == "away" else "place"),
        )
        rng = np.random.default_rng([self.seed, len(self.done) + 1])
        before = world.pose[k].copy(), world.state[k], self.belief[k].copy()
        if world.state[k] == STOCK:
            assert action.source is not None
            world.pose[k] = world.presented(k, action.source)
            self._set_out(k, rng)
            self.belief[k] = world.pose[k]
        skip = self.fails.get(key, 0) % TRIES
        move, why = self._look(k, action.goal, skip)
        if move is None:
            world.pose[k], world.state[k], self.belief[k] = before
            if world.state[k] == LOOSE and action.what == "place" and world.magazine(k) is not None:
                self._replace(k)
                return False
            self.fails[key] = self.fails.get(key, 0) + TRIES
            if action.what in ("place", "remove"):
                self.refused[k] = why
            return False
        if before[1] == STOCK and action.source is not None:
            world.used[action.source] += 1
        self._sync()  # What was presented or taken in has moved during the last attempt.
        found = self._carry_out(action, move, rng)
        self._update(action, found)
        self.done.append(
            Done(len(self.done) + 1, k, action.what, found.outcome.label,
                 found.detail, found.stage, move.grasp.sideways)
        )  # fmt: skip
        self.fails[key] = 0 if found.reached else self.fails.get(key, 0) + 1
        self.refused.clear()
        if len(self.done) in self.disturbance.push:
            self._push(rng)
        self._read(action, found, rng)
        self._append()
        return True

    def _look(self, k: int, goal: np.ndarray, skip: int) -> tuple[Move | None, str]:
        """The first way the kinematic cell allows, after as many as have failed in reality."""
        rows, why, first = rows_of(self.world, self.belief, k), "", None
        if frame_of(self.belief[k, 3:]).tilt > FLAT:
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
        k, number = action.block, len(self.done) + 1
        rows = rows_of(self.world, self.world.pose, k, self.masses)
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
            after = self._all_poses()
            self.recorder.poses = after
            return found
        found = self.physical.attempt(
            rows.scene, move, joints=self.joints, quaternion=rows.quaternion
        )
        step = next((n for n, s in enumerate(self.order, 1)
                     if s.block == k and s.remove == (action.what == "remove")), None)  # fmt: skip
        if not self.recorder.steps and found.trajectory is not None:
            self.recorder = self._recorder(float(found.trajectory.width[0]))
        found = found._replace(detail=named(found.detail, rows, self.world))
        self.recorder.add_attempt(found, rows.scene, move, self._numbers(rows), step)
        if found.joints is not None:
            self.joints = found.joints
        if found.after is not None and found.quaternion is not None:
            self._take_over(rows, move, found.after, found.quaternion)
        return found

    def _recorder(self, width: float) -> BuildRecorder:
        """Of the build, before its first attempt; the pads are ``width`` apart [m]."""
        halves, densities = self._boxes()
        objects = [*self.cells, *([cell] for cell in self.fixed)]
        return BuildRecorder(
            self.job.arm, self.joints, width, self._all_poses(), objects, self.words, halves,
            densities,
        )  # fmt: skip

    def _boxes(self) -> tuple[np.ndarray, np.ndarray]:
        """Half extents float64[C, 3] [m] and densities float64[C] [kg/m3] of all cells of the
        record."""
        count = sum(map(len, self.cells)) + len(self.fixed)
        halves, densities = np.empty((count, 3)), np.empty(count)
        for k, piece in enumerate(self.world.pieces):
            cells = list(self.cells[self.body[k]])
            halves[cells] = [half for _, half in piece.shape]
            densities[cells] = piece.density * self.masses[k]
        for cell, obstacle in zip(self.fixed, self.job.obstacles, strict=True):
            halves[cell], densities[cell] = np.array(obstacle.size) / 2, OBSTACLE_DENSITY
        return halves, densities

    def _numbers(self, rows: Rows) -> np.ndarray:
        """int64[n]: cell of the record of each row."""
        return np.array([
            self.fixed[part] if owner < 0 else self.cells[self.body[owner]][part]
            for owner, part in zip(rows.owner, rows.part, strict=True)
        ])  # fmt: skip

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
        self._sync()

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
                self.accepted.discard(n) if n == k else None
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
        self._sync()

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
        world = self.world
        spare = world.add(k)
        self.like.append(k)
        first = len(self.recorder.poses)
        self.cells.append(tuple(range(first, first + len(world.pieces[k].shape))))
        self.body.append(self.body[k])
        self.body[k] = len(self.cells) - 1
        world.pose[spare], world.state[spare] = world.pose[k].copy(), LOST
        world.state[k], world.source[k] = STOCK, None
        world.hide(k)
        self.masses = np.append(self.masses, self.masses[k])
        self.belief = np.vstack([self.belief, world.pose[spare]])
        self.belief[k] = world.pose[k]
        self.variance = np.vstack([self.variance, self.variance[k]])
        self.recorder.half, self.recorder.density = self._boxes()
        self.recorder.objects = (*self.recorder.objects, self.cells[-1])
        self.recorder.poses = np.vstack([self.recorder.poses, self._cell_rows(k)])
        self._sync()

    def _set_out(self, k: int, rng: np.random.Generator) -> None:
        """A block is presented, not exactly where it should be."""
        place, turn = self.disturbance.supply
        if place or turn:
            self.world.pose[k, :2] += rng.normal(0.0, place, 2)
            yaw = frame_of(self.world.pose[k, 3:]).yaw + rng.normal(0.0, turn)
            self.world.pose[k, 3:] = yaw_quaternion(yaw)

    def _push(self, rng: np.random.Generator) -> None:
        """Somebody pushes a block that carries nothing, to where there is room."""
        standing = self.standing()
        free = [k for k in sorted(standing) if not self.structure.above[k] & standing]
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
                    self._sync()
                    return

    def _read(self, action: Action, found: Attempt, rng: np.random.Generator) -> None:
        """Read the poses of all blocks back, and what to believe of them."""
        if action.what in ("place", "again") and found.reached:
            self.belief[action.block] = action.goal
            self.variance[action.block] = STEADY**2, STEADY_YAW**2
        for k, state in enumerate(self.world.state):
            true = self.world.pose[k]
            if state in (STANDING, LOOSE, LOST) and any(self.noise):
                read_back(self.belief[k], self.variance[k], true, self.noise, rng)
            else:
                self.belief[k] = true

    def fitted(self, k: int) -> np.ndarray:
        """float64[7]: where a block goes, see :func:`~.workcell_sense.fitted`."""
        return fitted(self.world, self.belief, self.standing() - {k}, k)

    # ------------------------------------------------------------ the record

    def _cell_rows(self, k: int) -> np.ndarray:
        """float64[m, 7]: poses of the boxes of a piece."""
        pose, turn = self.world.pose[k], quaternion_matrix(self.world.pose[k, 3:])
        return np.array([
            [*(pose[:3] + turn @ np.array(c)), *pose[3:]] for c, _ in self.world.pieces[k].shape
        ])  # fmt: skip

    def _all_poses(self) -> np.ndarray:
        """float64[C, 7] of all cells of the record."""
        count = sum(map(len, self.cells)) + len(self.fixed)
        poses = np.zeros((count, 7))
        for k, body in enumerate(self.body):
            poses[list(self.cells[body])] = self._cell_rows(k)
        for cell, obstacle in zip(self.fixed, self.job.obstacles, strict=True):
            turn = yaw_quaternion(obstacle.yaw)
            poses[cell] = [*obstacle.centre, obstacle.size[2] / 2, *turn]
        return poses

    def _sync(self) -> None:
        poses = self._all_poses()
        self.recorder.poses = poses
        if self.recorder.steps:
            self.recorder.steps[-1] = dataclasses.replace(self.recorder.steps[-1], after=poses)

    def record(self) -> BuildRecord | None:
        """What the arm did; None without a simulation."""
        if self.physical is None:
            return None
        found, first = self.recorder.record(), self.recorder.poses
        count = len(first)

        def whole(poses: np.ndarray) -> np.ndarray:
            # Replacements wait in their magazines until they are needed.
            return np.vstack([poses, self._hidden()[len(poses) :]]) if len(poses) < count else poses

        steps: list[StepRecord] = []
        for step in found.steps:
            before = steps[-1].after if steps else whole(step.before)
            steps.append(dataclasses.replace(step, before=before, after=whole(step.after)))
        return dataclasses.replace(found, steps=tuple(steps))

    def _hidden(self) -> np.ndarray:
        """float64[C, 7]: all cells in their magazines."""
        poses = self._all_poses()
        poses[:, 2] = -HIDDEN - 0.1
        return poses

    # ------------------------------------------------------------ going on after an interruption

    def _append(self) -> None:
        if self.log is None:
            return
        world = self.world
        state = {
            "done": dataclasses.asdict(self.done[-1]), "pose": world.pose.tolist(),
            "state": world.state, "used": world.used, "source": world.source, "body": self.body,
            "like": self.like, "cells": [list(c) for c in self.cells],
            "masses": self.masses.tolist(), "belief": self.belief.tolist(),
            "variance": self.variance.tolist(), "joints": self.joints.tolist(),
            "accepted": sorted(self.accepted),
            "fails": [[k, what, n] for (k, what), n in self.fails.items()],
        }  # fmt: skip
        if self.physical is not None:
            state["record"] = packed_step(self.recorder.steps[-1])
        append_state(self.log, state)

    def _resume(self, log: Path) -> None:
        """Go on from what the file says, or begin it."""
        states = read_states(log, self.key)
        if not states:
            return
        for state in states:
            self.done.append(Done(**state["done"]))
            if "record" in state:
                self.recorder.take(unpacked_step(state["record"]))
        last, world = states[-1], self.world
        for piece in last["like"]:
            world.add(piece)
        world.pose = np.array(last["pose"])
        world.state, world.used, world.source = last["state"], last["used"], last["source"]
        self.body, self.like = last["body"], last["like"]
        self.cells = [tuple(c) for c in last["cells"]]
        self.masses, self.belief = np.array(last["masses"]), np.array(last["belief"])
        self.variance, self.joints = np.array(last["variance"]), np.array(last["joints"])
        self.accepted = set(last["accepted"])
        self.fails = {(k, what): n for k, what, n in last["fails"]}
        self.recorder.half, self.recorder.density = self._boxes()
        self.recorder.objects = (*self.cells, *((cell,) for cell in self.fixed))
        self.recorder.poses = self._all_poses()


def footprint_of(world: World, k: int) -> Any:
    """What a piece of the plan covers in the finished structure, as a shapely area."""
    piece = world.pieces[k]
    return footprint(piece.shape, Pose(piece.target[0], piece.target[1], piece.yaw))
