"""Open loop: the same commands to the same cell, without looking."""

from __future__ import annotations

import numpy as np

from learn2assemble.errors import InputError
from learn2assemble.robot.dynamic import DynamicCell
from learn2assemble.robot.execution import BLIND, REST_TIME
from learn2assemble.robot.mjcf import TIMESTEP
from learn2assemble.robot.order import rigid_objects
from learn2assemble.robot.recording import Trajectory
from learn2assemble.robot.scene import Scene
from learn2assemble.robot.simulate import Simulation
from learn2assemble.robot.trajectory import Motion


def replay(
    cell: DynamicCell, scene: Scene, recorded: Trajectory, quaternion: np.ndarray | None = None
) -> tuple[Scene, np.ndarray]:
    """Send recorded joint positions, velocities and gripper commands to the drives again.

    Between two samples the joints follow the cubic that has their positions and velocities.

    Args:
        cell: the cell of the recording.
        scene: as things were before it.
        recorded: of an attempt.
        quaternion: float64[n, 4] orientations of the cells where not all stand upright.

    Returns:
        the scene as it is afterwards, in the order it has before, and float64[n, 4] orientations
        of its cells.

    Raises:
        InputError: where the recording has fewer than two samples.
    """
    if len(recorded.time) < 2:
        raise InputError("trajectory", len(recorded.time), "two samples or more")
    objects, poses, names = rigid_objects(scene, quaternion)
    world = cell.world(objects)
    sim = Simulation(
        cell.arm, world, poses, names, 0, recorded.joints[0], float(recorded.width[0]),
        cell.sample_steps, cell.dump,
    )  # fmt: skip
    motion, widths, payloads = _every_step(recorded)
    sim.run(motion, widths, "approach", BLIND, payloads)
    sim.wait(round(REST_TIME / TIMESTEP), "home", BLIND._replace(until=sim.asleep))
    position, turns, yaw = objects.cells(sim.poses)
    return scene._replace(position=position, yaw=yaw), turns


def _every_step(recorded: Trajectory) -> tuple[Motion, np.ndarray, np.ndarray]:
    """Samples one simulation step apart, openings [m] and payloads [kg]."""
    t = recorded.time
    now = np.arange(1, round((t[-1] - t[0]) / TIMESTEP) + 1) * TIMESTEP + t[0]
    k = np.clip(np.searchsorted(t, now - 1e-9) - 1, 0, len(t) - 2)
    h = (t[k + 1] - t[k])[:, None]
    u = (now - t[k])[:, None] / h
    p, q = recorded.joints[k], recorded.joints[k + 1]
    v, w = recorded.velocity[k] * h, recorded.velocity[k + 1] * h
    # Cubic Hermite polynomial of positions p, q and slopes v, w.
    c2, c3 = 3 * (q - p) - 2 * v - w, 2 * (p - q) + v + w
    position = p + u * (v + u * (c2 + u * c3))
    velocity = (v + u * (2 * c2 + u * 3 * c3)) / h
    acceleration = (2 * c2 + u * 6 * c3) / h**2
    widths, payloads = (np.interp(now, t, told) for told in (recorded.command, recorded.payload))
    return Motion(np.zeros((len(now), 3)), position, velocity, acceleration), widths, payloads
