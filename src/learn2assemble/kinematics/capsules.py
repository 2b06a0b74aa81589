"""What space an arm takes up, as capsules that contain its solids: quick to put anywhere, and how
far two arms are from each other follows from them alone.

A capsule is what is within its radius of a line. The solids of our arms are capsules, most of them;
a cylinder is contained in one about its axis, a box in some side by side along its longest edge.
"""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple, cast

import mujoco
import numpy as np

from learn2assemble.kernels import kernel
from learn2assemble.kinematics.chain import Chain, get_chain, joint_frames
from learn2assemble.robot.arm import Arm, arm_model
from learn2assemble.robot.bodies import Part

WIDEST = 0.035
"""A box that is more than twice as wide is contained in several capsules side by side [m]."""
SHORTER = 0.5
"""The line of a capsule around a solid with flat ends ends before these by this share of the radius
of the solid: the capsule is a bit thicker, and stands out less beyond the ends."""


class Capsules(NamedTuple):
    """Of an arm with n joints, and perhaps of what it holds."""

    link: np.ndarray
    """int64[c]: number of the joint each moves with, from 1; 0 for those of the base."""
    ends: np.ndarray
    """float64[c, 2, 3]: ends of their lines in the frame of that joint, or in the world [m]."""
    radius: np.ndarray
    """float64[c] [m]."""

    def add(self, other: Capsules) -> Capsules:
        """These and others."""
        return Capsules(*(np.concatenate(both) for both in zip(self, other, strict=True)))

    def reach(self, chain: Chain) -> np.ndarray:
        """float64[n]: no point of what a joint moves is farther from its axis [m]."""
        steps = np.linalg.norm(chain.offset, axis=1)
        out = np.zeros(len(steps))
        size = np.linalg.norm(self.ends, axis=2).max(1) + self.radius
        for link, far in zip(self.link.tolist(), size.tolist(), strict=True):
            for joint in range(link - 1, -1, -1):
                out[joint] = max(out[joint], far)
                far += steps[joint]
        return out


@lru_cache(maxsize=16)
def capsules_of(arm: Arm) -> Capsules:
    """Those that contain the solids of an arm, its tool and its fingers however far these are
    open."""
    model, chain, n = arm_model(arm), get_chain(arm), len(arm.joints)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    frames = np.empty((n, 3)), np.empty((n, 3, 3))
    start = data.qpos[[model.joint(name).qposadr[0] for name in arm.joints]].copy()
    joint_frames(chain, start, *frames)
    moved_by = {int(model.joint(name).bodyid[0]): k for k, name in enumerate(arm.joints, 1)}
    slides = [model.joint(name).id for name in arm.gripper.joints]
    links, ends, radii = list[int](), list[np.ndarray](), list[float]()
    for geom in np.flatnonzero(model.geom_contype | model.geom_conaffinity).tolist():
        lines, radius = _around(model, geom)
        place, turn = data.geom_xpos[geom], data.geom_xmat[geom].reshape(3, 3)
        line = place + lines @ turn.T
        body, link = int(model.geom_bodyid[geom]), 0
        while body and body not in moved_by:
            for joint in slides:
                if model.jnt_bodyid[joint] == body:
                    # Half of its way farther on it is never more than that away.
                    way = (model.jnt_range[joint] - data.qpos[model.jnt_qposadr[joint]]).mean()
                    line = line + way * data.xaxis[joint]
                    radius += float(np.ptp(model.jnt_range[joint])) / 2
            body = int(model.body_parentid[body])
        if body:
            link = moved_by[body]
            line = (line - frames[0][link - 1]) @ frames[1][link - 1]
        links += [link] * len(line)
        ends += list(line)
        radii += [radius] * len(line)
    return Capsules(np.array(links), np.array(ends), np.array(radii))


def _around(model: mujoco.MjModel, geom: int) -> tuple[np.ndarray, float]:
    """Capsules around a geom in its own frame: their lines float64[k, 2, 3] [m] and their radius
    [m]."""
    kind = mujoco.mjtGeom(int(model.geom_type[geom]))
    radius, length, _ = model.geom_size[geom]
    if kind in (mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_CYLINDER):
        short = 0.0
        if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
            short = min(SHORTER * radius, length)
        end = np.array([0.0, 0.0, length - short])
        return np.array([[-end, end]]), float(np.hypot(radius, short))
    # Of the box around it, whatever it is.
    middle, half = model.geom_aabb[geom].reshape(2, 3)
    return _box(middle, half)


def _box(middle: np.ndarray, half: np.ndarray, widest: float = WIDEST) -> tuple[np.ndarray, float]:
    """The same of a box, whose half extents are ``half`` float64[3] [m]."""
    *across, long = np.argsort(half, kind="stable").tolist()
    counts = np.ceil(half[across] / widest - 1e-9).astype(int).clip(1)
    radius = float(np.hypot(*(half[across] / counts)))
    short = min(SHORTER * radius, half[long])
    lines = np.zeros((*counts, 2, 3))
    numbers: list[int] = counts.tolist()
    for k, (axis, count) in enumerate(zip(across, numbers, strict=True)):
        middles = ((2 * np.arange(count) + 1) / count - 1) * half[axis]
        lines[..., axis] = middles.reshape((count, 1, 1) if k == 0 else (count, 1))
    lines[..., long] = (half[long] - short) * np.array([-1.0, 1.0])
    return middle + lines.reshape(-1, 2, 3), float(np.hypot(radius, short))


def solid_capsules(
    parts: Sequence[Part], position: np.ndarray, turn: np.ndarray, widest: float = WIDEST
) -> Capsules:
    """Those that contain a block that stands somewhere.

    Args:
        parts: of it.
        position: float64[3] of its frame [m], and
        turn: float64[3, 3], its rotation.
        widest: half a box that has one capsule [m].
    """
    ends, radii = list[np.ndarray](), list[float]()
    for part in parts:
        lines, radius = _solid(part, widest)
        ends += list(position + lines @ turn.T)
        radii += radius
    return Capsules(np.zeros(len(ends), np.int64), np.array(ends), np.array(radii))


@lru_cache(maxsize=4096)
def _solid(part: Part, widest: float) -> tuple[np.ndarray, list[float]]:
    """Capsules around a convex part in its block's frame: lines float64[k, 2, 3] and radii [m].

    They lie side by side along that axis on which the shadow of the part, drawn out, is least
    larger than it: each is around a piece of the shadow.
    """
    import shapely

    low, high = part.points.min(0), part.points.max(0)
    if part.hull is None:
        lines, radius = _box((low + high) / 2, (high - low) / 2, widest)
        return lines, [radius] * len(lines)
    library = cast("Any", shapely)  # Its stubs have arguments without a type.
    shadows = [library.MultiPoint(np.delete(part.points, k, 1)).convex_hull for k in range(3)]
    drawn = [shadow.area * long for shadow, long in zip(shadows, high - low, strict=True)]
    axis = min(range(3), key=lambda k: (round(drawn[k] / part.volume, 6), low[k] - high[k]))
    others = [k for k in range(3) if k != axis]
    corner, size = low[others], (high - low)[others]
    counts = np.ceil(size / 2 / widest - 1e-9).astype(int).clip(1)
    lines, radii = list[np.ndarray](), list[float]()
    for cell in np.ndindex(*counts.tolist()):
        start, end = (corner + size * (np.array(cell) + k) / counts for k in (0, 1))
        piece = library.get_coordinates(shadows[axis].intersection(library.box(*start, *end)))
        if not len(piece):
            continue
        middle = (piece.min(0) + piece.max(0)) / 2
        radius = float(np.linalg.norm(piece - middle, axis=1).max())
        half = float(high[axis] - low[axis]) / 2
        short = min(SHORTER * radius, half)
        line = np.empty((2, 3))
        line[:, others] = middle
        line[:, axis] = (low[axis] + high[axis]) / 2 + (half - short) * np.array([-1.0, 1.0])
        lines.append(line)
        radii.append(float(np.hypot(radius, short)))
    return np.array(lines), radii


def in_hand(arm: Arm, block: Capsules) -> Capsules:
    """Those of a block that is held, given in the frame of the tool."""
    chain, n = get_chain(arm), len(arm.joints)
    ends = chain.tool_offset + block.ends @ chain.tool_turn.T
    return Capsules(np.full(len(block.link), n), ends, block.radius)


# ---------------------------------------------------------------- compiled


@kernel
def placed(chain: Chain, capsules: Capsules, joints: np.ndarray) -> np.ndarray:
    """The lines float64[m, c, 2, 3] [m, world] of capsules at joints float64[m, n] [rad]."""
    m, n = joints.shape
    count = capsules.link.shape[0]
    out = np.empty((m, count, 2, 3))
    positions, rotations = np.empty((n, 3)), np.empty((n, 3, 3))
    for t in range(m):
        joint_frames(chain, joints[t], positions, rotations)
        for c in range(count):
            link = capsules.link[c]
            for e in range(2):
                for i in range(3):
                    value = capsules.ends[c, e, i]
                    if link:
                        value = positions[link - 1, i]
                        for j in range(3):
                            value += rotations[link - 1, i, j] * capsules.ends[c, e, j]
                    out[t, c, e, i] = value
    return out


@kernel
def between_lines(a: np.ndarray, b: np.ndarray) -> float:
    """Distance of two lines with ends float64[2, 3] [m]."""
    ux, uy, uz = a[1, 0] - a[0, 0], a[1, 1] - a[0, 1], a[1, 2] - a[0, 2]
    vx, vy, vz = b[1, 0] - b[0, 0], b[1, 1] - b[0, 1], b[1, 2] - b[0, 2]
    wx, wy, wz = a[0, 0] - b[0, 0], a[0, 1] - b[0, 1], a[0, 2] - b[0, 2]
    uu, vv = ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz
    uv = ux * vx + uy * vy + uz * vz
    uw, vw = ux * wx + uy * wy + uz * wz, vx * wx + vy * wy + vz * wz
    det = uu * vv - uv * uv
    s = 0.0
    if det > 1e-12 * uu * vv:
        s = min(max((uv * vw - vv * uw) / det, 0.0), 1.0)
    t = 0.0
    if vv > 0.0:
        t = min(max((uv * s + vw) / vv, 0.0), 1.0)
    if uu > 0.0:
        s = min(max((uv * t - uw) / uu, 0.0), 1.0)
    x, y, z = wx + s * ux - t * vx, wy + s * uy - t * vy, wz + s * uz - t * vz
    return np.sqrt(x * x + y * y + z * z)


@kernel
def apart(
    lines: np.ndarray, radius: np.ndarray, others: np.ndarray, other_radius: np.ndarray
) -> float:
    """Distance of two sets of capsules [m], lines float64[c, 2, 3] and float64[d, 2, 3]."""
    least = np.inf
    for c in range(lines.shape[0]):
        for d in range(others.shape[0]):
            least = min(least, between_lines(lines[c], others[d]) - radius[c] - other_radius[d])
    return least
