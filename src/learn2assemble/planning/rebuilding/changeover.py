"""One structure to be turned into another: which blocks stay, go and come, and in which order they
can.

All blocks of both are one list; those of the same kind at the same pose are one block. No block is
drawn out from under another, and none is pushed in under one: what lies on a block goes before it
and comes after it. Two blocks that overlap are never there together.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from learn2assemble.assembly.blocks import Assembly, Block
from learn2assemble.assembly.contacts import contact_tolerance, near_pairs
from learn2assemble.errors import InputError
from learn2assemble.planning.clearance import overlap, parts_of


@dataclass(frozen=True, eq=False)
class Changeover:
    """What has to happen to B blocks, those of the old structure first.

    Attributes:
        blocks: with distinct ids.
        old: bool[B], which stand at first.
        new: bool[B], which stand at last; of the old ones, those that may stay.
        kind: int64[B]: blocks of one number may stand for one another.
        overlaps: of each block, those it cannot stand beside.
        above: of each block, those that lie on it.
    """

    blocks: tuple[Block, ...]
    old: np.ndarray
    new: np.ndarray
    kind: np.ndarray
    overlaps: Sequence[frozenset[int]]
    above: Sequence[frozenset[int]]

    @property
    def going(self) -> frozenset[int]:
        """Blocks that have to be taken away: those of the old structure that the new one has not,
        and, as no block is drawn out from under another, those that lie on what goes, or that
        something comes under.
        """
        first = set(np.flatnonzero(self.old & ~self.new).tolist())
        first |= {b for n in np.flatnonzero(self.new & ~self.old).tolist() for b in self.above[n]}
        return self.with_those_on(first)

    def with_those_on(self, blocks: Iterable[int]) -> frozenset[int]:
        """Those of some blocks that are of the old structure, and what lies on them there."""
        queue, found = list(blocks), set[int]()
        while queue:
            block = queue.pop()
            if self.old[block] and block not in found:
                found.add(block)
                queue += self.above[block]
        return frozenset(found)

    def coming(self, going: Iterable[int]) -> frozenset[int]:
        """Blocks that have to be placed, where these are taken away."""
        fresh = np.flatnonzero(self.new & ~self.old).tolist()
        return frozenset(fresh) | {b for b in going if self.new[b]}

    def first_gone(self, coming: Iterable[int], going: frozenset[int]) -> dict[int, set[int]]:
        """Of each block that comes, those that have to be gone before."""
        return {
            n: {
                o
                for o in going
                if o == n or o in self.overlaps[n] or o in self.above[n] or n in self.above[o]
            }
            for n in coming
        }


def merged(old: Assembly, new: Assembly) -> tuple[tuple[Block, ...], np.ndarray, np.ndarray]:
    """The blocks of both structures, those at the same pose once; which are old, and which new.

    Raises:
        InputError: for blocks of the same kind that differ in size.
    """
    _check_kinds(old.blocks, new.blocks)
    width = contact_tolerance(new.blocks)
    at = np.array([block.centroid for block in old.blocks])
    same: dict[int, int] = {}
    for n, block in enumerate(new.blocks):
        near: list[int] = np.flatnonzero(np.abs(at - block.centroid).max(1) <= width[n]).tolist()
        for o in near:
            if o not in same and _same(old.blocks[o], block, float(width[n])):
                same[o] = n
                break
    taken, fresh = {block.id for block in old.blocks}, list[Block]()
    for n in sorted(set(range(len(new.blocks))) - set(same.values())):
        name = new.blocks[n].id
        while name in taken:
            name += "'"
        taken.add(name)
        fresh.append(replace(new.blocks[n], id=name))
    count, total = len(old.blocks), len(old.blocks) + len(fresh)
    goes = np.arange(total) < count
    stays = np.array([k >= count or k in same for k in range(total)])
    return (*old.blocks, *fresh), goes, stays


def kinds_of(blocks: Sequence[Block]) -> np.ndarray:
    """int64[B]: numbers of kinds: blocks of one kind, colour, density and shape have one number.

    The shape is told by the distances of the vertices from the centre of mass and from each other,
    so a block that has no kind and its mirror image count as one.
    """
    numbers: dict[object, int] = {}
    return np.array([numbers.setdefault(_kind(block), len(numbers)) for block in blocks])


def overlapping(blocks: Sequence[Block]) -> list[frozenset[int]]:
    """Of each block, those that share a volume with it."""
    depth = 2 * float(contact_tolerance(blocks).max())
    lower = np.array([block.vertices.min(0) for block in blocks])
    upper = np.array([block.vertices.max(0) for block in blocks])
    parts = [parts_of(block) for block in blocks]
    found: list[set[int]] = [set[int]() for _ in blocks]
    pairs: list[list[int]] = near_pairs(lower, upper, 0.0).tolist()
    for a, b in pairs:
        if overlap(parts[a], parts[b], depth):
            found[a].add(b)
            found[b].add(a)
    return [frozenset(some) for some in found]


def lying_on(below: Sequence[Iterable[int]]) -> list[frozenset[int]]:
    """Of each block, those that lie on it; blocks that lie on one another in a ring do not count.

    Args:
        below: of each block, those it lies on.
    """
    import scipy.sparse as sparse

    pairs = [(upper, lower) for upper, some in enumerate(below) for lower in some]
    above: list[set[int]] = [set() for _ in below]
    if pairs:
        rows, columns = np.array(pairs).T
        graph = sparse.csr_array((np.ones(len(pairs)), (rows, columns)), (len(below), len(below)))
        ring = sparse.csgraph.connected_components(graph, connection="strong")[1]
        for upper, lower in pairs:
            if ring[upper] != ring[lower]:
                above[lower].add(upper)
    return [frozenset(some) for some in above]


def _same(one: Block, two: Block, width: float) -> bool:
    """Whether blocks are of one kind and colour and at one pose, to ``width`` [m]."""
    if (one.kind, one.colour, one.support) != (two.kind, two.colour, two.support):
        return False
    apart = np.linalg.norm(one.vertices[:, None] - two.vertices[None], axis=2)
    return bool(apart.min(0).max() <= width and apart.min(1).max() <= width)


def _kind(block: Block) -> object:
    return block.kind, block.colour, block.support, f"{block.density:.4g}", _shape(block)


def _shape(block: Block) -> tuple[float, ...]:
    """What the shape of a block is told by, to a thousandth of its size."""
    points = block.vertices - block.centroid
    size = float(np.linalg.norm(points, axis=1).max())
    apart = np.linalg.norm(points[:, None] - points[None], axis=2)
    spread = np.sort(np.concatenate([np.linalg.norm(points, axis=1), apart.sum(1)]))
    unit = 10.0 ** (np.floor(np.log10(size)) - 3)
    return tuple((spread / unit).round().tolist())


def _check_kinds(old: Sequence[Block], new: Sequence[Block]) -> None:
    """Refuse structures of one kit in two sizes."""

    def named(blocks: Sequence[Block]) -> dict[str, Block]:
        return {block.kind: block for block in blocks if block.kind and not block.support}

    before, after = named(old), named(new)
    for kind in sorted(before.keys() & after.keys()):
        if not np.isclose(before[kind].volume, after[kind].volume, rtol=1e-2):
            got = f"{kind} of {before[kind].volume:.3g} m3"
            raise InputError(
                "old",
                got,
                f"blocks as large as those to build, {kind} of "
                f"{after[kind].volume:.3g} m3 (the same kit and cell)",
            )
