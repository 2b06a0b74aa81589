"""Designs of cells built with bricks that clutch."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import learn2assemble as l2a
from learn2assemble.assembly.kit import load_kit
from learn2assemble.errors import InputError
from learn2assemble.planning.plan import Plan
from test_brick_order import replay


def corbel() -> np.ndarray:
    """Each layer reaches a cell farther."""
    wanted = np.zeros((10, 2, 6), bool)
    for z in range(6):
        wanted[: 4 + z, :, z] = True
    return wanted


def tree() -> np.ndarray:
    wanted = np.zeros((7, 7, 6), bool)
    wanted[3, 3, :4] = True
    wanted[2:5, 2:5, [0, 4]] = True
    wanted[1:6, 3, 3] = wanted[3, 1:6, 3] = True
    wanted[1:6, 1:6, 5] = True
    return wanted


def letter() -> np.ndarray:
    wanted = np.zeros((9, 2, 8), bool)
    wanted[3:6] = True
    wanted[:, :, 6:] = True
    return wanted


def filled(plan: Plan, shape: tuple[int, int, int]) -> np.ndarray:
    """How many blocks are in every cell, from their corners."""
    assert plan.assembly is not None
    assert plan.design.cell is not None
    cell = np.array(plan.design.cell)
    count = np.zeros(shape, int)
    for block in plan.assembly.blocks:
        low, high = (
            np.round(end / cell + [shape[0] / 2, shape[1] / 2, 0]).astype(int)
            for end in (block.vertices.min(0), block.vertices.max(0))
        )
        count[low[0] : high[0], low[1] : high[1], low[2] : high[2]] += 1
    return count


@pytest.mark.parametrize("make", [corbel, tree, letter])
def test_what_dry_blocks_do_not_hold_is_built(make) -> None:
    wanted = make()
    plan = l2a.build(wanted, kit="lego")
    assert plan.status == "complete"
    assert plan.kit == "lego"
    assert plan.design.cell == pytest.approx((0.008, 0.008, 0.0096))
    assert (filled(plan, wanted.shape) == wanted).all()
    assert plan.cells is not None
    assert (plan.cells.wanted, plan.cells.missing) == (int(wanted.sum()), 0)
    replay(plan)


def test_a_hollow_body_has_walls_as_thick_as_asked() -> None:
    wanted = np.ones((7, 7, 6), bool)
    plan = l2a.build(wanted, kit="lego", shell=2)
    count = filled(plan, (7, 7, 6))
    assert (count[2:5, 2:5, 2:4] == 0).all()
    assert count.sum() == 7 * 7 * 6 - 3 * 3 * 2
    assert plan.status == "complete"
    assert plan.cells is not None
    assert plan.cells.wanted == count.sum()


def test_cells_that_reach_nothing_are_refused() -> None:
    wanted = np.zeros((9, 9, 2), bool)
    wanted[3:6, 3:6, 0] = wanted[:, :, 1] = True
    plan = l2a.build(wanted, kit="lego", seconds=3)
    assert plan.status == "refused"
    assert "however strong their joints" in (plan.reason or "")


def test_colours_are_those_of_most_cells() -> None:
    wanted = np.ones((2, 2, 2), bool)
    colours = np.zeros((2, 2, 2, 3), np.uint8)
    colours[:, :, 1] = (201, 26, 9)
    plan = l2a.build(wanted, kit="lego", colours=colours)
    assert plan.assembly is not None
    assert {b.colour for b in plan.assembly.blocks} == {(0, 0, 0), (201, 26, 9)}


def test_what_bricks_do_not_take_is_refused() -> None:
    wanted = np.ones((2, 2, 2), bool)
    wrong: tuple[tuple[dict[str, Any], str], ...] = (
        ({"cell": 0.02}, "cells of kit lego"),
        ({"gap": 0.001}, "clutch"),
        ({"supports": "props"}, "hands: bricks"),
        ({"arm": "panda", "tool": "suction"}, "does not hold on studs"),
        ({"shell": 0}, "from 1 to 64"),
    )
    for words, message in wrong:
        with pytest.raises(InputError, match=message):
            l2a.build(wanted, kit="lego", **words)
    with pytest.raises(InputError, match="kit that clutches"):
        l2a.build(wanted, kit="bricks", shell=2)
    lego = load_kit("lego")
    few = replace(lego, kinds=tuple(replace(kind, count=3) for kind in lego.kinds))
    with pytest.raises(InputError, match="without counts"):
        l2a.build(wanted, kit=few)
    large = replace(lego, kinds=tuple(kind for kind in lego.kinds if kind.name != "1x1"))
    with pytest.raises(InputError, match="the brick 1x1"):
        l2a.build(wanted, kit=large)
