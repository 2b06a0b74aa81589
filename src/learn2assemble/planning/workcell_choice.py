"""What to do next in a build: the next step that can be done, or what has to be put right first."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, NamedTuple

import numpy as np

from learn2assemble.geometry.rotations import quaternion_matrix, yaw_quaternion
from learn2assemble.planning.workcell import (
    LEANS,
    LOOSE,
    LOST,
    RETURNED,
    STANDING,
    STANDS,
    STOCK,
    TRIES,
    Job,
    StepOf,
    Structure,
    World,
    frame_of,
    supply_of,
)
from learn2assemble.planning.workcell_sense import STEADY, fitted
from learn2assemble.planning.workcell_site import QUARTER, Pose, footprint

NEAT = 8e-4
"""A neighbour that is off by more is put right where it leaves the next block no room [m]."""
BESIDE = 0.012
"""What lies nearer to a place than this is in its way [m]."""
WAITING = "what it stands on is missing"


class Action(NamedTuple):
    """What the arm shall do next."""

    block: int
    goal: np.ndarray
    """float64[7]: pose the block shall have."""
    what: str
    """``place``, ``remove``, ``again`` (from where it stands wrongly) or ``away``."""
    source: int | None = None
    """Where it comes from, or where it goes to where it is taken away."""


@dataclasses.dataclass
class Done:
    """What came of one attempt."""

    number: int
    block: int
    what: str
    outcome: str
    detail: str
    stage: str
    sideways: bool = False
    """Whether the block was held by its side."""


class Choice:
    """What is known of a build, and what follows from it.

    Args:
        job: what is to be built.
        order: proven, and possible for the arm.
        structure: what rests on what.
    """

    def __init__(self, job: Job, order: tuple[StepOf, ...], structure: Structure) -> None:
        self.job, self.order, self.structure = job, order, structure
        self.world = World(job)
        self.believe()
        self.fails: dict[tuple[int, str], int] = {}
        """By block and what was tried: failures since the last success."""
        self.refused: dict[int, str] = {}
        """Blocks that the arm cannot place as things are, and why."""
        self.accepted: set[int] = set()
        """Blocks that stay as they are, though not right."""
        self.done: list[Done] = []

    def believe(self) -> None:
        """Everything is where it really is: float64[N, 7], and variances float64[N, 2]."""
        self.belief = self.world.pose.copy()
        self.variance = np.full((len(self.belief), 2), STEADY**2)

    def replace(self, k: int, spare: int) -> None:
        """Another block takes the place of a piece, which has this number from now on."""
        self.belief = np.vstack([self.belief, self.world.pose[spare]])
        self.belief[k] = self.world.pose[k]
        self.variance = np.vstack([self.variance, self.variance[k]])

    def state(self) -> dict[str, Any]:
        """What a file says of it, with what came of the last attempt."""
        return {
            "done": dataclasses.asdict(self.done[-1]), "belief": self.belief.tolist(),
            "variance": self.variance.tolist(), "accepted": sorted(self.accepted),
            "fails": [[k, what, n] for (k, what), n in self.fails.items()],
        }  # fmt: skip

    def restore(self, state: dict[str, Any], done: list[dict[str, Any]]) -> None:
        """As a file says it was."""
        self.done = [Done(**one) for one in done]
        self.belief, self.variance = np.array(state["belief"]), np.array(state["variance"])
        self.accepted = set(state["accepted"])
        self.fails = {(k, what): n for k, what, n in state["fails"]}

    def standing(self) -> set[int]:
        """Pieces of the plan that are in their places."""
        return {k for k in range(len(self.job.pieces)) if self.world.state[k] == STANDING}

    def satisfied(self, step: StepOf) -> bool:
        """Whether a step is done and holds."""
        state = self.world.state[step.block]
        return state == RETURNED or (not step.remove and state == STANDING)

    def choose(self) -> Action | str | None:
        """The next action; None where all is done, words where nothing can be."""
        repair = self._repair()
        if repair is not None:
            return repair
        standing, blocked = self.standing(), dict[int, str]()
        ready: list[StepOf] = []
        for step in self.order:
            if self.satisfied(step):
                continue
            if step.remove:
                if not ready and not blocked:
                    ready.append(step)
                break
            missing = {k for k in self.structure.below[step.block] - standing
                       if self.world.state[k] != RETURNED}  # fmt: skip
            if missing:
                blocked[step.block] = WAITING
            elif not self.structure.stands(frozenset(standing | {step.block})):
                blocked[step.block] = "it would fall"
            else:
                ready.append(step)
        ready = [step for step in ready if self._left(step.block, "place") > 0]
        ready.sort(key=lambda step: self.fails.get((step.block, "place"), 0) // TRIES)
        for step in ready:
            why = self.refused.get(step.block)
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
        number = next(iter(causes or blocked))
        why = blocked[number]
        others = f" and {len(blocked) - 1} others" if len(blocked) > 1 else ""
        piece = self.world.pieces[number]
        return f"{piece.id} ({piece.name}){others} cannot be placed: {why}"

    def _left(self, block: int, what: str) -> int:
        return 3 * TRIES - self.fails.get((block, what), 0)

    def _place_or_remove(self, step: StepOf) -> Action | str:
        world, k = self.world, step.block
        if step.remove:
            goal = self._away(k)
            return goal if isinstance(goal, str) else goal._replace(what="remove")
        if world.state[k] == LOOSE:
            return Action(k, self.fitted(k), "place", world.source[k])
        places = supply_of(world, k)
        if not places:
            return f"no {world.pieces[k].name} is left in the supply"
        return Action(k, self.fitted(k), "place", places[0])

    # ------------------------------------------------------------ repair

    def _repair(self) -> Action | None:
        """What has to be put right first."""
        world, standing = self.world, self.standing()
        wrong = [k for k in sorted(standing - self.accepted) if self._wrong(k)]
        for k in wrong:
            top = next(iter(self.structure.loads(k, standing)), k)
            whole = self._bed(top) <= standing | self.accepted
            if top == k and whole and self._left(k, "again") > 2 * TRIES:
                return Action(k, self.fitted(k), "again")
            action = self._away(top) if self._left(top, "away") > 2 * TRIES else ""
            if isinstance(action, Action):
                return action
            self.accepted.add(k)  # Nothing helps: it stays as it is.
        for k in range(len(world.pieces)):
            if world.state[k] in (LOOSE, LOST) and self._in_the_way(k):
                action = self._away(k) if self._left(k, "away") > TRIES else ""
                if isinstance(action, Action):
                    return action
        return None

    def _crooked(self, k: int) -> Action | None:
        """Put a neighbour right that leaves a block no room."""
        standing, place = self.standing(), footprint_of(self.world, k).buffer(BESIDE)
        for n in sorted(standing - self.accepted):
            off = self.belief[n, :2] - self.world.target(n)[:2]
            other, piece = self.job.pieces[n], self.job.pieces[k]
            level = abs(other.target[2] - piece.target[2]) < other.half[2] + piece.half[2] - 1e-3
            free = not self.structure.loads(n, standing) and self._left(n, "again") > 2 * TRIES
            beside = footprint_of(self.world, n).intersects(place)
            if level and free and beside and np.linalg.norm(off) > NEAT:
                return Action(n, self.fitted(n), "again")
        return None

    def _bed(self, k: int) -> set[int]:
        """What a piece stands on and that is not meant to be gone."""
        return {b for b in self.structure.below[k] if self.world.state[b] != RETURNED}

    def _wrong(self, k: int) -> bool:
        """Whether a block has to be taken up again."""
        target, found = self.world.target(k), self.belief[k]
        frame = frame_of(found[3:])
        turned = abs((frame.yaw - self.world.pieces[k].yaw + QUARTER / 2) % QUARTER - QUARTER / 2)
        off = float(np.linalg.norm(found[:3] - target[:3]))
        missing = self._bed(k) - self.standing()
        return off > STANDS or max(turned, frame.tilt) > LEANS or bool(missing)

    def _away(self, k: int) -> Action | str:
        """Back to a magazine, to where it came from, or to a free place on the table."""
        world, piece = self.world, self.world.pieces[k]
        if (frame_of(world.pose[k, 3:]).side == np.eye(3)).all():
            own = world.source[k]
            number = world.magazine(k) if own is None else own
            if number is not None:
                return Action(k, world.presented(k, number), "away", number)
        for x, y in self._free_places(k):
            goal = np.array([x, y, piece.half[2], *yaw_quaternion(0.0)])
            return Action(k, goal, "away")
        return "there is no free place for it"

    def _free_places(self, k: int) -> list[tuple[float, float]]:
        """Places on the table where a block may lie, the nearest to the arm first."""
        import shapely

        taken = shapely.union_all([self._area(n) for n in self.world.visible() if n != k] + [
            footprint(p.shape, Pose(p.target[0], p.target[1], p.yaw)) for p in self.job.pieces
        ] + [footprint(s.shape, s.pose) for s in self.job.sources])  # fmt: skip
        size = float(np.linalg.norm(self.world.pieces[k].half))
        tried = self.fails.get((k, "away"), 0)
        grid = np.arange(-0.6, 0.61, 0.1)
        around = [(float(x), float(y)) for x in grid + self.job.base[0]
                  for y in grid + self.job.base[1]]  # fmt: skip
        around.sort(key=lambda p: abs(math.dist(p, self.job.base) - 0.45))
        free = [p for p in around
                if shapely.Point(p).distance(taken) > size + 0.03
                and math.dist(p, self.job.base) > 0.25 + size]  # fmt: skip
        return free[tried : tried + 1]

    def _area(self, k: int) -> Any:
        import shapely

        piece, pose = self.world.pieces[k], self.world.pose[k]
        turn = quaternion_matrix(pose[3:])
        corners = [pose[:3] + turn @ (np.array(c) + np.array(h) * s)
                   for c, h in piece.shape for s in np.ndindex(2, 2, 2)]  # fmt: skip
        corners += [pose[:3] + turn @ (np.array(c) - np.array(h) * s)
                    for c, h in piece.shape for s in np.ndindex(2, 2, 2)]  # fmt: skip
        return shapely.MultiPoint(np.array(corners)[:, :2]).convex_hull

    def _in_the_way(self, k: int) -> bool:
        """Whether it lies where a block shall stand or is presented."""
        world = self.world
        if world.source[k] is not None and world.state[k] == LOOSE:
            at = self.job.sources[world.source[k] or 0].pose
            if math.dist((at.x, at.y), world.pose[k, :2]) < BESIDE:
                return False  # It still waits where it always has.
        area = self._area(k).buffer(BESIDE)
        open_places = [n for n in range(len(self.job.pieces))
                       if n != k and world.state[n] in (STOCK, LOOSE)]  # fmt: skip
        if any(footprint_of(world, n).intersects(area) for n in open_places):
            return True
        return any(source.magazine and footprint(source.shape, source.pose).intersects(area)
                   for source in self.job.sources)  # fmt: skip

    def fitted(self, k: int) -> np.ndarray:
        """float64[7]: where a block goes, see :func:`~.workcell_sense.fitted`."""
        return fitted(self.world, self.belief, self.standing() - {k}, k)


def footprint_of(world: World, k: int) -> Any:
    """What a piece of the plan covers in the finished structure, as a shapely area."""
    piece = world.pieces[k]
    return footprint(piece.shape, Pose(piece.target[0], piece.target[1], piece.yaw))
