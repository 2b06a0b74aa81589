"""Whether an assembly stands whose joints hold, and how far it is from falling."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from learn2assemble.assembly.blocks import Assembly
from learn2assemble.assembly.contacts import GROUND
from learn2assemble.assembly.joints import DRY, Joint
from learn2assemble.errors import InputError
from learn2assemble.statics.holding.forces import Columns, Forces, forces_of
from learn2assemble.statics.holding.near import NearForces
from learn2assemble.statics.holding.program import Balance, Need

MANY = 1000
"""Blocks from which no one looks for the least strength they need."""
_FEW = 30
"""Blocks up to which the least strength they need takes no longer than any forces."""
_NEAR = 1e-9
"""Length that is rounding [m]."""


class JointAnswer(NamedTuple):
    """Of :func:`stands_by_joints`."""

    need: Need
    tight: bool
    """Whether faces side by side have to push."""
    balance: Balance
    forces: Forces


def stands_by_joints(assembly: Assembly, least: bool = True) -> JointAnswer:
    """Whether an assembly stands on what weight and joints press together, else with faces side by
    side that push, too.

    Args:
        least: whether the least strength is wanted with which it does; any forces take less time.
            Of more than :data:`MANY` blocks no one looks for
            it.

    Raises:
        InputError: where nothing stands on a support or the ground; see
            :func:`~learn2assemble.statics.holding.forces.forces_of`.
    """
    forces = forces_of(assembly)
    supported = any(block.support for block in assembly.blocks)
    if not supported and not (forces.contacts.a == GROUND).any():
        low = min(assembly.blocks, key=lambda block: float(block.vertices[:, 2].min()))
        where = f"block {low.id!r}: lowest point"
        expected = "a block with a face on z = 0, or a support block"
        raise InputError(where, float(low.vertices[:, 2].min()), expected)
    balance = Balance(assembly, forces)
    if balance.count > (MANY if least else _FEW):
        near = NearForces(balance, forces, thorough=False)
        found = near.need(little=least)
        if found is None and balance.count > MANY:
            found = near.need(little=True)
        if found is not None:
            return JointAnswer(found, False, balance, forces)
    need = balance.need()
    beside = Columns(*(field[~forces.upright] for field in forces.columns))
    if need.stands or not len(beside.b) or not balance.lessened_by(beside):
        return JointAnswer(need, False, balance, forces)
    tight = Balance(assembly, forces, sides=True)
    more = tight.need()
    if more.stands:
        return JointAnswer(more, True, tight, forces)
    return JointAnswer(need, False, balance, forces)


def reference(assembly: Assembly) -> Joint | None:
    """The clutch of least capacity of an assembly, in whose newtons margins are told; None where
    none of its joints clutch."""
    clutches = [joint for joint in assembly.laws if joint.law == "clutch" and joint.holds]
    return min(clutches, key=lambda joint: joint.capacity, default=None)


def without_mortar(assembly: Assembly) -> Assembly | None:
    """The same with dry joints where there is mortar that holds; None where there is none."""
    if not any(joint.law == "mortar" and joint.holds for joint in assembly.laws):
        return None

    def dry(joint: Joint) -> Joint:
        return DRY if joint.law == "mortar" else joint

    joints = tuple(replace(one, joint=dry(one.joint)) for one in assembly.joints)
    return replace(assembly, joint=dry(assembly.joint), joints=joints)


def words_of(need: Need, mortar: bool = False) -> str:
    """What an answer rests on, in words.

    Args:
        mortar: whether there is some that holds. The share is of what it pulls alone, all of its
            shear strength is there, and a joint may bear more where it cracks in part.
    """
    if need.stands:
        most = "" if need.least and not mortar else "at most "
        strength = "tensile strength" if mortar else "strength"
        return (
            f"forces balance the blocks with {most}{need.share:.1%} of the {strength} of their "
            "joints"
        )
    certain = "" if mortar else " for certain"
    if np.isfinite(need.share):
        return (
            f"forces would balance the blocks with {need.share:.4g} times the strength of their "
            f"joints: it falls{certain}"
        )
    if mortar:
        return (
            "no forces balance the blocks with the shear strength of their joints, whatever these "
            "can pull: it falls"
        )
    return "no forces balance the blocks, however strong their joints: it falls for certain"


def margin_n(share: float, joint: Joint | None) -> float | None:
    """What a contact point could pull less than it can, until the blocks fall [N]; negative where
    they do, None without clutches or where no strength would do."""
    if joint is None or not np.isfinite(share):
        return None
    return joint.capacity * (1.0 - share)


def margin_of(found: JointAnswer, joint: Joint | None) -> float | None:
    """The margin of :func:`margin_n` of an answer: the largest, but of more than
    :data:`MANY` blocks one that they have for certain."""
    need = found.need
    if not need.least and found.balance.count <= MANY:
        need = found.balance.need()
    elif not need.least:
        near = NearForces(found.balance, found.forces, thorough=False)
        need = near.need(little=True) or need
    return margin_n(need.share, joint)


def corner_forces(found: JointAnswer) -> np.ndarray:
    """float64[C, 3]: forces on block ``b`` at the corners of the contacts [N, world].

    The preload of a clutch is shared by its corners. What mortar bears inside of its patch is
    shared by the corners as stress would be that varies linearly.
    """
    contacts, columns = found.forces.contacts, found.balance.columns
    made = np.zeros_like(contacts.points)
    there = np.flatnonzero(columns.corner >= 0)
    corner, forces = columns.corner[there], (found.need.forces[:, None] * columns.force)[there]
    inside = np.linalg.norm(columns.at[there] - contacts.points[corner], axis=1) > _NEAR
    np.add.at(made, corner[~inside], forces[~inside])
    for patch in np.unique(contacts.patch[corner[inside]]).tolist():
        mine = inside & (contacts.patch[corner] == patch)
        ends = np.flatnonzero(contacts.patch == patch)
        rows, wanted = (
            np.column_stack([np.ones(len(points)), points - contacts.points[ends[0]]]).T
            for points in (contacts.points[ends], columns.at[there[mine]])
        )
        made[ends] += np.linalg.pinv(rows) @ wanted @ forces[mine]
    pulls = found.balance.preload
    shown = pulls.corner >= 0
    patch = contacts.patch[pulls.corner[shown]]
    count = np.bincount(contacts.patch, minlength=len(contacts.a))
    pull = np.zeros((len(contacts.a), 3))
    share = min(found.need.share, 1.0)
    np.add.at(pull, patch, share * pulls.force[shown] / count[patch][:, None])
    return made + pull[contacts.patch]
