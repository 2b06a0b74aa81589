"""Why a recorded step and its repetition differ: the known limits of either simulation."""

from __future__ import annotations

import numpy as np

from learn2assemble.geometry.support import BALANCE_TOLERANCE
from learn2assemble.physics.equilibrium import find_contacts, is_stable
from learn2assemble.physics.rigid import RULES
from learn2assemble.world.blocks import EDGE, HALF

EDGE_CASE, STUCK, JITTER, UNEXPLAINED = "edge", "stuck", "jitter", "unexplained"


def snap(centres: np.ndarray) -> np.ndarray:
    """Nearest lattice cells: recorded structures have drifted by less than a millimetre or two."""
    ground = np.array([0.0, 0.0, HALF])
    return EDGE * np.rint((centres - ground) / EDGE) + ground


def starts_or_ends_on_edge(centres: np.ndarray, object_id: np.ndarray, new: int) -> bool:
    """Whether it takes less than a millimetre to make this structure stand, or fall.

    Asked with the cells from ``new`` on, and without them: a bar that has begun to tip slowly goes
    on doing so. In both cases the recorded outcome is one of chance: the same bar at the same
    place, its centre of mass exactly above the edge of a cube, was recorded with summed speeds
    from 0.25 to 1.0 m/s.

    Args:
        centres: float64[n, 3] [m], the structure with the new object.
        object_id: int64[n].
        new: first cell of the new object.
    """
    cells = snap(centres)
    return any(
        _overhangs(cells[:count])
        and is_stable(cells[:count], object_id[:count], slack=BALANCE_TOLERANCE)
        and not is_stable(cells[:count], object_id[:count], slack=-BALANCE_TOLERANCE)
        for count in (new, len(cells))
    )


def _overhangs(cells: np.ndarray) -> bool:
    """Whether some cell of the lattice has nothing below it."""
    filled = {tuple(cell) for cell in np.rint(cells / HALF).astype(int).tolist()}
    return any(z > 1 and (x, y, z - 2) not in filled for x, y, z in filled)


def explain(
    centres: np.ndarray, object_id: np.ndarray, new: int, invalid: bool, speeds: list[float]
) -> str:
    """The class of a disagreement.

    Args:
        centres, object_id, new: see :func:`starts_or_ends_on_edge`.
        invalid: the recorded outcome.
        speeds: the recorded V of each block [m/s].

    Returns:
        ``edge``: see :func:`starts_or_ends_on_edge`; ``stuck``: nothing carries some block, but
        it touches others, where the published engine may let it hang; ``jitter``: only the sum of
        the speeds was over its limit, not that of any block; ``unexplained``.
    """
    if starts_or_ends_on_edge(centres, object_id, new):
        return EDGE_CASE
    cells = snap(centres)
    if not is_stable(cells, object_id, slack=BALANCE_TOLERANCE):
        contacts = find_contacts(cells, object_id)
        touched = np.union1d(contacts.body_a, contacts.body_b)
        return STUCK if len(touched) == len(np.unique(object_id)) + 1 else UNEXPLAINED
    if invalid and max(speeds, default=np.inf) <= RULES["block"]:
        return JITTER
    return UNEXPLAINED
