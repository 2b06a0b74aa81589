"""Joints that hold: the balance of bricks that clutch, and of mortar.

Joints of studs in the simulation, against loads worked out by hand and by another program.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import clarabel
import numpy as np
import pytest
import scipy.sparse as sp
from scipy.optimize import linprog

import brick_data
import learn2assemble as l2a
from brick_data import DUPLO, LEGO, PUBLISHED, bricks, duplo, random_bricks, scene_of
from learn2assemble.assembly.blocks import Assembly
from learn2assemble.assembly.boxes import box_block
from learn2assemble.assembly.bricks.lattice import GROUND, StudLattice, grip
from learn2assemble.assembly.joints import Joint, JointOf
from learn2assemble.cell.bricks import BrickStates
from learn2assemble.constants import GRAVITY
from learn2assemble.errors import InputError
from learn2assemble.handling.dynamic_cell import DynamicCell
from learn2assemble.robot.arm import get_arm
from learn2assemble.robot.grasps import Attitude
from learn2assemble.robot.moves import Move
from learn2assemble.robot.studs import Studs
from learn2assemble.simulation.clutch import holds
from learn2assemble.statics import rigid_blocks
from learn2assemble.statics.holding.check import stands_by_joints
from learn2assemble.statics.holding.forces import Columns, forces_of
from learn2assemble.statics.holding.program import Balance, Push, balance_of
from learn2assemble.statics.rigid_blocks import FALLS, STANDS, TIGHT, check

_conic: Any = clarabel
"""A compiled module without types."""
DESIGNS = brick_data.designs()
PITCH = 0.008


@pytest.mark.parametrize("name", [n for n, d in DESIGNS.items() if d["verdict"]])
def test_published_verdicts(name: str) -> None:
    found = check(brick_data.design(name).with_capacity(PUBLISHED))
    assert (found.verdict != FALLS) == (DESIGNS[name]["verdict"] == "stands")
    assert found.margin_n is not None
    assert (found.margin_n >= 0) == (found.verdict != FALLS)


# ---------------------------------------------------------------- another program


def points_of(joint: tuple[int, int, int, int, int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Contact points of a joint [studs from the upper brick] with the share of a point each has:
    written down again, a knob at a time."""
    x, y, u, v, a, b = joint
    spots, weights = [], []
    for i in range(x, x + u):
        for j in range(y, y + v):
            middle = np.array([i + 0.5, j + 0.5])
            if min(a, b) == 1:
                local = [(0.25, 0), (-0.25, 0), (0, 0.25), (0, -0.25)]
                spots += [middle + p for p in local]
                weights += [1.0] * 4
                continue
            # The wall is on the side of the brick that is nearer; the tubes are on the other.
            turned = []
            if a <= b:
                way = -1 if i + 0.5 < a / 2 else 1
                turned.append([(0.25 * way, 0), (-0.125 * way, -0.125), (-0.125 * way, 0.125)])
            if b <= a:
                way = -1 if j + 0.5 < b / 2 else 1
                turned.append([(0, 0.25 * way), (-0.125, -0.125 * way), (0.125, -0.125 * way)])
            for triangle in turned:
                spots += [middle + p for p in triangle]
                weights += [1.0 / len(turned)] * 3
    return np.array(spots), np.array(weights)


def least_capacity(assembly: Assembly, sides: bool) -> float:
    """The least capacity by the published program: every point pushes (n) or pulls (f <= T).

    Another solver, by interior points; rows and columns are made here.
    """
    lattice = StudLattice(assembly.blocks, assembly.joint.pitch)
    joints = lattice.clutches(ground=True)
    centre = np.array([b.centroid for b in assembly.blocks])
    count = len(centre)
    entries: list[tuple[int, int, float]] = []
    lower: list[bool] = []
    limits: list[tuple[int, float]] = []

    def add(a: int, b: int, at: np.ndarray, force, couple=(0, 0, 0), bounded: bool = True) -> int:
        for body, sign in ((b, 1.0), (a, -1.0)):
            if body != GROUND:
                wrench = np.concatenate([force, np.cross(at - centre[body], force) + couple])
                scale = np.array([1, 1, 1, 1 / PITCH, 1 / PITCH, 1 / PITCH])
                entries.extend(
                    (6 * body + r, len(lower), sign * w) for r, w in enumerate(wrench * scale) if w
                )
        lower.append(bounded)
        return len(lower) - 1

    height = assembly.joint.pitch[1]
    for a, b, first, last, layer in zip(*(f.tolist() for f in joints), strict=True):
        low, size = lattice.low[b], lattice.size[b]
        spots, weights = points_of((
            first[0] - low[0], first[1] - low[1], last[0] - first[0], last[1] - first[1],
            size[0], size[1],
        ))  # fmt: skip
        for spot, weight in zip(spots, weights, strict=True):
            at = np.array([*(low[:2] + spot) * PITCH + lattice.offset[:2], layer * height])
            add(a, b, at, np.array([0, 0, 1.0]))
            limits.append((add(a, b, at, np.array([0, 0, -1.0])), weight))
        middle = (np.array(first) + last) / 2 * PITCH + lattice.offset[:2]
        at = np.array([*middle, layer * height])
        for k in range(2):
            add(a, b, at, np.eye(3)[k], bounded=False)
        if len(spots) // (4 if min(size[:2]) == 1 else 3) > 1:
            add(a, b, at, np.zeros(3), PITCH * np.eye(3)[2], bounded=False)
    if sides:
        beside = lattice.sides()
        for a, b, axis, low, high in zip(*(f.tolist() for f in beside), strict=True):
            unit = np.array([PITCH, PITCH, height])
            for i in (0, 1):
                for j in (0, 1):
                    corner = np.array(low, float)
                    corner[1 - axis] = (low, high)[i][1 - axis]
                    corner[2] = (low, high)[j][2]
                    at = corner * unit + [*lattice.offset[:2], 0]
                    add(a, b, at, np.eye(3)[axis])
    columns = len(lower)
    row, column, value = map(np.array, zip(*entries, strict=True))
    balance = sp.csc_matrix((value, (row, column)), (6 * count, columns + 1))
    rest = np.zeros((count, 6))
    unit = 1e-3 * GRAVITY
    rest[:, 2] = [b.mass * GRAVITY / unit for b in assembly.blocks]
    some = np.flatnonzero(lower)
    signs = sp.csc_matrix(
        (-np.ones(len(some)), (np.arange(len(some)), some)), (len(some), columns + 1)
    )
    pulls, most = zip(*limits, strict=True)
    caps = sp.csc_matrix(
        (
            np.concatenate([np.ones(len(pulls)), -np.array(most)]),
            (
                np.tile(np.arange(len(pulls)), 2),
                np.concatenate([pulls, np.full(len(pulls), columns)]),
            ),
        ),
        (len(pulls), columns + 1),
    )
    matrix = sp.csc_matrix(sp.vstack([balance, signs, caps]))
    bound = np.concatenate([rest.reshape(-1), np.zeros(len(some) + len(pulls))])
    cost = np.zeros(columns + 1)
    cost[-1] = 1
    settings = _conic.DefaultSettings()
    settings.verbose = False
    cones = [_conic.ZeroConeT(6 * count), _conic.NonnegativeConeT(len(some) + len(pulls))]
    answer = _conic.DefaultSolver(
        sp.csc_matrix((columns + 1, columns + 1)), cost, matrix, bound, cones, settings
    ).solve()
    assert str(answer.status) == "Solved"
    return float(answer.x[-1]) * unit


@pytest.mark.parametrize("seed", range(12))
def test_the_preload_needs_what_the_published_program_needs(seed: int) -> None:
    assembly = bricks(*random_bricks(seed, 4 + 2 * seed))
    for sides in (False, True):
        need = balance_of(assembly, sides).need()
        assert need.share * 0.7 == pytest.approx(
            least_capacity(assembly, sides), rel=1e-4, abs=1e-6
        )


@pytest.mark.parametrize("name", ["stair_20", "apex_rss", "109567d7"])
def test_the_preload_needs_it_in_designs_too(name: str) -> None:
    assembly = brick_data.design(name)
    assert balance_of(assembly).need().share * 0.7 == pytest.approx(
        least_capacity(assembly, False), rel=1e-4
    )


def test_many_blocks_are_answered_by_interior_points_alike(monkeypatch: pytest.MonkeyPatch) -> None:
    assembly = brick_data.design("apex_rss")
    simplex = balance_of(assembly).need()
    monkeypatch.setattr("learn2assemble.statics.holding.program._MANY", 0)
    points = balance_of(assembly).need()
    assert points.share == pytest.approx(simplex.share, rel=1e-5)


# ---------------------------------------------------------------- by hand


def test_a_lever_by_hand() -> None:
    """A 1x8 that two knobs hold at its end tips about the outer point of the second."""
    beam = bricks(((1, 1), (0, 0, 0)), ((1, 1), (1, 0, 0)), ((8, 1), (0, 0, 1)))
    # From the outermost point at 1.75 studs, the points of the knobs are at these distances.
    arms = [1.0, 1.5, 1.25, 1.25, 0.0, 0.5, 0.25, 0.25]
    least = 3.03e-3 * GRAVITY * (4 - 1.75) / sum(arms)
    supported = replace(
        beam, blocks=tuple(replace(b, support=k < 2) for k, b in enumerate(beam.blocks))
    )
    assert balance_of(supported).need().share * 0.7 == pytest.approx(least)
    above, below = (check(supported.with_capacity(f * least)) for f in (1.001, 0.999))
    assert (above.verdict, below.verdict) == (STANDS, FALLS)
    assert above.margin_n == pytest.approx(0.001 * least, rel=1e-3)
    assert below.moving == ("b3",)


def test_a_hanging_brick_by_hand() -> None:
    """A 2x4 under a 2x4 that stands on a tower hangs on the points of its knobs."""
    model = bricks(
        ((2, 2), (0, 0, 0)),
        ((2, 2), (0, 0, 1)),
        ((2, 4), (0, 0, 2)),
        ((2, 2), (0, 2, 1)),
    )
    held = np.array([False, False, True, False])
    need = balance_of(model).need(held=held)
    # Four knobs of three points each; the pull of the lower brick is in the middle of them.
    assert need.share * 0.7 * 12 == pytest.approx(1.15e-3 * GRAVITY)


def test_a_press_is_a_load() -> None:
    model = bricks(((2, 4), (0, 0, 0)), ((2, 4), (0, 3, 1)))
    balance = balance_of(model)
    there, nobody = np.ones(2, bool), np.zeros(2, bool)
    x, y, _ = model.blocks[1].centroid
    over = model.blocks[1].vertices[:, 1].min() + PITCH / 2
    assert balance.stands(there, nobody)
    assert balance.stands(there, nobody, Push(1, 10.0, (x, over)))
    assert not balance.stands(there, nobody, Push(1, 10.0, (x, y)))
    assert balance.stands(there, np.array([False, True]), Push(1, 10.0, (x, y)))
    # Six points of the two knobs pull it down against a lift of less than their capacity.
    assert balance.stands(there, nobody, Push(1, -6 * 0.5, (x, over)))
    assert not balance.stands(there, nobody, Push(1, -6 * 0.75, (x, over)))


def test_the_contact_points_of_a_joint() -> None:
    narrow = grip(0, 0, 2, 1, (4, 1))
    assert narrow.pull == pytest.approx(8)
    assert narrow.middle == pytest.approx((1.0, 0.5))
    wide = grip(0, 0, 2, 2, (2, 4))
    assert wide.pull == pytest.approx(12)
    assert wide.middle == pytest.approx((1.0, 1.0))
    assert wide.corners.min(0) == pytest.approx([0.25, 0.375])
    square = grip(0, 0, 1, 1, (2, 2))
    assert square.pull == pytest.approx(3)


# ---------------------------------------------------------------- what must not matter

TURNS = [np.array(m) for m in (
    [[0, -1], [1, 0]], [[-1, 0], [0, -1]], [[-1, 0], [0, 1]], [[0, 1], [1, 0]],
)]  # fmt: skip


@pytest.mark.parametrize("turn", TURNS)
def test_turns_and_mirrors_do_not_matter(turn: np.ndarray) -> None:
    given = random_bricks(5, 20)
    ends = [np.array([[x, y], [x + a, y + b]]) @ turn.T for (a, b), (x, y, _) in given]
    turned = [
        ((int(np.ptp(e[:, 0])), int(np.ptp(e[:, 1]))), (int(e[:, 0].min()), int(e[:, 1].min()), z))
        for e, (_, (_, _, z)) in zip(ends, given, strict=True)
    ]
    first, second = (balance_of(bricks(*one)).need().share for one in (given, turned))
    assert first == pytest.approx(second, rel=1e-6)


def test_order_and_place_do_not_matter() -> None:
    given = random_bricks(6, 20)
    order = np.random.default_rng(0).permutation(len(given))
    moved = [
        (given[k][0], (given[k][1][0] - 31, given[k][1][1] + 7, given[k][1][2])) for k in order
    ]
    shares = [balance_of(bricks(*one)).need().share for one in (given, moved)]
    assert shares[0] == pytest.approx(shares[1], rel=1e-6)
    off = bricks(*given)
    shifted = tuple(
        replace(b, vertices=b.vertices + np.array([0.0031, -0.0017, 0])) for b in off.blocks
    )
    assert balance_of(replace(off, blocks=shifted)).need().share == pytest.approx(shares[0])


@pytest.mark.parametrize("seed", range(6))
def test_without_capacity_it_is_dry(seed: int) -> None:
    assembly = bricks(*random_bricks(seed, 8))
    dry = check(replace(assembly, joint=Joint()))
    assert check(assembly.with_capacity(0.0)).verdict == dry.verdict


def test_more_capacity_never_falls() -> None:
    assembly = brick_data.design("stair_20")
    verdicts = [check(assembly.with_capacity(c)).verdict for c in (0.5, 0.9, 0.98, 0.99, 5.0)]
    assert verdicts == [FALLS, FALLS, FALLS, STANDS, STANDS]


# ---------------------------------------------------------------- check


def test_forces_of_check_balance_the_bricks() -> None:
    assembly = brick_data.design("apex_fish_high")
    found = stands_by_joints(assembly)
    balance, need = found.balance, found.need
    centre = np.array([b.centroid for b in assembly.blocks])
    rest = np.zeros((len(centre), 6))
    rest[:, 2] = [-b.mass * GRAVITY for b in assembly.blocks]
    for columns, size in (
        (balance.columns, need.forces),
        (balance.preload, np.full(len(balance.preload.b), need.share)),
    ):
        for body, sign in ((columns.b, 1), (columns.a, -1)):
            on = body >= 0
            force = sign * size[on, None] * columns.force[on]
            couple = sign * size[on, None] * columns.couple[on]
            arm = columns.at[on] - centre[body[on]]
            np.add.at(rest, body[on], np.concatenate([force, np.cross(arm, force) + couple], 1))
    assert np.abs(rest[:, :3]).max() < 1e-6
    assert np.abs(rest[:, 3:]).max() < 1e-8
    shown = check(assembly)
    assert shown.forces.shape == shown.contacts.points.shape
    assert (found.need.forces[columns_that_push(balance)] > -1e-9).all()


def columns_that_push(balance: Balance) -> np.ndarray:
    return balance.columns.lower == 0


def test_side_faces_that_have_to_push_are_told() -> None:
    """A fish needs 0.42 N at a point, or 0.014 N where its bricks also push side by side."""
    fish = brick_data.design("apex_fish_high")
    verdicts = [check(fish.with_capacity(c)).verdict for c in (0.01, 0.3, 0.5)]
    assert verdicts == [FALLS, TIGHT, STANDS]


def test_margins_in_g_grow_with_capacity_and_tip_by_hand() -> None:
    tower = bricks(((2, 2), (0, 0, 0)), *[((2, 2), (0, 0, z)) for z in range(1, 9)])
    weak = tower.with_capacity(0.02)
    dry = check(replace(tower, joint=Joint(), friction=5.0))
    table = check(replace(tower, joint=replace(LEGO.joint, base="table"), friction=5.0))
    # The tower is one piece on a table: it tips about an edge as a block does, 1 stud over 4.5
    # bricks of 1.2 studs.
    assert table.margin_g == pytest.approx(1 / (4.5 * 1.2), rel=0.02)
    assert table.margin_g >= dry.margin_g - 1e-6
    grips = check(weak)
    assert grips.margin_g > table.margin_g
    assert check(tower.with_capacity(0.04)).margin_g > grips.margin_g
    assert grips.tilt == pytest.approx(np.degrees(np.arctan(grips.margin_g)))


def test_a_table_does_not_hold_down() -> None:
    stair = bricks(((2, 4), (0, 0, 0)), ((2, 4), (0, 3, 1)), ((2, 4), (0, 6, 2)))
    assert check(stair).verdict == STANDS
    on_table = replace(stair, joint=replace(stair.joint, base="table"))
    found = check(on_table)
    assert found.verdict == FALLS
    assert found.margin_n is None
    assert "however strong" in found.proof


def test_what_hangs_on_nothing_falls() -> None:
    found = check(bricks(((2, 4), (0, 0, 0)), ((2, 4), (9, 9, 3))))
    assert found.verdict == FALLS
    assert found.moving == ("b2",)


def test_bricks_off_the_lattice_or_in_each_other_are_refused() -> None:
    whole = bricks(((2, 4), (0, 0, 0)), ((2, 4), (0, 2, 1)))
    for move, words in (([0.003, 0, 0], "off the lattice"), ([0, 0, -0.0064], "overlap")):
        blocks = (
            whole.blocks[0],
            replace(whole.blocks[1], vertices=whole.blocks[1].vertices + move),
        )
        with pytest.raises(InputError, match=words):
            check(replace(whole, blocks=blocks))
    wedge = replace(
        whole.blocks[1], vertices=whole.blocks[1].vertices * [1, 1, 1] + np.eye(8, 3) * 1e-3
    )
    with pytest.raises(InputError, match="another shape"):
        check(replace(whole, blocks=(whole.blocks[0], wedge)))
    with pytest.raises(InputError, match="whose joints clutch"):
        replace(whole, joint=Joint()).with_capacity(1.0)


# ---------------------------------------------------------------- several laws


def bracket(length: float, joint: Joint) -> Assembly:
    """A block of 0.1 x 0.2 m, glued to the side of a support, that sticks out by ``length``."""
    wall = box_block("wall", (-0.2, 0, 0), (0, 0.1, 1), support=True)
    arm = box_block("arm", (0, 0, 0.5), (length, 0.1, 0.7), density=2000.0)
    return Assembly((wall, arm), joint=joint)


def test_mortar_bends_and_shears_by_hand() -> None:
    """M = W l / 2 <= tensile b d² / 6, W <= shear b d."""
    width, depth, length = 0.1, 0.2, 0.5
    weight = 2000 * width * depth * length * GRAVITY
    tensile = weight * length / 2 / (width * depth**2 / 6)
    for factor, verdict in ((1.02, STANDS), (0.98, FALLS)):
        joint = Joint("mortar", tensile=factor * tensile, shear=1e9)
        assert check(replace(bracket(length, joint), friction=0.0)).verdict == verdict
    shear = weight / (width * depth)
    for factor, verdict in ((1.01, STANDS), (0.99, FALLS)):
        joint = Joint("mortar", tensile=1e9, shear=factor * shear)
        assert check(replace(bracket(length, joint), friction=0.0)).verdict == verdict
    assert check(bracket(length, Joint())).verdict == FALLS


def test_a_law_may_be_of_two_blocks_or_of_a_kind() -> None:
    tree = bricks(((2, 2), (0, 0, 0)), ((2, 4), (0, 1, 1)), ((2, 4), (0, 4, 2)))
    assert check(tree).verdict == STANDS
    dry = replace(tree, joints=(JointOf(Joint(), blocks=("b2", "b3")),))
    found = check(dry)
    assert found.verdict == FALLS
    assert "b3" in found.moving
    other = replace(
        tree, joints=(JointOf(Joint(), blocks=("b1", "b2")), JointOf(tree.joint, kind="2x4"))
    )
    # The joint of two kinds is dry, that of two 2x4 clutches: b2 and b3 fall as one.
    assert check(other).verdict == FALLS
    assert set(check(other).moving) == {"b2", "b3"}
    same = replace(
        tree,
        joint=Joint(),
        joints=(
            JointOf(tree.joint, kind="2x4"),
            JointOf(tree.joint, kind="2x2"),
            JointOf(tree.joint, blocks=("b1", "b2")),
        ),
    )
    assert balance_of(same).need().share == pytest.approx(balance_of(tree).need().share, rel=1e-6)
    with pytest.raises(InputError, match="the id of a block"):
        replace(tree, joints=(JointOf(Joint(), blocks=("b1", "b9")),))


def test_dry_assemblies_do_not_come_here(monkeypatch: pytest.MonkeyPatch) -> None:
    def never(*_: object) -> None:
        raise AssertionError

    monkeypatch.setattr(rigid_blocks, "stands_by_joints", never)
    assert check(Assembly((box_block("a", (0, 0, 0), (1, 1, 1)),))).verdict == STANDS


def test_faces_side_by_side_are_left_out_only_where_they_cannot_help() -> None:
    told = {True: 0, False: 0}
    for seed in range(60):
        tree = bricks(*random_bricks(seed, 6 + seed % 25))
        forces = forces_of(tree)
        alone = Balance(tree, forces)
        need = alone.need()
        if need.stands or forces.upright.all():
            continue
        beside = Columns(*(field[~forces.upright] for field in forces.columns))
        could = alone.lessened_by(beside)
        more = Balance(tree, forces, sides=True).need()
        assert could or more.share == pytest.approx(need.share, rel=1e-6)
        told[could] += 1
    assert min(told.values()) > 2


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
