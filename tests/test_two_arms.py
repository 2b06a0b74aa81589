"""Two arms in one simulated world: one clock, one state, and each its own plant."""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import pytest

from learn2assemble.motion.plant import Guard, Motion, Report, Stop, ToolCommand, standing
from learn2assemble.motion.setup import BlockKind, Setup
from learn2assemble.robot.arm import Arm, get_arm
from learn2assemble.robot.bodies import Part
from learn2assemble.robot.grasps import Attitude
from learn2assemble.robot.inverse import solve
from learn2assemble.simulation.clock import SharedClock
from learn2assemble.simulation.plant import DynamicPlant

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
        loads.append(np.hstack(cup.load()))
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
