"""Structures made by the scripts in ``examples/structures``, and blocks made from points."""

from __future__ import annotations

import importlib.util
import json
import runpy
import sys
from functools import partial
from itertools import combinations
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import learn2assemble as l2a
from learn2assemble.assembly.contacts import check_overlaps, find_contacts
from learn2assemble.errors import InputError
from learn2assemble.geometry.hulls import area_vector
from learn2assemble.planning.clearance import FreeWays, overlap, parts_of
from learn2assemble.planning.posts import find_posts
from learn2assemble.statics.rigid_blocks import FALLS, STANDS

SCRIPTS = Path(__file__).resolve().parents[1] / "examples" / "structures"


def script(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, SCRIPTS / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(
    ("name", "function", "arguments", "count", "verdicts"),
    [
        ("turned_wall", "turned_wall", {"bricks": 30}, 30, {STANDS}),
        ("arch", "arch", {"voussoirs": 9}, 9, {STANDS}),
        ("arch", "arch", {"voussoirs": 21, "radius": 0.5, "thickness": 0.14}, 21, {STANDS}),
        ("vaults", "barrel_vault", {"courses": 2}, 18, {STANDS}),
        ("vaults", "barrel_vault", {"courses": 2, "bond": True}, 22, {STANDS}),
        # Its four parts press against one another in upright planes, as the rings of an open
        # dome do round the eye: weight presses them, no tight joint is needed.
        ("vaults", "cross_vault", {"voussoirs": 5, "course": 0.4}, 32, {STANDS}),
        ("dome", "dome", {"rings": 4, "voussoirs": 8}, 33, {STANDS}),
        ("dome", "dome", {"rings": 4, "voussoirs": 8, "key": False}, 32, {STANDS}),
        ("spiral_stair", "spiral_stair", {"steps": 12}, 24, {STANDS}),
    ],
)
def test_what_a_script_makes_stands(
    name: str, function: str, arguments: dict[str, float], count: int, verdicts: set[str]
) -> None:
    assembly = getattr(script(name), function)(**arguments)
    assert len(assembly.blocks) == count
    check_overlaps(assembly)
    assert l2a.check(assembly).verdict in verdicts


@pytest.mark.parametrize("bricks", [64, 500])
def test_every_whole_brick_of_a_turned_wall_lies_on_two(bricks: int) -> None:
    made = script("turned_wall")
    wall = made.turned_wall(bricks)
    assert len(wall.blocks) == bricks
    contacts = find_contacts(wall)
    # No brick touches another one of its course.
    assert (contacts.normal[:, 2] == 1).all()
    area = made.BRICK[0] * made.BRICK[1]
    on: dict[int, list[float]] = {}
    for lower, upper, share in zip(contacts.a, contacts.b, contacts.area / area, strict=True):
        on.setdefault(int(upper), []).append(share if lower >= 0 else 0.0)
    for number, block in enumerate(wall.blocks):
        if block.vertices[:, 2].min() > 0 and block.kind == "brick":
            assert len(on[number]) == 2, block.id
            assert min(on[number]) > 0.12, block.id


def test_a_turned_wall_shows_its_picture() -> None:
    made = script("turned_wall")
    picture = np.array([[1.0, 0.5, 0.0]])
    blocks = made.turned_wall(3, 3, picture).blocks
    edges = [block.vertices[1] - block.vertices[0] for block in blocks]
    turns = [np.degrees(np.arctan2(edge[1], edge[0])) for edge in edges]
    # Which edge of a brick is the first one is not said: its own turn is within 45 degrees.
    own = [(turn + 45) % 90 - 45 for turn in turns]
    assert own == pytest.approx([25, 0, -25], abs=1e-6)


def test_a_pile_of_stones_does_not_fall() -> None:
    made = script("stones")
    pile = made.stones(5, seed=1)
    assert [block.id for block in pile.blocks] == [f"stone{k}" for k in range(5)]
    sizes = [np.ptp(block.vertices, axis=0).max() for block in pile.blocks]
    assert min(sizes) > 0.015
    assert max(sizes) < 0.085
    check_overlaps(pile)
    assert l2a.check(pile).verdict != FALLS
    again = made.stones(5, seed=1)
    for one, two in zip(pile.blocks, again.blocks, strict=True):
        assert (one.vertices == two.vertices).all()


def test_stones_that_are_laid_lie_on_one_another_and_have_an_order() -> None:
    pile = script("stones").stones(8, seed=3, spread=0.015, laid=True)
    check_overlaps(pile)
    low = [block.vertices[:, 2].min() for block in pile.blocks]
    assert max(low) > 0.005
    plan = l2a.build(pile, supports="none")
    assert plan.status == "complete"
    assert plan.blocks.used == 8


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("arch", ["5"]),
        ("turned_wall", ["9"]),
        ("stones", ["0", "5"]),
        ("vaults", []),
        ("dome", []),
        ("spiral_stair", []),
    ],
)
def test_a_script_writes_its_assembly_and_a_plan_with_page_and_picture(
    name: str,
    words: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(sys, "argv", [name, str(tmp_path / "out"), *words])
    # Whether it is built is told elsewhere; large ones take longer than a test has, and so does it
    # to look for all their posts.
    monkeypatch.setattr(l2a, "build", partial(l2a.build, seconds=0.2, supports="none"))
    runpy.run_path(str(SCRIPTS / f"{name}.py"), run_name="__main__")
    assert "falls" not in capsys.readouterr().out.splitlines()[0]
    plans = sorted((tmp_path / "out").rglob("plan.json"))
    assert len(plans) == (2 if name == "vaults" else 1)
    for plan in plans:
        assert {"view.html", "progress.png"} <= {path.name for path in plan.parent.iterdir()}
        [own] = [
            p
            for p in plan.parent.glob("*.json")
            if p.stem.startswith(name.removesuffix("s")) or p.stem.endswith("_vault")
        ]
        blocks = json.loads(own.read_text())["blocks"]
        assert len(l2a.read_assembly(own).blocks) == len(blocks)


def test_a_post_does_not_come_where_another_one_stands() -> None:
    """Each post is found beside the given blocks alone, so two of them may want one place: the plan
    of a dome once had both."""
    assembly = script("dome").dome(rings=4, voussoirs=8)
    contacts = find_contacts(assembly)
    posts = find_posts(assembly.blocks, contacts)
    count, parts = len(assembly.blocks), [parts_of(post.block) for post in posts]
    blocks = (*assembly.blocks, *(post.block for post in posts))
    ways = FreeWays(blocks, contacts, 1e-4, count)
    pairs = [
        (k, n)
        for k, n in combinations(range(len(posts)), 2)
        if posts[k].carries != posts[n].carries and overlap(parts[k], parts[n], 1e-3)
    ]
    assert pairs
    for k, n in pairs[:: max(len(pairs) // 50, 1)]:
        present = np.zeros(len(blocks), bool)
        assert ways.free(count + k, present)
        present[count + n] = True
        assert not ways.free(count + k, present)


def test_a_hull_has_one_polygon_for_each_plane_face() -> None:
    cube = np.stack(np.meshgrid([0, 1, 2], [0, 1, 2], [0, 1, 2]), -1).reshape(-1, 3) / 10
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    for points in (cube, cube @ turn, cube @ turn + 100.0):
        block = l2a.hull_block("cube", points, density=2000.0, support=True)
        assert [len(face) for face in block.faces] == [4] * 6
        assert len(block.vertices) == 8
        assert block.volume == pytest.approx(0.008)
        assert block.is_convex
        assert block.support
    rng = np.random.default_rng(1)
    stone = l2a.hull_block("stone", rng.normal(size=(30, 3)))
    assert stone.is_convex
    assert {len(face) for face in stone.faces} == {3}
    flat = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [2, 3, 0]]
    for wrong in (flat, flat[:3], [[0, 0]] * 5, [["a", 0, 0]] * 4, [[np.nan, 0, 0], *flat]):
        with pytest.raises(InputError, match=r"block 'b': (points|vertices)"):
            l2a.hull_block("b", wrong)  # pyright: ignore[reportArgumentType]


def test_the_normal_of_a_ring_is_as_long_as_twice_its_area() -> None:
    """An L of area 3, turned at random, also where coordinates are 1e8 times as large."""
    ring = np.array([(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)], float)
    rng = np.random.default_rng(0)
    for _ in range(20):
        turn, at = np.linalg.qr(rng.normal(size=(3, 3)))[0], 1e8 * rng.normal(size=3)
        found = area_vector(ring @ turn[:2] + at)
        assert found == pytest.approx(6 * np.cross(turn[0], turn[1]), abs=1e-5)
        assert area_vector((ring @ turn[:2] + at)[::-1]) == pytest.approx(-found, abs=1e-5)
