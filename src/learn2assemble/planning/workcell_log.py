"""What a build has done, appended to a file after every attempt, so that it can go on from there.

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
from learn2assemble.robot.moves import Outcome
from learn2assemble.robot.record import Samples, Stage, StepRecord

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
