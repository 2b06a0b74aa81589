"""Blocks drawn in space: a parallel projection as polygons, far ones first."""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from scipy.spatial import ConvexHull  # pyright: ignore[reportMissingTypeStubs]

from learn2assemble.assembly.blocks import Block
from learn2assemble.assembly.bricks.mates import HEIGHT, RADIUS, knobs_on
from learn2assemble.assembly.instructions.steps import Group, Instructions
from learn2assemble.assembly.parts import convex_parts

_TOWARDS = np.array([-0.55, -1.0, 0.75])
TOWARDS = _TOWARDS / np.linalg.norm(_TOWARDS)
"""Unit vector to who looks: from the front, the left and above, so that O is in front."""
RIGHT = np.array([-TOWARDS[1], TOWARDS[0], 0]) / np.hypot(*TOWARDS[:2])
UP = np.cross(TOWARDS, RIGHT)
_LIGHT = np.array([-0.35, -0.6, 0.95])
_ROUND, _SIDE = 12, 0.75
"""Corners of the ends of a knob, and how light it is at its side."""
_TOUCH = 1e-5
"""Blocks that reach into one another by less are side by side [m]."""
WHOLE, NEAR = 120, 24
"""Up to so many blocks a drawing shows all; with more, so many around those of the step."""


@dataclass(frozen=True, eq=False)
class Figure:
    """What is drawn of a convex part of a block, from where its block begins."""

    faces: tuple[tuple[np.ndarray, float], ...]
    """float64[n, 2] [m, y up], and how light it is, 0 to 1."""
    edges: tuple[np.ndarray, ...]
    """float64[2, 2] each [m]."""
    rims: tuple[np.ndarray, ...]
    """Outlines of knobs, float64[n, 2] each [m]."""
    frame: np.ndarray
    """float64[2, 2]: lowest and highest point [m]."""


@dataclass(frozen=True, eq=False)
class Drawn:
    """One part of a block in the drawing."""

    block: int
    figure: Figure
    name: int
    """Equal figures have one number."""
    at: np.ndarray
    """float64[2]: where it begins [m]."""


def project(points: np.ndarray) -> np.ndarray:
    """float64[..., 2]: right and up in the drawing [m]."""
    return np.asarray(points) @ np.stack([RIGHT, UP], -1)


class DrawnScene:
    """All blocks of instructions, in an order in which nearer ones cover those behind."""

    def __init__(self, told: Instructions) -> None:
        self.told = told
        assembly = told.assembly
        sizes = [np.ptp(b.vertices, axis=0).min() for b in assembly.blocks]
        self.usual: float = float(np.median(sizes))
        """Size of a usual block [m], by which drawings choose grid and lines."""
        stud, known = assembly.joint.pitch[0], dict[bytes, int]()
        self.figures: list[Figure] = []
        shapes: dict[tuple[object, bytes], list[tuple[_ConvexPart, int]]] = {}
        parts: list[tuple[int, _ConvexPart, int]] = []
        for index, block in enumerate(assembly.blocks):
            relative = block.vertices - block.vertices.min(0)
            key = (block.faces, (relative / 1e-6).round().tobytes())
            if key not in shapes:
                shapes[key] = []
                for part in convex_parts(block):
                    figure = _figure(block, part, knobs_on(block, assembly.joint), stud)
                    content = b"".join(np.round(p, 6).tobytes() for p, _ in figure.faces)
                    content += b"|" + b"".join(np.round(e, 6).tobytes() for e in figure.edges)
                    if content not in known:
                        known[content] = len(self.figures)
                        self.figures.append(figure)
                    corners = part.vertices - block.vertices.min(0)
                    shapes[key].append((_ConvexPart(corners, part.faces), known[content]))
            low = block.vertices.min(0)
            parts += [(index, _ConvexPart(p.vertices + low, p.faces), n) for p, n in shapes[key]]
        order = _far_first([part for _, part, _ in parts])
        corner = project(np.array([b.vertices.min(0) - told.origin for b in assembly.blocks]))
        self.drawn: list[Drawn] = [
            Drawn(parts[k][0], self.figures[parts[k][2]], parts[k][2], corner[parts[k][0]])
            for k in order
        ]
        self._parts: dict[int, list[int]] = {}
        for number, one in enumerate(self.drawn):
            self._parts.setdefault(one.block, []).append(number)
        self.low: np.ndarray = np.array([b.vertices.min(0) for b in assembly.blocks]) - told.origin
        self.high: np.ndarray = np.array([b.vertices.max(0) for b in assembly.blocks]) - told.origin

    def parts_of(self, blocks: set[int]) -> list[Drawn]:
        """What is drawn of these blocks, from the back to the front."""
        return [self.drawn[k] for k in sorted(k for b in blocks for k in self._parts[b])]

    def standing(self) -> list[set[int]]:
        """What stands before every group."""
        here, found = {p.block for p in self.told.start}, list[set[int]]()
        for group in self.told.groups:
            found.append(set(here))
            for placement in group.placements:
                (here.discard if placement.action == "remove" else here.add)(placement.block)
        return found

    def shown(self, group: Group, standing: set[int]) -> tuple[set[int], bool]:
        """What a drawing of a step shows besides its own blocks, and whether that is all.

        Of more than :data:`WHOLE` blocks those nearest to the step are shown, none far below it.
        """
        new = [p.block for p in group.placements]
        others = np.array(sorted(standing - set(new)), int)
        if len(others) <= WHOLE and len(self.told.assembly.blocks) <= 2 * WHOLE:
            return set(others.tolist()), True
        low, high = self.low[new].min(0), self.high[new].max(0)
        apart = np.maximum(np.maximum(low - self.high[others], self.low[others] - high), 0)
        height = float(high[2] - low[2])
        deep = low[2] - self.low[others][:, 2]
        # What lies below counts as farther than what stands beside.
        distance = np.hypot(apart[:, 0], apart[:, 1]) + np.maximum(deep, 0) * 0.8
        distance[deep > 2.5 * height] = np.inf
        near = np.argsort(distance, kind="stable")[:NEAR]
        return set(others[near[np.isfinite(distance[near])]].tolist()), False


class _ConvexPart:
    """A convex part: corners float64[V, 3] [m] and faces."""

    def __init__(self, vertices: np.ndarray, faces: tuple[tuple[int, ...], ...]) -> None:
        self.vertices, self.faces = vertices, faces


def _normal(corners: np.ndarray) -> np.ndarray:
    ahead = np.roll(corners, -1, 0)
    normal = np.cross(corners - corners[0], ahead - corners[0]).sum(0)
    return normal / max(float(np.linalg.norm(normal)), 1e-300)


def _figure(block: Block, part: Block, knobs: np.ndarray, stud: float) -> Figure:
    """A part of a block, with knobs that begin at float64[k, 3] from its corner [m].

    Args:
        stud: distance of studs [m].
    """
    corner = block.vertices.min(0)
    faces = list[tuple[np.ndarray, float]]()
    for normal, shape in _level_faces(part):
        if normal @ TOWARDS > 1e-6:
            light = 0.62 + 0.38 * max(float(normal @ _LIGHT / np.linalg.norm(_LIGHT)), 0.0)
            faces.append((shape - project(corner), light))
    owners: dict[tuple[int, int], list[np.ndarray]] = {}
    for face in block.faces:
        normal = _normal(block.vertices[list(face)])
        for a, b in zip(face, (*face[1:], face[0]), strict=True):
            owners.setdefault((min(a, b), max(a, b)), []).append(normal)
    edges = list[np.ndarray]()
    low, high = part.vertices.min(0) - 1e-7, part.vertices.max(0) + 1e-7
    for (a, b), normals in owners.items():
        level = all(n @ normals[0] > 1 - 1e-9 for n in normals)
        if level or max(n @ TOWARDS for n in normals) <= 1e-6:
            continue
        ends = block.vertices[[a, b]]
        middle = ends.mean(0)
        if part is block or bool(((middle >= low) & (middle <= high)).all()):
            edges.append(project(ends - corner))
    points, rims = [project(part.vertices - corner)], list[np.ndarray]()
    around = 2 * np.pi * np.arange(_ROUND) / _ROUND
    circle = RADIUS * stud * np.stack([np.cos(around), np.sin(around), 0 * around], -1)
    for at in knobs[np.argsort(knobs @ TOWARDS)]:
        ends = [project(at + circle + (0, 0, up)) for up in (0.0, HEIGHT * stud)]
        both = np.concatenate(ends)
        side = both[ConvexHull(both).vertices]
        faces += [(side, _SIDE), (ends[1], 1.0)]
        rims += [side, ends[1]]
        points.append(side)
    found = np.concatenate(points)
    frame = np.array([found.min(0), found.max(0)])
    return Figure(tuple(faces), tuple(edges), tuple(rims), frame)


def _level_faces(part: Block) -> list[tuple[np.ndarray, np.ndarray]]:
    """Normals of the faces of a convex part, and the faces as they are drawn, ``float64[n, 2]``
    [m]; faces in one plane, as the triangles of a mesh, are one: between two drawn side by side
    what is behind would show as a hairline."""
    planes: list[tuple[np.ndarray, list[np.ndarray]]] = []
    for face in part.faces:
        corners = part.vertices[list(face)]
        normal = _normal(corners)
        same = (found for level, found in planes if level @ normal > 1 - 1e-9)
        if (found := next(same, None)) is None:
            planes.append((normal, [project(corners)]))
        else:
            found.append(project(corners))
    return [
        (normal, shapes[0] if len(shapes) == 1 or normal @ TOWARDS <= 1e-6 else _around(shapes))
        for normal, shapes in planes
    ]


def _around(shapes: list[np.ndarray]) -> np.ndarray:
    points = np.concatenate(shapes)
    return points[ConvexHull(points).vertices]


def _far_first(parts: list[_ConvexPart]) -> list[int]:
    """Numbers of convex parts, each after those it may cover."""
    import shapely

    low = np.array([p.vertices.min(0) for p in parts])
    high = np.array([p.vertices.max(0) for p in parts])
    flat = [project(p.vertices) for p in parts]
    ends = np.array([[*f.min(0), *f.max(0)] for f in flat]).T
    boxes = cast("Any", shapely).box(*ends)
    first, second = shapely.STRtree(boxes).query(boxes)
    pair = first < second
    first, second = cast("np.ndarray", first[pair]), cast("np.ndarray", second[pair])
    square = np.array([_is_square(part.vertices) for part in parts])
    # +1: the first is in front, -1: the second is.
    front = np.zeros(len(first), int)
    for axis in range(3):
        side = int(np.sign(TOWARDS[axis]))
        above = low[first, axis] >= high[second, axis] - _TOUCH
        below = high[first, axis] <= low[second, axis] + _TOUCH
        front[(front == 0) & above] = side
        front[(front == 0) & below] = -side
    for k in np.flatnonzero((front == 0) & ~(square[first] & square[second])).tolist():
        one, other = int(first[k]), int(second[k])
        front[k] = _in_front(parts[one], parts[other])
    depth = np.array([p.vertices.mean(0) @ TOWARDS for p in parts])
    undecided = front == 0
    front[undecided] = np.where(depth[first] > depth[second], 1, -1)[undecided]
    near, far = np.where(front > 0, first, second), np.where(front > 0, second, first)
    return _sorted(len(parts), far, near, depth)


def _is_square(points: np.ndarray) -> bool:
    """Whether these are the corners of a box along x, y and z."""
    ends = np.minimum(np.abs(points - points.min(0)), np.abs(points - points.max(0)))
    return len(points) == 8 and bool((ends < 1e-7).all())


def _in_front(a: _ConvexPart, b: _ConvexPart) -> int:
    """+1 where a plane of a face shows a to be in front of b, -1 where b is, 0 where none does."""
    best, found = np.inf, 0
    for one, other, sign in ((a, b, 1), (b, a, -1)):
        for face in one.faces:
            corners = one.vertices[list(face)]
            normal = _normal(corners)
            deep = -float(((other.vertices - corners[0]) @ normal).min())
            facing = float(normal @ TOWARDS)
            if deep < best and abs(facing) > 1e-3:
                best, found = deep, -sign if facing > 0 else sign
    return found if best < 1e-3 else 0


def _sorted(count: int, far: np.ndarray, near: np.ndarray, depth: np.ndarray) -> list[int]:
    waiting = np.bincount(near, minlength=count)
    by = np.argsort(far, kind="stable")
    begin = np.searchsorted(far[by], np.arange(count + 1))
    ready = [(float(depth[k]), k) for k in np.flatnonzero(waiting == 0).tolist()]
    heapq.heapify(ready)
    rest = iter(np.argsort(depth, kind="stable").tolist())
    done, found = np.zeros(count, bool), list[int]()
    while len(found) < count:
        # Where blocks cover one another in a ring, the farthest of all begins.
        k = heapq.heappop(ready)[1] if ready else next(rest)
        if done[k]:
            continue
        done[k] = True
        found.append(k)
        for other in near[by[begin[k] : begin[k + 1]]].tolist():
            waiting[other] -= 1
            if waiting[other] == 0 and not done[other]:
                heapq.heappush(ready, (float(depth[other]), other))
    return found
