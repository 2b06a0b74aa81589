"""The fewest posts of a small assembly, by trying everything, and random assemblies for that."""

from __future__ import annotations

import heapq
from itertools import count

import numpy as np

from learn2assemble.assembly.blocks import Assembly, Block, hull_block
from learn2assemble.assembly.boxes import box_block
from learn2assemble.assembly.contacts import Contacts, find_contacts
from learn2assemble.errors import InputError
from learn2assemble.planning.clearance import LEVEL, Clearance, ways_out
from learn2assemble.planning.posts import find_posts
from learn2assemble.statics.forces.equilibrium import solve
from learn2assemble.statics.rigid_blocks import SIDE, STANDS, check

MOST = 60_000
"""States after which trying everything is given up."""


def random_assembly(seed: int) -> Assembly:
    """An arch of 4 to 9 voussoirs, boxes in courses, or beams that their tails hold down: 4 to 10
    blocks that stand when all are there."""
    rng = np.random.default_rng(seed)
    if seed % 4 == 0:
        return _arch(int(rng.integers(4, 10)), rng)
    while True:
        made = _boxes(int(rng.integers(4, 11)), rng) if seed % 4 == 1 else _beams(rng)
        try:
            if 4 <= len(made.blocks) <= 10 and check(made).verdict == STANDS:
                return made
        except InputError:
            pass


def _arch(voussoirs: int, rng: np.random.Generator) -> Assembly:
    radius, thickness = rng.uniform(0.2, 0.4), rng.uniform(0.09, 0.13)
    angles = np.linspace(0, np.pi, voussoirs + 1)
    blocks: list[Block] = []
    for k in range(voussoirs):
        corners = [
            (r * np.cos(a), y, r * np.sin(a))
            for a in angles[k : k + 2]
            for r in (radius - thickness / 2, radius + thickness / 2)
            for y in (0.0, 0.1)
        ]
        blocks.append(hull_block(f"v{k}", corners))
    return Assembly(tuple(blocks), friction=0.7)


def _boxes(blocks: int, rng: np.random.Generator) -> Assembly:
    """Courses of boxes with gaps, each course shifted at random."""
    made: list[Block] = []
    for course in range(4):
        x = float(rng.uniform(-0.2, 0.2))
        for _ in range(int(rng.integers(1, 4))):
            length = float(rng.uniform(0.1, 0.45))
            if len(made) < blocks:
                low = (x, 0.0, 0.1 * course)
                made.append(box_block(f"b{len(made)}", low, (x + length, 0.1, low[2] + 0.1)))
            x += length + float(rng.uniform(0.02, 0.2))
    return Assembly(tuple(made), friction=0.6)


def _beams(rng: np.random.Generator) -> Assembly:
    """Columns with beams on them that fall but for a tail, some of them with a second beam."""
    made: list[Block] = []

    def add(x: float, length: float, z: float, height: float) -> float:
        made.append(box_block(f"b{len(made)}", (x, 0.0, z), (x + length, 0.1, z + height)))
        return z + height

    foot = 0.0
    for _ in range(int(rng.integers(1, 4))):
        side, z = int(rng.choice([-1, 1])), add(foot, 0.12, 0.0, float(rng.uniform(0.08, 0.2)))
        for _ in range(int(rng.integers(1, 3))):
            length, tail = float(rng.uniform(0.2, 0.4)), float(rng.uniform(0.08, 0.12))
            z = add(foot if side > 0 else foot + 0.12 - length, length, z, 0.06)
            z = add(foot if side > 0 else foot + 0.12 - tail, tail, z, float(rng.uniform(0.1, 0.3)))
        foot += 0.12 + float(rng.uniform(0.3, 0.9))
    return Assembly(tuple(made), friction=0.6)


def fewest_posts(assembly: Assembly, most: int = MOST) -> int | None:
    """The least number of posts with which the blocks can be put down one by one.

    Everything is tried: blocks in any order after those they lie on, with any of the posts that
    :func:`~learn2assemble.planning.posts.find_posts` proposes, put up and taken away at any time.
    Every state has to stand, what comes has to rest without being squeezed in, and its way has to
    be free.

    Returns:
        The number; None where no set of posts does, or where ``most`` states did not suffice.
    """
    given = len(assembly.blocks)
    contacts = find_contacts(assembly)
    posts = find_posts(assembly.blocks, contacts)
    whole = Assembly(
        (*assembly.blocks, *(post.block for post in posts)), friction=assembly.friction
    )
    joints = find_contacts(whole)
    # Posts are looked at with what they carry, not with one another: few of them stand at once.
    joints = joints.only((joints.a < given) | (joints.b < given))
    clearance = Clearance(whole.blocks, 2e-6)
    below = _lies_on(joints, given)
    stands: dict[int, bool] = {}

    def present(state: int) -> np.ndarray:
        return np.array([bool(state >> k & 1) for k in range(len(whole.blocks))])

    def balanced(state: int) -> bool:
        if state not in stands:
            stands[state] = solve(whole, joints, present=present(state)).stands
        return stands[state]

    def rests(state: int, block: int) -> bool:
        there = present(state)
        held = there & (np.arange(len(there)) != block)
        return solve(whole, joints, present=there, held=held).stands

    def enters(state: int, block: int) -> bool:
        there = present(state)
        live = ((joints.a == block) | (joints.b == block)) & there[joints.b]
        live &= (joints.a < 0) | there[joints.a]
        push = np.where((joints.a == block)[live, None], -1, 1) * joints.normal[live]
        ways = LEVEL[(LEVEL @ push.T > -1e-6).all(1)] if block >= given else ways_out(push)
        return clearance.leaves(block, there, ways)

    goal, order = (1 << given) - 1, count()
    queue, seen = [(0, 0, next(order), 0)], set[int]()
    while queue and len(seen) < most:
        used, _, _, state = heapq.heappop(queue)
        if state == goal:
            return used
        if state in seen:
            continue
        seen.add(state)
        for k in range(len(whole.blocks)):
            bit = 1 << k
            other = state ^ bit
            if other in seen:
                continue
            if k < given:
                fits = not state & bit and all(state >> b & 1 for b in below[k])
                fits = fits and balanced(other) and rests(other, k) and enters(other, k)
            else:
                base = posts[k - given].base
                fits = base < 0 or bool(state >> base & 1)
                fits = fits and balanced(other) and enters(state | bit, k)
            if fits:
                cost = used + (k >= given and not state & bit)
                left = given - (other & goal).bit_count()
                heapq.heappush(queue, (cost, left, next(order), other))
    return None


def _lies_on(joints: Contacts, given: int) -> list[set[int]]:
    found: list[set[int]] = [set() for _ in range(given)]
    for a, b, normal in zip(joints.a.tolist(), joints.b.tolist(), joints.normal, strict=True):
        if a >= 0 and b < given and abs(normal[2]) > SIDE:
            lower, upper = (a, b) if normal[2] > 0 else (b, a)
            found[int(upper)].add(lower)
    return found
