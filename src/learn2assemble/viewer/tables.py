"""What the page of an assembly says: head, captions, legend, bill and the table of steps."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from html import escape
from itertools import chain
from typing import NamedTuple

import numpy as np

from learn2assemble.assembly.blocks import Action, Assembly
from learn2assemble.assembly.instructions.appearance import millimetres
from learn2assemble.assembly.instructions.steps import Instructions, Placement
from learn2assemble.assembly.instructions.words import (
    BILL_HEAD,
    CUT_HEAD,
    action_words,
    before_words,
    bill_words,
    corner_words,
    count_words,
    cut_list,
    extent_words,
    kind_words,
    name_words,
    place_words,
    placement_words,
    way_words,
)
from learn2assemble.constants import GRAVITY
from learn2assemble.planning.plan import LARGEST, SearchStage
from learn2assemble.viewer.html import NUMBER, prose, row
from learn2assemble.viewer.scene import Mark, ScenePart
from learn2assemble.viewer.words import newtons, percent

STEP_HEAD = (
    "Step",
    "Action",
    "Shape",
    "x",
    "y",
    "z",
    "Turn",
    "Kind",
    "Nominal size",
    "Layer",
    "Block",
    "Stands",
    "Push [N]",
    "Push [g]",
    "Tilt [°]",
)
_UNKNOWN = {False: "–", True: "not computed"}
"""The push that is withstood where it is not known, without and with a proof."""
_NUMBERS = (3, 4, 5, 8, 9, 12, 13, 14, 15)
"""Columns of the table of steps that hold numbers."""


class StepNote(NamedTuple):
    """What is known about the state after a step."""

    proof: str = ""
    """How it was proven to stand."""
    margin_g: float | None = None
    """Sideways acceleration it withstands [g]."""
    coverage: float | None = None
    """Share of what is wanted that is filled."""
    more: str = ""
    """Anything else: where the block goes, which share of each side of a target is covered."""


class Noted(NamedTuple):
    """A step of an assembly with all that the page says about it."""

    number: int
    part: ScenePart
    placement: Placement
    note: StepNote
    weight: float
    """Of all that stands after the step but fixed supports [N]."""
    filled: str
    """What happens to the share of what is wanted: ``filled`` or ``covered``."""
    held: tuple[str, ...] = ()
    """Other blocks that hands hold meanwhile."""

    @property
    def action(self) -> Action:
        """What the step does to its block."""
        return self.placement.action

    @property
    def push(self) -> float | None:
        """The sideways push that everything together withstands after the step [N]."""
        margin = self.note.margin_g
        return None if margin is None else margin * self.weight

    @property
    def caption(self) -> str:
        """What the page says below the 3-D view."""
        part, note = self.part, self.note
        if self.action in ("place", "remove"):
            id_ = part.block.id
            name = f"{name_words(id_, 'prop') if part.block.prop else id_} ({part.kind})"
            away = "Remove" if part.block.prop else "Take away"
            done = "Place" if self.action == "place" else away
            text = f"{done} {name}, layer {part.layer + 1}."
        else:
            text = f"{action_words(self.action, name_words(part.block.id))}."
        for told in (before_words(self.placement), way_words(self.placement)):
            text += f" {told}" * bool(told)
        if self.held:
            text += f" Still in a hand: {', '.join(self.held)}."
        if note.proof:
            text += f" Stands: {note.proof}."
        if note.proof and note.margin_g is None:
            text += " What push it withstands was not computed."
        if note.margin_g is not None and self.push is not None:
            text += f" {push_words(note.margin_g, self.push)}"
        if note.coverage is not None:
            text += f" {percent(note.coverage)} {self.filled}."
        return f"{text} {note.more}".strip()


def push_words(margin_g: float, push: float) -> str:
    """In plain words, which push is withstood.

    Args:
        margin_g: sideways acceleration that is withstood [g].
        push: of everything together [N].
    """
    if margin_g >= LARGEST:
        return "Withstands any sideways push."
    return (
        f"Withstands a sideways push of {newtons(push)} N in every direction, shared by all blocks "
        f"by weight ({margin_g:.2f} g), or a tilt of {tilt_words(margin_g)}°."
    )


def tilt_words(margin_g: float) -> str:
    """Tilt [deg] with the same ratio of sideways to downward acceleration."""
    return f"{math.degrees(math.atan(margin_g)):.1f}"


def noted_steps(
    told: Instructions, parts: Sequence[ScenePart], notes: Sequence[StepNote], filled: str
) -> list[Noted]:
    """Every step of an assembly with what the page says about it.

    Args:
        told: the instructions.
        parts: stays of the blocks.
        notes: one a step.
        filled: as :class:`Noted` says.
    """
    of_step = {
        number: part
        for part in parts
        for number in (part.placed, part.removed, *chain.from_iterable(part.holds))
    }
    free = [p for p in parts if not p.placed and not p.block.support]
    mass, count = sum(part.block.mass for part in free), len(free)
    found: list[Noted] = []
    held: tuple[str, ...] = ()
    placements = told.placements if told.assembly.steps else []
    for placement, note in zip(placements, notes, strict=True):
        part = of_step[placement.number]
        change = {"place": 1, "remove": -1}.get(placement.action, 0)
        mass, count = mass + part.block.mass * change, count + change
        weight = mass * GRAVITY
        if not count:  # Nothing is left of which it could be said that it stands.
            note = note._replace(proof="", margin_g=None)
        held = tuple(id_ for id_ in held if id_ != part.block.id)
        found.append(Noted(placement.number, part, placement, note, weight, filled, held))
        held += (part.block.id,) if placement.action == "hold" else ()
    return found


def summary(
    assembly: Assembly,
    parts: Sequence[ScenePart],
    extent: np.ndarray,
    friction: float | None = None,
) -> str:
    """How much there is, in one line.

    Args:
        assembly: what stands.
        parts: one stay of every block.
        extent: float64[3], of all of it but what is taken away [m].
        friction: for which it is proven, where that is not the assembly's own.
    """
    props = sum(part.block.prop for part in parts)
    supports = sum(part.block.support for part in parts)
    gone = sum(bool(part.removed) and not part.block.prop for part in parts)
    words = [count_words(len(parts) - props - supports - gone, "block"), millimetres(*extent)]
    words += [f"{gone} taken away"] if gone else []
    words += [count_words(props, "prop")] if props else []
    words += [count_words(supports, "fixed support")] if supports else []
    words += [count_words(len(assembly.steps), "step")] if assembly.steps else []
    words += [f"{len(assembly.not_built)} not built"] if assembly.not_built else []
    mu = assembly.friction if friction is None else friction
    return ", ".join([*words, f"friction {mu:g}"]) + "."


def step_table(steps: Sequence[Noted]) -> tuple[str, str]:
    """Head and rows of the table of steps, with columns of what is filled and of what else
    is known."""
    covered = any(step.note.coverage is not None for step in steps)
    more = any(step.note.more for step in steps)
    names = [*STEP_HEAD]
    names += [steps[0].filled.capitalize()] if covered else []
    names += [""] if more else []
    head = "".join(
        f"<th {NUMBER}>{name}</th>" if k in _NUMBERS and name else f"<th>{name}</th>"
        for k, name in enumerate(names)
    )
    return head, "".join(_row(step, covered, more) for step in steps)


def _row(step: Noted, covered: bool, more: bool) -> str:
    part, note, push = step.part, step.note, step.push
    _, letter, x, y, z, turn = placement_words(step.placement)
    margin = note.margin_g or 0.0
    known = note.margin_g is not None and push is not None and margin < LARGEST
    cells = [
        str(step.number),
        "wait, " * (step.placement.wait is not None)
        + step.action
        + " by hand" * step.placement.by_hand,
        letter,
        x,
        y,
        z,
        turn,
        escape(kind_words(step.placement.shape))
        + ' <span class="tag">prop</span>' * part.block.prop,
        extent_words(step.placement.shape.nominal),
        str(part.layer + 1),
        escape(part.block.id),
        escape(note.proof) or "–",
        newtons(push or 0.0)
        if known
        else "any"
        if note.margin_g is not None
        else _UNKNOWN[bool(note.proof)],
        f"{margin:.2f}" if known else "–",
        tilt_words(margin) if known else "–",
    ]
    cells += [percent(note.coverage)] if covered else []
    cells += [escape(note.more)] if more else []
    numbers = {k: NUMBER for k in _NUMBERS if k < len(STEP_HEAD) + covered}
    return row(cells, numbers, f'data-step="{step.number}"', f"Show step {step.number}")


def bill(told: Instructions) -> tuple[str, str]:
    """Head and rows of the bill: every shape in its colour, as cards and PDF have it."""
    numbers = {2: NUMBER, 3: NUMBER, 6: NUMBER}
    head = "".join(
        f"<th {NUMBER}>{name}</th>" if k in numbers else f"<th>{name}</th>"
        for k, name in enumerate(BILL_HEAD)
    )
    rows = list[str]()
    for line in told.bill:
        letter, *words = map(escape, bill_words(line))
        rows.append(row([_swatch(line.shape.colour) + letter, *words], numbers))
    return head, "".join(rows)


def corners(told: Instructions) -> str:
    """The corners of shapes that are no boxes, as paragraphs."""
    found = ((line.shape.letter, corner_words(line.shape)) for line in told.bill)
    return "".join(
        f'<p class="corners"><b>Shape {letter}</b>, corners [mm]: {words}</p>'
        for letter, words in found
        if words
    )


def cuts(told: Instructions) -> str:
    """The posts to cut, as a table; nothing where there are none."""
    numbers = dict.fromkeys(range(1, len(CUT_HEAD)), NUMBER)
    rows = "".join(row(list(words), numbers) for words in cut_list(told))
    head = "".join(
        f"<th {NUMBER}>{name}</th>" if k in numbers else f"<th>{name}</th>"
        for k, name in enumerate(CUT_HEAD)
    )
    return (
        '<h3>Posts to cut</h3><div class="scroll"><table><thead><tr>'
        f"{head}</tr></thead><tbody>{rows}</tbody></table></div>"
    ) * bool(rows)


def layer_words(
    parts: Sequence[ScenePart], layers: Sequence[float], steps: Sequence[Noted]
) -> list[str]:
    """What belongs to every layer and where it begins.

    For example ``Layer 2 of 9, from 50 mm: 4 of 2x4, 1 of 1x2. Its first block, of step 5: 0 mm to
    the right of O, 50 mm behind it.``

    Args:
        parts: one stay of every block.
        layers: where they begin [m, world].
        steps: all of the assembly.
    """
    found = list[str]()
    for k, height in enumerate(layers):
        members = [part for part in parts if part.layer == k]
        counts = Counter(part.kind for part in members).most_common()
        listed = ", ".join(f"{number} of {kind}" for kind, number in counts)
        words = f"Layer {k + 1} of {len(layers)}, from {millimetres(height - layers[0])}: {listed}."
        first = next((s for s in steps if s.part.layer == k and s.action == "place"), None)
        if first is not None:
            place = place_words(first.placement)
            words += f" Its first block, of step {first.number}: {place}."
        found.append(words)
    return found


def legend(parts: Sequence[ScenePart], marks: Sequence[Mark]) -> str:
    """Kinds by colour; the swatches are SVG, whose colours need no style sheet."""
    words = {"prop": "prop, removed again", "support": "fixed support", "bad": "starts to move"}
    named: dict[str, dict[str, None]] = {}
    for part in parts:
        named.setdefault(part.colour, {})[words.get(part.colour, part.kind)] = None
    text = entry("current", "block of this step") * any(part.placed for part in parts)
    text += entry("held", "held by a hand") * any(part.holds for part in parts)
    for colour, kinds in list(named.items())[:16]:
        several = ", ".join(list(kinds)[:3]) + ", …" * (len(kinds) > 3)
        text += f"<li>{_swatch(colour)}{escape(several)}</li>"
    return text + "".join(entry("blamed", escape(mark.words)) for mark in marks)


def _swatch(colour: str) -> str:
    paint = f'fill="{colour}"' if colour.startswith("#") else f'class="{colour}"'
    return f'<svg class="swatch" viewBox="0 0 14 14"><rect width="14" height="14" {paint}/></svg>'


def entry(name: str, words: str) -> str:
    """An entry of the legend, by the name of its style."""
    return f'<li><i class="{name}"></i>{words}</li>'


def tried(stages: Sequence[SearchStage]) -> str:
    """What the planner tried, as a table; nothing where it tried nothing."""
    rows = "".join(
        row([prose(item.stage), prose(item.result), f"{item.seconds:.2f} s"], {2: NUMBER})
        for item in stages
    )
    head = f"<tr><th>Stage</th><th>Result</th><th {NUMBER}>Time</th></tr>"
    return (
        '<section class="more" aria-labelledby="tried-title"><h2 id="tried-title">What was tried'
        f'</h2><div class="scroll"><table><thead>{head}</thead><tbody>{rows}</tbody></table></div>'
        "</section>"
    ) * bool(rows)
