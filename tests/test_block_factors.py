"""Systems of equations in blocks of 6 x 6, against those of dense matrices; and that one thread
solves such ones."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from threadpoolctl import threadpool_info, threadpool_limits

from learn2assemble.blas import by_one_thread
from learn2assemble.statics.block_factors import BlockMatrix, Springs


def touching(count: int, share: float, rng: np.random.Generator) -> np.ndarray:
    """int64[2, c]: random bodies that touch, some pairs more than once, and some of nobody."""
    pairs = rng.integers(0, count, (2, int(share * count) + 1))
    return np.concatenate(
        [pairs, pairs[::-1, ::2], np.stack([pairs[0], -np.ones_like(pairs[0])])], 1
    )


def filled(
    matrix: BlockMatrix, pairs: np.ndarray, rng: np.random.Generator, lean: float
) -> np.ndarray:
    """The dense matrix of which the blocks were put into ``matrix``.

    Args:
        lean: how far it is from symmetric.
    """
    count = matrix.count
    dense = np.zeros((count, 6, count, 6))
    for a, b in pairs.T.tolist():
        if min(a, b) < 0:
            continue
        # Springs between two bodies, which are not the same in both directions.
        spring = rng.normal(size=(6, 6))
        spring = spring @ spring.T + lean * rng.normal(size=(6, 6))
        for row, column, sign in ((a, a, 1), (a, b, -1), (b, a, -1), (b, b, 1)):
            dense[row, :, column] += sign * spring * (a != b)
    along = np.arange(6)
    for k in range(count):
        dense[k, along, k, along] += 1.0
    matrix.data[:] = 0.0
    done = set()
    for a, b in [*pairs.T.tolist(), *((k, k) for k in range(count))]:
        for row, column in {(a, b), (b, a), (a, a), (b, b)}:
            if min(row, column) < 0 or (row, column) in done:
                continue
            done.add((row, column))
            at, turned = matrix.places(np.array(row), np.array(column))
            block = dense[row, :, column]
            matrix.data[int(at)] = block.T if turned else block
    return dense.reshape(6 * count, 6 * count)


@settings(max_examples=60, deadline=None)
@given(
    count=st.integers(1, 40),
    share=st.floats(0, 4),
    lean=st.sampled_from([0.0, 0.3]),
    seed=st.integers(0, 2**31),
)
def test_it_solves_what_a_dense_matrix_does(
    count: int, share: float, lean: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    pairs = touching(count, share, rng)
    matrix = BlockMatrix(count, pairs)
    dense = filled(matrix, pairs, rng, lean)
    right = rng.normal(size=(count, 6))
    # The right-hand half is not looked at where it says nothing new.
    found = matrix.solve(right, symmetric=lean == 0.0)
    assert found is not None
    left = dense @ found.reshape(-1) - right.reshape(-1)
    # Pivots stay inside the blocks, so a matrix that leans costs some digits, not all of them.
    size = np.abs(dense).max() * np.abs(found).max() + 1
    assert np.abs(left).max() < 1e-9 * size


def test_factors_of_a_grid_have_few_blocks() -> None:
    """A band of this grid would have 20 blocks for every body."""
    number = np.arange(400).reshape(20, 20)
    across = np.stack([number[:, 1:].reshape(-1), number[:, :-1].reshape(-1)])
    up = np.stack([number[1:].reshape(-1), number[:-1].reshape(-1)])
    matrix = BlockMatrix(400, np.concatenate([across, up], 1))
    assert len(matrix.data) < 400 + 2 * 400 * 10


@pytest.mark.parametrize("count", [1, 2])
def test_what_has_no_answer_has_none(count: int) -> None:
    matrix = BlockMatrix(count, np.zeros((2, 0), np.int64))
    matrix.data[:] = 0.0
    assert matrix.solve(np.ones((count, 6))) is None
    matrix.data[:count] = np.eye(6)
    assert matrix.solve(np.ones((count, 6))) == pytest.approx(np.ones((count, 6)))


@settings(max_examples=60, deadline=None)
@given(
    count=st.integers(1, 30),
    share=st.floats(0, 4),
    parts=st.sampled_from([(2, 3, 4), tuple(range(6))]),
    seed=st.integers(0, 2**31),
)
def test_springs_push_as_those_of_a_dense_matrix(
    count: int, share: float, parts: tuple[int, ...], seed: int
) -> None:
    """Random springs between bodies and to the ground, of which some bodies are held."""
    rng = np.random.default_rng(seed)
    a, b = rng.integers(-1, count, (2, int(share * count) + 3))
    a[(a == b) | (b < 0)], b[b < 0] = -1, 0
    sides = rng.normal(size=(2, len(b), 6))
    sides[0, a < 0] = 0.0
    springs = Springs(sides, (a, b), count)
    for _ in range(3):
        free = rng.random(count) < 0.7
        columns = np.flatnonzero(rng.random(len(b)) < 0.8)
        stiff, load = rng.random(len(columns)) + 0.1, rng.normal(size=(count, 6))
        factors = springs.factors(free, columns, stiff, parts, 0.5)
        assert factors is not None
        across = np.zeros((len(columns), count, 6))
        for i, k in enumerate(columns.tolist()):
            across[i, b[k]] = sides[1, k]
            if a[k] >= 0:
                across[i, a[k]] = sides[0, k]
        across = across[:, free][..., list(parts)].reshape(len(columns), -1)
        matrix = across.T @ (stiff[:, None] * across)
        matrix += 0.5 * np.eye(len(matrix))
        motion = np.linalg.solve(matrix, load[free][:, list(parts)].reshape(-1))
        wanted = stiff * (across @ motion)
        assert factors.spread(load) == pytest.approx(wanted, rel=1e-7, abs=1e-9)


def test_what_hangs_on_nothing_costs_no_digits() -> None:
    """A chain of bodies on springs of all sizes, that nothing but soft ones holds, pulled apart."""
    rng = np.random.default_rng(1)
    count, soft = 60, 1e-9
    a = np.repeat(np.arange(count - 1), 12)
    sides = np.zeros((2, len(a), 6))
    # Springs in all directions at points between two bodies, which turn about their middles.
    for k, body in enumerate(a.tolist()):
        way, at = rng.normal(size=3), np.array([body + 0.5, 0, 0]) + 0.3 * rng.normal(size=3)
        for side, middle, sign in ((0, body, -1.0), (1, body + 1, 1.0)):
            arm = at - (middle, 0, 0)
            sides[side, k] = sign * np.concatenate([way, np.cross(arm, way)])
    load = np.zeros((count, 6))
    load[0, 0], load[-1, 0] = -1.0, 1.0
    columns, stiff = np.arange(len(a)), 10.0 ** rng.uniform(-4, 3, len(a))
    springs = Springs(sides, (a, a + 1), count)
    factors = springs.factors(np.ones(count, bool), columns, stiff, tuple(range(6)), soft)
    assert factors is not None
    push = factors.spread(load)
    left = load.copy()
    np.add.at(left, a, -push[:, None] * sides[0])
    np.add.at(left, a + 1, -push[:, None] * sides[1])
    assert np.abs(left).max() < 1e-4


def threads() -> set[int]:
    """Of the libraries of linear algebra that are loaded."""
    return {one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"}


def test_linear_algebra_uses_one_thread_within_and_as_many_as_before_afterwards() -> None:
    np.linalg.solve(np.eye(3), np.ones(3))

    @by_one_thread
    def inside(number: int, fail: bool = False) -> tuple[int, set[int]]:
        if fail:
            raise ValueError("meant")
        return number, threads()

    with threadpool_limits(2, user_api="blas"):
        if threads() != {2}:
            pytest.skip("a library that uses one thread whatever it is told")
        assert inside(7) == (7, {1})
        assert threads() == {2}
        with pytest.raises(ValueError, match="meant"):
            inside(7, fail=True)
        assert threads() == {2}
