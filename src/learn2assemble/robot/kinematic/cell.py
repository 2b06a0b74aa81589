"""The arm without dynamics: can it reach, and does it touch anything on the way?

The cheap fidelity, for training and search. It moves nothing and decides nothing about balance;
:mod:`learn2assemble.physics` does.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

import numpy as np

from learn2assemble.geometry.rotations import yaw_matrix
from learn2assemble.robot.approach import RISE, ApproachCache
from learn2assemble.robot.arm import Arm
from learn2assemble.robot.kinematic.collision import MAX_SIZED, BoxChecker, Collision
from learn2assemble.robot.moves import (
    ROOM,
    Attempt,
    Move,
    Outcome,
    Scene,
    carried,
    crossing_height,
    grip_width,
    overload,
    turned,
    turns,
)

STRIDE = 0.25
"""Largest step of a joint between two checks of a free motion [rad]."""
DETOUR = 0.10
"""How much higher the tool crosses where the straight way is blocked [m]."""
STAGES = ("pick", "lift", "place", "cross", "release", "retreat")


class KinematicCell:
    """Reach, joint limits and collisions of one arm, for scenes of at most ``num_cells`` cubes, or
    any number of boxes.

    Joint solutions over a place are remembered, so repeated places cost collision checks only.
    A move is tried as ordered and with the fingers exchanged. One instance serves one thread.
    """

    name = "kinematic"

    def __init__(self, arm: Arm, num_cells: int = 40) -> None:
        self.arm = arm
        self.approaches = ApproachCache(arm)
        self.collisions = self._cubes = BoxChecker(arm, num_cells)
        self._boxes: BoxChecker | None = None

    def attempt(self, scene: Scene, move: Move) -> Attempt:
        """Outcome of a move; the scene is left alone."""
        why = overload(self.arm, scene, move)
        if why is not None:
            return Attempt(Outcome.GRASP_LOST, "lift", why)
        best = self._attempt(scene, move)
        # Turning the hand moves the wrist, not what is at its end, unless that is lopsided.
        only_wrist = self.arm.suction is None or self.arm.suction.round
        for turn in turns(self.arm, move):
            hand = only_wrist and not best.by_link
            if best.reached or (best.outcome != Outcome.UNREACHABLE and hand):
                break
            found = self._attempt(scene, turned(move, turn))
            best = found if _further(found) > _further(best) else best
        return best

    def _checker(self, scene: Scene) -> BoxChecker:
        """A checker with room for the boxes of a scene."""
        if scene.half is None:
            return self._cubes
        count, known = len(scene.position), self._boxes
        largest = int(np.unique(scene.object_id, return_counts=True)[1].max())
        if known is None or known.num_cells < count or known.most < largest:
            room = 32 * math.ceil(1.25 * count / 32)
            known = self._boxes = BoxChecker(self.arm, room, True, max(MAX_SIZED, largest))
        return known

    def pick(self, scene: Scene, move: Move) -> Attempt:
        """The first half of a move: what lies at its target does not matter, its height does."""
        self.collisions = self._checker(scene)
        held = grip_width(scene, move.cell, move.grasp)
        opening = held + ROOM
        height = crossing_height(scene, move)
        pick = self.approaches.solve(scene.position[move.cell], move.grasp, height)
        if isinstance(pick, str):
            return Attempt(Outcome.UNREACHABLE, "pick", pick)
        self.collisions.place(scene)
        self._open_hand()
        hit = self._first(pick, opening) or self._first(between(self.arm.home, pick[-1]), opening)
        if hit:
            return _failed(Outcome.GRASP_COLLISION, "pick", hit)
        self._grip(scene, move, scene.members(move.cell))
        hit = self._first(pick[1:], held)
        if hit:
            return _failed(Outcome.GRASP_COLLISION, "lift", hit)
        return Attempt(Outcome.REACHED, pick=pick)

    def _attempt(self, scene: Scene, move: Move) -> Attempt:
        picked = self.pick(scene, move)
        pick, height = picked.pick, crossing_height(scene, move)
        held = grip_width(scene, move.cell, move.grasp)
        opening = held + ROOM
        if pick is None:
            return picked
        members = scene.members(move.cell)
        place = self.approaches.solve(move.target, move.place, height, True)
        # What comes from the side sets down from above, and leaves to the side.
        leave = self.approaches.solve(move.target, move.place, height)
        if isinstance(place, str):
            return Attempt(Outcome.UNREACHABLE, "place", place)
        if isinstance(leave, str):
            return Attempt(Outcome.UNREACHABLE, "release", leave)
        hit = self._first(place, held)
        if hit:
            return _failed(Outcome.PLACE_COLLISION, "place", hit)
        hit = self._first(between(pick[-1], place[-1]), held)
        if hit:
            over = self._detour(scene, move, height, held)
            if over is None:
                return _failed(Outcome.UNREACHABLE, "cross", hit)
            pick, place = over
            leave = leave if move.place.sideways else place
        # The object now stands at its target and is in the way like all others.
        self.collisions.put(members, *carried(scene, move, members))
        self._open_hand()
        hit = self._first(leave if move.place.sideways else leave[: len(RISE)], opening)
        if hit:
            return _failed(Outcome.PLACE_COLLISION, "release", hit)
        hit = self._first(between(leave[-1], self.arm.home), opening)
        if hit:
            return _failed(Outcome.PLACE_COLLISION, "retreat", hit)
        return Attempt(Outcome.REACHED, pick=pick, place=place)

    def _detour(
        self, scene: Scene, move: Move, height: float, held: float
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Approaches whose tops are joined by a free motion, higher up."""
        pick = self.approaches.solve(scene.position[move.cell], move.grasp, height + DETOUR)
        place = self.approaches.solve(move.target, move.place, height + DETOUR, True)
        if isinstance(pick, str) or isinstance(place, str):
            return None
        way = [pick[len(RISE) :], place[len(RISE) :], *between(pick[-1], place[-1])]
        return None if self._first(np.vstack(way), held) else (pick, place)

    def _open_hand(self) -> None:
        self.collisions.carry(np.empty((0, 3)), np.empty(0, np.int64))

    def _grip(self, scene: Scene, move: Move, members: np.ndarray) -> None:
        """The object hangs from the hand instead of standing in the scene."""
        rotation = move.grasp.rotation()
        offset = scene.position[members] - move.grasp.tool_point(scene.position[move.cell])
        self.collisions.take(members)
        if scene.half is None:
            self.collisions.carry(offset @ rotation, scene.object_id[members])
        else:
            turn = np.array([rotation.T @ yaw_matrix(yaw) for yaw in scene.yaw[members].tolist()])
            half = scene.half[members]
            self.collisions.carry(offset @ rotation, scene.object_id[members], half, turn)

    def _first(self, joints: Iterable[np.ndarray], opening: float) -> Collision | None:
        self.collisions.opening = opening
        for q in joints:
            hit = self.collisions.check(q)
            if hit is not None:
                return hit
        return None


def between(start: np.ndarray, end: np.ndarray) -> Iterator[np.ndarray]:
    """Joint positions strictly between two, at most a stride apart."""
    steps = math.ceil(np.abs(end - start).max() / STRIDE)
    for k in range(1, steps):
        yield start + (end - start) * (k / steps)


def _failed(outcome: Outcome, stage: str, hit: Collision) -> Attempt:
    return Attempt(outcome, stage, str(hit), by_link=hit.by_link)


def _further(attempt: Attempt) -> int:
    return len(STAGES) if attempt.reached else STAGES.index(attempt.stage)
