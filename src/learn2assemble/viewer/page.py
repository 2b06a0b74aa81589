"""The report of a build as one stand-alone HTML file, with the arm where one built it."""

from __future__ import annotations

from html import escape
from pathlib import Path
from typing import Any

from learn2assemble.files import write_file
from learn2assemble.planning.plan import Plan
from learn2assemble.viewer.arm import (
    LEGEND,
    NEAR_VIEW,
    READING,
    Labels,
    arm_data,
    arm_section,
    arm_values,
    outcome_list,
)
from learn2assemble.viewer.html import fact_list, fill, speed_options, stand_alone
from learn2assemble.viewer.playback import Playback
from learn2assemble.viewer.scene import Scene, chart_svg, elevation_svg, kind, read_scene
from learn2assemble.viewer.words import (
    arm_summary,
    block_names,
    block_numbers,
    caption,
    percent,
    placement,
    search_needed,
    shares,
    summary,
)

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
    labels = cell_labels(plan, scene, playback)
    chart = chart_svg(plan)
    sections = {
        "elevations": _elevations(scene),
        "sides": str(len(scene.elevations)),
        "chart": chart,
        "counted": "" if shares(plan)[0] else ", counted from the first block",
        "plane_note": _PLANE_NOTE if 'class="plane"' in chart else "",
        "steps": _steps(plan),
        "attempts": _attempts(plan),
        "arm_section": arm_section(playback, labels.names) if playback else "",
        "reading": READING + f"<dd>{outcome_list()}.</dd>" if playback else "",
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
        "view_note": _TRAY_NOTE if scene.rearranged and playback is None else "",
        "sections": fill("plan.html", sections),
        "source": f"Design file: {escape(plan.design.source)}.",
        **(
            {}
            if playback is None
            else {
                **arm_values(playback),
                "body": "movable with-arm",
                "views": NEAR_VIEW,
                "legend": _LEGEND + LEGEND,
            }
        ),
    }
    scripts = (*_SCRIPTS, *["arm.js"] * (playback is not None), "timeline.js")
    return stand_alone(values, _data(plan, scene, playback, labels), scripts)


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


def cell_labels(plan: Plan, scene: Scene, playback: Playback | None) -> Labels:
    """Of the cells of a record, which are the blocks of the plan."""
    kinds = {block.number: kind(block) for block in scene.blocks}
    numbers, names = block_numbers(plan), block_names(plan)
    count = 0 if playback is None else playback.record.num_cells
    return Labels(
        tuple(numbers.get(cell) for cell in range(count)),
        tuple(names.get(cell, "a waiting block") for cell in range(count)),
        tuple(kinds.get(numbers.get(cell, -1), "wall") for cell in range(count)),
        tuple(numbers.get(cell) == 0 for cell in range(count)),
        tuple(caption(plan, number) for number in range(scene.num_steps + 1)),
    )


def _data(plan: Plan, scene: Scene, playback: Playback | None, labels: Labels) -> dict[str, Any]:
    """What the scripts need: lengths in metres, world frame, quaternions (w, x, y, z)."""
    kinds = {block.number: kind(block) for block in scene.blocks}
    return {
        **({} if playback is None else {"arm": arm_data(playback, labels)}),
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
        "captions": labels.captions,
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
