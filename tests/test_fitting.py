"""Where a block is aimed: between neighbours that are off, with room for those to come, and on a
table that is off, against figures worked out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from learn2assemble.acting.fitting import OPEN, STRAYS, Fitting, neighbours
from learn2assemble.assembly.blocks import Assembly
from learn2assemble.assembly.boxes import box_block
from learn2assemble.cell.pieces import pieces_of
from learn2assemble.cell.workcell import Job
from learn2assemble.cell.world import PLACED, SEEMS_FLAT, WorkcellBlocks
from learn2assemble.geometry.rotations import matrix_quaternion, quaternion_matrix, rotation_of
from learn2assemble.robot.arm import get_arm

EDGE, JOINT = 0.05, 1e-4
BASE = 0.3


def row(count: int) -> WorkcellBlocks:
    """Cubes in a row along x, a joint apart."""
    return cubes(*((k, 0) for k in range(count)))


def cubes(*cells: tuple[int, int]) -> WorkcellBlocks:
    """Cubes in cells of the table, a joint apart."""
    size, begins = EDGE - JOINT, [(BASE + x * EDGE, y * EDGE) for x, y in cells]
    blocks = [
        box_block(f"b{k}", (x, y, 0.0), (x + size, y + size, size))
        for k, (x, y) in enumerate(begins)
    ]
    assembly = Assembly(tuple(blocks))
    job = Job(pieces_of(assembly), (), assembly, get_arm("panda"), (), joint=JOINT)
    return WorkcellBlocks(job)


def stand(world: WorkcellBlocks, k: int, shift: float, spread: float = 0.0) -> None:
    world.pose[k] = world.target(k)
    world.pose[k, 0] += shift
    world.spread[k] = spread, spread


def aim(world: WorkcellBlocks, k: int, standing: set[int], coming: set[int]) -> float:
    """How far along x a block is aimed from its place [m]; nothing else of it changes."""
    goal, there = Fitting(world).goal(k, standing, coming), world.target(k)
    assert_allclose(goal[1:], there[1:], atol=1e-9)
    return float(goal[0] - there[0])


def test_what_is_known_exactly_and_in_its_place_moves_nothing() -> None:
    world = row(3)
    stand(world, 0, 0.0)
    assert aim(world, 1, {0}, {2}) == 0.0


@pytest.mark.parametrize("off", [3e-4, 1e-3, 1.5e-3])
def test_a_neighbour_that_stands_too_near_moves_a_block_by_the_least(off: float) -> None:
    world = row(2)
    stand(world, 0, off)
    assert_allclose(aim(world, 1, {0}, set()), off - JOINT / 2, rtol=2e-3)
    stand(world, 0, -off)
    assert aim(world, 1, {0}, set()) == 0.0


def test_a_slot_that_is_too_narrow_is_met_in_its_middle() -> None:
    world = row(3)
    stand(world, 0, 4e-4)
    stand(world, 2, -1e-4)
    assert_allclose(aim(world, 1, {0, 2}, set()), 1.5e-4, rtol=2e-2)


def test_what_is_not_known_exactly_leaves_room_to_those_that_come() -> None:
    """Of two blocks the first one gives way by half of what both joints of the other lack."""
    world = row(2)
    world.spread[0] = 1e-4, 1e-4
    size = math.hypot(PLACED, PLACED)
    lacks = OPEN * size - JOINT / 2
    # Least of 2 x² / STRAYS² + (lacks - 2 x)² / size².
    wanted = lacks * STRAYS**2 / (2 * STRAYS**2 + size**2)
    assert_allclose(aim(world, 0, set(), {1}), -wanted, rtol=1e-6)
    world = row(3)
    world.spread[1] = 1e-4, 1e-4
    assert_allclose(aim(world, 1, set(), {0, 2}), 0.0, atol=1e-9)


def test_a_corner_is_passed_on_the_side_that_is_free() -> None:
    """A block between two others, with a third one beside its corner, has nowhere to go but out of
    their row, and by what the third one asks for there."""
    world = cubes((0, 0), (0, 1), (0, -1), (1, -1))
    for k in (1, 2, 3):
        stand(world, k, 0.0)
    world.pose[3, :2] += [-2e-4, 3e-4]  # Its corner is past that of the block on both sides.
    goal = Fitting(world).goal(0, {1, 2, 3}, set()) - world.target(0)
    assert_allclose(goal[:2], [-(2e-4 - JOINT / 2), 0.0], atol=2e-6)
    # It may stand in the way on one side, as far as it is out of it on the other.
    world.pose[3, :2] = world.target(3)[:2] - np.array([2e-4, 3e-4])
    assert_allclose(Fitting(world).goal(0, {1, 2, 3}, set()), world.target(0), atol=1e-9)
    # Without the one behind, the shorter way is along the row.
    world.pose[3, :2] = world.target(3)[:2] - np.array([4e-4, -2e-4])
    goal = Fitting(world).goal(0, {2, 3}, set()) - world.target(0)
    assert_allclose(goal[:2], [0.0, 2e-4 - JOINT / 2], atol=2e-6)


def test_what_is_below_a_corner_or_past_it_is_no_neighbour() -> None:
    blocks = [
        box_block("low", (BASE, 0.0, 0.0), (BASE + 0.05, 0.05, 0.05)),
        box_block("high", (BASE + 0.0501, 0.0501, 0.05), (BASE + 0.1, 0.1, 0.1)),
        box_block("far", (BASE + 0.0801, 0.0801, 0.0), (BASE + 0.13, 0.13, 0.05)),
    ]
    assert not neighbours(pieces_of(Assembly(tuple(blocks))), 0)


def on(world: WorkcellBlocks, k: int, table: np.ndarray) -> np.ndarray:
    world.table = table
    pose = world.target(k)
    world.table = np.zeros(3)
    return pose


@pytest.mark.parametrize("table", [(2e-3, 0.0, 0.0), (-1e-3, 6e-3, -4e-3), (0.0, 0.0, 8e-3)])
def test_a_table_that_is_off_is_found_from_what_stands_on_it(
    table: tuple[float, float, float],
) -> None:
    world = row(6)
    for k in range(4):
        world.pose[k] = on(world, k, np.array(table))
        world.spread[k] = 1e-4, 3e-4
    found = Fitting(world).table(range(4))
    assert_allclose(found, table, atol=1e-4)
    world.table = found
    goal = Fitting(world).goal(5, {0, 1, 2, 3}, set())
    assert_allclose(goal, on(world, 5, np.array(table)), atol=1e-4)


def test_noise_of_what_stands_on_it_is_no_table() -> None:
    """False alarms: one in a thousand is expected; none that is large enough to matter."""
    rng, alarms = np.random.default_rng(0), 0
    world = row(6)
    fit = Fitting(world)
    for _ in range(300):
        for k in range(6):
            stand(world, k, 0.0)
            world.pose[k, 2] += 2e-4 * rng.normal()
            turn = rotation_of(1e-3 * rng.normal(size=3))
            world.pose[k, 3:] = matrix_quaternion(turn @ quaternion_matrix(world.pose[k, 3:]))
            world.spread[k] = 2e-4, 1e-3
        alarms += bool(fit.table(range(6)).any())
    assert alarms <= 3


def test_what_seems_to_lean_a_little_rests_on_its_face() -> None:
    world = row(1)
    stand(world, 0, 0.0)
    upright = world.pose[0].copy()
    for lean, rests in ((0.5 * SEEMS_FLAT, True), (2 * SEEMS_FLAT, False)):
        turn = rotation_of(np.array([0.6 * lean, 0.8 * lean, 0.0]))
        world.pose[0, 3:] = matrix_quaternion(turn @ quaternion_matrix(upright[3:]))
        lies = quaternion_matrix(world.resting(0)[3:])[2, 2]
        assert (lies > 1 - 1e-8) == rests
