"""The words of a page: shares, what an arm does, and what became of it."""

from __future__ import annotations

import math
from collections.abc import Collection
from decimal import Decimal

from learn2assemble.motion.record import BuildRecord, Stage, StepRecord
from learn2assemble.planning.plan import LARGEST, Plan, Step
from learn2assemble.robot.moves import Outcome

_RELATIONS = {
    "top": "on top of",
    "left": "to the left of",
    "right": "to the right of",
    "front": "in front of",
    "behind": "behind",
}


def percent(share: float | None) -> str:
    """``0.9886`` as ``98.9 %`` with a space that does not break; never rounded up to 100 %."""
    if share is None:
        return "–"
    if share in (0, 1):
        return f"{share:.0%}".replace("%", "\u00a0%")
    return f"{min(100 * share, 99.9) if share < 1 else 100 * share:.1f}\u00a0%"


def newtons(force: float) -> str:
    """Two digits of a force [N] that count, as ``1300``, ``5.2`` and ``0.031``."""
    return f"{Decimal(f'{force:.2g}'):f}"


def placement(step: Step) -> str:
    """Where a step of a task puts its block, e.g. ``on top of b3``."""
    if step.relation is None or step.reference is None:
        return ""
    return f"{_RELATIONS[step.relation]} b{step.reference}"


def proof_words(proof: str, leaning: bool) -> str:
    """What proves a step, for readers.

    Args:
        proof: as the plan has it.
        leaning: whether blocks have joints that lean, such as those of an arch.
    """
    # These load compiled code.
    from learn2assemble.statics import proofs

    if proof == proofs.BED and leaning:
        return "on joints that weight presses, with friction"
    return {
        proofs.LOCAL: "on bed faces alone, whatever the friction",
        proofs.PROGRAM: "on bed faces alone, whatever the friction",
        proofs.FRICTIONLESS: "on bed faces alone, without friction",
        proofs.BED: "on bed faces, with friction",
        proofs.TIGHT: "only where side faces touch",
        proofs.POINTS: "also on edges and points, with friction",
        proofs.CLUTCH: "by joints that hold",
        proofs.CLUTCH_TIGHT: "by joints that hold, only where side faces touch",
        proofs.MORTAR: "by mortar that holds",
    }.get(proof, proof)


def weakest_words(plan: Plan) -> str:
    """The step with the smallest margin, the first of several, with what that margin is for, e.g.
    ``step 79: 0.082 g sideways at friction 0.6``; empty where no margin is known."""
    known = [(s.margin_g, s.step) for s in plan.steps if s.margin_g is not None]
    if not known:
        return ""
    margin, step = min(known)
    worth = "any push" if margin >= LARGEST else f"{margin:.3f} g sideways"
    return f"step {step}: {worth}{friction_words(plan)}"


def friction_words(plan: Plan) -> str:
    """The friction that margins are for, e.g. `` at friction 0.5``; empty where it is not known."""
    return "" if plan.margin_friction is None else f" at friction {plan.margin_friction:g}"


BLAME_WORDS = {
    "not filled": "that no blocks of the kit fill",
    "not carried": "whose block nothing carries",
    "cannot be placed": "of a block that does not stand when it is placed, or of a prop that "
    "cannot be taken away",
    "would fall": "of blocks that would fall if that one were placed",
}
"""Why cells are to blame, after ``4 cells``."""
STAGE_WORDS = {
    "approach": ("moves to above {block}", "moves on"),
    "pick": ("goes down and grasps {block}", "goes down to {block}"),
    "lift": ("lifts {block}", "goes up without a block"),
    "cross": ("carries {block} across", "moves across without a block"),
    "place": ("lowers {block} into its place", "goes down without a block"),
    "release": ("opens the fingers", "opens the fingers"),
    "retreat": ("leaves {block} and goes up", "goes up without a block"),
    "home": ("moves back to where it waits", "moves back to where it waits"),
}
"""Of every stage: as it should go, and with an empty hand that should not be empty."""
OUTCOME_WORDS = {
    Outcome.REACHED: "the block stands where it should, and nothing else has moved",
    Outcome.UNREACHABLE: "there is no way for the arm's joints; it does not move",
    Outcome.GRASP_COLLISION: "something would be or was touched on the way to the block",
    Outcome.PLACE_COLLISION: "something would be or was touched on the way to its place",
    Outcome.GRASP_LOST: "the fingers closed on nothing, or the block slipped out at once",
    Outcome.DISTURBED_STRUCTURE: "a block that stood before has moved",
    Outcome.TOPPLED: "the block did not stay where it was released",
    Outcome.DROPPED: "the block was lost on the way",
    Outcome.NO_CONTACT: "the block was lowered as far as it may be and met nothing",
    Outcome.STOPPED: "the arm was stopped before it had taken the block",
}
_CARRYING = ("lift", "cross", "place")


SUCTION_WORDS = {
    "pick": ("goes down and takes hold of {block}", "goes down to {block}"),
    "release": ("lets go", "lets go"),
}
"""Where a cup or a socket does otherwise than fingers."""


def stage_words(step: StepRecord, stage: Stage, block: str, suction: bool = False) -> str:
    """What the arm does, e.g. ``"lifts block 7"``; ``block`` is how the object is called."""
    words = {**STAGE_WORDS, **SUCTION_WORDS} if suction else STAGE_WORDS
    as_planned, empty = words[stage.name]
    middle = (stage.start + stage.end) / 2
    release = math.inf if step.release is None else step.release
    held = step.grip is not None and step.grip <= middle <= release
    lost = stage.name in _CARRYING and not held
    lost |= stage.name in ("pick", "retreat") and step.grip is None
    return (empty if lost else as_planned).format(block=block)


def sentence(text: str, names: Collection[str] = ()) -> str:
    """With a full stop, and a capital letter but where it begins with a name; empty stays empty."""
    text = text.strip().rstrip(".")
    if text and not any(text.startswith(name) for name in names):
        text = f"{text[0].upper()}{text[1:]}"
    return f"{text}." if text else ""


def clock_words(seconds: float) -> str:
    """``83.4`` as ``1:23``."""
    return f"{int(seconds) // 60}:{int(seconds) % 60:02d}"


def arm_summary(record: BuildRecord) -> str:
    """Outcomes in short, e.g. ``"20 of 22 attempts reached in 2:43 of robot time"``."""
    reached = sum(step.outcome == Outcome.REACHED for step in record.steps)
    spent = record.spans()[-1][1] if record.steps else 0.0
    return (
        f"{reached} of {len(record.steps)} attempts reached in {clock_words(spent)} of robot time"
    )
