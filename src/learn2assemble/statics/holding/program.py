"""The balance of blocks whose joints hold, as one linear program that is kept warm.

Columns are the forces of :mod:`.forces`; six rows a block say that they bear its weight.
The share of the strength of the joints that is needed is one more column, and the least of it is
looked for: where it is at most 1, the blocks stand. Placing or holding a block changes bounds and
that column alone, so that states that follow each other cost little.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import NamedTuple

import highspy
import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from learn2assemble.assembly.blocks import Assembly
from learn2assemble.assembly.hands import Hand
from learn2assemble.constants import GRAVITY
from learn2assemble.errors import Learn2AssembleError
from learn2assemble.geometry.circles import inner_circle
from learn2assemble.geometry.hulls import cross_product
from learn2assemble.linear_programs import INF, Clock, pass_columns
from learn2assemble.statics.forces.hands import NO_HANDS, HeldBlock, held_blocks, held_meanwhile
from learn2assemble.statics.holding.forces import Columns, Forces, forces_of, joined
from learn2assemble.statics.holding.solver import (
    CAREFUL,
    DECIDED,
    OPTIONS,
    STATUS,
    by_cones,
    new_solver,
    run_within,
)
from learn2assemble.statics.holding.start import first_basis

MOST_G = 10.0
"""Margins are cut here [g]."""
_MANY = 300
"""Blocks from which one state alone is answered by a method of interior points."""
_CLOSE = 1e-3
"""Share of the strength by which its answer has to be clear."""
_FULL = 1.0 + 1e-7
"""Share of the strength up to which joints hold."""
_IDLE = 1e-9
"""Work that is none, in mean weights times a length."""
_MOVES = 0.1
"""A block moves where its part of the motion is this share of the largest."""
_FIRST = np.pi / 8 + np.pi / 4 * np.arange(8)
_DIRECTIONS = 24
"""Of a margin: at most so many programs."""


class Need(NamedTuple):
    """What a state needs."""

    share: float
    """Least share of the strength of the joints with which forces balance it; infinite where none
    do at any strength."""
    forces: np.ndarray
    """float64[n]: of the columns [N]; zero where it does not stand."""
    least: bool = True
    """Whether no smaller share does; else it is one of which forces are known."""

    @property
    def stands(self) -> bool:
        """Whether the strength of the joints suffices."""
        return self.share <= _FULL


class Push(NamedTuple):
    """A force down on a block."""

    block: int
    force: float
    """[N]; below 0 it lifts."""
    at: tuple[float, float]
    """Where, x and y [m]."""


class Holding(NamedTuple):
    """What a state lacks that falls."""

    force: float
    """Least sum of components of forces, and of couples over a length, on all blocks, that would
    have to be added [N]: a measure; a single force that would hold it may be less or more."""
    moving: list[int]
    """Blocks that move first."""


class Balance:
    """The program of one assembly.

    Args:
        assembly: the blocks where they stand; steps are not looked at.
        forces: of its joints.
        sides: whether faces side by side push, too.
    """

    def __init__(self, assembly: Assembly, forces: Forces, sides: bool = False) -> None:
        blocks = assembly.blocks
        self.count: int = len(blocks)
        self.fixed: np.ndarray = np.array([block.support for block in blocks])
        self.weight: NDArray[np.float64] = GRAVITY * np.array([block.mass for block in blocks])
        centre = np.array([block.centroid for block in blocks])
        self._centre, self._blocks = centre, blocks
        self.unit: float = float(self.weight.mean())
        self._length = float(np.cbrt(np.median([block.volume for block in blocks])))
        self.kept: NDArray[np.int64] = (
            np.arange(len(forces.upright)) if sides else np.flatnonzero(forces.upright)
        )
        columns = Columns(*(field[self.kept] for field in forces.columns))
        self.columns: Columns = columns
        self.preload: Columns = forces.preload
        self._width = n = len(columns.b)
        matrix = self._matrix(joined([columns, forces.preload]), centre)
        first = matrix.indptr[n]
        matrix.data[first:] = np.asarray(matrix.data[first:], np.float64) / self.unit
        self._both = matrix
        self.bodies: tuple[np.ndarray, np.ndarray] = columns.a, columns.b
        self.pull_bodies: tuple[np.ndarray, np.ndarray] = forces.preload.a, forces.preload.b
        self._last = np.bincount(matrix.indices[first:], matrix.data[first:], 6 * self.count)
        filled = np.flatnonzero(self._last)
        start = np.append(matrix.indptr[: n + 1], first + len(filled))
        index = np.concatenate([matrix.indices[:first], filled])
        value = np.concatenate([matrix.data[:first], self._last[filled]])
        self._solver = solver = new_solver(self.count)
        self._lower = np.append(columns.lower / self.unit, 0.0)
        self._upper = np.append(columns.upper / self.unit, np.inf)
        load = self._load()
        cost = np.append(np.zeros(n), 1.0)
        self._present = np.ones(self.count, bool)
        self._free = ~self.fixed
        low, high = self._row_bounds(load, self._free)
        bounds = self._lower, self._upper
        status = pass_columns(solver, cost, bounds, (low, high), (start, index, value))
        if status == highspy.HighsStatus.kError:
            raise Learn2AssembleError("balance: the solver refused the matrix")
        self._load_now = load
        self._started, self._least = False, True
        self.clock: Clock | None = None
        """Where its time is over, no state is known to stand, and nothing to move; margins, which
        are of states that stand, are looked for all the same."""

    # ------------------------------------------------------------ the program

    @cached_property
    def downwards(self) -> np.ndarray:
        """int64[count]: all blocks, those that reach highest first."""
        low = np.array([block.vertices.min(0) for block in self._blocks])
        high = np.array([block.vertices[:, 2].max() for block in self._blocks])
        x, y, top = np.round(np.column_stack([low[:, :2], high]), 6).T
        return np.lexsort((y, x, -top))

    @cached_property
    def wrench(self) -> sp.csc_matrix:
        """[6 count, n]: wrenches of unit forces."""
        return self._both[:, : self._width]

    @cached_property
    def pulls(self) -> sp.csc_matrix:
        """[6 count, joints]: wrenches of whole preloads, in mean weights."""
        return self._both[:, self._width :]

    def _matrix(self, columns: Columns, centre: np.ndarray) -> sp.csc_matrix:
        """Wrenches of unit forces on the blocks, couples over a length."""
        body = np.stack([columns.b, columns.a], 1)
        arm = columns.at[:, None] - centre[body]
        force = columns.force[:, None] * [[1.0], [-1.0]]
        couple = columns.couple[:, None] * [[1.0], [-1.0]]
        turning = cross_product(arm.reshape(-1, 3), force.reshape(-1, 3)).reshape(arm.shape)
        wrench = np.concatenate([force, (turning + couple) / self._length], 2)
        borne = (body >= 0) & ~self.fixed[body]
        there = (np.abs(wrench) > 1e-12) & borne[..., None]
        row = (6 * body[..., None] + np.arange(6))[there]
        start = np.append(0, there.sum((1, 2)).cumsum())
        return sp.csc_matrix((wrench[there], row, start), (6 * self.count, len(body)))

    def _load(self, push: np.ndarray | None = None) -> np.ndarray:
        """float64[6 count]: what forces have to balance, in mean weights, with further forces down
        on blocks float64[count] [N]."""
        load = np.zeros((self.count, 6))
        load[:, 2] = (self.weight if push is None else self.weight + push) / self.unit
        return load.reshape(-1)

    def _unheld(
        self, there: np.ndarray, held: np.ndarray | None, hands: Mapping[int, Hand]
    ) -> np.ndarray:
        """bool[count]: blocks that have to be balanced, also by hands of which the wrench is
        bounded."""
        free = there & ~self.fixed
        if held is not None:
            rigid = held.copy()
            rigid[list(hands)] = False
            free &= ~rigid
        return free

    def _held(self, hands: Mapping[int, Hand], free: np.ndarray) -> list[HeldBlock]:
        """Hands of blocks, in the units of the program."""
        number = np.where(free, np.arange(self.count), -1)
        length = np.full(self.count, self._length)
        return held_blocks(hands, number, self._centre, self.unit, length)

    def _row_bounds(self, load: np.ndarray, free: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        rows = np.repeat(free, 6)
        return np.where(rows, load, -np.inf), np.where(rows, load, np.inf)

    def on(self, bodies: tuple[np.ndarray, np.ndarray], present: np.ndarray) -> np.ndarray:
        a, b = bodies
        return present[b] & ((a < 0) | present[a])

    def _set(self, present: np.ndarray, free: np.ndarray, load: np.ndarray) -> None:
        """Change what differs from the state before."""
        solver = self._solver
        if (present != self._present).any():
            before, now = self.on(self.bodies, self._present), self.on(self.bodies, present)
            change = np.flatnonzero(before != now).astype(np.int32)
            if len(change):
                on = now[change]
                solver.changeColsBounds(
                    len(change),
                    change,
                    np.where(on, self._lower[change], 0.0),
                    np.where(on, self._upper[change], 0.0),
                )
            pulling = self.on(self.pull_bodies, present).astype(float)
            last = self.pulls @ pulling
            for row in np.flatnonzero(np.abs(last - self._last) > 1e-12).tolist():
                solver.changeCoeff(row, self._width, float(last[row]))
            self._last, self._present = last, present.copy()
        low, high = self._row_bounds(load, free)
        old_low, old_high = self._row_bounds(self._load_now, self._free)
        change = np.flatnonzero((low != old_low) | (high != old_high)).astype(np.int32)
        if len(change):
            solver.changeRowsBounds(len(change), change, low[change], high[change])
        self._free, self._load_now = free.copy(), load

    def _run(self, timed: bool = True) -> tuple[bool, np.ndarray]:
        """Whether there is an optimum, and the columns.

        Args:
            timed: whether the clock counts.
        """
        solver, clock = self._solver, self.clock if timed else None
        status = run_within(solver, clock)
        if status not in DECIDED and status != STATUS.kTimeLimit:
            # It goes round in circles: from the start again, with costs that are perturbed.
            solver.clearSolver()
            for option, value in CAREFUL:
                solver.setOptionValue(option, value)
            status = run_within(solver, clock)
            for option, value in OPTIONS:
                solver.setOptionValue(option, value)
        if status == STATUS.kOptimal:
            return True, np.array(self._solver.getSolution().col_value)
        return False, np.zeros(self._width + 1)

    # ------------------------------------------------------------ questions

    def need(
        self,
        present: np.ndarray | None = None,
        held: np.ndarray | None = None,
        push: np.ndarray | None = None,
        hands: Mapping[int, Hand] = NO_HANDS,
    ) -> Need:
        """The strength that a state needs.

        Args:
            present: bool[count], the blocks that are there; all by default.
            held: bool[count], those of them that a hand holds.
            push: float64[count], further forces down on blocks, at their middle [N].
            hands: what the hands can give; a block that is held by any other bears any load.
        """
        there = np.ones(self.count, bool) if present is None else present
        free = self._unheld(there, held, hands)
        load = self._load(push)
        self._set(there, free, load)
        if self.count > _MANY and not self._started and not hands:
            found = self._by_cones(load, there, free)
            if found is not None and abs(found.share - 1.0) > _CLOSE:
                return found
        self._aim(True)
        if not self._started and not hands:
            self._begin(there, free)
        self._started = True
        with held_meanwhile(self._solver, self._held(hands, free), self.count):
            fits, x = self._run()
        if not fits:
            return Need(np.inf, x[: self._width])
        return Need(float(max(x[self._width], 0.0)), x[: self._width] * self.unit)

    def _begin(self, there: np.ndarray, free: np.ndarray) -> None:
        """Give the solver forces to begin from, where such are known."""
        known = self.columns, self.weight, self._centre
        found = first_basis(*known, free) if there.all() else None
        if found is None:
            return
        basic, rows = found
        at = highspy.HighsBasisStatus
        level = np.isinf(self.columns.lower)
        basis = highspy.HighsBasis()
        basis.col_status = [
            at.kBasic if one else at.kZero if any_way else at.kLower
            for one, any_way in zip(basic.tolist(), level.tolist(), strict=True)
        ] + [at.kLower]
        basis.row_status = [at.kBasic if one else at.kLower for one in rows.reshape(-1).tolist()]
        basis.valid = True
        self._solver.setBasis(basis)

    def lessened_by(self, columns: Columns) -> bool:
        """Whether further forces could lessen the need of all blocks that was asked last: not where
        the motion in which they fall does work against none of them, as that is the dual of the
        program with them, too."""
        if not self._started:
            return True
        motion = np.array(self._solver.getSolution().row_dual)
        work = self._matrix(columns, self._centre).T @ motion
        held = (columns.lower < 0) & (work < -_IDLE) | (columns.upper > 0) & (work > _IDLE)
        return not motion.any() or bool(held.any())

    def stands(
        self,
        present: np.ndarray,
        held: np.ndarray,
        push: Push | None = None,
        hands: Mapping[int, Hand] = NO_HANDS,
    ) -> bool:
        """Whether a state stands with the strength its joints have; quicker than :meth:`need`.

        Args:
            present: bool[count], the blocks that are there.
            held: bool[count], those of them that a hand holds.
            push: a further force on a block.
            hands: as of :meth:`need`.
        """
        free = self._unheld(present, held, hands)
        if not free.any():
            return True
        self._aim(False)
        self._set(present, free, self.pushed(push))
        with held_meanwhile(self._solver, self._held(hands, free), self.count):
            return self._run()[0]

    def pushed(self, push: Push | None) -> np.ndarray:
        """float64[6 count]: what forces have to balance while something pushes a block, in mean
        weights."""
        load = self._load()
        if push is not None:
            arm = np.array(push.at) - self._centre[push.block, :2]
            wrench = push.force / self.unit * np.array([1.0, *(arm[::-1] / self._length)])
            load[6 * push.block + np.arange(2, 5)] += wrench * [1, 1, -1]
        return load

    def _aim(self, least: bool) -> None:
        """Look for the least share of the strength, or for any forces with all of it.

        Without a cost every basis is one to go on from, so that states that follow each other cost
        a few steps each.
        """
        if least != self._least:
            cost, low, high = (1.0, 0.0, np.inf) if least else (0.0, 1.0, 1.0)
            self._solver.changeColCost(self._width, cost)
            self._solver.changeColBounds(self._width, low, high)
            self._least = least

    def _by_cones(self, load: np.ndarray, present: np.ndarray, free: np.ndarray) -> Need | None:
        """The same by interior points, which many blocks cost less; None where it is stuck."""
        rows = np.flatnonzero(np.repeat(free, 6))
        on = np.flatnonzero(self.on(self.bodies, present))
        last = sp.csc_matrix(self._last[rows].reshape(-1, 1))
        balance = sp.hstack([self.wrench[rows][:, on], last])
        lower, upper = np.append(self._lower[on], 0.0), np.append(self._upper[on], np.inf)
        seconds = INF if self.clock is None else self.clock.left
        found = by_cones(balance, load[rows], lower, upper, seconds)
        if found is None:
            return None
        forces = np.zeros(self._width)
        forces[on] = found[:-1] * self.unit
        return Need(float(max(found[-1], 0.0)), forces)

    def margin_g(
        self,
        present: np.ndarray | None = None,
        held: np.ndarray | None = None,
        hands: Mapping[int, Hand] = NO_HANDS,
    ) -> float:
        """Sideways acceleration [g] in every direction that a state that stands withstands.

        The accelerations that its joints can balance are a convex set; the largest circle about
        zero in the hull of points of its border is inside. Arguments as of :meth:`need`.
        """
        there = np.ones(self.count, bool) if present is None else present
        free = self._unheld(there, held, hands)
        if not free.any():
            return MOST_G
        with held_meanwhile(self._solver, self._held(hands, free), self.count):
            return self._margin_g(there, free)

    def _margin_g(self, there: np.ndarray, free: np.ndarray) -> float:
        """The same, once the hands are in the program."""
        self._aim(True)
        self._set(there, free, self._load())
        solver, width = self._solver, self._width
        pulling = self.on(self.pull_bodies, there).astype(float)
        offset = self.pulls @ pulling  # The whole strength is there.
        points, angles = list[np.ndarray](), list[float]()
        queue, above, load = list(_FIRST), MOST_G, self._load_now
        solver.changeColCost(width, -1.0)
        try:
            low, high = self._row_bounds(load - offset, free)
            rows = np.arange(len(low), dtype=np.int32)
            solver.changeRowsBounds(len(low), rows, low, high)
            while queue:
                angle = queue.pop(0)
                way = np.array([np.cos(angle), np.sin(angle)])
                column = np.zeros((self.count, 6))
                column[:, :2] = -self.weight[:, None] * way / self.unit
                self._replace_last(column.reshape(-1))
                solver.changeColBounds(width, 0.0, MOST_G)
                fits, x = self._run(timed=False)
                if not fits:
                    return 0.0
                reach, dual = float(x[width]), np.array(self._solver.getSolution().row_dual)
                dual = dual[: 6 * self.count]
                points.append(reach * way)
                angles.append(angle)
                above = min(above, self._bound(dual, load - offset, reach, way))
                if not queue and len(points) < _DIRECTIONS:
                    below, angle = inner_circle(np.array(points))
                    known = min(abs(np.angle(np.exp(1j * (angle - a)))) for a in angles) < 1e-3
                    if below < 0.99 * above and not known:
                        queue.append(angle)
            return float(min(max(inner_circle(np.array(points))[0], 0.0), MOST_G))
        finally:
            solver.changeColCost(width, 1.0)
            solver.changeColBounds(width, 0.0, np.inf)
            self._replace_last(offset)
            low, high = self._row_bounds(load, free)
            solver.changeRowsBounds(len(low), np.arange(len(low), dtype=np.int32), low, high)

    def _bound(self, dual: np.ndarray, load: np.ndarray, reach: float, way: np.ndarray) -> float:
        """How far the line through a point of the border that no acceleration passes is from 0."""
        side = dual.reshape(-1, 6)[:, :2]
        slope = (self.weight[:, None] / self.unit * side).sum(0)
        length = float(np.linalg.norm(slope))
        return MOST_G if length == 0 else abs(float(slope @ way)) * reach / length

    def _replace_last(self, column: np.ndarray) -> None:
        for row in np.flatnonzero(np.abs(column - self._last) > 1e-12).tolist():
            self._solver.changeCoeff(row, self._width, float(column[row]))
        self._last = column

    def holding(
        self,
        present: np.ndarray | None = None,
        held: np.ndarray | None = None,
        hands: Mapping[int, Hand] = NO_HANDS,
    ) -> Holding:
        """The least that a state lacks with all its strength, and what moves first, infinite and
        nothing where time is over; arguments as of :meth:`need`."""
        there = np.ones(self.count, bool) if present is None else present
        free = self._unheld(there, held, hands)
        rows = np.flatnonzero(np.repeat(free, 6))
        on = np.flatnonzero(self.on(self.bodies, there))
        pulling = self.on(self.pull_bodies, there).astype(float)
        load = self._load() - self.pulls @ pulling
        matrix = self.wrench
        if len(rows) < 6 * self.count or len(on) < self._width:
            matrix = matrix[rows][:, on]
        m, n = len(rows), len(on)
        start = np.append(matrix.indptr, matrix.nnz + 1 + np.arange(2 * m))
        index = np.concatenate([matrix.indices, np.tile(np.arange(m), 2)])
        filled = np.concatenate([matrix.data, np.repeat([1.0, -1.0], m)])
        solver = new_solver(self.count)
        cost = np.concatenate([np.zeros(n), np.ones(2 * m)])
        lower = np.concatenate([self._lower[on], np.zeros(2 * m)])
        upper = np.concatenate([self._upper[on], np.full(2 * m, np.inf)])
        least = load[rows]
        pass_columns(solver, cost, (lower, upper), (least, least), (start, index, filled))
        number = np.cumsum(free) - 1
        some = [one._replace(body=int(number[one.body])) for one in self._held(hands, free)]
        with held_meanwhile(solver, some, int(free.sum())):
            if run_within(solver, self.clock) == STATUS.kTimeLimit:
                return Holding(INF, [])
            force = float(solver.getInfo().objective_function_value) * self.unit
            motion = np.zeros(6 * self.count)
            motion[rows] = np.array(solver.getSolution().row_dual)[:m]
        size = np.linalg.norm(motion.reshape(-1, 6), axis=1)
        moving = np.flatnonzero(size >= _MOVES * max(size.max(initial=0.0), 1e-12)).tolist()
        return Holding(force, moving)


def balance_of(assembly: Assembly, sides: bool = False, cured: np.ndarray | None = None) -> Balance:
    """The program of an assembly; arguments as :class:`Balance` and
    :func:`.forces.forces_of`."""
    return Balance(assembly, forces_of(assembly, cured), sides)
