r"""Hands that hold blocks, of which the wrench is bounded (:mod:`learn2assemble.assembly.hands`).

In the elastic analysis a hand is a spring that gives the wrench of its set that is nearest to
:math:`m + k \lambda`, where :math:`\lambda` is the motion of the block: within its bounds it is
stiff, at its bounds it yields. That is the gradient of a convex energy, as the nearest law of
:mod:`.elastic_joints` is. In programs a hand is six more columns, its wrench, and a row for each
of its inequalities.
"""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy import optimize  # pyright: ignore[reportMissingTypeStubs]

from learn2assemble.assembly.hands import Hand

_library: Any = optimize

STIFFNESS = 1.0
"""Of a hand, in that of a whole face of a median block: force over motion, and moment over turn."""
NO_HANDS: Mapping[int, Hand] = {}


class HeldBlock(NamedTuple):
    """A block that a bounded hand holds, in the units of a program."""

    body: int
    """Its number in the program."""
    rows: np.ndarray
    """float64[k, 6], each of length 1: of its wrench about its centroid, couples over a length."""
    most: np.ndarray
    """float64[k], 0 or more."""


def held_blocks(
    hands: Mapping[int, Hand],
    number: np.ndarray,
    centre: np.ndarray,
    newton: float,
    length: np.ndarray,
) -> list[HeldBlock]:
    """The bounded hands of a program.

    Args:
        hands: by block.
        number: int64[B]: of every block that of its rows in the program, -1 where it has none.
        centre: float64[B, 3], about which moments are counted [m].
        newton: unit of force [N].
        length: float64[B], by which couples are divided [m].
    """
    found = list[HeldBlock]()
    for block, hand in sorted(hands.items(), key=lambda item: item[0]):
        if number[block] >= 0:
            rows, most = hand.about(centre[block], newton, float(length[block]))
            found.append(HeldBlock(int(number[block]), rows, most))
    return found


def nearest_wrench(held: HeldBlock, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The wrench of a hand nearest to a wanted one, float64[6], and its derivative by that one,
    float64[6, 6].

    It is found as the least distance problem of Lawson and Hanson (1974, chapter 23): exactly, and
    with the inequalities that bind.
    """
    over = held.rows @ wanted - held.most
    worst = float(over.max())
    if worst <= 0:
        return wanted.copy(), np.eye(6)
    matrix = np.vstack([-held.rows.T, over / worst])
    unit = np.zeros(7)
    unit[6] = 1.0
    share, _ = _library.nnls(matrix, unit)
    rest = matrix @ share - unit
    wrench = wanted - worst * rest[:6] / rest[6]
    binding = held.rows[share > 0]
    # What the binding inequalities leave free.
    _, size, ways = np.linalg.svd(binding, full_matrices=False)
    ways = ways[size > 1e-9]
    return wrench, np.eye(6) - ways.T @ ways


class HandSprings:
    """All hands of a part of a structure.

    Args:
        held: the blocks; bodies are those of the part.
    """

    def __init__(self, held: Sequence[HeldBlock] = ()) -> None:
        self.held = held
        self.body: NDArray[np.int64] = np.array([one.body for one in held], np.int64)
        self.none: NDArray[np.float64] = np.zeros((len(held), 6))

    def respond(self, motion: np.ndarray, near: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Wrenches float64[h, 6] at a motion float64[n, 6], their derivatives float64[h, 6, 6] by
        it, and their energy.

        Args:
            near: float64[h, 6], wrenches without motion.
        """
        wrench, slope = self.none.copy(), np.zeros((len(self.held), 6, 6))
        energy = 0.0
        for k, one in enumerate(self.held):
            move = motion[one.body]
            wrench[k], slope[k] = nearest_wrench(one, near[k] + STIFFNESS * move)
            slope[k] *= STIFFNESS
            change = wrench[k] - near[k]
            energy += float(wrench[k] @ move - change @ change / (2 * STIFFNESS))
        return wrench, slope, energy


def hand_columns(
    held: Sequence[HeldBlock], count: int
) -> tuple[sp.csc_matrix, sp.csc_matrix, np.ndarray]:
    """The hands of a program of ``count`` blocks: [6 count, 6 h], what their columns do to its
    rows; [k, 6 h], their inequalities; and float64[k], the bounds of these."""
    at = np.array([6 * one.body for one in held], np.int64)[:, None] + np.arange(6)
    flat = at.reshape(-1)
    shape = 6 * count, len(flat)
    does = sp.csc_matrix((np.ones(len(flat)), (flat, np.arange(len(flat)))), shape)
    rows = [sp.csc_matrix(one.rows) for one in held]
    limits = sp.csc_matrix(sp.block_diag(rows)) if rows else sp.csc_matrix((0, 0))
    most = np.concatenate([one.most for one in held]) if held else np.zeros(0)
    return does, limits, most


@contextmanager
def held_meanwhile(
    solver: Any, held: Sequence[HeldBlock], count: int
) -> Generator[None, None, None]:
    """A linear program, given to HiGHS, of which the first 6 ``count`` rows are the balance of
    blocks: with the hands meanwhile, behind all else."""
    if not held:
        yield
        return
    does, limits, most = hand_columns(held, count)
    first, below = solver.getNumCol(), solver.getNumRow()
    wide, high = 6 * len(held), len(most)
    free = np.full(wide, np.inf)
    where = does.indptr[:-1].astype(np.int32), does.indices.astype(np.int32), does.data
    solver.addCols(wide, np.zeros(wide), -free, free, does.nnz, *where)
    by_row = sp.csr_matrix(limits)
    begin, index = by_row.indptr[:-1].astype(np.int32), (first + by_row.indices).astype(np.int32)
    solver.addRows(high, np.full(high, -np.inf), most, by_row.nnz, begin, index, by_row.data)
    try:
        yield
    finally:
        solver.deleteRows(high, np.arange(below, below + high, dtype=np.int32))
        solver.deleteCols(wide, np.arange(first, first + wide, dtype=np.int32))
