"""Contact between equal axis-aligned cubes, and whether an object made of them stands on others.

Two sufficient conditions decide nearly always without the equilibrium program. Both assume that
the structure without the new object is in equilibrium.

*It stands* where its centre of mass lies above the hull of its contacts with the ground and with
cubes whose column is unbroken down to the ground: such a column passes a vertical force at any
point of its top to the ground and leaves every other force as it was.

*It falls* where all its contacts lie at one height and face up and its centre of mass is outside
their hull: friction has no moment about a horizontal axis in that plane.

Objects on a lattice with gaps are held together by fillers, see :func:`find_fillers`, which count
for the centre of mass only.
"""

from __future__ import annotations

import math

import numpy as np

from learn2assemble.kernels import kernel

OVERLAP_TOLERANCE = 2e-3
"""Two boxes overlap when they penetrate by more than this along every axis [m]."""
CONTACT_TOLERANCE = 2e-3
"""Two faces touch when their gap is at most this [m]."""
CENTRED_TOLERANCE = 1e-3
"""A cube stands straight on another when their centres differ by at most this in x and y [m]."""

STABLE, OVERLAP, BELOW_GROUND, FLOATING, UNDECIDED, UNSTABLE = 0, 1, 2, 3, 4, 5


@kernel
def classify_cube(
    position: np.ndarray, count: int, x: float, y: float, z: float, half: float
) -> int:
    """Verdict on a cube with centre (x, y, z) [m] against ``position[:count]`` (cubes too).

    Returns STABLE where the column rule proves it (on the ground, or straight on a cube that is
    itself stable), OVERLAP, BELOW_GROUND, FLOATING, or UNDECIDED where only the equilibrium
    program (:mod:`learn2assemble.tasks.physics.equilibrium`) can tell.
    """
    if z - half < -OVERLAP_TOLERANCE:
        return BELOW_GROUND
    edge = 2 * half
    on_ground = z - half <= CONTACT_TOLERANCE
    centred = False
    touched = False
    for j in range(count):
        dx = abs(x - position[j, 0])
        dy = abs(y - position[j, 1])
        dz = z - position[j, 2]
        inside = edge - OVERLAP_TOLERANCE
        if dx >= inside or dy >= inside:
            continue
        if abs(dz) < inside:
            return OVERLAP
        if abs(dz - edge) <= CONTACT_TOLERANCE:
            touched = True
            if dx <= CENTRED_TOLERANCE and dy <= CENTRED_TOLERANCE:
                centred = True
    if on_ground or centred:
        return STABLE
    return UNDECIDED if touched else FLOATING


BALANCE_TOLERANCE = 1e-3
"""How far beyond its support a centre of mass may be [m]: an overhang of exactly one half stands
whatever the rounding, as it does in the simulations."""
FILLER_SLACK = 1e-3
"""How exactly cells of an object are level and in line [m]; a smaller gap has no filler."""
_MAX_PATCHES = 12
"""Contact patches looked at per cell: four at most on top of cubes that do not overlap, doubled
and more for tolerances."""


@kernel
def find_fillers(
    position: np.ndarray, first: int, count: int, half: float, centre: np.ndarray
) -> int:
    """Fillers of the object with cells ``position[first:count]``; returns their number.

    Where two of its cells are horizontal neighbours with a gap between them, the gap is filled with
    a body as heavy as a cube.

    Args:
        centre: float64[2 * (count - first), 3], written: their centres [m].
    """
    found = 0
    for k in range(first, count):
        for j in range(first, k):
            dx, dy = abs(position[k, 0] - position[j, 0]), abs(position[k, 1] - position[j, 1])
            if (
                2 * half + FILLER_SLACK < max(dx, dy) < 3 * half
                and min(dx, dy) <= FILLER_SLACK
                and abs(position[k, 2] - position[j, 2]) <= FILLER_SLACK
            ):
                for axis in range(3):
                    centre[found, axis] = (position[k, axis] + position[j, axis]) / 2
                found += 1
    return found


def filler_centres(cells: np.ndarray, half: float) -> np.ndarray:
    """float64[f, 3]: centres of the fillers of the object with these cells, float64[n, 3] [m]."""
    found = np.empty((2 * len(cells), 3))
    return found[: find_fillers(np.ascontiguousarray(cells), 0, len(cells), half, found)]


@kernel
def reaches_ground(position: np.ndarray, count: int, cube: int, half: float) -> bool:
    """Whether straight below ``cube`` one cube of ``position[:count]`` follows on the other."""
    while True:
        x, y, z = position[cube, 0], position[cube, 1], position[cube, 2]
        if z - half <= CONTACT_TOLERANCE:
            return True
        below = -1
        for j in range(count):
            if (
                abs(x - position[j, 0]) <= CENTRED_TOLERANCE
                and abs(y - position[j, 1]) <= CENTRED_TOLERANCE
                and abs(z - position[j, 2] - 2 * half) <= CONTACT_TOLERANCE
            ):
                below = j
                break
        if below < 0:
            return False
        cube = below


@kernel
def outside_hull(points: np.ndarray, count: int, x: float, y: float, tolerance: float) -> bool:
    """Whether (x, y) is more than ``tolerance`` beyond an edge of the hull of ``points[:count]``.

    True without points; the hull must have an area.
    """
    if count == 0:
        return True
    for a in range(count):
        for b in range(count):
            ex, ey = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1]
            length = math.sqrt(ex * ex + ey * ey)
            if length < 1e-9:
                continue
            beyond = (ex * (y - points[a, 1]) - ey * (x - points[a, 0])) / length
            if beyond >= -tolerance:
                continue
            # The point is right of a to b; that counts where no other point is: an edge of the
            # hull. Few points make this cheaper than building the hull.
            edge = True
            for c in range(count):
                side = ex * (points[c, 1] - points[a, 1]) - ey * (points[c, 0] - points[a, 0])
                if side < -1e-12:
                    edge = False
                    break
            if edge:
                return True
    return False


@kernel
def classify_object(position: np.ndarray, first: int, count: int, half: float) -> int:
    """Verdict on the object with cells ``position[first:count]`` against ``position[:first]``.

    Returns STABLE or UNSTABLE where one of the proofs above decides, OVERLAP or BELOW_GROUND for
    any of its cells, FLOATING where nothing is below any of them, and UNDECIDED otherwise.
    """
    # An overlap of any cell is told before one of another with the ground.
    below_ground = False
    for k in range(first, count):
        found = classify_cube(position, first, position[k, 0], position[k, 1], position[k, 2], half)
        if found == OVERLAP:
            return OVERLAP
        below_ground |= found == BELOW_GROUND
    if below_ground:
        return BELOW_GROUND

    edge = 2 * half
    size = count - first
    firm = np.empty((4 * _MAX_PATCHES * size, 2))
    points = np.empty((4 * _MAX_PATCHES * size, 2))
    num_firm, num_points = 0, 0
    lowest, highest = np.inf, -np.inf
    covered = False
    centre_x, centre_y = 0.0, 0.0
    fillers = np.empty((2 * size, 3))
    found = find_fillers(position, first, count, half, fillers)
    weight = size + found
    for k in range(found):
        centre_x += fillers[k, 0]
        centre_y += fillers[k, 1]
    centre_x, centre_y = centre_x / weight, centre_y / weight
    for k in range(first, count):
        x, y, z = position[k, 0], position[k, 1], position[k, 2]
        centre_x += x / weight
        centre_y += y / weight
        for j in range(-1, first):
            if j < 0:
                # The ground.
                if z - half > CONTACT_TOLERANCE:
                    continue
                middle_x, middle_y, reach_x, reach_y = x, y, half, half
                is_firm = True
            else:
                depth_x = edge - abs(x - position[j, 0])
                depth_y = edge - abs(y - position[j, 1])
                if depth_x <= OVERLAP_TOLERANCE or depth_y <= OVERLAP_TOLERANCE:
                    continue
                rise = z - position[j, 2]
                # Something rests on the object: its forces may hold it, so it is not proven to
                # fall.
                if abs(rise + edge) <= CONTACT_TOLERANCE:
                    covered = True
                if abs(rise - edge) > CONTACT_TOLERANCE:
                    continue
                middle_x, middle_y = (x + position[j, 0]) / 2, (y + position[j, 1]) / 2
                reach_x, reach_y = depth_x / 2, depth_y / 2
                is_firm = reaches_ground(position, first, j, half)
            # More patches than there is room for are left to the program.
            if num_points + 4 > len(points):
                return UNDECIDED
            lowest, highest = min(lowest, z), max(highest, z)
            for sx in (-1.0, 1.0):
                for sy in (-1.0, 1.0):
                    points[num_points, 0] = middle_x + sx * reach_x
                    points[num_points, 1] = middle_y + sy * reach_y
                    if is_firm:
                        firm[num_firm, 0] = points[num_points, 0]
                        firm[num_firm, 1] = points[num_points, 1]
                        num_firm += 1
                    num_points += 1
    if num_points == 0:
        return FLOATING
    if not outside_hull(firm, num_firm, centre_x, centre_y, BALANCE_TOLERANCE):
        return STABLE
    level = highest - lowest <= CONTACT_TOLERANCE
    if (
        level
        and not covered
        and outside_hull(points, num_points, centre_x, centre_y, BALANCE_TOLERANCE)
    ):
        return UNSTABLE
    return UNDECIDED
