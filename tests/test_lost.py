"""What is said where cells cannot show a feature of a drawing."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from learn2assemble.design.cells import CellDesign
from learn2assemble.design.read import read_design


def _read(folder: Path, path: str, **options: float) -> CellDesign:
    file = folder / "drawing.svg"
    file.write_text(
        '<svg xmlns="http://www.w3.org/2000/svg" width="500mm" height="500mm" '
        f'viewBox="0 0 500 500"><path fill-rule="evenodd" d="{path}"/></svg>'
    )
    found = read_design(file, **options)
    assert isinstance(found, CellDesign)
    return found


WINDOW = "M100 500V100H300V500Z M175 200H225V300H175Z"
"""A window across the middle of four cells of 50 mm, half of each."""
TEETH = "M50 500V300H90V340H130V300H170V340H210V300H250V500Z"


@pytest.mark.parametrize(
    ("path", "words"),
    [
        (WINDOW, "an opening of 50 × 100 mm"),
        (TEETH, "40 × 40 mm"),
    ],
)
def test_what_vanishes_is_said_and_the_cell_that_is_advised_shows_it(
    tmp_path: Path, path: str, words: str
) -> None:
    note = _read(tmp_path, path).note
    assert note.startswith("not shown by the cells: ")
    assert words in note
    advised = re.search(r"shown by cells of ([0-9.]+) mm$", note)
    assert advised is not None
    assert not _read(tmp_path, path, cell=float(advised[1]) / 1000).note


@pytest.mark.parametrize(
    "path",
    [
        "M100 500V100H300V500Z M150 200H250V300H150Z",  # on the lattice
        "M50 500A200 200 0 0 1 450 500Z",  # round
        "M50 500L250 100L450 500Z",  # slopes
        "M50 500L50 480L450 150V500Z",
        "M60 500V117H333V500Z",  # off the lattice by parts of a cell
    ],
)
def test_what_every_lattice_does_to_an_edge_is_not_called_lost(tmp_path: Path, path: str) -> None:
    assert not _read(tmp_path, path).note


def test_a_part_that_vanishes_is_one(tmp_path: Path) -> None:
    """A chimney that stands on the line between two cells."""
    note = _read(tmp_path, "M50 500V300H282V180H318V300H450V500Z").note
    assert "a part of 36 × 120 mm" in note


def test_a_narrow_slit_that_vanishes_is_an_opening(tmp_path: Path) -> None:
    note = _read(tmp_path, "M100 500V100H300V500Z M190 200H205V300H190Z").note
    assert "an opening of 15 × 100 mm" in note


@pytest.mark.parametrize(
    ("path", "advised"),
    [
        ("M100 500V100H300V500Z M180 180H240V340H180Z", 20.0),  # multiples of 20 mm
        ("M100 500V140H340V500H100Z", 60.0),  # larger than the cell
        ("M100 500V150H300V500Z", None),  # on the cells
        ("M107 500V100H307V500Z", None),  # on the cells, which may be moved along the wall
        ("M100 500V173H304V500Z", None),  # no common measure
        ("M100 500V120H320L300 500Z", None),  # a slope
    ],
)
def test_cells_that_show_all_of_a_drawing_are_named_and_show_it(
    tmp_path: Path, path: str, advised: float | None
) -> None:
    note = _read(tmp_path, path).note
    found = re.search(r"cells of ([0-9.]+) mm show all of it$", note)
    assert (float(found[1]) if found else None) == advised
    if advised:
        again = _read(tmp_path, path, cell=advised / 1000)
        assert again.iou == pytest.approx(1.0, abs=1e-6)
        assert not again.note
