"""Building a design by scores: the best candidate first, and repair at dead ends.

The scores are those of the network, or of a rule that nobody had to learn (:data:`RULES`).

**Budget.** A state is *expanded* when its candidates are described and scored. A
plan may expand ``budget`` states per block: every block beyond the most that ever stood together
earns so many, and the search ends where they are used up. So a finished plan of n blocks has
expanded at most ``budget * n`` states. Trying a scored candidate (its proof of equilibrium, and the
count of cells that nothing would fill any more) expands nothing.

With ``budget=1`` there is no search: of the scored candidates the best that stands is put down, and
the first dead end is the end.

With more, a candidate is passed over where it would leave an open cell that no candidate fills, or
a heap that cannot fill what is open. Where no candidate is left, the blocks around the cells in
question are taken out again, more of them every time, and are tried later than before. What rested
on them is put back where it was as soon as it can be, which expands nothing.

On a site for props, where nothing else is left, a block that would fall is put down all the same if
a stack of blocks below it can be its prop; what is finished has to stand without any.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from learn2assemble.linear_programs import INF, Clock
from learn2assemble.planning.tiling.props import FIRM
from learn2assemble.planning.tiling.world import LatticeSite, LatticeWorld

if TYPE_CHECKING:
    from l2a_lab.builder.arm import Hand

Score = Callable[[LatticeWorld, np.ndarray], np.ndarray]
"""Logits float[m] of candidates int64[m] of what is built so far, the best one highest."""
BUDGET = 10
WINDOW = 384
"""Candidates scored at a time: the lowest, and of those the nearest to the last block."""
_TRIES = 12
"""Candidates tried in a state before it counts as a dead end."""
_PENALTY = 0.5
"""Taken from the logit of a candidate every time it has been taken out."""
_NOISE = 0.5
"""Scale of the noise of logits once something has been taken out."""
_HANGING = 4.0
"""A logit for every cell by which a centroid is beside what carries it."""
_SNAPSHOT = 16
"""Blocks between two states that are kept to go back to."""


def lowest_largest(world: LatticeWorld, candidates: np.ndarray) -> np.ndarray:
    """The lowest level first, and on it the largest block."""
    found, size = world.site.found, world.site.found.size()
    return size[candidates] / size.max() - found.origin[candidates, 2]


def scarcest_cell(world: LatticeWorld, candidates: np.ndarray) -> np.ndarray:
    """The open cell first that the fewest candidates would fill, and into it the largest block."""
    site, size = world.site, world.site.found.size()
    ways = [int(world.cover[site.cells(int(c))].min()) for c in candidates]
    # As logs, so that noise and penalties swap cells of about as many candidates.
    return 0.1 * size[candidates] / size.max() - np.log(ways)


RULES: dict[str, Score | None] = {
    "lowest level, then largest block": lowest_largest,
    "scarcest cell first": scarcest_cell,
    "random": None,
}
"""Scores that nobody had to learn, by name."""


@dataclass(frozen=True, eq=False)
class SearchOutcome:
    """How far a search came."""

    world: LatticeWorld
    """The state with the fewest open cells."""
    expanded: int
    """States scored, over the whole search."""
    repairs: int
    """Dead ends after which blocks were taken out."""
    seconds: float
    decisions: tuple[float, ...] = ()
    """Seconds of every decision: of a placement, or of a repair and what led to it."""
    timed_out: bool = False

    @property
    def complete(self) -> bool:
        """Whether every wanted cell is filled."""
        return self.world.complete


def window(world: LatticeWorld, legal: np.ndarray) -> np.ndarray:
    """The :data:`WINDOW` lowest of legal candidates; on a level, the nearest to the last block."""
    if len(legal) <= WINDOW:
        return legal
    origin = world.site.found.origin
    last = origin[world.placed[-1]] if world.placed else np.zeros(3, np.int64)
    near = np.abs(origin[legal, :2] - last[:2]).sum(1)
    return legal[np.lexsort((near, origin[legal, 2]))[:WINDOW]]


class _BuilderSearch:
    def __init__(
        self, start: LatticeWorld, score: Score | None, seed: int, hand: Hand | None
    ) -> None:
        self.site = site = start.site
        self.score, self.hand = score, hand
        self.rng = np.random.default_rng(seed)
        self.world = start.copy()
        self.expanded = 0
        self.taken: Counter[int] = Counter()
        self.kept: list[LatticeWorld] = [self.world.copy()]
        self.sizes = np.array([len(kind.cells) for kind in site.kit.kinds])
        self.reach = max(max(max(cell) for cell in way.cells) for way in site.found.ways) + 1
        self.limited = bool((self.world.heap >= 0).any())
        self.left_over: list[int] = []
        self.dead: tuple[LatticeWorld, list[LatticeWorld], np.ndarray] | None = None
        """The dead end with the fewest open cells, what was kept then, and the cells to blame."""
        self.hopeless = len(self.world.stranded())

    def expand(self) -> np.ndarray:
        """Candidates of the present state, the best first."""
        candidates = window(self.world, self.world.legal())
        self.expanded += 1
        if not len(candidates):
            return candidates
        if self.score is None:
            logits = self.rng.random(len(candidates))
        else:
            logits = self.score(self.world, candidates)
        if self.hand is not None:
            logits = logits + self.hand.prefers(candidates)
        if self.site.props:
            logits = logits + _HANGING * np.minimum(self.site.found.support[candidates], 0.0)
        if self.taken:
            logits = logits - _PENALTY * np.array([self.taken[int(c)] for c in candidates])
            logits = logits + _NOISE * self.rng.gumbel(size=len(logits))
        return candidates[np.argsort(-logits, kind="stable")]

    def keep(self) -> None:
        if len(self.world.placed) % _SNAPSHOT == 0:
            self.kept.append(self.world.copy())

    def dead_end(self, world: LatticeWorld) -> np.ndarray | None:
        """Cells that cannot be filled any more, or whose blocks have to be held when all is done;
        none where the heap is to blame; else None."""
        stranded = world.stranded()
        if world.complete and (falls := world.falls()):
            return np.concatenate([self.site.cells(world.placed[n]) for n in falls])
        if len(stranded) > self.hopeless:
            return stranded
        if self.limited:
            places = world.room()
            left = np.where(world.heap < 0, places, np.minimum(world.heap, places))
            if (left * self.sizes).sum() < world.open - self.hopeless:
                return stranded[:0]
        return None

    def blocked(self, candidate: int) -> np.ndarray | None:
        """Cells to blame where an arm cannot make a placement now; None where it can."""
        return None if self.hand is None else self.hand.blocked(self.world, candidate)

    def step(self) -> np.ndarray | None:
        """Put down the best candidate; None, or the cells that are to blame for a dead end."""
        blame: list[np.ndarray] = []
        fallen: list[int] = []
        tried = 0
        for candidate in self.expand():
            trial = self.world.copy()
            hangs = self.site.found.support[candidate] <= FIRM
            if not (trial.place(int(candidate)) or (hangs and trial.prop_up(int(candidate)))):
                fallen.append(int(candidate))
                continue
            dead = self.dead_end(trial)
            dead = self.blocked(int(candidate)) if dead is None else dead
            if dead is None:
                self.world = trial
                self.keep()
                self.put_back()
                return None
            blame.append(dead)
            tried += 1
            if tried == _TRIES:
                break
        if not blame or self.site.props:
            for candidate in fallen[:_TRIES]:
                if self.blocked(candidate) is None and self.world.place(candidate, program=True):
                    self.keep()
                    return None
            for candidate in fallen[:_TRIES] if self.site.props else ():
                trial = self.world.copy()
                if trial.prop_up(candidate):
                    dead = self.dead_end(trial)
                    if dead is None:
                        self.world = trial
                        self.keep()
                        return None
                    blame.append(dead)
        if not blame:
            # What carries the blocks that fall.
            below = [self.site.cells(c) - 1 for c in fallen[:_TRIES]]
            return np.concatenate(below) if below else np.flatnonzero(self.world.cover < 0)
        cells = np.concatenate(blame)
        return cells[cells >= 0]

    def repair(self, cells: np.ndarray, radius: int) -> None:
        """Take out the blocks around ``cells`` and what rests on them.

        What only rested on others is put back where it was as soon as it can be.

        Args:
            radius: how far around [cells]. Without cells, and now and then with a limited heap,
                part of some level is taken out instead, so that it may use other blocks.
        """
        if self.dead is not None and self.dead[0].open < self.world.open:
            self.world, self.kept, cells = self.dead[0], list(self.dead[1]), self.dead[2]
        else:
            self.dead = self.world, list(self.kept), cells
        world, shape = self.world, self.site.wanted.shape
        out = np.zeros(len(world.placed), bool)
        filled = np.flatnonzero(world.owner >= 0)
        where = np.stack(np.unravel_index(filled, shape), -1)
        anywhere = not len(cells) or (self.limited and self.rng.random() < 0.5)
        if anywhere:
            first, level = where[int(self.rng.integers(len(where)))], 0
            radius += self.reach // 2
        else:
            at = np.stack(np.unravel_index(np.unique(cells), shape), -1)
            # One of the places at a time: others may be consequences.
            first, level = at[int(self.rng.integers(len(at)))], max(0, radius - self.reach)
        near = np.abs(where - first)
        close = (near[:, :2].max(1) <= radius) & (near[:, 2] <= level)
        out[world.owner[filled[close]]] = True
        if not out.any():
            out[-min(2 * radius, len(out)) :] = True
        self.taken.update(np.array(world.placed)[out].tolist())
        first_out = int(np.flatnonzero(out)[0])
        again = [c for c, gone in zip(world.placed, out, strict=True) if not gone]
        self.kept = [kept for kept in self.kept if len(kept.placed) <= first_out]
        self.world = self.kept[-1].copy()
        self.left_over = again[len(self.world.placed) :]
        self.put_back()

    def put_back(self) -> None:
        """Put back what was taken out only because it rested on others, where it can be."""
        for candidate in list(self.left_over):
            if not self.world.alive[candidate]:
                self.left_over.remove(candidate)
            elif self.world.waits[candidate] == 0:
                trial = self.world.copy()
                good = trial.place(candidate) and self.dead_end(trial) is None
                if good and self.blocked(candidate) is None:
                    self.left_over.remove(candidate)
                    self.world = trial
                    self.keep()


def build(
    start: LatticeSite | LatticeWorld,
    score: Score | None,
    *,
    budget: float = BUDGET,
    seed: int = 0,
    seconds: float = INF,
    hand: Hand | None = None,
) -> SearchOutcome:
    """Build a design.

    Args:
        start: the design, or what there is of it.
        score: of the candidates, such as a builder; None: they are scored at random.
        budget: expanded states per block; 1: no search.
        seed: of ties, of repairs and of random scores.
        seconds: wall-clock limit.
        hand: makes the placements; without one they make themselves.
    """
    start = start if isinstance(start, LatticeWorld) else LatticeWorld(start)
    clock, search = Clock(seconds), _BuilderSearch(start, score, seed, hand)
    decisions: list[float] = []

    def finished(world: LatticeWorld, repairs: int, timed_out: bool = False) -> SearchOutcome:
        times = tuple(np.diff([*decisions, clock.spent]).tolist())
        return SearchOutcome(world, search.expanded, repairs, clock.spent, times, timed_out)

    if budget <= 1:
        world = search.world
        while not world.complete and clock.left > 0:
            decisions.append(clock.spent)
            order = search.expand()
            ways = ((int(c), program) for program in (False, True) for c in order)
            if not any(
                search.blocked(c) is None and world.place(c, program) for c, program in ways
            ):
                break
        return finished(world, 0, clock.left <= 0)
    best, most, repairs, radius = search.world, 0, 0, 1
    while not search.world.complete and search.expanded < budget * (most + 1):
        if clock.left <= 0:
            return finished(best, repairs, True)
        decisions.append(clock.spent)
        cells = search.step()
        if search.world.open < best.open:
            best = search.world
        if len(search.world.placed) > most:
            most, radius = len(search.world.placed), 1
        if cells is not None:
            if not search.world.placed:
                break
            search.repair(cells, radius)
            repairs, radius = repairs + 1, radius + 1
    if search.world.complete:
        best = search.world
    return finished(best, repairs)
