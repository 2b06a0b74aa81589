r"""The balance of rigid blocks as cone programs over the forces at the corners of their contacts.

Forces :math:`f_p` at the corners of the contact patches and a wrench :math:`s_b` with which a hand
would have to hold every block balance the weight of all blocks:

.. math:: \sum_{p \in C_b} \pm (f_p,\; (x_p - c_b) \times f_p) + s_b + (m_b g, 0) = 0.

Rigid-block equilibrium (RBE) asks for the least :math:`\sum_b |s_b|` with :math:`f_p` in the round
Coulomb cone. Where it is above zero the assembly falls, and the multipliers of the balance are the
motion in which it starts to. Where it is zero forces *can* balance, not that they *will*: friction
may squeeze itself, as in a bar pinched between two posts. The coupled analysis (CRA, Kao et al.
2022) refuses those. It is reproduced here with elastic joints: the energy
:math:`\sum f_n^2/k_n + |f_t|^2/k_t` is least subject to :math:`|f_t| \le r_p`, where :math:`r_p` is
friction times the normal force (non-associated friction, Haslinger 1983; found in
:mod:`.elastic_joints`). The assembly stands where a fixed point without holding force is found.

Inside, lengths are in edges of a median block and forces in mean weights of a block.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any, Literal, NamedTuple

import clarabel  # pyright: ignore[reportMissingTypeStubs]
import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from learn2assemble.assembly.blocks import Assembly, Block
from learn2assemble.assembly.contacts import Contacts, across
from learn2assemble.assembly.hands import Hand
from learn2assemble.constants import GRAVITY
from learn2assemble.errors import InputError, Learn2AssembleError
from learn2assemble.statics.forces.elastic_joints import Joined
from learn2assemble.statics.forces.hands import NO_HANDS, HeldBlock, hand_columns, held_blocks

_conic: Any = clarabel
"""A compiled module without types."""

HELD, HELD_BLOCK = 5e-4, 1e-2
"""Holding forces taken for rounding: all, in the whole weight; of one block, in its weight."""
BALANCED, BALANCED_COUPLED = 1e-6, 1e-4
"""Force that may be missing at a block, in its weight: of RBE and of the coupled analysis."""
_ITERATIONS = 100
"""Of the cone solver."""
_TOLERANCES = (1e-8, 1e-6, 1e-5)
"""Of the cone solver. A program it is stuck in, such as that of blocks that rest on nothing, is
solved again with the next one, still far below what counts as rounding."""
_SOLVED = (_conic.SolverStatus.Solved, _conic.SolverStatus.AlmostSolved)
_STUCK = (
    _conic.SolverStatus.InsufficientProgress,
    _conic.SolverStatus.NumericalError,
    _conic.SolverStatus.MaxIterations,
)
_EXACT = 1e4
"""Price of a holding force against elastic energy; the largest displacement that is not a fall."""
MOVES = 0.1
"""A block moves where its part of the motion is this share of the largest."""
MOST_G = 10.0
"""Margins are cut here [g]."""


class Equilibrium(NamedTuple):
    """What :func:`solve` found."""

    stands: bool
    method: Literal["frictionless", "rbe", "cra"]
    """What decided: forces without friction, RBE, or the coupled analysis."""
    holding_force: float
    """Least sum over blocks of the length of a force and a moment over the radius of the block that
    would have to be added [N]: a measure; a single force that would hold it may be less or more."""
    moving: np.ndarray
    """int64[M]: indices of the blocks that start to move; empty where it stands."""
    forces: np.ndarray
    """float64[C, 3]: on block ``b`` of the patch of each corner [N, world]."""
    stiffness: float = 0.0
    """Tangential over normal stiffness of the joints of the fixed point, where one was found."""


class System:
    """The balance of all free blocks as sparse matrices, in units of a median block."""

    def __init__(
        self,
        assembly: Assembly,
        contacts: Contacts,
        present: np.ndarray | None = None,
        held: np.ndarray | None = None,
        hands: Mapping[int, Hand] = NO_HANDS,
    ) -> None:
        blocks = assembly.blocks
        there = np.ones(len(blocks), bool) if present is None else np.asarray(present, bool)
        if there.shape != (len(blocks),):
            raise InputError("present", there.shape, f"shape ({len(blocks)},)")
        on = there[contacts.b] & ((contacts.a < 0) | there[contacts.a])
        self._on = on[contacts.patch]
        contacts = contacts if on.all() else contacts.only(on)
        free = there & ~np.array([block.support for block in blocks])
        if held is not None:
            rigid = held.copy()
            rigid[list(hands)] = False
            free &= ~rigid
        self.free: NDArray[np.intp] = np.flatnonzero(free)
        self.count: int = len(self.free)
        self.corners: int = len(contacts.points)
        number = np.cumsum(free) - 1
        self._length = float(np.median([block.volume for block in blocks])) ** (1 / 3)
        movable = [block for block, on in zip(blocks, free, strict=True) if on]
        mass = np.array([block.mass for block in movable])
        self._newton = GRAVITY * float(mass.mean()) if self.count else 1.0
        self.mass: np.ndarray = mass / mass.mean() if self.count else mass
        centre = np.array([block.centroid for block in movable]).reshape(-1, 3)
        reach = [
            np.linalg.norm(block.vertices - c, axis=1).max()
            for block, c in zip(movable, centre, strict=True)
        ]
        self.radius: np.ndarray = np.array(reach) / self._length
        self._frame = corner_frames(contacts)
        level = (np.abs(contacts.normal[:, 2]) > 1 - 1e-6) & (contacts.spread == 0)
        self.upright: bool = bool(level.all())
        """Whether all joints are level, and known to be."""
        self._contacts = contacts
        soft = corner_softness(contacts, self._length)
        self._soft, points = soft, contacts.points
        self._bodies = np.stack(
            [
                np.where((body >= 0) & free[body], number[body], -1)[contacts.patch]
                for body in (contacts.a, contacts.b)
            ]
        )
        self.centre: np.ndarray = centre / self._length
        reach, frame = self.radius * self._length, self._frame
        # Of what bears any load there is no row, whatever stands in its place here.
        self._wrench = np.zeros((2, self.corners, 3, 6))
        for body, sign, wrench in zip(self._bodies, (-1.0, 1.0), self._wrench, strict=True):
            if self.count:
                wrench[:] = _wrenches(points - centre[body], sign * frame, reach[body])
        self.balance: sp.csc_matrix = self._balance()
        row = np.where(free, number, -1)
        every = np.zeros((len(blocks), 4))
        every[self.free, :3], every[self.free, 3] = centre, reach
        self.held: list[HeldBlock] = held_blocks(
            hands, row, every[:, :3], self._newton, every[:, 3]
        )
        weight = np.zeros((self.count, 6))
        weight[:, 2] = self.mass
        self.weight: NDArray[np.float64] = weight.reshape(-1)

    def _balance(self) -> sp.csc_matrix:
        """Wrench [6 count] of the corner forces in their frames; column 3 p is a normal force."""
        rows, columns, values = list[np.ndarray](), list[np.ndarray](), list[np.ndarray]()
        for body, wrench in zip(self._bodies, self._wrench, strict=True):
            corner = np.flatnonzero(body >= 0)
            row = 6 * body[corner][:, None, None] + np.arange(6)
            column = 3 * corner[:, None, None] + np.arange(3)[:, None]
            shape = len(corner), 3, 6
            rows.append(np.broadcast_to(row, shape).ravel())
            columns.append(np.broadcast_to(column, shape).ravel())
            values.append(wrench[corner].ravel())
        index = np.concatenate(rows), np.concatenate(columns)
        shape = 6 * self.count, 3 * self.corners
        return sp.csc_matrix((np.concatenate(values), index), shape)

    @cached_property
    def joined(self) -> Joined:
        """The joints as springs."""
        return Joined(self._bodies, self._wrench, 1 / self._soft, self.mass, self.held)

    def excess(self, held: np.ndarray) -> float:
        """Holding forces in what is taken for rounding."""
        every = held.sum() / (HELD * self.mass.sum())
        return float(max(every, (held / self.mass).max() / HELD_BLOCK))

    def newtons(self, forces: np.ndarray | None) -> np.ndarray:
        """Forces in their frames as forces in the world [N], zero at corners of absent blocks."""
        result = np.zeros((len(self._on), 3))
        if forces is not None:
            result[self._on] = self._newton * np.einsum("pk,pkj->pj", forces, self._frame)
        return result

    def fall(
        self,
        method: Literal["rbe", "cra"],
        forces: np.ndarray,
        held: np.ndarray,
        motion: np.ndarray,
    ) -> Equilibrium:
        """The answer where holding forces are needed."""
        size = np.linalg.norm(motion, axis=1)
        moving = self.free[size >= MOVES * size.max()]
        total = float(held.sum()) * self._newton
        return Equilibrium(False, method, total, moving, self.newtons(forces))

    def nearest(self, friction: float) -> np.ndarray | None:
        """Forces float64[corners, 3] in Coulomb's cone that balance everything; None where none
        were found, which proves nothing."""
        near, limit = np.zeros((self.corners, 3)), self._contacts.friction(friction)
        load = self.weight.reshape(-1, 6)
        found, answer = self.joined.nearest(load, limit, near, BALANCED)
        return answer.forces if found else None

    def centred(self, friction: float, share: float) -> np.ndarray | None:
        """Forces float64[corners, 3] that balance everything, with which every corner of a joint
        bears at least a share of the mean of its joint: those for which hands give least, as the
        sum of their squares, and then of least elastic energy. None where there are none."""
        corners, patch = self.corners, self._contacts.patch
        if not corners:
            return None
        cone, parts = _cones(self._contacts.friction(friction))
        does, limited, most = hand_columns(self.held, self.count)
        count, every = np.bincount(patch), np.arange(corners)
        same = sp.csr_matrix((np.ones(corners), (every, patch)))
        mean = sp.csr_matrix(same @ sp.diags(1 / np.maximum(count, 1)) @ same.T)
        least = sp.kron(share * mean + sp.diags(-np.ones(corners)), [[1.0, 0.0, 0.0]])
        rows = [[self.balance, does], [cone, None], [least, None], [None, limited]]
        matrix = sp.bmat(rows if len(most) else [row[:1] for row in rows[:3]]).tocsc()
        bound = np.concatenate([self.weight, np.zeros(4 * corners), most])
        cones = [_conic.ZeroConeT(6 * self.count), *parts]
        cones.append(_conic.NonnegativeConeT(corners + len(most)))
        width = matrix.shape[1]
        energy = np.concatenate([1e-3 * np.repeat(self._soft, 3), np.ones(width - 3 * corners)])
        answer = _run(sp.diags(energy), np.zeros(width), matrix, bound, cones)
        return None if answer is None else np.array(answer.x)[: 3 * corners].reshape(-1, 3)

    def least_holding(self, friction: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """RBE: forces [corners, 3], holding forces [count], motion [count, 6]."""
        cone, parts = _cones(self._contacts.friction(friction))
        # A little elastic energy chooses among the forces where there are many.
        return self._with_holding(
            1e-6 * np.repeat(self._soft, 3), 1.0, cone, np.zeros(3 * self.corners), parts
        )

    def coupled(
        self, friction: float, stiffness: float, forces: np.ndarray | None = None
    ) -> tuple[bool, np.ndarray]:
        """CRA: whether a fixed point stands, and its forces, or the last ones.

        Args:
            forces: of RBE, float64[corners, 3], to look for it from.
        """
        joined, limit = self.joined, self._contacts.friction(friction)
        terms = self.weight.reshape(-1, 6), limit, stiffness, BALANCED_COUPLED
        if forces is None:
            found, answer = joined.coupled(*terms)
            if found:
                return True, answer.forces
            forces = np.zeros((self.corners, 3))
        balances, near = joined.nearest(*terms[:2], forces, BALANCED)
        found, answer = joined.coupled_by_rounds(*terms, near) if balances else (False, near)
        return found, answer.forces

    def held_back(
        self, friction: float, forces: np.ndarray, stiffness: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """As least_holding, of elastic joints whose friction is what these forces allow."""
        corners = self.corners
        soft = (self._soft[:, None] * [1.0, 1 / stiffness, 1 / stiffness]).reshape(-1)
        disc = sp.diags(np.tile([0.0, -1.0, -1.0], corners))
        pick = sp.csc_matrix(
            (-np.ones(corners), (np.arange(corners), 3 * np.arange(corners))),
            (corners, 3 * corners),
        )
        limits = np.zeros(4 * corners)
        limits[corners::3] = self._contacts.friction(friction) * np.maximum(forces[:, 0], 0)
        parts = [_conic.NonnegativeConeT(corners), *[_conic.SecondOrderConeT(3)] * corners]
        return self._with_holding(soft, _EXACT, sp.vstack([pick, disc]), limits, parts)

    def _with_holding(
        self, soft: np.ndarray, price: float, signs: Any, limits: np.ndarray, parts: list[Any]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Least elastic energy plus price times the norm of the holding force of every block.

        Args:
            soft: float64[3 corners], compliance.
            price: of a holding force.
            signs: of the constraint ``limits - signs @ forces`` in the cones ``parts``.
        """
        count, corners = self.count, 3 * self.corners
        does, limited, most = hand_columns(self.held, count)
        more = 6 * len(self.held)
        energy = sp.diags(np.concatenate([soft, np.zeros(7 * count + more)]))
        price_of = np.zeros(corners + 6 * count), np.full(count, price), np.zeros(more)
        cost = np.concatenate(price_of)
        held, norm = (
            sp.kron(sp.identity(count), -part) for part in (np.eye(7, 6, -1), np.eye(7, 1))
        )
        rows = [
            [self.balance, sp.identity(6 * count), None, does],
            [signs, None, None, None],
            [None, held, norm, None],
            [None, None, None, limited],
        ]
        matrix = sp.bmat(rows if more else [row[:3] for row in rows[:3]]).tocsc()
        bound = np.concatenate([self.weight, limits, np.zeros(7 * count), most])
        cones = [_conic.ZeroConeT(6 * count), *parts, *[_conic.SecondOrderConeT(7)] * count]
        cones += [_conic.NonnegativeConeT(len(most))] * bool(more)
        answer = _run(energy, cost, matrix, bound, cones)
        if answer is None:
            raise Learn2AssembleError("equilibrium program: the solver stopped without a solution")
        x = np.array(answer.x)
        slack = x[corners : corners + 6 * count].reshape(-1, 6)
        motion = np.array(answer.z[: 6 * count]).reshape(-1, 6)
        return x[:corners].reshape(-1, 3), np.linalg.norm(slack, axis=1), motion

    def least_parting(
        self, friction: float, jump: sp.csc_matrix, price: np.ndarray
    ) -> np.ndarray | None:
        """How far pairs of blocks part in a motion that lowers the weight, or None.

        The motion opens or slides every joint at least as steeply as friction asks for, so that no
        contact forces hold it back (Farkas): it exists exactly where RBE has no solution.

        Args:
            jump: [6 pairs, 6 count], the relative motion of each pair.
            price: float64[pairs], of the largest component of it; the motion taken is the cheapest.

        Returns:
            float64[pairs], that component.
        """
        pairs, corners = len(price), self.corners
        dual = self._slides(friction) @ self.balance.T
        most = sp.kron(sp.identity(pairs), np.ones((6, 1)))
        rows = [[sp.csr_matrix(self.weight), None], [jump, -most], [-jump, -most], [-dual, None]]
        matrix = sp.bmat(rows).tocsc()
        bound = np.concatenate([[-1.0], np.zeros(12 * pairs + 3 * corners)])
        cones = [_conic.ZeroConeT(1), _conic.NonnegativeConeT(12 * pairs)]
        cones += [_conic.SecondOrderConeT(3)] * corners
        count = 6 * self.count
        energy = sp.csc_matrix((count + pairs, count + pairs))
        answer = _run(energy, np.concatenate([np.zeros(count), price]), matrix, bound, cones)
        if answer is None:
            return None
        return np.abs(jump @ np.array(answer.x)[:count]).reshape(-1, 6).max(1)

    def _slides(self, friction: float) -> Any:
        """Scales a motion at the corners so that Coulomb's cone becomes one of a right angle."""
        limit = self._contacts.friction(friction)
        return sp.diags(np.stack([np.ones_like(limit), limit, limit], 1).reshape(-1))

    def load_program(
        self, friction: float
    ) -> Callable[[np.ndarray], tuple[np.ndarray, float] | None]:
        """A function of a horizontal direction float64[2]: of all sideways loads up to MOST_G that
        friction holds the one farthest along it, float64[2] [g], and how far along it that is,
        which no other passes; None where nothing is held.

        It solves the dual, which is smaller: of all motions that friction holds back nowhere and
        on which a load does work as the direction tells, the one that lifts the weight least, and
        works least against hands, which hold back what their bounds allow.
        """
        corners = self.corners
        moves = (self._slides(friction) @ self.balance.T).tocsr()
        if friction > 0:
            cones = [_conic.SecondOrderConeT(3)] * corners
        else:
            # A cone without interior would stall the solver.
            moves, cones = moves[::3], [_conic.NonnegativeConeT(corners)]
        load = np.zeros((self.count, 6, 2))
        load[:, 0, 0] = load[:, 1, 1] = self.mass
        # Work that is left over costs what the largest load would do.
        does, limited, most = hand_columns(self.held, self.count)
        rows = [
            [sp.csr_matrix(load.reshape(-1, 2).T), sp.identity(2), None, None],
            [-moves, None, None, None],
            [None, None, -sp.identity(1), None],
            [None, -sp.identity(2), None, None],
            [does.T, None, None, limited.T],
            [None, None, None, -sp.identity(len(most))],
        ]
        matrix = sp.bmat(rows if len(most) else [row[:3] for row in rows[:4]]).tocsc()
        cones = [_conic.ZeroConeT(2), *cones, _conic.SecondOrderConeT(3)]
        if len(most):
            cones += [_conic.ZeroConeT(6 * len(self.held)), _conic.NonnegativeConeT(len(most))]
        cost = np.concatenate([self.weight, np.zeros(2), [MOST_G], most])
        energy = sp.csc_matrix((len(cost), len(cost)))

        bound = np.zeros(moves.shape[0] + 5 + (6 * len(self.held) + len(most)))
        # Directions differ in this bound alone: the matrix is ordered and scaled once.
        # Refining every step takes 2 of 5 parts of the time, and what ends a program is how far
        # its answer is from one, however its steps were found.
        solver = _solver(energy, cost, matrix, bound, cones, _TOLERANCES[1], refined=False)

        def run(direction: np.ndarray) -> tuple[np.ndarray, float] | None:
            bound[:2] = direction
            solver.update(b=bound)
            answer = solver.solve()
            if answer.status in _STUCK:
                answer = _run(energy, cost, matrix, bound, cones, _TOLERANCES[2:])
            elif answer.status not in _SOLVED:
                answer = None
            return None if answer is None else (-np.array(answer.z[:2]), float(answer.obj_val))

        return run


def corner_frames(contacts: Contacts) -> np.ndarray:
    """float64[C, 3, 3]: at every corner the normal of its patch and two directions across."""
    frame = np.concatenate([contacts.normal[:, None], across(contacts.normal)], 1)
    return frame[contacts.patch]


def corner_softness(contacts: Contacts, length: float) -> np.ndarray:
    """float64[C]: compliance of the joint at every corner, in units of a block of that length."""
    share = np.maximum(np.bincount(contacts.patch, minlength=len(contacts.a)), 1)
    area = (contacts.area / share)[contacts.patch] / length**2
    return 1 / np.maximum(area, 1e-4)


def corner_wrenches(blocks: Sequence[Block], contacts: Contacts) -> tuple[np.ndarray, np.ndarray]:
    """float64[C, 3, 6] twice: what unit forces at the corners do to blocks ``a`` and ``b``.

    Moments are about the centroid of the block and in units of force times its radius; those on
    the ground mean nothing.
    """
    centre = np.array([block.centroid for block in blocks])
    reach = np.array(
        [
            np.linalg.norm(block.vertices - at, axis=1).max()
            for block, at in zip(blocks, centre, strict=True)
        ]
    )
    frame = corner_frames(contacts)
    first, second = (
        _wrenches(contacts.points - centre[body], sign * frame, reach[body])
        for body, sign in ((contacts.a[contacts.patch], -1.0), (contacts.b[contacts.patch], 1.0))
    )
    return first, second


def _wrenches(arm: np.ndarray, frame: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """float64[n, 3, 6]: forces along the rows of frames and their moments over ``reach``."""
    moment = np.cross(arm[:, None], frame) / reach[:, None, None]
    return np.concatenate([frame, moment], -1)


def _cones(friction: np.ndarray) -> tuple[sp.csr_matrix, list[Any]]:
    """Coulomb's law: the negated rows of forces, and the cones they are in.

    Args:
        friction: float64[corners], coefficients.
    """
    corners = len(friction)
    order = np.arange(3 * corners).reshape(corners, 3)
    # A cone without interior would stall the solver.
    smooth, rough = order[friction <= 0], order[friction > 0]
    scale = np.ones((corners, 3))
    scale[:, 0] = np.where(friction > 0, friction, 1.0)
    rows = np.concatenate([smooth[:, 0], smooth[:, 1:].reshape(-1), rough.reshape(-1)])
    parts = [_conic.SecondOrderConeT(3)] * len(rough)
    if len(smooth):
        flat = [_conic.NonnegativeConeT(len(smooth)), _conic.ZeroConeT(2 * len(smooth))]
        parts = [*flat, *parts]
    return -sp.csr_matrix(sp.diags(scale.reshape(-1)))[rows], parts


def _run(
    energy: Any,
    cost: np.ndarray,
    matrix: Any,
    bound: np.ndarray,
    cones: list[Any],
    tolerances: tuple[float, ...] = _TOLERANCES,
) -> Any:
    """Solve one cone program; None where it is infeasible or the solver cannot tell."""
    for tolerance in tolerances:
        answer = _solver(energy, cost, matrix, bound, cones, tolerance).solve()
        if answer.status not in _STUCK:
            return answer if answer.status in _SOLVED else None
    return None


def _solver(
    energy: Any,
    cost: np.ndarray,
    matrix: Any,
    bound: np.ndarray,
    cones: list[Any],
    tolerance: float,
    refined: bool = True,
) -> Any:
    """A solver of: least x energy x / 2 + cost x where bound - matrix x is in the cones.

    Args:
        refined: whether the equations of its steps are solved again for what is left of them.
    """
    settings = _conic.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    settings.max_iter = _ITERATIONS
    settings.iterative_refinement_enable = refined
    settings.presolve_enable = False  # it would refuse a new bound
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance
    return _conic.DefaultSolver(sp.csc_matrix(energy), cost, matrix, bound, cones, settings)
