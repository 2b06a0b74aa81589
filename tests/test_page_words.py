"""What page, cards and terminal say of a plan is true, and can be read one way only."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from html import unescape
from pathlib import Path

import numpy as np
import pytest

import learn2assemble as l2a
from learn2assemble.cli.commands import _print_plan
from learn2assemble.cli.output import Output
from learn2assemble.constants import GRAVITY
from learn2assemble.planning.plan import Plan
from learn2assemble.viewer.page import write_plan_page
from learn2assemble.viewer.words import weakest_words


@cache
def gate(friction: float | tuple[float, float] | None = None) -> Plan:
    """Two piers and what lies across them."""
    wanted = np.ones((4, 1, 3), bool)
    wanted[1:3, :, :2] = False
    return l2a.build(wanted, kit="bricks-lintels", friction=friction)


def facts(plan: Plan, folder: Path) -> dict[str, str]:
    """The tiles of a page, by name."""
    write_plan_page(plan, folder / "view.html")
    text = (folder / "view.html").read_text(encoding="utf-8")
    found = re.findall(r"<dt>(.*?)</dt><dd><span[^>]*>(.*?)</span>", text)
    return {unescape(name): unescape(value) for name, value in found}


def test_newtons_stand_beside_the_step_they_belong_to(tmp_path: Path) -> None:
    """The weakest step in g is not the one that withstands fewest newtons."""
    plan = gate()
    assert plan.assembly is not None
    steps = tuple(
        replace(step, margin_g=0.3 if step.step < len(plan.steps) else 0.1) for step in plan.steps
    )
    told = facts(replace(plan, steps=steps), tmp_path)
    last = len(steps)
    assert told["weakest step"] == f"step {last}: 0.100 g sideways at friction 0.5"
    first = plan.assembly.block(plan.assembly.steps[0].block).mass
    total = sum(block.mass for block in plan.assembly.blocks)
    assert 0.3 * first < 0.1 * total, "a push on little is a small one"
    push = f"{0.3 * first * GRAVITY:.2g}"
    assert told["least push withstood"] == f"{push} N sideways, after step 1"


@pytest.mark.parametrize(("asked", "least"), [(None, "0.5"), (0.1, "0.1"), ((0.2, 0.4), "0.2")])
def test_a_margin_is_told_with_its_friction(
    asked: float | tuple[float, float] | None,
    least: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    plan = gate(asked)
    assert weakest_words(plan).endswith(f" g sideways at friction {least}")
    assert facts(plan, tmp_path)["weakest step"] == weakest_words(plan)
    page = (tmp_path / "view.html").read_text(encoding="utf-8")
    assert f", friction {least}." in page
    assert f"withstands after the step at friction {least}, in newtons" in page
    _print_plan(Output(as_json=False), plan, {})
    assert f"the weakest is {weakest_words(plan)}\n" in capsys.readouterr().out


def test_a_plan_without_margins_names_no_weakest_step() -> None:
    plan = gate()
    bare = tuple(replace(step, margin_g=None) for step in plan.steps)
    assert not weakest_words(replace(plan, steps=bare))
