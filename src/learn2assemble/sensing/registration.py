"""Poses of blocks of known shapes from depth pictures, near where they are believed to be.

What pictures say (:mod:`learn2assemble.sensing.residuals`) is added up, with how far the block may
be off as a weak prior. Along directions of which they say nothing the covariance of the result is
as wide as the search, so a filter keeps what it knew.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from learn2assemble.geometry.rotations import matrix_quaternion, quaternion_matrix, stepped_pose
from learn2assemble.robot.bodies import Shape
from learn2assemble.sensing.faceted import Faceted, faceted
from learn2assemble.sensing.residuals import (
    BEYOND,
    FEW,
    MANY,
    PreparedPicture,
    Sums,
    normal_equations,
)
from learn2assemble.sensing.resting import rested

SEARCH, SEARCH_TURN = 0.008, np.radians(6.0)
"""How far from where it is believed a block is looked for: standard deviations [m], [rad]."""
REACH = 10
"""Outlines are looked for so many pixels on both sides of where they are believed, at most."""
FARTHEST = 3.0
"""So many standard deviations of the search from where it is believed a block may be: outlines
farther off are those of others, and a pose that is farther off is not the block's."""
ROUNDS, LAST_ROUNDS, LEAST_REACH = 11, 5, 4
"""So often a pose is improved; in the last rounds outlines are looked for within the same few
pixels: a step that was made for an outline which is none at close range is taken back."""
ENOUGH = 2.5
"""A direction along which the pictures do not tell so many times more than the search does is left
as it is believed: what little they tell there comes from stray pixels."""
NOTHING = 0.02
"""Share of the search that the covariance of a reading has of what no picture says: whoever
averages readings must not take where a block was looked for for where it was seen."""
LEAST = 30
"""Pixels without which a block does not count as seen."""


class Believed(NamedTuple):
    """A block as it is looked for."""

    block: str
    shape: Shape
    pose: np.ndarray | None
    """float64[7]: x, y, z [m] and quaternion (w, x, y, z) of the frame of the shape; None: it is
    lost, and looked for anywhere."""
    turns: tuple[np.ndarray, ...] = (np.eye(3),)
    """Rotations float64[3, 3] of that frame that leave the shape as it is."""
    search: tuple[float, float] = (SEARCH, float(SEARCH_TURN))
    """How far it may be off: standard deviations [m], [rad]."""
    alone: bool = False
    """Whether it stands on the table and touches nothing else: then height and lean follow."""


class Look(StrEnum):
    """What came of looking for a block."""

    SEEN = "seen"
    HIDDEN = "hidden"
    """Something is before it, or nothing was read there."""
    ABSENT = "absent"
    """What is behind its place is seen."""


class Seen(NamedTuple):
    """A block as registration leaves it."""

    block: str
    look: Look
    pose: np.ndarray
    """float64[7]; where it is believed unless it was seen."""
    covariance: np.ndarray
    """float64[6, 6]: position [m] and small rotation about the axes of the world [rad]."""
    pixels: int
    """That lie on its faces."""
    behind: int = 0
    """Pixels that show what is behind it."""


def register(views: Sequence[PreparedPicture], believed: Believed) -> Seen:
    """Where a block is, from pictures.

    Args:
        views: from :func:`~learn2assemble.sensing.residuals.views_of`.
        believed: the block, with a pose.

    Returns:
        the equivalent pose that is nearest to the one believed.
    """
    assert believed.pose is not None
    start, shape = np.array(believed.pose, float), faceted(believed.shape)
    pose, sums = _fitted(views, shape, start, believed.search)
    look = _looks_near(sums, pose, start, believed)
    if look != Look.SEEN:
        # Blocks of one height that touch have outlines in common: one may be drawn to the place of
        # its neighbour. It has left its own only if that explains more of the pictures.
        here = normal_equations(views, shape, start, BEYOND, LEAST_REACH)
        if _worth(here.counts) >= _worth(sums.counts):
            pose, sums = _fitted(views, shape, start, believed.search, outlines=False)
            look = _looks_near(sums, pose, start, believed)
            if look != Look.SEEN:
                sums, look = here, _looks(here.counts)
                look = Look.HIDDEN if look == Look.SEEN else look
    worse = max(1.0, sums.squares / max(int(sums.counts[0]) - 6, 1))
    prior = _prior(believed.search)
    known, _ = what_is_told(sums.information, sums.gradient, prior)
    covariance = np.linalg.inv(known / worse + NOTHING * prior)
    on, border, _, behind, _ = sums.counts.tolist()
    if look != Look.SEEN:
        return Seen(believed.block, look, start, covariance, on + border, behind)
    covariance = (covariance + covariance.T) / 2 + _of_cameras(views, pose, sums.of_face)
    stands = rested(pose, covariance, believed.shape) if believed.alone else None
    if stands is not None:
        pose, covariance = stands
    pose = _nearest(pose, start, believed.turns)
    return Seen(believed.block, look, pose, covariance, on + border, behind)


def _prior(search: tuple[float, float]) -> np.ndarray:
    """float64[6, 6]: what a search says of a small motion."""
    place, turn = search
    return np.diag([1 / place**2] * 3 + [1 / turn**2] * 3)


def _fitted(
    views: Sequence[PreparedPicture],
    shape: Faceted,
    start: np.ndarray,
    search: tuple[float, float],
    outlines: bool = True,
) -> tuple[np.ndarray, Sums]:
    """The pose float64[7] near one believed that fits the pictures best, and what they say there.

    Args:
        start: float64[7], the one believed.
        search: as :attr:`Believed.search`.
        outlines: whether outlines count, or faces only.
    """
    place, turn = search
    prior, pose, offset = _prior(search), start.copy(), np.zeros(6)
    scale = max((view.device.focal / _depth(view, start) for view in views), default=0.0)
    farthest = min(REACH, math.ceil(FARTHEST * place * scale))
    for number in range(ROUNDS):
        last = number >= ROUNDS - LAST_ROUNDS
        gate = max(BEYOND, place * 0.6**number)
        reach = LEAST_REACH if last else max(LEAST_REACH, min(REACH - number, farthest))
        reach = reach if outlines else 0
        sums = normal_equations(views, shape, pose, gate, reach, FEW if number < 4 else MANY)
        if sums.counts[0] < LEAST // 4:
            break
        known, pull = what_is_told(sums.information, sums.gradient, prior)
        step = np.linalg.solve(known + prior, pull - prior @ offset)
        step[:3] = step[:3].clip(-place, place)
        step[3:] = step[3:].clip(-2 * turn, 2 * turn)
        pose, offset = stepped_pose(pose, step), offset + step
        if last and np.abs(step[:3]).max() < 5e-5 and np.abs(step[3:]).max() < 1e-3:
            break
    return pose, normal_equations(views, shape, pose, BEYOND, LEAST_REACH if outlines else 0)


def _depth(view: PreparedPicture, pose: np.ndarray) -> float:
    """How far a place is before a camera [m]."""
    return max(float((pose[:3] - view.device.position) @ view.device.turn[:, 2]), 0.01)


def _worth(counts: np.ndarray) -> int:
    """Pixels that a pose explains, less those that contradict it twice."""
    on, border, _, behind, _ = counts.tolist()
    return on + border - 2 * behind


def _looks_near(sums: Sums, pose: np.ndarray, start: np.ndarray, believed: Believed) -> Look:
    """Whether a block is where it was found, which is not too far from where it was looked for."""
    look = _looks(sums.counts)
    far = float(np.linalg.norm(pose[:3] - start[:3])) > FARTHEST * believed.search[0]
    return Look.ABSENT if look == Look.SEEN and far else look


def what_is_told(
    information: np.ndarray, gradient: np.ndarray, prior: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Information and gradient along those directions of which the pictures tell enough.

    Args:
        information: float64[6, 6] of the pictures.
        gradient: float64[6]
        prior: float64[6, 6], diagonal: the same of the search.
    """
    scale = 1 / np.sqrt(np.diag(prior))
    told, axes = np.linalg.eigh(information * np.outer(scale, scale))
    axes = axes[:, told >= ENOUGH**2]
    onto = (axes @ axes.T) * scale[:, None] / scale
    return onto.T @ information @ onto, onto.T @ gradient


def _looks(counts: np.ndarray) -> Look:
    """Whether a block is where it was looked for, from how many pixels are what."""
    on, border, before, behind, missing = counts.tolist()
    there = on + border
    if on >= LEAST and there > behind and there > 0.15 * (there + before + behind + missing):
        return Look.SEEN
    return Look.ABSENT if behind > there and behind > 0.3 * (before + missing) else Look.HIDDEN


def _of_cameras(
    views: Sequence[PreparedPicture], pose: np.ndarray, of_face: Sequence[np.ndarray]
) -> np.ndarray:
    """float64[6, 6]: what the uncertain poses of cameras add, by how much each has seen."""
    total, added = sum(float(k.sum()) for k in of_face) + 1e-9, np.zeros((6, 6))
    for view, seen in zip(views, of_face, strict=True):
        if view.device.covariance is None:
            continue
        x, y, z = pose[:3] - view.device.position
        # A camera turned by w moves what it sees by w x arm.
        onto = np.eye(6)
        onto[:3, 3:] = [[0, z, -y], [-z, 0, x], [y, -x, 0]]
        share = float(seen.sum()) / total
        added += share * onto @ np.array(view.device.covariance) @ onto.T
    return added


def _nearest(pose: np.ndarray, start: np.ndarray, turns: Sequence[np.ndarray]) -> np.ndarray:
    """Of the poses in which a block looks the same the one turned least from another."""
    if len(turns) < 2:
        return pose
    now, then = quaternion_matrix(pose[3:]), quaternion_matrix(start[3:])
    best = max(turns, key=lambda turn: round(float(np.trace(then.T @ now @ turn)), 9))
    return np.array([*pose[:3], *matrix_quaternion(now @ best)])
