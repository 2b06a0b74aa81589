"""Which proof a state has, by name, and the ranges of friction and gap it holds for."""

from __future__ import annotations

from collections.abc import Sequence

from learn2assemble.errors import InputError, is_number

LOCAL, PROGRAM = "bed faces, local", "bed faces, program"
"""Loads are passed down level joints without friction, block by block or by a linear program."""
LEVEL = LOCAL, PROGRAM
"""Proofs of a step that hold whatever the friction is."""
FRICTIONLESS, BED, TIGHT = "bed faces, no friction", "bed faces", "tight joints"
"""What may carry: bed faces without friction; joints that weight presses, with it; side faces that
touch, too. The latter two name the proof of a step by the coupled analysis."""
POINTS = "edges and points"
"""Proof of a step of given blocks that rest on edges or points, too."""
CLUTCH, CLUTCH_TIGHT = "joints that hold", "joints that hold and tight joints"
"""Proof of a step of bricks that clutch, also under its press: without and with side faces."""
MORTAR = "mortar that holds"
"""Proof of a step of given blocks after one has waited until the mortar of those before it holds;
that of blocks that came since is not looked at, and they are dry."""

Bounds = float | tuple[float, float] | None
"""A number, or the smallest and the largest of a range; None: that of the kit."""


def widest_joint(gap: Bounds, usual: float, cell: Sequence[float]) -> float:
    """The width of the widest vertical joints between blocks of cells [m].

    Args:
        gap: what was asked for.
        usual: that of the kit [m].
        cell: edges of a cell [m].

    Raises:
        InputError: where it is not below half the width of a cell.
    """
    widest, limit = value_range(gap, usual, "gap")[1], min(cell[:2]) / 2
    if widest >= limit:
        raise InputError("gap", widest, f"less than half the pitch, {limit:g} m")
    return widest


def value_range(given: Bounds, default: float, what: str) -> tuple[float, float]:
    """Smallest and largest of a number or a range that was asked for, else of ``default``."""
    pair = tuple(given) if isinstance(given, tuple | list) else (given, given)
    ends = [default if end is None else end for end in pair]
    if not all(is_number(end) for end in ends) or not (len(ends) == 2 and 0 <= ends[0] <= ends[1]):
        raise InputError(what, given, "a number >= 0, or a range of them")
    low, high = ends
    return float(low), float(high)
