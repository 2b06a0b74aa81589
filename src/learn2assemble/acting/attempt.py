"""One attempt of the arm: planned in the world as it is believed, carried out by a plant."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from learn2assemble.acting.belief import Estimate
from learn2assemble.acting.sight import Sight
from learn2assemble.cell.workcell import Job
from learn2assemble.cell.world import STOCK, Rows
from learn2assemble.geometry.rotations import quaternion_matrix
from learn2assemble.handling.dynamic_cell import DynamicCell
from learn2assemble.handling.execution import (
    ALONE,
    BLIND,
    LOADED,
    LOOSE,
    Coordinator,
    Execution,
    Rig,
    straight_motion,
)
from learn2assemble.handling.prepare import (
    PRESS,
    Approaches,
    Course,
    Following,
    least_rise,
    leaving,
    prepare,
    require_held,
    rest_pose,
)
from learn2assemble.handling.recovery import abandon
from learn2assemble.handling.rest import ShiftRule, check_rest
from learn2assemble.handling.ways import WorldChecker, free_way
from learn2assemble.kinematics.approach import ApproachPath, approach_path, tool_path
from learn2assemble.motion.record import RATE, Stage
from learn2assemble.motion.recorder import StepMotion
from learn2assemble.plants.plant import Motion, Plant, ToolCommand
from learn2assemble.robot.moves import Failure, Move, Outcome, Scene, turned, turns
from learn2assemble.simulation.model import SimulatedWorld, lean_table
from learn2assemble.simulation.objects import Order, rigid_objects, take_order

REST = 0.5
"""Blocks that were disturbed are left alone for so long before it is looked where they are [s]."""
OPENING_TIME = 0.5
"""In which a hand lets go of what it could put back nowhere [s]."""


UNCERTAIN, CERTAIN = LOOSE, 0.001
"""How near to a place a block may meet what carries it, at most, and where that is known well
[m]."""
SPREADS = 4.0
"""What carries it is within so many standard deviations of where it is believed to be."""


HOME_HEIGHT = 0.001
"""What is pressed on studs and is stopped farther above its place is not home [m]: knobs that do
not go in keep it 1.7 mm above it, or more."""
HOME = np.diag([2.5e-4**2] * 3 + [3e-3**2] * 3)
"""float64[6, 6]: covariance of the place of a brick that is pressed home [m], [rad]. Between bricks
side by side are 0.25 mm."""


class Ahead(NamedTuple):
    """What an attempt is told of the rest of the build."""

    following: Following | None = None
    """The arm waits above that; None: at home."""
    height: float = UNCERTAIN
    """Standard deviation of the height of what carries the block in its place [m]."""
    home: np.ndarray | None = None
    """float64[7]: where knobs draw the block once it is pressed on them; None: there are none."""


NOTHING_AHEAD = Ahead()


class Came(NamedTuple):
    """What came of an attempt."""

    outcome: Outcome
    stage: str
    detail: str
    joints: np.ndarray
    """float64[n] where the arm is [rad]."""
    motion: StepMotion | None = None
    """What the drives were told."""
    yields: bool = False
    """Nothing was done, because another arm is in the way now."""

    @property
    def reached(self) -> bool:
        """Whether all went as ordered."""
        return self.outcome == Outcome.REACHED


class AttemptSenses:
    """What is known during an attempt, object by object of its order.

    Args:
        sight: what is known of all blocks.
        order: what is asked.
        rows: of its scene.
        moving: the piece that is moved.
        home: as :attr:`Ahead.home`.
    """

    sight: Sight
    order: Order
    rows: Rows
    moving: int

    def __init__(
        self, sight: Sight, order: Order, rows: Rows, moving: int, home: np.ndarray | None
    ) -> None:
        self.sight, self.order, self.rows, self.moving = sight, order, rows, moving
        self.home = home
        self.name: str = sight.world.names[moving]
        self.run: Execution | None = None

    def _centre(self, row: int) -> np.ndarray:
        """float64[3]: middle of a part in the frame of its block [m]."""
        piece = self.sight.world.pieces[int(self.rows.owner[row])]
        return np.array(piece.shape[int(self.rows.part[row])].centre)

    def settle(self, stage: str) -> None:
        """See :class:`~learn2assemble.handling.execution.Senses`."""
        assert self.run is not None
        self.run.wait(REST, stage, BLIND)

    def taken(self) -> None:
        """See :class:`~learn2assemble.handling.execution.Senses`."""
        assert self.run is not None
        move = self.run.course.plan.move
        scene = self.order.scene
        mine = scene.object_id == scene.object_id[move.cell]
        along = {int(k) for k in self.rows.owner[mine]} - {self.moving}
        names = [self.sight.world.names[k] for k in sorted(along)]
        self.sight.taken(self.name, move.grasp, self._centre(move.cell), names)

    def in_hand(self) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`~learn2assemble.handling.execution.Senses`."""
        if self.sight.held is None:
            assert self.run is not None
            return self.order.in_hand(self.run.course.plan.move.grasp)
        lead = int(self.order.objects.lead[self.order.target])
        where, turn = self.sight.in_hand()
        return where + turn @ self._centre(lead), turn

    def look(self) -> np.ndarray:
        """See :class:`~learn2assemble.handling.execution.Senses`."""
        run, sight = self.run, self.sight
        assert run is not None
        guard = LOADED if run.holding else BLIND
        sight.pause = lambda seconds: run.wait(seconds, run.log[-1][0], guard)
        sight.look(fine=run.holding)
        poses = self.order.poses.copy()
        stock = {k for k, state in enumerate(sight.world.state) if state == STOCK}
        for number, lead in enumerate(self.order.objects.lead.tolist()):
            k = int(self.rows.owner[lead])
            if k == self.moving and sight.held is not None:
                pose = sight.held_pose(run.joints)
            elif k < 0 or (k != self.moving and (k in sight.carried or k in stock)):
                # An obstacle, or what another arm moves, or is about to put where it was taken to
                # be.
                continue
            else:
                pose = sight.world.pose[k]
                if k == self.moving and not sight.unknown(k):
                    pose = sight.belief.known[self.name].pose
            place = pose[:3] + quaternion_matrix(pose[3:]) @ self._centre(lead)
            poses[number] = [*place, *pose[3:]]
        return poses

    def let_go(self) -> None:
        """See :class:`~learn2assemble.handling.execution.Senses`.

        What was pressed on studs and met its resistance at the height of its place is home: studs
        draw it there.
        """
        run, home = self.run, self.home
        assert run is not None
        self.sight.let_go()
        known = self.sight.belief.known.get(self.name)
        if known is None or home is None or not (run.landed and run.press()):
            return
        if abs(known.pose[2] - home[2]) < HOME_HEIGHT:
            self.sight.rests(self.name, Estimate(home, HOME))

    def lost(self) -> None:
        """See :class:`~learn2assemble.handling.execution.Senses`."""
        self.sight.dropped()


class Attempts:
    """How an arm carries moves out.

    Args:
        job: what is built, by whom.
        plant: the arm and its world.
        sight: what is known of it.
        careful: ways of the arm are planned in the world as it is believed; else they are straight.
    """

    job: Job
    plant: Plant
    sight: Sight

    def __init__(self, job: Job, plant: Plant, sight: Sight, careful: bool) -> None:
        self.job, self.plant, self.sight = job, plant, sight
        self.planner: DynamicCell | None = DynamicCell(job.arm, recover=True) if careful else None
        """Has the models in which ways are planned, and the limits."""
        self.announce: Callable[[Execution, str], bool] = lambda run, block: True
        """Called before the arm moves, with the name of the block that it will: whether it may."""
        self.coordinator: Coordinator = ALONE
        self.near: np.ndarray | None = None
        """As of :func:`~.prepare.prepare`."""
        self.stays: Callable[[Execution], None] = lambda run: None
        """Called when the block rests in its place, still in the hand, which lets go of it when
        this returns."""

    def carry_out(
        self,
        rows: Rows,
        move: Move,
        k: int,
        joints: np.ndarray,
        ahead: Ahead = NOTHING_AHEAD,
    ) -> Came:
        """Carry a move out.

        Args:
            rows: the scene as it is believed.
            move: the order.
            k: the piece that is moved.
            joints: float64[n] where the arm is [rad].
            ahead: what is known of the rest of the build.

        Raises:
            PlantError: where the plant answers nonsense, or not at all.
        """
        order = take_order(rows.scene, move)
        try:
            require_held(self.job.arm, rows.scene, move)
            course, world = self._course(order, joints, ahead.following)
        except Failure as failure:
            return Came(failure.outcome, failure.stage, failure.detail, joints)
        senses = AttemptSenses(self.sight, order, rows, k, ahead.home)
        arm = self.job.arm
        limits = arm.bounds.scaled(0.8), arm.bounds.scaled(0.6)
        if self.planner is not None:
            limits = self.planner.limits, self.planner.loaded
        guarded = min(CERTAIN + SPREADS * ahead.height, UNCERTAIN)
        rig = Rig(self.plant, senses, arm, world, *limits, guarded, self.coordinator)
        run = senses.run = Execution(rig, order, course, joints)
        if not self.announce(run, senses.name):
            return Came(
                Outcome.UNREACHABLE, "approach", "another arm is in the way", joints, None, True
            )
        failure = None
        try:
            run.bring()
            self.stays(run)
            run.leave()
            check_rest(run.order, senses.look(), 0.0, run.landed, ShiftRule())
        except Failure as found:
            failure = _abandoned(run, found)
        if run.holding:
            self._open(run)
        came = Came(Outcome.REACHED, "", "", run.joints, motion_of(run, arm.gripper.max_width))
        if failure is None:
            return came
        return came._replace(outcome=failure.outcome, stage=failure.stage, detail=failure.detail)

    def leave_anew(self, run: Execution, rows: Rows) -> None:
        """Plan the ways by which an arm leaves a block that it holds in its place, as things are
        now.

        Args:
            run: the attempt that has brought the block there.
            rows: the scene as it is believed now, in which the block stands.

        Raises:
            Failure: where there is no way home.
        """
        senses, move = run.rig.senses, run.course.plan.move
        if self.planner is None or run.leaving is None or not isinstance(senses, AttemptSenses):
            return
        mine = (rows.owner == senses.moving) & (rows.part == senses.rows.part[move.cell])
        move = move._replace(cell=int(np.flatnonzero(mine)[0]), grasp=move.place)
        order = take_order(rows.scene, move)
        world = self.planner.world(order.objects, order.scene.studs)
        lean_table(world.plan, order.scene.table)
        run.order, run.rig = order, replace(run.rig, world=world)
        senses.order, senses.rows = order, rows
        checker = WorldChecker(self.job.arm, world, order.poses, order.names)
        checker.empty(order.opening)
        rest, why = rest_pose(self.job.arm, checker), None
        for leave in _ends(checker, run.leaving, least_rise(self.job.arm, order)):
            try:
                home = free_way(checker, leave.joints[-1], rest, "home")
            except Failure as failure:
                why = failure
                continue
            run.leaving, run.course = leave, run.course._replace(home=home)
            return
        raise why or Failure(Outcome.UNREACHABLE, "retreat", "the way out of its hold is not free")

    def way_home(self, scene: Scene, joints: np.ndarray) -> Iterator[Motion]:
        """The motions from joints to the home of the arm, where ways are planned.

        Args:
            scene: as it is believed.
            joints: float64[n], where the arm stands [rad].

        Raises:
            Failure: where there is no free way.
        """
        if self.planner is None:
            return
        objects, poses, names = rigid_objects(scene)
        world = self.planner.world(objects)
        lean_table(world.plan, scene.table)
        checker = WorldChecker(self.job.arm, world, poses, names)
        for leg in pairwise(free_way(checker, joints, self.job.arm.home, "home")):
            yield straight_motion(np.array(leg), self.planner.limits, "home")

    def _open(self, run: Execution) -> None:
        """Let go of what could be put back nowhere; it is looked for afterwards."""
        gripper = self.job.arm.gripper
        told = ToolCommand(vacuum=False)
        if self.job.arm.suction is None:
            told = ToolCommand(width=gripper.max_width, speed=gripper.speed)
        with suppress(Failure):  # It opens, however hard the tool is pressed meanwhile.
            run.wait(OPENING_TIME, "release", BLIND, (told,))
        self.sight.dropped()
        with suppress(Failure):
            run.wait(REST, "release", BLIND)

    def _course(
        self, order: Order, joints: np.ndarray, following: Following | None
    ) -> tuple[Course, SimulatedWorld | None]:
        """The ways of an attempt, and the model they were planned in."""
        if self.planner is not None:
            world = self.planner.world(order.objects, order.scene.studs)
            lean_table(world.plan, order.scene.table)
            # Where another arm waits for its turn, high ways would take its time, too.
            low, near = self.coordinator is not ALONE, self.near
            return prepare(self.job.arm, world, order, joints, True, following, near, low), world
        return straight(self, order, joints), None


def _abandoned(run: Execution, failure: Failure) -> Failure:
    """An attempt that failed and was ended, also where a rule of safety stops the arm as it stands:
    it is pressed with more force than the rule allows, wherever it goes."""
    try:
        return abandon(run, failure, True)
    except Failure as second:
        detail = f"{failure.detail}; then {second.stage}: {second.detail}"
        return Failure(failure.outcome, failure.stage, detail)


OUT_STEP = 0.05
"""Between the ends of a way out that are tried [m]."""


def _ends(checker: WorldChecker, path: ApproachPath, least: float) -> Iterator[ApproachPath]:
    """A way out as far as it is free, then shorter ones, not shorter than that [m]."""
    count = int((path.rise < least).sum()) + 1
    while count < len(path.joints) and checker.check(path.joints[count]) is None:
        count += 1
    while path.rise[count - 1] >= least:
        yield ApproachPath(path.joints[:count], path.rise[:count])
        lower = float(path.rise[count - 1]) - OUT_STEP
        count = int(np.searchsorted(path.rise, lower)) or 1


def straight(attempts: Attempts, order: Order, joints: np.ndarray) -> Course:
    """A course along straight lines of the joints, which was looked at before.

    Raises:
        Failure: where a place is out of reach.
    """
    arm, scene, given = attempts.job.arm, order.scene, order.move
    why: Failure | None = None
    for move in (given, *(turned(scene, given, turn) for turn in turns(arm, given))):
        grasp = move.grasp
        over = tool_path(scene.position[move.cell], grasp, order.height, grasp.straight)
        pick = approach_path(arm, over, PRESS)
        over = tool_path(move.target, move.place, order.height, upwards=True)
        place = approach_path(arm, over, order.below)
        if isinstance(pick, str) or isinstance(place, str):
            stage, detail = ("pick", pick) if isinstance(pick, str) else ("place", str(place))
            why = why or Failure(Outcome.UNREACHABLE, stage, str(detail))
            continue
        leave = leaving(arm, move.target, move.place, order.height, place)
        if isinstance(leave, str):
            why = why or Failure(Outcome.UNREACHABLE, "retreat", leave)
            continue
        plan = Approaches(pick, place, leave, move, order.height)
        there = np.array([joints, pick.joints[-1]])
        across = np.array([pick.joints[-1], place.joints[-1]])
        return Course(plan, there, across, np.array([leave.joints[-1], arm.home]))
    assert why is not None
    raise why


def motion_of(run: Execution, widest: float) -> StepMotion | None:
    """What the drives were told during an attempt, for its record."""
    parts = [(stage, played) for stage, played in run.log if len(played.time)]
    if not parts:
        return None
    joints, velocity, width, command = (
        np.concatenate([played[column] for _, played in parts]) for column in (1, 2, 3, 4)
    )
    stages: list[Stage] = []
    grip = release = None
    count = 0
    for number, (stage, played) in enumerate(run.log):
        if not len(played.time):
            continue
        begin, count = count, count + len(played.time)
        if stage == "lift" and grip is None:
            grip = begin / RATE
        gone = stage == "release" or (run.gone is not None and number >= run.gone)
        if grip is not None and release is None and gone:
            release = begin / RATE
        if stages and stages[-1].name == stage:
            stages[-1] = stages[-1]._replace(end=count / RATE)
        else:
            stages.append(Stage(stage, begin / RATE, count / RATE))
    return StepMotion(joints, velocity, width.clip(0, widest), command, stages, grip, release)
