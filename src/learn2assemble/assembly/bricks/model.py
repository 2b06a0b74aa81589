"""Bricks on a lattice of studs, as files of bricks tell of them, and the assembly they make."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from learn2assemble.assembly.blocks import MAX_BLOCKS, Assembly, AssemblyStep, Block
from learn2assemble.assembly.boxes import BoxFields, box_blocks
from learn2assemble.assembly.kit import Kind, Kit
from learn2assemble.errors import InputError

FARTHEST = 100_000
"""Largest coordinate [studs or layers]."""


class Brick(NamedTuple):
    """One brick."""

    low: tuple[int, int, int]
    """Its smallest corner [studs, studs, layers]."""
    size: tuple[int, int, int]
    """[studs, studs, layers]."""
    where: str
    """What messages call it."""
    colour: tuple[int, int, int] | None = None
    mass: float | None = None
    """[kg]; None: that of the kit."""


@dataclass(frozen=True)
class BrickModel:
    """What a file of bricks says.

    Attributes:
        bricks: in the order of the file.
        ordered: whether that is the order of building.
        name: of the model.
        offset: of the lattice in x and y [m].
    """

    bricks: tuple[Brick, ...]
    ordered: bool = False
    name: str = ""
    offset: tuple[float, float] = (0.0, 0.0)


def brick_layers(kit: Kit) -> int:
    """Layers of a brick of a kit: those of its highest kind."""
    return max(_extent(kind)[2] for kind in kit.kinds)


def assembly_of(model: BrickModel, kit: Kit, source: str) -> Assembly:
    """The assembly of a model whose lowest bricks stand on the ground z = 0.

    Blocks are called ``b1``, ``b2``, ... in the order of the file.

    Raises:
        InputError: for no bricks or too many, a size the kit has not, bricks that are far away or
            overlap.
    """
    bricks = model.bricks
    if not 0 < len(bricks) <= MAX_BLOCKS:
        raise InputError(f"{source}: bricks", len(bricks), f"1 to {MAX_BLOCKS} bricks")
    for brick in bricks:
        if max(map(abs, brick.low)) > FARTHEST:
            expected = f"coordinates up to {FARTHEST} studs or layers"
            raise InputError(brick.where, brick.low, expected)
    check_apart(bricks)
    kinds = dict[tuple[int, int, int], Kind]()
    for kind in kit.kinds:
        x, y, z = _extent(kind)
        kinds.setdefault((min(x, y), max(x, y), z), kind)
    ground = min(brick.low[2] for brick in bricks)
    low = np.array([brick.low for brick in bricks], float) - (0, 0, ground)
    lower = low * kit.pitch + (*model.offset, 0.0)
    sizes = np.array([brick.size for brick in bricks], float) * kit.pitch
    boxes = list[BoxFields]()
    for number, (brick, size) in enumerate(zip(bricks, sizes.tolist(), strict=True), 1):
        x, y, z = brick.size
        kind = kinds.get((min(x, y), max(x, y), z))
        if kind is None:
            raise InputError(brick.where, _words(brick.size, kit), _nearest(brick.size, kit))
        density = kit.density if kind.density is None else kind.density
        if brick.mass is not None:
            density = brick.mass / math.prod(size)
        boxes.append(BoxFields(f"b{number}", kind.name, density, brick.colour))
    blocks = box_blocks(boxes, lower, lower + sizes)
    steps = tuple(AssemblyStep(place=block.id) for block in blocks) if model.ordered else ()
    return Assembly(tuple(blocks), steps, kit.friction, model.name, joint=kit.joint)


def bricks_of(assembly: Assembly, source: str = "assembly") -> list[tuple[Block, np.ndarray]]:
    """The blocks that stand in the end, in the order of building where there is one, each with its
    box float64[2, 3] [m].

    Raises:
        InputError: for a block that is no upright box.
    """
    standing = {block.id: block for block in assembly.finished.blocks}
    order = [step.place for step in assembly.steps if step.place in standing]
    names = dict.fromkeys([*(n for n in standing if n not in set(order)), *map(str, order)])
    found = list[tuple[Block, np.ndarray]]()
    for name in names:
        block = standing[name]
        box = np.stack([block.vertices.min(0), block.vertices.max(0)])
        near = np.minimum(block.vertices - box[0], box[1] - block.vertices)
        size = box[1] - box[0]
        if near.max() > 1e-6 * size.max() or abs(size.prod() / block.volume - 1) > 1e-6:
            raise InputError(f"{source}: block {name!r}", "another shape", "an upright brick")
        found.append((block, box))
    return found


def check_apart(bricks: Sequence[Brick]) -> None:
    """Refuse bricks that share a cell.

    Raises:
        InputError: naming two that do.
    """
    low, size = np.array([brick[:2] for brick in bricks]).reshape(-1, 2, 3).swapaxes(0, 1)
    count = size.prod(1)
    owner = np.repeat(np.arange(len(bricks)), count)
    inside = np.arange(len(owner)) - (np.cumsum(count) - count)[owner]
    rest, z = np.divmod(inside, size[owner, 2])
    x, y = np.divmod(rest, size[owner, 1])
    cells = low[owner] + np.stack([x, y, z], 1)
    cells -= cells.min(0, initial=0)
    span = cells.max(0, initial=0) + 1
    code = (cells[:, 0] * span[1] + cells[:, 1]) * span[2] + cells[:, 2]
    order = np.argsort(code, kind="stable")
    twice = np.flatnonzero(np.diff(code[order]) == 0)
    if len(twice):
        first = twice[np.argmin(order[twice + 1])]
        pair: list[int] = owner[order[first : first + 2]].tolist()
        one, other = pair
        raise InputError(
            bricks[other].where, f"a brick in {bricks[one].where}", "bricks that do not overlap"
        )


@lru_cache(maxsize=1024)
def _extent(kind: Kind) -> tuple[int, int, int]:
    x, y, z = (max(along) + 1 for along in zip(*kind.cells, strict=True))
    return x, y, z


def _words(size: tuple[int, int, int], kit: Kit) -> str:
    x, y, z = size
    layers = brick_layers(kit)
    kind = "" if z == layers else "plate " if z == 1 else f"{z} layers of "
    return f"{kind}{min(x, y)}x{max(x, y)}"


def _nearest(size: tuple[int, int, int], kit: Kit) -> str:
    """The kind of a kit that is most like a size, for a message."""
    wanted = np.array([*sorted(size[:2]), size[2]])

    def far(kind: Kind) -> float:
        x, y, z = _extent(kind)
        return float(np.abs(wanted - [min(x, y), max(x, y), z]).sum())

    near = min(kit.kinds, key=far)
    return f"a size of kit {kit.name}, nearest {near.name}"
