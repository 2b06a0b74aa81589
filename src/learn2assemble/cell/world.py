"""Where the blocks of a cell are believed to be, and the scenes and moves that follow from it."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from learn2assemble.cell.workcell import DOWN, Direction, Job
from learn2assemble.geometry.hulls import Hull
from learn2assemble.geometry.rotations import (
    matrix_quaternion,
    quaternion_matrix,
    rotation_of,
    yaw_quaternion,
)
from learn2assemble.robot.bodies import Shape
from learn2assemble.robot.grasps import WAY, facing
from learn2assemble.robot.holding import Way, attitude, ways_to_turn
from learn2assemble.robot.moves import ARM_THERE, Move, Scene
from learn2assemble.values import three

if TYPE_CHECKING:
    from learn2assemble.cell.pieces import Piece
    from learn2assemble.robot.arm import Arm

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
UPRIGHT = 0.999
"""What comes to its place along a way that is steeper (sine) comes from above."""
PLACED = 1.5e-4
"""Standard deviation of where blocks come to stand where readings are not exact [m]."""
STOCK, STANDING, LOOSE, LOST, RETURNED, MISSING = range(6)
"""A block waits in a magazine, stands in the structure, lies elsewhere where the arm may take it,
lies where it cannot, is a prop that has been returned, or is not seen any more."""


class WorkcellBlocks:
    """Where all blocks are believed to be, and in which state.

    Args:
        job: its pieces, to which replacements may be added.
    """

    job: Job
    pieces: list[Piece]

    def __init__(self, job: Job) -> None:
        self.job, self.pieces = job, list(job.pieces)
        count = len(self.pieces)
        self.names: list[str] = [piece.id for piece in self.pieces]
        """What the blocks are called that the pieces are now."""
        self.pose: np.ndarray = np.zeros((count, 7))
        """float64[N, 7]: position [m] and quaternion (w, x, y, z) of the frame of its shape, as it
        is believed."""
        self.spread: np.ndarray = np.zeros((count, 2))
        """float64[N, 2]: standard deviations of where they are [m] and of how they are turned
        [rad], each along the axis where it is largest."""
        self.table: np.ndarray = np.zeros(3)
        """float64[3]: how the table is believed to be: its height at the origin [m], and by how
        much it leans about x and y [rad]."""
        self.state: list[int] = [STOCK] * count
        self.source: list[int | None] = [None] * count
        """Where each is taken from."""
        self.used: list[int] = [0] * len(job.sources)
        self.beside: np.ndarray = np.zeros((count, 3))
        """float64[N, 3]: how far from its place each is to stand now [m], see
        :attr:`StepOf.beside`."""
        self.arm: tuple[tuple[np.ndarray, np.ndarray, Hull], ...] = ()
        """Where another arm stands: poses float64[7], half extents float64[3] [m] and hulls of
        solids around it, which nothing may touch."""
        self.home: set[tuple[int, int]] = set()
        """Joints of studs that are pressed home: their lower and upper piece, -1 for the ground."""
        for n, source in enumerate(job.sources):
            if source.magazine:
                continue
            piece = next(
                (
                    k
                    for k, p in enumerate(self.pieces)
                    if source.presents(p) and self.source[k] is None and k not in job.there
                ),
                None,
            )
            if piece is not None:
                self.source[piece], self.state[piece] = n, LOOSE
                self.pose[piece] = self.presented(piece, n)
        for k in job.there:
            self.state[k], self.pose[k] = STANDING, self.target(k)
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
        """float64[7]: where a block lies. Where it seems to lean by no more than
        :data:`SEEMS_FLAT`, it rests on the face on which it waits or stands, and a tool that takes
        it lies flush."""
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
        """The first magazine of its shape, if there is one."""
        return next(iter(self.magazines(piece)), None)

    def magazines(self, piece: int) -> list[int]:
        """All magazines of its shape, empty ones too."""
        shape = self.pieces[piece].shape
        return [n for n, s in enumerate(self.job.sources) if s.magazine and s.shape == shape]

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
        out, count = list[tuple[int, ...]](), 0
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
        centre = np.array(shape[int(self.part[row])].centre)
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
    others = [k for k in world.visible() if not (k in taken or world.pieces[k].sunk)]
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
    for n, (pose, size, solid) in enumerate(world.arm, len(fixed)):
        number = len(world.pieces) + n
        fixed.append((pose[:3], pose[3:], number, size, solid, OBSTACLE_DENSITY, -1, n))
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
        aside=_aside(world, len(place)),
    )
    return Rows(scene, np.array(owner, np.int64), np.array(part, np.int64))


def _aside(world: WorkcellBlocks, count: int) -> np.ndarray | None:
    """See :attr:`~learn2assemble.robot.moves.Scene.aside`: another arm, and what that takes.

    Args:
        count: of the rows of the scene, of which obstacles are the first ones.
    """
    found, fixed = np.zeros(count, np.int8), world.job.obstacles
    found[: len(fixed)] = [one.aside for one in fixed]
    found[len(fixed) : len(fixed) + len(world.arm)] = ARM_THERE
    return found if found.any() else None


def direction_of(way: np.ndarray) -> Direction:
    return three((way.round(9) + 0.0).tolist())


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
    socket = arm.suction is not None and arm.suction.studs
    if press is not None or socket:
        at = {id(way): goal[:2] + (way.goal @ np.array(way.hold.point))[:2] for way in ways}
        beside = {id(way): round(math.dist(at[id(way)], press or at[id(way)]), 3) for way in ways}
        # Of those as near to it, first what turns the wrist less: the brick the other way round.
        here = np.array(rows.pose(moving, piece.shape)[:2])
        wrist = {id(way): _wrist_turn(arm, way, here, goal[:2]) for way in ways if socket}
        ways.sort(key=lambda way: (beside[id(way)], wrist.get(id(way), 0.0)))
        if press is not None:
            ways = [way for way in ways if _bears(world, way, at[id(way)], press)]
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
            if apart and -one[2] < UPRIGHT:
                # What leans over its place is above it until it is drawn out of that.
                corners = [goal[:3] + part.points @ way.goal.T for part in piece.shape]
                far = way_out(rows, mine, -np.array(one), np.vstack(corners))
                there = there._replace(way=max(far or 0.0, there.way))
            yield Move(of_part[way.hold.part], target, lift, there)


def _wrist_turn(arm: Arm, way: Way, here: np.ndarray, there: np.ndarray) -> float:
    """By about how much the last joint turns between a brick that lies at one place, float64[2],
    and another one to which it comes [m]: [rad], to a tenth."""
    angles: list[float] = []
    for place, tool in ((here, way.grasp), (there, way.place)):
        x, y = (place - arm.base_position[:2]).tolist()
        angles.append(math.atan2(tool[1, 0], tool[0, 0]) - math.atan2(y, x))
    return round(abs(math.remainder(angles[1] - angles[0], math.tau)), 1)


def _bears(world: WorkcellBlocks, way: Way, at: np.ndarray, press: tuple[float, float]) -> bool:
    """Whether a hand at a place float64[2] [m] can press a brick home elsewhere: a socket that is
    too far beside would tip off it."""
    suction = world.job.arm.suction
    if suction is None:
        return True
    socket, turn = suction.cups[0], way.place[:2, :2]
    x, y = (turn.T @ (np.array(press) - at)).tolist()
    return socket.presses((x, y), world.job.assembly.joint.press)


def way_out(
    rows: Rows, mine: np.ndarray, way: np.ndarray, corners: np.ndarray | None = None
) -> float | None:
    """How far blocks have to be drawn out until nothing is above them any more.

    Args:
        rows: the scene.
        mine: int64[m], its rows that are moved.
        way: float64[3], a unit vector.
        corners: float64[k, 3], of where they are drawn out from [m]; by default where they are.

    Returns:
        [m]; None where it is farther than :data:`FARTHEST_OUT`.
    """
    low, high = rows.scene.bounds()
    others = np.setdiff1d(np.arange(len(low)), mine)
    lows, highs = low[mine], high[mine]
    if corners is not None:
        lows, highs = corners.min(0)[None], corners.max(0)[None]
    covered = others[high[others, 2] > highs[:, 2].max() + 1e-3]
    for far in np.arange(WAY, FARTHEST_OUT, 0.01).tolist():
        a, b = (side[:, :2] + far * way[:2] for side in (lows, highs))
        apart = np.minimum(b[:, None], high[covered, :2]) - np.maximum(a[:, None], low[covered, :2])
        if not (apart > -OUT_ROOM).all(2).any():
            return round(far, 3)
    return None


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
    left = [source.left for source in world.job.sources]
    there = zip(left, world.used, strict=True)
    some = [count is None or used < count for count, used in there]
    return [n for n in world.magazines(k) if some[n]]
