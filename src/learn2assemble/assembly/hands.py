r"""What a hand that holds a block can give it: forces and moments within bounds.

The set of wrenches :math:`w = (f, m)`, the force and the moment about a point of the block, is
convex and known by linear inequalities :math:`A w \le b` with :math:`b \ge 0`: a hand may always
give nothing. Round limits are replaced by polyhedra inside them, so what is proven with these holds
with the round ones, too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated

import numpy as np

from learn2assemble.errors import InputError, is_number
from learn2assemble.geometry.circles import ball
from learn2assemble.values import Range

LARGEST = 1e9
"""Size of a number of a hand, in its unit."""
Number = Annotated[float, Range(-LARGEST, LARGEST)]
Row = tuple[Number, Number, Number, Number, Number, Number]
MOST_ROWS = 400
SHORTEST = 1e-9
"""Length of a row of which the direction is known."""
_DIGITS = 9
"""Of the numbers of rows, of which the largest in every row is about 1."""


def _check_row(number: int, row: Sequence[float]) -> None:
    if len(row) != 6 or not SHORTEST <= math.hypot(*row) < math.inf:
        expected = f"6 numbers, as a vector of length {SHORTEST:g} or more"
        raise InputError(f"hand: rows[{number}]", list(row), expected)


@dataclass(frozen=True)
class Hand:
    """The wrenches that a hand can give a block.

    Args:
        point: about which moments are counted [m, world, with the block in its place].
        rows: each the coefficients of a force [1/N] and a moment [1/(N m)], along the axes of the
            world.
        most: of every row, what their sum with a wrench reaches at most, 0 or more.
        name: whose hand it is.

    Raises:
        InputError: for rows and bounds that do not fit, rows that are not of 6 numbers or shorter
            than :data:`SHORTEST`, bounds below 0, and numbers that are not finite.
    """

    point: tuple[Number, Number, Number]
    rows: tuple[Row, ...]
    most: tuple[Annotated[float, Range(0, LARGEST)], ...]
    name: str = ""

    def __post_init__(self) -> None:
        if not 1 <= len(self.rows) <= MOST_ROWS or len(self.most) != len(self.rows):
            got = f"{len(self.rows)} rows, {len(self.most)} bounds"
            raise InputError("hand", got, f"1 to {MOST_ROWS} rows, and as many bounds")
        for number, row in enumerate(self.rows):
            _check_row(number, row)
        if min(self.most) < 0:
            raise InputError("hand: most", min(self.most), "0 or more: a hand may give nothing")
        if not all(map(math.isfinite, (*self.point, *self.most))):
            raise InputError("hand", "NaN or infinity", "finite numbers")

    @classmethod
    def within(
        cls, point: Sequence[float], rows: np.ndarray, most: np.ndarray, name: str = ""
    ) -> Hand:
        """That of float64[k, 6] and float64[k] about float64[3].

        Raises:
            InputError: as of the class, and for what has other shapes.
        """
        if rows.ndim != 2 or rows.shape[1] != 6 or np.shape(most) != (len(rows),):
            got = f"shapes {rows.shape}, {np.shape(most)}"
            raise InputError("hand", got, "rows of 6 numbers, and as many bounds")
        size = np.linalg.norm(rows, axis=1)
        for number in np.flatnonzero(~(size >= SHORTEST)).tolist():
            _check_row(number, rows[number].tolist())
        table = (rows / size[:, None]).round(_DIGITS) + 0.0
        found = [tuple(row) for row in table.tolist()]
        bounds = (np.asarray(most) / size).round(_DIGITS)
        if np.shape(point) != (3,) or not np.isfinite(point).all():
            raise InputError("hand: point", point, "three finite numbers")
        x, y, z = (float(v) for v in point)
        return cls((x, y, z), tuple(found), tuple(bounds.tolist()), name)  # pyright: ignore[reportArgumentType]

    @classmethod
    def limited(cls, point: Sequence[float], force: float, moment: float, name: str = "") -> Hand:
        """A hand of which force [N] and moment [N m] have a largest size, in any direction.

        Each is counted on in a polyhedron inside the ball of that size, whose corners are on it:
        in every direction at least 0.886 of the size, in those of few all of it.

        Raises:
            InputError: as :meth:`within`, and for a size below 0, above :data:`LARGEST`, or none.
        """
        for what, size in (("force", force), ("moment", moment)):
            if not is_number(size, 0, LARGEST):
                expected = f"0 or more, up to {LARGEST:g}: a hand may give nothing"
                raise InputError(f"hand: {what}", size, expected)
        ways, share = ball(3)
        nothing = np.zeros_like(ways)
        rows = np.vstack([np.hstack([ways, nothing]), np.hstack([nothing, ways])])
        return cls.within(point, rows, share * np.repeat([force, moment], len(ways)), name)

    @cached_property
    def key(self) -> bytes:
        """Of tables of states."""
        return repr((self.point, self.most, self.name, hash(self.rows))).encode()

    @cached_property
    def _arrays(self) -> tuple[np.ndarray, np.ndarray]:
        return np.array(self.rows), np.array(self.most)

    def about(
        self, centre: np.ndarray, newton: float, length: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """The inequalities for forces in other units and moments about another point.

        Args:
            centre: float64[3], that point [m].
            newton: unit of force [N].
            length: moments are in units of ``newton`` times this [m].

        Returns:
            Rows float64[k, 6] of length 1, and bounds float64[k].
        """
        rows, most = self._arrays
        arm = np.array(self.point) - centre
        # The moment about the own point is that about the centre less arm x force.
        turned = np.cross(rows[:, 3:], arm)
        made = newton * np.hstack([rows[:, :3] - turned, length * rows[:, 3:]])
        size = np.linalg.norm(made, axis=1)
        return made / size[:, None], most / size

    def gives(self, force: np.ndarray, moment: np.ndarray) -> bool:
        """Whether a force float64[3] [N] with a moment float64[3] about the own point [N m] is one
        of its wrenches."""
        rows, most = self._arrays
        return bool((rows @ np.concatenate([force, moment]) <= most + 1e-12).all())

    def called(self, name: str) -> Hand:
        """The same hand of somebody else."""
        return replace(self, name=name)
