"""Two arms: their cell as data, what a hand can give, and plans in which one of them holds.

Two arms in one simulated world: one clock, one state, and each its own plant.
"""

from __future__ import annotations

import json
import math
import runpy
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

import learn2assemble as l2a
from learn2assemble.assembly.blocks import Assembly
from learn2assemble.assembly.boxes import box_block
from learn2assemble.assembly.hands import Hand
from learn2assemble.cell.pieces import Pose, pieces_of
from learn2assemble.cell.site import Magazine, Site, read_site
from learn2assemble.cell.site_arms import SiteArm
from learn2assemble.constants import GRAVITY
from learn2assemble.errors import InputError
from learn2assemble.kinematics.capsules import capsules_of, in_hand, solid_capsules
from learn2assemble.kinematics.inverse import solve
from learn2assemble.kinematics.sweeps import clear, sweep
from learn2assemble.planning.given import plan_assembly
from learn2assemble.plants.plant import Guard, Motion, Report, Request, Stop, ToolCommand, standing
from learn2assemble.plants.setup import BlockKind, Setup
from learn2assemble.robot.arm import Arm, arm_model, get_arm
from learn2assemble.robot.bodies import Part
from learn2assemble.robot.grasps import Attitude
from learn2assemble.robot.hand import SHARE, hand_limits
from learn2assemble.robot.moves import AT_THE_SIDE, BASE_THERE, Move
from learn2assemble.simulation.clock import SharedClock
from learn2assemble.simulation.plant import DynamicPlant
from learn2assemble.statics.states import State
from learn2assemble.team.crew import APART, ArmCrew
from learn2assemble.team.members import plan_by_team, set_up_team, team_reach
from learn2assemble.viewer.page import write_plan_page

EXAMPLES = Path(__file__).resolve().parents[1] / "examples" / "structures"
ARMS = (SiteArm("one", "panda"), SiteArm("two", "ur5e"))


def balanced() -> Assembly:
    """A beam that falls off its pier until a stone stands on its end, which only then is let go."""
    pier = box_block("pier", (-0.12, -0.05, 0.0), (0.0, 0.05, 0.06), density=2000.0)
    beam = box_block("beam", (-0.12, -0.05, 0.06), (0.34, 0.05, 0.09), density=500.0)
    stone = box_block("stone", (-0.12, -0.05, 0.09), (0.0, 0.05, 0.15), density=2000.0)
    return Assembly((pier, beam, stone), friction=0.6)


def test_ways_pass_a_base_at_the_side_where_blocks_lean_alone() -> None:
    """Where both arms move at once, ways above a base leave the other arm more room."""
    arch = runpy.run_path(str(EXAMPLES / "arch.py"))["arch"](5, 0.2, 0.08)
    for assembly, past in ((balanced(), AT_THE_SIDE), (arch, BASE_THERE)):
        for member in set_up_team(assembly, ARMS, Site()):
            told = {one.name: one.aside for one in member.job.obstacles}
            assert told == {"the other arm": past, "the other arm's supply": AT_THE_SIDE}


def held_at(name: str) -> tuple[Arm, Move, np.ndarray]:
    """An arm with a cup that leans on something in front of it."""
    arm = get_arm(name, "suction")
    place = Attitude(yaw=0.4, tilt=0.5, depth=0.03)
    move = Move(0, np.array([0.05, 0.1, 0.25]), place, place)
    point = place.tool_point(move.target)
    found = solve(arm, point, place.rotation(), arm.home, restarts=20)
    assert found.ok
    return arm, move, found.joints


# ---------------------------------------------------------------- what a hand can give


@pytest.mark.parametrize("name", ["panda", "ur5e"])
def test_a_hand_gives_nothing_that_cup_payload_or_joints_could_not(name: str) -> None:
    arm, move, joints = held_at(name)
    point, limits, bounds = hand_limits(arm, move, joints)
    hand = Hand.within(point.tolist(), limits, bounds)
    assert arm.suction is not None
    cup, tool = arm.suction.cups[0], move.place.rotation()
    rng, loads = np.random.default_rng(0), []
    rows, most = np.array(hand.rows), np.array(hand.most)
    model = arm_model(arm)
    data = mujoco.MjData(model)
    which = [model.joint(j).id for j in arm.joints]
    data.qpos[model.jnt_qposadr[which]] = joints
    mujoco.mj_forward(model, data)
    linear, angular = np.empty((3, model.nv)), np.empty((3, model.nv))
    at = np.array(hand.point)
    body = int(model.site(arm.tool).bodyid[0])
    mujoco.mj_jac(model, data, linear, angular, at, body)
    limit = np.array([model.actuator(k).forcerange[1] for k in range(len(which))])
    carried = (arm.payload - arm.suction.mass) * GRAVITY
    for _ in range(300):
        way = rng.normal(size=6) * [1, 1, 1, 0.02, 0.02, 0.02]
        wrench = way / max(float((rows @ way / most).max()), 1e-12)
        force, moment = wrench[:3], wrench[3:]
        assert hand.gives(0.999 * force, 0.999 * moment)
        assert not hand.gives(1.01 * force, 1.01 * moment)
        assert np.linalg.norm(force) <= carried * (1 + 1e-9)
        # The block loads the cup with the opposite, in its frame.
        loads.append(max(cup.load(-tool.T @ force, -tool.T @ moment)))
        torque = linear.T @ force + angular.T @ moment + data.qfrc_bias
        assert (np.abs(torque[model.jnt_dofadr[which]]) <= limit + 1e-6).all()
    assert max(loads) <= 1 + 1e-9
    assert max(loads) > 0.9 * SHARE
    # Straight along its axis nothing but the pull-off force and the payload counts.
    pull = min(SHARE * cup.pull_off, 0.886 * carried)
    up = -move.place.approach()
    assert hand.gives(0.99 * pull * up, np.zeros(3))
    assert not hand.gives(1.14 * pull * up, np.zeros(3))


def test_two_arms_meet_where_their_hands_do() -> None:
    one = get_arm("panda", "suction", (-0.5, 0.0, 0.0, 0.0))
    other = get_arm("panda", "suction", (0.5, 0.0, 0.0, math.pi))
    down = Attitude().rotation()

    def joints(arm: Arm, x: float) -> np.ndarray:
        found = solve(arm, np.array([x, 0.0, 0.3]), down, arm.home, restarts=20)
        assert found.ok
        return found.joints

    def meet(x: float, y: float, held: float | None = None) -> bool:
        mine = capsules_of(one)
        if held is not None:
            box = Part((0.0, 0.0, 0.0), (held, held, 0.05))
            mine = mine.add(in_hand(one, solid_capsules([box], np.zeros(3), np.eye(3))))
        there = sweep(other, capsules_of(other), joints(other, y)[None])
        return not clear(sweep(one, mine, joints(one, x)[None]), there, 0.012)

    assert not meet(-0.2, 0.2)
    assert meet(-0.02, 0.02)
    # A block of 0.6 m between hands that are 0.3 m apart.
    assert not meet(-0.15, 0.15)
    assert meet(-0.15, 0.15, 0.3)


# ---------------------------------------------------------------- the cell as data


def layout(tmp_path: Path, **content: Any) -> Path:
    file = tmp_path / "layout.json"
    head = {"format": "learn2assemble-layout", "version": 2}
    file.write_text(json.dumps({**head, **content}), encoding="utf-8")
    return file


LEFT, RIGHT = ({"position": [0.0, y, 0.0], "yaw": yaw} for y, yaw in ((-0.5, 1.571), (0.5, -1.571)))
TWO = [{"name": "a", "arm": "panda", "base": LEFT}, {"name": "b", "arm": "ur5e", "base": RIGHT}]


def test_a_layout_has_arms(tmp_path: Path) -> None:
    some = [{**TWO[0], "magazines": [1], "tool": "suction-side"}, TWO[1]]
    kinds = [{"kind": "", "at": [0.2, y]} for y in (0.3, -0.3)]
    site = read_site(layout(tmp_path, arms=some, magazines=kinds))
    assert [one.name for one in site.arms] == ["a", "b"]
    assert site.arms[0] == SiteArm("a", "panda", "suction-side", (0.0, -0.5, 0.0, 1.571), (1,))
    assert site.base is None


@pytest.mark.parametrize(
    ("content", "arms", "words"),
    [
        (
            {"arms": TWO, "base": LEFT},
            "ab",
            "base: got [0.0, -0.5, 0.0, 1.571], expected none beside arms",
        ),
        ({"arms": [*TWO, TWO[0]]}, "ab", "arms: got '3 arms', expected a list of 1 to 2 arms"),
        ({"arms": [TWO[0], TWO[0]]}, "ab", "arms[1].name: got 'a', expected a name that no other"),
        ({"arms": [{"arm": "pandas"}]}, "a", "arms[0].arm: got 'pandas'"),
        ({"arms": [{**TWO[0], "magazines": [0]}]}, "a", "arms[0].magazines: got [0]"),
        ({"arms": TWO}, "ac", "arm: got 'c', expected one of a, b"),
        ({"arms": TWO}, "aa", "arm: got 'a, a', expected each arm of the layout once"),
        ({"arms": TWO}, "aba", "arm: got '3 arms', expected 2 at most"),
        (
            {"arms": [TWO[0], {**TWO[1], "base": LEFT}]},
            "ab",
            "arms a and b: got 'bases 0.00 m apart', expected at least 0.32 m",
        ),
        (
            {
                "arms": [
                    {**one, "base": {"position": [3.0 * k - 4, 0, 0]}} for k, one in enumerate(TWO)
                ]
            },
            "ab",
            "expected bases from which one of the arms reaches each",
        ),
        (
            {"arms": TWO, "magazines": [{"kind": "", "at": [1.5, 0.0]}], "table": [4, 2]},
            "ab",
            "magazines[0]: got [1.5, 0.0, 0.0], expected a place that one of the arms",
        ),
        (
            {"arms": TWO, "positions": [{"at": [0.3, 0.3]}]},
            "ab",
            "pallets or positions', expected magazines, for several arms",
        ),
    ],
)
def test_bad_cells_are_refused_in_one_line(
    tmp_path: Path, content: dict[str, Any], arms: str, words: str
) -> None:
    file = layout(tmp_path, **content)
    with pytest.raises(InputError) as error:
        l2a.build(balanced(), arm=tuple(arms), layout=file, physics="kinematic")
    assert words in str(error.value)
    assert "\n" not in str(error.value)


def test_arms_stand_on_opposite_sides_and_reach_everything() -> None:
    pieces = pieces_of(balanced())
    found = team_reach(ARMS, pieces)
    assert (found.both, found.out) == (3, [])
    (x, y, _, facing), (u, v, _, other) = (one.base or (9.0, 9, 9, 9) for one in found.arms)
    assert (u, v) == pytest.approx((-x, -y))
    assert math.cos(other - facing) == pytest.approx(-1.0)
    # A wall of 1.8 m: each reaches its own half.
    wall = Assembly(
        tuple(
            box_block(f"b{k}", (0.2 * k - 0.9, -0.03, 0), (0.2 * k - 0.71, 0.03, 0.06))
            for k in range(9)
        )
    )
    some = tuple(
        one._replace(base=(x, 0.5, 0.0, -math.pi / 2))
        for one, x in zip(ARMS, (-0.6, 0.6), strict=True)
    )
    wide = team_reach(some, pieces_of(wall))
    assert wide.out == []
    assert wide.both < 9


# ---------------------------------------------------------------- plans


@pytest.fixture(scope="module")
def plan() -> l2a.Plan:
    return l2a.build(balanced(), arm=("panda", "panda"), physics="kinematic", supports="none")


def test_the_page_of_a_plan_says_which_arm_is_to_do_what(plan: l2a.Plan, tmp_path: Path) -> None:
    write_plan_page(plan, tmp_path / "view.html")
    text = (tmp_path / "view.html").read_text(encoding="utf-8")
    for arm in ("panda-1", "panda-2"):
        assert text.count(f"By {arm}.") >= sum(step.arm == arm for step in plan.steps)


def test_one_arm_holds_while_the_other_one_places(plan: l2a.Plan) -> None:
    assert plan.complete, plan.reason
    assert plan.assembly is not None
    names = [plan.assembly.blocks[step.block].id for step in plan.steps]
    told = [(step.action, name) for step, name in zip(plan.steps, names, strict=True)]
    assert told[1:3] == [("place", "beam"), ("hold", "beam")]
    assert ("release", "beam") in told[4:]
    assert [arm.name for arm in plan.arms] == ["panda-1", "panda-2"]
    holder: str | None = None
    for step in plan.steps:
        assert step.arm in ("panda-1", "panda-2")
        assert step.action != "place" or step.arm != holder
        if step.action == "hold":
            assert plan.steps[step.step - 2].arm == step.arm
            holder = step.arm
        if step.action == "release":
            assert step.arm == holder
            holder = None
    assert holder is None


def test_the_plan_proves_itself_again_with_what_its_hands_can_give(
    plan: l2a.Plan, tmp_path: Path
) -> None:
    plan.save(tmp_path, page=False)
    again = l2a.load_plan(tmp_path)
    assert again.arms == plan.arms
    assert [step.arm for step in again.steps] == [step.arm for step in plan.steps]
    assert again.assembly is not None
    proven = plan_assembly(again.assembly, supports="none")
    assert proven.complete
    assert [s.margin_g for s in proven.steps] == pytest.approx([s.margin_g for s in plan.steps])
    document = json.loads((tmp_path / "assembly.json").read_text(encoding="utf-8"))
    hold = next(step for step in document["steps"] if "hold" in step)
    # With a tenth of what the hand gives the beam falls.
    hold["hand"]["most"] = [0.1 * value for value in hold["hand"]["most"]]
    (tmp_path / "weak.json").write_text(json.dumps(document), encoding="utf-8")
    weak = plan_assembly(l2a.read_assembly(tmp_path / "weak.json"), supports="none")
    assert not weak.complete
    assert len(weak.steps) == 1


def test_each_arm_takes_from_places_of_its_own() -> None:
    members = set_up_team(balanced(), ARMS, l2a.Site())
    places = [tuple(s.pose[:2]) for member in members for s in member.job.sources]
    assert len(set(places)) == len(places) == 4
    for member in members:
        away = [math.dist(s.pose[:2], member.job.base) for s in member.job.sources]
        assert max(away) < 0.85


def one_row() -> Assembly:
    """Two blocks of one kind side by side."""
    return Assembly(
        tuple(box_block(str(k), (0.07 * k, 0, 0), (0.07 * k + 0.06, 0.04, 0.04)) for k in range(2))
    )


@pytest.mark.parametrize(
    ("told", "places", "own"),
    [
        ((None, None), [(-0.05, 0.3)], [(0,), ()]),
        ((None, None), [(0.1, 0.3)], [(), (0,)]),
        # Both are nearer to the first arm, and of the same kind: each gets one.
        ((None, None), [(-0.1, 0.3), (-0.05, -0.3)], [(0,), (1,)]),
        ((None, (0,)), [(-0.05, 0.3)], [(), (0,)]),
        (((0, 1), None), [(0.1, 0.3), (0.1, -0.3)], [(0, 1), ()]),
    ],
)
def test_a_magazine_that_both_arms_reach_is_of_one_of_them(
    told: tuple[Any, Any], places: list[tuple[float, float]], own: list[tuple[int, ...]]
) -> None:
    arms = [
        one._replace(base=(x, 0.0, 0.0, yaw), magazines=some)
        for one, x, yaw, some in zip(ARMS, (-0.5, 0.5), (0.0, math.pi), told, strict=True)
    ]
    design = one_row()
    kind = pieces_of(design)[0].kind
    site = Site(magazines=tuple(Magazine(kind, Pose(*at)) for at in places))
    members = set_up_team(design, arms, site)
    for member, some in zip(members, own, strict=True):
        given = [s.name for s in member.job.sources if "magazines" in s.name]
        assert given == [f"layout: magazines[{n}]" for n in some]
    plan = plan_by_team(design, members, options={})
    assert plan.complete, plan.reason


def test_a_magazine_of_two_arms_is_one_line() -> None:
    arms = [one._replace(magazines=(0,)) for one in ARMS]
    site = Site(magazines=(Magazine(pieces_of(one_row())[0].kind, Pose(0.0, -0.3)),))
    with pytest.raises(InputError, match=r"arms\[\].magazines: got '0 of .* and of .*"):
        set_up_team(one_row(), arms, site)


def test_what_no_arm_can_bring_does_not_fall() -> None:
    members = set_up_team(one_row(), ARMS, Site())
    bare = [replace(one, job=replace(one.job, sources=())) for one in members]
    plan = plan_by_team(one_row(), bare, options={})
    assert not plan.complete
    assert "no arm can bring 0, 1" in (plan.reason or "")
    assert "no supply" in (plan.reason or "")
    assert "falls" not in (plan.reason or "")


def test_what_is_wider_than_arms_reach_is_one_line() -> None:
    ends = ((0.9, 0.0), (-0.9, 0.0), (0.0, 0.9), (0.0, -0.9))
    posts = [
        box_block(str(k), (x, y, 0.0), (x + 0.1, y + 0.1, 0.1)) for k, (x, y) in enumerate(ends)
    ]
    with pytest.raises(InputError, match="blocks out of it"):
        set_up_team(Assembly(tuple(posts)), ARMS, Site())


def test_each_arm_is_planned_for_beside_what_the_other_one_takes() -> None:
    members = set_up_team(balanced(), ARMS, Site())
    for mine, other in (members, members[::-1]):
        job, stands = mine.job, other.job.base
        last = job.obstacles[-1 - len(other.job.sources) :]
        assert [one.name for one in last] == [
            "the other arm",
            *["the other arm's supply"] * len(other.job.sources),
        ]
        np.testing.assert_allclose(last[0].centre, stands)


def test_courses_of_a_vault_stand_without_posts_beside_one_another() -> None:
    vault = runpy.run_path(str(EXAMPLES / "vaults.py"))["barrel_vault"](
        voussoirs=5, courses=3, radius=0.2, thickness=0.08, course=0.06, apart=1e-3
    )
    ends = (0.0, -0.53, 0.0, math.pi / 2), (0.0, 0.5, 0.0, -math.pi / 2)
    arms = [
        SiteArm(name, name, "suction-wide", base)
        for name, base in zip(("ur5e", "panda"), ends, strict=True)
    ]
    members = set_up_team(vault, arms, Site())
    plan = plan_by_team(
        vault, members, posts=False, options={"friction": None, "gap": None, "seconds": 600.0}
    )
    assert plan.complete, plan.reason
    assert plan.blocks.used == 15
    held = [step for step in plan.steps if step.action == "hold"]
    # Two of each course, by turns of the arms.
    assert len(held) == 6
    assert {step.arm for step in held} == {"ur5e", "panda"}


def test_an_arm_comes_past_one_that_leans_over_the_place() -> None:
    """Of an arch whose crown is held: straight down there is no way to the place beside it, along
    the joints there is."""
    arch = runpy.run_path(str(EXAMPLES / "arch.py"))["arch"](9)
    members = set_up_team(arch, [SiteArm("one", "ur5e"), SiteArm("two", "panda")], Site())
    crew, nothing = ArmCrew(members, arch.blocks), np.zeros(9, bool)

    def without(*missing: int) -> State:
        return State(~np.isin(np.arange(9), missing), nothing.copy())

    ways = {True: 0, False: 0}
    for held in crew._reached(1, 4, without(4, 5, 6)):
        for found in crew._reached(0, 5, without(5, 6)):
            if all(clear(way, held.stands, APART) for way in found.ways):
                ways[found.move.place.way > 0] += 1
    assert ways[True] > 0
    assert ways[False] == 0


LEFT = get_arm("panda", "suction", (-0.55, 0.0, 0.0, 0.0))
RIGHT = get_arm("ur5e", "suction", (0.55, 0.0, 0.0, np.pi))
BRICK = BlockKind((Part((0.0, 0.0, 0.0), (0.05, 0.025, 0.025)),), 600.0)
AT = {
    "a": np.array([-0.15, -0.2, 0.025, 1.0, 0.0, 0.0, 0.0]),
    "b": np.array([0.15, 0.2, 0.025, 1.0, 0.0, 0.0, 0.0]),
}
ON = (ToolCommand(vacuum=True),)
KEPT = (Guard(hold="kept"),)


def cell() -> DynamicPlant:
    return DynamicPlant(Setup(LEFT, dict.fromkeys("ab", BRICK), AT, others=(RIGHT,)))


def over(arm: Arm, block: str, height: float) -> np.ndarray:
    """Joints with the cup over a brick [m]."""
    point = AT[block][:3] + np.array([0, 0, height])
    found = solve(arm, point, Attitude().rotation(), arm.home)
    assert found.ok
    return found.joints


def way(stage: str, start: np.ndarray, end: np.ndarray, seconds: float) -> Motion:
    share = np.linspace(0, 1, 21)[:, None]
    joints = start + (3 * share**2 - 2 * share**3) * (end - start)
    velocity = 6 * (share - share**2) * (end - start) / seconds
    return Motion(stage, seconds * share[:, 0], joints, velocity)


def fetch(plant: DynamicPlant, number: int, block: str, hold: float) -> Callable[[], list[Report]]:
    """Take a brick up and hold it for some time [s]."""

    def run() -> list[Report]:
        one = plant.plants[number]
        arm = one.arm
        above, touching = over(arm, block, 0.1), over(arm, block, 0.025)
        return [
            one.execute(way("approach", arm.home, above, 2.0)),
            one.execute(way("pick", above, touching, 1.0)),
            one.execute(standing("pick", touching, 0.5), ON, (Guard(hold="made"),)),
            one.execute(way("lift", touching, above, 1.0), (ToolCommand(load=0.15),), KEPT),
            one.execute(standing("cross", above, hold), (), KEPT),
        ]

    return run


def poses(plant: DynamicPlant) -> dict[str, np.ndarray]:
    return {one.block: one.pose for one in plant.sense().blocks}


def test_two_arms_move_at_the_same_time() -> None:
    plant = cell()
    ends = over(LEFT, "a", 0.1), over(RIGHT, "b", 0.1)
    plant.clock.run(
        [
            lambda: plant.plants[0].execute(way("approach", LEFT.home, ends[0], 1.0)),
            lambda: plant.plants[1].execute(way("approach", RIGHT.home, ends[1], 1.6)),
        ]
    )
    assert plant.sense().time == pytest.approx(1.6)
    for one, end in zip(plant.plants, ends, strict=True):
        assert np.abs(one.sense().joints - end).max() < 2e-3
        assert one.sense().arm == one.arm.name


def test_what_one_arm_holds_stays_where_it_is_while_the_other_one_works() -> None:
    plant = cell()
    held = plant.clock.run([fetch(plant, 0, "a", 6.0), fetch(plant, 1, "b", 0.0)])
    for reports in held:
        assert [one.stop for one in reports] == [Stop.END, Stop.END, Stop.HELD, Stop.END, Stop.END]
    there = poses(plant)
    assert abs(there["a"][2] - 0.1) < 1e-3
    # The other one is idle by now, its motions over for long, and holds its brick, too.
    assert abs(there["b"][2] - 0.1) < 1e-3
    one = plant.plants[1]
    down = way("place", one.where(), over(RIGHT, "b", 0.02), 2.0)
    before = poses(plant)["a"]
    report = one.execute(down, (), (Guard(hold="kept", contact=1.0),))
    assert report.stop == Stop.CONTACT
    one.execute(standing("release", report.joints, 0.3), (ToolCommand(vacuum=False, load=0.0),))
    one.execute(way("retreat", report.joints, RIGHT.home, 2.0))
    after = poses(plant)
    assert np.abs(after["a"] - before).max() < 1e-4
    assert np.abs(after["b"][:3] - AT["b"][:3]).max() < 1e-3
    assert plant.plants[0].held() == "a"
    assert one.held() is None


def test_what_an_arm_holds_does_not_feel_that_the_other_one_begins() -> None:
    """When other blocks are free from now on, all goes on as before, to the forces on a cup."""
    plant = cell()
    plant.clock.run([lambda: [], fetch(plant, 1, "b", 0.2)])
    loads = []
    for _ in "12":
        cup = plant.plants[1].bench.sim.cup
        assert cup is not None
        assert cup.row is not None
        loads.append(np.hstack(cup.load(cup.row)))
        plant.acting = plant.plants[0]
        plant.enter({"a"})
    np.testing.assert_allclose(loads[1], loads[0], atol=0.02)
    weight = 600.0 * 0.1 * 0.05 * 0.05 * 9.81
    assert np.linalg.norm(loads[1][:3]) == pytest.approx(weight, abs=0.1)


def test_the_same_motions_give_the_same_to_the_last_bit() -> None:
    found: list[Any] = []
    for _ in range(2):
        plant = cell()
        reports = plant.clock.run([fetch(plant, 0, "a", 0.2), fetch(plant, 1, "b", 0.1)])
        played = [one.played for both in reports for one in both if one.played is not None]
        found.append([*(np.hstack([p.joints, p.velocity]) for p in played), *poses(plant).values()])
    assert all(np.array_equal(a, b) for a, b in zip(*found, strict=True))


def test_an_arm_that_meets_the_other_one_stops_and_the_other_one_goes_on() -> None:
    plant = cell()
    turn = Attitude().rotation()
    near, far = (solve(LEFT, np.array([x, 0.0, 0.3]), turn, LEFT.home).joints for x in (-0.2, 0.25))
    mine = solve(RIGHT, np.array([0.05, 0.0, 0.25]), turn, RIGHT.home).joints
    work = over(RIGHT, "b", 0.1)
    one, other = plant.plants
    other.execute(way("approach", RIGHT.home, mine, 2.0))
    one.execute(way("approach", LEFT.home, near, 2.0))
    hit = one.execute(way("cross", near, far, 3.0), (), (Guard(force=0.5),))
    assert hit.stop == Stop.FORCE
    assert "1/" in hit.detail
    assert other.execute(way("home", mine, work, 2.0)).stop == Stop.END


def test_a_state_is_written_and_read() -> None:
    plant, other = cell(), cell()
    plant.clock.run([fetch(plant, 0, "a", 0.0), lambda: []])
    plant.plants[1].execute(way("approach", RIGHT.home, over(RIGHT, "b", 0.1), 1.0))
    other.restore(plant.state())
    for one, two in zip(plant.plants, other.plants, strict=True):
        assert np.array_equal(one.where(), two.where())
    assert other.sense().time == plant.sense().time
    # What was in the hand is at its magazine again, and the cup takes it only when it is told to.
    assert (plant.held(), other.held()) == ("a", None)
    one = other.plants[0]
    above, touching = over(LEFT, "a", 0.1), over(LEFT, "a", 0.025)
    assert one.request(Request("present", "a", "a", AT["a"])).stop == Stop.END
    one.execute(way("pick", above, touching, 1.0))
    one.execute(standing("pick", touching, 0.5))
    assert one.held() is None
    assert one.execute(standing("pick", touching, 0.5), ON, (Guard(hold="made"),)).stop == Stop.HELD
    assert one.held() == "a"


def test_parts_of_the_arms_are_told_apart() -> None:
    world = cell().simulated.world
    model = world.model
    left, right = world.arms
    assert len(np.intersect1d(left.joint, right.joint)) == 0
    assert model.nu == len(left.actuators) + len(right.actuators)
    for parts, prefix in ((left, ""), (right, "1/")):
        names = {
            model.body(model.geom_bodyid[g]).name
            for g in np.flatnonzero(world.kind == parts.kinds[0])
        }
        assert names
        assert all(name.startswith("1/") == bool(prefix) for name in names)
    assert mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_EQUALITY, right.cup) == "1/cup"


# ---------------------------------------------------------------- the clock


def test_time_goes_on_when_all_that_move_wait() -> None:
    happened: list[Any] = []
    clock = SharedClock(lambda moving: happened.append(sorted(moving)))

    def job(who: int, ticks: int) -> Callable[[], int]:
        def run() -> int:
            for k in range(ticks):
                happened.append((who, k))
                clock.tick(who)
            return who

        return run

    assert clock.run([job(0, 1), job(1, 3), job(2, 2)]) == [0, 1, 2]
    assert happened == [
        (0, 0), (1, 0), (2, 0), [0, 1, 2],
        (1, 1), (2, 1), [1, 2],
        (1, 2), [1],
    ]  # fmt: skip
    clock.tick(1)
    assert happened[-1] == [1]


def test_an_error_of_one_ends_that_one_alone() -> None:
    steps: list[int] = []
    clock = SharedClock(lambda moving: steps.append(len(moving)))

    def fails() -> None:
        clock.tick(0)
        raise ValueError("broken")

    def works() -> None:
        for _ in range(4):
            clock.tick(1)

    with pytest.raises(ValueError, match="broken"):
        clock.run([fails, works])
    assert steps == [2, 1, 1, 1]


def test_an_error_of_the_world_reaches_everybody() -> None:
    def broken(moving: frozenset[int]) -> None:
        raise ArithmeticError("diverged")

    clock = SharedClock(broken)
    with pytest.raises(ArithmeticError):
        clock.run([lambda: clock.tick(0), lambda: clock.tick(1)])
