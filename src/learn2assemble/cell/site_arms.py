"""The arms of a layout that has several: their names, tools, bases and magazines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from learn2assemble.errors import InputError, check_name
from learn2assemble.robot.registry import ARMS, TOOLS
from learn2assemble.values import check_keys, integer, mapping, number, sequence, text

MOST_ARMS = 2
"""That one plan is for: more than one that places and one that holds are proven by nothing here."""
_KEYS = ("name", "arm", "tool", "base", "magazines")
Base = tuple[float, float, float, float]
"""x, y, z [m] and the direction the arm faces [rad from x]."""


class SiteArm(NamedTuple):
    """One of several arms of a cell; what is not given is chosen."""

    name: str
    """As steps call it."""
    arm: str
    """A registered arm."""
    tool: str | None = None
    base: Base | None = None
    magazines: tuple[int, ...] | None = None
    """Numbers of the magazines of the layout that it takes from; by default those it reaches."""


def parse_arms(value: Any, source: str, magazines: int) -> tuple[SiteArm, ...]:
    """The entries ``arms`` of a layout.

    Args:
        source: the file, and where in it they are.
        magazines: how many the layout has.

    Raises:
        InputError: for too many, for names that are there twice, and for bad values.
    """
    expected = f"a list of 1 to {MOST_ARMS} arms"
    entries = sequence(value, source, expected)
    if not 1 <= len(entries) <= MOST_ARMS:
        raise InputError(source, f"{len(entries)} arms", expected)
    found: list[SiteArm] = []
    for k, entry in enumerate(entries):
        where = f"{source}[{k}]"
        given = mapping(entry, where)
        check_keys(given, where, "", _KEYS, ("arm",))
        arm = text(given["arm"], f"{where}.arm")
        check_name(f"{where}.arm", arm, ARMS)
        name = text(given.get("name", arm), f"{where}.name")
        if name in {other.name for other in found}:
            raise InputError(f"{where}.name", name, "a name that no other arm of the layout has")
        tool = None if given.get("tool") is None else text(given["tool"], f"{where}.tool")
        if tool is not None:
            check_name(f"{where}.tool", tool, TOOLS)
        some = _magazines(given, where, magazines)
        found.append(SiteArm(name, arm, tool, _base(given, where), some))
    return tuple(found)


def _base(given: Mapping[str, Any], where: str) -> Base | None:
    if "base" not in given:
        return None
    base = mapping(given["base"], f"{where}.base")
    check_keys(base, f"{where}.base", "", ("position", "yaw"), ("position",))
    expected = "[x, y, z] in metres, each up to 100"
    at = sequence(base["position"], f"{where}.base.position", expected)
    found = [number(v, f"{where}.base.position") for v in at]
    if len(found) != 3 or max(map(abs, found)) > 100:
        raise InputError(f"{where}.base.position", base["position"], expected)
    x, y, z = found
    return x, y, z, number(base.get("yaw", 0.0), f"{where}.base.yaw")


def _magazines(given: Mapping[str, Any], where: str, count: int) -> tuple[int, ...] | None:
    if "magazines" not in given:
        return None
    expected = f"numbers of magazines of the layout, 0 to {count - 1}" if count else "none given"
    some = sequence(given["magazines"], f"{where}.magazines", expected)
    found = tuple(integer(n, f"{where}.magazines[{k}]") for k, n in enumerate(some))
    if any(not 0 <= n < count for n in found):
        raise InputError(f"{where}.magazines", list(found), expected)
    return found


def share_magazines(
    arms: Sequence[SiteArm],
    reached: Sequence[set[int]],
    kinds: Sequence[str],
    far: Sequence[Sequence[float]],
    source: str,
) -> list[set[int]]:
    """Which magazines each of two arms takes from: those that it alone reaches or is said to take
    from; of the rest the nearer ones, but where both have none else of a kind and there are two,
    each gets one.

    Args:
        reached: numbers of the magazines that each reaches, or is said to take from.
        kinds: of every magazine.
        far: by magazine, from each arm [m].
        source: the file.

    Raises:
        InputError: for a magazine that two are said to take from.
    """
    own, told = [set(some) for some in reached], [set(one.magazines or ()) for one in arms]
    if twice := told[0] & told[1]:
        got = f"{min(twice)} of {arms[0].name} and of {arms[1].name}"
        raise InputError(f"{source}: arms[].magazines", got, "each magazine of one arm")
    own = [own[0] - told[1], own[1] - told[0]]
    for kind in sorted({*kinds}):
        of_kind = {n for n, one in enumerate(kinds) if one == kind}
        both = sorted(own[0] & own[1] & of_kind, key=lambda n: (far[n][0] - far[n][1], n))
        least, most = (int(not some & of_kind - {*both}) for some in own)
        count = sum(far[n][0] <= far[n][1] for n in both)
        if least <= len(both) - most:
            count = min(max(count, least), len(both) - most)
        own = [own[0] - {*both[count:]}, own[1] - {*both[:count]}]
    return own


def named_arms(names: Sequence[str], tool: str | None, known: Sequence[SiteArm]) -> list[SiteArm]:
    """The arms that are asked for by name.

    Args:
        names: of arms of the layout where that has any, else of registered arms; one that is named
            twice is called ``panda-1`` and ``panda-2``.
        tool: of arms that have none of their own.
        known: arms of the layout.

    Raises:
        InputError: for unknown names, the same arm of a layout twice, and too many.
    """
    if len(names) > MOST_ARMS:
        raise InputError("arm", f"{len(names)} arms", f"{MOST_ARMS} at most, for a proof")
    if not known:
        for name in names:
            check_name("arm", name, ARMS)
        several = {name for name in names if list(names).count(name) > 1}
        return [
            SiteArm(f"{name}-{k + 1}" if name in several else name, name, tool)
            for k, name in enumerate(names)
        ]
    table = {one.name: one for one in known}
    for name in names:
        check_name("arm", name, table)
    if len(set(names)) < len(names):
        raise InputError("arm", ", ".join(names), "each arm of the layout once")
    return [table[name]._replace(tool=table[name].tool or tool) for name in names]
