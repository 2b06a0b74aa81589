"""The builder of designs as a player of the paper's tasks, and with an arm in its search."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from l2a_lab.bounds import best_returns, find_towers
from l2a_lab.builder import measure_arm as builder_arm
from l2a_lab.builder.arm import Hand, build_by_arm
from l2a_lab.builder.measure_arm import WAYS, compare
from l2a_lab.builder.network import load_builder
from l2a_lab.builder.search import build
from l2a_lab.builder.tasks import TaskModel, make_problem
from learn2assemble.acting.carry_out import Workcell
from learn2assemble.assembly.kit import load_kit
from learn2assemble.cell import world as cells
from learn2assemble.cell.pieces import pieces_of
from learn2assemble.cell.site import Obstacle, Site
from learn2assemble.design.cells import CellDesign
from learn2assemble.envs.policies import load_policy
from learn2assemble.envs.suite import SuiteTask
from learn2assemble.errors import InputError
from learn2assemble.planning.tiling.construct import plan_cells
from learn2assemble.planning.tiling.cover.tile import Tiling
from learn2assemble.planning.tiling.ordering import to_assembly
from learn2assemble.planning.tiling.planners import PlannerChoice
from learn2assemble.planning.tiling.world import LatticeWorld, make_site
from learn2assemble.tasks.designs import make_design
from learn2assemble.tasks.evaluation.episodes import (
    evaluate,
    greedy_policy,
    play_episodes,
    search_policy,
)
from learn2assemble.tasks.search.config import SearchConfig
from learn2assemble.tasks.simulator import Simulator
from learn2assemble.tasks.task import DesignTask, get_task
from learn2assemble.tasks.world_model import lookahead_actions

SEARCH = SearchConfig(budget=4, epsilon=0.0)


def model(task: str) -> TaskModel:
    return TaskModel(Simulator(get_task(task)), load_builder())


@pytest.mark.parametrize(
    "task", ["two-sided-3x3-20-24", "two-sided-5x5-40-44", "one-sided-3x3-22-24"]
)
def test_a_problem_is_the_towers_of_its_sides(task: str) -> None:
    """The cells of the design are those that the exact returns let grow, found in another way."""
    simulator = Simulator(get_task(task))
    state = simulator.new(20, np.random.default_rng(3))
    for row in range(20):
        problem = make_problem(simulator, state, row)
        cells = {
            tuple(cell) for cell in (np.argwhere(problem.site.wanted) + problem.corner).tolist()
        }
        towers = find_towers(simulator, state, row)
        high = [
            (*p, z)
            for p, cap in zip(towers.place.tolist(), towers.cap, strict=True)
            for z in range(cap)
        ]
        # A side without open pixels has places there, too, that only have to be passed.
        assert {cell for cell in high if cell[2] > 0} == {cell for cell in cells if cell[2] > 0}
        assert cells <= set(high)


@pytest.mark.parametrize(
    "task", ["two-sided-3x3-20-24", "bars-one-sided-5x5-25-27", "objects-two-sided-5x5-20-24"]
)
def test_what_is_built_is_filled_in_the_design(task: str) -> None:
    """Every placement offered holds, and what stands is what the network is shown."""
    simulator, rng = Simulator(get_task(task)), np.random.default_rng(0)
    player, state = TaskModel(simulator, load_builder()), simulator.new(8, rng)
    for _ in range(2):
        found = player.action_values(state)
        for row, values in enumerate(found):
            world = player.standing(state, row)
            problem = player.problem(state, row)
            filled = np.argwhere((world.owner >= 0).reshape(world.site.wanted.shape))
            placed = state.position[row, : state.num_placed[row]]
            at = np.rint(placed / 0.05 - [0, 0, 0.5]).astype(int)
            inside = {tuple(cell) for cell in at.tolist()}
            assert {tuple(cell) for cell in (filled + problem.corner).tolist()} <= inside
            for kind, left in zip(world.site.kit.kinds, world.heap, strict=True):
                assert 0 <= left <= (kind.count or 0)
            for action in values.actions:
                tried = simulator.step(state.take(np.array([row])), action[None])
                assert tried.verdict[0] == 0
        step = simulator.step(state, player.best(state)[1])
        state = state.take(np.flatnonzero(~step.terminated))


def test_the_builder_plays_nearly_perfectly() -> None:
    """On the problems of 12 episodes: no failure, and at most 4 % below the upper bound."""
    for task in ("two-sided-3x3-20-24", "two-sided-4x4-30-34"):
        player = model(task)
        played = play_episodes(player.simulator, search_policy(player, SEARCH), 12, 7)
        alone = play_episodes(player.simulator, greedy_policy(player, 0.0), 12, 7)
        root = np.random.SeedSequence([2, 7])
        bound = best_returns(player.simulator, 12, np.random.default_rng(root.spawn(1)[0]))
        assert not played.failed.any()
        assert (played.returns <= bound + 1e-9).all()
        assert played.returns.mean() >= max(0.96 * bound.mean(), alone.returns.mean() - 0.05)


def test_rewards_come_first() -> None:
    """Without search it takes what pays wherever the look-ahead finds something that does."""
    simulator = Simulator(get_task("two-sided-5x5-40-44"))
    player, state = (
        TaskModel(simulator, load_builder()),
        simulator.new(16, np.random.default_rng(1)),
    )
    best = simulator.step(state.copy(), lookahead_actions(simulator, state)).reward
    mine = simulator.step(state.copy(), player.best(state)[1]).reward
    np.testing.assert_array_equal(mine, best)


def test_evaluation_of_a_builder() -> None:
    result = evaluate(
        "two-sided-3x3-20-24", agent="builder-s0", search="mcts", budget=2, episodes=2
    )
    assert result.agent == "builder-s0"
    assert result.metrics.f == 0
    with pytest.raises(InputError, match="agent of the paper"):
        evaluate("robot-two-sided-3x3-10-14", agent="builder-s0", episodes=1)


# The arm in the search: what it makes, and what it says is in the way.

H = np.array([[c == "#" for c in row] for row in ("#...#", "#####", "#...#")])[::-1].T[:, None]
THICK = np.ones((3, 3, 2), bool)


def settled(
    cells: np.ndarray, tool: str = "suction", kit_name: str = "bricks-lintels", **site: Any
) -> tuple[Hand, LatticeWorld]:
    """An arm before a design, and a world with half of it built."""
    hand = Hand(Workcell("panda", tool, Site(**site), physics="kinematic"))
    kit = hand.holds(load_kit(kit_name))
    first = build(make_site(cells, kit), load_builder()).world
    place = make_site(cells, hand.set_up(first))
    hand.enter(place)
    done = build(place, load_builder()).world
    half = LatticeWorld(place)
    for candidate in done.placed[: len(done.placed) // 2]:
        assert half.place(candidate, program=True)
    return hand, half


def test_the_scene_is_that_of_the_build() -> None:
    hand, world = settled(H, obstacles=(Obstacle((0.3, 0.3), (0.05, 0.04, 0.1), 0.2),))
    assert hand.job is not None
    site = world.site
    nxt = next(int(c) for c in world.legal() if world.copy().place(int(c), program=True))
    blocks = tuple(site.placement(c) for c in [*world.placed, nxt])
    assembly = to_assembly(Tiling(blocks, site.wanted, "complete"), None, site.kit)
    job = replace(hand.job, pieces=pieces_of(assembly), steps=(), assembly=assembly)
    other = cells.WorkcellBlocks(job)
    for k in range(len(world.placed)):
        other.pose[k], other.state[k] = other.target(k), cells.STANDING
    last = len(world.placed)
    other.pose[last] = other.presented(last, cells.supply_of(other, last)[0])
    expected = cells.rows_of(other, other.pose, last)
    seen = []
    attempt = hand.cell.attempt
    hand.cell.attempt = lambda scene, move: seen.append((scene, move)) or attempt(scene, move)
    assert hand.blocked(world, nxt) is None
    scene, move = seen[0]
    assert scene.num_placed == expected.scene.num_placed
    np.testing.assert_allclose(scene.position, expected.scene.position, atol=1e-9)
    np.testing.assert_allclose(scene.halves, expected.scene.halves, atol=1e-9)
    assert scene.density is not None
    assert expected.scene.density is not None
    np.testing.assert_allclose(scene.density, expected.scene.density)
    np.testing.assert_allclose(scene.orientation, expected.scene.orientation, atol=1e-12)
    ways = list(cells.moves(other, expected, last, other.target(last)))
    assert any(np.allclose(move.target, way.target) and move.place == way.place for way in ways)


def test_what_is_in_the_way_is_named() -> None:
    """Fingers cannot put a block between two others; those are to blame."""
    hand, _ = settled(THICK, "gripper", "cubes")
    site, world = hand.site, LatticeWorld(hand.site)
    where = {tuple(site.found.origin[c]): int(c) for c in world.legal()}
    for around in ((0, 1, 0), (2, 1, 0), (1, 0, 0), (1, 2, 0)):
        assert world.place(where[around])
    blamed = hand.blocked(world, where[1, 1, 0])
    assert blamed is not None
    assert set(blamed) <= set(np.flatnonzero(world.owner >= 0))
    assert hand.blocked(LatticeWorld(site), where[1, 1, 0]) is None


@pytest.mark.parametrize(("cells", "tool"), [(H, "suction"), (H, "gripper"), (THICK, "gripper")])
def test_the_builders_plan_is_carried_out_in_its_order(cells: np.ndarray, tool: str) -> None:
    design = CellDesign("it", cells, (0.05, 0.05, 0.05), None, 0.0, None, "it", None)
    hands = []

    def plan_with(kit, hand):
        hands.append(hand)
        return plan_cells(design, kit, planner=PlannerChoice("agent", hand=hand))

    kit = load_kit("bricks-lintels")
    at = Workcell("panda", tool, physics="kinematic")
    plan = build_by_arm(plan_with, cells, kit, at, lambda text: None)
    assert plan.complete, plan.reason
    assert plan.arm is not None
    assert plan.arm.attempts == len(plan.steps)
    assert not plan.arm.failures
    assert [step.block for step in plan.steps] == list(range(len(plan.steps)))
    assert plan.cells is not None
    assert plan.cells.missing == plan.cells.outside == 0
    # Without room for fingers, they stand farther apart.
    assert (plan.arm.pitch > 0.07) == (cells is THICK)


def test_a_tool_that_holds_nothing_is_refused() -> None:
    with pytest.raises(InputError, match="blocks that it can hold"):
        Hand(Workcell("panda", "suction")).holds(load_kit("cubes").at_pitch((0.02, 0.02, 0.02)))


def test_the_comparison_says_whether_the_builder_helps() -> None:
    def row(exact: int, prior: int) -> dict[str, Any]:
        told = {"complete": True, "placed": 10, "tried": 10, "props": 0, "seconds": 1.0}
        failed = dict(zip(WAYS, (exact, exact, prior, prior), strict=True))
        return {"blocks": 10} | {way: told | {"failed": failed[way]} for way in WAYS}

    assert compare([row(10, 7), row(10, 7)])["helps"]
    assert not compare([row(10, 8), row(10, 7)])["helps"]
    assert not compare([row(0, 0), {"left_out": "out of reach"}])["helps"]
    told = compare([row(10, 7), row(20, 17), {"left_out": "out of reach"}])
    assert (told["designs"], told["left_out"]) == (2, 1)
    assert told["agent as prior"]["minus_far_to_near"]["failed_per_block"] == [-0.3, -0.3, -0.3]


def test_the_planners_of_the_comparison_place_the_same_blocks() -> None:
    task = DesignTask("little", ("rings",), "cubes", blocks=(8, 20))
    design = make_design(task, np.random.default_rng(3))
    row = builder_arm._compared(design, builder_arm.ArmMeasure(seconds=5.0), load_builder())
    for way in WAYS:
        assert row[way]["complete"], way
        assert row[way]["placed"] == len(design.order) == row[way]["tried"] - row[way]["failed"]


def test_the_measurement_counts_every_design(monkeypatch: pytest.MonkeyPatch) -> None:
    little = DesignTask("little", ("rings",), "cubes", blocks=(4, 12))
    monkeypatch.setattr(builder_arm, "SMALL", little)
    monkeypatch.setattr(builder_arm, "LARGE", (little,))
    kept = []
    config = builder_arm.ArmMeasure(2, 1, 1, 5.0)
    found = builder_arm.measure_arm("builder-s0", config, keep=lambda now: kept.append(dict(now)))
    assert len(kept) == 2
    assert (found["sets"]["suction"]["designs"], found["sets"]["gripper"]["designs"]) == (2, 1)
    assert found["sets"]["suction"]["complete"] == 1
    low, high = found["sets"]["suction"]["interval"]
    assert low < 1 <= high + 1e-9
    assert found["comparison"]["designs"] + found["comparison"]["left_out"] == 1
    more = builder_arm.measure_arm(
        "builder-s0", builder_arm.ArmMeasure(3, 1, 1, 5.0), known=json.loads(json.dumps(found))
    )
    assert more["sets"]["suction"]["designs"] == 3
    assert more["sets"]["suction"]["rows"][:2] == found["sets"]["suction"]["rows"]
    assert more["sets"]["gripper"] == json.loads(json.dumps(found["sets"]["gripper"]))
    assert more["comparison"] == json.loads(json.dumps(found["comparison"]))


def test_builders_are_policies_of_the_benchmark() -> None:
    """Alone it completes a design that random choices do not; with its search, by its plan."""
    task = SuiteTask("designs-lintels-60-held-out")
    env = task.make()
    for name, knows in (("builder", "observation"), ("builder-with-search", "model")):
        policy: Any = load_policy(f"{name}:builder-s0")
        assert policy.knows == knows
        done = task.play(env, 0, policy)
        assert (done.score, done.success) == (pytest.approx(1.0), True)
    assert policy.planned == []
    assert not task.play(env, 0, load_policy("random")).success
    with pytest.raises(InputError, match="designs-"):
        SuiteTask("goals-bridge").play(SuiteTask("goals-bridge").make(), 0, policy)
    with pytest.raises(InputError, match="builder of designs"):
        load_policy("builder:nobody")
