"""Margins hold in every direction: against brute force by a solver of another make.

``python tests/test_margins.py 10`` prints the figure for 720 directions of 10 stacks.

Loads passed down a stack, block by block or under many blocks at once, against programs.

Blocks that cannot answer alone are balanced with those near them.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from learn2assemble.assembly.blocks import Assembly
from learn2assemble.assembly.boxes import box_block
from learn2assemble.assembly.contacts import find_contacts
from learn2assemble.assembly.kit import load_kit
from learn2assemble.geometry.circles import inner_circle
from learn2assemble.linear_programs import INF, Clock, solve
from learn2assemble.planning.tiling import finished, standing
from learn2assemble.planning.tiling.cover.tile import tile
from learn2assemble.planning.tiling.exact import plan_exact
from learn2assemble.planning.tiling.finished import stand
from learn2assemble.planning.tiling.ordering import to_assembly
from learn2assemble.planning.tiling.stack import find_stack
from learn2assemble.statics import elastic
from learn2assemble.statics.elastic import balance
from learn2assemble.statics.forces.equilibrium import margin
from learn2assemble.statics.rigid_blocks import bed_patches
from learn2assemble.statics.step_proof import TOLERANCE, Proof
from test_ordering import imbalance
from test_rigid_blocks import GRAVITY, about, wrenches
from test_small_designs import random_design, refused_cells

SIDES = 8


def reaches(assembly: Assembly, angles: np.ndarray) -> np.ndarray:
    """Largest acceleration [g] along each angle that bed faces hold, by HiGHS, with pyramids of
    friction inside the cone that are exact along the angle."""
    contacts = find_contacts(assembly)
    contacts = contacts.only(bed_patches(contacts))
    assert (np.abs(contacts.normal[:, 2]) > 1 - 1e-9).all()
    matrix, weight = wrenches(assembly, contacts)
    scale = np.abs(weight).max()
    sign = contacts.normal[contacts.patch, 2]
    found = []
    for angle in angles:
        ring = angle + 2 * np.pi / SIDES * np.arange(SIDES)
        rays = assembly.friction * np.stack([np.cos(ring), np.sin(ring)], 1)
        cones = [sp.csr_matrix(np.column_stack([rays, np.full(SIDES, up)]).T) for up in sign]
        push = np.zeros((len(assembly.blocks), 6))
        for k, block in enumerate(assembly.blocks):
            force = GRAVITY * block.mass * np.array([np.cos(angle), np.sin(angle), 0.0])
            push[k] = np.concatenate([force, np.cross(block.centroid, force)])
        columns = (
            sp.hstack(
                [
                    sp.csr_matrix(matrix @ sp.block_diag(cones)),
                    sp.csr_matrix(-push.reshape(-1, 1)),
                ]
            )
            / scale
        )
        cost = np.zeros(columns.shape[1])
        cost[-1] = -1.0
        answer = linprog(cost, A_eq=columns, b_eq=weight / scale, method="highs")
        assert answer.status == 0, answer.message
        found.append(-answer.fun)
    return np.array(found)


def leaning_stack(seed: int) -> Assembly:
    """Boxes of any size, each somewhere on the one below, turned together by any angle."""
    rng = np.random.default_rng(seed)
    blocks, low, size = [], np.zeros(2), np.array([1.0, 0.8])
    for level in range(3):
        blocks.append(
            box_block(f"{level}", (*low, 0.6 * level), (*(low + size), 0.6 * level + 0.6))
        )
        low, size = low + rng.uniform(-0.2, 0.2, 2), rng.uniform(0.6, 1.1, 2)
    turn = about(2, rng.uniform(0.2, 1.3))
    blocks = [replace(block, vertices=block.vertices @ turn.T) for block in blocks]
    return Assembly(tuple(blocks), friction=0.9)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_margin_holds_all_round(seed: int) -> None:
    assembly = leaning_stack(seed)
    worth = margin(assembly, find_contacts(assembly))
    all_round = reaches(assembly, np.arange(120) * np.pi / 60)
    least = all_round.min()
    assert 0.05 < least < 0.85
    assert 0.985 * least <= worth <= (1 + 1e-4) * least
    # Along the axes alone more would have been said.
    assert all_round[::30].min() > 1.01 * least


def test_a_step_is_not_said_to_withstand_more_than_it_does_at_an_angle() -> None:
    """Along x and y 0.489 g, at 135 degrees 0.351 g."""
    kit = load_kit("tetrominoes")
    tiling, ordering = plan_exact(refused_cells("tet1"), kit)
    assert ordering is not None
    assembly = to_assembly(tiling, ordering, kit)
    there: list[str] = []
    for number, step in enumerate(assembly.steps, 1):
        if step.place is None:
            there.remove(step.remove or "")
        else:
            there.append(step.place)
        worth = ordering.steps[number - 1].margin_g
        if number not in (5, 7, 11, 16):
            continue
        state = Assembly(tuple(b for b in assembly.blocks if b.id in there), (), assembly.friction)
        least = reaches(state, np.arange(0, 360, 15) * np.pi / 180).min()
        assert 0 < worth <= least + 1e-6
        if number == 7:
            assert least == pytest.approx(0.351, abs=1e-3)
            assert worth == pytest.approx(0.351, rel=0.02)


@settings(max_examples=50, deadline=None)
@given(st.lists(st.tuples(st.floats(-5, 5), st.floats(-5, 5)), min_size=1, max_size=12))
def test_the_inner_circle_touches_the_hull_and_does_not_leave_it(points: list) -> None:
    cloud = np.array(points)
    radius, angle = inner_circle(cloud)
    ring = np.arange(720) * np.pi / 360
    ways = np.stack([np.cos(ring), np.sin(ring)], 1)
    support = (ways @ cloud.T).max(1)
    assert radius == pytest.approx(max(support.min(), 0.0), abs=0.03) or radius == 0.0
    assert radius <= max(support.min(), 0.0) + 1e-9
    if radius > 0:
        way = np.array([np.cos(angle), np.sin(angle)])
        assert (cloud @ way).max() == pytest.approx(radius)


def test_the_inner_circle_of_a_square() -> None:
    square = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1), (0.2, 0.3)], float)
    assert inner_circle(square)[0] == pytest.approx(1.0)
    assert inner_circle(square + 2)[0] == 0.0
    assert inner_circle(np.zeros((4, 2))) == (0.0, 0.0)


KIT = load_kit("bricks-lintels")


def shell(radius: float, thick: float, levels: int) -> np.ndarray:
    """A round tower that leans inwards and is closed at the top, so that its rim is weak."""
    side = int(2 * radius + 1)
    across = np.arange(side) + 0.5 - side / 2
    distance = np.hypot(across[:, None], across[None, :])
    cells = np.zeros((side, side, levels), bool)
    for z in range(levels):
        outer = radius - 0.45 * z
        cells[:, :, z] = (distance < outer) & (distance > max(outer - thick, -1))
    return cells


@pytest.mark.parametrize("seed", range(12))
def test_mended_forces_balance_and_are_found_only_where_a_program_finds_some(seed: int) -> None:
    """Random piles under accelerations at which many blocks cannot answer alone."""
    rng = np.random.default_rng(seed)
    tiling = tile(random_design(rng), KIT)
    stack = find_stack(tiling.placements, KIT, tiling.wanted.shape)
    everything = np.ones(len(stack), bool)
    for size in (0.0, 0.05, 0.1, 0.2):
        way = rng.normal(size=2)
        load = float(size * way[0]), float(size * way[1])
        alone, together = Proof(stack, load), Proof(stack, load)
        before = together.force.copy()
        if together.settle(everything, everything, mends=True):
            assert imbalance(together, everything) <= TOLERANCE
            assert (together.force >= 0).all()
            assert Proof(stack, load).program(everything, everything)
        else:
            assert not alone.settle(everything, everything)
            assert (together.force == before).all()


def test_blocks_are_mended_where_they_cannot_answer_alone() -> None:
    """Of a tower that leans inwards under every load up to 0.15 g."""
    wanted = shell(5.0, 2.4, 12)
    stack = find_stack(tile(wanted, KIT).placements, KIT, wanted.shape)
    everything = np.ones(len(stack), bool)
    for size in (0.0, 0.02, 0.05, 0.1, 0.15):
        alone, together = Proof(stack, (size, 0.0)), Proof(stack, (size, 0.0))
        assert not alone.settle(everything, everything)
        assert together.settle(everything, everything, mends=True)
        assert imbalance(together, everything) <= TOLERANCE


def test_a_tower_is_proven_with_few_programs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Programs over all blocks take most of the time of a large building."""
    asked = 0
    program = Proof.program

    def count(
        self: Proof, placed: np.ndarray, changing: np.ndarray, seconds: float = INF
    ) -> bool | None:
        nonlocal asked
        asked += int(changing.sum() > 1)
        return program(self, placed, changing, seconds)

    monkeypatch.setattr(Proof, "program", count)
    _, ordering = plan_exact(shell(5.0, 2.4, 12), KIT, gap=KIT.joint_gap)
    assert ordering is not None
    assert ordering.status == "complete"
    assert asked < len(ordering.steps)
    assert ordering.margin_g > 0.02


def test_cuts_that_are_known_prove_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first tiling is tried again after some rounds; how it falls is known by then."""
    monkeypatch.setattr(finished, "CUT_ROUNDS", 1)
    monkeypatch.setattr(finished._NearPart, "decide", lambda *_: ("unknown", None))
    tiling = tile(random_design(np.random.default_rng(9)), KIT)
    assert stand(tiling, KIT, Clock(60.0)).status == "complete"


def test_a_large_building_that_falls_ends_after_a_few_tilings(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A count, as time depends on the machine; what was tried is said."""
    monkeypatch.setattr(finished, "MAX_FALLEN", 30)
    monkeypatch.setattr(finished._NearPart, "decide", lambda *_: ("unknown", None))
    tiling = tile(random_design(np.random.default_rng(9)), KIT)
    monkeypatch.setattr(finished, "MIN_ROUNDS", 1)
    monkeypatch.setattr(finished, "CUT_ROUNDS", 1)
    stood = stand(tiling, KIT, Clock(60.0))
    assert stood.status == "not found"
    assert "4 tilings that were tried" in stood.reason


def test_a_program_that_timed_out_is_not_asked_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the parts that are decided with their forces each size has one chance."""
    asked = []

    def too_slow(*given: object, **_: object) -> tuple[str, None]:
        asked.append(given[3])
        return "time", None

    monkeypatch.setattr(finished, "tile_standing", too_slow)
    monkeypatch.setattr(finished, "CUT_ROUNDS", 0)
    tiling = tile(random_design(np.random.default_rng(9)), KIT)
    stand(tiling, KIT, Clock(60.0))
    assert 1 <= len(asked) <= 2


def test_motions_are_not_looked_for_again_at_the_prices_of_before(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Joints all open by the same: so do they at the next prices."""
    asked = 0

    def part(price: np.ndarray, closed: np.ndarray) -> np.ndarray | None:
        nonlocal asked
        asked += 1
        return None if closed.any() else np.ones(len(price))

    found = standing._partings(part, np.ones(8), 3, 1e-7)
    assert len(found) == 1
    assert found[0].all()
    assert asked == 3  # twice the same, and that there is no other


# Bed forces found at once, against a linear program.


@pytest.mark.parametrize("seed", range(30))
def test_forces_balance_and_are_found_exactly_where_a_program_finds_some(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By full matrices and by sparse ones alike."""
    rng = np.random.default_rng(seed)
    kit = load_kit("bricks-lintels")
    tiling = tile(random_design(rng), kit)
    stack = find_stack(tiling.placements, kit, tiling.wanted.shape)
    everything = np.ones(len(stack), bool)
    # Gravity alone, and accelerations up to those at which anything turns over.
    for size in (0.0, 0.05, 0.3, 1.0):
        way = rng.normal(size=2)
        proof = Proof(stack, (size * way[0], size * way[1]))
        free, _, program = proof._equations(everything, everything)
        near = rng.exponential(size=len(free)) * (rng.random(len(free)) < 0.5)
        for start in (np.zeros(len(free)), near):
            answer, forces = solve(program), list[np.ndarray]()
            for most in (10**6, 0):
                monkeypatch.setattr(elastic, "DENSE", most)
                found = balance(program, stack.share[free], start)
                assert (found is not False) == (answer.status == "optimal")
                if isinstance(found, np.ndarray):
                    columns = np.repeat(np.arange(len(free)), np.diff(program.start))
                    held = np.bincount(
                        program.index, program.value * found[columns], len(program.row_lower)
                    )
                    assert found.min() >= 0
                    assert np.abs(held - program.row_lower).max() < 1e-9 * program.row_lower.max()
                    forces.append(found)
            for one in forces[1:]:
                np.testing.assert_allclose(one, forces[0], atol=1e-8)


def test_forces_are_mostly_found_without_a_program() -> None:
    """Of a wall under loads at which it stands; None would leave the answer to the program."""
    kit = load_kit("bricks-lintels")
    tiling = tile(np.ones((20, 2, 10), bool), kit)
    stack = find_stack(tiling.placements, kit, (20, 2, 10))
    everything = np.ones(len(stack), bool)
    for size, stands in ((0.0, True), (0.05, True), (0.3, False)):
        proof = Proof(stack, (0.0, size))
        free, _, program = proof._equations(everything, everything)
        found = balance(program, stack.share[free], np.zeros(len(free)))
        assert isinstance(found, np.ndarray) == stands
        assert (found is False) != stands


if __name__ == "__main__":
    shares = []
    for number in range(int(sys.argv[1])):
        made = leaning_stack(number)
        if margin(made, find_contacts(made)) > 0:
            least = reaches(made, np.arange(720) * np.pi / 360).min()
            shares.append(margin(made, find_contacts(made)) / least)
    print(
        f"{len(shares)} stacks: margin over the least of 720 directions "
        f"{min(shares):.4f} to {max(shares):.4f}"
    )
