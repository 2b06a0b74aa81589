"""Centring of given blocks: boards that carry many of them, and vaults built on them."""

from __future__ import annotations

import runpy
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

import learn2assemble as l2a
from learn2assemble.assembly.blocks import Assembly, Block
from learn2assemble.assembly.boxes import box_block
from learn2assemble.assembly.contacts import Contacts, find_contacts
from learn2assemble.assembly.cuts import POST
from learn2assemble.planning.centring import find_centring
from learn2assemble.planning.clearance import FreeWays, overlap, parts_of
from learn2assemble.planning.given import plan_assembly
from learn2assemble.planning.plan import Plan
from learn2assemble.statics.rigid_blocks import solve

SCRIPTS = Path(__file__).resolve().parents[1] / "examples" / "structures"


def made(script: str, function: str, **arguments: object) -> Assembly:
    return runpy.run_path(str(SCRIPTS / f"{script}.py"))[function](**arguments)


def turned(assembly: Assembly, angle: float) -> Assembly:
    """The same blocks, turned about the vertical and moved aside."""
    cosine, sine = np.cos(angle), np.sin(angle)
    turn = np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    blocks = [replace(b, vertices=b.vertices @ turn + [3.0, -2.0, 0.0]) for b in assembly.blocks]
    return replace(assembly, blocks=tuple(blocks))


def touched(post: Block, assembly: Assembly) -> set[int]:
    """Blocks that share a face with a post."""
    contacts = find_contacts(Assembly((*assembly.blocks, replace(post, prop=False))))
    return set(contacts.a[contacts.b == len(assembly.blocks)].tolist()) - {-1}


def assert_built(plan: Plan) -> None:
    """Every state has forces that balance it, blocks come one by one, and no post is left."""
    assert plan.complete, plan.reason
    assembly = plan.assembly
    assert assembly is not None
    contacts, there = find_contacts(assembly), np.zeros(len(assembly.blocks), bool)
    index = {block.id: k for k, block in enumerate(assembly.blocks)}
    for step in assembly.steps:
        assert there[index[step.block]] == (step.action == "remove")
        there[index[step.block]] = step.action == "place"
        assert solve(assembly, contacts, present=there, coupled=False).stands, step
    assert [block.prop for block in assembly.blocks] == (~there).tolist()


@pytest.mark.parametrize("angle", [0.0, 0.7, 2.5])
@pytest.mark.parametrize(
    ("script", "function", "arguments"),
    [
        ("arch", "arch", {"voussoirs": 11}),
        ("vaults", "barrel_vault", {"courses": 3, "bond": True}),
        ("vaults", "cross_vault", {"voussoirs": 7}),
    ],
)
def test_boards_lie_against_what_they_carry_and_meet_nothing(
    script: str, function: str, arguments: dict[str, int], angle: float
) -> None:
    assembly = turned(made(script, function, **arguments), angle)
    boards, carried = find_centring(assembly.blocks, find_contacts(assembly))
    # A few between two boards lie on none, as do those that stand on the ground.
    high = {k for k, b in enumerate(assembly.blocks) if b.vertices[:, 2].min() > 0.1}
    assert len(high & set(carried)) > 0.75 * len(high)
    assert len(boards) < len(high) / 4
    for board in boards:
        assert board.block.prop
        assert board.block.kind == POST
        assert board.block.vertices[:, 2].min() == 0.0
        for block in assembly.blocks:
            assert not overlap(parts_of(board.block), parts_of(block), 1e-4)
    for one, two in combinations(boards, 2):
        assert not overlap(parts_of(one.block), parts_of(two.block), 0.0)
    assert set().union(*(touched(board.block, assembly) for board in boards)) >= set(carried)


def test_a_board_ends_at_what_stands_in_its_way() -> None:
    assembly = made("arch", "arch", voussoirs=11)
    [board], carried = find_centring(assembly.blocks, find_contacts(assembly))
    wall = box_block("wall", (0.1, -0.3, 0.0), (0.12, 0.3, 0.1))
    halved = replace(assembly, blocks=(*assembly.blocks, wall))
    [left, right], both = find_centring(halved.blocks, find_contacts(halved))
    assert left.block.vertices[:, 0].max() <= 0.1 + 1e-9 or right.block.vertices[:, 0].min() >= 0.12
    assert left.block.volume + right.block.volume < board.block.volume
    assert set(both) <= set(carried)
    # A pillar under the crown itself leaves nothing to carry there, but both haunches.
    for block in (left.block, right.block):
        assert not overlap(parts_of(block), parts_of(wall), 1e-9)


def test_blocks_without_slope_get_no_board() -> None:
    beam = Assembly(
        (box_block("foot", (0, 0, 0), (1, 1, 1)), box_block("beam", (0, 0, 1), (3, 1, 2)))
    )
    assert find_centring(beam.blocks, find_contacts(beam)) == ([], [])


def test_an_arch_of_many_voussoirs_is_built_on_one_board() -> None:
    plan = plan_assembly(made("arch", "arch", voussoirs=21, radius=0.5, thickness=0.14))
    assert_built(plan)
    assert plan.assembly is not None
    [board] = [block for block in plan.assembly.blocks if block.prop]
    steps = [step for step in plan.assembly.steps if step.block == board.id]
    assert steps == [plan.assembly.steps[0], plan.assembly.steps[-1]]
    assert [step.action for step in steps] == ["place", "remove"]


def test_a_cross_vault_is_built() -> None:
    """From posts that stand alone it is not: those under its steep stones are pushed over."""
    vault = made("vaults", "cross_vault", voussoirs=5, course=0.3)
    plan = plan_assembly(vault, seconds=300)
    assert_built(plan)


def test_the_last_block_of_a_vault_comes_between_faces_that_are_rounded() -> None:
    """Straight up is its one way, which faces rounded to a micrometre leave by 40 microradians."""
    corners = np.array([(x, y, z) for x in (0, 0.025) for y in (0, 0.025) for z in (0, 0.05)])
    key = l2a.hull_block("key", corners)
    beside = []
    for k, (x, y) in enumerate([(0.025, 0), (-0.025, 0), (0, 0.025), (0, -0.025)]):
        moved = corners + np.array([x, y, 0])
        # Its upper edge leans over the key.
        upper = moved[:, 2] > 0.01
        moved[upper] -= 1e-6 * np.sign([x, y, 0])
        beside.append(l2a.hull_block(f"b{k}", moved))
    blocks = (key, *beside)
    contacts = find_contacts(Assembly(blocks))
    ways = FreeWays(blocks, contacts, 1e-4, len(blocks))
    assert ways.free(0, np.ones(5, bool))


@pytest.mark.parametrize(("corners", "free"), [(1, True), (2, True), (4, False)])
def test_what_touches_at_a_corner_shuts_no_way(corners: int, free: bool) -> None:
    """The stones in the middle of a cross vault have one with the opposite one, and the normal that
    is found for it may be straight down; of faces it is the only one."""
    cube = np.array([(x, y, z) for x in (0.0, 0.1) for y in (0.0, 0.1) for z in (0.0, 0.1)])
    places = [(0, 0, 0), (0.1, 0, 0), (-0.1, 0, 0), (0, 0.1, 0), (0, -0.1, 0), (0.1, 0.1, 0)]
    blocks = [l2a.hull_block(f"b{k}", cube + np.array(at)) for k, at in enumerate(places)]
    contacts = find_contacts(Assembly(tuple(blocks)))
    corner = Contacts(
        a=np.array([0]),
        b=np.array([5]),
        normal=np.array([[0.0, 0.0, 1.0]]),
        area=np.zeros(1),
        points=np.array([[0.1, 0.1, 0.05]] * corners),
        patch=np.full(corners, len(contacts.a)),
        spread=np.zeros(1),
    )
    both = Contacts(*map(np.concatenate, zip(contacts, corner, strict=True)))
    ways = FreeWays(blocks, both, 1e-4, len(blocks))
    assert ways.free(0, np.ones(6, bool)) == free
