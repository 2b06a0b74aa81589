"""Two arms carry out a plan in which one holds a block while the other one brings the next: one
after the other, in the order of the plan.

Only one of them moves at a time. An arm whose block is to be held stays when it has set it down,
with the tool closed on it; to the other one it is a thing that stands there, and ways lead past it.
Letting go is a step of its own: the arm plans anew how it leaves, among what stands there by then.
An arm that cannot go on, or is stopped, goes on holding.
"""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Sequence
from functools import lru_cache
from itertools import islice
from typing import Any, NamedTuple

import numpy as np

from learn2assemble.acting.building import PAUSED, Building, Prepared
from learn2assemble.acting.carry_out import simulated
from learn2assemble.acting.fitting import neighbours
from learn2assemble.acting.state import Action
from learn2assemble.assembly.contacts import Contacts, find_contacts
from learn2assemble.assembly.hands import Hand
from learn2assemble.cell.arrange import Arranged
from learn2assemble.cell.structure import LEANING, Structure
from learn2assemble.cell.workcell import LEANS, STANDS, Progress, StepOf, Workcell
from learn2assemble.cell.world import STANDING, Rows, direction_of, rows_of, supply_of
from learn2assemble.errors import InputError
from learn2assemble.geometry.hulls import Hull, hull_of
from learn2assemble.geometry.rotations import matrix_quaternion, quaternion_matrix, yaw_matrix
from learn2assemble.handling.execution import Execution
from learn2assemble.kinematics.capsules import capsules_of, placed
from learn2assemble.kinematics.cell import KinematicCell
from learn2assemble.kinematics.chain import get_chain
from learn2assemble.planning.plan import Plan, Step
from learn2assemble.plants.plant import Plant, PlantError, Stop
from learn2assemble.plants.setup import Setup
from learn2assemble.robot.arm import Arm
from learn2assemble.robot.grasps import Attitude
from learn2assemble.robot.moves import Move, Outcome
from learn2assemble.statics.states import State
from learn2assemble.team.crew import FINE, ArmCrew, Member, Reached
from learn2assemble.team.pair import Pair, gather, jobs_of, workcell_of
from learn2assemble.team.pressing import TURNS, PressingHand, contact_force
from learn2assemble.team.telling import SharedJournal, key_of_two, route_of
from learn2assemble.team.together import Cell, Together, built_by

MOST = 12
"""Ways of an arm to bring a block that are tried."""
LOOKS = 10
"""After so many turns a hand that presses looks how its block is in it, ..."""
KNOWN = 5e-5
"""... where that is known better than by this standard deviation [m]."""
MOVED = 5e-5
"""A block that the hand which holds it has moved farther is told to be elsewhere [m]."""
SIDES = 12
"""Of the polygons around an arm that holds."""
ROOM = 0.012
"""That solids around an arm are larger than it on all sides [m]: ways keep as far from them, or
from the capsules in them, as from everything, 5 mm."""


def build_by_two(
    plan: Plan,
    members: Sequence[Member],
    workcell: Workcell,
    *,
    joint: float = 1e-4,
    progress: Progress = lambda text: None,
    order: Sequence[StepOf] | None = None,
    opened: Callable[[Setup], Any] = simulated,
) -> Plan:
    """A complete plan, carried out by two arms in one simulated cell.

    Args:
        plan, members, workcell, joint, progress, order, opened: as of :func:`two_arms`.

    Raises:
        InputError: as :func:`two_arms`.
    """
    started = time.perf_counter()
    both = two_arms(
        plan, members, workcell, joint=joint, progress=progress, order=order, opened=opened
    )
    return built_by(both, plan, progress, started)[0]


def two_arms(
    plan: Plan,
    members: Sequence[Member],
    workcell: Workcell,
    *,
    joint: float = 1e-4,
    progress: Progress = lambda text: None,
    order: Sequence[StepOf] | None = None,
    opened: Callable[[Setup], Any] = simulated,
    through: Callable[[int, Plant], Plant] | None = None,
) -> Together[Any]:
    """Two arms that are about to carry a plan out: at the same time, or, where somebody holds a
    block or is in the cell (:attr:`~.planning.plan.Plan.by_turns`), one after the other.

    Args:
        plan: complete.
        members: the arms, see :func:`~.members.set_up_team`.
        workcell: how they build; where its file exists, the build goes on from that. A build by
            turns keeps none: what was in a hand would have been taken out of it.
        joint: width of a vertical joint [m].
        order: of bricks that clutch, of :func:`~.pair.bricks_by_team`.
        opened, through: see :class:`~.together.Together`.

    Raises:
        InputError: as :func:`~.pair.gather`, and where a build by turns has a file to go on from.
    """
    if not plan.by_turns:
        crew, journal = gather(plan, members, workcell, joint, order, progress), None
        progress("starting the cell")
        if workcell.log is not None:
            journal = SharedJournal(workcell.log, key_of_two(plan, crew, workcell))
        return Together(crew, opened, journal, through)
    if workcell.log is not None and workcell.log.exists():
        got = str(workcell.log)
        raise InputError(
            "log", got, "no build to go on from: steps hold a block, or are done by hand"
        )
    crew, ways = gather_in_turn(plan, members, workcell, joint), ways_of(plan, members)
    progress("starting the cell")
    return InTurn(crew, opened, plan.steps, ways, through)


class Brought(NamedTuple):
    """How a step of the plan is done by an arm."""

    ways: tuple[Reached, ...]
    """With the grasp that the proof counts on, where the block is held afterwards."""
    force: np.ndarray | None = None
    """float64[3]: of all contacts on the block, while it is held, when the other arm has let go
    [N]."""


def ways_of(plan: Plan, members: Sequence[Member]) -> dict[int, Brought]:
    """By number of a step that places a block, how its arm brings that, as it was planned.

    Args:
        plan: complete, by these arms.
        members: the arms.
    """
    assert plan.assembly is not None
    blocks, made = plan.assembly.blocks, plan.assembly.steps
    contacts = find_contacts(plan.assembly)
    crew, fixed = ArmCrew(members, blocks), np.array([block.support for block in blocks])
    state, found = State(fixed, np.zeros(len(blocks), bool)), dict[int, Brought]()
    for n, step in enumerate(plan.steps):
        after = plan.steps[n + 1] if n + 1 < len(plan.steps) else None
        if step.action == "place":
            hand: Hand | None = None
            if after is not None and (after.action, after.block) == ("hold", step.block):
                hand = made[n + 1].hand
            if step.arm is not None:
                some = crew.reached(step.block, state, step.arm, hand)
                found[n] = Brought(tuple(islice(some, MOST)))
                if hand is not None:
                    force = _force_when_held(plan, contacts, n, state, hand)
                    found[n] = found[n]._replace(force=force)
            state = state.change(place=[step.block])
        elif step.action == "remove":
            state = state.change(remove=[step.block])
        elif step.action == "hold":
            hand = made[n].hand
            assert hand is not None
            state = state.change(hold=[step.block], hand=hand)
        else:
            state = state.change(release=[step.block])
    return found


def _force_when_held(
    plan: Plan, contacts: Contacts, number: int, state: State, hand: Hand
) -> np.ndarray | None:
    """float64[3]: the sum of what all contacts do to a block [N] that is held from now on, when
    whoever holds another one has let go of that.

    Args:
        contacts: of all blocks of the plan.
        number: of the step by which the block comes.
        state: before that.
        hand: by which it is held.
    """
    assert plan.assembly is not None
    block = plan.steps[number].block
    then = state.change(place=[block]).change(hold=[block], hand=hand)
    following = plan.steps[number + 2 : number + 3]
    if following and following[0].action == "release":
        then = then.change(release=[following[0].block])
    return contact_force(plan.assembly, contacts, then, block)


def gather_in_turn(
    plan: Plan, members: Sequence[Member], workcell: Workcell, joint: float = 1e-4
) -> Pair:
    """Two arms with magazines of their own and all steps of a plan, whoever does them.

    Args:
        plan: complete, of dry blocks; by these arms.
        members: the arms, see :func:`~.members.set_up_team`.
        workcell: how they build.
        joint: width of a vertical joint [m].
    """
    jobs = jobs_of(plan, members, workcell, joint, holding=True)
    structure = Structure(jobs[0])
    hands = frozenset(
        step
        for step, told in zip(
            jobs[0].steps, (s for s in plan.steps if s.action in ("place", "remove")), strict=True
        )
        if told.by_hand
    )
    order = Arranged(jobs[0].steps, {}, hands)
    first, second = (Prepared(job, structure, order, KinematicCell(job.arm)) for job in jobs)
    one, other = (workcell_of(workcell, job) for job in jobs)
    return Pair((first, second), (one, other), (members[0].name, members[1].name))


class InTurnBuilding(Building):
    """What one of the arms does and knows."""

    tries: int = MOST
    ways: Brought = Brought(())
    """Of the block that it is about to bring."""

    def _way(self, action: Action, skip: int) -> tuple[Move | None, str, Rows]:
        """One of the ways that were planned, the hand turned as the block is that waits."""
        k = action.block
        poses = self.world.pose.copy()
        poses[k] = self.world.resting(k)
        rows = rows_of(self.world, poses, k)
        if skip >= len(self.ways.ways):
            return None, "none of the planned ways is free", rows
        way = self.ways.ways[skip]
        self.attempts.near = way.joints
        mine = (rows.owner == k) & (rows.part == way.part)
        off = action.goal[:3] - self.world.drawn(k)[:3]
        grasp = way.move.grasp
        if action.source is not None:
            waits = quaternion_matrix(self.world.presented(k, action.source)[3:])
            grasp = about_vertical(grasp, quaternion_matrix(poses[k, 3:]) @ waits.T)
        cell, target = int(np.flatnonzero(mine)[0]), way.move.target + off
        move = way.move._replace(cell=cell, target=target, grasp=grasp)
        return move, "", rows


def about_vertical(grasp: Attitude, turn: np.ndarray) -> Attitude:
    """A grasp of a block that has been turned by float64[3, 3] about the vertical, as it was of the
    block before."""
    angle = math.atan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1])
    into = None if grasp.into is None else direction_of(yaw_matrix(angle) @ np.array(grasp.into))
    return grasp._replace(yaw=grasp.yaw + angle, into=into)


class InTurn(Together[Cell]):
    """A build by two arms, one after the other.

    Args:
        crew: of :func:`gather_in_turn`.
        opened, through: as of :class:`~.together.Together`.
        steps: of the plan.
        ways: of :func:`ways_of`.
    """

    steps: Sequence[Step]
    ways: dict[int, Brought]
    building_of: type[Building] = InTurnBuilding

    def __init__(
        self,
        crew: Pair,
        opened: Callable[[Setup], Cell],
        steps: Sequence[Step],
        ways: dict[int, Brought],
        through: Callable[[int, Plant], Plant] | None = None,
    ) -> None:
        super().__init__(crew, opened, None, through)
        self.steps, self.ways = steps, ways
        self.now: int = 0
        """Number of the step whose turn it is."""
        self.over: str | None = None
        """Why it cannot go on."""
        self.holds: list[int | None] = [None, None]
        """The block that each arm holds in its place."""
        for who, building in enumerate(self.buildings):
            building.goes_home = True
            building.attempts.announce = self._beginner(who)
            building.attempts.stays = self._holder(who)

    def _work(self, who: int, progress: Progress) -> None:
        try:
            super()._work(who, progress)
        finally:
            if self.over is None and self.now < len(self.steps):
                # Whatever it was: the other arm is not to wait for this one.
                self.over = f"{self.worked[who].name} has stopped"

    def _attempts(self, who: int, progress: Progress) -> str | None:
        building = self.buildings[who]
        building.look()
        while self.now < len(self.steps) and self.over is None:
            step = self.steps[self.now]
            if step.action in ("hold", "release") and step.block not in self.holds:
                self.over = f"step {self.now + 1}: nobody holds the block any more"
            elif self._whose(step) != who:
                self._wait(who)
            else:
                self.over = self._do(who, step, progress)
        return self.over

    def _whose(self, step: Step) -> int | None:
        """The arm that does a step, or sees to it that it is done by hand; None: one that holds a
        block lets go of it."""
        if step.action in ("hold", "release"):
            return None
        names = [one.name for one in self.worked]
        if step.arm in names:
            return names.index(step.arm)
        return 0 if self.holds[0] is None else 1

    def _do(self, who: int, step: Step, progress: Progress) -> str | None:
        """A step; why it was not done."""
        building, number = self.buildings[who], self.now
        known, k = building.known, step.block
        known.elsewhere = set()
        what = "hand" if step.by_hand else step.action
        source = None
        for _ in range(MOST):
            if what == "place":
                places = supply_of(building.world, k)
                if not places:
                    return f"no {building.world.pieces[k].name} is left in the supply"
                source = places[0]
                assert isinstance(building, InTurnBuilding)
                building.ways = self.ways[number]
            building.world.arm = self._other_stands(who)
            self._act(who, Action(k, known.fitted(k), what, source), progress)
            if self.paused:
                return PAUSED
            self.holds[who] = None
            done = building.world.state[k] == STANDING
            if done and step.action == "place" and self._slipped(who, k):
                break
            if done != (step.action == "remove"):
                # An attempt in which it was held has gone on to where that is let go.
                self.now += 1
                return None
            if self.now > number:
                break
        last = known.done[-1].detail if known.done else ""
        why = known.refused.get(k) or last
        return f"step {self.now + 1}: {building.world.pieces[k].id}: {why}"

    def _slipped(self, who: int, k: int) -> bool:
        """Whether an attempt has failed and left its block near its place, but not in it."""
        known, world = self.buildings[who].known, self.buildings[who].world
        if not known.done or known.done[-1].outcome == Outcome.REACHED.label:
            return False
        off = float(np.linalg.norm(world.pose[k, :3] - world.target(k)[:3]))
        turned = world.pieces[k].turned_by(world.pose[k, 3:], world.target(k)[3:])
        return off > STANDS or turned > LEANS

    # ------------------------------------------------------------ the other arm

    def _other_stands(self, who: int) -> tuple[tuple[np.ndarray, np.ndarray, Hull], ...]:
        """Solids around the other arm where it stands."""
        other = self.buildings[1 - who]
        return solids_of(other.job.arm, other.plant.sense().joints)

    def _beginner(self, who: int) -> Callable[[Execution, str], bool]:
        def begin(run: Execution, block: str) -> bool:
            self.moves[who] = self.buildings[who].world.names.index(block)
            route = route_of(run, block, widest=FINE)
            # What has to be free of it is looked at motion by motion: nobody else moves.
            self.traffic.begins(who, route._replace(legs=()))
            return True

        return begin

    # ------------------------------------------------------------ holding

    def _holder(self, who: int) -> Callable[[Execution], None]:
        """What an arm does when its block rests in its place."""

        def holds(run: Execution) -> None:
            building, k = self.buildings[who], self.moves[who]
            following = self.steps[self.now + 1 : self.now + 2]
            if not following or (following[0].action, following[0].block) != ("hold", k):
                return
            world, sight = building.world, building.sight
            run.rig.senses.look()
            world.state[k], world.pose[k] = STANDING, sight.held_pose(building.plant.sense().joints)
            self.holds[who] = k
            self.traffic.holds(who, run.joints)
            self._tell(who, {k})
            assert isinstance(building, InTurnBuilding)
            lies = sight.in_hand(), world.drawn(k), self._against(who, k)
            block = world.pieces[k]
            hold = PressingHand(run, building.job.arm, *lies, building.ways.force, block.mass)
            turns, held = itertools.count(1), sight.held
            # Of a block that is known less well, its force tells more than where it is seen; and
            # on a level joint it stays where it is.
            known = held is not None and held.estimate.spread < KNOWN
            known = known and abs(float(hold.way[2])) < 1 - LEANING

            def press(keeps: bool = True) -> None:
                if known and next(turns) % LOOKS == 0:
                    # What is pressed with slips, and tilts about the lip.
                    run.rig.senses.look()
                    hold.in_hand = sight.in_hand()
                hold.press(keeps and known)

            self._meanwhile(lambda: press(False))
            taken = self.holds[1 - who] is not None
            self.now += 2
            while (self.steps[self.now].action, self.steps[self.now].block) != ("release", k):
                if self.over is not None:
                    sight.let_go()  # It stands in its place, whoever takes it over.
                    raise PlantError(Stop.REFUSED, f"{self.over}; it holds {block.id}")
                if taken and self.holds[1 - who] is None:
                    self._meanwhile(press)
                    taken = False
                self.plant.loosen()
                # The other hand lets go of what leans on this one, or brings what it is to bear.
                (press if taken else hold.stay)()
                pose = sight.held_pose(building.plant.sense().joints)
                if np.abs(pose[:3] - world.pose[k, :3]).max() > MOVED:
                    # The next block is put where this one is by then.
                    world.pose[k] = pose
                    self._tell(who, {k})
            self._meanwhile(hold.ease)
            world.arm = self._other_stands(who)
            building.attempts.leave_anew(run, rows_of(world, world.pose, k))

        return holds

    def _meanwhile(self, held: Callable[[], None]) -> None:
        """Some turns of a hand that holds, the other arm as it is."""
        for _ in range(TURNS):
            self.plant.loosen()
            held()

    def _against(self, who: int, k: int) -> np.ndarray:
        """float64[3]: unit vector towards what stands beside a block, as drawn; zeros without."""
        world, way = self.buildings[who].world, np.zeros(3)
        for near, *others in neighbours(world.job.pieces, k):
            if not others and world.state[near.other] == STANDING:
                way += near.way
        return way / max(float(np.linalg.norm(way)), 1e-9)


def solids_of(arm: Arm, joints: np.ndarray) -> tuple[tuple[np.ndarray, np.ndarray, Hull], ...]:
    """Solids around the capsules of an arm that stands at joints float64[n] [rad], and what others
    keep from these: poses float64[7], half extents of the boxes around them float64[3] [m], and
    their hulls."""
    capsules = capsules_of(arm)
    found = list[tuple[np.ndarray, np.ndarray, Hull]]()
    lines = placed(get_chain(arm), capsules, joints[None].copy())[0]
    for (a, b), radius in zip(lines, capsules.radius.tolist(), strict=True):
        axis, length = b - a, float(np.linalg.norm(b - a))
        z = axis / length if length > 1e-9 else np.array([0.0, 0.0, 1.0])
        x = np.cross(z, [0.0, 0.0, 1.0] if abs(z[2]) < 0.9 else [1.0, 0.0, 0.0])
        x /= np.linalg.norm(x)
        turn = np.stack([x, np.cross(z, x), z], 1)
        hull = _rounded(round(length, 9), radius + ROOM)
        pose = np.array([*(a + b) / 2, *matrix_quaternion(turn)])
        found.append((pose, hull.points.max(0), hull))
    return tuple(found)


@lru_cache(maxsize=256)
def _rounded(length: float, radius: float) -> Hull:
    """A polyhedron around a capsule along z about the origin, nowhere more than 7 % of the radius
    outside it: what comes past a hand has a centimetre or two, which a box would take.

    Args:
        length: of its line [m].
    """
    step = 2 * math.pi / SIDES
    # Polygons around circles, along the axis and about it.
    wide = radius / math.cos(step / 2)
    rings = [(wide * math.cos(k), wide * math.sin(k)) for k in np.arange(0.5, SIDES / 4) * step]
    around = np.arange(SIDES) * step
    points = [
        (out * math.cos(angle) / math.cos(step / 2), out * math.sin(angle) / math.cos(step / 2), z)
        for out, up in rings
        for z in (-length / 2 - up, length / 2 + up)
        for angle in around.tolist()
    ]
    return hull_of(np.array(points))
