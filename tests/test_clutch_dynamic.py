"""Joints of studs in the simulation, against loads worked out by hand and by another program."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import linprog

import learn2assemble as l2a
from brick_data import DUPLO, duplo, scene_of
from learn2assemble.assembly.blocks import Assembly
from learn2assemble.assembly.bricks.lattice import GROUND
from learn2assemble.cell.bricks import BrickStates
from learn2assemble.constants import GRAVITY
from learn2assemble.errors import InputError
from learn2assemble.robot.arm import get_arm
from learn2assemble.robot.grasps import Attitude
from learn2assemble.robot.moves import Move
from learn2assemble.robot.studs import Studs
from learn2assemble.simulation.cell import DynamicCell
from learn2assemble.simulation.clutch import holds
from learn2assemble.statics.holding import Push

EXAMPLES = Path(__file__).resolve().parents[1] / "examples/bricks"


def fall(assembly: Assembly) -> float:
    """How far the farthest brick of an assembly falls [m]."""
    scene = scene_of(assembly, BrickStates(assembly))
    after, _, _ = DynamicCell(get_arm("panda", "gripper", (-0.6, 0, 0, 0))).settle(scene)
    return float((scene.position - after.position)[:, 2].max())


def heavier(assembly: Assembly, brick: int, mass: float) -> Assembly:
    """The same with another mass of a brick [kg]."""
    blocks = list(assembly.blocks)
    block = blocks[brick]
    blocks[brick] = replace(block, density=mass / block.volume)
    return replace(assembly, blocks=tuple(blocks))


LEVER = duplo(((2, 2), (0, 0, 0)), ((2, 8), (0, 0, 1)))
"""A beam of eight studs whose first two studs are pressed on."""


def lever_mass() -> float:
    """The mass of the beam at which it tips, by hand.

    Its four knobs pull with 12 T, as much at either row of studs: at 8 mm and 24 mm from the end.
    The beam, two studs wide, has a long wall beside every knob: a triangle, with the wall a quarter
    of a stud from the knob, the tubes an eighth on the other side and as far along the beam. So it
    tips about a line an eighth of a stud beyond the second row, 26 mm from the end.
    """
    pull, pitch = DUPLO.joint.capacity, DUPLO.pitch[0]
    edge = 1.5 * pitch + pitch / 8
    moment = sum(pull * 6 * (edge - row * pitch) for row in (0.5, 1.5))
    return moment / (GRAVITY * (4 * pitch - edge))


@pytest.mark.parametrize(("share", "falls"), [(0.93, False), (1.07, True)])
def test_a_lever_stands_below_its_capacity_and_falls_above(share: float, falls: bool) -> None:
    mass = share * lever_mass()
    beam = heavier(LEVER, 1, mass)
    need = BrickStates(beam).need
    # The weight of the beam is in its middle, so the share that is needed is that of its mass.
    assert need.share == pytest.approx(share, rel=1e-6)
    assert (fall(beam) > 0.005) == falls


def hanging_mass() -> float:
    """The mass at which a brick that hangs on four knobs in its middle falls off, by hand: all its
    twelve points pull."""
    return 12 * DUPLO.joint.capacity / GRAVITY


@pytest.mark.parametrize(("share", "falls"), [(0.93, False), (1.07, True)])
def test_what_hangs_is_held_up_to_its_capacity(share: float, falls: bool) -> None:
    # Two posts, a beam across them, and a brick under its middle.
    bridge = duplo(
        ((2, 2), (0, 0, 0)),
        ((2, 2), (0, 6, 0)),
        ((2, 2), (0, 0, 1)),
        ((2, 2), (0, 6, 1)),
        ((2, 8), (0, 0, 2)),
        ((2, 2), (0, 3, 1)),
    )
    made = heavier(bridge, 5, share * hanging_mass())
    assert BrickStates(made).need.share == pytest.approx(share, rel=1e-6)
    assert (fall(made) > 0.005) == falls


def test_loads_that_a_joint_bears_are_those_of_the_program() -> None:
    rng = np.random.default_rng(0)
    kinds = set()
    for _ in range(300):
        long = int(rng.choice([2, 3, 4, 6]))
        size = (2, long) if rng.random() < 0.5 else (long, 2)
        under = (2, int(rng.choice([2, 4])))
        at = int(rng.integers(1 - under[0], size[0])), int(rng.integers(1 - under[1], size[1]))
        two = duplo((under, (*at, 0)), (size, (0, 0, 1)))
        states = BrickStates(
            replace(two, blocks=(replace(two.blocks[0], support=True), *two.blocks[1:]))
        )
        low, high = two.blocks[1].vertices.min(0), two.blocks[1].vertices.max(0)
        where = rng.uniform(low[:2], high[:2])
        push = float(rng.uniform(-1.2, 1.2) * 16)
        stands = states.stands(frozenset({0, 1}), GROUND, Push(1, push, (where[0], where[1])))
        joint = states.stud_joint(0, 1)
        arm = where - (low + high)[:2] / 2
        force = np.array([0, 0, push + GRAVITY * two.blocks[1].mass])
        couple = np.array([arm[1] * push, -arm[0] * push, 0.0])
        # What presses within the faces is borne by them; a proof lets the knobs alone bear.
        low_face, high_face = np.array(joint.face)
        at_force = np.array([-couple[1], couple[0]]) / force[2]
        faces = force[2] > 0 and bool(((at_force > low_face) & (at_force < high_face)).all())
        assert holds(joint, force, couple) == (stands or faces), (size, under, at, push)
        kinds.add(stands)
    assert kinds == {True, False}


def balanced(points: np.ndarray, pull: float, middle: np.ndarray, load: np.ndarray) -> bool:
    """Whether pushes at some points, float64[k, 2], and a pull in their middle make a force up and
    a couple, float64[3]: by a linear program."""
    x, y = points.T
    made = np.array([np.ones(len(points)), y, -x])
    wanted = load + pull * np.array([1.0, middle[1], -middle[0]])
    return linprog(np.zeros(len(points)), A_eq=made, b_eq=wanted).status == 0


def test_faces_bear_what_presses_where_they_meet() -> None:
    rng, counts = np.random.default_rng(1), Counter[str]()
    joint = BrickStates(duplo(((2, 4), (0, 0, 0)), ((2, 4), (0, 2, 1)))).stud_joint(0, 1)
    low, high = joint.face
    corners = np.array([(x, y) for x in (low[0], high[0]) for y in (low[1], high[1])])
    knobs, middle = np.array(joint.hull), np.array(joint.middle)
    for _ in range(300):
        load = np.array([rng.uniform(-10, 60), *rng.uniform(-0.6, 0.6, 2)])
        by_knobs = balanced(knobs, joint.pull, middle, load)
        by_faces = balanced(corners, 0.0, middle, load)
        found = holds(joint, np.array([0.0, 0.0, load[0]]), np.array([*load[1:], 0.0]))
        assert found == (by_knobs or by_faces)
        # Both together bear more: what the simulation lets stand is on the safe side of that.
        assert not found or balanced(np.vstack([knobs, corners]), joint.pull, middle, load)
        counts["knobs" if by_knobs else "faces" if by_faces else "neither"] += 1
    assert min(counts[one] for one in ("knobs", "faces", "neither")) > 10


def test_what_one_joint_cannot_bear_the_others_do() -> None:
    """Two bricks side by side with one across, and a fourth pressed on the rim of the second: the
    ground bears it, but as all gives a little, the joints of the one across get more than they
    can."""
    four = duplo(((4, 2), (0, 0, 0)), ((4, 2), (0, 2, 0)), ((2, 2), (1, 1, 1)), ((2, 2), (0, 3, 1)))
    states = BrickStates(four)
    assert states.stands_pressed([3], frozenset({0, 1, 2}))
    scene = scene_of(four, states)
    assert scene.studs is not None
    joints = tuple(one._replace(home=one.upper != 3) for one in scene.studs.joints)
    target = scene.position[3].copy()
    waiting = scene.position.copy()
    waiting[3] += (0.0, -0.2, -0.0192)
    scene = scene._replace(position=waiting, num_placed=3, studs=Studs(joints, four.joint.press))
    hand = Attitude(yaw=np.pi / 2, depth=0.004)
    cell = DynamicCell(get_arm("panda", "gripper", (-0.5, 0, 0, 0)))
    found = cell.attempt(scene, Move(3, target, hand, hand))
    assert found.reached
    assert found.home is not None
    assert {(0, 2), (1, 2), (1, 3)} <= set(found.home)


@pytest.mark.parametrize("arm", ["panda", "ur5e"])
def test_an_arm_presses_bricks_home(arm: str) -> None:
    plan = l2a.build(EXAMPLES / "stair.txt", kit="duplo", arm=arm)
    assert plan.complete
    assert plan.arm is not None
    assert plan.arm.attempts <= 1.1 * 5
    assert (plan.arm.error_worst or 0.0) <= 5e-4
    assert plan.record is not None


@pytest.mark.parametrize(("aside", "home"), [(0.0005, True), (0.003, False)])
def test_what_misses_its_knobs_is_loose(aside: float, home: bool) -> None:
    two = duplo(((2, 2), (0, 0, 0)), ((2, 2), (0, 0, 1)))
    scene = scene_of(two, BrickStates(two))
    assert scene.studs is not None
    joints = tuple(one._replace(home=one.lower == GROUND) for one in scene.studs.joints)
    target = scene.position[1] + np.array((aside, 0.0, 0.0))
    waiting = scene.position + np.array([[0.0, 0.0, 0.0], [0.0, -0.2, -0.0192]])
    scene = scene._replace(position=waiting, num_placed=1, studs=Studs(joints, 20.0))
    hand = Attitude(depth=0.004)
    cell = DynamicCell(get_arm("panda", "gripper", (-0.5, 0, 0, 0)))
    found = cell.attempt(scene, Move(1, target, hand, hand))
    assert found.home is not None
    assert ((0, 1) in found.home) == home
    assert found.reached == home
    assert ("loose on its studs" in found.detail) != home


def test_joints_of_two_laws_are_refused() -> None:
    with pytest.raises(InputError, match="one clutch"):
        BrickStates(replace(LEVER, joint=replace(LEVER.joint, law="dry")))
