"""Scenes as the simulation sees them: rigid objects with poses, and an order to move one of them.

Boxes are 0.25 mm thinner per side in x and y, so that neighbours do not rub, but not in z (the
plant of a cup has them as large as they are called).
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np

from learn2assemble.constants import HALF
from learn2assemble.errors import InputError
from learn2assemble.geometry.hulls import Hull
from learn2assemble.geometry.rotations import cube_yaw, quaternion_matrix, rotate_vectors
from learn2assemble.robot.bodies import Part
from learn2assemble.robot.grasps import Attitude
from learn2assemble.robot.moves import (
    ARM_THERE,
    IMMOVABLE,
    ROOM,
    Move,
    Scene,
    carried,
    crossing_height,
    grip_width,
    object_boxes,
    put_down,
)
from learn2assemble.robot.scene import rotation_matrix
from learn2assemble.values import three

SHRINK = 2.5e-4
"""How much thinner a box is on its upright sides [m], ..."""
STUD_SHRINK = 1e-4
"""... how much on the others where studs join it to others [m], ..."""
UPRIGHT = 0.05
"""... whose normals are level but for this sine."""
GRAIN, FINE_GRAIN = 1e-3, 1e-5
"""Places of cells in their object are multiples of this, cubes and boxes of given size [m]."""
Box = (
    tuple[tuple[float, ...], ...]
    | tuple[tuple[float, ...], tuple[float, ...], float]
    | tuple[tuple[float, ...], tuple[float, ...], float, Hull]
)
"""Centre and half extents in the object's frame [m]; of cells of given size, the mass [kg] and,
where it is no box, the hull."""


class Objects(NamedTuple):
    """How the ``n`` cells of a scene make up ``b`` rigid objects; an object's frame is that of
    its first cell in the scene. Cells of objects that are held still follow on them, each by
    itself."""

    shape: tuple[tuple[Box, ...], ...]
    """Per object its boxes: cells, then fillers."""
    owner: np.ndarray
    """int64[n]: object of each cell, objects numbered by their first cell, boxes of given size by
    their shape; ``b + k`` for the k-th cell that is held still."""
    offset: np.ndarray
    """float64[n, 3]: cell centre in the object's frame [m]."""
    lead: np.ndarray
    """int64[b]: first cell of each object."""
    still: np.ndarray
    """float64[k, 7]: poses of the cells that are held still."""
    still_half: np.ndarray
    """float64[k, 3]: their half extents [m]."""
    still_hull: tuple[Hull | None, ...]
    """What they are where they are no boxes."""
    still_round: np.ndarray
    """bool[k]: capsules along z as large as these."""

    def hulls(self) -> frozenset[Hull]:
        """Of cells that are held still."""
        return frozenset(hull for hull in self.still_hull if hull is not None)

    def cells(self, poses: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Centres float64[n, 3] [m], quaternions float64[n, 4] and yaws float64[n] [rad] of the
        cells of objects at ``poses`` float64[b, 7]."""
        pose = np.vstack([poses, self.still])[self.owner]
        yaw = np.array([cube_yaw(rotation_matrix(turn)) for turn in pose[:, 3:]])
        return pose[:, :3] + rotate_vectors(pose[:, 3:], self.offset), pose[:, 3:].copy(), yaw


def group(
    scene: Scene,
    quaternion: np.ndarray,
    free: np.ndarray | None = None,
    goal: tuple[np.ndarray, np.ndarray] | None = None,
    thinner: float = SHRINK,
) -> Objects:
    """Objects of a scene.

    Args:
        scene: cells.
        quaternion: float64[n, 4], their orientations.
        free: bool[n], cells of objects that can move; by default all.
        goal: int64[m], cells that are moved, and float64[m, 4], the orientations they shall have.
        thinner: by how much boxes of given size are on their upright sides [m].
    """
    if free is None:
        free = np.ones(len(scene.position), bool)
    _, lead, owner = np.unique(scene.object_id, return_index=True, return_inverse=True)
    still = np.flatnonzero(~free)
    lead = np.sort(lead[free[lead]])
    offset = np.zeros_like(scene.position)
    shapes: list[tuple[Box, ...]] = []
    standing = quaternion.copy()
    if goal is not None:
        standing[goal[0]] = goal[1]
    half = _thinner(scene, standing, thinner)
    for first in lead:
        cells = np.flatnonzero(owner == owner[first])
        turn = rotation_matrix(quaternion[first])
        relative = (scene.position[cells] - scene.position[first]) @ turn
        if scene.half is None:
            offset[cells] = GRAIN * np.rint(relative / GRAIN)
            cube = np.array([HALF - SHRINK, HALF - SHRINK, HALF])
            boxes = object_boxes(offset[cells], cube)
            shapes.append(
                tuple((tuple(centre.tolist()), tuple(size.tolist())) for centre, size in boxes)
            )
        else:
            offset[cells] = FINE_GRAIN * np.rint(relative / FINE_GRAIN)
            # What is brought as one may have parts that are turned by quarters.
            turned = np.abs(np.rint(turn.T @ quaternion_matrix(quaternion[cells])))
            sizes = (turned @ half[cells, :, None])[..., 0]
            shapes.append(tuple(_sized(scene, cells, offset[cells], sizes)))
    if scene.half is not None:
        # The order of what waits and what stands changes with every move; that of shapes does not.
        order = sorted(range(len(lead)), key=lambda k: (shapes[k], k))
        lead, shapes = lead[order], [shapes[k] for k in order]
    number = np.full(len(scene.position), -1)
    number[owner[lead]] = np.arange(len(lead))
    owner = number[owner]
    owner[still] = len(lead) + np.arange(len(still))
    return Objects(
        tuple(shapes),
        owner,
        offset,
        lead,
        np.hstack([scene.position[still], quaternion[still]]),
        half[still],
        tuple(None if scene.hull is None else scene.hull[k] for k in still.tolist()),
        np.zeros(len(still), bool) if scene.aside is None else scene.aside[still] == ARM_THERE,
    )


def _sized(scene: Scene, cells: np.ndarray, centre: np.ndarray, half: np.ndarray) -> list[Box]:
    """Cells of given size at ``centre`` float64[m, 3] in the frame of their object [m]."""
    found: list[Box] = []
    masses = scene.mass(cells).tolist()
    rows: Iterable[tuple[int, np.ndarray, np.ndarray, float]]
    rows = zip(cells.tolist(), centre, half, masses, strict=True)
    for cell, middle, size, mass in rows:
        box: Any = tuple(middle.tolist()), tuple(size.round(9).tolist()), round(mass, 9)
        hull: Hull | None = None if scene.hull is None else scene.hull[cell]
        found.append(box if hull is None else (*box, hull))
    return found


def _thinner(scene: Scene, quaternion: np.ndarray, by: float) -> np.ndarray:
    """float64[n, 3]: half extents of the cells, boxes thinner along axes that are level [m], and
    along all where studs join them: what a joint bears is not borne by faces, too."""
    axes = quaternion_matrix(quaternion)[:, 2]
    lower = 0.0 if scene.studs is None else STUD_SHRINK
    return scene.halves - np.where(np.abs(axes) < UPRIGHT, by, lower)


PRESS = 0.004
"""Approach paths begin so far below the contact [m], ..."""
SOFTEST, DEEPEST = 2000.0, 0.02
"""... and farther by what the arm gives way under a press, if it is so stiff [N/m], but no more
than this [m]."""
NEAR = 0.005
"""What is so near to a block where it is taken or where it is put is free to move [m]."""
MOST_FREE = 40
"""No more objects than this are, the nearest ones."""


def free_cells(scene: Scene, quaternion: np.ndarray, move: Move) -> np.ndarray:
    """bool[n]: cells of the objects that a move may move: the object itself, what it stands on or
    beside where it is taken and where it is put, and what rests on those. All others are held
    still, obstacles always, which is what keeps a move in a large structure as cheap as in a small
    one."""
    scene = scene._replace(quaternion=quaternion)
    low, high = scene.bounds()
    members = scene.members(move.cell)
    there, turns = carried(scene, move, members)
    goal = scene.rows(members, 0)._replace(position=there, quaternion=turns)
    boxes = [*zip(low[members], high[members], strict=True), *zip(*goal.bounds(), strict=True)]
    return concerned(scene, members, boxes, np.vstack([there, scene.position[members]]))


def concerned(
    scene: Scene,
    members: np.ndarray,
    boxes: list[tuple[np.ndarray, np.ndarray]],
    ends: np.ndarray,
) -> np.ndarray:
    """bool[n]: cells of the objects that are free to move: those of ``members``, those near to a
    box, and what rests on them.

    Args:
        scene: with the orientations of its cells.
        members: int64[m] of its cells.
        boxes: lowest and highest coordinates float64[3] of each [m].
        ends: float64[k, 3]: where there are too many, those nearest to these places are [m].
    """
    low, high = scene.bounds()
    _, number = np.unique(scene.object_id, return_inverse=True)
    if scene.density is not None:
        # Obstacles are near nothing and rest on nothing.
        high[scene.density >= IMMOVABLE] = low[scene.density >= IMMOVABLE] = np.inf
    found = np.zeros(number.max() + 1, bool)
    found[number[members]] = True
    for lower, upper in boxes:
        near = ((low <= upper + NEAR) & (high >= lower - NEAR)).all(1)
        found[number[near]] = True
    leaning = scene.hull is not None
    joined = [] if scene.studs is None else [j for j in scene.studs.joints if j.home]
    while True:
        free = found[number]
        if leaning:
            # Blocks lean on one another in all directions.
            meet = (low[:, None] < high[free] + NEAR) & (high[:, None] > low[free] - NEAR)
            more = np.any(meet.all(2), axis=1) & ~free
        else:
            on = (low[:, None, :2] < high[free, :2]) & (high[:, None, :2] > low[free, :2])
            rests = np.abs(low[:, None, 2] - high[free, 2]) < NEAR
            more = (on.all(2) & rests).any(1) & ~free
        for joint in joined:
            # What is pressed is borne by all that clutches.
            if joint.lower >= 0 and free[joint.lower] != free[joint.upper]:
                more[[joint.lower, joint.upper]] = True
        if not more.any():
            break
        found[number[more]] = True
    if found.sum() > MOST_FREE:
        distance = np.full(len(found), np.inf)
        apart = np.linalg.norm(scene.position[:, None] - ends, axis=2).min(1)
        np.minimum.at(distance, number, apart)
        distance[number[members]] = -1.0
        distance[~found] = np.inf
        found[np.argsort(distance, kind="stable")[MOST_FREE:]] = False
    return found[number]


def part_of(box: Box) -> Part:
    """A box of an object, in the frame of the object."""
    centre, half, *own = box
    hull = next((one for one in own if isinstance(one, Hull)), None)
    return Part(three(centre), three(half), hull)


class Order(NamedTuple):
    """What is asked of the arm, and where."""

    scene: Scene
    quaternion: np.ndarray
    """float64[n, 4]: orientations (w, x, y, z) of the cells."""
    move: Move
    objects: Objects
    poses: np.ndarray
    """float64[b, 7] of the objects: position [m] and quaternion."""
    names: list[str]
    """Of the objects, in messages."""
    target: int
    """Number of the object to be moved."""
    height: float
    """Of the tool between picking and placing [m]."""
    held: float
    """Distance of the pads that hold it [m]."""
    opening: float
    """Distance of the pads before and after [m]."""

    @property
    def below(self) -> float:
        """How far below the place the approach path begins [m]: what is held is lowered until it
        rests, or is pressed home."""
        studs = self.scene.studs
        return PRESS if studs is None else min(PRESS + studs.press / SOFTEST, DEEPEST)

    def in_hand(self, grasp: Attitude) -> tuple[np.ndarray, np.ndarray]:
        """Pose of the object in the tool frame once it is grasped so: float64[3] [m] and [3, 3]."""
        tool, pose = grasp.rotation(), self.poses[self.target]
        contact = grasp.tool_point(self.scene.position[self.move.cell])
        return tool.T @ (pose[:3] - contact), tool.T @ rotation_matrix(pose[3:])

    def in_world(self, grasp: Attitude, place: Attitude) -> tuple[np.ndarray, np.ndarray]:
        """Pose of the object once it is placed: float64[3] [m] and float64[3, 3]."""
        position, rotation = self.in_hand(grasp)
        tool = place.rotation()
        return place.tool_point(self.move.target) + tool @ position, tool @ rotation

    def after(self, poses: np.ndarray) -> tuple[Scene, np.ndarray]:
        """The scene with objects at ``poses`` float64[b, 7], the moved one listed as
        :func:`~.moves.put_down` does, and quaternions of its cells float64[n, 4]."""
        position, quaternion, yaw = self.objects.cells(poses)
        # Which cell goes where in the list, by sending their numbers instead of their yaws.
        numbered = self.scene._replace(yaw=np.arange(len(yaw), dtype=float))
        meant = put_down(numbered, self.move)
        new = np.rint(meant.yaw).astype(np.int64)
        members = self.scene.members(self.move.cell)
        new[self.scene.num_placed : self.scene.num_placed + len(members)] = members
        there = quaternion[new] if meant.quaternion is not None else None
        return (
            meant._replace(position=position[new], yaw=yaw[new], quaternion=there),
            quaternion[new],
        )


def take_order(scene: Scene, move: Move, quaternion: np.ndarray | None = None) -> Order:
    """The order to carry out ``move``.

    Args:
        scene: as things are.
        move: what shall be done.
        quaternion: float64[n, 4] orientations (w, x, y, z) of the cells; by default as the scene
            says.

    Raises:
        InputError: for a cell that is not waiting, or numbers that are not finite.
    """
    if not scene.num_placed <= move.cell < len(scene.position):
        waiting = f"the index of a waiting cell, {scene.num_placed} to {len(scene.position) - 1}"
        raise InputError("cell", move.cell, waiting)
    if not np.isfinite(move.target).all():
        raise InputError("target", np.asarray(move.target).tolist(), "finite numbers")
    objects, poses, names = rigid_objects(scene, quaternion, move)
    turns = np.vstack([poses, objects.still])[objects.owner, 3:]
    if scene.half is not None:
        scene = scene._replace(quaternion=turns)
    held = grip_width(scene, move.cell, move.grasp)
    return Order(
        scene,
        turns,
        move,
        objects,
        poses,
        names,
        int(objects.owner[move.cell]),
        crossing_height(scene, move),
        held,
        held + ROOM,
    )


def rigid_objects(
    scene: Scene, quaternion: np.ndarray | None = None, move: Move | None = None
) -> tuple[Objects, np.ndarray, list[str]]:
    """The objects of a scene, their poses float64[b, 7] and their names in messages, then those of
    cells that are held still; with a ``move`` boxes of given size are, where it does not matter.

    Raises:
        InputError: for numbers that are not finite.
    """
    turns = scene.orientation if quaternion is None else np.asarray(quaternion, float)
    for array in (scene.position, turns):
        if not np.isfinite(array).all():
            raise InputError("scene", array.tolist(), "finite numbers")
    free = goal = None
    if scene.half is not None and move is not None:
        free = free_cells(scene, turns, move)
        members = scene.members(move.cell)
        goal = members, carried(scene._replace(quaternion=turns), move, members)[1]
    objects = group(scene, turns, free, goal)
    poses = np.hstack([scene.position[objects.lead], turns[objects.lead]])
    still = np.empty(0, np.int64) if free is None else np.flatnonzero(~free)
    return objects, poses, [f"block {k}" for k in (*objects.lead, *still)]
