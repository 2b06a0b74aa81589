"""Blocks laid on a lattice, one after the other, compiled: what each placement changes.

What kernels take of a :class:`~.world.LatticeSite` and change of a :class:`~.world.LatticeWorld`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from learn2assemble.kernels import kernel
from learn2assemble.planning.tiling.stack import grow_stack
from learn2assemble.statics.local_proof import settle
from learn2assemble.statics.step_proof import StackArrays, load_at_rest


class SiteArrays(NamedTuple):
    """What kernels take of a :class:`LatticeSite` and its candidates, by the names there."""

    start: np.ndarray
    cell: np.ndarray
    way: np.ndarray
    origin: np.ndarray
    kind: np.ndarray
    over_start: np.ndarray
    over: np.ndarray
    on_start: np.ndarray
    on: np.ndarray
    weight: np.ndarray
    centre: np.ndarray


class WorldArrays(NamedTuple):
    """What changes of a :class:`LatticeWorld`, in place."""

    owner: np.ndarray
    alive: np.ndarray
    waits: np.ndarray
    cover: np.ndarray
    heap: np.ndarray


@kernel
def fill(cells: np.ndarray, number: int, site: SiteArrays, world: WorldArrays) -> None:
    """Fill ``cells`` with block ``number``: candidates there are gone, those above come nearer."""
    for c in cells:
        world.owner[c] = number
        for k in range(site.over_start[c], site.over_start[c + 1]):
            d = site.over[k]
            if world.alive[d]:
                world.alive[d] = False
                for j in range(site.start[d], site.start[d + 1]):
                    world.cover[site.cell[j]] -= 1
        for k in range(site.on_start[c], site.on_start[c + 1]):
            world.waits[site.on[k]] -= 1


@kernel
def run_out(gone: int, site: SiteArrays, world: WorldArrays) -> None:
    """No candidate of a kind can be put down any more."""
    for k in range(len(site.kind)):
        if world.alive[k] and site.kind[k] == gone:
            world.alive[k] = False
            for j in range(site.start[k], site.start[k + 1]):
                world.cover[site.cell[j]] -= 1


@kernel
def lay(
    candidates: np.ndarray,
    site: SiteArrays,
    world: WorldArrays,
    propped: np.ndarray,
    shape: tuple[int, int, int],
    pitch: tuple[float, float, float],
    inset: float,
    stack: StackArrays,
    force: np.ndarray,
    count: int,
) -> tuple[StackArrays, np.ndarray, np.ndarray]:
    """See :meth:`LatticeWorld.lay`: the stack, its forces, what was laid on ``count`` blocks."""
    laid, done, moving = np.empty(len(candidates), np.int64), 0, True
    gone = np.zeros(len(candidates), np.bool_)
    unit = min(pitch[0], pitch[1])
    while moving:
        moving = False
        for k in range(len(candidates)):
            c = candidates[k]
            if gone[k] or world.waits[c] != 0:
                continue
            cells = site.cell[site.start[c] : site.start[c + 1]]
            way = site.way[c]
            block = float(site.weight[way]), site.centre[way], site.origin[c]
            grown = grow_stack(cells, world.owner, propped, shape, pitch, inset, block, stack)
            load = load_at_rest(grown, unit)
            forces = np.zeros(len(load.upper))
            forces[: len(force)] = force
            placed, dirty = (
                np.ones(len(load.weight), np.bool_),
                np.zeros(len(load.weight), np.bool_),
            )
            dirty[-1] = True
            if not settle(load, forces, placed, dirty, False):
                continue
            stack, force = grown, forces
            fill(cells, count + done, site, world)
            kind = int(site.kind[c])
            if world.heap[kind] > 0:
                world.heap[kind] -= 1
                if world.heap[kind] == 0:
                    run_out(kind, site, world)
            laid[done] = c
            gone[k] = moving = True
            done += 1
    return stack, force, laid[:done]


@kernel
def pack(
    alive: np.ndarray, kind: np.ndarray, kinds: int, start: np.ndarray, cell: np.ndarray, cells: int
) -> np.ndarray:
    taken = np.full((kinds, cells), False)
    count = np.zeros(kinds, np.int64)
    for c in alive:
        k = kind[c]
        free = True
        for j in range(start[c], start[c + 1]):
            if taken[k, cell[j]]:
                free = False
                break
        if free:
            count[k] += 1
            for j in range(start[c], start[c + 1]):
                taken[k, cell[j]] = True
    return count
