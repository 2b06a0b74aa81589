"""The arm without dynamics: can it reach, and does it touch anything on the way?

The cheap fidelity, for training and search: inverse kinematics and MuJoCo's collision detection
(:mod:`.collisions`). It moves nothing and decides nothing about balance;
:mod:`learn2assemble.statics` does.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from functools import cached_property

import numpy as np

from learn2assemble.geometry.rotations import quaternion_matrix
from learn2assemble.kinematics.approach import JUMP, RISE, ApproachCache, follow_poses, tool_path
from learn2assemble.kinematics.collisions import MAX_SIZED, BlockChecker, Collision
from learn2assemble.robot.arm import Arm
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
    """Reach, joint limits and collisions of one arm, for scenes of any blocks, or of at most
    ``num_cells`` cubes of the task.

    Joint solutions over a place are remembered, so repeated places cost collision checks only.
    A move is tried as ordered and with the fingers exchanged. One instance serves one thread.
    """

    collisions: BlockChecker

    name = "kinematic"

    def __init__(self, arm: Arm, num_cells: int = 40) -> None:
        self.arm = arm
        self.approaches: ApproachCache = ApproachCache(arm)
        self.num_cells = num_cells
        self._boxes: BlockChecker | None = None
        self.apart: float = 0.0
        """How far the hand has to be from everything [m]."""
        self._bounds: tuple[Scene, tuple[np.ndarray, np.ndarray]] | None = None
        """The bounds of the scene that was asked for last."""

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
            found = self._attempt(scene, turned(scene, move, turn))
            best = found if _further(found) > _further(best) else best
        return best

    @cached_property
    def _cubes(self) -> BlockChecker:
        """Of scenes that do not say how large their cells are."""
        return BlockChecker(self.arm, self.num_cells)

    def _checker(self, scene: Scene) -> BlockChecker:
        """A checker with room for the cells of a scene, whatever they are."""
        if scene.half is None:
            return self._cubes
        count, known = len(scene.position), self._boxes
        largest = int(np.unique(scene.object_id, return_counts=True)[1].max())
        hulls = frozenset(hull for hull in scene.hull or () if hull is not None)
        if (
            known is None
            or known.num_cells < count
            or known.most < largest
            or not hulls <= known.hulls
        ):
            room = 32 * math.ceil(1.25 * count / 32)
            most = max(MAX_SIZED, largest)
            hulls = hulls if known is None else hulls | known.hulls
            known = self._boxes = BlockChecker(self.arm, room, True, most, hulls)
        known.keep(self.apart)
        return known

    def _height(self, scene: Scene, move: Move) -> float:
        """As :func:`~.moves.crossing_height`, of many moves in one scene."""
        if self._bounds is None or self._bounds[0] is not scene:
            self._bounds = scene, scene.bounds()
        return crossing_height(scene, move, self._bounds[1])

    def pick(self, scene: Scene, move: Move, height: float | None = None) -> Attempt:
        """The first half of a move: what lies at its target does not matter, its height does.

        Args:
            height: of the tool between picking and placing, where it is known [m].
        """
        self.collisions = self._checker(scene)
        held = grip_width(scene, move.cell, move.grasp)
        height = self._height(scene, move) if height is None else height
        opening = held + ROOM
        pick = self.approaches.solve(
            scene.position[move.cell], move.grasp, height, move.grasp.straight
        )
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
        height = self._height(scene, move)
        picked = self.pick(scene, move, height)
        pick = picked.pick
        if pick is None:
            return picked
        held, members = grip_width(scene, move.cell, move.grasp), scene.members(move.cell)
        opening = held + ROOM
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
            leave = leave if move.place.apart else place
        # The object now stands at its target and is in the way like all others.
        self.collisions.put(members, *carried(scene, move, members))
        self._open_hand()
        hit = self._first(leave if move.place.apart else leave[: len(RISE)], opening)
        if hit:
            return _failed(Outcome.PLACE_COLLISION, "release", hit)
        hit = self._first(between(leave[-1], self.arm.home), opening)
        if hit:
            return _failed(Outcome.PLACE_COLLISION, "retreat", hit)
        return Attempt(Outcome.REACHED, pick=pick, place=place)

    def let_go(self, scene: Scene, move: Move, joints: np.ndarray) -> Attempt:
        """The last part of a move: a block that stands at its target in the scene and that the hand
        has held since it came is let go, and the arm leaves, bent as it is.

        Args:
            scene: in which the block stands.
            move: by which it came.
            joints: float64[n], of the arm that holds it [rad].
        """
        self.collisions = self._checker(scene)
        way = tool_path(move.target, move.place, self._height(scene, move))
        leave = follow_poses(self.arm, way.position, way.rotation, joints, jump=JUMP)
        if isinstance(leave, str):
            return Attempt(Outcome.UNREACHABLE, "release", leave)
        self.collisions.place(scene)
        self._open_hand()
        hit = self._first(leave, grip_width(scene, move.cell, move.grasp) + ROOM)
        if hit:
            return _failed(Outcome.PLACE_COLLISION, "release", hit)
        return Attempt(Outcome.REACHED, place=leave)

    def _detour(
        self, scene: Scene, move: Move, height: float, held: float
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Approaches whose tops are joined by a free motion, higher up."""
        above, grasp = height + DETOUR, move.grasp
        pick = self.approaches.solve(scene.position[move.cell], grasp, above, grasp.straight)
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
            turn = rotation.T @ quaternion_matrix(scene.orientation[members])
            self.collisions.hang(scene, members, offset @ rotation, turn)

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
