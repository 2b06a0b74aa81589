"""What is kept of a build: a file that is appended to after every attempt, and the record of what
the arm did.

The first line of the file says what is built, every other line is the whole state after an attempt,
with what the arm did in it. A line that was cut off is not read: what it says was not done.
"""

from __future__ import annotations

import base64
import dataclasses
import json
import zlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from learn2assemble.cell.world import HIDDEN, OBSTACLE_DENSITY, Rows, WorkcellBlocks
from learn2assemble.errors import InputError
from learn2assemble.files import append_line, unwritable, write_file
from learn2assemble.geometry.hulls import Hull
from learn2assemble.geometry.rotations import quaternion_matrix, yaw_quaternion
from learn2assemble.motion.record import BuildRecord, ByHand, Samples, Stage, StepRecord
from learn2assemble.motion.recorder import BuildRecorder, CellShapes
from learn2assemble.robot.moves import Outcome
from learn2assemble.robot.studs import GROUND, Studs

if TYPE_CHECKING:
    from learn2assemble.cell.site import Obstacle
    from learn2assemble.cell.workcell import Job

FORMAT, VERSION = "learn2assemble-build", 5
SUM = "checksum"
"""Key of every state: the CRC-32 of the rest, so that damage is seen whatever it hits."""


class Kept(NamedTuple):
    """How a simulated world is kept in the file of a build; it is not looked at."""

    save: Callable[[], dict[str, Any]]
    restore: Callable[[dict[str, Any]], None]

    @classmethod
    def of(cls, plant: Any) -> Kept | None:
        """That of a plant; None where there is none."""
        save, restore = getattr(plant, "state", None), getattr(plant, "restore", None)
        return None if save is None or restore is None else cls(save, restore)


def read_states(path: Path, key: str) -> list[dict[str, Any]]:
    """The states in a file, oldest first; an incomplete last line is cut off the file.

    Args:
        path: written with its first line where it does not exist.
        key: of what is built.

    Raises:
        InputError: for a file of another build, a damaged one, and one that cannot be written.
    """
    head = json.dumps({"format": FORMAT, "version": VERSION, "key": key})
    try:
        text = path.read_text(encoding="utf-8") if path.exists() else ""
        if head.startswith(text):  # Not even the first line is whole.
            write_file(path, head + "\n", "--resume")
            return []
        first, *lines = text.split("\n")[:-1]
        if first != head:
            same = "design, kit, arm, tool, layout, seed, physics and noise"
            expected = f"the same {same} as before"
            raise InputError("--resume", str(path), expected)
        states = [_unsealed(line) for line in lines]
        write_file(path, "".join(f"{line}\n" for line in (first, *lines)), "--resume")
    except OSError as error:
        raise unwritable("--resume", path, error) from None
    except InputError:
        raise
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        raise InputError("--resume", str(path), "the undamaged file of a build") from None
    return states


def append_state(path: Path, state: dict[str, Any]) -> None:
    """Append a state; it is on the disk when this returns."""
    append_line(path, json.dumps({**state, SUM: _checksum(state)}), "state of the build")


def _checksum(state: dict[str, Any]) -> int:
    return zlib.crc32(json.dumps(state).encode())


def _unsealed(line: str) -> dict[str, Any]:
    """The state in a line.

    Raises:
        ValueError: where it is not what was written; also other errors, of JSON and of types.
    """
    state = json.loads(line)
    if state.pop(SUM) != _checksum(state):
        raise ValueError("another checksum")
    return state


def packed(value: Any) -> Any:
    """A step of a record, or a value in it, as JSON can write it."""
    if isinstance(value, np.ndarray):
        numbers: np.ndarray = np.ascontiguousarray(value, float)
        data = zlib.compress(numbers.tobytes(), 6)
        return [list(numbers.shape), base64.b64encode(data).decode("ascii")]
    if isinstance(value, StepRecord | Samples):
        return {f.name: packed(getattr(value, f.name)) for f in dataclasses.fields(value)}
    return value


def _array(value: list[Any]) -> np.ndarray:
    data = zlib.decompress(base64.b64decode(value[1]))
    return np.frombuffer(data, float).reshape(value[0]).copy()


def last_joints(step: dict[str, Any] | None) -> np.ndarray | None:
    """float64[n]: where an arm was at the end of a step of a file [rad]; None where it did not
    move."""
    joints = np.empty((0, 0)) if step is None else _array(step["samples"]["joints"])
    return joints[-1].copy() if len(joints) else None


def _unpacked(value: dict[str, Any]) -> StepRecord:
    samples = Samples(**{name: _array(array) for name, array in value["samples"].items()})
    told = ("target", "before", "after", "source")
    arrays = {name: _array(value[name]) for name in told if value.get(name) is not None}
    fields: dict[str, Any] = {
        **value,
        **arrays,
        "samples": samples,
        "cells": tuple(value["cells"]),
        "stages": tuple(Stage(*stage) for stage in value["stages"]),
        "outcome": Outcome(value["outcome"]),
    }
    return StepRecord(**fields)


class Recording:
    """The record of a build, whose cells are those of physical blocks, replaced ones included, and
    of obstacles.

    Args:
        world: where everything is.
        joints: float64[n] where the arm begins [rad].
        words: what the outcomes come from.
        studs: joints of the structure, in pieces; None: there are none.
    """

    world: WorkcellBlocks
    job: Job
    words: str
    studs: Studs | None
    recorder: BuildRecorder

    def __init__(
        self, world: WorkcellBlocks, joints: np.ndarray, words: str, studs: Studs | None = None
    ) -> None:
        self.world, self.job, self.words, self.studs = world, world.job, words, studs
        count = len(world.pieces)
        self.body: list[int] = list(range(count))
        """The physical block that each piece is; others where one was lost."""
        self.like: list[int] = []
        """Of every block beyond those of the plan, the piece it is like."""
        self.cells: list[tuple[int, ...]] = world.cells()
        self.obstacles: list[Obstacle] = [one for one in self.job.obstacles if not one.aside]
        self.fixed: list[int] = [sum(map(len, self.cells)) + n for n in range(len(self.obstacles))]
        self.hands: list[ByHand] = []
        self.taken: dict[int, np.ndarray] = {}
        """float64[7] of each piece of the attempt that is under way: where it was when that
        began."""
        self._start(joints, 0.0, *self._there())

    def begin(self, joints: np.ndarray, width: float) -> None:
        """The first attempt has been carried out, from where everything is in the record; the pads
        were ``width`` apart [m]."""
        made = self.recorder
        self._start(joints, width, made.poses, made.objects, made.half, made.density, made.hull)

    def _start(
        self,
        joints: np.ndarray,
        width: float,
        poses: np.ndarray,
        objects: tuple[tuple[int, ...], ...],
        *shapes: Any,
    ) -> None:
        self.recorder = BuildRecorder(
            self.job.arm, joints, width, poses, objects, self.words, CellShapes(*shapes)
        )

    def takes(self, pieces: Sequence[int]) -> None:
        """An attempt with these pieces is about to begin: until it is in the record, they are there
        where they are now, whatever is seen of them meanwhile."""
        self.taken = {k: self.world.pose[k].copy() for k in pieces}
        self.sync()

    def by_hand(self, k: int, place: bool, stood: float, pose: np.ndarray) -> None:
        """A block is about to be placed or taken away by hand.

        Args:
            k: its piece.
            place: whether it is placed.
            stood: so long the arm has stood since its last motion [s].
            pose: float64[7]: where it is to stand, or stands.
        """
        made, piece, turn = self.recorder, self.world.pieces[k], quaternion_matrix(pose[3:])
        cells = self.cells[self.body[k]]
        at = [[*(pose[:3] + turn @ np.array(one.centre)), *pose[3:]] for one in piece.shape]
        rows: list[list[float]] = np.round(at, 6).tolist()
        poses = tuple(tuple(row) for row in rows)
        hand = ByHand(len(made.steps), cells, piece.id, place, made.now + stood, poses)
        self.hands.append(hand)

    def sync(self) -> None:
        """The record has all cells there are now, and they are where they are now."""
        made = self.recorder
        made.poses, made.objects, made.half, made.density, made.hull = self._there()
        if made.steps:
            made.steps[-1] = dataclasses.replace(made.steps[-1], after=made.poses)

    def _there(
        self,
    ) -> tuple[
        np.ndarray,
        tuple[tuple[int, ...], ...],
        np.ndarray,
        np.ndarray,
        tuple[Hull | None, ...] | None,
    ]:
        """Poses float64[C, 7] of all cells of the record, its objects, half extents float64[C, 3]
        [m], densities float64[C] [kg/m3] and hulls."""
        count = sum(map(len, self.cells)) + len(self.fixed)
        halves, densities, poses = np.empty((count, 3)), np.empty(count), np.zeros((count, 7))
        hulls: list[Hull | None] = [None] * count
        for k, (body, piece) in enumerate(zip(self.body, self.world.pieces, strict=True)):
            pose = self.taken[k] if k in self.taken else self.world.pose[k]
            turn = quaternion_matrix(pose[3:])
            for cell, part in zip(self.cells[body], piece.shape, strict=True):
                halves[cell], hulls[cell] = part.half, part.hull
                densities[cell] = piece.density
                poses[cell] = [*(pose[:3] + turn @ np.array(part.centre)), *pose[3:]]
        for cell, obstacle in zip(self.fixed, self.obstacles, strict=True):
            halves[cell], densities[cell] = np.array(obstacle.size) / 2, OBSTACLE_DENSITY
            poses[cell] = [*obstacle.middle, *yaw_quaternion(obstacle.yaw)]
        objects = (*self.cells, *((cell,) for cell in self.fixed))
        return poses, objects, halves, densities, tuple(hulls) if any(hulls) else None

    def numbers(self, rows: Rows) -> np.ndarray:
        """int64[n]: cell of the record of each row; -1: none."""
        fixed = [*self.fixed, *[-1] * (len(rows.owner) - len(self.fixed))]
        owners: list[int] = rows.owner.tolist()
        parts: list[int] = rows.part.tolist()
        return np.array(
            [
                fixed[part] if owner < 0 else self.cells[self.body[owner]][part]
                for owner, part in zip(owners, parts, strict=True)
            ]
        )

    def replace(self, k: int) -> int:
        """Another block takes the place of a piece; the number of this one from now on."""
        spare = self.world.add(k)
        self.like.append(k)
        first = sum(map(len, self.cells)) + len(self.fixed)
        self.cells.append(tuple(range(first, first + len(self.world.pieces[k].shape))))
        self.body.append(self.body[k])
        self.body[k] = len(self.cells) - 1
        return spare

    def cells_at(self, poses: Mapping[str, np.ndarray], otherwise: np.ndarray) -> np.ndarray:
        """float64[C, 7]: poses of all cells, of blocks that are at poses float64[7] by their names;
        of others as they are ``otherwise``."""
        found = otherwise.copy()
        for name, body, piece in zip(self.world.names, self.body, self.world.pieces, strict=True):
            if name in poses:
                pose, turn = poses[name], quaternion_matrix(poses[name][3:])
                for cell, part in zip(self.cells[body], piece.shape, strict=True):
                    found[cell] = [*(pose[:3] + turn @ np.array(part.centre)), *pose[3:]]
        return found

    def state(self) -> dict[str, Any]:
        """What a file says of it, besides the steps."""
        return {
            "body": self.body,
            "like": self.like,
            "cells": [list(c) for c in self.cells],
            "hands": [list(hand) for hand in self.hands],
        }

    def restore(self, state: dict[str, Any], steps: list[dict[str, Any]]) -> None:
        """As a file says it was; the world has its blocks already."""
        for step in steps:
            self.recorder.take(_unpacked(step))
        self.body, self.like = state["body"], state["like"]
        self.cells = [tuple(c) for c in state["cells"]]
        self.hands = [*map(ByHand.read, state["hands"])]
        self.sync()

    def record(self) -> BuildRecord:
        """What the arm did."""
        found, hidden = self.recorder.record(), self.recorder.poses.copy()
        hidden[:, 2] = -HIDDEN - 0.1

        def whole(poses: np.ndarray) -> np.ndarray:
            # Replacements wait in their magazines until they are needed.
            return np.vstack([poses, hidden[len(poses) :]])

        steps: list[StepRecord] = []
        for step in found.steps:
            before = steps[-1].after if steps else whole(step.before)
            steps.append(dataclasses.replace(step, before=before, after=whole(step.after)))
        names, kinds = [""] * len(found.objects), [""] * len(found.objects)
        for body, piece in zip(self.body, self.world.pieces, strict=True):
            names[body], kinds[body] = piece.id, piece.kind
        return dataclasses.replace(
            found,
            steps=tuple(steps),
            hands=tuple(self.hands),
            studs=self._joints(),
            names=tuple(names),
            kinds=tuple(kinds),
        )

    def _joints(self) -> Studs | None:
        """Those of studs, in cells of the blocks that the pieces are."""
        if self.studs is None:
            return None
        cell = {GROUND: GROUND, **{k: self.cells[body][0] for k, body in enumerate(self.body)}}
        joints = (
            joint._replace(lower=cell[joint.lower], upper=cell[joint.upper])
            for joint in self.studs.joints
        )
        return Studs(tuple(joints), self.studs.press)
