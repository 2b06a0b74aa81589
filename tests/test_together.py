"""Two arms that share a site: who may move, builds of both, and what is told of these."""

from __future__ import annotations

import contextlib
import io
import json
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import shapely

import learn2assemble as l2a
from cell_shapes import SHAPES, wall
from learn2assemble.acting.carry_out import carry_out, prepare, setup_of
from learn2assemble.assembly.blocks import Assembly
from learn2assemble.assembly.boxes import box_block
from learn2assemble.assembly.bricks.model import Brick, BrickModel, assembly_of
from learn2assemble.assembly.kit import DEFAULT_KIT, load_kit
from learn2assemble.cell.arrange import BESIDE, HAND, lower_beside
from learn2assemble.cell.site import Obstacle, Site
from learn2assemble.cell.site_arms import SiteArm
from learn2assemble.cell.workcell import Workcell, job_of
from learn2assemble.cell.world import WorkcellBlocks
from learn2assemble.cli import main
from learn2assemble.design.cells import CellDesign
from learn2assemble.errors import InputError, Learn2AssembleError
from learn2assemble.export.ros2 import names_of_two
from learn2assemble.handling.execution import Coordinator, Execution, Rig
from learn2assemble.kinematics.capsules import apart, capsules_of, in_hand, solid_capsules
from learn2assemble.kinematics.capsules import placed as lines_at
from learn2assemble.kinematics.chain import get_chain
from learn2assemble.kinematics.sweeps import Sweep, clear, still, sweep
from learn2assemble.motion.attempts import merged
from learn2assemble.motion.driver import arm_of
from learn2assemble.motion.files import read_record
from learn2assemble.motion.program import Program, Wait, make_program, motions
from learn2assemble.motion.record import find_fault
from learn2assemble.motion.waits import APART as KEPT
from learn2assemble.motion.waits import _follows, _Span, held_by, on_one_clock, with_waits
from learn2assemble.planning.given import plan_assembly
from learn2assemble.planning.plan import Plan
from learn2assemble.planning.tiling.construct import plan_cells
from learn2assemble.plants.plant import (
    Commands,
    Guard,
    Guards,
    Motion,
    Report,
    Stop,
    ToolCommand,
    WrappedPlant,
    standing,
)
from learn2assemble.plants.safety import Box, Safety
from learn2assemble.robot.arm import Arm, get_arm
from learn2assemble.robot.bodies import Part
from learn2assemble.robot.moves import Failure, Outcome
from learn2assemble.simulation.plant import DynamicPlant
from learn2assemble.team.members import set_up_team
from learn2assemble.team.pair import Pair, gather
from learn2assemble.team.telling import SharedJournal, tell
from learn2assemble.team.together import Together
from learn2assemble.team.traffic import APART, HALTS, PLANNED, ArmInTraffic, Leg, Route, Traffic
from learn2assemble.viewer.page import write_plan_page
from learn2assemble.viewer.playback import Playback

LEFT = get_arm("ur5e", "suction", (-0.42, 0.0, 0.0, 0.0))
RIGHT = get_arm("panda", "suction", (0.42, 0.0, 0.0, np.pi))
ARMS = LEFT, RIGHT
SITE_ARMS = SiteArm("ur5e", "ur5e"), SiteArm("panda", "panda")
BRICK = (Part((0.0, 0.0, 0.0), (0.03, 0.02, 0.02)),)
AWAY = still(solid_capsules(BRICK, np.array([0.0, 3.0, 0.0]), np.eye(3)))
KIT = load_kit("bricks")
LEGS = "approach", "cross", "home"


def motion(stage: str, start: np.ndarray, end: np.ndarray) -> Motion:
    joints = start + np.linspace(0, 1, 9)[:, None] * (end - start)
    return Motion(stage, np.linspace(0, 1, 9), joints, np.zeros_like(joints))


def route(arm: Arm, corners: list[np.ndarray]) -> Route:
    """From home through two corners and back, a leg each."""
    legs = tuple(
        Leg(stage, sweep(arm, capsules_of(arm), np.array(way)))
        for stage, way in zip(LEGS, pairwise([arm.home, *corners, arm.home]), strict=True)
    )
    held = in_hand(arm, solid_capsules(BRICK, np.array([0.0, 0.0, 0.02]), np.eye(3)))
    return Route("a", held, legs, AWAY)


@pytest.mark.parametrize(("halts", "flows"), [(False, False), (True, False), (True, True)])
@pytest.mark.parametrize("seed", [0, 1, 3, 4, 6, 7, 8, 9])  # both are on their ways at once
def test_whatever_happens_when_both_come_to_their_ends(seed: int, halts: bool, flows: bool) -> None:
    """Random courses that cross each other, legs that take any time, halts on them, or arms that go
    on where they may: nobody waits for ever, and what two arms are on never comes near."""
    rng, traffic = np.random.default_rng(seed), Traffic(ARMS)
    jobs: list[list[list[np.ndarray]]] = []
    for arm in ARMS:
        lower, upper = arm.limits()
        jobs.append(
            [
                [np.clip(arm.home + rng.normal(0, 0.45, len(arm.home)), lower, upper) for _ in "12"]
                for _ in range(4)
            ]
        )
    moving: list[tuple[float, np.ndarray] | None] = [None, None]
    left: list[list[Motion]] = [[], []]
    waited, together, skipped, done, halted, went_on = 0, 0, 0, 0, 0, 0
    for _ in range(2000):
        progress = False
        for who in rng.permutation(2).tolist():
            arm, lane = ARMS[who], traffic.lanes[who]
            now = moving[who]
            if now is not None:
                # How far on its way it is, and that way.
                share, joints = min(now[0] + rng.uniform(0, 0.5), 1.0), now[1]
                moving[who] = share, joints
                here = joints[0] + share * (joints[-1] - joints[0])
                traffic.passes(who, here)
                assert not clear(lane.here, sweep(arm, capsules_of(arm), here[None]), 0.0)
                end = left[who][0].joints[-1] if left[who] else here
                if flows and lane.stage == "cross" and left[who][0].stage == "cross":
                    there = joints[-1] + rng.uniform(0.1, 0.9) * (end - joints[-1])
                    there = end if rng.random() < 0.5 else there
                    if traffic.goes_on(who, here, there, end):
                        assert clear(traffic.lanes[0].here, traffic.lanes[1].here, APART)
                        assert there is not end or lane.behind is None
                        moving[who], share = (0.0, np.stack([here, there])), 0.0
                        left[who][:1] = [] if there is end else [motion("cross", there, end)]
                        went_on += 1
                if share == 1.0:
                    traffic.stands(who, joints[-1], False)
                    moving[who] = None
                    if not left[who]:
                        traffic.over(who)
                        done += 1
                progress = True
            elif left[who]:
                comes_after, one = lane.behind, left[who][0]
                start, end = one.joints[0], one.joints[-1]
                if one.stage == "cross" and lane.halt is None and halts:
                    share = traffic.halt(who, start, end)
                    if 0 < share < 1:
                        lane.halt = start + share * (end - start), end
                        parts = pairwise([start, lane.halt[0], end])
                        left[who][:1] = [motion("cross", *part) for part in parts]
                        halted += 1
                nearer = lane.halt is not None and np.array_equal(
                    left[who][0].joints[-1], lane.halt[0]
                )
                if traffic.enter(who, left[who][0]):
                    one = left[who].pop(0)
                    moving[who], progress = (0.0, one.joints), True
                    assert clear(traffic.lanes[0].here, traffic.lanes[1].here, APART)
                    together += moving[1 - who] is not None
                    assert one.stage != "cross" or nearer or comes_after is None
                else:
                    assert not nearer
                    waited += 1
                    assert not traffic.stuck(who)
            elif jobs[who]:
                corners, first = jobs[who][0], traffic.other(who).route
                mine = route(arm, corners)
                if jobs[1 - who] and rng.random() < 0.7:
                    # It places what the next way of the other one leads through.
                    there, own = jobs[1 - who][0][1][None], ARMS[1 - who]
                    mine = mine._replace(goal=sweep(own, capsules_of(own), there))
                fits = traffic.announce(who, mine)
                if not fits and first is not None and traffic.announce(who, mine, behind=True):
                    assert lane.behind is first
                    fits = True
                if fits:
                    stops = [arm.home, *jobs[who].pop(0), arm.home]
                    left[who] = [
                        motion(stage, *way)
                        for stage, way in zip(LEGS, pairwise(stops), strict=True)
                    ]
                    progress = True
                elif first is None:
                    # Not even alone: the other arm stands there.
                    jobs[who].pop(0)
                    skipped += 1
                    progress = True
        if not any((*left, *jobs, *[m for m in moving if m])):
            break
        assert progress, "both wait"
    assert not any(left)
    assert done + skipped == 8
    assert done >= 4
    assert together + waited > 0
    assert halts or not halted
    assert bool(went_on) == (flows and halted > 0)


def test_an_arm_that_comes_after_the_other_one_fetches_meanwhile_and_then_crosses() -> None:
    """Of two routes through the same place the second one begins, but does not cross before the
    first one is over; where nothing was placed then, it ends there, and takes its block back."""
    traffic, plant = Traffic(ARMS), Still(RIGHT)
    plants = Still(LEFT), plant
    one, two = (ArmInTraffic(p, traffic, k, plants[1 - k]) for k, p in enumerate(plants))  # pyright: ignore[reportArgumentType]
    corners = [[arm.home + step * np.eye(len(arm.home))[0] for step in (0.1, 0.2)] for arm in ARMS]
    mine, other = (route(arm, where) for arm, where in zip(ARMS, corners, strict=True))
    goal = sweep(LEFT, capsules_of(LEFT), corners[0][0][None])
    mine, other = mine._replace(goal=goal), other._replace(goal=goal)
    assert traffic.announce(0, mine)
    assert not traffic.announce(1, other)
    assert traffic.announce(1, other, behind=True)
    way = motion("approach", RIGHT.home, corners[1][0])
    assert two.execute(way).stop == Stop.END
    across = motion("cross", *corners[1])
    for placed in (True, False):
        traffic.lanes[1].behind = mine
        traffic.lanes[0].route = mine
        assert not traffic.enter(1, across)
        assert not traffic.stuck(1)
        traffic.over(0, placed)
        if placed:
            assert traffic.enter(1, across)
            traffic.stands(1, corners[1][0], True)
    told = len(plant.told)
    with pytest.raises(Failure, match="not placed"):
        two.execute(across)
    assert len(plant.told) == told
    # Whether it could have gone on to its place does not matter on its way back.
    assert not traffic.lanes[1].on_route
    assert traffic.lanes[1].ahead == ()
    # It is told once, and goes where it likes then.
    assert two.execute(across).stop == Stop.END
    traffic.over(1, placed=False)
    assert one.execute(motion("approach", LEFT.home, corners[0][0])).stop == Stop.END


def test_an_arm_that_waits_comes_nearer() -> None:
    """It halts on its way across where the other arm can still do all it has announced, also behind
    that one's block, and goes on when this is placed; the way is the same."""
    traffic, plant = Traffic(ARMS), Still(RIGHT)
    one, two = (
        ArmInTraffic(p, traffic, k, q)  # pyright: ignore[reportArgumentType]
        for k, (p, q) in enumerate([(Still(LEFT), plant), (plant, Still(LEFT))])
    )
    corners = [[arm.home + step * np.eye(len(arm.home))[0] for step in (0.1, 0.4)] for arm in ARMS]
    mine, other = (route(arm, where) for arm, where in zip(ARMS, corners, strict=True))
    assert traffic.announce(0, mine)
    assert traffic.announce(1, other, behind=True)
    lane, (start, end) = traffic.lanes[1], corners[1]
    two.execute(motion("approach", RIGHT.home, start))
    lane.holding = True
    there = two.halt(start, end)
    assert there is not None
    share = float((there - start)[0] / (end - start)[0])
    assert share == pytest.approx(HALTS[0])
    two.execute(motion("cross", start, there))
    assert [leg.stage for leg in lane.ahead] == ["cross", "home"]
    assert two.halt(there, end) is None  # Once on a part of the way.
    assert not traffic.enter(1, motion("cross", there, end))
    for stage, way in zip(LEGS, pairwise([LEFT.home, *corners[0], LEFT.home]), strict=True):
        one.execute(motion(stage, *way))
    traffic.over(0)
    two.execute(motion("cross", there, end))
    assert [leg.stage for leg in lane.ahead] == ["home"]


def one_behind_the_other() -> tuple[Traffic, list[ArmInTraffic], list[list[np.ndarray]]]:
    """Two arms told piece by piece, of which the second one follows, and the corners of both."""
    traffic, plant = Traffic(ARMS), Still(RIGHT)
    arms = [
        ArmInTraffic(p, traffic, k, q, True)  # pyright: ignore[reportArgumentType]
        for k, (p, q) in enumerate([(Still(LEFT), plant), (plant, Still(LEFT))])
    ]
    corners = [[arm.home + step * np.eye(len(arm.home))[0] for step in (0.1, 0.4)] for arm in ARMS]
    mine, other = (route(arm, where) for arm, where in zip(ARMS, corners, strict=True))
    assert traffic.announce(0, mine)
    assert traffic.announce(1, other, behind=True)
    return traffic, arms, corners


def test_an_arm_goes_on_where_it_may_before_it_brakes() -> None:
    """What it sweeps is its own then; where it has come to rest, it asks as before."""
    traffic, (one, two), corners = one_behind_the_other()
    lane, (start, end) = traffic.lanes[1], corners[1]
    two.execute(motion("approach", RIGHT.home, start))
    lane.holding = True
    there = two.halt(start, end)
    assert there is not None
    np.testing.assert_allclose(there, start + HALTS[0] * (end - start))
    # It is on its way to there, and goes on, but not to the end before that block is placed.
    now = start + 0.5 * (end - start)
    two.execute(motion("cross", start, now))
    assert lane.moving
    there = two.farther(now, there, end)
    assert there is not None
    np.testing.assert_allclose(there, start + 0.99 * (end - start))
    assert not clear(lane.here, lane.swept(there[None]), 0.0)
    two.execute(motion("cross", now, there))
    assert not lane.moving
    assert [leg.stage for leg in lane.ahead] == ["cross", "home"]
    for stage, way in zip(LEGS, pairwise([LEFT.home, *corners[0], LEFT.home]), strict=True):
        one.execute(motion(stage, *way))
    traffic.over(0)
    assert two.farther(there, there, end) is end
    two.execute(motion("cross", there, end))
    assert not lane.moving
    assert [leg.stage for leg in lane.ahead] == ["home"]
    # Where what comes before it was not placed it goes no farther.
    lane.in_vain = True
    assert two.farther(end, end, end) is None


def test_an_arm_that_may_go_on_all_the_time_comes_to_rest_before_what_it_waits_for() -> None:
    """Nothing of what it could still go on by takes any time."""
    traffic, (one, two), corners = one_behind_the_other()
    one.execute(motion("approach", LEFT.home, corners[0][0]))
    lane, (start, end) = traffic.lanes[1], corners[1]
    two.execute(motion("approach", RIGHT.home, start))
    lane.holding = True
    there = two.halt(start, end)
    for _ in range(20):
        if there is None:
            break
        there = two.farther(start, there, end)
    assert there is None
    assert lane.behind is traffic.lanes[0].route


class May(Coordinator):
    """Lets an arm go on by these shares of its way, one after the other."""

    piecewise = True

    def __init__(self, *shares: float) -> None:
        self.shares, self.start = list(shares), np.zeros(0)

    def halt(self, start: np.ndarray, end: np.ndarray) -> np.ndarray | None:
        if not self.shares:
            return None
        self.start = start
        return start + self.shares.pop(0) * (end - start)

    def farther(self, now: np.ndarray, there: np.ndarray, end: np.ndarray) -> np.ndarray | None:
        if not self.shares:
            return None
        share = self.shares.pop(0)
        return end if share == 1.0 else self.start + share * (end - self.start)


def test_a_way_in_pieces_is_the_same_as_one_without_a_stop() -> None:
    """And where the arm may not go on it brakes, and rests where it may."""
    arm = get_arm("panda", "gripper")
    way = np.stack([arm.home, arm.home + 0.8 * np.eye(len(arm.home))[0]])
    told = list[list[Motion]]()
    for may in (Coordinator(), May(0.5, 0.7, 1.0), May(0.5, 0.6)):
        plant = Still(arm)
        rig = Rig(plant, None, arm, None, arm.bounds, arm.bounds, coordinator=may)  # pyright: ignore[reportArgumentType]
        run = Execution(rig, None, None, arm.home)  # pyright: ignore[reportArgumentType]
        run.carry(way)
        assert np.abs(run.joints - way[1]).max() < 1e-9
        told.append(plant.told)
    whole, pieces, rests = told
    assert (len(whole), len(pieces)) == (1, 3)
    for values in ("joints", "velocity"):
        joined = [getattr(pieces[0], values), *(getattr(one, values)[1:] for one in pieces[1:])]
        np.testing.assert_allclose(np.vstack(joined), getattr(whole[0], values))
    speeds = [np.abs(one.velocity[-1]).max() for one in rests]
    assert [speed < 1e-6 for speed in speeds] == [False, False, True, True]
    np.testing.assert_allclose(rests[2].joints[-1], way[0] + 0.6 * (way[1] - way[0]))


def test_an_arm_with_nothing_in_its_way_does_not_halt() -> None:
    traffic, plant = Traffic(ARMS), Still(RIGHT)
    two = ArmInTraffic(plant, traffic, 1, Still(LEFT))  # pyright: ignore[reportArgumentType]
    start, end = (RIGHT.home + step * np.eye(len(RIGHT.home))[0] for step in (0.1, 0.4))
    assert traffic.announce(1, route(RIGHT, [start, end]))
    two.execute(motion("approach", RIGHT.home, start))
    traffic.lanes[1].holding = True
    assert two.halt(start, end) is None


def test_ways_that_are_found_again_are_announced_again() -> None:
    traffic = Traffic(ARMS)
    first, second, beside = (LEFT.home + k * 0.1 * np.eye(len(LEFT.home))[0] for k in (1, 2, 3))
    assert traffic.announce(0, route(LEFT, [first, second]))
    traffic.rerouted(0, "home", np.array([second, beside, LEFT.home]))
    legs = traffic.lanes[0].ahead
    assert [leg.stage for leg in legs] == ["approach", "cross", "home", "home"]
    turned = sweep(LEFT, capsules_of(LEFT), np.array([second, beside]))
    np.testing.assert_allclose(legs[2].swept.lines, turned.lines)
    traffic.rerouted(0, "place", np.array([second, beside]))
    assert traffic.lanes[0].ahead == legs


@pytest.mark.parametrize("there", [True, False])
def test_whoever_waits_goes_on_when_the_block_is_let_go_in_its_place(there: bool) -> None:
    """And not where the arm lets go of it elsewhere: it has put it back then."""
    traffic = Traffic(ARMS)
    lower = [arm.home + 0.2 * np.eye(len(arm.home))[1] for arm in ARMS]
    mine = route(LEFT, [lower[0], lower[0]])
    held = capsules_of(LEFT).add(mine.held)
    way = np.array([lower[0], lower[0] + 0.1])
    down = Leg("place", sweep(LEFT, held, way))
    mine = mine._replace(legs=(*mine.legs[:2], down, mine.legs[2]), there=down.swept.end)
    other = route(RIGHT, [lower[1], lower[1]])
    assert traffic.announce(0, mine)
    assert traffic.announce(1, other, behind=True)
    traffic.stands(0, way[-1] if there else way[-1] + 0.02, True)
    traffic.lets_go(0)
    traffic.stands(0, way[-1], False)
    waits = traffic.lanes[1]
    assert (waits.behind is None) is there
    # Its block comes after the other one all the same: nothing is in the way of that.
    assert waits.after is mine
    traffic.over(0, placed=False)
    assert waits.in_vain is not there


def test_of_two_that_wait_for_each_other_the_one_that_comes_after_gives_way() -> None:
    """What comes after a block that is put back is put back, too: two attempts for nothing."""
    traffic = Traffic(ARMS)
    corners = [[arm.home + step * np.eye(len(arm.home))[0] for step in (0.1, 0.2)] for arm in ARMS]
    mine, other = (route(arm, where) for arm, where in zip(ARMS, corners, strict=True))
    assert traffic.announce(0, mine)
    assert traffic.announce(1, other, behind=True)
    for lane in traffic.lanes:
        lane.refused = traffic.changes
    assert not traffic.stuck(0)
    assert traffic.stuck(1)
    traffic.leaves_route(1)
    traffic.over(1, placed=False)
    # One that waits for nobody's block gives way as before.
    assert traffic.announce(1, other._replace(goal=AWAY))
    for lane in traffic.lanes:
        lane.refused = traffic.changes
    assert traffic.stuck(0)


def test_nothing_is_fetched_behind_a_block_that_is_put_back(crew: Pair) -> None:
    """Each arm would put back what it fetched behind the other one's block, again and again."""
    both = Together(crew, DynamicPlant)
    lane = both.traffic.lanes[1]
    lane.route = route(RIGHT, [RIGHT.home, RIGHT.home])
    both.moves[1] = crew.found[1].order.steps[0].block
    asked: list[int] = []
    both.buildings[0].known.choose = lambda: asked.append(0)
    for lane.in_vain, lane.on_route in ((True, True), (False, False)):
        assert not both._fetch(0, print)
        assert not asked
    lane.in_vain, lane.on_route = False, True
    assert not both._fetch(0, print)
    assert asked


def test_nobody_waits_for_an_arm_whose_work_has_ended_with_an_error(
    crew: Pair, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever it is: it is told when the other arm has done what it can."""
    both = Together(crew, DynamicPlant)
    mine = route(LEFT, [LEFT.home, LEFT.home])
    both.moves[0] = crew.found[0].order.steps[0].block

    def fails(who: int, progress: object) -> str | None:
        assert both.traffic.announce(who, mine)
        raise ZeroDivisionError

    monkeypatch.setattr(both, "_attempts", fails)
    with pytest.raises(ZeroDivisionError):
        both._work(0, print)
    lane, other = both.traffic.lanes
    assert lane.halted
    assert lane.route is None
    assert both.moves[0] in both.lost
    assert not both.working[0]
    other.refused = both.traffic.changes
    assert both.traffic.stuck(1)  # It does not wait any longer.


@pytest.mark.parametrize("name", ["house-small", "bridge"])
def test_each_arm_has_its_magazines_on_its_own_side(name: str) -> None:
    """And none inside what is built."""
    kit = load_kit(DEFAULT_KIT).at_pitch((0.032, 0.032, 0.032))
    plan = plan_cells(CellDesign(name, SHAPES[name], kit.pitch, None, 0.0, None, "", None), kit)
    assert plan.assembly is not None
    members = set_up_team(plan.assembly, SITE_ARMS, Site())
    hull = shapely.union_all([p.face() for p in members[0].job.pieces]).convex_hull
    for member, other in zip(members, reversed(members), strict=True):
        for source in member.job.sources:
            at = np.array([source.pose.x, source.pose.y])
            own, far = (np.linalg.norm(at - one.job.base) for one in (member, other))
            assert own < far
            assert not source.area.intersects(hull)


def test_where_there_is_no_room_else_magazines_lie_inside_what_is_built() -> None:
    """Of a ring with obstacles all round; by preference none lies there."""
    size, half, high = 0.1, 0.25, 0.04
    ring = []
    for k in range(5):
        low = -half + k * size
        for n, y in enumerate((-half - 0.04, half)):
            at = (low, y, 0.0), (low + size, y + 0.04, high)
            ring.append(l2a.box_block(f"x{n}{k}", *at))
            ring.append(l2a.box_block(f"y{n}{k}", (y, low, 0.0), (y + 0.04, low + size, high)))
    around = tuple(
        Obstacle(middle, (*wide, 0.02))
        for way in (-1, 1)
        for middle, wide in (((0.0, 0.75 * way), (2.4, 0.75)), ((0.75 * way, 0.0), (0.75, 0.74)))
    )
    inside = shapely.box(-half, -half, half, half)
    arms = [
        one._replace(base=(0.0, 0.55 * k, 0.0, -k * np.pi / 2))
        for k, one in zip((-1, 1), SITE_ARMS, strict=True)
    ]
    for obstacles, there in (((), False), (around, True)):
        members = set_up_team(l2a.Assembly(tuple(ring)), arms, Site(obstacles=obstacles))
        for source in (s for member in members for s in member.job.sources):
            assert source.area.within(inside) == there


class Still:
    """A plant that does as it is told."""

    def __init__(self, arm: Arm) -> None:
        self.joints, self.told = arm.home, list[Motion]()

    def execute(self, motion: Motion, commands: object = (), guards: object = ()) -> Report:
        self.told.append(motion)
        self.joints = motion.joints[-1]
        return Report(Stop.END, 1.0, self.joints, motion.seconds)


def test_an_arm_off_its_course_whose_way_is_never_free_says_so() -> None:
    traffic, plant = Traffic(ARMS), Still(LEFT)
    mine = ArmInTraffic(plant, traffic, 0, Still(RIGHT))  # pyright: ignore[reportArgumentType]
    lower, upper = LEFT.limits()
    rng = np.random.default_rng(0)
    while True:
        end = np.clip(LEFT.home + rng.normal(0, 1.0, 6), lower, upper)
        way = motion("cross", LEFT.home, end)
        if not clear(sweep(LEFT, capsules_of(LEFT), way.joints), traffic.lanes[1].here, APART):
            break
    with pytest.raises(Failure, match="other arm is in the way"):
        mine.execute(way, (), (Guard(),))
    assert np.abs(plant.joints - LEFT.home).max() == 0
    # To stand is always possible.
    assert mine.execute(standing("home", LEFT.home, 0.1)).stop == Stop.END


# ---------------------------------------------------------------- builds


def design(x: int, y: int, z: int) -> Plan:
    cells = wall(x, y, z)
    plan = plan_cells(CellDesign("wall", cells, KIT.pitch, None, 0.0, None, "", None), KIT)
    assert plan.complete
    return plan


def crew_for(plan: Plan, workcell: Workcell) -> Pair:
    assert plan.assembly is not None
    members = set_up_team(plan.assembly, SITE_ARMS, Site())
    return gather(plan, members, workcell, KIT.joint_gap)


@pytest.fixture(scope="module")
def crew() -> Pair:
    return crew_for(design(10, 2, 3), Workcell("ur5e"))


@pytest.mark.parametrize(("size", "count"), [((10, 2, 3), 10), ((16, 2, 5), 22)])
def test_the_other_arm_is_gone_around_not_over(size: tuple[int, int, int], count: int) -> None:
    """Ways above its base would be so high that places at the ends of a wall are out of reach."""
    for found in crew_for(design(*size), Workcell("ur5e")).found:
        assert (len(found.order.steps), found.order.stuck) == (count, {})


def test_what_comes_before_a_block_is_lower_and_near(crew: Pair) -> None:
    pieces = crew.found[0].job.pieces
    found = lower_beside(crew.found[0].job)
    for k, one in enumerate(pieces):
        for n, other in enumerate(pieces):
            (low, high), (under, over) = one.extent, other.extent
            apart = max(float(max(low[i] - over[i], under[i] - high[i])) for i in (0, 1))
            near = min(BESIDE * float(high[2] - over[2]), HAND)
            meant = float(over[2]) <= float(low[2]) + 1e-3 and apart < near
            assert (n in found.get(k, set())) == meant
    assert found
    assert any(
        n not in crew.found[0].structure.below[k] for k, lower in found.items() for n in lower
    )


# ---------------------------------------------------------------- from the outside


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """A wall of five blocks by the command, and what that says."""
    folder = tmp_path_factory.mktemp("two")
    np.save(folder / "wall.npy", wall(8, 2, 2))
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(io.StringIO()):
        code = main(
            [
                *("build", str(folder / "wall.npy"), "--arm", "ur5e", "--arm", "panda"),
                *("--no-video", "--json", "--out", str(folder / "out")),
            ]
        )
    assert code == 0
    return folder / "out", json.loads(said.getvalue().splitlines()[-1])


def test_both_arms_keep_the_rules_of_the_layout() -> None:
    low = Site(safety=Safety(box=Box((-2.0, -2.0, 0.3), (2.0, 2.0, 2.0))))
    plan = l2a.build(wall(4, 2, 1), arm=("ur5e", "panda"), layout=low)
    assert plan.status == "incomplete"
    assert "outside the layout's safety.box" in (plan.reason or "")


def test_the_command_builds_with_two_arms(built: tuple[Path, dict[str, Any]]) -> None:
    folder, said = built
    plan = Plan.load(folder)
    assert plan.complete
    assert plan.arm is None
    assert [arm.name for arm in plan.arms] == ["ur5e", "panda"]
    assert {step.arm for step in plan.steps} == {"ur5e", "panda"}
    assert (said["holds"], said["props"], said["robot_s"]) == (0, 0, plan.robot_s)
    assert [arm["name"] for arm in said["arms"]] == ["ur5e", "panda"]
    for arm, record in zip(plan.arms, plan.records, strict=True):
        assert record.arm.name == arm.arm
        assert arm.did is not None
        assert arm.did.attempts == len(record.steps) == sum(s.arm == arm.name for s in plan.steps)
        assert arm.did.error_worst is not None
        assert arm.did.error_worst < 1e-3
        assert arm.did.motion_fault is None
        assert record.spans()[-1][1] <= (plan.robot_s or 0) + 0.1
    files = {path.name for path in folder.iterdir()}
    assert {"trajectory-1.json", "trajectory-2.json", "trajectory-2.csv"} <= files
    assert "trajectory.json" not in files


class Killed(BaseException):
    """The end of a process."""


def test_a_build_that_was_killed_goes_on_and_its_records_are_sound(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever the other arm was in the middle of: its record does not jump to there, so it is a
    program of a robot."""
    append, left = SharedJournal.append, [3.0]

    def appended(*given: Any) -> None:
        if left[0] <= 0:
            raise Killed
        append(*given)
        left[0] -= 1
        if left[0] <= 0:
            raise Killed

    def build() -> int:
        out = ("--no-video", "--out", str(tmp_path / "out"))
        more = ("--resume",) if left[0] > 3 else ()
        arms = ("--arm", "panda", "--arm", "ur5e")
        return main(["build", "examples/designs/pyramid.json", *arms, *out, *more])

    monkeypatch.setattr(SharedJournal, "append", appended)
    with pytest.raises(Killed):
        build()
    left[0] = np.inf
    assert build() == 0
    for number in (1, 2):
        record = read_record(tmp_path / "out" / f"trajectory-{number}.json")
        assert find_fault(record) is None
    assert Plan.load(tmp_path / "out").complete


def test_attempts_of_both_are_one_sequence(built: tuple[Path, dict[str, Any]]) -> None:
    """In the order in which they ended, each block moved by the arm that placed it alone."""
    plan = Plan.load(built[0])
    told = merged(plan.records)
    assert [one.step.number for one in told] == [*range(1, len(plan.steps) + 1)]
    assert all(a.end <= b.end for a, b in pairwise(told))
    names = [arm.name for arm in plan.arms]
    for one in told:
        step = one.step
        assert step.plan_step is not None
        assert names[one.arm] == plan.steps[step.plan_step - 1].arm
        placed = plan.steps[step.plan_step - 1].position
        assert np.allclose(step.after[step.cells[0], :3], placed, atol=1e-5)
    for a, b in pairwise(told):
        moved = np.flatnonzero(np.abs(a.step.after - b.step.before).max(1) > 1e-5)
        assert set(moved.tolist()) <= set(b.step.cells)


def asynchronous(
    programs: Sequence[Program], arms: Sequence[Arm], seed: int, waiting: bool = True
) -> float:
    """Plays two programs, each as fast as it likes for a while, and returns how near the arms have
    come to each other with what they hold [m]."""
    rng, clock, least = np.random.default_rng(seed), [0.0, 0.0], np.inf
    speed = np.ones(2)
    for tick in range(100_000):
        if all(now >= one.seconds for now, one in zip(clock, programs, strict=True)):
            return least
        if tick % 50 == 0:
            speed = np.exp(rng.uniform(-1.6, 1.1, 2))
        before = list(clock)
        for who, program in enumerate(programs):
            ends = [program.seconds, clock[who] + 0.02 * speed[who]]
            if waiting:
                ends += [w.time for w in program.waits if w.other > before[1 - who] + 1e-9]
            clock[who] = max(clock[who], min(ends))
        if tick % 4 == 0:
            bodies = [_body(*one) for one in zip(programs, arms, clock, strict=True)]
            least = min(least, apart(*bodies[0], *bodies[1]))
    raise AssertionError(f"both wait at {clock}")


def _body(program: Program, arm: Arm, now: float) -> tuple[np.ndarray, np.ndarray]:
    """Lines and radii of an arm and what it holds."""
    capsules = capsules_of(arm)
    for k, step in enumerate(program.steps):
        if step.held is not None and step.held[0] < now < step.held[1]:
            capsules = capsules.add(held_by(program, arm, k))
    joints = np.ascontiguousarray(program.knots.at(np.array([now]))[0])
    return lines_at(get_chain(arm), capsules, joints)[0], capsules.radius


def test_programs_of_both_keep_apart_however_fast_each_is(
    built: tuple[Path, dict[str, Any]],
) -> None:
    """Robots share no clock: what is kept of the order of the build is what each waits for."""
    plan = Plan.load(built[0])
    arms = [arm_of(record.arm) for record in plan.records]
    made = [make_program(*one) for one in zip(plan.records, arms, strict=True)]
    programs = with_waits((made[0], made[1]), (arms[0], arms[1]))
    for one, other in (programs, programs[::-1]):
        assert [wait.other for wait in one.waits] == [*other.awaited]
        assert [wait.number for wait in one.waits] == [*range(1, len(one.waits) + 1)]
        assert all(a.time <= b.time and a.other < b.other for a, b in pairwise(one.waits))
        for wait in one.waits:  # Where it stands.
            assert not one.knots.at(np.array([wait.time]))[1].round(3).any()
    assert 0 < sum(len(one.waits) for one in programs) <= 2 * len(plan.steps)
    assert min(asynchronous(programs, arms, seed) for seed in range(8)) > KEPT
    assert min(asynchronous(programs, arms, seed, waiting=False) for seed in range(4)) < 0.0
    # Whichever of both is named first.
    turned = with_waits((made[1], made[0]), (arms[1], arms[0]))
    assert [(one.waits, one.awaited) for one in turned[::-1]] == [
        (one.waits, one.awaited) for one in programs
    ]


def test_programs_of_arms_that_went_on_without_a_stop_keep_apart() -> None:
    """The one that followed the other one waits before it begins."""
    bricks = tuple(Brick((0, 0, 3 * z), (2, 4, 3), str(z)) for z in range(3))
    tower = assembly_of(BrickModel(bricks), load_kit("lego"), "tower")
    plan = l2a.build(tower, arm=("panda", "panda"), tool="socket")
    assert plan.complete
    arms = [arm_of(record.arm) for record in plan.records]
    made = [make_program(*one) for one in zip(plan.records, arms, strict=True)]
    programs = with_waits((made[0], made[1]), (arms[0], arms[1]))
    assert min(asynchronous(programs, arms, seed) for seed in range(4)) > KEPT


def ball(times: list[float], corners: list[tuple[float, float]]) -> Any:
    """A motion of a ball of 5 mm along a way on the table, of which it is known where it is at
    corners."""

    def swept(some: np.ndarray) -> Sweep:
        far = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(some, axis=0), axis=1))]
        at = np.union1d(np.arange(0.0, far[-1], 0.005), far)
        x, y = (np.interp(at, far, one) for one in some.T)
        points = np.column_stack([x, y, 0 * x])
        return Sweep(np.stack([points, points], 1)[:, None], np.full(1, 0.005), at[:, None])

    def left(now: float, until: float = np.inf) -> Sweep:
        first, last = (max(int(np.searchsorted(times, t, "right")) - 1, 0) for t in (now, until))
        return swept(np.array(corners)[first : last + 1])

    began, ended = times[0], times[-1]
    whole = swept(np.array(corners))
    return _Span(began, ended, began, ended, False, False, whole, left=left)


def test_a_motion_does_not_wait_for_one_that_came_to_where_it_had_been() -> None:
    """However near it was to the way of that when it has left."""
    leaves = ball([0.0, 0.5, 1.0, 3.0], [(0.0, 0.0), (0.0, 0.2), (0.2, 0.2), (0.5, 0.5)])
    comes = ball([0.9, 1.0, 2.0], [(0.3, 0.1), (0.1, 0.18), (0.0, 0.0)])
    assert not _follows(leaves, comes)
    elsewhere = ball([0.9, 1.0, 2.0], [(0.3, 0.1), (0.1, 0.18), (0.1, 0.0)])
    assert _follows(leaves, elsewhere)
    # Though it is where this one goes when it has ended: it has gone on from there by then.
    ahead = ball([0.9, 1.0, 2.0], [(0.3, 0.1), (0.1, 0.18), (0.5, 0.5)])
    assert _follows(leaves, ahead)


def test_each_arm_gets_a_program_that_says_what_it_waits_for(
    built: tuple[Path, dict[str, Any]], tmp_path: Path
) -> None:
    folder, told = built[0], list[dict[str, Any]]()
    for number in (1, 2):
        file = l2a.export_program(folder / f"trajectory-{number}.json", "csv", tmp_path / "t.csv")
        head = [line[2:] for line in file.file.read_text().splitlines() if line[0] == "#"]
        told.append({key: json.loads(rest) for key, _, rest in (x.partition(": ") for x in head)})
        played = l2a.replay_program(file.file, ("ur5e", "panda")[number - 1])
        mine = len({step["block"] for step in told[-1]["steps"]})
        assert played.same
        assert played.brought == Plan.load(folder).blocks.used - mine > 0
        file.file.unlink()
    for one, other in (told, told[::-1]):
        assert [wait["other"] for wait in one["waits"]] == other["awaited"]
    script = l2a.export_program(folder / "trajectory-1.json", "urscript", tmp_path).file.read_text()
    calls = re.findall(r"^ +l2a_(done|await)\((\d+)\)$", script, re.MULTILINE)
    done = [int(number) for what, number in calls if what == "done"]
    assert done == sorted(done)
    assert {*done} == {*range(1, len(told[0]["awaited"]) + 1)}
    waits = [int(number) for what, number in calls if what == "await" and number != "0"]
    assert waits == [*range(1, len(told[0]["waits"]) + 1)]
    one, other = Plan.load(folder).records
    again = l2a.export_program((one, other), "urscript", tmp_path / "again.script")
    assert again.file.read_text() == script
    assert again.waits == len(told[0]["waits"])
    assert f"has come so far, {again.waits} times;" in script
    alone = tmp_path / "trajectory-1.json"
    alone.write_bytes((folder / alone.name).read_bytes())
    with pytest.raises(InputError, match="record of the other arm, for which this one has to wait"):
        l2a.export_program(alone, "csv", tmp_path / "alone.csv")
    with pytest.raises(InputError, match=r"trajectory-N\.json of one of them"):
        l2a.export_program(folder, "urscript", tmp_path / "both.script")


def test_a_bag_has_both_arms_on_one_clock(
    built: tuple[Path, dict[str, Any]], tmp_path: Path
) -> None:
    """Each rests where it waits; nothing else of its motion is another one."""
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    plan = Plan.load(built[0])
    arms = [arm_of(record.arm) for record in plan.records]
    made = [make_program(*one) for one in zip(plan.records, arms, strict=True)]
    waiting = with_waits((made[0], made[1]), (arms[0], arms[1]))
    together = on_one_clock(waiting)
    for who, (before, now) in enumerate(zip(waiting, together, strict=True)):
        assert (np.diff(now.knots.time) > 0).all()
        assert len(list(motions(now))) == len(list(motions(before)))
        for (a, b), (c, d) in zip(motions(before), motions(now), strict=True):
            assert np.allclose(
                np.diff(before.knots.time[a : b + 1]), np.diff(now.knots.time[c : d + 1])
            )
            assert np.array_equal(before.knots.position[a : b + 1], now.knots.position[c : d + 1])
        for wait in now.waits:
            assert wait.time >= wait.other - 1e-9
            assert wait.other in together[1 - who].awaited
    late = [replace(one, waits=(Wait(1.0, 2.0, 1),)) for one in waiting]
    with pytest.raises(Learn2AssembleError, match="wait for one another for ever"):
        on_one_clock((late[0], late[1]))
    rested = sum(b.seconds - a.seconds for a, b in zip(waiting, together, strict=True))
    assert rested > 0.01
    bag = l2a.export_program(built[0], "ros2", tmp_path)
    with bag.file.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        found = [(c.topic, m.log_time, data) for _, c, m, data in reader.iter_decoded_messages()]
    for name, program in zip(("ur5e", "panda"), together, strict=True):
        told = [time for topic, time, _ in found if topic == f"/{name}/joint_trajectory"]
        begins = [round(1e9 * program.knots.time[a]) for a, _ in motions(program)]
        assert told == begins
    last = max(time for topic, time, _ in found if topic.endswith("/joint_states"))
    assert bag.seconds == pytest.approx(last / 1e9)
    # Each counts its places from 1, so it is said whose they are.
    assert {row[0] for row in bag.rows} == {
        f"{name} {place.number}"
        for name, program in zip(("ur5e", "panda"), together, strict=True)
        for place in program.places
    }
    frames = {t.child_frame_id for topic, _, m in found if topic[:3] == "/tf" for t in m.transforms}
    assert {"ur5e/tcp", "panda/tcp", "ur5e/base", "panda/panda_link0", "cell_0"} <= frames
    with pytest.raises(InputError, match="the programs of two arms"):
        l2a.replay_program(bag.file, "ur5e")
    assert names_of_two("panda", "panda") == ("panda_1", "panda_2")


def test_a_folder_with_files_of_two_builds_is_refused_in_one_line(
    built: tuple[Path, dict[str, Any]], tmp_path: Path
) -> None:
    for name in ("plan.json", "trajectory-1.json", "trajectory-2.json"):
        (tmp_path / name).write_bytes((built[0] / name).read_bytes())
    file = tmp_path / "trajectory-2.json"
    said = json.loads(file.read_text(encoding="utf-8"))
    said["names"][0] = "a block of another build"
    file.write_text(json.dumps(said), encoding="utf-8")
    with pytest.raises(InputError, match=r"trajectory-2\.json: got 'a record with other blocks'"):
        l2a.export_program(tmp_path / "trajectory-1.json", "csv", tmp_path / "new.csv")
    file.unlink()
    with pytest.raises(InputError, match="expected a record of the other arm"):
        l2a.export_program(tmp_path / "trajectory-1.json", "csv", tmp_path / "new.csv")
    plan = json.loads((tmp_path / "plan.json").read_text(encoding="utf-8"))
    plan["arms"] = plan["arms"][:1]
    (tmp_path / "plan.json").write_text(json.dumps(plan), encoding="utf-8")
    with pytest.raises(InputError, match="a complete plan of an arm, or of two"):
        l2a.run(tmp_path)


def test_the_page_of_arms_that_never_moved_shows_the_plan(
    built: tuple[Path, dict[str, Any]], tmp_path: Path
) -> None:
    plan = Plan.load(built[0])
    assert plan.assembly is not None
    still = tuple(
        replace(one, steps=tuple(replace(step, stages=()) for step in one.steps))
        for one in plan.records
    )
    write_plan_page(replace(plan, records=still), tmp_path / "view.html")
    text = (tmp_path / "view.html").read_text(encoding="utf-8")
    assert "<rect class=" not in text.split("<script")[0]
    assert f"Place {plan.assembly.blocks[plan.steps[0].block].id}" in text


def test_the_page_shows_both(built: tuple[Path, dict[str, Any]]) -> None:
    folder, _ = built
    plan, text = Plan.load(folder), (folder / "view.html").read_text(encoding="utf-8")
    assert "Built by arms ur5e and panda" in text
    assert len(re.findall(r'<rect class="reached" data-segment="\d+" x="[\d.]+" y="0"', text)) > 0
    assert len(re.findall(r'<rect class="reached" data-segment="\d+" x="[\d.]+" y="10"', text)) > 0
    assert "Done by panda." in text
    playback = Playback(plan.records, plan)
    both = [
        (a, b)
        for a in playback.segments
        for b in playback.segments
        if (a.arm, b.arm) == (0, 1) and max(a.start, b.start) < min(a.end, b.end)
    ]
    assert both
    for a, b in both:
        clock = (max(a.start, b.start) + min(a.end, b.end)) / 2
        assert {one.arm for one in playback.active_at(clock)} == {0, 1}
    # What is held is where the tool has it.
    for segment in playback.segments:
        glide = next(one for one in segment.glides if one.grip is not None)
        assert glide.grip is not None
        clock = (glide.grip + glide.release) / 2
        point, axes = playback.arms[segment.arm].shape.tool(playback.arm_at(clock, segment.arm)[0])
        where = playback.cells_at(clock)[0][glide.cell]
        assert np.allclose(where, point + axes @ glide.offset, atol=1e-6)


def at(*places: float) -> Site:
    """Arms beside each other, so far along x."""
    return Site(
        arms=tuple(
            one._replace(base=(x, 0.5, 0.0, -1.57))
            for one, x in zip(SITE_ARMS, places, strict=True)
        )
    )


@pytest.mark.parametrize(
    ("arms", "options", "words"),
    [
        (("ur5e", "ur5e", "panda"), {}, "3 arms"),
        (("ur5e", "panda"), {"kit": "lego", "tool": "suction"}, "a cup does not hold on studs"),
        (("ur5e", "panda"), {"layout": at(0.1, 0.2)}, "expected at least 0.32 m"),
        (("ur5e", "panda"), {"layout": at(3.0, 4.0)}, "blocks out of it"),
    ],
)
def test_what_two_arms_cannot_do_is_one_line(
    arms: tuple[str, ...], options: dict[str, Any], words: str
) -> None:
    with pytest.raises(InputError) as error:
        l2a.build(wall(4, 2, 1), arm=arms, **options)
    assert words in str(error.value)
    assert "\n" not in str(error.value)


# ---------------------------------------------------------------- one arm beside a stopped one


def random_joints(rng: np.random.Generator, arm: Arm) -> np.ndarray:
    return np.clip(arm.home + rng.normal(0, 0.5, len(arm.home)), *arm.limits())


def swept(arm: Arm, *joints: np.ndarray) -> Sweep:
    return sweep(arm, capsules_of(arm), np.array(joints))


def test_what_passes_somewhere_on_the_leg_of_a_stopped_arm_is_not_set_out_on() -> None:
    rng, refused = np.random.default_rng(0), 0
    held = in_hand(LEFT, solid_capsules(BRICK, np.array([0.0, 0.0, 0.02]), np.eye(3)))
    for _ in range(300):
        far, mine = random_joints(rng, RIGHT), random_joints(rng, LEFT)
        other, ways = swept(RIGHT, RIGHT.home, far), [LEFT.home, mine, LEFT.home]
        legs = [Leg("cross", swept(LEFT, *way)) for way in pairwise(ways)]
        past = all(clear(leg.swept, other.end, PLANNED) for leg in legs)
        if not past or all(clear(leg.swept, other, PLANNED) for leg in legs):
            continue
        traffic, route = Traffic((LEFT, RIGHT)), Route("a", held, tuple(legs), AWAY)
        told = Motion("home", np.array([0.0, 1]), np.array([RIGHT.home, far]), np.zeros((2, 7)))
        if not traffic.enter(1, told):
            continue
        # It waits for the leg to be over before it moves, as long as that will be.
        assert traffic.fits(0, route)
        traffic.stopped(1)
        assert not traffic.fits(0, route)
        refused += 1
    assert refused >= 3
    assert APART <= PLANNED


class Refuses(WrappedPlant):
    """Lets an arm lift nothing."""

    told: tuple[tuple[Motion, tuple[ToolCommand, ...]], ...] = ()

    def execute(self, motion: Motion, commands: Commands = (), guards: Guards = ()) -> Report:
        if motion.stage == "lift" and np.ptp(motion.joints, axis=0).any():
            raise Failure(Outcome.UNREACHABLE, "lift", "the other arm is in the way")
        self.told = (*self.told, (motion, tuple(commands)))
        return self.plant.execute(motion, commands, guards)


@pytest.mark.parametrize("tool", ["suction", "gripper"])
def test_what_was_taken_and_not_moved_is_let_go_where_it_lies(tool: str) -> None:
    block = box_block("block", (-0.03, -0.02, 0.0), (0.03, 0.02, 0.04), density=600.0)
    plan = plan_assembly(Assembly((block,), friction=0.6))
    workcell = Workcell("panda", tool)
    found = prepare(plan, workcell, 0.0)
    plant = Refuses(DynamicPlant(setup_of(found.job, workcell)))
    done = carry_out(plan, workcell, joint=0.0, found=found, plant=plant)
    assert done.arm is not None
    details = [one.detail for one in done.arm.failures]
    assert details
    assert all(one.endswith("the other arm is in the way; put back") for one in details)
    moved = [bool(np.ptp(motion.joints, axis=0).any()) for motion, _ in plant.told]
    takes = [n for n, (_, some) in enumerate(plant.told) if any(_holds(one) for one in some)]
    opens = [n for n, (_, some) in enumerate(plant.told) if any(_opens(one) for one in some)]
    assert len(takes) == len(details)
    for n in takes:
        until = next(k for k in opens if k > n)
        assert not any(moved[n:until])


def _holds(command: ToolCommand) -> bool:
    return bool(command.vacuum) or bool(command.force)


def _opens(command: ToolCommand) -> bool:
    return command.vacuum is False or (command.width is not None and not command.force)


def test_a_block_that_replaces_another_one_is_known_to_both() -> None:
    """By its new name, under which a magazine presents it: what is not known is refused."""
    plan = l2a.build(Path("examples/designs/gate.svg"))
    job = job_of(plan, "ur5e", 1e-4)

    def arm() -> Any:
        world, like = WorkcellBlocks(job), list[int]()
        return SimpleNamespace(
            world=world,
            names=set(world.names),
            sight=SimpleNamespace(belief=SimpleNamespace(known={})),
            known=SimpleNamespace(fails=Counter(), refused={}),
            recording=SimpleNamespace(like=like, replace=world.add, sync=lambda: None),
        )

    mine, other = arm(), arm()
    mine.recording.like += range(len(job.pieces))
    other.recording.like += range(len(job.pieces))
    spare = mine.world.add(2)
    mine.recording.like.append(2)
    tell(mine, other, {2, spare})
    assert other.world.names == mine.world.names
    assert mine.world.names[2] != job.pieces[2].id
    assert set(other.world.names) <= other.names
