"""What of a structure an arm reaches from where.

A place counts as reached when the inverse kinematics has a way down to it from above everything
that stands by then, on one branch of solutions. Whether links touch anything on the way is for
:mod:`.workcell`, which looks at every step.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from learn2assemble.cell.magazines import gone, supplied, takes_away
from learn2assemble.cell.pieces import (
    QUARTER,
    Piece,
    Turn,
    middle_of,
    pieces_of,
    turn_key,
    ways_to_rest,
    with_rests,
)
from learn2assemble.cell.site import Site, Source, given_sources
from learn2assemble.cell.workcell import Job, Progress
from learn2assemble.errors import InputError, listed
from learn2assemble.geometry.rotations import quaternion_matrix
from learn2assemble.kinematics.approach import ApproachCache
from learn2assemble.kinematics.chain import forward, get_chain
from learn2assemble.kinematics.inverse import RESTARTS, solve
from learn2assemble.progress import counted, silent
from learn2assemble.robot.arm import Arm, get_arm
from learn2assemble.robot.bodies import Shape
from learn2assemble.robot.holding import attitude, no_faces, ways_to_turn, why_not_held
from learn2assemble.robot.moves import (
    CLEARANCE,
    FINE_LEVEL,
)
from learn2assemble.robot.registry import ARMS, TOOLS
from learn2assemble.values import rounded

if TYPE_CHECKING:
    from learn2assemble.assembly.blocks import Assembly
    from learn2assemble.planning.plan import Plan

Base = tuple[float, float, float, float]
"""x, y, z [m] and the direction the arm faces [rad from x]."""
NEAREST = 0.22
"""Of a base from the edge of a structure [m]."""
DISTANCES = (0.5, 0.45, 0.55, 0.4, 0.6, 0.35, 0.65, 0.3, 0.7, 0.75)
HEIGHTS = (0.0, 0.2, 0.4)
"""Of bases that are tried [m], the preferred ones first."""
LOW = 0.25
"""Structures lower than this need no raised base [m]."""


def place_arm(name: str, tool: str, base: Base | None = None) -> Arm:
    """An arm whose base stands somewhere and faces some way; by default where its file says."""
    if base is None:
        return get_arm(name, tool)
    x, y, z, facing = base
    return get_arm(name, tool, (x, y, z, get_arm(name).base_yaw + facing))


@dataclass(frozen=True)
class Reach:
    """What an arm reaches of a structure from one base."""

    base: Base
    out: dict[int, str]
    """By piece, why it is out of reach."""
    count: int
    """How many pieces there are."""

    @property
    def words(self) -> str:
        """Where the base stands, in words."""
        x, y, z = (f"{rounded(value, 2):.2f}" for value in self.base[:3])
        facing = rounded(math.degrees(self.base[3]), 0)
        return f"[{x}, {y}, {z}] m facing {facing:.0f} degrees"


def reach_from(
    arm: Arm, base: Base, pieces: Sequence[Piece], which: Sequence[int] | None = None
) -> Reach:
    """What is out of reach.

    Args:
        arm: at its base.
        base: the same, for the report.
        pieces: of the structure.
        which: pieces to look at; by default all.
    """
    cache = ApproachCache(arm)
    out: dict[int, str] = {}
    for k in range(len(pieces)) if which is None else which:
        piece = pieces[k]
        why = way_down(cache, piece, piece.pose, piece.top)
        if why is not None:
            out[k] = why
    return Reach(base, out, len(pieces))


def way_down(cache: ApproachCache, piece: Piece, pose: np.ndarray, top: float) -> str | None:
    """Why the tool has no way down to a block; None where it has one.

    Args:
        cache: of the arm.
        piece: the block.
        pose: float64[7] at which it is.
        top: of what it has to be carried over [m].
    """
    arm, why = cache.arm, ""
    turn = quaternion_matrix(pose[3:])
    low = float(piece.corners(pose)[:, 2].min())
    for way in ways_to_turn(arm, piece.shape, quaternion_matrix(piece.waits[3:]), [turn]):
        centre = np.array(piece.shape[way.hold.part].centre)
        place = attitude(way.hold, centre, way.goal, way.place)
        where = pose[:3] + way.goal @ centre
        rise = float(place.tool_point(where)[2]) - low
        height = FINE_LEVEL * math.ceil((top + CLEARANCE + rise) / FINE_LEVEL - 1e-9)
        for angle in (0.0, *arm.turns):
            found = cache.solve(where, place.spun(angle), height)
            if not isinstance(found, str):
                return None
            why = why or found
    return why or "the tool cannot hold it"


def check_reached(arm: Arm, given: Sequence[Source], pieces: Sequence[Piece], top: float) -> None:
    """Refuse places of a layout that are out of reach.

    Raises:
        InputError: naming the first one.
    """
    cache = ApproachCache(arm)
    for source in given:
        seen: set[Turn] = set()
        for piece in pieces:
            if not source.presents(piece) or turn_key(piece.rest) in seen:
                continue
            seen.add(turn_key(piece.rest))
            why = way_down(cache, piece, piece.waiting(source.pose), top)
            if why is not None:
                at = [round(v, 4) for v in source.pose]
                raise InputError(source.name, at, f"a place {arm.name} can reach ({why})")


def extreme(pieces: Sequence[Piece]) -> list[int]:
    """Pieces that decide: those of every level that lie farthest out, in eight directions."""
    levels = np.array([round(float(p.target[2]), 4) for p in pieces])
    where = np.array([p.target[:2] for p in pieces])
    found: set[int] = set()
    for level in np.unique(levels):
        here = np.flatnonzero(levels == level)
        for k in range(8):
            way = np.array([math.cos(k * math.pi / 4), math.sin(k * math.pi / 4)])
            found.add(int(here[np.argmax(where[here] @ way)]))
    return sorted(found)


def bases(pieces: Sequence[Piece], distances: Sequence[float] = DISTANCES) -> Iterator[Base]:
    """Bases to try, the preferred ones first: before the long side, then before the short one.

    Args:
        distances: from the middle [m].
    """
    middle = middle_of(pieces)
    half = np.max([np.abs(end[:2] - middle) for piece in pieces for end in piece.extent], axis=0)
    long = QUARTER if half[0] > half[1] + 0.02 else 0.0
    top = max(p.top for p in pieces)
    for height in HEIGHTS if top > LOW else HEIGHTS[:1]:
        for facing in (long, QUARTER - long):
            depth = half[1] if facing else half[0]
            for distance in distances:
                if distance - depth >= NEAREST:
                    way = np.array([math.cos(facing), math.sin(facing)])
                    x, y = (middle - distance * way).tolist()
                    yield round(x, 4) + 0.0, round(y, 4) + 0.0, height, facing


def nowhere(pieces: Sequence[Piece]) -> Base:
    """Where an arm is said to stand that has no room anywhere."""
    x, y = middle_of(pieces).tolist()
    return x - DISTANCES[0], y, 0.0, 0.0


def suggest(name: str, tool: str, pieces: Sequence[Piece]) -> Reach:
    """The base from which most of a structure is in reach."""
    key, best = extreme(pieces), None
    for base in bases(pieces):
        found = reach_from(place_arm(name, tool, base), base, pieces, key)
        if best is None or len(found.out) < len(best.out):
            best = found
        if not found.out:
            break
    return _whole(name, tool, pieces, best)


def _whole(name: str, tool: str, pieces: Sequence[Piece], best: Reach | None) -> Reach:
    """The same of all pieces, after the decisive ones."""
    base = nowhere(pieces) if best is None else best.base
    return reach_from(place_arm(name, tool, base), base, pieces)


@dataclass(frozen=True, eq=False)
class ReachReport:
    """What of a design an arm reaches."""

    arm: str
    tool: str
    assembly: Assembly
    """The blocks; :attr:`Reach.out` refers to them by index."""
    here: Reach
    """From the base that was asked about, else from the best one."""
    best: Reach
    """From the base that reaches most."""

    @property
    def complete(self) -> bool:
        """Whether everything is within reach."""
        return not self.here.out


def report_reach(
    plan: Plan, arm: str, tool: str = "suction", site: Site | None = None
) -> ReachReport:
    """What an arm reaches of the blocks of a plan, and from where it reaches most.

    Args:
        plan: with an assembly.
        site: with the base that is asked about, if any.

    Raises:
        InputError: for a plan without blocks, and for blocks the tool cannot hold.
    """
    if plan.assembly is None:
        raise InputError("design", plan.reason or "no blocks", "a design that blocks fill")
    blocks = tuple(block for block in plan.assembly.blocks if not block.support)
    own = replace(plan.assembly, blocks=blocks, steps=(), not_built=())
    pieces = with_rests(pieces_of(own), get_arm(arm, tool))
    check_held(get_arm(arm, tool), pieces, plan.assembly.joint.studs)
    best = here = suggest(arm, tool, pieces)
    if site is not None and site.base is not None:
        here = reach_from(place_arm(arm, tool, site.base), site.base, pieces)
    return ReachReport(arm, tool, own, here, best)


def check_tool(arm: Arm, studs: float) -> None:
    """Refuse a tool that is none for blocks with studs so far apart [m], or without (0).

    Raises:
        InputError: naming the tools that are.
    """
    if arm.fits(studs):
        return
    cup = arm.suction is not None and not arm.suction.studs
    why = "a cup does not hold on studs" if cup else "blocks have no studs"
    if studs and not cup:
        why = f"studs are {1e3 * studs:g} mm apart"
    names = [name for name, one in with_other_tools(arm, studs).items() if one.fits(studs)]
    raise InputError("tool", arm.tool_name, f"{' or '.join(names) or 'another arm'}: {why}")


def check_held(arm: Arm, pieces: Sequence[Piece], studs: float = 0.0) -> None:
    """Refuse blocks that the tool cannot hold at any face.

    Args:
        studs: of the blocks, how far apart they are [m]; 0: they have none.

    Raises:
        InputError: naming them, by reason, and a tool that holds all of them.
    """
    check_tool(arm, studs)
    names = _not_held(arm, pieces)
    if not names:
        return
    words = [f"{listed(blocks)}: {why}" for why, blocks in names.items()]
    more = f" (and {len(words) - 6} more reasons)" if len(words) > 6 else ""
    others = with_other_tools(arm, studs)
    # Another tool turns blocks from where they wait in other ways.
    holds = (name for name, one in others.items() if not _not_held(one, with_rests(pieces, one)))
    other = next(holds, None)
    helps = f"`tool={other}` holds all of them" if other else "no other tool holds all of them"
    if not other and (arms := [name for name in ARMS if _holds_all(name, arm, pieces)]):
        helps = f"`arm={arms[0]}` holds all of them with `tool={arm.tool_name}`"
    raise InputError(
        f"tool {arm.tool_name}", "; ".join(words[:6]) + more, f"blocks it can hold; {helps}"
    )


def _holds_all(name: str, arm: Arm, pieces: Sequence[Piece]) -> bool:
    """Whether another arm, with the tool of this one, holds all blocks."""
    with suppress(InputError):  # It may not have such a tool.
        one = get_arm(name, arm.tool_name)
        return name != arm.name and not _not_held(one, with_rests(pieces, one))
    return False


def with_other_tools(arm: Arm, studs: float) -> dict[str, Arm]:
    """The arm, where its file says, with every other tool that it can have, by its name; for a cup
    other cups come first, which come to a block alike.

    Args:
        studs: of the blocks that it shall hold, how far apart they are [m]; 0: they have none.
    """
    found: dict[str, Arm] = {}
    for tool in TOOLS:
        with suppress(InputError):  # It has no fingers.
            found[tool] = get_arm(arm.name, tool)
    others = [
        name for name, one in found.items() if one.tool_name != arm.tool_name and one.fits(studs)
    ]
    others.sort(key=lambda name: (found[name].suction is None) != (arm.suction is None))
    return {name: found[name] for name in others}


def _not_held(arm: Arm, pieces: Sequence[Piece]) -> dict[str, list[str]]:
    """Names of the blocks that the tool cannot hold at any face, by reason."""
    seen: dict[tuple[Shape, Turn], str | None] = {}
    names: dict[str, list[str]] = {}
    for piece in pieces:
        key = piece.shape, turn_key(piece.turn[2:].round(6))
        if key not in seen:
            seen[key] = why_not_turned(arm, piece)
        why = seen[key]
        if why is not None:
            names.setdefault(why, []).append(piece.id)
    return names


def why_not_turned(arm: Arm, piece: Piece) -> str | None:
    """Why the tool of an arm cannot hold a block as it waits and as it shall stand, in words."""
    why = why_not_held(arm, piece.shape, piece.mass)
    goals = [piece.turn @ turn for turn in piece.turns()]
    if why is not None or any(
        ways_to_turn(arm, piece.shape, r, goals) for r in ways_to_rest(piece)
    ):
        return why
    if arm.suction is None:
        return no_faces(arm, piece.shape)
    size = " x ".join(f"{2e3 * side:g}" for side in piece.half.round(7))
    return f"a block of {size} mm has no face for the cup both as it waits and as it shall stand"


def set_up(job: Job, name: str, tool: str, site: Site, progress: Progress = silent) -> Job:
    """The job with an arm at a base that reaches all of it, and with sources for all blocks.

    Args:
        job: its arm and sources are replaced.
        name, tool: of the arm.
        site: what the user has said.
        progress: told of the bases and of the kinds of blocks for which a place is looked for.

    Raises:
        InputError: for what the tool cannot hold, blocks out of reach (with the base that reaches
            most), and where there is no room for a magazine.
    """
    every = with_rests(job.pieces, get_arm(name, tool))
    job = replace(job, obstacles=(*site.obstacles, *site.kept_out), pieces=every)
    # What can be done by hand asks nothing of the arm, nor does what stands there and stays.
    pieces = [p for p in every if not (p.fixed or (job.hands and p.prop))]
    check_held(get_arm(name, tool), pieces, job.assembly.joint.studs)
    order = [step.block for step in job.steps if not step.remove]
    given = given_sources(site, every, order, gone(job))
    come = [every[k] for k in order if not (job.hands and every[k].prop)]
    _check_enough(site, given, come, [every[k] for k in gone(job)])
    top = max(p.top for p in every)
    if site.base is not None:
        check_beside_supports(name, site.base, every)
        found = reach_from(place_arm(name, tool, site.base), site.base, pieces)
        if found.out:
            raise _out_of_reach(name, pieces, found, suggest(name, tool, pieces))
        arm = resting(place_arm(name, tool, site.base), site.base[3], every)
        check_reached(arm, given, pieces, top)
        return supplied(replace(job, arm=arm), given, site, progress=progress)
    key, fault, most, second = extreme(pieces), None, None, None
    tried = list(bases(pieces))
    free = [base for base in tried if _beside_supports(base, every)]
    if tried and not free:
        check_beside_supports(name, tried[0], every)
    for base in counted(free, "bases tried for the arm", progress):
        arm = place_arm(name, tool, base)
        found = reach_from(arm, base, pieces, key)
        if most is None or len(found.out) < len(most.out):
            most = found
        if found.out or reach_from(arm, base, pieces).out:
            continue
        try:
            check_reached(arm, given, pieces, top)
            here = replace(job, arm=resting(arm, base[3], every))
            if takes_away(here):
                return supplied(here, given, site, progress=progress)
            second = second or here
        except InputError as error:
            fault = fault or error
    if second is not None:
        # The order will say what cannot be taken away.
        return supplied(second, given, site, progress=progress)
    if fault is not None:
        raise fault
    best = _whole(name, tool, pieces, most)
    raise _out_of_reach(name, pieces, best, best)


def _check_enough(
    site: Site, given: Sequence[Source], needed: Sequence[Piece], gone: Sequence[Piece]
) -> None:
    """Refuse too few blocks on pallets and at positions, which nobody fills again.

    Args:
        given: what a layout names.
        needed: the blocks that come, from there or elsewhere.
        gone: those that are taken away, and come again.

    Raises:
        InputError: saying how many blocks of which kind there are, and how many there should be.
    """
    lying, want = (
        Counter(s.shape for s in given if not s.magazine),
        Counter(p.shape for p in needed) - Counter(p.shape for p in gone),
    )
    names = {piece.shape: piece.name for piece in needed}
    few = [f"{lying[one]} of {want[one]} {names[one]}" for one in lying if lying[one] < want[one]]
    if few:
        expected = "places for all blocks of a kind, or a magazine of it"
        raise InputError(f"{site.source}: pallets and positions", ", ".join(few), expected)


def check_beside_supports(name: str, base: Base, pieces: Sequence[Piece]) -> None:
    """Refuse a base that has no room beside what stands there from the first.

    Args:
        name: of the arm.

    Raises:
        InputError: saying where it is.
    """
    if not _beside_supports(base, pieces):
        at, expected = [round(v, 4) for v in base[:2]], f"one {NEAREST:g} m from supports"
        raise InputError(f"base of {name}", at, f"{expected}, which a layout can give")


def _beside_supports(base: Base, pieces: Sequence[Piece]) -> bool:
    """Whether a base has room beside what stands there from the first."""
    import shapely

    x, y, _, _ = base
    foot = shapely.Point(x, y)
    faces: list[Any] = [piece.face() for piece in pieces if piece.fixed and not piece.sunk]
    return all(float(face.distance(foot)) >= NEAREST for face in faces)


def _out_of_reach(name: str, pieces: Sequence[Piece], found: Reach, best: Reach) -> InputError:
    names = [f"{pieces[k].id} ({pieces[k].name})" for k in found.out]
    got = f"{len(names)} of {found.count} blocks out of it: {listed(names)}"
    what = f"reach of {name} at {found.words}"
    if not best.out:
        return InputError(what, got, f"a base at {best.words}, which reaches all of them")
    count = best.count - len(best.out)
    expected = f"a smaller design or kit; the best base, {best.words}, reaches {count}"
    return InputError(what, got, expected)


def resting(arm: Arm, facing: float, pieces: Sequence[Piece]) -> Arm:
    """The arm with a home pose over everything, between its base and the structure."""
    way = math.cos(facing), math.sin(facing)
    places = [(out, up) for up in (0.25, 0.2, 0.15, 0.1) for out in (0.4, 0.35, 0.45, 0.3)]
    return with_home(arm, way, max(p.top for p in pieces), places)


def with_home(
    arm: Arm, way: tuple[float, float], top: float, places: Iterable[tuple[float, float]]
) -> Arm:
    """The arm with another home pose: the first of some places that it reaches, the tool turned as
    it was; the arm itself where it reaches none.

    Args:
        way: from the base, a unit vector.
        top: of what is below [m].
        places: how far out along the way, and how high above the top, each [m].
    """
    rotation = forward(get_chain(arm), arm.home)[1]
    for out, up in places:
        point = np.array([*(arm.base_position[:2] + out * np.array(way)), max(top + up, 0.35)])
        found = solve(arm, point, rotation, arm.home, restarts=RESTARTS)
        if found.ok:
            home = found.joints.copy()
            home.flags.writeable = False
            return replace(arm, home=home)
    return arm
