"""What a design asks of the blocks: how much is enough, the fewest, and why it cannot be built.

All bounds are about towers in the planes of the elevations (:mod:`~.design_towers`).
"""

from __future__ import annotations

import dataclasses

import numpy as np

from learn2assemble.errors import InputError
from learn2assemble.world.design_model import Design
from learn2assemble.world.design_pixels import NUM_LEVELS, TOUCHING, Cell, Terms
from learn2assemble.world.design_towers import (
    connected,
    first_tower,
    inside_cells,
    limits_of,
    most_pixels,
    needed_cells,
    share_of,
    solid_height,
    towers_of,
)

BESIDE = 0.001
"""How far beside its place a block may stand that an arm has put down [m]."""


def unsupported_cells(design: Design, terms: Terms = TOUCHING) -> tuple[tuple[Cell, ...], ...]:
    """Per elevation, the needed cells inside its outline with a cell below them that is not.

    "Not" means inside no elevation. No cube can bridge such a gap, so these cells need blocks
    outside the outlines to carry them. Sorted by column, then level.
    """
    needed, inside = needed_cells(design, terms), inside_cells(design, terms)
    result: list[list[Cell]] = [[] for _ in design.elevations]
    for tower in towers_of(design, terms):
        height = solid_height(tower)
        for side, column in tower.faces:
            cells = (Cell(column, level) for level in range(height, NUM_LEVELS))
            result[side] += [c for c in cells if c in needed[side] and c in inside[side]]
    return tuple(tuple(sorted(cells)) for cells in result)


def required_share(design: Design, terms: Terms = TOUCHING) -> float:
    """F_co that must be exceeded.

    Where blocks stand apart, it is the design's share of what they can cover, as nobody can fill
    the gaps between them. They may stand a little beside their places then, so pixels that see the
    very edge of a block count half.
    """
    if not terms.of_coverable:
        return design.success_threshold
    free = dataclasses.replace(design, supports=True)
    most = [_most_share(free, terms._replace(margin=margin)) for margin in (0.0, BESIDE)]
    return design.success_threshold * sum(most) / len(most)


def _most_share(design: Design, terms: Terms) -> float:
    """F_co with as many blocks as there is room for."""
    return float(share_of(design, most_pixels(design, limits_of(design, terms), terms), terms)[-1])


def minimum_blocks(design: Design, terms: Terms = TOUCHING) -> int:
    """The fewest blocks, the first one included, with which F_co exceeds the threshold.

    Exact over all sets of towers that stand in the planes of the elevations, by dynamic
    programming over the towers; a block at the corner of a 3x3 footprint counts once. That the
    towers must also touch one another is left out, so it is a lower bound where they do not.
    With ``supports`` off, towers end below the first cell outside the outlines.

    Raises:
        InputError: where ``supports`` is off and no number of blocks suffices.
    """
    best = most_pixels(design, limits_of(design, terms), terms)
    enough = np.flatnonzero(share_of(design, best, terms) > required_share(design, terms))
    if len(enough) == 0:
        reason = explain_refusal(design, terms) or "out of reach"
        raise InputError("supports", design.supports, f"true, because {reason}")
    return int(enough[0])


def explain_refusal(design: Design, terms: Terms = TOUCHING) -> str | None:
    """Why the design cannot be built, in one sentence without a full stop, or None."""
    if not design.supports:
        reason = _explain_overhang(design, terms)
        if reason is not None:
            return reason
    least = minimum_blocks(design, terms)
    if design.num_blocks is not None and design.num_blocks < least:
        return f"needs at least {least} blocks, the design gives {design.num_blocks}"
    return None


def _explain_overhang(design: Design, terms: Terms) -> str | None:
    """Why it cannot be built from blocks inside the outlines alone, or None where it can."""
    if Cell(0, 0) not in inside_cells(design, terms)[design.first_elevation]:
        name = design.elevations[design.first_elevation].name
        return (
            f"the first block stands at the bottom centre of elevation {name!r}, outside its "
            "outline, and supports are off"
        )
    share = share_of(design, most_pixels(design, limits_of(design, terms), terms), terms)[-1]
    if share > required_share(design, terms):
        return None
    tail = (
        f"and supports are off: the rest is {100 * share:.1f} % of what the first block leaves, "
        f"more than {100 * required_share(design, terms):g} % are asked for"
    )
    for elevation, cells in zip(design.elevations, unsupported_cells(design, terms), strict=True):
        if cells:
            listed = ", ".join(f"(column {c.column}, level {c.level})" for c in cells[:4])
            more = f" and {len(cells) - 4} more" if len(cells) > 4 else ""
            name = elevation.name
            return f"elevation {name!r} overhangs at {listed}{more}, no cube can bridge it, {tail}"
    towers = towers_of(design, terms)
    reached = connected(towers, first_tower(design, towers).place)
    if any(tower.inside[0] and tower.place not in reached for tower in towers):
        return f"parts of it stand apart from the first block, {tail}"
    return f"the outlines only graze some of the cells they need, {tail}"
