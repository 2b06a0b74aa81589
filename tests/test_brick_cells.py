"""Designs of cells built with bricks that clutch."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.sparse.csgraph import dijkstra

import learn2assemble as l2a
from learn2assemble.assembly.kit import load_kit
from learn2assemble.cli import main
from learn2assemble.errors import InputError
from learn2assemble.export.formats import export_assembly
from learn2assemble.linear_programs import Clock
from learn2assemble.planning.plan import Plan
from learn2assemble.planning.tiling.cover.bearing import NO_WAY, least_ways
from learn2assemble.planning.tiling.cover.bricks import _Tiler
from learn2assemble.planning.tiling.cover.linked import LayerCells, NoCover, linked_cover
from learn2assemble.planning.tiling.cover.slabs import slabs_of
from learn2assemble.statics.holding.program import Balance
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


def hook() -> np.ndarray:
    """A part hangs from a beam: only hands put it there, which help unasked."""
    wanted = np.zeros((6, 2, 4), bool)
    wanted[:2] = wanted[:, :, 3] = True
    wanted[4:, :, 2] = True
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


@pytest.mark.parametrize("make", [corbel, tree, letter, hook])
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
    assert "of the bricks hang together with nothing that stands" in (plan.reason or "")


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


# ---------------------------------------------------------------- plates


def slope(wide: int = 8, deep: int = 2) -> np.ndarray:
    """Cells as high as a plate; the top falls by a plate a stud."""
    wanted = np.zeros((wide, deep, wide + 4), bool)
    for x in range(wide):
        wanted[x, :, : wide + 4 - x] = True
    return wanted


@pytest.mark.parametrize("seed", range(4))
def test_every_cell_is_in_one_slab_and_bricks_go_before_plates(seed: int) -> None:
    wanted = np.random.default_rng(seed).random((5, 4, 14)) < 0.8
    count, plates = np.zeros(wanted.shape, int), np.zeros(wanted.shape, bool)
    for low, high, cells in slabs_of(wanted, 3):
        assert high - low in (1, 3)
        count[:, :, low:high][cells] += 1
        plates[:, :, low] |= cells & (high - low == 1)
    assert (count == wanted).all()
    assert plates.any()
    assert not (plates[:, :, :-2] & plates[:, :, 1:-1] & plates[:, :, 2:]).any()


def test_layers_of_bricks_begin_where_the_fewest_plates_are_left() -> None:
    for first in range(3):
        levels = [low for low, high, _ in slabs_of(np.ones((2, 2, first + 9), bool), 3)]
        assert len(levels) == 3 + first
    on_a_plate = np.zeros((6, 6, 10), bool)
    on_a_plate[:, :, 0] = on_a_plate[1:5, 1:5] = True
    heights = [high - low for low, high, _ in slabs_of(on_a_plate, 3)]
    assert heights == [1, 3, 3, 3]


@pytest.mark.parametrize("make", [corbel, tree, letter])
def test_without_need_of_plates_it_is_as_without_them(make) -> None:
    with_, without = (
        l2a.build(cells, kit="lego", plates=plates)
        for cells, plates in ((make().repeat(3, 2), True), (make(), False))
    )
    assert with_.assembly is not None
    assert without.assembly is not None
    for one, other in zip(with_.assembly.blocks, without.assembly.blocks, strict=True):
        assert (one.id, one.kind) == (other.id, other.kind)
        assert np.array_equal(one.vertices, other.vertices)
    assert [(s.action, s.block) for s in with_.steps] == [
        (s.action, s.block) for s in without.steps
    ]


def test_a_slope_gets_plates(tmp_path: Path) -> None:
    wanted = slope()
    plan = l2a.build(wanted, kit="lego", plates=True)
    assert plan.status == "complete"
    assert plan.design.cell == pytest.approx((0.008, 0.008, 0.0032))
    assert (filled(plan, wanted.shape) == wanted).all()
    replay(plan)
    assert plan.assembly is not None
    kinds = [block.kind for block in plan.assembly.blocks]
    plates = [kind for kind in kinds if kind.startswith("plate ")]
    assert 0 < len(plates) < len(kinds)
    again = l2a.read_assembly(export_assembly(plan.assembly, "ldraw", tmp_path / "slope.ldr"))
    assert sorted(block.kind for block in again.blocks) == sorted(kinds)
    assert again.steps, "the order is in the file"


def test_cells_as_high_as_a_plate_ask_for_plates(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wanted = slope(5)
    plan = l2a.build(wanted, kit="lego", plates=True)
    by_cell = l2a.build(wanted, kit="lego", cell=(0.008, 0.008, 0.0032))
    assert by_cell.assembly is not None
    assert plan.assembly is not None
    assert [b.kind for b in by_cell.assembly.blocks] == [b.kind for b in plan.assembly.blocks]
    # 16 mm wide and 12.8 mm high: a brick and a plate.
    drawing = tmp_path / "low.svg"
    drawing.write_text(
        '<svg xmlns="http://www.w3.org/2000/svg" width="32mm" height="12.8mm" '
        'viewBox="0 0 32 12.8"><path d="M0 0H32V12.8H0Z"/></svg>'
    )
    asked = ["build", str(drawing), "--plates", "--out"]
    assert main([*asked, str(tmp_path / "out"), "--kit", "lego"]) == 0
    told = capsys.readouterr().out
    assert "plate 1x4" in told
    assert "100%" in told
    assert main([*asked, str(tmp_path / "dry"), "--kit", "bricks"]) == 2
    assert "a kit of bricks that clutch" in capsys.readouterr().err
    lego = load_kit("lego")
    few = replace(lego, kinds=tuple(kind for kind in lego.kinds if kind.name != "plate 1x1"))
    with pytest.raises(InputError, match="the plate 1x1"):
        l2a.build(wanted, kit=few, plates=True)


def test_walls_of_a_hollow_body_are_as_thick_up_as_along() -> None:
    plan = l2a.build(np.ones((7, 7, 18), bool), kit="lego", shell=2, plates=True)
    assert (filled(plan, (7, 7, 18))[2:5, 2:5, 6:12] == 0).all()
    assert plan.cells is not None
    assert plan.cells.wanted == 7 * 7 * 18 - 3 * 3 * 6


def ball(wide: int) -> np.ndarray:
    """Cells of a ball, 1.2 times as high as wide."""
    axis = np.arange(wide) - (wide - 1) / 2
    high = np.arange(round(wide / 1.2)) * 1.2 - (wide - 1.2) / 2
    x, y, z = np.meshgrid(axis, axis, high, indexing="ij")
    return x**2 + y**2 + z**2 <= (wide / 2) ** 2


@cache
def hollow_ball() -> tuple[Plan, int]:
    """The plan of a ball of many bricks, and how often forces were found anew for it."""
    asked: list[int] = []
    stands = Balance.stands

    def counted(self: Balance, *args: Any, **words: Any) -> bool:
        asked.append(1)
        return stands(self, *args, **words)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Balance, "stands", counted)
        return l2a.build(ball(24), kit="lego", shell=2, hands=True), len(asked)


def test_a_hollow_ball_is_proven_from_forces_of_states_near() -> None:
    """Pushes of contact points alone do not carry it; with level forces all states follow."""
    plan, asked = hollow_ball()
    assert plan.status == "complete"
    assert plan.blocks.used > 500
    assert asked < plan.blocks.used / 10


@pytest.mark.parametrize("seed", range(12))
def test_ways_to_the_ground_are_the_shortest_there_are(seed: int) -> None:
    """Of one layer, by another library; and no brick's are shorter than if layers were whole."""
    rng = np.random.default_rng(seed)
    cells, below = rng.random((7, 9)) < 0.6, rng.integers(0, 6, (7, 9)).astype(float)
    below[rng.random(below.shape) < 0.7] = NO_WAY
    numbers = np.arange(cells.size).reshape(cells.shape)
    graph = sp.lil_matrix((cells.size + 1, cells.size + 1))
    for here, there in [(np.s_[:-1], np.s_[1:]), (np.s_[:, :-1], np.s_[:, 1:])]:
        both = cells[here] & cells[there]
        graph[numbers[here][both], numbers[there][both]] = 1.0
    borne = cells & (below < NO_WAY)
    graph[numbers[borne], cells.size] = below[borne] + 1.0  # A way of zero would be none.
    shortest = dijkstra(graph.tocsr(), directed=False, indices=cells.size)[:-1] - 1.0
    expected = np.where(np.isfinite(shortest), shortest, NO_WAY).reshape(cells.shape)
    assert (least_ways(below, cells) == np.where(cells, expected, NO_WAY)).all()


def test_bricks_that_are_far_from_the_ground_are_covered_anew() -> None:
    """A slab on pillars: it never costs more than as it was covered at first, and often less."""
    first, then = [], []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        wanted = np.zeros((14, 14, 2), bool)
        wanted[:, :, 0] = rng.random((14, 14)) < 0.08
        wanted[2:12, 2:12, 1] = True
        costs = first, then
        for cost, seconds in zip(costs, (0.0, 60.0), strict=True):
            tiler = _Tiler(wanted, load_kit("lego"), np.random.default_rng(seed))
            tiler.fill(Clock(seconds))
            cost.append(sum(1.0 + tiler._cost(b) for b in tiler.bricks))
            assert (tiler._ways >= tiler._least).all()
            assert ((tiler.owner >= 0) == wanted).all()
    assert all(b <= a for a, b in zip(first, then, strict=True))
    assert sum(then) < sum(first)


def test_a_ball_of_many_bricks_is_taken_apart_layer_by_layer() -> None:
    plan, _ = hollow_ball()
    assert plan.assembly is not None
    tops = {block.id: float(block.vertices[:, 2].max()) for block in plan.assembly.blocks}
    highest = 0.0
    for step in plan.assembly.steps:
        if step.action == "place":
            assert tops[step.block] > highest - 3.5 * 9.6e-3
            highest = max(highest, tops[step.block])


def test_a_tree_that_chance_does_not_join_is_joined() -> None:
    """Single layers that reach out: few covers link all of their bricks."""
    wanted = np.zeros((14, 14, 7), bool)
    wanted[6:8, 6:8] = wanted[4:9, 6:8, 2] = wanted[6:8, 8:12, 2] = True
    wanted[6:8, 2:8, 3] = wanted[5:11, 6:8, 3] = wanted[5:8, 5:10, 3] = True
    wanted[6:11, 6:8, 4:6] = wanted[4:9, 6:9, 6] = True
    plan = l2a.build(wanted, kit="lego", hands=True)
    assert plan.complete
    assert (filled(plan, wanted.shape) == wanted).all()
    # A corner that no brick of two studs reaches from what is over or under something.
    wanted[2:9, 6:10, 6] = True
    plan = l2a.build(wanted, kit="lego", hands=True)
    assert plan.status == "refused"
    assert "whichever way one fills them" in (plan.reason or "")


def covers(layer: LayerCells) -> list[list[tuple[int, int, int, int]]]:
    """All covers of a layer by linked bricks, each with one across every cut, by trying out."""
    found = []

    def go(left: np.ndarray, some: list[tuple[int, int, int, int]]) -> None:
        if not left.any():
            good = True
            for cut in layer.cuts:
                inside = [cut[i : i + a, j : j + b] for i, j, a, b in some]
                good &= any(part.any() and not part.all() for part in inside)
            if good:
                found.append(some)
            return
        i, j = np.argwhere(left)[0].tolist()
        for a, b in layer.sizes.tolist():
            here = np.s_[i : i + a, j : j + b]
            if left[here].shape == (a, b) and left[here].all() and layer.linked[here].any():
                rest = left.copy()
                rest[here] = False
                go(rest, [*some, (i, j, a, b)])

    go(layer.cells, [])
    return found


def test_linked_covers_are_those_that_trying_out_finds() -> None:
    """Random layers of 4 x 4 cells with random cuts."""
    sizes = np.array([(1, 1), (1, 2), (2, 1), (2, 2), (1, 3), (3, 1)])
    none = 0
    for seed in range(120):
        rng = np.random.default_rng(seed)
        cells = rng.random((4, 4)) < 0.7
        cuts = (rng.random((int(rng.integers(3)), 4, 4)) < 0.4) & cells
        layer = LayerCells(cells, rng.random((4, 4)) < 0.4, sizes, cuts)
        all_ = covers(layer)
        try:
            (made,) = linked_cover([layer], 60.0) or [None]
        except NoCover:
            assert not all_
            none += 1
            continue
        assert made is not None
        assert len(made) == min(map(len, all_))
        assert sorted(made) in [sorted(some) for some in all_]
    assert 20 < none < 100
