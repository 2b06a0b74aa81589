"""Blocks, what actions mean, and the sets of objects that problems draw from.

An action ``k`` is relation ``k div R`` to a placed block in way ``k mod R``. Without a robot the
way is a number of quarter turns of the object about the vertical axis through the chosen block:
5 actions for R = 1, 20 for R = 4. With a robot it is a pair of gripper orientations.

An object is a list of lattice cells, counted from its origin; its cells are nodes in that order.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import NamedTuple, TypeVar

import numpy as np

from learn2assemble.constants import EDGE
from learn2assemble.errors import InputError, check_instance, check_name, is_whole
from learn2assemble.kernels import kernel
from learn2assemble.registry import PLAIN_NAME, Registry, is_plain_name

GRAVITY = 10.0
"""Gravity of the published simulation [m/s^2]; elsewhere it is that of ``constants``."""


RELATIONS = ("top", "left", "right", "front", "behind")
"""Names of the five relative placements, in the order of the action index."""

DIRECTIONS = np.array([[0, 0, 1], [-1, 0, 0], [1, 0, 0], [0, -1, 0], [0, 1, 0]], np.float64)
"""float64[5, 3]: unit direction of each relation in the reference block's frame."""

ROTATIONS = (1, 4)
"""Numbers of ways a task may offer in each relation."""

ACTION_MODES = {
    "turns": (((0, 0), (0, 1), (0, 2), (0, 3)), False),
    "grips": (((0, 0), (0, 3), (3, 0), (3, 3)), True),
}
"""What the ways are: the quarter turns of the hand over the place where it picks and over the one
where it places, and whether it is a gripper. ``turns`` turn the object in a hand that nothing is in
the way of; any number of them may fill the same cells. ``grips`` are the (grasp, place) yaws AA,
AB, BA, BB: two of them fill the same cells and are different actions all the same, as the fingers
stand elsewhere."""


class ActionSpec(NamedTuple):
    """What the actions of a task mean beside the relation, see :attr:`Task.action_spec`."""

    pitch: float
    """Horizontal distance of the centres of neighbouring cells [m]."""
    turns: np.ndarray
    """int64[R]: quarter turns the object makes in each way."""
    grips: np.ndarray
    """int64[R]: ways with different numbers are different even where the cells are the same."""
    hands: np.ndarray
    """int64[R, 2]: quarter turns of the hand where it picks and where it places; the object turns
    by their difference."""
    level: bool
    """The object's lowest cell comes to the level of the reference, not the chosen cell."""

    @property
    def num_grips(self) -> int:
        return int(self.grips.max()) + 1


@lru_cache
def get_action_spec(
    action_mode: str = "turns", rotations: int = 1, pitch: float = EDGE
) -> ActionSpec:
    """What the actions of a task mean.

    Args:
        action_mode: a name of :data:`ACTION_MODES`.
        rotations: R, how many there are in each relation.
        pitch: horizontal distance of the centres of neighbouring cells [m].

    Raises:
        UnknownNameError: for another action mode.
        InputError: for another number of ways.
    """
    check_name("action_mode", action_mode, ACTION_MODES)
    pairs, gripped = ACTION_MODES[action_mode]
    if rotations not in ROTATIONS:
        raise InputError("rotations", rotations, "1 or 4")
    grips = np.arange(rotations) if gripped else np.zeros(rotations, np.int64)
    hands = np.array(pairs[:rotations])
    return ActionSpec(float(pitch), (hands[:, 1] - hands[:, 0]) % 4, grips, hands, gripped)


_Number = TypeVar("_Number", int, float)


@kernel(inline="always")
def quarter_turn(x: _Number, y: _Number, turns: int) -> tuple[_Number, _Number]:
    """``(x, y)`` after ``turns`` (0..3) quarter turns to the left, seen from above; exact."""
    if turns == 1:
        return -y, x
    if turns == 2:
        return -x, -y
    if turns == 3:
        return y, -x
    return x, y


class Shape(NamedTuple):
    """An object before it is drawn."""

    cells: tuple[tuple[int, int, int], ...]
    """(x, y, z) of each cell [cells], in node order."""
    turned: bool = False
    """Drawn with a random number of quarter turns about z."""
    shuffled: bool = False
    """Drawn with its cells in random node order."""


SHAPES: dict[str, Shape] = {
    "cube": Shape(((0, 0, 0),)),
    "bar": Shape(((0, 0, 0), (1, 0, 0)), shuffled=True),
    "horizontal-2": Shape(((0, 0, 0), (1, 0, 0)), turned=True, shuffled=True),
    "horizontal-3": Shape(((0, 0, 0), (1, 0, 0), (2, 0, 0)), turned=True, shuffled=True),
    "vertical-2": Shape(((0, 0, 0), (0, 0, 1))),
    "vertical-3": Shape(((0, 0, 0), (0, 0, 1), (0, 0, 2))),
    "l-up": Shape(((1, 0, 0), (0, 0, 0), (0, 0, 1)), turned=True),
    "l-ground": Shape(((1, 0, 0), (0, 0, 0), (0, 1, 0)), turned=True),
    "w-up": Shape(((-1, 0, 0), (0, 0, 0), (1, 0, 0), (0, 0, 1)), turned=True),
    "w-ground": Shape(((-1, 0, 0), (0, 0, 0), (1, 0, 0), (0, 1, 0)), turned=True),
    "s": Shape(((1, 0, 0), (0, 0, 0), (0, 0, 1), (-1, 0, 1)), turned=True),
}
"""``bar`` always lies along x. ``s`` stands, and the end of its upper half overhangs."""

_CUBE, _UP, _L = ("cube",), ("vertical-2",), ("l-up", "l-ground")
_SET_26 = (_CUBE, _UP, ("cube", "vertical-2"), ("cube", "vertical-2"), ("l-up",), ("s",))
Groups = tuple[tuple[str, ...], ...]
OBJECT_SETS: Registry[Groups] = Registry(
    "object set",
    {
        "cubes": (_CUBE,),
        "bars": (_CUBE, ("bar",), _UP),
        "set-20": (
            _CUBE,
            ("horizontal-3", "horizontal-2"),
            ("vertical-3", "vertical-2"),
            (*_L, "w-up", "w-ground"),
        ),
        "set-21": (_CUBE, ("horizontal-2", "vertical-2"), _L),
        "set-23": (_CUBE, ("horizontal-2", "vertical-2"), _L, ("s",)),
        "set-25": (_CUBE, _UP, ("cube", "vertical-2"), ("l-up",)),
        "set-26": _SET_26,
        "paper-four": _SET_26,
    },
)
"""Per set its groups: an object is drawn from a group, the group uniformly from the set. The
numbers are those of the published code, whose sets 22 and 24 the protocol does not describe.
``bars`` is drawn by counts instead, so its groups only list the shapes. ``paper-four`` is set 26,
the four shapes the paper shows."""
MAX_CELLS = 4
"""Most cells of an object."""


def register_object_set(
    name: str, groups: Sequence[Sequence[str]], shapes: Mapping[str, Shape] | None = None
) -> None:
    """Make a set of objects known as ``objects`` of a task.

    Args:
        groups: names of the shapes of each group; an object is drawn from a group, the group
            uniformly from the set. The first shape of the first group is ``cube``.
        shapes: shapes of the caller's by name, beside those of :data:`SHAPES`.

    Raises:
        InputError: for a name that is taken, a shape that is unknown or has more than
            ``MAX_CELLS`` cells, or cells that are not one piece.
    """
    check_instance("shapes", shapes, (Mapping, type(None)), "shapes by name")
    own = dict(shapes or {})
    for key, shape in own.items():
        # Users may give other keys.
        word = isinstance(key, str)  # pyright: ignore[reportUnnecessaryIsInstance]
        if not word or not is_plain_name(key):
            raise InputError("shape name", key, PLAIN_NAME)
        check_instance(f"shape {key}", shape, Shape, "a Shape")
        cells = _cells_of(key, shape)
        if key in SHAPES and SHAPES[key] != shape:
            raise InputError("shape name", key, "a name that is not taken")
        if not 1 <= len(cells) <= MAX_CELLS or len(set(cells)) < len(cells):
            raise InputError(f"cells of {key}", cells, f"1 to {MAX_CELLS} different cells")
        if min(z for _, _, z in cells) != 0:
            raise InputError(f"cells of {key}", cells, "a lowest cell at height 0")
        reached = {cells[0]}
        for _ in cells:
            reached |= {c for c in cells if any(_adjacent(c, other) for other in reached)}
        if len(reached) < len(cells):
            raise InputError(f"cells of {key}", cells, "cells that hang together")
    known = SHAPES | own
    words = "groups of shapes, such as [['cube'], ['bar']]"
    check_instance(f"groups of {name}", groups, (list, tuple), words)
    for group in groups:
        check_instance(f"group of {name}", group, (list, tuple), words)
        for shape in group:
            check_name("shape", shape, known)
    if not groups or not all(groups) or groups[0][0] != "cube":
        raise InputError(f"groups of {name}", groups, "groups of shapes, the cube first")
    OBJECT_SETS.register(name, tuple(tuple(group) for group in groups))
    SHAPES.update(own)


def _cells_of(key: str, shape: Shape) -> list[tuple[int, int, int]]:
    """The cells of a shape of a caller's."""
    expected = f"1 to {MAX_CELLS} cells (x, y, z) of whole numbers"
    try:
        cells = [(x, y, z) for x, y, z in shape.cells]
    except (TypeError, ValueError):
        raise InputError(f"cells of {key}", shape.cells, expected) from None
    if not all(is_whole(k, -MAX_CELLS, MAX_CELLS) for cell in cells for k in cell):
        raise InputError(f"cells of {key}", shape.cells, expected)
    return cells


def _adjacent(a: tuple[int, ...], b: tuple[int, ...]) -> bool:
    return sum(abs(p - q) for p, q in zip(a, b, strict=True)) == 1


CUBES, BARS, GROUPS = 0, 1, 2


class Inventory(NamedTuple):
    """An object set as arrays: T shapes of at most C cells, G groups of at most K shapes."""

    kind: int
    """How objects are drawn: CUBES, BARS or GROUPS."""
    cells: np.ndarray
    """int64[T, C, 3]; shape 0 is the cube."""
    sizes: np.ndarray
    """int64[T]: cells of each shape."""
    turned: np.ndarray
    """bool[T]."""
    shuffled: np.ndarray
    """bool[T]."""
    groups: np.ndarray
    """int64[G, K]: shapes of each group, then -1."""
    group_sizes: np.ndarray
    """int64[G]."""


@lru_cache
def inventory(name: str) -> Inventory:
    """The object set called ``name``.

    Raises:
        UnknownNameError: naming the nearest set.
    """
    groups = OBJECT_SETS[name]
    names = list(dict.fromkeys(shape for group in groups for shape in group))
    shapes = [SHAPES[shape] for shape in names]
    sizes = np.array([len(shape.cells) for shape in shapes])
    group_sizes = np.array([len(group) for group in groups])
    cells = np.zeros((len(shapes), sizes.max(), 3), np.int64)
    members = np.full((len(groups), group_sizes.max()), -1, np.int64)
    for row, shape in zip(cells, shapes, strict=True):
        row[: len(shape.cells)] = shape.cells
    for row, group in zip(members, groups, strict=True):
        row[: len(group)] = [names.index(shape) for shape in group]
    turned, shuffled = np.array([(shape.turned, shape.shuffled) for shape in shapes]).T.copy()
    kind = {"cubes": CUBES, "bars": BARS}.get(name, GROUPS)
    return Inventory(kind, cells, sizes, turned, shuffled, members, group_sizes)


@kernel
def _below(rng: np.random.Generator, limit: int) -> int:
    return int(rng.random() * limit)


@kernel
def _choose_shapes(
    rng: np.random.Generator, stock: Inventory, count: int, chosen: np.ndarray
) -> int:
    """Shapes of a list of objects with ``count`` cells together; returns their number."""
    total = first = 0
    if stock.kind == BARS:
        half = count // 2 // 2
        bars, pairs = _below(rng, half + 1), _below(rng, half + 1)
        while count > 0:
            # Shapes 1 and 2 have two cells, cubes fill up what remains.
            shape = 1 if total < bars else (2 if total < bars + pairs else 0)
            chosen[total] = shape
            count -= stock.sizes[shape]
            total += 1
    else:
        chosen[0], total, first = 0, 1, 1
        remaining = count - 1
        while remaining > 0:
            shape = 0
            if remaining > 1:
                group = _below(rng, len(stock.groups))
                shape = stock.groups[group, _below(rng, stock.group_sizes[group])]
            if stock.sizes[shape] <= remaining:
                chosen[total] = shape
                remaining -= stock.sizes[shape]
                total += 1
    for k in range(total - 1, first, -1):
        other = first + _below(rng, k - first + 1)
        chosen[k], chosen[other] = chosen[other], chosen[k]
    return total


@kernel
def draw_objects(
    rng: np.random.Generator,
    stock: Inventory,
    count: int,
    position: np.ndarray,
    object_id: np.ndarray,
    pitch: float = EDGE,
) -> None:
    """Draw objects with ``count`` cells together, one after the other.

    Args:
        stock: the :class:`Inventory`.
        position: float64[M, 3], written: each cell relative to its object's origin [m].
        object_id: int64[M], written: number of the object in the list. What lies beyond
            ``count`` gets numbers that no object has.
        pitch: horizontal distance of the centres of neighbouring cells [m].
    """
    object_id[:] = np.arange(len(object_id))
    position[:] = 0.0
    if stock.kind == CUBES:
        return
    chosen = np.empty(count, np.int64)
    k = 0
    for number in range(_choose_shapes(rng, stock, count, chosen)):
        shape = chosen[number]
        size = stock.sizes[shape]
        turns = _below(rng, 4) if stock.turned[shape] else 0
        for c in range(size):
            x, y = quarter_turn(stock.cells[shape, c, 0], stock.cells[shape, c, 1], turns)
            position[k + c, 0], position[k + c, 1] = pitch * x, pitch * y
            position[k + c, 2] = EDGE * stock.cells[shape, c, 2]
            object_id[k + c] = number
        if stock.shuffled[shape]:
            for c in range(size - 1, 0, -1):
                other = _below(rng, c + 1)
                kept = position[k + c].copy()
                position[k + c] = position[k + other]
                position[k + other] = kept
        k += size
