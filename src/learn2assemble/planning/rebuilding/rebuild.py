"""The plan that turns a standing structure into another one."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from learn2assemble.assembly.blocks import Assembly, AssemblyStep
from learn2assemble.assembly.contacts import Contacts, add_point_contacts, find_contacts
from learn2assemble.assembly.kit import Kit
from learn2assemble.errors import InputError, check_name
from learn2assemble.linear_programs import Clock
from learn2assemble.planning.forward import Forward
from learn2assemble.planning.given import contact_layers
from learn2assemble.planning.given_plan import plan_of
from learn2assemble.planning.orders import OrderProblem, site_of
from learn2assemble.planning.plan import LARGEST, Plan, RebuildReport, Step
from learn2assemble.planning.rebuilding.changeover import (
    Changeover,
    kinds_of,
    lying_on,
    merged,
    overlapping,
)
from learn2assemble.planning.rebuilding.fewest_moves import fewest_moves
from learn2assemble.planning.rebuilding.search import Rebuilt, count_moves, find_rebuilding
from learn2assemble.planning.sequence import Sequenced, list_ids, reported
from learn2assemble.statics.states import State
from learn2assemble.values import rounded

Progress = Callable[[str], None]


class _Tried(NamedTuple):
    """An attempt for one width of vertical joints."""

    change: Changeover
    rules: Forward
    ends: tuple[float, float]
    gap: float
    bound: _Bound
    found: Rebuilt


class _Bound:
    """Of the moves, looked for once, when an order is known: many meet what is seen at once.

    Args:
        seconds: that it may take.
        clock: of all.
    """

    def __init__(self, change: Changeover, seconds: float, clock: Clock) -> None:
        self._change, self._seconds, self._clock = change, seconds, clock
        self._least: int | None = None

    def __call__(self, known: float) -> int:
        """See :func:`~.fewest_moves.fewest_moves`."""
        if self._least is None:
            clock = Clock(min(self._seconds, self._clock.left))
            self._least = fewest_moves(self._change, clock, known)
        return self._least


def rebuild(
    old: Assembly, plan: Plan, *, seconds: float = 60.0, progress: Progress = lambda text: None
) -> Plan:
    """Turn a standing structure into a planned one with its own blocks, every state proven.

    What may stay stays; what has to go is taken away, to a new place at once where that is free
    and to a heap beside otherwise; what is missing comes from the supply, what is left over goes.
    Blocks stay where both structures have one of the same kind at the same pose, as both are given.
    No block is drawn out from under another or pushed in under one. States are proven for the
    friction and joints of the plan; nothing is held, and no prop comes.

    Args:
        old: what stands; of its steps only what they leave.
        plan: of the new structure, complete.
        seconds: wall-clock limit.

    Returns:
        The plan, whose steps begin at the old structure and end in the new one;
        :attr:`~.plan.Plan.rebuilt` has the moves and a number that none goes below
        (:func:`~.fewest_moves.fewest_moves`). A plan that is not complete is given back as it is.

    Raises:
        InputError: for an old structure that is not proven to stand, for blocks of another kit or
            size, for joints that hold, and for supports that are not the same.
    """
    started = time.perf_counter()
    if not plan.complete or plan.assembly is None:
        return plan
    clock, tried, falls = Clock(seconds), None, ("", "")
    for gap in _widths(plan):
        change, rules, ends = changed_over(old.finished, plan, seconds, gap)
        nothing = np.zeros(len(change.blocks), bool)
        begin, end = State(change.old, nothing), State(change.new, nothing)
        unproven = [state for state in (begin, end) if rules.law(state) is None]
        if unproven:
            names = list_ids(change.blocks, rules.laws[-1].moving(unproven[0])) or "some blocks"
            falls = "old" if unproven[0] is begin else "new", names
            continue
        bound = _Bound(change, seconds / 4, clock)
        found = find_rebuilding(change, rules, bound, clock, progress)
        tried = _Tried(change, rules, ends, gap, bound, found)
        if found.complete or clock.left <= 0:
            break
    if tried is None:
        which, names = falls
        if which == "old":
            got = f"a structure that falls: {names} move"
            raise InputError("old structure", got, "one that stands")
        reason = f"that the new structure stands is not proven: {names} may move"
        return replace(plan, status="not found", reason=reason)
    change, rules, ends, gap, bound, found = tried
    blocks = change.blocks
    begin = State(change.old, np.zeros(len(blocks), bool))
    steps = tuple(reported(rules.laws, rules.law, begin, found.steps))
    reason = None
    if not found.complete:
        late = f"time ran out after {seconds:g} s"
        reason = late if clock.left <= 0 else f"no order without help: {_what_is_stuck(tried)}"
    status = "complete" if found.complete else "not found"
    made = Sequenced(blocks, steps, status, reason, found.stuck)
    whole = replace(
        plan.assembly, blocks=blocks, steps=(), joints=(), not_built=(), name=plan.design.name
    )
    gaps = plan.gap_range and (plan.gap_range[0], gap)
    told = plan_of(whole, made, ends, gaps, started, change.old, change.new)
    placed = [step.block for step in steps if step.action == "place"]
    taken = [step.block for step in steps if step.action == "remove"]
    moves = count_moves(found.steps, change.kind)
    report = RebuildReport(
        moves=moves,
        moves_bound=bound(moves if found.complete else math.inf),
        kept=int(change.old.sum()) - len(set(taken)),
        taken=len(taken),
        placed=len(placed),
        supplied=(Counter(change.kind[placed]) - Counter(change.kind[taken])).total(),
    )
    return replace(
        told,
        design=plan.design,
        kit=plan.kit,
        planner=plan.planner,
        cells=plan.cells,
        rebuilt=report,
        margin_friction=rounded(_asked(plan)),
    )


def _what_is_stuck(tried: _Tried) -> str:
    """What can neither be placed nor taken away where an order ends too early, in words."""
    blocks, there = tried.change.blocks, tried.change.old.copy()
    for action, block, *_ in tried.found.steps:
        there[block] = action == "place"
    coming = list_ids(blocks, (k for k in tried.found.stuck if not there[k]))
    going = list_ids(blocks, (k for k in tried.found.stuck if there[k]))
    said = [f"none of {coming} can be placed"] * bool(coming)
    return " and ".join([*said, *[f"none of {going} can be taken away"] * bool(going)])


def _widths(plan: Plan) -> list[float]:
    """Widths of vertical joints for which states may be proven, the largest first [m].

    A plan tells of the widest that its own states bear, which may be more than the old structure
    does: then narrower ones will have to do.
    """
    low, high = plan.gap_range or (0.0, 0.0)
    narrower = [high / 4**k for k in range(1, 4)]
    return [high, *(width for width in narrower if width > low), *([low] if low < high else [])]


def _asked(plan: Plan) -> float:
    """The friction that margins of a plan are for: the least that was asked for. Blocks may be
    proven to stand with less."""
    assert plan.assembly is not None
    return plan.assembly.friction if plan.margin_friction is None else plan.margin_friction


def changed_over(
    old: Assembly, plan: Plan, seconds: float, gap: float
) -> tuple[Changeover, Forward, tuple[float, float]]:
    """What has to be done, the rules that prove states of it, and the friction they hold for.

    Args:
        old, plan, seconds: as of :func:`rebuild`.
        gap: width to which vertical joints may open [m].
    """
    assert plan.assembly is not None
    new = plan.assembly.finished
    _check_joints(old, new)
    blocks, goes, stays = merged(old, new)
    whole = replace(new, blocks=blocks, steps=(), joints=(), not_built=())
    overlaps = overlapping(blocks)
    faces = _apart(find_contacts(whole), overlaps)

    def every() -> Contacts:
        return _apart(add_point_contacts(whole, faces), overlaps)

    ends = plan.friction_range or (new.friction, new.friction)
    some = {ends[0], ends[1]} if ends[1] < LARGEST else {ends[0]}
    layers = contact_layers(blocks, faces, every, gap)
    problem = OrderProblem(whole, layers, tuple(sorted(some)), _asked(plan))
    site = site_of(problem, whole, problem.layers, Clock(seconds))
    change = Changeover(blocks, goes, stays, kinds_of(blocks), overlaps, lying_on(site.below))
    return change, Forward(site), (float(ends[0]), float(ends[1]))


def _apart(contacts: Contacts, overlaps: list[frozenset[int]]) -> Contacts:
    """The contacts but those of blocks that overlap, which are never there together."""
    pairs = zip(contacts.a.tolist(), contacts.b.tolist(), strict=True)
    return contacts.only(np.array([a < 0 or b not in overlaps[a] for a, b in pairs], bool))


def _check_joints(old: Assembly, new: Assembly) -> None:
    """Refuse joints that hold."""
    if old.holds or new.holds:
        both = "bricks that clutch" if old.holds and new.holds else "bricks and dry blocks"
        raise InputError("old structure", both, "dry blocks, of both structures")
    supports = [sorted(b.id for b in a.blocks if b.support) for a in (old, new)]
    if supports[0] != supports[1]:
        got = ", ".join(supports[0][:4]) or "none"
        raise InputError("old structure: supports", got, ", ".join(supports[1][:4]) or "none")


def with_copies(plan: Plan) -> Plan:
    """The plan in which a block that is taken away and comes again is another one from then on,
    alike and in the same place: for who carries it out it is any block of its kind."""
    assert plan.assembly is not None
    blocks, steps, made = [*plan.assembly.blocks], list[Step](), list[AssemblyStep]()
    names, copies, gone = {block.id for block in blocks}, dict[int, int](), set[int]()
    for step, one in zip(plan.steps, plan.assembly.steps, strict=True):
        if step.action == "place" and step.block in gone:
            block = blocks[step.block]
            name = f"{block.id}'"
            while name in names:
                name += "'"
            names.add(name)
            copies[step.block] = len(blocks)
            blocks.append(replace(block, id=name))
        if step.action == "remove":
            gone.add(step.block)
        now = copies.get(step.block, step.block)
        told = {step.action: blocks[now].id}
        steps.append(replace(step, block=now))
        made.append(replace(one, **told))
    return replace(
        plan,
        steps=tuple(steps),
        assembly=replace(plan.assembly, blocks=tuple(blocks), steps=tuple(made)),
    )


def kits_from(kit: Kit, old: Assembly) -> list[Kit]:
    """Blocks that a design may be filled with where a structure stands already: those of that
    alone, any number of its kinds, and all of the kit.

    Raises:
        InputError: for blocks that the kit has not, and for a kit whose joints are not dry.
    """
    if kit.joint.law != "dry":
        got = f"kit {kit.name} of {kit.joint.law} joints"
        raise InputError("old structure", got, "dry blocks")
    names = [kind.name for kind in kit.kinds]
    there = [block for block in old.finished.blocks if not block.support]
    for block in there:
        where = f"old structure: kind of block {block.id} (kit {kit.name})"
        check_name(where, block.kind, names)
    count = Counter(block.kind for block in there)
    own = replace(kit, kinds=tuple(replace(k, count=count[k.name]) for k in kit.kinds))
    same = replace(kit, kinds=tuple(k for k in kit.kinds if count[k.name]))
    return [own, same, kit]


def fewest_moved(old: Assembly, tried: list[Plan], seconds: float, progress: Progress) -> Plan:
    """A structure turned into whichever plan takes the fewest moves."""
    # Kits that differ often give the same blocks, of which the first plan is enough.
    some: dict[object, Plan] = {}
    for plan in [plan for plan in tried if plan.complete] or tried[-1:]:
        blocks = () if plan.assembly is None else plan.assembly.blocks
        placed = tuple((block.kind, block.vertices.tobytes()) for block in blocks)
        some.setdefault((placed, plan.gap_range), plan)
    plans = [*some.values()]
    limit = seconds / len(plans)
    found = [rebuild(old, plan, seconds=limit, progress=progress) for plan in plans]
    return min(
        found,
        key=lambda plan: (not plan.complete, 0 if plan.rebuilt is None else plan.rebuilt.moves),
    )
