"""How the joints between blocks hold: dry, by clutch (studs of toy bricks), or by mortar.

A law is data of a kit (its table ``[joint]``) and of an assembly. What it means in a balance of
forces is :mod:`learn2assemble.statics.holding.program`.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any, Literal

from learn2assemble.errors import InputError, check_name, is_number
from learn2assemble.values import check_keys, from_plain, mapping, sequence, text

Law = Literal["dry", "clutch", "mortar"]
Base = Literal["grips", "table"]
LAWS: tuple[Law, ...] = ("dry", "clutch", "mortar")
BASES: tuple[Base, ...] = ("grips", "table")
MOST_CAPACITY, MOST_PRESS, MOST_STRENGTH, MOST_AGE = 1e3, 1e4, 1e9, 1e6
"""Largest pull of a contact point and press [N], strength [Pa] and age [h]."""


@dataclass(frozen=True)
class Joint:
    """The law of a joint.

    Args:
        law: ``"dry"``: it pushes, with friction; ``"clutch"``: studs, whose contact points also
            pull; ``"mortar"``: it also pulls and shears, over its whole patch.
        capacity: of a clutch, the largest pull of one contact point [N].
        base: whether the ground under a clutch has studs (``"grips"``) or is a ``"table"``.
        press: of a clutch, the force with which a block is pressed home [N].
        pitch: of a clutch, the distance of studs and the height of a layer [m].
        tensile: of mortar, tensile strength [Pa]; it counts up to ``shear`` over the coefficient
            of friction.
        shear: of mortar, shear strength without load [Pa].
        age: of mortar, the age at which it holds [h]; until then the joint is dry.

    Raises:
        InputError: for laws that are unknown, and numbers that are none, negative or absurd.
    """

    law: Law = "dry"
    capacity: float = 0.70
    base: Base = "grips"
    press: float = 10.0
    pitch: tuple[float, float] = (0.008, 0.0032)
    tensile: float = 0.0
    shear: float = 0.0
    age: float = 0.0

    def __post_init__(self) -> None:
        check_name("joint.law", self.law, LAWS)
        check_name("joint.base", self.base, BASES)
        for name, most, unit in (
            ("capacity", MOST_CAPACITY, "N"),
            ("press", MOST_PRESS, "N"),
            ("tensile", MOST_STRENGTH, "Pa"),
            ("shear", MOST_STRENGTH, "Pa"),
            ("age", MOST_AGE, "h"),
        ):
            if not is_number(getattr(self, name), 0.0, most):
                raise InputError(f"joint.{name}", getattr(self, name), f"0 to {most:g} {unit}")
        if len(self.pitch) != 2 or not all(is_number(one, 1e-4, 10.0) for one in self.pitch):
            raise InputError("joint.pitch", self.pitch, "two lengths from 0.0001 to 10 m")

    @property
    def holds(self) -> bool:
        """Whether it can pull, or bear more along itself than friction; else it is dry."""
        if self.law == "mortar":
            return max(self.tensile, self.shear) > 0
        return self.law == "clutch" and self.capacity > 0

    @property
    def studs(self) -> float:
        """Distance of the studs by which it clutches [m]; 0: it does not."""
        return self.pitch[0] if self.law == "clutch" and self.holds else 0.0


DRY = Joint()
_OF_LAW = {
    "dry": (),
    "clutch": ("capacity", "base", "press", "pitch"),
    "mortar": ("tensile", "shear", "age"),
}
"""Keys that mean something for a law."""


@dataclass(frozen=True)
class JointOf:
    """A law that only some joints of an assembly have: those of a kind of blocks, or of two blocks.

    Args:
        joint: the law.
        kind: kind of the blocks; a joint has the law where both its blocks are of it.
        blocks: ids of two blocks.
    """

    joint: Joint
    kind: str = ""
    blocks: tuple[str, str] | None = None


def joint_to_json(joint: Joint) -> dict[str, Any]:
    """The law as an object of a file; what does not matter for it is left out."""
    found: dict[str, Any] = {"law": joint.law}
    for name in _OF_LAW[joint.law]:
        value: Any = getattr(joint, name)
        given: object = value
        found[name] = list(value) if type(given) is tuple else value
    return found


def joint_of_json(value: Any, where: str, **defaults: Any) -> Joint:
    """The law of a table of a file.

    Args:
        value: what the file has.
        where: what messages call it.
        defaults: values of fields that it does not give.

    Raises:
        InputError: for keys that are unknown or of another law, and values that are out of range.
    """
    given = mapping(value, where)
    law = text(given.get("law", "dry"), f"{where}.law")
    check_name(f"{where}.law", law, LAWS)
    check_keys(given, where, "", ("law", *_OF_LAW[law]), ())
    given = {**{k: v for k, v in defaults.items() if k in _OF_LAW[law]}, **given}
    source, _, path = where.rpartition(": ")
    try:
        return from_plain(Joint, given, source, path)
    except InputError as error:
        what = re.sub(r"^joint(?=\.\w+$)", lambda _: where, error.what)
        raise InputError(what, error.got, error.expected) from None


def joints_of_json(rows: Any, where: str) -> tuple[JointOf, ...]:
    """The laws of single joints, see :class:`JointOf`."""
    made = list[JointOf]()
    for number, row in enumerate(sequence(rows, where, "a list of laws of joints")):
        at = f"{where}[{number}]"
        given = dict(mapping(row, at))
        kind, pair = given.pop("kind", ""), given.pop("blocks", None)
        listed: object = pair
        named = isinstance(listed, list) and len(pair) == 2 and all(type(p) is str for p in pair)
        if not (named if kind == "" else type(kind) is str and pair is None):
            raise InputError(at, sorted(mapping(row, at)), "a 'kind', or 'blocks' with two ids")
        joint = joint_of_json(given, at)
        made.append(JointOf(joint, kind, (pair[0], pair[1]) if named and pair else None))
    return tuple(made)


def joints_to_json(joints: tuple[JointOf, ...]) -> list[dict[str, Any]]:
    """The reverse of :func:`joints_of_json`."""
    return [
        {
            **({"kind": one.kind} if one.kind else {"blocks": list(one.blocks or ())}),
            **joint_to_json(one.joint),
        }
        for one in joints
    ]
