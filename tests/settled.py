"""Stones, planks and logs that MuJoCo lets settle, as a physics engine would export them.

``python tests/settled.py 40`` prints what ``l2a check`` says of 40 heaps that stay within 1 mm, of
as many planks, roofs and logs, and of 20 structures that fall.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable

import mujoco
import numpy as np
from scipy.spatial import ConvexHull

from learn2assemble.assembly.blocks import Assembly, Block
from learn2assemble.geometry.rotations import quaternion_matrix
from learn2assemble.statics.rigid_blocks import STANDS, TIGHT, check

FRICTION, STEP = 0.6, 0.001
STAYS, FALLS = 1e-3, 2e-2
"""Largest motion of a vertex in two seconds [m] of what stands, and least of what falls."""


def convex(points: np.ndarray, name: str = "") -> Block:
    """The convex hull of points, with flat faces in one piece."""
    hull = ConvexHull(points)
    faces, seen = [], set()
    for plane in hull.equations:
        on = np.flatnonzero(np.abs(points @ plane[:3] + plane[3]) < 1e-10)
        on = np.intersect1d(on, hull.vertices)
        if tuple(on) in seen:
            continue
        seen.add(tuple(on))
        u = np.cross(np.eye(3)[np.argmin(np.abs(plane[:3]))], plane[:3])
        arm = points[on] - points[on].mean(0)
        turn = np.arctan2(arm @ np.cross(plane[:3], u), arm @ u)
        faces.append(tuple(on[np.argsort(turn)].tolist()))
    used = np.unique(np.concatenate([np.array(face) for face in faces]))
    number = {int(k): n for n, k in enumerate(used)}
    return Block(name, points[used], tuple(tuple(number[k] for k in face) for face in faces))


def box(size: tuple[float, float, float]) -> np.ndarray:
    """Corners of a box about zero."""
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    return signs * np.array(size) / 2


def ridge(length: float, width: float, height: float) -> np.ndarray:
    """Corners of a prism whose upper edge lies along y."""
    ends = np.array([(-width / 2, 0.0), (width / 2, 0.0), (0.0, height)])
    return np.array([(x, y, z) for y in (-length / 2, length / 2) for x, z in ends])


def turned(points: np.ndarray, angle: float, axis: int = 2) -> np.ndarray:
    """Points turned about an axis through zero."""
    c, s = np.cos(angle), np.sin(angle)
    turn = np.roll(np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]), (axis + 1, axis + 1), (0, 1))
    return points @ turn.T


Heap = tuple[list[np.ndarray], list[bool]]
"""Corners of every body where it is let go, and which of them are fixed."""


def stones(rng: np.random.Generator) -> Heap:
    """3 to 8 stones of 8 to 20 corners, dropped one on the other."""
    count, bodies, height = int(rng.integers(3, 9)), [], 0.0
    for _ in range(count):
        way = rng.normal(size=(int(rng.integers(8, 21)), 3))
        way /= np.linalg.norm(way, axis=1)[:, None]
        body = turned(way * rng.uniform(0.04, 0.07, 3) * [1, 1, 0.7], rng.uniform(0, 6))
        body -= [0, 0, body[:, 2].min()]
        spread = 0.02 if count < 5 else 0.06
        bodies.append([*body, *rng.normal(0, spread, 2), height + 0.002])
        height += float(np.ptp(body[:, 2])) + 0.002
    return bodies, [False] * count


def plank_on_ridges(rng: np.random.Generator) -> Heap:
    """A plank across two ridges, at times with another on it."""
    high, off = rng.uniform(0.05, 0.12, 2), rng.uniform(0.1, 0.2)
    if rng.random() < 0.5:
        high[:] = high[0]
    left, right = (turned(ridge(0.2, 0.15, h), rng.uniform(-0.3, 0.3)) for h in high)
    bodies = [left - [off, 0, 0], [*right, off, 0, 0]]
    slope = float(np.arctan2(high[1] - high[0], 2 * off))
    top = high.mean() + 0.012 / np.cos(slope) + 0.001
    plank = turned(box((0.5 + rng.uniform(0, 0.1), 0.08, 0.024)), -slope, 1)
    bodies.append([*plank, rng.uniform(-0.03, 0.03), 0, top])
    if rng.random() < 0.5 and high[0] == high[1]:
        small = turned(box((0.1, 0.1, 0.05)), rng.uniform(0, 6))
        bodies.append([*small, rng.uniform(-0.08, 0.08), 0, top + 0.012 + 0.026])
    return bodies, [False] * len(bodies)


def roof(rng: np.random.Generator) -> Heap:
    """Two slabs that lean on each other and stand on their lower edges, or against walls."""
    angle, long, thick = rng.uniform(0.75, 1.1), rng.uniform(0.2, 0.3), 0.02
    bodies = []
    for side in (-1, 1):
        slab = turned(box((long, 0.15, thick)), side * angle, 1)
        slab -= [0, 0, slab[:, 2].min() - 0.0002]
        inner = slab[:, 0].max() if side < 0 else slab[:, 0].min()
        bodies.append(slab - [inner, 0, 0] + [side * 0.0002, 0, 0])
    return bodies, [False, False]


def log_in_v(rng: np.random.Generator) -> Heap:
    """A log of 6 to 12 sides in a V of two fixed or loose wedges."""
    sides, long = int(rng.integers(6, 13)), 0.3
    angle = 2 * np.pi / sides * np.arange(sides) + rng.uniform(0, 1)
    ring = 0.05 * np.stack([np.cos(angle), np.sin(angle)], 1)
    log = np.array([(x, y, z) for y in (-long / 2, long / 2) for x, z in ring])
    wedge = np.array([(x, y, z) for y in (-0.1, 0.1) for x, z in ((0, 0), (0.12, 0), (0.12, 0.1))])
    mirrored = wedge * [-1, 1, 1]
    fixed = bool(rng.random() < 0.5)
    return [wedge, mirrored, [*log, 0, 0, 0.075]], [fixed, fixed, False]


KINDS: dict[str, Callable[[np.random.Generator], Heap]] = {
    "stones": stones,
    "planks": plank_on_ridges,
    "roof": roof,
    "log": log_in_v,
}


class World:
    """Bodies in MuJoCo on the plane z = 0."""

    def __init__(self, bodies: list[np.ndarray], fixed: list[bool]) -> None:
        self.blocks = [convex(points, str(k)) for k, points in enumerate(bodies)]
        meshes, parts = [], []
        for k, block in enumerate(self.blocks):
            corners = " ".join(f"{v:.9g}" for v in (block.vertices - block.centroid).reshape(-1))
            meshes.append(f'<mesh name="m{k}" inertia="exact" vertex="{corners}"/>')
            at = " ".join(f"{v:.9g}" for v in block.centroid)
            joint = "" if fixed[k] else "<freejoint/>"
            parts.append(
                f'<body name="b{k}" pos="{at}">{joint}'
                f'<geom type="mesh" mesh="m{k}" density="2000"/></body>'
            )
        # A file moves its meshes to their centres, which are those of the blocks.
        self.model = mujoco.MjModel.from_xml_string(
            f'<mujoco><option timestep="{STEP}" cone="elliptic" impratio="20" '
            'noslip_iterations="4"/><default>'
            f'<geom friction="{FRICTION} 0 0" condim="3" solref="0.004 1" '
            'solimp="0.97 0.999 0.0005"/></default>'
            f"<asset>{''.join(meshes)}</asset><worldbody>"
            '<geom type="plane" size="9 9 0.1"/>' + "".join(parts) + "</worldbody></mujoco>"
        )
        self.data = mujoco.MjData(self.model)
        mujoco.mj_forward(self.model, self.data)
        self.fixed = fixed
        ids = [self.model.body(f"b{k}").id for k in range(len(bodies))]
        self.body, self.local = ids, []
        for k, block in zip(ids, self.blocks, strict=True):
            turn = quaternion_matrix(self.data.xquat[k][None])[0]
            self.local.append((block.vertices - self.data.xpos[k]) @ turn)

    def corners(self) -> list[np.ndarray]:
        """Where the corners of every body are [m]."""
        turns = quaternion_matrix(self.data.xquat[self.body])
        return [
            own @ turn.T + at
            for own, turn, at in zip(self.local, turns, self.data.xpos[self.body], strict=True)
        ]

    def run(self, seconds: float, damping: float = 0.0) -> float:
        """The largest motion of a corner [m]."""
        before = self.corners()
        for _ in range(round(seconds / STEP)):
            mujoco.mj_step(self.model, self.data)
            self.data.qvel *= 1 - damping
        return max(float(np.abs(a - b).max()) for a, b in zip(before, self.corners(), strict=True))

    def assembly(self) -> Assembly:
        """Where everything is now, as an assembly."""
        blocks = [
            Block(b.id, corners, b.faces, density=2000.0, support=fixed)
            for b, corners, fixed in zip(self.blocks, self.corners(), self.fixed, strict=True)
        ]
        if any(self.fixed):
            ground = convex(box((4.0, 4.0, 0.1)) - [0, 0, 0.05], "ground")
            blocks.append(Block("ground", ground.vertices, ground.faces, support=True))
        return Assembly(tuple(blocks), friction=FRICTION)


def settled(kind: str, seed: int) -> Assembly | None:
    """A structure of a kind after it has settled; None where it does not stay."""
    world = World(*KINDS[kind](np.random.default_rng(seed)))
    world.run(1.0, 0.01)
    world.run(2.0)
    made = world.assembly()
    return made if world.run(2.0) < STAYS else None


def falling(seed: int) -> Assembly | None:
    """A settled heap of stones without one of those that carry it; None where that stays."""
    rng = np.random.default_rng(seed)
    world = World(*stones(rng))
    world.run(1.0, 0.01)
    world.run(2.0)
    bodies = list(world.assembly().blocks)
    gone = int(rng.integers(len(bodies)))
    rest = [b.vertices for k, b in enumerate(bodies) if k != gone]
    left = World(rest, [False] * len(rest))
    made = left.assembly()
    return made if left.run(1.0) > FALLS else None


def figures(count: int) -> None:
    """Print what is said of ``count`` structures of every kind, and of half as many that fall."""
    for kind in KINDS:
        said, seed = Counter(), 0
        while said.total() < count and seed < 20 * count:
            made = settled(kind, seed)
            seed += 1
            if made is not None:
                found = check(made)
                certain = " for certain" if "for certain" in found.proof else ""
                said[found.verdict + certain] += 1
                if certain:
                    print(
                        f"  {kind} {seed - 1}: {found.proof}, {found.holding_force:.3g} N, "
                        f"{found.moving}"
                    )
        print(f"{kind}: {said.total()} of {seed} that were tried stay: {dict(said)}")
    said, seed = Counter(), 0
    while said.total() < count // 2:
        made = falling(seed)
        seed += 1
        if made is not None:
            said[check(made).verdict] += 1
    stood = said[STANDS] + said[TIGHT]
    print(f"falling: {said.total()} of {seed} that were tried, {stood} said to stand: {dict(said)}")


if __name__ == "__main__":
    figures(int(sys.argv[1]))
