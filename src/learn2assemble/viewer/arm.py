"""What pages with arms have in common: their motion as data for the scripts, and attempts."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import Any, NamedTuple

import numpy as np

from learn2assemble.geometry.rotations import matrix_quaternion
from learn2assemble.kinematics.shape import LinkPart
from learn2assemble.motion.record import StepRecord
from learn2assemble.robot.arm import Arm
from learn2assemble.robot.moves import Outcome
from learn2assemble.viewer.errors import truth_data
from learn2assemble.viewer.html import NUMBER, packed, row, speed_options, to_base64
from learn2assemble.viewer.playback import Playback, PlayedArm, ReplaySegment, split, standing
from learn2assemble.viewer.words import (
    OUTCOME_WORDS,
    arm_summary,
    clock_words,
    sentence,
    stage_words,
)

_SPEEDS = (1, 2, 4, 8, 16)
_SPEED = 4


_BARS = (
    "The bar above the slider shows",
    "The bars above the slider, one of each arm, show",
)
"""Of one arm, of several."""


REACH_WORDS = "where the upright tool reaches, 50 mm above the table"
NEAR_VIEW = '<button type="button" id="near-view">Near view</button>'


class StandingArm(NamedTuple):
    """An arm that stands at home, and what it reaches."""

    arm: Arm
    area: Sequence[np.ndarray]
    """Outlines of what it reaches on the table, float64[n, 2] each, none, one, or the outer and the
    inner one [m, world]."""

    @property
    def base(self) -> np.ndarray:
        """float64[2] [m, world]."""
        return self.arm.base_position[:2]


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

    def of_step(self, step: StepRecord, arm: str = "") -> str:
        """What a step of the record comes to, in one or two sentences.

        Args:
            arm: whose it is, where there are several.
        """
        if step.outcome == Outcome.REACHED and step.plan_step is not None:
            return self.captions[step.plan_step] + (f" Done by {arm}." if arm else "")
        block = object_name(step, self.names)
        words = sentence(f"{step.outcome.label}: {block}"), sentence(step.detail, self.names)
        text = " ".join(filter(None, words))
        if step.replanned:
            text += " The rest of the build is planned anew from where the blocks are now."
        return text


def object_name(step: StepRecord, names: Sequence[str]) -> str:
    """What an attempt brings: a block, or several as one, that which is held first.

    Args:
        names: of the blocks by cell.
    """
    return " and ".join(dict.fromkeys(names[cell] for cell in step.cells))


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
        f"{_BARS[len(playback.arms) > 1]} every attempt; red ones failed.",
    }


def arm_section(playback: Playback, names: Sequence[str]) -> str:
    """The table of attempts with its heading; names of the blocks by cell."""
    record = playback.record
    several = len(playback.arms) > 1
    rows = "".join(
        _attempt(
            k,
            segment,
            object_name(segment.step, names),
            several and playback.arms[segment.arm].name,
        )
        for k, segment in enumerate(playback.segments, 1)
    )
    return (
        '<section class="attempts" aria-labelledby="arm-title"><h2 id="arm-title">What the '
        f'{"arms" if several else "arm"} did</h2><p class="lead">{escape(arms_words(playback))}, '
        f"{escape(arm_summary(record))}, simulated by {escape(record.simulated_by)}.</p>"
        f'<div class="scroll"><table><thead><tr><th>Attempt</th>{"<th>Arm</th>" * several}'
        "<th>Object</th><th>Outcome</th>"
        '<th>Why</th><th class="number">Off by</th><th class="number">Time</th></tr></thead>'
        f"<tbody>{rows}</tbody></table></div></section>\n  "
    )


def arms_words(playback: Playback) -> str:
    """Who builds."""
    names = " and ".join(arm.name for arm in playback.arms)
    return f"Arms {names}" if len(playback.arms) > 1 else f"Arm {names}"


def _attempt(number: int, segment: ReplaySegment, name: str, arm: str | bool) -> str:
    """What became of a step: how far the cell stands from where it should, and how long it took.

    Args:
        arm: whose it is, where that is told.
    """
    step = segment.step
    seconds = step.seconds if not arm else segment.end - segment.start
    good = step.outcome == Outcome.REACHED
    again = ' <span class="tag">planned anew</span>' if step.replanned else ""
    outcome = f'class="{"yes" if good else "no"}" title="{escape(OUTCOME_WORDS[step.outcome])}"'
    cells = [
        str(number),
        *([escape(str(arm))] if arm else []),
        escape(name),
        step.outcome.label,
        escape(sentence(step.detail)) + again,
        f"{1000 * step.error:.1f} mm" if good else "–",
        f"{seconds:.1f} s",
    ]
    of_cells = {k + bool(arm): what for k, what in ((2, outcome), (4, NUMBER), (5, NUMBER))}
    return row(cells, of_cells, f'data-segment="{number - 1}"', f"Show attempt {number}")


def ribbon(playback: Playback) -> str:
    """All steps side by side as long as they take, one lane an arm; a click shows one."""
    parts, lanes = list[str](), len(playback.arms)
    high = 10 if lanes == 1 else 8
    for k, segment in enumerate(playback.segments):
        step = segment.step
        width = 1000 * (segment.end - segment.start) / playback.duration
        left = 1000 * segment.start / playback.duration
        state = "reached" if step.outcome == Outcome.REACHED else "failed"
        parts.append(
            f'<rect class="{state}" data-segment="{k}" x="{left:.2f}" y="{10 * segment.arm}" '
            f'width="{max(width - 1.2, 0.5):.2f}" height="{high}"><title>Attempt {k + 1}: '
            f"{f'{escape(playback.arms[segment.arm].name)}, ' * (lanes > 1)}"
            f"{step.outcome.label}, {clock_words(segment.start)} to "
            f"{clock_words(segment.end)}</title></rect>"
        )
    return (
        f'<svg class="ribbon{" lanes" * (lanes > 1)}" viewBox="0 0 1000 {10 * lanes}" '
        'preserveAspectRatio="none" role="img" '
        f'aria-label="{len(playback.segments)} attempts on the timeline">{"".join(parts)}</svg>'
    )


def arm_data(playback: Playback, labels: Labels) -> dict[str, Any]:
    """What the scripts need to move arms: metres, seconds, radians, quaternions (w, x, y, z)."""
    record = playback.record
    return {
        "rate": record.rate,
        "duration": _short(playback.duration),
        "robots": [_robot(arm) for arm in playback.arms],
        "cells": [
            {
                "kind": colour,
                "fixed": fixed,
                "half": size,
                "corners": None if hull is None else hull.triangles().ravel(),
                "position": position,
                "quaternion": quaternion,
            }
            for colour, fixed, size, hull, position, quaternion in zip(
                labels.colours,
                labels.fixed,
                playback.half,
                record.hull or [None] * record.num_cells,
                *split(record.steps[0].before),
                strict=True,
            )
        ],
        "segments": [
            _segment(playback, number, labels) for number in range(len(playback.segments))
        ],
        "start": labels.captions[0],
        "truth": truth_data(playback),
        "extent": extent(playback.arms, playback.record.steps),
    }


def standing_data(arms: Sequence[StandingArm]) -> dict[str, Any]:
    """The same of arms that stand at home, with where they reach."""
    return {
        "robots": [_robot(standing(one.arm)) for one in arms],
        "areas": [[line.round(4) for line in one.area] for one in arms if one.area],
        "extent": extent([standing(one.arm) for one in arms]),
    }


def _robot(arm: PlayedArm) -> dict[str, Any]:
    """An arm: its joints, what is drawn of it, and its motion."""
    chain, samples = arm.shape.chain, arm.samples
    return {
        "name": arm.name,
        "joints": [
            {"offset": offset, "turn": matrix_quaternion(turn)}
            for offset, turn in zip(chain.offset, chain.turn, strict=True)
        ],
        "tool": {"offset": chain.tool_offset, "turn": matrix_quaternion(chain.tool_turn)},
        "fingers": [
            {"offset": f.offset, "turn": matrix_quaternion(f.turn), "travel": f.travel}
            for f in arm.shape.fingers
        ],
        "parts": [_part(part) for part in arm.shape.parts],
        "samples": packed(np.column_stack([samples.joints, samples.width]), np.uint16),
    }


def _segment(playback: Playback, number: int, labels: Labels) -> dict[str, Any]:
    segment = playback.segments[number]
    step, delay = segment.step, segment.delay
    block, arm = object_name(step, labels.names), playback.arms[segment.arm]
    last = playback.segments[number - 1].step.after if number else step.before
    appeared = np.flatnonzero(np.abs(step.before - last).max(1) > 1e-9).tolist()
    return {
        "robot": segment.arm,
        "start": _short(segment.start),
        "end": _short(segment.end),
        "delay": _short(delay),
        "moves": bool(len(step.samples.time)),
        "step": step.plan_step,
        "cells": list(step.cells),
        "target": step.target,
        "reached": step.outcome == Outcome.REACHED,
        "outcome": step.outcome.label,
        "caption": labels.of_step(step, arm.name if len(playback.arms) > 1 else ""),
        "still": f"cannot move: {step.outcome.label}",
        "stages": [
            [
                _short(s.start + delay),
                _short(s.end + delay),
                stage_words(step, s, block, arm.suction),
            ]
            for s in step.stages
        ],
        "before": {str(cell): split(step.before[cell]) for cell in appeared},
        "glides": [
            {
                name: _short(value) if isinstance(value, float) else value
                for name, value in glide._asdict().items()
            }
            for glide in segment.glides
        ],
        "after": {str(glide.cell): split(step.after[glide.cell]) for glide in segment.glides},
    }


def extent(arms: Sequence[PlayedArm], steps: Sequence[StepRecord] = ()) -> np.ndarray:
    """float64[m, 3]: outermost points of what joints and tools of arms reach, and of what stands or
    waits before some steps [m, world]."""
    points: list[np.ndarray] = [at[at[:, 2] > 0, :3] for at in (one.before for one in steps)]
    points = [point for some in points for point in some]
    for arm in arms:
        points.append(arm.shape.chain.offset[0] * [1, 1, 0])
        joints = arm.samples.joints
        for q in joints[:: max(1, len(joints) // 200)]:
            points += [*arm.shape.frames(q, 0.0)[0], arm.shape.tool(q)[0]]
    reached = np.array(points)
    around = [v for v in np.ndindex(3, 3, 3) if v != (1, 1, 1)]
    return reached[np.unique((reached @ (np.array(around).T - 1.0)).argmax(0))]


def _part(part: LinkPart) -> dict[str, Any]:
    wide = len(part.mesh.vertices) >= 65536
    return {
        "frame": part.frame,
        "colour": list(part.colour),
        "vertices": packed(part.mesh.vertices, np.uint16),
        "normals": packed(part.mesh.normals, np.uint8, (-1.0, 1.0)),
        "faces": to_base64(part.mesh.faces.astype(np.uint32 if wide else np.uint16)),
        "wide": wide,
    }


def _short(value: float) -> float:
    return round(float(value), 4) + 0.0
