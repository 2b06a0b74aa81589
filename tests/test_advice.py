"""What is advised was tried; where nothing helps, nothing is advised."""

from __future__ import annotations

import numpy as np

from l2a_lab import shapes
from learn2assemble.assembly.kit import load_kit
from learn2assemble.design.cells import CellDesign
from learn2assemble.planning.tiling.advice import NO_ADVICE, _trials, fill_below, pool
from learn2assemble.planning.tiling.construct import plan_cells
from learn2assemble.planning.tiling.exact import plan_exact
from learn2assemble.planning.tiling.tile import Tiling

CELL = (0.05, 0.05, 0.05)


def refused(wanted: np.ndarray, kit: str) -> str:
    design = CellDesign("drawn", wanted, CELL, None, 0.0, None, "test", None)
    plan = plan_cells(design, load_kit(kit).at_pitch(CELL), seconds=600)
    assert plan.status in ("refused", "not found")
    assert plan.reason is not None
    return plan.reason


def test_a_kit_that_is_advised_builds_the_design() -> None:
    gate = shapes.wall(8, 1, 6, (2, 6, 0, 4))
    reason = refused(gate, "cubes")
    name = reason.rsplit("; kit `", 1)[1].split("`")[0]
    tiling, ordering = plan_exact(gate, load_kit(name).at_pitch(CELL))
    assert (ordering or tiling).status == "complete"


def test_a_wide_overhang_is_filled_or_nothing_is_advised() -> None:
    """A plate of 9 x 9 cells on one cell: no kit, no joint carries it."""
    wanted = np.zeros((9, 9, 2), bool)
    wanted[4, 4, 0] = wanted[:, :, 1] = True
    reason = refused(wanted, "bricks")
    filled = fill_below(wanted, np.argwhere(wanted))
    more = int(filled.sum() - wanted.sum())
    assert f"filled ({more} cells more) it stands" in reason or NO_ADVICE in reason
    tiling, ordering = plan_exact(filled, load_kit("bricks").at_pitch(CELL))
    stands = (ordering or tiling).status == "complete"
    assert stands == (NO_ADVICE not in reason)


def test_a_ball_is_tried_on_a_flat_base() -> None:
    x, y, z = np.meshgrid(*[np.arange(9)] * 3, indexing="ij")
    ball = (x - 4) ** 2 + (y - 4) ** 2 + (z - 4) ** 2 <= 17
    trials = {text: cells for text, cells, *_ in _trials(Tiling((), ball), load_kit("bricks"), {})}
    text = "without its lowest 1 level, on a flat base, it stands"
    assert np.array_equal(trials[text], ball[:, :, 1:])
    wall = np.ones((4, 1, 4), bool)
    trials = {text: cells for text, cells, *_ in _trials(Tiling((), wall), load_kit("bricks"), {})}
    assert not any("flat base" in text for text in trials)


def test_larger_cells_are_tried_and_longer_blocks_span_more() -> None:
    """A bar of eight cells bridges eight cells of this size only where cells are twice as large."""
    gate = shapes.wall(16, 1, 4, (3, 13, 0, 2))
    kit = load_kit("bricks-lintels")
    trials = {text: rest for text, *rest in _trials(Tiling((), gate), kit, {})}
    cells, larger, _ = trials["with cells twice as large it stands"]
    assert (cells.shape, larger.pitch) == ((8, 1, 2), (0.1, 0.1, 0.1))
    assert (pool(np.ones((3, 1, 3), bool)).shape) == (2, 1, 2)
    tiling, ordering = plan_exact(cells, larger)
    assert (ordering or tiling).status == "complete"
    tiling, ordering = plan_exact(gate, kit)
    assert (ordering or tiling).status != "complete"
