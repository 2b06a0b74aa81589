"""Replay of recorded transitions of the published simulator, step by step.

Each line restores the recorded state before the step, repeats the action here, and compares. The
two pixel counts are compared on the recorded poses (before and after), so they test the camera
and nothing else; validity, reward and end are compared on our own outcome of the action.
"""

from __future__ import annotations

import gzip
import itertools
import json
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from learn2assemble.errors import InputError
from learn2assemble.geometry.mask import paper_mask
from learn2assemble.physics.protocol import Physics, Verdict
from learn2assemble.physics.static import StaticPhysics
from learn2assemble.world.actions import RELATIONS
from learn2assemble.world.rules import (
    DISCRETE,
    count_row,
    cover_block,
    judge,
    move_block,
    recover_all,
    target_cell,
)
from learn2assemble.world.sides import side_frames
from learn2assemble.world.state import State, empty_state

SUCCESS_THRESHOLD = 0.975
TILT_LIMIT = 2e-3
"""Structures with a block tilted by more than this [rad] are excepted from the pixel comparison:
the logs hold positions only, and at this tilt an edge of a block is off by 0.1 mm."""
LOG_ROUNDING = 5e-8
"""Half a unit of the last decimal of the recorded vertices [m]."""
_SIDES = {"1mimic": 1, "2wo": 2, "4wo": 4}


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
    masks_within_rounding: int = 0
    """Masks that agree only for vertices moved by the rounding of the log; counted as exact."""
    real_lines: int = 0
    disagreements: list[dict[str, Any]] = field(default_factory=list)

    def to_dict(self) -> dict[str, Any]:
        return asdict(self)


class _Tally:
    """Running agreement of one quantity."""

    def __init__(self) -> None:
        self.good, self.all = 0, 0

    def add(self, agrees: bool) -> bool:
        self.good += int(agrees)
        self.all += 1
        return agrees

    @property
    def fraction(self) -> float:
        return self.good / self.all if self.all else 1.0


def read_lines(path: Path) -> Iterator[dict[str, Any]]:
    """The JSON objects of a ``.jsonl`` or ``.jsonl.gz`` file.

    Raises:
        InputError: where the file is missing, unreadable or not lines of JSON objects.
    """
    if not path.is_file():
        raise InputError("recorded transitions", str(path), "an existing .jsonl or .jsonl.gz file")
    opener = gzip.open if path.suffix == ".gz" else open
    number = 0
    try:
        with opener(path, "rt", encoding="utf-8") as stream:
            for text in stream:
                number += 1
                value = json.loads(text)
                if not isinstance(value, dict):
                    raise ValueError("not an object")
                yield value
    except (OSError, ValueError, EOFError, zlib.error) as error:
        raise InputError(
            f"{path.name} line {max(number, 1)}", str(error), "a JSON object"
        ) from None


class _Scene:
    """One world restored from a recorded line, with the targets of its episode."""

    def __init__(self, line: dict[str, Any], frames: np.ndarray) -> None:
        targets = line["targets"]
        sides = len(frames)
        if len(targets) != sides or any(not 3 <= len(side) <= 5 for side in targets):
            raise ValueError(f"targets are not {sides} outlines of 3 to 5 vertices")
        blocks = len(line["placed"]) + len(line["unplaced"]) + 1
        vertices = max(len(side) for side in targets)
        self.frames = frames
        self.state: State = empty_state(1, sides, vertices, blocks)
        self.mask_px = []
        for side, points in enumerate(targets):
            c, s, tx, ty = frames[side]
            world = np.asarray(points, float)
            local_x = c * (world[:, 0] - tx) + s * (world[:, 1] - ty)
            self.state.vertices[0, side, : len(points)] = np.stack([local_x, world[:, 2]], -1)
            self.state.num_vertices[0, side] = len(points)
            outline = self.state.vertices[0, side]
            self.mask_px.append(paper_mask(outline, len(points), self.state.mask[0, side]))
        self.state.mask_rows[0] = 0, self.state.mask.shape[2]
        self.state.mask_pixels[0] = sum(self.mask_px)

    def rounding_explains(self, side: int, recorded: int) -> bool:
        """Whether the mask has the recorded size for vertices within the rounding of the log.

        Vertices are rounded to whole pixels, so one that lies on a pixel boundary up to the last
        decimal of the log may fall on either side of it.
        """
        count = int(self.state.num_vertices[0, side])
        outline = self.state.vertices[0, side]
        mask = np.empty_like(self.state.mask[0, side])
        for vertex, axis, sign in itertools.product(range(count), range(2), (-1, 1)):
            moved = outline.copy()
            moved[vertex, axis] += sign * LOG_ROUNDING
            if paper_mask(moved, count, mask) == recorded:
                self.state.mask[0, side] = mask
                return True
        return False

    def place(self, placed: list[list[float]], num_unplaced: int) -> State:
        """Put the recorded blocks; returns the state with both pixel sets computed."""
        count = len(placed)
        self.state.position[0] = 0.0
        self.state.position[0, :count] = placed
        self.state.num_placed[0], self.state.num_blocks[0] = count, count + num_unplaced
        recover_all(self.state, 0, self.frames)
        count_row(self.state, 0)
        return self.state

    def counts(self) -> tuple[list[int], list[int]]:
        """Plane and complete pixels of every side."""
        mask, covered, occluded = self.state.mask[0], self.state.covered[0], self.state.occluded[0]
        seen = mask & covered
        return _count(seen & ~occluded), _count(seen)


def _count(image: np.ndarray) -> list[int]:
    return [int(np.bitwise_count(side).sum()) for side in image]


def replay_file(path: Path, rigid: Physics | None = None) -> ReplayReport:
    """Replay one file of cube environments without a robot.

    Args:
        path: ``transitions_2wo_*``, ``4wo_*`` or ``1mimic_*`` in the format of the reference.
        rigid: a second physics whose validity is reported as ``valid_rigid``.

    Raises:
        InputError: for a file that is not such a log.
    """
    report = ReplayReport(file=path.name)
    names = ("mask", "plane", "complete", "static", "rigid", "reward", "done")
    tallies = {name: _Tally() for name in names}
    lines = list(read_lines(path))
    if not lines:
        raise InputError("recorded transitions", path.name, "a file with at least one line")
    try:
        # A probe comes before the real step of the same state, which holds the problem.
        problems = {
            (line["ep"], line["t"]): line for line in lines if line.get("kind", "real") == "real"
        }
        for line in lines:
            _replay_line(line, problems, report, tallies, rigid)
    except (KeyError, TypeError, ValueError, IndexError) as error:
        if isinstance(error, InputError):
            raise
        got = f"no field {error}" if isinstance(error, KeyError) else str(error)
        where = f"{path.name} line {max(report.lines, 1)}"
        raise InputError(where, got, "a recorded transition") from None
    report.mask_exact = tallies["mask"].fraction
    report.plane_exact = tallies["plane"].fraction
    report.complete_exact = tallies["complete"].fraction
    report.valid_static = tallies["static"].fraction
    report.valid_rigid = tallies["rigid"].fraction if rigid is not None else None
    report.reward, report.done = tallies["reward"].fraction, tallies["done"].fraction
    return report


def replay_files(paths: Iterable[Path], rigid: Physics | None = None) -> list[ReplayReport]:
    """One report per file."""
    return [replay_file(path, rigid) for path in paths]


def _replay_line(
    line: dict[str, Any],
    problems: dict[tuple[int, int], dict[str, Any]],
    report: ReplayReport,
    tallies: dict[str, _Tally],
    rigid: Physics | None,
) -> None:
    report.lines += 1
    variant = line["variant"]
    if variant not in _SIDES:
        raise InputError(
            f"{report.file} variant", variant, f"one of {', '.join(_SIDES)} (cubes, no robot)"
        )
    real = line.get("kind", "real") == "real"
    key = (line["ep"], line["t"])
    if key not in problems:
        raise InputError(f"{report.file} line {report.lines}", key, "a step with a real line")
    unplaced = problems[key]["unplaced"]
    _check_indices(line, len(unplaced))
    scene = _Scene(problems[key], side_frames(_SIDES[variant]))

    if real:
        for side, theirs in enumerate(line["mask_px"]):
            exact = scene.mask_px[side] == theirs
            if not exact and scene.rounding_explains(side, theirs):
                exact = True
                report.masks_within_rounding += 1
            tallies["mask"].add(exact)
    earlier = problems.get((line["ep"], line["t"] - 1))
    tilt = {
        # A probe starts from a restored state, upright by construction.
        "before": earlier["tilt_after"] if real and earlier is not None else 0.0,
        "after": line["tilt_after"],
    }
    for when in ("before", "after"):
        placed = line["placed"] if when == "before" else line["placed_after"]
        views = len(scene.mask_px)
        if tilt[when] > TILT_LIMIT:
            report.tilted_views += views
            continue
        scene.place(placed, len(unplaced))
        for name, mine in zip(("plane", "complete"), scene.counts(), strict=True):
            theirs = line[f"px_{'plane' if name == 'plane' else 'comp'}_{when}"]
            for a, b in zip(mine, theirs, strict=True):
                tallies[name].add(a == b)
                report.max_px_diff = max(report.max_px_diff, abs(a - b))
        report.views += views

    valid, reward, done = _repeat(scene, line, len(unplaced), StaticPhysics())
    agrees = tallies["static"].add(valid == (not line["invalid"]))
    note = {"line": report.lines, "ep": line["ep"], "t": line["t"], "accv": line["accv"],
            "recorded_invalid": line["invalid"]}  # fmt: skip
    if not agrees:
        report.disagreements.append({**note, "physics": "static"})
    if real:
        report.real_lines += 1
        tallies["reward"].add(reward == line["reward"])
        tallies["done"].add(done == line["done"])
    if rigid is not None:
        valid, _, _ = _repeat(scene, line, len(unplaced), rigid)
        if not tallies["rigid"].add(valid == (not line["invalid"])):
            report.disagreements.append({**note, "physics": rigid.name})


def _check_indices(line: dict[str, Any], num_unplaced: int) -> None:
    """Refuse what compiled code would read beyond its arrays."""
    limits = {"blk": num_unplaced, "ref": len(line["placed"])}
    values = {name: line[name] for name in limits} | {"u[2]": line["u"][2]}
    for name, value in values.items():
        limit = limits.get(name, len(RELATIONS))
        if type(value) is not int or not 0 <= value < limit:
            raise ValueError(f"{name} is {value!r}, not an index below {limit}")


def _repeat(
    scene: _Scene, line: dict[str, Any], num_unplaced: int, physics: Physics
) -> tuple[bool, float, bool]:
    """Our outcome of the recorded action from the recorded state: valid, reward, done."""
    state = scene.place(line["placed"], num_unplaced)
    state.initial_pixels[0] = line["px_init"]
    previous = int(state.plane_pixels[0])
    x, y, z = target_cell(state, 0, line["ref"], line["u"][2])
    move_block(state, 0, line["blk"], line["ref"], x, y, z)
    verdict = physics.settle(state, np.array([0]))[0]
    if physics.moves_blocks:
        recover_all(state, 0, scene.frames)
    else:
        cover_block(state, 0, scene.frames, int(state.num_placed[0]) - 1)
    count_row(state, 0)
    valid = bool(verdict == Verdict.STABLE)
    reward, done, _ = judge(state, 0, previous, valid, DISCRETE, SUCCESS_THRESHOLD)
    state.quaternion[0] = (1.0, 0.0, 0.0, 0.0)
    return valid, reward, done
