"""What follows from what is known of a build: the next step that can be done, or what has to be
put right first. Where blocks are is what :mod:`learn2assemble.acting.sight` believes of them.
"""

from __future__ import annotations

import dataclasses
import math
from collections import Counter
from collections.abc import Generator, Set
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from learn2assemble.acting.fitting import OPEN, Fitting
from learn2assemble.cell.arrange import Arranged, Waits, steps_before
from learn2assemble.cell.pieces import Piece
from learn2assemble.cell.structure import Structure
from learn2assemble.cell.workcell import LEANS, STANDS, STRAYED, TRIES, Job, Offset, StepOf
from learn2assemble.cell.world import (
    LOOSE,
    LOST,
    RETURNED,
    STANDING,
    STOCK,
    WorkcellBlocks,
    supply_of,
)

NEAT = 8e-4
"""A neighbour that is off by more is put right where it leaves the next block no room [m]."""
OVER = math.radians(45.0)
"""What leans by more than this from how it waits and how it shall stand has fallen over [rad]."""
BESIDE = 0.012
"""What lies nearer to a place than this is in its way [m]."""
WAITING = "what it stands on, or what comes before it, is missing"
ELSEWHERE = "another arm is about to place it, or in its way"


class Action(NamedTuple):
    """What the arm shall do next."""

    block: int
    goal: np.ndarray
    """float64[7]: pose the block shall have."""
    what: str
    """``place``, ``remove``, ``again`` (from where it stands wrongly), ``away``, ``attach`` (with
    what was built beside), or ``hand``: the step is done by hand."""
    source: int | None = None
    """Where it comes from, or where it goes to where it is taken away."""
    group: tuple[int, ...] = ()
    """What it brings along, ..."""
    to: Offset = (0.0, 0.0, 0.0)
    """... and how far from their places."""


@dataclasses.dataclass
class Done:
    """What came of one attempt, or of a step that was done by hand."""

    number: int
    block: int
    what: str
    outcome: str
    detail: str
    stage: str
    sideways: bool = False
    """Whether the block was held by its side."""
    hand: bool = False
    """Whether it was no attempt of the arm, but done by hand."""

    @property
    def step(self) -> StepOf:
        """The step of the order it belongs to."""
        return StepOf(self.block, self.what == "remove")


class Choice:
    """What is known of a build, and what follows from it.

    Args:
        job: what is to be built.
        found: an order that is proven, and possible for the arm, or by hand.
        structure: what rests on what.
    """

    job: Job
    planned: tuple[StepOf, ...]
    """The steps of the order that was found."""
    order: tuple[StepOf, ...]
    """These, behind those of what stands before the first one and stays."""
    structure: Structure

    def __init__(self, job: Job, found: Arranged, structure: Structure) -> None:
        self.job, self.planned, self.structure = job, found.steps, structure
        self.order = (*job.first, *found.steps)
        self.by_hand: frozenset[StepOf] = found.by_hand
        self.world: WorkcellBlocks = WorkcellBlocks(job)
        for step in self.order:
            if step.beside is not None and not step.group:
                self.world.beside[step.block] = step.beside
        self.fails: Counter[tuple[int, str]] = Counter()
        """By block and what was tried: failures since the last success."""
        self.refused: dict[int, str] = {}
        """Blocks that the arm cannot place as things are, and why."""
        self.accepted: set[int] = {k for k, piece in enumerate(job.pieces) if piece.fixed}
        """Blocks that stay as they are, though perhaps not right."""
        self.elsewhere: set[int] = set()
        """Blocks that another arm is about to place."""
        self.postponed: set[int] = set()
        """Blocks whose way another arm is in."""
        self.waits: Waits = {}
        """By step, those that come before it, which it would be in the way of."""
        if job.standing or any(step.group and step.beside is not None for step in self.planned):
            # Of pieces that are built of pieces, all come in their order.
            self.waits = steps_before(replace(job, steps=self.planned), structure, self.planned)
        self.done: list[Done] = []
        self.fitting: Fitting = Fitting(self.world, structure.studs() is not None)
        self.comes: set[int] = {step.block for step in self.order}

    def state(self) -> dict[str, Any]:
        """What a file says of it, with what came of the last attempt."""
        return {
            "done": dataclasses.asdict(self.done[-1]) if self.done else None,
            "accepted": sorted(self.accepted),
            "beside": self.world.beside.tolist(),
            "home": sorted(self.world.home),
            "fails": [[k, what, n] for (k, what), n in self.fails.items()],
        }

    def restore(self, state: dict[str, Any], done: list[dict[str, Any]]) -> None:
        """As a file says it was."""
        self.done = [Done(**one) for one in done]
        self.accepted = set(state["accepted"])
        self.world.beside = np.array(state["beside"])
        self.world.home = {(a, b) for a, b in state["home"]}
        self.fails = Counter({(k, what): n for k, what, n in state["fails"]})

    def attempts(self) -> list[Done]:
        """Those of the arm."""
        return [done for done in self.done if not done.hand]

    def standing(self) -> set[int]:
        """Pieces of the plan that are in their places."""
        return {k for k in range(len(self.job.pieces)) if self.world.state[k] == STANDING}

    def satisfied(self, step: StepOf) -> bool:
        """Whether a step is done and holds."""
        state = self.world.state[step.block]
        if step.group:
            there = [self.world.state[k] == STANDING for k in (step.block, *step.group)]
            return all(there) and bool((self.world.beside[step.block] != step.whence).any())
        return state == RETURNED or (not step.remove and state == STANDING)

    def choose(self) -> Action | str | None:
        """The next action; None where all is done, words where nothing can be."""
        self.world.table = self.fitting.table(self.standing() - self.accepted)
        repair = self._repair()
        if repair is not None:
            return repair
        standing, blocked = self.standing(), dict[int, str]()
        ready: list[StepOf] = []
        for step in self.order:
            if self.satisfied(step):
                continue
            if {step.block, *step.group} & (self.elsewhere | self.postponed):
                blocked[step.block] = ELSEWHERE
                continue
            if step.remove and step.block not in self.job.standing:
                # A prop may carry whatever came behind it: it goes when all of that is there.
                if not ready and not blocked:
                    ready.append(step)
                break
            before = self.waits.get(step, ())
            if not all(map(self.satisfied, before)) or self._missing(step, standing):
                blocked[step.block] = WAITING
            elif not self.bears(step, standing):
                blocked[step.block] = "it would fall"
            else:
                ready.append(step)
        what = {step: _what(step) for step in ready}
        ready = [step for step in ready if self._left(step.block, what[step]) > 0]
        ready.sort(key=lambda step: self.fails[step.block, what[step]] // TRIES)
        for step in ready:
            why, failed = self.refused.get(step.block), self.fails[step.block, what[step]]
            if failed % TRIES == TRIES - 1 and self.done[-1].block == step.block:
                tight = self._tight(step.block)
                if tight is not None:
                    return tight
            if why is None:
                action = self._place_or_remove(step)
                if isinstance(action, Action):
                    return action
                self.refused[step.block] = why = action
            crooked = self._crooked(step.block)
            if crooked is not None:
                return crooked
            blocked[step.block] = why
        if not blocked and all(self.satisfied(step) for step in self.order):
            return None
        for step in self.order:
            if not self.satisfied(step) and step.block not in blocked:
                last = [d for d in self.done if d.block == step.block]
                blocked[step.block] = last[-1].detail if last else "it comes later"
        causes = [k for k, why in blocked.items() if why != WAITING]
        number, *rest = causes or list(blocked)
        piece, waiting = self.world.pieces[number], len(blocked) - 1 - len(rest)
        others = f" and {len(rest)} other{'s' * (len(rest) > 1)}" if rest else ""
        after = f"; {waiting} more wait{'s' * (waiting == 1)} for that" if waiting else ""
        return f"{piece.id} ({piece.name}){others} cannot be placed: {blocked[number]}{after}"

    def next_after(self, blocks: Set[int]) -> StepOf | None:
        """The step that comes next, as a rule, when some blocks are in their places: of bricks that
        clutch, the first one for which nothing is missing then, if there is one."""
        others = blocks | self.elsewhere
        left = [s for s in self.order if s.block not in others and not self.satisfied(s)]
        if self.structure.studs() is not None:
            there = self.standing() | {k for k in others if k < len(self.job.pieces)}
            left = [step for step in left if self._comes(step, others, there)] or left
        return next(iter(left), None)

    def _comes(self, step: StepOf, others: Set[int], there: set[int]) -> bool:
        """Whether nothing is missing for a step when some pieces are there and steps with others
        are done."""
        before = self.waits.get(step, ())
        done = all(self.satisfied(one) or one.block in others for one in before)
        return done and not self._missing(step, there)

    def bears(self, step: StepOf, standing: set[int]) -> bool:
        """Whether a step may be done: everything stands then, whether what another arm is about to
        place or take away is there or not."""
        # What is only put aside comes to no place.
        moved = {k for k in self.elsewhere if k < len(self.job.pieces)}
        states = {frozenset(standing - moved), frozenset(standing | moved)}
        return all(self.structure.takes(step, state, self.world) for state in states)

    def _left(self, block: int, what: str) -> int:
        return 3 * TRIES - self.fails[block, what]

    def _place_or_remove(self, step: StepOf) -> Action | str:
        world, k = self.world, step.block
        if step in self.by_hand:
            return Action(k, self.fitted(k), "hand")
        if step.group:
            goal = self.fitted(k, step.group, step.to)
            return Action(k, goal, "attach", None, step.group, step.to)
        if step.remove:
            goal = self._away(k)
            return goal if isinstance(goal, str) else goal._replace(what="remove")
        if world.state[k] == LOOSE:
            return Action(k, self.fitted(k), "place", world.source[k])
        places = supply_of(world, k)
        if not places:
            return f"no {world.pieces[k].name} is left in the supply"
        lying = {source: self._lies_at(k, source) for source in places}
        free = next((source for source in places if lying[source] is None), None)
        if free is None:
            name = world.names[lying[places[0]] or 0]
            return f"{name} lies where the next {world.pieces[k].name} would be presented"
        return Action(k, self.fitted(k), "place", free)

    def _lies_at(self, k: int, source: int) -> int | None:
        """What lies where a source would present a block, but that block itself; None: nothing."""
        world = self.world
        place = area(world.pieces[k], world.presented(k, source))
        lies = (LOOSE, LOST)
        others = (n for n in world.visible() if n != k and world.state[n] in lies)
        near = (n for n in others if area(world.pieces[n], world.pose[n]).intersects(place))
        return next(near, None)

    # ------------------------------------------------------------ repair

    def _repair(self) -> Action | None:
        """What has to be put right first; what another arm does that for is its own."""
        world, standing = self.world, self.standing()
        wrong = [k for k in sorted(standing - self.accepted - self.elsewhere) if self._wrong(k)]
        for k in wrong:
            top = next(iter(self.structure.loads(k, standing & self._together(k))), k)
            if top in self.elsewhere:
                continue
            whole = self._bed(top) <= standing | self.accepted
            if top == k and whole and self._left(k, "again") > 2 * TRIES:
                return Action(k, self.fitted(k), "again")
            action = self._away(top) if self._left(top, "away") > 2 * TRIES else ""
            if isinstance(action, Action):
                return action
            self.accepted.add(k)  # Nothing helps: it stays as it is.
        for k in range(len(world.pieces)):
            lies = world.state[k] in (LOOSE, LOST) and k not in self.elsewhere
            if lies and self._in_the_way(k):
                action = self._away(k) if self._left(k, "away") > TRIES else ""
                if isinstance(action, Action):
                    return action
        return None

    def _crooked(self, k: int) -> Action | None:
        """Put a neighbour right that leaves a block no room."""
        standing, place = self.standing(), self.world.pieces[k].face().buffer(BESIDE)
        for n in sorted(standing - self.accepted):
            off = self.world.pose[n, :2] - self.world.target(n)[:2]
            other, piece = self.job.pieces[n], self.job.pieces[k]
            bottom, top = (
                pick(other.extent[end][2], piece.extent[end][2])
                for end, pick in ((0, max), (1, min))
            )
            level = top - bottom > 1e-3
            free = not self.structure.loads(n, standing) and self._left(n, "again") > 2 * TRIES
            beside = self.world.pieces[n].face().intersects(place)
            if level and free and beside and np.linalg.norm(off) > NEAT:
                return Action(n, self.fitted(n), "again")
        return None

    def _tight(self, k: int) -> Action | None:
        """Put a neighbour right that leaves a block less room than it needs, where it can be."""
        standing = self.standing()
        for n in self.fitting.tight(k, standing & self._together(k)):
            free = not (self.job.pieces[n].fixed or self.structure.loads(n, standing))
            if free and self._left(n, "again") > 2 * TRIES:
                return Action(n, self.fitted(n), "again")
        return None

    def _bed(self, k: int) -> set[int]:
        """What a piece stands on and that is not meant to be gone."""
        below = self.structure.below[k] & self._together(k)
        return {b for b in below if self.world.state[b] != RETURNED}

    def _together(self, k: int) -> set[int]:
        """Pieces of the same part of the structure as things are."""
        return set(np.flatnonzero(self.world.together(k)).tolist())

    def _missing(self, step: StepOf, standing: set[int]) -> set[int]:
        """What a step needs to be there that is not, or to be gone that is there."""
        k, below = step.block, self.structure.below
        if step.remove:
            return set(self.structure.loads(k, standing))
        if step.group:
            group, at = {k, *step.group}, (self.world.beside == step.to).all(1)
            needed = set[int]().union(*(below[n] for n in group)) - group
            if step.beside is not None:
                # The rest of what carries it comes when the larger piece is brought.
                needed = {n for n in needed if at[n]}
            return group - standing | needed - {n for n in standing if at[n]}
        if self.world.beside[k].any():
            return self._bed(k) - standing
        there = standing & self._together(k)
        return {n for n in below[k] - there if self.world.state[n] != RETURNED}

    def _wrong(self, k: int) -> bool:
        """Whether a block has to be taken up again."""
        target, found = self.world.target(k), self.world.pose[k]
        turned = self.world.pieces[k].turned_by(found[3:], target[3:])
        off = float(np.linalg.norm(found[:3] - target[:3]))
        # What is shifted with its row stays; what was pushed there goes back, if that is certain.
        least = STRAYED + OPEN * float(self.world.spread[k, 0])
        pushed = off > least and float(np.linalg.norm((found - self.fitted(k))[:3])) > least
        missing = self._bed(k) - self.standing()
        apart = bool(missing) or self.structure.loose(k, self.world)
        return off > STANDS or pushed or turned > LEANS or apart

    def _away(self, k: int) -> Action | str:
        """Back to a magazine, to where it came from, or to a free place on the table."""
        world, piece = self.world, self.world.pieces[k]
        now = world.pose[k, 3:]
        if min(piece.lean(now, piece.pose[3:]), piece.lean(now, piece.waits[3:])) < OVER:
            own = world.source[k]
            number = world.magazine(k) if own is None else own
            if number is not None:
                return Action(k, world.presented(k, number), "away", number)
        for x, y in self._free_places(k):
            height = world.pose[k, 2] - float(piece.corners(world.pose[k])[:, 2].min())
            return Action(k, np.array([x, y, height, *now]), "away")
        return "there is no free place for it"

    def _free_places(self, k: int) -> list[tuple[float, float]]:
        """Places on the table where a block may lie, the nearest to the arm first."""
        import shapely

        world = self.world
        lying = [area(world.pieces[n], world.pose[n]) for n in world.visible() if n != k]
        places = [p.face() for p in self.job.pieces if not p.sunk]
        sources = [source.area for source in self.job.sources]
        taken = shapely.union_all(lying + places + sources)
        size = float(np.linalg.norm(self.world.pieces[k].half))
        tried = self.fails[k, "away"]
        grid = np.arange(-0.6, 0.61, 0.1)
        around = [
            (float(x), float(y)) for x in grid + self.job.base[0] for y in grid + self.job.base[1]
        ]
        around.sort(key=lambda p: abs(math.dist(p, self.job.base) - 0.45))
        free = [
            p
            for p in around
            if shapely.Point(p).distance(taken) > size + 0.03
            and math.dist(p, self.job.base) > 0.25 + size
        ]
        return free[tried : tried + 1]

    def _in_the_way(self, k: int) -> bool:
        """Whether it lies where a block shall stand or is presented."""
        world = self.world
        if world.source[k] is not None and world.state[k] == LOOSE:
            at = self.job.sources[world.source[k] or 0].pose
            if math.dist((at.x, at.y), world.pose[k, :2]) < BESIDE:
                return False  # It still waits where it always has.
        near = area(world.pieces[k], world.pose[k]).buffer(BESIDE)
        open_places = [
            n for n in range(len(self.job.pieces)) if n != k and world.state[n] in (STOCK, LOOSE)
        ]
        if any(world.pieces[n].face().intersects(near) for n in open_places):
            return True
        return any(source.magazine and source.area.intersects(near) for source in self.job.sources)

    def fitted(
        self, k: int, group: tuple[int, ...] = (), to: Offset = (0.0, 0.0, 0.0)
    ) -> np.ndarray:
        """float64[7]: where a block goes, with what it brings along, see
        :class:`~.fitting.Fitting`; that goes so far from its place."""
        with self._joined(k, group, to) as others:
            coming = {n for n in others & self.comes if self.world.state[n] in (STOCK, LOOSE)}
            return self.fitting.goal(k, self.standing() & others, coming)

    def home(
        self, k: int, group: tuple[int, ...] = (), to: Offset = (0.0, 0.0, 0.0)
    ) -> np.ndarray | None:
        """float64[7]: where knobs draw a brick, with what it brings along; None: it is on none."""
        if self.structure.studs() is None:
            return None
        with self._joined(k, group, to) as others:
            return self.fitting.home(k, self.standing() & others)

    @contextmanager
    def _joined(
        self, k: int, group: tuple[int, ...], to: Offset
    ) -> Generator[set[int], None, None]:
        """Pieces of the part of the structure that a block comes to, without what it brings along;
        meanwhile that is taken to belong to the structure."""
        world, taken = self.world, [k, *group]
        beside = world.beside[taken].copy()
        if group:
            world.beside[taken] = to
        try:
            yield self._together(k) - set(taken)
        finally:
            world.beside[taken] = beside

    def height(self, k: int) -> float:
        """Standard deviation of the height of what carries a block in its place [m]."""
        return self.fitting.height(k, self.standing() & self._together(k) - {k})


def _what(step: StepOf) -> str:
    """What the attempt at a step is called, see :attr:`Action.what`."""
    return "attach" if step.group else "remove" if step.remove else "place"


def area(piece: Piece, pose: np.ndarray) -> Any:
    """Hull of what lies below a block, wherever it lies and however it is turned [m].

    Args:
        pose: float64[7]: position and quaternion (w, x, y, z) of its centre.
    """
    import shapely

    return shapely.MultiPoint(piece.corners(pose)[:, :2]).convex_hull
