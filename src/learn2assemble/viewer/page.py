"""The page of a plan or an assembly: blocks of any shape step by step and layer by layer.

It shows their joints, the target of a task, the cells to blame where a design is not built, and the
arm where one built it.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from learn2assemble.assembly.blocks import Assembly
from learn2assemble.assembly.contacts import Contacts
from learn2assemble.assembly.instructions.appearance import has_leaning_face
from learn2assemble.assembly.instructions.steps import Instructions, instructions
from learn2assemble.assembly.instructions.words import count_words, length_words, reading_words
from learn2assemble.constants import GRAVITY
from learn2assemble.errors import InputError, as_both, listed
from learn2assemble.files import write_file
from learn2assemble.motion.attempts import anything_to_play
from learn2assemble.planning.plan import LARGEST, Plan
from learn2assemble.viewer import scene, tables
from learn2assemble.viewer.arm import (
    NEAR_VIEW,
    REACH_WORDS,
    StandingArm,
    arm_data,
    arm_section,
    arm_values,
    arms_words,
    standing_data,
)
from learn2assemble.viewer.errors import error_section
from learn2assemble.viewer.html import fact_list, prose, speed_options, stand_alone
from learn2assemble.viewer.places import place_section
from learn2assemble.viewer.playback import Playback
from learn2assemble.viewer.scene import SEEN_FROM_BEHIND, Mark, ScenePart, cell_labels
from learn2assemble.viewer.tables import StepNote
from learn2assemble.viewer.words import (
    BLAME_WORDS,
    arm_summary,
    friction_words,
    newtons,
    percent,
    placement,
    proof_words,
    sentence,
    weakest_words,
)

if TYPE_CHECKING:
    from learn2assemble.planning.plan import PlanTarget, Step

TONES = {
    "complete": "good",
    "stands": "good",
    "within reach": "good",
    "incomplete": "warn",
    "stands only with tight joints": "warn",
    "not certain": "warn",
    "not found": "warn",
    "out of reach": "bad",
    "refused": "bad",
    "refused by the arm": "bad",
    "falls": "bad",
}
_SPEEDS = (0.5, 1, 2, 4, 8, 16, 32, 64)
_LONGEST = 60.0
"""The chosen speed shows all steps within this time [s]."""
_SECONDS_PER_STEP = 1.1
_SCRIPTS = ("three.bundle.js", "view.js", "stage.js", "timeline.js")
_SHOW, _BLOCKS = "show.html", "blocks.html"
LICENCE = "The 3-D view uses three.js (MIT licence, text inside this file)."
_LISTED = 12
"""Cells to blame that are named one by one."""


class Verdict(NamedTuple):
    """What came of a plan or a check."""

    status: str = ""
    """Such as ``complete`` or ``stands only with tight joints``."""
    reason: str = ""
    """Why it is not complete, or does not stand."""
    moving: Collection[str] = ()
    """Ids of blocks that start to move, or are out of reach; they are marked."""


_UNSAID = Verdict()


def render_assembly_page(
    assembly: Assembly,
    *,
    title: str,
    facts: Sequence[tuple[str, str]] = (),
    step_notes: Sequence[StepNote] = (),
    forces: tuple[Contacts, np.ndarray | None] | None = None,
    arms: Sequence[StandingArm] = (),
    verdict: Verdict = _UNSAID,
    plan: Plan | None = None,
) -> str:
    """The page of an assembly as the text of a stand-alone HTML file.

    ``#step=5`` behind its address opens it at step 5; without it the finished structure shows.

    Args:
        assembly: blocks and steps; blocks that no step places stand from the start, or are not
            built.
        title: of the page.
        facts: name and value of each, for its head.
        step_notes: of every step of the assembly, or none.
        forces: contacts between the blocks of ``assembly.finished``, and float64[C, 3], the
            forces at their corners [N, world], where they are known.
        arms: that stand there, with what they reach on the table.
        verdict: shown beside the title, with the blocks that it is about.
        plan: of the assembly, whose targets, goals and obstacles the 3-D view shows, with what was
            tried for it and what an arm did, which the page plays.

    Raises:
        InputError: where the notes do not fit the steps.
    """
    steps = assembly.steps
    if step_notes and len(step_notes) != len(steps):
        raise InputError("step_notes", len(step_notes), f"one for each of {len(steps)} steps")
    notes = list(step_notes) or [StepNote()] * len(steps)
    told = instructions(assembly)
    parts, shapes, layers = scene.block_parts(assembly, verdict.moving)
    filled = "covered" if plan is not None and plan.design.targets else "filled"
    noted = tables.noted_steps(told, parts, notes, filled)
    standing = sum(not part.placed for part in parts)
    captions = [f"Start: {count_words(standing, 'block')} in place."]
    captions += [step.caption for step in noted]
    marks = _blamed(plan)
    front = plan is not None and scene.drawn_from_front(plan.design.drawn)
    data = scene.scene_data(parts, shapes, layers, len(steps), assembly.joint)
    data |= _plan_data(plan) | {
        "captions": captions,
        "layers": tables.layer_words(_built(parts), layers, noted),
        "joints": scene.joint_data(forces) if forces is not None else None,
        "marks": scene.mark_data(marks),
        "scale": scene.scale_data(told.origin, _corners(parts)[1] - told.origin),
        "view": scene.first_view((part.block for part in parts), [arm.base for arm in arms], front),
    }
    page = {
        **_head(title, verdict, plan),
        **_build(told, noted, parts, data),
        "at_friction": "" if plan is None else friction_words(plan),
        "legend": tables.legend(parts, marks)
        + tables.entry("unbuilt", "not built") * bool(assembly.not_built)
        + _target_legend(plan),
        "licence": LICENCE,
        "facts": fact_list(facts),
        "behind": f'<p class="behind" id="behind" hidden>{SEEN_FROM_BEHIND}</p>' * front,
    }
    asked = plan is not None and not plan.complete and not steps
    low, high = _corners(_built(parts))
    least = None if plan is None else plan.margin_friction
    words = tables.summary(assembly, _once(parts), high - low, least)
    page["summary"] = escape(f"Nothing is built. The design as blocks: {words}" if asked else words)
    page["show_title"] = (
        "The build" if steps else "What was asked for" if asked else "The structure"
    )
    scripts = _SCRIPTS
    if arms:
        data["standing"] = standing_data(arms)
        page["body"] += " with-arm"
        page["views"] += NEAR_VIEW
        page["legend"] += tables.entry("target", REACH_WORDS)
        scripts = (*_SCRIPTS[:-1], "arm.js", _SCRIPTS[-1])
    if plan is not None and anything_to_play(plan.records):
        playback = Playback(plan.records, plan)
        labels = cell_labels(assembly, playback.blocks, captions)
        data["arm"] = arm_data(playback, labels)
        bases = [arm.shape.chain.offset[0, :2] for arm in playback.arms]
        data["view"] = scene.first_view((part.block for part in parts), bases, front)
        page |= {**arm_values(playback), "body": "movable assembly with-arm"}
        page["views"] += NEAR_VIEW
        page["legend"] += tables.entry("waiting", "waiting block")
        page["legend"] += tables.entry("goal", "where this step puts it")
        page["legend"] += tables.entry("soft", "not in use") * (None in playback.blocks)
        page["summary"] += escape(
            f" Built by {arms_words(playback).lower()}: {arm_summary(playback.record)}."
        )
        if data["arm"]["truth"] is not None:
            words, scale = "where a block really is", data["arm"]["truth"]["scale"]
            words += f", errors {scale} times as large" * (scale > 1)
            page["legend"] += tables.entry("truth", words)
        page["attempts"] = place_section(
            playback, told.origin, "" if plan.arm is None else plan.arm.planed_words
        )
        page["attempts"] += arm_section(playback, labels.names)
        page["attempts"] += error_section(playback, labels.names)
        scripts = (*_SCRIPTS[:-1], "arm.js", _SCRIPTS[-1])
    return stand_alone(page, data, scripts, (_SHOW, _BLOCKS))


def _built(parts: Sequence[ScenePart]) -> list[ScenePart]:
    """One stay of every block, without what stood before and is gone at the end, if that is not
    all."""
    whole = _once(parts)
    return [part for part in whole if part.placed or not part.removed] or whole


def _once(parts: Sequence[ScenePart]) -> list[ScenePart]:
    """One stay of every block."""
    return list({part.block.id: part for part in parts}.values())


def _head(title: str, verdict: Verdict, plan: Plan | None) -> dict[str, str]:
    """What stands above and below everything else on any page."""
    status, reason, _ = verdict
    tone = f' <span class="status {TONES.get(status, "warn")}">{escape(status)}</span>'
    words = [f"<p>{prose(text)}</p>" for text in (sentence(reason), *_blame_sentences(plan))]
    page = {
        "title": escape(title),
        "eyebrow": "Assembly" + tone * bool(status),
        "reason": f'<div class="reason" role="alert">{"".join(words)}</div>' * bool(reason),
    }
    if plan is not None:
        page["tried"] = tables.tried(plan.search.attempts if plan.search else ())
        proof = plan.verified_by if plan.steps else None
        named = (("Verified by", proof), ("Made from", plan.design.source))
        page["source"] = escape(" ".join(f"{name}: {words}." for name, words in named if words))
    return page


def _build(
    told: Instructions, noted: list[tables.Noted], parts: list[ScenePart], data: dict[str, Any]
) -> dict[str, str]:
    """The 3-D view with its timeline, the plans of layers, the bill and the table of steps."""
    count = str(len(noted))
    wanted = _SECONDS_PER_STEP * len(noted) / _LONGEST
    low, high = _corners(parts)
    pad = 1000 * max(0.3 * data["edge"], 0.12 * float((high - low)[:2].max()))
    width, depth = 1000 * (high - low)[:2] + 2 * pad
    head, rows = tables.step_table(noted)
    bill_head, bill_rows = tables.bill(told)
    joint = f" Vertical joints are {length_words(told.joint, 2)} mm wide; the nominal size of a "
    joint += "block is the block itself and one joint."
    return {
        "body": "movable assembly" if noted else "fixed assembly",
        "views": "".join(
            f'<button type="button" data-side="{k}">{escape(target["name"].capitalize())}</button>'
            for k, target in enumerate(data["targets"])
        )
        + '<button type="button" id="from-above">From above</button>',
        "slider_last": count,
        "slider_step": "1",
        "slider_name": "Step",
        "count": f"{count} / {count}",
        "speeds": speed_options(_SPEEDS, next((s for s in _SPEEDS if s >= max(wanted, 1)), 64)),
        "caption": escape(data["captions"][-1]),
        "under_legend": _toggles(data["joints"]),
        "layer_box": f"{1000 * low[0] - pad:.1f} {-1000 * high[1] - pad:.1f} "
        f"{width:.1f} {depth:.1f}",
        "layer_count": str(len(data["layers"])),
        "last_layer": escape(data["layers"][-1]),
        "bill_head": bill_head,
        "bill": bill_rows,
        "corners": tables.corners(told),
        "cuts": tables.cuts(told),
        "joint": joint * bool(told.joint),
        "how_to_read": escape(reading_words(told)),
        "step_head": head,
        "steps": rows,
    }


def _corners(parts: Sequence[ScenePart]) -> tuple[np.ndarray, np.ndarray]:
    """float64[3] each: lower and upper corner of the box round all blocks [m, world]."""
    high = np.max([part.block.vertices.max(0) for part in parts], 0)
    return np.min([part.origin for part in parts], 0), high


def _plan_data(plan: Plan | None) -> dict[str, Any]:
    """The targets, goals and obstacles of a plan for the scripts."""
    targets, boxes = ((), ()) if plan is None else (plan.design.targets, plan.design.boxes)
    return {
        "targets": [
            {"name": t.name, "outline": t.outline, "outward": np.array(t.outward)} for t in targets
        ],
        "boxes": [
            {"what": box.what, "low": np.array(box.low), "high": np.array(box.high)}
            for box in boxes
        ],
    }


def _target_legend(plan: Plan | None) -> str:
    targets, boxes = ((), ()) if plan is None else (plan.design.targets, plan.design.boxes)
    wanted = any(box.what != "obstacle" for box in boxes)
    return (
        tables.entry("target", "target outline") * bool(targets)
        + tables.entry("target", "to be filled, reached or loaded") * wanted
        + tables.entry("bad", "obstacle") * any(box.what == "obstacle" for box in boxes)
    )


def _blamed(plan: Plan | None) -> list[Mark]:
    """The cells that are to blame for a design's not being built, by reason."""
    if plan is None or plan.design.cell is None or plan.design.shape is None:
        return []
    size, shape = np.array(plan.design.cell), np.array(plan.design.shape)
    found = list[Mark]()
    for group in plan.blamed:
        corner = (np.array(group.cells) - [shape[0] / 2, shape[1] / 2, 0]) * size
        boxes = np.hstack([corner, corner + size])
        found.append(Mark(f"cells {BLAME_WORDS[group.why]}", boxes))
    return found


def _blame_sentences(plan: Plan | None) -> list[str]:
    """Which cells are marked, in words."""
    found = list[str]()
    for group in plan.blamed if plan is not None else ():
        named = listed(group.cells, _LISTED)
        found.append(
            f"Marked red in the picture: {count_words(len(group.cells), 'cell')} "
            f"{BLAME_WORDS[group.why]}: {named}, counted from 0 to the right, to the back and up."
        )
    return found


def _toggles(joints: dict[str, Any] | None) -> str:
    names = ["joints", "forces"] if joints and "forces" in joints else ["joints"] * bool(joints)
    boxes = "".join(
        f'<label><input type="checkbox" id="show-{name}"> {name}</label>' for name in names
    )
    note = " of the finished structure" if boxes else ""
    return f'<p class="toggles">{boxes}{note}</p><p class="picked" id="picked" role="status"></p>'


def write_plan_page(plan: Plan, path: Path) -> None:
    """The page of a plan: what was filled, what is proven, and every step.

    Raises:
        InputError: for a plan whose blocks are not known, and where ``path`` cannot be written.
    """
    if plan.assembly is None and not plan.found_nothing:
        raise InputError("plan", "no blocks", "assembly.json beside plan.json")
    if plan.assembly is None:
        write_file(path, _page_of_nothing(plan), "page")
        return
    targets = plan.design.targets
    leaning = any(has_leaning_face(block) for block in plan.assembly.blocks)
    # Where arms have built, attempts say whose they are.
    by = ["" if plan.records else step.arm or "" for step in plan.steps]
    told = zip(plan.steps, by, strict=True)
    text = render_assembly_page(
        plan.assembly,
        title=plan.design.name,
        facts=_facts(plan),
        step_notes=[_note(step, targets, leaning, arm) for step, arm in told],
        verdict=Verdict(_status(plan), as_both(plan.reason or "")),
        plan=plan,
    )
    write_file(path, text, "page")


def _facts(plan: Plan) -> list[tuple[str, str]]:
    """Name and value of what is told of a plan."""
    used, available = plan.blocks.used, plan.blocks.available
    targets = plan.design.targets
    props = sum(step.prop and step.action == "place" for step in plan.steps)
    holds = sum(step.action == "hold" for step in plan.steps)
    facts: list[tuple[str, str | None]] = [
        ("arms", ", ".join(_who(plan, arm.name) for arm in plan.arms)),
        ("planner", plan.planner),
        ("agent", plan.agent),
        ("search", plan.search.needed if plan.search and targets else None),
        ("kit", plan.kit),
        ("steps", str(len(plan.steps))),
        ("blocks", f"{used} of {available}" if targets else str(used)),
        ("blocks found, none placed", str(plan.not_placed) if plan.not_placed else None),
        ("props", str(props) if props else None),
        ("holds by a hand", str(holds) if holds else None),
    ]
    if targets:
        needed = percent(plan.design.success_threshold)
        facts.append(("covered", f"{percent(plan.coverage)} of the target ({needed} needed)"))
    if (cells := plan.cells) is not None:
        words = f"{cells.wanted} wanted, {cells.missing} open, {cells.outside} outside"
        if cells.other_colour is not None:
            words += f", {cells.other_colour} in a block of another colour"
        facts.append(("cells, as planned" if plan.as_planned else "cells", words))
    if plan.design.iou is not None:
        facts.append(("drawing and cells in common", f"{plan.design.iou:.1%}"))
    facts.append(("warning", plan.design.not_read))
    if plan.design.note:
        facts.append(("reading", plan.design.note))
    if plan.margin_g is not None:
        facts.append(("weakest step", weakest_words(plan)))
        facts.append(("least push withstood", _least_push(plan)))
    if plan.margin_g is not None and (left := plan.without_margin):
        facts.append(("push not computed", f"{left} of {len(plan.steps)} steps"))
    facts += [(f"proven for {what}", words) for what, words in plan.proven_for.items()]
    return [(name, value) for name, value in facts if value]


def _status(plan: Plan) -> str:
    """The status of a plan, and who refuses it where it is an arm."""
    return f"{plan.status} by the arm" if plan.not_placed else plan.status


def _who(plan: Plan, name: str) -> str:
    """An arm, and how many steps are its."""
    steps = sum(step.arm == name for step in plan.steps)
    return f"{name} ({count_words(steps, 'step')})"


def _least_push(plan: Plan) -> str | None:
    """The smallest sideways push that is withstood after any step, and the step it belongs to: not
    always the weakest one, as a push of so many g is one of fewer newtons where less stands."""
    if plan.assembly is None:
        return None
    blocks = plan.assembly.blocks
    mass = {block.id: 0.0 if block.support else block.mass for block in blocks}
    there = [b for b, first in zip(blocks, plan.assembly.at_first, strict=True) if first]
    total, count = sum(mass[b.id] for b in there), sum(not b.support for b in there)
    pushes = list[tuple[float, int]]()
    for done, step in zip(plan.assembly.steps, plan.steps, strict=True):
        change = {"place": 1, "remove": -1}.get(done.action, 0)
        total, count = total + mass[done.block] * change, count + change
        if count and step.margin_g is not None and step.margin_g < LARGEST:
            pushes.append((step.margin_g * total * GRAVITY, step.step))
    if not pushes:
        return None
    push, number = min(pushes)
    return f"{newtons(push)} N sideways, after step {number}"


def _page_of_nothing(plan: Plan) -> str:
    """The page of a plan for which no block was found: why, which cells are to blame, and what was
    tried."""
    marks = _blamed(plan)
    page = {
        **_head(plan.design.name, Verdict(plan.status, as_both(plan.reason or "")), plan),
        "summary": "No blocks were placed.",
        "body": "fixed assembly bare",
        "facts": fact_list(_facts(plan)),
    }
    if not marks or plan.design.cell is None:
        return stand_alone(page, {}, (), ())
    data = scene.nothing_to_draw(min(plan.design.cell))
    data |= _plan_data(plan) | {
        "captions": [""],
        "layers": [],
        "joints": None,
        "marks": scene.mark_data(marks),
        "scale": None,
        "view": [0.0, -scene.ASIDE],
    }
    page |= {
        "show_title": "The cells to blame",
        "views": '<button type="button" id="from-above">From above</button>',
        "legend": tables.legend([], marks),
        "licence": LICENCE,
        "under_legend": _toggles(None),
    }
    return stand_alone(page, data, _SCRIPTS, (_SHOW,))


def _note(step: Step, targets: Sequence[PlanTarget], leaning: bool, arm: str) -> StepNote:
    """What is said about a step of a plan; ``leaning``: not all its joints are level or upright;
    ``arm``: which one is to do it."""
    where = placement(step)
    sides = []
    if len(targets) > 1:
        shares = zip(targets, step.sides, strict=bool(step.sides))
        sides = [f"{target.name} {percent(share)}" for target, share in shares]
    spare = (
        "" if step.margin_n is None else f"A contact point can pull {newtons(step.margin_n)} N more"
    )
    told = [spare, where[:1].upper() + where[1:] if where else "", ", ".join(sides)]
    told.append(f"By {arm}" if arm else "")
    more = "; ".join(part for part in told if part)
    return StepNote(
        proof_words(step.proof or "", leaning), step.margin_g, step.coverage, more and f"{more}."
    )
