"""An assembly as data for the 3-D view and the plans of layers: shapes, blocks, joints, marks.

It holds thousands of blocks: in the 3-D view they are one mesh, and equal shapes are stored once.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, cast

import numpy as np

from learn2assemble.assembly.blocks import Assembly, Block, fan_triangles
from learn2assemble.assembly.bricks.mates import HEIGHT, RADIUS, knobs_on
from learn2assemble.assembly.contacts import Contacts
from learn2assemble.assembly.instructions.appearance import Section, kinds_and_colours, sections
from learn2assemble.assembly.joints import DRY, Joint
from learn2assemble.assembly.parts import to_manifold
from learn2assemble.values import rounded
from learn2assemble.viewer.arm import Labels
from learn2assemble.viewer.html import packed, to_base64

_WIDE = 1.25
"""A structure is wide where it is so many times as long as it is deep, seen from above."""
ASIDE, _MORE_ASIDE = 0.5, 0.8
"""How far beside the middle of its wide side one looks at it from first, as a share of how far one
is in front; from the second with an arm behind, which then stands beside it."""
BESIDE = (ASIDE, _MORE_ASIDE, 1.0, 1.25, 1.5, 1.75)
"""The same for the front of a drawing that an arm may hide: the first one where none does."""
_ARM = 0.12
"""An arm hides what is behind this much of each side of the middle of its base [m]."""
SEEN_FROM_BEHIND = "Seen from behind: left and right are exchanged."
"""What page and video say where one looks at the back of what was drawn from the front."""
_COVERED = 0.03
"""Share of a side that may be left open where it counts as covered, and how far apart sides that
touch may be, as a share of the smallest edge."""


class ScenePart(NamedTuple):
    """One stay of a block in the structure; only props may have several."""

    block: Block
    shape: int
    origin: np.ndarray
    """float64[3]: lower corner of its bounding box [m]."""
    kind: str
    colour: str
    """``#rrggbb``, or the name of a colour of the style sheet."""
    layer: int
    placed: int
    """The step that places it; 0: it stands from the start."""
    removed: int
    """The step that removes it again, or 0."""
    holds: tuple[tuple[int, int], ...] = ()
    """Steps from which a hand holds it, and with which it is let go."""


class Mark(NamedTuple):
    """Cells to blame, marked in the 3-D view and in the plans of layers."""

    words: str
    """What they are."""
    boxes: np.ndarray
    """float64[n, 6]: lower and upper corner of each [m, world]."""


def cell_labels(
    assembly: Assembly, blocks: Sequence[int | None], captions: Sequence[str] = ()
) -> Labels:
    """What the cells of a record are called, see :func:`~.playback.block_of_cell`; ``captions`` of
    the start and of every step."""
    colour = {part.block.id: part.colour for part in block_parts(assembly)[0]}
    ids = [None if block is None else assembly.blocks[block].id for block in blocks]
    placed = {step.place for step in assembly.steps}
    return Labels(
        tuple(name or "an obstacle or a block that is not in use" for name in ids),
        tuple("soft" if name is None else colour[name] for name in ids),
        tuple(name not in placed for name in ids),
        tuple(captions),
    )


def scene_data(
    parts: Sequence[ScenePart],
    shapes: Sequence[Block],
    layers: Sequence[float],
    steps: int,
    joint: Joint = DRY,
) -> dict[str, Any]:
    """What the scripts need to draw an assembly: metres, world frame.

    Args:
        parts: of :func:`block_parts`, with shapes and layers.
        steps: how many there are.
        joint: of the assembly, whose blocks may have knobs.
    """
    kinds, colours = _numbered(part.kind for part in parts), _numbered(p.colour for p in parts)
    # Edge of the cube with the volume of a median block [m].
    size = float(np.median([part.block.volume for part in parts])) ** (1 / 3)
    return {
        "edge": rounded(size),
        "floor": rounded(min(part.origin[2] for part in parts)),
        "steps": steps,
        "kinds": list(kinds),
        "colours": list(colours),
        "heights": [rounded(height) for height in layers],
        "shapes": _shape_data(shapes),
        "blocks": [
            [
                part.shape,
                *map(rounded, part.origin),
                kinds[part.kind],
                colours[part.colour],
                part.layer,
                part.placed,
                part.removed,
                part.block.id,
            ]
            for part in parts
        ],
        "holds": [[number, *ends] for number, part in enumerate(parts) for ends in part.holds],
        "covers": side_covers([part.block for part in parts]),
        "knobs": [knobs_on(block, joint)[:, :2].round(6).tolist() for block in shapes],
        "knob": [share * joint.pitch[0] for share in (RADIUS, HEIGHT)],
    }


def nothing_to_draw(size: float) -> dict[str, Any]:
    """The same without a block; ``size`` of a usual one [m]."""
    shapes = {
        "vertices": packed(np.zeros((1, 3)), np.uint16),
        "triangles": "",
        "wide": False,
        "first": [0],
        "faces": [0],
        "sections": [],
        "widths": [],
    }
    lists = ("kinds", "colours", "heights", "blocks", "holds", "covers", "knobs")
    return {
        "edge": rounded(size),
        "floor": 0.0,
        "steps": 0,
        "shapes": shapes,
        **{name: [] for name in lists},
    }


def first_view(
    blocks: Iterable[Block], arms: Sequence[np.ndarray] = (), front: bool = False
) -> list[float]:
    """From where a page is seen first, above all: the wide side of what is built faces the viewer,
    a little from one side. An arm stands behind it or beside it, not before it. Of what was drawn
    from the front that side is seen, unless an arm hides it.

    Args:
        arms: float64[2] of each, where it stands [m, world].
        front: whether what is built was drawn from the front alone (:func:`drawn_from_front`).

    Returns:
        angle [rad] about z of the side that faces the viewer, 0 for the one towards -y, in whole
        steps of 15 degrees; how far to the right of its middle the viewer is, as a share of how far
        in front, and less than 0 to the left.
    """
    points = np.concatenate([block.vertices[:, :2] for block in blocks])
    middle = (points.min(0) + points.max(0)) / 2
    points = np.unique(points.round(6), axis=0) - middle
    along = np.linalg.eigh(points.T @ points)[1][:, 1]
    ahead = np.sign([along[0], -along[1]]).astype(int)[np.abs(along) > 1e-6]
    along *= int(ahead[0])
    across = np.array([-along[1], along[0]])
    wide = float(np.ptp(points @ along)) > _WIDE * float(np.ptp(points @ across))
    away = arms[0] - middle if arms else np.zeros(2)
    if not wide and not arms:
        along, aside = np.array([1.0, 0.0]), -ASIDE
    elif not wide:  # The arm stands on the left.
        along, aside = -away, ASIDE
    else:
        if away @ across < -abs(float(away @ along)):
            along, across = -along, -across
        beside, behind = float(away @ along), float(away @ across)
        left = beside < 0.25 * behind
        if behind > abs(beside):
            aside = -_MORE_ASIDE if left else _MORE_ASIDE
        else:
            aside = ASIDE if beside < 0 else -ASIDE
    step = math.radians(15)
    turn = step * round(math.atan2(along[1], along[0]) / step)
    found = [rounded(turn), aside]
    if front and is_behind(found):
        before = _before_front(points, [arm - middle for arm in arms])
        return found if before is None else [0.0, before]
    return found


def drawn_from_front(drawn: Sequence[str] | None) -> bool:
    """Whether sides that were drawn have a front and no back, which would be seen as drawn, too."""
    return drawn is not None and "front" in drawn and "back" not in drawn


def is_behind(view: Sequence[float]) -> bool:
    """Whether the viewer of :func:`first_view` stands behind, where y is larger."""
    turn, aside = view
    return math.sin(turn) * aside - math.cos(turn) > 1e-6


def _before_front(points: np.ndarray, arms: Sequence[np.ndarray]) -> float | None:
    """How far to the right of the middle one looks at the front with no arm before it, as a share
    of how far in front; None where an arm is before it from everywhere.

    Args:
        points: float64[n, 2] of what is built, from its middle [m].
        arms: float64[2] of each from there [m].
    """
    for share in BESIDE:
        for aside in (share, -share):
            right = np.array([1.0, aside]) / math.hypot(1.0, aside)
            toward = np.array([right[1], -right[0]])
            seen = points @ right
            hidden = (
                float(arm @ toward) > 0
                and seen.min() - _ARM < float(arm @ right) < seen.max() + _ARM
                for arm in arms
            )
            if not any(hidden):
                return aside
    return None


def mark_data(marks: Sequence[Mark]) -> list[dict[str, Any]]:
    """Marks for the scripts."""
    return [{"words": mark.words, "boxes": mark.boxes} for mark in marks]


def scale_data(origin: np.ndarray, extent: np.ndarray) -> dict[str, Any]:
    """The grid of the plans of layers: where O is, how far its lines are apart and how many there
    are along x and y; at most eight a side.

    Args:
        origin: float64[3], O [m, world].
        extent: float64[3], of the structure [m].
    """
    wanted = float(extent[:2].max()) / 8
    power = 10.0 ** math.floor(math.log10(wanted))
    step = next(k * power for k in (1, 2, 5, 10) if k * power >= wanted * (1 - 1e-9))
    count = [int(float(v) / step + 0.02) for v in extent[:2]]
    return {"origin": [rounded(v) for v in origin[:2]], "step": rounded(step), "count": count}


def _numbered(names: Iterable[str]) -> dict[str, int]:
    """The different names, numbered in the order in which they first appear."""
    return {name: k for k, name in enumerate(dict.fromkeys(names))}


def block_parts(
    assembly: Assembly, moving: Collection[str] = ()
) -> tuple[list[ScenePart], list[Block], list[float]]:
    """The stays of all blocks, one block of every shape, and where layers begin [m].

    What is not built is there after a step that never comes.
    """
    never = len(assembly.steps) + 1
    stays = {id_: [_Stay(never)] for id_ in assembly.not_built}
    there = zip(assembly.blocks, assembly.at_first, strict=True)
    stays |= {block.id: [_Stay(0)] for block, here in there if here}
    for number, step in enumerate(assembly.steps, 1):
        stays.setdefault(step.block, [])
        if step.action == "place":
            stays[step.block].append(_Stay(number))
        elif step.action == "remove":
            stays[step.block][-1].removed = number
        elif step.action == "hold":
            stays[step.block][-1].holds.append((number, never))
        else:
            holds = stays[step.block][-1].holds
            holds[-1] = (holds[-1][0], number)
    bottoms = np.array([block.vertices[:, 2].min() for block in assembly.blocks])
    heights = np.array([np.ptp(block.vertices[:, 2]) for block in assembly.blocks])
    built = np.array([any(s.placed or not s.removed for s in stays[b.id]) for b in assembly.blocks])
    built |= not built.any()
    layers = _layers(bottoms[built], heights[built].tolist())
    numbers: dict[Any, int] = {}
    shapes: list[Block] = []
    parts = list[ScenePart]()
    level = np.maximum(np.searchsorted(layers, bottoms, side="right") - 1, 0)
    for block, layer, (kind, colour) in zip(
        assembly.blocks, level.tolist(), kinds_and_colours(assembly), strict=True
    ):
        origin = block.vertices.min(0)
        relative = block.vertices - origin
        key = ((1e6 * relative).round().astype(np.int64).tobytes(), block.faces)
        if key not in numbers:
            numbers[key] = len(shapes)
            shapes.append(block)
        colour = "bad" if block.id in moving else colour
        for stay in stays[block.id]:
            parts.append(
                ScenePart(
                    block,
                    numbers[key],
                    origin,
                    kind,
                    colour,
                    layer,
                    stay.placed,
                    stay.removed,
                    tuple(stay.holds),
                )
            )
    return parts, shapes, layers


@dataclass
class _Stay:
    """When a block is there: the fields of :class:`ScenePart`."""

    placed: int
    removed: int = 0
    holds: list[tuple[int, int]] = field(default_factory=list[tuple[int, int]])


def _layers(bottoms: np.ndarray, heights: list[float]) -> list[float]:
    """Heights at which layers begin; in steps of a block where nearly every block has its own."""
    height = float(np.median(heights))
    levels = [float(bottoms.min())]
    for bottom in np.sort(bottoms).tolist():
        if bottom > levels[-1] + 0.02 * height:
            levels.append(bottom)
    count = max(math.ceil(float(np.ptp(bottoms)) / height), 1)
    if len(levels) > 4 * count:
        levels = (float(bottoms.min()) + height * np.arange(count + 1)).tolist()
    used = np.unique(np.searchsorted(np.array(levels) - 1e-9, bottoms, side="right") - 1)
    return [levels[k] - 1e-9 for k in used.tolist()]


def _shape_data(shapes: Sequence[Block]) -> dict[str, Any]:
    """Vertices and triangles of all shapes, one after the other, and their sections from below:
    bottom, top, rings and a point in it [m, from the smallest corner]."""
    vertices, triangles, cuts = list[np.ndarray](), list[np.ndarray](), list[list[Any]]()
    for block in shapes:
        points, faces = _triangles(block)
        vertices.append(points - block.vertices.min(0))
        triangles.append(faces)
        cuts.append([_drawn(one, block.vertices.min(0)) for one in sections(block)])
    wide = max(map(len, vertices)) >= 65536
    boxes = [np.ptp(block.vertices[:, :2], axis=0) for block in shapes]
    return {
        "vertices": packed(np.concatenate(vertices), np.uint16),
        "triangles": to_base64(np.concatenate(triangles).astype(np.uint32 if wide else np.uint16)),
        "wide": wide,
        "first": np.cumsum([0, *map(len, vertices)]).tolist(),
        "faces": np.cumsum([0, *map(len, triangles)]).tolist(),
        "sections": cuts,
        "widths": [rounded(float(size.min())) for size in boxes],
    }


def _triangles(block: Block) -> tuple[np.ndarray, np.ndarray]:
    """Surface as vertices float64[v, 3] [m] and triangles int[f, 3]."""
    if block.is_convex:
        corners = fan_triangles(block.vertices, block.faces).reshape(-1, 3)
        points, index = np.unique(corners, axis=0, return_inverse=True)
        return points, index.reshape(-1, 3)
    mesh: Any = to_manifold(block).to_mesh64()
    return np.asarray(mesh.vert_properties)[:, :3], np.asarray(mesh.tri_verts)


def _drawn(section: Section, corner: np.ndarray) -> list[Any]:
    """Bottom, top, rings and a point in it, from the smallest corner of the block."""
    x, y, z = corner.tolist()
    centre = section.area.centroid
    middle = centre if section.area.contains(centre) else section.area.representative_point()
    rings = [[[rounded(u - x), rounded(v - y)] for u, v in ring] for ring in section.rings]
    return [
        rounded(section.bottom - z),
        rounded(section.top - z),
        rings,
        [rounded(middle.x - x), rounded(middle.y - y)],
    ]


def side_covers(blocks: list[Block]) -> list[list[list[int]] | None]:
    """Of every box, the blocks that together cover each of its sides; the sides are not seen while
    all of these stand.

    Returns:
        for every block None, or six lists of block numbers, empty for a side that is seen: at the
        lower and upper end along x, y and z.
    """
    low = np.array([block.vertices.min(0) for block in blocks])
    high = np.array([block.vertices.max(0) for block in blocks])
    boxes = np.array(
        [
            len(b.vertices) == 8
            and bool((np.isclose(b.vertices, u) | np.isclose(b.vertices, v)).all())
            for b, u, v in zip(blocks, low, high, strict=True)
        ]
    )
    found: list[list[list[int]]] = [[[] for _ in range(6)] for _ in blocks]
    near = _COVERED * float((high - low)[boxes].min()) if boxes.any() else 0.0
    for axis in range(3):
        across = [(axis + 1) % 3, (axis + 2) % 3]
        ups = np.flatnonzero(boxes)[np.argsort(high[boxes, axis], kind="stable")]
        downs = np.flatnonzero(boxes)[np.argsort(low[boxes, axis], kind="stable")]
        begin, stop = (
            cast("np.ndarray", np.searchsorted(low[downs, axis], high[ups, axis] + off))
            for off in (-near, near)
        )
        covered = np.zeros((2, len(blocks)))
        numbers: list[int] = ups.tolist()
        for a, first, last in zip(numbers, begin.tolist(), stop.tolist(), strict=True):
            others = downs[first:last]
            shared = np.minimum(high[a], high[others]) - np.maximum(low[a], low[others])
            common = np.maximum(shared[:, across], 0.0).prod(1)
            touched: list[int] = others[common > 0].tolist()
            for b, size in zip(touched, common[common > 0], strict=True):
                found[a][2 * axis + 1].append(b)
                found[b][2 * axis].append(a)
                covered[0, b] += size
                covered[1, a] += size
        area = (high - low)[:, across].prod(1)
        for side in (0, 1):
            for k in np.flatnonzero(boxes & (covered[side] < (1 - _COVERED) * area)):
                found[k][2 * axis + side] = []
    return [
        sides if box and any(sides) else None
        for sides, box in zip(found, boxes.tolist(), strict=True)
    ]


def joint_data(forces: tuple[Contacts, np.ndarray | None]) -> dict[str, Any] | None:
    contacts, vectors = forces
    if not len(contacts.points):
        return None
    found: dict[str, Any] = {
        "points": packed(contacts.points, np.uint16),
        "start": contacts.start.tolist(),
    }
    if vectors is not None and (largest := float(np.linalg.norm(vectors, axis=1).max())) > 0:
        found |= {"forces": packed(vectors, np.uint16), "largest": largest}
    return found
