"""The kinematic cell against the dynamic one, on the same moves."""

from __future__ import annotations

from learn2assemble.evaluation.fidelities import compare
from learn2assemble.networks.agent import load_agent
from learn2assemble.robot.kinematic.cell import KinematicCell
from learn2assemble.robot.moves import Attempt, Outcome
from learn2assemble.tasks import get_task

TASK = get_task("robot-two-sided-3x3-10-14")


def test_both_cells_judge_the_same_moves() -> None:
    agent = load_agent("relational-two-sided-s0")
    found = compare(TASK, agent, 8, seed=4)
    again = compare(TASK, agent, 8, seed=4)
    assert found.actions == 8
    assert sum(found.outcomes.values()) == 8
    assert found.agree >= 7
    assert found.outcomes == again.outcomes
    assert min(found.kinematic_seconds, found.dynamic_seconds) > 0
    data = found.to_dict()
    assert data["share"] == found.agree / 8
    assert len(data["disagreements"]) == 8 - found.agree
    assert data["commit"]


def test_a_cell_that_is_wrong_is_found_out(monkeypatch) -> None:
    """A kinematic cell that says no to everything disagrees wherever the dynamic one succeeds."""
    no = Attempt(Outcome.UNREACHABLE, "pick", "never")
    monkeypatch.setattr(KinematicCell, "attempt", lambda self, scene, move: no)
    found = compare(TASK, load_agent("relational-two-sided-s0"), 6, seed=4)
    reached = sum(n for (_, second), n in found.outcomes.items() if second == "reached")
    assert reached > 0
    assert found.agree == 6 - reached
    assert len(found.disagreements) == reached
