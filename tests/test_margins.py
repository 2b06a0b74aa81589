"""Margins hold in every direction: against brute force by a solver of another make.

``python tests/test_margins.py 10`` prints the figure for 720 directions of 10 stacks.
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

import refusals
from learn2assemble.assembly.blocks import Assembly
from learn2assemble.assembly.boxes import box_block
from learn2assemble.assembly.contacts import find_contacts
from learn2assemble.assembly.kit import load_kit
from learn2assemble.geometry.circles import inner_circle
from learn2assemble.planning.tiling.exact import plan_exact
from learn2assemble.planning.tiling.ordering import to_assembly
from learn2assemble.statics.rigid_blocks import bed_patches, margin
from test_rigid_blocks import GRAVITY, about, wrenches

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
        cones = [np.column_stack([rays, np.full(SIDES, up)]).T for up in sign]
        push = np.zeros((len(assembly.blocks), 6))
        for k, block in enumerate(assembly.blocks):
            force = GRAVITY * block.mass * np.array([np.cos(angle), np.sin(angle), 0.0])
            push[k] = np.concatenate([force, np.cross(block.centroid, force)])
        columns = (
            sp.hstack(
                [sp.csr_matrix(matrix @ sp.block_diag(cones)), sp.csr_matrix(-push.reshape(-1, 1))]
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
    tiling, ordering = plan_exact(refusals.wanted("tet1"), kit)
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
