"""What the script of a page needs to move an arm: meshes, chain, samples and steps as data."""

from __future__ import annotations

import base64
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from learn2assemble.robot.outcome import Outcome
from learn2assemble.robot.scene import fillers
from learn2assemble.robot.shape import Part
from learn2assemble.viewer.arm_words import arm_caption, block_names, stage_words
from learn2assemble.viewer.playback import Glide, Playback, Segment, split
from learn2assemble.viewer.turns import quaternion_of, rotation_of
from learn2assemble.viewer.words import caption


def arm_data(plan: Mapping[str, Any], playback: Playback, kinds: Mapping[int, str]) -> dict:
    """What the scripts need to move the arm: metres, seconds, radians, quaternions (w, x, y, z).

    Args:
        kinds: colour of every block by its number.
    """
    record, shape = playback.record, playback.shape
    chain, samples = shape.chain, playback.samples
    numbers = {int(step["block"]): number for number, step in enumerate(plan["steps"], 1)}
    if plan.get("first_block"):
        numbers[int(plan["first_block"]["block"])] = 0
    first = record.steps[0].before
    tool_turn = quaternion_of(chain.tool_turn)
    return {
        "rate": record.rate,
        "duration": _short(playback.duration),
        "joints": [
            {"offset": _list(offset), "turn": _list(quaternion_of(turn))}
            for offset, turn in zip(chain.offset, chain.turn, strict=True)
        ],
        "tool": {"offset": _list(chain.tool_offset), "turn": _list(tool_turn)},
        "fingers": [
            {"offset": _list(f.offset), "turn": _list(quaternion_of(f.turn)),
             "travel": _list(f.travel)}
            for f in shape.fingers
        ],
        "parts": [_part(part) for part in shape.parts],
        "samples": _packed(np.column_stack([samples.joints, samples.width]), np.uint16),
        "cells": [
            {"number": numbers.get(cell), "kind": kinds.get(numbers.get(cell, -1), "wall"),
             "position": position, "quaternion": quaternion}
            for cell, (position, quaternion) in enumerate(
                zip(*map(_list, split(first)), strict=True)
            )
        ],
        "fillers": _fillers(playback, first),
        "segments": [_segment(plan, s) for s in playback.segments],
        "start": caption(plan, 0),
        "extent": _list(extent(playback)),
    }  # fmt: skip


def _segment(plan: Mapping[str, Any], segment: Segment) -> dict[str, Any]:
    step, delay = segment.step, segment.delay
    block = block_names(plan).get(step.cells[0], "a waiting block")
    return {
        "start": _short(segment.start),
        "end": _short(segment.end),
        "delay": _short(delay),
        "moves": bool(len(step.samples.time)),
        "step": step.plan_step,
        "cells": list(step.cells),
        "target": _list(step.target),
        "reached": step.outcome == Outcome.REACHED,
        "outcome": step.outcome.label,
        "caption": arm_caption(plan, step),
        "still": f"cannot move: {step.outcome.label}",
        "stages": [
            [_short(s.start + delay), _short(s.end + delay), stage_words(step, s, block)]
            for s in step.stages
        ],
        "glides": [_glide(glide) for glide in segment.glides],
        "after": {
            str(glide.cell): [_list(v) for v in split(step.after[glide.cell])]
            for glide in segment.glides
        },
    }


def _glide(glide: Glide) -> dict[str, Any]:
    return {
        "cell": glide.cell, "grip": _time(glide.grip), "release": _short(glide.release),
        "offset": _list(glide.offset), "turn": _list(glide.turn),
        "end": _short(glide.end),
        "position": _list(glide.position), "quaternion": _list(glide.quaternion),
        "falls": glide.falls,
    }  # fmt: skip


def _fillers(playback: Playback, first: np.ndarray) -> list[dict[str, Any]]:
    """Between neighbouring cells of one object: both cells, and the middle in the first's frame."""
    owner = np.empty(playback.record.num_cells, np.int64)
    for number, cells in enumerate(playback.record.objects):
        owner[list(cells)] = number
    found = []
    for a, b in fillers(first[:, :3], owner).tolist():
        gap = first[b, :3] - first[a, :3]
        x, y, _ = rotation_of(first[a, 3:]).T @ gap
        found.append({"cell": a, "middle": _list(np.array([x / 2, y / 2, 0.0])),
                      "yaw": _short(math.atan2(y, x)),
                      "gap": _short(math.hypot(x, y) - playback.record.block_edge)})  # fmt: skip
    return found


def extent(playback: Playback) -> np.ndarray:
    """float64[m, 3]: outermost points of what the arm's joints and tool reach [m, world]."""
    points = [playback.shape.chain.offset[0] * [1, 1, 0]]
    joints = playback.samples.joints
    for q in joints[:: max(1, len(joints) // 200)]:
        points += [*playback.shape.frames(q, 0.0)[0], playback.shape.tool(q)[0]]
    reached = np.array(points)
    around = [v for v in np.ndindex(3, 3, 3) if v != (1, 1, 1)]
    return reached[np.unique((reached @ (np.array(around).T - 1.0)).argmax(0))]


def _part(part: Part) -> dict[str, Any]:
    return {
        "frame": part.frame,
        "colour": list(part.colour),
        "vertices": _packed(part.mesh.vertices, np.uint16),
        "normals": _packed(part.mesh.normals, np.uint8, (-1.0, 1.0)),
        "faces": _text(part.mesh.faces.astype("<u2" if len(part.mesh.vertices) < 65536 else "<u4")),
        "wide": len(part.mesh.vertices) >= 65536,
    }


def _packed(
    values: np.ndarray, kind: type[np.unsignedinteger], limits: tuple[float, float] | None = None
) -> dict[str, Any]:
    """Columns as whole numbers from their smallest to their largest value, base64."""
    low, high = limits or (values.min(0), values.max(0))
    low, high = (np.broadcast_to(np.asarray(v, float), values.shape[1:]) for v in (low, high))
    levels = np.iinfo(kind).max
    scale = np.maximum(high - low, 1e-9) / levels
    whole = np.round((values - low) / scale).clip(0, levels).astype(kind)
    return {
        "low": [float(f"{v:.9g}") for v in low], "scale": [float(f"{v:.9g}") for v in scale],
        "bytes": kind(0).nbytes, "data": _text(whole.astype(whole.dtype.newbyteorder("<"))),
    }  # fmt: skip


def _text(array: np.ndarray) -> str:
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode()


def _list(values: np.ndarray) -> list[Any]:
    return (np.round(values, 6) + 0.0).tolist()


def _short(value: float) -> float:
    return round(float(value), 4) + 0.0


def _time(value: float | None) -> float | None:
    return None if value is None else _short(value)
