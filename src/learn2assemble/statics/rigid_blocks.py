"""Whether any assembly of rigid polyhedral blocks stands, and on what that rests.

The blocks touch with dry friction (:mod:`.equilibrium`), or joints hold (:mod:`.holding.check`).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np

from learn2assemble.assembly.blocks import Assembly, check_friction
from learn2assemble.assembly.contacts import (
    GROUND,
    SIDE,
    Contacts,
    add_point_contacts,
    check_overlaps,
    contact_tolerance,
    find_contacts,
    widened,
)
from learn2assemble.errors import InputError
from learn2assemble.statics.forces.block_forces import Equilibrium, System
from learn2assemble.statics.forces.equilibrium import STIFFNESS, answer, lacking, margin, solve
from learn2assemble.statics.holding.check import (
    corner_forces,
    margin_of,
    reference,
    stands_by_joints,
    without_mortar,
    words_of,
)

Verdict = Literal["stands", "stands only with tight joints", "falls", "not certain"]
STANDS: Verdict = "stands"
TIGHT: Verdict = "stands only with tight joints"
FALLS: Verdict = "falls"
UNCERTAIN: Verdict = "not certain"

LEVEL = 0.995
"""It leans, neither vertical nor level, when that part is less than this (6 degrees)."""
NO_MARGIN = 1e-4
"""Sideways acceleration [g] below which there is none to speak of."""
_STEEP = 0.1
"""Of a force, the least angle with the plane of a joint at which a fall may be proven [rad]."""


class Falling(NamedTuple):
    """What blocks lack that fall."""

    force: float
    """Of forces and moments, in all [N]; 0 where they stand: see :attr:`Check.holding_force`."""
    moving: tuple[str, ...]
    """Ids of the blocks that move first."""


NOTHING = Falling(0.0, ())


class Asked(NamedTuple):
    """How a check finds what takes longer than its verdict; each is called once, when it is asked
    for."""

    margin_g: Callable[[], float]
    falling: Callable[[], Falling]
    proof: Callable[[float], str]
    """Given the margin [g]."""
    margin_n: Callable[[], float | None] = lambda: None


@dataclass(frozen=True, eq=False, repr=False)
class Check:
    """The answer of :func:`check`.

    Margins, what blocks lack that fall, and the words of the proof are computed when they are
    asked for.

    Attributes:
        verdict: ``stands`` on what weight presses together (:func:`pressed_patches`), ``stands
            only with tight joints`` where side faces have to press, too, ``falls``, or ``not
            certain`` where it rests on edges or points and whether it falls depends on where
            exactly these lie.
        blocks: how many there are, supports included.
        contacts: all patches; where it ``stands``, those of :func:`pressed_patches` carry.
        forces: float64[C, 3], at the corners of ``contacts`` on block ``b`` [N, world].
        method: what decided; see :class:`Equilibrium`.
        seconds: the verdict took.
        asked: finds the rest.
    """

    verdict: Verdict
    blocks: int
    contacts: Contacts
    forces: np.ndarray
    method: str
    seconds: float
    asked: Asked

    def __repr__(self) -> str:
        """Without arrays; with the margin where it has been asked for."""
        known = f", margin {self.margin_g:.3f} g" if "margin_g" in vars(self) else ""
        return (
            f"<Check: {self.verdict}, {self.blocks} blocks, {len(self.contacts.a)} contacts, "
            f"{self.method}{known}, {self.seconds:.2f} s>"
        )

    @cached_property
    def margin_g(self) -> float:
        """Sideways acceleration [g] it withstands in every direction; 0 where it falls."""
        return self.asked.margin_g()

    @cached_property
    def margin_n(self) -> float | None:
        """Of joints that clutch, what a contact point can pull more than it needs to [N]; negative
        where it falls for that, None where joints do not clutch or none would do."""
        return self.asked.margin_n()

    @cached_property
    def _falling(self) -> Falling:
        return self.asked.falling()

    @property
    def holding_force(self) -> float:
        """Measure of what is lacking where it falls, 0 where it stands [N]: the least sum over all
        blocks of the force and moment over a length that would have to be added. It is no force
        that one could apply: a single one that holds it may be less or more."""
        return self._falling.force

    @property
    def moving(self) -> tuple[str, ...]:
        """Ids of the blocks that move first; empty where it stands."""
        return self._falling.moving

    @cached_property
    def proof(self) -> str:
        """What was shown, and what was not, in one line.

        A fixed point is forces that balance and obey Coulomb's law to ``SLIP`` and ``HELD``; where
        friction is needed other forces may be possible, too, and other programs find none (Kao et
        al. 2022 solve a nonlinear one). That none was found is no proof of a fall; that RBE has no
        forces is.
        """
        return self.asked.proof(self.margin_g)

    @property
    def tilt(self) -> float:
        """Inclination of the ground it withstands in every direction [deg]."""
        return float(np.degrees(np.arctan(self.margin_g)))


def check(
    assembly: Assembly, *, friction: float | None = None, tolerance: float | None = None
) -> Check:
    """Whether what stands after the last step of an assembly stands.

    Args:
        assembly: blocks, steps and friction.
        friction: Coulomb coefficient instead of the assembly's.
        tolerance: gap that counts as contact [m]; see
            :func:`~learn2assemble.assembly.contacts.find_contacts`.

    Raises:
        InputError: for what is no assembly, blocks that overlap, or where nothing stands on a
            support or the ground.
    """
    if not isinstance(assembly, Assembly):  # pyright: ignore[reportUnnecessaryIsInstance]
        raise InputError("assembly", assembly, "an Assembly, which read_assembly reads from files")
    started = time.perf_counter()
    friction = assembly.friction if friction is None else friction
    check_friction(friction)
    standing = assembly.finished
    if standing.holds:
        found = _check_holding(replace(standing, friction=friction), started)
        dry = without_mortar(standing)
        if found.verdict != FALLS or dry is None:
            return found
        # Mortar that cracks may still stand dry.
        cracked = check(dry, friction=friction, tolerance=tolerance)
        return found if cracked.verdict == FALLS else cracked
    check_overlaps(standing, tolerance)
    joints = Joints(standing, tolerance)
    result, contacts, keep, verdict = joints.decide(friction)
    forces = np.zeros_like(contacts.points)
    forces[keep[contacts.patch]] = result.forces
    first: list[int] = result.moving.tolist()
    moving = tuple(standing.blocks[k].id for k in first)

    def proof(margin_g: float) -> str:
        return _shown(result, margin_g, verdict)

    asked = Asked(
        lambda: margin(standing, contacts.only(keep), friction) if result.stands else 0.0,
        lambda: Falling(result.holding_force, moving),
        proof,
    )
    seconds = time.perf_counter() - started
    return Check(verdict, len(standing.blocks), contacts, forces, result.method, seconds, asked)


def _check_holding(standing: Assembly, started: float) -> Check:
    """The answer for blocks whose joints hold."""
    found = stands_by_joints(standing, least=False)
    stands = found.need.stands

    def falling() -> Falling:
        holds = found.balance.holding()
        return Falling(holds.force, tuple(standing.blocks[k].id for k in holds.moving))

    def proof(_: float) -> str:
        return words_of(found.need, without_mortar(standing) is not None)

    asked = Asked(
        lambda: found.balance.margin_g() if stands else 0.0,
        lambda: NOTHING if stands else falling(),
        proof,
        lambda: margin_of(found, reference(standing)),
    )
    return Check(
        FALLS if not stands else TIGHT if found.tight else STANDS,
        len(standing.blocks),
        found.forces.contacts,
        corner_forces(found),
        "preload",
        time.perf_counter() - started,
        asked,
    )


class Decision(NamedTuple):
    """Whether blocks stand, and on which patches."""

    result: Equilibrium
    contacts: Contacts
    """All that were looked at."""
    keep: np.ndarray
    """bool[P]: those that carry, or that do not suffice."""
    verdict: Verdict


class Joints:
    """The contacts of an assembly: of faces and, where these do not carry, of edges and points.

    Args:
        assembly: blocks where they stand.
        tolerance: as of :func:`check`.

    Raises:
        InputError: where nothing stands on a support or the ground.
    """

    def __init__(self, assembly: Assembly, tolerance: float | None = None) -> None:
        self.assembly = assembly
        self.tolerance = tolerance
        self.faces: Contacts = find_contacts(assembly, tolerance)
        self.support: np.ndarray = np.array([block.support for block in assembly.blocks])
        touched = self.support[self.faces.a] != self.support[self.faces.b]
        self.supported: bool = bool((touched | (self.faces.a < 0)).any() or self.support.all())
        _check_supported(assembly, self.faces if self.supported else self.every)

    @cached_property
    def every(self) -> Contacts:
        """All contacts, those of faces first."""
        return add_point_contacts(self.assembly, self.faces, self.tolerance)

    def decide(self, friction: float, present: np.ndarray | None = None) -> Decision:
        """Whether the blocks stand, or those of them that are ``present`` (bool[B])."""
        found = self._on(self.faces, friction, present)
        if self.supported and found.result.stands:
            return found
        # Edges and points are looked at only where faces do not carry: what these hold stands.
        every = self.every
        if self.supported and len(every.a) == len(self.faces.a):
            return found
        found = self._on(every.known(friction), friction, present)
        certain = found.result.stands or self._falls_anyhow(every, friction, present)
        return found if certain else found._replace(verdict=UNCERTAIN)

    def _on(self, contacts: Contacts, friction: float, present: np.ndarray | None) -> Decision:
        """The answer on the patches that weight presses where these carry, else on all."""
        keep = pressed_patches(contacts, present)
        system = System(self.assembly, contacts.only(keep), present)
        found = answer(system, friction)
        if keep.all():
            result = found if isinstance(found, Equilibrium) else lacking(system, friction, found)
            return Decision(result, contacts, keep, STANDS if result.stands else FALLS)
        if isinstance(found, Equilibrium) and found.stands:
            return Decision(found, contacts, keep, STANDS)
        result = solve(self.assembly, contacts, friction, present=present)
        return Decision(result, contacts, np.ones_like(keep), TIGHT if result.stands else FALLS)

    def _falls_anyhow(
        self, contacts: Contacts, friction: float, present: np.ndarray | None
    ) -> bool:
        """Whether no forces hold it wherever within the tolerance its points of contact lie, and
        along whatever direction that may be theirs they push."""
        if present is not None:
            contacts = contacts.only(present[contacts.b] & ((contacts.a < 0) | present[contacts.a]))
        if (np.arctan(friction) + contacts.spread).max(initial=0.0) >= np.pi / 2 - _STEEP:
            return False  # They may push in any direction.
        reach = self.tolerance or float(contact_tolerance(self.assembly.blocks).max())
        wide = widened(contacts, 2 * reach)
        found = solve(self.assembly, wide, friction, present=present, coupled=False)
        return not found.stands


def _shown(result: Equilibrium, margin_g: float, verdict: Verdict) -> str:
    """What an answer rests on, in words."""
    if verdict == UNCERTAIN:
        return (
            "no contact forces were found, but blocks rest on edges or points, and where these "
            "push, and which way, is known to the tolerance only: neither standing nor falling is "
            "proven"
        )
    if not result.stands:
        return {
            "rbe": "no contact forces balance the blocks: it falls for certain",
            "cra": "contact forces could balance the blocks, but none with elastic joints and "
            "Coulomb friction were found: a fall is likely, not proven",
        }[result.method]
    text = "forces balance the blocks without friction, so with any coefficient"
    if result.method == "cra":
        text = "forces balance the blocks with elastic joints and Coulomb friction"
        if result.stiffness != STIFFNESS[0]:
            text += f", if joints are {result.stiffness:g} times as stiff along as across"
    return text if margin_g >= NO_MARGIN else f"{text}; balanced on an edge, without a margin"


def bed_patches(contacts: Contacts) -> np.ndarray:
    """bool[P]: patches that are not vertical, so that they press however wide vertical gaps are."""
    return np.abs(contacts.normal[:, 2]) > SIDE


def pressed_patches(contacts: Contacts, present: np.ndarray | None = None) -> np.ndarray:
    """bool[P]: patches that weight presses together, without tight joints.

    These are all that are not vertical, and vertical ones between blocks that lean on others, too,
    as at the crown of an arch: such blocks are wedges, and sink until their joints press. So does a
    block that rests on an edge or a point and on no face: it turns until it leans on something.

    Args:
        contacts: of an assembly.
        present: bool[B], the blocks that are there; all by default.
    """
    upright = np.abs(contacts.normal[:, 2])
    leaning = (upright > SIDE) & (upright < LEVEL) & (contacts.a >= 0)
    if present is not None:
        leaning &= present[contacts.b] & present[np.maximum(contacts.a, 0)]
    wedges = np.concatenate([contacts.a[leaning], contacts.b[leaning]])
    pressed = (upright > SIDE) | (np.isin(contacts.a, wedges) & np.isin(contacts.b, wedges))
    flat = contacts.area > 0
    if flat.all():
        return pressed
    on_edges, on_faces = (
        np.concatenate([contacts.a[bed], contacts.b[bed]])
        for bed in ((upright > SIDE) & ~flat, (upright > SIDE) & flat)
    )
    turning = np.setdiff1d(on_edges, np.append(on_faces, GROUND))
    return pressed | (~flat & (np.isin(contacts.a, turning) | np.isin(contacts.b, turning)))


def _check_supported(assembly: Assembly, contacts: Contacts) -> None:
    """Refuse an assembly that has nothing to stand on, or that reaches below the ground."""
    fixed = np.array([block.support for block in assembly.blocks])
    if fixed.any():
        if not (fixed.all() or (fixed[contacts.a] != fixed[contacts.b]).any()):
            first = assembly.blocks[int(np.argmax(fixed))].id
            expected = "a block that touches one; with supports, the plane z = 0 is no ground"
            raise InputError(f"support {first!r}", "no support that a block touches", expected)
        return
    lows = [float(block.vertices[:, 2].min()) for block in assembly.blocks]
    lowest = assembly.blocks[int(np.argmin(lows))]
    reaches_below = min(lows) < -0.01 * float(np.ptp(lowest.vertices[:, 2]))
    if reaches_below or not (contacts.a < 0).any():
        where = f"block {lowest.id!r}: lowest point"
        raise InputError(where, min(lows), "a block with a face on z = 0, or a support block")
