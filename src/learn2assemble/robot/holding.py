"""Where a tool can hold a block: a cup on a plane face, a socket on a stud, fingers on two parallel
faces.

A cup meets a face where its lip has room, as near to the line through the centre of mass as that
allows; fingers close on two opposite faces where both have room for the pads. Faces that parts of
the same block cover are none. Candidates are in the frame of the block, so a tool is tilted where
the block is; which of them are any good for a pose and for the next one is told by the tilt of the
tool there.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np

from learn2assemble.geometry.hulls import cross_product
from learn2assemble.robot.bodies import Shape, body_of
from learn2assemble.robot.grasps import FIRST, MOST_TILT, UPRIGHT, Attitude, Lip, facing
from learn2assemble.robot.studs import stud_axes
from learn2assemble.values import three

if TYPE_CHECKING:
    from learn2assemble.robot.arm import Arm
    from learn2assemble.robot.tool import Cup, Gripper, Suction

ROOM = 0.008
"""How much wider than a block the fingers are open while approaching, after releasing and while
retreating [m]: enough for a millimetre or two of error, not so much that neighbours are touched."""
GRIP_DEPTH = 0.025
"""A taller block is held so far below its top [m], as the hand is not far above the fingertips."""
TIP_ROOM, STUD_ROOM = 0.002, 0.0055
"""Fingertips stay so far above what a block stands on [m]: above the studs of large bricks where
the block is high enough for that, ..."""
BRICK = 0.02
"""... and no higher than a large brick [m]."""
LEAST_GRIP = 0.008
"""So much of the height of a pad is on a block that is high enough [m]."""
PAD = 0.0075
"""Half the width of a pad [m]."""
ALONG = (0.0, 0.5, -0.5, 1.0, -1.0)
"""Where fingers hold a block along its faces: shares of how far a pad can be from where it is best,
which is tried first."""
HEADROOM = 0.005
"""A tool that comes from the side stays so far above what a block stands on [m]."""
CAPTURE = 0.0005
"""The lip of a cup at a side keeps this distance from the edges of a face [m]."""
_PARALLEL = math.radians(0.5)
"""Faces on which fingers close are off being parallel by less [rad]."""
_TOP = 1 - 1e-6
"""A face is on top where its normal points up by more than this, in the frame of the block."""
STUD_SHARE = 0.3
"""Radius of a stud, in distances of studs; large and small ones have 0.3."""
_OUT = 1e-4
"""Just outside a face [m]."""


class Hold(NamedTuple):
    """A way to hold a block, in its frame."""

    part: int
    """Number of the part that is held."""
    point: tuple[float, float, float]
    """Where the middle of the lip, or the point between the fingertips, is [m]."""
    axis: tuple[float, float, float]
    """Unit vector along which the lip, or the hand, comes to it."""
    across: tuple[float, float, float]
    """Unit vector at right angles: the fingers close along it; of a cup, just one in the face."""
    width: float = 0.0
    """Between the pads [m]; 0 for a cup."""
    lip: Lip = FIRST
    off: float = 0.0
    """Distance of the centre of mass from the axis [m]."""

    def tool(self, turn: np.ndarray) -> np.ndarray:
        """float64[3, 3]: axes of the tool as columns, world frame, that holds a block which is
        turned by ``turn``; a cup at the side of a tool has the tool as upright as it can be."""
        axis, across = turn @ np.array(self.axis), turn @ np.array(self.across)
        if self.lip == FIRST:
            return np.stack([cross_product(across, axis), across, axis], 1)
        own = self.lip.frame()
        down = np.array([0.0, 0.0, -1.0])
        # The frame of the cup about its axis, so that the z axis of the tool points down most.
        in_cup = own.T @ np.array([0.0, 0.0, 1.0])
        flat = down - axis * (axis @ down)
        size = float(np.linalg.norm(flat))
        u = flat / size if size > 1e-6 else across
        v = cross_product(axis, u)
        angle = math.atan2(in_cup[1], in_cup[0])
        c, s = math.cos(angle), math.sin(angle)
        # Cup axes x and y of which in_cup's horizontal part lies along u.
        x, y = c * u - s * v, s * u + c * v
        return np.stack([x, y, axis], 1) @ own.T


def tilt_of(tool: np.ndarray) -> float:
    """Angle [rad] of the axis of a tool float64[3, 3] to pointing straight down."""
    return math.acos(float(np.clip(-tool[2, 2], -1.0, 1.0)))


def holds_of(arm: Arm, shape: Shape, up: np.ndarray) -> tuple[Hold, ...]:
    """The ways in which the tool of an arm can hold a block.

    Args:
        arm: the robot with its tool.
        shape: of the block.
        up: float64[3]: the vertical in the frame of the block, for what has to do with the ground.
    """
    x, y, z = (np.asarray(up, float).round(3) + 0.0).tolist()
    if arm.suction is not None:
        return _cup_holds(arm.suction, shape, (x, y, z))
    return _finger_holds(arm.gripper, shape, (x, y, z))


@lru_cache(maxsize=4096)
def _cup_holds(suction: Suction, shape: Shape, up: tuple[float, float, float]) -> tuple[Hold, ...]:
    if suction.studs:
        return tuple(_on_studs(suction.cups[0], shape))
    return tuple(hold for cup in suction.cups for hold in _on_faces(cup, shape, np.array(up)))


def _on_studs(socket: Cup, shape: Shape) -> Iterator[Hold]:
    """A hold on every stud of a brick: on its top, as the kit has it."""
    import shapely

    body, down = body_of(shape), (0.0, 0.0, -1.0)
    for number, part in enumerate(shape):
        for face in np.flatnonzero(part.solid.normals[:, 2] > _TOP).tolist():
            corners = part.solid.polygon(face) + np.array(part.centre)
            axes, foot = _axes(part.solid.normals[face], corners), corners[0]
            free, (x0, y0, z), (x1, y1, _) = (
                free_face(shape, number, face),
                corners.min(0).tolist(),
                corners.max(0).tolist(),
            )
            for x, y in stud_axes(np.array([x0, y0]), np.array([x1, y1]), socket.studs).tolist():
                at = np.array([x, y, z])
                stud = shapely.Point(axes @ (at - foot)).buffer(STUD_SHARE * socket.studs)
                if free.contains(stud):
                    off = math.dist((x, y), body.centre[:2].tolist())
                    yield Hold(number, _tuple(at), down, (1.0, 0.0, 0.0), 0.0, FIRST, off)


def _on_faces(cup: Cup, shape: Shape, up: np.ndarray) -> Iterator[Hold]:
    """A hold on every face on which a cup has room."""
    import shapely

    body, side = body_of(shape), cup.lip != FIRST
    radius = cup.radius + (CAPTURE if side else -1e-6)
    ground = float((body.points @ up).min())
    for number, part in enumerate(shape):
        for face, normal in enumerate(part.solid.normals):
            if side and abs(float(normal @ up)) > math.sin(UPRIGHT):
                continue  # A tool with a cup at its side stays upright.
            free = free_face(shape, number, face)
            foot = part.solid.polygon(face)[0] + np.array(part.centre)
            axes = _axes(normal, part.solid.polygon(face))
            room = free.buffer(-radius)
            if side:
                room = room.intersection(_above(axes, foot, up, ground + _below(cup) + HEADROOM))
            if room.is_empty:
                continue
            middle = shapely.Point(axes @ (body.centre - foot))
            at = _nearest(room, middle)
            off = math.dist(at, (middle.x, middle.y))
            point = foot + at @ axes
            across = np.cross(-normal, _along(normal))
            yield Hold(number, _tuple(point), _tuple(-normal), _tuple(across), 0.0, cup.lip, off)


def _below(cup: Cup) -> float:
    """How far a tool with a cup at its side reaches below the middle of the lip [m]."""
    return max(-cup.lip.at[2], cup.radius)


def _above(axes: np.ndarray, foot: np.ndarray, up: np.ndarray, height: float) -> Any:
    """The half plane of a face, as a large square, that is higher than this above the origin."""
    import shapely

    slope = axes @ up
    steep = float(np.linalg.norm(slope))
    if steep < 1e-6:
        return shapely.Polygon()
    slope = slope / steep
    start = slope * (height - float(foot @ up)) / steep
    aside = np.array([-slope[1], slope[0]])
    ahead = start + 10 * slope
    return shapely.Polygon(
        [start - 10 * aside, start + 10 * aside, ahead + 10 * aside, ahead - 10 * aside]
    )


@lru_cache(maxsize=4096)
def _nearest(room: Any, middle: Any) -> np.ndarray:
    """float64[2]: the point of a shapely area that is nearest to a shapely point."""
    import shapely

    library = cast("Any", shapely)  # Its stubs have arguments without a type.
    line: Any = library.shortest_line(room, middle)
    return shapely.get_coordinates(line)[0]


def free_face(shape: Shape, part: int, face: int) -> Any:
    """The part of a face that no other part of the block covers, as a shapely area; coordinates
    are along two axes in the face from its first corner [m]."""
    import shapely

    solid = shape[part].solid
    corners, normal = solid.polygon(face) + np.array(shape[part].centre), solid.normals[face]
    axes, foot = _axes(normal, corners), corners[0]
    area = shapely.Polygon((corners - foot) @ axes.T)
    for number, other in enumerate(shape):
        if number == part:
            continue
        height = (other.points - foot) @ normal - _OUT
        if height.max() <= 0 or height.min() >= 0:
            continue
        section = [
            (other.points[p] * height[q] - other.points[q] * height[p]) / (height[q] - height[p])
            for polygon in other.solid.faces
            for p, q in zip(polygon, (*polygon[1:], polygon[0]), strict=True)
            if height[p] * height[q] < 0
        ]
        section += list(other.points[np.abs(height) < 1e-9])
        flat = (np.array(section) - foot) @ axes.T
        area = area.difference(shapely.MultiPoint(flat).convex_hull)
    return area


def _axes(normal: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """float64[2, 3]: two axes in a face, the first along its first edge."""
    along = corners[1] - corners[0]
    along = along / np.linalg.norm(along)
    return np.stack([along, cross_product(normal, along)])


def _along(normal: np.ndarray) -> np.ndarray:
    """float64[3]: a unit vector in a face: the x axis of the block, or y, made level with it."""
    axis = np.eye(3)[0 if abs(normal[0]) < 0.9 else 1]
    axis = axis - normal * (normal @ axis)
    return axis / np.linalg.norm(axis)


@lru_cache(maxsize=4096)
def _finger_holds(
    gripper: Gripper, shape: Shape, up: tuple[float, float, float]
) -> tuple[Hold, ...]:
    found: list[Hold] = []
    for number, part in enumerate(shape):
        solid = part.solid
        cosines = solid.normals @ solid.normals.T
        pairs = [(f, g) for f, g in np.argwhere(cosines < -math.cos(_PARALLEL)).tolist() if f < g]
        for f, g in pairs:
            width = float(solid.offsets[f] + solid.offsets[g])
            if width + ROOM <= gripper.max_width:
                found += _between_faces(gripper, shape, number, (f, g), np.array(up))
    return tuple(sorted(found, key=lambda hold: (round(hold.width, 6), -abs(hold.across[1]))))


def _between_faces(
    gripper: Gripper, shape: Shape, number: int, pair: tuple[int, int], up: np.ndarray
) -> Iterator[Hold]:
    """Holds on two parallel faces, the hand coming from above or along other faces."""
    import shapely

    body, part, (f, g) = body_of(shape), shape[number], pair
    solid, normal = part.solid, part.solid.normals[f]
    corners = [solid.polygon(face) + np.array(part.centre) for face in pair]
    axes, foot = _axes(normal, corners[0]), corners[0][0]
    other = _axes(solid.normals[g], corners[1])
    # The second face seen along the normal of the first: the areas that both have.
    back = free_face(shape, number, g)
    ring = [corners[1][0] + at @ other for at in _rings(back)]
    if not ring:
        return
    area = free_face(shape, number, f).intersection(
        shapely.MultiPoint((np.array(ring) - foot) @ axes.T).convex_hull
    )
    if area.is_empty:
        return
    middle = axes @ (body.centre - foot)
    width = float(solid.offsets[f] + solid.offsets[g])
    inwards = foot - normal * width / 2
    for axis in _approaches(normal, np.vstack([-up, -solid.normals])):
        flat = axes @ axis
        aside = np.array([-flat[1], flat[0]])
        room = area.buffer(-PAD) if area.buffer(-PAD).area > 0 else area
        best = _nearest(room, shapely.Point(middle))
        reach = shapely.get_coordinates(room) @ aside - float(best @ aside)
        shifts = (share * float(reach.max() if share > 0 else -reach.min()) for share in ALONG)
        for shift in dict.fromkeys(round(one, 6) for one in shifts):
            near = best + shift * aside
            line = shapely.LineString([near - 10 * flat, near + 10 * flat])
            ends = shapely.get_coordinates(area.intersection(line)) @ flat
            if not len(ends):
                continue
            # Along the way of the hand: where it enters the faces, where it would leave them.
            first, last = float(ends.min()), float(ends.max())
            most = min(first + GRIP_DEPTH, (first + last) / 2)
            room = STUD_ROOM if last - first <= BRICK else TIP_ROOM
            depth = min(most, last - gripper.tip - room)
            if depth + gripper.tip < first + LEAST_GRIP:
                depth = min(most, last - gripper.tip - TIP_ROOM)
                if depth < first:
                    continue
            at = aside * float(near @ aside) + flat * depth
            off = abs(float((middle - at) @ aside))
            point = _tuple(inwards + at @ axes)
            yield Hold(number, point, _tuple(axis), _tuple(normal), width, FIRST, off)


def _rings(area: Any) -> list[np.ndarray]:
    import shapely

    return list(shapely.get_coordinates(area))


def _approaches(normal: np.ndarray, wanted: np.ndarray) -> list[np.ndarray]:
    """Unit vectors at right angles to a normal that are nearest to wanted ones, each once."""
    found: list[np.ndarray] = []
    for axis in wanted:
        axis = axis - normal * (normal @ axis)
        size = float(np.linalg.norm(axis))
        if size < 0.2:
            continue
        axis = axis / size
        if all(axis @ old < math.cos(UPRIGHT) for old in found):
            found.append(axis)
    return found


def _tuple(vector: np.ndarray) -> tuple[float, float, float]:
    return three((vector.round(12) + 0.0).tolist())


# ---------------------------------------------------------------- what cannot be held


FACING = math.radians(4.0)
"""Largest angle between a cup and the face it closes on [rad]."""


def why_not_held(arm: Arm, shape: Shape, mass: float, axis: np.ndarray | None = None) -> str | None:
    """Why the tool of an arm cannot hold a block at any face, in words; None where it can.

    Args:
        arm: the robot with its tool.
        shape: of the block.
        mass: of it [kg].
        axis: float64[3]: the way on which the tool comes, in the frame of the block; by default
            any.
    """
    cup, ups = arm.suction, (*np.eye(3), *-np.eye(3))
    found = (hold for up in ups for hold in holds_of(arm, shape, up))
    if not any(axis is None or np.dot(hold.axis, axis) > math.cos(FACING) for hold in found):
        if cup is None:
            return no_faces(arm, shape)
        if cup.studs:
            return f"a block of {_size(shape)} mm has no stud for a socket"
        diameter = 1e3 * cup.cups[0].diameter
        return f"a block of {_size(shape)} mm is too small for a cup of {diameter:g} mm"
    if cup is not None and mass > cup.payload + 1e-3:  # Corners in a file are rounded.
        what = "socket" if cup.studs else "cup"
        return f"{mass:.4g} kg is too heavy for a {what} that takes {cup.payload:g} kg"
    return None


def no_faces(arm: Arm, shape: Shape) -> str:
    """Why fingers cannot take a block, in words."""
    gripper = arm.gripper
    apart, deep = 1e3 * (gripper.max_width - ROOM), 1e3 * (gripper.tip + TIP_ROOM)
    if not _has_parallel_faces(shape):
        return f"a block of {_size(shape)} mm has no two parallel faces for fingers"
    return f"no two faces at most {apart:.0f} mm apart and {deep:.0f} mm deep for fingers"


def _size(shape: Shape) -> str:
    return " x ".join(f"{2e3 * side:g}" for side in body_of(shape).half.round(7))


def _has_parallel_faces(shape: Shape) -> bool:
    return any(
        bool((part.solid.normals @ part.solid.normals.T < -math.cos(_PARALLEL)).any())
        for part in shape
    )


# ---------------------------------------------------------------- from a pose to another


def attitude(hold: Hold, centre: np.ndarray, turn: np.ndarray, tool: np.ndarray) -> Attitude:
    """How the tool meets a block.

    Args:
        hold: where.
        centre: float64[3]: of the part that is held, in the frame of the block [m].
        turn: float64[3, 3]: rotation of the block.
        tool: float64[3, 3]: axes of the tool as columns, world frame.
    """
    contact = tool.T @ turn @ (np.array(hold.point) - centre)
    along = np.array(hold.lip.axis)
    depth = -float(contact @ along)
    aside = _tuple(contact + depth * along)
    depth = round(depth, 12) + 0.0
    return facing(tool)._replace(depth=depth, lip=hold.lip, aside=aside)


class Way(NamedTuple):
    """A hold that is good for picking a block up as it lies and for putting it down as it shall."""

    hold: Hold
    grasp: np.ndarray
    """float64[3, 3]: axes of the tool where the block lies, world frame."""
    place: np.ndarray
    """float64[3, 3]: where it is put down."""
    goal: np.ndarray
    """float64[3, 3]: rotation of the block there; one of those in which it looks the same."""

    @property
    def tilt(self) -> float:
        """The larger tilt of the tool [rad]."""
        return max(tilt_of(self.grasp), tilt_of(self.place))

    @property
    def aside(self) -> bool:
        """Whether a cup at the side of the tool holds the block."""
        return self.hold.lip != FIRST


def ways_to_turn(arm: Arm, shape: Shape, now: np.ndarray, goals: Sequence[np.ndarray]) -> list[Way]:
    """The holds with which a block can be turned from one rotation to another, the best ones
    first: those with the least tilt of the tool, on the highest part, near the centre of mass.

    Args:
        arm: the robot with its tool.
        shape: of the block.
        now: float64[3, 3]: rotation of the block as it lies.
        goals: rotations float64[3, 3] it shall have, any of them.
    """
    found: list[tuple[tuple[float, ...], Way]] = []
    tops = [float((part.points @ now[2]).max()) for part in shape]
    for hold in holds_of(arm, shape, now[2]):
        grasp = hold.tool(now)
        if tilt_of(grasp) > arm.most_tilt:
            continue
        for goal in goals:
            place = goal @ now.T @ grasp
            way = Way(hold, grasp, place, goal)
            less, more = sorted((tilt_of(grasp), tilt_of(place)))
            if less > MOST_TILT or more > arm.most_tilt:
                continue
            cost = (
                float(way.aside),
                *(round(math.degrees(one)) if one > UPRIGHT else 0 for one in (more, less)),
                -round(tops[hold.part], 4),
                round(hold.off, 3),
            )
            found.append((cost, way))
    found.sort(key=lambda one: one[0])
    return [way for _, way in found]


def attitudes(arm: Arm, shape: Shape, turn: np.ndarray | None = None) -> list[Attitude]:
    """How the tool of an arm can hold a block as it lies, the most upright ways first; those of
    cups at the side of a tool are sideways.

    Args:
        arm: the robot with its tool.
        shape: of the block.
        turn: float64[3, 3]: its rotation; by default none.
    """
    now = np.eye(3) if turn is None else turn
    return [
        attitude(way.hold, np.array(shape[way.hold.part].centre), now, way.grasp)
        for way in ways_to_turn(arm, shape, now, [now])
    ]
