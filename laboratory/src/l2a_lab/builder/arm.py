"""The arm in the builder's search: a placement that the kinematic cell cannot make is not made.

The builder plans once without the arm; for what that plan builds, base and magazines are set up.
Then it plans again, and every placement it is about to make is tried from the state it is in:
reach, grasp, collisions of links, tool and block. What cannot be made is passed over, and at a dead
end what was in the way is taken out like what strands a cell (:mod:`.search`).
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from learn2assemble.acting.carry_out import FINGER_ROOMS, Prepared, Workcell, carry_out, wider
from learn2assemble.assembly.kit import Kit
from learn2assemble.cell import world as cells
from learn2assemble.cell.arrange import Arranged
from learn2assemble.cell.pieces import Piece, pieces_of, with_rests
from learn2assemble.cell.reach import Base, set_up, why_not_turned
from learn2assemble.cell.structure import Structure
from learn2assemble.cell.workcell import Job, Progress, StepOf, job_of
from learn2assemble.errors import InputError
from learn2assemble.geometry.rotations import quaternion_matrix, yaw_matrix, yaw_quaternion
from learn2assemble.kinematics.cell import KinematicCell
from learn2assemble.planning.plan import Plan
from learn2assemble.planning.tiling.cover.candidates import BlockPlacement
from learn2assemble.planning.tiling.cover.tile import Tiling
from learn2assemble.planning.tiling.ordering import to_assembly
from learn2assemble.planning.tiling.world import LatticeSite, LatticeWorld
from learn2assemble.robot.arm import get_arm
from learn2assemble.robot.bodies import Shape
from learn2assemble.robot.moves import Scene

WIDE_ROOMS = FINGER_ROOMS[2:]
"""Joints that are tried where fingers have no room [m]; less was never enough."""
FAR, LOW = 1.0, 4.0
"""A logit for every cell that a placement is farther from the arm, and for every level lower."""
_Box = tuple[np.ndarray, np.ndarray, np.ndarray, float]
"""Middle [m], quaternion, half extents [m] and density [kg/m³]."""


class Hand:
    """An arm that makes the placements of one search.

    Args:
        workcell: how the arm builds.

    Attributes:
        job: where arm and magazines stand, once that is known.
        tried, failed: placements that were asked for, and those that the arm could not make.
    """

    def __init__(self, workcell: Workcell) -> None:
        self.workcell = workcell
        self.job: Job | None = None
        self.tried = self.failed = 0
        self._base: Base | None = None

    def holds(self, kit: Kit) -> Kit:
        """The kit without the kinds that the tool cannot hold.

        Raises:
            InputError: where none is left.
        """
        arm = get_arm(self.workcell.arm, self.workcell.tool)
        pieces = _pieces(kit, [(kind.name, 0) for kind in kit.kinds])
        held = tuple(
            kind
            for kind, piece in zip(kit.kinds, pieces, strict=True)
            if why_not_turned(arm, piece) is None
        )
        if not held:
            what = f"tool {arm.tool_name}"
            raise InputError(what, f"nothing of kit {kit.name}", "blocks that it can hold")
        return replace(kit, kinds=held)

    def set_up(self, world: LatticeWorld, turn: int = 0) -> Kit:
        """Place base and magazines for what stands in ``world``.

        Args:
            turn: quarter turns about the design from the base of ``turn=0``, which comes first.

        Returns:
            the kit of the kinds that then wait somewhere.

        Raises:
            InputError: for what is out of reach, and for a layout that does not work.
        """
        site, at = world.site, self.workcell
        tiling = Tiling(tuple(site.placement(c) for c in world.placed), site.wanted, "complete")
        assembly = to_assembly(tiling, None, site.kit)
        steps = tuple(StepOf(k) for k in range(len(world.placed)))
        job = Job(
            pieces_of(assembly),
            steps,
            assembly,
            get_arm(at.arm),
            (),
            friction=site.kit.friction,
            joint=site.kit.joint_gap,
        )
        where = at.site
        if turn and self._base is not None:
            angle, (x, y, z, facing) = turn * math.pi / 2, self._base
            x, y = (yaw_matrix(angle) @ (x, y, 0.0))[:2].tolist()
            where = replace(where, base=(round(x, 6), round(y, 6), z, facing + angle))
        self.job = set_up(job, at.arm, at.tool, where)
        if not turn:
            arm = self.job.arm
            facing = float(arm.base_yaw - get_arm(at.arm).base_yaw)
            self._base = (*arm.base_position.tolist(), facing)
        used: set[int] = set(site.kind[world.placed].tolist())
        return replace(site.kit, kinds=tuple(site.kit.kinds[k] for k in sorted(used)))

    def enter(self, site: LatticeSite) -> None:
        """Make ready for the candidates of a site whose kinds wait somewhere."""
        assert self.job is not None
        job, self.site = self.job, site
        self.cell = KinematicCell(job.arm)
        ways = [(site.kit.kinds[way.kind].name, way.turn) for way in site.found.ways]
        self.pieces = with_rests(_pieces(site.kit, ways, site.wanted), job.arm)
        """Of every way to put down a block, at the corner of the design."""
        boxes = [_boxes(piece.shape, piece.pose, piece.density) for piece in self.pieces]
        self.count = np.array([len(box) for box in boxes])
        self.first = np.cumsum(self.count) - self.count
        self.parts = _columns([box for group in boxes for box in group])
        self.fixed = [
            (
                np.array(o.middle),
                yaw_quaternion(o.yaw),
                np.array(o.size) / 2,
                cells.OBSTACLE_DENSITY,
            )
            for o in job.obstacles
        ]
        self.world = cells.WorkcellBlocks(replace(job, pieces=self.pieces, steps=()))
        self.middle = np.array([piece.target[:2] for piece in self.pieces])
        ends = np.array([piece.extent for piece in self.pieces])
        self.half = (ends[:, 1] - ends[:, 0])[:, :2] / 2
        self.pitch = np.array(site.kit.pitch[:2])

    def prefers(self, candidates: np.ndarray) -> np.ndarray:
        """float64[m]: what is added to logits: lower levels first, on each the farthest."""
        assert self.job is not None
        found = self.site.found
        level = found.origin[candidates, 2]
        way = found.way[candidates]
        at = self.middle[way] + found.origin[candidates, :2] * self.pitch
        # To the farthest corner, so that it says nothing about which block is to be there.
        away = np.linalg.norm(np.abs(at - self.job.base) + self.half[way], axis=1)
        return away / self.pitch.min() * FAR - level * LOW

    def blocked(self, world: LatticeWorld, candidate: int) -> np.ndarray | None:
        """Cells to blame where the arm cannot make a placement; None where it can.

        Args:
            world: as it is before the placement.
        """
        assert self.job is not None
        found, kit = self.site.found, self.site.kit
        way = int(found.way[candidate])
        piece, offset = self.pieces[way], found.origin[candidate] * kit.pitch
        goal = np.array([*(piece.target + offset), *piece.pose[3:]])
        used = Counter(self.pieces[int(w)].shape for w in found.way[world.placed].tolist())
        sources, others = self._supply(used, piece.shape)
        self.tried += 1
        touched: set[int] = set()
        for source in sources:
            pose = self.world.pose[way] = self.world.presented(way, source)
            mine = _boxes(piece.shape, pose, piece.density)
            rows, owner = self._rows(world.placed, [*self.fixed, *others], mine, way)
            for move in cells.moves(self.world, rows, way, goal):
                attempt = self.cell.attempt(rows.scene, move)
                if attempt.reached:
                    return None
                touched |= {
                    int(owner[int(row)]) for row in re.findall(r"block (\d+)", attempt.detail)
                }
        self.failed += 1
        blamed = [self.site.cells(world.placed[n]) for n in sorted(touched - {-1})]
        return np.concatenate(blamed or [self.site.cells(candidate)])

    def _supply(self, used: Counter[Shape], shape: Shape) -> tuple[list[int], list[_Box]]:
        """Sources of the next block of a shape, and boxes of all others that wait on the table.

        What lies on the table is taken in the order of the layout, before magazines.
        """
        assert self.job is not None
        magazines, lying, others = list[int](), list[int](), list[_Box]()
        seen: Counter[Shape] = Counter()
        for number, source in enumerate(self.job.sources):
            if source.magazine:
                if source.shape == shape and (source.left is None or used[shape] < source.left):
                    magazines.append(number)
                continue
            seen[source.shape] += 1
            if seen[source.shape] == used[shape] + 1 and source.shape == shape:
                lying.append(number)
            elif seen[source.shape] > used[source.shape]:
                others += _boxes(source.shape, next(source.poses()), 1.0)
        return lying or magazines, others

    def _rows(
        self, placed: list[int], others: list[_Box], mine: list[_Box], way: int
    ) -> tuple[cells.Rows, np.ndarray]:
        """The scene, and int64[n]: the number of the block that a row is of, -1 for all others."""
        found, standing = self.site.found, np.array(placed, np.int64)
        ways = found.way[standing]
        count = self.count[ways]
        number = np.repeat(np.arange(len(standing)), count)
        row = np.arange(int(count.sum())) + np.repeat(
            self.first[ways] - np.cumsum(count) + count, count
        )
        built = [column[row] for column in self.parts]
        built[0] = built[0] + found.origin[standing][number] * self.site.kit.pitch
        before, after = _columns(others), _columns(mine)
        position, turn, half, density = (
            np.concatenate(three) for three in zip(before, built, after, strict=True)
        )
        owner = np.full(len(position), -1)
        owner[len(others) : len(others) + len(number)] = number
        things = owner.copy()
        things[: len(others)] = len(standing) + 1 + np.arange(len(others))
        things[len(position) - len(mine) :] = len(standing)
        placed_rows = len(position) - len(mine)
        moving = np.full(len(position), -1)
        moving[placed_rows:] = way
        part = np.zeros(len(position), np.int64)
        part[placed_rows:] = np.arange(len(mine))
        yaw = np.zeros(len(position))
        scene = Scene(position, yaw, things, placed_rows, half, density, turn)
        return cells.Rows(scene, moving, part), owner

    def carry_out(self, plan: Plan, progress: Progress) -> Plan:
        """A plan of this search, carried out in its order."""
        if self.job is None or not plan.complete:
            return plan
        job = replace(
            job_of(plan, self.workcell.arm, self.job.joint),
            arm=self.job.arm,
            sources=self.job.sources,
            obstacles=self.job.obstacles,
        )
        found = Prepared(job, Structure(job), Arranged(job.steps, {}), self.cell)
        return carry_out(plan, self.workcell, joint=job.joint, progress=progress, found=found)


def build_by_arm(
    plan_with: Callable[[Kit, Hand], Plan],
    wanted: np.ndarray,
    kit: Kit,
    workcell: Workcell,
    progress: Progress,
) -> Plan:
    """The builder's plan for an arm, carried out; with fingers, the blocks stand as far apart as
    they need.

    Args:
        plan_with: plans with a kit and an arm.
        wanted: bool[X, Y, Z].
    """
    rooms = [kit.joint_gap]
    if get_arm(workcell.arm, workcell.tool).suction is None:
        rooms += [room for room in WIDE_ROOMS if room > kit.joint_gap]
        if _has_square(wanted, Hand(workcell).holds(kit)):
            rooms = rooms[1:]
    best: tuple[Plan, Hand] | None = None
    for room in rooms:
        if room > kit.joint_gap:
            progress(f"fingers need room between the blocks: trying {1e3 * room:g} mm")
        hand = Hand(workcell)
        try:
            plan = plan_with(kit if room == kit.joint_gap else wider(kit, room), hand)
        except InputError:
            if best is None:
                raise
            break
        if best is None or plan.coverage > best[0].coverage:
            best = plan, hand
        if plan.complete:
            break
    assert best is not None
    return best[1].carry_out(best[0], progress)


def _has_square(wanted: np.ndarray, kit: Kit) -> bool:
    """Whether a level has four cells in a square that no block of a kit fills at once: the last
    block there has neighbours on both axes, and fingers no room beside it."""
    square = wanted[:-1, :-1] & wanted[1:, :-1] & wanted[:-1, 1:] & wanted[1:, 1:]
    narrow = all(
        len({x for x, _, _ in kind.cells}) == 1 or len({y for _, y, _ in kind.cells}) == 1
        for kind in kit.kinds
    )
    return narrow and bool(square.any())


def _pieces(
    kit: Kit, ways: list[tuple[str, int]], wanted: np.ndarray | None = None
) -> tuple[Piece, ...]:
    """Blocks at the corner of a design, by name and turn."""
    wanted = np.zeros((1, 1, 1), bool) if wanted is None else wanted
    blocks = tuple(BlockPlacement(name, turn, (0, 0, 0)) for name, turn in ways)
    return pieces_of(to_assembly(Tiling(blocks, wanted, "complete"), None, kit))


def _boxes(shape: Shape, pose: np.ndarray, density: float) -> list[_Box]:
    turn = quaternion_matrix(pose[3:])
    return [
        (pose[:3] + turn @ np.array(part.centre), pose[3:], np.array(part.half), density)
        for part in shape
    ]


def _columns(boxes: list[_Box]) -> list[np.ndarray]:
    if not boxes:
        return [np.empty((0, 3)), np.empty((0, 4)), np.empty((0, 3)), np.empty(0)]
    return [np.array(column, float) for column in zip(*boxes, strict=True)]
