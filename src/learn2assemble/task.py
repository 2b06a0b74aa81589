"""A task is a value: everything that tells one environment from another."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

from learn2assemble.errors import InputError, UnknownNameError
from learn2assemble.geometry.coverage import FILTERS
from learn2assemble.robot.registry import ARMS
from learn2assemble.world.actions import RELATIONS, Ways, get_ways
from learn2assemble.world.blocks import EDGE
from learn2assemble.world.layouts import LAYOUTS, RANDOM
from learn2assemble.world.objects import OBJECT_SETS
from learn2assemble.world.rules import REWARDS, STABILITY

MIN_VERTICES, MAX_VERTICES = 3, 5
NO_ARM = "none"
MAX_PITCH = 0.07
"""Cells farther apart [m] would need other rules for what fills the gaps of objects."""


def check_actions(num_actions: int, attitudes: str, task: Task) -> None:
    """Refuse a network whose actions are not the task's.

    Raises:
        InputError: naming what differs.
    """
    if num_actions != task.num_actions:
        raise InputError(
            "network.num_actions", num_actions, f"{task.num_actions}, the actions of {task.name}"
        )
    if attitudes != task.attitudes:
        raise InputError("network.attitudes", attitudes, f"{task.attitudes}, those of {task.name}")


@dataclass(frozen=True)
class Task:
    """One assembly problem distribution.

    Args:
        name: how presets, agents and results refer to it.
        num_sides: 1, 2, 3 or 4 target elevations (protocol 1.2).
        grid: width and height of the box targets are drawn from, in block edges.
        num_nodes: N, nodes of the graph; the number of blocks is N minus the target vertices.
        objects: the set objects are drawn from, see :mod:`learn2assemble.world.objects`.
        rotations: ways to place an object in each relation, 1 or 4.
        attitudes: what these are, see ``ATTITUDES`` in :mod:`learn2assemble.world.actions`.
        pitch: horizontal distance of the centres of neighbouring blocks [m]; more than a block's
            edge leaves room for the fingers of a gripper.
        aisle: empty rows of cells between the two walls of a two-sided structure.
        layout: where unplaced objects wait, see :mod:`learn2assemble.world.layouts`.
        reward: ``discrete`` (cubes) or ``scaled`` (objects), protocol 6.3.
        discount: gamma of the returns.
        success_threshold: Delta; the target is filled when F_co exceeds it.
        cover_filter: which depths count as covered, see ``FILTERS`` in
            :mod:`learn2assemble.geometry.coverage`.
        normalise_initial: F counts from the cover of the first object on; without it from nothing.
        arm: which arm builds, see :mod:`learn2assemble.robot.registry`; ``none``: objects appear
            at their places.
        stability: rule of a simulated placement, see ``STABILITY`` in
            :mod:`learn2assemble.world.rules`.
        min_mask_pixels: fewer mask pixels than this and the shapes are redrawn.
        max_initial_cover: more than this share covered by the first block: redrawn.
        unseen_shapes_only: every outline leaves the 3x3 box agents are trained on.

    Raises:
        InputError: for a value outside its range.
    """

    name: str
    num_sides: int
    grid: int
    num_nodes: int
    objects: str = "cubes"
    rotations: int = 1
    attitudes: str = "turns"
    pitch: float = EDGE
    aisle: int = 0
    layout: str = "line"
    reward: str = "discrete"
    discount: float = 0.8
    success_threshold: float = 0.975
    cover_filter: str = "narrow"
    normalise_initial: bool = True
    arm: str = "none"
    stability: str = "block"
    min_mask_pixels: int = 50
    max_initial_cover: float = 0.95
    unseen_shapes_only: bool = False

    def __post_init__(self) -> None:
        if self.num_sides not in (1, 2, 3, 4):
            raise InputError("num_sides", self.num_sides, "1, 2, 3 or 4")
        if not 1 <= self.grid <= 6:
            raise InputError("grid", self.grid, "1 to 6 block edges")
        if self.num_nodes <= MAX_VERTICES * self.num_sides + 1:
            raise InputError(
                "num_nodes", self.num_nodes, f"more than {MAX_VERTICES * self.num_sides + 1}"
            )
        if self.objects not in OBJECT_SETS:
            raise UnknownNameError("object set", self.objects, OBJECT_SETS)
        get_ways(self.attitudes, self.rotations, self.pitch)
        if not EDGE <= self.pitch <= MAX_PITCH:
            raise InputError("pitch", self.pitch, f"{EDGE} to {MAX_PITCH} m")
        if self.aisle not in ((0, 1, 2) if self.num_sides == 2 else (0,)):
            raise InputError("aisle", self.aisle, "0 to 2 rows between two walls, else 0")
        if self.cover_filter not in FILTERS:
            raise UnknownNameError("cover filter", self.cover_filter, FILTERS)
        if self.stability not in STABILITY:
            raise UnknownNameError("stability rule", self.stability, STABILITY)
        if self.arm not in (NO_ARM, *ARMS):
            raise UnknownNameError("arm", self.arm, (NO_ARM, *ARMS))
        if self.layout not in LAYOUTS:
            raise UnknownNameError("layout", self.layout, LAYOUTS)
        if self.layout == RANDOM and self.objects != "cubes":
            raise InputError("layout", self.layout, "one for objects of several cells")
        if self.reward not in REWARDS:
            raise UnknownNameError("reward", self.reward, REWARDS)
        if not 0 < self.discount <= 1:
            raise InputError("discount", self.discount, "0 < gamma <= 1")
        if not 0 < self.success_threshold < 1:
            raise InputError("success_threshold", self.success_threshold, "0 < Delta < 1")

    @property
    def num_actions(self) -> int:
        """Na, ways to place a block against another: relations times rotations."""
        return len(RELATIONS) * self.rotations

    @property
    def ways(self) -> Ways:
        """What the actions mean, beside the relation."""
        return get_ways(self.attitudes, self.rotations, self.pitch)

    @property
    def grasps(self) -> str:
        """The grasp set an arm uses, see :mod:`learn2assemble.robot.grasps`: one attitude where
        there is one way, else the four pairs of the paper."""
        return "along-y" if self.rotations == 1 else "paper"

    @property
    def has_arm(self) -> bool:
        """Whether an arm builds."""
        return self.arm != NO_ARM

    @property
    def touching(self) -> bool:
        """Whether blocks side by side touch; else they leave room for the fingers of a gripper."""
        return self.pitch == EDGE

    @property
    def max_blocks(self) -> int:
        """Blocks of the problem with the fewest target vertices."""
        return self.num_nodes - MIN_VERTICES * self.num_sides

    @property
    def block_range(self) -> tuple[int, int]:
        """Fewest and most blocks, the first one included (the "a-b blocks" label of the paper)."""
        return self.num_nodes - MAX_VERTICES * self.num_sides, self.max_blocks

    def replace(self, **changes: Any) -> Task:
        """A copy with some fields changed."""
        return dataclasses.replace(self, **changes)
