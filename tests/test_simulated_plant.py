"""Simulated cells as plants: pictures, disturbances, guards, placing by touch."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from cell_shapes import wall
from learn2assemble.acting.belief import step_between
from learn2assemble.acting.carry_out import Workcell, carry_out, prepare, setup_of
from learn2assemble.assembly.kit import load_kit
from learn2assemble.design.cells import CellDesign
from learn2assemble.handling.execution import PRESSED
from learn2assemble.kinematics.chain import forward, get_chain
from learn2assemble.kinematics.inverse import solve
from learn2assemble.planning.plan import Plan
from learn2assemble.planning.tiling.construct import plan_cells
from learn2assemble.plants.plant import (
    Guard,
    Motion,
    PlantError,
    Report,
    Request,
    Stop,
    ToolCommand,
    standing,
)
from learn2assemble.plants.setup import BlockKind, Disturbance, Noise, Setup, Simulated
from learn2assemble.robot.arm import get_arm
from learn2assemble.robot.bodies import Part
from learn2assemble.robot.grasps import Attitude
from learn2assemble.simulation.disturbances import (
    PERIOD,
    Chances,
    Pictures,
    on_table,
    stretched,
)
from learn2assemble.simulation.kinematic_plant import KinematicPlant
from learn2assemble.simulation.plant import DynamicPlant, simulated

ARM = get_arm("panda", "suction")
BRICK = BlockKind((Part((0.0, 0.0, 0.0), (0.05, 0.025, 0.025)),), 600.0)
PLACE = np.array([0.1, -0.1, 0.025, 1.0, 0.0, 0.0, 0.0])
KIT = dataclasses.replace(load_kit("bricks-lintels"), pitch=(0.04, 0.04, 0.04))


def setup(physics: str = "dynamic", **told: object) -> Setup:
    kinds = {"a": BRICK, "b": BRICK}
    return Setup(ARM, kinds, {"a": PLACE}, simulated=Simulated(physics, **told))


# ---------------------------------------------------------------- what is seen


def test_pictures_differ_from_one_another_as_they_say() -> None:
    noise = Noise(5e-4, 3e-3, 1e-3)
    pictures = Pictures(Chances(Simulated(noise=noise, seed=4)))
    off = []
    for k in range(600):
        (one,) = pictures.look(k * PERIOD, {"a": PLACE})
        assert np.array_equal(one.covariance, pictures.covariance())
        off.append(step_between(PLACE, one.pose))
    spread = np.std(off, axis=0)
    assert np.allclose(spread, [5e-4, 5e-4, 1e-3, 3e-3, 3e-3, 3e-3], rtol=0.15)
    assert np.abs(np.mean(off, axis=0) / spread).max() < 4 / math.sqrt(600)


def test_who_looks_twice_at_once_sees_the_same() -> None:
    pictures = Pictures(Chances(Simulated(noise=Noise(5e-4, 3e-3))))
    one, two = (pictures.look(time, {"a": PLACE})[0].pose for time in (0.31, 0.39))
    assert np.array_equal(one, two)
    assert not np.array_equal(one, pictures.look(0.41, {"a": PLACE})[0].pose)


def test_readings_are_missing_late_and_far_off_as_often_as_asked() -> None:
    """A block that moves on by a metre from picture to picture, so that every reading shows of
    which one it is."""
    noise = Noise(1e-4, 1e-3, missing=0.2, outliers=0.1, late=0.15)
    pictures = Pictures(Chances(Simulated(noise=noise)))
    seen = []
    for k in range(1000):
        pose = PLACE.copy()
        pose[0] = k
        seen += [(k, one) for one in pictures.look(k * PERIOD, {"a": pose})]
    assert 0.75 < len(seen) / 1000 < 0.85
    shown = [round(float(one.pose[0])) for _, one in seen]
    # A reading says of which moment it is, and shows where the block was then.
    assert [round(one.time / PERIOD) for _, one in seen] == shown
    late = [k - then for (k, _), then in zip(seen, shown, strict=True)]
    assert set(late) == {0, 1}
    assert 0.12 < np.mean(late) < 0.18
    off = [
        math.hypot(one.pose[0] - then, one.pose[1] - PLACE[1])
        for (_, one), then in zip(seen, shown, strict=True)
    ]
    assert 0.07 < np.mean(np.array(off) > 0.01) < 0.13
    # Noise of readings that are not far off.
    assert np.quantile(off, 0.8) < 1e-3


def test_blocks_are_as_heavy_and_high_as_drawn_whatever_else_is_drawn() -> None:
    told = Disturbance(supply=(1e-3, 0.02), mass=0.1, height=3e-4)
    chances = Chances(Simulated(seed=7, disturbance=told))
    kind, pose = chances.block(BRICK, PLACE, 3)
    chances.block(BRICK, PLACE, 4)
    again, there = Chances(Simulated(seed=7, disturbance=told)).block(BRICK, PLACE, 3)
    assert kind == again
    assert np.array_equal(pose, there)
    higher = 2 * kind.shape[0].half[2] - 0.05
    assert 0 < abs(higher) <= 3e-4
    # It stands on the table all the same.
    assert math.isclose(pose[2], kind.shape[0].half[2])
    assert kind.shape[0].half[:2] == BRICK.shape[0].half[:2]
    two = (Part((-0.01, 0.0, 0.0), (0.01, 0.01, 0.01)), Part((0.01, 0.0, 0.0), (0.01, 0.01, 0.02)))
    longer = stretched(two, 0, 0.004)
    assert math.isclose(longer[1].centre[0] + longer[1].half[0], 0.022)
    assert math.isclose(longer[0].centre[0] + longer[0].half[0], 0.0, abs_tol=1e-12)


# ---------------------------------------------------------------- what it does


def over(height: float) -> np.ndarray:
    """Joints with the cup over the brick [m]."""
    found = solve(ARM, PLACE[:3] + np.array([0, 0, height]), Attitude().rotation(), ARM.home)
    assert found.ok
    return found.joints


def way(stage: str, start: np.ndarray, end: np.ndarray, seconds: float) -> Motion:
    share = np.linspace(0, 1, 21)[:, None]
    joints = start + (3 * share**2 - 2 * share**3) * (end - start)
    velocity = 6 * (share - share**2) * (end - start) / seconds
    return Motion(stage, seconds * share[:, 0], joints, velocity)


@pytest.mark.parametrize("physics", ["dynamic", "kinematic"])
def test_a_block_is_taken_up_and_set_down_by_touch(physics: str) -> None:
    plant = simulated(setup(physics))
    above, touching, low = over(0.1), over(0.025), over(0.02)
    assert plant.execute(way("approach", ARM.home, above, 2.0)).stop == Stop.END
    assert plant.execute(way("pick", above, touching, 1.0)).stop == Stop.END
    on = (ToolCommand(vacuum=True),)
    made = plant.execute(standing("pick", touching, 0.5), on, (Guard(hold="made"),))
    assert made.stop == Stop.HELD
    assert made.tool.vacuum
    kept = (Guard(hold="kept"),)
    assert plant.execute(way("lift", touching, above, 1.0), (), kept).stop == Stop.END
    (seen,) = plant.sense().blocks
    assert abs(seen.pose[2] - 0.1) < 1e-3
    # Down again, further than the table: it ends where the brick stands.
    down = way("place", above, low, 2.0)
    report = plant.execute(down, (), (Guard(hold="kept", contact=1.0, held=PRESSED),))
    assert report.stop == Stop.CONTACT
    assert 0.8 < report.done < 1
    off = (ToolCommand(vacuum=False),)
    assert not plant.execute(standing("release", report.joints, 0.3), off).tool.vacuum
    (seen,) = plant.sense().blocks
    assert np.abs(seen.pose[:3] - PLACE[:3]).max() < 1e-3


def holding() -> DynamicPlant:
    """A plant whose cup holds the brick over the table, standing still."""
    plant = DynamicPlant(setup()._replace(joints=over(0.025)))
    on = (ToolCommand(vacuum=True), ToolCommand(load=0.075))
    made = plant.execute(standing("pick", over(0.025), 0.5), on, (Guard(hold="made"),))
    assert made.stop == Stop.HELD
    assert plant.execute(way("lift", over(0.025), over(0.1), 1.0)).stop == Stop.END
    return plant


def pieces(run: Motion, span: float) -> list[Motion]:
    """A motion cut into pieces of so many seconds."""
    marks = np.arange(0.0, run.seconds + span / 2, span)
    q, v = run.at(marks)
    both = zip(q, q[1:], v, v[1:], strict=False)
    return [
        Motion(run.stage, np.array([0.0, span]), np.stack([a, b]), np.stack([c, d]))
        for a, b, c, d in both
    ]


def test_a_motion_may_be_told_piece_by_piece() -> None:
    """As a controller is told of it, cycle by cycle: the world goes the same way."""
    turned = over(0.1) + np.array([0.5, 0, 0, 0, 0, 0, 0])
    run, whole, cut = way("cross", over(0.1), turned, 2.0), holding(), holding()
    whole.execute(run, (ToolCommand(load=0.08),))
    speeds = []
    for k, piece in enumerate(pieces(run, 0.008)):
        told = () if k else (ToolCommand(load=0.08),)
        assert cut.execute(piece, told).stop == Stop.END
        speeds.append(np.abs(cut.measured()[1]).max())
    assert max(speeds) > 0.3
    assert np.abs(whole.measured()[0] - cut.measured()[0]).max() < 1e-5
    assert np.abs(whole.truth()["a"] - cut.truth()["a"]).max() < 2e-5
    assert whole.held() == cut.held() == "a"
    assert whole.bench.sim.drives.payload == cut.bench.sim.drives.payload == 0.08
    assert whole.time == pytest.approx(cut.time)


def test_an_arm_that_is_left_moving_brakes_when_it_is_stopped() -> None:
    plant = holding()
    turned = over(0.1) + np.array([0.5, 0, 0, 0, 0, 0, 0])
    for piece in pieces(way("cross", over(0.1), turned, 2.0), 0.008)[:125]:
        plant.execute(piece)
    before, speed = plant.measured()
    assert np.abs(speed).max() > 0.3
    plant.stop()
    after, speed = plant.measured()
    assert np.abs(speed).max() < 0.02  # It still swings a little.
    # As soon as its limits allow: no farther than it takes, and not at once.
    assert 0 < after[0] - before[0] < 0.05
    now = plant.time
    plant.stop()
    assert plant.time == now
    # The next motion begins where it stands, and the brick hangs on the cup.
    assert plant.held() == "a"
    assert plant.execute(way("cross", plant.where(), turned, 1.0)).stop == Stop.END


def test_what_a_cup_lets_go_that_stands_still_falls() -> None:
    """What hangs still is at rest, but not asleep in the air."""
    plant = holding()
    plant.execute(standing("cross", over(0.1), 3.0))
    assert plant.truth()["a"][2] == pytest.approx(0.1, abs=1e-3)
    off = (ToolCommand(vacuum=False), ToolCommand(load=0.0))
    plant.execute(standing("release", over(0.1), 1.0), off)
    assert plant.truth()["a"][2] == pytest.approx(0.025, abs=1e-3)
    # An empty cup that touches nothing feels nothing, whatever the brick lies on.
    assert plant.sense().tool.force == (0.0, 0.0, 0.0)


def tool_of(plant: DynamicPlant) -> np.ndarray:
    """float64[3]: where the tool truly is [m]."""
    return plant.bench.sim.tool()[0]


def zero_of(plant: DynamicPlant) -> np.ndarray:
    """float64[n]: by how much the zero of each encoder is off [rad]."""
    straying = plant.bench.sim.straying
    assert straying is not None
    return straying.zero


@pytest.mark.parametrize("seed", [1, 2])
def test_encoders_do_not_see_where_their_zero_is(seed: int) -> None:
    """The tool is off by what forward kinematics says of joints that are off."""
    told = Disturbance(tracking=(2e-3, 0.0))
    plant = DynamicPlant(setup(disturbance=told, seed=seed)._replace(joints=over(0.1)))
    chain, zero = get_chain(ARM), zero_of(plant)
    for goal in (over(0.1), over(0.15) + np.array([0.4, 0, 0, 0, 0, 0, 0])):
        plant.execute(way("cross", plant.where(), goal, 2.0))
        plant.execute(standing("cross", goal, 0.5))
        assert np.abs(plant.measured()[0] - goal).max() < 1e-4
        off = np.linalg.norm(tool_of(plant) - forward(chain, goal)[0])
        assert off > 3e-4
        assert np.linalg.norm(tool_of(plant) - forward(chain, goal + zero)[0]) < 1e-4
    again = DynamicPlant(setup(disturbance=told, seed=seed))
    assert np.array_equal(zero_of(again), zero)
    assert not np.array_equal(zero_of(DynamicPlant(setup(disturbance=told, seed=9))), zero)
    # Blocks that the other simulated cell moves are off by the same.
    kinematic = simulated(
        setup("kinematic", disturbance=told, seed=seed)._replace(joints=over(0.1))
    )
    assert isinstance(kinematic, KinematicPlant)
    assert np.array_equal(kinematic.straying.zero, zero)
    on = (ToolCommand(vacuum=True),)
    kinematic.execute(way("pick", over(0.1), over(0.025), 1.0), on)
    kinematic.execute(way("lift", over(0.025), over(0.1), 1.0))
    top = kinematic.truth()["a"][2] + 0.025
    assert top == pytest.approx(forward(chain, over(0.1) + zero)[0][2], abs=1e-4)
    assert np.array_equal(kinematic.sense().joints, over(0.1))


def test_joints_that_move_are_off_as_encoders_see_and_arrive() -> None:
    size = 0.02
    told = Disturbance(tracking=(0.0, size))
    turned = over(0.1) + np.array([0.6, 0, 0, 0, 0, 0, 0])
    run, off = way("cross", over(0.1), turned, 2.0), list[np.ndarray]()
    exact = DynamicPlant(setup()._replace(joints=over(0.1)))
    astray = DynamicPlant(setup(disturbance=told, seed=3)._replace(joints=over(0.1)))
    for piece in pieces(run, 0.008):
        exact.execute(piece)
        astray.execute(piece)
        off.append(np.abs(astray.measured()[0] - exact.measured()[0]))
    share = 0.45 / ARM.velocity[0]
    assert 0.1 * share * size < np.max(off) < 1.2 * share * size
    # Joints that stand are where they were told.
    assert np.max([one[1:] for one in off]) < 0.05 * np.max(off)
    astray.execute(standing("cross", turned, 0.5))
    assert np.abs(astray.measured()[0] - turned).max() < 0.02 * np.max(off)
    assert len({round(float(one[0]), 9) for one in off}) > 100


def test_a_cup_at_the_side_that_hangs_beside_another_block_does_not_take_its_place() -> None:
    """The nearest lip is the idle one; what the tool comes to is under the other."""
    arm, high = get_arm("panda", "suction-side"), 1.2e-3
    tall = BlockKind((Part((0.0, 0.0, 0.0), (0.02, 0.02, 0.06)),), 600.0)

    def at(height: float) -> np.ndarray:
        found = solve(arm, PLACE[:3] + np.array([0, 0, height]), Attitude().rotation(), arm.home)
        assert found.ok
        return found.joints

    assert arm.suction is not None
    lip, turn = arm.suction.cups[1].lip, Attitude().rotation()
    beside = (
        PLACE[:3] + np.array([0, 0, 0.025]) + turn @ (np.array(lip.at) + 0.021 * np.array(lip.axis))
    )
    other = np.array([*beside[:2], 0.06, 1.0, 0.0, 0.0, 0.0])
    plant = simulated(Setup(arm, {"a": BRICK, "b": tall}, {"a": PLACE, "b": other}))
    above, touching = at(0.1), at(0.025 + high)
    assert plant.execute(way("approach", arm.home, above, 2.0)).stop == Stop.END
    assert plant.execute(way("pick", above, touching, 1.0)).stop == Stop.END
    on = (ToolCommand(vacuum=True),)
    made = plant.execute(standing("pick", touching, 0.5), on, (Guard(hold="made"),))
    assert made.stop == Stop.HELD
    kept = (Guard(hold="kept"),)
    assert plant.execute(way("lift", touching, above, 1.0), (), kept).stop == Stop.END
    seen = {one.block: one.pose for one in plant.sense().blocks}
    assert abs(seen["a"][2] - 0.1) < 2e-3
    assert np.abs(seen["b"][:3] - other[:3]).max() < 1e-3


@pytest.mark.parametrize("physics", ["dynamic", "kinematic"])
def test_a_vacuum_on_nothing_is_not_made(physics: str) -> None:
    plant = simulated(setup(physics))
    on = (ToolCommand(vacuum=True),)
    report = plant.execute(standing("pick", ARM.home, 0.5), on, (Guard(hold="made"),))
    assert report.stop == Stop.END
    assert report.tool.vacuum is False


def test_what_is_in_the_way_stops_the_arm() -> None:
    plant = simulated(setup())
    above, into = over(0.1), over(0.0)
    plant.execute(way("approach", ARM.home, above, 2.0))
    report = plant.execute(way("cross", above, into, 2.0), (), (Guard(force=0.5, taken=5.0),))
    assert report.stop == Stop.FORCE
    assert "touches a" in report.detail or "touches block" in report.detail
    assert report.done < 1
    assert np.abs(report.joints - plant.where()).max() == 0


@pytest.mark.parametrize("physics", ["dynamic", "kinematic"])
def test_motions_and_requests_that_cannot_be_are_refused(physics: str) -> None:
    plant = simulated(setup(physics))
    with pytest.raises(PlantError, match="rad from where the arm is"):
        plant.execute(standing("home", ARM.home + 0.1, 0.1))
    with pytest.raises(PlantError, match="7 joints"):
        plant.execute(standing("home", np.zeros(6), 0.1))
    for what, name in (("present", "a"), ("place it", "b"), ("join", "b")):
        assert plant.request(Request(what, name, "a", PLACE)).stop == Stop.REFUSED
    assert plant.request(Request("return", "a", "a", PLACE)).stop == Stop.END
    assert plant.sense().blocks == ()


# ---------------------------------------------------------------- placing by touch


def test_blocks_rest_on_the_table_where_that_is() -> None:
    told = Disturbance(table=(2e-3, math.radians(0.5)))
    plants = (simulated(setup(disturbance=told, seed=seed)) for seed in range(9))
    plant = next(one for one in plants if abs(one.table[2]) > 1e-3)
    before = plant.sense().blocks[0].pose
    assert np.abs(step_between(on_table(plant.table, PLACE), before)).max() < 1e-9
    assert abs(before[2] - PLACE[2]) > 5e-4
    plant.request(Request("place", "a", "a", PLACE))
    after = plant.sense().blocks[0].pose
    assert np.abs(step_between(before, after)).max() < 2e-4


@pytest.fixture(scope="module")
def low() -> Plan:
    cells = wall(4, 1, 2)
    plan = plan_cells(CellDesign("wall", cells, KIT.pitch, None, 0.0, None, "", None), KIT)
    assert plan.complete
    return plan


@pytest.mark.parametrize("seed", [0, 1])
def test_a_table_that_is_off_is_met_gently(low: Plan, seed: int) -> None:
    told = Disturbance(table=(2e-3, math.radians(0.5)), height=3e-4)
    noise = Noise(5e-4, math.radians(0.2), 5e-4)
    at = Workcell("ur5e", "suction", seed=seed, noise=noise, disturbance=told)
    found = prepare(low, at, KIT.joint_gap)
    plant = DynamicPlant(setup_of(found.job, at))
    assert np.abs(plant.table[:3]).max() > 1e-4
    plan = carry_out(low, at, found=found, plant=plant)
    assert plan.complete, plan.reason
    assert 0 < plant.hardest <= PRESSED


def test_a_table_that_is_not_there_is_said_to_be_missing(low: Plan) -> None:
    at = Workcell("ur5e", "suction")
    found = prepare(low, at, KIT.joint_gap)
    plant = DynamicPlant(setup_of(found.job, at))
    plant.table[2] = -8e-3
    plan = carry_out(low, at, found=found, plant=plant)
    assert plan.status == "incomplete"
    assert plan.arm is not None
    assert plan.arm.failures[0].outcome == "no-contact"
    assert "nothing is met 4 mm below the place" in plan.arm.failures[0].detail
    assert not plan.steps


def test_a_cup_that_has_come_off_holds_the_next_block(
    low: Plan, monkeypatch: pytest.MonkeyPatch
) -> None:
    at = Workcell("ur5e", "suction")
    found = prepare(low, at, KIT.joint_gap)
    plant = DynamicPlant(setup_of(found.job, at))
    execute, torn = plant.execute, list[str]()

    def tear(motion: Motion, *told: Any) -> Report:
        cup = plant.bench.sim.cup
        if motion.stage == "cross" and not torn and cup.held is not None:
            cup.lost = "torn off"
            cup._let_go()
            torn.append(motion.stage)
        return execute(motion, *told)

    monkeypatch.setattr(plant, "execute", tear)
    plan = carry_out(low, at, found=found, plant=plant)
    assert torn
    assert plan.complete, plan.reason
    assert plan.arm is not None
    assert [failure.outcome for failure in plan.arm.failures] == ["grasp-lost"]


def test_nothing_moves_when_a_block_is_taken_out_of_the_hand() -> None:
    """All blocks would be free for a while: of a hundred, that takes minutes."""
    plant = holding()
    assert plant.held() == "a"
    began = plant.time
    assert plant.request(Request("remove", "a", "a", PLACE)).stop is Stop.END
    assert plant.held() is None
    assert plant.time == began
    assert not plant.truth()
    # What stands by itself is given the time to fall.
    assert plant.request(Request("place", "a", "a", PLACE)).stop is Stop.END
    assert plant.request(Request("remove", "a", "a", PLACE)).stop is Stop.END
    assert plant.time > began
