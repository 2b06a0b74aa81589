"""Two arms that press bricks home in one cell: their order, who may press when, and builds."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import learn2assemble as l2a
from brick_data import DUPLO, duplo, scene_of
from learn2assemble.acting.building import Building
from learn2assemble.acting.state import Action
from learn2assemble.assembly.bricks.model import Brick, BrickModel, assembly_of
from learn2assemble.assembly.joints import Joint
from learn2assemble.assembly.kit import load_kit
from learn2assemble.cell.arrange import FINGERS, put_beside, steps_before
from learn2assemble.cell.bricks import BrickStates, BrickStructure
from learn2assemble.cell.site import Site
from learn2assemble.cell.site_arms import SiteArm
from learn2assemble.cell.workcell import Offset, StepOf, Workcell
from learn2assemble.cell.world import LOST, WorkcellBlocks, moves, rows_of, supply_of
from learn2assemble.errors import InputError
from learn2assemble.handling.dry_run import _put_home
from learn2assemble.handling.dynamic_cell import DynamicCell
from learn2assemble.kinematics.capsules import capsules_of, in_hand, solid_capsules
from learn2assemble.kinematics.sweeps import still, sweep
from learn2assemble.planning.plan import Plan
from learn2assemble.plants.plant import Motion
from learn2assemble.robot.arm import get_arm
from learn2assemble.robot.bodies import Part
from learn2assemble.robot.moves import Move
from learn2assemble.robot.studs import GROUND, StudJoint, Studs
from learn2assemble.simulation.clutch import Clutch
from learn2assemble.simulation.objects import rigid_objects
from learn2assemble.simulation.plant import DynamicPlant
from learn2assemble.simulation.simulation import SimulatedState
from learn2assemble.team.crew import Member
from learn2assemble.team.members import set_up_team
from learn2assemble.team.pair import bricks_by_team, gather
from learn2assemble.team.telling import HERE, assume, forget
from learn2assemble.team.together import Together
from learn2assemble.team.traffic import Leg, Route, Traffic

ARMS = SiteArm("one", "panda", "gripper"), SiteArm("two", "panda", "gripper")


STAIR = duplo(((4, 2), (0, 0, 0)), ((2, 2), (0, 0, 1)), ((2, 2), (1, 0, 2)), ((2, 2), (2, 0, 3)))
"""Its last brick alone tips the one below it when it is pressed home."""

Ordered = tuple[Plan, tuple[StepOf, ...], list[Member]]


def ordered_stair() -> Ordered:
    """The order of the stair for two arms."""
    members = set_up_team(STAIR, ARMS, Site())
    plan, order = bricks_by_team(STAIR, members, Workcell("panda", "gripper"))
    assert plan.complete
    return plan, order, members


@pytest.fixture(scope="module")
def stair() -> Ordered:
    return ordered_stair()


# ---------------------------------------------------------------- the order


def test_two_arms_find_the_order_of_one(stair: Ordered) -> None:
    plan, order, _ = stair
    assert [step.block for step in order] == [0, 1, 2, 3, 2]
    assert [step.group for step in order] == [(), (), (), (), (3,)]
    assert [step.beside is not None for step in order] == [False, False, True, True, False]
    assert [step.way for step in plan.steps] == ["above", "above", "beside", "beside"]
    assert [arm.name for arm in plan.arms] == ["one", "two"]
    assert [arm.tool for arm in plan.arms] == ["gripper", "gripper"]


def test_in_a_replay_what_the_other_arm_has_pressed_home_is_home() -> None:
    facts = (16.8, (0.0, 0.0, 0.0), (), ((0.0,) * 3, (0.0,) * 3), False)
    joints = tuple(
        StudJoint(lower, upper, (0.0, 0.0, high), *facts)  # pyright: ignore[reportArgumentType]
        for lower, upper, high in ((GROUND, 0, 0.01), (0, 1, 0.02), (1, 2, 0.02))
    )
    poses = np.array([[0.0, 0.0, z, 1.0, 0.0, 0.0, 0.0] for z in (0.01, 0.03, -0.05)])
    studs = Studs(joints, 20.0)
    assert _put_home(studs, poses, {0, 1, 2}) == {(GROUND, 0), (0, 1)}
    assert _put_home(studs, poses, {1}) == {(0, 1)}
    poses[0, 0] = 0.1  # It waits in a magazine.
    assert _put_home(studs, poses, {0, 1, 2}) == set()


def test_what_is_only_planned_says_who_brings_what_and_why_it_stands() -> None:
    plan = l2a.build(STAIR, arm=("panda", "ur5e"), tool="socket-large", physics="kinematic")
    assert plan.complete
    assert plan.assembly is not None
    assert {step.arm for step in plan.steps} == {"panda", "ur5e"}
    assert all(step.proof and step.margin_g is not None for step in plan.steps)
    ids = [plan.assembly.blocks[step.block].id for step in plan.steps]
    assert [step.place for step in plan.assembly.steps] == ids
    assert [step.way for step in plan.assembly.steps] == [None, None, "beside", "beside"]


def test_what_one_arm_builds_beside_comes_when_the_other_one_brings_it() -> None:
    plan = l2a.build(STAIR, arm=("panda", "ur5e"), tool="socket-large")
    assert plan.complete
    heights = [step.position[2] for step in plan.steps]
    assert heights == sorted(heights)
    assert {step.proof for step in plan.steps} == {"joints that hold"}
    assert len({step.arm for step in plan.steps if step.way == "beside"}) == 1
    did = [arm.did for arm in plan.arms]
    assert [one and one.attempts_per_step for one in did] == [1.0, 1.0]
    assert sum(one.attempts for one in did if one) == 5


def test_what_no_order_bears_to_be_pressed_is_refused() -> None:
    """A hook, whose last brick hangs: it has to come from below, or with all of the hook."""
    hook = duplo(*(((2, 4), at) for at in ((0, 8, 0), (0, 6, 1), (0, 4, 2), (0, 2, 3), (0, 0, 2))))
    assert BrickStates(hook).need.stands
    plan = l2a.build(hook, arm=("panda", "panda"), physics="kinematic")
    assert plan.status == "refused"
    assert "neither arm can place" in (plan.reason or "")


def test_arms_whose_fingers_have_no_room_are_told_of_sockets() -> None:
    bricks = [((4, 2), (0, 0, 0)), *(((1, 2), (x, 0, 1)) for x in range(4))]
    made = [Brick((x, y, 3 * z), (a, b, 3), f"{x} {z}") for (a, b), (x, y, z) in bricks]
    row = assembly_of(BrickModel(tuple(made)), load_kit("lego"), "row")
    plan = l2a.build(row, arm=("panda", "panda"), physics="kinematic")
    assert plan.status == "refused"
    said = "; with `tool=socket` there is an order in which the arms do every step"
    assert (plan.reason or "").endswith(said)
    plan = l2a.build(row, arm=("panda", "panda"), tool="socket", physics="kinematic")
    assert plan.complete, plan.reason


def test_a_brick_comes_to_what_bears_its_press(stair: Ordered) -> None:
    """Also where the order is another one than was found, and what is built beside stands there
    alone."""
    plan, order, members = stair
    crew = gather(plan, members, Workcell("panda", "gripper"), 0.0, order)
    structure, world = crew.found[0].structure, WorkcellBlocks(crew.found[0].job)
    assert isinstance(structure, BrickStructure)
    three = frozenset({0, 1, 2})
    assert structure.stands(three | {3})
    assert not structure.takes(StepOf(3), three, world)
    assert structure.takes(StepOf(2), three - {2}, world)
    put_beside(world, order)
    # On the brick that stands alone on the table, not on what it comes to later.
    assert structure.takes(StepOf(3, beside=order[3].beside), three, world)
    assert structure.takes(order[-1], three | {3}, world)
    # Nothing is there to press them on.
    assert not structure.takes(order[-1], frozenset({2, 3}), world)


def test_near_bricks_come_as_the_order_has_them() -> None:
    """And those that are far apart in any order."""
    pitch = DUPLO.pitch[0]
    far = 2 + int(np.ceil(FINGERS / pitch))
    row = duplo(*(((2, 2), (x, 0, 0)) for x in (0, 2, 2 + far)))
    members = set_up_team(row, ARMS, Site())
    plan, order = bricks_by_team(row, members, Workcell("panda", "gripper"))
    job = gather(plan, members, Workcell("panda", "gripper"), 0.0, order).found[0].job
    first, second = sorted((0, 1), key=lambda k: [step.block for step in order].index(k))
    waits = steps_before(job, BrickStructure(job), ())
    assert waits == {StepOf(second): {StepOf(first)}}
    # One part is built beside after the other where they are built on one spot.
    for far, alike in ((0.02, True), (0.5, False)):
        first, second = StepOf(0, beside=(0.5, 0.0, 0.0)), StepOf(2, beside=(0.5, far, 0.0))
        steps = first, second, StepOf(0, group=(1,), whence=(0.5, 0.0, 0.0))
        apart = steps_before(replace(job, steps=steps), BrickStructure(job), ())
        assert apart.get(second, set()) == ({first} if alike else set())
        assert apart[steps[2]] == ({first, second} if alike else {first})


def test_each_arm_builds_a_part_beside_on_its_own_side() -> None:
    """That of its end of the structure, while the other one builds the other part."""
    stairs = [((4, 2), (0, 0)), ((2, 2), (0, 0)), ((2, 2), (1, 0)), ((2, 2), (2, 0))]
    two = duplo(*((size, (x, y, z)) for y in (0, 8) for z, (size, (x, _)) in enumerate(stairs)))
    members = set_up_team(two, [one._replace(tool="socket-large") for one in ARMS], Site())
    workcell = Workcell("panda", "socket-large")
    plan, order = bricks_by_team(two, members, workcell)
    crew = gather(plan, members, workcell, 0.0, order)
    # First, as the rest waits for it, and the other arm may build that meanwhile.
    for one, part in zip(crew.found, ({2, 3}, {6, 7}), strict=True):
        assert {step.block for step in one.order.steps[:3]} == part
    parts = [next(step for step in one.order.steps if step.group) for one in crew.found]
    assert [part.block for part in parts] == [2, 6]
    jobs = [one.job for one in crew.found]
    middle = (jobs[0].base + jobs[1].base) / 2
    waits = steps_before(jobs[0], BrickStructure(jobs[0]), ())
    for job, own, other in zip(jobs, parts, parts[::-1], strict=True):
        at = job.pieces[own.block].target[:2] + own.whence[:2] - middle
        assert at @ (job.base - middle) > 0.1 * np.linalg.norm(job.base - middle)
        assert not [step for step in waits[own] if other.whence in (step.beside, step.whence)]


def test_magazines_of_bricks_are_to_the_left_of_each_arm() -> None:
    """On the way from one to another an arm does not pass what is built, nor the other arm."""
    sizes = enumerate([(2, 4), (2, 3), (2, 2), (1, 4)])
    made = [Brick((0, 0, 3 * z), (*size, 3), str(z)) for z, size in sizes]
    tower = assembly_of(BrickModel(tuple(made)), load_kit("lego"), "tower")
    members = set_up_team(tower, [one._replace(tool="socket") for one in ARMS], Site())
    middle = (members[0].job.base + members[1].job.base) / 2
    for member in members:
        x, y = middle - member.job.base
        left = [np.array([-y, x]) @ (np.array(s.pose[:2]) - middle) for s in member.job.sources]
        assert len(left) == 4
        assert min(left) > -1e-6


# ---------------------------------------------------------------- who may press


LEFT = get_arm("ur5e", "gripper", (-2.0, 0.0, 0.0, 0.0))
RIGHT = get_arm("panda", "gripper", (2.0, 0.0, 0.0, np.pi))


def pressing(*loads: dict[str, Offset]) -> tuple[Traffic, list[list[Motion]]]:
    """Two arms, far from each other, that have announced a way down and up, and its motions.

    Args:
        loads: where each of them presses, the other one as the first where nothing is said.
    """
    brick = (Part((0.0, 0.0, 0.0), (0.03, 0.02, 0.02)),)
    traffic, motions = Traffic((LEFT, RIGHT)), list[list[Motion]]()
    for who, arm in enumerate((LEFT, RIGHT)):
        low = arm.home + 0.1 * np.eye(len(arm.home))[1]
        ways = {"place": (arm.home, low), "retreat": (low, arm.home)}
        held = in_hand(arm, solid_capsules(brick, np.array([0.0, 0.0, 0.02]), np.eye(3)))
        goal = still(solid_capsules(brick, np.array([0.0, 3.0 + who, 0.0]), np.eye(3)))
        legs = [Leg(s, sweep(arm, capsules_of(arm), np.array(way))) for s, way in ways.items()]
        assert traffic.announce(who, Route("ab"[who], held, tuple(legs), goal, loads=loads[-who]))
        motions.append([])
        for stage, way in ways.items():
            joints = np.array(way)
            motions[-1].append(Motion(stage, np.array([0.0, 1.0]), joints, np.zeros_like(joints)))
    return traffic, motions


def test_no_arm_presses_while_the_other_one_does() -> None:
    traffic, ((down, up), (other, _)) = pressing({"place": HERE})
    assert traffic.enter(0, down)
    assert not traffic.enter(1, other)
    assert not traffic.stuck(1)
    # It presses until it lets go, not only while it moves.
    traffic.stands(0, down.joints[-1], True)
    traffic.changes += 1
    assert not traffic.enter(1, other)
    traffic.lets_go(0)
    assert traffic.enter(1, other)
    assert traffic.enter(0, up)


def test_arms_press_at_once_on_what_each_builds_beside() -> None:
    traffic, ((down, _), (other, _)) = pressing({"place": HERE}, {"place": (0.3, 0.0, 0.0)})
    assert traffic.enter(0, down)
    assert traffic.enter(1, other)


def test_blocks_that_are_set_down_may_come_at_once() -> None:
    traffic, ((down, _), (other, _)) = pressing({})
    assert traffic.enter(0, down)
    assert traffic.enter(1, other)


def test_nothing_is_pressed_on_what_a_stopped_arm_presses_on() -> None:
    traffic, ((down, _), _) = pressing({"place": HERE})
    route = traffic.lanes[1].route
    assert route is not None
    assert traffic.enter(0, down)
    traffic.over(1)
    traffic.stopped(0)
    assert not traffic.fits(1, route)
    assert traffic.fits(1, route._replace(loads={}))


def test_what_each_hand_has_pressed_home_is_its_own() -> None:
    """And goes on where the simulation does in another state: a hand that presses has not let go
    yet."""
    towers = duplo(
        ((2, 2), (0, 0, 0)), ((2, 2), (0, 0, 1)), ((2, 2), (8, 0, 0)), ((2, 2), (8, 0, 1))
    )
    states = BrickStates(towers)
    scene = scene_of(towers, states, home=False)
    objects, poses, names = rigid_objects(scene)
    assert scene.studs is not None
    world = DynamicCell(get_arm("panda", "gripper", (-0.6, 0, 0, 0))).world(objects, scene.studs)
    upper = [int(objects.owner[k]) for k in (1, 3)]

    def clutch(*given: object) -> Clutch:
        state = SimulatedState(world, poses, names)
        return Clutch(world, state.data, objects, studs, upper, *given)  # pyright: ignore

    studs = scene.studs
    one = clutch()
    one.join(1)
    assert one.home == ((2, 3),)
    assert one.made.pressed == (frozenset(), frozenset({(2, 3)}))
    studs = Studs(tuple(one.joints), studs.press)
    again = clutch(one.made)
    assert again.made == one.made
    slots = again.data.eq_active.copy()
    again.take(0)
    assert (again.data.eq_active == slots).all()
    again.take(1)
    assert again.data.eq_active.sum() == slots.sum() + 1
    assert again.made.pressed == (frozenset(), frozenset())
    assert again.made.held == (frozenset(), frozenset({(2, 3)}))
    again.draw(1)
    assert again.made.held == (frozenset(), frozenset())


# ---------------------------------------------------------------- builds


def test_what_is_taken_to_stand_is_taken_to_be_home(stair: Ordered) -> None:
    plan, order, members = stair
    both = Together(gather(plan, members, Workcell("panda", "gripper"), 0.0, order), DynamicPlant)
    building = both.buildings[0]
    world, before = building.world, (both.buildings[0].world.pose.copy(), set[tuple[int, int]]())
    known = assume(building, [0])
    assert world.home == {(-1, 0)}
    assert not building.known.structure.loose(0, world)
    forget(building, known)
    assert (world.pose == before[0]).all()
    assert world.home == before[1]
    # And what comes together, from where it was built.
    assume(building, [0])
    assume(building, [1])
    beside, home = world.beside.copy(), set(world.home)
    known = assume(building, [2, 3], (0.0, 0.0, 0.0))
    assert world.home == {(-1, 0), (0, 1), (1, 2), (2, 3)}
    assert not world.beside.any()
    assert building.known.satisfied(order[-1])
    forget(building, known)
    assert (world.beside == beside).all()
    assert world.home == home
    assert not building.known.satisfied(order[-1])


def test_the_next_step_is_one_that_can_be_done_then(stair: Ordered) -> None:
    """An arm waits above what it takes for that, not at home for a part that is not there yet."""
    plan, order, members = stair
    both = Together(gather(plan, members, Workcell("panda", "gripper"), 0.0, order), DynamicPlant)
    known = both.buildings[0].known
    beside = {step.block: step for step in order[2:4]}
    known.order = order[-1], *order[:-1]
    assert known.next_after({0}) == order[1]
    assume(both.buildings[0], [0])
    assume(both.buildings[0], [1])
    assert known.next_after({2}) == beside[3]
    assume(both.buildings[0], [2])
    assert known.next_after({3}) == order[-1]
    # Where nothing can, the first one: what is missing may come with what the arm has in hand.
    known = both.buildings[1].known
    known.order = order[1:2]
    assert known.next_after({2}) == order[1]


def test_an_arm_waits_above_what_it_takes_next(stair: Ordered) -> None:
    """And leaves out what the other arm takes before; what was built beside is lifted off by the
    hand that is above it already."""
    plan, order, members = stair
    both = Together(gather(plan, members, Workcell("panda", "gripper"), 0.0, order), DynamicPlant)
    building = both.buildings[0]
    building.known.order = order
    world, sources = building.world, [world_source(building, k) for k in range(4)]

    def after(k: int, *between: int) -> np.ndarray | None:
        building.between = set(between)
        found = building._following(Action(k, world.target(k), "place", sources[k]))
        return None if found is None else found.step

    for k, between, following in ((0, (), 1), (0, (1,), 2), (1, (2,), 3)):
        step = after(k, *between)
        assert step is not None
        there = world.presented(following, sources[following])
        np.testing.assert_allclose(step[:2], (there - world.presented(k, sources[k]))[:2])
        assume(building, [k])
    assume(building, [2])
    building.between = set()
    found = building._following(Action(3, world.target(3), "place", sources[3]))
    assert found is not None
    assert found.placed
    np.testing.assert_allclose(found.step[:2], (world.target(2) - world.target(3))[:2])


def test_what_one_arm_puts_right_is_left_to_it(stair: Ordered) -> None:
    """A brick that lies in the way of others is carried off by one arm, not by both."""
    plan, order, members = stair
    both = Together(gather(plan, members, Workcell("panda", "gripper"), 0.0, order), DynamicPlant)
    known = both.buildings[0].known
    known.order, world = order, known.world
    world.state[3], world.pose[3] = LOST, world.target(0)
    action = known.choose()
    assert isinstance(action, Action)
    assert (action.block, action.what) == (3, "away")
    known.elsewhere = {3}
    action = known.choose()
    assert isinstance(action, str) or action is None or action.block != 3


def world_source(building: Building, k: int) -> int:
    """Where an arm takes a block from."""
    return supply_of(building.world, k)[0]


@pytest.mark.parametrize("press", [None, (0.0, 0.0)])
def test_a_socket_turns_a_brick_the_shorter_way(press: tuple[float, float] | None) -> None:
    """Bricks look the same the other way round; on the stud where it is pressed, and on others."""
    made = [Brick((0, 0, 0), (4, 2, 3), "a"), Brick((8, 0, 0), (2, 4, 3), "b")]
    pair = assembly_of(BrickModel(tuple(made)), load_kit("lego"), "pair")
    members = set_up_team(pair, [one._replace(tool="socket") for one in ARMS], Site())
    for member in members:
        world = WorkcellBlocks(member.job)
        for k in range(2):
            here = world.presented(k, supply_of(world, k)[0])
            world.pose[k], goal = here, world.target(k)
            rows = rows_of(world, world.pose, k)
            at = None if press is None else (goal[0] + press[0], goal[1] + press[1])
            ways = list(moves(world, rows, k, goal, press=at))
            ends = [move.place.tool_point(move.target)[:2] for move in ways]
            near = [0.0 if at is None else round(math.dist(end, at), 3) for end in ends]
            turns = [wrist_turn(member.job.base, here, goal, move) for move in ways]
            assert near[0] == min(near)
            assert (
                turns[0] <= min(t for t, n in zip(turns, near, strict=True) if n == near[0]) + 0.1
            )
            assert turns[0] < math.pi / 2 + 0.1


def wrist_turn(base: np.ndarray, here: np.ndarray, there: np.ndarray, move: Move) -> float:
    """By how much the hand turns against the direction from the base of the arm [rad]."""
    angles = [
        math.atan2(*hand.rotation()[1::-1, 0]) - math.atan2(*(at[:2] - base)[::-1])
        for hand, at in ((move.grasp, here), (move.place, there))
    ]
    return abs(math.remainder(angles[1] - angles[0], math.tau))


def test_what_comes_together_is_expected_when_it_is_off_its_table(stair: Ordered) -> None:
    """Before, it is in the way where it was built."""
    plan, order, members = stair
    both = Together(gather(plan, members, Workcell("panda", "gripper"), 0.0, order), DynamicPlant)
    lane = both.traffic.lanes[1]
    block = still(
        solid_capsules((Part((0.0, 0.0, 0.0), (0.03, 0.02, 0.02)),), np.zeros(3), np.eye(3))
    )
    lane.route = Route("b", capsules_of(LEFT), (), block)
    both.moves[1], both.along[1], both.to[1] = 2, (3,), (0.0, 0.0, 0.0)
    for stage, holding, expected in (("lift", True, False), ("cross", True, True)):
        lane.stage, lane.holding = stage, holding
        assert both._expects(0) == expected  # pyright: ignore[reportPrivateUsage]
    both._assume(0)  # pyright: ignore[reportPrivateUsage]
    assert both.buildings[0].known.satisfied(order[-1])
    both._forget(0)  # pyright: ignore[reportPrivateUsage]
    both.along[1], both.to[1] = (), None
    lane.holding = False
    assert both._expects(0)  # pyright: ignore[reportPrivateUsage]


@pytest.mark.parametrize(
    ("joint", "options", "words"),
    [
        (Joint("mortar", tensile=1e4, shear=1e4), {}, "mortar"),
        (STAIR.joint, {"tool": "suction"}, "a cup does not hold on studs"),
        (STAIR.joint, {"supports": "posts"}, "bricks that clutch: got 'posts'"),
    ],
)
@pytest.mark.parametrize("arm", ["panda", ("panda", "panda")])
def test_what_arms_cannot_join_is_one_line(
    joint: Joint, options: dict[str, str], words: str, arm: str | tuple[str, str]
) -> None:
    with pytest.raises(InputError) as error:
        l2a.build(replace(STAIR, joint=joint), arm=arm, **options)  # pyright: ignore
    assert words in str(error.value)
    assert "\n" not in str(error.value)
