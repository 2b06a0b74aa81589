"""Depth pictures of simulated scenes.

The rays are MuJoCo's: no graphics card is needed. A picture is noisy as that of structured light or
of a time-of-flight camera: an error that grows with the square of the distance, one that varies
slowly over the picture and stays, readings lost or mixed beside edges, and readings lost anywhere.
"""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import mujoco
import numpy as np

from learn2assemble.robot.arm import Arm, arm_model
from learn2assemble.robot.bodies import Shape
from learn2assemble.robot.scene import mesh_of
from learn2assemble.sensing.camera import DepthCamera, DepthNoise, DepthPicture, rotation

JUMP = 0.008
"""Neighbouring pixels whose depths differ by this share of them are beside an edge."""
Scenery = tuple[Any, Any]
"""A MuJoCo model and its data."""
WAVES = (6, 8)
"""Rows and columns of the grid between which the slowly varying error is smooth."""


def true_depth(model: mujoco.MjModel, data: mujoco.MjData, camera: DepthCamera) -> np.ndarray:
    """float64[rows, columns]: what a camera would read without noise [m]; 0 where nothing is within
    its range.

    Args:
        model: the scene.
        data: of it, with what is where (after ``mj_forward`` or ``mj_kinematics``).
        camera: where it truly is.
    """
    low, high = camera.range
    rays = camera.rays.reshape(-1, 3)
    length = np.linalg.norm(rays, axis=1)
    ways = (rays / length[:, None]) @ camera.turn.T
    count = len(rays)
    hit, far = np.empty(count, np.int32), np.empty(count)
    # The cutoff is compared with the boxes around geoms, so what remains is cut below.
    cutoff, start, flat = high * float(length.max()), camera.position, ways.ravel()
    mujoco.mj_multiRay(model, data, start, flat, None, True, -1, hit, far, None, count, cutoff)
    depth = far / length
    depth[(far < 0) | (depth < low) | (depth > high)] = 0.0
    return depth.reshape(camera.rays.shape[:2])


def noisy(
    depth: np.ndarray, noise: DepthNoise, waves: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """float64[rows, columns]: a true depth picture as it would be read once.

    Args:
        waves: float64[rows, columns], the error that varies slowly, in its standard deviations.
    """
    from scipy.ndimage import maximum_filter, minimum_filter

    there = depth > 0
    near = minimum_filter(np.where(there, depth, np.inf), 3)
    far = maximum_filter(depth, 3)
    beside = there & (far - near > JUMP * depth)
    out = depth + noise.sigma(depth) * rng.standard_normal(depth.shape) + noise.waves * waves
    draw = rng.random(depth.shape)
    mixed = beside & (draw < noise.edges * 1.5) & (draw >= noise.edges)
    out[mixed] = near[mixed] + rng.random(int(mixed.sum())) * (far - near)[mixed]
    lost = ~there | (beside & (draw < noise.edges)) | (rng.random(depth.shape) < noise.dropout)
    return np.where(lost | (out <= 0), 0.0, out)


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
        from scipy.ndimage import zoom

        given = np.array(error, float)
        self.camera = camera.moved(given[:3], rotation(given[3:]))
        self.rng = np.random.default_rng(seed)
        columns, rows = camera.resolution
        grid = self.rng.standard_normal(WAVES)
        self.waves = np.asarray(zoom(grid, (rows / WAVES[0], columns / WAVES[1]), order=1))

    def look(self, scenes: Sequence[Scenery], time: float = 0.0) -> DepthPicture:
        """What it sees of simulated scenes that are one, see :func:`true_depth` and
        :func:`noisy`."""
        depths = np.array([true_depth(*scene, self.camera) for scene in scenes])
        there = np.where(depths > 0, depths, np.inf).min(0)
        there, noise = np.where(np.isfinite(there), there, 0.0), self.camera.noise
        frames = np.array(
            [noisy(there, noise, self.waves, self.rng) for _ in range(self.camera.frames)]
        )
        return DepthPicture(self.camera.name, time, _median(frames).astype(np.float32))


def _median(frames: np.ndarray) -> np.ndarray:
    """float64[rows, columns] of float64[n, rows, columns]; of those that were read."""
    if len(frames) == 1:
        return frames[0]
    count = (frames > 0).sum(0)
    order = np.sort(np.where(frames > 0, frames, 1e9), axis=0)
    ends = np.maximum(count - 1, 0) // 2, np.where(count > 0, count // 2, 0)
    low, high = (np.take_along_axis(order, end[None], 0)[0] for end in ends)
    return np.where(count > 0, (low + high) / 2, 0.0)


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
        self.cameras = [
            SimulatedCamera(camera, given.get(camera.name, (0.0,) * 6), seed + k)
            for k, camera in enumerate(cameras)
        ]
        self.model = arm_model(arm)
        self.data = mujoco.MjData(self.model)
        names = [self.model.joint(name).qposadr[0] for name in arm.joints]
        self.joint = np.array(names)

    def look(
        self, solids: Sequence[tuple[Shape, np.ndarray]], joints: np.ndarray, time: float
    ) -> list[DepthPicture]:
        """One picture of each.

        Args:
            solids: blocks and their poses float64[7].
            joints: float64[n] of the arm [rad].
            time: [s of the plant's clock]
        """
        scene = still_scene(solids)
        self.data.qpos[self.joint] = joints
        mujoco.mj_kinematics(self.model, self.data)
        return [camera.look([scene, (self.model, self.data)], time) for camera in self.cameras]
