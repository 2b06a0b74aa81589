"""The main job: every example design, the agent's help and the search behind it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from learn2assemble.networks.agent import Agent, default_agent, load_agent
from learn2assemble.networks.config import NetworkConfig
from learn2assemble.networks.qnetwork import QNetwork
from learn2assemble.planning.build import build_problem
from learn2assemble.planning.discover import Placement, plan_sequences, replay, strip
from learn2assemble.planning.plan import Step
from learn2assemble.planning.problem import Problem, design_problem, preset_problem
from learn2assemble.planning.verify import verify
from learn2assemble.simulator import Simulator
from learn2assemble.tasks import PRESETS
from learn2assemble.world.blocks import RELATIONS
from learn2assemble.world.design_bounds import parse_design, read_design

ROOT = Path(__file__).parent.parent
DESIGNS = sorted((ROOT / "examples" / "designs").glob("*.json"))
SOLUTIONS = ROOT / "tests" / "data" / "solutions"
BUILDABLE = [path for path in DESIGNS if path.stem != "cannot_be_built"]


@pytest.fixture(scope="module")
def agent() -> Agent:
    return load_agent(default_agent("two-sided-3x3-20-24"))


@pytest.fixture(scope="module")
def untrained() -> Agent:
    return Agent("untrained", QNetwork(NetworkConfig(rounds=1)).eval(), "two-sided-3x3-20-24")


def known_solution(design: str) -> list[Placement]:
    """Placements of a stored solution: ``[block, reference, relation]`` per step."""
    steps = json.loads((SOLUTIONS / f"{design}.json").read_text(encoding="utf-8"))
    return [Placement(block, ref, RELATIONS.index(relation)) for block, ref, relation in steps]


@pytest.mark.parametrize("path", BUILDABLE, ids=lambda p: p.stem)
def test_known_solution_plays_through_legally_to_success(path: Path) -> None:
    problem = design_problem(read_design(path))
    placements = known_solution(path.stem)
    state, held, filled = replay(problem, Simulator(problem.task), placements)
    assert held
    assert filled
    assert state.num_placed[0] == len(placements) + 1
    proof = verify(problem, placements)
    assert proof.stable
    assert proof.filled
    assert all(step.stability_margin > 0 for step in proof.steps)
    covers = [step.coverage for step in proof.steps]
    assert covers == sorted(covers)


@pytest.mark.parametrize("path", BUILDABLE, ids=lambda p: p.stem)
def test_every_design_is_built(path: Path, agent: Agent) -> None:
    plan = build_problem(design_problem(read_design(path)), agent, path.name)
    assert plan.status == "complete"
    assert plan.reason is None
    assert plan.coverage > plan.design.success_threshold
    assert all(step.stable for step in plan.steps)
    assert plan.blocks.used == len(plan.steps) + 1 <= plan.blocks.available


def test_what_cannot_be_built_is_refused_with_the_reason(agent: Agent) -> None:
    path = ROOT / "examples" / "designs" / "cannot_be_built.json"
    plan = build_problem(design_problem(read_design(path)), agent, path.name)
    assert plan.status == "refused"
    assert "overhang" in plan.reason
    assert plan.steps == ()


@pytest.mark.parametrize("preset", ["two-sided-3x3-20-24", "one-sided-3x3-22-24"])
def test_the_widest_search_finds_a_plan_without_a_trained_agent(
    preset: str, untrained: Agent
) -> None:
    """It must not give up where a plan exists: an untrained network is the worst adviser."""
    plan = build_problem(preset_problem(preset, 0), untrained, preset, seconds=10)
    assert plan.status == "complete", plan.reason
    stages = [attempt.stage for attempt in plan.search.attempts]
    assert plan.search.needed == stages[-1]


def test_too_few_blocks_end_incomplete_and_say_what_is_missing(untrained: Agent) -> None:
    problem = preset_problem("two-sided-3x3-20-24", 1)
    state = problem.state.copy()
    state.num_blocks[0] = 3
    short = Problem(problem.name, problem.task, state, problem.elevation_names, None)
    plan = build_problem(short, untrained, "test", seconds=2)
    assert plan.status == "incomplete"
    assert "is needed" in plan.reason
    assert all(step.stable for step in plan.steps)


def test_backtracking_leaves_a_dead_end(untrained: Agent) -> None:
    """Exactly enough blocks: one wrong placement and the search has to take it back."""
    text = json.dumps({
        "format": "learn2assemble-design", "version": 1, "name": "tight", "blocks": 4,
        "elevations": [
            {"outline": [[-0.075, 0], [-0.075, 0.05], [-0.025, 0.05], [-0.025, 0.1],
                         [0.025, 0.1], [0.025, 0.05], [0.075, 0.05], [0.075, 0]]}
        ],
    })  # fmt: skip
    problem = design_problem(parse_design(text, "test"))
    sequences = list(plan_sequences(problem, untrained.network, seconds=10))
    assert sequences[-1].success
    assert len(sequences[-1].placements) == 3


def test_no_block_stands_outside_where_supports_are_forbidden(untrained: Agent) -> None:
    text = json.dumps({
        "format": "learn2assemble-design", "version": 1, "name": "wall", "supports": False,
        "elevations": [{"outline": [[-0.125, 0], [-0.125, 0.1], [0.125, 0.1], [0.125, 0]]}],
    })  # fmt: skip
    plan = build_problem(design_problem(parse_design(text, "test")), untrained, "test")
    assert plan.status == "complete"
    assert not any(step.outside for step in plan.steps)


def test_strip_removes_what_nothing_needs_and_nothing_else(untrained: Agent) -> None:
    problem = preset_problem("two-sided-3x3-20-24", 3)
    simulator = Simulator(problem.task)
    *_, last = plan_sequences(problem, untrained.network, seconds=10)
    assert last.success
    assert strip(problem, simulator, last.placements) == last.placements
    for number in range(len(last.placements)):
        shorter = [p for n, p in enumerate(last.placements) if n != number]
        cut = [p for p in shorter if p.reference <= number]
        _, held, filled = replay(problem, simulator, cut[:number])
        assert held
        assert not filled


def test_every_preset_can_be_a_problem() -> None:
    for name, task in PRESETS.items():
        problem = preset_problem(name, 0)
        assert problem.task == task
        assert len(problem.outlines) == task.num_sides
        assert not problem.is_outside(np.array([1.0, 1.0, 1.0]))


def test_the_plan_is_the_same_for_the_same_seed(untrained: Agent) -> None:
    def made() -> tuple[Step, ...]:
        return build_problem(preset_problem("two-sided-3x3-20-24", 5), untrained, "x", seed=2).steps

    assert made() == made()
