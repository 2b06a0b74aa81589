"""What a page says about an arm: timeline, outcomes of the steps, how to read them."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from typing import Any

from learn2assemble.robot.outcome import Outcome
from learn2assemble.robot.record import StepRecord
from learn2assemble.viewer.arm_words import (
    OUTCOME_WORDS,
    arm_summary,
    block_names,
    clock_words,
    sentence,
)
from learn2assemble.viewer.playback import Playback

_SPEEDS = (1, 2, 4, 8, 16)
_SPEED = 4


def arm_values(plan: Mapping[str, Any], playback: Playback) -> dict[str, str]:
    """What stands in the places of the page that only a page with an arm fills."""
    end = f"{playback.duration:.2f}"
    return {
        "body": "movable with-arm",
        "near_view": '<button type="button" id="near-view">Near view</button>',
        "ribbon": ribbon(playback),
        "slider_last": end,
        "slider_step": "any",
        "slider_name": "Time",
        "count": f"{clock_words(playback.duration)} / {clock_words(playback.duration)}",
        "speeds": "".join(
            f'<option value="{value}"{" selected" if value == _SPEED else ""}>{value}×</option>'
            for value in _SPEEDS
        ),
        "doing": (
            '<p class="doing" id="doing"><span id="doing-words">The build is over.</span>'
            '<span class="chip good" id="outcome">end</span></p>'
        ),
        "legend": (
            '<li><i class="waiting"></i>waiting block</li>'
            '<li><i class="goal"></i>where this step puts it</li>'
        ),
        "keys_note": " At speed 1× the clock is the arm's own. "
        "The bar above the slider shows every attempt; red ones failed.",
        "arm_section": _section(plan, playback),
        "reading": _READING + f"<dd>{outcome_list()}.</dd>",
    }


_READING = (
    "<dt>The arm</dt><dd>Its joints follow the trajectory that stands in trajectory.json and "
    "trajectory.csv beside this page. Waiting blocks stand where the arm takes them from.</dd>"
    "<dt>Attempt</dt><dd>One try to pick up a block and put it down. After a failure the rest of "
    "the build is planned anew from where the blocks really are.</dd>"
    "<dt>Off by</dt><dd>Distance of the block from where it should stand, after the attempt.</dd>"
    "<dt>Outcome</dt>"
)


def _section(plan: Mapping[str, Any], playback: Playback) -> str:
    record = playback.record
    return (
        '<section class="attempts" aria-labelledby="arm-title"><h2 id="arm-title">What the arm '
        f'did</h2><p class="lead">Arm {escape(record.arm.name)}, {escape(arm_summary(record))}, '
        f"simulated by {escape(record.simulated_by)}.</p>"
        '<div class="scroll"><table><thead><tr><th>Attempt</th><th>Object</th><th>Outcome</th>'
        '<th>Why</th><th class="number">Off by</th><th class="number">Time</th></tr></thead>'
        f"<tbody>{arm_rows(plan, playback)}</tbody></table></div></section>\n  "
    )


def arm_rows(plan: Mapping[str, Any], playback: Playback) -> str:
    """The table of what became of every step."""
    rows = []
    for k, segment in enumerate(playback.segments):
        step = segment.step
        good = step.outcome == Outcome.REACHED
        name = block_names(plan).get(step.cells[0], "a waiting block")
        again = ' <span class="tag">planned anew</span>' if step.replanned else ""
        rows.append(
            f'<tr data-segment="{k}"><td><button type="button" data-segment="{k}" '
            f'aria-label="Show attempt {k + 1}">{k + 1}</button></td>'
            f"<td>{escape(name)}</td>"
            f'<td class="{"yes" if good else "no"}">{step.outcome.label}</td>'
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


def outcome_list() -> str:
    """Every outcome with its meaning."""
    return "; ".join(f"<b>{o.label}</b>: {escape(words)}" for o, words in OUTCOME_WORDS.items())
