"""Best-first search over structures that stand, guided by relaxed plans.

A node is a structure that stands; its children are one block larger. A node waits for its next
child with the priority

    blocks + weight * (blocks that are missing) + surprises on the way, the child's included ,

where what is missing is the relaxed plan, and ballast. A child of the relaxed plan surprises by
nothing, and any other by its detour and more.

A block of the relaxed plan that would fall, or a load, asks for *ballast*: the least weights on top
of the structure that would hold it, a linear program, say where; blocks there surprise little.

A search is many runs from the start, each longer than the one before and all but the first with
noise. The first structure is looked for greedily; then only structures with fewer blocks count. In
the end, blocks that nothing needs are left out, and where props are allowed, those that only
building needs are taken away again.
"""

from __future__ import annotations

import heapq
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import count

import numpy as np
from numpy.typing import NDArray

from learn2assemble.linear_programs import INF, Clock, Model, solve
from learn2assemble.planning.goals.loads import bears, failing_load, loaded
from learn2assemble.planning.goals.world import (
    GoalProblem,
    Relaxed,
    legal,
    put,
    relax,
    unmet,
)
from learn2assemble.planning.tiling.cover.candidates import BlockPlacement
from learn2assemble.planning.tiling.cover.tile import owners
from learn2assemble.planning.tiling.stack import find_stack
from learn2assemble.planning.tiling.world import LatticeWorld, grow
from learn2assemble.progress import Progress, silent
from learn2assemble.statics.step_proof import Proof, Stack

WEIGHTS = 3.0, 1.0
"""Of what is missing: while the first structure is looked for, then both in turn."""
FIRST_RUN, GROWTH, NOISE = 60.0, 1.3, 0.5
"""Nodes of the first run, by how much the next are longer, and what is added to surprises from the
second on, exponentially distributed [blocks]: estimates that are wrong in one way are left."""
UNLIKELY, FAR = 0.7, 4.0
"""Surprise of a child that is not in the relaxed plan, besides its detour; and the largest detour
[blocks]."""
SURE = 0.4
"""Share of a relaxed plan that is needed in any case."""
PATIENCE = 1.0, 3.0
"""Seconds, and times the seconds until the last structure, in which one with fewer blocks has to be
found for the search to go on."""
BALLAST = 0.5
"""Surprise of a block that lies best where ballast is asked for [blocks]."""
MAX_SEEN = 100_000


@dataclass(frozen=True, eq=False)
class Found:
    """What a search came to."""

    placements: tuple[BlockPlacement, ...]
    """In the order of building, temporary ones (``prop``) among them; empty: nothing was found."""
    expanded: int
    """Structures whose children were looked at."""
    seconds: float
    exhausted: bool = False
    """Whether nothing was left to try."""

    @property
    def blocks(self) -> int:
        """Blocks of the finished structure."""
        return sum(not block.prop for block in self.placements)


@dataclass(eq=False)
class Node:
    """A structure that stands, and its children in the order in which they are tried."""

    world: LatticeWorld
    relaxed: Relaxed
    missing: float
    children: np.ndarray
    surprise: np.ndarray
    """Of every child, with those on the way to it."""


class Search:
    """A search over the structures for some goals."""

    def __init__(self, problem: GoalProblem, seed: int = 0) -> None:
        self.problem = problem
        rng = np.random.default_rng(seed)
        self.rng: np.random.Generator = rng
        self.noise: float = 0.0
        self.hash: NDArray[np.int64] = rng.integers(0, 2**63, len(problem.site), dtype=np.int64)
        self.expanded: int = 0
        self.best: LatticeWorld | None = None
        self.fewest: float = INF
        self.heaviest: float = float(problem.site.weight.max())

    def expand(self, world: LatticeWorld, relaxed: Relaxed, spent: float) -> Node:
        """The node of a structure.

        Args:
            spent: surprises on the way to it.
        """
        self.expanded += 1
        children = legal(self.problem, world)
        helps, weight = self.advice(world, relaxed, children)
        missing = max(relaxed.blocks + np.ceil(round(weight / self.heaviest, 6)), 1.0)
        detour = np.clip(relaxed.detour[children], 0.0, FAR)
        surprise = np.where(relaxed.used[children], 0.0, UNLIKELY + detour)
        surprise = np.where(helps > 0, np.minimum(surprise, BALLAST + 1 - helps), surprise)
        if self.noise:
            surprise = surprise + self.noise * self.rng.exponential(size=len(surprise))
        order = np.argsort(surprise, kind="stable")
        return Node(world, relaxed, missing, children[order], spent + surprise[order])

    def advice(
        self, world: LatticeWorld, relaxed: Relaxed, children: np.ndarray
    ) -> tuple[np.ndarray, float]:
        """How well children lie where ballast is asked for (float64[m], 0 to 1), and how much is
        [kg]."""
        heavy = self.overloaded(world)
        liked = children[relaxed.used[children]]
        if heavy is None and any(world.stands(int(k)) for k in liked):
            return np.zeros(len(children)), 0.0
        share, weight = self.ballast(world, heavy, liked)
        return share[children], weight

    def hopeless(self, world: LatticeWorld, relaxed: Relaxed) -> bool:
        """Whether fewer blocks than before are out of sight: a relaxed plan may ask for too many,
        but hardly for twice as many as are needed."""
        return len(world.placed) + max(np.ceil(relaxed.blocks * SURE), 1) >= self.fewest

    def overloaded(self, world: LatticeWorld) -> Stack | None:
        """What stands with all loads that have a place by now, where that falls."""
        owner = world.owner.reshape(self.problem.goals.shape)
        loads = tuple(load for load in self.problem.goals.loads if owner[load.cell] >= 0)
        if not loads:
            return None
        stack = loaded(
            world.proof.stack, owner, loads, self.problem.goals.shape, self.problem.goals.kit.pitch
        )
        proof, everything = Proof(stack), np.ones(len(stack), bool)
        proof.force = world.proof.force.copy()
        return None if proof.settle(everything, everything) else stack

    def ballast(
        self, world: LatticeWorld, heavy: Stack | None, liked: np.ndarray
    ) -> tuple[np.ndarray, float]:
        """How well every candidate lies where weight is asked for (float64[n], 0 to 1), and how
        much is [kg].

        Args:
            heavy: what stands, with the loads under which it falls.
            liked: candidates that fall, asked for where there is no such load.
        """
        problem = self.problem
        share, least = np.zeros(len(problem.site)), INF
        cases = [] if heavy is None else [(heavy, world.owner)]
        for k in liked[:2] if len(world.placed) and heavy is None else ():
            owner = world.owner.copy()
            owner[problem.site.cells(int(k))] = len(world.placed)
            cases.append((grow(world, int(k)), owner))
        for stack, owner in cases:
            cells, weight = _least_ballast(problem, stack, owner)
            for cell, much in zip(cells, weight / max(weight.sum(), 1e-9), strict=True):
                on = problem.site.on[problem.site.on_start[cell] : problem.site.on_start[cell + 1]]
                share[on] = np.maximum(share[on], 0.2 + 0.8 * much)
            least = min(least, float(weight.sum()) if len(cells) else INF)
        return share, least if np.isfinite(least) else 0.0

    def run(self, weight: float, clock: Clock, limit: float = INF, noise: float = 0.0) -> bool:
        """Search until a structure with fewer blocks is found; whether there is nothing left.

        Args:
            weight: of what is missing.
            limit: of nodes.
            noise: scale of what is added to surprises.
        """
        ties, seen = count(), set[int]()
        limit, self.noise = self.expanded + limit, noise
        queue: list[tuple[float, int, int, Node]] = []

        def push(node: Node, index: int) -> None:
            if index < len(node.children):
                value = len(node.world.placed) + weight * node.missing + node.surprise[index]
                heapq.heappush(queue, (float(value), -next(ties), index, node))

        world = LatticeWorld(self.problem.site)
        push(self.expand(world, relax(self.problem, world), 0.0), 0)
        while queue:
            best = "none that meets all" if self.best is None else f"{self.fewest:g} blocks"
            clock.tell(f"searching for a structure: {self.expanded} looked at, best so far: {best}")
            if clock.left <= 0 or self.expanded > limit or len(seen) > MAX_SEEN:
                return False
            _, _, index, node = heapq.heappop(queue)
            if self.hopeless(node.world, node.relaxed):
                continue
            push(node, index + 1)
            candidate = int(node.children[index])
            key = int(np.bitwise_xor.reduce(self.hash[[*node.world.placed, candidate]]))
            if key in seen:
                continue
            seen.add(key)
            world = put(node.world, candidate)
            if world is None:
                continue
            relaxed = relax(self.problem, world, node.relaxed.price)
            if relaxed.blocks == 0 and bears(self.problem, world):
                self.best, self.fewest = world, len(world.placed)
                return False
            if not self.hopeless(world, relaxed):
                push(self.expand(world, relaxed, float(node.surprise[index])), 0)
        return True


def search(
    problem: GoalProblem,
    *,
    seconds: float = 10.0,
    seed: int = 0,
    timer: Callable[[], float] = time.monotonic,
    progress: Progress = silent,
) -> Found:
    """A structure for some goals with as few blocks as can be found.

    Args:
        seconds: limit, as ``timer`` tells them.
        progress: told how many were looked at, and the best so far.
    """
    clock, found = Clock(seconds, timer, progress), Search(problem, seed)
    best = Found((), 0, 0.0)
    end, runs = clock, 0
    exhausted = not len(problem.site) or not np.isfinite(
        relax(problem, LatticeWorld(problem.site)).blocks
    )
    while end.left > 0 and not exhausted:
        before = found.fewest
        weight = WEIGHTS[0 if found.best is None else runs % 2]
        exhausted = found.run(weight, end, FIRST_RUN * GROWTH**runs, NOISE * (runs > 0))
        runs += 1
        if found.best is None or found.fewest == before:
            continue
        made = Found(trim(problem, found.best), 0, 0.0)
        best = made if not best.placements or made.blocks < best.blocks else best
        found.fewest = best.blocks
        end = Clock(min(clock.left, PATIENCE[0] + PATIENCE[1] * clock.spent), timer, progress)
    return Found(best.placements, found.expanded, clock.spent, exhausted)


def trim(problem: GoalProblem, world: LatticeWorld) -> tuple[BlockPlacement, ...]:
    """The blocks in their order, without those that nothing needs; where props are allowed, those
    that only building needs are temporary."""
    kept = list(world.placed)
    for candidate in reversed(world.placed):
        fewer = [k for k in kept if k != candidate]
        made = replay(problem, fewer)
        if made is not None and not len(unmet(problem, made)) and bears(problem, made):
            kept = fewer
    blocks = [problem.site.placement(k) for k in kept]
    if problem.goals.props:
        for index in reversed(range(len(blocks))):
            trial = [*blocks[:index], replace(blocks[index], prop=True), *blocks[index + 1 :]]
            if finished(problem, tuple(b for b in trial if not b.prop)):
                blocks = trial
    return tuple(blocks)


def replay(problem: GoalProblem, candidates: list[int]) -> LatticeWorld | None:
    """The world after some candidates; None where one is not legal or falls."""
    world: LatticeWorld | None = LatticeWorld(problem.site)
    for k in candidates:
        if world is None or k not in legal(problem, world):
            return None
        world = put(world, k)
    return world


def finished(problem: GoalProblem, blocks: tuple[BlockPlacement, ...]) -> bool:
    """Whether blocks meet the goals, stand and bear the loads, however they got there."""
    goals = problem.goals
    owner = owners(blocks, goals.kit, goals.shape)
    if not (owner[:, :, 0] >= 0).any() or goals.unmet(owner >= 0):
        return False
    stack = find_stack(blocks, goals.kit, goals.shape)
    if np.bincount(stack.upper, minlength=len(stack)).min() == 0:
        return False
    everything = np.ones(len(stack), bool)
    if not Proof(stack).program(everything, everything):
        return False
    return failing_load(goals, stack, owner) is None


def _least_ballast(
    problem: GoalProblem, stack: Stack, owner: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Cells on top of which the least weight holds a structure, and how much on each [kg]; none
    where it stands without or nothing holds it.

    Args:
        stack: with its loads.
        owner: int64[cells].
    """
    goals = problem.goals
    depth = goals.shape[2]
    filled = np.flatnonzero(owner >= 0)
    top = filled[filled % depth < depth - 1]
    top = top[(owner[top + 1] < 0) & goals.open.reshape(-1)[top + 1]]
    x, y, _ = np.unravel_index(top, goals.shape)
    place = (np.stack([x, y], 1) + 0.5 - np.array(goals.shape[:2]) / 2) * goals.kit.pitch[:2]
    bears = np.flatnonzero(stack.lower >= 0)
    unit = float(stack.weight.mean())
    right = np.zeros((len(stack), 3))
    right[:, 0] = stack.weight / unit
    model = Model()
    force, ballast = model.columns(np.zeros(len(stack.point))), model.columns(np.ones(len(top)))
    entries = list[tuple[np.ndarray, np.ndarray, np.ndarray]]()
    for sign, column, block, at in (
        (1.0, force, stack.upper, stack.point[:, :2]),
        (-1.0, force[bears], stack.lower[bears], stack.point[bears, :2]),
        (-1.0, ballast, owner[top], place),
    ):
        lever = (at - stack.centre[block, :2]) / stack.pitch
        for k, arm in enumerate((np.ones(len(block)), lever[:, 0], lever[:, 1])):
            entries.append((3 * block + k, column, sign * arm))
    model.rows(right.reshape(-1), right.reshape(-1), *entries)
    answer = solve(model.program())
    if answer.x is None:
        return top[:0], np.empty(0)
    weight = answer.x[ballast] * unit
    chosen = weight > 1e-6 * unit
    return top[chosen], weight[chosen]
