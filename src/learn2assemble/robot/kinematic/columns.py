"""Joint positions over a place, from the contact upwards; remembered."""

from __future__ import annotations

from collections import OrderedDict

import numpy as np

from learn2assemble.robot.arm import Arm
from learn2assemble.robot.inverse import RESTARTS, solve
from learn2assemble.robot.moves import Attitude, column

REMEMBERED = 20_000
"""Columns kept; the least recently used go first."""
GRAIN = 1e-4
"""Places that differ by less are one [m]."""


class Columns:
    """Solves columns of tool poses for one arm."""

    def __init__(self, arm: Arm) -> None:
        self.arm = arm
        self._known: OrderedDict[tuple[object, ...], np.ndarray | str] = OrderedDict()

    def solve(self, centre: np.ndarray, attitude: Attitude, height: float) -> np.ndarray | str:
        """Joint positions for the poses of :func:`column`.

        Neighbouring poses are on one branch: each solution starts from the one below.

        Returns:
            float64[k, n] [rad], or in words why there are none.
        """
        key = (*(round(float(c) / GRAIN) for c in centre), attitude, round(height / GRAIN))
        found = self._known.get(key)
        if found is None:
            found = self._known[key] = self._solve(centre, attitude, height)
            if len(self._known) > REMEMBERED:
                self._known.popitem(last=False)
        else:
            self._known.move_to_end(key)
        return found

    def _solve(self, centre: np.ndarray, attitude: Attitude, height: float) -> np.ndarray | str:
        poses = column(centre, attitude, height)
        start, out = self.arm.home, []
        for point in poses.position:
            # Only the first may be anywhere: a restart further up would leave the branch.
            restarts = 0 if out else RESTARTS
            solution = solve(self.arm, point, poses.rotation, start, restarts=restarts)
            if not solution.ok:
                x, y, z = np.round(point, 3).tolist()
                return f"tool at ({x}, {y}, {z}): {solution.failure.name.lower().replace('_', ' ')}"
            out.append(solution.joints)
            start = solution.joints
        return np.array(out)
