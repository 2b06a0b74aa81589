"""What pages with an arm have in common: its motion as data for the scripts, and its attempts."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import Any, NamedTuple

import numpy as np

from learn2assemble.geometry.rotations import matrix_quaternion
from learn2assemble.robot.motion.record import StepRecord
from learn2assemble.robot.moves import Outcome
from learn2assemble.robot.shape import Part
from learn2assemble.viewer.html import packed, speed_options, to_base64
from learn2assemble.viewer.playback import Glide, Playback, split
from learn2assemble.viewer.words import (
    OUTCOME_WORDS,
    arm_summary,
    clock_words,
    sentence,
    stage_words,
)

_SPEEDS = (1, 2, 4, 8, 16)
_SPEED = 4


NEAR_VIEW = '<button type="button" id="near-view">Near view</button>'
LEGEND = (
    '<li><i class="waiting"></i>waiting block</li>'
    '<li><i class="goal"></i>where this step puts it</li>'
)


class Labels(NamedTuple):
    """What a page calls the cells of a record and the steps of its plan."""

    names: tuple[str, ...]
    """Of the blocks the cells belong to."""
    colours: tuple[str, ...]
    """Of the cells once they are placed: ``#rrggbb`` or a name of the style sheet."""
    fixed: tuple[bool, ...]
    """Cells that have this colour from the start: what stands there, obstacles."""
    captions: tuple[str, ...]
    """Of the start and of every step."""

    def of_step(self, step: StepRecord) -> str:
        """What a step of the record comes to, in one or two sentences."""
        if step.outcome == Outcome.REACHED and step.plan_step is not None:
            return self.captions[step.plan_step]
        block = self.names[step.cells[0]]
        text = f"{block[0].upper()}{block[1:]}: {step.outcome.label}. {sentence(step.detail)}"
        if step.replanned:
            text += " The rest of the build is planned anew from where the blocks are now."
        return text


def arm_values(playback: Playback) -> dict[str, str]:
    """What a page with an arm says in places of its own, or otherwise than one without."""
    end = f"{playback.duration:.2f}"
    return {
        "ribbon": ribbon(playback),
        "slider_last": end,
        "slider_step": "any",
        "slider_name": "Time",
        "count": f"{clock_words(playback.duration)} / {clock_words(playback.duration)}",
        "speeds": speed_options(_SPEEDS, _SPEED),
        "doing": (
            '<p class="doing" id="doing"><span id="doing-words">The build is over.</span>'
            '<span class="chip good" id="outcome">end</span></p>'
        ),
        "keys_note": " At speed 1× the clock is the arm's own. "
        "The bar above the slider shows every attempt; red ones failed.",
    }


def arm_section(playback: Playback, names: Sequence[str]) -> str:
    """The table of attempts with its heading; names of the blocks by cell."""
    record = playback.record
    return (
        '<section class="attempts" aria-labelledby="arm-title"><h2 id="arm-title">What the arm '
        f'did</h2><p class="lead">Arm {escape(record.arm.name)}, {escape(arm_summary(record))}, '
        f"simulated by {escape(record.simulated_by)}.</p>"
        '<div class="scroll"><table><thead><tr><th>Attempt</th><th>Object</th><th>Outcome</th>'
        '<th>Why</th><th class="number">Off by</th><th class="number">Time</th></tr></thead>'
        f"<tbody>{_rows(playback, names)}</tbody></table></div></section>\n  "
    )


def _rows(playback: Playback, names: Sequence[str]) -> str:
    """What became of every step."""
    rows = []
    for k, segment in enumerate(playback.segments):
        step = segment.step
        good = step.outcome == Outcome.REACHED
        name = names[step.cells[0]]
        again = ' <span class="tag">planned anew</span>' if step.replanned else ""
        rows.append(
            f'<tr data-segment="{k}"><td><button type="button" data-segment="{k}" '
            f'aria-label="Show attempt {k + 1}">{k + 1}</button></td>'
            f"<td>{escape(name)}</td>"
            f'<td class="{"yes" if good else "no"}" title="{escape(OUTCOME_WORDS[step.outcome])}">'
            f"{step.outcome.label}</td>"
            f"<td>{escape(sentence(step.detail))}{again}</td>"
            f'<td class="number">{_error(step) if good else "–"}</td>'
            f'<td class="number">{step.seconds:.1f} s</td></tr>'
        )  # fmt: skip
    return "".join(rows)


def _error(step: StepRecord) -> str:
    """How far the grasped cell stands from where it should [mm]."""
    return f"{1000 * step.error:.1f} mm"


def ribbon(playback: Playback) -> str:
    """All steps side by side as long as they take; a click shows one."""
    parts = []
    for k, segment in enumerate(playback.segments):
        step = segment.step
        width = 1000 * (segment.end - segment.start) / playback.duration
        left = 1000 * segment.start / playback.duration
        state = "reached" if step.outcome == Outcome.REACHED else "failed"
        parts.append(
            f'<rect class="{state}" data-segment="{k}" x="{left:.2f}" y="0" '
            f'width="{max(width - 1.2, 0.5):.2f}" height="10"><title>Attempt {k + 1}: '
            f"{step.outcome.label}, {clock_words(segment.start)} to "
            f"{clock_words(segment.end)}</title></rect>"
        )
    return (
        '<svg class="ribbon" viewBox="0 0 1000 10" preserveAspectRatio="none" role="img" '
        f'aria-label="{len(playback.segments)} attempts on the timeline">{"".join(parts)}</svg>'
    )


def arm_data(playback: Playback, labels: Labels) -> dict[str, Any]:
    """What the scripts need to move the arm: metres, seconds, radians, quaternions (w, x, y, z)."""
    record, shape = playback.record, playback.shape
    chain, samples = shape.chain, playback.samples
    first = record.steps[0].before
    tool_turn = matrix_quaternion(chain.tool_turn)
    return {
        "rate": record.rate,
        "duration": _short(playback.duration),
        "joints": [
            {"offset": _list(offset), "turn": _list(matrix_quaternion(turn))}
            for offset, turn in zip(chain.offset, chain.turn, strict=True)
        ],
        "tool": {"offset": _list(chain.tool_offset), "turn": _list(tool_turn)},
        "fingers": [
            {"offset": _list(f.offset), "turn": _list(matrix_quaternion(f.turn)),
             "travel": _list(f.travel)}
            for f in shape.fingers
        ],
        "parts": [_part(part) for part in shape.parts],
        "samples": packed(np.column_stack([samples.joints, samples.width]), np.uint16),
        "cells": [
            {"kind": colour, "fixed": fixed, "half": _list(size),
             "position": position, "quaternion": quaternion}
            for colour, fixed, size, position, quaternion in zip(
                labels.colours, labels.fixed, playback.half,
                *map(_list, split(first)), strict=True,
            )
        ],
        "segments": [
            _segment(playback, number, labels) for number in range(len(playback.segments))
        ],
        "start": labels.captions[0],
        "extent": _list(extent(playback)),
        "turn": _short(playback.side),
    }  # fmt: skip


def _segment(playback: Playback, number: int, labels: Labels) -> dict[str, Any]:
    segment = playback.segments[number]
    step, delay = segment.step, segment.delay
    block, suction = labels.names[step.cells[0]], playback.record.arm.suction
    last = playback.segments[number - 1].step.after if number else step.before
    appeared = np.flatnonzero(np.abs(step.before - last).max(1) > 1e-9).tolist()
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
        "caption": labels.of_step(step),
        "still": f"cannot move: {step.outcome.label}",
        "stages": [
            [_short(s.start + delay), _short(s.end + delay), stage_words(step, s, block, suction)]
            for s in step.stages
        ],
        "before": {str(cell): [_list(v) for v in split(step.before[cell])] for cell in appeared},
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
    wide = len(part.mesh.vertices) >= 65536
    return {
        "frame": part.frame,
        "colour": list(part.colour),
        "vertices": packed(part.mesh.vertices, np.uint16),
        "normals": packed(part.mesh.normals, np.uint8, (-1.0, 1.0)),
        "faces": to_base64(part.mesh.faces.astype(np.uint32 if wide else np.uint16)),
        "wide": wide,
    }


def _list(values: np.ndarray) -> list[Any]:
    return (np.round(values, 6) + 0.0).tolist()


def _short(value: float) -> float:
    return round(float(value), 4) + 0.0


def _time(value: float | None) -> float | None:
    return None if value is None else _short(value)
