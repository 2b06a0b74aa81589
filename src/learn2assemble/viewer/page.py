"""The page of a plan or an assembly: blocks of any shape step by step, layer by layer, with their
joints, the target of a task, and the arm where one built it.

It holds thousands of blocks: in the 3-D view they are one mesh, and equal shapes are stored once.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Iterable, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from learn2assemble.assembly.appearance import (
    Section,
    colour_words,
    joint_width,
    kinds_and_colours,
    millimetres,
    sections,
    size_words,
)
from learn2assemble.assembly.blocks import Assembly, Block, fan_triangles, to_manifold
from learn2assemble.assembly.contacts import Contacts
from learn2assemble.errors import InputError
from learn2assemble.files import write_file
from learn2assemble.viewer.arm import NEAR_VIEW, Labels, arm_data, arm_section, arm_values
from learn2assemble.viewer.html import (
    NUMBER,
    fact_list,
    packed,
    row,
    speed_options,
    stand_alone,
    to_base64,
)
from learn2assemble.viewer.playback import Playback
from learn2assemble.viewer.words import arm_summary, percent, placement

if TYPE_CHECKING:
    from learn2assemble.planning.plan import Plan, PlanTarget, SearchStage, Step

TONES = {
    "complete": "good", "stands": "good", "within reach": "good", "incomplete": "warn",
    "stands only with tight joints": "warn", "not certain": "warn",
    "out of reach": "bad", "refused": "bad", "falls": "bad",
}  # fmt: skip
STANDARD_GRAVITY = 9.80665
"""[m/s²]"""
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
    colour: str
    """``#rrggbb``, or the name of a colour of the style sheet."""
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
    plan: Plan | None = None,
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
        plan: of the assembly, whose targets, goals and obstacles the 3-D view shows, with what was
            tried for it and what an arm did, which the page plays.

    Raises:
        InputError: where the notes do not fit the steps.
    """
    steps = assembly.steps
    if step_notes and len(step_notes) != len(steps):
        raise InputError("step_notes", len(step_notes), f"one for each of {len(steps)} steps")
    notes = list(step_notes) or [StepNote()] * len(steps)
    design = None if plan is None else plan.design
    targets, boxes = ((), ()) if design is None else (design.targets, design.boxes)
    parts, shapes, layers = _parts(assembly, moving)
    distinct = list({part.block.id: part for part in parts}.values())
    of_step = {number: part for part in parts for number in (part.placed, part.removed)}
    stepped = [of_step[number] for number in range(1, len(steps) + 1)]
    standing = sum(not part.placed for part in parts)
    captions = [f"Start: {_count(standing, 'block')} in place."]
    captions += map(_caption, range(1, len(steps) + 1), stepped, notes)
    kinds, colours = _numbered(part.kind for part in parts), _numbered(p.colour for p in parts)
    # Edge of the cube with the volume of a median block [m].
    size = _round(float(np.median([block.volume for block in assembly.blocks])) ** (1 / 3))
    origin = np.min([block.vertices.min(0) for block in assembly.finished.blocks], 0)
    joint = joint_width(assembly)
    low = np.min([part.origin for part in parts], 0)
    high = np.max([part.block.vertices.max(0) for part in parts], 0)
    data = {
        "edge": size,
        "floor": _round(low[2]),
        "steps": len(steps),
        "captions": captions,
        "kinds": list(kinds),
        "colours": list(colours),
        "layers": _layer_words(distinct, layers),
        "heights": [_round(height) for height in layers],
        "shapes": _shape_data(shapes),
        "blocks": [
            [part.shape, *map(_round, part.origin), kinds[part.kind], colours[part.colour],
             part.layer, part.placed, part.removed, part.block.id]
            for part in parts
        ],
        "covers": _covers([part.block for part in parts]),
        "joints": _joints(forces) if forces is not None else None,
        "targets": [
            {"outline": target.outline, "outward": np.array(target.outward)} for target in targets
        ],
        "boxes": [
            {"what": box.what, "low": np.array(box.low), "high": np.array(box.high)}
            for box in boxes
        ],
    }  # fmt: skip
    covered = any(note.coverage is not None for note in notes)
    pad = 300 * size
    width, depth = 1000 * (high - low)[:2] + 2 * pad
    count = str(len(steps))
    wanted = _SECONDS_PER_STEP * len(steps) / _LONGEST
    tone = f' <span class="status {TONES.get(status, "warn")}">{escape(status)}</span>'
    page = {
        "title": escape(title),
        "eyebrow": "Assembly" + tone * bool(status),
        "reason": f'<div class="reason" role="alert"><p>{escape(reason)}</p></div>' * bool(reason),
        "summary": escape(_summary(assembly, distinct, high - low)),
        "facts": fact_list(facts),
        "body": "movable assembly" if steps else "fixed assembly",
        "views": "".join(
            f'<button type="button" data-side="{k}">{escape(target.name.capitalize())}</button>'
            for k, target in enumerate(targets)
        ) + '<button type="button" id="from-above">From above</button>',
        "slider_last": count,
        "slider_step": "1",
        "slider_name": "Step",
        "count": f"{count} / {count}",
        "speeds": speed_options(_SPEEDS, next((s for s in _SPEEDS if s >= max(wanted, 1)), 64)),
        "caption": escape(captions[-1]),
        "legend": _legend(parts) + _entry("target", "target outline") * bool(targets)
        + _entry("target", "to be filled, reached or loaded")
        * any(box.what != "obstacle" for box in boxes)
        + _entry("bad", "obstacle") * any(box.what == "obstacle" for box in boxes),
        "under_legend": _toggles(data["joints"]),
        "layer_box": f"{1000 * low[0] - pad:.1f} {-1000 * high[1] - pad:.1f} "
        f"{width:.1f} {depth:.1f}",
        "layers": str(len(layers)),
        "last_layer": escape(data["layers"][-1]),
        "bill": _bill(distinct, joint),
        "joint": f" Vertical joints are {millimetres(joint)} wide; the nominal size of a block is "
        "the block itself and one joint." * bool(joint),
        "steps": "".join(_row(k, part, note, covered, origin, joint)
                         for k, (part, note) in enumerate(zip(stepped, notes, strict=True), 1))
        or '<tr><td colspan="10">The order of building is not given.</td></tr>',
        "coverage": '<th class="number">Coverage</th>' * covered,
        "more": "<th></th>" * covered,
    }  # fmt: skip
    scripts = _SCRIPTS
    if plan is not None:
        page["tried"] = _tried(plan.search.attempts if plan.search else ())
        told = (("Verified by", plan.verified_by), ("Made from", plan.design.source))
        page["source"] = escape(" ".join(f"{name}: {words}." for name, words in told if words))
    if plan is not None and plan.record is not None and plan.record.steps:
        playback = Playback(plan.record, plan)
        labels = cell_labels(assembly, playback.blocks, captions)
        data["arm"] = arm_data(playback, labels)
        page |= {**arm_values(playback), "body": "movable assembly with-arm"}
        page["views"] += NEAR_VIEW
        page["legend"] += _entry("waiting", "waiting block")
        page["legend"] += _entry("goal", "where this step puts it")
        page["legend"] += _entry("soft", "not in use") * (None in playback.blocks)
        page["summary"] += escape(
            f" Built by the arm {playback.record.arm.name}: {arm_summary(playback.record)}."
        )
        page["attempts"] = arm_section(playback, labels.names)
        scripts = (*_SCRIPTS[:-1], "arm.js", _SCRIPTS[-1])
    return stand_alone(page, data, scripts)


def cell_labels(
    assembly: Assembly, blocks: Sequence[int | None], captions: Sequence[str] = ()
) -> Labels:
    """What the cells of a record are called, see :func:`~.playback.block_of_cell`; ``captions`` of
    the start and of every step."""
    colour = {part.block.id: part.colour for part in _parts(assembly)[0]}
    ids = [None if block is None else assembly.blocks[block].id for block in blocks]
    placed = {step.place for step in assembly.steps}
    return Labels(
        tuple(name or "an obstacle or a block that is not in use" for name in ids),
        tuple("soft" if name is None else colour[name] for name in ids),
        tuple(name not in placed for name in ids),
        tuple(captions),
    )


def _numbered(names: Iterable[str]) -> dict[str, int]:
    """The different names, numbered in the order in which they first appear."""
    return {name: k for k, name in enumerate(dict.fromkeys(names))}


def _parts(
    assembly: Assembly, moving: Collection[str] = ()
) -> tuple[list[_Part], list[Block], list[float]]:
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
    parts = []
    level = np.searchsorted(layers, bottoms, side="right") - 1
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
        for placed, removed in stays.get(block.id, [[0, 0]]):
            parts.append(_Part(block, numbers[key], origin, kind, colour, layer, placed, removed))
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


def _shape_data(shapes: list[Block]) -> dict[str, Any]:
    """Vertices and triangles of all shapes, one after the other, and their sections from below:
    bottom, top, rings and a point in it [m, from the smallest corner]."""
    vertices, triangles, cuts = [], [], []
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


def _drawn(section: Section, corner: np.ndarray) -> list[Any]:
    """Bottom, top, rings and a point in it, from the smallest corner of the block."""
    x, y, z = corner.tolist()
    centre = section.area.centroid
    middle = centre if section.area.contains(centre) else section.area.representative_point()
    rings = [[[_round(u - x), _round(v - y)] for u, v in ring] for ring in section.rings]
    return [_round(section.bottom - z), _round(section.top - z), rings,
            [_round(middle.x - x), _round(middle.y - y)]]  # fmt: skip


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
        across = [(axis + 1) % 3, (axis + 2) % 3]
        ups = np.flatnonzero(boxes)[np.argsort(high[boxes, axis], kind="stable")]
        downs = np.flatnonzero(boxes)[np.argsort(low[boxes, axis], kind="stable")]
        begin, stop = (
            np.searchsorted(low[downs, axis], high[ups, axis] + off) for off in (-near, near)
        )
        covered = np.zeros((2, len(blocks)))
        for a, first, last in zip(ups.tolist(), begin.tolist(), stop.tolist(), strict=True):
            others = downs[first:last]
            shared = np.minimum(high[a], high[others]) - np.maximum(low[a], low[others])
            common = np.maximum(shared[:, across], 0.0).prod(1)
            for b, size in zip(others[common > 0].tolist(), common[common > 0], strict=True):
                found[a][2 * axis + 1].append(b)
                found[b][2 * axis].append(a)
                covered[0, b] += size
                covered[1, a] += size
        area = (high - low)[:, across].prod(1)
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


def _summary(assembly: Assembly, parts: list[_Part], extent: np.ndarray) -> str:
    props = sum(part.block.prop for part in parts)
    supports = sum(part.block.support for part in parts)
    words = [_count(len(parts) - props - supports, "block"), millimetres(*extent)]
    words += [_count(props, "prop")] if props else []
    words += [_count(supports, "fixed support")] if supports else []
    words += [_count(len(assembly.steps), "step")] if assembly.steps else []
    return ", ".join([*words, f"friction {assembly.friction:g}"]) + "."


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"


def _caption(number: int, part: _Part, note: StepNote) -> str:
    action, prop = "Remove" if part.removed == number else "Place", "prop " * part.block.prop
    text = f"{action} {prop}{part.block.id} ({part.kind}), layer {part.layer + 1}."
    if note.proof:
        text += f" Stands: {note.proof}."
    if note.margin_g is not None:
        push = note.margin_g * STANDARD_GRAVITY * part.block.mass
        text += (
            f" Withstands a sideways push of {note.margin_g:.2f} g in every direction, about "
            f"{push:.2g} N on this block, or a tilt of {_tilt(note.margin_g)}°."
        )
    if note.coverage is not None:
        text += f" {percent(note.coverage)} covered."
    return f"{text} {note.more}".strip()


def _tilt(margin_g: float) -> str:
    """Tilt [deg] with the same ratio of sideways to downward acceleration."""
    return f"{math.degrees(math.atan(margin_g)):.1f}"


def _row(
    number: int, part: _Part, note: StepNote, covered: bool, origin: np.ndarray, joint: float
) -> str:
    """A step in the table; with columns of a target where one is covered.

    Args:
        origin: float64[3], from where positions are told [m].
        joint: width of vertical joints, which the nominal size of a block has in it [m].
    """
    margin = note.margin_g
    cells = [
        str(number), "remove" if part.removed == number else "place",
        escape(part.block.id) + ' <span class="tag">prop</span>' * part.block.prop,
        escape(part.kind), str(part.layer + 1), _millimetres(part.origin - origin),
        _nominal(part.block, joint), escape(note.proof) or "–",
        "–" if margin is None else f"{margin:.2f}", "–" if margin is None else _tilt(margin),
    ]  # fmt: skip
    if covered:
        cells += [percent(note.coverage), escape(note.more)]
    numbers: dict[int, str] = dict.fromkeys((4, 5, 6, 8, 9, 10), NUMBER)
    return row(cells, numbers, f'data-step="{number}"', f"Show step {number}")


def _millimetres(lengths: np.ndarray) -> str:
    """Three lengths [m] as millimetres, to a tenth."""
    words = (f"{1000 * v + 0.0:.1f}".removesuffix(".0") for v in lengths.tolist())
    return ", ".join("0" if word == "-0" else word for word in words)


def _nominal(block: Block, joint: float) -> str:
    """Size with the joint that belongs to the block."""
    size = np.ptp(block.vertices, axis=0) + np.array([joint, joint, 0])
    return millimetres(*size).removesuffix(" mm")


def _bill(parts: list[_Part], joint: float) -> str:
    """Bill of blocks: how many of each kind and colour, nominal size, block itself, and mass."""
    groups: dict[tuple[str, str, str], list[_Part]] = {}
    for part in parts:
        use = "support" if part.block.support else "prop" if part.block.prop else "block"
        groups.setdefault((part.kind, colour_words(part.block), use), []).append(part)
    rows = []
    for (kind, colour, use), members in sorted(groups.items()):
        sizes = {size_words(part.block) for part in members}
        size = sizes.pop() if len(sizes) == 1 else "several sizes"
        mass = f"{sum(part.block.mass for part in members):.3g} kg"
        nominal = {_nominal(part.block, joint) for part in members}
        told = f"{nominal.pop()} mm" if len(nominal) == 1 else "several sizes"
        named = f"{_swatch(colour)}{escape(kind)} {colour}" if colour else escape(kind)
        cells = [named, use, str(len(members)), told, size, mass]
        rows.append(row(cells, {2: NUMBER, 5: NUMBER}))
    return "".join(rows)


def _layer_words(parts: list[_Part], layers: list[float]) -> list[str]:
    """What belongs to every layer, e.g. ``Layer 2 of 9, from 50 mm: 4 of 2x4, 1 of 1x2``."""
    counts = [Counter(part.kind for part in parts if part.layer == k) for k in range(len(layers))]
    return [
        f"Layer {k + 1} of {len(layers)}, from {millimetres(height - layers[0])}: "
        + ", ".join(f"{number} of {kind}" for kind, number in counts[k].most_common())
        for k, height in enumerate(layers)
    ]


def _legend(parts: list[_Part]) -> str:
    """Kinds by colour; the swatches are SVG, whose colours need no style sheet."""
    words = {"prop": "prop, removed again", "support": "fixed support", "bad": "starts to move"}
    named: dict[str, dict[str, None]] = {}
    for part in parts:
        named.setdefault(part.colour, {})[words.get(part.colour, part.kind)] = None
    current = any(part.placed for part in parts)
    text = _entry("current", "block of this step") * current
    for colour, kinds in list(named.items())[:16]:
        several = ", ".join(list(kinds)[:3]) + ", …" * (len(kinds) > 3)
        text += f"<li>{_swatch(colour)}{escape(several)}</li>"
    return text


def _swatch(colour: str) -> str:
    """A square of a colour: ``#rrggbb``, or a name of the style sheet."""
    paint = f'fill="{colour}"' if colour.startswith("#") else f'class="{colour}"'
    return f'<svg class="swatch" viewBox="0 0 14 14"><rect width="14" height="14" {paint}/></svg>'


def _entry(name: str, words: str) -> str:
    """An entry of the legend, by the name of its style."""
    return f'<li><i class="{name}"></i>{words}</li>'


def _toggles(joints: dict[str, Any] | None) -> str:
    names = ["joints", "forces"] if joints and "forces" in joints else ["joints"] * bool(joints)
    boxes = "".join(
        f'<label><input type="checkbox" id="show-{name}"> {name}</label>' for name in names
    )
    note = " of the finished structure" if boxes else ""
    return f'<p class="toggles">{boxes}{note}</p><p class="picked" id="picked" role="status"></p>'


def _tried(stages: Sequence[SearchStage]) -> str:
    """What the planner tried, as a table; nothing where it tried nothing."""
    rows = "".join(
        row([escape(item.stage), escape(item.result), f"{item.seconds:.2f} s"], {2: NUMBER})
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
    if plan.assembly is None and not plan.found_nothing:
        raise InputError("plan", "no blocks", "assembly.json beside plan.json")
    used, available = plan.blocks.used, plan.blocks.available
    targets = plan.design.targets
    props = sum(step.prop and step.action == "place" for step in plan.steps)
    facts = [
        ("planner", plan.planner), ("agent", plan.agent),
        ("search", plan.search.needed if plan.search and targets else None), ("kit", plan.kit),
        ("steps", str(len(plan.steps))),
        ("blocks", f"{used} of {available}" if targets else str(used)),
        ("props", str(props) if props else None),
    ]  # fmt: skip
    if targets:
        needed = percent(plan.design.success_threshold)
        facts.append(("covered", f"{percent(plan.coverage)} of the target ({needed} needed)"))
    if (cells := plan.cells) is not None:
        words = f"{cells.wanted} wanted, {cells.missing} open, {cells.outside} outside"
        if cells.other_colour is not None:
            words += f", {cells.other_colour} in a block of another colour"
        facts.append(("cells", words))
    if plan.design.iou is not None:
        facts.append(("drawing and cells in common", f"{plan.design.iou:.1%}"))
    if plan.margin_g is not None:
        facts.append(("weakest step withstands", f"{plan.margin_g:.3f} g sideways"))
    facts += [(f"proven for {what}", words) for what, words in plan.proven_for.items()]
    if plan.assembly is None:
        write_file(path, _page_of_nothing(plan, [(a, b) for a, b in facts if b]), "page")
        return
    text = render_assembly_page(
        plan.assembly, title=plan.design.name, facts=[(a, b) for a, b in facts if b],
        step_notes=[_note(step, targets) for step in plan.steps],
        status=plan.status, reason=plan.reason or "", plan=plan,
    )  # fmt: skip
    write_file(path, text, "page")


def _page_of_nothing(plan: Plan, facts: Sequence[tuple[str, str]]) -> str:
    """The page of a plan for which no block was found: why, and what was tried."""
    tone = f' <span class="status {TONES[plan.status]}">{escape(plan.status)}</span>'
    source = plan.design.source
    page = {
        "title": escape(plan.design.name),
        "eyebrow": "Assembly" + tone,
        "reason": f'<div class="reason" role="alert"><p>{escape(plan.reason or "")}</p></div>',
        "facts": fact_list(facts),
        "tried": _tried(plan.search.attempts if plan.search else ()),
        "source": escape(f"Made from: {source}.") if source else "",
    }
    return stand_alone(page, {}, (), "no_blocks.html")


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
