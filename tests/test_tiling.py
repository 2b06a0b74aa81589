"""Tilings: exact covers, their bond and their heap against brute force, and what is refused."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cell_shapes import SHAPES, wall
from learn2assemble.assembly.kit import Kind, Kit, load_kit, orientations, parts_of
from learn2assemble.errors import InputError, Learn2AssembleError
from learn2assemble.linear_programs import Clock, LinearProgram, solve
from learn2assemble.planning.tiling.cover import retiling
from learn2assemble.planning.tiling.cover import tile as tile_module
from learn2assemble.planning.tiling.cover.candidates import (
    COSTS,
    BlockPlacement,
    filled_pairs,
    find_candidates,
)
from learn2assemble.planning.tiling.cover.retiling import improve_bond
from learn2assemble.planning.tiling.cover.tile import (
    Tiling,
    find_seams,
    owners,
    seams_bridged,
    tile,
)
from learn2assemble.planning.tiling.cover.ways import convex_hull, support_margin
from learn2assemble.planning.tiling.props import unsupported
from learn2assemble.planning.tiling.stack import find_stack
from learn2assemble.planning.tiling.world import LatticeWorld, make_site

LINTELS = load_kit("bricks-lintels")
SMALL = Kit("small", tuple(Kind(f"1x{n}", tuple((k, 0, 0) for k in range(n))) for n in (1, 2, 3)))
PIECES = st.sampled_from(["cubes", "bricks", "bricks-lintels"])


@st.composite
def designs(draw: st.DrawFn, most: tuple[int, int, int] = (6, 4, 3)) -> np.ndarray:
    """Any cells, at least one of them on the table."""
    shape = [draw(st.integers(1, n)) for n in most]
    bits = draw(st.lists(st.booleans(), min_size=int(np.prod(shape)), max_size=int(np.prod(shape))))
    cells = np.array(bits).reshape(shape)
    cells[0, 0, 0] = True
    return cells


def covers(wanted: np.ndarray, kit: Kit) -> Iterator[list[int]]:
    """All ways to fill ``wanted`` exactly, as candidates of :func:`find_candidates`."""
    found = find_candidates(wanted, kit)
    cells = [set(found.cell[a:b]) for a, b in zip(found.start, found.start[1:], strict=False)]
    by_cell: dict[int, list[int]] = {}
    for p, own in enumerate(cells):
        by_cell.setdefault(min(own), []).append(p)

    def fill(left: set[int]) -> Iterator[list[int]]:
        if not left:
            yield []
            return
        for p in by_cell.get(min(left), ()):
            if cells[p] <= left:
                for rest in fill(left - cells[p]):
                    yield [p, *rest]

    yield from fill(set(np.flatnonzero(wanted.reshape(-1)).tolist()))


def blocks_of(wanted: np.ndarray, kit: Kit, picked: list[int]) -> tuple[BlockPlacement, ...]:
    found, ways = find_candidates(wanted, kit), orientations(kit)
    return tuple(
        BlockPlacement(
            kit.kinds[ways[found.way[p]].kind].name,
            ways[found.way[p]].turn,
            tuple(found.origin[p].tolist()),
        )
        for p in picked
    )


@settings(max_examples=60, deadline=None)
@given(wanted=designs(), name=st.sampled_from(["bricks-lintels", "tetrominoes", "planks"]))
def test_candidates_are_what_one_finds_by_looking(wanted: np.ndarray, name: str) -> None:
    """Every way at every origin, in order, with the margins of what carries it."""
    kit = load_kit(name)
    found, seen = find_candidates(wanted, kit), list[tuple[int, ...]]()
    for number, way in enumerate(orientations(kit)):
        for origin in np.ndindex(*wanted.shape):
            cells = np.array(way.cells) + origin
            if (cells >= wanted.shape).any() or not wanted[tuple(cells.T)].all():
                continue
            own = set(map(tuple, cells.tolist()))
            slots = [
                (*c[:2], range(c[2] + 1, other[2]))
                for c in own
                for other in own
                if other[:2] == c[:2] and other[2] > c[2] + 1
                if not any((*c[:2], z) in own for z in range(c[2] + 1, other[2]))
            ]
            if any(all(wanted[x, y, z] for z in levels) for x, y, levels in slots):
                continue
            seen.append((number, *origin))
            n = len(seen) - 1
            low = np.array([(x, y, z - 1) not in own for x, y, z in cells.tolist()])
            bears = [
                lowest and (z == 0 or bool(wanted[x, y, z - 1]))
                for lowest, (x, y, z) in zip(low, cells.tolist(), strict=True)
            ]
            assert found.cell[found.start[n] : found.start[n + 1]].tolist() == [
                np.ravel_multi_index(c, wanted.shape) for c in cells
            ]
            assert found.lowest[found.start[n] : found.start[n + 1]].tolist() == low.tolist()
            assert found.hanging[n] == pytest.approx(1 - sum(bears) / low.sum())
            assert found.support[n] == support_margin(np.array(way.cells), np.array(bears), kit)
    assert np.column_stack([found.way, found.origin]).tolist() == [list(one) for one in seen]
    for axis in (0, 1):
        which, place = filled_pairs(found, axis)
        step = np.eye(3, dtype=int)[axis]
        expected = Counter(
            (n, *c)
            for n in range(len(found))
            for c in zip(
                *np.unravel_index(found.cell[found.start[n] : found.start[n + 1]], wanted.shape),
                strict=True,
            )
            if np.ravel_multi_index(tuple(np.add(c, step)), wanted.shape, mode="clip")
            in found.cell[found.start[n] : found.start[n + 1]]
            and (np.add(c, step) < wanted.shape).all()
        )
        assert Counter(zip(which.tolist(), *place.T.tolist(), strict=True)) == expected


# ---------------------------------------------------------------- exact covers


def check_cover(tiling: Tiling, kit: Kit) -> None:
    count = np.zeros(tiling.wanted.shape, int)
    cells = {(kit.kinds[way.kind].name, way.turn): way.cells for way in orientations(kit)}
    for block in tiling.placements:
        for cell in cells[block.kind, block.turn]:
            count[tuple(np.add(cell, block.origin))] += 1
    assert (count == tiling.wanted).all()


@settings(max_examples=60, deadline=None)
@given(wanted=designs(), name=PIECES)
def test_every_cell_is_filled_once_and_no_other(wanted: np.ndarray, name: str) -> None:
    kit = load_kit(name)
    tiling = tile(wanted, kit)
    assert (tiling.status, tiling.missing) == ("complete", ())
    check_cover(tiling, kit)


@pytest.mark.parametrize("name", ["wall-window", "house-small", "arch-8", "dome-lean", "blob-1"])
def test_shapes_are_filled_the_same_every_time(name: str) -> None:
    wanted = SHAPES[name]
    tiling = tile(wanted, LINTELS)
    check_cover(tiling, LINTELS)
    assert tile(wanted, LINTELS).placements == tiling.placements


def test_what_was_tiled_before_changes_nothing() -> None:
    """Parts of layers are remembered from one design to the next, but not what time cut short."""
    rng, kit = np.random.default_rng(7), LINTELS
    designs = [rng.random((4, 3, 2)) < 0.8 for _ in range(40)]
    fresh = list[Tiling]()
    for wanted in designs:
        tile_module._known_layers.cache_clear()
        fresh.append(tile(wanted, kit))
    tile_module._known_layers.cache_clear()
    assert tile(designs[0], kit, seconds=0.0).status != fresh[0].status
    for k in rng.permutation(2 * len(designs)) % len(designs):
        assert tile(designs[k], kit).placements == fresh[k].placements
    known = list(tile_module._known_layers(kit))
    assert tile(designs[5], kit).placements == fresh[5].placements
    assert list(tile_module._known_layers(kit)) == known


def test_wide_layers_are_cut_into_strips_and_still_filled() -> None:
    wanted = np.ones((30, 28, 2), bool)
    tiling = tile(wanted, LINTELS)
    check_cover(tiling, LINTELS)
    assert len(tiling.placements) < 2 * 30 * 28 / 10
    bridged, total = seams_bridged(tiling, LINTELS)
    assert bridged / total > 0.8


def test_blocks_taller_than_a_layer_and_blocks_on_their_side() -> None:
    kit = load_kit("planks")
    tiling = tile(np.ones((15, 3, 3), bool), kit)
    check_cover(tiling, kit)
    assert len(tiling.placements) == 3
    tall = Kit("tall", (Kind("post", ((0, 0, 0), (0, 0, 1))), Kind("cube", ((0, 0, 0),))))
    tiling = tile(np.ones((2, 1, 3), bool), tall)
    check_cover(tiling, tall)
    assert len(tiling.placements) == 4


# ---------------------------------------------------------------- against brute force


@settings(max_examples=25, deadline=None)
@given(bits=st.lists(st.booleans(), min_size=10, max_size=10), deep=st.booleans())
def test_a_layer_has_the_fewest_blocks(bits: list[bool], deep: bool) -> None:
    wanted = np.array([True, *bits, True]).reshape((6, 2, 1) if deep else (12, 1, 1))
    fewest = min(len(picked) for picked in covers(wanted, SMALL))
    assert len(tile(wanted, SMALL).placements) == fewest


@settings(max_examples=25, deadline=None)
@given(length=st.integers(2, 9), wide=st.booleans())
def test_a_second_layer_pays_least_for_its_bond(length: int, wide: bool) -> None:
    wanted = np.ones((length if not wide else 4, 1 + wide, 2), bool)
    tiling = tile(wanted, SMALL)
    owner = owners(tiling.placements, SMALL, wanted.shape)
    below = find_seams(owner[:, :, 0])
    second = tuple(b for b in tiling.placements if b.origin[2] == 1)

    def price(blocks: tuple[BlockPlacement, ...]) -> float:
        above = owners(
            tuple(replace(b, origin=(*b.origin[:2], 0)) for b in blocks),
            SMALL,
            (*wanted.shape[:2], 1),
        )
        kept = [int((a & b).sum()) for a, b in zip(below, find_seams(above[:, :, 0]), strict=True)]
        return len(blocks) - COSTS.seam * (sum(int(b.sum()) for b in below) - sum(kept))

    layer = wanted[:, :, :1]
    best = min(price(blocks_of(layer, SMALL, picked)) for picked in covers(layer, SMALL))
    assert price(second) == pytest.approx(best)


@settings(max_examples=40, deadline=None)
@given(counts=st.tuples(*[st.integers(0, 4)] * 3), height=st.integers(1, 2))
def test_a_heap_is_enough_exactly_where_some_cover_fits_it(
    counts: tuple[int, int, int], height: int
) -> None:
    wanted = np.ones((4, 1, height), bool)
    kit = replace(
        SMALL, kinds=tuple(replace(k, count=n) for k, n in zip(SMALL.kinds, counts, strict=True))
    )
    fits = False
    for picked in covers(wanted, kit):
        used = Counter(block.kind for block in blocks_of(wanted, kit, picked))
        fits |= all(used[kind.name] <= (kind.count or 0) for kind in kit.kinds)
    tiling = tile(wanted, kit)
    assert (tiling.status == "complete") == fits
    if fits:
        check_cover(tiling, kit)
        used = Counter(block.kind for block in tiling.placements)
        assert all(used[kind.name] <= (kind.count or 0) for kind in kit.kinds)
    else:
        assert "lacks" in tiling.reason


@pytest.mark.parametrize("name", ["wall", "house-flat", "bridge", "arch-4", "dome-lean"])
def test_the_blocks_of_a_tiling_are_enough_for_another(name: str) -> None:
    wanted = SHAPES[name]
    heap = Counter(block.kind for block in tile(wanted, LINTELS).placements)
    kinds = tuple(replace(kind, count=heap[kind.name]) for kind in LINTELS.kinds)
    tiling = tile(wanted, replace(LINTELS, kinds=kinds))
    assert tiling.status == "complete"
    check_cover(tiling, LINTELS)
    assert Counter(block.kind for block in tiling.placements) == heap


@pytest.mark.parametrize("name", ["house-flat", "wall-door-wide", "stairs"])
def test_joints_are_bridged_with_a_limited_heap_too(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    # A program that a busy machine would cut off must be solved all the same.
    monkeypatch.setattr(retiling, "_SECONDS", 60.0)
    wanted = SHAPES[name]
    heap = Counter(block.kind for block in tile(wanted, LINTELS).placements)
    kinds = tuple(replace(kind, count=heap[kind.name]) for kind in LINTELS.kinds)
    kit = replace(LINTELS, kinds=kinds)
    tiling = improve_bond(tile(wanted, kit), kit, Clock(600))
    check_cover(tiling, LINTELS)
    assert Counter(block.kind for block in tiling.placements) == heap
    bridged, total = seams_bridged(tiling, kit)
    assert bridged >= 0.9 * total


def test_a_heap_with_halves_is_laid_in_bond() -> None:
    """As without counts: not the fewest bricks, which have all joints one above the other."""
    halves = replace(SMALL, kinds=tuple(k for k in SMALL.kinds if len(k.cells) < 3))
    assert [len(kind.cells) for kind in halves.kinds] == [1, 2]
    wanted = np.ones((12, 1, 5), bool)
    for halves_there, blocks in ((10, 32), (3, 30)):
        counts = (halves_there, 40)
        kinds = zip(halves.kinds, counts, strict=True)
        kit = replace(halves, kinds=tuple(replace(kind, count=n) for kind, n in kinds))
        made = tile(wanted, kit)
        check_cover(made, kit)
        bridged, total = seams_bridged(made, kit)
        assert (len(made.placements), bridged == total) == (blocks, blocks == 32)
    assert (
        tile(wanted, halves).placements
        == tile(
            wanted, replace(halves, kinds=tuple(replace(kind, count=99) for kind in halves.kinds))
        ).placements
    )


@settings(max_examples=10, deadline=None)
@given(length=st.integers(3, 5), height=st.integers(2, 3), seed=st.integers(0, 999))
def test_no_cover_with_the_blocks_of_a_heap_continues_fewer_joints(
    length: int, height: int, seed: int
) -> None:
    """Against all covers of a wall with exactly the blocks of one of them."""
    wanted = np.ones((length, 1, height), bool)
    everything = [blocks_of(wanted, SMALL, picked) for picked in covers(wanted, SMALL)]
    heap = Counter(b.kind for b in everything[seed % len(everything)])
    same = [made for made in everything if Counter(b.kind for b in made) == heap]
    blocks = improve_bond(Tiling(same[seed % len(same)], wanted), SMALL, Clock(60)).placements
    assert Counter(b.kind for b in blocks) == heap

    def continued(placements: tuple[BlockPlacement, ...]) -> int:
        bridged, total = seams_bridged(Tiling(placements, wanted), SMALL)
        return total - bridged

    check_cover(Tiling(blocks, wanted), SMALL)
    assert continued(blocks) == min(map(continued, same))


@pytest.mark.parametrize("name", ["wall", "wall-window", "house-small", "tower-slim"])
def test_joints_of_walls_and_houses_are_bridged(name: str) -> None:
    bridged, total = seams_bridged(tile(SHAPES[name], LINTELS), LINTELS)
    assert bridged >= 0.9 * total


# ---------------------------------------------------------------- support


def test_support_is_the_distance_inside_the_hull() -> None:
    kit = replace(LINTELS, joint_gap=0.0)
    bar = np.array([(k, 0, 0) for k in range(6)])
    held = np.zeros(6, bool)
    assert support_margin(bar, held, kit) == -np.inf
    held[0] = True
    assert support_margin(bar, held, kit) == pytest.approx(-2)
    held[5] = True
    assert support_margin(bar, held, kit) == pytest.approx(0.5)
    held[:] = [True, True, True, False, False, False]
    assert support_margin(bar, held, kit) == pytest.approx(0)
    assert support_margin(bar, held, replace(kit, joint_gap=0.01)) == pytest.approx(-0.1)


def test_hull_of_points() -> None:
    points = np.array([[0, 0], [2, 0], [1, 0], [2, 2], [0, 2], [1, 1], [0, 0]], float)
    assert convex_hull(points).tolist() == [[0, 0], [2, 0], [2, 2], [0, 2]]


def test_lintels_span_what_they_can() -> None:
    """A gate of four cells: a bar with one cell on either post carries the rest."""
    tiling = tile(wall(8, 1, 6, (2, 6, 0, 4)), LINTELS)
    assert "1x6" in {b.kind for b in tiling.placements if b.origin[2] == 4} or any(
        b.kind == "1x8" for b in tiling.placements if b.origin[2] == 4
    )


# ---------------------------------------------------------------- refusals


@pytest.mark.parametrize(
    ("cells", "named"),
    [
        (np.ones((2, 2)), "X, Y, Z"),
        (np.ones((2, 2, 2)), "bool"),
        (np.zeros((2, 2, 2), bool), "at least one"),
        (np.ones((65, 1, 1), bool), "64"),
        (np.ones((0, 1, 1), bool), "64"),
        (np.stack([np.zeros((2, 2), bool), np.ones((2, 2), bool)], -1), "table"),
    ],
)
def test_cells_that_cannot_be_used_are_refused(cells: np.ndarray, named: str) -> None:
    with pytest.raises(InputError, match=named):
        tile(cells, LINTELS)


def test_what_does_not_fit_is_named() -> None:
    tiling = tile(np.ones((5, 1, 2), bool), load_kit("tetrominoes"))
    assert tiling.status == "refused"
    assert len(tiling.missing) == 2
    assert "`tetrominoes`" in tiling.reason
    kinds = tuple(replace(kind, count=1) for kind in SMALL.kinds)
    tiling = tile(np.ones((9, 1, 1), bool), replace(SMALL, kinds=kinds))
    assert tiling.reason == "the heap of kit `small` lacks 1 x 1x3"
    # A cell that stays open in each of two layers costs less than the blocks that are lacking.
    pairs, threes = (replace(k, count=n) for k, n in zip(SMALL.kinds[1:], (20, 2), strict=True))
    tiling = tile(np.ones((3, 1, 4), bool), replace(SMALL, kinds=(pairs, threes)))
    assert tiling.reason == "the heap of kit `small` lacks 2 x 1x3"
    alone = np.zeros((4, 1, 2), bool)
    alone[[0, 1, 3, 0], 0, [0, 0, 0, 1]] = True
    for count in (20, None):
        tiling = tile(alone, replace(SMALL, kinds=(replace(pairs, count=count),)))
        assert tiling.reason.endswith("fill 2 cells exactly, the first at (3, 0, 0), level 0")


def test_time_that_ran_out_is_called_so() -> None:
    tile_module._known_layers.cache_clear()  # What is known takes no time.
    tiling = tile(SHAPES["house-big"], LINTELS, seconds=0.0)
    assert tiling.status == "time"
    assert "time ran out after 0 s" in tiling.reason
    assert "`seconds=`" in tiling.reason


def program(**changes: object) -> LinearProgram:
    fields: dict = {
        "cost": np.ones(2),
        "lower": np.zeros(2),
        "upper": np.ones(2),
        "row_lower": np.ones(1),
        "row_upper": np.ones(1),
        "start": np.array([0, 1, 2]),
        "index": np.array([0, 0]),
        "value": np.ones(2),
        "integer": True,
    }
    return LinearProgram(**{**fields, **changes})


@pytest.mark.parametrize(
    "changes",
    [
        {"cost": np.array([1.0, np.nan])},
        {"cost": np.ones(3)},
        {"value": np.array([1.0, np.inf])},
        {"index": np.array([0, 1])},
        {"index": np.array([0, -1])},
        {"start": np.array([0, 2, 1])},
        {"start": np.array([0, 2, 2]), "index": np.array([0, 0])},
        {"start": np.array([0, 1, 3])},
        {"lower": np.array([0.0, 2.0])},
        {"row_lower": np.array([np.nan])},
    ],
)
def test_solvers_are_given_valid_programs_only(changes: dict) -> None:
    assert solve(program()).objective == 1.0
    with pytest.raises(Learn2AssembleError, match="malformed"):
        program(**changes)


def heights(rng: np.random.Generator) -> np.ndarray:
    """Cells of a small landscape in which some are missing, so that blocks have to reach over."""
    wide, deep, high = (int(v) for v in rng.integers((3, 1, 2), (9, 4, 6)))
    cells = np.arange(high) < rng.integers(1, high + 1, (wide, deep, 1))
    cells[:, :, : high - 1] &= rng.random((wide, deep, high - 1)) < 0.9
    return cells


def test_what_is_laid_is_the_stack_of_its_blocks_and_balanced() -> None:
    """Blocks are laid in one compiled call: the stack is the one that all of them make, the forces
    balance each, and what is left can be laid neither now nor one by one. What nothing carries is
    no candidate."""
    rng, laid, fell = np.random.default_rng(7), 0, 0
    for number in range(120):
        kit = load_kit(("bricks", "bricks-lintels", "cubes")[number % 3])
        wanted = heights(rng)
        if len(unreached := floating(wanted)):
            wanted[tuple(unreached.T)] = False
        tiling = tile(wanted, kit)
        site = make_site(wanted, kit)
        blocks = site.candidates(tiling.placements)
        assert np.flatnonzero(blocks < 0).tolist() == unsupported(tiling, kit)
        blocks = blocks[blocks >= 0]
        world = LatticeWorld(site)
        order = world.lay(blocks.tolist())
        placements = tuple(site.placement(candidate) for candidate in order)
        assert world.placed == order
        assert world.open == wanted.sum() - sum(len(site.cells(c)) for c in order)
        left = [c for c in blocks.tolist() if c not in order]
        assert not any(world.waits[c] == 0 and world.stands(c) for c in left)
        laid, fell = laid + len(order), fell + len(left)
        if not order:
            continue
        stack, force = find_stack(placements, kit, wanted.shape), world.proof.force
        for name in ("weight", "centre", "point", "upper", "lower", "share", "start", "rank"):
            np.testing.assert_allclose(getattr(world.proof.stack, name), getattr(stack, name))
        assert (force >= 0).all()
        for block in range(len(stack)):
            on, under = stack.upper == block, stack.lower == block
            pushed = np.where(on, force, 0.0) - np.where(under, force, 0.0)
            assert pushed.sum() == pytest.approx(stack.weight[block], rel=1e-6)
            moment = pushed @ stack.point[:, :2]
            np.testing.assert_allclose(
                moment, stack.weight[block] * stack.centre[block, :2], atol=1e-6
            )
    assert laid > 1000
    assert fell > 10


def floating(wanted: np.ndarray) -> np.ndarray:
    """int64[n, 3]: cells that hang together with none on the table."""
    parts = [part for part in parts_of(wanted) if not part[:, :, 0].any()]
    return np.argwhere(np.logical_or.reduce([wanted & False, *parts]))
