"""The sentences of a build report: what a plan says, in plain words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

_RELATIONS = {
    "top": "on top of",
    "left": "to the left of",
    "right": "to the right of",
    "front": "in front of",
    "behind": "behind",
}
STATUS_WORDS = {
    "complete": "Complete",
    "incomplete": "Incomplete",
    "refused": "Refused",
}


def percent(share: float | None) -> str:
    """``0.9886`` as ``98.9 %`` with a space that does not break; never rounded up to 100 %."""
    if share is None:
        return "–"
    if share in (0, 1):
        return f"{share:.0%}".replace("%", "\u00a0%")
    return f"{min(100 * share, 99.9) if share < 1 else 100 * share:.1f}\u00a0%"


def block_name(number: int) -> str:
    """How a block is called in the text: by the number that stands on it in the drawings."""
    return "the first block" if number == 0 else f"block {number}"


def placement(step: Mapping[str, Any]) -> str:
    """Where a step puts its block, e.g. ``on top of block 3``."""
    return f"{_RELATIONS[step['relation']]} {block_name(step['reference'])}"


def summary(plan: Mapping[str, Any]) -> str:
    """The report in short: status, blocks, coverage, search, verification."""
    used, available = plan["blocks"]["used"], plan["blocks"]["available"]
    needed = percent(plan["design"]["success_threshold"])
    covered = percent(plan["coverage"])
    if plan["status"] == "refused":
        return (
            f"There is no build order for this design of {_sides(plan)}; "
            f"{available} blocks were available."
        )
    word = "verified" if plan["status"] == "complete" else "checked"
    verified = f"{word} by {plan['verified_by']}" if plan.get("verified_by") else f"not {word}"
    found = f"Search needed: {plan['search']['needed'] or 'none'}; {verified}."
    if plan["status"] == "complete":
        return (
            f"{used} of {available} blocks, placed in an order that stays stable after every "
            f"step, cover {covered} of the target ({needed} needed). {found}"
        )
    return (
        f"The best order found places {used} of {available} blocks and covers {covered} of the "
        f"target, short of the {needed} needed. {found}"
    )


def first_share(plan: Mapping[str, Any], key: str = "coverage") -> float:
    """Coverage before the first step: 0 where it counts from the first block."""
    return float((plan.get("first_block") or {}).get(key, 0.0))


def caption(plan: Mapping[str, Any], number: int) -> str:
    """What happens in step ``number``; 0 is the start."""
    if number == 0:
        if not plan.get("first_block"):
            return "Start: the table is empty."
        counted = "" if first_share(plan) else " Coverage is counted from here."
        return f"Start: only the first block stands.{counted}"
    step = plan["steps"][number - 1]
    support = " It stands outside every outline, as a support." if step.get("outside") else ""
    unstable = "" if step["stable"] else " The structure does not stay stable."
    return (
        f"Block {number} goes {placement(step)}; now {percent(step['coverage'])} "
        f"of the target is covered.{support}{unstable}"
    )


def _sides(plan: Mapping[str, Any]) -> str:
    count = len(plan["design"]["elevations"])
    return "one side" if count == 1 else f"{count} sides"
