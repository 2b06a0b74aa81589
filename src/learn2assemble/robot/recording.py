"""What the arm was told and did during a pick and place, at equal steps of time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

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
    """float64[t]: opening between the pads [m], as it was."""
    command: np.ndarray
    """float64[t]: opening the gripper was told [m]; less than what it holds where it presses."""
    payload: np.ndarray
    """float64[t]: mass at the tool point the controller was told of [kg]."""
    stage: np.ndarray
    """int8[t]: index into :data:`STAGES`."""
    pose: np.ndarray
    """float64[t, c, 7]: centre [m] and quaternion (w, x, y, z) of every cell of the scene before
    the move, in its order (world)."""

    @property
    def duration(self) -> float:
        """[s]"""
        return float(self.time[-1]) if len(self.time) else 0.0


class Recorder:
    """Collects samples; one attempt each."""

    def __init__(self) -> None:
        self._rows: list[tuple[float, np.ndarray, np.ndarray, float, float, float, int]] = []
        self._poses: list[np.ndarray] = []

    def add(
        self,
        time: float,
        joints: np.ndarray,
        velocity: np.ndarray,
        width: float,
        command: float,
        payload: float,
        stage: str,
        poses: np.ndarray,
    ) -> None:
        """Append a sample; ``poses`` float64[b, 7] are those of the objects."""
        number = STAGES.index(stage)
        row = (time, joints.copy(), velocity.copy(), width, command, payload, number)
        self._rows.append(row)
        self._poses.append(poses.copy())

    def first_poses(self) -> np.ndarray:
        """float64[b, 7]: of the objects at the beginning."""
        return self._poses[0]

    @property
    def joints(self) -> np.ndarray:
        """float64[T, n]: joint positions so far [rad]."""
        return np.array([row[1] for row in self._rows])

    def trajectory(self, owner: np.ndarray, offset: np.ndarray) -> Trajectory:
        """All samples; cell c of object ``owner[c]`` lies at ``offset[c]`` in its frame [m]."""
        time, joints, velocity, width, command, payload, stage = (
            np.array(column) for column in zip(*self._rows, strict=True)
        )
        poses = np.array(self._poses)[:, owner]
        poses[..., :3] += rotated(poses[..., 3:], offset)
        return Trajectory(
            time, joints, velocity, width, command, payload, stage.astype(np.int8), poses
        )


def rotated(quaternion: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Vectors float64[..., 3] turned by quaternions float64[..., 4] (w, x, y, z)."""
    w, axis = quaternion[..., :1], quaternion[..., 1:]
    across = 2 * np.cross(axis, vector)
    return vector + w * across + np.cross(axis, across)
