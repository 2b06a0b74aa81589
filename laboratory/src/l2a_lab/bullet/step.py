"""One time step of the published cell, compiled: the arm's own dynamics, then all bodies.

The mass matrix and the forces of motion come from the links one after the other, in world axes
(recursive Newton-Euler; composite bodies), as in Featherstone, *Rigid Body Dynamics Algorithms*,
2008.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from l2a_lab.bullet.contacts import (
    BREAKING,
    Manifolds,
    accelerate,
    contact_points,
    integrate,
    inverse_mass_matrix,
    touching_bodies,
    turned_inertia,
    update_manifolds,
    wake,
)
from l2a_lab.bullet.resolution import FIRST, HAND, Drive, HandHold, resolve
from learn2assemble.geometry.rotations import quaternion_matrices, rotation_vector
from learn2assemble.kernels import kernel
from learn2assemble.kinematics.chain import (
    Chain,
    factorise,
    fill_gram,
    fill_jacobian,
    solve_factorised,
    tool_and_frames,
)
from learn2assemble.tasks.world.blocks import GRAVITY


class Links(NamedTuple):
    """What moves with each of the n joints, in its joint frame."""

    mass: np.ndarray
    """float64[n] [kg]."""
    centre: np.ndarray
    """float64[n, 3] [m]."""
    inertia: np.ndarray
    """float64[n, 3, 3]: about the centre [kg m^2]."""


class Bodies(NamedTuple):
    """The world, the hand, then every object; changed in place."""

    position: np.ndarray
    """float64[b, 3]: centres of mass; of the hand its tool point [m]."""
    quaternion: np.ndarray
    """float64[b, 4]."""
    rotation: np.ndarray
    """float64[b, 3, 3]: the same."""
    twist: np.ndarray
    """float64[b, 6]: velocity [m/s] and spin [rad/s]."""
    still: np.ndarray
    """int64[b]: steps for which a body has been still."""


class Held(NamedTuple):
    """What the hand holds, and how."""

    body: int
    """-1: nothing."""
    offset: np.ndarray
    """float64[3]: the point at the tool, in the body's frame [m]."""
    turn: np.ndarray
    """float64[3, 3]: of the body in the tool's frame."""


class Motors(NamedTuple):
    """The joints of the arm, changed in place but for the limits."""

    joints: np.ndarray
    """[rad]."""
    rates: np.ndarray
    """[rad/s]."""
    command: np.ndarray
    """[rad]."""
    lower: np.ndarray
    """[rad]."""
    upper: np.ndarray
    """[rad]."""


@kernel
def _cross(a: np.ndarray, b: np.ndarray, out: np.ndarray) -> None:
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@kernel
def arm_dynamics(
    links: Links, frames: tuple[np.ndarray, np.ndarray], rates: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Mass matrix float64[n, n] [kg m^2], and the torques float64[n] [N m] that gravity and motion
    ask of joints that do not accelerate.

    Args:
        links: see :class:`Links`.
        frames: positions float64[n, 3] [m] and rotations float64[n, 3, 3] of the joint frames.
        rates: float64[n] of the joints [rad/s].
    """
    positions, rotations = frames
    n = len(rates)
    mass, bias = np.empty((n, n)), np.empty(n)
    spin, turning, pull = np.zeros(3), np.zeros(3), np.array([0.0, 0.0, GRAVITY])
    centre, force, moment = np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 3))
    inertia = np.empty((n, 3, 3))
    arm, one, two, step = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for k in range(n):
        if k > 0:
            for i in range(3):
                arm[i] = positions[k, i] - positions[k - 1, i]
            _cross(turning, arm, one)
            _cross(spin, arm, two)
            _cross(spin, two, step)
            for i in range(3):
                pull[i] += one[i] + step[i]
        axis = rotations[k, :, 2]
        _cross(spin, axis, one)
        for i in range(3):
            turning[i] += rates[k] * one[i]
            spin[i] += rates[k] * axis[i]
        for i in range(3):
            arm[i] = 0.0
            for j in range(3):
                arm[i] += rotations[k, i, j] * links.centre[k, j]
            centre[k, i] = positions[k, i] + arm[i]
        _cross(turning, arm, one)
        _cross(spin, arm, two)
        _cross(spin, two, step)
        turned_inertia(rotations[k], links.inertia[k], inertia[k])
        for i in range(3):
            force[k, i] = links.mass[k] * (pull[i] + one[i] + step[i])
            one[i] = two[i] = 0.0
        # The moment about the centre: I alpha + omega x I omega.
        for i in range(3):
            for j in range(3):
                one[i] += inertia[k, i, j] * turning[j]
                two[i] += inertia[k, i, j] * spin[j]
        _cross(spin, two, step)
        for i in range(3):
            moment[k, i] = one[i] + step[i]
    total, whole, about = 0.0, np.zeros(3), np.zeros((3, 3))
    push, turn, joined = np.zeros(3), np.zeros(3), np.empty(3)
    for k in range(n - 1, -1, -1):
        # Bodies k.. as one: mass, centre, inertia about it; force, and moment about joint k.
        if k < n - 1:
            for i in range(3):
                arm[i] = positions[k + 1, i] - positions[k, i]
            _cross(arm, push, one)
            for i in range(3):
                turn[i] += one[i]
        for i in range(3):
            arm[i] = centre[k, i] - positions[k, i]
        _cross(arm, force[k], one)
        for i in range(3):
            turn[i] += one[i] + moment[k, i]
            push[i] += force[k, i]
        bias[k] = 0.0
        for i in range(3):
            bias[k] += rotations[k, i, 2] * turn[i]
        both = total + links.mass[k]
        for i in range(3):
            arm[i] = centre[k, i] - whole[i] if total > 0 else 0.0
            joined[i] = (total * whole[i] + links.mass[k] * centre[k, i]) / both
        reduced = total * links.mass[k] / both
        square = arm[0] * arm[0] + arm[1] * arm[1] + arm[2] * arm[2]
        for i in range(3):
            for j in range(3):
                about[i, j] += inertia[k, i, j] - reduced * arm[i] * arm[j]
            about[i, i] += reduced * square
            whole[i] = joined[i]
        total = both
        axis = rotations[k, :, 2]
        for i in range(3):
            arm[i] = whole[i] - positions[k, i]
        _cross(axis, arm, one)
        for i in range(3):
            two[i] = 0.0
            for j in range(3):
                two[i] += about[i, j] * axis[j]
        for j in range(k + 1):
            for i in range(3):
                arm[i] = whole[i] - positions[j, i]
            _cross(arm, one, step)
            entry = 0.0
            for i in range(3):
                entry += rotations[j, i, 2] * (two[i] + total * step[i])
            mass[k, j] = mass[j, k] = entry
    return mass, bias


@kernel
def _inverse(matrix: np.ndarray, out: np.ndarray) -> None:
    """Of a symmetric positive definite matrix, which is lost."""
    n = len(matrix)
    factorise(matrix, n)
    for k in range(n):
        for i in range(n):
            out[k, i] = 1.0 if i == k else 0.0
        solve_factorised(matrix, n, out[k])


@kernel
def _as_quaternion(rotation: np.ndarray, out: np.ndarray) -> None:
    """A quaternion of a rotation matrix, by its largest component."""
    x, y, z = rotation[0, 0], rotation[1, 1], rotation[2, 2]
    squares = (1 + x + y + z, 1 + x - y - z, 1 - x + y - z, 1 - x - y + z)
    best = 0
    for k in range(1, 4):
        if squares[k] > squares[best]:
            best = k
    a = rotation[2, 1] - rotation[1, 2]
    b = rotation[0, 2] - rotation[2, 0]
    c = rotation[1, 0] - rotation[0, 1]
    d = rotation[1, 0] + rotation[0, 1]
    e = rotation[0, 2] + rotation[2, 0]
    f = rotation[2, 1] + rotation[1, 2]
    size = 0.5 / np.sqrt(squares[best])
    if best == 0:
        out[0], out[1], out[2], out[3] = squares[0], a, b, c
    elif best == 1:
        out[0], out[1], out[2], out[3] = a, squares[1], d, e
    elif best == 2:
        out[0], out[1], out[2], out[3] = b, d, squares[2], f
    else:
        out[0], out[1], out[2], out[3] = c, e, f, squares[3]
    for k in range(4):
        out[k] *= size


@kernel
def follow(chain: Chain, joints: np.ndarray, bodies: Bodies) -> None:
    """The hand is where the joints, float64[n] [rad], take it."""
    n = len(joints)
    tool_and_frames(
        chain,
        joints,
        np.empty((n, 3)),
        np.empty((n, 3, 3)),
        bodies.position[HAND],
        bodies.rotation[HAND],
    )
    _as_quaternion(bodies.rotation[HAND], bodies.quaternion[HAND])


@kernel
def fill_poses(bodies: Bodies, centre: np.ndarray, out: np.ndarray) -> None:
    """Poses float64[b - 1, 7] of the hand and the objects: origin [m] and quaternion.

    Args:
        centre: float64[b, 3]: centres of mass in the bodies' frames [m].
    """
    for b in range(HAND, len(centre)):
        for i in range(3):
            away = 0.0
            for k in range(3):
                away += bodies.rotation[b, i, k] * centre[b, k]
            out[b - HAND, i] = bodies.position[b, i] - away
        out[b - HAND, 3:] = bodies.quaternion[b]


@kernel
def _hold(bodies: Bodies, held: Held) -> HandHold:
    error, point = np.zeros(6), np.zeros(3)
    if held.body >= 0:
        rotation, hand = bodies.rotation[held.body], bodies.rotation[HAND]
        wanted = np.zeros((3, 3))
        for i in range(3):
            point[i] = bodies.position[held.body, i]
            for k in range(3):
                point[i] += rotation[i, k] * held.offset[k]
                for j in range(3):
                    wanted[i, j] += hand[i, k] * held.turn[k, j]
            error[i] = bodies.position[HAND, i] - point[i]
        rotation_vector(rotation, wanted, error[3:])
    return HandHold(held.body, point, error)


@kernel
def advance(
    chain: Chain,
    links: Links,
    motors: Motors,
    impulse: float,
    bodies: Bodies,
    held: Held,
    inverse_mass: np.ndarray,
    inverse_inertia: np.ndarray,
    manifolds: Manifolds,
    body: np.ndarray,
    clock: int,
    found: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray],
    skin: float,
    timestep: float,
) -> np.ndarray:
    """One time step, once it is known where shapes touch; returns int64[k, 2], the bodies that do.

    Args:
        chain: of the arm; links: what moves with its joints; motors: see :class:`Motors`.
        impulse: largest of a motor in a step [N m s].
        bodies: see :class:`Bodies`; held: :class:`Held`.
        inverse_mass: float64[b] [1/kg]; inverse_inertia: float64[b, 3, 3], in the bodies' frames.
        manifolds: of pairs of shapes; body: int64[g] of each shape; clock: number of the step.
        found: of each contact the shapes int32[c, 2], the distance float64[c] [m], the point
            float64[c, 3] [m], and the frame float64[c, 9], its normal first.
        skin: so much thicker is the hand [m].
        timestep: [s].
    """
    _find(manifolds, clock, found, body, bodies, skin)
    touching = touching_bodies(manifolds, body)
    awake = wake(bodies.still, touching, held.body)
    contacts = contact_points(manifolds, body, bodies.position, bodies.rotation, awake)
    n = len(motors.joints)
    positions, rotations = np.empty((n, 3)), np.empty((n, 3, 3))
    tool, axes, jac = np.empty(3), np.empty((3, 3)), np.empty((6, n))
    tool_and_frames(chain, motors.joints, positions, rotations, tool, axes)
    fill_jacobian(positions, rotations, tool, jac)
    mass, bias = arm_dynamics(links, (positions, rotations), motors.rates)
    inverse = np.empty((n, n))
    _inverse(mass, inverse)
    for i in range(n):
        for k in range(n):
            motors.rates[i] -= timestep * inverse[i, k] * bias[k]
    accelerate(bodies.twist, awake, timestep)
    for i in range(6):
        bodies.twist[HAND, i] = 0.0
        for k in range(n):
            bodies.twist[HAND, i] += jac[i, k] * motors.rates[k]
    resolve(
        bodies.position,
        bodies.twist,
        motors.rates,
        inverse_mass_matrix(inverse_mass, inverse_inertia, bodies.rotation, awake),
        contacts,
        Drive(jac, inverse, motors.joints, motors.command, motors.lower, motors.upper, impulse),
        _hold(bodies, held),
        timestep,
    )
    integrate(bodies.position, bodies.quaternion, bodies.twist, awake, bodies.still, timestep)
    for i in range(n):
        motors.joints[i] += timestep * motors.rates[i]
    for b in range(FIRST, len(awake)):
        if awake[b]:
            bodies.rotation[b] = quaternion_matrices(bodies.quaternion[b : b + 1])[0]
    follow(chain, motors.joints, bodies)
    return touching


@kernel
def _find(
    manifolds: Manifolds,
    clock: int,
    found: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray],
    body: np.ndarray,
    bodies: Bodies,
    skin: float,
) -> None:
    """Bring the manifolds up to date with those contacts that are near."""
    geom, dist, pos, frame = found
    near = 0
    count = len(dist)
    shapes, normal = np.empty((count, 2), np.int64), np.empty((count, 3))
    point, distance = np.empty((count, 3)), np.empty(count)
    for c in range(count):
        i, j = geom[c, 0], geom[c, 1]
        gap = dist[c] - (skin if body[i] == HAND or body[j] == HAND else 0.0)
        if gap < BREAKING:
            shapes[near, 0], shapes[near, 1], distance[near] = i, j, gap
            point[near], normal[near] = pos[c], frame[c, :3]
            near += 1
    update_manifolds(
        manifolds,
        clock,
        shapes[:near],
        body,
        point[:near],
        normal[:near],
        distance[:near],
        bodies.position,
        bodies.rotation,
    )


@kernel
def fill_centres(bodies: Bodies, body: np.ndarray, offset: np.ndarray, out: np.ndarray) -> None:
    """Where the cells are, float64[n, 3] [m].

    Args:
        body: int64[n] of each cell; offset: float64[n, 3] from its centre of mass, in its frame.
    """
    for c in range(len(body)):
        b = body[c]
        for i in range(3):
            out[c, i] = bodies.position[b, i]
            for k in range(3):
                out[c, i] += bodies.rotation[b, i, k] * offset[c, k]


@kernel
def correction(
    chain: Chain, joints: np.ndarray, base: np.ndarray, left: np.ndarray, total: np.ndarray
) -> None:
    """Adds J^T (J J^T)^-1 ``left`` to ``total``, float64[n] [rad].

    J are the rows float64[3, n] of the velocity of that point of the hand which is at the arm's
    base: the integral term of the published servo uses these rows for those of the tool, so errors
    are corrected in directions a little beside their own.

    Args:
        joints: float64[n] [rad]; base: float64[3], of the arm [m]; left: float64[3] [m].
    """
    n = len(joints)
    positions, rotations = np.empty((n, 3)), np.empty((n, 3, 3))
    jac, gram, need = np.empty((6, n)), np.empty((3, 3)), left.copy()
    tool_and_frames(chain, joints, positions, rotations, np.empty(3), np.empty((3, 3)))
    fill_jacobian(positions, rotations, base, jac)
    fill_gram(jac, 3, np.ones(n, np.bool_), 0.0, gram)
    factorise(gram, 3)
    solve_factorised(gram, 3, need)
    for k in range(n):
        for i in range(3):
            total[k] += jac[i, k] * need[i]
