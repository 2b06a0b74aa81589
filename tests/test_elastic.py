"""Bed forces found at once, against a linear program."""

from __future__ import annotations

import numpy as np
import pytest

from learn2assemble.assembly.kit import load_kit
from learn2assemble.linear_programs import solve
from learn2assemble.planning.tiling.stack import find_stack
from learn2assemble.planning.tiling.tile import tile
from learn2assemble.statics.elastic import balance
from learn2assemble.statics.step_proof import Proof
from test_small_designs import random_design


@pytest.mark.parametrize("seed", range(30))
def test_forces_balance_and_are_found_exactly_where_a_program_finds_some(seed: int) -> None:
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
            found = balance(program, stack.share[free], start)
            answer = solve(program)
            assert (found is not False) == (answer.status == "optimal")
            if isinstance(found, np.ndarray):
                columns = np.repeat(np.arange(len(free)), np.diff(program.start))
                held = np.bincount(
                    program.index, program.value * found[columns], len(program.row_lower)
                )
                assert found.min() >= 0
                assert np.abs(held - program.row_lower).max() < 1e-9 * program.row_lower.max()


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
