"""Replay of the recorded robot cell: does a cell of ours fail where theirs did, and for the same
reason?

Each line restores what stood where before the step, orders the same move, and compares. What the
logs do not hold: how blocks that an earlier step pushed are turned, and what moved at that moment.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from learn2assemble.errors import InputError, look_up
from learn2assemble.reproduction.bullet.cell import PublishedCell, published_rules
from learn2assemble.reproduction.recordings import VARIANTS, Line, Log, waiting_objects
from learn2assemble.robot.arm import get_arm
from learn2assemble.robot.checker import Cell
from learn2assemble.robot.kinematic.cell import KinematicCell
from learn2assemble.robot.moves import Attempt, Move, Scene, get_grasps
from learn2assemble.tasks import Task, get_task
from learn2assemble.world.blocks import DIRECTIONS, EDGE, HALF

CLASSES = {
    "grasp_contact": "grasp contact",
    "gripper_contact_before_open": "contact before opening",
    "gripper_contact_after_open": "contact after opening",
    "velocity": "speed after opening",
    "moved_placed": "moved",
    "orientation_or_moved_unplaced": "tilted",
}
"""Recorded reasons of failure, and stages of the published cell."""
SUCCESS = "success"
MAX_CELLS = 40
"""Cells a recorded scene has at most."""


def published(rules: str) -> Cell:
    """The authors' fast mode."""
    return PublishedCell(get_arm("panda"), rules)


def kinematic(rules: str) -> Cell:
    """Reach and collisions alone, with all links, joint limits and planned ways."""
    return KinematicCell(get_arm("panda"), MAX_CELLS)


@dataclass
class RobotReport:
    """Agreement of one file on success or failure; ``rule`` is that of :func:`simple_rule`."""

    file: str
    cell: str = ""
    lines: int = 0
    agree: int = 0
    same_class: int = 0
    """Also in the reason. Reasons of other cells than the published one have other names."""
    rule: int = 0
    classes: dict[str, list[int]] = field(default_factory=dict)
    """Per recorded reason: lines, and those that agree on success or failure."""
    disagreements: list[dict[str, Any]] = field(default_factory=list)
    """Lines that differ on success or failure, with both reasons."""

    @property
    def fraction(self) -> float:
        """Share of the lines that agree."""
        return self.agree / max(self.lines, 1)

    def to_dict(self) -> dict[str, Any]:
        return asdict(self) | {"fraction": self.fraction}


def is_robot_line(line: Line) -> bool:
    """Whether a line was recorded with an arm."""
    return "grasp_variant" in line


def replay_robot_file(path: Path, cell: Callable[[str], Cell] = published) -> RobotReport:
    """Replay one file of environments with an arm.

    Args:
        path: ``transitions_*robo*`` in the format of the reference.
        cell: makes a cell for rules, a name in :data:`.bullet.cell.RULES`.

    Raises:
        InputError: for a file that is not such a log.
    """
    report, log = RobotReport(file=path.name), Log(path)
    cells: dict[str, Cell] = {}
    try:
        log.index()
        for line in log.lines:
            report.lines += 1
            if not is_robot_line(line):
                raise ValueError("recorded without an arm")
            order = recorded_order(line, log)
            rules = published_rules(order.task)
            if rules not in cells:
                cells[rules] = cell(rules)
                report.cell = cells[rules].name
            _compare(line, order, cells[rules], report)
    except (KeyError, TypeError, ValueError, IndexError) as error:
        if isinstance(error, InputError):
            raise
        got = f"no field {error}" if isinstance(error, KeyError) else str(error)
        where = f"{path.name} line {max(report.lines, 1)}"
        raise InputError(where, got, "a recorded transition of an arm") from None
    return report


class Order(NamedTuple):
    """What a line asks of the arm."""

    task: Task
    scene: Scene
    move: Move
    top: bool
    """Whether the reference is below the target."""


def recorded_order(line: Line, log: Log) -> Order:
    """Scene and move of a recorded line; KeyError, ValueError where it lacks something.

    Blocks stand upright and unturned, as far as the log says.
    """
    task = get_task(look_up("variant", line["variant"], VARIANTS))
    placed = np.array(line["placed"], float)
    waiting = np.array([row[:3] for row in line["unplaced"]], float)
    count, several = len(placed), task.objects != "cubes"
    number = np.arange(count + len(waiting))
    level = 0.0
    if several:
        planned = line["unplaced_info"]
        number[:count] = log.placed_objects(line)
        number[count:] = [count + n for n in waiting_objects(planned)]
        # An object's bottom goes to the reference's level.
        level = planned[line["blk"]][2]
    relation = line["place_dir"]
    step = task.pitch * DIRECTIONS[relation] if relation else np.array([0.0, 0.0, EDGE])
    target = placed[line["ref"]] + step + [0.0, 0.0, level]
    pair = get_grasps("paper")[line["grasp_variant"]]
    scene = Scene(np.vstack([placed, waiting]), np.zeros(len(number)), number, count)
    if not (0 <= line["blk"] < len(waiting) and len(number) <= MAX_CELLS):
        raise ValueError(f"blk is {line['blk']!r} of {len(waiting)}")
    return Order(
        task, scene, Move(count + line["blk"], target, pair.grasp, pair.place), not relation
    )


def simple_rule(order: Order) -> bool:
    """Whether plain geometry calls a move possible: nothing is at the cell or above it, and no
    neighbour on the axis the fingers close along is as high or higher."""
    scene, move, reach = order.scene, order.move, order.task.pitch / 2
    gap = scene.position[: scene.num_placed] - move.target
    axis = int(np.argmax(np.abs(move.place.rotation()[:2, 1])))
    along, across = np.abs(gap[:, axis]), np.abs(gap[:, 1 - axis])
    high = gap[:, 2] > -HALF
    return not (high & (across < reach) & (along < 3 * reach)).any()


def _compare(line: Line, order: Order, cell: Cell, report: RobotReport) -> None:
    attempt = _attempt(cell, order)
    theirs = SUCCESS if line["fail"] is None else look_up("fail", line["fail"], CLASSES)
    agrees = attempt.reached == (not line["invalid"])
    tally = report.classes.setdefault(theirs, [0, 0])
    tally[0] += 1
    tally[1] += agrees
    report.agree += agrees
    report.same_class += (SUCCESS if attempt.reached else attempt.stage) == theirs
    report.rule += simple_rule(order) == (not line["invalid"])
    if not agrees:
        here = SUCCESS if attempt.reached else f"{attempt.outcome.label}: {attempt.stage}"
        report.disagreements.append(
            {"line": report.lines, "ep": line["ep"], "t": line["t"], "recorded": theirs,
             "here": here, "detail": attempt.detail}
        )  # fmt: skip


def _attempt(cell: Cell, order: Order) -> Attempt:
    if isinstance(cell, PublishedCell):
        return cell.attempt(order.scene, order.move, order.top)
    return cell.attempt(order.scene, order.move)
