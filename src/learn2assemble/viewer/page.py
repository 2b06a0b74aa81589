"""The report of a build as one stand-alone HTML file, with the arm where one built it."""

from __future__ import annotations

from html import escape
from pathlib import Path
from typing import Any

from learn2assemble.files import write_file
from learn2assemble.planning.plan import Plan
from learn2assemble.robot.moves import Outcome
from learn2assemble.robot.record import StepRecord
from learn2assemble.viewer.html import fact_list, fill, speed_options, stand_alone
from learn2assemble.viewer.playback import Playback, arm_data
from learn2assemble.viewer.scene import Scene, chart_svg, elevation_svg, kind, read_scene
from learn2assemble.viewer.words import (
    OUTCOME_WORDS,
    arm_summary,
    block_names,
    caption,
    clock_words,
    percent,
    placement,
    search_needed,
    sentence,
    shares,
    summary,
)

_SPEEDS = (1, 2, 4, 8, 16)
_SPEED = 4


def arm_values(playback: Playback) -> dict[str, str]:
    """What a page with an arm says in places of its own, or otherwise than one without."""
    end = f"{playback.duration:.2f}"
    return {
        "body": "movable with-arm",
        "views": '<button type="button" id="near-view">Near view</button>',
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
        "legend": _LEGEND + '<li><i class="waiting"></i>waiting block</li>'
        '<li><i class="goal"></i>where this step puts it</li>',
        "keys_note": " At speed 1× the clock is the arm's own. "
        "The bar above the slider shows every attempt; red ones failed.",
    }


_READING = (
    "<dt>The arm</dt><dd>Its joints follow the trajectory that stands in trajectory.json and "
    "trajectory.csv beside this page. Waiting blocks stand where the arm takes them from.</dd>"
    "<dt>Attempt</dt><dd>One try to pick up a block and put it down. After a failure the rest of "
    "the build is planned anew from where the blocks really are.</dd>"
    "<dt>Off by</dt><dd>Distance of the block from where it should stand, after the attempt.</dd>"
    "<dt>Outcome</dt>"
)


def _section(plan: Plan, playback: Playback) -> str:
    record = playback.record
    return (
        '<section class="attempts" aria-labelledby="arm-title"><h2 id="arm-title">What the arm '
        f'did</h2><p class="lead">Arm {escape(record.arm.name)}, {escape(arm_summary(record))}, '
        f"simulated by {escape(record.simulated_by)}.</p>"
        '<div class="scroll"><table><thead><tr><th>Attempt</th><th>Object</th><th>Outcome</th>'
        '<th>Why</th><th class="number">Off by</th><th class="number">Time</th></tr></thead>'
        f"<tbody>{arm_rows(plan, playback)}</tbody></table></div></section>\n  "
    )


def arm_rows(plan: Plan, playback: Playback) -> str:
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


_SCRIPTS = ("three.bundle.js", "view.js", "stage.js")
_LEGEND = (
    '<li><i class="first"></i>first block</li><li><i class="wall"></i>placed block</li>'
    '<li><i class="current"></i>block of this step</li>'
    '<li><i class="support"></i>support outside the outline</li>'
    '<li><i class="target"></i>target outline</li>'
)


def write_page(plan: Plan, path: Path) -> None:
    """Write the report of a plan to ``path``, a stand-alone HTML file.

    ``#step=5`` behind its address opens it at step 5; without it the finished structure shows.

    With an arm the page shows it, and ``#t=12.5`` behind its address opens it at this second.

    Raises:
        InputError: for a record of the arm that does not fit the plan, or a path that cannot be
            written.
    """
    write_file(path, render_page(plan), "page")


def render_page(plan: Plan) -> str:
    """The HTML text of the report."""
    playback = Playback(plan.record, plan) if plan.record and plan.record.steps else None
    return _render(plan, read_scene(plan), playback)


def _render(plan: Plan, scene: Scene, playback: Playback | None) -> str:
    arm = playback is not None
    chart = chart_svg(plan)
    sections = {
        "elevations": _elevations(scene),
        "sides": str(len(scene.elevations)),
        "chart": chart,
        "counted": "" if shares(plan)[0] else ", counted from the first block",
        "plane_note": _PLANE_NOTE if 'class="plane"' in chart else "",
        "steps": _steps(plan),
        "attempts": _attempts(plan),
        "arm_section": _section(plan, playback) if arm else "",
        "reading": _READING + f"<dd>{outcome_list()}.</dd>" if arm else "",
    }
    last = str(scene.num_steps)
    values = {
        "what": "build plan",
        "title": escape(plan.design.name),
        "eyebrow": f'Build plan <span class="status {plan.status}">'
        f"{plan.status.capitalize()}</span>",
        "summary": escape(summary(plan)) + _arm_words(playback),
        "reason": _reason(plan),
        "facts": _facts(plan),
        "body": "movable" if scene.num_steps else "fixed",
        "shown": "the structure, the target outlines and the waiting blocks",
        "slider_last": last,
        "slider_step": "1",
        "slider_name": "Step",
        "count": f"{last} / {last}",
        "speeds": speed_options((0.5, 1, 2, 4), 1),
        "caption": escape(caption(plan, scene.num_steps)),
        "legend": _LEGEND,
        "view_note": _TRAY_NOTE if scene.rearranged and not arm else "",
        "sections": fill("plan.html", sections),
        "source": f"Design file: {escape(plan.design.source)}.",
        **(arm_values(playback) if playback is not None else {}),
    }
    scripts = (*_SCRIPTS, *["arm.js"] * arm, "timeline.js")
    return stand_alone(values, _data(plan, scene, playback), scripts)


def _arm_words(playback: Playback | None) -> str:
    if playback is None:
        return ""
    record = playback.record
    return escape(f" Built by the arm {record.arm.name}: {arm_summary(record)}.")


_TRAY_NOTE = (
    "Waiting blocks are drawn in a tidy tray: the plan's own waiting places overlap or hide the "
    "structure."
)
_PLANE_NOTE = " Dotted: without what stands in front of a side's face plane."


def _data(plan: Plan, scene: Scene, playback: Playback | None) -> dict[str, Any]:
    """What the scripts need: lengths in metres, world frame, quaternions (w, x, y, z)."""
    kinds = {block.number: kind(block) for block in scene.blocks}
    return {
        **({} if playback is None else {"arm": arm_data(plan, playback, kinds)}),
        "edge": scene.edge,
        "steps": scene.num_steps,
        "waiting": [
            None if row == scene.first else place
            for row, place in enumerate(scene.waiting.round(5).tolist())
        ],
        "blocks": [
            {
                "number": block.number,
                "waiting": block.waiting,
                "position": block.position.round(5).tolist(),
                "quaternion": block.quaternion.round(6).tolist(),
                "kind": kinds[block.number],
            }
            for block in scene.blocks
        ],
        "faces": [side.face(scene.edge).round(5).tolist() for side in scene.elevations],
        "captions": [caption(plan, number) for number in range(scene.num_steps + 1)],
    }


def _reason(plan: Plan) -> str:
    if not plan.reason:
        return ""
    head = "Why there is no build order" if plan.status == "refused" else "Why it ends here"
    return (
        f'<div class="reason" role="alert"><strong>{head}</strong>'
        f"<p>{escape(plan.reason)}</p></div>"
    )


def _facts(plan: Plan) -> str:
    back = plan.search.backtracks if plan.search else 0
    facts: list[tuple[str, str, str]] = [
        (
            "Coverage",
            percent(plan.coverage),
            f"{percent(plan.design.success_threshold)} needed",
        ),
        ("Blocks", str(plan.blocks.used), f"of {plan.blocks.available} available"),
        (
            "Search",
            search_needed(plan),
            f"{back} step{'' if back == 1 else 's'} taken back",
        ),
        (
            "Verified by" if plan.complete else "Checked by",
            (plan.verified_by if plan.steps else None) or "not checked",
            "",
        ),
        ("Agent", plan.agent or "none", f"planned in {_seconds(plan.seconds)}"),
    ]
    return fact_list(facts)


def _seconds(seconds: float) -> str:
    return "less than 0.1 s" if seconds < 0.1 else f"{seconds:.1f} s"


def _elevations(scene: Scene) -> str:
    return "".join(
        f"<figure>{elevation_svg(scene, side)}<figcaption><b>Side {side + 1}</b> "
        f"{escape(elevation.name)}</figcaption></figure>"
        for side, elevation in enumerate(scene.elevations)
    )


def _steps(plan: Plan) -> str:
    rows = []
    for number, step in enumerate(plan.steps, 1):
        margin, stable = step.margin_g, step.stable
        support = ' <span class="tag">support</span>' if step.outside else ""
        rows.append(
            f'<tr data-step="{number}"><td><button type="button" data-step="{number}" '
            f'aria-label="Show step {number}">{number}</button></td>'
            f"<td>{escape(placement(step))}{support}</td>"
            f'<td class="number">{step.block}</td>'
            f'<td class="number">{escape(percent(step.coverage))}</td>'
            f'<td class="number">{"–" if margin is None else f"{margin:.2f}"}</td>'
            f'<td class="{"yes" if stable else "no"}">{"yes" if stable else "no"}</td></tr>'
        )
    return "".join(rows) or '<tr><td colspan="6">This plan has no steps.</td></tr>'


def _attempts(plan: Plan) -> str:
    rows = "".join(
        f"<tr><td>{escape(item.stage)}</td><td>{escape(item.result)}</td>"
        f'<td class="number">{item.seconds:.2f} s</td></tr>'
        for item in (plan.search.attempts if plan.search else ())
    )
    return rows or '<tr><td colspan="3">Nothing was tried.</td></tr>'
