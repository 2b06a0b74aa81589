"""An arm carries out a plan: any blocks at any pose, tight joints, props placed and taken away.

First the order is chosen with the kinematic cell: among the blocks whose support stands, those of
the lowest level and farthest from the arm first, the first one that the arm can pick up and put
down; every state is proven to stand as in the plan. Then a plant carries it out, and the arm looks
where everything is; small deviations are corrected in the next placements, large ones are repaired:
what stands wrongly is taken up and placed again, after what stands on it has been taken away.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from learn2assemble.cell.pieces import Piece, pieces_of
from learn2assemble.cell.site import Obstacle, Site, Source
from learn2assemble.errors import InputError
from learn2assemble.geometry.rotations import (
    matrix_quaternion,
    quaternion_matrix,
    rotation_of,
    yaw_quaternion,
)
from learn2assemble.motion.setup import Disturbance, Noise, Simulated
from learn2assemble.planning.clearance import ways_out
from learn2assemble.robot.arm import Arm, get_arm
from learn2assemble.robot.bodies import Shape
from learn2assemble.robot.grasps import WAY, facing
from learn2assemble.robot.holding import attitude, ways_to_turn
from learn2assemble.robot.kinematic import KinematicCell
from learn2assemble.robot.moves import Attempt, Move, Scene
from learn2assemble.robot.studs import Studs
from learn2assemble.statics.proofs import BED, TIGHT

if TYPE_CHECKING:
    from learn2assemble.assembly.blocks import Assembly
    from learn2assemble.assembly.contacts import Contacts
    from learn2assemble.planning.plan import Plan

Progress = Callable[[str], None]
STANDS = 0.003
"""A block farther from its place than this is placed again [m] ..."""
LEANS = math.radians(2.0)
"""... and so is one that leans or is turned by more [rad]."""
FLAT = math.radians(4.0)
"""What leans more cannot be picked up [rad]."""
SEEMS_FLAT = math.radians(1.0)
"""What seems to lean by less rests on its face [rad]."""
HIDDEN = 0.05
"""Blocks in a magazine lie so far under the table [m]."""
OBSTACLE_DENSITY = 20_000.0
"""Nothing moves an obstacle [kg/m³]."""
FARTHEST_OUT, OUT_ROOM = 0.5, 0.005
"""No block is drawn out from below others farther than this, and what room it then has [m]."""
LEANING = 0.02
"""A joint leans where the height of its normal is neither 0 nor 1 by more."""
STEEP_JOINT = 0.9
"""Where the height of its normal is less, a block does not come straight down on a joint."""
LOW_WAY, MORE_WAYS = 0.3, 2
"""Height of the directions from which a block may come, at least, and how many further ones are
tried where blocks lean."""
PLACED = 1.5e-4
"""Standard deviation of where blocks come to stand where readings are not exact [m]."""
TRIES = 3
"""Attempts at one step before others come first."""


ROOMS = 0.0015, 0.0
"""Room for the hand beside others where it presses, if there is so much; else none [m]."""
Offset = tuple[float, float, float]
"""[m]"""


class StepOf(NamedTuple):
    """A step of the order."""

    block: int
    """Index of the piece."""
    remove: bool = False
    beside: Offset | None = None
    """How far from its place it is put: it is part of a piece of the structure that is built
    beside, on the table."""
    group: tuple[int, ...] = ()
    """The other blocks of such a piece, which it brings along to their places."""

    @property
    def plain(self) -> StepOf:
        """The step of a plan, which does not know where its blocks are built."""
        return StepOf(self.block, self.remove)


@dataclass(frozen=True)
class Workcell:
    """How an arm builds."""

    arm: str
    tool: str = "suction"
    site: Site = dataclasses.field(default_factory=Site)
    physics: str = "dynamic"
    seed: int = 0
    noise: Noise | tuple[float, float] = (0.0, 0.0)
    """Of readings in a simulation: a :class:`Noise`, or its first two fields."""
    disturbance: Disturbance | None = None
    """What goes otherwise than planned in a simulation."""
    touch: bool = True
    """Whether the arm learns from what its tool touches where it holds a block."""
    hands: bool = False
    """Props that the arm cannot place or take away are placed and taken away by hand."""
    log: Path | None = None
    """What is appended to after every attempt; where it exists, the build goes on from it."""

    @property
    def simulated(self) -> Simulated:
        """The simulated plant that belongs to it."""
        disturbance = self.disturbance or Disturbance()
        noise = self.noise if isinstance(self.noise, Noise) else Noise(*self.noise)
        return Simulated(self.physics, self.seed, noise, disturbance)


@dataclass(frozen=True, eq=False)
class Job:
    """What is to be built, by whom and from what."""

    pieces: tuple[Piece, ...]
    steps: tuple[StepOf, ...]
    """As the exact plan orders them."""
    assembly: Assembly
    arm: Arm
    sources: tuple[Source, ...]
    obstacles: tuple[Obstacle, ...] = ()
    friction: float = 0.5
    joint: float = 1e-4
    """Width of a vertical joint [m]."""
    hands: bool = False
    """Props that the arm cannot place or take away are placed and taken away by hand."""

    @property
    def base(self) -> np.ndarray:
        """float64[2] of the arm [m]."""
        return self.arm.base_position[:2]


def job_of(plan: Plan, arm: str, joint: float, hands: bool = False) -> Job:
    """What a complete plan asks of an arm.

    Args:
        hands: whether props may be placed and taken away by hand.

    Raises:
        InputError: for steps that hold a block, and for blocks of too many convex parts.
    """
    assert plan.assembly is not None
    holds = sum(step.action == "hold" for step in plan.steps)
    if holds:
        expected = "a plan without holds; one arm has one hand"
        raise InputError("steps that hold a block", holds, expected)
    steps = tuple(StepOf(step.block, step.action == "remove") for step in plan.steps)
    placed = {step.block for step in steps}
    kept = [k for k in range(len(plan.assembly.blocks)) if k in placed]
    if len(kept) < len(plan.assembly.blocks):
        raise InputError("design", "blocks that stand before the first step", "none, for an arm")
    return Job(
        pieces_of(plan.assembly),
        steps,
        plan.assembly,
        get_arm(arm),
        (),
        friction=plan.assembly.friction,
        joint=joint,
        hands=hands,
    )


# ---------------------------------------------------------------- where everything is


STOCK, STANDING, LOOSE, LOST, RETURNED, MISSING = range(6)
"""A block waits in a magazine, stands in the structure, lies elsewhere where the arm may take it,
lies where it cannot, is a prop that has been returned, or is not seen any more."""


class WorkcellBlocks:
    """Where all blocks are believed to be, and in which state.

    Args:
        job: its pieces, to which replacements may be added.
    """

    def __init__(self, job: Job) -> None:
        self.job, self.pieces = job, list(job.pieces)
        count = len(self.pieces)
        self.names = [piece.id for piece in self.pieces]
        """What the blocks are called that the pieces are now."""
        self.pose = np.zeros((count, 7))
        """float64[N, 7]: position [m] and quaternion (w, x, y, z) of the frame of its shape, as it
        is believed."""
        self.spread = np.zeros((count, 2))
        """float64[N, 2]: standard deviations of where they are [m] and of how they are turned
        [rad], each along the axis where it is largest."""
        self.table = np.zeros(3)
        """float64[3]: how the table is believed to be: its height at the origin [m], and by how
        much it leans about x and y [rad]."""
        self.state = [STOCK] * count
        self.source: list[int | None] = [None] * count
        """Where each is taken from."""
        self.used = [0] * len(job.sources)
        self.beside = np.zeros((count, 3))
        """float64[N, 3]: how far from its place each is to stand now [m], see
        :attr:`StepOf.beside`."""
        self.home: set[tuple[int, int]] = set()
        """Joints of studs that are pressed home: their lower and upper piece, -1 for the ground."""
        for n, source in enumerate(job.sources):
            if source.magazine:
                continue
            piece = next(
                (
                    k
                    for k, p in enumerate(self.pieces)
                    if source.presents(p) and self.source[k] is None
                ),
                None,
            )
            if piece is not None:
                self.source[piece], self.state[piece] = n, LOOSE
                self.pose[piece] = self.presented(piece, n)
        for k in range(count):
            if self.state[k] == STOCK:
                self.hide(k)

    def add(self, piece: int) -> int:
        """A further block like ``piece``, in stock; its number. The one that ``piece`` was keeps
        its name, and ``piece`` gets a new one."""
        kind = self.pieces[piece].id
        self.pieces.append(self.pieces[piece])
        self.names.append(self.names[piece])
        self.names[piece] = f"{kind}/{len(self.pieces)}"
        self.pose = np.vstack([self.pose, self.pose[piece]])
        self.spread = np.vstack([self.spread, self.spread[piece]])
        self.beside = np.vstack([self.beside, np.zeros(3)])
        self.state.append(STOCK)
        self.source.append(None)
        self.hide(len(self.pieces) - 1)
        return len(self.pieces) - 1

    @property
    def placing(self) -> float:
        """Standard deviation of where a block will stand that is placed next [m]."""
        return PLACED if self.spread.any() else 0.0

    def presented(self, piece: int, source: int) -> np.ndarray:
        """float64[7]: the pose at which a source presents a block."""
        return self.pieces[piece].waiting(self.job.sources[source].pose)

    def resting(self, piece: int) -> np.ndarray:
        """float64[7]: where a block lies, on the face on which it waits or stands where it seems to
        lean by no more than :data:`SEEMS_FLAT`: it rests on it, and a tool that takes it lies flush."""
        pose, one = self.pose[piece].copy(), self.pieces[piece]
        now, up = quaternion_matrix(pose[3:]), on_table(self.table, np.array([0.0, 0.0, 1.0]))
        up -= [0.0, 0.0, self.table[0]]
        for turn in (one.rest, one.turn):
            across = np.cross(now @ turn[2], up)
            if np.linalg.norm(across) < SEEMS_FLAT and now @ turn[2] @ up > 0:
                pose[3:] = matrix_quaternion(rotation_of(across) @ now)
                break
        return pose

    def hide(self, piece: int) -> None:
        """The block lies in its magazine, under the table, or is kept elsewhere."""
        source, one = self.magazine(piece), self.pieces[piece]
        pose = self.target(piece) if source is None else self.presented(piece, source)
        pose[2] -= HIDDEN + float(one.corners(pose)[:, 2].max())
        self.pose[piece] = pose

    def magazine(self, piece: int) -> int | None:
        """The magazine of its shape, if there is one."""
        shape = self.pieces[piece].shape
        return next(
            (n for n, s in enumerate(self.job.sources) if s.magazine and s.shape == shape), None
        )

    def drawn(self, piece: int) -> np.ndarray:
        """float64[7]: the pose it has in the finished structure, or beside it where it is built
        there, on a table that is as it should be."""
        pose = self.pieces[piece].pose.copy()
        pose[:3] += self.beside[piece]
        return pose

    def target(self, piece: int) -> np.ndarray:
        """float64[7]: the pose :meth:`drawn`, on the table as it is believed to be."""
        pose = self.drawn(piece)
        if not self.table.any():
            return pose
        place, turn = pose[:3], quaternion_matrix(pose[3:])
        place, *axes = on_table(self.table, np.vstack([place, place + turn.T]))
        return np.array([*place, *matrix_quaternion((np.array(axes) - place).T)])

    def together(self, piece: int) -> np.ndarray:
        """bool[N]: which pieces belong to the same part of the structure now: what is built beside
        is apart."""
        return (self.beside == self.beside[piece]).all(1)

    def visible(self) -> list[int]:
        """Blocks that are on the table or in the structure."""
        return [k for k, s in enumerate(self.state) if s in (STANDING, LOOSE, LOST)]

    def cells(self) -> list[tuple[int, ...]]:
        """Cells of every block: its parts, numbered through."""
        out, count = [], 0
        for piece in self.pieces:
            out.append(tuple(range(count, count + len(piece.shape))))
            count += len(piece.shape)
        return out


def on_table(table: np.ndarray, points: np.ndarray) -> np.ndarray:
    """float64[..., 3]: points that are meant on the table of the world, on one that is as
    :attr:`WorkcellBlocks.table` says [m]."""
    lean = rotation_of(np.array([table[1], table[2], 0.0]))
    return points @ lean.T + [0.0, 0.0, table[0]]


class Rows(NamedTuple):
    """A scene and what its rows are."""

    scene: Scene
    owner: np.ndarray
    """int64[n]: piece of each row, -1 for an obstacle."""
    part: np.ndarray
    """int64[n]: number of the part in its piece."""

    def pose(self, piece: int, shape: Shape) -> np.ndarray:
        """float64[7]: of a piece that has a row."""
        row = int(np.flatnonzero(self.owner == piece)[0])
        assert self.scene.quaternion is not None
        turn = self.scene.quaternion[row]
        centre = np.array(shape[self.part[row]].centre)
        return np.array([*(self.scene.position[row] - quaternion_matrix(turn) @ centre), *turn])


def rows_of(
    world: WorkcellBlocks, poses: np.ndarray, moving: int, group: tuple[int, ...] = ()
) -> Rows:
    """The scene in which ``moving`` waits and everything else is in its place.

    Args:
        poses: float64[N, 7] that blocks are taken to have.
        group: blocks that it brings along, as one with it.
    """
    taken = (moving, *group)
    others = [k for k in world.visible() if k not in taken]
    columns: list[tuple[Any, ...]] = []
    for k in [*others, *taken]:
        one = moving if k in taken else k
        piece, turn = world.pieces[k], quaternion_matrix(poses[k, 3:])
        density = piece.density
        for number, part in enumerate(piece.shape):
            place = poses[k, :3] + turn @ np.array(part.centre)
            columns.append((place, poses[k, 3:], one, part.half, part.hull, density, k, number))
    fixed: list[tuple[Any, ...]] = []
    for n, obstacle in enumerate(world.job.obstacles):
        size, number = np.array(obstacle.size) / 2, len(world.pieces) + n
        turn = yaw_quaternion(obstacle.yaw)
        fixed.append((obstacle.middle, turn, number, size, None, OBSTACLE_DENSITY, -1, n))
    columns = fixed + columns
    place, turn, number, half, hull, density, owner, part = zip(*columns, strict=True)
    carried = sum(len(world.pieces[k].shape) for k in taken)
    placed, axes = len(place) - carried, quaternion_matrix(np.array(turn))
    scene = Scene(
        np.array(place, float),
        np.arctan2(axes[:, 1, 0], axes[:, 0, 0]),
        np.array(number, np.int64),
        placed,
        np.array(half, float),
        np.array(density, float),
        np.array(turn),
        hull if any(hull) else None,
        table=(float(world.table[0]), float(world.table[1]), float(world.table[2])),
    )
    return Rows(scene, np.array(owner, np.int64), np.array(part, np.int64))


Direction = tuple[float, float, float]
"""A unit vector."""
DOWN: Direction = (0.0, 0.0, -1.0)
"""The way on which blocks come to their places, if nothing leans."""


def _direction(way: np.ndarray) -> Direction:
    x, y, z = (way.round(9) + 0.0).tolist()
    return x, y, z


def moves(
    world: WorkcellBlocks,
    rows: Rows,
    moving: int,
    goal: np.ndarray,
    into: Sequence[Direction] = (DOWN,),
    press: tuple[float, float] | None = None,
) -> Iterator[Move]:
    """Ways to bring a block to a pose: where it is held, and how the hand turns; cups at the side
    of a tool last, and drawn out only as far as it takes to come out from below others.

    Args:
        rows: the scene, in which the block waits; what it brings along is not turned.
        goal: float64[7]: the pose it shall have.
        into: unit vectors along which it may come there.
        press: where it is pressed home, x and y [m]: the hand that is nearest to it tips it least.
    """
    alone = (rows.scene.object_id == moving).sum() == len(world.pieces[moving].shape)
    piece, arm = world.pieces[moving], world.job.arm
    now = quaternion_matrix(rows.pose(moving, piece.shape)[3:])
    wanted = quaternion_matrix(goal[3:])
    mine = np.flatnonzero(rows.owner == moving)
    of_part = dict(zip(rows.part[mine].tolist(), mine.tolist(), strict=True))
    goals = [wanted @ turn for turn in piece.turns()]
    if not alone:
        goals = [goal for goal in goals if np.trace(now.T @ goal) > 1 + 2 * math.cos(FLAT)]
    ways = ways_to_turn(arm, piece.shape, now, goals)
    if press is not None:
        at = {id(way): goal[:2] + (way.goal @ np.array(way.hold.point))[:2] for way in ways}
        ways.sort(key=lambda way: round(math.dist(at[id(way)], press), 3))
    for way in ways:
        centre = np.array(piece.shape[way.hold.part].centre)
        grasp = attitude(way.hold, centre, now, way.grasp)
        place = facing(way.place)._replace(depth=grasp.depth, lip=grasp.lip, aside=grasp.aside)
        if grasp.sideways:
            far = way_out(rows, mine, -grasp.approach())
            if far is None:
                continue
            grasp = grasp._replace(way=far)
        target = goal[:3] + way.goal @ centre
        # What leans on others comes off them straight up, if not along its own axis.
        lifts = (
            (grasp, grasp._replace(into=DOWN)) if grasp.tilt and not grasp.sideways else (grasp,)
        )
        for lift, one in itertools.product(lifts, into):
            apart = np.abs(place.insertion() - one).max() > 1e-9
            there = place._replace(into=one) if apart else place
            yield Move(of_part[way.hold.part], target, lift, there)


def way_out(rows: Rows, mine: np.ndarray, way: np.ndarray) -> float | None:
    """How far blocks have to be drawn out until nothing is above them any more.

    Args:
        rows: the scene.
        mine: int64[m], its rows that are moved.
        way: float64[3], a level unit vector.

    Returns:
        [m]; None where it is farther than :data:`FARTHEST_OUT`.
    """
    low, high = rows.scene.bounds()
    others = np.setdiff1d(np.arange(len(low)), mine)
    covered = others[high[others, 2] > high[mine, 2].max() + 1e-3]
    for far in np.arange(WAY, FARTHEST_OUT, 0.01).tolist():
        a, b = (side[mine, :2] + far * way[:2] for side in (low, high))
        apart = np.minimum(b[:, None], high[covered, :2]) - np.maximum(a[:, None], low[covered, :2])
        if not (apart > -OUT_ROOM).all(2).any():
            return round(far, 3)
    return None


# ---------------------------------------------------------------- the order


@dataclass(frozen=True)
class Arranged:
    """An order the arm can carry out, or why there is none."""

    steps: tuple[StepOf, ...]
    stuck: dict[int, str]
    """By piece, why it cannot be placed or taken away; empty where the order is complete."""
    by_hand: frozenset[StepOf] = frozenset()
    """Steps that the arm cannot do."""


class Structure:
    """What rests on what, and whether a state stands.

    Args:
        job: its assembly is proven.
    """

    def __init__(self, job: Job) -> None:
        from learn2assemble.assembly.contacts import add_point_contacts, find_contacts
        from learn2assemble.statics.rigid_blocks import bed_patches

        self.job, self.contacts = job, find_contacts(job.assembly)
        self.lying = self.contacts.only(bed_patches(self.contacts))
        count = len(job.pieces)
        self.below: list[set[int]] = [set() for _ in range(count)]
        self.above: list[set[int]] = [set() for _ in range(count)]
        lying = self.lying
        for a, b, normal in zip(lying.a.tolist(), lying.b.tolist(), lying.normal, strict=True):
            self._rests(a, b, float(normal[2]))
        self.leans = self._leaning()
        last = {step.block for step in job.steps} - {
            step.block for step in job.steps if step.remove
        }
        if self._pressing(frozenset(last)) is None:
            # Edges and points carry.
            self.contacts, _ = add_point_contacts(job.assembly, self.contacts)
            self._leaning()
            self.leans = True
        standing: set[int] = set()
        self._proven = {frozenset(standing)}
        for step in job.steps:
            standing = standing - {step.block} if step.remove else standing | {step.block}
            self._proven.add(frozenset(standing))

    def _rests(self, a: int, b: int, up: float) -> None:
        """A block, a or b, rests on the other one; ``up`` is the normal towards b."""
        lower, upper = (a, b) if up > 0 else (b, a)
        if upper >= 0 and lower >= 0:
            self.below[upper].add(lower)
            self.above[lower].add(upper)

    def _leaning(self) -> bool:
        """Take up what leans on what, where joints lean: in the order of the steps, as what leans
        on two others is placed when both are there; whether any does."""
        place = {step.block: n for n, step in enumerate(self.job.steps) if not step.remove}
        ends = zip(self.contacts.a.tolist(), self.contacts.b.tolist(), strict=True)
        found = False
        for (a, b), normal in zip(ends, self.contacts.normal, strict=True):
            steep = abs(float(normal[2]))
            if not LEANING < steep < 1 - LEANING:
                continue
            found = True
            lower, upper = (a, b) if normal[2] > 0 else (b, a)
            if upper >= 0 and lower >= 0 and place.get(lower, 0) < place.get(upper, 0):
                self._rests(a, b, float(normal[2]))
        return found

    def ways_in(self, block: int, standing: set[int]) -> tuple[Direction, ...]:
        """Unit vectors along which a block may come to its place, the best ones first: straight
        down, or at right angles to the joints on which it comes to lean where these are steep;
        where blocks lean also others that lead away from all it touches."""
        if not self.leans:
            return (DOWN,)
        faces = self.contacts
        touched = [
            normal if b == block else -normal
            for a, b, normal in zip(faces.a.tolist(), faces.b.tolist(), faces.normal, strict=True)
            if block in (a, b) and (a if b == block else b) in {*standing, -1}
        ]
        carried = [normal for normal in touched if normal[2] > LEANING]
        if not carried:
            return (DOWN,)
        normals, up = np.array(touched), np.array([0.0, 0.0, 1.0])
        mean = np.sum(carried, axis=0)
        best = [mean / np.linalg.norm(mean), up]
        if min(float(normal[2]) for normal in carried) > STEEP_JOINT:
            best.reverse()
        best = [way for way in best if way is up or (normals @ way).min() > -1e-6]
        others = ways_out(normals)
        others = others[others[:, 2] > LOW_WAY]
        room = (others @ normals.T).min(1)
        best += list(others[np.argsort(-room, kind="stable")[:MORE_WAYS]])
        return tuple(_direction(-way) for way in best)

    def stands(self, standing: frozenset[int]) -> bool:
        """Whether these pieces stand without the others, by the proof of the plan or another."""
        if standing not in self._proven and self._pressing(standing) is not None:
            self._proven.add(standing)
        return standing in self._proven

    def proof(self, standing: frozenset[int]) -> tuple[str, float] | None:
        """What shows that these pieces stand without the others, and the sideways acceleration
        in every direction [g] that they withstand; None where nothing shows it."""
        from learn2assemble.statics.rigid_blocks import margin

        pressing = self._pressing(standing)
        if pressing is None:
            return None
        present = self._present(standing)
        worth = margin(self.job.assembly, pressing, self.job.friction, present=present)
        return BED if pressing is self.lying else TIGHT, worth

    def _pressing(self, standing: frozenset[int]) -> Contacts | None:
        """The joints whose forces can hold these pieces: horizontal ones alone, or all."""
        from learn2assemble.statics.rigid_blocks import solve

        present = self._present(standing)
        for contacts in (self.lying, self.contacts):
            if solve(self.job.assembly, contacts, self.job.friction, present=present).stands:
                return contacts
        return None

    def _present(self, standing: frozenset[int]) -> np.ndarray:
        present = np.zeros(len(self.job.pieces), bool)
        present[list(standing)] = True
        return present

    def joints_of(
        self, world: WorkcellBlocks, rows: Rows, placing: bool, group: tuple[int, ...] = ()
    ) -> Studs | None:
        """The joints of studs of a scene, in its rows; None: there are no studs."""
        return None

    def studs(self) -> Studs | None:
        """All joints of studs, whose cells are pieces; None: there are none."""
        return None

    def loose(self, block: int, world: WorkcellBlocks) -> bool:
        """Whether a block in its place is not pressed home."""
        return False

    def press_at(
        self, block: int, group: tuple[int, ...], standing: set[int]
    ) -> tuple[float, float] | None:
        """Where a block that comes to its place, perhaps with others, is pressed home, x and y from
        its own middle [m]; None: it is not pressed."""
        return None

    def loads(self, block: int, standing: set[int]) -> list[int]:
        """Pieces among ``standing`` that rest on a piece, directly or not, the topmost first."""
        found, queue = [], [block]
        for one in queue:
            for upper in sorted(self.above[one] & standing):
                if upper not in found:
                    found.append(upper)
                    queue.append(upper)
        return sorted(found, key=lambda k: -self.job.pieces[k].target[2])


def segments(steps: Sequence[StepOf]) -> list[list[StepOf]]:
    """The steps cut where a block is taken away: only placements of one part change places."""
    return [list(group) for _, group in itertools.groupby(steps, key=lambda step: step.remove)]


def priorities(job: Job, leans: bool) -> list[Callable[[int], tuple[float, ...]]]:
    """Which block comes first where several could; tried one after the other.

    Args:
        leans: the blocks lean on one another, and what stands is a matter of the whole order.
    """
    place = {step.block: n for n, step in enumerate(job.steps) if not step.remove}

    def level(k: int) -> float:
        return round(float(job.pieces[k].extent[0][2]), 4)

    def away(k: int) -> float:
        return round(float(np.linalg.norm(job.pieces[k].target[:2] - job.base)), 4)

    def as_planned(k: int) -> tuple[float, ...]:
        return (float(place[k]),)

    if leans:
        return [as_planned]
    return [
        lambda k: (level(k), -away(k)),
        lambda k: (level(k), float(place[k])),
        lambda k: (level(k), away(k)),
        as_planned,
    ]


def arrange(
    job: Job, structure: Structure, cell: KinematicCell, progress: Progress = lambda text: None
) -> Arranged:
    """The first order in which the arm reaches everything; else the one that comes farthest."""
    best: Arranged | None = None
    for key in priorities(job, structure.leans):
        found = _arrange(job, structure, cell, key, progress)
        if best is None or len(found.steps) > len(best.steps):
            best = found
        if not found.stuck or job.arm.suction is not None:
            break
    assert best is not None
    return best


def _arrange(
    job: Job,
    structure: Structure,
    cell: KinematicCell,
    key: Callable[[int], Any],
    progress: Progress,
) -> Arranged:
    world = WorkcellBlocks(job)
    standing: set[int] = set()
    order: list[StepOf] = []
    by_hand: set[StepOf] = set()
    for part in segments(job.steps):
        left = part if part[0].remove else sorted(part, key=lambda step: key(step.block))
        while left:
            stuck: dict[int, str] = {}
            for step in left:
                if not step.remove and not structure.below[step.block] <= standing:
                    continue
                after = standing - {step.block} if step.remove else standing | {step.block}
                if not structure.stands(frozenset(after)):
                    stuck.setdefault(step.block, "it would fall")
                    continue
                why = try_step(world, cell, step, structure.ways_in(step.block, standing))
                if why is None:
                    break
                if job.hands and job.pieces[step.block].prop:
                    by_hand.add(step)
                    break
                stuck[step.block] = why
                if step.remove:
                    return Arranged(tuple(order), stuck, frozenset(by_hand))
            else:
                missing = {s.block: "what it stands on is missing" for s in left}
                return Arranged(tuple(order), missing | stuck, frozenset(by_hand))
            left.remove(step)
            order.append(step)
            standing = after
            world.pose[step.block] = world.target(step.block)
            world.state[step.block] = RETURNED if step.remove else STANDING
            if len(order) % 20 == 0:
                progress(f"an order the arm can reach: step {len(order)} of {len(job.steps)}")
    return Arranged(tuple(order), {}, frozenset(by_hand))


def try_step(
    world: WorkcellBlocks,
    cell: KinematicCell,
    step: StepOf,
    into: Sequence[Direction] = (DOWN,),
    press: tuple[float, float] | None = None,
) -> str | None:
    """Why the arm cannot do a step in a world where everything is as planned; None if it can.

    Args:
        into: unit vectors along which the block may come to its place.
        press: see :func:`moves`.
    """
    k = step.block
    before = world.pose[k].copy()
    try:
        why, supplied = "", False
        for at, goal in _ends(world, step):
            supplied = True
            if at is not None:
                world.pose[k] = at
            rows = rows_of(world, world.pose, k, group=step.group)
            for move in moves(world, rows, k, goal, (DOWN,) if step.remove else into, press):
                found = cell.attempt(rows.scene, move)
                if found.reached:
                    return None
                why = why or named(describe(found), rows, world)
        return why or ("the tool cannot hold it" if supplied else "no supply")
    finally:
        world.pose[k] = before


def _ends(world: WorkcellBlocks, step: StepOf) -> Iterator[tuple[np.ndarray | None, np.ndarray]]:
    """Where the block of a step may come from, None for where it stands, and where it goes."""
    k = step.block
    if step.group:
        yield None, world.pieces[k].pose
        return
    for source in supply_of(world, k):
        at = world.presented(k, source)
        yield (None, at) if step.remove else (at, world.target(k))


def describe(found: Attempt) -> str:
    """Outcome, stage and reason of an attempt that failed, in words."""
    return f"{found.outcome.label} ({found.stage}): {found.detail}"


def named(text: str, rows: Rows, world: WorkcellBlocks) -> str:
    """Words of a cell, which counts the rows of its scene, with the names of the plan."""

    def name(found: re.Match[str]) -> str:
        row = int(found[1])
        owner = int(rows.owner[row]) if row < len(rows.owner) else -1
        return world.pieces[owner].id if owner >= 0 else "an obstacle"

    return re.sub(r"block (\d+)", name, text)


def supply_of(world: WorkcellBlocks, k: int) -> list[int]:
    """Sources a block can come from; for a prop, those it may return to."""
    if world.source[k] is not None:
        return [n for n in (world.source[k],) if n is not None]
    shape = world.pieces[k].shape
    return [
        n
        for n, source in enumerate(world.job.sources)
        if source.magazine
        and source.shape == shape
        and (source.left is None or world.used[n] < source.left)
    ]
