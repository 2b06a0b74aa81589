"""The page of a plan or an assembly: blocks of any shape step by step, layer by layer, with their
joints, the target of a task, and the arm where one built it.

It holds thousands of blocks: in the 3-D view they are one mesh, and equal shapes are stored once.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from learn2assemble.assembly.blocks import Assembly, Block, fan_triangles, to_manifold
from learn2assemble.assembly.contacts import Contacts
from learn2assemble.errors import InputError
from learn2assemble.files import write_file
from learn2assemble.viewer.arm import (
    LEGEND,
    NEAR_VIEW,
    Labels,
    arm_data,
    arm_section,
    arm_values,
)
from learn2assemble.viewer.html import (
    fact_list,
    fill,
    packed,
    speed_options,
    stand_alone,
    to_base64,
)
from learn2assemble.viewer.playback import Playback, block_of_cell
from learn2assemble.viewer.words import arm_summary, percent, placement

if TYPE_CHECKING:
    from learn2assemble.planning.plan import Plan, PlanBox, PlanTarget, SearchStage, Step

PALETTE = (
    "#c96f4a", "#ecca90", "#8fae7a", "#b98bb0", "#d8a13f", "#7f9fa3", "#a88468", "#c7cf8b",
    "#d99a94", "#8d8fb5", "#6f9a86", "#b7b2a6",
)  # fmt: skip
"""Colours of kinds, in the order in which they first appear."""
TONES = {
    "complete": "good", "stands": "good", "within reach": "good", "incomplete": "warn",
    "stands only with tight joints": "warn", "out of reach": "bad", "refused": "bad",
    "falls": "bad",
}  # fmt: skip
_SPEEDS = (0.5, 1, 2, 4, 8, 16, 32, 64)
_LONGEST = 60.0
"""The chosen speed shows all steps within this time [s]."""
_SECONDS_PER_STEP = 1.1
_COVERED = 0.03
"""Share of a side that may be left open where it counts as covered, and how far apart sides that
touch may be, as a share of the smallest edge."""
_SCRIPTS = ("three.bundle.js", "view.js", "stage.js", "timeline.js")


class StepNote(NamedTuple):
    """What is known about the state after a step."""

    proof: str = ""
    """How it was proven to stand."""
    margin_g: float | None = None
    """Sideways acceleration it withstands [g]."""
    coverage: float | None = None
    """Share of what is wanted that is filled."""
    more: str = ""
    """Anything else: where the block goes, which share of each side of a target is covered."""


class _Part(NamedTuple):
    """One stay of a block in the structure; only props may have several."""

    block: Block
    shape: int
    origin: np.ndarray
    """float64[3]: lower corner of its bounding box [m]."""
    kind: str
    layer: int
    placed: int
    """The step that places it; 0: it stands from the start."""
    removed: int
    """The step that removes it again, or 0."""


def render_assembly_page(
    assembly: Assembly,
    *,
    title: str,
    facts: Sequence[tuple[str, str]] = (),
    step_notes: Sequence[StepNote] = (),
    forces: tuple[Contacts, np.ndarray | None] | None = None,
    moving: Collection[str] = (),
    status: str = "",
    reason: str = "",
    playback: Playback | None = None,
    blocks: Sequence[int | None] = (),
    targets: Sequence[PlanTarget] = (),
    boxes: Sequence[PlanBox] = (),
    tried: Sequence[SearchStage] = (),
    note: str = "",
) -> str:
    """The page of an assembly as the text of a stand-alone HTML file.

    ``#step=5`` behind its address opens it at step 5; without it the finished structure shows.

    Args:
        assembly: blocks and steps; blocks that no step places stand from the start.
        title: of the page.
        facts: name and value of each, for its head.
        step_notes: of every step of the assembly, or none.
        forces: contacts between the blocks of ``assembly.finished``, and float64[C, 3], the
            forces at their corners [N, world], where they are known.
        moving: ids of blocks that start to move; they are marked.
        status: shown beside the title, e.g. ``complete`` or ``stands only with tight joints``.
        reason: why it is not complete, or does not stand.
        playback: what an arm did, which the page plays.
        blocks: of every cell of the record its block, see :func:`~.playback.block_of_cell`.
        targets: outlines that the blocks shall cover, which the 3-D view shows.
        boxes: goals and obstacles, which the 3-D view shows.
        tried: by the planner, in order.
        note: for the foot of the page.

    Raises:
        InputError: where the notes do not fit the steps.
    """
    steps = assembly.steps
    if step_notes and len(step_notes) != len(steps):
        raise InputError("step_notes", len(step_notes), f"one for each of {len(steps)} steps")
    notes = list(step_notes) or [StepNote()] * len(steps)
    parts, shapes, layers = _parts(assembly)
    distinct = list({part.block.id: part for part in parts}.values())
    of_step = {number: part for part in parts for number in (part.placed, part.removed)}
    stepped = [of_step[number] for number in range(1, len(steps) + 1)]
    captions = [_start(parts), *map(_caption, range(1, len(steps) + 1), stepped, notes)]
    colours = _colours(parts, set(moving))
    kinds = list(dict.fromkeys(part.kind for part in parts))
    size = _typical_size(assembly)
    data = {
        "edge": size,
        "floor": _round(min(part.origin[2] for part in parts)),
        "steps": len(steps),
        "captions": captions,
        "kinds": kinds,
        "colours": list(dict.fromkeys(colours)),
        "layers": _layer_words(distinct, layers),
        "shapes": _shape_data(shapes),
        "blocks": _block_data(parts, kinds, colours),
        "covers": _covers([part.block for part in parts]),
        "joints": _joints(forces) if forces is not None else None,
        "targets": [
            {"outline": target.outline, "outward": list(map(_round, target.outward))}
            for target in targets
        ],
        "boxes": [
            {
                "what": box.what,
                "low": list(map(_round, box.low)),
                "high": list(map(_round, box.high)),
            }
            for box in boxes
        ],
    }
    labels = None
    if playback is not None:
        labels = _labels(assembly, parts, colours, captions, blocks)
        data["arm"] = arm_data(playback, labels)
    low, high = _extent([part.block for part in parts])
    covered = any(note.coverage is not None for note in notes)
    values = {
        "layer_box": _view_box(low, high, size),
        "layers": str(len(layers)),
        "last_layer": escape(data["layers"][-1]),
        "bill": _bill(distinct),
        "steps": _rows(stepped, notes),
        "coverage": '<th class="number">Coverage</th>' * covered,
        "more": "<th></th>" * covered,
        "tried": _tried(tried),
    }
    count = str(len(steps))
    wanted = _SECONDS_PER_STEP * len(steps) / _LONGEST
    tone = TONES.get(status, "warn")
    page = {
        "what": "assembly",
        "title": escape(title),
        "eyebrow": f'Assembly <span class="status {tone}">{escape(status)}</span>'
        if status else "Assembly",
        "reason": f'<div class="reason" role="alert"><p>{escape(reason)}</p></div>'
        if reason else "",
        "summary": escape(_summary(assembly, distinct, low, high)),
        "facts": fact_list((name, value, "") for name, value in facts),
        "body": "movable assembly" if steps else "fixed assembly",
        "shown": "the assembly",
        "views": _views(targets),
        "slider_last": count,
        "slider_step": "1",
        "slider_name": "Step",
        "count": f"{count} / {count}",
        "speeds": speed_options(_SPEEDS, next((s for s in _SPEEDS if s >= max(wanted, 1)), 64)),
        "caption": escape(captions[-1]),
        "legend": _legend(parts, colours) + _TARGET_LEGEND * bool(targets)
        + _GOAL_LEGEND * any(box.what != "obstacle" for box in boxes)
        + _OBSTACLE_LEGEND * any(box.what == "obstacle" for box in boxes),
        "under_legend": _toggles(data["joints"]),
        "view_note": "A click on a block names it.",
        "sections": fill("plan.html", values),
        "source": escape(note),
    }  # fmt: skip
    scripts = _SCRIPTS
    if playback is not None and labels is not None:
        page |= {**arm_values(playback), "body": "movable assembly with-arm"}
        page["views"] += NEAR_VIEW
        page["legend"] += LEGEND
        page["legend"] += '<li><i class="soft"></i>not in use</li>' * (None in blocks)
        page["summary"] += escape(
            f" Built by the arm {playback.record.arm.name}: {arm_summary(playback.record)}."
        )
        page["sections"] += arm_section(playback, labels.names)
        scripts = (*_SCRIPTS[:-1], "arm.js", _SCRIPTS[-1])
    return stand_alone(page, data, scripts)


def cell_labels(assembly: Assembly, blocks: Sequence[int | None]) -> Labels:
    """What cells of a record are called, without captions; see :func:`~.playback.block_of_cell`."""
    parts, _, _ = _parts(assembly)
    return _labels(assembly, parts, _colours(parts, set()), [], blocks)


def _labels(
    assembly: Assembly, parts: list[_Part], colours: list[str], captions: list[str],
    blocks: Sequence[int | None],
) -> Labels:  # fmt: skip
    """What the page calls the cells of a record."""
    colour = {part.block.id: colour for part, colour in zip(parts, colours, strict=True)}
    ids = [None if block is None else assembly.blocks[block].id for block in blocks]
    placed = {step.place for step in assembly.steps}
    return Labels(
        tuple(name or "an obstacle or a block that is not in use" for name in ids),
        tuple("soft" if name is None else colour[name] for name in ids),
        tuple(name not in placed for name in ids),
        tuple(captions),
    )


def _parts(assembly: Assembly) -> tuple[list[_Part], list[Block], list[float]]:
    """The stays of all blocks, one block of every shape, and where layers begin [m]."""
    stays: dict[str, list[list[int]]] = {}
    for number, step in enumerate(assembly.steps, 1):
        if step.place is not None:
            stays.setdefault(step.place, []).append([number, 0])
        else:
            stays[str(step.remove)][-1][1] = number
    bottoms = np.array([block.vertices[:, 2].min() for block in assembly.blocks])
    layers = _layers(bottoms, [float(np.ptp(block.vertices[:, 2])) for block in assembly.blocks])
    numbers: dict[Any, int] = {}
    shapes: list[Block] = []
    unnamed = {_size_words(block) for block in assembly.blocks if not block.kind}
    parts = []
    level = np.searchsorted(layers, bottoms, side="right") - 1
    for block, layer in zip(assembly.blocks, level.tolist(), strict=True):
        origin = block.vertices.min(0)
        relative = block.vertices - origin
        key = ((1e6 * relative).round().astype(np.int64).tobytes(), block.faces)
        if key not in numbers:
            numbers[key] = len(shapes)
            shapes.append(block)
        kind = block.kind or (_size_words(block) if len(unnamed) <= len(PALETTE) else "block")
        for placed, removed in stays.get(block.id, [[0, 0]]):
            parts.append(_Part(block, numbers[key], origin, kind, layer, placed, removed))
    return parts, shapes, layers


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


def _typical_size(assembly: Assembly) -> float:
    """Edge of the cube with the volume of a median block [m]."""
    return _round(float(np.median([block.volume for block in assembly.blocks])) ** (1 / 3))


def _extent(blocks: list[Block]) -> tuple[np.ndarray, np.ndarray]:
    low = np.min([block.vertices.min(0) for block in blocks], 0)
    return low, np.max([block.vertices.max(0) for block in blocks], 0)


def _size_words(block: Block) -> str:
    """Bounding box in millimetres, e.g. ``100 × 50 × 50 mm``."""
    return " × ".join(f"{1000 * v:.4g}" for v in np.ptp(block.vertices, axis=0)) + " mm"


def _colours(parts: list[_Part], moving: set[str]) -> list[str]:
    """Of every block: ``#rrggbb``, or the name of a colour of the style sheet."""
    plain = [p.kind for p in parts if not (p.block.prop or p.block.support or p.block.colour)]
    of_kind = {kind: PALETTE[k % len(PALETTE)] for k, kind in enumerate(dict.fromkeys(plain))}

    def colour(part: _Part) -> str:
        block = part.block
        if block.id in moving:
            return "bad"
        if block.prop or block.support:
            return "prop" if block.prop else "support"
        own = block.colour and "#{:02x}{:02x}{:02x}".format(*block.colour)
        return own or of_kind[part.kind]

    return [colour(part) for part in parts]


def _shape_data(shapes: list[Block]) -> dict[str, Any]:
    """Vertices and triangles of all shapes, one after the other, and their outlines from above."""
    vertices, triangles, outlines = [], [], []
    for block in shapes:
        points, faces = _triangles(block)
        vertices.append(points - block.vertices.min(0))
        triangles.append(faces)
        outlines.append(_outline(vertices[-1], faces, block.is_convex))
    wide = max(map(len, vertices)) >= 65536
    boxes = [np.ptp(block.vertices[:, :2], axis=0) for block in shapes]
    return {
        "vertices": packed(np.concatenate(vertices), np.uint16),
        "triangles": to_base64(np.concatenate(triangles).astype(np.uint32 if wide else np.uint16)),
        "wide": wide,
        "first": np.cumsum([0, *map(len, vertices)]).tolist(),
        "faces": np.cumsum([0, *map(len, triangles)]).tolist(),
        "outlines": [rings for rings, _ in outlines],
        "middles": [middle for _, middle in outlines],
        "widths": [_round(float(size.min())) for size in boxes],
    }


def _triangles(block: Block) -> tuple[np.ndarray, np.ndarray]:
    """Surface as vertices float64[v, 3] [m] and triangles int[f, 3]."""
    if block.is_convex:
        corners = fan_triangles(block.vertices, block.faces).reshape(-1, 3)
        points, index = np.unique(corners, axis=0, return_inverse=True)
        return points, index.reshape(-1, 3)
    mesh = to_manifold(block).to_mesh64()
    return np.asarray(mesh.vert_properties)[:, :3], np.asarray(mesh.tri_verts)


def _outline(
    points: np.ndarray, faces: np.ndarray, convex: bool
) -> tuple[list[list[list[float]]], list[float]]:
    """What a surface of triangles covers seen from above: its rings and a point in it [m]."""
    import shapely

    if convex:
        return _rings(shapely.MultiPoint(points[:, :2]).convex_hull)
    corners = points[faces]
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    up = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0] > 0
    # A hair wider and back, so that seams between triangles close.
    hair = 1e-4 * float(np.ptp(points[:, :2]))
    parts = shapely.buffer(shapely.polygons(corners[up, :, :2]), hair, join_style="mitre")
    return _rings(shapely.union_all(parts).buffer(-hair, join_style="mitre").simplify(hair))


def _rings(area: Any) -> tuple[list[list[list[float]]], list[float]]:
    """Of a plane area: its rings and a point in it."""
    rings = [r for p in getattr(area, "geoms", [area]) for r in (p.exterior, *p.interiors)]
    centre = area.centroid
    middle = centre if area.contains(centre) else area.representative_point()
    outline = [[[_round(x), _round(y)] for x, y in ring.coords[:-1]] for ring in rings]
    return outline, [_round(middle.x), _round(middle.y)]


def _block_data(parts: list[_Part], kinds: list[str], colours: list[str]) -> list[list[Any]]:
    kind = {name: k for k, name in enumerate(kinds)}
    colour = {name: k for k, name in enumerate(dict.fromkeys(colours))}
    return [
        [part.shape, *map(_round, part.origin), kind[part.kind], colour[own], part.layer,
         part.placed, part.removed, part.block.id]
        for part, own in zip(parts, colours, strict=True)
    ]  # fmt: skip


def _covers(blocks: list[Block]) -> list[list[list[int]] | None]:
    """Of every box, the blocks that together cover each of its sides; the sides are not seen while
    all of these stand.

    Returns:
        for every block None, or six lists of block numbers, empty for a side that is seen: at the
        lower and upper end along x, y and z.
    """
    low = np.array([block.vertices.min(0) for block in blocks])
    high = np.array([block.vertices.max(0) for block in blocks])
    boxes = np.array([
        len(b.vertices) == 8 and bool((np.isclose(b.vertices, u) | np.isclose(b.vertices, v)).all())
        for b, u, v in zip(blocks, low, high, strict=True)
    ])  # fmt: skip
    found: list[list[list[int]]] = [[[] for _ in range(6)] for _ in blocks]
    near = _COVERED * float((high - low)[boxes].min()) if boxes.any() else 0.0
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        ups = np.flatnonzero(boxes)[np.argsort(high[boxes, axis], kind="stable")]
        downs = np.flatnonzero(boxes)[np.argsort(low[boxes, axis], kind="stable")]
        begin = np.searchsorted(low[downs, axis], high[ups, axis] - near)
        stop = np.searchsorted(low[downs, axis], high[ups, axis] + near)
        area = (high[:, u] - low[:, u]) * (high[:, v] - low[:, v])
        covered = np.zeros((2, len(blocks)))
        for a, first, last in zip(ups.tolist(), begin.tolist(), stop.tolist(), strict=True):
            others = downs[first:last]
            common = np.ones(len(others))
            for k in (u, v):
                shared = np.minimum(high[a, k], high[others, k]) - np.maximum(
                    low[a, k], low[others, k]
                )
                common *= np.maximum(shared, 0.0)
            for b, size in zip(others[common > 0].tolist(), common[common > 0], strict=True):
                found[a][2 * axis + 1].append(b)
                found[b][2 * axis].append(a)
                covered[1, a] += size
                covered[0, b] += size
        for side in (0, 1):
            for k in np.flatnonzero(boxes & (covered[side] < (1 - _COVERED) * area)):
                found[k][2 * axis + side] = []
    return [sides if box and any(sides) else None
            for sides, box in zip(found, boxes.tolist(), strict=True)]  # fmt: skip


def _joints(forces: tuple[Contacts, np.ndarray | None]) -> dict[str, Any] | None:
    contacts, vectors = forces
    if not len(contacts.points):
        return None
    found: dict[str, Any] = {
        "points": packed(contacts.points, np.uint16), "start": contacts.start.tolist()
    }  # fmt: skip
    if vectors is not None and (largest := float(np.linalg.norm(vectors, axis=1).max())) > 0:
        found |= {"forces": packed(vectors, np.uint16), "largest": largest}
    return found


def _summary(assembly: Assembly, parts: list[_Part], low: np.ndarray, high: np.ndarray) -> str:
    props = sum(part.block.prop for part in parts)
    supports = sum(part.block.support for part in parts)
    size = " × ".join(f"{v:.3g}" for v in high - low)
    words = [_count(len(parts) - props - supports, "block"), f"{size} m"]
    words += [_count(props, "prop")] if props else []
    words += [_count(supports, "fixed support")] if supports else []
    words += [_count(len(assembly.steps), "step")] if assembly.steps else []
    return ", ".join([*words, f"friction {assembly.friction:g}"]) + "."


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"


def _start(parts: list[_Part]) -> str:
    standing = sum(not part.placed for part in parts)
    return f"Start: {_count(standing, 'block')} in place."


def _action(number: int, part: _Part) -> str:
    return "remove" if part.removed == number else "place"


def _caption(number: int, part: _Part, note: StepNote) -> str:
    prop = "prop " if part.block.prop else ""
    text = f"{_action(number, part).capitalize()} {prop}{part.block.id} ({part.kind})"
    text += f", layer {part.layer + 1}."
    if note.proof:
        text += f" Stands: {note.proof}."
    if note.margin_g is not None:
        text += f" Withstands {note.margin_g:.2f} g sideways or a tilt of {_tilt(note.margin_g)}°."
    if note.coverage is not None:
        text += f" {percent(note.coverage)} covered."
    return f"{text} {note.more}".strip()


def _tilt(margin_g: float) -> str:
    """Tilt [deg] with the same ratio of sideways to downward acceleration."""
    return f"{math.degrees(math.atan(margin_g)):.1f}"


def _rows(stepped: list[_Part], notes: list[StepNote]) -> str:
    rows, covered = [], any(note.coverage is not None for note in notes)
    for number, (part, note) in enumerate(zip(stepped, notes, strict=True), 1):
        tag = ' <span class="tag">prop</span>' if part.block.prop else ""
        margin = "–" if note.margin_g is None else f"{note.margin_g:.2f}"
        tilt = "–" if note.margin_g is None else _tilt(note.margin_g)
        rows.append(
            f'<tr data-step="{number}"><td><button type="button" data-step="{number}" '
            f'aria-label="Show step {number}">{number}</button></td>'
            f"<td>{_action(number, part)}</td><td>{escape(part.block.id)}{tag}</td>"
            f'<td>{escape(part.kind)}</td><td class="number">{part.layer + 1}</td>'
            f'<td>{escape(note.proof) or "–"}</td><td class="number">{margin}</td>'
            f'<td class="number">{tilt}</td>'
        )  # fmt: skip
        if covered:
            rows.append(
                f'<td class="number">{percent(note.coverage)}</td><td>{escape(note.more)}</td>'
            )
        rows.append("</tr>")
    return "".join(rows) or '<tr><td colspan="8">The order of building is not given.</td></tr>'


def _bill(parts: list[_Part]) -> str:
    """Bill of blocks: how many of each kind, size and mass."""
    groups: dict[tuple[str, str], list[_Part]] = {}
    for part in parts:
        use = "support" if part.block.support else "prop" if part.block.prop else "block"
        groups.setdefault((part.kind, use), []).append(part)
    rows = []
    for (kind, use), members in sorted(groups.items()):
        sizes = {_size_words(part.block) for part in members}
        size = sizes.pop() if len(sizes) == 1 else "several sizes"
        mass = sum(part.block.mass for part in members)
        rows.append(
            f'<tr><td>{escape(kind)}</td><td>{use}</td><td class="number">{len(members)}</td>'
            f'<td>{size}</td><td class="number">{mass:.3g} kg</td></tr>'
        )
    return "".join(rows)


def _layer_words(parts: list[_Part], layers: list[float]) -> list[str]:
    """What belongs to every layer, e.g. ``Layer 2 of 9, from 50 mm: 4 of 2x4, 1 of 1x2``."""
    counts = [Counter(part.kind for part in parts if part.layer == k) for k in range(len(layers))]
    return [
        f"Layer {k + 1} of {len(layers)}, from {1000 * (height - layers[0]):.4g} mm: "
        + ", ".join(f"{number} of {kind}" for kind, number in counts[k].most_common())
        for k, height in enumerate(layers)
    ]


def _view_box(low: np.ndarray, high: np.ndarray, size: float) -> str:
    pad = 300 * size
    width, height = 1000 * (high - low)[:2] + 2 * pad
    return f"{1000 * low[0] - pad:.1f} {-1000 * high[1] - pad:.1f} {width:.1f} {height:.1f}"


def _legend(parts: list[_Part], colours: list[str]) -> str:
    """Kinds by colour; the swatches are SVG, whose colours need no style sheet."""
    named: dict[str, list[str]] = {}
    for part, colour in zip(parts, colours, strict=True):
        words = {"prop": "prop, removed again", "support": "fixed support", "bad": "starts to move"}
        kinds = named.setdefault(colour, [])
        if (word := words.get(colour, part.kind)) not in kinds:
            kinds.append(word)
    rows = [
        (colour, ", ".join(kinds[:3]) + (", …" if len(kinds) > 3 else ""))
        for colour, kinds in list(named.items())[:16]
    ]
    swatch = '<svg class="swatch" viewBox="0 0 14 14"><rect width="14" height="14" {}/></svg>'
    current = any(part.placed for part in parts)
    return '<li><i class="current"></i>block of this step</li>' * current + "".join(
        f"<li>{swatch.format(_paint(colour))}{escape(words)}</li>" for colour, words in rows
    )


def _paint(colour: str) -> str:
    return f'fill="{colour}"' if colour.startswith("#") else f'class="{colour}"'


def _toggles(joints: dict[str, Any] | None) -> str:
    names = ["joints", "forces"] if joints and "forces" in joints else ["joints"] * bool(joints)
    boxes = "".join(
        f'<label><input type="checkbox" id="show-{name}"> {name}</label>' for name in names
    )
    note = " of the finished structure" if boxes else ""
    return f'<p class="toggles">{boxes}{note}</p><p class="picked" id="picked" role="status"></p>'


_GOAL_LEGEND = '<li><i class="target"></i>to be filled, reached or loaded</li>'
_OBSTACLE_LEGEND = '<li><i class="bad"></i>obstacle</li>'
_TARGET_LEGEND = '<li><i class="target"></i>target outline</li>'


def _views(targets: Sequence[PlanTarget]) -> str:
    sides = "".join(
        f'<button type="button" data-side="{k}">{escape(target.name.capitalize())}</button>'
        for k, target in enumerate(targets)
    )
    return sides + '<button type="button" id="from-above">From above</button>'


def _tried(stages: Sequence[SearchStage]) -> str:
    """What the planner tried, as a table; nothing where it tried nothing."""
    rows = "".join(
        f"<tr><td>{escape(item.stage)}</td><td>{escape(item.result)}</td>"
        f'<td class="number">{item.seconds:.2f} s</td></tr>'
        for item in stages
    )
    head = '<tr><th>Stage</th><th>Result</th><th class="number">Time</th></tr>'
    return (
        '<section class="more" aria-labelledby="tried-title"><h2 id="tried-title">What was tried'
        f'</h2><div class="scroll"><table><thead>{head}</thead><tbody>{rows}</tbody></table></div>'
        "</section>"
    ) * bool(rows)


def _round(value: float) -> float:
    """To a micrometre."""
    return round(float(value), 6) + 0.0


def write_plan_page(plan: Plan, path: Path) -> None:
    """The page of a plan: what was filled, what is proven, and every step.

    Raises:
        InputError: for a plan whose blocks are not known, and where ``path`` cannot be written.
    """
    if plan.assembly is None:
        raise InputError("plan", "no blocks", "assembly.json beside plan.json")
    record = plan.record if plan.record is not None and plan.record.steps else None
    used, available = plan.blocks.used, plan.blocks.available
    facts = [("planner", plan.planner or ""), ("agent", plan.agent or "")]
    facts.append(("search", plan.search.needed if plan.search and plan.design.targets else ""))
    facts += [("kit", plan.kit or ""), ("steps", str(len(plan.steps)))]
    facts.append(("blocks", f"{used} of {available}" if plan.design.targets else str(used)))
    props = sum(step.prop and step.action == "place" for step in plan.steps)
    facts.append(("props", str(props) if props else ""))
    if plan.design.targets:
        needed = percent(plan.design.success_threshold)
        facts.append(("covered", f"{percent(plan.coverage)} of the target ({needed} needed)"))
    if plan.cells is not None:
        cells = plan.cells
        words = f"{cells.wanted} wanted, {cells.missing} open, {cells.outside} outside"
        facts.append(("cells", words))
    if plan.design.iou is not None:
        facts.append(("drawing and cells in common", f"{plan.design.iou:.1%}"))
    if plan.margin_g is not None:
        facts.append(("weakest step withstands", f"{plan.margin_g:.3f} g sideways"))
    if plan.complete and plan.gap_range is not None:
        low, high = plan.gap_range
        facts.append(("proven for joints", f"{low * 1e3:g} to {high * 1e3:g} mm"))
    if plan.complete and plan.friction_range is not None:
        low, high = plan.friction_range
        upper = "more" if high >= 100 else f"{high:g}"
        facts.append(("proven for friction", f"{low:g} to {upper}"))
    targets = plan.design.targets
    text = render_assembly_page(
        plan.assembly, title=plan.design.name, facts=[(a, b) for a, b in facts if b],
        step_notes=[_note(step, targets) for step in plan.steps],
        status=plan.status, reason=plan.reason or "",
        playback=None if record is None else Playback(record, plan),
        blocks=[] if record is None else block_of_cell(record, plan), targets=targets,
        boxes=plan.design.boxes,
        tried=plan.search.attempts if plan.search else (),
        note=" ".join(
            f"{name}: {words}." for name, words in
            (("Verified by", plan.verified_by), ("Made from", plan.design.source)) if words
        ),
    )  # fmt: skip
    write_file(path, text, "page")


def _note(step: Step, targets: Sequence[PlanTarget]) -> StepNote:
    """What is said about a step of a plan."""
    where = placement(step)
    sides = [
        f"{target.name} {percent(share)}"
        for target, share in zip(targets, step.sides, strict=bool(step.sides))
    ] if len(targets) > 1 else []  # fmt: skip
    told = [where[:1].upper() + where[1:] if where else "", ", ".join(sides)]
    more = "; ".join(part for part in told if part)
    return StepNote(step.proof or "", step.margin_g, step.coverage, more and f"{more}.")
