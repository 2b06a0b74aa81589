"""What numbers alone rule out is refused before any program is asked."""

from __future__ import annotations

import numpy as np
import pytest

from learn2assemble.assembly.kit import load_kit
from learn2assemble.errors import InputError
from learn2assemble.planning.tiling import exact
from learn2assemble.planning.tiling.exact import plan_exact


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
