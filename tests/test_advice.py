"""What is advised was tried; where nothing helps, nothing is advised."""

from __future__ import annotations

import numpy as np

from learn2assemble.assembly.kit import load_kit
from learn2assemble.design.cells import CellDesign
from learn2assemble.planning.advice import NO_ADVICE, fill_below
from learn2assemble.planning.construct import plan_cells
from learn2assemble.planning.exact import plan_exact
from learn2assemble.reproduction import shapes

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
