"""Building a problem of a task: the agent, the searches behind it, and what is proven of it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import learn2assemble as l2a
from learn2assemble.errors import InputError
from learn2assemble.planning.plan import Plan
from learn2assemble.statics.rigid_blocks import check
from learn2assemble.tasks import episode
from learn2assemble.tasks.episode import build_task, sample_problem
from learn2assemble.tasks.networks.agent import Agent, load_agent
from learn2assemble.tasks.networks.config import NetworkConfig
from learn2assemble.tasks.networks.qnetwork import QNetwork
from learn2assemble.tasks.playing import BUDGETS, STAGES, placement_key, plan_episode
from learn2assemble.tasks.simulator import Simulator
from learn2assemble.tasks.task import get_task
from learn2assemble.tasks.world.state import State

TASK = "two-sided-3x3-20-24"


@pytest.fixture(scope="module")
def untrained() -> Agent:
    return Agent("untrained", QNetwork(NetworkConfig(rounds=1)).eval(), TASK)


def replayed(task: str, seed: int, plan: Plan) -> State:
    """The plan's placements made anew in the world of the task, which accepts every one."""
    simulator, state = Simulator(get_task(task)), sample_problem(get_task(task), seed)
    for step in plan.steps:
        placed = int(state.num_placed[0])
        goal = np.array(step.position)
        found = False
        for reference in range(placed):
            for action in range(simulator.task.num_actions):
                key = placement_key(simulator.task, state, np.array([0, reference, action]))
                found = np.allclose(np.array(key[:3]) * 0.025, goal, atol=2e-3)
                if found:
                    break
            if found:
                break
        assert found, step
        made = simulator.step(state, np.array([[0, reference, action]]))
        assert made.verdict[0] == 0
    return state


@pytest.mark.parametrize(
    ("task", "seed"), [(TASK, 1), ("one-sided-3x3-22-24", 0), ("four-sided-3x3-10-18", 0)]
)
def test_a_problem_of_a_task_is_built(task: str, seed: int) -> None:
    plan = l2a.build(task, seed=seed)
    assert plan.status == "complete"
    assert plan.reason is None
    assert plan.coverage > plan.design.success_threshold
    assert plan.blocks.used == len(plan.steps) + 1 <= plan.blocks.available
    assert len(plan.design.targets) == get_task(task).num_sides
    assert plan.assembly is not None
    assert len(plan.assembly.steps) == len(plan.steps) == len(plan.assembly.blocks) - 1
    covers = [step.coverage for step in plan.steps]
    assert covers == sorted(covers)
    assert all(len(step.sides) == len(plan.design.targets) for step in plan.steps)
    assert all(0 <= share <= 1 for step in plan.steps for share in step.sides)
    for step in plan.steps:
        block = plan.assembly.blocks[step.block]
        np.testing.assert_allclose(block.centroid, step.position, atol=1e-5)
        assert step.margin_g is not None
        assert step.margin_g > 0
    state = replayed(task, seed, plan)
    assert state.complete_coverage[0] == pytest.approx(plan.coverage, abs=0.02)


def test_objects_of_several_cells_are_blocks_of_the_assembly() -> None:
    plan = l2a.build("objects-two-sided-5x5-20-24", seed=1)
    assert plan.complete
    assert plan.assembly is not None
    cells = [round(block.volume / 0.05**3) for block in plan.assembly.blocks]
    assert max(cells) > 1
    assert all(
        block.mass == pytest.approx(0.1 * n)
        for block, n in zip(plan.assembly.blocks, cells, strict=True)
    )
    assert check(plan.assembly).verdict == "stands"


@pytest.mark.parametrize("task", [TASK, "one-sided-3x3-22-24"])
def test_the_widest_search_needs_no_trained_agent(task: str, untrained: Agent) -> None:
    """It must not give up where a plan exists: an untrained network is the worst adviser."""
    plan = build_task(task, agent=untrained, seconds=10)
    assert plan.status == "complete", plan.reason
    assert plan.search is not None
    assert plan.search.needed == plan.search.attempts[-1].stage


def test_too_few_blocks_end_incomplete_and_say_what_is_missing(
    untrained: Agent, monkeypatch: pytest.MonkeyPatch
) -> None:
    def few(task: l2a.Task, seed: int) -> State:
        state = sample_problem(task, seed)
        state.num_blocks[0] = 3
        return state

    monkeypatch.setattr(episode, "sample_problem", few)
    plan = build_task(TASK, agent=untrained, seed=1, seconds=2)
    assert plan.status == "incomplete"
    assert plan.reason is not None
    assert "is needed; all 3 blocks are used" in plan.reason
    assert len(plan.steps) == 2


def test_backtracking_leaves_a_dead_end(untrained: Agent) -> None:
    """Exactly enough blocks: one wrong placement and the search has to take it back."""
    task = get_task(TASK)
    simulator, state = Simulator(task), sample_problem(task, 1)
    free = plan_episode(simulator, state, untrained.network, seconds=10)
    assert free.success
    state.num_blocks[0] = len(free.actions) + 1
    tight = plan_episode(simulator, state, untrained.network, seconds=10)
    assert tight.success
    assert len(tight.actions) <= len(free.actions)


def test_what_failed_is_left_out_of_the_next_plan() -> None:
    task = get_task(TASK)
    simulator, state = Simulator(task), sample_problem(task, 1)
    network = load_agent("relational-cubes-s0").network
    first = plan_episode(simulator, state, network).actions[0]
    avoid = frozenset({placement_key(task, state, first)})
    other = plan_episode(simulator, state, network, avoid=avoid)
    now = state.copy()
    for action in other.actions:
        assert placement_key(task, now, action) not in avoid
        simulator.step(now, action[None])
    assert other.success


def test_a_block_that_falls_in_simulation_is_taken_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """The plan is made anew without that placement, from what stood before it."""
    step, failed = Simulator.step, []

    def clumsy(self: Simulator, state: State, actions: np.ndarray) -> object:
        made = step(self, state, actions)
        if self.physics.name == "rigid" and not failed:
            failed.append(placement_key(self.task, state, actions[0]))
            made.verdict[0] = 5
            state.terminated[0] = True
        return made

    monkeypatch.setattr(Simulator, "step", clumsy)
    plan = build_task(TASK, seed=1)
    assert failed
    assert plan.complete
    assert plan.search is not None
    assert [s.result for s in plan.search.attempts if s.stage.startswith("failure")] == [
        "in rigid-body simulation"
    ]


def test_the_plan_is_the_same_for_the_same_seed(untrained: Agent) -> None:
    plans = [build_task(TASK, agent=untrained, seed=5) for _ in range(2)]
    assert plans[0].steps == plans[1].steps
    assert dataclasses.replace(plans[0], seconds=0, search=None) == dataclasses.replace(
        plans[1], seconds=0, search=None
    )


def test_stages_rise() -> None:
    assert len(STAGES) == len(set(STAGES)) == len(BUDGETS) + 1


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"planner": "exact"}, "agent, for the task"),
        ({"kit": "bricks", "tool": "suction"}, "kit, tool: got 'given'"),
        ({"arm": "panda"}, "a task with a robot"),
        ({"agent": "builder-s0"}, "agent"),
        ({"seed": -1}, "at least 0"),
    ],
)
def test_what_a_task_does_not_take_is_refused(arguments: dict, words: str) -> None:
    with pytest.raises(InputError, match=words):
        l2a.build(TASK, **arguments)


def test_an_agent_of_the_paper_does_not_build_drawings() -> None:
    with pytest.raises(InputError, match=r"relational-cubes-s0.*a builder of designs"):
        l2a.build("examples/designs/pyramid.json", agent="relational-cubes-s0")
    plan = l2a.build("examples/designs/pyramid.json", agent="builder-s0")
    assert (plan.planner, plan.agent) == ("agent", "builder-s0")
