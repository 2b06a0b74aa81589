"""The dynamic cell: outcomes of simulated pick and place, trajectories within limits."""

from __future__ import annotations

import dataclasses
from itertools import pairwise
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from learn2assemble.benchmark import build_wall
from learn2assemble.errors import InputError, SimulationDivergedError
from learn2assemble.handling.dynamic_cell import DynamicCell, ExactSenses
from learn2assemble.handling.execution import Execution, Rig
from learn2assemble.handling.prepare import prepare
from learn2assemble.handling.rest import ONE_SIDED, ShiftRule, check_rest
from learn2assemble.handling.ways import WorldChecker
from learn2assemble.kinematics.chain import forward, get_chain
from learn2assemble.robot.arm import Arm, get_arm
from learn2assemble.robot.grasps import Attitude, get_grasps
from learn2assemble.robot.moves import (
    OPENING,
    STAGES,
    Attempt,
    Failure,
    Move,
    Outcome,
    Scene,
    Trajectory,
    put_down,
)
from learn2assemble.simulation.drives import Drives
from learn2assemble.simulation.model import TIMESTEP
from learn2assemble.simulation.objects import take_order
from learn2assemble.simulation.simulation import SimulatedState, Simulation, Trace
from robot_scenes import GROUND, PITCH, cell, scene

AA, AB, BA, BB = get_grasps("paper")
PANDA = get_arm("panda")


ONE = scene([(0, 0, 0)], [(0, -4, 0)])
"""A block on the ground, and one that waits."""
ON_TOP = Move(1, cell(0, 0, 1), *AA)


@pytest.fixture(scope="module")
def panda() -> DynamicCell:
    return DynamicCell(PANDA)


@pytest.fixture(scope="module")
def moved(panda: DynamicCell) -> Attempt:
    return panda.attempt(ONE, ON_TOP)


def failed(found: Attempt) -> tuple[Outcome, str]:
    assert found.detail
    assert "\n" not in found.detail
    return found.outcome, found.stage


def assert_within_limits(arm: Arm, run: Trajectory) -> None:
    """By finite differences of what was commanded, at any rate of sampling."""
    step = np.diff(run.time)[:, None]
    assert np.allclose(step, step[0])
    velocity = np.diff(run.joints, axis=0) / step
    acceleration = np.diff(run.velocity, axis=0) / step
    jerk = np.diff(run.velocity, 2, axis=0) / step[1:] ** 2
    pairs = (
        (velocity, arm.velocity),
        (run.velocity, arm.velocity),
        (acceleration, arm.acceleration),
        (jerk, arm.jerk),
    )
    for found, limit in pairs:
        assert (np.abs(found) <= limit * (1 + 1e-4)).all()
    assert arm.inside_limits(run.joints).all()


# ---------------------------------------------------------------- ways


def test_a_way_home_is_sought_anew_where_a_block_is_in_it(panda: DynamicCell) -> None:
    far = scene([(0, 0, 0)], [(0, -4, 0), (0, 6, 0)])
    order = take_order(far, Move(1, cell(2, 0, 0), *AA))
    world = panda.world(order.objects)
    course = prepare(PANDA, world, order, None, True)
    above = course.home[0]
    state = SimulatedState(world, order.poses, order.names)
    sim = Simulation(state, PANDA, above, OPENING, order.target, Trace())
    known = ExactSenses(sim, order, False)
    rig = Rig(known, known, PANDA, world, panda.limits, panda.loaded)
    run = Execution(rig, order, course, above)
    np.testing.assert_array_equal(run.checked(course.home, "home"), course.home)
    middle = forward(get_chain(PANDA), (course.home[0] + course.home[-1]) / 2)[0]
    sim.poses[2, :3] = middle
    there = WorldChecker(PANDA, world, sim.poses.copy(), order.names)
    there.empty(OPENING)
    assert there.blocked(course.home[0], course.home[-1]) is not None
    way = run.checked(course.home, "home")
    np.testing.assert_array_equal(way[[0, -1]], course.home[[0, -1]])
    assert all(there.blocked(start, end) is None for start, end in pairwise(way))


# ---------------------------------------------------------------- success


def test_a_block_is_put_on_another(moved: Attempt) -> None:
    assert moved.reached
    assert moved.detail == moved.stage == ""
    assert moved.error < 1e-3
    assert not moved.held
    after = moved.after
    assert after is not None
    assert after.num_placed == 2
    np.testing.assert_allclose(after.position[0], ONE.position[0], atol=5e-4)
    np.testing.assert_allclose(after.position[1], ON_TOP.target, atol=1e-3)
    np.testing.assert_allclose(moved.joints, PANDA.home, atol=1e-9)


def test_the_recording_covers_every_stage(moved: Attempt) -> None:
    run = moved.trajectory
    assert run is not None
    assert [STAGES[k] for k in sorted(set(run.stage.tolist()))] == list(STAGES)
    assert (np.diff(run.stage) >= 0).all()
    np.testing.assert_allclose(np.diff(run.time), 0.02, atol=1e-9)
    assert run.joints.shape == run.velocity.shape == (len(run.time), 7)
    np.testing.assert_allclose(run.pose[0, :, :3], ONE.position, atol=1e-9)
    np.testing.assert_allclose(run.pose[-1, 1, :3], ON_TOP.target, atol=1e-3)
    held = np.isin(run.stage, [STAGES.index("lift"), STAGES.index("cross")])
    assert (np.abs(run.width[held] - 0.0495) < 5e-4).all()
    # Released no further than needed.
    assert run.width[~held].max() < OPENING + 1e-3


def test_nothing_exceeds_the_limits(moved: Attempt) -> None:
    assert moved.trajectory is not None
    assert_within_limits(PANDA, moved.trajectory)


@pytest.mark.parametrize(("name", "sample_steps"), [("panda", 1), ("ur5e", 1), ("ur5e", 10)])
@given(seed=st.integers(0, 10**6))
@settings(max_examples=3, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_limits_hold_in_random_moves(name: str, sample_steps: int, seed: int) -> None:
    """Whatever becomes of them; recovery included."""
    rng = np.random.default_rng(seed)
    arm = get_arm(name)
    tested = DynamicCell(arm, trace=Trace(sample_steps), recover=True, precheck=False, speed=1.0)
    position = np.array([rng.uniform([-0.3, -0.4, GROUND], [0.25, -0.12, GROUND]), cell(0, 0, 0)])
    world = Scene(position[::-1].copy(), np.zeros(2), np.arange(2), 1)
    target = cell(*rng.integers([-2, 0, 0], [3, 2, 3]))
    pair = (AA, AB, BA, BB)[rng.integers(4)]
    found = tested.attempt(world, Move(1, target, *pair))
    if found.trajectory is not None:
        assert_within_limits(arm, found.trajectory)
    # A held block is never lost silently: it is in the hand, or rests where the scene says.
    after = found.after
    assert after is not None
    if found.reached:
        assert np.linalg.norm(after.position[1] - target) < 0.01
    if not found.held:
        # On the table, or on the other block.
        over = np.linalg.norm(after.position[1, :2] - after.position[0, :2]) < 0.05
        assert after.position[1, 2] < (0.08 if over else 0.03)


def test_a_wall_of_six(panda: DynamicCell) -> None:
    report = build_wall(panda, columns=3, rows=2)
    assert [a.outcome for a in report.attempts] == [Outcome.REACHED] * 6
    assert report.errors.max() < 1e-3


@pytest.mark.slow
def test_a_wall_of_twenty_is_exact(panda: DynamicCell) -> None:
    report = build_wall(panda)
    assert [a.outcome for a in report.attempts] == [Outcome.REACHED] * 20
    assert report.errors.mean() <= 1e-3
    assert report.errors.max() <= 2e-3
    assert max(a.error for a in report.attempts) <= 2e-3


@pytest.mark.parametrize(
    ("cells", "grasped", "to", "pair"),
    [
        ([(1, -4, 0), (1, -4, 1)], 1, (1, 0, 1), BB),  # vertical pair, by its upper cell
        ([(1, -4, 0), (2, -4, 0)], 0, (1, 0, 0), AB),  # lying pair, turned by a quarter
        ([(1, -4, 0), (0, -4, 0), (0, -4, 1)], 2, (0, 0, 2), AA),  # L on two blocks
        ([(0, -5, 0), (1, -5, 0), (0, -5, 1), (-1, -5, 1)], 2, (0, 0, 2), AA),  # standing S
    ],
)
def test_objects_of_several_cells(
    panda: DynamicCell, cells: list[tuple], grasped: int, to: tuple, pair: tuple
) -> None:
    placed = [(0, 0, 0), (1, 0, 0)] if to[2] > 1 else [(0, 0, 0)]
    if pair is AB:
        placed = [(-2, 0, 0)]
    first = len(placed)
    world = scene(placed, cells, [*range(first), *[first] * len(cells)])
    move = Move(first + grasped, cell(*to), *pair)
    found = panda.attempt(world, move)
    assert found.reached, found.detail
    meant = put_down(world, move)
    assert found.after is not None
    np.testing.assert_allclose(found.after.position, meant.position, atol=2e-3)
    np.testing.assert_allclose(np.cos(found.after.yaw - meant.yaw), 1.0, atol=1e-3)
    np.testing.assert_array_equal(found.after.object_id, meant.object_id)


def test_the_ur5e_picks_and_places() -> None:
    ur5e = DynamicCell(get_arm("ur5e"))
    found = ur5e.attempt(ONE, ON_TOP)
    assert found.reached, found.detail
    assert found.error < 1e-3
    # And from where it is to a quarter turn elsewhere.
    assert found.after is not None
    world = scene([(0, 0, 0), (0, 0, 1)], [(2, -4, 0)])
    turned = ur5e.attempt(world, Move(2, cell(2, 0, 0), *AB), joints=found.joints)
    assert turned.reached, turned.detail
    assert turned.after is not None
    assert np.cos(4 * turned.after.yaw[2]) > 0.999


# ---------------------------------------------------------------- failures


def test_what_is_out_of_reach_is_not_tried(panda: DynamicCell) -> None:
    for world, target, stage in (
        (scene([(0, 0, 0)], [(20, 0, 0)]), cell(0, 0, 1), "pick"),
        (ONE, np.array([0.6, 0.6, GROUND]), "place"),
    ):
        found = panda.attempt(world, Move(1, target, *AA))
        assert failed(found) == (Outcome.UNREACHABLE, stage)
        assert "out of reach" in found.detail
        assert found.trajectory is None
        assert found.after is not None
        np.testing.assert_array_equal(found.after.position, world.position)


def test_a_neighbour_on_the_closing_axis_is_hit(panda: DynamicCell) -> None:
    waiting = scene([(0, 0, 0)], [(2, -4, 0), (2, -5, 0)])
    found = panda.attempt(waiting, Move(1, cell(0, 0, 1), *AA))
    assert failed(found) == (Outcome.GRASP_COLLISION, "pick")
    assert "finger touches block 2" in found.detail
    assert not found.held
    found = panda.attempt(ONE, Move(1, cell(0, 1, 0), *AA))
    assert failed(found) == (Outcome.PLACE_COLLISION, "place")
    assert "finger touches block 0" in found.detail
    assert found.held
    assert found.detail.endswith("still in the hand")
    assert panda.attempt(ONE, Move(1, cell(0, 1, 0), *AB)).reached


def test_an_occupied_cell_is_known_before_and_found_by_trying(panda: DynamicCell) -> None:
    move = Move(1, cell(0, 0, 0), *AA)
    known = panda.attempt(ONE, move)
    assert failed(known) == (Outcome.PLACE_COLLISION, "place")
    assert known.trajectory is None
    tried = DynamicCell(PANDA, precheck=False).attempt(ONE, move)
    assert failed(tried) == failed(known)
    assert "block 1 touches block 0" in tried.detail
    assert tried.held
    below = DynamicCell(PANDA, precheck=False).attempt(ONE, Move(1, cell(2, 0, -1), *AA))
    assert below.outcome == Outcome.PLACE_COLLISION
    assert "table" in below.detail


def test_what_cannot_be_placed_goes_back() -> None:
    found = DynamicCell(PANDA, recover=True).attempt(ONE, Move(1, cell(0, 1, 0), *AA))
    assert found.outcome == Outcome.PLACE_COLLISION
    assert found.detail.endswith("put back")
    assert not found.held
    assert found.after is not None
    np.testing.assert_allclose(found.after.position[1], ONE.position[1], atol=5e-3)
    np.testing.assert_allclose(found.joints, PANDA.home, atol=1e-9)


def test_fingers_that_close_on_nothing_have_lost_the_grasp(panda: DynamicCell) -> None:
    above = Attitude(depth=0.036)
    found = panda.attempt(ONE, Move(1, cell(0, 0, 1), above, above))
    assert failed(found) == (Outcome.GRASP_LOST, "pick")
    assert not found.held


def test_what_slips_out_of_weak_fingers_is_lost() -> None:
    gripper = dataclasses.replace(PANDA.gripper, force=2.0)
    weak = DynamicCell(dataclasses.replace(PANDA, gripper=gripper))
    cells = [(0, -5, 0), (1, -5, 0), (0, -5, 1), (1, -5, 1)]
    world = scene([(0, 0, 0)], cells, [0, 1, 1, 1, 1])
    found = weak.attempt(world, Move(3, cell(0, 2, 1), *AA))
    assert found.outcome == Outcome.GRASP_LOST
    assert "in the hand" in found.detail
    assert found.after is not None
    # It is back on the table, or still hangs from the hand, and the report says so.
    assert found.held or found.after.position[1:5, 2].min() < 0.03


def test_what_is_let_go_in_the_air_is_dropped(panda: DynamicCell) -> None:
    found = panda.attempt(ONE, Move(1, cell(2, 0, 3), *AA))
    assert failed(found) == (Outcome.DROPPED, "rest")
    assert "150 mm" in found.detail
    assert found.after is not None
    assert found.after.position[1, 2] < 0.03


def test_a_block_that_overhangs_tips(panda: DynamicCell) -> None:
    found = panda.attempt(ONE, Move(1, cell(0.032 / PITCH, 0, 1), *AA))
    assert failed(found) == (Outcome.TOPPLED, "rest")
    assert panda.attempt(ONE, Move(1, cell(0.02 / PITCH, 0, 1), *AA)).reached


def test_a_block_that_levers_another_off_disturbs() -> None:
    position = np.array([[0, 0, GROUND], [0.022, 0, 0.075], [0, -0.24, GROUND]])
    world = Scene(position, np.zeros(3), np.arange(3), 2)
    move = Move(2, np.array([0.05, 0, 0.125]), *AA)
    found = DynamicCell(PANDA).attempt(world, move)
    assert failed(found) == (Outcome.DISTURBED_STRUCTURE, "rest")
    assert found.detail.startswith("block 1 was moved")
    lenient = DynamicCell(PANDA, shift_rule=ShiftRule(1.0)).attempt(world, move)
    assert lenient.outcome in (Outcome.TOPPLED, Outcome.DROPPED)


def test_a_pushed_block_counts_by_the_rule_of_the_cell() -> None:
    order = take_order(ONE, ON_TOP)
    poses = order.poses.copy()
    poses[1, :3] = ON_TOP.target
    check_rest(order, poses, 0.0, True, ShiftRule())
    poses[0, :3] += [0.006, 0.006, 0.0]
    check_rest(order, poses, 0.0, True, ShiftRule())
    poses[0, :3] += [0.004, 0.004, 0.0]
    with pytest.raises(Failure, match="disturbed-structure"):
        check_rest(order, poses, 0.0, True, ShiftRule())
    check_rest(order, poses, 0.0, True, ONE_SIDED)
    poses[0, 2] += 0.04
    with pytest.raises(Failure, match="disturbed-structure"):
        check_rest(order, poses, 0.0, True, ONE_SIDED)
    poses[0] = order.poses[0]
    with pytest.raises(Failure, match="still moves"):
        check_rest(order, poses, 0.5, True, ShiftRule())
    poses[1] = np.nan
    with pytest.raises(Failure):
        check_rest(order, poses, 0.0, True, ShiftRule())


# ---------------------------------------------------------------- repetition


def test_the_same_question_has_the_same_answer(panda: DynamicCell, moved: Attempt) -> None:
    panda.attempt(ONE, Move(1, cell(1, 0, 0), *AA))
    for again in (panda.attempt(ONE, ON_TOP), DynamicCell(PANDA).attempt(ONE, ON_TOP)):
        assert again.trajectory is not None
        assert moved.trajectory is not None
        for one, other in zip(again.trajectory, moved.trajectory, strict=True):
            np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(ONE.position, scene([(0, 0, 0)], [(0, -4, 0)]).position)


def test_skipping_free_motion_changes_nothing_that_rests(moved: Attempt) -> None:
    quick = DynamicCell(PANDA, skip_free_motion=True).attempt(ONE, ON_TOP)
    assert quick.reached
    assert quick.trajectory is not None
    assert moved.trajectory is not None
    assert quick.after is not None
    assert moved.after is not None
    # Time passes all the same; the objects get the arm as it would have arrived.
    assert abs(quick.trajectory.duration - moved.trajectory.duration) < 0.05
    np.testing.assert_allclose(quick.after.position, moved.after.position, atol=1e-4)
    first = STAGES.index("pick")
    before, skipped = (run.pose[run.stage < first] for run in (moved.trajectory, quick.trajectory))
    np.testing.assert_array_equal(before[-1], skipped[-1])


# ---------------------------------------------------------------- guards


def test_a_diverged_simulation_is_dumped(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    honest = Drives.commands

    def burst(self: Drives, *args: np.ndarray) -> np.ndarray:
        if self.data.time > 0.2:
            self.data.qvel[0] = np.nan
        return honest(self, *args)

    monkeypatch.setattr(Drives, "commands", burst)
    broken = DynamicCell(PANDA, trace=Trace(dump=tmp_path / "dump"))
    with pytest.raises(SimulationDivergedError, match="dump") as caught:
        broken.attempt(ONE, ON_TOP)
    assert "\n" not in str(caught.value)
    assert [path.name for path in tmp_path.iterdir()] == ["dump"]  # no log of MuJoCo's
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "dump" / "scene.xml"))
    with np.load(tmp_path / "dump" / "state.npz") as state:
        assert model.nq == len(state["qpos"])
        assert not np.isfinite(state["qvel"]).all()
        np.testing.assert_allclose(state["began"][:, :3], ONE.position)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"move": ON_TOP._replace(cell=0)}, "waiting cell"),
        ({"move": ON_TOP._replace(target=np.array([0, 0, np.nan]))}, "target"),
        ({"scene": ONE._replace(position=ONE.position + np.inf)}, "scene"),
        ({"joints": np.full(7, 9.0)}, "joints"),
        ({"joints": np.zeros(6)}, "joints"),
    ],
)
def test_bad_questions_are_refused(panda: DynamicCell, change: dict, words: str) -> None:
    asked = {"scene": ONE, "move": ON_TOP, **change}
    with pytest.raises(InputError, match=words), np.errstate(invalid="ignore"):
        panda.attempt(asked.pop("scene"), asked.pop("move"), **asked)


@pytest.mark.parametrize(
    ("word", "bad"),
    [("speed", {"speed": 0.0}), ("speed", {"speed": 1.5}), ("sample_steps", {"trace": Trace(0)})],
)
def test_bad_settings_are_refused(word: str, bad: dict) -> None:
    with pytest.raises(InputError, match=word):
        DynamicCell(PANDA, **bad)


def test_a_step_is_what_the_samples_count() -> None:
    assert pytest.approx(0.02) == TIMESTEP * 10
