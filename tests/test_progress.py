"""What is told while something takes long: the phase, the best so far and what time is left."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
import pytest
from numba import njit

import learn2assemble as l2a
from learn2assemble import linear_programs
from learn2assemble.assembly.kit import load_kit
from learn2assemble.cli import output
from learn2assemble.compiling import compiling_seconds
from learn2assemble.linear_programs import Clock
from learn2assemble.planning.tiling.exact import plan_exact
from learn2assemble.progress import Detail
from test_cli import Terminal

KIT = load_kit("bricks-lintels")


def test_details_are_told_not_too_often_with_the_time_that_is_left() -> None:
    """By a stand-in clock."""
    now, told = [0.0], []
    clock = Clock(60.0, timer=lambda: now[0], progress=told.append)
    for second in range(5):
        now[0] = float(second)
        clock.tell(f"{second} steps")
    assert told == ["2 steps, at most 58 s left", "4 steps, at most 56 s left"]
    assert [line.what for line in told] == ["2 steps", "4 steps"]


def test_compiling_uses_no_time_of_a_limit() -> None:
    """The first plan on a fresh machine compiles for longer than it plans."""
    started, before = time.monotonic(), compiling_seconds(time.monotonic)
    clock, still = Clock(60.0), Clock(60.0, timer=lambda: 0.0)
    assert njit(lambda x: x + 1.0)(2.0) == 3.0
    spent, compiled = clock.spent, compiling_seconds(time.monotonic) - before
    assert compiled > 0.0
    assert 0.0 <= spent <= time.monotonic() - started - compiled
    assert still.spent == 0.0


def told_of(monkeypatch: pytest.MonkeyPatch, wanted: np.ndarray, **options: object) -> list[str]:
    """Everything that the exact planner tells, however soon."""
    monkeypatch.setattr(linear_programs, "EVERY", 0.0)
    told: list[str] = []
    plan_exact(wanted, KIT, progress=told.append, **options)  # pyright: ignore[reportArgumentType]
    return told


def test_the_exact_planner_tells_its_phases_and_the_best_so_far(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    told = told_of(monkeypatch, np.ones((6, 2, 5), bool))
    assert all(isinstance(line, Detail) and line.endswith(" s left") for line in told)
    assert any(line.startswith("choosing blocks: level 3 of 5, ") for line in told)
    proving = [line for line in told if line.startswith("proving the order: ")]
    steps = [int(line.split(": ")[1].split()[0]) for line in proving]
    assert steps == sorted(steps)
    assert steps[-1] >= 5
    assert "the weakest withstands 0.000 g" not in proving[-1]
    assert any(line.startswith("how wide joints may be: ") for line in told)


def test_tilings_and_props_that_are_tried_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    table = np.zeros((8, 4, 4), bool)
    table[:, :, 3] = True
    table[:2, :, :3] = True
    told = told_of(monkeypatch, table)
    assert any(line.startswith("tiling 1 of at most ") for line in told)
    wide = "looking for blocks that stand: tiling 1 of at most "
    assert any(line.startswith(wide) and " blocks fall" in line for line in told)
    bridge = np.zeros((6, 1, 3), bool)
    bridge[[0, -1], :, :2] = True
    bridge[:, :, 2] = True
    assert any("choosing props for " in line for line in told_of(monkeypatch, bridge))


def test_build_hands_details_on(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of designs and of goals."""
    monkeypatch.setattr(linear_programs, "EVERY", 0.0)
    told: list[str] = []
    l2a.build(np.ones((4, 2, 3), bool), progress=told.append)
    assert any(line.startswith("proving the order: ") for line in told)
    told.clear()
    l2a.build(Path("examples/goals/over_the_water.json"), seconds=20, progress=told.append)
    assert any("best so far: " in line for line in told)


def test_a_terminal_shows_details_in_the_line_that_beats(monkeypatch: pytest.MonkeyPatch) -> None:
    shown = Terminal()
    monkeypatch.setattr(sys, "stderr", shown)
    monkeypatch.setattr(output, "QUIET", 0.0)
    with output.Heartbeat("working", 60.0) as beat:
        said = output.Output(False, beat)
        said.progress(Detail("12 steps", 50.0))
        assert "12 steps\n" not in shown.getvalue()
        while "l2a: 12 steps ... " not in shown.getvalue():
            time.sleep(0.01)
    assert "at most 50 s" not in shown.getvalue()  # The beat says what is left.
