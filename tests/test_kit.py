"""Kits of blocks: reading them strictly, and turning their kinds."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from learn2assemble.assembly.kit import (
    Kind,
    Kit,
    kit_names,
    load_kit,
    orientations,
    parse_kit,
    turned_cells,
)
from learn2assemble.errors import InputError, UnknownNameError

HEAD = 'format = "learn2assemble-kit"\nversion = 1\nname = "mine"\n'
BRICK = '[[kinds]]\nname = "1x2"\nbox = [2, 1, 1]\n'
L_TETRACUBE = ((0, 0, 0), (0, 1, 0), (1, 0, 0), (2, 0, 0))


def test_built_in_kits_are_read_and_named_as_their_files() -> None:
    dry = ("bricks", "bricks-lintels", "cubes", "planks", "tetrominoes")
    assert kit_names() == tuple(sorted((*dry, "bricks-mortar", "duplo", "lego")))
    assert not any(load_kit(name).joint.holds for name in dry)
    for name in kit_names():
        assert load_kit(name).name == name
    assert [kind.name for kind in load_kit("bricks").kinds] == ["1x1", "1x2", "1x4", "2x2", "2x4"]
    names = {kind.name for kind in load_kit("bricks-lintels").kinds}
    assert {"1x3", "1x5", "1x6", "2x6", "1x8", "2x8"} <= names
    plank = load_kit("planks").kinds[0]
    assert tuple(np.max(plank.cells, 0) + 1) == (15, 3, 1)


def test_a_kit_file_says_it_all(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(
        HEAD + "pitch = [0.02, 0.02, 0.01]\ndensity = 600\nfriction = 0.4\njoint_gap = 0.001\n"
        '[[kinds]]\nname = "corner"\ncells = [[2, 1, 0], [1, 1, 0], [1, 2, 0]]\ncount = 3\n'
        'colour = "#0a0B0c"\ndensity = 700.5\nturns = "none"\n'
    )
    kit = load_kit(path)
    assert kit.pitch == (0.02, 0.02, 0.01)
    assert (kit.density, kit.friction, kit.joint_gap, kit.limited) == (600.0, 0.4, 0.001, True)
    corner = Kind("corner", ((0, 0, 0), (0, 1, 0), (1, 0, 0)), 3, (10, 11, 12), 700.5, "none")
    assert kit.kinds == (corner,)
    assert load_kit(str(path)) == kit


def test_a_short_kit_file_is_the_long_one(tmp_path: Path) -> None:
    """Only kinds are needed: the head, and names, are those that everybody would give."""
    path = tmp_path / "short.toml"
    path.write_text("kinds = [{box = [1, 1, 1], count = 9}, {box = [4, 2, 1]}, {box = [2, 1, 3]}]")
    kit = load_kit(path)
    assert (kit.name, kit.pitch) == ("short", Kit.pitch)
    assert [(kind.name, kind.count) for kind in kit.kinds] == [
        *(("1x1", 9), ("2x4", None), ("1x2x3", None)),
    ]
    head = HEAD.replace("mine", "short")
    assert parse_kit(head + path.read_text()) == kit


@pytest.mark.parametrize(
    ("content", "named"),
    [
        ("pitch =", "TOML"),
        (HEAD, "kinds"),
        (HEAD + "kinds = []\n", "kinds"),
        (HEAD + "kinds = 3\n", "kinds"),
        (HEAD + "kinds = [3]\n", "kinds[0]"),
        (HEAD.replace("learn2assemble-kit", "other") + BRICK, "format"),
        (HEAD.replace("version = 1", "version = 2") + BRICK, "version"),
        (HEAD + "colour = 3\n" + BRICK, "colour"),
        (HEAD + "pitch = [0.05, 0.05]\n" + BRICK, "pitch"),
        (HEAD + "pitch = [0.05, 0.05, nan]\n" + BRICK, "pitch"),
        (HEAD + "pitch = [0.05, 0.05, -0.05]\n" + BRICK, "pitch"),
        (HEAD + "friction = inf\n" + BRICK, "friction"),
        (HEAD + "density = 0\n" + BRICK, "density"),
        (HEAD + "joint_gap = 0.03\n" + BRICK, "joint_gap"),
        (HEAD + BRICK + BRICK, "1x2"),
        (HEAD + BRICK + "cells = [[0, 0, 0]]\n", "got 'both', expected either 'box' or"),
        (HEAD + '[[kinds]]\nname = "a"\n', "got 'neither', expected either 'box' or"),
        (HEAD + "[[kinds]]\ncells = [[0, 0, 0]]\n", "the key 'name'"),
        (HEAD + "[[kinds]]\nbox = [2, 1, 1]\n" + BRICK, "every name once"),
        ("", "the key 'kinds'"),
        (HEAD + '[[kinds]]\nname = ""\nbox = [1, 1, 1]\n', "name"),
        (HEAD + '[[kinds]]\nname = "a"\nbox = [0, 1, 1]\n', "box"),
        (HEAD + '[[kinds]]\nname = "a"\nbox = [1.5, 1, 1]\n', "box"),
        (HEAD + '[[kinds]]\nname = "a"\nbox = [64, 64, 64]\n', "512"),
        (HEAD + '[[kinds]]\nname = "a"\ncells = []\n', "cells"),
        (HEAD + '[[kinds]]\nname = "a"\ncells = [[0, 0, 0], [0, 0, 0]]\n', "once"),
        (HEAD + '[[kinds]]\nname = "a"\ncells = [[0, 0, 0], [2, 0, 0]]\n', "hang together"),
        (
            HEAD + '[[kinds]]\nname = "a"\ncells = [[1,0,0],[0,0,0],[0,1,0],[0,2,0],[1,2,0],'
            "[2,2,0],[2,1,0]]\n",
            "edge alone",
        ),
        (HEAD + BRICK + "count = -1\n", "count"),
        (HEAD + BRICK + "count = true\n", "count"),
        (HEAD + BRICK + "density = '1'\n", "density"),
        (HEAD + BRICK + "colour = 'red'\n", "colour"),
        (HEAD + BRICK + "colour = [1, 2, 300]\n", "colour"),
        (HEAD + BRICK + "turns = 'y'\n", "turns"),
        (HEAD + BRICK + "weight = 3\n", "weight"),
        ("[" * 100_000, "TOML"),
    ],
)
def test_a_bad_kit_is_refused_in_one_line_that_names_the_fault(content: str, named: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_kit(content, "kit.toml")
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith("kit.toml")
    assert named in message


def test_unknown_names_and_missing_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match="bricks"):
        load_kit("brick")
    with pytest.raises(InputError, match="no such file"):
        load_kit(tmp_path / "none.toml")
    with pytest.raises(UnknownNameError, match="1x2"):
        load_kit("bricks").kind("1x3")


def test_orientations_are_those_that_differ_and_fit_the_lattice() -> None:
    def number(cells: tuple[tuple[int, int, int], ...], turns: str, *pitch: float) -> int:
        kit = Kit("k", (Kind("a", cells, turns=turns),), pitch or (1.0, 1.0, 1.0))
        return len(orientations(kit))

    bar = ((0, 0, 0), (1, 0, 0))
    assert number(((0, 0, 0),), "any") == 1
    assert [number(bar, turns) for turns in ("none", "z", "any")] == [1, 2, 3]
    assert [number(L_TETRACUBE, turns) for turns in ("none", "z", "any")] == [1, 4, 24]
    assert number(bar, "any", 1.0, 1.0, 0.5) == 2
    assert number(L_TETRACUBE, "any", 1.0, 2.0, 1.0) == 2


@settings(max_examples=50, deadline=None)
@given(
    cells=st.sets(st.tuples(*[st.integers(0, 3)] * 3), min_size=1, max_size=8),
    turn=st.integers(0, 23),
)
def test_a_turn_is_a_rotation(cells: set[tuple[int, int, int]], turn: int) -> None:
    before = np.array(sorted(cells))
    after = np.array(turned_cells(tuple(sorted(cells)), turn))
    assert after.min(0).tolist() == [0, 0, 0]
    assert sorted(np.ptp(after, 0)) == sorted(np.ptp(before, 0))
    # Distances and handedness are kept: the moments of a rotated body have the same invariants.
    first, second = (x - x.mean(0) for x in (before, after))
    assert np.allclose(
        np.linalg.eigvalsh(first.T @ first), np.linalg.eigvalsh(second.T @ second), atol=1e-9
    )


def test_turns_never_mirror() -> None:
    mirrored = tuple(sorted((2 - x, y, z) for x, y, z in L_TETRACUBE))
    flat = {turned_cells(L_TETRACUBE, turn) for turn in range(4)}
    assert mirrored not in flat
    # A chiral body in three dimensions: no rotation makes it its mirror image.
    screw = ((0, 0, 0), (1, 0, 0), (1, 1, 0), (1, 1, 1))
    other = tuple(sorted((1 - x, y, z) for x, y, z in screw))
    assert other not in {turned_cells(screw, turn) for turn in range(24)}
