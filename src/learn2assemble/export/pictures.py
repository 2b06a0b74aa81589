"""Pictures and words of instructions, without a format: cards and PDF draw and print them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple

import numpy as np

from learn2assemble.assembly.blocks import Assembly, Block
from learn2assemble.assembly.instructions.shapes import BlockShape
from learn2assemble.assembly.instructions.steps import (
    Group,
    Instructions,
    Placement,
    instructions,
)
from learn2assemble.assembly.instructions.words import (
    before_words,
    bill_words,
    corner_words,
    cut_list,
    done_words,
    facts,
    length_words,
    name_words,
    place_words,
    placement_words,
    steps_words,
    way_words,
)
from learn2assemble.export.projection import DrawnScene, Figure, project

_WAYS = np.array([(0, 0, 1), (0, -1, 0), (-1, 0, 0), (1, 0, 0), (0, 1, 0)], float)
"""Directions in which a prop comes and is taken away, those seen best first."""
_MOST_LARGER = 8.0
"""Shapes that are so many times as large as the smallest have a scale of their own."""
_MOST_LARGER_OF_NUMBERED = 3.0
"""The same where corners have numbers, which overlap in a small picture."""
_UP = np.array([0.0, 1.0])
"""In the drawing."""


@dataclass(frozen=True, eq=False)
class Grid:
    """Lines on a level with their distance from O."""

    lines: tuple[np.ndarray, ...]
    """float64[2, 2] each [m in the drawing]."""
    labels: tuple[tuple[np.ndarray, str, str], ...]
    """Where, what, and which side of the place it is written on: ``below``, ``left``."""


Mark = Literal["", "new", "gone", "held"]
"""How the edges of a block are drawn over all."""


_Arrow = tuple[np.ndarray, np.ndarray]
"""From where to where, float64[2] each [m in the drawing]."""


@dataclass(frozen=True, eq=False)
class Use:
    """A part of a block in a picture."""

    name: int
    """Of its figure in the scene."""
    at: np.ndarray
    colour: str | None
    """Of a new block or one that is held; None: it stood before."""
    mark: Mark = ""


@dataclass(frozen=True, eq=False)
class Picture:
    """What is drawn, from the back to the front; lengths in metres, y up."""

    low: np.ndarray
    """float64[2], corners of the view."""
    high: np.ndarray
    grid: Grid
    uses: tuple[Use, ...]
    outlines: tuple[Use, ...] = ()
    """Edges drawn over all, so that what is hidden is seen."""
    arrows: tuple[_Arrow, ...] = ()
    labels: tuple[tuple[np.ndarray, str], ...] = ()
    place: tuple[float, float, float, float] | None = None
    """Where the step is in the whole seen from above, x, y, width and depth as shares; None where
    all is shown."""
    within: tuple[float, float] | None = None
    """Width and height of what holds any picture of the same scale [m]; None where a picture has a
    scale of its own."""
    dots: tuple[np.ndarray, ...] = ()
    """float64[2] each: corner 1 of every block that is told by it."""

    @property
    def size(self) -> np.ndarray:
        """float64[2]: width and height [m]."""
        return self.high - self.low


@dataclass(frozen=True, eq=False)
class Card:
    """What one card tells, ready to be drawn."""

    heading: str
    """Its steps."""
    number: str
    """Which card of how many it is."""
    words: tuple[str, ...]
    wanted: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    picture: Picture
    group: Group


def shape_words(shape: BlockShape, picture: Picture) -> str:
    """What stands below the picture of a shape: its letter, and where its scale is another one."""
    return shape.letter if picture.within else f"{shape.letter} (smaller scale)"


@dataclass(eq=False)
class Booklet:
    """Cover and cards of an assembly."""

    told: Instructions
    scene: DrawnScene
    cards: list[Card]
    cover: Picture
    shapes: list[tuple[BlockShape, Picture]]
    spacing: float
    title: str
    facts: tuple[str, ...]
    bill: list[tuple[str, ...]] = field(default_factory=list[tuple[str, ...]])
    cuts: list[tuple[str, ...]] = field(default_factory=list[tuple[str, ...]])
    """The posts to cut."""
    start: list[tuple[str, ...]] = field(default_factory=list[tuple[str, ...]])
    corners: list[tuple[str, str]] = field(default_factory=list[tuple[str, str]])
    """Of every shape that is no box: its letter, and its corners."""

    @property
    def shape_room(self) -> float:
        """Share of the usual room that the picture of a shape has: less where there are many."""
        return 1.0 if len(self.shapes) <= 5 else 0.65


def booklet(assembly: Assembly) -> Booklet:
    """Cover and cards of an assembly."""
    told = instructions(assembly)
    scene = DrawnScene(told)
    spacing = _spacing(told, scene.usual)
    until = {p.block: p.number for p in told.placements if p.action == "remove"}
    whole = _grid((0, 0), tuple(told.extent[:2]), 0.0, spacing, float(told.extent[2]))
    common = _Common(told, scene, spacing, whole, told.layers, until, {})
    cards = list[Card]()
    for group, standing in zip(told.groups, scene.standing(), strict=True):
        cards.append(_card(common, group, standing))
    # Cards that show all are drawn at one scale, no higher than what they show.
    large = [k for k, card in enumerate(cards) if card.picture.place is None]
    for k, picture in zip(large, _framed([cards[k].picture for k in large]), strict=True):
        cards[k] = replace(cards[k], picture=picture)
    finished = {assembly.index(b.id) for b in assembly.finished.blocks}
    colours = {p.block: p.shape.colour for p in (*told.start, *told.placements)}
    uses = tuple(
        Use(d.name, d.at, colours.get(d.block)) for d in scene.drawn if d.block in finished
    )
    [cover] = _framed([_picture(scene, uses, whole)])
    book = Booklet(
        told,
        scene,
        cards,
        cover,
        _shape_pictures(told, scene),
        spacing,
        assembly.name or "Assembly",
        facts(told),
    )
    for line in told.bill:
        book.bill.append(bill_words(line))
        if words := corner_words(line.shape):
            book.corners.append((line.shape.letter, words))
    book.cuts = cut_list(told)
    book.start = [placement_words(p) for p in told.start]
    return book


class _Common(NamedTuple):
    """What the cards of a booklet share."""

    told: Instructions
    scene: DrawnScene
    spacing: float
    """Of the lines of a grid [m]."""
    whole: Grid
    layers: int
    """How many there are."""
    until: dict[int, int]
    """Number of the step that takes a block away again."""
    grids: dict[tuple[float, ...], Grid]
    """Of cards that do not show all, drawn once each."""


def _card(common: _Common, group: Group, standing: set[int]) -> Card:
    """A card.

    Args:
        standing: blocks that stand before it.
    """
    told, scene, spacing, whole, layers, until, grids = common
    shown, all_ = scene.shown(group, standing)
    marks: dict[int, Mark] = dict.fromkeys(group.in_hands, "held")
    # What stands is grey, but for props, which go again: they have one colour everywhere.
    colours = dict.fromkeys((k for k in shown if told.assembly.blocks[k].prop), "prop")
    colours |= dict.fromkeys(group.in_hands, "held")
    for p in group.placements:
        if p.action == "place":
            # What is new keeps its colour, and in a hand the outline of what is held.
            colours[p.block] = p.shape.colour
            marks.setdefault(p.block, "new")
        elif p.action == "remove":
            marks[p.block] = "gone"
        elif group.main.action == "release" and p.block not in group.in_hands:
            # Only where nothing else has a colour.
            colours[p.block] = p.shape.colour
    seen = shown | {p.block for p in group.placements} | group.held
    uses = tuple(
        Use(d.name, d.at, colours.get(d.block), marks.get(d.block, ""))
        for d in scene.parts_of(seen)
    )
    outlines = tuple(use for use in uses if use.mark)
    place, grid = None, whole
    if not all_:
        members = sorted(seen)
        # In wide steps, so that many cards share a grid.
        wide = 4 * spacing
        low = np.floor(scene.low[members].min(0) / wide) * wide
        high = np.ceil(scene.high[members].max(0) / wide) * wide
        low[:2] = np.maximum(low[:2], 0)
        high[0] = min(high[0], np.ceil(told.extent[0] / spacing - 1e-6) * spacing)
        high[1] = min(high[1], told.extent[1])
        level = float(scene.low[members][:, 2].min())
        key = (*low[:2].round(6), *high[:2].round(6), round(level, 6))
        if key not in grids:
            grids[key] = _grid(tuple(low[:2]), tuple(high[:2]), level, spacing, 0.0)
        grid = grids[key]
        new = [p.block for p in group.placements]
        corner, size = (
            scene.low[new].min(0)[:2],
            np.ptp(np.concatenate([scene.low[new], scene.high[new]])[:, :2], axis=0),
        )
        x, y, w, d = (*(corner / told.extent[:2]), *(size / told.extent[:2]))
        place = (float(x), float(y), float(w), float(d))
    arrows, labels = list[_Arrow](), list[tuple[np.ndarray, str]]()
    told_of = set[int]()
    length = 1.2 * scene.usual
    for p in group.placements:
        low, high = scene.low[p.block], scene.high[p.block]
        top = project(np.array([*(low + high)[:2] / 2, high[2]]))
        way = _way_out(scene, p.block, standing) if p.prop else _WAYS[0]
        way = -_WAYS[0] if p.way == "below" else way
        middle = project((low + high) / 2)
        outside = middle + project(way) * 1.6 * length
        if p.action == "remove":
            arrows.append((middle, outside))
            labels.append((outside, str(p.number)))
        elif p.action == "place":
            # A post goes below what stands already from the side.
            above = way[2] > 0
            arrows.append(
                (top + 1.25 * length * _UP, top + 0.1 * length * _UP)
                if above
                else (outside, middle)
            )
            labels.append((arrows[-1][0], str(p.number)))
        else:
            # Of a block that is held and let go again, where hands take hold of it.
            if p.action == "hold" or p.block not in group.in_hands:
                arrows += _hands(scene, p, 0.6 * length)
            if p.block not in told_of:
                labels.append((top + 0.1 * length * _UP, str(p.number)))
        told_of.add(p.block)
    wanted = tuple(f"{count} × {shape.letter} ({shape.kind})" for shape, count in group.wanted)
    picture = _picture(scene, uses, grid, outlines, tuple(arrows), tuple(labels), place)
    dots = tuple(project(np.array(p.position)) for p in group.placements if p.askew)
    picture = replace(picture, dots=dots)
    if not all_:
        [picture] = _framed([picture])
    words = _words(told, group, layers, until)
    rows = tuple(_rows(group))
    number = f"card {group.number} of {len(told.groups)}"
    return Card(steps_words(group), number, words, wanted, rows, picture, group)


def _words(told: Instructions, group: Group, layers: int, until: dict[int, int]) -> tuple[str, ...]:
    main = group.main
    words = list[str]()
    if group.first:
        words.append(
            f"Layer {group.layer} of {layers}, from {length_words(group.level)} mm up. Its "
            f"first block, of step {main.number}: {place_words(main)}."
        )
    done = done_words(told, group)
    words += [*map(before_words, group.placements), done]
    name = name_words(told.assembly.blocks[main.block].id) if done else "it"
    words.append(way_words(main, name))
    after = told.placements[main.number : main.number + 1]
    if main.action == "remove":
        if [(p.shape, p.action) for p in after] == [(main.shape, "place")] and not main.prop:
            words.append("It goes to its new place in the next step.")
    elif main.prop and main.action == "place":
        end = f" until step {until[main.block]}" if main.block in until else ""
        words.append(f"A prop: it stands only for a while{end}.")
    if len([p for p in group.placements if p.action == "place"]) > 1:
        words.append("In the order of their numbers." if told.in_order else "In any order.")
    others = sorted(group.held - {p.block for p in group.placements})
    if others:
        words.append(f"Still in a hand: {', '.join(told.assembly.blocks[k].id for k in others)}.")
    text = " ".join(filter(None, words))
    return (text,) if text else ()


def _rows(group: Group) -> list[tuple[str, ...]]:
    """A line for every block of a card, with the numbers of all that is done with it."""
    numbers: dict[int, list[str]] = {}
    for p in group.placements:
        numbers.setdefault(p.block, []).append(str(p.number))
    told = {p.block: placement_words(p) for p in reversed(group.placements)}
    return [(", ".join(of), *told[block][1:]) for block, of in numbers.items()]


def _hands(scene: DrawnScene, placement: Placement, length: float) -> list[_Arrow]:
    """Arrows towards a block that is held from both sides, away from one that is let go."""
    ends = [scene.figures[d.name].frame + d.at for d in scene.parts_of({placement.block})]
    low, high = np.min(ends, (0, 1)), np.max(ends, (0, 1))
    level = float(low[1] + high[1]) / 2
    pairs = [
        (np.array([x + way * length, level]), np.array([x, level]))
        for x, way in ((low[0], -1.0), (high[0], 1.0))
    ]
    return pairs if placement.action == "hold" else [(end, start) for start, end in pairs]


def _way_out(scene: DrawnScene, block: int, standing: set[int]) -> np.ndarray:
    """float64[3]: the first direction in which nothing is in the way of a block."""
    others = np.array(sorted(standing - {block}), int)
    for way in _WAYS:
        low, high = scene.low[block].copy(), scene.high[block].copy()
        low, high = np.where(way < 0, -1e3, low), np.where(way > 0, 1e3, high)
        meets = (scene.low[others] < high - 1e-5) & (scene.high[others] > low + 1e-5)
        if not meets.all(1).any():
            return way
    return _WAYS[0]


def _picture(
    scene: DrawnScene,
    uses: tuple[Use, ...],
    grid: Grid,
    outlines: tuple[Use, ...] = (),
    arrows: tuple[_Arrow, ...] = (),
    labels: tuple[tuple[np.ndarray, str], ...] = (),
    place: tuple[float, float, float, float] | None = None,
) -> Picture:
    """A picture that ends where what is drawn ends, without a margin."""
    points = [*grid.lines, *(np.array(arrow) for arrow in arrows)]
    points += [scene.figures[use.name].frame + use.at for use in uses]
    found = np.concatenate(points)
    low, high = found.min(0), found.max(0)
    return Picture(low, high, grid, uses, outlines, arrows, labels, place)


def _framed(pictures: list[Picture]) -> list[Picture]:
    """Pictures of one scale with their margins: they begin at one place and are of one width, and
    each is as high as what it shows."""
    if not pictures:
        return []
    low = np.min([picture.low for picture in pictures], axis=0)
    high = np.max([picture.high for picture in pictures], axis=0)
    size = float((high - low).max())
    margin = 0.09 * size
    # At the left the distances are written outside of the grid.
    left = np.array([0.07 * size if any(p.grid.lines for p in pictures) else 0.0, 0.0])
    low, high = low - margin - left, high + margin
    width, height = (high - low).tolist()
    return [
        replace(p, low=low, high=np.array([high[0], p.high[1] + margin]), within=(width, height))
        for p in pictures
    ]


def _shape_pictures(told: Instructions, scene: DrawnScene) -> list[tuple[BlockShape, Picture]]:
    """Every shape as it is when it is not turned, with the numbers of its corners where it is no
    box; all at one scale, but for those that are far larger than the smallest."""
    found = list[tuple[BlockShape, Picture]]()
    askew = {p.shape.letter for p in (*told.start, *told.placements) if p.askew}
    most = _MOST_LARGER
    for shape in (line.shape for line in told.bill):
        block = Block(shape.letter, shape.corners, shape.faces)
        alone = DrawnScene(instructions(Assembly((block,), joint=told.assembly.joint)))
        uses = tuple(Use(_adopt(scene, d.figure), d.at, shape.colour) for d in alone.drawn)
        labels: tuple[tuple[np.ndarray, str], ...] = ()
        if not shape.is_box and len(shape.corners) <= 12:
            corners = shape.corners - shape.corners.min(0)
            labels = tuple((project(c), str(k)) for k, c in enumerate(corners, 1))
            most = _MOST_LARGER_OF_NUMBERED
        [picture] = _framed([_picture(scene, uses, Grid((), ()), labels=labels)])
        first = project(shape.corners[0] - shape.corners.min(0))
        dots = (first,) if shape.letter in askew and not labels else ()
        found.append((shape, replace(picture, within=None, dots=dots)))
    sizes = np.array([picture.size for _, picture in found])
    near = sizes.max(1, initial=0.0) <= most * sizes.max(1, initial=0.0).min(initial=np.inf)
    if not near.any():
        return found
    width, height = sizes[near].max(0).tolist()
    return [
        (shape, replace(picture, within=(width, height)) if k else picture)
        for (shape, picture), k in zip(found, near.tolist(), strict=True)
    ]


def _adopt(scene: DrawnScene, figure: Figure) -> int:
    """The number of a figure, which a scene takes in."""
    scene.figures.append(figure)
    return len(scene.figures) - 1


def _spacing(told: Instructions, usual: float) -> float:
    """Distance of grid lines [m]: 1, 2 or 5 times a power of ten mm, at most 24 lines a side."""
    wanted = max(0.8 * usual, float(told.extent[:2].max()) / 24)
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(next(k * power for k in (1, 2, 5, 10) if k * power >= wanted * (1 - 1e-9)))


def _depth_step(step: float, depth: float) -> float:
    """The distance of lines from front to back [m]: that of the others, or a smaller one where the
    last line would lie well behind ``depth``, as what stands hides that it does."""
    for _ in range(3):
        if math.ceil(depth / step - 1e-6) * step <= 1.1 * depth:
            break
        leading = round(step / 10.0 ** math.floor(math.log10(step) + 1e-9))
        step /= 2.5 if leading == 5 else 2.0
    return step


def _grid(
    low: tuple[float, ...], high: tuple[float, ...], level: float, step: float, height: float
) -> Grid:
    """Lines every ``step`` on a level, with distances at the front and left; of a height [m] also
    a scale of heights at the back left."""
    steps = (step, _depth_step(step, high[1]))
    xs, ys = (
        np.arange(math.floor(low[k] / every + 1e-6), math.ceil(high[k] / every - 1e-6) + 1) * every
        for k, every in enumerate(steps)
    )
    ends = [(x, ys[0], x, ys[-1]) for x in xs] + [(xs[0], y, xs[-1], y) for y in ys]
    lines = [project(np.array([(a, b, level), (c, d, level)])) for a, b, c, d in ends]
    every_x, every_y = -(-(len(xs) - 1) // 5) or 1, -(-(len(ys) - 1) // 3) or 1
    every_y = max(every_y, math.ceil(steps[0] / steps[1] - 1e-6))
    front, side = xs[::-every_x].tolist(), ys[:0:-every_y].tolist()
    labels = [
        (project(np.array([x, ys[0], level])), "x " * (x == front[0]) + length_words(x), "below")
        for x in front
    ]
    labels += [
        (project(np.array([xs[0], y, level])), "y " * (y == side[0]) + length_words(y), "left")
        for y in side
    ]
    if abs(xs[0]) + abs(ys[0]) + abs(level) < 1e-9:
        labels = [one for one in labels if one[1] != "0"]
        labels.append((project(np.array([xs[0], ys[0], level])), "O", "below"))
    if height:
        top = np.arange(0, math.ceil(height / step - 1e-6) + 1) * step
        corner = (xs[0], ys[-1])
        lines.append(project(np.array([(*corner, 0), (*corner, top[-1])])))
        every = -(-len(top) // 5)
        labels += [
            (project(np.array([*corner, z])), f"z {length_words(z)}", "left")
            for z in top[every::every]
        ]
    return Grid(tuple(lines), tuple(labels))
