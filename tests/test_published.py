"""The published fast mode against what its authors' simulator did with the arm."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from learn2assemble.errors import InputError, UnknownNameError
from learn2assemble.evaluation.robot_replay import kinematic, replay_robot_file
from learn2assemble.robot.arm import get_arm
from learn2assemble.robot.grasps import get_grasps
from learn2assemble.robot.outcome import Outcome
from learn2assemble.robot.published import PublishedCell
from learn2assemble.robot.scene import Move, Scene

AA, AB = get_grasps("paper")[:2]
TWO = Scene(np.array([[0.0, 0.0, 0.025], [0.019, -0.15, 0.025]]), np.zeros(2), np.array([0, 1]), 1)


def test_failures_agree_on_the_sample(data: Path) -> None:
    report = replay_robot_file(data / "transitions_robot_failures.jsonl")
    assert report.lines >= 10
    assert report.agree >= report.lines - 1


@pytest.mark.parametrize(
    ("name", "share"),
    [("2robo_g3_n20", 0.95), ("2robomore_g5_n30", 0.95), ("4robo_g3_n30", 0.92),
     ("1robo_g3_n20", 0.92)],
)  # fmt: skip
def test_whole_logs_agree(reference: Path, name: str, share: float) -> None:
    report = replay_robot_file(reference / f"transitions_{name}.jsonl.gz")
    assert report.agree >= share * report.lines


def test_the_kinematic_cell_can_be_compared_too(data: Path) -> None:
    report = replay_robot_file(data / "transitions_robot_failures.jsonl", kinematic)
    assert 0 < report.agree <= report.lines


def test_a_block_on_a_block_stands_and_a_neighbour_is_touched() -> None:
    cell = PublishedCell(get_arm("panda"))
    on_top = Move(1, np.array([0.0, 0.0, 0.075]), *AA)
    first, again = cell.attempt(TWO, on_top), cell.attempt(TWO, on_top)
    assert first.outcome == again.outcome == Outcome.REACHED
    assert first.after is not None
    assert again.after is not None
    np.testing.assert_array_equal(first.after.position, again.after.position)
    np.testing.assert_allclose(first.after.position[1], on_top.target, atol=6e-3)
    # The fingers open along y, where the first block stands.
    behind = np.array([0.0, 0.06, 0.025])
    assert cell.attempt(TWO, Move(1, behind, *AA)).outcome != Outcome.REACHED
    assert cell.attempt(TWO, Move(1, behind, *AB)).outcome == Outcome.REACHED


def test_out_of_reach_is_unreachable() -> None:
    cell = PublishedCell(get_arm("panda"))
    found = cell.attempt(TWO, Move(1, np.array([1.5, 0.0, 0.025]), *AA))
    assert found.outcome == Outcome.UNREACHABLE


def test_what_the_published_mode_does_not_know_is_refused() -> None:
    with pytest.raises(InputError, match="ur5e"):
        PublishedCell(get_arm("ur5e"))
    with pytest.raises(UnknownNameError, match="did you mean 'cubes'"):
        PublishedCell(get_arm("panda"), "cube")
    with pytest.raises(InputError, match="opening"):
        PublishedCell(get_arm("panda"), opening=0.04)
