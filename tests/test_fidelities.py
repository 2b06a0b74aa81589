"""The kinematic cell against the dynamic one, on the same moves."""

from __future__ import annotations

from learn2assemble.robot.kinematic import KinematicCell
from learn2assemble.robot.moves import Attempt, Outcome
from learn2assemble.tasks.evaluation.fidelities import compare
from learn2assemble.tasks.networks.agent import load_agent
from learn2assemble.tasks.task import get_task

TASK = get_task("robot-two-sided-3x3-10-14")


def test_both_cells_judge_the_same_moves() -> None:
    agent = load_agent("relational-two-sided-s0")
    found = compare(TASK, agent, 8, seed=4)
    again = compare(TASK, agent, 8, seed=4)
    data = found.to_dict()
    assert data["actions"] == sum(data["outcomes"].values()) == 8
    assert data["agree"] >= 7
    assert found.outcomes == again.outcomes
    assert min(data["kinematic_ms"], data["dynamic_ms"]) > 0
    assert data["share"] == found.share == data["agree"] / 8
    assert len(data["disagreements"]) == 8 - data["agree"]
    assert data["commit"]


def test_a_cell_that_is_wrong_is_found_out(monkeypatch) -> None:
    """A kinematic cell that says no to everything disagrees wherever the dynamic one succeeds."""
    no = Attempt(Outcome.UNREACHABLE, "pick", "never")
    monkeypatch.setattr(KinematicCell, "attempt", lambda self, scene, move: no)
    found = compare(TASK, load_agent("relational-two-sided-s0"), 6, seed=4)
    reached = sum(n for (_, second), n in found.outcomes.items() if second == "reached")
    assert reached > 0
    assert found.share == (6 - reached) / 6
    assert len(found.to_dict()["disagreements"]) == reached
