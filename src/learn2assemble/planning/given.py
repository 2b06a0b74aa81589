"""Order, supports and proof for an assembly whose blocks are given where they stand."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from learn2assemble.assembly.blocks import Assembly, Block
from learn2assemble.assembly.contacts import Contacts, check_overlaps, shrunk
from learn2assemble.errors import InputError, is_whole
from learn2assemble.linear_programs import Clock
from learn2assemble.planning.brick_plan import plan_bricks
from learn2assemble.planning.given_plan import plan_of
from learn2assemble.planning.orders import (
    ContactLayer,
    OrderProblem,
    find_sequence,
    follow_steps,
)
from learn2assemble.planning.plan import Plan
from learn2assemble.planning.sequence import Sequenced, Supports, list_ids
from learn2assemble.planning.what_carries import what_would_carry
from learn2assemble.statics.proofs import BED, POINTS, TIGHT, Bounds, value_range
from learn2assemble.statics.rigid_blocks import UNCERTAIN, Joints, bed_patches, pressed_patches

MOST_HOLDS = 8
Progress = Callable[[str], None]


def plan_assembly(
    assembly: Assembly,
    *,
    friction: Bounds = None,
    gap: Bounds = None,
    supports: str | Supports = "auto",
    holds: int = 0,
    hands: bool = False,
    seconds: float = 60.0,
    progress: Progress = lambda text: None,
) -> Plan:
    """Order, supports and proof for blocks that are given where they stand.

    The order of the file is kept where it has one. Else blocks go from below
    (:mod:`.forward`); where none stands, one is held while the next one comes, or posts carry it.
    Every state is proven, on what weight presses together where that holds, else with side faces
    that press or with edges and points, and the step says which.

    Args:
        friction: Coulomb coefficient, or the range to prove every step for (at both its ends),
            instead of the assembly's.
        gap: width to which vertical joints may open, or a range of widths [m]. Above 0 side faces
            carry nothing, nor do edges and points, and every bed face is taken to be smaller by
            half of it on all sides. Without it, side faces press where the file has them touch.
        supports: ``"none"``; ``"posts"`` places posts where nothing else helps, and so does
            ``"auto"``, of at most ten blocks the fewest; or all that may help, with who builds, in
            place of the next two.
        holds: how many blocks may be held by a hand while the next one comes; a hand is preferred
            to a post.
        hands: of bricks that clutch, whether they may come from below, and several as one; a hand
            then holds one while the next one comes.
        seconds: wall-clock limit; the steps proven until then are kept. Their margins may take as
            long again, and those of the steps behind that are not computed.

    Returns:
        The plan; :attr:`~.plan.Plan.assembly` has the posts, as props, behind the given blocks.

    Raises:
        InputError: for gaps, posts or hands where joints do not take them, for blocks that overlap,
            where nothing stands on a support or the ground, for props that stand on nothing, for
            joints wider than the blocks, and for supports that are none.
    """
    started = time.perf_counter()
    help_ = supports
    if not isinstance(help_, Supports):
        help_ = supports_called(help_, holds, hands)
    if any(joint.law == "clutch" for joint in assembly.laws if joint.holds):
        if gap is not None or supports == "posts":
            got = "a gap" if gap is not None else "posts"
            raise InputError("bricks that clutch", got, "hands and holds alone to help them")
        least = max(help_.holds, 1) if help_.hands else help_.holds
        help_ = Supports(holds=least, hands=help_.hands)
        return plan_bricks(assembly, help_, Clock(seconds), progress)
    if help_.hands:
        raise InputError("hands", True, "bricks that clutch (a kit such as lego)")
    check_overlaps(assembly)
    ends = value_range(friction, assembly.friction, "friction")
    widest = value_range(gap, 0.0, "gap")[1]
    joints = Joints(assembly)
    _check_props(assembly, joints)
    layers = contact_layers(assembly.blocks, joints.faces, lambda: joints.every, widest)
    # Joints that may open are not filled.
    mortar = assembly.holds and not widest
    problem = OrderProblem(assembly, layers, tuple(sorted(set(ends))), mortar=mortar)
    clock = Clock(seconds)
    before = wanted = None
    if assembly.steps:
        found = follow_steps(problem, clock, progress)
        before = np.array(assembly.at_first)
        wanted = ~before & [not (block.support or block.prop) for block in assembly.blocks]
        if found.status == "complete" and assembly.not_built:
            names = list_ids(assembly.blocks, map(assembly.index, assembly.not_built))
            found = replace(found, status="not found", reason=f"no step places {names}")
    else:
        found = find_sequence(problem, help_, clock, progress)
        unsure = not widest and joints.decide(ends[0]).verdict == UNCERTAIN
        if found.status == "refused" and unsure:
            names = list_ids(found.blocks, found.stuck) or "some blocks"
            reason = f"that the finished structure stands is not certain: {names} may move"
            found = replace(found, status="not found", reason=reason)
        elif found.status == "refused" and not widest:
            more = what_would_carry(assembly, found.stuck, ends[0], clock)
            found = replace(found, reason="; ".join(filter(None, (found.reason, more))))
        elif found.status == "not found":
            found = _advised(found, problem, joints, help_, clock)
    gaps = None if gap is None else (0.0, widest)
    return plan_of(assembly, found, ends, gaps, started, before, wanted)


def supports_called(
    name: str, holds: int = 0, hands: bool = False, table: bool = False
) -> Supports:
    """What may help given blocks, by its name.

    Args:
        name: ``supports`` of :func:`plan_assembly`; the next two are also as there.
        table: as :attr:`.Supports.table`.

    Raises:
        InputError: for a name or a number of holds that is none.
    """
    if name not in ("auto", "none", "posts"):
        raise InputError("supports", name, "auto, none or posts: given blocks have no kit")
    if not is_whole(holds, 0, MOST_HOLDS):
        raise InputError("holds", holds, f"a whole number from 0 to {MOST_HOLDS}")
    return Supports(name != "none", holds, hands=hands, fewest=name == "auto", table=table)


def _check_props(assembly: Assembly, joints: Joints) -> None:
    """Refuse props that stand on nothing."""
    loose = {k for k, block in enumerate(assembly.blocks) if block.prop}
    for find in (lambda: joints.faces, lambda: joints.every):
        if not loose:
            return
        contacts = find()
        upper = np.where(contacts.normal[:, 2] > 0, contacts.b, contacts.a)
        loose -= set(upper[bed_patches(contacts)].tolist())
    if loose:
        names = list_ids(assembly.blocks, sorted(loose))
        raise InputError("props", f"{names} in the air", "props on the ground or on a block")


def contact_layers(
    blocks: Sequence[Block], faces: Contacts, every: Callable[[], Contacts], gap: float
) -> tuple[ContactLayer, ...]:
    """What may carry, what needs the least of the joints first.

    Args:
        faces: contacts of faces of these blocks.
        every: those of edges and points, too; not looked for where there are gaps.
        gap: width to which vertical joints may open [m].

    Raises:
        InputError: for gaps wider than a block.
    """
    if gap > 0:
        least = min(float(np.ptp(b.vertices, axis=0)[:2].min()) for b in blocks)
        if gap >= least:
            raise InputError("gap", gap, f"less than the narrowest block, {least:g} m")
        return (ContactLayer(shrunk(faces.only(bed_patches(faces)), gap / 2), BED),)
    pressed = pressed_patches(faces)
    layers = [ContactLayer(faces.only(pressed), BED)]
    layers += [] if pressed.all() else [ContactLayer(faces, TIGHT)]
    more = every()
    layers += [ContactLayer(more, POINTS)] if len(more.a) > len(faces.a) else []
    return tuple(layers)


def _advised(
    found: Sequenced, problem: OrderProblem, joints: Joints, supports: Supports, clock: Clock
) -> Sequenced:
    """What was not found, with what would help, which is tried first."""
    if not joints.decide(problem.friction[0]).result.stands:
        return found
    more = "all blocks together stand"
    if clock.left > 0:
        if not supports.posts and _completes(problem, replace(supports, posts=True), clock):
            more = "posts would help: with posts it is built"
        elif supports.holds == 0 and _completes(problem, Supports(holds=1), clock):
            more = "a hold would help: with one block held at a time it is built"
    return replace(found, reason=f"{found.reason}; {more}")


def _completes(problem: OrderProblem, supports: Supports, clock: Clock) -> bool:
    return find_sequence(problem, supports, clock).status == "complete"
