"""Replay of recorded transitions of the published simulator, step by step.

Each line restores the recorded state before the step, repeats the action here, and compares. The
two pixel counts are compared on the recorded poses (before and after), so they test the camera
only; validity, reward and end are compared on our own outcome of the action.

Probes were made on a restored copy of the recorded world, which has lost the joints between the
cells of objects; so where blocks come in objects, only real steps are compared.

With a robot, only what is before a failed step is compared by :func:`replay_file`. Of the others
all is: whether static physics lets it stand where the block was commanded to, and what it pays
where the arm has left it. :func:`replay_robot_file` orders the same moves in a cell of ours: does
it fail where theirs did, and for the same reason? What the logs do not hold: how blocks that an
earlier step pushed are turned, and what moved at that moment.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from l2a_lab.bullet.cell import PublishedCell, published_rules
from l2a_lab.recordings import (
    UNEXPLAINED,
    VARIANTS,
    Line,
    Log,
    RecordedScene,
    drifted,
    explain,
    is_real,
    starts_or_ends_on_edge,
    waiting_objects,
    waiting_rows,
)
from learn2assemble.constants import EDGE, HALF
from learn2assemble.errors import InputError, look_up
from learn2assemble.robot.arm import get_arm
from learn2assemble.robot.grasps import get_grasps
from learn2assemble.robot.moves import Move, Scene
from learn2assemble.tasks.physics.protocol import Physics, PlacementVerdict
from learn2assemble.tasks.physics.static import StaticPhysics
from learn2assemble.tasks.task import Task, get_task
from learn2assemble.tasks.world.blocks import DIRECTIONS
from learn2assemble.tasks.world.rules import (
    REWARDS,
    count_row,
    last_object,
    move_block,
    recover_all,
    reward_and_end,
    target_cell,
    waiting_level,
)


@dataclass
class ReplayReport:
    """Agreement of one file; fractions, except the counts and ``max_px_diff``."""

    file: str
    lines: int = 0
    mask_exact: float = 1.0
    plane_exact: float = 1.0
    complete_exact: float = 1.0
    max_px_diff: int = 0
    valid_static: float = 1.0
    valid_rigid: float | None = None
    reward: float = 1.0
    done: float = 1.0
    views: int = 0
    tilted_views: int = 0
    """Views left out because blocks stand where the log does not say."""
    masks_within_rounding: int = 0
    """Masks that agree only for vertices moved by the rounding of the log; counted as exact."""
    real_lines: int = 0
    judged_lines: int = 0
    """Lines whose validity was compared: all of cubes, the real ones of objects, and those with a
    robot at which the arm did not fail."""
    edge_lines: int = 0
    """Those of objects that balance on an edge, see :func:`starts_or_ends_on_edge`."""
    valid_static_firm: float = 1.0
    """``valid_static`` without them."""
    valid_rigid_firm: float | None = None
    disagreements: list[dict[str, Any]] = field(default_factory=list[dict[str, Any]])
    """Per line and physics that differ in validity; ``why`` is the class of :func:`explain`."""

    def to_dict(self) -> dict[str, Any]:
        return asdict(self)


TILT_LIMIT = 2e-3
"""Structures with a block tilted by more than this [rad] are excepted from the pixel comparison:
the logs hold positions only, and at this tilt an edge of a block is off by 0.1 mm."""
REWARD_TOLERANCE = 1e-9
Agreement = defaultdict[str, list[bool]]
"""Comparisons by the field of the report that says which share of them agrees."""


@contextmanager
def _reading(report: ReplayReport | RobotReport, what: str) -> Generator[None, None, None]:
    """What a log lacks, as an error that names file and line."""
    try:
        yield
    except (KeyError, TypeError, ValueError, IndexError) as error:
        if isinstance(error, InputError):
            raise
        got = f"no field {error}" if isinstance(error, KeyError) else str(error)
        where = f"{report.file} line {max(report.lines, 1)}"
        raise InputError(where, got, f"a recorded transition{what}") from None


def replay_file(path: Path, rigid: Callable[[str], Physics] | None = None) -> ReplayReport:
    """Replay one file.

    Args:
        path: ``transitions_*`` of a variant in :data:`VARIANTS`, in the format of the reference.
        rigid: makes a second physics from the rule of stability (``RigidPhysics``); its validity
            is reported as ``valid_rigid``.

    Raises:
        InputError: for a file that is not such a log.
    """
    report, agreement = ReplayReport(file=path.name), Agreement(list)
    judges: dict[str, Physics] = {}
    with _reading(report, ""):
        log = Log(path)
        for line in log.lines:
            report.lines += 1
            name = line["variant"]
            if name not in VARIANTS:
                raise InputError(f"{path.name} variant", name, f"one of {', '.join(VARIANTS)}")
            task = get_task(VARIANTS[name])
            if rigid is not None and task.stability not in judges:
                judges[task.stability] = rigid(task.stability)
            _replay_line(line, task, log, report, agreement, judges.get(task.stability))
    for name, found in agreement.items():
        setattr(report, name, sum(found) / len(found))
    return report


def _replay_line(
    line: Line,
    task: Task,
    log: Log,
    report: ReplayReport,
    agreement: Agreement,
    rigid: Physics | None,
) -> None:
    real, robot, several = is_real(line), not task.touching, task.objects != "cubes"
    key = (line["ep"], line["t"])
    if key not in log.problems:
        raise InputError(f"{report.file} line {report.lines}", key, "a step with a real line")
    if several and not real:
        return
    problem = log.problems[key]
    unplaced = waiting_rows(problem, task)
    _check_indices(line, len(unplaced), task.num_actions)
    scene = RecordedScene(problem, task)
    if real:
        for side, theirs in enumerate(line["mask_px"]):
            exact = scene.mask_px[side] == theirs
            if not exact and scene.rounding_explains(side, theirs):
                exact = True
                report.masks_within_rounding += 1
            agreement["mask_exact"].append(exact)
    _compare_pixels(line, log, scene, report, agreement)
    if robot and line["invalid"]:
        return

    objects = log.placed_objects(problem) if several else None
    report.judged_lines += 1
    note = {name: line[name] for name in (("ep", "t") if robot else ("ep", "t", "accv"))}
    speeds: list[float] = [] if robot else line["accv_obj"]
    outcome = _repeat(scene, line, unplaced, objects, StaticPhysics())
    if real:
        report.real_lines += 1
        agreement["reward"].append(abs(outcome.reward - line["reward"]) <= REWARD_TOLERANCE)
        agreement["done"].append(outcome.done == line["done"])
    edge = several and not robot and starts_or_ends_on_edge(*outcome.structure)
    report.edge_lines += int(edge)
    outcomes = {"static": outcome}
    if rigid is not None and not robot:
        outcomes["rigid"] = _repeat(scene, line, unplaced, objects, rigid)
    for name, outcome in outcomes.items():
        agrees = outcome.valid != line["invalid"]
        agreement[f"valid_{name}"].append(agrees)
        if not edge:
            agreement[f"valid_{name}_firm"].append(agrees)
        if not agrees:
            if robot:
                # What an arm drops in mid-air may fall softly.
                centres, _, new = outcome.structure
                drop = centres[new, 2] - line["placed_after"][new][2]
                why = "fell" if drop > HALF else UNEXPLAINED
            else:
                why = explain(*outcome.structure, line["invalid"], speeds)
            report.disagreements.append(
                {
                    "line": report.lines,
                    **note,
                    "recorded_invalid": line["invalid"],
                    "physics": name,
                    "why": why,
                }
            )


def _compare_pixels(
    line: Line, log: Log, scene: RecordedScene, report: ReplayReport, agreement: Agreement
) -> None:
    """Both covers on the recorded poses before and after the step."""
    robot = not scene.task.touching
    earlier = log.problems.get((line["ep"], line["t"] - 1))
    # A probe starts from a restored state, upright by construction.
    tilt = {"before": 0.0, "after": 0.0}
    if not robot:
        tilt["after"] = line["tilt_after"]
        if is_real(line) and earlier is not None:
            tilt["before"] = earlier["tilt_after"]
    views = len(scene.mask_px)
    for when, blocks in (("before", line["placed"]), ("after", line["placed_after"])):
        if robot and when == "after" and line["invalid"]:
            continue
        if tilt[when] > TILT_LIMIT or (robot and drifted(blocks, scene.task.pitch)):
            report.tilted_views += views
            continue
        scene.place(blocks, 0)
        for name, mine in zip(("plane", "complete"), scene.counts(), strict=True):
            theirs = line[f"px_{'plane' if name == 'plane' else 'comp'}_{when}"]
            for a, b in zip(mine, theirs, strict=True):
                agreement[f"{name}_exact"].append(a == b)
                report.max_px_diff = max(report.max_px_diff, abs(a - b))
        report.views += views


def _check_indices(line: Line, num_unplaced: int, num_actions: int) -> None:
    """Refuse what compiled code would read beyond its arrays."""
    limits = {"blk": num_unplaced, "ref": len(line["placed"])}
    values = {name: line[name] for name in limits} | {"u[2]": line["u"][2]}
    for name, value in values.items():
        limit = limits.get(name, num_actions)
        if type(value) is not int or not 0 <= value < limit:
            raise ValueError(f"{name} is {value!r}, not an index below {limit}")


class _ReplayOutcome(NamedTuple):
    valid: bool
    reward: float
    done: bool
    structure: tuple[np.ndarray, np.ndarray, int]
    """Centres float64[n, 3] [m] of the placed blocks with the new object where it was commanded,
    their objects int64[n], and the first cell of the new one."""


def _repeat(
    scene: RecordedScene,
    line: Line,
    unplaced: list[list[float]],
    objects: list[int] | None,
    physics: Physics,
) -> _ReplayOutcome:
    """Our outcome of the recorded action from the recorded state."""
    task, spec = scene.task, scene.task.action_spec
    state = scene.place(line["placed"], len(unplaced))
    if objects is not None:
        scene.group(objects, unplaced)
    state.initial_pixels[0] = line["px_init"] if task.normalise_initial else 0
    previous = int(state.plane_pixels[0])
    relation, way = divmod(line["u"][2], task.rotations)
    x, y, z = target_cell(state, 0, line["ref"], relation, task.pitch)
    if spec.level:
        z += waiting_level(state.position[0, state.num_placed[0] + line["blk"], 2])
    move_block(state, 0, line["blk"], line["ref"], x, y, z, int(spec.turns[way]), task.pitch)
    count, new = int(state.num_placed[0]), last_object(state, 0)
    centres, object_id = state.position[0, :count].copy(), state.object_id[0, :count].copy()
    verdict = physics.settle(state, np.array([0]))[0]
    if not task.touching:
        # An arm leaves blocks some tenths of a millimetre beside their places.
        state.position[0, :count] = line["placed_after"]
    recover_all(state, 0, scene.frames, scene.depths)
    count_row(state, 0)
    valid = bool(verdict == PlacementVerdict.STABLE)
    reward, done, _ = reward_and_end(
        state, 0, previous, valid, REWARDS[task.reward], task.success_threshold
    )
    state.quaternion[0] = (1.0, 0.0, 0.0, 0.0)
    return _ReplayOutcome(valid, reward, done, (centres, object_id, new))


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


@dataclass
class RobotReport:
    """Agreement of one file on success or failure; ``rule`` is that of :func:`simple_rule`."""

    file: str
    cell: str = PublishedCell.name
    lines: int = 0
    agree: int = 0
    same_class: int = 0
    """Also in the reason."""
    rule: int = 0
    classes: dict[str, list[int]] = field(default_factory=dict[str, list[int]])
    """Per recorded reason: lines, and those that agree on success or failure."""
    disagreements: list[dict[str, Any]] = field(default_factory=list[dict[str, Any]])
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


def replay_robot_file(path: Path) -> RobotReport:
    """Replay one file of environments with an arm, ``transitions_*robo*``, in the published cell.

    Raises:
        InputError: for a file that is not such a log.
    """
    report = RobotReport(file=path.name)
    cells: dict[str, PublishedCell] = {}
    with _reading(report, " of an arm"):
        log = Log(path)
        for line in log.lines:
            report.lines += 1
            if not is_robot_line(line):
                raise ValueError("recorded without an arm")
            order = recorded_order(line, log)
            rules = published_rules(order.task)
            if rules not in cells:
                cells[rules] = PublishedCell(get_arm("panda"), rules)
            _compare(line, order, cells[rules], report)
    return report


class ReplayOrder(NamedTuple):
    """What a line asks of the arm."""

    task: Task
    scene: Scene
    move: Move
    top: bool
    """Whether the reference is below the target."""


def recorded_order(line: Line, log: Log) -> ReplayOrder:
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
    variant: int = line["grasp_variant"]
    pair = get_grasps("paper")[variant]
    scene = Scene(np.vstack([placed, waiting]), np.zeros(len(number)), number, count)
    if not (0 <= line["blk"] < len(waiting) and len(number) <= MAX_CELLS):
        raise ValueError(f"blk is {line['blk']!r} of {len(waiting)}")
    return ReplayOrder(
        task, scene, Move(count + line["blk"], target, pair.grasp, pair.place), not relation
    )


def simple_rule(order: ReplayOrder) -> bool:
    """Whether plain geometry calls a move possible: nothing is at the cell or above it, and no
    neighbour on the axis the fingers close along is as high or higher."""
    scene, move, reach = order.scene, order.move, order.task.pitch / 2
    gap = scene.position[: scene.num_placed] - move.target
    axis = int(np.argmax(np.abs(move.place.rotation()[:2, 1])))
    along, across = np.abs(gap[:, axis]), np.abs(gap[:, 1 - axis])
    high = gap[:, 2] > -HALF
    return not (high & (across < reach) & (along < 3 * reach)).any()


def _compare(line: Line, order: ReplayOrder, cell: PublishedCell, report: RobotReport) -> None:
    attempt = cell.attempt(order.scene, order.move, order.top)
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
            {
                "line": report.lines,
                "ep": line["ep"],
                "t": line["t"],
                "recorded": theirs,
                "here": here,
                "detail": attempt.detail,
            }
        )
