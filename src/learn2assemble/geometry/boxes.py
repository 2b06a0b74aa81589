"""Contact between equal axis-aligned cubes: overlap, support, and the column rule."""

from __future__ import annotations

from numba import njit

OVERLAP_TOLERANCE = 2e-3
"""Two boxes overlap when they penetrate by more than this along every axis [m]."""
CONTACT_TOLERANCE = 2e-3
"""Two faces touch when their gap is at most this [m]."""
CENTRED_TOLERANCE = 1e-3
"""A cube stands straight on another when their centres differ by at most this in x and y [m]."""

STABLE, OVERLAP, BELOW_GROUND, FLOATING, UNDECIDED, UNSTABLE = 0, 1, 2, 3, 4, 5


@njit(cache=True)
def classify_cube(position, count, x, y, z, half):
    """Verdict on a cube with centre (x, y, z) [m] against ``position[:count]`` (cubes too).

    Returns STABLE where the column rule proves it (on the ground, or straight on a cube that is
    itself stable), OVERLAP, BELOW_GROUND, FLOATING, or UNDECIDED where only the equilibrium
    program (:mod:`learn2assemble.physics.equilibrium`) can tell.
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
