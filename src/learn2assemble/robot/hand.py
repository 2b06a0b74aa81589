"""What the hand of an arm can give a block that it holds in its place.

Three limits bound it, all linear in the wrench on the block or made so from inside
(:mod:`~learn2assemble.geometry.circles`): the tool (a cup comes off, slips or tilts, see
:mod:`.tool`; fingers slip, and pads turn), the payload of the arm, and the torques of its joints
at that pose, of which its own weight takes its part. A plan counts on :data:`SHARE` of it.
"""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import mujoco
import numpy as np

from learn2assemble.constants import GRAVITY
from learn2assemble.geometry.circles import ball
from learn2assemble.robot.arm import Arm, arm_model
from learn2assemble.robot.moves import Move
from learn2assemble.robot.tool import Cup, Gripper

SHARE = 0.8
"""Of what tool and joints can bear, what a plan counts on; a payload is safe as it is rated."""
PAD = 0.0075
"""Half the width of a pad, over which a finger presses [m]."""
PAD_FRICTION = 0.8
"""Of pads on blocks; rubber on stone or wood has more."""


class HandLimits(NamedTuple):
    """The wrenches that a hand can give, about a point of the world, as linear inequalities."""

    point: np.ndarray
    """float64[3] [m]"""
    rows: np.ndarray
    """float64[k, 6]: of a force and a moment, world frame."""
    most: np.ndarray
    """float64[k]: what each of them times a wrench is at most."""


def hand_limits(arm: Arm, move: Move, joints: np.ndarray) -> HandLimits:
    """The wrenches that an arm can give a block that it has put down and still holds.

    Args:
        arm: at its base.
        move: by which the block came.
        joints: float64[n], of the arm with the block in its place [rad].
    """
    tool, point = move.place.rotation(), move.place.tool_point(move.target)
    limits: list[tuple[np.ndarray, np.ndarray]] = []
    if arm.suction is None:
        limits.append(_turned(_fingers(arm.gripper), tool))
    else:
        cup = next(one for one in arm.suction.cups if one.lip == move.place.lip)
        point = point + tool @ np.array(cup.lip.at)
        limits.append(_turned(tool_limits(cup), tool @ cup.lip.frame()))
    if math.isfinite(arm.payload):
        ways, share = ball(3)
        rows = np.hstack([ways, np.zeros_like(ways)])
        carried = arm.payload - (arm.suction.mass if arm.suction else 0.0)
        most = np.full(len(ways), share * GRAVITY * carried / SHARE)
        limits.append(_turned((rows, most), tool))
    limits.append(_torques(arm, joints, point))
    rows = np.vstack([one for one, _ in limits])
    most = SHARE * np.concatenate([one for _, one in limits])
    return HandLimits(point, rows, most)


def tool_limits(cup: Cup) -> tuple[np.ndarray, np.ndarray]:
    """Inequalities of what a cup gives, along its axes about the middle of its lip.

    With the pull N, the moment M that tilts it, S along the face and T about the axis:
    N + |M| / r <= F and (S / S_max)^2 + (T / T_max)^2 <= (1 - N / F)^2, also with N = 0 where it
    is pressed on; a socket, N + max(|M_x|, |M_y|) / r <= F, and tilts less where it presses.
    """
    flat, share = (np.vstack([np.eye(2), -np.eye(2)]), 1.0) if cup.studs else ball(2)
    full = cup.pull_off * cup.radius
    tilts = np.zeros((len(flat), 6))
    tilts[:, 3:5] = flat / (share * full)
    ways, share = ball(3)
    slips = np.zeros((len(ways), 6))
    slips[:, [0, 1, 5]] = ways / [cup.shear, cup.shear, cup.torsion] / share
    # The block pulls on the cup where the cup pulls on it: against the axis that points out of it.
    pull = [0.0, 0.0, 1.0 / cup.pull_off, 0.0, 0.0, 0.0]
    rows = [slips, slips - pull, tilts - pull] if cup.studs else [tilts, slips]
    if not cup.studs:
        rows += [row - pull for row in rows]
    return np.vstack(rows), np.ones(sum(map(len, rows)))


def _fingers(gripper: Gripper) -> tuple[np.ndarray, np.ndarray]:
    """The same of fingers, which close along y: one of them may lose its force to a push along
    it; friction of both carries what is across; pads tilt where a moment brings all the force of
    one to its edge."""
    force = gripper.force
    ways, share = ball(3)
    slips = np.zeros((len(ways), 6))
    across = 2 * PAD_FRICTION * force
    slips[:, [0, 2, 4]] = ways / [across, across, across * 2 / 3 * PAD] / share
    along = np.array([0.0, 1.0, 0.0, 0.0, 0.0, 0.0])
    flat, share = ball(2)
    tilts = np.zeros((len(flat), 6))
    tilts[:, [3, 5]] = flat / (share * force * PAD)
    rows = np.vstack([slips, along / force, -along / force, tilts])
    return rows, np.ones(len(rows))


def _turned(
    limits: tuple[np.ndarray, np.ndarray], turn: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Inequalities along the axes float64[3, 3] (columns, world frame), along those of the
    world."""
    rows, most = limits
    return np.hstack([rows[:, :3] @ turn.T, rows[:, 3:] @ turn.T]), most


def _torques(arm: Arm, joints: np.ndarray, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Inequalities of the torques of the joints, what gravity leaves of them, for a wrench about a
    point of the world float64[3] [m]."""
    model = arm_model(arm)
    data = mujoco.MjData(model)
    where, limit = _motors(arm)
    data.qpos[model.jnt_qposadr[where]] = joints
    mujoco.mj_forward(model, data)
    dof = model.jnt_dofadr[where]
    weight = data.qfrc_bias[dof]
    linear, angular = np.empty((3, model.nv)), np.empty((3, model.nv))
    body = model.site(arm.tool).bodyid[0]
    mujoco.mj_jac(model, data, linear, angular, point, body)
    arm_rows = np.vstack([linear, angular])[:, dof].T
    rows = np.vstack([arm_rows, -arm_rows])
    most = np.concatenate([limit - weight, limit + weight])
    # A joint near the axis of everything moves nothing there.
    some = (np.linalg.norm(rows, axis=1) > 1e-9) & np.isfinite(most)
    return rows[some], np.maximum(most[some], 0.0)


@lru_cache(maxsize=16)
def _motors(arm: Arm) -> tuple[np.ndarray, np.ndarray]:
    """Of the joints of an arm: their numbers, and the largest torques of their motors [N m],
    infinite where its model has no limit."""
    model = arm_model(arm)
    where = np.array([model.joint(name).id for name in arm.joints])
    limit = np.full(len(where), np.inf)
    for k, joint in enumerate(where.tolist()):
        moved = (model.actuator_trnid[:, 0] == joint) & (model.actuator_forcelimited > 0)
        limit[k] = model.actuator_forcerange[moved, 1].min(initial=np.inf)
    return where, limit
