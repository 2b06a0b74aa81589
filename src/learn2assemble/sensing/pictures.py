"""Depth pictures of simulated scenes.

The rays are MuJoCo's: no graphics card is needed. A picture is noisy as that of structured light or
of a time-of-flight camera: an error that grows with the square of the distance, one that varies
slowly over the picture and stays, readings lost or mixed beside edges, and readings lost anywhere.
"""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from typing import Any, cast

import mujoco
import numpy as np

from learn2assemble.kernels import kernel
from learn2assemble.plants.plant import Plant, Readings
from learn2assemble.plants.setup import Setup
from learn2assemble.robot.arm import Arm, arm_model
from learn2assemble.robot.bodies import Shape
from learn2assemble.robot.scene import mesh_of
from learn2assemble.sensing.camera import DepthCamera, DepthPicture, rotation
from learn2assemble.sensing.residuals import PreparedPicture

JUMP = 0.008
"""Neighbouring pixels whose depths differ by this share of them are beside an edge."""
BESIDE_ARM, NEAR_ARM = 4, 0.03
"""What is shown within so many pixels of the arm, and is so far before or behind it [m], may be
it."""
SIGNS = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
"""Of the corners of a box."""
Scenery = tuple[Any, Any]
"""A MuJoCo model and its data."""
WAVES = (6, 8)
"""Rows and columns of the grid between which the slowly varying error is smooth."""


def true_depth(scenes: Sequence[Scenery], camera: DepthCamera) -> np.ndarray:
    """float64[rows, columns]: what a camera would read without noise [m]; 0 where nothing is within
    its range.

    Args:
        scenes: that are one, with what is where (after ``mj_forward`` or ``mj_kinematics``).
        camera: where it truly is.
    """
    low, high = camera.range
    depth = np.full(camera.rays.shape[:2], np.inf)
    for model, data in scenes:
        shown = _backdrop(model, data, camera, depth)
        rays = camera.rays[shown]
        length = np.linalg.norm(rays, axis=1)
        ways = (rays / length[:, None]) @ camera.turn.T
        count = len(rays)
        if not count:
            continue
        hit, far = np.empty(count, np.int32), np.empty(count)
        # The cutoff is compared with the boxes around geoms, so what remains is cut below.
        cutoff, start, flat = high * float(length.max()), camera.position, ways.ravel()
        mujoco.mj_multiRay(model, data, start, flat, None, True, -1, hit, far, None, count, cutoff)
        depth[shown] = np.minimum(depth[shown], np.where(far < 0, np.inf, far / length))
    depth[(depth < low) | (depth > high)] = 0.0
    return depth


def _backdrop(
    model: mujoco.MjModel, data: mujoco.MjData, camera: DepthCamera, depth: np.ndarray
) -> np.ndarray:
    """bool[rows, columns]: where anything but an endless plane may be seen, so that rays are worth
    their time; the planes are put into ``depth``, where they are nearer."""
    columns, rows = camera.resolution
    shown = np.zeros((rows, columns), bool)
    for geom in range(model.ngeom):
        place, turn = data.geom_xpos[geom], data.geom_xmat[geom].reshape(3, 3)
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE and not model.geom_size[geom][0]:
            away = float((place - camera.position) @ turn[:, 2])
            _plane(camera.rays, turn[:, 2] @ camera.turn, away, depth)
            continue
        middle, half = model.geom_aabb[geom][:3], model.geom_aabb[geom][3:]
        seen = camera.project(place + (middle + SIGNS * half) @ turn.T)
        window = 0, rows, 0, columns
        if seen[:, 2].min() > 0.01:
            (u, v), (right, below) = np.floor(seen[:, :2].min(0)), np.ceil(seen[:, :2].max(0)) + 1
            window = max(0, int(v)), min(rows, int(below)), max(0, int(u)), min(columns, int(right))
        elif seen[:, 2].max() <= 0:
            continue
        origin = turn.T @ (camera.position - place) - middle
        _box(camera.rays, turn.T @ camera.turn, origin, half + 1e-6, window, shown)
    return shown


@kernel
def _box(
    rays: np.ndarray,
    between: np.ndarray,
    origin: np.ndarray,
    half: np.ndarray,
    window: tuple[int, int, int, int],
    shown: np.ndarray,
) -> None:
    """Mark those pixels within a window whose rays meet a box.

    Args:
        between: float64[3, 3] from the camera frame to that of the box, whose middle is its origin.
        origin: float64[3] of the rays there.
        half: float64[3], half extents of the box.
    """
    for v in range(window[0], window[1]):
        for u in range(window[2], window[3]):
            if shown[v, u]:
                continue
            enter, leave = 0.0, np.inf
            for i in range(3):
                way = 0.0
                for j in range(3):
                    way += between[i, j] * rays[v, u, j]
                if abs(way) < 1e-12:
                    if abs(origin[i]) > half[i]:
                        leave = -1.0
                    continue
                one, two = (-half[i] - origin[i]) / way, (half[i] - origin[i]) / way
                enter, leave = max(enter, min(one, two)), min(leave, max(one, two))
            shown[v, u] = enter <= leave


@kernel
def _plane(rays: np.ndarray, normal: np.ndarray, away: float, depth: np.ndarray) -> None:
    """Put an endless plane into a depth picture, where it is nearer."""
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            ray = rays[v, u]
            towards = ray[0] * normal[0] + ray[1] * normal[1] + ray[2] * normal[2]
            if towards != 0.0 and 0.0 < away / towards < depth[v, u]:
                depth[v, u] = away / towards


@kernel
def _read(
    depth: np.ndarray,
    noise: tuple[float, ...],
    waves: np.ndarray,
    frames: int,
    rng: np.random.Generator,
) -> np.ndarray:
    """Pictures of a depth picture as they would be read, and of every pixel the median of those
    that read something.

    Args:
        depth: float64[rows, columns] as it is.
        noise: floor, growth, waves, edges and dropout of :class:`DepthNoise`.
        waves: float64[rows, columns], the error that varies slowly, in its standard deviations.
        frames: how many.
        rng: numbers.

    Returns:
        float32[rows, columns], 0 where nothing was read.
    """
    floor, growth, wavy, edges, dropout = noise
    rows, columns = depth.shape
    out, found = np.zeros((rows, columns), np.float32), np.zeros(frames)
    for v in range(rows):
        for u in range(columns):
            there = depth[v, u]
            if there <= 0:
                continue
            near, far = there, there
            for a in range(max(0, v - 1), min(rows, v + 2)):
                for b in range(max(0, u - 1), min(columns, u + 2)):
                    if depth[a, b] > 0:
                        near = min(near, depth[a, b])
                    far = max(far, depth[a, b])
            beside = far - near > JUMP * there
            sigma, count = floor + growth * there * there, 0
            for _ in range(frames):
                if rng.random() < dropout:
                    continue
                value = there + sigma * rng.standard_normal() + wavy * waves[v, u]
                if beside:
                    draw = rng.random()
                    if draw < edges:
                        continue
                    if draw < 1.5 * edges:
                        value = near + rng.random() * (far - near)
                if value > 0:
                    k = count
                    while k > 0 and found[k - 1] > value:
                        found[k] = found[k - 1]
                        k -= 1
                    found[k] = value
                    count += 1
            if count:
                out[v, u] = (found[(count - 1) // 2] + found[count // 2]) / 2
    return out


class SimulatedCamera:
    """A camera of a simulated cell: where it truly is, and an error of its own.

    Args:
        camera: as the layout has it.
        error: by how much it truly is elsewhere: float64[6], a shift along the axes of the world
            [m], and a rotation vector about the camera [rad].
        seed: of its noise.
    """

    def __init__(
        self, camera: DepthCamera, error: Sequence[float] | np.ndarray = (0.0,) * 6, seed: int = 0
    ) -> None:
        from scipy.ndimage import (  # pyright: ignore[reportMissingTypeStubs]
            zoom,  # pyright: ignore[reportUnknownVariableType]
        )

        given = np.array(error, float)
        self.camera: DepthCamera = camera.moved(given[:3], rotation(given[3:]))
        self.rng: np.random.Generator = np.random.default_rng(seed)
        columns, rows = camera.resolution
        grid = self.rng.standard_normal(WAVES)
        self.waves: np.ndarray = np.asarray(
            zoom(grid, (rows / WAVES[0], columns / WAVES[1]), order=1)
        )

    def look(self, scenes: Sequence[Scenery], time: float = 0.0) -> DepthPicture:
        """What it sees of simulated scenes that are one, see :func:`true_depth` and
        :class:`DepthNoise`."""
        there, told = true_depth(scenes, self.camera), self.camera.noise
        noise = told.floor, told.growth, told.waves, told.edges, told.dropout
        depth = _read(there, noise, self.waves, self.camera.frames, self.rng)
        return DepthPicture(self.camera.name, time, depth)


def still_scene(solids: Sequence[tuple[Shape, np.ndarray]]) -> Scenery:
    """A scene in which nothing moves: the table, and blocks at poses float64[7]; its MuJoCo model
    and data."""
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1])
    for shape, pose in solids:
        body = spec.worldbody.add_body(pos=pose[:3], quat=pose[3:])
        for part in shape:
            if part.hull is None:
                kind: dict[str, Any] = {"type": mujoco.mjtGeom.mjGEOM_BOX, "size": part.half}
            else:
                name = mesh_of(spec, part.hull)
                kind = {"type": mujoco.mjtGeom.mjGEOM_MESH, "meshname": name}
            body.add_geom(pos=part.centre, **kind)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


class ArmPicture:
    """What an arm alone looks like.

    Args:
        arm: with its tool, at its place.
    """

    def __init__(self, arm: Arm) -> None:
        self.model: mujoco.MjModel = arm_model(arm)
        self.data: mujoco.MjData = mujoco.MjData(self.model)
        self.joint: np.ndarray = np.array(
            [self.model.joint(name).qposadr[0] for name in arm.joints]
        )
        self.fingers: list[int] = [
            int(self.model.joint(name).qposadr[0]) for name in arm.gripper.joints
        ]

    def at(self, joints: np.ndarray, width: float | None = None) -> Scenery:
        """Its scene where it is.

        Args:
            joints: float64[n] [rad].
            width: opening between the pads [m]; None: closed, or a tool without fingers.
        """
        self.data.qpos[self.joint] = joints
        for finger in self.fingers:
            self.data.qpos[finger] = (width or 0.0) / len(self.fingers)
        mujoco.mj_kinematics(self.model, self.data)
        return self.model, self.data


def without_arm(views: Sequence[PreparedPicture], arm: Scenery) -> list[PreparedPicture]:
    """Pictures with nothing read where an arm is, or near it."""
    from scipy.ndimage import (  # pyright: ignore[reportMissingTypeStubs]
        minimum_filter,  # pyright: ignore[reportUnknownVariableType]
    )

    found: list[PreparedPicture] = []
    for view in views:
        depth = true_depth([arm], view.device)
        shallow = np.where(depth > 0, depth, np.inf)
        near = cast("np.ndarray", minimum_filter(shallow, 2 * BESIDE_ARM + 1))
        shown = np.isfinite(near) & (np.abs(view.depth - near) < NEAR_ARM)
        found.append(view._replace(depth=np.where(shown, 0.0, view.depth)))
    return found


class CellCameras:
    """The cameras of a simulated cell: they see its blocks, its table and its arm.

    Args:
        arm: of the cell.
        cameras: as the layout has them.
        errors: by name, by how much a camera truly is elsewhere, see :class:`SimulatedCamera`.
        seed: of their noise.
    """

    def __init__(
        self,
        arm: Arm,
        cameras: Sequence[DepthCamera],
        errors: Mapping[str, Sequence[float] | np.ndarray] | None = None,
        seed: int = 0,
    ) -> None:
        given = errors or {}
        self.cameras: list[SimulatedCamera] = [
            SimulatedCamera(camera, given.get(camera.name, (0.0,) * 6), seed + k)
            for k, camera in enumerate(cameras)
        ]
        self.arm: ArmPicture = ArmPicture(arm)

    def look(self, solids: Sequence[tuple[Shape, np.ndarray]], arm: Readings) -> list[DepthPicture]:
        """One picture of each.

        Args:
            solids: blocks and their poses float64[7].
            arm: says where it is, and when.
        """
        scenes = still_scene(solids), self.arm.at(arm.joints, arm.tool.width)
        return [camera.look(scenes, arm.time) for camera in self.cameras]


def pictures_of(
    plant: Plant, setup: Setup, cameras: Sequence[DepthCamera]
) -> Callable[[], list[DepthPicture]] | None:
    """What takes pictures of a simulated cell, whose cameras may truly be elsewhere; None: the
    plant is none that can be looked at.

    Args:
        plant: that may say what there is (``solids``).
        setup: of it.
        cameras: where the layout has them.
    """
    there: Callable[[], list[tuple[Shape, np.ndarray]]] | None = getattr(plant, "solids", None)
    if there is None:
        return None
    told = setup.simulated
    off = dict(zip((one.name for one in cameras), told.disturbance.cameras, strict=False))
    eyes = CellCameras(setup.arm, cameras, off, told.seed)

    def look() -> list[DepthPicture]:
        return eyes.look(there(), plant.sense())

    return look
