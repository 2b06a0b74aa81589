"""Two arms in one cell: where they stand, what each reaches, and the plan that they share.

Without a layout the arms stand on two opposite sides of the site and each has magazines of its own,
within its reach. The order is found with them (:mod:`.crew`): who brings which block, who holds
it meanwhile with what its hand can give, and posts, set by hand, where that is not enough.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from learn2assemble.assembly.blocks import Assembly, AssemblyStep
from learn2assemble.assembly.contacts import GROUND, Contacts, find_contacts
from learn2assemble.cell.magazines import APART, supplied
from learn2assemble.cell.pieces import Piece, middle_of, pieces_of, ways_to_rest, with_rests
from learn2assemble.cell.reach import (
    DISTANCES,
    Base,
    Reach,
    bases,
    check_beside_supports,
    check_held,
    check_reached,
    extreme,
    nowhere,
    place_arm,
    reach_from,
    resting,
    way_down,
)
from learn2assemble.cell.site import Obstacle, Site, Source, given_sources, outline
from learn2assemble.cell.site_arms import SiteArm, share_magazines
from learn2assemble.cell.workcell import Job, Progress, StepOf, check_ground
from learn2assemble.errors import InputError, listed
from learn2assemble.kinematics.approach import ApproachCache
from learn2assemble.kinematics.capsules import capsules_of, placed
from learn2assemble.kinematics.chain import get_chain
from learn2assemble.planning.crew import NOBODY
from learn2assemble.planning.given import plan_assembly
from learn2assemble.planning.plan import Plan
from learn2assemble.planning.reports import BuilderArm
from learn2assemble.planning.sequence import Supports
from learn2assemble.progress import silent
from learn2assemble.robot.arm import Arm, get_arm
from learn2assemble.robot.grasps import LEVEL, UPRIGHT
from learn2assemble.robot.holding import Way, attitude, tilt_of, ways_to_turn
from learn2assemble.robot.moves import AT_THE_SIDE, BASE_THERE
from learn2assemble.team.crew import ArmCrew, Member, leaning

BESIDE = 0.32
"""Bases stand no nearer to each other, for what they cover [m]."""
BASE_RADIUS = 0.16
"""What a base covers [m]."""
FAR = (0.65, 0.6, 0.55, 0.5, 0.45, 0.7, 0.75, 0.4)
"""Distances of bases from the middle of arms with fingers, the preferred ones first [m]: hands are
wide and reach past each other only where the arms stretch from afar."""
AHEAD = math.cos(math.radians(40.0))
"""The axis of a tool that puts a block down by the face on its own side is off the way from the
base of its arm to the block by less."""
NARROW = 0.09
"""Wrists are so wide [m]: where leaning joints of a block are nearer to each other, two hands have
no room side by side above it and the next one."""
ABOVE = 0.01
"""All of an arm stays so far above the ground then [m]."""
BASE = (0.3, 0.3, 0.5)
"""Size of the box that the base of the other arm is for the ways of blocks [m]."""
TOOL = "suction"
"""Of an arm of which nothing else is said."""


@dataclass(frozen=True)
class TeamReach:
    """What several arms reach of a structure."""

    arms: tuple[SiteArm, ...]
    reaches: tuple[Reach, ...]
    """Of each, from its base."""
    count: int
    """How many blocks there are."""
    assembly: Assembly | None = None
    """The blocks, to which these refer by index."""

    @property
    def out(self) -> list[int]:
        """Blocks that none of them reaches."""
        first, *others = (set(reach.out) for reach in self.reaches)
        return sorted(first.intersection(*others))

    @property
    def both(self) -> int:
        """How many blocks each of them reaches."""
        return self.count - len(set[int]().union(*(reach.out for reach in self.reaches)))


def team_reach(
    arms: Sequence[SiteArm], pieces: Sequence[Piece], studs: float = 0.0, level: bool = False
) -> TeamReach:
    """What arms reach from their bases, or from opposite sides of the site where these are free.

    Args:
        studs: of the blocks, how far apart they are [m]; 0: they have none.
        level: whether they put blocks down with their tools level, see :func:`is_narrow`.

    Raises:
        InputError: for blocks that a tool cannot hold, and for bases on one spot.
    """
    for one in arms:
        check_held(_with_tool(get_arm(one.arm, one.tool or TOOL), level), pieces, studs)
    if all(one.base is not None for one in arms):
        _check_apart(arms)
        return _reached(arms, pieces, level)
    key, best, middle = extreme(pieces), None, middle_of(pieces)
    fingers = all(get_arm(one.arm, one.tool or TOOL).suction is None for one in arms)
    for base in bases(pieces, FAR if fingers else DISTANCES):
        found = _reached(_placed(arms, base, middle), pieces, level, key)
        cost = len(found.out), len(key) - (found.both - found.count + len(key))
        if best is None or cost < best[0]:
            best = cost, base
        if best[0] == (0, 0):
            break
    # What is as wide as arms reach leaves no room beside it: told from where is what they miss.
    placed = _placed(arms, nowhere(pieces) if best is None else best[1], middle)
    _check_apart(placed)
    return _reached(placed, pieces, level)


def _with_tool(arm: Arm, level: bool) -> Arm:
    return replace(arm, most_tilt=LEVEL) if level else arm


def _placed(arms: Sequence[SiteArm], base: Base, middle: np.ndarray) -> tuple[SiteArm, ...]:
    """Arms of which those without a base stand at one, and at the one across from it.

    Args:
        middle: float64[2], of the structure [m].
    """
    x, y = middle.tolist()

    def across(one: Base) -> Base:
        u, v, height, facing = one
        return 2 * x - u + 0.0, 2 * y - v + 0.0, height, facing + math.pi

    places = [base, across(base)]
    for one in arms:
        if one.base is not None:  # The other one stands across from it.
            places = [across(one.base)] * 2
    return tuple(
        one if one.base is not None else one._replace(base=place)
        for one, place in zip(arms, places, strict=False)
    )


def _reached(
    arms: Sequence[SiteArm],
    pieces: Sequence[Piece],
    level: bool,
    which: Sequence[int] | None = None,
) -> TeamReach:
    found = list[Reach]()
    for one in arms:
        assert one.base is not None
        arm = _with_tool(place_arm(one.arm, one.tool or TOOL, one.base), level)
        found.append(reach_from(arm, one.base, with_rests(pieces, arm), which))
    return TeamReach(tuple(arms), tuple(found), len(pieces))


def _check_apart(arms: Sequence[SiteArm]) -> None:
    """Refuse bases on one spot."""
    for k, one in enumerate(arms):
        for other in arms[:k]:
            assert one.base is not None
            assert other.base is not None
            away = math.dist(one.base[:2], other.base[:2])
            if away < BESIDE:
                got = f"bases {away:.2f} m apart"
                raise InputError(f"arms {other.name} and {one.name}", got, f"at least {BESIDE:g} m")


def report_team(plan: Plan, arms: Sequence[SiteArm]) -> TeamReach:
    """What several arms reach of the blocks of a plan, props aside.

    Raises:
        InputError: as :func:`team_reach`, and for a plan without blocks.
    """
    if plan.assembly is None:
        raise InputError("design", plan.reason or "no blocks", "a design that blocks fill")
    bare = _without_props(plan.assembly)
    level = is_narrow(find_contacts(bare))
    bare = replace(bare, blocks=tuple(block for block in bare.blocks if not block.support))
    return replace(team_reach(arms, pieces_of(bare), bare.joint.studs, level), assembly=bare)


def _without_props(assembly: Assembly) -> Assembly:
    """The blocks that stay, in no order."""
    kept = tuple(block for block in assembly.blocks if not block.prop)
    return replace(assembly, blocks=kept, steps=(), not_built=())


# ---------------------------------------------------------------- the cell


def set_up_team(
    assembly: Assembly, arms: Sequence[SiteArm], site: Site, progress: Progress = silent
) -> list[Member]:
    """The arms of a cell at their bases, each with places to take blocks from, and with what the
    others take as obstacles.

    Args:
        assembly: what is built; its steps and props are not looked at.
        arms: who builds.
        site: what the user has said of the cell.
        progress: told of the kinds of blocks for which a place is looked for.

    Raises:
        InputError: for mortar, for what a tool cannot hold, bases on one spot, blocks that no arm
            reaches, a magazine that none does, and where there is no room for one.
    """
    import shapely

    if assembly.holds and (assembly.joints or assembly.joint.law != "clutch"):
        raise InputError("joints", "some with mortar", "dry blocks or bricks, for several arms")
    if site.pallets or site.positions:
        raise InputError(site.source, "pallets or positions", "magazines, for several arms")
    assembly = _without_props(assembly)
    check_ground(assembly)
    pieces = pieces_of(assembly)
    own = [piece for piece in pieces if not piece.fixed]
    joints = find_contacts(assembly)
    level = len(arms) > 1 and is_narrow(joints)
    found = team_reach(arms, own, assembly.joint.studs, level)
    if out := found.out:
        names = listed([own[k].id for k in out])
        each = zip(found.arms, found.reaches, strict=True)
        where = ", ".join(f"{one.name} at {reach.words}" for one, reach in each)
        got = f"{len(out)} of {len(own)} blocks out of it: {names}"
        raise InputError(f"reach of {where}", got, "bases from which one of the arms reaches each")
    for one in found.arms:
        check_beside_supports(one.name, _base_of(one), pieces)
    placed = (k for k, piece in enumerate(pieces) if not piece.fixed)
    order = sorted(placed, key=lambda k: float(pieces[k].extent[0][2]))
    steps = tuple(StepOf(k) for k in order)
    obstacles = (*site.obstacles, *site.kept_out)
    taken = [shapely.Point(*_base_of(one)[:2]).buffer(BASE_RADIUS) for one in found.arms]
    taken += [outline(o) for o in obstacles]
    jobs = list[Job]()
    for one in found.arms:
        arm = _with_tool(place_arm(one.arm, one.tool or TOOL, _base_of(one)), level)
        mine = with_rests(pieces, arm, own_side(pieces, arm) if level else {})
        jobs.append(Job(mine, steps, assembly, arm, (), obstacles, assembly.friction))
    waiting = [given_sources(site, job.pieces, order) for job in jobs]
    own_sources = _own_sources(site, found.arms, jobs, waiting)
    members: list[Member] = []
    for number, (one, job, given) in enumerate(zip(found.arms, jobs, own_sources, strict=True)):
        across = np.array(_base_of(found.arms[1 - number])[:2])
        job = replace(job, arm=resting(job.arm, _base_of(one)[3], job.pieces))
        others = [s.area.buffer(APART) for s in own_sources[1 - number]]
        job = supplied(job, given, site, [*taken, *others], across, progress)
        taken += [source.area.buffer(APART) for source in job.sources if source not in given]
        members.append(Member(one.name, job))
    # Where blocks lean, one arm holds and the other one passes low, as it puts blocks down tilted;
    # where both move at once, ways above a base leave the room in front of it to the other arm.
    past = BASE_THERE if leaning(joints).any() else AT_THE_SIDE
    return [_clear_of(m, [one.job for one in members if one is not m], past) for m in members]


def _own_sources(
    site: Site, arms: Sequence[SiteArm], jobs: Sequence[Job], waiting: Sequence[list[Source]]
) -> list[list[Source]]:
    """What each of two arms takes of the magazines of a layout: as what one takes is in the way of
    the other one, each magazine is of one arm.

    Args:
        waiting: what comes from the magazines, as each arm would take it.

    Raises:
        InputError: for a magazine that no arm takes from or reaches, or that two shall take from.
    """
    names = [f"{site.source}: magazines[{n}]" for n in range(len(site.magazines))]
    found, reached = list[list[Source]](), list[set[int]]()
    for one, job, sources in zip(arms, jobs, waiting, strict=True):
        if one.magazines is None:
            given = [source for source in sources if _reaches(job.arm, source, job.pieces)]
        else:
            given = [s for s in sources if names.index(s.name) in one.magazines]
            check_reached(job.arm, given, job.pieces, max(p.top for p in job.pieces))
        found.append(given)
        reached.append({names.index(source.name) for source in given})
    kinds = [magazine.kind for magazine in site.magazines]
    far = [[math.dist(m.pose[:2], _base_of(a)[:2]) for a in arms] for m in site.magazines]
    own = share_magazines(arms, reached, kinds, far, site.source)
    for n, magazine in enumerate(site.magazines):
        if not any(n in some for some in own):
            at = [round(v, 4) for v in magazine.pose]
            expected = "a place that one of the arms takes from and reaches"
            raise InputError(names[n], at, expected)
    return [
        [source for source in given if names.index(source.name) in some]
        for given, some in zip(found, own, strict=True)
    ]


def _clear_of(member: Member, others: Sequence[Job], past: int) -> Member:
    """The arm, which keeps clear of what others take.

    Args:
        past: as of :func:`occupied`.
    """
    taken = (one for job in others for one in occupied(job, past))
    return replace(member, job=replace(member.job, obstacles=(*member.job.obstacles, *taken)))


def occupied(job: Job, past: int) -> list[Obstacle]:
    """What the other arm must not touch of one: where it stands, and where its blocks wait.

    Args:
        past: how ways pass its base, :data:`BASE_THERE` or :data:`AT_THE_SIDE`.
    """
    x, y = job.base.tolist()
    found = [Obstacle((x, y), BASE, float(job.arm.base_yaw), 0.0, "the other arm", past)]
    for source in job.sources:
        a, b, c, d = source.area.bounds
        tall = max(
            float(piece.corners(piece.waiting(source.pose))[:, 2].max())
            for piece in job.pieces
            if source.presents(piece)
        )
        size = (c - a, d - b, tall)
        middle = (a + c) / 2, (b + d) / 2
        found.append(Obstacle(middle, size, 0.0, 0.0, "the other arm's supply", AT_THE_SIDE))
    return found


def is_narrow(contacts: Contacts) -> bool:
    """Whether two hands have no room side by side above two blocks, so that each arm holds by the
    face on its own side, with its tool level."""
    return between_leaning(contacts) < NARROW


def between_leaning(contacts: Contacts) -> float:
    """Least distance of two joints of a block that lean, from middle to middle [m]; infinite
    without any."""
    lean = leaning(contacts)
    count = np.bincount(contacts.patch, minlength=len(lean))[:, None]
    middle = np.zeros((len(lean), 3))
    np.add.at(middle, contacts.patch, contacts.points / count[contacts.patch])
    joints: dict[int, list[np.ndarray]] = {}
    for a, b, at in zip(contacts.a[lean], contacts.b[lean], middle[lean], strict=True):
        for block in (int(a), int(b)):
            joints.setdefault(block, []).append(at)
    joints.pop(GROUND, None)
    pairs = (pair for each in joints.values() for pair in itertools.combinations(each, 2))
    return min((float(np.linalg.norm(one - other)) for one, other in pairs), default=math.inf)


def own_side(pieces: Sequence[Piece], arm: Arm) -> dict[str, np.ndarray]:
    """Rotations in which blocks wait that an arm then puts down with its tool level, by the face
    on its own side: two arms across from one another are in each other's way least so.

    Args:
        pieces: of a structure whose joints lean, so hands have to hold.
        arm: with a tool that may be level.

    Returns:
        float64[3, 3] by name; without those for which the tool has no room above the ground.
    """
    cache, found = ApproachCache(arm), dict[str, np.ndarray]()
    for piece in pieces:
        ahead = (piece.target - arm.base_position) * [1.0, 1.0, 0.0]
        ahead /= max(float(np.linalg.norm(ahead)), 1e-9)
        goals, best = [piece.turn @ turn for turn in piece.turns()], AHEAD
        for rest in ways_to_rest(piece):
            for way in ways_to_turn(arm, piece.shape, rest, goals):
                towards = float(way.place[:, 2] @ ahead)
                if towards < best + 1e-6 or tilt_of(way.grasp) > UPRIGHT or way.aside:
                    continue
                if _above_ground(cache, piece, way):
                    found[piece.id], best = rest, towards
    return found


def _above_ground(cache: ApproachCache, piece: Piece, way: Way) -> bool:
    """Whether an arm puts a block down so with all of it above the ground."""
    arm, centre = cache.arm, np.array(piece.shape[way.hold.part].centre)
    place = attitude(way.hold, centre, way.goal, way.place)
    where, capsules = piece.pose[:3] + way.goal @ centre, capsules_of(arm)
    moved = capsules.link > 1  # What is below turns about the vertical.
    for angle in (0.0, *arm.turns):
        joints = cache.solve(where, place.spun(angle), float(where[2]))
        if not isinstance(joints, str):
            lines = placed(get_chain(arm), capsules, joints[:1].copy())[0]
            if (lines[..., 2].min(1) - capsules.radius)[moved].min() > ABOVE:
                return True
    return False


def _base_of(one: SiteArm) -> Base:
    assert one.base is not None
    return one.base


def _reaches(arm: Arm, source: Source, pieces: Sequence[Piece]) -> bool:
    """Whether an arm reaches all that waits at a place."""
    cache, top = ApproachCache(arm), max(p.top for p in pieces)
    some = {piece.rest.tobytes(): piece for piece in pieces if source.presents(piece)}
    return all(
        way_down(cache, piece, piece.waiting(source.pose), top) is None for piece in some.values()
    )


# ---------------------------------------------------------------- the plan


def plan_by_team(
    assembly: Assembly,
    members: Sequence[Member],
    *,
    posts: bool = True,
    options: dict[str, Any],
    progress: Progress = silent,
) -> Plan:
    """The order in which two arms build, with who does each step; nothing is carried out.

    Args:
        assembly: given blocks that are dry; steps and props are not looked at.
        members: the arms, of :func:`set_up_team`.
        posts: whether posts may be placed, by hand, where hands that hold are not enough.
        options: ``friction``, ``gap`` and ``seconds`` as of :func:`~.planning.given.plan_assembly`.

    Raises:
        InputError: for options that cannot be used.
    """
    bare = _without_props(assembly)
    crews: list[ArmCrew] = []

    def crew_of(blocks: Sequence[Any]) -> ArmCrew:
        crews.append(ArmCrew(members, blocks))
        return crews[-1]

    help_ = Supports(posts=posts, holds=len(members) - 1, crew=crew_of, table=True)
    plan = plan_assembly(bare, supports=help_, progress=progress, **options)
    # Posts that no arm brings are set by hand, and no reason.
    told_last = [w for k, w in crews[-1].why.items() if k < len(bare.blocks)][-1:]
    told = plan.status == "incomplete" or NOBODY in (plan.reason or "")
    why = "; ".join(told_last) if told else ""
    reason = f"{plan.reason} ({why})" if why else plan.reason
    return replace(_by_hand(plan), arms=told_of(members), reason=reason)


def told_of(members: Sequence[Member]) -> tuple[BuilderArm, ...]:
    """What a plan tells of the arms that build."""
    level = members[0].job.arm.works_level
    arms = [site_arm_of(member) for member in members]
    own = [piece for piece in members[0].job.pieces if not piece.fixed]
    reached = team_reach(arms, own, members[0].job.assembly.joint.studs, level)
    return tuple(
        BuilderArm(a.name, a.arm, a.tool or TOOL, _base_of(a), reached.count - len(reach.out))
        for a, reach in zip(reached.arms, reached.reaches, strict=True)
    )


def _by_hand(plan: Plan) -> Plan:
    """The plan, with steps of props that no arm does marked as done by hand."""
    steps = tuple(
        replace(step, by_hand=True) if step.prop and step.arm is None else step
        for step in plan.steps
    )
    if plan.assembly is None:
        return replace(plan, steps=steps)
    made: list[AssemblyStep] = [
        replace(one, by_hand=True) if step.by_hand else one
        for one, step in zip(plan.assembly.steps, steps, strict=True)
    ]
    return replace(plan, steps=steps, assembly=replace(plan.assembly, steps=tuple(made)))


def site_arm_of(member: Member) -> SiteArm:
    """The arm as a layout says it, at its base and with its tool."""
    arm = member.job.arm
    x, y, z = arm.base_position.tolist()
    base = x, y, z, arm.base_yaw - get_arm(arm.name).base_yaw
    return SiteArm(member.name, arm.name, arm.tool_name, base)
