"""Proofs of states of bricks from forces of states near them, and what hands build with them; the
systems of equations in blocks of 6 x 6 behind them, against those of dense matrices, and that one
thread solves them.
"""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from threadpoolctl import threadpool_info, threadpool_limits

from brick_data import bricks, random_bricks
from learn2assemble.blas import by_one_thread
from learn2assemble.planning.given import plan_assembly
from learn2assemble.statics.forces.block_factors import BlockMatrix, Springs
from learn2assemble.statics.holding import program as holding
from learn2assemble.statics.holding.check import margin_n, stands_by_joints
from learn2assemble.statics.holding.forces import forces_of
from learn2assemble.statics.holding.near import _SHOWN, NearForces
from learn2assemble.statics.holding.program import Balance, Push, balance_of
from learn2assemble.statics.holding.start import first_basis
from learn2assemble.statics.rigid_blocks import check
from test_brick_order import replay

MODELS = 240


def test_a_structure_that_uses_much_of_its_strength_is_begun_with() -> None:
    """Trees of 100 bricks whose weights spread over all joints ask some to pull too much."""
    for seed in (3, 8, 10):
        model = bricks(*random_bricks(seed, 100))
        found = stands_by_joints(model)
        assert 0.4 < found.need.share < 0.8
        present = np.ones(len(model.blocks), bool)
        assert NearForces(found.balance, found.forces).stands(present, ~present)
        weak = model.with_capacity(0.69 * found.need.share)
        forces = forces_of(weak)
        balance = Balance(weak, forces)
        assert balance.need().share > 1
        assert not NearForces(balance, forces).stands(present, ~present)


def test_nothing_is_proven_that_the_program_refuses() -> None:
    """Trees of all strengths from those that just stand on, bricks taken away, held and pressed."""
    proven = {True: 0, False: 0}
    refused = missed = 0
    for seed in range(MODELS):
        rng = np.random.default_rng(seed)
        model = bricks(*random_bricks(seed, int(rng.integers(4, 16))))
        need = stands_by_joints(model).need.share
        if not np.isfinite(need):
            continue
        # As strong as it takes and a little more, down to a hair less.
        strength = 0.7 * max(need, 1e-3) * rng.choice([0.999, 1.001, 1.05, 1.5, 5.0, 40.0])
        found = stands_by_joints(model.with_capacity(float(strength)))
        if found.tight:
            continue
        near, balance = NearForces(found.balance, found.forces), found.balance
        middle = [block.centroid[:2] for block in model.blocks]
        present, held = np.ones(balance.count, bool), np.zeros(balance.count, bool)
        for _ in range(6):
            there = present.copy()
            there[rng.integers(balance.count)] = False
            hand = np.zeros_like(held)
            hand[rng.integers(balance.count)] = rng.random() < 0.4
            hand &= there
            push = None
            if rng.random() < 0.5 and there.any():
                block = int(rng.choice(np.flatnonzero(there)))
                x, y = middle[block] + rng.normal(0.0, 0.006, 2)
                push = Push(block, float(rng.normal(0.0, 4.0) * strength), (float(x), float(y)))
            stands = balance.stands(there, hand, push)
            if near.stands(there, hand, push):
                assert stands, (seed, there, hand, push)
                proven[push is not None] += 1
            elif stands:
                missed += 1
            else:
                refused += 1
            present = there if stands and push is None else present
    # Both verdicts come often, with a press and without.
    assert min(proven[True], proven[False]) > 100
    assert refused > 200
    assert missed < proven[True] + proven[False]


def test_a_state_is_proven_without_the_program_of_all_bricks() -> None:
    """A tower of crossed bricks, taken down from above: each proof follows from the one before."""
    model = bricks(*[(((2, 4), (4, 2))[z % 2], (-(z % 2), z % 2, z)) for z in range(40)])
    found = stands_by_joints(model)
    near = NearForces(found.balance, found.forces)
    present, nobody = np.ones(40, bool), np.zeros(40, bool)
    for top in range(39, 0, -1):
        x, y = model.blocks[top].centroid[:2]
        assert near.stands(present, nobody, Push(top, 10.0, (float(x), float(y))))
        present[top] = False
        assert near.stands(present, nobody)


def test_what_hangs_over_what_is_taken_comes_off_with_it() -> None:
    """A mast with a hook under which the arm of another one stands: none of the bricks of the mast
    can be the last one, and only all that is above comes off as one."""
    mast = [((2, 2), (0, 0, z)) for z in range(6)]
    boom = [((2, 6), (0, 0, 6)), ((2, 2), (0, 4, 5)), ((2, 4), (0, 4, 4))]
    model = bricks(*mast, *boom, ((2, 2), (0, 6, 0)), ((2, 2), (0, 6, 1)))
    plan = plan_assembly(model, hands=True)
    assert plan.status == "complete"
    replay(plan)


def test_what_bricks_need_is_witnessed_and_not_less_than_the_least() -> None:
    """Trees of all strengths: forces balance every brick, those that need little and any."""
    shown = {True: 0, False: 0}
    for seed, little in itertools.product(range(32), shown):
        model = bricks(*random_bricks(seed, 60))
        least = stands_by_joints(model).need.share
        if not np.isfinite(least):
            continue
        for share in (0.02, 0.5, 0.97, 1.02):
            found = stands_by_joints(model.with_capacity(0.7 * max(least, 1e-3) / share))
            if found.tight:
                continue
            balance = found.balance
            near = NearForces(balance, found.forces, thorough=False).need(little)
            if near is None:
                assert not little or found.need.share > 0.99 * _SHOWN
                continue
            assert found.need.share - 1e-6 <= near.share <= 1.0
            assert not near.least
            assert not little or near.share <= _SHOWN + 1e-6
            shown[little] += 1
            columns = balance.columns
            assert ((near.forces >= columns.lower - 1e-9) & (near.forces <= columns.upper)).all()
            load = balance.pushed(None) * balance.unit
            pull = balance.pulls @ np.ones(len(balance.pull_bodies[0])) * balance.unit
            lack = load - near.share * pull - balance.wrench @ near.forces
            lack[np.repeat(balance.fixed, 6)] = 0.0
            assert np.abs(lack).max() < 1e-6 * balance.unit
    assert min(shown.values()) > 30


def test_a_check_says_what_the_program_says() -> None:
    """The verdict of forces that are near, and the margin that is asked for later."""
    said = {"stands": 0, "falls": 0, "stands only with tight joints": 0}
    for seed in range(60):
        rng = np.random.default_rng(seed)
        model = bricks(*random_bricks(seed, int(rng.integers(31, 70))))
        need = stands_by_joints(model).need.share
        if not np.isfinite(need):
            continue
        strength = 0.7 * max(need, 1e-3) * rng.choice([0.9, 0.999, 1.001, 5.0])
        model = model.with_capacity(float(strength))
        found, sure = check(model), stands_by_joints(model)
        assert (found.verdict == "falls") == (not sure.need.stands)
        assert (found.verdict == "stands only with tight joints") == sure.tight
        assert found.margin_n == pytest.approx(margin_n(sure.need.share, model.joint), abs=1e-7)
        said[found.verdict] += 1
    assert min(said["stands"], said["falls"]) > 10


def test_the_program_finds_the_same_wherever_it_begins(monkeypatch: pytest.MonkeyPatch) -> None:
    """From bricks on three pushes each, and from nothing; some bricks hang, some hold others."""
    begun = 0
    for seed in range(80):
        model = bricks(*random_bricks(seed, 5 + seed))
        balance = balance_of(model)
        free = ~balance.fixed
        centre = np.array([block.centroid for block in model.blocks])
        found = first_basis(balance.columns, balance.weight, centre, free)
        if found is None:
            continue
        basic, rows = found
        square = np.zeros((len(rows.reshape(-1)), 0))
        square = np.hstack(
            [balance.wrench[:, basic].toarray(), np.eye(rows.size)[:, rows.reshape(-1)]]
        )
        assert np.linalg.matrix_rank(square) == rows.size
        begun += 1
        with monkeypatch.context() as patch:
            share = balance.need().share
            patch.setattr(holding, "first_basis", lambda *_: None)
            again = balance_of(model).need().share
        assert share == pytest.approx(again, rel=1e-7, abs=1e-9)
    assert begun > 40


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
