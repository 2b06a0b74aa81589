"""What a build has done: its record, and a file that is appended to after every attempt, so that it
can go on from there.

The first line says what is built; every other line is the whole state after one attempt, with what
the arm did in it. A line that was cut off is not read: what it says was not done.
"""

from __future__ import annotations

import base64
import dataclasses
import json
import os
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from learn2assemble.errors import InputError
from learn2assemble.files import unwritable
from learn2assemble.geometry.rotations import quaternion_matrix, yaw_quaternion
from learn2assemble.planning.workcell import HIDDEN, OBSTACLE_DENSITY, Rows, World
from learn2assemble.robot.motion.record import BuildRecord, Samples, Stage, StepRecord
from learn2assemble.robot.motion.recorder import BuildRecorder
from learn2assemble.robot.moves import Outcome

FORMAT, VERSION = "learn2assemble-build", 1


def read_states(path: Path, key: str) -> list[dict[str, Any]]:
    """The states in a file, oldest first; an incomplete last line is cut off the file.

    Args:
        path: written with its first line where it does not exist.
        key: of what is built.

    Raises:
        InputError: for a file of another build, a damaged one, and one that cannot be written.
    """
    try:
        lines = path.read_text(encoding="utf-8").split("\n") if path.exists() else []
        if len(lines) < 2:  # Not even the first line is whole.
            head = json.dumps({"format": FORMAT, "version": VERSION, "key": key})
            path.write_text(head + "\n", encoding="utf-8")
            return []
        head, *states = (json.loads(line) for line in lines[:-1])
        if not isinstance(head, dict) or head.get("format") != FORMAT or head.get("key") != key:
            expected = "the same design, kit, arm, tool, layout and seed as before"
            raise InputError("--resume", str(path), expected)
        whole = path.with_suffix(".tmp")
        whole.write_text("\n".join(lines[:-1]) + "\n", encoding="utf-8")
        os.replace(whole, path)
    except OSError as error:
        raise unwritable("--resume", path, error) from None
    except json.JSONDecodeError:
        raise InputError("--resume", str(path), "a file of an interrupted build") from None
    return states


def append_state(path: Path, state: dict[str, Any]) -> None:
    """Append a state; it is on the disk when this returns."""
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(state) + "\n")
        file.flush()
        os.fsync(file.fileno())


def _packed(array: np.ndarray) -> list[Any]:
    data = zlib.compress(np.ascontiguousarray(array, float).tobytes(), 6)
    return [list(array.shape), base64.b64encode(data).decode("ascii")]


def _unpacked(value: list[Any]) -> np.ndarray:
    data = zlib.decompress(base64.b64decode(value[1]))
    return np.frombuffer(data, float).reshape(value[0]).copy()


def packed_step(step: StepRecord) -> dict[str, Any]:
    """A step of a record as plain data."""
    fields = {f.name: getattr(step, f.name) for f in dataclasses.fields(step)}
    fields["outcome"] = int(step.outcome)
    fields["stages"] = [list(stage) for stage in step.stages]
    samples = {f.name: _packed(getattr(step.samples, f.name))
               for f in dataclasses.fields(step.samples)}  # fmt: skip
    for name in ("target", "before", "after"):
        fields[name] = _packed(fields[name])
    return {**fields, "samples": samples}


def unpacked_step(value: dict[str, Any]) -> StepRecord:
    samples = Samples(**{name: _unpacked(array) for name, array in value.pop("samples").items()})
    arrays: dict[str, Any] = {
        name: _unpacked(value.pop(name)) for name in ("target", "before", "after")
    }
    stages = tuple(Stage(*stage) for stage in value.pop("stages"))
    outcome, cells = Outcome(value.pop("outcome")), tuple(value.pop("cells"))
    return StepRecord(**value, **arrays, samples=samples, stages=stages, outcome=outcome,
                      cells=cells)  # fmt: skip


class Book:
    """The record of a build, whose cells are those of physical blocks, replaced ones included, and
    of obstacles.

    Args:
        world: where everything is.
        joints: float64[n] where the arm begins [rad].
        masses: float64[N], factors of the densities.
        words: what the outcomes come from.
    """

    def __init__(
        self, world: World, joints: np.ndarray, masses: np.ndarray, words: str
    ) -> None:  # fmt: skip
        self.world, self.job, self.words = world, world.job, words
        count = len(world.pieces)
        self.body = list(range(count))
        """The physical block that each piece is; others where one was lost."""
        self.like: list[int] = []
        """Of every block beyond those of the plan, the piece it is like."""
        self.cells = [tuple(c) for c in world.cells()]
        self.fixed = [sum(map(len, self.cells)) + n for n in range(len(self.job.obstacles))]
        self.masses = masses
        self.begin(joints, 0.0)

    def begin(self, joints: np.ndarray, width: float) -> None:
        """Before the first attempt; the pads are ``width`` apart [m]."""
        objects = [*self.cells, *([cell] for cell in self.fixed)]
        self.recorder = BuildRecorder(
            self.job.arm, joints, width, self.poses(), objects, self.words, *self.boxes()
        )

    def boxes(self) -> tuple[np.ndarray, np.ndarray]:
        """Half extents float64[C, 3] [m] and densities float64[C] [kg/m3] of all cells of the
        record."""
        count = sum(map(len, self.cells)) + len(self.fixed)
        halves, densities = np.empty((count, 3)), np.empty(count)
        for k, piece in enumerate(self.world.pieces):
            cells = list(self.cells[self.body[k]])
            halves[cells] = [half for _, half in piece.shape]
            densities[cells] = piece.density * self.masses[k]
        for cell, obstacle in zip(self.fixed, self.job.obstacles, strict=True):
            halves[cell], densities[cell] = np.array(obstacle.size) / 2, OBSTACLE_DENSITY
        return halves, densities

    def numbers(self, rows: Rows) -> np.ndarray:
        """int64[n]: cell of the record of each row."""
        return np.array([
            self.fixed[part] if owner < 0 else self.cells[self.body[owner]][part]
            for owner, part in zip(rows.owner, rows.part, strict=True)
        ])  # fmt: skip

    def replace(self, k: int) -> int:
        """Another block takes the place of a piece; the number of this one from now on."""
        spare = self.world.add(k)
        self.like.append(k)
        first = len(self.recorder.poses)
        self.cells.append(tuple(range(first, first + len(self.world.pieces[k].shape))))
        self.body.append(self.body[k])
        self.body[k] = len(self.cells) - 1
        self.masses = np.append(self.masses, self.masses[k])
        return spare

    def grow(self, k: int) -> None:
        """The record has the cells of the block that took the place of a piece."""
        self.recorder.half, self.recorder.density = self.boxes()
        self.recorder.objects = (*self.recorder.objects, self.cells[-1])
        self.recorder.poses = np.vstack([self.recorder.poses, self.cell_rows(k)])
        self.sync()

    def state(self) -> dict[str, Any]:
        """What a file says of it, besides the steps."""
        return {
            "body": self.body, "like": self.like, "cells": [list(c) for c in self.cells],
            "masses": self.masses.tolist(),
        }  # fmt: skip

    def restore(self, state: dict[str, Any], steps: list[dict[str, Any]]) -> None:
        """As a file says it was; the world has its blocks already."""
        for step in steps:
            self.recorder.take(unpacked_step(step))
        self.body, self.like = state["body"], state["like"]
        self.cells = [tuple(c) for c in state["cells"]]
        self.masses = np.array(state["masses"])
        self.recorder.half, self.recorder.density = self.boxes()
        self.recorder.objects = (*self.cells, *((cell,) for cell in self.fixed))
        self.recorder.poses = self.poses()

    def cell_rows(self, k: int) -> np.ndarray:
        """float64[m, 7]: poses of the boxes of a piece."""
        pose, turn = self.world.pose[k], quaternion_matrix(self.world.pose[k, 3:])
        return np.array([
            [*(pose[:3] + turn @ np.array(c)), *pose[3:]] for c, _ in self.world.pieces[k].shape
        ])  # fmt: skip

    def poses(self) -> np.ndarray:
        """float64[C, 7] of all cells of the record."""
        count = sum(map(len, self.cells)) + len(self.fixed)
        poses = np.zeros((count, 7))
        for k, body in enumerate(self.body):
            poses[list(self.cells[body])] = self.cell_rows(k)
        for cell, obstacle in zip(self.fixed, self.job.obstacles, strict=True):
            turn = yaw_quaternion(obstacle.yaw)
            poses[cell] = [*obstacle.middle, *turn]
        return poses

    def sync(self) -> None:
        poses = self.poses()
        self.recorder.poses = poses
        if self.recorder.steps:
            self.recorder.steps[-1] = dataclasses.replace(self.recorder.steps[-1], after=poses)

    def record(self) -> BuildRecord:
        """What the arm did."""
        found, first = self.recorder.record(), self.recorder.poses
        count = len(first)

        def whole(poses: np.ndarray) -> np.ndarray:
            # Replacements wait in their magazines until they are needed.
            return np.vstack([poses, self._hidden()[len(poses) :]]) if len(poses) < count else poses

        steps: list[StepRecord] = []
        for step in found.steps:
            before = steps[-1].after if steps else whole(step.before)
            steps.append(dataclasses.replace(step, before=before, after=whole(step.after)))
        return dataclasses.replace(found, steps=tuple(steps))

    def _hidden(self) -> np.ndarray:
        """float64[C, 7]: all cells in their magazines."""
        poses = self.poses()
        poses[:, 2] = -HIDDEN - 0.1
        return poses
