r"""What joints of bricks can bear, as columns of a linear program.

A contact point of a clutch pushes, or pulls up to its capacity :math:`T`. Its net force is
:math:`v \ge -T`, so a joint is a constant pull :math:`T` at every point, a *preload*, and pushes
:math:`p \ge 0` at the corners of the hull of its points: what pushes at the hull can produce is
exactly what pushes at the points can. Sideways forces at its knobs are free, and so is a couple
about the vertical where it has two knobs or more; faces side by side only push.

Other joints have their forces at the corners of their patches: eight directions of Coulomb's cone,
an octagon inside it.

Mortar that holds does not crack: its stress varies linearly over the patch and pulls nowhere more
than the tensile strength :math:`f`. That is a preload :math:`f A` at the middle and pushes at the
corners of the *kern* of the patch, as a push inside the kern leaves no tension anywhere:
:math:`|M| \le (N / A + f) S` about each axis of a rectangle. Along the patch it bears
:math:`c A + \mu N` (Mohr and Coulomb) with the shear strength :math:`c`. The cone about a push
of the kern, which bears the preload too, counts :math:`\mu (N + f A)` of it; so :math:`c - \mu f`
is left for the mortar, and of the tensile strength no more counts than :math:`c / \mu`, where that
line ends.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from learn2assemble.assembly.blocks import Assembly
from learn2assemble.assembly.bricks.lattice import Clutches, StudLattice, grip
from learn2assemble.assembly.contacts import GROUND, Contacts, across, find_contacts
from learn2assemble.assembly.joints import Joint
from learn2assemble.geometry.hulls import kern

_SIDES = 8
"""Of the pyramid inside Coulomb's cone."""
SIDE = 0.02
"""A patch is vertical when the vertical part of its normal is at most this."""
_LEVEL = 0.995
"""A patch of a clutch is level from this vertical part of its normal on."""


class Columns(NamedTuple):
    """Forces between bodies; n columns."""

    a: np.ndarray
    """int64[n]: the block that bears the opposite, or GROUND."""
    b: np.ndarray
    """int64[n]: the block the force is on."""
    force: np.ndarray
    """float64[n, 3]: of a unit."""
    at: np.ndarray
    """float64[n, 3]: where it acts [m]."""
    couple: np.ndarray
    """float64[n, 3]: couple of a unit [unit of force times m]."""
    lower: np.ndarray
    upper: np.ndarray
    """float64[n]: bounds of its size [N]."""
    corner: np.ndarray
    """int64[n]: the corner of ``Forces.contacts`` it acts at, or -1; of a preload, the first corner
    of its joint."""


class Forces(NamedTuple):
    """All forces of an assembly."""

    columns: Columns
    preload: Columns
    """Of strength: one column a joint, of which a unit is its whole preload [N]."""
    contacts: Contacts
    """The joints, to be shown."""
    upright: np.ndarray
    """bool[n]: of ``columns``, those that weight presses: at faces side by side only where mortar
    that holds fills the joint."""


def _columns(
    a: np.ndarray,
    b: np.ndarray,
    force: np.ndarray,
    at: np.ndarray,
    corner: np.ndarray,
    bounds: tuple[float, float] = (0.0, np.inf),
) -> Columns:
    n = len(b)
    return Columns(
        np.asarray(a, np.int64),
        np.asarray(b, np.int64),
        force,
        at,
        np.zeros((n, 3)),
        np.full(n, bounds[0]),
        np.full(n, bounds[1]),
        np.asarray(corner, np.int64),
    )


def joined(parts: list[Columns]) -> Columns:
    """Columns one after the other."""
    return Columns(*map(np.concatenate, zip(*parts, strict=True)))


def among(forces: Forces, blocks: np.ndarray) -> Forces:
    """The forces between some blocks of an assembly, and on the ground, renumbered.

    Args:
        blocks: int64[m], in ascending order.

    Returns:
        They, with the contacts of all.
    """
    bodies = [body for part in forces[:2] for body in (part.a, part.b)]
    number = np.full(max(int(one.max(initial=-1)) for one in (blocks, *bodies)) + 2, -2)
    number[blocks] = np.arange(len(blocks))
    number[GROUND] = GROUND  # The last entry.
    made, kept = list[Columns](), list[np.ndarray]()
    for part in forces[:2]:
        a, b = number[part.a], number[part.b]
        on = np.flatnonzero((a >= GROUND) & (b >= 0))
        kept.append(on)
        made.append(Columns(*(field[on] for field in part))._replace(a=a[on], b=b[on]))
    return Forces(made[0], made[1], forces.contacts, forces.upright[kept[0]])


def law_between(assembly: Assembly) -> Callable[[int, int], Joint]:
    """The law of the joint of two blocks, by their numbers; GROUND is the ground."""
    if not assembly.joints:
        return lambda a, b: assembly.joint
    blocks = assembly.blocks

    def law(a: int, b: int) -> Joint:
        found = assembly.joint
        real = [blocks[k] for k in (a, b) if k != GROUND]
        names = {block.id for block in real}
        for one in assembly.joints:
            if one.blocks is not None:
                found = one.joint if names == set(one.blocks) else found
            elif all(block.kind == one.kind for block in real):
                found = one.joint
        return found

    return law


def forces_of(assembly: Assembly, cured: np.ndarray | None = None) -> Forces:
    """What all joints of an assembly can bear.

    Args:
        assembly: the blocks where they stand; steps are not looked at. No mortar holds its props.
        cured: bool[B], the blocks between which, and under which, mortar holds; all by default.
            Elsewhere its joints are dry, unless it holds at once.

    Raises:
        InputError: for blocks under a law of clutch that are no bricks on one lattice, and for
            bricks that overlap.
    """
    support = any(block.support for block in assembly.blocks)
    joint = assembly.joint
    if joint.law == "clutch" and joint.holds and not assembly.joints:
        lattice = StudLattice(assembly.blocks, joint.pitch)
        clutches = lattice.clutches(ground=not support)
        grips = np.ones(len(clutches.upper), bool)
        if joint.base == "table":
            grips = clutches.lower != GROUND
        capacity = np.full(len(clutches.upper), joint.capacity)
        return _of_bricks(assembly, lattice, clutches, grips, capacity)
    return _of_patches(assembly, cured)


def _of_bricks(
    assembly: Assembly,
    lattice: StudLattice,
    clutches: Clutches,
    grips: np.ndarray,
    capacity: np.ndarray,
) -> Forces:
    parts, preload, points = list[Columns](), list[Columns](), list[np.ndarray]()
    held = Clutches(*(field[grips] for field in clutches))
    made = _clutch_columns(lattice, held, capacity[grips], points)
    parts += made[:2]
    preload.append(made[2])
    a, b = [held.lower], [held.upper]
    normal = [np.tile([0.0, 0, 1], (len(held.upper), 1))]
    sides = lattice.sides()
    table = Clutches(*(field[~grips] for field in clutches))
    for rows, axis, low, high, pair in (
        (
            len(table.upper),
            np.full(len(table.upper), 2),
            np.column_stack([table.first, table.layer]),
            np.column_stack([table.last, table.layer]),
            (table.lower, table.upper),
        ),
        (len(sides.a), sides.axis, sides.low, sides.high, (sides.a, sides.b)),
    ):
        if rows:
            corners = _rectangles(axis, low, high, lattice)
            unit = np.eye(3)[axis]
            first = sum(len(one) for one in points)
            corner = first + np.arange(4 * rows)
            points.append(corners.reshape(-1, 3))
            level = bool(axis[0] == 2)
            parts.append(_pushes(pair, unit, corners, corner, assembly.friction if level else 0.0))
            a.append(pair[0])
            b.append(pair[1])
            normal.append(unit)
    counts = [len(one) for one in points[: len(held.upper)]]
    counts += [4] * (len(table.upper) + len(sides.a))
    total = int(sum(counts))
    xyz = np.concatenate(points) if points else np.empty((0, 3))
    assert len(xyz) == total
    order = np.concatenate(a)
    contacts = Contacts(
        order,
        np.concatenate(b),
        np.concatenate(normal),
        np.zeros(len(order)),
        xyz,
        np.repeat(np.arange(len(counts)), counts),
        np.zeros(len(order)),
    )
    columns = joined(parts)
    return Forces(columns, joined(preload), contacts, _bearing(columns, contacts))


def _bearing(columns: Columns, contacts: Contacts, filled: Sequence[int] = ()) -> np.ndarray:
    """bool[n]: columns that are not at a patch that is vertical, or at one of those ``filled``."""
    side = np.abs(contacts.normal[:, 2]) <= SIDE
    side[list(filled)] = False
    at = columns.corner >= 0
    bearing = np.ones(len(at), bool)
    bearing[at] = ~side[contacts.patch[columns.corner[at]]]
    return bearing


def _clutch_columns(
    lattice: StudLattice, clutches: Clutches, capacity: np.ndarray, points: list[np.ndarray]
) -> tuple[Columns, Columns, Columns]:
    """Pushes, sideways forces and preloads of clutches; corners are added to ``points``."""
    count = len(clutches.upper)
    size = lattice.size[clutches.upper, :2]
    knobs = clutches.last - clutches.first
    where = np.column_stack([clutches.first - lattice.low[clutches.upper, :2], knobs, size])
    grips = [grip(x, y, u, v, (a, b)) for x, y, u, v, a, b in where.tolist()]
    stud, layer = lattice.pitch
    base = np.column_stack(
        [
            lattice.low[clutches.upper, :2] * stud + lattice.offset[:2],
            clutches.layer * layer,
        ]
    ).reshape(count, 3)
    first = sum(len(one) for one in points)
    sizes = np.array([len(g.corners) for g in grips], np.int64)
    owner = np.repeat(np.arange(count), sizes)
    corners = np.concatenate([g.corners for g in grips]) if grips else np.empty((0, 2))
    at = base[owner] + np.column_stack([corners * stud, np.zeros(len(corners))])
    ends = np.cumsum(sizes)
    points += [at[e - n : e] for e, n in zip(ends.tolist(), sizes.tolist(), strict=True)]
    up = np.tile([0.0, 0.0, 1.0], (len(at), 1))
    push = _columns(
        clutches.lower[owner], clutches.upper[owner], up, at, first + np.arange(len(at))
    )
    # Sideways at the middle of the knobs; a couple about it where there are two or more.
    middle = np.column_stack(
        [
            (clutches.first + clutches.last) / 2 * stud + lattice.offset[:2],
            clutches.layer * layer,
        ]
    ).reshape(count, 3)
    turning = np.flatnonzero(knobs.prod(1) > 1)
    joint = np.concatenate([np.arange(count), np.arange(count), turning])
    axis = np.repeat([0, 1, 2], [count, count, len(turning)])
    unit = np.eye(3)[axis]
    free = _columns(
        clutches.lower[joint],
        clutches.upper[joint],
        np.where(axis[:, None] < 2, unit, 0),
        middle[joint],
        np.full(len(joint), -1),
        (-np.inf, np.inf),
    )
    free = free._replace(couple=np.where(axis[:, None] == 2, stud * unit, 0.0))
    pull = np.array([g.pull for g in grips])
    spot = np.array([g.middle for g in grips]).reshape(count, 2)
    at = base + np.column_stack([spot * stud, np.zeros(count)])
    down = np.column_stack([np.zeros((count, 2)), -pull * capacity])
    pulls = _columns(clutches.lower, clutches.upper, down, at, first + ends - sizes)
    return push, free, pulls


def _rectangles(
    axis: np.ndarray, low: np.ndarray, high: np.ndarray, lattice: StudLattice
) -> np.ndarray:
    """float64[n, 4, 3]: corners of rectangles across an axis [m]; along it they are at ``low``."""
    count = len(axis)
    rows = np.arange(count)
    u, v = (axis + 1) % 3, (axis + 2) % 3
    corners = np.repeat(low[:, None].astype(float), 4, 1)
    for k, (i, j) in enumerate(((0, 0), (1, 0), (1, 1), (0, 1))):
        corners[rows, k, u] = np.where(i, high[rows, u], low[rows, u])
        corners[rows, k, v] = np.where(j, high[rows, v], low[rows, v])
    unit = np.array([lattice.pitch[0], lattice.pitch[0], lattice.pitch[1]])
    return corners * unit + lattice.offset


def _pushes(
    pair: tuple[np.ndarray, np.ndarray],
    normal: np.ndarray,
    corners: np.ndarray,
    corner: np.ndarray,
    friction: float,
) -> Columns:
    """Pushes at the corners of rectangles, with friction where there is some."""
    count = corners.shape[1]
    a, b = np.repeat(pair[0], count), np.repeat(pair[1], count)
    return _coned(a, b, np.repeat(normal, count, 0), corners.reshape(-1, 3), corner, friction)


def _coned(
    a: np.ndarray,
    b: np.ndarray,
    normal: np.ndarray,
    at: np.ndarray,
    corner: np.ndarray,
    friction: float,
) -> Columns:
    """Directions of Coulomb's cone about the normals."""
    if friction == 0:
        return _columns(a, b, normal, at, corner)
    angle = 2 * np.pi / _SIDES * np.arange(_SIDES)
    turn = friction * np.stack([np.cos(angle), np.sin(angle)], 1)
    force = normal[:, None] + np.einsum("ki,pij->pkj", turn, across(normal))
    many = np.repeat(np.arange(len(b)), _SIDES)
    return _columns(a[many], b[many], force.reshape(-1, 3), at[many], corner[many])


def _of_patches(assembly: Assembly, cured: np.ndarray | None) -> Forces:
    """Joints of several laws: the patches of contact, and studs where a joint clutches."""
    contacts = find_contacts(assembly)
    law = law_between(assembly)
    laws = [law(a, b) for a, b in zip(contacts.a.tolist(), contacts.b.tolist(), strict=True)]
    clutching = [joint.law == "clutch" and joint.holds for joint in laws]
    laid = np.array([not block.prop for block in assembly.blocks])
    cured = laid if cured is None else cured & laid
    parts: list[Columns] = []
    preload: list[Columns] = []
    filled: list[int] = []
    start: list[int] = contacts.start.tolist()
    studs = _studs_of(assembly, laws, clutching, contacts)
    for patch, joint in enumerate(laws):
        a, b, normal = int(contacts.a[patch]), int(contacts.b[patch]), contacts.normal[patch]
        corner = np.arange(start[patch], start[patch + 1])
        count = len(corner)
        pair = np.full(count, a), np.full(count, b)
        at, normals = contacts.points[corner], np.tile(normal, (count, 1))
        if clutching[patch] and (a != GROUND or joint.base == "grips"):
            if abs(normal[2]) < _LEVEL:
                parts.append(_coned(*pair, normals, at, corner, 0.0))
            elif (lower_upper := (a, b) if normal[2] > 0 else (b, a)) in studs:
                made = studs[lower_upper]
                parts += made[:2]
                preload.append(made[2])
            continue
        old = laid if joint.age == 0 else cured
        if joint.law == "mortar" and joint.holds and old[b] and (a == GROUND or old[a]):
            made = _mortar(contacts, patch, joint, assembly.friction)
            if made is not None:
                filled.append(patch)
                parts += made[:2]
                preload.append(made[2])
                continue
        parts.append(_coned(*pair, normals, at, corner, assembly.friction))
    empty = _columns(np.empty(0), np.empty(0), np.empty((0, 3)), np.empty((0, 3)), np.empty(0))
    columns = joined([empty, *parts])
    bearing = _bearing(columns, contacts, filled)
    return Forces(columns, joined([empty, *preload]), contacts, bearing)


def _mortar(
    contacts: Contacts, patch: int, joint: Joint, friction: float
) -> tuple[Columns, Columns, Columns] | None:
    """Pushes with friction at the corners of the kern of a patch of mortar, what it bears along
    itself beside that, and its preload; None for a patch without a width."""
    first, last = int(contacts.start[patch]), int(contacts.start[patch + 1])
    area, normal = float(contacts.area[patch]), contacts.normal[patch]
    frame = across(normal[None])[0]
    points = contacts.points[first:last]
    found = kern((points - points[0]) @ frame.T)
    if found is None:
        return None
    middle, spots = (points[0] + flat @ frame for flat in found)
    count = len(spots)
    a, b = (np.array([body[patch]]) for body in (contacts.a, contacts.b))
    # Shown at some corner of the patch each.
    corner = first + np.arange(count)
    tensile = min(joint.tensile, joint.shear / friction) if friction > 0 else joint.tensile
    normals = np.tile(normal, (count, 1))
    pushes = _coned(np.repeat(a, count), np.repeat(b, count), normals, spots, corner, friction)
    # Sizes along four lines add up to an octagon inside the circle, one of whose corners lies along
    # each direction of the frame.
    most = max(joint.shear - friction * tensile, 0.0) * area / count * np.sin(np.pi / 8)
    angle = np.pi / 8 + np.pi / 4 * np.arange(4)
    lines = np.stack([np.cos(angle), np.sin(angle)], 1) @ frame
    many = np.repeat(np.arange(count), 4)
    along = _columns(
        np.repeat(a, 4 * count),
        np.repeat(b, 4 * count),
        np.tile(lines, (count, 1)),
        spots[many],
        corner[many],
        (-most, most),
    )
    pull = -tensile * area * normal
    return pushes, along, _columns(a, b, pull[None], middle[None], np.array([-1]))


def _studs_of(
    assembly: Assembly, laws: list[Joint], clutching: list[bool], contacts: Contacts
) -> dict[tuple[int, int], tuple[Columns, Columns, Columns]]:
    """Columns of every pair of blocks, the lower one first, that clutches."""
    pairs: dict[tuple[int, int], Joint] = {
        (a, b) if up > 0 else (b, a): joint
        for a, b, up, joint, on in zip(
            contacts.a.tolist(),
            contacts.b.tolist(),
            contacts.normal[:, 2].tolist(),
            laws,
            clutching,
            strict=True,
        )
        if on and abs(up) >= _LEVEL
    }
    found: dict[tuple[int, int], tuple[Columns, Columns, Columns]] = {}
    for pitch in sorted({joint.pitch for joint in pairs.values()}):
        of = [pair for pair, joint in pairs.items() if joint.pitch == pitch]
        number = sorted({k for pair in of for k in pair if k != GROUND})
        lattice = StudLattice([assembly.blocks[k] for k in number], pitch)
        clutches = lattice.clutches(ground=any(a == GROUND for a, _ in of))
        index = np.array([*number, GROUND])
        low: list[int] = index[clutches.lower].tolist()
        up: list[int] = index[clutches.upper].tolist()
        for k, pair in enumerate(zip(low, up, strict=True)):
            if pair in pairs and pairs[pair].pitch == pitch:
                one = Clutches(*(field[k : k + 1] for field in clutches))
                capacity = np.array([pairs[pair].capacity])
                made = _clutch_columns(lattice, one, capacity, [])
                push, free, pull = (
                    part._replace(a=index[part.a], b=index[part.b], corner=np.full(len(part.b), -1))
                    for part in made
                )
                found[pair] = push, free, pull
    return found
