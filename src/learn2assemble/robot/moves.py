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
from learn2assemble.geometry.rotations import yaw_matrix
from learn2assemble.robot.grasps import QUARTER, Attitude

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


class Scene(NamedTuple):
    """Boxes on the table, in the world frame; the placed ones first.

    Each cell is one box: a cube of the lattice, or a box of any size where ``half`` is given.
    Objects of several cells are rigid. Where two cubes of one object are horizontal neighbours the
    gap between them is filled; boxes of given size are what they are.
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
    """float64[n] of each cell's box [kg/m3]; by default that of the cubes. From
    :data:`IMMOVABLE` on it is an obstacle."""

    @property
    def halves(self) -> np.ndarray:
        """float64[n, 3]: half extents of each cell's box [m]."""
        return np.full((len(self.position), 3), HALF) if self.half is None else self.half

    def mass(self, cells: np.ndarray) -> np.ndarray:
        """float64[m]: of cells int64[m] without the fillers between them [kg]."""
        volume = 8 * self.halves[cells].prod(1)
        return volume * (DENSITY if self.density is None else self.density[cells])

    def rows(self, cells: np.ndarray, num_placed: int) -> Scene:
        """The scene of some cells int64[m], of which the first ``num_placed`` are placed."""
        half, density = (None if a is None else a[cells] for a in (self.half, self.density))
        return Scene(
            self.position[cells], self.yaw[cells], self.object_id[cells], num_placed, half, density
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
        """Rotation of the object about z between picking and placing [rad]."""
        return self.place.yaw - self.grasp.yaw


def turns(arm: Arm, move: Move) -> tuple[float, ...]:
    """Other turns of the hand about the vertical [rad] in which it does the same."""
    return () if move.grasp.sideways else arm.turns


def turned(move: Move, turn: float) -> Move:
    """The same move with the hand turned about the vertical [rad] at both places."""
    grasp, place = (a._replace(yaw=a.yaw + turn) for a in (move.grasp, move.place))
    return move._replace(grasp=grasp, place=place)


def put_down(scene: Scene, move: Move) -> Scene:
    """The scene after a move that went as ordered: the object's cells are the last placed ones,
    the grasped one first."""
    members = scene.members(move.cell)
    position, yaw = carried(scene, move, members)
    rest = np.setdiff1d(np.arange(scene.num_placed, len(scene.position)), members)
    order = np.concatenate([np.arange(scene.num_placed), members, rest])
    after = scene.rows(order, scene.num_placed + len(members))
    after.position[scene.num_placed : after.num_placed] = position
    after.yaw[scene.num_placed : after.num_placed] = yaw
    return after


def carried(scene: Scene, move: Move, members: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where a move takes cells of the object: centres float64[m, 3] [m] and yaw float64[m]."""
    offset = scene.position[members] - scene.position[move.cell]
    return move.target + offset @ yaw_matrix(move.turn).T, scene.yaw[members] + move.turn


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


ROOM = 0.008
"""How much wider than a block the fingers are open while approaching, after releasing and while
retreating [m]: enough for a millimetre or two of error, not so much that neighbours are touched."""
OPENING = EDGE + ROOM
"""That opening for a cube [m]."""


def grip_width(scene: Scene, cell: int, grasp: Attitude) -> float:
    """How far apart the pads are when they hold a cell [m]."""
    if scene.half is None:
        return EDGE
    across = round((grasp.yaw - scene.yaw[cell]) / QUARTER) % 2 == 0
    return 2 * float(scene.half[cell, 1 if across else 0])


_GRIP_DEPTH = HALF
"""A taller block is held so far below its top [m], as the hand is not far above the fingertips."""
_TIP_ROOM = 0.002
"""Fingertips stay so far above what a block stands on [m]."""


def attitudes(arm: Arm, half: np.ndarray) -> tuple[Attitude, ...]:
    """The upright attitudes in which the tool of an arm can hold a box that stands at yaw 0; for
    another yaw, add it.

    Fingers close along y, then along x, each both ways round, where the box fits between them; a
    cup meets the middle of the top face at four yaws, where the face seals it.

    Args:
        arm: the robot with its tool.
        half: float64[3], half extents of the box [m].

    Returns:
        none where the box is too wide for the fingers, or too small for the cup.
    """
    if arm.suction is not None:
        if min(half[0], half[1]) < arm.suction.cups[0].radius:
            return ()
        return tuple(Attitude(-k * QUARTER, 0.0, float(half[2])) for k in range(4))
    depth = max(half[2] - _GRIP_DEPTH, arm.gripper.tip + _TIP_ROOM - half[2], 0.0)
    if depth > half[2]:
        return ()
    fits = [2 * width + ROOM <= arm.gripper.max_width for width in (half[1], half[0])]
    return tuple(Attitude(-k * QUARTER, 0.0, float(depth)) for k in (0, 2, 1, 3) if fits[k % 2])


HEADROOM = 0.005
"""A tool that comes from the side stays so far above what a block stands on [m]."""
CAPTURE = 0.0005
"""The lip of a cup keeps this distance from the edges of a face [m]."""


def side_attitudes(arm: Arm, half: np.ndarray) -> tuple[Attitude, ...]:
    """The attitudes in which the tool of an arm can hold a box that stands at yaw 0 by a side
    face: cups at the side of the tool on the faces they seal, high enough for the tool to pass
    above what the box stands on.

    Args:
        arm: the robot with its tool.
        half: float64[3], half extents of the box [m].
    """
    found: list[Attitude] = []
    for cup in arm.suction.cups[1:] if arm.suction else ():
        facing = Attitude(lip=cup.lip)
        if not facing.sideways:
            continue
        below = max(-float(facing.tool_point(np.zeros(3))[2]), cup.radius)
        raised = max(0.0, below + HEADROOM - float(half[2]))
        if raised > half[2] - cup.radius - CAPTURE:
            continue
        x, y, _ = facing.approach()
        for k in range(4):
            yaw = k * QUARTER - math.atan2(y, x)
            depth, across = (half[0], half[1]) if k % 2 == 0 else (half[1], half[0])
            if across >= cup.radius:
                found.append(facing._replace(yaw=yaw, depth=float(depth), raised=raised))
    return tuple(found)


def why_not_held(arm: Arm, half: np.ndarray, mass: float) -> str | None:
    """Why the tool of an arm cannot hold a box, in words; None where it can.

    Args:
        arm: the robot with its tool.
        half: float64[3], half extents of the box [m].
        mass: of the whole object [kg].
    """
    size = " x ".join(f"{2e3 * side:g}" for side in half) + " mm"
    cup = arm.suction
    if not attitudes(arm, half):
        if cup is None:
            widest = 1e3 * (arm.gripper.max_width - ROOM)
            return (
                f"a block of {size} is too wide for fingers that take {widest:.0f} mm, or too low"
            )
        return f"a block of {size} is too small for a cup of {1e3 * cup.cups[0].diameter:g} mm"
    if cup is not None and mass > cup.payload:
        return f"{mass:.2f} kg is too heavy for a cup that takes {cup.payload:g} kg"
    return None


CLEARANCE = 0.06
"""Between what is carried and everything below it while crossing [m]."""
LEVEL, FINE_LEVEL = 0.05, 0.01
"""Heights of crossing are multiples of this, with cubes and with boxes of given size, so that paths
repeat [m]."""


def crossing_height(scene: Scene, move: Move) -> float:
    """Height of the tool between picking and placing [m].

    What hangs below the grasped cell, and the fingertips, pass above everything else.
    """
    members, half = scene.members(move.cell), scene.halves[:, 2]
    others = np.setdiff1d(np.arange(len(scene.position)), members)
    highest = np.max(scene.position[others, 2] + half[others], initial=0.0)
    hanging = np.max(scene.position[move.cell, 2] - scene.position[members, 2] + half[members])
    height = max(highest, move.target[2] - hanging) + CLEARANCE + hanging
    # What is held near its top hangs lower than the tool; the small depths of cubes do not count.
    low = scene.half is not None or move.grasp.depth >= HALF
    above = move.grasp.depth if low else 0.0
    if move.grasp.sideways:
        above = float(move.grasp.tool_point(np.zeros(3))[2])
    level = LEVEL if scene.half is None else FINE_LEVEL
    return level * math.ceil((height + above) / level - 1e-9)


def overload(arm: Arm, scene: Scene, move: Move) -> str | None:
    """Why the cup of an arm cannot hold what a move asks for at all, in words; None where it can,
    and for fingers, whose grasp the motion tells."""
    cup, members = arm.suction, scene.members(move.cell)
    if cup is None:
        return None
    mass = scene.mass(members)
    why = why_not_held(arm, scene.halves[move.cell], float(mass.sum()))
    if why is not None:
        return why
    grasp, centre = move.grasp, scene.position[move.cell]
    used = next(one for one in cup.cups if one.lip == grasp.lip)
    turn = grasp.rotation() @ used.lip.frame()
    point = centre - grasp.depth * turn[:, 2] + np.array([0.0, 0.0, grasp.raised])
    weight = np.array([0.0, 0.0, -GRAVITY])
    moment = np.cross(mass @ (scene.position[members] - point), weight)
    off, slip = used.load(turn.T @ (mass.sum() * weight), turn.T @ moment)
    if off > 1:
        return f"its weight is {100 * off:.0f} % of what pulls the cup off"
    return f"its weight is {100 * slip:.0f} % of what the lip carries" if slip > 1 else None


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

    @property
    def reached(self) -> bool:
        return self.outcome == Outcome.REACHED
