"""A build that goes on attempt by attempt: looked at, chosen, carried out, looked at again.

What it knows of the world is what its plant lets it sense. Whatever an attempt leaves behind is
where the next decision begins; a build that is interrupted goes on from its file.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from learn2assemble.acting.attempt import UNCERTAIN, Ahead, Attempts, Came
from learn2assemble.acting.belief import Estimate
from learn2assemble.acting.journal import Kept, Recording, append_state, packed, read_states
from learn2assemble.acting.sight import Sight
from learn2assemble.acting.state import Action, Choice, Done
from learn2assemble.cell.arrange import Arranged, describe
from learn2assemble.cell.structure import Structure
from learn2assemble.cell.workcell import DOWN, ROOMS, TRIES, Direction, Job, Progress, Workcell
from learn2assemble.cell.world import (
    FLAT,
    LOOSE,
    LOST,
    MISSING,
    RETURNED,
    STANDING,
    STOCK,
    Rows,
    WorkcellBlocks,
    moves,
    named,
    rows_of,
    supply_of,
)
from learn2assemble.geometry.rotations import quaternion_matrix
from learn2assemble.handling.prepare import Following
from learn2assemble.kinematics.cell import KinematicCell
from learn2assemble.motion.recorder import StepMotion
from learn2assemble.plants.checked import Checked
from learn2assemble.plants.plant import Plant, PlantError, Request, Stop, standing
from learn2assemble.plants.safety import by_rule
from learn2assemble.progress import Detail, Pace
from learn2assemble.robot.moves import Move, Outcome, carried

if TYPE_CHECKING:
    from pathlib import Path


PLACING = ("place", "again", "attach")
"""Actions after which a block is in its place."""
ATTACH = "attach"
"""What was built beside is brought."""
ASIDE = ("away", ATTACH)
"""Actions that are no step of a plan."""
GONE = 0.02
"""A block farther from its place than this is not in its place any more [m]."""
AT_SOURCE = 0.005
"""A block that is seen no farther from where it is meant to wait does so [m]."""
SAME_JOINTS = 1e-3
"""Drives stray by less from where they were told to be [rad]."""
PAUSED = "paused"
OLDEST = 2.0
"""Readings that are older are not used [s]."""


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
        plant: that carries it out.
        words: what the outcomes come from.
        key: what the file it goes on from must have been written for.
        kept: where the plant is a simulation that is kept in that file.
        witness: called after every attempt; what it keeps is for reports when the build is over.
    """

    job: Job
    kinematic: KinematicCell
    key: str
    kept: Kept | None
    log: Path | None
    recorded: bool
    witness: Callable[[], None]
    stopped: Stop
    tries: int = TRIES
    """Ways that are tried by turns, of a block."""

    def __init__(
        self,
        found: Prepared,
        workcell: Workcell,
        plant: Plant,
        words: str = "",
        key: str = "",
        kept: Kept | None = None,
        witness: Callable[[], None] = lambda: None,
    ) -> None:
        self.job, self.kinematic, self.key, self.kept = found.job, found.cell, key, kept
        self.known: Choice = Choice(found.job, found.order, found.structure)
        self.log, self.recorded = workcell.log, workcell.physics == "dynamic"
        self.world: WorkcellBlocks = self.known.world
        arm = self.job.arm
        self.names: set[str] = set(self.world.names)
        """Of all blocks there ever were."""
        self.plant: Checked = Checked(plant, arm.name, len(arm.joints), self.names, OLDEST)
        self.sight: Sight = Sight(self.plant, arm, self.world, workcell.touch)
        for piece in (piece for piece in self.job.pieces if piece.fixed):
            # Nobody sees it: it is where the design has it.
            self.sight.belief.known[piece.id] = Estimate(piece.pose, np.zeros((6, 6)))
        self.sight.pause = self._pause
        self.attempts: Attempts = Attempts(self.job, self.plant, self.sight, self.recorded)
        self.witness, self.stopped = witness, Stop.END
        """Why the plant ended the build, where it did."""
        self.pace: Pace = Pace()
        """Of the steps that are left."""
        self.joints: np.ndarray = self._where(arm.home)
        self.between: set[int] = set()
        """Blocks that another arm fetches next, before this one does."""
        self.goes_home: bool = bool(workcell.site.cameras)
        """Whether the arm waits at home, not above what it takes next: where cameras look for
        blocks it goes out of their sight."""
        self.stood: float = 0.0
        """So long the arm did nothing before an attempt, where others work meanwhile [s], ..."""
        self.gone: StepMotion | None = None
        """... after it has done this, since its last attempt."""
        self.chosen: Callable[[], None] = lambda: None
        """Called when it is decided how the arm moves, before it does."""
        studs = found.structure.studs()
        self.recording: Recording = Recording(self.world, self.joints, words, studs)
        self._resume()

    # ------------------------------------------------------------ going on

    def run(
        self,
        progress: Progress = lambda text: None,
        go_on: Callable[[Action], bool] = lambda action: True,
    ) -> str | None:
        """Until everything is done; why not, in words, where it cannot be.

        Args:
            progress: is told what came of every attempt.
            go_on: asked before every attempt; where it says no, the build pauses.
        """
        try:
            return self._run(progress, go_on)
        except PlantError as error:
            self.stopped = error.stop
            # What a rule forbids the plant was not asked for.
            return error.why if by_rule(error.why) else str(error)

    def _run(self, progress: Progress, go_on: Callable[[Action], bool]) -> str | None:
        if not self.known.done:
            self.look()
        most = 2 * len(self.known.order) + 20
        while len(self.known.done) < most:
            action = self.known.choose()
            if not isinstance(action, Action):
                return action
            if not go_on(action):
                return PAUSED
            if not self.act(action):
                continue
            last = self.known.done[-1]
            piece = self.world.pieces[action.block]
            left = sum(not self.known.satisfied(step) for step in self.known.order)
            how = "by hand" if last.hand else f"attempt {last.number}"
            text = f"{how}: {last.what} {piece.id} ({piece.name}): {last.outcome}, "
            text += f"{left} step{'s' * (left != 1)} left{self.pace.about(left)}"
            progress(Detail(text))
        return f"given up after {most} attempts"

    # ------------------------------------------------------------ one attempt

    def act(self, action: Action) -> bool:
        """Try an action; False where the arm did not move because it cannot."""
        k, world = action.block, self.world
        if action.what == "hand":
            return self._by_hand(action)
        key = k, "place" if action.what == "remove" else action.what
        state, presented = world.state[k], world.state[k] == STOCK
        move, why, rows = None, f"{world.pieces[k].id} is not seen", None
        if not presented or self._present(action):
            if presented and action.what == "place":
                # How well a place can be known at all is known once something was seen.
                action = action._replace(goal=self.known.fitted(k))
            skip = self.known.fails[key] % self.tries
            move, why, rows = self._way(action, skip)
        placing = action.what in PLACING
        height, home = UNCERTAIN, None
        if move is not None and rows is not None:
            # While what is taken to stand already does so.
            studs = self.known.structure.joints_of(world, rows, placing, action.group, action.to)
            rows = rows._replace(scene=rows.scene._replace(studs=studs))
            if placing:
                height, home = self.known.height(k), self.known.home(k, action.group, action.to)
        self.chosen()
        if move is None or rows is None:
            if presented:
                self._take_back(k)
            if state == LOOSE and action.what == "place" and world.magazine(k) is not None:
                self._replace(k)
                return False
            self.known.fails[key] += TRIES
            if action.what in ("place", "remove", "attach"):
                self.known.refused[k] = why
            return False
        if presented and action.source is not None:
            world.used[action.source] += 1
        # What was presented or taken in has moved during the last attempt.
        self.recording.takes((k, *action.group))
        for n in action.group:
            self._ask("join", n, world.pose[n], world.names[k])
        lost: PlantError | None = None
        try:
            following = None
            if presented or action.group:
                following = self._following(action)
            ahead = Ahead(following, height, home)
            came = self.attempts.carry_out(rows, move, k, self.joints, ahead)
        except PlantError as error:
            lost, came = error, self._interrupted(rows, move, k, error)
        if came.yields:
            self.recording.taken.clear()
            if presented and action.source is not None:
                world.used[action.source] -= 1
                self._take_back(k)
            return False
        self._come_home(action, rows, came.reached and placing)
        came = came._replace(detail=named(came.detail, rows, world))
        self._record(action, rows, move, came)
        self.joints = came.joints
        self.sight.pause = self._pause
        try:
            if lost is None:
                self.look(k)
        except PlantError as error:
            lost = error
        if lost is not None:
            self._believe(k)
        self._update(action, came, lost is None)
        self.known.done.append(
            Done(
                len(self.known.done) + 1,
                k,
                action.what,
                came.outcome.label,
                came.detail,
                came.stage,
                move.grasp.sideways,
            )
        )
        self.witness()
        self.known.fails[key] = 0 if came.reached else self.known.fails[key] + 1
        self.known.refused.clear()
        self._append()
        if lost is not None:
            raise lost
        return True

    def _following(self, action: Action) -> Following | None:
        """What the arm takes next, from a source or where it was built beside; None where it does
        not know that, waits at home, or somebody comes near before."""
        world, k = self.world, action.block
        step = self.known.next_after({k, *self.between})
        if self.goes_home or step is None or step.remove or step in self.known.by_hand:
            return None
        n, sources = step.block, supply_of(world, step.block)
        here, there = world.pose[k] if action.group else None, None
        if step.group:
            here, there = action.goal, world.target(n)
        elif sources and world.state[n] == STOCK:
            there = world.presented(n, sources[0])
            if not action.group and action.source is not None:
                here = world.presented(k, action.source)
        if here is None or there is None:
            return None
        top, other = (world.pieces[m].corners(at)[:, 2].max() for m, at in ((k, here), (n, there)))
        higher = max(other - top, 0.0)
        return Following(np.array([*(there - here)[:2], higher]), bool(step.group))

    def _interrupted(self, rows: Rows, move: Move, k: int, error: PlantError) -> Came:
        """What came of an attempt that the plant has ended, as far as it is known: what was in the
        hand is not, for somebody has to take it out; what was let go is where that was."""
        name, held = self.world.names[k], self.sight.held is not None
        if held:
            self.sight.held = None
            self.sight.belief.forget(name)
        known, outcome = self.sight.belief.known.get(name), Outcome.STOPPED
        if known is not None:
            row = rows.scene.position[move.cell]
            near = np.linalg.norm(known.pose[:3] - row) < np.linalg.norm(row - move.target) / 2
            outcome = Outcome.STOPPED if near else Outcome.REACHED
        outcome = Outcome.DROPPED if held else outcome
        return Came(outcome, "", f"interrupted: {error.why}", self.joints)

    def _believe(self, k: int) -> None:
        """Blocks are where they are believed to be, as nobody can look."""
        self.sight.write()
        known = self.sight.belief.known.get(self.world.names[k])
        if known is not None:
            self.world.pose[k] = known.pose

    def _by_hand(self, action: Action) -> bool:
        """A step is done by hand: the block is where it shall be, or gone."""
        k, world = action.block, self.world
        number = len(self.known.done) + 1
        what = "remove" if world.state[k] == STANDING else "place"
        there = action.goal if what == "place" else world.pose[k]
        self.recording.by_hand(k, what == "place", self.stood, there)
        drawn = world.drawn(k)
        drawn[:3] += action.goal[:3] - world.target(k)[:3]
        self._ask(what, k, drawn)
        if what == "remove":
            world.state[k] = RETURNED
            self.sight.belief.forget(world.names[k])
            world.hide(k)
        else:
            world.state[k], world.pose[k] = STANDING, action.goal
        self.look(k)
        self.known.done.append(Done(number, k, what, Outcome.REACHED.label, "", "", hand=True))
        self.known.refused.clear()
        self.recording.sync()
        self._append()
        return True

    def _present(self, action: Action) -> bool:
        """Let a magazine present a block; whether it is seen there."""
        k, world = action.block, self.world
        assert action.source is not None
        self._ask("present", k, world.presented(k, action.source))
        self.sight.look({world.names[k]})
        if self.sight.unknown(k):
            return False
        known = self.sight.belief.known[world.names[k]]
        world.pose[k], world.spread[k] = known.pose, (known.spread, known.turn_spread)
        return True

    def _take_back(self, k: int) -> None:
        """A magazine takes back what it presented, or what was brought to it."""
        self._ask("return", k, self.world.pose[k])
        self.sight.belief.forget(self.world.names[k])
        self.world.hide(k)

    def _ask(self, what: str, k: int, pose: np.ndarray, kind: str = "") -> None:
        """Ask somebody else in the cell for something."""
        name = self.world.names[k]
        self.names.add(name)
        kind = kind or self.world.pieces[k].id
        self.plant.request(Request(what, name, kind, np.array(pose, float)))

    def _way(self, action: Action, skip: int) -> tuple[Move | None, str, Rows]:
        """The first way the kinematic cell allows, after as many as have failed in reality."""
        k, goal = action.block, action.goal
        poses, why = self.world.pose.copy(), ""
        poses[k] = self.world.resting(k)
        rows = rows_of(self.world, poses, k, action.group)
        into: tuple[Direction, ...] = (DOWN,)
        if action.what in ("place", "again"):
            into = self.known.structure.ways_in(k, self.known.standing() - {k})
        press = self._press(action) if action.what in PLACING else None
        reached: list[Move] = []
        ways = [*moves(self.world, rows, k, goal, into, press)]
        for room in (0.0,) if press is None else ROOMS:
            self.kinematic.apart = room
            for move in ways:
                found = self.kinematic.attempt(rows.scene, move)
                if found.reached and not any(move is one for one in reached):
                    reached.append(move)
                    if len(reached) > skip:
                        return move, "", rows
                elif not found.reached:
                    why = why or named(describe(found), rows, self.world)
        first = reached[0] if reached else None
        return first, why or "the tool cannot hold it", rows

    def _press(self, action: Action) -> tuple[float, float] | None:
        """Where a block is pressed home, x and y [m]; None: it is not."""
        k, taken = action.block, (action.block, *action.group)
        there = np.array(action.to) if action.group else self.world.beside[k]
        apart = (self.world.beside == there).all(1)
        here = {n for n in self.known.standing() if apart[n]} - set(taken)
        at = self.known.structure.press_at(k, action.group, here)
        return None if at is None else (action.goal[0] + at[0], action.goal[1] + at[1])

    def _come_home(self, action: Action, rows: Rows, pressed: bool) -> None:
        """Which joints of studs are home now, as far as that is known: those of a block that was
        pressed, and none of one that was taken elsewhere. What was built beside is so no more."""
        if pressed and action.what == "attach":
            self.world.beside[[action.block, *action.group]] = action.to
        taken, home = {action.block, *action.group}, self.world.home
        for pair in [pair for pair in home if len(taken & set(pair)) == 1]:
            home.discard(pair)
        studs = rows.scene.studs
        for joint in studs.joints if studs is not None and pressed else ():
            below = joint.lower if joint.lower < 0 else int(rows.owner[joint.lower])
            home.add((below, int(rows.owner[joint.upper])))

    # ------------------------------------------------------------ looking

    def _where(self, told: np.ndarray) -> np.ndarray:
        """float64[n]: joints at which the next motion begins: as it was told last where the arm is
        there, else as they are sensed [rad]."""
        sensed = self.plant.sense().joints
        return told.copy() if np.abs(sensed - told).max() < SAME_JOINTS else sensed

    def _pause(self, seconds: float) -> None:
        """Wait, standing still."""
        self.plant.execute(standing("home", self.joints, seconds))

    def look(self, k: int | None = None) -> None:
        """See where everything is.

        Args:
            k: a block that was moved, which has to be found.
        """
        world = self.world
        needed = {world.names[n] for n in world.visible()} | (
            {world.names[k]} if k is not None else set[str]()
        )
        self.sight.look(needed)
        for n in world.visible():
            if self.sight.unknown(n) and n != k and n not in self.sight.carried:
                self._lose(n)
        if k is not None and not self.sight.unknown(k):
            world.pose[k] = self.sight.belief.known[world.names[k]].pose

    def _update(self, action: Action, came: Came, asks: bool = True) -> None:
        """Which block is where now, as far as it was seen.

        Args:
            asks: whether a magazine can be asked to take a block back.
        """
        world, k = self.world, action.block
        placing = action.what in PLACING
        if came.reached and not placing:
            back = action.source is not None and world.job.sources[action.source].magazine
            extra = k >= len(self.job.pieces)
            if asks and (back or action.what == "remove"):
                self._take_back(k)
            gone = action.what == "remove" or (back and extra)
            world.state[k] = RETURNED if gone else LOST if extra else STOCK if back else LOOSE
            if back and action.what in ("away", "remove") and not extra:
                world.used[action.source or 0] -= 1
        for n in [k, *(n for n in world.visible() if n != k)]:
            if (n == k and came.reached and not placing) or n in self.sight.carried:
                continue
            if self.sight.unknown(n):
                self._lose(n)
                continue
            if n >= len(self.job.pieces):
                world.state[n] = LOST
                continue
            piece, now = world.pieces[n], world.pose[n, 3:]
            off = world.pose[n, :3] - world.target(n)[:3]
            in_place = np.linalg.norm(off) < GONE and piece.lean(now, piece.pose[3:]) < FLAT
            upright = piece.lean(now, piece.waits[3:]) < FLAT
            if in_place and (
                n != k or came.outcome not in (Outcome.UNREACHABLE,) or world.state[n] == STANDING
            ):
                world.state[n] = STANDING
                self.known.accepted.discard(n) if n == k else None
            elif (
                asks
                and n == k
                and action.source is not None
                and self._still_there(n, action.source)
            ):
                # What was to be taken away and fell at its magazine is where it belongs.
                world.state[n] = RETURNED if action.what == "remove" else STOCK
                world.used[action.source] -= 1
                self._take_back(n)
            elif upright:
                world.state[n] = LOOSE
            else:
                self._lose(n)
        for n, state in enumerate(world.state):
            if state in (STOCK, RETURNED, MISSING):
                world.hide(n)
        self.recording.sync()

    def _still_there(self, k: int, source: int) -> bool:
        """Whether a block lies at its magazine, which takes it back then."""
        at = self.world.presented(k, source)
        near = np.linalg.norm(self.world.pose[k, :3] - at[:3]) < GONE
        return bool(near) and self.job.sources[source].magazine

    def _lose(self, k: int) -> None:
        """The block cannot be used from where it lies, or it is not seen any more; the next one of
        its kind takes its place."""
        if k < len(self.job.pieces) and self.world.magazine(k) is not None:
            self._replace(k)
        else:
            self.world.state[k] = MISSING if self.sight.unknown(k) else LOST

    def _replace(self, k: int) -> None:
        """Another block of the kind takes its place in the plan; this one lies where it lies."""
        world, missing = self.world, self.sight.unknown(k)
        spare = self.recording.replace(k)
        self.names.add(world.names[k])
        world.pose[spare], world.state[spare] = world.pose[k].copy(), MISSING if missing else LOST
        world.state[k], world.source[k] = STOCK, None
        world.hide(k)
        if missing:
            world.hide(spare)
        self.recording.sync()

    # ------------------------------------------------------------ the record

    def _record(self, action: Action, rows: Rows, move: Move, came: Came) -> None:
        """Append an attempt to the record of the build."""
        self.recording.taken.clear()
        if not self.recorded:
            return
        recorder, scene = self.recording.recorder, rows.scene
        if not recorder.steps and came.motion is not None:
            self.recording.begin(self.joints, float(came.motion.width[0]))
        step = next(
            (
                n
                for n, s in enumerate(self.known.planned, 1)
                if s.block == action.block and s.remove == (action.what == "remove")
            ),
            None,
        )
        motion = None if came.motion is None else came.motion.after(self.stood, self.joints)
        if motion is not None and self.gone is not None:
            motion, self.gone = self.gone.then(motion), None
        members = scene.members(move.cell)
        turn = carried(scene, move, members)[1][0]
        self.recording.recorder.add(
            plan_step=step,
            cells=self.recording.numbers(rows)[members].tolist(),
            target=np.array([*move.target, *turn]),
            outcome=came.outcome,
            detail=came.detail,
            motion=motion,
            source=self._source(action, rows, move),
        )

    def _source(self, action: Action, rows: Rows, move: Move) -> np.ndarray | None:
        """float64[7]: where the cell that is grasped is meant to wait, if its block is there; None
        where it is seen exactly, or is meant to be nowhere."""
        k, world = action.block, self.world
        if not world.spread.any() or action.what not in ("place", "remove"):
            return None
        pose = world.drawn(k)
        if action.what == "place":
            source = world.magazine(k) if action.source is None else action.source
            if source is None:
                return None
            pose = world.presented(k, source)
        centre = np.array(world.pieces[k].shape[int(rows.part[move.cell])].centre)
        place = pose[:3] + quaternion_matrix(pose[3:]) @ centre
        near = np.linalg.norm(rows.scene.position[move.cell] - place) < AT_SOURCE
        return np.array([*place, *pose[3:]]) if near else None

    # ------------------------------------------------------------ going on after an interruption

    def snapshot(self) -> dict[str, Any]:
        """All that is known of the build, with what came of the last attempt."""
        world = self.world
        return {
            "pose": world.pose.tolist(),
            "spread": world.spread.tolist(),
            "state": list(world.state),
            "used": list(world.used),
            "source": list(world.source),
            "names": list(world.names),
            "joints": self.joints.tolist(),
            **self.known.state(),
            **self.sight.state(),
            **self.recording.state(),
        }

    def take_up(self, last: dict[str, Any], done: list[Any], records: list[Any]) -> None:
        """Know what was known; the plant is as it was.

        Args:
            last: the latest :meth:`snapshot`.
            done: what came of all attempts, as snapshots say it.
            records: of their steps.
        """
        world = self.world
        for piece in last["like"]:
            world.add(piece)
        world.names[:] = last["names"]
        self.names.update(world.names)
        world.pose, world.spread = np.array(last["pose"]), np.array(last["spread"])
        world.state, world.used, world.source = last["state"], last["used"], last["source"]
        self.joints = self._where(np.array(last["joints"]))
        self.known.restore(last, done)
        self.sight.restore(last)
        self.recording.restore(last, records)

    def _append(self) -> None:
        if self.log is None:
            return
        state = self.snapshot()
        if self.kept is not None:
            state["plant"] = self.kept.save()
            # The simulation goes on from what is in the file, as it does when it is read again: an
            # arm that stands has no speed left, and the solver no memory.
            self.kept.restore(state["plant"])
        if self.recorded and not self.known.done[-1].hand:
            state["record"] = packed(self.recording.recorder.steps[-1])
        append_state(self.log, state)

    def _resume(self) -> None:
        """Go on from what the file says, or begin it."""
        states = [] if self.log is None else read_states(self.log, self.key)
        if not states:
            return
        last = states[-1]
        if self.kept is not None and "plant" in last:
            self.kept.restore(last["plant"])
        records = [state["record"] for state in states if "record" in state]
        self.take_up(last, [state["done"] for state in states], records)

    def hand_back(self, k: int) -> None:
        """A magazine takes back what it has presented, wherever that is now: nothing came of the
        attempt."""
        self._take_back(k)
        number = self.world.magazine(k)
        if number is not None:
            self.world.used[number] -= 1
        self.world.state[k] = STOCK

    def presented(self) -> list[int]:
        """Blocks that lie at magazines, and were to be fetched there."""
        world, found = self.world, list[int]()
        for k in range(len(self.job.pieces)):
            number = world.magazine(k)
            if world.state[k] == LOOSE and number is not None and self._still_there(k, number):
                found.append(k)
        return found
