r"""Static equilibrium of rigid objects made of cubes, as a linear program over contact forces.

Find contact forces :math:`f_p`, one at every corner :math:`p` of every contact patch, with

.. math::

    \sum_{p \in C_b} \pm f_p + m_b\,(a\,d - g\,\hat z) &= 0    \\
    \sum_{p \in C_b} \pm (x_p - c_b) \times f_p        &= 0    \qquad \text{for every object } b \\
    f_p = \sum_{k=1}^{8} \lambda_{pk}\,(n_p + \mu\, t_{pk}), \quad \lambda_{pk} &\ge 0

where the sign is + on the object the patch pushes and - on the one that pushes back, ``c_b`` is
the centre of mass, ``n_p`` the patch normal and ``t_pk`` eight unit tangents: the Coulomb cone is
replaced by the octagonal pyramid inside it, exact along the axes. :func:`is_stable` asks for a
solution at ``a = 0``; :func:`stability_margin` maximises the inertial load ``a`` along sixteen
horizontal directions ``d``, each the direction of a tangent: for every second one the pyramid is
turned. Since loads that can be balanced are a convex set, those in the hull of the sixteen can be,
too. Inside, lengths are in block edges and forces in block weights.

A solution means that forces *can* balance, not that they *will*: two walls could clamp a block
that nothing presses between them. Placing blocks does not preload vertical faces, so only
horizontal patches carry force, and friction acts there.
"""

from __future__ import annotations

from typing import NamedTuple

import highspy
import numpy as np

from learn2assemble.constants import EDGE, FRICTION, HALF
from learn2assemble.errors import InputError, Learn2AssembleError
from learn2assemble.geometry.circles import inner_circle
from learn2assemble.linear_programs import pass_columns
from learn2assemble.tasks.physics.support import (
    CONTACT_TOLERANCE,
    OVERLAP_TOLERANCE,
    filler_centres,
)

GROUND = -1
CONE_SIDES = 8
_PRIMAL_SIMPLEX = 4
_CORNERS = np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]], float)
_ANGLES = 2 * np.pi / CONE_SIDES * np.arange(CONE_SIDES)


class BoxContacts(NamedTuple):
    """Point contacts at the corners of contact patches."""

    points: np.ndarray
    """float64[C, 3]: in the world [m], halfway through the gap."""
    normals: np.ndarray
    """float64[C, 3]: unit, from ``body_a`` to ``body_b``."""
    body_a: np.ndarray
    """int64[C]: the object that pushes back, -1 for the ground; objects are numbered 0.. in the
    order of their sorted ``object_id``."""
    body_b: np.ndarray
    """int64[C]: the object that is pushed along the normal."""


def find_contacts(centres: np.ndarray, object_id: np.ndarray, slack: float = 0.0) -> BoxContacts:
    """Corners of the contact patches between cubes of different objects, and with the ground.

    Two cubes touch when the gap along one axis is within CONTACT_TOLERANCE of zero and they
    overlap by more than OVERLAP_TOLERANCE along the two others. Cells of one object never touch.

    Args:
        centres: float64[n, 3], centres of axis-aligned cubes [m, world].
        object_id: int64[n]; cubes with the same number are cells of one rigid object.
        slack: how much farther than its edges a patch reaches [m].

    Raises:
        InputError: for arrays of another shape or coordinates that are not finite.
    """
    centres, body = _check(centres, object_id)
    first, second = np.triu_indices(len(centres), 1)
    other = body[first] != body[second]
    first, second = first[other], second[other]
    delta = centres[second] - centres[first]
    depth = EDGE - np.abs(delta)
    touching = np.abs(depth) <= CONTACT_TOLERANCE
    beside = depth > OVERLAP_TOLERANCE
    parts = [_ground_contacts(centres, body, slack)]
    for axis in (2, 0, 1):
        u, v = (k for k in range(3) if k != axis)
        pair = np.flatnonzero(touching[:, axis] & beside[:, u] & beside[:, v])
        upward = delta[pair, axis] > 0
        low = np.where(upward, first[pair], second[pair])
        high = np.where(upward, second[pair], first[pair])
        middle = (centres[low] + centres[high]) / 2
        points = np.repeat(middle[:, None], 4, 1)
        for k in (u, v):
            points[:, :, k] += (depth[pair, k, None] / 2 + slack) * _CORNERS[None, :, int(k == v)]
        parts.append(_patches(points, axis, body[low], body[high]))
    return BoxContacts(*[np.concatenate(field) for field in zip(*parts, strict=True)])


def is_stable(
    centres: np.ndarray,
    object_id: np.ndarray,
    friction: float = FRICTION,
    *,
    slack: float = 0.0,
) -> bool:
    """Whether contact forces inside the friction cones can carry the weight of every object.

    The paper judges stability by simulation; this is its static counterpart.
    Every cube weighs the same, so the mass cancels.

    Args:
        centres: float64[n, 3] [m, world].
        object_id: int64[n], see :func:`find_contacts`.
        friction: Coulomb coefficient of every contact.
        slack: how much farther than its edges a contact patch reaches [m]; settles by a margin
            what is balanced exactly on an edge.

    Raises:
        InputError: for malformed arrays or a negative friction.
        Learn2AssembleError: where the solver fails.
    """
    program = _BalanceProgram(centres, object_id, friction, slack)
    return program.num_objects == 0 or (program.touches_all and program.solve() is not None)


def stability_margin(
    centres: np.ndarray, object_id: np.ndarray, friction: float = FRICTION
) -> float:
    """Horizontal acceleration, in g, the structure withstands in every direction, from below.

    At most 2 % below the largest one for these friction pyramids; 0 where it does not even stand.
    Sliding on the ground caps it at ``friction``, which is also the answer for an empty structure.
    A column of n cubes gives 1/n. Arguments and errors as :func:`is_stable`.
    """
    reached = list[np.ndarray]()
    for turn in (0.0, np.pi / CONE_SIDES):
        program = _BalanceProgram(centres, object_id, friction, turn=turn)
        if program.num_objects == 0:
            return float(friction)
        if not program.touches_all or program.solve() is None:
            return 0.0
        for direction in _tangents(turn):
            value = program.solve(direction)
            # Standing has just been shown, so a refusal here is only a tolerance away from zero.
            reached.append((value or 0.0) * direction)
    return min(inner_circle(np.array(reached))[0], float(friction))


def _tangents(turn: float) -> np.ndarray:
    """float64[8, 2]: the edges of a friction pyramid that is turned by an angle [rad]."""
    return np.stack([np.cos(_ANGLES + turn), np.sin(_ANGLES + turn)], -1)


def _check(centres: np.ndarray, object_id: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    centres, ids = np.asarray(centres, float), np.asarray(object_id)
    if centres.ndim != 2 or centres.shape[1] != 3 or not np.isfinite(centres).all():
        raise InputError("centres", centres.shape, "finite coordinates of shape (n, 3)")
    if ids.shape != (len(centres),):
        raise InputError("object_id", ids.shape, f"one number a cube, shape ({len(centres)},)")
    return centres, np.unique(ids, return_inverse=True)[1].reshape(-1)


def _patches(points: np.ndarray, axis: int, body_a: np.ndarray, body_b: np.ndarray) -> BoxContacts:
    """Four point contacts of every patch; ``points`` is float64[P, 4, 3]."""
    normals = np.zeros((4 * len(points), 3))
    normals[:, axis] = 1.0
    return BoxContacts(points.reshape(-1, 3), normals, np.repeat(body_a, 4), np.repeat(body_b, 4))


def _ground_contacts(centres: np.ndarray, body: np.ndarray, slack: float) -> BoxContacts:
    down = np.flatnonzero(np.abs(centres[:, 2] - HALF) <= CONTACT_TOLERANCE)
    points = np.repeat(centres[down][:, None], 4, 1)
    points[:, :, :2] += (HALF + slack) * _CORNERS
    points[:, :, 2] = 0.0
    return _patches(points, 2, np.full(len(down), GROUND), body[down])


def _fillers(centres: np.ndarray, body: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centres float64[f, 3] of the fillers of all objects, and whose they are int64[f]."""
    found, owner = [np.empty((0, 3))], list[int]()
    for number in np.flatnonzero(np.bincount(body) > 1).tolist():
        found.append(filler_centres(centres[body == number], HALF))
        owner += [number] * len(found[-1])
    return np.concatenate(found), np.array(owner, np.int64)


class _BalanceProgram:
    """The linear program of one structure: columns are the multipliers, then the load ``a``."""

    def __init__(
        self,
        centres: np.ndarray,
        object_id: np.ndarray,
        friction: float,
        slack: float = 0.0,
        turn: float = 0.0,
    ) -> None:
        if not (np.isfinite(friction) and friction >= 0):
            raise InputError("friction", friction, "a finite number >= 0")
        centres, body = _check(centres, object_id)
        contacts = find_contacts(centres, body, slack)
        flat = contacts.normals[:, 2] == 1.0
        contacts = BoxContacts(*[field[flat] for field in contacts])
        self.num_objects = int(body.max()) + 1 if len(body) else 0
        # What fills the gaps of objects is as heavy as a cube.
        filler, its_body = _fillers(centres, body)
        heavy, owner = np.concatenate([centres, filler]), np.concatenate([body, its_body])
        self.mass = np.bincount(owner, minlength=self.num_objects).astype(float)
        weighted = np.zeros((self.num_objects, 3))
        np.add.at(weighted, owner, heavy)
        self._centre = weighted / np.maximum(self.mass, 1)[:, None]
        touched = np.concatenate([contacts.body_a, contacts.body_b])
        self.touches_all = len(np.setdiff1d(np.arange(self.num_objects), touched)) == 0
        self._start, self._index, self._value = self._columns(contacts, friction, turn)
        self._solver: highspy.Highs | None = None

    def _columns(
        self, contacts: BoxContacts, friction: float, turn: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Wrenches of the cone generators on both objects, as sparse columns."""
        # Per normal axis, the eight tangents in the plane of the patch.
        tangents = np.zeros((3, CONE_SIDES, 3))
        for axis in range(3):
            tangents[axis][:, [k for k in range(3) if k != axis]] = _tangents(turn)
        axes = np.argmax(contacts.normals, 1)
        generators = contacts.normals[:, None] + friction * tangents[axes]
        rows, values = list[np.ndarray](), list[np.ndarray]()
        for body, sign in ((contacts.body_a, -1.0), (contacts.body_b, 1.0)):
            # The ground needs no equations: its columns are dropped below as zeros.
            lever = (contacts.points - self._centre[body]) / EDGE
            wrench = np.concatenate([generators, np.cross(lever[:, None], generators)], -1)
            values.append(np.where(body == GROUND, 0.0, sign)[:, None, None] * wrench)
            row = 6 * np.maximum(body, 0)[:, None] + np.arange(6)
            rows.append(np.broadcast_to(row[:, None], wrench.shape))
        value = np.concatenate(values, -1).reshape(-1, 12)
        index = np.concatenate(rows, -1).reshape(-1, 12)
        keep = value != 0.0
        start = np.concatenate([[0], np.cumsum(keep.sum(1))])
        return start.astype(np.int32), index[keep].astype(np.int32), value[keep]

    def solve(self, direction: np.ndarray | None = None) -> float | None:
        """The largest load along ``direction`` (0 without one), or None where nothing balances."""
        solver = self._load()
        load = len(self._start) - 1
        if direction is None:
            solver.changeColBounds(load, 0.0, 0.0)
            solver.changeColCost(load, 0.0)
        else:
            for body, mass in enumerate(self.mass):
                for k in range(2):
                    solver.changeCoeff(6 * body + k, load, mass * float(direction[k]))
            solver.changeColBounds(load, 0.0, highspy.kHighsInf)
            solver.changeColCost(load, -1.0)
            # The last basis balances gravity, so it is feasible here: the primal method goes on.
            solver.setOptionValue("simplex_strategy", _PRIMAL_SIMPLEX)
        solver.run()
        status = solver.getModelStatus()
        if status == highspy.HighsModelStatus.kUnknown:
            # On the border between the two answers the simplex method may give up.
            solver.clearSolver()
            solver.setOptionValue("solver", "ipm")
            solver.run()
            status = solver.getModelStatus()
            solver.setOptionValue("solver", "choose")
        if status == highspy.HighsModelStatus.kOptimal:
            return float(-solver.getInfo().objective_function_value)
        if status == highspy.HighsModelStatus.kInfeasible:
            return None
        raise Learn2AssembleError(f"equilibrium program: the solver stopped with {status}")

    def _load(self) -> highspy.Highs:
        """The solver holding this program; later directions start from its last basis."""
        if self._solver is not None:
            return self._solver
        num_columns = len(self._start)
        solver = highspy.Highs()
        solver.setOptionValue("output_flag", False)
        solver.setOptionValue("threads", 1)
        solver.setOptionValue("presolve", "off")
        zeros, free = np.zeros(num_columns), np.full(num_columns, highspy.kHighsInf)
        weight = np.zeros((self.num_objects, 6))
        weight[:, 2] = self.mass
        weight = weight.reshape(-1)
        matrix = self._start, self._index, self._value
        pass_columns(solver, zeros, (zeros, free), (weight, weight), matrix)
        self._solver = solver
        return solver
