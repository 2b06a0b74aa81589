"""What is advised was tried; where nothing helps, nothing is advised. What is refused at once."""

from __future__ import annotations

import numpy as np
import pytest

from l2a_lab import shapes
from learn2assemble.assembly.kit import load_kit
from learn2assemble.design.cells import CellDesign
from learn2assemble.errors import InputError
from learn2assemble.planning.tiling import exact
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


# What numbers alone rule out is refused before any program is asked.


def no_program(*_: object, **__: object) -> None:
    """In place of the tiler."""
    raise AssertionError("a program was asked")


@pytest.mark.parametrize(
    ("shape", "kit", "words"),
    [
        ((64, 64, 36), "bricks", "at least 18432 blocks"),
        ((64, 62, 8), "cubes", "at least 31744 blocks"),
    ],
)
def test_designs_of_too_many_blocks_are_refused_at_once(
    shape: tuple[int, int, int], kit: str, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(exact, "tile", no_program)
    with pytest.raises(InputError, match=words):
        plan_exact(np.ones(shape, bool), load_kit(kit))


@pytest.mark.parametrize(
    ("shape", "words"),
    [
        ((11, 29, 4), "multiple of 4 cells; a part of level 0 has 319"),
        ((13, 11, 1), "multiple of 4 cells; the design has 143"),
    ],
)
def test_numbers_of_cells_are_looked_at_first(
    shape: tuple[int, int, int], words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """319 tetrominoes that are one cell high, in levels of which none can be filled."""
    monkeypatch.setattr(exact, "tile", no_program)
    tiling, ordering = plan_exact(np.ones(shape, bool), load_kit("tetrominoes"))
    assert (tiling.status, ordering) == ("refused", None)
    assert words in tiling.reason


def test_small_parts_are_left_to_the_program_which_says_which_cells() -> None:
    wanted = np.ones((7, 3, 4), bool)
    tiling, _ = plan_exact(wanted, load_kit("tetrominoes"))
    assert tiling.status == "refused"
    assert 0 < len(tiling.missing) < wanted.sum()
