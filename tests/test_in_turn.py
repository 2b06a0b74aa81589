"""Two arms of which one holds a block while the other one brings the next, in the dynamic cell."""

from __future__ import annotations

import json
import math
import runpy
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest

from learn2assemble.assembly.blocks import Assembly
from learn2assemble.assembly.boxes import box_block
from learn2assemble.assembly.contacts import Contacts, find_contacts
from learn2assemble.assembly.hands import Hand
from learn2assemble.cell.site import Site
from learn2assemble.cell.site_arms import SiteArm
from learn2assemble.cell.workcell import Workcell
from learn2assemble.constants import GRAVITY
from learn2assemble.errors import InputError
from learn2assemble.export.robot_programs import export_program, read_program
from learn2assemble.geometry.hulls import box_hull, hull_of
from learn2assemble.geometry.rotations import (
    matrix_quaternion,
    quaternion_matrix,
    rotation_of,
    yaw_matrix,
)
from learn2assemble.handling.execution import Execution
from learn2assemble.kinematics.capsules import Capsules, capsules_of, placed, solid_capsules
from learn2assemble.kinematics.chain import forward, get_chain
from learn2assemble.kinematics.inverse import solve
from learn2assemble.motion.driver import arm_of
from learn2assemble.motion.program import make_program
from learn2assemble.motion.waits import BY_HAND, on_one_clock, with_waits
from learn2assemble.planning.plan import Plan
from learn2assemble.planning.sequence import Supports
from learn2assemble.plants.plant import Guard, Motion, ToolReading
from learn2assemble.robot.arm import get_arm
from learn2assemble.robot.bodies import Part
from learn2assemble.robot.grasps import Attitude
from learn2assemble.robot.scene import reshape
from learn2assemble.simulation.model import TIMESTEP, compile_world
from learn2assemble.statics.forces.block_forces import System
from learn2assemble.statics.states import State
from learn2assemble.team import in_turn
from learn2assemble.team import members as team
from learn2assemble.team.crew import LIP_ROOM, ArmCrew, Member
from learn2assemble.team.in_turn import (
    about_vertical,
    build_by_two,
    solids_of,
)
from learn2assemble.team.members import plan_by_team, set_up_team
from learn2assemble.team.pressing import (
    AT_ONCE,
    BETWEEN,
    FARTHEST,
    FIRM,
    NARROWER,
    SHARES,
    TURNS,
    PressingHand,
    contact_force,
)
from test_together import asynchronous

EXAMPLES = Path(__file__).resolve().parents[1] / "examples" / "structures"
ARMS = SiteArm("one", "panda"), SiteArm("two", "panda")


def beam_held_down(posts: bool = False) -> tuple[Plan, list[Member]]:
    """A beam that falls off its pier until a stone stands on its end, planned for two arms."""
    pier = box_block("pier", (-0.12, -0.05, 0.0), (0.0, 0.05, 0.06), density=2000.0)
    beam = box_block("beam", (-0.12, -0.05, 0.06), (0.34, 0.05, 0.09), density=500.0)
    stone = box_block("stone", (-0.12, -0.05, 0.09), (0.0, 0.05, 0.15), density=2000.0)
    assembly = Assembly((pier, beam, stone), friction=0.6)
    members = set_up_team(assembly, ARMS, Site())
    options = {"friction": None, "gap": None, "seconds": 60.0}
    return plan_by_team(assembly, members, posts=posts, options=options), members


@pytest.fixture(scope="module")
def planned() -> tuple[Plan, list[Member]]:
    return beam_held_down()


def built(planned: tuple[Plan, list[Member]]) -> Plan:
    plan, members = planned
    return build_by_two(plan, members, Workcell("panda", hands=True), joint=0.0)


def test_while_somebody_sets_posts_one_arm_works_after_the_other(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Where hands hold nothing, a post stands under the beam until the stone has come."""
    monkeypatch.setattr(team, "Supports", lambda **told: Supports(**{**told, "holds": 0}))
    plan, members = beam_held_down(posts=True)
    assert plan.by_turns
    done = built((plan, members))
    assert done.complete
    assert [(s.action, s.arm is None) for s in done.steps if s.prop] == [
        ("place", True),
        ("remove", True),
    ]
    times = [record.spans() for record in done.records]
    assert sum(len(one) for one in times) == 3
    check_programs_with_hands(done, tmp_path)


def check_programs_with_hands(plan: Plan, folder: Path) -> None:
    """However late one arm is, what is done by hand comes when its turn is."""
    arms = [arm_of(record.arm) for record in plan.records]
    made = [make_program(*one) for one in zip(plan.records, arms, strict=True)]
    programs = with_waits((made[0], made[1]), (arms[0], arms[1]))
    asked = [(who, *ask) for who, one in enumerate(programs) for ask in one.asks]
    by_hand = [number for number, step in enumerate(plan.steps, 1) if step.by_hand]
    assert len(asked) == len(by_hand) == 2

    def comes_to(who: int, other: float) -> float:
        """How far an arm comes while the other one stands at a time of its program."""
        waits = programs[who].waits
        return min([w.time for w in waits if w.other > other + 1e-9], default=np.inf)

    for number, (who, hand, halt) in zip(by_hand, asked, strict=True):
        assert plan.steps[number - 1].action == ("place" if hand.place else "remove")
        for arm, program in enumerate(programs):
            for k, step in enumerate(program.steps):
                assert step.plan_step is not None
                assert step.held is not None
                begin = program.steps[k - 1].end if k else 0.0
                if arm == who:
                    assert step.held[1] < halt if step.plan_step < number else step.held[0] > halt
                elif step.plan_step < number:
                    assert comes_to(who, step.held[1]) <= halt
                    assert comes_to(who, program.seconds) > halt
                else:
                    assert comes_to(arm, halt) <= step.held[0]
                    assert comes_to(arm, halt + BY_HAND) > begin
    assert asynchronous(programs, arms, 0) > 0
    for one in on_one_clock(programs):
        assert (np.diff(one.knots.time) > 0).all()
    assert [w.hands for one in programs for w in one.waits if w.hands]
    # Both say how large the post is and where it stands, and nothing else stands there.
    for one in programs:
        assert [stood.name for stood in one.stands if stood.by_hand] == [asked[0][1].name]
        assert len(one.stands) == 1
    # Files say the same.
    plan.save(folder)
    for number, program in enumerate(programs, 1):
        file = export_program(folder / f"trajectory-{number}.json", "csv", folder / "t.csv").file
        (told,) = (x for x in file.read_text().splitlines() if x.startswith("# hands: "))
        assert [one["time"] for one in json.loads(told[9:])] == [
            pytest.approx(time) for _, time in program.asks
        ]
        assert read_program(file, "panda")[0].waits[0].hands == program.waits[0].hands
        file.unlink()
    records = [
        replace(one, hands=tuple(hand._replace(time=None) for hand in one.hands))
        for one in plan.records
    ]
    with pytest.raises(InputError, match="by hand without times"):
        export_program((records[0], records[1]), "csv", folder / "t.csv")


def test_without_its_hold_the_beam_falls(
    planned: tuple[Plan, list[Member]], monkeypatch: pytest.MonkeyPatch
) -> None:
    def lets_go(self: Any, who: int) -> Any:
        def passes(run: Execution) -> None:
            self.now += 2 * (self.steps[self.now + 1].action == "hold")

        return passes

    monkeypatch.setattr(in_turn.InTurn, "_holder", lets_go)
    done = built(planned)
    assert not done.complete
    failures = [one.detail for arm in done.arms if arm.did for one in arm.did.failures]
    assert any("beam leans by" in one for one in failures), failures


def test_an_arm_that_ends_by_a_fault_leaves_the_other_one_no_wait(
    planned: tuple[Plan, list[Member]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The stone never comes, and the arm with the beam is told."""
    act = in_turn.InTurnBuilding.act

    def fails(self: Any, action: Any) -> Any:
        if action.block == 2:
            raise ZeroDivisionError("a fault")
        return act(self, action)

    monkeypatch.setattr(in_turn.InTurnBuilding, "act", fails)
    with pytest.raises(ZeroDivisionError, match="a fault"):
        built(planned)


def test_what_is_in_a_hand_cannot_be_gone_on_with_from_a_file(
    planned: tuple[Plan, list[Member]], tmp_path: Path
) -> None:
    plan, members = planned
    log = tmp_path / "build.jsonl"
    log.write_text("what another build wrote\n")
    with pytest.raises(InputError, match="no build to go on from: steps hold a block"):
        build_by_two(plan, members, Workcell("panda", log=log))
    assert log.read_text() == "what another build wrote\n"


def test_solids_around_an_arm_contain_it() -> None:
    rng = np.random.default_rng(0)
    for name in ("panda", "ur5e"):
        arm = get_arm(name, "suction", (0.1, -0.4, 0.0, 1.0))
        capsules = capsules_of(arm)
        joints = arm.home + rng.normal(0, 0.3, len(arm.home))
        lines = placed(get_chain(arm), capsules, joints[None].copy())[0]
        for (pose, half, hull), (a, b), radius in zip(
            solids_of(arm, joints), lines, capsules.radius, strict=True
        ):
            ways = rng.normal(size=(50, 3))
            ways *= radius / np.linalg.norm(ways, axis=1)[:, None]
            points = a + rng.random((50, 1)) * (b - a) + ways
            own = (points - pose[:3]) @ quaternion_matrix(pose[3:])
            assert (np.abs(own) <= half - 0.01).all()
            outside = own @ hull.normals.T - hull.offsets
            assert (outside <= -0.0115).all()
            assert outside.max(1).max() > -0.02


def test_capsules_around_a_convex_part_contain_it_and_leave_room_beside_it() -> None:
    rng = np.random.default_rng(1)
    # A voussoir, whose upper end is twice as wide as its lower one.
    ends = ((-0.06, 0.03), (0.06, 0.06))
    wedge = np.array([(x, y, z) for z, x in ends for x in (-x, x) for y in (-0.04, 0.04)])
    for points in (wedge, *(rng.normal(0, 0.03, (12, 3)) for _ in range(20))):
        low, high = points.min(0), points.max(0)
        hull = hull_of(points - (low + high) / 2)
        middle, half = ((low + high) / 2).tolist(), ((high - low) / 2).tolist()
        part = Part(tuple(middle), tuple(half), hull)
        found = solid_capsules([part], np.zeros(3), np.eye(3), 0.008)
        shares = rng.dirichlet(np.ones(len(hull.points)), 400)
        inside = np.vstack([part.points, shares @ part.points])
        assert outside(found, inside).max() < 1e-9
    part = Part((0.0, 0.0, 0.0), (0.06, 0.04, 0.06), hull_of(wedge))
    beside = np.array([[0.055, 0.0, -0.055]])  # In the box of the voussoir, 2 cm from its face.
    own = solid_capsules([part], np.zeros(3), np.eye(3), 0.008)
    box = solid_capsules([part._replace(hull=None)], np.zeros(3), np.eye(3), 0.008)
    assert outside(own, beside)[0] > 0.005
    assert outside(box, beside)[0] < 0


def outside(capsules: Capsules, points: np.ndarray) -> np.ndarray:
    """float64[n]: how far points are outside of all capsules [m]; at most 0 inside."""
    a, b = capsules.ends[:, 0], capsules.ends[:, 1]
    along = b - a
    share = np.einsum("nkc,kc->nk", points[:, None] - a, along) / (along**2).sum(1).clip(1e-18)
    near = a + share.clip(0, 1)[..., None] * along
    return (np.linalg.norm(points[:, None] - near, axis=2) - capsules.radius).min(1)


def test_friction_of_blocks_that_lean_does_not_creep() -> None:
    """A block stays on a slope of 25 degrees, where friction of 0.6 carries up to 31."""
    slope = math.radians(25.0)
    rise = 0.2 * math.tan(slope)
    ends = ((-0.1, 0.02), (0.1, 0.02 + rise))
    wedge = np.array([(x, y, z) for x, top in ends for y in (-0.05, 0.05) for z in (0.0, top)])
    height = float(wedge[:, 2].max()) / 2
    lower, block = hull_of(wedge - [0.0, 0.0, height]), box_hull((0.04, 0.04, 0.02))
    still = (((0.0, 0.0, 0.0), (0.1, 0.05, height), 50.0, lower),)
    shape = (still, (((0.0, 0.0, 0.0), (0.04, 0.04, 0.02), 0.3, block),))
    arm = get_arm("panda", "suction", (0.0, -1.5, 0.0, 0.0))
    model = compile_world((arm,), shape, 0.6, hulls=frozenset({lower, block})).model
    data = mujoco.MjData(model)
    # Else it would fall asleep, and stay because of that.
    model.opt.enableflags &= ~int(mujoco.mjtEnableBit.mjENBL_SLEEP)
    up = 0.02 * np.array([-math.sin(slope), 0.0, math.cos(slope)])
    middle = [0.0, 0.0, 0.02 + rise / 2]
    turn = [math.cos(slope / 2), 0.0, -math.sin(slope / 2), 0.0]
    places = ([0.0, 0.0, height, 1.0, 0.0, 0.0, 0.0], [*np.add(up, middle), *turn])
    ways = [model.jnt_qposadr[model.body(f"object{k}").jntadr[0]] for k in range(2)]
    for way, place in zip(ways, places, strict=True):
        data.qpos[way : way + 7] = place
    seen = list[np.ndarray]()
    for seconds in (1.0, 8.0):
        for _ in range(round(seconds / TIMESTEP)):
            mujoco.mj_step(model, data)
        seen.append(data.qpos[ways[1] : ways[1] + 3].copy())
    assert np.linalg.norm(seen[1] - seen[0]) < 5e-5


def test_a_cup_that_is_moved_aside_stays_on_its_face() -> None:
    arch = runpy.run_path(str(EXAMPLES / "arch.py"))["arch"](9)
    members = set_up_team(arch, [SiteArm("one", "ur5e"), SiteArm("two", "panda")], Site())
    crew, nothing = ArmCrew(members, arch.blocks), np.zeros(9, bool)
    found = crew._reached(0, 0, State(nothing, nothing.copy()))
    moved = [one.move for one in found if any(one.move.place.aside)]
    assert moved
    piece, suction = crew.worlds[0].pieces[0], members[0].job.arm.suction
    assert suction is not None
    for move in moved:
        point, axis = move.place.tool_point(move.target), move.place.approach()
        middle = piece.pose[:3] + piece.turn @ np.array(piece.shape[0].centre)
        solid = piece.shape[0].solid
        normals = solid.normals @ piece.turn.T
        depth = solid.offsets - (point - middle) @ normals.T
        face = int(np.argmin(normals @ axis))
        assert abs(depth[face]) < 1e-6
        slope = np.linalg.norm(np.cross(normals, normals[face]), axis=1)
        others = slope > 1e-6
        room = depth[others] / slope[others]
        assert room.min() >= suction.cups[0].radius + LIP_ROOM - 1e-6


def test_an_arch_of_nine_voussoirs_needs_no_post() -> None:
    """Only the newest block is held, by turns, until the last one closes the arch."""
    arch = runpy.run_path(str(EXAMPLES / "arch.py"))["arch"](9)
    arms = [SiteArm(arm, arm, "suction-wide") for arm in ("ur5e", "panda")]
    members = set_up_team(arch, arms, Site())
    options = {"friction": None, "gap": None, "seconds": 600.0}
    plan = plan_by_team(arch, members, posts=False, options=options)
    assert plan.complete, plan.reason
    held = [(step.block, step.arm) for step in plan.steps if step.action == "hold"]
    assert len(held) == 4
    assert all(one[1] != other[1] for one, other in pairwise(held))
    at_once = most = 0
    for step in plan.steps:
        at_once += (step.action == "hold") - (step.action == "release")
        most = max(most, at_once)
    assert most == 2  # One holds on until the other one has its block in its place.


def test_a_grasp_turns_with_the_block_that_waits() -> None:
    grasp = Attitude(0.3, 0.7, spin=0.2, into=(0.6, 0.0, -0.8))
    turn = yaw_matrix(0.1)
    found = about_vertical(grasp, turn)
    assert np.allclose(found.rotation(), turn @ grasp.rotation())
    assert np.allclose(found.insertion(), turn @ grasp.insertion())


def test_an_arm_that_stands_is_round() -> None:
    """Past the edges of the boxes around it there is room."""
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(name="still")
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.01] * 3)
    ball = spec.worldbody.add_body(pos=[0.09, 0.09, 0.0])
    ball.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.01, 0.0, 0.0])
    model = spec.compile()
    data, half = mujoco.MjData(model), np.array([[0.06, 0.06, 0.2]])
    found = []
    for rounded in (True, False):
        reshape(model, np.array([0]), half, None, np.array([rounded]))
        mujoco.mj_kinematics(model, data)
        found.append(mujoco.mj_geomDistance(model, data, 0, 1, 1.0, None))
    assert abs(found[0] - (0.09 * np.sqrt(2) - 0.07)) < 1e-6
    assert abs(found[1] - (0.03 * np.sqrt(2) - 0.01)) < 1e-6


# ---------------------------------------------------------------- what a hand presses with


STRONG = Hand.within((0.0, 0.0, 0.0), np.vstack([np.eye(6), -np.eye(6)]), np.full(12, 100.0))


def half_arch(placed: int) -> tuple[Assembly, Contacts, State]:
    """Of 21 voussoirs the first ones, the last of them held."""
    arch = runpy.run_path(str(EXAMPLES / "arch.py"))["arch"](21, radius=0.5, thickness=0.14)
    state = State(np.zeros(21, bool), np.zeros(21, bool)).change(place=range(placed))
    return arch, find_contacts(arch), state.change(hold=[placed - 1], hand=STRONG)


@pytest.mark.parametrize("placed", [7, 11, 14])
def test_the_forces_balance_every_block_and_leave_no_joint_at_an_edge(placed: int) -> None:
    arch, contacts, state = half_arch(placed)
    system = System(arch, contacts, state.present, state.held, dict(state.hands))
    share = SHARES[0]
    forces = system.centred(arch.friction, share)
    assert forces is not None
    every = system.newtons(forces)
    for patch in np.unique(contacts.patch):
        bears = every[contacts.patch == patch] @ contacts.normal[patch]
        if np.abs(bears).max() > 0:
            assert np.abs(bears).min() >= share * np.abs(bears).mean() * (1 - 1e-4)
            along = every[contacts.patch == patch] - np.outer(bears, contacts.normal[patch])
            assert np.linalg.norm(along, axis=1).max() <= arch.friction * np.abs(bears).max() + 1e-3
    for block in range(placed - 1):
        on = contacts.b[contacts.patch] == block
        off = contacts.a[contacts.patch] == block
        total = every[on].sum(0) - every[off].sum(0)
        weight = GRAVITY * arch.blocks[block].mass
        assert np.abs(total - [0.0, 0.0, weight]).max() < 1e-3 * weight


def test_what_the_held_block_feels_is_what_its_only_neighbour_does_to_it() -> None:
    arch, contacts, state = half_arch(11)
    felt = contact_force(arch, contacts, state, 10)
    assert felt is not None
    # Block 9 presses it away from itself, and hangs on it: the hand bears the rest.
    apart = arch.blocks[10].centroid - arch.blocks[9].centroid
    assert felt @ apart > 0
    assert felt[2] < 0


def test_where_no_hand_can_hold_it_nothing_is_said() -> None:
    arch, contacts, _ = half_arch(11)
    state = State(np.zeros(21, bool), np.zeros(21, bool)).change(place=range(11))
    weak = Hand.within((0.0, 0.0, 0.0), np.vstack([np.eye(6), -np.eye(6)]), np.full(12, 1e-3))
    assert contact_force(arch, contacts, state.change(hold=[10], hand=weak), 10) is None


# ---------------------------------------------------------------- an arm on springs


class Springs:
    """An attempt by an arm whose drives are springs, with its block on a wall that is one, too.

    Args:
        way: float64[3], unit vector into the wall, on which the block just is.
        wall: its stiffness [N/m].
    """

    drives = 2e4

    def __init__(self, way: np.ndarray, wall: float = 1e5) -> None:
        self.way, self.wall, self.arm = way, wall, get_arm("panda", "suction")
        self.joints = self.arm.home.copy()
        """As they are told to be."""
        self.start, self.turn = forward(get_chain(self.arm), self.joints)
        self.rig = SimpleNamespace(plant=self)
        self.felt, self.most = np.zeros(3), 0.0
        self.real = self.joints

    def sense(self) -> SimpleNamespace:
        x, y, z = self.felt.tolist()
        return SimpleNamespace(joints=self.real, tool=ToolReading(force=(x, y, z)))

    def do(self, run: Motion, guards: tuple[Guard, ...]) -> None:
        self.most = max(self.most, float(np.abs(run.joints[1] - run.joints[0]).max()))
        self.joints = run.joints[1]
        told, turn = forward(get_chain(self.arm), self.joints)
        into = max(float(self.way @ (told - self.start)), 0.0)
        back = into * self.wall / (self.wall + self.drives)
        found = solve(self.arm, told - self.way * back, turn, self.joints, restarts=0)
        self.real, self.felt = found.joints, -self.way * (into - back) * self.wall

    @property
    def presses(self) -> float:
        return float(-self.way @ self.felt)


def held(springs: Springs, newtons: float) -> PressingHand:
    """A block of 0.4 kg that is where it shall be, and is to be pressed on the wall."""
    where, turn = forward(get_chain(springs.arm), springs.joints)
    in_hand = np.array([0.0, 0.0, 0.03]), np.eye(3)
    pose = np.array([*(where + turn @ in_hand[0]), *matrix_quaternion(turn)])
    run: Any = springs
    return PressingHand(run, springs.arm, in_hand, pose, springs.way, -newtons * springs.way, 0.4)


@pytest.mark.parametrize("newtons", [2.0, 20.0])
@pytest.mark.parametrize("wall", [2e4, 2e5])
def test_a_hand_presses_until_it_feels_the_force(newtons: float, wall: float) -> None:
    springs = Springs(np.array([0.6, 0.0, -0.8]), wall)
    hold = held(springs, newtons)
    for _ in range(TURNS):
        hold.press()
    assert springs.presses == pytest.approx(newtons, rel=0.05)
    off = forward(get_chain(springs.arm), springs.real)[0] - springs.start
    assert np.abs(off - springs.way * (springs.way @ off)).max() < 5e-5
    for _ in range(TURNS):
        hold.stay()
    assert springs.presses == pytest.approx(newtons, rel=0.1)


@pytest.mark.parametrize("needed", [6.0, 12.0])
def test_a_hand_that_keeps_its_place_finds_the_force_for_that(needed: float) -> None:
    """Half an arch leans on it with as much as it does; with the force of the proof it would be
    pushed away, or sink."""
    springs = Springs(np.array([0.6, 0.0, -0.8]), wall=1e4)
    hold = held(springs, 10.0)
    # So far from its place the soft wall gives as much as is needed.
    hold.pose[:3] += springs.way * (needed / springs.wall + NARROWER)
    for _ in range(3 * TURNS):
        hold.press(keeps=True)
    there = forward(get_chain(springs.arm), springs.real)[0] - springs.start
    assert springs.presses == pytest.approx(needed, rel=0.05)
    assert springs.way @ there == pytest.approx(needed / springs.wall, abs=5e-4)
    assert hold.share == pytest.approx(needed / 10.0, rel=0.05)


def test_a_hand_that_keeps_its_place_presses_with_no_more_than_some_times_the_force() -> None:
    springs = Springs(np.array([0.6, 0.0, -0.8]), wall=2e5)
    hold = held(springs, 2.0)
    hold.pose[:3] += springs.way * 2e-3  # Behind a wall that does not give way.
    for _ in range(4 * TURNS):
        hold.press(keeps=True)
    assert hold.share == BETWEEN[1]
    assert springs.presses == pytest.approx(2.0 * BETWEEN[1], rel=0.1)


def test_where_no_force_is_felt_a_hand_stops() -> None:
    """The block meets nothing, or nothing measures what it meets."""
    springs = Springs(np.array([0.0, 0.0, -1.0]), wall=0.0)
    hold = held(springs, 20.0)
    for _ in range(10 * TURNS):
        hold.press()
    gone = forward(get_chain(springs.arm), springs.real)[0] - springs.start
    assert np.linalg.norm(gone) == pytest.approx(FARTHEST, rel=0.01)
    for _ in range(10 * TURNS):
        hold.ease()
    gone = forward(get_chain(springs.arm), springs.real)[0] - springs.start
    assert np.linalg.norm(gone) < 1.01 * FARTHEST


def test_without_a_force_it_only_keeps_its_place() -> None:
    springs = Springs(np.array([0.0, 0.0, -1.0]))
    hold = held(springs, 20.0)
    kept = PressingHand(hold.run, springs.arm, hold.in_hand, hold.pose, springs.way, None, 0.4)
    for _ in range(TURNS):
        kept.press()
    gone = forward(get_chain(springs.arm), springs.real)[0] - springs.start
    assert np.abs(gone).max() < 2e-5


def test_before_it_lets_go_it_bears_nothing() -> None:
    springs = Springs(np.array([0.0, 0.0, -1.0]))
    hold = held(springs, 20.0)
    for _ in range(TURNS):
        hold.press()
    for _ in range(TURNS):
        hold.ease()
    assert springs.presses == pytest.approx(0.4 * GRAVITY, rel=0.1)


def test_a_block_that_is_off_is_brought_to_its_place_in_small_steps() -> None:
    springs = Springs(np.array([0.0, 0.0, -1.0]))
    hold = held(springs, 0.0)
    meant = rotation_of(np.array([0.0, 0.0, 0.004])) @ quaternion_matrix(hold.pose[3:])
    hold.pose[:2] += [2e-3, -1.5e-3]
    hold.pose[3:] = matrix_quaternion(meant)
    for _ in range(TURNS):
        hold.press()
    where, turn = forward(get_chain(springs.arm), springs.real)
    assert np.abs((where + turn @ hold.in_hand[0] - hold.pose[:3])[:2]).max() < 5e-5
    assert np.abs(turn - meant).max() < 5e-4
    assert springs.most <= AT_ONCE + 1e-12


class Felt(PressingHand):
    """A hand that feels what it is told, and only says where it would go."""

    feels: np.ndarray = np.zeros(3)
    went: np.ndarray = np.zeros(3)

    def _joints(self) -> np.ndarray:
        return self.arm.home

    def _felt(self) -> np.ndarray:
        return self.feels

    def _bent(self, point: np.ndarray, turn: np.ndarray) -> np.ndarray:
        self.went = point - self._hand()[0]
        return self.arm.home

    def _keep(self, there: np.ndarray) -> None:
        """It does not move."""


def test_a_hand_that_lets_go_gives_way_but_not_sideways() -> None:
    arm = get_arm("panda")
    where, turn = forward(get_chain(arm), arm.home)
    pose = np.array([*where, *matrix_quaternion(turn)])
    beside = pose + np.array([0.0, 2e-4, 0.0, 0.0, 0.0, 0.0, 0.0])
    for way, place, goes in (
        # Along the joint and up it follows what it feels, level across it comes to its place.
        ([1.0, 0.0, 0.0], pose, [5.0 / FIRM, 0.0, -3.0 / FIRM]),
        ([0.6, 0.0, -0.8], beside, [5.0 / FIRM, 2e-4, -3.0 / FIRM]),
        # On a level joint there is no such direction: it follows in all.
        ([0.0, 0.0, -1.0], beside, [5.0 / FIRM, 4.0 / FIRM, -3.0 / FIRM]),
    ):
        run: Any = None
        in_hand = np.zeros(3), np.eye(3)
        hand = Felt(run, arm, in_hand, place, np.array(way), np.array([-9.0, 0.0, -1.0]), 0.4)
        hand.feels = hand.weight + np.array([5.0, 4.0, -3.0])
        hand.ease()
        assert hand.went == pytest.approx(goes, abs=1e-9)
