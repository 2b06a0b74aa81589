"""Pick and place as every robot cell sees it: grasps, scenes, moves, and what came of them.

    home - above the block - down, close, up - across - down, open, up - home

Down and up follow the approach axis of the hand near the block, then the vertical.
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from learn2assemble.constants import EDGE, GRAVITY, HALF, MASS
from learn2assemble.geometry.hulls import Hull
from learn2assemble.geometry.rotations import (
    matrix_quaternion,
    quaternion_matrix,
    yaw_matrix,
    yaw_quaternion,
)
from learn2assemble.robot.bodies import Part
from learn2assemble.robot.grasps import Attitude
from learn2assemble.robot.holding import ROOM, why_not_held
from learn2assemble.robot.studs import Studs

if TYPE_CHECKING:
    from learn2assemble.robot.arm import Arm


class Outcome(IntEnum):
    """Result of one pick and place; stored as int8. Everything but ``REACHED`` is a failure."""

    REACHED = 0
    """The block stands where it should and nothing else moved."""
    UNREACHABLE = 1
    """No joint configuration for a pose on the way (:class:`~.inverse.IKFailure` says why)."""
    GRASP_COLLISION = 2
    """Something is touched while approaching, grasping or lifting."""
    PLACE_COLLISION = 3
    """Something is touched by arm or held object on the way, while placing or retreating."""
    GRASP_LOST = 4
    """The fingers closed on nothing, or the block slipped out before it was lifted."""
    DISTURBED_STRUCTURE = 5
    """A block that was there before has moved."""
    TOPPLED = 6
    """The placed object did not stay where it was released."""
    DROPPED = 7
    """The block left the hand between lifting and release."""
    NO_CONTACT = 8
    """What was lowered met nothing at its place, and went back."""
    STOPPED = 9
    """The arm was stopped, by a rule of the layout or by itself, before it had taken the block."""

    @property
    def label(self) -> str:
        """The name as it is shown, e.g. ``"grasp-collision"``."""
        return self.name.lower().replace("_", "-")


DENSITY = MASS / EDGE**3
"""Of the cubes [kg/m3]."""
IMMOVABLE = 20_000.0
"""What is as dense as this is an obstacle that nothing moves [kg/m3]."""
GAP = 0.01
"""Between horizontal neighbours on the lattice of the robot cell [m]."""


LEVEL_TABLE = (0.0, 0.0, 0.0)
"""A table as it should be, see :attr:`Scene.table`."""


AT_THE_SIDE, BASE_THERE, ARM_THERE = 1, 2, 3
"""Of an obstacle: ways lead past it unless it is between both ends of one; it is the base of an
arm, or a part of one that stands there, and ways lead past it wherever it is."""


class Scene(NamedTuple):
    """Convex solids on the table, in the world frame; the placed ones first.

    Each cell is one solid: a cube of the lattice, or, where ``half`` is given, a box of any size or
    the hull that is given for it. Objects of several cells are rigid. Where two cubes of one object
    are horizontal neighbours the gap between them is filled; all else is what it is.
    """

    position: np.ndarray
    """float64[n, 3]: cell centres [m]."""
    yaw: np.ndarray
    """float64[n]: rotation of each cell about z [rad]."""
    object_id: np.ndarray
    """int64[n]: cells with one number are one rigid object."""
    num_placed: int
    half: np.ndarray | None = None
    """float64[n, 3]: half extents of each cell's box in its own frame [m]; None: all are cubes of
    the lattice."""
    density: np.ndarray | None = None
    """float64[n] of each cell [kg/m3]; by default that of the cubes. From :data:`IMMOVABLE` on it
    is an obstacle."""
    quaternion: np.ndarray | None = None
    """float64[n, 4]: orientations (w, x, y, z); None: all stand upright at their yaw."""
    hull: tuple[Hull | None, ...] | None = None
    """Of each cell about its centre, where it is no box; None: all are boxes."""
    studs: Studs | None = None
    """Joints of studs between its cells, in a simulation; None: they only lie on one another."""
    table: tuple[float, float, float] = LEVEL_TABLE
    """How high the table is at the origin [m], and by how much it leans about x and y [rad]."""
    aside: np.ndarray | None = None
    """int8[n]: :data:`AT_THE_SIDE`, :data:`BASE_THERE` or :data:`ARM_THERE` of obstacles that ways
    lead past, not above, 0 of all else; None: there are none of these."""

    @property
    def halves(self) -> np.ndarray:
        """float64[n, 3]: half extents of each cell's box [m]."""
        return np.full((len(self.position), 3), HALF) if self.half is None else self.half

    @property
    def orientation(self) -> np.ndarray:
        """float64[n, 4]: quaternions (w, x, y, z)."""
        return yaw_quaternion(self.yaw) if self.quaternion is None else self.quaternion

    def solid(self, cell: int) -> Hull:
        """A cell as a polyhedron about its centre."""
        return self.part(cell).solid

    def part(self, cell: int) -> Part:
        """A cell by itself."""
        x, y, z = self.halves[cell].tolist()
        return Part((0.0, 0.0, 0.0), (x, y, z), None if self.hull is None else self.hull[cell])

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest coordinates of every cell, float64[n, 3] each [m]."""
        turn = quaternion_matrix(self.orientation)
        reach = np.einsum("nij,nj->ni", np.abs(turn), self.halves)
        low, high = self.position - reach, self.position + reach
        for k, hull in enumerate(self.hull or ()):
            if hull is not None:
                points = self.position[k] + hull.points @ turn[k].T
                low[k], high[k] = points.min(0), points.max(0)
        return low, high

    def mass(self, cells: np.ndarray) -> np.ndarray:
        """float64[m]: of cells int64[m] without the fillers between them [kg]."""
        volume = 8 * self.halves[cells].prod(1)
        for k, cell in enumerate(cells.tolist() if self.hull else ()):
            hull = self.hull[cell] if self.hull else None
            volume[k] = volume[k] if hull is None else hull.volume
        return volume * (DENSITY if self.density is None else self.density[cells])

    def rows(self, cells: np.ndarray, num_placed: int) -> Scene:
        """The scene of some cells int64[m], of which the first ``num_placed`` are placed."""
        half, density, turn, aside = (
            None if a is None else a[cells]
            for a in (self.half, self.density, self.quaternion, self.aside)
        )
        kept: list[int] = cells.tolist()
        hull = None if self.hull is None else tuple(self.hull[k] for k in kept)
        return Scene(
            self.position[cells],
            self.yaw[cells],
            self.object_id[cells],
            num_placed,
            half,
            density,
            turn,
            hull,
            aside=aside,
        )

    def members(self, cell: int) -> np.ndarray:
        """int64[m]: the cells of the object of ``cell``, that cell first."""
        others = np.flatnonzero(self.object_id == self.object_id[cell])
        return np.concatenate([[cell], others[others != cell]])


class Move(NamedTuple):
    """Pick up the object of a waiting cell and put that cell somewhere else."""

    cell: int
    """Index of the grasped cell in the scene."""
    target: np.ndarray
    """float64[3]: centre the grasped cell shall have [m]."""
    grasp: Attitude
    place: Attitude

    @property
    def turn(self) -> float:
        """Rotation of the object about z between picking and placing, where it is not tilted
        [rad]."""
        return self.place.yaw - self.grasp.yaw

    @property
    def level(self) -> bool:
        """Whether the object is only turned about the vertical."""
        a, b = self.grasp, self.place
        return (a.tilt, a.spin) == (b.tilt, b.spin)

    def rotation(self) -> np.ndarray:
        """float64[3, 3]: of the object between picking and placing."""
        if self.level:
            return yaw_matrix(self.turn)
        return self.place.rotation() @ self.grasp.rotation().T


def turns(arm: Arm, move: Move) -> tuple[float, ...]:
    """Other turns of the hand about its axis [rad] in which it does the same."""
    return () if move.grasp.sideways else arm.turns


def turned(scene: Scene, move: Move, turn: float) -> Move:
    """The same move with the hand turned at both places [rad]: with cubes about the vertical, as
    all their sides are alike, else about its own axis."""
    if scene.half is None:
        grasp, place = (a._replace(yaw=a.yaw + turn) for a in (move.grasp, move.place))
    else:
        grasp, place = move.grasp.spun(turn), move.place.spun(turn)
    return move._replace(grasp=grasp, place=place)


def put_down(scene: Scene, move: Move) -> Scene:
    """The scene after a move that went as ordered: the object's cells are the last placed ones,
    the grasped one first."""
    members = scene.members(move.cell)
    position, quaternion = carried(scene, move, members)
    rest = np.setdiff1d(np.arange(scene.num_placed, len(scene.position)), members)
    order = np.concatenate([np.arange(scene.num_placed), members, rest])
    after = scene.rows(order, scene.num_placed + len(members))
    moved = slice(scene.num_placed, after.num_placed)
    after.position[moved] = position
    after.yaw[moved] += move.turn
    if after.quaternion is not None:
        after.quaternion[moved] = quaternion
    return after


def carried(scene: Scene, move: Move, members: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where a move takes cells of the object: centres float64[m, 3] [m] and quaternions
    float64[m, 4]."""
    offset = scene.position[members] - scene.position[move.cell]
    turn = move.rotation()
    if scene.quaternion is None and move.level:
        quaternion = yaw_quaternion(scene.yaw[members] + move.turn)
    else:
        before = quaternion_matrix(scene.orientation[members])
        quaternion = np.array([matrix_quaternion(turn @ one) for one in before])
    return move.target + offset @ turn.T, quaternion


def fillers(position: np.ndarray, object_id: np.ndarray) -> np.ndarray:
    """Pairs of horizontal neighbours of one object; the gap between them is filled.

    Args:
        position: float64[n, 3] cell centres [m].
        object_id: int64[n].

    Returns:
        int64[f, 2].
    """
    same = object_id[:, None] == object_id
    if same.sum() == len(object_id):
        return np.empty((0, 2), np.int64)
    a, b = np.nonzero(np.triu(same, 1))
    gap = np.abs(position[b] - position[a])
    near = (gap[:, 2] < HALF) & (np.hypot(gap[:, 0], gap[:, 1]) < 3 * HALF)
    return np.stack([a, b], -1)[near]


def object_boxes(
    cells: np.ndarray, half: np.ndarray, filler: float | None = None
) -> list[tuple[np.ndarray, np.ndarray]]:
    """The boxes an object is made of: its cells, then the fillers between them.

    Args:
        cells: float64[n, 3] centres in the object's frame, whose axes are those of the cells [m].
        half: float64[3], half extents of a cell's box [m].
        filler: half thickness of a filler [m]; by default what the boxes leave free.

    Returns:
        centre and half extents of every box [m].
    """
    boxes = [(cell, half) for cell in cells]
    for a, b in fillers(cells, np.zeros(len(cells), np.int64)):
        gap = np.abs(cells[b] - cells[a])
        size, axis = half.copy(), int(np.argmax(gap))
        size[axis] = gap[axis] / 2 - size[axis] if filler is None else filler
        if size[axis] > 0:
            boxes.append(((cells[a] + cells[b]) / 2, size))
    return boxes


OPENING = EDGE + ROOM
"""Between the fingers while they approach a cube [m]."""


def grip_width(scene: Scene, cell: int, grasp: Attitude) -> float:
    """How far apart the pads are when they hold a cell [m]: the distance of the two faces that
    they meet."""
    if scene.half is None:
        return EDGE
    closing = quaternion_matrix(scene.orientation[cell]).T @ grasp.rotation()[:, 1]
    solid = scene.solid(cell)
    along = solid.normals @ closing
    return float(solid.offsets[int(along.argmax())] + solid.offsets[int(along.argmin())])


CLEARANCE = 0.06
"""Between what is carried and everything below it while crossing [m]."""
LEVEL, FINE_LEVEL = 0.05, 0.01
"""Heights of crossing are multiples of this, with cubes and with boxes of given size, so that paths
repeat [m]."""


def crossing_height(
    scene: Scene, move: Move, bounds: tuple[np.ndarray, np.ndarray] | None = None
) -> float:
    """Height of the tool between picking and placing [m].

    What hangs below the grasped cell, and the fingertips, pass above everything else but what
    stands at the side.

    Args:
        bounds: of the scene, where they are known.
    """
    members = scene.members(move.cell)
    counts = np.ones(len(scene.position), bool) if scene.aside is None else ~_passed(scene, move)
    counts[members] = False
    others = np.flatnonzero(counts)
    low, high = scene.bounds() if bounds is None else bounds
    highest = float(np.max(high[others, 2], initial=0.0))
    there, quaternion = carried(scene, move, members)
    placed = scene.rows(members, 0)._replace(position=there, quaternion=quaternion)
    goal = float(placed.bounds()[0][:, 2].min())
    centre = scene.position[move.cell]
    hanging = float(centre[2] - low[members, 2].min())
    if scene.half is None and move.grasp.depth < HALF:
        # The small depths of the hand above the middle of a cube do not count.
        rise, level = hanging, LEVEL
    else:
        rise = float(move.grasp.tool_point(centre)[2]) - float(centre[2]) + hanging
        rise = max(rise, float(move.place.tool_point(move.target)[2]) - goal)
        level = LEVEL if scene.half is None else FINE_LEVEL
    return level * math.ceil((max(highest, goal) + CLEARANCE + rise) / level - 1e-9)


def _passed(scene: Scene, move: Move) -> np.ndarray:
    """bool[n]: what stands at the side and so far from the straight line between both places that
    nothing of what is carried comes above it."""
    assert scene.aside is not None
    start, end = scene.position[move.cell, :2], move.target[:2]
    away, way = scene.position[:, :2] - start, end - start
    share = (away @ way / max(float(way @ way), 1e-12)).clip(0.0, 1.0)
    apart = np.linalg.norm(away - share[:, None] * way, axis=1)
    members = scene.members(move.cell)
    carries = np.linalg.norm(scene.position[members] - scene.position[move.cell], axis=1)
    size = float((carries + np.linalg.norm(scene.halves[members], axis=1)).max())
    room = np.hypot(*scene.halves[:, :2].T) + size + CLEARANCE
    return (scene.aside >= BASE_THERE) | (scene.aside == AT_THE_SIDE) & (apart > room)


def overload(arm: Arm, scene: Scene, move: Move) -> str | None:
    """Why the cup of an arm cannot hold what a move asks for at all, in words; None where it can,
    and for fingers, whose grasp the motion tells."""
    cup, members = arm.suction, scene.members(move.cell)
    if cup is None:
        return None
    mass = scene.mass(members)
    shape, axis = (scene.part(move.cell),), None
    if scene.half is not None:
        axis = quaternion_matrix(scene.orientation[move.cell]).T @ move.grasp.approach()
    why = why_not_held(arm, shape, float(mass.sum()), axis)
    if why is not None:
        return why
    grasp, centre = move.grasp, scene.position[move.cell]
    used = next(one for one in cup.cups if one.lip == grasp.lip)
    tool = grasp.rotation()
    point = grasp.tool_point(centre) + tool @ np.array(grasp.lip.at)
    turn, weight = tool @ used.lip.frame(), np.array([0.0, 0.0, -GRAVITY])
    lever = turn.T @ (mass @ (_middles(scene, members) - point))
    loads = list[tuple[float, float]]()
    for there in (turn, move.place.rotation() @ used.lip.frame()):
        pull = there.T @ weight
        loads.append(used.load(mass.sum() * pull, np.cross(lever, pull)))
    off, slip = (max(share) for share in zip(*loads, strict=True))
    if off > 1:
        return f"its weight is {100 * off:.0f} % of what pulls the cup off"
    return f"its weight is {100 * slip:.0f} % of what the lip carries" if slip > 1 else None


def _middles(scene: Scene, cells: np.ndarray) -> np.ndarray:
    """float64[m, 3]: centres of mass of cells int64[m] [m]."""
    turn = quaternion_matrix(scene.orientation[cells])
    own = np.zeros((len(cells), 3))
    for k, cell in enumerate(cells.tolist() if scene.hull else ()):
        own[k] = scene.solid(cell).centroid
    return scene.position[cells] + np.einsum("nij,nj->ni", turn, own)


STAGES = ("approach", "pick", "lift", "cross", "place", "release", "retreat", "home")
"""Parts of a pick and place, in order; ``retreat`` ends above the target."""


class Trajectory(NamedTuple):
    """Samples of one attempt."""

    time: np.ndarray
    """float64[t]: from the beginning of the attempt [s]."""
    joints: np.ndarray
    """float64[t, n]: commanded [rad]."""
    velocity: np.ndarray
    """float64[t, n]: commanded [rad/s]."""
    width: np.ndarray
    """float64[t]: opening between the pads [m], as it was; 0 for a suction tool."""
    command: np.ndarray
    """float64[t]: opening the gripper was told [m], less than what it holds where it presses; for a
    suction tool 1 with the vacuum on, else 0."""
    stage: np.ndarray
    """int8[t]: index into :data:`STAGES`."""
    pose: np.ndarray
    """float64[t, c, 7]: centre [m] and quaternion (w, x, y, z) of every cell of the scene before
    the move, in its order (world)."""

    @property
    def duration(self) -> float:
        """[s]"""
        return float(self.time[-1]) if len(self.time) else 0.0


class Attempt(NamedTuple):
    """What became of a move."""

    outcome: Outcome
    stage: str = ""
    """Where it failed; empty for a success."""
    detail: str = ""
    """Why, in one line."""
    pick: np.ndarray | None = None
    """float64[k, n]: joint positions over the picked cell, from the contact upwards [rad]."""
    place: np.ndarray | None = None
    """The same over the target."""
    after: Scene | None = None
    """Where everything is then, where that was simulated, also after a failure; the moved object
    listed as :func:`learn2assemble.robot.moves.put_down` does."""
    by_link: bool = False
    """A link of the arm, not its hand, was in the way."""

    quaternion: np.ndarray | None = None
    """float64[n, 4]: orientations (w, x, y, z) of the cells of ``after``, where simulated."""
    error: float = np.nan
    """Distance of the grasped cell from its target then [m], where simulated."""
    held: bool = False
    """The object is still in the hand, which has stopped."""
    joints: np.ndarray | None = None
    """float64[n]: where the arm is then [rad]."""
    trajectory: Trajectory | None = None
    """What the arm did, where something was moved in a simulation."""
    home: tuple[tuple[int, int], ...] | None = None
    """Joints of studs that are pressed home then, lower and upper cell of the scene before, where
    it has some and that was simulated."""

    @property
    def reached(self) -> bool:
        return self.outcome == Outcome.REACHED


class Failure(Exception):
    """What broke a pick and place off, or spoiled it.

    Args:
        outcome: its kind.
        stage: one of :data:`learn2assemble.robot.moves.STAGES`, or ``rest`` once the arm is done.
        detail: one line.
    """

    outcome: Outcome
    stage: str
    detail: str

    def __init__(self, outcome: Outcome, stage: str, detail: str) -> None:
        super().__init__(f"{outcome.label} ({stage}): {detail}")
        self.outcome, self.stage, self.detail = outcome, stage, detail
