"""A task is a value: everything that tells one environment from another.

The paper's tasks by name, and one of ours; :func:`register_task` adds more.

The label "a-b blocks" fixes the number of nodes: N = a + 5 S = b + 3 S for S sides. An arm builds
in those that begin with ``robot``; the same without one: ``get_task(NAME).replace(arm="none")``.

Cube tasks whose grid or number of blocks is larger than in training draw only unseen shapes, as
the paper's text says: outlines that meet the published bound on the 3x3 box. Where
the grid is 3x3 itself, that leaves four- and five-sided ones with high left shoulders. Object tasks
do not: their agents are trained on 5x5, and the published bound knows no other box than 3x3.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from learn2assemble.constants import EDGE
from learn2assemble.errors import InputError, check_fields, check_name, is_number, is_whole
from learn2assemble.registry import Registry
from learn2assemble.robot.registry import ARMS

if TYPE_CHECKING:
    from learn2assemble.tasks.world.blocks import ActionSpec

MIN_VERTICES, MAX_VERTICES = 3, 5
NO_ARM = "none"
LARGEST_SEEN, SIGHT = 6, 3
"""On larger grids a cell looks at the blocks within so many cells only: the sum over all would grow
beyond what was met in training, and hide what is near."""
MAX_NODES = 1000
"""Of a graph; every array of a world grows with them, some with their square."""
MAX_PITCH = 0.07
"""Cells farther apart [m] would need other rules for what fills the gaps of objects."""


def check_actions(num_actions: int, action_mode: str, task: Task) -> None:
    """Refuse a network whose actions are not the task's.

    Raises:
        InputError: naming what differs.
    """
    for name, given, own in (
        ("num_actions", num_actions, f"{task.num_actions}, the actions of {task.name}"),
        ("action_mode", action_mode, f"{task.action_mode}, those of {task.name}"),
    ):
        if given != getattr(task, name):
            raise InputError(f"network.{name}", given, own)


@dataclass(frozen=True)
class Task:
    """One assembly problem distribution.

    Args:
        name: how presets, agents and results refer to it.
        num_sides: 1, 2, 3 or 4 target elevations.
        grid: width and height of the box targets are drawn from, in block edges.
        num_nodes: N, nodes of the graph; the number of blocks is N minus the target vertices.
        objects: the set objects are drawn from, see :mod:`learn2assemble.tasks.world.blocks`.
        rotations: ways to place an object in each relation, 1 or 4.
        action_mode: what these are, see ``ACTION_MODES`` in
        :mod:`learn2assemble.tasks.world.blocks`.
        pitch: horizontal distance of the centres of neighbouring blocks [m]; more than a block's
            edge leaves room for the fingers of a gripper.
        aisle: empty rows of cells between the two walls of a two-sided structure.
        layout: where unplaced objects wait, see :mod:`learn2assemble.tasks.world.layouts`.
        reward: ``discrete`` (cubes) or ``scaled`` (objects).
        discount: gamma of the returns.
        success_threshold: Delta; the target is filled when F_co exceeds it.
        cover_filter: which depths count as covered, see ``FILTERS`` in
            :mod:`learn2assemble.tasks.world.coverage`.
        normalise_initial: F counts from the cover of the first object on; without it from nothing.
        arm: which arm builds, see :mod:`learn2assemble.robot.registry`; ``none``: objects appear
            at their places.
        stability: rule of a simulated placement, see ``STABILITY`` in
            :mod:`learn2assemble.tasks.world.rules`.
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
    action_mode: str = "turns"
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
        # Compiled code is loaded by those who have a task, not by those who list their names.
        from learn2assemble.tasks.world.blocks import ACTION_MODES, OBJECT_SETS, get_action_spec
        from learn2assemble.tasks.world.coverage import FILTERS
        from learn2assemble.tasks.world.layouts import LAYOUTS, RANDOM
        from learn2assemble.tasks.world.rules import REWARDS, STABILITY

        for name, what, valid in (
            ("objects", "object set", OBJECT_SETS),
            ("cover_filter", "cover filter", FILTERS),
            ("stability", "stability rule", STABILITY),
            ("arm", "arm", (NO_ARM, *ARMS)),
            ("layout", "layout", LAYOUTS),
            ("reward", "reward", REWARDS),
        ):
            check_name(what, getattr(self, name), valid)
        check_fields(
            self,
            ("name", isinstance(self.name, str), "a word"),  # pyright: ignore[reportUnnecessaryIsInstance]
            ("num_sides", is_whole(self.num_sides, 1, 4), "1, 2, 3 or 4"),
            ("grid", is_whole(self.grid, 1, 12), "a whole number from 1 to 12 block edges"),
            ("num_nodes", is_whole(self.num_nodes, 1, MAX_NODES), f"at most {MAX_NODES}"),
            ("rotations", is_whole(self.rotations, 1, 4), "1 or 4"),
            ("aisle", is_whole(self.aisle, 0, 2), "0 to 2 rows between two walls, else 0"),
            ("pitch", is_number(self.pitch, EDGE, MAX_PITCH), f"{EDGE} to {MAX_PITCH} m"),
            ("discount", is_number(self.discount, 0, 1), "0 < gamma <= 1"),
            ("success_threshold", is_number(self.success_threshold, 0, 1), "0 < Delta < 1"),
            ("min_mask_pixels", is_whole(self.min_mask_pixels, 0, 10**6), "a whole number from 0"),
            ("max_initial_cover", is_number(self.max_initial_cover, 0, 1), "0 to 1"),
            *[
                (name, isinstance(getattr(self, name), bool), "True or False")
                for name in ("normalise_initial", "unseen_shapes_only")
            ],
        )
        check_name("action mode", self.action_mode, ACTION_MODES)
        get_action_spec(self.action_mode, self.rotations, self.pitch)
        least = MAX_VERTICES * self.num_sides + 1
        aisles = range(3 if self.num_sides == 2 else 1)
        cubes = self.objects == "cubes"
        check_fields(
            self,
            ("num_nodes", self.num_nodes > least, f"more than {least}"),
            ("aisle", self.aisle in aisles, "0 to 2 rows between two walls, else 0"),
            ("layout", cubes or self.layout != RANDOM, "one for objects of several cells"),
            ("discount", 0 < self.discount <= 1, "0 < gamma <= 1"),
            ("success_threshold", 0 < self.success_threshold < 1, "0 < Delta < 1"),
        )

    @property
    def num_actions(self) -> int:
        """Na, ways to place a block against another: five relations times rotations."""
        return 5 * self.rotations

    @property
    def action_spec(self) -> ActionSpec:
        """What the actions mean, beside the relation."""
        from learn2assemble.tasks.world.blocks import get_action_spec

        return get_action_spec(self.action_mode, self.rotations, self.pitch)

    @property
    def grasps(self) -> str:
        """The grasp set an arm uses, see :mod:`learn2assemble.robot.moves`: one attitude where
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
    def sight(self) -> int:
        """How many cells away our network sees blocks; 0: at any distance."""
        return SIGHT if self.grid > LARGEST_SEEN else 0

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


def _draft(num_sides: int, grid: int, num_nodes: int, **more: Any) -> dict[str, Any]:
    """Arguments of a task but its name."""
    return {"num_sides": num_sides, "grid": grid, "num_nodes": num_nodes, **more}


_OBJECTS = _draft(
    2,
    5,
    30,
    objects="set-26",
    rotations=4,
    layout="narrow-field",
    reward="scaled",
    discount=0.95,
    success_threshold=0.75,
    stability="object",
)
_BARS = _draft(
    1,
    5,
    30,
    objects="bars",
    layout="field",
    reward="scaled",
)

# Shared by all workcells: room for the fingers, a tolerant camera, coverage of the whole
# target. One side has five actions, all by one grip.
_ROBOT = _draft(
    2,
    3,
    20,
    rotations=4,
    action_mode="grips",
    pitch=0.06,
    layout="slanted-rows",
    success_threshold=0.75,
    cover_filter="wide",
    normalise_initial=False,
    max_initial_cover=0.6,
    arm="panda",
)
_ROBOT_MORE = dict(_ROBOT, num_nodes=24, unseen_shapes_only=True)
_ROBOT_ONE_SIDED = dict(
    _ROBOT, num_sides=1, grid=5, rotations=1, action_mode="turns", pitch=0.055, layout="rows"
)
_ROBOT_OBJECTS = dict(
    _ROBOT,
    grid=5,
    num_nodes=30,
    objects="set-26",
    layout="columns",
    reward="scaled",
    discount=0.95,
    stability="object",
)

_ALL = {
    "two-sided-3x3-20-24": _draft(2, 3, 30),
    "two-sided-3x3-30-34": _draft(2, 3, 40, unseen_shapes_only=True),
    # The same with the shapes of training, the other reading of the paper's column.
    "two-sided-3x3-30-34-trained-shapes": _draft(2, 3, 40),
    "two-sided-4x4-20-24": _draft(2, 4, 30, unseen_shapes_only=True),
    "two-sided-4x4-30-34": _draft(2, 4, 40, unseen_shapes_only=True),
    "two-sided-5x5-40-44": _draft(2, 5, 50, unseen_shapes_only=True),
    "two-sided-6x6-50-54": _draft(2, 6, 60, unseen_shapes_only=True),
    # Ours: how far agents trained on small targets get.
    "two-sided-8x8-90-94": _draft(2, 8, 100, unseen_shapes_only=True),
    "two-sided-10x10-140-144": _draft(2, 10, 150, unseen_shapes_only=True),
    "two-sided-12x12-200-204": _draft(2, 12, 210, unseen_shapes_only=True),
    "one-sided-3x3-22-24": _draft(1, 3, 27, layout="rows"),
    # The twin of the one-sided robot cell for agents trained without a robot (appendix table 5).
    "one-sided-5x5-15-17": _draft(1, 5, 20, layout="rows"),
    "four-sided-3x3-10-18": _draft(4, 3, 30),
    "four-sided-5x5-30-38": _draft(4, 5, 50, unseen_shapes_only=True),
    # The paper's four shapes: cube, standing pair, L, S (table 5, appendix table 6).
    "objects-two-sided-5x5-20-24": _OBJECTS,
    "objects-two-sided-5x5-30-34": dict(_OBJECTS, num_nodes=40),
    "objects-two-sided-6x6-30-34": dict(_OBJECTS, num_nodes=40, grid=6),
    # The set the released environment without a robot draws from.
    "objects21-two-sided-5x5-20-24": dict(_OBJECTS, objects="set-21"),
    "objects21-two-sided-6x6-30-34": dict(_OBJECTS, objects="set-21", num_nodes=40, grid=6),
    # Cubes, bars and standing pairs (appendix table 3).
    "bars-one-sided-5x5-25-27": _BARS,
    "bars-one-sided-5x5-35-37": dict(_BARS, num_nodes=40),
    "bars-one-sided-6x6-35-37": dict(_BARS, num_nodes=40, grid=6),
    # "Different types of objects" in the same table; which ones is not said. Our reading: set 21.
    "other-bars-one-sided-5x5-25-27": dict(_BARS, objects="set-21", stability="object"),
    # With a robot: appendix table 5, table 4 (blocks in rows, at random places), table 3, table 5.
    "robot-one-sided-5x5-15-17": _ROBOT_ONE_SIDED,
    "robot-one-sided-6x6-16-18": dict(_ROBOT_ONE_SIDED, grid=6, num_nodes=21),
    "robot-two-sided-3x3-10-14": _ROBOT,
    "robot-two-sided-3x3-14-18": _ROBOT_MORE,
    "robot-two-sided-5x5-14-18": dict(_ROBOT_MORE, grid=5),
    "robot-random-two-sided-3x3-10-14": dict(_ROBOT, layout="random"),
    "robot-random-two-sided-3x3-14-18": dict(_ROBOT_MORE, layout="random"),
    "robot-random-two-sided-5x5-14-18": dict(_ROBOT_MORE, layout="random", grid=5),
    # Ours, for building designs: walls with an aisle for the fingers, filled as far as gaps allow.
    "robot-walls-two-sided-5x5-26-30": dict(
        _ROBOT,
        grid=5,
        num_nodes=36,
        aisle=1,
        layout="around",
        success_threshold=0.85,
    ),
    "robot-four-sided-3x3-10-18": dict(_ROBOT, num_sides=4, num_nodes=30),
    "robot-four-sided-3x3-16-24": dict(_ROBOT_MORE, num_sides=4, num_nodes=36),
    "robot-objects-two-sided-5x5-20-24": _ROBOT_OBJECTS,
    "robot-objects-two-sided-5x5-30-34": dict(_ROBOT_OBJECTS, num_nodes=40),
    "robot-objects-two-sided-6x6-30-34": dict(_ROBOT_OBJECTS, num_nodes=40, grid=6),
}

PRESETS: Registry[Task] = Registry("task", _ALL, lambda name, given: Task(name, **given))
"""Every task by name; see :func:`register_task`."""


@dataclass(frozen=True)
class DesignTask:
    """Random designs of cells for an agent to build, see ``planning/agent/designs.py``.

    Args:
        name: how presets and results refer to it.
        families: of designs, or ``("train",)`` or ``("held-out",)``.
        kit: of blocks.
        blocks: fewest and most blocks of the known solution.
        limited_heap: whether the heap is exactly the blocks of that solution.
        max_candidates: how many candidate placements an environment offers at a time.
        extent: most cells along any axis.
    """

    name: str
    families: tuple[str, ...]
    kit: str = "bricks-lintels"
    blocks: tuple[int, int] = (5, 60)
    limited_heap: bool = False
    max_candidates: int = 1024
    extent: int = 64


DESIGN_TASKS: Registry[DesignTask] = Registry(
    "design task",
    {
        f"designs-{name}{'' if part == 'train' else '-held-out'}": {"families": (part,), **given}
        for part in ("train", "held-out")
        for name, given in {
            "cubes-60": {"kit": "cubes"},
            "bricks-60": {"kit": "bricks"},
            "lintels-60": {},
            "lintels-60-heap": {"limited_heap": True},
            "lintels-400": {"blocks": (200, 400), "max_candidates": 4096},
            "lintels-400-heap": {
                "blocks": (100, 400),
                "limited_heap": True,
                "max_candidates": 4096,
            },
        }.items()
    },
    lambda name, given: DesignTask(name, **given),
)
"""Tasks of designs by name."""


@dataclass(frozen=True)
class GoalTask:
    """Goals for which an agent invents a structure, see ``planning/goals/tasks.py``.

    Args:
        name: how presets and results refer to it.
        goals: name of the fixed goals.
        max_candidates: how many candidate placements an environment offers at a time.
    """

    name: str
    goals: str
    max_candidates: int = 512


GOAL_TASKS: Registry[GoalTask] = Registry(
    "goals task",
    {
        "goals-bridge": {"goals": "planar/bridge/0"},
        "goals-cantilever": {"goals": "planar/cantilever/2"},
        "goals-table": {"goals": "spatial/table/1"},
    },
    lambda name, given: GoalTask(name, **given),
)
"""Tasks of goals by name."""


@dataclass(frozen=True)
class HiddenTask:
    """Random designs of given blocks that are put down with hidden errors, see
    :mod:`learn2assemble.tasks.hidden_world`.

    Args:
        name: how presets and results refer to it.
        families: of designs; all of them without any.
        kit: of blocks, all of them boxes.
        blocks: fewest and most blocks of a design.
        factor: that scales all hidden errors.
        moves: placements, takings and looks that there are time for: so many for each block, and
            so many more.
    """

    name: str
    families: tuple[str, ...] = ()
    kit: str = "bricks-lintels"
    blocks: tuple[int, int] = (8, 20)
    factor: float = 1.4
    moves: tuple[float, int] = (2.0, 8)

    def __post_init__(self) -> None:
        check_fields(self, ("factor", is_number(self.factor, 0.0, 10.0), "a number from 0 to 10"))


HIDDEN_TASKS: Registry[HiddenTask] = Registry(
    "task with hidden errors",
    {"hidden-designs-20": {}},
    lambda name, given: HiddenTask(name, **given),
)
"""Tasks of designs with hidden errors by name."""


def register_task(task: Task, *, replace: bool = False) -> Task:
    """Make a task known by its name: to training, evaluation, the command line and Gymnasium.

    Args:
        replace: take the place of a task of this name.

    Returns:
        ``task``.

    Raises:
        InputError: for what is no task, and for a name that is no plain word or is taken.
    """
    if not isinstance(task, Task):  # pyright: ignore[reportUnnecessaryIsInstance]
        raise InputError("task", task, "a Task")
    PRESETS.register(task.name, task, replace=replace)
    return task


def get_task(name: str | Task, arm: str | None = None) -> Task:
    """The task called ``name``, or the one given.

    Args:
        arm: builds in place of the task's own, or ``none``; for tasks with a robot.

    Raises:
        UnknownNameError: naming the nearest task or arm.
        InputError: for an arm where the task has no robot.
    """
    task = name if isinstance(name, Task) else PRESETS[name]
    if arm is None:
        return task
    if not task.has_arm:
        raise InputError("arm", arm, f"a task with a robot ({task.name} has none)")
    return task.replace(arm=arm)
